"""A floor plan as a picture with a scale: what readers of plans return, and what is extracted from."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

LARGEST_PIXELS = 50_000_000
FINEST_M = 0.05  # finer pictures are made coarser, up to this size of a pixel


class Lift(NamedTuple):
    """A lift on one level: its name, the middle of its cabin, and a place before its door (m)."""

    name: str
    cabin_m: tuple[float, float]
    landing_m: tuple[float, float]


@dataclass(frozen=True, eq=False)
class Plan:
    """A floor plan as a picture, its top row first.

    Attributes
    ----------
    name
        For people: the name of the file.
    free, unknown
        ``bool (H, W)``: pixels a robot may be on; pixels of which the map says nothing. The rest is occupied.
    grey
        ``uint8 (H, W)``: the picture, for drawing upon.
    resolution_m
        Metres per pixel.
    origin
        ``(x, y, yaw)`` of the lower left corner of the picture (m, m, rad).
    doubts
        What the reader is not sure of, a sentence each.
    doors_m
        ``float64 (K, 2, 2)``: the two ends of every door (m), where the file tells; ``None`` where they have to
        be found.
    seeds_m
        ``float64 (n, 2)``: points (m) that lie in the building, or ``None``.
    names
        Names of rooms, each with a point (m) in it, where the file has them.
    lifts, elevation_m
        The lifts on this level and its height (m), of a building with several levels.
    """

    name: str
    free: NDArray[np.bool_]
    unknown: NDArray[np.bool_]
    grey: NDArray[np.uint8]
    resolution_m: float
    origin: tuple[float, float, float]
    doubts: tuple[str, ...] = ()
    doors_m: NDArray[np.float64] | None = None
    seeds_m: NDArray[np.float64] | None = None
    names: tuple[tuple[str, tuple[float, float]], ...] = ()
    lifts: tuple[Lift, ...] = ()
    elevation_m: float = 0.0

    def to_world(self, rows: NDArray[np.float64], columns: NDArray[np.float64]) -> NDArray[np.float64]:
        """Metres ``(n, 2)``, x right and y up, of points given in pixels (row 0 is the picture's top edge)."""
        x = np.asarray(columns, float) * self.resolution_m
        y = (self.free.shape[0] - np.asarray(rows, float)) * self.resolution_m
        cos, sin = math.cos(self.origin[2]), math.sin(self.origin[2])
        return np.column_stack([self.origin[0] + cos * x - sin * y, self.origin[1] + sin * x + cos * y])

    def to_pixels(self, points_m: NDArray[np.float64]) -> NDArray[np.float64]:
        """``(n, 2)`` rows and columns (fractions of pixels) of points in metres; undoes :meth:`to_world`."""
        x, y = (np.atleast_2d(points_m) - self.origin[:2]).T
        cos, sin = math.cos(self.origin[2]), math.sin(self.origin[2])
        columns = (cos * x + sin * y) / self.resolution_m
        rows = self.free.shape[0] - (cos * y - sin * x) / self.resolution_m
        return np.column_stack([rows, columns])
