"""Learning-curve and transfer metrics, and what may be concluded from them.

Conventions. A *curve* is an array ``(..., T)``: one value per trial, trials last; usually ``(n, T)``, a row
per seed. Metrics reduce the trials and give one value per seed, because **the seed is the unit of
replication, never the trial**; only then are seeds resampled. ``strata`` labels each seed's map: seeds are
resampled within their map. ``better`` says which direction is good: ``"less"`` for steps and losses,
``"greater"`` for rewards. Every random result follows from its ``seed``.

Metrics after Taylor & Stone, "Transfer Learning for Reinforcement Learning Domains: A Survey", JMLR 10, 2009.
*Target only* ignores what the source task cost; the parameters named ``source`` or ``spent`` include it.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from typing import Any, Literal

import numpy as np
from numpy.typing import ArrayLike, NDArray

from tasklift.errors import TaskliftError

Direction = Literal["less", "greater"]
Verdict = Literal["holds", "does not hold", "undecided"]
Method = Literal["bca", "percentile"]
Floats = NDArray[np.float64]
Statistic = Callable[..., Any]  # statistic(*samples, axis=-1), reducing that axis

_CHUNK = 4_000_000  # elements gathered at once while resampling: 32 MB


def _floats(values: ArrayLike, what: str) -> Floats:
    array = np.asarray(values, dtype=np.float64)
    if array.size == 0 or array.ndim == 0:
        raise TaskliftError(f"stats: {what} has shape {array.shape}; give at least one value")
    if not np.isfinite(array).all():
        raise TaskliftError(f"stats: {what} holds a value that is not finite; find the run it comes from")
    return array


def _gain(better: Direction) -> int:
    if better not in ("less", "greater"):
        raise TaskliftError(f"stats: expected 'less' or 'greater', found {better!r}")
    return -1 if better == "less" else 1


# ---------------------------------------------------------------- metrics of a curve, one value per seed


def jumpstart(
    curve: ArrayLike, reference: ArrayLike, *, first: int = 10, spent: int = 0, better: Direction = "less"
) -> Floats:
    """Initial advantage over the reference, in the curve's unit; positive is better.

    Parameters
    ----------
    curve, reference
        ``(..., T)``, the arm and the learner without transfer, paired by seed.
    first
        Mean over so many trials.
    spent
        Trials that the source task cost. 0 is the target-only form; otherwise (source included) the reference
        is read after it has learned for as many trials on the target itself.
    """
    arm, plain = _floats(curve, "the curve"), _floats(reference, "the reference")
    if not 0 < first <= arm.shape[-1] or not 0 <= spent <= plain.shape[-1] - first:
        raise TaskliftError(
            f"stats.jumpstart: {first} trials after {spent} do not fit curves of {arm.shape[-1]} and "
            f"{plain.shape[-1]} trials; ask for fewer"
        )
    gap = arm[..., :first].mean(axis=-1) - plain[..., spent : spent + first].mean(axis=-1)
    return np.asarray(_gain(better) * gap)


def asymptotic(curve: ArrayLike, *, last: int = 20) -> Floats:
    """Mean over the last trials: the performance that learning arrived at (it may still be moving)."""
    values = _floats(curve, "the curve")
    if not 0 < last <= values.shape[-1]:
        raise TaskliftError(f"stats.asymptotic: last {last} of {values.shape[-1]} trials; ask for fewer")
    return np.asarray(values[..., -last:].mean(axis=-1))


def area_under_curve(curve: ArrayLike, *, source: ArrayLike | None = None) -> Floats:
    """Sum over the trials (for steps: the total time); ``source`` ``(..., T_source)`` is joined in front."""
    total = _floats(curve, "the curve").sum(axis=-1)
    return np.asarray(total if source is None else total + _floats(source, "the source curve").sum(axis=-1))


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
    cost
        ``(n, T)``, what each trial costs (its steps, say); by default each costs one trial.
    source
        What the source task cost in the same unit, one value or ``(n,)``; 0 is the target-only form.

    Returns
    -------
    Times
        A seed that never gets there is censored at its whole cost; it is not dropped.
    """
    values = np.atleast_2d(_floats(curve, "the curve"))
    trials = values.shape[-1]
    if not 0 < window <= trials:
        raise TaskliftError(f"stats.time_to_threshold: window {window}, expected 1 to {trials} trials")
    spent = np.ones_like(values) if cost is None else np.broadcast_to(_floats(cost, "the cost"), values.shape)
    total = np.cumsum(values, axis=-1)
    total[..., window:] -= total[..., :-window].copy()
    smooth = total[..., window - 1 :] / window
    good = (smooth - threshold) * _gain(better) >= -1e-12 * max(1.0, abs(threshold))
    reached = np.asarray(good.any(axis=-1))
    at = np.where(reached, good.argmax(axis=-1) + window - 1, trials - 1)
    time = np.take_along_axis(np.cumsum(spent, axis=-1), at[:, None], axis=-1)[:, 0]
    return Times(time + np.asarray(source, dtype=np.float64), reached)


