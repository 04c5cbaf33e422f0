"""The command line: parse and call, nothing else. Everything heavy is imported when its command runs."""

from __future__ import annotations

import io
import sys
from collections.abc import Callable
from importlib import import_module
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from tasklift import __version__
from tasklift.cli.terminal import say
from tasklift.errors import TaskliftError
from tasklift.text import one_line

if TYPE_CHECKING:
    from tasklift.lab import Progress

#: Command groups that live with their wing: name -> (module, attribute, one line of help).
_ELSEWHERE = {
    "map": (
        "tasklift.cli.plans",
        "map_group",
        "Turn floor plans into buildings; look at them, check, correct, export.",
    ),
    "learn": ("tasklift.cli.learn", "learn_command", "Run a curriculum from a spec file; say whether it paid."),
    "runs": ("tasklift.cli.runs", "runs_group", "List, show, compare and export experiments."),
    "watch": ("tasklift.cli.watch", "watch_command", "Replay trials in the browser."),
}


class _Commands(click.Group):
    """A group that imports a command of another wing only when it is asked for."""

    def list_commands(self, ctx: click.Context) -> list[str]:
        return sorted([*super().list_commands(ctx), *_ELSEWHERE])

    def get_command(self, ctx: click.Context, name: str) -> click.Command | None:
        if name not in _ELSEWHERE:
            return super().get_command(ctx, name)
        module, attribute, _ = _ELSEWHERE[name]
        command: click.Command = getattr(import_module(module), attribute)
        return command

    def format_commands(self, ctx: click.Context, formatter: click.HelpFormatter) -> None:
        rows = []
        for name in self.list_commands(ctx):
            if name in _ELSEWHERE:
                rows.append((name, _ELSEWHERE[name][2]))
            else:
                rows.append((name, self.commands[name].get_short_help_str(90)))
        with formatter.section("Commands"):
            formatter.write_dl(rows)


@click.group(cls=_Commands, context_settings={"help_option_names": ["-h", "--help"]})
@click.version_option(__version__, prog_name="tasklift")
def cli() -> None:
    """Learn the safe, simple version of a task first; extend it; know whether it paid."""


def _team(ctx: click.Context, parameter: click.Parameter, text: str) -> tuple[int, int]:
    parts = text.split("+")
    if len(parts) != 2 or not all(part.strip().isdigit() for part in parts):
        raise click.BadParameter(f"expected SCOUTS+WEAPONS such as 10+5, found {text!r}")
    return int(parts[0]), int(parts[1])


def _arms(ctx: click.Context, parameter: click.Parameter, text: str | None) -> tuple[str, ...]:
    from tasklift.studies.arms import ARMS

    return tuple(ARMS) if text is None else tuple(part.strip() for part in text.split(";"))


_positive = click.IntRange(min=1)


def _experiment_options(command: Callable[..., Any]) -> Callable[..., Any]:
    """Options of every command that trains."""
    for option in (
        click.option("--workers", type=_positive, help="Threads, or the size of a local Ray; default: one per core."),
        click.option("--address", help="For Ray: a running cluster, such as auto or HOST:PORT."),
        click.option("--engine", type=click.Choice(["threads", "ray"]), default="threads", show_default=True),
    ):
        command = option(command)
    return command


@cli.command()
@click.option("--maps", type=_positive, default=6, show_default=True, help="Generated buildings.")
@click.option("--seeds", type=_positive, default=5, show_default=True, help="Seeds per building.")
@click.option("--trials", type=_positive, default=100, show_default=True, help="Trials on the full task.")
@click.option("--arms", callback=_arms, help="Arms to run, separated by semicolons; default: all of them.")
@click.option(
    "--survey",
    type=click.IntRange(min=2),
    default=60,
    show_default=True,
    help="Generated buildings for Figure 3 and its claims.",
)
@click.option(
    "--out",
    type=click.Path(path_type=Path),
    default=Path("reproduction"),
    show_default=True,
    help="Folder for the report; the same command resumes there.",
)
@_experiment_options
def reproduce(**options: Any) -> None:
    """Reproduce the paper: arms, presets, maps, seeds; figures, claims, report.html."""
    from tasklift.studies.paper.reproduce import reproduce as run

    with _progress() as progress:
        report = run(progress=progress, **options)
    click.echo(f"report: {report}")


@cli.command()
@click.option("--readings", type=click.IntRange(min=2), default=500, show_default=True, help="Readings to draw.")
@click.option("--maps", type=_positive, default=4, show_default=True, help="Generated buildings.")
@click.option("--seeds", type=_positive, default=5, show_default=True, help="Seeds per building.")
@click.option("--trials", type=_positive, default=100, show_default=True, help="Trials on the full task.")
@click.option(
    "--design",
    type=click.IntRange(min=0),
    default=0,
    show_default=True,
    help="Seed of the design: which readings are drawn.",
)
@click.option(
    "--out",
    type=click.Path(path_type=Path),
    default=Path("multiverse"),
    show_default=True,
    help="Folder for the report; the same command resumes there.",
)
@_experiment_options
def multiverse(**options: Any) -> None:
    """Judge the paper's claims under many readings of it: shares, what decides, report.html."""
    from tasklift.studies.multiverse.report import multiverse as run

    with _progress() as progress:
        report = run(progress=progress, **options)
    click.echo(f"report: {report}")


def _numbers(ctx: click.Context, parameter: click.Parameter, text: str) -> tuple[int, ...]:
    first, dash, last = text.partition("-")
    if not first.strip().isdigit() or (dash and not last.strip().isdigit()):
        raise click.BadParameter(f"expected a number or a range such as 1-5, found {text!r}")
    numbers = tuple(range(int(first), int(last if dash else first) + 1))
    if not numbers or numbers[0] < 1:
        raise click.BadParameter(f"expected a range that begins at 1 or later and ends no earlier, found {text!r}")
    return numbers


