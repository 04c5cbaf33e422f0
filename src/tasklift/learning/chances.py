"""Random numbers keyed by seed, stage and trial, so that no trial depends on what ran before it."""

from __future__ import annotations

from typing import Any

import numpy as np

SWEEP_STAGE = 1
TARGET_STAGE = 2
BUDGET_STAGE = 3
DRILL_STAGE = 4
GREEDY_STAGE = 5
CERTIFY_STAGE = 6
CHOICE_STAGE = 7
FULL_DRILL_STAGE = 8
"""Stages are part of every random key, so that two stages of an experiment never share random numbers."""


class Chances:
    """The random numbers of a stage's trials, keyed by seed, stage and trial: not by what ran before.

    Counter-based (Philox), so going to a trial costs next to nothing. :meth:`of` always returns the same generator
    object, which is good until the next trial is asked for.

    Parameters
    ----------
    seed, stage
        The key.

    Examples
    --------
    >>> chances = Chances(seed=0, stage=2)
    >>> first, second = (chances.of(trial).random() for trial in (0, 1))
    >>> chances.of(0).random() == first
    True
    """

    def __init__(self, seed: int, stage: int) -> None:
        self._philox = np.random.Philox()
        self._generator = np.random.Generator(self._philox)
        self._state: Any = self._philox.state
        self._state["state"]["key"][:] = (seed % 2**64, stage)
        self._state |= {"buffer_pos": 4, "has_uint32": 0, "uinteger": 0}  # nothing left over from before

    def of(self, trial: int) -> np.random.Generator:
        """Return the generator, at the beginning of a trial."""
        self._state["state"]["counter"][:] = (0, trial, 0, 0)
        self._philox.state = self._state
        return self._generator
