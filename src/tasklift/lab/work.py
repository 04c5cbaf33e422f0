"""The work of a cell, wherever it is done: on a thread here, or in a worker of a cluster."""

from __future__ import annotations

from collections.abc import Callable

from tasklift.errors import TaskliftError
from tasklift.lab.cell import Cell, CellResult
from tasklift.lab.packing import Detail, Packed

Work = Callable[[Cell], CellResult]
Group = list[Cell]
Stopped = Callable[[], bool]


def compute(work: Work, cell: Cell, detail: Detail) -> Packed:
    """Do one cell's work and pack it; errors name the cell."""
    try:
        return Packed.of(cell, work(cell), detail)
    except TaskliftError as error:
        raise TaskliftError(f"cell {cell}: {error}") from error
    except Exception as error:
        error.add_note(f"while computing the cell {cell}")
        raise
