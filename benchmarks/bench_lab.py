"""What the store and the statistics cost: python benchmarks/bench_lab.py [CELLS]

Stores results like the full study's (a sweep of 220 trials and 100 trials with nine outcomes per cell), which
are made beforehand, so that all the time is the laboratory's; then reads them, and exports them.
"""

from __future__ import annotations

import sys
import tempfile
import time
from pathlib import Path

import numpy as np

from tasklift import stats
from tasklift.lab import Cell, CellResult, Curves, Spec, Store, run, runs

ARMS = ["random", "expert", "direct", "direct-budget", "copy", "prior", "copy-prior"]


def result(rng: np.random.Generator) -> CellResult:
    steps = np.minimum(rng.integers(50, 900, 100), 600)
    target = {"steps": steps, "success": steps < 600, "explored": rng.random(100)}
    for name, high in (
        ("losses", 16),
        ("scouts", 11),
        ("weapons", 6),
        ("teams", 9),
        ("hostiles", 2),
        ("messages", 400),
    ):
        target[name] = rng.integers(0, high, 100)
    sweep = {"steps": rng.integers(90, 601, 220), "success": rng.random(220) < 0.9}
    return CellResult({"sweep": sweep, "target": target}, {"greedy_steps": float(steps.mean()), "losses": 3})


def timed(text: str, start: float) -> None:
    print(f"{text} in {time.perf_counter() - start:.2f} s")


def describe(curves: dict[str, Curves]) -> None:
    """Bands, a paired comparison and a censored time for every arm."""
    plain = curves["direct"]
    for arm in curves.values():
        stats.mean_band(arm.values, strata=arm.column("map"))
        stats.compare(arm.values.mean(axis=1), plain.values.mean(axis=1), strata=arm.column("map"))
        stats.median_time(stats.time_to_threshold(arm.values, 320))


def main() -> None:
    wanted = int(sys.argv[1]) if len(sys.argv) > 1 else 16_800
    seeds = -(-wanted // (2 * 12 * len(ARMS)))
    axes = {
        "reading": ["scattered", "cohesive"],
        "map": [f"map-{i}" for i in range(12)],
        "seed": range(seeds),
        "arm": ARMS,
    }
    spec = Spec.of("bench", {}, axes, over=["map", "seed"])
    cells = spec.cells()
    rng = np.random.default_rng(0)
    made = [result(rng) for _ in range(97)]

    def work(cell: Cell) -> CellResult:
        return made[(int(cell["seed"]) * 31 + len(cell["arm"])) % 97]

    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "experiment.sqlite"
        with Store.open(path, spec) as store:
            start = time.perf_counter()
            run(store, cells, work)
        each, size = 1e3 * (time.perf_counter() - start) / len(cells), path.stat().st_size / 1e6
        timed(f"store: {len(cells)} cells, {each:.3f} ms each, {size:.1f} MB,", start)
        with Store.read(path) as store:
            start = time.perf_counter()
            curves = {a: store.curves("target", "steps", reading="scattered", arm=a) for a in ARMS}
        count = sum(curve.values.size for curve in curves.values())
        timed(f"read: one column of {count} rows", start)
        start = time.perf_counter()
        describe(curves)
        timed(f"statistics of {count} rows", start)
        for name in ("rows.csv", "rows.parquet"):
            start = time.perf_counter()
            count = runs.export(path, Path(folder) / name)
            size = (Path(folder) / name).stat().st_size / 1e6
            timed(f"export: {count} rows to {name}, {size:.0f} MB,", start)


if __name__ == "__main__":
    main()
