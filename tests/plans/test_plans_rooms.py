"""Rooms are what walls and doors close: with several doors, with tables, open wide, drawn with door leaves, turned."""

from __future__ import annotations

import numpy as np
import pytest
import shapely
from shapely import affinity

from tasklift.building.graph import DOOR, ROOM, Building
from tasklift.plans.extract.building import extract
from tasklift.plans.plan import Plan

CELL_M = 0.05
TURNS = (0, 90, 17, 38)


def box(x: float, y: float, to_x: float, to_y: float) -> shapely.Geometry:
    return shapely.box(x, y, to_x, to_y)


def drawn(
    free: shapely.Geometry, turn: float = 0.0, outside: int = 205, cell_m: float = CELL_M, margin: float = 1.0,
    entrance: shapely.Geometry | None = None,
) -> Plan:  # fmt: skip
    """A plan of a floor, turned; walls of 15 cm around it, ``outside`` is the grey of all else."""
    from PIL import Image, ImageDraw

    free = affinity.rotate(free.buffer(0.002, join_style="mitre"), turn, origin=(0, 0))  # no cracks between boxes
    low, high = np.array(free.bounds[:2]) - margin, np.array(free.bounds[2:]) + margin
    width, height = np.ceil((high - low) / cell_m).astype(int).tolist()
    image = Image.new("L", (width, height), outside)
    pen = ImageDraw.Draw(image)

    def fill(shape: shapely.Geometry, inner: int, outer: int) -> None:
        for polygon in getattr(shape, "geoms", [shape]):
            for ring, colour in [(polygon.exterior, inner), *((hole, outer) for hole in polygon.interiors)]:
                at = (np.asarray(ring.coords) - low) / cell_m
                pen.polygon([(x - 0.5, height - y - 0.5) for x, y in at.tolist()], fill=colour)

    fill(free.buffer(0.15, join_style="mitre"), 0, outside)
    fill(free, 254, 0)
    if entrance is not None:
        fill(affinity.rotate(entrance, turn, origin=(0, 0)), outside, outside)
    grey = np.asarray(image)
    return Plan("drawn", grey == 254, grey == 205, grey, cell_m, (float(low[0]), float(low[1]), 0.0))


def office(
    door_m: float = 1.0, table: tuple[float, float] | None = None, rooms: int = 3, width: float = 4.0,
    depth: float = 4.0, corridor_m: float = 2.2, wall_m: float = 0.2,
) -> shapely.Geometry:  # fmt: skip
    """Rooms on both sides of a corridor along x, each with a door or opening in its middle, perhaps with a table."""
    length = rooms * (width + wall_m) - wall_m
    floor = [box(0, 0, length, corridor_m)]
    tables = []
    for i in range(rooms):
        x = i * (width + wall_m)
        middle = x + width / 2
        for y, gap in ((corridor_m + wall_m, corridor_m), (-wall_m - depth, -wall_m)):
            floor += [box(x, y, x + width, y + depth), box(middle - door_m / 2, gap, middle + door_m / 2, gap + wall_m)]
            if table:
                half = np.array(table) / 2
                at = np.array([middle, y + depth / 2])
                tables.append(box(*(at - half), *(at + half)))
    return shapely.union_all(floor).difference(shapely.union_all(tables))


def areas(building: Building) -> list[float]:
    return sorted(building.area_m2[building.kind == ROOM].tolist())


def doors(building: Building) -> int:
    return int((building.feature_class == DOOR).sum())


@pytest.mark.parametrize("turn", TURNS)
@pytest.mark.parametrize("size", [(4.0, 4.0), (3.0, 5.0), (6.0, 3.5)])
def test_rooms_with_one_door(turn: float, size: tuple[float, float]) -> None:
    building, _ = extract(drawn(office(width=size[0], depth=size[1]), turn))
    assert np.allclose(areas(building), [size[0] * size[1]] * 6, rtol=0.1)
    assert doors(building) == 6


@pytest.mark.parametrize("turn", TURNS)
@pytest.mark.parametrize("size", [(3.6, 4.5), (5.0, 4.0), (3.4, 6.0)])
def test_rooms_between_two_corridors_have_two_doors(turn: float, size: tuple[float, float]) -> None:
    width, depth = size
    end = 3 * width + 0.6
    floor = [box(0, 0, end, 2.4), box(0, depth + 2.8, end, depth + 5.2)]
    floor.append(box(end, 0, end + 2.4, depth + 5.2))  # the two corridors meet
    for i in range(3):
        x = i * (width + 0.2)
        floor += [box(x, 2.6, x + width, depth + 2.6)]
        floor += [box(x + width / 2 - 0.5, y, x + width / 2 + 0.5, y + 0.2) for y in (2.4, depth + 2.6)]
    building, _ = extract(drawn(shapely.union_all(floor), turn))
    assert np.allclose(areas(building), [width * depth] * 3, rtol=0.1)
    assert doors(building) == 6


@pytest.mark.parametrize("turn", TURNS)
@pytest.mark.parametrize("doors_at", [(1.0, 9.0), (0.8, 5.0), (2.0, 8.0)])
def test_a_long_room_with_two_doors_to_one_corridor(turn: float, doors_at: tuple[float, float]) -> None:
    floor = [box(0, 0, 10, 2.2), box(0, 2.4, 10, 5.4), box(0, -4.2, 4, -0.2), box(1.5, -0.2, 2.5, 0)]
    floor += [box(x - 0.5, 2.2, x + 0.5, 2.4) for x in doors_at]
    building, _ = extract(drawn(shapely.union_all(floor), turn))
    assert np.allclose(areas(building), [16, 30], rtol=0.1)
    assert doors(building) == 3


