"""Machine instructions per robot-step of the compiled simulator, counted by valgrind: they do not depend on the load.

``make instructions`` counts and compares with ``benchmarks/instructions.json``: more than 10 % above fails.
``make instructions ARGS=--record`` writes the file anew; say why in the changelog.
``make instructions ARGS=--parts`` shows by source function where they go in the first episodes, and where valgrind's
simulated processor guesses branches wrong. ``make instructions ARGS=--robots`` counts teams of 1 to 10,000 robots.

The count is the difference between runs of 242 and 42 episodes (trials) of the paper's mission, learning from equal
weights. Only the compiled kernel is counted: the start of Python alone varies by more than a change of the kernel. The
kernel is compiled for a generic processor: valgrind shows programs another processor than the machine has, and counts
would differ between machines.
"""

from __future__ import annotations

import argparse
import ast
import json
import os
import pickle
import re
import shutil
import subprocess
import sys
import tempfile
from bisect import bisect_right
from collections import Counter
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

FEW, MANY = 42, 242
FIRST_EPISODES = {1: 200, 15: 84, 240: 4, 10_000: 1}  # of a team, with --robots
CODE = 2**20  # bytes from the kernel's first instruction on in which nothing else of the process lies
WORKLOADS = ("scattered", "cohesive", "scattered, with a sensor of one's own")
ALLOWED = 1.10
RECORD = Path(__file__).with_suffix(".json")
Line = tuple[int, int, str]  # distance from the kernel's start, instructions executed there, and what else was counted
GENERIC = {"NUMBA_CPU_NAME": "generic", "NUMBA_CPU_FEATURES": "", "PYTHONHASHSEED": "0"}


def work(file: str, episodes: int, machine_code: Path | None = None) -> None:
    """Run episodes of a dumped mission and print the number of robot-steps; what valgrind watches.

    Prints also the address of the compiled code, and writes that to a file if it has just been compiled.
    """
    import numpy as np

    from tasklift.building.inputs import kernel_for

    inputs, world, rules, learner, lane, keys = pickle.loads(Path(file).read_bytes())
    kernel = kernel_for(inputs)
    table, left = np.zeros((1, episodes, 7), np.int64), np.zeros((1, episodes, 2), np.int64)
    jobs, taken, done = np.array([[0, 0, episodes]]), np.zeros(1, np.int64), np.zeros((1, 2), np.int64)
    weights, drawn = np.full((1, *lane.weights.shape), 1.5), np.full(episodes, -1)
    kernel.run(world, rules, learner, lane, keys, 0, drawn, -1, weights, jobs, taken, table, left, done)
    compiled = next(iter(kernel.run.overloads.values()))
    name = compiled.fndesc.llvm_func_name
    print(int(lane.count["robot_steps"][0]), compiled.library.get_pointer_to_function(name), name)
    if machine_code is not None:
        machine_code.write_bytes(compiled.library._get_compiled_object())


def at_start(world, rules, lane, r, numbers):  # type: ignore[no-untyped-def]
    """Whether a robot is at the entrance, or last was: a sensor of one's own."""
    return 1 if lane.robots[r].node == rules.start else 0


