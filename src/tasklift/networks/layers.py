"""Layers with more inputs or outputs than they had, whose old part is computed by the same calls as before.

A sum of floating-point numbers depends on its order, and a matrix product of another size may take another order. A
layer here therefore keeps its inputs in groups, the old ones first. The old group goes through the same product as
before. The products of the new groups are added to it, and are exactly 0 while their weights are. Parameters keep the
ordinary names, shapes and order, so an ordinary layer of the new size can load them.
"""

# No `from __future__ import annotations` on purpose: TorchScript reads the annotations as they stand.
import math
from collections.abc import Sequence
from typing import Any, List  # noqa: UP035  (TorchScript reads List)

import torch
from torch import Tensor, nn
from torch.nn import functional

#: Groups of positions along one side of a layer: those of each widening, in the order in which they came.
Groups = Sequence[Sequence[int]]


def groups_of(layer: nn.Module, side: str) -> list[list[int]]:
    """Return the groups of a layer's inputs (``"in"``) or outputs (``"out"``); of an ordinary layer there is one."""
    found = getattr(layer, f"{side}_groups", None)
    if found is not None:
        return [list(group) for group in found]
    names = {"in": ("in_features", "input_size", "num_features"), "out": ("out_features",)}[side]
    return [list(range(next(getattr(layer, name) for name in names if hasattr(layer, name))))]


class WiderLinear(nn.Linear):
    """A linear layer with groups of inputs and outputs; the product of each pair of groups is taken apart."""

    in_sizes: List[int]  # noqa: UP006
    out_sizes: List[int]  # noqa: UP006

    def __init__(self, in_groups: Groups, out_groups: Groups, like: nn.Linear) -> None:
        columns, rows = [i for g in in_groups for i in g], [i for g in out_groups for i in g]
        factory: Any = {"device": like.weight.device, "dtype": like.weight.dtype}
        super().__init__(len(columns), len(rows), like.bias is not None, **factory)
        self.in_groups, self.out_groups = [list(g) for g in in_groups], [list(g) for g in out_groups]
        self.in_sizes, self.out_sizes = [len(g) for g in in_groups], [len(g) for g in out_groups]
        for name, order in (("columns", columns), ("rows", rows)):
            index = torch.tensor(order, dtype=torch.long, device=like.weight.device)
            self.register_buffer(name, index, persistent=False)
            self.register_buffer(f"{name}_back", torch.argsort(index), persistent=False)

    def forward(self, input: Tensor) -> Tensor:
        """Return the outputs (…, out) of inputs (…, in)."""
        if not torch.jit.is_tracing() and input.shape[-1] != self.in_features:
            raise RuntimeError(f"expected {self.in_features} inputs, found {input.shape[-1]}")
        ordered = input.index_select(-1, self.columns)
        weight = self.weight.index_select(0, self.rows).index_select(1, self.columns)
        bias = self.bias
        found: List[Tensor] = []  # noqa: UP006
        row = 0
        for height in self.out_sizes:
            column = 0
            total = torch.empty(0)
            for number, width in enumerate(self.in_sizes):
                part = weight[row : row + height, column : column + width].contiguous()
                seen = ordered[..., column : column + width].contiguous()
                if number == 0:
                    shift = bias
                    if shift is not None:
                        shift = shift.index_select(0, self.rows[row : row + height])
                    total = functional.linear(seen, part, shift)
                else:
                    total = total + functional.linear(seen, part)
                column += width
            found.append(total)
            row += height
        return torch.cat(found, dim=-1).index_select(-1, self.rows_back)


