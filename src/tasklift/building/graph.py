"""A building as a graph: rooms, intersections and features, joined by straight corridors (paper, section IV).

The arrays of a :class:`Building` are frozen: whoever holds one may compile it, hash it and share it between
threads. Everything that a file or a caller can get wrong is checked once, here, and the message names the
node or the edge at fault.
"""

from __future__ import annotations

import hashlib
import json
import os
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from importlib import import_module
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from tasklift.building.coverage import coverage
from tasklift.checks import check_name, number, plain, whole_number
from tasklift.errors import TaskliftError
from tasklift.files import canonical_json, read_document, write_atomically
from tasklift.text import html_picture, shown

FORMAT, VERSION = "tasklift-building", 1

ROOM, INTERSECTION, FEATURE = 0, 1, 2
KIND_NAMES = ("room", "intersection", "feature")

NONE, BEND, CORNER, DOOR, OTHER = 1, 2, 3, 4, 5
CLASS_NAMES = {BEND: "bend", CORNER: "corner", DOOR: "door", OTHER: "other"}

OUTLINE_MARGIN_M = 2.0
# Costs and speeds are whole millimetres further on: anything smaller would vanish, anything larger than a
# thousand kilometres is a mistake in the units.
SMALLEST_M, LARGEST_M = 0.001, 1e6
LARGEST_COUNT = 10**6
#: Ten times the largest plan seen. Drawing takes time that grows with nodes × edges.
MOST_NODES, MOST_EDGES = 10_000, 40_000
MOST_COURSE_POINTS = 1_000

_KINDS = {name: kind for kind, name in enumerate(KIND_NAMES)}
_CLASSES = {name: value for value, name in CLASS_NAMES.items()}


