"""Networks (``torch.nn.Module``) for a task with more inputs or outputs than the one they were trained on.

:func:`extend_module` is for networks what :meth:`.Policy.extend` is for tables. On the source task's inputs, the
outputs are the same numbers. :class:`.Extension` takes along what belongs to the network: the optimiser's moments,
statistics of normalisation, experience. Needs the extra ``torch``.

Shapes: ``S`` inputs and ``A`` outputs of a task; ``F`` columns of an observation.
"""

from __future__ import annotations

import copy
from collections.abc import Sequence
from typing import TYPE_CHECKING, Any, Literal

import numpy as np

from tasklift.checks import number, one_of
from tasklift.errors import TaskliftError, missing
from tasklift.networks.extension import Encoding, Extension, Side, index_of, representatives
from tasklift.tasks.policy import spread
from tasklift.tasks.prior import Prior
from tasklift.tasks.task import Task

if TYPE_CHECKING:
    from torch import Tensor, nn

#: By how much the logit or value of a new output lies below that of the output it is copied from, if not chosen.
BELOW = 5.0


def extend_module(
    module: nn.Module,
    source_task: Task,
    target_task: Task,
    prior: Sequence[Prior] = (),
    *,
    encoding: Encoding | None = None,
    head: Literal["flat", "factored"] | None = None,
    first: Sequence[str] | None = None,
    last: Sequence[str] | None = None,
    outputs: Literal["logits", "values"] = "logits",
    new_inputs: Literal["copied", "neutral"] = "copied",
    new_actions: float | Literal["copied", "below"] = "below",
) -> Any:
    """Return a copy of a network, extended to the task that its own task came from.

    On the source task's inputs the outputs are the same numbers, bit by bit. New inputs have no influence at first.
    The result is an ordinary module; its ``extension`` (:class:`Extension`) takes along what belongs to it.

    Parameters
    ----------
    module : torch.nn.Module
        Stays as it is.
    source_task, target_task : Task
        The task that the network was trained on, and one that it is a simplification of.
    prior
        As for tables: :func:`swap`, :func:`forget`, :func:`invert`, :func:`scale`, :func:`set_weight`. They are exact:
        fixed operations behind the last layer, where their condition on the inputs holds.
    encoding
        How the network sees an input: ``"one-hot"``, a column per value; ``"scalar"``, a column per variable with its
        value (or its position, if it is not a number); ``"flat"``, the index of the input, for an embedding.
        Default: by the width of the first layers.
    head
        What the network answers: ``"flat"``, one number per combination of outputs; ``"factored"``, one per value of
        each output. Default: by the width of the last layers.
    first, last
        Names of the layers that see the input, and of those that give the outputs. Default: found by their width.
    outputs
        ``"logits"``: logarithms of weights, as a policy's. ``"values"``: a value per output.
    new_inputs
        What a value that a restriction had left out begins as: the mean of the others, or nothing.
    new_actions
        The logit or value of new outputs; ``"copied"``: as :meth:`.Policy.extend` does; ``"below"``: copied and 5
        lower, so that the best output stays the best.

    Raises
    ------
    TaskliftError
        For layers that are not there or do not fit (names the layer and the width expected), tasks that are not of one
        lineage, and priors that are not known. Nothing is changed.

    Examples
    --------
    >>> import torch  # doctest: +SKIP
    >>> net = torch.nn.Sequential(torch.nn.Linear(8, 64), torch.nn.Tanh(), torch.nn.Linear(64, 44))  # doctest: +SKIP
    >>> wide = extend_module(net, search_only(task), task, prior=[forget("MV")])  # doctest: +SKIP
    """
    try:
        import torch
    except ImportError as error:
        raise missing("PyTorch", "torch", "a network") from error
    from tasklift.networks import finding, trial

    if not isinstance(module, torch.nn.Module):
        raise TaskliftError(f"extend_module: expected a torch.nn.Module, found {type(module).__name__}")
    ancestor = source_task.ancestor(target_task)
    one_of(outputs, ("logits", "values"), "extend_module, outputs")
    one_of(new_inputs, ("copied", "neutral"), "extend_module, new_inputs")
    if not isinstance(new_actions, str):
        new_actions = number(new_actions, "extend_module, new_actions")
    else:
        one_of(new_actions, ("copied", "below"), "extend_module, new_actions")
    plan = finding.find(module, source_task, encoding, head, first, last)
    result = Extension(
        source_task,
        target_task,
        plan.encoding,
        _inputs(source_task, ancestor, plan.encoding, new_inputs),
        _outputs(source_task, ancestor, plan.head),
        first=tuple(plan.first),
        last=tuple(plan.last),
    )
    wide = copy.deepcopy(module, trial.passing(module))
    wide = _widen(wide, plan, result, new_actions)
    _widen_buffers(wide, plan, result)
    if hasattr(wide, "observation_space") and hasattr(wide, "action_space"):
        from tasklift.networks.spaces import retell

        retell(wide, result)
    trial.compare(module, wide, result)
    if prior:
        _know(wide, result, plan, prior, outputs)
    wide.extension = result
    return wide


