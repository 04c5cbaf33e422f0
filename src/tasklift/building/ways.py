"""How a node's ways are weighed, for people to look at: the sectors of CovA, and GolC (paper, Fig. 2)."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from tasklift.building.coverage import rings
from tasklift.building.graph import Building


def sectors(building: Building, node: int) -> list[Any]:
    """Return the part of the outline on the side of each corridor of ``node``: shapely (multi)polygons.

    In the order of the node's half-edges; corridors in the same direction get the sector that they share.
    """
    import shapely

    outline = shapely.Polygon(building.outline_m)
    ways = building.neighbour[building.indptr[node] : building.indptr[node + 1]]
    ring, group = rings(building.position_m[node], building.position_m[ways], building.outline_m)
    if len(ring) == 1:
        return [outline] * len(group)
    return list(shapely.intersection(shapely.polygons(ring), outline)[group])


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
