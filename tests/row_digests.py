"""Digests of rows: the fingerprints that ``tests/studies/row_digests.json`` holds of the code before its rebuild."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

#: Section -> ``axis/axis/…/arm`` -> digest.
RECORDED: dict[str, dict[str, str]] = json.loads(
    (Path(__file__).parent / "studies" / "row_digests.json").read_text(encoding="utf-8")
)


def digest(stages: Mapping[str, Mapping[str, ArrayLike]], attachments: Mapping[str, ArrayLike] | None = None) -> str:
    """Return 16 hex digits over every value of every column, by name, shape and the last bit of each number."""
    found = hashlib.sha256()
    for stage in sorted(stages):
        for column in sorted(stages[stage]):
            _feed(found, f"{stage}/{column}", stages[stage][column])
    for name in sorted(attachments or {}):
        _feed(found, name, (attachments or {})[name])
    return found.hexdigest()[:16]


def _feed(found: Any, name: str, values: ArrayLike) -> None:
    array = np.ascontiguousarray(np.asarray(values).astype(np.float64))
    found.update(name.encode())
    found.update(str(array.shape).encode())
    found.update(array.tobytes())
