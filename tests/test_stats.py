"""Statistics against published values, SciPy, their definition and simulation. Fixed seeds."""

from __future__ import annotations

import itertools
import math
import time

import numpy as np
import pytest
import scipy.stats
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp

import null_simulation as simulation
from tasklift import stats
from tasklift.errors import TaskliftError

P = 1e-3

# Darwin's maize (1876), crossed less self-fertilised plants in eighths of an inch; Fisher, The Design of Experiments
# (1935), section 21: 863 of the 32,768 choices of signs give a sum of at least 314 on one side
DARWIN = [49, -67, 8, 16, 6, 23, 28, 41, 14, 29, 56, 24, 75, 60, -48]
# Benjamini & Hochberg (1995), section 3.3
BH_P = [0.0001, 0.0004, 0.0019, 0.0095, 0.0201, 0.0278, 0.0298, 0.0344, 0.0459, 0.3240, 0.4262, 0.5719,
        0.6528, 0.7590, 1.0]  # fmt: skip
# Freireich et al. (1963), remission on 6-MP in weeks; negative: censored
REMISSION = [6, 6, 6, -6, 7, -9, 10, -10, -11, 13, 16, -17, -19, -20, 22, 23, -25, -32, -32, -34, -35]

samples = hnp.arrays(np.float64, st.integers(6, 20), elements=st.integers(-40, 40).map(float))
probabilities = hnp.arrays(np.float64, st.integers(1, 30), elements=st.floats(0, 1))


# ---------------------------------------------------------------- how often verdicts are wrong


@pytest.mark.parametrize("design", simulation.DESIGNS)
@pytest.mark.parametrize("name", simulation.NULLS)
def test_verdicts_are_wrong_and_intervals_miss_in_at_most_six_percent(name, design):
    """At p = 1e-3 over 400 samples; `python tests/null_simulation.py` measures it more finely."""
    wrong, missed = simulation.errors(simulation.NULLS[name], *design, draws=400, resamples=399)
    bound = scipy.stats.binom.isf(P, 400, 0.06) / 400
    assert wrong <= bound
    assert missed <= bound + 0.01  # of those that are shown, fewer than 400


@pytest.mark.parametrize("n", [1, 2, 3, 4, 5])
def test_five_seeds_or_fewer_get_no_verdict_and_no_interval(n):
    for name, draw in simulation.NULLS.items():
        values = draw(np.random.default_rng((n, *name.encode())), n) + 100
        for found in (stats.compare(values), stats.ratio(values, values + 1), stats.equivalent(values, margin=1000)):
            assert found.verdict == "too few"
            assert found.says == f"too few seeds ({n} of at least 6)"
            assert (found.interval.low, found.interval.high) == (-math.inf, math.inf)
            assert "inf" not in str(found)
        assert np.isnan(stats.mean_band(values[:, None]).low).all()


def test_ratios_medians_and_bands_miss_in_at_most_seven_percent():
    for arms in simulation.RATIOS.values():
        for n in (10, 30):
            missed, _ = simulation.ratio_errors(arms, n, shown=150, resamples=399)
            assert missed <= scipy.stats.binom.isf(P, 150, 0.07) / 150
    for n in (6, 10, 30):
        assert simulation.median_errors(n, draws=300) <= scipy.stats.binom.isf(P, 300, 0.06) / 300
    for name in ("normal", "exponential", "two zero-inflated"):
        for n, maps in ((8, 1), (30, 6)):
            missed = simulation.band_errors(simulation.NULLS[name], n, maps, draws=10, resamples=499)
            assert missed <= scipy.stats.binom.isf(P, 500, 0.07) / 500


def test_true_differences_are_found():
    """Two standard deviations: in 5 of 6 samples of 8 seeds, nearly always in 10; one in 30."""
    normal = simulation.NULLS["normal"]
    for n, shift, least in ((8, 2.0, 0.7), (10, 2.0, 0.85), (30, 1.0, 0.97)):
        assert simulation.errors(normal, n, draws=150, resamples=399, shift=shift)[0] >= least


def test_holm_keeps_the_error_of_many_verdicts_together():
    rng = np.random.default_rng(5)
    wrong = 0
    for _ in range(60):
        found = [stats.compare(rng.normal(size=10), resamples=399) for _ in range(8)]
        wrong += any(one.verdict != "undecided" for one in stats.after_holm(found))
    assert wrong <= scipy.stats.binom.isf(P, 60, 0.05)


