"""Graphs of routes for robots: nodes joined by straight lines that keep a robot's radius from walls.

A building's own graph says how rooms hang together; its corridors bend, and a robot needs nodes where it turns. Here
the free floor of the plan is covered anew: with the building's nodes, the corners around which shortest ways turn, and
nodes from which the rest of the floor is in sight. All lines are straight, since Nav2's route server and fleet managers
drive straight from node to node, whatever line a file draws.
"""

from __future__ import annotations

import heapq
import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from tasklift.building.graph import Building
from tasklift.errors import TaskliftError
from tasklift.plans.extract.paths import line_length
from tasklift.plans.floor import Floor
from tasklift.plans.plan import Plan

RADIUS_M = 0.3
# Floor that only a thinner robot reaches is not covered; ways lead through it where there is no other.
NARROW_M = 0.2
CORNER_M = 0.12  # how far from a wall's corner beyond the radius ways turn
STRAIGHT_M = 0.1
TURN_DEGREES = 25.0
APART_M = 0.5  # nodes other than the building's are so far from each other
SIGHT_M = 4.0  # how far from each other points and nodes are that see each other
LINE_M = 8.0
SAMPLE_M = 0.4
SMALLEST_M2 = 0.25
STRETCH = 1.1  # a line is left out if a way over others is at most this much longer
AROUND = 1.1  # and one around a corner is laid if the way over others is longer than this
NARROW_COST = 1000.0  # of a cell too near to a wall, where others cost 1
SNAP_M = 1.0

Points = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class Routes:
    """A graph of routes.

    Attributes
    ----------
    position_m
        ``float64 (n, 2)`` (m).
    edges
        ``int64 (m, 2)``: straight lines, to be driven both ways.
    node
        ``int64 (n,)``: the building's node of that place, or -1.
    clearance_m
        ``float64 (m,)``: how far from walls each line stays (m); not a number where that is not known.
    remarks
        What a user should know, a sentence each.
    """

    position_m: Points
    edges: NDArray[np.int64]
    node: NDArray[np.int64]
    clearance_m: Points
    remarks: tuple[str, ...] = ()

    @property
    def length_m(self) -> Points:
        """``float64 (m,)``: length of each line (m)."""
        return np.hypot(*(self.position_m[self.edges[:, 0]] - self.position_m[self.edges[:, 1]]).T)


def routes_of(building: Building, plan: Plan | None, radius_m: float = RADIUS_M) -> Routes:
    """Return the routes of a building on its plan; without a plan those along its corridors.

    Parameters
    ----------
    building
        Its nodes become nodes of the routes, moved by up to a metre where they are too near to a wall.
    plan
        The floor plan, in the building's coordinates.
    radius_m
        How far from walls lines stay, where the floor allows it: narrower passages are only used where nothing
        else joins two parts of the floor.

    Raises
    ------
    TaskliftError
        If no node of the building lies on free floor of the plan.

    Examples
    --------
    >>> from tasklift.building import generate
    >>> from tasklift.plans.raster import rasterise
    >>> building = generate(seed=7)
    >>> routes = routes_of(building, rasterise(building))
    >>> sorted(routes.node[routes.node >= 0].tolist()) == list(range(building.n_nodes))
    True
    """
    if plan is None:
        return _along_corridors(building)
    return _Net(building, Floor.of(plan), radius_m).routes()


def _along_corridors(building: Building) -> Routes:
    position, edges = list(building.position_m), []
    for edge, (a, b) in enumerate(building.edges.tolist()):
        first = a
        for point in building.course_m[edge]:
            position.append(point)
            edges.append((first, len(position) - 1))
            first = len(position) - 1
        edges.append((first, b))
    node = np.full(len(position), -1)
    node[: building.n_nodes] = np.arange(building.n_nodes)
    return Routes(
        np.array(position),
        np.array(edges, np.int64),
        node,
        np.full(len(edges), np.nan),
        ("there is no floor plan: lines follow the corridors, and their distance from walls is not known",),
    )


