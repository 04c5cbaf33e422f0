"""Learning by value: Q-learning, SARSA and Expected SARSA, on the same policies as reinforcement of weights.

The paper's method "does not apply only to a specific learning algorithm" (section III). Here a policy keeps
estimates of return (``kind="value"``), and carries what the learner needs to go on: how often each pair was
visited, and how much it still explores.

Source of the learners: Sutton & Barto, Reinforcement Learning (2nd ed. 2018), sections 6.4 to 6.6.

Shapes: ``S`` inputs, ``A`` outputs, ``n`` trials.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import asdict, dataclass
from typing import Literal, get_args, get_type_hints

import numpy as np
from numpy.typing import NDArray

import tasklift
from tasklift.errors import TaskliftError
from tasklift.learning.model import Model
from tasklift.learning.reinforcement import GREEDY_STAGE, TARGET_STAGE, whole_number
from tasklift.learning.steps import Chances, StepOutcomes, Steps, View, outcomes_of
from tasklift.tasks import choice as rules
from tasklift.tasks.policy import Policy
from tasklift.tasks.task import Task
from tasklift.tasks.variable import plain_number

Record = tuple[int, bool, int, float]


@dataclass(frozen=True)
class ValueLearning:
    """Settings of a learner by value.

    Parameters
    ----------
    rule
        The target: best next value, value of the next choice, or mean over the chances of the next choice.
    step_size
        α, in (0, 1]. With ``step_power`` 0 it is constant.
    step_power
        Above 0, the step size of the k-th visit of a pair is k ** -step_power, but at least ``step_size``:
        then visits are experience, and :func:`~tasklift.learning.curriculum.with_trust` can say how many a copied value
        counts as.
    discount
        γ, from 0 to 1.
    epsilon, epsilon_decay, epsilon_least
        Share of even choices at the start; its factor after each trial; where it stops falling.
    temperature
        Above 0: softmax in place of greedy choice.
    initial_value
        Of every pair; one above what can be reached makes an optimistic start.
    """

    rule: Literal["q-learning", "sarsa", "expected-sarsa"] = "q-learning"
    step_size: float = 0.1
    step_power: float = 0.0
    discount: float = 0.99
    epsilon: float = 0.1
    epsilon_decay: float = 1.0
    epsilon_least: float = 0.0
    temperature: float = 0.0
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


@dataclass(frozen=True)
class ValueCurve:
    """A learned policy of values, and the outcome of every trial on the way to it."""

    policy: Policy
    outcomes: StepOutcomes


def learn_values(
    world: Steps,
    policy: Policy | None = None,
    *,
    task: Task | None = None,
    trials: int | None = None,
    steps: int | None = None,
    seed: int = 0,
    stage: int = TARGET_STAGE,
    first_trial: int = 0,
    learning: ValueLearning = ValueLearning(),
    max_losses: int | None = None,
) -> ValueCurve:
    """Learn values, trial after trial, from a given policy or from scratch.

    Parameters
    ----------
    world
        A :class:`~tasklift.learning.model.Model` runs compiled; any other world runs at the speed of Python.
    policy
        Where to start; it is not changed, and what it carries is gone on with. Default: ``learning.start``.
    task
        What to learn when there is no policy: the world's task, or a simplification of it.
    trials, steps
        The budget, one or both: how many trials; no trial begins once so many steps are done.
    max_losses
        No trial begins once this many losses are reached.
    """
    if trials is None and steps is None:
        raise TaskliftError("learn_values: give a budget, trials= or steps=")
    for name, value in (("trials", trials), ("steps", steps), ("seed", seed), ("first_trial", first_trial)):
        if value is not None:
            whole_number(value, f"learn_values, {name}", at_least=0)
    if max_losses is not None:
        whole_number(max_losses, "learn_values, max_losses", at_least=1)
    start = policy or learning.start(task or world.task)
    if start.kind != "value":
        raise TaskliftError("learn_values: expected a policy of values, found one of weights; start from scratch")
    carried = learning.carried(start.task) | dict(start.carried)
    values, visits = start.weights.copy(), np.array(carried["visits"])
    epsilon = float(carried["epsilon"])
    one_trial = _trial_of(world, start.task, values, visits, learning)
    records: list[Record] = []
    chances = Chances(seed, stage)
    walked = lost = 0
    while trials is None or len(records) < trials:
        if (steps is not None and walked >= steps) or (max_losses is not None and lost >= max_losses):
            break
        records.append(one_trial(chances.of(first_trial + len(records)), epsilon, True))
        walked, lost = walked + records[-1][0], lost + records[-1][2]
        epsilon = max(learning.epsilon_least, epsilon * learning.epsilon_decay)
    outcomes = outcomes_of(records, world.limit)
    provenance = {
        "learned_by": learning.rule,
        "tasklift": tasklift.__version__,
        "task": start.task.name,
        "seed": seed,
        "stage": stage,
        "first_trial": first_trial,
        "max_losses": max_losses,
        "learning": asdict(learning),
        "outcomes": outcomes.summary(),
        "before": dict(start.provenance),
    }
    kept = carried | {"visits": visits, "epsilon": epsilon}
    return ValueCurve(Policy(start.task, values, provenance, "value", kept), outcomes)


def evaluate(
    world: Steps,
    policy: Policy,
    *,
    trials: int = 100,
    seed: int = 0,
    stage: int = GREEDY_STAGE,
    epsilon: float = 0.0,
) -> StepOutcomes:
    """Run trials with the heaviest output (of values or of weights), ties at random, and learn nothing."""
    whole_number(trials, "evaluate, trials", at_least=1)
    values, visits = policy.weights.copy(), np.zeros(policy.task.shape)
    one_trial = _trial_of(world, policy.task, values, visits, ValueLearning())
    chances = Chances(seed, stage)
    return outcomes_of([one_trial(chances.of(i), epsilon, False) for i in range(trials)], world.limit)


def _trial_of(
    world: Steps,
    task: Task,
    values: NDArray[np.float64],
    visits: NDArray[np.float64],
    learning: ValueLearning,
) -> Callable[[np.random.Generator, float, bool], Record]:
    """Return the function that runs one trial: compiled where the world is an explicit model."""
    rule = ("q-learning", "sarsa", "expected-sarsa").index(learning.rule)
    step_size, power = float(learning.step_size), float(learning.step_power)
    settings = (rule, step_size, power, float(learning.discount), float(learning.temperature))
    if isinstance(world, Model):
        return world.compiled_trial(task, values, visits, settings)
    view = View(world, task)

    def trial(rng: np.random.Generator, epsilon: float, learn: bool) -> Record:
        return _trial(world, view, values, visits, learning, rng, epsilon, learn)

    return trial


def _trial(
    world: Steps,
    view: View,
    values: NDArray[np.float64],
    visits: NDArray[np.float64],
    learning: ValueLearning,
    rng: np.random.Generator,
    epsilon: float,
    learn: bool,
) -> Record:
    """Run one trial; the same steps, in the same order, as ``model_kernel.trial``, which is compiled."""
    chances = np.empty(values.shape[1])
    sarsa = learn and learning.rule == "sarsa"

    def choose(row: int) -> int:
        rules.probabilities(values[row], epsilon, learning.temperature, chances)
        return rules.draw(chances, rng.random())

    row = view.row(world.start(rng))
    column = choose(row)
    steps, losses, total = 0, 0, 0.0
    while True:
        answer = world.step(view.columns[column])
        steps, losses, total = steps + 1, losses + answer.lost, total + answer.reward
        after, then, target = -1, -1, answer.reward
        if not answer.ended:
            after = view.row(answer.input)
            if sarsa:
                then = choose(after)
                target += learning.discount * values[after, then]
            elif learning.rule == "q-learning":
                target += learning.discount * values[after].max()
            else:
                rules.probabilities(values[after], epsilon, learning.temperature, chances)
                target += learning.discount * sum(c * v for c, v in zip(chances, values[after], strict=True))
        if learn:
            visits[row, column] += 1
            size = rules.step_size(visits[row, column], learning.step_size, learning.step_power)
            values[row, column] += size * (target - values[row, column])
        if answer.ended or steps >= world.limit:
            return steps, answer.success, losses, total
        if not sarsa:
            then = choose(after)
        row, column = after, then
