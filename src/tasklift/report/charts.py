"""Charts that stand alone: curves as SVG, rows of dots and of shares as HTML. ``report.js`` adds hovering and toggling.

Text is HTML wherever it can be, so that it keeps its size on a phone.
"""

from __future__ import annotations

import html
import json
import math
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from tasklift.errors import TaskliftError
from tasklift.style import DASHES, Look
from tasklift.text import number

_WIDTH, _HEIGHT = 480, 270
_LEFT, _RIGHT, _TOP, _BOTTOM = 52, 8, 10, 42
#: Least distance of two names at the ends of lines, as a share of the chart's height.
_NAME = 0.07
#: A verdict's sign, and its colour.
VERDICTS = {
    "holds": ("✓", "holds"),
    "undecided": ("–", "open"),
    "does not hold": ("✗", "fails"),
    "too few": ("–", "open"),
}

Floats = NDArray[np.float64]


@dataclass(frozen=True)
class Series:
    """One curve: ``y`` ``(T,)``, its band ``low`` and ``high`` ``(T,)`` or None, and the slug of its colour.

    ``each`` ``(T,)`` is what the reader may switch to: the values before they were smoothed.
    """

    name: str
    y: ArrayLike
    low: ArrayLike | None = None
    high: ArrayLike | None = None
    slug: str = ""
    each: ArrayLike | None = None


@dataclass(frozen=True)
class Mark:
    """A dot on a row, with its interval (nan: none); ``slug`` gives its colour; names of several make a key."""

    at: float
    low: float = math.nan
    high: float = math.nan
    slug: str = ""
    name: str = ""


@dataclass(frozen=True)
class Row:
    """A row of a flat chart: its name, the dots on it, and what is written behind them."""

    label: str
    marks: Sequence[Mark]
    text: str = ""


def escape(text: object) -> str:
    """Text for HTML or SVG, in an element or an attribute; control characters become visible."""
    return html.escape(re.sub(r"[\x00-\x08\x0b-\x1f\x7f-\x9f]", "\ufffd", str(text)), quote=True)


def data_block(value: Any) -> str:
    """JSON for a ``<script type="application/json">``, which no content can end early."""
    return json.dumps(value, allow_nan=False).replace("<", "\\u003c")


def ticks(low: float, high: float, count: int = 5) -> list[float]:
    """Round numbers covering [low, high], about ``count`` of them."""
    if not high > low:
        high = low + 1
    raw = (high - low) / count
    power = 10.0 ** math.floor(math.log10(raw))
    step = next(s * power for s in (1, 2, 2.5, 5, 10) if s * power >= raw * (1 - 1e-9))
    first, last = math.floor(low / step + 1e-9), math.ceil(high / step - 1e-9)
    return [round(i * step, 12) for i in range(first, last + 1)]


# ---------------------------------------------------------------- curves


