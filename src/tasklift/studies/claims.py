"""The paper's claims C1 to C12, each turned into a measure, an interval and a verdict.

The unit of replication is the seed: every measure is one number per (map, seed) and arm; arms that share them are
compared by paired differences, their spread measured within maps (:func:`tasklift.stats.compare`). *Holds* and *does
not hold* are said at p ≤ 5 %; with fewer seeds than the test can decide anything with, *too few seeds*.

A further claim is one entry of :data:`CLAIMS`: its words, whose it is, and the function that judges it.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any, Literal

import numpy as np

from tasklift import stats
from tasklift.studies.arms import ARMS, Arm
from tasklift.studies.samples import Coverage, Floats, Sample

LAST, WINDOW = 20, 10
#: C2: a change of the trial time by less than this share of it, from CA = 0 to CA = 1, is no trend.
NO_TREND = 0.05

Side = Literal["below", "above", "within", "about", "most"]
#: Whose a claim is: V's, direct learning's, an arm's against another one, or an arm's own.
Whose = Literal["v", "direct", "contrast", "arm"]


@dataclass(frozen=True)
class Finding:
    """A claim's measure for one arm, or one contrast, under one condition.

    Attributes
    ----------
    claim, condition, arm
        Which; the arm by its slug.
    reference
        Slug of the arm that is subtracted; None: the measure is the arm's own.
    found
        The measure with its interval, p and verdict.
    side, bound
        Where the claim holds: ``below`` or ``above`` the bound, ``within`` ± the bound, ``about`` (the bound is an
        ordinary value), ``most`` (on most maps, and on none the opposite).
    use
        How the reference is used: ``greedily`` or ``as drawn`` (C11); empty: while it learns.
    note
        What else a reader should know.
    """

    claim: str
    condition: str
    arm: str
    reference: str | None
    found: stats.Comparison
    side: Side
    bound: float
    use: str = ""
    note: str = ""

    @property
    def interval(self) -> stats.Interval:
        """The measure and its interval."""
        return self.found.interval

    @property
    def verdict(self) -> stats.Verdict:
        """Whether the claim holds."""
        return self.found.verdict

    @property
    def holds_if(self) -> str:
        """Where the claim holds, in words."""
        words = {
            "below": "below {:.3g}",
            "above": "above {:.3g}",
            "within": "within ±{:.2g}",
            "about": "{:.3g} is ordinary",
            "most": "on most maps, on none the opposite",
        }
        return words[self.side].format(self.bound)

    def contrast(self, arms: Mapping[str, Arm] = ARMS) -> str:
        """Return what is compared, in words."""
        label = arms[self.arm].label
        if self.reference is None:
            return label
        return f"{label} − {arms[self.reference].label}{self.use and f', {self.use}'}"

    @property
    def standardised(self) -> float:
        """The effect in standard errors, positive on the claim's side; nan where that has no meaning."""
        # C1 asks for some map; C11 has two bounds
        if self.side not in ("above", "below") or self.claim in ("C1", "C11"):
            return float("nan")
        gain = (self.found.estimate - self.bound) * (1 if self.side == "above" else -1)
        error = self.found.error
        return float(np.clip(gain / error, -20, 20)) if error > 0 else 20 * float(np.sign(gain))


@dataclass(frozen=True, eq=False)
class Case:
    """What a claim is judged on.

    Attributes
    ----------
    claim, condition
        For the findings.
    samples
        By slug.
    arms
        The arms themselves, by slug.
    coverage
        What V taught about CA; None where that is not known.
    resamples
        Per test.
    """

    claim: str
    condition: str
    samples: Mapping[str, Sample]
    arms: Mapping[str, Arm]
    coverage: Coverage | None
    resamples: int

    def compare(self, arm: str, values: Floats, side: stats.Direction, bound: float = 0.0) -> stats.Comparison:
        """Ask whether the mean of an arm's values, one per seed, lies on one side of a bound."""
        maps = self.samples[arm].maps
        return stats.compare(values, better=side, reference=bound, strata=maps, resamples=self.resamples)

    def finding(
        self, arm: str, reference: str | None, values: Floats, side: stats.Direction, bound: float = 0.0
    ) -> Finding:
        """Return the finding that the mean of ``values`` lies on one side of a bound."""
        where: Side = "below" if side == "less" else "above"
        found = self.compare(arm, values, side, bound)
        return Finding(self.claim, self.condition, arm, reference, found, where, bound)


