"""Speed of the simulator: the paper's cell, robot-steps per second, growth with robots and with the map.

Run with ``make bench``. Everything is measured on one core after compilation, as the best of several rounds; a
robot-step is one living robot in one step, and V's trials with MV = 0 (nobody moves) are left out.
"""

from __future__ import annotations

import statistics
import sys
import time
from dataclasses import replace
from functools import partial
from pathlib import Path

import numpy as np

import tasklift as tl
from tasklift.building.generate import generate
from tasklift.building.graph import Building
from tasklift.building.mission import Mission
from tasklift.building.reading import PRESETS
from tasklift.building.search import search_only
from tasklift.building.team import SCOUT, WEAPON
from tasklift.building.variables import TABLE_I
from tasklift.learning.reinforcement import Reinforcement
from tasklift.processes import cores
from tasklift.studies.arms import PRIOR

sys.path.insert(0, str(Path(__file__).parents[1] / "tests"))
from oracle import Oracle

ROUNDS, TURNS = 5, 5


def best(action):
    """Return the least seconds that an action took, and what it returned."""
    least, result = float("inf"), None
    for _ in range(ROUNDS):
        start = time.thread_time()  # of this core's time, so that other programs matter less
        result = action()
        least = min(least, time.thread_time() - start)
    return least, result


def source(mission):
    """Return V's policy: every output for whole trials, five times over."""
    return tl.sweep(mission.without_hostiles(), search_only(mission.task), repeats=5, seed=0)


def cell(mission):
    """V's 220 traversals, then direct, copy and copy+prior for 100 trials each."""
    v = source(mission)
    starts = (tl.Policy.equal(mission.task), v.extend(mission.task), v.extend(mission.task, prior=PRIOR))
    return [tl.reinforce(mission, start, trials=100) for start in starts]


def robot_steps(mission, task, outputs, trials, weights=None):
    """Return (robot-steps, seconds) of a run; ``outputs`` as in a sweep, or None."""
    simulator = mission.simulator
    learner = simulator.learner(task, Reinforcement(), sweep=outputs is not None)
    fixed = np.full(trials, -1) if outputs is None else outputs
    keys, jobs, done = np.array([simulator.keys(0, 2)]), np.array([[0, 0, len(fixed)]]), np.zeros((1, 2), np.int64)
    table, left = np.zeros((1, len(fixed), 7), np.int64), np.zeros((1, len(fixed), len(mission.team)), np.int64)

    def run():
        lane = simulator.lane(task.shape)
        start = np.full((1, *task.shape), 1.5) if weights is None else weights[None].copy()
        taken = np.zeros(1, np.int64)
        simulator.kernel.run(
            simulator.world, simulator.rules, learner, lane, keys, 0, fixed, -1, start, jobs, taken, table, left, done
        )  # fmt: skip
        return int(lane.count["robot_steps"][0])

    seconds, steps = best(run)
    return steps, seconds


def rate(mission):
    """Return robot-steps per second over V's moving trials and three arms, as they mix in a cell."""
    v_task, v = search_only(mission.task), source(mission)
    moving = [a for a in range(v_task.shape[1]) if v_task.output_values(a)["MV"] == 1]
    parts = [robot_steps(mission.without_hostiles(), v_task, np.array(moving * 5), 0)]
    for start in (tl.Policy.equal(mission.task), v.extend(mission.task), v.extend(mission.task, prior=PRIOR)):
        parts.append(robot_steps(mission, mission.task, None, 100, start.weights))
    return sum(steps for steps, _ in parts) / sum(seconds for _, seconds in parts)


def all_cores(mission, runs, trials):
    """Return how many times the work of one core all do in the same time of the clock; ``runs`` per core and call."""

    def seconds(threads):
        seeds, start = list(range(runs * threads)), time.perf_counter()
        tables = np.full((len(seeds), *mission.task.shape), 1.5)
        key = {"stage": 2, "reinforcement": Reinforcement(), "threads": threads}
        mission.run_many(mission.task, tables, trials=trials, seeds=seeds, **key)
        return (time.perf_counter() - start) / len(seeds)

    return statistics.median(seconds(1) / seconds(cores()) for _ in range(4 * TURNS))


def python_overhead(mission):
    """Return microseconds per episode of `evaluate` beyond the kernel: episodes of one step, all included."""
    short = Mission(mission.building, mission.team, limit=1)
    tables = np.ones((100, *short.task.shape))
    seconds, _ = best(lambda: short.evaluate(tables, 1000, threads=1))
    return 1e6 * seconds / 100_000


def tiled(copies):
    """Return as many copies of a building in a row, joined at their starts."""
    one, every = generate(seed=7), np.arange(copies)
    starts = one.start + one.n_nodes * every
    return Building(
        "tiled", np.tile(one.kind, copies), np.tile(one.feature_class, copies),
        (one.position_m + 100.0 * np.stack([every, 0 * every], axis=1)[:, None]).reshape(-1, 2),
        np.tile(one.area_m2, copies), np.tile(one.obstacles, copies),
        np.concatenate([(one.edges + one.n_nodes * every[:, None, None]).reshape(-1, 2),
                        np.stack([starts[:-1], starts[1:]], axis=1)]),
        np.concatenate([np.tile(one.length_m, copies), np.full(copies - 1, 100.0)]),
        np.concatenate([np.tile(one.width_m, copies), np.full(copies - 1, 2.0)]), start=one.start,
    )  # fmt: skip


