"""How good a policy could be: the best one that a search finds, and a bound that none can pass."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from tasklift.building.least import least_steps
from tasklift.building.reading import PRESETS
from tasklift.lab import Store
from tasklift.studies.arms import ARMS, SEARCHED
from tasklift.studies.samples import Sample
from tasklift.studies.study import GREEDY_TRIALS, Part, Study
from tasklift.tasks.policy import Policy

#: Seed of the one search per map and preset.
SEED = 0


def part(maps: Sequence[str]) -> Part:
    """Return the cells that search a policy: one per map and preset."""
    return Part((SEARCHED.slug,), tuple(PRESETS), tuple(maps), (SEED,))


def policy(study: Study, store: Store, preset: str, name: str) -> Policy:
    """Return the policy that was searched on one map.

    Parameters
    ----------
    study, store
        With the cells of :func:`part`, done.
    preset, name
        Names of the condition and of the map.
    """
    weights = store.result(study.cell(preset, name, SEED, SEARCHED.slug)).attachments["weights"]
    made = {"learned_by": SEARCHED.label, "arm": SEARCHED.slug, "map": name, "seed": SEED}
    return Policy(study.mission(preset, name).task, weights, made)


def searched(study: Study, store: Store, preset: str, maps: Sequence[str], seeds: Sequence[int]) -> Sample:
    """Return what the policies that were searched on each map do, row by row as the other arms' greedy use is played.

    Parameters
    ----------
    study, store
        With the cells of :func:`part`, done.
    preset
        Name of the condition.
    maps, seeds
        The rows, each map with each seed: hostiles are where the other arms meet them.
    """
    rows: list[tuple[str, int, Any]] = []
    for name in maps:
        mission, found = study.mission(preset, name), policy(study, store, preset, name)
        rows += [(name, seed, mission.evaluate(found, GREEDY_TRIALS, seed=seed)) for seed in seeds]
    steps, losses, success = (
        np.array([getattr(played, column)[0] for *_, played in rows], np.float64)
        for column in ("steps", "losses", "success")
    )
    return Sample(
        maps=np.array([name for name, *_ in rows]),
        seeds=np.array([seed for _, seed, _ in rows]),
        steps=steps,
        losses=losses,
        success=success,
        limit=study.limit,
        n_robots=study.mission(preset, maps[0]).n_robots,
        greedy_steps=steps.mean(axis=1),
        greedy_losses=losses.mean(axis=1),
    )


HEADERS = ("preset", "arm", "steps", "least possible", "times the least", "robots lost a trial")


def excess(study: Study, preset: str, samples: Mapping[str, Sample]) -> list[list[Any]]:
    """Return how far above the least possible number of steps the policies are that each arm ends with.

    Parameters
    ----------
    study
        Knows the buildings.
    preset
        Name of the condition.
    samples
        By slug. Policies that are mixed are used as they are, the others greedily.
    """
    bound = {name: least_steps(study.mission(preset, name)) for sample in samples.values() for name in sample.maps}
    rows = []
    for slug, sample in samples.items():
        least = np.array([bound[name] for name in sample.maps], np.float64)
        steps = sample.greedy_steps
        rows.append(
            [preset, ARMS[slug].label, round(float(steps.mean())), round(float(least.mean())),
             round(float((steps / least).mean()), 2), round(float(sample.greedy_losses.mean()), 1)]
        )  # fmt: skip
    return rows
