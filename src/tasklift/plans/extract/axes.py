"""Where corridors meet: the middle lines between their walls, and the points where those cross.

A skeleton leaves the middle line near a junction, towards the wider corridor, and cuts through a short
corridor between two bends; people do not. The walls themselves are straight there, and tell the line.
"""

from __future__ import annotations

import numpy as np

from tasklift.plans.extract.outline import Outline
from tasklift.plans.extract.paths import Node, PathGraph, Points, line_length
from tasklift.plans.extract.space import Space

# Corridors wider than twice this have no axis that a person would keep to.
WIDEST_HALF_M = 2.2
# Walls make a corridor from this length on, with at least this between them, parallel within 14 degrees (the
# cosine between the directions to their floors), and within 53 degrees of the line between them (the cosine).
SHORTEST_WALL_M = 0.8
NARROWEST_M = 0.5
FACING = -0.97
AHEAD = 0.6
# A line's corridor is looked for so far beyond the junction, in these steps; it is the first that the line follows
# for the first length, or else the one that it follows longest, for the second length at least.
AXIS_M = 3.0
STEP_M = 0.1
SHORTEST_AXIS_M = 0.8
SHORT_AXIS_M = 0.3
# Axes cross if the sine between them is above this; a junction may miss one of its axes by this distance.
LEAST_ANGLE = 0.4
MISS_M = 0.4
# The skeleton cuts a corner by at most this many half widths; walls along it would lead in its direction (the cosine).
LONGEST_CHAMFER = 3.5
ALONG = 0.79
# A dead end up to this length is no corridor without facing walls, of at least the second length.
LONGEST_SPIKE_M = 3.0
NICHE_WALL_M = 0.3


def centre_nodes(graph: PathGraph, space: Space, roles: tuple[str, ...]) -> None:
    """Move the nodes of these roles to where the axes of their corridors meet."""
    moves = []
    for number, node in graph.nodes.items():
        if node.role not in roles or len(graph.incident[number]) < 2 or node.half > WIDEST_HALF_M:
            continue
        clear = 1.2 * max(node.half, 0.5) / space.cell_m  # the part of a line that the junction deflects
        begin = dict.fromkeys(graph.incident[number], clear)
        normal, offset = [], []
        for edge in sorted(graph.incident[number]):
            axis = _axis(graph.line(edge, number), clear, space)
            if axis is None:
                door = graph.nodes[graph.other(edge, number)]
                axis = _door_axis(door, graph.edges[edge][2], clear, space)
            if axis is not None:
                normal.append(axis[0])
                offset.append(axis[1])
                begin[edge] = axis[2]
        most = max(1.0, 2.0 * node.half) / space.cell_m  # sharp corners lie farthest from the skeleton
        moved = _crossing(np.array(node.at), np.array(normal), np.array(offset), most, space)
        if moved is not None:
            moves.append((number, moved, begin))
    for number, at, begin in moves:
        graph.move(number, at, begin)


def is_spike(line: Points, space: Space) -> bool:
    """Whether a dead end is but the sharp corner of a floor: short, and never between walls that face each other."""
    if line_length(line) * space.cell_m > LONGEST_SPIKE_M:
        return False
    return not any(_facing(line, i, space, NICHE_WALL_M) for i in range(0, len(line), 2))


