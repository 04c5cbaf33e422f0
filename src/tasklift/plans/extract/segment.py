"""From the free space of a building to its rooms, corridors and doors: dividing it at the narrow places.

Regions are what lies between narrow places, openings are those places; some openings are doors, some regions
are rooms, the others corridors.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from tasklift.plans.extract.mouths import cut_mouths, find_gaps, part_rooms
from tasklift.plans.extract.regions import Opening, Regions, jambs, measure_regions
from tasklift.plans.extract.rooms import which_are_rooms, without_furniture
from tasklift.plans.extract.space import EIGHT, Space

# A narrow place divides two spaces if its width is below this part of theirs within this distance, or below the second
# part of the wider one's largest width: a corridor that opens into a hall without a door frame.
DOOR_RATIO = 0.75
NEAR_M = 1.0
MOUTH_RATIO = 0.6
# Of the places that divide, those up to this width are doors if their width is below this part of the space on both
# sides, and the frame is at most so deep; up to the leaf's width it may be deeper.
DOOR_WIDTH_M = 2.2
FRAME_RATIO = 0.76
FRAME_M = 1.75
LEAF_M = 1.1
DEEP_FRAME_M = 3.0
# Between two corridors a door is narrower than this part of both, and stands between walls of at least this extent, not
# pillars. Where a corridor leads around to the door's other side, the door has at least the third width.
CORRIDOR_DOOR_RATIO = 0.58
WALL_M = 3.0
NARROWEST_DOOR_M = 0.8
# A dead end wide open to a space is part of it if its area is below this part.
BAY_SHARE = 0.25
# A gap so near to an opening is the same place.
NEAR_GAP_M = 0.5
THROAT_M = 0.25  # a doorway is looked for so far from its border
CORRIDOR_ELONGATION = 3.0  # what is longer is not a bay of a room


@dataclass(eq=False)
class Division:
    """A space divided at its narrow places.

    ``region`` is ``int32 (H, W)``: the regions from 1 on, 0 where not free. ``openings`` are the places between
    them, ``measure`` is what is known of each, ``is_room`` says which are rooms; row 0 of both is what is not free.
    """

    space: Space
    region: NDArray[np.int32]
    openings: list[Opening]
    measure: Regions
    is_room: NDArray[np.bool_]


def divide(space: Space, furnished: bool = True) -> Division:
    """Divide the free space at its narrow places.

    Every pixel climbs to the top of the ``R`` around it; tops whose pass is hardly lower than they are belong
    together. What stays apart are the regions.

    Parameters
    ----------
    furnished
        Whether islands in rooms are to be looked for; they are filled, and the space is divided again.
    """
    half = space.half_width_m
    top = _climb(half)
    basin, peak = _number_tops(top, half)
    a, b, height, where = _passes(basin, half)
    joined = height >= 0.95 * np.maximum(peak[a], peak[b])
    narrow = 2 * height < DOOR_WIDTH_M
    narrow &= height < DOOR_RATIO * np.maximum(peak[a], peak[b])
    perhaps = where[narrow]
    group = _join(len(peak), a[joined], b[joined])
    basin = group[basin]
    merged_peak = np.zeros(group.max() + 1, np.float32)
    np.maximum.at(merged_peak, group, peak)
    a, b, height, where = _passes(basin, half)
    root = _merge(space, basin, merged_peak, (a, b, height, where))
    region, openings, measure = _tidy(space, root[basin])
    gaps = find_gaps(space)
    region, parting = part_rooms(space, region, gaps)
    if len(parting):
        region, openings, measure = _tidy(space, region, parting)
    if furnished:
        emptied = without_furniture(space, region, openings, measure)
        if emptied is not None:
            return divide(emptied, furnished=False)
    is_room = which_are_rooms(space, region, openings, measure)
    ways_out = _ways_out(openings, is_room, measure)
    if ways_out:
        region, doors = cut_mouths(space, region, gaps, ways_out, is_room)
        openings = _openings(space, region, {})
        for opening in openings:
            opening.is_door |= _is_near(opening.pixel, doors, space) and opening.width_m < DOOR_WIDTH_M
        measure = measure_regions(space, region, openings)
        is_room = np.pad(is_room, (0, len(measure.exits) - len(is_room)))
    walls = _Walls(space)
    openings += _inner_doors(space, region, perhaps, openings, walls)
    for opening in openings:
        if opening.is_door and not is_room[list(opening.regions)].any():
            # corridors vary in width: only a marked narrowing between walls is a door in one
            opening.is_door = walls.beside(opening) and _is_door(space, region, opening, True)
    openings = [o for o in openings if o.is_door or o.regions[0] != o.regions[1]]
    return Division(space, region, openings, measure, is_room)


def _is_near(pixel: tuple[int, int], places: NDArray[np.int64], space: Space) -> bool:
    return bool(np.hypot(*(places - pixel).T).min(initial=np.inf) * space.cell_m < NEAR_GAP_M)


def _climb(half: NDArray[np.float32]) -> NDArray[np.int64]:
    """For every pixel the flat index of the local maximum of ``half`` that steepest ascent leads to."""
    height, width = half.shape
    index = np.arange(half.size, dtype=np.int64).reshape(half.shape)
    best = half.copy()
    target = index.copy()
    for dr, dc in ((-1, 0), (1, 0), (0, -1), (0, 1), (-1, -1), (-1, 1), (1, -1), (1, 1)):
        rows = slice(max(0, -dr), height - max(0, dr)), slice(max(0, dr), height - max(0, -dr))
        columns = slice(max(0, -dc), width - max(0, dc)), slice(max(0, dc), width - max(0, -dc))
        here, there = (rows[0], columns[0]), (rows[1], columns[1])
        higher = half[there] > best[here]
        best[here][higher] = half[there][higher]
        target[here][higher] = index[there][higher]
    flat = target.ravel()
    while True:
        further = flat[flat]
        if np.array_equal(further, flat):
            return flat.reshape(half.shape)
        flat = further


def _number_tops(top: NDArray[np.int64], half: NDArray[np.float32]) -> tuple[NDArray[np.int32], NDArray[np.float32]]:
    """Number the tops from 1; 0 is what is not free. Returns the numbers and the height of each top."""
    tops = np.flatnonzero((top.ravel() == np.arange(top.size)) & (half.ravel() > 0))
    number = np.zeros(top.size, np.int32)
    number[tops] = np.arange(1, len(tops) + 1)
    basin = np.where(half > 0, number[top], 0)
    return basin.astype(np.int32), np.concatenate([[0], half.ravel()[tops]]).astype(np.float32)


def _passes(
    label: NDArray[np.int32], half: NDArray[np.float32]
) -> tuple[NDArray[np.int64], NDArray[np.int64], NDArray[np.float32], NDArray[np.int64]]:
    """The highest pass between each two neighbouring labels: ``(a, b, height, flat index)``, a < b."""
    width = label.shape[1]
    found = []
    flat, r = label.ravel(), half.ravel()
    for step in (1, width):
        i = np.flatnonzero((flat[:-step] != flat[step:]) & (flat[:-step] > 0) & (flat[step:] > 0))
        found.append((i, i + step))
    i, j = (np.concatenate(parts) for parts in zip(*found, strict=True))
    low, high = np.minimum(flat[i], flat[j]).astype(np.int64), np.maximum(flat[i], flat[j]).astype(np.int64)
    height = np.minimum(r[i], r[j])
    order = np.lexsort((-height, high, low))
    low, high, height, i = low[order], high[order], height[order], i[order]
    first = np.ones(len(low), bool)
    first[1:] = (low[1:] != low[:-1]) | (high[1:] != high[:-1])
    return low[first], high[first], height[first], i[first]


def _join(n: int, a: NDArray[np.int64], b: NDArray[np.int64]) -> NDArray[np.int32]:
    """Number of the connected group of each of ``n`` labels; label 0 keeps 0."""
    from scipy.sparse import coo_array
    from scipy.sparse.csgraph import connected_components

    graph = coo_array((np.ones(len(a), bool), (a, b)), shape=(n, n))
    group = connected_components(graph, directed=False)[1].astype(np.int32)
    _, group = np.unique(np.where(np.arange(n) == 0, -1, group), return_inverse=True)
    return group.astype(np.int32)


def _merge(
    space: Space,
    basin: NDArray[np.int32],
    peak: NDArray[np.float32],
    passes: tuple[NDArray[np.int64], NDArray[np.int64], NDArray[np.float32], NDArray[np.int64]],
) -> NDArray[np.int32]:
    """Join neighbouring basins over their passes, widest first, unless the pass is a narrow place.

    Returns the region of each basin.
    """
    half = space.half_width_m
    root = np.arange(len(peak), dtype=np.int32)
    peak = peak.copy()
    reach = int(np.ceil(NEAR_M / space.cell_m))
    width = half.shape[1]
    for k in np.argsort(-passes[2], kind="stable").tolist():
        p, q = root[passes[0][k]], root[passes[1][k]]
        height = passes[2][k]
        if p == q:
            continue
        if space.settings.door_rule == "absolute":
            apart = 2 * height < DOOR_WIDTH_M and height < 0.95 * min(peak[p], peak[q])
        else:
            near = _near(half, root, basin, divmod(int(passes[3][k]), width), (p, q), reach)
            apart = height < DOOR_RATIO * near
            apart = apart or height < MOUTH_RATIO * max(peak[p], peak[q])
        if not apart:
            root[root == q] = p
            peak[p] = max(peak[p], peak[q])
    return np.unique(root, return_inverse=True)[1].astype(np.int32)


def _near(
    half: NDArray[np.float32],
    root: NDArray[np.int32],
    basin: NDArray[np.int32],
    pixel: tuple[int, int],
    sides: tuple[int, int],
    reach: int,
) -> float:
    """The smaller of the two greatest values of ``half`` on either side of a pass, within ``reach`` of it."""
    box = tuple(slice(max(0, v - reach), v + reach + 1) for v in pixel)
    owner = root[basin[box]]
    return min(float(half[box][owner == side].max(initial=0)) for side in sides)


def _is_door(
    space: Space,
    region: NDArray[np.int32],
    opening: Opening,
    in_corridor: bool,
) -> bool:
    """Whether a narrow place is a door: the space on both sides is wider, soon enough."""
    ratio, most = FRAME_RATIO, FRAME_M
    if in_corridor:
        ratio = CORRIDOR_DOOR_RATIO
    elif opening.width_m <= LEAF_M:
        most = DEEP_FRAME_M
    reach = int(np.ceil(DEEP_FRAME_M / space.cell_m))
    box = tuple(slice(max(0, v - reach), v + reach + 1) for v in opening.pixel)
    side = _sides(space, region[box], opening, (box[0].start, box[1].start))
    if side is None or opening.width_m >= DOOR_WIDTH_M:
        return False
    roomy = space.half_width_m[box] >= opening.width_m / 2 / ratio + space.cell_m / 2
    depth = 0.0
    for number in (1, 2):
        rows, columns = np.nonzero(roomy & (side == number))
        if not len(rows):
            return False
        away = np.hypot(rows + box[0].start - opening.pixel[0], columns + box[1].start - opening.pixel[1])
        depth += float(away.min()) * space.cell_m
    return depth <= most


def _sides(
    space: Space, region: NDArray[np.int32], opening: Opening, corner: tuple[int, int]
) -> NDArray[np.int8] | None:
    """1 and 2 on the two sides of an opening: its regions, or the two sides of the line across it.

    ``region`` is the part of the regions that begins at ``corner``.
    """
    a, b = opening.regions
    if a != b:
        return (region == a).astype(np.int8) + 2 * (region == b).astype(np.int8)
    row, column = opening.pixel
    across = jambs(space.free, opening.pixel, float(space.half_width_m[row, column]) / space.cell_m)
    if across is None:
        return None
    ahead = np.array([across[0][1] - across[1][1], across[1][0] - across[0][0]], float)
    rows, columns = np.indices(region.shape)
    rows, columns = rows + corner[0] - row, columns + corner[1] - column
    # straight ahead, give or take 45 degrees: what lies aside belongs to neither side
    share = (rows * ahead[0] + columns * ahead[1]) / np.hypot(*ahead)
    beyond = np.abs(share) >= 0.7 * np.hypot(rows, columns)
    return ((region == a) * beyond * np.where(share > 0, 1, np.where(share < 0, 2, 0))).astype(np.int8)


def _tidy(
    space: Space, region: NDArray[np.int32], gaps: NDArray[np.int64] | None = None
) -> tuple[NDArray[np.int32], list[Opening], Regions]:
    """Join what is not a space of its own to its neighbour: slivers, bays, and the two ways around a table.

    Nothing is joined across the middles of ``gaps`` ``(n, 2)`` in walls. Returns the regions, the openings between
    them, and what is known of each.
    """
    throats: dict[tuple[int, int], tuple[int, int]] = {}
    unchanged: list[Opening] = []
    while True:
        openings = _openings(space, region, throats, unchanged)
        measure = measure_regions(space, region, openings)
        root = np.arange(len(measure.area_m2), dtype=np.int32)
        mouths: dict[tuple[int, int], int] = {}
        exits = np.zeros(len(root), np.int64)
        for opening in openings:
            mouths[opening.regions] = mouths.get(opening.regions, 0) + (not opening.is_door)
            exits[list(opening.regions)] += 1
        touched: set[int] = set()
        for opening in sorted(openings, key=lambda o: -o.width_m):
            a, b = sorted(opening.regions, key=lambda r: (measure.area_m2[r], r))  # a is the smaller one
            parted = opening.is_door or (gaps is not None and _is_near(opening.pixel, gaps, space))
            if parted and measure.area_m2[a] >= space.settings.smallest_room_m2 / 2:
                continue
            overflows = measure.elongation[a] < 0.8  # its own largest circle reaches into the neighbours
            tiny = measure.area_m2[a] < space.settings.smallest_room_m2 / 2
            bay = (
                exits[a] == 1
                and measure.area_m2[a] < BAY_SHARE * measure.area_m2[b]
                and measure.elongation[a] < 1.5
                and opening.width_m > 1.4 * measure.peak_m[a]
            )
            around = mouths[opening.regions] > 1
            if (overflows or tiny or bay or around) and not touched & {a, b}:
                root[a] = b
                touched |= {a, b}
        if not touched:
            return region, openings, measure
        number = np.unique(root, return_inverse=True)[1].astype(np.int32)
        region = number[region]
        unchanged = []
        for opening in openings:
            if not touched & {*opening.regions}:
                a, b = sorted(number[list(opening.regions)].tolist())
                unchanged.append(replace(opening, regions=(a, b)))


def _openings(
    space: Space,
    region: NDArray[np.int32],
    throats: dict[tuple[int, int], tuple[int, int]],
    unchanged: Sequence[Opening] = (),
) -> list[Opening]:
    """One opening for every connected stretch of border between two regions.

    ``throats`` are those found before, ``unchanged`` the openings of pairs of regions that are as they were.
    """
    from scipy import ndimage

    width = region.shape[1]
    n = int(region.max()) + 1
    flat, half = region.ravel(), space.half_width_m.ravel()
    sides = []
    for step in (1, width):
        i = np.flatnonzero((flat[:-step] != flat[step:]) & (flat[:-step] > 0) & (flat[step:] > 0))
        sides.append(np.stack([flat[i], flat[i + step], i, i + step]))
    a, b, here, there = np.concatenate(sides, axis=1).astype(np.int64)
    key = np.minimum(a, b) * n + np.maximum(a, b)
    order = np.argsort(key, kind="stable")
    if not len(order):
        return []
    pairs, first = np.unique(key[order], return_index=True)
    border = {
        (int(k // n), int(k % n)): np.concatenate([here[rows], there[rows]])
        for k, rows in zip(pairs, np.split(order, first[1:]), strict=True)
    }
    known: dict[tuple[int, int], list[Opening]] = {}
    for opening in unchanged:
        known.setdefault(opening.regions, []).append(opening)
    found = []
    for pair, pixels in sorted(border.items()):
        if pair in known:
            found += known[pair]
            continue
        rows, columns = np.divmod(np.unique(pixels), width)
        patch = np.zeros((np.ptp(rows) + 1, np.ptp(columns) + 1), bool)
        patch[rows - rows.min(), columns - columns.min()] = True
        stretch = ndimage.label(patch, structure=EIGHT)[0][rows - rows.min(), columns - columns.min()]
        for s in range(1, stretch.max() + 1):
            r, c = rows[stretch == s], columns[stretch == s]
            best = int(np.argmax(half[r * width + c]))
            at = int(r[best]), int(c[best])
            if at not in throats:
                throats[at] = _throat(space, at)
            pixel = throats[at]
            # half a cell less on either side: the wall begins at the edge of its first cell
            found.append(Opening(pixel, pair, 2 * float(space.half_width_m[pixel]) - space.cell_m, False))
            found[-1].is_door = _is_door(space, region, found[-1], False)
    return found


def _throat(space: Space, pixel: tuple[int, int]) -> tuple[int, int]:
    """The cell near a place on a border that lies between two walls; the place itself if there is none.

    Where a doorway was joined to one of its sides, the border lies before it.
    """
    reach = round(THROAT_M / space.cell_m)
    steps = np.indices((2 * reach + 1, 2 * reach + 1)).reshape(2, -1).T - reach
    order = np.argsort((steps**2).sum(axis=1), kind="stable")
    for row, column in (steps[order] + pixel).tolist():
        if 0 <= row < space.free.shape[0] and 0 <= column < space.free.shape[1] and space.free[row, column]:
            half = float(space.half_width_m[row, column]) / space.cell_m
            if jambs(space.free, (row, column), half) is not None:
                return row, column
    return pixel


def _ways_out(
    openings: list[Opening], is_room: NDArray[np.bool_], measure: Regions
) -> dict[int, list[tuple[int, int]]]:
    """For each room the cells where it opens into a corridor without a door."""
    found: dict[int, list[tuple[int, int]]] = {}
    for opening in openings:
        for number, other in (opening.regions, opening.regions[::-1]):
            is_corridor = measure.exits[other] >= 2 or measure.elongation[other] >= CORRIDOR_ELONGATION
            if is_room[number] and not opening.is_door and is_corridor:
                found.setdefault(number, []).append(opening.pixel)
    return found


def _inner_doors(
    space: Space,
    region: NDArray[np.int32],
    passes: NDArray[np.int64],
    others: list[Opening],
    walls: _Walls,
) -> list[Opening]:
    """Doors with the same region on both sides: narrow places between two walls, not beside furniture.

    Only the narrowest of several close to each other, and none close to the ``others``.
    """
    taken = np.full((len(others) + len(passes), 2), np.inf)
    taken[: len(others)] = np.array([opening.pixel for opening in others]).reshape(-1, 2)
    found: list[Opening] = []
    half = space.half_width_m.ravel()[passes].astype(float)
    for k in np.argsort(half, kind="stable").tolist():
        row, column = (int(v) for v in divmod(int(passes[k]), region.shape[1]))
        number = int(region[row, column])
        opening = Opening((row, column), (number, number), 2 * half[k] - space.cell_m, True)
        if not NARROWEST_DOOR_M <= opening.width_m <= LEAF_M:
            continue
        away = np.hypot(taken[:, 0] - row, taken[:, 1] - column)
        if away.min() * space.cell_m < FRAME_M:
            continue
        if walls.beside(opening) and _is_door(space, region, opening, True):
            taken[len(others) + len(found)] = opening.pixel
            found.append(opening)
    return found


class _Walls:
    """What is not free, by size: walls are large, furniture and pillars are not."""

    def __init__(self, space: Space):
        from scipy import ndimage

        self.space = space
        self.label, n = ndimage.label(~space.free, structure=EIGHT)
        self.is_wall = np.zeros(n + 1, bool)
        for i, (rows, columns) in enumerate(ndimage.find_objects(self.label), start=1):
            extent = max(rows.stop - rows.start, columns.stop - columns.start) * space.cell_m
            self.is_wall[i] = extent >= WALL_M

    def beside(self, opening: Opening) -> bool:
        """Whether an opening lies between two walls."""
        half = float(self.space.half_width_m[opening.pixel]) / self.space.cell_m
        ends = jambs(self.space.free, opening.pixel, half)
        return ends is not None and all(self.is_wall[self.label[end]] for end in ends)
