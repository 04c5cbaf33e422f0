"""Levels of an open-rmf building as one building, joined by lifts."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
from click.testing import CliRunner

from tasklift.building.graph import OTHER, ROOM, Building
from tasklift.cli.plans import map_group
from tasklift.errors import TaskliftError
from tasklift.plans.check import check
from tasklift.plans.edits import apply_edits, parse_edits
from tasklift.plans.floor import unpack
from tasklift.plans.importing import import_map


def level(turn: float, lifts: dict[str, bool], height: float) -> dict[str, object]:
    """A corridor with a room on each side; lifts at its ends are rooms that open to it, or shafts without floor."""
    points: list[tuple[float, float]] = []
    options: dict[int, dict[str, object]] = {}

    def point(x: float, y: float) -> int:
        points.append((x, y))
        return len(points) - 1

    def box(x: float, y: float, to_x: float, to_y: float) -> list[int]:
        return [point(x, y), point(to_x, y), point(to_x, to_y), point(x, to_y)]

    areas = [box(0, 0, 12, 2), box(2, 2, 8, 6), box(4, -5, 10, 0)]
    doors = [(point(3, 2), point(4, 2)), (point(8, 0), point(9, 0))]
    lanes = []
    for name, is_shaft in lifts.items():
        x, way = (-2.2, 1.0) if name == "West" else (12.0, 11.0)
        if not is_shaft:
            areas.append(box(x, -0.1, x + 2.2, 2.1))
            doors.append((point(12 * (name == "East"), 0.5), point(12 * (name == "East"), 1.5)))
        cabin = point(x + 1.1, 1.0)
        options[cabin] = {"lift_cabin": [1, name]}
        lanes.append([point(way, 1.0), cabin])
    walls = []
    for area in areas:
        for a, b in zip(area, [*area[1:], area[0]], strict=True):
            # a wall ends at the doors on it
            on = sorted(
                (d for d in doors for d in d if _between(points[a], points[d], points[b])),
                key=lambda d: np.hypot(*np.subtract(points[d], points[a])),
            )
            stops = [a, *on, b]
            walls += [stops[i : i + 2] for i in range(0, len(stops), 2)]
    c, s = np.cos(np.radians(turn)), np.sin(np.radians(turn))
    return {
        "elevation": height,
        "vertices": [[c * x - s * y, s * x + c * y, 0, "", options.get(i, {})] for i, (x, y) in enumerate(points)],
        "walls": walls,
        "doors": doors,
        "lanes": lanes,
        "floors": [{"vertices": area} for area in areas],
    }


def _between(a: tuple[float, float], p: tuple[float, float], b: tuple[float, float]) -> bool:
    whole = np.hypot(*np.subtract(a, b))
    return abs(np.hypot(*np.subtract(a, p)) + np.hypot(*np.subtract(p, b)) - whole) < 1e-9


def written(folder: Path, turn: float, levels: dict[str, tuple[dict[str, bool], float]]) -> Path:
    path = folder / "tower.building.yaml"
    content = {name: level(turn, *parts) for name, parts in levels.items()}
    path.write_text(json.dumps({"coordinate_system": "cartesian_meters", "levels": content}))
    return path


# For each level its lifts, whether they are shafts, and its height (m)
TOWER = {
    "two": ({"West": True}, 8.0),
    "ground": ({"West": False, "East": False}, 0.0),
    "one": ({"West": True, "East": False}, 4.0),
}


def rides(building: Building) -> list[tuple[str, str, float]]:
    names = building.provenance["names"]
    ends = ((names.get(str(a)), names.get(str(b))) for a, b in building.edges.tolist())
    return sorted((a, b, length) for (a, b), length in zip(ends, building.length_m.tolist(), strict=True) if a and b)


@pytest.mark.parametrize("turn", [0, 17, 90])
def test_three_levels_and_two_lifts(tmp_path: Path, turn: float) -> None:
    path = written(tmp_path, turn, TOWER)
    building, doubts = import_map(path, levels=[])
    assert not doubts
    assert np.allclose(sorted(building.area_m2[building.kind == ROOM]), [24] * 3 + [30] * 3, rtol=0.06)
    assert rides(building) == [
        ("East ground", "East one", 24.0), ("West ground", "West one", 24.0), ("West one", "West two", 24.0),
    ]  # fmt: skip
    lifts = [int(node) for node in building.provenance["names"]]
    assert (building.feature_class[lifts] == OTHER).all()
    assert building.n_edges == building.n_nodes  # two lifts between two levels are the one loop
    assert check(building).warnings == ()
    # the lowest level lies where it lies alone, and the plan beneath all levels is theirs
    alone, _ = import_map(path, level="ground")
    rooms = building.position_m[building.kind == ROOM]
    for room in alone.position_m[(alone.kind == ROOM) & (alone.area_m2 > 10)]:
        assert np.hypot(*(rooms - room).T).min() < 0.01
    plan = unpack(building)
    assert plan is not None
    assert plan.free[tuple(np.floor(plan.to_pixels(rooms)).astype(int).T)].all()


def test_some_levels_on_the_command_line(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    path = written(tmp_path, 0, TOWER)

    def run(*arguments: str) -> str:
        return CliRunner().invoke(map_group, list(arguments), catch_exceptions=False).output

    text = run("import", str(path), "--levels", "one, ground", "--start", "5,4")
    assert "4 rooms" in text
    building = Building.load("tower.json")
    assert np.allclose(building.position_m[building.start], [5, 4], atol=0.1)
    assert "looks wrong nothing" in run("check", "tower.json")
    assert "wrote" in run("export", "tower.json", "tower.geojson")
    for arguments in (("--level", "one", "--levels", "all"), ("--levels", "one,two", "--seed-point", "1,1")):
        with pytest.raises((TaskliftError, AssertionError)):
            assert "wrote" in run("import", str(path), *arguments, "--force")


def test_levels_that_nothing_joins(tmp_path: Path) -> None:
    path = written(tmp_path, 0, TOWER | {"attic": ({"East": True}, 12.0)})
    with pytest.raises(TaskliftError, match="its lifts do not join the levels"):
        import_map(path, levels=["two", "attic"])
    with pytest.raises(TaskliftError, match="has no level 'cellar'"):
        import_map(path, levels=["ground", "cellar"])
    with pytest.raises(TaskliftError, match="of an open-rmf building only"):
        import_map(Path(__file__).parent / "samples" / "osm" / "rooms.osm", levels=[])


def test_names_and_rides_outlive_edits(tmp_path: Path) -> None:
    building, _ = import_map(written(tmp_path, 0, TOWER), levels=[])
    between = (building.degree == 2) & (building.kind != ROOM)
    between[[int(node) for node in building.provenance["names"]]] = False
    dropped = int(np.flatnonzero(between)[0])
    edited, _ = apply_edits(building, parse_edits(f"tasklift-edits 1\ndrop node {dropped}"))
    assert rides(edited) == rides(building)
    assert check(edited).warnings == ()


def test_a_drawing_that_is_missing_does_not_matter_the_second_time(tmp_path: Path) -> None:
    path = written(tmp_path, 0, TOWER)
    content = json.loads(path.read_text())
    content["levels"]["one"]["drawing"] = {"filename": "nowhere.png"}
    path.write_text(json.dumps(content))
    for _ in range(2):
        import_map(path, tmp_path / "tower.json", level="one")
