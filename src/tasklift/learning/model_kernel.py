# mypy: disallow-untyped-defs=False
"""The compiled trial of value learning on an explicit model; imported only when one is run.

No checks are made here; :class:`tasklift.learning.model.Model` makes them. Shapes: ``N`` states, ``A`` outputs of the
world, ``K`` branches of a transition; ``S × a`` the table that is learned.

Functions that are called from Python at every step take few arguments, because each one costs time: a learner's
numbers are one array (``settings``), and so are its rows of scratch (``scratch``, float64 (2, a)).
"""

from typing import Any, NamedTuple

import numpy as np
from numba import njit

from tasklift.compiled import keep
from tasklift.tasks import choice as rules

COMPILED_IN = (rules,)
_entry = keep(*COMPILED_IN)
_draw = njit(rules.draw)
_probabilities = njit(rules.probabilities)
_step_size = njit(rules.step_size)


#: What the numbers of a learner's ``settings`` are, float64 (8,).
RULE, LEAST_STEP, STEP_POWER, DISCOUNT, TEMPERATURE, PENALTY, EPSILON, LEARN = range(8)


class Arrays(NamedTuple):
    """A model as arrays; ``upto`` are running sums of probabilities, the last one raised above 1."""

    start_upto: Any  # float64 (N,)
    upto: Any  # float64 (N, A, K)
    after: Any  # int64 (N, A, K)
    reward: Any  # float64 (N, A, K)
    ended: Any  # bool (N, A, K)
    lost: Any  # int64 (N, A, K)
    success: Any  # bool (N, A, K)
    limit: int


@_entry
def branch(upto, u):
    """Return the first index whose running sum exceeds ``u``."""
    k = 0
    while u >= upto[k]:
        k += 1
    return k


@_entry
def look(values, row, possible, seen):
    """Fill ``seen`` (a,) with a row of values, −inf where an output is not possible; return the largest."""
    most = -np.inf
    for i in range(len(seen)):
        seen[i] = values[row, i] if possible[i] else -np.inf
        if seen[i] > most:
            most = seen[i]
    return most


@_entry
def choose(values, settings, row, possible, u, scratch):
    """Return the output that is chosen at a row with the random number ``u``; −1 if none is possible."""
    if look(values, row, possible, scratch[0]) == -np.inf:
        return -1
    _probabilities(scratch[0], settings[EPSILON], settings[TEMPERATURE], scratch[1])
    return _draw(scratch[1], u)


@_entry
def follow(values, visits, settings, row, column, reward, lost, after, last, possible, u, scratch):
    """Learn from one step, and choose the next output with ``u``; ``values`` and ``visits`` change in place.

    ``after`` is the next row, −1 if the trial has ended; ``last``: it goes no further, ended or cut off. ``possible``
    (a,) are the outputs possible there. Returns −1 where none is chosen. A trial that is cut off where no output is
    possible is worth nothing beyond.
    """
    rule, learn = settings[RULE], settings[LEARN] != 0.0
    sarsa = learn and rule == 1.0
    then = -1
    worth = look(values, after, possible, scratch[0]) if after >= 0 else -np.inf
    if worth > -np.inf and rule != 0.0:
        then = choose(values, settings, after, possible, u, scratch)
        if sarsa:
            worth = values[after, then]
        else:
            worth = 0.0
            for i in range(len(possible)):
                if scratch[1, i] > 0.0:
                    worth += scratch[1, i] * scratch[0, i]
    if learn:
        target = reward - settings[PENALTY] * lost
        if worth > -np.inf:
            target += settings[DISCOUNT] * worth
        visits[row, column] += 1
        size = _step_size(visits[row, column], settings[LEAST_STEP], settings[STEP_POWER])
        values[row, column] += size * (target - values[row, column])
    if sarsa or last:
        return then
    return choose(values, settings, after, possible, u, scratch)


@_entry
def trial(arrays, rows, columns, values, visits, settings, rng):
    """Run one trial of value learning; ``values`` and ``visits``, float64 (S, a), change in place if it learns.

    Returns (steps, success, losses, return, state): the state is −1, or one whose row in ``rows`` (N,) is
    −1, which means that the world left the task; then the rest means nothing.
    """
    scratch = np.empty((2, values.shape[1]))
    possible = np.ones(values.shape[1], np.bool_)
    sarsa = settings[LEARN] != 0.0 and settings[RULE] == 1.0
    state = branch(arrays.start_upto, rng.random())
    row = rows[state]
    if row < 0:
        return 0, False, 0, 0.0, state
    column = choose(values, settings, row, possible, rng.random(), scratch)
    steps, losses, total = 0, 0, 0.0
    while True:
        output = columns[column]
        k = branch(arrays.upto[state, output], rng.random())
        reward, lost = arrays.reward[state, output, k], arrays.lost[state, output, k]
        ended = arrays.ended[state, output, k]
        success = arrays.success[state, output, k]
        steps += 1
        losses += lost
        total += reward
        state = arrays.after[state, output, k]
        last = ended or steps >= arrays.limit
        after = -1
        if not ended:
            after = rows[state]
            if after < 0:
                return 0, False, 0, 0.0, state
        u = rng.random() if not last or (sarsa and not ended) else 0.0
        column = follow(values, visits, settings, row, column, reward, lost, after, last, possible, u, scratch)
        if last:
            return steps, success, losses, total, -1
        row = after
