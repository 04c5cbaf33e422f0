"""Several missions as one world: for policies that are to work in more than one building."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from tasklift.building.mission import Mission
from tasklift.building.outcomes import SearchOutcomes
from tasklift.errors import TaskliftError
from tasklift.learning.worlds import joined
from tasklift.tasks.task import Task


@dataclass(frozen=True, eq=False)
class Missions:
    """Missions that take turns: trial ``i`` is played on mission ``i`` modulo their number.

    It is a world of whole episodes (:class:`.Trials`), so whatever learns on a mission learns on several.

    Parameters
    ----------
    missions : sequence of Mission
        At least one, with the same kinds of robots, inputs and outputs. Each runs a trial with the random numbers that
        it would have by itself.

    Raises
    ------
    TaskliftError
        If there is none, or they differ in the kinds of their robots, in inputs or in outputs.

    Examples
    --------
    >>> from tasklift.building import generate
    >>> world = Missions([Mission(generate(seed=seed), "10+5") for seed in range(3)])
    >>> world.task.shape
    (90, 44)
    """

    missions: Sequence[Mission]

    def __repr__(self) -> str:
        return f"Missions({len(self.missions)}, the first one {self.missions[0]!r})"

    def __post_init__(self) -> None:
        object.__setattr__(self, "missions", tuple(self.missions))
        if not self.missions:
            raise TaskliftError("missions: expected at least one, found none")
        if len({tuple(mission.team) for mission in self.missions}) > 1:
            raise TaskliftError("missions: expected teams of the same kinds of robots")
        if len({(mission.inputs, mission.outputs) for mission in self.missions}) > 1:
            raise TaskliftError("missions: expected the same inputs and outputs in all of them")

    @property
    def task(self) -> Task:
        """The task of each mission."""
        return self.missions[0].task

    def run(
        self,
        task: Task,
        weights: NDArray[np.float64],
        *,
        trials: int,
        first_trial: int = 0,
        outputs: NDArray[np.int64] | None = None,
        max_losses: int | None = None,
        **key: Any,
    ) -> SearchOutcomes:
        """Run trials one after another; see :meth:`.Trials.run`."""
        parts: list[Any] = []
        lost = 0
        for i in range(first_trial, first_trial + trials):
            if max_losses is not None and lost >= max_losses:
                break
            own = None if outputs is None else outputs[i - first_trial : i - first_trial + 1]
            parts.append(self._of(i).run(task, weights, trials=1, first_trial=i, outputs=own, **key))
            lost += int(parts[-1].losses.sum())
        if not parts:
            return self.missions[0].run(task, weights, trials=0, first_trial=first_trial, **key)
        found: Any = joined(parts)
        return found

    def run_many(
        self, task: Task, weights: NDArray[np.float64], *, trials: int, first_trial: int = 0, **key: Any
    ) -> SearchOutcomes:
        """Run the same trials with many policies; see :meth:`.Simulator.run_many`."""
        parts: list[Any] = [
            self._of(i).run_many(task, weights, trials=1, first_trial=i, **key)
            for i in range(first_trial, first_trial + trials)
        ]
        columns = {
            name: np.concatenate([getattr(part, name) for part in parts], axis=1)
            for name, value in vars(parts[0]).items()
            if isinstance(value, np.ndarray)
        }
        return SearchOutcomes(**columns, limit=max(part.limit for part in parts))

    def _of(self, trial: int) -> Mission:
        return self.missions[trial % len(self.missions)]
