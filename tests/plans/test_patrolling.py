"""patrolling_sim graphs: the real ones, the rule that sets kinds, damage, and writing."""

from __future__ import annotations

import math
from pathlib import Path

import networkx
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from plans_measure import read_graph

from tasklift.building.generate import generate
from tasklift.building.graph import (
    BEND,
    CORNER,
    DOOR,
    FEATURE,
    INTERSECTION,
    OTHER,
    ROOM,
    Building,
)
from tasklift.building.search import hostile_candidates
from tasklift.errors import TaskliftError
from tasklift.plans.read.patrolling import write_graph

MAPS = Path(__file__).parents[3] / "shared" / "maps" / "patrolling_sim"

# Nodes, edges and leaves, counted apart from the reader
REAL = {
    "1r5": (12, 11, 7),
    "DIAG_labs": (27, 26, 15),
    "L440": (18, 21, 5),
    "broughton": (163, 186, 26),
    "ctcv": (18, 17, 6),
    "cumberland": (40, 44, 18),
    "grid": (25, 40, 0),
    "move_base_arena": (14, 22, 2),
}


def real(name):
    path = MAPS / name / f"{name}.graph"
    if not path.exists():
        pytest.skip(f"no real maps here: {path} is missing")
    return path


def graph_file(folder, positions, edges, cost=None, resolution=0.5, offset=(0, 0)):
    """Write a .graph file by hand: pixel positions, edges, some costs that are not the distance."""
    words = [str(len(positions)), "100", "80", str(resolution), str(offset[0]), str(offset[1])]
    neighbours = {node: [] for node in range(len(positions))}
    for a, b in edges:
        pixels = (cost or {}).get((a, b), round(math.dist(positions[a], positions[b])))
        neighbours[a].append((b, pixels))
        neighbours[b].append((a, pixels))
    for node, (x, y) in enumerate(positions):
        words += ["", str(node), str(x), str(y), str(len(neighbours[node]))]
        for other, pixels in neighbours[node]:
            words += [str(other), "N", str(pixels)]
    path = folder / "made.graph"
    path.write_text("\n".join(words) + "\n")
    return path


@pytest.mark.parametrize("name", sorted(REAL))
def test_real_maps(name):
    nodes, edges, leaves = REAL[name]
    plain = read_graph(real(name), add_doors=False)
    assert (plain.n_nodes, plain.n_edges) == (nodes, edges)
    assert np.sum(plain.kind == ROOM) == leaves
    building = read_graph(real(name))
    assert len(hostile_candidates(building)) >= 4
    added = building.n_nodes - nodes
    assert building.n_edges == edges + added
    assert building.name == name
    assert (building.feature_class[nodes:] == DOOR).all()
    assert np.array_equal(building.position_m[:nodes], plain.position_m)
    assert building.length_m.sum() == pytest.approx(plain.length_m.sum(), abs=1e-3 * edges)
    # Every room has its door
    for room in np.flatnonzero(building.kind == ROOM):
        (beside,) = building.neighbour[building.indptr[room] : building.indptr[room + 1]]
        assert building.feature_class[beside] == DOOR
    # The start is the lowest room there is
    lowest = building.position_m[building.kind == ROOM if leaves else slice(None), 1].min()
    assert building.position_m[building.start, 1] == lowest
    assert "room" in building.provenance["rule"]
    assert building.coverage.shape == (2 * building.n_edges,)
    assert Building.from_json(building.to_json()) == building


def test_pixels_become_metres():
    building = read_graph(real("ctcv"))
    # The first node of the file stands at pixel (60, 143), 0.05 m each, moved by (-29.675, -7.4)
    first = [float(word) for word in real("ctcv").read_text().split()[7:9]]
    np.testing.assert_allclose(building.position_m[0], np.array(first) * 0.05 + (-29.675, -7.4), atol=1e-4)


def test_a_start_can_be_chosen():
    assert read_graph(real("cumberland"), start=7).start == 7
    with pytest.raises(TaskliftError, match=r"cumberland\.graph: start 40 is not a node of the file; expected 0 to 39"):
        read_graph(real("cumberland"), start=40)


