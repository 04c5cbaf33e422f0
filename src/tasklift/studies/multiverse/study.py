"""The multiverse of readings: how far the paper's claims depend on what the paper leaves open.

A *reading* here is one level of every named alternative in :data:`OPTIONS`: of the world's rules, of the
learner's, and of the mission's open number of hostiles. Readings are drawn by a Latin hypercube, all options at
once, so that every level of every option is met equally often and every pair of them nearly so; on each, arms are
trained and the claims judged exactly as in the main study (:mod:`tasklift.studies.paper.claims`).
"""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from itertools import pairwise
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from tasklift import stats
from tasklift.building.graph import Building
from tasklift.building.reading import Reading
from tasklift.building.team import SCOUT, WEAPON, Kind
from tasklift.errors import TaskliftError
from tasklift.lab import Cell, CellResult, Spec, Store, grid
from tasklift.learning.reinforcement import Reinforcement
from tasklift.studies.paper.claims import INDIRECT, Finding, Sample, evaluate
from tasklift.studies.paper.survey import CA, NO_TREND
from tasklift.studies.study import GREEDY_TRIALS, Study

Floats = NDArray[np.float64]
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


#: All named alternatives. Additions of ours (drill, loss signal) are no readings of the paper and stay off.
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

#: What is trained under every reading; the main study has more controls (`prior`, `direct+budget`).
ARMS = ("direct", *INDIRECT)
#: Besides, where the rule is exploration: what C10 compares it with.
EXPLOITING = tuple(f"{arm}, exploitation" for arm in INDIRECT)
#: Per trial, the store keeps what the claims read; the rest of a cell can be computed again.
KEPT = ("steps", "success", "losses", "teams_left")


