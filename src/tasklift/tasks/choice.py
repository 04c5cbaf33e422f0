"""Choosing by weight or value, and reinforcing: the scalar functions, each written once.

Plain Python over a row of weights (a 1-D float64 array), with nothing but loops,
arithmetic and ``len``: :mod:`tasklift.tasks.policy` calls these functions as they are, and the simulator's kernel
compiles the same source (``numba.njit(choice.draw)``). No checks are made here: rows have at least one entry,
weights are finite and not negative, and ``u`` and ``coin`` lie in [0, 1).
"""

# No `from __future__` and no annotations on purpose: this file is compiled as it stands.
from math import exp, inf


def total(weights, n):  # type: ignore[no-untyped-def]
    """Return the sum of the first ``n`` weights, added from left to right (the order counts)."""
    result = 0.0
    for i in range(n):
        result += weights[i]
    return result


def draw(weights, u):  # type: ignore[no-untyped-def]
    """Return an index drawn in proportion to its weight ("exploration", section V of the paper).

    A row that is all zero draws evenly. An index of weight zero is never returned while another has more,
    also where rounding puts ``u`` times the sum at or past the end of the running sum.
    """
    n = len(weights)
    added = 0.0
    for i in range(n):
        added += weights[i]
    if added <= 0.0:
        even = int(u * n)
        return even if even < n else n - 1
    target = u * added
    running = 0.0
    for i in range(n):
        running += weights[i]
        if target < running:
            return i
    last = n - 1
    while weights[last] <= 0.0:
        last -= 1
    return last


def room_for_sums(n):  # type: ignore[no-untyped-def]
    """Return how many numbers :func:`sum_up` keeps for ``n`` weights."""
    return (n // 8 + 1) * 8 + (n // 64 + 1) * 8


def sum_up(weights, sums, first):  # type: ignore[no-untyped-def]
    """Bring the running sums of the weights up to date from entry ``first`` on.

    The last sum of each full block of eight is kept once more, behind all sums. What is not used there is infinite.
    """
    running = sums[first - 1] if first > 0 else 0.0
    for i in range(first, len(weights)):
        running += weights[i]
        sums[i] = running
    lasts = len(weights) // 8 * 8 + 8
    for block in range(first // 8, len(weights) // 8):
        sums[lasts + block] = sums[8 * block + 7]


def draw_summed(weights, sums, u):  # type: ignore[no-untyped-def]
    """Return what :func:`draw` returns, given what :func:`sum_up` keeps.

    Weights are not negative, so the sums do not fall: the index is the number of sums at or below the target. Counting
    takes no branch that a processor could guess wrong.
    """
    n = len(weights)
    if rarely(sums[n - 1] <= 0.0):
        even = int(u * n)
        return even if even < n else n - 1
    target = u * sums[n - 1]
    lasts = n // 8 * 8 + 8
    block = at_or_below(sums, lasts, target)
    following = 8
    while rarely(block == following):
        block += at_or_below(sums, lasts + block, target)
        following += 8
    found = 8 * block + at_or_below(sums, 8 * block, target)
    if rarely(found >= n):
        found = n - 1
        while weights[found] <= 0.0:
            found -= 1
    return found


def at_or_below(rising, first, target):  # type: ignore[no-untyped-def]
    """Return how many of eight numbers that do not fall, from entry ``first`` on, are at or below ``target``."""
    found = 0
    for i in range(first, first + 8):
        found += rising[i] <= target
    return found


def rarely(condition):  # type: ignore[no-untyped-def]
    """Return the condition. Compiled, the code is laid out for it to be false: see ``building/bits.py``."""
    return condition


def heaviest(weights, u):  # type: ignore[no-untyped-def]
    """Return the index of the largest weight ("exploitation"); ``u`` decides evenly between equal ones."""
    n = len(weights)
    most = weights[0]
    equals = 0
    for i in range(n):
        if weights[i] > most:
            most = weights[i]
            equals = 1
        elif weights[i] == most:
            equals += 1
    skip = int(u * equals)
    if skip >= equals:
        skip = equals - 1
    for i in range(n):
        if weights[i] == most:
            if skip == 0:
                return i
            skip -= 1
    return n - 1


def select(weights, greedy, coin, u):  # type: ignore[no-untyped-def]
    """Return the heaviest index if ``coin < greedy``, else one drawn by weight ("pseudo-random sampling").

    ``greedy`` is the paper's q: 0 is exploration, 1 is exploitation. (A compiler that cannot call plain
    functions compiles :func:`heaviest` and :func:`draw` and writes this line itself.)
    """
    return heaviest(weights, u) if coin < greedy else draw(weights, u)


def reinforce(weight, signal, floor):  # type: ignore[no-untyped-def]
    """Return ``weight`` changed by ``signal``, never below ``floor``."""
    changed = weight + signal
    return changed if changed > floor else floor


def time_inverted(reward, steps, limit):  # type: ignore[no-untyped-def]
    """Return the signal of the time taken: ``reward`` × (1 − steps / limit), all of it for no time at all."""
    return reward * (1.0 - steps / limit)


def time_baseline(reward, steps, limit, mean_steps):  # type: ignore[no-untyped-def]
    """Return the signal of the time taken against a running mean; 0 while there is none (``mean_steps`` below 0)."""
    return 2.0 * reward * (mean_steps - steps) / limit if mean_steps >= 0.0 else 0.0


def probabilities(values, epsilon, temperature, out):  # type: ignore[no-untyped-def]
    """Fill ``out`` with the probability of each index under ε-greedy (temperature 0) or softmax choice, by value.

    A share ``epsilon`` is even over all; the rest goes to the largest values, evenly among equal ones, or,
    with a temperature above 0, in proportion to exp(value / temperature). A value of −inf is never chosen; one
    at least must be more.
    """
    n = len(values)
    most = values[0]
    possible = 0
    for i in range(n):
        if values[i] > most:
            most = values[i]
        if values[i] > -inf:
            possible += 1
    added = 0.0
    for i in range(n):
        if temperature > 0.0:
            out[i] = exp((values[i] - most) / temperature)
        else:
            out[i] = 1.0 if values[i] == most else 0.0
        added += out[i]
    for i in range(n):
        out[i] = (1.0 - epsilon) * out[i] / added + (epsilon / possible if values[i] > -inf else 0.0)


def step_size(visits, least, power):  # type: ignore[no-untyped-def]
    """Return the step size of a visit: ``least``, or visits ** -power if that is more and power is not 0."""
    if power == 0.0:
        return least
    size = visits**-power
    return size if size > least else least
