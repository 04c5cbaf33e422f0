"""Corrections to a building, in a small text file that people write and that applies again after a new import.

One edit per line; ``#`` begins a remark. Places are metres, as in the overlay and in ``map check --nodes``::

    tasklift-edits 1
    drop node at 12.3 4.5
    merge nodes at 1.0 2.0 and 1.4 2.1
    move node at 1.0 2.0 to 1.5 2.5
    set class at 5.0 6.0 to corner
    set class at 5.0 6.0 to room area 12 obstacles 2
    add door at 7.5 3.0
    add node at 7.5 3.0 to 6.0 3.0
    add room at 7.1 8.0 area 12.8 obstacles 1 to 7.1 4.5
    add edge from 1.0 2.0 to 3.0 4.0 length 5 width 1.5
    drop edge from 1.0 2.0 to 3.0 4.0
    start at 3.0 4.0

Nodes are named by where they are, so that the file still fits when a new import numbers them differently. ``node 12``
in place of a place means the node of that number in the building that is edited, as its picture shows it; it is kept as
its place (:func:`as_places`). ``add node`` and ``add room`` join the new node to the place after ``to``: the node
that is there, or else the corridor; without it to the nearest corridor. All lines that do not apply are reported
together, and nothing is changed then.
"""

from __future__ import annotations

import math
import os
import re
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

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
from tasklift.plans.extract.paths import line_length
from tasklift.text import one_line

HEADER = "tasklift-edits 1"
REACH_M = 1.5
SHORTEST_M = 0.05
LARGEST_EDITS_BYTES = 1_000_000

Points = NDArray[np.float64]
Corridor = tuple[float, float, Points]
STRAIGHT: Points = np.zeros((0, 2))

_PLACE = r"(node(?=\s+\d{1,9}(?!\S))|-?[\d.]+(?:[eE][-+]?\d+)?)\s+(-?[\d.]+(?:[eE][-+]?\d+)?)"
_NUMBER = r"([\d.]+)"
_CLASSES = {name: (FEATURE, value) for value, name in CLASS_NAMES.items()}
_CLASSES |= {"room": (ROOM, NONE), "intersection": (INTERSECTION, NONE)}
_FORMS = {
    "drop node": rf"drop node at {_PLACE}",
    "merge nodes": rf"merge nodes at {_PLACE} and {_PLACE}",
    "move node": rf"move node at {_PLACE} to {_PLACE}",
    "add node": rf"add node at {_PLACE}(?: to {_PLACE})?",
    "add room": rf"add room at {_PLACE} area {_NUMBER}(?: obstacles (\d{{1,6}}))?(?: to {_PLACE})?",
    "set class": rf"set class at {_PLACE} to (\w+)(?: area {_NUMBER})?(?: obstacles (\d{{1,6}}))?",
    "add door": rf"add door at {_PLACE}",
    "add edge": rf"add edge from {_PLACE} to {_PLACE}(?: length {_NUMBER})?(?: width {_NUMBER})?",
    "drop edge": rf"drop edge from {_PLACE} to {_PLACE}",
    "start": rf"start at {_PLACE}",
}
_PATTERNS = {verb: re.compile(form.replace(" ", r"\s+").replace(r"\s+\s+", r"\s+")) for verb, form in _FORMS.items()}

# "drop node 12", "merge nodes 1 and 2", "drop edge from 1 to 2" are short for "drop node at node 12" and so on
_SHORT = (
    (re.compile(r"^(drop node|move node|merge nodes)\s+(\d+)(?=\s|$)"), r"\1 at node \2"),
    (re.compile(r"^(set class|start)\s+(node\s+\d+)"), r"\1 at \2"),
    (re.compile(r"\band\s+(\d+)$"), r"and node \1"),
    (re.compile(r"\bfrom\s+(\d+)\s+to\s+(\d+)(?=$|\s+[a-z])"), r"from node \1 to node \2"),
)


@dataclass(frozen=True)
class Edit:
    """One correction: where it was written, what it does, and its arguments as they were written."""

    where: str
    verb: str
    text: str
    arguments: tuple[str | None, ...]