@dataclass(frozen=True, eq=False, repr=False)
class Building:
    """A connected building with ``N`` nodes and ``E`` corridors. Two are equal if their content is.

    Edges may be given in any order and direction; they are kept with the lower node first, sorted. All arrays
    are copied and read-only.

    Parameters
    ----------
    name
        For people; not part of the content.
    kind
        ``int8 (N,)``: :data:`ROOM`, :data:`INTERSECTION` or :data:`FEATURE`.
    feature_class
        ``int8 (N,)``: :data:`BEND`, :data:`CORNER`, :data:`DOOR` or :data:`OTHER` at features, :data:`NONE`
        elsewhere: the values of the paper's variable FTR (Table I).
    position_m
        ``float64 (N, 2)``, x to the right, y up (m).
    area_m2, obstacles
        ``float64 (N,)`` and ``int64 (N,)``: size and number of obstacles of each room, 0 elsewhere.
    edges
        ``int64 (E, 2)``: the two nodes of each corridor. No self-loops, no parallel corridors.
    length_m, width_m
        ``float64 (E,)`` (m), in the order of ``edges``.
    course_m
        How each corridor runs, in the order of ``edges``: the points ``float64 (k, 2)`` between its two nodes,
        from the first to the second, without them; empty for a straight corridor. ``None``: all are straight.
        In the file it is the field ``course`` of an edge, ``[[x, y], …]``. A straight corridor leaves it out.
    start
        The node where the robots begin.
    outline_m
        ``float64 (K, 2)``: a simple polygon around all nodes, not closed; ``None``: the convex hull of the
        nodes, buffered by 2 m.
    provenance
        Where the building comes from, JSON values only; not part of the content.

    Raises
    ------
    TaskliftError
        With the faulty node or edge.

    Examples
    --------
    >>> hall = Building(
    ...     "hall", kind=[ROOM, FEATURE, ROOM], feature_class=[NONE, DOOR, NONE],
    ...     position_m=[(0, 0), (4, 0), (8, 0)], area_m2=[12, 0, 20], obstacles=[1, 0, 0],
    ...     edges=[(0, 1), (1, 2)], length_m=[4, 4], width_m=[1.2, 1.2], start=0,
    ... )
    >>> hall
    Building('hall': 2 rooms, 0 intersections, 1 feature, 2 edges)
    >>> hall.neighbour[hall.indptr[1] : hall.indptr[2]].tolist()
    [0, 2]
    """

    name: str
    kind: NDArray[np.int8]
    feature_class: NDArray[np.int8]
    position_m: NDArray[np.float64]
    area_m2: NDArray[np.float64]
    obstacles: NDArray[np.int64]
    edges: NDArray[np.int64]
    length_m: NDArray[np.float64]
    width_m: NDArray[np.float64]
    start: int
    outline_m: NDArray[np.float64] = None  # type: ignore[assignment]  # None is replaced at construction
    course_m: tuple[NDArray[np.float64], ...] = None  # type: ignore[assignment]  # likewise
    provenance: dict[str, Any] = field(default_factory=dict)

    def __post_init__(self) -> None:
        if self.name != "":
            check_name(self.name, "building")
        where = f"building {self.name!r}"
        kind = _array(where, "kind", self.kind, np.int8, (None,))
        n = len(kind)
        if not 2 <= n <= MOST_NODES:
            bound = "at least 2" if n < 2 else f"at most {MOST_NODES:,}"
            raise TaskliftError(f"{where}: expected {bound} nodes, found {n:,}")
        arrays = {
            "kind": kind,
            "feature_class": _array(where, "feature_class", self.feature_class, np.int8, (n,)),
            "position_m": _array(where, "position_m", self.position_m, np.float64, (n, 2)) + 0.0,  # no -0.0
            "area_m2": _array(where, "area_m2", self.area_m2, np.float64, (n,)) + 0.0,
            "obstacles": _array(where, "obstacles", self.obstacles, np.int64, (n,)),
        }
        edges = _array(where, "edges", self.edges, np.int64, (None, 2))
        if len(edges) > MOST_EDGES:
            raise TaskliftError(f"{where}: expected at most {MOST_EDGES:,} edges, found {len(edges):,}")
        length = _array(where, "length_m", self.length_m, np.float64, (len(edges),))
        width = _array(where, "width_m", self.width_m, np.float64, (len(edges),))
        course = _courses(where, self.course_m, edges)
        edges = np.sort(edges, axis=1)
        order = np.lexsort((edges[:, 1], edges[:, 0]))
        arrays |= {"edges": edges[order], "length_m": length[order], "width_m": width[order]}

        _check_nodes(where, arrays)
        _check_edges(where, n, arrays)
        whole_number(self.start, f"{where}: start", 0, n - 1)
        _check_connected(where, n, arrays["edges"], int(self.start))
        if self.outline_m is None:
            arrays["outline_m"] = buffered_hull(arrays["position_m"])
        else:
            arrays["outline_m"] = _array(where, "outline", self.outline_m, np.float64, (None, 2)) + 0.0
            _check_outline(where, arrays["outline_m"], arrays["position_m"])
        try:
            provenance = plain(json.loads(canonical_json(self.provenance)), f"{where}, provenance")
        except TaskliftError:
            raise
        except (TypeError, ValueError, RecursionError) as error:
            raise TaskliftError(f"{where}: provenance is not plain JSON ({error})") from error
        if not isinstance(provenance, dict):
            raise TaskliftError(f"{where}: expected provenance as an object, found {self.provenance!r}")
        for key, value in arrays.items():
            value.flags.writeable = False
            object.__setattr__(self, key, value)
        object.__setattr__(self, "course_m", tuple(course[i] for i in order.tolist()))
        object.__setattr__(self, "start", int(self.start))
        object.__setattr__(self, "provenance", provenance)

    # -- sizes and identity -----------------------------------------------------------------------

    @property
    def n_nodes(self) -> int:
        """Number of nodes, ``N``."""
        return len(self.kind)

    @property
    def n_edges(self) -> int:
        """Number of corridors, ``E``."""
        return len(self.edges)

    @cached_property
    def content_id(self) -> str:
        """SHA-256 (hex) of everything but the name and the provenance; the same after saving and loading."""
        document = self.to_json()
        del document["name"], document["provenance"]
        return hashlib.sha256(canonical_json(document).encode()).hexdigest()

    @cached_property
    def map_id(self) -> int:
        """The first 63 bits of the content id: the building's part of every random key."""
        return int(self.content_id[:16], 16) >> 1

    def __eq__(self, other: object) -> bool:
        return self.content_id == other.content_id if isinstance(other, Building) else NotImplemented

    def __hash__(self) -> int:
        return hash(self.content_id)

    def __repr__(self) -> str:
        kinds = [(int(np.sum(self.kind == kind)), name) for kind, name in enumerate(KIND_NAMES)]
        parts = [f"{n} {name}{'' if n == 1 else 's'}" for n, name in [*kinds, (self.n_edges, "edge")]]
        return f"Building({shown(self.name)}: {', '.join(parts)})"

    def plot(self, hostiles: Iterable[int] = ()) -> Any:
        """Draw the building as a plan and as a graph; return the matplotlib figure.

        Parameters
        ----------
        hostiles
            Nodes at which to draw one.
        """
        # by name, since the module that draws imports this one
        return import_module("tasklift.building.draw").figure(self, hostiles)

    def _repr_html_(self) -> str:
        return html_picture(repr(self), self.plot())

    def line_m(self, edge: int) -> NDArray[np.float64]:
        """Return the corridor in row ``edge`` of ``edges`` as a polyline ``float64 (k, 2)``, k ≥ 2, nodes included."""
        a, b = self.edges[edge]
        return np.concatenate([self.position_m[[a]], self.course_m[edge], self.position_m[[b]]])

    # -- derived arrays ---------------------------------------------------------------------------

    @cached_property
    def _half_edges(self) -> tuple[NDArray[np.int64], NDArray[np.int64], NDArray[np.int64]]:
        origin = self.edges.T.ravel()
        target = self.edges[:, ::-1].T.ravel()
        order = np.lexsort((target, origin))
        indptr = np.zeros(self.n_nodes + 1, np.int64)
        np.cumsum(np.bincount(origin, minlength=self.n_nodes), out=indptr[1:])
        edge_of = np.tile(np.arange(self.n_edges), 2)
        found = indptr, target[order], edge_of[order]
        for value in found:
            value.flags.writeable = False
        return found

    @property
    def indptr(self) -> NDArray[np.int64]:
        """``int64 (N + 1,)``: the half-edges of node ``i`` are ``indptr[i]`` to ``indptr[i + 1]`` (CSR)."""
        return self._half_edges[0]

    @property
    def neighbour(self) -> NDArray[np.int64]:
        """``int64 (2E,)``: the node at the far end of each half-edge, ascending within a node."""
        return self._half_edges[1]

    @property
    def edge_of(self) -> NDArray[np.int64]:
        """``int64 (2E,)``: the row of ``edges`` to which each half-edge belongs."""
        return self._half_edges[2]

    @cached_property
    def degree(self) -> NDArray[np.int64]:
        """``int64 (N,)``: number of corridors at each node."""
        degree = np.diff(self.indptr)
        degree.flags.writeable = False
        return degree

    @cached_property
    def coverage(self) -> NDArray[np.float64]:
        """``float64 (2E,)``: CovA of each half-edge at its node; sums to 1 at every node."""
        found = coverage(self.position_m, self.outline_m, self.indptr, self.neighbour)
        found.flags.writeable = False
        return found

    # -- files ------------------------------------------------------------------------------------

    def to_json(self) -> dict[str, Any]:
        """Return the building as plain JSON values; :meth:`from_json` gives an equal building back."""
        nodes = []
        columns = zip(
            self.kind.tolist(),
            self.feature_class.tolist(),
            self.position_m.tolist(),
            self.area_m2.tolist(),
            self.obstacles.tolist(),
            strict=True,
        )
        for i, (kind, feature, (x, y), area, obstacles) in enumerate(columns):
            node: dict[str, Any] = {"id": i, "kind": KIND_NAMES[kind]}
            if kind == FEATURE:
                node["class"] = CLASS_NAMES[feature]
            node |= {"x": x, "y": y}
            if kind == ROOM:
                node |= {"area_m2": area, "obstacles": obstacles}
            nodes.append(node)
        corridors = []
        sizes = zip(self.length_m.tolist(), self.width_m.tolist(), self.course_m, strict=True)
        for (a, b), (length, width, course) in zip(self.edges.tolist(), sizes, strict=True):
            corridor: dict[str, Any] = {"a": a, "b": b, "length_m": length, "width_m": width}
            if len(course):
                corridor["course"] = course.tolist()
            corridors.append(corridor)
        return {
            "format": FORMAT,
            "version": VERSION,
            "name": self.name,
            "start": self.start,
            "outline": self.outline_m.tolist(),
            "nodes": nodes,
            "edges": corridors,
            "provenance": json.loads(canonical_json(self.provenance)),
        }

    def save(self, path: str | os.PathLike[str]) -> None:
        """Write the building to ``path`` as JSON, one node and one edge per line."""
        parts = []
        for key, value in self.to_json().items():
            if isinstance(value, list):
                lines = ",\n".join("    " + json.dumps(item, ensure_ascii=False) for item in value)
                parts.append(f'  "{key}": [\n{lines}\n  ]')
            else:
                parts.append(f'  "{key}": {json.dumps(value, ensure_ascii=False)}')
        write_atomically(path, "{\n" + ",\n".join(parts) + "\n}\n")

    @classmethod
    def load(cls, path: str | os.PathLike[str]) -> Building:
        """Read a building from the JSON file ``path``, checking every field."""
        return cls.from_json(read_document(path, FORMAT, VERSION), str(path))

    @classmethod
    def from_json(cls, document: Mapping[str, Any], where: str = "building") -> Building:
        """Make a building of the JSON values in ``document``; messages begin with ``where``.

        ``outline`` and ``provenance`` may be missing; every other field of :meth:`to_json` must be there, and
        no other. The ids of the nodes are 0 to N − 1, in order.
        """
        if not isinstance(document, Mapping):
            raise TaskliftError(f"{where}: expected an object, found {type(document).__name__}")
        required = ("format", "version", "name", "start", "nodes", "edges")
        _check_fields(where, document, required, ("outline", "provenance"))
        if document["format"] != FORMAT or document["version"] != VERSION:
            raise TaskliftError(
                f"{where}: expected format {FORMAT!r} version {VERSION}, "
                f"found {shown(document['format'])} version {shown(document['version'])}"
            )
        nodes = [_read_node(where, i, node) for i, node in enumerate(_list(where, document, "nodes"))]
        edges = [_read_edge(where, i, edge) for i, edge in enumerate(_list(where, document, "edges"))]
        if not isinstance(document.get("provenance", {}), dict):
            raise TaskliftError(f"{where}: field 'provenance': expected an object")
        outline = None
        if "outline" in document:
            outline = np.array(
                [_read_point(f"{where}: outline point {i}", p) for i, p in enumerate(_list(where, document, "outline"))]
            ).reshape(-1, 2)
        kind, feature_class, x, y, area, obstacles = zip(*nodes, strict=True) if nodes else ((),) * 6
        a, b, length, width, course = zip(*edges, strict=True) if edges else ((),) * 5
        try:
            return cls(
                name=document["name"],
                kind=np.array(kind, np.int8),
                feature_class=np.array(feature_class, np.int8),
                position_m=np.array([x, y], np.float64).T,
                area_m2=np.array(area, np.float64),
                obstacles=np.array(obstacles, np.int64),
                edges=np.array([a, b], np.int64).T,
                length_m=np.array(length, np.float64),
                width_m=np.array(width, np.float64),
                start=document["start"],
                outline_m=outline,  # type: ignore[arg-type]
                course_m=course,
                provenance=document.get("provenance", {}),
            )
        except TaskliftError as error:
            raise TaskliftError(f"{where}: {error}") from error

    def to_networkx(self) -> Any:
        """Return a ``networkx.Graph`` with the node and edge fields of the file as attributes."""
        try:
            import networkx
        except ImportError as error:
            raise TaskliftError("networkx is not installed; type: pip install networkx") from error
        document = self.to_json()
        graph = networkx.Graph(name=self.name, start=self.start)
        for node in document["nodes"]:
            graph.add_node(node.pop("id"), **node)
        for edge in document["edges"]:
            graph.add_edge(edge.pop("a"), edge.pop("b"), **edge)
        return graph


