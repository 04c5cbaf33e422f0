"""Networks for a larger task: the same numbers on the source's inputs, whatever the layers; priors as on tables."""

from __future__ import annotations

import io

import numpy as np
import pytest
from test_task import paper_task

from tasklift.building.search import search_and_clear, search_only
from tasklift.errors import TaskliftError
from tasklift.tasks.policy import Policy, forget, invert, scale, set_weight, swap
from tasklift.tasks.task import Task, Variable

torch = pytest.importorskip("torch")
from torch import nn  # noqa: E402

from tasklift.networks.extend import extend_module  # noqa: E402
from tasklift.networks.extension import width  # noqa: E402

FULL = Task(
    "full",
    (Variable("a", (0, 1, 2)), Variable("b", (-1.0, 0.5, 2.0, 3.0)), Variable("c", (0, 1)), Variable("d", (5, 6, 7))),
    (Variable("x", (0, 1, 2)), Variable("y", (0, 1, 2, 3))),
)
# TorchScript is deprecated in the newest releases and still used
pytestmark = pytest.mark.filterwarnings(r"ignore:.*torch\.jit:FutureWarning", r"ignore:.*torch\.jit:DeprecationWarning")
#: a removed, b restricted, c fixed; x restricted, y kept: new columns before, between and after the old ones
SOURCE = FULL.simplify(remove=["a"], restrict={"b": [-1.0, 2.0, 3.0], "x": [0, 2]}, fix={"c": 1})
INPUTS_ONLY = FULL.simplify(remove=["a"], restrict={"b": [-1.0, 2.0, 3.0]}, fix={"c": 1})


def observations(task: Task, encoding: str, n: int, dtype=torch.float64, seed: int = 0):
    rng = np.random.default_rng(seed)
    positions = np.stack([rng.integers(len(v), size=n) for v in task.inputs], axis=1)
    if encoding == "one-hot":
        array = np.hstack([np.eye(len(v))[positions[:, k]] for k, v in enumerate(task.inputs)])
        array *= rng.random(array.shape) + 0.5  # as after normalisation: any numbers
    else:
        array = rng.normal(size=(n, len(task.inputs))) * 10
    return torch.tensor(array, dtype=dtype)


def mlp(columns: int, outputs: int, dtype=torch.float64, hidden: int = 64):
    torch.manual_seed(1)
    layers = [nn.Linear(columns, hidden), nn.Tanh(), nn.Linear(hidden, hidden), nn.ReLU(), nn.Linear(hidden, outputs)]
    return nn.Sequential(*layers).to(dtype)


def wide_of(extension, x):
    return torch.as_tensor(extension.observations(x.numpy()))


@pytest.mark.parametrize("dtype", [torch.float64, torch.float32])
@pytest.mark.parametrize("encoding", ["one-hot", "scalar"])
@pytest.mark.parametrize("n", [1, 3, 1000])
def test_outputs_are_the_same_bits(dtype, encoding, n) -> None:
    net = mlp(width(SOURCE, encoding), SOURCE.shape[1], dtype)
    wide = extend_module(net, SOURCE, FULL, encoding=encoding)
    x = observations(SOURCE, encoding, n, dtype)
    old = wide.extension.outputs.old
    assert torch.equal(wide(wide_of(wide.extension, x))[:, old], net(x))
    assert wide(wide_of(wide.extension, x)).argmax(1).tolist() == [old[i] for i in net(x).argmax(1)]
    again = extend_module(wide, FULL, FULL)
    assert torch.equal(again(wide_of(wide.extension, x))[:, old], net(x))


def test_twice_extended_has_the_same_bits_still() -> None:
    middle = FULL.simplify(fix={"c": 1})
    simple = middle.simplify(remove=["a"], restrict={"b": [-1.0, 2.0]})
    net = mlp(width(simple, "one-hot"), simple.shape[1])
    one = extend_module(net, simple, middle, encoding="one-hot")
    two = extend_module(one, middle, FULL, encoding="one-hot")
    x = observations(simple, "one-hot", 500)
    assert torch.equal(two(wide_of(two.extension, wide_of(one.extension, x))), net(x))