def transfer_ratio(
    arm: ArrayLike,
    reference: ArrayLike,
    *,
    variant: Literal["relative", "quotient"] = "relative",
    better: Direction = "less",
    axis: int = -1,
) -> Any:
    """Transfer ratio of mean totals (areas under the curve), pooled over seeds; fit for :func:`bootstrap`.

    ``relative``: (arm - reference) / reference, its sign turned so that positive is better (Taylor & Stone).
    ``quotient``: arm / reference. Means are divided, not seeds: single seeds may have a total near zero.
    Give totals with the source's share for the source-included form.
    """
    plain = np.mean(np.asarray(reference, dtype=np.float64), axis=axis)
    quotient = np.mean(np.asarray(arm, dtype=np.float64), axis=axis) / plain
    if variant == "quotient":
        return quotient
    if variant == "relative":
        return _gain(better) * (quotient - 1.0)
    raise TaskliftError(f"stats.transfer_ratio: variant {variant!r}, expected 'relative' or 'quotient'")


def forward_transfer(performance: ArrayLike, reference: ArrayLike, *, spent: int = 0, axis: int = -1) -> Any:
    """Normalised forward transfer: (A - A_ref) / (1 - A_ref), A the mean performance in [0, 1] over trials.

    Wołczyk et al., "Continual World" (2021). For steps, performance is ``1 - steps / limit``. ``spent`` > 0
    is the source-included form: the curve is preceded by so many trials of performance 0, and both areas are
    means over the longer span, which the reference must cover.

    Returns
    -------
    float64, one value per seed; at most 1, unbounded below; nan where the reference is perfect.
    """
    arm, plain = _floats(performance, "the performance"), _floats(reference, "the reference")
    if min(arm.min(), plain.min()) < 0 or max(arm.max(), plain.max()) > 1:
        raise TaskliftError("stats.forward_transfer: performance outside 0 to 1; give 1 - steps / limit")
    span = arm.shape[axis] + spent
    if plain.shape[axis] != span:
        raise TaskliftError(
            f"stats.forward_transfer: the reference has {plain.shape[axis]} trials, expected {span} "
            f"({arm.shape[axis]} and {spent} spent on the source)"
        )
    area, base = arm.sum(axis=axis) / span, plain.mean(axis=axis)
    room = np.where(base < 1.0, 1.0 - base, np.nan)
    return (area - base) / room


# ---------------------------------------------------------------- losses


def losses_total(losses: ArrayLike, *, source: ArrayLike | None = None) -> Floats:
    """Losses over all trials per seed; with ``source`` ``(..., T_source)`` the source task's as well."""
    return area_under_curve(losses, source=source)


def losses_by_stage(stages: Mapping[str, ArrayLike]) -> dict[str, Floats]:
    """Losses per seed in each stage, ``{stage: (n, T_stage)}``, and their ``"total"``: the loss ledger."""
    ledger = {name: area_under_curve(losses) for name, losses in stages.items()}
    if not ledger or "total" in ledger:
        raise TaskliftError("stats.losses_by_stage: expected at least one stage, none of them named 'total'")
    ledger["total"] = np.sum(np.broadcast_arrays(*ledger.values()), axis=0)
    return ledger


def losses_until_threshold(
    losses: ArrayLike,
    curve: ArrayLike,
    threshold: float,
    *,
    window: int = 10,
    source: ArrayLike = 0.0,
    better: Direction = "less",
) -> Times:
    """What was lost before the curve was as good as the threshold: a :class:`Times` whose unit is losses.

    A seed that never gets there is censored: it would have lost at least so many.
    """
    return time_to_threshold(curve, threshold, window=window, cost=losses, source=source, better=better)


