"""Drills: practice against hostiles that repel instead of destroying, measured at equal total trials.

A drill (:attr:`tasklift.building.Reading.drill`) keeps all of the task T and is safe: a simple task in the paper's own
sense, but one that contains what is hard. Here every arm with drills is compared with direct learning with the same
loss signal and the same selection rule on T, which gets the drills' number (and V's traversals, where an arm has
them) as additional trials on T. Losses in drills are *would-be* losses: kept in a stage of their own, reported beside
the real ones.
"""

from __future__ import annotations

from collections.abc import Sequence

from tasklift.studies.arms import AMOUNTS, COUNTED, SELECTIONS, SPENT_BEFORE, STARTS, TRAVERSALS, VARIANTS
from tasklift.studies.study import Condition, Part, Record, Study, generated, numbered

#: Doors per building: with 5 hostiles there is still one behind which nobody waits (`generate` gives 4 by default).
DOORS = 6
#: What :func:`tasklift.studies.drills.report.chosen` picks of the variants, by the rule stated there.
CHOSEN = "variant-every-door"
FURTHER_HOSTILES = (1, 3)
_KINDS = ("drill", "every-door")
RECORD = Record(columns=("losses", "steps", "success"), policy=False)


def main_arms(selection: str) -> tuple[str, ...]:
    """Return the arms of the main result: 300 drills, or V and 80, against 300 more trials on T."""
    return (
        f"direct-{COUNTED + SPENT_BEFORE}-{selection}",
        f"drill-{SPENT_BEFORE}-{selection}",
        f"every-door-{SPENT_BEFORE}-{selection}",
        f"copy-every-door-{SPENT_BEFORE - TRAVERSALS}-{selection}",
    )


def variants() -> tuple[str, ...]:
    """Return the arms that try a way of drilling each, drills as they are first."""
    return tuple(f"variant-{slug}" for slug in VARIANTS)


def amounts(selection: str) -> tuple[str, ...]:
    """Return the arms with other numbers of drills."""
    others = [amount for amount in AMOUNTS if amount != SPENT_BEFORE]
    return tuple(f"{kind}-{amount}-{selection}" for amount in others for kind in _KINDS)


def starts(selection: str) -> tuple[str, ...]:
    """Return the arms that begin with V, with the prior, or with both."""
    drilled = [f"{start}-{kind}-{amount}-{selection}" for start, _, amount, _ in STARTS for kind in _KINDS]
    plain = [f"{start}-loss-{selection}" for start in dict.fromkeys(start for start, *_ in STARTS)]
    return tuple(slug for slug in (*drilled, *plain) if slug not in main_arms(selection))


def further_arms() -> tuple[str, ...]:
    """Return the other arms: other numbers of drills, other starts, and direct learning for as many trials."""
    return tuple(
        slug
        for selection in SELECTIONS
        for slug in (f"direct-{COUNTED + max(AMOUNTS)}-{selection}", *amounts(selection), *starts(selection))
    )


def study(*, maps: int, seeds: int, hostiles: Sequence[int]) -> Study:
    """Return the full study: the main result on all seeds, everything else on a tenth of them.

    Parameters
    ----------
    maps, seeds
        Buildings 0 on, and seeds per building for the main result (T at q = .9).
    hostiles
        Numbers of hostiles; other numbers of drills and other starts are tried with 1 and 3 of them.
    """
    every = tuple(numbered(seeds, "seeds"))
    own, few = generated(numbered(maps, "maps"), doors=DOORS), every[: max(1, seeds // 10)]
    names, numbers = tuple(own), tuple(str(h) for h in hostiles)
    parts = [
        Part(main_arms("q90"), numbers, names, every),
        Part(main_arms("exploitation"), numbers, names, few),
    ]
    further = tuple(str(h) for h in FURTHER_HOSTILES if h in hostiles)
    if further:
        parts.append(Part(further_arms(), further, names, few))
    conditions = {str(h): Condition(hostiles=h) for h in hostiles}
    return Study(own, conditions, tuple(parts), axis="hostiles", trials=COUNTED, record=RECORD)


def choosing(maps: int = 4, seeds: int = 4) -> Study:
    """Return the study that decides between the variants: on maps and seeds that are in no result."""
    conditions = {str(h): Condition(hostiles=h) for h in FURTHER_HOSTILES}
    own = generated(numbered(maps, "maps", 103), doors=DOORS)
    part = Part(variants(), tuple(conditions), tuple(own), tuple(numbered(seeds, "seeds")))
    return Study(own, conditions, (part,), axis="hostiles", trials=COUNTED, record=RECORD)
