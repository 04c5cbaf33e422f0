"""Failures of policies in models, exactly, and shields."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

import tasklift as tl
from tasklift.errors import TaskliftError
from tasklift.learning.model import Model
from tasklift.tasks.task import Task, Variable


def random_model(seed: int, states: int = 8, outputs: int = 3, branches: int = 3) -> Model:
    """A random world in which every state can be told apart, some losses end the trial and some do not."""
    rng = np.random.default_rng(seed)
    shape = (states, outputs, branches)
    probability = rng.random(shape) * (rng.random(shape) < 0.7)
    probability[..., 0] += 0.1
    return Model(
        task=Task("random", (Variable("x", range(states)),), (Variable("y", range(outputs)),)),
        rows=np.arange(states),
        start_probability=np.full(states, 1 / states),
        probability=probability / probability.sum(axis=2, keepdims=True),
        after=rng.integers(0, states, shape),
        reward=rng.normal(size=shape),
        ended=rng.random(shape) < 0.15,
        lost=(rng.random(shape) < 0.1).astype(np.int64),
        success=rng.random(shape) < 0.5,
        limit=2000,
    )


def fork(p_fall: float = 0.3) -> Model:
    """One state: go, and fall with this probability or arrive; or make a detour, and fall a tenth as often."""
    one = np.zeros((1, 2, 2))
    return Model(
        task=Task("fork", (), (Variable("do", ("go", "detour")),)),
        rows=np.array([0]),
        start_probability=np.array([1.0]),
        probability=np.array([[[p_fall, 1 - p_fall], [0.1 * p_fall, 1 - 0.1 * p_fall]]]),
        after=np.zeros((1, 2, 2), np.int64),
        reward=one - 1.0,
        ended=np.ones((1, 2, 2), bool),
        lost=np.array([[[1, 0], [1, 0]]]),
        success=np.array([[[False, True], [False, True]]]),
        limit=10,
    )


def test_in_a_fork_all_is_known() -> None:
    model = fork()
    assert model.risks() == pytest.approx(np.array([[0.3, 0.03]]))
    assert model.failure_probability(np.array([[0.5, 0.5]])) == pytest.approx(0.165)
    assert np.array_equal(model.shielded(0.3).probability, model.probability)
    assert model.shielded(0.1).probability[0, 0] == pytest.approx([0.03, 0.97])
    # below what any output reaches, the safest one remains
    assert model.shielded(0.0).probability[0, 0] == pytest.approx([0.03, 0.97])
    for risk in (-0.1, 1.1, float("nan")):
        with pytest.raises(TaskliftError, match="shield, risk"):
            model.shielded(risk)


@settings(deadline=None, max_examples=25)
@given(st.integers(0, 10_000))
def test_no_policy_fails_less_than_the_risk_and_the_safest_one_as_often(seed: int) -> None:
    model, rng = random_model(seed), np.random.default_rng(seed)
    risks = model.risks()
    least = float(model.start_probability @ risks.min(axis=1))
    for _ in range(5):
        assert model.failure_probability(rng.dirichlet(np.ones(3), size=8)) >= least - 1e-9
    safest = np.eye(3)[risks.argmin(axis=1)]
    assert model.failure_probability(safest) == pytest.approx(least, abs=1e-8)


@settings(deadline=None, max_examples=15)
@given(st.integers(0, 10_000), st.floats(0, 1))
def test_behind_a_shield_a_state_never_offers_more_than_the_risk(seed: int, risk: float) -> None:
    model = random_model(seed)
    risks, shielded = model.risks(), model.shielded(risk)
    allowed = np.maximum(risk, risks.min(axis=1, keepdims=True)) + 1e-8
    does = np.array([
        [next(b for b in range(3) if np.array_equal(shielded.after[s, a], model.after[s, b])
              and np.array_equal(shielded.probability[s, a], model.probability[s, b])) for a in range(3)]
        for s in range(8)
    ])  # fmt: skip
    assert (np.take_along_axis(risks, does, axis=1) <= allowed).all()
    assert np.array_equal(model.shielded(1.0).after, model.after)


def test_played_failures_are_as_probable_as_computed() -> None:
    model = random_model(3)
    chances = np.full((8, 3), 1 / 3)
    ends = replace(model, ended=model.ended | (model.lost > 0))
    fixed = tl.Fixed(tl.Reinforcement(selection="exploration"))
    found = fixed.learn(ends, tl.Policy(model.task, chances), tl.Run(trials=2000, seed=1)).outcomes
    assert (found.losses > 0).mean() == pytest.approx(model.failure_probability(chances), abs=0.04)


@pytest.mark.slow
def test_failure_probabilities_agree_with_storm(tmp_path: Path) -> None:
    storm = pytest.importorskip("stormpy", reason="stormpy is not installed")
    for seed in range(20):
        model = random_model(seed)
        chances = np.random.default_rng(seed).dirichlet(np.ones(3), size=8)
        # states 0 to 7 of the model, then: lost, ended, not begun
        move = np.zeros((11, 11))
        for s, a, k in np.ndindex(model.probability.shape):
            to = 8 if model.lost[s, a, k] else 9 if model.ended[s, a, k] else model.after[s, a, k]
            move[s, to] += chances[s, a] * model.probability[s, a, k]
        move[8, 8] = move[9, 9] = 1.0
        move[10, :8] = model.start_probability
        lines = [
            f"[] s={s} -> " + " + ".join(f"{float(move[s, to])!r}:(s'={to})" for to in np.flatnonzero(move[s])) + ";"
            for s in range(11)
        ]
        text = "\n".join(["dtmc", "module m", "s : [0..10] init 10;", *lines, "endmodule"])
        (tmp_path / "chain.prism").write_text(text)
        program = storm.parse_prism_program(str(tmp_path / "chain.prism"))
        properties = storm.parse_properties("P=? [F s=8]", program)
        chain = storm.build_model[storm.Rational](program, properties)  # Storm's own floats are good to 1e-6
        result = storm.model_checking(chain, properties[0], environment=storm.environments.exact())
        expected = float(result.get_value(chain.initial_states[0]))
        assert model.failure_probability(chances) == pytest.approx(expected, abs=1e-10)


def walk(*, probability=1.0, reward=-1.0, lost=0, start=None, limit=50, branches=None) -> Model:
    """Five places in a row; the last one is home."""
    task = Task("walk", (Variable("place", range(5)),), (Variable("go", (-1, 1)),))

    def transitions(state, output):
        there = min(4, max(0, state["place"] + output["go"]))
        return [(probability, {"place": there}, reward, there == 4, lost)] if branches is None else branches

    return Model.from_function(task, transitions, {"place": 0} if start is None else start, limit)


def test_a_model_from_a_function_counts_losses_and_successes() -> None:
    model = walk(lost=np.int64(2))
    assert model.lost.dtype == np.int64
    assert (model.lost == 2).all()
    assert not model.success.any()  # who loses does not succeed, unless the function says so
    assert walk().optimum() == -4
    split = walk(start=[(0.25, {"place": 3}), (0.75, {"place": 2})])
    assert split.optimum() == -0.25 - 0.75 * 2


@pytest.mark.parametrize(
    ("options", "says"),
    [
        ({"lost": 0.5}, "expected whole numbers of losses"),
        ({"lost": -1}, "expected whole numbers of losses"),
        ({"lost": 1e30}, "expected whole numbers of losses"),
        ({"lost": float("nan")}, "expected whole numbers of losses"),
        ({"lost": None}, r"{'place': 0}, {'go': -1}: expected branches"),
        ({"reward": "x"}, "expected branches"),
        ({"reward": float("nan")}, "a reward is not a finite number"),
        ({"probability": 0.5}, "do not sum to one"),
        ({"probability": "half"}, "expected branches"),
        ({"limit": 0}, "limit: expected a whole number of at least 1, found 0"),
        ({"limit": None}, "limit: expected a whole number of at least 1"),
        ({"start": 3}, r"start: expected a state, or pairs \(probability, state\), found 3"),
        ({"start": [{"place": 0}]}, "expected a state, or pairs"),
        ({"start": {"room": 0}}, "has no 'place'"),
        ({"branches": (1.0, {"place": 0}, 0.0, True)}, "expected branches"),
        ({"branches": None, "probability": None}, "expected branches"),
        ({"branches": []}, "at least one branch"),
        ({"branches": [(1.0, {"place": 9}, 0.0, True)]}, r"{'go': -1}: .*has no value 9"),
        ({"branches": [(1.0, {"place": 1}, 0.0, True, 0, True, 3)]}, "expected branches"),
    ],
)
def test_what_is_wrong_with_a_function_is_named(options, says: str) -> None:
    with pytest.raises(TaskliftError, match=says):
        walk(**options)


def test_a_model_is_stepped_within_trials_only() -> None:
    model = walk(start={"place": 3})
    with pytest.raises(TaskliftError, match="outside of a trial"):
        model.step(1)
    model.start(np.random.default_rng(0))
    for output in (-1, 2, 0.5):
        with pytest.raises(TaskliftError, match="output: expected a whole number from 0 to 1"):
            model.step(output)
    assert model.step(1).ended
    with pytest.raises(TaskliftError, match="outside of a trial"):
        model.step(1)
