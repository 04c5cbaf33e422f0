"""Reader and writer of the hand-made graphs of patrolling_sim: a ``.graph`` file beside each map.

The format is numbers and words between spaces: N, width and height (pixels), resolution (m per pixel), offset
x and y (m); then for each of the N nodes its id, x, y and number of neighbours, and for each neighbour its
id, a direction label and a cost. Coordinates and costs are in pixels, y points up. Every edge is listed from
both ends. Labels say little in practice (one real file calls every direction S) and are not used.
"""

from __future__ import annotations

import math
import os
from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from tasklift.building.graph import (
    BEND,
    CORNER,
    DOOR,
    FEATURE,
    INTERSECTION,
    NONE,
    OTHER,
    ROOM,
    Building,
)
from tasklift.errors import TaskliftError
from tasklift.files import read_text, write_atomically

MOST_NODES = 100_000
MOST_NEIGHBOURS = 8  # per node, in the format
FEWEST_DOORS = 4  # not next to the start
BEND_DEGREES, CORNER_DEGREES = 35.0, 70.0

_RULE = (
    "Nodes with one neighbour are rooms. A node with two neighbours next to a room is a door; a room without "
    "one gets a door in the middle of its corridor. Other nodes with two neighbours are corners if the way "
    f"turns there by more than {CORNER_DEGREES:g} degrees, bends by more than {BEND_DEGREES:g}, else other "
    "features. All others are intersections, and so is a start that is not a room. While fewer than "
    f"{FEWEST_DOORS} doors are not next to the start, the longest corridor without a door gets one in its "
    "middle. Lengths are straight distances, or the file's costs where these are longer."
)
_DIRECTIONS = ("E", "NE", "N", "NW", "W", "SW", "S", "SE")


def read_graph(
    path: str | os.PathLike[str],
    *,
    start: int | None = None,
    room_area_m2: float = 12.0,
    width_m: float = 2.0,
    add_doors: bool = True,
) -> Building:
    """Read a ``.graph`` file into a building; the file's nodes keep their ids, doors that are added follow.

    The file knows only places and corridors; kinds are set by this rule. Nodes with one neighbour are rooms.
    A node with two neighbours next to a room is a door; a room without one gets a door in the middle of its
    corridor. Other nodes with two neighbours are corners if the way turns there by more than 70°, bends by
    more than 35°, else other features. All others are intersections, and so is a start that is not a room.
    While fewer than 4 doors are not next to the start, the longest corridor without a door gets one in its
    middle, so that hostiles have a choice. Costs span 0.4 to 4 times the straight distance in real files: a
    corridor is as long as the straight distance, or as its cost where that is longer.

    Parameters
    ----------
    path
        The file.
    start
        Where robots begin: a node of the file. ``None``: the lowest room on the map, or else the lowest node.
    room_area_m2
        Area of every room (m²); obstacles are 0.
    width_m
        Width of every corridor (m).
    add_doors
        Whether to add nodes for doors; without, the building has exactly the file's nodes and edges.

    Raises
    ------
    TaskliftError
        With the file and the line at fault.
    """
    graph = _parse(path)
    n = len(graph.position)
    degree = [0] * n
    for a, b in graph.length:
        degree[a] += 1
        degree[b] += 1
    rooms = [node for node in range(n) if degree[node] == 1]
    if start is None:
        start = min(rooms or range(n), key=lambda node: (graph.position[node][1], node))
    elif start not in range(n):
        raise TaskliftError(f"{path}: start {start!r} is not a node of the file; expected 0 to {n - 1}")
    _set_kinds(graph, degree, start)
    if add_doors:
        _add_doors(graph, rooms, start)
    edges = sorted(graph.length)
    kind = np.array(graph.kind, np.int8)
    try:
        return Building(
            name=Path(path).stem,
            kind=kind,
            feature_class=np.array(graph.feature_class, np.int8),
            position_m=np.array(graph.position),
            area_m2=np.where(kind == ROOM, room_area_m2, 0.0),
            obstacles=np.zeros(len(kind), np.int64),
            edges=np.array(edges, np.int64).reshape(-1, 2),
            length_m=np.array([graph.length[edge] for edge in edges]),
            width_m=np.full(len(edges), width_m),
            start=start,
            provenance={
                "source": "patrolling_sim .graph",
                "file": Path(path).name,
                "resolution_m": graph.resolution,
                "offset_m": list(graph.offset),
                "nodes_in_file": n,
                "rule": _RULE,
                "room_area_m2": room_area_m2,
                "width_m": width_m,
            },
        )
    except TaskliftError as error:
        raise TaskliftError(f"{path}: {error}") from error


