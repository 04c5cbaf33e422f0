"""Policies: a weight for every input and output of a task; choosing by weight, extending, files.

A policy is the paper's π(s, a), a utility for each state and action (Singh & Adams 2006, section III).
Extending it from a simpler task V to the task T that V came from is the paper's transfer: weights are copied
to every value put back, and prior knowledge may then change chosen rows (:func:`swap`, :func:`forget`,
:func:`invert`, :func:`scale`, :func:`set_weight`).

Shapes: ``S`` inputs, ``A`` outputs of the policy's task.
"""

from __future__ import annotations

import csv
import hashlib
import io
import json
import os
import re
import time
from collections.abc import Iterator, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, field
from itertools import groupby
from pathlib import Path
from typing import Any, Literal

import numpy as np
from numpy.typing import ArrayLike, NDArray

import tasklift
from tasklift.checks import check_fields, number, one_of, plain, whole_number
from tasklift.errors import TaskliftError
from tasklift.files import (
    canonical_json,
    parse_arrays,
    parse_json,
    read_bytes,
    read_document,
    read_text,
    write_atomically,
)
from tasklift.tasks import choice
from tasklift.tasks.prior import Prior, forget, invert, scale, set_weight, swap
from tasklift.tasks.task import Task
from tasklift.tasks.variable import Variable, plain_number
from tasklift.text import html_table, shown

__all__ = ["Policy", "Prior", "Selection", "Weights", "forget", "invert", "scale", "set_weight", "swap"]

Weights = NDArray[np.float64]
Selection = Literal["exploration", "pseudo-random", "exploitation"]

SELECTIONS: tuple[Selection, ...] = ("exploration", "pseudo-random", "exploitation")

LARGEST_JSON = 100_000
"""Policies with more weights than this keep them in an NPZ file beside the JSON file."""

AN_HOUR_S = 3600.0

LARGEST_ARRAYS = 256_000_000
"""Bytes of all arrays of a policy together: reading them takes twice as much memory."""


