"""Drills against direct learning, like with like: robots lost after arrival on T, and how often T is solved."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

from tasklift import stats
from tasklift.errors import TaskliftError
from tasklift.lab import Store
from tasklift.studies.arms import ARMS
from tasklift.studies.samples import Floats, Sample

#: T is solved "at least as often" if the share of trials that succeed is not lower, and is shown not to be lower by
#: this much. Whole runs fail or succeed: with 600 the interval is about ± 2.5 points wide.
MARGIN = 0.05

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
    if not math.isfinite(interval.estimate):
        return "none lost"
    if math.isfinite(interval.high):
        return f"{times(interval.estimate)} [{times(max(interval.low, 0.0))}, {times(interval.high)}]"
    bound = f"at least {times(interval.low)}" if math.isfinite(interval.low) else "no interval"
    return f"{times(interval.estimate)} ({bound})"