def test_resampling_trials_instead_of_seeds_would_claim_far_too_much():
    """With a spread between seeds, the trial as the unit finds what is not there in most samples."""
    rng = np.random.default_rng(5)
    by_trial, by_seed = 0, 0
    for _ in range(60):
        curve = rng.normal(size=(10, 1)) + rng.normal(size=(10, 20))
        by_trial += stats.compare(curve.ravel(), resamples=199).verdict != "undecided"
        by_seed += stats.compare(curve.mean(axis=1), resamples=199).verdict != "undecided"
    assert by_trial > 25 > 9 > by_seed


# ---------------------------------------------------------------- the test itself


def signs_p(values):
    """Two-sided p of all sign flips, by enumeration."""
    sums = [abs(np.dot(signs, values)) for signs in itertools.product((1, -1), repeat=len(values))]
    return np.mean(np.array(sums) >= abs(sum(values)) * (1 - 1e-9))


def test_sign_flips_give_fishers_p_for_darwins_maize():
    """Fisher's 863 of 32,768 on either side; the bootstrap's p is smaller here, so that the larger one is his."""
    assert stats.compare(DARWIN).p == pytest.approx(max(2 * 863 / 2**15, stats.compare(DARWIN).p))
    assert signs_p(np.array(DARWIN, float)) == pytest.approx(2 * 863 / 2**15)
    theirs = scipy.stats.permutation_test(
        (np.array(DARWIN), np.zeros(15)), lambda a, b, axis: (a - b).mean(axis=axis), permutation_type="samples",
        n_resamples=10**6, vectorized=True,
    ).pvalue  # fmt: skip
    assert signs_p(np.array(DARWIN, float)) == pytest.approx(theirs)


@given(hnp.arrays(np.float64, st.integers(1, 9), elements=st.integers(-9, 9).map(float)))
@settings(deadline=None, derandomize=True, max_examples=60)
def test_p_is_never_below_that_of_the_enumerated_sign_flips(values):
    assert stats.compare(values, resamples=99).p >= signs_p(values) - 1e-12


def test_beyond_sixteen_seeds_random_signs_agree_with_scipy():
    values = np.random.default_rng(1).normal(0.6, size=40)
    theirs = scipy.stats.ttest_1samp(values, 0).pvalue
    assert stats.compare(values).p == pytest.approx(theirs, abs=0.01)


@given(samples, st.sampled_from([None, 2]), st.sampled_from(["less", "greater"]))
@settings(deadline=None, derandomize=True, max_examples=60)
def test_the_interval_is_what_the_test_does_not_reject(values, maps, better):
    """So that interval, p and verdict cannot contradict one another."""
    strata = None if maps is None else np.arange(values.size) % maps
    found = stats.compare(values, strata=strata, better=better, resamples=199)
    low, high = found.interval.low, found.interval.high
    assert low <= found.estimate <= high
    for end, beyond in ((low, -1), (high, 1)):
        if math.isfinite(end):
            step = 1e-3 * (high - low if math.isfinite(high - low) else 1)
            outside = stats.compare(values, reference=end + beyond * step, strata=strata, better=better, resamples=199)
            inside = stats.compare(values, reference=end - beyond * step, strata=strata, better=better, resamples=199)
            assert outside.p <= 0.05 < inside.p
            assert outside.verdict in ("holds", "does not hold")
            assert inside.verdict == "undecided"


@given(samples, st.floats(0.1, 10), st.integers(-10, 10))
@settings(deadline=None, derandomize=True, max_examples=40)
def test_intervals_follow_a_change_of_unit(values, scale, shift):
    one, two = (stats.compare(v, resamples=199).interval for v in (values, scale * values + shift))
    size = max(1.0, abs(values).max()) * scale + abs(shift)
    for a, b in ((one.low, two.low), (one.high, two.high)):
        assert b == pytest.approx(scale * a + shift, abs=1e-3 * size) if math.isfinite(a) else b == a


