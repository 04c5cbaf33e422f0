"""The one error that means: the user can mend this."""

from __future__ import annotations

import os
from collections.abc import Iterator
from contextlib import contextmanager

from tasklift.text import one_line


class TaskliftError(ValueError):
    """A mistake in what the user gave: a file, an option, a declaration.

    The message says what was expected, what was found, where, and what to do. It is one line of at most 300
    characters without control characters, whatever was found. The command line prints it and exits with code
    2; it never becomes a traceback there.
    """

    def __init__(self, message: object) -> None:
        super().__init__(one_line(message))


@contextmanager
def about(path: str | os.PathLike[str]) -> Iterator[None]:
    """Put the name of the file that is wrong before the errors of the block."""
    try:
        yield
    except TaskliftError as error:
        raise TaskliftError(f"{path}: {error}") from error


def missing(package: str, extra: str, needed_by: str = "this") -> TaskliftError:
    """Return the error for a package that one of tasklift's extras brings; a command that installs it comes with it.

    The command names the packages of the extra, as this installation declares them. It therefore works for a clone
    and for a release, from any folder.
    """
    from importlib.metadata import PackageNotFoundError, requires

    try:
        declared = requires("tasklift") or []
    except PackageNotFoundError:  # run from its source folder, never installed
        declared = []
    needs = [need.split(";")[0].strip() for need in declared if f'extra == "{extra}"' in need.replace("'", '"')]
    command = " ".join(f"'{need}'" for need in needs) or package.lower()
    return TaskliftError(f"{needed_by} needs {package} (the extra {extra!r}); type: pip install {command}")
