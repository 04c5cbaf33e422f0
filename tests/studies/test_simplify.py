"""The search for a simpler task: its space, its race, and answers that are known."""

from __future__ import annotations

import json
from itertools import combinations
from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st

import planted
from tasklift import Task, TaskliftError, Variable
from tasklift.studies.learn import run_spec
from tasklift.studies.simplify import candidates, simplify, study_of

pytest.importorskip("gymnasium")
EXAMPLES = Path(__file__).parents[2] / "examples"

SWITCHES = [{"name": "calm", "options": {"wind": 0}}, {"name": "drill", "options": {"x": 1}, "harmless": True}]


@st.composite
def tasks(draw: st.DrawFn) -> Task:
    inputs = tuple(Variable(f"i{k}", range(draw(st.integers(2, 4)))) for k in range(draw(st.integers(1, 4))))
    outputs = tuple(Variable(f"o{k}", range(draw(st.integers(1, 3)))) for k in range(draw(st.integers(1, 3))))
    return Task("t", inputs, outputs)


@given(tasks(), st.integers(0, 2), st.sampled_from([[], SWITCHES[:1], SWITCHES]))
def test_candidates_are_all_different_and_come_cheapest_first(task: Task, depth: int, switches: list) -> None:
    found = candidates(task, {"trials": 5, "depth": depth, "switches": switches})
    assert len({candidate.slug for candidate in found}) == len(found)
    assert len({json.dumps([dict(c.stage), list(map(dict, c.prior))], sort_keys=True) for c in found}) == len(found)
    assert [candidate.states for candidate in found] == sorted(candidate.states for candidate in found)
    assert all(set(candidate.stage) > {"name", "trials"} for candidate in found)


@given(tasks())
def test_inputs_that_belong_together_are_never_left_out_together(task: Task) -> None:
    names = [variable.name for variable in task.inputs]
    never = list(combinations(names, 2))
    found = candidates(task, {"trials": 5, "depth": 2}, never)
    assert all(len(candidate.stage.get("remove", [])) <= 1 for candidate in found)


def test_the_free_lake_is_learned_without_holes_first(tmp_path: Path) -> None:
    spec = tmp_path / "lake.toml"
    spec.write_text((EXAMPLES / "simplify-lake.toml").read_text().replace("trials = 1000", "trials = 300"))
    study = study_of(spec)
    answer = simplify(spec, tmp_path / "out")
    assert answer.best is not None
    assert answer.best.words.startswith("no holes")
    assert answer.comparison is not None
    assert answer.comparison.verdict == "holds"
    assert answer.episodes <= study.price()
    # the same call computes nothing anew, and the recommended spec runs as it is
    assert simplify(spec, tmp_path / "out").lines == answer.lines
    verdict = run_spec(tmp_path / "out" / "curriculum.json", seeds=6)
    assert verdict.finding("losses, target only").curriculum < verdict.finding("losses, target only").direct


@pytest.mark.slow
def test_on_the_punished_lake_nothing_helps(tmp_path: Path) -> None:
    text = (EXAMPLES / "lake-punished-falls.toml").read_text().split("[[stages]]")[0]
    holes = (EXAMPLES / "simplify-lake.toml").read_text()
    (tmp_path / "lake.toml").write_text(text + holes[holes.index("[[stages]]") :])
    answer = simplify(tmp_path / "lake.toml")
    assert answer.best is None
    assert answer.lines[0].startswith("Nothing helps: learn the task from scratch.")


@pytest.mark.parametrize(
    ("change", "says"),
    [
        (("[simplify]\ntrials = 300", "[simplify]\ntrials = 0"), "simplify, trials"),
        (("[simplify]\ntrials = 300", "[simplify]\ntrials = 300\ncriterion = 'fame'"), "criterion"),
        (("[simplify]\ntrials = 300", "[simplify]\ntrials = 300\ndepth = 9"), "depth"),
        (('name = "no holes"\n', ""), "switches 1"),
        (("trials = 1000", "steps = 1000"), "one [[stages]] with trials"),
        (("[simplify]\ntrials = 300", "[other]\ntrials = 300"), "other"),
    ],
)
def test_mistakes_are_refused_before_anything_is_trained(tmp_path: Path, change: tuple[str, str], says: str) -> None:
    text = (EXAMPLES / "simplify-lake.toml").read_text()
    assert change[0] in text
    (tmp_path / "spec.toml").write_text(text.replace(*change))
    with pytest.raises(TaskliftError, match=r"spec\.toml") as refused:
        simplify(tmp_path / "spec.toml", tmp_path / "out")
    assert says in str(refused.value)
    assert not (tmp_path / "out").exists()


def test_a_file_that_is_no_spec_is_named_once(tmp_path: Path) -> None:
    (tmp_path / "notes.md").write_text("# no spec")
    with pytest.raises(TaskliftError) as refused:
        simplify(tmp_path / "notes.md", tmp_path / "out")
    assert str(refused.value).count("notes.md") == 1


@pytest.mark.parametrize("kind", planted.KINDS)
def test_planted_truths_are_found(kind: str, tmp_path: Path) -> None:
    assert planted.right(kind, planted.answer(kind, 1000, tmp_path))
