"""Statistics against published values, SciPy and simulation. Fixed seeds; random tests fail at p < 1e-3."""

from __future__ import annotations

import time

import numpy as np
import pytest
import scipy.stats
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp

from tasklift import stats
from tasklift.errors import TaskliftError

P = 1e-3

# Efron & Tibshirani, An Introduction to the Bootstrap (1993), table 14.1: spatial test, column A
SPATIAL = [
    48,
    36,
    20,
    29,
    42,
    42,
    20,
    42,
    22,
    41,
    45,
    14,
    6,
    0,
    33,
    28,
    34,
    4,
    32,
    24,
    47,
    41,
    24,
    26,
    30,
    41,
]
# the same, table 3.1: law school
LSAT = [576, 635, 558, 578, 666, 580, 555, 661, 651, 605, 653, 575, 545, 572, 594]
GPA = [3.39, 3.30, 2.81, 3.03, 3.44, 3.07, 3.00, 3.43, 3.36, 3.13, 3.12, 2.74, 2.76, 2.88, 2.96]
# Benjamini & Hochberg (1995), section 3.3
BH_P = [0.0001, 0.0004, 0.0019, 0.0095, 0.0201, 0.0278, 0.0298, 0.0344, 0.0459, 0.3240, 0.4262, 0.5719,
        0.6528, 0.7590, 1.0]  # fmt: skip
# Freireich et al. (1963), remission on 6-MP in weeks; negative: censored
REMISSION = [6, 6, 6, -6, 7, -9, 10, -10, -11, 13, 16, -17, -19, -20, 22, 23, -25, -32, -32, -34, -35]

arrays = hnp.arrays(np.float64, st.integers(1, 40), elements=st.floats(-1e3, 1e3))
probabilities = hnp.arrays(np.float64, st.integers(1, 30), elements=st.floats(0, 1))


def correlation(a, b, axis=-1):
    a, b = a - a.mean(axis=axis, keepdims=True), b - b.mean(axis=axis, keepdims=True)
    return (a * b).sum(axis=axis) / np.sqrt((a**2).sum(axis=axis) * (b**2).sum(axis=axis))


# ---------------------------------------------------------------- intervals


def test_bca_and_percentile_give_the_published_intervals_of_the_spatial_test():
    """Table 14.2: 90 % intervals of the variance; 2,000 resamples there, hence the tolerance."""
    bca = stats.bootstrap(np.var, SPATIAL, confidence=0.9, resamples=20_000)
    assert bca.estimate == pytest.approx(171.5, abs=0.05)
    assert (bca.low, bca.high) == pytest.approx((115.8, 259.6), abs=5)
    plain = stats.bootstrap(np.var, SPATIAL, confidence=0.9, resamples=20_000, method="percentile")
    assert (plain.low, plain.high) == pytest.approx((100.8, 233.9), abs=4)


@pytest.mark.parametrize(("ours", "theirs"), [("bca", "BCa"), ("percentile", "percentile")])
def test_law_school_correlation_agrees_with_scipy(ours, theirs):
    mine = stats.bootstrap(correlation, LSAT, GPA, method=ours, resamples=20_000, seed=1)
    other = scipy.stats.bootstrap(
        (np.array(LSAT), np.array(GPA)), correlation, paired=True, vectorized=True, method=theirs,
        n_resamples=20_000, rng=np.random.default_rng(2),
    ).confidence_interval  # fmt: skip
    assert mine.estimate == pytest.approx(0.776, abs=5e-4)
    assert (mine.low, mine.high) == pytest.approx((other.low, other.high), abs=0.015)


