"""Correcting, checking, drawing and exporting buildings, and the command line around it."""

from __future__ import annotations

import os
import subprocess
import sys
import xml.etree.ElementTree as ElementTree
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import shapely
from click.testing import CliRunner
from hypothesis import given, settings
from hypothesis import strategies as st
from PIL import Image
from plans_measure import read_graph
from test_plans_readers import pgm, two_rooms, write_map

import tasklift
from tasklift.building.generate import generate
from tasklift.building.graph import BEND, DOOR, FEATURE, INTERSECTION, NONE, OTHER, ROOM, Building
from tasklift.building.search import hostile_candidates
from tasklift.cli.plans import map_group
from tasklift.errors import TaskliftError
from tasklift.plans.check import check, node_lines
from tasklift.plans.edits import HEADER, STRAIGHT, apply_edits, parse_edits, read_edits
from tasklift.plans.exporting import export
from tasklift.plans.importing import import_map, read_plan
from tasklift.plans.overlay import LARGEST_PICTURE, draw_overlay


def ladder() -> Building:
    """A room (0 0), a corridor (5 0) (10 0) (15 0) with a bend, and a way around over (10 4)."""
    return Building(
        name="ladder",
        kind=np.array([ROOM, INTERSECTION, FEATURE, INTERSECTION, FEATURE]),
        feature_class=np.array([NONE, NONE, BEND, NONE, OTHER]),
        position_m=np.array([[0.0, 0], [5, 0], [10, 0], [15, 0], [10, 4]]),
        area_m2=np.array([9.0, 0, 0, 0, 0]),
        obstacles=np.zeros(5, int),
        edges=np.array([[0, 1], [1, 2], [2, 3], [1, 4], [3, 4]]),
        length_m=np.array([5.0, 5.0, 5.0, 6.5, 6.5]),
        width_m=np.array([1.0, 2.0, 2.0, 2.0, 2.0]),
        start=0,
    )


def edited(*lines: str, building: Building | None = None) -> Building:
    return apply_edits(building or ladder(), parse_edits("\n".join([HEADER, *lines])))[0]


def test_drop_node_joins_its_neighbours() -> None:
    building = edited("drop node at 10.2 0.1")
    assert building.n_nodes == 4
    joined = building.edges.tolist().index([1, 2])
    assert building.length_m[joined] == 10.0


def test_merge_move_and_classes() -> None:
    building = edited("merge nodes at 10 0 and 10 4")
    assert (building.n_nodes, building.n_edges) == (4, 3)
    building = edited(
        "move node at 10 0 to 10 -1", "set class at 10 -1 to corner", "set class at 10 4 to room area 12 obstacles 3"
    )
    assert building.position_m[2].tolist() == [10, -1]
    assert np.isclose(building.length_m[building.edges.tolist().index([1, 2])], np.hypot(5, 1))
    assert (building.area_m2[4], building.obstacles[4]) == (12, 3)


def test_doors_edges_and_the_start() -> None:
    building = edited("add door at 2.5 0.1", "drop edge from 10 0 to 15 0", "start at 15 0  # a remark")
    door = int(np.flatnonzero(building.feature_class == DOOR)[0])
    assert building.degree[door] == 2
    assert building.length_m[: len(building.edges)].sum() == pytest.approx(5 + 5 + 6.5 + 6.5)
    assert building.start == 3
    building = edited("drop node at 10 4", "add edge from 0 0 to 10 0 length 11 width 1.5")
    edge = building.edges.tolist().index([0, 2])
    assert (building.length_m[edge], building.width_m[edge]) == (11, 1.5)


