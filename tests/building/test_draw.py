"""Drawings: what is on them, where, and that they come out as files."""

from __future__ import annotations

import sys
import warnings
from pathlib import Path

import numpy as np
import pytest
import shapely
from hypothesis import given, settings
from hypothesis import strategies as st
from matplotlib.collections import LineCollection
from matplotlib.figure import Figure

from tasklift.building.draw import corridor_floor, draw_graph, draw_plan, figure, footprints
from tasklift.building.generate import generate
from tasklift.building.graph import DOOR, INTERSECTION, ROOM, Building
from tasklift.errors import TaskliftError
from tasklift.plans.read import load_building
from tasklift.style import GROUND, SCENE

MAPS = Path(__file__).parents[3] / "shared" / "maps" / "patrolling_sim"


def without_footprints(building):
    fields = {name: getattr(building, name) for name in building.__dataclass_fields__}
    return Building(**fields | {"provenance": {}})


def legend_of(ax):
    return [text.get_text() for text in ax.get_legend().get_texts()]


def crossroads(widths=(2.0, 3.0, 2.0, 3.0)):
    return Building(
        name="crossroads",
        kind=[1] * 5,
        feature_class=[1] * 5,
        position_m=[[0, 0], [10, 0], [0, 10], [-10, 0], [0, -10]],
        area_m2=[0] * 5,
        obstacles=[0] * 5,
        edges=[[0, 1], [0, 2], [0, 3], [0, 4]],
        length_m=[10] * 4,
        width_m=widths,
        start=0,
    )


@settings(deadline=None, derandomize=True, max_examples=15)
@given(st.integers(0, 10**6))
def test_rooms_keep_their_area_and_the_floor_joins_them_all(seed):
    building = generate(seed=seed)
    rooms = footprints(building)
    assert sorted(rooms) == np.flatnonzero(building.kind == ROOM).tolist()
    for room, floor in rooms.items():
        assert floor.area == pytest.approx(building.area_m2[room], abs=0.01)
    corridors = corridor_floor(building)
    whole = shapely.union_all([corridors, *rooms.values()], grid_size=0.001)
    assert isinstance(whole, shapely.Polygon)  # in one piece
    assert all(whole.covers(shapely.Point(p)) for p in building.position_m)
    # As many courtyards as the graph has loops
    assert len(whole.interiors) == building.n_edges - building.n_nodes + 1
    # Only the corners of wide corridors may reach over the rounded outline
    assert shapely.Polygon(building.outline_m).buffer(1.2).covers(whole)


def test_corridors_are_bands_of_their_width_with_square_corners():
    # Two bands of 20 + margins: each ends as a square, half its width beyond the node
    east_west, north_south = 22 * 2.0, 23 * 3.0
    assert corridor_floor(crossroads()).area == pytest.approx(east_west + north_south - 2 * 3, abs=1e-6)


@settings(deadline=None, derandomize=True, max_examples=15)
@given(st.integers(0, 10**6))
def test_rooms_without_footprints_stay_off_each_other(seed):
    building = without_footprints(generate(seed=seed))
    rooms = footprints(building)
    for room, floor in rooms.items():
        assert floor.covers(shapely.Point(building.position_m[room]))
        assert 1.4 < floor.area < building.area_m2[room] + 1e-9
        for other in building.neighbour[building.indptr[room] : building.indptr[room + 1]]:
            assert floor.distance(shapely.Point(building.position_m[other])) < 3
    floors = list(rooms.values())
    for i, one in enumerate(floors):
        assert all(one.intersection(other).area < 0.5 for other in floors[:i])


@pytest.mark.parametrize("box", [[1, 2, 3], "wide", [1, 2, None, 4], None])
def test_odd_footprints_in_the_provenance_are_passed_over(box):
    building = generate(seed=1)
    fields = {name: getattr(building, name) for name in building.__dataclass_fields__}
    room = int(np.flatnonzero(building.kind == ROOM)[0])
    odd = Building(**fields | {"provenance": {"footprints": {str(room): box}}})
    assert footprints(odd)[room].equals(footprints(without_footprints(building))[room])


def test_the_graph_shows_every_node_and_edge():
    building = generate(seed=2)
    ax = Figure().subplots()
    door = int(np.flatnonzero(building.feature_class == DOOR)[0])
    draw_graph(building, ax, hostiles=[door])
    drawn = {line.get_label(): line for line in ax.lines}
    assert len(drawn) == len(ax.lines)
    shown = [tuple(p) for line in ax.lines[:4] for p in np.column_stack(line.get_data())]
    assert sorted(shown) == sorted(map(tuple, building.position_m.tolist()))
    (edges,) = [c for c in ax.collections if isinstance(c, LineCollection)]
    assert len(edges.get_segments()) == building.n_edges
    dark = [line for line in ax.lines if line.get_markerfacecolor() == GROUND["ink"][0]]
    assert len(dark[0].get_xdata()) == np.sum(building.kind == INTERSECTION)
    assert legend_of(ax) == ["intersection", "room", "door", "other feature", "start", "hostile"]
    assert ax.get_aspect() == 1.0


