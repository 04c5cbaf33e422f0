"""The hand-made graphs of patrolling_sim, read and written: a ``.graph`` file beside each map.

The format is numbers and words between spaces: N, width and height (pixels), resolution (m per pixel), offset
x and y (m); then for each of the N nodes its id, x, y and number of neighbours, and for each neighbour its
id, a direction label and a cost. Coordinates and costs are in pixels, y points up. Every edge is listed from
both ends. Labels say little in practice (one real file calls every direction S) and are not used.
"""

from __future__ import annotations

import math
import os

import numpy as np

from tasklift.building.graph import Building
from tasklift.checks import number
from tasklift.errors import TaskliftError
from tasklift.files import write_atomically
from tasklift.plans.places import MOST_PLACES, Places
from tasklift.plans.source import Source
from tasklift.text import shown

TITLE = "patrolling_sim graph (.graph)"
MOST_NEIGHBOURS = 8  # per node, in the format

_DIRECTIONS = ("E", "NE", "N", "NW", "W", "SW", "S", "SE")


def recognises(source: Source) -> bool:
    """Whether it begins with six numbers, or has the ending."""
    head = source.head.removeprefix(b"\xef\xbb\xbf").lstrip()
    words = head.split(None, 7)
    named = source.path.suffix == ".graph" and head[:1] not in b"{[<"
    return named or (len(words) >= 6 and all(_is_number(word) for word in words[:6]))


def _is_number(word: bytes) -> bool:
    try:
        float(word)
    except ValueError:
        return False
    return True


def read(source: Source) -> Places:
    """Read nodes and edges; costs span 0.4 to 4 times the straight distance in real files.

    A corridor is as long as the straight distance, or as its cost where that is longer.

    Raises
    ------
    TaskliftError
        With the file and the line at fault.
    """
    words = _Words(source)
    n = words.integer("the number of nodes", 2, MOST_PLACES)
    words.integer("the map's width in pixels", 0, 10**9)
    words.integer("the map's height in pixels", 0, 10**9)
    resolution = words.number("the resolution in m per pixel", least=1e-6)
    offset = words.number("the offset in x"), words.number("the offset in y")
    provenance = {
        "source": "patrolling_sim .graph",
        "file": source.path.name,
        "resolution_m": resolution,
        "offset_m": list(offset),
    }
    places = Places(source, provenance, must_be_joined=True)
    listed: dict[tuple[int, int], tuple[float, TaskliftError]] = {}
    for node in range(n):
        found = words.integer(f"the id of node {node}", 0, MOST_PLACES)
        if found != node:
            raise words.fault(f"expected node {node}, found id {found}; ids are 0 to {n - 1} in order")
        x = words.number(f"x of node {node}") * resolution + offset[0]
        y = words.number(f"y of node {node}") * resolution + offset[1]
        places.add(x, y)
        for _ in range(words.integer(f"the number of neighbours of node {node}", 0, MOST_NEIGHBOURS)):
            other, cost, fault = _neighbour(words, node, n)
            if (node, other) in listed:
                places.doubts.append(f"edge {node}-{other} is listed twice at node {node}; taken once")
            listed.setdefault((node, other), (cost * resolution, fault))
    if words.next != len(words.words):
        found_word = words.word("the end")
        raise words.fault(f"expected the end of the file after {n} nodes, found {shown(found_word)}")
    for (a, b), (cost, fault) in listed.items():
        if (b, a) not in listed:
            raise fault
        if a < b:
            places.join(a, b, max(cost, listed[b, a][0]))
    return places


def _neighbour(words: _Words, node: int, n: int) -> tuple[int, float, TaskliftError]:
    """A neighbour, its cost in pixels, and the fault to raise if the neighbour does not list the node."""
    other = words.integer(f"a neighbour of node {node}", 0, MOST_PLACES)
    if other >= n:
        raise words.fault(f"edge {node}-{other}: node {other} does not exist; nodes are 0 to {n - 1}")
    if other == node:
        raise words.fault(f"node {node} is its own neighbour")
    # Whether the other end lists the edge shows only at the end
    fault = words.fault(f"edge {node}-{other}: node {other} does not list node {node} as a neighbour")
    label = words.word(f"the direction of edge {node}-{other}")
    if not label.isalpha():
        raise words.fault(f"edge {node}-{other}: expected a direction like NE, found {shown(label)}")
    return other, words.number(f"the cost of edge {node}-{other}", least=0), fault


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
    number(resolution_m, f"{path}: resolution (m per pixel)", 0.0001, 100)
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


class _Words:
    """The words of a file, one after the other, with the line that each stands on."""

    def __init__(self, source: Source) -> None:
        self.source = source
        lines = source.text.splitlines()
        self.words = [(word, i) for i, line in enumerate(lines, start=1) for word in line.split()]
        self.last_line = len(lines)
        self.next = 0

    def fault(self, message: str) -> TaskliftError:
        """Return an error at the line of the word read last."""
        line = self.words[self.next - 1][1] if self.next else 1
        return TaskliftError(f"{self.source.path}, line {line}: {message}")

    def word(self, what: str) -> str:
        if self.next == len(self.words):
            raise TaskliftError(
                f"{self.source.path}, line {self.last_line}: expected {what}, found the end; is the file cut short?"
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
            raise self.fault(f"expected {what} (a number), found {shown(text)}")
        return value

    def integer(self, what: str, least: int, most: int) -> int:
        text = self.word(what)
        if not (text.isascii() and text.isdecimal() and len(text) < 19) or not least <= int(text) <= most:
            raise self.fault(f"expected {what} (a whole number from {least} to {most}), found {shown(text)}")
        return int(text)
