"""How results become bytes: small, quick, readable without this package.

Packed arrays are a zlib stream of one JSON header line ``[[name, dtype, shape], …]`` and then the arrays'
little-endian bytes in that order, integers in the narrowest type that holds them.
"""

from __future__ import annotations

import json
import math
import zlib
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from functools import lru_cache
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from tasklift.errors import TaskliftError
from tasklift.files import canonical_json
from tasklift.lab.cell import Cell, CellResult
from tasklift.text import shown

Detail = Literal["rows", "summary"]

#: Numbers that one stage or one attachment may have; 256 MiB of memory when they are read.
MOST_VALUES = 2**25

_MOST_BYTES = 8 * MOST_VALUES + 2**20
_WIDE = {"b": np.bool_, "i": np.int64, "u": np.int64, "f": np.float64}
_TYPES = {"|b1", "|i1", "|u1", "<f2"} | {f"<{kind}{size}" for kind in "iuf" for size in (2, 4, 8)}


def pack(arrays: Mapping[str, NDArray[Any]]) -> bytes:
    """Pack named bool, integer and float arrays (see the text of this module)."""
    header, parts = [], []
    _refuse_too_many([np.shape(array) for array in arrays.values()])
    for name, given in arrays.items():
        array = np.asarray(given)
        if array.dtype.kind not in "biuf":
            raise TaskliftError(f"column {name!r} has type {array.dtype}; give bool, integer or float arrays")
        if array.dtype.kind in "iu":
            ends = (int(array.min()), int(array.max())) if array.size else (0, 0)
            if ends[1] >= 2**63:
                raise TaskliftError(f"column {name!r} holds {ends[1]}, too large for a 64-bit integer")
            array = array.astype(np.result_type(*(np.min_scalar_type(end) for end in ends)))
        array = np.ascontiguousarray(array, dtype=array.dtype.newbyteorder("<"))
        header.append([name, array.dtype.str, list(array.shape)])
        parts.append(array.tobytes())
    return zlib.compress(json.dumps(header).encode() + b"\n" + b"".join(parts), 1)


def unpack(data: bytes, only: str | None = None) -> dict[str, NDArray[Any]]:
    """Undo :func:`pack`: bool stays bool, integers come back as int64, floats as float64.

    Parameters
    ----------
    data
        The bytes.
    only
        The one array to return, if it is there; by default all.

    Raises
    ------
    ValueError
        If the bytes are not a packed set of arrays, or one of more than :data:`MOST_VALUES` numbers; memory is taken
        for no more than that.
    """
    stream = zlib.decompressobj()
    raw = stream.decompress(data, _MOST_BYTES)
    end = raw.index(b"\n") + 1
    header, size = _read_header(raw[:end])
    if end + size != len(raw) or not stream.eof or stream.unused_data:
        raise ValueError(f"{len(raw) - end} bytes of arrays, expected {size}")
    arrays: dict[str, NDArray[Any]] = {}
    offset = end
    for name, dtype, count, shape, length in header:
        if only is None or name == only:
            wide = _WIDE[dtype.kind]
            arrays[name] = np.frombuffer(raw, dtype, count, offset).astype(wide).reshape(shape)
        offset += length
    return arrays


@lru_cache(maxsize=256)
def _read_header(line: bytes) -> tuple[list[tuple[str, np.dtype[Any], int, list[int], int]], int]:
    """Return (name, type, count, shape, bytes) of each array, and the bytes of all; cells have few headers."""
    header = []
    for name, dtype, shape in json.loads(line):
        if dtype not in _TYPES:
            raise ValueError(f"an array of type {dtype!r}")
        header.append((name, np.dtype(dtype), math.prod(shape), shape, np.dtype(dtype).itemsize * math.prod(shape)))
    _refuse_too_many(shape for _, _, _, shape, _ in header)
    return header, sum(length for *_, length in header)


def _refuse_too_many(shapes: Iterable[Sequence[int]]) -> None:
    values = 0
    for shape in shapes:
        if len(shape) > 32 or min(shape, default=0) < 0 or max(shape, default=0) > MOST_VALUES:
            raise ValueError(f"an array of shape {shape}")
        values += math.prod(shape)
    if values > MOST_VALUES:
        raise ValueError(f"{values} values in one stage or attachment, expected at most {MOST_VALUES}")


@dataclass(frozen=True)
class Packed:
    """A cell's result, ready to be stored: made where the work is done, so that the store only writes.

    ``contents`` has the checksums of all parts, as JSON: ``{"trials": {stage: crc}, "attachments": {name: crc}}``.
    """

    cell: Cell
    summary: str
    trials: tuple[tuple[str, int, bytes], ...]
    attachments: tuple[tuple[str, str | bytes], ...]
    contents: str

    @classmethod
    def of(cls, cell: Cell, result: CellResult, detail: Detail = "rows") -> Packed:
        """Pack a result; with ``detail="summary"`` only its summary."""
        try:
            summary = canonical_json(scalars(dict(result.summary)))
            summary.encode()
            trials: list[tuple[str, int, bytes]] = []
            attachments: list[tuple[str, str | bytes]] = []
            if detail == "rows":
                for stage, columns in sorted(result.stages.items()):
                    trials.append((stage, len(next(iter(columns.values()))), pack(columns)))
                for name, value in sorted(result.attachments.items()):
                    attachments.append(
                        (name, pack({"": value}) if isinstance(value, np.ndarray) else canonical_json(value))
                    )
            contents = {
                "trials": {stage: checksum(stage, data, n) for stage, n, data in trials},
                "attachments": {name: checksum(name, data) for name, data in attachments},
            }
        except (TypeError, ValueError) as error:
            raise TaskliftError(f"cell {cell}: its result cannot be stored: {error}") from error
        return cls(cell, summary, tuple(trials), tuple(attachments), canonical_json(contents))


def scalars(summary: Any) -> dict[str, Any]:
    """Return a summary if it is a mapping from names to texts, finite numbers of at most 64 bits, or None."""
    if not isinstance(summary, dict):
        raise TypeError("a summary that is not a mapping")
    for name, value in summary.items():
        whole = isinstance(value, int) and abs(value) < 2**63
        real = isinstance(value, float) and math.isfinite(value)
        if not (value is None or isinstance(value, str) or whole or real):
            raise ValueError(f"the summary's {name!r} is {shown(value)}, not a text, a finite number or None")
    return summary


def checksum(name: str, data: str | bytes, n: int = 0) -> int:
    """CRC-32 of a part: its name, its number of trials, whether it is text or bytes, and its content."""
    kind, raw = ("text", data.encode()) if isinstance(data, str) else ("bytes", data)
    return zlib.crc32(raw, zlib.crc32(f"{name}\0{n}\0{kind}\0".encode()))