@cli.command()
@click.option("--maps", type=_positive, default=12, show_default=True, help="Generated buildings.")
@click.option("--seeds", type=_positive, default=50, show_default=True, help="Seeds per building, main result.")
@click.option("--hostiles", default="1-5", show_default=True, callback=_numbers, help="A number or a range.")
@click.option(
    "--out",
    type=click.Path(path_type=Path),
    default=Path("drills"),
    show_default=True,
    help="Folder for the report; the same command resumes there.",
)
@click.option("--page", type=click.Path(path_type=Path), help="A Markdown page with marks to put the results between.")
@click.option("--choose", is_flag=True, help="Instead, compare ways of drilling on other maps, and name the best.")
@_experiment_options
def drills(choose: bool, **options: Any) -> None:
    """Measure drills: hostiles that repel, then T, against direct learning at equal total trials."""
    from tasklift.studies.drills import report as drill_report

    with _progress() as progress:
        if choose:
            line, table = drill_report.choose(out=options["out"], workers=options["workers"], progress=progress)
        else:
            lines, report = drill_report.drills(progress=progress, **options)
    if choose:
        from tasklift.cli.runs import print_tables

        print_tables(table)
        click.echo(line)
    else:
        click.echo("\n".join([*lines, f"report: {report}"]))


@cli.command()
@click.argument("building", type=click.Path(path_type=Path))
@click.option("--team", default="10+5", show_default=True, callback=_team, help="Scouts+weapon robots.")
@click.option("--hostiles", type=click.IntRange(min=0), default=1, show_default=True)
@click.option("--weapons-needed", type=_positive, default=2, show_default=True, help="The paper's m.")
@click.option("--limit", type=_positive, default=600, show_default=True, help="Steps per trial.")
@click.option("--preset", type=click.Choice(["scattered", "cohesive"]), default="scattered", show_default=True)
@click.option("--seeds", type=_positive, default=5, show_default=True)
@click.option("--trials", type=_positive, default=100, show_default=True)
@click.option(
    "--out",
    type=click.Path(path_type=Path),
    default=None,
    help="Folder for policies and report; default: beside the current folder's runs, by name.",
)
@_experiment_options
def train(**options: Any) -> None:
    """Learn on your own building (.json or .graph): policy files and the verdict."""
    from tasklift.studies.train import train as run

    with _progress() as progress:
        lines, report = run(progress=progress, **options)
    for line in lines:
        click.echo(line)
    click.echo(f"report: {report}")


@cli.group()
def policy() -> None:
    """Read what was learned."""


@policy.command("show")
@click.argument("file", type=click.Path(path_type=Path))
@click.option("--top", type=_positive, default=3, show_default=True, help="Outputs to show per input.")
def policy_show(file: Path, top: int) -> None:
    """Show the most likely outputs of every input."""
    from tasklift.tasks.policy import Policy

    loaded = Policy.load(file)
    say(f"{loaded.task.name}: {loaded.task.shape[0]} inputs x {loaded.task.shape[1]} outputs")
    for line in loaded.describe(top):
        say(line)


@policy.command("export")
@click.argument("file", type=click.Path(path_type=Path))
@click.option("-o", "--out", type=click.Path(path_type=Path), required=True, help="A .csv file.")
@click.option("--force", is_flag=True, help="Replace a file that is there.")
def policy_export(file: Path, out: Path, force: bool) -> None:
    """Write a policy as a table: one line per input and output, with weight and probability."""
    from tasklift.files import output_file, write_atomically
    from tasklift.tasks.policy import Policy

    output_file(out, (".csv",), force=force, reads=[file])
    write_atomically(out, Policy.load(file).to_csv(), replace=force)
    say(f"written: {out}")


class _progress:
    """A bar per piece of work; called as ``progress(done, total, note)``."""

    def __enter__(self) -> Progress:
        from rich.console import Console
        from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeElapsedColumn

        self.bar = Progress(
            TextColumn("{task.fields[what]:<44.44}", markup=False),
            BarColumn(),
            MofNCompleteColumn(),
            TimeElapsedColumn(),
            console=Console(stderr=True),
        )
        self.current: tuple[Any, int] | None = None
        return self.show

    def show(self, done: int, total: int, note: str) -> None:
        """Show ``done`` of ``total``; another total begins another bar."""
        if self.current is None:
            self.bar.start()  # not before there is something to show: a refusal is one line
        if self.current is None or self.current[1] != total:
            self.current = (self.bar.add_task("", total=total, what=note), total)
        self.bar.update(self.current[0], completed=done, what=note)

    def __exit__(self, *_: object) -> None:
        if self.current is not None:
            self.bar.stop()


def main() -> None:
    """Run the command line; the user's mistakes end in one line and exit code 2, Ctrl-C in 130."""
    for stream in (sys.stdout, sys.stderr):
        if isinstance(stream, io.TextIOWrapper):  # a terminal that cannot show a character gets its number
            stream.reconfigure(errors="backslashreplace")
    try:
        cli.main(standalone_mode=False)
    except TaskliftError as error:
        click.echo(one_line(f"tasklift: {error}"), err=True)
        sys.exit(2)
    except click.exceptions.NoArgsIsHelpError as error:
        error.show()
        sys.exit(2)
    except click.ClickException as error:
        click.echo(one_line(f"tasklift: {error.format_message()}"), err=True)
        sys.exit(2)
    except (KeyboardInterrupt, click.Abort) as stop:
        # click turns the interrupt into Abort; its cause may say how to resume
        reason = str(stop.__cause__ or stop) or "stopped"
        click.echo(f"tasklift: {reason}", err=True)
        sys.exit(130)
