"""``tasklift policy``: show and export what was learned."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

import click

from tasklift.cli.options import Group, as_json, mission, path, positive
from tasklift.cli.runs import print_tables
from tasklift.cli.terminal import say, say_json

if TYPE_CHECKING:
    from tasklift.tasks.policy import Policy

#: Episodes that are played to find out which states (inputs) occur.
_EPISODES = 20


@click.group("policy", cls=Group)
def policy_group() -> None:
    """Show and export what was learned."""


@policy_group.command("show")
@click.argument("file", type=path)
@click.option("--top", type=positive, default=3, show_default=True, help="Actions (outputs) to show per state (input).")
@click.option("--all", "every", is_flag=True, help="Show states that did not occur, too.")
@click.option("--building", type=path, help="Where to play.  [default: building.json beside FILE, or a generated one]")
@mission
@as_json
def policy_show(
    file: Path, top: int, every: bool, building: Path | None, mission: Path | None, as_json: bool
) -> None:
    """Show the most likely actions (outputs) in each state (input), with their probabilities.

    Of a policy for the building search, only the states that occur in 20 episodes are shown.
    """
    from tasklift.lab.runs import Table
    from tasklift.tasks.policy import Policy

    policy = Policy.load(file)
    met = None if every else _met(policy, building, mission, file)
    states = [found for row, found in enumerate(policy.describe(top)) if met is None or row in met]
    if as_json:
        likely = [[{"probability": share, "action": does} for share, does in actions] for _, actions in states]
        say_json([{"state": seen, "actions": found} for (seen, _), found in zip(states, likely, strict=True)])
        return
    rows = [
        [*(seen.values() if first else [""] * len(seen)), f"{share:.0%}", *does.values()]
        for seen, actions in states
        for first, (share, does) in zip([True, *[False] * top], actions, strict=False)
    ]
    title = f"{policy.task.name}: {policy.task.shape[0]} states × {policy.task.shape[1]} actions"
    if met is not None:
        title += f"; {len(states)} states occur in {_EPISODES} episodes (--all shows all)"
    names = [[variable.name for variable in side] for side in (policy.task.inputs, policy.task.outputs)]
    print_tables(Table(title, [*names[0], "", *names[1]], rows))
    for variable in policy.task.variables:
        if variable.meaning:
            say(f"{variable.name}: {variable.meaning}")


def _met(policy: Policy, building: Path | None, declares: Path | None, file: Path) -> set[int] | None:
    """Return the states that occur when the policy plays; None if its task is not the mission's."""
    from tasklift.building import Mission, generate
    from tasklift.learning.chances import GREEDY_STAGE
    from tasklift.plans.read import load_building
    from tasklift.studies.mission_file import declared

    beside = building or (file.parent / "building.json" if (file.parent / "building.json").exists() else None)
    place = generate(seed=0) if beside is None else load_building(beside)
    mission = Mission(place, **declared(declares, file.parent)).with_reading(relocate=True)
    if policy.task != mission.task:
        return None
    simulator = mission.simulator
    met: set[int] = set()
    for trial in range(_EPISODES):
        robots = simulator.trace(policy, trial=trial, stage=GREEDY_STAGE, learn=False).robots
        met |= set(robots["pair_row"][robots["alive"].astype(bool)].tolist())
    return met - {-1}


@policy_group.command("export")
@click.argument("file", type=path)
@click.option("-o", "--out", type=path, required=True, help="A file, or a folder for a ROS 2 package.")
@click.option("--kind", type=click.Choice(["json", "csv", "onnx", "python", "c", "ros2"]),
              help="[default: by OUT's name]")
@click.option("--force", is_flag=True, help="Replace what is there.")
def policy_export(file: Path, out: Path, kind: str | None, force: bool) -> None:
    """Write a policy for use elsewhere: .json, .csv, .onnx, .py, .h, or a ROS 2 package in a folder.

    All of them make the same decisions as the policy, and none needs tasklift. A .py has act(inputs); a .h is C99;
    a .csv has one line per state and action, with weight and probability.
    """
    from tasklift.files import holds, output_file, output_folder, write_atomically
    from tasklift.tasks import exports
    from tasklift.tasks.policy import Policy

    kind = exports.kind_of(out, kind)
    policy = Policy.load(file)
    if kind == "ros2":
        files = exports.to_ros2(policy, out.resolve().name)
        output_folder(out, ("package.xml",))
        files = {name: text for name, text in files.items() if not holds(out / name, text)}  # a stopped one goes on
        for name in files:
            if (out / name).parent.is_dir():
                output_file(out / name, force=force, reads=[file])
        for name, text in files.items():
            (out / name).parent.mkdir(exist_ok=True)
            write_atomically(out / name, text, replace=force)
    else:
        output_file(out, (exports.SUFFIXES[kind],), force=force, reads=[file])
        if kind == "json":
            policy.save(out)
        else:
            write_atomically(out, exports.content(policy, kind, out.stem), replace=force)
    say(f"written: {out}")
