"""The reference of the command line, made from the commands themselves."""

from __future__ import annotations

import re
from collections.abc import Iterator

import click

from tasklift.cli.main import cli


def commands_page() -> str:
    """Return the page: a section for each command, with its help and a table of its options."""
    parts = [
        "# The command line\n",
        "This page is made from the commands. `tasklift COMMAND --help` prints the same.\n",
        'Shell completion, for Bash: `eval "$(_TASKLIFT_COMPLETE=bash_source tasklift)"`; for Zsh and Fish, write\n'
        "`zsh_source` or `fish_source`.\n",
        "Wrong input ends with one line and exit code 2. Nothing that exists is replaced without `--force`.\n",
    ]
    for path, command, context in _commands(cli, click.Context(cli, info_name="tasklift")):
        parts.append(f"## {path}\n")
        parts.append(_text(command.help or ""))
        if isinstance(command, click.Group):
            continue
        parts.append(f"```text\n{command.get_usage(context).removeprefix('Usage: ')}\n```\n")
        options = [p for p in command.params if isinstance(p, click.Option)]
        rows = [record for option in options if (record := option.get_help_record(context))]
        parts.append("| option | meaning |\n|---|---|")
        parts += [f"| `{name.replace('|', chr(92) + '|')}` | {_cell(text)} |" for name, text in rows]
        parts.append("")
    return "\n".join(parts)


def _commands(group: click.Group, context: click.Context) -> Iterator[tuple[str, click.Command, click.Context]]:
    for name in group.list_commands(context):
        command = group.get_command(context, name)
        if command is None or command.hidden:
            continue
        inside = click.Context(command, info_name=name, parent=context)
        yield inside.command_path, command, inside
        if isinstance(command, click.Group):
            yield from _commands(command, inside)


def _text(help_text: str) -> str:
    """Return paragraphs as they are; blocks that click keeps (``\\b``) as code."""
    found = []
    for block in help_text.split("\n\n"):
        kept = block.removeprefix("\b\n")
        found.append(f"```text\n{kept}\n```\n" if kept != block else " ".join(block.split()) + "\n")
    return "\n".join(found)


def _cell(text: str) -> str:
    text = " ".join(text.split()).replace("<", "&lt;")
    return re.sub(r"[|\[\]]", r"\\\g<0>", text)  # two brackets side by side would be a link
