"""The one pipeline: maps × conditions × seeds × arms -> rows.

Every experiment is a :class:`Study`. The paper's, the study of drills, the multiverse of readings and training on a
building of your own differ in the arms and conditions that they list, and in the questions that they ask of the rows.
"""

from __future__ import annotations

import dataclasses
import threading
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from itertools import product
from math import prod
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from tasklift.building.generate import generate
from tasklift.building.graph import Building
from tasklift.building.mission import Mission
from tasklift.building.reading import Reading
from tasklift.building.team import Kind
from tasklift.building.terms import parse_terms, terms_from_json, terms_of, terms_to_json
from tasklift.building.variables import TABLE_I, TABLE_I_OUTPUTS, Sensor
from tasklift.checks import one_of, whole_number
from tasklift.errors import TaskliftError
from tasklift.lab import Cell, CellResult, Spec
from tasklift.learning.chances import GREEDY_STAGE
from tasklift.learning.curriculum import Curriculum, CurriculumRun
from tasklift.learning.learner import MOST_TRIALS, InTurn, Learner, Run
from tasklift.learning.reinforcement import Fixed, Reinforcement, Sweep
from tasklift.learning.search import PolicySearch
from tasklift.studies.arms import ARMS, PRACTICE, SEARCHED, Arm, Setup, arms_named
from tasklift.studies.own_code import OwnCode
from tasklift.tasks.policy import Policy
from tasklift.tasks.variable import Variable

if TYPE_CHECKING:
    from tasklift.building.simulator import SearchOutcomes, Trace

#: The policy that a cell ends with is used for this many trials without learning, always its heaviest output (or as it
#: is, where the arm's policies are mixed): on its own map, and on one that it has never seen.
GREEDY_TRIALS = 5
GREEDY = Fixed(Reinforcement(selection="exploitation"))
MIXED = Fixed(Reinforcement(selection="exploration"))
#: More seeds or generated maps, or more cells of a study, would fill the memory before anything is trained.
MOST_SEEDS, MOST_MAPS, MOST_CELLS = 100_000, 1_000, 1_000_000
#: Worlds that are kept of a building. One is compiled in half a millisecond and takes 0.15 MB.
WORLDS_KEPT = 200
#: What the rows of a trial may hold.
COLUMNS = ("steps", "success", "losses", "robots_left", "teams_left", "hostiles_left", "explored", "messages")

_latest = threading.local()  # what the arms of one map and seed share in this thread: V, and drills


@dataclass(frozen=True)
class Condition:
    """Under which rules arms learn: the world's, the learner's, and the number of hostiles.

    Examples
    --------
    >>> Condition(Reading(split="team"), hostiles=2).to_json()
    {'hostiles': 2, 'reading': {'split': 'team'}, 'reinforcement': {}}
    """

    reading: Reading = field(default_factory=Reading)
    reinforcement: Reinforcement = field(default_factory=Reinforcement)
    hostiles: int = 1

    def to_json(self) -> dict[str, Any]:
        """Return what differs from the defaults."""
        found: dict[str, Any] = {"hostiles": self.hostiles}
        for name in ("reading", "reinforcement"):
            mine, usual = (dataclasses.asdict(getattr(c, name)) for c in (self, Condition()))
            found[name] = {key: value for key, value in mine.items() if value != usual[key]}
        return found

    @classmethod
    def from_json(cls, document: Mapping[str, Any]) -> Condition:
        """Undo :meth:`to_json`."""
        rules = Reinforcement(**document["reinforcement"])
        return cls(Reading.from_json(document["reading"]), rules, document["hostiles"])


@dataclass(frozen=True)
class Part:
    """Some arms, under some conditions, on some maps, with some seeds; all by name."""

    arms: tuple[str, ...]
    conditions: tuple[str, ...]
    maps: tuple[str, ...]
    seeds: tuple[int, ...]


