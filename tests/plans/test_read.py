"""Every reader: its samples, damage, what a drawing says, and what is named that is not a map."""

from __future__ import annotations

import shutil
from pathlib import Path

import numpy as np
import pytest
from click.testing import CliRunner

from tasklift.building.graph import DOOR, ROOM
from tasklift.cli.plans import map_group
from tasklift.errors import TaskliftError
from tasklift.plans.importing import import_map
from tasklift.plans.read import find_reader, load_building, read_map, readers
from tasklift.plans.source import Source
from tasklift.testing import check_reader

# One folder for each reader, with its files and what belongs to them
SAMPLES = Path(__file__).parent / "samples"
OPTIONS = {"picture": {"resolution_m": 0.25}, "movingai": {"resolution_m": 0.25}}
BESIDE = (".pgm",)


def samples(name: str) -> list[Path]:
    return sorted(path for path in (SAMPLES / name).iterdir() if path.suffix not in BESIDE)


def name_of(reader: object) -> str:
    return reader.__name__.rpartition(".")[2]


@pytest.mark.parametrize("reader", readers(), ids=name_of)
def test_a_reader_keeps_its_promises(reader) -> None:
    name = name_of(reader)
    check_reader(reader, samples(name), options=OPTIONS.get(name), damaged=100)


@pytest.mark.parametrize("name", [name_of(reader) for reader in readers() if name_of(reader) != "building"])
def test_samples_become_buildings(name: str) -> None:
    for path in samples(name):
        building, _ = import_map(path, **OPTIONS.get(name, {}))
        assert building.n_nodes >= 3


def test_a_reader_that_breaks_a_promise_is_found_out(tmp_path: Path) -> None:
    class Careless:
        TITLE = "careless"

        def recognises(self, source: Source) -> bool:
            return source.head.startswith(b"places")

        def read(self, source: Source):
            count = int(source.text.split()[1])
            good = Source(samples("patrolling")[0])
            return find_reader(good).read(good) if count else None

    path = tmp_path / "three.places"
    path.write_text("places 3 and more")
    with pytest.raises(AssertionError, match=r"three\.places: (ValueError|IndexError|AttributeError|read gives)"):
        check_reader(Careless(), [path])
    with pytest.raises(AssertionError, match="does not recognise it"):
        check_reader(Careless(), samples("lif"))


# -- what a format says --------------------------------------------------------------------------------


def names(building) -> dict[str, str]:
    return building.provenance["names"]


def test_names_of_waypoints_become_names_of_nodes() -> None:
    for name, expected in (
        ("strands", {"Hall", "Desk", "Store"}),
        ("nav2_route", {"dock", "lab"}),
        ("rmf_graph", {"dock", "office", "lab"}),
        ("graphml", {"dock", "lab", "1"}),
        ("lif", {"n1", "n2", "Rack 1"}),
    ):
        building = load_building(samples(name)[-1])
        assert set(names(building).values()) == expected, name
        for node in names(building):
            assert 0 <= int(node) < building.n_nodes


def test_an_edge_is_as_long_as_its_line() -> None:
    building = load_building(samples("nav2_route")[0])
    assert building.length_m.sum() == pytest.approx(5 + 2 * np.hypot(2, 3), abs=1e-3)
    assert load_building(samples("graphml")[0]).length_m.sum() == pytest.approx(np.hypot(4, 0.5) + 8.5, abs=1e-3)


def test_two_rooms_of_every_drawing_have_their_size_and_door() -> None:
    for path in (*samples("dxf"), samples("osm")[0], samples("rmf")[0]):
        building, _ = import_map(path)
        assert np.allclose(building.area_m2[building.kind == ROOM], 25, rtol=0.06), path
        assert int((building.feature_class == DOOR).sum()) == 1, path


