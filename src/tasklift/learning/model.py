"""Worlds whose every transition is known: run compiled, and solved exactly.

Shapes: ``N`` states of the world, ``A`` outputs, ``K`` branches of a transition (unused ones have
probability 0); ``S`` inputs of the task. Several states may look the same, so N and S may differ.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray

from tasklift.checks import number, whole_number
from tasklift.errors import TaskliftError
from tasklift.learning.worlds import Record, Step, stray_input
from tasklift.tasks.policy import Policy
from tasklift.tasks.task import Task
from tasklift.text import shown

Floats = NDArray[np.float64]


_BRANCH = ("probability", "after", "reward", "ended", "lost", "success")


@dataclass(frozen=True, eq=False)
class Model:
    """An explicit Markov decision process; it is a :class:`~tasklift.learning.worlds.Steps` world.

    Parameters
    ----------
    task
        The full task; its inputs are what is seen of the states.
    rows
        int64 (N,): the input of each state.
    start_probability
        float64 (N,): how probable each state is at the start.
    probability, after, reward, ended, lost, success
        (N, A, K): of each branch its probability, next state, reward, whether the trial ends, how much is
        lost, and whether the trial then counts as a success.
    limit
        The most steps of a trial.

    Raises
    ------
    TaskliftError
        If shapes do not fit, probabilities do not sum to one, or a state or input does not exist.

    Examples
    --------
    Two places: *go* leads home with probability 0.5, *wait* stays; each step costs 1.

    >>> import numpy as np
    >>> from tasklift import Model, Task, Variable
    >>> task = Task("home", (Variable("place", ("out", "home")),), (Variable("move", ("wait", "go")),))
    >>> shape, home = (2, 2, 2), np.array([[[0, 0], [0, 1]], [[1, 1], [1, 1]]])
    >>> model = Model(
    ...     task, rows=np.array([0, 1]), start_probability=np.array([1.0, 0.0]), probability=np.full(shape, 0.5),
    ...     after=home, reward=np.full(shape, -1.0), ended=home == 1, lost=np.zeros(shape, int), success=home == 1,
    ...     limit=100,
    ... )
    >>> round(model.optimum(), 6)
    -2.0
    >>> task.output_values(int(model.best_policy().best()[0]))
    {'move': 'go'}
    """

    task: Task
    rows: NDArray[np.int64]
    start_probability: Floats
    probability: Floats
    after: NDArray[np.int64]
    reward: Floats
    ended: NDArray[np.bool_]
    lost: NDArray[np.int64]
    success: NDArray[np.bool_]
    limit: int

    @classmethod
    def from_function(
        cls,
        task: Task,
        transitions: Callable[[dict[str, Any], dict[str, Any]], Sequence[Sequence[Any]]],
        start: Mapping[str, Any] | Sequence[tuple[float, Mapping[str, Any]]],
        limit: int,
    ) -> Model:
        """Return the model whose states are the task's inputs, from a function of a state and an output.

        Parameters
        ----------
        task
            Whose inputs are the states.
        transitions
            ``(state, output)``, both by name → the branches, each ``(probability, next state, reward, ended)``, then
            how much is lost (default 0), and whether it is a success (default: ended without a loss). Asked once for
            every input and output.
        start
            The first state; or pairs of a probability and a state.
        limit
            The most steps of a trial.

        Raises
        ------
        TaskliftError
            For a state that is not an input of the task, a branch without its four entries, and whatever the class
            refuses.

        Examples
        --------
        >>> from tasklift import Model, Task, Variable
        >>> task = Task("walk", (Variable("place", range(5)),), (Variable("go", (-1, 1)),))
        >>> def walk(state, output):
        ...     there = max(0, state["place"] + output["go"])
        ...     return [(0.9, {"place": min(there, 4)}, -1.0, there >= 4), (0.1, state, -1.0, False)]
        >>> model = Model.from_function(task, walk, start={"place": 0}, limit=50)
        >>> round(model.optimum(), 4)
        -4.4444
        """
        n, outputs = task.shape
        task.need_room(n * outputs, "the model")
        told: list[list[list[tuple[Any, ...]]]] = []
        for s in range(n):
            told.append([])
            for a in range(outputs):
                state, output = task.input_values(s), task.output_values(a)
                branches = transitions(dict(state), output)
                told[-1].append(_branches(branches, task, f"model of {task.name!r}, {state}, {output}"))
        shape = (n, outputs, max(len(branches) for row in told for branches in row))
        arrays: dict[str, NDArray[Any]] = {name: np.zeros(shape) for name in ("probability", "reward")}
        arrays |= {"after": np.zeros(shape, np.int64), "lost": np.zeros(shape)}
        arrays |= {name: np.zeros(shape, np.bool_) for name in ("ended", "success")}
        for s, row in enumerate(told):
            for a, branches in enumerate(row):
                for k, branch in enumerate(branches):
                    for name, value in zip(_BRANCH, branch, strict=True):
                        arrays[name][s, a, k] = value
        begins = np.zeros(n)
        try:
            pairs = [(1.0, start)] if isinstance(start, Mapping) else [(float(p), begin) for p, begin in start]
        except (TypeError, ValueError) as error:
            raise TaskliftError(
                f"model of {task.name!r}, start: expected a state, or pairs (probability, state), found {shown(start)}"
            ) from error
        for p, begin in pairs:
            begins[task.input_index(begin)] += p
        return cls(task, np.arange(n), begins, limit=limit, **arrays)

    def __post_init__(self) -> None:
        n, outputs = len(self.rows), self.task.shape[1]
        where = f"model of {self.task.name!r}"
        shapes = {np.shape(getattr(self, name)) for name in _BRANCH}
        if len(shapes) != 1 or self.probability.shape[:2] != (n, outputs) or self.start_probability.shape != (n,):
            raise TaskliftError(f"{where}: expected arrays of shape ({n}, {outputs}, branches), found {sorted(shapes)}")
        sums = np.append(self.probability.sum(axis=2).ravel(), self.start_probability.sum())
        if (self.probability < 0).any() or not np.allclose(sums, 1, atol=1e-9):
            raise TaskliftError(f"{where}: the probabilities of a transition, or of the start, do not sum to one")
        if self.after.min() < 0 or self.after.max() >= n:
            raise TaskliftError(f"{where}: a transition leads to a state that is not among the {n}")
        lost = np.asarray(self.lost, dtype=np.float64)
        if not ((lost >= 0) & (lost <= 2**31) & (lost == np.floor(lost))).all():
            raise TaskliftError(f"{where}: expected whole numbers of losses from 0; count in smaller units")
        object.__setattr__(self, "lost", lost.astype(np.int64))
        whole_number(self.limit, f"{where}, limit", least=1)
        if not np.isfinite(self.reward).all():
            raise TaskliftError(f"{where}: a reward is not a finite number")
        if self.rows.min() < 0 or self.rows.max() >= self.task.shape[0]:
            raise TaskliftError(f"{where}: a state has an input outside of the task's {self.task.shape[0]}")
        object.__setattr__(self, "_state", {"now": -1, "rng": None})

    # -- step by step --------------------------------------------------------------------------------------

    @cached_property
    def _arrays(self) -> Any:
        from tasklift.learning.model_kernel import Arrays

        def running(probabilities: Floats) -> Floats:
            upto = np.cumsum(probabilities, axis=-1)
            # past the last branch that can happen, nothing must be left over through rounding
            upto[upto >= upto[..., -1:]] = 2.0
            return upto

        return Arrays(
            running(self.start_probability),
            running(self.probability),
            np.ascontiguousarray(self.after, dtype=np.int64),
            np.ascontiguousarray(self.reward, dtype=np.float64),
            np.ascontiguousarray(self.ended, dtype=np.bool_),
            np.ascontiguousarray(self.lost, dtype=np.int64),
            np.ascontiguousarray(self.success, dtype=np.bool_),
            self.limit,
        )

    def start(self, rng: np.random.Generator) -> int:
        """Begin a trial and return the first input."""
        state = int(np.argmax(rng.random() < self._arrays.start_upto))
        self._state.update(now=state, rng=rng)  # type: ignore[attr-defined]
        return int(self.rows[state])

    def step(self, output: int) -> Step:
        """Do one step with this output."""
        state, rng = self._state["now"], self._state["rng"]  # type: ignore[attr-defined]
        whole_number(output, f"model of {self.task.name!r}, output", 0, self.task.shape[1] - 1)
        if rng is None:
            raise TaskliftError(f"model of {self.task.name!r}: a step outside of a trial; call start() before")
        k = int(np.argmax(rng.random() < self._arrays.upto[state, output]))
        branch = (state, output, k)
        self._state["now"] = after = int(self.after[branch])  # type: ignore[attr-defined]
        if self.ended[branch]:
            self._state["rng"] = None  # type: ignore[attr-defined]
        return Step(
            int(self.rows[after]),
            float(self.reward[branch]),
            bool(self.ended[branch]),
            int(self.lost[branch]),
            bool(self.success[branch]),
        )

    def compiled_trial(
        self, task: Task, values: Floats, visits: Floats, settings: Floats
    ) -> Callable[[np.random.Generator], Record]:
        """Return a function that runs one compiled trial of value learning on ``values``, float64 (S, A).

        ``settings`` are a learner's, float64 (8,); see :mod:`tasklift.learning.model_kernel`.
        """
        from tasklift.learning import model_kernel

        ancestor = task.ancestor(self.task)
        rows = task.input_rows(ancestor)[self.rows]
        columns = task.output_columns(ancestor)

        def trial(rng: np.random.Generator) -> Record:
            *record, stray = model_kernel.trial(self._arrays, rows, columns, values, visits, settings, rng)
            if stray >= 0:
                raise stray_input(self.task.input_values(int(self.rows[stray])), task)
            steps, success, losses, total = record
            return steps, success, losses, total

        return trial

    # -- exact answers -------------------------------------------------------------------------------------

    def evaluate(self, probabilities: Floats, *, reward: Floats | None = None, steps: int | None = None) -> float:
        """Return the exact expected undiscounted sum of rewards of a policy.

        Parameters
        ----------
        probabilities
            float64 (S, A): how probable each output is at each input.
        reward
            (N, A, K), in place of the world's; ``model.success`` gives the probability of success.
        steps
            Over this many steps; default: without a limit (the trial must end by itself).
        """
        weights = np.asarray(probabilities, dtype=np.float64)[self.rows]
        gain, move = self._dynamics(reward)
        gain_under = (weights * gain).sum(axis=1)
        move_under = np.einsum("na,nam->nm", weights, move)
        if steps is None:
            # only states that can be met matter; others may never end, and have no value
            met = self._met(move_under)
            values = np.zeros(len(self.rows))
            within = np.eye(int(met.sum())) - move_under[np.ix_(met, met)]
            values[met] = np.linalg.solve(within, gain_under[met])
        else:
            values = np.zeros(len(self.rows))
            for _ in range(steps):
                values = gain_under + move_under @ values
        return float(self.start_probability @ values)

    def optimum(self, *, reward: Floats | None = None, steps: int | None = None, sweeps: int = 100_000) -> float:
        """Return the exact best expected sum of rewards: over ``steps`` steps, or without a limit."""
        return float(self.start_probability @ self.action_values(reward=reward, steps=steps, sweeps=sweeps).max(axis=1))

    def action_values(
        self,
        *,
        reward: Floats | None = None,
        steps: int | None = None,
        discount: float = 1.0,
        epsilon: float = 0.0,
        sweeps: int = 100_000,
    ) -> Floats:
        """Return the value of each state and output, float64 (N, A), by value iteration (to 1e-12).

        With ``epsilon``, of the best policy among those that choose evenly with that probability (ε-soft).
        """
        gain, move = self._dynamics(reward)
        values = np.zeros(len(self.rows))
        table = gain
        for _ in range(sweeps if steps is None else steps):
            table = gain + discount * move @ values
            new = (1 - epsilon) * table.max(axis=1) + epsilon * table.mean(axis=1)
            if steps is None and np.abs(new - values).max() < 1e-12:
                return table
            values = new
        if steps is None:
            raise TaskliftError(f"model of {self.task.name!r}: values do not settle; give steps= or a discount below 1")
        return table

    # -- safety --------------------------------------------------------------------------------------------

    def failure_probability(self, chances: Floats) -> float:
        """Return the exact probability that a policy ever loses anything, in a trial without a limit.

        Parameters
        ----------
        chances : float64 (S, A)
            How probable each output is at each input.
        """
        weights = np.asarray(chances, dtype=np.float64)[self.rows]
        gain, move = self._until_lost._dynamics(None)
        now, on = (weights * gain).sum(axis=1), np.einsum("na,nam->nm", weights, move)
        # from the other states nothing is ever lost, even if the trial never ends there
        near = now > 0
        while (wider := near | ((on @ near.astype(float)) > 0)).sum() > near.sum():
            near = wider
        lost = np.zeros(len(self.rows))
        lost[near] = np.linalg.solve(np.eye(int(near.sum())) - on[np.ix_(near, near)], now[near])
        return float(self.start_probability @ lost)

    def risks(self) -> Floats:
        """Return the least probability of ever losing anything after each output in each state, float64 (N, A)."""
        certain = replace(self._until_lost, reward=-self._until_lost.reward)
        return np.asarray(-certain.action_values())

    def shielded(self, risk: float) -> Model:
        """Return the model behind a shield: outputs that are too risky do what the safest one does instead.

        An output is too risky in a state if the least probability of ever losing anything after it is above ``risk``,
        and another one's is lower. The shield needs the model; what learns in it needs nothing (Alshiekh et al., *Safe
        Reinforcement Learning via Shielding*, AAAI 2018; here with probabilities, by value iteration).

        Parameters
        ----------
        risk : float
            From 0 to 1. At 1 nothing is changed.

        Raises
        ------
        TaskliftError
            If ``risk`` is out of range.
        """
        number(risk, "shield, risk", 0.0, 1.0)
        risks = self.risks()
        least = risks.min(axis=1, keepdims=True)
        # what value iteration leaves of a difference is no reason to refuse
        refused = (risks > risk + 1e-9) & (risks > least + 1e-9)
        state, outputs = np.arange(len(self.rows))[:, None], np.arange(self.task.shape[1])
        does = np.where(refused, risks.argmin(axis=1)[:, None], outputs)
        return replace(self, **{name: getattr(self, name)[state, does] for name in _BRANCH})

    @cached_property
    def _until_lost(self) -> Model:
        """The model in which the first loss gives 1 and ends the trial, and nothing else gives anything."""
        lost = self.lost > 0
        return replace(self, ended=self.ended | lost, reward=lost.astype(np.float64))

    def best_policy(self, **options: Any) -> Policy:
        """Return the best policy by :meth:`action_values`; inputs must tell the model's states apart."""
        if len(set(self.rows.tolist())) < len(self.rows):
            raise TaskliftError(f"model of {self.task.name!r}: states look the same, so the best policy has no table")
        values = np.zeros(self.task.shape)
        values[self.rows] = self.action_values(**options)
        return Policy(self.task, values, {"solved": "value iteration"}, "value")

    def _dynamics(self, reward: Floats | None) -> tuple[Floats, Floats]:
        """Return the expected reward (N, A), and the probabilities of going on in each state (N, A, N)."""
        gain = (self.probability * (self.reward if reward is None else reward)).sum(axis=2)
        n, outputs, branches = self.probability.shape
        move = np.zeros((n, outputs, n))
        going = np.where(self.ended, 0.0, self.probability)
        state, output = np.indices((n, outputs))
        for k in range(branches):
            np.add.at(move, (state, output, self.after[:, :, k]), going[:, :, k])
        return gain, move

    def _met(self, move: Floats) -> NDArray[np.bool_]:
        met = self.start_probability > 0
        while True:
            wider = met | ((met.astype(float) @ move) > 0)
            if (wider == met).all():
                return met
            met = wider


def _branches(given: Any, task: Task, where: str) -> list[tuple[Any, ...]]:
    """Return the branches of a transition, each with its six entries (:data:`_BRANCH`)."""
    found = []
    try:
        for p, to, reward, ended, *rest in given:
            lost = float(rest[0]) if rest else 0.0
            success = bool(rest[1]) if len(rest) > 1 else bool(ended) and not lost
            if len(rest) > 2:
                raise ValueError(f"{4 + len(rest)} entries")
            found.append((float(p), task.input_index(to), float(reward), bool(ended), lost, success))
    except TaskliftError as error:
        raise TaskliftError(f"{where}: {error}") from error
    except (TypeError, ValueError) as error:
        raise TaskliftError(
            f"{where}: expected branches (probability, next state, reward, ended, then perhaps losses and success), "
            f"found {shown(given)}"
        ) from error
    if not found:
        raise TaskliftError(f"{where}: expected at least one branch (probability, next state, reward, ended)")
    return found
