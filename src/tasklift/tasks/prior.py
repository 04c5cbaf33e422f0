"""Prior knowledge: operations on chosen rows of a policy's weights, named, so that provenance can tell them.

"If we know that the unsafe value requires the direct opposite of the safe value actions, the signs of the weight
values can be inverted instead of merely copying them" (Singh & Adams 2006, section VII).
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from tasklift.errors import TaskliftError
from tasklift.tasks.task import Condition, Task
from tasklift.tasks.variable import Variable, plain_number

Weights = NDArray[np.float64]
Inputs = NDArray[np.int64] | None


class Prior(Protocol):
    """Prior knowledge: an operation on chosen weights."""

    def apply(self, task: Task, weights: Weights, inputs: Inputs = None) -> Weights:
        """Return changed weights of ``task``; the given ones stay as they are.

        Parameters
        ----------
        weights
            float64 (S, A), or (n, A) of some inputs only.
        inputs
            int64 (n, variables): the positions of their values (:meth:`Task.input_positions`); None: all inputs.
        """
        ...

    def to_json(self) -> dict[str, Any]:
        """Return what was done, for the provenance of a policy."""
        ...


@dataclass(frozen=True)
class _Swap:
    output: str
    values: tuple[Any, Any] | None
    when: Condition

    def apply(self, task: Task, weights: Weights, inputs: Inputs = None) -> Weights:
        where = "prior swap"
        variable = _output(task, self.output, self.when, where)
        if self.values is None and len(variable) != 2:
            raise TaskliftError(f"{where}: {self.output!r} has {len(variable)} values; say which with values=(a, b)")
        pair = variable.values if self.values is None else self.values
        if len(pair) != 2:
            raise TaskliftError(f"{where}: expected two values to swap, found {pair!r}")
        one, other = (task.where({**self.when, self.output: value}, inputs) for value in pair)
        changed = weights.copy()
        # the masks list the same rows, and the other outputs in the same order, so their entries match one
        # to one
        changed[one], changed[other] = weights[other], weights[one]
        return changed

    def to_json(self) -> dict[str, Any]:
        return _json("swap", self.when, output=self.output, values=self.values)


@dataclass(frozen=True)
class _Forget:
    output: str
    when: Condition

    def apply(self, task: Task, weights: Weights, inputs: Inputs = None) -> Weights:
        variable = _output(task, self.output, self.when, "prior forget")
        cube = weights.reshape(len(weights), *map(len, task.outputs))
        means = cube.mean(axis=1 + task.outputs.index(variable), keepdims=True)
        even = np.broadcast_to(means, cube.shape).reshape(weights.shape)
        return np.where(task.where(self.when, inputs), even, weights)

    def to_json(self) -> dict[str, Any]:
        return _json("forget", self.when, output=self.output)


@dataclass(frozen=True)
class _Invert:
    when: Condition

    def apply(self, task: Task, weights: Weights, inputs: Inputs = None) -> Weights:
        chosen = task.where(self.when, inputs)
        rows = chosen.any(axis=1)
        low = weights.min(axis=1, where=chosen, initial=np.inf)[rows, None]
        high = weights.max(axis=1, where=chosen, initial=-np.inf)[rows, None]
        changed = weights.copy()
        reflected = np.clip(low + high - weights[rows], low, high)
        changed[rows] = np.where(chosen[rows], reflected, weights[rows])
        return changed

    def to_json(self) -> dict[str, Any]:
        return _json("invert", self.when)


@dataclass(frozen=True)
class _Scale:
    factor: float
    when: Condition

    def apply(self, task: Task, weights: Weights, inputs: Inputs = None) -> Weights:
        return np.where(task.where(self.when, inputs), weights * self.factor, weights)

    def to_json(self) -> dict[str, Any]:
        return _json("scale", self.when, factor=self.factor)


@dataclass(frozen=True)
class _SetWeight:
    value: float
    when: Condition

    def apply(self, task: Task, weights: Weights, inputs: Inputs = None) -> Weights:
        return np.where(task.where(self.when, inputs), self.value, weights)

    def to_json(self) -> dict[str, Any]:
        return _json("set_weight", self.when, value=self.value)


def _output(task: Task, name: str, when: Condition, where: str) -> Variable:
    """Return the output variable that a prior changes; it cannot be one of the prior's conditions."""
    variable = task.variable(name, where)
    if variable not in task.outputs:
        raise TaskliftError(f"{where}: expected an output, found the input {name!r}")
    if name in when:
        raise TaskliftError(f"{where}: {name!r} is what is changed, it cannot be a condition as well")
    return variable


def _json(operation: str, when: Condition, **rest: Any) -> dict[str, Any]:
    conditions = {n: v if isinstance(v, str) else np.asarray(v).tolist() for n, v in when.items()}
    return {"operation": operation, "when": conditions} | {
        name: list(v) if isinstance(v, tuple) else v for name, v in rest.items() if v is not None
    }


