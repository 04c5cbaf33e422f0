"""Bends and corners: where corridors turn, how much, and lines pulled straight."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from tasklift.plans.extract.axes import is_chamfer, turn_before_door
from tasklift.plans.extract.paths import Node, PathGraph, Points, simplify, straight
from tasklift.plans.extract.space import Space

# Corridors that turn by more have a bend there, or a corner.
BEND_DEGREES = 25.0
CORNER_DEGREES = 65.0
BEND_TOLERANCE_M = 0.6
NEAR_DOOR_M = 0.4
SHORTEST_PIECE_M = 1.0  # turns closer to each other are one


def role_of(turn: float) -> str | None:
    """Return the class of a turn by this angle (degrees), if it has one."""
    if turn < BEND_DEGREES:
        return None
    return "corner" if turn >= CORNER_DEGREES else "bend"


def name_bends(graph: PathGraph, space: Space) -> None:
    """Put a node of role "bend" or "corner" wherever a corridor turns."""
    for door in [number for number, node in graph.nodes.items() if node.role == "door"]:
        for edge in sorted(graph.incident[door]):
            if graph.nodes[graph.other(edge, door)].role != "room":
                _bend_before(graph, edge, door, space)
    for edge in list(graph.edges):
        line = graph.edges[edge][2]
        corners = _corners(line, space)
        # the last first, so that what is still to be split keeps its indices
        for k in range(len(corners) - 2, 0, -1):
            turn = turn_at(*(line[i] for i in corners[k - 1 : k + 2]))
            edge = _bend(graph, edge, corners[k], turn, space)


def _bend_before(graph: PathGraph, edge: int, door: int, space: Space) -> None:
    """Put a bend where a corridor turns right before a door."""
    line = graph.line(edge, door)
    found = turn_before_door(graph.nodes[door], line, space)
    if found is None:
        return
    at, turn = found
    away = np.hypot(*(line - at).T)
    index = int(away.argmin())
    half = float(space.half_width_m[tuple(np.rint(at).astype(int))])
    if away[index] * space.cell_m <= max(1.0, 2 * half):
        from_start = index if door == graph.edges[edge][0] else len(line) - 1 - index
        _bend(graph, edge, from_start, float(np.degrees(turn)), space)


def _bend(graph: PathGraph, edge: int, index: int, turn: float, space: Space) -> int:
    """Put a bend at a point of an edge's line, if it turns enough (degrees), and not close to either end.

    Returns the edge up to there.
    """
    a, b, line = graph.edges[edge]
    here = line[index]
    half = float(space.half_width_m[tuple(np.rint(here).astype(int))])
    for end in (a, b):
        apart = np.hypot(*(here - graph.nodes[end].at)) * space.cell_m
        if apart < (max(SHORTEST_PIECE_M, half) if graph.nodes[end].role == "path" else NEAR_DOOR_M):
            return edge
    role = role_of(turn)
    if role is None:
        return edge
    node = graph.split(edge, index, Node((float(here[0]), float(here[1])), half, role))
    return min(graph.incident[node])  # splitting numbers the first part before the second


def _corners(line: Points, space: Space) -> list[int]:
    """Indices of the points where a line turns; two close together in one turn are one, between them."""
    corners = simplify(line, BEND_TOLERANCE_M / space.cell_m).tolist()
    k = 1
    while k + 2 < len(corners):
        first, second = line[corners[k]], line[corners[k + 1]]
        half = float(space.half_width_m[tuple(int(v) for v in np.rint(first))])
        short = np.hypot(*(second - first)) * space.cell_m < max(SHORTEST_PIECE_M, 1.8 * half)
        if short or is_chamfer(line[corners[k] : corners[k + 1] + 1], space):
            corners[k : k + 2] = [(corners[k] + corners[k + 1]) // 2]
        else:
            k += 1
    return corners


def taut(line: Points, free: NDArray[np.bool_]) -> Points:
    """The points of ``line`` that remain when it is pulled straight, around the walls that it goes around."""
    from skimage.draw import polygon

    kept = simplify(line, 1.0).tolist()
    middle = len(kept) - 2
    while middle > 0:
        corners = np.rint(line[kept[middle - 1 : middle + 2]]).astype(np.int64)
        cut = straight(corners[0], corners[2]).T
        # not only the short cut itself: between it and the corner there may be a wall as well
        between = polygon(corners[:, 0], corners[:, 1], free.shape)
        if free[tuple(cut)].all() and free[between].all():
            del kept[middle]
            middle = min(middle, len(kept) - 2)
        else:
            middle -= 1
    return line[kept]


def turn_at(before: Points, here: Points, after: Points) -> float:
    """The angle (degrees) by which a line turns at ``here``."""
    u, v = here - before, after - here
    return float(abs(np.degrees(np.arctan2(u[0] * v[1] - u[1] * v[0], u @ v))))


def part_parallels(graph: PathGraph) -> None:
    """Put a node of role "other" into one of two corridors between the same nodes, and two into a ring."""
    seen: set[tuple[int, int]] = set()
    for edge in sorted(graph.edges):
        a, b, line = graph.edges[edge]
        pair = (min(a, b), max(a, b))
        if a == b:
            cuts = [2 * len(line) // 3, len(line) // 3]
        elif pair in seen:
            cuts = [len(line) // 2]
        else:
            cuts = []
        seen.add(pair)
        for cut in cuts:
            at = (float(line[cut][0]), float(line[cut][1]))
            node = graph.split(edge, cut, Node(at, 0.0, "other"))
            edge = min(graph.incident[node])  # the first part: splitting numbers it first
