"""``tasklift team``: a table, a verdict, and one clear line for every mistake."""

from __future__ import annotations

import sys

import pytest

from tasklift.building import generate
from tasklift.cli import main as cli


@pytest.fixture
def tasklift(monkeypatch, capsys, tmp_path):
    """Run the command in a folder with a building; return (exit code, standard output, standard error)."""
    monkeypatch.chdir(tmp_path)
    generate(5, 5, 2, 5, seed=1).save("house.json")
    generate(5, 5, 2, 0, seed=1).save("bare.json")

    def run(*arguments):
        monkeypatch.setattr(sys, "argv", ["tasklift", "team", *map(str, arguments)])
        code = 0
        try:
            cli.main()
        except SystemExit as stop:
            code = stop.code
        out = capsys.readouterr()
        return code, out.out, out.err

    return run


def test_prints_a_table_and_the_smallest_team(tasklift):
    code, out, _ = tasklift("house.json", "--scouts", "2", "--weapons", "2-3", "--practice", "400", "--out", "run")
    assert code == 0
    lines = out.splitlines()
    assert lines[0].split()[:2] == ["team", "robots"]
    assert [line.split()[0] for line in lines[1:3]] == ["2+2", "2+3"]
    assert lines[-1] == "report: run/report.html"
    assert "team" in lines[-2]


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["nowhere.json"], "nowhere.json: cannot be read"),
        (["bare.json"], "has 0 place(s) for them"),
        (["house.json", "--weapons", "1"], "a hostile needs 2 weapon robots"),
        (["house.json", "--weapons", "a"], "such as 1-5"),
        (["house.json", "--ready", "2"], "ready: expected a number above 0 up to 1"),
        (["house.json", "--hostiles", "40"], "asked for 40"),
        (["house.json", "--practice", "5"], "practice"),
    ],
)
def test_a_mistake_is_one_line_and_exit_code_2(tasklift, tmp_path, arguments, message):
    code, out, err = tasklift(*arguments)
    assert (code, out) == (2, "")
    assert message in err
    assert err.count("\n") == 1
    assert sorted(p.name for p in tmp_path.iterdir()) == ["bare.json", "house.json"]
