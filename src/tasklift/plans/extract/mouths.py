"""Where rooms end whose way out is wider than the corridor outside.

Dividing at narrow places does not find the gap in the wall of such a room: the narrow places are in the corridor on
either side of it, and the piece between them would belong to the room.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from tasklift.plans.extract.space import EIGHT, Space, to_wall

# The widest gap, in metres and as a part of the room's width; and the least length of the wall that ends there.
WIDEST_GAP_M = 8.0
NARROWER = 0.85
SHORTEST_WALL_M = 0.3
# The wall nearest to its middle is farther than this part of its width: else it runs along a wall.
OPEN = 0.35
# What lies beyond a gap is smaller than this part of the room.
LARGEST_MOUTH = 0.6
# From a door one sees a wall within this distance: a corridor passes. Farther, and the gap is a corridor's mouth.
PASSING_M = 3.0
# Part of a region is a room behind a gap between two ends of one wall. Each number is a limit: the gap's width; how far
# one end lies from the line of the other; how far they turn from each other; the part of the border that is gaps, were
# the room a square; the ratio of its length to its width; and the border that may be a door to another region.
WIDEST_ROOM_GAP_M = 4.0
SAME_LINE_M = 0.45
OPPOSITE = -0.8  # a cosine
LARGEST_OPENNESS = 0.22
LONGEST_ROOM = 2.5
DOOR_M = 1.5
# What is left over of a region is none of its own below this.
SLIVER_M2 = 0.25


@dataclass(frozen=True, eq=False)
class Gap:
    """A gap in a wall: the cells ``(n, 2)`` of a line across it, its width and its middle (cells).

    It is not open if the line runs along a wall.
    """

    line: NDArray[np.int64]
    width: float
    middle: tuple[int, int]
    is_open: bool


def find_gaps(space: Space) -> list[Gap]:
    """The gaps in the walls of a space: where a wall ends, straight across to the next one."""
    half = space.half_width_m / space.cell_m
    found = []
    for line in space.outline.gaps(half, SHORTEST_WALL_M / space.cell_m, WIDEST_GAP_M / space.cell_m):
        width = float(np.hypot(*(line[-1] - line[0])))
        middle = int(line[len(line) // 2][0]), int(line[len(line) // 2][1])
        found.append(Gap(line, width, middle, float(half[middle]) >= OPEN * width > 0))
    return found


def cut_mouths(
    space: Space,
    region: NDArray[np.int32],
    gaps: list[Gap],
    ways_out: dict[int, list[tuple[int, int]]],
    is_room: NDArray[np.bool_],
) -> tuple[NDArray[np.int32], NDArray[np.int64]]:
    """Give what lies beyond the gap in a room's wall to the corridor outside.

    Parameters
    ----------
    ways_out
        For each room, by its region, the cells of the narrow places in corridors where it ends so far.

    Returns
    -------
    tuple
        The regions, and the middles ``(n, 2)`` of those gaps that a corridor passes: doors, if not too wide.
    """
    from scipy import ndimage

    doors: list[tuple[int, int]] = []
    region = region.copy()
    half = space.half_width_m / space.cell_m
    boxes = ndimage.find_objects(region)
    for room, pixels in ways_out.items():
        box = tuple(slice(s.start - 1, s.stop + 1) for s in boxes[room - 1])
        corner = np.array([s.start for s in box])
        depth = np.where(region[box] == room, half[box], 0)
        widest = NARROWER * 2 * depth.max()
        mine = [gap for gap in gaps if gap.is_open and region[gap.middle] == room and gap.width <= widest]
        inside = np.unravel_index(np.argmax(depth), depth.shape)
        left = np.array(pixels) - corner
        while mine and len(left):
            gap, beyond, apart = _best_cut(region[box] == room, inside, mine, left, corner)
            around = region[box][ndimage.binary_dilation(beyond) & (region[box] != room)]
            border = np.bincount(around, minlength=len(is_room)) * ~is_room
            border[0] = 0
            if not apart.any() or not border.any():
                break
            region[box][beyond] = np.argmax(border)
            left = left[~apart]
            if _is_passed(region, room, gap, space):
                doors.append(gap.middle)
    return _in_one_piece(space, region), np.array(doors, np.int64).reshape(-1, 2)


def part_rooms(space: Space, region: NDArray[np.int32], gaps: list[Gap]) -> tuple[NDArray[np.int32], NDArray[np.int64]]:
    """Make regions of their own of what lies behind gaps in walls, where that is as compact as a room.

    Dividing at narrow places joins two rooms that open to a corridor opposite each other, as wide as it is.

    Returns
    -------
    tuple
        The regions, and the middles ``(n, 2)`` of the gaps that part them.
    """
    from scipy import ndimage

    of_region: dict[int, list[Gap]] = {}
    for gap in _between_ends(space, gaps):
        if region[gap.middle]:
            of_region.setdefault(int(region[gap.middle]), []).append(gap)
    region = region.copy()
    fresh = int(region.max()) + 1
    boxes = ndimage.find_objects(region)
    middles: list[tuple[int, int]] = []
    for number, mine in of_region.items():
        box = tuple(slice(max(0, s.start - 1), s.stop + 1) for s in boxes[number - 1])
        corner = np.array([s.start for s in box])
        mask = region[box] == number
        bars = np.zeros(mask.shape, np.int32)  # which of the gaps
        for i, gap in enumerate(mine, start=1):
            _draw_bar(bars, gap, corner, i)
        part, n = ndimage.label(mask & (bars == 0))
        width = np.array([0.0, *(gap.width * space.cell_m for gap in mine)])
        others = ndimage.binary_dilation((region[box] != number) & (region[box] != 0), EIGHT)
        rooms = [
            i
            for i, piece in enumerate(ndimage.find_objects(part), start=1)
            if n > 1 and _is_a_room(space, part, i, piece, bars, width, others)
        ]
        if rooms:
            nearest = ndimage.distance_transform_edt(part == 0, return_distances=False, return_indices=True)
            whole = np.where(mask, part[tuple(nearest)], 0)  # the bars go to the pieces beside them
            fresh_of = np.zeros(n + 1, np.int32)
            fresh_of[rooms] = fresh + np.arange(len(rooms))
            fresh += len(rooms)
            region[box] = np.where(fresh_of[whole] > 0, fresh_of[whole], region[box])
            middles += [gap.middle for gap in mine]
    if middles:
        region = _in_one_piece(space, region, 0.0)
    return region, np.array(middles, np.int64).reshape(-1, 2)


def _between_ends(space: Space, gaps: list[Gap]) -> list[Gap]:
    """Gaps from where a wall ends to where another one in its line does, one at each place."""
    from scipy.spatial import KDTree

    if not gaps:
        return []
    ends = np.array([(gap.line[0], gap.line[-1]) for gap in gaps], float)
    along = ends[:, 1] - ends[:, 0]
    along /= np.maximum(np.hypot(*along.T), 1)[:, None]
    begins = KDTree(ends[:, 0])
    found: list[Gap] = []
    for gap, (_, end), ahead in zip(gaps, ends, along, strict=True):
        if gap.is_open and gap.width * space.cell_m <= WIDEST_ROOM_GAP_M:
            near = begins.query_ball_point(end, SAME_LINE_M / space.cell_m)
            if (along[near] @ ahead < OPPOSITE).any():
                found.append(gap)
    if not found:
        return []
    taken = np.zeros(len(found), bool)
    twins = KDTree([gap.middle for gap in found]).query_pairs(SAME_LINE_M / space.cell_m)
    for i, j in sorted(twins):
        taken[j] |= not taken[i]
    return [gap for gap, double in zip(found, taken.tolist(), strict=True) if not double]


def _draw_bar(bar: NDArray[Any], gap: Gap, corner: NDArray[np.int64], value: int = 1) -> None:
    for step in ((0, 0), (0, 1), (1, 0), (0, -1), (-1, 0)):
        bar[tuple((gap.line - corner + step).clip(0, np.array(bar.shape) - 1).T)] = value


def _is_a_room(
    space: Space,
    part: NDArray[np.int32],
    number: int,
    box: tuple[slice, ...],
    bars: NDArray[np.int32],
    width_m: NDArray[np.float64],
    others: NDArray[np.bool_],
) -> bool:
    """Whether a piece of a region is as large and compact as a room, and open by its gaps only."""
    from scipy import ndimage

    box = tuple(slice(max(0, s.start - 1), s.stop + 1) for s in box)
    piece = part[box] == number
    area = float(piece.sum()) * space.cell_m**2
    if area < space.settings.smallest_room_m2 or (piece & others[box]).sum() * space.cell_m > DOOR_M:
        return False
    gaps_m = width_m[np.unique(bars[box][ndimage.binary_dilation(piece, EIGHT)])]
    if not 0 < gaps_m.sum() <= LARGEST_OPENNESS * 4 * area**0.5:
        return False
    across = 2 * float(to_wall(np.pad(piece, 1)).max()) * space.cell_m
    return bool(gaps_m.max() <= NARROWER * across and area <= LONGEST_ROOM * across**2)


def _best_cut(
    room: NDArray[np.bool_],
    inside: tuple[np.intp, ...],
    gaps: list[Gap],
    ways_out: NDArray[np.int64],
    corner: NDArray[np.int64],
) -> tuple[Gap, NDArray[np.bool_], NDArray[np.bool_]]:
    """The gap that parts most ways out from the inside, the narrowest of several.

    Returns it with what of ``room`` lies beyond, and which of the ``ways_out`` do. ``corner`` is the room's
    first cell in the plan.
    """
    from scipy import ndimage

    reached = ndimage.binary_dilation(room, EIGHT)[tuple(ways_out.T)].all()
    cuts = []
    for gap in gaps:
        bar = np.zeros_like(room)
        _draw_bar(bar, gap, corner)
        part, _ = ndimage.label(room & ~bar)
        kept = part == part[inside]
        beyond = room & ~kept
        apart = ~ndimage.binary_dilation(kept, EIGHT)[tuple(ways_out.T)]
        if bar[inside] or not reached or beyond.sum() > LARGEST_MOUTH * kept.sum():
            apart[:] = False
        cuts.append((gap, beyond, apart))
    return max(cuts, key=lambda cut: (cut[2].sum(), -cut[0].width))


def _is_passed(region: NDArray[np.int32], room: int, gap: Gap, space: Space) -> bool:
    """Whether one soon sees a wall when one looks out of a room straight through a gap."""
    across = (gap.line[-1] - gap.line[0]) / gap.width
    away = np.arange(2, round(PASSING_M / space.cell_m))[:, None] * np.array([-across[1], across[0]])
    for sign in (1, -1):
        seen = np.rint(gap.middle + sign * away).astype(np.int64).clip(0, np.array(region.shape) - 1)
        owner = region[tuple(seen.T)]
        if owner[len(owner) // 4] != room:
            return bool((owner == 0).any())
    return False


def _in_one_piece(space: Space, region: NDArray[np.int32], sliver_m2: float = SLIVER_M2) -> NDArray[np.int32]:
    """Regions in one piece each: what is apart from the largest piece is one of its own, or nothing if tiny."""
    from scipy import ndimage

    fresh = int(region.max()) + 1
    for number, box in enumerate(ndimage.find_objects(region), start=1):
        part, _ = ndimage.label(region[box] == number)
        area = np.bincount(part.ravel())[1:]
        for piece in (np.flatnonzero(area < area.max(initial=0)) + 1).tolist():
            big = area[piece - 1] * space.cell_m**2 >= sliver_m2
            region[box][part == piece] = fresh if big else 0
            fresh += big
    return region