@given(samples)
@settings(deadline=None, derandomize=True, max_examples=30)
def test_either_side_gives_the_same_p_and_the_opposite_verdict(values):
    less, greater = (stats.compare(values, better=side, resamples=199) for side in ("less", "greater"))
    mirrored = stats.compare(np.zeros_like(values), values, better="less", resamples=199)
    assert less.p == greater.p == pytest.approx(mirrored.p)
    opposite = {"holds": "does not hold", "does not hold": "holds", "undecided": "undecided"}
    assert greater.verdict == opposite[less.verdict] == mirrored.verdict


def test_maps_that_differ_do_not_widen_what_is_said_of_them():
    rng = np.random.default_rng(7)
    maps = np.repeat(np.arange(6), 10)
    values = 10.0 * maps + rng.normal(size=60)
    within, across = (stats.compare(values, strata=s).interval for s in (maps, None))
    assert within.high - within.low < 0.2 * (across.high - across.low)
    few = np.arange(12) // 3  # three seeds a map show no spread
    assert stats.compare(values[:12], strata=few).interval == stats.compare(values[:12]).interval


def test_paired_seeds_are_used():
    rng = np.random.default_rng(6)
    shared = 100 * rng.normal(size=40)
    a, b = shared + rng.normal(size=40) - 2, shared + rng.normal(size=40)
    found = stats.compare(a, b)
    assert found.verdict == "holds"
    assert found.estimate == pytest.approx((a - b).mean())
    assert stats.compare(a, rng.permutation(b)).verdict == "undecided"


def test_the_seed_decides_and_matters():
    values = np.random.default_rng(0).normal(size=(30, 5))
    for function in (
        lambda seed: stats.compare(values[:, 0], seed=seed).interval.low,
        lambda seed: stats.ratio(abs(values[:, 0]), abs(values[:, 1]), seed=seed).p,
        lambda seed: stats.equivalent(values[:, 0], margin=0.3, seed=seed, resamples=99).p,
        lambda seed: stats.mean_band(values**3, seed=seed, resamples=99).low[0],
    ):
        assert function(1) == function(1)
        assert len({function(seed) for seed in range(8)}) > 1


def test_six_seeds_have_126_resamples_and_the_sample_is_one_more():
    """Four of six, drawn with replacement, in any order: C(9, 4). Their shares by enumeration."""
    values = np.array([5.0, 5.1, 5.2, 5.3, 5.4, 5.6])
    drawn = np.array(list(itertools.product(values - values.mean(), repeat=4)))
    with np.errstate(divide="ignore", invalid="ignore"):
        t = drawn.mean(axis=1) / (drawn.std(axis=1, ddof=1) / 2)
    test = stats.PairedTest(values, np.ones(6), None, 0, 200_000)
    for theta in (4.8, 5.0, 5.2):
        share = (t >= (values.mean() - theta) / scipy.stats.sem(values)).mean()
        expected = max(signs_p(values - theta) / 2, (1 + 126 * share) / 127)
        assert test.sides(theta)[1] == pytest.approx(expected, rel=0.05)


def test_seeds_that_all_agree_have_no_interval_and_need_to_be_many():
    """Without a spread nothing says how rare exceptions are."""
    for n, verdict in ((6, "undecided"), (12, "undecided"), (18, "holds"), (50, "holds")):
        found = stats.compare(np.full(n, -2.0))
        assert (found.estimate, found.verdict) == (-2, verdict)
        assert not math.isfinite(found.interval.low)
    nothing = stats.compare(np.zeros(50))
    assert (nothing.p, nothing.verdict) == (1, "undecided")


# ---------------------------------------------------------------- ratios, shares, equivalence


def test_a_ratio_has_the_verdict_of_the_difference_and_the_interval_of_its_reciprocal():
    rng = np.random.default_rng(3)
    a, b = rng.gamma(9, size=20), 3 * rng.gamma(9, size=20)
    found, turned = stats.ratio(a, b), stats.ratio(b, a, better="greater")
    assert found.p == stats.compare(a, b).p
    assert found.verdict == turned.verdict == "holds"
    assert found.estimate == pytest.approx(a.mean() / b.mean())
    ends = 1 / turned.interval.high, 1 / turned.interval.low
    assert (found.interval.low, found.interval.high) == pytest.approx(ends, rel=1e-3)


