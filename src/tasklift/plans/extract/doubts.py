"""What is doubtful about a division and the lines drawn in it: floor without nodes, widths that no building has."""

from __future__ import annotations

import numpy as np

from tasklift.plans.extract.paths import PathGraph
from tasklift.plans.extract.segment import DOOR_WIDTH_M, Division
from tasklift.plans.plan import Plan

WIDEST_CORRIDOR_M = 8.0
MOST_PLACES = 5
# Greys up to this are walls or unknown, and so is the one that map_saver writes; a grey, with those about it, is common
# from this share on.
DARK, SAVED_UNKNOWN = 140, 205
LEAST_SHARE, SPREAD = 0.05, 10


def doubt(plan: Plan, division: Division, graph: PathGraph) -> None:
    """Add to the doubts of the space what a person should look at."""
    space = division.space
    uncovered = _uncovered(division, graph)
    if len(uncovered):
        middles = [np.argwhere(division.region == r).mean(axis=0) for r in uncovered[:MOST_PLACES]]
        at = plan.to_world(*space.to_plan(np.array(middles)).T)
        listed = ", ".join(f"({x:.1f}, {y:.1f})" for x, y in at.tolist())
        more = " …" if len(uncovered) > MOST_PLACES else ""
        area = float(division.measure.area_m2[uncovered].sum())
        space.doubts.append(f"{area:.0f} m² of floor have no node or corridor, near {listed}{more} m")
    lines = [line for _, _, line in graph.edges.values() if len(line) > 1]
    widths = [2 * float(np.median(space.half_width_m[tuple(np.rint(line).astype(int).T)])) for line in lines]
    openings = [opening.width_m for opening in division.openings]
    if widths and np.median(widths) > WIDEST_CORRIDOR_M and min(openings, default=np.inf) > DOOR_WIDTH_M:
        space.doubts.append(
            f"corridors are {np.median(widths):.0f} m wide and no opening is below {DOOR_WIDTH_M:g} m: is the "
            f"resolution of {plan.resolution_m:g} m right?"
        )


def not_free(plan: Plan) -> list[str]:
    """A sentence about the commonest light grey, if it is not free."""
    shares = np.bincount(plan.grey.ravel(), minlength=256) / plan.grey.size
    shares[: DARK + 1] = shares[SAVED_UNKNOWN] = 0
    common = int(shares.argmax())
    about = np.abs(np.arange(256) - common) <= SPREAD
    share = float(shares[about].sum())
    if share < LEAST_SHARE or plan.free[about[plan.grey]].mean() > 0.5:
        return []
    p = (255 - common) / 255
    return [
        f"the commonest light grey is {common} (p = {p:.3f}, {share:.0%} of the picture) and is not free; if "
        f"it is floor, set free_thresh above {p:.3f}"
    ]


def _uncovered(division: Division, graph: PathGraph) -> np.ndarray:
    """Regions as large as a room that no line and no node touches."""
    covered = np.zeros(len(division.measure.area_m2), bool)
    covered[0] = True
    for _, _, line in graph.edges.values():
        covered[division.region[tuple(np.rint(line).astype(int).T)]] = True
    for node in graph.nodes.values():
        covered[division.region[tuple(np.rint(node.at).astype(int))]] = True
    present = np.bincount(division.region.ravel(), minlength=len(covered)) > 0
    large = division.measure.area_m2 >= division.space.settings.smallest_room_m2
    return np.flatnonzero(~covered & present & large)
