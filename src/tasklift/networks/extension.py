"""What is kept of a network's extension, and what of its training follows by it."""

from __future__ import annotations

import copy
import inspect
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any, Literal

import numpy as np
from numpy.typing import NDArray

from tasklift.errors import TaskliftError
from tasklift.tasks.task import Task
from tasklift.tasks.variable import Variable

if TYPE_CHECKING:
    from torch import Tensor, nn
    from torch.optim import Optimizer

Encoding = Literal["one-hot", "scalar", "flat"]
Floats = NDArray[np.float64]



@dataclass(frozen=True)
class Side:
    """One side of a network: how many columns it has, and where the source task's columns lie among them.

    ``old``: for each source column its place (source columns,). ``mix``: float64 (columns, source columns), what each
    column is a copy or a mean of.
    """

    old: list[int]
    mix: Floats

    @property
    def size(self) -> int:
        """The number of columns."""
        return len(self.mix)

    @property
    def new(self) -> list[int]:
        """The columns that the source task does not have."""
        return [i for i in range(self.size) if i not in set(self.old)]


@dataclass
class Extension:
    """How a network was extended, and what else of its training can follow.

    The ``extension`` of what :func:`extend_module` returns.
    """

    source: Task
    target: Task
    encoding: Encoding
    inputs: Side
    outputs: Side
    #: parameters by name: what is done to a moment of the old shape
    places: dict[str, tuple[Side | None, Side | None]] = field(default_factory=dict)
    first: tuple[str, ...] = ()
    last: tuple[str, ...] = ()

    def observations(self, observations: Any, fill: Mapping[str, Any] | None = None) -> NDArray[Any]:
        """Return observations (…, F of the source) as the target task's (…, F of the target).

        Parameters
        ----------
        fill
            ``{variable: value}`` of inputs that the source task does not have. Default: the value at which the source
            task fixed it; of a removed input, the first.
        """
        array = np.asarray(observations)
        if self.encoding == "flat":
            # an input of the target stands for each of the source's: fixed values, first values of what was removed
            return representatives(self.source, self.target, fill or {})[array]
        if array.shape[-1:] != (len(self.inputs.old),):
            raise TaskliftError(
                f"extension: expected observations of {len(self.inputs.old)} columns (of {self.source.name!r}), "
                f"found the shape {array.shape}"
            )
        wide = np.zeros((*array.shape[:-1], self.inputs.size), dtype=array.dtype)
        kept = self.source.kept_positions(self.source.ancestor(self.target))
        ours, start = {v.name for v in self.source.inputs}, 0
        for variable in self.target.inputs:
            width = len(variable) if self.encoding == "one-hot" else 1
            if variable.name not in ours:
                position = (kept[variable.name] or (0,))[0]
                if variable.name in (fill or {}):
                    position = variable.position((fill or {})[variable.name], "extension, fill")
                if self.encoding == "one-hot":
                    wide[..., start + position] = 1
                else:
                    wide[..., start] = codes(variable)[position]
            start += width
        wide[..., self.inputs.old] = array
        return wide

    def positions(self, positions: Any, fill: Mapping[str, Any] | None = None) -> NDArray[np.int64]:
        """Return positions of values (…, variables), as of a MultiDiscrete space, as the target task's.

        Parameters
        ----------
        fill
            As of :meth:`observations`.
        """
        array = _whole(positions, [len(v) for v in self.source.inputs], "positions")
        kept = self.source.kept_positions(self.source.ancestor(self.target))
        ours = {v.name: k for k, v in enumerate(self.source.inputs)}
        wide = np.zeros((*array.shape[:-1], len(self.target.inputs)), dtype=np.int64)
        for k, variable in enumerate(self.target.inputs):
            inside = np.asarray(kept[variable.name] or (0,))
            if variable.name in ours:
                wide[..., k] = inside[array[..., ours[variable.name]]]
            elif variable.name in (fill or {}):
                wide[..., k] = variable.position((fill or {})[variable.name], "extension, fill")
            else:
                wide[..., k] = inside[0]
        return wide

    def actions(self, actions: Any) -> NDArray[Any]:
        """Return flat actions (outputs' indices) of the source task as the target's."""
        flat = _whole(np.asarray(actions)[..., None], [self.source.shape[1]], "actions")[..., 0]
        return self.source.output_columns(self.source.ancestor(self.target))[flat]

    def statistics(self, mean: Any, variance: Any) -> tuple[Floats, Floats]:
        """Return running means and variances (F,) for the target's columns: new ones begin with mean 0, variance 1."""
        for found in (mean, variance):
            if np.shape(found) != (len(self.inputs.old),):
                raise TaskliftError(
                    f"extension, statistics: expected the shape ({len(self.inputs.old)},), found {np.shape(found)}"
                )
        wide_mean, wide_variance = np.zeros(self.inputs.size), np.ones(self.inputs.size)
        wide_mean[self.inputs.old], wide_variance[self.inputs.old] = np.asarray(mean), np.asarray(variance)
        return wide_mean, wide_variance

    def optimizer(self, optimizer: Optimizer, module: nn.Module, extended: nn.Module) -> Optimizer:
        """Return an optimiser of the extended network with the old one's settings and moments; new entries have 0.

        Parameters
        ----------
        optimizer
            Of ``module``; stays as it is.
        module, extended
            The network before and after.

        Raises
        ------
        TaskliftError
            If the optimiser has parameters that are not the module's, or moments that are not of a parameter's shape
            (LBFGS, Adafactor), and if ``extended`` is not the module extended.
        """
        import torch

        if not isinstance(optimizer, torch.optim.Optimizer):
            raise TaskliftError(f"extension, optimizer: expected an optimiser, found {type(optimizer).__name__}")
        names = {id(parameter): name for name, parameter in module.named_parameters()}
        fresh = dict(extended.named_parameters())
        given = [parameter for group in optimizer.param_groups for parameter in group["params"]]
        if strange := [parameter for parameter in given if id(parameter) not in names]:
            raise TaskliftError(
                f"extension, optimizer: {len(strange)} parameters are not the module's, the first of shape "
                f"{tuple(strange[0].shape)}; give the optimiser of this module"
            )
        for name, parameter in module.named_parameters():
            wide = tuple(self._moment(name, parameter.detach()).shape)
            if name not in fresh or fresh[name].shape != wide:
                raise TaskliftError(
                    f"extension, optimizer: expected the extended network, with {name!r} of shape {wide}, found "
                    f"{tuple(fresh[name].shape) if name in fresh else 'none'}"
                )
        groups = []
        for group in optimizer.param_groups:
            groups.append({**group, "params": [fresh[names[id(p)]] for p in group["params"]]})
        settings = {k: v for k, v in optimizer.defaults.items() if k in _arguments(type(optimizer))}
        result = type(optimizer)(groups, **settings)
        for parameter, state in optimizer.state.items():
            name = names[id(parameter)]
            for key, value in state.items():
                if torch.is_tensor(value) and value.dim() and value.shape != parameter.shape and name in self.places:
                    raise TaskliftError(
                        f"extension, optimizer: {type(optimizer).__name__} keeps {key!r} of shape {tuple(value.shape)} "
                        f"for {name!r}, expected {tuple(parameter.shape)}; begin with a fresh optimiser"
                    )
            result.state[fresh[name]] = {
                key: self._moment(name, value)
                if torch.is_tensor(value) and value.shape == parameter.shape
                else copy.deepcopy(value)
                for key, value in state.items()
            }
        return result

    def _moment(self, name: str, value: Tensor) -> Tensor:
        out, into = self.places.get(name, (None, None))
        wide = value.clone()
        for axis, side in ((0, out), (1, into)):
            if side is not None:
                shape = list(wide.shape)
                shape[axis] = side.size
                wider = wide.new_zeros(shape)
                wider.index_copy_(axis, index_of(side.old, wide), wide)
                wide = wider
        return wide


