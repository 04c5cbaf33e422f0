"""What a division holds that is not the building's: the outdoors, a scanner's rays beyond windows, closets."""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np
from numpy.typing import NDArray

from tasklift.plans.extract.regions import measure_regions
from tasklift.plans.extract.rooms import which_are_rooms
from tasklift.plans.extract.segment import Division
from tasklift.plans.extract.space import EDGE_DOUBT
from tasklift.plans.plan import Plan

# The outdoors lies along this part of the picture's edge, and the building is not smaller than this.
EDGE_SHARE = 0.25
LEAST_BUILDING_M2 = 15.0
# Rays have walls along at most this part of their border if they are a dead end, or else; a wall is near within this
# distance.
WALLED_SHARE = 0.25
THROUGH_SHARE = 0.15
NEAR_WALL_M = 0.3
CLOSET_ELONGATION = 3.0  # what is longer is a piece of corridor


def leave_out(division: Division, plan: Plan) -> None:
    """Leave out what is not the building's, and say so; the ways to the outdoors stay, as doors at dead ends."""
    outdoors = _outdoors(division)
    if outdoors.any():
        at = [o.pixel for o in division.openings if outdoors[list(o.regions)].sum() == 1]
        _remove(division, outdoors, plan, keep_openings=True)
        places = _places(division, plan, at)
        division.space.doubts[:] = [doubt for doubt in division.space.doubts if doubt != EDGE_DOUBT]
        division.space.doubts.append(f"the floor beyond {places} runs along the picture's edge: taken for the outdoors")
    if plan.unknown.any() and plan.doors_m is None:
        rays = _rays(division, plan)
        if rays.any():
            at = [o.pixel for o in division.openings if rays[list(o.regions)].any()]
            _remove(division, rays, plan)
            places = _places(division, plan, at)
            division.space.doubts.append(
                f"floor without walls around it, beyond {places}, was left out: a scanner's rays through windows?"
            )
    measure = division.measure
    closet = (measure.exits == 1) & ~division.is_room & (measure.elongation < CLOSET_ELONGATION)
    closet &= measure.area_m2 < division.space.settings.smallest_room_m2
    closet[0] = False
    if closet.sum() and closet.sum() + 1 < len(closet):
        _cut(division, closet)
        division.space.doubts.append(f"{int(closet.sum())} closets too small for a room were left out")


def _cut(division: Division, out: NDArray[np.bool_]) -> None:
    division.openings = [o for o in division.openings if not out[list(o.regions)].any()]
    division.region = np.where(out[division.region], 0, division.region).astype(np.int32)


def _remove(division: Division, out: NDArray[np.bool_], plan: Plan, keep_openings: bool = False) -> None:
    """Take regions out, and look anew at what is a room; with ``keep_openings`` those to the rest become doors."""
    kept = []
    for opening in division.openings:
        gone = out[list(opening.regions)]
        if gone.sum() == 1 and keep_openings:
            opening.regions = (opening.regions[0] if gone[1] else opening.regions[1], 0)
            opening.is_door = True
        if not gone.any() or (gone.sum() == 1 and keep_openings):
            kept.append(opening)
    space = division.space
    division.openings = kept
    division.region = np.where(out[division.region], 0, division.region).astype(np.int32)
    division.measure = measure_regions(space, division.region, kept)
    is_room = which_are_rooms(space, division.region, kept, division.measure)
    division.is_room = (division.is_room[: len(is_room)] | is_room) & (division.measure.area_m2 > 0)


def _outdoors(division: Division) -> NDArray[np.bool_]:
    """Regions that together, joined without doors, lie along much of the picture's edge."""
    edge = division.space.at_edge
    n = len(division.measure.exits)
    touches = np.bincount(division.region[edge], minlength=n).astype(float)
    touches[0] = 0
    root = np.arange(n)
    for opening in division.openings:
        a, b = opening.regions
        if not opening.is_door and touches[a] and touches[b]:
            root[root == root[b]] = root[a]
    share = np.bincount(root, touches, minlength=n) / max(1, division.space.edge_cells)
    out: NDArray[np.bool_] = (share[root] > EDGE_SHARE) & (touches > 0)
    rest = float(division.measure.area_m2[~out].sum())
    if rest < LEAST_BUILDING_M2 or not division.is_room[~out].any():
        out[:] = False
    return out


def _rays(division: Division, plan: Plan) -> NDArray[np.bool_]:
    """Regions whose border is not a wall but the unknown; none where walls are not drawn at all."""
    from scipy import ndimage

    space, region, measure = division.space, division.region, division.measure
    wall = space.part_of(~plan.free & ~plan.unknown)
    near = ndimage.binary_dilation(wall, iterations=max(1, round(NEAR_WALL_M / space.cell_m)))
    border = (region > 0) & ndimage.binary_dilation(~space.free)
    n = len(measure.exits)
    length = np.bincount(region[border], minlength=n)
    walled = np.bincount(region[border & near], minlength=n)
    out: NDArray[np.bool_] = walled < np.where(measure.exits == 1, WALLED_SHARE, THROUGH_SHARE) * length
    out[0] = False
    return out & (2 * measure.area_m2[out].sum() < measure.area_m2.sum())


def _places(division: Division, plan: Plan, cells: Iterable[tuple[int, int]]) -> str:
    points = np.array(list(cells), float).reshape(-1, 2)
    at = plan.to_world(*division.space.to_plan(points).T)
    listed = [f"({x:.1f}, {y:.1f})" for x, y in at[:5].tolist()]
    return f"{' and '.join(listed)}{' …' if len(at) > 5 else ''} m"
