"""What an experiment is: the settings that all its rows share, and the axes along which they differ."""

from __future__ import annotations

import hashlib
import json
import re
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

from tasklift.checks import check_name, plain
from tasklift.errors import TaskliftError
from tasklift.files import canonical_json, parse_json
from tasklift.lab.cell import Cell, axis_name, axis_value, grid
from tasklift.text import shown


@dataclass(frozen=True)
class Spec:
    """Everything that decides an experiment's rows, and which rows are asked for, as plain JSON.

    The *settings* are what all rows share. The *axes* are along what they differ: for each axis its values, each
    with what it stands for (a building's content, a rule). A row is decided by the settings and by its own values.
    So an experiment may be given more values later, such as more seeds: it stays the same experiment.

    Parameters
    ----------
    name
        A label for people; not part of the identity.
    canonical
        The settings as canonical JSON.
    plan
        The axes as canonical JSON: ``[[axis, [[value, what it stands for], …]], …]``.
    over
        The axes over which means are taken, from the outermost; the last of them is what repeats independently.

    Examples
    --------
    >>> spec = Spec.of("drills", {"trials": 50}, {"seed": range(3), "arm": ["direct", "drill"]}, over=["seed"])
    >>> more = Spec.of("drills", {"trials": 50}, {"seed": range(9), "arm": ["direct", "drill"]}, over=["seed"])
    >>> len(spec.cells()), len(more.cells()), spec.id == more.id
    (6, 18, True)
    """

    name: str
    canonical: str
    plan: str
    over: tuple[str, ...] = ()

    @classmethod
    def of(
        cls,
        name: str,
        settings: Mapping[str, Any],
        axes: Mapping[str, Iterable[str | int] | Mapping[str, Any]],
        *,
        over: Iterable[str] = (),
    ) -> Spec:
        """Freeze an experiment.

        Parameters
        ----------
        name
            A label for people.
        settings
            What all rows share: budgets, rules, …; JSON values only.
        axes
            For each axis its values, or a mapping from its values to what they stand for (JSON), such as
            ``{"map": {"office": building.content_id}, "seed": range(5), "arm": ["direct", "copy"]}``.
        over
            The axes over which ``tasklift runs`` takes means, from the outermost, such as ``["map", "seed"]``.

        Raises
        ------
        TaskliftError
            If a value cannot be written as JSON, an axis or a value may not be called so, or ``over`` names an
            axis that is not there.
        """
        plan = []
        for axis, values in axes.items():
            meant = values if isinstance(values, Mapping) else dict.fromkeys(values)
            plan.append([axis_name(axis), [[axis_value(axis, value), meaning] for value, meaning in meant.items()]])
            if not meant:
                raise TaskliftError(f"spec {name!r}: the axis {axis} has no values")
        if not plan or (unknown := [axis for axis in over if axis not in axes]):
            found = f"'over' names {unknown[0]!r}, which is not among them" if plan else "found none"
            raise TaskliftError(f"spec {name!r}: expected axes such as {{'seed': range(5)}}; {found}")
        try:
            spec = cls(check_name(name, "spec"), canonical_json(dict(settings)), canonical_json(plan), tuple(over))
            plain([spec.settings, spec.axes], "values")
        except (TypeError, ValueError, RecursionError) as error:
            raise TaskliftError(f"spec {shown(name)}: settings and axes must be plain JSON values: {error}") from error
        return spec

    @classmethod
    def parse(cls, name: str, settings: str, axes: str, over: str) -> Spec:
        """Make a spec of its texts, checked as in :meth:`of`; the canonical ones come back as they are."""
        plan = parse_json(axes, "axes")
        return cls.of(name, parse_json(settings, "settings"), {axis: dict(values) for axis, values in plan},
                      over=parse_json(over, "over"))  # fmt: skip

    @property
    def settings(self) -> dict[str, Any]:
        """A fresh copy of the settings."""
        copy: dict[str, Any] = json.loads(self.canonical)
        return copy

    @cached_property
    def axes(self) -> dict[str, dict[str, Any]]:
        """For each axis its values, with what they stand for (None where the name says it all)."""
        return {axis: dict(values) for axis, values in json.loads(self.plan)}

    @property
    def id(self) -> str:
        """Content id: sha256 of the settings and the names of the axes, 64 hex digits; more values do not change it."""
        return hashlib.sha256(canonical_json([self.canonical, list(self.axes)]).encode()).hexdigest()

    def cells(self) -> list[Cell]:
        """All combinations of the values of the axes; the last axis varies fastest."""
        return grid(**self.axes)

    def covers(self, cell: Cell) -> bool:
        """Whether the cell is one of the combinations."""
        return cell.names == tuple(self.axes) and all(value in self.axes[axis] for axis, value in cell.items)

    def joined(self, other: Spec) -> Spec:
        """The same experiment with the values of both."""
        axes = [[axis, list((values | other.axes[axis]).items())] for axis, values in self.axes.items()]
        return replace(other, plan=canonical_json(axes))

    def conflicts(self, other: Spec) -> list[str]:
        """Say in what two experiments differ, so that their rows do not belong together: ``path: this, not that``."""
        if list(self.axes) != list(other.axes):
            return [f"axes {', '.join(self.axes)}, not {', '.join(other.axes)}"]
        found = differences(self.settings, other.settings)
        for axis, values in self.axes.items():
            for value in values.keys() & other.axes[axis].keys():
                found += differences(values[value], other.axes[axis][value], f"{axis} {value}")
        return found


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
    if a == b and type(a) is type(b):
        return []
    if all(isinstance(value, str) and re.fullmatch("[0-9a-f]{32,}", value) for value in (a, b)):
        return [f"{where}: another one"]  # digests tell people nothing
    return [f"{where}: {_short(a)}, not {_short(b)}"]


def _short(value: Any) -> str:
    text = canonical_json(value)
    return text if len(text) <= 60 else f"{text[:57]}…"
