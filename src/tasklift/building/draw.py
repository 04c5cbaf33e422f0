"""A building drawn as a floor plan and as a graph, like the paper's Figure 1 (a) and (b).

Every function draws on axes that the caller made, ``matplotlib.figure.Figure().subplots()`` for example, and
leaves pyplot alone. Coordinates are metres.
"""

from __future__ import annotations

import math
from collections.abc import Iterable
from typing import TYPE_CHECKING, Any, TypeGuard

import numpy as np
from numpy.typing import NDArray

from tasklift.building.graph import DOOR, FEATURE, INTERSECTION, LARGEST_M, ROOM, Building
from tasklift.errors import TaskliftError
from tasklift.style import GROUND, SCENE

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

_INK = GROUND["ink"][0]
_WALL, _CORRIDOR, _ROOM, _GROUND = (SCENE[name][0] for name in ("wall", "floor", "room", "ground"))
_FEATURE, _DOOR, _START, _HOSTILE = (SCENE[name][0] for name in ("mark", "door", "safe", "danger"))
_EDGE = GROUND["soft"][0]
_SMALLEST_ROOM_M = 1.2


def footprints(building: Building) -> dict[int, Any]:
    """Return the floor of every room: a shapely polygon by node.

    Generated buildings carry their rooms' rectangles (m) in the provenance. Elsewhere a room is a square of
    its area around its node, turned to its corridor; smaller where that would cover the next node, another
    room or a corridor.
    """
    import shapely

    known = building.provenance.get("footprints")
    found: dict[int, Any] = {}
    rooms = np.flatnonzero(building.kind == ROOM)
    lines = shapely.linestrings(building.position_m[building.edges])
    for room in rooms.tolist():
        box = known.get(str(room)) if isinstance(known, dict) else None
        if _is_box(box):
            found[room] = shapely.box(*box)
            continue
        here = building.position_m[room]
        beside = building.neighbour[building.indptr[room] : building.indptr[room + 1]]
        offsets = here - building.position_m[beside]
        near = offsets[np.hypot(*offsets.T).argmin()]
        distance = float(np.hypot(*near))
        foreign = ~np.isin(building.edges, [room, *beside]).any(axis=1)
        corridors = shapely.distance(shapely.Point(here), lines[foreign]) - building.width_m[foreign] / 2
        others = np.hypot(*(building.position_m[rooms[rooms != room]] - here).T) * 0.48
        limit = min([distance, *corridors, *others])
        half = min(math.sqrt(building.area_m2[room]) / 2, max(_SMALLEST_ROOM_M / 2, limit))
        ahead = near / distance if distance > 0 else np.array([1.0, 0.0])
        aside = np.array([-ahead[1], ahead[0]])
        corners = [here + half * (i * ahead + j * aside) for i, j in ((-1, -1), (1, -1), (1, 1), (-1, 1))]
        found[room] = shapely.Polygon(corners)
    return found


def _is_box(value: Any) -> TypeGuard[list[float]]:
    """Whether a building's provenance, where anything may stand, gives a rectangle: left, bottom, right, top (m)."""
    if not (isinstance(value, list) and len(value) == 4):
        return False
    if not all(isinstance(v, int | float) and abs(v) <= LARGEST_M for v in value):
        return False
    return bool(value[0] < value[2] and value[1] < value[3])


def corridor_floor(building: Building) -> Any:
    """Return the floor of all corridors together: a shapely geometry, each corridor a band of its width.

    Where corridors meet at right angles the corners are square, at a bend they are mitred, elsewhere cut off.
    """
    import shapely

    position, half = building.position_m, building.width_m / 2
    ends = position[building.edges].copy()
    joints: list[Any] = []
    for node in range(building.n_nodes):
        here = slice(building.indptr[node], building.indptr[node + 1])
        edges = building.edge_of[here]
        away = position[building.neighbour[here]] - position[node]
        away = away / np.maximum(np.hypot(*away.T), 1e-9)[:, None]
        sine = np.abs(away[:, :1] * away[:, 1] - away[:, 1:] * away[:, 0])
        if len(edges) == 1:
            reach = half[edges] * (building.kind[node] != ROOM)  # a corridor ends as a square, or in its room
        elif (np.minimum(sine, 1 - sine) < 1e-3).all():
            reach = (np.round(sine) * half[edges]).max(axis=1)
        else:
            reach = np.zeros(len(edges))
            if len(edges) == 2 and half[edges[0]] == half[edges[1]]:
                h = half[edges[0]]
                line = shapely.LineString([position[node] + h * away[0], position[node], position[node] + h * away[1]])
                joints.append(line.buffer(h, cap_style="flat", join_style="mitre", mitre_limit=2.0))
            else:
                aside = np.column_stack([-away[:, 1], away[:, 0]]) * half[edges][:, None]
                corners = np.concatenate([position[node] + aside, position[node] - aside])
                joints.append(shapely.MultiPoint(corners).convex_hull)
        side = (building.edges[edges, 1] == node).astype(int)
        ends[edges, side] -= reach[:, None] * away
    bands = shapely.buffer(shapely.linestrings(ends), half, cap_style="flat")
    # corridors of no length, and joints of corridors in one line, have no floor
    floors = [shape for shape in (*bands, *joints) if shape.area > 0]
    return shapely.union_all(floors, grid_size=0.001)


