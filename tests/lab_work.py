"""Work for the tests of the laboratory, importable by subprocesses and by Ray's workers."""

from __future__ import annotations

import os
import sys
import time
from functools import partial
from pathlib import Path

import numpy as np

from tasklift.lab import Cell, CellResult, Spec, Store, grid, run

SPEC = Spec.of("test", {"maps": ["a", "b"], "seeds": 6, "arms": ["direct", "copy"], "trials": 30})
CELLS = grid(["scattered", "cohesive"], ["a", "b"], range(6), ["direct", "copy"])


def work(cell: Cell, delay: float = 0.0) -> CellResult:
    """Numbers that depend on the cell alone."""
    time.sleep(delay)
    key = [ord(c) for c in f"{cell.reading}/{cell.map}/{cell.arm}"]
    rng = np.random.default_rng([*key, cell.seed])
    steps = rng.integers(50, 601, 30)
    target = {
        "steps": steps,
        "success": steps < 600,
        "losses": rng.integers(0, 16, 30),
        "share": rng.random(30),
    }
    return CellResult(
        {"sweep": {"steps": rng.integers(0, 70_000, 8)}, "target": target},
        {"steps": float(steps.mean()), "losses": int(target["losses"].sum()), "time_to": None},
        {"weights": rng.random((3, 4)), "note": {"best": [1, 2]}},
    )


def work_and_die_once(cell: Cell, folder: str) -> CellResult:
    """Leave a note of this process, and wait to be killed if this is the first one on seed 3."""
    note = Path(folder) / f"{cell.reading}-{cell.map}-{cell.seed}-{cell.arm}"
    if cell.seed == 3 and cell.arm == "copy" and not note.exists():
        note.write_text(str(os.getpid()))
        time.sleep(60)
    return work(cell)


if __name__ == "__main__":
    # store, seconds per cell, detail
    with Store.open(sys.argv[1], SPEC, detail=sys.argv[3]) as opened:
        run(opened, CELLS, partial(work, delay=float(sys.argv[2])), workers=2)
