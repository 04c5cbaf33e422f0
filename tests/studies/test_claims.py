"""The judge of the claims: it must be able to say all three verdicts, and for the right reason."""

from __future__ import annotations

import numpy as np
import pytest

from tasklift import stats
from tasklift.studies.arms import ARMS, Arm, to_target
from tasklift.studies.claims import CLAIMS, after_holm, evaluate, excess_teams, on_maps, trials_to_level
from tasklift.studies.samples import CA, Coverage, Sample


def sample(rng, *, steps=300.0, losses=5.0, n=12, trials=60, spread=20.0, greedy=250.0, teams_per_robot=0.8):
    """An arm with known means: what the judge is given, without any simulator."""
    robots = 15 - rng.poisson(losses, (n, trials)).clip(0, 15)
    level = rng.normal(steps, spread, (n, trials)).clip(1, 600)
    return Sample(
        maps=np.repeat([f"map-{i}" for i in range(3)], n // 3),
        seeds=np.tile(np.arange(n // 3), 3),
        steps=level,
        losses=15.0 - robots,
        teams_left=np.rint(teams_per_robot * robots),
        success=(level < 600).astype(float),
        limit=600,
        n_robots=15,
        greedy_steps=rng.normal(greedy, 5, n),
        greedy_losses=np.zeros(n),
        move_weights=np.ones((n, 3, 5, 2)) + rng.normal(0, 0.01, (n, 3, 5, 2)),
    )


def verdicts(samples, **options):
    findings = evaluate(samples, "test", resamples=500, **options)
    return {(f.claim, f.arm, f.reference): f.verdict for f in findings}


def test_a_better_arm_is_told_from_a_worse_one_and_from_an_equal_one():
    rng = np.random.default_rng(0)
    direct = sample(rng)
    better = verdicts({"direct": direct, "copy": sample(rng, steps=200, losses=2, teams_per_robot=0.5)})
    worse = verdicts({"direct": direct, "copy": sample(rng, steps=420, losses=9, teams_per_robot=1.0)})
    for claim in ("C4", "C6", "C8"):
        assert better[claim, "copy", "direct"] == "holds"
        assert worse[claim, "copy", "direct"] == "does not hold"
    # three maps cannot show what holds on most; and four seeds on each not what holds on any
    assert better["C12", "copy", "direct"] == worse["C12", "copy", "direct"] == "too few"
    same = verdicts({"direct": direct, "copy": direct})
    assert same["C4", "copy", "direct"] == "undecided"
    alike = verdicts({"direct": direct, "copy": sample(rng)})
    assert alike["C4", "copy", "direct"] == "undecided"


def test_c9_reads_the_weights_of_the_right_feature():
    rng = np.random.default_rng(1)
    arm = sample(rng)
    weights = rng.normal(1, 0.01, (12, 3, 5, 2))
    weights[:, :, 0, 1] += 1.0  # move where there is no feature
    weights[:, :, 3, 0] += 1.0  # stop at the enemy feature
    weights[:, 2, 3, 1] += 0.5  # but with m weapon robots move there more than without
    arm = Sample(**{**arm.__dict__, "move_weights": weights})
    found = verdicts({"direct": sample(rng), "copy": arm})
    assert [found[c, "copy", None] for c in ("C9a", "C9b", "C9c")] == ["holds"] * 3
    turned = Sample(**{**arm.__dict__, "move_weights": weights[..., ::-1]})
    found = verdicts({"direct": sample(rng), "copy": turned})
    assert [found[c, "copy", None] for c in ("C9a", "C9b")] == ["does not hold"] * 2


def test_c11_is_judged_against_the_best_policy_known():
    rng = np.random.default_rng(5)
    direct, copy = sample(rng, greedy=400), sample(rng, greedy=250)
    (found,) = (f for f in evaluate({"direct": direct, "copy": copy}, "test", resamples=500) if f.claim == "C11")
    assert found.verdict == "holds"
    samples = {"direct": direct, "copy": copy, "searched": sample(rng, steps=200, greedy=200)}
    (found,) = (f for f in evaluate(samples, "test", resamples=500) if f.claim == "C11")
    assert (found.reference, found.use, found.verdict) == ("searched", "as drawn", "does not hold")


def test_c12_counts_maps():
    rng = np.random.default_rng(8)
    spread = {"maps": np.repeat([f"map-{i}" for i in range(8)], 6), "seeds": np.tile(np.arange(6), 8)}
    direct, good, bad = (
        Sample(**{**sample(rng, n=48, **options).__dict__, **spread})
        for options in ({}, {"steps": 200, "losses": 2}, {"steps": 420, "losses": 9})
    )
    assert verdicts({"direct": direct, "copy": good})["C12", "copy", "direct"] == "holds"
    assert verdicts({"direct": direct, "copy": bad})["C12", "copy", "direct"] == "does not hold"
    # on one map the opposite
    mixed = Sample(**{**good.__dict__, "losses": np.where(good.maps[:, None] == "map-0", 15.0, good.losses)})
    found = [f for f in evaluate({"direct": direct, "copy": mixed}, "test", resamples=500) if f.claim == "C12"]
    assert "7 of 8 maps in favour" in found[0].note


def test_c7b_says_where_the_papers_eleven_falls():
    rng = np.random.default_rng(2)

    def keeping(counts, times=4):
        arm = sample(rng, trials=100, n=12 * times)
        losses = np.full((12 * times, 100), 5.0)
        for row, count in zip(losses, counts * times, strict=True):
            row[:count] = 0
        return Sample(**{**arm.__dict__, "losses": losses})

    about, below = [5, 8, 9, 10, 11, 12, 13, 15, 9, 8, 20, 11], [0, 1, 2, 3, 1, 0, 2, 1, 0, 1, 2, 1]
    for counts, verdict in ((about, "holds"), (below, "does not hold")):
        assert verdicts({"direct": keeping(counts)})["C7b", "direct", None] == verdict
        assert verdicts({"direct": keeping(counts, times=1)})["C7b", "direct", None] == "too few"


def test_excess_teams_ignores_how_many_robots_are_left():
    rng = np.random.default_rng(3)
    few, many = sample(rng, losses=9), sample(rng, losses=1)
    a, b = excess_teams(few, many)  # the same number of teams per robot left, other numbers of robots
    difference = stats.compare(a, b, strata=few.maps)
    assert abs(difference.estimate) < 0.05
    assert abs(few.teams_left.mean() - many.teams_left.mean()) > 3


def test_trials_to_level_is_censored_at_the_last_trial():
    rng = np.random.default_rng(4)
    reference = sample(rng, steps=200, spread=1)
    never = sample(rng, steps=500, spread=1)
    assert (trials_to_level(never, reference) == 60).all()
    assert (trials_to_level(sample(rng, steps=150, spread=1), reference) == 10).all()


def test_every_finding_has_a_claim_and_adjusted_p_values_are_not_smaller():
    rng = np.random.default_rng(5)
    arms = {name: sample(rng) for name in ("direct", "direct-budget", "copy", "prior", "copy-prior")}
    findings = evaluate(arms, "test", resamples=200)
    assert {f.claim for f in findings} <= set(CLAIMS)
    for finding, adjusted in zip(findings, after_holm(findings), strict=True):
        assert np.isnan(finding.found.p) == np.isnan(adjusted.found.p) == (finding.claim == "C7b")
        assert not adjusted.found.p < finding.found.p
        assert (adjusted.interval, adjusted.arm) == (finding.interval, finding.arm)


def test_the_resampling_seed_is_fixed():
    rng = np.random.default_rng(6)
    arms = {"direct": sample(rng), "copy": sample(rng)}
    once, again = (evaluate(arms, "test", resamples=200) for _ in range(2))
    assert [f.interval for f in once] == [f.interval for f in again]
    assert once[0].interval.low != pytest.approx(once[0].interval.high)


def coverage(slopes, changes, maps):
    """V whose weights, and whose trial times as a share of their mean, are straight lines with these slopes."""
    return Coverage(
        maps=np.asarray(maps),
        seeds=np.arange(len(maps)),
        weights=2 + np.asarray(slopes)[:, None] * CA,
        steps=150 * (1 + np.asarray(changes)[:, None] * (CA - 0.5)),
    )


def test_the_trend_of_v_with_ca_is_judged_over_all_maps_together():
    rng = np.random.default_rng(0)
    maps = np.repeat(["a", "b"], 6)
    noise = rng.normal(0, 0.01, 12)

    def found(slopes, changes, maps=maps):
        findings = evaluate({}, "test", coverage=coverage(slopes, changes, maps))
        assert [f.claim for f in findings] == ["C1", "C2"]
        return [f.verdict for f in findings]

    falls, rises = np.repeat([-0.2, 0.2], 6), np.full(12, 0.2)
    assert found(falls + noise, np.repeat([0.3, 0.0], 6) + noise) == ["holds", "holds"]
    assert found(rises + noise, rises + noise) == ["does not hold", "does not hold"]
    assert found(noise, np.full(12, 0.05) + noise) == ["undecided", "undecided"]
    # one run a map tells nothing
    assert found([-0.2, 0.2], [0.0, 0.0], ["a", "b"]) == ["too few", "too few"]


def test_intervals_over_maps_hold_together():
    """Under chance, in 95 % of surveys no map of 20 has an interval that misses its mean (here: at least 92.4 %)."""
    rng = np.random.default_rng(1)
    maps = np.repeat([f"map-{i}" for i in range(20)], 6)
    missed = 0
    for _ in range(600):
        of = coverage(rng.normal(0, 1, 120), np.zeros(120), maps)
        each = on_maps(of, of.slopes, "below", 0.0).values()
        assert all((one.p <= 0.05) == (not one.interval.low <= 0 <= one.interval.high) for one in each)
        missed += any(one.p <= 0.05 for one in each)
    assert missed / 600 < 0.076  # 0.05 and three standard errors


def test_an_arm_of_your_own_is_judged_against_the_arms_that_it_names():
    rng = np.random.default_rng(7)
    mine = Arm("mine", "mine", "a test", to_target, against=("direct",))
    found = evaluate({"direct": sample(rng), "mine": sample(rng, losses=2)}, "test", arms=ARMS | {"mine": mine},
                     resamples=200)  # fmt: skip
    (robots,) = [f for f in found if f.claim == "C6"]
    assert (robots.arm, robots.reference, robots.verdict) == ("mine", "direct", "holds")
    assert robots.contrast(ARMS | {"mine": mine}) == "mine − direct"
