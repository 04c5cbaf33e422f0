"""The bars for floor plans: hand-made graphs, Willow Garage, drawn buildings, speed. Each prints its figure."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from plans_measure import (
    against_labels,
    agreement,
    before_plain_walls,
    counts,
    drawn_counts,
    empty_loops,
    farthest_intersection_m,
    loop_count,
    needs_maps,
    office,
    write_office,
)

from tasklift.building.generate import generate
from tasklift.building.graph import DOOR, INTERSECTION, NONE, ROOM, Building
from tasklift.plans.check import check
from tasklift.plans.extract.building import extract
from tasklift.plans.importing import import_map, read_plan
from tasklift.plans.plan import Plan
from tasklift.plans.raster import rasterise

# Junction recall, precision, median and 90th percentile of the path error: the bars.
BARS = {
    "cumberland": (0.80, 0.60, 0.06, 0.22),
    "broughton": (0.80, 0.60, 0.06, 0.22),
    "DIAG_labs": (0.80, 0.45, 0.06, 0.22),
    "grid": (1.0, 1.0, 0.01, 0.03),
}
# Against the hand-made graphs as they are, two recalls are lower, and what is asked here is what is reached: 12 of
# cumberland's 22 junctions lie on loops or forks around nothing but floor, and 4 of DIAG's 12 stand before walls as
# plain as beside them (doors that were shut). Nothing is there to be found; a building's graph should not have them.
LITERAL_RECALL = {"cumberland": 0.68, "DIAG_labs": 0.66}


@pytest.mark.parametrize("name", BARS)
@pytest.mark.parametrize("as_a_building", [False, True], ids=["as it is", "as a building"])
def test_hand_made_graphs(name: str, as_a_building: bool) -> None:
    folder = needs_maps() / "patrolling_sim" / name
    plan = read_plan(folder / f"{name}.yaml")
    building, _ = extract(plan)
    recall, precision, median, p90 = BARS[name]
    if not as_a_building:
        recall = LITERAL_RECALL.get(name, recall)
    found = agreement(building, plan, folder / f"{name}.graph", as_a_building)
    print(f"\n{name}: {found}")
    assert found.junction_recall >= recall
    assert found.precision >= precision
    assert found.path_median <= median
    assert found.path_p90 <= p90


def test_what_a_buildings_graph_should_not_have_is_told_from_the_plan() -> None:
    """A square loop and a fork around floor, a stop before a plain wall; and the same with something in between."""
    free = np.zeros((200, 400), bool)
    free[20:180, 20:380] = True
    plan = Plan("hall", free, np.zeros_like(free), free.astype(np.uint8) * 254, 0.05, (0.0, 0.0, 0.0))
    corners = np.array([[3.0, 3], [6, 3], [6, 6], [3, 6], [16, 3], [14, 7], [18, 7], [10, 5], [10, 6.4]])
    edges = np.array([[0, 1], [1, 2], [2, 3], [0, 3], [1, 7], [4, 7], [4, 5], [4, 6], [7, 8]])
    hand = graph_of(corners, edges)
    assert sorted(map(sorted, empty_loops(hand, plan))) == [[0, 1, 2, 3], [4, 5, 6]]
    assert before_plain_walls(hand, plan).tolist() == [0, 0, 0, 0, 0, 0, 0, 1, 0]
    free[90:120, 80:100] = free[70:130, 310:330] = False  # something in the loop and in the fork
    free[5:20, 195:205] = True  # a niche behind the stop
    assert empty_loops(hand, plan) == []
    assert not before_plain_walls(hand, plan).any()


def graph_of(position: np.ndarray, edges: np.ndarray) -> Building:
    n = len(position)
    length = np.hypot(*(position[edges[:, 0]] - position[edges[:, 1]]).T)
    kind, area, none = np.full(n, INTERSECTION), np.zeros(n), np.full(n, NONE)
    return Building("hand", kind, none, position, area, area.astype(int), edges, length, np.full(len(edges), 2.0), 0)


def test_grid_is_exact() -> None:
    building, _ = import_map(needs_maps() / "patrolling_sim" / "grid" / "grid.yaml")
    assert (building.n_nodes, building.n_edges, loop_count(building)) == (25, 40, 16)


def test_willow_garage() -> None:
    building, _ = import_map(needs_maps() / "willow_garage" / "willow-full.yaml")
    for name, found in against_labels(building).items():
        print(f"\n{name}: recall {found.recall:.3f}, precision {found.precision:.3f} (bars .90)")
        assert found.recall >= 0.9
        assert found.precision >= 0.9


def test_an_import_compiles_nothing() -> None:
    path = needs_maps() / "willow_garage" / "willow-full.yaml"
    code = (
        "import sys; from tasklift.plans.importing import import_map; "
        f"import_map({str(path)!r}); assert 'numba' not in sys.modules"
    )
    subprocess.run([sys.executable, "-c", code], check=True)


@pytest.mark.parametrize("folder", ["nav2/depot", "nav2/tb3_sandbox", "turtlebot3/map", "aws_small_house/map"])
def test_maps_nobody_tuned_on_give_a_building(folder: str) -> None:
    building, doubts = import_map(needs_maps() / f"{folder}.yaml")
    print(f"\n{building!r} {doubts}")
    assert building.n_nodes >= 4


def round_trip(seeds: range) -> tuple[int, int]:
    exact = near = 0
    for seed in seeds:
        drawn = generate(seed=seed)
        found, _ = extract(rasterise(drawn))
        exact += counts(found) == drawn_counts(drawn)
        near += farthest_intersection_m(drawn, found) <= 1.0
    print(f"\n{len(seeds)} drawn buildings: counts exact in {exact}, every intersection within 1 m in {near}")
    return exact, near


def test_round_trip() -> None:
    exact, near = round_trip(range(10))
    assert exact >= 10
    assert near >= 10


@pytest.mark.slow
@pytest.mark.parametrize("first", [0, 500])
def test_round_trip_of_a_hundred(first: int) -> None:
    # nothing was tuned on the seeds from 500 on
    exact, near = round_trip(range(first, first + 100))
    assert exact >= 97
    assert near >= 95


def test_small_office_is_exact() -> None:
    building, _ = extract(office(800))
    # sixteen rooms, and the open hall beside them, which is a room without a door
    assert int((building.feature_class == DOOR).sum()) == 16
    areas = np.sort(building.area_m2[building.kind == ROOM])
    assert len(areas) == 17
    assert np.isclose(areas[:16], 4.7 * 4.2, rtol=0.1).all()


@pytest.mark.slow
def test_a_large_plan(tmp_path: Path) -> None:
    import resource

    path = write_office(tmp_path, 4000)
    building, _ = import_map(path, tmp_path / "office.json", tmp_path / "office.png")
    gigabytes = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1e6
    print(f"\n4,000 x 4,000: {building!r} {gigabytes:.2f} GB (bar 2)")
    assert gigabytes <= 2


@pytest.mark.parametrize("seed", range(5))
def test_corridors_are_as_long_as_they_run_but_for_corners_cut(seed: int) -> None:
    building, _ = extract(rasterise(generate(seed=seed)))
    line = np.array([np.hypot(*np.diff(building.line_m(e), axis=0).T).sum() for e in range(building.n_edges)])
    straight = np.hypot(*(building.position_m[building.edges[:, 0]] - building.position_m[building.edges[:, 1]]).T)
    assert (line >= straight - 0.002).all()
    assert (building.length_m <= line + 0.002).all()
    assert not check(building).warnings


def test_the_same_plan_gives_the_same_building() -> None:
    plan = rasterise(generate(seed=3))
    assert extract(plan)[0].content_id == extract(plan)[0].content_id
