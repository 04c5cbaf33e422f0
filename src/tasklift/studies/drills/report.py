"""What the study of drills came to: contrasts with intervals and verdicts, a figure, a page, a Markdown fragment."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
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

#: T is solved "at least as often" if the share of its counted trials that succeed is not lower, and its interval rules
#: out that it is lower by this much. Whole runs fail or succeed: with 600 the interval is about ± 2.5 points wide.
MARGIN = 0.05
#: A variant of drilling is admitted if it loses at most this share of what drills as they are lose.
ADMITTED = 0.1
BEGIN, END = "<!-- results of `tasklift drills` -->", "<!-- end of results -->"

Tables = dict[str, list["Contrast"]]


def with_hostiles(number: int) -> str:
    """Return a number of hostiles in words."""
    return f"{number} hostile{'s' if number > 1 else ''}"


@dataclass(frozen=True)
class Contrast:
    """An arm against direct learning with the same signals and selection, at equal total trials.

    Attributes
    ----------
    hostiles, arm, total, n
        Which; trials of every kind of both; pairs of runs.
    lost, lost_direct
        Robots lost in all trials on T, per run.
    late, late_direct
        Robots lost in the last 100 trials on T, per run: direct has learned on T in those before.
    all_share, late_share, first_share
        The arm's share of the robots that both lose together (0.5: as many): over all trials; over the last 100 of
        both; and over the last 100 of the arm against the *first* 100 of direct, which charges nothing for drills.
    solved, solved_direct, solved_difference
        Share of the counted trials that succeed, and the arm's less direct's.
    steps, steps_direct
        Per counted trial.
    would_be
        Losses in drills per run.
    """

    hostiles: int
    arm: str
    total: int
    n: int
    lost: float
    lost_direct: float
    late: float
    late_direct: float
    all_share: stats.Interval
    late_share: stats.Interval
    first_share: stats.Interval
    solved: float
    solved_direct: float
    solved_difference: stats.Interval
    steps: float
    steps_direct: float
    would_be: float | None

    def verdict(self, share: stats.Interval) -> stats.Verdict:
        """Whether the arm loses fewer robots and T is solved at least as often (:data:`MARGIN`)."""
        fewer = stats.verdict(share, "less", 0.5)
        solved = self.solved_difference
        if fewer == "holds" and solved.estimate >= 0 and solved.low > -MARGIN:
            return "holds"
        return "does not hold" if fewer == "does not hold" or solved.high < 0 else "undecided"

    @property
    def holds(self) -> bool:
        """Whether the contrast over all trials holds: what a headline needs."""
        return self.verdict(self.all_share) == "holds"


def share_of_losses(arm: Floats, direct: Floats, axis: int = -1) -> Any:
    """Return the arm's share of what both lost; a half where nobody lost anything."""
    a, b = arm.sum(axis=axis), direct.sum(axis=axis)
    return np.where(a + b > 0, a / np.maximum(a + b, 1e-300), 0.5)


def contrast(arm: Sample, direct: Sample, *, name: str, hostiles: int, resamples: int = 4000) -> Contrast:
    """Compare two arms that share maps and seeds row by row; direct must have run as many trials in total.

    Parameters
    ----------
    arm, direct
        What they did.
    name
        Slug of the arm.
    hostiles
        How many.
    resamples
        Bootstrap resamples per interval.

    Raises
    ------
    TaskliftError
        If direct has fewer trials, or the two are not paired.
    """
    total = arm.total
    if direct.losses.shape[1] < total or not arm.paired_with(direct):
        raise TaskliftError(f"{name}: direct learning has {direct.losses.shape} trials, expected {total} paired ones")
    late, strata = slice(total - COUNTED, total), arm.strata
    lost, lost_direct = arm.losses.sum(axis=1), direct.losses[:, :total].sum(axis=1)
    last, last_direct = arm.losses[:, -COUNTED:].sum(axis=1), direct.losses[:, late].sum(axis=1)
    solved, solved_direct = arm.success[:, -COUNTED:].mean(axis=1), direct.success[:, late].mean(axis=1)

    def share(a: Floats, b: Floats) -> stats.Interval:
        return stats.bootstrap(share_of_losses, a, b, strata=strata, resamples=resamples)

    return Contrast(
        hostiles=hostiles,
        arm=name,
        total=total,
        n=len(lost),
        lost=float(lost.mean()),
        lost_direct=float(lost_direct.mean()),
        late=float(last.mean()),
        late_direct=float(last_direct.mean()),
        all_share=share(lost, lost_direct),
        late_share=share(last, last_direct),
        first_share=share(last, direct.losses[:, :COUNTED].sum(axis=1)),
        solved=float(solved.mean()),
        solved_direct=float(solved_direct.mean()),
        solved_difference=stats.paired_difference(solved, solved_direct, strata=strata, resamples=resamples),
        steps=float(arm.steps[:, -COUNTED:].mean()),
        steps_direct=float(direct.steps[:, late].mean()),
        would_be=None if arm.would_be is None else float(arm.would_be.sum(axis=1).mean()),
    )


