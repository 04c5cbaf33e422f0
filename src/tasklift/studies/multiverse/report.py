"""What the multiverse of readings shows: one picture of shares and of what decides, tables, ``report.html``."""

from __future__ import annotations

import time
from collections.abc import Mapping, Sequence
from itertools import pairwise
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from tasklift import stats
from tasklift.files import output_folder
from tasklift.lab import FILE_NAME, Progress, Store, run
from tasklift.report.page import Number, Report
from tasklift.report.pictures import save, styled
from tasklift.studies.arms import ARMS as ALL_ARMS
from tasklift.studies.claims import CLAIMS
from tasklift.studies.multiverse.study import (
    ARMS,
    INDIRECT,
    LINES,
    OFFSETS,
    OPTIONS,
    SELECTION,
    STORY,
    Effects,
    Judged,
    draw,
    judge,
    main_effects,
    study,
)
from tasklift.studies.report import add_settings, large, write_csv
from tasklift.studies.samples import Floats
from tasklift.studies.study import Study, generated, numbered
from tasklift.style import GROUND, SERIES

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

_LABELS = {slug: ALL_ARMS[slug].label for slug in ("v", *ARMS)}
_TITLES = {"v": "the simple task V", "direct": "direct learning alone",
           "copy": "copy against direct: the paper's indirect learning",
           "copy-prior": "copy+prior against direct"}  # fmt: skip
_HOLDS, _OPEN, _FAILS = (GROUND[name][0] for name in ("holds", "line", "fails"))
_INK, _MUTED = GROUND["ink"][0], GROUND["soft"][0]
#: A cell is at its darkest where a level moves the balance of verdicts by this much (of −1 … 1).
_DARKEST = 0.6


def multiverse(
    *,
    out: Path,
    readings: int = 500,
    maps: int = 4,
    seeds: int = 5,
    trials: int = 100,
    design: int = 0,
    command: str = "",
    progress: Progress | None = None,
    **engine: Any,
) -> tuple[list[str], Path]:
    """Draw readings, train and judge under each, find what decides; return the result in a few lines, and the report.

    Parameters
    ----------
    out
        Folder; one that holds this very experiment is resumed, any other content is refused.
    readings, maps, seeds, trials
        How many; maps are generated from the seeds 0, 1, …, as in the main study.
    design
        Seed of the design: which readings are drawn.
    command
        The line that runs this again, for the report.
    progress, engine
        As in :func:`tasklift.lab.run`; also its ``workers`` and ``address``.
    """
    since = time.monotonic()
    buildings = generated(numbered(maps, "maps"))
    numbered(seeds, "seeds")  # before the design, which takes a while
    levels = draw(readings, design)
    plan = study(buildings, levels, seeds=seeds, trials=trials)
    folder = output_folder(out, (FILE_NAME,), ("figures",))
    with Store.open(folder / FILE_NAME, plan.spec("multiverse of readings")) as store:
        run(store, plan.cells(), plan.work, progress=progress, **engine)
        judged = judge(store, levels, progress=progress)
        return write_report(plan, judged, folder, store, command, since)


def write_report(
    plan: Study, judged: Judged, folder: Path, store: Store, command: str, since: float
) -> tuple[list[str], Path]:
    """Write ``verdicts.csv``, ``effects.csv``, the figures and ``report.html``; return the result and its path."""
    effects = main_effects(judged.verdict, judged.levels)
    write_verdicts(judged, list(plan.conditions), folder / "verdicts.csv")
    write_effects({"balance of verdicts": effects,
                   "effect in standard errors": main_effects(judged.effect, judged.levels)},
                  folder / "effects.csv")  # fmt: skip
    pictures = output_folder(folder / "figures")
    drawn = {
        "multiverse": save(draw_multiverse(judged, effects), pictures, "multiverse")[1],
        "rules": save(draw_rules(judged), pictures, "selection-rules")[1],
        "eleven": save(draw_eleven(judged), pictures, "eleven-of-100")[1],
    }
    path = folder / "report.html"
    page = _page(plan, judged, effects, drawn)
    add_settings(page, store, command, since)
    page.write(path)
    return [line.replace("**", "") for line in (headline(judged), *verdict_lines(judged, effects))], path


