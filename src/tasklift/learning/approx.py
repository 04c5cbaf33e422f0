"""Other representations: a policy as a decision tree or a neural network, and back into a table.

"If it is viewed as a table of inputs and respective output values, then this policy is a simple functional mapping
that is fed into a neural network or decision tree. Conversely, the policy can be extracted from the learning
algorithm by providing all the different possible inputs" (Singh & Adams 2006, section III). Nothing here enumerates
a task's inputs unless asked to, so tasks whose tables would not fit in memory can be learned this way.

Needs the extra ``approx``. Shapes: ``n`` inputs, ``A`` outputs.
"""

from __future__ import annotations

import warnings
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from itertools import product
from typing import Any, Literal, Protocol, get_args

import numpy as np
from numpy.typing import NDArray

from tasklift.checks import whole_number
from tasklift.errors import TaskliftError, missing
from tasklift.learning.chances import GREEDY_STAGE, Chances
from tasklift.learning.learner import keeping
from tasklift.learning.worlds import Course, Possible, StepOutcomes, Steps, View, nothing_possible, outcomes_of
from tasklift.tasks import choice as rules
from tasklift.tasks.policy import Policy, Prior, spread
from tasklift.tasks.task import Task
from tasklift.tasks.variable import Variable

Floats = NDArray[np.float64]
Positions = NDArray[np.int64]
Kind = Literal["tree", "network"]

#: Gradient steps of a network's fit, at least; the first fits have little experience, and much to unlearn.
LEAST_UPDATES = 20


class Regressor(Protocol):
    """Weights as a function of inputs."""

    def rows(self, positions: Positions) -> Floats:
        """Return the weights (n, A) of inputs, given by the positions of their values, int64 (n, variables)."""
        ...


@dataclass(frozen=True, eq=False)
class Approximation:
    """A policy that is a function from inputs to weights, in place of a table.

    Made by :func:`approximate` from a policy, by :func:`learn_approximate` from experience, or by :meth:`extend`.
    """

    task: Task
    regressor: Regressor
    kind: Literal["weight", "value"] = "value"

    def weights(self, inputs: Sequence[int]) -> Floats:
        """Return the weights, float64 (n, A), of inputs given by their indices."""
        return self.rows(self.task.input_positions(inputs))

    def rows(self, positions: Positions) -> Floats:
        """Return the weights, float64 (n, A), of inputs given by the positions of their values."""
        found = self.regressor.rows(positions)
        return np.maximum(found, 0.0) if self.kind == "weight" else found

    def best(self, inputs: Sequence[int]) -> NDArray[np.int64]:
        """Return the heaviest output of each of the inputs; the first one where several are equal."""
        return np.argmax(self.weights(inputs), axis=1).astype(np.int64)

    def to_policy(self) -> Policy:
        """Return the table, by asking for every input."""
        self.task.need_room(self.task.shape[0] * self.task.shape[1], "the policy")
        weights = self.rows(_all_positions(self.task))
        return Policy(self.task, weights, {"extracted_from": type(self.regressor).__name__}, self.kind)

    def extend(self, task: Task, prior: Sequence[Prior] = ()) -> Approximation:
        """Extend to a task that this one's came from, as :meth:`.Policy.extend` does for tables."""
        ancestor = self.task.ancestor(task)
        # priors with unknown names are refused now, not at the first question
        nobody = np.zeros((0, len(task.inputs)), dtype=np.int64)
        for operation in prior:
            operation.apply(task, np.zeros((0, task.shape[1])), nobody)
        return Approximation(task, _Extended(self, ancestor, tuple(prior)), self.kind)

    def rules(self, inputs: Sequence[int] | None = None, *, max_leaves: int = 16) -> str:
        """Return the best outputs as nested rules, read off a small decision tree.

        Parameters
        ----------
        inputs
            Over these; default: all of them.
        max_leaves
            Largest number of the tree's ends; see :func:`fidelity` for what that costs.
        """
        positions = _all_positions(self.task) if inputs is None else self.task.input_positions(inputs)
        small = _Tree(positions, self.rows(positions), max_leaves, 1)
        return "\n".join(_lines(small.tree.tree_, 0, self.task, {}))


