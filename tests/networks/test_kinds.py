"""Networks of many kinds: each is extended exactly, or refused by a layer's name, with nothing changed."""

from __future__ import annotations

import numpy as np
import pytest
from test_extend import FULL, SOURCE, mlp, observations, wide_of

from tasklift.errors import TaskliftError
from tasklift.networks.extension import width
from tasklift.tasks.policy import swap

torch = pytest.importorskip("torch")
from torch import nn, optim  # noqa: E402
from torch.nn.utils import parametrizations, prune  # noqa: E402

from tasklift.networks.extend import extend_module  # noqa: E402

pytestmark = pytest.mark.filterwarnings("ignore")  # of parts of torch that are deprecated and still used
COLUMNS, OUTPUTS = width(SOURCE, "one-hot"), SOURCE.shape[1]


def net(first=None, last=None, middle=(), behind=()):
    torch.manual_seed(0)
    ends = first or nn.Linear(COLUMNS, 16), last or nn.Linear(16, OUTPUTS)
    return nn.Sequential(ends[0], nn.Tanh(), *middle, ends[1], *behind)


class Own(nn.Module):
    """A network by a function of its parts: ``Own(lambda net, x: …, enc=…, head=…)``."""

    def __init__(self, run, **parts) -> None:
        super().__init__()
        self.run = run
        for name, part in parts.items():
            setattr(self, name, part)

    def forward(self, x):
        return self.run(self, x)


def shared():
    """Return a network whose first layer has three names."""
    enc = nn.Linear(COLUMNS, 16)
    actor, critic = (nn.Sequential(enc, nn.Tanh(), nn.Linear(16, n)) for n in (OUTPUTS, 1))
    return Own(lambda net, x: net.actor(x) + net.critic(x), enc=enc, actor=actor, critic=critic)


def tied():
    made = net(nn.Linear(COLUMNS, OUTPUTS), nn.Linear(OUTPUTS, OUTPUTS), (nn.Linear(OUTPUTS, COLUMNS), nn.Tanh()))
    made[2].weight = nn.Parameter(made[0].weight.T.clone())
    return Own(lambda own, x: own.net(x) + own.twin(x), net=made, twin=twin_of(made[4]))


def twin_of(layer):
    made = nn.Linear(layer.in_features, layer.out_features)
    made.weight = layer.weight
    return made


def dueling():
    def run(own, x):
        advantage = own.advantage(own.body(x))
        return own.value(own.body(x)) + advantage - advantage.mean(-1, keepdim=True)

    parts = {"advantage": nn.Linear(16, OUTPUTS), "value": nn.Linear(16, 1)}
    return Own(run, body=nn.Sequential(nn.Linear(COLUMNS, 16), nn.Tanh()), **parts)


def hooked():
    made = net()
    made[0].register_forward_hook(lambda layer, given, output: output * 2)
    return made


def normalised(*names):
    made = Own(lambda own, x: own.net((x - getattr(own, names[0])) / getattr(own, names[1])), net=net())
    for name in names:
        made.register_buffer(name, torch.rand(COLUMNS) + 0.5)
    return made


def compiled():
    made = net()
    made.compile(backend="eager")
    return made


EXACT = {
    "one layer": lambda: nn.Linear(COLUMNS, OUTPUTS),
    "a first layer with three names": shared,
    "hooks": hooked,
    "a compiled network": lambda: torch.compile(net(), backend="eager"),
    "compiled in place": compiled,
    "DataParallel": lambda: nn.DataParallel(net()),
    "weight norm inside": lambda: net(middle=[parametrizations.weight_norm(nn.Linear(16, 16))]),
    "running statistics": lambda: normalised("running_mean", "running_std"),
    "a BatchNorm of its own": lambda: Own(lambda own, x: own.net(own.norm(x)), norm=nn.BatchNorm1d(COLUMNS), net=net()),
    "dropout": lambda: net(middle=[nn.Dropout(0.5)]),
}


@pytest.mark.parametrize("kind", EXACT)
@pytest.mark.parametrize("dtype", [torch.float64, torch.float16])
def test_kinds_that_are_extended_exactly(kind, dtype) -> None:
    module = EXACT[kind]().to(dtype).eval()
    wide = extend_module(module, SOURCE, FULL, new_actions="copied").eval()
    x = observations(SOURCE, "one-hot", 20, dtype)
    assert torch.equal(wide(wide_of(wide.extension, x))[:, wide.extension.outputs.old], module(x))


def past():
    """Return a network that also passes the input on to its last layer."""
    parts = {"first": nn.Linear(COLUMNS, 16), "last": nn.Linear(22, OUTPUTS)}
    return Own(lambda own, x: own.last(torch.cat([own.first(x), x], -1)), **parts)


def scaled():
    return Own(lambda own, x: own.net(x * own.by), net=net(), by=nn.Parameter(torch.ones(COLUMNS)))


