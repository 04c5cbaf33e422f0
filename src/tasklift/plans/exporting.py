"""A building written for other programs, by the ending of the file."""

from __future__ import annotations

import os
from collections.abc import Callable
from pathlib import Path

from tasklift.building.graph import Building
from tasklift.checks import number
from tasklift.files import output_file, write_atomically
from tasklift.plans import route_files
from tasklift.plans.floor import unpack
from tasklift.plans.plan import Plan
from tasklift.plans.raster import rasterise, write_ros
from tasklift.plans.read.patrolling import write_graph
from tasklift.plans.routes import RADIUS_M, Routes, routes_of

ROUTES: dict[str, Callable[[Building, Routes], str]] = {
    ".geojson": route_files.nav2,
    ".lif.json": route_files.lif,
    ".nav.yaml": route_files.rmf,
}
ENDINGS = (*ROUTES, ".graph", ".yaml", ".yml", ".json")


def _ending(path: str | os.PathLike[str]) -> str:
    name = Path(path).name.lower()
    return next((ending for ending in ENDINGS if name.endswith(ending)), "")


def outputs(path: str | os.PathLike[str]) -> list[Path]:
    """All files that :func:`export` writes for this name."""
    target = Path(path)
    return [target, target.with_suffix(".pgm")] if _ending(path) in (".yaml", ".yml") else [target]


def export(
    building: Building,
    path: str | os.PathLike[str],
    resolution_m: float = 0.05,
    *,
    plan: Plan | None = None,
    radius_m: float = RADIUS_M,
) -> list[str]:
    """Write ``building`` for other programs, by the ending of ``path``; returns remarks, a sentence each.

    Graphs of routes (:mod:`tasklift.plans.routes`): ``.geojson`` for Nav2's route server, ``.lif.json`` (Layout
    Interchange Format), ``.nav.yaml`` (open-rmf navigation graph). ``.graph``: patrolling_sim. ``.yaml``: a ROS map,
    with the picture beside it. ``.json``: a building. For ``.graphml``:
    ``networkx.write_graphml(building.to_networkx(), path)``.

    Parameters
    ----------
    resolution_m
        Metres per pixel of a ROS map and of a ``.graph``.
    plan
        The floor plan on which routes keep from walls. ``None``: the one in the building's file, or the drawing of a
        generated building.
    radius_m
        How far routes keep from walls, where the floor allows it.

    Raises
    ------
    TaskliftError
        If the ending is another, or the format cannot hold the building.
    """
    output_file(path, ENDINGS, force=True)
    ending = _ending(path)
    if ending in ROUTES:
        number(radius_m, "radius (m)", 0.01, 5)
        plan = plan or unpack(building)
        if plan is None and "footprints" in building.provenance:
            plan = rasterise(building)
        routes = routes_of(building, plan, radius_m)
        write_atomically(path, ROUTES[ending](building, routes))
        near = int((routes.clearance_m < radius_m - 0.01).sum())
        narrow = f", {near} of them nearer to walls than {radius_m:g} m, where the passage is narrower" if near else ""
        return [f"{len(routes.node)} nodes and {len(routes.edges)} lines{narrow}", *routes.remarks]
    if ending == ".graph":
        write_graph(building, path, resolution_m)
        return ["a .graph file holds places and corridors only: no kinds, widths or areas"]
    if ending == ".json":
        building.save(path)
        return []
    picture = write_ros(building, path, resolution_m)
    remarks = [f"the picture is {picture.name}"]
    if "footprints" not in building.provenance:
        remarks.append("this building was not generated: the plan is a sketch, with straight corridors")
    return remarks
