"""Drills: practice against hostiles that repel instead of destroying, measured at equal total trials.

A drill (:attr:`tasklift.building.Reading.drill`) keeps all of the task T and is safe: a simple task in the paper's own
sense, but one that contains what is hard. Here every arm with drills is held against direct learning with the same
loss signal and the same selection rule on T, which gets the drills' number (and V's traversals, where an arm has
them) as additional trials on T. Losses in drills are *would-be* losses: kept in a stage of their own, reported beside
the real ones.
"""

from __future__ import annotations

import dataclasses
import threading
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from tasklift.building.generate import generate
from tasklift.building.graph import Building
from tasklift.building.mission import Mission
from tasklift.building.reading import Reading
from tasklift.building.search import hostile_candidates
from tasklift.building.team import SCOUT, WEAPON, Kind
from tasklift.errors import TaskliftError
from tasklift.lab import Cell, CellResult, Spec
from tasklift.learning.chances import DRILL_STAGE, TARGET_STAGE
from tasklift.learning.learner import Curve
from tasklift.learning.reinforcement import Reinforcement, reinforce
from tasklift.learning.worlds import Outcomes
from tasklift.studies.arms import LOSS_SIGNAL, Start, learn_source, start_policy
from tasklift.tasks.policy import Policy

#: Trials on T that count for every arm: its last ones.
COUNTED = 100
#: What V costs: 44 outputs × 5 traversals.
REPEATS = 5
TRAVERSALS = 44 * REPEATS
#: Doors per building: with 5 hostiles there is still one behind which nobody waits (`generate` gives 4 by default).
DOORS = 6

Selection = Literal["q = .9", "exploitation"]
SELECTIONS: tuple[Selection, ...] = ("q = .9", "exploitation")


@dataclass(frozen=True)
class Drilling:
    """How drills are done.

    Attributes
    ----------
    trials
        How many drills.
    loss_signal
        At every would-be loss; on T it is always :data:`tasklift.studies.arms.LOSS_SIGNAL`.
    credit
        As in :class:`tasklift.learning.reinforcement.Reinforcement`.
    q
        The share of heaviest outputs, in equal parts of the drills one after another; 0 is exploration.
    hostiles
        ``same``: where they will be on T; ``relocated``: as many, placed afresh in every drill; ``every door``: one
        at each door that may hide one. Only the first needs to know where the hostiles are.
    """

    trials: int = 300
    loss_signal: float = LOSS_SIGNAL
    credit: Literal["decision", "trial"] = "decision"
    q: tuple[float, ...] = (0.0,)
    hostiles: Literal["same", "relocated", "every door"] = "same"

    def world(self, mission: Mission) -> Mission:
        """Return the mission in which drills are done."""
        if self.hostiles == "every door":
            mission = dataclasses.replace(mission, hostiles=tuple(hostile_candidates(mission.building)))
        return mission.with_reading(drill=True, relocate=self.hostiles == "relocated" or mission.reading.relocate)


@dataclass(frozen=True)
class Way:
    """One way to come to T: where it starts, its drills, and how many trials on T it runs.

    Attributes
    ----------
    meaning
        One line for readers.
    selection
        The rule on T, while all trials there go on learning with the loss signal.
    trials
        On T; the last :data:`COUNTED` count, and the losses of all of them.
    """

    meaning: str
    selection: Selection
    start: Start = "equal"
    drilling: Drilling | None = None
    trials: int = COUNTED

    @property
    def total(self) -> int:
        """Trials of every kind: V's traversals, drills, and trials on T."""
        source = TRAVERSALS if self.start in ("copy", "copy+prior") else 0
        return source + (self.drilling.trials if self.drilling else 0) + self.trials

    def rules(self) -> Reinforcement:
        """Return the learner's settings on T."""
        if self.selection == "exploitation":
            return Reinforcement(selection="exploitation", loss_signal=LOSS_SIGNAL)
        return Reinforcement(selection="pseudo-random", q=0.9, loss_signal=LOSS_SIGNAL)