def draw(n: int, seed: int = 0) -> NDArray[np.int64]:
    """Return ``int64 (n, options)``: a level of every option for each of ``n`` readings.

    A Latin hypercube, improved by swaps to a small centred discrepancy: the levels of an option are equally
    frequent (but for a remainder of one), those of two options together nearly so. Other seeds give other
    readings; the design itself is part of the experiment's specification.
    """
    from scipy.stats import qmc

    if n < 2:
        raise TaskliftError(f"readings: expected at least 2, found {n}")
    points = qmc.LatinHypercube(len(OPTIONS), optimization="random-cd", seed=seed).random(n)
    ranks = points.argsort(axis=0).argsort(axis=0)
    return np.asarray(ranks * np.array([len(option.levels) for option in OPTIONS]) // n, dtype=np.int64)


@dataclass(frozen=True)
class Variant:
    """One reading in full: of the world, of the learner, and the number of hostiles."""

    reading: Reading
    reinforcement: Reinforcement
    hostiles: int

    @classmethod
    def of(cls, levels: Sequence[int]) -> Variant:
        """Build it from a level of every option, in the order of :data:`OPTIONS`."""
        chosen: dict[str, dict[str, Any]] = {"reading": {}, "mission": {}, "reinforcement": {}}
        for option, level in zip(OPTIONS, levels, strict=True):
            value = option.levels[level]
            chosen[option.of] |= _RULES[value] if option.name == "selection" else {option.name: value}
        return cls(Reading(**chosen["reading"]), Reinforcement(**chosen["reinforcement"]), **chosen["mission"])


@dataclass(frozen=True, eq=False)
class Multiverse:
    """The study: readings × maps × seeds × arms.

    Attributes
    ----------
    buildings
        By name.
    levels
        ``int64 (readings, options)``, as :func:`draw` gives them.
    seeds, trials, repeats, team, weapons_needed, limit
        As in :class:`tasklift.studies.study.Study`.
    """

    buildings: Mapping[str, Building]
    levels: NDArray[np.int64]
    seeds: int = 5
    trials: int = 100
    repeats: int = 5
    team: Mapping[Kind, int] = field(default_factory=lambda: {SCOUT: 10, WEAPON: 5})
    weapons_needed: int = 2
    limit: int = 600

    def __getstate__(self) -> dict[str, Any]:
        """Leave compiled missions behind when it travels to another process."""
        return {f.name: getattr(self, f.name) for f in dataclasses.fields(self)}

    @cached_property
    def names(self) -> tuple[str, ...]:
        """The readings' names, ``r0000`` on, in the order of the design."""
        return tuple(f"r{i:04d}" for i in range(len(self.levels)))

    @cached_property
    def _studies(self) -> dict[str, Study]:
        return {}

    def study(self, reading: str) -> Study:
        """Return one reading as a study of its own."""
        if reading not in self._studies:
            levels = self.levels[self.names.index(reading)]
            variant = Variant.of([int(level) for level in levels])
            exploring = OPTIONS[SELECTION].levels[levels[SELECTION]] == "exploration"
            study = Study(
                self.buildings,
                {reading: variant.reading},
                ARMS + EXPLOITING if exploring else ARMS,
                seeds=self.seeds,
                trials=self.trials,
                repeats=self.repeats,
                team=self.team,
                hostiles=variant.hostiles,
                weapons_needed=self.weapons_needed,
                limit=self.limit,
                reinforcement=variant.reinforcement,
            )
            self._studies.setdefault(reading, study)  # threads that come at once share the first one's
        return self._studies[reading]

    def cells(self) -> list[Cell]:
        """Return the units of work."""
        return [
            cell
            for name in self.names
            for cell in grid(reading=[name], map=self.buildings, seed=range(self.seeds), arm=self.study(name).arms)
        ]

    def spec(self) -> Spec:
        """Return the design, the options and all else that decides the rows, as data."""
        return Spec.of(
            "multiverse of readings",
            {
                "maps": {name: building.content_id for name, building in self.buildings.items()},
                "options": [[option.name, option.of, list(option.levels)] for option in OPTIONS],
                "design": self.levels.tolist(),
                "otherwise": {
                    "reading": dataclasses.asdict(Reading()),
                    "reinforcement": dataclasses.asdict(Reinforcement()),
                },
                "arms": [*ARMS, *EXPLOITING],
                "seeds": self.seeds,
                "trials": self.trials,
                "repeats": self.repeats,
                "team": [[kind.name, kind.speed_mm, kind.armed, n] for kind, n in self.team.items()],
                "weapons_needed": self.weapons_needed,
                "limit": self.limit,
                "greedy_trials": GREEDY_TRIALS,
            },
            {
                "reading": self.names,
                "map": list(self.buildings),
                "seed": range(self.seeds),
                "arm": [*ARMS, *EXPLOITING],
            },
            over=("map", "seed"),
        )

    def work(self, cell: Cell) -> CellResult:
        """Train one arm as the main study does, and keep of it what the claims need."""
        full = self.study(cell["reading"]).work(cell)
        summary = dict(full.summary)
        if cell["arm"] == "copy":
            summary |= _coverage(full.attachments["ca_weights"], full.stages["source"]["steps"])
        return CellResult(
            stages={"target": {name: full.stages["target"][name] for name in KEPT}},
            summary=summary,
            attachments={"move_weights": full.attachments["move_weights"].astype(np.float32)},
        )


def _coverage(weights: Floats, steps: NDArray[np.int64]) -> dict[str, float]:
    """Slope of V's weight on CA; and of the time of its moving trials, as a share of their mean."""
    centred = (CA - CA.mean()) / ((CA - CA.mean()) ** 2).sum()
    moving = steps.reshape(-1, 2, 2, len(CA))[:, 1].mean(axis=(0, 1))
    return {"ca_slope": float(weights @ centred), "ca_time": float(moving @ centred / moving.mean())}


# ---------------------------------------------------------------- judging the claims under every reading

_OF_TRANSFER = ("C3", "C4", "C5", "C6", "C7", "C8", "C9a", "C9b", "C9c", "C10", "C11", "C12")
#: What is judged: claim and arm. V's and direct learning's own, then the indirect arms, against direct.
LINES: tuple[tuple[str, str], ...] = (
    ("C1", "V"), ("C2", "V"), ("C5b", "direct"), ("C7b", "direct"),
    *((claim, arm) for arm in INDIRECT for claim in _OF_TRANSFER),
)  # fmt: skip
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


def judge(store: Store, *, resamples: int = 1000, progress: Any = None) -> Judged:
    """Judge all claims under all readings, from the store alone.

    Parameters
    ----------
    resamples
        Bootstrap resamples per interval.
    progress
        ``progress(done, total, note)``.
    """
    settings = store.spec.settings
    levels = np.array(settings["design"], np.int64)
    verdict = np.full((len(levels), len(LINES)), np.nan)
    effect = np.full_like(verdict, np.nan)
    kept, arms = [], []
    for i in range(len(levels)):
        name = f"r{i:04d}"
        samples, coverage = _samples(store, name, settings)
        for finding in [*_coverage_findings(*coverage, name), *evaluate(samples, name, resamples=resamples)]:
            line = (finding.claim, finding.contrast.split(" − ")[0])
            if line in LINES:
                verdict[i, LINES.index(line)] = _CODES[finding.verdict]
                effect[i, LINES.index(line)] = _standardised(finding)
        direct = samples["direct"]
        kept.append(100 * (direct.robots_left == direct.n_robots).mean(axis=1))
        arms.append({arm: _means(samples[arm]) for arm in ARMS})
        if progress is not None:
            progress(i + 1, len(levels), "judging the claims")
    return Judged(levels, verdict, effect, np.array(kept), {arm: np.array([m[arm] for m in arms]) for arm in ARMS})


def _samples(
    store: Store, reading: str, settings: Mapping[str, Any]
) -> tuple[dict[str, Sample], tuple[Floats, Floats, NDArray[np.str_]]]:
    """Return the arms of one reading, and V's two slopes on CA with the map of each."""
    robots = sum(n for *_, n in settings["team"])
    found: dict[str, list[tuple[str, CellResult]]] = {}
    for cell, result in store.select(reading=reading, attachments=True):
        found.setdefault(cell["arm"], []).append((cell["map"], result))
    samples = {}
    for arm, rows in found.items():
        column = {name: np.array([r.stages["target"][name] for _, r in rows], np.float64) for name in KEPT}
        samples[arm] = Sample(
            maps=np.array([name for name, _ in rows]),
            robots_left=robots - column["losses"],
            limit=settings["limit"],
            n_robots=robots,
            greedy_steps=np.array([r.summary["greedy_steps"] for _, r in rows]),
            greedy_losses=np.array([r.summary["greedy_losses"] for _, r in rows]),
            move_weights=np.stack([r.attachments["move_weights"] for _, r in rows]),
            **column,
        )
    slopes, times = (np.array([r.summary[key] for _, r in found["copy"]]) for key in ("ca_slope", "ca_time"))
    return samples, (slopes, times, samples["copy"].maps)


def _coverage_findings(slopes: Floats, times: Floats, maps: NDArray[np.str_], reading: str) -> list[Finding]:
    """Judge C1 and C2: is there a map of which it is true?

    Each map's mean gets a t interval with the variance pooled over maps, at 5 % over all maps together. C1: the
    slope of V's weight lies below 0 on some map. C2: on some map the trial time changes from CA = 0 to CA = 1 by
    less than 5 % of itself. They do not hold where the opposite is shown for every map.
    """
    findings = []
    for claim, values, bounds in (("C1", slopes, (-np.inf, 0.0)), ("C2", times, (-NO_TREND, NO_TREND))):
        intervals = _map_intervals(values, maps, 0.95 if claim == "C1" else 0.90)
        inside = [bounds[0] < interval.low and interval.high < bounds[1] for interval in intervals]
        outside = [interval.high <= bounds[0] or interval.low >= bounds[1] for interval in intervals]
        verdict = "holds" if any(inside) else "does not hold" if all(outside) else "undecided"
        best = min(intervals, key=lambda interval: interval.estimate if claim == "C1" else abs(interval.estimate))
        better = "below 0" if claim == "C1" else f"within ±{NO_TREND}"
        findings.append(Finding(claim, reading, "V", best, better, verdict))
    return findings


def _map_intervals(values: Floats, maps: NDArray[np.str_], confidence: float) -> list[stats.Interval]:
    """Return a t interval of each map's mean, Bonferroni over the maps, the variance pooled within them."""
    from scipy.stats import t

    names = np.unique(maps)
    groups = [values[maps == name] for name in names]
    freedom = len(values) - len(names)
    spread = float(np.sqrt(sum(((g - g.mean()) ** 2).sum() for g in groups) / freedom)) if freedom else np.inf
    reach = float(t.ppf(1 - (1 - confidence) / (2 * len(names)), freedom)) if freedom else 1.0
    return [
        stats.Interval(
            float(g.mean()),
            float(g.mean() - reach * spread / np.sqrt(g.size)),
            float(g.mean() + reach * spread / np.sqrt(g.size)),
            confidence, "t", g.size, 0,
        )
        for g in groups
    ]  # fmt: skip


def _standardised(finding: Finding) -> float:
    """Return the effect in standard errors, positive on the claim's side; nan where that has no meaning."""
    interval = finding.interval
    word, _, bound = finding.better.partition(" ")
    if word not in ("above", "below") or finding.claim in ("C1", "C11"):  # C1 asks for some map; C11 has two bounds
        return float("nan")
    error = (interval.high - interval.low) / 3.92
    gain = (interval.estimate - float(bound)) * (1 if word == "above" else -1)
    return float(np.clip(gain / error, -20, 20)) if 0 < error < np.inf else 20 * float(np.sign(gain))


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
