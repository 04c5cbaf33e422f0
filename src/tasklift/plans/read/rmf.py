"""Floor plans as lines: the ``.building.yaml`` of open-rmf's traffic editor, one level at a time.

Walls and doors are drawn exactly as the file has them, on a fine grid; what is a door is what the file calls
one. Lanes are not walls: they only tell which piece of floor the robots use.
"""

from __future__ import annotations

import math
import os
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from tasklift.errors import TaskliftError
from tasklift.plans.read.ros import LARGEST_PIXELS, Plan
from tasklift.plans.read.yamls import read_yaml

RESOLUTION_M = 0.05
WALL_M = 0.1
MARGIN_M = 1.0
MOST_LINES = 100_000


def read_rmf(
    path: str | os.PathLike[str], *, level: str | None = None, document: Mapping[str, Any] | None = None
) -> Plan:
    """Read one level of an open-rmf building as a plan of 5 cm cells.

    Parameters
    ----------
    path
        The ``.building.yaml``.
    level
        Its name; may be left out where there is one level only.
    document
        What the YAML holds, if it was read already.
    """
    fields = read_yaml(path) if document is None else document
    levels = fields.get("levels")
    if not isinstance(levels, dict) or not levels:
        raise TaskliftError(f"{path}: field 'levels': expected the levels of a building by name")
    names = ", ".join(str(name) for name in levels)
    if level is None:
        if len(levels) > 1:
            raise TaskliftError(f"{path}: has the levels {names:.200}; choose one with --level")
        level = next(iter(levels))
    if level not in levels:
        raise TaskliftError(f"{path}: no level {level!r:.80}; there is {names:.200}")
    where = f"{path}: level {level}"
    content = levels[level]
    if not isinstance(content, dict):
        raise TaskliftError(f"{where}: expected its walls and vertices")
    points = _vertices(where, content)
    metric = fields.get("coordinate_system", "reference_image")
    if metric == "cartesian_meters":
        points_m = points
    elif metric == "reference_image":
        points_m = points * _scale(where, content, points) * [1, -1]  # y points down in the picture
    else:
        raise TaskliftError(f"{where}: coordinate system {metric!r:.80}; expected reference_image or cartesian_meters")
    walls = _pairs(where, content, "walls", len(points))
    doors = _pairs(where, content, "doors", len(points))
    lanes = _pairs(where, content, "lanes", len(points))
    if not len(walls):
        raise TaskliftError(f"{where}: has no walls, so no rooms; draw them in the traffic editor")
    floors = _floors(where, content, len(points))
    name = f"{Path(path).name.split('.')[0]} {level}"
    return _draw(name, where, points_m, walls, doors, lanes, floors)


def _draw(
    name: str,
    where: str,
    points: NDArray[np.float64],
    walls: NDArray[np.int64],
    doors: NDArray[np.int64],
    lanes: NDArray[np.int64],
    floors: list[list[int]],
) -> Plan:
    """The plan of walls and floors on a grid; without floors all within the walls' bounds is floor."""
    from PIL import Image, ImageDraw

    used = np.unique(np.concatenate([walls.ravel(), *(np.array(f) for f in floors)]).astype(np.int64))
    low, high = points[used].min(axis=0) - MARGIN_M, points[used].max(axis=0) + MARGIN_M
    width, height = (float(v) for v in np.ceil((high - low) / RESOLUTION_M))
    if width * height > LARGEST_PIXELS:
        raise TaskliftError(
            f"{where}: {high[0] - low[0]:.0f} x {high[1] - low[1]:.0f} m are more than fits "
            f"{LARGEST_PIXELS:,} cells of {RESOLUTION_M:g} m; is the measurement right?"
        )
    pixel = (points - low) / RESOLUTION_M
    pixel[:, 1] = height - pixel[:, 1]
    pixel -= 0.5
    floor = Image.new("1", (int(width), int(height)), 0 if floors else 1)
    pen = ImageDraw.Draw(floor)
    for polygon in floors:
        pen.polygon([tuple(p) for p in pixel[polygon].tolist()], fill=1)
    drawn = Image.new("1", floor.size, 0)
    pen = ImageDraw.Draw(drawn)
    for a, b in walls.tolist():
        ends = [tuple(pixel[a].tolist()), tuple(pixel[b].tolist())]
        pen.line(ends, fill=1, width=max(1, round(WALL_M / RESOLUTION_M)))
    wall = np.asarray(drawn, bool)
    inside = np.asarray(floor, bool)
    free = inside & ~wall
    grey = np.where(wall, 0, np.where(inside, 254, 205)).astype(np.uint8)
    lane_ends = points[np.unique(lanes)] if len(lanes) else None
    return Plan(
        name,
        free,
        ~inside & ~wall,
        grey,
        RESOLUTION_M,
        (float(low[0]), float(low[1]), 0.0),
        (),
        doors_m=points[doors],
        seeds_m=lane_ends,
    )