def test_units_of_a_drawing(tmp_path: Path) -> None:
    text = samples("dxf")[0].read_text()
    (tmp_path / "mm.dxf").write_text(text.replace("70\n6", "70\n4"))
    with pytest.raises(TaskliftError, match=r"close no floor.*--resolution"):
        import_map(tmp_path / "mm.dxf")
    building, _ = import_map(tmp_path / "mm.dxf", resolution_m=2.0)
    assert np.allclose(building.area_m2[building.kind == ROOM], 100, rtol=0.06)
    (tmp_path / "none.dxf").write_text(text.replace("70\n6", "70\n0"))
    assert any("names no unit" in doubt for doubt in import_map(tmp_path / "none.dxf")[1])
    (tmp_path / "plain.dxf").write_text(text.replace("A-WALL", "0"))
    assert any("no layer is named like walls" in doubt for doubt in import_map(tmp_path / "plain.dxf")[1])


def test_lanes_without_walls_are_a_graph(tmp_path: Path) -> None:
    text = samples("rmf")[0].read_text()
    path = tmp_path / "lanes.building.yaml"
    path.write_text("\n".join(line for line in text.splitlines() if "walls" not in line and "doors" not in line))
    building, doubts = import_map(path)
    assert set(names(building).values()) == {"a", "b"}
    assert int((building.kind == ROOM).sum()) == 2
    assert building.length_m.sum() == pytest.approx(5, abs=0.01)
    assert any("no walls" in doubt for doubt in doubts)


def test_a_scale_instead_of_a_measurement(tmp_path: Path) -> None:
    path = tmp_path / "x.building.yaml"
    path.write_text(samples("rmf")[0].read_text().replace("measurements:", "others:"))
    with pytest.raises(TaskliftError, match=r"no measurement .* --scale"):
        import_map(path)
    assert np.allclose(import_map(path, resolution_m=0.05)[0].area_m2[:2], 25, rtol=0.06)


def test_an_edge_that_is_listed_twice_is_taken_once(tmp_path: Path) -> None:
    path = tmp_path / "twice.graph"
    path.write_text(samples("patrolling")[0].read_text().replace("1 30 10 2", "1 30 10 3\n0 S 20"))
    building, doubts = import_map(path)
    assert building.n_edges == 2
    assert any("edge 1-0 is listed twice" in doubt for doubt in doubts)


@pytest.mark.parametrize("name", [name_of(reader) for reader in readers()])
def test_byte_order_marks_are_passed_over(tmp_path: Path, name: str) -> None:
    for path in samples(name):
        shutil.copytree(path.parent, tmp_path, dirs_exist_ok=True)
        data = path.read_bytes()
        if not data.startswith(b"\x89PNG"):
            (tmp_path / path.name).write_bytes(b"\xef\xbb\xbf" + data)
        read_map(Source(tmp_path / path.name, **OPTIONS.get(name, {})))


def test_places_that_no_way_joins_are_left_out(tmp_path: Path) -> None:
    path = tmp_path / "g.geojson"
    lone = '{"type": "Feature", "properties": {"id": 99}, "geometry": {"type": "Point", "coordinates": [50, 50]}}'
    path.write_text(samples("nav2_route")[0].read_text().replace('"features": [', f'"features": [{lone},'))
    building, doubts = import_map(path)
    assert building.n_nodes == 3
    assert any("1 places that no way joins" in doubt for doubt in doubts)


# -- ROS, as yaml-cpp reads it -------------------------------------------------------------------------


def ros(folder: Path, old: str, new: str) -> Path:
    shutil.copytree(SAMPLES / "ros", folder, dirs_exist_ok=True)
    text = (folder / "office.yaml").read_text()
    assert old in text
    (folder / "office.yaml").write_text(text.replace(old, new))
    return folder / "office.yaml"


