"""The free space of a building: a plan's pixels without noise, scanner beams, furniture and the outdoors.

Distances are in metres, pixels are square cells of ``cell_m``. ``half_width_m`` is the distance of a free
cell to the nearest wall: half the width of the space there.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from tasklift.errors import TaskliftError
from tasklift.plans.extract.outline import Outline
from tasklift.plans.plan import FINEST_M, Plan

EIGHT = np.ones((3, 3), bool)  # neighbours across corners count
STRAIGHT_M = 0.1  # walls are straight within this
ROUNDING = 1e-3  # 0.3 m are three cells of 0.1 m, whatever 0.3 / 0.1 is in binary
DOOR_RULES = ("relative", "absolute")
# Islands in free space whose extent is smaller are scanner noise, and furniture: they are counted as obstacles, and
# corridors do not lead around them. In a single space without doors they are all the structure there is.
SPECKLE_M = 0.8
FURNITURE_M = 2.0
LONE_SPECKLE_M = 0.2
# Plans of more cells than this are made coarser still: time and memory grow with them. Floor farther from any wall than
# this, in pieces of a metre, is not a building's.
MOST_CELLS = 17_000_000
OPEN_M = 60.0
EDGE_DOUBT = "the free space runs along the picture's edge: is the outdoors taken for the building?"


@dataclass(frozen=True)
class Settings:
    """What a user may want otherwise; one setting serves all maps we know.

    Attributes
    ----------
    smallest_room_m2
        A room has at least this area.
    door_rule
        "relative": a door is narrower than the spaces on both sides. "absolute": every place narrower than
        2.2 m divides.
    narrowest_m
        Passages narrower than this are closed: beams of a laser scanner are not corridors.
    """

    smallest_room_m2: float = 4.0
    door_rule: str = "relative"
    narrowest_m: float = 0.5


@dataclass(eq=False)
class Space:
    """The free space of one building. All arrays ``(H, W)``; row, column + ``corner`` are the plan's cells.

    Islands in it smaller than ``furniture_m`` were taken out. ``sheet`` are the rows and columns of the whole plan,
    ``left_out_m2`` is the area of other free regions, which are not the outdoors.
    """

    free: NDArray[np.bool_]
    half_width_m: NDArray[np.float32]
    filled: NDArray[np.bool_]
    cell_m: float
    factor: int
    corner: tuple[int, int]
    settings: Settings = field(default_factory=Settings)
    furniture_m: float = FURNITURE_M
    sheet: tuple[int, int] = (0, 0)
    left_out_m2: float = 0.0
    doubts: list[str] = field(default_factory=list)

    @cached_property
    def outline(self) -> Outline:
        """The straight walls of the space."""
        return Outline(self.free, STRAIGHT_M / self.cell_m)

    @property
    def at_edge(self) -> NDArray[np.bool_]:
        """``bool (H, W)``: the cells at the edge of the plan."""
        rows, columns = (np.arange(size) + first for size, first in zip(self.free.shape, self.corner, strict=True))
        along = [np.isin(index, (0, size - 1)) for index, size in zip((rows, columns), self.sheet, strict=True)]
        return along[0][:, None] | along[1][None]

    @property
    def edge_cells(self) -> int:
        """How many cells there are along the plan's edge."""
        return 2 * (self.sheet[0] + self.sheet[1])

    def part_of(self, pixels: NDArray[np.bool_]) -> NDArray[np.bool_]:
        """The plan's ``pixels`` as cells of this space; one is true if any of its pixels is."""
        cells = ~coarser(~pixels, self.factor)
        found = np.zeros(self.free.shape, bool)
        first = np.maximum(self.corner, 0)
        last = np.minimum(np.add(self.corner, self.free.shape), cells.shape)
        into = tuple(slice(a - c, b - c) for a, b, c in zip(first, last, self.corner, strict=True))
        found[into] = cells[tuple(slice(a, b) for a, b in zip(first, last, strict=True))]
        return found

    def to_plan(self, points: NDArray[np.float64]) -> NDArray[np.float64]:
        """Rows and columns of the plan, in its pixels, of points ``(n, 2)`` given in cells."""
        return (np.asarray(points, float) + 0.5 + self.corner) * self.factor

    def to_cells(self, points: NDArray[np.float64]) -> NDArray[np.float64]:
        """Cells of points ``(n, 2)`` given in the plan's pixels; undoes :meth:`to_plan`."""
        return np.asarray(points, float) / self.factor - self.corner - 0.5


