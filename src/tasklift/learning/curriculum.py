"""Curricula: stages in order, each with its task, world, learner and budget.

Generalises the paper's V and T (section III) to any chain V1 ⊂ V2 ⊂ … ⊂ T. What a stage learned enters the
next one by copying, then by priors, then by *trust*: as how much experience a copied weight counts.
"""

from __future__ import annotations

from collections.abc import Hashable, MutableMapping, Sequence
from dataclasses import dataclass
from typing import Any

from tasklift.checks import whole_number
from tasklift.errors import TaskliftError
from tasklift.learning.chances import SWEEP_STAGE, TARGET_STAGE
from tasklift.learning.guard import GuardReport
from tasklift.learning.ledger import Ledger
from tasklift.learning.stage import Stage, StageRun
from tasklift.learning.worlds import Outcomes
from tasklift.tasks.policy import Policy
from tasklift.text import shown

EARLIER_STAGES = 100
"""Random key of a curriculum's first stage; the next ones count up, the last has :data:`TARGET_STAGE`."""


@dataclass(frozen=True)
class Records:
    """What a curriculum came to, its policies aside.

    Attributes
    ----------
    outcomes
        By stage: the transferred learner's; a control's are under ``"<stage> (control)"``.
    ledger
        Trials, steps and losses by stage and learner.
    guards
        What each stage's guard found.
    stopped
        The stage whose cap, or the curriculum's, was reached last.
    """

    outcomes: dict[str, Outcomes]
    ledger: Ledger
    guards: dict[str, GuardReport]
    stopped: str | None

    def __repr__(self) -> str:
        stages = [f"{shown(name, 30)} {len(outcomes)} episodes" for name, outcomes in list(self.outcomes.items())[:3]]
        return f"{type(self).__name__}({', '.join(stages)}; {sum(e.losses for e in self.ledger.entries)} lost)"

    def at_the_end(self, stage: str) -> Outcomes:
        """Return the outcomes of the learner whose policy counts: the control's, if the guard fell back to it."""
        fell_back = stage in self.guards and self.guards[stage].fell_back
        return self.outcomes[f"{stage} (control)" if fell_back else stage]


@dataclass(frozen=True, repr=False)
class CurriculumRun(Records):
    """What a curriculum came to: its records, the policy learned last, and the rollback policy of that stage."""

    policy: Policy
    best: Policy