def losses_per_1000_steps(
    losses: ArrayLike, steps: ArrayLike, *, source_losses: ArrayLike = 0.0, source_steps: ArrayLike = 0.0
) -> Floats:
    """1,000 x losses / steps per seed; the source's totals, one value or ``(n,)``, may be included."""
    lost = area_under_curve(losses) + np.asarray(source_losses, dtype=np.float64)
    taken = area_under_curve(steps) + np.asarray(source_steps, dtype=np.float64)
    if (taken <= 0).any():
        raise TaskliftError("stats.losses_per_1000_steps: a seed took no steps; leave out what did not run")
    return np.asarray(1000.0 * lost / taken)


# ---------------------------------------------------------------- summaries over seeds


def iqm(values: ArrayLike, axis: int = -1) -> Any:
    """Interquartile mean: the lowest and the highest floor(n / 4) values are left out of the mean."""
    array = np.moveaxis(np.asarray(values, dtype=np.float64), axis, -1)
    n = array.shape[-1]
    cut = n // 4
    if cut:
        array = np.partition(array, (cut, n - cut - 1), axis=-1)[..., cut : n - cut]
    return array.mean(axis=-1)


def negative_transfer(gain: ArrayLike, axis: int = -1) -> Any:
    """Probability of negative transfer: the share of seeds whose gain over the reference is below zero."""
    return (np.asarray(gain) < 0).mean(axis=axis)


def _survival(times: Times, counts: NDArray[Any] | None = None) -> tuple[Floats, Floats]:
    """Kaplan-Meier: sorted times (n,), survival after each (..., n); `counts`: how often each seed counts."""
    time = _floats(times.time, "the times")
    order = np.lexsort((~times.reached, time))  # at equal times, events before censorings
    weight = np.ones((1, time.size)) if counts is None else np.asarray(counts, dtype=np.float64)
    weight = weight[..., order]
    at_risk = np.cumsum(weight[..., ::-1], axis=-1)[..., ::-1]
    died = np.where(times.reached[order], weight, 0.0)
    survival = np.cumprod(1.0 - died / np.maximum(at_risk, 1.0), axis=-1)
    return time[order], np.asarray(survival if counts is not None else survival[0])


def kaplan_meier(times: Times) -> tuple[Floats, Floats]:
    """Product-limit estimate of the share that has not reached the threshold yet.

    Returns
    -------
    time, survival
        float64 ``(k,)`` each, ``k`` the distinct times; ``survival[i]`` holds from ``time[i]`` on.
    """
    time, survival = _survival(times)
    last = np.append(time[1:] != time[:-1], True)
    return time[last], survival[last]


def _median_time(times: Times, counts: NDArray[Any] | None = None) -> Any:
    time, survival = _survival(times, counts)
    half = survival <= 0.5 + 1e-12
    return np.where(half.any(axis=-1), time[half.argmax(axis=-1)], np.inf)


def median_time(times: Times) -> float:
    """Kaplan-Meier median; infinity if half of the seeds are not there when the observation ends."""
    return float(_median_time(times))


def _restricted_mean(times: Times, horizon: float, counts: NDArray[Any] | None = None) -> Any:
    time, survival = _survival(times, counts)
    edges = np.minimum(np.concatenate(([0.0], time, [max(horizon, float(time[-1]))])), horizon)
    before = np.concatenate((np.ones((*survival.shape[:-1], 1)), survival), axis=-1)
    return (before * np.diff(edges)).sum(axis=-1)


def restricted_mean_time(times: Times, horizon: float) -> float:
    """Mean of min(time, horizon): the area under the Kaplan-Meier curve up to ``horizon`` (> 0)."""
    return float(_restricted_mean(times, horizon))


# ---------------------------------------------------------------- resampling


@dataclass(frozen=True)
class Interval:
    """An estimate and its bootstrap interval: floats, or float64 ``(T,)`` from :func:`mean_band`."""

    estimate: Any
    low: Any
    high: Any
    confidence: float
    method: str
    n: int
    resamples: int

    def __str__(self) -> str:
        return f"{self.estimate:.4g} [{self.low:.4g}, {self.high:.4g}]"


def _groups(strata: ArrayLike | None, n: int) -> list[NDArray[np.int64]]:
    if strata is None:
        return [np.arange(n)]
    labels = np.asarray(strata)
    if labels.shape != (n,):
        raise TaskliftError(f"stats: strata has shape {labels.shape}, expected ({n},): one map per seed")
    _, group = np.unique(labels, return_inverse=True)
    return [np.flatnonzero(group == g) for g in range(group.max() + 1)]