@dataclass(frozen=True)
class Fidelity:
    """How well an approximation stands for a table.

    ``same_best``: share of inputs whose best output is (one of) the table's best; ``same_best_visited``: the same,
    inputs weighted by visits (NaN without visits); ``table_return``, ``approximation_return``: mean return of both,
    played greedily on a world (NaN without one).
    """

    same_best: float
    same_best_visited: float
    table_return: float
    approximation_return: float


def approximate(
    policy: Policy,
    kind: Kind = "tree",
    *,
    max_leaves: int | None = None,
    hidden: Sequence[int] = (64, 64),
    seed: int = 0,
) -> Approximation:
    """Fit a decision tree or a neural network to a policy's table.

    Parameters
    ----------
    kind
        ``"tree"``: splits on the order of each variable's values; exact if it may grow. ``"network"``: a perceptron
        on one-hot inputs.
    max_leaves
        Of a tree; None: as many as it takes.
    hidden
        Sizes of a network's hidden layers.
    seed
        Of a network's start.

    Raises
    ------
    TaskliftError
        For another kind, a number out of range, or without the extra ``approx``.

    Examples
    --------
    >>> from tasklift import Policy
    >>> from tasklift.building import Mission, generate
    >>> hunt = Mission(generate(seed=7), team="10+5")
    >>> policy = Policy.equal(hunt.task)
    >>> tree = approximate(policy, "tree", max_leaves=8)
    >>> fidelity(policy, tree).same_best
    1.0
    """
    positions = _all_positions(policy.task)
    if kind not in get_args(Kind):
        raise TaskliftError(f"approximate: expected 'tree' or 'network', found {kind!r}")
    regressor: Regressor
    if kind == "tree":
        regressor = _Tree(positions, policy.weights, max_leaves, 1)
    else:
        regressor = _Network(policy.task, positions, policy.weights, hidden, seed)
    return Approximation(policy.task, regressor, policy.kind)


def fidelity(
    policy: Policy,
    approximation: Approximation,
    *,
    visits: Floats | None = None,
    world: Steps | None = None,
    trials: int = 200,
    seed: int = 0,
) -> Fidelity:
    """Compare an approximation with the table it stands for.

    Parameters
    ----------
    visits
        float64 (S,) or (S, A); default: what the policy carries, if it does.
    world
        Where both are played greedily, over ``trials`` trials with the same seeds.

    Returns
    -------
    Fidelity
        Shares of inputs, and mean returns; NaN for what was not asked.

    Raises
    ------
    TaskliftError
        If a number is out of range.

    Examples
    --------
    See :func:`approximate`.
    """
    found = approximation.rows(_all_positions(policy.task)).argmax(axis=1)
    best = policy.weights[np.arange(len(found)), found] == policy.weights.max(axis=1)
    seen: Any = policy.carried.get("visits") if visits is None else visits
    weight = None if seen is None else np.asarray(seen, dtype=np.float64).reshape(len(found), -1).sum(axis=1)
    table_return = approximation_return = float("nan")
    if world is not None:
        table = Approximation(policy.task, _Table(policy), policy.kind)
        table_return, approximation_return = (
            float(play(world, player, trials=trials, seed=seed).returns.mean()) for player in (table, approximation)
        )
    return Fidelity(
        float(best.mean()),
        float(np.average(best, weights=weight)) if weight is not None and weight.sum() > 0 else float("nan"),
        table_return,
        approximation_return,
    )


