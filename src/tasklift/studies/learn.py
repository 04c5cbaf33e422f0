"""A spec file as an experiment: its curriculum and direct learning, seed by seed, stored, resumed and judged."""

from __future__ import annotations

import dataclasses
import os
import threading
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from tasklift.building import Mission
from tasklift.checks import whole_number
from tasklift.errors import TaskliftError, about
from tasklift.files import canonical_json, results_folder, write_atomically
from tasklift.lab import FILE_NAME, Cell, CellResult, Progress, Spec, Store, run
from tasklift.learning.compare import Comparison, judged, learn_directly
from tasklift.learning.curriculum import Curriculum, Records
from tasklift.learning.guard import GuardReport
from tasklift.learning.ledger import Entry, Ledger
from tasklift.learning.model import Model
from tasklift.learning.worlds import Outcomes, StepOutcomes
from tasklift.studies.own_code import OwnCode
from tasklift.studies.spec_file import code_beside, curriculum_of, read_spec
from tasklift.studies.study import MOST_SEEDS
from tasklift.tasks.policy import Policy

CURRICULUM, DIRECT = "curriculum", "direct"
#: What a spec says about judging and about how many seeds there are: it changes no row.
_NO_ROWS = ("name", "seeds", "performance", "first", "last", "threshold")
_JUDGING = ("performance", "first", "last", "threshold")

_latest = threading.local()  # the curriculum of this thread, whose worlds have a state, and its latest run


def run_spec(
    path: str | os.PathLike[str],
    out: str | os.PathLike[str] | None = None,
    seeds: int | None = None,
    *,
    allow_imports: bool = False,
    progress: Progress | None = None,
) -> Comparison:
    """Run a spec file: the curriculum against direct learning, over seeds.

    Parameters
    ----------
    path
        The spec.
    out
        A folder for the experiment, ``comparison.json``, ``comparison.txt`` and ``policy.json`` (the first seed's).
        It may be missing, empty, or hold the same experiment: what is there already is not computed again.
    seeds
        In place of the spec's.
    allow_imports
        As in :func:`.curriculum_of`.
    progress
        As in :func:`tasklift.lab.run`.

    Raises
    ------
    TaskliftError
        For whatever is wrong with the spec or the folder, before anything is trained; and for what a module beside
        the spec raises in training, with its file and line.
    """
    document = read_spec(path)
    with about(path):
        chosen = whole_number(document.get("seeds", 20) if seeds is None else seeds, "seeds", 2, MOST_SEEDS)
        study = SpecStudy(document, Path(path).parent, chosen, allow_imports)
        with results_folder(out, (FILE_NAME,)) as folder, Store.open(folder / FILE_NAME, study.spec()) as store:
            run(store, study.cells(), study.work, workers=study.workers, progress=progress)
            comparison = study.comparison(store)
            if out is not None:
                told = {"format": "tasklift-comparison", "version": 1, "spec": store.spec.id, "name": document["name"]}
                comparison.policy.save(folder / "policy.json")
                write_atomically(folder / "comparison.txt", f"{comparison}\n")
                write_atomically(folder / "comparison.json", canonical_json(told | comparison.to_json()) + "\n")
    return comparison