def draw_plan(building: Building, ax: Axes, hostiles: Iterable[int] = (), legend: bool = True) -> None:
    """Draw the floor plan: corridors with their widths, rooms, doors, the start, the outline, a scale bar.

    Parameters
    ----------
    building
        What to draw.
    ax
        Where; gets an equal aspect and loses its frame.
    hostiles
        Nodes to mark.
    legend
        Whether to explain the signs below the plan.
    """
    import shapely
    from matplotlib.lines import Line2D
    from matplotlib.patches import Patch

    nodes = _nodes(building, hostiles)
    rooms = footprints(building)
    corridors = corridor_floor(building)
    ax.add_patch(_patch(shapely.Polygon(building.outline_m), facecolor=_GROUND, edgecolor="none", zorder=0))
    floor = shapely.union_all([corridors, *rooms.values()], grid_size=0.001)
    ax.add_patch(_patch(floor, facecolor=_CORRIDOR, edgecolor=_WALL, linewidth=1.6, joinstyle="round", zorder=1))
    # Where a wall would cross a corridor or the inside of another room
    all_rooms = shapely.union_all(list(rooms.values()), grid_size=0.001)
    inside = shapely.union_all([corridors, all_rooms.buffer(-0.01)], grid_size=0.001)
    for room in rooms.values():
        ax.add_patch(_patch(room, facecolor=_ROOM, edgecolor="none", zorder=2))
        wall = room.exterior.difference(inside)
        for line in getattr(wall, "geoms", [wall]):
            ax.plot(*line.xy, color=_WALL, linewidth=1.3, solid_capstyle="butt", zorder=3)
    doors = np.flatnonzero(building.feature_class == DOOR).tolist()
    for door in doors:
        a, b = _across(building, door)
        ax.plot(*zip(a, b, strict=True), color=_DOOR, linewidth=2.2, solid_capstyle="butt", zorder=4)
    others = (building.kind == FEATURE) & (building.feature_class != DOOR)
    ax.plot(*building.position_m[others].T, "o", color=_FEATURE, markersize=3, zorder=4)
    start = building.position_m[building.start]
    ax.plot(*start, marker="*", markersize=12, color=_START, markeredgecolor="white", zorder=6)
    ax.plot(*building.position_m[nodes].T, **_hostile_style(), markersize=8, zorder=7)
    _finish(ax, building, rooms)
    if legend:
        handles: list[Any] = [Patch(facecolor=_CORRIDOR, edgecolor=_WALL, label="corridor")]
        if rooms:
            handles.append(Patch(facecolor=_ROOM, edgecolor=_WALL, label="room"))
        if doors:
            handles.append(Line2D([], [], color=_DOOR, linewidth=2.2, label="door"))
        if others.any():
            handles.append(
                Line2D([], [], marker="o", color=_FEATURE, markersize=4, linestyle="none", label="other feature")
            )
        handles.append(Line2D([], [], marker="*", markersize=10, color=_START, linestyle="none", label="start"))
        if nodes:
            handles.append(Line2D([], [], **_hostile_style(), markersize=7, label="hostile"))
        _legend(ax, handles)


def draw_graph(building: Building, ax: Axes, hostiles: Iterable[int] = (), legend: bool = True) -> None:
    """Draw the graph: intersections dark, rooms white, features grey (doors square), the start ringed.

    Parameters
    ----------
    building
        What to draw.
    ax
        Where; gets an equal aspect and loses its frame.
    hostiles
        Nodes to mark.
    legend
        Whether to explain the signs below the graph.
    """
    from matplotlib.collections import LineCollection
    from matplotlib.lines import Line2D

    nodes = _nodes(building, hostiles)
    size = float(np.clip(70 / math.sqrt(building.n_nodes), 3.5, 9.0))
    lines = LineCollection(list(building.position_m[building.edges]), colors=_EDGE, linewidths=size / 5, zorder=1)
    ax.add_collection(lines)
    door = building.feature_class == DOOR
    signs: list[tuple[str, NDArray[np.bool_], dict[str, Any]]] = [
        ("intersection", building.kind == INTERSECTION, {"marker": "o", "markerfacecolor": _INK}),
        ("room", building.kind == ROOM, {"marker": "o", "markerfacecolor": "white"}),
        ("door", door, {"marker": "s", "markerfacecolor": _FEATURE}),
        ("other feature", (building.kind == FEATURE) & ~door, {"marker": "o", "markerfacecolor": _FEATURE}),
    ]
    handles: list[Any] = []
    for label, mask, style in signs:
        scale = {"room": 1.35, "door": 0.85, "other feature": 0.85}.get(label, 1.0)
        style |= {"linestyle": "none", "markeredgecolor": _INK, "markeredgewidth": size / 8}
        ax.plot(*building.position_m[mask].T, **style, markersize=size * scale, zorder=3)
        if mask.any():
            handles.append(Line2D([], [], **style, markersize=6.5 * scale, label=label))
    ring: dict[str, Any] = {
        "marker": "o",
        "markerfacecolor": "none",
        "markeredgecolor": _START,
        "linestyle": "none",
    }
    ax.plot(*building.position_m[building.start], **ring, markersize=size * 2.1, markeredgewidth=2.0, zorder=4)
    handles.append(Line2D([], [], **ring, markersize=9, markeredgewidth=2.0, label="start"))
    ax.plot(*building.position_m[nodes].T, **_hostile_style(), markersize=size * 1.2, zorder=5)
    if nodes:
        handles.append(Line2D([], [], **_hostile_style(), markersize=7, label="hostile"))
    _finish(ax, building, footprints(building))
    if legend:
        _legend(ax, handles)


