"""What can be watched: policies on a building, the arms of the paper, any trial of an experiment.

Nothing is recorded while robots learn. A trial is a function of its building, seed, arm and number, so it is
computed again up to its beginning, then traced.
"""

from __future__ import annotations

import re
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

from tasklift.building.generate import generate
from tasklift.building.graph import Building
from tasklift.building.mission import Mission
from tasklift.building.reading import Reading
from tasklift.building.team import Kind
from tasklift.errors import TaskliftError
from tasklift.lab import Cell, Store
from tasklift.learning.chances import GREEDY_STAGE, TARGET_STAGE
from tasklift.learning.reinforcement import Reinforcement
from tasklift.studies.arms import ARMS, arm_named
from tasklift.studies.study import Study
from tasklift.tasks.policy import Policy

if TYPE_CHECKING:
    from tasklift.building.simulator import Trace

#: More floor plans than this are too small to read
MOST = 9


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
    study: Study, *, reading: str, map: str, seed: int, arms: Sequence[str], trials: Sequence[int]
) -> list[tuple[str, Trace]]:
    """Trace trials (counted from 1) of arms on one map with one seed, each as the unbroken run has it."""
    if len(arms) * len(trials) > MOST:
        raise TaskliftError(f"watch: {len(arms)} arms at {len(trials)} trials each; expected at most {MOST} in all")
    traces = []
    for name in arms:
        cell = Cell(reading=reading, map=map, seed=seed, arm=name)
        for trial in trials:
            trace = _trial(study, cell, trial)
            several = f"trial {trial}" if len(arms) == 1 else f"{name}, trial {trial}"
            traces.append((name if len(trials) == 1 else several, trace))
    return traces


def arm_names(text: str) -> list[str]:
    """Split a list of arms at its commas, but not within "copy, exploitation"."""
    names: list[str] = []
    for part in text.split(","):
        if names and f"{names[-1]}, {part.strip()}" in ARMS:
            names[-1] += f", {part.strip()}"
        elif part.strip():
            names.append(part.strip())
    return names


def _trial(study: Study, cell: Cell, trial: int) -> Trace:
    if trial < 1:
        raise TaskliftError(f"watch: trials count from 1, found {trial}")
    mission, arm = study.mission(cell["reading"], cell["map"]), arm_named(cell["arm"])
    rules, policy = arm.reinforcement(study.reinforcement), study.before(cell, trial)
    seed = int(cell["seed"])
    return mission.simulator.trace(policy, seed=seed, trial=trial - 1, reinforcement=rules, learn=arm.learns)


def run_traces(
    path: Path,
    *,
    reading: str | None,
    map: str | None,
    seed: int,
    arms: Sequence[str] | None,
    trials: Sequence[int] | None,
) -> list[tuple[str, Trace]]:
    """Trace trials of an experiment, computed again from its settings and held against its rows.

    Parameters
    ----------
    path
        The experiment's folder or file.
    reading, map
        Names in the experiment; by default its first ones.
    seed
        One of the experiment's seeds.
    arms
        Names of arms; by default ``direct``, ``copy`` and ``copy+prior`` where they are there, else the first three.
    trials
        Numbers, counted from 1; by default the last one.

    Raises
    ------
    TaskliftError
        If there is no such cell or trial, or if this release plays the trial differently.
    """
    with Store.read(path) as store:
        settings = store.spec.settings
        study = _study(settings, store.path)
        reading = _one_of(study.readings, reading, "reading")
        map = _one_of(study.buildings, map, "map")
        if seed >= study.seeds:
            raise TaskliftError(f"{path}: has the seeds 0 to {study.seeds - 1}, not {seed}")
        usual = [arm for arm in ("direct", "copy", "copy+prior") if arm in study.arms]
        arms = list(arms or usual or study.arms[:3])
        for arm in arms:
            _one_of(study.arms, arm, "arm")
        trials = list(trials) if trials else [study.trials]
        for trial in trials:
            if trial > study.trials:
                raise TaskliftError(f"{path}: has {study.trials} trials, not trial {trial}")
        traces = study_traces(study, reading=reading, map=map, seed=seed, arms=arms, trials=trials)
        cells = [Cell(reading=reading, map=map, seed=seed, arm=arm) for arm in arms for _ in trials]
        _hold_against(store, cells, traces)
    return traces


def _one_of(names: Any, wanted: str | None, what: str) -> str:
    if wanted is None:
        return str(next(iter(names)))
    if wanted not in names:
        raise TaskliftError(f"{what} {wanted!r} is not in this experiment; there are: {'; '.join(map(str, names))}")
    return wanted


def _study(settings: dict[str, Any], where: Path) -> Study:
    """The study of which ``settings`` are the specification."""
    try:
        return Study(
            {name: _building(where.parent, name, id) for name, id in settings["maps"].items()},
            {name: Reading.from_json(options) for name, options in settings["readings"].items()},
            tuple(settings["arms"]),
            seeds=settings["seeds"],
            trials=settings["trials"],
            repeats=settings["repeats"],
            team={Kind(name, speed, armed): n for name, speed, armed, n in settings["team"]},
            hostiles=settings["hostiles"],
            weapons_needed=settings["weapons_needed"],
            limit=settings["limit"],
            reinforcement=Reinforcement(**settings["reinforcement"]),
        )
    except (KeyError, TypeError, ValueError, AttributeError) as error:
        if isinstance(error, TaskliftError):
            raise
        raise TaskliftError(
            f"{where}: watch plays the experiments of `tasklift reproduce` and `tasklift train`; this one has other "
            f"settings ({error!r})"
        ) from error


def _building(folder: Path, name: str, content_id: str) -> Building:
    """The building of that content: beside the experiment, or generated again."""
    for file in sorted(folder.rglob("*.json")):
        try:
            building = Building.load(file)
        except TaskliftError:
            continue  # a policy, for example
        if building.content_id == content_id:
            return building
    if numbered := re.fullmatch(r"map (\d+)", name):
        building = generate(seed=int(numbered[1]))
        if building.content_id == content_id:
            return building
    raise TaskliftError(f"{folder}: the building {name!r} of this experiment is gone; put its .json file back there")


def _hold_against(store: Store, cells: Sequence[Cell], traces: Sequence[tuple[str, Trace]]) -> None:
    for cell, (label, trace) in zip(cells, traces, strict=True):
        if cell not in store:
            continue
        rows = store.result(cell).stages.get("target")
        if rows is None or trace.trial >= len(rows["steps"]):
            continue
        seen = (trace.steps if trace.success else trace.mission.limit, int(trace.losses[-1]))
        kept = (int(rows["steps"][trace.trial]), int(rows["losses"][trace.trial]))
        if seen != kept:
            raise TaskliftError(
                f"{store.path}: {cell}, {label}: recorded with {kept[0]} steps and {kept[1]} losses, played here "
                f"with {seen[0]} and {seen[1]}; it was recorded by tasklift {store.release}: use that"
            )
