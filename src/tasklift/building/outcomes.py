"""What comes of a building search: outcomes of episodes (trials), and one episode step by step."""

from __future__ import annotations

from dataclasses import dataclass, fields
from typing import Any

import numpy as np
from numpy.typing import NDArray

from tasklift.building.setting import Setting
from tasklift.learning.worlds import Outcomes
from tasklift.tasks.task import Task
from tasklift.text import shown


@dataclass(frozen=True, eq=False, repr=False)
class SearchOutcomes(Outcomes):
    """What came of ``n`` episodes (trials) of a building search: of one run, or of ``P`` runs side by side.

    Every array has the shape ``(n,)`` or ``(P, n)``, ``robots_left`` one axis more.

    Attributes
    ----------
    robots_left : int64 (..., kinds)
        The living at the end, in the order of the mission's team.
    teams_left : int64
        Teams among them.
    hostiles_left : int64
        Hostiles that were not destroyed.
    explored : float64
        Share of the building's edges that some robot, living or lost, has travelled.
    messages : int64
        Alerts heard plus poolings of maps that taught someone something (rule 11).
    """

    robots_left: NDArray[np.int64]
    teams_left: NDArray[np.int64]
    hostiles_left: NDArray[np.int64]
    explored: NDArray[np.float64]
    messages: NDArray[np.int64]

    def of_run(self, p: int) -> SearchOutcomes:
        """Return the outcomes of run ``p`` of several, each array of shape ``(n,)``."""
        parts = {f.name: getattr(self, f.name) for f in fields(self)}
        return SearchOutcomes(**{n: part[p] if isinstance(part, np.ndarray) else part for n, part in parts.items()})


@dataclass(frozen=True, eq=False)
class Trace:
    """One trial, step by step: frame 0 is the start, frame ``t`` the world after step ``t``; ``F`` frames.

    Attributes
    ----------
    mission
        Where it happened.
    task, learner
        What was learned, and the compiled rules by which the weights changed.
    seed, trial
        The random key, with the stage.
    success
        How it ended.
    weights
        ``float64 (S, A)``: at the start of the trial.
    robots
        Records ``(F, R)`` with the fields of :data:`tasklift.building.layout.ROBOT` and ``since``. Among them:
        ``alive``, ``node`` (the last), ``half`` (-1 at a node), ``progress`` (mm), ``dl``, ``alert``, ``row`` (input
        of the full task), ``pair_row`` and ``out`` (row and output of the last decision, in the learned task),
        ``since`` (steps since then, 1: decided in this step), ``team``.
    hostile, resolved
        ``bool (F, N)``: where a hostile stands; which features are resolved.
    failed
        ``bool (F, N)``: where an attack failed in this step.
    unsearched
        ``int64 (F, N)``: steps of search left in each room.
    visited
        ``bool (F, E)``: edges travelled by anyone.
    messages, losses
        ``int64 (F,)``: counted so far.
    """

    mission: Setting
    task: Task
    learner: Any
    seed: int
    trial: int
    success: bool
    weights: NDArray[np.float64]
    robots: NDArray[Any]
    hostile: NDArray[np.bool_]
    resolved: NDArray[np.bool_]
    failed: NDArray[np.bool_]
    unsearched: NDArray[np.int64]
    visited: NDArray[np.bool_]
    messages: NDArray[np.int64]
    losses: NDArray[np.int64]

    def __repr__(self) -> str:
        end = f"{'solved' if self.success else 'not solved'} in {self.steps} steps, {int(self.losses[-1])} lost"
        return f"Trace({shown(self.mission.building.name)}, episode {self.trial + 1}, seed {self.seed}: {end})"

    @property
    def steps(self) -> int:
        """Steps that were run."""
        return len(self.robots) - 1
