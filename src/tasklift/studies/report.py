"""What studies leave behind: tables, policies, and the sections that their reports share."""

from __future__ import annotations

import csv
import io
import json
import math
from collections.abc import Callable, Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any

import tasklift
from tasklift import stats
from tasklift.files import output_folder, write_atomically
from tasklift.lab import FILE_NAME, Store
from tasklift.report.charts import Series
from tasklift.report.page import Report
from tasklift.studies.arms import ARMS, SEARCHED, Arm
from tasklift.studies.claims import CLAIMS, LAST, Finding, indirect
from tasklift.studies.samples import Sample
from tasklift.studies.study import Study

FEATURES = ("1 none", "2 bend", "3 corner", "4 door (enemy)", "5 other")
#: The classes of nWPN (Table I).
WEAPONS = ("no weapon robot", "1 to m − 1 weapon robots", "m or more weapon robots")


def save_policies(study: Study, folder: Path, condition: str, building: str) -> list[Path]:
    """Write what every learning arm of a study ends with on one building with seed 0; what is there already stays.

    Parameters
    ----------
    study
        Its arms are trained again, since stores keep no policies but those that were searched.
    folder
        Made if it is not there.
    condition, building
        Names in the study.
    """
    output_folder(folder)
    paths = []
    for slug in study.slugs(building):
        if study.arms[slug].learns and slug != SEARCHED.slug:
            paths.append(folder / f"{condition}-{slug}.json")
            if not paths[-1].exists():
                study.train(study.cell(condition, building, 0, slug)).policy.save(paths[-1])
    return paths


def write_csv(rows: Iterable[Sequence[Any]], path: Path) -> None:
    """Write rows as CSV."""
    text = io.StringIO()
    csv.writer(text, lineterminator="\n").writerows(rows)
    write_atomically(path, text.getvalue())


def markdown_table(headers: Sequence[str], rows: Sequence[Sequence[Any]], missing: str = "") -> str:
    """Return a table as Markdown."""
    lines = [headers, ["---"] * len(headers), *rows]
    return "".join(f"| {' | '.join(missing if x is None else str(x) for x in line)} |\n" for line in lines)


# ---------------------------------------------------------------- arms


def arm_table(samples: Mapping[str, Sample], arms: Mapping[str, Arm] = ARMS) -> tuple[list[str], list[list[Any]]]:
    """Return headers and one row per arm: steps early and late, losses, trials kept, out of time, greedy use."""
    columns: dict[str, Callable[[Sample], Any]] = {
        "steps, first 10 trials": lambda s: s.steps[:, :10].mean(),
        "steps, last 20": lambda s: s.steps[:, -LAST:].mean(),
        "robots lost a trial": lambda s: s.losses.mean(),
        "all kept (% of trials)": lambda s: s.kept_all.mean(),
        "out of time (%)": lambda s: 100 * (1 - s.success.mean()),
        "greedy: steps": lambda s: s.greedy_steps.mean(),
        "greedy: lost a trial": lambda s: s.greedy_losses.mean(),
    }
    if all(sample.unseen_steps.size for sample in samples.values()):
        columns["greedy on unseen maps: steps"] = lambda s: s.unseen_steps.mean()
        columns["greedy on unseen maps: lost a trial"] = lambda s: s.unseen_losses.mean()
    rows = [
        [arms[slug].label, *(round(float(of(sample)), 1) for of in columns.values())]
        for slug, sample in samples.items()
    ]
    return ["arm", *columns], rows


LEDGER_HEADERS = ("arm", "stage", "trials", "steps", "robots lost (drill: would be)", "per 1,000 steps")


def ledger_rows(samples: Mapping[str, Sample], arms: Mapping[str, Arm] = ARMS) -> list[list[Any]]:
    """Return losses and steps by arm and stage, per map and seed, the price of the source task included."""
    rows: list[list[Any]] = []
    for slug, sample in samples.items():
        for stage in ("source", "budget", "drill", "full-drill", "target"):
            if stage in sample.spent:
                trials, steps, losses = (float(value) for value in sample.spent[stage])
                per_1000 = round(1000 * losses / steps, 2)
                rows.append([arms[slug].label, stage, trials, round(steps), round(losses, 1), per_1000])
    return rows


def add_arms(report: Report, slugs: Iterable[str], arms: Mapping[str, Arm] = ARMS) -> None:
    """Add what the arms are."""
    report.section("The arms")
    report.table(["arm", "name in options and files", "what it is"],
                 [[arms[slug].label, f"`{slug}`", arms[slug].meaning] for slug in slugs])  # fmt: skip


# ---------------------------------------------------------------- findings


FINDING_HEADERS = ("claim", "preset", "contrast", "estimate [interval]", "holds if", "verdict", "p (Holm)", "note")