#: What might make drills better: one change each, then together; V's 220 traversals and 80 drills cost what 300 do.
#: They are tried on other maps than those reported.
VARIANTS: dict[str, tuple[Start, Drilling]] = {
    "as it is": ("equal", Drilling()),
    "loss signal -1": ("equal", Drilling(loss_signal=-1.0)),
    "loss signal -1.5": ("equal", Drilling(loss_signal=-1.5)),
    "credit once a trial": ("equal", Drilling(credit="trial")),
    "by q = .9": ("equal", Drilling(q=(0.9,))),
    "q = 0, .5, .9 in turn": ("equal", Drilling(q=(0.0, 0.5, 0.9))),
    "hostiles relocated": ("equal", Drilling(hostiles="relocated")),
    "every door": ("equal", Drilling(hostiles="every door")),
    "every door, loss signal -1.5": ("equal", Drilling(hostiles="every door", loss_signal=-1.5)),
    "every door, credit once a trial": ("equal", Drilling(hostiles="every door", credit="trial")),
    "every door, by q = .9": ("equal", Drilling(hostiles="every door", q=(0.9,))),
    "every door, q in turn": ("equal", Drilling(hostiles="every door", q=(0.0, 0.5, 0.9))),
    "V, then 80 drills": ("copy", Drilling(300 - TRAVERSALS)),
    "V, then 80, every door": ("copy", Drilling(300 - TRAVERSALS, hostiles="every door")),
    "V, then 80, every door, q in turn": (
        "copy",
        Drilling(300 - TRAVERSALS, hostiles="every door", q=(0.0, 0.5, 0.9)),
    ),
}
#: What :func:`tasklift.studies.drills.report.chosen` picks of them, by the rule stated there.
CHOSEN = "every door"
AMOUNTS = (100, 300, 1000)
FURTHER_HOSTILES = (1, 3)


def direct_name(trials: int, selection: Selection) -> str:
    """Return the name of direct learning for so many trials on T."""
    return f"direct, {trials} trials, {selection}"


def _ways() -> dict[str, Way]:
    ways: dict[str, Way] = {}
    for selection in SELECTIONS:
        for trials in (COUNTED + 300, COUNTED + 1000):
            ways[direct_name(trials, selection)] = Way("equal weights, all trials on T", selection, trials=trials)
        for amount in AMOUNTS:
            ways[f"drill {amount}, {selection}"] = Way(
                f"{amount} drills by exploration", selection, drilling=Drilling(amount)
            )
            ways[f"every-door drill {amount}, {selection}"] = Way(
                f"{amount} drills by exploration, with hostiles at every door",
                selection,
                drilling=dataclasses.replace(VARIANTS[CHOSEN][1], trials=amount),
            )
        starts: tuple[tuple[Start, int, str], ...] = (
            ("copy", 300 - TRAVERSALS, "V, copied, then 80 drills: as many trials as 300 drills"),
            ("copy", 300, "V, copied, then 300 drills"),
            ("copy+prior", 300 - TRAVERSALS, "V, copied, stop and move swapped at doors, then 80 drills"),
            ("copy+prior", 300, "V, copied, stop and move swapped at doors, then 300 drills"),
            ("prior", 300, "equal weights, the prior at doors, then 300 drills"),
        )
        for start, amount, meaning in starts:
            every = dataclasses.replace(VARIANTS[CHOSEN][1], trials=amount)
            ways[f"{start}→drill {amount}, {selection}"] = Way(meaning, selection, start, Drilling(amount))
            ways[f"{start}→every-door drill {amount}, {selection}"] = Way(
                f"{meaning}, with hostiles at every door", selection, start, every
            )
        for start in ("copy", "copy+prior", "prior"):
            ways[f"{start}, {selection}"] = Way(f"{start}, no drills", selection, start)
    for name, (start, drilling) in VARIANTS.items():
        ways[f"variant: {name}"] = Way(f"drills: {name}", "q = .9", start, drilling)
    return ways


WAYS: dict[str, Way] = _ways()


@dataclass(frozen=True)
class Part:
    """Some arms, measured with some numbers of hostiles on so many seeds per map."""

    hostiles: tuple[int, ...]
    seeds: int
    arms: tuple[str, ...]


def main_arms(selection: Selection) -> tuple[str, ...]:
    """Return the arms of the main result: 300 drills, or V and 80, against 300 more trials on T."""
    return (
        direct_name(COUNTED + 300, selection),
        f"drill 300, {selection}",
        f"every-door drill 300, {selection}",
        f"copy→every-door drill {300 - TRAVERSALS}, {selection}",
    )


def further_arms() -> tuple[str, ...]:
    """Return the other arms: other numbers of drills, other starts, and direct learning for as many trials."""
    main = {name for selection in SELECTIONS for name in main_arms(selection)}
    return tuple(name for name in WAYS if name not in main and not name.startswith("variant: "))


