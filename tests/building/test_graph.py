"""Building: what it derives, what it refuses, and that its files give it back."""

from __future__ import annotations

import copy
import json
import math
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from tasklift.building.graph import CORNER, DOOR, FEATURE, INTERSECTION, NONE, ROOM, Building, buffered_hull
from tasklift.errors import TaskliftError
from tasklift.files import canonical_json

metres = st.floats(0, 100).map(lambda value: round(value, 3))


@st.composite
def buildings(draw):
    """Any connected building of 2 to 12 nodes: a random tree and some more edges."""
    n = draw(st.integers(2, 12))
    edges = {(draw(st.integers(0, b - 1)), b) for b in range(1, n)}
    pairs = st.tuples(st.integers(0, n - 1), st.integers(0, n - 1)).filter(lambda pair: pair[0] < pair[1])
    edges |= set(draw(st.lists(pairs, max_size=6)))
    edges = draw(st.permutations(sorted(edges)))
    kind = np.array([draw(st.integers(0, 2)) for _ in range(n)])
    rows = [[draw(metres), draw(metres)] for _ in range(n)]
    return Building(
        name=draw(st.text(max_size=5).filter(lambda name: name.isprintable())),
        kind=kind,
        feature_class=np.where(kind == FEATURE, [draw(st.integers(2, 5)) for _ in range(n)], NONE),
        position_m=rows,
        area_m2=np.where(kind == ROOM, [draw(st.floats(1, 90)) for _ in range(n)], 0.0),
        obstacles=np.where(kind == ROOM, [draw(st.integers(0, 5)) for _ in range(n)], 0),
        edges=[(b, a) if draw(st.booleans()) else (a, b) for a, b in edges],
        length_m=[draw(st.floats(0.5, 50)) for _ in edges],
        width_m=[draw(st.floats(0.5, 5)) for _ in edges],
        start=draw(st.integers(0, n - 1)),
        provenance={"why": "test"},
        course_m=[draw(st.lists(st.tuples(metres, metres), max_size=3)) for _ in edges],
    )


def document():
    """A room, a door, an intersection and a corner: small enough to see every fault."""
    return {
        "format": "tasklift-building",
        "version": 1,
        "name": "flat",
        "start": 0,
        "outline": [[-3, -3], [13, -3], [13, 8], [-3, 8]],
        "nodes": [
            {"id": 0, "kind": "room", "x": 0, "y": 0, "area_m2": 12.5, "obstacles": 2},
            {"id": 1, "kind": "feature", "class": "door", "x": 3, "y": 0},
            {"id": 2, "kind": "intersection", "x": 10, "y": 0},
            {"id": 3, "kind": "feature", "class": "corner", "x": 10.25, "y": 5},
        ],
        "edges": [
            {"a": 0, "b": 1, "length_m": 3, "width_m": 1},
            {"a": 2, "b": 1, "length_m": 7, "width_m": 2},
            {"a": 2, "b": 3, "length_m": 5.01, "width_m": 2.5},
        ],
        "provenance": {},
    }


@settings(deadline=None, derandomize=True, max_examples=60)
@given(buildings())
def test_a_saved_building_comes_back(tmp_path_factory, building):
    path = tmp_path_factory.mktemp("graph") / "building.json"
    building.save(path)
    loaded = Building.load(path)
    assert loaded == building
    assert hash(loaded) == hash(building)
    assert loaded.content_id == building.content_id
    assert (loaded.name, loaded.provenance) == (building.name, building.provenance)
    first = path.read_bytes()
    loaded.save(path)
    assert path.read_bytes() == first


