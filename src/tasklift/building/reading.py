"""The world's rules where the paper leaves them open.

The paper (Singh & Adams, ICRA 2006) leaves many details of its world open. :class:`Reading` names each of them
as an option with a default and alternatives; ``docs/reading.md`` tells which sentence of the paper each rests on.
"""

from __future__ import annotations

import dataclasses
from dataclasses import dataclass
from functools import cache
from typing import Any, Literal, get_args, get_type_hints

from tasklift.checks import number, one_of, whole_number
from tasklift.errors import TaskliftError

#: The least and the largest value of each number. Beyond them the compiled world would overflow.
RANGES: dict[str, tuple[Any, Any]] = {
    "patience": (1, 10**9),
    "goal_sharpness": (0, 100),
    "alert_range_m": (0, 1e7),
    "search_rate_m2": (0.001, 1e9),
}

_hints = cache(get_type_hints)  # slow, and readings are made by the thousand


@dataclass(frozen=True)
class Reading:
    """The world's rules where the paper leaves them open. Numbers in brackets: the rules of ``docs/reading.md``.

    Parameters
    ----------
    decide : {"robot", "team"}
        [5] ``robot``: each robot draws its own output. ``team``: the lowest-numbered member draws for all.
    patience : int
        [6] A robot decides anew after this many steps without a decision (steps, at least 1).
    split : {"robots", "pairs", "team"}
        [7] ``robots``: each leaving robot draws its own edge. ``pairs``: a leaving team divides over at most two
        edges. ``team``: later robots follow an earlier robot's choice that is open to them.
    turn_back : bool
        [8] Whether the edge just used is open to a robot whose goal lies elsewhere.
    explore : {"unvisited-first", "memoryless"}
        [8] ``unvisited-first``: without a goal, edges missing from the robot's own map come first.
        ``memoryless``: they do not.
    goal_sharpness : float
        [9] Exponent on the distance in GolC (dimensionless, 0 to 100).
    engage : {"team", "crossing"}
        [10] Whom a crossing engages. ``team``: everyone at the node. ``crossing``: those who cross in this step.
    alert_range_m : float
        [11] How far a suspicion is heard (m, straight line, at least 0).
    suspicion_goal : bool
        [11] Whether a suspected feature is the goal of the robots that hear of it.
    share_map : {"team", "radio", "none"}
        [12] Who pools maps: the robots of a ``team``, all of them by ``radio``, or ``none``.
    relocate : bool
        [14] Whether the hostiles are placed afresh in every trial.
    drill : bool
        [21] Hostiles repel instead of destroying (an addition of ours).
    search_rate_m2 : float
        [13] Floor area that is searched per step (m² per step, at least 0.001).

    Raises
    ------
    TaskliftError
        For a value that is not one of the options, or outside its range (:data:`RANGES`).

    Examples
    --------
    >>> Reading(split="team").split
    'team'
    >>> Reading(split="thirds")
    Traceback (most recent call last):
    tasklift.errors.TaskliftError: reading, split: expected one of robots, pairs, team, found 'thirds'
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

    def __repr__(self) -> str:
        usual = {f.name: f.default for f in dataclasses.fields(self)}
        changed = [f"{name}={getattr(self, name)!r}" for name in usual if getattr(self, name) != usual[name]]
        return f"Reading({', '.join(changed)})"

    def __post_init__(self) -> None:
        for name, hint in _hints(Reading).items():
            value, where = getattr(self, name), f"reading, {name}"
            if name in RANGES:
                (whole_number if hint is int else number)(value, where, *RANGES[name])
            else:
                one_of(value, (False, True) if hint is bool else get_args(hint), where)

    @classmethod
    def from_json(cls, document: dict[str, Any], where: str = "reading") -> Reading:
        """Return the reading with these options, the defaults elsewhere.

        Raises
        ------
        TaskliftError
            For an unknown option, or a value outside its range.
        """
        known = {f.name for f in dataclasses.fields(cls)}
        for name in document:
            if name not in known:
                raise TaskliftError(f"{where}: unknown option {name!r}; known are {', '.join(sorted(known))}")
        return cls(**document)


SCATTERED = Reading()
"""The preset with every rule at its default: robots spread out over the building."""
COHESIVE = Reading(split="team", engage="crossing", alert_range_m=20.0)
"""The preset in which robots that leave together stay together."""
#: The two frozen presets, always reported side by side.
PRESETS: dict[str, Reading] = {"scattered": SCATTERED, "cohesive": COHESIVE}