@dataclass(frozen=True, eq=False)
class Policy:
    """A utility for every input and output of a task.

    Parameters
    ----------
    task : Task
        The declaration, which gives the table its meaning.
    weights : float64 (S, A)
        Copied and made read-only.
    provenance : mapping
        Where the policy comes from, as JSON data: seeds, settings, the policies before it.
    kind : {"weight", "value"}
        ``"weight"``: not negative, drawn in proportion (the paper's). ``"value"``: estimates of return, any
        finite numbers, as Q-learning keeps them; they cannot be drawn in proportion.
    carried : mapping
        What the learner carries beside the weights: arrays (S, A), such as visit counts, and single numbers,
        such as the exploration rate. It is saved, and extended like the weights, so that learning can go on.

    Raises
    ------
    TaskliftError
        For a wrong shape, NaN, infinite or negative weights; says where the first one is.

    Examples
    --------
    >>> from tasklift.tasks.task import Task
    >>> walk = Task("walk", inputs=(Variable("door", (0, 1)),), outputs=(Variable("move", (0, 1)),))
    >>> policy = Policy(walk, [[1.0, 3.0], [1.0, 1.0]])
    >>> policy.probabilities({"door": 0}).tolist()
    [0.25, 0.75]
    >>> policy.select({"door": 0}, "exploitation", u=0.5)
    1
    """

    task: Task
    weights: Weights
    provenance: Mapping[str, Any] = field(default_factory=dict)
    kind: Literal["weight", "value"] = "weight"
    carried: Mapping[str, Weights | float] = field(default_factory=dict)

    def __post_init__(self) -> None:
        if self.kind not in ("weight", "value"):
            raise TaskliftError(f"policy: expected the kind 'weight' or 'value', found {self.kind!r}")
        weights = _checked(self.task, self.weights, "weights")
        if self.kind == "weight":
            if (weights < 0).any():
                row, column = (int(i) for i in np.argwhere(weights < 0)[0])
                raise TaskliftError(
                    f"policy: weights are not negative, found {weights[row, column]} {self._at(row, column)}"
                )
            with np.errstate(over="ignore"):
                heavy = ~np.isfinite(weights.sum(axis=1))
            if heavy.any():
                raise TaskliftError(f"policy: the weights of row {int(np.argmax(heavy))} are too large to be added up")
        object.__setattr__(self, "weights", weights)
        carried: dict[str, Weights | float] = {}
        for name, value in self.carried.items():
            if name in ("weights", "input"):
                raise TaskliftError(f"policy: {name!r} cannot be carried, the name is taken; choose another")
            if isinstance(value, np.ndarray) and value.ndim:
                carried[name] = _checked(self.task, value, f"carried {name!r}")
            else:
                carried[name] = plain_number(value, f"policy, carried {name!r}")
        object.__setattr__(self, "carried", carried)
        object.__setattr__(self, "provenance", dict(self.provenance))

    def _at(self, row: int, column: int) -> str:
        return f"at input {self.task.input_values(row)}, output {self.task.output_values(column)}"

    @classmethod
    def equal(cls, task: Task, weight: float = 1.5) -> Policy:
        """Return the policy that weighs everything equally: the start of direct learning."""
        task.need_room(task.shape[0] * task.shape[1], "the policy")
        return cls(task, np.full(task.shape, float(weight)), {"equal": float(weight)})

    def __repr__(self) -> str:
        learned_by = self.provenance.get("learned_by", "")
        return f"Policy({self.task!r}, {self.kind}s{f', by {shown(learned_by)}' if learned_by else ''})"

    def _repr_html_(self) -> str:
        most = 30
        inputs = [self.task.input_values(row) for row in range(min(most, self.task.shape[0]))]
        rows = [(*self.task.in_words(seen).values(), _listed(self.best_action(seen))) for seen in inputs]
        left = f"; {self.task.shape[0] - most} more states" if self.task.shape[0] > most else ""
        names = [variable.name for variable in self.task.inputs]
        return html_table(f"{self!r}: best actions{left}", (*names, "does"), rows)

    # -- choosing ------------------------------------------------------------------------------------------

    def row(self, input: int | Mapping[str, Any]) -> Weights:
        """Return the weights (A,) of an input, given by its index or as ``{name: value}``."""
        if isinstance(input, Mapping):
            return self.weights[self.task.input_index(input)]
        return self.weights[whole_number(input, "policy, input", 0, self.task.shape[0] - 1)]

    def probabilities(
        self, input: int | Mapping[str, Any], selection: Selection = "exploration", q: float = 0.9
    ) -> Weights:
        """Return how probable each output (A,) is at an input; the heaviest outputs share evenly.

        Parameters
        ----------
        input : int or mapping
            Its row, or ``{name: value}``.
        selection, q
            As in :meth:`select`.

        Raises
        ------
        TaskliftError
            For an unknown input or selection, and for values that would have to be drawn in proportion.
        """
        greedy = greedy_share(selection, q)
        row = self.row(input)
        ties = row == row.max()
        shares = greedy * ties / ties.sum()
        if greedy < 1.0:
            self._need_weights(selection)
            total = choice.total(row, len(row))
            shares = shares + (1.0 - greedy) * (row / total if total > 0 else np.full(len(row), 1 / len(row)))
        return shares

    def best(self) -> NDArray[np.int64]:
        """Return the heaviest output of each input, int64 (S,); the first one where several are equal."""
        return np.argmax(self.weights, axis=1).astype(np.int64)

    def best_action(self, input: int | Mapping[str, Any]) -> dict[str, str]:
        """Return what the policy prefers in a state (input), in words: ``{output: label}``.

        Parameters
        ----------
        input : int or mapping
            Its row, or ``{name: value}``; labels may stand for values.

        Raises
        ------
        TaskliftError
            For a state that the task does not have.

        Examples
        --------
        >>> from tasklift.tasks.task import Task
        >>> move = Variable("move", (0, 1), labels=("stop", "go"))
        >>> walk = Task("walk", inputs=(Variable("door", (0, 1), labels=("shut", "open")),), outputs=(move,))
        >>> Policy(walk, [[3.0, 1.0], [1.0, 3.0]]).best_action({"door": "open"})
        {'move': 'go'}
        """
        return self.task.in_words(self.task.output_values(int(np.argmax(self.row(input)))))

    def rows(self) -> Iterator[tuple[dict[str, Any], dict[str, Any], float, float]]:
        """Yield (input values, output values, weight, probability) of every pair, input by input.

        Probabilities are those of exploration; a policy of values has none, there it is the heaviest output's.
        """
        selection: Selection = "exploration" if self.kind == "weight" else "exploitation"
        outputs = [self.task.output_values(out) for out in range(self.task.shape[1])]
        for row in range(self.task.shape[0]):
            seen, shares = self.task.input_values(row), self.probabilities(row, selection)
            for out, does in enumerate(outputs):
                yield seen, does, float(self.weights[row, out]), float(shares[out])

    def describe(self, top: int = 3) -> Iterator[tuple[dict[str, str], list[tuple[float, dict[str, str]]]]]:
        """Yield for each state (input) its values, and its ``top`` most likely actions with probability, in words.

        Examples
        --------
        >>> from tasklift.tasks.task import Task
        >>> walk = Task("walk", inputs=(), outputs=(Variable("move", (0, 1), labels=("stop", "go")),))
        >>> list(Policy(walk, [[3.0, 1.0]]).describe(top=1))
        [({}, [(0.75, {'move': 'stop'})])]
        """
        for seen, pairs in groupby(self.rows(), key=lambda pair: pair[0]):
            likely = sorted(pairs, key=lambda pair: -pair[3])[:top]
            yield self.task.in_words(seen), [(share, self.task.in_words(does)) for _, does, _, share in likely]

    def to_csv(self) -> str:
        """Return the policy as a table: a line per input and output, with weight and probability."""
        text = io.StringIO()
        writer = csv.writer(text, lineterminator="\n")
        names = [variable.name for variable in (*self.task.inputs, *self.task.outputs)]
        writer.writerow([*names, self.kind, "probability"])
        for seen, does, weight, chance in self.rows():
            writer.writerow([*seen.values(), *does.values(), weight, chance])
        return text.getvalue()

    def select(
        self,
        input: int | Mapping[str, Any],
        selection: Selection = "exploration",
        *,
        q: float = 0.9,
        rng: np.random.Generator | None = None,
        u: float | None = None,
        coin: float = 0.0,
    ) -> int:
        """Choose an output at an input, in one of the paper's three ways (section V).

        Parameters
        ----------
        input : int or mapping
            Its row, or ``{name: value}``.
        selection
            ``"exploration"``: drawn in proportion to weight. ``"exploitation"``: the heaviest.
            ``"pseudo-random"``: the heaviest with probability ``q``, else in proportion.
        rng
            Supplies the random numbers; ties between heaviest outputs are broken with it, too.
        u, coin
            The random numbers themselves, in [0, 1), in place of ``rng``.
        """
        greedy = greedy_share(selection, q)
        if greedy < 1.0:
            self._need_weights(selection)
        if (rng is None) == (u is None):
            raise TaskliftError("policy, select: give either rng= or u=, so that the choice can be repeated")
        if rng is not None:
            coin, u = rng.random(), rng.random()
        if not (0 <= number(u, "policy, select, u") < 1 and 0 <= number(coin, "policy, select, coin") < 1):
            raise TaskliftError(f"policy, select: expected u and coin in [0, 1), found {shown(u)} and {shown(coin)}")
        return int(choice.select(self.row(input), greedy, coin, u))

    def _need_weights(self, selection: str) -> None:
        if self.kind == "value":
            raise TaskliftError(f"policy: values cannot be drawn in proportion ({selection}); use 'exploitation'")

    # -- extending -----------------------------------------------------------------------------------------

    def extend(self, task: Task, prior: Sequence[Prior] = ()) -> Policy:
        """Extend the policy to the task that its own task came from (section III of the paper).

        The weights are copied to every value put back, of inputs and of outputs, and to all values of a merged group.
        A variable that had been restricted to several of its values gives a returned value the mean over those. What
        the learner carries is extended in the same way, but for ``visits``: an output that was left out was never
        tried, and has none. Then the priors change the weights, in order.

        Parameters
        ----------
        task
            A task of this task's lineage: its parent, the root, or any in between, or the same task again.
        prior
            Operations on chosen rows: :func:`swap`, :func:`forget`, :func:`invert`, :func:`scale`, :func:`set_weight`.

        Raises
        ------
        TaskliftError
            If this policy's task is not a simplification of ``task`` (names the variable), or a prior names
            something unknown.

        Examples
        --------
        >>> from tasklift.tasks.task import Task
        >>> full = Task("full", inputs=(Variable("danger", (0, 1)),), outputs=(Variable("move", (0, 1)),))
        >>> safe = Policy(full.simplify(fix={"danger": 0}), [[1.0, 3.0]])
        >>> safe.extend(full, prior=[swap("move", when={"danger": 1})]).weights.tolist()
        [[1.0, 3.0], [3.0, 1.0]]
        """
        ancestor = self.task.ancestor(task)
        task.need_room(task.shape[0] * task.shape[1], "the extended policy")
        weights = _put_back(self.weights, self.task, ancestor)
        for operation in prior:
            weights = operation.apply(task, weights)
        provenance = {
            "extended_from": self.task.name,
            "before": dict(self.provenance),
            "prior": [operation.to_json() for operation in prior],
        }
        carried = {
            name: _put_back(value, self.task, ancestor) if isinstance(value, np.ndarray) else value
            for name, value in self.carried.items()
        }
        if "visits" in carried:
            carried["visits"] = np.where(_tried(self.task, ancestor), carried["visits"], 0.0)
        return Policy(task, weights, provenance, self.kind, carried)

    # -- files ---------------------------------------------------------------------------------------------

    def save(self, path: str | os.PathLike[str]) -> None:
        """Write the policy as JSON that a person can read, one input per line.

        More than :data:`LARGEST_JSON` weights go into an NPZ file beside it; keep them together. That file is
        written first and named by its content, so that whoever reads ``path`` at any moment, or after a crash,
        finds the old pair or the new one.

        Raises
        ------
        TaskliftError
            If it cannot be written, or not be read again: the provenance is not JSON data, the arrays are too large.
        """
        target = Path(path)
        document: dict[str, Any] = {
            "format": "tasklift-policy",
            "version": 1,
            "written_by": f"tasklift {tasklift.__version__}",
            "kind": self.kind,
            "task": self.task.to_json(),
            "provenance": dict(self.provenance),
        }
        arrays: dict[str, Any] = {"weights": self.weights}
        arrays |= {n: v for n, v in self.carried.items() if isinstance(v, np.ndarray)}
        document["numbers"] = {n: v for n, v in self.carried.items() if not isinstance(v, np.ndarray)}
        try:
            plain(json.loads(canonical_json(document)), str(target))
        except (TypeError, ValueError, RecursionError) as error:
            raise TaskliftError(f"{target}: the provenance is not JSON data ({error})") from error
        before: set[str] = set()
        if self.weights.size > LARGEST_JSON:
            if target.suffix == ".npz":
                raise TaskliftError(f"{target}: the suffix .npz is taken by the weights; save to a .json file")
            before = _weights_files(target)
            document["arrays"] = _write_arrays(target, arrays)
        else:
            document["outputs"] = [self.task.output_values(a) for a in range(self.task.shape[1])]
            document["rows"] = [
                {"input": self.task.input_values(s)} | {name: array[s].tolist() for name, array in arrays.items()}
                for s in range(self.task.shape[0])
            ]
        document["checksum"] = _checksum(document)
        write_atomically(target, _readable(document))
        if before:
            _remove_unused(target.parent, before)

    @classmethod
    def load(cls, path: str | os.PathLike[str], task: Task | None = None) -> Policy:
        """Read a policy file; with ``task``, check that it fits, and say which variable does not.

        A file that was damaged, cut short or changed is refused. Somebody who edits a policy by hand, and
        means it, takes the field ``checksum`` out.
        """
        document = read_document(path, "tasklift-policy", 1)
        where = str(path)
        shape: dict[str, Any] = {"format": str, "version": int, "written_by": str, "kind": str, "task": dict}
        shape |= {"provenance": dict, "numbers": dict, "checksum?": str}
        shape |= {"arrays": dict} if "arrays" in document else {"outputs": list, "rows": list}
        check_fields(document, where, shape)
        if "checksum" in document and document["checksum"] != _checksum(document):
            raise TaskliftError(
                f"{where}: the content does not match its checksum: damaged, or edited? "
                "If you edited it on purpose, take the field 'checksum' out"
            )
        try:
            found = Task.from_json(document["task"], f"{where}, task")
            if task is not None and (reason := found.difference(task)) is not None:
                raise TaskliftError(f"it is the policy of another task: {reason}")
            if "arrays" in document:
                arrays = _read_arrays(Path(path), document["arrays"], found)
            else:
                arrays = _read_rows(found, document)
            weights = arrays.pop("weights")
            carried = arrays | document["numbers"]
            return cls(task or found, weights, document["provenance"], document["kind"], carried)
        except TaskliftError as error:
            raise TaskliftError(str(error) if where in str(error) else f"{where}: {error}") from error


