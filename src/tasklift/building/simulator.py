"""The seam between people and the kernel: validate, allocate, seed, call, and name what comes back."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from tasklift.building import kernel, layout
from tasklift.building.search import hostile_candidates
from tasklift.errors import TaskliftError
from tasklift.learning.reinforcement import SWEEP_STAGE, TARGET_STAGE, Outcomes, Reinforcement
from tasklift.tasks.task import Task

if TYPE_CHECKING:
    from tasklift.building.mission import Mission
    from tasklift.tasks.policy import Policy

_SPLITS = ("robots", "pairs", "team")
_SHARES = ("none", "team", "radio")
_TIME_SIGNALS = ("none", "inverted", "baseline")
_TABLE = ("steps", "success", "losses", "teams_left", "hostiles_left", "edges_seen", "messages")


@dataclass(frozen=True, eq=False)
class SearchOutcomes(Outcomes):
    """What came of ``n`` trials of a building search, one row each.

    Attributes
    ----------
    robots_left
        ``int64 (n, kinds)``: the living at the end, in the order of the mission's team.
    teams_left
        ``int64 (n,)``: teams among them.
    hostiles_left
        ``int64 (n,)``.
    explored
        ``float64 (n,)``: share of the building's edges that some robot, living or lost, has travelled.
    messages
        ``int64 (n,)``: alerts heard plus poolings of maps that taught someone something (rule 11).
    """

    robots_left: NDArray[np.int64]
    teams_left: NDArray[np.int64]
    hostiles_left: NDArray[np.int64]
    explored: NDArray[np.float64]
    messages: NDArray[np.int64]


def _records(dtype: np.dtype, **columns: Any) -> NDArray[Any]:
    """Return a record array from its columns."""
    rows = np.zeros(len(next(iter(columns.values()))), dtype)
    for name, column in columns.items():
        rows[name] = column
    return rows


class Simulator:
    """A mission, compiled to arrays. Holds nothing that changes: any number of threads may share one.

    Parameters
    ----------
    mission
        A checked :class:`tasklift.building.Mission`.
    """

    def __init__(self, mission: Mission) -> None:
        self.mission = mission
        self.world = self._world()
        self.rules = self._rules()
        self._n_robots = mission.n_robots

    # --- what never changes -------------------------------------------------------------------------------------

    def _world(self) -> layout.World:
        building, reading = self.mission.building, self.mission.reading
        near = _within_earshot(building.position_m, building.feature_class > 1, reading.alert_range_m)
        near_ends = np.cumsum([len(features) for features in near])
        nodes = _records(
            layout.NODE,
            x=building.position_m[:, 0],
            y=building.position_m[:, 1],
            feature=building.feature_class,
            first=building.indptr[:-1],
            last=building.indptr[1:],
            near_first=near_ends - [len(features) for features in near],
            near_last=near_ends,
        )
        halves = _records(
            layout.HALF,
            to=building.neighbour,
            edge=building.edge_of,
            cost_mm=edge_cost_mm(building.length_m, building.width_m)[building.edge_of],
            coverage=building.coverage,
        )
        kinds = [(i, kind) for i, (kind, n) in enumerate(self.mission.team.items()) for _ in range(n)]
        members = _records(
            layout.MEMBER,
            speed_mm=[kind.speed_mm for _, kind in kinds],
            armed=[kind.armed for _, kind in kinds],
            kind=[i for i, _ in kinds],
        )
        placed = self.mission.hostiles
        candidates = hostile_candidates(building) if isinstance(placed, int) else list(placed)
        return layout.World(
            nodes=nodes,
            halves=halves,
            near=np.array([f for features in near for f in features], np.int64),
            search=search_steps(building.kind == 0, building.area_m2, building.obstacles, reading.search_rate_m2),
            candidates=np.array(candidates, np.int64),
            members=members,
        )

    def _rules(self) -> layout.Rules:
        mission, reading = self.mission, self.mission.reading
        return layout.Rules(
            start=int(mission.building.start),
            rooms=int((self.world.search > 0).sum()),
            hostiles=mission.n_hostiles,
            placed=int(not isinstance(mission.hostiles, int)),
            relocate=int(reading.relocate),
            weapons_needed=mission.weapons_needed,
            limit=mission.limit,
            patience=reading.patience,
            by_team=int(reading.decide == "team"),
            split=_SPLITS.index(reading.split),
            turn_back=int(reading.turn_back),
            unvisited_first=int(reading.explore == "unvisited-first"),
            sharpness=float(reading.goal_sharpness),
            engage_crossing=int(reading.engage == "crossing"),
            suspicion_goal=int(reading.suspicion_goal),
            share_map=_SHARES.index(reading.share_map),
            drill=int(reading.drill),
            alerts=int(mission.n_hostiles > 0),
        )

    # --- what a run needs ---------------------------------------------------------------------------------------

    def learner(
        self, task: Task, reinforcement: Reinforcement, *, sweep: bool = False, learn: bool = True
    ) -> layout.Learner:
        """Compile a task's tables and the learner's rules.

        Raises
        ------
        TaskliftError
            If ``task`` is neither the mission's task nor a simplification of it.
        """
        root = self.mission.task
        if task.root != root:
            raise TaskliftError(
                f"task {task.name!r} is no simplification of this mission's task {root.name!r}; "
                "start from `mission.task`"
            )
        values = [root.output_values(int(index)) for index in task.output_map]
        outputs = _records(
            layout.OUTPUT,
            mv=[v["MV"] for v in values],
            wpn=[v["WPN"] for v in values],
            ca=[v["CA"] for v in values],
        )
        sweep_all = sweep and reinforcement.sweep_credit == "all"
        greedy = {"exploration": 0.0, "pseudo-random": reinforcement.q, "exploitation": 1.0}
        return layout.Learner(
            rows=np.ascontiguousarray(task.input_map, np.int64),
            outputs=outputs,
            signal=np.ascontiguousarray(task.rule_table() if sweep_all else task.signal_table(), np.float64),
            learn=int(learn),
            sweep_all=int(sweep_all),
            greedy=float(greedy[reinforcement.selection]),
            floor=float(reinforcement.floor),
            once=int(reinforcement.credit == "trial"),
            time_signal=1 if sweep else _TIME_SIGNALS.index(reinforcement.time_signal),
            time_reward=float(task.time_reward),
            loss_signal=float(reinforcement.loss_signal),
        )

    def lane(self, weights: NDArray[np.float64]) -> layout.Lane:
        """Allocate one simulation; ``weights`` (S, A) are used in place."""
        n_robots, n_nodes = self._n_robots, len(self.world.nodes)
        n_edges = self.mission.building.n_edges
        words = (n_edges + 63) // 64
        degree = int((self.world.nodes["last"] - self.world.nodes["first"]).max())
        return layout.Lane(
            robots=np.zeros(n_robots, layout.ROBOT),
            roster=np.zeros(n_robots, np.int64),
            sites=np.zeros(n_nodes, layout.SITE),
            picks=np.zeros(len(self.world.halves), np.int64),
            open=np.zeros(degree, np.uint8),
            share=np.zeros(degree),
            visited=np.zeros(n_edges, np.uint8),
            maps=np.zeros((n_robots, words), np.uint64),
            pooled=np.zeros((n_robots, words), np.uint64),
            teams=np.zeros(n_robots, layout.TEAM),
            slots=np.zeros(1 << (2 * n_robots - 1).bit_length(), layout.SLOT),
            used=np.zeros(weights.shape, np.int64),
            pairs=np.zeros(weights.size, np.int64),
            shuffle=np.zeros(len(self.world.candidates), np.int64),
            count=np.zeros(1, layout.COUNT),
            weights=weights,
        )

    def keys(self, seed: int, stage: int) -> tuple[np.uint64, np.uint64]:
        """Return the random keys of a stage and of the hostiles' places."""
        if not isinstance(seed, int | np.integer) or isinstance(seed, bool) or not 0 <= seed < 2**63:
            raise TaskliftError(f"seed: expected a whole number from 0 to 2^63 - 1, found {seed!r}")
        stage_key, place_key = kernel.keys(int(seed), self.mission.building.map_id, stage)
        return np.uint64(stage_key), np.uint64(place_key)

    def begin_trial(self, lane: layout.Lane, stage_key: np.uint64, place_key: np.uint64, trial: int) -> None:
        """Set a lane to the start of one trial; :func:`tasklift.building.kernel.step` takes it from there."""
        key = np.uint64(kernel.child_key(stage_key, trial))
        kernel.begin_trial(self.world, self.rules, lane, key, place_key)

    # --- running ------------------------------------------------------------------------------------------------

    def run(
        self,
        task: Task,
        weights: NDArray[np.float64],
        *,
        trials: int,
        seed: int,
        stage: int,
        reinforcement: Reinforcement,
        outputs: NDArray[np.int64] | None = None,
        first_trial: int = 0,
        learn: bool = True,
        max_losses: int | None = None,
    ) -> SearchOutcomes:
        """Run trials on one lane; ``weights`` (S, A) learn in place. See :class:`.Trials`."""
        if weights.shape != task.shape or weights.dtype != np.float64 or not weights.flags.c_contiguous:
            raise TaskliftError(
                f"weights: expected a C-ordered float64 array of shape {task.shape} for task {task.name!r}, "
                f"found {weights.dtype} {weights.shape}"
            )
        fixed = np.full(trials, -1, np.int64) if outputs is None else np.asarray(outputs, np.int64)
        if fixed.shape != (trials,) or (outputs is not None and not ((fixed >= 0) & (fixed < task.shape[1])).all()):
            raise TaskliftError(
                f"outputs: expected {trials} output numbers from 0 to {task.shape[1] - 1}, one per trial"
            )
        table = np.zeros((trials, len(_TABLE)), np.int64)
        left = np.zeros((trials, len(self.mission.team)), np.int64)
        stage_key, place_key = self.keys(seed, stage)
        lane = self.lane(weights)
        done, outside = kernel.run_trials(
            self.world,
            self.rules,
            self.learner(task, reinforcement, sweep=outputs is not None, learn=learn),
            lane,
            stage_key,
            place_key,
            first_trial,
            fixed,
            -1 if max_losses is None else max_losses,
            table,
            left,
        )
        if outside:
            self._refuse_input(task, outside - 1)
        column = {name: np.ascontiguousarray(table[:done, i]) for i, name in enumerate(_TABLE)}
        return SearchOutcomes(
            steps=column["steps"],
            success=column["success"].astype(bool),
            losses=column["losses"],
            limit=self.mission.limit,
            robots_left=left[:done],
            teams_left=column["teams_left"],
            hostiles_left=column["hostiles_left"],
            explored=column["edges_seen"] / self.mission.building.n_edges,
            messages=column["messages"],
        )

    def _refuse_input(self, task: Task, row: int) -> None:
        raise TaskliftError(
            f"task {task.name!r}: the world showed the input {self.mission.task.input_values(row)}, which this "
            "simplified task leaves out; train it on a mission that never shows it (`without_hostiles`), "
            "or extend it first"
        )

    def trace(
        self,
        policy: Policy,
        *,
        seed: int = 0,
        trial: int = 0,
        stage: int = TARGET_STAGE,
        reinforcement: Reinforcement | None = None,
        output: int | None = None,
        learn: bool = True,
    ) -> Trace:
        """Run one trial and keep everything that happens in it.

        Parameters
        ----------
        policy
            Its weights at the start of the trial; not changed.
        seed, trial, stage
            The random key: the same as in :meth:`run` gives the same trial.
        reinforcement
            The learner's rules; the default's if not given.
        output
            One output for the whole trial, as in the sweep.
        learn
            Whether weights change during the trial.
        """
        weights = np.array(policy.weights, np.float64, order="C")
        rules = reinforcement or Reinforcement()
        stage = SWEEP_STAGE if output is not None and stage == TARGET_STAGE else stage
        learner = self.learner(policy.task, rules, sweep=output is not None, learn=learn)
        lane = self.lane(weights)
        stage_key, place_key = self.keys(seed, stage)
        self.begin_trial(lane, stage_key, place_key, trial)
        frames = [_frame(lane)]
        fixed = -1 if output is None else output
        state = 0
        while state == 0:
            state = kernel.step(self.world, self.rules, learner, lane, fixed)
            if state == 3:
                self._refuse_input(policy.task, int(lane.count["outside"][0]) - 1)
            frames.append(_frame(lane))
        return Trace(
            mission=self.mission,
            task=policy.task,
            learner=learner,
            seed=seed,
            trial=trial,
            success=state == 1,
            weights=np.array(policy.weights, np.float64),
            **{name: np.stack([frame[name] for frame in frames]) for name in frames[0]},
        )


