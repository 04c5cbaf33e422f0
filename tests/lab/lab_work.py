"""Work for the tests of the laboratory, importable by subprocesses and by Ray's workers."""

from __future__ import annotations

import os
import sys
import time
from functools import partial
from pathlib import Path

import numpy as np

from tasklift.lab import Cell, CellResult, Spec, Store, run

AXES = {
    "reading": ["scattered", "cohesive"],
    "map": {"a": "7f", "b": "e0"},
    "seed": range(6),
    "arm": ["direct", "copy"],
}
SPEC = Spec.of("test", {"trials": 30, "team": [10, 5]}, AXES, over=["map", "seed"])
CELLS = SPEC.cells()


def work(cell: Cell, delay: float = 0.0) -> CellResult:
    """Numbers that depend on the cell alone."""
    time.sleep(delay)
    key = [ord(c) for c in f"{cell['reading']}/{cell['map']}/{cell['arm']}"]
    rng = np.random.default_rng([*key, int(cell["seed"])])
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


FATAL = Cell(reading="scattered", map="a", seed=3, arm="copy")


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
