"""A mission: a building, a team, hidden hostiles and the world's rules. What policies are trained on."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from typing import TYPE_CHECKING, Any

import numpy as np

from tasklift.building.graph import FEATURE, Building
from tasklift.building.reading import Reading
from tasklift.building.search import hostile_candidates, search_and_clear
from tasklift.building.team import Kind, parse_team
from tasklift.errors import TaskliftError
from tasklift.tasks.task import Task

if TYPE_CHECKING:
    from tasklift.building.simulator import SearchOutcomes, Simulator

#: The largest step limit: draws are numbered with 32 bits.
LARGEST_LIMIT = 10**9


@dataclass(frozen=True, eq=False)
class Mission:
    """A building, a team, hidden hostiles and the rules they live by. A world that policies are trained on.

    It implements :class:`tasklift.learning.reinforcement.Trials`.

    Parameters
    ----------
    building : Building
        Where.
    team : str or mapping
        ``"10+5"`` (scouts + weapon robots), or how many robots of each :class:`Kind`, as
        :func:`~tasklift.building.team.parse_team` takes it. Robots are numbered in this order.
    hostiles : int or sequence of int
        How many, hidden at random at doors that are not next to the start (rule 14). Or the nodes of the
        features that they stand at.
    reading : Reading
        The world's rules.
    weapons_needed : int
        The paper's m: the number of weapon robots that destroy a hostile (at least 1).
    limit : int
        Steps after which an episode (trial) has failed (at least 1).

    Raises
    ------
    TaskliftError
        If there is no robot, if no team could ever destroy a hostile, or if there is no place to hide them.

    Examples
    --------
    >>> from tasklift.building import generate
    >>> hunt = Mission(generate(seed=7), team="10+5", hostiles=1)
    >>> hunt.n_robots, hunt.task.shape
    (15, (90, 44))
    >>> hunt.without_hostiles().n_hostiles
    0
    """

    building: Building
    team: Mapping[Kind, int]
    hostiles: int | tuple[int, ...] = 1
    reading: Reading = field(default_factory=Reading)
    weapons_needed: int = 2
    limit: int = 600

    if TYPE_CHECKING:  # what may be given is more than what is kept

        def __init__(
            self,
            building: Building,
            team: str | Mapping[Any, int],
            hostiles: int | Sequence[int] = 1,
            reading: Reading = ...,
            weapons_needed: int = 2,
            limit: int = 600,
        ) -> None: ...

    def __post_init__(self) -> None:
        if not isinstance(self.building, Building):
            raise TaskliftError(f"mission: expected a Building, found {self.building!r}")
        if not isinstance(self.reading, Reading):
            raise TaskliftError(f"mission: expected a Reading, found {self.reading!r}")
        object.__setattr__(self, "team", parse_team(self.team))
        _check_count("weapons_needed", self.weapons_needed, 1, LARGEST_LIMIT)
        _check_count("limit", self.limit, 1, LARGEST_LIMIT)
        self._check_hostiles()

    def _check_hostiles(self) -> None:
        if isinstance(self.hostiles, Sequence | np.ndarray) and not isinstance(self.hostiles, str):
            for node in self.hostiles:
                _check_count("hostiles, node", node, 0, self.building.n_nodes - 1)
                if self.building.kind[node] != FEATURE:
                    raise TaskliftError(f"hostiles: node {node} of {self.building.name!r} is not a feature")
            object.__setattr__(self, "hostiles", tuple(int(node) for node in self.hostiles))
            if len(set(self.hostiles)) < len(self.hostiles):
                raise TaskliftError("hostiles: at most one per feature, found a node twice")
        else:
            _check_count("hostiles", self.hostiles, 0)
            places = len(hostile_candidates(self.building))
            if self.n_hostiles > places:
                raise TaskliftError(
                    f"hostiles: asked for {self.hostiles}, but {self.building.name!r} has {places} door(s) that are "
                    "not next to the start; ask for fewer, add doors, or name the features they stand at"
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
        """The paper's task T (Table I)."""
        return search_and_clear()

    def without_hostiles(self) -> Mission:
        """Return the safe version: the same building and team, nothing hidden, hence nothing to suspect."""
        return dataclasses.replace(self, hostiles=0)

    def with_reading(self, **options: Any) -> Mission:
        """Return the same mission under a reading with some options changed."""
        return dataclasses.replace(self, reading=dataclasses.replace(self.reading, **options))

    @cached_property
    def simulator(self) -> Simulator:
        """The compiled world of this mission."""
        from tasklift.building.simulator import Simulator

        return Simulator(self)

    @property
    def run(self) -> Callable[..., SearchOutcomes]:
        """Run trials, as :class:`~tasklift.learning.reinforcement.Trials` asks: :meth:`Simulator.run`."""
        return self.simulator.run


def _check_count(where: str, value: object, least: int, most: int | None = None) -> None:
    whole = isinstance(value, int | np.integer) and not isinstance(value, bool)
    if not whole or value < least or (most is not None and value > most):  # type: ignore[operator]
        bounds = f"of at least {least}" if most is None else f"from {least} to {most}"
        raise TaskliftError(f"{where}: expected a whole number {bounds}, found {value!r}")
