"""Did it pay: a curriculum against learning its last task from scratch, over many seeds, with intervals.

The unit of replication is the seed; arms are compared by paired differences. What the earlier stages cost is
reported both ways: left out (*target only*), and included, against a direct learner that spends the same on
the last task itself.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass, replace
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from tasklift import stats
from tasklift.checks import whole_number
from tasklift.errors import TaskliftError, missing
from tasklift.learning.curriculum import Curriculum, CurriculumRun, Records
from tasklift.learning.ledger import Ledger
from tasklift.learning.stage import Stage
from tasklift.learning.worlds import Outcomes
from tasklift.processes import cores, in_processes
from tasklift.tasks.policy import Policy
from tasklift.text import one_line, shown

Performance = Literal["return", "steps", "success"]
_WORDS = {"holds": "helps", "does not hold": "hurts", "undecided": "can't tell"}


@dataclass(frozen=True)
class Finding:
    """One comparison: means over seeds, and the test of their paired difference (curriculum − direct).

    The p-value is for all findings of a :class:`Comparison` asked together (Holm).
    """

    name: str
    curriculum: float
    direct: float
    difference: stats.Comparison

    @property
    def verdict(self) -> str:
        """Whether transfer ``helps`` or ``hurts``; or ``can't tell``, or ``too few seeds (3 of at least 8)``."""
        return _WORDS.get(self.difference.verdict, self.difference.says)

    def to_json(self) -> dict[str, Any]:
        """Return the finding as JSON data; what is not bounded is null."""
        interval = self.difference.interval
        return {
            "name": self.name,
            "curriculum": self.curriculum,
            "direct": self.direct,
            "difference": float(interval.estimate),
            "low": _finite(interval.low),
            "high": _finite(interval.high),
            "confidence": interval.confidence,
            "p": self.difference.p,
            "verdict": self.verdict,
        }


@dataclass(frozen=True)
class Until:
    """What was lost until a threshold of performance was reached: medians over seeds, earlier stages included.

    A seed that never gets there counts as having lost more than it did (Kaplan-Meier); a median is infinite if half
    of the seeds do not.
    """

    threshold: float
    curriculum: stats.Interval
    direct: stats.Interval
    curriculum_reached: float  # share of seeds
    direct_reached: float

    def to_json(self) -> dict[str, Any]:
        """Return it as JSON data; a median that is not reached is null."""
        found = asdict(self)
        return found | {arm: _finite(found[arm]["estimate"]) for arm in ("curriculum", "direct")}

    def __str__(self) -> str:
        arms = ((self.curriculum, self.curriculum_reached), (self.direct, self.direct_reached))
        found = [f"{median} (reached by {100 * share:.0f} %)" for median, share in arms]
        return f"median losses until {self.threshold:g} is reached: {found[0]} against {found[1]}"


