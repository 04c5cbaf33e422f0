"""Learning by reinforcement of weights, the paper's way (Singh & Adams 2006, sections V and VI).

A world of whole trials reinforces the weights it is given (:class:`.Trials`); a world that is met step by step does so
through :class:`StepTrials`. The paper's two procedures are :class:`Sweep`, for the source task V, and
:class:`Reinforcement`, for the target task T; :func:`sweep` and :func:`reinforce` are their short forms.

Shapes: ``S`` inputs, ``A`` outputs, ``n`` trials.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cache
from typing import Any, Literal, get_args, get_type_hints

import numpy as np
from numpy.typing import NDArray

from tasklift.checks import whole_number
from tasklift.errors import TaskliftError
from tasklift.learning.chances import SWEEP_STAGE, Chances
from tasklift.learning.learner import MOST_TRIALS, Curve, Run, keeping, provenance, run_of
from tasklift.learning.worlds import (
    Course,
    Outcomes,
    Possible,
    Record,
    StepOutcomes,
    Steps,
    Trials,
    View,
    joined,
    need_world,
    nothing_possible,
    outcomes_of,
)
from tasklift.tasks import choice as rules
from tasklift.tasks.policy import Policy, greedy_share
from tasklift.tasks.task import Task
from tasklift.tasks.variable import plain_number

_hints = cache(get_type_hints)  # slow, and settings are made by the thousand

@dataclass(frozen=True)
class Reinforcement:
    """Learn by reinforcement of weights (sections V and VI); the defaults are the reading that the presets use.

    Parameters
    ----------
    initial_weight
        Weight of every input and output before learning.
    floor
        No weight falls below it.
    sweep_credit
        In a sweep, what a trial's output is credited with: ``"all"`` inputs ("all inputs have all output
        combinations evaluated and reinforced"), or the ``"visited"`` ones only, at each decision.
    credit
        A local signal reaches its input and output at every ``"decision"``, or once per ``"trial"``.
    time_signal
        The global signal at the end of a trial, for every pair used in it: ``"inverted"``: the task's time
        reward × (1 − steps / limit); ``"baseline"``: twice the time reward × (running mean − steps) / limit;
        or ``"none"``.
    selection, q
        How outputs are chosen; ``q`` is the share of heaviest choices in ``"pseudo-random"``.
    loss_signal
        Added, once per loss, to the input and output that led to it; a penalty, at most 0. The paper has none (0).

    Raises
    ------
    TaskliftError
        If a setting has another type or range; names it, and says what was found.

    Examples
    --------
    >>> from tasklift import Policy, Reinforcement, Run
    >>> from tasklift.building import Mission, generate
    >>> hunt = Mission(generate(seed=7), team="10+5")
    >>> learner = Reinforcement(selection="pseudo-random", q=0.9, loss_signal=-0.5)
    >>> curve = learner.learn(hunt, learner.start(hunt.task), Run(seed=0, trials=20, max_losses=200))
    >>> len(curve.outcomes), curve.policy.weights.shape
    (20, (90, 44))
    """

    initial_weight: float = 1.5
    floor: float = 0.0
    sweep_credit: Literal["all", "visited"] = "all"
    credit: Literal["decision", "trial"] = "decision"
    time_signal: Literal["inverted", "baseline", "none"] = "inverted"
    selection: Literal["exploration", "pseudo-random", "exploitation"] = "exploration"
    q: float = 0.9
    loss_signal: float = 0.0

    def __post_init__(self) -> None:
        for name, hint in _hints(Reinforcement).items():
            value, allowed = getattr(self, name), get_args(hint)
            if allowed and value not in allowed:
                raise TaskliftError(
                    f"reinforcement, {name}: expected one of {', '.join(allowed)}, found {value!r}"
                )
            if not allowed:
                plain_number(value, f"reinforcement, {name}")
        if self.floor < 0:
            raise TaskliftError(
                f"reinforcement, floor: weights are not negative, found {self.floor}; use 0 or more"
            )
        if self.initial_weight < self.floor:
            raise TaskliftError(
                f"reinforcement, initial_weight: expected at least the floor {self.floor}, "
                f"found {self.initial_weight}"
            )
        if not 0 <= self.q <= 1:
            raise TaskliftError(f"reinforcement, q: a probability lies between 0 and 1, found {self.q}")
        if self.loss_signal > 0:
            raise TaskliftError(
                f"reinforcement, loss_signal: a loss is not rewarded, found {self.loss_signal}; use 0 or less"
            )

    @property
    def divisible(self) -> bool:
        """Whether a run may be cut: not with the baseline, whose running mean begins anew in every run."""
        return self.time_signal != "baseline"

    def start(self, task: Task) -> Policy:
        """Return equal weights."""
        return Policy.equal(task, self.initial_weight)

    def check(self, world: Trials | Steps, task: Task, run: Run) -> None:
        """Raise :class:`TaskliftError` for a run without a budget, or a signal that could not work."""
        if run.trials is None and run.steps is None:
            raise TaskliftError("has no budget; give trials= or steps=")
        if run.steps is not None and self.time_signal == "baseline":
            raise TaskliftError("the baseline time signal needs the mean of a run's trials; give trials=, not steps=")
        if self.time_signal == "none":
            task = replace(task, time_reward=0.0)
        _need_signals(world, task, self.loss_signal)

    def learn(self, world: Trials | Steps, policy: Policy, run: Run) -> Curve:
        """Learn trial after trial, outputs chosen by weight; see :class:`.Learner`.

        Raises
        ------
        TaskliftError
            For a policy of values, or as :meth:`check` does.
        """
        self.check(world, policy.task, run)
        return _learned("reinforce", self, world, policy, run, self, None)

    def count_as(self, policy: Policy, trust: float) -> Policy:
        """Return the policy with each row scaled so that its mean weight is worth ``trust`` of the largest signals.

        Raises
        ------
        TaskliftError
            If the task has no signal.
        """
        task = policy.task
        unit = max([abs(s.value) for s in task.signals] + [abs(task.time_reward)])
        if unit == 0:
            raise TaskliftError(f"trust: the task {task.name!r} has no signal to measure weights by")
        means = policy.weights.mean(axis=1, keepdims=True)
        scaled = np.where(means > 0, trust * unit / np.maximum(means, 1e-300), 1.0)
        return replace(policy, weights=policy.weights * scaled)


@dataclass(frozen=True)
class Sweep:
    """Learn a simple task by trying every output for full trials (section V; 44 × 5 trials in the paper).

    Its budget is its own: all outputs once, in order, each one in all decisions of a trial; then all of them again.

    Parameters
    ----------
    reinforcement
        The rules of the update; nothing is chosen by weight.
    repeats
        How often each output is tried.

    Raises
    ------
    TaskliftError
        If ``repeats`` is not a whole number of at least 1.

    Examples
    --------
    >>> from tasklift.building import Mission, generate
    >>> hunt = Mission(generate(seed=7), team="10+5")
    >>> safe = hunt.task.simplify(fix={"DL": 0, "GL": 0})
    >>> learner = Sweep(repeats=5)
    >>> learner.trials(safe)
    220
    >>> curve = learner.learn(hunt.without_hostiles(), learner.start(safe), Run(stage=SWEEP_STAGE))
    >>> int(curve.outcomes.losses.sum())
    0
    """

    reinforcement: Reinforcement = Reinforcement()
    repeats: int = 5

    def __post_init__(self) -> None:
        whole_number(self.repeats, "sweep, repeats", least=1)

    def trials(self, task: Task) -> int:
        """Return how many trials the sweep of a task takes."""
        return self.repeats * task.shape[1]

    def start(self, task: Task) -> Policy:
        """Return equal weights."""
        return self.reinforcement.start(task)

    def count_as(self, policy: Policy, trust: float) -> Policy:
        """Return the policy as :meth:`Reinforcement.count_as` does."""
        return self.reinforcement.count_as(policy, trust)

    def check(self, world: Trials | Steps, task: Task, run: Run) -> None:
        """Raise :class:`TaskliftError` for a stage that gives a sweep another budget than its own."""
        if run.trials is not None or run.steps is not None:
            raise TaskliftError("a sweep has its own budget; drop trials= and steps=")
        _need_signals(world, task, 0.0 if self.reinforcement.sweep_credit == "all" else self.reinforcement.loss_signal)
        whole_number(self.repeats, "sweep, repeats", 1, MOST_TRIALS // task.shape[1])

    def learn(self, world: Trials | Steps, policy: Policy, run: Run) -> Curve:
        """Learn from the sweep's trials, or from those of them that ``run`` names."""
        if run.steps is not None:
            raise TaskliftError("sweep: expected trials, found a budget of steps")
        left = max(0, self.trials(policy.task) - run.first_trial)
        trials = left if run.trials is None else min(left, run.trials)
        outputs = (run.first_trial + np.arange(trials, dtype=np.int64)) % policy.task.shape[1]
        run = replace(run, trials=trials)
        return _learned("sweep", self, world, policy, run, self.reinforcement, outputs)