def clean(
    plan: Plan, settings: Settings, seeds: NDArray[np.float64] | None = None, keep_islands: bool = False
) -> Space:
    """Return the free space of the building in ``plan``, without noise, beams, furniture, and the outdoors.

    Parameters
    ----------
    seeds
        Points in it, rows and columns ``(n, 2)`` of the plan's pixels.
    keep_islands
        Whether furniture and the larger specks stay.

    Raises
    ------
    TaskliftError
        If the plan holds no free space, or none of the seeds is on any.
    """

    doubts: list[str] = []
    speckle_m, furniture_m = (LONE_SPECKLE_M, 0.0) if keep_islands else (SPECKLE_M, FURNITURE_M)
    factor = max(1, int(FINEST_M / plan.resolution_m + 1e-6))
    while plan.free.size / factor**2 > MOST_CELLS:
        factor += 1
    cell = plan.resolution_m * factor
    free = coarser(plan.free, factor)
    if not free.any():
        raise TaskliftError(f"{plan.name}: no free space in the picture; are the thresholds and 'negate' right?")
    _refuse_open_country(plan.name, free, cell)
    sheet = free.shape
    free = np.pad(free, 1)
    filled = fill_islands(free, speckle_m / cell)
    free = free | filled
    radius = max(0.5, settings.narrowest_m / 2 / cell)
    core = to_wall(free) >= radius - ROUNDING
    if not core.any():
        raise TaskliftError(
            f"{plan.name}: no free space wider than {settings.narrowest_m:g} m; is the resolution right? "
            "(--narrowest lets narrower passages through)"
        )
    inside = None if seeds is None else np.floor(np.asarray(seeds) / factor).astype(int) + 1
    chosen, left_out_m2 = _choose(plan.name, _pieces(core, radius), cell, inside, doubts)
    rows, columns = (np.flatnonzero(chosen.any(axis=1 - axis)) for axis in (0, 1))
    box = slice(rows[0] - 1, rows[-1] + 2), slice(columns[0] - 1, columns[-1] + 2)
    chosen, filled = chosen[box], filled[box]
    furniture = fill_islands(chosen, furniture_m / cell)
    filled = (filled | furniture) & (chosen | furniture)
    chosen = chosen | furniture
    half = to_wall(chosen) * np.float32(cell)
    corner = int(rows[0]) - 2, int(columns[0]) - 2
    return Space(chosen, half, filled, cell, factor, corner, settings, furniture_m, sheet, left_out_m2, doubts)


def _refuse_open_country(name: str, free: NDArray[np.bool_], cell: float) -> None:
    """Refuse floor that is far from any wall: it takes long, and comes to nothing."""
    metre = max(1, round(1.0 / cell))
    away = float(to_wall(np.pad(coarser(free, metre), 1)).max()) * metre * cell
    if away > OPEN_M:
        raise TaskliftError(
            f"{name}: floor is {away:.0f} m from any wall; is the resolution of {cell:g} m right, or in millimetres? "
            "Else cut the picture to the building"
        )


def to_wall(free: NDArray[np.bool_]) -> NDArray[np.float32]:
    """The distance (cells) of each free cell to the nearest one that is not."""
    return _nearest_wall(free)[0]


def _nearest_wall(free: NDArray[np.bool_]) -> tuple[NDArray[np.float32], NDArray[np.int32]]:
    """How far (cells) the nearest cell is that is not free, and its row and column ``(2, H, W)``."""
    from scipy import ndimage

    nearest = ndimage.distance_transform_edt(free, return_distances=False, return_indices=True)
    # scipy's own distances take twice the time and the memory; whole numbers up to 4,096 squared stay whole in these
    square, away = np.zeros(free.shape, np.float32), np.empty(free.shape, np.float32)
    for axis, size in enumerate(free.shape):
        cells = np.arange(size, dtype=np.int32).reshape((-1, 1) if axis == 0 else (1, -1))
        np.subtract(nearest[axis], cells, out=away, casting="unsafe")
        square += np.multiply(away, away, out=away)
    return np.sqrt(square, out=square), nearest


