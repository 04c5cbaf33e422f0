"""One stage of a curriculum: what it begins with, and its way through its budget, block by block."""

from __future__ import annotations

from collections.abc import Hashable, Sequence
from dataclasses import dataclass, fields, replace
from typing import Any

import numpy as np

from tasklift.checks import whole_number
from tasklift.errors import TaskliftError
from tasklift.files import canonical_json
from tasklift.learning.guard import Guard, GuardReport, SequentialTest
from tasklift.learning.learner import Learner, Run, check, count_as, divisible, settings_of
from tasklift.learning.ledger import Entry
from tasklift.learning.worlds import Outcomes, Steps, Trials, joined, need_world
from tasklift.tasks.policy import Policy, Prior
from tasklift.tasks.task import Task
from tasklift.tasks.variable import plain_number
from tasklift.text import shown


@dataclass(frozen=True)
class Stage:
    """One stage of a curriculum.

    Parameters
    ----------
    name
        For the ledger.
    task
        What is learned: the world's full task or a simplification of it.
    world
        A world of whole trials, or one that is met step by step.
    learner
        :class:`.Reinforcement`, :class:`.Sweep`, :class:`.ValueLearning`, :class:`.Fixed`, several :class:`.InTurn`,
        or a class of your own (:class:`.Learner`).
    trials, steps
        The budget, one or both. With neither, the learner's own: a sweep has one.
    prior
        Prior knowledge, applied to what the stage begins with.
    trust
        How much experience the copied policy counts as. Value learners: the visit count given to copied entries (needs
        ``step_power`` > 0). Weights: each copied row is rescaled so that its mean is ``trust`` × the task's largest
        signal. None: unchanged.
    initial
        Begin with this policy, extended, in place of what the stage before learned.
    keep_exploration
        Whether the exploration rate goes on from the stage before, or starts again at the learner's.
    max_losses
        The stage stops for good before the next trial could begin once it has lost this much.
    rehearsal
        What is lost here is not lost for good (a drill against hostiles that repel, a simulated fall). The ledger
        keeps it apart, as would-be losses, and it counts for no cap.
    guard
        Watches whether what was transferred helps.
    key
        Part of the random key in place of the default, for stages that are to share their random numbers.

    Examples
    --------
    A drill of 300 episodes with harmless hostiles, before the real ones:

    >>> from tasklift import Reinforcement, Stage
    >>> from tasklift.building import Mission, generate
    >>> hunt = Mission(generate(seed=7), team="10+5")
    >>> drill = Stage("drill", hunt.task, hunt.with_reading(drill=True), Reinforcement(), trials=300, rehearsal=True)
    """

    name: str
    task: Task
    world: Trials | Steps
    learner: Learner = None  # type: ignore[assignment]  # check() says which there are
    trials: int | None = None
    steps: int | None = None
    prior: Sequence[Prior] = ()
    trust: float | None = None
    initial: Policy | None = None
    keep_exploration: bool = True
    max_losses: int | None = None
    rehearsal: bool = False
    guard: Guard | None = None
    key: int | None = None

    def __repr__(self) -> str:
        budget = " and ".join(f"{n} {unit}" for n, unit in ((self.trials, "trials"), (self.steps, "steps")) if n)
        learner = type(self.learner).__name__
        return f"Stage({shown(self.name)}: {shown(self.task.name)} by {learner}, {budget or 'its own budget'})"

    @property
    def own_budget(self) -> bool:
        """Whether the budget is left to the learner."""
        return self.trials is None and self.steps is None

    def check(self) -> None:
        """Raise :class:`TaskliftError` if the stage cannot run as declared."""
        where = f"stage {self.name!r}"
        for name, least in (("trials", 1), ("steps", 1), ("max_losses", 1), ("key", 0)):
            if getattr(self, name) is not None:
                whole_number(getattr(self, name), f"{where}, {name}", least=least)
        if self.own_budget and self.guard is not None:
            raise TaskliftError(f"{where}: a guard needs a share of a budget; give trials= or steps=")
        if self.rehearsal and self.max_losses is not None:
            raise TaskliftError(
                f"{where}: a rehearsal loses nothing for good, so a cap on losses says nothing; drop it"
            )
        try:
            need_world(self.world)
            self.task.ancestor(self.world.task)
            check(self.learner, self.world, self.task, Run(trials=self.trials, steps=self.steps))
            if self.initial is not None:
                self.initial.task.ancestor(self.task)
            for operation in self.prior:
                operation.apply(self.task, np.zeros(self.task.shape))
            if self.trust is not None:
                if plain_number(self.trust, "trust") <= 0:
                    raise TaskliftError(f"trust: expected a number above 0, found {self.trust}")
                count_as(self.learner, self.learner.start(self.task), self.trust)
        except TaskliftError as error:
            raise TaskliftError(f"{where}: {error}") from error

    def enter(self, policy: Policy | None) -> Policy:
        """Return what the stage begins with: the policy of the stage before, copied; then priors, then trust.

        Parameters
        ----------
        policy
            None: from scratch, changed by priors only.
        """
        source = policy if self.initial is None else self.initial
        if source is None:
            scratch = self.learner.start(self.task)
            return scratch.extend(self.task, self.prior) if self.prior else scratch
        extended = source.extend(self.task, self.prior)
        if not self.keep_exploration:
            carried = {name: value for name, value in extended.carried.items() if name != "epsilon"}
            extended = replace(extended, carried=carried)
        return extended if self.trust is None else count_as(self.learner, extended, self.trust)

    def identity(self) -> tuple[Hashable, ...]:
        """Return what decides the stage's results, beside seed and random key, in an order of its own."""
        others = [getattr(self, f.name) for f in fields(self) if f.name != "prior"]
        return (*others, *(canonical_json(operation.to_json()) for operation in self.prior))


