"""Measures of a graph of routes on a plan, against the shortest ways over its grid."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy import ndimage
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components, dijkstra

from tasklift.plans.floor import Floor
from tasklift.plans.plan import Plan
from tasklift.plans.routes import Routes

RADIUS_M, NARROW_M = 0.3, 0.2
NEAREST = 12


@dataclass(frozen=True)
class Figures:
    """What the bars are about.

    Attributes
    ----------
    pieces
        How many pieces the graph has.
    near
        Lines that come nearer than 0.3 m to a wall within a part of the floor that a robot of 0.3 m can go all
        about: the floor would have allowed more.
    narrow
        Lines through passages that such a robot does not fit through.
    found
        Share of random pairs of free points with a way.
    stretch
        Mean of the way over the graph, with the straight lines to it, over the grid's shortest (8 neighbours) that
        keeps as far from walls: through narrow passages only where nothing wider joins the two points.
    """

    pieces: int
    near: int
    narrow: int
    found: float
    stretch: float


def measure(routes: Routes, plan: Plan, sources: int = 20, targets: int = 50, seed: int = 0) -> Figures:
    """Compare ``sources * targets`` random pairs of points at which a robot of 0.3 m can stand."""
    floor = Floor.of(plan)
    n = len(routes.node)
    a, b = routes.edges.T
    graph = coo_array((np.maximum(routes.length_m, 1e-9), (a, b)), (n, n)).tocsr()
    pieces = connected_components(graph, False)[0]
    cells = floor.to_cells(routes.position_m)
    clear = floor.clearance_between(cells[a], cells[b])
    safe, _ = ndimage.label(floor.clearance_m >= RADIUS_M)  # across corners alone it does not fit through
    part = safe[tuple(np.rint(cells).astype(int).T)]
    close = clear < RADIUS_M - 0.01
    inside = close & (part[a] == part[b]) & (part[a] > 0)
    # the floor that is meant: what a robot reaches from the nodes, through narrow passages where it must
    narrow, count = ndimage.label(floor.clearance_m >= NARROW_M, np.ones((3, 3), bool))
    here = narrow[tuple(np.rint(cells).astype(int).T)]
    main = narrow == np.bincount(here, minlength=count + 1)[1:].argmax() + 1
    rng = np.random.default_rng(seed)
    rows, columns = np.nonzero(main & (safe > 0))
    pick = rng.integers(len(rows), size=sources + sources * targets)
    points = np.column_stack([rows[pick], columns[pick]]).astype(float)
    joins = _joins(floor, points, cells)
    grid = _Grid(floor.clearance_m, main)
    found, ratios = 0, []
    for i in range(sources):
        goals = sources + i * targets + np.arange(targets)
        shortest = grid.lengths(points[i], points[goals])
        reach = _reach(graph, joins[i], floor.cell_m)
        for g, best in zip(goals, np.array(shortest) * floor.cell_m, strict=True):
            way = min((reach[node] + away for node, away in joins[g]), default=np.inf)
            straight = np.hypot(*(points[i] - points[g])) * floor.cell_m
            if floor.clearance_between(points[[i]], points[[g]])[0] >= RADIUS_M:
                way = min(way, straight)
            found += bool(np.isfinite(way))
            if np.isfinite(way) and best > 0.5:
                ratios.append(way / best)
    total = sources * targets
    return Figures(pieces, int(inside.sum()), int((close & ~inside).sum()), found / total, float(np.mean(ratios)))


class _Grid:
    """The shortest ways over cells; a step is narrow where a cell of it, or both cells beside a slanting one, are."""

    def __init__(self, clearance_m: np.ndarray, passable: np.ndarray):
        self.number = np.where(passable, np.cumsum(passable).reshape(passable.shape) - 1, -1)
        self.cells = np.column_stack(np.nonzero(passable))
        safe = clearance_m >= RADIUS_M
        ends, weights = [], []
        for down, right in ((0, 1), (1, 0), (1, 1), (1, -1)):
            there = self.cells + np.array([down, right])
            other = self.number[tuple(there.T)]
            fits = other >= 0
            here, there, other = self.cells[fits], there[fits], other[fits]
            wide = safe[tuple(here.T)] & safe[tuple(there.T)]
            if down and right:
                wide &= safe[here[:, 0], there[:, 1]] | safe[there[:, 0], here[:, 1]]
            ends.append(np.column_stack([np.flatnonzero(fits), other]))
            weights.append(np.hypot(down, right) * np.where(wide, 1.0, 1000.0))
        pairs = np.concatenate(ends)
        n = len(self.cells)
        self.graph = coo_array((np.concatenate(weights), tuple(pairs.T)), (n, n)).tocsr()

    def lengths(self, start: np.ndarray, goals: np.ndarray) -> list[float]:
        """Lengths (cells) from one point to others."""
        number = self.number[tuple(start.astype(int))]
        _, before = dijkstra(self.graph, directed=False, indices=number, return_predecessors=True)
        found = []
        for goal in self.number[tuple(goals.astype(int).T)].tolist():
            way = [goal]
            while way[-1] != number and before[way[-1]] >= 0:
                way.append(before[way[-1]])
            found.append(float(np.hypot(*np.diff(self.cells[way], axis=0).T).sum()) if way[-1] == number else np.inf)
        return found


def _joins(floor: Floor, points: np.ndarray, cells: np.ndarray) -> list[list[tuple[int, float]]]:
    """For each point the nodes that it sees among the nearest, with their distance (m)."""
    from scipy.spatial import cKDTree

    away, index = cKDTree(cells).query(points, k=min(NEAREST, len(cells)))
    joins = []
    for point, far, nodes in zip(points, away, index, strict=True):
        sees = floor.clearance_between(np.repeat(point[None], len(nodes), 0), cells[nodes]) > 0
        joins.append([(int(n), float(d) * floor.cell_m) for n, d, ok in zip(nodes, far, sees, strict=True) if ok])
    return joins


def _reach(graph: coo_array, start: list[tuple[int, float]], cell_m: float) -> np.ndarray:
    if not start:
        return np.full(graph.shape[0], np.inf)
    nodes, away = zip(*start, strict=True)
    lengths = dijkstra(graph, directed=False, indices=list(nodes))
    return (lengths + np.array(away)[:, None]).min(axis=0)