def test_the_rule_for_kinds(tmp_path):
    """Row of nodes along y = 40 with a corner, a bend and a straight node; rooms at 0, 5, 6, 7."""
    positions = [
        (0, 40),
        (10, 40),
        (20, 40),
        (30, 40),
        (40, 48),
        (40, 60),
        (40, 30),
        (60, 48),
        (20, 60),
        (30, 60),
    ]
    edges = [(0, 1), (1, 2), (2, 3), (3, 4), (4, 5), (6, 3), (4, 7), (2, 8), (8, 9), (9, 3)]
    building = read_graph(graph_file(tmp_path, positions, edges))
    kind, feature = building.kind.tolist(), building.feature_class.tolist()
    assert [node for node in range(10) if kind[node] == ROOM] == [0, 5, 6, 7]
    assert [node for node in range(10) if kind[node] == INTERSECTION] == [2, 3, 4]
    assert feature[1] == DOOR  # two neighbours, one of them a room
    assert feature[8] == CORNER
    assert feature[9] == CORNER
    # Rooms 5, 6 and 7 hang on junctions: their doors are new, halfway
    assert kind[10:] == [FEATURE] * (building.n_nodes - 10)
    halfway = {tuple(p) for p in building.position_m[10:].tolist()}
    assert {(20.0, 27.0), (17.5, 17.5), (25.0, 24.0)} <= halfway
    # Room 6 is the lowest. Its own door does not count, so one more stands in the longest corridor, 2-8
    assert building.start == 6
    assert len(hostile_candidates(building)) == 4
    assert (10.0, 25.0) in halfway
    assert building.n_nodes == 14


@pytest.mark.parametrize(
    ("turn", "feature"), [(0, OTHER), (30, OTHER), (40, BEND), (65, BEND), (75, CORNER), (120, CORNER)]
)
@pytest.mark.parametrize("side", [1, -1])
def test_turns_are_bends_and_corners(tmp_path, turn, feature, side):
    end = [round(1000 * v) for v in (math.cos(math.radians(turn)), side * math.sin(math.radians(turn)))]
    positions = [(-2000, 0), (-1000, 0), (0, 0), end, (end[0], end[1] - 3000), (-1000, 900)]
    positions = [(x + 5000, y + 5000) for x, y in positions]
    # Node 2 turns between the junctions 1 and 3
    edges = [(0, 1), (1, 2), (2, 3), (3, 4), (1, 5), (5, 3)]
    building = read_graph(graph_file(tmp_path, positions, edges, resolution=0.01), add_doors=False)
    assert building.feature_class[2] == feature


def test_lengths_are_straight_unless_the_cost_is_longer(tmp_path):
    positions = [(0, 0), (30, 40), (60, 0)]
    path = graph_file(tmp_path, positions, [(0, 1), (1, 2)], cost={(0, 1): 70, (1, 2): 20})
    building = read_graph(path, width_m=1.5, room_area_m2=20, add_doors=False)
    assert building.length_m.tolist() == [35.0, 25.0]
    assert building.width_m.tolist() == [1.5, 1.5]
    assert building.area_m2.tolist() == [20, 0, 20]
    assert building.obstacles.tolist() == [0, 0, 0]


@settings(deadline=None, derandomize=True, max_examples=25)
@given(st.integers(0, 10**6), st.sampled_from([0.02, 0.05, 0.075]))
def test_writing_and_reading_keeps_nodes_and_edges(tmp_path_factory, seed, resolution):
    path = tmp_path_factory.mktemp("graph") / "written.graph"
    building = generate(seed=seed)
    write_graph(building, path, resolution)
    back = read_graph(path, add_doors=False)
    assert np.array_equal(back.edges, building.edges)
    np.testing.assert_allclose(back.position_m, building.position_m, atol=resolution / 2 + 1e-4)
    np.testing.assert_allclose(back.length_m, building.length_m, atol=2.1 * resolution)
    assert (back.kind[building.kind == ROOM] == ROOM).all()
    full = read_graph(path)
    # With doors added, what is in between the old nodes is still the same
    for door in range(building.n_nodes, full.n_nodes):
        assert full.feature_class[door] == DOOR
    joined = networkx.Graph(full.edges.tolist())
    for door in range(building.n_nodes, full.n_nodes):
        a, b = joined[door]
        joined.remove_node(door)
        joined.add_edge(a, b)
    assert {tuple(sorted(edge)) for edge in joined.edges} == {tuple(edge) for edge in building.edges.tolist()}


@pytest.mark.parametrize("name", ["cumberland", "broughton", "ctcv"])
def test_real_maps_survive_writing(tmp_path, name):
    building = read_graph(real(name), add_doors=False)
    write_graph(building, tmp_path / "again.graph", building.provenance["resolution_m"])
    again = read_graph(tmp_path / "again.graph", add_doors=False)
    assert np.array_equal(again.edges, building.edges)
    assert np.array_equal(again.kind, building.kind)
    resolution = building.provenance["resolution_m"]
    np.testing.assert_allclose(again.position_m, building.position_m, atol=resolution / 2 + 1e-4)


def test_writing_refuses_what_the_format_cannot_hold(tmp_path):
    n = 10
    hub = Building(
        name="hub",
        kind=[1] * n,
        feature_class=[1] * n,
        position_m=[[0, 0], *([math.cos(i), math.sin(i)] for i in range(1, n))],
        area_m2=[0] * n,
        obstacles=[0] * n,
        edges=[[0, i] for i in range(1, n)],
        length_m=[1] * (n - 1),
        width_m=[2] * (n - 1),
        start=0,
    )
    with pytest.raises(TaskliftError, match="node 0 has 9 neighbours; the format holds 8"):
        write_graph(hub, tmp_path / "hub.graph")
    with pytest.raises(TaskliftError, match="resolution"):
        write_graph(generate(), tmp_path / "hub.graph", resolution_m=0)
    assert not (tmp_path / "hub.graph").exists()


