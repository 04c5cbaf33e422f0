"""The search for a simpler task: candidates × seeds as cells, raced against learning from scratch.

The paper ends with this question (section VIII): identifying the simpler task "cannot be intuitively realized for
complex, tightly-coupled problems". All candidates spend the same budget, and learning from scratch spends as much on
the target task itself.
"""

from __future__ import annotations

import os
import threading
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from tasklift import stats
from tasklift.building import Mission
from tasklift.checks import check_fields, number, one_of, whole_number
from tasklift.errors import TaskliftError, about
from tasklift.lab import Cell, CellResult, Progress, Spec, Store, run
from tasklift.learning.curriculum import Curriculum
from tasklift.learning.model import Model
from tasklift.learning.worlds import StepOutcomes
from tasklift.studies.own_code import OwnCode
from tasklift.studies.simplify.space import Candidate, chains, joined, steps
from tasklift.studies.spec_file import code_beside, curriculum_of, read_spec
from tasklift.text import shown

SCRATCH = "from scratch"
#: Seeds of the race: rung after rung the better half of the candidates goes on to more of them.
RUNGS = (4, 8, 16)
#: Before the race each candidate is probed: with this share of the episodes, and as many seeds. The best quarter, but
#: at least as many as stand third, is raced. Of the cheap signals tried, only this one foretells what is saved.
PROBE_SHARE, PROBE_SEEDS, PROBE_LEAST = 0.25, 2, 4
#: As many of the best stages are tried with a simpler stage before them.
LAST_STAGES = 2
#: As many of the best candidates are measured on the seeds that judge, so that the regret of the choice is known.
FINALISTS = 3
#: The seeds that judge begin here, which the race has not seen. Buildings are numbered by seeds, so they are new, too.
HELD_OUT = 1_000_000
#: How many there are, unless the spec says otherwise.
FINAL = 30
#: A candidate's late success may be this much lower than that of learning from scratch; in a probe, which knows less.
MARGIN, PROBE_MARGIN = 0.05, 0.2
#: Episodes whose success is *late*; of the moving mean that is compared with the threshold.
LATE = 20
#: The share of successes to reach, unless the spec says otherwise.
THRESHOLD = 0.8
#: The most episodes of a stage.
MOST_TRIALS = 10_000_000
#: What can be compared; less is better for all of them.
CRITERIA = ("losses", "losses-after-arrival", "steps", "steps-to-threshold", "area")

_latest = threading.local()  # the worlds of this thread, those of one building at a time


@dataclass(frozen=True)
class Measures:
    """What a candidate came to, one entry per seed: its criterion, late success, losses and steps before the target."""

    criterion: NDArray[np.float64]
    success: NDArray[np.float64]
    losses_before: NDArray[np.float64]
    steps_before: NDArray[np.float64]


@dataclass(frozen=True)
class Raced:
    """A candidate's place in the race: its measures, whether it keeps to all limits, and what it saves.

    ``saved`` is a share of what learning from scratch comes to on the same seeds.
    """

    candidate: Candidate
    measures: Measures
    allowed: bool
    saved: float

    @property
    def seeds(self) -> int:
        """On how many seeds it was raced."""
        return len(self.measures.success)

    @property
    def rank(self) -> tuple[bool, float]:
        """What candidates are sorted by: those within the limits first, then by the mean of the criterion."""
        return not self.allowed, float(self.measures.criterion.mean())


@dataclass(frozen=True)
class Found:
    """What the search came to.

    Attributes
    ----------
    best
        The candidate to learn first; None: learn the target task from scratch.
    race
        The candidates that were raced, the best first.
    probed
        Those of one stage that a probe left out, the best first.
    scratch
        Learning from scratch, on the race's seeds.
    judged
        On seeds that the race has not seen: the chosen candidate first, the other finalists, the user's own curricula.
    judge
        Learning from scratch on those seeds.
    refused
        Candidates that cannot run, with the reason.
    tried
        How many candidates there were, those that were only probed included.
    episodes
        What the search spent.
    """

    best: Candidate | None
    race: list[Raced]
    probed: list[Raced]
    scratch: Measures
    judged: list[Raced]
    judge: Measures
    refused: dict[str, str]
    tried: int
    episodes: int

    def against_scratch(self) -> stats.Comparison:
        """Compare the chosen candidate with learning from scratch."""
        return stats.compare(self.judged[0].measures.criterion, self.judge.criterion, better="less")

    @property
    def runner_up(self) -> Raced | None:
        """The best of the others that were judged."""
        return min(self.judged[1:], key=lambda one: one.rank, default=None)

    def regret(self, other: Raced) -> tuple[stats.Comparison, stats.Comparison]:
        """Compare the chosen candidate with another one by criterion and by late success, on the seeds that judge."""
        ours, theirs = self.judged[0].measures, other.measures
        return (
            stats.compare(ours.criterion, theirs.criterion, better="less"),
            stats.compare(ours.success, theirs.success, better="greater"),
        )