def buffered_hull(points_m: NDArray[np.float64], margin_m: float = OUTLINE_MARGIN_M) -> NDArray[np.float64]:
    """Return the convex hull of ``points_m`` (n, 2), grown by ``margin_m``: ``float64 (K, 2)``, open.

    Corners are rounded off with 32 points to the circle, coordinates to whole millimetres, so that the
    outline does not depend on the last bit of anybody's trigonometry.
    """
    import shapely

    hull = shapely.get_coordinates(shapely.MultiPoint(points_m).convex_hull)
    angle = np.arange(32) * (2 * np.pi / 32)
    disc = margin_m * np.column_stack([np.cos(angle), np.sin(angle)])
    grown = np.round((hull[:, None, :] + disc).reshape(-1, 2), 3)
    return shapely.get_coordinates(shapely.MultiPoint(grown).convex_hull)[:-1] + 0.0


# -- checks on arrays -------------------------------------------------------------------------------


def _array(where: str, name: str, value: ArrayLike, dtype: Any, shape: tuple[int | None, ...]) -> Any:
    """A private copy of ``value`` with the dtype and shape expected; no silent truncation of numbers."""
    try:
        given = np.asarray(value)
        if given.dtype.kind not in "iuf" and given.size:
            raise ValueError(f"numbers expected, found {given.dtype}")
        if not given.size and len(shape) == 2:
            given = given.reshape(0, shape[1] or 0)
        with np.errstate(invalid="ignore", over="ignore"):
            array = np.array(given, dtype=dtype)
        if np.dtype(dtype).kind == "i" and not np.array_equal(array, given):
            raise ValueError(f"whole numbers that fit {np.dtype(dtype)} expected")
    except (ValueError, TypeError, OverflowError) as error:
        raise TaskliftError(f"{where}: {name}: {error}") from error
    if array.ndim != len(shape) or any(n is not None and n != m for n, m in zip(shape, array.shape, strict=True)):
        text = ", ".join("any" if n is None else str(n) for n in shape)
        raise TaskliftError(f"{where}: {name}: expected shape ({text}), found {array.shape}")
    return array


