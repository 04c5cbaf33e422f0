"""What is to be done, by whom, under which rules: kinds of robots, the Reading, and the paper's two tasks.

The paper (Singh & Adams, ICRA 2006) leaves many details of its world open. :class:`Reading` names each of them
as an option with a default and alternatives; ``docs/reading.md`` tells which sentence of the paper each rests on.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from functools import cache, cached_property
from typing import TYPE_CHECKING, Any, Literal, get_args, get_type_hints

from tasklift.building.graph import DOOR, FEATURE, Building
from tasklift.errors import TaskliftError
from tasklift.tasks.task import Signal, Task, Variable

if TYPE_CHECKING:
    from tasklift.building.simulator import SearchOutcomes, Simulator


_hints = cache(get_type_hints)  # slow, and readings are made by the thousand


@dataclass(frozen=True, order=True)
class Kind:
    """A kind of robot.

    Parameters
    ----------
    name
        What to call it.
    speed_mm
        Millimetres per step, a positive whole number (motion is exact integer arithmetic).
    armed
        Whether it counts as a weapon robot.
    """

    name: str
    speed_mm: int
    armed: bool

    def __post_init__(self) -> None:
        if not isinstance(self.speed_mm, int) or isinstance(self.speed_mm, bool) or self.speed_mm <= 0:
            raise TaskliftError(
                f"kind {self.name!r}: speed_mm must be a whole number of millimetres per step above 0, "
                f"found {self.speed_mm!r}"
            )


#: The paper's two kinds (section VI: velocities 1.5 and 1.0).
SCOUT = Kind("scout", 1500, armed=False)
WEAPON = Kind("weapon", 1000, armed=True)


@dataclass(frozen=True)
class Reading:
    """The world's rules where the paper leaves them open. Numbers in brackets: the rules of ``docs/reading.md``.

    Attributes
    ----------
    decide
        [5] ``robot``: each robot draws its own output; ``team``: the lowest-numbered member draws for all.
    patience
        [6] A robot decides anew after so many steps without a decision (steps, at least 1).
    split
        [7] ``robots``: each leaving robot draws its own edge; ``pairs``: a leaving team divides over at most two
        edges; ``team``: later robots follow an earlier robot's choice that is open to them.
    turn_back
        [8] Whether the edge just used is open to a robot whose goal lies elsewhere.
    explore
        [8] ``unvisited-first``: without a goal, edges missing from the robot's own map come first;
        ``memoryless``: they do not.
    goal_sharpness
        [9] Exponent on the distance in GolC (dimensionless, at least 0).
    engage
        [10] Whom a crossing engages: ``team``: everyone at the node; ``crossing``: those who cross in this step.
    alert_range_m
        [11] How far a suspicion is heard (m, straight line).
    suspicion_goal
        [11] Whether a suspected feature is the goal of the robots that hear of it.
    share_map
        [12] Who pools maps: the robots of a ``team``, all of them by ``radio``, or ``none``.
    relocate
        [14] Whether the hostiles are placed afresh in every trial.
    drill
        [21] Hostiles repel instead of destroying (an addition of ours).
    search_rate_m2
        [13] Floor area that is searched per step (m²).
    """

    decide: Literal["robot", "team"] = "robot"
    patience: int = 60
    split: Literal["robots", "pairs", "team"] = "robots"
    turn_back: bool = False
    explore: Literal["unvisited-first", "memoryless"] = "unvisited-first"
    goal_sharpness: float = 1.0
    engage: Literal["team", "crossing"] = "team"
    alert_range_m: float = 10.0
    suspicion_goal: bool = True
    share_map: Literal["team", "radio", "none"] = "team"
    relocate: bool = False
    drill: bool = False
    search_rate_m2: float = 4.0

    def __post_init__(self) -> None:
        for name, hint in _hints(Reading).items():
            value = getattr(self, name)
            options = get_args(hint)
            if options and value not in options:
                raise TaskliftError(f"reading, {name}: expected one of {', '.join(options)}, found {value!r}")
            if hint is bool and not isinstance(value, bool):
                raise TaskliftError(f"reading, {name}: expected true or false, found {value!r}")
            if hint is float:
                good = isinstance(value, int | float) and not isinstance(value, bool) and 0 <= value < float("inf")
                if not good or (name == "search_rate_m2" and value == 0):
                    raise TaskliftError(f"reading, {name}: expected a finite number >= 0, found {value!r}")
        if not isinstance(self.patience, int) or isinstance(self.patience, bool) or self.patience < 1:
            raise TaskliftError(f"reading, patience: expected a whole number of steps >= 1, found {self.patience!r}")

    @classmethod
    def from_json(cls, document: dict[str, Any], where: str = "reading") -> Reading:
        """Build a reading from a mapping of option names to values; unknown names are refused."""
        known = {f.name for f in dataclasses.fields(cls)}
        for name in document:
            if name not in known:
                raise TaskliftError(f"{where}: unknown option {name!r}; known are {', '.join(sorted(known))}")
        return cls(**document)


#: The two frozen presets, always reported side by side.
SCATTERED = Reading()
COHESIVE = Reading(split="team", engage="crossing", alert_range_m=20.0)
PRESETS: dict[str, Reading] = {"scattered": SCATTERED, "cohesive": COHESIVE}

#: The feature class that hides hostiles (the paper's EnemyFTR; Figure 5 shows it at 4).
ENEMY_FEATURE = DOOR

#: Table III, the signals of the simplified task V.
SEARCH_SIGNALS = (Signal(-0.2, {"MV": 0}, "stopped while mapping"),)
SEARCH_TIME_REWARD = 0.2


@cache
def search_and_clear() -> Task:
    """Return the paper's task T (Table I, 90 × 44 weights) with its signals (Table III).

    Two misprints of Table III are mended: its ``WPN ≥ 2`` and ``WPN = 0`` speak of nWPN (the output WPN has no
    such values), and its last row, described as "suspected enemy at a different feature", needs FTR ≠ enemy.
    """
    elsewhere = [ftr for ftr in range(1, 6) if ftr != ENEMY_FEATURE]
    return Task(
        name="search and clear",
        inputs=(
            Variable("DL", (0, 1, 2), labels=("none", "suspected", "attacked"), meaning="danger level"),
            Variable("GL", (0, 1), labels=("unknown", "known"), meaning="goal"),
            Variable(
                "nWPN",
                (0, 1, 2),
                labels=("none", "below m", "m or more"),
                meaning="weapon robots in the team",
            ),
            Variable(
                "FTR",
                (1, 2, 3, 4, 5),
                labels=("none", "bend", "corner", "door", "other"),
                meaning="feature faced",
            ),
        ),
        outputs=(
            Variable("MV", (0, 1), labels=("stop", "move"), meaning="stop or move"),
            Variable("WPN", (0, 1), labels=("deny", "accept"), meaning="keep to the weapon robots' speed"),
            Variable("CA", tuple(i / 10 for i in range(11)), meaning="coverage coefficient"),
        ),
        signals=(
            Signal(-0.1, {"MV": 0, "nWPN": 2}, "never stop when enough weapon robots"),
            Signal(+0.1, {"MV": 0, "nWPN": 0, "FTR": ENEMY_FEATURE}, "stopped near a correct feature"),
            Signal(-0.1, {"MV": 0, "FTR": elsewhere}, "suspected enemy at a different feature"),
        ),
        impossible=({"WPN": 1, "nWPN": 0},),
        impossible_signal=-0.5,
        time_reward=0.1,
    )


def search_only(task: Task) -> Task:
    """Return the paper's task V (Table II, 15 × 44 weights): ``task`` with no danger and no goal."""
    return task.simplify(fix={"DL": 0, "GL": 0}, name="search", signals=SEARCH_SIGNALS, time_reward=SEARCH_TIME_REWARD)


