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
    _present(layers)
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
    for name in (*plan.first, *plan.last):
        _alone(layers, name)
    columns = width(source, plan.encoding)
    if plan.encoding != "flat":
        for name, layer in layers.items():
            if (
                isinstance(layer, nn.BatchNorm1d)
                and layer.num_features == columns
                and (_leads(name, plan.first) or not _given(layers, columns))
            ):
                plan.normalised.append(name)
        for name, buffer in module.named_buffers():
            owner, _, called = name.rpartition(".")
            if isinstance(layers[owner], nn.modules.batchnorm._NormBase) or not buffer.dim():
                continue
            if buffer.shape[-1] == columns and any(word in called for word in ("mean", "var", "std")):
                plan.statistics.append(name)
    return plan


def _present(layers: dict[str, nn.Module]) -> None:
    """Refuse parameters and buffers without values."""
    for name, layer in layers.items():
        for tensor in (*layer._parameters.values(), *layer._buffers.values()):
            if nn.parameter.is_lazy(tensor):
                raise TaskliftError(
                    f"extend_module: layer {name!r} ({type(layer).__name__}) has no shape yet; run the network once"
                )
            if tensor is not None and tensor.is_meta:
                raise TaskliftError(
                    f"extend_module: layer {name!r} is on the device 'meta', without values; load them first"
                )


def _alone(layers: dict[str, nn.Module], name: str) -> None:
    """Refuse a layer that cannot be widened for itself."""
    if hasattr(layers[name], "prior_knowledge"):
        raise TaskliftError(
            f"extend_module: layer {name!r} has prior knowledge of an earlier extension, which cannot be widened; "
            "extend without a prior before, and give all of it in the last extension"
        )
    own = {id(parameter) for parameter in layers[name].parameters()}
    for other, layer in layers.items():
        if layer is not layers[name] and not own.isdisjoint(id(p) for p in layer._parameters.values()):
            raise TaskliftError(
                f"extend_module: layers {name!r} and {other!r} share a parameter, which cannot fit both once one is "
                "wider; give each its own"
            )


def _ordinary(layer: nn.Module) -> bool:
    """Return whether a layer can be widened: its weights are parameters, and not made of others."""
    return type(layer) in FIRST and not {"weight", "weight_ih_l0"}.isdisjoint(layer._parameters)


def _leads(name: str, first: Sequence[str]) -> bool:
    """Return whether a layer stands before a first layer, in the same container."""
    parent, _, at = name.rpartition(".")
    for one in first:
        there, _, place = one.rpartition(".")
        if there == parent and at.isdigit() and place.isdigit() and int(at) < int(place):
            return True
    return False


def _given(layers: dict[str, nn.Module], columns: int) -> bool:
    """Return whether some layer's output has this width."""
    return any(columns in (getattr(o, "out_features", 0), getattr(o, "hidden_size", 0)) for o in layers.values())


def _known(layers: dict[str, nn.Module]) -> dict[str, list[str]]:
    """Return the layers of a Stable-Baselines3 actor-critic, whose parts have fixed names."""
    if "action_net" not in layers or "mlp_extractor" not in layers:
        return {}
    known = {"last": ["action_net"]}
    if not any(name.startswith("features_extractor.") and [*layer.parameters()] for name, layer in layers.items()):
        heads = {"mlp_extractor.policy_net.0": "action_net", "mlp_extractor.value_net.0": "value_net"}
        known["first"] = [name if name in layers else head for name, head in heads.items()]
    return known


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
        found = [n for n, layer in layers.items() if type(layer) in kinds and _ordinary(layer)]
        found = [n for n in found if _size(layers[n], n) == expected]
        found = [n for n in found if not _follows(n, found, layers)]
        if found:
            _unambiguous(found, layers, "first")
            return encoding, found
    there = _listed(layers, ("in_features", "num_embeddings", "input_size", "in_channels"), fits)
    raise TaskliftError(
        f"extend_module: no layer has the inputs of {source.name!r}: expected {_said(fits)}; "
        f"found {there or 'no layer that can be widened'}; name the layers with first="
    )


def _last(layers: dict[str, nn.Module], heads: dict[str, int], names: Sequence[str] | None) -> tuple[str, list[str]]:
    if names is not None:
        sizes = {n: getattr(_layer(layers, n, "last"), "out_features", None) for n in names}
        for head, expected in heads.items():
            if all(size == expected and _ordinary(layers[n]) for n, size in sizes.items()):
                return head, list(names)
        name = next((n for n, size in sizes.items() if size not in heads.values()), names[0])
        found = f"has {sizes[name]} outputs" if _ordinary(layers[name]) else _unfit(layers[name])
        raise TaskliftError(f"extend_module: layer {name!r} {found}; expected {_said(heads)}")
    for head, expected in heads.items():
        some = [n for n, layer in layers.items() if type(layer) in (nn.Linear, WiderLinear) and _ordinary(layer)]
        fit = [n for n in some if getattr(layers[n], "out_features", 0) == expected]
        fit = [n for n in fit if not any(_follows(later, [n], layers) for later in some if later != n)]
        if fit:
            _unambiguous(fit, layers, "last")
            return head, fit
    raise TaskliftError(
        f"extend_module: no layer has the outputs: expected {_said(heads)}; "
        f"found {_listed(layers, ('out_features',), heads)}; name the layers with last="
    )


def _listed(layers: dict[str, nn.Module], attributes: Sequence[str], fits: Any) -> str:
    """Return some layers with their widths, those of a width expected first."""
    widths = {name: [getattr(layer, a) for a in attributes if hasattr(layer, a)] for name, layer in layers.items()}
    names = sorted((n for n in widths if widths[n]), key=lambda n: widths[n][0] not in fits.values())[:4]
    notes = {n: "" if _ordinary(layers[n]) else f" ({_unfit(layers[n])})" for n in names}
    return ", ".join(f"{n!r} {widths[n][0]}{note}" for n, note in notes.items())


def _unfit(layer: nn.Module) -> str:
    made = ", whose weight is made of other parameters," if type(layer) in FIRST else ", which"
    return f"is a {type(layer).__name__}{made} cannot be widened"


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
    if not _ordinary(layer):
        raise TaskliftError(
            f"extend_module: layer {name!r} {_unfit(layer)}; it can be a Linear, Embedding, LSTM, GRU or RNN"
        )
    return int(getattr(layer, FIRST[type(layer)]))


def _said(widths: Any) -> str:
    return " or ".join(f"{size} ({name})" for name, size in widths.items())