# ---------------------------------------------------------------- numbers


def shares(judged: Judged, among: NDArray[np.bool_] | None = None) -> Floats:
    """Return ``float64 (L, 3)``: the share of (judged) readings in which a claim holds, is undecided, fails."""
    verdict = judged.verdict if among is None else judged.verdict[among]
    count = np.maximum(np.isfinite(verdict).sum(axis=0), 1)
    return np.stack([(verdict == code).sum(axis=0) / count for code in (1, 0, -1)], axis=1)


def by_rule(judged: Judged) -> dict[str, NDArray[np.bool_]]:
    """Return ``bool (n,)`` per selection rule: its readings; rules without any are left out."""
    option = OPTIONS[SELECTION]
    found = {option.label(i): judged.levels[:, SELECTION] == i for i in range(len(option.levels))}
    return {name: rows for name, rows in found.items() if rows.any()}


def spreads(effects: Effects) -> Floats:
    """Return ``float64 (L, options)``: range of an option's effects on a line, 0 where no level decides it."""
    found = np.zeros((len(effects.estimate), len(OPTIONS)))
    for o, (start, end) in enumerate(pairwise(OFFSETS)):
        decided = effects.decides[:, start:end].any(axis=1)
        if decided.any():
            part = effects.estimate[decided, start:end]
            found[decided, o] = np.nanmax(part, axis=1) - np.nanmin(part, axis=1)
    return found


def deciding(effects: Effects, line: int) -> str:
    """Say which options decide a claim, the strongest first: the levels that do, with their effects (points)."""
    spread = spreads(effects)[line]
    parts = []
    for o in np.argsort(-spread, kind="stable"):
        if spread[o] > 0:
            levels = [
                f"{OPTIONS[o].label(k)} {100 * effects.estimate[line, OFFSETS[o] + k]:+.0f} "
                f"[{100 * effects.low[line, OFFSETS[o] + k]:+.0f}, {100 * effects.high[line, OFFSETS[o] + k]:+.0f}]"
                for k in range(len(OPTIONS[o].levels))
                if effects.decides[line, OFFSETS[o] + k]
            ]
            parts.append(f"**{OPTIONS[o].name}**: {', '.join(levels)}".replace("-", "−"))
    return "; ".join(parts) or "none"


def write_verdicts(judged: Judged, names: Sequence[str], path: Path) -> None:
    """Write a line per reading: its options, then every claim's verdict and effect in standard errors."""
    words = {1.0: "holds", 0.0: "undecided", -1.0: "does not hold"}
    titles = [f"{claim} {arm}" for claim, arm in LINES]
    rows: list[list[Any]] = [
        ["reading", *(o.name for o in OPTIONS), *titles, *(f"{title}, effect" for title in titles),
         "direct: trials of 100 with all robots kept"]
    ]  # fmt: skip
    for i, name in enumerate(names):
        chosen = [option.levels[level] for option, level in zip(OPTIONS, judged.levels[i], strict=True)]
        verdicts = [words.get(v, "") for v in judged.verdict[i]]
        sizes = ["" if np.isnan(e) else round(float(e), 4) for e in judged.effect[i]]
        rows.append([name, *chosen, *verdicts, *sizes, round(float(judged.kept[i].mean()), 4)])
    write_csv(rows, path)


def write_effects(outcomes: Mapping[str, Effects], path: Path) -> None:
    """Write a line per outcome, claim, arm, option and level: the main effect, its interval, the adjusted p."""
    rows: list[list[Any]] = [["outcome", "claim", "arm", "option", "level", "effect", "low", "high", "p (BH)"]]
    for outcome, effects in outcomes.items():
        for line, (claim, arm) in enumerate(LINES):
            for o, option in enumerate(OPTIONS):
                for k in range(len(option.levels)):
                    at = line, OFFSETS[o] + k
                    numbers = (effects.estimate[at], effects.low[at], effects.high[at], effects.p[at])
                    rows.append([outcome, claim, arm, option.name, option.label(k),
                                 *("" if np.isnan(x) else f"{x:.4g}" for x in numbers)])  # fmt: skip
    write_csv(rows, path)


