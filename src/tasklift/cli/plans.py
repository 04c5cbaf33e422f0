"""``tasklift map``: parse and call; no logic here."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import click

from tasklift.cli.options import Group
from tasklift.cli.terminal import say

_file = click.Path(path_type=Path)


class _Place(click.ParamType):
    """``X,Y`` in metres."""

    name = "X,Y"

    def convert(
        self, value: object, param: click.Parameter | None, ctx: click.Context | None
    ) -> tuple[float, float] | int:
        """Two numbers with a comma between; with one whole number, a node."""
        if not isinstance(value, str):
            return value  # type: ignore[return-value]
        parts = value.split(",")
        try:
            if len(parts) == 1:
                return int(parts[0])
            x, y = (float(part) for part in parts)
        except ValueError:
            self.fail(f"expected X,Y in metres such as 3.5,12, found {value!r}", param, ctx)
        if not max(abs(x), abs(y)) <= 1e6:
            self.fail(f"{value} is not a place within a building (m)", param, ctx)
        return x, y


@click.group("map", cls=Group)
def map_group() -> None:
    """Turn floor plans into buildings; look at them, check, correct, export."""


_force = click.option("--force", is_flag=True, help="Replace files that are there.")


@map_group.command("import")
@click.argument("file", type=_file)
@click.option("-o", "--out", type=_file, help="The building to write.  [default: FILE with .json, here]")
@click.option("--overlay", type=_file, help="The picture to write, .png or .svg.  [default: OUT with -graph.png]")
@click.option("--edits", type=_file, help="Corrections to apply, see 'map edit'.")
@click.option("--seed-point", type=_Place(), help="A point in the building, where the picture has several.")
@click.option("--smallest-room", type=float, help="Smallest area of a room, m².  [default: 4]")
@click.option("--door-rule", type=click.Choice(["relative", "absolute"]), help="What is a door.  [default: relative]")
@click.option("--narrowest", type=float, help="Narrowest passage that a robot fits through, m.  [default: 0.5]")
@click.option("--start", type=_Place(), help="Where robots begin: a point, or a node's number.")
@click.option("--level", help="The level, of a building that has several.")
@click.option("--levels", help="Several levels joined by lifts (open-rmf): 'all', or names with commas.")
@click.option(
    "--resolution", "--scale", type=float, help="Metres per pixel, where the file does not say (per unit of a drawing)."
)
@click.option("--allow-outside", is_flag=True, help="Follow a picture's path out of the YAML file's folder.")
@_force
def import_command(
    file: Path,
    out: Path | None,
    overlay: Path | None,
    edits: Path | None,
    seed_point: tuple[float, float] | int | None,
    smallest_room: float | None,
    door_rule: str | None,
    narrowest: float | None,
    start: tuple[float, float] | int | None,
    level: str | None,
    levels: str | None,
    resolution: float | None,
    allow_outside: bool,
    force: bool,
) -> None:
    """Turn a map into a building; 'map formats' lists what is read."""
    from tasklift.files import output_files
    from tasklift.plans.importing import import_map

    if level is not None and levels is not None:
        raise click.UsageError("--level imports one level, --levels joins several; give one of them")
    if isinstance(seed_point, int):
        raise click.BadParameter("expected X,Y in metres", param_hint="--seed-point")
    if out is None:
        stem = file.name.removesuffix(file.suffix).removesuffix(".building")
        out = Path(f"{stem}{'' if level is None else f'-{level}'}.json".replace("/", "-"))
    overlay = overlay or out.with_name(f"{out.stem}-graph.png")
    output_files((out, ()), (overlay, ()), force=force)
    building, doubts = import_map(
        file,
        out,
        overlay,
        edits=edits,
        seed_point=seed_point,
        smallest_room_m2=smallest_room,
        door_rule=door_rule,
        narrowest_m=narrowest,
        start=start,
        level=level,
        levels=None if levels is None else [] if levels == "all" else [name.strip() for name in levels.split(",")],
        resolution_m=resolution,
        allow_outside=allow_outside,
        progress=lambda text: say(f"  {text} …", err=True),
    )
    say(repr(building))
    for doubt in doubts:
        say(f"doubtful: {doubt}")
    say(f"wrote {out} and {overlay}: look at the picture, then correct with 'tasklift map edit'")


@map_group.command("formats")
def formats_command() -> None:
    """List the formats of maps that are read."""
    from tasklift.plans.read import readers

    for reader in readers():
        say(reader.TITLE)


@map_group.command("show")
@click.argument("building", type=_file)
@click.option("-o", "--out", type=_file, help="The picture, .png or .svg.  [default: BUILDING with -shown.png]")
@click.option("--plan", type=_file, help="The map to draw it on.  [default: the plan in BUILDING, or a sketch]")
@click.option("--level", help="The level of the plan.")
@click.option("--allow-outside", is_flag=True, help="Follow a picture's path out of the YAML file's folder.")
@_force
def show_command(
    building: Path, out: Path | None, plan: Path | None, level: str | None, allow_outside: bool, force: bool
) -> None:
    """Draw a building, with node ids."""
    from tasklift.files import output_file
    from tasklift.plans.importing import read_plan
    from tasklift.plans.overlay import ENDINGS, draw_overlay
    from tasklift.plans.read import load_building

    out = out or building.with_name(f"{building.stem}-shown.png")
    output_file(out, ENDINGS, force=force, reads=[building, *([plan] if plan else [])])
    drawn_on = None if plan is None else read_plan(plan, level=level, allow_outside=allow_outside, outputs=[out])
    draw_overlay(load_building(building), out, drawn_on)
    say(f"wrote {out}")


@map_group.command("check")
@click.argument("building", type=_file)
@click.option("--nodes", is_flag=True, help="List every node with its place.")
@click.option("--plan", type=_file, help="Compare lengths with this floor plan.  [default: the one imported]")
@click.option("--level", help="The level of the plan.")
def check_command(building: Path, nodes: bool, plan: Path | None, level: str | None) -> None:
    """Count what is in a building, compare its ways with the plan's, and say what looks wrong."""
    from tasklift.building.graph import ROOM
    from tasklift.plans.check import check, node_lines
    from tasklift.plans.floor import unpack
    from tasklift.plans.importing import read_plan
    from tasklift.plans.read import load_building
    from tasklift.plans.ways import compare_ways

    loaded = load_building(building)
    for line in check(loaded).lines():
        say(line)
    floor = unpack(loaded) if plan is None else read_plan(plan, level=level)
    if floor is not None and (loaded.kind == ROOM).sum() > 1:
        say(compare_ways(loaded, floor).line())
    for line in node_lines(loaded) if nodes else ():
        say(line)