@dataclass(frozen=True)
class Comparison:
    """What a comparison came to.

    ``findings`` in the order of reports; ``ledger`` has the mean losses by stage; ``policy`` is the one that
    the first seed learned through the curriculum; ``guards`` counts the guard's verdicts by stage;
    ``until`` is what was lost until a threshold, if one was asked for.
    """

    seeds: int
    findings: tuple[Finding, ...]
    ledger: dict[str, float]
    guards: dict[str, dict[str, int]]
    policy: Policy
    until: Until | None = None

    def finding(self, name: str) -> Finding:
        """Return the finding of that name."""
        for found in self.findings:
            if found.name == name:
                return found
        raise TaskliftError(f"comparison: no finding {name!r}; there are {', '.join(f.name for f in self.findings)}")

    def to_json(self) -> dict[str, Any]:
        """Return the comparison, without the policy, as JSON data."""
        return {
            "seeds": self.seeds,
            "findings": [f.to_json() for f in self.findings],
            "losses_by_stage": self.ledger,
            "guards": self.guards,
            "until": None if self.until is None else self.until.to_json(),
        }

    def __repr__(self) -> str:
        verdicts = ", ".join(f"{finding.name}: {finding.verdict}" for finding in self.findings)
        return one_line(f"Comparison({self.seeds} seeds; {verdicts})", 200)

    def to_pandas(self) -> Any:
        """Return the findings as a ``pandas.DataFrame``: one row each, with interval, p-value and verdict.

        Raises
        ------
        TaskliftError
            Without pandas.
        """
        try:
            import pandas
        except ImportError as error:
            raise missing("pandas", "pandas", "to_pandas") from error
        return pandas.DataFrame([finding.to_json() for finding in self.findings]).set_index("name")

    def __str__(self) -> str:
        lines = [
            f"curriculum against direct learning, {self.seeds} seeds; 95 % intervals, p for all lines together (Holm)"
        ]
        width = max(len(f.name) for f in self.findings)
        for f in self.findings:
            lines.append(
                f"  {f.name:<{width}}  {f.curriculum:>10.2f} against {f.direct:>10.2f}   "
                f"difference {f.difference.interval}, p {f.difference.p:.2g}   {_transfer(f.verdict)}"
            )
        lines.append("  losses by stage: " + ", ".join(f"{s} {n:.1f}" for s, n in self.ledger.items()))
        if self.until is not None:
            lines.append(f"  {self.until}")
        for stage, counts in self.guards.items():
            lines.append(f"  guard of {stage!r}: " + ", ".join(f"{v} in {n}" for v, n in counts.items()))
        return "\n".join(lines)


def compare(
    curriculum: Curriculum,
    *,
    seeds: int = 100,
    seed: int = 0,
    performance: Performance | None = None,
    first: int = 10,
    last: int = 20,
    threshold: float | None = None,
    workers: int | None = None,
    progress: Callable[[int, int], None] | None = None,
) -> Comparison:
    """Run a curriculum and direct learning over seeds and say, with intervals, whether transfer paid.

    Parameters
    ----------
    curriculum
        Its last stage is the target.
    seeds, seed
        Number of runs, and the first seed; runs use ``seed``, ``seed + 1``, …
    performance
        What is judged beside losses; default: returns where the world gives them, else steps.
    first, last
        Trials over which the jumpstart and the late performance are averaged.
    threshold
        Of performance: also report what is lost until the mean of ``first`` trials is that good.
    workers
        Processes that run the seeds; the result is the same. Default: one per core, on Linux. They are forked: where
        worlds or learners have threads or a GPU of their own, or write files, give 1.
    progress
        Called after each seed with the number of seeds done, and of all.

    Returns
    -------
    Comparison
        The findings, each with its verdict; ``print`` it.

    Raises
    ------
    TaskliftError
        For whatever :meth:`.Curriculum.check` finds, numbers out of range, a last stage without a budget of its own,
        or a cap that stopped the curriculum before its last stage.

    Examples
    --------
    >>> from tasklift import Curriculum, Stage, Step, Task, ValueLearning, Variable
    >>> class Walk:  # five places in a row; the last one is home
    ...     task = Task("walk", (Variable("place", range(5)),), (Variable("go", ("left", "right")),))
    ...     limit = 50
    ...     def start(self, rng):
    ...         self.place = 0
    ...         return self.place
    ...     def step(self, output):
    ...         self.place = max(0, self.place + (1 if output else -1))
    ...         return Step(self.place, -1.0, ended=self.place == 4, success=self.place == 4)
    >>> stages = [Stage(name, Walk.task, Walk(), ValueLearning(), trials=20) for name in ("before", "after")]
    >>> comparison = compare(Curriculum(stages), seeds=8)
    >>> comparison.finding("losses, target only").curriculum
    0.0

    Notes
    -----
    The direct learner has no cap and no guard. Losses on the target include the guard's control; late performance is
    that of the learner whose policy counts in the end. Rehearsals' would-be losses are left out.
    """
    if not isinstance(curriculum, Curriculum):
        raise TaskliftError(f"compare: expected a Curriculum, found {shown(curriculum)}")
    whole_number(seeds, "compare, seeds", least=2)
    whole_number(first, "compare, first", least=1)
    whole_number(last, "compare, last", least=1)
    workers = cores() if workers is None else whole_number(workers, "compare, workers", least=1)
    curriculum.check()

    def both(number: int) -> tuple[CurriculumRun, Outcomes]:
        run = curriculum.run(number)
        return run, learn_directly(curriculum, run, number)

    runs: list[CurriculumRun] = []
    direct: list[Outcomes] = []
    for run, directly in in_processes(both, range(seed, seed + seeds), workers):
        runs.append(run)
        direct.append(directly)
        if progress is not None:
            progress(len(runs), seeds)
    options: dict[str, Any] = {"performance": performance, "first": first, "last": last, "threshold": threshold}
    return judged(curriculum.stages[-1], runs, direct, runs[0].policy, **options)


