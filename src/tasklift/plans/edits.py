"""Corrections to a building, in a small text file that people write and that applies again after a new import.

One edit per line; ``#`` begins a remark. Places are metres, as in the overlay and in ``map check --nodes``::

    tasklift-edits 1
    drop node at 12.3 4.5
    merge nodes at 1.0 2.0 and 1.4 2.1
    move node at 1.0 2.0 to 1.5 2.5
    set class at 5.0 6.0 to corner
    set class at 5.0 6.0 to room area 12 obstacles 2
    add door at 7.5 3.0
    add edge from 1.0 2.0 to 3.0 4.0 length 5 width 1.5
    drop edge from 1.0 2.0 to 3.0 4.0
    start at 3.0 4.0

Nodes are named by where they are, not by number, so that the file still fits when a new import numbers them
differently. An edit that does not apply says why, and nothing is changed.
"""

from __future__ import annotations

import math
import os
import re
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from tasklift.building.graph import (
    CLASS_NAMES,
    DOOR,
    FEATURE,
    INTERSECTION,
    NONE,
    ROOM,
    Building,
    buffered_hull,
)
from tasklift.errors import TaskliftError
from tasklift.files import read_text

HEADER = "tasklift-edits 1"
REACH_M = 1.5
SHORTEST_M = 0.05
LARGEST_EDITS_BYTES = 1_000_000

_PLACE = r"(-?[\d.]+(?:[eE][-+]?\d+)?)\s+(-?[\d.]+(?:[eE][-+]?\d+)?)"
_NUMBER = r"([\d.]+)"
_CLASSES = {name: (FEATURE, value) for value, name in CLASS_NAMES.items()}
_CLASSES |= {"room": (ROOM, NONE), "intersection": (INTERSECTION, NONE)}
_FORMS = {
    "drop node": rf"drop node at {_PLACE}",
    "merge nodes": rf"merge nodes at {_PLACE} and {_PLACE}",
    "move node": rf"move node at {_PLACE} to {_PLACE}",
    "set class": rf"set class at {_PLACE} to (\w+)(?: area {_NUMBER})?(?: obstacles (\d{{1,6}}))?",
    "add door": rf"add door at {_PLACE}",
    "add edge": rf"add edge from {_PLACE} to {_PLACE}(?: length {_NUMBER})?(?: width {_NUMBER})?",
    "drop edge": rf"drop edge from {_PLACE} to {_PLACE}",
    "start": rf"start at {_PLACE}",
}
_PATTERNS = {verb: re.compile(form.replace(" ", r"\s+").replace(r"\s+\s+", r"\s+")) for verb, form in _FORMS.items()}


@dataclass(frozen=True)
class Edit:
    """One correction: where it was written, what it does, and its arguments as they were written."""

    where: str
    verb: str
    text: str
    arguments: tuple[str | None, ...]


def read_edits(path: str | os.PathLike[str]) -> list[Edit]:
    """Read an edits file; messages name the line."""
    text = read_text(path)
    if len(text) > LARGEST_EDITS_BYTES:
        raise TaskliftError(f"{path}: larger than {LARGEST_EDITS_BYTES} bytes, which no edits file is")
    return parse_edits(text, str(path))


def parse_edits(text: str, where: str = "edits") -> list[Edit]:
    """Read edits from ``text``; see the module for the form."""
    lines = [(i, line.split("#")[0].strip()) for i, line in enumerate(text.splitlines(), start=1)]
    lines = [(i, line) for i, line in lines if line]
    if not lines or lines[0][1].split() != HEADER.split():
        found = repr(lines[0][1][:60]) if lines else "nothing"
        raise TaskliftError(f"{where}: expected {HEADER!r} in the first line, found {found}")
    edits = []
    for i, line in lines[1:]:
        verb = next((verb for verb in _PATTERNS if line.split()[: len(verb.split())] == verb.split()), None)
        if verb is None:
            raise TaskliftError(
                f"{where}: line {i}: no edit begins like {line[:60]!r}; expected one of {', '.join(_PATTERNS)}"
            )
        match = _PATTERNS[verb].fullmatch(line)
        if match is None:
            raise TaskliftError(f"{where}: line {i}: cannot read {line[:80]!r}; write it like {_example(verb)!r}")
        edits.append(Edit(f"{where}: line {i}", verb, line, match.groups()))
    return edits


