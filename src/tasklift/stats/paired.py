"""The test behind every verdict on paired seeds: sign flips and a studentised bootstrap, the larger p of both."""

from __future__ import annotations

import math
from functools import lru_cache
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from tasklift.errors import TaskliftError

Floats = NDArray[np.float64]

LEVEL = 0.05
"""A verdict falls where p is at most this."""

RESAMPLES = 9999
_ENUMERATED = 16  # seeds up to which all signs are tried: 2^16, and by symmetry half of them
_CHUNK = 2_000_000  # elements multiplied at once: 16 MB


def floats(values: ArrayLike, what: str) -> Floats:
    """Return finite numbers as an array, or raise."""
    array = np.asarray(values, dtype=np.float64)
    if array.size == 0 or array.ndim == 0:
        raise TaskliftError(f"stats: {what} has shape {array.shape}; give at least one value")
    if not np.isfinite(array).all():
        raise TaskliftError(f"stats: {what} holds a value that is not finite; find the run it comes from")
    return array


def seeds_needed(asked: int = 1) -> int:
    """Return the fewest seeds with which a sign-flip test can reach 5 % after Holm's correction for ``asked`` tests.

    All n signs are equal by chance with probability 2 / 2^n.

    >>> seeds_needed(), seeds_needed(84)
    (6, 12)
    """
    return math.ceil(math.log2(asked * 2 / LEVEL))


def groups_of(strata: ArrayLike | None, n: int) -> list[NDArray[np.int64]]:
    """Return the places of each stratum's seeds; one stratum where the seeds of some map are too few for a spread."""
    if strata is None:
        return [np.arange(n)]
    labels = np.asarray(strata)
    if labels.shape != (n,):
        raise TaskliftError(f"stats: strata has shape {labels.shape}, expected ({n},): one map per seed")
    _, group, size = np.unique(labels, return_inverse=True, return_counts=True)
    if size.min() < 4:
        return [np.arange(n)]
    return [np.flatnonzero(group == g) for g in range(len(size))]


@lru_cache(maxsize=8)
def _signs(n: int, seed: int, resamples: int) -> NDArray[np.int8]:
    """Return rows of signs, the first all positive; of a row and its negative one is left out."""
    if n <= _ENUMERATED:
        return (1 - 2 * ((np.arange(2 ** (n - 1))[:, None] >> np.arange(n)) & 1)).astype(np.int8)
    signs = 1 - 2 * np.random.default_rng((seed, 1)).integers(2, size=(resamples + 1, n), dtype=np.int8)
    signs[0] = 1
    return signs


@lru_cache(maxsize=8)
def counts(sizes: tuple[int, ...], seed: int, resamples: int) -> NDArray[np.uint16]:
    """Return how often each seed is drawn ``(resamples, n)``, just over half of every stratum's, one by one."""
    rng = np.random.default_rng((seed, 2))
    drawn = []
    for size in sizes:
        at = rng.integers(size, size=(resamples, half(size))) + size * np.arange(resamples)[:, None]
        drawn.append(np.bincount(at.ravel(), minlength=size * resamples).reshape(resamples, size).astype(np.uint16))
    return np.concatenate(drawn, axis=1)


def half(size: Any) -> Any:
    """Return the number of seeds in a resample: just over half of ``size``."""
    return size // 2 + 1