Judge = Callable[[Case, str, str | None], Finding | None]


@dataclass(frozen=True)
class Claim:
    """One claim of the paper: what it says, where, how it is measured here, in a few words; and its judge.

    ``judge(case, arm, reference)`` returns a finding, or None where it cannot be judged.
    """

    says: str
    where: str
    measure: str
    short: str
    of: Whose
    judge: Judge


# ---------------------------------------------------------------- V's claims


def on_maps(
    coverage: Coverage, values: Floats, side: Literal["below", "above", "within"], bound: float
) -> dict[str, stats.Comparison]:
    """Ask of every map whether a mean lies below, above or within ± a bound; t tests, the variance pooled within maps.

    p-values and intervals hold for all maps together (Bonferroni), *within* by two one-sided tests at 5 %. Without a
    spread there is neither.
    """
    from scipy.stats import t

    names, place = np.unique(coverage.maps, return_inverse=True)
    sizes = np.bincount(place)
    means = np.bincount(place, values) / sizes
    freedom = len(values) - len(names)
    spread = float(np.sqrt(((values - means[place]) ** 2).sum() / freedom)) if freedom else math.nan
    confidence, needed = (0.90 if side == "within" else 0.95), len(names) + 1
    quantile = float(t.ppf(1 - (1 - confidence) / (2 * len(names)), freedom)) if freedom else math.nan
    found = {}
    for name, mean, error, n in zip(names, means, spread / np.sqrt(sizes), sizes, strict=True):
        reach = quantile * error if error > 0 else math.inf
        interval = stats.Interval(float(mean), float(mean - reach), float(mean + reach), confidence, int(n))
        distance = bound - abs(mean) if side == "within" else bound - mean if side == "below" else mean - bound
        tails = 1 if side == "within" and distance > 0 else 2
        p = min(1.0, tails * len(names) * float(t.sf(abs(distance) / error, freedom))) if error > 0 else 1.0
        found[str(name)] = stats.Comparison(interval, p, len(values), needed, bool(distance > 0), float(error))
    return found


def _some_map(case: Case, arm: str, values: Floats, side: Literal["below", "within"], bound: float) -> Finding:
    """Judge whether there is a map on which a mean lies where the claim says; refuted where it does so on none."""
    assert case.coverage is not None
    found = on_maps(case.coverage, values, side, bound)
    # of the maps on the claim's side the surest; where there is none, the one that refutes it least
    surest = {m: (not one.favours, one.p if one.favours else -one.p, abs(one.estimate)) for m, one in found.items()}
    best = min(found, key=lambda m: surest[m])
    says = found[best]
    note = f"on {best}; {100 * says.interval.confidence:.0f} % over all {len(found)} maps together"
    return Finding(case.claim, case.condition, arm, None, says, side, bound, note=note)


def _falls(case: Case, arm: str, _: str | None) -> Finding | None:
    return None if case.coverage is None else _some_map(case, arm, case.coverage.slopes, "below", 0.0)


def _no_trend(case: Case, arm: str, _: str | None) -> Finding | None:
    return None if case.coverage is None else _some_map(case, arm, case.coverage.changes, "within", NO_TREND)


# ---------------------------------------------------------------- direct learning's claims


def _not_converged(case: Case, arm: str, _: str | None) -> Finding:
    late = 1 - case.samples[arm].success[:, -LAST:].mean(axis=1)
    return case.finding(arm, None, late, "greater", 0.05)


