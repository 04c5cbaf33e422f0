"""The building search as a ParallelEnv: PettingZoo's own tests, and step for step the simulator."""

from __future__ import annotations

import numpy as np
import pytest

import tasklift as tl
from tasklift.building import COHESIVE, SCATTERED, SCOUT, WEAPON, Mission, Reading, generate
from tasklift.errors import TaskliftError

pytest.importorskip("pettingzoo")

from pettingzoo.test import parallel_api_test, parallel_seed_test

from tasklift.envs.pettingzoo import SearchEnv

BUILDING = generate(intersections=9, corridors=11, rooms=3, features=6, doors=3, seed=5)


def mission(reading: Reading = SCATTERED, **options) -> Mission:
    return Mission(BUILDING, {SCOUT: 4, WEAPON: 3}, reading=reading, **({"hostiles": 1, "limit": 150} | options))


def test_pettingzoos_own_tests() -> None:
    parallel_api_test(SearchEnv(mission()), num_cycles=400)
    parallel_seed_test(lambda: SearchEnv(mission()), num_cycles=60)


@pytest.mark.parametrize("reading", [SCATTERED, COHESIVE, Reading(drill=True), Reading(suspicion_goal=False)])
def test_step_for_step_it_is_the_simulator(reading: Reading) -> None:
    # one heaviest output per input, so that both make the same decisions; the edges are drawn with the same chances
    there = mission(reading)
    weights = np.random.default_rng(1).random(there.task.shape)
    weights[:, :22] *= 0.8  # moving is heavier more often than not
    policy = tl.Policy(there.task, weights)
    greedy = tl.Reinforcement(selection="exploitation")
    eager = there.with_reading(patience=1, decide="robot")
    outcomes = eager.run(there.task, weights.copy(), trials=12, seed=3, stage=2, reinforcement=greedy, learn=False)
    env = SearchEnv(there)
    best, sizes = policy.best(), [len(v) for v in there.task.outputs]
    for trial in range(12):
        _, infos = env.reset(seed=3) if trial == 0 else env.reset()
        steps = losses = 0
        success = False
        while env.agents:
            actions = {agent: np.array(np.unravel_index(best[infos[agent]["input"]], sizes)) for agent in env.agents}
            _, _, terminations, truncations, infos = env.step(actions)
            steps += 1
            losses += sum(info["lost"] for info in infos.values())
            success = (
                not env.agents
                and not any(truncations.values())
                and any(terminations[a] and not infos[a]["lost"] for a in terminations)
            )
        assert success == outcomes.success[trial]
        assert (steps if success else there.limit) == outcomes.steps[trial]
        if reading.engage == "crossing" or not reading.drill:
            assert losses == outcomes.losses[trial]


def test_rewards_are_signals_losses_and_the_end() -> None:
    env = SearchEnv(mission(), loss_reward=-7.0, success_reward=100.0)
    signals = env.task.signal_table()
    rng = np.random.default_rng(0)
    lost = finished = 0
    for seed in range(30):
        observations, infos = env.reset(seed=seed)
        assert set(observations) == set(env.possible_agents)
        steps = 0
        while env.agents:
            actions = {
                a: np.array([rng.random() < 0.9, rng.random() < 0.5, rng.integers(11)], dtype=int) for a in env.agents
            }
            expected = {
                a: signals[infos[a]["input"], np.ravel_multi_index(tuple(actions[a]), (2, 2, 11))] for a in env.agents
            }
            before = observations
            observations, rewards, terminations, truncations, infos = env.step(actions)
            steps += 1
            won = not env.agents and not any(truncations.values()) and not all(i["lost"] for i in infos.values())
            for agent, reward in rewards.items():
                if infos[agent]["lost"]:
                    lost += 1
                    expected[agent] -= 7.0
                    assert (observations[agent] == before[agent]).all(), "a lost robot keeps the last that it saw"
                    assert terminations[agent]
                elif won:
                    finished += 1
                    expected[agent] += 100.0 * (1 - steps / 150)
                assert reward == pytest.approx(expected[agent])
                assert env.observation_space(agent).contains(observations[agent])
    assert lost > 0
    assert finished > 0


def test_a_missing_or_wrong_action_is_named() -> None:
    env = SearchEnv(mission())
    env.reset(seed=0)
    good = {agent: np.array([1, 0, 5]) for agent in env.agents}
    with pytest.raises(TaskliftError, match="for 'scout_2', found None"):
        env.step({a: v for a, v in good.items() if a != "scout_2"})
    with pytest.raises(TaskliftError, match="for 'weapon_6'"):
        env.step(good | {"weapon_6": [2, 0, 0]})
    assert env.state().shape == (7,)
