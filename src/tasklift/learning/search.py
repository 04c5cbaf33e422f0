"""Learning by policy search: the cross-entropy method on the probabilities of a policy's outputs.

Where episodes (trials) are safe and cheap, a search over whole policies needs no reward signals: it asks of each
candidate what counts in the end, whether it solved the task, what it lost and how long it took (Rubinstein 1999; de
Boer, Kroese, Mannor & Rubinstein 2005, *A tutorial on the cross-entropy method*).

Shapes: ``S`` inputs, ``A`` outputs, ``P`` candidates, ``n`` episodes; ``A`` is the product of the ``k`` values of each
output variable.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, fields, replace
from typing import Any, ClassVar

import numpy as np
from numpy.typing import NDArray

from tasklift.checks import number, whole_number
from tasklift.errors import TaskliftError
from tasklift.learning.learner import Curve, Run, provenance
from tasklift.learning.reinforcement import Reinforcement, StepTrials
from tasklift.learning.worlds import Outcomes, Steps, Trials, joined
from tasklift.tasks.policy import Policy
from tasklift.tasks.task import Task

Floats = NDArray[np.float64]

_AS_DRAWN = Reinforcement()
"""Outputs are drawn in proportion to weight."""


MOST_CANDIDATES = 10_000
"""In a generation: all their tables are in memory at once."""


@dataclass(frozen=True)
class PolicySearch:
    """Search for a policy by playing many and moving towards those that do best; a :class:`.Learner`.

    A policy is one probability vector per input and output variable; its table is their product. In each generation,
    candidates are drawn around the policy (from Dirichlet distributions), each plays the same few episodes, and the
    policy moves towards the mean of the best. So it can end mixed where a mixture does best, and pure where not.

    A candidate's score is the mean over its episodes of ``solved − loss_price · losses / (1 + losses) − step_price ·
    steps / limit``. A candidate that solved no episode is never among the best: "never move" loses nothing, and would
    otherwise win while nothing is solved yet.

    Parameters
    ----------
    population : int
        Candidates in a generation, at least 2.
    episodes : int
        Episodes that each of them plays.
    elite : float
        Share of the candidates that the policy moves towards, above 0, at most 1.
    rate : float
        How far it moves: 1 forgets where it was. With fewer candidates that solved an episode, it moves less.
    concentration : float
        How close candidates are drawn to the policy, above 0: the sum of the Dirichlet parameters. Near 0 every
        candidate is pure.
    loss_price, step_price : float
        The price of losses and of all steps up to the limit, in solved episodes; at least 0.
    cutoff : float
        Outputs less likely than this in the end get probability 0, below 0.5.

    Raises
    ------
    TaskliftError
        If a number is out of range.

    Examples
    --------
    >>> import tasklift as tl
    >>> from tasklift.building import Mission, generate
    >>> drill = Mission(generate(intersections=9, corridors=11, rooms=3, features=6, seed=5), "4+3").drill()
    >>> simple = drill.task.simplify(remove=["DL", "GL"])
    >>> learner = PolicySearch(population=20)
    >>> curve = learner.learn(drill, learner.start(simple), tl.Run(trials=1600))
    >>> len(curve.outcomes)
    1600
    """

    population: int = 100
    episodes: int = 4
    elite: float = 0.2
    rate: float = 0.3
    concentration: float = 2.0
    loss_price: float = 1.0
    step_price: float = 1.0
    cutoff: float = 0.03

    #: A run that is cut into shorter ones would lose unfinished generations.
    divisible: ClassVar[bool] = False

    def __post_init__(self) -> None:
        whole_number(self.population, "policy search, population", 2, MOST_CANDIDATES)
        whole_number(self.episodes, "policy search, episodes", least=1)
        for name, most in (("elite", 1.0), ("rate", 1.0), ("concentration", math.inf)):
            number(getattr(self, name), f"policy search, {name}", 0.0, most, above=True)
        for name, most in (("loss_price", math.inf), ("step_price", math.inf), ("cutoff", 0.5)):
            number(getattr(self, name), f"policy search, {name}", 0.0, most)

    def start(self, task: Task) -> Policy:
        """Return equal weights."""
        return Policy.equal(task, 1.0)

    def count_as(self, policy: Policy, trust: float) -> Policy:
        """Return the policy such that candidates are drawn this close to it: ``trust`` is the ``concentration``."""
        return replace(policy, carried=dict(policy.carried) | {"concentration": float(trust)})

    def check(self, world: Trials | Steps, task: Task, run: Run) -> None:
        """Raise :class:`TaskliftError` for a run without trials, or with fewer than one generation needs."""
        least = self.population * self.episodes
        if run.trials is None:
            raise TaskliftError("policy search: has no budget; give trials=")
        if run.trials < least:
            raise TaskliftError(
                f"policy search: a generation of {self.population} candidates × {self.episodes} episodes takes {least} "
                f"trials, found a budget of {run.trials}; give at least {least}"
            )

    def learn(self, world: Trials | Steps, policy: Policy, run: Run) -> Curve:
        """Search from ``policy``, in as many full generations as the budget allows.

        The episodes of a generation are numbered on from the last one's, the same ones for all its candidates. So a
        search plays ``episodes`` × generations different episodes, each with ``population`` candidates. A search that
        solved nothing returns the policy it was given.
        """
        if policy.kind != "weight":
            raise TaskliftError(f"policy search: expected a policy of weights, found one of {policy.kind}s")
        task, rng = policy.task, np.random.default_rng([_DRAWS, run.seed, run.stage, run.first_trial])
        mean, moved = marginals(task, policy.weights), False
        concentration = float(policy.carried.get("concentration", self.concentration))
        parts: list[Outcomes] = []
        full = self.population * self.episodes
        while (left := run.rest(parts)) is not None and (left.trials or 0) >= full:
            candidates = [_around(vector, concentration, self.population, rng) for vector in mean]
            generation = replace(left, first_trial=run.first_trial + self.episodes * len(parts))
            played = self._play(world, task, product(candidates), generation)
            parts.append(played)
            if len(played) < full:
                break  # the cap on losses was reached: what is left of the generation is never played
            moved |= self._move(mean, candidates, played)
        outcomes = joined(parts)
        history = provenance("policy search", self, policy, run, outcomes)
        weights = product([_cut(vector, self.cutoff) for vector in mean]) if moved else policy.weights
        carried = {name: value for name, value in policy.carried.items() if name != "concentration"}
        return Curve(Policy(task, weights, history, "weight", carried), outcomes)

    def _play(self, world: Trials | Steps, task: Task, tables: Floats, run: Run) -> Outcomes:
        """Play the first episodes of ``run`` with each table, float64 (P, S, A); return the outcomes (P · n,)."""
        trials_of: Any = StepTrials(world) if isinstance(world, Steps) else world
        key = {
            "trials": self.episodes,
            "stage": run.stage,
            "first_trial": run.first_trial,
            "reinforcement": _AS_DRAWN,
            "learn": False,
        }
        if run.max_losses is None and hasattr(trials_of, "run_many"):
            return _flat(trials_of.run_many(task, tables, seeds=[run.seed] * len(tables), **key))
        parts: list[Outcomes] = []
        for table in tables:
            left = replace(run, steps=None).rest(parts)
            if left is None:
                break
            parts.append(trials_of.run(task, table, seed=run.seed, max_losses=left.max_losses, **key))
        return joined(parts)

    def _move(self, mean: list[Floats], candidates: list[Floats], played: Outcomes) -> bool:
        """Move each probability vector towards the mean of the best candidates', in place; return whether there are."""
        shape = (self.population, self.episodes)
        scores = (
            played.success
            - self.loss_price * played.losses / (1.0 + played.losses)
            - self.step_price * played.steps / played.limit
        ).reshape(shape)
        solved = played.success.reshape(shape).any(axis=1)
        most = max(1, round(self.elite * self.population))
        best = np.argsort(np.where(solved, -scores.mean(axis=1), np.inf), kind="stable")[: min(most, int(solved.sum()))]
        if not len(best):
            return False
        # the better of the best count for more (the weights of Hansen & Ostermeier 2001, CMA-ES)
        share = np.log(len(best) + 0.5) - np.log(np.arange(1, len(best) + 1))
        share /= share.sum()
        rate = self.rate * len(best) / most
        for vector, drawn in zip(mean, candidates, strict=True):
            vector *= 1.0 - rate
            # added one by one: a BLAS product's last bit depends on the processor
            vector += rate * (share[:, None, None] * drawn[best]).sum(axis=0)
        return True


