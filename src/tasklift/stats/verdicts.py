"""Questions to seeds, and what is answered: an interval, a p-value and a verdict of one test."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any, Literal

import numpy as np
from numpy.typing import ArrayLike

from tasklift.errors import TaskliftError
from tasklift.stats.paired import LEVEL, RESAMPLES, Floats, PairedTest, floats, seeds_needed

Direction = Literal["less", "greater"]
Verdict = Literal["holds", "does not hold", "undecided", "too few"]


@dataclass(frozen=True)
class Interval:
    """An estimate and its interval: floats, or float64 ``(T,)`` each from :func:`mean_band`.

    An end is infinite where the seeds do not bound the quantity on that side; both are where the seeds are too
    few for any interval. Neither is ever printed as infinite.

    Examples
    --------
    >>> print(Interval(2.0, 1.5, 2.5, 0.95, 12))
    2 [1.5, 2.5]
    >>> print(Interval(2.0, 1.5, float("inf"), 0.95, 12))
    2 (at least 1.5)
    >>> print(Interval(2.0, -float("inf"), float("inf"), 0.95, 3))
    2 (no interval from 3 seeds)
    """

    estimate: Any
    low: Any
    high: Any
    confidence: float
    n: int

    def __str__(self) -> str:
        found = f"{self.estimate:.4g}" if math.isfinite(self.estimate) else "unbounded"
        if math.isfinite(self.low) and math.isfinite(self.high):
            return f"{found} [{self.low:.4g}, {self.high:.4g}]"
        if math.isfinite(self.low):
            return f"{found} (at least {self.low:.4g})"
        if math.isfinite(self.high):
            return f"{found} (at most {self.high:.4g})"
        return f"{found} (no interval from {self.n} seeds)"


@dataclass(frozen=True)
class Comparison:
    """An interval, the p-value of the same test, and what follows.

    Attributes
    ----------
    interval
        Of the quantity that was compared.
    p
        Two-sided; after :func:`after_holm` adjusted for all that were asked together. nan: the estimate decides.
    n, needed, unit
        Seeds (or maps, or trials), and the fewest with which p can reach 5 %.
    favours
        Whether the estimate lies on the side that was asked about.
    error
        Standard error of the estimate.
    """

    interval: Interval
    p: float
    n: int
    needed: int
    favours: bool
    error: float = math.nan
    unit: str = "seeds"

    @property
    def estimate(self) -> float:
        """The estimate, without its interval."""
        return float(self.interval.estimate)

    @property
    def verdict(self) -> Verdict:
        """``holds`` or ``does not hold`` where p is at most 5 %; else ``undecided`` or ``too few``."""
        if self.n < self.needed:
            return "too few"
        if self.p > LEVEL:
            return "undecided"
        return "holds" if self.favours else "does not hold"

    @property
    def says(self) -> str:
        """The verdict for people: ``"too few seeds (3 of at least 6)"`` says how many."""
        verdict = self.verdict
        return f"too few {self.unit} ({self.n} of at least {self.needed})" if verdict == "too few" else verdict

    def __str__(self) -> str:
        return f"{self.interval}, p = {self.p:.2g}: {self.says}"


def compare(
    a: ArrayLike,
    b: ArrayLike | None = None,
    *,
    better: Direction = "less",
    reference: float = 0.0,
    strata: ArrayLike | None = None,
    confidence: float = 0.95,
    seed: int = 0,
    resamples: int = RESAMPLES,
) -> Comparison:
    """Compare two arms that share their seeds, or one arm with a number.

    Parameters
    ----------
    a, b
        ``(n,)`` each, one value per seed, paired; without ``b`` the values of ``a`` alone.
    better
        The verdict *holds* if the mean of a − b is ``"less"`` or ``"greater"`` than the reference.
    reference
        In the unit of the values.
    strata
        ``(n,)``, each seed's map: the spread is measured within maps. Ignored if a map has one seed only.
    confidence
        Of the interval of the mean of a − b. The verdict asks at 5 % in any case.
    seed, resamples
        Of the random signs and resamples.

    Raises
    ------
    TaskliftError
        For no values, values that are not finite, or shapes that do not match.

    Examples
    --------
    >>> lost = [3.1, 2.7, 3.5, 2.9, 3.3, 3.0, 2.8, 3.2]
    >>> direct = [4.9, 5.6, 5.2, 6.1, 5.0, 5.4, 5.9, 5.3]
    >>> print(compare(lost, direct))
    -2.362 [-3.509, -1.75], p = 0.013: holds
    >>> compare(lost[:3], direct[:3]).says
    'too few seeds (3 of at least 6)'
    """
    values = _vector(a) if b is None else np.subtract(*_paired(a, b))
    test = PairedTest(values, np.ones_like(values), strata, seed, resamples)
    found = Interval(test.estimate, *test.limits(confidence), confidence, test.n)
    return _compared(test, found, reference, better)


def ratio(
    a: ArrayLike,
    b: ArrayLike,
    *,
    better: Direction = "less",
    reference: float = 1.0,
    strata: ArrayLike | None = None,
    confidence: float = 0.95,
    seed: int = 0,
    resamples: int = RESAMPLES,
) -> Comparison:
    """Compare two arms by the ratio of their means, mean(a) / mean(b); parameters as in :func:`compare`.

    Both hold numbers of at least 0, such as losses. An interval needs what :func:`bounds_ratio` asks for. The verdict
    needs no interval; at the reference 1 it is that of the difference.

    Examples
    --------
    >>> found = ratio([40, 61, 37, 52, 45, 48, 55, 41, 50, 44], [2, 3, 1, 3, 2, 2, 4, 2, 3, 2], better="greater")
    >>> print(found.interval, found.verdict)
    19.71 [15.73, 23.88] holds
    """
    over, under = _paired(a, b)
    if min(over.min(), under.min()) < 0:
        raise TaskliftError("stats.ratio: expected values of at least 0; compare the difference instead")
    test = PairedTest(over, under, strata, seed, resamples)
    centre = test.estimate if under.any() else math.inf if over.any() else math.nan
    low, high = -math.inf, math.inf
    if bounds_ratio(over, under):
        low, high = test.limits(confidence)
        low = low if math.isinf(high) else max(low, 0.0)
    found = Interval(centre, low, high, confidence, test.n)
    return _compared(test, found, reference, better)


def bounds_ratio(over: Floats, under: Floats) -> bool:
    """Return whether arms carry an interval of their ratio: at least ten seeds, six of each above 0.

    With fewer it would miss the truth too often. Where zeros are usual, six of eight seeds without one are a lucky
    choice, and their mean is too large.
    """
    return over.size >= 10 and bool(min(np.count_nonzero(over), np.count_nonzero(under)) >= seeds_needed())


def gain(better: Direction) -> int:
    """Return 1 where more is better, −1 where less is."""
    if better not in ("less", "greater"):
        raise TaskliftError(f"stats: expected 'less' or 'greater', found {better!r}")
    return -1 if better == "less" else 1


def _paired(a: ArrayLike, b: ArrayLike) -> tuple[Floats, Floats]:
    one, other = floats(a, "the first arm"), floats(b, "the second arm")
    if one.shape != other.shape or one.ndim != 1:
        raise TaskliftError(f"stats: arms of shapes {one.shape} and {other.shape}, expected the same (n,)")
    return one, other


def _compared(test: PairedTest, interval: Interval, reference: float, better: Direction) -> Comparison:
    below, above = test.sides(reference)
    favours = (below if gain(better) < 0 else above) < 1
    return Comparison(interval, min(1.0, 2 * min(below, above)), test.n, seeds_needed(), favours, test.error)


def equivalent(
    a: ArrayLike,
    b: ArrayLike | None = None,
    *,
    margin: float,
    strata: ArrayLike | None = None,
    seed: int = 0,
    resamples: int = RESAMPLES,
) -> Comparison:
    """Ask whether the mean of a − b is zero but for a margin; parameters as in :func:`compare`.

    *Holds* if two one-sided tests at 5 % place it inside (TOST, Schuirmann 1987); the interval is a 90 % one then.
    *Does not hold* if it lies outside at 5 %.
    """
    if not margin > 0:
        raise TaskliftError(f"stats.equivalent: margin {margin}, expected a positive number")
    values = _vector(a) if b is None else np.subtract(*_paired(a, b))
    test = PairedTest(values, np.ones_like(values), strata, seed, resamples)
    inside = abs(test.estimate) < margin
    if inside:
        p = max(test.sides(-margin)[1], test.sides(margin)[0])
    else:
        p = min(1.0, 2 * (test.sides(margin)[1] if test.estimate > 0 else test.sides(-margin)[0]))
    found = Interval(test.estimate, *test.limits(0.90), 0.90, test.n)
    return Comparison(found, p, test.n, seeds_needed(), inside, test.error)


def share(
    successes: int,
    trials: int,
    *,
    better: Direction = "greater",
    reference: float = 0.5,
    unit: str = "trials",
) -> Comparison:
    """Compare a share of independent trials with a number, exactly (Clopper & Pearson 1934).

    Examples
    --------
    >>> print(share(11, 12))
    0.9167 [0.6152, 0.9979], p = 0.0063: holds
    """
    from scipy.stats import beta, binom

    if not 0 <= successes <= trials or trials < 1 or not 0 < reference < 1:
        raise TaskliftError(f"stats.share: {successes} of {trials} against {reference}; expected k of n, a share")
    low = float(beta.ppf(0.025, successes, trials - successes + 1)) if successes else 0.0
    high = float(beta.ppf(0.975, successes + 1, trials - successes)) if successes < trials else 1.0
    tails = binom.cdf(successes, trials, reference), binom.sf(successes - 1, trials, reference)
    needed = math.ceil(math.log(LEVEL / 2) / math.log(min(reference, 1 - reference)))
    found = Interval(successes / trials, low, high, 0.95, trials)
    favours = gain(better) * (found.estimate - reference) > 0
    error = math.sqrt(found.estimate * (1 - found.estimate) / trials)
    return Comparison(found, min(1.0, 2 * float(min(tails))), trials, needed, favours, error, unit)


def _vector(values: ArrayLike) -> Floats:
    array = floats(values, "the values")
    if array.ndim != 1:
        raise TaskliftError(f"stats: values of shape {array.shape}, expected (n,): one per seed")
    return array


# ---------------------------------------------------------------- many questions at once


def holm(p: ArrayLike) -> Floats:
    """p-values adjusted after Holm (1979): comparing them with alpha keeps the family-wise error below it."""
    values = floats(p, "p")
    order = np.argsort(values, kind="stable")
    adjusted = np.maximum.accumulate(values[order] * np.arange(values.size, 0, -1))
    result = np.empty_like(values)
    result[order] = np.minimum(adjusted, 1.0)
    return result


def after_holm(found: Sequence[Comparison]) -> list[Comparison]:
    """Return the comparisons with p-values, and so verdicts, for all of them asked together (:func:`holm`).

    Intervals stay as they are: 95 % each.
    """
    result = list(found)
    tested = [i for i, one in enumerate(found) if not math.isnan(one.p)]
    for i, p in zip(tested, holm([found[i].p for i in tested]) if tested else [], strict=True):
        needed = found[i].needed if p <= LEVEL else max(found[i].needed, seeds_needed(len(tested)))
        result[i] = replace(found[i], p=float(p), needed=needed)
    return result


def benjamini_hochberg(p: ArrayLike) -> Floats:
    """p-values adjusted after Benjamini & Hochberg (1995), to bound the false discovery rate."""
    values = floats(p, "p")
    order = np.argsort(values, kind="stable")
    scaled = values[order] * values.size / np.arange(1, values.size + 1)
    result = np.empty_like(values)
    result[order] = np.minimum(np.minimum.accumulate(scaled[::-1])[::-1], 1.0)
    return result
