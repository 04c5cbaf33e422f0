"""Building searches side by side, steered from outside: what the environments of the search share.

Shapes: ``n`` missions, ``R`` robots each, ``F`` features of an observation.
"""

from __future__ import annotations

from dataclasses import asdict, dataclass, fields
from typing import Any, Literal, get_args

import numpy as np
from numpy.typing import NDArray

from tasklift.building.mission import Mission
from tasklift.building.simulator import FAILURE, SUCCESS
from tasklift.checks import one_of, whole_number
from tasklift.errors import TaskliftError
from tasklift.learning.chances import TARGET_STAGE
from tasklift.learning.reinforcement import Reinforcement

Observe = Literal["values", "onehot", "local"]
Act = Literal["values", "flat"]

#: Corridors at its node that a local observation has room for; a node with more shows the first ones.
CORRIDORS = 8
#: What a step that comes too late or too early is answered with.
OVER = "step: the episode (trial) is over, or has not begun; call reset() before"


@dataclass(frozen=True)
class Rewards:
    """What a robot is rewarded for in a step.

    Parameters
    ----------
    progress_reward
        To all who live, shared out over the mission's work: every edge that somebody is the first to travel, room that
        is searched and hostile that is destroyed gives an equal part.
    loss_reward
        To a robot that takes part in a failed attack.
    success_reward
        To all who are left at the end of a success, × (1 − steps / (2 × limit)).
    signal_weight
        Weight of the task's local signals (Table III), at every decision. They are rules of thumb for reinforcement of
        weights: with weight 1 they outweigh all the rest, and a team that stands at doors earns most.
    team_share
        Part of every reward that goes to all robots of the mission in equal parts, lost ones too (0 to 1). With 1, a
        robot is rewarded for what it does for the team: a scout that is lost at a door shows where the hostile is.
    """

    progress_reward: float = 0.5
    loss_reward: float = -1.5
    success_reward: float = 2.0
    signal_weight: float = 0.0
    team_share: float = 0.0

    @classmethod
    def of(cls, settings: dict[str, Any]) -> Rewards:
        """Return the rewards with these settings, or refuse an unknown one."""
        names = [field.name for field in fields(cls)]
        for name in settings:
            if name not in names:
                raise TaskliftError(f"environment: unknown option {name!r}; rewards are set by {', '.join(names)}")
        return cls(**settings)


class Batch:
    """Missions of one kind, stepped together by the compiled kernel.

    Parameters
    ----------
    mission
        Where, who, and the world's rules; ``decide`` and ``patience`` of its reading do not matter here.
    n
        How many.
    rewards
        What is rewarded.
    patience
        A robot decides when its input changes, and after this many steps without a decision (steps, at least 1).

    Attributes
    ----------
    rows : int64 (n, R)
        The robots' inputs; a lost robot keeps the last that it saw.
    alive, decides, lost : uint8 (n, R)
        Who lives, who decides next, and who took part in a failed attack in the last step.
    rewards : float64 (n, R)
        Of the last step.
    state : int64 (n,)
        How each mission ended: 0 if it goes on, ``SUCCESS`` or ``FAILURE``.
    """

    def __init__(self, mission: Mission, n: int, rewards: Rewards, patience: int) -> None:
        if not isinstance(mission, Mission):
            raise TaskliftError(f"environment: expected a Mission, found {mission!r}")
        self.mission = mission.with_reading(decide="robot", patience=patience)
        self._simulator = self.mission.simulator
        self._learner = self._simulator.learner(mission.task, Reinforcement(), learn=False)
        self._steered = self._simulator.steered(n, **asdict(rewards))
        self.rows, self.alive, self.lost = self._steered.rows, self._steered.alive, self._steered.lost
        self.rewards, self.state, self.lanes = self._steered.rewards, self._steered.state, self._steered.lanes
        self.decides = self._steered.decides
        self.begun = False

    def seed(self, seed: int | None) -> None:
        """Give every mission a seed of its own, which comes of this one; a single mission has this one itself."""
        n = len(self.state)
        if seed is not None:
            whole_number(seed, "seed")
        if seed is not None and n == 1:
            seeds = [seed]
        else:
            seeds = (np.random.SeedSequence(seed).generate_state(n, np.uint64) >> np.uint64(2)).tolist()
        self._simulator.seed_steered(self._steered, seeds, TARGET_STAGE)

    def begin(self, which: NDArray[np.int64] | None = None) -> None:
        """Begin the next episode (trial) of the missions with these numbers, of all by default."""
        self.begun = True
        self._simulator.begin_steered(self._steered, np.arange(len(self.state)) if which is None else which)

    def step(self, outputs: NDArray[np.int64]) -> None:
        """Step every mission that goes on until somebody decides or is lost; ``outputs`` int64 (n, R).

        Who does not decide keeps its output: what is given for it is not looked at.
        """
        self._steered.outputs[:] = outputs
        self._simulator.step_steered(self._learner, self._steered)

    @property
    def cut(self) -> NDArray[np.bool_]:
        """Who lives at the step limit of a mission that did not succeed, bool (n, R)."""
        return (self.alive == 1) & (self.state == FAILURE)[:, None]

    @property
    def succeeded(self) -> NDArray[np.bool_]:
        """Which missions have just succeeded, bool (n,)."""
        return self.state == SUCCESS