@settings(deadline=None, derandomize=True, max_examples=60)
@given(buildings())
def test_half_edges_list_every_edge_from_both_ends(building):
    rebuilt = set()
    for node in range(building.n_nodes):
        here = slice(building.indptr[node], building.indptr[node + 1])
        neighbours = building.neighbour[here].tolist()
        assert neighbours == sorted(neighbours)
        assert len(neighbours) == building.degree[node]
        for other, edge in zip(neighbours, building.edge_of[here].tolist(), strict=True):
            assert sorted((node, other)) == building.edges[edge].tolist()
            rebuilt.add((node, other))
    assert rebuilt == {pair for a, b in building.edges.tolist() for pair in ((a, b), (b, a))}
    assert building.edges.tolist() == sorted(building.edges.tolist())


@settings(deadline=None, derandomize=True, max_examples=40)
@given(buildings(), st.randoms(use_true_random=False))
def test_the_order_of_edges_in_a_file_is_not_content(building, random):
    shuffled = building.to_json()
    random.shuffle(shuffled["edges"])
    for edge in shuffled["edges"]:
        if random.random() < 0.5:
            edge["a"], edge["b"] = edge["b"], edge["a"]
            edge["course"] = edge.get("course", [])[::-1]
    assert Building.from_json(shuffled) == building


def test_the_content_id_is_pinned_and_knows_content_from_label():
    building = Building.from_json(document())
    # Results refer to buildings by this id: a change here orphans them
    assert building.content_id == "081ae056bb59d2d794145b701113afd530e15f33faeb27909477cd6f448ca1cb"
    assert 0 <= building.map_id < 2**63
    assert building.map_id == int(building.content_id, 16) >> 193
    renamed = document() | {"name": "other", "provenance": {"source": "elsewhere"}}
    assert Building.from_json(renamed) == building
    wider = document()
    wider["edges"][0]["width_m"] = 1.1
    assert Building.from_json(wider) != building
    assert building != "flat"
    bent = document()
    bent["edges"][1]["course"] = [[8, 1]]
    assert Building.from_json(bent) != building


def test_a_course_runs_from_the_lower_node_to_the_higher_one():
    bent = document()
    bent["edges"][1]["course"] = [[8, 1], [6, 1]]  # from node 2 to node 1
    building = Building.from_json(bent)
    assert building.edges[1].tolist() == [1, 2]
    assert building.line_m(1).tolist() == [[3, 0], [6, 1], [8, 1], [10, 0]]
    assert building.line_m(0).tolist() == [[0, 0], [3, 0]]
    assert [edge.get("course") for edge in building.to_json()["edges"]] == [None, [[6, 1], [8, 1]], None]
    with pytest.raises(ValueError, match="read-only"):
        building.course_m[1][0] = 0


def test_files_have_one_node_and_one_edge_per_line(tmp_path):
    building = Building.from_json(document())
    building.save(tmp_path / "flat.json")
    lines = (tmp_path / "flat.json").read_text().splitlines()
    assert sum('"kind"' in line for line in lines) == building.n_nodes
    assert sum('"length_m"' in line for line in lines) == building.n_edges


def test_kinds_classes_and_sizes_are_read_as_written():
    building = Building.from_json(document())
    assert building.kind.tolist() == [ROOM, FEATURE, INTERSECTION, FEATURE]
    assert building.feature_class.tolist() == [NONE, DOOR, NONE, CORNER]
    assert building.area_m2.tolist() == [12.5, 0, 0, 0]
    assert building.obstacles.tolist() == [2, 0, 0, 0]
    assert (building.n_nodes, building.n_edges) == (4, 3)
    assert repr(building) == "Building('flat': 1 room, 1 intersection, 2 features, 3 edges)"


def test_arrays_cannot_be_changed():
    given = np.array([[0, 1], [1, 2]])
    building = Building("x", [1, 1, 1], [1, 1, 1], [[0, 0], [1, 0], [2, 0]], [0] * 3, [0] * 3, given, [1, 1], [2, 2], 0)
    given[0, 0] = 2
    assert building.edges[0, 0] == 0
    for name in (
        "kind",
        "position_m",
        "edges",
        "length_m",
        "outline_m",
        "indptr",
        "neighbour",
        "degree",
        "coverage",
    ):
        with pytest.raises(ValueError, match="read-only"):
            getattr(building, name).flat[0] = 0
    with pytest.raises(AttributeError):
        building.start = 1


