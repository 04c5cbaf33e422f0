"""``tasklift watch``: parse and call."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from tasklift.cli.options import Names, Numbers, count, limit, mission, team, weapons_needed
from tasklift.cli.terminal import say

if TYPE_CHECKING:
    from tasklift.building.simulator import Trace


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
@click.option("--arms", type=Names(), help="Methods (arms), side by side.  [default: direct,copy,copy-prior]")
@click.option(
    "--trial",
    "--trials",
    "trials",
    type=Numbers(),
    help="One number from 1, or several: 1,10,50,100.  [default: the last]",
)
@click.option("--stage", default="target", show_default=True, help="source, budget, drill, target, greedy or unseen.")
@click.option("--seed", type=count, default=0, show_default=True)
@click.option("--map", "map_name", help="Of an experiment: one of its maps.  [default: the first]")
@click.option("--preset", help="The world's rules: scattered or cohesive, or another of the experiment's.")
@mission
@team
@click.option("--hostiles", type=count, help="On a building: how many.  [default: 1]  Of drills: one of the numbers.")
@weapons_needed
@limit
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
    from tasklift.files import canonical_json, output_files, write_atomically
    from tasklift.watch.html import page

    reads = [source, *options["policies"]]
    output_files((json_file, (".json",)), (html, (".html", ".htm")), force=force, reads=reads)
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
    if source.is_dir() or source.suffix == ".sqlite":
        traces = _of_run(source, **options)
    else:
        traces = _of_building(source, **options)
    for label, trace in traces:
        end = f"done in {trace.steps} steps" if trace.success else f"not done in {trace.steps} steps"
        say(f"{label}: {end}, {trace.losses[-1]} lost", err=True)
    from tasklift.studies.arms import ARMS

    about = {arm.label: arm.meaning for arm in ARMS.values()}
    about["handed over"] = "the policy that train hands over"
    return replay(traces, _title(traces, source), about)


def _title(traces: list[tuple[str, Trace]], source: Path) -> str:
    place = traces[0][1].mission.building.name or source.stem
    numbers = sorted({trace.trial + 1 for _, trace in traces})
    return f"{place}: {'trial' if len(numbers) == 1 else 'trials'} {', '.join(map(str, numbers))}"


def _of_run(
    source: Path,
    *,
    policies: tuple[Path, ...],
    draw: bool,
    preset: str | None,
    hostiles: int | None,
    map_name: str | None,
    seed: int,
    arms: tuple[str, ...] | None,
    trials: tuple[int, ...] | None,
    stage: str,
    **_: Any,
) -> list[tuple[str, Trace]]:
    from tasklift.watch.sources import run_traces

    if policies or draw:
        raise click.UsageError("--policy and --draw go with a building, not with an experiment")
    condition = preset if hostiles is None else str(hostiles)
    return run_traces(source, condition=condition, map=map_name, seed=seed, arms=arms, trials=trials, stage=stage)


def _of_building(
    source: Path,
    *,
    policies: tuple[Path, ...],
    draw: bool,
    arms: tuple[str, ...] | None,
    trials: tuple[int, ...] | None,
    stage: str,
    seed: int,
    map_name: str | None,
    preset: str | None,
    hostiles: int | None,
    mission: Path | None,
    **options: Any,
) -> list[tuple[str, Trace]]:
    from tasklift.building.reading import PRESETS
    from tasklift.plans.read import load_building
    from tasklift.studies.mission_file import declared
    from tasklift.studies.study import Condition, Study
    from tasklift.tasks.policy import Policy
    from tasklift.watch.sources import USUAL, policy_traces, study_traces

    preset = preset or "scattered"
    if preset not in PRESETS:
        raise click.UsageError(f"--preset: expected one of {', '.join(PRESETS)}, found {preset!r}")
    if map_name is not None:
        raise click.UsageError("--map goes with an experiment, not with a building")
    if policies and arms:
        raise click.UsageError("--policy and --arms exclude each other")
    rules = Condition(PRESETS[preset], hostiles=1 if hostiles is None else hostiles)
    shown = arms or USUAL
    terms = declared(mission, source.parent, **options)
    study = Study.every({source.stem: load_building(source)}, {preset: rules}, shown, seeds=1, **terms)
    if not policies:
        return study_traces(
            study, condition=preset, map=source.stem, seed=seed, arms=shown, trials=trials, stage=stage
        )
    world = study.mission(preset, source.stem)
    loaded = [(file.stem, Policy.load(file)) for file in policies]
    traces = []
    for trial in trials or (1,):
        for label, trace in policy_traces(world, loaded, seed=seed, trial=trial, greedy=not draw):
            traces.append((label if len(trials or (1,)) == 1 else f"{label}, trial {trial}", trace))
    return traces