def _draws(
    groups: list[NDArray[np.int64]], resamples: int, seed: int, nested: bool, width: int = 1
) -> Iterator[NDArray[np.int64]]:
    """Yield index arrays (r, n), `resamples` rows in all: seeds within maps (nested: maps drawn first)."""
    if nested and len({group.size for group in groups}) > 1:
        raise TaskliftError("stats: nested resampling needs as many seeds on every map")
    rng = np.random.default_rng(seed)
    rows = max(1, _CHUNK // (width * sum(group.size for group in groups)))
    for start in range(0, resamples, rows):
        r = min(rows, resamples - start)
        if nested:
            maps = rng.integers(len(groups), size=(r, len(groups), 1))
            within = rng.integers(groups[0].size, size=(r, len(groups), groups[0].size))
            yield np.stack(groups)[maps, within].reshape(r, -1)
        else:
            yield np.concatenate([g[rng.integers(g.size, size=(r, g.size))] for g in groups], axis=1)


def _counts(
    groups: list[NDArray[np.int64]], resamples: int, seed: int, nested: bool
) -> Iterator[NDArray[np.float64]]:
    """As `_draws`, but how often each seed was drawn: float64 (r, n)."""
    n = sum(group.size for group in groups)
    for index in _draws(groups, resamples, seed, nested):
        flat = (index + n * np.arange(len(index))[:, None]).ravel()
        yield np.bincount(flat, minlength=n * len(index)).reshape(-1, n).astype(np.float64)


def _limits(
    estimate: Floats, replicates: Floats, confidence: float, method: str, acceleration: Floats | float
) -> tuple[Floats, Floats]:
    """Percentile or BCa limits of replicates (B, ...). BCa: Efron & Tibshirani (1993), chapter 14.3."""
    if not 0 < confidence < 1:
        raise TaskliftError(f"stats: confidence {confidence}, expected a share between 0 and 1")
    if method not in ("bca", "percentile"):
        raise TaskliftError(f"stats: method {method!r}, expected 'bca' or 'percentile'")
    replicates = np.sort(replicates.reshape(len(replicates), -1), axis=0)
    centre = np.asarray(estimate, dtype=np.float64).reshape(-1)
    tail = np.array([(1 - confidence) / 2, (1 + confidence) / 2])[:, None] * np.ones_like(centre)
    if method == "bca":
        from scipy.special import ndtr, ndtri

        # ties count half, and rounding must not break them: small samples have many
        near = 1e-12 * (abs(centre) + abs(replicates[len(replicates) // 4]))
        below = (replicates < centre - near).mean(axis=0) / 2 + (replicates <= centre + near).mean(axis=0) / 2
        with np.errstate(invalid="ignore"):
            z = ndtri(below) + ndtri(tail)
            moved = ndtr(ndtri(below) + z / (1 - np.reshape(acceleration, -1) * z))
        # all replicates on one side of the estimate: no correction can be computed, the plain limits stay
        tail = np.where(np.isfinite(z) & np.isfinite(moved), moved, tail)
    # the quantile by linear interpolation; infinite replicates (a median never reached) sort to the end
    at = tail * (len(replicates) - 1)
    lower = np.floor(at).astype(np.int64)
    upper = np.minimum(lower + 1, len(replicates) - 1)
    column = np.arange(centre.size)
    a, b = replicates[lower, column], replicates[upper, column]
    share = at - lower
    with np.errstate(invalid="ignore"):
        limits = np.where((share == 0) | (a == b), a, a + share * (b - a))
    shape = np.shape(estimate)
    return limits[0].reshape(shape), limits[1].reshape(shape)


def _acceleration(jackknife: list[Floats]) -> Floats:
    """BCa's a from leave-one-out values, one array (n_h, ...) per stratum (strata as independent samples)."""
    cubes, squares = 0.0, 0.0
    for values in jackknife:
        n = len(values)
        influence = (n - 1) * (values.mean(axis=0) - values)
        cubes = cubes + (influence**3).sum(axis=0) / n**3
        squares = squares + (influence**2).sum(axis=0) / n**2
    with np.errstate(invalid="ignore", divide="ignore"):
        return np.nan_to_num(np.asarray(cubes / (6 * np.asarray(squares) ** 1.5)), nan=0.0)


def _left_out(statistic: Statistic, samples: list[Floats], group: NDArray[np.int64], n: int) -> Floats:
    values = []
    rows = max(1, _CHUNK // (n * len(samples)))
    for start in range(0, group.size, rows):
        keep = np.arange(n - 1) + (np.arange(n - 1) >= group[start : start + rows, None])
        values.append(np.asarray(statistic(*[sample[keep] for sample in samples], axis=-1)))
    return np.concatenate(values)


def bootstrap(
    statistic: Statistic,
    *samples: ArrayLike,
    strata: ArrayLike | None = None,
    seed: int = 0,
    resamples: int = 4000,
    confidence: float = 0.95,
    method: Method = "bca",
    nested: bool = False,
) -> Interval:
    """Stratified bootstrap interval of a statistic of one or more paired samples.

    Parameters
    ----------
    statistic
        ``statistic(*samples, axis=-1)``, vectorised: it reduces that axis, as ``np.mean`` and :func:`iqm` do.
    samples
        ``(n,)`` each, one value per seed, resampled together.
    strata
        ``(n,)``, each seed's map: seeds are resampled within their map, the interval speaks of these maps.
    nested
        Draw the maps first (all with the same number of seeds), then seeds within: it speaks of maps like
        these. Percentile only: leaving one seed out says nothing about maps.
    """
    arrays = [_floats(sample, "a sample") for sample in samples]
    n = arrays[0].size
    if any(array.shape != (n,) for array in arrays):
        raise TaskliftError(f"stats.bootstrap: shapes {[a.shape for a in arrays]}, expected the same (n,)")
    method = "percentile" if nested else method
    groups = _groups(strata, n)
    replicates = np.concatenate(
        [
            np.asarray(statistic(*[array[index] for array in arrays], axis=-1), dtype=np.float64)
            for index in _draws(groups, resamples, seed, nested, len(arrays))
        ]
    )
    estimate = np.asarray(statistic(*arrays, axis=-1), dtype=np.float64)
    acceleration: Floats | float = 0.0
    if method == "bca" and n > 1:
        acceleration = _acceleration([_left_out(statistic, arrays, g, n) for g in groups if g.size > 1])
    low, high = _limits(estimate, replicates, confidence, method, acceleration)
    return Interval(float(estimate), float(low), float(high), confidence, method, n, resamples)


def mean_band(
    values: ArrayLike,
    *,
    strata: ArrayLike | None = None,
    seed: int = 0,
    resamples: int = 2000,
    confidence: float = 0.95,
    method: Method = "percentile",
    nested: bool = False,
) -> Interval:
    """Bootstrap band of the mean curve: whole seeds ``(n, T)`` are resampled, the fields are ``(T,)``.

    The limits hold trial by trial, not for all trials at once.
    """
    curves = _floats(values, "the curves")
    if curves.ndim != 2:
        raise TaskliftError(f"stats.mean_band: curves have shape {curves.shape}, expected (seeds, trials)")
    n = len(curves)
    groups = _groups(strata, n)
    method = "percentile" if nested else method
    # a resampled mean is a weighted one, and all of them are one matrix product
    replicates = np.concatenate([count @ curves / n for count in _counts(groups, resamples, seed, nested)])
    estimate = curves.mean(axis=0)
    jackknife = [(estimate * n - curves[g]) / (n - 1) for g in groups if g.size > 1]
    acceleration = _acceleration(jackknife) if method == "bca" and jackknife else np.zeros_like(estimate)
    low, high = _limits(estimate, replicates, confidence, method, acceleration)
    return Interval(estimate, low, high, confidence, method, n, resamples)


def time_interval(
    times: Times,
    *,
    horizon: float | None = None,
    strata: ArrayLike | None = None,
    seed: int = 0,
    resamples: int = 2000,
    confidence: float = 0.95,
    nested: bool = False,
) -> Interval:
    """Percentile interval of the restricted mean time up to ``horizon``, or else of the median time."""

    def summary(counts: NDArray[Any] | None) -> Any:
        return _median_time(times, counts) if horizon is None else _restricted_mean(times, horizon, counts)

    n = len(times.time)
    draws = _counts(_groups(strata, n), resamples, seed, nested)
    replicates = np.concatenate([np.asarray(summary(count)) for count in draws])
    estimate = np.asarray(summary(None))
    low, high = _limits(estimate, replicates, confidence, "percentile", 0.0)
    return Interval(float(estimate), float(low), float(high), confidence, "percentile", n, resamples)


# ---------------------------------------------------------------- comparisons


def paired_difference(
    arm: ArrayLike, reference: ArrayLike, *, statistic: Statistic = np.mean, **options: Any
) -> Interval:
    """Interval of ``statistic(arm - reference)`` for arms that share seeds; options as :func:`bootstrap`."""
    return bootstrap(statistic, _floats(arm, "the arm") - _floats(reference, "the reference"), **options)


def probability_of_improvement(
    arm: ArrayLike,
    reference: ArrayLike,
    *,
    better: Direction = "less",
    strata: ArrayLike | None = None,
    seed: int = 0,
    resamples: int = 2000,
    confidence: float = 0.95,
) -> Interval:
    """P(a random seed of the arm beats a random seed of the reference on the same map), ties counting half.

    The Mann-Whitney statistic per map, averaged over maps: Agarwal et al., "Deep RL at the Edge of the
    Statistical Precipice" (2021). Seeds of both are resampled within maps, together. Percentile interval.
    """
    a, b = _floats(arm, "the arm"), _floats(reference, "the reference")
    if a.shape != b.shape or a.ndim != 1:
        raise TaskliftError(f"stats: arms of shapes {a.shape} and {b.shape}, expected the same (n,)")
    groups = _groups(strata, a.size)
    wins = [(np.sign(a[g][:, None] - b[g]) * _gain(better) + 1) / 2 for g in groups]
    estimate = np.mean([win.mean() for win in wins])
    replicates = []
    for count in _counts(groups, resamples, seed, False):
        shares = [
            ((count[:, g] @ win) * count[:, g]).sum(axis=1) / g.size**2
            for g, win in zip(groups, wins, strict=True)
        ]
        replicates.append(np.mean(shares, axis=0))
    low, high = _limits(estimate, np.concatenate(replicates), confidence, "percentile", 0.0)
    return Interval(float(estimate), float(low), float(high), confidence, "percentile", a.size, resamples)


def sign_flip_test(difference: ArrayLike, *, seed: int = 0, flips: int = 9999) -> float:
    """Two-sided p-value that paired differences ``(n,)`` lie symmetric around zero, by flipping signs."""
    values = _floats(difference, "the differences")
    rng = np.random.default_rng(seed)
    observed = abs(values.sum()) * (1 - 1e-12)
    extreme = 0
    rows = max(1, _CHUNK // values.size)
    for start in range(0, flips, rows):
        signs = rng.integers(2, size=(min(rows, flips - start), values.size), dtype=np.int8) * 2.0 - 1.0
        extreme += int((abs(signs @ values) >= observed).sum())
    return (extreme + 1) / (flips + 1)


def holm(p: ArrayLike) -> Floats:
    """p-values adjusted after Holm (1979): comparing them with alpha keeps the family-wise error below it."""
    values = _floats(p, "p")
    order = np.argsort(values, kind="stable")
    adjusted = np.maximum.accumulate(values[order] * np.arange(values.size, 0, -1))
    result = np.empty_like(values)
    result[order] = np.minimum(adjusted, 1.0)
    return result


def benjamini_hochberg(p: ArrayLike) -> Floats:
    """p-values adjusted after Benjamini & Hochberg (1995), to bound the false discovery rate."""
    values = _floats(p, "p")
    order = np.argsort(values, kind="stable")
    scaled = values[order] * values.size / np.arange(1, values.size + 1)
    result = np.empty_like(values)
    result[order] = np.minimum(np.minimum.accumulate(scaled[::-1])[::-1], 1.0)
    return result


def verdict(interval: Interval, direction: Direction, reference: float = 0.0) -> Verdict:
    """Whether the quantity lies below (``"less"``) or above (``"greater"``) the reference.

    ``holds`` if the whole interval does, ``does not hold`` if the whole interval lies on the other side or is
    the reference itself, else ``undecided``.
    """
    sign = _gain(direction)
    ends = sorted((sign * (interval.low - reference), sign * (interval.high - reference)))
    if ends[0] > 0:
        return "holds"
    return "does not hold" if ends[1] < 0 or ends == [0, 0] else "undecided"


def equivalence(interval: Interval, margin: float) -> Verdict:
    """Whether the quantity is zero but for ``margin``: the interval lies inside (-margin, margin).

    With a 90 % interval this is the two one-sided tests procedure (TOST) at 5 %. ``does not hold`` if the
    interval lies wholly outside.
    """
    if not margin > 0:
        raise TaskliftError(f"stats.equivalence: margin {margin}, expected a positive number")
    if -margin < interval.low and interval.high < margin:
        return "holds"
    return "does not hold" if interval.low >= margin or interval.high <= -margin else "undecided"
