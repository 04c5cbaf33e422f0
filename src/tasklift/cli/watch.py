"""``tasklift watch``: parse and call."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from tasklift.cli.terminal import say

if TYPE_CHECKING:
    from tasklift.building.simulator import Trace


def _names(ctx: click.Context, parameter: click.Parameter, text: str | None) -> list[str] | None:
    from tasklift.watch.sources import arm_names

    return None if text is None else arm_names(text)


def _numbers(ctx: click.Context, parameter: click.Parameter, text: str | None) -> list[int] | None:
    if text is None:
        return None
    parts = [part.strip() for part in text.split(",")]
    if not all(part.isdigit() and int(part) >= 1 for part in parts):
        raise click.BadParameter(f"expected trial numbers from 1 such as 1,10,50,100, found {text!r}")
    return [int(part) for part in parts]


def _team(ctx: click.Context, parameter: click.Parameter, text: str) -> tuple[int, int]:
    parts = text.split("+")
    if len(parts) != 2 or not all(part.strip().isdigit() for part in parts):
        raise click.BadParameter(f"expected SCOUTS+WEAPONS such as 10+5, found {text!r}")
    return int(parts[0]), int(parts[1])


_count = click.IntRange(min=0)


@click.command("watch")
@click.argument("source", type=click.Path(path_type=Path))
@click.option(
    "--policy",
    "policies",
    type=click.Path(path_type=Path),
    multiple=True,
    help="On a building: a policy file to use as it is; several stand side by side.",
)
@click.option("--draw", is_flag=True, help="Draw the policy's outputs by weight; default: always the heaviest.")
@click.option("--arms", callback=_names, help="Arms, side by side.  [default: direct,copy,copy+prior]")
@click.option(
    "--trial",
    "--trials",
    "trials",
    callback=_numbers,
    help="One number from 1, or several: 1,10,50,100.  [default: the last, or 100]",
)
@click.option("--seed", type=_count, default=0, show_default=True)
@click.option("--map", "map_name", help="Of an experiment: one of its maps.  [default: the first]")
@click.option("--preset", help="The world's rules: scattered or cohesive, or another of the experiment's.")
@click.option("--team", default="10+5", show_default=True, callback=_team, help="On a building: scouts+weapon robots.")
@click.option("--hostiles", type=_count, default=1, show_default=True, help="On a building.")
@click.option("--weapons-needed", type=click.IntRange(min=1), default=2, show_default=True, help="On a building.")
@click.option(
    "--limit", type=click.IntRange(min=1), default=600, show_default=True, help="On a building: steps per trial."
)
@click.option("--html", type=click.Path(path_type=Path), help="Write the replay as one HTML file instead.")
@click.option("--json", "json_file", type=click.Path(path_type=Path), help="Write the traces as one JSON file.")
@click.option("--force", is_flag=True, help="With --html and --json: replace files that are there.")
@click.option("--open/--no-open", "open_browser", default=True, help="Open the browser, or print the address only.")
def watch_command(
    source: Path, html: Path | None, json_file: Path | None, force: bool, open_browser: bool, **options: Any
) -> None:
    """Replay trials in the browser, side by side.

    SOURCE is the folder of an experiment (of `reproduce` or `train`), a building (.json or .graph), or a replay
    that --json wrote. A building is simulated: with policy files, or with the arms of the paper, which learn on it
    first.
    """
    from tasklift.files import canonical_json, output_file, write_atomically
    from tasklift.watch.html import page

    for target, suffixes in ((json_file, (".json",)), (html, (".html", ".htm"))):
        if target is not None:
            output_file(target, suffixes, force=force, reads=[source, *options["policies"]])
    document = _document(source, **options)
    if json_file is not None:
        write_atomically(json_file, canonical_json(document), replace=force)
        say(f"written: {json_file}")
    if html is not None:
        write_atomically(html, page(document), replace=force)
        say(f"written: {html}")
    if html is None and json_file is None:
        from tasklift.watch.server import serve

        serve(page(document), open_browser=open_browser, say=say)


def _document(source: Path, **options: Any) -> dict[str, Any]:
    from tasklift.errors import TaskliftError
    from tasklift.files import parse_json, read_text
    from tasklift.watch.document import FORMAT, checked, replay

    if not source.exists():
        raise TaskliftError(f"{source}: no such file or folder; expected an experiment, a building or a replay")
    if not source.is_dir() and source.suffix == ".json":
        found = parse_json(read_text(source), str(source))
        if isinstance(found, dict) and found.get("format") == FORMAT:
            return checked(found, str(source))
    if source.is_dir() or source.suffix not in (".json", ".graph"):
        traces = _of_run(source, **options)
    else:
        traces = _of_building(source, **options)
    for label, trace in traces:
        end = f"done in {trace.steps} steps" if trace.success else f"not done in {trace.steps} steps"
        say(f"{label}: {end}, {trace.losses[-1]} lost", err=True)
    return replay(traces, _title(traces, source))


def _title(traces: list[tuple[str, Trace]], source: Path) -> str:
    place = traces[0][1].mission.building.name or source.stem
    numbers = sorted({trace.trial + 1 for _, trace in traces})
    return f"{place}: {'trial' if len(numbers) == 1 else 'trials'} {', '.join(map(str, numbers))}"


def _of_run(
    source: Path,
    *,
    policies: tuple[Path, ...],
    draw: bool,
    arms: list[str] | None,
    trials: list[int] | None,
    seed: int,
    map_name: str | None,
    preset: str | None,
    **_: Any,
) -> list[tuple[str, Trace]]:
    from tasklift.watch.sources import run_traces

    if policies or draw:
        raise click.UsageError("--policy and --draw go with a building, not with an experiment")
    return run_traces(source, reading=preset, map=map_name, seed=seed, arms=arms, trials=trials)


def _of_building(
    source: Path,
    *,
    policies: tuple[Path, ...],
    draw: bool,
    arms: list[str] | None,
    trials: list[int] | None,
    seed: int,
    map_name: str | None,
    preset: str | None,
    team: tuple[int, int],
    hostiles: int,
    weapons_needed: int,
    limit: int,
) -> list[tuple[str, Trace]]:
    from tasklift.building.reading import PRESETS
    from tasklift.building.team import SCOUT, WEAPON
    from tasklift.plans.read import load_building
    from tasklift.studies.study import Study
    from tasklift.tasks.policy import Policy
    from tasklift.watch.sources import policy_traces, study_traces

    preset = preset or "scattered"
    if preset not in PRESETS:
        raise click.UsageError(f"--preset: expected one of {', '.join(PRESETS)}, found {preset!r}")
    if map_name is not None:
        raise click.UsageError("--map goes with an experiment, not with a building")
    if policies and arms:
        raise click.UsageError("--policy and --arms exclude each other")
    study = Study(
        {source.stem: load_building(source)},
        {preset: PRESETS[preset]},
        ("direct",),
        team={SCOUT: team[0], WEAPON: team[1]},
        hostiles=hostiles,
        weapons_needed=weapons_needed,
        limit=limit,
    )
    if not policies:
        arms = arms or ["direct", "copy", "copy+prior"]
        return study_traces(study, reading=preset, map=source.stem, seed=seed, arms=arms, trials=trials or [100])
    mission = study.mission(preset, source.stem)
    loaded = [(file.stem, Policy.load(file)) for file in policies]
    traces = []
    for trial in trials or [1]:
        for label, trace in policy_traces(mission, loaded, seed=seed, trial=trial, greedy=not draw):
            traces.append((label if len(trials or [1]) == 1 else f"{label}, trial {trial}", trace))
    return traces