def test_the_plan_shows_doors_across_their_corridors():
    building = generate(seed=2)
    ax = Figure().subplots()
    draw_plan(building, ax)
    ticks = [line for line in ax.lines if line.get_color() == SCENE["door"][0]]
    doors = np.flatnonzero(building.feature_class == DOOR)
    assert len(ticks) == len(doors)
    for door, tick in zip(doors, ticks, strict=True):
        ends = np.column_stack(tick.get_data())
        np.testing.assert_allclose(ends.mean(axis=0), building.position_m[door], atol=1e-9)
        edges = building.edge_of[building.indptr[door] : building.indptr[door + 1]]
        assert np.hypot(*(ends[1] - ends[0])) == pytest.approx(building.width_m[edges].min())
        beside = building.neighbour[building.indptr[door]]
        assert (ends[1] - ends[0]) @ (building.position_m[beside] - building.position_m[door]) == pytest.approx(0)
    assert legend_of(ax) == ["corridor", "room", "door", "other feature", "start"]


def test_signs_that_are_not_there_are_not_explained():
    ax = Figure().subplots()
    draw_plan(crossroads(), ax)
    assert legend_of(ax) == ["corridor", "start"]
    ax = Figure().subplots()
    draw_graph(crossroads(), ax)
    assert legend_of(ax) == ["intersection", "start"]
    ax = Figure().subplots()
    draw_graph(crossroads(), ax, legend=False)
    assert ax.get_legend() is None


def test_the_scale_bar_is_as_long_as_it_says():
    for building in (generate(seed=1), crossroads(), generate(100, 110, 30, 60, seed=1)):
        ax = Figure().subplots()
        draw_graph(building, ax)
        (label,) = [text.get_text() for text in ax.texts]
        assert label.endswith(" m")
        x, y = ax.lines[-1].get_data()
        assert x[1] - x[0] == pytest.approx(float(label.removesuffix(" m")))
        assert y[0] == y[1]
        extent = np.ptp(building.outline_m, axis=0).max()
        assert 0.05 * extent < x[1] - x[0] <= 0.25 * extent


@pytest.mark.parametrize("draw", [draw_plan, draw_graph])
def test_a_hostile_that_is_no_node_is_refused(draw):
    with pytest.raises(TaskliftError, match="hostile at node 99; nodes are 0 to 42"):
        draw(generate(), Figure().subplots(), hostiles=[99])


@pytest.mark.parametrize("suffix", ["png", "svg", "pdf"])
def test_figures_are_written_without_pyplot(tmp_path, suffix):
    before = "matplotlib.pyplot" in sys.modules
    path = tmp_path / f"building.{suffix}"
    figure(generate(seed=4), hostiles=[30]).savefig(path)
    assert path.stat().st_size > 5000
    assert ("matplotlib.pyplot" in sys.modules) == before


def test_wide_buildings_are_drawn_one_above_the_other():
    line = np.array([[float(i * 10), 0.0] for i in range(6)])
    wide = Building(
        name="corridor",
        kind=[1] * 6,
        feature_class=[1] * 6,
        position_m=line,
        area_m2=[0] * 6,
        obstacles=[0] * 6,
        edges=[[i, i + 1] for i in range(5)],
        length_m=[10] * 5,
        width_m=[2] * 5,
        start=0,
    )
    upper, lower = figure(wide).axes
    assert upper.get_subplotspec().rowspan.start < lower.get_subplotspec().rowspan.start
    left, right = figure(generate(10, 10, 3, 5, seed=1)).axes
    assert left.get_subplotspec().colspan.start < right.get_subplotspec().colspan.start


@pytest.mark.parametrize("name", ["cumberland", "broughton", "grid"])
def test_real_maps_are_drawn(tmp_path, name):
    path = MAPS / name / f"{name}.graph"
    if not path.exists():
        pytest.skip(f"no real maps here: {path} is missing")
    building = load_building(path)
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        figure(building, hostiles=[int(np.flatnonzero(building.feature_class == DOOR)[0])]).savefig(
            tmp_path / "map.png"
        )
    assert (tmp_path / "map.png").stat().st_size > 10_000
