"""What the study of drills came to: contrasts with intervals and verdicts, a figure, a page, a Markdown fragment."""

from __future__ import annotations

import time
from collections.abc import Iterator, Mapping, Sequence
from contextlib import nullcontext
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from tasklift import stats, style
from tasklift.errors import TaskliftError
from tasklift.files import output_file, output_folder, read_text, write_atomically
from tasklift.lab import FILE_NAME, Progress, Store, run
from tasklift.lab.runs import Table
from tasklift.report import pictures
from tasklift.report.charts import Row, Series
from tasklift.report.page import Link, Number, Report
from tasklift.studies.arms import ARMS, COUNTED, LOSS_SIGNAL, SELECTIONS, SPENT_BEFORE
from tasklift.studies.drills.contrasts import (
    MARGIN,
    Contrast,
    Tables,
    after_holm,
    contrasts,
    times_fewer,
    with_hostiles,
)
from tasklift.studies.drills.study import amounts, choosing, main_arms, starts, study, variants
from tasklift.studies.report import (
    Play,
    add_arms,
    add_replays,
    add_settings,
    large,
    mark_of,
    markdown_table,
    mean_of,
    smoothed,
    too_few,
)
from tasklift.studies.samples import Floats, Sample
from tasklift.studies.study import Study
from tasklift.text import number

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

#: A variant of drilling is admitted if it loses at most this share of what drills as they are lose.
ADMITTED = 0.1
BEGIN, END = "<!-- results of `tasklift drills` -->", "<!-- end of results -->"
#: Where the results on a page find their figure.
PICTURE = "pictures/drills.png"

#: By slug and number of hostiles.
Links = Mapping[tuple[str, int], Link | None]


LOSSES = (
    "arm", "hostiles", "robots lost", "direct's first", "times fewer", "verdict", "direct's last", "times fewer",
    "verdict",
)  # fmt: skip
PRICE = (
    "arm", "hostiles", "trials: safe + dangerous", "robots lost", "direct in as many", "times fewer", "solved (%)",
    "less direct's last (points)", "steps", "would-be losses",
)  # fmt: skip


def losses(found: Sequence[Contrast]) -> list[list[Any]]:
    """Return a row per contrast, as under :data:`LOSSES`: robots lost on T, against direct's first and last trials."""
    return [
        [ARMS[c.arm].label, c.hostiles, f"{c.lost:.3g}",
         f"{c.first.lost:.3g}", times_fewer(c.first.fewer), c.first.fewer.says,
         f"{c.last.lost:.3g}", times_fewer(c.last.fewer), c.last.fewer.says]
        for c in found
    ]  # fmt: skip


def prices(found: Sequence[Contrast]) -> list[list[Any]]:
    """Return a row per contrast, as under :data:`PRICE`: what is spent in all, and how well T is solved for it."""
    table = []
    for c in found:
        solved = c.last.difference.interval
        points = (100 * solved.estimate, 100 * solved.low, 100 * solved.high)
        ends = " [{1:+.1f}, {2:+.1f}]" if np.isfinite(points).all() else ""
        table.append(
            [ARMS[c.arm].label, c.hostiles, f"{c.safe} + {c.dangerous}", f"{c.lost:.3g}", f"{c.everything.lost:.3g}",
             times_fewer(c.everything.fewer), f"{100 * c.solved:.1f}", ("{0:+.1f}" + ends).format(*points),
             f"{c.steps:.0f}", None if c.would_be is None else round(c.would_be)]
        )  # fmt: skip
    return table


def headline(found: Sequence[Contrast]) -> list[str]:
    """Say in a line per arm what it loses after arrival on T, against direct's first and last trials, and the price.

    Parameters
    ----------
    found
        Contrasts of the main arms, T at q = .9; the arm that loses the fewest robots comes first.
    """
    arms = dict.fromkeys(c.arm for c in found)
    by_arm = {arm: [c for c in found if c.arm == arm] for arm in arms}
    order = sorted(arms, key=lambda arm: (-sum(c.holds for c in by_arm[arm]), sum(c.lost for c in by_arm[arm])))
    return [_of_arm(arm, by_arm[arm]) for arm in order]


