"""The answer of the search: sentences, tables, a picture of the tasks, and the recommended curriculum as a spec."""

from __future__ import annotations

import os
import textwrap
from collections.abc import Mapping
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from tasklift import stats
from tasklift.errors import about
from tasklift.files import canonical_json, results_folder, write_atomically
from tasklift.lab import FILE_NAME, Progress
from tasklift.lab.runs import Table
from tasklift.report import pictures
from tasklift.studies.simplify.search import RUNGS, SCRATCH, Found, Measures, Raced, SimplifyStudy, study_of
from tasklift.studies.simplify.space import Candidate, Step
from tasklift.style import GROUND

if TYPE_CHECKING:
    from matplotlib.figure import Figure

#: Rows of the picture: the ones with the best tasks, where there are more.
MOST_ROWS = 40
AS_IT_IS = "the world as it is"


@dataclass(frozen=True)
class Answer:
    """What the search came to, and how to say it.

    Attributes
    ----------
    found
        The search's result.
    criterion
        What was compared.
    document
        The recommended curriculum, as a spec.
    """

    found: Found
    criterion: str
    document: Mapping[str, Any]

    @property
    def best(self) -> Candidate | None:
        """The candidate to learn first; None: learn the target task from scratch."""
        return self.found.best

    @property
    def lines(self) -> list[str]:
        """The answer in sentences: what to learn first and what it saves, then what the search cost."""
        found, measure = self.found, self.criterion.replace("-", " ")
        tried = f"The search tried {found.tried} simpler tasks and spent {found.episodes:,} episodes"
        if not found.judged:
            return ["Nothing helps: learn the task from scratch.", f"{tried}."]
        n = len(found.judge.success)
        said = f"on {n} new seeds, {measure} against learning from scratch: {found.against_scratch()}"
        if found.best is not None:
            first = f"Learn this first: {found.best.words}. It saves, {said}."
        else:
            why = "" if found.judged[0].allowed else "; it solves the task less often, or costs more than allowed"
            best = found.judged[0].candidate.words
            first = f"Nothing helps: learn the task from scratch. The best of the candidates is {best}; {said}{why}."
        if found.runner_up is not None:
            less, success = found.regret(found.runner_up)
            other = found.runner_up.candidate.words
            tried += f". Its choice against the best of the others judged, {other}: {measure} {less.interval}"
            tried += f", late success {success.interval}"
        return [first, f"{tried}.", *(f"left out: {words} ({why})" for words, why in found.refused.items())]

    @property
    def tables(self) -> list[Table]:
        """The race, and what was judged on new seeds."""
        found, measure = self.found, self.criterion
        headers = ["learn first", "seeds", measure, "against from scratch", "late success", "lost before the target"]
        race = [_row(one, found.scratch) for one in found.race]
        judged = [_row(one, found.judge) for one in found.judged]
        title = "The race: the best of the probes, the better half going on to more seeds"
        return [
            Table(title, headers, [*race, _scratch_row(found.scratch)]),
            Table("On new seeds, which the race has not seen", headers, [*judged, _scratch_row(found.judge)]),
        ]


def simplify(
    path: str | os.PathLike[str],
    out: str | os.PathLike[str] | None = None,
    *,
    allow_imports: bool = False,
    progress: Progress | None = None,
) -> Answer:
    """Say which simpler task to learn first, or that none helps.

    Candidates are raced on growing sets of seeds (:data:`.RUNGS`), the better half going on. The simplest of those that
    do best and reach the target task's success is then compared with learning from scratch, on seeds that the race has
    not seen.

    Parameters
    ----------
    path
        A spec with one stage, the target task, and a table ``[simplify]``.
    out
        A folder for the experiment, ``curriculum.json`` (the recommended spec, which ``tasklift learn`` runs),
        ``answer.txt`` and, of the tasks that were raced, ``lattice.svg``; the same call resumes there.
    allow_imports
        As in :func:`.curriculum_of`.
    progress
        As in :func:`tasklift.lab.run`.

    Raises
    ------
    TaskliftError
        For whatever is wrong with the spec or the folder, before anything is trained.
    """
    study = study_of(path, allow_imports=allow_imports)
    with about(path), results_folder(out, (FILE_NAME,)) as folder:
        answer = answer_of(study, folder, progress)
        if out is not None:
            write_atomically(folder / "curriculum.json", canonical_json(dict(answer.document)) + "\n")
            write_atomically(folder / "answer.txt", "\n".join(answer.lines) + "\n")
            if _fields(answer.found):
                pictures.save(lattice_figure(answer), folder, "lattice")
    return answer


def answer_of(study: SimplifyStudy, folder: Path, progress: Progress | None = None) -> Answer:
    """Search, and put the result into words; the experiment is kept in ``folder``."""
    found = study.search(folder / FILE_NAME, progress)
    return Answer(found, study.criterion, study.spec_of(found.best))