def write_graph(building: Building, path: str | os.PathLike[str], resolution_m: float = 0.05) -> None:
    """Write the nodes and edges of ``building`` as a ``.graph`` file, which has no kinds, widths or areas.

    Reading it back with ``add_doors=False`` gives the same nodes and edges, positions to half a pixel.

    Parameters
    ----------
    building
        What to write.
    path
        The file; an existing one is replaced.
    resolution_m
        Metres per pixel.
    """
    if not isinstance(resolution_m, int | float) or not 0 < resolution_m < math.inf:
        raise TaskliftError(f"{path}: expected a resolution above 0 m per pixel, found {resolution_m!r}")
    most = int(building.degree.argmax())
    if building.degree[most] > MOST_NEIGHBOURS:
        raise TaskliftError(
            f"{path}: node {most} has {building.degree[most]} neighbours; the format holds {MOST_NEIGHBOURS}"
        )
    points = np.concatenate([building.outline_m, building.position_m])
    offset = np.floor(points.min(axis=0) / resolution_m) * resolution_m
    width, height = np.ceil((points.max(axis=0) - offset) / resolution_m).astype(int).tolist()
    pixel = np.round((building.position_m - offset) / resolution_m).astype(int)
    cost = np.maximum(1, np.round(building.length_m / resolution_m)).astype(int)
    header = (
        building.n_nodes,
        width,
        height,
        f"{resolution_m:.10g}",
        *(f"{v:.10g}" for v in offset.tolist()),
    )
    lines = [str(value) for value in header]
    for node in range(building.n_nodes):
        here = range(building.indptr[node], building.indptr[node + 1])
        lines += ["", str(node), *(str(v) for v in pixel[node].tolist()), str(len(here))]
        for half_edge in here:
            other = int(building.neighbour[half_edge])
            x, y = (building.position_m[other] - building.position_m[node]).tolist()
            label = _DIRECTIONS[round(math.atan2(y, x) / (math.pi / 4)) % 8]
            lines += [str(other), label, str(cost[building.edge_of[half_edge]])]
    write_atomically(path, "\n".join(lines) + "\n")


@dataclass
class _Graph:
    resolution: float
    offset: tuple[float, float]
    position: list[tuple[float, float]] = field(default_factory=list)  # m
    length: dict[tuple[int, int], float] = field(default_factory=dict)  # m, by (lower, higher) node
    kind: list[int] = field(default_factory=list)
    feature_class: list[int] = field(default_factory=list)


class _Words:
    """The words of a file, one after the other, with the line that each stands on."""

    def __init__(self, path: str | os.PathLike[str]) -> None:
        self.path = path
        lines = read_text(path).splitlines()
        self.words = [(word, i) for i, line in enumerate(lines, start=1) for word in line.split()]
        self.last_line = len(lines)
        self.next = 0

    def fault(self, message: str) -> TaskliftError:
        """Return an error at the line of the word read last."""
        line = self.words[self.next - 1][1] if self.next else 1
        return TaskliftError(f"{self.path}, line {line}: {message}")

    def word(self, what: str) -> str:
        if self.next == len(self.words):
            raise TaskliftError(
                f"{self.path}, line {self.last_line}: expected {what}, found the end; is the file cut short?"
            )
        self.next += 1
        return self.words[self.next - 1][0]

    def number(self, what: str, least: float = -math.inf) -> float:
        text = self.word(what)
        try:
            value = float(text)
        except ValueError:
            value = math.nan
        if not least <= value <= 1e9:  # false for NaN
            raise self.fault(f"expected {what} (a number), found {text!r:.40}")
        return value

    def integer(self, what: str, least: int, most: int) -> int:
        text = self.word(what)
        if not (text.isascii() and text.isdecimal() and len(text) < 19) or not least <= int(text) <= most:
            raise self.fault(f"expected {what} (a whole number from {least} to {most}), found {text!r:.40}")
        return int(text)


