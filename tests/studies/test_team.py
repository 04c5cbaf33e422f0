"""Which team is needed: a table that resumes, and its verdict."""

from __future__ import annotations

import pytest

from tasklift.building import generate
from tasklift.errors import TaskliftError
from tasklift.studies.team import HEADERS, _verdict, team


def test_names_the_smallest_team_and_resumes(tmp_path) -> None:
    generate(9, 11, 3, 12, doors=8, seed=5).save(tmp_path / "house.json")
    options = {"building": tmp_path / "house.json", "scouts": (4,), "practice": 400, "out": tmp_path / "run"}
    lines, page = team(**options, weapons=(2, 9))
    assert lines[0].split() == " ".join(HEADERS).split()
    small, large = (float(line.split()[3]) for line in lines[1:3])
    assert small < large
    assert lines[-1].startswith("the smallest team that is ready: 4+9 solves ")
    assert page.exists()
    more, _ = team(**options, weapons=(1, 2, 9))  # one weapon robot could never succeed
    assert more == lines


def test_the_verdict_is_the_smallest_ready_team() -> None:
    rows = [["9+2", 11, "search", 40.0, 500, 0.0, 80], ["5+8", 13, "expert", 97.0, 300, 0.0, 80],
            ["2+20", 22, "search", 99.0, 200, 0.0, 80]]  # fmt: skip
    assert _verdict(rows, 0.95).startswith("the smallest team that is ready: 5+8 solves 97.0 %")
    assert _verdict(rows, 0.995).startswith("no team is ready: 2+20 solves the most, 99.0 %")


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"weapons": (1,)}, "a hostile needs 2 weapon robots"),
        ({"practice": 10}, "practice"),
        ({"ready": 0}, "ready"),
        ({"hostiles": 40}, "asked for 40"),
    ],
)
def test_mistakes_are_named_before_anything_is_searched(tmp_path, options, message) -> None:
    generate(5, 5, 2, 5, seed=1).save(tmp_path / "house.json")
    with pytest.raises(TaskliftError, match=message):
        team(building=tmp_path / "house.json", out=tmp_path / "run", **options)
    assert not (tmp_path / "run").exists()
