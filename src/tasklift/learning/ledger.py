"""The ledger: every trial, step and loss of a curriculum, booked to the stage and the learner that it belongs to."""

from __future__ import annotations

from dataclasses import dataclass


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
    """Every loss, booked to its stage.

    Examples
    --------
    >>> drill = Entry("drill", "transferred", trials=300, steps=9000, losses=0, would_be=41, stopped=False)
    >>> target = Entry("T", "transferred", trials=100, steps=4000, losses=8, would_be=0, stopped=False)
    >>> ledger = Ledger((drill, target))
    >>> ledger.total, ledger.by_stage(), ledger.per_1000_steps()["T"]
    (8, {'drill': 0, 'T': 8}, 2.0)
    """

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