def write_claims(findings: Sequence[Finding], path: Path) -> None:
    """Write the findings as CSV, one per line."""
    rows: list[list[Any]] = [
        ["claim", "condition", "arm", "reference", "use", "measure", "estimate", "low", "high", "side", "bound",
         "verdict", "p_holm", "note"]
    ]  # fmt: skip
    for f in findings:
        ends = (x if math.isfinite(x) else None for x in (f.interval.estimate, f.interval.low, f.interval.high))
        p = None if math.isnan(f.found.p) else f.found.p
        rows.append(
            [f.claim, f.condition, f.arm, f.reference, f.use, CLAIMS[f.claim].measure, *ends, f.side, f.bound,
             f.found.says, p, f.note]
        )  # fmt: skip
    write_csv(rows, path)


def finding_rows(findings: Sequence[Finding], arms: Mapping[str, Arm] = ARMS) -> list[list[Any]]:
    """Return the measures behind the verdicts: one row per finding, in the order of the claims."""
    order, rows = list(CLAIMS), []
    for f in sorted(findings, key=lambda f: order.index(f.claim)):
        p = f.found.p
        chance = "" if math.isnan(p) else "< 0.001" if p < 0.001 else f"{p:.3f}"
        rows.append(
            [f.claim, f.condition, f.contrast(arms), str(f.interval), f.holds_if, f.found.says, chance, f.note]
        )
    return rows


def about(findings: Sequence[Finding], condition: str, arm: str, arms: Mapping[str, Arm] = ARMS) -> list[Finding]:
    """Return what was found under one condition about an indirect arm, against the first arm it is judged against."""
    return [
        f
        for f in findings
        if f.condition == condition
        and f.arm == arm
        and (CLAIMS[f.claim].of == "arm" or f.reference == arms[arm].against[0])
    ]


def glance(
    findings: Sequence[Finding], conditions: Sequence[str], slugs: Iterable[str], arms: Mapping[str, Arm] = ARMS
) -> tuple[list[str], list[list[Any]]]:
    """Return headers and one row per claim: what the paper says, and a verdict per condition and indirect arm."""
    pairs = [(condition, arm) for condition in conditions for arm in indirect(list(slugs), arms)]
    rows: list[list[Any]] = []
    for name, claim in CLAIMS.items():
        row: list[Any] = [name, claim.says, claim.where]
        for condition, arm in pairs:
            of_arm = about(findings, condition, arm, arms)
            of_all = [f for f in findings if f.condition == condition and claim.of in ("v", "direct")]
            row.append(next((f.found.says for f in (*of_arm, *of_all) if f.claim == name), None))
        rows.append(row)
    return ["claim", "the paper", "where", *(f"{c}, {arms[arm].label}" for c, arm in pairs)], rows


# ---------------------------------------------------------------- sections


def add_curves(report: Report, samples: Mapping[str, Sample], title: str, arms: Mapping[str, Arm] = ARMS) -> None:
    """Add Figure 4 as interactive curves: steps, robots left and teams left per trial, with 95 % bands."""
    drawn = [slug for slug in samples if arms[slug].drawn] or list(samples)
    for column, label in (("steps", "steps"), ("robots_left", "robots left"), ("teams_left", "teams left")):
        series = []
        for slug in drawn:
            band = stats.mean_band(getattr(samples[slug], column), strata=samples[slug].maps)
            series.append(Series(arms[slug].label, band.estimate, band.low, band.high, slug))
        report.curves(series, title=f"{title}: {label}", y_label=label, x_label="trial")


def add_move_weights(report: Report, sample: Sample, label: str) -> None:
    """Add Figure 5 as turning bars, one per weapons class."""
    assert sample.move_weights is not None
    mean = sample.move_weights.mean(axis=0)
    top = float(mean.max())
    for level, weapons in enumerate(WEAPONS):
        report.bars3d(
            mean[level],
            FEATURES,
            ("stop", "move"),
            title=f"{label}: {weapons}",
            z_label="mean weight",
            z_range=(0.0, top),
        )


def add_settings(report: Report, store: Store, command: str) -> None:
    """Add what was run, with which settings, and how to run it again.

    Parameters
    ----------
    command
        The line to type; empty: there is none.
    """
    report.section("How to run it again")
    if command:
        report.code(command)
    report.paragraph(
        f"tasklift {tasklift.__version__}, specification `{store.spec.id[:16]}`; the rows are in `{FILE_NAME}` "
        "(`tasklift runs export` writes them as CSV or Parquet). The same command in the same folder resumes; the same "
        "settings give the same rows on any number of threads."
    )
    report.code(json.dumps(store.spec.settings, indent=1, ensure_ascii=False), summary="All settings")


def write_summary(
    path: Path,
    samples: Mapping[str, Mapping[str, Sample]],
    findings: Sequence[Finding],
    further: tuple[Sequence[str], Sequence[Sequence[Any]]],
    command: str,
) -> None:
    """Write the tables of the report as Markdown, ``further`` among them, for pages that quote them."""
    parts = [f"Made by `{command}` (tasklift {tasklift.__version__}).\n"]
    for condition, arms in samples.items():
        parts.append(f"Preset {condition}, means over all cells:\n\n{markdown_table(*arm_table(arms))}")
    slugs = next(iter(samples.values()))
    parts.append(markdown_table(*further))
    parts.append(markdown_table(*glance(findings, list(samples), slugs)))
    parts.append(markdown_table(FINDING_HEADERS, finding_rows(findings)))
    write_atomically(path, "\n".join(parts))