def test_strata_are_independent_samples_as_in_scipy():
    """The difference of two groups' sums, groups as strata, is scipy's two-sample bootstrap."""
    rng = np.random.default_rng(3)
    a, b = rng.exponential(size=12), rng.exponential(size=25)
    strata = [0] * 12 + [1] * 25
    signed = np.concatenate((a / 12, -b / 25))
    mine = stats.bootstrap(np.sum, signed, strata=strata, resamples=20_000)
    other = scipy.stats.bootstrap(
        (a, b), lambda x, y, axis: x.mean(axis=axis) - y.mean(axis=axis), vectorized=True,
        n_resamples=20_000, rng=np.random.default_rng(2),
    ).confidence_interval  # fmt: skip
    assert (mine.low, mine.high) == pytest.approx((other.low, other.high), abs=0.02)


def test_the_seed_decides_and_matters():
    values = np.random.default_rng(0).normal(size=(30, 5))
    for function in (
        lambda seed: stats.bootstrap(np.mean, values[:, 0], seed=seed).low,
        lambda seed: stats.mean_band(values, seed=seed).low[0],
        lambda seed: stats.probability_of_improvement(values[:, 0], values[:, 1], seed=seed).low,
        lambda seed: stats.sign_flip_test(values[:, 0], seed=seed),
        lambda seed: stats.time_interval(stats.Times(abs(values[:, 0]), values[:, 1] > 0), horizon=2, seed=seed).low,
    ):
        assert function(1) == function(1)
        assert len({function(seed) for seed in range(8)}) > 1


@pytest.mark.parametrize(("method", "statistic"), [("percentile", np.mean), ("bca", np.mean), ("bca", stats.iqm)])
def test_intervals_cover_as_often_as_they_say(method, statistic):
    """Skewed seeds on 3 maps, 400 studies: 92 % (small samples cost a little) to 97.5 %, at p = 1e-3."""
    rng = np.random.default_rng(11)
    offsets = np.repeat([0.0, 5.0, -3.0], 12)
    truth = statistic(rng.gamma(4.0, size=(100_000, 36)) + offsets, axis=-1).mean()
    covered = 0
    for study in range(400):
        sample = rng.gamma(4.0, size=36) + offsets
        found = stats.bootstrap(statistic, sample, strata=offsets, seed=study, resamples=800, method=method)
        covered += found.low <= truth <= found.high
    assert scipy.stats.binomtest(covered, 400, 0.92, "less").pvalue > P, covered
    assert scipy.stats.binomtest(covered, 400, 0.975, "greater").pvalue > P, covered


def test_resampling_trials_instead_of_seeds_would_claim_far_too_much():
    """With a spread between seeds, intervals with the trial as the unit cover the truth far too rarely."""
    rng = np.random.default_rng(5)
    by_trial, by_seed = 0, 0
    for study in range(200):
        curve = rng.normal(size=(20, 1)) + rng.normal(size=(20, 50))
        wrong = stats.bootstrap(np.mean, curve.ravel(), seed=study, resamples=300, method="percentile")
        right = stats.bootstrap(np.mean, curve.mean(axis=1), seed=study, resamples=300, method="percentile")
        by_trial += wrong.low <= 0 <= wrong.high
        by_seed += right.low <= 0 <= right.high
    assert scipy.stats.binomtest(by_trial, 200, 0.6, "greater").pvalue > P
    assert by_trial < 120 < by_seed
    assert scipy.stats.binomtest(by_seed, 200, 0.90, "less").pvalue > P


def test_strata_and_nesting_change_what_the_interval_speaks_of():
    """Maps that differ: within maps the interval is narrow, with maps drawn as well it is wide."""
    rng = np.random.default_rng(7)
    maps = np.repeat(np.arange(6), 10)
    values = 10.0 * maps + rng.normal(size=60)

    def width(**options):
        found = stats.bootstrap(np.mean, values, method="percentile", **options)
        return found.high - found.low

    assert width(strata=maps) < 0.2 * width()
    assert width() < width(strata=maps, nested=True)
    with pytest.raises(TaskliftError, match="as many seeds on every map"):
        stats.bootstrap(np.mean, values[:-1], strata=maps[:-1], nested=True)


