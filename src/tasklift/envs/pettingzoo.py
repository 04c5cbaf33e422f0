"""The building search as a PettingZoo ``ParallelEnv``: every robot an agent, for other people's learners.

Needs the extra ``gym``. The world is the simulator's kernel; only the decisions come
from outside. Every robot decides at every step, which is the simulator under ``patience=1``.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from tasklift.building import Mission
from tasklift.building.simulator import FAILURE, SUCCESS
from tasklift.errors import TaskliftError, missing
from tasklift.learning.chances import TARGET_STAGE
from tasklift.learning.reinforcement import Reinforcement

try:
    from gymnasium.spaces import MultiDiscrete
    from pettingzoo import ParallelEnv
except ImportError as error:
    raise missing("PettingZoo", "gym", "tasklift.envs.pettingzoo") from error

Observations = dict[str, NDArray[np.int64]]


class SearchEnv(ParallelEnv):
    """A mission whose robots are steered from outside.

    Agents are called after their kind and number (``"scout_0"``, … ``"weapon_10"``), in the simulator's order. An
    observation has the positions of the mission's inputs: by default DL, GL, nWPN and FTR (``MultiDiscrete([3, 2, 3,
    5])``). An action has those of its outputs: by default MV, WPN and CA (``MultiDiscrete([2, 2, 11])``).

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
        self.mission = mission.with_reading(decide="robot", patience=1)
        self.loss_reward, self.success_reward = loss_reward, success_reward
        self.task = mission.task
        kinds = [kind.name for kind, number in mission.team.items() for _ in range(number)]
        self.possible_agents = [f"{kind}_{r}" for r, kind in enumerate(kinds)]
        self.agents: list[str] = []
        self._numbers = {agent: r for r, agent in enumerate(self.possible_agents)}
        self._sizes = [len(v) for v in self.task.outputs]
        self._observations = {a: MultiDiscrete([len(v) for v in self.task.inputs]) for a in self.possible_agents}
        self._actions = {a: MultiDiscrete(self._sizes) for a in self.possible_agents}
        self._signals = self.task.signal_table()
        self._positions = self.task.input_positions(range(self.task.shape[0]))
        self._simulator = self.mission.simulator
        self._learner = self._simulator.learner(self.task, Reinforcement(), learn=False)
        self._lane = self._simulator.lane(self.task.shape)
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
        self._simulator.begin_trial(self._lane, self._seed, TARGET_STAGE, self._trial)
        self.agents = list(self.possible_agents)
        self._inputs = self._simulator.observe(self._lane)
        return self._seen(), self._infos(np.zeros(len(self.agents), bool))

    def step(self, actions: dict[str, Any]) -> tuple[Any, Any, Any, Any, Any]:
        """Do one step with everybody's action; returns observations, rewards, terminations, truncations, infos."""
        if not self.agents:
            return {}, {}, {}, {}, {}
        robots, agents = self._lane.robots, self.agents
        outputs = self._outputs(actions)
        rewards = self._signals[self._inputs, outputs]
        losses = int(self._lane.count["losses"][0])
        state = self._simulator.act(self._learner, self._lane, outputs)
        alive = robots["alive"] == 1
        lost = ~alive
        if self.mission.reading.drill and int(self._lane.count["losses"][0]) > losses:
            lost = robots["repelled"] == 1
        if state == SUCCESS:
            steps = int(self._lane.count["step"][0])
            rewards = rewards + self.success_reward * (1 - steps / self.mission.limit) * ~lost
        rewards = rewards + self.loss_reward * lost
        self._inputs = self._simulator.observe(self._lane)
        result = (
            self._seen(),
            self._by_agent(rewards),
            self._by_agent((state == SUCCESS) | ~alive),
            self._by_agent((state == FAILURE) & alive),
            self._infos(lost),
        )
        self.agents = [] if state else [agent for agent in agents if alive[self._numbers[agent]]]
        return result

    def state(self) -> NDArray[np.int64]:
        """Return everybody's input, int64 (R,); −1 for a robot that is lost."""
        return np.where(self._lane.robots["alive"] == 1, self._inputs, -1)

    def render(self) -> None:
        """Draw nothing: ``tasklift watch`` shows trials."""

    def close(self) -> None:
        """Do nothing: there is nothing to close."""

    def _outputs(self, actions: dict[str, Any]) -> NDArray[np.int64]:
        """Return the number of each robot's output, int64 (R,); 0 for the lost."""
        outputs = np.zeros(len(self.possible_agents), np.int64)
        for agent in self.agents:
            action: Any = actions.get(agent)
            values = action.tolist() if isinstance(action, np.ndarray) else action
            index = 0
            try:
                for value, size in zip(values, self._sizes, strict=True):
                    if not 0 <= value < size or value != int(value):
                        raise ValueError
                    index = index * size + int(value)
            except (TypeError, ValueError) as error:
                raise TaskliftError(
                    f"step: expected an action of {self._actions[agent]} for {agent!r}, found {action!r}"
                ) from error
            outputs[self._numbers[agent]] = index
        return outputs

    def _by_agent(self, values: NDArray[Any]) -> dict[str, Any]:
        listed = values.tolist()
        return {agent: listed[self._numbers[agent]] for agent in self.agents}

    def _seen(self) -> Observations:
        positions = self._positions[self._inputs]
        return {agent: positions[self._numbers[agent]] for agent in self.agents}

    def _infos(self, lost: NDArray[np.bool_]) -> dict[str, dict[str, Any]]:
        inputs, were_lost = self._inputs.tolist(), lost.tolist()
        return {a: {"input": inputs[self._numbers[a]], "lost": were_lost[self._numbers[a]]} for a in self.agents}