@pytest.mark.slow
@pytest.mark.parametrize("dtype", [torch.float64, torch.float32])
def test_outputs_are_the_same_bits_over_a_million_inputs(dtype) -> None:
    net = mlp(width(SOURCE, "one-hot"), SOURCE.shape[1], dtype)
    wide = extend_module(net, SOURCE, FULL)
    x = observations(SOURCE, "one-hot", 1_000_000, dtype)
    with torch.no_grad():
        for size in (1, 7, 64, 1000, 999_000):
            part = x[:size]
            assert torch.equal(wide(wide_of(wide.extension, part))[:, wide.extension.outputs.old], net(part))


class Recurrent(nn.Module):
    def __init__(self, cell, columns, outputs, **more) -> None:
        super().__init__()
        self.rnn = cell(columns, 32, **more)
        self.head = nn.Linear(32 * (2 if more.get("bidirectional") else 1), outputs)

    def forward(self, x, state=None):
        y, state = self.rnn(x, state)
        return self.head(y), state


@pytest.mark.parametrize("dtype", [torch.float64, torch.float32])
@pytest.mark.parametrize("cell", [nn.LSTM, nn.GRU, nn.RNN])
@pytest.mark.parametrize(
    "more", [{}, {"num_layers": 2, "batch_first": True}, {"bidirectional": True}, {"bias": False}], ids=str
)
@pytest.mark.parametrize("shape", [(5, 3), (1, 1), (20, 40)])
def test_recurrent_first_layers(dtype, cell, more, shape) -> None:
    torch.manual_seed(2)
    net = Recurrent(cell, width(SOURCE, "one-hot"), SOURCE.shape[1], **more).to(dtype)
    wide = extend_module(net, SOURCE, FULL, encoding="one-hot")
    x = observations(SOURCE, "one-hot", shape[0] * shape[1], dtype).reshape(*shape, -1)
    (ours, state), (theirs, other) = net(x), wide(wide_of(wide.extension, x))
    assert torch.equal(theirs[..., wide.extension.outputs.old], ours)
    states = (state, other) if cell is nn.LSTM else ([state], [other])
    assert all(torch.equal(a, b) for a, b in zip(*states, strict=True))
    ours, _ = net(x, state)
    theirs, _ = wide(wide_of(wide.extension, x), other)
    assert torch.equal(theirs[..., wide.extension.outputs.old], ours)
    theirs.sum().backward()
    assert wide.rnn.weight_ih_l0.grad[:, wide.extension.inputs.new].abs().sum() > 0


def test_embeddings_of_the_input() -> None:
    net = nn.Sequential(nn.Embedding(SOURCE.shape[0], 16), nn.Linear(16, 32), nn.ReLU(), nn.Linear(32, 8))
    wide = extend_module(net, SOURCE, FULL)
    x = torch.arange(SOURCE.shape[0])
    assert torch.equal(wide(torch.as_tensor(wide.extension.observations(x)))[:, wide.extension.outputs.old], net(x))
    # what was removed leads to the same row: the network's copy is the table's
    rows = torch.as_tensor(SOURCE.input_rows(FULL))
    met = rows >= 0
    every = wide(torch.arange(FULL.shape[0]))[met][:, wide.extension.outputs.old]
    assert torch.equal(every, net(rows[met]))


class Agent(nn.Module):
    """An agent as CleanRL writes them: separate networks, and methods besides forward."""

    def __init__(self, columns: int, outputs: int) -> None:
        super().__init__()
        self.critic = nn.Sequential(nn.Linear(columns, 64), nn.Tanh(), nn.Linear(64, 64), nn.Tanh(), nn.Linear(64, 1))
        self.actor = nn.Sequential(nn.Linear(columns, 64), nn.Tanh(), nn.Linear(64, outputs))

    def get_value(self, x):
        return self.critic(x)

    def get_logits(self, x):
        return self.actor(x)


class Shared(nn.Module):
    def __init__(self, columns: int, outputs: int) -> None:
        super().__init__()
        self.network = nn.Sequential(nn.Linear(columns, 64), nn.Tanh(), nn.Linear(64, 64), nn.Tanh())
        self.actor, self.critic = nn.Linear(64, outputs), nn.Linear(64, 1)

    def get_value(self, x):
        return self.critic(self.network(x))

    def get_logits(self, x):
        return self.actor(self.network(x))


