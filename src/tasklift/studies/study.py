"""One study: buildings × seeds × arms × readings, and what is done in each cell."""

from __future__ import annotations

import dataclasses
import threading
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray

from tasklift.building.graph import Building
from tasklift.building.mission import Mission
from tasklift.building.reading import Reading
from tasklift.building.search import search_and_clear
from tasklift.building.simulator import SearchOutcomes
from tasklift.building.team import SCOUT, WEAPON, Kind
from tasklift.errors import TaskliftError
from tasklift.lab import Cell, CellResult, Spec, grid
from tasklift.learning.chances import BUDGET_STAGE, DRILL_STAGE, GREEDY_STAGE, TARGET_STAGE
from tasklift.learning.learner import Curve
from tasklift.learning.reinforcement import Reinforcement, reinforce
from tasklift.studies.arms import arm_named, learn_source, start_policy
from tasklift.tasks.policy import Policy
from tasklift.tasks.task import Task

#: The policy that a cell ends with is used so often without learning, always its heaviest output: on its own map,
#: and on one that it has never seen.
GREEDY_TRIALS = 5

_latest = threading.local()  # V of the reading, map and seed that this thread works on: the arms share it


@dataclass(frozen=True, eq=False)
class Study:
    """What is compared with what, and on how much.

    Attributes
    ----------
    buildings
        By name.
    readings
        The world's rules, by name.
    arms
        Names of :data:`tasklift.studies.arms.ARMS`.
    seeds
        How many; the seeds are 0, 1, ….
    trials
        On the full task T.
    repeats
        Traversals per output on the simple task V (44 outputs × 5 in the paper).
    team, hostiles, weapons_needed, limit
        As in :class:`tasklift.building.Mission`.
    reinforcement
        The learner's settings.
    unseen
        Further buildings, on which nothing is learned: policies are tried there greedily, seed by seed in turn.
    """

    buildings: Mapping[str, Building]
    readings: Mapping[str, Reading]
    arms: tuple[str, ...]
    seeds: int = 5
    trials: int = 100
    repeats: int = 5
    team: Mapping[Kind, int] = field(default_factory=lambda: {SCOUT: 10, WEAPON: 5})
    hostiles: int = 1
    weapons_needed: int = 2
    limit: int = 600
    reinforcement: Reinforcement = field(default_factory=Reinforcement)
    unseen: Mapping[str, Building] = field(default_factory=dict)

    def __post_init__(self) -> None:
        for name in ("seeds", "trials", "repeats"):
            value = getattr(self, name)
            if not isinstance(value, int) or isinstance(value, bool) or value < 1:
                raise TaskliftError(f"{name}: expected a whole number of at least 1, found {value!r}")
        for name in self.arms:
            arm_named(name)
        for reading in self.readings:
            for building in (*self.buildings, *self.unseen):
                self.mission(reading, building)  # refuses before anything is trained what cannot work

    def __getstate__(self) -> dict[str, Any]:
        """Leave compiled missions behind when a study travels to another process."""
        return {f.name: getattr(self, f.name) for f in dataclasses.fields(self)}

    @cached_property
    def _missions(self) -> dict[tuple[str, str], Mission]:
        return {}

    def mission(self, reading: str, building: str) -> Mission:
        """Return the mission on one building under one reading, compiled at its first use."""
        key = (reading, building)
        if key not in self._missions:
            self._missions[key] = Mission(
                {**self.buildings, **self.unseen}[building],
                self.team,
                hostiles=self.hostiles,
                reading=self.readings[reading],
                weapons_needed=self.weapons_needed,
                limit=self.limit,
            )
        return self._missions[key]

    @property
    def task(self) -> Task:
        """The full task T."""
        return search_and_clear()

    def spec(self, name: str) -> Spec:
        """Return the study as data: equal specs give equal rows."""
        return Spec.of(
            name,
            {
                "maps": {key: building.content_id for key, building in self.buildings.items()},
                "readings": {key: dataclasses.asdict(reading) for key, reading in self.readings.items()},
                "arms": list(self.arms),
                "seeds": self.seeds,
                "trials": self.trials,
                "repeats": self.repeats,
                "team": [[kind.name, kind.speed_mm, kind.armed, n] for kind, n in self.team.items()],
                "hostiles": self.hostiles,
                "weapons_needed": self.weapons_needed,
                "limit": self.limit,
                "reinforcement": dataclasses.asdict(self.reinforcement),
                "greedy_trials": GREEDY_TRIALS,
                "unseen": {key: building.content_id for key, building in self.unseen.items()},
            },
            {"reading": list(self.readings), "map": list(self.buildings), "seed": range(self.seeds), "arm": self.arms},
            over=("map", "seed"),
        )

    def cells(self) -> list[Cell]:
        """Return the units of work."""
        return grid(reading=self.readings, map=self.buildings, seed=range(self.seeds), arm=self.arms)

    def work(self, cell: Cell) -> CellResult:
        """Train one arm on one map with one seed under one reading, then use what it learned greedily."""
        policy, stages = self._train(cell)
        columns = {stage: _columns(outcomes) for stage, outcomes in stages.items()}
        columns["greedy"] = _columns(self._greedy(cell, cell["map"], policy))
        if self.unseen:
            place = list(self.unseen)[int(cell["seed"]) % len(self.unseen)]
            columns["unseen"] = _columns(self._greedy(cell, place, policy))
        attachments: dict[str, Any] = {"move_weights": move_weights(policy)}
        if cell["arm"] == "copy":
            attachments["ca_weights"] = ca_weights(self._source(cell).policy)
        return CellResult(stages=columns, summary=_summary(columns), attachments=attachments)

    def _greedy(self, cell: Cell, building: str, policy: Policy) -> SearchOutcomes:
        """Use a policy without learning, always its heaviest output."""
        return self.mission(cell["reading"], building).run(
            policy.task,
            policy.weights.copy(),
            trials=GREEDY_TRIALS,
            seed=int(cell["seed"]),
            stage=GREEDY_STAGE,
            reinforcement=Reinforcement(selection="exploitation"),
            learn=False,
        )

    def learned(self, cell: Cell) -> Policy:
        """Train one cell again and return the policy that it ends with."""
        return self._train(cell)[0]

    def start(self, cell: Cell) -> Policy:
        """Return the policy with which a cell enters T, before any trial there."""
        arm = arm_named(cell["arm"])
        source = self._source(cell).policy if arm.needs_source else None
        return start_policy(arm.start, self.task, source, self.reinforcement.initial_weight)

    def before(self, cell: Cell, trial: int) -> Policy:
        """Return the policy with which a cell enters one of its trials on T, counted from 1."""
        policy, _ = self._enter(cell)
        arm = arm_named(cell["arm"])
        if not arm.learns or trial == 1:
            return policy
        rules, mission = arm.reinforcement(self.reinforcement), self.mission(cell["reading"], cell["map"])
        return reinforce(mission, policy, trials=trial - 1, seed=int(cell["seed"]), reinforcement=rules).policy

    def _train(self, cell: Cell) -> tuple[Policy, dict[str, SearchOutcomes]]:
        """Return the policy at the end and the outcomes of each stage: source, budget, drill, target."""
        mission, arm = self.mission(cell["reading"], cell["map"]), arm_named(cell["arm"])
        rules = arm.reinforcement(self.reinforcement)
        policy, stages = self._enter(cell)
        if not arm.learns:
            stages["target"] = mission.run(
                policy.task,
                policy.weights.copy(),
                trials=self.trials,
                seed=int(cell["seed"]),
                stage=TARGET_STAGE,
                reinforcement=rules,
                learn=False,
            )
            return policy, stages
        curve = reinforce(mission, policy, trials=self.trials, seed=int(cell["seed"]), reinforcement=rules)
        stages["target"] = curve.outcomes
        return curve.policy, stages

    def _enter(self, cell: Cell) -> tuple[Policy, dict[str, Any]]:
        """Return the policy with which a cell enters T, and the outcomes of the stages before."""
        mission, arm = self.mission(cell["reading"], cell["map"]), arm_named(cell["arm"])
        rules = arm.reinforcement(self.reinforcement)
        policy = self.start(cell)
        stages: dict[str, Any] = {}
        if arm.needs_source:
            stages["source"] = self._source(cell).outcomes
        budget = self.repeats * policy.task.shape[1] if arm.budget < 0 else arm.budget
        before = (
            ("budget", mission, budget, BUDGET_STAGE, rules),
            (
                "drill",
                mission.with_reading(drill=True),
                arm.drills,
                DRILL_STAGE,
                replace(rules, selection="exploration"),
            ),
        )
        for name, world, trials, stage, how in before:
            if trials:
                spent = reinforce(world, policy, trials=trials, seed=int(cell["seed"]), stage=stage, reinforcement=how)
                policy, stages[name] = spent.policy, spent.outcomes
        return policy, stages

    def _source(self, cell: Cell) -> Curve:
        """V of a cell, learned once for all arms that share it."""
        mission = self.mission(cell["reading"], cell["map"])
        key = (int(cell["seed"]), self.repeats, self.reinforcement)
        if getattr(_latest, "mission", None) is not mission or _latest.key != key:
            _latest.curve = learn_source(
                mission, repeats=self.repeats, seed=int(cell["seed"]), reinforcement=self.reinforcement
            )
            _latest.mission, _latest.key = mission, key
        curve: Curve = _latest.curve
        return curve


