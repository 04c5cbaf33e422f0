"""How results become bytes: small, quick, readable without this package.

Packed arrays are a zlib stream of one JSON header line ``[[name, dtype, shape], …]`` and then the arrays'
little-endian bytes in that order, integers in the narrowest type that holds them.
"""

from __future__ import annotations

import json
import math
import zlib
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from tasklift.errors import TaskliftError
from tasklift.files import canonical_json
from tasklift.lab.spec import Cell, CellResult

Detail = Literal["rows", "summary"]


def pack(arrays: Mapping[str, NDArray[Any]]) -> bytes:
    """Pack named bool, integer and float arrays (see the text of this module)."""
    header, parts = [], []
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
    """Undo :func:`pack`: bool stays bool, integers come back as int64, floats as float64."""
    raw = zlib.decompress(data)
    end = raw.index(b"\n")
    arrays: dict[str, NDArray[Any]] = {}
    offset = end + 1
    for name, dtype, shape in json.loads(raw[:end]):
        count = math.prod(shape)
        array = np.frombuffer(raw, dtype, count, offset).reshape(shape)
        offset += array.nbytes
        wide = {"b": np.bool_, "i": np.int64, "u": np.int64, "f": np.float64}[array.dtype.kind]
        arrays[name] = array.astype(wide)
    return arrays


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
    def crc(self) -> int:
        """Checksum over all parts, the cell's name included."""
        value = zlib.crc32(f"{self.cell}\0{self.summary}".encode())
        for stage, n, data in self.trials:
            value = zlib.crc32(data, zlib.crc32(f"{stage}\0{n}".encode(), value))
        for name, content in self.attachments:
            raw = content if isinstance(content, bytes) else content.encode()
            value = zlib.crc32(raw, zlib.crc32(name.encode(), value))
        return value
