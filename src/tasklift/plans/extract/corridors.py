"""The lines of a building: stars in rooms, from their middle to their doors; skeletons in corridors."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from tasklift.plans.extract.axes import is_spike
from tasklift.plans.extract.bends import role_of, taut, turn_at
from tasklift.plans.extract.paths import Node, PathGraph, Points, line_length, straight, trace
from tasklift.plans.extract.regions import Opening, jambs
from tasklift.plans.extract.segment import Division
from tasklift.plans.extract.space import Space, fill_islands

# A branch of a corridor that reaches less than this beyond the wall is a niche.
PRUNE_M = 0.5
# Junctions closer to each other are one, and those closer than this part of the half width.
MERGE_M = 1.0
MERGE_SHARE = 0.6
SHORTEST_RING_M = 1.2
TURN_M = 2.0  # how far from a bend its two corridors show how it turns
BESIDE_M = 0.3  # a room's node keeps so far from its furniture
SAME_M = 0.6  # junctions whose corridors' axes cross so near to each other are one


def draw_lines(division: Division) -> PathGraph:
    """The lines of the whole building: one graph for every region, tied together at the openings."""
    from scipy import ndimage

    space, region, is_room = division.space, division.region, division.is_room
    # corridors that run into each other without a door are one: their skeleton should not break there
    root = np.arange(len(is_room), dtype=np.int32)
    for opening in division.openings:
        a, b = (int(root[r]) for r in opening.regions)
        if not opening.is_door and not is_room[a] and not is_room[b]:
            root[root == max(a, b)] = min(a, b)
    region = root[region]
    ties: list[tuple[Opening, list[tuple[int, tuple[int, int]]]]] = []
    barred = np.zeros(region.shape, bool)
    for opening in division.openings:
        a, b = (int(root[r]) for r in opening.regions)
        if a != b:
            ties.append((opening, [(side, opening.pixel) for side in (a, b) if side]))
        elif opening.is_door and not is_room[a]:
            # a corridor leads around to the door's other side: bar it, so that the skeleton ends on either side
            beside = _bar(barred, space, opening)
            if beside is not None:
                ties.append((opening, [(a, side) for side in beside]))
    region[barred] = 0

    whole = PathGraph()
    of_region: dict[int, list[tuple[int, tuple[int, int]]]] = {}
    for opening, sides in ties:
        row, column = opening.pixel
        role = "door" if opening.is_door else "path"
        half = float(space.half_width_m[row, column])
        across = jambs(space.free, opening.pixel, half / space.cell_m)
        node = whole.add_node(Node((float(row), float(column)), half, role, 0, across))
        for number, point in sides:
            of_region.setdefault(number, []).append((node, point))
    for number, box in enumerate(ndimage.find_objects(region), start=1):
        if box is None:
            continue
        mine = of_region.get(number, [])
        # a door that the plan declares may lie beside its region
        cells = np.array([point for _, point in mine] or [(box[0].start, box[1].start)])
        low, high = cells.min(axis=0).tolist(), cells.max(axis=0).tolist()
        box = tuple(
            slice(max(0, min(s.start, first) - 1), max(s.stop, last + 1) + 1)
            for s, first, last in zip(box, low, high, strict=True)
        )
        mask = region[box] == number
        points = [(point[0] - box[0].start, point[1] - box[1].start) for _, point in mine]
        part, ends = _draw_region(space, box, mask, points, bool(is_room[number]), number)
        _tie(whole, part, ends, [node for node, _ in mine])
    _simplify(whole, space, is_room)
    return whole


def _bar(barred: NDArray[np.bool_], space: Space, opening: Opening) -> tuple[tuple[int, int], tuple[int, int]] | None:
    """Draw a bar across a door; returns a cell on either side of it, or ``None`` if that does not work out."""
    ends = jambs(space.free, opening.pixel, opening.width_m / 2 / space.cell_m)
    if ends is None:
        return None
    line = straight(*(np.array(end) for end in ends))
    across = np.subtract(ends[1], ends[0]) / np.hypot(*np.subtract(ends[1], ends[0]))
    sides = []
    for sign in (-1, 1):
        row, column = np.rint(opening.pixel + sign * 3 * np.array([-across[1], across[0]])).astype(int).tolist()
        within = 0 <= row < space.free.shape[0] and 0 <= column < space.free.shape[1]
        if not within or not space.free[row, column]:
            return None
        sides.append((row, column))
    for row, column in ((0, 0), (0, 1), (1, 0), (0, -1), (-1, 0)):
        barred[tuple((line + np.array([row, column])).clip(0, np.array(barred.shape) - 1).T)] = True
    return sides[0], sides[1]


def _draw_region(
    space: Space,
    box: tuple[slice, ...],
    mask: NDArray[np.bool_],
    points: list[tuple[int, int]],
    is_room: bool,
    number: int,
) -> tuple[PathGraph, list[tuple[int, Points]]]:
    """The lines within one region, and for each of its openings the node and the line that leads there.

    ``mask`` are the region's cells in ``box``, ``points`` its openings there.
    """
    half, corner = space.half_width_m[box], (box[0].start, box[1].start)
    if is_room:
        centre = _centre(mask, half, space.filled[box], space.cell_m)
        if _star_serves(np.array(points, float).reshape(-1, 2), np.array(centre, float), space.cell_m):
            graph = PathGraph()
            room = graph.add_node(
                Node((float(centre[0] + corner[0]), float(centre[1] + corner[1])), float(half[centre]), "room", number)
            )
            target = np.zeros_like(mask)
            target[centre] = True
            lead = _Leads(mask, target)
            lines = [lead(point) + np.array(corner, float) for point in points]
            return graph, [(room, line) for line in lines]
    from skimage.morphology import skeletonize

    # what another region left of a cell or two would be a ring in the skeleton
    mask = mask | fill_islands(mask, space.furniture_m / space.cell_m)
    pixels = skeletonize(mask)
    graph = trace(pixels, half, owner=number)
    graph.prune(_reaches_out(space))
    kept = _pixels(graph, mask.shape)
    lead = _Leads(mask, kept)
    leads = [lead(point) for point in [*points, *([centre] if is_room else [])]]
    graph = trace(kept, half, {(int(line[-1][0]), int(line[-1][1])) for line in leads}, corner, number)
    where = {node.at: number for number, node in graph.nodes.items()}
    ends = []
    for line in leads:
        line = line + np.array(corner, float)
        ends.append((where[float(line[-1][0]), float(line[-1][1])], line))
    if is_room:
        at, line = ends.pop()
        node = graph.nodes[at]
        if len(line) == 1 and node.role == "path":
            node.role = "room"
        else:
            room = graph.add_node(Node((float(line[0][0]), float(line[0][1])), float(half[centre]), "room", number))
            graph.add_edge(at, room, line[::-1])
    return graph, ends


def _centre(
    mask: NDArray[np.bool_], half: NDArray[np.float32], filled: NDArray[np.bool_], cell_m: float
) -> tuple[int, int]:
    """The free cell nearest to the middle of a region, a step away from its walls and furniture where that is near."""
    from scipy import ndimage

    cells = np.argwhere(mask)
    roomy = mask & (half >= 0.5 * half[mask].max())
    if filled.any():
        beside = roomy & ~ndimage.binary_dilation(filled, iterations=max(1, round(BESIDE_M / cell_m)))
        roomy = beside if beside.any() else roomy
    roomy = np.argwhere(roomy)
    middle = cells.mean(axis=0)
    row, column = roomy[np.argmin(((roomy - middle) ** 2).sum(axis=1))].tolist()
    return row, column


def _star_serves(points: Points, centre: Points, cell_m: float) -> bool:
    """Whether ways through a room by its centre are hardly longer than the straight ones."""
    if len(points) < 2:
        return True
    radius = np.hypot(*(points - centre).T)
    straight = np.hypot(*(points[:, None] - points[None]).transpose(2, 0, 1))
    detour = radius[:, None] + radius[None] - straight
    np.fill_diagonal(detour, 0)
    return bool((detour * cell_m <= 1.0 + 0.5 * straight * cell_m).all())


class _Leads:
    """Finds the shortest lines of cells within ``mask`` to the nearest of the ``targets``."""

    def __init__(self, mask: NDArray[np.bool_], targets: NDArray[np.bool_]):
        from scipy.spatial import KDTree

        self.mask, self.targets = mask, targets
        self.cells = np.argwhere(targets)
        self.tree = KDTree(self.cells)

    def __call__(self, point: tuple[int, int]) -> Points:
        """The line from ``point``, which may be a cell outside the mask, to the target."""
        from skimage.graph import MCP_Geometric

        distance, nearest = self.tree.query(point)
        direct = straight(np.array(point), self.cells[nearest])
        if self.mask[tuple(direct[1:].T)].all():
            return direct.astype(float)
        reach = int(2 * distance) + 10
        while True:
            low = np.maximum(0, np.array(point) - reach)
            box = tuple(slice(int(s), int(p) + reach + 1) for s, p in zip(low, point, strict=True))
            cost = np.where(self.mask[box], 1.0, -1.0)
            start = tuple(int(v) for v in np.array(point) - low)
            cost[start] = 1.0
            ends = np.argwhere(self.targets[box])
            search = MCP_Geometric(cost)
            total, _ = search.find_costs([start], ends.tolist(), find_all_ends=False)
            costs = total[tuple(ends.T)]
            if np.isfinite(costs).any():
                return np.array(search.traceback(ends[int(np.argmin(costs))].tolist()), float) + low
            if cost.shape == self.mask.shape:
                return direct.astype(float)
            reach *= 2


def _reaches_out(space: Space, is_room: NDArray[np.bool_] | None = None) -> Callable[[float, Node, Node], bool]:
    """Whether a dangling branch reaches far enough beyond the walls of the space that it leaves.

    Within a room none does: the room's node stands for all of it.
    """

    def reaches_out(length: float, leaf: Node, stem: Node) -> bool:
        if is_room is not None and is_room[leaf.owner]:
            return False
        beyond = length * space.cell_m + leaf.half - stem.half
        return beyond >= max(PRUNE_M, 0.5 * stem.half)

    return reaches_out


def _pixels(graph: PathGraph, shape: tuple[int, ...]) -> NDArray[np.bool_]:
    pixels = np.zeros(shape, bool)
    for _, _, line in graph.edges.values():
        pixels[tuple(line.astype(int).T)] = True
    for node in graph.nodes.values():
        pixels[int(node.at[0]), int(node.at[1])] = True
    return pixels


def _tie(whole: PathGraph, part: PathGraph, ends: list[tuple[int, Points]], doors: list[int]) -> None:
    """Copy ``part`` into ``whole`` and join it to the openings."""
    number = {old: whole.add_node(node) for old, node in part.nodes.items()}
    for a, b, line in part.edges.values():
        whole.add_edge(number[a], number[b], line)
    for (node, line), door in zip(ends, doors, strict=True):
        at = np.array([whole.nodes[door].at])  # the line may begin beside the door
        whole.add_edge(door, number[node], line if (line[0] == at[0]).all() else np.concatenate([at, line]))


def _simplify(graph: PathGraph, space: Space, is_room: NDArray[np.bool_]) -> None:
    def near(a: Node, b: Node) -> float:
        return max(MERGE_M, MERGE_SHARE * max(a.half, b.half)) / space.cell_m

    reaches_out = _reaches_out(space, is_room)
    graph.prune(reaches_out)
    graph.drop_rings(SHORTEST_RING_M / space.cell_m)
    graph.contract(near)
    graph.drop_rings(SHORTEST_RING_M / space.cell_m)
    graph.prune(reaches_out)


def join_same(graph: PathGraph, space: Space) -> None:
    """Make one of junctions that came to lie at the same place."""
    for edge, (a, b, line) in graph.edges.items():
        if a != b and all(graph.nodes[end].role == "path" and graph.degree(end) >= 3 for end in (a, b)):
            pulled = taut(line, space.free)
            if line_length(pulled) * space.cell_m < SAME_M:
                graph.edges[edge] = (a, b, pulled)
    graph.contract(lambda a, b: SAME_M / space.cell_m)


def drop_spikes(graph: PathGraph, space: Space) -> None:
    """Remove the dead ends in the sharp corners where two corridors meet; what is left there is a bend."""
    for node in [number for number, node in graph.nodes.items() if node.role == "path"]:
        if graph.degree(node) != 1:
            continue
        (edge,) = graph.incident[node]
        stem = graph.other(edge, node)
        if graph.nodes[stem].role == "path" and graph.degree(stem) == 3 and is_spike(graph.line(edge, node), space):
            graph.remove_node(node)
            ways = [graph.line(other, stem) for other in sorted(graph.incident[stem])]
            if len(ways) == 2:
                before, after = (way[min(round(TURN_M / space.cell_m), len(way) - 1)] for way in ways)
                turn = turn_at(before, np.array(graph.nodes[stem].at), after)
                graph.nodes[stem].role = role_of(turn) or "path"
    graph.dissolve()


def keep_joined(graph: PathGraph) -> int:
    """Remove all but the largest part that is joined; returns how many nodes that were."""
    parts: list[set[int]] = []
    left = set(graph.nodes)
    while left:
        part = {min(left)}
        stack = list(part)
        while stack:
            node = stack.pop()
            for edge in graph.incident[node]:
                other = graph.other(edge, node)
                if other not in part:
                    part.add(other)
                    stack.append(other)
        parts.append(part)
        left -= part
    lost = sorted(set(graph.nodes) - max(parts, key=len, default=set()))
    for node in lost:
        graph.remove_node(node)
    return len(lost)