@dataclass(frozen=True)
class Record:
    """What is kept of every cell.

    Attributes
    ----------
    columns
        Of :data:`COLUMNS`, for every trial.
    stages
        Of these stages; empty: of all.
    policy
        Whether the learned policy is used greedily afterwards, and its weights are summed up.
    weights
        Whether the learned policy's weights are kept as well. Those of the arm ``searched`` always are.
    """

    columns: tuple[str, ...] = COLUMNS
    stages: tuple[str, ...] = ()
    policy: bool = True
    weights: bool = False


@dataclass(frozen=True, eq=False)
class Study:
    """What is compared with what, and on how much.

    Parameters
    ----------
    buildings
        The maps, by name.
    conditions
        By name.
    parts
        Which cells there are; :meth:`every` makes the plain case.
    axis
        What the conditions are called in stores: ``reading``, or ``hostiles``.
    trials
        On the full task T, for arms that do not say otherwise.
    repeats
        Traversals per output on the simple task V (44 outputs × 5 in the paper).
    practice
        Episodes of drills for the arm that searches.
    team, weapons_needed, limit, inputs, outputs
        As in :class:`tasklift.building.Mission`.
    unseen
        Further buildings, on which nothing is learned: policies are tried there greedily, seed by seed in turn.
    record
        What is kept.
    arms
        The arms that ``parts`` name, by slug; default: :data:`tasklift.studies.arms.ARMS`.

    Raises
    ------
    TaskliftError
        For what cannot work on one of the maps or is unknown, before anything is trained.

    Examples
    --------
    >>> from tasklift.studies.study import Condition, Study, generated
    >>> study = Study.every(generated([7]), {"scattered": Condition()}, ["direct", "copy"], seeds=1, trials=10)
    >>> print(*study.cells(), sep="; ")
    reading scattered, map map-7, seed 0, arm direct; reading scattered, map map-7, seed 0, arm copy
    >>> copied = study.work(study.cells()[1])
    >>> {stage: len(rows["steps"]) for stage, rows in copied.stages.items()}
    {'source': 220, 'target': 10, 'greedy': 5}
    >>> trace = study.replay(study.cells()[1], trial=9)
    >>> bool(trace.losses[-1] == copied.stages["target"]["losses"][9])
    True
    """

    buildings: Mapping[str, Building]
    conditions: Mapping[str, Condition]
    parts: tuple[Part, ...]
    axis: str = "reading"
    trials: int = 100
    repeats: int = 5
    practice: int = PRACTICE
    team: str | Mapping[Kind, int] = "10+5"
    weapons_needed: int = 2
    limit: int = 600
    inputs: Sequence[str | Sensor] = TABLE_I
    outputs: Sequence[str] = TABLE_I_OUTPUTS
    unseen: Mapping[str, Building] = field(default_factory=dict)
    record: Record = field(default_factory=Record)
    arms: Mapping[str, Arm] = field(default_factory=lambda: ARMS)

    @classmethod
    def every(
        cls,
        buildings: Mapping[str, Building],
        conditions: Mapping[str, Condition],
        arms: Iterable[str | Arm],
        *,
        seeds: int = 5,
        **options: Any,
    ) -> Study:
        """Return the study of every arm under every condition on every map with the seeds 0, 1, ….

        Parameters
        ----------
        buildings, conditions
            By name.
        arms
            Slugs, or arms of your own.
        seeds
            How many.
        options
            The other parameters of :class:`Study`.

        Raises
        ------
        TaskliftError
            As :class:`Study` does.
        """
        numbers = tuple(numbered(seeds, "seeds"))
        given = [arm if isinstance(arm, Arm) else arms_named([arm])[0] for arm in arms]
        slugs = tuple(arm.slug for arm in given)
        part = Part(slugs, tuple(conditions), tuple(buildings), numbers)
        return cls(buildings, conditions, (part,), arms=ARMS | {arm.slug: arm for arm in given}, **options)

    def __post_init__(self) -> None:
        parse_terms(self)
        for name in ("trials", "repeats", "practice"):
            whole_number(getattr(self, name), name, 1, MOST_TRIALS)
        cells = sum(prod(map(len, (p.arms, p.conditions, p.maps, p.seeds))) for p in self.parts)
        if cells > MOST_CELLS:
            raise TaskliftError(f"asks for {cells:,} cells; at most {MOST_CELLS:,}: ask for fewer seeds, maps or arms")
        for part in self.parts:
            for name in part.maps:
                one_of(name, list(self.buildings), "maps")
            for name in part.conditions:
                one_of(name, list(self.conditions), self.axis)
            for arm in arms_named(part.arms, self.arms):
                for condition, name in product(part.conditions, part.maps):
                    self.mission(condition, name)
                    if condition == part.conditions[0] and name == part.maps[0]:
                        self._check(arm, self._setup(condition, name))
            if part.arms and self.unseen:
                for condition, name in product(part.conditions, self.unseen):
                    self.mission(condition, name)

    @staticmethod
    def _check(arm: Arm, on: Setup) -> None:
        try:
            arm.curriculum(on).check()
        except TaskliftError as error:
            raise TaskliftError(f"arm {arm.slug!r}: {error}") from error

    def __getstate__(self) -> dict[str, Any]:
        """Leave compiled worlds behind when a study travels to another process."""
        return {f.name: getattr(self, f.name) for f in dataclasses.fields(self)}

    # ------------------------------------------------------------ what there is

    @cached_property
    def _worlds(self) -> dict[str, dict[Any, Mission]]:
        return {}

    def _setup(self, condition: str, building: str) -> Setup:
        of = self.conditions[condition]
        worlds = self._worlds.setdefault(building, {})
        mission = worlds.get((of.hostiles, of.reading))
        if mission is None:
            if len(worlds) >= WORLDS_KEPT:
                worlds.clear()
            place = self.buildings[building] if building in self.buildings else self.unseen[building]
            made = Mission(place, hostiles=of.hostiles, reading=of.reading, **terms_of(self))
            mission = worlds.setdefault((of.hostiles, of.reading), made)  # threads that come at once share one
        return Setup(mission, of.reinforcement, self.trials, self.repeats, self.practice, worlds)

    def mission(self, condition: str, building: str) -> Mission:
        """Return T's world on one building under one condition, made at its first use.

        Parameters
        ----------
        condition, building
            By name; buildings that are tried only afterwards (``unseen``) as well.

        Raises
        ------
        TaskliftError
            If there is no such mission: more hostiles than places, fewer weapon robots than a hostile needs.
        """
        return self._setup(condition, building).mission

    def cell(self, condition: str, building: str, seed: int, arm: str) -> Cell:
        """Return a cell of this study.

        Parameters
        ----------
        condition, building, arm
            By name.
        seed
            At least 0.
        """
        return Cell.of((self.axis, "map", "seed", "arm"), (condition, building, str(seed), arm))

    def cells(self) -> list[Cell]:
        """Return the units of work: those of one map and seed side by side, the first seeds first."""
        asked: dict[tuple[int, str, str], dict[str, None]] = {}
        for part in self.parts:
            for place in product(part.seeds, part.maps, part.conditions):
                asked.setdefault(place, {}).update(dict.fromkeys(part.arms))
        maps, conditions = list(self.buildings), list(self.conditions)
        order = sorted(asked, key=lambda at: (at[0], maps.index(at[1]), conditions.index(at[2])))
        return [self.cell(of, name, seed, arm) for seed, name, of in order for arm in asked[seed, name, of]]

    def slugs(self, building: str) -> list[str]:
        """Return the arms that are trained on one building."""
        return list(dict.fromkeys(slug for part in self.parts if building in part.maps for slug in part.arms))

    def curriculum(self, cell: Cell) -> Curriculum:
        """Return the curriculum of a cell's arm, made for its map and condition.

        Raises
        ------
        TaskliftError
            If the arm is unknown.
        """
        return arms_named([cell["arm"]], self.arms)[0].curriculum(self._setup(cell[self.axis], cell["map"]))

    # ------------------------------------------------------------ what is done

    def train(self, cell: Cell) -> CurriculumRun:
        """Train one arm on one map with one seed under one condition."""
        return self.curriculum(cell).run(int(cell["seed"]), shared=self._shared(cell))

    def work(self, cell: Cell) -> CellResult:
        """Train a cell, use what it learned greedily, and keep of it what :attr:`record` says."""
        run, arm = self.train(cell), self.arms[cell["arm"]]
        kept = {name: _columns(outcomes) for name, outcomes in run.outcomes.items() if name not in arm.unspent}
        last = kept[next(reversed(run.outcomes))]
        summary: dict[str, Any] = {
            "steps": float(last["steps"].mean()),
            "losses": int(last["losses"].sum()),
            "out_of_time": float(1.0 - last["success"].mean()),
            "would_be_losses": sum(entry.would_be for entry in run.ledger.entries),
            "trials": sum(len(columns["steps"]) for columns in kept.values()),
        }
        attachments: dict[str, Any] = {}
        if self.record.policy:
            attachments |= self._coverage(cell, run)
            if self.record.weights or arm.slug == SEARCHED.slug:
                attachments["weights"] = run.policy.weights
            if "target" in run.outcomes:
                weights = move_weights(run.policy)
                attachments |= {} if weights is None else {"move_weights": weights}
                for name, place in self._tried(cell).items():
                    kept[name] = _columns(self._greedily(cell, place, run.policy))
                    for column in ("steps", "losses", "success"):
                        summary[f"{name}_{column}"] = float(kept[name][column].mean())
        stages = self.record.stages or (tuple(kept) if arm.rows else ())
        rows = {
            stage: {name: kept[stage][name] for name in self.record.columns} for stage in stages if stage in kept
        }
        return CellResult(rows, summary, attachments)

    def replay(self, cell: Cell, trial: int, stage: str = "target") -> Trace:
        """Play one trial again, step by step, exactly as the unbroken run has it.

        Parameters
        ----------
        cell
            Of this study.
        trial
            Its number in the stage, counted from 0.
        stage
            A stage of the arm's curriculum; or ``greedy`` or ``unseen``, the use afterwards without learning.

        Raises
        ------
        TaskliftError
            If there is no such stage, it ends before that trial, or it is a search, which keeps no candidates.
        """
        seed, curriculum = int(cell["seed"]), self.curriculum(cell)
        if stage in self._tried(cell):
            mission = self.mission(cell[self.axis], self._tried(cell)[stage])
            return mission.simulator.trace(
                self.train(cell).policy, seed=seed, trial=trial, stage=GREEDY_STAGE,
                reinforcement=self._use(cell).reinforcement, learn=False,
            )  # fmt: skip
        searched = next((s for s in curriculum.stages if s.name == stage and isinstance(s.learner, PolicySearch)), None)
        if searched is not None:
            raise TaskliftError(
                f"stage {stage!r} is a search: each of its episodes is played by a candidate that is not kept; replay "
                "the stage target, or greedy"
            )
        policy = curriculum.policy_at(seed, stage, trial, shared=self._shared(cell))
        number = [one.name for one in curriculum.stages].index(stage)
        played = curriculum.stages[number]
        learner, output = _at(played.learner, trial), None
        if isinstance(learner, Sweep):
            output = trial % policy.task.shape[1]
        rules = learner if isinstance(learner, Reinforcement) else learner.reinforcement  # type: ignore[attr-defined]
        return played.world.simulator.trace(  # type: ignore[union-attr]
            policy, seed=seed, trial=trial, stage=curriculum.key(number), reinforcement=rules, output=output,
            learn=not isinstance(learner, Fixed),
        )  # fmt: skip

    def stage_trials(self, cell: Cell, stage: str = "target") -> int:
        """Return how many trials a stage of a cell has; parameters as in :meth:`replay`.

        Raises
        ------
        TaskliftError
            If there is no such stage.
        """
        if stage in self._tried(cell):
            return GREEDY_TRIALS
        for one in self.curriculum(cell).stages:
            if one.name == stage:
                return one.trials or one.learner.trials(one.task)  # type: ignore[attr-defined]
        names = [one.name for one in self.curriculum(cell).stages]
        raise TaskliftError(f"cell {cell}: no stage {stage!r}; there are {', '.join([*names, *self._tried(cell)])}")

    def _tried(self, cell: Cell) -> dict[str, str]:
        """Return the map of each greedy use."""
        places = {"greedy": cell["map"]}
        if self.unseen:
            places["unseen"] = list(self.unseen)[int(cell["seed"]) % len(self.unseen)]
        return places

    def _greedily(self, cell: Cell, building: str, policy: Policy) -> Any:
        mission = self.mission(cell[self.axis], building)
        run = Run(int(cell["seed"]), GREEDY_STAGE, trials=GREEDY_TRIALS)
        return self._use(cell).learn(mission, policy, run).outcomes

    def _use(self, cell: Cell) -> Fixed:
        return MIXED if self.arms[cell["arm"]].mixed else GREEDY

    def _coverage(self, cell: Cell, run: CurriculumRun) -> dict[str, Any]:
        """Return what V taught about CA, where the arm has learned V."""
        if "source" not in run.outcomes:
            return {}
        source = Curriculum(self.curriculum(cell).stages[:1], block=None)
        learned = source.run(int(cell["seed"]), shared=self._shared(cell)).policy
        steps = run.outcomes["source"].steps
        return {
            "ca_weights": ca_weights(learned),
            "ca_steps": _means(steps, learned.task.outputs, ("MV", "CA"))[1],  # the outputs in order, again and again
        }

    def _shared(self, cell: Cell) -> dict[Any, CurriculumRun]:
        group = (self, cell["map"], cell["seed"])
        if getattr(_latest, "group", None) != group:
            _latest.group, _latest.known = group, {}
        known: dict[Any, CurriculumRun] = _latest.known
        return known

    # ------------------------------------------------------------ as data

    def spec(self, name: str) -> Spec:
        """Return the study as data: rows of equal specs are equal. More seeds, maps or arms do not make it another one.

        Parameters
        ----------
        name
            For people.
        """
        seeds = sorted({seed for part in self.parts for seed in part.seeds})
        return Spec.of(
            name,
            {
                "otherwise": dataclasses.asdict(Condition()),
                "trials": self.trials,
                "repeats": self.repeats,
                "practice": self.practice,
                "mission": terms_to_json(self),
                "greedy_trials": GREEDY_TRIALS,
                "unseen": {name: _of_building(building) for name, building in self.unseen.items()},
                "record": dataclasses.asdict(self.record),
            },
            {
                self.axis: {name: condition.to_json() for name, condition in self.conditions.items()},
                "map": {name: _of_building(building) for name, building in self.buildings.items()},
                "seed": seeds,
                "arm": {arm: self.arms[arm].settings for part in self.parts for arm in part.arms},
            },
            over=("map", "seed"),
        )

    @classmethod
    def from_spec(cls, spec: Spec, folder: Path, arms: Mapping[str, Arm] = ARMS) -> Study:
        """Return the study of which ``spec`` is the specification, with every combination of its axes as a cell.

        Parameters
        ----------
        spec
            Of an experiment's store.
        folder
            Where buildings that were not generated lie, as ``.json`` files, and modules with sensors of one's own.
        arms
            By slug. Arms that were made from a spec file are made again.

        Raises
        ------
        TaskliftError
            If it is the specification of something else, or a building is not there.
        """
        from tasklift.studies.spec_file import own_arm

        settings, axes = spec.settings, spec.axes
        try:
            axis, (maps, seeds, slugs) = next(iter(axes)), (axes[name] for name in ("map", "seed", "arm"))
            conditions = axes[axis]
            kept = settings["record"]
            own = {slug: own_arm(slug, of, folder) for slug, of in slugs.items() if of is not None}
            return cls(
                {name: _building(folder, name, of) for name, of in maps.items()},
                {name: Condition.from_json(of) for name, of in conditions.items()},
                (Part(tuple(slugs), tuple(conditions), tuple(maps), tuple(int(seed) for seed in seeds)),),
                axis=axis,
                unseen={name: _building(folder, name, of) for name, of in settings["unseen"].items()},
                record=Record(tuple(kept["columns"]), tuple(kept["stages"]), kept["policy"], kept["weights"]),
                arms={**arms, **own},
                **{key: settings[key] for key in ("trials", "repeats", "practice")},
                **terms_from_json(settings["mission"], f"{folder}, mission", OwnCode(folder).named),
            )
        except (KeyError, TypeError, ValueError, AttributeError) as error:
            if isinstance(error, TaskliftError):
                raise
            raise TaskliftError(
                f"{folder}: not a study of missions by this release of tasklift ({error!r}); `tasklift runs show` "
                "lists its settings"
            ) from error


