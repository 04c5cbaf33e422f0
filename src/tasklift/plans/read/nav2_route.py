"""Graphs of Nav2's route server: GeoJSON with points for nodes and lines for edges, in metres of the map frame.

Format: https://docs.nav2.org/configuration/packages/configuring-route-server.html and its geojson_graph_file_loader:
nodes are Points with ``properties.id``, edges MultiLineStrings (or LineStrings) with ``id``, ``startid`` and ``endid``.
"""

from __future__ import annotations

import math
from itertools import pairwise
from typing import Any

from tasklift.plans.places import Places
from tasklift.plans.source import Source, coordinate, plain_name
from tasklift.text import shown

TITLE = "Nav2 route graph (.geojson)"


def recognises(source: Source) -> bool:
    """Whether it is a GeoJSON collection of features."""
    return source.fields.get("type") == "FeatureCollection"


def read(source: Source) -> Places:
    """Read nodes and edges; an edge's length is that of its line, one way or both.

    Raises
    ------
    TaskliftError
        With the feature at fault.
    """
    features = source.fields.get("features")
    if not isinstance(features, list):
        raise source.fault("field 'features': expected a list")
    places = Places(source, {"source": "Nav2 route graph", "file": source.path.name})
    number: dict[Any, int] = {}
    edges: list[tuple[int, Any, Any, float]] = []
    for i, feature in enumerate(features):
        geometry, properties = _parts(source, i, feature)
        kind = geometry.get("type")
        if kind == "Point":
            at = _point(source, i, geometry.get("coordinates"))
            key = _id(source, i, properties, "id")
            if key in number:
                raise source.fault(f"features[{i}]: the id {shown(key)} is there twice")
            number[key] = places.add(*at, _name(properties))
            if _class(properties) == "room":
                places.rooms.add(number[key])
            elif _class(properties) == "door":
                places.doors.add(number[key])
        elif kind in ("MultiLineString", "LineString"):
            length = _length(source, i, geometry)
            edges.append((i, _id(source, i, properties, "startid"), _id(source, i, properties, "endid"), length))
    if not number:
        raise source.fault("has no points with an id; it is GeoJSON, but not a graph of Nav2's route server")
    for i, a, b, length in edges:
        for end in (a, b):
            if end not in number:
                raise source.fault(f"features[{i}]: node {shown(end)} does not exist")
        places.join(number[a], number[b], length)
    return places


def _parts(source: Source, i: int, feature: Any) -> tuple[dict[str, Any], dict[str, Any]]:
    geometry = feature.get("geometry") if isinstance(feature, dict) else None
    properties = feature.get("properties") if isinstance(feature, dict) else None
    if not isinstance(geometry, dict):
        raise source.fault(f"features[{i}]: expected a feature with a geometry")
    return geometry, properties if isinstance(properties, dict) else {}


def _id(source: Source, i: int, properties: dict[str, Any], key: str) -> Any:
    value = properties.get(key)
    if not isinstance(value, int | str) or isinstance(value, bool):
        raise source.fault(f"features[{i}]: property {key!r}: expected a whole number, found {shown(value)}")
    return value


def _point(source: Source, i: int, value: Any) -> tuple[float, float]:
    at = [coordinate(v) for v in value[:2]] if isinstance(value, list) else []
    if len(at) != 2 or at[0] is None or at[1] is None:
        raise source.fault(f"features[{i}]: expected coordinates [x, y] up to 1e6 m, found {shown(value)}")
    return at[0], at[1]


def _length(source: Source, i: int, geometry: dict[str, Any]) -> float:
    lines = geometry.get("coordinates")
    lines = [lines] if geometry["type"] == "LineString" else lines
    if not isinstance(lines, list) or not all(isinstance(line, list) for line in lines):
        raise source.fault(f"features[{i}]: expected the coordinates of a line")
    points = [_point(source, i, point) for line in lines for point in line]
    return sum(math.dist(a, b) for a, b in pairwise(points))


def _name(properties: dict[str, Any]) -> str:
    metadata = properties.get("metadata")
    for record in (properties, metadata if isinstance(metadata, dict) else {}):
        if name := plain_name(record.get("name", "")):
            return name
    return ""


def _class(properties: dict[str, Any]) -> Any:
    metadata = properties.get("metadata")
    return metadata.get("class") if isinstance(metadata, dict) else None