def test_edits_are_remembered_and_apply_again_to_other_numbers() -> None:
    lines = ["add door at 2.5 0", "set class at 10 4 to bend"]
    building = ladder()
    assert edited(*lines).provenance["edits"] == lines
    order = np.array([3, 0, 4, 1, 2])
    number = np.argsort(order)
    shuffled = Building(
        name="other",
        kind=building.kind[order],
        feature_class=building.feature_class[order],
        position_m=building.position_m[order] + 0.2,
        area_m2=building.area_m2[order],
        obstacles=building.obstacles[order],
        edges=number[building.edges],
        length_m=building.length_m,
        width_m=building.width_m,
        start=int(number[0]),
    )
    assert check(edited(*lines, building=shuffled)).counts == check(edited(*lines)).counts


@pytest.mark.parametrize(
    ("line", "part"),
    [
        ("drop node at 50 50", "no node within 1.5 m of 50 50; the nearest is at"),
        ("drop node at 0 0", "the robots start there"),
        ("drop node at 5 0", "would cut off 1 nodes"),
        ("drop edge from 0 0 to 5 0", "would cut off 1 nodes"),
        ("drop edge from 0 0 to 15 0", "no corridor joins"),
        ("merge nodes at 5 0 and 5.1 0", "the same node"),
        ("add door at 5.01 0", "at the end of a corridor"),
        ("add door at 50 50", "no corridor within"),
        ("add edge from 0 0 to 5 0", "joined already"),
        ("add edge from 0 0 to 15 0 width 0", "at least 0.05 m"),
        ("set class at 5 0 to cupboard", "no class 'cupboard'"),
        ("set class at 5 0 to room", "needs its area"),
        ("set class at 5 0 to door area 3", "only a room"),
        ("move node at 5 0 to 1e9 0", "not a distance within a building"),
        ("start at 9 9", "no node within"),
    ],
)
def test_an_edit_that_does_not_apply_says_why(line: str, part: str) -> None:
    with pytest.raises(TaskliftError) as caught:
        edited(line)
    assert part in str(caught.value)
    assert "line 2" in str(caught.value)
    assert line in str(caught.value)


@pytest.mark.parametrize(
    ("text", "part"),
    [
        ("", "expected 'tasklift-edits 1' in the first line, found nothing"),
        ("drop node at 1 2", "in the first line"),
        (f"{HEADER}\nremove everything", "line 2: no edit begins like"),
        (f"{HEADER}\n\n# x\ndrop node at 1", "line 4: cannot read"),
        (f"{HEADER}\ndrop node at 1.2.3 4", "is not a number"),
        (f"{HEADER}\ndrop node 1.5", "cannot read"),
        (f"{HEADER}\nadd door at node {'7' * 5000}", "cannot read"),
        (f"{HEADER}\nset class at 1 2 to room area x", "cannot read"),
    ],
)
def test_an_edits_file_that_cannot_be_read(tmp_path: Path, text: str, part: str) -> None:
    (tmp_path / "e").write_text(text)
    with pytest.raises(TaskliftError) as caught:
        apply_edits(ladder(), read_edits(tmp_path / "e"))
    assert part in str(caught.value)


PLACE = st.tuples(st.floats(-2, 17), st.floats(-2, 6)).map(lambda p: f"{p[0]:.2f} {p[1]:.2f}")
LINE = st.one_of(
    PLACE.map("drop node at {}".format),
    PLACE.map("add door at {}".format),
    st.tuples(PLACE, PLACE).map(lambda p: f"merge nodes at {p[0]} and {p[1]}"),
    st.tuples(PLACE, PLACE).map(lambda p: f"move node at {p[0]} to {p[1]}"),
    st.tuples(PLACE, PLACE).map(lambda p: f"add edge from {p[0]} to {p[1]}"),
    st.tuples(PLACE, PLACE).map(lambda p: f"drop edge from {p[0]} to {p[1]}"),
    st.text(max_size=30),
)


@given(st.lists(LINE, max_size=6))
@settings(derandomize=True, deadline=None, max_examples=200)
def test_any_edits_give_a_building_or_our_error(lines: list[str]) -> None:
    try:
        building = edited(*lines)
    except TaskliftError:
        return
    assert Building.from_json(building.to_json()) == building