@pytest.mark.parametrize("method", ["percentile", "bca"])
def test_mean_band_is_the_bootstrap_of_every_column(method):
    values = np.random.default_rng(8).gamma(1.0, size=(24, 4))
    strata = np.repeat([0, 1, 2], 8)
    band = stats.mean_band(values, strata=strata, seed=5, method=method, resamples=3000)
    for t in range(4):
        one = stats.bootstrap(np.mean, values[:, t], strata=strata, seed=5, method=method, resamples=3000)
        assert (band.estimate[t], band.low[t], band.high[t]) == pytest.approx((one.estimate, one.low, one.high))


def test_degenerate_samples_give_their_value():
    for method in ("bca", "percentile"):
        for sample in ([3.0], [3.0] * 9):
            found = stats.bootstrap(np.mean, sample, method=method)
            assert (found.estimate, found.low, found.high) == (3.0, 3.0, 3.0)


@given(arrays, st.floats(0.1, 10), st.floats(-10, 10))
@settings(deadline=None, derandomize=True, max_examples=40)
def test_intervals_follow_a_change_of_unit(values, scale, shift):
    one = stats.bootstrap(np.mean, values, resamples=200)
    two = stats.bootstrap(np.mean, scale * values + shift, resamples=200)
    size = max(1.0, abs(values).max()) * scale + abs(shift)
    assert two.low == pytest.approx(scale * one.low + shift, abs=1e-2 * size)
    assert two.high == pytest.approx(scale * one.high + shift, abs=1e-2 * size)
    assert one.low <= one.high


# ---------------------------------------------------------------- tests, corrections, verdicts


def test_corrections_give_the_published_decisions():
    """Benjamini & Hochberg (1995): their procedure rejects four of fifteen at 0.05, Holm's three."""
    assert (stats.benjamini_hochberg(BH_P) <= 0.05).sum() == 4
    assert (stats.holm(BH_P) <= 0.05).sum() == 3
    assert stats.holm([0.01, 0.04, 0.03, 0.005]) == pytest.approx([0.03, 0.06, 0.06, 0.02])  # R's p.adjust


@given(probabilities)
@settings(deadline=None, derandomize=True)
def test_benjamini_hochberg_is_scipys(p):
    assert stats.benjamini_hochberg(p) == pytest.approx(scipy.stats.false_discovery_control(p))


@given(probabilities)
@settings(deadline=None, derandomize=True)
def test_holm_is_step_down(p):
    """Its definition: reject in ascending order while p_(i) <= alpha / (m - i + 1)."""
    adjusted = stats.holm(p)
    for alpha in (0.01, 0.05, 0.2):
        count = 0
        for i, value in enumerate(np.sort(p)):
            if value * (p.size - i) > alpha:
                break
            count += 1
        assert (adjusted <= alpha).sum() >= count
        assert (adjusted[np.argsort(p, kind="stable")][:count] <= alpha).all()
        assert (adjusted <= alpha).sum() == count


def test_sign_flips_agree_with_scipy():
    values = np.random.default_rng(1).normal(0.4, size=18)
    theirs = scipy.stats.permutation_test(
        (values, np.zeros(18)), lambda a, b, axis: (a - b).mean(axis=axis), permutation_type="samples",
        n_resamples=20_000, vectorized=True, rng=np.random.default_rng(1),
    ).pvalue  # fmt: skip
    assert stats.sign_flip_test(values, flips=20_000) == pytest.approx(theirs, abs=0.01)
    assert stats.sign_flip_test(np.zeros(5)) == 1.0
    assert stats.sign_flip_test(np.arange(50) + 100.0, flips=999) == 1 / 1000  # never zero


def test_sign_flip_p_values_are_uniform_under_the_null():
    rng = np.random.default_rng(4)
    p = [stats.sign_flip_test(rng.normal(size=20), seed=i, flips=199) for i in range(300)]
    assert scipy.stats.binomtest(int((np.array(p) <= 0.1).sum()), 300, 0.1).pvalue > P


