"""The priors of tables as operations on a network's outputs."""

from __future__ import annotations

from typing import Any

import numpy as np

from tasklift.errors import TaskliftError
from tasklift.networks.extension import Extension, codes
from tasklift.networks.layers import Decoder, Knowledge
from tasklift.tasks.prior import Prior
from tasklift.tasks.task import Task


def knowledge(prior: Prior, extension: Extension, head: str, logits: bool) -> Knowledge:
    """Return a prior as an operation behind the last layer; see :func:`tasklift.networks.extend.extend_module`."""
    task = extension.target
    nobody = np.zeros((0, len(task.inputs)), dtype=np.int64)
    # unknown names and values are refused here, with the words of the tables
    prior.apply(task, np.zeros((0, task.shape[1])), nobody)
    said = prior.to_json()
    operation, when = said["operation"], dict(said["when"])
    if operation not in ("swap", "forget", "invert", "scale", "set_weight"):
        raise TaskliftError(f"extend_module: the prior {operation!r} is not known for networks; extend a table with it")
    inputs = {v.name: v for v in task.inputs}
    where = _decoder(task, extension, {n: when[n] for n in when if n in inputs})
    columns = _columns(task, head, said, {n: when[n] for n in when if n not in inputs})
    rest: dict[str, Any] = {"outputs": extension.outputs.size}
    rest |= {name: float(said[name]) for name in ("factor", "value") if name in said}
    if operation in ("swap", "forget"):
        variable = task.variable(said["output"])
        start, stride = _place(task, head, said["output"])
        size, count = len(variable), extension.outputs.size
        column = np.arange(count)
        position = (column - start) // stride % size if head == "flat" else column - start
        inside = np.ones(count, dtype=bool) if head == "flat" else (position >= 0) & (position < size)
        base = np.where(inside, column - position * stride, column)
        if operation == "forget":
            steps = np.where(inside[:, None], np.arange(size) * stride, 0)
            rest["alike"] = base[:, None] + steps
        else:
            one, other = (variable.position(v) for v in said.get("values", variable.values))
            swapped = np.where(position == one, other, np.where(position == other, one, position))
            rest["swapped"] = np.where(inside, base + swapped * stride, column)
    return Knowledge(operation, where, columns, logits, **rest)


def _decoder(task: Task, extension: Extension, when: dict[str, Any]) -> Decoder:
    if extension.encoding == "flat":
        return Decoder("flat", [], task.input_mask(when))
    allowed, start = [], 0
    for variable in task.inputs:
        if variable.name in when:
            mask = [False] * len(variable)
            for position in variable.positions(when[variable.name], "prior"):
                mask[position] = True
            allowed.append((start, codes(variable), mask))
        start += len(variable) if extension.encoding == "one-hot" else 1
    return Decoder(extension.encoding, allowed, [False])


def _place(task: Task, head: str, name: str) -> tuple[int, int]:
    """Return the first column of an output's values, and how far apart they are."""
    names = [v.name for v in task.outputs]
    at = names.index(name)
    if head == "flat":
        return 0, int(np.prod([len(v) for v in task.outputs[at + 1 :]], initial=1))
    return sum(len(v) for v in task.outputs[:at]), 1


def _columns(task: Task, head: str, said: dict[str, Any], when: dict[str, Any]) -> list[int]:
    """Return the columns that a prior may change."""
    if head == "flat":
        nothing = np.zeros((1, len(task.inputs)), dtype=np.int64)
        mask = task.where(when, nothing)[0]
        if said["operation"] == "swap":
            variable = task.variable(said["output"])
            pair = said.get("values", variable.values)
            mask = mask & task.where({said["output"]: list(pair)}, nothing)[0]
        return np.flatnonzero(mask).tolist()
    names = {*when, *([said["output"]] if "output" in said else [])}
    if len(names) != 1:
        raise TaskliftError(
            f"extend_module: a head with numbers for each output takes a prior about one, found {sorted(names)}; "
            "use a head with one number for each combination"
        )
    name = names.pop()
    variable, (start, _) = task.variable(name), _place(task, head, name)
    wanted = when.get(name, said.get("values", variable.values))
    return [start + position for position in variable.positions(wanted, "prior")]
