"""How the spaces of an environment split into variables: discrete ones by themselves, continuous ones in bins."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from itertools import pairwise
from typing import Any

import numpy as np

from tasklift.checks import whole_number
from tasklift.errors import TaskliftError
from tasklift.tasks.variable import Variable
from tasklift.text import shown

Leaf = tuple[int, int]
"""The first number and the size of one discrete part of a space."""


def leaves(space: Any, names: Sequence[str] = ()) -> list[Leaf] | None:
    """Return the discrete parts of a space in order, or None where a part has no finite number of values.

    Parameters
    ----------
    space
        ``Discrete``, ``MultiDiscrete`` or ``MultiBinary``, from any first number, or a ``Tuple`` or ``Dict`` of such.
    names
        Of the variables. A ``Dict`` with these keys is taken in their order, any other in its own.
    """
    parts = _parts(space, names)
    if parts is not None:
        found = [leaves(part) for _, part in parts]
        return None if None in found else [leaf for part in found for leaf in part or []]
    kind = type(space).__name__
    if kind == "Discrete":
        return [(int(space.start), int(space.n))]
    if kind == "MultiDiscrete":
        first = np.broadcast_to(getattr(space, "start", 0), np.shape(space.nvec))
        return [(int(low), int(n)) for low, n in zip(first.ravel(), space.nvec.ravel(), strict=True)]
    if kind == "MultiBinary":
        return [(0, 2)] * int(np.prod(space.shape))
    return None


def _parts(space: Any, names: Sequence[str]) -> list[tuple[Any, Any]] | None:
    """Return the keys and the parts of a ``Tuple`` or ``Dict``, None for any other space."""
    inner = getattr(space, "spaces", None)
    if type(space).__name__ == "Tuple" and inner is not None:
        return list(enumerate(inner))
    if not isinstance(inner, Mapping):
        return None
    return [(key, inner[key]) for key in (names if set(names) == set(inner) else inner)]


def positions_of(space: Any, names: Sequence[str]) -> Callable[[Any], list[int]]:
    """Return the function that splits a value of a space into positions, each counted from 0.

    The function raises ``TypeError`` or ``ValueError`` for what is not a whole number.
    """
    found = leaves(space, names)
    assert found is not None
    lows = [low for low, _ in found]
    def positions(value: Any) -> list[int]:
        flat: list[Any] = []
        _flatten(space, names, value, flat)
        return [whole(v) - low for v, low in zip(flat, lows, strict=True)]

    return positions


def _flatten(space: Any, names: Sequence[str], value: Any, into: list[Any]) -> None:
    parts = _parts(space, names)
    if parts is None:
        into.extend(np.ravel(value).tolist())
        return
    if len(value) != len(parts):
        raise ValueError(f"expected {len(parts)} parts, found {len(value)}")
    for key, part in parts:
        _flatten(part, (), value[key], into)


def whole(value: Any) -> int:
    """Return a number as an ``int``; raise ``ValueError`` for a fraction."""
    found = value.item() if isinstance(value, np.ndarray | np.generic) else value
    if found != int(found):
        raise ValueError(f"expected a whole number, found {found}")
    return int(found)


def value_at(space: Any, names: Sequence[str], positions: Sequence[int]) -> Any:
    """Return the value of a space at these positions: what :func:`positions_of` takes apart."""
    return _built(space, names, iter(positions))


def _built(space: Any, names: Sequence[str], positions: Any) -> Any:
    parts = _parts(space, names)
    if parts is None:
        found = [next(positions) + low for low, _ in leaves(space) or []]
        if type(space).__name__ == "Discrete":
            return found[0]
        return np.array(found, dtype=space.dtype).reshape(space.shape)
    built = {key: _built(part, (), positions) for key, part in parts}
    return built if isinstance(getattr(space, "spaces", None), Mapping) else tuple(built.values())


class Bins:
    """Continuous observations in bins: the input variables, and the function that finds their values.

    Parameters
    ----------
    **edges
        Of each component of the (flattened) observation, in order: its name, and the edges between its bins,
        ascending. n edges make n + 1 bins. None leaves a component out.

    Raises
    ------
    TaskliftError
        For edges that do not grow; later, for an observation of another length, or with a NaN in it.

    Examples
    --------
    >>> bins = Bins(place=None, angle=(-0.1, 0.0, 0.1), speed=(0.0,))
    >>> [(v.name, len(v)) for v in bins.inputs]
    [('angle', 4), ('speed', 2)]
    >>> bins([2.5, 0.03, -1.0])
    {'angle': 2, 'speed': 0}

    With an environment: ``Factored(env, Task("pole", bins.inputs, outputs), observe=bins)``.
    """

    def __init__(self, **edges: Sequence[float] | None) -> None:
        self._edges: dict[str, Any] = {}
        for name, given in edges.items():
            try:
                array = None if given is None else np.asarray(given, dtype=float).ravel()
            except (TypeError, ValueError):
                array = np.zeros(0)
            if array is not None and (not len(array) or not np.isfinite(array).all() or (np.diff(array) <= 0).any()):
                raise TaskliftError(f"bins, {name}: expected ascending, finite edges, found {shown(given)}")
            self._edges[name] = array
        if all(array is None for array in self._edges.values()):
            raise TaskliftError("bins: expected the edges of at least one component, such as angle=(-0.1, 0.1)")

    @classmethod
    def evenly(cls, space: Any, **bins: int | None) -> Bins:
        """Return equal bins between the bounds of a ``Box``: their number by component, in order; None leaves it out.

        Raises
        ------
        TaskliftError
            For another space, a wrong number of components, less than 2 bins, or a component without finite bounds.
        """
        low, high = (np.ravel(getattr(space, side, ())) for side in ("low", "high"))
        if len(low) != len(bins) or not len(low):
            raise TaskliftError(f"bins: expected a Box with {len(bins)} components, found {space}")
        edges: dict[str, Sequence[float] | None] = {}
        for (name, number), least, most in zip(bins.items(), low.tolist(), high.tolist(), strict=True):
            if number is not None and whole_number(number, f"bins, {name}", least=2) and not most - least <= 1e30:
                raise TaskliftError(
                    f"bins, {name}: expected finite bounds, found {least} and {most}; give the edges themselves"
                )
            edges[name] = None if number is None else np.linspace(least, most, number + 1)[1:-1].tolist()
        return cls(**edges)

    @property
    def inputs(self) -> tuple[Variable, ...]:
        """The variables: bins by number, with their bounds as labels."""
        return tuple(
            Variable(name, tuple(range(len(edges) + 1)), _labels(edges.tolist()))
            for name, edges in self._edges.items()
            if edges is not None
        )

    def __call__(self, observation: Any) -> dict[str, int]:
        """Return the bin of each component of an observation, by name."""
        try:
            values = np.ravel(np.asarray(observation, dtype=float))
        except (TypeError, ValueError):
            values = np.zeros(0)
        if len(values) != len(self._edges) or np.isnan(values).any():
            raise TaskliftError(
                f"bins: expected {len(self._edges)} numbers ({', '.join(self._edges)}), found {shown(observation)}"
            )
        return {
            name: int(np.searchsorted(edges, value, side="right"))
            for (name, edges), value in zip(self._edges.items(), values.tolist(), strict=True)
            if edges is not None
        }


def _labels(edges: Sequence[float]) -> tuple[str, ...]:
    inner = [f"{a:g} to {b:g}" for a, b in pairwise(edges)]
    return (f"below {edges[0]:g}", *inner, f"from {edges[-1]:g}")
