"""What the study of drills came to: contrasts with intervals and verdicts, a figure, a page, a Markdown fragment."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from tasklift import stats, style
from tasklift.errors import TaskliftError
from tasklift.files import output_folder, read_text, write_atomically
from tasklift.lab import FILE_NAME, Progress, Store, run
from tasklift.lab.runs import Table
from tasklift.report import pictures
from tasklift.report.page import Report
from tasklift.studies.arms import ARMS, COUNTED, LOSS_SIGNAL, SELECTIONS, SPENT_BEFORE
from tasklift.studies.drills.study import amounts, choosing, main_arms, starts, study, variants
from tasklift.studies.report import add_arms, add_settings, markdown_table
from tasklift.studies.samples import Floats, Sample
from tasklift.studies.study import Study

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

#: T is solved "at least as often" if the share of trials that succeed is not lower, and is shown not to be lower by
#: this much. Whole runs fail or succeed: with 600 the interval is about ± 2.5 points wide.
MARGIN = 0.05
#: A variant of drilling is admitted if it loses at most this share of what drills as they are lose.
ADMITTED = 0.1
BEGIN, END = "<!-- results of `tasklift drills` -->", "<!-- end of results -->"

Tables = dict[str, list["Contrast"]]


def with_hostiles(number: int) -> str:
    """Return a number of hostiles in words."""
    return f"{number} hostile{'s' if number > 1 else ''}"


@dataclass(frozen=True)
class Against:
    """An arm's 100 trials on T against some of direct learning's.

    Attributes
    ----------
    lost, solved
        Direct's robots lost per run, and its share of trials that succeed.
    fewer
        How many times as many robots direct loses, with its interval; the verdict asks that the arm loses fewer *and*
        solves T at least as often (:data:`MARGIN`).
    difference
        Share of trials solved, the arm's less direct's.
    """

    lost: float
    solved: float
    fewer: stats.Comparison
    difference: stats.Comparison

    @classmethod
    def of(cls, arm: Sample, losses: Floats, success: Floats, **options: Any) -> Against:
        """Compare an arm's losses on T with direct's losses, and its successes with those of direct's last 100."""
        lost, direct = arm.losses.sum(axis=1), losses.sum(axis=1)
        solved, direct_solved = arm.success.mean(axis=1), success.mean(axis=1)
        fewer = stats.ratio(direct, lost, better="greater", strata=arm.maps, **options)
        less = stats.compare(solved, direct_solved, better="greater", strata=arm.maps, **options)
        as_often = stats.compare(
            solved, direct_solved, better="greater", reference=-MARGIN, strata=arm.maps, **options
        )
        if fewer.favours and less.estimate >= 0:
            found = replace(fewer, p=max(fewer.p, as_often.p if as_often.favours else 1.0))
        else:  # more lost, or solved less often: whichever is shown
            against = [1.0 if one.favours else one.p for one in (fewer, less)]
            found = replace(fewer, p=min(1.0, 2 * min(against)), favours=False)
        return cls(float(direct.mean()), float(success.mean()), found, less)


@dataclass(frozen=True)
class Contrast:
    """An arm against direct learning with the same signals and selection, after arrival on T.

    Attributes
    ----------
    hostiles, arm, n
        Which; pairs of runs.
    safe, dangerous
        Trials that each costs: safe ones (V's traversals and drills), and the arm's on T.
    lost, solved, steps
        The arm's on T: robots lost per run, share of trials that succeed, mean steps.
    first
        Against direct's first trials on T, as many as the arm's: for both they are the first where it is dangerous.
    last
        Against direct's last trials on T, as many: direct has learned on T for as long as the arm drilled.
    everything
        Against all of direct's trials, as many as the arm's of every kind.
    would_be
        Losses in drills per run.
    """

    hostiles: int
    arm: str
    n: int
    safe: int
    dangerous: int
    lost: float
    solved: float
    steps: float
    first: Against
    last: Against
    everything: Against
    would_be: float | None

    @property
    def holds(self) -> bool:
        """Whether the arm loses fewer robots both against direct's first and its last trials on T."""
        return self.first.fewer.verdict == self.last.fewer.verdict == "holds"