def _eleven(case: Case, arm: str, _: str | None) -> Finding:
    kept = case.samples[arm].kept_all
    low, high = np.quantile(kept, [0.025, 0.975])
    below = 100 * float((kept < 11).mean())
    note = f"central 95 % of runs: {low:.0f} to {high:.0f}; {below:.0f} % of runs lie below 11"
    # a description of the runs, no test of a mean; of fewer runs the central 95 % are all
    found = replace(case.compare(arm, kept, "less", 11.0), p=math.nan, needed=40, favours=bool(low <= 11 <= high))
    return Finding(case.claim, case.condition, arm, None, found, "about", 11, note=note)


# ---------------------------------------------------------------- an arm against another one


def _differs(values: Callable[[Sample, Sample], tuple[Floats, Floats]], side: stats.Direction) -> Judge:
    """Return the judge of a paired difference of one value per row."""

    def judge(case: Case, arm: str, reference: str | None) -> Finding:
        a, b = values(case.samples[arm], case.samples[reference or arm])
        return case.finding(arm, reference, a - b, side)

    return judge


def _each(value: Callable[[Sample], Any]) -> Callable[[Sample, Sample], tuple[Floats, Floats]]:
    return lambda a, b: (value(a), value(b))


def trials_to_level(sample: Sample, reference: Sample) -> Floats:
    """Return ``(n,)``: trials until the mean of 10 is as low as the reference's last 20 on the same map (C3)."""
    times = np.empty(len(sample.steps))
    window = min(WINDOW, sample.steps.shape[1])
    for name in np.unique(sample.maps):
        here = sample.maps == name
        level = float(reference.steps[here][:, -LAST:].mean())
        times[here] = stats.time_to_threshold(sample.steps[here], level, window=window).time
    return times


def excess_teams(first: Sample, second: Sample) -> tuple[Floats, Floats]:
    """Return ``(n,)`` each: mean teams left beyond what both arms show for as many robots left (C8)."""
    assert first.teams_left is not None
    assert second.teams_left is not None
    robots = np.concatenate([first.robots_left, second.robots_left]).astype(int)
    teams = np.concatenate([first.teams_left, second.teams_left])
    total = np.bincount(robots.ravel(), teams.ravel(), minlength=first.n_robots + 1)
    count = np.bincount(robots.ravel(), minlength=first.n_robots + 1)
    expected = total / np.maximum(count, 1)
    excess = (teams - expected[robots]).mean(axis=1)
    return excess[: len(first.steps)], excess[len(first.steps) :]


def _similar_on_maps(case: Case, arm: str, reference: str | None) -> Finding:
    """C12: on most maps fewer steps and losses (sign test over maps); refuted by a map that shows the opposite."""
    a, b = case.samples[arm], case.samples[reference or arm]
    names = np.unique(a.maps)
    favours, each = 0, []
    for name in names:
        here = a.maps == name
        differences = [(x[here] - y[here]).mean(axis=1) for x, y in ((a.steps, b.steps), (a.losses, b.losses))]
        favours += all(d.mean() < 0 for d in differences)
        each += [stats.compare(d, resamples=case.resamples) for d in differences]
    against = [one for one in stats.after_holm(each) if one.verdict == "does not hold"]
    found = stats.share(favours, len(names), unit="maps")
    if against:
        found = replace(found, p=min(one.p for one in against), needed=1, favours=False)
    note = f"{favours} of {len(names)} maps in favour, {len(against)} measures against"
    return Finding(case.claim, case.condition, arm, reference, found, "most", 0.5, note=note)


# ---------------------------------------------------------------- an arm's own


def _weights(value: Callable[[Floats], Any]) -> Judge:
    """Return the judge of a value above 0, read from the mean weights by nWPN, FTR and MV (Figure 5)."""

    def judge(case: Case, arm: str, _: str | None) -> Finding | None:
        weights = case.samples[arm].move_weights
        return None if weights is None else case.finding(arm, None, value(weights), "greater")

    return judge


