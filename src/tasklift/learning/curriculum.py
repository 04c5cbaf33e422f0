"""Curricula: stages in order, each with its task, world, learner and budget; the loss ledger and its caps.

Generalises the paper's V and T (section III) to any chain V1 ⊂ V2 ⊂ … ⊂ T. What a stage learned enters the
next one by copying, then by priors, then by *trust*: as how much experience a copied weight counts.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, fields, replace
from typing import Any

import numpy as np

from tasklift.errors import TaskliftError
from tasklift.learning.guard import Guard, GuardReport, SequentialTest
from tasklift.learning.reinforcement import (
    SWEEP_STAGE,
    TARGET_STAGE,
    Outcomes,
    Reinforcement,
    Trials,
    reinforce,
    sweep_curve,
)
from tasklift.learning.reinforcement import whole_number as whole
from tasklift.learning.steps import Steps, StepTrials
from tasklift.learning.values import ValueLearning, learn_values
from tasklift.tasks.policy import Policy, Prior
from tasklift.tasks.task import Task
from tasklift.tasks.variable import plain_number

EARLIER_STAGES = 100
"""Random key of a curriculum's first stage; the next ones count up, the last has :data:`TARGET_STAGE`."""


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
        :class:`~tasklift.learning.reinforcement.Reinforcement` or :class:`~tasklift.learning.values.ValueLearning`.
    trials, steps
        The budget, one or both.
    repeats
        In place of a budget: a sweep, every output held for so many trials (reinforcement only).
    prior
        Prior knowledge, applied to what comes from the stage before.
    trust
        A copied value counts as so many visits (a learner by value with ``step_power`` above 0), or: a
        copied row of weights is scaled so that its mean weight is worth so many of the task's largest
        signals. None: as it is.
    keep_exploration
        Whether the exploration rate goes on from the stage before, or starts again at the learner's.
    max_losses
        The stage stops for good before the next trial could begin once it has lost so many.
    rehearsal
        What is lost here is not lost for good (a drill against hostiles that repel, a simulated fall): it is booked
        apart, as would-be losses, and counts for no cap.
    guard
        Watches whether what was transferred helps.
    key
        Part of the random key in place of the default, for stages that are to share their chances.
    """

    name: str
    task: Task
    world: Trials | Steps
    learner: Reinforcement | ValueLearning = field(default_factory=Reinforcement)
    trials: int | None = None
    steps: int | None = None
    repeats: int | None = None
    prior: Sequence[Prior] = ()
    trust: float | None = None
    keep_exploration: bool = True
    max_losses: int | None = None
    rehearsal: bool = False
    guard: Guard | None = None
    key: int | None = None

    def check(self) -> None:
        """Raise :class:`TaskliftError` if the stage cannot run as declared."""
        where = f"stage {self.name!r}"
        budgets = {"trials": self.trials, "steps": self.steps, "repeats": self.repeats}
        if all(value is None for value in budgets.values()):
            raise TaskliftError(f"{where}: has no budget; give trials=, steps= or repeats=")
        for name, value in (budgets | {"max_losses": self.max_losses, "key": self.key}).items():
            if value is not None:
                whole(value, f"{where}, {name}", at_least=0 if name == "key" else 1)
        if self.repeats is not None and (self.trials, self.steps, self.guard) != (None, None, None):
            raise TaskliftError(f"{where}: a sweep (repeats=) has its own budget and no guard; drop the others")
        if self.rehearsal and self.max_losses is not None:
            raise TaskliftError(
                f"{where}: a rehearsal loses nothing for good, so a cap on losses says nothing; drop it"
            )
        by_value = isinstance(self.learner, ValueLearning)
        if by_value and self.repeats is not None:
            raise TaskliftError(f"{where}: a sweep reinforces weights; a learner by value needs trials= or steps=")
        if by_value and not isinstance(self.world, Steps):
            raise TaskliftError(f"{where}: the world runs whole trials only; a learner by value must meet it by steps")
        try:
            self.task.ancestor(self.world.task)
            for operation in self.prior:
                operation.apply(self.task, np.zeros(self.task.shape))
        except TaskliftError as error:
            raise TaskliftError(f"{where}: {error}") from error
        if self.trust is not None:
            _trust_unit(self)

    def scratch(self) -> Policy:
        """Return where learning without transfer starts."""
        if isinstance(self.learner, ValueLearning):
            return self.learner.start(self.task)
        return Policy.equal(self.task, self.learner.initial_weight)

    def enter(self, policy: Policy) -> Policy:
        """Return what the stage starts with, given the policy of the stage before: copy, priors, trust."""
        extended = policy.extend(self.task, self.prior)
        carried = dict(extended.carried)
        if not self.keep_exploration:
            carried.pop("epsilon", None)
        extended = replace(extended, carried=carried)
        return extended if self.trust is None else with_trust(extended, self)


def _trust_unit(stage: Stage) -> float:
    where = f"stage {stage.name!r}, trust"
    if plain_number(stage.trust, where) <= 0:
        raise TaskliftError(f"{where}: expected a number above 0, found {stage.trust}")
    if isinstance(stage.learner, ValueLearning):
        if stage.learner.step_power == 0:
            raise TaskliftError(f"{where}: needs step sizes that fall with visits; give the learner a step_power")
        return 1.0
    unit = max([abs(s.value) for s in stage.task.signals] + [abs(stage.task.time_reward)])
    if unit == 0:
        raise TaskliftError(f"{where}: the task {stage.task.name!r} has no signal to measure weights by")
    return unit


def with_trust(policy: Policy, stage: Stage) -> Policy:
    """Return the policy with its copied experience counted as ``stage.trust`` says (see :class:`Stage`)."""
    trust, unit = float(stage.trust or 0.0), _trust_unit(stage)
    if policy.kind == "value":
        visits = np.where(np.asarray(policy.carried["visits"]) > 0, trust, 0.0)
        return replace(policy, carried=dict(policy.carried) | {"visits": visits})
    means = policy.weights.mean(axis=1, keepdims=True)
    return replace(policy, weights=policy.weights * np.where(means > 0, trust * unit / np.maximum(means, 1e-300), 1.0))


# -- the ledger --------------------------------------------------------------------------------------------


@dataclass(frozen=True)
class Entry:
    """A line of the ledger: what one learner of one stage did, and what it lost."""

    stage: str
    learner: str  # "transferred" or "control"
    trials: int
    steps: int
    losses: int
    would_be: int  # what a rehearsal would have lost
    stopped: bool  # at its cap


@dataclass(frozen=True)
class Ledger:
    """Every loss, booked to its stage."""

    entries: tuple[Entry, ...]

    def by_stage(self) -> dict[str, int]:
        """Return losses by stage, the controls' included."""
        losses: dict[str, int] = {}
        for entry in self.entries:
            losses[entry.stage] = losses.get(entry.stage, 0) + entry.losses
        return losses

    @property
    def total(self) -> int:
        """All losses."""
        return sum(entry.losses for entry in self.entries)

    def per_1000_steps(self) -> dict[str, float]:
        """Return losses per 1,000 steps by stage (NaN where no step was done)."""
        steps: dict[str, int] = {}
        for entry in self.entries:
            steps[entry.stage] = steps.get(entry.stage, 0) + entry.steps
        return {s: 1000 * n / steps[s] if steps[s] else float("nan") for s, n in self.by_stage().items()}

    def __str__(self) -> str:
        lines = [f"{'stage':<16} {'learner':<12} {'trials':>8} {'steps':>10} {'losses':>8}  per 1,000 steps"]
        for e in self.entries:
            rate = f"{1000 * e.losses / e.steps:.2f}" if e.steps else "-"
            note = "  (stopped at its cap)" if e.stopped else ""
            note += f"  ({e.would_be} would-be losses)" if e.would_be else ""
            lines.append(f"{e.stage:<16} {e.learner:<12} {e.trials:>8} {e.steps:>10} {e.losses:>8}  {rate}{note}")
        return "\n".join([*lines, f"total losses {self.total}"])