def by_stratum(weights: NDArray[Any], columns: Floats, sizes: NDArray[np.int64]) -> Floats:
    """Return ``(columns, rows, H)``: sums within strata of columns ``(columns, n)``, weighted by rows ``(rows, n)``.

    Seeds stand stratum after stratum.
    """
    ends = np.cumsum(sizes)
    places = [slice(end - size, end) for size, end in zip(sizes, ends, strict=True)]
    found = []
    for part in np.array_split(weights, 1 + weights.size // _CHUNK):
        whole = part.astype(np.float64)
        found.append(np.stack([columns[:, at] @ whole[:, at].T for at in places], axis=-1))
    return np.concatenate(found, axis=1)


class PairedTest:
    r"""Is the mean of x = u − θ v zero? Two tests; the larger of their p-values counts.

    *Sign flips* (Fisher 1935). Where the arms of a pair could be exchanged, or x is symmetric about 0, every choice
    of signs of x is as likely. The statistic is the mean over its standard error within strata. Exact for any
    number of seeds: all signs are tried up to 16 seeds, random ones beyond.

    *Studentised bootstrap* (Hall 1988). The same statistic in resamples within strata, about the sample's own mean,
    follows a skewed distribution, which sign flips do not. Few seeds understate how skewed their distribution is:
    so resamples take just over half of the seeds. That errs on the safe side, and costs nothing with many seeds.
    The sample counts as one more resample. Of six seeds there are 126 different resamples, however many are drawn.

    To reject only where both do keeps the level if either assumption is right (an intersection-union test). For a
    difference v is 1; for a ratio of means it is the denominator, and θ the ratio (Fieller 1954).

    Shapes: ``H`` strata, ``n`` seeds.
    """

    def __init__(self, u: Floats, v: Floats, strata: ArrayLike | None, seed: int, resamples: int) -> None:
        groups = groups_of(strata, u.size)
        columns = np.stack([u, v])[:, np.concatenate(groups)]
        self.n = u.size
        self._sizes = np.array([group.size for group in groups])
        once = np.ones((1, self.n), dtype=np.int8)
        self._total = by_stratum(once, columns, self._sizes)[:, 0]
        about = columns - np.repeat(self._total / self._sizes, self._sizes, axis=1)
        about[abs(about) < 1e-12 * abs(columns).max(axis=1, keepdims=True)] = 0.0
        self._squares = by_stratum(once, _products(columns), self._sizes)[:, 0]
        self._spread = by_stratum(once, _products(about), self._sizes)[:, 0]
        self._flipped = by_stratum(_signs(self.n, seed, resamples), columns, self._sizes)
        drawn = counts(tuple(self._sizes.tolist()), seed, resamples)
        self._drawn = by_stratum(drawn, np.concatenate([about, _products(about)]), self._sizes)
        self._distinct = min(resamples, math.prod(math.comb(int(n + half(n)) - 1, int(half(n))) for n in self._sizes))
        self._same = None if about[1].any() else self._resampled(0.0)

    @property
    def estimate(self) -> float:
        """The θ at which the mean of x is zero."""
        u, v = self._total.sum(axis=-1)
        return float(u / v)

    def sides(self, theta: float) -> tuple[float, float]:
        """Return one-sided p-values: small where the mean of x lies below zero; where it lies above."""
        mean, error = self._observed(theta)
        if mean == 0:
            return 1.0, 1.0
        flipped = abs(statistic(_linear(self._flipped, theta), _square(self._squares, theta), self._sizes, self._sizes))
        # every row stands for its negative, too: half of those as extreme lie on the estimate's side
        flips = float((flipped >= flipped[0] * (1 - 1e-9)).mean()) / 2
        if error == 0:  # nothing to resample: as if a third of the seeds were there
            below = above = 0.5 ** (self.n // 3)
        else:
            drawn = self._resampled(theta) if self._same is None else self._same
            below = self._tail(np.searchsorted(drawn, mean / error, side="right"), drawn.size)
            above = self._tail(drawn.size - np.searchsorted(drawn, mean / error, side="left"), drawn.size)
        return (max(flips, below), 1.0) if mean < 0 else (1.0, max(flips, above))

    @property
    def error(self) -> float:
        """Standard error of the estimate; nan where the mean of v is zero."""
        scale = abs(float(self._total[1].sum())) / self.n
        return self._observed(self.estimate)[1] / scale if scale else math.nan

    @property
    def shown(self) -> bool:
        """Whether there is an interval: seeds enough, and a spread."""
        return self.n >= seeds_needed() and self.error > 0

    def limits(self, confidence: float) -> tuple[float, float]:
        """Return the ends of what is not rejected on either side; infinite where nothing is, or without interval."""
        if not 0 < confidence < 1:
            raise TaskliftError(f"stats: confidence {confidence}, expected a share between 0 and 1")
        if not self.shown:
            return -math.inf, math.inf
        return self._end(-self.error, (1 - confidence) / 2), self._end(self.error, (1 - confidence) / 2)

    def _end(self, step: float, tail: float) -> float:
        """Return the θ beyond which all are rejected, searched for in the direction of the step."""
        side = 0 if step > 0 else 1
        within = 0.0
        for doubling in range(40):
            beyond = step * 2.0**doubling
            if self.sides(self.estimate + beyond)[side] <= tail:
                break
            within = beyond
        else:
            return math.copysign(math.inf, step)
        for _ in range(22):
            middle = (within + beyond) / 2
            within, beyond = (within, middle) if self.sides(self.estimate + middle)[side] <= tail else (middle, beyond)
        return self.estimate + beyond

    def _observed(self, theta: float) -> tuple[float, float]:
        """Return mean and standard error of x."""
        mean = _linear(self._total, theta).sum() / self.n
        spread = _square(self._spread, theta)
        parts = spread / (self._sizes * np.maximum(self._sizes - 1, 1)) * (self._sizes / self.n) ** 2
        return float(mean), float(np.sqrt(parts.sum()))

    def _tail(self, extreme: Any, drawn: int) -> float:
        """Return the p-value of as many resamples of those drawn; the sample itself is one more."""
        return float(1 + extreme * self._distinct / drawn) / (1 + self._distinct)

    def _resampled(self, theta: float) -> Floats:
        """Return the statistic of every resample about the sample's mean, sorted."""
        sums, squares = _linear(self._drawn[:2], theta), _square(self._drawn[2:], theta)
        return np.sort(statistic(sums, squares, self._sizes, half(self._sizes)))


def statistic(sums: Floats, squares: Floats, strata: NDArray[np.int64], sizes: NDArray[np.int64]) -> Floats:
    """Return stratified means over their standard errors.

    Parameters
    ----------
    sums, squares
        ``(..., H)``: of the values, of their squares.
    strata, sizes
        ``(H,)``: seeds in each stratum, and how many of them are in the sums.
    """
    share, sizes = strata / strata.sum(), sizes.astype(np.float64)
    left = squares - sums**2 / sizes
    left[left < 1e-12 * squares] = 0.0
    mean = sums / sizes @ share
    error = np.sqrt(left / (sizes * np.maximum(sizes - 1, 1)) @ share**2)
    mean[abs(mean) < 1e-12 * np.sqrt(squares.max(initial=0.0))] = 0.0
    with np.errstate(divide="ignore", invalid="ignore"):
        return np.asarray(np.where(mean == 0, 0.0, mean / error))


def _products(columns: Floats) -> Floats:
    u, v = columns
    return np.stack([u * u, u * v, v * v])


def _linear(sums: Floats, theta: float) -> Floats:
    """Return sums of x = u − θ v from those of u and v."""
    return np.asarray(sums[0] - theta * sums[1])


def _square(sums: Floats, theta: float) -> Floats:
    """Return sums of x² from those of u², uv and v²."""
    return np.asarray(sums[0] - 2 * theta * sums[1] + theta**2 * sums[2])
