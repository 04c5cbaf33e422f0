"""The spaces of an extended Stable-Baselines3 policy."""

from __future__ import annotations

from typing import Any

import numpy as np

from tasklift.errors import TaskliftError
from tasklift.networks.extension import Extension


def retell(policy: Any, extension: Extension) -> None:
    """Tell an extended policy how wide its observations and actions are."""
    from gymnasium import spaces

    def wider(space: Any, side: str) -> Any:
        variables = getattr(extension.target, side)
        if isinstance(space, spaces.Discrete):
            count = int(np.prod([len(v) for v in variables]))
            if side == "inputs" and count != extension.inputs.size:
                raise TaskliftError(
                    f"extend_module: {space} is seen as {space.n} columns, and would be as {count}, where the layers "
                    f"have {extension.inputs.size}; use a MultiDiscrete space, one number for each input"
                )
            return spaces.Discrete(count)
        if isinstance(space, spaces.MultiDiscrete):
            return spaces.MultiDiscrete([len(v) for v in variables])
        if isinstance(space, spaces.MultiBinary):
            return spaces.MultiBinary(extension.inputs.size)
        if isinstance(space, spaces.Box) and side == "inputs":
            low, high = (np.full(extension.inputs.size, edge, space.dtype) for edge in (-np.inf, np.inf))
            low[extension.inputs.old], high[extension.inputs.old] = space.low, space.high
            return spaces.Box(low, high, dtype=space.dtype.type)
        raise TaskliftError(f"extend_module: expected a discrete or Box space of {side}, found {space}")

    seen, done = wider(policy.observation_space, "inputs"), wider(policy.action_space, "outputs")
    for part in policy.modules():
        for name, space in (
            ("observation_space", seen), ("action_space", done), ("_observation_space", seen),
            ("features_dim", extension.inputs.size), ("_features_dim", extension.inputs.size),
        ):  # fmt: skip
            if name in vars(part):
                setattr(part, name, space)
    dist: Any = getattr(policy, "action_dist", None)
    if hasattr(dist, "action_dims"):
        dist.action_dims = list(done.nvec)
    if hasattr(dist, "action_dim"):
        dist.action_dim = int(getattr(done, "n", 0))