def _inputs(source: Task, target: Task, encoding: Encoding, new: str) -> Side:
    if encoding == "flat":
        target.need_room(target.shape[0] * source.shape[0], "the extended embedding")
        mix = spread(np.eye(source.shape[0]), source.inputs, target.inputs, source.value_positions(target), axis=0)
        rows = representatives(source, target, {})
        return Side(rows.tolist(), mix)
    if merged := [name for task in source.lineage for name in task.merged]:
        raise TaskliftError(
            f"extend_module: values of {merged[0]!r} are merged; only a network that sees a flat input can be extended"
        )
    kept, ours = source.kept_positions(target), {v.name: v for v in source.inputs}
    starts, columns = {}, 0
    for variable in source.inputs:
        starts[variable.name] = columns
        columns += len(variable) if encoding == "one-hot" else 1
    old: dict[int, int] = {}
    rows_of_mix: list[Any] = []
    for variable in target.inputs:
        inside = (kept[variable.name] or ()) if variable.name in ours else ()
        for position in range(len(variable) if encoding == "one-hot" else 1):
            row = np.zeros(columns)
            if variable.name in ours:
                start = starts[variable.name]
                if encoding == "scalar" or position in inside:
                    column = start + (0 if encoding == "scalar" else inside.index(position))
                    old[column] = len(rows_of_mix)
                    row[column] = 1
                elif new == "copied":
                    row[start : start + len(inside)] = 1 / len(inside)
            rows_of_mix.append(row)
    return Side([old[i] for i in range(columns)], np.array(rows_of_mix).reshape(-1, columns))


def _outputs(source: Task, target: Task, head: str) -> Side:
    if head == "flat":
        mix = spread(np.eye(source.shape[1]), source.outputs, target.outputs, source.value_positions(target), axis=0)
        return Side(source.output_columns(target).tolist(), mix)
    kept = source.kept_positions(target)
    ours = {v.name: v for v in source.outputs}
    columns = sum(len(v) for v in source.outputs)
    old: dict[int, int] = {}
    rows: list[Any] = []
    start = 0
    for variable in target.outputs:
        inside = kept[variable.name] or ()
        for position in range(len(variable)):
            row = np.zeros(columns)
            if variable.name in ours:
                if position in inside:
                    old[start + inside.index(position)] = len(rows)
                    row[start + inside.index(position)] = 1
                else:
                    row[start : start + len(inside)] = 1 / len(inside)
            rows.append(row)
        start += len(inside) if variable.name in ours else 0
    return Side([old[i] for i in range(columns)], np.array(rows))


def _widen(wide: nn.Module, plan: Any, extension: Extension, new_actions: float | str) -> nn.Module:
    import torch

    from tasklift.networks import layers

    for name in dict.fromkeys([*plan.first, *plan.last]):
        old = wide.get_submodule(name) if name else wide
        into = extension.inputs if name in plan.first else None
        out = extension.outputs if name in plan.last else None
        new: Any
        if isinstance(old, torch.nn.Embedding):
            more: dict[str, Any] = {"device": old.weight.device, "dtype": old.weight.dtype}
            new = torch.nn.Embedding(extension.inputs.size, old.embedding_dim, max_norm=old.max_norm, **more)
            pairs: dict[str, tuple[Side | None, Side | None]] = {"weight": (into, None)}
        elif type(old) in layers.RECURRENT:
            new = layers.RECURRENT[type(old)](_groups(old, "in", into), old)
            pairs = {n: (None, into) for n in ("weight_ih_l0", "weight_ih_l0_reverse") if hasattr(old, n)}
        else:
            assert isinstance(old, torch.nn.Linear)
            new = old
            if (into is not None and into.new) or (out is not None and out.new) or _moved(into) or _moved(out):
                new = layers.WiderLinear(_groups(old, "in", into), _groups(old, "out", out), old)
            pairs = {"weight": (out, into), "bias": (out, None)}
        if new is old:
            continue
        with torch.no_grad():
            for parameter, value in old.named_parameters():
                getattr(new, parameter).copy_(_mixed(value, *pairs.get(parameter, (None, None))))
            if out is not None and out.new and isinstance(old, torch.nn.Linear):
                _start_actions(new, out, new_actions, name)
        for parameter, value in old.named_parameters():
            getattr(new, parameter).requires_grad_(value.requires_grad)
            key = f"{name}.{parameter}" if name else parameter
            extension.places[key] = pairs.get(parameter, (None, None))
        new.train(old.training)
        vars(new).update({key: hooks for key, hooks in vars(old).items() if key.endswith(("_hooks", "_with_kwargs"))})
        wide = _replaced(wide, old, new)
    return wide


