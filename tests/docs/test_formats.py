"""The tables of ``docs/formats.md`` name the fields that the code writes and reads, and no other."""

from __future__ import annotations

import csv
import json
import re
from pathlib import Path

import pytest

import tasklift as tl
from tasklift.errors import TaskliftError
from tasklift.lab import FILE_NAME, Store, run
from tasklift.lab.runs import export
from tasklift.studies.certify import certify
from tasklift.studies.spec_file import curriculum_of, read_spec
from tasklift.studies.study import Condition, Study
from tasklift.tasks.policy import LARGEST_JSON

PAGE = (Path(__file__).parents[2] / "docs" / "formats.md").read_text(encoding="utf-8")
BUILDING = tl.generate(seed=7)
TASK = {"inputs": {"a": 2}, "outputs": {"b": 2}}


def named(first: str, after: str) -> set[str]:
    """Return the names in the first column of the first table below ``after`` whose header begins with ``first``."""
    table = PAGE[PAGE.index(after) :].split(f"\n| {first} |", 1)[1].split("\n\n", 1)[0]
    cells = [line.split("|")[1] for line in table.splitlines()[2:]]
    return {name for cell in cells for name in re.findall(r"`(\w+)`", cell)}


def accepted(document: object, tmp_path: Path) -> set[str]:
    """Return the fields that the refusal of a spec with a wrong field lists."""
    file = tmp_path / "spec.json"
    file.write_text(json.dumps(document))
    with pytest.raises(TaskliftError, match="unknown field 'wrong'; the fields are ") as refused:
        curriculum_of(read_spec(file), tmp_path)
    return set(str(refused.value).split("the fields are ")[1].split(", "))


def spec(**fields: object) -> dict[str, object]:
    stage = {"name": "all", "trials": 1}
    return {"name": "x", "environment": {"building": {"seed": 7}}, "stages": [stage]} | fields


def test_building():
    document = BUILDING.to_json()
    document["edges"][0]["course"] = [[1.0, 2.0]]
    written = tl.Building.from_json(document).to_json()
    assert named("field", "## Building") == set(written)
    assert named("field of a node", "## Building") == {name for node in written["nodes"] for name in node}
    assert named("field of an edge", "## Building") == {name for edge in written["edges"] for name in edge}


def test_policy(tmp_path):
    written: set[str] = set()
    for numbers in (2, LARGEST_JSON // 2 + 1):  # rows in the file; a file beside it
        task = tl.Task("wide", [tl.Variable("a", range(numbers))], [tl.Variable("b", range(2))])
        tl.Policy.equal(task).save(tmp_path / "policy.json")
        written |= set(json.loads((tmp_path / "policy.json").read_text()))
    assert {"arrays", "rows"} <= written
    assert named("field", "## Policy") == written


def test_spec(tmp_path):
    assert named("field", "## Spec") == accepted(spec(wrong=1), tmp_path)
    stage = {"name": "all", "trials": 1, "wrong": 1}
    assert named("field of a stage", "## Spec") == accepted(spec(stages=[stage]), tmp_path)
    worlds = [{"gymnasium": "CliffWalking-v1"}, {"building": {"seed": 7}}, {"python": "mine:World"}]
    found = [accepted(spec(environment=w | {"wrong": 1}) | ({"task": TASK} if i == 0 else {}), tmp_path)
             for i, w in enumerate(worlds)]  # fmt: skip
    assert named("field of `environment`", "## Spec") == set.union(*found)
    of_task = spec(environment=worlds[0], task=TASK | {"wrong": 1})
    assert named("field of `task`", "## Spec") == accepted(of_task, tmp_path)


def test_rows(tmp_path):
    study = Study.every({"m": BUILDING}, {"scattered": Condition()}, ("direct",), seeds=1, trials=2)
    with Store.open(tmp_path / FILE_NAME, study.spec("rows")) as store:
        run(store, study.cells(), study.work)
    export(tmp_path, tmp_path / "rows.csv")
    with open(tmp_path / "rows.csv", encoding="utf-8") as file:
        assert named("column", "## Rows") == set(next(csv.reader(file)))


def test_certificate(tmp_path):
    BUILDING.save(tmp_path / "building.json")
    tl.Policy.equal(tl.Mission(BUILDING, "10+5").task).save(tmp_path / "policy.json")
    made = certify(tmp_path / "policy.json", episodes=20)
    assert named("field", "## Certificate") == set(json.loads(made.path.read_text()))
