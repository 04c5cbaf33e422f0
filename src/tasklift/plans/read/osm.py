"""OpenStreetMap's simple indoor tagging (``.osm``): rooms, corridors, walls and doors of one level.

Tagging: https://wiki.openstreetmap.org/wiki/Simple_Indoor_Tagging. Latitude and longitude become metres around the
middle of what is drawn. Corridors and areas that share a piece of their outlines have no wall there.
"""

from __future__ import annotations

import math
from collections import Counter
from dataclasses import dataclass, replace
from itertools import pairwise
from xml.etree.ElementTree import Element

import numpy as np
from numpy.typing import NDArray

from tasklift.plans.lines import Points, plan_of_lines
from tasklift.plans.plan import Plan
from tasklift.plans.source import Source, number_in, plain_name
from tasklift.text import shown

TITLE = "OpenStreetMap indoor rooms (.osm), --level 0"
DOOR_M = 0.9
# Doors nearer to each other are one, drawn on the outlines of both its sides.
SAME_DOOR_M = 0.5
METRES_PER_DEGREE = 111_195.0
MOST_LEVELS, MOST_MEMBERS = 200, 1000
_AREAS = ("room", "corridor", "area")
_OPEN = ("corridor", "area")


@dataclass(frozen=True)
class _Node:
    """A node: latitude and longitude (degrees), and its tags."""

    at: tuple[float, float]
    tags: dict[str, str]


@dataclass(frozen=True)
class _Way:
    """The nodes of an outline or wall, with the tags of the room that it belongs to."""

    refs: list[str]
    tags: dict[str, str]
    is_area: bool


def recognises(source: Source) -> bool:
    """Whether its root is ``osm``."""
    return source.xml is not None and source.xml.tag == "osm"


def read(source: Source) -> Plan:
    """Draw the rooms and walls of a level, open at their doors.

    Raises
    ------
    TaskliftError
        With the way or node at fault, or if no door joins the rooms.
    """
    root = source.xml
    assert root is not None
    nodes = _nodes(source, root)
    ways = _ways(source, root, nodes)
    levels = sorted({level for way in ways for level in _levels(way.tags)})
    level = source.level if source.level is not None else levels[0] if len(levels) == 1 else None
    listed = ", ".join(map(shown, levels[:8]))
    if not ways:
        raise source.fault("is OpenStreetMap XML without indoor rooms (indoor=room, corridor, area or wall)")
    if level is None:
        raise source.fault(f"has the levels {listed:.120}; choose one with --level")
    if level not in levels:
        raise source.fault(f"has no level {shown(level)}; there is {listed:.120}")
    here = [way for way in ways if level in _levels(way.tags)]
    at = _in_metres(nodes, sorted({ref for way in here for ref in way.refs}))
    floors = [np.array([at[ref] for ref in way.refs]) for way in here if way.is_area]
    doors, openings = _doors(here, nodes, at, level)
    if not len(openings) and all(way.tags["indoor"] in ("room", "corridor") for way in here):
        raise source.fault(
            f"is OpenStreetMap XML, and no door leads into a room of level {shown(level)} ({len(floors)} in all); map "
            "doors (door=* on a node of a room's outline)"
        )
    inner = _inner_points(floors)
    named = [plain_name(way.tags.get("name") or way.tags.get("ref") or "") for way in here if way.is_area]
    plan = plan_of_lines(
        source,
        f"{source.path.stem} {plain_name(level)}",
        _walls(here, at) or floors,
        floors,
        doors=doors if len(doors) else None,
        openings=openings,
        seeds=inner if floors else None,
        doubts=[] if len(doors) else ["no doors are mapped (door=* on a node of a room's outline)"],
    )
    names = [(name, (x, y)) for name, (x, y) in zip(named, inner.tolist(), strict=True) if name]
    return replace(plan, names=tuple(names))


def _tags(element: Element) -> dict[str, str]:
    return {tag.get("k", ""): tag.get("v", "") for tag in element if tag.tag == "tag"}


def _levels(tags: dict[str, str]) -> list[str]:
    """The levels that something is on: ``0``, ``0;1``, ``0-2`` or ``-2--1``."""
    found: list[str] = []
    for part in ";".join(tags[key] for key in ("level", "repeat_on") if key in tags).split(";"):
        low, dash, high = part.strip().rpartition("-") if "-" in part.strip()[1:] else ("", "", "")
        if low.endswith("-"):
            low, high = low[:-1], f"-{high}"
        ends = [number_in(end) for end in (low, high)]
        whole = dash and all(end is not None and abs(end) <= MOST_LEVELS and end == int(end) for end in ends)
        if whole and ends[0] is not None and ends[1] is not None:
            found += map(str, range(int(ends[0]), int(ends[1]) + 1))
        elif part.strip():
            found.append(part.strip())
    return found or ["0"]


def _nodes(source: Source, root: Element) -> dict[str, _Node]:
    nodes = {}
    for element in root:
        if element.tag == "node":
            lat, lon = (number_in(element.get(key)) for key in ("lat", "lon"))
            if lat is None or lon is None or not abs(lat) <= 85 or not abs(lon) <= 180:
                key = shown(element.get("id"))
                raise source.fault(f"node {key}: expected lat within 85 and lon within 180 degrees")
            nodes[element.get("id", "")] = _Node((lat, lon), _tags(element))
    return nodes


