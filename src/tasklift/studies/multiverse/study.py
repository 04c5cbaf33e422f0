"""The multiverse of readings: how far the paper's claims depend on what the paper leaves open.

A *reading* here is one level of every named alternative in :data:`OPTIONS`: of the world's rules, of the
learner's, and of the mission's open number of hostiles. Readings are drawn by a Latin hypercube, all options at
once, so that every level of every option is met equally often and every pair of them nearly so; on each, arms are
trained and the claims judged exactly as in the main study (:mod:`tasklift.studies.paper.claims`).
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from itertools import pairwise
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from tasklift import stats
from tasklift.building.graph import Building
from tasklift.building.reading import Reading
from tasklift.checks import whole_number
from tasklift.lab import Progress, Store
from tasklift.learning.reinforcement import Reinforcement
from tasklift.studies.claims import CLAIMS, evaluate
from tasklift.studies.samples import Coverage, Floats, Sample
from tasklift.studies.study import Condition, Part, Record, Study, numbered

Level = bool | int | float | str


@dataclass(frozen=True)
class Option:
    """Something the paper leaves open, and what it may be read as.

    Attributes
    ----------
    name
        The field of :class:`Reading` or :class:`Reinforcement`; ``hostiles``; or ``selection``.
    of
        Whose it is.
    levels
        The alternatives; the presets' own are among them.
    """

    name: str
    of: Literal["reading", "mission", "reinforcement"]
    levels: tuple[Level, ...]

    def label(self, level: int) -> str:
        """Return a level as readers see it."""
        value = self.levels[level]
        if isinstance(value, bool):
            return "on" if value else "off"
        return value if isinstance(value, str) else f"{value:g}"


#: All named alternatives. Additions of ours (drill, loss signal) do not belong to the paper and stay off.
OPTIONS: tuple[Option, ...] = (
    Option("selection", "reinforcement", ("exploration", "q = 0.5", "q = 0.9", "exploitation")),
    Option("sweep_credit", "reinforcement", ("all", "visited")),
    Option("credit", "reinforcement", ("decision", "trial")),
    Option("time_signal", "reinforcement", ("inverted", "baseline", "none")),
    Option("initial_weight", "reinforcement", (0.5, 1.5, 5.0)),
    Option("floor", "reinforcement", (0.0, 0.1)),
    Option("hostiles", "mission", (1, 2, 3)),
    Option("decide", "reading", ("robot", "team")),
    Option("patience", "reading", (1, 5, 20, 60, 200)),
    Option("split", "reading", ("robots", "pairs", "team")),
    Option("turn_back", "reading", (False, True)),
    Option("explore", "reading", ("unvisited-first", "memoryless")),
    Option("goal_sharpness", "reading", (0.5, 1.0, 2.0)),
    Option("engage", "reading", ("team", "crossing")),
    Option("alert_range_m", "reading", (5.0, 10.0, 20.0, 40.0)),
    Option("suspicion_goal", "reading", (True, False)),
    Option("share_map", "reading", ("team", "radio", "none")),
    Option("relocate", "reading", (False, True)),
)
SELECTION = next(i for i, option in enumerate(OPTIONS) if option.name == "selection")
_RULES: dict[Level, dict[str, Any]] = {
    "exploration": {"selection": "exploration"},
    "q = 0.5": {"selection": "pseudo-random", "q": 0.5},
    "q = 0.9": {"selection": "pseudo-random", "q": 0.9},
    "exploitation": {"selection": "exploitation"},
}

#: What is trained under every reading; the main study has more controls (`prior`, `direct-budget`).
INDIRECT = ("copy", "copy-prior")
ARMS = ("direct", *INDIRECT)
#: Besides, where the rule is exploration: what C10 compares it with.
EXPLOITING = tuple(f"{arm}-exploitation" for arm in INDIRECT)
#: Per trial, the store keeps what the claims read; the rest of a cell can be computed again.
RECORD = Record(columns=("steps", "success", "losses", "teams_left"), stages=("target",))
#: Each is a condition: 500 of them take minutes.
MOST_READINGS = 10_000


def draw(n: int, seed: int = 0) -> NDArray[np.int64]:
    """Return ``int64 (n, options)``: a level of every option for each of ``n`` readings.

    A Latin hypercube, improved by swaps to a small centred discrepancy: the levels of an option are equally
    frequent (but for a remainder of one), those of two options together nearly so. Other seeds give other
    readings; the design itself is part of the experiment's specification.

    Parameters
    ----------
    n
        How many readings, at least 2.
    seed
        Of the design.

    Raises
    ------
    TaskliftError
        For fewer than two.
    """
    from scipy.stats import qmc

    whole_number(n, "readings", 2, MOST_READINGS)
    points = qmc.LatinHypercube(len(OPTIONS), optimization="random-cd", seed=seed).random(n)
    ranks = points.argsort(axis=0).argsort(axis=0)
    return np.asarray(ranks * np.array([len(option.levels) for option in OPTIONS]) // n, dtype=np.int64)


def condition(levels: Sequence[int]) -> Condition:
    """Return one reading in full: a level of every option, in the order of :data:`OPTIONS`."""
    chosen: dict[str, dict[str, Any]] = {"reading": {}, "mission": {}, "reinforcement": {}}
    for option, level in zip(OPTIONS, levels, strict=True):
        value = option.levels[level]
        chosen[option.of] |= _RULES[value] if option.name == "selection" else {option.name: value}
    return Condition(Reading(**chosen["reading"]), Reinforcement(**chosen["reinforcement"]), **chosen["mission"])


def study(buildings: Mapping[str, Building], levels: NDArray[np.int64], *, seeds: int = 5, **options: Any) -> Study:
    """Return the study: readings × maps × seeds × arms. Readings are named ``r0000`` on, in the order of the design.

    Parameters
    ----------
    buildings
        By name.
    levels
        ``int64 (readings, options)``, as :func:`draw` gives them.
    seeds
        How many.
    options
        As in :class:`tasklift.studies.study.Study`.
    """
    conditions = {f"r{i:04d}": condition([int(level) for level in row]) for i, row in enumerate(levels)}
    exploring = [of.reinforcement.selection == "exploration" for of in conditions.values()]
    parts = tuple(
        Part(
            (*ARMS, *EXPLOITING) if explores else ARMS,
            tuple(name for name, one in zip(conditions, exploring, strict=True) if one is explores),
            tuple(buildings),
            tuple(numbered(seeds, "seeds")),
        )
        for explores in (True, False)
    )
    return Study(buildings, conditions, parts, record=RECORD, **options)


# ---------------------------------------------------------------- judging the claims under every reading

#: What is judged: claim and arm. V's and direct learning's own, then the indirect arms, against direct.
LINES: tuple[tuple[str, str], ...] = (
    *((name, claim.of) for name, claim in CLAIMS.items() if claim.of in ("v", "direct")),
    *((name, arm) for arm in INDIRECT for name, claim in CLAIMS.items() if claim.of in ("contrast", "arm")),
)
#: The claims that the paper's story needs together.
STORY = ("C3", "C4", "C6", "C7", "C8")
_CODES = {"holds": 1.0, "does not hold": -1.0, "undecided": 0.0}


@dataclass(frozen=True, eq=False)
class Judged:
    """What came out, a row per reading; ``n`` readings, ``L`` lines, as in :data:`LINES`.

    Attributes
    ----------
    levels
        ``int64 (n, options)``: the design.
    verdict
        ``float64 (n, L)``: 1 holds, 0 undecided, −1 does not hold, nan where not judged.
    effect
        ``float64 (n, L)``: the effect in standard errors, positive on the claim's side; nan where the claim has
        no side.
    kept
        ``float64 (n, runs)``: of 100 trials of each direct run, those in which every robot survived.
    arms
        Per arm ``float64 (n, 4)``: mean steps and mean losses per trial, then greedily.
    """

    levels: NDArray[np.int64]
    verdict: Floats
    effect: Floats
    kept: Floats
    arms: Mapping[str, Floats]

    def column(self, claim: str, arm: str) -> Floats:
        """Return the verdicts of one line, ``(n,)``."""
        return self.verdict[:, LINES.index((claim, arm))]

    def together(self, arm: str) -> NDArray[np.bool_]:
        """Return ``bool (n,)``: whether C3, C4, C6, C7 and C8 hold at once."""
        return np.all([self.column(claim, arm) == 1 for claim in STORY], axis=0)


def judge(
    store: Store, levels: NDArray[np.int64], *, resamples: int = 1000, progress: Progress | None = None
) -> Judged:
    """Judge all claims under all readings, from their rows.

    Parameters
    ----------
    store
        Of the study.
    levels
        The design.
    resamples
        Per test.
    progress
        As in :func:`tasklift.lab.run`.
    """
    verdict = np.full((len(levels), len(LINES)), np.nan)
    effect = np.full_like(verdict, np.nan)
    kept, arms = [], []
    for i, row in enumerate(levels):
        name = f"r{i:04d}"
        explores = OPTIONS[SELECTION].levels[row[SELECTION]] == "exploration"
        samples = {slug: Sample.of(store, slug, reading=name) for slug in (*ARMS, *(EXPLOITING if explores else ()))}
        coverage = Coverage.of(store, "copy", reading=name)
        for finding in evaluate(samples, name, coverage=coverage, resamples=resamples):
            if (line := (finding.claim, finding.arm)) in LINES:
                verdict[i, LINES.index(line)] = _CODES.get(finding.verdict, 0.0)
                effect[i, LINES.index(line)] = finding.standardised
        kept.append(samples["direct"].kept_all)
        arms.append({arm: _means(samples[arm]) for arm in ARMS})
        if progress is not None:
            progress(i + 1, len(levels), "judging the claims")
    return Judged(levels, verdict, effect, np.array(kept), {arm: np.array([m[arm] for m in arms]) for arm in ARMS})


def _means(sample: Sample) -> list[float]:
    return [float(v.mean()) for v in (sample.steps, sample.losses, sample.greedy_steps, sample.greedy_losses)]


# ---------------------------------------------------------------- which options decide


@dataclass(frozen=True, eq=False)
class Effects:
    """Main effects of every level on an outcome; ``L`` lines, ``M`` levels of all options one after another.

    Attributes
    ----------
    estimate, low, high
        ``float64 (L, M)``: mean outcome of the readings with this level less that of all readings; 95 %
        percentile bootstrap over readings.
    p
        ``float64 (L, M)``: of the t test that the level's mean is that of all, the variance pooled within the
        option's levels; adjusted after Benjamini & Hochberg for all lines and levels. nan where untestable.
    """

    estimate: Floats
    low: Floats
    high: Floats
    p: Floats

    @property
    def decides(self) -> NDArray[np.bool_]:
        """``bool (L, M)``: where the adjusted p lies below 5 %."""
        return np.nan_to_num(self.p, nan=1.0) < 0.05


#: The column of each option's first level in :class:`Effects`, and the end.
OFFSETS = np.concatenate(([0], np.cumsum([len(option.levels) for option in OPTIONS])))


def main_effects(outcome: Floats, levels: NDArray[np.int64], *, resamples: int = 2000, seed: int = 0) -> Effects:
    """Return how the mean outcome, ``(n, L)`` with nan where there is none, depends on every option's level."""
    member = np.concatenate(
        [levels[:, [o]] == np.arange(len(option.levels)) for o, option in enumerate(OPTIONS)], axis=1
    ).astype(np.float64)
    n = len(outcome)
    counts = np.random.default_rng(seed).multinomial(n, np.full(n, 1 / n), size=resamples).astype(np.float64)
    lines, size = outcome.shape[1], member.shape[1]
    estimate, low, high, p = (np.full((lines, size), np.nan) for _ in range(4))
    for line in range(lines):
        there = np.isfinite(outcome[:, line])
        if there.sum() < 2:
            continue
        y, x, weights = outcome[there, line], member[there], counts[:, there]
        estimate[line] = _differences(np.ones((1, y.size)), x, y)[0]
        met = x.any(axis=0)
        low[line, met], high[line, met] = np.nanquantile(_differences(weights, x[:, met], y), [0.025, 0.975], axis=0)
        p[line] = _p_values(x, y, estimate[line])
    tested = np.isfinite(p)
    if tested.any():
        p[tested] = stats.benjamini_hochberg(p[tested])
    return Effects(estimate, low, high, p)


def _differences(weights: Floats, member: Floats, y: Floats) -> Floats:
    """Return ``(B, M)``: each level's weighted mean less that of all; nan where no reading has the level."""
    with np.errstate(invalid="ignore"):
        level = (weights @ (member * y[:, None])) / (weights @ member)
        return np.asarray(level - ((weights @ y) / weights.sum(axis=1))[:, None])


def _p_values(member: Floats, y: Floats, estimate: Floats) -> Floats:
    from scipy.stats import t

    p = np.full(len(estimate), np.nan)
    for start, end in pairwise(OFFSETS):
        x = member[:, start:end]
        size = x.sum(axis=0)
        freedom = y.size - int((size > 0).sum())
        if freedom < 1 or (size > 0).sum() < 2:
            continue
        residual = y - y.mean() - x @ np.nan_to_num(estimate[start:end])
        with np.errstate(divide="ignore", invalid="ignore"):
            error = np.sqrt((residual @ residual) / freedom * (1 / size - 1 / y.size))
            p[start:end] = np.where(error > 0, 2 * t.sf(np.abs(estimate[start:end] / error), freedom), np.nan)
    return p
