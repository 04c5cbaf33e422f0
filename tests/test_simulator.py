"""The compiled simulator against the oracle, and what must hold in every trial."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from oracle import Oracle
from worlds import missions, readings, reinforcements

from tasklift.building import kernel
from tasklift.building.mission import search_only

CASES = settings(max_examples=500, deadline=None, derandomize=True)


def random_weights(rng, shape):
    """Rows of every sort: all zero, one hot, even, ragged."""
    weights = rng.uniform(0, 3, shape) * rng.integers(0, 2, shape)
    weights[rng.integers(0, shape[0], 3)] = 0.0
    weights[rng.integers(0, shape[0], 3)] = 1.5
    return np.ascontiguousarray(weights)


def oracle_for(mission, task, weights, reinforcement, sweep, learn):
    root = mission.task
    every_credit = sweep and reinforcement.sweep_credit == "all"
    return Oracle(
        mission,
        weights.tolist(),
        [root.output_values(int(a)) for a in task.output_map],
        lambda seen: int(task.input_map[root.input_index(dict(zip(("DL", "GL", "nWPN", "FTR"), seen, strict=True)))]),
        (task.rule_table() if every_credit else task.signal_table()).tolist(),
        reinforcement,
        learn=learn,
        sweep=sweep,
        time_reward=task.time_reward,
    )


def assert_same_state(mission, lane, oracle):
    """Compare everything that both know, to the last bit."""
    building = mission.building
    count = lane.count[0]
    for mine, theirs in zip(lane.robots, oracle.robots, strict=True):
        assert bool(mine["alive"]) == theirs.alive
        if not theirs.alive:
            continue
        edge = None if mine["half"] < 0 else int(building.edge_of[mine["half"]])
        assert (int(mine["node"]), edge, int(mine["progress"])) == (theirs.node, theirs.edge, theirs.progress)
        dl, gl, weapons, ftr = theirs.input
        assert int(mine["row"]) == ((dl * 2 + gl) * 3 + weapons) * 5 + ftr - 1
        assert (int(mine["pair_row"]), int(mine["out"])) == theirs.used
        about = None if mine["alert"] < 0 else int(mine["alert"])
        assert (int(mine["dl"]), about) == (theirs.danger, theirs.about)
        assert int(mine["since"]) == theirs.waited
        known = {e for e in range(building.n_edges) if int(lane.maps[theirs.number, e // 64]) >> (e % 64) & 1}
        assert known == theirs.map
    teams = {frozenset(np.flatnonzero((lane.robots["team"] == t) & (lane.robots["alive"] == 1)).tolist())
             for t in range(count["teams"])}
    assert teams == {frozenset(robot.number for robot in team) for team in oracle.teams}
    assert set(np.flatnonzero(lane.sites["hostile"]).tolist()) == oracle.hostiles
    assert set(np.flatnonzero(lane.sites["resolved"]).tolist()) == oracle.resolved
    assert {v: int(n) for v, n in enumerate(lane.sites["unsearched"]) if n} == oracle.unsearched
    assert set(np.flatnonzero(lane.visited).tolist()) == oracle.visited
    assert (count["messages"], count["losses"], count["step"]) == (oracle.messages, oracle.losses, oracle.steps)
    assert lane.weights.tolist() == oracle.weights


def agree(mission, reinforcement, weight_seed, seed, sweep, learn, trials=2):
    """Run kernel and oracle side by side, comparing after every step and every trial."""
    simulator = mission.simulator
    task = search_only(mission.task) if sweep and mission.n_hostiles == 0 else mission.task
    weights = np.maximum(random_weights(np.random.default_rng(weight_seed), task.shape), reinforcement.floor)
    oracle = oracle_for(mission, task, weights, reinforcement, sweep, learn)
    learner = simulator.learner(task, reinforcement, sweep=sweep, learn=learn)
    lane = simulator.lane(weights)
    stage_key, place_key = simulator.keys(seed, 2)
    total = 0
    for trial in range(trials):
        fixed = (weight_seed + trial) % task.shape[1] if sweep else -1
        simulator.begin_trial(lane, stage_key, place_key, trial)
        oracle.begin(seed, 2, trial)
        assert int(lane.count["key"][0]) == oracle.key
        state = 0
        while state == 0:
            state = kernel.step(simulator.world, simulator.rules, learner, lane, fixed)
            oracle.step(None if fixed < 0 else fixed)
            assert_same_state(mission, lane, oracle)
            assert {0: "on", 1: "success", 2: "failure"}[state] == oracle.status()
        steps = kernel.end_trial(
            simulator.rules, learner, lane, state == 1, fixed, total / trial if trial else -1.0
        )
        assert steps == oracle.end(state == 1, fixed, total / trial if trial else None)
        total += steps
        assert lane.weights.tolist() == oracle.weights


@CASES
@given(missions(), reinforcements, st.integers(0, 2**31), st.integers(0, 2**40), st.booleans())
def test_kernel_agrees_with_oracle_when_outputs_are_drawn(mission, reinforcement, weight_seed, seed, learn):
    agree(mission, reinforcement, weight_seed, seed, sweep=False, learn=learn)


@settings(max_examples=80, deadline=None, derandomize=True)
@given(missions(), reinforcements, st.integers(0, 2**31), st.integers(0, 2**40))
def test_kernel_agrees_with_oracle_in_sweeps(mission, reinforcement, weight_seed, seed):
    agree(mission, reinforcement, weight_seed, seed, sweep=True, learn=True)


@settings(max_examples=25, deadline=None, derandomize=True)
@given(missions(most_nodes=90, most_robots=60), reinforcements, st.integers(0, 2**31), st.integers(0, 2**40))
def test_kernel_agrees_with_oracle_on_large_teams_and_buildings(mission, reinforcement, weight_seed, seed):
    agree(mission, reinforcement, weight_seed, seed, sweep=False, learn=True, trials=1)
