"""Measure the simulator beside its peers, in the same run: the table of ``docs/performance.md``.

    python benchmarks/peers.py                   all of them, each in an environment of its own
    python benchmarks/peers.py rware pogema      some of them
    python benchmarks/peers.py --page docs/performance.md

Environments are installed below ``build/peers`` at the first run; the largest, with PyTorch or JAX, take some minutes
and gigabytes. Runs are interleaved: every peer once, then every peer again. The figure is the median of agent-steps per
second of processor time. A peer that cannot be installed or run is listed with the reason.
"""

from __future__ import annotations

import argparse
import json
import os
import shutil
import statistics
import subprocess
import sys
from dataclasses import dataclass
from pathlib import Path

ROOT = Path(__file__).parents[1]
HOMES = ROOT / "build" / "peers"
ROUNDS = 5
CORES = os.cpu_count() or 1
BATCHES = (64, 1024, 4096)

#: What every peer's script ends with: run ``steps`` calls of ``step()`` until a second is over, and print the figure.
MEASURE = """
import json, time
step()  # compiles
begun, wall, calls = time.process_time(), time.perf_counter(), 0
while time.process_time() - begun < SECONDS:
    step()
    calls += 1
spent, passed = time.process_time() - begun, time.perf_counter() - wall
print(json.dumps({"per_cpu_s": calls * AGENT_STEPS / spent, "per_wall_s": calls * AGENT_STEPS / passed}))
"""


@dataclass(frozen=True)
class Peer:
    """One environment: what to install, what one step of it does, and a script that defines ``step``.

    ``single`` and ``batch`` define ``AGENT_STEPS`` (agent-steps per call) and ``step()``. None: the environment is
    not run alone, or not in batches.
    """

    name: str
    package: str
    does: str
    agents: str
    single: str | None
    batch: str | None = None


PARALLEL = """
env.reset(seed=0)
agents = list(env.possible_agents)
spaces = [env.action_space(agent) for agent in agents]
AGENT_STEPS = 200 * len(agents)
def step():
    for _ in range(200):
        if not env.agents:
            env.reset()
        env.step({agent: space.sample() for agent, space in zip(agents, spaces) if agent in env.agents})
"""

#: For environments in JAX: 20 steps of a whole batch in one compiled call, by the script's `one(state, key)`.
SCANNED = """
LENGTH = 20
@jax.jit
def many(states, keys):
    return jax.vmap(lambda s, k: jax.lax.scan(one, s, jax.random.split(k, LENGTH))[0])(states, keys)
key = jax.random.PRNGKey(0)
states = states_of(jax.vmap(env.reset)(jax.random.split(key, BATCH)))
AGENT_STEPS = 15 * BATCH * LENGTH
def step():
    global states, key
    key, sub = jax.random.split(key)
    states = many(states, jax.random.split(sub, BATCH))
    jax.block_until_ready(states)
"""

