"""A graph of drawn lines: skeletons traced into branches, pruned, merged and straightened.

Points are rows and columns of cells, lengths are in cells; nothing here knows metres or buildings.
"""

from __future__ import annotations

import heapq
from collections.abc import Callable, Collection, Mapping
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

Points = NDArray[np.float64]


@dataclass(eq=False)
class Node:
    """A point of a :class:`PathGraph`; ``role`` is "path", or says whose fixed point it is.

    ``across`` are the two ends of the line across a narrow place, where the node is one.
    """

    at: tuple[float, float]
    half: float
    role: str = "path"
    owner: int = 0
    across: tuple[tuple[int, int], tuple[int, int]] | None = None


@dataclass(eq=False)
class PathGraph:
    """An undirected multigraph whose edges are drawn lines: ``(a, b, points from a to b)``."""

    nodes: dict[int, Node] = field(default_factory=dict)
    edges: dict[int, tuple[int, int, Points]] = field(default_factory=dict)
    incident: dict[int, set[int]] = field(default_factory=dict)
    _next: int = 0

    def add_node(self, node: Node) -> int:
        """Add a node and return its number."""
        self._next += 1
        self.nodes[self._next] = node
        self.incident[self._next] = set()
        return self._next

    def add_edge(self, a: int, b: int, line: Points) -> int:
        """Add the edge drawn by ``line`` and return its number."""
        self._next += 1
        self.edges[self._next] = (a, b, line)
        self.incident[a].add(self._next)
        self.incident[b].add(self._next)
        return self._next

    def remove_edge(self, edge: int) -> None:
        """Remove an edge; its nodes stay."""
        a, b, _ = self.edges.pop(edge)
        self.incident[a].discard(edge)
        self.incident[b].discard(edge)

    def remove_node(self, node: int) -> None:
        """Remove a node and its edges."""
        for edge in list(self.incident[node]):
            self.remove_edge(edge)
        del self.nodes[node], self.incident[node]

    def degree(self, node: int) -> int:
        """Number of edge ends at a node; a loop counts twice."""
        return sum(1 + (self.edges[e][0] == self.edges[e][1]) for e in self.incident[node])

    def line(self, edge: int, start: int) -> Points:
        """The line of an edge, beginning at the node ``start``."""
        a, _, points = self.edges[edge]
        return points if a == start else points[::-1]

    def other(self, edge: int, node: int) -> int:
        """The far end of an edge."""
        a, b, _ = self.edges[edge]
        return b if a == node else a

    def dissolve(self) -> None:
        """Remove nodes of role "path" and degree 2, joining their two edges."""
        for node in list(self.nodes):
            if self.nodes[node].role != "path" or len(self.incident[node]) != 2 or self.degree(node) != 2:
                continue
            first, second = sorted(self.incident[node])
            a, b = self.other(first, node), self.other(second, node)
            joined = np.concatenate([self.line(first, a), self.line(second, node)[1:]])
            self.remove_node(node)
            self.add_edge(a, b, joined)

    def drop_rings(self, length: float) -> None:
        """Remove edges shorter than ``length`` that lead from a node back to it: artefacts of the grid."""
        for edge, (a, b, line) in list(self.edges.items()):
            if a == b and line_length(line) < length:
                self.remove_edge(edge)

    def prune(self, excess: Callable[[float, Node, Node], bool]) -> None:
        """Remove dangling branches for which ``excess(length, leaf, root)`` is false, all of a round at once."""
        while True:
            self.dissolve()
            short = []
            for node, data in self.nodes.items():
                if data.role == "path" and self.degree(node) == 1:
                    (edge,) = self.incident[node]
                    root = self.other(edge, node)
                    length = line_length(self.edges[edge][2])
                    is_end = self.degree(root) == 1 and self.nodes[root].role == "path"
                    if not is_end and not excess(length, data, self.nodes[root]):
                        short.append(node)
            if not short:
                return
            for node in short:
                self.remove_node(node)

    def contract(self, near: Callable[[Node, Node], float]) -> None:
        """Merge "path" nodes joined by an edge shorter than ``near(a, b)``, shortest first.

        A "path" node gives way to a room's node; two "path" nodes meet in the middle.
        """
        queue = [(line_length(line), edge) for edge, (_, _, line) in self.edges.items()]
        heapq.heapify(queue)
        while queue:
            length, edge = heapq.heappop(queue)
            if edge not in self.edges:
                continue
            a, b, _ = self.edges[edge]
            keep, give = (a, b) if self.nodes[b].role == "path" else (b, a)
            keeper, giver = self.nodes[keep], self.nodes[give]
            if a == b or giver.role != "path" or length >= near(keeper, giver):
                continue
            if keeper.role == "path":
                fits = min(self.degree(keep), self.degree(give)) >= 3
            else:
                fits = keeper.role == "room" and keeper.owner == giver.owner
            if fits:
                self._merge(edge, keep, give)
                for e in self.incident[keep]:
                    heapq.heappush(queue, (line_length(self.edges[e][2]), e))

    def _merge(self, edge: int, keep: int, give: int) -> None:
        keeper, giver = self.nodes[keep], self.nodes[give]
        middle = keeper.at
        if keeper.role == "path":
            middle = ((keeper.at[0] + giver.at[0]) / 2, (keeper.at[1] + giver.at[1]) / 2)
        self.remove_edge(edge)
        for node in (keep, give):
            for e in list(self.incident[node]):
                a, b, line = self.edges[e]
                line = line.copy()
                # the line ends in the new place; what it did near the old one no longer matters
                if a == node:
                    line[0] = middle
                if b == node:
                    line[-1] = middle
                self.remove_edge(e)
                self.add_edge(keep if a == node else a, keep if b == node else b, line)
        keeper.at = middle
        keeper.half = max(keeper.half, giver.half)
        self.remove_node(give)

    def move(self, node: int, at: tuple[float, float], clear: Mapping[int, float]) -> None:
        """Move a node; its lines go straight there from where each is ``clear[edge]`` of its old place."""
        for edge in list(self.incident[node]):
            a, b, line = self.edges[edge]
            if a == node:
                line = _led_from(line, at, clear[edge])
            if b == node:
                line = _led_from(line[::-1], at, clear[edge])[::-1]
            self.edges[edge] = (a, b, line)
        self.nodes[node].at = at

    def split(self, edge: int, index: int, node: Node) -> int:
        """Put ``node`` at point ``index`` of an edge's line; returns its number."""
        a, b, line = self.edges[edge]
        self.remove_edge(edge)
        number = self.add_node(node)
        self.add_edge(a, number, line[: index + 1])
        self.add_edge(number, b, line[index:])
        return number


