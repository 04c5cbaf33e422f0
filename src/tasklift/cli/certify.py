"""``tasklift certify``: bounds on what a policy solves and loses."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import click

from tasklift.cli.options import Numbers, as_json, limit, mission, path, progress, quiet, team, weapons_needed
from tasklift.cli.terminal import say, say_json


@click.command("certify")
@click.argument("policy", type=path, required=False)
@click.option("--building", type=path, help="The building.  [default: building.json beside the policy]")
@click.option("--buildings", help="In place of one building: generated ones, such as 21-25-6.")
@mission
@team
@click.option("--hostiles", type=Numbers(), default="1", show_default=True, help="Their number, or numbers: 1-5.")
@weapons_needed
@limit
@click.option("--preset", default="scattered", show_default=True, help="The world's rules: scattered or cohesive.")
@click.option("--episodes", type=int, help="Fresh episodes.  [default: 10000, with --buildings 1000]")
@click.option("--confidence", type=float, default=0.99, show_default=True, help="Of all bounds together.")
@click.option("--seed", type=int, default=0, show_default=True, help="Of the fresh episodes.")
@click.option("-o", "--out", type=path, help="The certificate.  [default: POLICY-certificate.json]")
@click.option("--force", is_flag=True, help="Replace a certificate that is there.")
@click.option("--verify", type=path, help="Recompute this certificate instead, and say whether it holds.")
@click.option("--learning", type=path, help="Bound what learning cost in this experiment's folder instead.")
@quiet
@as_json
def certify_command(
    policy: Path | None, verify: Path | None, learning: Path | None, quiet: bool, as_json: bool, **options: Any
) -> None:
    """Bound what a policy solves and loses, on fresh episodes; write a certificate.

    The unit is an episode (trial) on one building, or with --buildings an episode on a fresh building each.
    """
    from tasklift.studies import certify

    if verify is not None:
        with progress() as show:
            says = certify.verify(verify, show)
        say_json({"holds": True, "says": says}) if as_json else say(f"holds: {says}")
        return
    if learning is not None:
        lines = certify.learning_costs(learning)
        say_json({"says": lines}) if as_json else say("\n".join(lines))
        return
    if policy is None:
        raise click.UsageError("expected a policy, --verify and a certificate, or --learning and a folder")
    with progress() as show:
        made = certify.certify(policy, progress=show, **options)
    if as_json:
        from tasklift.files import parse_json, read_text

        say_json(parse_json(read_text(made.path), str(made.path)))
        return
    say(made.says)
    say(f"certificate: {made.path}")