REFUSED = {
    "weight norm first": (lambda: net(parametrizations.weight_norm(nn.Linear(COLUMNS, 16))), "'0' 6 .*Parametrized"),
    "weight norm last": (lambda: net(None, parametrizations.weight_norm(nn.Linear(16, OUTPUTS))), "'2' 8 .*Parametriz"),
    "the older weight norm": (lambda: net(nn.utils.weight_norm(nn.Linear(COLUMNS, 16))), "'0' 6 .*other parameters"),
    "pruned": (lambda: net(prune.l1_unstructured(nn.Linear(COLUMNS, 16), "weight", 0.5)), "'0' 6 .*other parameters"),
    "a convolution": (lambda: net(nn.Conv1d(COLUMNS, 16, 1)), "'0' 6 .is a Conv1d"),
    "a cell": (lambda: net(nn.GRUCell(COLUMNS, 16)), "'0' 6 .is a GRUCell"),
    "lazy": (lambda: net(nn.LazyLinear(16)), "'0' .LazyLinear. has no shape yet"),
    "lazy inside": (lambda: net(middle=[nn.LazyBatchNorm1d()]), "'2' .LazyBatchNorm1d. has no shape yet"),
    "without values": (lambda: net().to("meta"), "'0' is on the device 'meta'"),
    "shares a parameter": (tied, "'net.4' and 'twin' share a parameter"),
    "softmax": (lambda: net(behind=[nn.Softmax(-1)]), "'3' .Softmax. mixes columns"),
    "PReLU": (lambda: net(behind=[nn.PReLU(OUTPUTS)]), "'3' .PReLU. does not fit"),
    "dueling": (dueling, r"the network \(Own\) mixes columns"),
    "other statistics": (lambda: normalised("mu", "sigma"), r"its 'mu' has the shape \(6,\); expected .* 12 inputs"),
    "a scale for each column": (scaled, r"its 'by' has the shape \(6,\)"),
    "a shape within": (lambda: nn.Sequential(nn.Unflatten(1, (2, 3)), nn.Flatten(), *net()), "'0' .Unflatten. does"),
    "the input goes past": (past, "'last' .Linear. does not fit .*expected 22 inputs, found 28"),
    "of another task": (lambda: mlp(COLUMNS + 1, OUTPUTS), "expected 6 .one-hot. .* found '0' 7"),
    "has a prior": (lambda: extend_module(net(), SOURCE, SOURCE, [swap("x", (0, 2))]), "'2' has prior knowledge"),
}


@pytest.mark.parametrize("kind", REFUSED)
def test_kinds_that_are_refused_with_nothing_changed(kind) -> None:
    make, says = REFUSED[kind]
    module = make()
    before = repr(module), [tuple(p.shape) for p in module.parameters() if not nn.parameter.is_lazy(p)]
    with pytest.raises(TaskliftError, match=says):
        extend_module(module, SOURCE, FULL)
    assert (repr(module), [tuple(p.shape) for p in module.parameters() if not nn.parameter.is_lazy(p)]) == before


OPTIMISERS = {
    "SGD": {"lr": 0.01, "momentum": 0.9, "nesterov": True}, "RMSprop": {"centered": True, "momentum": 0.5},
    "AdamW": {"amsgrad": True}, "Adagrad": {}, "Adadelta": {}, "NAdam": {}, "Rprop": {},
}  # fmt: skip


@pytest.mark.parametrize("kind", OPTIMISERS)
def test_the_next_step_is_the_same_with_optimisers_of_many_kinds(kind) -> None:
    module, x = mlp(COLUMNS, OUTPUTS), observations(SOURCE, "one-hot", 30)
    optimizer = getattr(optim, kind)(module.parameters(), **OPTIMISERS[kind])

    def step(network, optimizer, seen, columns):
        optimizer.zero_grad()
        network(seen)[:, columns].square().sum().backward()
        optimizer.step()

    for _ in range(3):
        step(module, optimizer, x, slice(None))
    wide = extend_module(module, SOURCE, FULL)
    ours = wide.extension.optimizer(optimizer, module, wide)
    step(module, optimizer, x, slice(None))
    step(wide, ours, wide_of(wide.extension, x), wide.extension.outputs.old)
    for old, new, columns in ((module[0], wide[0], wide.extension.inputs.old), (module[2], wide[2], slice(None))):
        assert torch.allclose(new.weight[:, columns], old.weight, rtol=0, atol=1e-9)


def test_what_does_not_belong_to_the_network_is_refused() -> None:
    module = mlp(COLUMNS, OUTPUTS)
    wide = extend_module(module, SOURCE, FULL)
    follow, adam = wide.extension, optim.Adam(module.parameters())
    factored = optim.LBFGS(module.parameters())
    factored.step(lambda: (module(observations(SOURCE, "one-hot", 5)).sum().backward(), torch.tensor(0.0))[1])
    for call, says in (
        (lambda: follow.optimizer(factored, module, wide), "LBFGS keeps .* for '0.weight', expected .64, 6."),
        (lambda: follow.optimizer(adam, wide, module), "6 parameters are not the module's"),
        (lambda: follow.optimizer(adam, module, module), r"with '0.weight' of shape \(64, 12\), found \(64, 6\)"),
        (lambda: follow.optimizer(adam.state_dict(), module, wide), "expected an optimiser, found dict"),
        (lambda: follow.statistics(np.zeros(5), np.ones(5)), r"expected the shape \(6,\), found \(5,\)"),
        (lambda: follow.actions([8]), "from 0 to below 8"),
        (lambda: follow.actions([0.5]), "from 0 to below 8"),
        (lambda: follow.positions([[3, 0]]), "from 0 to below 3, 3"),
        (lambda: follow.positions([[0]]), "from 0 to below 3, 3"),
    ):
        with pytest.raises(TaskliftError, match=says):
            call()