@dataclass(frozen=True, eq=False)
class SimplifyStudy:
    """The search as cells: candidates × seeds, learning from scratch among them.

    Parameters
    ----------
    document
        As :func:`.read_spec` returns it: one stage, the target task, and a table ``simplify``.
    folder
        Where the spec lies.
    allow_imports
        As in :func:`.curriculum_of`.

    Raises
    ------
    TaskliftError
        If the spec has more than the target stage, no budget for simpler tasks, or a setting that is out of range.
    """

    document: Mapping[str, Any]
    folder: Path
    allow_imports: bool = False
    found: list[Candidate] = field(init=False)
    refused: dict[str, str] = field(init=False)

    def __post_init__(self) -> None:
        _check(self.settings)
        stages = self.document["stages"]
        if len(stages) != 1 or not isinstance(stages[0], Mapping) or "trials" not in stages[0]:
            raise TaskliftError("simplify: expected one [[stages]] with trials, the target task")
        whole_number(stages[0]["trials"], "stages 1, trials", 1, MOST_TRIALS)
        target = self.curriculum(None).stages[-1]
        made = [Candidate(own=own) for own in self.settings.get("curricula", ())]
        made += steps(target.task, self.settings, target.world)
        names = [candidate.name for candidate in made]
        if double := [name for name in names if names.count(name) > 1]:
            raise TaskliftError(f"simplify: two candidates are called {double[0]!r}; give your own other names")
        object.__setattr__(self, "refused", {})
        object.__setattr__(self, "found", self.runnable(made))

    def runnable(self, candidates: Sequence[Candidate]) -> list[Candidate]:
        """Return the candidates that can run; the others are kept in ``refused``, with the reason."""
        good = []
        for candidate in candidates:
            try:
                self.curriculum(candidate)
                good.append(candidate)
            except TaskliftError as error:
                if candidate.own is not None:
                    raise TaskliftError(f"simplify, curricula, {candidate.words!r}: {error}") from error
                self.refused[candidate.words] = str(error)
        return good

    @property
    def settings(self) -> Mapping[str, Any]:
        """The spec's ``[simplify]``."""
        found: Mapping[str, Any] = self.document.get("simplify", {})
        return found

    @property
    def criterion(self) -> str:
        """What is compared."""
        return str(self.settings.get("criterion", "losses"))

    @property
    def episodes(self) -> int:
        """Of one run, on all stages together."""
        return int(self.settings["trials"] + self.document["stages"][0]["trials"])

    @property
    def most_chains(self) -> int:
        """The most candidates of two stages that there can be."""
        if self.settings.get("stages", 1) < 2:
            return 0
        last = [candidate for candidate in self.found if candidate.own is None]
        by_stage = sorted((len(chains([one], last)) for one in last), reverse=True)
        return sum(by_stage[:LAST_STAGES])

    def price(self) -> int:
        """Return the most episodes that the search may spend: probes, races, and the seeds that judge."""
        own = len(self.settings.get("curricula", ()))
        runs = _runs(len(self.found) - own, own) + (_runs(self.most_chains, 0) if self.most_chains else 0)
        runs += (1 + FINALISTS + own) * int(self.settings.get("seeds", FINAL))
        return round(runs * self.episodes)

    def spec_of(self, candidate: Candidate | None, share: float = 1.0) -> dict[str, Any]:
        """Return the curriculum of a candidate as a spec; None: the target task with the budget of both.

        ``share`` of the episodes of every stage; of a curriculum of the user's own, of the target's alone.
        """
        trials = max(1, round(share * self.settings["trials"]))
        target = dict(self.document["stages"][0])
        target["trials"] = max(1, round(share * target["trials"]))
        document = {name: value for name, value in self.document.items() if name != "simplify"}
        if candidate is None:
            target["trials"] += trials
            return {**document, "stages": [target]}
        budget = {name: self.settings[name] for name in ("learner",) if name in self.settings}
        before, entering = candidate.stages({**budget, "trials": trials})
        return {**document, "stages": [*before, joined([entering, target])]}

    def curriculum(self, candidate: Candidate | None, seed: int = 0, share: float = 1.0) -> Curriculum:
        """Return the curriculum of a candidate, or of learning from scratch; each seed has a generated building."""
        document = self.spec_of(candidate, share)
        environment = document["environment"]
        if isinstance(environment.get("building"), Mapping):
            building = environment["building"]
            first = whole_number(building.get("seed", 0), "environment, building, seed")
            document["environment"] = {**environment, "building": {**building, "seed": first + seed}}
        if getattr(_latest, "key", None) != (self, document["environment"]):
            _latest.key, _latest.worlds = (self, document["environment"]), {}
        return curriculum_of(document, self.folder, allow_imports=self.allow_imports, worlds=_latest.worlds)

    @property
    def workers(self) -> int | None:
        """One per core for compiled worlds; one for worlds in Python."""
        return None if isinstance(self.curriculum(None).stages[-1].world, Model | Mission) else 1

    def measured(
        self,
        file: Path,
        candidates: Sequence[Candidate],
        seeds: Sequence[int],
        progress: Progress | None,
        share: float = 1.0,
    ) -> tuple[list[Measures], Measures]:
        """Return the candidates' measures and those of learning from scratch; what the store has is not run again.

        With a ``share`` of the episodes it is a probe.
        """
        probe = "probe: " if share < 1 else ""
        known: dict[str, Candidate | None] = {probe + candidate.name: candidate for candidate in candidates}
        known[probe + SCRATCH] = None
        meant = {name: self.spec_of(candidate, share)["stages"] for name, candidate in known.items()}
        # stages decide what a candidate comes to: other candidates, criteria or seeds go on in the same file
        settings = {name: value for name, value in self.document.items() if name not in ("name", "seeds", "simplify")}
        settings["threshold"] = self.settings.get("threshold", THRESHOLD)
        world = self.curriculum(None).stages[-1].world
        settings["building"] = world.building.content_id if isinstance(world, Mission) else None
        settings["modules"] = code_beside(self.document, self.folder)
        axes: dict[str, Any] = {"seed": seeds, "candidate": meant}
        spec = Spec.of(str(self.document["name"]), settings, axes, over=["seed"])

        def work(cell: Cell) -> CellResult:
            with OwnCode(self.folder).running("training"):
                seed = int(cell["seed"])
                return self._result(self.curriculum(known[cell["candidate"]], seed, share), seed, share)

        columns: dict[str, list[list[float]]] = {name: [] for name in known}
        with Store.open(file, spec) as store:
            run(store, spec.cells(), work, workers=self.workers, progress=progress)
            for cell, summary in store.outlines():
                names = (self.criterion, "success", "losses before", "steps before")
                columns[cell["candidate"]].append([float(summary[name]) for name in names])
        *found, scratch = [Measures(*np.array(columns[name]).T) for name in known]
        return found, scratch

    def _result(self, curriculum: Curriculum, seed: int, share: float) -> CellResult:
        """Run a curriculum and sum it up; the target's last episodes count, as many as a curriculum has there."""
        done, name = curriculum.run(seed), curriculum.stages[-1].name
        earlier = [entry for entry in done.ledger.entries if entry.stage != name]
        summary = {
            "episodes": sum(entry.trials for entry in done.ledger.entries),
            "losses": float(done.ledger.total),
            "losses before": float(sum(entry.losses for entry in earlier)),
            "steps before": float(sum(entry.steps for entry in earlier)),
            "success": 0.0,
        }
        if name not in done.outcomes:  # a cap on losses was reached before
            return CellResult({}, dict.fromkeys(CRITERIA, 0.0) | summary)
        last, n = done.outcomes[name], max(1, round(share * self.document["stages"][0]["trials"]))
        gained = last.returns if isinstance(last, StepOutcomes) else last.success
        until = stats.time_to_threshold(
            last.success[None, :].astype(float), self.settings.get("threshold", THRESHOLD),
            window=min(LATE, len(last)), cost=last.steps[None, :], source=summary["steps before"], better="greater",
        )  # fmt: skip
        summary |= {
            "losses-after-arrival": float(last.losses[-n:].sum()),
            "steps": float(last.steps[-n:].mean()),
            "steps-to-threshold": float(until.time[0]),
            "area": -float(gained[-n:].mean()),
            "success": float(last.success[-LATE:].mean()),
        }
        return CellResult({}, summary)

    def race(
        self, file: Path, candidates: Sequence[Candidate], progress: Progress | None
    ) -> tuple[list[Raced], list[Raced], Measures]:
        """Probe candidates, then race the best on growing sets of seeds.

        Returns those that were raced, those that the probe left out, the best first, and learning from scratch. The
        user's own are raced unprobed.
        """
        own = [candidate for candidate in candidates if candidate.own is not None]
        made = [candidate for candidate in candidates if candidate.own is None]
        probed: list[Raced] = []
        if len(made) > PROBE_LEAST:
            probed, _ = self._measured(file, made, range(PROBE_SEEDS), progress, PROBE_SHARE)
            probed.sort(key=lambda one: one.rank)
            made = [one.candidate for one in probed[: _best_quarter(len(made))]]
        going, out = [*own, *made], list[Raced]()
        for seeds in RUNGS:
            raced, scratch = self._measured(file, going, range(seeds), progress)
            raced.sort(key=lambda one: one.rank)
            left = len(raced) if seeds == RUNGS[-1] else _better_half(len(raced))
            going, out = [one.candidate for one in raced[:left]], [*raced[left:], *out]
        return [*raced, *out], probed[len(made) :], scratch

    def _measured(
        self,
        file: Path,
        candidates: Sequence[Candidate],
        seeds: Sequence[int],
        progress: Progress | None,
        share: float = 1.0,
    ) -> tuple[list[Raced], Measures]:
        """Measure candidates, in the order given, and learning from scratch."""
        found, scratch = self.measured(file, candidates, seeds, progress, share)
        whole = float(scratch.criterion.mean())
        return [
            Raced(one, m, self._allowed(m, scratch, share), (whole - float(m.criterion.mean())) / max(abs(whole), 1e-9))
            for one, m in zip(candidates, found, strict=True)
        ], scratch

    def _allowed(self, measures: Measures, scratch: Measures, share: float = 1.0) -> bool:
        """Return whether late success is high enough, and what the user limits is within the limits."""
        most = self.settings.get("most", {})
        margin = MARGIN if share == 1 else PROBE_MARGIN
        return bool(
            measures.success.mean() >= scratch.success.mean() - margin
            and measures.losses_before.mean() <= share * most.get("losses", np.inf)
            and measures.steps_before.mean() <= share * most.get("steps", np.inf)
        )

    def search(self, file: Path, progress: Progress | None = None) -> Found:
        """Race the candidates, and judge the chosen one on new seeds; ``file`` keeps every run."""
        race, probed, scratch = self.race(file, self.found, progress)
        longer: list[Candidate] = []
        if self.settings.get("stages", 1) > 1:
            good = [one.candidate for one in race if one.candidate.own is None][:LAST_STAGES]
            singles = [candidate for candidate in self.found if candidate.own is None]
            longer = self.runnable(chains(good, singles))
        if longer:
            race = sorted([*race, *self.race(file, longer, progress)[0]], key=lambda one: (-one.seeds, one.rank))
        finalists = [one.candidate for one in chosen_first(race)[:FINALISTS]]
        finalists += [c for c in self.found if c.own is not None and c not in finalists]
        fresh = range(HELD_OUT, HELD_OUT + self.settings.get("seeds", FINAL))
        judged, judge = self._measured(file, finalists, fresh, progress)
        with Store.read(file) as store:
            spent = sum(int(summary["episodes"]) for _, summary in store.outlines())
        tried = len(self.found) + len(longer)
        found = Found(None, race, probed, scratch, judged, judge, dict(self.refused), tried, spent)
        helps = bool(judged) and judged[0].allowed and found.against_scratch().verdict == "holds"
        return replace(found, best=judged[0].candidate) if helps else found


