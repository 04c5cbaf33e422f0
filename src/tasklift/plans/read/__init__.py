"""Readers of floor plans and graphs, one format a module.

A module in this folder is a reader: it has a ``TITLE`` for people, ``recognises(source)`` which tells the format from
what is in a file, and ``read(source)``. Nothing else has to be changed to add one; give it a test that calls
:func:`tasklift.testing.check_reader`.
"""

from __future__ import annotations

import os
import pkgutil
from functools import cache
from importlib import import_module
from typing import Protocol, cast

from tasklift.building.graph import Building
from tasklift.errors import TaskliftError
from tasklift.plans.foreign import by_content, by_signature
from tasklift.plans.pictures import is_picture
from tasklift.plans.places import Places
from tasklift.plans.plan import Plan
from tasklift.plans.source import Source


class Reader(Protocol):
    """What a module that reads one format has."""

    TITLE: str

    def recognises(self, source: Source) -> bool:
        """Whether ``source`` is of this format; exactly one reader says so."""
        ...

    def read(self, source: Source) -> Plan | Places | Building:
        """Return a floor plan, places and ways, or a building."""
        ...


@cache
def readers() -> tuple[Reader, ...]:
    """All readers, by the name of their module."""
    names = sorted(module.name for module in pkgutil.iter_modules(__path__))
    return tuple(cast(Reader, import_module(f"{__name__}.{name}")) for name in names)


def find_reader(source: Source) -> Reader:
    """Return the reader that recognises a file.

    Raises
    ------
    TaskliftError
        If none does, with what the file seems to be.
    """
    known = by_signature(source)
    if known:
        raise source.fault(known)
    damage: TaskliftError | None = None
    for reader in readers():
        try:
            if reader.recognises(source):
                return reader
        except TaskliftError as error:
            damage = damage or error
    if damage is not None:
        raise damage
    raise source.fault(by_content(source))


def read_map(source: Source) -> Plan | Places | Building:
    """Read a file of any format.

    Raises
    ------
    TaskliftError
        In one line, with the file and the place at fault.
    """
    return find_reader(source).read(source)


def load_building(path: str | os.PathLike[str]) -> Building:
    """Read a building: our JSON, or any graph of places that :func:`read_map` reads.

    Raises
    ------
    TaskliftError
        If the file is damaged, or a floor plan, which ``tasklift map import`` turns into a building.
    """
    source = Source(path)
    found = None if is_picture(source.head) else read_map(source)
    if found is None or isinstance(found, Plan):
        raise source.fault("is a floor plan, not a building; turn it into one with `tasklift map import`")
    return found.building() if isinstance(found, Places) else found