@pytest.mark.parametrize("agent", [Agent, Shared])
@pytest.mark.parametrize("head", ["flat", "factored"])
def test_agents_with_shared_and_separate_heads(agent, head) -> None:
    net = agent(width(SOURCE, "one-hot"), SOURCE.shape[1] if head == "flat" else 6)
    wide = extend_module(net, SOURCE, FULL, head=head)
    x = observations(SOURCE, "one-hot", 50, torch.float32)
    seen = wide_of(wide.extension, x)
    assert torch.equal(wide.get_value(seen), net.get_value(x))
    assert torch.equal(wide.get_logits(seen)[:, wide.extension.outputs.old], net.get_logits(x))
    assert wide.get_logits(seen).shape[1] == (12 if head == "flat" else 7)


def test_the_result_is_an_ordinary_module(tmp_path) -> None:
    net = mlp(width(SOURCE, "one-hot"), SOURCE.shape[1])
    wide = extend_module(net, SOURCE, FULL)
    x = wide_of(wide.extension, observations(SOURCE, "one-hot", 20))
    x[:, wide.extension.inputs.new] = 0.3
    plain = mlp(width(FULL, "one-hot"), FULL.shape[1])
    plain.load_state_dict(wide.state_dict())  # ordinary names and shapes
    assert torch.allclose(plain(x), wide(x), rtol=0, atol=1e-12)
    wide(x).square().sum().backward()
    assert all(p.grad is not None and p.grad.abs().sum() > 0 for p in wide.parameters())
    assert torch.equal(torch.jit.script(wide)(x), wide(x))
    saved = io.BytesIO()
    torch.save(wide, saved)
    saved.seek(0)
    assert torch.equal(torch.load(saved, weights_only=False)(x), wide(x))


def test_it_leaves_as_onnx() -> None:
    pytest.importorskip("onnxscript")
    from onnx.reference import ReferenceEvaluator

    net = mlp(width(SOURCE, "one-hot"), SOURCE.shape[1], torch.float32)
    for prior in ((), (swap("y", (0, 2), {"c": 0}), forget("x", {"a": 1}))):
        wide = extend_module(net, SOURCE, FULL, prior).eval()
        x = wide_of(wide.extension, observations(SOURCE, "one-hot", 20, torch.float32))
        program = torch.onnx.export(wide, (x,), dynamo=True, verbose=False)
        found = ReferenceEvaluator(program.model_proto).run(None, {program.model_proto.graph.input[0].name: x.numpy()})
        assert np.allclose(found[0], wide(x).detach().numpy(), atol=1e-5)


def test_moments_statistics_and_experience_follow() -> None:
    net = mlp(width(SOURCE, "one-hot"), SOURCE.shape[1])
    optimizer = torch.optim.Adam(net.parameters(), lr=3e-4, amsgrad=True)
    x = observations(SOURCE, "one-hot", 30)
    net(x).square().sum().backward()
    optimizer.step()
    wide = extend_module(net, SOURCE, FULL)
    ours = wide.extension.optimizer(optimizer, net, wide)
    assert ours.param_groups[0]["lr"] == 3e-4
    assert ours.param_groups[0]["amsgrad"]
    before, after = optimizer.state[net[0].weight], ours.state[wide[0].weight]
    assert set(after) == set(before)
    assert torch.equal(after["step"], before["step"])
    assert torch.equal(after["exp_avg"][:, wide.extension.inputs.old], before["exp_avg"])
    assert after["exp_avg_sq"][:, wide.extension.inputs.new].abs().sum() == 0
    # one step more changes the old parts as it would have changed the source's network
    for module, opt, seen in ((net, optimizer, x), (wide, ours, wide_of(wide.extension, x))):
        opt.zero_grad()
        module(seen)[:, slice(None) if module is net else wide.extension.outputs.old].square().sum().backward()
        opt.step()
    assert torch.allclose(wide[0].weight[:, wide.extension.inputs.old], net[0].weight, rtol=0, atol=1e-12)
    mean, variance = wide.extension.statistics(np.arange(6.0), np.full(6, 4.0))
    assert mean[wide.extension.inputs.old].tolist() == [0, 1, 2, 3, 4, 5]
    assert sorted(variance) == [1.0] * 6 + [4.0] * 6
    assert wide.extension.actions(np.arange(8)).tolist() == SOURCE.output_columns(FULL).tolist()
    other = torch.optim.SGD(mlp(3, 2).parameters(), lr=0.1)
    with pytest.raises(TaskliftError, match="not the module's"):
        wide.extension.optimizer(other, net, wide)