def contrast(arm: Sample, direct: Sample, *, name: str, hostiles: int, **options: Any) -> Contrast:
    """Compare two arms that share maps and seeds row by row; direct must have run as many trials in total.

    Parameters
    ----------
    arm, direct
        What they did.
    name
        Slug of the arm.
    hostiles
        How many.
    options
        ``seed`` and ``resamples``, as in :func:`tasklift.stats.compare`.

    Raises
    ------
    TaskliftError
        If direct has fewer trials, or the two are not paired.
    """
    total, own = arm.total, arm.losses.shape[1]
    if direct.losses.shape[1] < total or not arm.paired_with(direct):
        raise TaskliftError(f"{name}: direct learning has {direct.losses.shape} trials, expected {total} paired ones")
    last = direct.success[:, total - own : total]
    return Contrast(
        hostiles=hostiles,
        arm=name,
        n=len(arm.losses),
        safe=total - own,
        dangerous=own,
        lost=float(arm.losses.sum(axis=1).mean()),
        solved=float(arm.success.mean()),
        steps=float(arm.steps.mean()),
        first=Against.of(arm, direct.losses[:, :own], direct.success[:, :own], **options),
        last=Against.of(arm, direct.losses[:, total - own : total], last, **options),
        everything=Against.of(arm, direct.losses[:, :total], last, **options),
        would_be=None if arm.would_be is None else float(arm.would_be.sum(axis=1).mean()),
    )


def contrasts(store: Store, arms: Sequence[str], **options: Any) -> list[Contrast]:
    """Compare every arm of the store that is named with the direct learning it is judged against, by hostiles."""
    there = {(int(cell["hostiles"]), cell["arm"]) for cell in store.done()}
    numbers = sorted({hostiles for hostiles, _ in there})
    found = []
    for arm in arms:
        (reference,) = ARMS[arm].against
        for hostiles in numbers:
            if {(hostiles, arm), (hostiles, reference)} <= there:
                first, second = (Sample.of(store, slug, hostiles=str(hostiles)) for slug in (arm, reference))
                found.append(contrast(first, second, name=arm, hostiles=hostiles, **options))
    return found


def after_holm(tables: Tables) -> Tables:
    """Return the tables with p-values, and so verdicts, for all of them together (Holm 1979)."""
    asked = [getattr(c, name) for of in tables.values() for c in of for name in _AGAINST]
    found = iter(stats.after_holm([one.fewer for one in asked]))
    return {
        title: [
            replace(c, **{name: replace(getattr(c, name), fewer=next(found)) for name in _AGAINST}) for c in of
        ]
        for title, of in tables.items()
    }


_AGAINST = ("first", "last", "everything")


def times(ratio: float) -> str:
    """Return how many times as many, in two or three digits."""
    return f"{ratio:,.0f}" if ratio >= 99.5 else f"{ratio:.2g}" if ratio >= 9.95 else f"{ratio:.1f}"


def times_fewer(found: stats.Comparison) -> str:
    """Return ``"12 [10, 14]"``: direct's losses over the arm's, with its interval; below 1, the arm loses more."""
    interval = found.interval
    if not np.isfinite(interval.estimate):
        return "none lost"
    if np.isfinite(interval.high):
        return f"{times(interval.estimate)} [{times(max(interval.low, 0.0))}, {times(interval.high)}]"
    bound = f"at least {times(interval.low)}" if np.isfinite(interval.low) else "no interval"
    return f"{times(interval.estimate)} ({bound})"


HEADERS = (
    "arm", "hostiles", "trials: safe + dangerous", "robots lost",
    "direct, first 100", "times fewer", "holds", "direct, last 100", "times fewer", "holds",
    "direct, all of as many trials", "times fewer", "solved (%)", "less direct's in its last 100 (points)", "steps",
    "would-be losses",
)  # fmt: skip


