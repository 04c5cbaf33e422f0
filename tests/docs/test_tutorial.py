"""The code of the tutorial and of other pages runs, and prints what the pages say."""

from __future__ import annotations

import contextlib
import io
import re
from pathlib import Path

import pytest

from tasklift.building import generate
from tasklift.studies.learn import run_spec
from tasklift.studies.train import train

pytest.importorskip("gymnasium")
pytest.importorskip("sklearn")
DOCS = Path(__file__).parents[2] / "docs"


def play(page: str, folder: Path) -> tuple[dict, list[str]]:
    """Run a page's code in order, compare what it prints, write its files; returns its names and files."""
    blocks = re.findall(r"```(python|text|toml)( title=\"(.*?)\")?\n(.*?)```", (DOCS / page).read_text(), re.DOTALL)
    printed, names, files = "", {"__name__": "page"}, []
    for kind, _, title, code in blocks:
        if title:
            (folder / title).write_text(code)
            files.append(title)
        if kind == "text":
            assert printed.rstrip() == code.rstrip()
        elif kind == "python" and title != "worlds.py":
            out = io.StringIO()
            with contextlib.redirect_stdout(out):
                exec(compile(code, f"docs/{page}, {title or 'code'}", "exec"), names)
            printed = out.getvalue()
    return names, files


def test_the_page_on_hazards_does_what_it_says(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    names, _ = play("hazards.md", tmp_path)
    assert names["run"].guards["holes"].verdict == "hurts"


def test_the_tutorial_does_what_it_says(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    names, files = play("tutorial.md", tmp_path)
    assert files == ["aisle.py", "aisle.toml", "worlds.py"]
    assert (tmp_path / "aisle-policy.json").exists()
    # the spec says the same as the code: same seeds, same losses
    comparison = run_spec(tmp_path / "aisle.toml", seeds=12)
    assert comparison.to_json()["findings"] == names["verdict"].to_json()["findings"]


@pytest.mark.parametrize("page", ["quickstart.md", "exercises.md"])
def test_short_pages_do_what_they_say(page: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    play(page, tmp_path)


def test_a_run_becomes_a_table_and_a_plot(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    pytest.importorskip("pandas")
    monkeypatch.chdir(tmp_path)
    generate(seed=7).save("office.json")
    train(building=Path("office.json"), out=Path("runs/office"), seeds=2, arms=["direct", "copy-prior"])
    play("pandas.md", tmp_path)
