"""Kinds of robots, and the ways in which a team is written."""

from __future__ import annotations

import re
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

from tasklift.building.variables import named_numbers
from tasklift.checks import check_fields, check_name, whole_number
from tasklift.errors import TaskliftError
from tasklift.text import shown

#: The most robots in one team, and the fastest robot (mm per step): beyond that is a mistake in the units.
LARGEST_TEAM, LARGEST_SPEED_MM = 100_000, 10**9


@dataclass(frozen=True, order=True)
class Kind:
    """A kind of robot.

    Parameters
    ----------
    name : str
        What to call it.
    speed_mm : int
        Millimetres per step, at least 1. Motion is exact integer arithmetic.
    armed : bool
        Whether it counts as a weapon robot.
    attributes : mapping of str to float, optional
        Numbers that sensors read in place of their own of the same name
        (:class:`~tasklift.building.variables.Sensor`), such as ``{"detector_range_m": 12}``.

    Raises
    ------
    TaskliftError
        For an empty name, a speed that is not a whole number of millimetres, or an ``armed`` that is not a truth value.

    Examples
    --------
    >>> Kind("crawler", speed_mm=700, armed=True)
    Kind(name='crawler', speed_mm=700, armed=True)
    """

    name: str
    speed_mm: int
    armed: bool
    attributes: tuple[tuple[str, float], ...] = field(default=(), repr=False)

    def __post_init__(self) -> None:
        check_name(self.name, "kind")
        whole_number(self.speed_mm, f"kind {self.name!r}, speed_mm (millimetres per step)", 1, LARGEST_SPEED_MM)
        if not isinstance(self.armed, bool):
            raise TaskliftError(f"kind {self.name!r}: armed must be True or False, found {shown(self.armed)}")
        object.__setattr__(self, "attributes", named_numbers(self.attributes, f"kind {self.name!r}, attributes"))


SCOUT = Kind("scout", 1500, armed=False)
"""The paper's fast kind (section VI: velocity 1.5)."""
WEAPON = Kind("weapon", 1000, armed=True)
"""The paper's armed kind (section VI: velocity 1.0)."""

_KNOWN = {kind.name: kind for kind in (SCOUT, WEAPON)}

Team = dict[Kind, int]


def parse_team(team: str | Mapping[Any, Any] | list[Any], where: str = "team") -> Team:
    """Return how many robots there are of each kind.

    Parameters
    ----------
    team : str, mapping or list
        ``"10+5"``: scouts + weapon robots. Or ``{kind: number}``, where a kind is a :class:`Kind`, ``"scout"`` or
        ``"weapon"``. Or what :func:`team_to_json` returns. Robots are numbered in the order of kinds.
    where : str
        What the error message begins with: the option or the field that holds the team.

    Raises
    ------
    TaskliftError
        For another spelling, an unknown or doubled kind, a number that is not whole or is negative, no robot at all,
        or more than :data:`LARGEST_TEAM` robots.

    Examples
    --------
    >>> parse_team("10+5") == {SCOUT: 10, WEAPON: 5} == parse_team({"scout": 10, "weapon": 5})
    True
    """
    if isinstance(team, str):
        spelled = re.fullmatch(r"([0-9]{1,9})\+([0-9]{1,9})", team.strip(), re.ASCII)
        if spelled is None:
            raise TaskliftError(f"{where}: expected SCOUTS+WEAPONS such as 10+5, found {shown(team)}")
        team = {SCOUT: int(spelled[1]), WEAPON: int(spelled[2])}
    if not isinstance(team, Mapping | list):
        raise TaskliftError(f"{where}: expected SCOUTS+WEAPONS such as 10+5, or {{kind: number}}, found {shown(team)}")
    found: Team = {}
    for given, number in team.items() if isinstance(team, Mapping) else [_entry(entry, where) for entry in team]:
        kind = _KNOWN.get(given) if isinstance(given, str) else given
        if not isinstance(kind, Kind):
            raise TaskliftError(f"{where}: expected a Kind, 'scout' or 'weapon', found {shown(given)}")
        if kind in found:
            raise TaskliftError(f"{where}: the kind {kind.name!r} is there twice")
        found[kind] = whole_number(number, f"{where}, {kind.name}", 0, LARGEST_TEAM)
    whole_number(sum(found.values()), f"{where}, number of robots", 1, LARGEST_TEAM)
    return found


def team_to_json(team: Mapping[Kind, int]) -> list[dict[str, Any]]:
    """Return a team as JSON data: one table per kind, which :func:`parse_team` reads.

    Examples
    --------
    >>> team_to_json({WEAPON: 5})
    [{'kind': 'weapon', 'robots': 5, 'speed_mm': 1000, 'armed': True}]
    """
    return [
        {"kind": kind.name, "robots": number, "speed_mm": kind.speed_mm, "armed": kind.armed}
        | ({"attributes": [list(pair) for pair in kind.attributes]} if kind.attributes else {})
        for kind, number in team.items()
    ]


def _entry(entry: Any, where: str) -> tuple[Kind, Any]:
    """Return the kind and the number that one table names; a scout and a weapon robot need no more than their name."""
    shape = {"kind": str, "robots": int, "speed_mm?": int, "armed?": bool, "attributes?": (dict, list)}
    data = check_fields(entry, where, shape)
    usual = vars(_KNOWN[data["kind"]]) if data["kind"] in _KNOWN else {"speed_mm": None, "armed": None}
    described = {"attributes": ()} | usual | data
    return Kind(*(described[name] for name in ("kind", "speed_mm", "armed", "attributes"))), data["robots"]
