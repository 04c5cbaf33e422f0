"""The search for a simpler task: its space, its race, and answers that are known."""

from __future__ import annotations

import json
from contextlib import suppress
from pathlib import Path

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

import planted
from tasklift import Task, TaskliftError, Variable
from tasklift.building import Mission, generate
from tasklift.building.search import hostile_candidates
from tasklift.cli.main import main
from tasklift.lab import Interrupted
from tasklift.studies.arms import Setup
from tasklift.studies.learn import run_spec
from tasklift.studies.simplify import search
from tasklift.studies.simplify.answer import simplify
from tasklift.studies.simplify.search import FINALISTS, SimplifyStudy, study_of
from tasklift.studies.simplify.space import Candidate, chains, steps
from tasklift.studies.spec_file import arm_of, curriculum_of

pytest.importorskip("gymnasium")
EXAMPLES = Path(__file__).parents[2] / "examples"

SWITCHES = [{"name": "calm", "options": {"wind": 0}}, {"name": "drill", "options": {"x": 1}, "harmless": True}]
PRIORS = [{"name": "the opposite", "operations": [{"operation": "invert"}]}]

PROPERTY = settings(deadline=None, derandomize=True, max_examples=15)


@st.composite
def tasks(draw: st.DrawFn) -> Task:
    inputs = tuple(Variable(f"i{k}", range(draw(st.integers(2, 5)))) for k in range(draw(st.integers(1, 3))))
    outputs = tuple(Variable(f"o{k}", range(draw(st.integers(1, 5)))) for k in range(draw(st.integers(1, 3))))
    return Task("t", inputs, outputs)


def spelled(candidate: Candidate) -> str:
    return json.dumps(candidate.stages({"trials": 5}), sort_keys=True)


@PROPERTY
@given(tasks(), st.integers(0, 2), st.sampled_from([[], SWITCHES[:1], SWITCHES]), st.sampled_from([[], PRIORS]))
def test_candidates_are_all_different_and_come_cheapest_first(
    task: Task, depth: int, switches: list, priors: list
) -> None:
    found = steps(task, {"depth": depth, "switches": switches, "priors": priors, "trust": [2.0]})
    both = [*found, *chains(found[-3:], found)]
    assert len({candidate.name for candidate in both}) == len(both)
    assert [candidate.cost for candidate in found] == sorted(candidate.cost for candidate in found)
    for candidate in found:
        (stage,), entering = candidate.stages({"trials": 5})
        assert set(stage) > {"name", "trials"}
        assert entering.keys() <= {"prior", "trust"}
    # the names of stages aside, no two ask for the same
    said = [json.dumps([dict(s, name="") for s in c.stages({"trials": 5})[0]] + [c.stages({"trials": 5})[1]],
                       sort_keys=True) for c in both]  # fmt: skip
    assert len(set(said)) == len(said)


@PROPERTY
@given(tasks())
def test_a_chain_leads_from_the_simpler_task_to_the_less_simple_one(task: Task) -> None:
    found = steps(task, {"depth": 2, "switches": SWITCHES})
    for chain in chains(found[-4:], found):
        stages, _ = chain.stages({"trials": 7})
        assert sum(stage["trials"] for stage in stages) == 7
        middle = task.simplify(**changes(stages[1]))
        first = middle.simplify(**changes(stages[0]))
        assert first.ancestor(task).shape == task.shape
        assert first.shape[0] * first.shape[1] == chain.steps[0].entries


def changes(stage: dict) -> dict:
    return {name: stage[name] for name in ("fix", "remove", "restrict", "merge") if name in stage}


@PROPERTY
@given(tasks())
def test_inputs_that_belong_together_are_never_changed_together(task: Task) -> None:
    names = [variable.name for variable in task.inputs]
    found = steps(task, {"depth": 2, "never": [names[:2]]})
    changed = [{move.variable for move in candidate.steps[0].moves} for candidate in found]
    assert not any(len(names) > 1 and set(names[:2]) <= both for both in changed)


def test_the_free_lake_is_learned_without_holes_first(tmp_path: Path) -> None:
    spec = tmp_path / "lake.toml"
    text = (EXAMPLES / "simplify-lake.toml").read_text().replace("trials = 1000", "trials = 300")
    spec.write_text(text.replace("[simplify]\n", "[simplify]\ndepth = 0\nseeds = 12\n"))
    study = study_of(spec)
    answer = simplify(spec, tmp_path / "out")
    assert answer.best is not None
    assert answer.best.words.startswith("no holes")
    assert answer.found.against_scratch().verdict == "holds"
    assert answer.found.episodes <= study.price()
    assert (tmp_path / "out" / "lattice.svg").read_text().count("<svg") == 1
    # the same call computes nothing anew, and the recommended spec runs as it is
    assert simplify(spec, tmp_path / "out").lines == answer.lines
    verdict = run_spec(tmp_path / "out" / "curriculum.json", seeds=6)
    assert verdict.finding("losses, target only").curriculum < verdict.finding("losses, target only").direct


