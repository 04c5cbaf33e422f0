"""A building back into a floor plan of pixels: what a robot would have mapped, as a ROS map."""

from __future__ import annotations

import json
import math
import os
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from tasklift.building.draw import corridor_floor, footprints
from tasklift.building.graph import DOOR, Building
from tasklift.errors import TaskliftError
from tasklift.files import write_atomically
from tasklift.plans.plan import LARGEST_PIXELS, Plan

DOOR_GAP_M = 1.0
WALL_M = 0.2
FREE, OCCUPIED, UNKNOWN = 254, 0, 205


def rasterise(building: Building, resolution_m: float = 0.05) -> Plan:
    """Draw the floor plan of ``building`` in pixels: floor free, walls around it occupied, the rest unknown.

    Corridors are bands of their width, rooms as in :func:`tasklift.building.draw.footprints`. A door in a
    corridor is a wall across it with a gap of 1 m; a room's link is as wide as its edge says, with or without
    a door. Bends and corners show as far as the corridor turns there, other features do not show.

    Parameters
    ----------
    resolution_m
        Metres per pixel, at least 0.01.
    """
    return rasterise_floor(building.name, _floor(building), resolution_m)


def rasterise_floor(name: str, floor: Any, resolution_m: float = 0.05) -> Plan:
    """Draw a floor, a shapely polygon in metres, as :func:`rasterise` does, with a metre to spare around it."""
    from PIL import Image, ImageDraw
    from scipy import ndimage

    if not isinstance(resolution_m, int | float) or not 0.01 <= resolution_m <= 0.5:
        raise TaskliftError(f"{name}: expected a resolution of 0.01 to 0.5 m per pixel, found {resolution_m!r}")
    low = np.floor((np.array(floor.bounds[:2]) - 1.0) / resolution_m) * resolution_m
    width, height = np.ceil((np.array(floor.bounds[2:]) + 1.0 - low) / resolution_m).astype(int).tolist()
    if width * height > LARGEST_PIXELS:
        raise TaskliftError(
            f"{name}: {width} x {height} pixels are more than the limit of {LARGEST_PIXELS:,}; "
            "choose a coarser resolution"
        )
    image = Image.new("1", (width, height), 0)
    pen = ImageDraw.Draw(image)
    for polygon in getattr(floor, "geoms", [floor]):
        for ring, colour in [(polygon.exterior, 1), *((hole, 0) for hole in polygon.interiors)]:
            points = (np.asarray(ring.coords) - low) / resolution_m
            pen.polygon([(x - 0.5, height - y - 0.5) for x, y in points.tolist()], fill=colour)
    free = np.asarray(image, bool)
    near = ndimage.binary_dilation(free, np.ones((3, 3), bool), iterations=max(1, round(WALL_M / resolution_m)))
    grey = np.where(free, FREE, np.where(near, OCCUPIED, UNKNOWN)).astype(np.uint8)
    origin = (round(float(low[0]), 6), round(float(low[1]), 6), 0.0)
    return Plan(name, free, ~near, grey, float(resolution_m), origin)


def write_ros(building: Building, path: str | os.PathLike[str], resolution_m: float = 0.05) -> Path:
    """Write ``building`` as a ROS map: the YAML file ``path`` and a PGM of the same name; returns the PGM's path."""
    target = Path(path)
    if target.suffix.lower() not in (".yaml", ".yml"):
        raise TaskliftError(f"{path}: a ROS map is a .yaml file (the picture goes beside it); name it so")
    plan = rasterise(building, resolution_m)
    picture = target.with_suffix(".pgm")
    height, width = plan.grey.shape
    write_atomically(picture, b"P5\n%d %d\n255\n" % (width, height) + plan.grey.tobytes())
    origin = ", ".join(f"{v:g}" if v == 0 else f"{v:.6f}" for v in plan.origin)
    write_atomically(
        target,
        f"image: {json.dumps(picture.name)}\nmode: trinary\nresolution: {plan.resolution_m:g}\n"
        f"origin: [{origin}]\nnegate: 0\noccupied_thresh: 0.65\nfree_thresh: 0.196\n",
    )
    return picture


def _floor(building: Building) -> Any:
    """All floor, as a shapely geometry: corridors and rooms less the walls beside the doors."""
    import shapely

    walls = []
    for node in np.flatnonzero(building.feature_class == DOOR).tolist():
        here = slice(building.indptr[node], building.indptr[node + 1])
        width = float(building.width_m[building.edge_of[here]].min())
        if width > 1.2 * DOOR_GAP_M:
            walls.append(_door_wall(building.position_m[node], _along(building, node), width))
    floor = shapely.union_all([corridor_floor(building), *footprints(building).values()], grid_size=0.001)
    return shapely.difference(floor, shapely.union_all(walls)) if walls else floor


def _along(building: Building, node: int) -> NDArray[np.float64]:
    """The direction in which one passes through a node of a corridor."""
    near = building.neighbour[building.indptr[node] : building.indptr[node + 1]]
    away = building.position_m[near] - building.position_m[node]
    along = away[0] - away[1] if len(away) > 1 else away[0]
    return along / max(math.hypot(*along), 1e-9)


def _door_wall(at: NDArray[np.float64], along: NDArray[np.float64], width: float) -> Any:
    import shapely

    across = np.array([-along[1], along[0]])
    sides = []
    for side in (-1, 1):
        near, far = at + side * across * DOOR_GAP_M / 2, at + side * across * (width / 2 + WALL_M)
        sides.append(shapely.LineString([near, far]).buffer(WALL_M / 2, cap_style="flat"))
    return shapely.union_all(sides)