def test_normalisation_inside_the_network_follows() -> None:
    columns = width(SOURCE, "one-hot")
    net = nn.Sequential(nn.BatchNorm1d(columns), nn.Linear(columns, 32), nn.Tanh(), nn.Linear(32, 8)).double()
    x = observations(SOURCE, "one-hot", 50)
    net(x)
    wide = extend_module(net.eval(), SOURCE, FULL)
    assert torch.equal(wide(wide_of(wide.extension, x))[:, wide.extension.outputs.old], net(x))
    with pytest.raises(TaskliftError, match="'0' \\(LayerNorm\\)"):
        extend_module(nn.Sequential(nn.LayerNorm(columns), nn.Linear(columns, 8)), SOURCE, FULL)


PRIORS = [
    swap("y", (0, 2), {"c": 0}), swap("x", (0, 2)), forget("y", {"a": [1, 2]}), forget("x", {"y": [0, 1], "d": 6}),
    invert({"c": 0, "y": [0, 1, 2]}), scale(0.25, {"b": 0.5}), set_weight(2.0, {"a": 2, "x": 1}),
]  # fmt: skip


@pytest.mark.parametrize("outputs", ["logits", "values"])
@pytest.mark.parametrize("encoding", ["one-hot", "scalar", "flat"])
def test_priors_are_those_of_tables(outputs, encoding) -> None:
    torch.manual_seed(3)
    columns = width(SOURCE, encoding)
    first = nn.Embedding(columns, 16) if encoding == "flat" else nn.Linear(columns, 16)
    net = nn.Sequential(first, nn.Tanh(), nn.Linear(16, SOURCE.shape[1])).double()
    positions = FULL.input_positions(range(FULL.shape[0]))
    if encoding == "flat":
        x = torch.arange(FULL.shape[0])
    elif encoding == "one-hot":
        x = torch.tensor(np.hstack([np.eye(len(v))[positions[:, k]] for k, v in enumerate(FULL.inputs)]))
    else:
        x = torch.tensor([[float(v.values[p]) for v, p in zip(FULL.inputs, row, strict=True)] for row in positions])
    x = x if encoding == "flat" else x.double()
    bare = extend_module(net, SOURCE, FULL, encoding=encoding, new_actions="copied")(x).detach().numpy()
    for prior in [[one] for one in PRIORS] + [PRIORS]:
        wide = extend_module(net, SOURCE, FULL, prior, encoding=encoding, outputs=outputs, new_actions="copied")
        found = wide(x).detach().numpy()
        expected = np.exp(bare) if outputs == "logits" else bare
        for one in prior:
            expected = one.apply(FULL, expected)
        assert np.allclose(np.exp(found) if outputs == "logits" else found, expected, rtol=1e-9, atol=1e-12)
    traced = torch.jit.trace(wide, (x[:5],))
    assert torch.equal(traced(x), wide(x))
    wide(x).sum().backward()
    with pytest.raises(RuntimeError, match="prior_knowledge"):
        nn.Sequential(first, nn.Tanh(), nn.Linear(16, SOURCE.shape[1])).load_state_dict(wide.state_dict())


def test_priors_of_a_factored_head() -> None:
    net = mlp(width(INPUTS_ONLY, "one-hot"), 7)
    bare = extend_module(net, INPUTS_ONLY, FULL, head="factored")
    x = torch.zeros(2, 12, dtype=torch.float64)
    x[:, [0, 3, 9]] = 1
    x[0, 7], x[1, 8] = 1, 1  # c is 0, then 1
    wide = extend_module(net, INPUTS_ONLY, FULL, [swap("y", (0, 3), {"c": 0})], head="factored")
    assert torch.equal(wide(x)[1], bare(x)[1])
    assert torch.equal(wide(x)[0], bare(x)[0][[0, 1, 2, 6, 4, 5, 3]])
    with pytest.raises(TaskliftError, match="a prior about one, found"):
        extend_module(net, INPUTS_ONLY, FULL, [swap("y", (0, 3), {"x": 0})], head="factored")


