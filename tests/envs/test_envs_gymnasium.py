"""Gymnasium environments as factored tasks, and external checks: published or exact numbers, cited."""

from __future__ import annotations

import numpy as np
import pytest

from tasklift.envs.gymnasium import Event, Factored
from tasklift.errors import TaskliftError
from tasklift.learning.compare import compare
from tasklift.learning.curriculum import Curriculum
from tasklift.learning.stage import Stage
from tasklift.learning.values import ValueLearning, evaluate, learn_values
from tasklift.tasks.policy import Policy
from tasklift.tasks.task import Task, Variable

gymnasium = pytest.importorskip("gymnasium")

LAKE_MOVES = Variable("move", ("left", "down", "right", "up"))
CLIFF = Task(
    "cliff",
    (Variable("row", range(4)), Variable("col", range(12))),
    (Variable("move", ("up", "right", "down", "left")),),
)
TAXI = Task(
    "taxi",
    (
        Variable("row", range(5)),
        Variable("col", range(5)),
        Variable("passenger", range(5), ("red", "green", "yellow", "blue", "aboard")),
        Variable("destination", range(4), ("red", "green", "yellow", "blue")),
    ),
    (Variable("do", ("south", "north", "east", "west", "pick up", "drop off")),),
)


def lake_task(side: int) -> Task:
    return Task("lake", (Variable("row", range(side)), Variable("col", range(side))), (LAKE_MOVES,))


def frozen_lake(**options) -> Factored:
    return Factored(
        gymnasium.make("FrozenLake-v1", **options),
        lake_task(4),
        loss=lambda e: e.terminated and e.reward == 0,
    )


def cliff_walk(**options) -> Factored:
    return Factored(gymnasium.make("CliffWalking-v1", **options), CLIFF, loss=lambda e: e.reward == -100, limit=5000)


# -- external checks -----------------------------------------------------------------------------------------


def test_frozen_lake_optimum() -> None:
    # Gymnasium's 4x4 map, slippery: 0.7442 within its 100 steps (0.74 is the figure commonly quoted for an
    # optimal policy), 14/17 without a limit; both exact, by dynamic programming
    model = frozen_lake().model()
    assert model.limit == 100
    assert model.optimum(steps=100) == pytest.approx(0.7442, abs=5e-5)
    assert model.optimum() == pytest.approx(14 / 17, abs=1e-9)
    played = evaluate(model, model.best_policy(), trials=4000, seed=1)
    # within 0.75 at best (the stationary policy is not the best one for 100 steps), 5 standard errors around
    assert played.success.mean() == pytest.approx(0.74, abs=0.035)


def test_cliff_walking_optima() -> None:
    # Sutton & Barto (2018), example 6.6: the optimal path takes 13 steps; the best eps-soft policy is exact
    model = cliff_walk().model()
    assert model.optimum() == pytest.approx(-13)
    values = model.action_values(epsilon=0.1)
    greedy = (values == values.max(axis=1, keepdims=True)).astype(float)
    soft = 0.9 * greedy / greedy.sum(axis=1, keepdims=True) + 0.1 / 4
    assert model.evaluate(soft) == pytest.approx(-20.71, abs=5e-3)


def test_cliff_walking_as_sutton_and_barto_have_it() -> None:
    # example 6.6 and its figure: alpha .5, epsilon .1, 500 episodes; over the last ones the sum of rewards
    # during an episode is near -50 for Q-learning and near -25 for SARSA, which takes the safe path and
    # falls less
    model = cliff_walk().model()
    late, falls = {}, {}
    for rule in ("q-learning", "sarsa"):
        runs = [
            learn_values(model, trials=500, seed=s, learning=ValueLearning(rule, 0.5, discount=1.0)).outcomes
            for s in range(100)
        ]
        late[rule] = np.mean([run.returns[-100:].mean() for run in runs])
        falls[rule] = np.array([run.losses.sum() for run in runs])
    assert late["q-learning"] == pytest.approx(-50, abs=5)
    assert late["sarsa"] == pytest.approx(-25, abs=5)
    assert (falls["q-learning"] > falls["sarsa"]).mean() == 1.0


# -- the door itself -----------------------------------------------------------------------------------------


