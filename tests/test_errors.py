"""A missing extra is named with a command that works where the user is."""

from __future__ import annotations

import importlib.metadata

import pytest

from tasklift.errors import missing

DECLARED = ["numpy>=1.26", "pillow>=10; extra == 'plans'", 'pyyaml>=6 ; extra == "plans"', "ray>=2; extra == 'ray'"]


def test_the_command_names_the_packages_of_the_extra(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(importlib.metadata, "requires", lambda name: DECLARED)
    error = missing("Pillow", "plans", "reading a picture")
    assert str(error) == (
        "reading a picture needs Pillow (the extra 'plans'); type: pip install 'pillow>=10' 'pyyaml>=6'"
    )


def test_without_metadata_the_command_names_the_package(monkeypatch: pytest.MonkeyPatch) -> None:
    def nothing(name: str) -> list[str]:
        raise importlib.metadata.PackageNotFoundError(name)

    monkeypatch.setattr(importlib.metadata, "requires", nothing)
    assert str(missing("Ray", "ray")).endswith("type: pip install ray")


@pytest.mark.parametrize("extra", ["plans", "dxf", "gym", "approx", "ray", "parquet", "pandas", "torch"])
def test_every_extra_that_the_code_names_is_declared(extra: str) -> None:
    needs = importlib.metadata.requires("tasklift") or []
    assert any(f"extra == '{extra}'" in need.replace('"', "'") for need in needs)
