"""DXF and OpenStreetMap as people draw: six rooms on a corridor in several styles, turned, mirrored, in other units."""

from __future__ import annotations

import itertools
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
import shapely

from tasklift.building.graph import DOOR, ROOM, Building
from tasklift.errors import TaskliftError
from tasklift.plans.check import node_lines
from tasklift.plans.importing import import_map

Points = np.ndarray
DOOR_M = 0.9
# Styles with both faces of walls, 20 cm apart
THICK = ("outlines", "two faces", "double leaves", "entrance")
# Three rooms of 4 x 4 m on both sides of a corridor that is 2 m wide; walls are lines between them.
ROOMS = [(4.0 * i, y, 4.0 * i + 4, y + 4.0) for y in (2.0, -4.0) for i in range(3)]
CORRIDOR = (0.0, 0.0, 12.0, 2.0)
DOORS = [(np.array([4.0 * i + 1.5, y]), side) for y, side in ((2.0, 1), (0.0, -1)) for i in range(3)]  # hinge, swing


def turned(degrees: float, mirrored: bool = False) -> Callable[[Points], Points]:
    c, s = np.cos(np.radians(degrees)), np.sin(np.radians(degrees))
    matrix = np.array([[c, s], [-s, c]]) * ([[-1], [1]] if mirrored else 1)
    return lambda points: np.asarray(points, float).reshape(-1, 2) @ matrix


def outline(x: float, y: float, to_x: float, to_y: float, inset: float = 0.0) -> Points:
    x, y, to_x, to_y = x + inset, y + inset, to_x - inset, to_y - inset
    return np.array([[x, y], [to_x, y], [to_x, to_y], [x, to_y], [x, y]])


def with_gaps(walls: list[Points]) -> list[Points]:
    """Walls open where the doors are."""
    doors = shapely.union_all([shapely.LineString([h, np.add(h, (DOOR_M, 0))]).buffer(1e-6) for h, _ in DOORS])
    parts = shapely.get_parts(shapely.difference(shapely.multilinestrings(walls), doors))
    return [shapely.get_coordinates(part) for part in parts]


def leaf_and_arc(hinge: Points, swing: int) -> tuple[Points, Points]:
    angle = np.linspace(0, np.pi / 2, 12)
    arc = hinge + DOOR_M * np.column_stack([np.cos(angle), swing * np.sin(angle)])
    return np.array([hinge, arc[-1]]), arc


def imported(tmp_path: Path, style: str, turn: float, mirrored: bool = False, unit: float = 1.0) -> Building:
    """The building of a drawing in a style; ``unit``: units per metre."""
    import ezdxf

    move = turned(turn, mirrored)
    drawing = ezdxf.new(units=6 if unit == 1 else 4)
    space = drawing.modelspace()

    def line(points: Points, layer: str, into: object = space) -> None:
        into.add_lwpolyline((move(points) * unit).tolist(), dxfattribs={"layer": layer})

    plain = style == "one layer"
    inset = 0.1 if style in THICK else 0.0
    walls = [outline(*box, inset=inset) for box in (*ROOMS, CORRIDOR)]
    if style in ("gaps", "one layer"):
        walls = with_gaps(walls)
    elif style == "entrance":
        frame = shapely.difference(shapely.LineString(outline(-0.1, -4.1, 12.1, 6.1)), shapely.box(-0.2, 0.5, 0.2, 1.5))
        inner = shapely.difference(shapely.LineString(walls.pop()), shapely.box(-0.2, 0.5, 0.2, 1.5))
        walls += [shapely.get_coordinates(part) for part in shapely.get_parts([frame, inner])]
    elif style in THICK:
        walls.append(outline(-0.1, -4.1, 12.1, 6.1))
    for wall in walls:
        line(wall, "0" if plain else "Raum" if style == "outlines" else "A-WALL")
    line(outline(1, 4, 3, 5), "A-FURN")
    for i, (hinge, swing) in enumerate(DOORS):
        leaf, arc = leaf_and_arc(hinge, swing)
        if style == "lines in walls":
            line(np.array([hinge, np.add(hinge, (DOOR_M, 0))]), "Türen")
        elif style == "double leaves":
            for side, post in ((1, hinge), (-1, np.add(hinge, (DOOR_M, 0)))):
                line(post + (arc - hinge) * (side / 2, 0.5), "A-DOOR")
        elif style in ("two faces", "lines"):
            block = drawing.blocks.new(f"DOOR_{i}")  # named so; its entities and its layer are 0
            for points in (leaf, arc):
                line(points, "0", block)
            space.add_blockref(f"DOOR_{i}", (0, 0))
        else:
            for points in (leaf, arc):
                line(points, "0" if plain else "A-DOOR")
    path = tmp_path / "house.dxf"
    drawing.saveas(path)
    return import_map(path)[0]


