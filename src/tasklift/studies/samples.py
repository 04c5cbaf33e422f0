"""What was measured, as arrays: an arm's rows, and what V taught about the output CA."""

from __future__ import annotations

from collections.abc import Collection, Mapping
from dataclasses import dataclass, field, replace
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from tasklift.errors import TaskliftError
from tasklift.lab import Cell, Store

Floats = NDArray[np.float64]

#: The values of the output CA.
CA = np.linspace(0.0, 1.0, 11)
#: Least-squares weights: a curve over :data:`CA` times these is its slope.
SLOPE = (CA - CA.mean()) / ((CA - CA.mean()) ** 2).sum()

_AFTERWARDS = ("greedy_steps", "greedy_losses", "unseen_steps", "unseen_losses")


@dataclass(frozen=True, eq=False)
class Sample:
    """What one arm did under one condition, a row per (map, seed), ordered by them; ``n`` rows, ``T`` trials on T.

    Attributes
    ----------
    maps, seeds
        ``(n,)``: of each row.
    steps, losses, success
        ``(n, T)``: on T.
    limit, n_robots
        Steps at which a trial fails; robots at the start.
    teams_left
        ``(n, T)``; None where that was not kept.
    spent
        By stage ``(3,)``: trials, steps and losses per row, T included. Losses in drills are would-be losses.
    would_be
        ``(n, drills)``: losses in drills, where nobody is lost; None for arms without.
    greedy_steps, greedy_losses
        ``(n,)``: of the learned policy, always taking the heaviest output; empty where that was not tried.
    unseen_steps, unseen_losses
        ``(n,)``: the same on maps on which nothing was learned.
    move_weights
        ``(n, 3, 5, 2)``: mean weights by nWPN, FTR and MV; None where they were not kept.
    """

    maps: NDArray[np.str_]
    seeds: NDArray[np.int64]
    steps: Floats
    losses: Floats
    success: Floats
    limit: int
    n_robots: int
    teams_left: Floats | None = None
    spent: Mapping[str, Floats] = field(default_factory=dict)
    would_be: Floats | None = None
    greedy_steps: Floats = field(default_factory=lambda: np.empty(0))
    greedy_losses: Floats = field(default_factory=lambda: np.empty(0))
    unseen_steps: Floats = field(default_factory=lambda: np.empty(0))
    unseen_losses: Floats = field(default_factory=lambda: np.empty(0))
    move_weights: Floats | None = None

    @classmethod
    def of(cls, store: Store, arm: str, *, among: Collection[Cell] | None = None, **where: str) -> Sample:
        """Read an arm's rows.

        Parameters
        ----------
        store
            Of a study.
        arm
            Its slug.
        among
            Only these cells, where the store may have more than were asked for.
        where
            Values of other axes, such as ``reading="scattered"``.

        Raises
        ------
        TaskliftError
            If the store has no such rows.
        """
        found = [
            (cell, result)
            for cell, result in store.select(arm=arm, **where, attachments=True)
            if among is None or cell in among
        ]
        if not found:
            raise TaskliftError(f"{store.path}: no rows of arm {arm!r} {where or ''}; `tasklift runs show` lists them")
        settings = store.spec.settings
        results = [result for _, result in found]

        def column(stage: str, name: str) -> Floats | None:
            if name not in results[0].stages.get(stage, {}):
                return None
            return np.array([r.stages[stage][name] for r in results], np.float64)

        steps, losses, success = (column("target", name) for name in ("steps", "losses", "success"))
        assert steps is not None
        assert losses is not None
        assert success is not None
        spent = {
            stage: np.mean([[r.stages[stage][c].sum() for c in ("steps", "losses")] for r in results], axis=0)
            for stage in results[0].stages
            if stage not in ("greedy", "unseen")
        }
        return cls(
            maps=np.array([cell["map"] for cell, _ in found]),
            seeds=np.array([int(cell["seed"]) for cell, _ in found]),
            steps=steps,
            losses=losses,
            success=success,
            limit=settings["mission"]["limit"],
            n_robots=sum(kind["robots"] for kind in settings["mission"]["team"]),
            teams_left=column("target", "teams_left"),
            spent={s: np.array([len(results[0].stages[s]["steps"]), *sums]) for s, sums in spent.items()},
            would_be=column("drill", "losses"),
            move_weights=np.stack([r.attachments["move_weights"] for r in results])
            if "move_weights" in results[0].attachments
            else None,
            **{
                name: np.array([r.summary[name] for r in results], np.float64)
                for name in _AFTERWARDS
                if name in results[0].summary
            },
        )

    @property
    def robots_left(self) -> Floats:
        """``(n, T)``: at the end of each trial."""
        return self.n_robots - self.losses

    @property
    def kept_all(self) -> Floats:
        """``(n,)``: of 100 trials on T, those in which every robot survives."""
        return np.asarray(100 * (self.losses == 0).mean(axis=1))

    @property
    def total(self) -> int:
        """Trials of every kind: V's traversals, drills, and trials on T."""
        return int(sum(trials for trials, *_ in self.spent.values()))

    def last(self, trials: int) -> Sample:
        """Return the same with only the last trials on T."""
        cut = {name: getattr(self, name)[:, -trials:] for name in ("steps", "losses", "success")}
        return replace(self, teams_left=None if self.teams_left is None else self.teams_left[:, -trials:], **cut)

    def paired_with(self, other: Sample) -> bool:
        """Whether both have the same (map, seed) row by row, so that differences are paired."""
        return np.array_equal(self.maps, other.maps) and np.array_equal(self.seeds, other.seeds)


@dataclass(frozen=True, eq=False)
class Coverage:
    """What V taught about CA, a row per (map, seed); ``n`` rows.

    Attributes
    ----------
    maps, seeds
        ``(n,)``: of each row.
    weights
        ``(n, 11)``: mean weight by CA of the outputs that move (Figure 3c, 3d).
    steps
        ``(n, 11)``: mean steps of their trials.
    """

    maps: NDArray[np.str_]
    seeds: NDArray[np.int64]
    weights: Floats
    steps: Floats

    @classmethod
    def of(cls, store: Store, arm: str, **where: str) -> Coverage:
        """Read what an arm that learns V has learned of it; parameters as in :meth:`Sample.of`."""
        found = list(store.select(arm=arm, **where, attachments=True))
        return cls(
            maps=np.array([cell["map"] for cell, _ in found]),
            seeds=np.array([int(cell["seed"]) for cell, _ in found]),
            weights=np.array([result.attachments["ca_weights"] for _, result in found]).reshape(-1, len(CA)),
            steps=np.array([result.attachments["ca_steps"] for _, result in found]).reshape(-1, len(CA)),
        )

    @cached_property
    def slopes(self) -> Floats:
        """``(n,)``: least-squares slope of weight on CA (weight per unit of CA)."""
        return np.asarray(self.weights @ SLOPE)

    @cached_property
    def changes(self) -> Floats:
        """``(n,)``: change of the trial time from CA = 0 to CA = 1, as a share of its mean."""
        return np.asarray(self.steps @ SLOPE / self.steps.mean(axis=1))
