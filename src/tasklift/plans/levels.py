"""Levels of a building joined by its lifts: plans side by side, and a node for each lift on each of its levels."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import pairwise
from typing import Any

import numpy as np
from numpy.typing import NDArray

from tasklift.building.graph import CLASS_NAMES, CORNER, INTERSECTION, OTHER, Building
from tasklift.errors import TaskliftError
from tasklift.plans.edits import HEADER, REACH_M, apply_edits, parse_edits
from tasklift.plans.extract.building import choose_start
from tasklift.plans.plan import Lift, Plan

# A ride takes as long as a robot drives these metres: waiting and doors, and for every metre of height.
WAIT_M = 20.0
PER_HEIGHT_M = 1.0
STOREY_M = 3.0  # where the file has no heights
APART_M = 3.0  # between two plans


@dataclass(frozen=True, eq=False)
class Level:
    """One level: its name, its plan, and the building that was found in it."""

    name: str
    plan: Plan
    building: Building


def join_levels(name: str, levels: Sequence[Level]) -> tuple[Building, Plan, list[str]]:
    """Return one building of all levels, from the lowest up, their plan, and doubts.

    The plans lie side by side; places of the lowest level stay what they are. A lift is a feature "other" on each of
    its levels. Its nodes on one level and the next are joined by an edge as long as a ride takes.

    Raises
    ------
    TaskliftError
        If lifts do not join all levels.
    """
    levels = sorted(levels, key=lambda level: level.plan.elevation_m)
    plan, offsets = _side_by_side(name, [level.plan for level in levels])
    doubts: list[str] = []
    stops: dict[str, list[tuple[int, int]]] = {}  # by lift: level and node
    buildings = []
    first = 0
    for i, level in enumerate(levels):
        building = level.building
        for lift in level.plan.lifts:
            building = _with_lift(building, lift)
        for lift in level.plan.lifts:
            at = _nearest(building, lift.cabin_m)
            stops.setdefault(lift.name, []).append((i, first + at))
        buildings.append(building)
        first += building.n_nodes
    rides = []
    for lift_name, served in stops.items():
        if len(served) < 2:
            doubts.append(f"{lift_name} serves only level {levels[served[0][0]].name} of those taken")
        for (low, a), (high, b) in pairwise(served):
            height = levels[high].plan.elevation_m - levels[low].plan.elevation_m
            rides.append((a, b, WAIT_M + PER_HEIGHT_M * max(height, STOREY_M)))
    joined = _union(name, buildings, offsets, rides, plan)
    names = {str(node): f"{lift} {levels[i].name}" for lift, served in stops.items() for i, node in served}
    places = {
        lift: [joined.position_m[node].round(3).tolist() for _, node in served] for lift, served in stops.items()
    }
    corners = {level.name: offset.round(3).tolist() for level, offset in zip(levels, offsets, strict=True)}
    origin = joined.provenance | {"names": names, "lifts": places, "levels": corners}
    return replace(joined, provenance=origin), plan, doubts


def _with_lift(building: Building, lift: Lift) -> Building:
    """The building with a node for a lift: the dead end in its cabin, or a new one that leads to its landing."""
    near = _nearest(building, lift.cabin_m)
    x, y = lift.cabin_m
    class_ = CLASS_NAMES[OTHER]
    if np.hypot(*(building.position_m[near] - lift.cabin_m)) <= REACH_M and building.degree[near] == 1:
        return _edited(building, f"set class at node {near} to {class_}")
    landing = lift.landing_m
    try:
        added = _edited(building, f"add node at {x:.3f} {y:.3f} to {landing[0]:.3f} {landing[1]:.3f}")
    except TaskliftError:  # no corridor there
        added = _edited(building, f"add node at {x:.3f} {y:.3f} to node {_nearest(building, landing)}")
    node = _nearest(added, lift.cabin_m)
    beside = int(added.neighbour[added.indptr[node]])
    if added.kind[beside] == INTERSECTION and added.degree[beside] == 2:  # a corridor ended there
        added = _edited(added, f"set class at node {beside} to {CLASS_NAMES[CORNER]}")
    return _edited(added, f"set class at node {node} to {class_}")


def _edited(building: Building, line: str) -> Building:
    return apply_edits(building, parse_edits(f"{HEADER}\n{line}", "lift"))[0]


def _nearest(building: Building, at: tuple[float, float]) -> int:
    return int(np.hypot(*(building.position_m - at).T).argmin())


def _side_by_side(name: str, plans: Sequence[Plan]) -> tuple[Plan, list[NDArray[np.float64]]]:
    """One plan of several, and how far each was moved (m); the first stays where it is."""
    resolution = min(plan.resolution_m for plan in plans)
    plans = [_finer(plan, resolution) for plan in plans]
    apart = round(APART_M / resolution)
    height = max(plan.free.shape[0] for plan in plans)
    origin = np.array(plans[0].origin[:2])
    columns = [np.cumsum([0, *(plan.free.shape[1] + apart for plan in plans)])[i] for i in range(len(plans))]
    width = columns[-1] + plans[-1].free.shape[1]
    free, unknown = np.zeros((height, width), bool), np.ones((height, width), bool)
    grey = np.full((height, width), 205, np.uint8)
    for plan, column in zip(plans, columns, strict=True):
        part = slice(height - plan.free.shape[0], height), slice(column, column + plan.free.shape[1])
        free[part], unknown[part], grey[part] = plan.free, plan.unknown, plan.grey
    corners = origin + np.outer(columns, [resolution, 0])
    offsets = [corner - plan.origin[:2] for corner, plan in zip(corners, plans, strict=True)]
    return Plan(name, free, unknown, grey, resolution, (float(origin[0]), float(origin[1]), 0.0)), offsets


def _finer(plan: Plan, resolution: float) -> Plan:
    """The plan in pixels of this size, which divides its own."""
    factor = round(plan.resolution_m / resolution)
    parts: dict[str, Any] = {
        key: getattr(plan, key).repeat(factor, axis=0).repeat(factor, axis=1) for key in ("free", "unknown", "grey")
    }
    return replace(plan, resolution_m=resolution, **parts)


def _union(
    name: str,
    buildings: Sequence[Building],
    offsets: Sequence[NDArray[np.float64]],
    rides: Sequence[tuple[int, int, float]],
    plan: Plan,
) -> Building:
    """All nodes and corridors, each building moved, and the rides of lifts: from, to, length (m)."""
    first = np.cumsum([0, *(building.n_nodes for building in buildings)])[:-1]
    parts = list(zip(buildings, offsets, first, strict=True))
    width = float(np.median(np.concatenate([building.width_m for building in buildings])))

    def joined(key: str) -> Any:
        return np.concatenate([getattr(building, key) for building in buildings])

    edges = [building.edges + start for building, _, start in parts]
    edges.append(np.array([ride[:2] for ride in rides], np.int64).reshape(-1, 2))
    try:
        return Building(
            name=name,
            kind=joined("kind"),
            feature_class=joined("feature_class"),
            position_m=np.concatenate([building.position_m + offset for building, offset, _ in parts]),
            area_m2=joined("area_m2"),
            obstacles=joined("obstacles"),
            edges=np.concatenate(edges),
            length_m=np.concatenate([joined("length_m"), [ride[2] for ride in rides]]),
            width_m=np.concatenate([joined("width_m"), np.full(len(rides), width)]),
            course_m=(
                *(course + offset for building, offset, _ in parts for course in building.course_m),
                *(np.zeros((0, 2)) for _ in rides),
            ),
            start=choose_start(name, buildings[0].kind, buildings[0].position_m, None),
            provenance={"source": name, "resolution_m": plan.resolution_m},
        )
    except TaskliftError as error:
        raise TaskliftError(f"{name}: its lifts do not join the levels ({error})") from error
