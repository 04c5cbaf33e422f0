"""What is in a building, in figures, and what looks wrong with it."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from tasklift.building.graph import CLASS_NAMES, DOOR, FEATURE, INTERSECTION, KIND_NAMES, OTHER, ROOM, Building
from tasklift.building.search import hostile_candidates
from tasklift.text import shown

SHORTEST_EDGE_M = 0.3
NEAREST_NODES_M = 0.4
SMALLEST_LOOP_M = 12.0
LONGEST_DETOUR = 3.0
MOST_WARNINGS = 8
GENERATED = "tasklift.building.generate"


@dataclass(frozen=True)
class Check:
    """What :func:`check` found.

    Attributes
    ----------
    counts
        Nodes by kind, features by class as ``"door"`` and so on, and edges.
    degrees
        Number of nodes by their number of corridors.
    loops
        Independent loops: edges − nodes + 1, as every building is connected.
    bridges
        Corridors without which the building would fall apart.
    length_m, width_m
        Least, median and greatest (m).
    total_length_m, room_area_m2
        Sums.
    warnings
        What looks wrong, a sentence each.
    """

    counts: dict[str, int]
    degrees: dict[int, int]
    loops: int
    bridges: int
    length_m: tuple[float, float, float]
    width_m: tuple[float, float, float]
    total_length_m: float
    room_area_m2: float
    warnings: tuple[str, ...]

    def lines(self) -> list[str]:
        """The findings as text, a line each."""
        counts = ", ".join(f"{n} {name}{'s' * (n != 1)}" for name, n in self.counts.items() if n)
        degrees = ", ".join(f"{n} with {degree}" for degree, n in self.degrees.items())
        low, middle, high = self.length_m
        narrow, usual, wide = self.width_m
        found = [
            f"nodes       {counts}",
            f"corridors   {degrees} (number of nodes by number of corridors)",
            f"loops       {self.loops}; connected; {self.bridges} corridors have no way around",
            f"lengths     {low:.2f} to {high:.2f} m, median {middle:.2f} m, {self.total_length_m:.0f} m in all",
            f"widths      {narrow:.2f} to {wide:.2f} m, median {usual:.2f} m",
            f"rooms       {self.room_area_m2:.0f} m² in all",
        ]
        found += [f"looks wrong {warning}" for warning in self.warnings]
        return found if self.warnings else [*found, "looks wrong nothing that this check knows of"]


def check(building: Building) -> Check:
    """Count what is in ``building`` and look for what a person should look at."""
    kind, feature = building.kind, building.feature_class
    counts = {name: int(np.sum(kind == value)) for value, name in enumerate(KIND_NAMES) if value != FEATURE}
    counts |= {name: int(np.sum(feature == value)) for value, name in CLASS_NAMES.items()}
    counts["edge"] = building.n_edges
    values, numbers = np.unique(building.degree, return_counts=True)
    return Check(
        counts=counts,
        degrees=dict(zip(values.tolist(), numbers.tolist(), strict=True)),
        loops=building.n_edges - building.n_nodes + 1,
        bridges=len(_bridges(building)),
        length_m=_spread(building.length_m),
        width_m=_spread(building.width_m),
        total_length_m=float(building.length_m.sum()),
        room_area_m2=float(building.area_m2.sum()),
        warnings=tuple(_warnings(building)),
    )


def _spread(values: np.ndarray) -> tuple[float, float, float]:
    return float(values.min()), float(np.median(values)), float(values.max())


def _warnings(building: Building) -> list[str]:
    position, degree = building.position_m, building.degree
    a, b = building.edges.T
    straight = np.hypot(*(position[a] - position[b]).T)
    door = building.feature_class == DOOR
    feature = building.kind == FEATURE
    found: list[str] = []

    def warn(what: str, nodes: np.ndarray) -> None:
        if len(nodes):
            listed = ", ".join(_place(building, int(node)) for node in nodes[:MOST_WARNINGS])
            more = f" and {len(nodes) - MOST_WARNINGS} more" if len(nodes) > MOST_WARNINGS else ""
            found.append(f"{what}: {listed}{more}")

    def warn_edges(what: str, edges: np.ndarray) -> None:
        if len(edges):
            listed = ", ".join(f"{a[e]}-{b[e]}" for e in edges[:MOST_WARNINGS].tolist())
            more = f" and {len(edges) - MOST_WARNINGS} more" if len(edges) > MOST_WARNINGS else ""
            found.append(f"{what}: {listed}{more}")

    rides, lifts = _rides(building)
    warn("features where corridors meet; make them intersections", np.flatnonzero(feature & (degree > 2) & ~lifts))
    warn("features at a dead end", np.flatnonzero(feature & (degree == 1)))
    unmarked = (building.kind == INTERSECTION) & (degree == 2)
    if building.provenance.get("source") != GENERATED:  # as in the paper's buildings, by their counts
        warn("intersections with two corridors; bends or other features?", np.flatnonzero(unmarked))
    if not hostile_candidates(building):
        found.append("no place for a hostile: no door, nor another feature in a building without doors, is away from "
                     "the start")  # fmt: skip
    elif not door.any():
        found.append("no doors: hostiles hide at bends, corners and other features instead")
    if not (building.kind == ROOM).any():
        found.append("no rooms: nothing to search but corridors")
    elif building.kind[building.start] != ROOM:
        found.append(f"the robots do not start in a room but at {_place(building, building.start)}")
    warn_edges(f"shorter than {SHORTEST_EDGE_M:g} m", np.flatnonzero(building.length_m < SHORTEST_EDGE_M))
    warn_edges(
        "shorter than the straight line between the places at their ends",
        np.flatnonzero((building.length_m < 0.98 * straight - 0.05 - _reach(building)) & ~rides),
    )
    warn_edges(
        f"more than {LONGEST_DETOUR:g} times as long as the straight line",
        np.flatnonzero((building.length_m > LONGEST_DETOUR * straight) & (building.length_m > 2.0)),
    )
    near = _near_pairs(building)
    if near:
        listed = ", ".join(f"{i}-{j}" for i, j in near[:MOST_WARNINGS])
        found.append(f"nodes within {NEAREST_NODES_M:g} m of each other; merge them? {listed}")
    rings = _small_loops(building)
    if rings:
        listed = "; ".join(" ".join(map(str, ring)) for ring in rings[:MOST_WARNINGS])
        found.append(f"loops of less than {SMALLEST_LOOP_M:g} m, around furniture? {listed}")
    return found


def _rides(building: Building) -> tuple[np.ndarray, np.ndarray]:
    """Which corridors are rides of a lift from level to level, and which nodes are lifts."""
    lift = np.full(building.n_nodes, -1)
    lifts = building.provenance.get("lifts")
    for i, places in enumerate(lifts.values() if isinstance(lifts, dict) else ()):
        for node, at in enumerate(building.position_m.round(3).tolist()):
            if isinstance(places, list) and at in places:
                lift[node] = i
    a, b = building.edges.T
    return (lift[a] >= 0) & (lift[a] == lift[b]), lift >= 0


def _reach(building: Building) -> np.ndarray:
    """How far (m) the places at both ends of each corridor reach: where corridors meet, ways cut the corner."""
    half = np.zeros(building.n_nodes)
    for end in building.edges.T:
        np.maximum.at(half, end, building.width_m / 2)
    half = np.maximum(half, np.sqrt(building.area_m2) / 2)
    half[(building.feature_class == DOOR) | (building.degree == 1)] = 0
    return np.asarray(half[building.edges].sum(axis=1))


def _place(building: Building, node: int) -> str:
    x, y = building.position_m[node].tolist()
    return f"{node} at {x:.1f} {y:.1f}"


def _near_pairs(building: Building) -> list[tuple[int, int]]:
    from scipy.spatial import KDTree

    pairs = KDTree(building.position_m).query_pairs(NEAREST_NODES_M)
    return sorted((int(i), int(j)) for i, j in pairs)


def _bridges(building: Building) -> list[int]:
    """Edges whose loss would disconnect the building (depth first, lowest point reached)."""
    indptr, neighbour, edge_of = (v.tolist() for v in (building.indptr, building.neighbour, building.edge_of))
    entered = [-1] * building.n_nodes
    low = [0] * building.n_nodes
    found, clock = [], 0
    stack = [(building.start, -1, indptr[building.start])]
    entered[building.start] = 0
    while stack:
        node, via, at = stack.pop()
        if at < indptr[node + 1]:
            stack.append((node, via, at + 1))
            other, edge = neighbour[at], edge_of[at]
            if edge == via:
                continue
            if entered[other] < 0:
                clock += 1
                entered[other] = low[other] = clock
                stack.append((other, edge, indptr[other]))
            else:
                low[node] = min(low[node], entered[other])
        elif stack:
            parent = stack[-1][0]
            low[parent] = min(low[parent], low[node])
            if low[node] > entered[parent]:
                found.append(via)
    return found


def _small_loops(building: Building) -> list[list[int]]:
    """The shortest loop through each edge that is on a short one, once each."""
    from scipy.sparse import coo_array
    from scipy.sparse.csgraph import dijkstra

    a, b = building.edges.T
    n = building.n_nodes
    found: dict[tuple[int, ...], list[int]] = {}
    graph = coo_array((building.length_m, (a, b)), shape=(n, n)).tolil()
    for i, j, length in zip(a.tolist(), b.tolist(), building.length_m.tolist(), strict=True):
        if length >= SMALLEST_LOOP_M:
            continue
        graph[i, j] = 0
        distance, before = dijkstra(
            graph.tocsr(), directed=False, indices=i, return_predecessors=True, limit=SMALLEST_LOOP_M - length
        )
        graph[i, j] = length
        if np.isfinite(distance[j]):
            ring = [j]
            while ring[-1] != i:
                ring.append(int(before[ring[-1]]))
            found.setdefault(tuple(sorted(ring)), ring)
    return list(found.values())


def node_lines(building: Building) -> list[str]:
    """One line per node: its number, place (m), kind, and neighbours; what one needs to write edits."""
    lines = []
    names = building.provenance.get("names")
    names = names if isinstance(names, dict) else {}
    for node in range(building.n_nodes):
        x, y = building.position_m[node].tolist()
        kind = KIND_NAMES[building.kind[node]]
        if building.kind[node] == FEATURE:
            kind = CLASS_NAMES.get(int(building.feature_class[node]), CLASS_NAMES[OTHER])
        near = building.neighbour[building.indptr[node] : building.indptr[node + 1]].tolist()
        area = f"  {building.area_m2[node]:.1f} m²" if building.kind[node] == ROOM else ""
        name = f"  {shown(names[str(node)])}" if str(node) in names else ""
        lines.append(f"{node:5d}  {x:9.2f} {y:9.2f}  {kind:<12} to {' '.join(map(str, near))}{area}{name}")
    return lines
