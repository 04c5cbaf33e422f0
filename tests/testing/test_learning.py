"""The public checks of worlds and learners: what ships passes them, and each broken promise is named."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import own_learner
import pytest
from test_reinforcement import Corridor, simple_task
from test_values import Gate, OneByOne, random_model

import tasklift as tl
from tasklift.building import Mission, generate
from tasklift.learning.compare import compare
from tasklift.learning.curriculum import Curriculum
from tasklift.testing import check_learner, check_world

HUNT = Mission(generate(intersections=8, corridors=9, rooms=3, seed=3), team="4+3", limit=120)


def pole() -> Any:
    gymnasium = pytest.importorskip("gymnasium")
    from tasklift.envs.gymnasium import Factored

    task = tl.Task(
        "lake",
        (tl.Variable("row", range(4)), tl.Variable("col", range(4))),
        (tl.Variable("move", ("left", "down", "right", "up")),),
    )
    return Factored(gymnasium.make("FrozenLake-v1"), task, loss=lambda event: event.terminated and not event.reward)


# -- what ships ------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    "world",
    [HUNT, HUNT.without_hostiles(), HUNT.with_reading(drill=True), Corridor(), Gate(), random_model(3),
     tl.StepTrials(Gate()), OneByOne(random_model(4)), own_learner.Ferry(0.5)],
    ids=["mission", "mission without hostiles", "drill", "trials", "steps", "model", "steps as trials", "plain", "own"],
)  # fmt: skip
def test_worlds_keep_their_promises(world: Any) -> None:
    check_world(world)


def test_gymnasium_keeps_the_promises_of_worlds() -> None:
    world = pole()
    check_world(world)
    check_world(world.model())
    check_learner(tl.ValueLearning(), world)


def test_a_simplified_task_can_be_checked() -> None:
    safe = HUNT.task.simplify(fix={"DL": 0, "GL": 0})
    check_world(HUNT.without_hostiles(), safe)
    check_world(Corridor(hazard=False), simple_task())


LEARNERS = {
    "reinforcement": tl.Reinforcement(loss_signal=-0.5),
    "baseline": tl.Reinforcement(time_signal="baseline", credit="trial"),
    "sweep": tl.Sweep(repeats=3),
    "fixed": tl.Fixed(tl.Reinforcement(selection="pseudo-random")),
    "in turn": tl.InTurn((tl.Reinforcement(), tl.Reinforcement(selection="exploitation")), (0, 5)),
    "own": own_learner.RandomSearch(),
}


@pytest.mark.parametrize("world", [HUNT, Corridor(), Gate()], ids=["mission", "trials", "steps"])
@pytest.mark.parametrize("learner", LEARNERS.values(), ids=LEARNERS)
def test_learners_of_weights_keep_their_promises(learner: Any, world: Any) -> None:
    check_learner(learner, world)


@pytest.mark.parametrize("rule", ["q-learning", "sarsa", "expected-sarsa"])
def test_learners_of_values_keep_their_promises(rule: Any) -> None:
    learner = tl.ValueLearning(rule, 0.05, 0.7, epsilon=0.5, epsilon_decay=0.9)
    check_learner(learner, random_model(5))
    check_learner(learner, Gate())
    check_learner(tl.InTurn((learner, replace(learner, step_size=0.2)), (0, 4)), Gate())


def test_a_learner_of_ones_own_is_an_equal_citizen() -> None:
    curriculum = own_learner.curriculum
    run = curriculum.run(seed=0)
    assert [(e.stage, e.learner) for e in run.ledger.entries] == [
        ("calm", "transferred"), ("storms", "transferred"), ("storms", "control")
    ]  # fmt: skip
    assert sum(e.trials for e in run.ledger.entries) == 240 or run.stopped
    assert run.guards["storms"].pairs > 0
    capped = replace(curriculum, max_losses=5).run(seed=0)
    assert capped.stopped == "storms"
    assert 5 <= capped.ledger.total <= 5 + 30
    assert run.policy.provenance["learner"] == "RandomSearch"
    assert run.policy.provenance["settings"] == {"size": 1.0}
    comparison = compare(curriculum, seeds=4, performance="steps")
    assert comparison.finding("losses, target only").curriculum < comparison.finding("losses, target only").direct
    other = tl.Reinforcement(loss_signal=-0.5)
    mixed = [curriculum.stages[0], replace(curriculum.stages[1], learner=other, guard=None, trials=5)]
    assert Curriculum(mixed).run(0).ledger.entries[1].trials == 5
    with pytest.raises(tl.TaskliftError, match="stage 'storms': trust: a RandomSearch cannot weigh"):
        Curriculum([replace(curriculum.stages[1], trust=3.0)]).check()


# -- broken promises -------------------------------------------------------------------------------------------


class Bent(Gate):
    """A good world with one thing wrong."""

    def __init__(self, wrong: str) -> None:
        super().__init__()
        self.wrong, self.begun = wrong, 0
        if wrong == "limit":
            self.limit = 0

    def start(self, rng: np.random.Generator) -> int:
        self.begun += 1
        if self.wrong == "memory" and self.begun > 6:
            rng.random()
        if self.wrong == "own dice":
            rng = np.random.default_rng()
        found = super().start(rng)
        return {"start": 99, "start type": 1.0}.get(self.wrong, found)

    def step(self, output: int) -> tl.Step:
        answer = super().step(output)
        bad = {"input": -1, "reward": float("nan"), "lost": -1, "success": 1}
        if self.wrong == "tuple":
            return (0, 1.0)  # type: ignore[return-value]
        return answer._replace(**{self.wrong: bad[self.wrong]}) if self.wrong in bad else answer


@pytest.mark.parametrize(
    ("wrong", "message"),
    [
        ("limit", "world, limit: expected a whole number of steps of at least 1, found 0"),
        ("start", "world, start: expected an input from 0 to 5, found 99"),
        ("start type", "world, start: expected an input from 0 to 5, found 1.0"),
        ("input", r"input=-1.*expected an input from 0 to 5"),
        ("reward", "expected a finite number as the reward"),
        ("lost", "expected a whole number of losses"),
        ("success", "expected true or false in success"),
        ("tuple", "expected a Step, found"),
        ("memory", "run again with the same random numbers and outputs differs"),
        ("own dice", "take all random numbers from the generator"),
    ],
)
def test_a_broken_promise_of_steps_is_named(wrong: str, message: str) -> None:
    with pytest.raises(AssertionError, match=message):
        check_world(Bent(wrong), trials=8)


class BentTrials(Corridor):
    """A good world of whole trials with one thing wrong."""

    def __init__(self, wrong: str) -> None:
        super().__init__()
        self.wrong, self.calls = wrong, 0

    def run(self, task, weights, **options: Any) -> tl.Outcomes:
        self.calls += 1
        if self.wrong == "memory":
            options["seed"] += self.calls
        if self.wrong == "first trial":
            options["first_trial"] = 0
        if self.wrong == "cap":
            options["max_losses"] = None
        if self.wrong == "sweep" and options.get("outputs") is not None:
            options["seed"] += self.calls
        found = super().run(task, weights, **options)
        if self.wrong == "learn":
            weights += 0.5
        if self.wrong == "floor" and options.get("learn", True):
            weights -= 9.0
        if self.wrong == "piece" and options.get("learn", True):
            weights += 0.5
        if self.wrong == "many":
            return tl.joined([found, found])
        return replace(found, losses=found.losses - 1) if self.wrong == "losses" else found


@pytest.mark.parametrize(
    ("wrong", "message"),
    [
        ("memory", "the same trials, run twice without learning, differ: steps of trial . are"),
        ("first trial", "trial 3 on depend on the trials before them"),
        ("cap", "a trial began after .* losses, with a cap of"),
        ("sweep", "a sweep, run twice, differs"),
        ("learn", "learn=False, and the weights changed"),
        ("floor", "a weight of .* is below the floor 0.0"),
        ("piece", "comes to other weights"),
        ("many", "at most 6 trials, found 12"),
        ("losses", "a trial lost -1"),
    ],
)
def test_a_broken_promise_of_trials_is_named(wrong: str, message: str) -> None:
    with pytest.raises(AssertionError, match=message):
        check_world(BentTrials(wrong))


@dataclass
class BentLearner:
    """A good learner with one thing wrong."""

    wrong: str
    calls: int = 0

    def start(self, task: tl.Task) -> tl.Policy:
        self.calls += 1
        return tl.Policy.equal(task, 1.0 + self.calls * (self.wrong == "start"))

    def count_as(self, policy: tl.Policy, trust: float) -> tl.Policy:
        return tl.Policy.equal(simple_task()) if self.wrong == "count" else policy

    def learn(self, world: Any, policy: tl.Policy, run: tl.Run) -> tl.Curve:
        self.calls += 1
        if self.wrong == "dice":
            run = replace(run, seed=run.seed + self.calls)
        if self.wrong == "key":
            run = replace(run, first_trial=0)
        if self.wrong == "cap":
            run = replace(run, max_losses=None)
        if self.wrong == "steps" and run.steps is not None:
            run = replace(run, trials=3, steps=None)
        if self.wrong == "trials" and run.trials:
            run = replace(run, trials=run.trials + 1)
        curve = tl.Reinforcement().learn(world, policy, run)
        if self.wrong == "nothing":
            return tl.Curve(tl.Policy(policy.task, curve.policy.weights + 1), curve.outcomes)
        if self.wrong == "task":
            return tl.Curve(tl.Policy.equal(simple_task()), curve.outcomes)
        if self.wrong == "kind":
            return tl.Curve(replace(curve.policy, kind="value"), curve.outcomes)
        if self.wrong == "provenance":
            return tl.Curve(replace(curve.policy, provenance={"by": self}), curve.outcomes)
        return curve


@pytest.mark.parametrize(
    ("wrong", "message"),
    [
        ("start", r"BentLearner, start: two starts on one task differ: weights at \(0, 0\) are 2.0 and 3.0"),
        ("dice", "the same run, learned twice"),
        ("key", "a run cut after 6 of 12 trials .* has other outcomes"),
        ("cap", r"max_losses=\d+: a trial began after"),
        ("steps", "expected the last trial to begin before and to end after"),
        ("trials", "at most 12 trials, found 13"),
        ("nothing", "0 trials changed the weights"),
        ("task", "came back with a policy of another task"),
        ("kind", "took a policy of weights, came back with values"),
        ("count", "count_as: came back with a policy of another task"),
        ("provenance", "its provenance is not JSON"),
    ],
)
def test_a_broken_promise_of_a_learner_is_named(wrong: str, message: str) -> None:
    with pytest.raises(AssertionError, match=message):
        check_learner(BentLearner(wrong), Corridor())
    check_learner(BentLearner("none"), Corridor())


def test_a_curriculum_does_not_book_more_trials_than_it_asked_for() -> None:
    stage = tl.Stage("greedy", Corridor.task, Corridor(), BentLearner("trials"), trials=10)
    with pytest.raises(tl.TaskliftError, match=r"BentLearner was asked for at most 10 trials and ran 11"):
        Curriculum([stage]).run()
