"""Files: bounded and checked when read, never half-written, never overwritten unasked."""

from __future__ import annotations

import io
import os
import stat
import tempfile
import tracemalloc
import zipfile
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from tasklift import files
from tasklift.checks import DEEPEST, plain
from tasklift.errors import TaskliftError
from tasklift.files import output_file, output_folder, parse_arrays, parse_json, parse_toml, read_bytes, read_text

# -- writing -----------------------------------------------------------------------------------------------


def test_a_file_is_replaced_in_one_piece_or_stays(tmp_path: Path) -> None:
    path = tmp_path / "a.txt"
    files.write_atomically(path, "old")
    with pytest.raises(TypeError), files.writing(path) as file:
        file.write(b"half of the n" + None)  # type: ignore[operator]
    assert path.read_text() == "old"
    with pytest.raises(TaskliftError, match=r"a\.txt: is there already; choose another name, or say --force"):
        files.write_atomically(path, "new", replace=False)
    assert path.read_text() == "old"
    files.write_atomically(path, "new")
    assert path.read_text() == "new"
    assert os.listdir(tmp_path) == ["a.txt"]


def test_a_new_file_has_the_mode_of_any_new_file(tmp_path: Path) -> None:
    files.write_atomically(tmp_path / "a", "")
    (tmp_path / "b").touch()
    assert (tmp_path / "a").stat().st_mode == (tmp_path / "b").stat().st_mode


def test_a_link_is_replaced_and_not_followed(tmp_path: Path) -> None:
    precious, link = tmp_path / "precious", tmp_path / "link"
    precious.write_text("precious")
    link.symlink_to(precious)
    files.write_atomically(link, "rows")
    assert precious.read_text() == "precious"
    assert not link.is_symlink()
    link.unlink()
    link.symlink_to(tmp_path / "nowhere")
    with pytest.raises(TaskliftError, match="is there already"):
        files.write_atomically(link, "rows", replace=False)


def test_what_killed_writers_left_is_removed_and_what_others_write_is_not(tmp_path: Path) -> None:
    left = tmp_path / f".tasklift-{'0' * 16}.part"
    left.write_text("left")
    own = tmp_path / ".tasklift-notes.part"
    own.write_text("the user's")
    with files.writing(tmp_path / "a") as first:
        first.write(b"a")
        assert not left.exists()
        files.write_atomically(tmp_path / "b", "b")
        assert len(list(tmp_path.glob(".tasklift-*.part"))) == 2  # the first writer's, and the user's
    assert (tmp_path / "a").read_text() == "a"
    assert sorted(os.listdir(tmp_path)) == [".tasklift-notes.part", "a", "b"]


@pytest.mark.parametrize("path", ["no/such/folder/a", "a\0b", "x" * 300])
def test_a_place_that_cannot_be_is_named(path: str, tmp_path: Path) -> None:
    with pytest.raises(TaskliftError, match="cannot be"):
        files.write_atomically(tmp_path / path, "")


def test_two_outputs_of_one_name_are_refused(tmp_path: Path) -> None:
    one, two = tmp_path / "one.json", tmp_path / "two.png"
    assert files.output_files((one, (".json",)), (None, ()), (two, (".png",))) == [one, two]
    with pytest.raises(TaskliftError, match="is named for two outputs"):
        files.output_files((one, ()), (two, ()), (tmp_path / "." / "one.json", ()), force=True)


def test_outputs_are_refused_before_anything_is_lost(tmp_path: Path) -> None:
    source, there = tmp_path / "policy.json", tmp_path / "there.csv"
    source.write_text("read")
    there.write_text("kept")
    assert output_file(tmp_path / "new.CSV", (".csv",)) == tmp_path / "new.CSV"
    assert output_file(there, (".csv",), force=True) == there
    for path, options, message in (
        (there, {}, "is there already"),
        (tmp_path / "table.xlsx", {}, r"expected a name that ends in \.csv"),
        (tmp_path / "no" / "a.csv", {}, "the folder .*no does not exist"),
        (tmp_path / "a\0.csv", {}, "cannot be a file's name"),
        (tmp_path / f"{'x' * 300}.csv", {}, "cannot be a file's name"),
    ):
        with pytest.raises(TaskliftError, match=message):
            output_file(path, (".csv",), **options)
    with pytest.raises(TaskliftError, match="is a folder"):
        output_file(tmp_path, force=True)
    for alias in ("policy.json", "./policy.json", "hard", "soft", f"../{tmp_path.name}/policy.json"):
        if alias == "hard":
            os.link(source, tmp_path / alias)
        elif alias == "soft":
            (tmp_path / alias).symlink_to(source)
        with pytest.raises(TaskliftError, match="is read by this command, and never written"):
            output_file(tmp_path / alias, force=True, reads=[source])
    assert there.read_text() == "kept"


