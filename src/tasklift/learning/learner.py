"""What a learner is, which trials it is asked for, and what it gives back.

A stage of a curriculum is handed a learner (:class:`Learner`). The learners here and a class of a user's own are equal
citizens: a curriculum knows the methods below and nothing else of them.
"""

from __future__ import annotations

import json
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import asdict, dataclass, fields, is_dataclass, replace
from typing import Any, Protocol

import numpy as np

import tasklift
from tasklift.checks import LARGEST_WHOLE, whole_number
from tasklift.errors import TaskliftError
from tasklift.learning.chances import TARGET_STAGE, Chances
from tasklift.learning.worlds import Outcomes, Record, Steps, Trials, joined
from tasklift.tasks.policy import Policy
from tasklift.tasks.task import Task
from tasklift.text import shown

MOST_TRIALS = 10_000_000
"""In a run: what came of them is in memory at the end."""


@dataclass(frozen=True)
class Run:
    """Which trials to learn from: the random key and the budget.

    Parameters
    ----------
    seed, stage
        The random key, with the number of the trial.
    first_trial
        Number of the first trial within the stage. A run that goes on after 100 trials has 100 here.
    trials, steps
        The budget, one or both: how many trials; no trial begins once this many steps are done. With neither, the
        budget is the learner's own, as a sweep's.
    max_losses
        No trial begins once this many losses are reached.

    Raises
    ------
    TaskliftError
        If a number is not whole, or too small.

    Examples
    --------
    >>> Run(seed=3, trials=100, max_losses=20).after(trials=40, steps=900, losses=6)
    Run(seed=3, stage=2, first_trial=40, trials=60, steps=None, max_losses=14)
    """

    seed: int = 0
    stage: int = TARGET_STAGE
    first_trial: int = 0
    trials: int | None = None
    steps: int | None = None
    max_losses: int | None = None

    def __post_init__(self) -> None:
        for name in ("seed", "stage", "first_trial"):
            whole_number(getattr(self, name), f"run, {name}", least=0)
        for name, least, most in (
            ("trials", 0, MOST_TRIALS), ("steps", 0, LARGEST_WHOLE), ("max_losses", 1, LARGEST_WHOLE)
        ):  # fmt: skip
            if getattr(self, name) is not None:
                whole_number(getattr(self, name), f"run, {name}", least, most)

    def goes_on(self, trials: int, steps: int, losses: int) -> bool:
        """Return whether another trial may begin after this many trials, steps and losses."""
        limits = ((self.trials, trials), (self.steps, steps), (self.max_losses, losses))
        return all(limit is None or done < limit for limit, done in limits)

    def play(
        self,
        trial: Callable[[np.random.Generator], Record],
        records: list[Record] | None = None,
        stop: Callable[[Record], bool] | None = None,
    ) -> list[Record]:
        """Run a function for each trial until the budget is used, and return what it recorded.

        Parameters
        ----------
        trial
            Runs one trial with the generator of that trial; returns its steps, success, losses and return.
        records
            An empty list to record in, for whoever wants what was done before an error.
        stop
            Asked after each trial; True ends the run before its budget is used.
        """
        records = [] if records is None else records
        chances = Chances(self.seed, self.stage)
        steps = losses = 0
        while self.goes_on(len(records), steps, losses):
            records.append(trial(chances.of(self.first_trial + len(records))))
            steps, losses = steps + records[-1][0], losses + records[-1][2]
            if stop is not None and stop(records[-1]):
                break
        return records

    def after(self, trials: int, steps: int, losses: int) -> Run:
        """Return the rest of a run of which this much is done; ask :meth:`goes_on` before."""
        return replace(
            self,
            first_trial=self.first_trial + trials,
            trials=None if self.trials is None else self.trials - trials,
            steps=None if self.steps is None else self.steps - steps,
            max_losses=None if self.max_losses is None else self.max_losses - losses,
        )


    def rest(self, parts: Sequence[Outcomes]) -> Run | None:
        """Return what is left of the run after these outcomes; None if no further trial may begin.

        Examples
        --------
        >>> from tasklift.learning.worlds import outcomes_of
        >>> run, parts = Run(trials=3), []
        >>> while (left := run.rest(parts)) is not None:
        ...     parts.append(outcomes_of([(12, True, 0, 1.0)], limit=30))  # learn from trial left.first_trial
        >>> len(parts)
        3
        """
        done = (
            sum(len(part) for part in parts),
            sum(int(part.steps.sum()) for part in parts),
            sum(int(part.losses.sum()) for part in parts),
        )
        return self.after(*done) if self.goes_on(*done) else None


