"""The arms of the experiment: where each starts on the full task, and what it spent before."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Literal

import numpy as np

from tasklift.building.mission import Mission
from tasklift.building.search import ENEMY_FEATURE, search_only
from tasklift.errors import TaskliftError
from tasklift.learning.chances import SWEEP_STAGE
from tasklift.learning.learner import Curve, Run
from tasklift.learning.reinforcement import Reinforcement, Sweep
from tasklift.tasks.policy import Policy, swap
from tasklift.tasks.task import Task

#: Where a hostile may wait and the team is too weak for it: the unsafe rows that prior knowledge speaks of.
UNSAFE = {"FTR": ENEMY_FEATURE, "nWPN": (0, 1)}
#: "if we know that the unsafe value requires the direct opposite of the safe value actions" (section VII)
PRIOR = (swap("MV", when=UNSAFE),)

Start = Literal["equal", "expert", "copy", "prior", "copy+prior"]


@dataclass(frozen=True)
class Arm:
    """One way to come to the full task T.

    Attributes
    ----------
    name
        As in reports.
    start
        The weights at the start of T.
    learns
        False: a reference that never changes.
    budget
        Additional trials on T before the counting starts; -1: as many as V has traversals.
    drills
        Trials against hostiles that repel instead of destroying, by exploration, before T (rule 21).
    loss_signal
        Given to the input and output with which a robot took part in a failed attack; 0 is the paper.
    selection
        Overrides the study's selection rule on T.
    meaning
        One line for readers.
    """

    name: str
    start: Start
    meaning: str
    learns: bool = True
    budget: int = 0
    drills: int = 0
    loss_signal: float = 0.0
    selection: Literal["exploration", "pseudo-random", "exploitation"] | None = None

    @property
    def needs_source(self) -> bool:
        """Whether the simple task V is learned first."""
        return self.start in ("copy", "prior", "copy+prior")

    def reinforcement(self, base: Reinforcement) -> Reinforcement:
        """Return the study's learner settings with this arm's own."""
        selection = base.selection if self.selection is None else self.selection
        return replace(base, selection=selection, loss_signal=self.loss_signal or base.loss_signal)


#: The additions of ours are compared at equal total trials: so many before the 100 on T that count.
SPENT_BEFORE = 300
LOSS_SIGNAL = -0.5


def _ours(name: str, start: Start, meaning: str, *, budget: int = 0, drills: int = 0) -> Arm:
    """An arm with the loss signal, on T at q = .9."""
    return Arm(
        name, start, meaning, budget=budget, drills=drills, loss_signal=LOSS_SIGNAL, selection="pseudo-random"
    )


ARMS: dict[str, Arm] = {
    arm.name: arm
    for arm in (
        Arm("random", "equal", "every output equally likely, never learns", learns=False),
        Arm("expert", "expert", "stops at doors until m weapon robots are there, else moves; never learns",
            learns=False),
        Arm("direct", "equal", "learns T from equal weights"),
        Arm("direct+budget", "equal", "direct, with V's traversals spent as additional trials on T", budget=-1),
        Arm("copy", "copy", "learns V, copies its weights, continues on T: the paper's indirect learning"),
        Arm("prior", "prior", "equal weights, with the prior knowledge but without V"),
        Arm("copy+prior", "copy+prior", "copy, with stop and move swapped at doors for teams too weak"),
        Arm("copy, exploitation", "copy", "copy, always taking the heaviest output (for C10)",
            selection="exploitation"),
        Arm("copy+prior, exploitation", "copy+prior", "copy+prior, always taking the heaviest output (for C10)",
            selection="exploitation"),
        _ours("direct, loss signal", "equal", "direct, punished for every loss, at q = .9"),
        _ours("direct+budget, loss signal", "equal", "the same with 300 additional trials on T before",
              budget=SPENT_BEFORE),
        _ours("drill", "equal", "300 drills (hostiles that repel), then T, with the loss signal, at q = .9",
              drills=SPENT_BEFORE),
        _ours("V→drill", "copy", "V's 220 traversals, copied, then 80 drills, then T, with the loss signal, at q = .9",
              drills=SPENT_BEFORE - 220),
    )
}  # fmt: skip


def arm_named(name: str) -> Arm:
    """Return the arm of that name, or raise :class:`TaskliftError` listing those there are."""
    if name not in ARMS:
        raise TaskliftError(f"arm {name!r} is unknown; there are: {'; '.join(ARMS)}")
    return ARMS[name]


def expert(task: Task) -> Policy:
    """Return the hand-written reference: stop at doors until m weapon robots are there, else move."""
    allowed = task.where({"MV": 1, "WPN": 0})
    unsafe = task.input_mask(UNSAFE)
    allowed[unsafe] = task.where({"MV": 0, "WPN": 0})[unsafe]
    return Policy(task, allowed.astype(np.float64), {"made_by": "expert"})


def learn_source(mission: Mission, *, repeats: int, seed: int, reinforcement: Reinforcement) -> Curve:
    """Learn the simple task V on the mission without hostiles: every output for ``repeats`` whole trials."""
    learner, task = Sweep(reinforcement, repeats), search_only(mission.task)
    return learner.learn(mission.without_hostiles(), learner.start(task), Run(seed, SWEEP_STAGE))


def start_policy(start: Start, task: Task, source: Policy | None, initial_weight: float) -> Policy:
    """Return the policy with which an arm enters the full task.

    Parameters
    ----------
    start
        As in :class:`Arm`.
    task
        The full task T.
    source
        What was learned on V; needed by ``copy``, ``prior`` and ``copy+prior``.
    initial_weight
        Of equal weights.
    """
    if start == "equal":
        return Policy.equal(task, initial_weight)
    if start == "expert":
        return expert(task)
    if source is None:
        raise TaskliftError(f"start {start!r}: expected a policy learned on the simple task, found none")
    if start == "copy":
        return source.extend(task)
    told = source.extend(task, prior=PRIOR)
    if start == "copy+prior":
        return told
    # the prior without V: what copy+prior is told about the unsafe rows, and nothing else
    weights = np.full(task.shape, initial_weight)
    unsafe = task.input_mask(UNSAFE)
    weights[unsafe] = told.weights[unsafe]
    return Policy(task, weights, {"made_by": "prior", "source": dict(told.provenance)})