def play(
    world: Steps, approximation: Approximation, *, trials: int = 100, seed: int = 0, stage: int = GREEDY_STAGE
) -> StepOutcomes:
    """Run trials with the best output at every step, ties at random, and learn nothing."""
    whole_number(trials, "play, trials", least=1)
    collector = _Collector(world, approximation.task)
    chances = Chances(seed, stage)
    for i in range(trials):
        collector.trial(approximation, chances.of(i), epsilon=0.0)
    return outcomes_of(collector.records, world.limit)


# -- learning without a table ----------------------------------------------------------------------------------


@dataclass(frozen=True)
class ApproximateCurve:
    """A learned approximation, the outcomes on the way to it, and the inputs that were met."""

    approximation: Approximation
    outcomes: StepOutcomes
    met: tuple[int, ...]


def learn_approximate(
    world: Steps,
    start: Approximation | None = None,
    *,
    task: Task | None = None,
    kind: Kind = "tree",
    rounds: int = 10,
    trials: int = 50,
    discount: float = 0.99,
    epsilon: float = 0.2,
    loss_penalty: float = 0.0,
    sweeps: int = 5,
    leaf: int = 5,
    hidden: Sequence[int] = (64, 64),
    seed: int = 0,
    stage: int = 2,
) -> ApproximateCurve:
    """Learn by fitted Q iteration (Ernst, Geurts & Wehenkel, JMLR 2005): no table, only what was met.

    Each round runs trials with ε-greedy choice, then fits the weights, which may depend on the start's. In the first
    round they are fitted after 1, 2, 4, … trials as well: a start that is wrong where danger is new would repeat its
    mistake for the whole round. Without experience, transferred weights stay. A weight of a state (input) for an action
    (output) changes only after experience: each value of the state must have occurred, and the action must have been
    tried. Without a start, the fit holds for all states. A network takes one gradient step for each step of experience,
    and at least 20 per sweep. Outputs that the task or the world
    says are impossible are never chosen.

    Parameters
    ----------
    start
        What to begin with, an extended approximation for example; default: zero everywhere.
    task
        What to learn without a start: the world's task or a simplification.
    rounds
        Number of rounds.
    trials
        Trials per round.
    epsilon
        Probability of a uniformly random output.
    loss_penalty
        What each loss takes from the reward that is learned from; returns are reported without it.
    sweeps
        Fits per round, each one step further ahead.
    leaf
        Least number of experiences in a tree's leaf.

    Raises
    ------
    TaskliftError
        For another kind, a number out of range, or without the extra ``approx``.

    Examples
    --------
    >>> from tasklift import Step, Task, Variable
    >>> class Walk:  # five places in a row; the last one is home
    ...     task = Task("walk", (Variable("place", range(5)),), (Variable("go", ("left", "right")),))
    ...     limit = 50
    ...     def start(self, rng):
    ...         self.place = 0
    ...         return self.place
    ...     def step(self, output):
    ...         self.place = max(0, self.place + (1 if output else -1))
    ...         return Step(self.place, -1.0, ended=self.place == 4, success=self.place == 4)
    >>> curve = learn_approximate(Walk(), rounds=4, trials=10, seed=0)
    >>> curve.approximation.best([0, 1, 2, 3]).tolist()
    [1, 1, 1, 1]
    """
    for name, value in (("rounds", rounds), ("trials", trials), ("sweeps", sweeps), ("leaf", leaf)):
        whole_number(value, f"learn_approximate, {name}", least=1)
    if kind not in get_args(Kind):
        raise TaskliftError(f"learn_approximate: expected 'tree' or 'network', found {kind!r}")
    full = start.task if start is not None else task or world.task
    base = start or Approximation(full, _Zero(full.shape[1]))
    current = base
    collector, chances = _Collector(world, full), Chances(seed, stage)
    learner: _Trees | _Perceptron = _Trees(full, leaf) if kind == "tree" else _Perceptron(full, hidden, seed)

    def curve() -> ApproximateCurve:
        return ApproximateCurve(current, outcomes_of(collector.records, world.limit), tuple(collector.met))

    with _one_thread(), keeping(curve):
        done = 0
        for fitted in _fits(rounds, trials):
            known = len(collector.steps)
            for i in range(done, fitted):
                collector.trial(current, chances.of(i), epsilon, loss_penalty)
            done = fitted
            memory = collector.memory()
            met = None if start is None else _met(full, memory)
            base_now = base.rows(memory.before)
            updates = max(LEAST_UPDATES, -(-(len(memory.output) - known) // sweeps))
            for _ in range(sweeps):
                ahead = np.where(memory.possible, current.rows(memory.after), -np.inf).max(axis=1)
                ahead = np.where(memory.ended, 0.0, ahead)
                learner.fit(memory, base_now, memory.reward + discount * ahead, updates)
                current = Approximation(full, _Corrected(base, learner, met), "value")
    return curve()


def _fits(rounds: int, trials: int) -> list[int]:
    """Return after how many trials the weights are fitted: after 1, 2, 4, … in the first round, then once a round."""
    early = [2**k for k in range(trials.bit_length()) if 2**k < trials]
    return early + [trials * (number + 1) for number in range(rounds)]


@dataclass
class _Memory:
    before: Positions
    output: NDArray[np.int64]
    reward: Floats
    after: Positions
    ended: NDArray[np.bool_]
    possible: NDArray[np.bool_]  # after it, (n, A)


class _Collector:
    """Runs trials and remembers them; inputs are numbered as they are met."""

    def __init__(self, world: Steps, task: Task) -> None:
        self.view, self.task = View(world, task), task
        self.met: dict[int, int] = {}
        self.positions: list[list[int]] = []
        self.steps: list[tuple[int, int, float, int, bool, NDArray[np.bool_]]] = []
        self.records: list[tuple[int, bool, int, float]] = []
        self._rows: dict[int, Floats] = {}
        self._tasks: dict[int, NDArray[np.bool_]] = {}
        self._asked: Approximation | None = None

    def _number(self, row: int) -> int:
        if row not in self.met:
            self.met[row] = len(self.met)
            self.positions.append(self.task.input_positions([row])[0].tolist())
        return self.met[row]

    def _row(self, number: int, approximation: Approximation) -> Floats:
        if self._asked is not approximation:
            # what was met before is asked for at once: one question costs as much as a thousand
            known = np.array(self.positions, dtype=np.int64).reshape(len(self.positions), -1)
            self._rows = dict(enumerate(approximation.rows(known)))
            self._asked = approximation
        if number not in self._rows:
            self._rows[number] = approximation.rows(np.array([self.positions[number]], dtype=np.int64))[0]
        return self._rows[number]

    def _allowed(self, number: int, possible: Possible) -> NDArray[np.bool_]:
        """Return which outputs the task and the world allow at an input, bool (A,)."""
        if number not in self._tasks:
            place = np.array([self.positions[number]], dtype=np.int64)
            refused = [self.task.where(condition, place)[0] for condition in self.task.impossible]
            self._tasks[number] = ~np.any(refused, axis=0) if refused else np.ones(self.task.shape[1], np.bool_)
        allowed = self._tasks[number]
        return allowed if possible is None else allowed & possible

    def trial(
        self, approximation: Approximation, rng: np.random.Generator, epsilon: float, loss_penalty: float = 0.0
    ) -> None:
        likely = np.empty(self.task.shape[1])

        def course(row: int, possible: Possible) -> Course:
            here, last = self._number(row), False
            allowed = self._allowed(here, possible)
            while not last:
                if not allowed.any():
                    raise nothing_possible(self.task, row)
                weights = np.where(allowed, self._row(here, approximation), -np.inf)
                rules.probabilities(weights, epsilon, 0.0, likely)
                output = rules.draw(likely, rng.random())
                row, possible, reward, lost, last = yield output
                there = here if row < 0 else self._number(row)
                allowed = self._allowed(there, possible)
                over = row < 0 or not allowed.any()
                self.steps.append((here, output, reward - loss_penalty * lost, there, over, allowed))
                here = there
            yield -1

        self.records.append(self.view.play(rng, course))

    def memory(self) -> _Memory:
        before, output, reward, after, ended, possible = (np.array(column) for column in zip(*self.steps, strict=True))
        where = np.array(self.positions, dtype=np.int64).reshape(len(self.positions), -1)
        return _Memory(where[before], output, reward, where[after], ended, possible)


def _met(task: Task, memory: _Memory) -> list[NDArray[np.bool_]]:
    """Return, for each input variable, which of its values were met, for outputs that were tried, bool (values, A)."""
    tried = np.isin(np.arange(task.shape[1]), memory.output)
    met = [np.zeros((len(variable), task.shape[1]), np.bool_) for variable in task.inputs]
    for seen, positions in zip(met, memory.before.T, strict=True):
        seen[positions] = tried
    return met


class _Trees:
    """A regression tree for each output, which sees the start's weight beside the input.

    It can so keep what the start knows and split off where that is wrong. A tree of corrections could not: where the
    right output is the other one, a correction is positive as often as negative on each side of the first split.
    """

    def __init__(self, task: Task, leaf: int) -> None:
        self.leaf = leaf
        self.trees: list[_Tree | None] = [None] * task.shape[1]

    def fit(self, memory: _Memory, base: Floats, targets: Floats, updates: int) -> None:
        """Fit all trees anew."""
        for output in range(len(self.trees)):
            those = memory.output == output
            if those.sum() >= self.leaf:
                seen = np.column_stack([memory.before[those], base[those, output]])
                self.trees[output] = _Tree(seen, targets[those, None], None, self.leaf)

    def rows(self, positions: Positions, base: Floats) -> Floats:
        """Return the weights of inputs for which the start has the weights ``base``, both (n, A)."""
        columns = [
            base[:, output] if tree is None else tree.rows(np.column_stack([positions, base[:, output]]))[:, 0]
            for output, tree in enumerate(self.trees)
        ]
        return np.stack(columns, axis=1)


class _Perceptron:
    """One network of corrections for all outputs, which sees the start's weights and goes on from where it is."""

    batch = 64

    def __init__(self, task: Task, hidden: Sequence[int], seed: int) -> None:
        self.task, self.rng = task, np.random.default_rng(seed)
        self.network = _sklearn("neural_network").MLPRegressor(
            hidden_layer_sizes=tuple(hidden), batch_size=self.batch, alpha=0.0, random_state=seed
        )
        self.scale = 0.0

    def fit(self, memory: _Memory, base: Floats, targets: Floats, updates: int) -> None:
        """Take gradient steps on experience drawn at random; what an output was not tried for stays as it is."""
        missing = targets - base[np.arange(len(targets)), memory.output]
        drawn = self.rng.integers(len(missing), size=updates * self.batch)
        where, there = memory.before[drawn], base[drawn]
        wanted = self._corrections(where, there)
        wanted[np.arange(len(drawn)), memory.output[drawn]] = missing[drawn]
        self._rescale(float(np.abs(missing).max()))
        self.network.partial_fit(self._features(where, there), _squeezed(wanted / self.scale))

    def _features(self, positions: Positions, base: Floats) -> Floats:
        largest = np.maximum(1.0, np.abs(base).max(axis=1, keepdims=True))
        return np.hstack([_one_hot(self.task, positions), base / largest])

    def _rescale(self, largest: float) -> None:
        """Let the network's numbers stay below about 1, and its function as it is."""
        if largest > self.scale:
            if self.scale:
                for part in (self.network.coefs_[-1], self.network.intercepts_[-1]):
                    part *= self.scale / largest
            self.scale = largest
        self.scale = self.scale or 1.0

    def rows(self, positions: Positions, base: Floats) -> Floats:
        """Return the weights of inputs for which the start has the weights ``base``, both (n, A)."""
        return base + self._corrections(positions, base)

    def _corrections(self, positions: Positions, base: Floats) -> Floats:
        if not self.scale or not len(positions):
            return np.zeros(base.shape)
        found = np.asarray(self.network.predict(self._features(positions, base)))
        return found.reshape(base.shape) * self.scale


# -- the functions themselves ----------------------------------------------------------------------------------


class _Zero:
    def __init__(self, outputs: int) -> None:
        self.outputs = outputs

    def rows(self, positions: Positions) -> Floats:
        return np.zeros((len(positions), self.outputs))


class _Table:
    def __init__(self, policy: Policy) -> None:
        self.weights, self.sizes = policy.weights, [len(v) for v in policy.task.inputs]

    def rows(self, positions: Positions) -> Floats:
        if not self.sizes:
            return np.repeat(self.weights, len(positions), axis=0)
        return self.weights[np.ravel_multi_index(tuple(positions.T), self.sizes)]


class _Tree:
    """A regression tree on the positions of values; scikit-learn's."""

    def __init__(self, positions: Positions, rows: Floats, max_leaves: int | None, leaf: int) -> None:
        if max_leaves is not None:
            whole_number(max_leaves, "tree, max_leaves", least=2)
        tree = _sklearn("tree").DecisionTreeRegressor(max_leaf_nodes=max_leaves, min_samples_leaf=leaf, random_state=0)
        self.tree = tree.fit(self._features(positions), rows)
        self.outputs = rows.shape[1]

    def rows(self, positions: Positions) -> Floats:
        if not len(positions):
            return np.zeros((0, self.outputs))
        return np.asarray(self.tree.predict(self._features(positions))).reshape(len(positions), self.outputs)

    @staticmethod
    def _features(positions: Positions) -> Positions:
        # a task without inputs has one row; a tree needs something to look at
        return positions if positions.shape[1] else np.zeros((len(positions), 1), dtype=np.int64)


class _Network:
    """A perceptron on one-hot inputs; scikit-learn's. Targets are scaled to mean 0 and deviation 1."""

    def __init__(self, task: Task, positions: Positions, rows: Floats, hidden: Sequence[int], seed: int) -> None:
        networks = _sklearn("neural_network")
        self.task, self.outputs = task, rows.shape[1]
        self.middle, self.spread = rows.mean(), rows.std() or 1.0
        solver = "lbfgs" if len(positions) <= 5000 else "adam"
        with warnings.catch_warnings():
            # a fit that stops at its limit of iterations is judged by its fidelity, not by a warning
            warnings.simplefilter("ignore", _sklearn("exceptions").ConvergenceWarning)
            self.network = networks.MLPRegressor(
                hidden_layer_sizes=tuple(hidden), solver=solver, max_iter=500, alpha=1e-6, random_state=seed
            ).fit(_one_hot(task, positions), _squeezed((rows - self.middle) / self.spread))

    def rows(self, positions: Positions) -> Floats:
        if not len(positions):
            return np.zeros((0, self.outputs))
        found = np.asarray(self.network.predict(_one_hot(self.task, positions)))
        return found.reshape(len(positions), self.outputs) * self.spread + self.middle


def _one_hot(task: Task, positions: Positions) -> Floats:
    """Return a constant and one number for each value of each input, float64 (n, 1 + values)."""
    parts = [np.eye(len(variable))[positions[:, k]] for k, variable in enumerate(task.inputs)]
    return np.hstack([np.ones((len(positions), 1)), *parts])


def _squeezed(targets: Floats) -> Floats:
    """Return targets as scikit-learn wants them: of one output, without its axis."""
    return targets[:, 0] if targets.shape[1] == 1 else targets


class _Corrected:
    """A start that is corrected where each value of an input was met and the output was tried."""

    def __init__(
        self, base: Approximation, learner: _Trees | _Perceptron, met: list[NDArray[np.bool_]] | None
    ) -> None:
        self.base, self.learner, self.met = base, learner, met

    def rows(self, positions: Positions) -> Floats:
        base = self.base.rows(positions)
        found = self.learner.rows(positions, base)
        if self.met is not None:
            for seen, column in zip(self.met, positions.T, strict=True):
                found = np.where(seen[column], found, base)
        return found


class _Extended:
    """An approximation seen from the task that its own task came from."""

    def __init__(self, simple: Approximation, full: Task, prior: tuple[Prior, ...]) -> None:
        self.simple, self.full, self.prior = simple, full, prior
        self.places = simple.task.value_positions(full)

    def rows(self, positions: Positions) -> Floats:
        task, full = self.simple.task, self.full
        ours = {v.name: k for k, v in enumerate(full.inputs)}
        columns = [self._choices(positions[:, ours[v.name]], v) for v in task.inputs]
        # a value that a restriction left out gets the mean over those it kept, so ask for each of them
        total = np.zeros((len(positions), task.shape[1]))
        counts = [column.shape[1] for column in columns]
        for pick in product(*(range(n) for n in counts)):
            asked = [column[:, k] for column, k in zip(columns, pick, strict=True)]
            where = np.stack(asked, axis=1) if asked else np.zeros((len(positions), 0), dtype=np.int64)
            total += self.simple.rows(where)
        found = spread(total / np.prod(counts, initial=1.0), task.outputs, full.outputs, self.places, axis=1)
        for operation in self.prior:
            found = operation.apply(full, found, positions)
        return found

    def _choices(self, positions: NDArray[np.int64], variable: Variable) -> Positions:
        """Return the positions, in the simple task, that stand for each value (n, how many)."""
        places = self.places[variable.name]
        assert places is not None
        local = places[positions][:, None]
        return local if (local >= 0).all() else np.where(local >= 0, local, np.arange(len(variable)))


def _one_thread() -> Any:
    """Return a context in which small matrices are not shared out to threads, which costs more than it brings."""
    _sklearn("base")  # it brings threadpoolctl
    from threadpoolctl import threadpool_limits

    return threadpool_limits(1, user_api="blas")


def _sklearn(module: str) -> Any:
    try:
        from importlib import import_module

        return import_module(f"sklearn.{module}")
    except ImportError as error:
        raise missing("scikit-learn", "approx", "a tree or a network") from error


def _all_positions(task: Task) -> Positions:
    task.need_room(task.shape[0] * max(1, len(task.inputs)), "the list of all inputs")
    sizes = [len(v) for v in task.inputs]
    return np.indices(sizes, dtype=np.int64).reshape(len(sizes), -1).T if sizes else np.zeros((1, 0), np.int64)


def _lines(tree: Any, node: int, task: Task, known: Mapping[str, tuple[int, int]], depth: int = 0) -> list[str]:
    """Return a tree below a node as lines; branches that say the same appear once."""
    indent = "  " * depth
    said = _says(tree, node)
    if len(said) == 1:
        output = task.output_values(said.pop())
        return [f"{indent}{', '.join(f'{name} = {value!r}' for name, value in output.items())}"]
    variable = task.inputs[int(tree.feature[node])]
    low, high = known.get(variable.name, (0, len(variable)))
    cut = int(np.floor(tree.threshold[node])) + 1
    lines: list[str] = []
    for child, (first, last) in (
        (tree.children_left[node], (low, cut)),
        (tree.children_right[node], (cut, high)),
    ):
        names = variable.labels or tuple(map(repr, variable.values))
        shown = names[first] if last - first == 1 else f"one of {', '.join(names[first:last])}"
        lines.append(f"{indent}if {variable.name} is {shown}:")
        lines += _lines(tree, int(child), task, {**known, variable.name: (first, last)}, depth + 1)
    return lines


def _says(tree: Any, node: int) -> set[int]:
    """Return the best outputs at the leaves below a node."""
    if tree.children_left[node] < 0:
        return {int(np.argmax(tree.value[node].ravel()))}
    return _says(tree, int(tree.children_left[node])) | _says(tree, int(tree.children_right[node]))
