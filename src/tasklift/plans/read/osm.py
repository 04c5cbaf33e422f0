"""OpenStreetMap's simple indoor tagging (``.osm``): rooms, corridors, walls and doors of one level.

Tagging: https://wiki.openstreetmap.org/wiki/Simple_Indoor_Tagging. Latitude and longitude become metres around the
middle of what is drawn.
"""

from __future__ import annotations

import math
from xml.etree.ElementTree import Element

import numpy as np
from numpy.typing import NDArray

from tasklift.plans.lines import plan_of_lines
from tasklift.plans.plan import Plan
from tasklift.plans.source import Source, number_in, plain_name
from tasklift.text import shown

TITLE = "OpenStreetMap indoor rooms (.osm), --level 0"
DOOR_M = 0.9
METRES_PER_DEGREE = 111_195.0
_AREAS = ("room", "corridor", "area")


def recognises(source: Source) -> bool:
    """Whether its root is ``osm``."""
    return source.xml is not None and source.xml.tag == "osm"


def read(source: Source) -> Plan:
    """Draw the rooms and walls of a level, open at their doors.

    Raises
    ------
    TaskliftError
        With the way or node at fault.
    """
    root = source.xml
    assert root is not None
    nodes = _nodes(source, root)
    ways = _ways(source, root, nodes)
    levels = sorted({level for _, tags, _ in ways for level in _levels(tags)})
    level = source.level if source.level is not None else levels[0] if len(levels) == 1 else None
    listed = ", ".join(map(shown, levels[:8]))
    if not ways:
        raise source.fault("is OpenStreetMap XML without indoor rooms (indoor=room, corridor, area or wall)")
    if level is None:
        raise source.fault(f"has the levels {listed:.120}; choose one with --level")
    if level not in levels:
        raise source.fault(f"has no level {shown(level)}; there is {listed:.120}")
    here = [(refs, tags, key) for refs, tags, key in ways if level in _levels(tags)]
    used = sorted({ref for refs, _, _ in here for ref in refs})
    middle = np.array([nodes[ref][0] for ref in used]).mean(axis=0)
    east = METRES_PER_DEGREE * math.cos(math.radians(middle[0]))
    at = {
        ref: np.array([(nodes[ref][0][1] - middle[1]) * east, (nodes[ref][0][0] - middle[0]) * METRES_PER_DEGREE])
        for ref in used
    }
    walls = [np.array([at[ref] for ref in refs]) for refs, tags, _ in here if tags["indoor"] != "area"]
    floors = [np.array([at[ref] for ref in refs]) for refs, tags, _ in here if tags["indoor"] in _AREAS]
    if not walls:
        walls = floors
    doors, names = _doors(here, nodes, at), _names(here, at)
    return plan_of_lines(
        source,
        f"{source.path.stem} {plain_name(level)}",
        walls,
        floors,
        doors=doors if len(doors) else None,
        cut_doors=True,
        seeds=np.array([point for point, _ in names]) if names else None,
        doubts=[] if len(doors) else ["no doors are mapped (door=* on a node of a room's outline)"],
    )


_Nodes = dict[str, tuple[tuple[float, float], dict[str, str]]]
_Way = tuple[list[str], dict[str, str], str]


def _tags(element: Element) -> dict[str, str]:
    return {tag.get("k", ""): tag.get("v", "") for tag in element if tag.tag == "tag"}


def _levels(tags: dict[str, str]) -> list[str]:
    return [part.strip() for part in tags.get("level", "0").split(";") if part.strip()]


def _nodes(source: Source, root: Element) -> _Nodes:
    nodes: _Nodes = {}
    for element in root:
        if element.tag == "node":
            at = [number_in(element.get(key)) for key in ("lat", "lon")]
            if at[0] is None or at[1] is None or not abs(at[0]) <= 85 or not abs(at[1]) <= 180:
                key = shown(element.get("id"))
                raise source.fault(f"node {key}: expected lat within 85 and lon within 180 degrees")
            nodes[element.get("id", "")] = (at[0], at[1]), _tags(element)
    return nodes


def _ways(source: Source, root: Element, nodes: _Nodes) -> list[_Way]:
    ways: list[_Way] = []
    for element in root:
        tags = _tags(element) if element.tag == "way" else {}
        if tags.get("indoor") not in (*_AREAS, "wall"):
            continue
        refs = [nd.get("ref", "") for nd in element if nd.tag == "nd"]
        key = shown(element.get("id"))
        missing = [ref for ref in refs if ref not in nodes]
        if missing:
            raise source.fault(f"way {key}: node {shown(missing[0])} is not in the file")
        if len(refs) < (2 if tags["indoor"] == "wall" else 4):
            raise source.fault(f"way {key}: an outline of {len(refs)} nodes")
        ways.append((refs, tags, key))
    return ways


def _doors(ways: list[_Way], nodes: _Nodes, at: dict[str, NDArray[np.float64]]) -> NDArray[np.float64]:
    """Both ends of every door: along the outline on which its node lies."""
    doors: dict[str, NDArray[np.float64]] = {}
    for refs, _, _ in ways:
        closed = refs[0] == refs[-1]
        for i, ref in enumerate(refs):
            tags = nodes[ref][1]
            if ref in doors or tags.get("door", tags.get("entrance", "no")) == "no":
                continue
            before = refs[i - 1] if i else (refs[-2] if closed else ref)
            after = refs[i + 1] if i + 1 < len(refs) else (refs[1] if closed else ref)
            along = at[after] - at[before]
            size = float(np.hypot(*along))
            width = number_in(tags.get("width", "")) or DOOR_M
            if size > 0 and 0.3 <= width <= 20:
                doors[ref] = np.array([at[ref] - along / size * width / 2, at[ref] + along / size * width / 2])
    return np.array(list(doors.values())).reshape(-1, 2, 2)


def _names(ways: list[_Way], at: dict[str, NDArray[np.float64]]) -> list[tuple[NDArray[np.float64], str]]:
    """A point in each area, with its name."""
    import shapely

    found = []
    for refs, tags, _ in ways:
        if tags["indoor"] in _AREAS:
            inside = shapely.Polygon([at[ref] for ref in refs]).representative_point()
            found.append((np.array([inside.x, inside.y]), plain_name(tags.get("name") or tags.get("ref") or "")))
    return found
