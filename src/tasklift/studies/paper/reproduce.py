"""The paper's experiment from one call: train all arms, judge the claims, draw the figures, write the report."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np

from tasklift.building.generate import generate
from tasklift.building.graph import INTERSECTION, Building
from tasklift.building.reading import PRESETS
from tasklift.building.search import hostile_candidates
from tasklift.errors import TaskliftError
from tasklift.lab import FILE_NAME, Progress, Store, run
from tasklift.lab.runs import export
from tasklift.report.page import Report
from tasklift.studies import report
from tasklift.studies.arms import ARMS
from tasklift.studies.paper import figures
from tasklift.studies.paper.claims import CLAIMS, Finding, Sample, all_samples, evaluate
from tasklift.studies.paper.survey import Survey, survey
from tasklift.studies.study import Study

#: The seed of the first map on which nothing is learned; a study's own maps begin at 0.
FIRST_UNSEEN = 5000
#: A larger study leaves its rows in the store (`tasklift runs export` writes them): a text file would take gigabytes.
MOST_CELLS_EXPORTED = 2000


def reproduce(
    *,
    out: Path,
    maps: int = 6,
    seeds: int = 5,
    trials: int = 100,
    arms: tuple[str, ...] = tuple(ARMS),
    survey: int = 60,
    engine: str = "threads",
    workers: int | None = None,
    address: str | None = None,
    progress: Progress | None = None,
) -> Path:
    """Run the whole experiment; return the path of ``report.html``.

    Parameters
    ----------
    out
        Folder; one that holds this very experiment is resumed, any other content is refused.
    maps, seeds, trials
        Generated buildings, seeds on each, trials on the full task. Policies are also tried on as many other maps.
    arms
        Names of :data:`tasklift.studies.arms.ARMS`; ``direct``, ``copy`` and ``copy+prior`` are needed.
    survey
        Generated buildings for Figure 3 (claims C1, C2).
    engine, workers, address
        As in :func:`tasklift.lab.run`.
    progress
        ``progress(done, total, note)``.

    Raises
    ------
    TaskliftError
        Before anything is overwritten.
    """
    study = Study(
        {f"map {i}": generate(seed=i) for i in range(maps)},
        PRESETS,
        arms,
        seeds=seeds,
        trials=trials,
        unseen={f"unseen {i}": generate(seed=FIRST_UNSEEN + i) for i in range(maps)},
    )
    for name in ("direct", *report.GLANCED):
        if name not in arms:
            raise TaskliftError(f"arms: the claims need {name!r}; found {'; '.join(arms)}")
    folder = report.prepare_folder(out)
    with Store.open(folder / FILE_NAME, study.spec("the paper's experiment")) as store:
        run(
            store,
            study.cells(),
            study.work,
            engine=engine,
            workers=workers,
            address=address,
            progress=progress,
        )
        say = progress or (lambda done, total, note: None)
        surveys = {name: _survey(survey, name, study, workers, progress) for name in PRESETS}
        say(0, 4, "judging the claims")
        samples = {name: all_samples(store, name) for name in PRESETS}
        findings = [f for name in PRESETS for f in [*surveyed(surveys[name], name), *evaluate(samples[name], name)]]
        say(1, 4, "writing rows and policies")
        if len(study.cells()) <= MOST_CELLS_EXPORTED:
            export(folder, folder / "rows.csv")
        report.write_claims(findings, folder / "claims.csv")
        for name in PRESETS:
            report.save_policies(study, folder / "policies", name, "map 0")
        say(2, 4, "drawing the figures")
        drawn = _draw(folder / "figures", study, store, samples, surveys["scattered"])
        say(3, 4, "writing the report")
        command = f"tasklift reproduce --maps {maps} --seeds {seeds} --trials {trials} --survey {survey} --out {out}"
        command += "" if arms == tuple(ARMS) else f" --arms '{';'.join(arms)}'"
        path = folder / "report.html"
        report.write_summary(folder / "summary.md", samples, findings, command)
        _report(study, store, samples, surveys, findings, drawn, command).write(path)
        say(4, 4, "done")
    return path


def _survey(maps: int, reading: str, study: Study, workers: int | None, progress: Progress | None) -> Survey:
    return survey(
        maps=maps,
        repeats=study.repeats,
        reading=PRESETS[reading],
        team=study.team,
        progress=None if progress is None else lambda done, total: progress(done, total, f"survey of V, {reading}"),
        workers=workers,
    )


def surveyed(maps: Survey, reading: str) -> list[Finding]:
    """Judge C1 and C2 on the two maps that the survey chose on half of its seeds, with the other half."""
    steep, level = maps.choose()
    names = [maps.maps[place].building.name for place in (steep, level)]
    return [
        Finding("C1", reading, names[0], maps.slope_interval(steep), "below 0", maps.trend(steep)),
        Finding("C2", reading, names[1], maps.slope_interval(level, confidence=0.9),
                f"within ±{maps.margin(level):.2g}", maps.no_trend(level), note="90 % interval"),
    ]  # fmt: skip


def _draw(
    folder: Path, study: Study, store: Store, samples: dict[str, dict[str, Sample]], maps: Survey
) -> dict[str, Path]:
    folder.mkdir(exist_ok=True)
    first = next(iter(study.buildings.values()))
    node, goal = crossing(first)
    drawn = {
        "figure1": figures.figure1(first),
        "figure2": figures.figure2(first, node, goal),
        "figure3": figures.figure3(maps, *maps.choose()),
    }
    for reading, arms in samples.items():
        drawn[f"figure4-{reading}"] = figures.figure4(store, reading, report.DRAWN)
        for arm in ("copy", "copy+prior"):
            drawn[f"figure5-{reading}-{arm}"] = figures.figure5(arms[arm].move_weights.mean(axis=0))
    return {name: figures.save(figure, folder, name)[0] for name, figure in drawn.items()}


def crossing(building: Building) -> tuple[int, int]:
    """Return the busiest intersection, and a goal far from it: where Figure 2 looks."""
    degree = np.where(building.kind == INTERSECTION, np.diff(building.indptr), 0)
    node = int(degree.argmax())
    doors = hostile_candidates(building)
    distance = np.linalg.norm(building.position_m[doors] - building.position_m[node], axis=1)
    return node, int(doors[int(distance.argmax())])


def verdict_lines(samples: dict[str, dict[str, Sample]], findings: Sequence[Finding]) -> list[str]:
    """Say in words and numbers what came out, per preset and indirect arm."""
    lines = []
    for reading, arms in samples.items():
        direct = arms["direct"]
        for arm in report.GLANCED:
            about = [f for f in findings if f.reading == reading and f.contrast in (arm, f"{arm} − direct")]
            about += [f for f in findings if f.reading == reading and f.claim in ("C10", "C11") and f not in about
                      and f.contrast.split(" − ")[0] == arm]  # fmt: skip
            lost = next(f for f in about if f.claim == "C6")
            time = next(f for f in about if f.claim == "C4")
            tally = "; ".join(
                f"{verdict}: {', '.join(f.claim for f in about if f.verdict == verdict) or 'none'}"
                for verdict in ("holds", "does not hold", "undecided")
            )
            lines.append(
                f"**{reading}, {arm} against direct.** Robots lost a trial: {arms[arm].losses.mean():.1f} against "
                f"{direct.losses.mean():.1f} of {direct.n_robots} (difference {lost.interval}). Steps of the last 20 "
                f"trials: {arms[arm].steps[:, -20:].mean():.0f} against {direct.steps[:, -20:].mean():.0f} "
                f"(difference {time.interval}). Claims of the paper: {tally}."
            )
    return lines


def _report(
    study: Study,
    store: Store,
    samples: dict[str, dict[str, Sample]],
    surveys: dict[str, Survey],
    findings: Sequence[Finding],
    drawn: dict[str, Path],
    command: str,
) -> Report:
    page = Report("Transfer of learning for complex task domains: a reproduction")
    page.paragraph(
        "Singh & Adams (ICRA 2006) let 10 scouts and 5 weapon robots learn to search an unknown building first "
        "without hostile agents (task V), copied what was learned to the full task T, and went on learning there. "
        f"Here: {len(study.buildings)} generated buildings × {study.seeds} seeds × {len(study.arms)} arms × "
        f"{len(study.readings)} readings of what the paper leaves open, {study.trials} trials on T each."
    )
    page.verdict(*verdict_lines(samples, findings))
    page.section("The arms")
    page.table(["arm", "what it is"], [[name, ARMS[name].meaning] for name in study.arms])
    for reading, arms in samples.items():
        page.table(*report.arm_table(arms), caption=f"Preset **{reading}**, means over all cells")
    page.section("The claims")
    page.paragraph(
        "Intervals are 95 % (BCa bootstrap over seeds within maps; C2: 90 %, two one-sided tests). A verdict follows "
        "from its interval alone; p-values are of sign-flip tests, adjusted for the whole table after Holm."
    )
    columns = [f"{reading}, {arm}" for reading in samples for arm in report.GLANCED]
    page.table(
        ["claim", "the paper", "where", *columns],
        report.glance_rows(findings, list(samples)),
        caption="The claims at a glance: each indirect arm against plain direct learning",
    )
    page.table(["claim", "how it is measured here"], [[name, claim.measure] for name, claim in CLAIMS.items()])
    page.table(
        report.FINDING_HEADERS,
        report.finding_rows(findings),
        caption="The measures behind the verdicts, also against the controls `direct+budget` and `prior`",
    )
    page.section("Figure 1: a building as a plan and as its graph")
    page.figure(drawn["figure1"], "Dark: intersections, white: rooms, grey: features; the start is at the bottom.")
    page.section("Figure 2: covered area and goal at an intersection")
    page.figure(drawn["figure2"], "Drawn by the code that computes the shares.")
    page.section("Figure 3: the coverage coefficient after V")
    page.figure(
        drawn["figure3"],
        f"Two of {len(surveys['scattered'].maps)} surveyed maps, chosen by their slope on the even seeds; the weights "
        "shown are those of the odd seeds.",
    )
    for reading, maps in surveys.items():
        page.paragraph(f"**{reading}.** {maps.in_words()}")
        page.table(["property of a map", "rank correlation with the slope", "p (Holm)"], maps.explain())
    page.section("Figure 4: direct and indirect learning")
    for reading, arms in samples.items():
        report.add_curves(page, arms, reading)
        page.figure(drawn[f"figure4-{reading}"], f"Preset {reading}; below, one single run like the paper's.")
    page.section("Figure 5: stop or move, by the feature faced")
    for reading, arms in samples.items():
        page.paragraph(f"Preset **{reading}**; feature 1 is none, 4 is the enemy feature.")
        for arm in ("copy", "copy+prior"):
            report.add_move_weights(page, arms[arm], arm)
        page.figure(drawn[f"figure5-{reading}-copy"], f"Arm copy, {reading}, as in the paper.")
    page.section("The ledger: what was spent and lost, by stage")
    for reading in samples:
        page.table(
            report.LEDGER_HEADERS,
            report.ledger_rows(store, reading),
            caption=f"Preset **{reading}**, per map and seed",
        )
    report.add_settings(page, store, command)
    return page
