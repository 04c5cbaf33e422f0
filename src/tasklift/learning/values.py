"""Learning by value: Q-learning, SARSA and Expected SARSA, on the same policies as reinforcement of weights.

The paper's method "does not apply only to a specific learning algorithm" (section III). Here a policy keeps
estimates of return (``kind="value"``), and carries what the learner needs to go on: how often each pair was
visited, and how much it still explores.

Source of the learners: Sutton & Barto, Reinforcement Learning (2nd ed. 2018), sections 6.4 to 6.6.

Shapes: ``S`` inputs, ``A`` outputs, ``n`` trials.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any, Literal, NamedTuple, get_args, get_type_hints

import numpy as np
from numpy.typing import NDArray

from tasklift.checks import number
from tasklift.errors import TaskliftError
from tasklift.learning.chances import GREEDY_STAGE
from tasklift.learning.learner import Curve, Run, keeping, provenance, run_of
from tasklift.learning.model import Model
from tasklift.learning.reinforcement import Fixed
from tasklift.learning.worlds import (
    Course,
    Outcomes,
    Possible,
    Record,
    Steps,
    Trials,
    View,
    need_world,
    nothing_possible,
    outcomes_of,
)
from tasklift.tasks.policy import Policy
from tasklift.tasks.task import Task
from tasklift.tasks.variable import plain_number
from tasklift.text import shown


class Episode(NamedTuple):
    """One trial of a run by value, as a callback sees it.

    Attributes
    ----------
    trial
        Its number within the stage, from 0.
    steps, success, losses, returns
        What came of it.
    values
        float64 (S, A): the values after it, −inf where an output is impossible. Read-only, and they go on changing.
    """

    trial: int
    steps: int
    success: bool
    losses: int
    returns: float
    values: NDArray[np.float64]


@dataclass(frozen=True)
class ValueLearning:
    """Learn by value: Q-learning, SARSA or Expected SARSA, on a world that is met step by step.

    Parameters
    ----------
    rule
        The target: best next value, value of the next choice, or mean over the probabilities of the next choice.
    step_size
        α, in (0, 1]. With ``step_power`` 0 it is constant.
    step_power
        Above 0, the step size of the k-th visit of a pair is k ** -step_power, but at least ``step_size``:
        then visits are experience, and :meth:`count_as` can say how many a copied value counts as.
    discount
        γ, from 0 to 1.
    epsilon, epsilon_decay, epsilon_least
        Initial exploration rate (probability of a uniformly random output), its multiplicative decay per trial, and
        its lower bound.
    temperature
        Above 0: softmax in place of greedy choice.
    loss_penalty
        What each loss takes from the reward that is learned from; returns are reported without it.
    initial_value
        Of every pair; one above what can be reached makes an optimistic start.

    Raises
    ------
    TaskliftError
        If a setting is out of its range; names it, and says what was found.

    Examples
    --------
    >>> from tasklift import Run, Step, Task, ValueLearning, Variable
    >>> class Walk:  # five places in a row; the last one is home
    ...     task = Task("walk", (Variable("place", range(5)),), (Variable("go", ("left", "right")),))
    ...     limit = 50
    ...     def start(self, rng):
    ...         self.place = 0
    ...         return self.place
    ...     def step(self, output):
    ...         self.place = max(0, self.place + (1 if output else -1))
    ...         return Step(self.place, -1.0, ended=self.place == 4, success=self.place == 4)
    >>> learner = ValueLearning("sarsa", step_size=0.5, epsilon=0.2, epsilon_decay=0.9)
    >>> curve = learner.learn(Walk(), learner.start(Walk.task), Run(seed=0, trials=60))
    >>> int(curve.outcomes.steps[-1])
    4
    """

    rule: Literal["q-learning", "sarsa", "expected-sarsa"] = "q-learning"
    step_size: float = 0.1
    step_power: float = 0.0
    discount: float = 0.99
    epsilon: float = 0.1
    epsilon_decay: float = 1.0
    epsilon_least: float = 0.0
    temperature: float = 0.0
    loss_penalty: float = 0.0
    initial_value: float = 0.0

    def __post_init__(self) -> None:
        if self.rule not in get_args(get_type_hints(type(self))["rule"]):
            raise TaskliftError(
                f"value learning, rule: expected q-learning, sarsa or expected-sarsa, found {self.rule!r}"
            )
        for name, low, high in (
            ("step_size", 0.0, 1.0),
            ("step_power", 0.0, 1.0),
            ("discount", 0.0, 1.0),
            ("epsilon", 0.0, 1.0),
            ("epsilon_decay", 0.0, 1.0),
            ("epsilon_least", 0.0, 1.0),
            ("temperature", 0.0, float("inf")),
            ("loss_penalty", 0.0, float("inf")),
            ("initial_value", -float("inf"), float("inf")),
        ):
            number = plain_number(getattr(self, name), f"value learning, {name}")
            if not low <= number <= high or (name == "step_size" and number == 0):
                raise TaskliftError(f"value learning, {name}: expected {low} to {high}, found {number}")

    def start(self, task: Task) -> Policy:
        """Return the policy of values that learning from scratch starts with."""
        task.need_room(task.shape[0] * task.shape[1], "the policy")
        values = np.full(task.shape, float(self.initial_value))
        return Policy(task, values, {"equal": float(self.initial_value)}, "value", self.carried(task))

    def carried(self, task: Task) -> dict[str, NDArray[np.float64] | float]:
        """Return what a learner with these settings carries at its start."""
        return {"visits": np.zeros(task.shape), "epsilon": float(self.epsilon)}

    def check(self, world: Trials | Steps, task: Task, run: Run) -> None:
        """Raise :class:`TaskliftError` for a world of whole trials, or a run without a budget."""
        if not isinstance(world, Steps):
            raise TaskliftError("the world runs whole trials only; a learner by value must meet it by steps")
        if run.trials is None and run.steps is None:
            raise TaskliftError("has no budget; give trials= or steps=")
        told = isinstance(world, Model) and not world.reward.any() and not (self.loss_penalty and world.lost.any())
        if told and self.initial_value == 0:
            raise TaskliftError("nothing can be learned: the model has no reward, and no loss with a loss_penalty")
        _need_outputs(task)

    def learn(
        self, world: Trials | Steps, policy: Policy, run: Run, *, callback: Callable[[Episode], object] | None = None
    ) -> Curve:
        """Learn trial after trial; see :class:`.Learner`. The outcomes are :class:`.StepOutcomes`.

        Outputs that the task declares impossible, or the world (``possible``), are never chosen. If anything is raised
        on the way, the exception has what was learned until then as its attribute ``curve``.

        Parameters
        ----------
        world
            A :class:`~tasklift.learning.model.Model` runs compiled; any other world runs at the speed of Python.
        callback
            Called after each trial with an :class:`Episode`; the run stops early where it returns something true.

        Raises
        ------
        TaskliftError
            For a policy of weights, or as :meth:`check` does.
        """
        self.check(world, policy.task, run)
        assert isinstance(world, Steps)
        if policy.kind != "value":
            raise TaskliftError("expected a policy of values, found one of weights; start from scratch")
        if callback is not None and not callable(callback):
            raise TaskliftError(f"callback: expected a function of an Episode, found {shown(callback)}")
        carried = self.carried(policy.task) | dict(policy.carried)
        values, visits = _without_impossible(policy), np.array(carried["visits"])
        epsilon = float(carried["epsilon"])
        one_trial = _trial_of(world, policy.task, values, visits, self)
        records: list[Record] = []
        watched = values.view()
        watched.flags.writeable = False

        def trial(rng: np.random.Generator) -> Record:
            nonlocal epsilon
            record = one_trial(rng, epsilon, True)
            epsilon = max(self.epsilon_least, epsilon * self.epsilon_decay)
            return record

        def stop(record: Record) -> bool:
            number = run.first_trial + len(records) - 1
            return callback is not None and bool(callback(Episode(number, *record, watched)))

        def curve() -> Curve:
            outcomes = outcomes_of(records, world.limit)
            history = provenance(self.rule, self, policy, run, outcomes)
            kept = carried | {"visits": visits.copy(), "epsilon": epsilon}
            learned = np.where(np.isneginf(values), policy.weights, values)
            return Curve(replace(policy, weights=learned, provenance=history, carried=kept), outcomes)

        with keeping(curve):
            run.play(trial, records, stop)
        return curve()

    def count_as(self, policy: Policy, trust: float) -> Policy:
        """Return the policy with ``trust`` visits in place of those of each entry that was ever visited.

        Raises
        ------
        TaskliftError
            If step sizes do not fall with visits (``step_power`` 0).
        """
        if self.step_power == 0:
            raise TaskliftError("trust: needs step sizes that fall with visits; give the learner a step_power")
        visits = np.where(np.asarray(policy.carried["visits"]) > 0, float(trust), 0.0)
        return replace(policy, carried=dict(policy.carried) | {"visits": visits})


def learn_values(
    world: Steps,
    policy: Policy | None = None,
    *,
    task: Task | None = None,
    learning: ValueLearning = ValueLearning(),
    callback: Callable[[Episode], object] | None = None,
    **run: Any,
) -> Curve:
    """Learn values, from a given policy or from scratch: the short form of :class:`ValueLearning` with a run.

    Parameters
    ----------
    world
        A world that is met step by step.
    policy
        Where to start; it is not changed, and what it carries goes on. Default: ``learning.start``.
    task
        What to learn when there is no policy: the world's task (the default), or a simplification of it.
    learning
        The learner.
    callback
        Called after each trial with an :class:`Episode`; True stops the run early.
    **run
        The fields of :class:`.Run`: ``trials`` or ``steps`` or both, ``seed``, ``stage``, ``first_trial``,
        ``max_losses``.

    Returns
    -------
    Curve
        The policy of values learned, and the outcomes of the trials, with their returns.

    Raises
    ------
    TaskliftError
        For a policy of weights, a missing budget, or a number out of range.

    Examples
    --------
    >>> from tasklift import Step, Task, Variable
    >>> class Walk:  # five places in a row; the last one is home
    ...     task = Task("walk", (Variable("place", range(5)),), (Variable("go", ("left", "right")),))
    ...     limit = 50
    ...     def start(self, rng):
    ...         self.place = 0
    ...         return self.place
    ...     def step(self, output):
    ...         self.place = max(0, self.place + (1 if output else -1))
    ...         return Step(self.place, -1.0, ended=self.place == 4, success=self.place == 4)
    >>> curve = learn_values(Walk(), trials=50, seed=0, learning=ValueLearning(epsilon=0.2))
    >>> curve.policy.best()[:4].tolist()
    [1, 1, 1, 1]
    """
    asked = run_of("learn_values", run)
    need_world(world)
    if not isinstance(learning, ValueLearning):
        raise TaskliftError(f"learn_values, learning: expected a ValueLearning, found {shown(learning)}")
    start = learning.start(task or world.task) if policy is None else _policy(policy)
    return learning.learn(world, start, asked, callback=callback)


def evaluate(
    world: Trials | Steps,
    policy: Policy,
    *,
    trials: int = 100,
    epsilon: float = 0.0,
    stage: int = GREEDY_STAGE,
    **run: Any,
) -> Outcomes:
    """Run trials with the heaviest output (of values or of weights), ties at random, and learn nothing.

    Parameters
    ----------
    world
        Any world; one that is met step by step gives :class:`.StepOutcomes`.
    policy
        Of the world's task, or of a simplification of it.
    trials
        How many to run.
    epsilon
        Probability of a uniformly random output in place of the heaviest; on worlds met step by step only.
    stage, **run
        The other fields of :class:`.Run`: ``seed``, ``first_trial``, ``steps``, ``max_losses``.

    Returns
    -------
    Outcomes
        One entry per trial; the policy is not changed.

    Raises
    ------
    TaskliftError
        If a number is out of range, or the world shows an input that the policy's task leaves out.

    Examples
    --------
    >>> from tasklift import Policy
    >>> from tasklift.building import Mission, generate
    >>> hunt = Mission(generate(seed=7), team="10+5")
    >>> evaluate(hunt, Policy.equal(hunt.task), trials=10).summary()["trials"]
    10
    """
    asked = run_of("evaluate", {"trials": trials, "stage": stage, **run})
    need_world(world)
    epsilon, policy = number(epsilon, "evaluate, epsilon", 0.0, 1.0), _policy(policy)
    if not isinstance(world, Steps):
        if epsilon:
            raise TaskliftError(f"evaluate, epsilon: a world of whole trials has no random outputs, found {epsilon}")
        return Fixed().learn(world, policy, asked).outcomes
    _need_outputs(policy.task)
    values, visits = _without_impossible(policy), np.zeros(policy.task.shape)
    one_trial = _trial_of(world, policy.task, values, visits, ValueLearning())
    return outcomes_of(asked.play(lambda rng: one_trial(rng, epsilon, False)), world.limit)


def _trial_of(
    world: Steps,
    task: Task,
    values: NDArray[np.float64],
    visits: NDArray[np.float64],
    learning: ValueLearning,
) -> Callable[[np.random.Generator, float, bool], Record]:
    """Return the function that runs one trial: compiled where the world is an explicit model."""
    from tasklift.learning.model_kernel import EPSILON, LEARN

    rule = ("q-learning", "sarsa", "expected-sarsa").index(learning.rule)
    settings = np.array([
        rule, learning.step_size, learning.step_power, learning.discount, learning.temperature, learning.loss_penalty,
        0.0, 0.0,
    ])  # fmt: skip
    if isinstance(world, Model):
        run = world.compiled_trial(task, values, visits, settings)
    else:
        view, scratch = View(world, task), np.empty((2, values.shape[1]))

        def run(rng: np.random.Generator) -> Record:
            def agent(row: int, possible: Possible) -> Course:
                return _course(task, values, visits, settings, rng, row, possible, scratch)

            return view.play(rng, agent)

    def trial(rng: np.random.Generator, epsilon: float, learn: bool) -> Record:
        settings[EPSILON], settings[LEARN] = epsilon, learn
        return run(rng)

    return trial


def _policy(policy: Policy) -> Policy:
    if not isinstance(policy, Policy):
        raise TaskliftError(f"expected a Policy, found {shown(policy)}")
    return policy


def _need_outputs(task: Task) -> None:
    """Refuse a task with an input at which nothing can be chosen."""
    stuck = task.impossible_table().all(axis=1)
    if stuck.any():
        raise TaskliftError(
            f"task {task.name!r}: all outputs are impossible at {task.input_values(int(stuck.argmax()))}; "
            "what is impossible is never chosen"
        )


def _without_impossible(policy: Policy) -> NDArray[np.float64]:
    """Return a copy of the weights, −inf where an output is impossible: that is never chosen, nor learned from."""
    return np.where(policy.task.impossible_table(), -np.inf, policy.weights)


def _course(
    task: Task,
    values: NDArray[np.float64],
    visits: NDArray[np.float64],
    settings: NDArray[np.float64],
    rng: np.random.Generator,
    row: int,
    possible: Possible,
    scratch: NDArray[np.float64],
) -> Course:
    """Act and learn in one trial; the same steps, in the same order, as ``model_kernel.trial``, which is compiled."""
    from tasklift.learning.model_kernel import LEARN, RULE, choose, follow

    everything = np.ones(values.shape[1], np.bool_)
    sarsa = settings[LEARN] != 0.0 and settings[RULE] == 1.0
    here = everything if possible is None else possible
    column, last = choose(values, settings, row, here, rng.random(), scratch), False
    while True:
        if column < 0 and not last:
            raise nothing_possible(task, row)
        after, possible, reward, lost, last = yield column
        here = everything if possible is None else possible
        u = rng.random() if not last or (sarsa and after >= 0) else 0.0
        column = follow(values, visits, settings, row, column, reward, lost, after, last, here, u, scratch)
        row = after
