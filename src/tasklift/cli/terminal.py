"""What a command prints: as text, whatever a file or a user put into it."""

from __future__ import annotations

import json
from typing import Any

import click

from tasklift.text import printable


def say_json(document: Any) -> None:
    """Print a document as JSON, readable for people."""
    click.echo(json.dumps(document, indent=1, ensure_ascii=True))


def say(text: object, *, err: bool = False) -> None:
    """Print lines; control characters within them, which a terminal would obey, are spelled out."""
    click.echo("\n".join(printable(line) for line in str(text).split("\n")), err=err)
