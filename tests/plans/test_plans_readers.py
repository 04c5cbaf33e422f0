"""Reading maps: the three modes of ROS, open-rmf, and one clear line for everything that is not a map."""

from __future__ import annotations

import contextlib
import io
import struct
import zlib
from pathlib import Path

import numpy as np
import pytest
from hypothesis import HealthCheck, example, given, settings
from hypothesis import strategies as st
from PIL import Image
from plans_measure import needs_maps

from tasklift.errors import TaskliftError
from tasklift.plans.importing import import_map, read_plan
from tasklift.plans.pictures import Picture
from tasklift.plans.plan import LARGEST_PIXELS
from tasklift.plans.read import find_reader
from tasklift.plans.source import Source

FUZZ = settings(
    derandomize=True,
    deadline=None,
    max_examples=80,
    suppress_health_check=[HealthCheck.function_scoped_fixture, HealthCheck.too_slow],
)
HEAD = "resolution: 0.05\norigin: [0, 0, 0]\nnegate: 0\noccupied_thresh: 0.65\nfree_thresh: 0.196\n"


def pgm(pixels: np.ndarray, largest: int = 255) -> bytes:
    height, width = pixels.shape
    return b"P5\n# a remark\n%d %d\n%d\n" % (width, height, largest) + pixels.astype(np.uint8).tobytes()


def two_rooms() -> np.ndarray:
    grey = np.full((120, 220), 205, np.uint8)
    grey[10:110, 10:210] = 0
    grey[14:106, 14:106] = 254
    grey[14:106, 114:206] = 254
    grey[50:68, 100:120] = 254
    return grey


def write_map(folder: Path, text: str | None = None, image: bytes | None = None, name: str = "map.pgm") -> Path:
    if image is not None:
        (folder / name).write_bytes(image)
    path = folder / "map.yaml"
    path.write_text(f"image: {name}\n{HEAD}" if text is None else text)
    return path


def png(pixels: np.ndarray, mode: str) -> bytes:
    buffer = io.BytesIO()
    Image.fromarray(pixels).convert(mode).save(buffer, "PNG")
    return buffer.getvalue()


def png_header(width: int, height: int) -> bytes:
    def chunk(kind: bytes, data: bytes) -> bytes:
        return struct.pack(">I", len(data)) + kind + data + struct.pack(">I", zlib.crc32(kind + data))

    header = chunk(b"IHDR", struct.pack(">IIBBBBB", width, height, 8, 0, 0, 0, 0))
    return b"\x89PNG\r\n\x1a\n" + header + chunk(b"IDAT", zlib.compress(b"\0" * 1000)) + chunk(b"IEND", b"")


# -- what is read ------------------------------------------------------------------------------------


@pytest.mark.parametrize("negate", [0, 1, "false", "true"])
@pytest.mark.parametrize("mode", ["trinary", "scale", "raw"])
def test_every_grey_value_in_every_mode(tmp_path: Path, mode: str, negate: int | str) -> None:
    x = np.arange(256, dtype=np.uint8)[None]
    text = f"image: map.pgm\nmode: {mode}\n{HEAD}".replace("negate: 0", f"negate: {negate}")
    plan = read_plan(write_map(tmp_path, text, pgm(x)))
    for value in range(256):
        p = value / 255 if negate in (1, "true") else (255 - value) / 255
        if mode == "raw":
            p = value / 100
            free, unknown = p < 0.196, p > 1 or 0.196 <= p <= 0.65
        else:
            free, unknown = p < 0.196, 0.196 <= p <= 0.65
            if mode == "scale" and unknown:
                free, unknown = p < (0.196 + 0.65) / 2, False
        assert (plan.free[0, value], plan.unknown[0, value]) == (free, unknown), value


def test_p2_p5_png_and_16_bit_are_the_same_plan(tmp_path: Path) -> None:
    grey = two_rooms()
    height, width = grey.shape
    ascii_pgm = f"P2\n# by hand\n{width} {height} # size\n255\n{' '.join(map(str, grey.ravel()))}\n".encode()
    wide = b"P5 %d %d 65535\n" % (width, height) + (grey.astype(">u2") * 257).tobytes()
    expected = read_plan(write_map(tmp_path, image=pgm(grey)))
    for image, name in (
        (ascii_pgm, "map.pgm"),
        (wide, "map.pgm"),
        (png(grey, "L"), "map.png"),
        (png(grey, "RGB"), "c.png"),
    ):
        plan = read_plan(write_map(tmp_path, image=image, name=name))
        assert np.array_equal(plan.free, expected.free)
        assert np.array_equal(plan.unknown, expected.unknown)