def _of_arm(arm: str, of_arm: Sequence[Contrast]) -> str:
    one = of_arm[0]
    return (
        f"**{ARMS[arm].label}** arrives on T after {one.safe} safe trials. In its {one.dangerous} dangerous ones, "
        f"against direct learning's first {one.dangerous}: {_spread(of_arm, 'first')}. Against direct's last "
        f"{one.dangerous}, after {one.safe} dangerous ones more: {_spread(of_arm, 'last')}. The price: {one.safe} safe "
        f"and {one.dangerous} dangerous trials instead of {one.safe + one.dangerous} dangerous ones; robots lost in "
        "them, by hostiles: "
        + ", ".join(f"{c.lost:.3g} instead of {c.everything.lost:.3g} ({c.hostiles})" for c in of_arm)
        + "."
    )


def _spread(of_arm: Sequence[Contrast], name: str) -> str:
    """Say with how many hostiles fewer robots are lost, how many times fewer, and where not."""
    words = {"holds": "fewer", "does not hold": "more, or T solved less often,"}
    parts: dict[str, list[str]] = {}
    for c in of_arm:
        fewer = getattr(c, name).fewer
        parts.setdefault(words.get(fewer.verdict, fewer.says), []).append(
            f"{with_hostiles(c.hostiles)} ({times_fewer(fewer)} times)"
        )
    return "; ".join(f"{word} with {', '.join(those)}" for word, those in parts.items())


# ---------------------------------------------------------------- which drills are better


def chosen(store: Store) -> tuple[str, list[list[Any]]]:
    """Return the variant to take, and a row per variant: label, lost a trial by hostiles, solved, admitted.

    The rule: of the variants that lose at most a tenth of the robots that drills as they are lose (mean over 1 and 3
    hostiles), the one that solves T most often; the first in the list where they are equal.
    """
    slugs = variants()
    numbers = sorted({int(cell["hostiles"]) for cell in store.done()})
    samples = {slug: [Sample.of(store, slug, hostiles=str(h)) for h in numbers] for slug in slugs}
    lost = {slug: [float(s.losses.mean()) for s in of] for slug, of in samples.items()}
    solved = {slug: float(np.mean([s.success.mean() for s in of])) for slug, of in samples.items()}
    most = ADMITTED * float(np.mean(lost[slugs[0]]))
    admitted = [slug for slug in slugs if np.mean(lost[slug]) <= most] or list(slugs[:1])
    table = [
        [ARMS[slug].label, *(round(x, 3) for x in lost[slug]), round(100 * solved[slug], 1), slug in admitted]
        for slug in slugs
    ]
    return max(admitted, key=lambda slug: solved[slug]), table


def choose(
    *,
    out: Path,
    progress: Progress | None = None,
    **engine: Any,
) -> tuple[str, Table]:
    """Run the study of the variants; return which to take, in a line, and their table.

    Parameters
    ----------
    out
        Folder; one that holds this very experiment is resumed, any other content is refused.
    progress, engine
        As in :func:`tasklift.lab.run`; also its ``workers`` and ``address``.
    """
    plan = choosing()
    with Store.open(output_folder(out, (FILE_NAME,)) / FILE_NAME, plan.spec("choosing drills")) as store:
        run(store, plan.cells(), plan.work, progress=progress, **engine)
        slug, rows = chosen(store)
    lost = [f"robots lost a trial, {with_hostiles(int(h))}" for h in plan.conditions]
    line = f"of those that lose at most {100 * ADMITTED:g} % of what the first one does, the most often solved: {slug}"
    return line, Table("300 drills, T at q = .9", ["drills", *lost, "solved (%)", "admitted"], rows)


# ---------------------------------------------------------------- the figure


_MARKERS = ("o", "s", "D", "^")