@dataclass(frozen=True)
class Fixed:
    """Play a policy and learn nothing: a reference, or an evaluation.

    Parameters
    ----------
    reinforcement
        How outputs are chosen. Default: always the heaviest, ties at random.

    Examples
    --------
    >>> random, greedy = Fixed(Reinforcement()), Fixed()
    """

    reinforcement: Reinforcement = Reinforcement(selection="exploitation")

    def start(self, task: Task) -> Policy:
        """Return equal weights."""
        return self.reinforcement.start(task)

    def count_as(self, policy: Policy, trust: float) -> Policy:
        """Return the policy as it is: nothing is learned that could outweigh it."""
        return policy

    def check(self, world: Trials | Steps, task: Task, run: Run) -> None:
        """Raise :class:`TaskliftError` for a run without a budget."""
        if run.trials is None and run.steps is None:
            raise TaskliftError("has no budget; give trials= or steps=")

    def learn(self, world: Trials | Steps, policy: Policy, run: Run) -> Curve:
        """Run the trials and return the policy as it was."""
        self.check(world, policy.task, run)
        if policy.kind != "weight" and self.reinforcement.selection != "exploitation":
            raise TaskliftError(f"fixed: {policy.kind}s cannot be drawn in proportion; select by 'exploitation'")
        weights = policy.weights.copy()
        parts: list[Outcomes] = []
        _run_trials(world, policy.task, weights, run, self.reinforcement, parts, learn=False)
        return Curve(policy, joined(parts))


