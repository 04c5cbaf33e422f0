"""The paper's experiment from one call: train all arms, judge the claims, draw the figures, write the report."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from tasklift.building.graph import INTERSECTION, Building
from tasklift.building.reading import PRESETS
from tasklift.building.search import hostile_candidates
from tasklift.errors import TaskliftError
from tasklift.files import output_folder
from tasklift.lab import FILE_NAME, Progress, Store, run
from tasklift.lab.runs import export
from tasklift.report import pictures
from tasklift.report.page import Report
from tasklift.studies import report
from tasklift.studies.arms import ARMS, PAPER, PRACTICE, SEARCHED, arms_named
from tasklift.studies.claims import CLAIMS, Finding, after_holm, evaluate, indirect
from tasklift.studies.paper import best, figures
from tasklift.studies.paper import survey as surveys_of
from tasklift.studies.paper.survey import Survey
from tasklift.studies.samples import Sample
from tasklift.studies.study import GREEDY_TRIALS, Part, Study, generated, numbered

#: The seed of the first map on which nothing is learned; a study's own maps begin at 0.
FIRST_UNSEEN = 5000
#: A larger study leaves its rows in the store (`tasklift runs export` writes them): a text file would take gigabytes.
MOST_CELLS_EXPORTED = 4000

USUAL = tuple(arm.slug for arm in PAPER)

Samples = Mapping[str, Mapping[str, Sample]]


def study(*, maps: int, seeds: int, trials: int, arms: Sequence[str], survey: int, practice: int = PRACTICE) -> Study:
    """Return the paper's experiment: arms × presets × maps × seeds, one search per map, V alone on the survey's maps.

    Parameters
    ----------
    maps, seeds, trials, arms, survey, practice
        As in :func:`reproduce`.

    Raises
    ------
    TaskliftError
        For numbers below 1, unknown arms, or arms without the ones that they are judged against.
    """
    seen, numbers = numbered(maps, "maps"), tuple(numbered(seeds, "seeds"))
    judged = [arm for arm in arms_named(arms) if arm.against]
    if not judged:
        raise TaskliftError("arms: the claims are about indirect learning, and no such arm is named; add copy")
    for arm in judged:
        if arm.against[0] not in arms:
            raise TaskliftError(f"arms: {arm.slug!r} is judged against {arm.against[0]!r}; name that as well")
    own, surveyed = generated(seen), surveys_of.surveyed(survey)
    return Study(
        own | surveyed,
        surveys_of.conditions(),
        (
            Part(tuple(arms), tuple(PRESETS), tuple(own), numbers),
            best.part(list(own)),
            *surveys_of.parts(list(surveyed)),
        ),
        trials=trials,
        practice=practice,
        unseen=generated(numbered(maps, "maps", FIRST_UNSEEN)),
    )


def reproduce(
    *,
    out: Path,
    maps: int = 6,
    seeds: int = 5,
    trials: int = 100,
    arms: Sequence[str] = USUAL,
    survey: int = 60,
    practice: int = PRACTICE,
    command: str = "",
    progress: Progress | None = None,
    **engine: Any,
) -> Path:
    """Run the whole experiment; return the path of ``report.html``.

    Parameters
    ----------
    out
        Folder; one that holds this very experiment is resumed, any other content is refused.
    maps, seeds, trials
        Generated buildings, seeds on each, trials on the full task. Policies are also tried on as many other maps.
    arms
        Slugs; at least one indirect arm such as ``copy``, and the arm that each is judged against.
    survey
        Generated buildings for Figure 3 (claims C1, C2).
    practice
        Safe episodes of the search, once per map and preset, that shows how good a policy can be (claim C11).
    command
        The line that runs this again, for the report.
    progress, engine
        As in :func:`tasklift.lab.run`; also its ``workers`` and ``address``.

    Raises
    ------
    TaskliftError
        Before anything is trained or overwritten.
    """
    plan = study(maps=maps, seeds=seeds, trials=trials, arms=arms, survey=survey, practice=practice)
    first = plan.parts[0]
    folder = output_folder(out, (FILE_NAME,), ("figures", "policies"))
    with Store.open(folder / FILE_NAME, plan.spec("the paper's experiment")) as store:
        run(store, plan.cells(), plan.work, progress=progress, **engine)
        more = surveys_of.further(plan, surveys_of.read(store, plan))
        run(store, [*plan.cells(), *more], plan.work, progress=progress, **engine)
        surveys = surveys_of.read(store, plan)
        say = progress or (lambda done, total, note: None)
        say(0, 4, "judging the claims")
        asked = set(plan.cells())
        samples = {
            name: {slug: Sample.of(store, slug, among=asked, reading=name).last(trials) for slug in arms}
            for name in PRESETS
        }
        known = {
            name: samples[name] | {SEARCHED.slug: best.searched(plan, store, name, first.maps, first.seeds)}
            for name in PRESETS
        }
        findings = after_holm(
            [f for name in PRESETS for f in evaluate(known[name], name, coverage=surveys[name].coverage)]
        )
        excess = [row for name in PRESETS for row in best.excess(plan, name, known[name])]
        say(1, 4, "writing rows and policies")
        if len(plan.cells()) <= MOST_CELLS_EXPORTED:
            export(folder, folder / "rows.csv")
        report.write_claims(findings, folder / "claims.csv")
        for name in PRESETS:
            report.save_policies(plan, folder / "policies", name, first.maps[0])
            found = best.policy(plan, store, name, first.maps[0])
            found.save(folder / "policies" / f"{name}-{SEARCHED.slug}.json")
        say(2, 4, "drawing the figures")
        drawn = _draw(folder / "figures", plan.buildings[first.maps[0]], samples, surveys["scattered"])
        say(3, 4, "writing the report")
        path = folder / "report.html"
        report.write_summary(folder / "summary.md", samples, findings, (best.HEADERS, excess), command)
        _report(plan, store, samples, surveys, findings, excess, drawn, command).write(path)
        say(4, 4, "done")
    return path


def _draw(folder: Path, building: Building, samples: Samples, survey: Survey) -> dict[str, Path]:
    node, goal = crossing(building)
    drawn = {
        "figure1": figures.figure1(building),
        "figure2": figures.figure2(building, node, goal),
        "figure3": figures.figure3(survey),
    }
    for condition, of in samples.items():
        drawn[f"figure4-{condition}"] = figures.figure4(of)
        for arm in indirect(of):
            weights = of[arm].move_weights
            assert weights is not None
            drawn[f"figure5-{condition}-{arm}"] = figures.figure5(weights.mean(axis=0))
    return {name: pictures.save(figure, folder, name)[0] for name, figure in drawn.items()}


def crossing(building: Building) -> tuple[int, int]:
    """Return the busiest intersection, and a goal far from it: where Figure 2 looks."""
    degree = np.where(building.kind == INTERSECTION, np.diff(building.indptr), 0)
    node = int(degree.argmax())
    doors = hostile_candidates(building)
    distance = np.linalg.norm(building.position_m[doors] - building.position_m[node], axis=1)
    return node, int(doors[int(distance.argmax())])


def verdict_lines(samples: Samples, findings: Sequence[Finding]) -> list[str]:
    """Say in words and numbers what came out, per preset and indirect arm."""
    lines = []
    for condition, arms in samples.items():
        for arm in indirect(arms):
            about = report.about(findings, condition, arm)
            reference = arms[ARMS[arm].against[0]]
            lost, time = (next(f for f in about if f.claim == claim) for claim in ("C6", "C4"))
            verdicts = dict.fromkeys(("holds", "does not hold", "undecided", *(f.found.says for f in about)))
            tally = "; ".join(
                f"{verdict}: {', '.join(f.claim for f in about if f.found.says == verdict) or 'none'}"
                for verdict in verdicts
            )
            lines.append(
                f"**{condition}, {ARMS[arm].label} against {ARMS[ARMS[arm].against[0]].label}.** Robots lost a trial: "
                f"{arms[arm].losses.mean():.1f} against {reference.losses.mean():.1f} of {reference.n_robots} "
                f"(difference {lost.interval}). Steps of the last 20 trials: {arms[arm].steps[:, -20:].mean():.0f} "
                f"against {reference.steps[:, -20:].mean():.0f} (difference {time.interval}). Claims of the paper: "
                f"{tally}."
            )
    return lines


def _report(
    plan: Study,
    store: Store,
    samples: Samples,
    surveys: Mapping[str, Survey],
    findings: Sequence[Finding],
    excess: Sequence[Sequence[Any]],
    drawn: Mapping[str, Path],
    command: str,
) -> Report:
    first = plan.parts[0]
    page = Report("Transfer of learning for complex task domains: a reproduction")
    page.paragraph(
        "Singh & Adams (ICRA 2006) let 10 scouts and 5 weapon robots learn to search an unknown building first "
        "without hostile agents (task V), copied what was learned to the full task T, and went on learning there. "
        f"Here: {len(first.maps)} generated buildings × {len(first.seeds)} seeds × {len(first.arms)} arms × "
        f"{len(first.conditions)} readings of what the paper leaves open, {plan.trials} trials on T each."
    )
    page.verdict(*verdict_lines(samples, findings))
    report.add_arms(page, first.arms)
    for condition, arms in samples.items():
        page.table(*report.arm_table(arms), caption=f"Preset **{condition}**, means over all cells")
    page.section("How good could a policy be?")
    page.paragraph(
        "No policy can be faster than a bound that follows from the building: the farthest corridor and room must be "
        "reached, and somebody must travel all corridors. *Searched in drills* is the policy of one search per map, "
        "in practice with a hostile at every door. *Expert* is written by hand."
    )
    page.table(best.HEADERS, excess, caption=f"The policies that arms end with, in {GREEDY_TRIALS} further trials per "
               "map and seed: always the heaviest output, but as drawn for expert and searched")  # fmt: skip
    page.section("The claims")
    page.paragraph(
        "Intervals are 95 %, one by one, the spread measured within maps (C1 and C2: t intervals for all maps "
        "together, C2 at 90 % as in two one-sided tests). A verdict follows from its p-value, which is for the whole "
        "table together (Holm): *holds* and *does not hold* at 5 %. With fewer seeds than that takes, it is *too few "
        "seeds*."
    )
    page.table(
        *report.glance(findings, list(samples), first.arms),
        caption="The claims at a glance: each indirect arm against plain direct learning",
    )
    page.table(["claim", "how it is measured here"], [[name, claim.measure] for name, claim in CLAIMS.items()])
    page.table(
        report.FINDING_HEADERS,
        report.finding_rows(findings),
        caption="The measures behind the verdicts, also against the controls `direct+budget` and `prior`",
    )
    _pictures(page, samples, surveys, drawn)
    page.section("The ledger: what was spent and lost, by stage")
    for condition, arms in samples.items():
        page.table(report.LEDGER_HEADERS, report.ledger_rows(arms),
                   caption=f"Preset **{condition}**, per map and seed")  # fmt: skip
    report.add_settings(page, store, command)
    return page


def _pictures(page: Report, samples: Samples, surveys: Mapping[str, Survey], drawn: Mapping[str, Path]) -> None:
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
    for condition, survey in surveys.items():
        page.paragraph(f"**{condition}.** {survey.in_words()}")
        page.table(["property of a map", "rank correlation with the slope", "p (Holm)"], survey.explain())
    page.section("Figure 4: direct and indirect learning")
    for condition, arms in samples.items():
        report.add_curves(page, arms, condition)
        page.figure(drawn[f"figure4-{condition}"], f"Preset {condition}; below, one single run like the paper's.")
    page.section("Figure 5: stop or move, by the feature faced")
    for condition, arms in samples.items():
        page.paragraph(f"Preset **{condition}**; feature 1 is none, 4 is the enemy feature.")
        for arm in indirect(arms):
            report.add_move_weights(page, arms[arm], ARMS[arm].label)
        first = indirect(arms)[0]
        page.figure(drawn[f"figure5-{condition}-{first}"], f"Arm {ARMS[first].label}, {condition}, as in the paper.")