class WiderBatchNorm(nn.BatchNorm1d):
    """A normalisation of inputs (n, in) in groups: a vectorised loop over more columns may round otherwise."""

    def __init__(self, in_groups: Groups, like: Any) -> None:
        weight = like.weight if like.affine else like.running_mean
        super().__init__(
            sum(map(len, in_groups)), like.eps, like.momentum, like.affine, like.track_running_stats,
            device=weight.device, dtype=weight.dtype,
        )  # fmt: skip
        self.in_groups = [list(g) for g in in_groups]

    def forward(self, input: Tensor) -> Tensor:
        """Return the normalised inputs."""
        result = torch.empty_like(input)
        batch = self.training or self.running_mean is None
        share = 0.0 if self.momentum is None else self.momentum
        if self.training and self.num_batches_tracked is not None:
            self.num_batches_tracked.add_(1)
            share = 1.0 / float(self.num_batches_tracked) if self.momentum is None else share
        for group in self.in_groups:
            names = ("running_mean", "running_var", "weight", "bias")
            values = [None if getattr(self, n) is None else getattr(self, n)[group] for n in names]
            mean, variance, weight, bias = values
            found = functional.batch_norm(
                input[:, group].contiguous(), mean, variance, weight, bias, batch, share, self.eps
            )
            result = result.index_copy(1, torch.tensor(group, device=input.device), found)
            if self.training and mean is not None and variance is not None:
                self.running_mean[group], self.running_var[group] = mean, variance
        return result


class _WiderRecurrent:
    """A recurrent layer with groups of inputs; its old gates come from the same product as before."""

    def __init__(self, in_groups: Groups, like: Any) -> None:
        columns = [i for group in in_groups for i in group]
        more: dict[str, Any] = {"proj_size": like.proj_size} if isinstance(like, nn.LSTM) else {}
        if isinstance(like, nn.RNN):
            more["nonlinearity"] = like.nonlinearity
        super().__init__(
            len(columns), like.hidden_size, like.num_layers, bias=like.bias, batch_first=like.batch_first,
            dropout=like.dropout, bidirectional=like.bidirectional, device=like.weight_ih_l0.device,
            dtype=like.weight_ih_l0.dtype, **more,
        )  # fmt: skip
        self.in_groups, self.in_sizes = [list(g) for g in in_groups], [len(g) for g in in_groups]
        index = torch.tensor(columns, dtype=torch.long, device=like.weight_ih_l0.device)
        self.register_buffer("columns", index, persistent=False)

    def forward(self, input: Any, hx: Any = None) -> Any:
        """Return what the ordinary layer returns; gates of new inputs are added to those of the old ones."""
        layer: Any = self
        packed = isinstance(input, nn.utils.rnn.PackedSequence)
        data = input.data if packed else input
        # the old inputs are laid out as they were, and turned over as the ordinary layer would do
        ordered = data.index_select(-1, layer.columns)
        parts = [part.contiguous() for part in ordered.split(layer.in_sizes, dim=-1)]
        turned = layer.batch_first and data.dim() == 3 and not packed
        if turned:
            parts = [part.transpose(0, 1) for part in parts]
        size, names = layer.weight_ih_l0.shape[0], [""] + (["_reverse"] if layer.bidirectional else [])
        gates, flat = [], list(layer._flat_weights)
        per_direction = len(flat) // (layer.num_layers * len(names))
        for number, name in enumerate(names):
            weight = getattr(layer, f"weight_ih_l0{name}").index_select(1, layer.columns)
            pieces = [piece.contiguous() for piece in weight.split(layer.in_sizes, dim=1)]
            bias = getattr(layer, f"bias_ih_l0{name}") if layer.bias else None
            total = functional.linear(parts[0], pieces[0], bias)
            for part, piece in zip(parts[1:], pieces[1:], strict=True):
                total = total + functional.linear(part, piece)
            gates.append(total)
            # the gates are ready: the first layer's own product only passes them on, each direction its own
            choose = torch.zeros(size, size * len(names), dtype=weight.dtype, device=weight.device)
            choose[:, number * size : (number + 1) * size] = torch.eye(size, dtype=weight.dtype, device=weight.device)
            flat[number * per_direction] = choose
            if layer.bias:
                flat[number * per_direction + 2] = torch.zeros(size, dtype=weight.dtype, device=weight.device)
        ready = torch.cat(gates, dim=-1) if len(gates) > 1 else gates[0]
        inner = _RUN[layer.mode]
        lonely = ready.dim() == 2 and not packed
        state = layer._start(ready, input if packed else None, hx, lonely)
        common = (layer.bias, layer.num_layers, layer.dropout, layer.training, layer.bidirectional)
        if packed:
            result = inner(ready, input.batch_sizes, state, flat, *common)
        else:
            result = inner(ready.unsqueeze(1) if lonely else ready, state, flat, *common, False)
        output, last = result[0], list(result[1:])
        if packed:
            output = input._replace(data=output)
            last = [layer.permute_hidden(one, input.unsorted_indices) for one in last]
        elif lonely:
            output, last = output.squeeze(1), [one.squeeze(1) for one in last]
        elif turned:
            output = output.transpose(0, 1)
        return output, tuple(last) if layer.mode == "LSTM" else last[0]

    def _start(self, ready: Tensor, packed: Any, hx: Any, lonely: bool) -> Any:
        layer: Any = self
        lstm = layer.mode == "LSTM"
        if hx is None:
            count = int(packed.batch_sizes[0]) if packed is not None else 1 if lonely else ready.shape[1]
            layers = layer.num_layers * (2 if layer.bidirectional else 1)
            sizes = [getattr(layer, "proj_size", 0) or layer.hidden_size] + [layer.hidden_size] * lstm
            start = [ready.new_zeros(layers, count, size) for size in sizes]
        else:
            start = list(hx) if lstm else [hx]
            if packed is not None:
                start = [layer.permute_hidden(one, packed.sorted_indices) for one in start]
            elif lonely:
                start = [one.unsqueeze(1) for one in start]
        return start if lstm else start[0]


