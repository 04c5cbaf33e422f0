"""Reading YAML that a stranger wrote: plain values only, of bounded size."""

from __future__ import annotations

import os
from pathlib import Path
from typing import Any

from tasklift.errors import TaskliftError
from tasklift.files import read_text

LARGEST_YAML_BYTES = 4_000_000
DEEPEST = 50


def read_yaml(path: str | os.PathLike[str]) -> dict[str, Any]:
    """Return the mapping in the YAML file ``path``: plain values, no tags, no anchors or aliases.

    Aliases let a few lines stand for millions of values, and no map format needs them, so they are refused.

    Raises
    ------
    TaskliftError
        If the file is larger than 4 MB, is not YAML, has tags or aliases, or is not a mapping.
    """
    try:
        import yaml
    except ImportError as error:
        raise TaskliftError("PyYAML is not installed; type: pip install 'tasklift[plans]'") from error

    try:
        size = Path(path).stat().st_size
    except (OSError, ValueError) as error:
        reason = getattr(error, "strerror", None) or error
        raise TaskliftError(f"{path}: cannot be read ({reason})") from error
    if size > LARGEST_YAML_BYTES:
        raise TaskliftError(f"{path}: {size} bytes; a map's YAML has at most {LARGEST_YAML_BYTES}")
    text = read_text(path)
    loader = getattr(yaml, "CSafeLoader", yaml.SafeLoader)  # the same, ten times faster, where it was built
    try:
        _check_events(yaml, loader, str(path), text)
        document = yaml.load(text, Loader=loader)
    except yaml.constructor.ConstructorError as error:
        line = error.problem_mark.line + 1 if error.problem_mark else "?"
        raise TaskliftError(
            f"{path}: line {line}: {error.problem}; a map holds plain values only, without tags"
        ) from error
    except yaml.YAMLError as error:
        mark = getattr(error, "problem_mark", None)
        line = f"line {mark.line + 1}: " if mark else ""
        problem = getattr(error, "problem", None) or getattr(error, "reason", "unreadable")
        raise TaskliftError(f"{path}: {line}not valid YAML ({problem})") from error
    except (RecursionError, ValueError, OverflowError) as error:
        # dates and numbers that look like YAML's but are out of range; a thousand nested brackets
        if isinstance(error, TaskliftError):
            raise
        raise TaskliftError(f"{path}: not a map's YAML ({type(error).__name__}: {error!s:.80})") from error
    if not isinstance(document, dict):
        raise TaskliftError(
            f"{path}: expected the fields of a map (image, resolution, …), found {type(document).__name__}"
        )
    return document


def _check_events(yaml: Any, loader: Any, where: str, text: str) -> None:
    """Refuse aliases and deep nesting before anything is built."""
    depth = 0
    for event in yaml.parse(text, Loader=loader):
        if isinstance(event, yaml.AliasEvent):
            line = event.start_mark.line + 1
            raise TaskliftError(f"{where}: line {line}: YAML aliases are not allowed in a map; write it out")
        depth += isinstance(event, yaml.CollectionStartEvent) - isinstance(event, yaml.CollectionEndEvent)
        if depth > DEEPEST:
            raise TaskliftError(f"{where}: nested more than {DEEPEST} deep, which no map is")