def read_edits(path: str | os.PathLike[str]) -> list[Edit]:
    """Read an edits file; messages name the line."""
    text = read_text(path).removeprefix("\ufeff")
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
    edits, faults = [], []
    for i, line in lines[1:]:
        for short, full in _SHORT:
            line = short.sub(full, line)
        verb = next((verb for verb in _PATTERNS if line.split()[: len(verb.split())] == verb.split()), None)
        if verb is None:
            known = ", ".join(_PATTERNS)
            faults.append(f"{where}: line {i}: no edit begins like {line[:60]!r}; expected one of {known}")
        elif (match := _PATTERNS[verb].fullmatch(line)) is None:
            faults.append(f"{where}: line {i}: cannot read {line[:80]!r}; write it like {_example(verb)!r}")
        else:
            edits.append(Edit(f"{where}: line {i}", verb, line, match.groups()))
    _raise_all(faults)
    return edits


def _raise_all(faults: Sequence[str]) -> None:
    """Raise the first fault; the others are its notes, which the command line prints below it."""
    if faults:
        error = TaskliftError(faults[0])
        for fault in faults[1:]:
            error.add_note(one_line(fault))
        raise error


def as_places(building: Building, edits: Sequence[Edit]) -> list[str]:
    """Return the lines of the edits with places in the stead of numbers, ready to be written below the header."""

    def place(match: re.Match[str]) -> str:
        x, y = _numbered(building, match[1])
        return f"{x:.3f} {y:.3f}"

    return [re.sub(r"\bnode\s+(\d+)\b", place, edit.text) for edit in edits]


def _numbered(building: Building, number: str) -> tuple[float, float]:
    if not 0 <= int(number) < building.n_nodes:
        raise TaskliftError(f"node {number} does not exist; nodes are 0 to {building.n_nodes - 1}")
    x, y = building.position_m[int(number)].tolist()
    return x, y


def _example(verb: str) -> str:
    assert __doc__ is not None
    return next(line.strip() for line in __doc__.splitlines() if line.strip().startswith(verb))


