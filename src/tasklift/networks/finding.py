"""Which layers of a network see its input, and which give its outputs."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Any

from torch import nn

from tasklift.errors import TaskliftError
from tasklift.networks.extension import Encoding, width
from tasklift.networks.layers import RECURRENT, WiderLinear
from tasklift.tasks.task import Task

#: Layers with parameters that can be a first layer, by how they call the width of their input.
FIRST = {nn.Linear: "in_features", WiderLinear: "in_features", nn.Embedding: "num_embeddings"}
FIRST |= dict.fromkeys(RECURRENT, "input_size")


@dataclass
class Plan:
    """What to widen: names of layers; how the network sees its input and says its outputs."""

    encoding: Encoding
    head: Any
    first: list[str]
    last: list[str]
    normalised: list[str] = field(default_factory=list)
    statistics: list[str] = field(default_factory=list)


def find(
    module: nn.Module,
    source: Task,
    encoding: Encoding | None,
    head: Any,
    first: Sequence[str] | None,
    last: Sequence[str] | None,
) -> Plan:
    """Return what to widen, or refuse with the names of the layers and the widths expected."""
    layers = dict(module.named_modules())
    encodings: list[Encoding] = ["one-hot", "scalar", "flat"] if encoding is None else [encoding]
    if encoding not in (None, "one-hot", "scalar", "flat"):
        raise TaskliftError(f"extend_module, encoding: expected one-hot, scalar or flat, found {encoding!r}")
    heads = {"flat": source.shape[1], "factored": sum(len(v) for v in source.outputs)}
    if head is not None and head not in heads:
        raise TaskliftError(f"extend_module, head: expected flat or factored, found {head!r}")
    heads = heads if head is None else {head: heads[head]}
    known = _known(layers) if first is None or last is None else {}
    chosen = _first(layers, source, encodings, first or known.get("first"))
    ends = _last(layers, heads, last or known.get("last"))
    plan = Plan(chosen[0], ends[0], chosen[1], ends[1])
    columns = width(source, plan.encoding)
    if plan.encoding != "flat":
        for name, layer in layers.items():
            if isinstance(layer, nn.BatchNorm1d) and layer.num_features == columns and _leads(name, plan.first):
                plan.normalised.append(name)
            if isinstance(layer, nn.LayerNorm) and layer.normalized_shape == (columns,) and _leads(name, plan.first):
                raise TaskliftError(
                    f"extend_module: layer {name!r} (LayerNorm) mixes all {columns} inputs, so new ones would change "
                    "the outputs; take it out, or normalise each input for itself"
                )
        for name, buffer in module.named_buffers():
            owner, _, called = name.rpartition(".")
            if isinstance(layers[owner], nn.modules.batchnorm._NormBase) or not buffer.dim():
                continue
            if buffer.shape[-1] == columns and any(word in called for word in ("mean", "var", "std")):
                plan.statistics.append(name)
    return plan


def _leads(name: str, first: Sequence[str]) -> bool:
    """Return whether a layer stands before a first layer, in the same container."""
    parent, _, at = name.rpartition(".")
    for one in first:
        there, _, place = one.rpartition(".")
        if there == parent and at.isdigit() and place.isdigit() and int(at) < int(place):
            return True
    return False


def _known(layers: dict[str, nn.Module]) -> dict[str, list[str]]:
    """Return the layers of a Stable-Baselines3 actor-critic, whose parts have fixed names."""
    if "action_net" not in layers or "mlp_extractor" not in layers:
        return {}
    first = [f"mlp_extractor.{net}.0" for net in ("policy_net", "value_net") if f"mlp_extractor.{net}.0" in layers]
    return {"first": first or ["action_net", "value_net"], "last": ["action_net"]}


def _first(
    layers: dict[str, nn.Module], source: Task, encodings: Sequence[Encoding], names: Sequence[str] | None
) -> tuple[Encoding, list[str]]:
    fits = {e: width(source, e) for e in encodings}
    if names is not None:
        sizes = {name: _size(_layer(layers, name, "first"), name) for name in names}
        for encoding, expected in fits.items():
            flat = encoding == "flat"
            if all(s == expected and isinstance(layers[n], nn.Embedding) == flat for n, s in sizes.items()):
                return encoding, list(names)
        name = next(n for n, s in sizes.items() if s not in fits.values()) if set(sizes.values()) - set(
            fits.values()
        ) else next(iter(sizes))  # fmt: skip
        raise TaskliftError(
            f"extend_module: layer {name!r} has {sizes[name]} inputs; for {source.name!r} expected {_said(fits)}"
        )
    for encoding, expected in fits.items():
        kinds = (nn.Embedding,) if encoding == "flat" else tuple(kind for kind in FIRST if kind is not nn.Embedding)
        found = [n for n, layer in layers.items() if type(layer) in kinds and _size(layer, n) == expected]
        found = [n for n in found if not _follows(n, found, layers)]
        if found:
            _unambiguous(found, layers, "first")
            return encoding, found
    there = [f"{n!r} {getattr(layer, FIRST[type(layer)])}" for n, layer in layers.items() if type(layer) in FIRST]
    raise TaskliftError(
        f"extend_module: no layer has the inputs of {source.name!r}: expected {_said(fits)}; "
        f"found {', '.join(there[:4]) or 'no layer that can be widened'}; name the layers with first="
    )


def _last(layers: dict[str, nn.Module], heads: dict[str, int], names: Sequence[str] | None) -> tuple[str, list[str]]:
    if names is not None:
        for head, expected in heads.items():
            if all(getattr(_layer(layers, n, "last"), "out_features", None) == expected for n in names):
                return head, list(names)
        name = names[0]
        found = getattr(layers[name], "out_features", None)
        raise TaskliftError(f"extend_module: layer {name!r} has {found} outputs; expected {_said(heads)}")
    for head, expected in heads.items():
        some = [n for n, layer in layers.items() if type(layer) in (nn.Linear, WiderLinear)]
        fit = [n for n in some if getattr(layers[n], "out_features", 0) == expected]
        fit = [n for n in fit if not any(_follows(later, [n], layers) for later in some if later != n)]
        if fit:
            _unambiguous(fit, layers, "last")
            return head, fit
    sizes = [f"{n!r} {layer.out_features}" for n, layer in layers.items() if isinstance(layer, nn.Linear)]
    raise TaskliftError(
        f"extend_module: no layer has the outputs: expected {_said(heads)}; found {', '.join(sizes[-4:])}; "
        "name the layers with last="
    )


def _follows(name: str, others: Sequence[str], layers: dict[str, nn.Module]) -> bool:
    """Return whether a layer comes after one of the others in a Sequential."""
    for other in others:
        parts, before = name.split("."), other.split(".")
        shared = 0
        while shared < min(len(parts), len(before)) and parts[shared] == before[shared]:
            shared += 1
        if shared < min(len(parts), len(before)) and isinstance(layers[".".join(parts[:shared])], nn.Sequential):
            order = list(layers[".".join(parts[:shared])]._modules)
            if order.index(parts[shared]) > order.index(before[shared]):
                return True
    return False


def _unambiguous(found: Sequence[str], layers: dict[str, nn.Module], which: str) -> None:
    """Refuse layers of one module between which the width cannot decide: fc1 and fc2 of the same size."""
    for name in found:
        parent = name.rpartition(".")[0]
        beside = [n for n in found if n.rpartition(".")[0] == parent and n != name]
        square = [n for n in (name, *beside) if _square(layers[n])]
        if beside and square:
            raise TaskliftError(
                f"extend_module: {' and '.join(map(repr, sorted((name, *beside))))} could be the {which} layer by "
                f"their width; name it with {which}=[...]"
            )


def _square(layer: nn.Module) -> bool:
    return isinstance(layer, nn.Linear) and layer.in_features == layer.out_features


def _layer(layers: dict[str, nn.Module], name: str, which: str) -> nn.Module:
    if name not in layers:
        known = ", ".join(n for n in layers if n)
        raise TaskliftError(f"extend_module, {which}: the network has no layer {name!r}; it has {known}")
    return layers[name]


def _size(layer: nn.Module, name: str) -> int:
    if type(layer) not in FIRST:
        raise TaskliftError(
            f"extend_module: layer {name!r} is a {type(layer).__name__}, which cannot be widened; it can be a Linear, "
            "Embedding, LSTM, GRU or RNN"
        )
    return int(getattr(layer, FIRST[type(layer)]))


def _said(widths: Any) -> str:
    return " or ".join(f"{size} ({name})" for name, size in widths.items())
