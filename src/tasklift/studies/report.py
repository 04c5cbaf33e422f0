"""What studies leave behind: tables, policies, and the sections that their reports share."""

from __future__ import annotations

import csv
import io
import json
import math
import os
import platform
import time
from collections.abc import Callable, Iterable, Mapping, Sequence
from datetime import UTC, datetime
from importlib.metadata import version
from pathlib import Path
from typing import TYPE_CHECKING, Any
from urllib.parse import quote

import numpy as np

import tasklift
from tasklift import stats
from tasklift.files import output_folder, write_atomically
from tasklift.lab import FILE_NAME, Cell, Store
from tasklift.report.charts import VERDICTS, Mark, Row, Series
from tasklift.report.page import Link, Number, Report
from tasklift.studies.arms import ARMS, SEARCHED, Arm
from tasklift.studies.claims import CLAIMS, LAST, WINDOW, Finding, indirect
from tasklift.studies.samples import Floats, Sample
from tasklift.studies.study import Study
from tasklift.text import with_interval

if TYPE_CHECKING:
    from tasklift.building.simulator import Trace

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
    """Add what the methods are, folded."""
    with report.fold("What each method (arm) is"):
        report.table(["method", "name in options and files", "what it is"],
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
            [f.claim, f.condition, f.contrast(arms), in_text(f.interval), f.holds_if, f.found.says, chance, f.note]
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
    """Return headers and one row per claim: what the paper says, and a verdict per preset and method."""
    pairs = [(condition, arm) for condition in conditions for arm in indirect(list(slugs), arms)]
    rows: list[list[Any]] = []
    for name, claim in CLAIMS.items():
        row: list[Any] = [f"{claim.says} ({name})"]
        for condition, arm in pairs:
            of_arm = about(findings, condition, arm, arms)
            of_all = [f for f in findings if f.condition == condition and claim.of in ("v", "direct")]
            row.append(next((f.found.says for f in (*of_arm, *of_all) if f.claim == name), None))
        rows.append(row)
    return ["the paper says", *(f"{arms[arm].label}, {c}" for c, arm in pairs)], rows


# ---------------------------------------------------------------- numbers and words


def in_text(interval: stats.Interval) -> str:
    """Return an estimate and its interval as reports write them."""
    ends = interval.estimate, interval.low, interval.high
    return with_interval(*ends) if all(map(math.isfinite, ends)) else str(interval).replace("-", "−")


def large(interval: stats.Interval, label: str, unit: str = "") -> Number:
    """Return an estimate for a report's headline."""
    value, _, rest = in_text(interval).partition(" ")
    return Number(value + unit, rest.replace("]", f"{unit}]"), label)


def mean_of(sample: Sample, values: Floats) -> stats.Interval:
    """Return the mean of a sample's values, one per row, with its interval within maps."""
    return stats.compare(values, strata=sample.maps).interval


def mark_of(interval: stats.Interval, slug: str, name: str = "") -> Mark:
    """Return an estimate as a dot on a row."""
    return Mark(float(interval.estimate), float(interval.low), float(interval.high), slug, name)


def tally(findings: Sequence[Finding]) -> str:
    """Say which claims hold, do not, and are open, a line each."""
    found: dict[str, list[str]] = {}
    for f in findings:
        found.setdefault(VERDICTS[f.verdict][0], []).append(CLAIMS[f.claim].short)
    return "\n".join(f"  {sign} {', '.join(found[sign])}" for sign in ("✓", "✗", "–") if sign in found)


# ---------------------------------------------------------------- replays


#: Writes traces as a page that plays them: its title, labels and traces, the file. What makes such pages lies above.
Play = Callable[[str, "Sequence[tuple[str, Trace]]", Path], None]


def add_replays(study: Study, folder: Path, cells: Iterable[Cell], play: Play | None) -> dict[Cell, Link | None]:
    """Write a replay of the last episode of each cell, unless it is there; return the links, by cell.

    Parameters
    ----------
    study
        Plays the episodes again.
    folder
        Of the report; replays go into ``replays`` below it.
    cells
        Of the study.
    play
        Writes a page; None: there are no replays and no links.
    """
    links: dict[Cell, Link | None] = dict.fromkeys(cells)
    for cell in links if play else ():
        last = study.stage_trials(cell)
        name = f"replays/{'-'.join(cell[axis] for axis in cell.axes)}-{last}.html"
        (folder / "replays").mkdir(exist_ok=True)
        if not (folder / name).exists():
            assert play is not None
            trace = study.replay(cell, last - 1)
            play(f"{cell}, episode {last}", [(study.arms[cell["arm"]].label, trace)], folder / name)
        links[cell] = Link(f"▶ episode {last}", quote(name))
    return links


# ---------------------------------------------------------------- sections


def too_few(report: Report, found: Sequence[stats.Comparison]) -> None:
    """Warn of the comparisons that have no verdict since there are too few runs."""
    few = [one for one in found if one.verdict == "too few" and one.unit == "seeds"]
    if few:
        report.warning(
            f"**Too few runs**: {len(few)} of {len(found)} comparisons have no verdict. They need up to "
            f"{max(one.needed for one in few)} runs (maps × seeds); add some with `--seeds` in the same folder."
        )


def add_curves(
    report: Report,
    samples: Mapping[str, Sample],
    title: str,
    arms: Mapping[str, Arm] = ARMS,
    columns: Sequence[str] = ("steps", "robots_left", "teams_left"),
) -> None:
    """Add Figure 4 as interactive curves: running means of 10 episodes with 95 % bands, by method."""
    drawn = [slug for slug in samples if arms[slug].drawn] or list(samples)
    for column in columns:
        series, most = [], samples[drawn[0]].limit if column == "steps" else samples[drawn[0]].n_robots
        for slug in drawn:
            values = getattr(samples[slug], column)
            if not arms[slug].learns:
                values = np.broadcast_to(values.mean(axis=1, keepdims=True), values.shape)
            series.append(smoothed(values, samples[slug].maps, arms[slug], most=most))
        label = column.replace("_", " ")
        report.curves(series, title=f"{title}: {label}", y_label=label, x_label="episode (trial)")


def smoothed(values: Floats, maps: Any, arm: Arm, *, most: float, before: int = 0) -> Series:
    """Return the running means of 10 episodes as a curve with its 95 % band; between 0 and ``most``.

    Parameters
    ----------
    values
        ``(n, T)``.
    maps
        ``(n,)``: each row's map.
    arm
        For the curve's name and colour.
    most
        The largest value that is possible.
    before
        Episodes of which nothing is drawn, before these.
    """
    window = min(WINDOW, values.shape[1])
    sums = np.cumsum(np.pad(values, ((0, 0), (1, 0))), axis=1)
    band = stats.mean_band((sums[:, window:] - sums[:, :-window]) / window, strata=maps)
    low, high = np.clip([band.low, band.high], 0, most)
    y, low, high = (np.concatenate([np.full(before + window - 1, np.nan), part]) for part in (band.estimate, low, high))
    each = np.concatenate([np.full(before, np.nan), values.mean(axis=0)])
    return Series(arm.label, y, low, high, arm.slug, each)


def add_move_weights(report: Report, sample: Sample, label: str, *, brief: bool = False) -> None:
    """Add Figure 5 as flat charts: the mean weights of stopping and moving, by feature and class of weapon robots.

    Parameters
    ----------
    report, sample, label
        Where, of what, and its name.
    brief
        One chart of what the claims are about: no feature and the enemy feature. Otherwise one per class, all features.
    """
    assert sample.move_weights is not None
    shape = sample.move_weights.shape[1:]
    band = stats.mean_band(sample.move_weights.reshape(len(sample.maps), -1), strata=sample.maps)
    mean, low, high = (np.reshape(part, shape) for part in (band.estimate, band.low, band.high))
    scale = 0.0, float(np.nanmax([mean, high]))

    def row(name: str, level: int, feature: int) -> Row:
        at = level, feature
        marks = [Mark(mean[*at, m], low[*at, m], high[*at, m], move, move) for m, move in enumerate(("stop", "move"))]
        return Row(name, marks)

    if brief:
        rows = [
            row(f"{words}, {weapons}", level, FEATURES.index(feature))
            for words, feature in (("no feature", FEATURES[0]), ("enemy feature", FEATURES[3]))
            for level, weapons in enumerate(("0 weapons", "1 to m − 1", "m or more"))
        ]
        report.rows(rows, title=label, label="mean weight", within=scale, beside=2)
        return
    for level, weapons in enumerate(WEAPONS):
        rows = [row(feature, level, k) for k, feature in enumerate(FEATURES)]
        report.rows(rows, title=f"{label}: {weapons}", label="weight", within=scale, beside=3)


def add_settings(report: Report, store: Store, command: str, since: float) -> None:
    """Add what was run, with which settings, and how to run it again; in the foot: date, versions, duration, command.

    Parameters
    ----------
    command
        The line to type; empty: there is none.
    since
        When the command began, by ``time.monotonic``.
    """
    with report.fold("How to run it again, and all settings"):
        if command:
            report.code(command)
        report.paragraph(
            f"The rows are in `{FILE_NAME}` (`tasklift runs export` writes them as CSV or Parquet). The same command "
            "in the same folder resumes. The same settings give the same rows on any number of threads."
        )
        report.code(json.dumps(store.spec.settings, indent=1, ensure_ascii=False))
    seconds = round(time.monotonic() - since)
    versions = ", ".join(f"{name} {version(name)}" for name in ("numpy", "numba", "scipy"))
    took = f"{seconds // 60} min {seconds % 60} s" if seconds >= 60 else f"{seconds} s"
    report.footer(
        f"Written {datetime.now(UTC):%Y-%m-%d %H:%M} UTC by tasklift {tasklift.__version__}; Python "
        f"{platform.python_version()}, {versions}; {platform.system()} {platform.machine()}, {os.cpu_count()} cores. "
        f"This command took {took}. Specification `{store.spec.id[:16]}`.",
        *([f"`{command}`"] if command else []),
    )


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
