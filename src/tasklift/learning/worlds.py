"""Worlds, of whole trials or met step by step, and what comes of trials.

The method meets a world through one of two protocols. A world of :class:`Trials` runs whole trials and reinforces the
weights that it is given. A world of :class:`Steps` answers one output at a time. Both speak of their own full task, by
indices; a learner may work on a simplification of it, and :class:`View` translates.

Shapes: ``S`` inputs, ``A`` outputs, ``n`` trials.
"""

from __future__ import annotations

import html
from collections.abc import Callable, Generator, Mapping, Sequence
from dataclasses import dataclass, fields, replace
from math import isfinite
from typing import Any, ClassVar, NamedTuple, Protocol, runtime_checkable

import numpy as np
from numpy.typing import NDArray

from tasklift.checks import one_of, whole_number
from tasklift.errors import TaskliftError, missing
from tasklift.style import SERIES
from tasklift.tasks.task import Task
from tasklift.text import html_picture, shown

# -- what comes of trials --------------------------------------------------------------------------------------


@dataclass(frozen=True, eq=False, repr=False)
class Outcomes:
    """What came of trials, one entry per trial, in order.

    Parameters
    ----------
    steps
        int64 (n,): how many steps each took, as the world counts them (the building search counts a failed
        trial as ``limit``, a world met step by step counts the steps that were done).
    success
        bool (n,).
    losses
        int64 (n,): what was lost in each, as the world counts it.
    limit
        The most steps that a trial may take.

    Raises
    ------
    TaskliftError
        If the arrays do not have one entry per trial each.

    Examples
    --------
    >>> import numpy as np
    >>> outcomes = Outcomes(np.array([12, 30]), np.array([True, False]), np.array([0, 2]), limit=30)
    >>> outcomes.summary()
    {'trials': 2, 'mean_steps': 21.0, 'successes': 1, 'losses': 2}
    """

    steps: NDArray[np.int64]
    success: NDArray[np.bool_]
    losses: NDArray[np.int64]
    limit: int

    def __post_init__(self) -> None:
        shapes = {np.shape(a) for a in (self.steps, self.success, self.losses)}
        if len(shapes) != 1 or not shapes.pop():
            raise TaskliftError("outcomes: steps, success and losses must have one entry per trial each")

    def __len__(self) -> int:
        return len(self.steps)

    def first(self, n: int) -> Outcomes:
        """Return the outcomes of the first ``n`` trials; of the same kind."""
        columns: dict[str, Any] = {name: column[:n] for name, column in _columns(self).items()}
        return replace(self, **columns)

    def __repr__(self) -> str:
        size = " × ".join(map(str, self.steps.shape))
        ends = f"{int(self.success.sum())} solved, {int(self.losses.sum())} lost"
        steps = f", {np.mean(self.steps):.1f} steps on average" if self.steps.size else ""
        return f"{type(self).__name__}({size} episodes: {ends}{steps})"

    def to_pandas(self) -> Any:
        """Return a ``pandas.DataFrame``: one row per episode (trial), numbered from 1, one column per measure.

        Measures of several numbers per episode, such as ``robots_left``, have a column for each:
        ``robots_left_0``, ….

        Raises
        ------
        TaskliftError
            Without pandas, or for several runs at once: take one with ``of_run``.
        """
        try:
            import pandas
        except ImportError as error:
            raise missing("pandas", "pandas", "to_pandas") from error
        if self.steps.ndim > 1:
            raise TaskliftError("to_pandas: expected the outcomes of one run, found several; take one with of_run(p)")
        columns: dict[str, Any] = {}
        for name, column in _columns(self).items():
            parts = column.reshape(len(self), -1).T if column.ndim > 1 else [column]
            columns |= {name if column.ndim == 1 else f"{name}_{i}": part for i, part in enumerate(parts)}
        return pandas.DataFrame(columns, index=pandas.RangeIndex(1, len(self) + 1, name="trial"))

    def plot(self, what: str = "losses", smooth: int = 10, ax: Any = None) -> Any:
        """Draw a measure by episode (trial), as a running mean; return the matplotlib axes.

        Parameters
        ----------
        what
            A measure, such as ``losses``, ``steps`` or ``success``.
        smooth
            Episodes in the running mean. 1: every episode as it is.
        ax
            Axes to draw on. None: new ones, of pyplot.

        Raises
        ------
        TaskliftError
            For a measure that there is not, and for several runs at once.
        """
        one_of(what, [name for name, column in _columns(self).items() if column.ndim == 1], "plot")
        smooth = whole_number(smooth, "plot, smooth", 1)
        if ax is None:
            from matplotlib import pyplot  # which notebooks show without being asked

            _, ax = pyplot.subplots(figsize=(6, 3), layout="constrained")
        values = np.asarray(getattr(self, what), dtype=float)
        width = min(smooth, max(len(values), 1))
        means = np.convolve(values, np.full(width, 1 / width), "valid") if len(values) else values
        ax.plot(np.arange(width, len(values) + 1), means, color=SERIES["blue"][0])
        ax.set(xlabel="episode", ylabel=what if width == 1 else f"{what}, mean of {width}")
        return ax

    def _repr_html_(self) -> str:
        if self.steps.ndim > 1 or not len(self):
            return html.escape(repr(self))
        from matplotlib.figure import Figure

        figure = Figure(figsize=(6, 3), layout="constrained")
        self.plot(ax=figure.subplots())
        return html_picture(repr(self), figure)

    def summary(self) -> dict[str, Any]:
        """Return trials, mean steps, successes and losses in all, as JSON data."""
        return {
            "trials": len(self),
            "mean_steps": float(np.mean(self.steps)) if len(self) else None,
            "successes": int(np.sum(self.success)),
            "losses": int(np.sum(self.losses)),
        }


