"""How often verdicts are wrong, intervals miss, and true differences are found: by simulation.

``python tests/null_simulation.py [DRAWS]`` prints the tables of docs/quality.md; ``tests/test_stats.py`` asks the same
with fewer draws.

The mean of the values is zero: there is nothing to find. There are two ways for that to be so. Both arms do the same,
and a value is the difference of two draws from one distribution; or they do not, and the values are skewed about
zero.
"""

from __future__ import annotations

import sys
from collections.abc import Callable, Sequence

import numpy as np
from numpy.typing import NDArray

from tasklift import stats
from tasklift.learning.guard import SequentialTest
from tasklift.studies.multiverse.study import draw, main_effects

Draw = Callable[[np.random.Generator, int], NDArray[np.float64]]


def inflated(rng: np.random.Generator, n: int) -> NDArray[np.float64]:
    """Return losses of which seven in ten are zero; their mean is 0.3."""
    return rng.exponential(size=n) * (rng.random(n) < 0.3)


def _two(draw: Draw) -> Draw:
    return lambda rng, n: draw(rng, n) - draw(rng, n)


NULLS: dict[str, Draw] = {
    "normal": lambda rng, n: rng.normal(size=n),
    "two exponentials": _two(lambda rng, n: rng.exponential(size=n)),
    "two lognormals": _two(lambda rng, n: rng.lognormal(size=n)),
    "two zero-inflated": _two(inflated),
    "exponential": lambda rng, n: rng.exponential(size=n) - 1,
    "lognormal": lambda rng, n: rng.lognormal(size=n) - np.exp(0.5),
    "zero-inflated": lambda rng, n: inflated(rng, n) - 0.3,
}
#: One arm always loses a little, the other one rarely and much; their means are the same.
RARE: dict[str, Draw] = {"exponential, zero-inflated": lambda rng, n: 0.3 * rng.exponential(size=n) - inflated(rng, n)}
#: Pairs of positive arms, and the ratio of their means.
RATIOS: dict[str, tuple[Draw, Draw, float]] = {
    "lognormal / lognormal": (lambda rng, n: 4 * rng.lognormal(size=n), lambda rng, n: rng.lognormal(size=n), 4.0),
    "exponential / zero-inflated": (lambda rng, n: 3 * rng.exponential(size=n), inflated, 10.0),
    "zero-inflated / exponential": (inflated, lambda rng, n: rng.exponential(size=n), 0.3),
    "Poisson / Poisson": (
        lambda rng, n: rng.poisson(20, size=n) * 1.0, lambda rng, n: rng.poisson(1, size=n) * 1.0, 20.0,
    ),
    "Poisson / rare Poisson": (
        lambda rng, n: rng.poisson(5, size=n) * 1.0, lambda rng, n: rng.poisson(0.5, size=n) * 1.0, 10.0,
    ),
}  # fmt: skip
#: Seeds, and the maps that they are divided over: 4 × 5 is a reading of the multiverse, 6 × 5 the reproduction.
DESIGNS = ((6, 1), (8, 1), (10, 1), (30, 1), (20, 4), (30, 6))
RATIO_SEEDS = (10, 15, 30)
#: Pairs of trials that a guard compares: a tenth of 100 to 3,000 trials.
PAIRS = (10, 30, 100, 300)


