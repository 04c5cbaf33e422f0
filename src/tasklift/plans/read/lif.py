"""Layout Interchange Format (LIF) of VDMA for fleets of vehicles: JSON with layouts of nodes and edges, in metres.

Format: "LIF – Layout Interchange Format", version 1.0.0, VDMA and VDA 2024.
"""

from __future__ import annotations

from typing import Any

from tasklift.plans.places import Places
from tasklift.plans.source import Source, coordinate, plain_name
from tasklift.text import shown

TITLE = "Layout Interchange Format (LIF, .json), --level LAYOUT"


def recognises(source: Source) -> bool:
    """Whether it has layouts."""
    return isinstance(source.fields.get("layouts"), list)


def read(source: Source) -> Places:
    """Read one layout; stations name their nodes, and a node of a station is a room.

    Raises
    ------
    TaskliftError
        With the node or the edge at fault.
    """
    layout = _layout(source)
    places = Places(source, {"source": "Layout Interchange Format", "file": source.path.name})
    number: dict[str, int] = {}
    for i, node in enumerate(_list(source, layout, "nodes")):
        position = node.get("nodePosition") if isinstance(node, dict) else None
        at = [coordinate(position.get(key)) for key in ("x", "y")] if isinstance(position, dict) else []
        key = node.get("nodeId") if isinstance(node, dict) else None
        if not isinstance(key, str) or len(at) != 2 or at[0] is None or at[1] is None:
            raise source.fault(f"nodes[{i}]: expected nodeId and nodePosition with x and y up to 1e6 m")
        if key in number:
            raise source.fault(f"nodes[{i}]: the id {shown(key)} is there twice")
        number[key] = places.add(at[0], at[1], node.get("nodeName") or key)
    for i, edge in enumerate(_list(source, layout, "edges")):
        ends = [edge.get(key) for key in ("startNodeId", "endNodeId")] if isinstance(edge, dict) else [None, None]
        missing = [end for end in ends if not isinstance(end, str) or end not in number]
        if missing:
            raise source.fault(f"edges[{i}]: node {shown(missing[0])} does not exist")
        places.join(number[str(ends[0])], number[str(ends[1])])
    for station in _list(source, layout, "stations"):
        nodes = station.get("interactionNodeIds") if isinstance(station, dict) else None
        for key in nodes if isinstance(nodes, list) else ():
            if isinstance(key, str) and key in number:
                places.rooms.add(number[key])
                if name := plain_name(station.get("stationName") or ""):
                    places.names[number[key]] = name
    return places


def _layout(source: Source) -> dict[str, Any]:
    layouts = [layout for layout in source.fields["layouts"] if isinstance(layout, dict)]
    names = [plain_name(layout.get("layoutId") or "") or str(i) for i, layout in enumerate(layouts)]
    listed = ", ".join(names[:8])
    if source.level is not None and source.level not in names:
        raise source.fault(f"has no layout {shown(source.level)}; there is {listed:.120}")
    if not layouts or (len(layouts) > 1 and source.level is None):
        raise source.fault(f"has the layouts {listed:.120}; choose one with --level" if layouts else "has no layouts")
    return layouts[names.index(source.level) if source.level is not None else 0]


def _list(source: Source, layout: dict[str, Any], key: str) -> list[Any]:
    value = layout.get(key) or []
    if not isinstance(value, list):
        raise source.fault(f"field {key!r}: expected a list")
    return value