def codes(variable: Variable) -> list[float]:
    """Return the numbers that stand for a variable's values in one column: the values, or else their positions."""
    if all(isinstance(value, int | float) for value in variable.values):
        return [float(value) for value in variable.values]
    return [float(position) for position in range(len(variable))]


def width(task: Task, encoding: Encoding) -> int:
    """Return the number of columns of an observation; of a flat one, the number of inputs."""
    if encoding == "flat":
        return task.shape[0]
    return sum(len(v) for v in task.inputs) if encoding == "one-hot" else len(task.inputs)


def representatives(source: Task, target: Task, fill: Mapping[str, Any]) -> NDArray[np.int64]:
    """Return, for each input of the source, the row of the target's input that stands for it."""
    ancestor = source.ancestor(target)
    kept, ours = source.kept_positions(ancestor), {v.name for v in source.inputs}
    rows = np.zeros(1, dtype=np.int64)
    for variable in ancestor.inputs:
        inside = kept[variable.name] or (0,)
        if variable.name in fill and variable.name not in ours:
            inside = (variable.position(fill[variable.name], "extension, fill"),)
        rows = np.add.outer(rows * len(variable), np.asarray(inside)).ravel()
    return rows


def _whole(values: Any, sizes: Sequence[int], what: str) -> NDArray[np.int64]:
    """Return whole numbers (…, n) from 0 to below n sizes, or refuse others."""
    array = np.asarray(values)
    fits = array.dtype.kind in "iuf" and array.shape[-1:] == (len(sizes),)
    if not fits or ((array < 0) | (array >= sizes) | (array % 1 != 0)).any():
        raise TaskliftError(
            f"extension, {what}: expected whole numbers from 0 to below {', '.join(map(str, sizes))}, found {values!r}"
        )
    return array.astype(np.int64)


def _arguments(kind: type) -> set[str]:
    """Return the names of the arguments that make an optimiser."""
    return set(inspect.signature(kind).parameters)


def index_of(positions: Sequence[int], like: Tensor) -> Tensor:
    """Return positions as an index tensor beside another tensor."""
    import torch

    return torch.tensor(list(positions), dtype=torch.long, device=like.device)