def greedy_share(selection: str, q: float) -> float:
    """Return the probability with which a way of selection takes the heaviest output: the paper's q."""
    one_of(selection, SELECTIONS, "selection")
    q = number(q, "selection, q (a probability)", 0.0, 1.0)
    return {"exploration": 0.0, "exploitation": 1.0}.get(selection, q)


def _checked(task: Task, given: ArrayLike, what: str) -> Weights:
    """Return a read-only float64 (S, A) copy, or say what is wrong with it."""
    try:
        if np.iscomplexobj(given):
            raise TypeError("complex numbers")
        array = np.array(given, dtype=np.float64, order="C")
    except (TypeError, ValueError, OverflowError) as error:
        raise TaskliftError(f"policy: the {what} are not a table of numbers ({error})") from error
    if array.shape != task.shape:
        raise TaskliftError(
            f"policy: expected {what} of shape {task.shape} (inputs × outputs of {task.name!r}), found {array.shape}"
        )
    if not np.isfinite(array).all():
        row, column = (int(i) for i in np.argwhere(~np.isfinite(array))[0])
        raise TaskliftError(
            f"policy: expected finite {what}, found {array[row, column]} at input {task.input_values(row)}, "
            f"output {task.output_values(column)}"
        )
    array.setflags(write=False)
    return array