def figure(building: Building, hostiles: Iterable[int] = ()) -> Figure:
    """Return a figure with the plan and the graph side by side, or one above the other if it is wide.

    ``figure(building).savefig(path)`` writes it, in any format that matplotlib knows.
    """
    from matplotlib.figure import Figure

    hostiles = list(hostiles)
    low, high = _bounds(building, footprints(building))
    width, height = high - low
    wide = width > 1.8 * height
    across = 9.0 if wide else 5.5
    panel = float(np.clip(1.12 * across * height / width, 1.5, 9.0)) + 0.4  # with the scale bar and the legend
    drawn = Figure(figsize=(across, 2 * panel) if wide else (2 * across, panel), layout="constrained")
    first, second = drawn.subplots(2, 1) if wide else drawn.subplots(1, 2)
    draw_plan(building, first, hostiles)
    draw_graph(building, second, hostiles)
    return drawn


def _hostile_style() -> dict[str, Any]:
    return {
        "marker": "X",
        "markerfacecolor": _HOSTILE,
        "markeredgecolor": "white",
        "markeredgewidth": 0.6,
        "linestyle": "none",
    }


def _nodes(building: Building, hostiles: Iterable[int]) -> list[int]:
    nodes = [int(node) for node in hostiles]
    for node in nodes:
        if not 0 <= node < building.n_nodes:
            raise TaskliftError(
                f"drawing of {building.name!r}: hostile at node {node}; nodes are 0 to {building.n_nodes - 1}"
            )
    return nodes


def _across(building: Building, node: int) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """The two ends of the line across the corridor at ``node``, as wide as its narrowest corridor."""
    here = slice(building.indptr[node], building.indptr[node + 1])
    away = building.position_m[building.neighbour[here]] - building.position_m[node]
    # Across the line from one neighbour to the next is square to the bisector of a bend
    along = away[0] - away[1] if len(away) > 1 else away[0]
    along = along / max(float(np.hypot(*along)), 1e-9)
    half = building.width_m[building.edge_of[here]].min() / 2 * np.array([-along[1], along[0]])
    return building.position_m[node] - half, building.position_m[node] + half


def _patch(geometry: Any, **style: Any) -> Any:
    """A (multi)polygon with its holes as one patch."""
    from matplotlib.patches import PathPatch
    from matplotlib.path import Path

    rings = []
    for polygon in getattr(geometry, "geoms", [geometry]):
        rings += [Path(np.asarray(ring.coords), closed=True) for ring in (polygon.exterior, *polygon.interiors)]
    return PathPatch(Path.make_compound_path(*rings), **style)


def _bounds(building: Building, rooms: dict[int, Any]) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    points = np.concatenate([building.outline_m, *(np.asarray(room.exterior.coords) for room in rooms.values())])
    return points.min(axis=0), points.max(axis=0)


def _finish(ax: Axes, building: Building, rooms: dict[int, Any]) -> None:
    """Frame everything, equal aspect, and draw a scale bar of a round length in the lower left corner."""
    (x0, y0), (x1, y1) = _bounds(building, rooms)
    extent = max(x1 - x0, y1 - y0)
    rough = max(extent / 5, 1e-3)
    unit = 10.0 ** math.floor(math.log10(rough))
    length = max(step * unit for step in (1, 2, 5) if step * unit <= rough)
    y = y0 - 0.035 * extent
    ax.plot([x0, x0 + length], [y, y], color=_INK, linewidth=2.0, solid_capstyle="butt")
    ax.text(x0 + length + 0.015 * extent, y, f"{length:g} m", va="center", ha="left", fontsize=8, color=_INK)
    pad = 0.02 * extent
    ax.set_xlim(x0 - pad, x1 + pad)
    ax.set_ylim(y - 2 * pad, y1 + pad)
    ax.set_aspect("equal")
    ax.set_axis_off()


def _legend(ax: Axes, handles: list[Any]) -> None:
    ax.legend(
        handles=handles,
        loc="upper center",
        bbox_to_anchor=(0.5, 0.0),
        ncols=min(len(handles), 6),
        frameon=False,
        fontsize=8,
        handletextpad=0.4,
        columnspacing=1.2,
    )
