# mypy: disallow-untyped-defs=False
"""The compiled trial of value learning on an explicit model; imported only when one is run.

No checks are made here; :class:`tasklift.learning.model.Model` makes them. Shapes: ``N`` states, ``A`` outputs of the
world, ``K`` branches of a transition; ``S × a`` the table that is learned.
"""

from typing import Any, NamedTuple

import numpy as np
from numba import njit

from tasklift.tasks import choice as rules

_draw = njit(rules.draw)
_probabilities = njit(rules.probabilities)
_step_size = njit(rules.step_size)


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


@njit(cache=True)
def branch(upto, u):
    """Return the first index whose running sum exceeds ``u``."""
    k = 0
    while u >= upto[k]:
        k += 1
    return k


@njit(cache=True)
def look(values, row, possible, seen):
    """Fill ``seen`` (a,) with a row of values, −inf where an output is not possible; return the largest."""
    most = -np.inf
    for i in range(len(seen)):
        seen[i] = values[row, i] if possible[i] else -np.inf
        if seen[i] > most:
            most = seen[i]
    return most


@njit(cache=True)
def choose(values, row, possible, settings, epsilon, u, seen, likely):
    """Return the output that is chosen at a row with the random number ``u``."""
    look(values, row, possible, seen)
    _probabilities(seen, epsilon, settings[4], likely)
    return _draw(likely, u)


@njit(cache=True)
def follow(
    values, visits, settings, row, column, reward, lost, after, last, possible, epsilon, u, learn, seen, likely
):
    """Learn from one step, and choose the next output with ``u``; the arrays change in place if ``learn``.

    ``after`` is the next row, −1 if the trial has ended; ``last``: it goes no further, ended or cut off. ``possible``
    (a,) are the outputs possible there, ``seen`` and ``likely`` (a,) scratch. Returns −1 where none is chosen.
    """
    rule, least, power, discount, _, penalty = settings
    sarsa = learn and rule == 1
    target, then = reward - penalty * lost, -1
    if after >= 0:
        if sarsa:
            then = choose(values, after, possible, settings, epsilon, u, seen, likely)
            target += discount * values[after, then]
        elif rule == 0:
            target += discount * look(values, after, possible, seen)
        else:
            choose(values, after, possible, settings, epsilon, u, seen, likely)
            mean = 0.0
            for i in range(len(likely)):
                if likely[i] > 0.0:
                    mean += likely[i] * seen[i]
            target += discount * mean
    if learn:
        visits[row, column] += 1
        size = _step_size(visits[row, column], least, power)
        values[row, column] += size * (target - values[row, column])
    if not last and not sarsa:
        then = choose(values, after, possible, settings, epsilon, u, seen, likely)
    return then


@njit(cache=True)
def trial(arrays, rows, columns, values, visits, settings, rng, epsilon, learn):
    """Run one trial of value learning; ``values`` and ``visits``, float64 (S, a), change in place if
    ``learn``.

    Returns (steps, success, losses, return, state): the state is −1, or one whose row in ``rows`` (N,) is
    −1, which means that the world left the task; then the rest means nothing.
    """
    seen, likely = np.empty(values.shape[1]), np.empty(values.shape[1])
    possible = np.ones(values.shape[1], np.bool_)
    sarsa = learn and settings[0] == 1
    state = branch(arrays.start_upto, rng.random())
    row = rows[state]
    if row < 0:
        return 0, False, 0, 0.0, state
    column = choose(values, row, possible, settings, epsilon, rng.random(), seen, likely)
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
        column = follow(
            values, visits, settings, row, column, reward, lost, after, last, possible, epsilon, u, learn, seen, likely
        )
        if last:
            return steps, success, losses, total, -1
        row = after