def _put_back(table: Weights, task: Task, ancestor: Task) -> Weights:
    """Extend a table of ``task`` to an ancestor: copies, or means over the values that a restriction kept."""
    taller = spread(table, task.inputs, ancestor.inputs, task.value_positions(ancestor), axis=0)
    return spread(taller, task.outputs, ancestor.outputs, task.value_positions(ancestor), axis=1)


def _tried(task: Task, ancestor: Task) -> NDArray[np.bool_]:
    """Return which outputs of an ancestor a learner of ``task`` could try, bool (A of the ancestor,)."""
    tried = np.zeros(ancestor.shape[1], dtype=np.bool_)
    tried[task.output_columns(ancestor)] = True
    return tried


def spread(
    table: Weights,
    ours: Sequence[Variable],
    theirs: Sequence[Variable],
    places: Mapping[str, NDArray[np.int64] | None],
    axis: int,
) -> Weights:
    """Extend one axis of a table (n, A) or (S, n) from the variables it has to those of an ancestor.

    ``places`` says where the values are (:meth:`.Task.value_positions`).
    """
    before, after = table.shape[:axis], table.shape[axis + 1 :]
    cube = table.reshape([*before, *(len(v) for v in ours), *after])
    names = {v.name for v in ours}
    for k, variable in enumerate(theirs, start=axis):
        if variable.name not in names:
            cube = np.repeat(np.expand_dims(cube, k), len(variable), axis=k)
            continue
        local = places[variable.name]
        assert local is not None
        if (local < 0).any() or cube.shape[k] < len(variable):
            wider = np.take(cube, local, axis=k)
            wider[(slice(None),) * k + (local < 0,)] = cube.mean(axis=k, keepdims=True)
            cube = wider
    return np.ascontiguousarray(cube.reshape(*before, -1, *after))