GOOD = "3 100 80 0.5 0 0\n0 10 10 1\n1 N 20\n1 30 10 2\n0 S 20\n2 S 20\n2 50 10 1\n1 E 20\n"


def test_the_small_file_is_good(tmp_path):
    path = tmp_path / "small.graph"
    path.write_text(GOOD)
    assert read_graph(path).edges.tolist() == [[0, 1], [1, 2]]


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        ("3 100", "1000000000 100", "line 1: expected the number of nodes .* found '1000000000'"),
        ("3 100", "1 100", "line 1: expected the number of nodes"),
        ("3 100", "-3 100", "line 1: expected the number of nodes"),
        ("3 100", "90000 100", "line 8: expected the id of node 3, found the end; is the file cut short"),
        ("3 100", "2 100", "line 6: edge 1-2: node 2 does not exist; nodes are 0 to 1"),
        ("1 E 20", "1 E 20\n3 70 10 0", "line 9: expected the end of the file after 3 nodes, found '3'"),
        ("0.5 0 0", "0 0 0", "line 1: expected the resolution in m per pixel"),
        ("0.5 0 0", "nan 0 0", "line 1: expected the resolution in m per pixel .* found 'nan'"),
        ("0.5 0 0", "0.5 x 0", r"line 1: expected the offset in x \(a number\), found 'x'"),
        ("1 30 10 2", "1 thirty 10 2", r"line 4: expected x of node 1 \(a number\), found 'thirty'"),
        ("1 30 10 2", "1 30 inf 2", "line 4: expected y of node 1"),
        ("1 30 10 2", "5 30 10 2", "line 4: expected node 1, found id 5; ids are 0 to 2 in order"),
        ("1 30 10 2", "1 30 10 9", "line 4: expected the number of neighbours of node 1"),
        ("1 30 10 2", "1 30 10 1.5", "line 4: expected the number of neighbours of node 1"),
        ("2 S 20", "7 S 20", "line 6: edge 1-7: node 7 does not exist; nodes are 0 to 2"),
        ("2 S 20", "1 S 20", "line 6: node 1 is its own neighbour"),
        ("2 S 20", "2 7 20", "line 6: edge 1-2: expected a direction like NE, found '7'"),
        ("2 S 20", "2 S far", r"line 6: expected the cost of edge 1-2 \(a number\), found 'far'"),
        ("2 S 20", "2 S -1", "line 6: expected the cost of edge 1-2"),
        ("1 N 20", "2 N 20", "line 3: edge 0-2: node 2 does not list node 0 as a neighbour"),
        (
            "1 30 10 2\n0 S 20\n2 S 20\n2 50 10 1\n1 E 20",
            "1 30 10 1\n0 S 20\n2 50 10 0",
            "node 2 cannot be reached",
        ),
    ],
)
def test_damage_is_named_with_its_line(tmp_path, old, new, message):
    path = tmp_path / "bad.graph"
    assert GOOD.count(old) == 1
    path.write_text(GOOD.replace(old, new))
    with pytest.raises(TaskliftError, match=message) as caught:
        read_graph(path)
    assert str(caught.value).startswith(str(path))
    assert "\n" not in str(caught.value)


def test_a_file_cut_short_is_refused(tmp_path):
    path = tmp_path / "cut.graph"
    words = GOOD.split()
    for end in range(len(words)):
        path.write_text(" ".join(words[:end]))
        with pytest.raises(TaskliftError, match="found the end; is the file cut short"):
            read_graph(path)


@settings(deadline=None, derandomize=True, max_examples=200)
@given(st.integers(0, len(GOOD) - 1), st.integers(0, 5), st.text("0123456789.-eNS \n\x00é", max_size=6))
def test_any_other_damage_gives_a_building_or_a_clear_error(tmp_path_factory, at, drop, text):
    path = tmp_path_factory.mktemp("graph") / "odd.graph"
    path.write_text(GOOD[:at] + text + GOOD[at + drop :], encoding="utf-8")
    message = None
    try:
        read_graph(path)
    except TaskliftError as error:
        message = str(error)
    if message is not None:
        assert message.startswith(str(path))
        assert "\n" not in message


def test_a_missing_or_binary_file(tmp_path):
    with pytest.raises(TaskliftError, match=r"none\.graph: cannot be read"):
        read_graph(tmp_path / "none.graph")
    (tmp_path / "image.graph").write_bytes(b"P5\n\xff\xfe\x00")
    with pytest.raises(TaskliftError, match=r"image\.graph: expected UTF-8 text"):
        read_graph(tmp_path / "image.graph")
