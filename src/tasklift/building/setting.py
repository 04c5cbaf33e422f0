"""A setting: a building, a team, hidden hostiles and the world's rules, checked. What the simulator compiles."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any

import numpy as np

from tasklift.building.graph import FEATURE, Building
from tasklift.building.reading import Reading
from tasklift.building.search import hostile_candidates, search_and_clear
from tasklift.building.team import Kind
from tasklift.building.terms import parse_terms
from tasklift.building.variables import TABLE_I, TABLE_I_OUTPUTS, Sensor
from tasklift.checks import whole_number
from tasklift.errors import TaskliftError
from tasklift.tasks.task import Task
from tasklift.text import one_line, shown


@dataclass(frozen=True, eq=False)
class Setting:
    """A building, a team, hidden hostiles and the rules they live by. :class:`.Mission` is one that can be run.

    The parameters, their checks and an example stand at :class:`.Mission`.
    """

    building: Building
    team: Mapping[Kind, int]
    hostiles: int | tuple[int, ...] = 1
    reading: Reading = field(default_factory=Reading)
    weapons_needed: int = 2
    limit: int = 600
    inputs: tuple[Sensor, ...] = TABLE_I  # type: ignore[assignment]
    outputs: tuple[str, ...] = TABLE_I_OUTPUTS

    if TYPE_CHECKING:  # what may be given is more than what is kept

        def __init__(
            self,
            building: Building,
            team: str | Mapping[Any, int],
            hostiles: int | Sequence[int] = 1,
            reading: Reading = ...,
            weapons_needed: int = 2,
            limit: int = 600,
            inputs: Sequence[str | Sensor] = ...,
            outputs: Sequence[str] = ...,
        ) -> None: ...

    def __repr__(self) -> str:
        team = "+".join(f"{n} {kind.name}" for kind, n in list(self.team.items())[:3])
        team += ", …" if len(self.team) > 3 else ""
        hostiles = f"{self.n_hostiles} hostile{'' if self.n_hostiles == 1 else 's'}"
        rules = [] if self.reading == Reading() else [one_line(self.reading, 70)]
        parts = [shown(self.building.name, 40), one_line(team, 50), hostiles, *rules]
        return f"{type(self).__name__}({', '.join(parts)})"

    def __post_init__(self) -> None:
        if not isinstance(self.building, Building):
            raise TaskliftError(f"mission: expected a Building, found {shown(self.building)}")
        if not isinstance(self.reading, Reading):
            raise TaskliftError(f"mission: expected a Reading, found {shown(self.reading)}")
        parse_terms(self)
        self._check_hostiles()

    def _check_hostiles(self) -> None:
        if isinstance(self.hostiles, list | tuple) or (isinstance(self.hostiles, np.ndarray) and self.hostiles.ndim):
            for node in self.hostiles:
                whole_number(node, "hostiles, node", 0, self.building.n_nodes - 1)
                if self.building.kind[node] != FEATURE:
                    raise TaskliftError(f"hostiles: node {node} of {self.building.name!r} is not a feature")
            object.__setattr__(self, "hostiles", tuple(int(node) for node in self.hostiles))
            if len(set(self.hostiles)) < len(self.hostiles):
                raise TaskliftError("hostiles: at most one per feature, found a node twice")
        else:
            whole_number(self.hostiles, "hostiles")
            places = len(hostile_candidates(self.building))
            if self.n_hostiles > places:
                raise TaskliftError(
                    f"hostiles: asked for {self.hostiles}, but {self.building.name!r} has {places} place(s) for "
                    "them: doors (other features if it has none) not next to the start; ask for fewer, add doors, or "
                    "name the features they stand at"
                )
        armed = sum(number for kind, number in self.team.items() if kind.armed)
        if self.n_hostiles and self.weapons_needed > armed:
            raise TaskliftError(
                f"weapons_needed: a hostile needs {self.weapons_needed} weapon robots, the team has {armed}; "
                "no team could ever succeed"
            )

    @property
    def n_robots(self) -> int:
        """Number of robots, ``R``."""
        return sum(self.team.values())

    @property
    def n_hostiles(self) -> int:
        """Number of hostiles at the start of a trial."""
        return self.hostiles if isinstance(self.hostiles, int) else len(self.hostiles)

    @property
    def task(self) -> Task:
        """The paper's task T (Table I), or the one with the variables that were chosen."""
        return search_and_clear(self.inputs, self.outputs)