def _sooner(case: Case, arm: str, _: str | None) -> Finding | None:
    exploiting = case.arms[arm].exploiting
    if exploiting is None or exploiting not in case.samples:
        return None
    steps = case.samples[arm].greedy_steps - case.samples[exploiting].greedy_steps
    return case.finding(arm, exploiting, steps, "less")


def _optimal(case: Case, arm: str, _: str | None) -> Finding:
    """C11: not slower by more than 5 % than the fastest way of acting known, also by search, and as safe."""
    sample = case.samples[arm]
    pure = {name: s for name, s in case.samples.items() if name != arm and not case.arms[name].mixed}
    seen = {(name, "greedily"): s.greedy_steps for name, s in pure.items()}
    seen |= {(name, "as drawn"): s.steps[:, -LAST:].mean(axis=1) for name, s in case.samples.items()}
    fastest = min(seen, key=lambda name: float(seen[name].mean()))
    margin = 0.05 * float(seen[fastest].mean())
    found = case.compare(arm, sample.greedy_steps - seen[fastest], "less", margin)
    lost = float(sample.greedy_losses.mean())
    least = min(float(s.greedy_losses.mean()) for s in case.samples.values())
    if lost > least + 0.05 * sample.n_robots:
        found = replace(found, favours=False)
    note = f"greedily {sample.greedy_steps.mean():.0f} steps and {lost:.1f} robots lost a trial"
    reference, use = fastest
    return Finding(case.claim, case.condition, arm, reference, found, "below", margin, use=use, note=note)


# ---------------------------------------------------------------- all of them


CLAIMS: dict[str, Claim] = {
    "C1": Claim("on map (a), weights fall as CA rises", "Fig. 3(c)",
                "on some map, the slope of V's weight on CA lies below 0 (simultaneous intervals over all maps)",
                "on some map, weights fall with CA", "v", _falls),
    "C2": Claim("on map (b), CA shows no trend", "Fig. 3(d)",
                "on some map, the trial time changes with CA by less than 5 % (simultaneous 90 % intervals)",
                "on some map, CA does not matter", "v", _no_trend),
    "C3": Claim("indirect learning converges faster", "Fig. 4(a)",
                "trials until the mean of 10 reaches direct's level of the last 20 trials on that map; never: 100",
                "converges faster", "contrast",
                _differs(lambda a, b: (trials_to_level(a, b), trials_to_level(b, b)), "less")),
    "C4": Claim("indirect learning ends at a lower time", "Fig. 4(a)", "mean steps of the last 20 trials",
                "ends at a lower time", "contrast",
                _differs(_each(lambda s: s.steps[:, -LAST:].mean(axis=1)), "less")),
    "C5": Claim("direct learning has many more spikes", "Fig. 4(a)", "share of trials out of time",
                "fewer trials out of time", "contrast",
                _differs(_each(lambda s: 1 - s.success.mean(axis=1)), "less")),
    "C5b": Claim("direct learning has not converged after 100 trials", "Fig. 4(a)",
                 "share of the last 20 trials out of time is above 5 %",
                 "has not converged after 100 trials", "direct", _not_converged),
    "C6": Claim("indirect learning loses far fewer robots", "Fig. 4(b)", "robots lost per trial",
                "loses fewer robots", "contrast", _differs(_each(lambda s: s.losses.mean(axis=1)), "less")),
    "C7": Claim("indirect learning keeps all robots in more trials", "Fig. 4(b)",
                "trials of 100 in which every robot survives", "keeps all robots more often", "contrast",
                _differs(_each(lambda s: s.kept_all), "greater")),
    "C7b": Claim("direct learning keeps all 15 robots in only 11 of 100 trials", "VI",
                 "11 lies within the central 95 % of the direct runs",
                 "keeps all robots in 11 of 100 trials", "direct", _eleven),
    "C8": Claim("for the same number of robots left, fewer teams are left", "Fig. 4(c)",
                "teams left, less the mean of all trials with as many robots left",
                "fewer teams for as many robots", "contrast", _differs(excess_teams, "less")),
    "C9a": Claim("facing no feature, move", "Fig. 5", "mean weight of moving less that of stopping, at FTR = 1",
                 "at no feature: move", "arm",
                 _weights(lambda w: w[:, :, 0, 1].mean(axis=1) - w[:, :, 0, 0].mean(axis=1))),
    "C9b": Claim("facing the enemy feature, stop", "Fig. 5",
                 "mean weight of stopping less that of moving, at FTR = 4",
                 "at the enemy feature: stop", "arm", _weights(lambda w: (w[:, :, 3, 0] - w[:, :, 3, 1]).mean(axis=1))),
    "C9c": Claim("at the enemy feature, moving weighs more with m weapon robots than without", "Fig. 5",
                 "mean weight of moving at FTR = 4, nWPN = 2 less nWPN < 2", "there with m weapons: move more", "arm",
                 _weights(lambda w: w[:, 2, 3, 1] - w[:, :2, 3, 1].mean(axis=1))),
    "C10": Claim("exploration finds the optimal policy sooner than exploitation", "VI",
                 "after the same trials: steps of the learned policy used greedily",
                 "exploration beats exploitation", "arm", _sooner),
    "C11": Claim("the policy that indirect learning generates is optimal", "VII",
                 "used greedily: at most 5 % slower than the fastest policy known, also by search, and as safe",
                 "the policy is optimal", "arm", _optimal),
    "C12": Claim("the results were similar on the other maps", "VI",
                 "maps on which mean steps and losses both favour indirect learning: most, and none against",
                 "similar on all maps", "contrast", _similar_on_maps),
}  # fmt: skip


