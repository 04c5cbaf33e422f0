"""What a study leaves behind: rows, policies, figures, the claims table and ``report.html``."""

from __future__ import annotations

import csv
import io
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

import tasklift
from tasklift import stats
from tasklift.errors import TaskliftError
from tasklift.files import write_atomically
from tasklift.lab import FILE_NAME, Cell, Store
from tasklift.report.charts import Series
from tasklift.report.page import Report
from tasklift.studies.arms import ARMS
from tasklift.studies.paper.claims import CLAIMS, LAST, Finding, Sample, holm_adjusted
from tasklift.studies.paper.figures import WEAPONS
from tasklift.studies.study import Study

#: Arms in the curves, in the order of their colours.
DRAWN = ("direct", "copy", "copy+prior", "prior", "expert")
FEATURES = ("1 none", "2 bend", "3 corner", "4 door (enemy)", "5 other")


def prepare_folder(out: Path) -> Path:
    """Create the folder of an experiment, or accept one that holds an experiment already.

    Raises
    ------
    TaskliftError
        If it holds anything else: nothing is overwritten.
    """
    try:
        out.mkdir(parents=True, exist_ok=True)
        if any(out.iterdir()) and not (out / FILE_NAME).exists():
            raise TaskliftError(f"{out}: holds other files and no experiment; choose a new or empty folder")
    except OSError as error:
        raise TaskliftError(f"{out}: cannot be used as a folder ({error.strerror}); choose another") from error
    return out


def save_policies(study: Study, folder: Path, reading: str, building: str) -> list[Path]:
    """Write what every learning arm ends with on one building with seed 0."""
    folder.mkdir(exist_ok=True)
    paths = []
    for name in study.arms:
        if ARMS[name].learns:
            file = folder / f"{reading}, {name}.json".replace(" ", "-").replace(",", "")
            study.learned(Cell(reading=reading, map=building, seed=0, arm=name)).save(file)
            paths.append(file)
    return paths


def write_claims(findings: Sequence[Finding], path: Path) -> None:
    """Write the findings as CSV, one per line."""
    text = io.StringIO()
    writer = csv.writer(text, lineterminator="\n")
    writer.writerow(
        ["claim", "reading", "contrast", "measure", "estimate", "low", "high", "holds if", "verdict", "p", "p Holm",
         "note"]
    )  # fmt: skip
    for finding, p in zip(findings, holm_adjusted(list(findings)), strict=True):
        interval = finding.interval
        writer.writerow(
            [finding.claim, finding.reading, finding.contrast, CLAIMS[finding.claim].measure, interval.estimate,
             interval.low, interval.high, finding.better, finding.verdict, finding.p, p, finding.note]
        )  # fmt: skip
    write_atomically(path, text.getvalue())


def arm_table(samples: Mapping[str, Sample]) -> tuple[list[str], list[list[Any]]]:
    """Return headers and one row per arm: steps early and late, losses, trials kept, out of time, greedy use."""
    columns: dict[str, Callable[[Sample], Any]] = {
        "steps, first 10 trials": lambda s: s.steps[:, :10].mean(),
        "steps, last 20": lambda s: s.steps[:, -LAST:].mean(),
        "robots lost a trial": lambda s: s.losses.mean(),
        "all kept (% of trials)": lambda s: 100 * (s.robots_left == s.n_robots).mean(),
        "out of time (%)": lambda s: 100 * (1 - s.success.mean()),
        "greedy: steps": lambda s: s.greedy_steps.mean(),
        "greedy: lost a trial": lambda s: s.greedy_losses.mean(),
    }
    if all(sample.unseen_steps.size for sample in samples.values()):
        columns["greedy on unseen maps: steps"] = lambda s: s.unseen_steps.mean()
        columns["greedy on unseen maps: lost a trial"] = lambda s: s.unseen_losses.mean()
    rows = [[arm, *(round(float(of(sample)), 1) for of in columns.values())] for arm, sample in samples.items()]
    return ["arm", *columns], rows


def ledger_rows(store: Store, reading: str) -> list[list[Any]]:
    """Return losses and steps by stage and arm, per cell, the price of the source task included."""
    rows: list[list[Any]] = []
    for arm in store.spec.settings["arms"]:
        total: dict[str, list[float]] = {}
        cells = 0
        for _, result in store.select(reading=reading, arm=arm):
            cells += 1
            for stage, columns in result.stages.items():
                if stage != "greedy":
                    seen = total.setdefault(stage, [0.0, 0.0, 0.0])
                    seen[0] += len(columns["steps"])
                    seen[1] += float(np.sum(columns["steps"]))
                    seen[2] += float(np.sum(columns["losses"]))
        for stage in ("source", "budget", "drill", "target"):
            if stage in total:
                trials, steps, losses = (value / cells for value in total[stage])
                rows.append([arm, stage, trials, round(steps), round(losses, 1), round(1000 * losses / steps, 2)])
    return rows


