"""What an experiment is: a frozen specification, its cells, and what a cell gives."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

from tasklift.errors import TaskliftError
from tasklift.files import canonical_json


@dataclass(frozen=True)
class Spec:
    """Everything that decides an experiment's results, as plain JSON; two equal specs give equal rows.

    Parameters
    ----------
    name
        A label for people; not part of the identity.
    canonical
        The settings as canonical JSON. Use :meth:`of` to make one from a mapping.
    """

    name: str
    canonical: str

    @classmethod
    def of(cls, name: str, settings: Mapping[str, Any]) -> Spec:
        """Freeze ``settings`` (maps, seeds, arms, reading, reinforcement, budgets, …; JSON values only)."""
        try:
            return cls(name, canonical_json(dict(settings)))
        except (TypeError, ValueError) as error:
            raise TaskliftError(f"spec {name!r}: settings must be plain JSON values: {error}") from error

    @property
    def settings(self) -> dict[str, Any]:
        """A fresh copy of the settings."""
        copy: dict[str, Any] = json.loads(self.canonical)
        return copy

    @property
    def id(self) -> str:
        """Content id: the sha256 of the canonical settings, 64 hex digits."""
        return hashlib.sha256(self.canonical.encode()).hexdigest()


@dataclass(frozen=True, order=True)
class Cell:
    """The unit of work, of resume and of commit: one learner on one map with one seed under one reading."""

    reading: str
    map: str
    seed: int
    arm: str

    def __str__(self) -> str:
        return f"{self.reading} / {self.map} / seed {self.seed} / {self.arm}"

    @property
    def group(self) -> tuple[str, str, int]:
        """Reading, map and seed: arms that share them are paired, and computed one after another."""
        return self.reading, self.map, self.seed


@dataclass(frozen=True)
class CellResult:
    """What a cell gives.

    Parameters
    ----------
    stages
        ``{stage: {column: array (trials,)}}``, bool, integer or float columns in trial order; the columns of
        one stage are equally long.
    summary
        Named scalars (JSON numbers, strings or None), kept in every store.
    attachments
        Named arrays of any shape, or JSON values: learned weights, for example.
    """

    stages: Mapping[str, Mapping[str, NDArray[Any]]] = field(default_factory=dict)
    summary: Mapping[str, Any] = field(default_factory=dict)
    attachments: Mapping[str, Any] = field(default_factory=dict)

    def __post_init__(self) -> None:
        for stage, columns in self.stages.items():
            shapes = {np.shape(column) for column in columns.values()}
            if len(shapes) != 1 or len(next(iter(shapes))) != 1:
                raise TaskliftError(f"stage {stage!r}: columns of shapes {sorted(shapes)}, expected one (trials,)")


def grid(readings: Iterable[str], maps: Iterable[str], seeds: Iterable[int], arms: Iterable[str]) -> list[Cell]:
    """All combinations, the arms of one (reading, map, seed) next to each other."""
    maps, seeds, arms = list(maps), list(seeds), list(arms)
    return [Cell(r, m, int(s), a) for r in readings for m in maps for s in seeds for a in arms]


def differences(a: Any, b: Any, where: str = "") -> list[str]:
    """Name every place where two JSON values differ: ``path: a, not b``."""
    if isinstance(a, dict) and isinstance(b, dict):
        found = []
        for key in sorted(a.keys() | b.keys()):
            path = f"{where}.{key}" if where else str(key)
            if key in a and key in b:
                found += differences(a[key], b[key], path)
            else:
                value, side = (a[key], "the first") if key in a else (b[key], "the second")
                found.append(f"{path}: only {side} has it ({_short(value)})")
        return found
    if isinstance(a, list) and isinstance(b, list) and len(a) == len(b):
        return [line for i, (x, y) in enumerate(zip(a, b, strict=True)) for line in differences(x, y, f"{where}[{i}]")]
    return [] if a == b and type(a) is type(b) else [f"{where}: {_short(a)}, not {_short(b)}"]


def _short(value: Any) -> str:
    text = canonical_json(value)
    return text if len(text) <= 60 else f"{text[:57]}…"
