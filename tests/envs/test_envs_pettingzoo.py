"""The building search as a ParallelEnv: PettingZoo's own tests, and step for step the simulator."""

from __future__ import annotations

from functools import partial

import numpy as np
import pytest

import tasklift as tl
from tasklift.building import COHESIVE, SCATTERED, SCOUT, WEAPON, Mission, Reading, generate
from tasklift.errors import TaskliftError

pytest.importorskip("pettingzoo")
pytest.importorskip("supersuit")

from pettingzoo.test import api_test, parallel_api_test, parallel_seed_test, render_test
from pettingzoo.test.state_test import state_test
from supersuit import (
    agent_indicator_v0,
    black_death_v3,
    dtype_v0,
    flatten_v0,
    frame_stack_v1,
    pad_observations_v0,
)

from tasklift.envs.pettingzoo import SearchEnv

SMALL = "tasklift/SearchSmall-v0"
BUILDING = generate(intersections=9, corridors=11, rooms=3, features=6, doors=3, seed=5)


def mission(reading: Reading = SCATTERED, **options) -> Mission:
    return Mission(BUILDING, {SCOUT: 4, WEAPON: 3}, reading=reading, **({"hostiles": 1, "limit": 150} | options))


def test_pettingzoos_own_tests() -> None:
    parallel_api_test(SearchEnv(mission()), num_cycles=400)
    parallel_seed_test(lambda: SearchEnv(mission()), num_cycles=60)


@pytest.mark.parametrize("patience", [1, 7, 60])
@pytest.mark.parametrize("reading", [SCATTERED, COHESIVE, Reading(drill=True), Reading(suspicion_goal=False)])
def test_step_for_step_it_is_the_simulator(reading: Reading, patience: int) -> None:
    # one heaviest output per input, so that both make the same decisions; the edges are drawn with the same chances
    there = mission(reading)
    weights = np.random.default_rng(1).random(there.task.shape)
    weights[:, :22] *= 0.8  # moving is heavier more often than not
    policy = tl.Policy(there.task, weights)
    greedy = tl.Reinforcement(selection="exploitation")
    eager = there.with_reading(patience=patience, decide="robot")
    outcomes = eager.run(there.task, weights.copy(), trials=12, seed=3, stage=2, reinforcement=greedy, learn=False)
    env, rng = SearchEnv(there, patience=patience), np.random.default_rng(2)
    best, sizes = policy.best(), [len(v) for v in there.task.outputs]
    for trial in range(12):
        _, infos = env.reset(seed=3) if trial == 0 else env.reset()
        losses, success = 0, False
        while env.agents:
            outputs = {a: best[infos[a]["input"]] if infos[a]["decides"] else rng.integers(44) for a in env.agents}
            actions = {agent: np.unravel_index(output, sizes) for agent, output in outputs.items()}
            _, _, terminations, truncations, infos = env.step(actions)
            losses += sum(info["lost"] for info in infos.values())
            success = (
                not env.agents
                and not any(truncations.values())
                and any(terminations[a] and not infos[a]["lost"] for a in terminations)
            )
        assert success == outcomes.success[trial]
        steps = env._batch.lanes.count["step"].item()  # of the mission; one of the environment may be several
        assert (steps if success else there.limit) == outcomes.steps[trial]
        if reading.engage == "crossing" or not reading.drill:
            assert losses == outcomes.losses[trial]


def test_rewards_are_work_done_losses_signals_and_the_end() -> None:
    pay = {"progress_reward": 3.0, "loss_reward": -7.0, "success_reward": 100.0, "signal_weight": 0.5}
    env = SearchEnv(mission(), **pay)
    signals, rng = env.task.signal_table(), np.random.default_rng(0)
    lost = finished = 0
    for seed in range(30):
        observations, infos = env.reset(seed=seed)
        assert set(observations) == set(env.possible_agents)
        steps, total = 0, 0.0
        while env.agents:
            actions = {
                a: np.array([rng.random() < 0.9, rng.random() < 0.5, rng.integers(11)], dtype=int) for a in env.agents
            }
            local = {
                a: signals[infos[a]["input"], np.ravel_multi_index(tuple(actions[a]), (2, 2, 11))] for a in env.agents
            }
            observations, rewards, terminations, truncations, infos = env.step(actions)
            steps += 1
            won = not env.agents and not any(truncations.values()) and not all(i["lost"] for i in infos.values())
            work = set()
            for agent, reward in rewards.items():
                rest = reward - 0.5 * local[agent]
                if infos[agent]["lost"]:
                    lost += 1
                    assert rest == pytest.approx(-7.0)
                    assert not observations[agent].any()
                    assert terminations[agent]
                else:
                    finished += won
                    work.add(round(rest - won * 100.0 * (1 - steps / 300), 9))
                assert env.observation_space(agent).contains(observations[agent])
            assert len(work) <= 1, "the work done is everybody's"
            total += max(work, default=0.0)
        assert 0 <= total <= 3.0 + 1e-6
        assert not won or total == pytest.approx(3.0)
    assert lost > 0
    assert finished > 0