@dataclass(frozen=True, eq=False, repr=False)
class StepOutcomes(Outcomes):
    """Outcomes of trials on a world with rewards: ``returns``, float64 (n,), are their undiscounted sums."""

    returns: NDArray[np.float64]


Record = tuple[int, bool, int, float]
"""Steps, success, losses and return of one trial."""


def outcomes_of(records: Sequence[Record], limit: int) -> StepOutcomes:
    """Return the outcomes of trials recorded one by one.

    Parameters
    ----------
    records
        Steps, success, losses and return of each trial.
    limit
        The most steps that a trial may take.
    """
    columns: list[Any] = list(zip(*records, strict=True)) if records else [(), (), (), ()]
    return StepOutcomes(
        steps=np.array(columns[0], dtype=np.int64),
        success=np.array(columns[1], dtype=np.bool_),
        losses=np.array(columns[2], dtype=np.int64),
        limit=limit,
        returns=np.array(columns[3], dtype=np.float64),
    )


def joined(parts: Sequence[Outcomes]) -> Outcomes:
    """Return the outcomes of consecutive parts as one; all of one kind."""
    parts = [part for part in parts if len(part)] or parts[:1]  # an empty part may lack the columns of the others
    if len(parts) == 1:
        return parts[0]
    if not parts:
        empty = np.zeros(0, dtype=np.int64)
        return Outcomes(empty, empty.astype(bool), empty, 0)
    tables = [_columns(part) for part in parts]
    columns: dict[str, Any] = {name: np.concatenate([table[name] for table in tables]) for name in tables[0]}
    return replace(parts[0], **columns)


def _columns(outcomes: Outcomes) -> dict[str, Any]:
    values = {f.name: getattr(outcomes, f.name) for f in fields(outcomes)}
    return {name: value for name, value in values.items() if isinstance(value, np.ndarray)}


# -- worlds of whole trials ------------------------------------------------------------------------------------


class Trials(Protocol):
    """A world that runs whole trials, choosing outputs by weight and reinforcing the weights as it goes."""

    @property
    def task(self) -> Task:
        """The world's full task; it also takes simplifications of it."""
        ...

    def run(
        self,
        task: Task,
        weights: NDArray[np.float64],
        *,
        trials: int,
        seed: int,
        stage: int,
        reinforcement: Any,
        outputs: NDArray[np.int64] | None = None,
        first_trial: int = 0,
        learn: bool = True,
        max_losses: int | None = None,
    ) -> Outcomes:
        """Run trials of ``task`` and update ``weights``, float64 (S, A), in place.

        Parameters
        ----------
        trials
            How many. Fewer are run if the losses reach ``max_losses`` before: no trial begins after that.
        seed, stage, first_trial
            The random key: trial ``i`` of this call is number ``first_trial + i`` of the stage, whatever ran
            before.
        reinforcement
            The rules of choice and of update: a :class:`~tasklift.learning.reinforcement.Reinforcement`. (Typed
            loosely here, because learners import worlds and not the other way round.)
        outputs
            int64 (trials,): the output of all decisions in each trial, as in a sweep; None: chosen by weight.
        learn
            False: leave the weights as they are.
        """
        ...


# -- worlds that are met step by step --------------------------------------------------------------------------


class _Answer(NamedTuple):
    input: int
    reward: float
    ended: bool
    lost: int = 0
    success: bool = False
    cut: bool = False