def test_a_ratio_with_fiellers_theorem():
    """Fieller (1954), by his formula with Student's quantile; resampling adds a little."""
    rng = np.random.default_rng(8)
    a, b = rng.normal(10, 2, size=(2, 200))
    t = scipy.stats.t.ppf(0.975, 199)
    (va, cov), (_, vb) = np.cov(a, b) / 200
    f = a.mean() * b.mean() - t**2 * cov, a.mean() ** 2 - t**2 * va, b.mean() ** 2 - t**2 * vb
    root = math.sqrt(f[0] ** 2 - f[1] * f[2])
    found = stats.ratio(a, b).interval
    assert (found.low, found.high) == pytest.approx(((f[0] - root) / f[2], (f[0] + root) / f[2]), abs=0.01)


def test_a_ratio_of_nine_seeds_has_a_verdict_but_no_interval():
    direct, safe = np.array([41, 30, 35, 44, 37, 39, 32, 36, 31, 40.0]), np.arange(1.0, 11)
    for n, shown in ((9, False), (10, True)):
        found = stats.ratio(direct[:n], safe[:n], better="greater")
        assert (found.verdict, math.isfinite(found.interval.low)) == ("holds", shown)
    assert not math.isfinite(stats.ratio(direct, safe * (safe > 5), better="greater").interval.low)


def test_what_was_never_lost_gives_no_ratio_but_a_verdict():
    direct, nothing = np.arange(1.0, 13), np.zeros(12)
    found = stats.ratio(direct, nothing, better="greater")
    assert (found.verdict, str(found.interval)) == ("holds", "unbounded (no interval from 12 seeds)")
    rare = np.zeros(12)
    rare[:5] = 1
    assert not math.isfinite(stats.ratio(direct, rare).interval.high)
    assert stats.ratio(nothing, nothing).p == 1


@given(st.integers(1, 40), st.data())
@settings(deadline=None, derandomize=True, max_examples=40)
def test_a_share_is_scipys_clopper_pearson(n, data):
    k = data.draw(st.integers(0, n))
    found, theirs = stats.share(k, n), scipy.stats.binomtest(k, n, 0.5)
    limits = theirs.proportion_ci(0.95, "exact")
    assert (found.interval.low, found.interval.high) == pytest.approx((limits.low, limits.high))
    assert found.p == pytest.approx(theirs.pvalue)
    assert (found.verdict == "too few") == (n < 6)


def test_equivalence_is_two_one_sided_tests():
    values = np.random.default_rng(2).normal(0.1, 1, size=30)
    sides = ((-0.6, "greater"), (0.6, "less"))
    lower, upper = (scipy.stats.ttest_1samp(values, margin, alternative=side).pvalue for margin, side in sides)
    found = stats.equivalent(values, margin=0.6)
    assert found.p == pytest.approx(max(lower, upper), abs=0.02)
    assert found.verdict == "holds"
    assert (found.interval.confidence, found.interval.low > -0.6, found.interval.high < 0.6) == (0.9, True, True)
    assert stats.equivalent(values, margin=0.2).verdict == "undecided"
    assert stats.equivalent(values + 3, margin=1).verdict == "does not hold"
    assert stats.equivalent(values + 0.9, margin=1).verdict == "undecided"


# ---------------------------------------------------------------- many questions


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


def test_after_holm_verdict_and_needed_seeds_are_those_of_the_family():
    strong = [stats.compare(np.arange(1.0, 9) + i) for i in range(3)]
    assert [one.verdict for one in strong] == ["does not hold"] * 3
    together = stats.after_holm(strong)
    assert [one.p for one in together] == pytest.approx(list(stats.holm([one.p for one in strong])))
    assert all((one.p <= 0.05) == (one.verdict == "does not hold") for one in together)
    many = stats.after_holm(strong * 30)
    assert {one.says for one in many} == {"too few seeds (8 of at least 12)"}
    assert stats.after_holm([]) == []


# ---------------------------------------------------------------- curves and times