def reading_name(hostiles: int) -> str:
    """Return what the store calls a number of hostiles."""
    return f"{hostiles} hostile{'s' if hostiles > 1 else ''}"


def buildings(first: int, maps: int) -> dict[str, Building]:
    """Return generated buildings ``first`` on, by name, with :data:`DOORS` doors each."""
    return {f"map {i}": generate(doors=DOORS, seed=i) for i in range(first, first + maps)}


_latest = threading.local()  # what the arms of one map and seed share in this thread: V, and drilled policies


@dataclass(frozen=True, eq=False)
class Drills:
    """The study of drills: parts × maps.

    Attributes
    ----------
    buildings
        By name.
    parts
        Which arms, with how many hostiles, on how many seeds.
    team, limit
        As in :class:`tasklift.building.Mission`.
    """

    buildings: Mapping[str, Building]
    parts: tuple[Part, ...]
    team: Mapping[Kind, int] = field(default_factory=lambda: {SCOUT: 10, WEAPON: 5})
    limit: int = 600

    def __post_init__(self) -> None:
        for part in self.parts:
            for name in part.arms:
                if name not in WAYS:
                    raise TaskliftError(f"drills: unknown arm {name!r}; there are {'; '.join(WAYS)}")
            for hostiles in part.hostiles:
                for name in self.buildings:
                    self.mission(hostiles, name)  # refuses before anything is trained what cannot work

    def __getstate__(self) -> dict[str, Any]:
        """Leave compiled missions behind when a study travels to another process."""
        return {f.name: getattr(self, f.name) for f in dataclasses.fields(self)}

    @cached_property
    def _missions(self) -> dict[tuple[int, str, str], Mission]:
        return {}

    def mission(self, hostiles: int, building: str, drilling: Drilling | None = None) -> Mission:
        """Return the mission on T, or the one for drills, compiled at its first use."""
        key = (hostiles, building, drilling.hostiles if drilling else "T")
        if key not in self._missions:
            if drilling is None:
                mission = Mission(self.buildings[building], self.team, hostiles, Reading(), limit=self.limit)
            else:
                mission = drilling.world(self.mission(hostiles, building))
            self._missions.setdefault(key, mission)  # threads that come at once share the first one's
        return self._missions[key]

    def cells(self) -> list[Cell]:
        """Return the units of work, those that share map and seed side by side, the first seeds first."""
        numbers = sorted({h for part in self.parts for h in part.hostiles})
        return [
            Cell(reading=reading_name(h), map=building, seed=seed, arm=arm)
            for seed in range(max(part.seeds for part in self.parts))
            for building in self.buildings
            for h in numbers
            for arm in WAYS
            if any(h in p.hostiles and seed < p.seeds and arm in p.arms for p in self.parts)
        ]

    def spec(self) -> Spec:
        """Return all that decides the rows, as data."""
        used = {arm for part in self.parts for arm in part.arms}
        return Spec.of(
            "drills",
            {
                "maps": {name: building.content_id for name, building in self.buildings.items()},
                "parts": [dataclasses.asdict(part) for part in self.parts],
                "arms": {name: dataclasses.asdict(way) for name, way in WAYS.items() if name in used},
                "reading": dataclasses.asdict(Reading()),
                "reinforcement": dataclasses.asdict(Reinforcement(loss_signal=LOSS_SIGNAL)),
                "team": [[kind.name, kind.speed_mm, kind.armed, n] for kind, n in self.team.items()],
                "limit": self.limit,
                "counted": COUNTED,
                "repeats": REPEATS,
            },
            {
                "reading": [reading_name(h) for h in sorted({h for part in self.parts for h in part.hostiles})],
                "map": list(self.buildings),
                "seed": range(max(part.seeds for part in self.parts)),
                "arm": [name for name in WAYS if name in used],
            },
            over=("map", "seed"),
        )

    def work(self, cell: Cell) -> CellResult:
        """Train one arm with one number of hostiles on one map with one seed."""
        way, hostiles = WAYS[cell["arm"]], int(cell["reading"].split()[0])
        policy, stages = self._enter(cell, way, hostiles)
        target = reinforce(
            self.mission(hostiles, cell["map"]), policy, trials=way.trials, seed=int(cell["seed"]), stage=TARGET_STAGE,
            reinforcement=way.rules(),
        ).outcomes  # fmt: skip
        columns = {stage: _columns(outcomes) for stage, outcomes in (stages | {"target": target}).items()}
        drilled = columns.get("drill")
        summary = {
            "robots_lost": int(target.losses.sum()),
            "robots_lost_counted": int(target.losses[-COUNTED:].sum()),
            "would_be_losses": int(drilled["losses"].sum()) if drilled else 0,
            "steps_counted": float(target.steps[-COUNTED:].mean()),
            "success_counted": float(target.success[-COUNTED:].mean()),
            "total_trials": way.total,
        }
        return CellResult(columns, summary)

    def _enter(self, cell: Cell, way: Way, hostiles: int) -> tuple[Policy, dict[str, Outcomes]]:
        """Return the policy with which an arm enters T, and the outcomes of the stages before."""
        group = (self, cell["map"], int(cell["seed"]))
        if getattr(_latest, "group", None) != group:
            _latest.group, _latest.known = group, {}
        known: dict[Any, Any] = _latest.known
        mission, stages = self.mission(hostiles, cell["map"]), {}
        source: Curve | None = None
        if way.start != "equal":
            if "V" not in known:
                seed = int(cell["seed"])
                known["V"] = learn_source(mission, repeats=REPEATS, seed=seed, reinforcement=Reinforcement())
            source = known["V"]
        if source is not None and way.start != "prior":  # the prior is told, V's traversals are not spent on it
            stages["source"] = source.outcomes
        policy = start_policy(
            way.start, mission.task, source.policy if source else None, Reinforcement().initial_weight
        )
        if way.drilling is None:
            return policy, stages
        # V knows no hostiles, and with one at every door it does not matter how many there are on T
        key = (way.start, way.drilling, 0 if way.drilling.hostiles == "every door" else hostiles)
        if key not in known:
            world = self.mission(hostiles, cell["map"], way.drilling)
            known[key] = drilled(world, policy, way.drilling, seed=int(cell["seed"]))
        policy, stages["drill"] = known[key]
        return policy, stages


