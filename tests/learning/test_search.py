"""Learning by policy search, in two small worlds: two who must not meet, and a ledge; and in the building."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

import tasklift as tl
from tasklift.building import Mission, generate
from tasklift.errors import TaskliftError
from tasklift.learning.chances import Chances
from tasklift.learning.search import PolicySearch, marginals, product
from tasklift.learning.worlds import Outcomes
from tasklift.tasks import choice
from tasklift.tasks.policy import Policy
from tasklift.tasks.task import Task, Variable
from tasklift.testing import check_learner


class Played:
    """A world of whole trials, made of a function that plays one; nothing is reinforced."""

    def __init__(self, task, trial) -> None:
        self.task, self.trial = task, trial

    def run(self, task, weights, *, trials, seed, stage, first_trial=0, max_losses=None, **_) -> Outcomes:
        records: list[tuple[int, bool, int]] = []
        for i in range(trials):
            if max_losses is not None and sum(r[2] for r in records) >= max_losses:
                break
            records.append(self.trial(weights, Chances(seed, stage).of(first_trial + i)))
        steps, success, losses = np.array(records, dtype=np.int64).reshape(-1, 3).T
        success = success.astype(bool)
        return Outcomes(steps, success, losses, limit=10)


def drawn(row, rng) -> int:
    return choice.draw(row, rng.random())


def meeting(weights, rng) -> tuple[int, bool, int]:
    """Two walkers draw a side from the same row; the task is solved if they pass each other."""
    return 1, drawn(weights[0], rng) != drawn(weights[0], rng), 0


def ledge(weights, rng) -> tuple[int, bool, int]:
    """Four steps along a ledge. Going where it is wet loses; a wait dries it. Never to go loses nothing."""
    losses = place = 0
    wet = True
    for step in range(1, 11):
        go = drawn(weights[int(wet)], rng)
        losses += go and wet
        place, wet = place + go, bool(go)
        if place == 4:
            return step, True, losses
    return 10, False, losses


SIDES = Played(Task("sides", (), (Variable("side", ("left", "right")),)), meeting)
LEDGE = Played(Task("ledge", (Variable("wet", (0, 1)),), (Variable("go", (0, 1)),)), ledge)
SMALL = PolicySearch(population=30, episodes=4)


def search(world, trials, learner=SMALL, **run) -> tl.Curve:
    return learner.learn(world, learner.start(world.task), tl.Run(trials=trials, **run))


@settings(deadline=None, max_examples=30)
@given(st.lists(st.integers(1, 4), min_size=1, max_size=3), st.integers(0, 99))
def test_a_product_has_the_marginals_it_was_made_of(sizes: list[int], seed: int) -> None:
    task = Task(
        "any", (Variable("i", (0, 1, 2)),), tuple(Variable(f"o{k}", tuple(range(n))) for k, n in enumerate(sizes))
    )
    vectors = [np.random.default_rng(seed).dirichlet(np.ones(n), size=3) for n in sizes]
    table = product(vectors)
    assert table.shape == task.shape
    for given_one, found in zip(vectors, marginals(task, 7.0 * table), strict=True):
        assert np.allclose(found, given_one)
    assert all(np.allclose(m, 1 / m.shape[1]) for m in marginals(task, np.zeros(task.shape)))


def test_ends_mixed_where_a_mixture_does_best() -> None:
    policy = search(SIDES, 6000).policy
    assert 0.3 < policy.probabilities({})[0] < 0.7


def test_ends_pure_and_safe_where_that_does_best_and_does_not_end_never_moving() -> None:
    curve = search(LEDGE, 6000)
    assert curve.policy.probabilities({"wet": 1}).tolist() == [1.0, 0.0]
    assert curve.policy.probabilities({"wet": 0}).tolist() == [0.0, 1.0]
    first = curve.outcomes.first(300)
    # losses alone would have taught not to go: most who go at all lose at first
    assert first.losses.sum() > first.success.sum()


def test_nothing_is_learned_while_nothing_is_solved() -> None:
    never = Played(LEDGE.task, lambda weights, rng: (10, False, drawn(weights[1], rng)))
    start = Policy(LEDGE.task, [[1.0, 3.0], [2.0, 2.0]])
    curve = SMALL.learn(never, start, tl.Run(trials=600))
    assert np.array_equal(curve.policy.weights, start.weights)


def test_same_seed_same_policy_and_another_seed_another() -> None:
    one, same, other = (search(LEDGE, 600, seed=seed) for seed in (3, 3, 4))
    assert np.array_equal(one.policy.weights, same.policy.weights)
    assert np.array_equal(one.outcomes.steps, same.outcomes.steps)
    assert not np.array_equal(one.policy.weights, other.policy.weights)
    assert not np.array_equal(one.policy.weights, search(LEDGE, 600, seed=3, first_trial=600).policy.weights)


def test_uses_full_generations_only() -> None:
    assert len(search(LEDGE, 719).outcomes) == 600
    assert len(search(LEDGE, 720).outcomes) == 720
    assert len(search(LEDGE, 6000, steps=1).outcomes) == 120


def test_no_trial_begins_at_the_cap() -> None:
    capped, free = search(LEDGE, 1200, max_losses=40), search(LEDGE, 1200)
    n = len(capped.outcomes)
    assert 0 < n < 1200
    assert np.array_equal(capped.outcomes.losses, free.outcomes.losses[:n])
    lost = np.cumsum(capped.outcomes.losses)
    assert lost[-1] >= 40 > lost[-2]


def test_trust_keeps_candidates_near_what_was_copied() -> None:
    start = Policy(SIDES.task, [[9.0, 1.0]])
    near = SMALL.learn(SIDES, SMALL.count_as(start, 1e6), tl.Run(trials=1200))
    far = SMALL.learn(SIDES, start, tl.Run(trials=1200))
    assert near.policy.weights[0, 0] == pytest.approx(0.9, abs=0.02)
    assert far.policy.weights[0, 0] < 0.8
    assert "concentration" not in near.policy.carried


def test_plays_a_world_that_is_met_step_by_step() -> None:
    class Steps:
        task, limit = LEDGE.task, 10

        def start(self, rng) -> int:
            self.place = 0
            return 1

        def step(self, output) -> tl.Step:
            self.place += output
            return tl.Step(output, 0.0, self.place == 4, 0, self.place == 4)

    curve = search(Steps(), 1200)
    assert curve.outcomes.success[-100:].mean() > 0.9


@pytest.fixture(scope="module")
def drill() -> Mission:
    return Mission(generate(9, 11, 3, 6, seed=5), "4+5").drill()


def test_a_drill_has_a_hostile_at_every_place_and_none_is_lethal(drill: Mission) -> None:
    assert drill.n_hostiles == len(drill.hostiles) > 1
    outcomes = drill.evaluate(Policy.equal(drill.task), 20)
    assert outcomes.losses.sum() > 0
    assert (outcomes.robots_left.sum(axis=-1) == 9).all()


def test_in_the_building_many_at_once_is_one_by_one(drill: Mission) -> None:
    simple = drill.task.simplify(remove=["DL", "GL"])
    learner = PolicySearch(population=20, episodes=2)
    run = tl.Run(trials=400, seed=2)
    many = learner.learn(drill, learner.start(simple), run)
    single = learner.learn(drill, learner.start(simple), tl.Run(trials=400, seed=2, max_losses=10**9))
    assert np.array_equal(many.policy.weights, single.policy.weights)
    for name in ("steps", "success", "losses", "robots_left"):
        assert np.array_equal(getattr(many.outcomes, name), getattr(single.outcomes, name))


def test_in_the_building_drills_teach_to_solve_without_losses(drill: Mission) -> None:
    learner = PolicySearch(population=40)
    stage = tl.Stage(
        "drill", drill.task.simplify(remove=["DL", "GL"]), drill, learner, trials=4800, rehearsal=True
    )
    policy = tl.Curriculum([stage]).run(seed=0).policy.extend(drill.task)
    hunt = Mission(drill.building, "4+5").with_reading(relocate=True)
    outcomes = hunt.evaluate(policy, 300, seed=1)
    assert outcomes.success.mean() > 0.9
    assert outcomes.losses.sum() <= 2


def test_keeps_the_promises_of_a_learner(drill: Mission) -> None:
    for world in (LEDGE, SIDES, drill):
        check_learner(PolicySearch(population=3, episodes=2), world)


def in_a_stage(**budget) -> None:
    tl.Curriculum([tl.Stage("drill", LEDGE.task, LEDGE, SMALL, **budget)]).check()


@pytest.mark.parametrize(
    ("act", "message"),
    [
        (lambda: PolicySearch(population=1), "population: expected a whole number from 2 to 10,000"),
        (lambda: PolicySearch(episodes=0), "episodes: expected a whole number of at least 1"),
        (lambda: PolicySearch(elite=0), "elite: expected a number above 0 up to 1"),
        (lambda: PolicySearch(rate=1.5), "rate: expected a number above 0 up to 1"),
        (lambda: PolicySearch(concentration=float("nan")), "expected a finite number"),
        (lambda: PolicySearch(cutoff=0.6), "cutoff: expected a number from 0 up to 0.5"),
        (lambda: in_a_stage(trials=100), "takes 120 trials, found a budget of 100"),
        (lambda: in_a_stage(steps=100), "no budget"),
        (
            lambda: SMALL.learn(LEDGE, Policy(LEDGE.task, np.ones((2, 2)), kind="value"), tl.Run(trials=120)),
            "expected a policy of weights",
        ),
    ],
)
def test_says_what_is_wrong(act, message: str) -> None:
    with pytest.raises(TaskliftError, match=message):
        act()