def test_the_band_is_wider_than_students_and_near_the_comparison_of_every_column():
    values = np.random.default_rng(8).gamma(2.0, size=(24, 4))
    maps = np.repeat([0, 1, 2], 8)
    band = stats.mean_band(values, strata=maps, resamples=4999)
    for t in range(4):
        one = stats.compare(values[:, t], strata=maps).interval
        width = one.high - one.low
        assert (band.low[t], band.high[t]) == pytest.approx((one.low, one.high), abs=0.15 * width)
    student = scipy.stats.t.interval(0.95, 23, values[:, 0].mean(), scipy.stats.sem(values[:, 0]))
    alone = stats.mean_band(values)
    assert alone.low[0] <= student[0] + 1e-9
    assert alone.high[0] >= student[1] - 1e-9
    assert np.isnan(stats.mean_band(np.ones((9, 2))).low).all()


def test_kaplan_meier_gives_the_published_median():
    data = np.array(REMISSION, dtype=float)
    found = stats.median_time(stats.Times(abs(data), data > 0))
    assert found.estimate == 23
    placebo = np.array([1, 1, 2, 2, 3, 4, 4, 5, 5, 8, 8, 8, 8, 11, 11, 12, 12, 15, 17, 22, 23.0])
    published = stats.median_time(stats.Times(placebo, np.full(21, True)))
    assert (published.estimate, published.low, published.high) == (8, 4, 12)  # as R's survfit


@given(st.lists(st.tuples(st.integers(1, 9), st.booleans()), min_size=1, max_size=25))
@settings(deadline=None, derandomize=True)
def test_the_median_is_scipys_and_lies_in_its_interval(seeds):
    times, reached = np.array([s[0] for s in seeds], float), np.array([s[1] for s in seeds])
    theirs = scipy.stats.ecdf(scipy.stats.CensoredData(uncensored=times[reached], right=times[~reached])).sf
    found = stats.median_time(stats.Times(times, reached))
    under = theirs.quantiles[theirs.probabilities <= 0.5 + 1e-12]
    assert found.estimate == (under.min() if under.size else np.inf)
    assert found.low <= found.estimate <= found.high
    if len(seeds) < 6:
        assert (found.low, found.high) == (-np.inf, np.inf)


def test_time_to_threshold_censors_and_includes_the_source():
    curve = np.array([[9, 9, 3, 3, 3, 3.0], [9, 9, 9, 9, 9, 9], [1, 1, 1, 1, 1, 1]])
    found = stats.time_to_threshold(curve, 3, window=2)
    assert found.time.tolist() == [4, 6, 2]
    assert found.reached.tolist() == [True, False, True]
    steps = stats.time_to_threshold(curve, 3, window=2, cost=curve, source=[10, 20, 30])
    assert steps.time.tolist() == [34, 74, 32]
    assert stats.median_time(stats.Times(found.time[1:2], found.reached[1:2])).estimate == np.inf
    up = stats.time_to_threshold(-curve, -3, window=2, better="greater")
    assert up.time.tolist() == found.time.tolist()
    lost = stats.time_to_threshold(curve, 3, window=2, cost=np.ones((3, 6)), source=5)
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


# ---------------------------------------------------------------- bad input, speed


@pytest.mark.parametrize(
    "call",
    [
        lambda: stats.compare([]),
        lambda: stats.compare([1, np.nan]),
        lambda: stats.compare([1, 2], [1, 2, 3]),
        lambda: stats.compare([[1, 2]]),
        lambda: stats.compare([1, 2], strata=[1]),
        lambda: stats.compare([1, 2], confidence=95),
        lambda: stats.compare([1, 2], better="up"),
        lambda: stats.ratio([1, -2], [1, 2]),
        lambda: stats.share(3, 2),
        lambda: stats.equivalent([1, 2], margin=0),
        lambda: stats.mean_band([1, 2, 3]),
        lambda: stats.time_to_threshold([[1, 2]], 1, window=3),
    ],
)
def test_bad_input_is_named(call):
    with pytest.raises(TaskliftError, match="stats"):
        call()


def test_the_largest_study_is_judged_in_seconds():
    """12 maps x 100 seeds: a second or so per comparison or band; the limit is for slow machines."""
    rng = np.random.default_rng(0)
    maps = np.repeat(np.arange(12), 100)
    steps = rng.integers(50, 600, size=(2, 1200, 100))
    start = time.perf_counter()
    stats.mean_band(steps[0], strata=maps)
    stats.compare(steps[0].mean(axis=1), steps[1].mean(axis=1), strata=maps)
    assert time.perf_counter() - start < 30