def curves_html(
    series: Sequence[Series],
    looks: Mapping[str, Look],
    *,
    x: ArrayLike | None = None,
    x_label: str = "episode",
    y_label: str = "",
    y_range: tuple[float, float] | None = None,
) -> tuple[str, dict[str, Any]]:
    """Draw the curves, with their names at their ends; return HTML and what ``report.js`` needs besides."""
    rows = [_checked(one) for one in series]
    if not rows:
        raise TaskliftError("report.curves: no series; give at least one")
    longest = max(len(y) for y, *_ in rows)
    across = np.arange(1, longest + 1, dtype=np.float64) if x is None else np.asarray(x, dtype=np.float64)
    if across.shape != (longest,) or not np.isfinite(across).all():
        raise TaskliftError(f"report.curves: x has shape {across.shape}, expected ({longest},) finite numbers")
    known = np.concatenate([part[np.isfinite(part)] for row in rows for part in row if part is not None])
    marks = ticks(*(y_range or ((float(known.min()), float(known.max())) if known.size else (0.0, 1.0))))
    span = float(across[0]), float(across[-1] if across[-1] > across[0] else across[0] + 1)

    def sx(value: Any) -> Any:
        return _LEFT + (value - span[0]) / (span[1] - span[0]) * (_WIDTH - _LEFT - _RIGHT)

    def sy(value: Any) -> Any:
        return _HEIGHT - _BOTTOM - (value - marks[0]) / (marks[-1] - marks[0]) * (_HEIGHT - _TOP - _BOTTOM)

    parts = [_axes(marks, [t for t in ticks(*span, 5) if span[0] <= t <= span[1]], sx, sy, x_label, y_label)]
    for i, (one, (y, low, high, each)) in enumerate(zip(series, rows, strict=True)):
        at = sx(across[: len(y)])
        look = looks[one.name]
        dash = " ".join(f"{1.8 * length:g}" for length in DASHES[look.dash])
        drawn = "" if low is None or high is None else f'<path class="band" d="{_band(at, sy(low), sy(high))}"/>'
        drawn += f'<path class="line" stroke-dasharray="{dash}" d="{_line(at, sy(y))}"/>'
        if each is not None:
            raw = f'<path class="line" stroke-dasharray="{dash}" d="{_line(at, sy(each))}"/>'
            drawn = f'<g class="smooth">{drawn}</g><g class="each">{raw}</g>'
        parts.append(f'<g class="series c{look.index}" data-series="{i}">{drawn}</g>')
    parts.append(f'<line class="guide" y1="{_TOP}" y2="{_HEIGHT - _BOTTOM}" visibility="hidden"/>')
    label = escape(f"{y_label} by {x_label}")
    svg = f'<svg viewBox="0 0 {_WIDTH} {_HEIGHT}" role="img" aria-label="{label}">{"".join(parts)}</svg>'
    names = [
        f'<span class="c{looks[one.name].index}" style="top: {100 * top:.1f}%">'
        f'<i class="{looks[one.name].dash}"></i>{escape(one.name)}</span>'
        for one, top in zip(series, _apart([_end(sy(y)) / _HEIGHT for y, *_ in rows]), strict=True)
    ]
    data = {
        "x": across.tolist(),
        "from": [_LEFT, _WIDTH - _RIGHT],
        "label": x_label,
        "series": [
            {"name": one.name, "y": _texts(y), "low": _texts(low), "high": _texts(high), "each": _texts(each)}
            for one, (y, low, high, each) in zip(series, rows, strict=True)
        ],
    }
    return f'<div class="curves">{svg}<div class="ends">{"".join(names)}</div></div>', data


def _checked(one: Series) -> tuple[Floats, Floats | None, Floats | None, Floats | None]:
    y = np.asarray(one.y, dtype=np.float64)
    low, high, each = (None if v is None else np.asarray(v, dtype=np.float64) for v in (one.low, one.high, one.each))
    for part in (y, low, high, each):
        if part is not None and (part.shape != y.shape or part.ndim != 1 or not part.size):
            raise TaskliftError(f"report.curves: series {one.name!r} has shape {part.shape}, expected one (T,)")
    return y, low, high, each


def _end(y: Floats) -> float:
    """Return where a line ends: its last known value."""
    known = y[np.isfinite(y)]
    return float(known[-1]) if known.size else 0.0


def _apart(places: Sequence[float]) -> list[float]:
    """Move places in [0, 1] apart, so that names at them do not cover one another; their order stays."""
    order = sorted(range(len(places)), key=lambda i: places[i])
    found, least = list(places), 0.0
    for i in order:
        found[i] = least = max(places[i], least)
        least += _NAME
    most = 1.0
    for i in reversed(order):
        found[i] = min(found[i], most)
        most = found[i] - _NAME
    return found


def _texts(values: Floats | None) -> list[str] | None:
    return None if values is None else [number(v, 3) for v in values]


def _line(x: Floats, y: Floats) -> str:
    """A path with a gap wherever a value is not finite."""
    steps, pen = [], "M"
    for a, b in zip(x, y, strict=True):
        if math.isfinite(b):
            steps.append(f"{pen}{a:.1f} {b:.1f}")
        pen = "L" if math.isfinite(b) else "M"
    return "".join(steps)


def _band(x: Floats, low: Floats, high: Floats) -> str:
    good = np.isfinite(low) & np.isfinite(high)
    if not good.any():
        return ""
    there, back = _line(x[good], high[good]), _line(x[good][::-1], low[good][::-1])
    return f"{there}L{back[1:]}Z"


