"""The plan that a building was found in, kept in its file; and how far its floor is from walls."""

from __future__ import annotations

import base64
import binascii
import io
import math
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from tasklift.building.graph import LARGEST_M, Building
from tasklift.errors import TaskliftError
from tasklift.plans.extract.space import MOST_CELLS, to_wall
from tasklift.plans.plan import FINEST_M, LARGEST_PIXELS, Plan

WALL, UNKNOWN, FREE = 0, 1, 2
GREYS = (0, 205, 254)
LARGEST_PACKED = 8_000_000
Points = NDArray[np.float64]


def pack(plan: Plan) -> dict[str, Any]:
    """Return a plan as JSON values: a PNG of wall, floor and unknown, in cells of 5 cm or more, cut to what is known.

    :func:`unpack` gives it back.
    """
    from PIL import Image

    free, unknown, factor = _coarser(plan)
    known = ~unknown if not unknown.all() else np.ones_like(free)
    rows, columns = (np.flatnonzero(known.any(axis=1 - axis)) for axis in (0, 1))
    top, bottom, left, right = rows[0], rows[-1] + 1, columns[0], columns[-1] + 1
    value = np.where(free, FREE, np.where(unknown, UNKNOWN, WALL)).astype(np.uint8)[top:bottom, left:right]
    image = Image.fromarray(value, "P")
    image.putpalette([grey for shade in GREYS for grey in (shade, shade, shade)])
    buffer = io.BytesIO()
    image.save(buffer, "PNG", bits=2, optimize=True)
    below = plan.free.shape[0] - (free.shape[0] - bottom) * factor  # blocks begin at the lower edge
    corner = plan.to_world(np.array([below], float), np.array([left * factor], float))[0]
    return {
        "png": base64.b64encode(buffer.getvalue()).decode(),
        "resolution_m": plan.resolution_m * factor,
        "origin": [round(float(corner[0]), 6), round(float(corner[1]), 6), plan.origin[2]],
    }


def unpack(building: Building) -> Plan | None:
    """Return the plan in a building's file, or ``None`` where there is none, or none that can be read."""
    found = placed(building)
    if found is None:
        return None
    from PIL import Image

    data, resolution, origin = found
    try:
        with Image.open(io.BytesIO(data), formats=["PNG"]) as image:
            if image.width * image.height > LARGEST_PIXELS or image.mode not in ("P", "L"):
                return None
            value = np.asarray(image if image.mode == "P" else image.convert("P"))
    except (OSError, ValueError, SyntaxError, Image.DecompressionBombError):
        return None
    grey = np.array([*GREYS, *[205] * 253], np.uint8)[value]
    return Plan(building.name, value == FREE, value == UNKNOWN, grey, resolution, origin)


def placed(building: Building) -> tuple[bytes, float, tuple[float, float, float]] | None:
    """Return the PNG in a building's file, metres per pixel, and its lower left corner and yaw; ``None``: none."""
    plan = building.provenance.get("plan")
    if not isinstance(plan, dict):
        return None
    png: Any
    resolution: Any
    png, resolution, origin = (plan.get(key) for key in ("png", "resolution_m", "origin"))
    resolution = resolution if _numbers([resolution]) else 0.0
    if not isinstance(png, str) or len(png) > LARGEST_PACKED or not 0 < resolution <= 1000:
        return None
    if not isinstance(origin, list) or len(origin) != 3 or not _numbers(origin):
        return None
    try:
        data = base64.b64decode(png, validate=True)
    except (binascii.Error, ValueError):
        return None
    if not data.startswith(b"\x89PNG\r\n\x1a\n"):
        return None
    return data, float(resolution), (float(origin[0]), float(origin[1]), float(origin[2]))


def _numbers(values: list[Any]) -> bool:
    return all(isinstance(v, int | float) and not isinstance(v, bool) and abs(v) <= LARGEST_M for v in values)