PEERS = (
    Peer(
        "pursuit", "pettingzoo[sisl]", "grid pursuit with local pictures (PettingZoo)", "15",
        "from pettingzoo.sisl import pursuit_v5\nenv = pursuit_v5.parallel_env(n_pursuers=15)\n" + PARALLEL,
    ),
    Peer(
        "simple_spread", "mpe2", "points in a plane, collisions (MPE2)", "15",
        "from mpe2 import simple_spread_v3\nenv = simple_spread_v3.parallel_env(N=15)\n" + PARALLEL,
    ),
    Peer(
        "rware", "rware", "warehouse robots on a grid (RWARE)", "15",
        """
import gymnasium, rware
from rware.warehouse import Warehouse, RewardType
env = Warehouse(shelf_columns=3, column_height=8, shelf_rows=2, n_agents=15, msg_bits=0, sensor_range=1,
                request_queue_size=15, max_inactivity_steps=None, max_steps=500, reward_type=RewardType.INDIVIDUAL)
env.reset(seed=0)
import numpy as np
rng = np.random.default_rng(0)
AGENT_STEPS = 200 * 15
def step():
    for _ in range(200):
        _, _, done, truncated, _ = env.step(rng.integers(0, 5, 15).tolist())
        if np.all(done) or np.all(truncated):
            env.reset()
""",
    ),
    Peer(
        "pogema", "pogema", "paths of many agents on a grid (POGEMA)", "15",
        """
from pogema import pogema_v0, GridConfig
import numpy as np
env = pogema_v0(GridConfig(num_agents=15, size=32, density=0.2, seed=0, max_episode_steps=500))
env.reset()
rng = np.random.default_rng(0)
AGENT_STEPS = 200 * 15
def step():
    for _ in range(200):
        _, _, done, truncated, _ = env.step(rng.integers(0, 5, 15).tolist())
        if all(done) or all(truncated):
            env.reset()
""",
    ),
    Peer(
        "vmas", "vmas", "points in a plane, vectorised in PyTorch (VMAS)", "15",
        None,
        """
import torch, vmas
torch.set_num_threads(THREADS)
env = vmas.make_env("simple_spread", num_envs=BATCH, device="cpu", n_agents=15, continuous_actions=False, seed=0)
env.reset()
AGENT_STEPS = 15 * BATCH * 5
def step():
    for _ in range(5):
        env.step([env.get_random_action(agent) for agent in env.agents])
""",
    ),
    Peer(
        "jumanji", "jumanji", "warehouse robots on a grid, in JAX (Jumanji RobotWarehouse)", "15",
        None,
        """
import jax, jumanji
from jumanji.environments.routing.robot_warehouse.generator import RandomGenerator
from jumanji.wrappers import AutoResetWrapper
from jumanji.environments import RobotWarehouse
made = RandomGenerator(shelf_rows=2, shelf_columns=3, column_height=8, num_agents=15, sensor_range=1,
                       request_queue_size=15)
env = AutoResetWrapper(RobotWarehouse(generator=made))
def one(state, key):
    action = jax.random.randint(key, (15,), 0, 5)
    return env.step(state, action)[0], None
states_of = lambda reset: reset[0]
""" + SCANNED,
    ),
    Peer(
        "jaxmarl", "jaxmarl", "points in a plane, in JAX (JaxMARL)", "15",
        None,
        """
import jax, jaxmarl
env = jaxmarl.make("MPE_simple_spread_v3", num_agents=15, num_landmarks=15)
def one(carry, key):
    state = carry
    keys = jax.random.split(key, 16)
    actions = {a: env.action_space(a).sample(keys[i]) for i, a in enumerate(env.agents)}
    _, state, _, _, _ = env.step(keys[15], state, actions)
    return state, None
states_of = lambda reset: reset[1]
""" + SCANNED,
    ),
    Peer(
        "gamms", "gamms", "agents and adversaries on a graph (GAMMS)", "15",
        """
import random, gamms
from gamms.typing import SensorType
ctx = gamms.create_context(vis_engine=gamms.visual.Engine.NO_VIS)
side = 7
for n in range(side * side):
    ctx.graph.graph.add_node({"id": n, "x": float(n % side), "y": float(n // side)})
edge = 0
for n in range(side * side):
    for m in [n + 1] * (n % side < side - 1) + [n + side] * (n // side < side - 1):
        for a, b in ((n, m), (m, n)):
            ctx.graph.graph.add_edge({"id": edge, "source": a, "target": b, "length": 1.0})
            edge += 1
ctx.sensor.create_sensor("near", SensorType.NEIGHBOR)
agents = [ctx.agent.create_agent(f"a{i}", start_node_id=i, sensors=["near"]) for i in range(15)]
random.seed(0)
AGENT_STEPS = 100 * 15
def step():
    for _ in range(100):
        for agent in agents:
            state = agent.get_state()
            state["action"] = random.choice(state["sensor"]["near"][1])
            agent.set_state()
""",
    ),
    Peer(
        "cartpole", "gymnasium numpy", "four numbers per environment, in NumPy (Gymnasium's vectorised CartPole)", "1",
        None,
        """
import gymnasium, numpy as np
env = gymnasium.make_vec("CartPole-v1", num_envs=BATCH, vectorization_mode="vector_entry_point")
env.reset(seed=0)
actions = np.random.default_rng(0).integers(0, 2, (50, BATCH))
AGENT_STEPS = 50 * BATCH
def step():
    for action in actions:
        env.step(action)
""",
    ),
)