@pytest.mark.parametrize(
    ("net", "more", "says"),
    [
        (lambda: mlp(5, 8), {}, "no layer has the inputs of .* expected 6 .one-hot. or 2 .scalar."),
        (lambda: mlp(6, 9), {}, "no layer has the outputs: expected 8"),
        (lambda: mlp(6, 8), {"first": ["1"]}, "layer '1' is a Tanh"),
        (lambda: mlp(6, 8), {"first": ["7"]}, "no layer '7'"),
        (lambda: mlp(6, 8), {"first": ["2"]}, "layer '2' has 64 inputs"),
        (lambda: mlp(6, 8), {"last": ["2"]}, "layer '2' has 64 outputs; expected 8"),
        (lambda: mlp(6, 8), {"prior": [swap("z")]}, "no variable 'z'"),
        (lambda: mlp(6, 8), {"encoding": "binary"}, "encoding"),
        (lambda: mlp(6, 8), {"new_actions": "high"}, "new_actions"),
        (lambda: nn.Sequential(nn.Conv1d(6, 3, 1)), {}, "'0' 6 .is a Conv1d, which cannot be widened"),
        (lambda: "net", {}, "expected a torch.nn.Module"),
    ],
)
def test_what_does_not_fit_is_refused_before_anything_is_changed(net, more, says) -> None:
    made = net()
    before = repr(made)
    with pytest.raises(TaskliftError, match=says):
        extend_module(made, SOURCE, FULL, **more)
    assert repr(made) == before


def test_layers_that_the_width_cannot_tell_apart_are_named() -> None:
    class Plain(nn.Module):
        def __init__(self) -> None:
            super().__init__()
            self.fc1, self.fc2, self.fc3 = nn.Linear(6, 6), nn.Linear(6, 6), nn.Linear(6, 8)

    with pytest.raises(TaskliftError, match="'fc1' and 'fc2'"):
        extend_module(Plain(), SOURCE, FULL)
    assert extend_module(Plain(), SOURCE, FULL, first=["fc1"]).fc1.in_features == 12
    square = nn.Sequential(nn.Linear(6, 6), nn.ReLU(), nn.Linear(6, 6), nn.ReLU(), nn.Linear(6, 8))
    assert [layer.in_features for layer in extend_module(square, SOURCE, FULL)[::2]] == [12, 6, 6]


def test_tasks_of_other_lineages_are_refused() -> None:
    with pytest.raises(TaskliftError, match="neither equal to nor a simplification"):
        extend_module(mlp(6, 8), SOURCE, paper_task())


def test_merged_values_are_extended_where_the_network_sees_a_flat_input() -> None:
    walk = Task("walk", (Variable("place", range(4)),), (Variable("move", (0, 1)),))
    coarse = walk.simplify(merge={"place": [[0, 3]]})
    net = nn.Sequential(nn.Embedding(3, 5), nn.Linear(5, 2))
    wide = extend_module(net, coarse, walk, encoding="flat")
    assert torch.equal(wide(torch.tensor([0, 1, 2, 3])), net(torch.tensor([0, 1, 2, 0])))
    with pytest.raises(TaskliftError, match="values of 'place' are merged"):
        extend_module(mlp(3, 2), coarse, walk)


def test_the_papers_tasks() -> None:
    task = search_and_clear()
    source = search_only(task)
    net = mlp(8, 44)
    wide = extend_module(net, source, task, [forget("MV", {"DL": [1, 2]})])
    assert wide[0].in_features == 13
    table = Policy(source, np.exp(net(observations_of(source)).detach().numpy()))
    table = table.extend(task, [forget("MV", {"DL": [1, 2]})])
    found = np.exp(wide(observations_of(task)).detach().numpy())
    assert np.allclose(found, table.weights)


def observations_of(task: Task):
    positions = task.input_positions(range(task.shape[0]))
    return torch.tensor(np.hstack([np.eye(len(v))[positions[:, k]] for k, v in enumerate(task.inputs)]))