def drilled(world: Mission, policy: Policy, drilling: Drilling, *, seed: int) -> tuple[Policy, Outcomes]:
    """Do the drills from a policy; return the policy after them and every drill's outcome (would-be losses).

    Parameters
    ----------
    world
        As :meth:`Drilling.world` gives it.
    """
    ends = [round(drilling.trials * (i + 1) / len(drilling.q)) for i in range(len(drilling.q))]
    done, parts = 0, []
    for q, end in zip(drilling.q, ends, strict=True):
        rules = Reinforcement(selection="pseudo-random", q=q, loss_signal=drilling.loss_signal, credit=drilling.credit)
        curve = reinforce(
            world, policy, trials=end - done, first_trial=done, seed=seed, stage=DRILL_STAGE, reinforcement=rules
        )
        policy, done = curve.policy, end
        parts.append(curve.outcomes)
    return policy, Outcomes(
        steps=np.concatenate([p.steps for p in parts]),
        success=np.concatenate([p.success for p in parts]),
        losses=np.concatenate([p.losses for p in parts]),
        limit=world.limit,
    )


def _columns(outcomes: Outcomes) -> dict[str, NDArray[Any]]:
    return {
        "losses": outcomes.losses.astype(np.int32),  # a drill may lose a robot many times
        "steps": outcomes.steps.astype(np.int32),
        "success": outcomes.success,
    }


def study(*, maps: int, seeds: int, hostiles: Sequence[int]) -> Drills:
    """Return the whole study: the main result on all seeds, everything else on a tenth of them.

    Parameters
    ----------
    maps, seeds
        Buildings 0 on, and seeds per building for the main result (T at q = .9).
    hostiles
        Numbers of hostiles; other numbers of drills and other starts are tried with 1 and 3 of them.
    """
    few = max(1, seeds // 10)
    parts = [Part(tuple(hostiles), seeds, main_arms("q = .9")), Part(tuple(hostiles), few, main_arms("exploitation"))]
    further = tuple(h for h in FURTHER_HOSTILES if h in hostiles)
    if further:
        parts.append(Part(further, few, further_arms()))
    return Drills(buildings(0, maps), tuple(parts))


def choosing() -> Drills:
    """Return the study that decides between the variants: on maps and seeds that are in no result."""
    arms = tuple(name for name in WAYS if name.startswith("variant: "))
    return Drills(buildings(103, 4), (Part(FURTHER_HOSTILES, 4, arms),))
