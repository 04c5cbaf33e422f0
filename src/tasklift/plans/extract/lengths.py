"""How long corridors are: what each adds to the shortest ways between rooms, which cut the corners of wide places."""

from __future__ import annotations

from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from tasklift.plans.extract.axes import WIDEST_HALF_M
from tasklift.plans.extract.bends import taut
from tasklift.plans.extract.paths import PathGraph, Points, line_length
from tasklift.plans.extract.space import ROUNDING, Space

# For each room, ways to this many of the nearest rooms and to this many of the others are measured, up to a total.
NEAR_ROOMS, FAR_ROOMS = 3, 2
MOST_WAYS = 600
# A corridor keeps this part of its own length, and this length (m). Corridors to doors and rooms give up length more
# readily than those along axes: a door lies beside the ways of others.
LEAST_SHARE = 0.3
LEAST_M = 0.35
SOFT, STIFF = 0.01, 0.1
ROUNDS = 200
# A way is pulled straight a few times, until it gets shorter by less than this part: first between points so far apart
# (m), then between points that lie the closer to each other the nearer they are to a corner, from the nearest (m) on by
# this ratio. This many ahead are looked at.
# Sight is sampled this often (m): what is closed to a robot's middle is wider. A way ends up longer by this factor.
PASSES, SHORTER = 5, 1e-3
STEP_M = 0.3
NEAREST_M, RATIO = 0.05, 1.6
WINDOW = 24
SIGHT_M = 0.15
LEFT_OVER = 1.02


@dataclass(frozen=True, eq=False)
class Course:
    """How a corridor runs: its line pulled straight (cells), and its length (cells)."""

    line: Points
    length: float


def courses(graph: PathGraph, space: Space) -> dict[int, Course]:
    """The course of every edge of ``graph``.

    A node is a place as wide as the floor there. Ways over it cut its corner, and are shorter than the sum of
    the lines to its middle; in a hall they lead by its far side, too. Lengths are fitted to the shortest ways between
    rooms. None is shorter than its own line by more than half the widths of the places at its ends, or longer by more
    than these are wider than corridors.
    """
    lines = {edge: taut(line, space.free) for edge, (_, _, line) in graph.edges.items()}
    numbers = sorted(lines)
    row = {edge: i for i, edge in enumerate(numbers)}
    own = np.array([max(line_length(lines[edge]), 1.0) for edge in numbers])
    ways, lengths = _ways(graph, space, lines, row, own)
    if len(ways):
        cut = np.array([_reach(graph, space, edge) for edge in numbers])
        around = np.array([_reach(graph, space, edge, WIDEST_HALF_M) for edge in numbers])
        least = np.maximum(np.maximum(own * LEAST_SHARE, own - cut), LEAST_M / space.cell_m)
        stiff = np.array([STIFF if _is_axis(graph, edge) else SOFT for edge in numbers]) / np.mean(own)
        fitted = _fit(ways, lengths / LEFT_OVER, own, (np.minimum(least, own), own + around), stiff)
    else:
        fitted = own
    return {edge: Course(lines[edge], float(fitted[row[edge]])) for edge in numbers}


def _is_axis(graph: PathGraph, edge: int) -> bool:
    """Whether an edge runs along a corridor, between junctions and bends."""
    return not any(graph.nodes[end].role in ("door", "room") for end in graph.edges[edge][:2])


def _reach(graph: PathGraph, space: Space, edge: int, beyond_m: float = 0.0) -> float:
    """How far (cells) the places at both ends of an edge reach, more than this far (m)."""
    reach = 0.0
    for end in graph.edges[edge][:2]:
        node = graph.nodes[end]
        if node.role != "door" and graph.degree(end) > 1:
            half = float(space.half_width_m[tuple(np.rint(node.at).astype(int))])
            reach += max(0.0, half - beyond_m) / space.cell_m
    return reach


