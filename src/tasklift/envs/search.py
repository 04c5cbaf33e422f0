"""The building search for Gymnasium: a team steered as one, and many robots in one compiled call.

Needs the extra ``gym``. :class:`SearchTeamEnv` is one agent that decides for everybody; :class:`SearchVectorEnv` has
an environment for every robot of many missions, for learners that train one policy for all.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from tasklift.building.mission import Mission
from tasklift.checks import whole_number
from tasklift.envs.batch import OVER, Act, Actions, Batch, Observations, Observe, Rewards
from tasklift.envs.picture import MODES, Drawn
from tasklift.errors import TaskliftError, missing

try:
    import gymnasium
    from gymnasium.vector import AutoresetMode, VectorEnv
    from gymnasium.vector.utils import batch_space
except ImportError as error:
    raise missing("Gymnasium", "gym", "tasklift.envs.search") from error


class SearchTeamEnv(Drawn, gymnasium.Env):
    """A mission as one agent: it sees what all robots see, and decides for all; the reward is the sum of theirs.

    Parameters
    ----------
    mission, observe, act, patience, render_mode, **rewards
        As in :class:`tasklift.envs.pettingzoo.SearchEnv`; observations and actions are those of all robots in a row.
        A lost robot sees zeros, and its action is not looked at.

    Raises
    ------
    TaskliftError
        For an unknown option; later, for an action outside its space, and a step after the end.
    """

    metadata = {"render_modes": MODES, "render_fps": 10}  # noqa: RUF012

    def __init__(
        self,
        mission: Mission,
        *,
        observe: Observe = "onehot",
        act: Act = "values",
        patience: int = 1,
        render_mode: str | None = None,
        **rewards: float,
    ) -> None:
        self._set_mode(render_mode)
        self._batch = Batch(mission, 1, Rewards.of(rewards), patience)
        self.mission = self._batch.mission
        self._observations, self._actions = Observations(mission, observe), Actions(mission, act)
        self.observation_space = self._observations.space(mission.n_robots)
        self.action_space = self._actions.space_of(mission.n_robots)

    def reset(self, *, seed: int | None = None, options: dict[str, Any] | None = None) -> tuple[Any, dict[str, Any]]:
        """Begin an episode (trial); with a seed, the same one each time."""
        super().reset(seed=None if seed is None else whole_number(seed, "seed"))
        self._batch.seed(int(self.np_random.integers(2**62)))
        self._batch.begin()
        self._show()
        return self._seen(), self._info()

    def step(self, action: Any) -> tuple[Any, float, bool, bool, dict[str, Any]]:
        """Do one step with the actions of all robots in a row."""
        batch = self._batch
        if batch.state[0]:
            raise TaskliftError(OVER)
        batch.step(self._actions.numbers(action, self.action_space, batch.rows.shape))
        self._show()
        truncated = bool(batch.cut.any())
        terminated = bool(batch.state[0]) and not truncated
        return self._seen(), float(batch.rewards.sum()), terminated, truncated, self._info()

    def _seen(self) -> NDArray[Any]:
        return self._observations.of(self._batch).ravel()

    def _info(self) -> dict[str, Any]:
        batch = self._batch
        lost, decides = int((batch.alive == 0).sum()), batch.decides[0] == 1
        return {"success": bool(batch.succeeded[0]), "lost": lost, "decides": decides}


class SearchVectorEnv(VectorEnv):
    """``missions`` copies of a mission, side by side; every robot is one of the environments.

    Environment ``i × R + r`` is robot ``r`` of mission ``i``. A mission that has ended begins anew in the same step
    (``AutoresetMode.SAME_STEP``): ``info["final_obs"]`` has what was seen before, where ``info["_final_obs"]``. A robot
    that is lost terminates. Until its mission ends it sees zeros and gets nothing: ``info["alive"]`` says whose step it
    was. It terminates once more with its mission. With a ``team_share`` it goes on earning what the team earns, and
    terminates with its mission only. ``info["decides"]`` says whose next action is looked at. ``info["success"]`` and
    ``info["lost"]`` say how the missions of the environments in ``info["_success"]`` have just ended.

    Parameters
    ----------
    mission
        Where, who, and the world's rules.
    missions
        How many at once.
    observe, act, patience, **rewards
        As in :class:`tasklift.envs.pettingzoo.SearchEnv`.

    Raises
    ------
    TaskliftError
        For an unknown option; later, for actions outside their space, and a step before a reset.
    """

    metadata = {"autoreset_mode": AutoresetMode.SAME_STEP, "render_modes": []}  # noqa: RUF012

    def __init__(
        self,
        mission: Mission,
        missions: int = 64,
        *,
        observe: Observe = "onehot",
        act: Act = "values",
        patience: int = 1,
        **rewards: float,
    ) -> None:
        whole_number(missions, "missions", 1, 100_000)
        pay = Rewards.of(rewards)
        self._batch, self._shares = Batch(mission, missions, pay, patience), pay.team_share > 0
        self.mission = self._batch.mission
        self.num_envs = missions * mission.n_robots
        self._observations, self._actions = Observations(mission, observe), Actions(mission, act)
        self.single_observation_space, self.single_action_space = self._observations.space(), self._actions.space()
        self.observation_space = batch_space(self.single_observation_space, self.num_envs)
        self.action_space = batch_space(self.single_action_space, self.num_envs)

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[NDArray[Any], dict[str, Any]]:
        """Begin all missions; from one seed, mission i has the i-th that comes of it."""
        if seed is not None or not self._batch.begun:
            self._batch.seed(seed)
        self._batch.begin()
        return self._seen(), {"alive": np.ones(self.num_envs, np.bool_), "decides": self._deciding()}

    def step(self, actions: Any) -> tuple[NDArray[Any], Any, Any, Any, dict[str, Any]]:
        """Do one step of every mission with an action for every robot."""
        batch = self._batch
        if not batch.begun:
            raise TaskliftError("step: nothing has begun; call reset() before")
        lived = batch.alive == 1
        batch.step(self._actions.numbers(actions, self.action_space, batch.rows.shape))
        over, cut = batch.state != 0, batch.cut.ravel()
        done = over[:, None] if self._shares else (lived & (batch.alive == 0)) | over[:, None]
        ended = np.broadcast_to(done, lived.shape).ravel() & ~cut
        seen, rewards, info = self._seen(), batch.rewards.ravel().copy(), {"alive": lived.ravel()}
        if ended.any() or cut.any():
            info |= {"final_obs": seen, "_final_obs": ended | cut}
        if over.any():
            lost = (batch.alive == 0).sum(axis=1) * over
            how = {"success": batch.succeeded, "lost": lost, "_success": over, "_lost": over}
            info |= {name: np.repeat(value, lived.shape[1]) for name, value in how.items()}
            batch.begin(np.flatnonzero(over))
            seen = self._seen()
        info["decides"] = self._deciding()
        return seen, rewards, ended, cut, info

    def _deciding(self) -> NDArray[np.bool_]:
        return self._batch.decides.ravel() == 1

    def _seen(self) -> NDArray[Any]:
        return self._observations.of(self._batch).reshape(self.num_envs, -1)