@pytest.mark.parametrize("make", [frozen_lake, cliff_walk])
def test_the_model_is_the_environment(make) -> None:
    world = make()
    model = world.model()
    rng = np.random.default_rng(0)
    for trial in range(20):
        seen = world.start(np.random.default_rng(trial))
        for _ in range(100):
            output = int(rng.integers(4))
            answer = world.step(output)
            branches = model.probability[seen, output] > 0
            told = [
                (
                    int(model.after[seen, output, k]),
                    model.reward[seen, output, k],
                    bool(model.ended[seen, output, k]),
                    int(model.lost[seen, output, k]),
                    bool(model.success[seen, output, k]),
                )
                for k in np.flatnonzero(branches)
            ]
            assert tuple(answer) in told
            seen = answer.input
            if answer.ended:
                break


def test_an_environment_is_learned_step_by_step_as_well() -> None:
    learning = ValueLearning("sarsa", 0.5, discount=1.0)
    slow = learn_values(cliff_walk(), trials=60, seed=2, learning=learning)
    fast = learn_values(cliff_walk().model(), trials=60, seed=2, learning=learning)
    # the cliff has no chance in it but the choices, which differ only by the draws that the model spends on
    # moves
    assert slow.outcomes.returns[-20:].mean() == pytest.approx(fast.outcomes.returns[-20:].mean(), abs=40)
    assert slow.outcomes.returns[-20:].mean() > slow.outcomes.returns[:20].mean()
    again = learn_values(cliff_walk(), trials=60, seed=2, learning=learning)
    assert np.array_equal(again.policy.weights, slow.policy.weights)


def test_taxi_factors_as_its_manual_says() -> None:
    world = Factored(gymnasium.make("Taxi-v4"), TAXI, loss=lambda e: e.reward == -10)
    env = world.env.unwrapped
    for state in range(500):
        row, col, passenger, destination = env.decode(state)
        values = {"row": row, "col": col, "passenger": passenger, "destination": destination}
        assert TAXI.input_values(world.input_of(state)) == values
    assert world.limit == 200
    model = world.model()
    # the published optimum of taxi's mean return is near 8 (Dietterich 2000 and after); exact here
    assert model.optimum(steps=200) == pytest.approx(7.93, abs=0.2)


def test_a_factoring_of_ones_own() -> None:
    class Signpost(gymnasium.Env):
        """Two numbers are seen; the action must be their sum."""

        observation_space = gymnasium.spaces.MultiDiscrete([3, 2])
        action_space = gymnasium.spaces.MultiDiscrete([2, 2])

        def reset(self, *, seed=None, options=None):
            super().reset(seed=seed)
            self.seen = self.observation_space.sample()
            return self.seen, {}

        def step(self, action):
            right = int(self.seen.sum()) == int(2 * action[0] + action[1])
            return self.seen, float(right), True, False, {}

    numbers = (Variable("a", range(3)), Variable("b", range(2)))
    bits = (Variable("two", (0, 1)), Variable("one", (0, 1)))
    task = Task("signpost", numbers, bits)
    env = Signpost()
    env.observation_space.seed(3)
    world = Factored(env, task, limit=1, success=lambda e: e.reward > 0)
    learned = learn_values(world, trials=400, learning=ValueLearning(step_size=1.0, epsilon=0.5)).policy
    for s in range(6):
        seen, best = task.input_values(s), task.output_values(int(learned.best()[s]))
        assert seen["a"] + seen["b"] == 2 * best["two"] + best["one"]
    named = Task("parity", (Variable("sum", ("even", "odd")),), (Variable("go", ("x", "y")),))
    own = Factored(
        Signpost(),
        named,
        observe=lambda seen: {"sum": "odd" if seen.sum() % 2 else "even"},
        act=lambda output: np.array([output["go"] == "x", 0]),
        limit=1,
    )
    assert named.input_values(own.start(np.random.default_rng(0)))["sum"] in ("even", "odd")


def test_a_tuple_of_discrete_spaces_factors_by_itself() -> None:
    hand = Task(
        "blackjack",
        (Variable("sum", range(32)), Variable("dealer", range(11)), Variable("ace", ("hard", "soft"))),
        (Variable("draw", ("stick", "hit")),),
    )
    world = Factored(gymnasium.make("Blackjack-v1"), hand, limit=20, success=lambda e: e.reward > 0)
    assert hand.input_values(world.input_of((20, 1, 1))) == {"sum": 20, "dealer": 1, "ace": "soft"}
    learned = learn_values(world, trials=3000, learning=ValueLearning(step_size=0.02, step_power=0.8, epsilon=0.3))
    high = learned.policy.row({"sum": 20, "dealer": 10, "ace": "hard"})
    assert high[0] > high[1]  # on 20, stick
    with pytest.raises(TaskliftError, match="outside of the factoring"):
        world.input_of((40, 1, 1))


