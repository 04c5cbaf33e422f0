"""The same experiment on a user's own building: policy files to take away, and the verdict."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from tasklift import stats
from tasklift.building.graph import Building
from tasklift.building.reading import PRESETS
from tasklift.building.team import SCOUT, WEAPON
from tasklift.lab import FILE_NAME, Cell, Progress, Store, run
from tasklift.lab.runs import export
from tasklift.plans.read import load_building
from tasklift.report.page import Report
from tasklift.studies import report
from tasklift.studies.arms import ARMS
from tasklift.studies.paper import figures
from tasklift.studies.paper.claims import Sample, all_samples
from tasklift.studies.study import Study

TRAINED = ("random", "expert", "direct", "copy", "prior", "copy+prior")


def train(
    *,
    building: Path,
    team: tuple[int, int] = (10, 5),
    hostiles: int = 1,
    weapons_needed: int = 2,
    limit: int = 600,
    preset: str = "scattered",
    seeds: int = 5,
    trials: int = 100,
    out: Path | None = None,
    engine: str = "threads",
    workers: int | None = None,
    address: str | None = None,
    progress: Progress | None = None,
) -> tuple[list[str], Path]:
    """Train the arms on one building.

    Parameters
    ----------
    building
        File of the building.
    team
        Numbers of scouts and weapon robots.
    out
        Folder; default ``runs/`` and the building's file name.
    hostiles, weapons_needed, limit, preset, seeds, trials, engine, workers, address, progress
        As on the command line.

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
    study = Study(
        {building.stem: place},
        {preset: PRESETS[preset]},
        TRAINED,
        seeds=seeds,
        trials=trials,
        team={SCOUT: team[0], WEAPON: team[1]},
        hostiles=hostiles,
        weapons_needed=weapons_needed,
        limit=limit,
    )
    folder = report.prepare_folder(out if out is not None else Path("runs") / building.stem)
    with Store.open(folder / FILE_NAME, study.spec(f"training on {building.name}")) as store:
        run(
            store,
            study.cells(),
            study.work,
            engine=engine,
            workers=workers,
            address=address,
            progress=progress,
        )
        samples = all_samples(store, preset)
        export(folder, folder / "rows.csv")
        report.save_policies(study, folder / "policies", preset, building.stem)
        best = recommended(samples)
        study.learned(Cell(reading=preset, map=building.stem, seed=0, arm=best)).save(folder / "policy.json")
        place.save(folder / "building.json")
        lines = verdict_lines(samples, best, folder)
        command = (
            f"tasklift train {building} --team {team[0]}+{team[1]} --hostiles {hostiles} "
            f"--weapons-needed {weapons_needed} --limit {limit} --preset {preset} --seeds {seeds} --trials {trials} "
            f"--out {folder}"
        )
        path = folder / "report.html"
        _report(place, store, samples, preset, lines, command, folder).write(path)
    return lines, path


def recommended(samples: dict[str, Sample]) -> str:
    """Return the learning arm whose policy, used greedily, loses the fewest robots; of equals the fastest."""
    learning = [name for name in samples if ARMS[name].learns]
    return min(
        learning,
        key=lambda name: (
            round(float(samples[name].greedy_losses.mean()), 1),
            samples[name].greedy_steps.mean(),
        ),
    )


def verdict_lines(samples: dict[str, Sample], best: str, folder: Path) -> list[str]:
    """Say what the transfer brought on this building, and which policy to take."""
    lines = []
    direct = samples["direct"]
    for name in ("copy", "copy+prior"):
        sample = samples[name]
        lost = stats.paired_difference(sample.losses.mean(axis=1), direct.losses.mean(axis=1))
        steps = stats.paired_difference(sample.steps.mean(axis=1), direct.steps.mean(axis=1))
        lines.append(
            f"{name} against direct while learning: robots lost a trial {sample.losses.mean():.1f} against "
            f"{direct.losses.mean():.1f} (difference {lost}), steps {sample.steps.mean():.0f} against "
            f"{direct.steps.mean():.0f} (difference {steps})"
        )
    sample = samples[best]
    lines.append(
        f"policy to take: {folder / 'policy.json'} (arm {best}; greedily {sample.greedy_steps.mean():.0f} steps and "
        f"{sample.greedy_losses.mean():.1f} robots lost a trial)"
    )
    if float(np.mean([s.success.mean() for s in samples.values()])) < 0.1:
        lines.append(
            f"hardly any trial was solved within {direct.limit} steps: give --limit a larger number or the team more "
            "weapon robots (every door where one waits alone needs another)"
        )
    return lines


def _report(
    place: Building,
    store: Store,
    samples: dict[str, Sample],
    preset: str,
    lines: list[str],
    command: str,
    folder: Path,
) -> Report:
    page = Report(f"Training on {place.name}")
    page.verdict(*lines)
    (folder / "figures").mkdir(exist_ok=True)
    picture, _ = figures.save(figures.figure1(place), folder / "figures", "building")
    page.figure(picture, "The building as a plan and as its graph.")
    page.section("The arms")
    page.table(["arm", "what it is"], [[name, ARMS[name].meaning] for name in samples])
    page.table(*report.arm_table(samples), caption=f"Preset **{preset}**")
    page.section("Learning curves")
    report.add_curves(page, samples, preset)
    page.section("Stop or move, by the feature faced")
    for arm in ("copy", "copy+prior"):
        report.add_move_weights(page, samples[arm], arm)
    page.section("The ledger: what was spent and lost, by stage")
    page.table(report.LEDGER_HEADERS, report.ledger_rows(store, preset), caption="Per seed")
    report.add_settings(page, store, command)
    return page