class Step(_Answer):
    """What a world answers to one output.

    Attributes
    ----------
    input
        The next input, an index of the world's task; not looked at if the trial has ended.
    reward
        Of this step; reinforcement of weights does not use it.
    ended
        Whether the trial is over: nothing comes after.
    lost
        How much this step lost (fell, crashed, destroyed), as the user counts it.
    success
        Whether the trial has succeeded.
    cut
        Whether the world cuts the trial off here, though it has not ended: learners take the next input's value for
        what would have come.

    Raises
    ------
    TaskliftError
        If the reward is not a finite number, or the losses are not a whole number of at least 0.

    Examples
    --------
    >>> Step(3, -1.0, ended=False)
    Step(input=3, reward=-1.0, ended=False, lost=0, success=False, cut=False)
    >>> Step(3, -1.0, ended=True, lost=0.5)
    Traceback (most recent call last):
    tasklift.errors.TaskliftError: step, lost: expected a whole number of at least 0, found 0.5; count in smaller units
    """

    __slots__ = ()

    #: Makes a step of all six, which were checked before.
    unchecked: ClassVar[Any] = classmethod(tuple.__new__)

    def __new__(
        cls, input: int, reward: float, ended: bool, lost: int = 0, success: bool = False, cut: bool = False
    ) -> Step:
        """Check what is answered."""
        if not finite(reward):
            raise TaskliftError(f"step, reward: expected a finite number, found {shown(reward)}")
        losses = count_of(lost)
        if losses < 0:
            raise TaskliftError(
                f"step, lost: expected a whole number of at least 0, found {shown(lost)}; count in smaller units"
            )
        return cls.unchecked((input, float(reward), ended, losses, success, cut))


def finite(reward: Any) -> bool:
    """Return whether a reward is a finite number."""
    try:
        return isfinite(reward)
    except (TypeError, ValueError, OverflowError):
        return False


def count_of(lost: Any) -> int:
    """Return losses as an ``int``, truth values as 0 and 1; −1 for what is not a whole number from 0 to 2³¹."""
    try:
        found = int(lost)
        return found if found == lost and 0 <= found <= 2**31 else -1
    except (TypeError, ValueError, OverflowError):
        return -1


@runtime_checkable
class Steps(Protocol):
    """A world that is met step by step; :func:`tasklift.testing.check_world` tests one.

    An optional attribute ``possible``, bool (A,) or None, says which outputs are possible at the present input, beside
    what the task says; learners choose among them.

    Several agents may share one policy: then ``start`` returns ``{agent: input}``, ``step`` takes ``{agent: output}``
    and returns ``{agent: Step}``, and ``possible`` is ``{agent: mask}``. An agent whose step has ended, or is cut, is
    left out from then on.

    Examples
    --------
    >>> from tasklift import Step, Task, Variable
    >>> class Walk:
    ...     task = Task("walk", (Variable("place", range(5)),), (Variable("go", ("left", "right")),))
    ...     limit = 50
    ...     def start(self, rng):
    ...         self.place = 0
    ...         return self.place
    ...     def step(self, output):
    ...         self.place = max(0, self.place + (1 if output else -1))
    ...         return Step(self.place, -1.0, ended=self.place == 4, success=self.place == 4)
    >>> from tasklift.testing import check_world
    >>> check_world(Walk())
    """

    @property
    def task(self) -> Task:
        """The full task, whose indices the world speaks of."""
        ...

    @property
    def limit(self) -> int:
        """The most steps of a trial; one that gets there is cut off."""
        ...

    def start(self, rng: np.random.Generator) -> int:
        """Begin a trial and return the first input; all random numbers of the trial come from ``rng``."""
        ...

    def step(self, output: int) -> Step:
        """Do one step with this output."""
        ...


Possible = NDArray[np.bool_] | None
"""Which of a task's outputs, bool (a,), are possible now; None: the world does not say."""

Experience = tuple[int, Possible, float, int, bool]
"""What came of an output: the next row (−1 where the trial has ended), the outputs possible there, reward, losses, and
whether it is the trial's last."""

Course = Generator[int, Experience, None]
"""One agent's course of a trial: yields its outputs, by column, and is sent what came of each. The answer to the last
experience is not looked at."""

Agent = Callable[[int, Possible], Course]
"""Begins a course, given the first row and the outputs possible there."""