class WiderLSTM(_WiderRecurrent, nn.LSTM):
    """An LSTM with groups of inputs."""

    def permute_hidden(self, hx: Any, permutation: Tensor | None) -> Any:
        """Return one state in another order of the batch."""
        return hx if permutation is None else hx.index_select(1, permutation)

    def forward(self, input: Any, hx: Any = None) -> Any:
        """Return what the ordinary layer returns.

        In float32 on a processor, the ordinary layer is one compiled call that takes the inputs as they are. There
        columns of zeros change nothing, as we measured; see decision 56.
        """
        data = input.data if isinstance(input, nn.utils.rnn.PackedSequence) else input
        if data.dtype == torch.float32 and data.device.type == "cpu" and torch.backends.mkldnn.is_available():
            ordered = data.index_select(-1, self.columns)
            own: Any = self._flat_weights
            flat = list(own)
            step = len(flat) // (self.num_layers * (2 if self.bidirectional else 1))
            for number in range(2 if self.bidirectional else 1):
                flat[number * step] = flat[number * step].index_select(1, self.columns)
            self._flat_weights = flat
            try:
                given = input._replace(data=ordered) if data is not input else ordered
                if hx is None or data is input:
                    return nn.LSTM.forward(self, given, hx)
            finally:
                self._flat_weights = own
        return _WiderRecurrent.forward(self, input, hx)


class WiderGRU(_WiderRecurrent, nn.GRU):
    """A GRU with groups of inputs."""


class WiderRNN(_WiderRecurrent, nn.RNN):
    """A plain recurrent layer with groups of inputs."""


_RUN = {"LSTM": torch._VF.lstm, "GRU": torch._VF.gru, "RNN_TANH": torch._VF.rnn_tanh, "RNN_RELU": torch._VF.rnn_relu}

#: Which class takes a layer's place, by its own class; of the layers that can be widened.
RECURRENT: dict[type, type] = {
    nn.LSTM: WiderLSTM, nn.GRU: WiderGRU, nn.RNN: WiderRNN,
    WiderLSTM: WiderLSTM, WiderGRU: WiderGRU, WiderRNN: WiderRNN,
}  # fmt: skip


class Seen:
    """Notes which states (inputs) a forward pass is about: a hook before the first layer."""

    def __init__(self) -> None:
        self.input: Tensor | None = None

    def __call__(self, layer: nn.Module, given: Any) -> None:
        """Keep the first argument of the layer."""
        self.input = given[0].data if isinstance(given[0], nn.utils.rnn.PackedSequence) else given[0]


