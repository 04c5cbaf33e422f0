"""Graphs of routes: near no wall, connected, short, and as other programs read them."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import yaml
from click.testing import CliRunner
from hypothesis import given, settings
from hypothesis import strategies as st
from routes_measure import measure
from scipy import ndimage
from test_plans_edits import ladder

from tasklift.building.generate import generate
from tasklift.building.graph import DOOR, ROOM, Building
from tasklift.cli.plans import map_group
from tasklift.errors import TaskliftError
from tasklift.plans.exporting import export
from tasklift.plans.extract.building import extract
from tasklift.plans.floor import Floor, pack, unpack
from tasklift.plans.plan import Plan
from tasklift.plans.raster import rasterise
from tasklift.plans.read import read_map
from tasklift.plans.read.nav2_route import read as read_nav2
from tasklift.plans.routes import routes_of
from tasklift.plans.source import Source


def office(seed: int, resolution_m: float = 0.05, furniture: int = 40, yaw: float = 0.0) -> Plan:
    """A generated building as a plan, with things of 0.2 to 0.8 m standing about in it, turned by ``yaw``."""
    plan = rasterise(generate(seed=seed), resolution_m)
    rng = np.random.default_rng(seed)
    free = plan.free.copy()
    rows, columns = np.nonzero(plan.free)
    for i in rng.integers(len(rows), size=furniture).tolist():
        size = max(1, round(rng.uniform(0.2, 0.8) / resolution_m))
        free[rows[i] : rows[i] + size, columns[i] : columns[i] + size] = False
    grey = np.where(free, plan.grey, np.where(plan.free, 0, plan.grey)).astype(np.uint8)
    return replace(plan, free=free, grey=grey, origin=(*plan.origin[:2], yaw))


@pytest.mark.parametrize(("seed", "resolution_m", "yaw"), [(1, 0.05, 0.0), (2, 0.1, 0.4), (3, 0.05, -2.0)])
def test_the_bars_hold_on_drawn_plans(seed: int, resolution_m: float, yaw: float) -> None:
    plan = office(seed, resolution_m, yaw=yaw)
    building, _ = extract(plan)
    found = measure(routes_of(building, plan), plan, sources=6, targets=40)
    assert (found.pieces, found.near) == (1, 0)
    assert found.found >= 0.99
    assert found.stretch <= 1.05


def test_every_node_of_the_building_is_there_and_near_its_place() -> None:
    building = generate(seed=5)
    routes = routes_of(building, rasterise(building))
    ours = routes.node >= 0
    assert sorted(routes.node[ours].tolist()) == list(range(building.n_nodes))
    moved = np.hypot(*(routes.position_m[ours] - building.position_m[routes.node[ours]]).T)
    assert moved.max() <= 1.0
    assert routes.clearance_m.min() >= 0.3


def passage(gap_m: float) -> Plan:
    """Two rooms of 4 x 4 m, and a passage of 1 m length between them."""
    free = np.zeros((100, 220), bool)
    free[10:90, 10:90] = free[10:90, 110:190] = True
    half = round(gap_m / 0.05 / 2)
    free[50 - half : 50 + half, 90:110] = True
    grey = np.where(free, 254, 0).astype(np.uint8)
    return Plan("two", free, np.zeros_like(free), grey, 0.05, (0.0, 0.0, 0.0))


def beside() -> Building:
    """Two nodes in the left room of :func:`passage`, three in the right one."""
    return replace(ladder(), position_m=np.array([[2.5, 2.5], [3, 2], [7, 2.5], [7, 3], [8, 2.0]]), outline_m=None)


@pytest.mark.parametrize("gap_m", [0.3, 0.5, 0.8])
def test_narrow_passages_are_used_only_where_nothing_else_joins(gap_m: float) -> None:
    plan = passage(gap_m)
    building = beside()
    routes = routes_of(building, plan)
    assert set(routes.node.tolist()) >= set(range(5))
    near = routes.clearance_m < 0.3 - 0.01
    assert near.any() == (gap_m < 0.6)
    assert routes.clearance_m.min() >= min(0.3, gap_m / 2) - 0.03


def test_a_node_behind_a_shut_door_is_joined_as_in_the_building() -> None:
    plan = passage(0.8)
    plan.free[:, 90:110] = False
    building = beside()
    routes = routes_of(building, plan)
    assert set(routes.node.tolist()) >= set(range(5))
    with pytest.raises(TaskliftError, match="none of its nodes lies on free floor"):
        routes_of(replace(building, position_m=building.position_m + 1000, outline_m=None), plan)


def test_without_a_plan_lines_follow_the_corridors() -> None:
    course = [np.zeros((0, 2)), np.array([[7.0, 1.0], [8.0, 1.0]]), *[np.zeros((0, 2))] * 3]
    building = replace(ladder(), course_m=tuple(course))
    routes = routes_of(building, None)
    assert len(routes.edges) == building.n_edges + 2
    assert "no floor plan" in routes.remarks[0]


@pytest.mark.parametrize("resolution_m", [0.02, 0.05, 0.1])
@pytest.mark.parametrize("yaw", [0.0, 0.7])
def test_a_building_keeps_its_plan(resolution_m: float, yaw: float) -> None:
    plan = office(4, resolution_m, yaw=yaw)
    building = replace(generate(seed=4), provenance={"plan": pack(plan)})
    kept = unpack(Building.from_json(json.loads(json.dumps(building.to_json()))))
    assert kept is not None
    assert kept.resolution_m == pytest.approx({0.02: 0.04}.get(resolution_m, resolution_m))
    rows, columns = np.nonzero(kept.free)
    pixels = np.floor(plan.to_pixels(kept.to_world(rows + 0.5, columns + 0.5))).astype(int)
    assert plan.free[tuple(pixels.T)].all()
    assert kept.free.sum() * kept.resolution_m**2 == pytest.approx(plan.free.sum() * resolution_m**2, rel=0.1)


def test_cells_of_the_floor_lie_where_the_plan_has_them() -> None:
    for plan in (office(2, 0.02), office(2, 0.05, yaw=1.0)):
        floor = Floor.of(plan)
        rows, columns = np.nonzero(floor.clearance_m > 0)
        cells = np.column_stack([rows, columns]).astype(float)
        points = floor.to_world(cells)
        assert np.allclose(floor.to_cells(points), cells)
        pixels = np.floor(plan.to_pixels(points)).astype(int)
        assert plan.free[tuple(pixels.T)].all()
        far = ndimage.distance_transform_edt(plan.free) * plan.resolution_m
        assert np.abs(far[tuple(pixels.T)] - floor.clearance_m[rows, columns]).max() < 0.1


damaged = st.one_of(st.none(), st.text(), st.integers(), st.floats(allow_nan=False, allow_infinity=False))


@given(st.fixed_dictionaries({}, optional={"png": damaged, "resolution_m": damaged, "origin": damaged}))
@settings(max_examples=40, deadline=None)
def test_a_damaged_plan_counts_as_none(plan: dict[str, object]) -> None:
    try:
        building = replace(ladder(), provenance={"plan": plan})
    except TaskliftError:
        return
    assert unpack(building) is None


@pytest.fixture(scope="module")
def imported(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("routes")
    export(generate(seed=7), folder / "seven.yaml")
    result = CliRunner().invoke(map_group, ["import", str(folder / "seven.yaml"), "-o", str(folder / "seven.json")])
    assert result.exit_code == 0, result.output
    return folder / "seven.json"


def exported(imported: Path, tmp_path: Path, ending: str, *options: str) -> Path:
    out = tmp_path / f"seven{ending}"
    result = CliRunner().invoke(map_group, ["export", str(imported), str(out), *options])
    assert result.exit_code == 0, result.output
    return out


def test_geojson_is_what_the_route_server_parses(imported: Path, tmp_path: Path) -> None:
    """nav2_route's geojson_graph_file_loader: unsigned ids, points before use, metadata of plain values."""
    document = json.loads(exported(imported, tmp_path, ".geojson").read_text())
    nodes = [f for f in document["features"] if f["geometry"]["type"] == "Point"]
    edges = [f["properties"] for f in document["features"] if f["geometry"]["type"] == "MultiLineString"]
    ids = [f["properties"]["id"] for f in document["features"]]
    assert len(set(ids)) == len(ids)
    assert all(type(i) is int and i >= 0 for i in ids)
    number = {f["properties"]["id"]: f["geometry"]["coordinates"] for f in nodes}
    assert all(f["properties"]["frame"] == "map" and len(f["geometry"]["coordinates"]) == 2 for f in nodes)
    pairs = {(e["startid"], e["endid"]) for e in edges}
    assert pairs <= {(a, b) for a in number for b in number}
    assert {(b, a) for a, b in pairs} == pairs
    for record in (*(f["properties"] for f in nodes), *edges):
        assert all(isinstance(value, int | float | str) for value in record["metadata"].values())
    building = Building.load(imported)
    classes = [f["properties"]["metadata"]["class"] for f in nodes]
    assert classes.count("room") == (building.kind == ROOM).sum()
    assert classes.count("door") == (building.feature_class == DOOR).sum()


