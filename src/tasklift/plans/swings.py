"""Doors in line drawings: the quarter circles that their leaves describe, and lines for doors that lie in walls."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from tasklift.plans.lines import Points

# A leaf is so long (m), and opens so far (degrees).
SHORTEST_LEAF_M, LONGEST_LEAF_M = 0.35, 1.6
LEAST_SWING, MOST_SWING = 55.0, 110.0
# An arc's points lie on its circle up to this part of its radius.
ROUND = 0.02
# What lies within the swing of a leaf, give or take this much (m), is the leaf.
LEAF_M = 0.08
# Doors without an arc are so wide (m), and have a wall so near (m) at both ends and in the middle.
WIDEST_DOOR_M = 3.0
IN_WALL_M = 0.2


@dataclass(frozen=True, eq=False)
class _Swing:
    """The way of a leaf: its hinge and the points of its arc (m)."""

    hinge: Points
    arc: Points


def openings(walls: Sequence[Points], doors: Sequence[Sequence[Points]]) -> tuple[list[Points], Points]:
    """Return the walls without leaves and arcs of doors, and both ends of every door ``(K, 2, 2)`` (m).

    Parameters
    ----------
    walls
        Lines, ``(n, 2)`` points each (m). Arcs and leaves of doors may be among them.
    doors
        For every door the lines that draw it.
    """
    import shapely

    swings = [swing for line in walls if (swing := _swing(line)) is not None]
    unswung = []
    for lines in doors:
        found = [swing for line in lines if (swing := _swing(line)) is not None]
        swings += found
        if not found:
            unswung.append(np.concatenate(lines))
    drawn = shapely.linestrings(np.concatenate(walls), indices=np.repeat(np.arange(len(walls)), list(map(len, walls))))
    leaves: set[int] = set()
    if swings:
        ways = shapely.buffer([shapely.Polygon([s.hinge, *s.arc]) for s in swings], LEAF_M)
        leaves = set(shapely.STRtree(drawn).query(ways, predicate="contains")[1].tolist())
    kept = [line for i, line in enumerate(walls) if i not in leaves]
    if not kept:
        return list(walls), np.zeros((0, 2, 2))
    tree = shapely.STRtree(np.delete(drawn, list(leaves)))
    found_doors = [_closed(swing, tree) for swing in swings]
    found_doors += [door for points in unswung if (door := _in_wall(points, tree)) is not None]
    return kept, np.array(found_doors).reshape(-1, 2, 2)


def _swing(line: Points) -> _Swing | None:
    """The way of a leaf, if a line is an arc as a leaf describes it."""
    if len(line) < 4:
        return None
    middle = line.mean(axis=0)
    at = line - middle
    solved, _, rank, _ = np.linalg.lstsq(np.column_stack([2 * at, np.ones(len(at))]), (at**2).sum(axis=1), rcond=None)
    if rank < 3:
        return None
    radius = float(np.sqrt(max(solved[2] + solved[:2] @ solved[:2], 0)))
    spokes = at - solved[:2]
    if not SHORTEST_LEAF_M <= radius <= LONGEST_LEAF_M or np.abs(np.hypot(*spokes.T) - radius).max() > ROUND * radius:
        return None
    turned = np.degrees(np.abs(np.diff(np.unwrap(np.arctan2(spokes[:, 1], spokes[:, 0])))).sum())
    return _Swing(solved[:2] + middle, line) if LEAST_SWING <= turned <= MOST_SWING else None


def _closed(swing: _Swing, walls: Any) -> Points:
    """Both ends of a shut door: its hinge, and the end of its arc that is nearer to a wall."""
    away = _distance(walls, swing.arc[[0, -1]])
    return np.array([swing.hinge, swing.arc[0 if away[0] <= away[1] else -1]])


def _in_wall(points: Points, walls: Any) -> Points | None:
    """Both ends of a door that is drawn without an arc, if it lies in a wall."""
    middle = points.mean(axis=0)
    along = np.linalg.svd(points - middle, full_matrices=False)[2][0]
    reach = (points - middle) @ along
    ends = middle + np.outer([reach.min(), reach.max()], along)
    if not SHORTEST_LEAF_M <= np.ptp(reach) <= WIDEST_DOOR_M:
        return None
    return ends if _distance(walls, np.vstack([ends, ends.mean(axis=0)])).max() <= IN_WALL_M else None


def _distance(walls: Any, points: Points) -> NDArray[np.float64]:
    """How far the nearest wall is from each point (m)."""
    import shapely

    index, distance = walls.query_nearest(shapely.points(points), return_distance=True, all_matches=False)
    found = np.zeros(len(points))
    found[index[0]] = distance
    return found
