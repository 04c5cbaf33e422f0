"""How long the ways of a building are, against the shortest that a robot could drive on its floor plan."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from tasklift.building.graph import ROOM, Building
from tasklift.errors import TaskliftError
from tasklift.plans.extract.lengths import pulled_length
from tasklift.plans.extract.space import ROUNDING, Settings, clean, coarser
from tasklift.plans.plan import Plan

# Of more rooms a part is compared. Ways are looked for on cells at least so large, whose number is about this, but on
# none so large that walls between them vanish.
MOST_ROOMS = 24
FINE_M, COARSE_M = 0.1, 0.25
CELLS = 300_000
ON_FLOOR_M = 1.5  # a room's node is so near to floor that a robot can reach


@dataclass(frozen=True)
class Ways:
    """How much longer the graph's ways between rooms are than the shortest free ones.

    Attributes
    ----------
    pairs, rooms
        The number of pairs compared, and of rooms among which they are.
    radius_m
        A free way keeps this far from walls (m).
    median, p90
        Of graph over free way, minus 1: the median and the 90th percentile.
    """

    pairs: int
    rooms: int
    radius_m: float
    median: float
    p90: float

    def line(self) -> str:
        """The comparison as a line of text."""
        return (
            f"ways        {100 * self.median:+.1f} % (median), {100 * self.p90:+.1f} % (90th percentile) against the "
            f"shortest free way, {self.radius_m:g} m from walls: {self.pairs} pairs of {self.rooms} rooms"
        )


def compare_ways(building: Building, plan: Plan) -> Ways:
    """Compare the ways of ``building`` between its rooms with the shortest free ways on its ``plan``.

    Of more than 24 rooms, 24 spread evenly over their numbers are taken.

    Raises
    ------
    TaskliftError
        If the building has fewer than two rooms on the plan's floor that are joined.
    """
    from scipy.sparse import coo_array
    from scipy.sparse.csgraph import dijkstra
    from skimage.graph import MCP_Geometric

    rooms = np.flatnonzero(building.kind == ROOM)
    rooms = rooms[np.unique(np.linspace(0, len(rooms) - 1, min(len(rooms), MOST_ROOMS)).astype(int))]
    a, b = building.edges.T
    matrix = coo_array((building.length_m, (a, b)), shape=(building.n_nodes, building.n_nodes)).tocsr()
    along = dijkstra(matrix, directed=False, indices=rooms)

    seeds = plan.to_pixels(building.position_m[rooms]) if plan.seeds_m is None else plan.to_pixels(plan.seeds_m)
    space = clean(plan, Settings(), seeds if len(rooms) else None)
    radius = space.settings.narrowest_m / 2
    factor = int(np.clip(np.sqrt(space.free.size / CELLS), FINE_M / space.cell_m, COARSE_M / space.cell_m))
    factor = max(1, factor)
    closed = space.half_width_m < radius - ROUNDING
    robot = ~coarser(np.pad(closed, [(0, -size % factor) for size in closed.shape], constant_values=True), factor)
    cell = space.cell_m * factor
    at = np.floor((space.to_cells(plan.to_pixels(building.position_m[rooms])) + 0.5) / factor).astype(int)
    on_floor = np.argwhere(robot)
    nearest = [on_floor[((on_floor - point) ** 2).sum(axis=1).argmin()] for point in at]
    reached = [i for i, point in enumerate(at) if np.hypot(*(nearest[i] - point)) * cell <= ON_FLOOR_M]
    rooms, along = rooms[reached], along[reached]  # the others are on another level, or behind a shut door
    starts = [tuple(nearest[i].tolist()) for i in reached]
    ratios = []
    for i, start in enumerate(starts):
        search = MCP_Geometric(np.where(robot, 1.0, -1.0))
        cost, _ = search.find_costs([start])
        for j in range(i):
            if np.isfinite(cost[starts[j]]) and starts[j] != start:
                way = np.array(search.traceback(starts[j]), float)
                ratios.append(along[i, rooms[j]] / (pulled_length(way, robot, cell) * cell) - 1)
    if not ratios:
        raise TaskliftError(
            f"{building.name}: fewer than two rooms lie on the floor of {plan.name}; is it another plan?"
        )
    return Ways(len(ratios), len(rooms), radius, float(np.median(ratios)), float(np.quantile(ratios, 0.9)))