class Progress:
    """One learner's progress through a stage."""

    def __init__(self, stage: Stage, key: int, seed: int, policy: Policy) -> None:
        self.stage, self.key, self.seed, self.policy = stage, key, seed, policy
        self.parts: list[Outcomes] = []
        self.trials = self.steps = self.losses = 0

    @property
    def outcomes(self) -> Outcomes:
        """All outcomes so far."""
        return joined(self.parts)

    def go_on(self, trials: int | None, steps: int | None, max_losses: int | None) -> bool:
        """Run at most this much more; returns whether any trial began."""
        before, run = self.policy, Run(self.seed, self.key, self.trials, trials, steps, max_losses)
        curve = self.stage.learner.learn(self.stage.world, before, run)
        part = curve.outcomes
        if trials is not None and len(part) > trials:
            raise TaskliftError(
                f"stage {self.stage.name!r}: {type(self.stage.learner).__name__} was asked for at most {trials} "
                f"trials and ran {len(part)}; see tasklift.testing.check_learner"
            )
        self.parts.append(part)
        # blocks are the curriculum's, not the user's: the provenance is that of the stage, not of every block
        self.policy = replace(curve.policy, provenance=before.provenance)
        self.trials += len(part)
        self.steps += int(part.steps.sum())
        self.losses += int(part.losses.sum())
        return len(part) > 0

    def entry(self, who: str, stopped: bool) -> Entry:
        """Return the learner's line of the ledger."""
        real, would_be = (0, self.losses) if self.stage.rehearsal else (self.losses, 0)
        return Entry(self.stage.name, who, self.trials, self.steps, real, would_be, stopped)

    def signed(self, policy: Policy) -> Policy:
        """Return a policy of this stage with the stage as its provenance."""
        record = {
            "stage": self.stage.name,
            "learner": type(self.stage.learner).__name__,
            "settings": settings_of(self.stage.learner),
            "seed": self.seed,
            "key": self.key,
            "trials": self.trials,
            "steps": self.steps,
            "losses": self.losses,
            "before": dict(policy.provenance),
        }
        return replace(policy, provenance=record)


class Rollback:
    """Keeps the policy with which the best full block of trials began.

    Parameters
    ----------
    rule
        What the means of blocks are compared by, most important first.
    block
        Trials per block; None: no blocks, the policy learned last is kept.
    policy
        With which the first block begins.
    """

    def __init__(self, rule: Sequence[str], block: int | None, policy: Policy) -> None:
        self.rule, self.block, self.best = rule, block, policy
        self._begin, self._parts = policy, list[Outcomes]()
        self._score: tuple[float, ...] | None = None

    def update(self, part: Outcomes, after: Policy) -> None:
        """Take in the outcomes since the last update, and the policy after them."""
        if self.block is None:
            self.best = after
            return
        self._parts.append(part)
        if sum(len(p) for p in self._parts) >= self.block:
            trials = joined(self._parts)
            score = tuple(_mean(trials, name) for name in self.rule)
            if self._score is None or score > self._score:
                self.best, self._score = self._begin, score
            self._begin, self._parts = after, []


def _mean(outcomes: Outcomes, name: str) -> float:
    """Return the mean of what a rollback rule names, more being better."""
    if name == "return":
        returns: Any = getattr(outcomes, "returns", None)
        if returns is None:
            raise TaskliftError("curriculum, best_by: this world has no returns; name losses, success or steps")
        return float(np.mean(returns))
    mean = float(np.mean(getattr(outcomes, name)))
    return mean if name == "success" else -mean