def test_check_counts_and_warns() -> None:
    found = check(ladder())
    assert found.counts == {"room": 1, "intersection": 2, "bend": 1, "corner": 0, "door": 0, "other": 1, "edge": 5}
    assert (found.degrees, found.loops, found.bridges) == ({1: 1, 2: 3, 3: 1}, 1, 1)
    text = "\n".join(found.lines())
    assert "no doors: hostiles hide at bends" in text
    assert len(hostile_candidates(ladder())) > 0
    assert any("no place for a hostile" in warning for warning in check(edited("add door at 1 0")).warnings)
    assert "intersections with two corridors" in text
    assert len(node_lines(ladder())) == 5
    assert not any("no doors" in warning for warning in check(generate(seed=1)).warnings)
    short = edited("move node at 10 4 to 10 0.3")
    assert any("within 0.4 m" in warning for warning in check(short).warnings)


@pytest.mark.parametrize("suffix", [".png", ".svg"])
def test_overlays_on_the_plan_and_without(tmp_path: Path, suffix: str) -> None:
    path = write_map(tmp_path, image=pgm(two_rooms()))
    building, _ = import_map(path, tmp_path / "b.json", tmp_path / f"o{suffix}")
    assert Building.load(tmp_path / "b.json") == building
    draw_overlay(building, tmp_path / f"p{suffix}")
    for name in ("o", "p"):
        picture = tmp_path / f"{name}{suffix}"
        if suffix == ".png":
            with Image.open(picture) as image:
                assert min(image.size) > 200
        else:
            words = [e.text for e in ElementTree.parse(picture).iter("{http://www.w3.org/2000/svg}text")]
            assert {"0", "1", "2", "room (2)", "door (1)", "start"} <= set(words)
    before = (tmp_path / f"o{suffix}").read_bytes()
    draw_overlay(building, tmp_path / f"o{suffix}", read_plan(path))
    assert (tmp_path / f"o{suffix}").read_bytes() == before
    with pytest.raises(TaskliftError, match=r"\.png or \.svg"):
        draw_overlay(building, tmp_path / "o.bmp")


def test_export_and_back(tmp_path: Path) -> None:
    drawn = generate(seed=1)
    export(drawn, tmp_path / "b.graph")
    again = read_graph(tmp_path / "b.graph", add_doors=False)
    assert np.array_equal(again.edges, drawn.edges)
    remarks = export(drawn, tmp_path / "b.yaml")
    assert remarks == ["the picture is b.pgm"]
    building, doubts = import_map(tmp_path / "b.yaml")
    assert int((building.kind == ROOM).sum()) == 6
    assert not doubts
    export(drawn, tmp_path / "b.json")
    assert Building.load(tmp_path / "b.json") == drawn
    assert any("sketch" in remark for remark in export(ladder(), tmp_path / "l.yaml", 0.1))
    for name, resolution, part in (
        ("b.docx", 0.05, "ends in"),
        ("b.yaml", -1.0, "resolution"),
        ("b.graph", 0.0, "resolution"),
    ):
        with pytest.raises(TaskliftError, match=part):
            export(drawn, tmp_path / name, resolution)