def _example(verb: str) -> str:
    assert __doc__ is not None
    return next(line.strip() for line in __doc__.splitlines() if line.strip().startswith(verb))


def apply_edits(building: Building, edits: Sequence[Edit]) -> tuple[Building, list[str]]:
    """Apply corrections in order; returns the corrected building and remarks, a sentence each.

    Raises
    ------
    TaskliftError
        If an edit does not apply, with its line and the reason.
    """
    sketch = _Sketch(building)
    remarks: list[str] = []
    for edit in edits:
        try:
            remark = _ACTIONS[edit.verb](sketch, edit.arguments)
        except TaskliftError as error:
            raise TaskliftError(f"{edit.where}: {edit.text!r} does not apply: {error}") from error
        if remark:
            remarks.append(f"{edit.where}: {remark}")
    return sketch.building([edit.text for edit in edits]), remarks


class _Sketch:
    """A building that can be changed; nodes keep their numbers until it is built again."""

    def __init__(self, building: Building):
        self.source = building
        self.nodes: dict[int, dict[str, Any]] = {
            i: {
                "at": building.position_m[i].copy(),
                "kind": int(building.kind[i]),
                "class": int(building.feature_class[i]),
                "area": float(building.area_m2[i]),
                "obstacles": int(building.obstacles[i]),
            }
            for i in range(building.n_nodes)
        }
        ends = (tuple(pair) for pair in building.edges.tolist())
        sizes = zip(building.length_m.tolist(), building.width_m.tolist(), strict=True)
        self.edges: dict[tuple[int, int], tuple[float, float]] = dict(zip(ends, sizes, strict=True))
        self.start = building.start

    def node(self, x: str | None, y: str | None) -> int:
        """The node nearest to a place, which has to be near."""
        at = _point(x, y)
        away = {i: math.dist(at, node["at"]) for i, node in self.nodes.items()}
        nearest = min(away, key=lambda i: (away[i], i))
        if away[nearest] > REACH_M:
            px, py = self.nodes[nearest]["at"]
            raise TaskliftError(
                f"no node within {REACH_M:g} m of {at[0]:g} {at[1]:g}; the nearest is at {px:.2f} {py:.2f}, "
                f"{away[nearest]:.1f} m away"
            )
        return nearest

    def two_nodes(self, arguments: tuple[str | None, ...]) -> tuple[int, int]:
        a, b = self.node(*arguments[:2]), self.node(*arguments[2:4])
        if a == b:
            x, y = self.nodes[a]["at"]
            raise TaskliftError(f"both places mean the same node, at {x:.2f} {y:.2f}")
        return a, b

    def neighbours(self, node: int) -> list[int]:
        return sorted(a + b - node for a, b in self.edges if node in (a, b))

    def join(self, a: int, b: int, length: float, width: float) -> bool:
        """Add a corridor, or keep the shorter one where there is one already; tells whether it is new."""
        pair = (min(a, b), max(a, b))
        new = pair not in self.edges
        if new or length < self.edges[pair][0]:
            self.edges[pair] = (max(length, SHORTEST_M), width)
        return new

    def drop_edge(self, a: int, b: int) -> tuple[float, float]:
        return self.edges.pop((min(a, b), max(a, b)))

    def straight(self, a: int, b: int) -> float:
        return math.dist(self.nodes[a]["at"], self.nodes[b]["at"])

    def restretch(self, node: int, before: dict[int, float]) -> None:
        """Scale the corridors of a moved node by how much farther its neighbours are now."""
        for other, old in before.items():
            length, width = self.drop_edge(node, other)
            new = self.straight(node, other)
            self.join(node, other, max(length * new / old if old > SHORTEST_M else new, new), width)

    def require_connected(self, what: str) -> None:
        seen, stack = {next(iter(self.nodes))}, [next(iter(self.nodes))]
        beside: dict[int, list[int]] = {node: [] for node in self.nodes}
        for a, b in self.edges:
            beside[a].append(b)
            beside[b].append(a)
        while stack:
            for other in beside[stack.pop()]:
                if other not in seen:
                    seen.add(other)
                    stack.append(other)
        if len(seen) < len(self.nodes):
            few = min(len(seen), len(self.nodes) - len(seen))
            raise TaskliftError(f"{what} would cut off {few} nodes; add an edge first")

    def building(self, texts: list[str]) -> Building:
        order = sorted(self.nodes)
        number = {node: i for i, node in enumerate(order)}
        nodes = [self.nodes[node] for node in order]
        edges = sorted(self.edges)
        position = np.array([node["at"] for node in nodes])
        provenance = dict(self.source.provenance)
        before = provenance.get("edits")
        provenance["edits"] = [*(before if isinstance(before, list) else []), *texts]
        footprints = provenance.pop("footprints", None)
        if isinstance(footprints, dict):
            provenance["footprints"] = {
                str(number[int(old)]): box
                for old, box in footprints.items()
                if str(old).isdigit() and int(old) in number and self.nodes[int(old)]["kind"] == ROOM
            }
        return Building(
            name=self.source.name,
            kind=np.array([node["kind"] for node in nodes], np.int8),
            feature_class=np.array([node["class"] for node in nodes], np.int8),
            position_m=position,
            area_m2=np.array([node["area"] for node in nodes]),
            obstacles=np.array([node["obstacles"] for node in nodes], np.int64),
            edges=np.array([[number[a], number[b]] for a, b in edges], np.int64).reshape(-1, 2),
            length_m=np.array([self.edges[edge][0] for edge in edges]),
            width_m=np.array([self.edges[edge][1] for edge in edges]),
            start=number[self.start],
            outline_m=_outline(self.source, position),
            provenance=provenance,
        )


