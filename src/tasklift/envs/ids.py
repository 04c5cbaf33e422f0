"""Names for the building search: ``tasklift.make``, and ids of Gymnasium.

Once this module is imported, ``gymnasium.make("tasklift/Search-v0")`` gives the team as one agent, and
``gymnasium.make_vec("tasklift/Search-v0", num_envs=64)`` every robot of 64 missions. Gymnasium imports it by itself
for ``gymnasium.make("tasklift.envs.ids:tasklift/Search-v0")``.
"""

from __future__ import annotations

from functools import partial
from typing import Any, Literal, get_args

from tasklift.building.generate import generate
from tasklift.building.mission import Mission
from tasklift.checks import one_of
from tasklift.envs.search import SearchTeamEnv, SearchVectorEnv

Api = Literal["parallel", "aec", "team", "vector"]

#: The missions that have a name: building and team.
MISSIONS: dict[str, tuple[dict[str, Any], str]] = {
    "tasklift/SearchSmall-v0": ({"intersections": 5, "corridors": 5, "rooms": 2, "seed": 1}, "3+2"),
    "tasklift/Search-v0": ({"intersections": 21, "corridors": 25, "rooms": 6, "seed": 7}, "10+5"),
}


def mission_of(name: str) -> Mission:
    """Return the mission of that name; raises :class:`.TaskliftError` for an unknown one."""
    one_of(name, MISSIONS, "environment")
    building, team = MISSIONS[name]
    return Mission(generate(**building), team)


def make(name: str, *, api: Api = "parallel", mission: Mission | None = None, **options: Any) -> Any:
    """Return the building search as an environment for other people's learners.

    Parameters
    ----------
    name
        ``"tasklift/SearchSmall-v0"`` (5 robots) or ``"tasklift/Search-v0"`` (15).
    api
        ``"parallel"`` and ``"aec"`` for PettingZoo, ``"team"`` and ``"vector"`` for Gymnasium.
    mission
        Of your own, in place of the named one.
    **options
        Of :class:`.SearchEnv`, :class:`.SearchTeamEnv` or :class:`.SearchVectorEnv`.

    Raises
    ------
    TaskliftError
        For an unknown name, api or option.

    Examples
    --------
    >>> import tasklift as tl
    >>> env = tl.make("tasklift/SearchSmall-v0", observe="onehot", act="flat")
    >>> observations, infos = env.reset(seed=0)
    >>> observations["scout_0"].shape, env.action_space("scout_0")
    ((13,), Discrete(44))
    """
    one_of(api, get_args(Api), "api")
    if mission is None:
        mission = mission_of(name)
    if api == "team":
        return SearchTeamEnv(mission, **options)
    if api == "vector":
        return SearchVectorEnv(mission, **options)
    from tasklift.envs.pettingzoo import SearchEnv, SearchTurns

    env = SearchEnv(mission, **options)
    return env if api == "parallel" else SearchTurns(env)


def _register() -> None:
    from gymnasium import register, registry

    def vector(num_envs: int = 64, **options: Any) -> SearchVectorEnv:
        return make(api="vector", missions=num_envs, **options)

    for name in MISSIONS:
        if name not in registry:
            register(name, partial(make, api="team"), vector_entry_point=vector, kwargs={"name": name})


_register()
