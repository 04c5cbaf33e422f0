"""Where things come to lie: junctions on the axes of corridors, rooms between their walls, bends before doors."""

from __future__ import annotations

import math
import re

import numpy as np
import pytest
import shapely
from hypothesis import assume, given, settings
from hypothesis import strategies as st
from plans_measure import counts
from scipy import ndimage

from tasklift.building.graph import BEND, CORNER, DOOR, INTERSECTION, ROOM, Building
from tasklift.errors import TaskliftError
from tasklift.plans.extract.axes import turn_before_door
from tasklift.plans.extract.building import extract
from tasklift.plans.extract.paths import Node
from tasklift.plans.extract.space import Settings, Space, clean, to_wall
from tasklift.plans.plan import Plan
from tasklift.plans.raster import rasterise_floor

CELL_M = 0.05
EXAMPLES = settings(derandomize=True, deadline=None, max_examples=40)


def plan_of(floor: shapely.Geometry) -> Plan:
    return rasterise_floor("drawn", floor, CELL_M)


def plan_from(free: np.ndarray, cell_m: float) -> Plan:
    grey = np.where(free, 254, 0).astype(np.uint8)
    return Plan("drawn", free, np.zeros_like(free), grey, cell_m, (0.0, 0.0, 0.0))


def corridor(points: list[tuple[float, float]], width: float) -> shapely.Geometry:
    return shapely.LineString(points).buffer(width / 2, cap_style="flat", join_style="mitre")


def box(x: float, y: float, to_x: float, to_y: float) -> shapely.Geometry:
    return shapely.box(x, y, to_x, to_y)


def nearest_m(building: Building, point: tuple[float, float], kinds: np.ndarray) -> float:
    return float(np.hypot(*(building.position_m[kinds] - point).T).min(initial=np.inf))


def turns(building: Building) -> np.ndarray:
    return np.isin(building.feature_class, (BEND, CORNER))


# -- axes --------------------------------------------------------------------------------------------

# a corridor that opens into one far wider opens into a room
WIDTHS = st.sampled_from([(1.2, 1.6), (1.8, 2.4), (2.4, 1.8), (2.4, 3.0), (3.0, 2.2), (1.8, 1.8)])


@given(WIDTHS, st.floats(50, 130))
@EXAMPLES
def test_a_bend_lies_where_the_axes_of_unequal_corridors_meet(widths: tuple[float, float], degrees: float) -> None:
    first, second = widths
    away = (16 * math.cos(math.radians(degrees)), 16 * math.sin(math.radians(degrees)))
    floor = shapely.union_all([corridor([(0, 0), (-16, 0)], first), corridor([(0, 0), away], second)])
    # what the corner of such a floor is made of, a wedge between two corridors that end square
    floor = floor.union(shapely.Point(0, 0).buffer(min(first, second) / 2))
    building, _ = extract(plan_of(floor))
    assert nearest_m(building, (0, 0), turns(building)) < 0.3


@given(WIDTHS, st.floats(50, 130))
@EXAMPLES
def test_a_junction_lies_where_the_axes_meet(widths: tuple[float, float], degrees: float) -> None:
    first, second = widths
    away = (16 * math.cos(math.radians(degrees)), 16 * math.sin(math.radians(degrees)))
    floor = shapely.union_all([corridor([(-16, 0), (16, 0)], first), corridor([(0, 0), away], second)])
    building, _ = extract(plan_of(floor))
    junctions = (building.kind == INTERSECTION) & (building.degree == 3)
    assert nearest_m(building, (0, 0), junctions) < 0.3


@pytest.mark.parametrize("across", [3.6, 4.2, 5.0])
def test_two_bends_with_a_short_corridor_between_them(across: float) -> None:
    """The skeleton cuts straight through the short piece; its walls say where it runs."""
    corners = [(-10.0, 0.0), (0.0, 0.0), (across / 2, across), (10.0, across)]
    building, _ = extract(plan_of(corridor(corners, 2.4)))
    for corner in corners[1:3]:
        assert nearest_m(building, corner, turns(building)) < 0.3


