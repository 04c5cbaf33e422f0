"""Regions of a space and the openings between them: what is known of each."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from tasklift.plans.extract.space import Space


@dataclass(eq=False)
class Opening:
    """A narrow place between two regions: where it is (cells), how wide (m), whether it is a door.

    Both regions may be the same: a door in a corridor that leads around to its other side.
    """

    pixel: tuple[int, int]
    regions: tuple[int, int]
    width_m: float
    is_door: bool


@dataclass(eq=False)
class Regions:
    """What is known of each region; row 0 is what is not free. All arrays ``(regions + 1,)``.

    ``elongation`` is the area over that of the square around the largest circle in it: about how many times it
    is longer than wide. ``openness`` is the share of its border that is open without being a door, were it a
    square; ``exits`` the number of its openings; ``mouth`` the widest that is not a door, over the largest width.
    """

    area_m2: NDArray[np.float64]
    peak_m: NDArray[np.float64]
    elongation: NDArray[np.float64]
    openness: NDArray[np.float64]
    exits: NDArray[np.int64]
    mouth: NDArray[np.float64]


def measure_regions(space: Space, region: NDArray[np.int32], openings: list[Opening]) -> Regions:
    """Area, half width, elongation, openness and number of exits of every region."""
    n = int(region.max()) + 1
    area: NDArray[Any] = np.bincount(region.ravel(), minlength=n) * space.cell_m**2
    highest = np.zeros(n, np.float32)  # of the same type as the half width: otherwise this is twenty times slower
    np.maximum.at(highest, region.ravel(), space.half_width_m.ravel())
    peak = highest.astype(float)
    area[0], peak[0] = 0, 1
    open_m, widest, exits = np.zeros(n), np.zeros(n), np.zeros(n, np.int64)
    for opening in openings:
        for r in opening.regions:
            exits[r] += 1
            if not opening.is_door:
                open_m[r] += opening.width_m
                widest[r] = max(widest[r], opening.width_m)
    openness = open_m / np.maximum(4 * np.sqrt(area), 1e-9)
    across = np.maximum(2 * peak, space.cell_m)
    return Regions(area, peak, area / across**2, openness, exits, widest / across)


def jambs(
    free: NDArray[np.bool_], pixel: tuple[int, int], half: float
) -> tuple[tuple[int, int], tuple[int, int]] | None:
    """The two wall cells between which a narrow place lies: the ends of the shortest line across it.

    ``half`` is the distance of the nearest wall (cells); ``None`` if no line is shorter than 1.5 times what
    that asks for.
    """
    angle = np.arange(36) * (np.pi / 36)
    away = np.arange(0.5, 3 * half + 2, 0.5)
    ends = []
    for sign in (1, -1):
        rows = np.rint(pixel[0] + sign * np.sin(angle)[:, None] * away).astype(np.int64)
        columns = np.rint(pixel[1] + sign * np.cos(angle)[:, None] * away).astype(np.int64)
        inside = (rows >= 0) & (columns >= 0) & (rows < free.shape[0]) & (columns < free.shape[1])
        wall = ~free[np.where(inside, rows, 0), np.where(inside, columns, 0)] & inside
        first = np.argmax(wall, axis=1)
        hit = wall[np.arange(len(angle)), first]
        ends.append((np.where(hit, away[first], np.inf), rows, columns, first))
    chord = ends[0][0] + ends[1][0]
    best = int(np.argmin(chord))
    if chord[best] > 3 * half + 2:
        return None
    (r1, c1), (r2, c2) = (
        (int(rows[best, first[best]]), int(columns[best, first[best]])) for _, rows, columns, first in ends
    )
    return (r1, c1), (r2, c2)
