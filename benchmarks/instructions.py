"""Machine instructions per robot-step of the compiled simulator, counted by valgrind: they do not depend on the load.

``make instructions`` counts and compares with ``benchmarks/instructions.json``: more than 10 % above fails.
``make instructions ARGS=--record`` writes the file anew; say why in the changelog.

The count is the difference between runs of 1,042 and 42 episodes (trials) of the paper's mission, learning from equal
weights, so that the start of Python and of Numba cancels out. The kernel is compiled for a generic processor: valgrind
shows programs another processor than the machine has, and counts would differ between machines.
"""

from __future__ import annotations

import argparse
import json
import os
import pickle
import re
import shutil
import subprocess
import sys
import tempfile
from pathlib import Path

FEW, MANY = 42, 1042
WORKLOADS = ("scattered", "cohesive", "scattered, with a sensor of one's own")
ALLOWED = 1.10
RECORD = Path(__file__).with_suffix(".json")
GENERIC = {"NUMBA_CPU_NAME": "generic", "NUMBA_CPU_FEATURES": "", "PYTHONHASHSEED": "0"}


def work(file: str, episodes: int) -> None:
    """Run episodes of a dumped mission and print the number of robot-steps; what valgrind watches."""
    import numpy as np

    from tasklift.building.inputs import kernel_for

    inputs, world, rules, learner, lane, keys = pickle.loads(Path(file).read_bytes())
    kernel = kernel_for(inputs)
    table, left = np.zeros((1, episodes, 7), np.int64), np.zeros((1, episodes, 2), np.int64)
    jobs, done = np.array([[0, 0, episodes]]), np.zeros((1, 2), np.int64)
    weights, drawn = np.full((1, *lane.weights.shape), 1.5), np.full(episodes, -1)
    kernel.run(world, rules, learner, lane, keys, 0, drawn, -1, weights, jobs, table, left, done)
    print(int(lane.count["robot_steps"][0]))


def at_start(world, rules, lane, r, numbers):  # type: ignore[no-untyped-def]
    """Whether a robot is at the entrance, or last was: a sensor of one's own."""
    return 1 if lane.robots[r].node == rules.start else 0


def dump(workload: str, file: Path) -> None:
    """Write the compiled mission of a workload, so that the worker imports little."""
    import numpy as np

    from tasklift.building import Mission, generate
    from tasklift.building.reading import PRESETS
    from tasklift.building.variables import TABLE_I, Sensor
    from tasklift.learning.reinforcement import Reinforcement
    from tasklift.tasks.task import Variable

    preset, _, own = workload.partition(", ")
    inputs = [*TABLE_I, Sensor(Variable("HOME", (0, 1)), at_start)] if own else TABLE_I
    mission = Mission(generate(seed=7), "10+5", reading=PRESETS[preset], inputs=inputs)
    simulator = mission.simulator
    parts = (mission.inputs, simulator.world, simulator.rules, simulator.learner(mission.task, Reinforcement()),
             simulator.lane(mission.task.shape), np.array([simulator.keys(0, 2)]))  # fmt: skip
    file.write_bytes(pickle.dumps(parts))


def run(file: Path, episodes: int, watched: bool) -> tuple[int, int]:
    """Return the instructions (0 if not watched) and robot-steps of a worker."""
    command = [sys.executable, __file__, "--work", str(file), str(episodes)]
    if watched:
        command = ["valgrind", "--tool=callgrind", "--callgrind-out-file=/dev/null", *command]
    done = subprocess.run(command, capture_output=True, text=True, check=True, env=os.environ | GENERIC)
    counted = re.search(r"Collected : (\d+)", done.stderr)
    return int(counted[1]) if counted else 0, int(done.stdout)


def count(workload: str) -> float:
    """Return the instructions per robot-step of a workload."""
    with tempfile.TemporaryDirectory() as folder:
        file = Path(folder) / "workload"
        dump(workload, file)
        run(file, 1, watched=False)  # compiles, so that valgrind finds the kernel in Numba's cache
        (few, few_steps), (many, many_steps) = (run(file, episodes, watched=True) for episodes in (FEW, MANY))
    return (many - few) / (many_steps - few_steps)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--record", action="store_true", help="write the counts into the file")
    parser.add_argument("--work", nargs=2, metavar=("FILE", "EPISODES"), help=argparse.SUPPRESS)
    options = parser.parse_args()
    if options.work:
        work(options.work[0], int(options.work[1]))
        return
    if shutil.which("valgrind") is None:
        sys.exit("instructions: needs valgrind; install it, for example with: apt-get install valgrind")
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