@pytest.mark.parametrize("aside", [2.0, 2.4, 2.8])
def test_a_bend_between_a_door_and_a_corridor_that_soon_turns_back(aside: float) -> None:
    corners = [(0.0, -1.6), (-aside, -5.3), (0.0, -14.0)]
    floor = [box(-3, 0, 3, 4), box(-0.5, -2, 0.5, 0), shapely.Point(corners[0]).buffer(1.2), corridor(corners, 2.4)]
    building, _ = extract(plan_of(shapely.union_all(floor)))
    assert counts(building)[1] == 1
    for corner in corners[:2]:
        assert nearest_m(building, corner, turns(building)) < 0.4


def test_a_door_that_looks_along_its_corridor_has_no_bend_before_it() -> None:
    floor = shapely.union_all([box(-3, 0, 3, 4), box(-0.5, -1, 0.5, 0), corridor([(0, -1), (0, -15)], 2.4)])
    building, _ = extract(plan_of(floor))
    assert counts(building)[:2] == (1, 1)
    assert not turns(building).any()


def test_no_turn_before_what_is_no_door() -> None:
    space = clean(plan_of(corridor([(0, 0), (8, 0)], 2)), Settings())
    line = np.column_stack([np.full(50, 40.0), np.arange(20.0, 70.0)])
    assert turn_before_door(Node((40.0, 20.0), 1.0, "path"), line, space) is None


def test_a_way_around_is_as_long_as_it_is_though_its_ends_see_each_other() -> None:
    ring = shapely.box(0, 0, 14, 14).exterior.buffer(1, join_style="mitre")
    building, _ = extract(plan_of(shapely.union_all([ring, corridor([(14, 7), (30, 7)], 2), box(30, 3, 36, 11)])))
    assert counts(building)[2] == 1
    on_ring = building.position_m[building.edges].max(axis=(1, 2)) < 15
    assert building.length_m[on_ring].sum() == pytest.approx(4 * 14, rel=0.03)


# -- rooms -------------------------------------------------------------------------------------------


@given(st.sampled_from([2.4, 3.0, 3.4]), st.floats(4.2, 6.0), st.floats(4.5, 7.0))
@EXAMPLES
def test_a_room_ends_at_the_gap_in_its_wall(gap: float, width: float, depth: float) -> None:
    """The gap is wider than the corridor: no piece of the corridor belongs to the room."""
    assume(gap < 0.65 * width)  # a wider one makes the room a bay
    wall = 0.2
    floor = shapely.union_all(
        [
            corridor([(-20, 0), (20, 0)], 2.0),
            box(-gap / 2, 0.9, gap / 2, 1 + wall + 0.1),
            box(-width / 2, 1 + wall, width / 2, 1 + wall + depth),
        ]
    )
    building, _ = extract(plan_of(floor))
    rooms = np.flatnonzero(building.kind == ROOM)
    assert len(rooms) == 1
    assert building.area_m2[rooms[0]] == pytest.approx(width * depth, rel=0.06)
    middle = (0.0, 1 + wall + depth / 2)
    assert np.hypot(*(building.position_m[rooms[0]] - middle)) < 0.3
    assert building.degree[rooms[0]] == 1
    assert nearest_m(building, (0, 0), building.kind == INTERSECTION) < 0.4


ROOM_BY_THE_WAY = [box(-2.5, 1.2, 2.5, 6.2), box(-1, 0.9, 1, 1.3)]


def test_a_wide_gap_that_a_corridor_passes_is_a_door() -> None:
    building, _ = extract(plan_of(shapely.union_all([*ROOM_BY_THE_WAY, corridor([(-20, 0), (20, 0)], 2.0)])))
    assert counts(building) == (1, 1, 0)
    assert nearest_m(building, (0, 1.1), building.feature_class == DOOR) < 0.3


def test_a_corridor_that_begins_in_a_room_has_no_door_there() -> None:
    way = corridor([(0, 1.2), (0, -20)], 2.0)
    building, _ = extract(plan_of(shapely.union_all([*ROOM_BY_THE_WAY, way, corridor([(-9, -15), (9, -15)], 2.0)])))
    assert counts(building) == (1, 0, 0)