def _outline(source: Building, position: np.ndarray) -> np.ndarray:
    """The building's outline, or a new hull if a node left it."""
    import shapely

    inside = shapely.distance(shapely.Polygon(source.outline_m), shapely.points(position)) < 1e-3
    return source.outline_m if inside.all() else buffered_hull(np.concatenate([source.outline_m, position]))


def _point(x: str | None, y: str | None) -> tuple[float, float]:
    return _float(x), _float(y)


def _float(text: str | None) -> float:
    try:
        value = float(text or "")
    except ValueError as error:
        raise TaskliftError(f"{text!r} is not a number") from error
    if not abs(value) <= 1e6:
        raise TaskliftError(f"{text!r} is not a distance within a building (m)")
    return value


def _drop_node(sketch: _Sketch, arguments: tuple[str | None, ...]) -> str:
    node = sketch.node(*arguments)
    if node == sketch.start:
        raise TaskliftError("the robots start there; write 'start at …' for another place first")
    near = sketch.neighbours(node)
    remark = ""
    sizes = [sketch.drop_edge(node, other) for other in near]
    at = sketch.nodes.pop(node)["at"]
    if len(near) == 2:
        (first, second), width = sizes, min(sizes[0][1], sizes[1][1])
        if not sketch.join(near[0], near[1], first[0] + second[0], width):
            remark = "its neighbours were joined already; the shorter corridor stays"
    sketch.require_connected(f"dropping the node at {at[0]:.2f} {at[1]:.2f}")
    return remark


def _merge_nodes(sketch: _Sketch, arguments: tuple[str | None, ...]) -> str:
    keep, give = sketch.two_nodes(arguments)
    joined = give in sketch.neighbours(keep)
    if joined:
        sketch.drop_edge(keep, give)
    before = {other: sketch.straight(give, other) for other in sketch.neighbours(give)}
    for other, old in before.items():
        length, width = sketch.drop_edge(give, other)
        new = sketch.straight(keep, other)
        sketch.join(keep, other, max(length * new / old if old > SHORTEST_M else new, new), width)
    if sketch.start == give:
        sketch.start = keep
    del sketch.nodes[give]
    return "" if joined else "the two nodes were not joined by a corridor"