def _at(learner: Learner, trial: int) -> Learner:
    """Return the learner whose turn a trial is."""
    if not isinstance(learner, InTurn):
        return learner
    return learner.learners[sum(start <= trial for start in learner.starts) - 1]


def _of_building(building: Building) -> dict[str, Any]:
    """Return a building's content, and how it was generated, if it was."""
    made = building.provenance
    return {
        "content": building.content_id,
        "generated": made.get("arguments") if made.get("source") == "tasklift.building.generate" else None,
    }


def _building(folder: Path, name: str, of: Mapping[str, Any]) -> Building:
    """Return the building of that content: generated again, or beside the experiment."""
    if of["generated"]:
        building = generate(**of["generated"])
        if building.content_id == of["content"]:
            return building
    for file in sorted(folder.rglob("*.json")):
        try:
            building = Building.load(file)
        except TaskliftError:
            continue  # a policy, for example
        if building.content_id == of["content"]:
            return building
    raise TaskliftError(f"{folder}: the building {name!r} of this experiment is gone; put its .json file back there")


def _columns(outcomes: Any) -> dict[str, NDArray[Any]]:
    found: SearchOutcomes = outcomes
    return {
        "steps": found.steps,
        "success": found.success,
        "losses": found.losses,
        "robots_left": found.robots_left.sum(axis=1),
        "teams_left": found.teams_left,
        "hostiles_left": found.hostiles_left,
        "explored": found.explored.astype(np.float32),
        "messages": found.messages,
    }