def swap(output: str, values: tuple[Any, Any] | None = None, when: Condition | None = None) -> Prior:
    """Prior: exchange the weights of two values of an output; the unsafe value asks for the opposite.

    Parameters
    ----------
    output
        An output variable; one of two values needs no ``values``.
    values
        The two values to exchange; all other outputs keep their combination.
    when
        ``{variable: value or values}``: only there. Conditions on inputs choose rows, on outputs columns.

    Raises
    ------
    TaskliftError
        When it is applied: for an unknown output, an input, or a pair that is not two of its values.

    Examples
    --------
    >>> from tasklift.tasks.policy import Policy
    >>> from tasklift.tasks.task import Task, Variable
    >>> door = Task("door", inputs=(Variable("danger", (0, 1)),), outputs=(Variable("move", (0, 1)),))
    >>> policy = Policy(door, [[1.0, 3.0], [1.0, 3.0]])
    >>> policy.extend(door, prior=[swap("move", when={"danger": 1})]).weights.tolist()
    [[1.0, 3.0], [3.0, 1.0]]
    """
    return _Swap(output, None if values is None else tuple(values), dict(when or {}))


def forget(output: str, when: Condition | None = None) -> Prior:
    """Prior: spread what was learned about an output evenly over its values; keep what was learned about the others.

    A simple task teaches an output wrongly where the danger it leaves out decides. In the safe building search, every
    stop is punished. Forgetting the output lets the next stage learn it anew, without losing the rest.

    Parameters
    ----------
    output : str
        An output variable. All its values get the mean weight over them, for each combination of the other outputs.
    when : mapping, optional
        ``{variable: value or values}``: only there.

    Raises
    ------
    TaskliftError
        When it is applied: for an unknown output, an input, or a condition on the output itself.

    Examples
    --------
    >>> from tasklift.tasks.policy import Policy
    >>> from tasklift.tasks.task import Task, Variable
    >>> door = Task("door", inputs=(), outputs=(Variable("move", (0, 1)), Variable("way", ("left", "right"))))
    >>> policy = Policy(door, [[1.0, 2.0, 3.0, 8.0]])
    >>> policy.extend(door, prior=[forget("move")]).weights.tolist()
    [[2.0, 5.0, 2.0, 5.0]]
    """
    return _Forget(output, dict(when or {}))


def invert(when: Condition | None = None) -> Prior:
    """Prior: turn the order of the chosen weights of each row around.

    The paper inverts signs. Weights here are not negative, so each chosen weight is reflected between the
    smallest and the largest chosen weight of its row: the heaviest becomes the lightest, and the range stays.

    Parameters
    ----------
    when : mapping, optional
        ``{variable: value or values}``: only there.

    Examples
    --------
    >>> from tasklift.tasks.policy import Policy
    >>> from tasklift.tasks.task import Task, Variable
    >>> door = Task("door", inputs=(Variable("danger", (0, 1)),), outputs=(Variable("move", (0, 1)),))
    >>> policy = Policy(door, [[1.0, 3.0], [1.0, 3.0]])
    >>> policy.extend(door, prior=[invert({"danger": 1})]).weights.tolist()
    [[1.0, 3.0], [3.0, 1.0]]
    """
    return _Invert(dict(when or {}))


def scale(factor: float, when: Condition | None = None) -> Prior:
    """Prior: multiply the chosen weights by a factor.

    Parameters
    ----------
    factor : float
        Finite, at least 0.
    when : mapping, optional
        ``{variable: value or values}``: only there.

    Raises
    ------
    TaskliftError
        If the factor is not a finite number of at least 0.

    Examples
    --------
    >>> from tasklift.tasks.policy import Policy
    >>> from tasklift.tasks.task import Task, Variable
    >>> door = Task("door", inputs=(Variable("danger", (0, 1)),), outputs=(Variable("move", (0, 1)),))
    >>> policy = Policy(door, [[1.0, 3.0], [1.0, 3.0]])
    >>> policy.extend(door, prior=[scale(0.5, {"danger": 1})]).weights.tolist()
    [[1.0, 3.0], [0.5, 1.5]]
    """
    return _Scale(_finite(factor, "scale", at_least=0.0), dict(when or {}))


def set_weight(value: float, when: Condition | None = None) -> Prior:
    """Prior: give the chosen weights this value.

    Parameters
    ----------
    value : float
        Finite.
    when : mapping, optional
        ``{variable: value or values}``: only there.

    Raises
    ------
    TaskliftError
        If the value is not a finite number.

    Examples
    --------
    >>> from tasklift.tasks.policy import Policy
    >>> from tasklift.tasks.task import Task, Variable
    >>> door = Task("door", inputs=(Variable("danger", (0, 1)),), outputs=(Variable("move", (0, 1)),))
    >>> policy = Policy(door, [[1.0, 3.0], [1.0, 3.0]])
    >>> policy.extend(door, prior=[set_weight(0.0, {"danger": 1, "move": 1})]).weights.tolist()
    [[1.0, 3.0], [1.0, 0.0]]
    """
    return _SetWeight(_finite(value, "set_weight"), dict(when or {}))


def _finite(value: float, what: str, at_least: float = -math.inf) -> float:
    number = plain_number(value, f"prior {what}")
    if number < at_least:
        raise TaskliftError(f"prior {what}: expected a number of {at_least} or more, found {value!r}")
    return number
