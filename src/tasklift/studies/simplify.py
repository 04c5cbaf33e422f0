"""Which simpler task to learn first: candidates from a task's variables and a world's switches, raced against scratch.

The paper ends with this question (section VIII): identifying the simpler task "cannot be intuitively realized for
complex, tightly-coupled problems". A candidate here is one stage before the target task: a switch of the world, a
simplification of the task, and what is carried over. All candidates spend the same budget, and learning from scratch
spends as much on the target task itself.
"""

from __future__ import annotations

import os
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from itertools import combinations
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from tasklift import stats
from tasklift.building import Mission
from tasklift.checks import check_fields, one_of, whole_number
from tasklift.errors import TaskliftError
from tasklift.files import canonical_json, results_folder, write_atomically
from tasklift.lab import FILE_NAME, Cell, CellResult, Progress, Spec, Store, run
from tasklift.learning.curriculum import Curriculum
from tasklift.learning.model import Model
from tasklift.learning.worlds import StepOutcomes
from tasklift.studies.own_code import OwnCode
from tasklift.studies.spec_file import about, curriculum_of, read_spec
from tasklift.tasks.task import Task

SCRATCH = "scratch"
#: Seeds of the race: rung after rung the better half of the candidates goes on to more of them.
RUNGS = (4, 8, 16)
#: The final comparison uses seeds from here on, which the race has not seen.
HELD_OUT = 1_000_000
#: How many there are, unless the spec says otherwise.
FINAL = 30
#: What is compared; all are better when they are less.
CRITERIA = ("losses", "losses-after-arrival", "steps")
#: A candidate's late success may be this much lower than that of learning from scratch.
MARGIN = 0.05


@dataclass(frozen=True)
class Candidate:
    """A simpler task to learn first, and what to carry over.

    Attributes
    ----------
    slug, words
        Its name in stores and files, and in a sentence.
    stage
        The stage before the target, in the words of a spec.
    prior
        What is forgotten of its policy.
    states
        Size of its table, in states (inputs): cheaper candidates come first.
    """

    slug: str
    words: str
    stage: Mapping[str, Any]
    prior: tuple[Mapping[str, Any], ...]
    states: int


@dataclass(frozen=True)
class Answer:
    """What the search came to.

    Attributes
    ----------
    best
        The candidate to learn first; None: learn the target task from scratch.
    lines
        The answer in sentences.
    rows
        The race: for each candidate its words, the seeds it was raced on, its mean criterion and late success.
    comparison
        The best candidate against learning from scratch, on seeds that the race has not seen.
    document
        The recommended curriculum, as a spec.
    episodes
        What the search itself spent.
    """

    best: Candidate | None
    lines: list[str]
    rows: list[list[Any]]
    comparison: stats.Comparison | None
    document: Mapping[str, Any]
    episodes: int


def candidates(task: Task, settings: Mapping[str, Any], never: Sequence[Sequence[str]] = ()) -> list[Candidate]:
    """Return every candidate once, the cheapest first.

    Parameters
    ----------
    task
        The target task.
    settings
        The spec's ``[simplify]``: ``switches``, ``fix``, ``depth``, ``trials``.
    never
        Pairs of inputs that must not be left out together.

    Examples
    --------
    >>> from tasklift.tasks.task import Variable
    >>> walk = Task("walk", (Variable("place", range(8)), Variable("rain", (0, 1))), (Variable("go", (0, 1)),))
    >>> [candidate.words for candidate in candidates(walk, {"trials": 20})]
    ['without place', 'without rain']
    """
    inputs = [variable.name for variable in task.inputs]
    left_out: list[tuple[str, ...]] = [()]
    for depth in range(1, settings.get("depth", 1) + 1):
        left_out += [
            names
            for names in combinations(inputs, depth)
            if depth < max(len(inputs), 2) and not any(set(pair) <= set(names) for pair in never)
        ]
    switches: list[Mapping[str, Any]] = [{"name": "", "options": {}}, *settings.get("switches", ())]
    forgotten = [None, *(v.name for v in task.outputs if len(v) > 1)] if len(task.outputs) > 1 else [None]
    found = []
    for switch in switches:
        fixed = {name: value for name, value in switch.get("fix", {}).items() if name in inputs}
        for names in left_out:
            if set(names) & set(fixed):
                continue
            simple = task.simplify(fix=fixed, remove=list(names), signals=())
            for output in forgotten:
                words = [switch["name"], *(f"without {name}" for name in names)]
                slug = [switch["name"].replace(" ", "_"), *names, *([f"forget_{output}"] if output else [])]
                stage: dict[str, Any] = {"name": "simple", "trials": settings["trials"]}
                stage |= {"options": dict(switch["options"])} if switch["options"] else {}
                stage |= {"fix": fixed} if fixed else {}
                stage |= {"remove": list(names)} if names else {}
                stage |= {"rehearsal": True} if switch.get("harmless", False) else {}
                prior = ({"operation": "forget", "output": output},) if output else ()
                said = ", ".join(filter(None, words))
                said += f"; forget {output}" if output else ""
                found.append(Candidate("-".join(filter(None, slug)), said, stage, prior, simple.shape[0]))
    simpler = [candidate for candidate in found if candidate.stage.keys() != {"name", "trials"}]
    return sorted(simpler, key=lambda candidate: (candidate.states, len(candidate.prior)))