NOT_VALUES: list = [
    [0.5, 0, 0], [1, 0], [1, 0, 5, 0], [[1, 0, 5]], {0, 1, 5}, {1: 0, 0: 1, 5: 5}, b"\x01\x00\x05", [True, False, 5], 5,
    np.array([1.0, 0, 5]), np.array([True, False, True]), [np.nan, 0, 5], [2**65, 0, 0],
]  # fmt: skip


def test_wrong_actions_are_named_before_anything_changes() -> None:
    env = SearchEnv(mission())
    with pytest.raises(TaskliftError, match=r"call reset\(\) before"):
        env.step({})
    env.reset(seed=0)
    good = {agent: np.array([1, 0, 5]) for agent in env.agents}
    for bad, message in (
        ({a: v for a, v in good.items() if a != "scout_2"}, "for 'scout_2', found None"),
        (good | {"weapon_6": [2, 0, 0]}, "for 'weapon_6'"),
        *((good | {"weapon_6": bad}, "for 'weapon_6'") for bad in NOT_VALUES),
        ([1, 0, 5], "expected a dict"),
        (None, "expected a dict"),
        (good | {"weapon_7": [0, 0, 0]}, "'weapon_7' is unknown"),
    ):
        with pytest.raises(TaskliftError, match=message):
            env.step(bad)
    flat = SearchEnv(mission(), act="flat")
    flat.reset(seed=0)
    for bad_action in (44, -1, 1.5, 1.0, np.nan, True, np.bool_(True), np.array([3]), np.float64(2), "go", None):
        with pytest.raises(TaskliftError, match="for 'scout_0'"):
            flat.step(dict.fromkeys(flat.agents, bad_action))
    for option, message in (({"los_reward": 1.0}, "'los_reward'.*loss_reward"), ({"loss_reward": "1"}, "loss_reward")):
        with pytest.raises(TaskliftError, match=message):
            SearchEnv(mission(), **option)
    rng = np.random.default_rng(0)
    while len(env.agents) == 7:
        env.step({a: rng.integers([2, 2, 11]) | [1, 0, 0] for a in env.agents})
    if env.agents:
        gone = next(a for a in env.possible_agents if a not in env.agents)
        with pytest.raises(TaskliftError, match=f"'{gone}' is lost"):
            env.step({a: np.array([1, 0, 5]) for a in [*env.agents, gone]})
    while env.agents:
        env.step({a: np.array([1, 0, 5]) for a in env.agents})
    with pytest.raises(TaskliftError, match="is over"):
        env.step(good)


def test_whoever_takes_turns_is_told_of_wrong_actions_at_once() -> None:
    env = tl.make(SMALL, api="aec", act="flat")
    with pytest.raises(TaskliftError, match=r"call reset\(\) before"):
        env.step(0)
    env.reset(seed=0)
    rng, lost = np.random.default_rng(0), 0
    while env.agents:
        agent = env.agent_selection
        done = env.terminations[agent] or env.truncations[agent]
        for bad in (3,) if done else (44, 1.0, True, None):
            with pytest.raises(TaskliftError, match=f"{agent}"):
                env.step(bad)
            assert env.agent_selection == agent
        lost += done
        env.step(None if done else rng.integers(22, 44))
    assert lost == 5
    with pytest.raises(TaskliftError, match="is over"):
        env.step(0)


