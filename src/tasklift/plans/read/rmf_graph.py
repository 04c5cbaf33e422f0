"""open-rmf navigation graphs, as ``building_map_generator nav`` exports them: vertices and lanes in metres."""

from __future__ import annotations

import numpy as np

from tasklift.plans.places import Places
from tasklift.plans.read.rmf import is_navigation_graph, lanes_as_places, level_of
from tasklift.plans.source import Source, coordinate, plain_name
from tasklift.text import shown

TITLE = "open-rmf navigation graph (.yaml), --level L1"
MOST_LANES = 100_000


def recognises(source: Source) -> bool:
    """Whether its levels have vertices ``[x, y, {name: …}]``."""
    return is_navigation_graph(source)


def read(source: Source) -> Places:
    """Read one level; a lane may be one-way in the file, and is a corridor either way.

    Raises
    ------
    TaskliftError
        With the vertex or the lane at fault.
    """
    level, content = level_of(source)
    where = f"level {shown(level)}"
    vertices, lanes = content.get("vertices"), content.get("lanes")
    if not isinstance(vertices, list) or not isinstance(lanes, list) or max(len(vertices), len(lanes)) > MOST_LANES:
        raise source.fault(f"{where}: expected lists of at most {MOST_LANES:,} vertices and lanes")
    points, names = [], []
    for i, vertex in enumerate(vertices):
        at = [coordinate(v) for v in vertex[:2]] if isinstance(vertex, list) else []
        if len(at) != 2 or None in at:
            raise source.fault(f"{where}: vertex {i}: expected [x, y, {{name: …}}] with x and y up to 1e6")
        points.append(at)
        names.append(plain_name(vertex[2].get("name", "")) if len(vertex) > 2 and isinstance(vertex[2], dict) else "")
    pairs = []
    for i, lane in enumerate(lanes):
        ends = lane[:2] if isinstance(lane, list) else []
        if len(ends) != 2 or not all(type(v) is int and 0 <= v < len(points) for v in ends):
            raise source.fault(f"{where}: lanes[{i}]: expected two vertices, each from 0 to {len(points) - 1}")
        if ends[0] != ends[1]:
            pairs.append(ends)
    if not pairs:
        raise source.fault(f"{where}: has no lanes")
    return lanes_as_places(source, level, names, np.array(points, float), np.array(pairs, np.int64))
