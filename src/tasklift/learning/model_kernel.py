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
def trial(arrays, rows, columns, values, visits, settings, rng, epsilon, learn):
    """Run one trial of value learning; ``values`` and ``visits``, float64 (S, a), change in place if
    ``learn``.

    Returns (steps, success, losses, return, state): the state is −1, or one whose row in ``rows`` (N,) is
    −1, which means that the world left the task; then the rest means nothing.
    """
    rule, least, power, discount, temperature = settings
    probabilities = np.empty(values.shape[1])
    sarsa = learn and rule == 1
    state = branch(arrays.start_upto, rng.random())
    row = rows[state]
    if row < 0:
        return 0, False, 0, 0.0, state
    _probabilities(values[row], epsilon, temperature, probabilities)
    column = _draw(probabilities, rng.random())
    steps, losses, total = 0, 0, 0.0
    while True:
        output = columns[column]
        k = branch(arrays.upto[state, output], rng.random())
        reward = arrays.reward[state, output, k]
        ended = arrays.ended[state, output, k]
        success = arrays.success[state, output, k]
        steps += 1
        losses += arrays.lost[state, output, k]
        total += reward
        state = arrays.after[state, output, k]
        after, then, target = -1, -1, reward
        if not ended:
            after = rows[state]
            if after < 0:
                return 0, False, 0, 0.0, state
            if sarsa:
                _probabilities(values[after], epsilon, temperature, probabilities)
                then = _draw(probabilities, rng.random())
                target += discount * values[after, then]
            elif rule == 0:
                target += discount * values[after].max()
            else:
                _probabilities(values[after], epsilon, temperature, probabilities)
                mean = 0.0
                for i in range(len(probabilities)):
                    mean += probabilities[i] * values[after, i]
                target += discount * mean
        if learn:
            visits[row, column] += 1
            size = _step_size(visits[row, column], least, power)
            values[row, column] += size * (target - values[row, column])
        if ended or steps >= arrays.limit:
            return steps, success, losses, total, -1
        if not sarsa:
            _probabilities(values[after], epsilon, temperature, probabilities)
            then = _draw(probabilities, rng.random())
        row, column = after, then
