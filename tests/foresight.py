"""What tells beforehand which simpler task will help: cheap signals against what was saved, on planted tasks.

``python tests/foresight.py --tasks 25`` prints the rank correlation of each signal with the share of the criterion that
is saved, over all candidates of one stage, and its 95 % interval by resampling tasks. The signals:

- ``probe``: what is saved with a quarter of the episodes and two seeds;
- ``overlap``: of the inputs that a short run on the target changes, the share that a short run on the source changed;
- ``agreement``: how the preferences of both correlate where both changed something;
- ``rewards``: how the expected rewards of both worlds correlate, inputs left out being averaged;
- ``variation``: how little the preferences of a short run on the target vary over what the source cannot tell apart.
"""

from __future__ import annotations

import argparse
import tempfile
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.stats import spearmanr

import planted
from tasklift import Model
from tasklift.learning.curriculum import Curriculum
from tasklift.studies.simplify.search import SimplifyStudy

Table = NDArray[np.float64]
REALISED = range(100, 116)
PROBED = range(2)
SIGNALS = ("probe", "overlap", "agreement", "rewards", "variation")


def short(document: dict[str, Any]) -> dict[str, Any]:
    """Return the spec with a quarter of the episodes."""
    target = document["stages"][0]
    settings = document["simplify"]
    return document | {
        "stages": [target | {"trials": target["trials"] // 4}],
        "simplify": settings | {"trials": settings["trials"] // 4},
    }


def saved(study: SimplifyStudy, seeds: range, file: Path) -> Table:
    """Return the share of the criterion that each candidate saves."""
    found, scratch = study.measured(file, study.found, seeds, None)
    least = scratch.criterion.mean()
    return np.array([(least - one.criterion.mean()) / max(least, 1e-9) for one in found])


def centred(table: Table) -> Table:
    return table - table.mean(axis=1, keepdims=True)


def correlation(one: Table, other: Table) -> float:
    flat = np.stack([one.ravel(), other.ravel()])
    return float(np.corrcoef(flat)[0, 1]) if flat.shape[1] > 1 and (flat.std(axis=1) > 0).all() else 0.0


def averaged(table: Table, groups: NDArray[np.int64]) -> Table:
    """Return the table with each row replaced by the mean over its group; rows outside are 0."""
    found = np.zeros_like(table)
    for group in np.unique(groups[groups >= 0]):
        found[groups == group] = table[groups == group].mean(axis=0)
    return found


def expected_rewards(model: Model) -> Table:
    return (model.probability * model.reward).sum(axis=2)


def signals_of(curriculum: Curriculum, learned: Table) -> dict[str, float]:
    """Return the signals of one candidate; ``learned``: preferences after a short run on the target."""
    source, target = curriculum.stages[0], curriculum.stages[-1]
    entering = curriculum.policy_at(0, target.name, 0).weights
    here, there = (table.any(axis=1) for table in (learned, entering))
    groups, both = source.task.input_map, here & there
    mine, means = centred(learned), averaged(centred(learned), groups)
    total = float((mine[here] ** 2).sum())
    return {
        "overlap": float(there[here].mean()),
        "agreement": correlation(mine[both], centred(entering)[both]),
        "rewards": correlation(expected_rewards(target.world), averaged(expected_rewards(source.world), groups)),
        "variation": 1.0 - float(((mine - means)[here] ** 2).sum()) / total if total else 0.0,
    }


def rows_of(kind: str, number: int) -> list[list[float]]:
    """Return, for each candidate of one stage, its signals and what it saves."""
    document = planted.document(kind, number)
    whole, quick = (SimplifyStudy(d, Path(planted.__file__).parent) for d in (document, short(document)))
    with tempfile.TemporaryDirectory() as folder:
        realised = saved(whole, REALISED, Path(folder) / "whole.sqlite")
        probed = saved(quick, PROBED, Path(folder) / "quick.sqlite")
    learned = np.asarray(quick.curriculum(None).run(0).policy.weights)
    rows = []
    for candidate, probe, gain in zip(quick.found, probed, realised, strict=True):
        found = signals_of(quick.curriculum(candidate), learned) | {"probe": float(probe)}
        rows.append([*(found[name] for name in SIGNALS), float(gain)])
    return rows


def main() -> None:
    """Print the rank correlations."""
    asked = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    asked.add_argument("--tasks", type=int, default=25)
    asked.add_argument("--first", type=int, default=3000)
    options = asked.parse_args()
    tasks = [
        np.array(rows_of(kind, options.first + number)) for kind in planted.KINDS for number in range(options.tasks)
    ]
    rng = np.random.default_rng(0)
    for k, name in enumerate(SIGNALS):
        def ranked(chosen: list[Table], k: int = k) -> float:
            rows = np.concatenate(chosen)
            return float(spearmanr(rows[:, k], rows[:, -1]).statistic)

        drawn = [ranked([tasks[i] for i in rng.integers(len(tasks), size=len(tasks))]) for _ in range(999)]
        low, high = np.quantile(drawn, [0.025, 0.975])
        print(f"{name}: {ranked(tasks):.2f} [{low:.2f}, {high:.2f}] over {sum(map(len, tasks))} candidates")


if __name__ == "__main__":
    main()
