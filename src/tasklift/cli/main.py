"""The command line: parse and call, nothing else. Everything heavy is imported when its command runs."""

from __future__ import annotations

import atexit
import errno
import io
import os
import signal
import sys
from contextlib import suppress
from importlib import import_module
from typing import NoReturn

import click

from tasklift import __version__
from tasklift.cli.options import Group
from tasklift.errors import TaskliftError
from tasklift.text import one_line

#: Command groups that live with their wing: name -> (module, attribute, one line of help).
_ELSEWHERE = {
    "map": (
        "tasklift.cli.plans",
        "map_group",
        "Turn floor plans into buildings; look at them, check, correct, export.",
    ),
    "certify": ("tasklift.cli.certify", "certify_command", "Bound what a policy solves and loses, on fresh episodes."),
    "drills": (
        "tasklift.cli.experiments",
        "drills",
        "Compare practice with harmless hostiles (drills) with learning from scratch.",
    ),
    "learn": ("tasklift.cli.learn", "learn_command", "Run a curriculum from a spec file; say whether it paid."),
    "multiverse": (
        "tasklift.cli.experiments",
        "multiverse",
        "Test the paper's claims under many rule variants (readings).",
    ),
    "policy": ("tasklift.cli.policy", "policy_group", "Show and export what was learned."),
    "reproduce": ("tasklift.cli.experiments", "reproduce", "Reproduce the paper: figures, claims, report.html."),
    "runs": ("tasklift.cli.runs", "runs_group", "List, show, compare and export experiments."),
    "simplify": ("tasklift.cli.simplify", "simplify_command", "Say which simpler task to learn first."),
    "team": ("tasklift.cli.team", "team_command", "Say which team a building needs."),
    "train": ("tasklift.cli.experiments", "train", "Learn on your own building: the best policy there is, certified."),
    "watch": ("tasklift.cli.watch", "watch_command", "Replay trials in the browser."),
}


STOPPED = "stopped; the same command goes on from there"


class _Commands(Group):
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


def main() -> None:
    """Run the command line; the user's mistakes end in one line and exit code 2, Ctrl-C in 130."""
    try:
        atexit.register(signal.signal, signal.SIGINT, signal.SIG_IGN)  # Ctrl-C while Python ends has nothing to stop
        for stream in (sys.stdout, sys.stderr):
            if isinstance(stream, io.TextIOWrapper):  # a terminal that cannot show a character gets its number
                stream.reconfigure(errors="backslashreplace")
        cli.main(standalone_mode=False)
        if sys.stdout is not None:
            sys.stdout.flush()  # what cannot be written is found here, not while Python ends
    except TaskliftError as error:
        _end("\n".join([str(error), *getattr(error, "__notes__", ())]), 2)
    except click.exceptions.NoArgsIsHelpError as error:
        with suppress(OSError):
            error.show()
        sys.exit(2)
    except click.ClickException as error:
        _end(error.format_message(), 2)
    except (KeyboardInterrupt, click.Abort) as stop:
        # click turns the interrupt into Abort; its cause may say how to resume
        _end(str(stop.__cause__ or stop) or STOPPED, 130)
    except RuntimeError as error:
        if not isinstance(error.__cause__, KeyboardInterrupt):  # up to 3.11, Python says so of one in a class body
            raise
        _end(STOPPED, 130)
    except MemoryError:
        _end("the memory is full; ask for less at once, such as fewer seeds or episodes", 2)
    except OSError as error:  # of files that commands write or read, it has become a TaskliftError
        if error.errno == errno.EPIPE:
            _end("", 1)  # whoever read the output wants no more of it
        place = "the output" if error.filename is None else error.filename
        _end(f"{place}: {error.strerror or error}", 2)


def _end(reason: str, code: int) -> NoReturn:
    """Say in one line why the command ends, where it can be said."""
    if reason:
        with suppress(OSError):
            for line in reason.splitlines():
                click.echo(one_line(f"tasklift: {line}"), err=True)
    for stream in (sys.stdout, sys.stderr):
        try:
            if stream is not None:
                stream.flush()
        except OSError:  # a full disk, or a closed pipe: Python would try again at its end, and say so
            os.dup2(os.open(os.devnull, os.O_WRONLY), stream.fileno())
    sys.exit(code)
