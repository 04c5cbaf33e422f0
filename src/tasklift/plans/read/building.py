"""Our own buildings: JSON as :meth:`tasklift.building.graph.Building.save` writes it."""

from __future__ import annotations

from tasklift.building.graph import FORMAT, Building
from tasklift.plans.source import Source

TITLE = "tasklift building (.json)"


def recognises(source: Source) -> bool:
    """Whether it is JSON that says so, or has the ending and its first fields."""
    return source.fields.get("format") == FORMAT


def read(source: Source) -> Building:
    """Load the building, checking every field.

    Raises
    ------
    TaskliftError
        With the field, node or edge at fault.
    """
    return Building.load(source.path)