@dataclass(frozen=True)
class Curriculum:
    """Stages in order, each task equal to the next one's or a simplification of it.

    Parameters
    ----------
    stages
        At least one.
    max_losses
        Over all stages and controls together; no trial begins once this much is lost.
    best_by
        Criteria for the rollback policy, most important first: fewer losses, more success, fewer steps, higher return.
        The policy kept is the one at the start of the block of trials with the best means. A stage that runs in one
        piece, such as a sweep, keeps what it learned.
    block
        Trials per block. None: every stage runs in one piece.

    Examples
    --------
    >>> from tasklift import Curriculum, Reinforcement, Stage, Sweep, swap
    >>> from tasklift.building import Mission, generate
    >>> hunt = Mission(generate(seed=7), team="10+5")
    >>> safe = hunt.task.simplify(fix={"DL": 0, "GL": 0})
    >>> stop_at_doors = swap("MV", when={"FTR": 4, "nWPN": [0, 1]})
    >>> run = Curriculum([
    ...     Stage("V", safe, hunt.without_hostiles(), Sweep(repeats=1)),
    ...     Stage("T", hunt.task, hunt, Reinforcement(), trials=20, prior=[stop_at_doors]),
    ... ], max_losses=60).run(seed=0)
    >>> [(entry.stage, entry.trials) for entry in run.ledger.entries], run.stopped  # no trial begins after 60 losses
    ([('V', 44), ('T', 13)], 'T')
    """

    stages: Sequence[Stage]
    max_losses: int | None = None
    best_by: Sequence[str] = ("losses", "success", "steps")
    block: int | None = 20

    def __repr__(self) -> str:
        names = [shown(stage.name, 30) for stage in self.stages]
        return f"Curriculum({' → '.join(names if len(names) <= 4 else [*names[:3], '…', names[-1]])})"

    def check(self) -> None:
        """Raise :class:`TaskliftError` for the first thing wrong; :meth:`run` asks before it trains."""
        names = [stage.name for stage in self.stages]
        if not names:
            raise TaskliftError("curriculum: has no stages")
        if len(set(names)) < len(names):
            raise TaskliftError(f"curriculum: two stages have the same name in {names}")
        for name in ("block", "max_losses"):
            if getattr(self, name) is not None:
                whole_number(getattr(self, name), f"curriculum, {name}", least=1)
        unknown = [name for name in self.best_by if name not in ("losses", "success", "steps", "return")]
        if unknown or not self.best_by:
            raise TaskliftError(f"curriculum, best_by: expected losses, success, steps or return, found {unknown}")
        for stage in self.stages:
            stage.check()
            if stage.guard is not None and self.block is None:
                raise TaskliftError(f"stage {stage.name!r}: a guard takes turns by blocks; give the curriculum a block")
        kinds = [stage.learner.start(stage.task).kind for stage in self.stages]
        for k, (stage, after) in enumerate(zip(self.stages, self.stages[1:], strict=False)):
            if after.initial is not None:
                continue
            try:
                stage.task.ancestor(after.task)
            except TaskliftError as error:
                raise TaskliftError(f"stage {stage.name!r} cannot lead to {after.name!r}: {error}") from error
            if kinds[k] != kinds[k + 1]:
                raise TaskliftError(
                    f"stage {stage.name!r} cannot lead to {after.name!r}: one learns {kinds[k]}s, one {kinds[k + 1]}s"
                )

    def run(
        self,
        seed: int = 0,
        initial: Policy | None = None,
        shared: MutableMapping[Any, CurriculumRun] | None = None,
    ) -> CurriculumRun:
        """Run all stages in order.

        Parameters
        ----------
        seed
            Of everything; curricula run with the same seed share random numbers in stages with the same key.
        initial
            Enter the first stage with this policy; default: from scratch.
        shared
            Remembers what the first one, two, … stages came to. Curricula that begin with the same stages, and are run
            with the same mapping, learn those once. It changes no result. Stages are the same if they have the same
            world object and equal settings.

        Raises
        ------
        TaskliftError
            For whatever :meth:`check` finds, before anything is trained.
        """
        self.check()
        whole_number(seed, "curriculum, seed", least=0)
        found = self._upto(len(self.stages), seed, initial, shared)
        assert found is not None
        return found

    def policy_at(
        self,
        seed: int,
        stage: str,
        trial: int,
        initial: Policy | None = None,
        shared: MutableMapping[Any, CurriculumRun] | None = None,
    ) -> Policy:
        """Return the policy with which a trial begins, by running everything before it again.

        Parameters
        ----------
        seed
            As in :meth:`run`.
        stage
            Name of a stage.
        trial
            Of the learner in that stage (not of a guard's control), counted from 0.
        initial, shared
            As in :meth:`run`.

        Raises
        ------
        TaskliftError
            If there is no such stage, or it ends before that trial.
        """
        self.check()
        whole_number(seed, "curriculum, seed", least=0)
        whole_number(trial, "curriculum, trial", least=0)
        names = [s.name for s in self.stages]
        if stage not in names:
            raise TaskliftError(f"curriculum: no stage {stage!r}; there are {', '.join(names)}")
        number = names.index(stage)
        before = self._upto(number, seed, initial, shared)
        if before is not None and len(before.outcomes) < number:
            raise TaskliftError(f"curriculum: a cap was reached before stage {stage!r} began")
        if trial == 0:
            return self.stages[number].enter(self._entering(number, before, initial))
        run = self._stage(number, seed, before, initial, until=trial)
        if run.transferred.trials < trial:
            raise TaskliftError(
                f"stage {stage!r}, trial {trial}: the stage ends after {run.transferred.trials} trials, counted from 0"
            )
        return run.transferred.signed(run.transferred.policy)

    def _upto(
        self, number: int, seed: int, initial: Policy | None, shared: MutableMapping[Any, CurriculumRun] | None
    ) -> CurriculumRun | None:
        """Return what the first ``number`` stages came to; None for 0."""
        before: CurriculumRun | None = None
        for k in range(number):
            left = self._left(before)
            if left is not None and left <= 0:
                break
            key = None if shared is None else self._identity(k, seed, initial)
            if shared is not None and key is not None and key in shared:
                before = shared[key]
                continue
            before = self._joined(before, self._stage(k, seed, before, initial))
            if shared is not None and key is not None:
                shared[key] = before
        return before

    def _stage(
        self, number: int, seed: int, before: CurriculumRun | None, initial: Policy | None, until: int | None = None
    ) -> StageRun:
        entering = self._entering(number, before, initial)
        stage, key = self.stages[number], self.key(number)
        return StageRun(stage, key, seed, entering, self._left(before), self.best_by, self.block, until)

    def _entering(self, number: int, before: CurriculumRun | None, initial: Policy | None) -> Policy | None:
        """Return the policy of the stage before: the rollback policy, if a cap stopped it."""
        if before is None:
            return initial
        return before.best if before.stopped == self.stages[number - 1].name else before.policy

    def _left(self, before: CurriculumRun | None) -> int | None:
        """Return how much may still be lost."""
        if self.max_losses is None:
            return None
        return self.max_losses - (before.ledger.total if before is not None else 0)

    def _joined(self, before: CurriculumRun | None, run: StageRun) -> CurriculumRun:
        name = run.stage.name
        outcomes, entries, guards, stopped = (
            ({}, (), {}, None)
            if before is None
            else (before.outcomes, before.ledger.entries, before.guards, before.stopped)
        )
        return CurriculumRun(
            {**outcomes, **run.outcomes()},
            Ledger((*entries, *run.entries())),
            {**guards, name: run.report} if run.stage.guard is not None else guards,
            name if run.stopped else stopped,
            run.policy,
            run.best,
        )

    def _identity(self, number: int, seed: int, initial: Policy | None) -> Hashable | None:
        """Return the key under which the first stages, to this one, are shared; None if they cannot be compared."""
        stages = tuple((*self.stages[k].identity(), self.key(k)) for k in range(number + 1))
        key = (stages, seed, initial, self.max_losses, tuple(self.best_by), self.block)
        try:
            hash(key)
        except TypeError:  # a world or a learner of a user's that has no hash
            return None
        return key

    def key(self, number: int) -> int:
        """Return the part of the random key that a stage has, by its number from 0."""
        stage = self.stages[number]
        if stage.key is not None:
            return stage.key
        if stage.own_budget:
            return SWEEP_STAGE
        return TARGET_STAGE if number == len(self.stages) - 1 else EARLIER_STAGES + number