# ---------------------------------------------------------------- pictures


@styled
def draw_multiverse(judged: Judged, effects: Effects) -> Figure:
    """Draw the shares of readings in which each claim holds, and beside them which option levels decide it.

    A coloured cell: with this level, the balance (share that holds less share that fails) differs from that of
    all readings, at 5 % after Benjamini & Hochberg; its number is the difference in points. Options are ordered
    by how much they decide, but for the selection rule, which comes first.
    """
    from matplotlib.figure import Figure

    figure = Figure(figsize=(13.5, 7.9))
    grid = figure.add_gridspec(1, 2, width_ratios=(1.9, 8.1), wspace=0.015, left=0.205, right=0.972, top=0.79,
                               bottom=0.03)  # fmt: skip
    bars, cells = figure.add_subplot(grid[0]), figure.add_subplot(grid[1])
    y = _rows()
    _draw_shares(bars, judged, y)
    _name_lines(bars, y)
    _draw_cells(cells, effects, y)
    for ax in (bars, cells):
        ax.set_ylim(max(y) + 0.6, min(y) - 0.6)
    n = len(judged.levels)
    figure.text(0.012, 0.965, f"The paper's claims under {n} readings of it", fontsize=14, color=_INK,
                fontweight="bold", va="center")  # fmt: skip
    figure.text(0.012, 0.938, "Bars: share of the readings (%).\nSquares: how an alternative moves the balance, "
                "holds less fails (points);\ncoloured where it decides, at 5 % after Benjamini & Hochberg.",
                fontsize=8, color=_MUTED, va="top", linespacing=1.35)  # fmt: skip
    _legend(figure, 0.865)
    return figure


def _name_lines(ax: Axes, y: Sequence[float]) -> None:
    """Write the claims beside their bars, and a title over every block."""
    place = ax.get_yaxis_transform()
    for line, (claim, arm) in enumerate(LINES):
        ax.text(-1.27, y[line], claim, va="center", fontweight="bold", color=_INK, transform=place)
        ax.text(-1.05, y[line], CLAIMS[claim].short, va="center", color=_INK, transform=place)
        if arm != LINES[line - 1][1]:
            ax.text(-1.27, y[line] - 0.95, _TITLES[arm], va="center", fontsize=8.5, color=_INK, fontweight="bold",
                    transform=place)  # fmt: skip


def _rows() -> list[float]:
    """Return the height of every line; a gap before every block of lines holds its title."""
    y, at = [], 0.0
    for line, (_, arm) in enumerate(LINES):
        at += 1.0 if line and arm == LINES[line - 1][1] else 2.0
        y.append(at)
    return y


def _draw_shares(ax: Axes, judged: Judged, y: Sequence[float], among: NDArray[np.bool_] | None = None) -> None:
    share = 100 * shares(judged, among)
    verdict = judged.verdict if among is None else judged.verdict[among]
    for line in range(len(LINES)):
        if not np.isfinite(verdict[:, line]).any():
            continue
        left = 0.0
        for value, colour in zip(share[line], (_HOLDS, _OPEN, _FAILS), strict=True):
            ax.barh(y[line], value, left=left, height=0.8, color=colour)
            left += value
        if share[line, 0] >= 8:
            ax.text(1.5, y[line], f"{share[line, 0]:.0f}", va="center", color="white", fontsize=7)
        if share[line, 2] >= 8:
            ax.text(98.5, y[line], f"{share[line, 2]:.0f}", va="center", ha="right", color="white", fontsize=7)
    ax.set_xlim(0, 100)
    ax.set_xticks([0, 50, 100], ["0", "50 %", "100"])
    ax.xaxis.tick_top()
    ax.set_yticks([])
    ax.tick_params(length=2)
    for side in ("left", "right", "bottom", "top"):
        ax.spines[side].set_visible(False)
    ax.axvline(50, color="white", linewidth=0.8)


