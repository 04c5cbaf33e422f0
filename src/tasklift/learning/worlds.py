"""Worlds, of whole trials or met step by step, and what comes of trials.

The method meets a world through one of two protocols. A world of :class:`Trials` runs whole trials and reinforces the
weights that it is given. A world of :class:`Steps` answers one output at a time. Both speak of their own full task, by
indices; a learner may work on a simplification of it, and :class:`View` translates.

Shapes: ``S`` inputs, ``A`` outputs, ``n`` trials.
"""

from __future__ import annotations

import html
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, fields, replace
from typing import Any, NamedTuple, Protocol, runtime_checkable

import numpy as np
from numpy.typing import NDArray

from tasklift.checks import one_of, whole_number
from tasklift.errors import TaskliftError, missing
from tasklift.style import SERIES
from tasklift.tasks.task import Task
from tasklift.text import html_picture

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


class Step(NamedTuple):
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
    """

    input: int
    reward: float
    ended: bool
    lost: int = 0
    success: bool = False
    cut: bool = False


@runtime_checkable
class Steps(Protocol):
    """A world that is met step by step; :func:`tasklift.testing.check_world` tests one.

    An optional attribute ``possible``, bool (A,) or None, says which outputs are possible at the present input, beside
    what the task says; learners by value choose among them.

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


class View:
    """A world seen through a task that is the world's own or a simplification of it.

    Raises
    ------
    TaskliftError
        If the task is neither; says which variable differs.
    """

    def __init__(self, world: Steps, task: Task) -> None:
        ancestor = task.ancestor(world.task)
        self.task = task
        self._full = world.task
        self._rows: dict[int, int] = {}
        self.columns: list[int] = task.output_columns(ancestor).tolist()

    def row(self, input: int) -> int:
        """Return the task's row for an input of the world; rows are looked up as they turn up.

        Raises
        ------
        TaskliftError
            If the task leaves that input out.
        """
        if input not in self._rows:
            values = self._full.input_values(input)
            row = self.task.row_of(values)
            if row < 0:
                raise stray_input(values, self.task)
            self._rows[input] = row
        return self._rows[input]


def stray_input(values: Mapping[str, Any], task: Task) -> TaskliftError:
    """Return the error for a world that shows an input which a simplified task leaves out."""
    return TaskliftError(
        f"the world gave the input {values}, which is outside of the task {task.name!r}; "
        "simplify the task less, or switch the world to its simpler version"
    )