def chosen_first(race: Sequence[Raced]) -> list[Raced]:
    """Return the candidates of the last rung, the chosen one first: the simplest that is as good as the best.

    *As good*: its mean is at most one standard error of their paired difference behind (Breiman et al. 1984).
    """
    last = [one for one in race if one.seeds == RUNGS[-1]]
    if not last:
        return []
    best, *_ = last
    equals = [best]
    for one in last[1:]:
        behind = one.measures.criterion - best.measures.criterion
        if one.allowed == best.allowed and behind.mean() <= behind.std(ddof=1) / np.sqrt(len(behind)):
            equals.append(one)
    chosen = min(equals, key=lambda one: one.candidate.complexity)
    return [chosen, *(one for one in last if one is not chosen)]


def study_of(path: str | os.PathLike[str], *, allow_imports: bool = False) -> SimplifyStudy:
    """Return the search that a spec asks for; parameters and errors as in :func:`.simplify`."""
    document = read_spec(path)
    with about(path):
        return SimplifyStudy(document, Path(path).parent, allow_imports)


def _best_quarter(n: int) -> int:
    return min(n, max(PROBE_LEAST, (n + 3) // 4))


def _better_half(n: int) -> int:
    return min(n, max(2, (n + 1) // 2))


def _runs(made: int, own: int) -> float:
    """Return how many whole runs a race takes, those from scratch included: of candidates made and the user's own."""
    probes = PROBE_SEEDS * PROBE_SHARE * (made + 1) if made > PROBE_LEAST else 0.0
    left, before, total = own + _best_quarter(made), 0, 0
    for seeds in RUNGS:
        total += (left + 1) * (seeds - before)
        left, before = _better_half(left), seeds
    return probes + total


def _check(settings: Mapping[str, Any]) -> None:
    """Raise :class:`TaskliftError` for the first setting of ``[simplify]`` that is wrong."""
    where = "simplify"
    check_fields(
        settings,
        where,
        {
            "trials": int,
            "learner?": dict,
            "switches?": list,
            "depth?": int,
            "stages?": int,
            "never?": list,
            "most?": dict,
            "priors?": list,
            "trust?": list,
            "curricula?": list,
            "criterion?": str,
            "threshold?": (int, float),
            "seeds?": int,
        },
    )
    whole_number(settings["trials"], f"{where}, trials", 1, MOST_TRIALS)
    whole_number(settings.get("depth", 1), f"{where}, depth", 0, 3)
    whole_number(settings.get("stages", 1), f"{where}, stages", 1, 2)
    whole_number(settings.get("seeds", FINAL), f"{where}, seeds", stats.seeds_needed(), 100_000)
    number(settings.get("threshold", THRESHOLD), f"{where}, threshold", 0, 1)
    one_of(settings.get("criterion", "losses"), tuple(CRITERIA), f"{where}, criterion")
    check_fields(settings.get("most", {}), f"{where}, most", {"losses?": (int, float), "steps?": (int, float)})
    for trust in settings.get("trust", ()):
        number(trust, f"{where}, trust", 0, above=True)
    for k, names in enumerate(settings.get("never", ())):
        if not isinstance(names, list) or not all(isinstance(name, str) for name in names):
            raise TaskliftError(f"{where}, never {k + 1}: expected a list of inputs, found {shown(names)}")
    lists: dict[str, dict[str, Any]] = {
        "switches": {"name": str, "options?": dict, "fix?": dict, "harmless?": bool, "learner?": dict,
                     "signals?": list, "time_reward?": (int, float)},
        "priors": {"name": str, "operations": list},
        "curricula": {"name": str, "stages": list, "prior?": list, "trust?": (int, float)},
    }  # fmt: skip
    for name, fields in lists.items():
        for k, entry in enumerate(settings.get(name, ())):
            check_fields(entry, f"{where}, {name} {k + 1}", fields)
            for stage in entry.get("stages", ()):
                if not isinstance(stage, Mapping):
                    raise TaskliftError(f"{where}, {name} {k + 1}: expected tables as stages, found {shown(stage)}")