def dump(workload: str, file: Path, robots: int) -> None:
    """Write the compiled mission of a workload, so that the worker imports little."""
    import numpy as np

    from tasklift.building import Mission, generate
    from tasklift.building.reading import PRESETS
    from tasklift.building.team import SCOUT, WEAPON
    from tasklift.building.variables import TABLE_I, Sensor
    from tasklift.learning.reinforcement import Reinforcement
    from tasklift.tasks.task import Variable

    preset, _, own = workload.partition(", ")
    inputs = [*TABLE_I, Sensor(Variable("HOME", (0, 1)), at_start)] if own else TABLE_I
    team = {SCOUT: robots * 2 // 3, WEAPON: robots - robots * 2 // 3}
    mission = Mission(generate(seed=7), team, min(1, robots - 1), reading=PRESETS[preset], inputs=inputs)
    simulator = mission.simulator
    parts = (mission.inputs, simulator.world, simulator.rules, simulator.learner(mission.task, Reinforcement()),
             simulator.lane(mission.task.shape), np.array([simulator.keys(0, 2)]))  # fmt: skip
    file.write_bytes(pickle.dumps(parts))


def watch(worker: list[str], folder: Path, environment: dict[str, str], *options: str) -> tuple[str, list[Line]]:
    """Run a worker under valgrind; return what it printed, and the lines of the profile that are the kernel's."""
    profile = folder / f"counts-{worker[-1]}"
    command = ["valgrind", "--tool=callgrind", "--dump-instr=yes", "--compress-pos=no", *options,
               f"--callgrind-out-file={profile}", *worker]  # fmt: skip
    done = subprocess.run(command, capture_output=True, text=True, check=True, env=environment)
    start = int(done.stdout.split()[1])
    lines = re.findall(r"^(?:calls=\d+ 0x(\S+) .*\n)?0x([0-9a-f]+) \S+ (\d+)((?: \d+)*)$", profile.read_text(), re.M)
    ours = [(int(at, 16) - start, int(executed), branches) for called, at, executed, branches in lines
            if not (called and 0 <= int(called, 16) - start < CODE)]  # a call's line has what the called one took
    return done.stdout, [line for line in ours if 0 <= line[0] < CODE]


def prepare(workload: str, folder: Path, environment: dict[str, str], *code: str, robots: int = 15) -> list[str]:
    """Write a workload and have it compiled, so that valgrind finds the kernel in Numba's cache; return its worker."""
    dump(workload, folder / "workload", robots)
    worker = [sys.executable, __file__, "--work", str(folder / "workload")]
    subprocess.run([*worker, "1", *code], check=True, env=environment, capture_output=True)
    return worker


def count(workload: str) -> float:
    """Return the instructions per robot-step of a workload."""
    environment, found = os.environ | GENERIC, []
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        worker = prepare(workload, folder, environment)
        with ThreadPoolExecutor(2) as both:
            seen = both.map(lambda episodes: watch([*worker, str(episodes)], folder, environment), (FEW, MANY))
            for printed, lines in seen:
                found.append((int(printed.split()[0]), sum(executed for _, executed, _ in lines)))
    (few_steps, few), (many_steps, many) = found
    return (many - few) / (many_steps - few_steps)


def growth() -> None:
    """Print the instructions per robot-step of teams of several sizes, over their first episodes."""
    for robots, episodes in FIRST_EPISODES.items():
        with tempfile.TemporaryDirectory() as name:
            folder, environment = Path(name), os.environ | GENERIC
            worker = prepare(WORKLOADS[0], folder, environment, robots=robots)
            printed, lines = watch([*worker, str(episodes)], folder, environment)
        number = sum(executed for _, executed, _ in lines) / int(printed.split()[0])
        print(f"{robots:,} robots, {WORKLOADS[0]}: {number:.1f} instructions per robot-step", flush=True)


def parts(workload: str) -> None:
    """Print how many instructions and wrongly guessed branches of a robot-step each source function takes."""
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        environment = os.environ | GENERIC | {"NUMBA_DEBUGINFO": "1", "NUMBA_CACHE_DIR": str(folder / "cache")}
        worker = prepare(workload, folder, environment, str(folder / "code.o"))
        printed, lines = watch([*worker, str(2 * FEW)], folder, environment, "--branch-sim=yes")
        steps, _, symbol = printed.split()
        owners = _owners(folder / "code.o", symbol)
    instructions: Counter[str] = Counter()
    wrong: Counter[str] = Counter()
    for at, executed, branches in lines:
        owner = owners.get(at)
        if owner is not None:
            instructions[owner] += executed
            wrong[owner] += int([*branches.split(), "0", "0"][1])  # branches, and those guessed wrong
    for owner, number in [("all", instructions.total()), *instructions.most_common()]:
        guessed = wrong.total() if owner == "all" else wrong[owner]
        print(f"{workload}: {number / int(steps):6.1f} instructions, {guessed / int(steps):.2f} wrong guesses  {owner}")


def _owners(code: Path, symbol: str) -> dict[int, str]:
    """Return the source function of each instruction of a symbol, by its distance from the symbol's start."""
    source = Path(__file__).parents[1] / "src" / "tasklift"
    functions: dict[str, list[tuple[int, str]]] = {}
    for file in [*source.glob("building/*.py"), source / "tasks" / "choice.py"]:
        nodes = [node for node in ast.walk(ast.parse(file.read_text())) if isinstance(node, ast.FunctionDef)]
        functions[file.name] = sorted((node.lineno, node.name) for node in nodes)
    listing = subprocess.run(["objdump", "-d", "-l", str(code)], check=True, capture_output=True, text=True).stdout
    owners: dict[int, str] = {}
    start, owner = None, "elsewhere"
    for line in listing.splitlines():
        if found := re.match(r"([0-9a-f]+) <(.*)>:$", line):
            start = int(found[1], 16) if found[2] == symbol else None
        elif found := re.match(r"\S*?([^/\s]+\.py):(\d+)", line):
            known = functions.get(found[1], [])
            k = bisect_right(known, (int(found[2]), "~"))
            owner = known[k - 1][1] if k else "elsewhere"
        elif start is not None and (found := re.match(r"\s+([0-9a-f]+):\t", line)):
            owners[int(found[1], 16) - start] = owner
    return owners


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--record", action="store_true", help="write the counts into the file")
    parser.add_argument("--parts", action="store_true", help="show where the instructions of two workloads go")
    parser.add_argument("--robots", action="store_true", help="count small and large teams")
    parser.add_argument("--work", nargs="+", metavar="FILE", help=argparse.SUPPRESS)
    options = parser.parse_args()
    if options.work:
        work(options.work[0], int(options.work[1]), *map(Path, options.work[2:]))
        return
    if shutil.which("valgrind") is None:
        sys.exit("instructions: needs valgrind; install it, for example with: apt-get install valgrind")
    if options.robots:
        growth()
        return
    if options.parts:
        for workload in WORKLOADS[:2]:
            parts(workload)
        return
    found = {workload: round(count(workload), 1) for workload in WORKLOADS}
    recorded = json.loads(RECORD.read_text()) if RECORD.exists() else {}
    for workload, number in found.items():
        print(f"{workload}: {number} instructions per robot-step (recorded: {recorded.get(workload, 'none')})")
    if options.record:
        RECORD.write_text(json.dumps(found, indent=1) + "\n")
    elif any(number > ALLOWED * recorded.get(workload, 0) for workload, number in found.items()):
        sys.exit(f"instructions: more than {ALLOWED - 1:.0%} above the record; mend it, or record anew and say why")


if __name__ == "__main__":
    main()