def _draw_cells(ax: Axes, effects: Effects, y: Sequence[float]) -> None:
    from matplotlib.patches import Rectangle

    total = spreads(effects).sum(axis=0)
    order = [SELECTION, *(int(o) for o in np.argsort(-total, kind="stable") if o != SELECTION)]
    x = 0.0
    for o in order:
        option, start = OPTIONS[o], x
        for k in range(len(option.levels)):
            for line in range(len(LINES)):
                at = line, OFFSETS[o] + k
                decides = bool(effects.decides[at])
                colour = _shade(effects.estimate[at]) if decides else "#f4f5f7"
                ax.add_patch(Rectangle((x, y[line] - 0.42), 0.94, 0.84, facecolor=colour, linewidth=0))
                if decides:
                    strong = abs(effects.estimate[at]) > 0.55 * _DARKEST
                    text = f"{100 * effects.estimate[at]:.0f}".replace("-", "−")
                    ax.text(x + 0.47, y[line], text, ha="center", va="center", fontsize=5.3,
                            color="white" if strong else _INK)  # fmt: skip
            ax.text(x + 0.5, min(y) - 0.75, option.label(k), rotation=90, ha="center", va="bottom", fontsize=7,
                    color=_MUTED)  # fmt: skip
            x += 1.0
        ax.plot([start, x - 0.06], [min(y) - 4.35] * 2, color=_INK, linewidth=0.9, clip_on=False)
        ax.text((start + x) / 2 - 0.1, min(y) - 4.5, _title(option.name), rotation=38,
                ha="left", va="bottom", fontsize=8.5, color=_INK)  # fmt: skip
        x += 0.9 if o == SELECTION else 0.5
    ax.set_xlim(-0.3, x - 0.4)
    ax.axis("off")


def _title(option: str) -> str:
    """Return an option's name as the picture shows it."""
    return {"alert_range_m": "alert range (m)", "selection": "selection rule"}.get(option, option.replace("_", " "))


def _shade(effect: float) -> tuple[float, float, float]:
    """Blend from near white to the colour of holding or failing."""
    from matplotlib.colors import to_rgb

    strength = 0.18 + 0.82 * min(1.0, abs(effect) / _DARKEST)
    full = to_rgb(_HOLDS if effect > 0 else _FAILS)
    red, green, blue = (1 - strength * (1 - channel) for channel in full)
    return red, green, blue


def _legend(figure: Figure, top: float) -> None:
    from matplotlib.patches import Patch

    figure.legend(
        handles=[Patch(color=_HOLDS, label="holds"), Patch(color=_OPEN, label="undecided"),
                 Patch(color=_FAILS, label="does not hold")],
        loc="upper left", bbox_to_anchor=(0.005, top), ncols=3, frameon=False, handlelength=1.2, fontsize=8.5,
    )  # fmt: skip


@styled
def draw_rules(judged: Judged) -> Figure:
    """Draw the shares again for each selection rule on its own."""
    from matplotlib.figure import Figure

    rules = by_rule(judged)
    figure = Figure(figsize=(11, 6.2))
    axes = figure.subplots(1, len(rules), squeeze=False, gridspec_kw={
        "left": 0.235, "right": 0.985, "top": 0.87, "bottom": 0.02, "wspace": 0.12})[0]  # fmt: skip
    y = _rows()
    for ax, (name, rows) in zip(axes, rules.items(), strict=True):
        _draw_shares(ax, judged, y, rows)
        ax.set_ylim(max(y) + 0.6, min(y) - 1.6)
        ax.set_title(f"{name} ({rows.sum()} readings)", fontsize=9.5, color=_INK, pad=8, loc="center")
    _name_lines(axes[0], y)
    _legend(figure, 1.0)
    return figure


@styled
def draw_eleven(judged: Judged) -> Figure:
    """Draw how many of 100 trials direct learning loses no robot in, and where the paper's 11 falls."""
    from matplotlib.figure import Figure

    figure = Figure(figsize=(7.2, 2.7), layout="constrained")
    ax = figure.subplots()
    rules = by_rule(judged)
    kept = judged.kept.mean(axis=1)
    colours = [SERIES[name][0] for name in ("violet", "pink", "gold", "grey")]  # none is an arm's here
    ax.hist([kept[rows] for rows in rules.values()], bins=np.linspace(0, 100, 41).tolist(), stacked=True,
            label=list(rules), color=colours[: len(rules)])  # fmt: skip
    ax.set_ylim(0, 1.15 * ax.get_ylim()[1])
    ax.axvline(11, color=_INK, linewidth=1.2)
    ax.annotate("the paper: 11", (11, ax.get_ylim()[1]), (6, -9), textcoords="offset points", color=_INK)
    ax.set_xlabel("trials of 100 in which direct learning keeps all robots (mean of a reading's runs)")
    ax.set_ylabel("readings")
    ax.set_xlim(0, 100)
    ax.legend(loc="upper right")
    return figure