def _need_signals(world: Trials | Steps, task: Task, loss_signal: float) -> None:
    """Refuse to reinforce on a world met step by step without any signal."""
    if isinstance(world, Steps) and not (task.time_reward or loss_signal or task.signal_table().any()):
        raise TaskliftError(
            f"nothing can be learned: task {task.name!r} has no signal and no time_reward, and reinforcement does "
            "not use the world's rewards; learn by value (learner=ValueLearning()), or declare signals"
        )


def sweep(
    world: Trials | Steps,
    task: Task,
    *,
    repeats: int = 5,
    seed: int = 0,
    reinforcement: Reinforcement = Reinforcement(),
    initial: Policy | None = None,
) -> Policy:
    """Learn a simple task by trying every output for full trials: the short form of :class:`Sweep`.

    Parameters
    ----------
    world
        Where trials run.
    task
        The simple task V, the world's task or a simplification of it.
    repeats, reinforcement
        As in :class:`Sweep`.
    seed
        Of all random numbers.
    initial
        Start from this policy of ``task``; default: equal weights.

    Returns
    -------
    Policy
        Of ``task``, float64 weights (S, A).

    Raises
    ------
    TaskliftError
        If ``initial`` is of another task, or a number is out of range.

    Examples
    --------
    >>> from tasklift.building import Mission, generate
    >>> hunt = Mission(generate(seed=7), team="10+5")
    >>> safe = hunt.task.simplify(fix={"DL": 0, "GL": 0})
    >>> sweep(hunt.without_hostiles(), safe, repeats=1).extend(hunt.task).weights.shape
    (90, 44)
    """
    learner = Sweep(reinforcement, repeats)
    start = learner.start(task) if initial is None else initial
    if (reason := start.task.difference(task)) is not None:
        raise TaskliftError(f"sweep: the initial policy is of another task: {reason}")
    return learner.learn(world, start, Run(seed, SWEEP_STAGE)).policy