def test_trinary_averages_alpha_in(tmp_path: Path) -> None:
    pixels = np.zeros((1, 2, 4), np.uint8)
    pixels[0, 0] = (255, 255, 255, 255)
    pixels[0, 1] = (255, 255, 255, 0)  # the mean of four channels is 191: p = 0.25, unknown
    plan = read_plan(write_map(tmp_path, image=png(pixels, "RGBA"), name="a.png"))
    assert plan.free.tolist() == [[True, False]]
    assert plan.unknown.tolist() == [[False, True]]


def test_unknown_that_is_shown_as_free_is_doubted(tmp_path: Path) -> None:
    text = f"image: map.pgm\n{HEAD}".replace("0.196", "0.25")
    plan = read_plan(write_map(tmp_path, text, pgm(two_rooms())))
    assert any("unknown shown as free" in doubt for doubt in plan.doubts)
    assert not read_plan(write_map(tmp_path, image=pgm(two_rooms()))).doubts


@given(st.floats(-100, 100), st.floats(-100, 100), st.floats(-3, 3), st.floats(0.01, 1))
@FUZZ
def test_pixels_and_metres_are_inverse(x: float, y: float, yaw: float, resolution: float) -> None:
    from tasklift.plans.plan import Plan

    free = np.zeros((30, 50), bool)
    plan = Plan("p", free, free, free.astype(np.uint8), resolution, (x, y, yaw))
    points = np.array([[0.0, 0.0], [30.0, 0.0], [12.5, 49.0]])
    assert np.allclose(plan.to_pixels(plan.to_world(*points.T)), points, atol=1e-6)
    assert np.allclose(plan.to_world(np.array([30.0]), np.array([0.0])), [[x, y]])


def test_two_rooms_and_a_door(tmp_path: Path) -> None:
    building, _ = import_map(write_map(tmp_path, image=pgm(two_rooms())))
    assert repr(building).endswith("2 rooms, 0 intersections, 1 feature, 2 edges)")
    door = building.position_m[building.feature_class == 4][0]
    assert np.hypot(*(door - [5.5, 3.05])) < 0.3
    rooms = np.sort(building.area_m2[building.kind == 0])
    assert np.allclose(rooms, 4.6 * 4.6, rtol=0.05)


# -- what is refused ---------------------------------------------------------------------------------

