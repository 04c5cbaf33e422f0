"""Intervals that are too narrow for few seeds; what still uses them moves to :func:`tasklift.stats.compare`."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from typing import Any, Literal

import numpy as np
from numpy.typing import ArrayLike, NDArray

from tasklift.errors import TaskliftError
from tasklift.stats.paired import Floats
from tasklift.stats.paired import floats as _floats
from tasklift.stats.verdicts import Direction, Interval, Verdict
from tasklift.stats.verdicts import gain as _gain

Method = Literal["bca", "percentile"]
Statistic = Callable[..., Any]  # statistic(*samples, axis=-1), reducing that axis

_CHUNK = 4_000_000  # elements gathered at once while resampling: 32 MB


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
    return Interval(float(estimate), float(low), float(high), confidence, n)


def paired_difference(
    arm: ArrayLike, reference: ArrayLike, *, statistic: Statistic = np.mean, **options: Any
) -> Interval:
    """Interval of ``statistic(arm - reference)`` for arms that share seeds; options as :func:`bootstrap`."""
    return bootstrap(statistic, _floats(arm, "the arm") - _floats(reference, "the reference"), **options)


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