@dataclass(frozen=True, eq=False)
class Trace:
    """One trial, step by step: frame 0 is the start, frame ``t`` the world after step ``t``; ``F`` frames.

    Attributes
    ----------
    mission
        Where it happened.
    task, learner
        What was learned, and the compiled rules by which the weights changed.
    seed, trial
        The random key, with the stage.
    success
        How it ended.
    weights
        ``float64 (S, A)``: at the start of the trial.
    robots
        Records ``(F, R)`` of :data:`tasklift.building.layout.ROBOT`: ``alive``, ``node`` (the last), ``half``
        (-1 at a node), ``progress`` (mm), ``dl``, ``alert``, ``row`` (input of the full task), ``pair_row`` and
        ``out`` (row and output of the last decision, in the learned task), ``since`` (1: decided in this step),
        ``team``.
    hostile, resolved
        ``bool (F, N)``: where a hostile stands; which features are resolved.
    failed
        ``bool (F, N)``: where an attack failed in this step.
    unsearched
        ``int64 (F, N)``: steps of search left in each room.
    visited
        ``bool (F, E)``: edges travelled by anyone.
    messages, losses
        ``int64 (F,)``: counted so far.
    """

    mission: Mission
    task: Task
    learner: layout.Learner
    seed: int
    trial: int
    success: bool
    weights: NDArray[np.float64]
    robots: NDArray[Any]
    hostile: NDArray[np.bool_]
    resolved: NDArray[np.bool_]
    failed: NDArray[np.bool_]
    unsearched: NDArray[np.int64]
    visited: NDArray[np.bool_]
    messages: NDArray[np.int64]
    losses: NDArray[np.int64]

    @property
    def steps(self) -> int:
        """Steps that were run."""
        return len(self.robots) - 1


