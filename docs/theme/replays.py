"""The replays that the site plays. They are learned and written when the site is built, so none can be out of date."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import tasklift as tl
from tasklift.building import COHESIVE, SCATTERED, Mission, generate
from tasklift.studies.study import Condition, Study
from tasklift.watch import page, replay
from tasklift.watch.sources import policy_traces, study_traces

#: The building that all pictures and replays show.
OFFICE = generate(seed=3)


def methods(arms: Sequence[str], trials: Sequence[int], preset: str = "scattered") -> list[tuple[str, Any]]:
    """Trace trials of the paper's methods on one building with one seed, as they learn."""
    reading = {"scattered": SCATTERED, "cohesive": COHESIVE}[preset]
    study = Study.every({"office": OFFICE}, {preset: Condition(reading)}, arms, seeds=1)
    return study_traces(study, condition=preset, map="office", seed=0, arms=arms, trials=trials)


def practised(hostiles: int = 1) -> tuple[str, Any]:
    """Trace a dangerous episode of a team that practised with harmless hostiles at every door (docs/train.md)."""
    mission = Mission(OFFICE, team="10+5", hostiles=hostiles)
    search = tl.PolicySearch()
    simple = mission.task.simplify(remove=["DL", "GL"])
    policy = search.learn(mission.drill(), search.start(simple), tl.Run(trials=24_000)).policy
    (trace,) = policy_traces(mission, [("practised first", policy.extend(mission.task))], seed=0, trial=1, greedy=False)
    return trace


def replays() -> dict[str, str]:
    """Return every replay of the site: its name, and one HTML page that plays it."""
    ((_, scratch),) = methods(["direct"], [100])
    shown = {
        "home": ([("from scratch, episode 100", scratch), practised()], "One building, one hidden hostile"),
        "methods": (methods(["direct", "copy", "copy-prior"], [100]), "The paper's methods at episode 100"),
        "learning": (methods(["direct"], [1, 10, 50, 100]), "From scratch: episodes 1, 10, 50 and 100"),
        "hostiles": ([practised(3)], "Three hostiles, none of which was known"),
        "cohesive": (methods(["direct", "copy", "copy-prior"], [100], "cohesive"), "The same, as cohesive teams"),
    }
    return {name: page(replay(traces, title)) for name, (traces, title) in shown.items()}