def _first(mask: ArrayLike) -> int | None:
    found = np.flatnonzero(mask)
    return int(found[0]) if len(found) else None


def _check_nodes(where: str, arrays: Mapping[str, Any]) -> None:
    kind, feature, area, obstacles = (arrays[key] for key in ("kind", "feature_class", "area_m2", "obstacles"))
    position = arrays["position_m"]
    room, is_feature = kind == ROOM, kind == FEATURE
    with np.errstate(invalid="ignore"):
        faults = (
            ((kind < ROOM) | (kind > FEATURE), "kind", kind, "expected 0 room, 1 intersection or 2 feature"),
            (
                is_feature & ((feature < BEND) | (feature > OTHER)),
                "class",
                feature,
                "a feature needs a class: 2 bend, 3 corner, 4 door or 5 other",
            ),
            (~is_feature & (feature != NONE), "class", feature, "only features have a class (1 elsewhere)"),
            (~(np.abs(position) <= LARGEST_M).all(axis=1), "position", position, "expected finite metres"),
            (
                room & ~((area > 0) & (area <= LARGEST_M)),
                "area_m2",
                area,
                f"a room needs an area above 0 and up to {LARGEST_M:g}",
            ),
            (~room & (area != 0), "area_m2", area, "only rooms have an area"),
            (
                (obstacles < 0) | (obstacles > LARGEST_COUNT),
                "obstacles",
                obstacles,
                f"expected 0 to {LARGEST_COUNT}",
            ),
            (~room & (obstacles != 0), "obstacles", obstacles, "only rooms have obstacles"),
        )
    for mask, name, values, expected in faults:
        i = _first(mask)
        if i is not None:
            raise TaskliftError(f"{where}: node {i}: {name} is {values[i].tolist()!r}; {expected}")


