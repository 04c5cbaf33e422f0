"""Charts as SVG text that stands alone; ``report.js`` adds hovering, toggling and turning to the same SVG."""

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
from tasklift.style import DASHES, LOOKS, Look
from tasklift.text import number

_WIDTH, _HEIGHT = 640, 340
_LEFT, _RIGHT, _TOP, _BOTTOM = 62, 12, 12, 46


@dataclass(frozen=True)
class Series:
    """One curve: ``y`` ``(T,)``, its band ``low`` and ``high`` ``(T,)`` or None, and the slug of its colour."""

    name: str
    y: ArrayLike
    low: ArrayLike | None = None
    high: ArrayLike | None = None
    slug: str = ""


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


def curves_svg(
    series: Sequence[Series],
    looks: Mapping[str, Look],
    *,
    x: ArrayLike | None = None,
    x_label: str = "trial",
    y_label: str = "",
    y_range: tuple[float, float] | None = None,
) -> tuple[str, dict[str, Any]]:
    """Draw the curves; return the SVG and what ``report.js`` needs to show values under the pointer."""
    rows = [_checked(one) for one in series]
    if not rows:
        raise TaskliftError("report.curves: no series; give at least one")
    longest = max(len(y) for y, _, _ in rows)
    across = np.arange(1, longest + 1, dtype=np.float64) if x is None else np.asarray(x, dtype=np.float64)
    if across.shape != (longest,) or not np.isfinite(across).all():
        raise TaskliftError(f"report.curves: x has shape {across.shape}, expected ({longest},) finite numbers")
    known = np.concatenate([part[np.isfinite(part)] for row in rows for part in row if part is not None])
    ends = y_range or ((min(0.0, float(known.min())), float(known.max())) if known.size else (0.0, 1.0))
    marks = ticks(*ends)
    span = float(across[0]), float(across[-1] if across[-1] > across[0] else across[0] + 1)

    def sx(value: Any) -> Any:
        return _LEFT + (value - span[0]) / (span[1] - span[0]) * (_WIDTH - _LEFT - _RIGHT)

    def sy(value: Any) -> Any:
        return _HEIGHT - _BOTTOM - (value - marks[0]) / (marks[-1] - marks[0]) * (_HEIGHT - _TOP - _BOTTOM)

    parts = [_axes(marks, [t for t in ticks(*span, 8) if span[0] <= t <= span[1]], sx, sy, x_label, y_label)]
    for i, (one, (y, low, high)) in enumerate(zip(series, rows, strict=True)):
        at = sx(across[: len(y)])
        look = looks[one.name]
        style = f'class="series c{look.index}" data-series="{i}"'
        dash = " ".join(f"{1.8 * length:g}" for length in DASHES[look.dash])
        band = ""
        if low is not None and high is not None:
            band = f'<path class="band" d="{_band(at, sy(low), sy(high))}"/>'
        line = f'<path class="line" stroke-dasharray="{dash}" d="{_line(at, sy(y))}"/>'
        parts.append(f"<g {style}><title>{escape(one.name)}</title>{band}{line}</g>")
    parts.append(f'<line class="guide" y1="{_TOP}" y2="{_HEIGHT - _BOTTOM}" visibility="hidden"/>')
    label = escape(f"{y_label} by {x_label}")
    svg = f'<svg viewBox="0 0 {_WIDTH} {_HEIGHT}" role="img" aria-label="{label}">{"".join(parts)}</svg>'
    data = {
        "x": across.tolist(),
        "from": [_LEFT, _WIDTH - _RIGHT],
        "label": x_label,
        "series": [
            {"name": one.name, "y": _texts(y), "low": _texts(low), "high": _texts(high)}
            for one, (y, low, high) in zip(series, rows, strict=True)
        ],
    }
    return svg, data


def _checked(
    one: Series,
) -> tuple[NDArray[np.float64], NDArray[np.float64] | None, NDArray[np.float64] | None]:
    y = np.asarray(one.y, dtype=np.float64)
    low, high = (None if v is None else np.asarray(v, dtype=np.float64) for v in (one.low, one.high))
    for part in (y, low, high):
        if part is not None and (part.shape != y.shape or part.ndim != 1 or not part.size):
            raise TaskliftError(f"report.curves: series {one.name!r} has shape {part.shape}, expected one (T,)")
    return y, low, high


def _texts(values: NDArray[np.float64] | None) -> list[str] | None:
    return None if values is None else [number(v) for v in values]


def _line(x: NDArray[np.float64], y: NDArray[np.float64]) -> str:
    """A path with a gap wherever a value is not finite."""
    steps, pen = [], "M"
    for a, b in zip(x, y, strict=True):
        if math.isfinite(b):
            steps.append(f"{pen}{a:.1f} {b:.1f}")
        pen = "L" if math.isfinite(b) else "M"
    return "".join(steps)


def _band(x: NDArray[np.float64], low: NDArray[np.float64], high: NDArray[np.float64]) -> str:
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
        parts.append(f'<text class="tick mid" x="{sx(mark):.1f}" y="{base + 17}">{number(mark)}</text>')
    middle = (_TOP + base) / 2
    parts.append(f'<line class="axis" x1="{_LEFT}" x2="{right}" y1="{base}" y2="{base}"/>')
    parts.append(f'<text class="label mid" x="{(_LEFT + right) / 2}" y="{_HEIGHT - 8}">{escape(x_label)}</text>')
    parts.append(
        f'<text class="label mid" transform="rotate(-90 14 {middle})" x="14" y="{middle}">{escape(y_label)}</text>'
    )
    return "".join(parts)