def test_unseeded_environments_are_different_and_seeded_ones_the_same() -> None:
    def seen(*seed: int) -> list[float]:
        env = SearchEnv(mission(), act="flat")
        env.reset(*seed)
        rng = np.random.default_rng(0)
        path = []
        for _ in range(40):
            if env.agents:
                env.step({a: int(rng.integers(22, 44)) for a in env.agents})
                path.append(env.state().sum() + env.state() @ np.arange(len(env.state())))
        return path

    assert seen(3) == seen(3)
    assert len({tuple(seen()) for _ in range(4)}) > 1


# the AEC test would rather see no MultiDiscrete, which is what "values" are
@pytest.mark.filterwarnings("ignore:(Observation|Action) (space for each agent|numpy array is all)")
@pytest.mark.parametrize("act", ["values", "flat"])
@pytest.mark.parametrize("observe", ["values", "onehot", "local"])
def test_every_observation_and_action_passes_pettingzoos_tests(observe, act) -> None:
    make = partial(tl.make, SMALL, observe=observe, act=act)
    parallel_api_test(make(), num_cycles=100)
    parallel_seed_test(make, num_cycles=30)
    api_test(make(api="aec"), num_cycles=60)
    state_test(make(api="aec"), make())


WRAPPERS = [
    black_death_v3,
    pad_observations_v0,
    agent_indicator_v0,
    flatten_v0,
    partial(frame_stack_v1, stack_size=2),
    partial(dtype_v0, dtype=np.float32),
]


@pytest.mark.parametrize("wrap", WRAPPERS)
def test_supersuit_wraps_it(wrap) -> None:
    env = wrap(tl.make(SMALL, observe="onehot", act="flat"))
    for seed in range(3):
        env.reset(seed=seed)
        while env.agents:
            env.step({agent: env.action_space(agent).sample() for agent in env.agents})


def test_it_is_drawn(monkeypatch) -> None:
    matplotlib = pytest.importorskip("matplotlib")
    monkeypatch.setattr(matplotlib.rcParams, "backend", "Agg", raising=False)
    matplotlib.use("Agg")
    render_test(lambda render_mode=None: tl.make(SMALL, api="aec", render_mode=render_mode))
    env = tl.make(SMALL, act="flat", render_mode="rgb_array")
    env.reset(seed=0)
    first = env.render()
    for _ in range(10):
        env.step(dict.fromkeys(env.agents, 27))
    assert first.dtype == np.uint8
    assert first.shape == env.render().shape
    assert not np.array_equal(first, env.render())
    env.close()


def test_a_local_observation_says_what_is_around() -> None:
    env = SearchEnv(mission(), observe="local", patience=60)
    observations, _ = env.reset(seed=0)
    assert observations["weapon_6"][13] == pytest.approx(6 / 7)
    seen = observations["scout_0"][14:]
    corridors = BUILDING.indptr[BUILDING.start + 1] - BUILDING.indptr[BUILDING.start]
    assert seen[:6] == pytest.approx([0, 0, 1, 0, 1, 3 / 7]), "an unarmed robot at the start, where all are one team"
    assert seen[6:14].sum() == corridors
    assert not seen[14:-1].any(), "nobody knows or came by any of them, or was alerted"
    assert seen[-1] == 1, "everybody decides"
    observations = env.step({a: np.array([0, 0, 5]) for a in env.agents})[0]
    assert observations["weapon_4"][14:18] == pytest.approx([1, 60 / 150, 1, 60 / 80])
    known = alerted = 0
    for _ in range(300):
        if not env.agents:
            observations, infos = env.reset()
        observations, *_, infos = env.step({a: np.array([1, 0, 5]) for a in env.agents})
        for agent in env.agents:
            seen = observations[agent]
            assert seen[-1] == infos[agent]["decides"]
            assert not seen[-2] or not seen[0], "who was alerted of a feature suspects danger"
            known, alerted = known + seen[28:36].any(), alerted + seen[-2]
    assert known > 50
    assert alerted > 5


def test_declared_variables_are_what_is_seen_and_done() -> None:
    there = Mission(BUILDING, "4+3", limit=60, inputs=["DL", "FTR", "TEAM"], outputs=["MV", "WPN", "CA", "BACK"])
    env = SearchEnv(there, observe="onehot", act="flat")
    seen, _ = env.reset(seed=0)
    assert seen["scout_0"].tolist() == [1, 0, 0, 1, 0, 0, 0, 0, 0, 0, 0, 1]
    assert env.action_space("scout_0").n == there.task.shape[1]
    parallel_api_test(env, num_cycles=30)