def _check_edges(where: str, n: int, arrays: Mapping[str, Any]) -> None:
    edges = arrays["edges"]
    i = _first(((edges < 0) | (edges >= n)).any(axis=1))
    if i is not None:
        a, b = edges[i].tolist()
        missing = a if not 0 <= a < n else b
        raise TaskliftError(f"{where}: edge {a}-{b}: node {missing} does not exist; nodes are 0 to {n - 1}")
    i = _first(edges[:, 0] == edges[:, 1])
    if i is not None:
        raise TaskliftError(f"{where}: edge {edges[i, 0]}-{edges[i, 1]} joins node {edges[i, 0]} to itself")
    i = _first((edges[1:] == edges[:-1]).all(axis=1))
    if i is not None:
        raise TaskliftError(
            f"{where}: edge {edges[i, 0]}-{edges[i, 1]} is there twice; "
            "put a node of kind feature into one of two parallel corridors"
        )
    for name in ("length_m", "width_m"):
        value = arrays[name]
        with np.errstate(invalid="ignore"):
            i = _first(~((value >= SMALLEST_M) & (value <= LARGEST_M)))
        if i is not None:
            raise TaskliftError(
                f"{where}: edge {edges[i, 0]}-{edges[i, 1]}: {name} is {value[i]}; "
                f"expected {SMALLEST_M:g} to {LARGEST_M:g}"
            )