def _replaced(wide: nn.Module, old: nn.Module, new: nn.Module) -> nn.Module:
    """Put a layer in another one's place, under all the names that it has."""
    for parent in list(wide.modules()):
        for name, child in list(parent._modules.items()):
            if child is old:
                setattr(parent, name, new)
    return new if wide is old else wide


def _moved(side: Side | None) -> bool:
    return side is not None and side.old != list(range(side.size))


def _groups(layer: nn.Module, which: str, side: Side | None) -> list[list[int]]:
    from tasklift.networks.layers import groups_of

    groups = groups_of(layer, which)
    if side is None:
        return groups
    return [[side.old[i] for i in group] for group in groups] + ([side.new] if side.new else [])


def _mixed(value: Tensor, out: Side | None, into: Side | None) -> Tensor:
    """Return a parameter with rows and columns copied or averaged; those of the source keep their bits."""
    import torch

    wide = value
    for axis, side in ((0, out), (1, into)):
        if side is None:
            continue
        mix = torch.as_tensor(side.mix, dtype=value.dtype, device=value.device)
        made = torch.tensordot(mix, wide, dims=([1], [axis])).movedim(0, axis).contiguous()
        made.index_copy_(axis, index_of(side.old, value), wide)
        # a copy keeps its bits, too: where one source column has all the weight, it is taken as it is
        one = np.flatnonzero((side.mix == 1).any(axis=1))
        origin = side.mix.argmax(axis=1)[one]
        made.index_copy_(axis, index_of(one.tolist(), value), wide.index_select(axis, index_of(origin.tolist(), value)))
        wide = made
    return wide


def _start_actions(layer: Any, out: Side, new_actions: float | str, name: str) -> None:
    if new_actions == "copied":
        return
    if layer.bias is None:
        raise TaskliftError(
            f"extend_module: layer {name!r} has no bias, so new outputs cannot begin at a chosen number; "
            "say new_actions='copied'"
        )
    if new_actions == "below":
        layer.bias[out.new] -= BELOW
    else:
        layer.weight[out.new] = 0
        layer.bias[out.new] = new_actions


def _widen_buffers(wide: nn.Module, plan: Any, extension: Extension) -> None:
    """Widen running means and variances of the input: new columns begin with mean 0 and variance 1."""
    import torch

    from tasklift.networks.layers import WiderBatchNorm

    for name in plan.normalised:
        layer: Any = wide.get_submodule(name)
        new: Any = WiderBatchNorm(_groups(layer, "in", extension.inputs), layer)
        with torch.no_grad():
            for key, value in layer.state_dict().items():
                target = new.state_dict()[key]
                target.copy_(value) if value.dim() == 0 else target.index_copy_(
                    0, index_of(extension.inputs.old, target), value.to(target)
                )
        for parameter, _ in layer.named_parameters():
            extension.places[f"{name}.{parameter}"] = (extension.inputs, None)
        new.to(next(iter(layer.state_dict().values()), torch.zeros(0))).train(layer.training)
        _replaced(wide, layer, new)
    for name in plan.statistics:
        parent = wide.get_submodule(name.rpartition(".")[0])
        key = name.rpartition(".")[2]
        old = getattr(parent, key)
        shape = (*old.shape[:-1], extension.inputs.size)
        new = old.new_ones(shape) if any(word in key for word in ("var", "std")) else old.new_zeros(shape)
        new[..., extension.inputs.old] = old
        setattr(parent, key, new)


def _know(wide: nn.Module, extension: Extension, plan: Any, prior: Sequence[Prior], outputs: str) -> None:
    """Put prior knowledge behind the last layers."""
    import torch

    from tasklift.networks.layers import Corrected, Seen
    from tasklift.networks.priors import knowledge

    if plan.normalised or plan.statistics:
        raise TaskliftError(
            f"extend_module: the network normalises its input ({(*plan.normalised, *plan.statistics)[0]!r}), so a "
            "prior cannot see values; normalise before the network, and only columns that no prior names"
        )
    seen = Seen()
    for name in plan.first:
        wide.get_submodule(name).register_forward_pre_hook(seen)
    for name in plan.last:
        steps = [knowledge(one, extension, plan.head, outputs == "logits") for one in prior]
        layer = wide.get_submodule(name)
        layer.register_forward_hook(Corrected(seen, steps))
        # a plain network would load these parameters and silently leave the prior out; this entry stops it
        layer.register_buffer("prior_knowledge", torch.tensor(len(steps)))
