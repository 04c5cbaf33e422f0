"""``tasklift learn``: parse and call."""

from __future__ import annotations

from pathlib import Path

import click


@click.command("learn")
@click.argument("spec", type=click.Path(path_type=Path))
@click.option("--seeds", type=click.IntRange(min=2), help="In place of the spec's number of seeds.")
@click.option("--out", type=click.Path(path_type=Path), help="Folder for the comparison and the learned policy.")
def learn_command(spec: Path, seeds: int | None, out: Path | None) -> None:
    """Run a curriculum from a spec file (TOML), and say whether it paid."""
    from rich.console import Console
    from rich.progress import Progress

    from tasklift.studies.spec_file import run_spec

    with Progress(console=Console(stderr=True), transient=True) as progress:
        bar = progress.add_task("seeds", total=None)
        comparison = run_spec(
            spec, out, seeds, progress=lambda done, of: progress.update(bar, completed=done, total=of)
        )
    click.echo(str(comparison))
    if out is not None:
        click.echo(f"comparison and policy: {out}")