def learn_directly(curriculum: Curriculum, run: Records, seed: int) -> Outcomes:
    """Learn a curriculum's last task from scratch, with what ``run`` spent on earlier stages added to the budget.

    Parameters
    ----------
    curriculum
        Its last stage is learned, without prior, trust, guard or cap.
    run
        What the curriculum came to with this seed.
    seed
        Of all random numbers.

    Raises
    ------
    TaskliftError
        If the last stage has its learner's budget.
    """
    last = curriculum.stages[-1]
    target = replace(last, prior=(), trust=None, initial=None, guard=None, max_losses=None)
    spent = [entry for entry in run.ledger.entries if entry.stage != last.name]
    longer = _with_source(target, sum(entry.trials for entry in spent), sum(entry.steps for entry in spent))
    return Curriculum([longer], block=curriculum.block).run(seed).outcomes[last.name]


def judged(
    target: Stage,
    runs: Sequence[Records],
    direct: Sequence[Outcomes],
    policy: Policy,
    *,
    performance: Performance | None = None,
    first: int = 10,
    last: int = 20,
    threshold: float | None = None,
) -> Comparison:
    """Judge runs of a curriculum against direct learning, seed by seed: what :func:`compare` does after the training.

    Parameters
    ----------
    target
        The curriculum's last stage.
    runs, direct
        Of the same seeds, in the same order; ``direct`` as :func:`learn_directly` gives it.
    policy
        What the first seed learned.
    performance, first, last, threshold
        As in :func:`compare`.

    Raises
    ------
    TaskliftError
        If a cap stopped a run before its last stage, or the world has no returns to judge by.
    """
    lifted = [run.outcomes[target.name] for run in runs if len(run.outcomes.get(target.name, ()))]
    if len(lifted) < len(runs):
        raise TaskliftError("compare: a cap stopped the curriculum before its last stage began; raise the cap")
    plain = [_head(outcomes, target.trials, target.steps) for outcomes in direct]
    kind: Performance = performance or ("return" if hasattr(lifted[0], "returns") else "steps")
    return Comparison(
        len(runs),
        tuple(_findings(runs, lifted, plain, direct, target.name, kind, first, last)),
        _mean_ledger([run.ledger for run in runs]),
        _guard_counts(runs),
        policy,
        None if threshold is None else _until(runs, lifted, plain, kind, first, threshold),
    )


def _until(
    runs: Sequence[Records],
    lifted: list[Outcomes],
    plain: list[Outcomes],
    kind: Performance,
    window: int,
    threshold: float,
) -> Until:
    better: stats.Direction = "less" if kind == "steps" else "greater"

    def times(arm: list[Outcomes], before: list[int]) -> stats.Times:
        each = [
            stats.time_to_threshold(
                _curve(o, kind)[None],
                threshold,
                window=min(window, len(o)),
                cost=o.losses[None],
                source=b,
                better=better,
            )
            for o, b in zip(arm, before, strict=True)
        ]
        return stats.Times(np.concatenate([t.time for t in each]), np.concatenate([t.reached for t in each]))

    ours = times(lifted, [run.ledger.total - int(o.losses.sum()) for run, o in zip(runs, lifted, strict=True)])
    theirs = times(plain, [0] * len(plain))
    medians = stats.median_time(ours), stats.median_time(theirs)
    return Until(threshold, *medians, float(ours.reached.mean()), float(theirs.reached.mean()))


