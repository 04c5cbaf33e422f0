"""Gymnasium environments as factored tasks, and external checks: published or exact numbers, cited."""

from __future__ import annotations

import numpy as np
import pytest

from tasklift.envs.gymnasium import Event, Factored
from tasklift.envs.spaces import Bins
from tasklift.errors import TaskliftError
from tasklift.learning.compare import compare
from tasklift.learning.curriculum import Curriculum
from tasklift.learning.learner import Run
from tasklift.learning.reinforcement import Fixed, Reinforcement
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
            assert list(answer[1:5]) in [rest for after, *rest in told if answer.ended or after == answer.input]
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
    world = Factored(gymnasium.make("Taxi-v4"), TAXI, loss=lambda e: e.reward == -10, mask=None)
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
        (lambda: Factored(Moody(), FOUR, limit=0), "limit: expected a whole number of at least 1, found 0"),
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
    def model(**more):
        return Factored(gymnasium.make(name, **options, **more), task, loss=loss, mask=None).model()

    plain, full = model(), model(**switch)
    stages = [Stage("simple", task, plain, Q, trials=trials), Stage("full", task, full, Q, trials=trials)]
    told = compare(Curriculum(stages), seeds=seeds)
    assert told.finding("jumpstart (return, first 10 trials)").verdict == "helps"
    assert told.finding("losses, target only").verdict == "helps"
    assert told.finding("losses, all stages, equal total budget").verdict == "helps"
    assert told.ledger["simple"] > 0


# -- what environments do ----------------------------------------------------------------------------------------


class Scripted(gymnasium.Env):
    """Shows, pays and ends as the test says; ``t`` counts steps."""

    def __init__(self, see, do, *, shows=lambda t: 0, pays=lambda t, a: 0.0, ends=None, cuts=None, says=lambda t: {}):
        self.observation_space, self.action_space, self.t, self.does = see, do, 0, []
        self.shows, self.pays, self.ends, self.cuts, self.says = shows, pays, ends, cuts, says

    def reset(self, *, seed=None, options=None):
        super().reset(seed=seed)
        self.t, self.does = 0, []
        return self.shows(0), self.says(0)

    def step(self, action):
        self.t += 1
        self.does.append(action)
        ended, cut = self.t == self.ends, self.t == self.cuts
        return self.shows(self.t), self.pays(self.t, action), ended, cut, self.says(self.t)


def small(inputs=1, outputs=1, **options) -> Task:
    return Task("small", (Variable("see", range(inputs)),), (Variable("do", range(outputs)),), **options)


DISCRETE = gymnasium.spaces.Discrete


@pytest.mark.parametrize(("how", "value"), [({"ends": 5}, 4.0951), ({"cuts": 5}, 10.0)])
def test_termination_ends_and_truncation_bootstraps(how: dict[str, int], value: float) -> None:
    # rewards of 1, gamma 0.9: 1 + 0.9 + … + 0.9^4 = 4.0951 for five steps; 1 / (1 - 0.9) = 10 where it would go on
    see = DISCRETE(5 if "ends" in how else 1)
    env = Scripted(see, DISCRETE(1), shows=lambda t: min(t, 4) if "ends" in how else 0, pays=lambda t, a: 1.0, **how)
    world = Factored(env, small(int(see.n)), limit=50)
    learned = learn_values(world, trials=400, learning=ValueLearning(step_size=0.5, discount=0.9))
    assert set(learned.outcomes.steps.tolist()) == {5}
    assert learned.policy.weights[0, 0] == pytest.approx(value, abs=1e-6)


def test_survival_is_success_where_every_step_pays() -> None:
    def success(**options) -> bool:
        world = Factored(Scripted(DISCRETE(1), DISCRETE(1), **options), small(), limit=9)
        return bool(evaluate(world, Policy.equal(small()), trials=1).success[0])

    assert success(pays=lambda t, a: 1.0, cuts=9)
    assert success(pays=lambda t, a: 1.0)
    assert not success(pays=lambda t, a: 1.0, ends=4)
    assert success(pays=lambda t, a: float(t == 4), ends=4)
    assert not success(cuts=9)


