"""The graph of a building drawn on its plan, so that a person sees at a glance what was understood."""

from __future__ import annotations

import os
from typing import Any

import numpy as np
from numpy.typing import NDArray

from tasklift.building.graph import BEND, CORNER, DOOR, FEATURE, INTERSECTION, OTHER, ROOM, Building
from tasklift.files import output_file, write_atomically
from tasklift.plans.floor import unpack
from tasklift.plans.plan import Plan
from tasklift.style import GROUND, SCENE, SERIES

# Told apart by shape as well as by colour
_COLOURS = {
    "room": SERIES["green"][0],
    "crossing": SERIES["blue"][0],
    "door": SCENE["door"][0],
    "turn": SERIES["pink"][0],
    "other": SERIES["grey"][0],
}
_SIGNS: tuple[tuple[str, int, int | None, str, str, float], ...] = (
    ("room", ROOM, None, "s", _COLOURS["room"], 1.6),
    ("junction", INTERSECTION, None, "o", _COLOURS["crossing"], 1.0),
    ("door", FEATURE, DOOR, "D", _COLOURS["door"], 0.95),
    ("bend", FEATURE, BEND, "^", _COLOURS["turn"], 0.95),
    ("corner", FEATURE, CORNER, "v", _COLOURS["turn"], 0.95),
    ("other feature", FEATURE, OTHER, "X", _COLOURS["other"], 0.95),
)
# The longest side grows with the number of nodes, so that their numbers can be read
LONGEST_SIDE_INCHES, MOST_INCHES = 16.0, 40.0
LEGEND_INCHES, LEGEND_ROW_INCHES = 5.5, 0.3
PIXELS_PER_INCH = 100
LARGEST_PICTURE = 2000
ENDINGS = (".png", ".svg")


def draw_overlay(building: Building, path: str | os.PathLike[str], plan: Plan | None = None) -> None:
    """Draw rooms, doors, junctions, bends and node ids over the plan, and write the picture.

    Parameters
    ----------
    building
        What to draw.
    path
        The picture: ``.png`` or ``.svg``.
    plan
        What to draw on. ``None``: the plan in the building's file, or else one sketched from the building.
    """
    import io

    from matplotlib import rc_context
    from matplotlib.figure import Figure

    suffix = output_file(path, ENDINGS, force=True).suffix.lower()
    plan = plan or unpack(building)
    low, high = _bounds(building, plan)
    width, height = high - low
    scale = _inches(building) / max(width, height)
    inches = max(LEGEND_INCHES, width * scale), max(2.0, height * scale) + 2 * LEGEND_ROW_INCHES
    figure = Figure(figsize=inches, dpi=PIXELS_PER_INCH)
    legend = 2 * LEGEND_ROW_INCHES / inches[1]
    axes = figure.add_axes((0.005, legend, 0.99, 0.995 - legend))
    if plan is None:
        from tasklift.building.draw import draw_plan

        draw_plan(building, axes, legend=False)
    else:
        _draw_picture(axes, plan)
    _draw_graph(axes, building, scale)
    axes.set_xlim(low[0], high[0])
    axes.set_ylim(low[1], high[1])
    axes.set_aspect("equal")
    axes.set_axis_off()
    buffer = io.BytesIO()
    # text stays text in SVG, and the same building gives the same file
    with rc_context({"svg.fonttype": "none", "svg.hashsalt": "tasklift"}):
        metadata = {"Date": None} if suffix == ".svg" else {"Software": None}
        figure.savefig(buffer, format=suffix[1:], metadata=metadata)
    write_atomically(path, buffer.getvalue())


def _inches(building: Building) -> float:
    return float(np.clip(1.6 * np.sqrt(building.n_nodes), LONGEST_SIDE_INCHES, MOST_INCHES))


def _bounds(building: Building, plan: Plan | None) -> tuple[np.ndarray, np.ndarray]:
    """The corners of what there is to see: the graph, and on a plan all that it knows of."""
    points = [building.position_m, building.outline_m]
    if plan is not None and not plan.unknown.all():
        rows, columns = (np.flatnonzero((~plan.unknown).any(axis=1 - axis)) for axis in (0, 1))
        ends = [(row, column) for row in (rows[0], rows[-1] + 1) for column in (columns[0], columns[-1] + 1)]
        points.append(plan.to_world(*np.array(ends, float).T))
    known = np.concatenate(points)
    return known.min(axis=0) - 1.0, known.max(axis=0) + 1.0