def check(building: Building, area_m2: float, doors: int = 6) -> None:
    rooms = building.area_m2[building.kind == ROOM]
    assert len(rooms) == 6
    assert np.allclose(rooms, area_m2, rtol=0.08)
    assert int((building.feature_class == DOOR).sum()) == doors


@pytest.mark.parametrize("style", ["gaps", "one layer", "lines", "lines in walls", *THICK])
@pytest.mark.parametrize(("turn", "mirrored", "unit"), [(90, True, 1), (17, False, 1000)])
def test_styles_of_drawings(tmp_path: Path, style: str, turn: float, mirrored: bool, unit: float) -> None:
    check(imported(tmp_path, style, turn, mirrored, unit), 14.2 if style in THICK else 15.5, 6 + (style == "entrance"))


def test_layers_that_the_user_names(tmp_path: Path) -> None:
    """Walls on a layer that no language calls so, beside others that no wall is on; hidden layers do not count."""
    import ezdxf

    drawing = ezdxf.new(units=6)
    for wall in with_gaps([outline(*box) for box in (*ROOMS, CORRIDOR)]):
        drawing.modelspace().add_lwpolyline(wall.tolist(), dxfattribs={"layer": "P-17"})
    for x in np.arange(0.3, 12.0, 0.4).tolist():
        for layer in ("Lines", "Hidden"):
            drawing.modelspace().add_line((x, -6), (x, 8), dxfattribs={"layer": layer})
    drawing.layers.add("Hidden").off()
    path = tmp_path / "house.dxf"
    drawing.saveas(path)
    for layers in (None, "Lines"):
        with pytest.raises(TaskliftError, match=r"close no floor; name the layers of walls with --level"):
            import_map(path, level=layers)
    with pytest.raises(TaskliftError, match=r"no lines on layer 'hidden'; its layers are 'Lines', 'P-17'"):
        import_map(path, level="hidden,P-17")
    check(import_map(path, level="p-17")[0], 15.5)


class Map:
    """OpenStreetMap XML in the making; places are metres, turned, in the far north."""

    def __init__(self, turn: float):
        self.move = turned(turn)
        self.nodes: dict[tuple[float, float], tuple[int, dict[str, str]]] = {}
        self.body = ""
        self.ways = 0

    def node(self, x: float, y: float, **tags: str) -> int:
        number, known = self.nodes.setdefault((round(x, 3), round(y, 3)), (len(self.nodes) + 1, {}))
        known.update(tags)
        return number

    def way(self, points: Points, doors: list[Points] = (), /, **tags: str) -> int:
        """An outline with its doors' nodes where they lie on it."""
        refs = []
        for start, end in itertools.pairwise(points):
            low, high = sorted((start[0], end[0]))
            on = [d for d in doors if start[1] == end[1] == d[1] and low < d[0] < high]
            refs += [self.node(*p) for p in [start, *sorted(on, key=lambda d: np.hypot(*(d - start)))]]
        refs.append(self.node(*points[-1]))
        self.ways += 1
        self.body += f'<way id="{self.ways}">' + "".join(f'<nd ref="{r}"/>' for r in refs) + _tags(tags) + "</way>"
        return self.ways

    def relation(self, members: list[tuple[int, str]], **tags: str) -> None:
        listed = "".join(f'<member type="way" ref="{way}" role="{role}"/>' for way, role in members)
        self.body += f'<relation id="1">{listed}{_tags(tags)}<tag k="type" v="multipolygon"/></relation>'

    def save(self, path: Path) -> Path:
        nodes = ""
        for (x, y), (number, tags) in self.nodes.items():
            east, north = self.move((x, y))[0] / 111_195
            at = f'lat="{60 + north:.9f}" lon="{10 + east / np.cos(np.radians(60)):.9f}"'
            nodes += f'<node id="{number}" {at}>{_tags(tags)}</node>'
        path.write_text(f'<?xml version="1.0"?><osm version="0.6">{nodes}{self.body}</osm>')
        return path


