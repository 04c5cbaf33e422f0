"""Why no policy is ready, and what would help: recognised in traces, and tried."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np

from tasklift.building.least import least_steps
from tasklift.building.mission import Mission
from tasklift.building.search import hostile_candidates
from tasklift.building.simulator import Trace
from tasklift.building.team import SCOUT, WEAPON
from tasklift.lab import Progress
from tasklift.learning.chances import CHOICE_STAGE
from tasklift.learning.reinforcement import Reinforcement
from tasklift.studies.arms import UNSAFE, expert
from tasklift.studies.certify import share_bounds
from tasklift.tasks.policy import Policy

#: Failed episodes that are looked at.
LOOKED_AT = 20
#: Episodes by which a larger team is tried, and by which it is confirmed.
TRIED, CONFIRMED = 100, 1000
_AS_DRAWN = Reinforcement()


@dataclass(frozen=True)
class End:
    """How an episode that failed ended.

    Attributes
    ----------
    waiting
        Weapon robots that stand at a place where a hostile may hide, fewer than m of them there.
    places
        How many such places that is.
    armed
        Weapon robots that are left.
    explored
        Share of the corridors that somebody travelled.
    """

    waiting: int
    places: int
    armed: int
    explored: float


def end_of(trace: Trace) -> End:
    """Return how an episode ended, from its last frame."""
    mission, robots = trace.mission, trace.robots[-1]
    armed = np.repeat([kind.armed for kind in mission.team], list(mission.team.values())) & (robots["alive"] == 1)
    hides = np.zeros(mission.building.n_nodes, bool)
    hides[hostile_candidates(mission.building)] = True
    at_one = armed & (robots["half"] < 0) & hides[robots["node"]] & ~trace.resolved[-1][robots["node"]]
    there = np.bincount(robots["node"][at_one], minlength=mission.building.n_nodes)
    alone = (there > 0) & (there < mission.weapons_needed)
    return End(int(there[alone].sum()), int(alone.sum()), int(armed.sum()), float(trace.visited[-1].mean()))


def diagnose(mission: Mission, policy: Policy) -> list[str]:
    """Say why episodes fail under a policy, in one line or none.

    Parameters
    ----------
    mission : Mission
        The dangerous task.
    policy : Policy
        Outputs are drawn in proportion.
    """
    failed = np.flatnonzero(~mission.evaluate(policy, 200, stage=CHOICE_STAGE).success[0])[:LOOKED_AT]
    ends = [
        end_of(mission.simulator.trace(
            policy, trial=int(trial), stage=CHOICE_STAGE, reinforcement=_AS_DRAWN, learn=False
        ))
        for trial in failed
    ]  # fmt: skip
    if not ends:
        return []
    m, limit = mission.weapons_needed, mission.limit
    stuck = [end for end in ends if end.armed >= m and 2 * end.waiting > end.armed]
    weak = [end for end in ends if end.armed < m]
    explored = f"{100 * np.mean([end.explored for end in ends]):.0f} % of the corridors were explored"
    if 2 * len(weak) > len(ends):
        left = f"fewer than {m} weapon robots were left in {len(weak)} of {len(ends)} failed episodes"
        return [f"why: {left}; {explored}"]
    if 2 * len(stuck) > len(ends):
        return [
            f"why: in {len(stuck)} of {len(ends)} failed episodes weapon robots wait one by one at different doors, "
            f"{np.mean([end.waiting for end in stuck]):.1f} of {np.mean([end.armed for end in stuck]):.1f} at "
            f"{np.mean([end.places for end in stuck]):.1f} doors, each for {m} to come together; {explored}"
        ]
    return [f"why: {len(ends)} of {len(ends)} failed episodes looked at ran out of their {limit} steps; {explored}"]


def advice(mission: Mission, ready: float, progress: Progress | None = None) -> list[str]:
    """Say which team, or which limit, would do: found by trying the hand-written reference, which needs no training.

    A team does if its episodes say so with 99 % confidence. Otherwise training with it might find none ready again.
    """
    lines, needed = [], least_steps(mission)
    if needed > mission.limit:
        lines.append(f"no policy can: the building needs at least {needed} steps, the limit is {mission.limit}")
    if not {variable.name for variable in mission.task.inputs}.issuperset(UNSAFE):
        return lines  # the reference cannot wait for what it does not see
    tries = list(larger(mission))
    for k, larger_one in enumerate(tries, start=1):
        if progress is not None:
            progress(k, len(tries), "trying larger teams")
        policy = expert(larger_one)
        if larger_one.evaluate(policy, TRIED, stage=CHOICE_STAGE, seed=1).success.mean() < ready:
            continue
        solved = larger_one.evaluate(policy, CONFIRMED, stage=CHOICE_STAGE, seed=2).success.mean()
        if solved == 1.0 or share_bounds(round(solved * CONFIRMED), CONFIRMED, 0.99)[0] >= ready:
            if progress is not None:
                progress(len(tries), len(tries), "trying larger teams")
            limit = f" --limit {larger_one.limit}" if larger_one.limit != mission.limit else ""
            lines.append(
                f"what would do: {_team(larger_one)}{limit}; with it, waiting at doors for "
                f"{mission.weapons_needed} weapon robots solves {100 * solved:.1f} % of {CONFIRMED:,} fresh episodes"
            )
            return lines
    lines.append(f"no team of up to {tries[-1].n_robots} robots was found that solves {100 * ready:g} % of episodes")
    return lines


def larger(mission: Mission) -> Iterator[Mission]:
    """Yield the mission with more and more weapon robots, then with more time as well.

    With D places where hostiles may hide, D · (m − 1) + 1 weapon robots cannot all wait alone; twice as many are tried.
    """
    armed = sum(n for kind, n in mission.team.items() if kind.armed)
    enough = len(hostile_candidates(mission.building)) * (mission.weapons_needed - 1) + 1
    kind = next(kind for kind in mission.team if kind.armed)
    sizes = [armed]
    while sizes[-1] < 2 * max(enough, armed):
        sizes.append(sizes[-1] + max(1, sizes[-1] // 5))
    for limit in (mission.limit, 2 * mission.limit, 4 * mission.limit):
        for size in sizes[1 if limit == mission.limit else 0 :]:
            team = dict(mission.team)
            team[kind] += size - armed
            yield replace(mission, team=team, limit=limit)


def _team(mission: Mission) -> str:
    if set(mission.team) <= {SCOUT, WEAPON}:
        return f"--team {mission.team.get(SCOUT, 0)}+{mission.team[WEAPON]}"
    return "a team of " + ", ".join(f"{n} {kind.name}" for kind, n in mission.team.items())
