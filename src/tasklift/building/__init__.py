"""The world: a multi-robot search of a building that nobody has mapped (paper, section IV).

Names are imported when they are first used, so that ``import tasklift.building`` compiles nothing.
"""

from __future__ import annotations

from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from tasklift.building.generate import generate as generate
    from tasklift.building.graph import Building as Building

_HOMES = {
    "Building": "graph",
    "generate": "generate",
}

__all__ = sorted(_HOMES)


def __getattr__(name: str) -> Any:
    if name not in _HOMES:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    # Kept in the package's namespace: the function `generate` would otherwise be hidden by its module
    value = getattr(import_module(f"{__name__}.{_HOMES[name]}"), name)
    globals()[name] = value
    return value


def __dir__() -> list[str]:
    return sorted({*globals(), *_HOMES})
