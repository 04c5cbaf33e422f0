"""The building search as a PettingZoo ``ParallelEnv``: every robot an agent, for other people's learners.

Needs the extra ``gym`` (``pip install "tasklift[gym]"``). The world is the simulator's kernel; only the decisions come
from outside. Every robot decides at every step, which is the simulator under ``patience=1``.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from tasklift.building import Mission
from tasklift.building.simulator import Simulator
from tasklift.errors import TaskliftError
from tasklift.learning.reinforcement import TARGET_STAGE, Reinforcement

try:
    from gymnasium.spaces import MultiDiscrete
    from pettingzoo import ParallelEnv
except ImportError as error:
    raise TaskliftError('needs PettingZoo; type: pip install "tasklift[gym]"') from error

Observations = dict[str, NDArray[np.int64]]


class SearchEnv(ParallelEnv):
    """A mission whose robots are told what to do from outside.

    Agents are called after their kind and number (``"scout_0"``, … ``"weapon_10"``), in the simulator's order. An
    observation has the positions of DL, GL, nWPN and FTR (``MultiDiscrete([3, 2, 3, 5])``), an action those of MV,
    WPN and CA (``MultiDiscrete([2, 2, 11])``).

    Parameters
    ----------
    mission
        Where, who, and the world's rules; ``decide`` and ``patience`` of its reading do not matter here.
    loss_reward
        For a robot that takes part in a failed attack.
    success_reward
        At the end of a successful trial, everyone who is left gets this × (1 − steps / limit).

    Notes
    -----
    In each step a robot's reward also has the task's local signal for its input and output (Table III). A robot
    that is destroyed terminates; at the step limit the rest is truncated. ``reset(seed=…)`` starts trial 0 of that
    seed, which also hides the hostiles; ``reset()`` goes on to the next trial.
    """

    metadata = {"name": "tasklift_search_v0", "render_modes": [], "is_parallelizable": True}  # noqa: RUF012
    render_mode = None

    def __init__(self, mission: Mission, *, loss_reward: float = -1.0, success_reward: float = 1.0) -> None:
        self.mission = mission.with_reading(decide="robot", patience=2**31)
        self.loss_reward, self.success_reward = loss_reward, success_reward
        self.task = mission.task
        kinds = [kind.name for kind, number in mission.team.items() for _ in range(number)]
        self.possible_agents = [f"{kind}_{r}" for r, kind in enumerate(kinds)]
        self.agents: list[str] = []
        self._numbers = {agent: r for r, agent in enumerate(self.possible_agents)}
        self._sizes = [len(v) for v in self.task.inputs], [len(v) for v in self.task.outputs]
        self._observations = {a: MultiDiscrete(self._sizes[0]) for a in self.possible_agents}
        self._actions = {a: MultiDiscrete(self._sizes[1]) for a in self.possible_agents}
        self._signals = self.task.signal_table()
        self._simulator = Simulator(self.mission)
        self._learner = self._simulator.learner(self.task, Reinforcement(), learn=False)
        self._lane = self._simulator.lane(np.ones(self.task.shape))
        self._seed, self._trial = 0, -1

    def observation_space(self, agent: str) -> Any:
        """Return the space of an agent's observations; always the same object."""
        return self._observations[agent]

    def action_space(self, agent: str) -> Any:
        """Return the space of an agent's actions; always the same object."""
        return self._actions[agent]

    def reset(
        self, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[Observations, dict[str, dict[str, Any]]]:
        """Begin trial 0 of a seed, or the next trial of the last one."""
        self._trial = self._trial + 1 if seed is None else 0
        self._seed = self._seed if seed is None else int(seed)
        self._simulator.begin_trial(self._lane, *self._simulator.keys(self._seed, TARGET_STAGE), self._trial)
        self.agents = list(self.possible_agents)
        rows = self._rows()
        return self._seen(rows), {agent: self._told(rows, agent, False) for agent in self.agents}

    def step(self, actions: dict[str, Any]) -> tuple[Any, Any, Any, Any, Any]:
        """Do one step with everybody's action; returns observations, rewards, terminations, truncations, infos."""
        from tasklift.building import kernel

        if not self.agents:
            return {}, {}, {}, {}, {}
        robots, agents = self._lane.robots, self.agents
        rows = self._rows()
        # what the kernel's `decide` would do, with outputs from outside; it then finds nobody due
        robots["row"], robots["due"], robots["since"], robots["held"] = rows, 0, 0, 0
        rewards: dict[str, float] = {}
        for agent in agents:
            r = self._numbers[agent]
            output = self._output(agent, actions)
            robots["out"][r] = output
            if robots["half"][r] < 0:
                robots["force"][r] = output
            rewards[agent] = float(self._signals[rows[r], output])
        losses = int(self._lane.count["losses"][0])
        state = kernel.step(self._simulator.world, self._simulator.rules, self._learner, self._lane, -1)
        lost = {agent: not robots["alive"][self._numbers[agent]] for agent in agents}
        if self.mission.reading.drill and int(self._lane.count["losses"][0]) > losses:
            lost = {agent: bool(robots["held"][self._numbers[agent]]) for agent in agents}
        steps = int(self._lane.count["step"][0])
        if state == 1:
            bonus = self.success_reward * (1 - steps / self.mission.limit)
            rewards = {agent: reward + bonus * (not lost[agent]) for agent, reward in rewards.items()}
        rewards = {agent: reward + self.loss_reward * lost[agent] for agent, reward in rewards.items()}
        alive = {agent: bool(robots["alive"][self._numbers[agent]]) for agent in agents}
        terminations = {agent: state == 1 or not alive[agent] for agent in agents}
        truncations = {agent: state == 2 and alive[agent] for agent in agents}
        rows = self._rows()
        seen = self._seen(rows)
        infos = {agent: self._told(rows, agent, lost[agent]) for agent in agents}
        self.agents = [] if state else [agent for agent in agents if alive[agent]]
        return seen, rewards, terminations, truncations, infos

    def state(self) -> NDArray[np.int64]:
        """Return everybody's input, int64 (R,); −1 for a robot that is lost."""
        return np.where(self._lane.robots["alive"] == 1, self._rows(), -1)

    def render(self) -> None:
        """Draw nothing: ``tasklift watch`` shows trials."""

    def close(self) -> None:
        """Nothing is held open."""

    def _output(self, agent: str, actions: dict[str, Any]) -> int:
        action = actions.get(agent)
        if action is None or not self._actions[agent].contains(np.asarray(action, dtype=np.int64)):
            raise TaskliftError(f"step: expected an action of {self._actions[agent]} for {agent!r}, found {action!r}")
        return int(np.ravel_multi_index(tuple(int(a) for a in action), self._sizes[1]))

    def _rows(self) -> NDArray[np.int64]:
        """Return every robot's input (Table I), as the kernel's ``sense`` finds it."""
        lane, world, rules = self._lane, self._simulator.world, self._simulator.rules
        robots = lane.robots
        armed = lane.teams["armed"][robots["team"]]
        weapons = np.where(armed == 0, 0, np.where(armed < rules.weapons_needed, 1, 2))
        faces = (robots["half"] < 0) & (lane.sites["resolved"][robots["node"]] == 0)
        feature = np.where(faces, world.nodes["feature"][robots["node"]], 1)
        heads = (robots["dl"] == 2) | ((robots["dl"] == 1) & bool(rules.suspicion_goal))
        goal = (heads & (robots["alert"] >= 0)).astype(np.int64)
        return np.asarray(((robots["dl"] * 2 + goal) * 3 + weapons) * 5 + feature - 1, dtype=np.int64)

    def _seen(self, rows: NDArray[np.int64]) -> Observations:
        positions = np.stack(np.unravel_index(rows, self._sizes[0]), axis=1)
        return {agent: positions[self._numbers[agent]].astype(np.int64) for agent in self.agents}

    def _told(self, rows: NDArray[np.int64], agent: str, lost: bool) -> dict[str, Any]:
        return {"input": int(rows[self._numbers[agent]]), "lost": bool(lost)}
