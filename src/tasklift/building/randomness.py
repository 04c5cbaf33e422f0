"""Counter-based randomness: every draw is a hash of a key and an address, compiled into the kernel.

A trial's key is the hash of (seed, map, stage, trial), an address is (robot, purpose, number). Nothing depends on
threads, batches or what other robots drew.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numba import njit

# Nothing here allocates, so no array's references need counting: left on, Numba's atomic counters take half of the
# time. The option is private to Numba but used in its own sources; without it all is the same, only slower.
# And nothing divides by zero, so no division needs a check.
UNCHECKED: dict[str, Any] = {"_nrt": False, "error_model": "numpy"}
# What Python does not call. Without the wrappers for that, everything compiles in half the time.
INNER: dict[str, Any] = {"no_cpython_wrapper": True, "no_cfunc_wrapper": True, **UNCHECKED}
_INLINED: dict[str, Any] = {"forceinline": True}
inline = njit(**_INLINED, **INNER)

# the purpose of a draw; those of other sensors are 8 and above
OUTPUT_DRAW, EDGE_DRAW, GREEDY_COIN, PLACE_DRAW, DETECTOR_DRAW = 0, 1, 2, 3, 4

GOLDEN = np.uint64(0x9E3779B97F4A7C15)
FIRST = np.uint64(0xBF58476D1CE4E5B9)
_SECOND = np.uint64(0x94D049BB133111EB)


@inline
def mix(z):
    """Return the finaliser of SplitMix64 (Steele, Lea & Flood, OOPSLA 2014) of a uint64."""
    z = (z ^ (z >> np.uint64(30))) * FIRST
    z = (z ^ (z >> np.uint64(27))) * _SECOND
    return z ^ (z >> np.uint64(31))


@inline
def absorb(key, value):
    """Return the uint64 ``key`` with one more 64-bit ``value`` hashed into it."""
    return mix(key ^ mix(np.uint64(value) + GOLDEN))


@inline
def uniform(key, robot, purpose, number):
    """Return draw ``number`` of ``robot`` for ``purpose``: a float64 in [0, 1)."""
    address = (np.uint64(robot) << np.uint64(40)) | (np.uint64(purpose) << np.uint64(32)) | np.uint64(number)
    return np.float64(absorb(key, address) >> np.uint64(11)) * 1.1102230246251565e-16  # 2 ** -53
