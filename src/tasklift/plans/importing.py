"""From whatever map a user has to a building: the kind of file is recognised from what is in it."""

from __future__ import annotations

import json
import os
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

from tasklift.building.graph import FORMAT, Building
from tasklift.errors import TaskliftError
from tasklift.plans.edits import apply_edits, read_edits
from tasklift.plans.extract.space import DOOR_RULES, Settings
from tasklift.plans.read.ros import Plan, read_ros
from tasklift.plans.read.yamls import read_yaml


def import_map(
    path: str | os.PathLike[str],
    out: str | os.PathLike[str] | None = None,
    overlay: str | os.PathLike[str] | None = None,
    *,
    edits: str | os.PathLike[str] | None = None,
    seed_point: tuple[float, float] | None = None,
    smallest_room_m2: float | None = None,
    door_rule: str | None = None,
    narrowest_m: float | None = None,
    start: tuple[float, float] | int | None = None,
    level: str | None = None,
    allow_outside: bool = False,
    progress: Callable[[str], None] | None = None,
) -> tuple[Building, list[str]]:
    """Turn a map into a building; returns it with what is doubtful about it, a sentence each.

    Reads ROS map_server and nav2 maps (YAML and PGM or PNG), open-rmf ``.building.yaml``, and patrolling_sim
    ``.graph`` files.

    Parameters
    ----------
    path
        The map.
    out
        Where to write the building (JSON); not written if ``None``.
    overlay
        Where to write the picture of the graph on the plan (PNG or SVG, by its ending); not drawn if ``None``.
    edits
        Corrections to apply, see :mod:`tasklift.plans.edits`.
    seed_point
        A point (m) in the building, where the picture holds several. Pictures and open-rmf only.
    smallest_room_m2
        Rooms below this area are none [4].
    door_rule
        "relative" [default]: a door is narrower than the spaces on both sides; "absolute": narrower than a
        given width.
    narrowest_m
        Passages narrower than this are closed [0.5].
    start
        Where the robots begin: a node, or a point (m) of which the nearest room is taken.
    level
        The level of an open-rmf building.
    allow_outside
        Follow the path of a picture that leaves the folder of its YAML file.
    progress
        Called with what is being done, a few words each.
    """
    say = progress or (lambda _: None)
    say("reading the map")
    kind, document = recognise(path)
    plan: Plan | None = None
    doubts: list[str] = []
    if kind == "graph":
        from tasklift.plans.read.patrolling import read_graph

        building = read_graph(path)
        if start is not None:
            building = replace(building, start=_start(building, start))
    else:
        from tasklift.plans.extract.rooms_and_corridors import extract

        plan = _plan(kind, path, level, allow_outside, document)
        settings = _settings(smallest_room_m2, door_rule, narrowest_m)
        building, doubts = extract(plan, settings, seed_point=seed_point, start=start, progress=progress)
    building = replace(building, provenance=building.provenance | {"imported_from": Path(path).name, "doubts": doubts})
    if edits is not None:
        say("applying the edits")
        building, notes = apply_edits(building, read_edits(edits))
        doubts = doubts + notes
    if out is not None:
        building.save(out)
    if overlay is not None:
        from tasklift.plans.overlay import draw_overlay

        say("drawing the overlay")
        draw_overlay(building, overlay, plan)
    return building, doubts


def read_plan(path: str | os.PathLike[str], *, level: str | None = None, allow_outside: bool = False) -> Plan:
    """Read a floor plan to draw on: a ROS map or a level of an open-rmf building."""
    kind, document = recognise(path)
    if kind == "graph":
        raise TaskliftError(f"{path}: a .graph file has no floor plan; give the ROS map (YAML) beside it")
    return _plan(kind, path, level, allow_outside, document)


def _plan(
    kind: str,
    path: str | os.PathLike[str],
    level: str | None,
    allow_outside: bool,
    document: dict[str, Any] | None,
) -> Plan:
    if kind == "rmf":
        from tasklift.plans.read.rmf import read_rmf

        return read_rmf(path, level=level, document=document)
    return read_ros(path, allow_outside=allow_outside, document=document)