def _ways(
    graph: PathGraph, space: Space, lines: dict[int, Points], row: dict[int, int], own: NDArray[np.float64]
) -> tuple[list[NDArray[np.int64]], NDArray[np.float64]]:
    """Shortest ways between rooms, as rows of edges, and how long each is for a robot (cells)."""
    from scipy.sparse import coo_array
    from scipy.sparse.csgraph import dijkstra

    nodes = sorted(graph.nodes)
    index = {node: i for i, node in enumerate(nodes)}
    ends = np.array([[index[end] for end in graph.edges[edge][:2]] for edge in row], np.int64).reshape(-1, 2)
    rooms = [i for i, node in enumerate(nodes) if graph.nodes[node].role == "room"]
    if len(rooms) < 2:
        return [], np.zeros(0)
    matrix = coo_array((own, (ends[:, 0], ends[:, 1])), shape=(len(nodes), len(nodes))).tocsr()
    between = {(min(a, b), max(a, b)): edge for edge, (a, b) in zip(row, ends.tolist(), strict=True)}
    robot = space.half_width_m >= space.settings.narrowest_m / 2 - ROUNDING
    wanted: list[tuple[int, int, int]] = []  # how near, and the two rooms
    trees = {}
    for room in rooms:
        distance, before = dijkstra(matrix, directed=False, indices=room, return_predecessors=True)
        trees[room] = before
        order = np.argsort(distance[rooms], kind="stable")[1:]
        far = order[NEAR_ROOMS:]
        for rank, i in enumerate([*order[:NEAR_ROOMS], *far[:: max(1, len(far) // FAR_ROOMS)]]):
            wanted.append((rank, room, rooms[i]))
    measured: dict[tuple[int, int], tuple[NDArray[np.int64], float]] = {}
    for _, room, other in sorted(wanted):
        pair = (min(room, other), max(room, other))
        if pair in measured or len(measured) == MOST_WAYS:
            continue
        path, line, at = [], [], other
        while at != room:
            onward = int(trees[room][at])
            edge = between[min(at, onward), max(at, onward)]
            path.append(row[edge])
            line.append(lines[edge] if index[graph.edges[edge][0]] == at else lines[edge][::-1])
            at = onward
        measured[pair] = np.array(path), pulled_length(np.concatenate(line), robot, space.cell_m)
    return [way for way, _ in measured.values()], np.array([length for _, length in measured.values()])


def pulled_length(line: Points, free: NDArray[np.bool_], cell_m: float) -> float:
    """How long a line is once it is pulled straight around what is not free, corners cut where one sees across."""
    length = line_length(line)
    for number in range(PASSES):
        points = _even(line, STEP_M / cell_m) if number == 0 else _near_corners(line, NEAREST_M / cell_m)
        kept = [0]
        while kept[-1] < len(points) - 1:
            kept.append(kept[-1] + _farthest_seen(points[kept[-1] :], free, max(1.0, SIGHT_M / cell_m)))
        line = points[kept][::-1]  # and again from the other end
        before, length = length, line_length(line)
        if number and length > (1 - SHORTER) * before:
            break
    return length


def _even(line: Points, step: float) -> Points:
    """Points of a line at most ``step`` apart, its corners among them."""
    size = np.hypot(*np.diff(line, axis=0).T)
    line, size = line[np.append(True, size > 0)], size[size > 0]
    pieces = np.ceil(size / step).astype(int)
    piece = np.repeat(np.arange(len(pieces)), pieces)
    share = (np.arange(len(piece)) - np.repeat(np.cumsum(pieces) - pieces, pieces)) / pieces[piece]
    return np.concatenate([line[piece] + share[:, None] * (line[piece + 1] - line[piece]), line[-1:]])


def _near_corners(line: Points, nearest: float) -> Points:
    """Points of a line, its corners among them, the denser the nearer to one."""
    found = []
    for a, b in pairwise(line):
        half = float(np.hypot(*(b - a))) / 2
        away = nearest * RATIO ** np.arange(max(0, int(np.ceil(np.log(max(half / nearest, 1e-9)) / np.log(RATIO)))))
        share = away / (2 * max(half, 1e-9))
        found.append(a + np.concatenate([[0], share, 1 - share[::-1]])[:, None] * (b - a))
    return np.concatenate([*found, line[-1:]])


def _farthest_seen(points: Points, free: NDArray[np.bool_], step: float) -> int:
    """Index of the last of ``points`` that one sees from the first; at least 1."""
    seen = 1
    for first in range(2, len(points), WINDOW):
        ahead = points[first : first + WINDOW]
        steps = int(np.abs(ahead - points[0]).max() / step) + 1
        t = (np.arange(steps + 1) / steps)[:, None]
        rows = np.rint(points[0, 0] + t * (ahead[:, 0] - points[0, 0])).astype(np.int32)
        columns = np.rint(points[0, 1] + t * (ahead[:, 1] - points[0, 1])).astype(np.int32)
        clear = np.flatnonzero(free[rows, columns].all(axis=0))
        if not len(clear):
            break
        seen = first + int(clear[-1])
    return seen


def _fit(
    ways: list[NDArray[np.int64]],
    lengths: NDArray[np.float64],
    own: NDArray[np.float64],
    bounds: tuple[NDArray[np.float64], NDArray[np.float64]],
    weight: NDArray[np.float64],
) -> NDArray[np.float64]:
    """Lengths of edges, within bounds, whose sums along the ways are nearest to their lengths, in proportion."""
    from scipy.sparse import coo_array, diags_array, vstack

    way = np.repeat(np.arange(len(ways)), [len(edges) for edges in ways])
    used = coo_array((1 / lengths[way], (way, np.concatenate(ways))), shape=(len(ways), len(own))).tocsr()
    # projected gradient, with Nesterov's momentum
    matrix = vstack([used, diags_array(weight)]).tocsr()
    target = np.concatenate([np.ones(len(ways)), weight * own])
    vector = np.ones(len(own))
    for _ in range(20):
        vector = matrix.T @ (matrix @ vector)
        norm = float(np.linalg.norm(vector))
        vector /= norm
    found = ahead = own
    momentum = 1.0
    for _ in range(ROUNDS):
        fresh = np.clip(ahead - matrix.T @ (matrix @ ahead - target) / (1.05 * norm), *bounds)
        following = (1 + np.sqrt(1 + 4 * momentum**2)) / 2
        ahead = fresh + (momentum - 1) / following * (fresh - found)
        found, momentum = fresh, following
    return found