@dataclass(frozen=True, eq=False)
class SpecStudy:
    """A spec as cells: seeds × (curriculum, direct learning).

    Parameters
    ----------
    document
        As :func:`.read_spec` returns it.
    folder
        Where the spec lies.
    seeds
        How many.
    allow_imports
        As in :func:`.curriculum_of`.

    Raises
    ------
    TaskliftError
        If the spec describes no curriculum that could be compared.
    """

    document: Mapping[str, Any]
    folder: Path
    seeds: int
    allow_imports: bool = False

    def __post_init__(self) -> None:
        if self.curriculum.stages[-1].own_budget:
            raise TaskliftError("the last stage is a sweep, with a budget of its own; give it trials or steps")

    @property
    def curriculum(self) -> Curriculum:
        """The curriculum, with worlds that belong to this thread."""
        if getattr(_latest, "study", None) is not self:
            _latest.study, _latest.seed, _latest.run = self, None, None
            _latest.curriculum = curriculum_of(self.document, self.folder, allow_imports=self.allow_imports)
        found: Curriculum = _latest.curriculum
        return found

    @property
    def workers(self) -> int | None:
        """One per core for worlds that are compiled; one for worlds in Python, which threads would not make faster."""
        compiled = all(isinstance(stage.world, Mission | Model) for stage in self.curriculum.stages)
        return None if compiled else 1

    def spec(self) -> Spec:
        """Return all that decides the rows, as data: the spec's text, the buildings and modules that it names."""
        settings = {name: value for name, value in self.document.items() if name not in _NO_ROWS}
        worlds = [stage.world for stage in self.curriculum.stages]
        settings["buildings"] = [world.building.content_id for world in worlds if isinstance(world, Mission)]
        settings["modules"] = code_beside(self.document, self.folder)
        axes: dict[str, Any] = {"seed": range(self.seeds), "arm": [CURRICULUM, DIRECT]}
        return Spec.of(str(self.document["name"]), settings, axes, over=["seed"])

    def cells(self) -> list[Cell]:
        """Return the units of work; the two of a seed are side by side."""
        return self.spec().cells()

    def work(self, cell: Cell) -> CellResult:
        """Run the curriculum with one seed, or learn its last task from scratch with the same total budget."""
        with OwnCode(self.folder).running("training"):
            seed, curriculum = int(cell["seed"]), self.curriculum
            if _latest.seed != seed:
                _latest.run, _latest.seed = curriculum.run(seed), seed
            found = _latest.run
            if cell["arm"] == DIRECT:
                outcomes = learn_directly(curriculum, found, seed)
                rows = {curriculum.stages[-1].name: _columns(outcomes)}
                return CellResult(rows, _summary(outcomes, outcomes.losses.sum()))
        attachments: dict[str, Any] = {
            "ledger": [dataclasses.asdict(entry) for entry in found.ledger.entries],
            "guards": {stage: dataclasses.asdict(report) for stage, report in found.guards.items()},
            "stopped": found.stopped,
        }
        if seed == 0:
            attachments["policy"] = {
                "kind": found.policy.kind,
                "provenance": dict(found.policy.provenance),
                "numbers": {n: v for n, v in found.policy.carried.items() if not isinstance(v, np.ndarray)},
            }
            attachments["weights"] = found.policy.weights
            tables = {n: v for n, v in found.policy.carried.items() if isinstance(v, np.ndarray)}
            attachments |= {f"carried {name}": table for name, table in tables.items()}
        rows = {name: _columns(outcomes) for name, outcomes in found.outcomes.items() if len(outcomes)}
        last = found.outcomes[next(reversed(rows))]
        return CellResult(rows, _summary(last, found.ledger.total), attachments)

    def comparison(self, store: Store) -> Comparison:
        """Judge the rows that are there."""
        results = {cell: result for cell, result in store.select(attachments=True) if int(cell["seed"]) < self.seeds}
        runs = [self._records(result) for cell, result in results.items() if cell["arm"] == CURRICULUM]
        direct = [self._records(result).outcomes for cell, result in results.items() if cell["arm"] == DIRECT]
        last, first = self.curriculum.stages[-1], next(iter(results.values())).attachments
        carried = {name.removeprefix("carried "): table for name, table in first.items() if name.startswith("carried ")}
        told = first["policy"]
        stage = next(s for s in self.curriculum.stages if s.name == told["provenance"]["stage"])
        policy = Policy(stage.task, first["weights"], told["provenance"], told["kind"], carried | told["numbers"])
        options = {name: self.document[name] for name in _JUDGING if name in self.document}
        return judged(last, runs, [outcomes[last.name] for outcomes in direct], policy, **options)

    def _records(self, result: CellResult) -> Records:
        attached = result.attachments
        outcomes: dict[str, Outcomes] = {}
        for stage in self.curriculum.stages:
            for name in (stage.name, f"{stage.name} (control)"):
                if name in result.stages:
                    columns: Mapping[str, Any] = result.stages[name]
                    kind = StepOutcomes if "returns" in columns else Outcomes
                    limit = getattr(stage.world, "limit", int(columns["steps"].max()))
                    outcomes[name] = kind(**columns, limit=limit)
        return Records(
            outcomes,
            Ledger(tuple(Entry(**entry) for entry in attached.get("ledger", ()))),
            {
                stage: GuardReport(**report | {"evidence": tuple(report["evidence"])})
                for stage, report in attached.get("guards", {}).items()
            },
            attached.get("stopped"),
        )


def _columns(outcomes: Outcomes) -> dict[str, Any]:
    names = ("steps", "success", "losses", *(["returns"] if isinstance(outcomes, StepOutcomes) else ()))
    return {name: getattr(outcomes, name) for name in names}


def _summary(last: Outcomes, losses: int) -> dict[str, Any]:
    return {"losses": int(losses), "steps": float(last.steps.mean()), "success": float(last.success.mean())}
