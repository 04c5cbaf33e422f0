"""CovA: the share of a building's area that lies on each corridor's side of a node (paper, Fig. 2a).

The plane around a node is divided by the bisectors of the angles between neighbouring corridors; the outline
cuts each sector off, in a strict geometric sense, whether or not walls lie between.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

if TYPE_CHECKING:
    from tasklift.building.graph import Building

# Directions that differ by less than this part of a full turn are one direction (0.6 nanoradians)
_DIRECTIONS = 10**10


def coverage(building: Building) -> NDArray[np.float64]:
    """Return CovA of every half-edge at its node.

    Corridors that leave a node in the same direction share their sector evenly; a node's only corridor has
    all of the area. The sectors of a node divide the whole plane, so this holds wherever the node lies.

    Returns
    -------
    float64 (2E,)
        In the order of ``building.neighbour``; at least 0, sums to 1 at every node.
    """
    import shapely

    outline = shapely.Polygon(building.outline_m)
    share = np.empty(len(building.neighbour))
    rings, groups, nodes = [], [], []
    for node in range(building.n_nodes):
        here = slice(building.indptr[node], building.indptr[node + 1])
        ring, group = _sectors(building, node)
        if len(ring) == 1:
            share[here] = 1 / len(group)
        else:
            rings.append(ring)
            groups.append(group)
            nodes.append(here)
    if not rings:
        return share
    area = shapely.area(shapely.intersection(shapely.polygons(np.concatenate(rings)), outline))
    first = 0
    for ring, group, here in zip(rings, groups, nodes, strict=True):
        of_sector = area[first : first + len(ring)]
        first += len(ring)
        # Sectors partition the plane: only rounding may be missing
        assert abs(of_sector.sum() / outline.area - 1) < 1e-6, "sectors do not add up to the outline"
        of_edge = (of_sector / np.bincount(group))[group]
        share[here] = of_edge / of_edge.sum()
    return share


def sectors(building: Building, node: int) -> list[Any]:
    """Return the part of the outline on the side of each corridor of ``node``: shapely (multi)polygons.

    In the order of the node's half-edges; corridors in the same direction get the sector that they share.
    """
    import shapely

    outline = shapely.Polygon(building.outline_m)
    rings, group = _sectors(building, node)
    if len(rings) == 1:
        return [outline] * len(group)
    return list(shapely.intersection(shapely.polygons(rings), outline)[group])


def _sectors(building: Building, node: int) -> tuple[NDArray[np.float64], NDArray[np.int64]]:
    """Rings ``(G, 7, 2)`` of a node's G sectors, large enough for the outline; each half-edge's sector.

    With a single direction there is one sector, the whole plane, and its ring means nothing.
    """
    here = building.position_m[node]
    offset = building.position_m[building.neighbour[building.indptr[node] : building.indptr[node + 1]]] - here
    angle = np.arctan2(offset[:, 1], offset[:, 0])
    key = np.round(angle * (_DIRECTIONS / (2 * np.pi))).astype(np.int64) % _DIRECTIONS
    _, first, group = np.unique(key, return_index=True, return_inverse=True)
    direction = angle[first]
    gap = np.mod(np.roll(direction, -1) - direction, 2 * np.pi)
    low, width = direction - np.roll(gap, 1) / 2, (gap + np.roll(gap, 1)) / 2
    # With two or more directions a sector spans at most half a turn, so the ring's chords stay 1.38 times as
    # far from the node as the farthest point of the outline
    ray = low[:, None] + width[:, None] * np.linspace(0, 1, 5)
    radius = 1.5 * np.sqrt(((building.outline_m - here) ** 2).sum(axis=1).max())
    ring = np.empty((len(direction), 7, 2))
    ring[:, [0, 6]] = here
    ring[:, 1:6, 0] = here[0] + radius * np.cos(ray)
    ring[:, 1:6, 1] = here[1] + radius * np.sin(ray)
    return ring, group


def goal_shares(building: Building, node: int, goal: int, sharpness: float = 1.0) -> NDArray[np.float64]:
    """Return GolC of every way at a node (paper, Fig. 2b): how likely the goal lies there.

    GolC_j ∝ 1 / (0.5 + d_j) ** ``sharpness``, ``d_j`` the straight distance (m) from the goal to the far end
    of way ``j``; equal shares at the goal itself. Rule 9 of ``docs/reading.md``; the simulator's
    :func:`tasklift.building.kernel.draw_edge` computes the same over the ways open to a robot.

    Returns
    -------
    float64 (degree,)
        In the order of the node's half-edges; sums to 1.
    """
    ways = building.neighbour[building.indptr[node] : building.indptr[node + 1]]
    if node == goal:
        return np.full(len(ways), 1 / len(ways))
    distance = np.hypot(*(building.position_m[ways] - building.position_m[goal]).T)
    nearness = (0.5 + distance) ** -float(sharpness)
    total = nearness.sum()  # 0 if all are too far for so sharp a rule
    return np.asarray(nearness / total) if total > 0 else np.full(len(ways), 1 / len(ways))
