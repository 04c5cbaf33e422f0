"""A guard beside a transferred learner: does transfer help or hurt, said with stated error rates, at any
time.

A scratch control runs on a small share of the budget. Its k-th trial is compared with the transferred
learner's k-th trial (same seed, same random numbers where the world allows it), so that both are
equally experienced.

The test multiplies bets. If the transferred learner is not better (the mean of the differences d, given the
past, is at most 0), every product of (1 + λ d) with d in [−1, 1] and λ in [0, 1) is a fair or losing game,
and so is the mean over several λ. By Ville's inequality the chance that it ever reaches 1/α is at most α,
however often one looks. The same holds for "hurts", with −d. See Waudby-Smith & Ramdas, "Estimating means of
bounded random variables by betting" (JRSS B, 2024), and Ville (1939).
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from typing import Any, Literal, get_args

import numpy as np

from tasklift.checks import whole_number
from tasklift.errors import TaskliftError
from tasklift.learning.worlds import Outcomes
from tasklift.tasks.variable import plain_number

Verdict = Literal["helps", "hurts", "can't tell yet"]
Measure = Literal["losses", "return", "steps", "success"]

_STAKES = 0.98 * 2.0 ** -np.arange(8)


class SequentialTest:
    """Says whether differences in [−1, 1] lean above or below zero; may be asked after every one of them.

    Source: Waudby-Smith & Ramdas, "Estimating means of bounded random variables by betting" (JRSS B, 2024).

    Parameters
    ----------
    alpha
        The largest probability of ever saying "helps" where there is no gain; and, apart from that, of ever
        saying "hurts" where there is no harm.

    Raises
    ------
    TaskliftError
        If ``alpha`` is not between 0 and 1.

    Examples
    --------
    >>> test = SequentialTest(alpha=0.05)
    >>> [test.update(1.0) for _ in range(9)][-1], test.pairs
    ('helps', 9)
    """

    def __init__(self, alpha: float = 0.05) -> None:
        if not 0 < plain_number(alpha, "guard, alpha") < 1:
            raise TaskliftError(f"guard, alpha: an error rate lies between 0 and 1, found {alpha}")
        self.alpha = alpha
        self.pairs = 0
        self.verdict: Verdict = "can't tell yet"
        #: the most that the products for "helps" and "hurts" have come to; a verdict falls at 1 / alpha
        self.evidence = (1.0, 1.0)
        self._log_wealth = np.zeros((2, len(_STAKES)))

    def update(self, difference: float) -> Verdict:
        """Take in one difference (above 0: transfer did better); return the verdict, which stays."""
        if not -1 <= difference <= 1:
            raise TaskliftError(f"guard: expected a difference from -1 to 1, found {difference}")
        self.pairs += 1
        self._log_wealth[0] += np.log1p(_STAKES * difference)
        self._log_wealth[1] += np.log1p(-_STAKES * difference)
        now = np.exp(self._log_wealth).mean(axis=1)
        self.evidence = (max(self.evidence[0], float(now[0])), max(self.evidence[1], float(now[1])))
        if self.verdict == "can't tell yet":
            helps, hurts = self.evidence
            if helps >= 1 / self.alpha:
                self.verdict = "helps"
            elif hurts >= 1 / self.alpha:
                self.verdict = "hurts"
        return self.verdict


@dataclass(frozen=True)
class Guard:
    """How a stage is guarded.

    Parameters
    ----------
    measure
        What is compared, trial by trial: fewer losses, a higher return, fewer steps, or more successes.
    share
        Of the stage's budget, for the control that learns from scratch; above 0, at most 0.5.
    alpha
        See :class:`SequentialTest`.
    window
        Compare windows of this many steps, the k-th of one with the k-th of the other, in place of trials. This is
        fair where a trial that fails early is short, and the next one begins at once.
    bound
        The largest difference there can be: then means are compared, and differences beyond it count as it.
        None: only signs are compared ("better in more pairs than worse"), which needs no bound.
    on_hurts
        ``"fall back"``: the control takes over, with what is left of the budget. ``"decay"``: what was
        transferred gives way: the learner moves half-way to the control, and the test begins anew.
        ``"report"``: nothing.

    Raises
    ------
    TaskliftError
        If a setting is out of its range.

    Examples
    --------
    >>> from tasklift import Curriculum, Guard, Reinforcement, Stage, Sweep
    >>> from tasklift.building import Mission, generate
    >>> hunt = Mission(generate(seed=7), team="10+5")
    >>> safe = hunt.task.simplify(fix={"DL": 0, "GL": 0})
    >>> guard = Guard("losses", share=0.25)
    >>> run = Curriculum([
    ...     Stage("V", safe, hunt.without_hostiles(), Sweep(repeats=1)),
    ...     Stage("T", hunt.task, hunt, Reinforcement(), trials=40, guard=guard),
    ... ]).run(seed=0)
    >>> run.guards["T"].verdict
    "can't tell yet"
    """

    measure: Measure = "losses"
    share: float = 0.1
    alpha: float = 0.05
    window: int | None = None
    bound: float | None = None
    on_hurts: Literal["fall back", "decay", "report"] = "fall back"

    def __post_init__(self) -> None:
        for name, allowed in (("measure", get_args(Measure)), ("on_hurts", ("fall back", "decay", "report"))):
            if getattr(self, name) not in allowed:
                found = getattr(self, name)
                raise TaskliftError(f"guard, {name}: expected one of {', '.join(allowed)}, found {found!r}")
        if not 0 < plain_number(self.share, "guard, share") <= 0.5:
            raise TaskliftError(f"guard, share: expected more than 0 and at most 0.5, found {self.share}")
        if self.bound is not None and not plain_number(self.bound, "guard, bound") > 0:
            raise TaskliftError(f"guard, bound: expected a number above 0, found {self.bound}")
        if self.window is not None:
            whole_number(self.window, "guard, window", least=1)
            if self.measure == "steps":
                raise TaskliftError("guard, window: windows have equally many steps; measure something else")
        SequentialTest(self.alpha)

    def scores(self, outcomes: Outcomes) -> list[float]:
        """Return what is compared, one number per trial or full window, more being better."""
        scores = self._by_trial(outcomes)
        if self.window is None:
            return scores
        # a trial counts where it ends; the last window is left out until it is full
        ends = np.cumsum(outcomes.steps)
        full = int(ends[-1]) // self.window if len(ends) else 0
        places = np.maximum(ends - 1, 0) // self.window
        return list(np.bincount(places[places < full], np.array(scores)[places < full], minlength=full))

    def _by_trial(self, outcomes: Outcomes) -> list[float]:
        if self.measure == "return":
            returns: Any = getattr(outcomes, "returns", None)
            if returns is None:
                raise TaskliftError("guard: this world has no returns; measure losses, steps or success")
            return list(returns)
        if self.measure == "success":
            return [float(s) for s in outcomes.success]
        return [-float(v) for v in (outcomes.losses if self.measure == "losses" else outcomes.steps)]

    def difference(self, transferred: float, control: float) -> float:
        """Return the difference of two scores as the test takes it."""
        gap = transferred - control
        if self.bound is None:
            return math.copysign(1.0, gap) if gap else 0.0
        return min(1.0, max(-1.0, gap / self.bound))


@dataclass
class GuardReport:
    """What a guard found: the verdict, after how many pairs, the evidence, and what was done about it."""

    verdict: Verdict = "can't tell yet"
    pairs: int = 0
    evidence: tuple[float, float] = (1.0, 1.0)
    actions: list[str] = field(default_factory=list)
    fell_back: bool = False

    def __str__(self) -> str:
        verdict = f"transfer {self.verdict}" if self.verdict != "can't tell yet" else self.verdict
        done = f"; {', '.join(self.actions)}" if self.actions else ""
        helps, hurts = self.evidence
        return f"{verdict} ({self.pairs} pairs; evidence for helps {helps:.3g}, for hurts {hurts:.3g}{done})"


class Watch:
    """A guard for a training loop of one's own: tell it of every episode of both learners, and ask.

    Parameters
    ----------
    guard : Guard
        What is measured and with which error rate. Its ``window`` is not used: episodes are compared.

    Raises
    ------
    TaskliftError
        For another learner than ``"transferred"`` or ``"control"``.

    Examples
    --------
    >>> watch = Watch(Guard("return"))
    >>> for k in range(20):
    ...     _ = watch.episode("control", returned=1.0)
    ...     verdict = watch.episode("transferred", returned=2.0)
    >>> verdict, watch.pairs
    ('helps', 20)
    """

    def __init__(self, guard: Guard) -> None:
        if guard.window is not None:
            raise TaskliftError("guard, window: a watch compares episodes; leave the window out")
        self.guard, self.test = guard, SequentialTest(guard.alpha)
        self.scores: dict[str, list[float]] = {"transferred": [], "control": []}

    def episode(
        self, learner: str, returned: float = 0.0, steps: int = 0, losses: float = 0, success: bool = False
    ) -> Verdict:
        """Take in one episode of the ``"transferred"`` or the ``"control"`` learner; return the verdict so far."""
        if learner not in self.scores:
            raise TaskliftError(f"watch, learner: expected transferred or control, found {learner!r}")
        score = {"return": returned, "steps": -float(steps), "losses": -float(losses), "success": float(success)}
        self.scores[learner].append(plain_number(score[self.guard.measure], f"watch, {self.guard.measure}"))
        ours, control = self.scores["transferred"], self.scores["control"]
        while self.pairs < min(len(ours), len(control)):
            self.test.update(self.guard.difference(ours[self.pairs], control[self.pairs]))
        return self.verdict

    @property
    def verdict(self) -> Verdict:
        """The verdict so far, over the pairs of equally experienced episodes."""
        return self.test.verdict

    @property
    def pairs(self) -> int:
        """The number of pairs that were compared."""
        return self.test.pairs

    @property
    def report(self) -> GuardReport:
        """The verdict with its evidence."""
        return GuardReport(self.verdict, self.pairs, self.test.evidence)