#: Our own, in the environment that runs this script: with learning on, one policy (a cell of the paper), and many.
OURS = {
    preset: f"""
import numpy as np
import tasklift as tl
from tasklift.building import kernel
from tasklift.building.reading import PRESETS
mission = tl.Mission(tl.generate(seed=7), "10+5", 1, PRESETS["{preset}"])
lanes, trials = LANES, 100
weights = np.full((lanes, *mission.task.shape), 1.5)
seeds = list(range(lanes))
def step():
    mission.run_many(mission.task, weights.copy(), trials=trials, seeds=seeds, stage=2,
                     reinforcement=tl.Reinforcement(), threads=THREADS)
# steps of living robots in the same runs, which outcomes do not tell: counted once, by the kernel
simulator = mission.simulator
lane, learner = simulator.lane(mission.task.shape), simulator.learner(mission.task, tl.Reinforcement())
world, rules = simulator.world, simulator.rules
keys = np.array([simulator.keys(seed, 2) for seed in seeds])
jobs = np.array([[run, 0, trials] for run in range(lanes)])
table, left = np.zeros((lanes, trials, 7), np.int64), np.zeros((lanes, trials, 2), np.int64)
drawn, taken, done = np.full(trials, -1), np.zeros(1, np.int64), np.zeros((lanes, 2), np.int64)
kernel.run(world, rules, learner, lane, keys, 0, drawn, -1, weights.copy(), jobs, taken, table, left, done)
AGENT_STEPS = int(lane.count["robot_steps"][0])
"""
    for preset in ("scattered", "cohesive")
}


def install(peer: Peer) -> str:
    """Return the interpreter of a peer's environment, installed at the first call."""
    home = HOMES / peer.name
    python = home / "bin" / "python"
    if not (home / "ready").exists():
        print(f"installing {peer.package} …", file=sys.stderr, flush=True)
        shutil.rmtree(home, ignore_errors=True)
        subprocess.run([sys.executable, "-m", "venv", str(home)], check=True)
        command = [str(python), "-m", "pip", "install", "--quiet", "--disable-pip-version-check", *peer.package.split()]
        done = subprocess.run(command, capture_output=True, text=True, check=False)
        if done.returncode:
            raise RuntimeError(done.stderr.strip().splitlines()[-1] if done.stderr.strip() else "pip failed")
        (home / "ready").touch()
    return str(python)


def version(python: str, package: str) -> str:
    """Return a package's version in an environment."""
    name = package.split()[0].split("[")[0]
    code = f"from importlib.metadata import version; print(version({name!r}))"
    return subprocess.run([python, "-c", code], capture_output=True, text=True, check=True).stdout.strip()


def measure(python: str, script: str, *, cores: int, batch: int, seconds: float) -> float:
    """Return agent-steps per second: of processor time on one core, of the clock on several.

    An environment that is stepped alone runs once on each core.
    """
    copies, threads = (cores, 1) if batch == 1 else (1, cores)
    settings = f"BATCH, LANES, THREADS, SECONDS = {batch}, {16 * threads}, {threads}, {seconds}\n"
    environment = dict(os.environ, OMP_NUM_THREADS=str(threads), MKL_NUM_THREADS=str(threads), JAX_PLATFORMS="cpu")
    environment["XLA_FLAGS"] = f"--xla_cpu_multi_thread_eigen={'true' if threads > 1 else 'false'}"
    running = []
    for copy in range(copies):
        pinned = f"{copy}" if copies > 1 or threads == 1 else f"0-{threads - 1}"
        where = ["taskset", "--cpu-list", pinned] if shutil.which("taskset") else []
        running.append(
            subprocess.Popen(
                [*where, python, "-c", settings + script + MEASURE],
                stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True, env=environment,
            )
        )  # fmt: skip
    total = 0.0
    for process in running:
        out, err = process.communicate(timeout=600)
        if process.returncode:
            raise RuntimeError((err.strip().splitlines() or ["no output"])[-1][:200])
        found = json.loads(out.strip().splitlines()[-1])
        total += found["per_cpu_s" if cores == 1 else "per_wall_s"]
    return total