def reinforce(
    world: Trials | Steps,
    policy: Policy,
    *,
    trials: int = 100,
    reinforcement: Reinforcement = Reinforcement(),
    **run: Any,
) -> Curve:
    """Learn by reinforcement of weights, trial after trial: the short form of :class:`Reinforcement` with a run.

    Parameters
    ----------
    world
        Where trials run.
    policy
        Where to start; it is not changed.
    trials
        How many to run.
    reinforcement
        The learner.
    **run
        The other fields of :class:`.Run`: ``seed``, ``stage``, ``first_trial``, ``steps``, ``max_losses``.

    Returns
    -------
    Curve
        The policy learned, and the outcomes of the trials.

    Raises
    ------
    TaskliftError
        For a policy of values, or a number out of range.

    Examples
    --------
    >>> from tasklift import Policy
    >>> from tasklift.building import Mission, generate
    >>> hunt = Mission(generate(seed=7), team="10+5")
    >>> first = reinforce(hunt, Policy.equal(hunt.task), trials=15, seed=1)
    >>> rest = reinforce(hunt, first.policy, trials=5, seed=1, first_trial=15)
    >>> whole = reinforce(hunt, Policy.equal(hunt.task), trials=20, seed=1)
    >>> bool((rest.policy.weights == whole.policy.weights).all())
    True
    """
    need_world(world)
    return reinforcement.learn(world, policy, run_of("reinforce", {"trials": trials, **run}))


def _learned(
    how: str,
    learner: Reinforcement | Sweep,
    world: Trials | Steps,
    policy: Policy,
    run: Run,
    reinforcement: Reinforcement,
    outputs: NDArray[np.int64] | None,
) -> Curve:
    if policy.kind != "weight":
        raise TaskliftError(f"{how}: expected a policy of weights, found one of {policy.kind}s")
    weights = policy.weights.copy()
    parts: list[Outcomes] = []

    def curve() -> Curve:
        outcomes = joined(parts)
        history = provenance(how, learner, policy, run, outcomes)
        return Curve(replace(policy, weights=weights, provenance=history), outcomes)

    with keeping(curve):
        _run_trials(world, policy.task, weights, run, reinforcement, parts, outputs)
    return curve()


def _run_trials(
    world: Trials | Steps,
    task: Task,
    weights: NDArray[np.float64],
    run: Run,
    reinforcement: Reinforcement,
    parts: list[Outcomes],
    outputs: NDArray[np.int64] | None = None,
    learn: bool = True,
) -> None:
    """Run trials that update ``weights`` in place, and add their outcomes to ``parts``, an empty list."""
    trials_of = StepTrials(world) if isinstance(world, Steps) else world

    def some(part: Run, trials: int) -> Outcomes:
        try:
            outcomes = trials_of.run(
                task,
                weights,
                trials=trials,
                seed=part.seed,
                stage=part.stage,
                reinforcement=reinforcement,
                outputs=outputs,
                first_trial=part.first_trial,
                learn=learn,
                max_losses=part.max_losses,
            )
        except BaseException as error:
            parts.extend(getattr(error, "outcomes", ()))
            raise
        parts.append(outcomes)
        return outcomes

    if run.steps is None:
        some(run, run.trials or 0)
        return
    # a world of whole trials does not count steps, so ask after each trial
    steps = losses = 0
    while run.goes_on(len(parts), steps, losses):
        outcomes = some(run.after(len(parts), steps, losses), 1)
        steps, losses = steps + int(outcomes.steps[0]), losses + int(outcomes.losses[0])
    if not parts:
        some(run, 0)


# -- worlds that are met step by step --------------------------------------------------------------------------


