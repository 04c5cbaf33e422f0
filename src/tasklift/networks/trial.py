"""A widened network runs beside its source before it is handed out: no rule about layers knows every network."""

from __future__ import annotations

import copy
import sys
from contextlib import nullcontext
from typing import Any

import torch
from torch import Tensor, nn

from tasklift.errors import TaskliftError
from tasklift.networks.extension import Extension


def compare(module: nn.Module, wide: nn.Module, extension: Extension) -> None:
    """Run copies of both networks on inputs of the source task, and refuse a network whose outputs change.

    A network that does not take one tensor, such as an agent with methods of its own, is run in parts: those that hold
    a first layer. What does not run on the source task's inputs is not compared.

    Raises
    ------
    TaskliftError
        Names the first layer whose outputs change, or that fails on the wider columns.
    """
    given = _inputs(module, extension)
    # NumPy does not know every kind of number that torch does
    plain = given.double() if given.is_floating_point() else given
    wider = torch.as_tensor(extension.observations(plain.cpu())).to(given)
    for part in ("", *(name for name, _ in module.named_children())):
        if part and not any(f"{first}.".startswith(f"{part}.") for first in extension.first):
            continue
        before, failed = _run(module.get_submodule(part), given)
        if failed is not None:
            continue
        after, failed = _run(wide.get_submodule(part), wider)
        if failed is not None:
            layer, error = failed
            reason = str(error).partition("\n")[0] or type(error).__name__
            raise _refusal(module, part, layer, extension, f"does not fit the wider layers ({reason})")
        for layer, output in before.items():
            if not _same(output, after.get(layer), extension):
                raise _refusal(module, part, layer, extension, "mixes columns, so new ones change its outputs")
        if not part:
            return


def _inputs(module: nn.Module, extension: Extension) -> Tensor:
    """Return random observations, (n, F), of a flat input (n,); n is not the number of outputs."""
    like = next(module.get_submodule(extension.first[0]).parameters())
    n, chance = (3 if len(extension.outputs.old) != 3 else 4), torch.Generator().manual_seed(0)
    if extension.encoding == "flat":
        return torch.randint(extension.source.shape[0], (n,), generator=chance).to(like.device)
    return torch.rand(n, len(extension.inputs.old), generator=chance).to(like)


def _run(network: nn.Module, given: Tensor) -> tuple[dict[str, Any], tuple[str, Exception] | None]:
    """Return the outputs of all layers in the order in which they are ready, and which layer failed, if one did."""
    network = copy.deepcopy(network, passing(network)).eval()
    active: list[str] = []
    outputs: dict[str, Any] = {}

    def watch(name: str, part: nn.Module) -> None:
        part.register_forward_pre_hook(lambda *_: active.append(name), prepend=True)
        part.register_forward_hook(lambda _, __, output: outputs.update({active.pop(): output}))

    for name, part in network.named_modules():
        watch(name, part)
    # a compiled network is not compiled for this
    compiled = "torch._dynamo" in sys.modules and hasattr(torch.compiler, "set_stance")
    eager = torch.compiler.set_stance("force_eager") if compiled else nullcontext()
    with eager, torch.no_grad(), torch.random.fork_rng(devices=[]):
        torch.default_generator.manual_seed(0)
        try:
            network(given)
        except Exception as error:  # other people's networks raise anything
            return outputs, (active[-1] if active else "", error)
    return outputs, None


def passing(module: nn.Module) -> dict[int, Any]:
    """Return, for deepcopy, what the last forward pass left in a network: it is not copied."""
    left: dict[int, Any] = {}
    for part in module.modules():
        left |= {id(v): None for v in vars(part).values() if getattr(v, "grad_fn", None) is not None}
        if hasattr(chosen := vars(part).get("action_dist"), "distribution"):
            left[id(chosen.distribution)] = None
    return left


def _same(narrow: Any, wider: Any, extension: Extension) -> bool:
    """Return whether outputs agree where they can be compared; in float64 to the bit."""
    if isinstance(narrow, tuple | list) and isinstance(wider, tuple | list):
        # one of several may tell the probability of a choice, which new outputs share
        pairs = zip(narrow, wider, strict=False)
        return all(_same(one, other, extension) for one, other in pairs if _shape(one) != _shape(other))
    if not (torch.is_tensor(narrow) and torch.is_tensor(wider) and narrow.is_floating_point() and narrow.dim()):
        return True
    for side in (extension.outputs, extension.inputs):
        if narrow.shape[-1] == len(side.old) and wider.shape[-1] == side.size:
            wider = wider[..., side.old]
            break
    if wider.shape != narrow.shape:
        return True
    near = 0.0 if narrow.dtype == torch.float64 else 16 * torch.finfo(narrow.dtype).eps
    return torch.allclose(wider, narrow, rtol=near, atol=near, equal_nan=True)


def _shape(output: Any) -> Any:
    return getattr(output, "shape", None)


def _refusal(module: nn.Module, part: str, layer: str, extension: Extension, why: str) -> TaskliftError:
    name = ".".join(one for one in (part, layer) if one)
    found, inputs, outputs = module.get_submodule(name), extension.inputs, extension.outputs
    narrow = [
        f"; its {key!r} has the shape {tuple(value.shape)}"
        for key, value in {**found._parameters, **found._buffers, **vars(found)}.items()
        if torch.is_tensor(value) and value.shape[-1:] in ((len(inputs.old),), (len(outputs.old),))
    ]
    return TaskliftError(
        f"extend_module: {f'layer {name!r}' if name else 'the network'} ({type(found).__name__}) {why}"
        f"{''.join(narrow[:1])}; expected what takes {inputs.size} inputs in place of {len(inputs.old)} and "
        f"{outputs.size} outputs in place of {len(outputs.old)}, each for itself"
    )
