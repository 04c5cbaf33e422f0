"""How fast a mission can be at best: an exact lower bound on the steps of an episode that solves it."""

from __future__ import annotations

import heapq

import numpy as np
from numpy.typing import NDArray

from tasklift.building.graph import Building
from tasklift.building.setting import Setting
from tasklift.building.simulator import edge_cost_mm, search_steps


def least_steps(mission: Setting) -> int:
    """Return steps below which no team like this solves the mission, whatever its policy is and wherever hostiles are.

    It is the largest of three bounds, each exact in itself, with every robot as fast as the fastest one:

    - the farthest corridor must be reached and travelled;
    - the farthest room must be reached and searched;
    - all corridors must be travelled by somebody, and no robot is in two of them at once.

    Nobody leaves a room before it is searched (rule 13), the start's own first of all.

    Parameters
    ----------
    mission : Mission
        Only its building, team and search rate matter.

    Examples
    --------
    >>> from tasklift.building import Mission, generate
    >>> least_steps(Mission(generate(seed=7), team="10+5"))
    86
    """
    building = mission.building
    speed = max(kind.speed_mm for kind, number in mission.team.items() if number)
    # a robot leaves a node without progress and arrives when it has an edge's length: each edge takes full steps
    steps = -(-edge_cost_mm(building.length_m, building.width_m) // speed)
    search = search_steps(building.kind == 0, building.area_m2, building.obstacles, mission.reading.search_rate_m2)
    leaves = _leaves(building, steps, search)
    ends = np.full(building.n_edges, np.iinfo(np.int64).max)
    tails = np.repeat(np.arange(building.n_nodes), np.diff(building.indptr))
    np.minimum.at(ends, building.edge_of, leaves[tails] + steps[building.edge_of])
    shared = -(-int(steps.sum()) // mission.n_robots)
    return int(max(ends.max(initial=0), leaves[search > 0].max(initial=0), shared))


def _leaves(building: Building, steps: NDArray[np.int64], search: NDArray[np.int64]) -> NDArray[np.int64]:
    """Return int64 (N,): the fewest steps after which a robot can leave each node, its room searched (Dijkstra).

    The step of arrival is the first one that searches. Nobody leaves a room that is not searched.
    """
    leaves = np.full(building.n_nodes, np.iinfo(np.int64).max)
    leaves[building.start] = search[building.start]
    queue = [(int(leaves[building.start]), int(building.start))]
    while queue:
        when, node = heapq.heappop(queue)
        if when > leaves[node]:
            continue
        for half in range(building.indptr[node], building.indptr[node + 1]):
            there = int(building.neighbour[half])
            left = when + int(steps[building.edge_of[half]]) + max(int(search[there]) - 1, 0)
            if left < leaves[there]:
                leaves[there] = left
                heapq.heappush(queue, (left, there))
    return leaves
