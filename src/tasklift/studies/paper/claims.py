"""The paper's claims C1 to C12, each turned into a measure, an interval and a verdict.

The unit of replication is the seed: every measure is one number per (map, seed) and arm; arms that share them are
compared by paired differences, seeds resampled within maps, 95 % intervals (BCa bootstrap). ``holds`` means that
the whole interval lies on the claim's side, ``does not hold`` that it lies on the other, ``undecided`` neither.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from tasklift import stats
from tasklift.lab import Store

Floats = NDArray[np.float64]


@dataclass(frozen=True)
class Claim:
    """One claim of the paper: what it says, where, and how it is measured here."""

    says: str
    where: str
    measure: str


CLAIMS: dict[str, Claim] = {
    "C1": Claim("on map (a), weights fall as CA rises", "Fig. 3(c)",
                "slope of V's weight on CA, on the half of the seeds that did not choose the map"),
    "C2": Claim("on map (b), CA shows no trend", "Fig. 3(d)",
                "the same slope lies within a margin worth 5 % of the trial time (two one-sided tests)"),
    "C3": Claim("indirect learning converges faster", "Fig. 4(a)",
                "trials until the mean of 10 reaches direct's level of the last 20 trials on that map; never: 100"),
    "C4": Claim("indirect learning ends at a lower time", "Fig. 4(a)", "mean steps of the last 20 trials"),
    "C5": Claim("direct learning has many more spikes", "Fig. 4(a)", "share of trials out of time"),
    "C5b": Claim("direct learning has not converged after 100 trials", "Fig. 4(a)",
                 "share of the last 20 trials out of time is above 5 %"),
    "C6": Claim("indirect learning loses far fewer robots", "Fig. 4(b)", "robots lost per trial"),
    "C7": Claim("indirect learning keeps all robots in more trials", "Fig. 4(b)",
                "trials of 100 in which every robot survives"),
    "C7b": Claim("direct learning keeps all 15 robots in only 11 of 100 trials", "VI",
                 "11 lies within the central 95 % of the direct runs"),
    "C8": Claim("for the same number of robots left, fewer teams are left", "Fig. 4(c)",
                "teams left, less the mean of all trials with as many robots left"),
    "C9a": Claim("facing no feature, move", "Fig. 5", "mean weight of moving less that of stopping, at FTR = 1"),
    "C9b": Claim("facing the enemy feature, stop", "Fig. 5",
                 "mean weight of stopping less that of moving, at FTR = 4"),
    "C9c": Claim("at the enemy feature, moving weighs more with m weapon robots than without", "Fig. 5",
                 "mean weight of moving at FTR = 4, nWPN = 2 less nWPN < 2"),
    "C10": Claim("exploration finds the optimal policy sooner than exploitation", "VI",
                 "after the same trials: steps of the learned policy used greedily"),
    "C11": Claim("the policy that indirect learning generates is optimal", "VII",
                 "used greedily: at most 5 % slower than the fastest policy seen, greedy or as drawn, and as safe"),
    "C12": Claim("the results were similar on the other maps", "VI",
                 "maps on which mean steps and losses both favour indirect learning"),
}  # fmt: skip

#: Which arm each indirect arm is held against: plain direct learning, and the control that isolates its cause.
CONTRASTS = (("copy", "direct"), ("copy", "direct+budget"), ("copy+prior", "direct"), ("copy+prior", "prior"))
INDIRECT = ("copy", "copy+prior")
LAST, WINDOW = 20, 10


_TRIED = ("greedy_steps", "greedy_losses", "unseen_steps", "unseen_losses")


@dataclass(frozen=True, eq=False)
class Sample:
    """What one arm did under one reading, a row per (map, seed), always in the same order; ``n`` rows, ``T`` trials.

    Attributes
    ----------
    maps
        ``(n,)``: the map of each row.
    steps, losses, robots_left, teams_left
        ``(n, T)``.
    limit, n_robots
        Steps at which a trial fails; robots at the start.
    success
        ``(n, T)``.
    greedy_steps, greedy_losses
        ``(n,)``: of the learned policy, always taking the heaviest output.
    move_weights
        ``(n, 3, 5, 2)``: mean weights by nWPN, FTR and MV.
    unseen_steps, unseen_losses
        ``(n,)``: of the same use on maps on which nothing was learned; empty where that was not tried.
    """

    maps: NDArray[np.str_]
    steps: Floats
    losses: Floats
    robots_left: Floats
    teams_left: Floats
    success: Floats
    limit: int
    n_robots: int
    greedy_steps: Floats
    greedy_losses: Floats
    move_weights: Floats
    unseen_steps: Floats = field(default_factory=lambda: np.empty(0))
    unseen_losses: Floats = field(default_factory=lambda: np.empty(0))

    @classmethod
    def of(cls, store: Store, reading: str, arm: str) -> Sample:
        """Read an arm's rows from a store."""
        settings = store.spec.settings
        names = ("steps", "losses", "robots_left", "teams_left", "success")
        curves = {name: store.curves("target", name, reading=reading, arm=arm) for name in names}
        results = [result for _, result in store.select(reading=reading, arm=arm, attachments=True)]
        return cls(
            maps=curves["steps"].column("map"),
            limit=settings["limit"],
            n_robots=sum(n for *_, n in settings["team"]),
            **{name: np.array([r.summary[name] for r in results]) for name in _TRIED if name in results[0].summary},
            move_weights=np.stack([r.attachments["move_weights"] for r in results]),
            **{name: curve.values for name, curve in curves.items()},
        )


