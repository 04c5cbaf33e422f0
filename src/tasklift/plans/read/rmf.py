"""open-rmf: the ``.building.yaml`` of its traffic editor, one level at a time.

Walls and doors are drawn exactly as the file has them, on a fine grid; what is a door is what the file calls one.
Lanes are not walls: they only tell which piece of floor the robots use. A level without walls is read as the graph of
its lanes.
"""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from tasklift.plans.lines import plan_of_lines
from tasklift.plans.places import Places
from tasklift.plans.plan import Lift, Plan
from tasklift.plans.source import Source, coordinate, plain_name
from tasklift.text import shown

TITLE = "open-rmf building (.building.yaml), --level L1"
MOST_LINES = 100_000


def recognises(source: Source) -> bool:
    """Whether it has levels that are drawn in the traffic editor."""
    return isinstance(source.fields.get("levels"), dict) and not is_navigation_graph(source)


def is_navigation_graph(source: Source) -> bool:
    """Whether its levels are those of an exported navigation graph: vertices are ``[x, y, {options}]``."""
    levels = source.fields.get("levels")
    for level in levels.values() if isinstance(levels, dict) else ():
        vertices = level.get("vertices") if isinstance(level, dict) else None
        if isinstance(vertices, list) and vertices and isinstance(vertices[0], list) and len(vertices[0]) > 2:
            return isinstance(vertices[0][2], dict)
    return False


def read(source: Source) -> Plan | Places:
    """Read one level as a plan of 5 cm cells, or as places where it has lanes and no walls.

    Raises
    ------
    TaskliftError
        With the level and the item at fault.
    """
    level, content = level_of(source)
    where = f"level {shown(level)}"
    drawing = content.get("drawing")
    if isinstance(drawing, dict) and isinstance(drawing.get("filename"), str):
        source.files.append(source.path.parent / drawing["filename"].replace("\0", ""))
    vertices = _list(source, where, content, "vertices")
    points = _vertices(source, where, vertices)
    metric = source.fields.get("coordinate_system", "reference_image")
    if metric == "cartesian_meters":
        points_m = points
    elif metric == "reference_image":
        points_m = points * _scale(source, where, content, points) * [1, -1]  # y points down in the picture
    else:
        raise source.fault(f"{where}: coordinate system {shown(metric)}; expected reference_image or cartesian_meters")
    walls, doors, lanes = (_pairs(source, where, content, key, len(points)) for key in ("walls", "doors", "lanes"))
    floors = _floors(source, where, content, len(points))
    if not np.isfinite(points_m).all() or np.abs(points_m).max(initial=0) > 1e6:
        raise source.fault(f"{where}: places farther than 1,000 km away; is the measurement right?")
    if len(walls):
        name = f"{source.path.name.split('.')[0]} {plain_name(level)}"
        plan = plan_of_lines(
            source,
            name,
            [points_m[wall] for wall in walls],
            [points_m[floor] for floor in floors],
            doors=points_m[doors],
            seeds=points_m[np.unique(lanes)] if len(lanes) else None,
        )
        height = coordinate(content.get("elevation")) or 0.0
        return replace(plan, lifts=_lifts(vertices, points_m, lanes), elevation_m=height)
    if not len(lanes):
        raise source.fault(f"{where}: has no walls and no lanes; draw them in the traffic editor")
    return _lanes(source, level, vertices, points_m, lanes)


def levels_of(source: Source) -> list[str]:
    """The names of the levels that have something to read."""
    levels = source.fields["levels"]
    return [name for name, content in levels.items() if isinstance(content, dict) and content.get("vertices")]


def level_of(source: Source) -> tuple[str, dict[str, Any]]:
    """The level that is asked for, or the only one."""
    levels = source.fields["levels"]
    names = ", ".join(shown(name) for name in list(levels)[:8])
    if not levels:
        raise source.fault("field 'levels': expected the levels of a building by name")
    level = source.level
    if level is None:
        if len(levels) > 1:
            raise source.fault(f"has the levels {names:.120}; choose one with --level")
        level = next(iter(levels))
    if level not in levels:
        raise source.fault(f"has no level {shown(level)}; there is {names:.120}")
    content = levels[level]
    if not isinstance(content, dict):
        raise source.fault(f"level {shown(level)}: expected its walls and vertices")
    return level, content


def lanes_as_places(
    source: Source, level: str, names: list[str], points_m: NDArray[np.float64], lanes: NDArray[np.int64]
) -> Places:
    """The graph of lanes; a named vertex with one or two lanes is a room, as robots are sent there."""
    places = Places(source, {"source": "open-rmf lanes", "file": source.path.name, "level": plain_name(level)})
    used = np.unique(lanes)
    number = {}
    for vertex in used.tolist():
        x, y = points_m[vertex].tolist()
        number[vertex] = places.add(x, y, names[vertex])
    for a, b in lanes.tolist():
        places.join(number[a], number[b])
    degree = np.bincount(np.array(list(places.ways), np.int64).ravel(), minlength=len(used))
    places.rooms = {place for place in places.names if degree[place] <= 2}
    return places