def _move_node(sketch: _Sketch, arguments: tuple[str | None, ...]) -> str:
    node = sketch.node(*arguments[:2])
    target = np.array(_point(*arguments[2:4]))
    before = {other: sketch.straight(node, other) for other in sketch.neighbours(node)}
    sketch.nodes[node]["at"] = target
    sketch.restretch(node, before)
    return ""


def _set_class(sketch: _Sketch, arguments: tuple[str | None, ...]) -> str:
    x, y, name, area, obstacles = arguments
    if name not in _CLASSES:
        raise TaskliftError(f"no class {name!r}; expected {', '.join(_CLASSES)}")
    node = sketch.nodes[sketch.node(x, y)]
    kind, feature = _CLASSES[name]
    if kind != ROOM and (area or obstacles):
        raise TaskliftError(f"only a room has an area and obstacles, not a {name}")
    if kind == ROOM and not area and not node["area"]:
        raise TaskliftError("a room needs its area: write 'to room area 12' (m²)")
    node["kind"], node["class"] = kind, feature
    node["area"] = (_float(area) if area else node["area"]) if kind == ROOM else 0.0
    node["obstacles"] = (int(obstacles) if obstacles else node["obstacles"]) if kind == ROOM else 0
    if kind == ROOM and node["area"] <= 0:
        raise TaskliftError("a room's area is above 0 m²")
    return ""


def _add_door(sketch: _Sketch, arguments: tuple[str | None, ...]) -> str:
    at = np.array(_point(*arguments))
    best, nearest, share = None, math.inf, 0.0
    for a, b in sketch.edges:
        start, along = sketch.nodes[a]["at"], sketch.nodes[b]["at"] - sketch.nodes[a]["at"]
        square = float(along @ along)
        t = min(1.0, max(0.0, float((at - start) @ along) / square)) if square else 0.0
        away = math.dist(at, start + t * along)
        if away < nearest:
            best, nearest, share = (a, b), away, t
    if best is None or nearest > REACH_M:
        raise TaskliftError(
            f"no corridor within {REACH_M:g} m of {at[0]:g} {at[1]:g}; the nearest is {nearest:.1f} m away"
        )
    length, width = sketch.edges[best]
    if min(share, 1 - share) * length < SHORTEST_M:
        raise TaskliftError("that is at the end of a corridor; write 'set class at … to door', or a place between")
    sketch.drop_edge(*best)
    door = max(sketch.nodes) + 1
    sketch.nodes[door] = {"at": at, "kind": FEATURE, "class": DOOR, "area": 0.0, "obstacles": 0}
    sketch.join(best[0], door, share * length, width)
    sketch.join(door, best[1], (1 - share) * length, width)
    return ""


def _add_edge(sketch: _Sketch, arguments: tuple[str | None, ...]) -> str:
    a, b = sketch.two_nodes(arguments)
    straight = sketch.straight(a, b)
    length = _float(arguments[4]) if arguments[4] else straight
    width = _float(arguments[5]) if arguments[5] else float(np.median([w for _, w in sketch.edges.values()] or [2.0]))
    if b in sketch.neighbours(a):
        raise TaskliftError("the two nodes are joined already")
    if min(length, width) < SHORTEST_M:
        raise TaskliftError(f"length and width have to be at least {SHORTEST_M:g} m")
    sketch.join(a, b, length, width)
    return f"shorter than the straight line of {straight:.2f} m" if length < 0.98 * straight else ""


def _drop_edge(sketch: _Sketch, arguments: tuple[str | None, ...]) -> str:
    a, b = sketch.two_nodes(arguments)
    if b not in sketch.neighbours(a):
        raise TaskliftError("no corridor joins these two nodes")
    sketch.drop_edge(a, b)
    sketch.require_connected("dropping that corridor")
    return ""


def _set_start(sketch: _Sketch, arguments: tuple[str | None, ...]) -> str:
    sketch.start = sketch.node(*arguments)
    return ""


_ACTIONS: dict[str, Callable[[_Sketch, tuple[str | None, ...]], str]] = {
    "drop node": _drop_node,
    "merge nodes": _merge_nodes,
    "move node": _move_node,
    "set class": _set_class,
    "add door": _add_door,
    "add edge": _add_edge,
    "drop edge": _drop_edge,
    "start": _set_start,
}
