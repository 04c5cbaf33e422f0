"""Figures for papers and reports: one look, no global state, the same bytes for the same figure."""

from __future__ import annotations

import io
from collections.abc import Callable
from functools import wraps
from pathlib import Path
from typing import TYPE_CHECKING, Any, ParamSpec

from tasklift.files import write_atomically
from tasklift.style import FIGURE

if TYPE_CHECKING:
    from matplotlib.figure import Figure

P = ParamSpec("P")

#: The width of a page of two text columns (inches).
PAGE = 7.2


def styled(function: Callable[P, Figure]) -> Callable[P, Figure]:
    """Draw with our look, whatever the reader's own settings."""

    @wraps(function)
    def drawn(*args: P.args, **kwargs: P.kwargs) -> Figure:
        import matplotlib as mpl

        with mpl.rc_context(FIGURE):
            return function(*args, **kwargs)

    return drawn


def save(figure: Figure, folder: Path, name: str) -> tuple[Path, Path]:
    """Write ``name.png`` (200 dots per inch) and ``name.svg`` into the folder; return both paths.

    The same figure gives the same bytes: no dates, no random ids.
    """
    import matplotlib as mpl

    kinds: dict[str, dict[str, Any]] = {
        "png": {"dpi": 200, "metadata": {"Software": None}},
        "svg": {"metadata": {"Date": None, "Creator": None}},
    }
    with mpl.rc_context({**FIGURE, "svg.hashsalt": name, "svg.fonttype": "path"}):
        for kind, options in kinds.items():
            buffer = io.BytesIO()
            figure.savefig(buffer, format=kind, **options)
            figure.set_layout_engine("none")  # laid out once is enough, and the same in both
            write_atomically(folder / f"{name}.{kind}", buffer.getvalue())
    return folder / f"{name}.png", folder / f"{name}.svg"


def page(width: float, height: float) -> Figure:
    """Return an empty figure of that size (inches), with our spacing and no global state."""
    from matplotlib.figure import Figure

    return Figure(figsize=(width, height), layout="constrained")
