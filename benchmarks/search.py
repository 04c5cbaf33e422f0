"""Measure the policy search on buildings that no choice was tuned on: the figures of ``docs/train.md``.

    python benchmarks/search.py scattered cohesive unseen

Each line: the building's seed, processor seconds of training, then solved, robots lost and steps in 1,000 episodes with
1, 3 and 5 hostiles, placed afresh in each. Buildings have five doors, so that five hostiles find a place.
"""

from __future__ import annotations

import sys
import time

import numpy as np

import tasklift as tl
from tasklift.building import Mission, generate
from tasklift.building.missions import Missions
from tasklift.building.reading import PRESETS
from tasklift.studies.arms import Setup, searching
from tasklift.studies.certify import Bounds, Ground, Sizes, statement

BUILDINGS = range(9100, 9112)
HOSTILES = (1, 3, 5)
EPISODES = 1000


def per_building(preset: str) -> None:
    """Train on each building and try the policy there."""
    print(f"{preset}: seed, CPU s | solved, lost, steps with {HOSTILES} hostiles")
    table = []
    for seed in BUILDINGS:
        place = generate(21, 25, 6, doors=5, seed=seed)
        mission = Mission(place, "10+5", 1, PRESETS[preset]).with_reading(relocate=True)
        begun = time.process_time()
        policy = tl.Curriculum(searching(Setup(mission)).stages[:-1], block=None).run(seed=0).policy
        spent = time.process_time() - begun
        row = []
        for hostiles in HOSTILES:
            outcomes = Mission(place, "10+5", hostiles, mission.reading).evaluate(policy, EPISODES, seed=1)
            row.append((outcomes.success.mean(), outcomes.losses.sum(), outcomes.steps.mean()))
        table.append(row)
        print(f"{seed} {spent:5.1f} | " + " | ".join(f"{a:.3f} {b} {c:.0f}" for a, b, c in row), flush=True)
    found = np.array(table)
    print(f"worst: solved {found[..., 0].min():.3f}, lost {found[..., 1].max():.0f}; mean: solved "
          f"{found[..., 0].mean():.4f}, lost {found[..., 1].mean():.2f}, steps {found[..., 2].mean():.0f}")  # fmt: skip


def unseen(preset: str = "scattered") -> None:
    """Train on eight buildings at once, and certify on 1,000 fresh ones."""
    places = [generate(21, 25, 6, doors=5, seed=9300 + k) for k in range(8)]
    world = Missions([Mission(place, "10+5", 1, PRESETS[preset]).drill() for place in places])
    learner, task = tl.PolicySearch(episodes=8), world.task
    simple = task.simplify(remove=["DL", "GL"])
    begun = time.process_time()
    policy = learner.learn(world, learner.start(simple), tl.Run(trials=64_000)).policy
    spent = time.process_time() - begun
    ground = Ground(Sizes(21, 25, 6), "10+5", HOSTILES, PRESETS[preset])
    counts = ground.play(policy, EPISODES, seed=0)
    print(f"unseen, {preset}: {spent:.1f} CPU s;", statement(counts, Bounds.of(counts, 15, 0.99), 0.99, ground.unit))


if __name__ == "__main__":
    for what in sys.argv[1:] or ["scattered", "cohesive", "unseen"]:
        unseen() if what == "unseen" else per_building(what)