# ---------------------------------------------------------------- the page


def _page(plan: Study, judged: Judged, effects: Effects, drawn: Mapping[str, Path]) -> Report:
    n, maps, seeds = len(judged.levels), len(plan.buildings), len(plan.parts[0].seeds)
    page = Report(f"The paper's claims under {n} readings of it")
    page.headline(headline(judged), numbers(judged))
    page.shares(_share_rows(judged, STORY), title="Readings in which the paper's five main claims hold (%)")
    with page.fold("The same in words, and the paper's 11 of 100"):
        page.verdict(*verdict_lines(judged, effects))
        page.figure(drawn["eleven"])
    with page.fold("All claims"):
        page.shares(_share_rows(judged, list(CLAIMS)), title=f"Share of {n} readings (%)", caption="C5b and C7b speak "
                    "of direct learning alone, C1 and C2 of the simple task V; C10 is judged in the readings whose "
                    "rule is exploration.")  # fmt: skip
    page.section("What decides")
    page.paragraph(
        "The paper leaves details open. Each became an option with alternatives, and a reading takes one alternative "
        f"of each of the {len(OPTIONS)} options. The {n} readings meet every alternative equally often (Latin "
        f"hypercube). Under each, direct, copy and copy+prior learned on {maps} maps × {seeds} seeds, with "
        f"{plan.trials} episodes (trials) on T each."
    )
    with page.fold("Which alternatives move which claim, in one picture"):
        page.figure(drawn["multiverse"])
    with page.fold("The same in numbers"):
        _decided(page, judged, effects, maps * seeds)
    with page.fold("The selection rule"):
        for name, among in by_rule(judged).items():
            page.shares(_share_rows(judged, STORY, among), title=f"{name} ({among.sum()} readings, %)")
        page.table(RULE_HEADERS, rule_rows(judged), caption="Means over the readings of a rule; greedily: the policy "
                   "at the end, always taking its heaviest output.")  # fmt: skip
    with page.fold("The options"):
        page.table(
            ["option", "of", "alternatives"],
            [[o.name, o.of, ", ".join(o.label(k) for k in range(len(o.levels)))] for o in OPTIONS],
        )
    return page


def _share_rows(
    judged: Judged, claims: Sequence[str], among: NDArray[np.bool_] | None = None
) -> list[tuple[str, list[float], str]]:
    """Return for each line of these claims its name, its shares, and the shares that hold and fail in numbers."""
    share = shares(judged, among)
    return [
        (f"{_LABELS[arm]}: {CLAIMS[claim].short} ({claim})", share[i].tolist(),
         f"✓ {100 * share[i, 0]:.0f}  ✗ {100 * share[i, 2]:.0f}")
        for i, (claim, arm) in enumerate(LINES)
        if claim in claims
    ]  # fmt: skip


def _decided(page: Report, judged: Judged, effects: Effects, runs: int) -> None:
    page.paragraph(
        f"Verdicts come from 95 % intervals over {runs} paired runs, as in the main study. With so few runs small "
        "effects stay undecided. Where there is no effect at all, some 5 to 6 % of the readings say that it holds and "
        "as many that it does not (measured on normal samples of 4 × 5). An effect is the change of the balance "
        "(share that holds less share that fails, points) with an alternative against all readings, with its 95 % "
        "bootstrap interval over readings. Those listed lie below 5 % after Benjamini & Hochberg over all claims and "
        "alternatives."
    )
    share = 100 * shares(judged)
    count = np.isfinite(judged.verdict).sum(axis=0)
    page.table(
        ["claim", "", "method", "readings", "holds (%)", "undecided (%)", "fails (%)", "decided by (points)"],
        [
            [claim, CLAIMS[claim].says, _LABELS[arm], int(count[i]), *share[i].round(1).tolist(), deciding(effects, i)]
            for i, (claim, arm) in enumerate(LINES)
        ],
    )