@pictures.styled
def figure(store: Store, found: Sequence[Contrast], curves_for: int) -> Figure:
    """Draw robots lost by number of hostiles, with intervals, and the learning curves of losses; logarithmic.

    Parameters
    ----------
    found
        The main contrasts, T at q = .9.
    curves_for
        The number of hostiles of the learning curves.
    """
    page = pictures.page(pictures.PAGE, 3.2)
    left, right = page.subplots(1, 2, width_ratios=(2, 3))
    numbers = sorted({c.hostiles for c in found})
    for i, arm in enumerate(main_arms("q90")):
        colour = style.look(arm).line["color"]
        at, points = [], []
        for hostiles in numbers:
            sample = Sample.of(store, arm, hostiles=str(hostiles))
            at.append(hostiles + 0.12 * (i - 1.5))
            points.append(stats.compare(sample.losses.sum(axis=1), strata=sample.maps).interval)
        spread = np.array([[p.estimate - p.low for p in points], [p.high - p.estimate for p in points]])
        spread[~np.isfinite(spread)] = np.nan  # not bounded on that side: no bar
        left.errorbar(
            at, [p.estimate for p in points], spread.clip(0), label=ARMS[arm].label, lw=1, ms=3.5, capsize=2,
            color=colour, marker=_MARKERS[i],
        )  # fmt: skip
        _learning_curve(right, Sample.of(store, arm, hostiles=str(curves_for)), colour)
    left.set_yscale("symlog", linthresh=1)
    left.set_ylim(bottom=0)
    left.set_xticks(numbers)
    left.set_xlabel("hostiles")
    left.set_ylabel("robots lost in all trials of a run")
    left.set_title(f"(a) {COUNTED + SPENT_BEFORE} trials of every kind each")
    right.set_yscale("symlog", linthresh=0.01)
    right.set_ylim(bottom=0)
    right.set_xlabel("trial, V and drills included")
    right.set_ylabel("lost a trial (mean of 10)")
    right.set_title(f"(b) {with_hostiles(curves_for)}; dotted: would be lost, in drills")
    for ax in (left, right):
        ax.grid(axis="y")
    handles, labels = left.get_legend_handles_labels()
    page.legend(handles, labels, loc="outside upper center", ncols=len(labels))
    return page


def _learning_curve(ax: Axes, sample: Sample, colour: str) -> None:
    begin = sample.total - sample.losses.shape[1]
    if sample.would_be is not None:
        blocks = _tens(sample.would_be)
        at = begin - sample.would_be.shape[1] + np.arange(blocks.shape[1]) * 10 + 5
        ax.plot(at, blocks.mean(axis=0), ":", color=colour, lw=1)
    blocks = _tens(sample.losses)
    at = begin + np.arange(blocks.shape[1]) * 10 + 5
    band = stats.mean_band(blocks, strata=sample.maps)
    ax.fill_between(at, band.low, band.high, color=colour, alpha=0.15, linewidth=0)
    ax.plot(at, band.estimate, color=colour, lw=1.2)


def _tens(values: Floats) -> Floats:
    """Return the means of ten trials after ten, ``(n, T // 10)``."""
    n = values.shape[1] // 10
    return values[:, : 10 * n].reshape(len(values), n, 10).mean(axis=2)


# ---------------------------------------------------------------- the command


def drills(
    *,
    out: Path,
    maps: int = 12,
    seeds: int = 50,
    hostiles: Sequence[int] = (1, 2, 3, 4, 5),
    page: Path | None = None,
    command: str = "",
    progress: Progress | None = None,
    play: Play | None = None,
    **engine: Any,
) -> tuple[list[str], Path]:
    """Measure drills; return the headline, a line per arm, and the path of ``report.html``.

    Parameters
    ----------
    out
        Folder; one that holds this very experiment is resumed, any other content is refused.
    maps, seeds, hostiles
        As in :func:`tasklift.studies.drills.study.study`.
    page
        A Markdown page between whose two marks the results are put, with the figure in ``pictures`` beside it. A
        picture of that name that is there is replaced if the results on the page show it, and else refused.
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
    plan = study(maps=maps, seeds=seeds, hostiles=hostiles)
    if page is not None:  # refuses before the work what cannot take the results
        ours = PICTURE in results_on(page)[1]
        picture = output_file(output_folder(page.parent / "pictures") / Path(PICTURE).name, force=ours)
    folder = output_folder(out, (FILE_NAME,))
    with Store.open(folder / FILE_NAME, plan.spec("drills")) as store:
        run(store, plan.cells(), plan.work, progress=progress, **engine)
        tables = _tables(store)
        main = next(iter(tables.values()))
        says = headline(main)
        lines = [line.replace("**", "") for line in (in_a_sentence(main), *says)]
        drawn = figure(store, main, 3 if 3 in hostiles else hostiles[0])
        pictures.save(drawn, folder, "drills")
        text = markdown(lines[0], tables, plan)
        write_atomically(folder / "drills.md", text)
        written = _report(says, tables, plan, store, _replays(plan, main, folder, play))
        add_settings(written, store, command, since)
        written.write(folder / "report.html")
    if page is not None:
        before, _, after = results_on(page)
        write_atomically(page, f"{before}{BEGIN}\n\n{text}\n{END}{after}")
        write_atomically(picture, (folder / picture.name).read_bytes())
    return lines, folder / "report.html"


def _tables(store: Store) -> Tables:
    """Return the contrasts by the title of their table, the main ones first."""
    asked = {f"300 drills, T at {words}": main_arms(selection)[1:] for selection, words in SELECTIONS.items()}
    for selection, words in SELECTIONS.items():
        asked[f"other numbers of drills, T at {words}"] = amounts(selection)
        asked[f"with V and with the prior, T at {words}"] = starts(selection)
    tables: Tables = {}
    for title, arms in asked.items():  # each table is one question; random signs cannot tell hundreds of them apart
        tables |= after_holm({title: contrasts(store, arms)})
    return tables


def _scale(plan: Study) -> str:
    few = min(len(part.seeds) for part in plan.parts)
    most = len(plan.parts[0].seeds)
    return (
        f"{len(plan.buildings)} generated buildings; {most} seeds each for 300 drills with T at q = .9, "
        f"{few} for the rest. Intervals are 95 % each, the spread measured within maps. *Holds*, at 5 % for each table "
        "together (Holm): fewer robots are lost than by direct learning, and T is solved at least as often as in those "
        f"trials of direct learning (not less often, and shown not to be by {100 * MARGIN:.0f} points)."
    )


def markdown(says: str, tables: Tables, plan: Study) -> str:
    """Return the results as Markdown: a sentence, the figure's place, every table in two; all but the first folded."""
    picture = f"![Robots lost by number of hostiles, and learning curves]({PICTURE})"
    parts = [f"**{says}**", picture, _scale(plan)]
    for k, (title, found) in enumerate((title, found) for title, found in tables.items() if found):
        name = f"{title[0].upper()}{title[1:]}"
        parts.append(f"<details markdown>\n<summary>{name}</summary>" if k else f"### {name}")
        for headers, rows in ((LOSSES, losses(found)), (PRICE, prices(found))):
            parts.append(markdown_table(headers, rows, missing="–").rstrip())
        parts += ["</details>"] if k else []
    return "\n\n".join(parts) + "\n"