def contrasts(store: Store, arms: Sequence[str], *, resamples: int = 4000) -> list[Contrast]:
    """Compare every arm of the store that is named with the direct learning it is judged against, by hostiles."""
    there = {(int(cell["hostiles"]), cell["arm"]) for cell in store.done()}
    numbers = sorted({hostiles for hostiles, _ in there})
    found = []
    for arm in arms:
        (reference,) = ARMS[arm].against
        for hostiles in numbers:
            if {(hostiles, arm), (hostiles, reference)} <= there:
                first, second = (Sample.of(store, slug, hostiles=str(hostiles)) for slug in (arm, reference))
                found.append(contrast(first, second, name=arm, hostiles=hostiles, resamples=resamples))
    return found


def times(value: float) -> str:
    """Return how many times fewer robots a share of losses means, in two or three digits."""
    if value <= 0:
        return "∞"
    ratio = (1 - value) / value
    return f"{ratio:,.0f}" if ratio >= 99.5 else f"{ratio:.2g}" if ratio >= 9.95 else f"{ratio:.1f}"


def times_fewer(share: stats.Interval) -> str:
    """Return ``"12 [10, 14]"``: direct's losses over the arm's, with its interval; below 1, the arm loses more."""
    return f"{times(share.estimate)} [{times(share.high)}, {times(share.low)}]"


HEADERS = (
    "arm", "hostiles", "total trials", "robots lost: arm, direct", "times fewer", "holds",
    "in the last 100: arm, direct", "times fewer", "holds", "times fewer than in direct's first 100",
    "solved (%): arm, direct", "difference (points)", "steps: arm, direct", "would-be losses",
)  # fmt: skip


def rows(found: Sequence[Contrast]) -> list[list[Any]]:
    """Return one row per contrast, as under :data:`HEADERS`."""
    table = []
    for c in found:
        points = (100 * c.solved_difference.estimate, 100 * c.solved_difference.low, 100 * c.solved_difference.high)
        table.append(
            [ARMS[c.arm].label, c.hostiles, c.total,
             f"{c.lost:.3g}, {c.lost_direct:.3g}", times_fewer(c.all_share), c.verdict(c.all_share),
             f"{c.late:.3g}, {c.late_direct:.3g}", times_fewer(c.late_share), c.verdict(c.late_share),
             times_fewer(c.first_share), f"{100 * c.solved:.1f}, {100 * c.solved_direct:.1f}",
             "{:+.1f} [{:+.1f}, {:+.1f}]".format(*points), f"{c.steps:.0f}, {c.steps_direct:.0f}",
             None if c.would_be is None else round(c.would_be)]
        )  # fmt: skip
    return table


