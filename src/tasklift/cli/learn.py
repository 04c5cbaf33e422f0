"""``tasklift learn``: parse and call."""

from __future__ import annotations

from pathlib import Path

import click

from tasklift.cli.options import as_json, folder, path, progress, quiet
from tasklift.cli.terminal import say, say_json


@click.command("learn")
@click.argument("spec", type=path)
@click.option("--seeds", type=click.IntRange(min=2), help="In place of the spec's number of seeds.")
@folder(help="Folder for the comparison and the learned policy; the same command resumes there.")
@click.option(
    "--allow-imports",
    is_flag=True,
    help="Let the spec name any installed module. Importing runs code. [default: only modules beside the spec]",
)
@quiet
@as_json
def learn_command(
    spec: Path, seeds: int | None, out: Path | None, allow_imports: bool, quiet: bool, as_json: bool
) -> None:
    """Run a curriculum from a spec file (TOML), and say whether it paid.

    A module that lies beside the spec, and that the spec names, is code: it runs.
    """
    from tasklift.studies.learn import run_spec

    with progress() as show:
        comparison = run_spec(spec, out, seeds, allow_imports=allow_imports, progress=show)
    if as_json:
        say_json(comparison.to_json())
        return
    say(comparison)
    if out is not None:
        say(f"comparison and policy: {out}")