@dataclass(frozen=True, eq=False)
class SimplifyStudy:
    """The search as cells: candidates × seeds, learning from scratch among them.

    Raises
    ------
    TaskliftError
        If the spec has more than the target stage, or no budget for simpler tasks.
    """

    document: Mapping[str, Any]
    folder: Path
    allow_imports: bool = False
    found: dict[str, Candidate] = field(init=False)

    def __post_init__(self) -> None:
        settings = check_fields(
            self.document.get("simplify"),
            "simplify",
            {"trials": int, "switches?": list, "depth?": int, "never?": list, "criterion?": str, "seeds?": int},
        )
        whole_number(settings["trials"], "simplify, trials", 1)
        whole_number(settings.get("depth", 1), "simplify, depth", 0, 3)
        one_of(settings.get("criterion", "losses"), CRITERIA, "simplify, criterion")
        for k, switch in enumerate(settings.get("switches", ())):
            check_fields(
                switch, f"simplify, switches {k + 1}", {"name": str, "options": dict, "fix?": dict, "harmless?": bool}
            )
        if len(self.document["stages"]) != 1 or "trials" not in self.document["stages"][0]:
            raise TaskliftError("simplify: expected one [[stages]] with trials, the target task")
        task = self.curriculum(None).stages[-1].task
        made = candidates(task, settings, settings.get("never", ()))
        object.__setattr__(self, "found", {candidate.slug: candidate for candidate in made})

    def price(self) -> int:
        """Return how many episodes the search may spend: the rungs of the race, and the final comparison."""
        left, total = len(self.found), 0
        before = 0
        for seeds in RUNGS:
            total += (left + 1) * (seeds - before)
            before, left = seeds, max(2, (left + 1) // 2)
        total += 2 * int(self.settings.get("seeds", FINAL))
        return total * int(self.settings["trials"] + self.document["stages"][0]["trials"])

    @property
    def settings(self) -> Mapping[str, Any]:
        """The spec's ``[simplify]``."""
        found: Mapping[str, Any] = self.document["simplify"]
        return found

    def spec_of(self, candidate: Candidate | None) -> dict[str, Any]:
        """Return the curriculum of a candidate as a spec; None: the target task with the budget of both."""
        target = dict(self.document["stages"][0])
        document = {name: value for name, value in self.document.items() if name != "simplify"}
        if candidate is None:
            target["trials"] += self.settings["trials"]
            return {**document, "stages": [target]}
        target["prior"] = [*map(dict, candidate.prior), *target.get("prior", ())]
        return {**document, "stages": [dict(candidate.stage), target if target["prior"] else {**target, "prior": []}]}

    def curriculum(self, candidate: Candidate | None) -> Curriculum:
        """Return the curriculum of a candidate, or of learning from scratch."""
        return curriculum_of(self.spec_of(candidate), self.folder, allow_imports=self.allow_imports)

    @property
    def workers(self) -> int | None:
        """One per core for compiled worlds; one for worlds in Python."""
        return None if isinstance(self.curriculum(None).stages[-1].world, Model | Mission) else 1

    def spec(self, slugs: Sequence[str], seeds: Sequence[int]) -> Spec:
        """Return the experiment's spec: the document, seeds and candidates."""
        settings = {name: value for name, value in self.document.items() if name not in ("name", "seeds")}
        return Spec.of(str(self.document["name"]), settings, {"seed": seeds, "candidate": list(slugs)}, over=["seed"])

    def work(self, cell: Cell) -> CellResult:
        """Learn with one candidate and one seed."""
        candidate = self.found.get(cell["candidate"])
        trials = self.document["stages"][0]["trials"]
        with OwnCode(self.folder).running("training"):
            curriculum = self.curriculum(candidate)
            done = curriculum.run(seed=int(cell["seed"]))
        last = done.outcomes[curriculum.stages[-1].name]
        late = max(1, min(20, len(last)))
        summary = {
            "losses": int(done.ledger.total),
            "losses-after-arrival": int(last.losses[:trials].sum()),
            "steps": float(last.steps[:trials].mean()) if len(last) else 0.0,
            "success": float(last.success[-late:].mean()) if len(last) else 0.0,
        }
        if isinstance(last, StepOutcomes) and len(last):
            summary["return"] = float(last.returns[-late:].mean())
        return CellResult({}, summary)


def study_of(path: str | os.PathLike[str], *, allow_imports: bool = False) -> SimplifyStudy:
    """Return the search that a spec asks for; parameters and errors as in :func:`simplify`."""
    document = read_spec(path)
    with about(path):
        return SimplifyStudy(document, Path(path).parent, allow_imports)


def simplify(
    path: str | os.PathLike[str],
    out: str | os.PathLike[str] | None = None,
    *,
    allow_imports: bool = False,
    progress: Progress | None = None,
) -> Answer:
    """Say which simpler task to learn first, or that none helps.

    Candidates are raced on growing sets of seeds (:data:`RUNGS`), the better half going on. The best one that reaches
    the target task's success is then compared with learning from scratch on seeds that the race has not seen.

    Parameters
    ----------
    path
        A spec with one stage, the target task, and a table ``[simplify]``.
    out
        A folder for the experiment, ``curriculum.json`` (the recommended spec, which ``tasklift learn`` runs) and
        ``answer.txt``; the same call resumes there.
    allow_imports
        As in :func:`.curriculum_of`.
    progress
        As in :func:`tasklift.lab.run`.

    Raises
    ------
    TaskliftError
        For whatever is wrong with the spec or the folder, before anything is trained.
    """
    study = study_of(path, allow_imports=allow_imports)
    with about(path), results_folder(out, (FILE_NAME,)) as folder:
        answer = search(study, folder, progress)
        if out is not None:
            write_atomically(folder / "curriculum.json", canonical_json(dict(answer.document)) + "\n")
            write_atomically(folder / "answer.txt", "\n".join(answer.lines) + "\n")
    return answer


def search(study: SimplifyStudy, folder: Path, progress: Progress | None = None) -> Answer:
    """Race the candidates, and judge the best one on new seeds; the experiment is kept in ``folder``."""
    file = folder / FILE_NAME
    criterion = study.settings.get("criterion", "losses")
    going, broken, spent = list(study.found), {}, 0
    for slug in list(going):  # what cannot run is refused before anything is trained
        try:
            study.curriculum(study.found[slug]).check()
        except TaskliftError as error:
            broken[slug] = str(error)
            going.remove(slug)
    raced: dict[str, tuple[int, float, float]] = {}
    for seeds in RUNGS:
        found = _measure(study, file, [*going, SCRATCH], range(seeds), progress)
        scratch = found.pop(SCRATCH)
        means = {slug: (float(m[criterion].mean()), float(m["success"].mean())) for slug, m in found.items()}
        raced |= {slug: (seeds, *mean) for slug, mean in means.items()}
        raced[SCRATCH] = (seeds, float(scratch[criterion].mean()), float(scratch["success"].mean()))
        good = scratch["success"].mean() - MARGIN
        order = sorted(means, key=lambda slug: (means[slug][1] < good, means[slug][0]))
        going = order if seeds == RUNGS[-1] else order[: max(2, (len(order) + 1) // 2)]
    per_run = study.settings["trials"] + study.document["stages"][0]["trials"]
    spent = sum(seeds for seeds, *_ in raced.values()) * per_run
    best = study.found[going[0]] if going else None
    comparison, helps = None, False
    if best is not None:
        fresh = range(HELD_OUT, HELD_OUT + study.settings.get("seeds", FINAL))
        found = _measure(study, file, [best.slug, SCRATCH], fresh, progress)
        ours, scratch = found[best.slug], found[SCRATCH]
        spent += 2 * len(fresh) * per_run
        comparison = stats.compare(ours[criterion], scratch[criterion], better="less")
        solved = ours["success"].mean() >= scratch["success"].mean() - MARGIN
        helps = comparison.verdict == "holds" and bool(solved)
    rows = [
        [study.found[slug].words if slug in study.found else "from scratch", *raced[slug]]
        for slug in sorted(raced, key=lambda slug: (-raced[slug][0], raced[slug][1]))
    ]
    lines = _sentences(best if helps else None, comparison, criterion, len(study.found), spent)
    lines += [f"left out: {study.found[slug].words} ({why})" for slug, why in broken.items()]
    chosen = best if helps else None
    return Answer(chosen, lines, rows, comparison, study.spec_of(chosen), spent)


def _measure(
    study: SimplifyStudy, file: Path, slugs: Sequence[str], seeds: Sequence[int], progress: Progress | None
) -> dict[str, dict[str, NDArray[np.float64]]]:
    """Return each candidate's measures by seed; what the store has is not computed again."""
    spec = study.spec(slugs, seeds)
    with Store.open(file, spec) as store:
        run(store, spec.cells(), study.work, workers=study.workers, progress=progress)
        found: dict[str, dict[str, list[float]]] = {slug: {} for slug in slugs}
        for cell, result in store.select():
            if cell["candidate"] in found and int(cell["seed"]) in seeds:
                for name, value in result.summary.items():
                    found[cell["candidate"]].setdefault(name, []).append(float(value))
    return {slug: {name: np.array(values) for name, values in columns.items()} for slug, columns in found.items()}


def _sentences(
    best: Candidate | None, comparison: stats.Comparison | None, criterion: str, n: int, episodes: int
) -> list[str]:
    measure = criterion.replace("-", " ")
    price = f"The search tried {n} simpler tasks and spent {episodes:,} episodes."
    if best is None:
        found = "" if comparison is None else f" The best of them, on new seeds: {measure} {comparison}."
        return [f"Nothing helps: learn the task from scratch.{found}", price]
    found = f"On new seeds, against learning from scratch: {measure} {comparison}."
    return [f"Learn this first: {best.words}. {found}", price]
