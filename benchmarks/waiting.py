"""What do *steps waited* and *go back* gain where robots wait at different doors? The figures of ``docs/simulator.md``.

    python benchmarks/waiting.py                       on generated buildings with 17 doors
    python benchmarks/waiting.py office.json …         on buildings of your own

A team with few weapon robots and many doors gets stuck: each weapon robot waits alone at another door. Both searches
start from the hand-written reference on Table I and have the same budget of practice with a harmless hostile, placed
afresh in each episode (relocated drills). One goes on with Table I, the other with the table that has WAITED and BACK.
The larger table starts as the extended reference, but that robots which have waited at a door stay or go back evenly.

Each line: the building and policy; then of fresh episodes on the dangerous task, the same ones for all policies: the
share solved, robots lost per 100 and steps. ``waiting``: weapon robots that stand alone at doors at the end of failed
episodes.
"""

from __future__ import annotations

import argparse
from pathlib import Path

import numpy as np

import tasklift as tl
from tasklift import stats
from tasklift.building import Building, Mission, generate
from tasklift.building.outcomes import SearchOutcomes
from tasklift.building.variables import TABLE_I, TABLE_I_OUTPUTS
from tasklift.learning.chances import CHOICE_STAGE
from tasklift.learning.reinforcement import Reinforcement
from tasklift.plans.read import load_building
from tasklift.studies.arms import expert
from tasklift.studies.readiness import end_of
from tasklift.tasks.policy import Policy

BUILDINGS, DOORS, TRACED = (9400, 9401, 9402), 17, 20
#: Where too few have waited at a door: they may stay, or go back. Elsewhere they go on as before.
STUCK = {"WAITED": (1, 2), "FTR": 4, "nWPN": (0, 1)}
PRIORS = (
    tl.set_weight(0.0, when={"BACK": 1}),
    tl.set_weight(1.0, when=STUCK | {"BACK": 1, "WPN": 0, "CA": 0.0}),
    tl.set_weight(0.0, when=STUCK | {"BACK": 0}),
)


def searched(policy: Policy, practice: Mission, trials: int, seed: int) -> Policy:
    """Search on from a policy, near it; a robot lost costs more than a solved episode is worth."""
    learner = tl.PolicySearch(episodes=8, loss_price=4.0)
    return learner.learn(practice, learner.count_as(policy, 6.0), tl.Run(seed=seed, trials=trials)).policy


def waiting(mission: Mission, policy: Policy, outcomes: SearchOutcomes) -> float:
    """Return how many weapon robots stand alone at doors at the end, on average over some failed episodes."""
    failed = np.flatnonzero(~outcomes.success[0])[:TRACED]
    use = {"stage": CHOICE_STAGE, "reinforcement": Reinforcement(), "learn": False}
    ends = [end_of(mission.simulator.trace(policy, trial=int(trial), **use)).waiting for trial in failed]
    return float(np.mean(ends)) if ends else 0.0


def compare(place: Building, options: argparse.Namespace) -> np.ndarray:
    """Search with both tables on a building; return what each solves of the fresh episodes, (policies, episodes)."""
    small = Mission(place, options.team, limit=options.limit).with_reading(relocate=True)
    large = Mission(place, options.team, limit=options.limit, reading=small.reading,
                    inputs=[*TABLE_I, "WAITED"], outputs=[*TABLE_I_OUTPUTS, "BACK"])  # fmt: skip
    start = expert(small)
    lifted = Policy(large.task.simplify(remove=["WAITED"], fix={"BACK": 0}), start.weights)
    extended = lifted.extend(large.task, prior=PRIORS)
    policies = {"reference": (small, start), "extended": (large, extended)}
    for name, (mission, policy) in list(policies.items()):
        drills = mission.with_reading(drill=True)
        policies[f"{name}, searched"] = mission, searched(policy, drills, options.practice, options.seed)
    solved = []
    for name, (mission, policy) in policies.items():
        outcomes = mission.evaluate(policy, options.episodes, stage=CHOICE_STAGE)
        solved.append(outcomes.success[0])
        figures = f"solved {outcomes.success.mean():.1%}, lost {100 * outcomes.losses.mean():.1f}"
        stand = f"steps {outcomes.steps.mean():.0f}, waiting {waiting(mission, policy, outcomes):.1f}"
        print(f"{place.name}, {name}: {figures}, {stand}", flush=True)
    found = stats.compare(100.0 * solved[3], 100.0 * solved[2], better="greater")
    print(f"{place.name}, extended − reference, both searched, points: {found}", flush=True)
    return np.array(solved)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("buildings", nargs="*", type=Path, help="files; default: generated ones")
    parser.add_argument("--team", default="10+5")
    parser.add_argument("--limit", type=int, default=2400)
    parser.add_argument("--practice", type=int, default=8_000, help="episodes of drills per search")
    parser.add_argument("--episodes", type=int, default=1_000, help="fresh ones")
    parser.add_argument("--seed", type=int, default=0)
    options = parser.parse_args()
    places = [load_building(file) for file in options.buildings]
    places = places or [generate(21, 25, 6, 24, doors=DOORS, seed=seed) for seed in BUILDINGS]
    shares = np.array([compare(place, options).mean(axis=1) for place in places])
    names = ("reference", "extended", "reference, searched", "extended, searched")
    for name, share in zip(names, shares.T, strict=True):
        print(f"mean of {len(places)}: {name} {share.mean():.1%}")


if __name__ == "__main__":
    main()
