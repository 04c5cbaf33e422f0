"""Where rooms end whose way out is wider than the corridor outside.

Dividing at narrow places does not find the gap in the wall of such a room: the narrow places are in the corridor on
either side of it, and the piece between them would belong to the room.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from tasklift.plans.extract.space import EIGHT, Space

# A gap is at most so wide, and this part of the room's width; the wall that ends there has at least this length.
WIDEST_GAP_M = 8.0
NARROWER = 0.85
SHORTEST_WALL_M = 0.3
# The wall nearest to its middle is farther than this part of its width: else it runs along a wall.
OPEN = 0.35
# What lies beyond a gap is smaller than this part of the room.
LARGEST_MOUTH = 0.6
# From a door one sees a wall within this distance: a corridor passes. Farther, and the gap is a corridor's mouth.
PASSING_M = 3.0
# What is left over of a region is none of its own below this.
SLIVER_M2 = 0.25


@dataclass(frozen=True, eq=False)
class _Gap:
    """A gap in a wall: the cells ``(n, 2)`` of a line across it, its width and its middle (cells)."""

    line: NDArray[np.int64]
    width: float
    middle: tuple[int, int]


def cut_mouths(
    space: Space,
    region: NDArray[np.int32],
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
    boxes, gaps = ndimage.find_objects(region), _gaps(space, half)
    for room, pixels in ways_out.items():
        box = tuple(slice(s.start - 1, s.stop + 1) for s in boxes[room - 1])
        corner = np.array([s.start for s in box])
        depth = np.where(region[box] == room, half[box], 0)
        mine = [g for g in gaps if region[g.middle] == room and g.width <= NARROWER * 2 * depth.max()]
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


def _gaps(space: Space, half: NDArray[np.float32]) -> list[_Gap]:
    found = []
    for line in space.outline.gaps(half, SHORTEST_WALL_M / space.cell_m, WIDEST_GAP_M / space.cell_m):
        width = float(np.hypot(*(line[-1] - line[0])))
        middle = int(line[len(line) // 2][0]), int(line[len(line) // 2][1])
        if half[middle] >= OPEN * width > 0:
            found.append(_Gap(line, width, middle))
    return found


def _best_cut(
    room: NDArray[np.bool_],
    inside: tuple[np.intp, ...],
    gaps: list[_Gap],
    ways_out: NDArray[np.int64],
    corner: NDArray[np.int64],
) -> tuple[_Gap, NDArray[np.bool_], NDArray[np.bool_]]:
    """The gap that parts most ways out from the inside, the narrowest of several.

    Returns it with what of ``room`` lies beyond, and which of the ``ways_out`` do. ``corner`` is the room's
    first cell in the plan.
    """
    from scipy import ndimage

    reached = ndimage.binary_dilation(room, EIGHT)[tuple(ways_out.T)].all()
    cuts = []
    for gap in gaps:
        bar = np.zeros_like(room)
        for step in ((0, 0), (0, 1), (1, 0), (0, -1), (-1, 0)):
            bar[tuple((gap.line - corner + step).clip(0, np.array(room.shape) - 1).T)] = True
        part, _ = ndimage.label(room & ~bar)
        kept = part == part[inside]
        beyond = room & ~kept
        apart = ~ndimage.binary_dilation(kept, EIGHT)[tuple(ways_out.T)]
        if bar[inside] or not reached or beyond.sum() > LARGEST_MOUTH * kept.sum():
            apart[:] = False
        cuts.append((gap, beyond, apart))
    return max(cuts, key=lambda cut: (cut[2].sum(), -cut[0].width))


def _is_passed(region: NDArray[np.int32], room: int, gap: _Gap, space: Space) -> bool:
    """Whether one soon sees a wall when one looks out of a room straight through a gap."""
    across = (gap.line[-1] - gap.line[0]) / gap.width
    away = np.arange(2, round(PASSING_M / space.cell_m))[:, None] * np.array([-across[1], across[0]])
    for sign in (1, -1):
        seen = np.rint(gap.middle + sign * away).astype(np.int64).clip(0, np.array(region.shape) - 1)
        owner = region[tuple(seen.T)]
        if owner[len(owner) // 4] != room:
            return bool((owner == 0).any())
    return False


def _in_one_piece(space: Space, region: NDArray[np.int32]) -> NDArray[np.int32]:
    """Regions in one piece each: what is apart from the largest piece is one of its own, or nothing if tiny."""
    from scipy import ndimage

    fresh = int(region.max()) + 1
    for number, box in enumerate(ndimage.find_objects(region), start=1):
        part, _ = ndimage.label(region[box] == number)
        area = np.bincount(part.ravel())[1:]
        for piece in (np.flatnonzero(area < area.max(initial=0)) + 1).tolist():
            big = area[piece - 1] * space.cell_m**2 >= SLIVER_M2
            region[box][part == piece] = fresh if big else 0
            fresh += big
    return region