@dataclass(frozen=True)
class CurriculumRun:
    """What a curriculum came to.

    ``policy`` is the last one learned; ``best`` the rollback policy of the last stage that ran; ``outcomes``
    are by stage (the transferred learner's; a control's are under ``"<stage> (control)"``); ``guards`` by
    stage; ``stopped`` names the stage whose cap, or the curriculum's, was reached last.
    """

    policy: Policy
    best: Policy
    outcomes: dict[str, Outcomes]
    ledger: Ledger
    guards: dict[str, GuardReport]
    stopped: str | None

    def at_the_end(self, stage: str) -> Outcomes:
        """Return the outcomes of the learner whose policy counts: the control's, if the guard fell back to it."""
        fell_back = stage in self.guards and self.guards[stage].fell_back
        return self.outcomes[f"{stage} (control)" if fell_back else stage]


@dataclass(frozen=True)
class Curriculum:
    """Stages in order, each task equal to the next one's or a simplification of it.

    Parameters
    ----------
    stages
        At least one.
    max_losses
        Over all stages and controls together; no trial begins once so many are lost.
    best_by
        The rule of the rollback policy. Of each full block of trials the means are compared in this order (fewer
        losses, more success, fewer steps, higher return); kept is the policy with which the best block began. A
        sweep, whose trials do not depend on what it has learned, keeps what it learned.
    block
        Trials per block.
    """

    stages: Sequence[Stage]
    max_losses: int | None = None
    best_by: Sequence[str] = ("losses", "success", "steps")
    block: int = 20

    def check(self) -> None:
        """Raise :class:`TaskliftError` for the first thing wrong; :meth:`run` asks before it trains."""
        names = [stage.name for stage in self.stages]
        if not names:
            raise TaskliftError("curriculum: has no stages")
        if len(set(names)) < len(names):
            raise TaskliftError(f"curriculum: two stages have the same name in {names}")
        whole(self.block, "curriculum, block", at_least=1)
        if self.max_losses is not None:
            whole(self.max_losses, "curriculum, max_losses", at_least=1)
        unknown = [name for name in self.best_by if name not in ("losses", "success", "steps", "return")]
        if unknown or not self.best_by:
            raise TaskliftError(f"curriculum, best_by: expected losses, success, steps or return, found {unknown}")
        for stage in self.stages:
            stage.check()
        for stage, after in zip(self.stages, self.stages[1:], strict=False):
            try:
                stage.task.ancestor(after.task)
            except TaskliftError as error:
                raise TaskliftError(f"stage {stage.name!r} cannot lead to {after.name!r}: {error}") from error
            if isinstance(stage.learner, ValueLearning) != isinstance(after.learner, ValueLearning):
                raise TaskliftError(
                    f"stage {stage.name!r} cannot lead to {after.name!r}: one learns values, one weights"
                )

    def run(self, seed: int = 0, initial: Policy | None = None) -> CurriculumRun:
        """Run all stages in order.

        Parameters
        ----------
        seed
            Of everything; curricula run with the same seed share their chances in stages with the same key.
        initial
            Enter the first stage with this policy; default: from scratch.
        """
        self.check()
        whole(seed, "curriculum, seed", at_least=0)
        policy = initial
        entries: list[Entry] = []
        outcomes: dict[str, Outcomes] = {}
        guards: dict[str, GuardReport] = {}
        stopped: str | None = None
        for number, stage in enumerate(self.stages):
            left = None if self.max_losses is None else self.max_losses - sum(e.losses for e in entries)
            if left is not None and left <= 0:
                break
            run = _StageRun(self, stage, self._key(number), seed, policy, None if stage.rehearsal else left)
            run.go()
            policy = run.chosen.best if run.stopped else run.chosen.policy
            entries += run.entries()
            outcomes[stage.name] = run.lifted.outcomes
            if stage.guard is not None:
                guards[stage.name] = run.report
                outcomes[f"{stage.name} (control)"] = run.control.outcomes
            stopped = stage.name if run.stopped else stopped
        return CurriculumRun(run.chosen.policy, run.chosen.best, outcomes, Ledger(tuple(entries)), guards, stopped)

    def _key(self, number: int) -> int:
        stage = self.stages[number]
        if stage.key is not None:
            return stage.key
        if stage.repeats is not None:
            return SWEEP_STAGE
        return TARGET_STAGE if number == len(self.stages) - 1 else EARLIER_STAGES + number


