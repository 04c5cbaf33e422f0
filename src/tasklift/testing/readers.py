"""A check of readers of maps, and damage to files for it."""

from __future__ import annotations

import os
import tempfile
import time
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from tasklift.building.graph import Building
from tasklift.errors import TaskliftError

if TYPE_CHECKING:
    from tasklift.plans.read import Reader

LONGEST_MESSAGE = 300
LONGEST_READ_S = 5.0

# What breaks parsers: numbers beyond the machine, text that is no text, nesting, digits that are no digits
_NASTY = (
    b"9" * 5000, b"1e400", b"-1e400", b"1e-400", b"nan", b".nan", b"-inf", b"1e30", b"-1", b"0", b"0x10", b"\xc2\xb2",
    b"\\ud800", b"\xed\xa0\x80", b"\0", b"\x1b[2J", b"\n", b"[" * 200, b"{" * 200, b"]", b"}", b'"', b"'", b"&a", b"*a",
    b"!!python/none", b"<<", b"null", b"true", b"2001-99-99", b"\xff\xfe", b"\xef\xbb\xbf", b" " * 300, b"999999999999",
)  # fmt: skip


def damage(data: bytes, rng: np.random.Generator) -> bytes:
    """Return ``data`` with one to four pieces of damage: cut, repeated, moved, changed, or something nasty put in.

    >>> damage(b"resolution: 0.05", np.random.default_rng(0)) != b"resolution: 0.05"
    True
    """
    raw = bytearray(data)
    for _ in range(int(rng.integers(1, 5))):
        at = int(rng.integers(0, len(raw) + 1))
        size = int(rng.integers(1, 20))
        kind = int(rng.integers(0, 7))
        if kind == 0:
            del raw[at : at + size]
        elif kind == 1:
            raw[at:at] = raw[at : at + size]
        elif kind == 2:
            del raw[at:]
        elif kind == 3 and at < len(raw):
            raw[at] = int(rng.integers(0, 256))
        elif kind == 4 and at < len(raw):
            raw[at] ^= 1 << int(rng.integers(0, 8))
        elif kind == 5:
            other = int(rng.integers(0, len(raw) + 1))
            raw[at : at + size] = raw[other : other + size]
        else:
            raw[at : at + int(rng.integers(0, size))] = _NASTY[int(rng.integers(0, len(_NASTY)))]
    return bytes(raw)


def check_reader(
    reader: Reader,
    samples: Sequence[str | os.PathLike[str]],
    *,
    options: Mapping[str, Any] | None = None,
    damaged: int = 200,
    seed: int = 0,
) -> None:
    """Check a reader of maps on sample files and on damaged copies of them.

    The reader has a title. It recognises every sample, and no other reader does. It returns a floor plan with shapes
    and numbers that fit, places that become a building, or a building; the same each time. A damaged file is
    read, or refused with a :class:`TaskliftError` of one line that names the file, within 5 seconds; what is
    accepted becomes a building, or is refused in the same way.

    Parameters
    ----------
    reader
        A module, or any object, with ``TITLE``, ``recognises`` and ``read``; see :mod:`tasklift.plans.read`.
    samples
        Files of its format, as they should be. Files that belong to them lie in the same folder.
    options
        What the user says about them, as :class:`tasklift.plans.source.Source` takes it.
    damaged
        Number of damaged copies to try of each sample.
    seed
        Another seed damages otherwise.

    Raises
    ------
    AssertionError
        With the promise that is broken, the sample, and the damaged bytes where that is short.

    Examples
    --------
    >>> from tasklift.plans.read import movingai
    >>> with tempfile.TemporaryDirectory() as folder:
    ...     path = Path(folder) / "small.map"
    ...     _ = path.write_text(chr(10).join(["type octile", "height 1", "width 2", "map", ".."]))
    ...     check_reader(movingai, [path], damaged=20)
    """
    from tasklift.plans.read import readers

    assert isinstance(getattr(reader, "TITLE", None), str), f"{reader!r} has no TITLE for people"
    assert samples, "expected one sample at least"
    rng = np.random.default_rng(seed)
    for sample in map(Path, samples):
        known = [other for other in readers() if _recognises(other, sample, options)]
        assert _recognises(reader, sample, options), f"{sample.name}: {reader.TITLE} does not recognise it"
        others = [other.TITLE for other in known if other.TITLE != reader.TITLE]
        assert not others, f"{sample.name}: recognised by {' and '.join(others)} as well"
        first, again = (_shape_of(reader, sample, options) for _ in range(2))
        assert first == again, f"{sample.name}: read twice, it is not the same"
        with tempfile.TemporaryDirectory() as folder:
            for beside in sample.parent.iterdir():
                if beside.is_file():
                    (Path(folder) / beside.name).write_bytes(beside.read_bytes())
            for _ in range(damaged):
                _check_damaged(reader, Path(folder) / sample.name, damage(sample.read_bytes(), rng), options)


def _source(path: Path, options: Mapping[str, Any] | None) -> Any:
    from tasklift.plans.source import Source

    return Source(path, **dict(options or {}))


def _recognises(reader: Reader, path: Path, options: Mapping[str, Any] | None) -> bool:
    try:
        return reader.recognises(_source(path, options))
    except TaskliftError:
        return False


def _shape_of(reader: Reader, path: Path, options: Mapping[str, Any] | None) -> Any:
    """What a file is read as, to compare; its parts are checked."""
    from tasklift.plans.places import Places
    from tasklift.plans.plan import Plan

    found = reader.read(_source(path, options))
    if isinstance(found, Plan):
        shape = found.free.shape
        for name, dtype in (("free", bool), ("unknown", bool), ("grey", np.uint8)):
            array = getattr(found, name)
            assert array.dtype == dtype, f"{path.name}: {name} is {array.dtype}, expected {np.dtype(dtype)}"
            assert array.shape == shape, f"{path.name}: {name} has the shape {array.shape}, free has {shape}"
        assert not (found.free & found.unknown).any(), f"{path.name}: pixels are free and unknown at once"
        size = found.resolution_m
        assert 0 < size < np.inf, f"{path.name}: the resolution is {size} m"
        assert np.isfinite(found.origin).all(), f"{path.name}: the origin is {found.origin}"
        return found.free.tobytes(), found.unknown.tobytes(), size, found.origin
    assert isinstance(found, Places | Building), f"{path.name}: read gives {type(found).__name__}"
    building = found.building() if isinstance(found, Places) else found
    assert isinstance(building, Building), f"{path.name}: building() gives {type(building).__name__}"
    return building.content_id


def _check_damaged(reader: Reader, path: Path, data: bytes, options: Mapping[str, Any] | None) -> None:
    path.write_bytes(data)
    shown = repr(data) if len(data) <= 500 else f"{len(data)} bytes"
    begin = time.perf_counter()
    try:
        if reader.recognises(_source(path, options)):
            _shape_of(reader, path, options)
    except TaskliftError as error:
        message = str(error)
        assert "\n" not in message, f"{path.name}: the message has several lines: {message!r} of {shown}"
        assert str(path) in message, f"{path.name}: the message does not name the file: {message!r} of {shown}"
        rest = len(message) - len(str(path))
        assert rest <= LONGEST_MESSAGE, f"{path.name}: a message of {rest} characters: {message!r}"
    except AssertionError:
        raise
    except BaseException as error:
        raise AssertionError(f"{path.name}: {type(error).__name__}: {error!s:.200} of {shown}") from error
    seconds = time.perf_counter() - begin
    assert seconds <= LONGEST_READ_S, f"{path.name}: {seconds:.1f} s to read {shown}"
