"""``tasklift team``: which team a building needs."""

from __future__ import annotations

from typing import Any

import click

from tasklift.cli.options import (
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
    weapons_needed,
)
from tasklift.cli.terminal import say, say_json


@click.command("team")
@click.argument("building", type=path)
@mission
@click.option("--scouts", type=Numbers(), default="10", show_default=True, help="Numbers of scouts: 5,10 or 5-8.")
@click.option("--weapons", type=Numbers(), default="2,3,5,8,12,18", show_default=True, help="Numbers of weapon robots.")
@click.option("--hostiles", type=count, default=1, show_default=True, help="Hidden at doors.")
@weapons_needed
@limit
@click.option("--preset", default="scattered", show_default=True, help="The world's rules: scattered or cohesive.")
@click.option("--practice", type=positive, default=12_000, show_default=True, help="Safe episodes per team.")
@click.option("--ready", type=float, default=0.95, show_default=True, help="Share solved from which a team is ready.")
@folder(help="Folder for table and report; the same command resumes there.  [default: runs/BUILDING-team]")
@running
@as_json
def team_command(as_json: bool, **options: Any) -> None:
    """Say which team a building needs: search a policy for every size, and judge it on fresh episodes."""
    from tasklift.studies.team import team

    with progress() as show:
        lines, report = team(progress=show, command=command_line(), **given(options))
    if as_json:
        say_json({"says": lines, "report": str(report)})
        return
    for line in [*lines, f"report: {report}"]:
        say(line)