@dataclass(frozen=True)
class Job:
    """One line of the table, before it is measured."""

    name: str
    way: str
    peer: Peer | None
    python: str
    script: str
    batch: int


def jobs(names: list[str]) -> list[Job]:
    """Return what is measured: every peer alone and in batches, and our own kernel under both presets."""
    found = []
    if not names or "tasklift" in names:
        for preset, script in OURS.items():
            found.append(Job(f"tasklift, {preset}", "16 runs per core", None, sys.executable, script, 0))
    for peer in PEERS:
        if names and peer.name not in names:
            continue
        try:
            python = install(peer)
            name = f"{peer.name} {version(python, peer.package)}"
        except (RuntimeError, subprocess.CalledProcessError) as error:
            print(f"{peer.name}: left out, {error}", file=sys.stderr)
            continue
        if peer.single is not None:
            found.append(Job(name, "single", peer, python, peer.single, 1))
        if peer.batch is not None:
            found += [Job(name, f"{batch:,} at once", peer, python, peer.batch, batch) for batch in BATCHES]
    return found


def table(rows: dict[Job, dict[int, list[float]]]) -> str:
    """Return the Markdown table in million agent-steps per second: medians, best batch, ratios to our slower preset."""
    best: dict[str, tuple[Job, dict[int, float]]] = {}
    for job, by_cores in rows.items():
        medians = {cores: statistics.median(found) for cores, found in by_cores.items() if found}
        if medians and (job.name not in best or medians.get(1, 0) > best[job.name][1].get(1, 0)):
            best[job.name] = (job, medians)
    ours = min((found.get(1, 0) for job, found in best.values() if job.peer is None), default=0)
    lines = [
        "| environment | what one step of it does | agents | way | one core | all cores | tasklift, one core |",
        "|---|---|---|---|---|---|---|",
    ]
    for name, (job, medians) in sorted(best.items(), key=lambda item: -item[1][1].get(1, 0)):
        does = job.peer.does if job.peer else "a building search: maps, doors, fights, learning in every decision"
        agents = job.peer.agents if job.peer else "15"
        one, many = medians.get(1), medians.get(CORES)
        ratio = f"{float(f'{ours / one:.3g}'):,g} ×" if one and job.peer else ""
        shown = [f"{value / 1e6:.3g}" if value else "–" for value in (one, many)]
        lines.append(f"| {name} | {does} | {agents} | {job.way} | {shown[0]} | {shown[1]} | {ratio} |")
    return "\n".join(lines)


def main() -> None:
    """Measure, round by round, and print the table; with --page put it between a page's marks."""
    asked = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    asked.add_argument("names", nargs="*", help="tasklift and peers; default: all")
    asked.add_argument("--rounds", type=int, default=ROUNDS)
    asked.add_argument("--seconds", type=float, default=2.0, help="processor time of each measurement")
    asked.add_argument("--page", type=Path, help="a Markdown page, to put the table between its marks")
    options = asked.parse_args()
    found: dict[Job, dict[int, list[float]]] = {job: {1: [], CORES: []} for job in jobs(options.names)}
    for turn in range(options.rounds):
        for job, by_cores in found.items():
            for cores in by_cores:
                if turn and not by_cores[cores]:
                    continue  # it failed in the first round, and the reason was printed
                try:
                    got = measure(job.python, job.script, cores=cores, batch=job.batch, seconds=options.seconds)
                except (RuntimeError, subprocess.TimeoutExpired) as error:
                    print(f"{job.name}, {job.way}, {cores} core(s): {error}", file=sys.stderr)
                    continue
                by_cores[cores].append(got)
                print(f"{turn + 1} {job.name}, {job.way}, {cores} core(s): {by_cores[cores][-1]:,.0f}", flush=True)
    made = table(found)
    print(made)
    if options.page is not None:
        text = options.page.read_text(encoding="utf-8")
        before, begin, rest = text.partition("<!-- peers -->\n")
        _, end, after = rest.partition("<!-- end of peers -->")
        if not (begin and end):
            sys.exit(f"{options.page}: expected the marks <!-- peers --> and <!-- end of peers -->")
        options.page.write_text(f"{before}{begin}\n{made}\n\n{end}{after}", encoding="utf-8")


if __name__ == "__main__":
    main()