def hostile_candidates(building: Building) -> list[int]:
    """Doors that are not next to the start: where hostiles may be hidden (rule 14)."""
    start = building.start
    beside = {int(v) for v in building.neighbour[building.indptr[start] : building.indptr[start + 1]]}
    return [
        node
        for node in range(building.n_nodes)
        if building.feature_class[node] == ENEMY_FEATURE and node not in beside and node != start
    ]


@dataclass(frozen=True, eq=False)
class Mission:
    """A building, a team, hidden hostiles and the rules they live by. A world that policies are trained on.

    It implements :class:`tasklift.learning.reinforcement.Trials`.

    Parameters
    ----------
    building
        Where.
    team
        How many robots of each kind; robots are numbered in this order.
    hostiles
        How many, hidden at random at doors that are not next to the start (rule 14); or the nodes of the
        features that they stand at.
    reading
        The world's rules.
    weapons_needed
        The paper's m: so many weapon robots destroy a hostile.
    limit
        Steps after which a trial has failed.

    Raises
    ------
    TaskliftError
        If there is no robot, if no team could ever destroy a hostile, or if there is no place to hide them.
    """

    building: Building
    team: Mapping[Kind, int]
    hostiles: int | tuple[int, ...] = 1
    reading: Reading = field(default_factory=Reading)
    weapons_needed: int = 2
    limit: int = 600

    def __post_init__(self) -> None:
        object.__setattr__(self, "team", dict(self.team))
        for kind, number in self.team.items():
            _expect_count(f"team, {kind.name}", number, 0)
        _expect_count("weapons_needed", self.weapons_needed, 1)
        _expect_count("limit", self.limit, 1)
        if self.n_robots == 0:
            raise TaskliftError("team: expected at least one robot, found none")
        if not isinstance(self.hostiles, int):
            object.__setattr__(self, "hostiles", tuple(int(node) for node in self.hostiles))
        self._check_hostiles()

    def _check_hostiles(self) -> None:
        if isinstance(self.hostiles, tuple):
            for node in self.hostiles:
                if not 0 <= node < self.building.n_nodes or self.building.kind[node] != FEATURE:
                    raise TaskliftError(f"hostiles: node {node} of {self.building.name!r} is not a feature")
            if len(set(self.hostiles)) < len(self.hostiles):
                raise TaskliftError("hostiles: at most one per feature, found a node twice")
        else:
            _expect_count("hostiles", self.hostiles, 0)
            places = len(hostile_candidates(self.building))
            if self.hostiles > places:
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


def _expect_count(where: str, value: object, least: int) -> None:
    if not isinstance(value, int) or isinstance(value, bool) or value < least:
        raise TaskliftError(f"{where}: expected a whole number of at least {least}, found {value!r}")