@pytest.mark.parametrize(
    ("old", "new", "doubt"),
    [
        ("0.25", '"0.25"', ""),
        ("0.25", "25e-2", ""),
        ("negate: 0", 'negate: "no"', ""),
        ("2.0, 0.0]", "2.0, -nan]", "yaw"),
        ("2.0, 0.0]", "2.0, .nan]", "yaw"),
        ("image: office.pgm", "image: /home/robot/maps/office.pgm", "beside the YAML"),
        ("image: office.pgm", "image: ~/maps/office.pgm", "beside the YAML"),
        ("image: office.pgm", "image: 'C:\\maps\\office.pgm'", "beside the YAML"),
    ],
)
def test_maps_as_map_server_reads_them(tmp_path: Path, old: str, new: str, doubt: str) -> None:
    expected, _ = import_map(SAMPLES / "ros" / "office.yaml")
    building, doubts = import_map(ros(tmp_path, old, new))
    assert building == expected
    assert any(doubt in found for found in doubts) or not doubt
    assert bool(doubts) == bool(doubt)


@pytest.mark.parametrize("kind", ["bmp", "jpg", "tif", "ppm", "png", "gif", "webp"])
def test_all_kinds_of_pictures(tmp_path: Path, kind: str) -> None:
    from PIL import Image

    path = ros(tmp_path, "office.pgm", f"office.{kind}")
    mode = "RGBA" if kind == "png" else "RGB"
    grey = Image.open(tmp_path / "office.pgm").convert(mode)
    grey.save(tmp_path / f"office.{kind}", **({"lossless": True} if kind == "webp" else {}))
    building, doubts = import_map(path)
    assert int((building.kind == ROOM).sum()) == 2
    assert any("JPEG" in doubt for doubt in doubts) == (kind == "jpg")


def test_a_plain_picture_needs_its_resolution(tmp_path: Path) -> None:
    path = samples("picture")[0]
    with pytest.raises(TaskliftError, match="--resolution"):
        import_map(path)
    with pytest.raises(TaskliftError, match="above 0"):
        import_map(path, resolution_m=0.0)
    assert int((import_map(path, resolution_m=0.25)[0].kind == ROOM).sum()) == 2


def test_a_very_large_sheet_is_cut_to_what_is_drawn_on_it(tmp_path: Path) -> None:
    """Sixty million pixels, of which an office takes 1,056; its places stay what they are."""
    from PIL import Image

    path = ros(tmp_path, "office.pgm", "office.png")
    office = Image.open(tmp_path / "office.pgm")
    expected, _ = import_map(SAMPLES / "ros" / "office.yaml")
    sheet = Image.new("L", (10_000, 6_000), 205)
    sheet.paste(office, (7_000, 2_000))
    sheet.save(tmp_path / "office.png")
    building, _ = import_map(path)
    away = [7_000 * 0.25, (6_000 - 2_000 - office.height) * 0.25]
    assert np.allclose(building.position_m, expected.position_m + away, atol=0.01)


# -- what is refused is named --------------------------------------------------------------------------

FOREIGN = {
    "git lfs pull": b"version https://git-lfs.github.com/spec/v1\noid sha256:0\nsize 1\n",
    "is a PDF": b"%PDF-1.7\n",
    "DWG": b"AC1032\0\0",
    "unpack": b"PK\x03\x04abc",
    "SVG": b"<svg xmlns='http://www.w3.org/2000/svg'></svg>",
    "web page": b"<!DOCTYPE html>\n<html></html>",
    "ROS bag": b"#ROSBAG V2.0\n",
    "PCD": b"# .PCD v0.7\n",
    "IFC": b"ISO-10303-21;\n",
    "Gazebo": b"<?xml version='1.0'?><sdf version='1.6'></sdf>",
    "document type": b"<?xml version='1.0'?><!DOCTYPE x [<!ENTITY a 'b'>]><osm/>",
    "'tasklift-policy'": b'{"format": "tasklift-policy", "version": 1}',
    "is empty": b" \n",
    "not a map that is read": b"hello",
    "binary DXF": b"AutoCAD Binary DXF\r\n\x1a\0",
}


@pytest.mark.parametrize("part", FOREIGN)
def test_other_files_are_named(tmp_path: Path, part: str) -> None:
    path = tmp_path / "thing"
    path.write_bytes(FOREIGN[part])
    with pytest.raises(TaskliftError, match=part) as caught:
        import_map(path)
    assert str(caught.value).startswith(str(path))
    if part in ("git lfs pull", "is a PDF"):
        with pytest.raises(TaskliftError, match=part):
            import_map(ros(tmp_path, "office.pgm", "thing"))