def test_probability_of_improvement_is_mann_whitney():
    rng = np.random.default_rng(2)
    a, b = rng.integers(0, 6, 20).astype(float), rng.integers(0, 8, 20).astype(float)
    u = scipy.stats.mannwhitneyu(b, a).statistic / 400
    assert stats.probability_of_improvement(a, b, better="less").estimate == pytest.approx(u)
    assert stats.probability_of_improvement(a, b, better="greater").estimate == pytest.approx(1 - u)
    two_maps = stats.probability_of_improvement(np.r_[a, a - 100], np.r_[b, b + 100], strata=[0] * 20 + [1] * 20)
    assert two_maps.estimate == pytest.approx((u + 1) / 2)
    assert two_maps.low < two_maps.estimate < two_maps.high


def test_paired_difference_uses_the_shared_seeds():
    rng = np.random.default_rng(6)
    shared = 100 * rng.normal(size=40)
    a, b = shared + rng.normal(size=40) - 2, shared + rng.normal(size=40)
    found = stats.paired_difference(a, b)
    assert stats.verdict(found, "less") == "holds"
    assert found.estimate == pytest.approx((a - b).mean())
    unpaired = stats.bootstrap(np.mean, a).high - stats.bootstrap(np.mean, b).low
    assert unpaired > 0 > found.high


def interval(low, high):
    return stats.Interval((low + high) / 2, low, high, 0.95, "bca", 10, 100)


@pytest.mark.parametrize(
    ("low", "high", "less", "greater"),
    [
        (-2, -1, "holds", "does not hold"),
        (1, 2, "does not hold", "holds"),
        (-1, 1, "undecided", "undecided"),
        (0, 0, "does not hold", "does not hold"),
        (0, 1, "undecided", "undecided"),
    ],
)
def test_verdict(low, high, less, greater):
    assert stats.verdict(interval(low, high), "less") == less
    assert stats.verdict(interval(low, high), "greater") == greater
    assert stats.verdict(interval(low + 5, high + 5), "less", reference=5) == less


def test_equivalence():
    assert stats.equivalence(interval(-0.9, 0.9), 1) == "holds"
    assert stats.equivalence(interval(-0.9, 1.0), 1) == "undecided"
    assert stats.equivalence(interval(-3, 3), 1) == "undecided"
    assert stats.equivalence(interval(1.5, 3), 1) == stats.equivalence(interval(-3, -1), 1) == "does not hold"
    with pytest.raises(TaskliftError, match="margin"):
        stats.equivalence(interval(0, 1), 0)


# ---------------------------------------------------------------- metrics


@given(arrays)
@settings(deadline=None, derandomize=True)
def test_iqm_is_scipys_trimmed_mean(values):
    assert stats.iqm(values) == pytest.approx(scipy.stats.trim_mean(values, 0.25), abs=1e-9)


def test_kaplan_meier_gives_the_published_remission_table():
    data = np.array(REMISSION, dtype=float)
    times = stats.Times(abs(data), data > 0)
    when, survival = stats.kaplan_meier(times)
    published = {6: 0.857, 7: 0.807, 10: 0.753, 13: 0.690, 16: 0.627, 22: 0.538, 23: 0.448, 35: 0.448}
    found = dict(zip(when, survival, strict=True))
    assert {t: round(found[t], 3) for t in published} == published
    assert stats.median_time(times) == 23
    # area under those steps up to 10 weeks: 6 x 1 + 1 x .857 + 3 x .807
    assert stats.restricted_mean_time(times, 10) == pytest.approx(6 + 0.857 + 3 * 0.807, abs=2e-3)


