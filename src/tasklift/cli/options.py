"""What the commands share: kinds of options, the progress bar, and the line that runs a command again."""

from __future__ import annotations

import re
import shlex
from collections.abc import Callable
from difflib import get_close_matches
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

if TYPE_CHECKING:
    from tasklift.lab import Progress

positive = click.IntRange(min=1)
count = click.IntRange(min=0)
path = click.Path(path_type=Path)

#: Options that change where and how fast a command runs and what it prints, and none of its results.
_NO_RESULT = ("engine", "workers", "address", "page", "open_browser", "quiet", "as_json")

#: For commands that a script may call.
quiet = click.option("-q", "--quiet", is_flag=True, help="Show no progress.")
as_json = click.option("--json", "as_json", is_flag=True, help="Print the result as JSON, and nothing else.")


class Group(click.Group):
    """A group of commands that says which one might be meant."""

    def resolve_command(
        self, ctx: click.Context, args: list[str]
    ) -> tuple[str | None, click.Command | None, list[str]]:
        """Return the command that is named; refuse an unknown one."""
        names = self.list_commands(ctx)
        if args[0] not in names and not args[0].startswith("-"):
            near = get_close_matches(args[0], names, 1)
            meant = f"did you mean {near[0]!r}?" if near else f"expected one of {', '.join(names)}"
            ctx.fail(f"unknown command {args[0]!r}; {meant}")
        return super().resolve_command(ctx, args)


class Names(click.ParamType):
    """A list of names, separated by commas."""

    name = "names"

    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> tuple[str, ...]:
        """Return the names."""
        if not isinstance(value, str):
            return tuple(value)
        found = tuple(part.strip() for part in value.split(","))
        if not all(found):
            self.fail(f"expected names separated by commas, found {value!r}", param, ctx)
        return found


class Numbers(click.ParamType):
    """A list of whole numbers from 1, separated by commas; ``1-5`` stands for 1,2,3,4,5."""

    name = "numbers"

    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> tuple[int, ...]:
        """Return the numbers, each once, in the order in which they are named."""
        if not isinstance(value, str):
            return tuple(value)
        found: dict[int, None] = {}
        for part in value.split(","):
            spelled = re.fullmatch(r"\s*([0-9]{1,6})\s*(?:-\s*([0-9]{1,6})\s*)?", part)
            first, last = (int(spelled[1]), int(spelled[2] or spelled[1])) if spelled else (0, 0)
            if not 1 <= first <= last or last - first > 10_000:
                self.fail(f"expected numbers from 1 such as 1,3, or a range such as 1-5, found {value!r}", param, ctx)
            found.update(dict.fromkeys(range(first, last + 1)))
        return tuple(found)


#: For commands that make a mission: what it declares. None: as the mission file says, or else Mission's default.
mission = click.option("--mission", type=path, help="A file (TOML) with team, kinds of robots, inputs and outputs.")
team = click.option("--team", help="Scouts+weapon robots.  [default: of --mission, or 10+5]")
weapons_needed = click.option("--weapons-needed", type=positive,
                              help="Weapon robots per hostile (m).  [default: of --mission, or 2]")  # fmt: skip
limit = click.option("--limit", type=positive, help="Steps per episode (trial).  [default: of --mission, or 600]")


def folder(default: str | None = None, help: str = "Folder for the report; the same command resumes there.") -> Any:
    """Return the option of a command's folder."""
    return click.option("--out", type=path, default=default, show_default=default is not None, help=help)


def _defaults_from(context: click.Context, option: click.Parameter, file: Path | None) -> None:
    """Take the defaults of a command's options from a TOML file, spelled as on the command line."""
    if file is None:
        return
    from tasklift.errors import TaskliftError
    from tasklift.files import parse_toml, read_text
    from tasklift.text import shown

    known = {one.opts[-1].lstrip("-"): one for one in context.command.params if one is not option}
    found: dict[str, Any] = {}
    for name, value in parse_toml(read_text(file), str(file)).items():
        if name.replace("_", "-") not in known:
            raise TaskliftError(f"{file}: unknown option {shown(name)}; the options are {', '.join(sorted(known))}")
        parameter = known[name.replace("_", "-")]
        values = value if isinstance(value, list) else [value]
        if not all(isinstance(one, str | int | float) for one in values):
            raise TaskliftError(f"{file}, {name}: expected a value or a list of values, found {shown(value)}")
        spelled = [str(one) for one in values]
        given = spelled if isinstance(parameter, click.Option) and parameter.multiple else ",".join(spelled)
        try:
            parameter.type_cast_value(context, given)
        except click.BadParameter as error:
            raise TaskliftError(f"{file}, {name}: {error.message}") from error
        found[parameter.name or ""] = given
    context.default_map = {**(context.default_map or {}), **found}


def running(command: Callable[..., Any]) -> Callable[..., Any]:
    """Add the options of every command that trains: where, and on how many cores."""
    for option in (
        click.option(
            "--workers",
            type=click.IntRange(1, 4096),
            help="Threads, or the size of a local Ray.  [default: one per core]",
        ),
        click.option("--address", help="For Ray: a running cluster, such as auto or HOST:PORT."),
        click.option("--engine", type=click.Choice(["threads", "ray"]), default="threads", show_default=True),
        quiet,
        click.option(
            "--config",
            type=path,
            is_eager=True,
            expose_value=False,
            callback=_defaults_from,
            help="A TOML file with options by name, such as seeds = 10. The command line goes before it.",
        ),
    ):
        command = option(command)
    return command


def command_line() -> str:
    """Return the line that runs the current command again: its arguments, and every option that has a value."""
    context = click.get_current_context()
    words = ["tasklift", context.info_name or ""]
    for parameter in context.command.params:
        value = context.params.get(parameter.name or "")
        if parameter.name in _NO_RESULT or value is None or value is False:
            continue
        several = isinstance(parameter, click.Option) and parameter.multiple
        for one in value if several else [value]:
            if isinstance(parameter, click.Option):
                words.append(parameter.opts[0])
            if one is not True:
                words.append(",".join(map(str, one)) if isinstance(one, tuple) else str(one))
    return shlex.join(words)


def given(options: dict[str, Any]) -> dict[str, Any]:
    """Return the options that have a value, but for those that say how to print."""
    return {name: value for name, value in options.items() if value is not None and name not in ("quiet", "as_json")}


class progress:
    """A bar per piece of work; called as ``progress(done, total, note)``. With --quiet or --json it shows nothing."""

    def __enter__(self) -> Progress:
        asked = click.get_current_context().params
        self.silent = bool(asked.get("quiet") or asked.get("as_json"))
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
        if self.silent:
            return
        if self.current is None:
            self.bar.start()  # not before there is something to show: a refusal is one line
        if self.current is None or self.current[1] != total:
            self.current = (self.bar.add_task("", total=total, what=note), total)
        self.bar.update(self.current[0], completed=done, what=note)

    def __exit__(self, *_: object) -> None:
        if self.current is not None:
            self.bar.stop()
