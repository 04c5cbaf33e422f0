"""The building search for Gymnasium: one agent for the team, and every robot of many missions."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.stats import spearmanr

import tasklift as tl
from tasklift.building import SCATTERED, Mission, Reading, generate
from tasklift.errors import TaskliftError

pytest.importorskip("gymnasium")

import gymnasium
from gymnasium.utils.env_checker import check_env

from tasklift.envs.pettingzoo import SearchEnv
from tasklift.envs.search import SearchTeamEnv, SearchVectorEnv

SMALL = "tasklift/SearchSmall-v0"


def mission(reading: Reading = SCATTERED) -> Mission:
    building = generate(intersections=9, corridors=11, rooms=3, features=6, doors=3, seed=5)
    return Mission(building, "4+3", limit=60, reading=reading)


@pytest.mark.filterwarnings("ignore:.*alternative render modes")
@pytest.mark.parametrize("observe", ["values", "onehot", "local"])
def test_gymnasiums_own_checks(observe) -> None:
    check_env(tl.make(SMALL, api="team", observe=observe))
    env = gymnasium.make(SMALL, observe=observe, act="flat", max_episode_steps=20)
    env.reset(seed=0)
    assert env.step(env.action_space.sample())[1] <= 20
    vector = gymnasium.make_vec(SMALL, num_envs=3)
    assert vector.reset(seed=0)[0].shape == (15, 13)


@pytest.mark.parametrize("reading", [SCATTERED, Reading(drill=True)])
def test_a_vector_is_missions_side_by_side(reading: Reading) -> None:
    there = mission(reading)
    vector = SearchVectorEnv(there, 6, observe="values", act="flat")
    alone = [SearchEnv(there, act="flat") for _ in range(6)]
    seen, _ = vector.reset(seed=5)
    for env, seed in zip(alone, np.random.SeedSequence(5).generate_state(6, np.uint64) >> np.uint64(2), strict=True):
        env.reset(seed=int(seed))
    rng, ends = np.random.default_rng(0), 0
    for _ in range(200):
        actions = rng.integers(22, 44, vector.num_envs)
        seen, rewards, ended, cut, info = vector.step(actions)
        for i, env in enumerate(alone):
            number = {a: i * 7 + r for r, a in enumerate(env.possible_agents)}
            before = list(env.agents)
            theirs = env.step({a: int(actions[number[a]]) for a in before})
            for agent in before:
                k = number[agent]
                assert info["alive"][k]
                assert (rewards[k], ended[k], cut[k]) == tuple(theirs[j][agent] for j in (1, 2, 3))
                last = info["final_obs"][k] if ended[k] or cut[k] else seen[k]
                assert np.array_equal(last, theirs[0][agent])
            assert not rewards[[number[a] for a in env.possible_agents if a not in before]].any()
            if not env.agents:
                ends += 1
                env.reset()
    assert ends > 5
    with pytest.raises(TaskliftError, match=r"actions of Discrete\(44\)"):
        vector.step(np.full(vector.num_envs, 44))
    with pytest.raises(TaskliftError, match="float64"):
        vector.step(np.zeros(vector.num_envs))


def test_the_team_as_one_agent() -> None:
    env = SearchTeamEnv(mission())
    with pytest.raises(TaskliftError, match=r"call reset\(\) before"):
        env.step(env.action_space.sample())
    env.reset(seed=1)
    over = False
    while not over:
        seen, reward, ended, cut, info = env.step(np.tile([1, 0, 5], 7))
        over = ended or cut
        assert env.observation_space.contains(seen)
        assert np.isfinite(reward)
    assert info["lost"] == 7 - int(seen.reshape(7, 13).any(axis=1).sum())
    with pytest.raises(TaskliftError, match=r"call reset\(\) before"):
        env.step(np.tile([1, 0, 5], 7))
    with pytest.raises(TaskliftError, match="unknown option"):
        tl.make(SMALL, api="team", observ="onehot", missions=3, signal=1)
    with pytest.raises(TaskliftError, match="environment"):
        tl.make("tasklift/Serch-v0")


def policies(task) -> dict[str, tuple[np.ndarray, float]]:
    """Ten fixed policies: an output for each input, and the share of decisions that are random instead."""
    weapons, feature = task.input_positions(range(task.shape[0]))[:, 2:].T
    constant = {at: np.full(task.shape[0], np.ravel_multi_index((*at, 5), (2, 2, 11))) for at in np.ndindex(2, 2)}
    go, stop, armed = constant[1, 0], constant[0, 0], constant[1, 1]
    best = task.signal_table().argmax(axis=1)
    at_door = feature == 3
    return {
        "best local signal": (best, 0.0),
        "best local signal, 10 % random": (best, 0.1),
        "best local signal, 30 % random": (best, 0.3),
        "best local signal, 60 % random": (best, 0.6),
        "random": (go, 1.0),
        "go": (go, 0.0),
        "stop": (stop, 0.0),
        "go, with weapons": (armed, 0.0),
        "unarmed teams stop at doors": (np.where(at_door & (weapons == 0), stop, go), 0.0),
        "all wait at doors for two weapon robots": (np.where(at_door & (weapons < 2), stop, go), 0.0),
    }


def test_returns_rank_policies_as_the_mission_does() -> None:
    env = tl.make("tasklift/Search-v0", api="team", observe="values", act="flat")
    sizes, limit = [len(v) for v in env.mission.task.inputs], env.mission.limit
    returns, scores = [], []
    for outputs, share in policies(env.mission.task).values():
        rng = np.random.default_rng(0)
        total = score = 0.0
        for seed in range(10):
            seen, over, steps = env.reset(seed=seed)[0], False, 0
            while not over:
                chosen = outputs[np.ravel_multi_index(seen.reshape(-1, 4).T, sizes)]
                random = rng.random(len(chosen)) < share
                seen, reward, ended, cut, info = env.step(np.where(random, rng.integers(44, size=len(chosen)), chosen))
                over, steps, total = ended or cut, steps + 1, total + reward
            # as policies are searched: see PolicySearch
            score += info["success"] - info["lost"] / (1 + info["lost"]) - (steps if info["success"] else limit) / limit
        returns.append(total)
        scores.append(score)
    assert spearmanr(returns, scores).statistic >= 0.9, (returns, scores)
