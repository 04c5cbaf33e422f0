"""A building written for other programs, by the ending of the file."""

from __future__ import annotations

import os
from pathlib import Path

from tasklift.building.graph import Building
from tasklift.files import output_file
from tasklift.plans.raster import write_ros
from tasklift.plans.read.patrolling import write_graph

ENDINGS = (".graph", ".yaml", ".yml", ".json")


def outputs(path: str | os.PathLike[str]) -> list[Path]:
    """All files that :func:`export` writes for this name."""
    target = Path(path)
    return [target, target.with_suffix(".pgm")] if target.suffix.lower() in (".yaml", ".yml") else [target]


def export(building: Building, path: str | os.PathLike[str], resolution_m: float = 0.05) -> list[str]:
    """Write ``building`` for other programs, by the ending of ``path``; returns remarks, a sentence each.

    ``.graph``: patrolling_sim. ``.yaml``: a ROS map, with the picture beside it. ``.json``: a building. For
    ``.graphml``: ``networkx.write_graphml(building.to_networkx(), path)``.

    Raises
    ------
    TaskliftError
        If the ending is another, or the format cannot hold the building.
    """
    suffix = output_file(path, ENDINGS, force=True).suffix.lower()
    if suffix == ".graph":
        write_graph(building, path, resolution_m)
        return ["a .graph file holds places and corridors only: no kinds, widths or areas"]
    if suffix == ".json":
        building.save(path)
        return []
    picture = write_ros(building, path, resolution_m)
    remarks = [f"the picture is {picture.name}"]
    if "footprints" not in building.provenance:
        remarks.append("this building was not generated: the plan is a sketch, with straight corridors")
    return remarks