def _tags(tags: dict[str, str]) -> str:
    return "".join(f'<tag k="{key}" v="{value}"/>' for key, value in tags.items())


@pytest.mark.parametrize("turn", [17, 90])
@pytest.mark.parametrize("style", ["shared", "apart", "door on one side", "corridor in pieces"])
def test_indoor_tagging(tmp_path: Path, style: str, turn: float) -> None:
    """Outlines that share walls and door nodes; outlines 20 cm apart with a door on both or on the room's; levels."""
    drawn = Map(turn)
    inset = 0.0 if style in ("shared", "corridor in pieces") else 0.1
    room_doors = [np.add(hinge, (DOOR_M / 2, swing * inset)) for hinge, swing in DOORS]
    corridor_doors = [np.add(hinge, (DOOR_M / 2, -swing * inset)) for hinge, swing in DOORS]
    if style == "door on one side":
        corridor_doors = []
    for at in (*room_doors, *corridor_doors):
        drawn.node(*at, door="hinged", level="1;2")
    for i, box in enumerate(ROOMS):
        drawn.way(outline(*box, inset=inset), room_doors, indoor="room", level="1-2", name=f"Room {i}")
    x, y, to_x, to_y = CORRIDOR
    for start, end in [(x, 4.0), (4.0, to_x)] if style == "corridor in pieces" else [(x, to_x)]:
        piece = outline(start, y, end, to_y, inset=inset)
        drawn.way(piece, corridor_doors, indoor="corridor", level="0", repeat_on="2")
    drawn.way(outline(0, 0, 3, 3), indoor="room", level="-1")
    path = drawn.save(tmp_path / "house.osm")
    with pytest.raises(TaskliftError, match=r"has the levels '-1', '0', '1', '2'; choose one with --level"):
        import_map(path)
    building, _ = import_map(path, level="2")
    check(building, 14.2 if inset else 15.5)
    names = building.provenance["names"]
    assert sorted(names.values()) == [f"Room {i}" for i in range(6)]
    middles = np.array([building.position_m[int(node)] for node, _ in sorted(names.items(), key=lambda item: item[1])])
    apart = np.hypot(*np.diff(middles, axis=0).T)
    assert np.allclose(apart[[0, 1, 3, 4]], 4, atol=0.3)  # rooms of a row, in their order
    assert any("'Room 3'" in line for line in node_lines(building))


def test_a_corridor_around_a_courtyard_and_a_doorway_without_a_door(tmp_path: Path) -> None:
    drawn = Map(30)
    ring = [(0, 0), (10, 0), (10, 10), (0, 10), (0, 0)]
    halves = [drawn.way(np.array(ring[:3])), drawn.way(np.array(ring[2:]))]
    yard = drawn.way(outline(2, 2, 8, 8))
    drawn.relation([(halves[0], "outer"), (halves[1], "outer"), (yard, "inner")], indoor="corridor", level="0")
    for x, tags in ((2.0, {"door": "yes"}), (7.0, {"door": "no"})):
        drawn.node(x, 10.0, **tags)
        drawn.way(outline(x - 2, 10, x + 2, 14), [np.array([x, 10.0])], indoor="room", level="0")
    building, doubts = import_map(drawn.save(tmp_path / "yard.osm"))
    assert np.allclose(building.area_m2[building.kind == ROOM], 15.5, rtol=0.06)
    assert int((building.feature_class == DOOR).sum()) == 1
    assert building.n_edges == building.n_nodes  # around the courtyard
    assert not doubts


def test_rooms_that_no_door_joins(tmp_path: Path) -> None:
    drawn = Map(0)
    for box in ROOMS:
        drawn.way(outline(*box), indoor="room")
    with pytest.raises(TaskliftError, match=r"no door leads into a room of level .0. \(6 in all\); map doors"):
        import_map(drawn.save(tmp_path / "shut.osm"))