class Observations:
    """How observations look: the task's inputs as values, as one-hot vectors, or with what is nearby beside.

    Parameters
    ----------
    mission
        Whose task and building are seen.
    kind
        ``"values"``: the positions of the input variables, int64. ``"onehot"``: float32, one number for each value.
        ``"local"``: that, and what a robot knows beside, as numbers from 0 to 1: its number r of R, as r / R; whether
        it is armed; the share of the limit that has passed; whether it is at a node, and for how many steps n, as
        n / (n + 20); how many robots, and how many armed ones, are in its team, as shares of all; of each of up to
        eight corridors at its node, whether it exists, whether the robot has it in its map, and whether it came by it;
        whether it is at the feature that it was alerted of; and last, whether it decides now.
    """

    def __init__(self, mission: Mission, kind: Observe) -> None:
        one_of(kind, get_args(Observe), "observe")
        self.kind = kind
        self.sizes = [len(v) for v in mission.task.inputs]
        table = mission.task.input_positions(range(mission.task.shape[0]))
        if kind != "values":
            table = np.hstack([np.eye(n, dtype=np.float32)[table[:, i]] for i, n in enumerate(self.sizes)])
        self._table = np.vstack([table, np.zeros_like(table[:1])])  # the last row is what the lost see
        self.size = self._table.shape[1] + (9 + 3 * CORRIDORS if kind == "local" else 0)
        self._armed = mission.simulator.world.members["armed"]
        self._limit = mission.limit
        first, last = mission.building.indptr[:-1], mission.building.indptr[1:]
        self._half = first[:, None] + np.arange(CORRIDORS)
        self._exists = self._half < last[:, None]
        self._edge = mission.building.edge_of[np.where(self._exists, self._half, 0)].astype(np.int64)

    def space(self, copies: int = 1) -> Any:
        """Return the Gymnasium space of one robot's observation, or of several robots' in a row."""
        from gymnasium.spaces import Box, MultiDiscrete

        if self.kind == "values":
            return MultiDiscrete(self.sizes * copies)
        return Box(0.0, 1.0, (self.size * copies,), np.float32)

    def of(self, batch: Batch) -> NDArray[Any]:
        """Return what the robots see, int64 or float32 (n, R, F); zeros for the lost."""
        inputs = self._table.take(np.where(batch.alive, batch.rows, len(self._table) - 1), axis=0)
        if self.kind != "local":
            return inputs
        seen = np.empty((*batch.rows.shape, self.size), np.float32)
        width = inputs.shape[2]
        seen[..., :width] = inputs
        self._look_around(batch, seen[..., width:])
        seen[batch.alive == 0] = 0.0
        return seen

    def _look_around(self, batch: Batch, seen: NDArray[np.float32]) -> None:
        """Fill in what is nearby, float32 (n, R, 9 + 3 × CORRIDORS)."""
        robots, step = batch.lanes.robots, batch.lanes.count["step"]
        node, at_node, n_robots = robots["node"].astype(np.int64), robots["half"] < 0, robots.shape[1]
        steps = at_node * (step - robots["arrived"])
        teams, team = batch.lanes.teams, robots["team"].astype(np.int64)
        seen[..., 0] = np.arange(n_robots) / n_robots
        seen[..., 1] = self._armed
        seen[..., 2] = step / self._limit
        seen[..., 3] = at_node
        seen[..., 4] = steps / (steps + 20)
        seen[..., 5] = np.take_along_axis(teams["size"], team, axis=1) / n_robots
        seen[..., 6] = np.take_along_axis(teams["armed"], team, axis=1) / n_robots
        edge = self._edge[node]
        words = np.take_along_axis(batch.lanes.maps, edge >> 6, axis=2)
        known = (words >> (edge & 63).astype(np.uint64)) & np.uint64(1) == 1
        here = self._exists[node] & at_node[..., None]
        came = self._half[node] == robots["came"][..., None]
        for k, flags in enumerate((here, here & known, here & came)):
            seen[..., 7 + k * CORRIDORS : 7 + (k + 1) * CORRIDORS] = flags
        seen[..., -2] = at_node & (robots["alert"] == node)
        seen[..., -1] = batch.decides