@map_group.command("edit")
@click.argument("building", type=_file)
@click.argument("edits", type=_file, required=False)
@click.option("-o", "--out", type=_file, help="The corrected building to write; needed without --browser.")
@click.option("--overlay", type=_file, help="A picture of it to write, .png or .svg.")
@click.option("--places", type=_file, help="The edits to write with places for the numbers of nodes.")
@click.option("--browser", is_flag=True, help="Correct it on a page here; EDITS is written when you save.")
@click.option("--no-open", is_flag=True, help="With --browser: say the page's address, and leave the browser alone.")
@_force
def edit_command(
    building: Path,
    edits: Path | None,
    out: Path | None,
    overlay: Path | None,
    places: Path | None,
    browser: bool,
    no_open: bool,
    force: bool,
) -> None:
    """Apply a file of corrections: drop, merge, move nodes, add rooms, doors, edges, set classes.

    With --browser, click, drag and delete on the plan instead. EDITS [BUILDING with .edits] goes on from what is
    there; saving writes it, and OUT where you name one.
    """
    if browser:
        _edit_in_browser(building, edits or building.with_suffix(".edits"), out, not no_open, force)
        return
    if edits is None or out is None:
        raise click.UsageError("expected EDITS and -o OUT, or --browser")
    from tasklift.files import output_files, write_atomically
    from tasklift.plans.edits import HEADER, apply_edits, as_places, read_edits
    from tasklift.plans.overlay import ENDINGS, draw_overlay
    from tasklift.plans.read import load_building

    output_files((out, (".json",)), (overlay, ENDINGS), (places, ()), force=force, reads=[building, edits])
    loaded, corrections = load_building(building), read_edits(edits)
    corrected, remarks = apply_edits(loaded, corrections)
    if overlay is not None:  # first, since it takes long: what is stopped leaves all files or none
        draw_overlay(corrected, overlay)
    if places is not None:
        write_atomically(places, "\n".join([HEADER, *as_places(loaded, corrections)]) + "\n")
    corrected.save(out)
    say(repr(corrected))
    for remark in remarks:
        say(f"note: {remark}")