class StepTrials:
    """Reinforcement of weights on a world that is met step by step, as a world of whole trials.

    The signals are the task's rules, not the world's rewards; a loss adds the ``loss_signal`` to the pair that led
    to it. The decision is made at every step. Learners of weights wrap such worlds by themselves.

    Parameters
    ----------
    world
        A world of :class:`.Steps`.
    """

    def __init__(self, world: Steps) -> None:
        self.world = world

    @property
    def task(self) -> Task:
        """The world's full task."""
        return self.world.task

    def run(
        self,
        task: Task,
        weights: NDArray[np.float64],
        *,
        trials: int,
        seed: int,
        stage: int,
        reinforcement: Reinforcement,
        outputs: NDArray[np.int64] | None = None,
        first_trial: int = 0,
        learn: bool = True,
        max_losses: int | None = None,
    ) -> StepOutcomes:
        """Run trials and update ``weights``, float64 (S, A), in place; as :class:`.Trials` asks.

        What is raised on the way has the outcomes until then, in a list, as its attribute ``outcomes``.
        """
        view = View(self.world, task)
        # in a sweep the output is not the learner's choice, so it is not punished for being impossible
        chosen = outputs is None or reinforcement.sweep_credit == "visited"
        signals = task.signal_table(impossible=bool(chosen))
        records: list[Record] = []
        chances = Chances(seed, stage)
        lost = counted = 0
        try:
            for i in range(trials):
                if max_losses is not None and lost >= max_losses:
                    break
                fixed = None if outputs is None else int(outputs[i])
                trial = _Trial(task, weights, signals, reinforcement, fixed, learn, chances.of(first_trial + i))
                records.append(view.play(trial.rng, trial.course))
                steps, success, losses, _ = records[-1]
                # a failed trial must not look fast to the time signal, however early it ended
                taken = steps if success else self.world.limit
                trial.finish(taken, self.world.limit, counted / i if i else -1.0)
                lost, counted = lost + losses, counted + taken
        except BaseException as error:
            error.outcomes = [outcomes_of(records, self.world.limit)]  # type: ignore[attr-defined]
            raise
        return outcomes_of(records, self.world.limit)


class _Trial:
    """One trial under reinforcement of weights (sections V and VI; Table III), of one agent or of several."""

    def __init__(
        self,
        task: Task,
        weights: NDArray[np.float64],
        signals: NDArray[np.float64],
        settings: Reinforcement,
        fixed: int | None,
        learn: bool,
        rng: np.random.Generator,
    ) -> None:
        self.task, self.weights, self.signals = task, weights, signals
        self.settings, self.fixed, self.learn, self.rng = settings, fixed, learn, rng
        self.to_all = fixed is not None and settings.sweep_credit == "all"
        self.greedy = greedy_share(settings.selection, settings.q)
        self.used: dict[tuple[int, int], None] = {}

    def course(self, row: int, possible: Possible) -> Course:
        """Act and learn in one trial, as one agent."""
        last = False
        while not last:
            column = self._chosen(row, possible)
            first = (row, column) not in self.used
            self.used[row, column] = None
            if not self.to_all and (first or self.settings.credit == "decision"):
                self._signal(row, column, self.signals[row, column])
            after, possible, _, lost, last = yield column
            if lost and not self.to_all:
                self._signal(row, column, self.settings.loss_signal * lost)
            row = after
        yield -1

    def _chosen(self, row: int, possible: Possible) -> int:
        coin, u = self.rng.random(), self.rng.random()
        if possible is None:
            return rules.select(self.weights[row], self.greedy, coin, u) if self.fixed is None else self.fixed
        columns = np.flatnonzero(possible)
        if not len(columns):
            raise nothing_possible(self.task, row)
        if self.fixed is None:
            return int(columns[rules.select(self.weights[row, columns], self.greedy, coin, u)])
        if not possible[self.fixed]:
            raise TaskliftError(
                f"sweep: the world says that {self.task.output_values(self.fixed)} is impossible at "
                f"{self.task.input_values(row)}; a sweep tries every output everywhere, so use another learner here"
            )
        return self.fixed

    def _signal(self, row: int, column: int, signal: float) -> None:
        if self.learn:
            self.weights[row, column] = rules.reinforce(self.weights[row, column], signal, self.settings.floor)

    def finish(self, steps: int, limit: int, usual_steps: float) -> None:
        """Apply the global signal of the time taken, and a sweep's credit to all inputs.

        Parameters
        ----------
        steps, limit
            Of the trial.
        usual_steps
            The mean of the trials before, or below 0.
        """
        size = self.task.time_reward
        reward = 0.0
        if self.fixed is not None or self.settings.time_signal == "inverted":  # a sweep is judged by its time
            reward = rules.time_inverted(size, steps, limit)
        elif self.settings.time_signal == "baseline":
            reward = rules.time_baseline(size, steps, limit, usual_steps)
        pairs = list(self.used)
        if self.to_all and self.fixed is not None:
            pairs = [(row, self.fixed) for row in range(len(self.weights))]
        for row, column in pairs:
            self._signal(row, column, reward + (self.signals[row, column] if self.to_all else 0.0))
