"""Every example runs as it stands, in a folder of its own."""

from __future__ import annotations

import runpy
from pathlib import Path

import pytest

EXAMPLES = Path(__file__).parents[1] / "examples"
SHORT = ["train_team", "own_environment", "own_building", "own_learner", "table_and_plot"]


@pytest.mark.parametrize("name", SHORT)
def test_short_examples_run_and_are_short(
    name: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    if name == "own_environment":
        pytest.importorskip("gymnasium")
    if name == "table_and_plot":
        pytest.importorskip("pandas")
    monkeypatch.chdir(tmp_path)
    script = EXAMPLES / f"{name}.py"
    assert len(script.read_text().splitlines()) <= 40
    runpy.run_path(str(script), run_name="__main__")
    assert capsys.readouterr().out


def test_the_notebook_runs_and_shows_what_it_makes(tmp_path: Path) -> None:
    nbformat = pytest.importorskip("nbformat")
    nbclient = pytest.importorskip("nbclient")
    pytest.importorskip("ipykernel")
    notebook = nbformat.read(EXAMPLES / "first_steps.ipynb", as_version=4)
    nbclient.NotebookClient(notebook, timeout=300, resources={"metadata": {"path": str(tmp_path)}}).execute()
    shown = [output for cell in notebook.cells for output in cell.get("outputs", []) if "data" in output]
    pages = [output["data"].get("text/html", "") for output in shown]
    for begins in ("<svg", "<table", "<iframe"):
        assert any(begins in page for page in pages), begins
    assert any("image/png" in output["data"] for output in shown)