def _led_from(line: Points, at: tuple[float, float], clear: float) -> Points:
    """The line that begins at ``at``, and from ``clear`` on is the given one."""
    along = np.concatenate([[0], np.cumsum(np.hypot(*np.diff(line, axis=0).T))])
    return np.concatenate([[at], line[max(1, min(int(np.searchsorted(along, clear)), len(line) - 1)) :]])


def line_length(line: Points) -> float:
    """Length of a line of points, in its own unit."""
    return float(np.hypot(*np.diff(line, axis=0).T).sum())


def straight(a: NDArray[np.int64], b: NDArray[np.int64]) -> NDArray[np.int64]:
    """The cells ``(n, 2)`` of the straight line between two cells, both included."""
    steps = int(np.abs(b - a).max())
    t = np.linspace(0, 1, steps + 1)[:, None]
    return np.rint(a + t * (b - a)).astype(np.int64)


def simplify(line: Points, tolerance: float) -> NDArray[np.int64]:
    """Indices of the points that a line within ``tolerance`` of the given one needs (Douglas and Peucker)."""
    keep = {0, len(line) - 1}
    stack = [(0, len(line) - 1)]
    while stack:
        i, j = stack.pop()
        if j - i < 2:
            continue
        base = line[j] - line[i]
        between = line[i + 1 : j] - line[i]
        along = float(base @ base)
        if along == 0:
            distance = np.hypot(*between.T)
        else:  # distance to the segment, not to the endless line: hairpins count
            t = np.clip(between @ base / along, 0, 1)
            distance = np.hypot(*(between - t[:, None] * base).T)
        k = int(np.argmax(distance))
        if distance[k] > tolerance:
            keep.add(i + 1 + k)
            stack += [(i, i + 1 + k), (i + 1 + k, j)]
    return np.array(sorted(keep))


def trace(
    pixels: NDArray[np.bool_],
    half: NDArray[np.float32],
    fixed: Collection[tuple[int, int]] = (),
    offset: tuple[int, int] = (0, 0),
    owner: int = 0,
) -> PathGraph:
    """Turn the one-pixel-wide lines of ``pixels`` into a graph.

    Nodes are the pixels with other than two neighbours, and the ``fixed`` ones; ``offset`` is added to all
    points.
    """
    links = _links(pixels)
    graph = PathGraph()
    number: dict[tuple[int, int], int] = {}

    def node_at(pixel: tuple[int, int]) -> int:
        if pixel not in number:
            at = (float(pixel[0] + offset[0]), float(pixel[1] + offset[1]))
            number[pixel] = graph.add_node(Node(at, float(half[pixel]), owner=owner))
        return number[pixel]

    ends = {p for p, near in links.items() if len(near) != 2} | set(fixed)
    walked: set[tuple[tuple[int, int], tuple[int, int]]] = set()

    def walk(start: tuple[int, int], step: tuple[int, int]) -> None:
        line = [start, step]
        walked.add((start, step))
        while line[-1] not in ends:
            onward = [p for p in links[line[-1]] if p != line[-2]]
            walked.add((line[-1], onward[0]))
            line.append(onward[0])
        walked.add((line[-1], line[-2]))
        graph.add_edge(node_at(start), node_at(line[-1]), np.array(line, float) + offset)

    for start in sorted(ends):
        node_at(start)
        for step in links[start]:
            if (start, step) not in walked:
                walk(start, step)
    seen = {p for a, b in walked for p in (a, b)} | ends
    for start in sorted(links):  # rings without any junction
        if start not in seen:
            ends.add(start)
            walk(start, links[start][0])
            seen |= {p for a, b in walked for p in (a, b)}
    return graph


def _links(pixels: NDArray[np.bool_]) -> dict[tuple[int, int], list[tuple[int, int]]]:
    """The neighbours of each pixel; a diagonal step counts only where no two straight steps replace it."""
    padded = np.pad(pixels, 1)
    rows, columns = np.nonzero(padded)
    width = padded.shape[1]
    have = padded.ravel()
    here = rows * width + columns
    links: dict[tuple[int, int], list[tuple[int, int]]] = {
        at: [] for at in zip((rows - 1).tolist(), (columns - 1).tolist(), strict=True)
    }
    for dr, dc in ((-1, 0), (0, -1), (0, 1), (1, 0), (-1, -1), (-1, 1), (1, -1), (1, 1)):
        linked = have[here + dr * width + dc]
        if dr and dc:
            linked = linked & ~have[here + dr * width] & ~have[here + dc]
        for r, c in zip((rows[linked] - 1).tolist(), (columns[linked] - 1).tolist(), strict=True):
            links[r, c].append((r + dr, c + dc))
    return links