def apply_edits(building: Building, edits: Sequence[Edit]) -> tuple[Building, list[str]]:
    """Apply corrections in order; returns the corrected building and remarks, a sentence each.

    Raises
    ------
    TaskliftError
        If edits do not apply, with the line and the reason of the first; its notes have the others.
    """
    sketch = _Sketch(building)
    remarks: list[str] = []
    faults: list[str] = []
    for edit in edits:
        before = sketch.state()
        try:
            remark = _ACTIONS[edit.verb](sketch, edit.arguments)
        except TaskliftError as error:
            faults.append(f"{edit.where}: {edit.text!r} does not apply: {error}")
            sketch.nodes, sketch.edges, sketch.start = before
            continue
        if remark:
            remarks.append(f"{edit.where}: {remark}")
    _raise_all(faults)
    return sketch.building(as_places(building, edits)), remarks


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
        sizes = zip(building.length_m.tolist(), building.width_m.tolist(), building.course_m, strict=True)
        # length, width and course from the lower node to the higher one
        self.edges: dict[tuple[int, int], Corridor] = dict(zip(ends, sizes, strict=True))
        self.start = building.start

    def state(self) -> tuple[dict[int, dict[str, Any]], dict[tuple[int, int], Corridor], int]:
        """What an edit may change, to be put back where it does not apply."""
        return {i: dict(node) for i, node in self.nodes.items()}, dict(self.edges), self.start

    def place(self, x: str | None, y: str | None) -> tuple[float, float]:
        """The point that an edit names, by ``x y`` or by ``node 12`` of the building that is edited."""
        if x == "node":
            return _numbered(self.source, y if y is not None and y.isdigit() else "-1")
        return _float(x), _float(y)

    def node(self, x: str | None, y: str | None) -> int:
        """The node nearest to a place, which has to be near; by number exactly that one, if it is still there."""
        at = self.place(x, y)
        if x == "node" and int(y or 0) in self.nodes:
            return int(y or 0)
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

    def join(self, a: int, b: int, length: float, width: float, course: Points = STRAIGHT) -> bool:
        """Add a corridor, or keep the shorter one where there is one already; tells whether it is new."""
        pair = (min(a, b), max(a, b))
        new = pair not in self.edges
        if new or length < self.edges[pair][0]:
            self.edges[pair] = (max(length, SHORTEST_M), width, course if a < b else course[::-1])
        return new

    def drop_edge(self, a: int, b: int) -> Corridor:
        """Remove a corridor; its course is from ``a`` to ``b``."""
        length, width, course = self.edges.pop((min(a, b), max(a, b)))
        return length, width, course if a < b else course[::-1]

    def line(self, a: int, b: int) -> Points:
        """The polyline of a corridor, its nodes included."""
        return np.concatenate([[self.nodes[a]["at"]], self.edges[a, b][2], [self.nodes[b]["at"]]])

    def add(self, at: Points, node: dict[str, Any]) -> int:
        """Add a node, joined to nothing yet; numbers are not given twice."""
        number = max(max(self.nodes) + 1, self.source.n_nodes)
        self.nodes[number] = {"at": at, "area": 0.0, "obstacles": 0} | node
        return number

    def usual_width(self) -> float:
        return float(np.median([width for _, width, _ in self.edges.values()] or [2.0]))

    def put_between(
        self, at: Points, node: dict[str, Any], stand: Points | None = None, reach_m: float = REACH_M
    ) -> int:
        """Put a node into the corridor nearest to ``at``: at ``stand``, or on the corridor itself.

        Where that is the end of the corridor, and the node may stand on it, the node there is taken.
        """
        best, nearest, index, spot = None, math.inf, 0, at
        for pair in self.edges:
            line = self.line(*pair)
            away, i, point = _nearest_on(line, at)
            if away < nearest:
                best, nearest, index, spot = pair, away, i, point
        if best is None or nearest > reach_m:
            raise TaskliftError(
                f"no corridor within {reach_m:g} m of {at[0]:g} {at[1]:g}; the nearest is {nearest:.1f} m away"
            )
        line = self.line(*best)
        before, after = np.concatenate([line[: index + 1], [spot]]), np.concatenate([[spot], line[index + 1 :]])
        share = line_length(before) / max(line_length(before) + line_length(after), 1e-9)
        length, width, _ = self.edges[best]
        if min(share, 1 - share) * length < SHORTEST_M:
            if stand is None:
                return best[round(share)]
            raise TaskliftError("that is at the end of a corridor; write 'set class at … to door', or a place between")
        self.drop_edge(*best)
        new = self.add(spot if stand is None else stand, node)
        self.join(best[0], new, share * length, width, before[1:-1])
        self.join(new, best[1], (1 - share) * length, width, after[1:-1])
        return new

    def straight(self, a: int, b: int) -> float:
        return math.dist(self.nodes[a]["at"], self.nodes[b]["at"])

    def restretch(self, node: int, before: dict[int, float]) -> None:
        """Scale the corridors of a moved node by how much farther its neighbours are now."""
        for other, old in before.items():
            length, width, _ = self.drop_edge(node, other)
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
        for key in ("footprints", "names"):
            if isinstance(by_node := provenance.get(key), dict):
                provenance[key] = {
                    str(number[int(old)]): value
                    for old, value in by_node.items()
                    if str(old).isdigit() and int(old) in number
                    and (key == "names" or self.nodes[int(old)]["kind"] == ROOM)
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
            course_m=tuple(self.edges[edge][2] for edge in edges),
            start=number[self.start],
            outline_m=_outline(self.source, position),
            provenance=provenance,
        )


def _nearest_on(line: Points, at: Points) -> tuple[float, int, Points]:
    """How far a polyline is from a point, on which of its parts, and the point of it that is nearest."""
    start, along = line[:-1], np.diff(line, axis=0)
    square = np.maximum((along**2).sum(axis=1), 1e-12)
    t = np.clip(((at - start) * along).sum(axis=1) / square, 0, 1)
    points = start + t[:, None] * along
    away = np.hypot(*(points - at).T)
    i = int(away.argmin())
    return float(away[i]), i, points[i]


