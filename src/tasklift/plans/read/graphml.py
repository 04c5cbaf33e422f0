"""GraphML, as networkx and yEd write it: nodes with x and y (m), edges, perhaps names and lengths."""

from __future__ import annotations

from xml.etree.ElementTree import Element

from tasklift.plans.places import Places
from tasklift.plans.source import Source, coordinate
from tasklift.text import shown

TITLE = "GraphML (.graphml)"
_X, _Y = ("x", "pos_x", "x_m"), ("y", "pos_y", "y_m")
_NAMES, _LENGTHS = ("name", "label"), ("length_m", "length", "weight", "distance")


def recognises(source: Source) -> bool:
    """Whether its root is ``graphml``."""
    return source.xml is not None and _tag(source.xml) == "graphml"


def read(source: Source) -> Places:
    """Read nodes and edges by their data keys x, y, name and length.

    Raises
    ------
    TaskliftError
        With the node or the edge at fault.
    """
    root = source.xml
    assert root is not None
    keys = {e.get("id", ""): e.get("attr.name", "").lower() for e in root if _tag(e) == "key"}
    places = Places(source, {"source": "GraphML", "file": source.path.name})
    number: dict[str, int] = {}
    edges = []
    for element in root.iter():
        if _tag(element) == "node":
            data = _data(element, keys)
            key = element.get("id", "")
            x, y = (coordinate(_first(data, names)) for names in (_X, _Y))
            if x is None or y is None:
                raise source.fault(f"node {shown(key)}: expected its data x and y, up to 1e6 m")
            if key in number:
                raise source.fault(f"node {shown(key)} is there twice")
            number[key] = places.add(x, y, _first(data, _NAMES) or key)
            if data.get("kind") == "room":
                places.rooms.add(number[key])
            elif data.get("class") == "door":
                places.doors.add(number[key])
        elif _tag(element) == "edge":
            edges.append((element.get("source", ""), element.get("target", ""), _data(element, keys)))
    for a, b, data in edges:
        for end in (a, b):
            if end not in number:
                raise source.fault(f"edge {shown(a)} to {shown(b)}: node {shown(end)} does not exist")
        length = coordinate(_first(data, _LENGTHS))
        places.join(number[a], number[b], length if length is not None and length > 0 else 0.0)
    return places


def _tag(element: Element) -> str:
    return element.tag.rpartition("}")[2] if isinstance(element.tag, str) else ""


def _data(element: Element, keys: dict[str, str]) -> dict[str, str]:
    return {keys.get(e.get("key", ""), ""): (e.text or "").strip() for e in element if _tag(e) == "data"}


def _first(data: dict[str, str], names: tuple[str, ...]) -> str | None:
    return next((data[name] for name in names if data.get(name)), None)
