"""The commands that train: ``reproduce``, ``multiverse``, ``drills`` and ``train``."""

from __future__ import annotations

from typing import Any

import click

from tasklift.cli.options import (
    Names,
    Numbers,
    as_json,
    command_line,
    count,
    folder,
    given,
    limit,
    mission,
    path,
    positive,
    progress,
    running,
    team,
    weapons_needed,
)
from tasklift.cli.terminal import say, say_json


@click.command()
@click.option("--maps", type=positive, default=6, show_default=True, help="Generated buildings.")
@click.option("--seeds", type=positive, default=5, show_default=True, help="Seeds per building.")
@click.option("--trials", type=positive, default=100, show_default=True, help="Episodes (trials) on the full task.")
@click.option("--arms", type=Names(), help="Methods (arms) by name, such as direct,copy.  [default: 13 of them]")
@click.option(
    "--survey",
    type=click.IntRange(min=2),
    default=60,
    show_default=True,
    help="Generated buildings for Figure 3 and its claims.",
)
@click.option(
    "--practice",
    type=positive,
    default=36_000,
    show_default=True,
    help="Safe episodes of the search per building and preset that C11 is judged by.",
)
@folder("reproduction")
@running
def reproduce(**options: Any) -> None:
    """Reproduce the paper: arms, presets, maps, seeds; figures, claims, report.html."""
    from tasklift.studies.paper.reproduce import reproduce as run
    from tasklift.watch.html import write

    with progress() as show:
        lines, report = run(progress=show, play=write, command=command_line(), **given(options))
    say("\n".join([*lines, f"report: {report}"]))


@click.command()
@click.option("--readings", type=click.IntRange(min=2), default=500, show_default=True, help="Readings to draw.")
@click.option("--maps", type=positive, default=4, show_default=True, help="Generated buildings.")
@click.option("--seeds", type=positive, default=5, show_default=True, help="Seeds per building.")
@click.option("--trials", type=positive, default=100, show_default=True, help="Episodes (trials) on the full task.")
@click.option("--design", type=count, default=0, show_default=True, help="Seed that decides which readings are drawn.")
@folder("multiverse")
@running
def multiverse(**options: Any) -> None:
    """Test the paper's claims under many rule variants (readings): shares, what decides, report.html."""
    from tasklift.studies.multiverse.report import multiverse as run

    with progress() as show:
        lines, report = run(progress=show, command=command_line(), **given(options))
    say("\n".join([*lines, f"report: {report}"]))


@click.command()
@click.option("--maps", type=positive, default=12, show_default=True, help="Generated buildings.")
@click.option("--seeds", type=positive, default=50, show_default=True, help="Seeds per building, main result.")
@click.option("--hostiles", type=Numbers(), default="1-5", show_default=True, help="Numbers of hostiles: 1,3 or 1-5.")
@folder("drills")
@click.option("--page", type=path, help="A Markdown page with marks to put the results between.")
@click.option("--choose", is_flag=True, help="Instead, compare ways of drilling on other maps, and name the best.")
@running
def drills(choose: bool, **options: Any) -> None:
    """Compare practice with harmless hostiles (drills) with learning from scratch at equal total trials."""
    from tasklift.studies.drills import report as drill_report

    if choose:
        from tasklift.cli.runs import print_tables

        where: dict[str, Any] = {name: options[name] for name in ("out", "engine", "workers", "address")}
        with progress() as show:
            line, table = drill_report.choose(progress=show, **where)
        print_tables(table)
        say(line)
        return
    from tasklift.watch.html import write

    with progress() as show:
        lines, report = drill_report.drills(progress=show, play=write, command=command_line(), **given(options))
    say("\n".join([*lines, f"report: {report}"]))


@click.command()
@click.argument("building", type=path)
@mission
@team
@click.option("--hostiles", type=count, default=1, show_default=True, help="Hidden at doors.")
@weapons_needed
@limit
@click.option("--preset", default="scattered", show_default=True, help="The world's rules: scattered or cohesive.")
@click.option(
    "--arms",
    type=Names(),
    help="Methods (arms) by name, drills among them, such as direct-400-q90,every-door-300-q90.  "
    "[default: search,expert,direct,copy,copy-prior]",
)
@click.option(
    "--curriculum",
    type=path,
    multiple=True,
    help="A spec file (TOML) whose stages are a further arm, as `learn` takes it; may be given again.",
)
@click.option("--seeds", type=positive, default=3, show_default=True, help="Independent runs.")
@click.option("--trials", type=positive, default=100, show_default=True, help="Episodes (trials) on the full task.")
@click.option("--practice", type=positive, default=36_000, show_default=True, help="Safe episodes of the search.")
@click.option("--ready", type=float, default=0.95, show_default=True, help="Share solved from which a policy is ready.")
@folder(help="Folder for policies and report.  [default: runs/BUILDING]")
@running
@as_json
def train(as_json: bool, **options: Any) -> None:
    """Learn on your own building: the best policy, certified; or that none is ready, why, and what would do."""
    from tasklift.studies.train import train as run
    from tasklift.watch.html import write

    with progress() as show:
        lines, report = run(progress=show, play=write, command=command_line(), **given(options))
    if as_json:
        from tasklift.files import parse_json, read_text

        ready, certificate = report.with_name("policy.json"), report.with_name("certificate.json")
        certified = parse_json(read_text(certificate), str(certificate)) if certificate.exists() else None
        policy = str(ready) if certified else None
        say_json({"policy": policy, "certificate": certified, "says": lines, "report": str(report)})
        return
    for line in [*lines, f"report: {report}"]:
        say(line)