def run_of(what: str, options: Mapping[str, Any]) -> Run:
    """Return the run that a function's further options describe, or name the one that there is not.

    Parameters
    ----------
    what
        The function, for the message.
    options
        By name.
    """
    known = [field.name for field in fields(Run)]
    for name in options:
        if name not in known:
            raise TaskliftError(f"{what}: unknown option {name!r}; the run takes {', '.join(known)}")
    return Run(**options)


@dataclass(frozen=True)
class Curve:
    """A learned policy, and the outcome of every trial on the way to it."""

    policy: Policy
    outcomes: Outcomes

    def __repr__(self) -> str:
        return f"Curve({self.outcomes!r})"

    def to_pandas(self) -> Any:
        """Return a ``pandas.DataFrame``, one row per episode (trial): :meth:`.Outcomes.to_pandas`."""
        return self.outcomes.to_pandas()

    def plot(self, what: str = "losses", smooth: int = 10, ax: Any = None) -> Any:
        """Draw a measure by episode (trial); return the matplotlib axes: :meth:`.Outcomes.plot`."""
        return self.outcomes.plot(what, smooth, ax)

    def _repr_html_(self) -> str:
        return self.outcomes._repr_html_()


@contextmanager
def keeping(curve: Callable[[], object]) -> Iterator[None]:
    """Give what is raised within the block, Ctrl-C too, what was learned until then, as its attribute ``curve``."""
    try:
        yield
    except BaseException as error:
        error.curve = curve()  # type: ignore[attr-defined]
        raise


class Learner(Protocol):
    """A way to learn. ``examples/own_learner.py`` has one in 30 lines; :func:`tasklift.testing.check_learner` tests it.

    Three members are optional. ``check(world, task, run)`` raises :class:`TaskliftError` for what it cannot learn; a
    curriculum asks it before anything is trained. ``divisible = False``: a run that is cut into shorter ones may come
    out differently, so a curriculum runs each stage in one piece. ``count_as(policy, trust)`` returns the policy with
    the experience copied into it counted as ``trust`` (above 0) says; a stage with ``trust`` asks for it.
    """

    def start(self, task: Task) -> Policy:
        """Return the policy that learning from scratch starts with."""
        ...

    def learn(self, world: Trials | Steps, policy: Policy, run: Run) -> Curve:
        """Learn from the trials of ``run``, beginning with ``policy``, which is not changed.

        Trial ``i`` of the run is number ``run.first_trial + i`` of its stage. All its random numbers are keyed by
        that number, the seed and the stage (:class:`~tasklift.learning.chances.Chances`), so that the same run gives
        the same curve. What a learner must remember from run to run is in :attr:`.Policy.carried`.
        """
        ...