# -- files -------------------------------------------------------------------------------------------------


def _checksum(document: Mapping[str, Any]) -> str:
    content = {name: value for name, value in document.items() if name != "checksum"}
    return hashlib.sha256(canonical_json(content).encode()).hexdigest()


def _spelled(value: Any) -> str:
    return json.dumps(value, allow_nan=False, ensure_ascii=False)


def _readable(document: Mapping[str, Any]) -> str:
    """Spell a document with one field per line, and one line per row or output."""
    lines = []
    for name, value in document.items():
        if name in ("rows", "outputs") and value:
            body = ",\n    ".join(_spelled(item) for item in value)
            lines.append(f'  "{name}": [\n    {body}\n  ]')
        else:
            lines.append(f'  "{name}": {_spelled(value)}')
    return "{\n" + ",\n".join(lines) + "\n}\n"


def _read_rows(task: Task, document: Mapping[str, Any]) -> dict[str, Weights]:
    outputs, rows = document["outputs"], document["rows"]
    # the numbers first: a few variables declare more outputs than there is time to spell
    if (len(rows), len(outputs)) != task.shape or outputs != [task.output_values(a) for a in range(task.shape[1])]:
        raise TaskliftError(
            f"expected {task.shape[0]} rows and the task's {task.shape[1]} outputs, "
            f"found {len(rows)} and {len(outputs)}"
        )
    names = [name for name in rows[0] if name != "input"] if isinstance(rows[0], dict) else []
    if "weights" not in names:
        raise TaskliftError("row 0 has no weights")
    for s, row in enumerate(rows):
        check_fields(row, f"row {s}", {"input": dict} | dict.fromkeys(names, list))
        if row["input"] != task.input_values(s):
            raise TaskliftError(f"row {s}: expected the input {task.input_values(s)}, found {row['input']}")
        for name in names:
            numbers = all(isinstance(v, int | float) and not isinstance(v, bool) for v in row[name])
            if len(row[name]) != task.shape[1] or not numbers:
                raise TaskliftError(f"row {s}: expected {task.shape[1]} numbers as {name}")
    try:
        return {name: np.array([row[name] for row in rows], dtype=np.float64) for name in names}
    except OverflowError as error:
        raise TaskliftError("a weight is too large to be a number") from error


