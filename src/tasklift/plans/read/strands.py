"""Topological maps of STRANDS and LCAS: the indented text of old ``.tmap`` files, and the YAML of later ones."""

from __future__ import annotations

from typing import Any

from tasklift.plans.places import Places
from tasklift.plans.source import Source, coordinate, number_in
from tasklift.text import shown

TITLE = "STRANDS topological map (.tmap, .tmap2, YAML)"


def recognises(source: Source) -> bool:
    """Whether it begins with a node in either form."""
    if source.head.removeprefix(b"\xef\xbb\xbf").lstrip().startswith(b"node:") and b"waypoint:" in source.head:
        return True
    return any(isinstance(_node(item), dict) and "pose" in _node(item) for item in _items(source)[:1])


def read(source: Source) -> Places:
    """Read nodes, their names and the edges between them.

    Raises
    ------
    TaskliftError
        With the node at fault.
    """
    is_text = b"waypoint:" in source.head and source.head.lstrip(b"\xef\xbb\xbf \r\n").startswith(b"node:")
    nodes = _from_text(source) if is_text else _from_yaml(source)
    places = Places(source, {"source": "STRANDS topological map", "file": source.path.name})
    number: dict[str, int] = {}
    for name, x, y, _ in nodes:
        if name in number:
            raise source.fault(f"node {shown(name)} is there twice")
        number[name] = places.add(x, y, name)
    missing = []
    for name, _, _, ends in nodes:
        for end in ends:
            if end in number:
                places.join(number[name], number[end])
            else:
                missing.append(f"{shown(name)} to {shown(end)}")
    if missing:
        places.doubts.append(f"{len(missing)} edges lead to nodes that are not there, such as {missing[0]}; left out")
    return places


_Node = tuple[str, float, float, list[str]]


def _from_text(source: Source) -> list[_Node]:
    nodes: list[_Node] = []
    name = part = ""
    x = y = 0.0
    ends: list[str] = []
    for i, raw in enumerate([*source.text.splitlines(), "node:"], start=1):
        line = raw.strip()
        if line == "node:":
            if name and part in ("", "name"):
                raise source.fault(f"line {i}: node {shown(name)} has no waypoint")
            if name:
                nodes.append((name, x, y, ends))
            name, part, ends = "", "name", []
        elif line in ("waypoint:", "edges:", "vertices:") or (line.endswith(":") and " " not in line):
            part = line
        elif line and part == "name":
            name = line
        elif line and part == "waypoint:":
            at = [coordinate(word) for word in line.split(",")[:2]]
            if len(at) != 2 or at[0] is None or at[1] is None:
                raise source.fault(f"line {i}: expected x,y,… of node {shown(name)}, found {shown(line)}")
            x, y = at[0], at[1]
        elif line and part == "edges:":
            ends.append(line.rsplit(",", 1)[0].strip())
    if not nodes:
        raise source.fault("has no nodes with a waypoint")
    return nodes


def _items(source: Source) -> list[Any]:
    document = source.document
    if isinstance(document, dict):
        document = document.get("nodes")
    return document if isinstance(document, list) else []


def _node(item: Any) -> Any:
    return item.get("node") if isinstance(item, dict) and "node" in item else item


def _from_yaml(source: Source) -> list[_Node]:
    nodes: list[_Node] = []
    for i, item in enumerate(_items(source)):
        node = _node(item)
        if not isinstance(node, dict) or not isinstance(node.get("name"), str):
            raise source.fault(f"node {i}: expected a node with a name")
        pose = node.get("pose")
        position = pose.get("position") if isinstance(pose, dict) else None
        at = [number_in(position.get(key)) for key in ("x", "y")] if isinstance(position, dict) else []
        if len(at) != 2 or any(v is None or not abs(v) <= 1e6 for v in at):
            raise source.fault(f"node {i}: expected pose: {{position: {{x: …, y: …}}}} up to 1e6 m")
        edges = node.get("edges") or []
        if not isinstance(edges, list):
            raise source.fault(f"node {i}: expected a list of edges")
        ends = [str(edge["node"]) for edge in edges if isinstance(edge, dict) and "node" in edge]
        nodes.append((node["name"], float(at[0] or 0), float(at[1] or 0), ends))
    return nodes