@given(st.lists(st.tuples(st.integers(1, 9), st.booleans()), min_size=1, max_size=25), st.integers(1, 12))
@settings(deadline=None, derandomize=True)
def test_survival_is_scipys_and_the_restricted_mean_its_area(seeds, horizon):
    time_, reached = np.array([s[0] for s in seeds], float), np.array([s[1] for s in seeds])
    times = stats.Times(time_, reached)
    data = scipy.stats.CensoredData(uncensored=time_[reached], right=time_[~reached])
    theirs = scipy.stats.ecdf(data).sf
    when, survival = stats.kaplan_meier(times)
    assert survival == pytest.approx(theirs.evaluate(when), abs=1e-9)
    grid = np.arange(horizon) + 0.5
    assert stats.restricted_mean_time(times, horizon) == pytest.approx(theirs.evaluate(grid).sum(), abs=1e-9)
    whole = stats.Times(time_, np.ones(time_.size, bool))
    assert stats.restricted_mean_time(whole, horizon) == pytest.approx(np.minimum(time_, horizon).mean())
    found = stats.time_interval(times, horizon=horizon, resamples=100)
    assert found.low - 1e-9 <= found.high <= horizon + 1e-9


def test_time_to_threshold_censors_and_includes_the_source():
    curve = np.array([[9, 9, 3, 3, 3, 3.0], [9, 9, 9, 9, 9, 9], [1, 1, 1, 1, 1, 1]])
    found = stats.time_to_threshold(curve, 3, window=2)
    assert found.time.tolist() == [4, 6, 2]
    assert found.reached.tolist() == [True, False, True]
    steps = stats.time_to_threshold(curve, 3, window=2, cost=curve, source=[10, 20, 30])
    assert steps.time.tolist() == [34, 74, 32]
    assert stats.median_time(stats.Times(found.time[1:2], found.reached[1:2])) == np.inf
    up = stats.time_to_threshold(-curve, -3, window=2, better="greater")
    assert up.time.tolist() == found.time.tolist()
    lost = stats.losses_until_threshold(np.ones((3, 6)), curve, 3, window=2, source=5)
    assert lost.time.tolist() == [9, 11, 7]
    assert lost.reached.tolist() == [True, False, True]


@given(hnp.arrays(np.float64, (3, 12), elements=st.integers(0, 9)), st.integers(1, 12), st.integers(0, 9))
@settings(deadline=None, derandomize=True)
def test_time_to_threshold_is_its_definition(curve, window, threshold):
    found = stats.time_to_threshold(curve, threshold, window=window)
    for row, time_, reached in zip(curve, found.time, found.reached, strict=True):
        hits = [t for t in range(window, 13) if row[t - window : t].sum() <= threshold * window]
        assert reached == bool(hits)
        assert time_ == (hits[0] if hits else 12)


def test_transfer_metrics_target_only_and_source_included():
    arm, plain = np.full((2, 10), 200.0), np.tile(np.linspace(500, 50, 10), (2, 1))
    assert stats.jumpstart(arm, plain, first=2).tolist() == [275, 275]
    # the reference, two trials of its own later, is at 400 and 350
    assert stats.jumpstart(arm, plain, first=2, spent=2).tolist() == [175, 175]
    assert stats.jumpstart(-arm, -plain, first=2, better="greater").tolist() == [275, 275]
    assert stats.asymptotic(plain, last=2).tolist() == [75, 75]
    assert stats.area_under_curve(arm).tolist() == [2000, 2000]
    assert stats.area_under_curve(arm, source=np.full((2, 3), 100.0)).tolist() == [2300, 2300]
    total, base = stats.area_under_curve(arm), stats.area_under_curve(plain)
    assert stats.transfer_ratio(total, base) == pytest.approx(1 - 2000 / 2750)
    assert stats.transfer_ratio(total, base, variant="quotient") == pytest.approx(2000 / 2750)
    totals = total + np.array([0, 1]), base + np.array([5, 0])
    ratio = stats.bootstrap(stats.transfer_ratio, *totals, resamples=200)
    assert ratio.low <= ratio.estimate <= ratio.high
    performance, reference = np.full((1, 4), 0.75), np.full((1, 4), 0.5)
    assert stats.forward_transfer(performance, reference) == pytest.approx([0.5])
    # two of six trials at zero: (0.5 - 0.5) / 0.5
    assert stats.forward_transfer(performance, np.full((1, 6), 0.5), spent=2) == pytest.approx([0.0])
    assert np.isnan(stats.forward_transfer(performance, np.ones((1, 4)))).all()
    assert stats.negative_transfer([-1, 0, 2, -3]) == 0.5