def results_on(page: Path) -> tuple[str, str, str]:
    """Return what stands before, between and after the two marks of a Markdown page.

    Raises
    ------
    TaskliftError
        If the page lacks the marks.
    """
    whole = read_text(page)
    before, begin, rest = whole.partition(BEGIN)
    results, end, after = rest.partition(END)
    if not begin or not end:
        raise TaskliftError(f"{page}: expected the marks {BEGIN} and {END}, one after the other; add them")
    return before, results, after


def _replays(plan: Study, found: Sequence[Contrast], folder: Path, play: Play | None) -> Links:
    """Write a replay per contrast and its direct learning, on the first map with the first seed; return the links."""
    asked = {(arm, c.hostiles) for c in found for arm in (c.arm, *ARMS[c.arm].against)}
    first = plan.parts[0]
    cells = {at: plan.cell(str(at[1]), first.maps[0], first.seeds[0], at[0]) for at in sorted(asked)}
    links = add_replays(plan, folder, cells.values(), play)
    return {at: links[cell] for at, cell in cells.items()}


def in_a_sentence(found: Sequence[Contrast]) -> str:
    """Say in one sentence what the arm that loses fewest robots is worth, with the fewest hostiles."""
    one = _best(found)
    verdict = {"holds": "Practice saves robots", "does not hold": "Practice does not save robots, or costs successes"}
    return (
        f"{verdict.get(one.first.fewer.verdict, 'Whether practice saves robots is undecided')}: after {one.safe} safe "
        f"episodes, {one.dangerous} dangerous ones cost **{number(one.lost, 3)} robots**; learning from scratch loses "
        f"{number(one.first.lost, 3)} in as many and {number(one.everything.lost, 3)} in as many of both kinds."
    )


def _best(found: Sequence[Contrast]) -> Contrast:
    """Return the contrast with the fewest hostiles whose arm loses the fewest robots in all."""
    total = {c.arm: sum(one.lost for one in found if one.arm == c.arm) for c in found}
    return min(found, key=lambda c: (total[c.arm], c.hostiles))


def _numbers(found: Sequence[Contrast]) -> list[Number]:
    one = _best(found)
    where = f"({ARMS[one.arm].label}, {with_hostiles(one.hostiles)})"
    solved = one.last.difference.interval
    points = stats.Interval(100 * solved.estimate, 100 * solved.low, 100 * solved.high, solved.confidence, solved.n)
    return [
        _times(one.first.fewer, f"than by direct's first {one.dangerous} episodes {where}"),
        _times(one.last.fewer, f"than by its last {one.dangerous}, after {one.safe} more dangerous ones"),
        large(points, f"points more episodes solved than by direct's last {one.dangerous}"),
    ]


