"""Learners by value: compiled and plain code agree, learning goes on where it stopped, exact answers hold."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from tasklift.errors import TaskliftError
from tasklift.learning.curriculum import Curriculum
from tasklift.learning.learner import InTurn, Run
from tasklift.learning.model import Model
from tasklift.learning.reinforcement import Reinforcement, StepTrials, Sweep, reinforce, sweep
from tasklift.learning.stage import Stage
from tasklift.learning.values import ValueLearning, evaluate, learn_values
from tasklift.learning.worlds import Step
from tasklift.tasks import choice as rules
from tasklift.tasks.policy import Policy, swap
from tasklift.tasks.task import Signal, Task, Variable

PROPERTY = settings(deadline=None, derandomize=True, max_examples=40)


def random_model(seed: int, states: int = 6, outputs: int = 3, branches: int = 3, limit: int = 40) -> Model:
    """A random world, some of whose states look the same."""
    rng = np.random.default_rng(seed)
    inputs = int(rng.integers(2, states + 1))
    task = Task("random", (Variable("x", range(inputs)),), (Variable("y", range(outputs)),))
    shape = (states, outputs, branches)
    probability = rng.random(shape) * (rng.random(shape) < 0.7)
    probability[..., 0] += 0.1
    probability /= probability.sum(axis=2, keepdims=True)
    start = rng.random(states)
    return Model(
        task=task,
        rows=rng.integers(0, inputs, states),
        start_probability=start / start.sum(),
        probability=probability,
        after=rng.integers(0, states, shape),
        reward=rng.normal(size=shape),
        ended=rng.random(shape) < 0.1,
        lost=rng.integers(0, 2, shape),
        success=rng.random(shape) < 0.5,
        limit=limit,
    )


class OneByOne:
    """A model behind the protocol of steps only, so that nothing is compiled."""

    def __init__(self, model: Model) -> None:
        self.model, self.task, self.limit = model, model.task, model.limit

    def start(self, rng: np.random.Generator) -> int:
        return self.model.start(rng)

    def step(self, output: int) -> Step:
        return self.model.step(output)


SETTINGS = st.builds(
    ValueLearning,
    rule=st.sampled_from(["q-learning", "sarsa", "expected-sarsa"]),
    step_size=st.sampled_from([0.05, 0.5]),
    step_power=st.sampled_from([0.0, 0.7]),
    discount=st.sampled_from([0.5, 0.99]),
    epsilon=st.sampled_from([0.0, 0.2]),
    epsilon_decay=st.sampled_from([1.0, 0.9]),
    temperature=st.sampled_from([0.0, 0.5]),
    initial_value=st.sampled_from([0.0, 2.0]),
)


@PROPERTY
@given(st.integers(0, 10_000), SETTINGS)
def test_compiled_and_plain_learning_agree(seed: int, learning: ValueLearning) -> None:
    model = random_model(seed)
    fast = learn_values(model, trials=8, seed=seed, learning=learning)
    slow = learn_values(OneByOne(model), trials=8, seed=seed, learning=learning)
    for field in ("steps", "success", "losses"):
        assert np.array_equal(getattr(fast.outcomes, field), getattr(slow.outcomes, field))
    assert np.allclose(fast.outcomes.returns, slow.outcomes.returns, rtol=1e-10)
    assert np.allclose(fast.policy.weights, slow.policy.weights, rtol=1e-10, atol=1e-12)
    assert np.array_equal(fast.policy.carried["visits"], slow.policy.carried["visits"])


@PROPERTY
@given(st.integers(0, 10_000), SETTINGS)
def test_learning_goes_on_exactly_where_it_stopped(seed: int, learning: ValueLearning) -> None:
    model = random_model(seed)
    whole = learn_values(model, trials=12, seed=seed, learning=learning)
    first = learn_values(model, trials=5, seed=seed, learning=learning)
    rest = learn_values(model, first.policy, trials=7, first_trial=5, seed=seed, learning=learning)
    assert np.array_equal(rest.policy.weights, whole.policy.weights)
    assert rest.policy.carried["epsilon"] == whole.policy.carried["epsilon"]
    assert np.array_equal(rest.policy.carried["visits"], whole.policy.carried["visits"])


def test_what_a_learner_carries_is_saved_and_extended(tmp_path: Path) -> None:
    task = Task("t", (Variable("x", (0, 1)), Variable("z", (0, 1))), (Variable("y", (0, 1)),))
    simple = task.simplify(fix={"z": 0})
    model = random_model(1, states=2, outputs=2)
    model = replace(model, task=simple, rows=np.array([0, 1]))
    learning = ValueLearning(epsilon=0.5, epsilon_decay=0.9)
    learned = learn_values(model, trials=10, learning=learning).policy
    learned.save(tmp_path / "values.json")
    wide = Policy.load(tmp_path / "values.json").extend(task)
    assert wide.kind == "value"
    assert wide.carried["epsilon"] == pytest.approx(0.5 * 0.9**10)
    assert wide.carried["visits"].sum() == 2 * learned.carried["visits"].sum()
    # a copied pair is as settled as it was: with step sizes by visits, one more visit moves it as little
    row = task.input_index({"x": 0, "z": 1})
    assert np.array_equal(wide.carried["visits"][row], learned.carried["visits"][0])


@PROPERTY
@given(st.lists(st.floats(-50, 50), min_size=1, max_size=6), st.floats(0, 1), st.sampled_from([0.0, 0.1, 3.0]))
def test_chances_are_a_distribution(values: list[float], epsilon: float, temperature: float) -> None:
    row, out = np.array(values), np.empty(len(values))
    rules.probabilities(row, epsilon, temperature, out)
    assert out.sum() == pytest.approx(1)
    assert (out >= epsilon / len(row) - 1e-12).all()
    order = np.argsort(row)
    assert (np.diff(out[order]) >= -1e-12).all()
    if temperature == 0:
        expected = (1 - epsilon) * (row == row.max()) / (row == row.max()).sum() + epsilon / len(row)
        assert out == pytest.approx(expected)


def test_step_sizes_by_visits_average() -> None:
    # one state, one output, a random reward and an end: with power 1 the value is the mean of what was seen
    task = Task("bandit", (), (Variable("y", (0,)),))
    shape = (1, 1, 2)
    model = Model(
        task,
        np.array([0]),
        np.array([1.0]),
        np.full(shape, 0.5),
        np.zeros(shape, dtype=np.int64),
        np.array([[[0.0, 1.0]]]),
        np.ones(shape, dtype=bool),
        np.zeros(shape, dtype=np.int64),
        np.ones(shape, dtype=bool),
        5,
    )
    curve = learn_values(model, trials=50, learning=ValueLearning(step_size=0.001, step_power=1.0))
    assert curve.policy.weights[0, 0] == pytest.approx(curve.outcomes.returns.mean())


@PROPERTY
@given(st.integers(0, 10_000))
def test_exact_values_agree_with_many_trials(seed: int) -> None:
    model = random_model(seed, limit=15)
    policy = Policy(model.task, np.random.default_rng(seed).normal(size=model.task.shape), kind="value")
    chances = np.zeros(model.task.shape)
    chances[np.arange(len(chances)), policy.best()] = 1
    exact = model.evaluate(chances, steps=15)
    returns = evaluate(model, policy, trials=600, seed=seed).returns
    # five standard errors: below one false alarm in 10^6 per case
    assert abs(returns.mean() - exact) < 5 * returns.std() / np.sqrt(600) + 1e-9
    assert exact <= model.optimum(steps=15) + 1e-9


@pytest.mark.parametrize(("rule", "epsilon"), [("q-learning", 0.5), ("sarsa", 0.5), ("expected-sarsa", 0.5)])
def test_learners_settle_on_the_exact_values(rule: str, epsilon: float) -> None:
    # Q-learning learns the best policy's values, the other two those of the best policy that explores as they do
    model = random_model(17, limit=200)
    task = Task("seen", (Variable("x", range(6)),), model.task.outputs)
    model = replace(model, task=task, rows=np.arange(6))
    learning = ValueLearning(rule, step_size=1e-4, step_power=0.75, discount=0.8, epsilon=epsilon)
    learned = learn_values(model, trials=25_000, seed=1, learning=learning).policy
    exact = model.action_values(discount=0.8, epsilon=0.0 if rule == "q-learning" else epsilon)
    other = model.action_values(discount=0.8, epsilon=epsilon if rule == "q-learning" else 0.0)
    assert np.abs(learned.weights - exact).mean() < 0.05
    assert np.abs(learned.weights - exact).mean() < 0.3 * np.abs(learned.weights - other).mean()


# -- reinforcement of weights, on any world ------------------------------------------------------------------


class Gate:
    """Walk three places; the gate before the last is open or shut, and hurts who enters it shut."""

    task = Task(
        "gate",
        (Variable("place", (0, 1, 2)), Variable("shut", (0, 1))),
        (Variable("go", (0, 1)),),
        signals=(Signal(-0.1, {"go": 0, "shut": 0}), Signal(0.1, {"go": 0, "shut": 1})),
        time_reward=0.1,
    )
    limit = 30

    def __init__(self, hazard: bool = True) -> None:
        self.hazard = hazard

    def _seen(self) -> int:
        self.shut = int(self.hazard and self.rng.random() < 0.5)
        return self.task.input_index({"place": min(self.place, 2), "shut": self.shut})

    def start(self, rng: np.random.Generator) -> int:
        self.rng, self.place = rng, 0
        return self._seen()

    def step(self, output: int) -> Step:
        lost = output == 1 and self.shut == 1 and self.place == 2
        self.place = 0 if lost else self.place + output
        done = self.place == 3
        return Step(self._seen(), -1.0, done, int(lost), done)


def test_the_papers_method_on_a_world_met_step_by_step() -> None:
    safe = Gate.task.simplify(fix={"shut": 0}, time_reward=0.2)
    v = sweep(StepTrials(Gate(hazard=False)), safe, repeats=3)
    # staying fails (no time reward) and is punished, going takes 3 of 30 steps
    expected = np.tile([1.5 - 3 * 0.1, 1.5 + 3 * 0.2 * (1 - 3 / 30)], (3, 1))
    assert v.weights == pytest.approx(expected)
    t = v.extend(Gate.task, [swap("go", when={"shut": 1})])
    world = StepTrials(Gate())
    lifted = reinforce(world, t, trials=60, seed=1).outcomes
    scratch = reinforce(world, Policy.equal(Gate.task), trials=60, seed=1).outcomes
    assert lifted.losses.sum() < scratch.losses.sum()
    capped = reinforce(world, Policy.equal(Gate.task), trials=200, seed=1, max_losses=3).outcomes
    assert capped.losses[:-1].sum() < 3 <= capped.losses.sum()


@pytest.mark.parametrize("credit", ["decision", "trial"])
@pytest.mark.parametrize("time_signal", ["inverted", "baseline", "none"])
def test_the_signals_of_one_trial_by_hand(credit: str, time_signal: str) -> None:
    # always go: three steps with the gate open, and no chance in it
    task = Gate.task.simplify(fix={"shut": 0}, signals=[Signal(0.3, {"go": 1, "place": 0})], time_reward=0.2)
    start = Policy(task, np.tile([0.0, 1.0], (3, 1)))
    settings = Reinforcement(credit=credit, time_signal=time_signal, initial_weight=1)
    learned = reinforce(StepTrials(Gate(False)), start, trials=2, reinforcement=settings).policy.weights
    each = {"inverted": 0.2 * (1 - 3 / 30), "baseline": 0.0, "none": 0.0}[time_signal]
    assert learned[:, 0].tolist() == [0, 0, 0]
    assert learned[:, 1] == pytest.approx([1 + 2 * each + 2 * 0.3, 1 + 2 * each, 1 + 2 * each])


def test_the_loss_signal_reaches_the_pair_that_lost() -> None:
    start = Policy(Gate.task, np.tile([0.0, 10.0], (6, 1)))
    settings = Reinforcement(loss_signal=-0.5, time_signal="none")
    curve = reinforce(StepTrials(Gate()), start, trials=5, seed=3, reinforcement=settings)
    guilty = Gate.task.input_index({"place": 2, "shut": 1})
    assert curve.outcomes.losses.sum() > 0
    assert curve.policy.weights[guilty, 1] == pytest.approx(10 - 0.5 * curve.outcomes.losses.sum())
    assert (curve.policy.weights[[0, 1, 2, 3, 4], 1] == 10).all()


def test_a_world_outside_of_the_task_is_refused() -> None:
    safe = Gate.task.simplify(fix={"shut": 0})
    with pytest.raises(TaskliftError, match=r"'shut': 1}, which is outside of the task \"gate'\""):
        learn_values(Gate(), task=safe, trials=20)
    with pytest.raises(TaskliftError, match="outside of the task"):
        sweep(StepTrials(Gate()), safe)
    model = random_model(3)
    with pytest.raises(TaskliftError, match="outside of the task"):
        learn_values(model, task=model.task.simplify(restrict={"x": [0]}), trials=50)
    with pytest.raises(TaskliftError, match="input 'place' of 'gate' is not in 'random'"):
        learn_values(model, task=Gate.task, trials=5)


@pytest.mark.parametrize(
    ("call", "message"),
    [
        (lambda m: ValueLearning(rule="dqn"), "rule: expected q-learning"),
        (lambda m: ValueLearning(step_size=0), "step_size: expected 0.0 to 1.0, found 0"),
        (lambda m: ValueLearning(discount=1.5), "discount: expected 0.0 to 1.0"),
        (lambda m: ValueLearning(epsilon=-0.1), "epsilon: expected 0.0 to 1.0"),
        (lambda m: ValueLearning(temperature=float("nan")), "temperature: expected finite"),
        (lambda m: learn_values(m), "has no budget"),
        (
            lambda m: learn_values(m, trials=5, max_losses=0),
            "max_losses: expected a whole number of at least 1",
        ),
        (lambda m: learn_values(m, Policy.equal(m.task), trials=5), "policy of values, found one of weights"),
        (lambda m: replace(m, start_probability=m.start_probability / 2), "do not sum to one"),
        (lambda m: replace(m, after=m.after + 10), "leads to a state"),
        (lambda m: replace(m, rows=m.rows + 10), "input outside"),
        (lambda m: replace(m, reward=m.reward[:, :1]), "expected arrays of shape"),
        (lambda m: random_model(0, states=9).best_policy(discount=0.9), "look the same"),
    ],
)
def test_mistakes_are_named(call, message: str) -> None:
    with pytest.raises(TaskliftError, match=message):
        call(random_model(0))


class Ring:
    """Places in a ring; going round gives 1, the last place is a loss."""

    task = Task("ring", (Variable("place", range(4)),), (Variable("go", ("on", "stay")),))
    limit = 8
    breaks, error = None, RuntimeError("the simulator fell over")
    begun = 0

    def start(self, rng):
        self.place, self.begun = 0, self.begun + 1
        return 0

    def step(self, output):
        if self.begun == self.breaks:
            raise self.error
        self.place = (self.place + (output == 0)) % 4
        return Step(self.place, 1.0, ended=False, lost=int(self.place == 3))


def test_a_penalty_per_loss_teaches_to_stay() -> None:
    for penalty, best in ((0.0, None), (10.0, 1)):
        learner = ValueLearning(epsilon=0.3, loss_penalty=penalty, discount=0.5)
        learned = learn_values(Ring(), trials=200, learning=learner)
        assert learned.outcomes.returns.tolist() == [8.0] * 200
        if best is not None:
            assert learned.policy.best()[2] == best
    with pytest.raises(TaskliftError, match="loss_penalty"):
        ValueLearning(loss_penalty=-1.0)


def test_a_callback_sees_each_trial_and_stops_early() -> None:
    told = []

    def callback(episode) -> bool:
        told.append(episode)
        return episode.trial == 6

    curve = learn_values(Ring(), trials=50, callback=callback)
    assert len(learn_values(Ring(), trials=50, callback=lambda e: np.bool_(e.trial == 3)).outcomes) == 4
    assert len(curve.outcomes) == len(told) == 7
    assert [e.steps for e in told] == curve.outcomes.steps.tolist()
    assert np.array_equal(curve.policy.weights, learn_values(Ring(), trials=7).policy.weights)
    with pytest.raises(ValueError, match="read-only"):
        told[0].values[0, 0] = 1.0
    with pytest.raises(TaskliftError, match="callback: expected a function"):
        learn_values(Ring(), trials=1, callback="checkpoint")


@pytest.mark.parametrize("error", [RuntimeError("fell over"), KeyboardInterrupt("fell over")])
@pytest.mark.parametrize(
    ("learner", "budget"),
    [
        (ValueLearning(), {"trials": 50}),
        (Reinforcement(loss_signal=-0.1), {"trials": 50}),
        (Reinforcement(loss_signal=-0.1), {"steps": 400}),
        (InTurn((ValueLearning(), ValueLearning(epsilon=0.5)), (0, 2)), {"trials": 50}),
    ],
)
def test_what_was_learned_before_a_crash_is_kept(learner, budget, error) -> None:
    world = Ring()
    world.breaks, world.error = 6, error
    with pytest.raises(type(error), match="fell over") as crash:
        learner.learn(world, learner.start(Ring.task), Run(**budget))
    whole = learner.learn(Ring(), learner.start(Ring.task), Run(trials=5))
    kept = crash.value.curve
    assert np.array_equal(kept.policy.weights, whole.policy.weights)
    assert np.array_equal(kept.outcomes.losses, whole.outcomes.losses[-len(kept.outcomes) :])


def test_what_a_curriculum_learned_before_a_crash_is_kept() -> None:
    world = Ring()
    world.breaks = 66
    stages = [Stage(name, Ring.task, world, ValueLearning(), trials=40) for name in ("first", "second")]
    with pytest.raises(RuntimeError) as crash:
        Curriculum(stages).run()
    whole = [replace(stage, world=Ring(), trials=trials) for stage, trials in zip(stages, (40, 25), strict=True)]
    assert np.array_equal(crash.value.curve.policy.weights, Curriculum(whole).run().policy.weights)


def test_an_output_that_was_left_out_has_no_visits() -> None:
    full = Task("full", (Variable("here", (0,)),), (Variable("move", range(3)),))
    simple = full.simplify(restrict={"move": (0, 1)})
    learner = ValueLearning()
    policy = learner.start(simple)
    policy = replace(policy, carried={"visits": np.array([[3.0, 5.0]]), "epsilon": 0.1})
    assert policy.extend(full).carried["visits"].tolist() == [[3.0, 5.0, 0.0]]


def free(model: Model) -> Model:
    return replace(model, reward=np.zeros_like(model.reward))


@pytest.mark.parametrize(("world", "learner"), [
    (Ring(), Reinforcement()), (Ring(), Sweep()), (free(random_model(0)), ValueLearning()),
])  # fmt: skip
def test_a_stage_in_which_nothing_can_be_learned_is_refused(world, learner) -> None:
    trials = None if isinstance(learner, Sweep) else 20
    with pytest.raises(TaskliftError, match="stage 'only': nothing can be learned"):
        Curriculum([Stage("only", world.task, world, learner, trials=trials)]).check()


@pytest.mark.parametrize("learner", [{}, {"learner": None}, {"learner": "q"}, {"learner": ValueLearning}])
def test_a_stage_without_a_learner_says_which_there_are(learner) -> None:
    stage = Stage("only", Ring().task, Ring(), trials=20, **learner)
    with pytest.raises(TaskliftError, match=r"stage 'only': expected a learner.*ValueLearning\(\) learns from"):
        Curriculum([stage]).run()


@pytest.mark.parametrize(("world", "learner"), [
    (Ring(), Reinforcement(loss_signal=-1.0)), (free(random_model(0)), ValueLearning(loss_penalty=1.0)),
    (free(random_model(0)), ValueLearning(initial_value=1.0)),
])  # fmt: skip
def test_a_stage_in_which_losses_teach_is_not_refused(world, learner) -> None:
    Curriculum([Stage("only", world.task, world, learner, trials=20)]).check()
