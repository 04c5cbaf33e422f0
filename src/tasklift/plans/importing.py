"""From whatever map a user has to a building."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from typing import Any

from tasklift.building.graph import Building
from tasklift.checks import number, one_of
from tasklift.files import PathLike, output_files
from tasklift.plans.edits import apply_edits, read_edits
from tasklift.plans.extract.building import choose_start, extract
from tasklift.plans.extract.space import DOOR_RULES, Settings
from tasklift.plans.floor import pack
from tasklift.plans.levels import Level, join_levels
from tasklift.plans.overlay import ENDINGS as PICTURES
from tasklift.plans.overlay import draw_overlay
from tasklift.plans.places import Places
from tasklift.plans.plan import Plan
from tasklift.plans.read import find_reader, read_map, rmf
from tasklift.plans.source import Source
from tasklift.text import shown


def import_map(
    path: PathLike,
    out: PathLike | None = None,
    overlay: PathLike | None = None,
    *,
    edits: PathLike | None = None,
    seed_point: tuple[float, float] | None = None,
    smallest_room_m2: float | None = None,
    door_rule: str | None = None,
    narrowest_m: float | None = None,
    start: tuple[float, float] | int | None = None,
    level: str | None = None,
    levels: Sequence[str] | None = None,
    resolution_m: float | None = None,
    allow_outside: bool = False,
    progress: Callable[[str], None] | None = None,
) -> tuple[Building, list[str]]:
    """Turn a map into a building; returns it with what is doubtful about it, a sentence each.

    The kind of file is recognised from what is in it; :func:`tasklift.plans.read.readers` has them all.

    Parameters
    ----------
    path
        The map.
    out
        Where to write the building (JSON); not written if ``None``. A file that is there is replaced.
    overlay
        Where to write the picture of the graph on the plan (PNG or SVG, by its ending); not drawn if ``None``.
    edits
        Corrections to apply, see :mod:`tasklift.plans.edits`.
    seed_point
        A point (m) in the building, where the picture holds several. Floor plans only.
    smallest_room_m2
        Smallest area of a room [4].
    door_rule
        "relative" [default]: a door is narrower than the spaces on both sides; "absolute": narrower than a
        given width.
    narrowest_m
        Passages narrower than this are closed [0.5].
    start
        Where the robots begin: a node, or a point (m) of which the nearest room is taken.
    level
        The level of a building that has several.
    levels
        The levels of an open-rmf building to import as one, joined by its lifts; none: all.
    resolution_m
        Metres per pixel of a plain picture, per pixel of an open-rmf drawing without a measurement, per cell of a
        grid map, or per unit of a DXF drawing.
    allow_outside
        Follow the path of a picture that leaves the folder of its YAML file.
    progress
        Called with what is being done, a few words each.

    Raises
    ------
    TaskliftError
        If the map, the edits or an option cannot be used; nothing is written then.

    Examples
    --------
    >>> building, doubts = import_map("office.yaml", "office.json", "office-graph.png")  # doctest: +SKIP
    """
    say = progress or (lambda _: None)
    settings = _settings(smallest_room_m2, door_rule, narrowest_m)
    options: dict[str, Any] = {"resolution_m": resolution_m, "allow_outside": allow_outside}
    source = Source(path, level=level, **options)
    outputs = (out, (".json",)), (overlay, PICTURES)
    output_files(*outputs, force=True, reads=[path])
    say("reading the map")
    sources = [source] if levels is None else [Source(path, level=name, **options) for name in _levels(source, levels)]
    found = [read_map(one) for one in sources]
    files = [file for one in sources for file in one.files]
    output_files(*outputs, force=True, reads=[*files, *([edits] if edits is not None else [])])
    plan: Plan | None
    if levels is not None:
        if seed_point is not None:
            raise source.fault("a seed point lies in one level; leave it out, or import levels one by one")
        building, plan, doubts = _joined(sources, found, settings, start, say)
    else:
        building, plan, doubts = _building(source, found[0], settings, seed_point, start, say)
    origin = {"imported_from": source.path.name, "doubts": doubts} | ({} if plan is None else {"plan": pack(plan)})
    building = replace(building, provenance=building.provenance | origin)
    if edits is not None:
        say("applying the edits")
        building, notes = apply_edits(building, read_edits(edits))
        doubts = doubts + notes
    if overlay is not None:
        say("drawing the overlay")
        draw_overlay(building, overlay, plan)
    if out is not None:  # after the drawing, which takes long: what is stopped leaves both files or none
        building.save(out)
    return building, doubts


_Found = Plan | Places | Building


def _building(
    source: Source,
    found: _Found,
    settings: Settings,
    seed_point: tuple[float, float] | None,
    start: tuple[float, float] | int | None,
    say: Callable[[str], None],
) -> tuple[Building, Plan | None, list[str]]:
    """The building that a file holds, its plan if it has one, and doubts."""
    if isinstance(found, Plan):
        building, doubts = extract(found, settings, seed_point=seed_point, start=start, progress=say)
        return building, found, doubts
    if isinstance(found, Places):
        return found.building(start=start), None, found.doubts
    raise source.fault("is a building already; use 'map show' or 'map edit'")


def _levels(source: Source, levels: Sequence[str]) -> Sequence[str]:
    """The levels asked for, or all of the file."""
    if find_reader(source) is not rmf:
        raise source.fault("levels are joined by the lifts of an open-rmf building only; import one with --level")
    return levels or rmf.levels_of(source)


def _joined(
    sources: Sequence[Source],
    found: Sequence[_Found],
    settings: Settings,
    start: tuple[float, float] | int | None,
    say: Callable[[str], None],
) -> tuple[Building, Plan, list[str]]:
    """The levels of a building joined by lifts, their plan, and doubts that name their level."""
    parts, doubts = [], []
    for source, plan in zip(sources, found, strict=True):
        assert source.level is not None
        if not isinstance(plan, Plan):
            raise source.fault(f"level {shown(source.level)} has lanes and no walls; choose others: --levels L1,L2")
        say(f"level {source.level}")
        building, notes = extract(plan, settings, progress=say)
        parts.append(Level(source.level, plan, building))
        doubts += [f"level {source.level}: {note}" for note in notes]
    joined, plan, notes = join_levels(sources[0].path.name.split(".")[0], parts)
    if start is not None:
        joined = replace(joined, start=choose_start(joined.name, joined.kind, joined.position_m, start))
    return joined, plan, [*doubts, *notes]


def read_plan(
    path: PathLike, *, level: str | None = None, allow_outside: bool = False, outputs: Sequence[PathLike] = ()
) -> Plan:
    """Read a floor plan to draw on.

    Raises
    ------
    TaskliftError
        If it cannot be read, is a graph without a floor plan, or consists of files among the ``outputs``.
    """
    source = Source(path, level=level, allow_outside=allow_outside)
    found = read_map(source)
    if not isinstance(found, Plan):
        raise source.fault("has no floor plan; give the map (YAML) beside it")
    output_files(*((target, ()) for target in outputs), force=True, reads=source.files)
    return found


def _settings(smallest_room_m2: float | None, door_rule: str | None, narrowest_m: float | None) -> Settings:
    settings = Settings()
    if smallest_room_m2 is not None:
        settings = replace(settings, smallest_room_m2=number(smallest_room_m2, "smallest room (m²)", 0.5, 10_000))
    if door_rule is not None:
        settings = replace(settings, door_rule=one_of(door_rule, DOOR_RULES, "door rule"))
    if narrowest_m is not None:
        settings = replace(settings, narrowest_m=number(narrowest_m, "narrowest passage (m)", 0.1, 5))
    return settings