class Decoder(nn.Module):
    """Tells where a condition over inputs holds, from what the network is given.

    ``encoding``: see :func:`tasklift.networks.extend.extend_module`. ``allowed``: for each variable of the condition,
    its first column, the numbers that code its values, and which values are allowed.
    """

    def __init__(self, encoding: str, allowed: Sequence[tuple[int, list[float], list[bool]]], table: Any) -> None:
        super().__init__()
        self.encoding, self.starts, self.sizes = encoding, [a[0] for a in allowed], [len(a[1]) for a in allowed]
        for number, (_, codes, mask) in enumerate(allowed):
            self.register_buffer(f"codes_{number}", torch.tensor(codes, dtype=torch.float64), persistent=False)
            self.register_buffer(f"mask_{number}", torch.tensor(mask), persistent=False)
        self.register_buffer("table", torch.as_tensor(table), persistent=False)

    def forward(self, input: Tensor) -> Tensor:
        """Return bool (…,): where the condition holds."""
        if self.encoding == "flat":
            return self.table[input.long()]
        holds = torch.ones(input.shape[:-1], dtype=torch.bool, device=input.device)
        for number, (start, size) in enumerate(zip(self.starts, self.sizes, strict=True)):
            mask = getattr(self, f"mask_{number}")
            if self.encoding == "one-hot":
                position = input[..., start : start + size].argmax(-1)
            else:
                codes = getattr(self, f"codes_{number}")
                position = (input[..., start].unsqueeze(-1) - codes).abs().argmin(-1)
            holds = holds & mask[position]
        return holds


class Knowledge(nn.Module):
    """Prior knowledge behind the last layer: a fixed operation on its outputs where a condition holds.

    ``logits``: the outputs are logarithms of weights, and the operation is that on weights; else it is on the outputs.
    """

    def __init__(self, operation: str, where: Decoder, columns: Sequence[int], logits: bool, **rest: Any) -> None:
        super().__init__()
        self.operation, self.where, self.logits = operation, where, logits
        self.factor, self.value = rest.get("factor", 1.0), rest.get("value", 0.0)
        self.log_count = math.log(len(rest["alike"][0])) if "alike" in rest else 0.0
        chosen = torch.zeros(rest["outputs"], dtype=torch.bool)
        chosen[list(columns)] = True
        self.register_buffer("chosen", chosen, persistent=False)
        for name in ("swapped", "alike"):
            if name in rest:
                self.register_buffer(name, torch.as_tensor(rest[name], dtype=torch.long), persistent=False)

    def forward(self, seen: Tensor, output: Tensor) -> Tensor:
        """Return the outputs (…, A), changed where the condition holds for what was seen (…, in)."""
        holds = self.where(seen).reshape(-1)
        flat = output.reshape(-1, output.shape[-1])
        if not torch.jit.is_tracing() and holds.shape[0] != flat.shape[0]:
            raise RuntimeError(
                f"tasklift: prior knowledge saw {holds.shape[0]} states and {flat.shape[0]} rows of outputs; call the "
                "network's layers on the same batch"
            )
        return torch.where(holds.unsqueeze(-1) & self.chosen, self._changed(flat), flat).reshape(output.shape)

    def _changed(self, flat: Tensor) -> Tensor:
        if self.operation == "swap":
            return flat.index_select(-1, self.swapped)
        if self.operation == "forget":
            alike = flat[:, self.alike]
            if not self.logits:
                return alike.mean(-1)
            return alike.logsumexp(-1) - self.log_count
        if self.operation == "invert":
            low = flat.masked_fill(~self.chosen, float("inf")).amin(-1, keepdim=True)
            high = flat.masked_fill(~self.chosen, float("-inf")).amax(-1, keepdim=True)
            if not self.logits:
                return low + high - flat
            least = torch.exp(low - high)
            return high + torch.log((1 + least - torch.exp(flat - high)).clamp_min(least))
        if self.operation == "scale":
            return flat + _log(self.factor) if self.logits else flat * self.factor
        return torch.full_like(flat, _log(self.value) if self.logits else self.value)


class Corrected:
    """Applies prior knowledge to the last layer's outputs: a hook behind it."""

    def __init__(self, seen: Seen, steps: Sequence[Knowledge]) -> None:
        self.seen, self.steps = seen, nn.ModuleList(steps)

    def __call__(self, layer: nn.Module, given: Any, output: Tensor) -> Tensor:
        """Return the outputs with all prior knowledge applied, in order."""
        self.steps.to(output.device)
        if self.seen.input is not None:
            for step in self.steps:
                output = step(self.seen.input, output)
        return output


def _log(weight: float) -> float:
    """Return the logit of a weight; of weight 0, one that is never drawn."""
    return math.log(weight) if weight > 0 else -1e4