@dataclass(frozen=True)
class Finding:
    """A claim's measure for one contrast under one reading.

    Attributes
    ----------
    claim, reading, contrast
        Which.
    interval
        Of the effect; its sign as in ``better``.
    better
        The side on which the claim holds, in words for the table.
    verdict
        ``holds``, ``does not hold`` or ``undecided``.
    p
        Of the sign-flip test that the paired differences are symmetric around zero; None where there is none.
    note
        What else a reader should know.
    """

    claim: str
    reading: str
    contrast: str
    interval: stats.Interval
    better: str
    verdict: str
    p: float | None = None
    note: str = ""


def evaluate(samples: Mapping[str, Sample], reading: str, *, resamples: int = 4000) -> list[Finding]:
    """Judge C3 to C12 under one reading.

    Parameters
    ----------
    samples
        By arm name; claims whose arms are missing are left out.
    reading
        Its name, for the findings.
    """
    judge = _Judge(samples, reading, resamples)
    findings: list[Finding] = []
    for indirect, control in CONTRASTS:
        if indirect in samples and control in samples:
            findings += judge.contrast(indirect, control)
    if "direct" in samples:
        findings += judge.direct_alone()
    for indirect in INDIRECT:
        if indirect in samples:
            findings += judge.learned_policy(indirect)
    return findings


def holm_adjusted(findings: list[Finding]) -> list[float | None]:
    """Return each finding's p-value adjusted for all of them together (Holm 1979), None where it has none."""
    tested = {i: finding.p for i, finding in enumerate(findings) if finding.p is not None}
    adjusted: list[float | None] = [None] * len(findings)
    if tested:
        for i, p in zip(tested, stats.holm(list(tested.values())), strict=True):
            adjusted[i] = float(p)
    return adjusted


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
    robots = np.concatenate([first.robots_left, second.robots_left]).astype(int)
    teams = np.concatenate([first.teams_left, second.teams_left])
    total = np.bincount(robots.ravel(), teams.ravel(), minlength=first.n_robots + 1)
    count = np.bincount(robots.ravel(), minlength=first.n_robots + 1)
    expected = total / np.maximum(count, 1)
    excess = (teams - expected[robots]).mean(axis=1)
    return excess[: len(first.steps)], excess[len(first.steps) :]