def test_loss_metrics():
    losses, source = np.array([[1, 2, 0], [0, 0, 4]]), np.array([[3, 1], [0, 0]])
    assert stats.losses_total(losses).tolist() == [3, 4]
    assert stats.losses_total(losses, source=source).tolist() == [7, 4]
    ledger = stats.losses_by_stage({"sweep": source, "target": losses})
    assert {k: v.tolist() for k, v in ledger.items()} == {"sweep": [4, 0], "target": [3, 4], "total": [7, 4]}
    steps = np.full((2, 3), 500)
    assert stats.losses_per_1000_steps(losses, steps) == pytest.approx([2, 8 / 3])
    assert stats.losses_per_1000_steps(losses, steps, source_losses=[4, 0], source_steps=500).tolist() == [
        3.5,
        2,
    ]


# ---------------------------------------------------------------- bad input, speed


@pytest.mark.parametrize(
    "call",
    [
        lambda: stats.bootstrap(np.mean, []),
        lambda: stats.bootstrap(np.mean, [1, np.nan]),
        lambda: stats.bootstrap(correlation, [1, 2], [1, 2, 3]),
        lambda: stats.bootstrap(np.mean, [1, 2], strata=[1]),
        lambda: stats.bootstrap(np.mean, [1, 2], confidence=95),
        lambda: stats.bootstrap(np.mean, [1, 2], method="normal"),
        lambda: stats.mean_band([1, 2, 3]),
        lambda: stats.verdict(interval(0, 1), "up"),
        lambda: stats.jumpstart([[1, 2]], [[1, 2]], first=3),
        lambda: stats.jumpstart([[1, 2]], [[1, 2]], first=2, spent=1),
        lambda: stats.asymptotic([[1, 2]], last=3),
        lambda: stats.time_to_threshold([[1, 2]], 1, window=3),
        lambda: stats.transfer_ratio([1], [1], variant="area"),
        lambda: stats.forward_transfer([[2.0]], [[0.5]]),
        lambda: stats.forward_transfer([[0.5]], [[0.5, 0.5]]),
        lambda: stats.losses_by_stage({}),
        lambda: stats.losses_per_1000_steps([[1]], [[0]]),
        lambda: stats.probability_of_improvement([1, 2], [1]),
    ],
)
def test_bad_input_is_named(call):
    with pytest.raises(TaskliftError, match="stats"):
        call()


def test_a_hundred_thousand_rows_take_well_under_ten_seconds():
    """7 arms x 1,000 seeds x 100 trials, several statistics each: 2 s; the limit is for slow machines."""
    rng = np.random.default_rng(0)
    strata = np.repeat(np.arange(10), 100)
    steps = rng.integers(50, 600, size=(7, 1000, 100))
    start = time.perf_counter()
    for arm in steps:
        stats.mean_band(arm, strata=strata)
        stats.paired_difference(
            stats.area_under_curve(arm), stats.area_under_curve(steps[0]), strata=strata, statistic=stats.iqm
        )
        stats.time_interval(stats.time_to_threshold(arm, 320), horizon=100, strata=strata)
        stats.probability_of_improvement(stats.asymptotic(arm), stats.asymptotic(steps[0]), strata=strata)
    assert time.perf_counter() - start < 30