class Actions:
    """How actions look: the positions of the task's outputs, or one number.

    Parameters
    ----------
    mission
        Whose task's outputs are chosen.
    kind
        ``"values"``: ``MultiDiscrete``. ``"flat"``: ``Discrete``, the number of the output.
    """

    def __init__(self, mission: Mission, kind: Act) -> None:
        one_of(kind, get_args(Act), "act")
        self.kind = kind
        self.sizes = [len(v) for v in mission.task.outputs] if kind == "values" else [mission.task.shape[1]]
        self._strides = np.cumprod([1, *self.sizes[:0:-1]])[::-1].astype(np.int64)

    def space(self) -> Any:
        """Return the Gymnasium space of one robot's action."""
        from gymnasium.spaces import Discrete

        return self.space_of(1) if self.kind == "values" else Discrete(self.sizes[0])

    def space_of(self, robots: int) -> Any:
        """Return the Gymnasium space of several robots' actions in a row."""
        from gymnasium.spaces import MultiDiscrete

        return MultiDiscrete(self.sizes * robots)

    def number(self, action: Any, who: str) -> int:
        """Return the number of one robot's action, or refuse what is not an action."""
        if type(action) is int and self.kind == "flat" and 0 <= action < self.sizes[0]:  # what is usual is fast
            return action
        plain = action.tolist() if isinstance(action, np.ndarray | np.generic) else action
        parts = (plain,) if self.kind == "flat" else plain
        fits = isinstance(parts, list | tuple) and len(parts) == len(self.sizes)
        if not fits or not all(_is_below(part, size) for part, size in zip(parts, self.sizes, strict=True)):
            raise TaskliftError(f"step: expected an action of {self.space()} for {who!r}, found {action!r}")
        index = 0
        for part, size in zip(parts, self.sizes, strict=True):
            index = index * size + int(part)
        return index

    def numbers(self, actions: Any, space: Any, shape: tuple[int, ...]) -> NDArray[np.int64]:
        """Return the numbers of many robots' actions, int64 of ``shape``, or refuse what is not in the space."""
        try:
            found = np.asarray(actions)
        except ValueError:  # rows of different lengths
            found = np.empty(0)
        if found.shape != space.shape or found.dtype.kind not in "iu":
            raise TaskliftError(
                f"step: expected whole numbers of shape {space.shape}, actions of {space}, "
                f"found {found.dtype} {found.shape}"
            )
        parts = found.reshape(*shape, len(self.sizes))
        for i, size in enumerate(self.sizes):
            least, most = parts[..., i].min(), parts[..., i].max()
            if least < 0 or most >= size:
                raise TaskliftError(
                    f"step: expected actions of {self.space()}, found numbers from {least} to {most}, "
                    f"where {size} values are possible"
                )
        return parts[..., 0] if len(self.sizes) == 1 else parts @ self._strides


def _is_below(value: Any, size: int) -> bool:
    return isinstance(value, int | np.integer) and not isinstance(value, bool) and 0 <= int(value) < size