class _Judge:
    def __init__(self, samples: Mapping[str, Sample], reading: str, resamples: int) -> None:
        self.samples, self.reading, self.resamples = samples, reading, resamples

    def contrast(self, indirect: str, control: str) -> list[Finding]:
        a, b = self.samples[indirect], self.samples[control]
        teams_a, teams_b = excess_teams(a, b)
        kept_a, kept_b = (100 * (s.robots_left == s.n_robots).mean(axis=1) for s in (a, b))
        lines: list[tuple[str, Floats, Floats, stats.Direction]] = [
            ("C3", trials_to_level(a, b), trials_to_level(b, b), "less"),
            ("C4", a.steps[:, -LAST:].mean(axis=1), b.steps[:, -LAST:].mean(axis=1), "less"),
            ("C5", 1 - a.success.mean(axis=1), 1 - b.success.mean(axis=1), "less"),
            ("C6", a.losses.mean(axis=1), b.losses.mean(axis=1), "less"),
            ("C7", kept_a, kept_b, "greater"),
            ("C8", teams_a, teams_b, "less"),
        ]
        contrast = f"{indirect} − {control}"
        found = [self._paired(claim, contrast, x, y, side) for claim, x, y, side in lines]
        return [*found, self._similar_on_maps(contrast, a, b)]

    def direct_alone(self) -> list[Finding]:
        direct = self.samples["direct"]
        late = self._interval(1 - direct.success[:, -LAST:].mean(axis=1), direct.maps)
        kept = 100 * (direct.robots_left == direct.n_robots).mean(axis=1)
        low, high = np.quantile(kept, [0.025, 0.975])
        below = 100 * float((kept < 11).mean())
        return [
            Finding("C5b", self.reading, "direct", late, "above 0.05", stats.verdict(late, "greater", 0.05)),
            Finding(
                "C7b", self.reading, "direct", self._interval(kept, direct.maps), "11 is ordinary",
                "holds" if low <= 11 <= high else "does not hold",
                note=f"central 95 % of runs: {low:.0f} to {high:.0f}; {below:.0f} % of runs lie below 11",
            ),
        ]  # fmt: skip

    def learned_policy(self, arm: str) -> list[Finding]:
        sample = self.samples[arm]
        weights = sample.move_weights  # (n, nWPN, FTR, MV)
        enemy = weights[:, :, 3, :]
        nothing = weights[:, :, 0, :].mean(axis=1)
        lines = [
            ("C9a", nothing[:, 1] - nothing[:, 0]),
            ("C9b", (enemy[:, :, 0] - enemy[:, :, 1]).mean(axis=1)),
            ("C9c", enemy[:, 2, 1] - enemy[:, :2, 1].mean(axis=1)),
        ]
        found = []
        for claim, values in lines:
            interval = self._interval(values, sample.maps)
            found.append(
                Finding(claim, self.reading, arm, interval, "above 0", stats.verdict(interval, "greater"),
                        stats.sign_flip_test(values))
            )  # fmt: skip
        exploiting = f"{arm}, exploitation"
        if exploiting in self.samples:
            other = self.samples[exploiting]
            found.append(self._paired("C10", f"{arm} − {exploiting}", sample.greedy_steps, other.greedy_steps, "less"))
        return [*found, self._optimal(arm)]

    def _optimal(self, arm: str) -> Finding:
        """C11: not slower by more than 5 % than the fastest way of acting that any arm showed, and as safe."""
        sample = self.samples[arm]
        seen = {f"{name}, greedily": s.greedy_steps for name, s in self.samples.items() if name != arm}
        seen |= {f"{name}, as drawn": s.steps[:, -LAST:].mean(axis=1) for name, s in self.samples.items()}
        fastest = min(seen, key=lambda name: float(seen[name].mean()))
        gap = self._interval(sample.greedy_steps - seen[fastest], sample.maps)
        margin = 0.05 * float(seen[fastest].mean())
        verdict = "holds" if gap.high < margin else "does not hold" if gap.low > 0 else "undecided"
        lost = float(sample.greedy_losses.mean())
        least = min(float(s.greedy_losses.mean()) for s in self.samples.values())
        if verdict == "holds" and lost > least + 0.05 * sample.n_robots:
            verdict = "does not hold"
        note = f"greedily {sample.greedy_steps.mean():.0f} steps and {lost:.1f} robots lost a trial"
        return Finding("C11", self.reading, f"{arm} − {fastest}", gap, f"below {margin:.3g}", verdict, note=note)

    def _similar_on_maps(self, contrast: str, a: Sample, b: Sample) -> Finding:
        """C12: on every map, fewer steps and fewer losses; refuted by a map that shows the opposite."""
        names = np.unique(a.maps)
        favours, opposes = [], 0
        for name in names:
            here = a.maps == name
            differences = [
                a.steps[here].mean(axis=1) - b.steps[here].mean(axis=1),
                a.losses[here].mean(axis=1) - b.losses[here].mean(axis=1),
            ]
            favours.append(float(all(d.mean() < 0 for d in differences)))
            if here.sum() > 1:
                intervals = [stats.bootstrap(np.mean, d, resamples=self.resamples) for d in differences]
                opposes += any(interval.low > 0 for interval in intervals)
        share = stats.bootstrap(np.mean, np.array(favours), method="percentile", resamples=self.resamples)
        verdict = "holds" if min(favours) == 1 else "does not hold" if opposes else "undecided"
        note = f"{int(sum(favours))} of {len(names)} maps in favour, {opposes} against"
        return Finding("C12", self.reading, contrast, share, "1", verdict, note=note)

    def _paired(self, claim: str, contrast: str, a: Floats, b: Floats, better: stats.Direction) -> Finding:
        maps = self.samples[contrast.split(" − ")[0]].maps
        interval = self._interval(a - b, maps)
        side = "below 0" if better == "less" else "above 0"
        verdict = stats.verdict(interval, better)
        return Finding(claim, self.reading, contrast, interval, side, verdict, stats.sign_flip_test(a - b))

    def _interval(self, values: Floats, maps: NDArray[np.str_]) -> stats.Interval:
        return stats.bootstrap(np.mean, values, strata=maps, resamples=self.resamples)


def all_samples(store: Store, reading: str) -> dict[str, Sample]:
    """Read every arm of one reading from a store."""
    return {arm: Sample.of(store, reading, arm) for arm in store.spec.settings["arms"]}