@settings(deadline=None, derandomize=True, max_examples=60)
@given(buildings())
def test_the_default_outline_is_the_hull_grown_by_two_metres(building):
    import shapely

    exact = shapely.MultiPoint(building.position_m).convex_hull
    outline = shapely.Polygon(building.outline_m)
    assert outline.is_valid
    # 32 points to the circle keep 2 m · cos(π / 32) on the sides between them, to the millimetre
    assert outline.covers(exact.buffer(2 * math.cos(math.pi / 32) - 0.002))
    assert exact.buffer(2.002, quad_segs=64).covers(outline)


def test_the_hull_of_points_on_a_line_is_a_capsule():
    import shapely

    outline = shapely.Polygon(buffered_hull(np.array([[0.0, 0.0], [5.0, 0.0], [10.0, 0.0]]), 1.0))
    disc = 16 * math.sin(math.pi / 16)  # a 32-gon of radius 1
    assert outline.area == pytest.approx(20 + disc, abs=0.02)


def test_networkx_gets_every_attribute():
    building = Building.from_json(document())
    graph = building.to_networkx()
    assert graph.graph == {"name": "flat", "start": 0}
    assert graph.nodes[0] == {"kind": "room", "x": 0.0, "y": 0.0, "area_m2": 12.5, "obstacles": 2}
    assert graph.nodes[1]["class"] == "door"
    assert graph.edges[1, 2] == {"length_m": 7.0, "width_m": 2.0}
    assert sorted(map(sorted, graph.edges)) == building.edges.tolist()


def put(*path):
    """A change to a document: the value at the end of a path of keys; ``...`` removes."""
    *keys, last, value = path

    def change(doc):
        for key in keys:
            doc = doc[key]
        if value is ...:
            del doc[last]
        else:
            doc[last] = value

    return change