@dataclass(frozen=True)
class InTurn:
    """Learners one after another within a stage, by the number of the trial.

    Parameters
    ----------
    learners
        At least one; all learn the same kind of policy.
    starts
        The trial with which each begins, counted from 0; the first one is 0.

    Raises
    ------
    TaskliftError
        If there is not one start per learner, or they do not grow from 0.

    Examples
    --------
    Exploration for 100 trials, then mostly the best output:

    >>> from tasklift import InTurn, Reinforcement
    >>> bold, careful = Reinforcement(), Reinforcement(selection="pseudo-random", q=0.9)
    >>> learner = InTurn((bold, careful), (0, 100))
    """

    learners: tuple[Learner, ...]
    starts: tuple[int, ...]

    def __post_init__(self) -> None:
        object.__setattr__(self, "learners", tuple(self.learners))
        object.__setattr__(self, "starts", tuple(self.starts))
        ordered = all(a < b for a, b in zip(self.starts, self.starts[1:], strict=False))
        if not self.learners or len(self.learners) != len(self.starts) or self.starts[0] != 0 or not ordered:
            raise TaskliftError(
                f"learners in turn: expected one start per learner, growing from 0, found {len(self.learners)} "
                f"learners and the starts {list(self.starts)}"
            )

    @property
    def divisible(self) -> bool:
        """Whether all the learners are."""
        return all(divisible(learner) for learner in self.learners)

    def check(self, world: Trials | Steps, task: Task, run: Run) -> None:
        """Raise :class:`TaskliftError` for what one of the learners cannot learn."""
        if run.trials is None and run.steps is None:
            raise TaskliftError("learners in turn: have no budget of their own; give trials= or steps=")
        for learner in self.learners:
            check(learner, world, task, run)

    def start(self, task: Task) -> Policy:
        """Return the first learner's start."""
        return self.learners[0].start(task)

    def count_as(self, policy: Policy, trust: float) -> Policy:
        """Return the policy as the first learner counts it."""
        return count_as(self.learners[0], policy, trust)

    def learn(self, world: Trials | Steps, policy: Policy, run: Run) -> Curve:
        """Learn from the trials of ``run``, each by the learner whose turn it is."""
        self.check(world, policy.task, run)
        parts: list[Outcomes] = []
        for learner, end in zip(self.learners, (*self.starts[1:], None), strict=True):
            left = run.rest(parts)
            if left is None:
                break
            if end is not None and end <= left.first_trial:
                continue
            turn = [n for n in (left.trials, None if end is None else end - left.first_trial) if n is not None]
            curve = learner.learn(world, policy, replace(left, trials=min(turn, default=None)))
            policy = curve.policy
            parts.append(curve.outcomes)
        return Curve(policy, joined(parts))


def divisible(learner: Learner) -> bool:
    """Return whether a run by this learner may be cut into shorter ones: yes, unless it says no."""
    return bool(getattr(learner, "divisible", True))


def check(learner: Learner, world: Trials | Steps, task: Task, run: Run) -> None:
    """Refuse anything but a learner, and let one that has a ``check`` refuse what it cannot learn, before training."""
    if isinstance(learner, type) or not all(callable(getattr(learner, name, None)) for name in ("start", "learn")):
        raise TaskliftError(
            f"expected a learner, with start() and learn(), found {shown(learner)}; "
            "ValueLearning() learns from a world's rewards, Reinforcement() from a task's signals"
        )
    refuse = getattr(learner, "check", None)
    if refuse is not None:
        refuse(world, task, run)


def count_as(learner: Learner, policy: Policy, trust: float) -> Policy:
    """Return a policy with its copied experience counted as ``trust`` says.

    Raises
    ------
    TaskliftError
        If the learner cannot weigh experience.
    """
    weigh = getattr(learner, "count_as", None)
    if weigh is None:
        raise TaskliftError(f"trust: a {type(learner).__name__} cannot weigh what was copied (it has no count_as())")
    counted: Policy = weigh(policy, trust)
    return counted


def settings_of(learner: Learner) -> dict[str, Any]:
    """Return a learner's settings as JSON data, for the provenance of what it learns: a dataclass's fields."""
    found: dict[str, Any] = asdict(learner) if is_dataclass(learner) and not isinstance(learner, type) else {}
    try:
        json.dumps(found)
    except (TypeError, ValueError):
        return {name: repr(value) for name, value in found.items()}
    return found


def provenance(learned_by: str, learner: Learner, policy: Policy, run: Run, outcomes: Outcomes) -> dict[str, Any]:
    """Return the provenance of what ``learner`` made of ``policy`` in a run."""
    return {
        "learned_by": learned_by,
        "tasklift": tasklift.__version__,
        "task": policy.task.name,
        **asdict(run),
        "settings": settings_of(learner),
        "outcomes": outcomes.summary(),
        "before": dict(policy.provenance),
    }