def lane_cost(mission, lanes):
    """Return seconds per episode of many policies in one call; few outputs, so that their tables fit the memory."""
    short = replace(mission, limit=100)
    tables = np.ones((lanes, *(task := short.task.simplify(fix={"CA": 0.5, "WPN": 0})).shape))
    trials = max(1, 1000 // lanes)
    key = {"stage": 2, "reinforcement": Reinforcement(), "learn": False, "threads": 1}
    seconds, _ = best(lambda: short.run_many(task, tables, trials=trials, seeds=list(range(lanes)), **key))
    return seconds / (lanes * trials)


def cart_pole_rate(copies=4096, steps=50):
    """Return environment steps per second and core of Gymnasium's NumPy-vectorised CartPole."""
    import gymnasium

    env = gymnasium.make_vec("CartPole-v1", num_envs=copies, vectorization_mode="vector_entry_point")
    env.reset(seed=0)
    actions = np.random.default_rng(0).integers(0, 2, (steps, copies))

    def run():
        for chosen in actions:
            env.step(chosen)

    seconds, _ = best(run)
    return copies * steps / seconds


def oracle_rate(mission):
    """Return robot-steps per second of the plain-Python oracle on the same work (direct, three trials)."""
    task = mission.task
    oracle = Oracle(
        mission,
        np.full(task.shape, 1.5).tolist(),
        [task.output_values(a) for a in range(task.shape[1])],
        lambda seen: task.input_index({v.name: v.values[seen[v.name]] for v in task.inputs}),
        task.signal_table().tolist(),
        Reinforcement(),
    )
    start, steps = time.thread_time(), 0
    for trial in range(3):
        oracle.begin(0, 2, trial)
        while oracle.status() == "on":
            steps += len(oracle.living)
            oracle.step()
        oracle.end(oracle.status() == "success", None, None)
    return steps / (time.thread_time() - start)


def growth(name, building, inputs):
    """Print how the cost grows with robots, with the building and with policies in one call.

    The sizes are measured in turns, so that the load hits all of them; the least of each counts.
    """

    def cost(place, team, trials, hostiles=1):
        mission = Mission(place, team, hostiles, inputs=inputs)
        steps, seconds = robot_steps(mission, mission.task, None, trials)
        return seconds / steps

    teams = {n: {SCOUT: n * 2 // 3, WEAPON: n - n * 2 // 3} for n in (1, 15, 60, 240, 960, 10_000)}
    places = {place.n_nodes: place for place in map(tiled, (1, 8, 80, 232))}  # a building has at most 10,000 nodes
    mission = Mission(building, teams[15], inputs=inputs)
    costs = {
        "robots": {n: partial(cost, building, team, max(1, 1000 // n), min(1, n - 1)) for n, team in teams.items()},
        "nodes": {n: partial(cost, place, teams[15], 20) for n, place in places.items()},
        "policies in one call": {n: partial(lane_cost, mission, n) for n in (1, 100, 10_000, 100_000)},
    }
    for what, sizes in costs.items():
        rounds = [{n: measure() for n, measure in sizes.items()} for _ in range(TURNS)]
        found = {n: min(turn[n] for turn in rounds) for n in sizes}
        least = min(found.values())
        print(f"{name}, cost by {what}: " + ", ".join(f"{n:,}: {c / least:.2f}" for n, c in found.items()), flush=True)


def main():
    building = generate(seed=7)
    for name, reading in PRESETS.items():
        mission = Mission(building, {SCOUT: 10, WEAPON: 5}, reading=reading)
        cell(mission)
        seconds, _ = best(lambda mission=mission: cell(mission))
        print(f"{name}: a cell (220 traversals + 3 x 100 trials) takes {seconds:.3f} s (bar 0.15)")
        pairs = [(rate(mission), cart_pole_rate()) for _ in range(TURNS)]  # in turns, so that the load hits both
        speed, other = map(max, zip(*pairs, strict=True))
        print(f"{name}: {speed / 1e6:.1f} million robot-steps per second (goal 66)")
        for runs, trials in ((64, 100), (16, 1)):
            times = all_cores(mission, runs, trials)
            print(f"{name}: {times:.2f} x on {cores()} cores, {runs} runs of {trials} trials each (goal 1.85 on two)")
        print(f"{name}: {speed / other:.2f} x the steps per second of vectorised CartPole in the same run (goal 3)")
    print(f"evaluate: {python_overhead(mission):.2f} us per episode of one step, the kernel included (bar 1 beyond it)")
    mission = Mission(building, {SCOUT: 10, WEAPON: 5})
    compiled, plain = rate(mission), oracle_rate(mission)
    print(f"kernel / oracle in plain Python, same rules: {compiled / plain:.0f} x")
    for name, inputs in (("Table I", TABLE_I), ("Table I and WAITED", [*TABLE_I, "WAITED"])):
        growth(name, building, inputs)
    lane = mission.simulator.lane(mission.task.shape)
    beyond = sum(part.nbytes for part in lane) - lane.weights.nbytes
    print(f"memory of a lane beyond its weights: {beyond / 1024:.1f} KiB (bar 64)")


if __name__ == "__main__":
    main()