def test_a_pipe_is_not_waited_for(tmp_path: Path) -> None:
    import os

    os.mkfifo(tmp_path / "pipe")
    for path in (tmp_path / "pipe", "/dev/zero"):
        with pytest.raises(TaskliftError, match="not a plain file"):
            import_map(path)


# -- commands ------------------------------------------------------------------------------------------


def run(*arguments: str) -> str:
    result = CliRunner().invoke(map_group, [str(argument) for argument in arguments], catch_exceptions=False)
    return result.output


def test_what_takes_a_building_takes_every_graph(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    for name in ("patrolling", "strands", "nav2_route", "lif", "graphml", "rmf_graph", "building"):
        path = samples(name)[0]
        assert "corridors" in run("check", path, "--nodes")
        assert "wrote" in run("show", path, "-o", f"{name}.png")
    with pytest.raises(TaskliftError, match="is a floor plan, not a building"):
        load_building(SAMPLES / "ros" / "office.yaml")
    with pytest.raises(TaskliftError, match="is a floor plan, not a building"):
        load_building(samples("picture")[0])
    assert len(run("formats").splitlines()) == len(readers())


def test_nothing_of_the_users_is_overwritten(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    ros(tmp_path, "office.pgm", "office.png")
    shutil.copy(samples("picture")[0], tmp_path / "office.png")
    plan = (tmp_path / "office.png").read_bytes()
    run("import", "office.yaml")
    assert {"office.json", "office-graph.png"} <= {path.name for path in tmp_path.iterdir()}
    first = (tmp_path / "office.json").read_bytes()
    (tmp_path / "office.edits").write_text("tasklift-edits 1\n")
    for arguments in (
        ("import", "office.yaml"),
        ("import", "office.yaml", "-o", "other.json", "--overlay", "office.png", "--force"),
        ("import", "office.yaml", "-o", "office.yaml", "--force"),
        ("import", "office.yaml", "-o", "other.png"),
        ("import", "office.yaml", "-o", "other.json", "--overlay", "other.json"),
        ("export", "office.json", "other.yml.txt"),
        ("export", "office.json", "office.json", "--force"),
        ("generate", "-o", "office.json"),
        ("show", "office.json", "-o", "office.png"),
        ("show", "office.json", "-o", "office.json", "--force"),
        ("show", "office.json", "-o", "office.png", "--plan", "office.yaml", "--force"),
        ("edit", "office.json", "office.edits", "-o", "other.json", "--places", "other.json"),
    ):
        with pytest.raises(TaskliftError):
            run(*arguments)
    assert (tmp_path / "office.png").read_bytes() == plan
    assert (tmp_path / "office.json").read_bytes() == first
    assert "wrote" in run("import", "office.yaml", "--force")
    (tmp_path / "plan.pgm").write_bytes(b"mine")
    with pytest.raises(TaskliftError, match=r"plan\.pgm: is there already"):
        run("export", "office.json", "plan.yaml")
    assert (tmp_path / "plan.pgm").read_bytes() == b"mine"
    assert not (tmp_path / "plan.yaml").exists()


def test_two_floors_have_two_names(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    shutil.copytree(SAMPLES / "ros", tmp_path, dirs_exist_ok=True)
    for floor in "12":
        shutil.copy("office.yaml", f"floor.{floor}.yaml")
        run("import", f"floor.{floor}.yaml")
    assert {"floor.1.json", "floor.2.json"} <= {path.name for path in tmp_path.iterdir()}


def test_the_drawing_of_a_building_is_never_written(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    text = samples("rmf")[0].read_text() + "    drawing: {filename: small-graph.png}\n"
    (tmp_path / "small.building.yaml").write_text(text)
    (tmp_path / "small-graph.png").write_bytes(b"mine")
    with pytest.raises(TaskliftError, match="is read by this command"):
        run("import", "small.building.yaml", "--force")
    assert (tmp_path / "small-graph.png").read_bytes() == b"mine"