def _draw_picture(axes: Any, plan: Plan) -> None:
    """The plan in pale grey, turned by its yaw."""
    from matplotlib.transforms import Affine2D

    x, y, yaw = plan.origin
    pale = (160 + plan.grey.astype(np.float32) * (95 / 255)).astype(np.uint8)
    pale[~plan.free & ~plan.unknown] = 70
    top = pale.shape[0]
    pale, factor = _darkest(pale)
    left, right, bottom = 0, pale.shape[1] * factor, top - pale.shape[0] * factor
    extent = tuple(plan.resolution_m * edge for edge in (left, right, bottom, top))
    axes.imshow(
        pale,
        cmap="gray",
        vmin=0,
        vmax=255,
        extent=extent,
        interpolation="nearest",
        zorder=0,
        transform=Affine2D().rotate(yaw).translate(x, y) + axes.transData,
    )


def _darkest(grey: NDArray[np.uint8]) -> tuple[NDArray[np.uint8], int]:
    """A large picture made smaller, and by which factor: by the darkest of each block, so that thin walls stay."""
    factor = -(-max(grey.shape) // LARGEST_PICTURE)
    if factor > 1:
        grey = np.pad(grey, [(0, -size % factor) for size in grey.shape], constant_values=255)
        grey = grey.reshape(grey.shape[0] // factor, factor, -1, factor).min(axis=(1, 3))
    return grey, factor


def _draw_graph(axes: Any, building: Building, scale: float) -> None:
    from matplotlib.collections import LineCollection
    from matplotlib.lines import Line2D

    position = building.position_m
    # signs about as large as half a metre, but never too small to tell apart or too large for the plan
    size = float(np.clip(0.55 * scale * 72, 4.0, 9.0))
    lines = [building.line_m(edge) for edge in range(building.n_edges)]
    axes.add_collection(LineCollection(lines, colors=SERIES["sky"][0], linewidths=size / 4.5, zorder=2))
    handles = []
    for label, kind, feature, marker, colour, factor in _SIGNS:
        mask = building.kind == kind
        if feature is not None:
            mask &= building.feature_class == feature
        style: dict[str, Any] = {
            "marker": marker,
            "color": colour,
            "linestyle": "none",
            "markeredgecolor": "white",
            "markeredgewidth": 0.5,
        }
        axes.plot(*position[mask].T, **style, markersize=size * factor, zorder=3)
        if mask.any():
            handles.append(Line2D([], [], **style, markersize=8, label=f"{label} ({int(mask.sum())})"))
    ring: dict[str, Any] = {"marker": "o", "markerfacecolor": "none", "linestyle": "none"}
    ring["markeredgecolor"] = SCENE["safe"][0]
    axes.plot(*position[building.start], **ring, markersize=size * 2.4, markeredgewidth=2, zorder=4)
    handles.append(Line2D([], [], **ring, markersize=10, markeredgewidth=2, label="start"))
    beside = size / 72 / scale  # as far as the sign is large (m)
    _draw_numbers(axes, np.add(position, [0.55 * beside, 0.45 * beside]), size * 0.95)
    axes.legend(
        handles=handles,
        loc="upper center",
        bbox_to_anchor=(0.5, 0.0),
        ncols=len(handles) if axes.figure.get_figwidth() > 1.3 * len(handles) else -(-len(handles) // 2),
        frameon=False,
        fontsize=9,
        handletextpad=0.3,
        columnspacing=1.2,
    )


def _draw_numbers(axes: Any, position: NDArray[np.float64], size: float) -> None:
    """Write the number of each node at its place (m), all as one artist: single texts take three times as long."""
    from matplotlib.artist import Artist
    from matplotlib.font_manager import FontProperties

    class Numbers(Artist):
        def draw(self, renderer: Any) -> None:
            context = renderer.new_gc()
            context.set_foreground(GROUND["ink"][0])
            context.set_clip_rectangle(axes.bbox)
            height = axes.figure.bbox.height
            for node, (x, y) in enumerate(axes.transData.transform(position).tolist()):
                renderer.draw_text(context, x, height - y if renderer.flipy() else y, str(node), font, 0)
            context.restore()

    font = FontProperties(size=size)
    numbers = Numbers()
    numbers.set_zorder(5)
    axes.add_artist(numbers)