def _courses(where: str, given: Sequence[ArrayLike] | None, edges: NDArray[np.int64]) -> list[NDArray[np.float64]]:
    """Private, read-only copies of the courses, each from the lower node to the higher one."""
    if given is None:
        given = [()] * len(edges)
    if len(given) != len(edges):
        raise TaskliftError(f"{where}: course_m: expected one for each of {len(edges)} edges, found {len(given)}")
    found = []
    for (a, b), points in zip(edges.tolist(), given, strict=True):
        at = f"edge {a}-{b}: course"
        course = _array(where, at, points, np.float64, (None, 2)) + 0.0
        if len(course) > MOST_COURSE_POINTS:
            raise TaskliftError(f"{where}: {at}: expected at most {MOST_COURSE_POINTS:,} points, found {len(course):,}")
        i = _first(~(np.abs(course) <= 2 * LARGEST_M).all(axis=1))
        if i is not None:
            raise TaskliftError(f"{where}: {at}: point {i}: expected finite metres, found {course[i].tolist()}")
        course = course[::-1].copy() if a > b else course
        course.flags.writeable = False
        found.append(course)
    return found


def _check_connected(where: str, n: int, edges: NDArray[np.int64], start: int) -> None:
    neighbours: list[list[int]] = [[] for _ in range(n)]
    for a, b in edges.tolist():
        neighbours[a].append(b)
        neighbours[b].append(a)
    seen = [False] * n
    seen[start] = True
    stack = [start]
    while stack:
        for j in neighbours[stack.pop()]:
            if not seen[j]:
                seen[j] = True
                stack.append(j)
    if not all(seen):
        raise TaskliftError(
            f"{where}: node {seen.index(False)} cannot be reached from start {start} "
            f"({seen.count(False)} of {n} nodes cannot); add an edge or remove them"
        )


def _check_outline(where: str, outline: NDArray[np.float64], position: NDArray[np.float64]) -> None:
    import shapely

    if len(outline) < 3:
        raise TaskliftError(f"{where}: outline: expected at least 3 points, found {len(outline)}")
    i = _first(~(np.abs(outline) <= 2 * LARGEST_M).all(axis=1))
    if i is not None:
        raise TaskliftError(f"{where}: outline point {i}: expected finite metres, found {outline[i].tolist()}")
    polygon = shapely.Polygon(outline)
    if not polygon.is_valid or polygon.area <= 0:
        reason = shapely.is_valid_reason(polygon)
        raise TaskliftError(f"{where}: outline is not a simple polygon ({reason}); draw it without crossings")
    # a millimetre of slack: a node may lie on the outline
    i = _first(shapely.distance(polygon, shapely.points(position)) > SMALLEST_M)
    if i is not None:
        x, y = position[i].tolist()
        raise TaskliftError(f"{where}: node {i} at ({x:g}, {y:g}) lies outside the outline; draw the outline around it")


