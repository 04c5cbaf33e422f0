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


@pytest.mark.parametrize(("reading", "patience"), [(SCATTERED, 1), (SCATTERED, 9), (Reading(drill=True), 1)])
def test_a_vector_is_missions_side_by_side(reading: Reading, patience: int) -> None:
    there = mission(reading)
    vector = SearchVectorEnv(there, 6, observe="values", act="flat", patience=patience)
    alone = [SearchEnv(there, act="flat", patience=patience) for _ in range(6)]
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
                assert not env.agents or info["decides"][k] == theirs[4][agent]["decides"]
            assert not rewards[[number[a] for a in env.possible_agents if a not in before]].any()
            if not env.agents:
                ends += 1
                env.reset()
    assert ends > 5


@pytest.mark.parametrize("share", [0.25, 1.0])
def test_a_team_shares_what_it_earns(share: float) -> None:
    own, shared = (SearchVectorEnv(mission(), 6, act="flat", team_share=part) for part in (0.0, share))
    own.reset(seed=1), shared.reset(seed=1)
    rng = np.random.default_rng(0)
    lost = 0
    for _ in range(150):
        actions = rng.integers(22, 44, own.num_envs)
        seen, alone, *_ = own.step(actions)
        same, together, ended, cut, info = shared.step(actions)
        assert np.array_equal(seen, same)
        mean = np.repeat(alone.reshape(6, 7).mean(axis=1), 7)
        assert together == pytest.approx((1 - share) * alone + share * mean)
        over = info.get("_success", np.zeros(own.num_envs, bool))
        assert np.array_equal(ended | cut, over), "the lost earn on until their mission ends"
        lost += (alone < -1).sum()
    assert lost > 5


@pytest.mark.parametrize("api", ["team", "vector"])
@pytest.mark.parametrize("act", ["values", "flat"])
def test_actions_of_another_kind_are_refused_before_anything_changes(api, act) -> None:
    env = tl.make(SMALL, api=api, act=act)
    with pytest.raises(TaskliftError, match=r"call reset\(\) before"):
        env.step(env.action_space.sample())
    env.reset(seed=0)
    good = env.action_space.sample()
    before = env._batch.lanes.count.copy()
    nan, large = np.full(good.shape, np.nan), np.full(good.shape, 2**63, np.uint64)
    for bad in (good.astype(float), nan, large, good > 0, good.astype(object), good[:-1], good[None], good.T[..., None],
                good - 100, good + 100, None, "go", {}, [], [[0], [0, 1]]):  # fmt: skip
        with pytest.raises(TaskliftError, match=r"step: expected .*found"):
            env.step(bad)
    for seed in (1.5, -1, "a", True, [1, 2]):
        with pytest.raises(TaskliftError, match="seed"):
            env.reset(seed=seed)
    assert np.array_equal(env._batch.lanes.count, before)
    env.step(good)


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


GO, STOP, ARMED = (np.ravel_multi_index((*at, 5), (2, 2, 11)) for at in ((1, 0), (0, 0), (1, 1)))


def policies(task) -> dict[str, tuple[np.ndarray, float]]:
    """Ten fixed policies: an output for each input, and the share of decisions that are random instead."""
    weapons, feature = task.input_positions(range(task.shape[0]))[:, 2:].T
    best, always = task.signal_table().argmax(axis=1), np.ones(task.shape[0], int)
    at_door = feature == 3
    return {
        "best local signal": (best, 0.0),
        "best local signal, 10 % random": (best, 0.1),
        "best local signal, 30 % random": (best, 0.3),
        "best local signal, 60 % random": (best, 0.6),
        "random": (always, 1.0),
        "go": (GO * always, 0.0),
        "stop": (STOP * always, 0.0),
        "go, with weapons": (ARMED * always, 0.0),
        "unarmed teams stop at doors": (np.where(at_door & (weapons == 0), STOP, GO), 0.0),
        "all wait at doors for two weapon robots": (np.where(at_door & (weapons < 2), STOP, GO), 0.0),
    }


def other_policies(task) -> dict[str, tuple[np.ndarray, float]]:
    """Ten more, by which no reward was chosen."""
    danger, goal, weapons, feature = task.input_positions(range(task.shape[0])).T
    at_door, drawn = feature == 3, np.random.default_rng(0).integers(44, size=(2, task.shape[0]))
    scouts_first = np.where(at_door & (weapons == 1), STOP, GO)
    return {
        "single weapon robots wait at doors": (scouts_first, 0.0),
        "the same, 20 % random": (scouts_first, 0.2),
        "wait for two, keep with weapons, 5 % random": (np.where(at_door & (weapons < 2), STOP, ARMED), 0.05),
        "wait at every feature for two": (np.where((feature > 0) & (weapons < 2), STOP, GO), 0.0),
        "only armed teams move": (np.where(weapons == 0, STOP, GO), 0.0),
        "stop where danger is known": (np.where(danger > 0, STOP, GO), 0.0),
        "cross doors with a goal only": (np.where(at_door & (goal == 0), STOP, GO), 0.0),
        "wait for two, half random": (np.where(at_door & (weapons < 2), STOP, GO), 0.5),
        "a table drawn at random": (drawn[0], 0.0),
        "another table": (drawn[1], 0.0),
    }


def played(outputs: np.ndarray, share: float, missions: int = 30) -> tuple[float, float]:
    """Return a policy's mean return and mean score (see PolicySearch), over one episode of each mission."""
    env = tl.make("tasklift/Search-v0", api="vector", missions=missions, observe="values", act="flat")
    sizes, limit, n_robots = [len(v) for v in env.mission.task.inputs], env.mission.limit, env.mission.n_robots
    rng, seen = np.random.default_rng(0), env.reset(seed=0)[0]
    going, total, scores = np.ones(missions, bool), np.zeros(missions), np.zeros(missions)
    for step in range(1, limit + 1):
        random = rng.random(len(seen)) < share
        chosen = np.where(random, rng.integers(44, size=len(seen)), outputs[np.ravel_multi_index(seen.T, sizes)])
        seen, rewards, _, _, info = env.step(chosen)
        total += going * rewards.reshape(missions, n_robots).sum(axis=1)
        if "success" in info:
            over, success, lost = (info[name][::n_robots] for name in ("_success", "success", "lost"))
            score = success - lost / (1 + lost) - np.where(success, step, limit) / limit
            scores, going = np.where(over & going, score, scores), going & ~over
    assert not going.any()
    return total.mean(), scores.mean()


@pytest.mark.parametrize("ten", [policies, other_policies])
def test_returns_rank_policies_as_the_mission_does(ten) -> None:
    returns, scores = zip(*(played(*policy) for policy in ten(tl.make(SMALL).task).values()), strict=True)
    assert spearmanr(returns, scores).statistic >= 0.9, (returns, scores)
