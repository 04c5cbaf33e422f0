"""Speed of the simulator: the paper's cell, robot-steps per second, growth with robots and with the map.

Run with ``make bench``. Everything is measured on one core after compilation, as the best of several rounds; a
robot-step is one living robot in one step, and V's trials with MV = 0 (nobody moves) are left out.
"""

from __future__ import annotations

import sys
import time
from pathlib import Path

import numpy as np

from tasklift.building import kernel
from tasklift.building.generate import generate
from tasklift.building.mission import Mission
from tasklift.building.reading import PRESETS
from tasklift.building.search import search_only
from tasklift.building.team import SCOUT, WEAPON
from tasklift.learning.reinforcement import Reinforcement, reinforce, sweep
from tasklift.studies.arms import PRIOR
from tasklift.tasks.policy import Policy

sys.path.insert(0, str(Path(__file__).parents[1] / "tests"))
from oracle import Oracle

ROUNDS = 5


def best(action):
    """Return the least seconds that an action took, and what it returned."""
    least, result = float("inf"), None
    for _ in range(ROUNDS):
        start = time.perf_counter()
        result = action()
        least = min(least, time.perf_counter() - start)
    return least, result


def cell(mission):
    """V's 220 traversals, then direct, copy and copy+prior for 100 trials each."""
    v = sweep(mission.without_hostiles(), search_only(mission.task), repeats=5, seed=0)
    starts = (Policy.equal(mission.task), v.extend(mission.task), v.extend(mission.task, prior=PRIOR))
    return [reinforce(mission, start, trials=100) for start in starts]


def robot_steps(mission, task, outputs, trials, weights=None):
    """Return (robot-steps, seconds) of a run; ``outputs`` as in a sweep, or None."""
    simulator = mission.simulator
    learner = simulator.learner(task, Reinforcement(), sweep=outputs is not None)
    fixed = np.full(trials, -1) if outputs is None else outputs
    stage_key, place_key = simulator.keys(0, 2)
    table, left = np.zeros((len(fixed), 7), np.int64), np.zeros((len(fixed), len(mission.team)), np.int64)

    def run():
        lane = simulator.lane(np.full(task.shape, 1.5) if weights is None else weights.copy())
        kernel.run_trials(
            simulator.world, simulator.rules, learner, lane, stage_key, place_key, 0, fixed, -1, table, left
        )
        return int(lane.count["robot_steps"][0])

    seconds, steps = best(run)
    return steps, seconds


def rate(mission):
    """Return robot-steps per second over V's moving trials and three arms, as they mix in a cell."""
    v_task = search_only(mission.task)
    v = sweep(mission.without_hostiles(), search_only(mission.task), repeats=5, seed=0)
    moving = [a for a in range(v_task.shape[1]) if v_task.output_values(a)["MV"] == 1]
    parts = [robot_steps(mission.without_hostiles(), v_task, np.array(moving * 5), 0)]
    for start in (Policy.equal(mission.task), v.extend(mission.task), v.extend(mission.task, prior=PRIOR)):
        parts.append(robot_steps(mission, mission.task, None, 100, start.weights))
    return sum(steps for steps, _ in parts) / sum(seconds for _, seconds in parts)


def oracle_rate(mission):
    """Return robot-steps per second of the plain-Python oracle on the same work (direct, three trials)."""
    task = mission.task
    oracle = Oracle(
        mission,
        np.full(task.shape, 1.5).tolist(),
        [task.output_values(a) for a in range(task.shape[1])],
        lambda seen: ((seen[0] * 2 + seen[1]) * 3 + seen[2]) * 5 + seen[3] - 1,
        task.signal_table().tolist(),
        Reinforcement(),
    )
    start, steps = time.perf_counter(), 0
    for trial in range(3):
        oracle.begin(0, 2, trial)
        while oracle.status() == "on":
            steps += len(oracle.living)
            oracle.step()
        oracle.end(oracle.status() == "success", None, None)
    return steps / (time.perf_counter() - start)


def main():
    building = generate(seed=7)
    for name, reading in PRESETS.items():
        mission = Mission(building, {SCOUT: 10, WEAPON: 5}, reading=reading)
        cell(mission)
        seconds, _ = best(lambda mission=mission: cell(mission))
        print(f"{name}: a cell (220 traversals + 3 x 100 trials) takes {seconds:.3f} s (bar 0.15)")
        print(f"{name}: {rate(mission) / 1e6:.1f} million robot-steps per second (bar 20)")
    mission = Mission(building, {SCOUT: 10, WEAPON: 5})
    compiled, plain = rate(mission), oracle_rate(mission)
    print(f"kernel / oracle in plain Python, same rules: {compiled / plain:.0f} x")
    base = None
    for robots in (15, 60, 240, 960):
        team = {SCOUT: robots * 2 // 3, WEAPON: robots // 3}
        steps, seconds = robot_steps(Mission(building, team), mission.task, None, 10)
        cost = seconds / steps
        base = base or cost
        print(f"{robots:4d} robots, 43 nodes: cost per robot-step {cost / base:.2f} x that of 15 robots")
    base = None
    for intersections in (21, 84, 336):
        large = generate(intersections, intersections + 4, intersections // 4, intersections // 2, seed=1)
        steps, seconds = robot_steps(Mission(large, {SCOUT: 10, WEAPON: 5}), mission.task, None, 20)
        cost = seconds / steps
        base = base or cost
        print(f"15 robots, {large.n_nodes:4d} nodes: cost per robot-step {cost / base:.2f} x that of the smallest")


if __name__ == "__main__":
    main()