# ---------------------------------------------------------------- bars in three dimensions


def bars_scene(
    values: ArrayLike,
    rows: Sequence[str],
    columns: Sequence[str],
    *,
    z_label: str,
    z_range: tuple[float, float] | None,
) -> dict[str, Any]:
    """What is drawn from any side, by :func:`bars_svg` and, while the reader turns it, by ``report.js``."""
    z = np.asarray(values, dtype=np.float64)
    if z.shape != (len(rows), len(columns)) or not z.size or not np.isfinite(z).all():
        raise TaskliftError(
            f"report.bars3d: values have shape {z.shape}, expected ({len(rows)}, {len(columns)}), all finite"
        )
    low, high = z_range or (min(0.0, float(z.min())), max(0.0, float(z.max())))
    marks = ticks(low, high, 4)
    return {
        "z": z.tolist(),
        "texts": [[number(v) for v in row] for row in z],
        "rows": [str(row) for row in rows],
        "columns": [str(column) for column in columns],
        "colours": [LOOKS.get(str(column), LOOKS["move"]).index for column in columns],
        "ticks": marks,
        "tickTexts": [number(mark) for mark in marks],
        "label": z_label,
        "turn": -0.6,
        "tilt": 0.5,
    }


def bars_svg(scene: Mapping[str, Any]) -> str:
    """The scene as SVG, orthographic. ``report.js`` has the same drawing; keep the two alike."""
    n, m = len(scene["rows"]), len(scene["columns"])
    low, high = scene["ticks"][0], scene["ticks"][-1]
    depth = max(n, 0.5 * m)  # rows are spread, so that two of them do not look like a wall
    cos_t, sin_t = math.cos(scene["turn"]), math.sin(scene["turn"])
    cos_e, sin_e = math.cos(scene["tilt"]), math.sin(scene["tilt"])
    unit = 370 / math.hypot(m, depth)

    def project(x: float, y: float, z: float) -> tuple[float, float]:
        """Floor coordinates in cells from the centre, height in the data's unit; to the picture."""
        across, away = x * cos_t - y * sin_t, x * sin_t + y * cos_t
        up = (z - low) / (high - low) * 150
        return 240 + across * unit, 222 + away * unit * sin_e - up * cos_e

    def points(corners: Sequence[tuple[float, float, float]]) -> str:
        return " ".join(f"{a:.1f},{b:.1f}" for a, b in (project(*corner) for corner in corners))

    w, d = m / 2, depth / 2
    floor = [(-w, -d, low), (w, -d, low), (w, d, low), (-w, d, low)]
    parts = [f'<polygon class="floor" points="{points(floor)}"/>']
    # walls and the ruler stand on the far sides
    side_x, side_y = (-w if sin_t > 0 else w), (-d if cos_t > 0 else d)
    for mark, text in zip(scene["ticks"], scene["tickTexts"], strict=True):
        wall = [(-side_x, side_y, mark), (side_x, side_y, mark), (side_x, -side_y, mark)]
        parts.append(f'<polyline class="grid" points="{points(wall)}"/>')
        a, b = project(*wall[0]) if project(*wall[0])[0] < project(*wall[2])[0] else project(*wall[2])
        parts.append(f'<text class="tick end" x="{a - 6:.1f}" y="{b + 4:.1f}">{escape(text)}</text>')
    places = [(j - w + 0.5, (i + 0.5) * depth / n - d, i, j) for i in range(n) for j in range(m)]
    for x, y, i, j in sorted(places, key=lambda p: p[0] * sin_t + p[1] * cos_t):
        parts.append(_bar(scene, x, y, i, j, points, sin_t, cos_t))
    for j, name in enumerate(scene["columns"]):
        a, b = project(j - w + 0.5, -side_y * 1.18, low)
        parts.append(f'<text class="tick mid" x="{a:.1f}" y="{b + 10:.1f}">{escape(name)}</text>')
    for i, name in enumerate(scene["rows"]):
        a, b = project(-side_x * 1.06, (i + 0.5) * depth / n - d, low)
        anchor = "start" if project(-side_x, 0, low)[0] > 240 else "end"
        parts.append(f'<text class="tick {anchor}" x="{a:.1f}" y="{b + 10:.1f}">{escape(name)}</text>')
    parts.append(f'<text class="label start" x="8" y="16">{escape(scene["label"])}</text>')
    return "".join(parts)


def _bar(scene: Mapping[str, Any], x: float, y: float, i: int, j: int, points: Any, sin_t: float, cos_t: float) -> str:
    r = 0.32
    base, top = sorted((max(0.0, scene["ticks"][0]), scene["z"][i][j]))
    near_x, near_y = x + (r if sin_t > 0 else -r), y + (r if cos_t > 0 else -r)

    def upright(a: tuple[float, float], b: tuple[float, float]) -> list[tuple[float, float, float]]:
        return [(*a, base), (*b, base), (*b, top), (*a, top)]

    faces = {
        "side": upright((near_x, y - r), (near_x, y + r)),
        "front": upright((x - r, near_y), (x + r, near_y)),
        "top": [(x - r, y - r, top), (x + r, y - r, top), (x + r, y + r, top), (x - r, y + r, top)],
    }
    title = f"{scene['rows'][i]}, {scene['columns'][j]}: {scene['texts'][i][j]}"
    shapes = "".join(f'<polygon class="{name}" points="{points(c)}"/>' for name, c in faces.items())
    return f'<g class="bar c{scene["colours"][j]}"><title>{escape(title)}</title>{shapes}</g>'