def _outline(source: Building, position: np.ndarray) -> np.ndarray:
    """The building's outline, or a new hull if a node left it."""
    import shapely

    inside = shapely.distance(shapely.Polygon(source.outline_m), shapely.points(position)) < 1e-3
    return source.outline_m if inside.all() else buffered_hull(np.concatenate([source.outline_m, position]))


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
    sizes = [sketch.drop_edge(other, node) for other in near]
    at = sketch.nodes.pop(node)["at"]
    if len(near) == 2:
        (first, second), width = sizes, min(sizes[0][1], sizes[1][1])
        course = np.concatenate([first[2], [at], second[2][::-1]])
        if not sketch.join(near[0], near[1], first[0] + second[0], width, course):
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
        length, width, _ = sketch.drop_edge(give, other)
        new = sketch.straight(keep, other)
        sketch.join(keep, other, max(length * new / old if old > SHORTEST_M else new, new), width)
    if sketch.start == give:
        sketch.start = keep
    del sketch.nodes[give]
    return "" if joined else "the two nodes were not joined by a corridor"


def _move_node(sketch: _Sketch, arguments: tuple[str | None, ...]) -> str:
    node = sketch.node(*arguments[:2])
    target = np.array(sketch.place(*arguments[2:4]))
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
    at = np.array(sketch.place(*arguments))
    sketch.put_between(at, {"kind": FEATURE, "class": DOOR}, at)
    return ""


def _add_node(sketch: _Sketch, arguments: tuple[str | None, ...]) -> str:
    at = np.array(sketch.place(*arguments[:2]))
    if arguments[2] is None:
        sketch.put_between(at, {"kind": INTERSECTION, "class": NONE}, at)
        return ""
    return _add_beside(sketch, at, {"kind": INTERSECTION, "class": NONE}, arguments[2:4])


def _add_room(sketch: _Sketch, arguments: tuple[str | None, ...]) -> str:
    at = np.array(sketch.place(*arguments[:2]))
    area = _float(arguments[2])
    if area <= 0:
        raise TaskliftError("a room's area is above 0 m²")
    room = {"kind": ROOM, "class": NONE, "area": area, "obstacles": int(arguments[3] or 0)}
    return _add_beside(sketch, at, room, arguments[4:6])


def _add_beside(sketch: _Sketch, at: Points, node: dict[str, Any], to: tuple[str | None, ...]) -> str:
    """Add a node and a straight corridor from it to a node or to a corridor, which gets an intersection there."""
    if any(math.dist(at, other["at"]) < SHORTEST_M for other in sketch.nodes.values()):
        raise TaskliftError("there is a node at that place already")
    if to[0] is not None:
        point = np.array(sketch.place(to[0], to[1]))
        try:
            joined = sketch.node(*to)
        except TaskliftError:
            joined = sketch.put_between(point, {"kind": INTERSECTION, "class": NONE})
    else:
        joined = sketch.put_between(at, {"kind": INTERSECTION, "class": NONE}, reach_m=math.inf)
    new = sketch.add(at, node)
    sketch.join(joined, new, sketch.straight(joined, new), sketch.usual_width())
    x, y = sketch.nodes[joined]["at"]
    return "" if to[0] is not None else f"its corridor leads to {x:.2f} {y:.2f}"


def _add_edge(sketch: _Sketch, arguments: tuple[str | None, ...]) -> str:
    a, b = sketch.two_nodes(arguments)
    straight = sketch.straight(a, b)
    length = _float(arguments[4]) if arguments[4] else straight
    width = _float(arguments[5]) if arguments[5] else sketch.usual_width()
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
    "add node": _add_node,
    "add room": _add_room,
    "drop node": _drop_node,
    "merge nodes": _merge_nodes,
    "move node": _move_node,
    "set class": _set_class,
    "add door": _add_door,
    "add edge": _add_edge,
    "drop edge": _drop_edge,
    "start": _set_start,
}