class _Course:
    """One learner on its way through a stage, block by block."""

    def __init__(self, curriculum: Curriculum, stage: Stage, key: int, seed: int, policy: Policy) -> None:
        self.stage, self.key, self.seed, self.policy = stage, key, seed, policy
        self.rule, self.block = curriculum.best_by, curriculum.block
        self.parts: list[Outcomes] = []
        self._block_start, self._block_parts = policy, list[Outcomes]()
        self.trials = self.steps = self.losses = 0
        self.best = policy
        self._best_score: tuple[float, ...] | None = None

    @property
    def outcomes(self) -> Outcomes:
        return joined(self.parts)

    def go_on(self, trials: int, steps: int | None, max_losses: int | None) -> bool:
        """Run at most so many trials more; returns whether any trial began."""
        before = self.policy
        stage = self.stage
        options: dict[str, Any] = {"seed": self.seed, "max_losses": max_losses}
        curve: Any
        if isinstance(stage.learner, ValueLearning):
            curve = learn_values(
                stage.world,  # type: ignore[arg-type]
                before,
                trials=trials,
                steps=steps,
                stage=self.key,
                first_trial=self.trials,
                learning=stage.learner,
                **options,
            )
        else:
            world: Any = StepTrials(stage.world) if isinstance(stage.world, Steps) else stage.world
            if stage.repeats is not None:
                curve = sweep_curve(
                    world,
                    stage.task,
                    repeats=stage.repeats,
                    reinforcement=stage.learner,
                    initial=before,
                    **options,
                )
            else:
                curve = reinforce(
                    world,
                    before,
                    trials=trials,
                    stage=self.key,
                    first_trial=self.trials,
                    reinforcement=stage.learner,
                    **options,
                )
        part: Outcomes = curve.outcomes
        self.parts.append(part)
        # blocks are ours, not the user's: the provenance tells of the stage as a whole, not of every block
        self.policy = replace(curve.policy, provenance=before.provenance)
        self._judge(part)
        self.trials += len(part)
        self.steps += int(part.steps.sum())
        self.losses += int(part.losses.sum())
        return len(part) > 0

    def _judge(self, part: Outcomes) -> None:
        """Keep the policy with which the best full block began."""
        if self.stage.repeats is not None:
            self.best = self.policy
            return
        self._block_parts.append(part)
        whole_block = joined(self._block_parts)
        if len(whole_block) >= self.block:
            score = tuple(_means(whole_block, name) for name in self.rule)
            if self._best_score is None or score > self._best_score:
                self.best, self._best_score = self._block_start, score
            self._block_start, self._block_parts = self.policy, []

    def told(self, policy: Policy) -> Policy:
        """Return a policy of this course with the provenance of the stage."""
        record = {
            "stage": self.stage.name,
            "learner": type(self.stage.learner).__name__,
            "settings": {f.name: getattr(self.stage.learner, f.name) for f in fields(self.stage.learner)},
            "seed": self.seed,
            "key": self.key,
            "trials": self.trials,
            "steps": self.steps,
            "losses": self.losses,
            "before": dict(policy.provenance),
        }
        return replace(policy, provenance=record)