def test_a_folder_is_new_or_empty_or_the_commands_own(tmp_path: Path) -> None:
    own = ("experiment.sqlite",)
    folder = output_folder(tmp_path / "a" / "b", own)
    assert output_folder(folder, own) == folder
    (folder / ".hidden").touch()
    assert output_folder(folder, own) == folder
    (folder / "report.html").touch()
    with pytest.raises(TaskliftError, match=r"is not empty and holds no experiment\.sqlite"):
        output_folder(folder, own)
    (folder / "experiment.sqlite").touch()
    assert output_folder(folder, own) == folder
    for place in (folder / "report.html", folder / "report.html" / "c", tmp_path / "a\0b"):
        with pytest.raises(TaskliftError, match="cannot be a folder"):
            output_folder(place, own)


# -- reading -----------------------------------------------------------------------------------------------


def test_only_plain_files_of_moderate_size_are_read(tmp_path: Path) -> None:
    os.mkfifo(tmp_path / "pipe")
    (tmp_path / "large").write_bytes(b"12345")
    for path, message in (
        (tmp_path / "pipe", "is not a plain file"),
        ("/dev/zero", "is not a plain file"),
        (tmp_path, "cannot be read"),
        (tmp_path / "missing", "cannot be read"),
        (tmp_path / "a\0b", "cannot be read"),
        (tmp_path / "large", "larger than 4 bytes"),
    ):
        with pytest.raises(TaskliftError, match=message):
            read_bytes(path, 4)
    assert read_bytes(tmp_path / "large", 5) == b"12345"


def test_text_is_read_alike_from_every_system(tmp_path: Path) -> None:
    path = tmp_path / "a"
    path.write_bytes(b"\xef\xbb\xbfone\r\ntwo\rthree\n")
    assert read_text(path) == "one\ntwo\nthree\n"
    path.write_bytes(b"\xed\xa0\x80")
    with pytest.raises(TaskliftError, match="expected UTF-8 text, found other bytes at offset 0"):
        read_text(path)


HOSTILE_JSON = [
    ("7" * 5000, "too many digits"),
    ("[1e400]", "expected a finite number, found inf"),
    ("[-1e400]", "expected a finite number, found -inf"),
    ("NaN", "expected a finite number, found NaN"),
    ('["\\ud800"]', "half a surrogate pair"),
    ('{"\\ud800": 1}', "half a surrogate pair"),
    ('"\\u0000"', "a control character"),
    ('"\\u001b[2J"', "a control character"),
    ("[" * 200 + "]" * 200, "nested more than 100 deep"),
    ("[" * 100_000, "nested too deeply"),
    ('{"a": ' * 100_000, "nested too deeply"),
    ("18446744073709551616", "at most 64 bits"),
    ('{"a": 1, "b": 2, "a": 3}', "the field 'a' is there twice"),
    ('{"a": 1', "line 1, column 8"),
    ("", "line 1, column 1"),
]


@pytest.mark.parametrize(("text", "message"), HOSTILE_JSON, ids=[message for _, message in HOSTILE_JSON])
def test_hostile_json_is_refused(text: str, message: str) -> None:
    with pytest.raises(TaskliftError, match=f"^x: .*{message}"):
        parse_json(text, "x")


HOSTILE_TOML = [
    (f"a = {'7' * 5000}", "out of range"),
    ("a = inf", "expected a finite number, found inf"),
    ("a = nan", "expected a finite number, found nan"),
    ("a = 1e400", "expected a finite number, found inf"),
    ("a = 2026-01-01", "expected text or a number, found datetime.date"),
    ("a = 2026-13-01", "not valid TOML|out of range"),
    ("a = " + "[" * 50_000, "nested too deeply"),
    ('a = "\\u0000"', "a control character"),
    ("a" + ".a" * 60_000 + " = 1", "a key of more than 50 parts"),
    ("[" + "a . " * 60_000 + "a]", "a key of more than 50 parts"),
    ("[" + '"a". ' * 20_000 + "a]", "a key of more than 50 parts"),
    ("#" * 300_000, "longer than"),
    ("a = 1\na = 2", "not valid TOML"),
]