def _row(one: Raced, scratch: Measures) -> list[Any]:
    measures = one.measures
    difference = stats.compare(measures.criterion, scratch.criterion[: one.seeds], better="less")
    note = "" if one.allowed else " (too low, or a limit is passed)"
    return [
        one.candidate.words, one.seeds, f"{measures.criterion.mean():.4g}", str(difference.interval),
        f"{measures.success.mean():.0%}{note}", f"{measures.losses_before.mean():.4g}",
    ]  # fmt: skip


def _scratch_row(scratch: Measures) -> list[Any]:
    return [SCRATCH, len(scratch.success), f"{scratch.criterion.mean():.4g}", "", f"{scratch.success.mean():.0%}", ""]


# ---------------------------------------------------------------- the picture


@pictures.styled
def lattice_figure(answer: Answer) -> Figure:
    """Draw the tasks of one stage: switches of the world by changes of the task, coloured by what they save.

    Each field shows the best way to carry over. Above is what is saved, as a share of what learning from scratch comes
    to; below on how much that rests, and what is lost before the target. Arrows are the steps of the recommended
    curriculum.
    """
    from matplotlib.colors import LinearSegmentedColormap
    from matplotlib.patches import Rectangle

    found = answer.found
    fields = _fields(found)
    columns = sorted({switch for switch, _ in fields}, key=lambda switch: (switch != AS_IT_IS, switch))
    rows = list(dict.fromkeys(changes for _, changes in fields))[:MOST_ROWS]
    most = max([*(one.saved for one in fields.values()), 1e-9])
    colours = LinearSegmentedColormap.from_list("saved", [GROUND[name][0] for name in ("fails", "paper", "holds")])
    figure = pictures.page(2.2 + 1.15 * len(columns), 1.1 + 0.42 * len(rows))
    axes = figure.subplots()
    for (switch, changes), one in fields.items():
        if changes not in rows:
            continue
        x, y = columns.index(switch), rows.index(changes)
        share = float(np.clip(one.saved / most, -1, 1))
        seeds = "probe" if one.seeds < RUNGS[0] else f"{one.seeds} seeds"
        axes.add_patch(
            Rectangle((x - 0.5, y - 0.5), 1, 1, facecolor=colours(0.5 + 0.3 * share), edgecolor=GROUND["line"][0],
                      hatch=None if one.allowed else "///")
        )  # fmt: skip
        axes.text(x, y - 0.14, f"{one.saved:+z.0%}", ha="center", va="center", size=7.5)
        basis = f"{seeds}; {one.measures.losses_before.mean():.4g} lost before"
        axes.text(x, y + 0.24, basis, ha="center", va="center", size=5, color=GROUND["ink"][0])
    if found.best is not None:
        _draw_path(axes, [_place(step) for step in found.best.steps], columns, rows)
    axes.set_xlim(-0.5, len(columns) - 0.5)
    axes.set_ylim(len(rows) - 0.5, -0.5)
    axes.set_xticks(range(len(columns)), [textwrap.fill(name, 18) for name in columns])
    axes.set_yticks(range(len(rows)), rows)
    axes.tick_params(length=0)
    axes.spines[:].set_visible(False)
    axes.xaxis.tick_top()
    axes.set_xlabel(
        f"{answer.criterion.replace('-', ' ')} saved against learning from scratch\n"
        "hatched: the target is solved less often, or a limit is passed"
    )
    return figure


def _fields(found: Found) -> dict[tuple[str, str], Raced]:
    """Return the best candidate of one stage by switch and changes of the task, those with fewest changes first."""
    best: dict[tuple[str, str], Raced] = {}
    for one in (*found.race, *found.probed):
        if len(one.candidate.steps) == 1:
            best.setdefault(_place(one.candidate.steps[0]), one)
    changes = {place: sum(bool(move.variable) for move in one.candidate.steps[0].moves) for place, one in best.items()}
    return {place: best[place] for place in sorted(best, key=lambda place: (changes[place], place[1]))}


def _place(step: Step) -> tuple[str, str]:
    """Return the column and the row of a step: its switch, and what is changed in the task."""
    changed = [move.words for move in step.moves if move.variable]
    switch = [move.words for move in step.moves if not move.variable]
    return switch[0] if switch else AS_IT_IS, ", ".join(changed) or "the whole task"


def _draw_path(axes: Any, places: list[tuple[str, str]], columns: list[str], rows: list[str]) -> None:
    """Mark the recommended steps, with an arrow from each to the next."""
    from matplotlib.patches import Rectangle

    at = [(columns.index(switch), rows.index(changes)) for switch, changes in places if changes in rows]
    for x, y in at:
        axes.add_patch(
            Rectangle((x - 0.48, y - 0.46), 0.96, 0.92, fill=False, edgecolor=GROUND["ink"][0], linewidth=1.8, zorder=3)
        )
    for one, other in pairwise(at):
        way = {"arrowstyle": "->", "connectionstyle": "arc3,rad=0.25", "shrinkA": 24, "shrinkB": 24}
        axes.annotate("", other, one, arrowprops={**way, "color": GROUND["ink"][0], "linewidth": 1.4})
