"""The unit of work: a cell with named axes, what it gives, and grids of cells."""

from __future__ import annotations

import re
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field
from functools import lru_cache
from itertools import product
from typing import Any

import numpy as np
from numpy.typing import NDArray

from tasklift.errors import TaskliftError

# names of the store's own columns, of exported ones, and of the options of Store.select and Store.curves
_TAKEN = {"attachments", "cell", "contents", "crc", "id", "name", "pad", "spec", "stage", "summary", "trial", "value"}
_LONGEST = 100  # characters of a value


@dataclass(frozen=True, init=False, repr=False)
class Cell:
    """The unit of work, of resume and of commit: one value on each of the axes of an experiment.

    The axes are the experiment's own, named in any way; their order is kept. By custom the last one is what is
    compared (the arm), the one before it what repeats (the seed).

    Parameters
    ----------
    **axes
        A text or a whole number for each axis; numbers become text. A name is a Python identifier in lower case.

    Raises
    ------
    TaskliftError
        If a name is taken or is not an identifier, or a value is empty, longer than 100 characters, or not
        printable.

    Examples
    --------
    >>> cell = Cell(map="office", seed=3, arm="copy")
    >>> cell["seed"], cell.axes
    ('3', {'map': 'office', 'seed': '3', 'arm': 'copy'})
    >>> print(cell)
    map office, seed 3, arm copy
    >>> sorted([Cell(seed=10), Cell(seed=9)])
    [Cell(seed='9'), Cell(seed='10')]
    """

    items: tuple[tuple[str, str], ...]

    def __init__(self, **axes: str | int) -> None:
        if not axes:
            raise TaskliftError("a cell needs at least one axis, such as Cell(seed=0)")
        items = tuple((axis_name(name), axis_value(name, value)) for name, value in axes.items())
        object.__setattr__(self, "items", items)

    @classmethod
    def of(cls, names: Iterable[str], values: Iterable[str]) -> Cell:
        """Make a cell of names and values that were checked before."""
        cell = object.__new__(cls)
        object.__setattr__(cell, "items", tuple(zip(names, values, strict=True)))  # past the frozen dataclass
        return cell

    def __getitem__(self, axis: str) -> str:
        for name, value in self.items:
            if name == axis:
                return value
        raise TaskliftError(f"cell {self}: no axis {axis!r}; its axes are {', '.join(self.names)}")

    @property
    def axes(self) -> dict[str, str]:
        """The values by axis, in order."""
        return dict(self.items)

    @property
    def names(self) -> tuple[str, ...]:
        """The axes, in order."""
        return tuple(name for name, _ in self.items)

    @property
    def values(self) -> tuple[str, ...]:
        """The values, in the order of the axes."""
        return tuple(value for _, value in self.items)

    @property
    def group(self) -> tuple[str, ...]:
        """The values of all axes but the last one: cells that share them run one after another in one worker."""
        return self.values[:-1]

    def __lt__(self, other: Cell) -> bool:
        """Axis by axis; numbers, and numbers within names, sort as numbers."""
        return [*map(_place, self.values)] < [*map(_place, other.values)]

    def __str__(self) -> str:
        return ", ".join(f"{name} {value}" for name, value in self.items)

    def __repr__(self) -> str:
        return f"Cell({', '.join(f'{name}={value!r}' for name, value in self.items)})"


def axis_name(name: str) -> str:
    """Return ``name`` if an axis may have it."""
    if not re.fullmatch(r"[a-z][a-z0-9_]{0,39}", name) or name in _TAKEN:
        raise TaskliftError(
            f"axis {name!r}: expected a name in lower case such as map or seed, and none of {', '.join(sorted(_TAKEN))}"
        )
    return name


def axis_value(name: str, value: Any) -> str:
    """Return ``value`` as the text that a cell keeps."""
    whole = isinstance(value, (int, np.integer)) and not isinstance(value, (bool, np.bool_))
    text = str(int(value)) if whole else value
    if not isinstance(text, str) or not 0 < len(text) <= _LONGEST or not text.isprintable():
        raise TaskliftError(
            f"axis {name}: expected a whole number, or a printable text of 1 to {_LONGEST} characters, found "
            f"{ascii(value)[:60]}"
        )
    return text


@lru_cache(maxsize=1 << 16)
def _place(value: str) -> tuple[Any, ...]:
    if re.fullmatch(r"-?[0-9]+(\.[0-9]+)?", value):
        return 0, float(value), value
    parts = re.split(r"([0-9]+)", value)  # text and digits in turn
    return 1, [int(part) if i % 2 else part for i, part in enumerate(parts)], value


def in_order(values: Iterable[str]) -> list[str]:
    """Sort values: numbers, and numbers within names, as numbers."""
    return sorted(values, key=_place)


def grid(**axes: Iterable[str | int]) -> list[Cell]:
    """All combinations of values of the axes; the last axis varies fastest.

    Examples
    --------
    >>> grid(seed=range(2), arm=["direct", "copy"])[:3]
    [Cell(seed='0', arm='direct'), Cell(seed='0', arm='copy'), Cell(seed='1', arm='direct')]
    """
    if not axes:
        raise TaskliftError("a grid needs at least one axis, such as grid(seed=range(5))")
    texts = {axis_name(name): [axis_value(name, value) for value in values] for name, values in axes.items()}
    return [Cell.of(texts, values) for values in product(*texts.values())]


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

    Raises
    ------
    TaskliftError
        If the columns of a stage differ in length.
    """

    stages: Mapping[str, Mapping[str, NDArray[Any]]] = field(default_factory=dict)
    summary: Mapping[str, Any] = field(default_factory=dict)
    attachments: Mapping[str, Any] = field(default_factory=dict)

    def __post_init__(self) -> None:
        for stage, columns in self.stages.items():
            shapes = {np.shape(column) for column in columns.values()}
            if len(shapes) != 1 or len(next(iter(shapes))) != 1:
                raise TaskliftError(f"stage {stage!r}: columns of shapes {sorted(shapes)}, expected one (trials,)")
