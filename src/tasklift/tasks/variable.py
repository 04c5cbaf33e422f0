"""Variables with named, ordered values, and signals with conditions over them: what a task is made of."""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field
from functools import cached_property
from typing import Any

import numpy as np

from tasklift.checks import check_fields, check_name
from tasklift.errors import TaskliftError
from tasklift.text import shown

Value = int | float | str | bool
Condition = Mapping[str, Any]


def plain_value(value: Any, where: str) -> Value:
    """Return ``value`` as a plain Python scalar, or refuse it."""
    plain = value.item() if isinstance(value, np.generic) else value
    if not isinstance(plain, int | float | str):
        raise TaskliftError(f"{where}: expected a number, a string or a truth value, found {value!r}")
    if isinstance(plain, float) and not math.isfinite(plain):
        raise TaskliftError(f"{where}: expected finite numbers, found {plain!r}")
    return plain


def plain_number(value: Any, where: str) -> float:
    """Return ``value`` as a float, or refuse it; a truth value is not a number."""
    plain = plain_value(value, where)
    if isinstance(plain, str | bool):
        raise TaskliftError(f"{where}: expected a number, found {value!r}")
    try:
        return float(plain)
    except OverflowError as error:
        raise TaskliftError(f"{where}: a number of {len(str(plain))} digits is too large") from error


@dataclass(frozen=True)
class Variable:
    """One input or output: a name and its ordered values.

    Parameters
    ----------
    name : str
        Unique within a task.
    values : sequence of int, float, str or bool
        Distinct values in table order, at least one.
    labels : sequence of str, optional
        Names of the values, one each. A condition may use them in place of the values.
    meaning : str
        A line for readers.

    Raises
    ------
    TaskliftError
        For an empty name, no values, values or labels that are there twice, and numbers that are not finite.

    Examples
    --------
    >>> danger = Variable("DL", (0, 1, 2), labels=("none", "suspected", "attacked"), meaning="danger level")
    >>> len(danger), danger.position("suspected")
    (3, 1)
    """

    name: str
    values: tuple[Value, ...]
    labels: tuple[str, ...] | None = None
    meaning: str = ""

    def __post_init__(self) -> None:
        where = f"variable {check_name(self.name, 'variable')!r}"
        if isinstance(self.values, str) or not isinstance(self.values, Iterable):
            raise TaskliftError(f"{where}: expected a list of values, found {self.values!r}")
        object.__setattr__(self, "values", tuple(plain_value(v, where) for v in self.values))
        if not self.values:
            raise TaskliftError(f"{where}: has no values; give at least one")
        if len(self._positions) < len(self.values):
            double = next(v for i, v in enumerate(self.values) if self._positions[v] != i)
            raise TaskliftError(f"{where}: the value {double!r} is there twice; values must differ")
        if self.labels is not None:
            object.__setattr__(self, "labels", tuple(self.labels))
            self._check_labels(where)
        if not isinstance(self.meaning, str):
            raise TaskliftError(f"{where}: expected a line of text as meaning, found {self.meaning!r}")

    def _check_labels(self, where: str) -> None:
        labels = self.labels or ()
        if len(labels) != len(self.values) or not all(isinstance(label, str) for label in labels):
            raise TaskliftError(
                f"{where}: expected {len(self.values)} labels, one text for each value, found {labels!r}"
            )
        first: dict[str, int] = {}
        for i, label in enumerate(labels):
            if first.setdefault(label, i) != i or self._positions.get(label, i) != i:
                raise TaskliftError(f"{where}: the label {label!r} stands for two values; labels must differ")

    @cached_property
    def _positions(self) -> dict[Value, int]:
        return {value: i for i, value in reversed(list(enumerate(self.values)))}

    def __len__(self) -> int:
        return len(self.values)

    def __repr__(self) -> str:
        labels = "" if self.labels is None else f", labels={shown(self.labels)}"
        return f"Variable({shown(self.name, 40)}, {shown(self.values)}{labels})"

    def find(self, value: Any) -> int | None:
        """Return the index of ``value``, or None if it is not one of the values."""
        try:
            return self._positions.get(value)
        except TypeError:
            return None

    def position(self, value: Any, where: str = "") -> int:
        """Return the index of ``value`` (or of the value with that label); errors name ``where``."""
        found = self.find(value)
        if found is None and self.labels is not None and isinstance(value, str) and value in self.labels:
            found = self.labels.index(value)
        if found is None:
            known = ", ".join(map(repr, self.values[:12])) + (", …" if len(self) > 12 else "")
            prefix = f"{where}: " if where else ""
            raise TaskliftError(f"{prefix}variable {self.name!r} has no value {value!r}; it has {known}")
        return found

    def label(self, value: Any) -> str:
        """Return what ``value`` is called: its label, or the value as text.

        Examples
        --------
        >>> Variable("MV", (0, 1), labels=("stop", "move")).label(0), Variable("CA", (0.5,)).label(0.5)
        ('stop', '0.5')
        """
        at = self.position(value)
        return str(self.values[at]) if self.labels is None else self.labels[at]

    def positions(self, wanted: Any, where: str) -> tuple[int, ...]:
        """Return the indices of one value or of a sequence of distinct values, in table order."""
        many = wanted.tolist() if isinstance(wanted, np.ndarray) else wanted
        if isinstance(many, str) or not isinstance(many, Iterable):
            return (self.position(many, where),)
        found = [self.position(value, where) for value in many]
        if not found:
            raise TaskliftError(
                f"{where}: no value of {self.name!r} is allowed, so nothing can meet the condition"
            )
        if len(set(found)) < len(found):
            raise TaskliftError(f"{where}: a value of {self.name!r} is given twice in {list(many)!r}")
        return tuple(sorted(found))

    def to_json(self) -> dict[str, Any]:
        """Return the variable as JSON data."""
        return {
            "name": self.name,
            "values": list(self.values),
            "labels": None if self.labels is None else list(self.labels),
            "meaning": self.meaning,
        }

    @classmethod
    def from_json(cls, document: Any, where: str) -> Variable:
        """Read what :meth:`to_json` gives; errors name ``where``."""
        data = check_fields(
            document, where, {"name": str, "values": list, "labels": (list, None), "meaning": str}
        )
        return cls(data["name"], tuple(data["values"]), data["labels"], data["meaning"])


@dataclass(frozen=True)
class Signal:
    """A reinforcement signal (Table III): ``value`` is added wherever all conditions hold.

    Parameters
    ----------
    value : float
        The signal. Several that hold together add up.
    when : mapping
        For each named variable, input or output, the value or the values at which the signal holds. Empty: always.
    name : str
        For reports.

    Raises
    ------
    TaskliftError
        If the value is not a finite number, or ``when`` is not a mapping.

    Examples
    --------
    >>> Signal(-0.1, {"MV": 0, "nWPN": 2}, "never stop when enough weapon robots").value
    -0.1
    """

    value: float
    when: Condition = field(default_factory=dict)
    name: str = ""

    def __post_init__(self) -> None:
        object.__setattr__(self, "value", plain_number(self.value, f"signal {self.name!r}"))
        if not isinstance(self.when, Mapping):
            raise TaskliftError(
                f"signal {self.name!r}: expected conditions {{variable: values}}, found {self.when!r}"
            )

    def to_json(self) -> dict[str, Any]:
        """Return the signal as JSON data."""
        return {"value": self.value, "when": condition_json(self.when), "name": self.name}


def condition_json(when: Condition) -> dict[str, Any]:
    """Return a condition as JSON data."""
    return {name: list(v) if isinstance(v, tuple) else v for name, v in when.items()}