def test_an_event_says_all_there_is_to_know_and_nothing_changes_under_it() -> None:
    shared, events = np.zeros(1, np.int64), []

    def shows(t):
        shared[0] = t % 2
        return shared

    see = gymnasium.spaces.MultiDiscrete([2])
    env = Scripted(see, gymnasium.spaces.MultiDiscrete([2]), shows=shows, says=lambda t: {"cost": t}, ends=6)
    kept: list[int] = []

    def loss(event: Event) -> int:
        events.append(event)
        event.action[0] += 7  # as an environment might
        kept.append(event.info["cost"])
        return event.info["cost"]

    world = Factored(env, small(2, 2), loss=loss, limit=9)
    outcomes = evaluate(world, Policy.equal(small(2, 2)), trials=2)
    assert outcomes.losses.tolist() == [21, 21]
    assert [(int(e.before[0]), int(e.after[0]), e.input) for e in events[:2]] == [(0, 1, 1), (1, 0, 0)]
    assert [list(a) for a in world.actions] == [[0], [1]]


def test_what_comes_with_the_end_is_not_looked_up() -> None:
    for last in (None, -1, 99, np.nan, "gone"):
        env = Scripted(DISCRETE(2), DISCRETE(1), shows=lambda t, last=last: 0 if t < 3 else last, ends=3)
        assert learn_values(Factored(env, small(2), limit=9), trials=2).outcomes.steps.tolist() == [3, 3]


@pytest.mark.parametrize("bad", [float("nan"), float("inf"), None])
def test_a_reward_that_is_no_number_is_refused_where_it_comes(bad) -> None:
    env = Scripted(DISCRETE(1), DISCRETE(1), pays=lambda t, a: bad if t == 3 else 1.0, ends=5)
    with pytest.raises(TaskliftError, match=r"episode \(trial\) 1, step 3: the reward is"):
        learn_values(Factored(env, small(), limit=9), trials=100)


@pytest.mark.parametrize("bad", [0.5, -1, float("nan"), "one", None])
def test_a_loss_that_is_no_count_is_refused_where_it_comes(bad) -> None:
    world = Factored(Scripted(DISCRETE(1), DISCRETE(1)), small(), loss=lambda e: bad, limit=9)
    with pytest.raises(TaskliftError, match=r"step 1: the loss is .*expected a whole number of at least 0"):
        learn_values(world, trials=1)


def gives(**answers) -> Factored:
    """Return a world whose ``reset`` or ``step`` returns the given answer."""
    env = Scripted(DISCRETE(1), DISCRETE(1))
    for call, answer in answers.items():
        setattr(env, call, lambda *a, answer=answer, **k: answer)
    return Factored(env, small(), limit=9)


@pytest.mark.parametrize(
    ("call", "says"),
    [
        (lambda: gives(reset=0), r"reset\(\) gave 0; expected \(observation, info\)"),
        (lambda: gives(reset=(0, None)), r"reset\(\) gave \(0, None\)"),
        (lambda: gives(step=(0, 1.0, False, {})), r"step\(\) gave .*expected \(observation, reward, terminated"),
        (lambda: gives(step=(0, 1.0, False, False, None)), r"step\(\) gave"),
        (lambda: gives(step=(0, 1.0, np.zeros(2), False, {})), r"step\(\) gave"),
        (lambda: gives(step=(0, "1.0", False, False, {})), "the reward is '1.0'"),
        (lambda: gives(step=(0, np.zeros(1), False, False, {})), r"the reward is array"),
        (lambda: Factored("CartPole-v1", small()), "expected one Gymnasium environment, found 'CartPole-v1'"),
        (lambda: Factored(gymnasium.make_vec("FrozenLake-v1", num_envs=2), small()), "expected one Gymnasium"),
        (lambda: Factored(Moody(), FOUR, limit=5, loss=3), "loss: expected a function, found 3"),
        (lambda: Factored(Moody(), FOUR, limit=5, observe="x"), "observe: expected a function"),
        (lambda: Factored(Moody(), FOUR, limit=5, mask=["action_mask"]), "mask: expected the name"),
        (lambda: Factored(Moody(), FOUR, limit=5, success=lambda e: np.zeros(2), observe=lambda o: {"x": 0}),
         "the success is array"),
    ],
)  # fmt: skip
def test_what_is_no_environment_of_todays_is_named(call, says: str) -> None:
    with pytest.raises(TaskliftError, match=says):
        learn_values(call(), trials=1)


