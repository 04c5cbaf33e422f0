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


FATAL = Cell("scattered", "a", 3, "copy")


def work_and_wait_for_death(cell: Cell, note: str) -> CellResult:
    """At the fatal cell, leave this process's id in a file and wait to be killed; not at the second try."""
    if cell == FATAL and not Path(note).exists():
        Path(note).write_text(str(os.getpid()))
        time.sleep(60)
    return work(cell)


if __name__ == "__main__":
    # store, seconds per cell, detail
    with Store.open(sys.argv[1], SPEC, detail=sys.argv[3]) as opened:
        run(opened, CELLS, partial(work, delay=float(sys.argv[2])), workers=2)