def _edit_in_browser(building: Path, edits: Path, out: Path | None, open_browser: bool, force: bool) -> None:
    from tasklift.files import output_file
    from tasklift.plans.edits import read_edits
    from tasklift.plans.read import load_building
    from tasklift.watch.editor import Editing, edit

    output_file(edits, force=True, reads=[building])
    if out is not None:
        output_file(out, (".json",), force=force, reads=[building, edits])
    lines = [edit.text for edit in read_edits(edits)] if edits.exists() else []
    session = Editing(load_building(building), edits, out, lines)
    edit(session, open_browser=open_browser, say=lambda text: click.echo(text))


@map_group.command("export")
@click.argument("building", type=_file)
@click.argument("out", type=_file)
@click.option("--radius", type=float, default=0.3, show_default=True, help="Routes: how far from walls they stay, m.")
@click.option("--plan", type=_file, help="Routes: the floor plan.  [default: the one in BUILDING]")
@click.option("--level", help="The level of the plan.")
@click.option("--allow-outside", is_flag=True, help="Follow a picture's path out of the YAML file's folder.")
@click.option("--resolution", type=float, default=0.05, show_default=True, help="ROS map: metres per pixel.")
@_force
def export_command(
    building: Path,
    out: Path,
    radius: float,
    plan: Path | None,
    level: str | None,
    allow_outside: bool,
    resolution: float,
    force: bool,
) -> None:
    """Write a building for other programs, by the ending of OUT.

    Routes for robots: .geojson (Nav2 route server), .lif.json (Layout Interchange Format), .nav.yaml (open-rmf
    navigation graph). Else .graph (patrolling_sim), or .yaml (ROS map, with a .pgm).
    """
    from tasklift.files import output_files
    from tasklift.plans.exporting import ENDINGS, export, outputs
    from tasklift.plans.importing import read_plan
    from tasklift.plans.read import load_building

    reads = [building, *([plan] if plan else [])]
    beside = ((target, ()) for target in outputs(out)[1:])
    written = output_files((out, ENDINGS), *beside, force=force, reads=reads)
    options: Any = {"level": level, "allow_outside": allow_outside, "outputs": written}
    drawn_on = None if plan is None else read_plan(plan, **options)
    for remark in export(load_building(building), out, resolution, plan=drawn_on, radius_m=radius):
        say(f"note: {remark}")
    say(f"wrote {' and '.join(map(str, written))}")


@map_group.command("generate")
@click.option("-o", "--out", type=_file, required=True, help="The building to write.")
@click.option("--intersections", type=int, default=21, show_default=True)
@click.option("--corridors", type=int, default=25, show_default=True)
@click.option("--rooms", type=int, default=6, show_default=True)
@click.option("--features", type=int, default=16, show_default=True)
@click.option("--doors", type=int, help="Features that are doors.  [default: a quarter, at least 4]")
@click.option("--seed", type=int, default=0, show_default=True)
@_force
def generate_command(
    out: Path, intersections: int, corridors: int, rooms: int, features: int, doors: int | None, seed: int, force: bool
) -> None:
    """Generate a building with exactly these counts."""
    from tasklift.building.generate import generate
    from tasklift.files import output_file

    output_file(out, (".json",), force=force)
    building = generate(intersections, corridors, rooms, features, doors, seed)
    building.save(out)
    say(repr(building))