def test_what_is_no_world_or_policy_is_named() -> None:
    env, policy = gymnasium.make("FrozenLake-v1"), Policy.equal(lake_task(4))
    for call in (
        lambda: learn_values(env, trials=1),
        lambda: evaluate(env, policy),
        lambda: Curriculum([Stage("only", lake_task(4), env, ValueLearning(), trials=1)]).check(),
    ):
        with pytest.raises(TaskliftError, match=r"expected a world, found .*envs\.gymnasium\.Factored"):
            call()
    with pytest.raises(TaskliftError, match="expected a Policy, found"):
        evaluate(frozen_lake(), policy.weights)
    with pytest.raises(TaskliftError, match="learning: expected a ValueLearning, found 'sarsa'"):
        learn_values(frozen_lake(), trials=1, learning="sarsa")
    with pytest.raises(TaskliftError, match="epsilon: expected a number from 0 up to 1"):
        evaluate(frozen_lake(), policy, epsilon=2)


def test_steps_out_of_turn_and_outputs_out_of_range() -> None:
    world = Factored(Scripted(DISCRETE(1), DISCRETE(2), ends=1), small(1, 2), limit=9)
    with pytest.raises(TaskliftError, match="after the end"):
        world.step(0)
    world.start(np.random.default_rng(0))
    for output in (-1, 2, 0.5):
        with pytest.raises(TaskliftError, match="expected an output from 0 to 1"):
            world.step(output)
    assert world.step(1).ended
    with pytest.raises(TaskliftError, match="after the end"):
        world.step(0)


def test_masks_are_obeyed_from_the_task_and_from_the_environment() -> None:
    task = small(1, 3, impossible=({"do": 2},))
    env = Scripted(DISCRETE(1), DISCRETE(3), says=lambda t: {"action_mask": np.array([t % 2, 1, 1], np.int8)})
    for rule in ("q-learning", "sarsa", "expected-sarsa"):
        for temperature in (0.0, 1.0):
            done: list[tuple[int, int]] = []
            env.pays = lambda t, a, done=done: done.append((t, a)) or 1.0
            learner = ValueLearning(rule, epsilon=0.5, temperature=temperature)
            curve = learn_values(Factored(env, task, limit=10), trials=20, learning=learner)
            evaluate(Factored(env, task, limit=10), curve.policy, trials=5, epsilon=0.5)
            assert {a for _, a in done} == {0, 1}
            assert all(a == 1 for t, a in done if t % 2)
            assert np.isfinite(curve.policy.weights).all()
    env.says = lambda t: {"action_mask": [0, 0, 0]}
    with pytest.raises(TaskliftError, match="at least one action"):
        learn_values(Factored(env, task, limit=10), trials=1)
    shut = small(1, 2, impossible=({"do": 0}, {"do": 1}))
    for call in (learn_values, lambda world, trials: evaluate(world, Policy.equal(shut), trials=trials)):
        with pytest.raises(TaskliftError, match="all outputs are impossible at"):
            call(Factored(Scripted(DISCRETE(1), DISCRETE(2)), shut, limit=5), trials=1)


SPACES = gymnasium.spaces
NESTED = SPACES.Tuple((SPACES.Discrete(2, start=3), SPACES.Dict(b=SPACES.MultiBinary(2), a=SPACES.Discrete(3))))
OFFSET = SPACES.MultiDiscrete([2, 3], start=[5, -1])


@pytest.mark.parametrize(("space", "sizes"), [(NESTED, (2, 2, 2, 3)), (OFFSET, (2, 3)), (SPACES.MultiBinary(2), (2, 2)),
                                              (SPACES.Discrete(6, start=-2), (2, 3))])  # fmt: skip
def test_discrete_spaces_of_any_shape_split_both_ways(space, sizes) -> None:
    parts = tuple(Variable(f"v{i}", range(n)) for i, n in enumerate(sizes))
    task = Task("split", parts, tuple(Variable(f"w{i}", range(n)) for i, n in enumerate(sizes)))
    world = Factored(Scripted(space, space), task, limit=5)
    assert [world.input_of(action) for action in world.actions] == list(range(task.shape[0]))
    assert all(space.contains(action) for action in world.actions)


@pytest.mark.parametrize("space", [SPACES.Box(0, 1, (2,)), SPACES.Tuple((DISCRETE(2), SPACES.Box(0, 1))),
                                   SPACES.Sequence(DISCRETE(2))])  # fmt: skip
def test_spaces_that_do_not_split_are_refused_at_declaration(space) -> None:
    with pytest.raises(TaskliftError, match=r"does not split .* give observe="):
        Factored(Scripted(space, DISCRETE(1)), small(2), limit=5)


