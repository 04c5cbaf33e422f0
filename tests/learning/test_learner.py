"""Runs, and the learners that need no world of their own: fixed ones, several in turn; playing on any world."""

from __future__ import annotations

from dataclasses import asdict, dataclass, replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from test_reinforcement import Corridor, simple_task
from test_values import Gate, random_model

import tasklift as tl
from tasklift.building import Mission, generate
from tasklift.learning.chances import GREEDY_STAGE
from tasklift.learning.values import evaluate, learn_values
from tasklift.learning.worlds import joined

PROPERTY = settings(deadline=None, derandomize=True, max_examples=60)
BOLD, CAREFUL = tl.Reinforcement(), tl.Reinforcement(selection="pseudo-random", q=0.9, loss_signal=-0.5)


@PROPERTY
@given(
    trials=st.none() | st.integers(0, 30), steps=st.none() | st.integers(0, 200), cap=st.none() | st.integers(1, 9),
    cut=st.integers(1, 29),
)  # fmt: skip
def test_a_run_cut_anywhere_is_the_same_run(trials: int | None, steps: int | None, cap: int | None, cut: int) -> None:
    if trials is None and steps is None:
        return
    run = tl.Run(seed=1, trials=trials, steps=steps, max_losses=cap)
    start = tl.Policy.equal(Gate.task)
    whole = tl.Reinforcement().learn(Gate(), start, run)
    first = tl.Reinforcement().learn(Gate(), start, replace(run, trials=cut if trials is None else min(cut, trials)))
    left = run.rest([first.outcomes])
    parts, policy = [first.outcomes], first.policy
    if left is not None:
        rest = tl.Reinforcement().learn(Gate(), policy, left)
        parts, policy = [*parts, rest.outcomes], rest.policy
    assert np.array_equal(joined(parts).steps, whole.outcomes.steps)
    assert np.array_equal(policy.weights, whole.policy.weights)


def test_an_empty_part_takes_no_column_from_the_others() -> None:
    @dataclass(frozen=True)
    class Measured(tl.Outcomes):
        robots: np.ndarray

    part = Measured(np.array([3]), np.array([True]), np.array([1]), 9, np.array([2]))
    assert joined([part, joined([]), part]).to_pandas()["robots"].tolist() == [2, 2]
    assert len(joined([joined([]), joined([])])) == 0


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"seed": -1}, "run, seed: expected a whole number"),
        ({"trials": 2.5}, "run, trials: expected a whole number"),
        ({"steps": -1}, "run, steps: expected a whole number"),
        ({"max_losses": 0}, "run, max_losses: expected a whole number of at least 1"),
        ({"first_trial": True}, "run, first_trial: expected a whole number"),
    ],
)
def test_runs_are_checked(options: dict, message: str) -> None:
    with pytest.raises(tl.TaskliftError, match=message):
        tl.Run(**options)


def test_learners_in_turn_are_one_after_the_other() -> None:
    start = tl.Policy.equal(Corridor.task)
    both = tl.InTurn((BOLD, CAREFUL), (0, 12)).learn(Corridor(), start, tl.Run(seed=4, trials=30))
    first = BOLD.learn(Corridor(), start, tl.Run(seed=4, trials=12))
    second = CAREFUL.learn(Corridor(), first.policy, tl.Run(seed=4, first_trial=12, trials=18))
    assert np.array_equal(both.policy.weights, second.policy.weights)
    assert np.array_equal(both.outcomes.losses, np.append(first.outcomes.losses, second.outcomes.losses))
    stage = tl.Stage("s", Corridor.task, Corridor(), tl.InTurn((BOLD, CAREFUL), (0, 12)), trials=30)
    for block in (1, 5, 7, None):
        assert np.array_equal(tl.Curriculum([stage], block=block).run(4).policy.weights, both.policy.weights)


@pytest.mark.parametrize("starts", [(), (0,), (1, 2), (0, 0), (0, 5, 9)])
def test_learners_in_turn_need_a_start_each(starts: tuple) -> None:
    with pytest.raises(tl.TaskliftError, match="one start per learner, growing from 0"):
        tl.InTurn((BOLD, CAREFUL), starts)


def test_a_sweep_can_be_cut() -> None:
    learner, start = tl.Sweep(repeats=4), tl.Policy.equal(simple_task())
    whole = learner.learn(Corridor(False), start, tl.Run(3, 1))
    first = learner.learn(Corridor(False), start, tl.Run(3, 1, trials=5))
    rest = learner.learn(Corridor(False), first.policy, tl.Run(3, 1, first_trial=5))
    assert (len(first.outcomes), len(rest.outcomes)) == (5, 3)
    assert np.array_equal(rest.policy.weights, whole.policy.weights)
    assert np.array_equal(whole.policy.weights, tl.sweep(Corridor(False), simple_task(), repeats=4, seed=3).weights)


def test_a_fixed_learner_learns_nothing() -> None:
    start = tl.Policy(Corridor.task, np.tile([1.0, 3.0], (6, 1)))
    curve = tl.Fixed(BOLD).learn(Corridor(), start, tl.Run(seed=2, trials=20))
    assert curve.policy is start
    assert len(curve.outcomes) == 20
    learned = BOLD.learn(Corridor(), start, tl.Run(seed=2, trials=1))
    assert curve.outcomes.steps[0] == learned.outcomes.steps[0]
    values = learn_values(Gate(), trials=40, seed=2).policy
    with pytest.raises(tl.TaskliftError, match="values cannot be drawn in proportion"):
        tl.Fixed(BOLD).learn(Gate(), values, tl.Run(trials=1))
    assert tl.Fixed().learn(Gate(), values, tl.Run(trials=9)).outcomes.success.all()


def test_any_world_can_be_played_greedily() -> None:
    hunt = Mission(generate(intersections=8, corridors=9, rooms=3, seed=3), team="4+3", limit=120)
    policy = tl.reinforce(hunt, tl.Policy.equal(hunt.task), trials=20).policy
    before = policy.weights.copy()
    found = tl.evaluate(hunt, policy, trials=7, seed=3)
    by_hand = hunt.evaluate(policy, 7, seed=3, reinforcement=tl.Reinforcement(selection="exploitation"))
    assert np.array_equal(found.steps, by_hand.steps[0])
    assert found.robots_left.shape == (7, 2)
    assert np.array_equal(policy.weights, before)
    safe = tl.sweep(hunt.without_hostiles(), hunt.task.simplify(fix={"DL": 0, "GL": 0}), repeats=1)
    assert len(tl.evaluate(hunt.without_hostiles(), safe, trials=3)) == 3
    with pytest.raises(tl.TaskliftError, match="which this simplified task leaves out"):
        tl.evaluate(hunt, safe, trials=20)
    with pytest.raises(tl.TaskliftError, match="evaluate, epsilon"):
        tl.evaluate(hunt, policy, epsilon=0.1)
    model = random_model(2)
    values = learn_values(model, trials=50).policy
    late = evaluate(model, values, trials=4, first_trial=6)
    assert np.array_equal(late.returns, evaluate(model, values, trials=10).returns[6:])
    greedy = tl.Fixed().learn(model, values, tl.Run(stage=GREEDY_STAGE, trials=3)).outcomes
    assert len(greedy) == 3
    assert asdict(tl.Run())["trials"] is None