@pytest.mark.slow
def test_on_the_punished_lake_the_holes_stay() -> None:
    answer = simplify(EXAMPLES / "simplify-lake-punished.toml")
    assert answer.best is not None
    assert answer.best.words == "coarse col"
    assert answer.found.judged[0].measures.success.mean() > answer.found.judge.success.mean()


@pytest.mark.parametrize(
    ("change", "says"),
    [
        (("[simplify]\ntrials = 300", "[simplify]\ntrials = 0"), "simplify, trials"),
        (("[simplify]\ntrials = 300", "[simplify]\ntrials = 300\ncriterion = 'fame'"), "criterion"),
        (("[simplify]\ntrials = 300", "[simplify]\ntrials = 300\ndepth = 9"), "depth"),
        (('name = "no holes"\n', ""), "switches 1"),
        (("[simplify]\ntrials = 300", "[simplify]\ntrials = 300\nmost = { episodes = 3 }"), "simplify, most"),
        (("[simplify]\ntrials = 300", "[simplify]\ntrials = 300\nseeds = 3"), "simplify, seeds"),
        (("[simplify]\ntrials = 300", "[simplify]\ntrials = 300\ncurricula = [{ name = 'a', stages = [{}] }]"), "'a'"),
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


@pytest.mark.parametrize("seed", ['"x"', "[]", "-1", "0.5"])
def test_a_seed_of_buildings_that_is_no_number_is_refused(tmp_path: Path, seed: str) -> None:
    text = (EXAMPLES / "simplify-mission.toml").read_text()
    assert "seed = 7 }" in text
    (tmp_path / "spec.toml").write_text(text.replace("seed = 7 }", f"seed = {seed} }}"))
    with pytest.raises(TaskliftError, match=r"spec\.toml: environment, building, seed: expected a whole number"):
        study_of(tmp_path / "spec.toml")


def test_a_file_that_is_no_spec_is_named_once(tmp_path: Path) -> None:
    (tmp_path / "notes.md").write_text("# no spec")
    with pytest.raises(TaskliftError) as refused:
        simplify(tmp_path / "notes.md", tmp_path / "out")
    assert str(refused.value).count("notes.md") == 1


@pytest.mark.parametrize("kind", planted.KINDS)
def test_planted_truths_are_found(kind: str, tmp_path: Path) -> None:
    assert planted.right(kind, planted.answer(kind, 1000, tmp_path))


def search_of(kind: str, **settings: object) -> SimplifyStudy:
    document = planted.document(kind, 1000)
    document["simplify"] |= {"seeds": 12} | settings
    return SimplifyStudy(document, Path(planted.__file__).parent)


@pytest.mark.parametrize("criterion", search.CRITERIA)
def test_every_criterion_finds_the_colour_that_means_nothing(criterion: str, tmp_path: Path) -> None:
    study = search_of("independent", criterion=criterion, stages=1)
    found = study.search(tmp_path / "experiment.sqlite")
    assert found.race[0].candidate.words == "without colour"
    assert found.runner_up is not None
    assert found.regret(found.runner_up)[0].estimate < 0
    assert 1 < len(found.judged) <= FINALISTS


def test_a_limit_on_what_is_lost_before_the_target_is_kept(tmp_path: Path) -> None:
    free = search_of("decoy", stages=1).search(tmp_path / "free.sqlite").race
    least = min(one.measures.losses_before.mean() for one in free)
    found = search_of("decoy", stages=1, most={"losses": least + 0.1}).search(tmp_path / "limited.sqlite")
    assert found.race[0].measures.losses_before.mean() <= least + 0.1 < free[0].measures.losses_before.mean()


def test_a_search_that_was_stopped_goes_on_to_the_same_answer(tmp_path: Path) -> None:
    class Stop:
        calls = 0

        def __call__(self, done: int, total: int, note: str) -> None:
            self.calls += 1
            if self.calls == 40:
                raise KeyboardInterrupt

    study, stop = search_of("decoy", stages=1), Stop()
    with pytest.raises((Interrupted, KeyboardInterrupt)):
        study.search(tmp_path / "experiment.sqlite", stop)
    stop.calls = 41
    found = study.search(tmp_path / "experiment.sqlite", stop)
    again = search_of("decoy", stages=1).search(tmp_path / "other.sqlite")
    assert found.race[0].candidate.words == again.race[0].candidate.words
    assert [one.measures.criterion.tolist() for one in found.judged] == [
        one.measures.criterion.tolist() for one in again.judged
    ]
    more = search_of("decoy", stages=1, seeds=14, criterion="steps").search(tmp_path / "experiment.sqlite")
    assert len(more.judge.success) == 14
    assert more.episodes > found.episodes


def test_a_mission_brings_its_own_switches_and_a_building_for_each_seed() -> None:
    study = study_of(EXAMPLES / "simplify-mission.toml")
    words = {candidate.words for candidate in study.found}
    assert {"no hostiles", "harmless hostiles at every door; forget MV", "half the team", "without DL"} <= words
    assert "one hostile" not in words
    buildings = [study.curriculum(None, seed).stages[0].world.building.content_id for seed in (0, 0, 1)]
    assert buildings[0] == buildings[1] != buildings[2]
    safe = next(candidate for candidate in study.found if candidate.words == "no hostiles; forget MV")
    before, target = study.curriculum(safe).stages
    assert before.world.n_hostiles == 0
    assert before.task.shape == (15, 44)
    assert [operation.to_json()["operation"] for operation in target.prior] == ["forget"]


def test_a_recommended_mission_is_an_arm_of_train(tmp_path: Path) -> None:
    study = study_of(EXAMPLES / "simplify-mission.toml")
    found = next(c for c in study.found if c.words == "harmless hostiles at every door, MV never stop")
    (tmp_path / "curriculum.json").write_text(json.dumps(study.spec_of(found)))
    assert curriculum_of(study.spec_of(found)).stages[0].task.shape == (90, 22)
    other = Setup(Mission(generate(doors=6, seed=5), team="6+4", hostiles=2))
    before, target = arm_of(tmp_path / "curriculum.json").curriculum(other).stages
    assert before.world.hostiles == tuple(hostile_candidates(other.mission.building))
    assert target.world.n_hostiles == 2


FERRY = """
import gymnasium
import numpy as np

class Ferry(gymnasium.Env):
    observation_space = gymnasium.spaces.MultiDiscrete([5, 4])  # place, flag
    action_space = gymnasium.spaces.Discrete(2)

    def __init__(self, storm=True):
        self.storm = storm

    def seen(self):
        return np.array([self.place, self.np_random.integers(4)])

    def reset(self, seed=None, options=None):
        super().reset(seed=seed)
        self.place = 0
        return self.seen(), {}

    def step(self, action):
        wrecked = self.storm and action == self.place % 2
        self.place = 0 if wrecked else self.place + 1
        home = self.place == 5
        if home:
            self.place = 0
        return self.seen(), -3.0 if wrecked else -1.0, home, False, {}

gymnasium.register("Ferry-v0", Ferry)
"""
SPEC = """
name = "ferry"
environment = { gymnasium = "ferry:Ferry-v0", limit = 40, loss = { reward = -3.0 }, options = { storm = true } }
task = { inputs = { place = 5, flag = 4 }, outputs = { go = ["left", "right"] } }
learner = { rule = "q-learning", step_size = 0.2, epsilon = 0.1 }

[[stages]]
name = "storm"
trials = 30

[simplify]
trials = 20
seeds = 12
switches = [{ name = "calm", options = { storm = false } }]
"""


def test_a_gymnasium_task_of_ones_own_from_fifteen_lines(tmp_path: Path) -> None:
    assert len(SPEC.strip().splitlines()) <= 15
    (tmp_path / "ferry.py").write_text(FERRY)
    (tmp_path / "ferry.toml").write_text(SPEC)
    answer = simplify(tmp_path / "ferry.toml", tmp_path / "out")
    assert answer.best is not None
    assert answer.best.words == "without flag"
    assert answer.lines[0].startswith("Learn this first: without flag. It saves, on 12 new seeds, losses")
    again = FERRY.replace("gymnasium.register", 'gymnasium.registry.pop("Ferry-v0")\ngymnasium.register')
    (tmp_path / "ferry.py").write_text(again)
    with pytest.raises(TaskliftError, match=r"modules\.ferry: another one"):
        simplify(tmp_path / "ferry.toml", tmp_path / "out")


def test_the_command_judges_curricula_of_ones_own(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    (tmp_path / "ferry.py").write_text(FERRY.replace("Ferry-v0", "Ferry-v1"))
    own = """curricula = [
        { name = "calm first", stages = [{ name = "calm", options = { storm = false }, trials = 20 }] },
        { name = "no flag first", stages = [{ name = "flat", remove = ["flag"], trials = 20 }] },
    ]"""
    spec = SPEC.replace("Ferry-v0", "Ferry-v1").replace("seeds = 12", f"seeds = 12\ndepth = 0\n{own}")
    (tmp_path / "own.toml").write_text(spec[: spec.index("switches")])
    monkeypatch.setattr(
        "sys.argv", ["tasklift", "simplify", str(tmp_path / "own.toml"), "--out", str(tmp_path / "out"), "--json"]
    )
    with suppress(SystemExit):
        main()
    said = json.loads(capsys.readouterr().out)
    assert said["best"] == "no flag first"
    assert [row["learn first"] for row in said["judged"]] == ["no flag first", "calm first", "from scratch"]
    assert said["curriculum"]["stages"][0]["remove"] == ["flag"]
    assert not (tmp_path / "out" / "lattice.svg").exists()