def _coarser(plan: Plan) -> tuple[NDArray[np.bool_], NDArray[np.bool_], int]:
    """Free and unknown cells of at least 5 cm: free where all pixels are, unknown where none is a wall and not free."""
    factor = max(1, int(FINEST_M / plan.resolution_m + 1e-6))
    while plan.free.size / factor**2 > MOST_CELLS:
        factor += 1
    if factor == 1:
        return plan.free, plan.unknown, 1
    # blocks begin at the lower left corner, which is the origin
    height, width = (-(-size // factor) * factor for size in plan.free.shape)
    pads = [(height - plan.free.shape[0], 0), (0, width - plan.free.shape[1])]

    def blocks(pixels: NDArray[np.bool_], outside: bool) -> NDArray[np.bool_]:
        padded = np.pad(pixels, pads, constant_values=outside)
        return padded.reshape(height // factor, factor, width // factor, factor)

    free = np.asarray(blocks(plan.free, False).all(axis=(1, 3)))
    wall = np.asarray(blocks(~plan.free & ~plan.unknown, False).any(axis=(1, 3)))
    return free, ~free & ~wall, factor


@dataclass(frozen=True, eq=False)
class Floor:
    """The free cells of a plan with their distance to walls; points are rows and columns of cells.

    Attributes
    ----------
    clearance_m
        ``float32 (H, W)``: from the middle of a cell to the face of the nearest wall (m), below 0 in walls.
    cell_m
        Size of a cell (m).
    plan, factor
        The plan, and how many of its pixels a cell is wide.
    """

    clearance_m: NDArray[np.float32]
    cell_m: float
    plan: Plan
    factor: int

    @classmethod
    def of(cls, plan: Plan) -> Floor:
        """Return the floor of a plan, in cells of at least 5 cm; all that is not free counts as a wall."""
        free, _, factor = _coarser(plan)
        if not free.any():
            raise TaskliftError(f"{plan.name}: no free floor in the plan")
        cell = plan.resolution_m * factor
        clearance = (to_wall(np.pad(free, 1)) - np.float32(0.5)) * np.float32(cell)
        return cls(clearance, cell, plan, factor)

    def to_cells(self, points_m: Points) -> Points:
        """Rows and columns ``(n, 2)`` of points in metres."""
        pixels = self.plan.to_pixels(np.asarray(points_m, float).reshape(-1, 2)) / self.factor
        return pixels + [self._above, 0] + 0.5

    def to_world(self, cells: Points) -> Points:
        """Metres ``(n, 2)`` of points in cells; undoes :meth:`to_cells`."""
        rows, columns = ((np.asarray(cells, float).reshape(-1, 2) - 0.5 - [self._above, 0]) * self.factor).T
        return self.plan.to_world(rows, columns)

    @property
    def _above(self) -> float:
        """How much higher than the plan the cells reach, which begin at its lower edge."""
        return self.clearance_m.shape[0] - 2 - self.plan.free.shape[0] / self.factor

    def clearance_at(self, cells: Points) -> NDArray[np.float64]:
        """How far from walls points are (m); below 0 in walls and off the plan."""
        from scipy import ndimage

        low = -self.cell_m / 2
        return ndimage.map_coordinates(self.clearance_m, np.asarray(cells).T, np.float64, order=1, cval=low)

    def clearance_between(self, a: Points, b: Points) -> NDArray[np.float64]:
        """How far from walls the straight lines between points ``(n, 2)`` and ``(n, 2)`` stay (m)."""
        if not len(a):
            return np.zeros(0)
        steps = np.ceil(np.hypot(*(b - a).T) / 0.5).astype(int) + 1
        begin = np.concatenate([[0], np.cumsum(steps)[:-1]])
        t = (np.arange(steps.sum()) - np.repeat(begin, steps)) / np.repeat(np.maximum(steps - 1, 1), steps)
        line = np.repeat(a, steps, axis=0) + t[:, None] * np.repeat(b - a, steps, axis=0)
        return np.minimum.reduceat(self.clearance_at(line), begin)


def picture(building: Building) -> tuple[str, list[tuple[float, float]]] | None:
    """Return the plan as a data URI and its corners (m): lower left, lower right, upper left; ``None``: none."""
    found = placed(building)
    plan = building.provenance.get("plan")
    if found is None or not isinstance(plan, dict):
        return None
    data, resolution, (x, y, yaw) = found
    width, height = (int.from_bytes(data[i : i + 4], "big") * resolution for i in (16, 20))
    across, up = (math.cos(yaw) * width, math.sin(yaw) * width), (-math.sin(yaw) * height, math.cos(yaw) * height)
    corners = [(x, y), (x + across[0], y + across[1]), (x + up[0], y + up[1])]
    return f"data:image/png;base64,{plan['png']}", corners