def recognise(path: str | os.PathLike[str]) -> tuple[str, dict[str, Any] | None]:
    """Tell "ros", "rmf" or "graph" from the content of a file; the YAML, once read, comes along.

    Raises
    ------
    TaskliftError
        If it is none of them, with what it seems to be.
    """
    try:
        with open(path, "rb") as file:
            head = file.read(4096)
    except (OSError, ValueError) as error:
        raise TaskliftError(f"{path}: cannot be read ({getattr(error, 'strerror', None) or error})") from error
    if not head.strip():
        raise TaskliftError(f"{path}: is empty; expected a map")
    if head[:2] in (b"P2", b"P5") or head[:8] == b"\x89PNG\r\n\x1a\n":
        raise TaskliftError(
            f"{path}: is a picture; give the YAML file beside it, which says how large a pixel is "
            "(image, resolution, origin, negate, occupied_thresh, free_thresh)"
        )
    if head.lstrip()[:1] == b"{" and FORMAT.encode() in head:
        raise TaskliftError(f"{path}: is a building already; use 'map show' or 'map edit'")
    words = head.split(None, 7)
    if len(words) >= 6 and all(_is_number(word) for word in words[:6]):
        return "graph", None
    document = read_yaml(path)
    if "levels" in document:
        return "rmf", document
    if "image" in document or "resolution" in document:
        return "ros", document
    fields = ", ".join(str(key) for key in list(document)[:5])
    raise TaskliftError(
        f"{path}: is YAML but no map: found the fields {fields:.100}; expected 'image' and 'resolution' (ROS) "
        "or 'levels' (open-rmf)"
    )


def _is_number(word: bytes) -> bool:
    try:
        float(word)
    except ValueError:
        return False
    return True


def _settings(smallest_room_m2: float | None, door_rule: str | None, narrowest_m: float | None) -> Settings:
    settings = Settings()
    if smallest_room_m2 is not None:
        if not 0.5 <= smallest_room_m2 <= 10_000:
            raise TaskliftError(f"smallest room: expected 0.5 to 10000 m², found {smallest_room_m2:g}")
        settings = replace(settings, smallest_room_m2=float(smallest_room_m2))
    if door_rule is not None:
        if door_rule not in DOOR_RULES:
            raise TaskliftError(f"door rule: expected {' or '.join(DOOR_RULES)}, found {door_rule!r}")
        settings = replace(settings, door_rule=door_rule)
    if narrowest_m is not None:
        if not 0.1 <= narrowest_m <= 5:
            raise TaskliftError(f"narrowest passage: expected 0.1 to 5 m, found {narrowest_m:g}")
        settings = replace(settings, opening_m=narrowest_m / 2)
    return settings


def _start(building: Building, start: tuple[float, float] | int) -> int:
    from tasklift.plans.extract.rooms_and_corridors import choose_start

    return choose_start(building.name, building.kind, building.position_m, start)


def export(building: Building, path: str | os.PathLike[str], resolution_m: float = 0.05) -> list[str]:
    """Write ``building`` for other programs, by the ending of ``path``; returns remarks, a sentence each.

    ``.graph``: patrolling_sim. ``.yaml``: a ROS map, with the picture beside it. ``.json``: a building;
    ``.graphml`` is networkx's to write: ``networkx.write_graphml(building.to_networkx(), path)``.
    """
    suffix = Path(path).suffix.lower()
    if suffix == ".graph":
        from tasklift.plans.read.patrolling import write_graph

        write_graph(building, path, resolution_m)
        return ["a .graph file holds places and corridors only: no kinds, widths or areas"]
    if suffix in (".yaml", ".yml"):
        from tasklift.plans.raster import write_ros

        picture = write_ros(building, path, resolution_m)
        remarks = [f"the picture is {picture.name}"]
        if "footprints" not in building.provenance:
            remarks.append("this building was not generated: the plan is a sketch, with straight corridors")
        return remarks
    if suffix == ".json":
        building.save(path)
        return []
    raise TaskliftError(f"{path}: expected a name that ends in .graph, .yaml or .json, found {json.dumps(suffix)}")