def _axes(y_marks: list[float], x_marks: list[float], sx: Any, sy: Any, x_label: str, y_label: str) -> str:
    right, base = _WIDTH - _RIGHT, _HEIGHT - _BOTTOM
    parts = []
    for mark in y_marks:
        parts.append(f'<line class="grid" x1="{_LEFT}" x2="{right}" y1="{sy(mark):.1f}" y2="{sy(mark):.1f}"/>')
        parts.append(f'<text class="tick end" x="{_LEFT - 7}" y="{sy(mark) + 4:.1f}">{number(mark)}</text>')
    for mark in x_marks:
        parts.append(f'<text class="tick mid" x="{sx(mark):.1f}" y="{base + 16}">{number(mark)}</text>')
    middle = (_TOP + base) / 2
    parts.append(f'<line class="axis" x1="{_LEFT}" x2="{right}" y1="{base}" y2="{base}"/>')
    parts.append(f'<text class="label mid" x="{(_LEFT + right) / 2}" y="{_HEIGHT - 7}">{escape(x_label)}</text>')
    parts.append(
        f'<text class="label mid" transform="rotate(-90 13 {middle})" x="13" y="{middle}">{escape(y_label)}</text>'
    )
    return "".join(parts)


# ---------------------------------------------------------------- flat charts: rows


def rows_html(
    rows: Sequence[Row], looks: Mapping[str, Look], *, label: str = "", within: tuple[float, float] | None = None
) -> str:
    """Draw a dot with its interval for each mark, a row under the other, on one scale; a table for those who listen.

    Parameters
    ----------
    rows
        At least one mark in all.
    looks
        By slug of the marks.
    label
        Of the scale.
    within
        The scale's ends; default: those of the marks.
    """
    marks = [mark for row in rows for mark in row.marks]
    if not marks or not all(math.isfinite(mark.at) for mark in marks):
        raise TaskliftError("report.rows: expected rows with marks at finite places")
    known = [v for mark in marks for v in (mark.at, mark.low, mark.high) if math.isfinite(v)]
    scale = ticks(*(within or (min(known), max(known))), 4)

    def at(value: float) -> float:
        return 100 * (min(max(value, scale[0]), scale[-1]) - scale[0]) / (scale[-1] - scale[0])

    body = []
    for row in rows:
        drawn = []
        for mark in row.marks:
            title = escape(f"{mark.name or row.label}: {number(mark.at)}")
            colour = f"c{looks[mark.slug].index}"
            if math.isfinite(mark.low) or math.isfinite(mark.high):
                low, high = (at(v) if math.isfinite(v) else end for v, end in ((mark.low, 0.0), (mark.high, 100.0)))
                drawn.append(f'<i class="reach {colour}" style="left: {low:.1f}%; width: {high - low:.1f}%"></i>')
            drawn.append(f'<i class="dot {colour}" style="left: {at(mark.at):.1f}%" title="{title}"></i>')
        body.append(_row(row.label, "".join(drawn), row.text))
    lines = "".join(f'<b style="left: {at(mark):.1f}%">{number(mark)}</b>' for mark in scale)
    names = dict.fromkeys((mark.name, looks[mark.slug].index) for mark in marks if mark.name)
    key = "".join(f'<span><i class="dot c{index}"></i>{escape(name)}</span>' for name, index in names)
    key = f'<div class="key">{key}</div>' if len(names) > 1 else ""
    return key + _rows(body, f'<div class="track scale">{lines}</div>', label)


def shares_html(rows: Sequence[tuple[str, Sequence[float], str]]) -> str:
    """Draw shares of the three verdicts: in each row a name, the shares that hold, are open, and fail, and a text."""
    body, kinds = [], list(VERDICTS.items())[:3]
    for name, shares, text in rows:
        parts = "".join(
            f'<i class="part {kind}" style="width: {100 * share:.1f}%" title="{words}: {100 * share:.0f} %"></i>'
            for share, (words, (_, kind)) in zip(shares, kinds, strict=True)
        )
        body.append(_row(name, parts, text))
    key = "".join(f'<span class="{kind}">{sign} {words}</span>' for words, (sign, kind) in kinds)
    return _rows(body, f'<div class="key">{key}</div>', "")


def _row(name: str, drawn: str, text: str) -> str:
    return (
        f'<tr><th scope="row">{escape(name)}</th><td><div class="track">{drawn}</div></td><td>{escape(text)}</td></tr>'
    )


def _rows(body: Sequence[str], scale: str, label: str) -> str:
    under = f'<tr class="under"><td>{escape(label)}</td><td>{scale}</td><td></td></tr>'
    return f'<table class="rows"><tbody>{"".join(body)}{under}</tbody></table>'