def _ways(source: Source, root: Element, nodes: dict[str, _Node]) -> list[_Way]:
    """Ways with indoor tags, and the rings of relations that have them."""
    refs_of = {e.get("id", ""): [nd.get("ref", "") for nd in e if nd.tag == "nd"] for e in root if e.tag == "way"}
    ways: list[_Way] = []
    for element in root:
        tags = _tags(element)
        key = f"{element.tag} {shown(element.get('id'))}"
        indoor = tags.get("indoor")
        if element.tag not in ("way", "relation") or indoor not in (*_AREAS, "wall"):
            continue
        if element.tag == "way":
            rings = {"outer": [refs_of[element.get("id", "")]]}
        else:
            rings = _rings(source, element, refs_of)
        for role, found in rings.items():
            for refs in found:
                missing = [ref for ref in refs if ref not in nodes]
                if missing:
                    raise source.fault(f"{key}: node {shown(missing[0])} is not in the file")
                if len(refs) < (2 if indoor == "wall" else 4):
                    raise source.fault(f"{key}: an outline of {len(refs)} nodes")
                ways.append(_Way(refs, tags, indoor != "wall" and role == "outer"))
    return ways


def _rings(source: Source, relation: Element, refs_of: dict[str, list[str]]) -> dict[str, list[list[str]]]:
    """The outer and inner rings of a multipolygon; ways are joined end to end."""
    members = [member for member in relation if member.tag == "member" and member.get("type") == "way"]
    if len(members) > MOST_MEMBERS:
        raise source.fault(f"relation {shown(relation.get('id'))}: more than {MOST_MEMBERS} members")
    rings: dict[str, list[list[str]]] = {"outer": [], "inner": []}
    for role, found in rings.items():
        rest = [refs_of.get(m.get("ref", ""), []) for m in members if (m.get("role") or "outer") == role]
        rest = [refs for refs in rest if refs]
        while rest:
            ring = list(rest.pop())
            while ring[0] != ring[-1]:
                after = next((refs for refs in rest if ring[-1] in (refs[0], refs[-1])), None)
                if after is None:
                    break
                rest.remove(after)
                ring += after[1:] if after[0] == ring[-1] else after[-2::-1]
            found.append(ring)
    return rings


def _in_metres(nodes: dict[str, _Node], refs: list[str]) -> dict[str, Points]:
    """East and north of nodes (m), around their middle."""
    middle = np.mean([nodes[ref].at for ref in refs], axis=0)
    scale = METRES_PER_DEGREE * np.array([1.0, math.cos(math.radians(middle[0]))])
    return {ref: ((nodes[ref].at - middle) * scale)[::-1] for ref in refs}


def _walls(ways: list[_Way], at: dict[str, Points]) -> list[Points]:
    """Outlines of rooms, walls, and the outlines of corridors but where they share them."""
    shared = Counter(
        frozenset(pair) for way in ways if way.tags["indoor"] in _OPEN for pair in pairwise(way.refs)
    )
    walls = []
    for way in ways:
        if way.tags["indoor"] == "corridor" and way.is_area:
            own = (pair for pair in pairwise(way.refs) if shared[frozenset(pair)] == 1)
            walls += [np.array([at[ref] for ref in pair]) for pair in own]
        elif way.tags["indoor"] != "area" or not way.is_area:
            walls.append(np.array([at[ref] for ref in way.refs]))
    return walls


def _doors(
    ways: list[_Way], nodes: dict[str, _Node], at: dict[str, Points], level: str
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Both ends of every door, and of every opening in a wall (``door=no`` is one without a door), ``(K, 2, 2)``."""
    found: dict[str, Points] = {}
    for way in ways:
        closed = way.refs[0] == way.refs[-1]
        for i, ref in enumerate(way.refs):
            tags = nodes[ref].tags
            is_opening = {"door", "entrance"} & tags.keys() or tags.get("indoor") == "door"
            if ref in found or not is_opening or ("level" in tags and level not in _levels(tags)):
                continue
            before = way.refs[i - 1] if i else (way.refs[-2] if closed else ref)
            after = way.refs[i + 1] if i + 1 < len(way.refs) else (way.refs[1] if closed else ref)
            along = at[after] - at[before]
            size = float(np.hypot(*along))
            width = number_in(tags.get("width", "")) or DOOR_M
            if size > 0 and 0.3 <= width <= 20:
                found[ref] = at[ref] + np.outer([-0.5, 0.5], along) / size * width
    doors: list[Points] = []
    for ref, door in found.items():
        if nodes[ref].tags.get("door") != "no":
            middles = np.mean(doors, axis=1) if doors else np.zeros((0, 2))
            away = np.hypot(*(middles - door.mean(axis=0)).T)
            if away.min(initial=np.inf) > SAME_DOOR_M:
                doors.append(door)
    return np.array(doors).reshape(-1, 2, 2), np.array(list(found.values())).reshape(-1, 2, 2)


def _inner_points(floors: list[Points]) -> NDArray[np.float64]:
    """A point in each area ``(n, 2)``."""
    import shapely

    return shapely.get_coordinates([shapely.Polygon(floor).representative_point() for floor in floors]).reshape(-1, 2)