def rows(found: Sequence[Contrast]) -> list[list[Any]]:
    """Return one row per contrast, as under :data:`HEADERS`."""
    table = []
    for c in found:
        solved = c.last.difference.interval
        points = (100 * solved.estimate, 100 * solved.low, 100 * solved.high)
        ends = " [{1:+.1f}, {2:+.1f}]" if np.isfinite(points).all() else ""
        table.append(
            [ARMS[c.arm].label, c.hostiles, f"{c.safe} + {c.dangerous}", f"{c.lost:.3g}",
             f"{c.first.lost:.3g}", times_fewer(c.first.fewer), c.first.fewer.says,
             f"{c.last.lost:.3g}", times_fewer(c.last.fewer), c.last.fewer.says,
             f"{c.everything.lost:.3g} in {c.safe + c.dangerous}", times_fewer(c.everything.fewer),
             f"{100 * c.solved:.1f}", ("{0:+.1f}" + ends).format(*points), f"{c.steps:.0f}",
             None if c.would_be is None else round(c.would_be)]
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
    line = f"of those that lose at most {ADMITTED:.0%} of what the first one does, the most often solved: {slug}"
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
        A Markdown page between whose two marks the results are put, with the figure in ``pictures`` beside it.
    command
        The line that runs this again, for the report.
    progress, engine
        As in :func:`tasklift.lab.run`; also its ``workers`` and ``address``.

    Raises
    ------
    TaskliftError
        Before anything is trained or overwritten.
    """
    if page is not None:
        paste("", page, write=False)  # refuses before the work what cannot take the results
    plan, folder = study(maps=maps, seeds=seeds, hostiles=hostiles), output_folder(out, (FILE_NAME,))
    with Store.open(folder / FILE_NAME, plan.spec("drills")) as store:
        run(store, plan.cells(), plan.work, progress=progress, **engine)
        tables = _tables(store)
        main = next(iter(tables.values()))
        says = headline(main)
        drawn = figure(store, main, 3 if 3 in hostiles else hostiles[0])
        picture, _ = pictures.save(drawn, folder, "drills")
        text = markdown(says, tables, plan)
        write_atomically(folder / "drills.md", text)
        _report(says, tables, plan, picture, store, command).write(folder / "report.html")
    if page is not None:
        paste(text, page)
        pictures.save(drawn, output_folder(page.parent / "pictures"), "drills")
    return says, folder / "report.html"


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


def markdown(says: Sequence[str], tables: Tables, plan: Study) -> str:
    """Return the results as Markdown: the headline, the figure's place, every table."""
    parts = [*says, _scale(plan), "![Robots lost by number of hostiles, and learning curves](pictures/drills.png)"]
    for title, found in tables.items():
        if found:
            table = markdown_table(HEADERS, rows(found), missing="–").rstrip()
            parts.append(f"### {title[0].upper()}{title[1:]}\n\n{table}")
    return "\n\n".join(parts) + "\n"


def paste(text: str, page: Path, *, write: bool = True) -> None:
    """Put the results between the two marks of a Markdown page, in place of what is there.

    Raises
    ------
    TaskliftError
        If the page lacks the marks.
    """
    whole = read_text(page)
    before, begin, rest = whole.partition(BEGIN)
    _, end, after = rest.partition(END)
    if not begin or not end:
        raise TaskliftError(f"{page}: expected the marks {BEGIN} and {END}, one after the other; add them")
    if write:
        write_atomically(page, f"{before}{BEGIN}\n\n{text}\n{END}{after}")


def _report(
    says: Sequence[str], tables: Tables, plan: Study, picture: Path, store: Store, command: str
) -> Report:
    report = Report("Drills: practice against hostiles that repel")
    report.paragraph(
        "A drill keeps all of the task T, but its hostiles repel instead of destroying: nobody is lost while robots "
        "learn what would lose them. Every arm is compared with direct learning with the same loss signal "
        f"({LOSS_SIGNAL}) and the same selection rule on T: after arrival there, with direct's first trials and with "
        "its last, as many as the arm's. Direct learning has one more trial on T for every drill and traversal of V."
    )
    report.verdict(*says).paragraph(_scale(plan))
    report.figure(picture, "Means with 95 % intervals. Would-be losses lose nobody: they are what drills teach with.")
    for title, found in tables.items():
        if found:
            report.section(f"{title[0].upper()}{title[1:]}")
            report.table(
                HEADERS,
                rows(found),
                caption="Times fewer: direct's losses over the arm's; below 1, the arm loses more.",
            )
    add_arms(report, dict.fromkeys(arm for part in plan.parts for arm in part.arms))
    add_settings(report, store, command)
    return report
