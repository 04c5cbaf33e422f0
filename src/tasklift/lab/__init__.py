"""Any experiment: a frozen spec, cells, one file that survives interruption, engines, exports, reports."""

from tasklift.lab.engine import Interrupted, Progress, Ran, recompute, run
from tasklift.lab.spec import Cell, CellResult, Spec, differences, grid
from tasklift.lab.store import FILE_NAME, Curves, Store

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
