"""The seam between people and the kernel: validate, allocate, seed, call, and name what comes back."""

from __future__ import annotations

import math
import sys
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager
from functools import cached_property, lru_cache
from threading import Timer
from typing import Any

import numpy as np
from numpy.typing import NDArray

from tasklift.building import kernel, layout
from tasklift.building.inputs import compiling, kernel_for, numbers_of
from tasklift.building.outcomes import SearchOutcomes, Trace
from tasklift.building.search import hostile_candidates
from tasklift.building.setting import Setting
from tasklift.building.variables import Sensor
from tasklift.checks import LARGEST_WHOLE, number, one_of, whole_number
from tasklift.errors import TaskliftError
from tasklift.learning.chances import SWEEP_STAGE, TARGET_STAGE
from tasklift.learning.reinforcement import Reinforcement
from tasklift.processes import cores
from tasklift.tasks.choice import room_for_sums
from tasklift.tasks.policy import Policy, greedy_share
from tasklift.tasks.task import Task
from tasklift.text import shown

#: The most trials in one call, summed over its runs: their outcomes take about a gigabyte.
LARGEST_CALL = 10_000_000

#: The most robots × steps that a trace keeps (about a gigabyte).
LARGEST_TRACE = 5_000_000

FAILURE, SUCCESS = kernel.FAILURE, kernel.SUCCESS  #: how a trial ends, as :meth:`Simulator.step` returns it
_SPLITS = {"robots": kernel.SPLIT_ROBOTS, "pairs": kernel.SPLIT_PAIRS, "team": kernel.SPLIT_TEAM}
_SHARES = {"none": kernel.SHARE_NONE, "team": kernel.SHARE_TEAM, "radio": kernel.SHARE_RADIO}
_TIME_SIGNALS = {"none": kernel.TIME_NONE, "inverted": kernel.TIME_INVERTED, "baseline": kernel.TIME_BASELINE}
_TABLE = ("steps", "success", "losses", "teams_left", "hostiles_left", "edges_seen", "messages")
_LARGEST_STAGE = 2**31 - 1


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
    mission : Setting
        A :class:`tasklift.building.Mission`, which has been checked.
    """

    def __init__(self, mission: Setting) -> None:
        if not isinstance(mission, Setting):
            raise TaskliftError(f"simulator: expected a Mission, found {shown(mission)}")
        self.mission = mission
        self.world = self._world()
        self.rules = self._rules()

    @cached_property
    def kernel(self) -> Any:
        """The kernel that shows robots this mission's inputs."""
        return kernel_for(self.mission.inputs)

    @cached_property
    def _sizes(self) -> tuple[int, ...]:
        """Robots, nodes, edges, and the inputs and outputs of the mission's task; asked for in every step."""
        mission = self.mission
        return mission.n_robots, len(self.world.nodes), mission.building.n_edges, *mission.task.shape

    def __getstate__(self) -> dict[str, Any]:
        """Leave the kernel out, which pickle cannot keep; it is found again when it is needed."""
        return {name: value for name, value in vars(self).items() if name != "kernel"}

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
        # of each edge, its two half-edges, each of which leads back along the other
        pairs = np.argsort(building.edge_of, kind="stable").reshape(-1, 2)
        back = np.empty(len(building.edge_of), np.int64)
        back[pairs] = pairs[:, ::-1]
        halves = _records(
            layout.HALF,
            to=building.neighbour,
            edge=building.edge_of,
            back=back,
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
            near=np.array([f for features in near for f in features], np.uint32),
            search=search_steps(building.kind == 0, building.area_m2, building.obstacles, reading.search_rate_m2),
            candidates=np.array(candidates, np.uint32),
            members=members,
            numbers=np.array(numbers_of(self.mission.inputs, list(self.mission.team)), np.float64),
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
            split=_SPLITS[reading.split],
            turn_back=int(reading.turn_back),
            unvisited_first=int(reading.explore == "unvisited-first"),
            sharpness=float(reading.goal_sharpness),
            engage_crossing=int(reading.engage == "crossing"),
            suspicion_goal=int(reading.suspicion_goal),
            share_map=_SHARES[reading.share_map],
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
        self._check_task(task)
        if not isinstance(reinforcement, Reinforcement):
            raise TaskliftError(f"simulator: expected a Reinforcement, found {shown(reinforcement)}")
        for name, value in {"sweep": sweep, "learn": learn}.items():
            one_of(value, (False, True), name)
        return _compiled(task, reinforcement, sweep, learn)

    def _check_task(self, task: object) -> None:
        if not isinstance(task, Task):
            raise TaskliftError(f"simulator: expected a Task, found {shown(task)}")
        if task.root != self.mission.task:
            raise TaskliftError(
                f"task {task.name!r} is not a simplification of this mission's task {self.mission.task.name!r}; "
                "start from `mission.task`"
            )

    def lane(self, shape: tuple[int, int]) -> layout.Lane:
        """Allocate one simulation, for a table of weights of this shape (S, A)."""
        if not isinstance(shape, tuple) or len(shape) != 2:
            raise TaskliftError(f"lane: expected the shape (inputs, outputs) of a table, found {shown(shape)}")
        for size, most in zip(shape, self.mission.task.shape, strict=True):
            whole_number(size, "lane, shape", 1, most)
        n_robots, n_nodes = self.mission.n_robots, len(self.world.nodes)
        n_edges = self.mission.building.n_edges
        words = (n_edges + 63) // 64
        degree = int((self.world.nodes["last"] - self.world.nodes["first"]).max())
        n_halves = len(self.world.halves)
        return layout.Lane(
            robots=np.zeros(n_robots, layout.ROBOT),
            given=np.full(n_robots, -1, np.int64),
            roster=np.zeros(n_robots, np.uint32),
            agenda=np.zeros((n_robots + 63) // 64 * layout.AGENDA * 2, np.uint64),
            awake=np.zeros(n_robots, np.uint32),
            sites=np.zeros(n_nodes, layout.SITE),
            places=np.zeros(n_nodes + n_halves, layout.PLACE),
            touched=np.zeros(n_nodes + n_halves, np.uint32),
            unsettled=np.zeros(n_robots, np.uint32),
            rooms=np.zeros(n_nodes, np.uint32),
            picks=np.zeros(n_halves, np.uint32),
            open=np.zeros(degree, np.uint32),
            share=np.zeros(degree),
            visited=np.zeros(n_edges, np.uint8),
            maps=np.zeros((n_robots, words), np.uint64),
            pooled=np.zeros((n_robots, words), np.uint64),
            teams=np.zeros(n_robots, layout.TEAM),
            slots=np.zeros(1 << (2 * n_robots - 1).bit_length(), layout.SLOT),
            classes=np.zeros((layout.CLASSES, 2), np.int64),
            used=np.zeros((shape[0], (shape[1] + 63) // 64), np.uint64),
            shuffle=np.zeros(len(self.world.candidates), np.uint32),
            count=np.zeros(1, layout.COUNT),
            weights=np.zeros(shape),
            sums=np.full((shape[0], room_for_sums(shape[1])), np.inf),
            stale=np.zeros(shape[0], np.int64),
        )

    def keys(self, seed: int, stage: int) -> tuple[np.uint64, np.uint64]:
        """Return the random keys of a stage and of the hostiles' places.

        Raises
        ------
        TaskliftError
            For a seed outside 0 to 2^63 - 1 or a stage outside 0 to 2^31 - 1.
        """
        whole_number(seed, "seed")
        whole_number(stage, "stage", 0, _LARGEST_STAGE)
        stage_key, place_key = kernel.keys(int(seed), self.mission.building.map_id, int(stage))
        return np.uint64(stage_key), np.uint64(place_key)

    def begin_trial(self, lane: layout.Lane, seed: int, stage: int, trial: int) -> None:
        """Set a lane to the start of one trial; :meth:`step` takes it from there."""
        self._check_lane(lane)
        whole_number(trial, "trial")
        stage_key, place_key = self.keys(seed, stage)
        kernel.begin_trial(self.world, self.rules, lane, np.uint64(kernel.child_key(stage_key, int(trial))), place_key)

    def step(self, learner: layout.Learner, lane: layout.Lane) -> int:
        """Run one step; return the kernel's ``GOES_ON``, ``SUCCESS``, ``FAILURE`` or ``OUTSIDE``."""
        self._check(learner, lane)
        with _patience(self.kernel.step, self.mission.inputs):
            return int(self.kernel.step(self.world, self.rules, learner, lane))

    def _check(self, learner: object, lane: Any) -> None:
        self._check_lane(lane)
        self._check_learner(learner, lane.weights.shape)

    def _check_learner(self, learner: object, shape: tuple[int, ...]) -> None:
        if not isinstance(learner, layout.Learner) or learner.signal.shape != shape:
            raise TaskliftError("step: expected the learner of a task whose table has the shape of the lane's weights")
        if len(learner.rows) != self._sizes[3]:
            raise TaskliftError("step: expected a learner that this simulator's `learner` compiled")

    def _check_steered(self, steered: object) -> int:
        """Return the number of simulations, or refuse what :meth:`steered` of such a simulator did not allocate."""
        if not isinstance(steered, layout.Steered) or self._sizes != (
            steered.rows.shape[1],
            steered.lanes.sites.shape[1],
            steered.lanes.visited.shape[1],
            *steered.lanes.weights.shape[1:],
        ):
            raise TaskliftError("simulator: expected what this simulator's `steered` allocated")
        return len(steered.state)

    def _check_lane(self, lane: object) -> None:
        """Refuse what was not allocated by :meth:`lane` of a simulator of these sizes."""
        sizes = self._sizes[:3]
        if not isinstance(lane, layout.Lane) or (len(lane.robots), len(lane.sites), len(lane.visited)) != sizes:
            raise TaskliftError("simulator: expected a lane that this simulator's `lane` allocated")
        if lane.sums.shape != (lane.weights.shape[0], room_for_sums(lane.weights.shape[1])):
            raise TaskliftError("simulator: the lane's weights have another shape than it was allocated for")

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
        """Run trials on one lane; ``weights`` (S, A) learn in place. See :class:`.Trials`.

        Raises
        ------
        TaskliftError
            For a task of another world, weights that are not a C-ordered float64 table of the task, and numbers out
            of range; and if the world shows an input that the task leaves out.

        Examples
        --------
        >>> import numpy as np, tasklift as tl
        >>> from tasklift.building import Mission, generate
        >>> hunt = Mission(generate(seed=7), team="10+5")
        >>> weights = np.full(hunt.task.shape, 1.5)
        >>> out = hunt.simulator.run(hunt.task, weights, trials=3, seed=0, stage=2, reinforcement=tl.Reinforcement())
        >>> out.steps.shape, out.robots_left.shape
        ((3,), (3, 2))
        """
        if not isinstance(task, Task) or not isinstance(weights, np.ndarray) or weights.shape != task.shape:
            self._check_task(task)
            raise TaskliftError(f"weights: expected an array of shape {task.shape}, found {_described(weights)}")
        together = self.run_many(
            task, weights[None], trials=trials, seeds=[seed], stage=stage, reinforcement=reinforcement,
            outputs=outputs, first_trial=first_trial, learn=learn, max_losses=max_losses, threads=1,
        )  # fmt: skip
        return together.of_run(0)

    def run_many(
        self,
        task: Task,
        weights: NDArray[np.float64],
        *,
        trials: int,
        seeds: Sequence[int] | NDArray[np.int64],
        stage: int,
        reinforcement: Reinforcement,
        outputs: NDArray[np.int64] | None = None,
        first_trial: int = 0,
        learn: bool = True,
        max_losses: int | None = None,
        threads: int | None = None,
    ) -> SearchOutcomes:
        """Run trials of many policies in one call, each as :meth:`run` alone would.

        Parameters
        ----------
        task : Task
            The mission's task, or a simplification of it.
        weights : float64 (P, S, A), C-ordered
            A table for each run. They learn in place.
        trials : int
            Number of trials of each run.
        seeds : sequence of int, (P,)
            The seed of each run. Runs with equal seeds share their random numbers: they are paired.
        stage, first_trial : int
            The rest of the random key.
        reinforcement : Reinforcement
            The learner's rules.
        outputs : int64 (trials,), optional
            The one output of each trial, as in the sweep.
        learn : bool
            False: the weights stay as they are.
        max_losses : int, optional
            No trial of a run begins once it has lost this many robots. Needs a single run.
        threads : int, optional
            Number of threads; all cores by default. The result is the same on any number.

        Returns
        -------
        SearchOutcomes
            Arrays (P, trials).

        Raises
        ------
        TaskliftError
            As :meth:`run`.
        """
        learner = self.learner(task, reinforcement, sweep=outputs is not None, learn=learn)
        _check_tables(task, weights, negative=learner.greedy == 1.0 and not learn)
        n_runs = len(weights)
        whole_number(trials, "trials", 0, LARGEST_CALL // max(n_runs, 1))
        whole_number(first_trial, "first_trial", 0, LARGEST_WHOLE - LARGEST_CALL)
        if max_losses is not None:
            whole_number(max_losses, "max_losses")
            if n_runs != 1:
                raise TaskliftError(f"max_losses: expected a single run, found {n_runs}; cap them one by one")
        if not isinstance(seeds, list | tuple | np.ndarray) or not np.iterable(seeds) or len(seeds) != n_runs:
            raise TaskliftError(f"seeds: expected one for each of {n_runs} tables of weights, found {shown(seeds)}")
        numbers = [whole_number(seed, "seed") for seed in seeds]
        keys_of = {number: self.keys(number, stage) for number in dict.fromkeys(numbers)}
        keys = np.array([keys_of[number] for number in numbers], np.uint64).reshape(n_runs, 2)
        fixed = _checked_outputs(task, outputs, trials)
        # a run that learns goes from trial to trial; one that does not may be cut anywhere
        block = trials if learn or max_losses is not None else max(1, min(trials, n_runs * trials // 64))
        table = np.zeros((n_runs, trials, len(_TABLE)), np.int64)
        left = np.zeros((n_runs, trials, len(self.mission.team)), np.int64)
        jobs = _blocks(n_runs, trials, block)
        done, taken = np.zeros((len(jobs), 2), np.int64), np.zeros(1, np.int64)

        def work() -> None:
            self.kernel.run(
                self.world, self.rules, learner, self.lane(task.shape), keys, first_trial, fixed,
                -1 if max_losses is None else max_losses, weights, jobs, taken, table, left, done,
            )  # fmt: skip

        with _patience(self.kernel.run, self.mission.inputs):
            _share_out(work, taken, len(jobs), threads)
        outside = done[:, 1].nonzero()[0]
        if len(outside):
            self._refuse_input(task, int(done[outside[0], 1]) - 1)
        n_done = int(done[0, 0]) if max_losses is not None else trials
        column = {name: np.ascontiguousarray(table[:, :n_done, i]) for i, name in enumerate(_TABLE)}
        return SearchOutcomes(
            steps=column["steps"],
            success=column["success"].astype(bool),
            losses=column["losses"],
            limit=self.mission.limit,
            robots_left=left[:, :n_done],
            teams_left=column["teams_left"],
            hostiles_left=column["hostiles_left"],
            explored=column["edges_seen"] / self.mission.building.n_edges,
            messages=column["messages"],
        )

    def steered(
        self,
        n: int,
        *,
        progress_reward: float,
        loss_reward: float,
        success_reward: float,
        signal_weight: float,
        team_share: float,
    ) -> layout.Steered:
        """Allocate ``n`` simulations side by side, whose robots are steered from outside.

        The mission's reading must have ``decide="robot"``. With ``patience=1`` everyone decides in every step.

        Parameters
        ----------
        n
            Number of simulations.
        progress_reward, loss_reward, success_reward, signal_weight, team_share
            What a step is rewarded with: see :class:`tasklift.envs.batch.Rewards`.

        Raises
        ------
        TaskliftError
            For numbers out of range.
        """
        whole_number(n, "steered, n", 1, 1_000_000)
        one = self.lane(self.mission.task.shape)
        # zeros cost no memory until they are written to; `given` is written first, and `sums` is for drawn outputs only
        lanes = layout.Lane(*(np.zeros((n, *array.shape), array.dtype) for array in one))
        robots = (n, self.mission.n_robots)
        return layout.Steered(
            lanes=lanes,
            keys=np.zeros((n, 2), np.uint64),
            trials=np.full(n, -1, np.int64),
            pay=_records(
                layout.PAY,
                progress=[number(progress_reward, "progress_reward")],
                loss=[number(loss_reward, "loss_reward")],
                success=[number(success_reward, "success_reward")],
                signal=[number(signal_weight, "signal_weight")],
                team_share=[number(team_share, "team_share", 0, 1)],
            ),
            outputs=np.zeros(robots, np.int64),
            state=np.full(n, FAILURE, np.int64),
            rows=np.zeros(robots, np.int64),
            alive=np.zeros(robots, np.uint8),
            decides=np.zeros(robots, np.uint8),
            lost=np.zeros(robots, np.uint8),
            rewards=np.zeros(robots),
        )

    def seed_steered(self, steered: layout.Steered, seeds: Sequence[int], stage: int) -> None:
        """Give every simulation a random key; its next trial is number 0.

        Raises
        ------
        TaskliftError
            For simulations of another simulator, or seeds that are not one whole number for each.
        """
        n = self._check_steered(steered)
        if not isinstance(seeds, list | tuple) or len(seeds) != n:
            raise TaskliftError(f"seeds: expected one for each of {n} simulations, found {shown(seeds)}")
        steered.keys[:] = [self.keys(seed, stage) for seed in seeds]
        steered.trials[:] = -1

    def begin_steered(self, steered: layout.Steered, which: NDArray[np.int64]) -> None:
        """Begin the next trial of the simulations with the numbers ``which``, int64 (k,).

        Raises
        ------
        TaskliftError
            For simulations of another simulator, or numbers that they do not have.
        """
        n = self._check_steered(steered)
        if not isinstance(which, np.ndarray) or which.dtype != np.int64 or which.ndim != 1:
            raise TaskliftError(f"begin: expected the numbers of simulations, found {_described(which)}")
        if len(which) and not 0 <= which.min() <= which.max() < n:
            raise TaskliftError(f"begin: expected numbers from 0 to {n - 1}, found {shown(which)}")
        with _patience(self.kernel.begin_many, self.mission.inputs):
            self.kernel.begin_many(self.world, self.rules, steered, which)

    def step_steered(self, learner: layout.Learner, steered: layout.Steered) -> None:
        """Step every simulation that goes on until a robot decides or is lost; who decided takes ``steered.outputs``.

        The learner is compiled for the mission's whole task, and does not learn.

        Raises
        ------
        TaskliftError
            For simulations or a learner of another simulator, and output numbers that the task does not have.
        """
        self._check_steered(steered)
        self._check_learner(learner, self._sizes[3:])
        last = len(learner.outputs) - 1
        if steered.outputs.view(np.uint64).max() > last:  # a negative number is a large one there
            raise TaskliftError(f"step: expected output numbers from 0 to {last}, found {shown(steered.outputs)}")
        with _patience(self.kernel.step_many, self.mission.inputs):
            self.kernel.step_many(self.world, self.rules, learner, steered)

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
        if not isinstance(policy, Policy):
            raise TaskliftError(f"trace: expected a policy, found {shown(policy)}")
        if output is not None:
            whole_number(output, "output", 0, policy.task.shape[1] - 1)
        rules = Reinforcement() if reinforcement is None else reinforcement
        whole_number(stage, "stage", 0, _LARGEST_STAGE)
        stage = SWEEP_STAGE if output is not None and stage == TARGET_STAGE else stage
        learner = self.learner(policy.task, rules, sweep=output is not None, learn=learn)
        lane = self.lane(policy.task.shape)
        lane.weights[:] = policy.weights
        self.begin_trial(lane, seed, stage, trial)
        lane.given[:] = -1 if output is None else output
        frames = [_frame(lane)]
        state = kernel.GOES_ON
        while state == kernel.GOES_ON:
            state = self.step(learner, lane)
            if state == kernel.OUTSIDE:
                self._refuse_input(policy.task, int(lane.count["outside"][0]) - 1)
            frames.append(_frame(lane))
            if len(frames) * self.mission.n_robots > LARGEST_TRACE:
                raise TaskliftError(
                    f"trace: {len(frames):,} steps of {self.mission.n_robots:,} robots are more than memory is meant "
                    "for; lower the mission's limit"
                )
        return Trace(
            mission=self.mission,
            task=policy.task,
            learner=learner,
            seed=seed,
            trial=trial,
            success=state == kernel.SUCCESS,
            weights=np.array(policy.weights, np.float64),
            **{name: np.stack([frame[name] for frame in frames]) for name in frames[0]},
        )


#: A robot's record in a trace: with how far it has come along its corridor, and the steps since its last decision.
_SEEN = np.dtype([(name, "i8") for name in (*(layout.ROBOT.names or ()), "progress", "since")])


def progress_mm(robots: NDArray[Any], tick: NDArray[np.int64] | int) -> NDArray[np.int64]:
    """Return how far robots have come along their corridors at a tick: the kernel keeps it only where it needs it."""
    return np.where(robots["half"] < 0, 0, robots["passed"] + robots["pace"] * (tick - robots["planned"]))


def _frame(lane: layout.Lane) -> dict[str, Any]:
    robots = np.zeros(len(lane.robots), _SEEN)
    for name in layout.ROBOT.names or ():
        robots[name] = lane.robots[name]
    robots["row"] = robots["seen"]
    now = lane.count["tick"][0]
    robots["progress"] = progress_mm(lane.robots, now)
    robots["since"] = np.where(robots["alive"] == 1, now + 1, robots["entered"]) - robots["decided"]
    return {
        "robots": robots,
        "hostile": lane.sites["hostile"] == 1,
        "resolved": lane.sites["resolved"] == 1,
        "failed": lane.sites["failed"] == now,
        "unsearched": lane.sites["unsearched"].copy(),
        "visited": lane.visited == 1,
        "messages": lane.count["messages"][0],
        "losses": lane.count["losses"][0],
    }


@lru_cache(maxsize=64)
def _compiled(task: Task, reinforcement: Reinforcement, sweep: bool, learn: bool) -> layout.Learner:
    root = task.root
    values = [root.output_values(int(index)) for index in task.output_map]
    outputs = _records(
        layout.OUTPUT,
        way=[(kernel.GOES_BACK if v.get("BACK") else kernel.GOES) if v["MV"] else kernel.STAYS for v in values],
        wpn=[v["WPN"] for v in values],
        ca=[v["CA"] for v in values],
    )
    sweep_all = sweep and reinforcement.sweep_credit == "all"
    return layout.Learner(
        rows=np.ascontiguousarray(task.input_map, np.int64),
        outputs=outputs,
        signal=np.ascontiguousarray(task.signal_table(impossible=not sweep_all), np.float64),
        learn=int(learn),
        at_once=int(learn and not sweep_all),
        sweep_all=int(sweep_all),
        greedy=greedy_share(reinforcement.selection, reinforcement.q),
        floor=float(reinforcement.floor),
        once=int(reinforcement.credit == "trial"),
        time_signal=kernel.TIME_INVERTED if sweep else _TIME_SIGNALS[reinforcement.time_signal],
        time_reward=float(task.time_reward),
        loss_signal=float(reinforcement.loss_signal),
    )


@contextmanager
def _patience(entry: Any, sensors: tuple[Sensor, ...]) -> Iterator[None]:
    """Say on a terminal that the kernel is being compiled, where the first call takes longer than reading the cache.

    A sensor that cannot be compiled is an error of one line.
    """
    if entry.overloads:
        yield
        return
    note = "tasklift: compiling the simulator for this machine, once; this can take half a minute"
    timer = Timer(2.0, print, [note], {"file": sys.stderr})
    if sys.stderr.isatty():
        timer.start()
    try:
        with compiling(sensors):
            yield
    finally:
        timer.cancel()


def _share_out(work: Callable[[], None], taken: NDArray[np.int64], n_jobs: int, threads: int | None) -> None:
    """Call ``work`` on several threads, which share the jobs; an interrupt leaves those that nobody has taken."""
    if threads is None:
        threads = cores()
    whole_number(threads, "threads", 1, 4096)
    threads = min(threads, n_jobs)
    if threads <= 1:
        work()
        return
    with ThreadPoolExecutor(threads) as pool:
        try:
            for future in [pool.submit(work) for _ in range(threads)]:
                future.result()
        finally:
            taken[0] = n_jobs


def _blocks(n_runs: int, trials: int, block: int) -> NDArray[np.int64]:
    """Return ``int64 (J, 3)``: run, first trial and the trial after the last, of every block of every run."""
    first = np.arange(0, trials, max(block, 1))
    run, start = np.repeat(np.arange(n_runs), len(first)), np.tile(first, n_runs)
    return np.column_stack([run, start, np.minimum(start + block, trials)]).astype(np.int64)


def _described(array: object) -> str:
    return f"{array.dtype} {array.shape}" if isinstance(array, np.ndarray) else shown(array)


def _check_tables(task: Task, weights: object, negative: bool) -> None:
    """Refuse what is not a C-ordered float64 (P, S, A) of numbers that can be drawn by weight."""
    good = isinstance(weights, np.ndarray) and weights.dtype == np.float64 and weights.flags.c_contiguous
    if not good or weights.shape[1:] != task.shape or weights.ndim != 3:  # type: ignore[attr-defined]
        raise TaskliftError(
            f"weights: expected a C-ordered float64 array of shape {task.shape} for task {task.name!r}, "
            f"found {_described(weights)}"
        )
    if not weights.flags.writeable or not weights.flags.aligned:  # type: ignore[attr-defined]
        raise TaskliftError("weights: expected an array that can be written to; pass a copy")
    if not weights.size:  # type: ignore[attr-defined]
        raise TaskliftError("weights: expected at least one table, found none")
    least, most = float(weights.min()), float(weights.max())  # type: ignore[attr-defined]
    if not (math.isfinite(least) and math.isfinite(most)) or (least < 0 and not negative):
        raise TaskliftError(f"weights: expected finite numbers of at least 0, found {least} to {most}")


def _checked_outputs(task: Task, outputs: object, trials: int) -> NDArray[np.int64]:
    """Return the one output of each trial, int64 (trials,): -1 where it is drawn."""
    if outputs is None:
        return np.full(trials, -1, np.int64)
    found = np.asarray(outputs)
    whole = found.shape == (trials,) and (found.dtype.kind in "iu" or trials == 0)
    if not whole or ((found < 0) | (found >= task.shape[1])).any():
        raise TaskliftError(
            f"outputs: expected {trials} output numbers from 0 to {task.shape[1] - 1}, one per trial"
        )
    return np.ascontiguousarray(found, np.int64)


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