def _write_arrays(target: Path, arrays: Mapping[str, Weights]) -> dict[str, str]:
    """Write the weights beside a policy file, by the name of their content, and return what names them there."""
    if (size := sum(array.nbytes for array in arrays.values())) > LARGEST_ARRAYS:
        raise TaskliftError(f"{target}: {size:,} bytes of weights; at most {LARGEST_ARRAYS:,} are saved and read")
    buffer = io.BytesIO()
    np.savez_compressed(buffer, **arrays)  # type: ignore[arg-type]
    content = hashlib.sha256(buffer.getvalue()).hexdigest()
    name = f"{target.stem}-{content[:16]}.npz"
    write_atomically(target.with_name(name), buffer.getvalue())
    return {"file": name, "sha256": content}


def _weights_files(path: Path) -> set[str]:
    """Return the names of weights files that a policy file will not need once it is replaced.

    The one that it names, and those that killed writers left; a young one may be a living writer's.
    """
    pattern = re.compile(rf"{re.escape(path.stem)}-[0-9a-f]{{16}}\.npz")
    found = set()
    with suppress(OSError):
        found = {
            file.name
            for file in path.parent.iterdir()
            if pattern.fullmatch(file.name) and time.time() - file.stat().st_mtime > AN_HOUR_S
        }
    with suppress(TaskliftError, KeyError, TypeError):
        name = parse_json(read_text(path), str(path))["arrays"]["file"]
        if pattern.fullmatch(name):
            found.add(name)
    return found


def _remove_unused(folder: Path, names: set[str]) -> None:
    """Remove weights files, but for those that a policy in the folder names: the new one, or a copy of the old."""
    with suppress(OSError, TaskliftError):
        used = [read_bytes(file) for file in folder.glob("*.json")]
        for name in names:
            if not any(name.encode() in content for content in used):
                (folder / name).unlink()


def _read_arrays(path: Path, beside: Mapping[str, Any], task: Task) -> dict[str, Weights]:
    check_fields(beside, f"{path}, arrays", {"file": str, "sha256": str})
    name = beside["file"]
    if Path(name).name != name or not name.endswith(".npz"):
        raise TaskliftError(f"expected the name of an .npz file in the same folder, found {shown(name)}")
    file = path.with_name(name)
    try:
        raw = read_bytes(file, LARGEST_ARRAYS)
    except TaskliftError as error:
        raise TaskliftError(f"its weights are in another file; {error}") from error
    if hashlib.sha256(raw).hexdigest() != beside["sha256"]:
        raise TaskliftError(f"its weights in {file} are not the ones saved with it: damaged, or of another policy")
    found = parse_arrays(raw, str(file), task.shape, LARGEST_ARRAYS)
    if "weights" not in found:
        raise TaskliftError(f"{file}: has no weights")
    return found


def _listed(values: Mapping[str, str]) -> str:
    return ", ".join(f"{name} {label}" for name, label in values.items())