GOOD = pgm(two_rooms())
BAD_YAML = {
    "not a mapping": ("- 1\n- 2\n", "is not a map that is read here"),
    "not a map": ("name: x\nvalue: 3\n", "it has the fields"),
    "not YAML": ("image: [1, 2\n", "not valid YAML"),
    "no image": (HEAD, "'image' is missing"),
    "no resolution": (f"image: map.pgm\n{HEAD}".replace("resolution: 0.05\n", ""), "'resolution' is missing"),
    "zero resolution": (f"image: map.pgm\n{HEAD}".replace("0.05", "0"), "number above 0"),
    "negative resolution": (f"image: map.pgm\n{HEAD}".replace("0.05", "-1"), "number above 0"),
    "resolution that is no number": (f"image: map.pgm\n{HEAD}".replace("0.05", ".nan"), "'resolution'"),
    "origin of two": (f"image: map.pgm\n{HEAD}".replace("[0, 0, 0]", "[0, 0]"), "[x, y, yaw]"),
    "origin of words": (f"image: map.pgm\n{HEAD}".replace("[0, 0, 0]", "[a, b, c]"), "[x, y, yaw]"),
    "no negate": (f"image: map.pgm\n{HEAD}".replace("negate: 0\n", ""), "'negate'"),
    "negate 2": (f"image: map.pgm\n{HEAD}".replace("negate: 0", "negate: 2"), "expected 0 or 1"),
    "no threshold": (f"image: map.pgm\n{HEAD}".replace("free_thresh: 0.196\n", ""), "'free_thresh' is missing"),
    "threshold above 1": (f"image: map.pgm\n{HEAD}".replace("0.65", "65"), "'occupied_thresh'"),
    "threshold below 0": (f"image: map.pgm\n{HEAD}".replace("0.196", "-0.1"), "'free_thresh'"),
    "thresholds crossed": (f"image: map.pgm\n{HEAD}".replace("0.65", "0.1"), "swap them"),
    "unknown mode": (f"image: map.pgm\nmode: quaternary\n{HEAD}", "trinary, scale, raw"),
    "image that is no name": (f"image: [1]\n{HEAD}", "name of a file"),
    "image that is not there": (f"image: mop.pgm\n{HEAD}", "there is 'map.pgm'"),
    "image that is a folder": (f"image: .\n{HEAD}", "does not exist"),
    "image outside": (f"image: ../../x.pgm\n{HEAD}", "does not exist; there is 'map.pgm'"),
    "absolute image": (f"image: /etc/hostname\n{HEAD}", "leaves the folder"),
    "objects": (f"image: !!python/object/apply:os.getcwd []\n{HEAD}", "without tags"),
    "aliases": (f"a: &a [x, x]\nb: &b [*a, *a]\nimage: map.pgm\n{HEAD}", "aliases are not allowed"),
    "nested deeply": ("image: " + "[" * 5000, "nested more than 50 deep"),
    "a number too long": (f"image: map.pgm\n{HEAD}".replace("0.05", "9" * 5000), ""),
    "a date that is none": (f"image: 2001-99-99\n{HEAD}", "does not exist"),
    "empty": ("", "is empty"),
}
BAD_IMAGES = {
    "no picture": (b"hello, this is text", "not a picture"),
    "empty picture": (b"", "not a picture"),
    "zero width": (b"P5 0 10 255\n", "holds no plan"),
    "zero height": (b"P5 10 0 255\n", "holds no plan"),
    "cut short": (GOOD[:-100], "cut short"),
    "P2 cut short": (b"P2 3 2 255\n1 2 3 4", "cut short"),
    "P2 with words": (b"P2 3 2 255\n1 2 three 4 5 6", "whole numbers only"),
    "P2 out of range": (b"P2 2 1 255\n1 300", "outside the announced range"),
    "PGM header only": (b"P5 ", "damaged PGM header"),
    "largest value 0": (b"P5 2 2 0\n1234", "expected 1 to 65535"),
    "a bomb in PGM": (b"P5 99999 99999 255\n0", "limit of 400,000,000"),
    "a bomb in PNG": (png_header(60_000, 60_000), "limit of 400,000,000"),
    "a large PNG": (png_header(10_000, 6_000), "damaged or cut short"),
    "PNG of zero size": (png_header(0, 5), "PNG"),
    "PNG cut short": (png(two_rooms(), "L")[:200], "PNG"),
    "all occupied": (pgm(np.zeros((50, 50))), "no free space"),
    "all unknown": (pgm(np.full((50, 50), 205)), "no free space"),
    "free slits only": (pgm(np.tile([[0, 254, 0]], (50, 20))), "no free space wider"),
}


def assert_one_line(error: TaskliftError, part: str) -> None:
    message = str(error)
    assert part in message
    assert "\n" not in message.strip(), message
    assert len(message) < 600


@pytest.mark.parametrize("case", BAD_YAML)
def test_bad_yaml(tmp_path: Path, case: str) -> None:
    text, part = BAD_YAML[case]
    path = write_map(tmp_path, text, GOOD)
    with pytest.raises(TaskliftError) as caught:
        import_map(path)
    assert_one_line(caught.value, part)
    assert str(path) in str(caught.value)


@pytest.mark.parametrize("case", BAD_IMAGES)
def test_bad_images(tmp_path: Path, case: str) -> None:
    image, part = BAD_IMAGES[case]
    with pytest.raises(TaskliftError) as caught:
        import_map(write_map(tmp_path, image=image))
    assert_one_line(caught.value, part)


def test_what_is_no_map(tmp_path: Path) -> None:
    for name, data, part in (
        ("picture.pgm", GOOD, "is a picture; give the YAML"),
        ("building.json", b'{"format":"tasklift-building"}', "version None"),
        ("large.yaml", b"a: " + b"x" * 5_000_000, "4,000,000"),
        ("latin.yaml", b"image: \xe9\xff", "UTF-8"),
    ):
        (tmp_path / name).write_bytes(data)
        with pytest.raises(TaskliftError) as caught:
            import_map(tmp_path / name)
        assert_one_line(caught.value, part)
    for missing in ("nothing.yaml", "."):
        with pytest.raises(TaskliftError, match="cannot be read"):
            find_reader(Source(tmp_path / missing))


def test_outside_is_followed_when_allowed(tmp_path: Path) -> None:
    (tmp_path / "map.pgm").write_bytes(GOOD)
    inner = tmp_path / "inner"
    inner.mkdir()
    path = write_map(inner, f"image: ../map.pgm\n{HEAD}")
    assert import_map(path, allow_outside=True)[0].n_nodes == 3


