"""The building search as a PettingZoo ``ParallelEnv``: every robot an agent, for other people's learners.

Needs the extra ``gym``. The world is the simulator's kernel; only the decisions come from outside. By default every
robot decides at every step, which is the simulator under ``patience=1``.
"""

from __future__ import annotations

from collections.abc import Mapping
from itertools import compress
from typing import Any

import numpy as np
from numpy.typing import NDArray

from tasklift.building.mission import Mission
from tasklift.envs.batch import OVER, Act, Actions, Batch, Observations, Observe, Rewards
from tasklift.envs.picture import MODES, Drawn
from tasklift.errors import TaskliftError, missing
from tasklift.text import shown

try:
    from pettingzoo import ParallelEnv
    from pettingzoo.utils.conversions import parallel_to_aec_wrapper
    from pettingzoo.utils.wrappers import OrderEnforcingWrapper
except ImportError as error:
    raise missing("PettingZoo", "gym", "tasklift.envs.pettingzoo") from error


class SearchEnv(Drawn, ParallelEnv):
    """A mission whose robots are steered from outside.

    Agents are called after their kind and number (``"scout_0"``, … ``"weapon_10"``), in the simulator's order. What
    they see and do is read from ``mission.task``: its inputs (DL, GL, nWPN and FTR) and outputs (MV, WPN and CA).

    Parameters
    ----------
    mission
        Where, who, and the world's rules; ``decide`` and ``patience`` of its reading do not matter here.
    observe
        ``"values"``: the positions of the inputs, a ``MultiDiscrete``. ``"onehot"``: a ``Box`` of ones and zeros.
        ``"local"``: that, and what the robot knows of the corridors and robots around it: :class:`.Observations`.
    act
        ``"values"``: the positions of the outputs, a ``MultiDiscrete``. ``"flat"``: one ``Discrete`` number.
    patience
        A robot decides when its input changes or it arrives, and after this many steps without a decision (steps, at
        least 1). With more than 1, a step of the environment goes on until somebody decides or is lost. Who does not
        decide keeps its output: ``info["decides"]`` says whose next action is looked at.
    render_mode
        None, ``"rgb_array"`` or ``"human"``.
    **rewards
        ``progress_reward``, ``loss_reward``, ``success_reward``, ``signal_weight``, ``team_share``: :class:`.Rewards`.

    Raises
    ------
    TaskliftError
        For an unknown option; later, for a missing action, one outside its space, one of a robot that is lost or
        unknown, and a step after the end.

    Notes
    -----
    A robot that is destroyed terminates; at the step limit the rest is truncated. ``reset(seed=…)`` starts trial 0 of
    that seed, which also hides the hostiles; ``reset()`` goes on to the next trial, of a fresh seed if none was given.
    """

    metadata = {  # noqa: RUF012
        "name": "tasklift_search_v0",
        "render_modes": MODES,
        "is_parallelizable": True,
        "render_fps": 10,
    }

    def __init__(
        self,
        mission: Mission,
        *,
        observe: Observe = "values",
        act: Act = "values",
        patience: int = 1,
        render_mode: str | None = None,
        **rewards: float,
    ) -> None:
        self._set_mode(render_mode)
        self._batch = Batch(mission, 1, Rewards.of(rewards), patience)
        self.mission, self.task = self._batch.mission, mission.task
        kinds = [kind.name for kind, n in mission.team.items() for _ in range(n)]
        self.possible_agents = [f"{kind}_{r}" for r, kind in enumerate(kinds)]
        self.agents: list[str] = []
        self._live: list[int] = []  # of each possible agent, 1 if it is one of them
        self._observations, self._actions = Observations(mission, observe), Actions(mission, act)
        self._states = Observations(mission, "onehot")
        self.state_space = self._states.space(mission.n_robots)
        self._observation_spaces = {agent: self._observations.space() for agent in self.possible_agents}
        self._action_spaces = {agent: self._actions.space() for agent in self.possible_agents}

    def observation_space(self, agent: str) -> Any:
        """Return the space of an agent's observations; always the same object."""
        return self._observation_spaces[agent]

    def action_space(self, agent: str) -> Any:
        """Return the space of an agent's actions; always the same object."""
        return self._action_spaces[agent]

    def reset(
        self, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[dict[str, NDArray[Any]], dict[str, dict[str, Any]]]:
        """Begin trial 0 of a seed, or the next trial of the last one."""
        if seed is not None or not self._batch.begun:
            self._batch.seed(seed)
        self._batch.begin()
        self.agents, self._live = list(self.possible_agents), [1] * len(self.possible_agents)
        self._show()
        return self._by_agent(self._observations.of(self._batch)[0]), self._infos()

    def step(self, actions: dict[str, Any]) -> tuple[Any, Any, Any, Any, Any]:
        """Do one step with everybody's action; returns observations, rewards, terminations, truncations, infos."""
        if not isinstance(actions, Mapping):
            raise TaskliftError(f"step: expected a dict from agent to action, found {shown(actions)}")
        if not self.agents:
            if actions or not self._batch.begun:
                raise TaskliftError(OVER)
            return {}, {}, {}, {}, {}  # SuperSuit's black_death takes one more step, without actions
        if len(actions) > len(self.agents):
            extra = next(agent for agent in actions if agent not in self.agents)
            known = "lost" if extra in self.possible_agents else "unknown"
            raise TaskliftError(f"step: {extra!r} is {known}; expected actions of {', '.join(self.agents)} only")
        batch, number = self._batch, self._actions.number
        chosen = iter([number(actions.get(agent), agent) for agent in self.agents])
        batch.step(np.array([[next(chosen) if lives else 0 for lives in self._live]]))
        over, cut, alive = bool(batch.state[0]), batch.cut[0].tolist(), batch.alive[0].tolist()
        result = (
            self._by_agent(self._observations.of(batch)[0]),
            self._by_agent(batch.rewards[0].tolist()),
            self._by_agent([not c and (over or not lives) for c, lives in zip(cut, alive, strict=True)]),
            self._by_agent(cut),
            self._infos(),
        )
        self._live = [0] * len(alive) if over else alive
        self.agents = list(compress(self.possible_agents, self._live))
        self._show()
        return result

    def check(self, action: Any, agent: str) -> None:
        """Refuse what is not an action of the agent."""
        self._actions.number(action, agent)

    def state(self) -> NDArray[np.float32]:
        """Return everybody's inputs, one-hot and in a row, float32; zeros for a robot that is lost."""
        return self._states.of(self._batch).ravel()

    def _by_agent(self, values: Any) -> dict[str, Any]:
        return dict(zip(self.agents, compress(values, self._live), strict=True))

    def _infos(self) -> dict[str, dict[str, Any]]:
        batch = self._batch
        known = zip(batch.rows[0].tolist(), batch.lost[0].tolist(), batch.decides[0].tolist(), strict=True)
        return self._by_agent([{"input": row, "lost": hit == 1, "decides": due == 1} for row, hit, due in known])


class SearchTurns(OrderEnforcingWrapper):
    """The same for learners that take turns: a wrong action is refused in its own turn."""

    def __init__(self, env: SearchEnv) -> None:
        super().__init__(parallel_to_aec_wrapper(env))

    def step(self, action: Any) -> None:
        """Take the action of the agent whose turn it is; None for one whose episode has ended."""
        if not self._has_reset or not self.agents:
            raise TaskliftError(OVER)
        agent = self.agent_selection
        if not (self.terminations[agent] or self.truncations[agent]):
            self.unwrapped.check(action, agent)
        elif action is not None:
            raise TaskliftError(f"step: the episode of {agent!r} is over; expected None, found {shown(action)}")
        super().step(action)
