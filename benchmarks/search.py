"""Measure the policy search on buildings that no choice was tuned on: the figures of ``docs/train.md``.

    python benchmarks/search.py scattered cohesive unseen

Each line: the building's seed, processor seconds of training, then solved, robots lost and steps in 1,000 episodes with
1, 3 and 5 hostiles, placed afresh in each. Buildings have five doors, so that five hostiles find a place. ``search`` is
the policy found, ``handed over`` the better of that and the hand-written reference, as ``tasklift train`` chooses.
"""

from __future__ import annotations

import sys
import time

import numpy as np

import tasklift as tl
from tasklift.building import Mission, generate
from tasklift.building.missions import Missions
from tasklift.building.reading import PRESETS
from tasklift.learning.chances import CHOICE_STAGE
from tasklift.studies.arms import ARMS, Setup, expert, searching
from tasklift.studies.certify import Bounds, Ground, Sizes, statement
from tasklift.studies.train import CHOICE_EPISODES, Candidate, chosen

BUILDINGS = range(9100, 9112)
HOSTILES = (1, 3, 5)
EPISODES = 1000


def per_building(preset: str) -> None:
    """Train on each building and try the policy there."""
    print(f"{preset}: seed, CPU s | solved, lost, steps with {HOSTILES} hostiles")
    table: dict[str, list[list[tuple[float, float, float]]]] = {"search": [], "handed over": []}
    for seed in BUILDINGS:
        place = generate(21, 25, 6, doors=5, seed=seed)
        mission = Mission(place, "10+5", 1, PRESETS[preset]).with_reading(relocate=True)
        begun = time.process_time()
        found = tl.Curriculum(searching(Setup(mission)).stages[:-1], block=None).run(seed=0).policy
        both = [found.extend(mission.task), expert(mission)]
        tried = mission.evaluate(both, CHOICE_EPISODES, stage=CHOICE_STAGE)
        of = [Candidate(ARMS[slug], 0, policy, float(tried.success[k].mean()), float(tried.losses[k].mean()),
                        float(tried.steps[k].mean()))
              for k, (slug, policy) in enumerate(zip(("search", "expert"), both, strict=True))]  # fmt: skip
        best = chosen(of)
        spent = time.process_time() - begun
        for what, policy in (("search", both[0]), ("handed over", best.policy)):
            row = []
            for hostiles in HOSTILES:
                outcomes = Mission(place, "10+5", hostiles, mission.reading).evaluate(policy, EPISODES, seed=1)
                row.append((outcomes.success.mean(), outcomes.losses.sum(), outcomes.steps.mean()))
            table[what].append(row)
            by = f" {best.arm.slug}" if what == "handed over" else ""
            figures = " | ".join(f"{a:.3f} {b} {c:.0f}" for a, b, c in row)
            print(f"{seed} {spent:5.1f} {what}{by} | {figures}", flush=True)
    for what, rows in table.items():
        found_all = np.array(rows)
        each = found_all[..., 0].min(axis=1)
        print(f"{what}: solved, worst {each.min():.3f}, mean {found_all[..., 0].mean():.4f}, at least 0.99 on "
              f"{(each >= 0.99).sum()} of {len(each)}; lost {found_all[..., 1].sum():.0f}; steps "
              f"{found_all[..., 2].mean():.0f}")  # fmt: skip


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
