"""What can be watched: policies on a building, arms on a building, any trial of an experiment.

Nothing is recorded while robots learn. A trial is a function of its building, seed, arm and number, so it is
computed again up to its beginning, then traced.
"""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

from tasklift.building.mission import Mission
from tasklift.errors import TaskliftError
from tasklift.lab import Cell, Store
from tasklift.learning.chances import GREEDY_STAGE, TARGET_STAGE
from tasklift.learning.reinforcement import Reinforcement
from tasklift.studies.study import Study
from tasklift.tasks.policy import Policy

if TYPE_CHECKING:
    from tasklift.building.simulator import Trace

#: More floor plans than this are too small to read
MOST = 9
#: What is shown unless somebody asks for other arms.
USUAL = ("direct", "copy", "copy-prior")


def policy_traces(
    mission: Mission, policies: Sequence[tuple[str, Policy]], *, seed: int, trial: int, greedy: bool
) -> list[tuple[str, Trace]]:
    """Trace policies as they are, without learning; trial ``trial`` counts from 1.

    Parameters
    ----------
    mission
        Where, and against what.
    policies
        Labels and policies.
    seed, trial
        The random key. Greedy trials are those that a study counts at its end.
    greedy
        Always the heaviest output; otherwise drawn by weight.
    """
    rules = Reinforcement(selection="exploitation" if greedy else "exploration")
    stage = GREEDY_STAGE if greedy else TARGET_STAGE
    return [
        (
            label,
            mission.simulator.trace(policy, seed=seed, trial=trial - 1, stage=stage, reinforcement=rules, learn=False),
        )
        for label, policy in policies
    ]


def study_traces(
    study: Study,
    *,
    condition: str,
    map: str,
    seed: int,
    arms: Sequence[str],
    trials: Sequence[int] | None = None,
    stage: str = "target",
) -> list[tuple[str, Trace]]:
    """Trace trials of arms on one map with one seed, each as the unbroken run has it.

    Parameters
    ----------
    study
        The experiment.
    condition, map, seed, arms
        The cells; arms by slug.
    trials
        Counted from 1; by default the last one.
    stage
        As in :meth:`.Study.replay`.

    Raises
    ------
    TaskliftError
        If there is no such cell, stage or trial, or these are too many.
    """
    cells = [study.cell(condition, map, seed, arm) for arm in arms]
    several = len(cells) * len(trials or [1])
    if several > MOST:
        raise TaskliftError(f"watch: asked for {several} trials side by side; expected at most {MOST}")
    traces = []
    for cell in cells:
        label, last = study.arms[cell["arm"]].label, study.stage_trials(cell, stage)
        for trial in trials or [last]:
            if not 1 <= trial <= last:
                raise TaskliftError(f"watch: {label} has the trials 1 to {last} in stage {stage!r}, not trial {trial}")
            trace = study.replay(cell, trial - 1, stage)
            if trials is not None and len(trials) > 1:
                traces.append((f"trial {trial}" if len(cells) == 1 else f"{label}, trial {trial}", trace))
            else:
                traces.append((label, trace))
    return traces


def run_traces(
    path: Path,
    *,
    condition: str | None = None,
    map: str | None = None,
    seed: int = 0,
    arms: Sequence[str] | None = None,
    trials: Sequence[int] | None = None,
    stage: str = "target",
) -> list[tuple[str, Trace]]:
    """Trace trials of an experiment, computed again from its settings and compared with its rows.

    Parameters
    ----------
    path
        The experiment's folder or file.
    condition, map
        Names in the experiment; by default its first ones.
    seed
        One of the experiment's seeds.
    arms
        Slugs; by default the policy that ``train`` handed over, else :data:`USUAL` where they are there, else the
        first three.
    trials, stage
        As in :func:`study_traces`.

    Raises
    ------
    TaskliftError
        If there is no such cell, stage or trial, or if this release plays the trial differently.
    """
    with Store.read(path) as store:
        study = Study.from_spec(store.spec, store.path.parent)
        there = sorted(store.done())
        given = {study.axis: condition, "map": map, "seed": str(seed)}
        for axis, wanted in given.items():
            there = _among(there, axis, wanted)
        slugs = list(dict.fromkeys(cell["arm"] for cell in there))
        handed = store.path.parent / "policy.json"
        if arms is None and trials is None and stage == "target" and handed.exists():
            # an experiment of train: what it hands over, in an episode that nothing was learned in
            mission = study.mission(there[0][study.axis], there[0]["map"]).with_reading(relocate=True)
            return policy_traces(mission, [("handed over", Policy.load(handed))], seed=seed, trial=1, greedy=False)
        arms = list(arms or [arm for arm in USUAL if arm in slugs] or slugs[:3])
        cells = [_among(there, "arm", arm)[0] for arm in arms]
        traces = study_traces(
            study, condition=cells[0][study.axis], map=cells[0]["map"], seed=seed, arms=arms, trials=trials, stage=stage
        )
        _compare(store, [cell for cell in cells for _ in trials or [1]], traces, stage)
    return traces


def _among(cells: Sequence[Cell], axis: str, wanted: str | None) -> list[Cell]:
    """Return the cells with a value on an axis; by default its first value."""
    found = [cell for cell in cells if cell[axis] == (cells[0][axis] if wanted is None else wanted)]
    if not found:
        values = list(dict.fromkeys(cell[axis] for cell in cells))
        shown = ", ".join(values[:12]) + (f" and {len(values) - 12} more" if len(values) > 12 else "")
        raise TaskliftError(f"{axis} {wanted!r} is not in this experiment; there are: {shown}")
    return found


def _compare(store: Store, cells: Sequence[Cell], traces: Sequence[tuple[str, Trace]], stage: str) -> None:
    """Refuse traces that differ from the rows that were recorded."""
    for cell, (label, trace) in zip(cells, traces, strict=True):
        if cell not in store:
            continue
        rows: Any = store.result(cell).stages.get(stage)
        if rows is None or trace.trial >= len(rows["steps"]):
            continue
        seen = (trace.steps if trace.success else trace.mission.limit, int(trace.losses[-1]))
        kept = (int(rows["steps"][trace.trial]), int(rows["losses"][trace.trial]))
        if seen != kept:
            raise TaskliftError(
                f"{store.path}: {cell}, {label}: recorded with {kept[0]} steps and {kept[1]} losses, played here "
                f"with {seen[0]} and {seen[1]}; it was recorded by tasklift {store.release}: use that"
            )