def test_the_command_line(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    write_map(tmp_path, image=pgm(two_rooms()))
    (tmp_path / "e.txt").write_text(f"{HEADER}\nset class at 5.5 3 to other\n")
    run = CliRunner().invoke
    for arguments, part in (
        ("import map.yaml", "2 rooms, 0 intersections, 1 feature"),
        ("import map.yaml -o x.json --overlay x.svg --start 8,3 --edits e.txt", "2 rooms"),
        ("show map.json -o s.png --plan map.yaml", "wrote s.png"),
        ("check map.json --nodes", "door"),
        ("edit map.json e.txt -o y.json --overlay y.png", "2 rooms"),
        ("export map.json m.graph", "no kinds"),
        ("export map.json m2.yaml", "sketch"),
        ("generate -o g.json --seed 4", "6 rooms"),
    ):
        result = run(map_group, arguments.split(), catch_exceptions=False)
        assert result.exit_code == 0, result.output
        assert part in result.output
    written = "map.json map-graph.png x.json x.svg s.png y.json y.png m.graph m2.pgm g.json"
    for name in written.split():
        assert (tmp_path / name).stat().st_size > 0
    assert run(map_group, ["import", "map.yaml", "--start", "a,b"]).exit_code == 2
    assert run(map_group, ["import", "map.yaml", "--seed-point", "3"]).exit_code == 2
    result = run(map_group, ["import", "nothing.yaml"])
    assert isinstance(result.exception, TaskliftError)  # which tasklift's main prints as one line, exit code 2


def test_a_large_picture_keeps_its_thin_walls(tmp_path: Path) -> None:
    grey = np.full((LARGEST_PICTURE + 200, 300), 254, np.uint8)
    grey[:4] = grey[-4:] = grey[:, :4] = grey[:, -4:] = 0
    grey[1001] = 0  # one pixel thick
    grey[1001, 100:130] = 254
    plan = read_plan(write_map(tmp_path, image=pgm(grey)))
    building, _ = import_map(tmp_path / "map.yaml")
    assert int((building.feature_class == DOOR).sum()) == 1
    draw_overlay(building, tmp_path / "large.png", plan)
    drawn = np.asarray(Image.open(tmp_path / "large.png").convert("L"))
    wall = (drawn < 100).mean(axis=1) > 0.05  # rows in which a wall is drawn
    assert wall[drawn.shape[0] // 3 : drawn.shape[0] // 2 + 50].any()


def test_nodes_can_be_named_by_number_and_are_kept_as_places() -> None:
    """Numbers are those of the building before the edits, also after some of its nodes are gone."""
    by_number = edited("drop node 2", "merge nodes 3 and 4", "set class node 1 to bend", "add edge from 0 to 3")
    by_place = edited("drop node at 10 0", "merge nodes at 15 0 and 10 4", "set class at 5 0 to bend",
                      "add edge from 0 0 to 15 0")  # fmt: skip
    assert by_number == by_place
    assert by_number.provenance["edits"][0] == "drop node at 10.000 0.000"
    again = apply_edits(ladder(), parse_edits("\n".join([HEADER, *by_number.provenance["edits"]])))[0]
    assert again == by_number
    with pytest.raises(TaskliftError, match="node 99 does not exist; nodes are 0 to 4"):
        edited("drop node 99")


def test_rooms_and_nodes_can_be_added() -> None:
    room = "add room at 12 3 area 12.8 obstacles 2 to 12 0.2"
    building = edited(room, "add node at 7 -2 to 5 0", "add node at 2 0.1")
    assert building.n_nodes == 9
    room = int(np.flatnonzero(building.area_m2 == 12.8)[0])
    assert (building.kind[room], building.obstacles[room]) == (ROOM, 2)
    (way,) = building.neighbour[building.indptr[room] : building.indptr[room + 1]].tolist()
    assert building.position_m[way].tolist() == [12, 0]
    assert building.kind[way] == INTERSECTION
    assert building.length_m.sum() == pytest.approx(ladder().length_m.sum() + 3 + np.hypot(2, 2))
    alone = edited("add room at 20 0 area 9")
    assert alone.degree[5] == 1
    assert alone.neighbour[alone.indptr[5]] == 3


def test_corridors_keep_their_course() -> None:
    bent = replace(ladder(), course_m=(STRAIGHT, np.array([[5.0, 2.0], [10.0, 2.0]]), *[STRAIGHT] * 3))
    one = edited("add door at 7 2", building=bent)
    door = int(np.flatnonzero(one.feature_class == DOOR)[0])
    lines = [one.line_m(e).tolist() for e in range(one.n_edges) if door in one.edges[e]]
    assert lines == [[[5, 0], [5, 2], [7, 2]], [[10, 0], [10, 2], [7, 2]]]
    back = edited("drop node at 7 2", building=one)
    assert shapely.equals(shapely.LineString(back.line_m(1)).simplify(0), shapely.LineString(bent.line_m(1)))
    assert back.length_m.sum() == pytest.approx(bent.length_m.sum())


def test_all_bad_lines_are_reported_and_nothing_is_written(tmp_path: Path) -> None:
    ladder().save(tmp_path / "a.json")
    (tmp_path / "a.edits").write_text(f"{HEADER}\ndrop node 99\nadd door at 2 0\ndrop node at 50 50\nstart at 5 0\n")
    run = subprocess.run(
        [sys.executable, "-m", "tasklift", "map", "edit", "a.json", "a.edits", "-o", "b.json"],
        cwd=tmp_path, capture_output=True, text=True, check=False,
        env=os.environ | {"PYTHONPATH": str(Path(tasklift.__file__).parents[1])},
    )  # fmt: skip
    assert run.returncode == 2
    assert [line.split(":")[2] for line in run.stderr.splitlines()] == [" line 2", " line 4"]
    assert not (tmp_path / "b.json").exists()
    with pytest.raises(TaskliftError, match="line 2") as caught:
        parse_edits(f"{HEADER}\nnonsense\ndrop node\n")
    assert "line 3" in caught.value.__notes__[0]


def test_a_byte_order_mark_and_windows_line_ends_are_accepted(tmp_path: Path) -> None:
    (tmp_path / "a.edits").write_bytes(b"\xef\xbb\xbf" + HEADER.encode() + b"\r\ndrop node 2\r\n")
    assert apply_edits(ladder(), read_edits(tmp_path / "a.edits"))[0].n_nodes == 4


def test_places_can_be_written_and_apply_to_another_import(tmp_path: Path) -> None:
    ladder().save(tmp_path / "a.json")
    (tmp_path / "a.edits").write_text(f"{HEADER}\ndrop node 2\nadd room at 12 3 area 5 to node 4\n")
    run = CliRunner().invoke(
        map_group,
        [
            "edit", str(tmp_path / "a.json"), str(tmp_path / "a.edits"), "-o", str(tmp_path / "b.json"),
            "--places", str(tmp_path / "kept.edits"),
        ],
    )  # fmt: skip
    assert run.exit_code == 0, run.output
    assert "node 2" not in (tmp_path / "kept.edits").read_text()
    again, _ = apply_edits(ladder(), read_edits(tmp_path / "kept.edits"))
    assert again == Building.load(tmp_path / "b.json")


def gray(path: Path) -> np.ndarray:
    with Image.open(path) as image:
        return np.asarray(image.convert("L"), float)


def test_the_plan_lies_beneath_pictures_of_an_imported_building(tmp_path: Path) -> None:
    export(generate(seed=7), tmp_path / "seven.yaml")
    building, _ = import_map(tmp_path / "seven.yaml", tmp_path / "seven.json", tmp_path / "with.png")
    draw_overlay(Building.load(tmp_path / "seven.json"), tmp_path / "kept.png")
    draw_overlay(replace(building, provenance={}), tmp_path / "sketch.png")
    pictures = [gray(tmp_path / f"{name}.png") for name in ("with", "kept", "sketch")]
    assert pictures[0].shape == pictures[1].shape
    assert np.abs(pictures[0] - pictures[1]).mean() < 1.0
    assert pictures[2].shape != pictures[0].shape or np.abs(pictures[0] - pictures[2]).mean() > 5.0


def test_pictures_grow_with_the_number_of_nodes_and_keep_their_legend(tmp_path: Path) -> None:
    draw_overlay(ladder(), tmp_path / "small.svg")
    text = (tmp_path / "small.svg").read_text()
    for word in ("room (1)", "junction (2)", "bend (1)", "other feature (1)", "start"):
        assert word in text
    draw_overlay(generate(150, 170, 100, 50, seed=1), tmp_path / "large.png")
    assert max(gray(tmp_path / "large.png").shape) > 2500