FAULTS = [
    (put("edges", 1, "a", 9), "edge 1-9: node 9 does not exist"),
    (put("edges", 1, "a", -1), "edge -1-1: node -1 does not exist"),
    (put("edges", 1, "a", 1), "edge 1-1 joins node 1 to itself"),
    (lambda d: d["edges"].append({"a": 1, "b": 0, "length_m": 4, "width_m": 1}), "edge 0-1 is there twice"),
    (put("edges", 2, ...), "node 3 cannot be reached from start 0"),
    (put("edges", []), "node 1 cannot be reached"),
    (put("edges", 0, "length_m", 0), "edge 0-1: length_m is 0.0"),
    (put("edges", 0, "length_m", -2), "edge 0-1: length_m is -2.0"),
    (put("edges", 1, "width_m", 0), "edge 1-2: width_m is 0.0"),
    (put("edges", 1, "width_m", math.inf), "edge 2-1: field 'width_m': expected a finite number, found inf"),
    (put("edges", 1, "width_m", "wide"), "edge 2-1: field 'width_m': expected a finite number, found 'wide'"),
    (put("edges", 1, "width_m", ...), r"edges\[1\]: field 'width_m' is missing"),
    (put("edges", 1, "colour", "red"), r"edges\[1\]: unknown field 'colour'"),
    (put("edges", 1, "a", True), r"edges\[1\]: field 'a': expected a whole number from .* found True"),
    (put("edges", 1, "a", 1.5), r"edges\[1\]: field 'a': expected a whole number from .* found 1.5"),
    (put("edges", 1, [1, 2]), r"edges\[1\]: expected an object, found list"),
    (put("edges", 1, "course", 7), "edge 2-1: field 'course': expected a list, found int"),
    (put("edges", 1, "course", [[1, 2], [3]]), r"edge 2-1: course point 1: expected \[x, y\]"),
    (put("edges", 1, "course", [[1, 1e9]]), "edge 2-1: course: point 0: expected finite metres"),
    (put("edges", 1, "course", [[1, 1]] * 1001), "edge 2-1: course: expected at most 1,000 points, found 1,001"),
    (put("edges", None), "field 'edges': expected a list, found NoneType"),
    (put("nodes", 2, "x", math.nan), "node 2: field 'x': expected a finite number, found nan"),
    (put("nodes", 2, "x", 10**400), "node 2: field 'x': expected a finite number, found a number of 401 digits"),
    (put("nodes", 2, "x", 1e9), "node 2: position is .*; expected finite metres"),
    (put("nodes", 2, "id", 3), "node 2: id is 3; expected ids 0, 1, 2 … in order"),
    (
        put("nodes", 2, "kind", "hall"),
        "node 2: field 'kind': expected room, intersection, feature, found 'hall'",
    ),
    (put("nodes", 2, "kind", ["room"]), "node 2: field 'kind'"),
    (put("nodes", 2, "area_m2", 4), r"node 2 \(intersection\): unknown field 'area_m2'"),
    (put("nodes", 1, "class", ...), r"node 1 \(feature\): field 'class' is missing"),
    (
        put("nodes", 1, "class", "window"),
        "node 1: field 'class': expected bend, corner, door, other, found 'window'",
    ),
    (put("nodes", 1, "class", {}), "node 1: field 'class'"),
    (put("nodes", 0, "area_m2", ...), r"node 0 \(room\): field 'area_m2' is missing"),
    (put("nodes", 0, "area_m2", 0), "node 0: area_m2 is 0.0; a room needs an area above 0"),
    (put("nodes", 0, "obstacles", -1), "node 0: obstacles is -1"),
    (put("nodes", 0, "obstacles", 1.5), "node 0: field 'obstacles': expected a whole number"),
    (put("nodes", 0, 7), "node 0: expected an object, found int"),
    (put("nodes", []), "expected at least 2 nodes, found 0"),
    (put("start", 4), "start: expected a whole number from 0 to 3, found 4"),
    (put("start", True), "start: expected a whole number from 0 to 3, found True"),
    (put("start", ...), "field 'start' is missing"),
    (put("name", 5), "expected a name, found 5"),
    (put("provenance", []), "field 'provenance': expected an object"),
    (put("height", 3), "unknown field 'height'"),
    (put("format", "tasklift-policy"), "expected format 'tasklift-building'"),
    (put("outline", [[-3, -3], [13, 8], [13, -3], [-3, 8]]), "outline is not a simple polygon"),
    (put("outline", [[0, 0], [1, 1]]), "outline: expected at least 3 points, found 2"),
    (put("outline", [[0, 0], [1, 1], [2, 2]]), "outline is not a simple polygon"),
    (put("outline", 1, [1]), "outline point 1: expected"),
    (put("outline", 1, [1, None]), "outline point 1: field 'y': expected a finite number"),
    (put("outline", [[-3, -3], [5, -3], [5, 8], [-3, 8]]), r"node 2 at \(10, 0\) lies outside the outline"),
]