def _columns(outcomes: SearchOutcomes) -> dict[str, NDArray[Any]]:
    return {
        "steps": outcomes.steps,
        "success": outcomes.success,
        "losses": outcomes.losses,
        "robots_left": outcomes.robots_left.sum(axis=1),
        "teams_left": outcomes.teams_left,
        "hostiles_left": outcomes.hostiles_left,
        "explored": outcomes.explored.astype(np.float32),
        "messages": outcomes.messages,
    }


def _summary(columns: Mapping[str, Mapping[str, NDArray[Any]]]) -> dict[str, Any]:
    target = columns["target"]
    summary = {
        "steps": float(target["steps"].mean()),
        "losses": int(target["losses"].sum()),
        "out_of_time": float(1.0 - target["success"].mean()),
    }
    for stage in ("greedy", "unseen"):
        if stage in columns:
            for name in ("steps", "losses", "success"):
                summary[f"{stage}_{name}"] = float(columns[stage][name].mean())
    return summary


def move_weights(policy: Policy) -> NDArray[np.float64]:
    """Return Figure 5's table, float64 (3, 5, 2): the mean weight by nWPN, FTR and MV, over all else."""
    return policy.weights.reshape(3, 2, 3, 5, 2, 22).mean(axis=(0, 1, 5))


def ca_weights(source: Policy) -> NDArray[np.float64]:
    """Return Figure 3's curve, float64 (11,): V's mean weight by CA where robots move, over all else."""
    return source.weights.reshape(15, 2, 2, 11)[:, 1].mean(axis=(0, 1))
