"""``tasklift runs``: list, show, compare and export experiments."""

from __future__ import annotations

import os
from pathlib import Path
from typing import TYPE_CHECKING

import click

from tasklift.cli.options import Group, as_json
from tasklift.cli.terminal import say, say_json
from tasklift.text import number, printable

if TYPE_CHECKING:
    from tasklift.lab.runs import Table

_path = click.Path(path_type=Path)
#: The width of a table that is written to a pipe or a file, in characters.
WIDEST = 200


def _names(ctx: click.Context, parameter: click.Parameter, text: str | None) -> list[str] | None:
    return None if text is None else [name.strip() for name in text.split(",") if name.strip()]


def _between(ctx: click.Context, parameter: click.Parameter, text: str | None) -> tuple[str, str, str] | None:
    if text is None:
        return None
    axis, _, values = text.partition("=")
    first, _, second = values.partition(",")
    if not axis.strip() or not first.strip() or not second.strip() or "," in second:
        raise click.BadParameter(f"expected AXIS=FIRST,SECOND such as arm=direct,copy, found {text!r}")
    return axis.strip(), first.strip(), second.strip()


_over = click.option("--over", callback=_names, help="Axes to average over, such as map,seed; else the experiment's.")


@click.group("runs", cls=Group)
def runs_group() -> None:
    """List, show, compare and export experiments."""


@runs_group.command("list")
@click.argument("folder", type=_path, default=Path())
@as_json
def runs_list(folder: Path, as_json: bool) -> None:
    """List the experiments in FOLDER and below."""
    from tasklift.lab.runs import find

    print_tables(find(folder), as_json=as_json)


@runs_group.command("show")
@click.argument("run", type=_path)
@_over
@as_json
def runs_show(run: Path, over: list[str] | None, as_json: bool) -> None:
    """Show an experiment's settings, axes and the mean of every summary."""
    from tasklift.lab.runs import show

    print_tables(*show(run, over=over), as_json=as_json)


@runs_group.command("compare")
@click.argument("first", type=_path)
@click.argument("second", type=_path, required=False)
@click.option("--between", callback=_between, help="Two values of an axis to compare, such as arm=direct,copy.")
@_over
@as_json
def runs_compare(
    first: Path, second: Path | None, between: tuple[str, str, str] | None, over: list[str] | None, as_json: bool
) -> None:
    """Compare two experiments, or two values of an axis of one, by paired differences of every summary."""
    from tasklift.lab.runs import compare

    print_tables(*compare(first, second, between=between, over=over), as_json=as_json)


@runs_group.command("export")
@click.argument("run", type=_path)
@click.option("-o", "--out", type=_path, required=True, help="A .csv or .parquet file.")
@click.option("--what", type=click.Choice(["trials", "cells"]), default="trials", show_default=True)
@click.option("--force", is_flag=True, help="Replace a file that is there.")
def runs_export(run: Path, out: Path, what: str, force: bool) -> None:
    """Write an experiment's rows to a file."""
    from tasklift.lab.runs import export

    say(f"{export(run, out, what=what, force=force)} rows: {out}")


def print_tables(*tables: Table, as_json: bool = False) -> None:
    """Print tables as wide as the terminal, or as JSON. A name that does not fit goes on in the next line.

    Into a file or a pipe, tables are as wide as they need to be, unless ``COLUMNS`` says otherwise.
    """
    if as_json:
        documents = [
            {"title": found.title, "rows": [dict(zip(found.headers, row, strict=True)) for row in found.rows]}
            for found in tables
        ]
        say_json(documents)
        return
    from rich.console import Console
    from rich.table import Table as Drawn
    from rich.text import Text

    console = Console()
    if not console.is_terminal and "COLUMNS" not in os.environ:
        console.width = WIDEST
    for content in tables:
        table = Drawn(title=Text(printable(content.title)), title_justify="left")
        for header in content.headers:
            table.add_column(Text(printable(header)), overflow="fold")
        for row in content.rows:
            table.add_row(*(Text(number(value) if isinstance(value, float) else printable(value)) for value in row))
        console.print(table)