class View:
    """A world met step by step, seen through a task that is the world's own or a simplification of it.

    Learners run their trials through it, so that what a world answers is checked in one place.

    Raises
    ------
    TaskliftError
        If the task is neither, and says which variable differs; if the world's limit is not a number of steps.
    """

    def __init__(self, world: Steps, task: Task) -> None:
        ancestor = task.ancestor(world.task)
        self.task, self.world = task, world
        self.limit = whole_number(world.limit, "world, limit", least=1)
        self._full = world.task
        self._rows: dict[int, int] = {}
        self._columns = task.output_columns(ancestor)

    def play(self, rng: np.random.Generator, agent: Agent) -> Record:
        """Run one trial in which ``agent`` decides; in a world of several agents, each has its own course of it.

        The steps are the world's. Losses and returns are sums over the agents; the trial succeeds if it does for all
        agents that are there at its end.

        Raises
        ------
        TaskliftError
            If an answer is not a :class:`Step`, or an input is one that the task leaves out.
        """
        world, columns = self.world, self._columns.tolist()
        begun = world.start(rng)
        if isinstance(begun, dict):
            return self._play_team(begun, agent)
        row = self._row(begun)
        course = agent(row, self._possible(getattr(world, "possible", None)))
        column = next(course)
        steps, losses, total, last = 0, 0, 0.0, False
        while not last:
            answer = world.step(columns[column])
            steps += 1
            experience = self._experience(answer, steps, getattr(world, "possible", None))
            losses, total, last = losses + answer.lost, total + answer.reward, experience[4]
            column = course.send(experience)
        return steps, bool(answer.success), losses, total

    def _play_team(self, inputs: dict[str, int], agent: Agent) -> Record:
        world: Any = self.world
        courses: dict[str, Course] = {}
        chosen: dict[str, int] = {}
        possible = getattr(world, "possible", None) or {}
        for name, seen in inputs.items():
            courses[name] = agent(self._row(seen), self._possible(possible.get(name)))
            chosen[name] = next(courses[name])
        steps, losses, total, success = 0, 0, 0.0, False
        while chosen:
            answers = world.step({name: int(self._columns[column]) for name, column in chosen.items()})
            if answers.keys() != chosen.keys():
                raise TaskliftError(f"world: expected answers for {shown(list(chosen))}, found {shown(list(answers))}")
            steps, possible, chosen = steps + 1, getattr(world, "possible", None) or {}, {}
            for name, answer in answers.items():
                experience = self._experience(answer, steps, possible.get(name))
                column = courses[name].send(experience)
                losses, total = losses + answer.lost, total + answer.reward
                if not experience[4]:
                    chosen[name] = column
            success = all(answer.success for answer in answers.values())
        return steps, success, losses, total

    def _experience(self, answer: Step, steps: int, possible: Any) -> Experience:
        """Return what a learner makes of a world's answer."""
        if not isinstance(answer, Step):
            raise TaskliftError(f"world, step {steps} of a trial: expected a Step, found {shown(answer)}")
        seen, reward, ended, lost, _, cut = answer
        if ended:
            return -1, None, reward, lost, True
        last = bool(cut) or steps >= self.limit
        return self._row(seen), None if possible is None else self._possible(possible), reward, lost, last

    def _row(self, input: int) -> int:
        """Return the task's row for an input of the world; rows are looked up as they turn up."""
        try:
            row = self._rows.get(input)
        except TypeError as error:
            raise TaskliftError(f"world: expected the number of an input, found {shown(input)}") from error
        if row is None:
            values = self._full.input_values(input)
            row = self.task.row_of(values)
            if row < 0:
                raise stray_input(values, self.task)
            self._rows[input] = row
        return row

    def _possible(self, mask: Any) -> NDArray[np.bool_] | None:
        """Return which of the task's outputs the world says are possible, bool (a,)."""
        if mask is None:
            return None
        possible = np.asarray(mask, np.bool_)
        if possible.shape != (self._full.shape[1],):
            raise TaskliftError(
                f"world, possible: expected a truth value for each of its {self._full.shape[1]} outputs, found "
                f"{shown(mask)}"
            )
        return possible[self._columns]


def need_world(world: Any) -> None:
    """Refuse what does not run trials, an environment of somebody else's for example."""
    if not isinstance(world, Steps) and not (hasattr(world, "task") and hasattr(world, "run")):
        raise TaskliftError(
            f"expected a world, found {shown(world)}; declare a Gymnasium environment with "
            "tasklift.envs.gymnasium.Factored, a PettingZoo one with tasklift.envs.parallel.FactoredTeam"
        )


def nothing_possible(task: Task, row: int) -> TaskliftError:
    """Return the error for an input at which the task and the world together leave no output to choose."""
    return TaskliftError(
        f"task {task.name!r}: no output is possible at {task.input_values(row)}, by the task and by what the world "
        "says (possible, info['action_mask'])"
    )


def stray_input(values: Mapping[str, Any], task: Task) -> TaskliftError:
    """Return the error for a world that shows an input which a simplified task leaves out."""
    return TaskliftError(
        f"the world gave the input {values}, which is outside of the task {task.name!r}; "
        "simplify the task less, or switch the world to its simpler version"
    )