_DRAWS = 0x5EA2C4  # keeps the candidates' random numbers apart from all trials'


def marginals(task: Task, weights: Floats) -> list[Floats]:
    """Return how probable each value of each output variable is at each input: one float64 (S, k) per variable.

    Parameters
    ----------
    task : Task
        What the weights are of.
    weights : float64 (S, A)
        Not negative. A row of zeros means that all outputs are equally probable.
    """
    rows = np.where(weights.sum(axis=1, keepdims=True) > 0, weights, 1.0)
    cube = (rows / rows.sum(axis=1, keepdims=True)).reshape(len(rows), *map(len, task.outputs))
    axes = range(1, cube.ndim)
    return [cube.sum(axis=tuple(other for other in axes if other != axis)) for axis in axes]


def product(vectors: Sequence[Floats]) -> Floats:
    """Return the table(s), float64 (…, S, A), whose output variables are drawn independently of each other."""
    table = vectors[0]
    for vector in vectors[1:]:
        table = (table[..., :, None] * vector[..., None, :]).reshape(*table.shape[:-1], -1)
    return np.ascontiguousarray(table)


def _around(vector: Floats, concentration: float, n: int, rng: np.random.Generator) -> Floats:
    """Draw ``n`` candidates around probability vectors, float64 (S, k), each from a Dirichlet distribution."""
    drawn = rng.standard_gamma(np.maximum(concentration * vector, 1e-3), size=(n, *vector.shape)) + 1e-300
    return np.asarray(drawn / drawn.sum(axis=-1, keepdims=True))


def _cut(vector: Floats, cutoff: float) -> Floats:
    """Return probability vectors without what is less probable than ``cutoff`` and than the most probable."""
    kept = np.where((vector < cutoff) & (vector < vector.max(axis=1, keepdims=True)), 0.0, vector)
    return np.asarray(kept / kept.sum(axis=1, keepdims=True))


def _flat(outcomes: Outcomes) -> Outcomes:
    """Return outcomes of many policies (P, n) as one row of episodes, policy by policy."""
    columns = {f.name: getattr(outcomes, f.name) for f in fields(outcomes)}
    arrays = {name: column for name, column in columns.items() if isinstance(column, np.ndarray)}
    flat: dict[str, Any] = {name: array.reshape(-1, *array.shape[2:]) for name, array in arrays.items()}
    return replace(outcomes, **flat)