def test_narrow_passages_are_closed_unless_one_asks_for_them() -> None:
    rooms = [box(0, 0, 5, 5), box(5.2, 0, 10, 5), box(4.9, 2, 5.3, 2.4)]
    plan = plan_of(shapely.union_all(rooms))
    building, _ = extract(plan, Settings(narrowest_m=0.4))
    assert counts(building) == (2, 1, 0)
    # the passage is but as deep as the wall, and closed all the same
    with pytest.raises(TaskliftError, match="a single room"):
        extract(plan, Settings(narrowest_m=0.6))


# -- outlines ----------------------------------------------------------------------------------------


def space_of(floor: shapely.Geometry) -> tuple[Space, Plan]:
    plan = plan_of(floor)
    return clean(plan, Settings()), plan


@given(st.floats(0, 89), st.floats(4, 9), st.floats(4, 9))
@EXAMPLES
def test_the_outline_of_a_turned_box_has_its_four_walls(turn: float, width: float, height: float) -> None:
    floor = shapely.affinity.rotate(box(0, 0, width, height), turn)
    space = space_of(floor)[0]
    outline = space.outline
    assert outline.length.sum() * CELL_M == pytest.approx(2 * (width + height), rel=0.1)
    long = outline.length * CELL_M > 1.5
    angle = np.degrees(np.arctan2(-outline.ahead[long, 0], outline.ahead[long, 1])) - turn
    assert np.abs((angle + 45) % 90 - 45).max() < 4
    # the floor is where the walls say that it is
    inside = outline.middle[long] + 4 * outline.inward[long]
    assert space.free[tuple(np.rint(inside).astype(int).T)].all()


def test_a_gap_runs_from_the_end_of_a_wall_to_the_next() -> None:
    floor = box(0, 0, 10, 8).difference(box(0, 3.9, 4, 4.1)).difference(box(7, 3.9, 10, 4.1))
    space, plan = space_of(floor)
    gaps = list(space.outline.gaps(space.half_width_m / space.cell_m, 0.5 / CELL_M, 5 / CELL_M))
    ends = [np.sort(plan.to_world(*space.to_plan(gap[[0, -1]].astype(float)).T), axis=0) for gap in gaps]
    across = [end for end in ends if np.ptp(end[:, 1]) < 0.3]
    assert across
    for end in across:
        assert end[:, 0] == pytest.approx([4, 7], abs=0.2)
        assert end[:, 1] == pytest.approx([4, 4], abs=0.2)


@given(st.integers(0, 10_000), st.floats(0.3, 0.9))
@EXAMPLES
def test_distances_are_those_of_scipy(seed: int, share: float) -> None:
    free = np.random.default_rng(seed).random((40, 50)) < share
    free[0, 0] = False
    assert np.allclose(to_wall(free), ndimage.distance_transform_edt(free), rtol=1e-6)


# -- anything ----------------------------------------------------------------------------------------


PICTURES = st.sampled_from(["boxes", "noise", "turned", "clouds"])


@given(st.integers(0, 2**32), PICTURES, st.sampled_from([0.03, 0.05, 0.2]))
@settings(derandomize=True, deadline=None, max_examples=150)
def test_any_picture_gives_a_building_or_one_clear_line(seed: int, kind: str, cell_m: float) -> None:
    rng = np.random.default_rng(seed)
    shape = tuple(int(v) for v in rng.integers(20, 200, 2))
    free = np.zeros(shape, bool)
    if kind == "clouds":
        free = ndimage.gaussian_filter(rng.random(shape), rng.uniform(1, 8)) > 0.5
    for value, most in ((True, 120), (False, 8)):
        for _ in range(int(rng.integers(1, 14))):
            row, column = (int(rng.integers(0, n)) for n in shape)
            height, width = (int(v) for v in rng.integers(1, most, 2))
            free[row : row + height, column : column + width] = value
    if kind == "noise":
        free ^= rng.random(shape) < 0.01
    if kind == "turned":
        free = ndimage.rotate(free.astype(float), float(rng.uniform(0, 90)), order=0) > 0.5
    said = ""
    try:
        extract(plan_from(free, cell_m))
    except TaskliftError as error:
        said = str(error)
    assert not said or re.match("drawn: (no free space|the free space is a single room)", said)
