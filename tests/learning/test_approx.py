"""Trees and networks in place of tables: faithful, extended like tables, and learned where no table would fit."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from test_policy import random_policy
from test_task import paper_simple, paper_task, simplified, small_tasks
from test_values import Gate

from tasklift.errors import TaskliftError
from tasklift.learning.approx import Approximation, approximate, fidelity, learn_approximate, play
from tasklift.learning.values import ValueLearning, evaluate, learn_values
from tasklift.learning.worlds import Step
from tasklift.tasks import task as task_module
from tasklift.tasks.policy import Policy, invert, scale, set_weight, swap
from tasklift.tasks.task import Task, Variable

pytest.importorskip("sklearn")
PROPERTY = settings(deadline=None, derandomize=True, max_examples=40)


@PROPERTY
@given(st.data())
def test_a_tree_that_may_grow_is_the_table_and_comes_back(data: st.DataObject) -> None:
    policy = random_policy(data.draw(simplified(data.draw(small_tasks()))))
    tree = approximate(policy)
    assert tree.to_policy().weights == pytest.approx(policy.weights)
    assert fidelity(policy, tree).same_best == 1


@PROPERTY
@given(st.data())
def test_extending_a_tree_is_extending_the_table(data: st.DataObject) -> None:
    task = data.draw(small_tasks())
    policy = random_policy(data.draw(simplified(task)))
    prior = [scale(2.0, {"i0": 0}), invert({"o0": "v0"})]
    wide = approximate(policy).extend(task, prior)
    assert wide.to_policy().weights == pytest.approx(policy.extend(task, prior).weights)


def test_the_papers_policy_as_a_tree_extends_with_its_prior() -> None:
    task, v = paper_task(), random_policy(paper_simple())
    prior = [swap("MV", when={"FTR": 4, "nWPN": [0, 1]}), set_weight(0.5, {"DL": 2, "CA": 0.0})]
    wide = approximate(v).extend(task, prior)
    table = v.extend(task, prior)
    assert wide.to_policy().weights == pytest.approx(table.weights)
    some = [0, 17, 44, 89]
    assert wide.weights(some) == pytest.approx(table.weights[some])
    assert wide.best(some).tolist() == table.best()[some].tolist()
    with pytest.raises(TaskliftError, match="'FTR' has no value 9"):
        approximate(v).extend(task, [swap("MV", when={"FTR": 9})])


def test_a_network_is_faithful_and_a_small_tree_less_so() -> None:
    task = paper_task()
    rng = np.random.default_rng(2)
    weights = 1.5 + rng.normal(size=(30, 1, 1)) * np.linspace(0, 1, 11) + rng.normal(size=(30, 4, 1))
    policy = Policy(task, np.tile(np.exp(weights).reshape(30, 44), (3, 1)))
    visits = np.zeros(90)
    visits[:5] = 1
    network = fidelity(policy, approximate(policy, "network", hidden=(64,)), visits=visits)
    assert network.same_best > 0.9
    small = approximate(policy, max_leaves=8)
    stump = fidelity(policy, small, visits=visits)
    assert stump.same_best < network.same_best
    first = small.to_policy().best()[:5] == policy.best()[:5]
    assert stump.same_best_visited == pytest.approx(first.mean())
    assert math.isnan(stump.table_return)


def test_fidelity_counts_ties_as_faithful() -> None:
    policy = Policy.equal(paper_simple())
    assert fidelity(policy, approximate(policy, max_leaves=2)).same_best == 1


def test_the_return_is_reported_with_the_fidelity() -> None:
    learned = learn_values(Gate(), trials=300, learning=ValueLearning("sarsa", 0.2, discount=1.0)).policy
    exact = fidelity(learned, approximate(learned), world=Gate(), trials=50)
    assert exact.same_best == exact.same_best_visited == 1
    assert exact.table_return == exact.approximation_return
    assert exact.table_return == pytest.approx(evaluate(Gate(), learned, trials=50).returns.mean())
    always = approximate(learned, max_leaves=2)
    blunt = fidelity(learned, always, world=Gate(), trials=50)
    assert blunt.approximation_return < blunt.table_return


def test_a_small_tree_is_told_as_rules() -> None:
    policy = Policy(Gate.task, np.array([[0.0, 1.0]] * 5 + [[1.0, 0.0]]), kind="value")
    told = approximate(policy).rules()
    assert told.splitlines() == [
        "if place is one of 0, 1:",
        "  go = 1",
        "if place is 2:",
        "  if shut is 0:",
        "    go = 1",
        "  if shut is 1:",
        "    go = 0",
    ]
    labels = Policy(paper_simple(), np.array([[1.0] * 22 + [2.0] * 22] * 15))
    assert approximate(labels).rules() == "MV = 1, WPN = 0, CA = 0.0"
    assert "if FTR is door:" in approximate(labels.extend(paper_simple(), [swap("MV", when={"FTR": "door"})])).rules()


# -- tasks without a table -----------------------------------------------------------------------------------


class Sorting:
    """Three parcels per trial, each with many marks; left or right depends on two of them, and one is fragile.

    Which side is right depends on ``x0``; with ``x1`` at 7 or more the parcel is fragile and the sides are swapped.
    """

    limit = 3

    def __init__(self, marks: int, fragile: bool = True) -> None:
        inputs = tuple(Variable(f"x{k}", range(10)) for k in range(marks))
        self.task = Task("sorting", inputs, (Variable("side", ("left", "right")),))
        self.fragile = fragile

    def _next(self) -> int:
        self.seen = [int(v) for v in self.rng.integers(0, 10, len(self.task.inputs))]
        if not self.fragile:
            self.seen[1] = 0
        return self.task.input_index({f"x{k}": v for k, v in enumerate(self.seen)})

    def start(self, rng: np.random.Generator) -> int:
        self.rng, self.done = rng, 0
        return self._next()

    def step(self, output: int) -> Step:
        right = int(self.seen[0] >= 5) ^ int(self.seen[1] >= 7)
        good = output == right
        lost = int(not good and self.seen[1] >= 7)
        self.done += 1
        return Step(self._next(), 1.0 if good else -1.0, self.done == 3, lost, True)


@pytest.mark.parametrize("marks", [6, 12])
def test_a_task_of_a_million_inputs_and_more_is_learned_and_never_enumerated(marks: int, monkeypatch) -> None:
    monkeypatch.setattr(task_module, "LARGEST_TABLE", 5000)
    world = Sorting(marks)
    assert world.task.shape[0] == 10**marks
    with pytest.raises(TaskliftError, match=r"tasklift\.learning\.approx"):
        Policy.equal(world.task)
    # the simple task sees x0 only, where nothing is fragile
    safe = world.task.simplify(fix={"x1": 0}, remove=[f"x{k}" for k in range(2, marks)])
    v = learn_approximate(Sorting(marks, fragile=False), task=safe, rounds=4, trials=40, discount=0.0)
    assert play(Sorting(marks, fragile=False), v.approximation).returns.mean() == 3
    copied = v.approximation.extend(world.task)
    informed = v.approximation.extend(world.task, [swap("side", when={"x1": [7, 8, 9]})])
    assert play(world, informed).returns.mean() == 3
    assert 0 < play(world, copied).returns.mean() < 2.5
    # what was copied is right where nothing is fragile; learning mends the rest, and does so from less
    learned = learn_approximate(world, copied, rounds=4, trials=100, discount=0.0, seed=1)
    scratch = learn_approximate(world, rounds=4, trials=100, discount=0.0, seed=1)
    assert play(world, learned.approximation).returns.mean() > 2.8
    assert learned.outcomes.returns[:100].mean() > scratch.outcomes.returns[:100].mean() + 0.2
    assert 0 < len(learned.met) <= 4 * 100 * 4
    told = learned.approximation.rules(learned.met, max_leaves=4)
    assert "x0" in told
    assert "x1" in told
    with pytest.raises(TaskliftError, match="would have"):
        learned.approximation.to_policy()


@pytest.mark.parametrize("kind", ["tree", "network"])
def test_going_on_after_an_extension_loses_little_more_than_from_scratch(kind) -> None:
    world, options = Sorting(4), {"kind": kind, "discount": 0.0}
    safe = world.task.simplify(fix={"x1": 0}, remove=["x2", "x3"])
    lost = {"scratch": 0, "copied": 0, "informed": 0}
    for seed in range(2):
        v = learn_approximate(Sorting(4, fragile=False), task=safe, seed=seed, rounds=2, trials=40, **options)
        copied, known = v.approximation.extend(world.task), [swap("side", when={"x1": [7, 8, 9]})]
        informed = v.approximation.extend(world.task, known)
        for arm, start in (("scratch", None), ("copied", copied), ("informed", informed)):
            curve = learn_approximate(world, start, seed=seed, rounds=3, trials=100, **options)
            lost[arm] += int(curve.outcomes.losses.sum())
    # a start that repeats its mistake for a whole round loses 1.5 to 1.9 times as much
    assert lost["copied"] <= 1.15 * lost["scratch"]
    assert lost["informed"] < 0.75 * lost["scratch"]


def test_looking_ahead_pays_in_fitted_iteration() -> None:
    # one reward at the end of a walk: only a learner that backs it up finds the way
    learned = learn_approximate(Gate(), rounds=8, trials=30, sweeps=10, discount=0.95, leaf=1, epsilon=0.3)
    outcomes = play(Gate(), learned.approximation, trials=100)
    assert outcomes.success.all()
    assert outcomes.losses.sum() == 0


def test_a_network_learns_too() -> None:
    world = Sorting(2)
    options = {"kind": "network", "rounds": 2, "trials": 150, "sweeps": 1, "discount": 0.0, "hidden": (16,)}
    learned = learn_approximate(world, **options)
    assert play(world, learned.approximation).returns.mean() > 2.3


class Half:
    """One step; of each of two inputs, only the lower half is ever met. The first output pays, the second costs."""

    task = Task("half", (Variable("i", range(6)), Variable("j", range(4))), (Variable("o", range(3)),))
    limit = 1

    def start(self, rng: np.random.Generator) -> int:
        return int(rng.integers(3)) * 4 + int(rng.integers(2))

    def step(self, output: int) -> Step:
        return Step(0, 10.0 * (1 - output), ended=True, success=True)


@pytest.mark.parametrize("kind", ["tree", "network"])
def test_what_was_transferred_stays_where_there_is_no_experience(kind) -> None:
    start = approximate(Policy(Half.task, np.tile([1.0, 2.0, 3.0], (24, 1)), kind="value"), "tree")
    curve = learn_approximate(Half(), start, kind=kind, rounds=2, trials=100, epsilon=1.0, discount=0.0)
    weights = curve.approximation.to_policy().weights
    never = [i for i in range(24) if i not in curve.met]
    assert len(never) == 18
    assert np.abs(weights[never] - [1.0, 2.0, 3.0]).max() < 1e-9
    assert weights[list(curve.met)] == pytest.approx(np.tile([10.0, 0.0, -10.0], (6, 1)), abs=1.5)


class Toll:
    """One step. The first door pays most and breaks something, the third is locked, the fourth is always shut."""

    task = Task("toll", (), (Variable("door", range(4)),), impossible=({"door": 3},))
    limit = 1
    possible = np.array([True, True, False, True])
    breaks, begun = None, 0

    def start(self, rng: np.random.Generator) -> int:
        self.begun += 1
        if self.begun == self.breaks:
            raise RuntimeError("the simulator fell over")
        return 0

    def step(self, output: int) -> Step:
        assert output < 2
        return Step(0, 5.0 - output, ended=True, lost=int(output == 0), success=True)


def test_fitted_iteration_knows_losses_and_what_is_impossible() -> None:
    for penalty, best in ((0.0, 0), (3.0, 1)):
        curve = learn_approximate(Toll(), rounds=2, trials=30, epsilon=1.0, loss_penalty=penalty)
        weights = curve.approximation.weights([0])[0]
        assert weights[:2].argmax() == best
        assert weights[:2] == pytest.approx([5.0 - penalty, 4.0])
    shut = Toll()
    shut.possible = np.array([False, False, False, True])
    with pytest.raises(TaskliftError, match="no output is possible"):
        learn_approximate(shut, rounds=1, trials=1)


def test_what_was_fitted_before_a_crash_is_kept() -> None:
    world = Toll()
    world.breaks = 25
    with pytest.raises(RuntimeError, match="fell over") as crash:
        learn_approximate(world, rounds=2, trials=20, epsilon=1.0)
    once = learn_approximate(Toll(), rounds=1, trials=20, epsilon=1.0)
    assert np.array_equal(crash.value.curve.approximation.weights([0]), once.approximation.weights([0]))
    assert len(crash.value.curve.outcomes) == 24


@pytest.mark.parametrize(
    ("call", "message"),
    [
        (lambda p: approximate(p, "forest"), "expected 'tree' or 'network'"),
        (lambda p: learn_approximate(Gate(), kind="forest"), "expected 'tree' or 'network'"),
        (lambda p: approximate(p, max_leaves=1), "max_leaves: expected a whole number of at least 2"),
        (lambda p: learn_approximate(Gate(), rounds=0), "rounds: expected a whole number"),
        (lambda p: learn_approximate(Gate(), approximate(p)), "input 'nWPN' of 'T' is not in 'gate'|'DL'"),
        (lambda p: approximate(p).extend(paper_simple()), "neither equal to nor a simplification"),
        (lambda p: play(Gate(), approximate(Policy.equal(Gate.task)), trials=0), "trials: expected a whole number"),
    ],
)
def test_mistakes_are_named(call, message: str) -> None:
    with pytest.raises(TaskliftError, match=message):
        call(Policy.equal(paper_task()))


def test_weights_stay_weights() -> None:
    policy = random_policy(paper_simple())
    network = approximate(policy, "network", hidden=(4,))
    assert isinstance(network, Approximation)
    assert (network.to_policy().weights >= 0).all()
    assert network.to_policy().kind == "weight"