def test_a_link_that_leads_outside_is_refused(tmp_path: Path) -> None:
    (tmp_path / "map.pgm").write_bytes(GOOD)
    inner = tmp_path / "inner"
    inner.mkdir()
    (inner / "map.pgm").symlink_to(tmp_path / "map.pgm")
    with pytest.raises(TaskliftError, match="leaves the folder"):
        import_map(write_map(inner))


def test_ctcv_names_the_file_that_is_there() -> None:
    path = needs_maps() / "patrolling_sim" / "ctcv" / "ctcv.yaml"
    with pytest.raises(TaskliftError, match=r"'ctcv_map.pgm' does not exist; there is 'ctcv.pgm'"):
        import_map(path)


# -- options -----------------------------------------------------------------------------------------


def test_options(tmp_path: Path) -> None:
    path = write_map(tmp_path, image=GOOD)
    building, _ = import_map(path, start=(8.0, 3.0))
    assert building.position_m[building.start][0] > 5.5
    building, _ = import_map(path, seed_point=(2.0, 3.0), door_rule="absolute")
    assert building.n_nodes == 3
    for options, part in (
        ({"door_rule": "guess"}, "relative, absolute"),
        ({"narrowest_m": 0.0}, "narrowest passage"),
        ({"narrowest_m": float("nan")}, "narrowest passage"),
        ({"smallest_room_m2": -1.0}, "smallest room"),
        ({"seed_point": (0.1, 0.1)}, "not on free space"),
        ({"seed_point": (1e5, 1e5)}, "not on free space"),
        ({"start": 99}, "does not exist"),
    ):
        with pytest.raises(TaskliftError, match=part):
            import_map(path, **options)


def test_several_free_regions_are_doubted(tmp_path: Path) -> None:
    grey = np.concatenate([two_rooms(), two_rooms()[:, :110], np.zeros((120, 4), np.uint8)], axis=1)
    grey[14:106, 320:326] = 0
    grey[50:68, 100 + 220 : 110 + 220] = 0
    _, doubts = import_map(write_map(tmp_path, image=pgm(grey)))
    assert any("several free regions" in doubt and "left out 1" in doubt for doubt in doubts)


# -- open-rmf ----------------------------------------------------------------------------------------

RMF = """
coordinate_system: reference_image
levels:
  L1:
    vertices: [[0, 0, 0, ""], [200, 0, 0, ""], [200, 100, 0, ""], [0, 100, 0, ""], [100, 0, 0, ""],
               [100, 40, 0, ""], [100, 60, 0, ""], [100, 100, 0, ""], [50, 50, 0, a], [150, 50, 0, b]]
    walls: [[0, 1, {}], [1, 2, {}], [2, 3, {}], [3, 0, {}], [4, 5, {}], [6, 7, {}]]
    doors: [[5, 6, {name: [1, door]}]]
    lanes: [[8, 9, {}]]
    measurements: [[0, 1, {distance: [3, 10.0]}]]
    floors: [{vertices: [0, 1, 2, 3]}]
"""


def test_rmf_rooms_and_doors_are_exact(tmp_path: Path) -> None:
    path = tmp_path / "x.building.yaml"
    path.write_text(RMF)
    building, doubts = import_map(path)
    assert repr(building).endswith("2 rooms, 0 intersections, 1 feature, 2 edges)")
    assert not doubts
    assert np.allclose(building.position_m[building.feature_class == 4], [[5.0, -2.5]], atol=0.1)
    assert np.allclose(building.area_m2[building.kind == 0], 25.0, rtol=0.05)


@pytest.mark.parametrize(
    ("old", "new", "part"),
    [
        ("levels:", "floors:", "is not a map"),
        ("  L1:", "  L1: {}\n  L2:", "choose one with --level"),
        ("[4, 5, {}]", "[4, 99, {}]", "walls[4]"),
        ("[4, 5, {}]", "[4, x, {}]", "walls[4]"),
        ("[5, 6, {name: [1, door]}]", "[5]", "doors[0]"),
        ('[0, 0, 0, ""], [200', '[0, .inf, 0, ""], [200', "vertex 0"),
        ("distance: [3, 10.0]", "distance: [3, 0.0]", "measurement 0-1"),
        ("measurements: [[0, 1, {distance: [3, 10.0]}]]", "measurements: []", "tells the scale"),
        ("distance: [3, 10.0]", "distance: [3, 900000.0]", "is the measurement right"),
        ("reference_image", "wgs84", "coordinate system"),
        ("{vertices: [0, 1, 2, 3]}", "{vertices: [0, 1]}", "floors[0]"),
    ],
)
def test_bad_rmf(tmp_path: Path, old: str, new: str, part: str) -> None:
    assert old in RMF
    path = tmp_path / "x.building.yaml"
    path.write_text(RMF.replace(old, new))
    with pytest.raises(TaskliftError) as caught:
        import_map(path)
    assert_one_line(caught.value, part)


