"""Graphs of routes as other programs read them; every line is written once for each way.

Formats: Nav2's route server (nav2_route, ``geojson_graph_file_loader``), the Layout Interchange Format of VDMA, version
1.0.0, and the navigation graphs of open-rmf (rmf_traffic, ``parse_graph``).
"""

from __future__ import annotations

import json
from datetime import UTC, datetime
from itertools import count
from typing import Any

from tasklift.building.graph import CLASS_NAMES, FEATURE, KIND_NAMES, ROOM, Building
from tasklift.plans.routes import Routes
from tasklift.plans.source import plain_name

FRAME = "map"
VEHICLE = "robot"


def nav2(building: Building, routes: Routes) -> str:
    """Return the GeoJSON of Nav2's route server.

    ``metadata`` of nodes: ``class`` (room, door, …, way), ``node`` (its number in the building), ``name``, ``area_m2``;
    of lines: ``clearance_m``, how far from walls they stay. Numbers of lines follow those of nodes.
    """
    features: list[dict[str, Any]] = []
    for i, (x, y) in enumerate(routes.position_m.tolist()):
        properties = {"id": i, "frame": FRAME, "metadata": _metadata(building, int(routes.node[i]))}
        features.append(_feature(properties, "Point", [x, y]))
    number = count(len(routes.node))
    for line, (a, b) in enumerate(routes.edges.tolist()):
        clearance = routes.clearance_m[line]
        known = {"metadata": {"clearance_m": round(float(clearance), 2)}} if clearance == clearance else {}
        for start, end in ((a, b), (b, a)):
            properties = {"id": next(number), "startid": start, "endid": end} | known
            points = [routes.position_m[start].tolist(), routes.position_m[end].tolist()]
            features.append(_feature(properties, "MultiLineString", [points]))
    lines = ",\n".join(json.dumps(feature, ensure_ascii=False) for feature in features)
    name = json.dumps(building.name, ensure_ascii=False)
    crs = '{"type": "name", "properties": {"name": "urn:ogc:def:crs:EPSG::3857"}}'  # metres, as Nav2's own graphs say
    return f'{{"type": "FeatureCollection", "name": {name}, "crs": {crs}, "features": [\n{lines}\n]}}\n'


def lif(building: Building, routes: Routes) -> str:
    """Return a layout of the Layout Interchange Format; rooms are its stations."""
    nodes, stations = [], []
    for i, (x, y) in enumerate(routes.position_m.tolist()):
        node = int(routes.node[i])
        nodes.append(
            {
                "nodeId": f"n{i}",
                "nodeName": _name(building, node),
                "mapId": FRAME,
                "nodePosition": {"x": x, "y": y},
                "vehicleTypeNodeProperties": [{"vehicleTypeId": VEHICLE}],
            }
        )
        if node >= 0 and building.kind[node] == ROOM:
            name = _name(building, node)
            stations.append({"stationId": f"s{node}", "stationName": name, "interactionNodeIds": [f"n{i}"]})
    edges: list[dict[str, Any]] = []
    for a, b in routes.edges.tolist():
        for start, end in ((a, b), (b, a)):
            edges.append(
                {
                    "edgeId": f"e{len(edges)}",
                    "startNodeId": f"n{start}",
                    "endNodeId": f"n{end}",
                    "vehicleTypeEdgeProperties": [{"vehicleTypeId": VEHICLE, "rotationAllowed": True}],
                }
            )
    layout = {
        "layoutId": building.name or "building",
        "layoutVersion": "1",
        "nodes": nodes,
        "edges": edges,
        "stations": stations,
    }
    meta = {
        "projectIdentification": building.name or "building",
        "creator": "tasklift",
        "exportTimestamp": datetime.now(UTC).isoformat(timespec="seconds").replace("+00:00", "Z"),
        "lifVersion": "1.0.0",
    }
    return json.dumps({"metaInformation": meta, "layouts": [layout]}, ensure_ascii=False, indent=1) + "\n"


def rmf(building: Building, routes: Routes) -> str:
    """Return an open-rmf navigation graph; rooms are named vertices."""
    lines = [f"building_name: {json.dumps(building.name)}", "levels:", "  L1:", "    lanes:"]
    for a, b in routes.edges.tolist():
        lines += [f"    - [{a}, {b}, {{speed_limit: 0}}]", f"    - [{b}, {a}, {{speed_limit: 0}}]"]
    lines.append("    vertices:")
    for i, (x, y) in enumerate(routes.position_m.tolist()):
        node = int(routes.node[i])
        is_room = node >= 0 and building.kind[node] == ROOM
        name = _name(building, node) if is_room or str(node) in _names(building) else ""
        options = f"name: {json.dumps(name, ensure_ascii=False)}, class: {_class(building, node)}"
        lines.append(f"    - [{x}, {y}, {{{options}}}]")
    return "\n".join([*lines, "doors: {}", "lifts: {}"]) + "\n"


def _feature(properties: dict[str, Any], kind: str, coordinates: list[Any]) -> dict[str, Any]:
    return {"type": "Feature", "properties": properties, "geometry": {"type": kind, "coordinates": coordinates}}


def _class(building: Building, node: int) -> str:
    if node < 0:
        return "way"
    kind = int(building.kind[node])
    return CLASS_NAMES[int(building.feature_class[node])] if kind == FEATURE else KIND_NAMES[kind]


def _names(building: Building) -> dict[str, Any]:
    names = building.provenance.get("names")
    return names if isinstance(names, dict) else {}


def _name(building: Building, node: int) -> str:
    """What the building's map calls the node, or its class and number."""
    if node < 0:
        return ""
    return plain_name(_names(building).get(str(node))) or f"{_class(building, node)}_{node}"


def _metadata(building: Building, node: int) -> dict[str, Any]:
    if node < 0:
        return {"class": "way"}
    found: dict[str, Any] = {"class": _class(building, node), "node": node, "name": _name(building, node)}
    if building.kind[node] == ROOM:
        found["area_m2"] = float(building.area_m2[node])
    return found