def move_weights(policy: Policy) -> NDArray[np.float64] | None:
    """Return Figure 5's table, float64 (3, 5, 2): the mean weight by nWPN, FTR and MV, over all else.

    None if the task lacks one of them.
    """
    task, kept = policy.task, ("nWPN", "FTR", "MV")
    if not {variable.name for variable in task.variables}.issuperset(kept):
        return None
    return _means(policy.weights, task.variables, kept)


def ca_weights(source: Policy) -> NDArray[np.float64]:
    """Return Figure 3's curve, float64 (11,): V's mean weight by CA where robots move, over all else."""
    found: NDArray[np.float64] = _means(source.weights, source.task.variables, ("MV", "CA"))[1]
    return found


def _means(table: NDArray[Any], variables: Sequence[Variable], kept: Sequence[str]) -> NDArray[np.float64]:
    """Return the means of a table over all variables but those that are kept, one axis for each of these, in order.

    The table's last axes are those of the variables; it is averaged over further ones before them, too.
    """
    cube = table.reshape(-1, *map(len, variables))
    names = ["", *(variable.name for variable in variables)]
    means = cube.mean(axis=tuple(k for k, name in enumerate(names) if name not in kept))
    left = [name for name in names if name in kept]
    return np.asarray(means.transpose([left.index(name) for name in kept]))


def numbered(count: int, what: str, first: int = 0) -> range:
    """Return that many numbers from ``first`` on.

    Parameters
    ----------
    count, what
        How many of what: ``seeds``, or another word for maps.

    Raises
    ------
    TaskliftError
        If they are fewer than one, or too many to make.
    """
    return range(first, first + whole_number(count, what, 1, MOST_SEEDS if what == "seeds" else MOST_MAPS))


def generated(seeds: Sequence[int], **options: Any) -> dict[str, Building]:
    """Return generated buildings by name: ``map-0`` has the seed 0.

    Parameters
    ----------
    seeds
        Of the buildings.
    options
        As in :func:`tasklift.building.generate`.
    """
    return {f"map-{seed}": generate(seed=seed, **options) for seed in seeds}