def _means(outcomes: Outcomes, name: str) -> float:
    """Return the mean of what a rollback rule names, more being better."""
    if name == "return":
        returns: Any = getattr(outcomes, "returns", None)
        if returns is None:
            raise TaskliftError("curriculum, best_by: this world has no returns; name losses, success or steps")
        return float(np.mean(returns))
    mean = float(np.mean(getattr(outcomes, name)))
    return mean if name == "success" else -mean


class _StageRun:
    """A stage on its way: the learner, the control beside it if there is a guard, and both caps."""

    def __init__(
        self,
        curriculum: Curriculum,
        stage: Stage,
        key: int,
        seed: int,
        policy: Policy | None,
        left: int | None,
    ) -> None:
        self.stage, self.block = stage, curriculum.block
        start = stage.scratch() if policy is None else stage.enter(policy)
        self.lifted = _Course(curriculum, stage, key, seed, start)
        self.control = _Course(curriculum, stage, key, seed, stage.scratch())
        self.chosen = self.lifted  # whose policy counts; the control's after falling back
        self.report = GuardReport()
        caps = [cap for cap in (left, stage.max_losses) if cap is not None]
        self.cap = min(caps) if caps else None
        self.stopped = False
        self._test = SequentialTest(stage.guard.alpha if stage.guard is not None else 0.05)
        self._compared = [0, 0]
        if isinstance(stage.learner, Reinforcement):
            if stage.steps is not None:
                self.block = 1  # trials of weights do not count steps, so ask after each
            elif stage.learner.time_signal == "baseline" and stage.guard is None:
                self.block = stage.trials or 1  # its running mean is the world's, and begins anew with every call

    def go(self) -> None:
        """Run the stage until its budget, or a cap, is reached."""
        if self.stage.repeats is not None:
            self.lifted.go_on(0, None, self.cap)
            self.stopped = self.cap is not None and self.lifted.losses >= self.cap
        else:
            while self._next_block():
                pass
        self.chosen.policy, self.chosen.best = (self.chosen.told(p) for p in (self.chosen.policy, self.chosen.best))

    def _next_block(self) -> bool:
        """Run the next block of the learner or of the control; returns whether there may be more."""
        stage, guard, control = self.stage, self.stage.guard, self.control
        lost = self.lifted.losses + control.losses
        if self.cap is not None and lost >= self.cap:
            self.stopped = True
            return False
        done_trials, done_steps = self.lifted.trials + control.trials, self.lifted.steps + control.steps
        trials = self.block if stage.trials is None else min(self.block, stage.trials - done_trials)
        steps = None if stage.steps is None else stage.steps - done_steps
        if trials <= 0 or (steps is not None and steps <= 0):
            return False
        turn = self.chosen
        if guard is not None and self.chosen is not control and self.lifted.trials > control.trials:
            used, whole_of_it = (control.trials, done_trials) if steps is None else (control.steps, done_steps)
            if used < guard.share * whole_of_it:
                turn = control
        turn.go_on(trials, steps, None if self.cap is None else self.cap - lost)
        if guard is not None and turn is control and self.chosen is not control:
            self._compare(guard)
        return True

    def _compare(self, guard: Guard) -> None:
        """Compare the pairs of trials that are new, and act on the verdict if it is that transfer hurts."""
        ours, theirs = (guard.scores(course.outcomes) for course in (self.lifted, self.control))
        while self._compared[0] < len(ours) and self._compared[1] < len(theirs):
            gap = guard.difference(ours[self._compared[0]], theirs[self._compared[1]])
            self._compared = [k + 1 for k in self._compared]
            before = self._test.verdict
            self.report.verdict = self._test.update(gap)
            self.report.evidence = self._test.evidence
            self.report.pairs += 1
            if self.report.verdict == "hurts" and before != "hurts" and guard.on_hurts != "report":
                self._give_way(guard)
                return

    def _give_way(self, guard: Guard) -> None:
        after = f"after {self.lifted.trials} trials"
        if guard.on_hurts == "fall back":
            self.report.actions.append(f"fell back to the control {after}")
            self.chosen, self.report.fell_back = self.control, True
            return
        self.report.actions.append(f"moved half-way to the control {after}")
        self.lifted.policy = _half_way(self.lifted.policy, self.control.policy)
        # from here on both learners' next trials are compared, each from where it is
        self._test = SequentialTest(guard.alpha)
        self._compared = [self.lifted.trials, self.control.trials]

    def entries(self) -> list[Entry]:
        """Return the stage's lines of the ledger."""
        courses = [("transferred", self.lifted)] + [("control", self.control)] * (self.stage.guard is not None)
        return [
            Entry(
                self.stage.name,
                who,
                c.trials,
                c.steps,
                0 if self.stage.rehearsal else c.losses,
                c.losses if self.stage.rehearsal else 0,
                self.stopped and c is self.chosen,
            )
            for who, c in courses
        ]


def _half_way(policy: Policy, other: Policy) -> Policy:
    carried: dict[str, Any] = {}
    for name, value in policy.carried.items():
        theirs = other.carried.get(name, value)
        carried[name] = (value + theirs) / 2 if isinstance(value, np.ndarray) else max(value, theirs)
    return replace(policy, weights=(policy.weights + other.weights) / 2, carried=carried)


def joined(parts: Sequence[Outcomes]) -> Outcomes:
    """Return the outcomes of consecutive parts as one; all of one kind."""
    if not parts:
        empty = np.zeros(0, dtype=np.int64)
        return Outcomes(empty, empty.astype(bool), empty, 0)
    first = parts[0]
    columns: dict[str, Any] = {
        f.name: np.concatenate([getattr(part, f.name) for part in parts])
        for f in fields(first)
        if isinstance(getattr(first, f.name), np.ndarray)
    }
    return replace(first, **columns)
