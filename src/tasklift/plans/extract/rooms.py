"""Which pieces of floor are rooms: those that walls and doors close, with a table in them or not, long or square."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from tasklift.plans.extract.regions import Opening, Regions, jambs
from tasklift.plans.extract.space import EIGHT, Space, to_wall

# A room is somewhere at least twice this wide. At most this part of its border is open without being a door, were it a
# square.
ROOM_HALF_WIDTH_M = 0.7
ROOM_OPENNESS = 0.22
# The largest ratio of its length to its width: with one way in; with doors in its long walls only (corridors have doors
# at their ends). With several ways in the limit is this many times its half width (m): if all are doors; otherwise.
ROOM_ELONGATION = 4.0
LONG_ELONGATION = 8.0
THROUGH_ELONGATION = 1.7
MOUTH_ELONGATION = 1.4
# Below this half width, and with several ways in, what opens by more than this part of its width is corridor.
HALL_HALF_WIDTH_M = 1.85
MOUTH_SHARE = 0.52
# A door stands across a corridor if on both sides, this far away, walls up to this far apart lie equally far to the
# left and to the right, give or take this much.
BEYOND_M = 1.0
WIDEST_CORRIDOR_M = 3.3
SAME_WALL_M = 0.3
# An island is furniture if its area is below this part of the room's, it is not thicker (twice its half width) and not
# longer than this.
FURNITURE_SHARE = 0.25
FURNITURE_THICK_M = 3.0
FURNITURE_LONG_M = 6.5
NARROW_HALF_M = 1.35
ASIDE = 0.7  # a door is in a long wall if the cosine between its way through and the room's length is below this


def which_are_rooms(
    space: Space, region: NDArray[np.int32], openings: list[Opening], measure: Regions
) -> NDArray[np.bool_]:
    """Which regions are rooms, ``bool (regions + 1,)``; the others are corridors."""
    if not openings:
        return np.zeros(len(measure.exits), bool)  # one space alone: its inner structure is all there is
    is_room = _by_shape(space, measure, _doors_aside(space, region, openings, measure))
    for opening in openings:
        # a piece of corridor between two doors is not a room, however short: it goes on beyond the door
        if opening.is_door and _goes_on(space, opening):
            for r in opening.regions:
                narrow = measure.peak_m[r] < HALL_HALF_WIDTH_M and measure.exits[r] >= 2
                is_room[r] = is_room[r] and not narrow
    return is_room


def _by_shape(space: Space, measure: Regions, aside: NDArray[np.bool_]) -> NDArray[np.bool_]:
    through = np.where(measure.openness > 0, MOUTH_ELONGATION, THROUGH_ELONGATION)
    longest = np.where(measure.exits <= 1, ROOM_ELONGATION, np.minimum(ROOM_ELONGATION, through * measure.peak_m))
    longest = np.where(aside, LONG_ELONGATION, longest)
    narrow = (measure.exits >= 2) & (measure.peak_m < HALL_HALF_WIDTH_M)
    found: NDArray[np.bool_] = (
        (measure.area_m2 >= space.settings.smallest_room_m2)
        & (measure.peak_m >= ROOM_HALF_WIDTH_M)
        & (measure.openness <= ROOM_OPENNESS)
        & (measure.elongation <= longest)
        & ~(narrow & (measure.mouth > MOUTH_SHARE))
    )
    return found


def _doors_aside(
    space: Space, region: NDArray[np.int32], openings: list[Opening], measure: Regions
) -> NDArray[np.bool_]:
    """Which regions have doors in their long walls only, no other way in, and lead to one or two others."""
    from scipy import ndimage

    beyond: list[set[int]] = [set() for _ in measure.exits]
    for opening in openings:
        a, b = opening.regions
        beyond[a].add(b)
        beyond[b].add(a)
    most = np.where(measure.peak_m < NARROW_HALF_M, 1, 2)  # a narrow one that leads to more is a corridor
    few = np.array([len(others) for others in beyond]) <= most
    aside: NDArray[np.bool_] = np.array((measure.exits >= 1) & (measure.openness == 0) & few)
    boxes = ndimage.find_objects(region)
    for r in np.flatnonzero(aside & (measure.elongation > 2)).tolist():
        cells = np.argwhere(region[boxes[r - 1]] == r)[::7]
        along = np.linalg.svd(cells - cells.mean(axis=0), full_matrices=False)[2][0]
        for opening in openings:
            if r in opening.regions:
                ends = jambs(space.free, opening.pixel, float(space.half_width_m[opening.pixel]) / space.cell_m)
                if ends is None:
                    aside[r] = False
                    break
                across = np.subtract(ends[1], ends[0]) / np.hypot(*np.subtract(ends[1], ends[0]))
                aside[r] &= abs(float(across[1] * along[0] - across[0] * along[1])) < ASIDE
    return aside


def _goes_on(space: Space, opening: Opening) -> bool:
    """Whether a door stands across a corridor: the walls left and right go on beyond it as they came."""
    half = float(space.half_width_m[opening.pixel])
    ends = jambs(space.free, opening.pixel, half / space.cell_m)
    if ends is None:
        return False
    across = np.subtract(ends[1], ends[0]) / np.hypot(*np.subtract(ends[1], ends[0]))
    ahead = np.array([-across[1], across[0]]) * BEYOND_M / space.cell_m
    walls = [[_clear_m(space, opening.pixel + sign * ahead, side * across) for side in (-1, 1)] for sign in (-1, 1)]
    (left, right), (far_left, far_right) = walls
    same = max(abs(left - far_left), abs(right - far_right)) <= SAME_WALL_M
    return same and left + right <= WIDEST_CORRIDOR_M and min(left, right) > 0 and left + right > 2.4 * half


def _clear_m(space: Space, start: NDArray[np.float64], along: NDArray[np.float64]) -> float:
    """How far it is from a point to the next wall in a direction; 0 where the point is not on the floor."""
    steps = np.arange(0, WIDEST_CORRIDOR_M / space.cell_m + 1)
    cells = np.rint(start + steps[:, None] * along).astype(np.int64)
    inside = ((cells >= 0) & (cells < space.free.shape)).all(axis=1)
    free: NDArray[np.bool_] = np.zeros(len(cells), bool)
    free[inside] = space.free[tuple(cells[inside].T)]
    return float(len(steps) if free.all() else free.argmin()) * space.cell_m


def without_furniture(
    space: Space, region: NDArray[np.int32], openings: list[Opening], measure: Regions
) -> Space | None:
    """The space without the islands that stand in its rooms; ``None`` if there are none.

    A region that is a room once its small islands are filled has them as obstacles.
    """
    from scipy import ndimage

    label, _ = ndimage.label(~space.free, structure=EIGHT)
    fits = (measure.area_m2 >= space.settings.smallest_room_m2) & (measure.openness <= ROOM_OPENNESS)
    fits &= measure.exits >= 1
    # what an island adds to the area of its room, by region
    islands: dict[int, list[tuple[int, tuple[slice, ...], float]]] = {}
    for i, box in enumerate(ndimage.find_objects(label), start=1):
        if np.hypot(*(s.stop - s.start for s in box)) * space.cell_m > FURNITURE_LONG_M:
            continue
        box = tuple(slice(max(0, s.start - 1), s.stop + 1) for s in box)
        island = label[box] == i
        beside = np.unique(region[box][ndimage.binary_dilation(island, EIGHT) & space.free[box]])
        # between two regions it is no island: what lies within it would be cut off
        if len(beside) == 1 and fits[beside[0]] and 2 * to_wall(island).max() * space.cell_m <= FURNITURE_THICK_M:
            islands.setdefault(int(beside[0]), []).append((i, box, float(island.sum()) * space.cell_m**2))
    filled = np.zeros(space.free.shape, bool)
    boxes = ndimage.find_objects(region)
    for r, mine in sorted(islands.items()):
        total = measure.area_m2[r] + sum(area for _, _, area in mine)
        small = [(i, box) for i, box, area in mine if area < FURNITURE_SHARE * total]
        if small:
            box = tuple(slice(s.start - 1, s.stop + 1) for s in boxes[r - 1])
            inside = np.isin(label[box], [i for i, _ in small])
            if _is_room_without(space, (region[box] == r) | inside, r, region, openings, measure):
                filled[box] |= inside
    if not filled.any():
        return None
    free = space.free | filled
    half = to_wall(free) * np.float32(space.cell_m)
    return replace(space, free=free, filled=space.filled | filled, half_width_m=half)


def _is_room_without(
    space: Space,
    mask: NDArray[np.bool_],
    r: int,
    region: NDArray[np.int32],
    openings: list[Opening],
    measure: Regions,
) -> bool:
    """Whether a region would be a room if its floor were ``mask``."""
    peak = float(to_wall(np.pad(mask, 1)).max()) * space.cell_m
    area = float(mask.sum()) * space.cell_m**2
    values = {"area_m2": area, "peak_m": peak, "elongation": area / max(2 * peak, space.cell_m) ** 2}
    changed = replace(measure, **{name: getattr(measure, name).copy() for name in values})
    for name, value in values.items():
        getattr(changed, name)[r] = value
    return bool(which_are_rooms(space, region, [o for o in openings if r in o.regions], changed)[r])