# -- checks on JSON ---------------------------------------------------------------------------------


def _check_fields(where: str, value: Any, required: tuple[str, ...], optional: tuple[str, ...] = ()) -> None:
    for key in required:
        if key not in value:
            raise TaskliftError(f"{where}: field {key!r} is missing")
    for key in value:
        if key not in required and key not in optional:
            raise TaskliftError(f"{where}: unknown field {shown(key)}; expected {', '.join(required + optional)}")


def _list(where: str, document: Mapping[str, Any], key: str) -> list[Any]:
    value = document[key]
    if not isinstance(value, list):
        raise TaskliftError(f"{where}: field {key!r}: expected a list, found {type(value).__name__}")
    return value


def _number(where: str, name: str, value: Any) -> float:
    return number(value, f"{where}: field {name!r}", -1e12, 1e12)


def _integer(where: str, name: str, value: Any) -> int:
    return whole_number(value, f"{where}: field {name!r}", -(10**12), 10**12)


def _read_point(where: str, value: Any) -> tuple[float, float]:
    if not isinstance(value, list) or len(value) != 2:
        raise TaskliftError(f"{where}: expected [x, y], found {shown(value)}")
    return _number(where, "x", value[0]), _number(where, "y", value[1])


def _read_node(where: str, i: int, node: Any) -> tuple[int, int, float, float, float, int]:
    """``(kind, feature class, x, y, area, obstacles)`` of one node of a document."""
    at = f"{where}: node {i}"
    if not isinstance(node, dict):
        raise TaskliftError(f"{at}: expected an object, found {type(node).__name__}")
    if node.get("kind") not in KIND_NAMES:
        raise TaskliftError(f"{at}: field 'kind': expected {', '.join(KIND_NAMES)}, found {shown(node.get('kind'))}")
    kind = _KINDS[node["kind"]]
    required: tuple[str, ...] = ("id", "kind", "x", "y")
    if kind == ROOM:
        required += ("area_m2", "obstacles")
    elif kind == FEATURE:
        required += ("class",)
    _check_fields(f"{at} ({node['kind']})", node, required)
    if _integer(at, "id", node["id"]) != i:
        raise TaskliftError(f"{at}: id is {node['id']}; expected ids 0, 1, 2 … in order")
    feature, area, obstacles = NONE, 0.0, 0
    if kind == FEATURE:
        if node["class"] not in CLASS_NAMES.values():
            names = ", ".join(CLASS_NAMES.values())
            raise TaskliftError(f"{at}: field 'class': expected {names}, found {shown(node['class'])}")
        feature = _CLASSES[node["class"]]
    elif kind == ROOM:
        area = _number(at, "area_m2", node["area_m2"])
        obstacles = _integer(at, "obstacles", node["obstacles"])
    return kind, feature, _number(at, "x", node["x"]), _number(at, "y", node["y"]), area, obstacles


def _read_edge(where: str, i: int, edge: Any) -> tuple[int, int, float, float, list[tuple[float, float]]]:
    at = f"{where}: edges[{i}]"
    if not isinstance(edge, dict):
        raise TaskliftError(f"{at}: expected an object, found {type(edge).__name__}")
    _check_fields(at, edge, ("a", "b", "length_m", "width_m"), ("course",))
    a, b = _integer(at, "a", edge["a"]), _integer(at, "b", edge["b"])
    at = f"{where}: edge {a}-{b}"
    points = _list(at, edge, "course") if "course" in edge else []
    course = [_read_point(f"{at}: course point {j}", point) for j, point in enumerate(points)]
    return a, b, _number(at, "length_m", edge["length_m"]), _number(at, "width_m", edge["width_m"]), course
