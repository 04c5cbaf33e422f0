"""``tasklift learn``: parse and call."""

from __future__ import annotations

from pathlib import Path

import click


@click.command("learn")
@click.argument("spec", type=click.Path(path_type=Path))
@click.option("--seeds", type=click.IntRange(min=2), help="In place of the spec's number of seeds.")
@click.option("--out", type=click.Path(path_type=Path), help="Folder for the comparison and the learned policy.")
@click.option(
    "--allow-imports",
    is_flag=True,
    help="Let the spec name any installed module. Importing runs code. [default: only modules beside the spec]",
)
def learn_command(spec: Path, seeds: int | None, out: Path | None, allow_imports: bool) -> None:
    """Run a curriculum from a spec file (TOML), and say whether it paid.

    A module that lies beside the spec, and that the spec names, is code: it runs.
    """
    from rich.console import Console
    from rich.progress import Progress

    from tasklift.studies.spec_file import run_spec

    with Progress(console=Console(stderr=True), transient=True) as progress:
        bar = progress.add_task("seeds", total=None)
        comparison = run_spec(
            spec,
            out,
            seeds,
            progress=lambda done, of: progress.update(bar, completed=done, total=of),
            allow_imports=allow_imports,
        )
    click.echo(str(comparison))
    if out is not None:
        click.echo(f"comparison and policy: {out}")