def _pieces(core: NDArray[np.bool_], radius: float) -> NDArray[np.int32]:
    """Number the pieces of the floor that a disc whose middle stays in ``core`` can go over, from 1 on.

    Where a passage is so short that the discs before and behind it cover it, it parts two pieces all the same.
    """
    from scipy import ndimage

    label, _ = ndimage.label(core)
    away, nearest = _nearest_wall(~core)
    return np.where(away < radius - ROUNDING, label[nearest[0], nearest[1]], 0).astype(np.int32)


def coarser(free: NDArray[np.bool_], factor: int) -> NDArray[np.bool_]:
    """One cell per ``factor`` x ``factor`` pixels, free if all of them are: walls never vanish."""
    if factor == 1:
        return free
    height, width = (-(-n // factor) * factor for n in free.shape)
    padded = np.zeros((height, width), bool)
    padded[: free.shape[0], : free.shape[1]] = free
    blocks = padded.reshape(height // factor, factor, width // factor, factor)
    return np.asarray(blocks.all(axis=(1, 3)))


def fill_islands(free: NDArray[np.bool_], extent: float) -> NDArray[np.bool_]:
    """The pieces of ``~free`` that are smaller than ``extent`` cells either way and do not touch the edge.

    By extent and not by area, which would also take wall stubs.
    """
    from scipy import ndimage

    label, n = ndimage.label(~free, structure=EIGHT)
    small = np.zeros(n + 1, bool)
    for i, (rows, columns) in enumerate(ndimage.find_objects(label), start=1):
        inside = rows.start > 0 and columns.start > 0
        inside = inside and rows.stop < free.shape[0] and columns.stop < free.shape[1]
        small[i] = inside and max(rows.stop - rows.start, columns.stop - columns.start) < extent
    return small[label]


def _choose(
    name: str, label: NDArray[np.int32], cell: float, seeds: NDArray[np.int64] | None, doubts: list[str]
) -> tuple[NDArray[np.bool_], float]:
    """The piece of free space with most of the seeds in it, or the largest that is not the outdoors.

    Returns it, and the area (m²) of the other pieces.
    """
    area = np.bincount(label.ravel()) * cell**2
    area[0] = 0
    if seeds is not None:
        within = seeds[((seeds >= 0) & (seeds < label.shape)).all(axis=1)]
        votes = np.bincount(label[tuple(within.T)], minlength=len(area))
        votes[0] = 0
        if not votes.any():
            raise TaskliftError(f"{name}: the seed point is not on free space; choose a point inside the building")
        chosen: NDArray[np.bool_] = np.isin(label, np.argmax(votes))
        return chosen, 0.0
    # the outdoors lies along much of the picture's edge; a room that was scanned up to the edge does not
    edge = np.concatenate([label[1], label[-2], label[:, 1], label[:, -2]])
    outdoors = np.bincount(edge, minlength=len(area)) > 0.25 * len(edge)
    outdoors[0] = False
    bounded = np.where(outdoors, 0, area)
    best = int(np.argmax(bounded)) if bounded.max() > 0 else int(np.argmax(area))
    if outdoors[best]:
        doubts.append(EDGE_DOUBT)
    elif outdoors.any():
        doubts.append(f"{area[outdoors].sum():.0f} m² along the picture's edge were taken for the outdoors")
    others = [float(a) for i, a in enumerate(area) if i != best and not outdoors[i] and a >= 4.0]
    if others:
        doubts.append(
            f"several free regions: took the one of {area[best]:.0f} m²; left out {len(others)} more of "
            f"{sum(others):.0f} m² in all, the largest {max(others):.0f} m²: are doors shut, or drawn as lines? "
            "(a seed point chooses another)"
        )
    return np.isin(label, best), sum(others)
