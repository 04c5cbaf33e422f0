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
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from tasklift.errors import TaskliftError
from tasklift.files import canonical_json
from tasklift.lab.cell import Cell, CellResult

Detail = Literal["rows", "summary"]

#: Numbers that one stage or one attachment may have; 256 MiB of memory when they are read.
MOST_VALUES = 2**25

_LONGEST_HEADER = 2**20
_WIDE = {"b": np.bool_, "i": np.int64, "u": np.int64, "f": np.float64}


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


def unpack(data: bytes) -> dict[str, NDArray[Any]]:
    """Undo :func:`pack`: bool stays bool, integers come back as int64, floats as float64.

    Raises
    ------
    ValueError
        If the bytes are not a packed set of arrays, or one larger than :data:`MOST_VALUES`; nothing large is
        decompressed before that is known.
    """
    stream = zlib.decompressobj()
    start = stream.decompress(data, _LONGEST_HEADER)
    end = start.index(b"\n")
    header = [(name, np.dtype(dtype), [int(n) for n in shape]) for name, dtype, shape in json.loads(start[:end])]
    _refuse_too_many([shape for _, _, shape in header])
    size = end + 1 + sum(dtype.itemsize * math.prod(shape) for _, dtype, shape in header)
    raw = start + (stream.decompress(stream.unconsumed_tail, size - len(start) + 1) if size > len(start) else b"")
    if len(raw) != size or not stream.eof or stream.unused_data:
        raise ValueError(f"{len(raw)} bytes of arrays, expected {size}")
    arrays: dict[str, NDArray[Any]] = {}
    offset = end + 1
    for name, dtype, shape in header:
        array = np.frombuffer(raw, dtype, math.prod(shape), offset).reshape(shape)
        offset += array.nbytes
        arrays[name] = array.astype(_WIDE[dtype.kind])
    return arrays


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
    """A cell's result, ready to be stored: made where the work is done, so that the store only writes."""

    cell: Cell
    summary: str
    trials: tuple[tuple[str, int, bytes], ...]
    attachments: tuple[tuple[str, str | bytes], ...]

    @classmethod
    def of(cls, cell: Cell, result: CellResult, detail: Detail = "rows") -> Packed:
        """Pack a result; with ``detail="summary"`` only its summary."""
        try:
            summary = canonical_json(dict(result.summary))
            if detail == "summary":
                return cls(cell, summary, (), ())
            trials = tuple(
                (stage, len(next(iter(columns.values()))), pack(columns))
                for stage, columns in sorted(result.stages.items())
            )
            attachments = tuple(
                (name, pack({"": value}) if isinstance(value, np.ndarray) else canonical_json(value))
                for name, value in sorted(result.attachments.items())
            )
        except (TypeError, ValueError) as error:
            raise TaskliftError(f"cell {cell}: its result cannot be stored: {error}") from error
        return cls(cell, summary, trials, attachments)

    @property
    def contents(self) -> str:
        """The checksums of all parts as JSON: ``{"trials": {stage: crc}, "attachments": {name: crc}}``."""
        return canonical_json(
            {
                "trials": {stage: checksum(stage, n, data) for stage, n, data in self.trials},
                "attachments": {name: checksum(name, data) for name, data in self.attachments},
            }
        )


def checksum(*parts: str | int | bytes) -> int:
    """CRC-32 over texts, numbers and bytes, each with its type and length."""
    value = 0
    for part in parts:
        raw = part if isinstance(part, bytes) else str(part).encode("utf-8", "surrogatepass")
        value = zlib.crc32(raw, zlib.crc32(f"{type(part).__name__} {len(raw)} ".encode(), value))
    return value