def _vertices(where: str, content: Mapping[str, Any]) -> NDArray[np.float64]:
    vertices = _list(where, content, "vertices")
    for i, vertex in enumerate(vertices):
        if not isinstance(vertex, list) or len(vertex) < 2 or not all(_is_coordinate(v) for v in vertex[:2]):
            raise TaskliftError(f"{where}: vertex {i}: expected [x, y, z, name] with x and y up to 1e6")
    return np.array([vertex[:2] for vertex in vertices], float).reshape(-1, 2)


def _pairs(where: str, content: Mapping[str, Any], key: str, n: int) -> NDArray[np.int64]:
    """The vertex pairs of ``walls``, ``doors`` or ``lanes``; those of no length are left out."""
    found = []
    for i, item in enumerate(_list(where, content, key)):
        if not isinstance(item, list) or len(item) < 2 or not all(_is_index(v, n) for v in item[:2]):
            raise TaskliftError(f"{where}: {key}[{i}]: expected two vertices, each from 0 to {n - 1}")
        if item[0] != item[1]:
            found.append(item[:2])
    return np.array(found, np.int64).reshape(-1, 2)


def _floors(where: str, content: Mapping[str, Any], n: int) -> list[list[int]]:
    found = []
    for i, floor in enumerate(_list(where, content, "floors")):
        corners = floor.get("vertices") if isinstance(floor, dict) else None
        if not isinstance(corners, list) or len(corners) < 3 or not all(_is_index(v, n) for v in corners):
            raise TaskliftError(f"{where}: floors[{i}]: expected 'vertices', three or more from 0 to {n - 1}")
        found.append(corners)
    return found


def _scale(where: str, content: Mapping[str, Any], points: NDArray[np.float64]) -> float:
    """Metres per pixel: the mean of the measurements, as the traffic editor takes it."""
    scales = []
    pairs = _pairs(where, content, "measurements", len(points))
    given = [m for m in _list(where, content, "measurements") if m[0] != m[1]]
    for (a, b), item in zip(pairs.tolist(), given, strict=True):
        options = item[2] if len(item) > 2 and isinstance(item[2], dict) else {}
        distance = options.get("distance")
        value = distance[1] if isinstance(distance, list) and len(distance) == 2 else None
        drawn = float(np.hypot(*(points[a] - points[b])))
        if not isinstance(value, int | float) or not _is_coordinate(value) or value <= 0 or drawn < 1e-3:
            raise TaskliftError(f"{where}: measurement {a}-{b}: expected 'distance: [3, metres]' above 0")
        scales.append(float(value) / drawn)
    if not scales:
        raise TaskliftError(f"{where}: no measurement tells the scale; add one in the traffic editor")
    return float(np.mean(scales))


def _list(where: str, content: Mapping[str, Any], key: str) -> list[Any]:
    value = content.get(key, [])
    value = [] if value is None else value
    if not isinstance(value, list) or len(value) > MOST_LINES:
        raise TaskliftError(f"{where}: field {key!r}: expected a list of at most {MOST_LINES}")
    return value


def _is_coordinate(value: object) -> bool:
    return isinstance(value, int | float) and not isinstance(value, bool) and math.isfinite(value) and abs(value) <= 1e6


def _is_index(value: object, n: int) -> bool:
    return isinstance(value, int) and not isinstance(value, bool) and 0 <= value < n