def _lanes(
    source: Source, level: str, vertices: list[Any], points_m: NDArray[np.float64], lanes: NDArray[np.int64]
) -> Places:
    names = [plain_name(vertex[3]) if len(vertex) > 3 else "" for vertex in vertices]
    places = lanes_as_places(source, level, names, points_m, lanes)
    places.doubts.append("the level has lanes and no walls: places and corridors are its graph's, rooms have no size")
    return places


def _lifts(
    vertices: list[Any], points_m: NDArray[np.float64], lanes: NDArray[np.int64]
) -> tuple[Lift, ...]:
    """The lifts whose cabins are vertices of a level; a lane leads from the cabin to the landing."""
    found: dict[str, Lift] = {}
    for i, vertex in enumerate(vertices):
        options = vertex[4] if len(vertex) > 4 and isinstance(vertex[4], dict) else {}
        cabin = options.get("lift_cabin")
        name = plain_name(cabin[1]) if isinstance(cabin, list) and len(cabin) == 2 else ""
        if name:
            beside = lanes[(lanes == i).any(axis=1)].ravel()
            landing = next((int(v) for v in beside if v != i), i)
            x, y = points_m[[i, landing]].tolist()
            found[name] = Lift(name, (x[0], x[1]), (y[0], y[1]))
    return tuple(found.values())


def _vertices(source: Source, where: str, vertices: list[Any]) -> NDArray[np.float64]:
    for i, vertex in enumerate(vertices):
        if not isinstance(vertex, list) or len(vertex) < 2 or any(coordinate(v) is None for v in vertex[:2]):
            raise source.fault(f"{where}: vertex {i}: expected [x, y, z, name] with x and y up to 1e6")
    return np.array([[coordinate(v) for v in vertex[:2]] for vertex in vertices], float).reshape(-1, 2)


def _pairs(source: Source, where: str, content: dict[str, Any], key: str, n: int) -> NDArray[np.int64]:
    """The vertex pairs of ``walls``, ``doors`` or ``lanes``; those of no length are left out."""
    found = []
    for i, item in enumerate(_list(source, where, content, key)):
        if not isinstance(item, list) or len(item) < 2 or not all(_is_index(v, n) for v in item[:2]):
            raise source.fault(f"{where}: {key}[{i}]: expected two vertices, each from 0 to {n - 1}")
        if item[0] != item[1]:
            found.append(item[:2])
    return np.array(found, np.int64).reshape(-1, 2)


def _floors(source: Source, where: str, content: dict[str, Any], n: int) -> list[list[int]]:
    found = []
    for i, floor in enumerate(_list(source, where, content, "floors")):
        corners = floor.get("vertices") if isinstance(floor, dict) else None
        if not isinstance(corners, list) or len(corners) < 3 or not all(_is_index(v, n) for v in corners):
            raise source.fault(f"{where}: floors[{i}]: expected 'vertices', three or more from 0 to {n - 1}")
        found.append(corners)
    return found


def _scale(source: Source, where: str, content: dict[str, Any], points: NDArray[np.float64]) -> float:
    """Metres per pixel: what the user says, or the mean of the measurements, as the traffic editor takes it."""
    if source.resolution_m is not None:
        return source.resolution_m
    scales = []
    pairs = _pairs(source, where, content, "measurements", len(points))
    given = [m for m in _list(source, where, content, "measurements") if m[0] != m[1]]
    for (a, b), item in zip(pairs.tolist(), given, strict=True):
        options = item[2] if len(item) > 2 and isinstance(item[2], dict) else {}
        distance = options.get("distance")
        value = coordinate(distance[1]) if isinstance(distance, list) and len(distance) == 2 else None
        drawn = float(np.hypot(*(points[a] - points[b])))
        if value is None or value <= 0 or drawn < 1e-3:
            raise source.fault(f"{where}: measurement {a}-{b}: expected 'distance: [3, metres]' above 0")
        scales.append(value / drawn)
    if not scales:
        raise source.fault(
            f"{where}: no measurement tells the scale; add one in the traffic editor, or give the metres per pixel of "
            "its drawing: --scale 0.05"
        )
    return float(np.mean(scales))


def _list(source: Source, where: str, content: dict[str, Any], key: str) -> list[Any]:
    value = content.get(key, [])
    value = [] if value is None else value
    if not isinstance(value, list) or len(value) > MOST_LINES:
        raise source.fault(f"{where}: field {key!r}: expected a list of at most {MOST_LINES}")
    return value


def _is_index(value: object, n: int) -> bool:
    return isinstance(value, int) and not isinstance(value, bool) and 0 <= value < n