def _finite(value: float) -> float | None:
    return value if math.isfinite(value) else None


def _transfer(verdict: str) -> str:
    return verdict if verdict.startswith("too few") else f"transfer {verdict}"


def _with_source(target: Stage, trials: int, steps: int) -> Stage:
    """Return the target stage with what the earlier stages spent added to its budget."""
    if target.own_budget:
        raise TaskliftError("compare: the last stage has its learner's budget; give it trials= or steps= to compare")
    more = target
    if target.trials is not None:
        more = replace(more, trials=target.trials + trials)
    if target.steps is not None:
        more = replace(more, steps=target.steps + steps)
    return more


def _head(outcomes: Outcomes, trials: int | None, steps: int | None) -> Outcomes:
    """Return the part of a longer run that the target's own budget would have bought."""
    n = len(outcomes) if trials is None else min(trials, len(outcomes))
    if steps is not None:
        begun = np.cumsum(outcomes.steps) - outcomes.steps < steps
        n = min(n, int(begun.sum()))
    return outcomes.first(n)


def _curve(outcomes: Outcomes, kind: Performance) -> NDArray[np.float64]:
    found: Any = getattr(outcomes, "returns" if kind == "return" else kind, None)
    if found is None:
        raise TaskliftError("compare: this world has no returns; judge by performance='steps' or 'success'")
    return np.asarray(found, dtype=np.float64)


def _findings(
    runs: Sequence[Records],
    lifted: list[Outcomes],
    plain: list[Outcomes],
    longer: Sequence[Outcomes],
    target: str,
    kind: Performance,
    first: int,
    last: int,
) -> list[Finding]:
    better: stats.Direction = "less" if kind == "steps" else "greater"

    def curves(arm: Sequence[Outcomes], part: slice) -> NDArray[np.float64]:
        return np.array([_curve(outcomes, kind)[part].mean() for outcomes in arm])

    def losses(arm: Sequence[Outcomes]) -> NDArray[np.float64]:
        return np.array([float(outcomes.losses.sum()) for outcomes in arm])

    early, late = slice(None, first), slice(-last, None)
    everything = np.array([float(run.ledger.total) for run in runs])
    on_target = np.array([float(run.ledger.by_stage()[target]) for run in runs])
    ended = [run.at_the_end(target) for run in runs]
    asked: list[tuple[str, NDArray[np.float64], NDArray[np.float64], stats.Direction]] = [
        (f"jumpstart ({kind}, first {first} trials)", curves(lifted, early), curves(plain, early), better),
        (f"late {kind} (last {last} trials)", curves(ended, late), curves(plain, late), better),
        (f"late {kind}, equal total budget", curves(ended, late), curves(longer, late), better),
        ("losses, target only", on_target, losses(plain), "less"),
        ("losses per 1,000 steps, target only", _rates(lifted), _rates(plain), "less"),
        ("losses, all stages, equal total budget", everything, losses(longer), "less"),
    ]
    found = stats.after_holm([stats.compare(ours, theirs, better=side) for _, ours, theirs, side in asked])
    return [
        Finding(name, float(ours.mean()), float(theirs.mean()), difference)
        for (name, ours, theirs, _), difference in zip(asked, found, strict=True)
    ]


def _rates(arm: list[Outcomes]) -> NDArray[np.float64]:
    return np.array([1000.0 * outcomes.losses.sum() / max(1, outcomes.steps.sum()) for outcomes in arm])


def _mean_ledger(ledgers: list[Ledger]) -> dict[str, float]:
    names = list(dict.fromkeys(name for ledger in ledgers for name in ledger.by_stage()))
    return {name: float(np.mean([ledger.by_stage().get(name, 0) for ledger in ledgers])) for name in names}


def _guard_counts(runs: Sequence[Records]) -> dict[str, dict[str, int]]:
    counts: dict[str, dict[str, int]] = {}
    for run in runs:
        for stage, report in run.guards.items():
            tally = counts.setdefault(stage, {})
            tally[report.verdict] = tally.get(report.verdict, 0) + 1
    return counts