def headline(judged: Judged) -> str:
    """Say in one sentence in how many readings transfer loses fewer robots than learning from scratch."""
    said = []
    for arm in INDIRECT:
        holds, _, fails = 100 * shares(judged)[LINES.index(("C6", arm))]
        said.append(f"{_LABELS[arm]} loses **fewer robots in {holds:.0f} %** and more in {fails:.0f} %")
    return f"Of {len(judged.levels)} readings of what the paper leaves open, {'; '.join(said)}."


def numbers(judged: Judged) -> list[Number]:
    """Return the share of readings in which robots are saved, by method, and in which the paper's story holds."""
    n = len(judged.levels)
    asked = {f"of readings: {_LABELS[arm]} loses fewer robots than direct": judged.column("C6", arm) == 1
             for arm in INDIRECT}  # fmt: skip
    last = INDIRECT[-1]
    asked[f"of readings: all five main claims hold at once for {_LABELS[last]}"] = judged.together(last)
    found = {label: stats.share(int(flags.sum()), n, unit="readings").interval for label, flags in asked.items()}
    return [
        large(stats.Interval(100 * i.estimate, 100 * i.low, 100 * i.high, i.confidence, i.n), label, " %")
        for label, i in found.items()
    ]


def verdict_lines(judged: Judged, effects: Effects) -> list[str]:
    """Say in words and numbers what came out, per indirect arm; then what decides most."""
    share, n = 100 * shares(judged), len(judged.levels)
    lines = []
    for arm in INDIRECT:
        said = []
        for claim in STORY:
            holds, _, fails = share[LINES.index((claim, arm))]
            said.append(f"{claim} ({CLAIMS[claim].short}) holds in {holds:.0f} % and fails in {fails:.0f} %")
        together = judged.together(arm).sum()
        lines.append(
            f"**{_LABELS[arm]} against direct**: {'; '.join(said)}. All five hold at once in **{together} of {n} "
            "readings**."
        )
    total = spreads(effects).sum(axis=0)
    order = [OPTIONS[o].name for o in np.argsort(-total, kind="stable") if total[o] > 0][:5]
    lines.append(
        f"What decides most, over all claims: **{', '.join(order)}**." if order
        else "No option decides any claim at 5 %, corrected for all that was looked at: too few readings."
    )  # fmt: skip
    return [*lines, eleven_line(judged)]


def eleven_line(judged: Judged) -> str:
    """Say where the paper's 11 of 100 falls among the direct arms of all readings."""
    kept = judged.kept.mean(axis=1)
    low, middle, high = np.quantile(kept, [0.05, 0.5, 0.95])
    parts = [f"{name}: {100 * (kept[rows] < 11).mean():.0f} %" for name, rows in by_rule(judged).items()]
    return (
        f"Direct learning keeps all robots in {middle:.0f} of 100 trials under the median reading (5 to 95 %: "
        f"{low:.0f} to {high:.0f}). The paper's 11 lies above {100 * (kept < 11).mean():.0f} % of the readings "
        f"({'; '.join(parts)}) and above {100 * (judged.kept < 11).mean():.0f} % of all single runs."
    )


RULE_HEADERS = ("rule", "arm", "readings", "C3, C4, C6, C7, C8 at once", "steps a trial", "robots lost a trial",
                "greedily: steps", "greedily: lost a trial")  # fmt: skip


def rule_rows(judged: Judged) -> list[list[Any]]:
    """Return a row per selection rule and arm: how often the story holds, and the means."""
    rows: list[list[Any]] = []
    for name, among in by_rule(judged).items():
        for arm in ARMS:
            together = int(judged.together(arm)[among].sum()) if arm in INDIRECT else None
            means = [float(v) for v in judged.arms[arm][among].mean(axis=0)]
            rows.append([name, _LABELS[arm], int(among.sum()), together, *means])
    return rows