def test_rmf_level_by_name(tmp_path: Path) -> None:
    path = tmp_path / "x.building.yaml"
    path.write_text(RMF)
    assert read_plan(path, level="L1").name == "x L1"
    with pytest.raises(TaskliftError, match="no level 'L9'"):
        import_map(path, level="L9")


@pytest.mark.parametrize(("name", "level"), [("office", "L1"), ("hotel", "L2")])
def test_real_rmf_buildings(name: str, level: str) -> None:
    path = needs_maps() / "rmf_demos" / f"{name}.building.yaml"
    building, doubts = import_map(path, level=level)
    plan = read_plan(path, level=level)
    assert plan.doors_m is not None
    found = int((building.feature_class == 4).sum())
    print(f"{name} {level}: {building!r}; {found} of {len(plan.doors_m)} doors; {doubts}")
    assert found >= len(plan.doors_m) - 1
    assert not (building.feature_class == 4).sum() > len(plan.doors_m)


# -- fuzzing: only our own error type may come out ---------------------------------------------------


def survives(path: Path) -> None:
    with contextlib.suppress(TaskliftError):
        import_map(path)


@given(st.binary(max_size=400))
@example(b"P5 3 3 255\n" + b"\0" * 9)
@FUZZ
def test_fuzz_images(tmp_path: Path, data: bytes) -> None:
    for prefix in (b"", b"P5 4 4 255\n", b"P2 2 2 9\n", b"\x89PNG\r\n\x1a\n", png_header(4, 4)[:33]):
        (tmp_path / "x").write_bytes(prefix + data)
        try:
            picture = Picture(tmp_path / "x")
            assert picture.band(0, picture.height)[0].size <= LARGEST_PIXELS
        except TaskliftError:
            pass


@given(st.integers(0, len(GOOD) - 1), st.binary(min_size=1, max_size=8), st.booleans())
@FUZZ
def test_fuzz_pictures_that_were_right(tmp_path: Path, at: int, data: bytes, is_png: bool) -> None:
    image = png(two_rooms(), "L") if is_png else GOOD
    at = at % min(len(image), 400)
    survives(write_map(tmp_path, image=image[:at] + data + image[at + len(data) :]))


VALUES = st.recursive(
    st.none() | st.booleans() | st.integers() | st.floats() | st.text(max_size=6),
    lambda inner: st.lists(inner, max_size=4) | st.dictionaries(st.text(max_size=4), inner, max_size=3),
    max_leaves=8,
)
FIELDS = ("image", "resolution", "origin", "negate", "occupied_thresh", "free_thresh", "mode")


@given(st.dictionaries(st.sampled_from(FIELDS), VALUES, min_size=1))
@FUZZ
def test_fuzz_ros_fields(tmp_path: Path, changed: dict) -> None:
    import yaml

    good = {"image": "map.pgm", "resolution": 0.05, "origin": [0, 0, 0], "negate": 0, "occupied_thresh": 0.65}
    fields = good | {"free_thresh": 0.196} | changed
    survives(write_map(tmp_path, yaml.safe_dump(fields, allow_unicode=True), GOOD))


@given(st.sampled_from(["vertices", "walls", "doors", "lanes", "measurements", "floors"]), VALUES)
@FUZZ
def test_fuzz_rmf_fields(tmp_path: Path, key: str, value: object) -> None:
    import yaml

    document = yaml.safe_load(RMF)
    document["levels"]["L1"][key] = value
    path = tmp_path / "x.building.yaml"
    path.write_text(yaml.safe_dump(document, allow_unicode=True), encoding="utf-8")
    survives(path)


@given(st.text(max_size=200) | st.lists(st.sampled_from(["1", "0", "-1", "x", "1e9", "nan", "2.5"])).map(" ".join))
@FUZZ
def test_fuzz_any_text(tmp_path: Path, text: str) -> None:
    path = tmp_path / "x"
    path.write_text(text, encoding="utf-8")
    survives(path)