LEDGER_HEADERS = ("arm", "stage", "trials", "steps", "robots lost (drill: would be)", "per 1,000 steps")


#: The columns of the claims at a glance: what each indirect arm is, against plain direct learning.
GLANCED = ("copy", "copy+prior")


def glance_rows(findings: Sequence[Finding], readings: Sequence[str]) -> list[list[Any]]:
    """Return one row per claim: what the paper says, and a verdict per preset and indirect arm."""
    rows: list[list[Any]] = []
    for name, claim in CLAIMS.items():
        row: list[Any] = [name, claim.says, claim.where]
        for reading in readings:
            about = [f for f in findings if f.claim == name and f.reading == reading]
            for arm in GLANCED:
                row.append(next((f.verdict for f in about if _speaks_of(f, arm)), None))
        rows.append(row)
    return rows


def _speaks_of(finding: Finding, arm: str) -> bool:
    """Whether a finding is the arm's own, its contrast with direct learning, or the same for every arm."""
    first, _, second = finding.contrast.partition(" − ")
    if finding.claim in ("C1", "C2", "C5b", "C7b"):
        return True
    return first == arm and (finding.claim in ("C10", "C11") or second in ("", "direct"))


def finding_rows(findings: Sequence[Finding]) -> list[list[Any]]:
    """Return the measures behind the verdicts: one row per finding, in the order of the claims."""
    order = list(CLAIMS)
    adjusted = holm_adjusted(list(findings))
    rows = []
    for finding, p in sorted(zip(findings, adjusted, strict=True), key=lambda pair: order.index(pair[0].claim)):
        chance = "" if p is None else ("< 0.001" if p < 0.001 else f"{p:.3f}")
        rows.append(
            [finding.claim, finding.reading, finding.contrast, str(finding.interval), finding.better, finding.verdict,
             chance, finding.note]
        )  # fmt: skip
    return rows


FINDING_HEADERS = ("claim", "preset", "contrast", "estimate [interval]", "holds if", "verdict", "p (Holm)", "note")


def markdown_table(headers: Sequence[str], rows: Sequence[Sequence[Any]]) -> str:
    """Return a table as Markdown."""
    lines = [headers, ["---"] * len(headers), *rows]
    return "".join(f"| {' | '.join('' if value is None else str(value) for value in line)} |\n" for line in lines)


def write_summary(
    path: Path, samples: Mapping[str, Mapping[str, Sample]], findings: Sequence[Finding], command: str
) -> None:
    """Write the tables of the report as Markdown, for pages that quote them."""
    parts = [f"Made by `{command}` (tasklift {tasklift.__version__}).\n"]
    for reading, arms in samples.items():
        parts.append(f"Preset {reading}, means over all cells:\n\n{markdown_table(*arm_table(arms))}")
    columns = [f"{reading}, {arm}" for reading in samples for arm in GLANCED]
    parts.append(markdown_table(["claim", "the paper", "where", *columns], glance_rows(findings, list(samples))))
    parts.append(markdown_table(FINDING_HEADERS, finding_rows(findings)))
    write_atomically(path, "\n".join(parts))


def add_curves(report: Report, samples: Mapping[str, Sample], title: str) -> None:
    """Add Figure 4 as interactive curves: steps, robots left and teams left per trial, with 95 % bands."""
    for column, label, most in (
        ("steps", "steps", None),
        ("robots_left", "robots left", None),
        ("teams_left", "teams left", None),
    ):
        series = []
        for name in DRAWN:
            if name in samples:
                sample = samples[name]
                band = stats.mean_band(getattr(sample, column), strata=sample.maps, resamples=1000)
                series.append(Series(name, band.estimate, band.low, band.high, name.replace("+", "-")))
        report.curves(series, title=f"{title}: {label}", y_label=label, x_label="trial", y_range=most)


def add_move_weights(report: Report, sample: Sample, arm: str) -> None:
    """Add Figure 5 as turning bars, one per weapons class."""
    mean = sample.move_weights.mean(axis=0)
    top = float(mean.max())
    for level, label in enumerate(WEAPONS):
        report.bars3d(
            mean[level],
            FEATURES,
            ("stop", "move"),
            title=f"{arm}: {label}",
            z_label="mean weight",
            z_range=(0.0, top),
        )


def add_settings(report: Report, store: Store, command: str) -> None:
    """Add what was run, with which settings, and how to run it again."""
    report.section("How to run it again")
    report.code(command)
    report.paragraph(
        f"tasklift {tasklift.__version__}, specification `{store.spec.id[:16]}`; the rows are in `{FILE_NAME}` "
        "(`tasklift runs export` writes them as CSV or Parquet). The same command in the same folder resumes; the same "
        "settings give the same rows on any number of threads."
    )
    report.code(_pretty(store.spec.settings), summary="All settings")


def _pretty(settings: Mapping[str, Any]) -> str:
    import json

    return json.dumps(settings, indent=1, ensure_ascii=False)