@pytest.mark.parametrize("turn", TURNS)
@pytest.mark.parametrize("table", [(3.0, 1.2), (1.2, 2.2), (2.2, 2.2)])
def test_a_table_is_an_obstacle(turn: float, table: tuple[float, float]) -> None:
    plan = drawn(office(table=table, width=5.5, depth=5.0), turn)
    building, _ = extract(plan)
    assert np.allclose(areas(building), [27.5] * 6, rtol=0.1)
    assert doors(building) == 6
    assert building.obstacles[building.kind == ROOM].tolist() == [1] * 6
    nodes = np.floor(plan.to_pixels(building.position_m)).astype(int)
    assert plan.free[tuple(nodes.T)].all()  # no room's node is on its table


# the widest ones are found in upright drawings only
@pytest.mark.parametrize(
    ("opening", "turn"),
    [(1.6, 0), (1.6, 17), (1.6, 38), (2.2, 0), (2.2, 17), (2.2, 38), (2.2, 90), (2.5, 0), (2.8, 90)],
)
@pytest.mark.parametrize("corridor", [2.0, 2.4])
def test_rooms_end_at_wide_openings(turn: float, opening: float, corridor: float) -> None:
    building, _ = extract(drawn(office(door_m=opening, corridor_m=corridor), turn))
    assert np.allclose(areas(building), [16] * 6, rtol=0.12)


@pytest.mark.parametrize(("turn", "cell", "ink"), [(0, 0.02, 0), (180, 0.03, 120), (17, 0.02, 0), (38, 0.03, 120)])
def test_leaves_and_arcs_of_doors_are_opened(turn: float, cell: float, ink: int) -> None:
    """Thin lines, black or of the grey that smoothing makes of them."""
    from PIL import Image, ImageDraw

    plan = drawn(office(), turn, outside=254, cell_m=cell, margin=2.0)
    image = Image.fromarray(plan.grey)
    pen = ImageDraw.Draw(image)
    for i in range(3):
        for y, side in ((2.4, 1), (-0.2, -1)):
            hinge = np.array([i * 4.2 + 1.5, y])
            angle = np.linspace(0, np.pi / 2, 30)
            arc = hinge + np.column_stack([np.cos(angle), side * np.sin(angle)])
            points = np.concatenate([arc, [hinge]])
            c, s = np.cos(np.radians(turn)), np.sin(np.radians(turn))
            at = plan.to_pixels(points @ np.array([[c, s], [-s, c]]))
            pen.line([(x, y) for y, x in at.tolist()], fill=ink)
    grey = np.asarray(image)
    closed = Plan("cad", grey > 200, grey == 120, grey, cell, plan.origin)
    building, doubts = extract(closed)
    assert np.allclose(areas(building), [16] * 6, rtol=0.12)
    assert doors(building) == 6
    assert any("leaves and arcs of doors" in doubt for doubt in doubts)


@pytest.mark.parametrize("turn", [0, 90, 270])
def test_the_outdoors_is_cut_at_the_entrance(turn: float) -> None:
    building, doubts = extract(drawn(office(), turn, 254, margin=3.0, entrance=box(-0.3, 0.6, 0.1, 1.6)))
    assert np.allclose(areas(building), [16] * 6, rtol=0.1)
    assert doors(building) == 7
    assert any("taken for the outdoors" in doubt for doubt in doubts)
    assert np.hypot(*building.position_m.T).max() < 16


@pytest.mark.parametrize("turn", [0, 30])
@pytest.mark.parametrize("joined", [False, True])
def test_rays_through_windows_are_not_rooms(turn: float, joined: bool) -> None:
    """Fans of floor beyond the windows of two rooms, apart or grown into one."""
    from skimage.draw import polygon

    plan = drawn(office(), turn)
    free, unknown, grey = (
        np.pad(values, 60, constant_values=fill)
        for values, fill in ((plan.free, False), (plan.unknown, True), (plan.grey, 205))
    )
    grown = Plan("x", free, unknown, grey, CELL_M, (plan.origin[0] - 3, plan.origin[1] - 3, 0.0))
    c, s = np.cos(np.radians(turn)), np.sin(np.radians(turn))
    fan = np.array([[1.2, 6.3], [2.8, 6.3], [2.8, 6.7], [3.3, 9.0], [2.0, 8.0], [1.2, 9.2], [1.2, 6.7]])
    bridge = [np.array([[2.5, 7.0], [5.7, 7.0], [5.7, 8.0], [2.5, 8.0]])]
    for shape in (fan, np.add(fan, [4.2, 0]), *(bridge if joined else [])):
        rows, columns = polygon(*grown.to_pixels(shape @ np.array([[c, s], [-s, c]])).T, free.shape)
        free[rows, columns], unknown[rows, columns] = True, False
    building, doubts = extract(grown)
    assert np.allclose(areas(building), [16] * 6, rtol=0.12)
    assert any("rays through windows" in doubt for doubt in doubts)


def test_floor_of_a_map_without_walls_is_no_ray() -> None:
    """Only free and unknown: such maps are floor all the same."""
    plan = drawn(office())
    bare = Plan("bare", plan.free, ~plan.free, plan.grey, CELL_M, plan.origin)
    building, doubts = extract(bare)
    assert np.allclose(areas(building), [16] * 6, rtol=0.12)
    assert not any("rays" in doubt for doubt in doubts)
