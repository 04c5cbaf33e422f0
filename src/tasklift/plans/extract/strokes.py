"""Thin strokes in drawings with thick walls: leaves and arcs of doors, which shut rooms that are open."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from tasklift.plans.extract.space import EIGHT, to_wall
from tasklift.plans.plan import Plan

# Walls of fewer pixels leave no room for thinner strokes; a stroke is at most this part of a wall.
THICKEST_PIXELS = 5
THIN_SHARE = 0.5
# The leaf and arc of a door are within a box of these sides (m), this many times longer than wide at most.
SMALLEST_M, LARGEST_M = 0.4, 2.6
LONGEST = 2.5
BROKEN_PIXELS = 2


def without_door_leaves(plan: Plan) -> tuple[Plan, NDArray[np.float64]] | None:
    """The plan without the leaves and arcs of its doors, and their places ``(n, 2)`` (m); ``None`` if it has none.

    A window is drawn with thin strokes as well, but long and narrow ones; they stay.
    """
    from scipy import ndimage

    occupied = ~plan.free & ~plan.unknown
    if not occupied.any():
        return None
    wall = 2 * float(np.percentile(to_wall(occupied)[occupied], 90))
    if wall < THICKEST_PIXELS:
        return None
    size = max(2, int(wall * THIN_SHARE) + 1)
    # a grey stroke is neither free nor a wall; a turned one may have gaps
    drawn = ~plan.free
    thick = ndimage.binary_dilation(ndimage.binary_opening(drawn, np.ones((size, size), bool)), EIGHT)
    label, n = ndimage.label(ndimage.binary_dilation(drawn & ~thick, EIGHT, BROKEN_PIXELS), structure=EIGHT)
    strokes = np.zeros(n + 1, bool)
    middles = []
    for i, box in enumerate(ndimage.find_objects(label), start=1):
        sides = sorted((s.stop - s.start) * plan.resolution_m for s in box)
        if sides[0] >= SMALLEST_M and sides[1] <= min(LARGEST_M, LONGEST * sides[0]):
            strokes[i] = True
            middles.append([(s.start + s.stop) / 2 for s in box])
    if not middles:
        return None
    free = plan.free | (strokes[label] & ~thick)
    return replace(plan, free=free), plan.to_world(*np.array(middles).T)
