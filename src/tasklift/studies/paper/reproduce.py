"""The paper's experiment from one call: train all arms, judge the claims, draw the figures, write the report."""

from __future__ import annotations

import time
from collections.abc import Mapping, Sequence
from contextlib import nullcontext
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
from tasklift.report.charts import Row
from tasklift.report.page import Link, Number, Report
from tasklift.studies import report
from tasklift.studies.arms import ARMS, PAPER, PRACTICE, SEARCHED, arms_named
from tasklift.studies.claims import CLAIMS, Finding, after_holm, evaluate, indirect
from tasklift.studies.paper import best, figures
from tasklift.studies.paper import survey as surveys_of
from tasklift.studies.paper.survey import Survey
from tasklift.studies.report import Play
from tasklift.studies.samples import Sample
from tasklift.studies.study import GREEDY_TRIALS, Part, Study, generated, numbered

#: The seed of the first map on which nothing is learned; a study's own maps begin at 0.
FIRST_UNSEEN = 5000
#: A larger study leaves its rows in the store (`tasklift runs export` writes them): a text file would take gigabytes.
MOST_CELLS_EXPORTED = 4000

USUAL = tuple(arm.slug for arm in PAPER)

Samples = Mapping[str, Mapping[str, Sample]]
#: By preset and slug.
Links = Mapping[tuple[str, str], Link | None]


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
    play: Play | None = None,
    **engine: Any,
) -> tuple[list[str], Path]:
    """Run the experiment; return the result in a few lines, and the path of ``report.html``.

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
    play
        Writes replays beside the report, which its tables link to; None: there are none.

    Raises
    ------
    TaskliftError
        Before anything is trained or overwritten.
    """
    since = time.monotonic()
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
        page = _report(plan, samples, surveys, findings, excess, drawn, _replays(plan, folder, play))
        report.add_settings(page, store, command, since)
        page.write(path)
        say(4, 4, "done")
    return verdict_lines(samples, findings), path


def _replays(plan: Study, folder: Path, play: Play | None) -> Links:
    """Write a replay per preset and method, on the first map with the first seed; return the links."""
    first = plan.parts[0]
    cells = {(c, arm): plan.cell(c, first.maps[0], first.seeds[0], arm) for c in first.conditions for arm in first.arms}
    links = report.add_replays(plan, folder, cells.values(), play)
    return {asked: links[cell] for asked, cell in cells.items()}


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
    return {name: pictures.save(figure, folder, name)[1] for name, figure in drawn.items()}


def crossing(building: Building) -> tuple[int, int]:
    """Return the busiest intersection, and a goal far from it: where Figure 2 looks."""
    degree = np.where(building.kind == INTERSECTION, np.diff(building.indptr), 0)
    node = int(degree.argmax())
    doors = hostile_candidates(building)
    distance = np.linalg.norm(building.position_m[doors] - building.position_m[node], axis=1)
    return node, int(doors[int(distance.argmax())])


# ---------------------------------------------------------------- the words


_LOSES = {"holds": "loses fewer robots", "does not hold": "loses more robots",
          "undecided": "shows no clear difference in robots lost", "too few": "is judged on too few seeds"}  # fmt: skip


def headline(samples: Samples, findings: Sequence[Finding]) -> str:
    """Say in one sentence whether each indirect arm loses fewer robots than learning from scratch."""
    said = []
    for arm in indirect(next(iter(samples.values()))):
        where: dict[str, list[str]] = {}
        for condition in samples:
            about = report.about(findings, condition, arm)
            where.setdefault(_LOSES[next(f for f in about if f.claim == "C6").verdict], []).append(condition)
        under = {words: "" if len(where) == 1 else f" under {' and '.join(names)}" for words, names in where.items()}
        said.append(f"{ARMS[arm].label} {', and '.join(f'**{words}**{under[words]}' for words in where)}")
    return f"Against learning from scratch (direct), transfer with {'; '.join(said)}."


def numbers(samples: Samples) -> list[Number]:
    """Return the robots lost per episode under the first preset: by learning from scratch, and by transfer."""
    condition, arms = next(iter(samples.items()))
    shown = [ARMS[indirect(arms)[0]].against[0], *indirect(arms)][:3]
    return [
        report.large(
            report.mean_of(arms[arm], arms[arm].losses.mean(axis=1)),
            f"of {arms[arm].n_robots} robots lost per episode: {ARMS[arm].label} ({condition})",
        )
        for arm in shown
    ]


def verdict_lines(samples: Samples, findings: Sequence[Finding]) -> list[str]:
    """Say in words and numbers what came out, for the terminal: a sentence, the numbers, the claims."""
    lines = [headline(samples, findings).replace("**", "")]
    lines += [f"{one.value} {one.interval} {one.label}" for one in numbers(samples)]
    for condition, arms in samples.items():
        for arm in indirect(arms):
            lines += [f"{ARMS[arm].label}, {condition}:", report.tally(report.about(findings, condition, arm))]
    return lines


# ---------------------------------------------------------------- the page