def headline(found: Sequence[Contrast]) -> list[str]:
    """Say in a line per arm which contrasts hold, each with its interval, the strongest arm first; or that none does.

    Parameters
    ----------
    found
        Contrasts of the main arms, T at q = .9.
    """
    arms = dict.fromkeys(c.arm for c in found)
    by_arm = {arm: [c for c in found if c.arm == arm] for arm in arms}
    # most contrasts that hold, then fewest robots lost
    order = sorted(arms, key=lambda arm: (-sum(c.holds for c in by_arm[arm]), sum(c.lost for c in by_arm[arm])))
    lines, rest_of_arms = [], []
    for arm in order:
        held = [c for c in by_arm[arm] if c.holds]
        if held:
            ratios = "; ".join(f"{times_fewer(c.all_share)} times fewer with {with_hostiles(c.hostiles)}" for c in held)
            rest = ", ".join(with_hostiles(c.hostiles) for c in by_arm[arm] if not c.holds)
            lines.append(
                f"**{ARMS[arm].label}: fewer robots lost than by direct learning** with the same signals in as "
                f"many trials in all, and T solved at least as often: {ratios}."
                f"{f' Not so with {rest}.' if rest else ''} "
                f"{_late(by_arm[arm])}"
            )
        else:
            rest_of_arms.append(_not_shown(arm, by_arm[arm]))
    return (lines or ["**No contrast of drills with direct learning holds** at equal total trials."]) + rest_of_arms


def _not_shown(arm: str, of_arm: Sequence[Contrast]) -> str:
    """Say what an arm without any contrast that holds came to."""
    found = "; ".join(
        f"{times_fewer(c.all_share)} times fewer robots lost, T solved in {100 * c.solved:.0f} against "
        f"{100 * c.solved_direct:.0f} % of trials, with {with_hostiles(c.hostiles)}: {c.verdict(c.all_share)}"
        for c in of_arm
    )
    return f"**{ARMS[arm].label}: no contrast holds.** {found}."


def _late(of_arm: Sequence[Contrast]) -> str:
    """Say how the last 100 trials compare, where direct has learned on T itself for as long as others drilled."""
    verdicts = [(c, c.verdict(c.late_share)) for c in of_arm]
    words = {"holds": "fewer", "does not hold": "more, or T solved less often,", "undecided": "undecided"}
    parts = []
    for verdict, word in words.items():
        those = [f"{c.hostiles} ({times_fewer(c.late_share)})" for c, v in verdicts if v == verdict]
        if those:
            parts.append(f"{word} with {', '.join(those)}")
    return (
        f"In the last {COUNTED} trials alone, where direct has learned on T for 300, by hostiles (times fewer): "
        f"{'; '.join(parts)}."
    )


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
            points.append(stats.bootstrap(np.mean, sample.losses.sum(axis=1), strata=sample.strata))
        spread = np.array([[p.estimate - p.low for p in points], [p.high - p.estimate for p in points]])
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
    band = stats.mean_band(blocks, strata=sample.strata, resamples=1000)
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
        (page.parent / "pictures").mkdir(exist_ok=True)
        pictures.save(drawn, page.parent / "pictures", "drills")
    return says, folder / "report.html"


def _tables(store: Store) -> Tables:
    """Return the contrasts by the title of their table, the main ones first."""
    asked = {f"300 drills, T at {words}": main_arms(selection)[1:] for selection, words in SELECTIONS.items()}
    for selection, words in SELECTIONS.items():
        asked[f"other numbers of drills, T at {words}"] = amounts(selection)
        asked[f"with V and with the prior, T at {words}"] = starts(selection)
    return {title: contrasts(store, arms) for title, arms in asked.items()}


def _scale(plan: Study) -> str:
    few = min(len(part.seeds) for part in plan.parts)
    most = len(plan.parts[0].seeds)
    return (
        f"{len(plan.buildings)} generated buildings; {most} seeds each for 300 drills with T at q = .9, "
        f"{few} for the rest. 95 % intervals: BCa bootstrap, seeds resampled within maps. A contrast *holds* if the "
        "whole interval of *times fewer* lies above 1 and T is solved at least as often: the difference is not below "
        f"0, its whole interval above −{100 * MARGIN:.0f} points."
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
        "learn what would lose them. Every arm is held against direct learning with the same loss signal "
        f"({LOSS_SIGNAL}) and the same selection rule on T, at equal total trials: for every drill (and every "
        "traversal of V) direct learning gets one more trial on T, whose losses count."
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