@pytest.mark.parametrize(("change", "message"), FAULTS, ids=[message[:40] for _, message in FAULTS])
def test_faults_are_named(change, message):
    faulty = document()
    change(faulty)
    with pytest.raises(TaskliftError, match=message) as caught:
        Building.from_json(faulty, "flat.json")
    assert str(caught.value).startswith("flat.json: ")
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize(
    ("field", "value", "message"),
    [
        ("kind", [0, 1, 3, 1], "node 2: kind is 3"),
        ("kind", [0, 1, 1.5, 1], "kind: whole numbers"),
        ("feature_class", [1, 1, 1, 1], "node 1: class is 1; a feature needs a class"),
        ("feature_class", [1, 4, 4, 3], "node 2: class is 4; only features have a class"),
        ("position_m", np.zeros((3, 2)), r"position_m: expected shape \(4, 2\), found \(3, 2\)"),
        ("position_m", np.full((4, 2), np.nan), "node 0: position"),
        ("area_m2", [9, 0, 1, 0], "node 2: area_m2 is 1.0; only rooms have an area"),
        ("obstacles", [9, 0, 1, 0], "node 2: obstacles is 1; only rooms have obstacles"),
        ("length_m", [1, math.nan, 1], "edge 1-2: length_m is nan"),
        ("length_m", ["a", "b", "c"], "length_m: numbers expected"),
        ("edges", [[0, 1]], r"length_m: expected shape \(1\), found \(3,\)"),
        ("course_m", [[]], "course_m: expected one for each of 3 edges, found 1"),
        ("provenance", {"a": object()}, "provenance is not plain JSON"),
        ("provenance", {"a": math.nan}, "provenance is not plain JSON"),
    ],
)
def test_faults_in_arrays_are_named(field, value, message):
    good = Building.from_json(document())
    fields = {name: getattr(good, name) for name in good.__dataclass_fields__}
    with pytest.raises(TaskliftError, match=message):
        Building(**fields | {field: value})


@settings(deadline=None, derandomize=True, max_examples=400)
@given(st.data())
def test_no_change_to_a_document_gives_anything_but_a_building_or_a_clear_error(data):
    changed = document()
    place = changed
    while True:
        key = data.draw(st.sampled_from(sorted(place) if isinstance(place, dict) else range(len(place))))
        if not isinstance(place[key], dict | list) or not place[key] or data.draw(st.booleans()):
            break
        place = place[key]
    anything = st.recursive(
        st.none() | st.booleans() | st.integers() | st.floats() | st.text(max_size=3),
        lambda inner: st.lists(inner, max_size=2) | st.dictionaries(st.text(max_size=2), inner, max_size=2),
        max_leaves=4,
    )
    if data.draw(st.booleans()):
        place[key] = data.draw(anything)
    elif isinstance(place, dict):
        place[data.draw(st.text(max_size=3))] = place.pop(key)
    else:
        place.insert(key, copy.deepcopy(place[key]))
    refusal = None
    try:
        building = Building.from_json(changed, "here")
    except TaskliftError as error:
        refusal = str(error)
    if refusal is None:
        assert Building.from_json(json.loads(canonical_json(building.to_json()))) == building
    else:
        assert refusal.startswith("here: ")
        assert "\n" not in refusal
        assert len(refusal) < 400


def test_a_file_cut_short_anywhere_is_refused(tmp_path):
    path = tmp_path / "flat.json"
    Building.from_json(document()).save(path)
    text = path.read_text()
    for end in range(0, len(text.rstrip()) - 1, 7):
        path.write_text(text[:end])
        with pytest.raises(TaskliftError, match=r"flat\.json: not valid JSON"):
            Building.load(path)


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("[]", "expected a tasklift-building file"),
        (
            '{"format": "tasklift-building", "version": 2}',
            "version 2 of tasklift-building is not readable here",
        ),
        ('{"format": "tasklift-building", "version": 1, "name": NaN}', "found NaN"),
        ('{"format": "tasklift-building", "version": 1, "name": 1e999}', "expected a finite number, found inf"),
    ],
)
def test_other_files_are_refused(tmp_path, text, message):
    path = tmp_path / "odd.json"
    path.write_text(text)
    with pytest.raises(TaskliftError, match=message):
        Building.load(path)


def test_a_missing_file_is_named(tmp_path):
    with pytest.raises(TaskliftError, match="nowhere"):
        Building.load(Path(tmp_path) / "nowhere.json")


def test_edges_may_be_shorter_or_longer_than_the_straight_distance():
    bent = document()
    bent["edges"][0]["length_m"] = 2.5
    bent["edges"][1]["length_m"] = 70
    assert Building.from_json(bent).length_m.tolist() == [2.5, 70.0, 5.01]