def _frame(lane: layout.Lane) -> dict[str, Any]:
    return {
        "robots": lane.robots.copy(),
        "hostile": lane.sites["hostile"] == 1,
        "resolved": lane.sites["resolved"] == 1,
        "failed": lane.sites["failed"] == lane.count["tick"][0],
        "unsearched": lane.sites["unsearched"].copy(),
        "visited": lane.visited == 1,
        "messages": lane.count["messages"][0],
        "losses": lane.count["losses"][0],
    }


def edge_cost_mm(length_m: NDArray[np.float64], width_m: NDArray[np.float64]) -> NDArray[np.int64]:
    """Return ``int64 (E,)``: length, stretched where narrower than 2 m, in whole millimetres (rule 2)."""
    return np.maximum(1, np.rint(1000.0 * length_m * np.maximum(1.0, 2.0 / width_m))).astype(np.int64)


def search_steps(
    is_room: NDArray[np.bool_], area_m2: NDArray[np.float64], obstacles: NDArray[np.int64], rate_m2: float
) -> NDArray[np.int64]:
    """Return ``int64 (N,)``: steps to search each room, at least 1 there, 0 elsewhere (rule 13)."""
    steps = np.maximum(1, np.ceil(area_m2 / rate_m2).astype(np.int64) + obstacles)
    return np.where(is_room, steps, 0)


def _within_earshot(position_m: NDArray[np.float64], is_feature: NDArray[np.bool_], range_m: float) -> list[list[int]]:
    """For each node, the features within ``range_m`` (straight line), by descending id."""
    from scipy.spatial import cKDTree

    features = np.flatnonzero(is_feature)
    if len(features) == 0:
        return [[] for _ in position_m]
    # the tree proposes with a margin, the plain distance decides: as the oracle computes it
    tree = cKDTree(position_m[features])
    near = []
    for node, found in enumerate(tree.query_ball_point(position_m, range_m * 1.001 + 0.001)):
        within = [int(features[i]) for i in found if math.dist(position_m[node], position_m[features[i]]) <= range_m]
        near.append(sorted(within, reverse=True))
    return near
