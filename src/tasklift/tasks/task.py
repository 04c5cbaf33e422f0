"""Tasks: variables, reinforcement signals over them, and simpler versions of a task.

A task is a table of inputs × outputs (Singh & Adams 2006, section III; Tables I to III), declared by its
variables. A simpler task V drops or fixes some of them; it remembers the task it came from, so that a policy
learned on V can be extended to T (:meth:`tasklift.tasks.policy.Policy.extend`). Nothing here enumerates inputs or
outputs until asked to, so a task whose table would not fit in memory can be declared all the same.

Shapes: ``S`` inputs, ``A`` outputs.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray

from tasklift.checks import check_fields, check_name, whole_number
from tasklift.errors import TaskliftError
from tasklift.files import canonical_json
from tasklift.tasks.variable import Condition, Signal, Value, Variable, condition_json, plain_number
from tasklift.text import html_table, shown

__all__ = ["LARGEST_TABLE", "Condition", "Signal", "Task", "Value", "Variable"]

_Kept = Mapping[str, tuple[int, ...]]
_Groups = Mapping[str, tuple[tuple[int, ...], ...]]

LARGEST_TABLE = 2**28
"""The most entries that a table on request may have (2 GiB of float64)."""


@dataclass(frozen=True, eq=False)
class Task:
    """A task: inputs × outputs, its reinforcement signals, and what is not possible in a state.

    The first-named variable is the slowest in the index (C order). Tasks compare and hash by content.

    Parameters
    ----------
    name : str
        For reports and files.
    inputs, outputs : sequence of Variable
        The variables. Names are unique over both. Without inputs the task has one row.
    signals : sequence of Signal
        Local signals, each with the condition at which it holds.
    impossible : sequence of mapping
        Conditions under which an output is not possible (Table III, "inapplicable action").
    impossible_signal : float
        What is added there (the paper's strongly negative signal, −0.5).
    time_reward : float
        Size of the global signal for the time taken (the paper's +0.2 for V, +0.1 for T).
    parent, fixed, removed, merged
        For a simplified task, filled in by :meth:`simplify`: the task it came from, the variables that were
        fixed, with their value, the inputs that were removed, and the groups of values of inputs that were merged.

    Raises
    ------
    TaskliftError
        On unknown or doubled names and values, and on conditions that nothing can meet.

    Examples
    --------
    >>> door = Task(
    ...     "door",
    ...     inputs=(Variable("danger", (0, 1)), Variable("armed", (False, True))),
    ...     outputs=(Variable("move", (0, 1), labels=("stop", "go")),),
    ...     signals=(Signal(-1.0, {"danger": 1, "armed": False, "move": "go"}, "walked into it"),),
    ... )
    >>> door.shape
    (4, 2)
    >>> door.signal_table().tolist()
    [[0.0, 0.0], [0.0, 0.0], [0.0, -1.0], [0.0, 0.0]]
    >>> door.simplify(fix={"danger": 0}).shape
    (2, 2)
    """

    name: str
    inputs: tuple[Variable, ...]
    outputs: tuple[Variable, ...]
    signals: tuple[Signal, ...] = ()
    impossible: tuple[Condition, ...] = ()
    impossible_signal: float = -0.5
    time_reward: float = 0.0
    parent: Task | None = None
    fixed: Mapping[str, Value] = field(default_factory=dict)
    removed: tuple[str, ...] = ()
    merged: Mapping[str, tuple[tuple[Value, ...], ...]] = field(default_factory=dict)

    def __post_init__(self) -> None:
        where = f"task {check_name(self.name, 'task')!r}"
        for side in ("inputs", "outputs"):
            variables = tuple(getattr(self, side))
            object.__setattr__(self, side, variables)
            if not all(isinstance(v, Variable) for v in variables):
                raise TaskliftError(f"{where}: expected Variable(...) in {side}, found {variables!r}")
        if not self.outputs:
            raise TaskliftError(f"{where}: has no output left to choose; keep at least one output variable")
        names = [v.name for v in self.variables]
        if len(set(names)) < len(names):
            double = next(n for n in names if names.count(n) > 1)
            raise TaskliftError(f"{where}: two variables are called {double!r}; names must differ")
        signals = tuple(
            replace(s, when=self._tidy(s.when, f"{where}, signal {s.name or i}")) for i, s in enumerate(self.signals)
        )
        impossible = tuple(self._tidy(c, f"{where}, impossible {i}") for i, c in enumerate(self.impossible))
        object.__setattr__(self, "signals", signals)
        object.__setattr__(self, "impossible", impossible)
        for number in ("impossible_signal", "time_reward"):
            object.__setattr__(self, number, plain_number(getattr(self, number), f"{where}, {number}"))
        object.__setattr__(self, "fixed", dict(self.fixed))
        object.__setattr__(self, "removed", tuple(self.removed))
        groups = {name: tuple(tuple(group) for group in merged) for name, merged in self.merged.items()}
        object.__setattr__(self, "merged", groups)
        self._check_parent(where)

    def _check_parent(self, where: str) -> None:
        if self.parent is None:
            if self.fixed or self.removed or self.merged:
                raise TaskliftError(
                    f"{where}: expected a parent task, since variables are fixed, removed or merged, found none"
                )
            return
        ours = {v.name: v for v in self.variables}
        for variable in self.parent.variables:
            if sum(variable.name in part for part in (ours, self.fixed, self.removed)) != 1:
                raise TaskliftError(
                    f"{where}: variable {variable.name!r} of {self.parent.name!r} must be kept, fixed "
                    "or removed, exactly one of them"
                )
            if variable.name in ours:
                kept = variable.positions(ours[variable.name].values, where)
                if tuple(variable.values[i] for i in kept) != ours[variable.name].values:
                    raise TaskliftError(f"{where}: variable {variable.name!r} must keep the order of its values")
            elif variable.name in self.fixed:
                variable.position(self.fixed[variable.name], where)
        known = {v.name for v in self.parent.variables}
        strange = [n for n in (*ours, *self.fixed, *self.removed) if n not in known]
        if strange or any(v.name in self.removed for v in self.parent.outputs):
            raise TaskliftError(f"{where}: {strange or self.removed!r} cannot be taken from {self.parent.name!r}")
        for side in ("inputs", "outputs"):
            order = [v.name for v in getattr(self.parent, side) if v.name in ours]
            if order != [v.name for v in getattr(self, side)]:
                raise TaskliftError(f"{where}: the {side} must keep the order they have in {self.parent.name!r}")
        for name, groups in self.merged.items():
            variable = self.parent.variable(name, where)
            positions = [variable.position(value, where) for group in groups for value in group]
            if name not in {v.name for v in self.inputs} or len(set(positions)) < len(positions) or () in groups:
                raise TaskliftError(f"{where}: expected groups of different values of the input {name!r} in merged")
            if set(ours[name].values) & {value for group in groups for value in group[1:]}:
                raise TaskliftError(f"{where}: of values of {name!r} that are merged, only the first one is kept")

    def __repr__(self) -> str:
        sizes = f"{len(self.inputs)} inputs and {len(self.outputs)} outputs, {' × '.join(map(str, self.shape))}"
        return f"Task({shown(self.name)}: {sizes if sum(self.shape) < 10**30 else 'too large for a table'})"

    def _repr_html_(self) -> str:
        rows = [
            (side, v.name, v.meaning, ", ".join(map(v.label, v.values[:20])) + (", …" if len(v) > 20 else ""))
            for side, variables in (("input", self.inputs), ("output", self.outputs))
            for v in variables
        ]
        return html_table(repr(self), ("", "variable", "meaning", "values"), rows)

    # -- the table -----------------------------------------------------------------------------------------

    @property
    def variables(self) -> tuple[Variable, ...]:
        """Inputs, then outputs."""
        return self.inputs + self.outputs

    @cached_property
    def shape(self) -> tuple[int, int]:
        """``(S, A)``: how many inputs and outputs there are (exact, however large)."""
        return math.prod(map(len, self.inputs)), math.prod(map(len, self.outputs))

    def variable(self, name: str, where: str = "") -> Variable:
        """Return the variable called ``name``; an unknown name is refused with the names there are."""
        for variable in self.variables:
            if variable.name == name:
                return variable
        names = ", ".join(v.name for v in self.variables)
        raise TaskliftError(f"{where or f'task {self.name!r}'}: no variable {name!r}; there are {names}")

    def input_index(self, values: Mapping[str, Any]) -> int:
        """Return the row of an input given as ``{name: value}``, every variable named."""
        return self._index(values, self.inputs, "input")

    def output_index(self, values: Mapping[str, Any]) -> int:
        """Return the column of an output given as ``{name: value}``, every variable named."""
        return self._index(values, self.outputs, "output")

    def input_values(self, index: int) -> dict[str, Value]:
        """Return the input at row ``index`` as ``{name: value}``."""
        return self._values(index, self.inputs, self.shape[0], "input")

    def output_values(self, index: int) -> dict[str, Value]:
        """Return the output at column ``index`` as ``{name: value}``."""
        return self._values(index, self.outputs, self.shape[1], "output")

    def in_words(self, values: Mapping[str, Any]) -> dict[str, str]:
        """Return ``{name: label}`` of ``{name: value}``; a value without a label is shown as it is.

        Examples
        --------
        >>> task = Task("walk", inputs=(), outputs=(Variable("move", (0, 1), labels=("stop", "go")),))
        >>> task.in_words({"move": 1})
        {'move': 'go'}
        """
        return {name: self.variable(name).label(value) for name, value in values.items()}

    def _index(self, values: Mapping[str, Any], variables: tuple[Variable, ...], what: str) -> int:
        if not isinstance(values, Mapping) or len(values) != len(variables):
            names = ", ".join(v.name for v in variables)
            raise TaskliftError(f"task {self.name!r}: expected an {what} as {{{names}}}, found {values!r}")
        index = 0
        for variable in variables:
            if variable.name not in values:
                raise TaskliftError(f"task {self.name!r}: the {what} {values!r} has no {variable.name!r}")
            index = index * len(variable) + variable.position(values[variable.name], f"task {self.name!r}")
        return index

    def _values(self, index: int, variables: tuple[Variable, ...], n: int, what: str) -> dict[str, Value]:
        rest = whole_number(index, f"task {self.name!r}, number of an {what}", 0, n - 1)
        found: dict[str, Value] = {}
        for variable in reversed(variables):
            rest, position = divmod(rest, len(variable))
            found[variable.name] = variable.values[position]
        return dict(reversed(found.items()))

    def _tidy(self, when: Condition, where: str) -> dict[str, tuple[Value, ...]]:
        """Return a condition with known names, in table order, each with a tuple of known values."""
        if not isinstance(when, Mapping):
            raise TaskliftError(f"{where}: expected conditions {{variable: value or values}}, found {when!r}")
        tidy: dict[str, tuple[Value, ...]] = {}
        for name in when:
            self.variable(name, where)
        for variable in self.variables:
            if variable.name in when:
                positions = variable.positions(when[variable.name], where)
                tidy[variable.name] = tuple(variable.values[i] for i in positions)
        return tidy

    def need_room(self, entries: int, what: str) -> None:
        """Refuse to build a table of this task with more than :data:`LARGEST_TABLE` entries."""
        if entries > LARGEST_TABLE:
            raise TaskliftError(
                f"task {self.name!r}: {what} would have {entries:,} entries, more than the "
                f"{LARGEST_TABLE:,} that are built in memory; simplify it, or learn it with tasklift.learning.approx"
            )

    def input_positions(self, indices: Iterable[int]) -> NDArray[np.int64]:
        """Return the positions of the values of some inputs, int64 (n, variables)."""
        found = []
        for index in indices:
            values = self.input_values(index)
            found.append([variable.position(values[variable.name]) for variable in self.inputs])
        return np.array(found, dtype=np.int64).reshape(len(found), len(self.inputs))

    def where(self, when: Condition, inputs: NDArray[np.int64] | None = None) -> NDArray[np.bool_]:
        """Return the mask, bool (S, A), of the inputs and outputs at which a condition holds.

        With ``inputs``, int64 (n, variables), the positions of some inputs' values: for those only, bool (n, A).
        """
        if inputs is None:
            self.need_room(self.shape[0] * self.shape[1], "the table")
            return np.outer(*self._sides(when))
        tidy = self._tidy(when, f"task {self.name!r}, where")
        rows = np.ones(len(inputs), dtype=np.bool_)
        for k, variable in enumerate(self.inputs):
            rows &= _allowed(variable, tidy)[inputs[:, k]]
        return np.outer(rows, _mask(self.outputs, tidy))

    def input_mask(self, when: Condition) -> NDArray[np.bool_]:
        """Return the mask, bool (S,), of the inputs at which a condition over inputs holds."""
        outputs = [v.name for v in self.outputs if v.name in when]
        if outputs:
            raise TaskliftError(f"task {self.name!r}: expected a condition over inputs, found output {outputs[0]!r}")
        return self._sides(when)[0]

    def _sides(self, when: Condition) -> tuple[NDArray[np.bool_], NDArray[np.bool_]]:
        """Return where a condition holds among the inputs, bool (S,), and among the outputs, bool (A,)."""
        tidy = self._tidy(when, f"task {self.name!r}, where")
        self.need_room(max(self.shape), "the mask")
        return _mask(self.inputs, tidy), _mask(self.outputs, tidy)

    def impossible_table(self) -> NDArray[np.bool_]:
        """Return where an output is not possible, bool (S, A)."""
        self.need_room(self.shape[0] * self.shape[1], "the table")
        table = np.zeros(self.shape, dtype=np.bool_)
        for condition in self.impossible:
            rows, columns = self._sides(condition)
            table[np.ix_(rows, columns)] = True
        return table

    def signal_table(self, impossible: bool = True) -> NDArray[np.float64]:
        """Return the local signals, float64 (S, A): the sum of those that hold at each input and output.

        Parameters
        ----------
        impossible : bool
            Whether ``impossible_signal`` is added where an output is not possible. A sweep leaves it out: there the
            output was not the learner's choice.

        Raises
        ------
        TaskliftError
            If the table would have more than :data:`LARGEST_TABLE` entries.
        """
        self.need_room(self.shape[0] * self.shape[1], "the table of signals")
        table = np.zeros(self.shape)
        for signal in self.signals:
            rows, columns = self._sides(signal.when)
            table[np.ix_(rows, columns)] += signal.value
        return table + np.where(self.impossible_table(), self.impossible_signal, 0.0) if impossible else table

    # -- simpler versions ----------------------------------------------------------------------------------

    def simplify(
        self,
        fix: Mapping[str, Any] | None = None,
        remove: Sequence[str] = (),
        restrict: Mapping[str, Sequence[Any]] | None = None,
        merge: Mapping[str, Sequence[Sequence[Any]]] | None = None,
        name: str | None = None,
        signals: Sequence[Signal] | None = None,
        impossible: Sequence[Condition] | None = None,
        time_reward: float | None = None,
    ) -> Task:
        """Return a simpler version of this task, which remembers where it came from.

        Parameters
        ----------
        fix
            ``{variable: value}``: the variable leaves the table. Of a fixed input only that slice belongs to
            the simpler task; a fixed output always has that value.
        remove
            Inputs that leave the table; all their values lead to the same row.
        restrict
            ``{variable: values}``: the variable keeps only these values.
        merge
            ``{input: groups of values}``: the values of a group lead to the same row, named by the first of them.
        name
            Default: this task's name with a prime.
        signals, impossible
            The simpler task's own. Default: this task's, with the conditions on dropped variables
            resolved; one that depends on a removed input, or differs within a merged group, is refused.
        time_reward
            Default: this task's.

        Raises
        ------
        TaskliftError
            For an unknown or doubled name, an output in ``remove`` or ``merge``, and a signal that depends on a removed
            input or tells merged values apart.

        Examples
        --------
        >>> walk = Task("walk", inputs=(Variable("place", range(6)),), outputs=(Variable("move", (0, 1)),))
        >>> coarse = walk.simplify(merge={"place": [[0, 1, 2], [4, 5]]})
        >>> coarse.inputs[0].values, coarse.input_map.tolist()
        ((0, 3, 4), [0, 0, 0, 1, 2, 2])
        """
        where = f"task {self.name!r}, simplify"
        fix, restrict, merge = dict(fix or {}), dict(restrict or {}), dict(merge or {})
        if isinstance(remove, str):
            raise TaskliftError(f"{where}: expected a list of names in remove, found the text {remove!r}")
        for variable_name in (*fix, *remove, *restrict, *merge):
            self.variable(variable_name, where)
            if (
                sum(variable_name in part for part in (fix, remove, restrict, merge)) > 1
                or list(remove).count(variable_name) > 1
            ):
                raise TaskliftError(f"{where}: {variable_name!r} is named twice; fix, remove, restrict or merge it")
        for output in self.outputs:
            if output.name in remove or output.name in merge:
                raise TaskliftError(f"{where}: {output.name!r} is an output; outputs are fixed or restricted")
        kept: dict[str, tuple[int, ...]] = {}
        for variable in self.variables:
            if variable.name in fix:
                kept[variable.name] = (variable.position(fix[variable.name], where),)
            elif variable.name in restrict:
                kept[variable.name] = variable.positions(restrict[variable.name], where)
        groups = {n: tuple(self.variable(n).positions(group, where) for group in merge[n]) for n in merge}
        for merged_name, together in groups.items():
            others = {position for group in together for position in group[1:]}
            kept[merged_name] = tuple(i for i in range(len(self.variable(merged_name))) if i not in others)
        gone = {*fix, *remove}
        return Task(
            name=name or f"{self.name}'",
            inputs=tuple(_fewer(v, kept.get(v.name)) for v in self.inputs if v.name not in gone),
            outputs=tuple(_fewer(v, kept.get(v.name)) for v in self.outputs if v.name not in gone),
            signals=self._simpler_signals(kept, gone, groups) if signals is None else tuple(signals),
            impossible=(
                self._simpler_impossible(kept, gone, groups) if impossible is None else tuple(impossible)
            ),
            impossible_signal=self.impossible_signal,
            time_reward=self.time_reward if time_reward is None else time_reward,
            parent=self,
            fixed={n: self.variable(n).values[kept[n][0]] for n in fix},
            removed=tuple(remove),
            merged={n: tuple(tuple(self.variable(n).values[i] for i in g) for g in groups[n]) for n in groups},
        )

    def _simpler_signals(self, kept: _Kept, gone: set[str], groups: _Groups) -> tuple[Signal, ...]:
        simpler = ((s, self._simpler(s.when, kept, gone, groups, f"signal {s.name!r}")) for s in self.signals)
        return tuple(replace(signal, when=when) for signal, when in simpler if when is not None)

    def _simpler_impossible(self, kept: _Kept, gone: set[str], groups: _Groups) -> tuple[Condition, ...]:
        simpler = (self._simpler(condition, kept, gone, groups, "impossible") for condition in self.impossible)
        return tuple(condition for condition in simpler if condition is not None)

    def _simpler(
        self, when: Condition, kept: _Kept, gone: set[str], groups: _Groups, what: str
    ) -> dict[str, tuple[Value, ...]] | None:
        """Return a condition over what is left of the table, or None if it can no longer hold."""
        simpler: dict[str, tuple[Value, ...]] = {}
        for name, values in when.items():
            variable = self.variable(name)
            positions = variable.positions(values, what)
            removed = name in gone and name not in kept
            together = (range(len(variable)),) if removed else groups.get(name, ())
            if any(0 < len(set(group) & set(positions)) < len(group) for group in together):
                raise TaskliftError(
                    f"task {self.name!r}, simplify: {what} depends on {name!r}, which is "
                    f"{'removed' if removed else 'merged'}; "
                    f"give the simpler task's own {'signals' if what != 'impossible' else 'impossible'}="
                )
            if removed:
                continue
            left = [i for i in positions if i in kept.get(name, range(len(variable)))]
            if not left:
                return None
            if name not in gone:
                simpler[name] = tuple(variable.values[i] for i in left)
        return simpler

    @property
    def lineage(self) -> tuple[Task, ...]:
        """This task, its parent, and so on up to the root."""
        tasks = [self]
        while tasks[-1].parent is not None:
            tasks.append(tasks[-1].parent)
        return tuple(tasks)

    @property
    def root(self) -> Task:
        """The task that all of this one's simplifications started from."""
        return self.lineage[-1]

    def ancestor(self, task: Task) -> Task:
        """Return the member of this task's lineage with the same variables as ``task``.

        Raises
        ------
        TaskliftError
            If this task is neither equal to ``task`` nor a simplification of it; names the variable.
        """
        for candidate in self.lineage:
            if candidate.difference(task) is None:
                return candidate
        reason = self.root.difference(task)
        raise TaskliftError(f"task {self.name!r} is neither equal to nor a simplification of {task.name!r}: {reason}")

    def difference(self, task: Task) -> str | None:
        """Say in which variable the tables of two tasks differ; None if they are the same."""
        for side in ("input", "output"):
            ours = {v.name: v for v in getattr(self, f"{side}s")}
            theirs = {v.name: v for v in getattr(task, f"{side}s")}
            for name in [*ours, *theirs]:
                if name not in theirs:
                    return f"{side} {name!r} of {self.name!r} is not in {task.name!r}"
                if name not in ours:
                    return f"{side} {name!r} of {task.name!r} is not in {self.name!r}"
                if ours[name].values != theirs[name].values:
                    a, b = _shown(ours[name].values), _shown(theirs[name].values)
                    return f"{side} {name!r} has the values {a} in {self.name!r} and {b} in {task.name!r}"
            if list(ours) != list(theirs):
                orders = f"{list(ours)} in {self.name!r}, {list(theirs)} in {task.name!r}"
                return f"the {side}s are in the order {orders}"
        return None

    def kept_positions(self, ancestor: Task) -> dict[str, tuple[int, ...] | None]:
        """Return, for every variable of an ancestor, the positions of its values that belong to this task.

        A variable of this task has the positions of its values, a fixed one the position of its one value,
        and a removed one None.
        """
        lineage = self.lineage
        between = lineage[: lineage.index(self.ancestor(ancestor))]
        ours = {v.name: v.values for v in self.variables}
        fixed = {n: (v,) for task in between for n, v in task.fixed.items()}
        found: dict[str, tuple[int, ...] | None] = {}
        for variable in ancestor.variables:
            values = ours.get(variable.name) or fixed.get(variable.name)
            found[variable.name] = None if values is None else variable.positions(values, "kept positions")
        return found

    def value_positions(self, ancestor: Task) -> dict[str, NDArray[np.int64] | None]:
        """Return, for every variable of an ancestor, where each of its values is among this task's, int64 (values,).

        It is −1 for a value that does not belong to this task, 0 for the value of a fixed variable, and the position of
        the group for merged values. A removed input has None.
        """
        lineage = self.lineage
        between = lineage[: lineage.index(self.ancestor(ancestor))]
        ours = {v.name: v for v in self.variables}
        fixed = {name: Variable(name, (value,)) for task in between for name, value in task.fixed.items()}
        found: dict[str, NDArray[np.int64] | None] = {}
        for variable in ancestor.variables:
            there = ours.get(variable.name) or fixed.get(variable.name)
            places = [] if there is None else [there.find(_named(v, variable.name, between)) for v in variable.values]
            found[variable.name] = None if there is None else np.array([-1 if p is None else p for p in places])
        return found

    def row_of(self, values: Mapping[str, Any]) -> int:
        """Return this task's row for an ancestor's input, given as ``{name: value}``; −1 if outside.

        Nothing is enumerated, so this serves tasks of any size.
        """
        lineage = self.lineage
        for k, task in enumerate(lineage):
            for name, value in task.fixed.items():
                if name in values and _named(values[name], name, lineage[k + 1 :]) != value:
                    return -1
        row = 0
        for variable in self.inputs:
            position = variable.find(_named(values[variable.name], variable.name, lineage))
            if position is None:
                return -1
            row = row * len(variable) + position
        return row

    def input_rows(self, ancestor: Task) -> NDArray[np.int64]:
        """Return this task's row for each input of an ancestor, int64 (S_ancestor,); −1 where outside."""
        ancestor.need_room(ancestor.shape[0], "the map of inputs")
        places = self.value_positions(ancestor)
        sizes = {v.name: len(v) for v in self.inputs}
        rows = np.zeros(1, dtype=np.int64)
        for variable in ancestor.inputs:
            found = places[variable.name]
            local = np.zeros(len(variable), dtype=np.int64) if found is None else found
            size = sizes.get(variable.name, 1)
            outside = np.logical_or.outer(rows < 0, local < 0)
            rows = np.where(outside, -1, np.add.outer(rows * size, local)).ravel()
        return rows

    def output_columns(self, ancestor: Task) -> NDArray[np.int64]:
        """Return the ancestor's output index of each of this task's outputs, int64 (A,)."""
        kept = self.kept_positions(ancestor)
        columns = np.zeros(1, dtype=np.int64)
        for variable in ancestor.outputs:
            inside = kept[variable.name] or ()
            columns = np.add.outer(columns * len(variable), np.asarray(inside, dtype=np.int64)).ravel()
        return columns

    @cached_property
    def input_map(self) -> NDArray[np.int64]:
        """This task's row for every input of the root task, int64 (S of the root,); −1 where outside."""
        return self.input_rows(self.root)

    @cached_property
    def output_map(self) -> NDArray[np.int64]:
        """The root task's output index of each of this task's outputs, int64 (A,)."""
        return self.output_columns(self.root)

    # -- identity and files --------------------------------------------------------------------------------

    def to_json(self) -> dict[str, Any]:
        """Return the whole declaration as JSON data, the tasks it came from included."""
        return {
            "name": self.name,
            "inputs": [v.to_json() for v in self.inputs],
            "outputs": [v.to_json() for v in self.outputs],
            "signals": [s.to_json() for s in self.signals],
            "impossible": [condition_json(c) for c in self.impossible],
            "impossible_signal": self.impossible_signal,
            "time_reward": self.time_reward,
            "parent": None if self.parent is None else self.parent.to_json(),
            "fixed": dict(self.fixed),
            "removed": list(self.removed),
            **({"merged": {n: [list(g) for g in groups] for n, groups in self.merged.items()}} if self.merged else {}),
        }

    @classmethod
    def from_json(cls, document: Any, where: str = "task") -> Task:
        """Read what :meth:`to_json` gives; every error is a :class:`TaskliftError` that names ``where``."""
        number = (int, float)
        data = check_fields(
            document,
            where,
            {
                "name": str,
                "inputs": list,
                "outputs": list,
                "signals": list,
                "impossible": list,
                "impossible_signal": number,
                "time_reward": number,
                "parent": (dict, None),
                "fixed": dict,
                "removed": list,
                "merged?": dict,
            },
        )
        signals = [
            check_fields(s, f"{where}, signal", {"value": number, "when": dict, "name": str}) for s in data["signals"]
        ]
        if not all(isinstance(n, str) for n in data["removed"]):
            raise TaskliftError(f"{where}: expected names in 'removed', found {data['removed']!r}")
        merged = data.get("merged", {})
        if not all(isinstance(g, list) and all(isinstance(v, list) for v in g) for g in merged.values()):
            raise TaskliftError(f"{where}: expected groups of values in 'merged', found {shown(merged)}")
        return cls(
            name=data["name"],
            inputs=tuple(Variable.from_json(v, f"{where}, inputs") for v in data["inputs"]),
            outputs=tuple(Variable.from_json(v, f"{where}, outputs") for v in data["outputs"]),
            signals=tuple(Signal(s["value"], s["when"], s["name"]) for s in signals),
            impossible=tuple(data["impossible"]),
            impossible_signal=data["impossible_signal"],
            time_reward=data["time_reward"],
            parent=None if data["parent"] is None else cls.from_json(data["parent"], where),
            fixed=data["fixed"],
            removed=tuple(data["removed"]),
            merged=merged,
        )

    @cached_property
    def _content(self) -> str:
        return canonical_json(self.to_json())

    def __eq__(self, other: object) -> bool:
        return isinstance(other, Task) and (self is other or self._content == other._content)

    def __hash__(self) -> int:
        return hash(self._content)


def _named(value: Any, name: str, lineage: Sequence[Task]) -> Any:
    """Return the value that stands for a value of an ancestor's input, after all merging from there down."""
    for task in reversed(lineage):
        for group in task.merged.get(name, ()):
            if value in group:
                value = group[0]
    return value


def _fewer(variable: Variable, kept: tuple[int, ...] | None) -> Variable:
    if kept is None:
        return variable
    labels = None if variable.labels is None else tuple(variable.labels[i] for i in kept)
    return replace(variable, values=tuple(variable.values[i] for i in kept), labels=labels)


def _allowed(variable: Variable, tidy: Condition) -> NDArray[np.bool_]:
    """Return which values of a variable meet a condition, bool (values,)."""
    allowed = np.ones(len(variable), dtype=np.bool_)
    if variable.name in tidy:
        allowed[:] = False
        allowed[list(variable.positions(tidy[variable.name], variable.name))] = True
    return allowed


def _mask(variables: tuple[Variable, ...], tidy: Condition) -> NDArray[np.bool_]:
    """Return where a condition holds among all combinations of variables, in C order."""
    mask = np.ones(1, dtype=np.bool_)
    for variable in variables:
        mask = np.logical_and.outer(mask, _allowed(variable, tidy)).ravel()
    return mask


def _shown(values: tuple[Value, ...]) -> str:
    return f"({', '.join(map(repr, values[:8]))}{', …' if len(values) > 8 else ''})"