def _report(
    plan: Study,
    samples: Samples,
    surveys: Mapping[str, Survey],
    findings: Sequence[Finding],
    excess: Sequence[Sequence[Any]],
    drawn: Mapping[str, Path],
    links: Links,
) -> Report:
    first = plan.parts[0]
    page = Report("Transfer of learning for complex task domains: a reproduction")
    page.headline(headline(samples, findings), numbers(samples))
    report.too_few(page, [f.found for f in findings])
    for condition, arms in samples.items():
        page.rows(
            [_lost(arms[slug], slug) for slug in arms if ARMS[slug].drawn] or [_lost(arms[s], s) for s in arms],
            title=f"Robots lost per episode, preset {condition}", label="robots", beside=2,
        )  # fmt: skip
    page.section("The paper's claims")
    page.table(
        *report.glance(findings, list(samples), first.arms),
        caption="✓ holds, ✗ does not hold, – undecided, or too few runs to say. Transfer (copy, copy+prior) against "
        "learning from scratch (direct).",
    )
    with page.fold("How each claim is measured, with the numbers behind the verdicts"):
        _measures(page, findings)
    page.section("Learning on the full task T (Figure 4)")
    for k, (condition, arms) in enumerate(samples.items()):
        with page.fold(f"Preset {condition}") if k else nullcontext():
            report.add_curves(page, arms, condition, columns=("steps", "robots_left"))
    with page.fold("Teams left (Figure 4c)"):
        for condition, arms in samples.items():
            report.add_curves(page, arms, condition, columns=("teams_left",))
    for condition, arms in samples.items():
        headers, rows = report.arm_table(arms)
        rows = [[*row, links[condition, slug]] for row, slug in zip(rows, arms, strict=True)]
        with page.fold(f"All methods in numbers, and an episode of each to play: preset {condition}"):
            page.table([*headers, "play"], rows, caption=f"Preset **{condition}**, means over all cells")
    with page.fold("How good could a policy be?"):
        page.paragraph(
            "No policy can be faster than a bound that follows from the building: the farthest corridor and room must "
            "be reached, and somebody must travel all corridors. *Searched in drills* is the policy of one search per "
            "map, in practice with a hostile at every door. *Expert* is written by hand."
        )
        page.table(
            best.HEADERS, excess,
            caption=f"The policies that methods end with, in {GREEDY_TRIALS} further episodes per map and seed: always "
            "the heaviest output, but as drawn for expert and searched",
        )  # fmt: skip
    page.section("What was learned: stop or move, by the feature faced (Figure 5)")
    _weights(page, samples, drawn)
    page.section("More")
    _more(page, plan, samples, surveys, drawn)
    return page


def _lost(sample: Sample, slug: str) -> Row:
    found = report.mean_of(sample, sample.losses.mean(axis=1))
    return Row(ARMS[slug].label, [report.mark_of(found, slug)], f"{100 * sample.success.mean():.0f} % solved")


def _measures(page: Report, findings: Sequence[Finding]) -> None:
    page.paragraph(
        "Intervals are 95 %, one by one, the spread measured within maps. C1 and C2 have t intervals for all maps "
        "together (C2 at 90 %, as in two one-sided tests). A verdict follows from its p-value, which is for the full "
        "table together (Holm): *holds* and *does not hold* at 5 %. With fewer seeds than that takes, it is *too few "
        "seeds*."
    )
    page.table(
        ["claim", "in the paper", "how it is measured here"],
        [[name, claim.where, claim.measure] for name, claim in CLAIMS.items()],
    )
    page.table(
        report.FINDING_HEADERS,
        report.finding_rows(findings),
        caption="The measures behind the verdicts, also against the controls `direct+budget` and `prior`",
    )


def _weights(page: Report, samples: Samples, drawn: Mapping[str, Path]) -> None:
    """Add Figure 5: what the claims are about; folded, all of it, and once as in the paper."""
    first, arms = next(iter(samples.items()))
    page.paragraph(f"Mean weights at the end of learning, preset {first}; 95 % intervals.")
    for arm in indirect(arms):
        report.add_move_weights(page, arms[arm], ARMS[arm].label, brief=True)
    for condition, of in samples.items():
        with page.fold(f"All features, preset {condition}"):
            for arm in indirect(of):
                report.add_move_weights(page, of[arm], ARMS[arm].label)
    with page.fold("Figure 5 as the paper draws it"):
        shown = indirect(arms)[0]
        page.figure(drawn[f"figure5-{first}-{shown}"], f"{ARMS[shown].label}, {first}; the others are in `figures/`.")


def _more(
    page: Report, plan: Study, samples: Samples, surveys: Mapping[str, Survey], drawn: Mapping[str, Path]
) -> None:
    first = plan.parts[0]
    with page.fold("The experiment"):
        page.paragraph(
            "Singh & Adams (ICRA 2006) let 10 scouts and 5 weapon robots learn to search an unknown building first "
            "without hostile agents (the source task V). They copied what was learned to the full task T, and went on "
            f"learning there. Here: {len(first.maps)} generated buildings × {len(first.seeds)} seeds × "
            f"{len(first.arms)} methods (arms) × {len(first.conditions)} readings of what the paper leaves open, "
            f"{plan.trials} episodes (trials) on T each."
        )
    report.add_arms(page, first.arms)
    with page.fold("What was spent and lost, by stage"):
        for condition, arms in samples.items():
            page.table(report.LEDGER_HEADERS, report.ledger_rows(arms),
                       caption=f"Preset **{condition}**, per map and seed")  # fmt: skip
    with page.fold("Figure 1: a building as a plan and as its graph"):
        page.figure(drawn["figure1"], "Dark: intersections, white: rooms, grey: features; the start is at the bottom.")
    with page.fold("Figure 2: covered area and goal at an intersection"):
        page.figure(drawn["figure2"], "Drawn by the code that computes the shares.")
    with page.fold("Figure 3: the coverage coefficient after V"):
        page.figure(
            drawn["figure3"],
            f"Two of {len(surveys['scattered'].maps)} surveyed maps, chosen by their slope on the even seeds; the "
            "weights shown are those of the odd seeds.",
        )
        for condition, survey in surveys.items():
            page.paragraph(f"**{condition}.** {survey.in_words()}")
            page.table(["property of a map", "rank correlation with the slope", "p (Holm)"], survey.explain())