def evaluate(
    samples: Mapping[str, Sample],
    condition: str,
    *,
    coverage: Coverage | None = None,
    arms: Mapping[str, Arm] = ARMS,
    resamples: int = 9999,
) -> list[Finding]:
    """Judge every claim under one condition, in the order of :data:`CLAIMS`, each on its own (:func:`after_holm`).

    Parameters
    ----------
    samples
        By slug of the arm; claims whose arms are missing are left out.
    condition
        Its name, for the findings.
    coverage
        What V taught about CA, for C1 and C2.
    arms
        The arms themselves; they say against which others they are judged.
    resamples
        Per test.
    """
    findings = []
    for name, claim in CLAIMS.items():
        case = Case(name, condition, samples, arms, coverage, resamples)
        for arm, reference in _judged(claim.of, samples, arms):
            found = claim.judge(case, arm, reference)
            if found is not None:
                findings.append(found)
    return findings


def _judged(of: Whose, samples: Mapping[str, Sample], arms: Mapping[str, Arm]) -> Iterator[tuple[str, str | None]]:
    if of == "v":
        yield "v", None
    elif of == "direct":
        if "direct" in samples:
            yield "direct", None
    else:
        for arm in indirect(samples, arms):
            if of == "arm":
                yield arm, None
            else:
                yield from ((arm, reference) for reference in arms[arm].against if reference in samples)


def indirect(slugs: Sequence[str] | Mapping[str, Any], arms: Mapping[str, Arm] = ARMS) -> list[str]:
    """Return those arms that are judged against others: the indirect ones."""
    return [slug for slug in slugs if arms[slug].against]


def after_holm(findings: Sequence[Finding]) -> list[Finding]:
    """Return the findings with p-values, and so verdicts, for all of them together (Holm 1979)."""
    found = stats.after_holm([finding.found for finding in findings])
    return [replace(finding, found=one) for finding, one in zip(findings, found, strict=True)]
