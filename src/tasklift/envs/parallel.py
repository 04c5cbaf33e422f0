"""Any PettingZoo parallel environment as a world whose agents share one policy: declare how one agent factors."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from tasklift.checks import whole_number
from tasklift.envs.adapter import Act, Adapter, Judge, Observe
from tasklift.errors import TaskliftError
from tasklift.tasks.task import Task
from tasklift.text import shown


class FactoredTeam:
    """A PettingZoo parallel environment as a world of several agents with one policy (:class:`.Steps`).

    Every agent that acts is one more source of experience for the same table. Losses and returns of an episode (trial)
    are sums over the agents; its steps are the environment's.

    Parameters
    ----------
    env
        The environment, with PettingZoo's parallel interface.
    task
        How one agent's observations and actions factor into variables; the spaces of all agents have to fit it.
    observe, act, mask
        As in :class:`tasklift.envs.gymnasium.Factored`. An agent's mask is in its ``info``.
    loss, success
        As there, asked for each agent in each step; ``event.agent`` says whose event it is. An episode succeeds if it
        does for all agents that are there in its last step.
    limit
        The most steps of an episode; default: the environment's ``max_cycles``.

    Raises
    ------
    TaskliftError
        If the environment has another interface, or an agent's spaces do not fit the task; later, for an agent that
        comes in the middle of an episode or gets no answer, and for whatever ``Factored`` refuses.

    Examples
    --------
    >>> import tasklift as tl
    >>> from tasklift.envs.parallel import FactoredTeam
    >>> env = tl.make("tasklift/SearchSmall-v0", act="flat")
    >>> lost = lambda event: event.info["lost"]
    >>> world = FactoredTeam(env, env.task, loss=lost, limit=env.mission.limit)
    >>> tl.learn_values(world, trials=2, seed=0)
    Curve(StepOutcomes(2 episodes: 0 solved, 7 lost, 600.0 steps on average))
    """

    def __init__(
        self,
        env: Any,
        task: Task,
        *,
        observe: Observe | None = None,
        act: Act | None = None,
        loss: Judge | None = None,
        success: Judge | None = None,
        limit: int | None = None,
        mask: str | None = "action_mask",
    ) -> None:
        name = str(getattr(env, "metadata", {}).get("name") or type(env).__name__)
        if not hasattr(env, "possible_agents") or hasattr(env, "agent_iter"):
            other = "the AEC interface (convert it by pettingzoo.utils.conversions.aec_to_parallel)"
            found = other if hasattr(env, "agent_iter") else "no possible_agents (one agent: Factored)"
            raise TaskliftError(f"{name}: expected PettingZoo's parallel interface, found {found}")
        chosen = getattr(env.unwrapped, "max_cycles", None) if limit is None else limit
        if chosen is None:
            raise TaskliftError(f"{name}: the environment has no limit of steps; give limit=")
        limit = whole_number(chosen, f"{name}, limit", least=1)
        self.env, self._name, self._task, self._limit = env, name, task, limit
        self._adapters = {
            agent: Adapter(
                name,
                (env.observation_space(agent), env.action_space(agent)),
                task,
                observe=observe,
                act=act,
                loss=loss,
                success=success,
                limit=limit,
                mask=mask,
                agent=agent,
            )
            for agent in env.possible_agents
        }

    def __repr__(self) -> str:
        return f"FactoredTeam({self._name}, {len(self._adapters)} agents, {self._task!r})"

    @property
    def task(self) -> Task:
        """The declared task of one agent."""
        return self._task

    @property
    def limit(self) -> int:
        """The most steps of an episode (trial)."""
        return self._limit

    @property
    def agents(self) -> tuple[str, ...]:
        """The names of all agents."""
        return tuple(self._adapters)

    @property
    def possible(self) -> dict[str, NDArray[np.bool_] | None]:
        """The outputs that are possible now, bool (A,), by agent; None: all of the task's."""
        return {agent: adapter.possible for agent, adapter in self._adapters.items()}

    def start(self, rng: np.random.Generator) -> Any:
        """Reset the environment, seeded from ``rng``, and return the first input of each agent that is there."""
        for agent, adapter in self._adapters.items():
            adapter.need_spaces(self.env.observation_space(agent), self.env.action_space(agent))
        given = self.env.reset(seed=int(rng.integers(2**31)))
        if not self.env.agents:
            raise TaskliftError(f"{self._name}: no agent is there after reset()")
        return {agent: self._adapters[agent].begin(self._part(given, agent, "reset")) for agent in self.env.agents}

    def step(self, outputs: Any) -> Any:
        """Do one step with an output of each agent that is there; return a :class:`.Step` for each."""
        if set(outputs) != set(self.env.agents):
            raise TaskliftError(
                f"{self._name}: expected an output of each agent that is there, {shown(self.env.agents)}, found "
                f"{shown(list(outputs))}; agents leave by termination or truncation"
            )
        given = self.env.step({agent: self._adapters[agent].action(output) for agent, output in outputs.items()})
        for agent in self.env.agents:
            if agent not in outputs:
                raise TaskliftError(f"{self._name}: agent {shown(agent)} came in the middle of an episode (trial)")
        return {agent: self._adapters[agent].answer(self._part(given, agent, "step")) for agent in outputs}

    def _part(self, given: Any, agent: str, call: str) -> tuple[Any, ...]:
        """Return what ``reset`` or ``step`` gave one agent."""
        try:
            return tuple(part[agent] for part in given)
        except (KeyError, TypeError, IndexError) as error:
            raise TaskliftError(f"{self._name}: {call}() gave agent {shown(agent)} nothing: {shown(given)}") from error