@pytest.mark.parametrize("ending", [".geojson", ".lif.json", ".nav.yaml"])
def test_what_is_written_is_read_again(imported: Path, tmp_path: Path, ending: str) -> None:
    out = exported(imported, tmp_path, ending)
    building = Building.load(imported)
    places = read_map(Source(out))
    routes = routes_of(building, unpack(building))
    assert np.allclose(places.position_m, routes.position_m, atol=1e-3)
    assert sorted(places.ways) == [tuple(edge) for edge in routes.edges.tolist()]
    rooms = set(np.flatnonzero(building.kind == ROOM).tolist())
    assert {f"room_{room}" for room in rooms} <= set(places.names.values())


def test_names_of_waypoints_stay(tmp_path: Path) -> None:
    building = replace(ladder(), provenance={"names": {"0": "dock", "3": "lab"}})
    export(building, tmp_path / "a.geojson")
    assert set(read_nav2(Source(tmp_path / "a.geojson")).names.values()) >= {"dock", "lab"}
    export(building, tmp_path / "a.nav.yaml")
    vertices = yaml.safe_load((tmp_path / "a.nav.yaml").read_text())["levels"]["L1"]["vertices"]
    assert [v[2]["name"] for v in vertices] == ["dock", "", "", "lab", ""]


def test_lif_has_what_the_guideline_requires(imported: Path, tmp_path: Path) -> None:
    document = json.loads(exported(imported, tmp_path, ".lif.json").read_text())
    assert set(document["metaInformation"]) == {"projectIdentification", "creator", "exportTimestamp", "lifVersion"}
    (layout,) = document["layouts"]
    assert all(node["mapId"] and node["vehicleTypeNodeProperties"] for node in layout["nodes"])
    assert all(edge["vehicleTypeEdgeProperties"][0]["rotationAllowed"] for edge in layout["edges"])
    assert len(layout["stations"]) == (Building.load(imported).kind == ROOM).sum()


def test_a_wider_robot_keeps_farther_and_another_plan_can_be_given(imported: Path, tmp_path: Path) -> None:
    plan = imported.with_name("seven.yaml")
    out = exported(imported, tmp_path, ".geojson", "--radius", "0.45", "--plan", str(plan))
    features = json.loads(out.read_text())["features"]
    clearance = [f["properties"]["metadata"]["clearance_m"] for f in features if "startid" in f["properties"]]
    assert min(clearance) >= 0.45
    result = CliRunner().invoke(map_group, ["export", str(imported), str(plan), "--force", "--plan", str(plan)])
    assert isinstance(result.exception, TaskliftError)