class _Net:
    """A graph on a floor that grows; positions are cells, distances metres."""

    def __init__(self, building: Building, floor: Floor, radius_m: float):
        self.building, self.floor, self.radius = building, floor, radius_m
        self.at: list[tuple[float, float]] = []
        self.node: list[int] = []
        self.beside: list[dict[int, float]] = []  # by node, the length (cells) of the line to each other
        self.off: dict[int, tuple[float, float]] = {}  # nodes of the building that lie on no floor

    def routes(self) -> Routes:
        clearance = self.floor.clearance_m
        self._place_building(clearance)
        covered = self._covered(clearance)
        self._place_corners(clearance, covered)
        self._cover(covered)
        self._join_in_sight()
        self._join_around(clearance)
        remarks = self._join_those_off()
        at, edges = np.array(self.at), np.array(self.edges, np.int64).reshape(-1, 2)
        return Routes(
            np.round(self.floor.to_world(at), 3),
            edges,
            np.array(self.node, np.int64),
            self.floor.clearance_between(at[edges[:, 0]], at[edges[:, 1]]),
            tuple(remarks),
        )

    def _add(self, at: tuple[float, float], node: int = -1) -> int:
        self.at.append((float(at[0]), float(at[1])))
        self.node.append(node)
        self.beside.append({})
        return len(self.at) - 1

    def _join(self, a: int, b: int) -> None:
        if a != b:
            self.beside[a][b] = self.beside[b][a] = math.dist(self.at[a], self.at[b])

    @property
    def edges(self) -> list[tuple[int, int]]:
        """The lines, the lower node first."""
        return sorted((a, b) for a, near in enumerate(self.beside) for b in near if a < b)

    # -- nodes --------------------------------------------------------------------------------------

    def _place_building(self, clearance: NDArray[np.float32]) -> None:
        """The building's nodes, each moved to the nearest place with clearance enough, or left where it is free."""
        from scipy import ndimage

        cells = self.floor.to_cells(self.building.position_m)
        safe = clearance >= self.radius
        away, nearest = ndimage.distance_transform_edt(~safe, return_indices=True)
        here = self.floor.clearance_at(cells)
        for i, at in enumerate(cells.tolist()):
            row, column = round(at[0]), round(at[1])
            inside = 0 <= row < safe.shape[0] and 0 <= column < safe.shape[1]
            if here[i] < self.radius and inside and away[row, column] * self.floor.cell_m <= SNAP_M and safe.any():
                moved = nearest[:, row, column]
                if here[i] > 0 and not self._open_between(at, moved):
                    moved = np.array([row, column])
                at = moved.tolist()
            if here[i] > 0 or self.floor.clearance_at(np.array([at]))[0] > 0:
                self._add((at[0], at[1]), i)
            else:
                self.off[i] = (at[0], at[1])
        if not self.at:
            raise TaskliftError(
                f"building {self.building.name!r}: none of its nodes lies on free floor of the plan; is it this plan?"
            )

    def _open_between(self, a: Points | list[float], b: Points) -> bool:
        return bool(self.floor.clearance_between(np.array([a], float), np.array([b], float))[0] > 0)

    def _covered(self, clearance: NDArray[np.float32]) -> NDArray[np.bool_]:
        """Floor with clearance enough in those parts that hold nodes of the building."""
        from scipy import ndimage

        part, n = ndimage.label(clearance >= min(NARROW_M, self.radius), np.ones((3, 3), bool))
        rows, columns = np.rint(np.array(self.at)).astype(int).T
        ours = np.zeros(n + 1, bool)
        ours[part[rows, columns]] = True
        ours[0] = False
        safe, n = ndimage.label((clearance >= self.radius) & ours[part])
        large = np.bincount(safe.ravel(), minlength=n + 1) * self.floor.cell_m**2 >= SMALLEST_M2
        large[0] = False
        return large[safe]

    def _place_corners(self, clearance: NDArray[np.float32], covered: NDArray[np.bool_]) -> None:
        """Nodes where shortest ways turn: beside the corners of walls that stand into the floor."""
        from skimage.measure import approximate_polygon, find_contours

        cell = self.floor.cell_m
        found: list[tuple[float, float, float]] = []
        for line in find_contours(clearance, self.radius + CORNER_M):
            line = approximate_polygon(line, STRAIGHT_M / cell)
            closed = len(line) > 2 and bool((line[0] == line[-1]).all())
            ring = np.concatenate([line[-2:-1], line]) if closed else line
            before, after = np.diff(ring[:-1], axis=0), np.diff(ring[1:], axis=0)
            turn = np.arctan2(
                before[:, 0] * after[:, 1] - before[:, 1] * after[:, 0], (before * after).sum(axis=1)
            )
            # the higher side, the floor, lies on a fixed side of the line: this sign turns around the wall
            for (row, column), angle in zip(ring[1:-1].tolist(), turn.tolist(), strict=True):
                if angle > math.radians(TURN_DEGREES) and covered[round(row), round(column)]:
                    found.append((-angle, row, column))
        taken = _Near(APART_M / cell, self.at)
        for _, row, column in sorted(found):
            if taken.add((row, column)):
                self._add((row, column))

    def _cover(self, covered: NDArray[np.bool_]) -> None:
        """Nodes until every sample of the floor sees one: each time at the widest place out of sight."""
        step = max(1, round(SAMPLE_M / self.floor.cell_m))
        rows, columns = np.nonzero(covered)
        rest = (rows % step == step // 2) & (columns % step == step // 2)
        points = np.column_stack([rows[rest], columns[rest]]).astype(float)
        seen = self._seen(points, np.array(self.at))
        wide = np.minimum(self.floor.clearance_at(points), SIGHT_M / 2)
        order = np.argsort(-wide, kind="stable")
        for i in order.tolist():
            if not seen[i]:
                self._add((points[i, 0], points[i, 1]))
                left = np.flatnonzero(~seen)
                seen[left] = self._seen(points[left], points[[i]])
                seen[i] = True

    def _seen(self, points: Points, nodes: Points) -> NDArray[np.bool_]:
        """Which points see one of the nodes, with clearance enough on the way; the nearest nodes are tried first."""
        from scipy.spatial import cKDTree

        seen = np.zeros(len(points), bool)
        if not len(points):
            return seen
        near = min(8, len(nodes))
        away, index = cKDTree(nodes).query(points, k=near, distance_upper_bound=SIGHT_M / self.floor.cell_m)
        away, index = away.reshape(-1, near), index.reshape(-1, near)
        for k in range(near):
            asked = np.flatnonzero(~seen & np.isfinite(away[:, k]))
            between = self.floor.clearance_between(points[asked], nodes[index[asked, k]])
            seen[asked] = between >= self.radius
        return seen

    # -- lines --------------------------------------------------------------------------------------

    def _join_in_sight(self) -> None:
        """Join nodes that see each other, but where a way over others is hardly longer, the shortest lines first."""
        from scipy.spatial import cKDTree

        at = np.array(self.at)
        pairs = cKDTree(at).query_pairs(LINE_M / self.floor.cell_m, output_type="ndarray")
        length = np.hypot(*(at[pairs[:, 0]] - at[pairs[:, 1]]).T)
        fits = self.floor.clearance_between(at[pairs[:, 0]], at[pairs[:, 1]]) >= self.radius
        pairs, length = pairs[fits], length[fits]
        order = np.lexsort((pairs[:, 1], pairs[:, 0], np.round(length, 6)))
        for (a, b), straight in zip(pairs[order].tolist(), length[order].tolist(), strict=True):
            if not self._leads(a, b, STRETCH * straight):
                self._join(a, b)

    def _join_around(self, clearance: NDArray[np.float32]) -> None:
        """Lay ways between nodes whose surroundings touch: where no line joins two parts, or only a much longer way.

        Each cell of the floor belongs to the node that is nearest over the floor; where two meet, the way through that
        place is the shortest between them. Passages narrower than the radius cost so much that ways lead through them
        only between parts of the floor that nothing wider joins. A step across a corner may be too narrow though both
        cells are wide enough: then another way is looked for first.
        """
        from scipy import ndimage
        from skimage.graph import MCP_Geometric

        part, _ = ndimage.label(clearance >= self.radius)
        lack = np.clip((self.radius - clearance) / self.radius, 0, 1)
        cost = np.where(clearance > 0, 1 + NARROW_COST * ((lack > 0) + 3 * lack**2), -1.0)
        cells = np.rint(np.array(self.at)).astype(int)
        part_of = part[tuple(cells.T)]
        group = _Groups(len(self.at), self.edges)
        for last in (False, False, True):
            ways = MCP_Geometric(cost)
            total, step = ways.find_costs(cells)
            owner = _owners(total, step, np.array(ways.offsets), cells)
            tight = False
            for length, a, b, here, there in _meetings(total, owner):
                is_narrow = length >= NARROW_COST
                if is_narrow and tight and not last:
                    break
                apart = group.of(a) != group.of(b)
                if not apart and ((is_narrow and part_of[a] == part_of[b]) or self._leads(a, b, AROUND * length)):
                    continue
                path = _around_corners(np.array(ways.traceback(here) + ways.traceback(there)[::-1]), clearance)
                line = path.astype(float)
                squeezed = self.floor.clearance_between(line[:-1], line[1:]) < self.radius
                if squeezed.any() and not is_narrow and not (last and apart):
                    cost[tuple(path[1:][squeezed].T)] = NARROW_COST
                    tight = True
                elif apart or not is_narrow or not self._leads(a, b, AROUND * line_length(line) / math.sqrt(2)):
                    self._lay(a, b, line)
                    group.join(a, b)
            if not tight:
                return

    def _lay(self, first: int, last: int, path: Points) -> None:
        """Lay straight lines along a path of cells, each as long as it stays as far from walls as the path does."""
        path[0], path[-1] = self.at[first], self.at[last]
        here = np.minimum(self.floor.clearance_at(path), self.radius)
        end, i, node = len(path) - 1, 0, first
        reach = max(1, round(SIGHT_M / self.floor.cell_m))
        while i < end:
            ahead = np.arange(i + 1, min(end, i + reach) + 1)
            clear = self.floor.clearance_between(np.repeat(path[[i]], len(ahead), 0), path[ahead])
            fits = np.flatnonzero(clear >= np.minimum.accumulate(here[i : ahead[-1] + 1])[1:] - 1e-6)
            j = int(ahead[fits[-1]]) if len(fits) else i + 1
            following = last if j == end else self._add((path[j, 0], path[j, 1]))
            self._join(node, following)
            i, node = j, following

    def _leads(self, start: int, goal: int, most: float) -> bool:
        """Whether a way of at most this length (cells) leads from one node to another (Dijkstra, cut off)."""
        best = {start: 0.0}
        queue = [(0.0, start)]
        while queue:
            length, node = heapq.heappop(queue)
            if node == goal:
                return True
            if length > best[node]:
                continue
            for other, step in self.beside[node].items():
                new = length + step
                if new <= most and new < best.get(other, math.inf):
                    best[other] = new
                    heapq.heappush(queue, (new, other))
        return False

    def _join_those_off(self) -> list[str]:
        """Join nodes that no floor reaches as the building does, and leave out what stays apart."""
        number = {node: i for i, node in enumerate(self.node) if node >= 0}
        group = _Groups(len(self.at), self.edges)
        apart = set(self.off)
        for node, at in self.off.items():
            number[node] = self._add(at, node)
        for edge, (a, b) in enumerate(self.building.edges.tolist()):
            ends = number[a], number[b]
            if a in apart or b in apart or group.of(ends[0]) != group.of(ends[1]):
                last = ends[0]
                for point in self.floor.to_cells(self.building.course_m[edge].reshape(-1, 2)).tolist():
                    here = self._add((point[0], point[1]))
                    self._join(last, here)
                    last = here
                self._join(last, ends[1])
        self._keep(_Groups(len(self.at), self.edges).largest())
        if not apart:
            return []
        few = ", ".join(map(str, sorted(apart)[:8]))
        return [f"{len(apart)} nodes lie on no free floor ({few}); lines to them follow the building's corridors"]

    def _keep(self, kept: NDArray[np.bool_]) -> None:
        number = np.cumsum(kept) - 1
        self.at = [at for at, keep in zip(self.at, kept, strict=True) if keep]
        self.node = [node for node, keep in zip(self.node, kept, strict=True) if keep]
        self.beside = [
            {int(number[b]): length for b, length in near.items() if kept[b]}
            for near, keep in zip(self.beside, kept, strict=True)
            if keep
        ]


class _Groups:
    """Which nodes are joined (union and find)."""

    def __init__(self, n: int, edges: list[tuple[int, int]]):
        self.above = list(range(n))
        for a, b in edges:
            self.join(a, b)

    def of(self, node: int) -> int:
        """The node that stands for all that are joined with this one."""
        while self.above[node] != node:
            self.above[node] = node = self.above[self.above[node]]
        return node

    def join(self, a: int, b: int) -> None:
        """Join two groups."""
        self.above[self.of(a)] = self.of(b)

    def largest(self) -> NDArray[np.bool_]:
        """The nodes of the largest group."""
        group = np.array([self.of(node) for node in range(len(self.above))])
        return group == np.bincount(group).argmax()


class _Near:
    """Points that keep a distance from each other."""

    def __init__(self, distance: float, points: list[tuple[float, float]]):
        self.distance = distance
        self.tiles: dict[tuple[int, int], list[tuple[float, float]]] = {}
        for point in points:
            self.tiles.setdefault(self._tile(point), []).append(point)

    def _tile(self, point: tuple[float, float]) -> tuple[int, int]:
        return int(point[0] // self.distance), int(point[1] // self.distance)

    def add(self, point: tuple[float, float]) -> bool:
        """Add a point and return true, unless another one is near."""
        row, column = self._tile(point)
        for r in (row - 1, row, row + 1):
            for c in (column - 1, column, column + 1):
                if any(math.dist(point, other) < self.distance for other in self.tiles.get((r, c), ())):
                    return False
        self.tiles.setdefault((row, column), []).append(point)
        return True


def _owners(
    cost: NDArray[np.float64], step: NDArray[np.integer], offsets: NDArray[np.integer], seeds: NDArray[np.int64]
) -> NDArray[np.int64]:
    """The seed from which each cell was reached, -1 where none was, by following all steps back at once."""
    size = cost.size
    back = offsets @ [cost.shape[1], 1]
    flat = np.arange(size)
    above = np.where(step.ravel() >= 0, flat - back[np.maximum(step.ravel(), 0)], flat)
    while True:
        further = above[above]
        if (further == above).all():
            break
        above = further
    number = np.full(size, -1)
    number[seeds @ [cost.shape[1], 1]] = np.arange(len(seeds))
    return np.where(np.isfinite(cost.ravel()), number[above], -1).reshape(cost.shape)


def _around_corners(path: NDArray[np.int64], clearance: NDArray[np.float32]) -> NDArray[np.int64]:
    """The path of cells with straight steps in place of slanting ones, over the wider of the two cells beside."""
    before, after = path[:-1], path[1:]
    one, two = np.column_stack([before[:, 0], after[:, 1]]), np.column_stack([after[:, 0], before[:, 1]])
    wider = np.where((clearance[tuple(one.T)] >= clearance[tuple(two.T)])[:, None], one, two)
    steps = np.stack([before, wider], axis=1).reshape(-1, 2)
    kept = np.append(np.column_stack([np.ones(len(before), bool), (before != after).all(axis=1)]).ravel(), True)
    return np.concatenate([steps, path[-1:]])[kept]


def _meetings(
    cost: NDArray[np.float64], owner: NDArray[np.int64]
) -> list[tuple[float, int, int, tuple[int, int], tuple[int, int]]]:
    """Where the cells of two seeds touch at least cost: ``(cost of the way, a, b, cell of a, cell of b)``, in order."""
    found = []
    for down, right in ((0, 1), (1, 0), (1, 1), (1, -1)):
        rows, columns = owner.shape
        one = slice(0, rows - down), slice(max(0, -right), columns - max(0, right))
        two = slice(down, rows), slice(max(0, right), columns - max(0, -right))
        touch = (owner[one] != owner[two]) & (owner[one] >= 0) & (owner[two] >= 0)
        r, c = np.nonzero(touch)
        r, c = r + one[0].start, c + one[1].start
        there = r + down, c + right
        total = cost[r, c] + cost[there] + math.hypot(down, right)
        found.append(np.column_stack([total, owner[r, c], owner[there], r, c, *there]))
    every = np.concatenate(found)
    swap = every[:, 1] > every[:, 2]
    every[swap] = every[swap][:, [0, 2, 1, 5, 6, 3, 4]]
    every = every[np.lexsort((every[:, 4], every[:, 3], every[:, 0]))]
    _, first = np.unique(every[:, 1:3], axis=0, return_index=True)
    chosen = every[np.sort(first)]
    return [(t, int(a), int(b), (int(r), int(c)), (int(y), int(x))) for t, a, b, r, c, y, x in chosen.tolist()]
