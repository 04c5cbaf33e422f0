"""The same experiment on a user's own building: policy files to take away, and the verdict."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from tasklift import stats
from tasklift.building.graph import Building
from tasklift.building.reading import PRESETS
from tasklift.checks import one_of
from tasklift.errors import TaskliftError
from tasklift.files import output_folder
from tasklift.lab import FILE_NAME, Progress, Store, run
from tasklift.lab.runs import export
from tasklift.plans.read import load_building
from tasklift.report import pictures
from tasklift.report.page import Report
from tasklift.studies import report
from tasklift.studies.arms import ARMS
from tasklift.studies.claims import indirect
from tasklift.studies.paper import figures
from tasklift.studies.samples import Sample
from tasklift.studies.study import Condition, Study

TRAINED = ("random", "expert", "direct", "copy", "prior", "copy-prior")


def train(
    *,
    building: Path,
    team: str = "10+5",
    hostiles: int = 1,
    weapons_needed: int = 2,
    limit: int = 600,
    preset: str = "scattered",
    arms: Sequence[str] = TRAINED,
    seeds: int = 5,
    trials: int = 100,
    out: Path | None = None,
    command: str = "",
    progress: Progress | None = None,
    **engine: Any,
) -> tuple[list[str], Path]:
    """Train arms on one building.

    Parameters
    ----------
    building
        File of the building.
    team, hostiles, weapons_needed, limit
        As in :class:`tasklift.building.Mission`.
    preset
        ``scattered`` or ``cohesive``.
    arms
        Slugs; at least one that learns.
    seeds, trials
        How many; trials on T, for arms that do not say otherwise.
    out
        Folder; default ``runs/`` and the building's file name.
    command
        The line that runs this again, for the report.
    progress, engine
        As in :func:`tasklift.lab.run`; also its ``workers`` and ``address``.

    Returns
    -------
    (list of str, Path)
        The verdict in a few lines, and the path of ``report.html``.

    Raises
    ------
    TaskliftError
        Before anything is trained or overwritten.
    """
    place = load_building(building)
    rules = PRESETS[one_of(preset, list(PRESETS), "preset")]
    study = Study.every(
        {building.stem: place},
        {preset: Condition(rules, hostiles=hostiles)},
        arms,
        seeds=seeds,
        trials=trials,
        team=team,
        weapons_needed=weapons_needed,
        limit=limit,
    )
    if not any(study.arms[slug].learns for slug in arms):
        raise TaskliftError("arms: none of those named learns; add direct or copy-prior")
    folder = output_folder(out if out is not None else Path("runs") / building.stem, (FILE_NAME,))
    with Store.open(folder / FILE_NAME, study.spec(f"training on {building.name}")) as store:
        run(store, study.cells(), study.work, progress=progress, **engine)
        samples = {slug: Sample.of(store, slug, reading=preset) for slug in arms}
        export(folder, folder / "rows.csv")
        report.save_policies(study, folder / "policies", preset, building.stem)
        best = recommended(samples)
        study.train(study.cell(preset, building.stem, 0, best)).policy.save(folder / "policy.json")
        place.save(folder / "building.json")
        lines = verdict_lines(samples, best, folder)
        path = folder / "report.html"
        _report(place, store, samples, preset, lines, command, folder).write(path)
    return lines, path


def recommended(samples: Mapping[str, Sample]) -> str:
    """Return the learning arm whose policy, used greedily, loses the fewest robots; of equals the fastest."""
    return min(
        (slug for slug in samples if ARMS[slug].learns),
        key=lambda slug: (
            round(float(samples[slug].greedy_losses.mean()), 1),
            samples[slug].greedy_steps.mean(),
        ),
    )


def verdict_lines(samples: Mapping[str, Sample], best: str, folder: Path) -> list[str]:
    """Say what the transfer brought on this building, and which policy to take."""
    lines = []
    for arm in indirect(samples):
        reference = next((slug for slug in ARMS[arm].against if slug in samples), None)
        if reference is None:
            continue
        a, b = samples[arm], samples[reference]
        lost = stats.paired_difference(a.losses.mean(axis=1), b.losses.mean(axis=1))
        steps = stats.paired_difference(a.steps.mean(axis=1), b.steps.mean(axis=1))
        lines.append(
            f"{ARMS[arm].label} against {ARMS[reference].label} while learning: robots lost a trial "
            f"{a.losses.mean():.1f} against {b.losses.mean():.1f} (difference {lost}), steps {a.steps.mean():.0f} "
            f"against {b.steps.mean():.0f} (difference {steps})"
        )
    sample = samples[best]
    lines.append(
        f"policy to take: {folder / 'policy.json'} (arm {ARMS[best].label}; greedily "
        f"{sample.greedy_steps.mean():.0f} steps and {sample.greedy_losses.mean():.1f} robots lost a trial)"
    )
    if float(np.mean([s.success.mean() for s in samples.values()])) < 0.1:
        lines.append(
            f"hardly any trial was solved within {sample.limit} steps: give --limit a larger number or the team more "
            "weapon robots (every door where one waits alone needs another)"
        )
    return lines


def _report(
    place: Building,
    store: Store,
    samples: Mapping[str, Sample],
    preset: str,
    lines: Sequence[str],
    command: str,
    folder: Path,
) -> Report:
    page = Report(f"Training on {place.name}")
    page.verdict(*lines)
    (folder / "figures").mkdir(exist_ok=True)
    picture, _ = pictures.save(figures.figure1(place), folder / "figures", "building")
    page.figure(picture, "The building as a plan and as its graph.")
    report.add_arms(page, samples)
    page.table(*report.arm_table(samples), caption=f"Preset **{preset}**")
    page.section("Learning curves")
    report.add_curves(page, samples, preset)
    page.section("Stop or move, by the feature faced")
    for arm in indirect(samples):
        report.add_move_weights(page, samples[arm], ARMS[arm].label)
    page.section("The ledger: what was spent and lost, by stage")
    page.table(report.LEDGER_HEADERS, report.ledger_rows(samples), caption="Per seed")
    report.add_settings(page, store, command)
    return page