def _times(found: stats.Comparison, than: str) -> Number:
    value, _, rest = times_fewer(found).partition(" ")
    if value == "none":
        return Number("0", "", f"robots lost, fewer {than}")
    return Number(value, rest, f"times fewer robots lost {than}")


def _lost(store: Store, found: Sequence[Contrast]) -> Iterator[tuple[int, list[Row]]]:
    """Yield for each number of hostiles a row per arm: robots lost per run, in its episodes on T."""
    for hostiles in dict.fromkeys(c.hostiles for c in found):
        rows = []
        for arm in dict.fromkeys(arm for c in found for arm in (*ARMS[c.arm].against, c.arm)):
            sample = Sample.of(store, arm, hostiles=str(hostiles))
            lost = mean_of(sample, sample.losses.sum(axis=1))
            text = f"in {sample.losses.shape[1]}; {100 * sample.success[:, -COUNTED:].mean():.0f} % solved"
            rows.append(Row(ARMS[arm].label, [mark_of(lost, arm)], text))
        yield hostiles, rows


def _report(says: Sequence[str], tables: Tables, plan: Study, store: Store, links: Links) -> Report:
    report, main = Report("Drills: practice against hostiles that repel"), next(iter(tables.values()))
    report.headline(in_a_sentence(main), _numbers(main))
    too_few(report, [one.fewer for c in main for one in (c.first, c.last)])
    for k, (hostiles, lost) in enumerate(_lost(store, main)):
        with report.fold(with_hostiles(hostiles)) if k else nullcontext():
            ends = [end for row in lost for mark in row.marks for end in (mark.at, mark.high)]
            most = max(end for end in ends if np.isfinite(end))
            report.rows(lost, title=f"Robots lost per run, {with_hostiles(hostiles)}", label="robots", within=(0, most))
    report.section("By number of hostiles")
    report.table(*_at_a_glance(main, links), caption="Fewer: direct's losses over the arm's; below 1, the arm loses "
                 "more. ✓ also asks that the full task T is solved at least as often.")  # fmt: skip
    report.paragraph(_scale(plan))
    with report.fold("In words"):
        report.verdict(*says)
        report.paragraph(
            "A drill keeps all of the task T, but its hostiles repel instead of destroying: nobody is lost while "
            "robots learn what would lose them. Every arm is compared with direct learning with the same loss signal "
            f"({LOSS_SIGNAL}) and the same selection rule on T: after arrival there, with direct's first trials and "
            "with its last, as many as the arm's. Direct learning has one more trial on T for every drill and "
            "traversal of V."
        )
    report.section("Learning curves")
    report.curves(_learning(store, main), title=f"Robots lost per episode, {with_hostiles(main[0].hostiles)}",
                  x_label="episode (trial), the safe ones included", y_label="robots lost", caption="Running means of "
                  "10. A line begins where its method meets the dangerous task; before, nobody is lost.")  # fmt: skip
    report.section("All comparisons")
    for title, found in tables.items():
        if found:
            with report.fold(f"{title[0].upper()}{title[1:]}"):
                report.table(LOSSES, losses(found))
                report.table(PRICE, prices(found))
    add_arms(report, dict.fromkeys(arm for part in plan.parts for arm in part.arms))
    return report


def _learning(store: Store, found: Sequence[Contrast]) -> list[Series]:
    """Return robots lost per dangerous episode of each arm, with the fewest hostiles."""
    series = []
    for arm in dict.fromkeys(arm for c in found for arm in (*ARMS[c.arm].against, c.arm)):
        sample = Sample.of(store, arm, hostiles=str(found[0].hostiles))
        before = sample.total - sample.losses.shape[1]
        series.append(smoothed(sample.losses, sample.maps, ARMS[arm], most=sample.n_robots, before=before))
    return series


def _at_a_glance(found: Sequence[Contrast], links: Links) -> tuple[list[str], list[list[Any]]]:
    headers = [
        "method", "hostiles", "fewer than direct's first", "verdict", "fewer than direct's last", "verdict", "play",
        "direct",
    ]  # fmt: skip
    body: list[list[Any]] = []
    for c in found:
        (reference,) = ARMS[c.arm].against
        body.append(
            [ARMS[c.arm].label, c.hostiles, times_fewer(c.first.fewer), c.first.fewer.says, times_fewer(c.last.fewer),
             c.last.fewer.says, links[c.arm, c.hostiles], links[reference, c.hostiles]]
        )  # fmt: skip
    return headers, body
