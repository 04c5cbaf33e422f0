"""Learning by reinforcement of weights, the paper's way; and the seam between a learner and its world.

The world runs trials and reinforces the weights it is given (:class:`Trials`); this module says which
trials, with which settings, and keeps a record. The paper's two procedures (Singh & Adams 2006, sections V
and VI) are :func:`sweep`, for the simple task V, and :func:`reinforce`, for the task T.

Shapes: ``S`` inputs, ``A`` outputs, ``n`` trials.
"""

from __future__ import annotations

from dataclasses import asdict, dataclass
from functools import cache
from typing import Any, Literal, Protocol, get_args, get_type_hints

import numpy as np
from numpy.typing import NDArray

import tasklift
from tasklift.errors import TaskliftError
from tasklift.tasks.policy import Policy
from tasklift.tasks.task import Task
from tasklift.tasks.variable import plain_number

SWEEP_STAGE = 1
TARGET_STAGE = 2
BUDGET_STAGE = 3
DRILL_STAGE = 4
GREEDY_STAGE = 5
"""Stages are part of every random key, so that no two stages of an experiment share their chances."""


_hints = cache(get_type_hints)  # slow, and settings are made by the thousand


@dataclass(frozen=True)
class Reinforcement:
    """The learner's settings; the defaults are the reading of the paper that the presets use.

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
        Added, once per loss, to the input and output that led to it; 0 is the paper.
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


@dataclass(frozen=True, eq=False)
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

    def summary(self) -> dict[str, Any]:
        """Return trials, mean steps, successes and losses in all, as JSON data."""
        return {
            "trials": len(self),
            "mean_steps": float(np.mean(self.steps)) if len(self) else None,
            "successes": int(np.sum(self.success)),
            "losses": int(np.sum(self.losses)),
        }


@dataclass(frozen=True)
class Curve:
    """A learned policy, and the outcome of every trial on the way to it."""

    policy: Policy
    outcomes: Outcomes


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
        reinforcement: Reinforcement,
        outputs: NDArray[np.int64] | None = None,
        first_trial: int = 0,
        learn: bool = True,
        max_losses: int | None = None,
    ) -> Outcomes:
        """Run trials of ``task`` and update ``weights``, float64 (S, A), in place.

        Parameters
        ----------
        trials
            How many. Fewer are run if the losses reach ``max_losses`` before: none begins after that.
        seed, stage, first_trial
            The random key: trial ``i`` of this call is number ``first_trial + i`` of the stage, whatever ran
            before.
        outputs
            int64 (trials,): the output held throughout each trial, as a sweep does; None: chosen by weight.
        learn
            False: leave the weights as they are.
        """
        ...


def sweep(
    world: Trials,
    task: Task,
    *,
    repeats: int = 5,
    seed: int = 0,
    reinforcement: Reinforcement = Reinforcement(),
    initial: Policy | None = None,
) -> Policy:
    """Learn the simple task by trying every output for whole trials (section V; 44 × 5 trials in the paper).

    Parameters
    ----------
    world
        Where trials run.
    task
        The simple task V; one output of it is held throughout each trial, whatever the input.
    repeats
        Times that each output is tried: all outputs once, in order, then all of them again.
    initial
        Start from this policy of ``task``; default: equal weights.
    """
    return sweep_curve(
        world, task, repeats=repeats, seed=seed, reinforcement=reinforcement, initial=initial
    ).policy


def sweep_curve(
    world: Trials,
    task: Task,
    *,
    repeats: int = 5,
    seed: int = 0,
    reinforcement: Reinforcement = Reinforcement(),
    initial: Policy | None = None,
    max_losses: int | None = None,
) -> Curve:
    """Do what :func:`sweep` does, and return the outcome of every trial as well."""
    whole_number(repeats, "sweep, repeats", at_least=1)
    start = Policy.equal(task, reinforcement.initial_weight) if initial is None else initial
    if start.task.difference(task) is not None:
        raise TaskliftError(f"sweep: the initial policy is of another task: {start.task.difference(task)}")
    outputs = np.tile(np.arange(task.shape[1], dtype=np.int64), repeats)
    return _trials(
        world, start, outputs, "sweep", len(outputs), seed, SWEEP_STAGE, 0, reinforcement, max_losses
    )


def reinforce(
    world: Trials,
    policy: Policy,
    *,
    trials: int = 100,
    seed: int = 0,
    stage: int = TARGET_STAGE,
    reinforcement: Reinforcement = Reinforcement(),
    max_losses: int | None = None,
    first_trial: int = 0,
) -> Curve:
    """Learn by reinforcement of weights, trial after trial, from a given policy (section V, task T).

    Parameters
    ----------
    policy
        Where to start; it is not changed.
    trials
        How many to run.
    stage, first_trial
        Parts of the random key: continuing a run after 100 trials takes ``first_trial=100``.
    max_losses
        No trial begins once this many losses are reached.
    """
    return _trials(
        world, policy, None, "reinforce", trials, seed, stage, first_trial, reinforcement, max_losses
    )


def _trials(
    world: Trials,
    start: Policy,
    outputs: NDArray[np.int64] | None,
    how: str,
    trials: int,
    seed: int,
    stage: int,
    first_trial: int,
    reinforcement: Reinforcement,
    max_losses: int | None,
) -> Curve:
    whole_number(trials, f"{how}, trials", at_least=0)
    whole_number(seed, f"{how}, seed", at_least=0)
    whole_number(first_trial, f"{how}, first_trial", at_least=0)
    if max_losses is not None:
        whole_number(max_losses, f"{how}, max_losses", at_least=1)
    if start.kind != "weight":
        raise TaskliftError(f"{how}: expected a policy of weights, found one of {start.kind}s")
    weights = start.weights.copy()
    outcomes = world.run(
        start.task,
        weights,
        trials=trials,
        seed=seed,
        stage=stage,
        reinforcement=reinforcement,
        outputs=outputs,
        first_trial=first_trial,
        max_losses=max_losses,
    )
    provenance = {
        "learned_by": how,
        "tasklift": tasklift.__version__,
        "task": start.task.name,
        "seed": seed,
        "stage": stage,
        "first_trial": first_trial,
        "trials_asked": trials,
        "max_losses": max_losses,
        "reinforcement": asdict(reinforcement),
        "outcomes": outcomes.summary(),
        "before": dict(start.provenance),
    }
    return Curve(Policy(start.task, weights, provenance, start.kind, start.carried), outcomes)


def whole_number(value: Any, what: str, at_least: int) -> None:
    """Refuse ``value`` unless it is a whole number of at least ``at_least``; errors name ``what``."""
    if isinstance(value, bool) or not isinstance(value, int | np.integer) or value < at_least:
        raise TaskliftError(f"{what}: expected a whole number of at least {at_least}, found {value!r}")
