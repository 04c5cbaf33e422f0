"""Machine code that Numba keeps in files, and when it must be made anew."""

from __future__ import annotations

import hashlib
from collections.abc import Callable
from functools import cache
from pathlib import Path
from types import ModuleType
from typing import Any


@cache
def fingerprint(*modules: ModuleType) -> str:
    """Return a text that differs where the source of one of the modules does."""
    content = hashlib.sha256()
    for module in modules:
        content.update(hashlib.sha256(Path(str(module.__file__)).read_bytes()).digest())
    return content.hexdigest()[:16]


def keep(*modules: ModuleType, **options: Any) -> Callable[[Callable[..., Any]], Any]:
    """Return ``numba.njit(cache=True, ...)`` for functions in which functions of other modules are compiled in.

    Numba compiles anew when the function's own file has changed, but not for any other file. So the name by which it
    keeps a function tells the content of the others.
    """
    from numba import njit  # only kernels pay for this import, not whoever asks for a fingerprint

    mark = fingerprint(*modules)

    def compiled(function: Callable[..., Any]) -> Any:
        function.__qualname__ = f"{function.__qualname__}_{mark}"
        return njit(cache=True, **options)(function)

    return compiled