def _parse(path: str | os.PathLike[str]) -> _Graph:
    words = _Words(path)
    n = words.integer("the number of nodes", 2, MOST_NODES)
    words.integer("the map's width in pixels", 0, 10**9)
    words.integer("the map's height in pixels", 0, 10**9)
    resolution = words.number("the resolution in m per pixel", least=1e-6)
    offset = words.number("the offset in x"), words.number("the offset in y")
    graph = _Graph(resolution, offset)
    listed: dict[tuple[int, int], tuple[float, TaskliftError]] = {}
    for node in range(n):
        found = words.integer(f"the id of node {node}", 0, MOST_NODES)
        if found != node:
            raise words.fault(f"expected node {node}, found id {found}; ids are 0 to {n - 1} in order")
        x = words.number(f"x of node {node}") * resolution + offset[0]
        y = words.number(f"y of node {node}") * resolution + offset[1]
        graph.position.append((round(x, 4), round(y, 4)))
        for _ in range(words.integer(f"the number of neighbours of node {node}", 0, MOST_NEIGHBOURS)):
            other = words.integer(f"a neighbour of node {node}", 0, MOST_NODES)
            if other >= n:
                raise words.fault(f"edge {node}-{other}: node {other} does not exist; nodes are 0 to {n - 1}")
            if other == node:
                raise words.fault(f"node {node} is its own neighbour")
            if (node, other) in listed:
                raise words.fault(f"edge {node}-{other} is listed twice at node {node}")
            # The fault is kept for later: whether the other end lists the edge shows only at the end
            fault = words.fault(f"edge {node}-{other}: node {other} does not list node {node} as a neighbour")
            label = words.word(f"the direction of edge {node}-{other}")
            if not label.isalpha():
                raise words.fault(f"edge {node}-{other}: expected a direction like NE, found {label!r:.40}")
            cost = words.number(f"the cost of edge {node}-{other}", least=0)
            listed[node, other] = cost * resolution, fault
    if words.next != len(words.words):
        words.next += 1
        raise words.fault(f"expected the end of the file after {n} nodes, found {words.words[words.next - 1][0]!r:.40}")
    for (a, b), (cost, fault) in listed.items():
        if (b, a) not in listed:
            raise fault
        if a < b:
            straight = math.dist(graph.position[a], graph.position[b])
            graph.length[a, b] = round(max(straight, cost, listed[b, a][0]), 4)
    return graph


def _neighbours(graph: _Graph) -> list[list[int]]:
    neighbours: list[list[int]] = [[] for _ in graph.position]
    for a, b in graph.length:
        neighbours[a].append(b)
        neighbours[b].append(a)
    return neighbours


def _set_kinds(graph: _Graph, degree: Sequence[int], start: int) -> None:
    """Set kinds and classes of the file's nodes by the rule of :func:`read_graph`."""
    for node, others in enumerate(_neighbours(graph)):
        kind, feature = INTERSECTION, NONE
        if degree[node] == 1:
            kind = ROOM
        elif degree[node] == 2 and node != start:
            kind = FEATURE
            (ax, ay), (bx, by) = (graph.position[other] for other in others)
            x, y = graph.position[node]
            turn = abs(math.degrees(math.atan2(by - y, bx - x) - math.atan2(y - ay, x - ax)))
            turn = min(turn, 360 - turn)
            if any(degree[other] == 1 for other in others):
                feature = DOOR
            else:
                feature = CORNER if turn > CORNER_DEGREES else BEND if turn > BEND_DEGREES else OTHER
        graph.kind.append(kind)
        graph.feature_class.append(feature)


def _add_doors(graph: _Graph, rooms: Sequence[int], start: int) -> None:
    """Give every room a door, and the building enough doors that are not next to the start."""
    neighbours = _neighbours(graph)
    for room in rooms:
        (other,) = neighbours[room]
        # Two rooms joined by one corridor share a door
        if graph.feature_class[other] != DOOR and (min(room, other), max(room, other)) in graph.length:
            _insert_door(graph, room, other)
    while True:
        is_door = [feature == DOOR for feature in graph.feature_class]
        beside = {node for edge in graph.length if start in edge for node in edge}
        plain = [edge for edge in graph.length if not is_door[edge[0]] and not is_door[edge[1]] and start not in edge]
        if not plain or sum(is_door[node] and node not in beside for node in range(len(is_door))) >= FEWEST_DOORS:
            return
        _insert_door(graph, *min(plain, key=lambda edge: (-graph.length[edge], edge)))


def _insert_door(graph: _Graph, a: int, b: int) -> None:
    half = round(graph.length.pop((min(a, b), max(a, b))) / 2, 4)
    door = len(graph.position)
    (ax, ay), (bx, by) = graph.position[a], graph.position[b]
    graph.position.append((round((ax + bx) / 2, 4), round((ay + by) / 2, 4)))
    graph.kind.append(FEATURE)
    graph.feature_class.append(DOOR)
    graph.length[a, door] = graph.length[b, door] = half
