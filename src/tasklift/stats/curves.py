"""Curves over trials: the band of their mean, the time until they are good enough, and the median of such times."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from tasklift.errors import TaskliftError
from tasklift.stats.paired import Floats, by_stratum, counts, floats, groups_of, half, seeds_needed, statistic
from tasklift.stats.verdicts import Direction, Interval, gain


def mean_band(values: ArrayLike, *, strata: ArrayLike | None = None, seed: int = 0, resamples: int = 1999) -> Interval:
    """Return the mean curve of ``(n, T)`` and its 95 % band, whose limits hold trial by trial.

    Every limit is the farther one of Student's and of the studentised bootstrap's
    (:class:`~tasklift.stats.paired.PairedTest`). With too few seeds, or where they do not bound the mean, the limits
    are nan: there is nothing to draw.
    """
    from scipy.stats import t

    curves = floats(values, "the curves")
    if curves.ndim != 2:
        raise TaskliftError(f"stats.mean_band: curves have shape {curves.shape}, expected (seeds, trials)")
    n = len(curves)
    mean = curves.mean(axis=0)
    if n < seeds_needed():
        return Interval(mean, np.full_like(mean, np.nan), np.full_like(mean, np.nan), 0.95, n)
    groups = groups_of(strata, n)
    sizes = np.array([group.size for group in groups])
    about = np.concatenate([curves[group] - curves[group].mean(axis=0) for group in groups]).T  # (T, n)
    about[abs(about) < 1e-12 * (1 + abs(mean[:, None]))] = 0.0
    spread = by_stratum(np.ones((1, n)), about**2, sizes)[:, 0]
    error = np.sqrt(spread @ (sizes / (sizes - 1))) / n
    sums = by_stratum(counts(tuple(sizes.tolist()), seed, resamples), np.concatenate([about, about**2]), sizes)
    drawn = statistic(sums[: len(mean)], sums[len(mean) :], sizes, half(sizes))
    low, high = np.quantile(drawn, [0.025, 0.975], axis=1, method="inverted_cdf")
    least = float(t.ppf(0.975, n - len(groups)))
    with np.errstate(invalid="ignore"):
        limits = mean - np.maximum(high, least) * error, mean + np.maximum(-low, least) * error
    low, high = (np.where(np.isfinite(limit) & (error > 0), limit, np.nan) for limit in limits)
    return Interval(mean, low, high, 0.95, n)


@dataclass(frozen=True)
class Times:
    """Times to an event, some censored: where not ``reached``, the event came later than ``time`` or never.

    ``time`` float64 ``(n,)``, ``reached`` bool ``(n,)``.
    """

    time: Floats
    reached: NDArray[np.bool_]


def time_to_threshold(
    curve: ArrayLike,
    threshold: float,
    *,
    window: int = 10,
    cost: ArrayLike | None = None,
    source: ArrayLike = 0.0,
    better: Direction = "less",
) -> Times:
    """When the mean of the last ``window`` trials first is as good as the threshold.

    Parameters
    ----------
    curve
        ``(n, T)``.
    threshold
        In the curve's unit.
    window
        Trials.
    cost
        ``(n, T)``, what each trial costs (its steps, its losses); by default each costs one trial.
    source
        What the source task cost in the same unit, one value or ``(n,)``; 0 is the target-only form.
    better
        Whether a curve that falls (``"less"``) or rises gets better.

    Returns
    -------
    Times
        A seed that never gets there is censored at its total cost; it is not dropped.

    Raises
    ------
    TaskliftError
        For a window longer than the curve.
    """
    values = np.atleast_2d(floats(curve, "the curve"))
    trials = values.shape[-1]
    if not 0 < window <= trials:
        raise TaskliftError(f"stats.time_to_threshold: window {window}, expected 1 to {trials} trials")
    spent = np.ones_like(values) if cost is None else np.broadcast_to(floats(cost, "the cost"), values.shape)
    total = np.cumsum(values, axis=-1)
    total[..., window:] -= total[..., :-window].copy()
    smooth = total[..., window - 1 :] / window
    good = (smooth - threshold) * gain(better) >= -1e-12 * max(1.0, abs(threshold))
    reached = np.asarray(good.any(axis=-1))
    at = np.where(reached, good.argmax(axis=-1) + window - 1, trials - 1)
    time = np.take_along_axis(np.cumsum(spent, axis=-1), at[:, None], axis=-1)[:, 0]
    return Times(time + np.asarray(source, dtype=np.float64), reached)


def median_time(times: Times) -> Interval:
    """Return the Kaplan-Meier median and its exact 95 % interval; an end is infinite where it is not observed.

    The interval takes order statistics (the sign test's), a censored time counting as the earliest it can be for
    the lower end and as never for the upper one. So it holds however the times were censored.

    Examples
    --------
    >>> weeks = np.array([6, 6, 6, 7, 10, 13, 16, 22, 23, 6, 9, 10, 11, 17, 19, 20, 25, 32, 32, 34, 35.0])
    >>> print(median_time(Times(weeks, np.arange(21) < 9)))  # remission on 6-MP (Freireich 1963)
    23 (at least 9)
    """
    from scipy.stats import binom

    time = floats(times.time, "the times")
    order = np.lexsort((~times.reached, time))  # at equal times, events before censorings
    reached, n = times.reached[order], time.size
    survival = np.cumprod(1.0 - reached / np.arange(n, 0, -1))
    half = survival <= 0.5 + 1e-12
    median = float(time[order][half.argmax()]) if half.any() else math.inf
    rank = int(binom.ppf(0.025, n, 0.5))  # the interval runs from the rank-th smallest to the rank-th largest
    if rank < 1:
        return Interval(median, -math.inf, math.inf, 0.95, n)
    high = np.sort(np.where(times.reached, time, np.inf))[n - rank]
    return Interval(median, float(np.sort(time)[rank - 1]), float(high), 0.95, n)
