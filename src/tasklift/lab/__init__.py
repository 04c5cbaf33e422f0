"""Any experiment: a frozen spec, cells, one file that survives interruption, engines, exports, reports."""

from tasklift.lab.cell import Cell, CellResult, grid
from tasklift.lab.engine import Interrupted, Progress, Ran, recompute, run
from tasklift.lab.file import FILE_NAME
from tasklift.lab.spec import Spec, differences
from tasklift.lab.store import Curves, Store

__all__ = [
    "FILE_NAME",
    "Cell",
    "CellResult",
    "Curves",
    "Interrupted",
    "Progress",
    "Ran",
    "Spec",
    "Store",
    "differences",
    "grid",
    "recompute",
    "run",
]