def test_continuous_observations_come_in_bins() -> None:
    bins = Bins.evenly(SPACES.Box(np.array([-1, 0, 0]), np.array([1, 8, 1]), dtype=float), x=4, y=2, z=None)
    task = Task("box", bins.inputs, (Variable("do", range(2)),))
    env = Scripted(SPACES.Box(-1, 8, (3,)), DISCRETE(2), shows=lambda t: np.array([-1 + 0.5 * t, 4.0, 7]), ends=9)
    world = Factored(env, task, observe=bins, limit=3)
    rows = [world.start(np.random.default_rng(0)), *(world.step(0).input for _ in range(3))]
    assert [task.input_values(row) for row in rows] == [{"x": x, "y": 1} for x in range(4)]
    assert task.inputs[0].labels[1] == "-0.5 to 0"
    for bad in ([1.0], [np.nan, 0, 0]):
        with pytest.raises(TaskliftError, match="expected 3 numbers"):
            bins(bad)
    for make in (lambda: Bins(x=(1.0, 0.0)), lambda: Bins(x=None), lambda: Bins.evenly(DISCRETE(2), x=2),
                 lambda: Bins.evenly(SPACES.Box(-np.inf, np.inf, (1,)), x=4)):  # fmt: skip
        with pytest.raises(TaskliftError, match="bins"):
            make()


class Liar(gymnasium.Env):
    """Its table says that 0 leads to 1; it goes there with probability ``p`` only."""

    observation_space, action_space = DISCRETE(2), DISCRETE(1)
    initial_state_distrib = np.array([1.0, 0.0])

    def __init__(self, told: float, done: float) -> None:
        self.P = {s: {0: [(told, 1, 0.0, False), (1 - told, 0, 0.0, False)]} for s in range(2)}
        self.done = done

    def reset(self, *, seed=None, options=None):
        super().reset(seed=seed)
        return 0, {}

    def step(self, action):
        return int(self.np_random.random() < self.done), 0.0, False, False, {}


class Round(gymnasium.Env):
    """Four places in a ring, with a table of transitions. Every step pays."""

    observation_space, action_space = DISCRETE(4), DISCRETE(2)
    initial_state_distrib = np.eye(4)[0]
    P = {s: {a: [(1.0, (s + a) % 4, 1.0, False)] for a in (0, 1)} for s in range(4)}  # noqa: RUF012

    def reset(self, *, seed=None, options=None):
        self.place = 0
        return 0, {}

    def step(self, action):
        self.place = (self.place + action) % 4
        return self.place, 1.0, False, False, {}


@pytest.mark.parametrize(
    ("success", "share"), [(None, 1), (lambda e: e.truncated, 1), (lambda e: e.truncated and int(e.after) == 2, None)]
)
def test_a_model_succeeds_at_its_limit_as_the_environment_does(success, share) -> None:
    world = Factored(Round(), small(4, 2), success=success, limit=7)
    policy = Policy(small(4, 2), np.random.default_rng(0).random((4, 2)))
    played = [
        Fixed(Reinforcement()).learn(where, policy, Run(trials=300)).outcomes.success.mean()
        for where in (world, world.model())
    ]
    assert played[0] == pytest.approx(played[1], abs=0.15)  # five standard errors
    assert played[0] == share or (share is None and 0 < played[0] < 1)


def test_a_model_is_the_environment_or_is_refused() -> None:
    Factored(Liar(0.5, 0.5), small(2), limit=50).model()
    with pytest.raises(TaskliftError, match="other probabilities"):
        Factored(Liar(0.5, 0.7), small(2), limit=50).model()
    with pytest.raises(TaskliftError, match="does not know"):
        Factored(Liar(1.0, 0.5), small(2), limit=50).model()
    sticky = gymnasium.wrappers.TransformReward(gymnasium.make("FrozenLake-v1"), lambda r: 2 * r)
    with pytest.raises(TaskliftError, match="the wrapper TransformReward"):
        Factored(sticky, lake_task(4)).model()
    masked = Factored(gymnasium.make("Taxi-v4"), TAXI)
    with pytest.raises(TaskliftError, match=r"which actions are possible.*mask=None"):
        masked.model()
    fickle = gymnasium.make("Taxi-v4", fickle_passenger=True, fickle_probability=1.0)
    with pytest.raises(TaskliftError, match=r"fickle_passenger = True.*learn step by step"):
        Factored(fickle, TAXI).model()
    with pytest.raises(TaskliftError, match="reads 'cost' of info"):
        Factored(gymnasium.make("FrozenLake-v1"), lake_task(4), loss=lambda e: e.info["cost"]).model()