def strata(n: int, maps: int) -> NDArray[np.int64] | None:
    """Return each seed's map; None for one map."""
    return None if maps == 1 else np.repeat(np.arange(maps), n // maps)


def _effects(n: int, maps: int, rng: np.random.Generator) -> NDArray[np.float64]:
    effects = rng.normal(scale=2.0, size=maps)
    return np.repeat(effects - effects.mean(), n // maps)


def errors(draw: Draw, n: int, maps: int = 1, *, draws: int, resamples: int, shift: float = 0.0) -> tuple[float, float]:
    """Return the share of samples with a verdict, and of the intervals that are shown those that miss zero.

    Maps differ from one another by twice the standard deviation of a normal seed; their mean effect is ``shift``.
    """
    rng = np.random.default_rng((n, maps))
    found = shown = missed = 0
    for number in range(draws):
        values = draw(rng, n) + _effects(n, maps, rng) + shift
        test = stats.PairedTest(values, np.ones(n), strata(n, maps), number % 10, resamples)
        verdict = 2 * min(test.sides(0.0)) <= stats.LEVEL
        found += verdict
        shown += test.shown
        missed += verdict and test.shown
    return found / draws, missed / max(shown, 1)


def ratio_errors(arms: tuple[Draw, Draw, float], n: int, *, shown: int, resamples: int) -> tuple[float, float]:
    """Return how often a ratio's interval misses the truth, of ``shown`` ones; and the share of samples with one."""
    rng = np.random.default_rng(n)
    above, below, truth = arms
    found = missed = draws = 0
    while found < shown:
        a, b = above(rng, n), below(rng, n)
        draws += 1
        if stats.bounds_ratio(a, b):
            test = stats.PairedTest(a, b, None, found % 10, resamples)
            found += 1
            missed += 2 * min(test.sides(truth)) <= stats.LEVEL
    return missed / shown, shown / draws


def median_errors(n: int, *, draws: int) -> float:
    """Return how often the interval of a median time misses it; exponential times, half of them censored."""
    rng = np.random.default_rng(n)
    missed = 0
    for _ in range(draws):
        time, end = rng.exponential(size=n), rng.exponential(scale=1.5, size=n)
        found = stats.median_time(stats.Times(np.minimum(time, end), time <= end))
        missed += not found.low <= np.log(2) <= found.high
    return missed / draws


def band_errors(draw: Draw, n: int, maps: int, *, draws: int, resamples: int) -> float:
    """Return how often a band misses zero at a trial; the trials of a curve are independent here."""
    rng = np.random.default_rng((n, maps))
    missed = shown = 0
    for number in range(draws):
        curves = np.stack([draw(rng, n) + _effects(n, maps, rng) for _ in range(50)], axis=1)
        band = stats.mean_band(curves, strata=strata(n, maps), seed=number % 10, resamples=resamples)
        known = np.isfinite(band.low) & np.isfinite(band.high)
        shown += known.sum()
        missed += (known & ((band.low > 0) | (band.high < 0))).sum()
    return missed / max(shown, 1)


def guard_verdicts(draw: Draw, pairs: int, *, draws: int, shift: float = 0.0) -> tuple[float, float]:
    """Return how often a guard that looks after every pair ever says "helps", and "hurts"."""
    rng = np.random.default_rng(pairs)
    found = []
    for _ in range(draws):
        test, verdict = SequentialTest(), "can't tell yet"
        for gap in np.sign(draw(rng, pairs) - draw(rng, pairs) + shift):
            if verdict == "can't tell yet":
                verdict = test.update(float(gap))
        found.append(verdict)
    return found.count("helps") / draws, found.count("hurts") / draws


def deciding_errors(verdicts: Sequence[float], *, draws: int) -> float:
    """Return how often a multiverse of 500 readings names an option that decides, where none does.

    ``verdicts``: the shares of *does not hold*, *undecided* and *holds*, for 16 claims that no option changes.
    """
    rng, levels = np.random.default_rng(1), draw(500)
    outcomes = (rng.choice([-1.0, 0.0, 1.0], p=verdicts, size=(500, 16)) for _ in range(draws))
    return sum(main_effects(outcome, levels, resamples=2).decides.any() for outcome in outcomes) / draws


def _table(title: str, columns: Sequence[str], rows: Sequence[Sequence[str]]) -> None:
    print(f"\n{title}\n")
    for row in [columns, ["---"] * len(columns), *rows]:
        print("| " + " | ".join(row) + " |", flush=True)


def main(draws: int, resamples: int = 999) -> None:
    """Print all tables, in percent."""
    names = [f"{n}" if maps == 1 else f"{maps} × {n // maps}" for n, maps in DESIGNS]

    def percent(share: float) -> str:
        return f"{100 * share:.1f}"

    found = {
        name: [errors(draw, n, maps, draws=draws, resamples=resamples) for n, maps in DESIGNS]
        for name, draw in (NULLS | RARE).items()
    }
    _table("False verdicts (%)", ["values", *names], [[k, *(percent(v) for v, _ in row)] for k, row in found.items()])
    missed = [[name, *(percent(miss) for _, miss in row)] for name, row in found.items()]
    _table("Intervals that miss (%)", ["values", *names], missed)
    power = [
        [f"{shift:g}", *(
            percent(errors(NULLS["normal"], n, maps, draws=draws // 4, resamples=resamples, shift=shift)[0])
            for n, maps in DESIGNS
        )]
        for shift in (0.5, 1.0, 1.5, 2.0, 4.0)
    ]  # fmt: skip
    _table("Power (%): true differences in standard deviations, normal", ["difference", *names], power)
    rows = []
    for name, arms in RATIOS.items():
        cells = [ratio_errors(arms, n, shown=draws // 2, resamples=resamples) for n in RATIO_SEEDS]
        rows.append([name, *(f"{percent(missed)} ({percent(share)})" for missed, share in cells)])
    _table("Ratios: intervals that miss (of the samples that have one, %)", ["values", *map(str, RATIO_SEEDS)], rows)
    medians = [[percent(median_errors(n, draws=draws * 4)) for n in (6, 8, 10, 30)]]
    _table("Median times: intervals that miss (%)", ["6", "8", "10", "30"], medians)
    bands = [
        [name, *(percent(band_errors(draw, n, maps, draws=draws // 20, resamples=resamples)) for n, maps in DESIGNS)]
        for name, draw in NULLS.items()
    ]
    _table("Bands of curves: trials missed (%)", ["values", *names], bands)
    mixed, rare = (percent(deciding_errors(shares, draws=draws // 20)) for shares in ((0.2, 0.5, 0.3), (0, 0.95, 0.05)))
    _table("Multiverses that name an option (%)", ["mixed verdicts", "rare ones"], [[mixed, rare]])
    columns = [f"{pairs} pairs" for pairs in PAIRS]
    guarded = []
    for name in ("normal", "lognormal", "zero-inflated"):
        rates = [guard_verdicts(NULLS[name], pairs, draws=draws // 2) for pairs in PAIRS]
        for k, word in enumerate(("helps", "hurts")):
            guarded.append([f"{name}: {word}", *(percent(rate[k]) for rate in rates)])
    _table("The guard, where there is nothing (%)", ["values", *columns], guarded)
    helped = [
        [f"{shift:g}", *(percent(guard_verdicts(NULLS["normal"], p, draws=draws // 4, shift=shift)[0]) for p in PAIRS)]
        for shift in (0.5, 1.0, 2.0)
    ]
    _table('The guard, power (%): "helps", difference in standard deviations', ["difference", *columns], helped)


if __name__ == "__main__":
    main(int(sys.argv[1]) if len(sys.argv) > 1 else 2000)