@pytest.mark.parametrize(("text", "message"), HOSTILE_TOML, ids=[message for _, message in HOSTILE_TOML])
def test_hostile_toml_is_refused(text: str, message: str) -> None:
    with pytest.raises(TaskliftError, match=f"^x: .*({message})"):
        parse_toml(text, "x")


@given(
    st.recursive(
        st.none() | st.booleans() | st.integers() | st.floats() | st.text(max_size=4),
        lambda inner: st.lists(inner, max_size=3) | st.dictionaries(st.text(max_size=3), inner, max_size=3),
        max_leaves=10,
    )
)
def test_plain_data_survives_json_and_the_rest_is_refused(value: object) -> None:
    try:
        plain(value, "x")
    except TaskliftError:
        return
    assert parse_json(files.canonical_json(value), "x") == value


def test_data_may_be_as_deep_as_the_limit() -> None:
    parse_json("[" * DEEPEST + "]" * DEEPEST, "x")
    with pytest.raises(TaskliftError, match="nested"):
        parse_json("[" * (DEEPEST + 1) + "]" * (DEEPEST + 1), "x")


# -- arrays ------------------------------------------------------------------------------------------------

SHAPE = (3, 4)


def npz(**arrays: np.ndarray) -> bytes:
    buffer = io.BytesIO()
    np.savez_compressed(buffer, **arrays)  # type: ignore[arg-type]
    return buffer.getvalue()


def with_header(shape: str, data: bytes, descr: str = "'<f8'") -> bytes:
    header = f"{{'descr': {descr}, 'fortran_order': False, 'shape': {shape}, }}".encode()
    header += b" " * (-(len(header) + 11) % 64) + b"\n"
    buffer = io.BytesIO()
    with zipfile.ZipFile(buffer, "w", zipfile.ZIP_DEFLATED) as archive:
        archive.writestr("weights.npy", b"\x93NUMPY\x01\x00" + len(header).to_bytes(2, "little") + header + data)
    return buffer.getvalue()


def test_arrays_come_back() -> None:
    weights = np.arange(12.0).reshape(SHAPE)
    found = parse_arrays(npz(weights=weights, visits=-weights), "x", SHAPE, 1000)
    assert np.array_equal(found["weights"], weights)
    assert np.array_equal(found["visits"], -weights)


HOSTILE_ARRAYS = {
    "empty": (b"", "not a file of arrays"),
    "no zip": (b"PK\x03\x04" + bytes(100), "not a file of arrays"),
    "no array": (with_header("(", b""), "not a file of arrays"),
    "terabytes": (with_header("(1000000000000,)", b"\0" * 8), r"expected array 'weights' of shape \(3, 4\)"),
    "another type": (npz(weights=np.zeros(SHAPE, np.float32)), "float64, found"),
    "objects": (with_header("(3, 4)", bytes(96), "'|O'"), "found"),
    "too short": (with_header("(3, 4)", bytes(95)), "another length"),
    "bomb": (with_header("(3, 4)", bytes(300_000_000)), "another length"),
    "too many": (npz(**{f"a{i}": np.zeros(SHAPE) for i in range(20)}), "20 arrays"),
}


@pytest.mark.parametrize("name", HOSTILE_ARRAYS)
def test_hostile_arrays_are_refused_before_they_are_unpacked(name: str) -> None:
    data, message = HOSTILE_ARRAYS[name]
    tracemalloc.start()
    with pytest.raises(TaskliftError, match=f"^x: .*{message}"):
        parse_arrays(data, "x", SHAPE, 1000)
    _, peak = tracemalloc.get_traced_memory()
    tracemalloc.stop()
    assert peak < 20e6  # the largest would take 300 MB


@given(st.integers(0, 10_000), st.integers(1, 255))
def test_a_flipped_byte_in_arrays_is_harmless_or_refused(place: int, bits: int) -> None:
    weights = np.arange(12.0).reshape(SHAPE)
    raw = bytearray(npz(weights=weights))
    raw[place % len(raw)] ^= bits
    try:
        found = parse_arrays(bytes(raw), "x", SHAPE, 1000)
    except TaskliftError:
        return
    assert all(np.array_equal(array, weights) for array in found.values())


def test_the_folder_of_temporary_files_is_left_clean() -> None:
    with tempfile.TemporaryDirectory() as folder:
        for i in range(5):
            files.write_atomically(Path(folder) / f"{i}", str(i))
        assert len(os.listdir(folder)) == 5
        assert all(stat.S_ISREG(p.stat().st_mode) for p in Path(folder).iterdir())