def is_chamfer(line: Points, space: Space) -> bool:
    """Whether a piece of line cuts a corner: it is short, and no walls that lead along it face each other."""
    half = float(space.half_width_m[tuple(np.rint(line[len(line) // 2]).astype(int))])
    if half > WIDEST_HALF_M or np.hypot(*(line[-1] - line[0])) * space.cell_m > LONGEST_CHAMFER * half:
        return False
    along = line[-1] - line[0]
    return not any(_facing_at(point, along, space, NICHE_WALL_M, ALONG) for point in line[::2])


def turn_before_door(door: Node, line: Points, space: Space) -> tuple[Points, float] | None:
    """Where the way that leads square through a door meets the axis of the corridor beyond, and by what angle (rad).

    ``line`` begins at the door. ``None`` if that is not on the floor, or not near.
    """
    across = _square_to(door)
    axis = None if across is None else _axis(line, 0.0, space)
    if across is None or axis is None:
        return None
    normal, offset = np.array([across[0], axis[0]]), np.array([across[1], axis[1]])
    turn = float(np.arccos(np.clip(abs(normal[0] @ normal[1]), 0, 1)))
    if np.sin(turn) < LEAST_ANGLE:
        return None
    at = np.linalg.solve(normal, offset)
    near = np.hypot(*(at - door.at)) * space.cell_m < AXIS_M
    return (at, turn) if near and _on_floor(at, space) else None


def _on_floor(at: Points, space: Space) -> bool:
    cell = np.rint(at).astype(int)
    return bool((cell >= 0).all() and (cell < space.free.shape).all() and space.free[tuple(cell)])


def _crossing(at: Points, normal: Points, offset: Points, most: float, space: Space) -> tuple[float, float] | None:
    """The free point nearest to all axes, at most ``most`` cells from ``at``; one axis may miss it."""
    for _ in range(min(2, len(normal) - 1)):  # all axes, then without the one that misses most
        # least squares, held where it is along the axes that all share; they miss where corridors are crooked
        u, size, v = np.linalg.svd(normal, full_matrices=False)
        steps = np.where(size > LEAST_ANGLE, (u.T @ (offset - normal @ at)) / np.maximum(size, 1e-9), 0)
        moved = at + steps @ v
        miss = np.abs(normal @ moved - offset)
        near = np.hypot(*(moved - at)) <= most and miss.max() * space.cell_m <= MISS_M
        if near and _on_floor(moved, space):
            return float(moved[0]), float(moved[1])
        worst = int(np.argmax(miss))
        normal, offset = np.delete(normal, worst, axis=0), np.delete(offset, worst)
    return None


def _axis(line: Points, clear: float, space: Space) -> tuple[Points, float, float] | None:
    """The straight corridor along which ``line`` leaves its first point, or ``None``.

    Normal and offset of its axis, and how far along the line it begins. It is the corridor between the first
    two walls that the line follows for long enough: near a junction it crosses others.
    """
    along = np.concatenate([[0], np.cumsum(np.hypot(*np.diff(line, axis=0).T))])
    window = np.flatnonzero(along <= clear + AXIS_M / space.cell_m)
    followed: dict[tuple[int, int], tuple[int, int]] = {}
    best, most = None, SHORT_AXIS_M / space.cell_m
    for i in window[1 :: max(1, round(STEP_M / space.cell_m))].tolist():
        for pair in _facing(line, i, space, SHORTEST_WALL_M):
            first, _ = followed.setdefault(pair, (i, i))
            followed[pair] = (first, i)
            progress = abs(float((line[i] - line[first]) @ space.outline.ahead[pair[0]]))
            if progress > most:
                best, most = pair, progress
        if most >= SHORTEST_AXIS_M / space.cell_m:
            break
    if best is None:
        return None
    first, last = followed[best]
    normal, offset = _middle(line[(first + last) // 2], best, space.outline)
    return normal, offset, float(along[first])


def _facing(line: Points, i: int, space: Space, shortest_m: float) -> list[tuple[int, int]]:
    """The walls of some length that face each other across a line at its point ``i``, and lead along it."""
    return _facing_at(line[i], line[min(i + 5, len(line) - 1)] - line[max(i - 5, 0)], space, shortest_m, AHEAD)


def _facing_at(point: Points, towards: Points, space: Space, shortest_m: float, ahead: float) -> list[tuple[int, int]]:
    """The walls of some length that face each other across a point and lead ``towards``; ``ahead`` is the cosine."""
    walls = space.outline
    towards = towards / max(np.hypot(*towards), 1e-9)
    half = float(space.half_width_m[tuple(np.rint(point).astype(int))]) / space.cell_m
    near = walls.near(point, 1.1 * half + 2)
    long = walls.length[near] * space.cell_m >= shortest_m
    near = near[long & (np.abs(walls.ahead[near] @ towards) > ahead)]
    if len(near) < 2:
        return []
    inward, beside = walls.inward[near], walls.beside(near, point)
    first, second = np.nonzero(np.triu(inward @ inward.T < FACING))
    apart = ((beside[second] - beside[first]) * inward[first]).sum(axis=1) * space.cell_m
    between = ((point - beside) * inward).sum(axis=1) > 0
    fits = (apart >= NARROWEST_M) & (apart <= 2 * WIDEST_HALF_M) & between[first] & between[second]
    return list(zip(near[first[fits]].tolist(), near[second[fits]].tolist(), strict=True))


def _middle(point: Points, pair: tuple[int, int], walls: Outline) -> tuple[Points, float]:
    """Normal and offset of the middle line between two walls that face each other, where it passes a point."""
    index = np.array(pair)
    normal = walls.length[pair[0]] * walls.inward[pair[0]] - walls.length[pair[1]] * walls.inward[pair[1]]
    normal /= np.hypot(*normal)
    return normal, float(normal @ walls.beside(index, point).mean(axis=0))


def _door_axis(door: Node, line: Points, clear: float, space: Space) -> tuple[Points, float, float] | None:
    """As :func:`_axis`, square to a door's wall, for the short way from a door to its corridor."""
    square = _square_to(door)
    if square is None or line_length(line) * space.cell_m > AXIS_M:
        return None
    return *square, clear


def _square_to(door: Node) -> tuple[Points, float] | None:
    """Normal and offset of the line square through a door."""
    if door.role != "door" or door.across is None:
        return None
    first, second = (np.array(end, float) for end in door.across)
    normal = (second - first) / np.hypot(*(second - first))
    return normal, float(normal @ ((first + second) / 2))