def test_losses_and_success_are_what_the_user_says() -> None:
    seen: list[Event] = []

    def loss(event: Event) -> int:
        seen.append(event)
        return 3 if event.reward == -100 else 0

    world = Factored(gymnasium.make("CliffWalking-v1"), CLIFF, loss=loss, limit=50)
    world.start(np.random.default_rng(0))
    answer = world.step(CLIFF.output_index({"move": "right"}))
    assert (answer.lost, answer.reward, answer.ended) == (3, -100, False)
    assert (int(seen[0].before), seen[0].action, int(seen[0].after)) == (36, 1, 36)


class Moody(gymnasium.Env):
    """Says Discrete(4), and then something else."""

    observation_space = gymnasium.spaces.Discrete(4)
    action_space = gymnasium.spaces.Discrete(2)

    def reset(self, *, seed=None, options=None):
        return 0, {}

    def step(self, action):
        return 9, 0.0, False, False, {}


TWO = (Variable("y", (0, 1)),)
FOUR = Task("four", (Variable("x", range(4)),), TWO)


def changed() -> None:
    world = Factored(Moody(), FOUR, limit=5)
    world.env.observation_space = gymnasium.spaces.Discrete(5)
    learn_values(world, trials=1)


@pytest.mark.parametrize(
    ("call", "message"),
    [
        (lambda: Factored(Moody(), FOUR), "no limit of steps; give limit="),
        (lambda: Factored(Moody(), FOUR, limit=0), "at least 1 step"),
        (
            lambda: Factored(Moody(), Task("t", (Variable("x", range(3)),), TWO), limit=5),
            r"Discrete\(4\), which does not split into x \(3\)",
        ),
        (
            lambda: Factored(Moody(), Task("t", FOUR.inputs, (Variable("z", range(3)),)), limit=5),
            "action space .* give act=",
        ),
        (lambda: Factored(Moody(), FOUR, act=lambda o: 7, limit=5), "gives 7, not an action"),
        (
            lambda: learn_values(Factored(Moody(), FOUR, limit=5), trials=1),
            "observation 9 is outside of the factoring",
        ),
        (
            lambda: learn_values(Factored(Moody(), FOUR, observe=lambda o: {"x": o}, limit=5), trials=1),
            "'x' has no value 9",
        ),
        (
            lambda: learn_values(Factored(Moody(), FOUR, observe=lambda o: {"z": o}, limit=5), trials=1),
            "outside of the factoring",
        ),
        (changed, "changed its spaces, from Discrete"),
        (lambda: Factored(Moody(), FOUR, limit=5).model(), "no table of transitions"),
    ],
)
def test_mistakes_are_named(call, message: str) -> None:
    with pytest.raises(TaskliftError, match=message):
        call()


def test_a_policy_of_weights_plays_too() -> None:
    outcomes = evaluate(frozen_lake().model(), Policy.equal(lake_task(4)), trials=200)
    assert 0 <= outcomes.success.mean() < 0.2


# -- does transfer pay: the simple version of three environments first ----------------------------------------

Q = ValueLearning("q-learning", step_size=0.1, epsilon=0.1)


@pytest.mark.parametrize(
    ("name", "options", "switch", "task", "loss", "trials"),
    [
        ("Taxi-v4", {}, {"is_rainy": True}, TAXI, lambda e: e.reward == -10, 400),
        ("CliffWalking-v1", {"max_episode_steps": 200}, {"is_slippery": True}, CLIFF, lambda e: e.reward == -100, 300),
    ],
)
@pytest.mark.parametrize("seeds", [16, pytest.param(100, marks=pytest.mark.slow)])
def test_the_switch_of_an_environment_is_a_simpler_task(name, options, switch, task, loss, trials, seeds) -> None:
    plain, full = (Factored(gymnasium.make(name, **options, **more), task, loss=loss).model() for more in ({}, switch))
    stages = [Stage("simple", task, plain, Q, trials=trials), Stage("full", task, full, Q, trials=trials)]
    told = compare(Curriculum(stages), seeds=seeds)
    assert told.finding("jumpstart (return, first 10 trials)").verdict == "helps"
    assert told.finding("losses, target only").verdict == "helps"
    assert told.finding("losses, all stages, equal total budget").verdict == "helps"
    assert told.ledger["simple"] > 0