class StageRun:
    """A stage on its way: the learner, the control beside it if there is a guard, and the caps.

    Parameters
    ----------
    stage, key, seed
        The stage, and its random key.
    policy
        What the stage before learned, if there was one.
    left
        What may still be lost over all stages.
    best_by, block
        As in :class:`~tasklift.learning.curriculum.Curriculum`.
    until
        Stop when the learner (not the control) has run this many trials.
    """

    def __init__(
        self,
        stage: Stage,
        key: int,
        seed: int,
        policy: Policy | None,
        left: int | None,
        best_by: Sequence[str],
        block: int | None,
        until: int | None = None,
    ) -> None:
        self.stage, self.until = stage, until
        pieces = stage.guard is not None or (divisible(stage.learner) and not stage.own_budget)
        self.block = block if pieces else None
        start = stage.enter(policy)
        self.transferred = Progress(stage, key, seed, start)
        self.control = Progress(stage, key, seed, stage.learner.start(stage.task)) if stage.guard is not None else None
        self.rollbacks = {
            learner: Rollback(best_by, self.block, learner.policy)
            for learner in (self.transferred, self.control)
            if learner is not None
        }
        self.chosen = self.transferred  # whose policy counts; the control's after falling back
        self.report = GuardReport()
        caps = [cap for cap in (None if stage.rehearsal else left, stage.max_losses) if cap is not None]
        self.cap = min(caps) if caps else None
        self.stopped = False
        self._test = SequentialTest(stage.guard.alpha if stage.guard is not None else 0.05)
        self._compared = [0, 0]
        while self._next_block():
            pass

    @property
    def policy(self) -> Policy:
        """The policy at the end of the stage."""
        return self.chosen.signed(self.chosen.policy)

    @property
    def best(self) -> Policy:
        """The rollback policy."""
        return self.chosen.signed(self.rollbacks[self.chosen].best)

    def _done(self) -> tuple[int, int, int]:
        """Return the trials, steps and losses of learner and control together."""
        both = list(self.rollbacks)
        return sum(p.trials for p in both), sum(p.steps for p in both), sum(p.losses for p in both)

    def _next_block(self) -> bool:
        """Run the next block of the learner or of the control; returns whether there may be more."""
        stage = self.stage
        trials_done, steps_done, lost = self._done()
        if self.cap is not None and lost >= self.cap:
            self.stopped = True
            return False
        if stage.own_budget and trials_done:
            return False
        turn = self._whose_turn(trials_done, steps_done)
        limits = [self.block, None if stage.trials is None else stage.trials - trials_done]
        trials = min((limit for limit in limits if limit is not None), default=None)
        steps = None if stage.steps is None else stage.steps - steps_done
        if (trials is not None and trials <= 0) or (steps is not None and steps <= 0):
            return False
        cut = None if self.until is None or turn is self.control else self.until - self.transferred.trials
        last = cut is not None and (trials is None or cut < trials)
        if last:
            trials = cut
        if trials == 0:
            return False
        began = turn.go_on(trials, steps, None if self.cap is None else self.cap - lost)
        self.rollbacks[turn].update(turn.parts[-1], turn.policy)
        if turn is self.control and self.chosen is not self.control:
            self._compare()
        return began and not last

    def _whose_turn(self, trials_done: int, steps_done: int) -> Progress:
        """Return whether the learner goes on, or the control, so that it keeps to its share of the budget."""
        guard, control = self.stage.guard, self.control
        if guard is None or control is None or self.chosen is control or self.transferred.trials <= control.trials:
            return self.chosen
        used, done = (control.trials, trials_done) if self.stage.steps is None else (control.steps, steps_done)
        return control if used < guard.share * done else self.chosen

    def _compare(self) -> None:
        """Compare the pairs of trials that are new, and act on the verdict if it is that transfer hurts."""
        guard, control = self.stage.guard, self.control
        assert guard is not None
        assert control is not None
        ours, theirs = (guard.scores(learner.outcomes) for learner in (self.transferred, control))
        while self._compared[0] < len(ours) and self._compared[1] < len(theirs):
            gap = guard.difference(ours[self._compared[0]], theirs[self._compared[1]])
            self._compared = [k + 1 for k in self._compared]
            before = self._test.verdict
            self.report.verdict = self._test.update(gap)
            self.report.evidence = self._test.evidence
            self.report.pairs += 1
            if self.report.verdict == "hurts" and before != "hurts" and guard.on_hurts != "report":
                self._give_way(guard, control)
                return

    def _give_way(self, guard: Guard, control: Progress) -> None:
        after = f"after {self.transferred.trials} trials"
        if guard.on_hurts == "fall back":
            self.report.actions.append(f"fell back to the control {after}")
            self.chosen, self.report.fell_back = control, True
            return
        self.report.actions.append(f"moved half-way to the control {after}")
        self.transferred.policy = _half_way(self.transferred.policy, control.policy)
        # from here on both learners' next trials are compared, each from where it is
        self._test = SequentialTest(guard.alpha)
        self._compared = [self.transferred.trials, control.trials]

    def outcomes(self) -> dict[str, Outcomes]:
        """Return the outcomes by name: the stage's, and those of the control if there is one."""
        found = {self.stage.name: self.transferred.outcomes}
        if self.control is not None:
            found[f"{self.stage.name} (control)"] = self.control.outcomes
        return found

    def entries(self) -> tuple[Entry, ...]:
        """Return the stage's lines of the ledger."""
        names = ("transferred", "control")
        return tuple(
            progress.entry(who, self.stopped and progress is self.chosen)
            for who, progress in zip(names, self.rollbacks, strict=False)
        )


def _half_way(policy: Policy, other: Policy) -> Policy:
    carried: dict[str, Any] = {}
    for name, value in policy.carried.items():
        theirs = other.carried.get(name, value)
        carried[name] = (value + theirs) / 2 if isinstance(value, np.ndarray) else max(value, theirs)
    return replace(policy, weights=(policy.weights + other.weights) / 2, carried=carried)
