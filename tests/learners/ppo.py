"""How well the guide's PPO does: its greedy success on missions that it was not trained on.

Every seed trains for 4 million steps with the code of docs/learners.md. `make test-learners` sets up what it needs.
"""

from __future__ import annotations

import argparse
import re
import time
from pathlib import Path
from typing import Any

import numpy as np

GUIDE = Path(__file__).parents[2] / "docs" / "learners.md"


def guide(blocks: int | None = None) -> dict[str, Any]:
    """Run the guide's code for Stable-Baselines3, or its first blocks, and return its names."""
    names: dict[str, Any] = {}
    exec("\n".join(re.findall(r"```py\n(.*?)```", GUIDE.read_text(), re.DOTALL)[:blocks]), names)
    return names


def success(model: Any, env: Any, seed: int) -> float:
    """Return the share of missions whose first episode succeeds with the most probable actions."""
    robots = env.mission.n_robots
    seen = env.reset(seed=seed)[0]
    going = np.ones(env.num_envs // robots, bool)
    won = ~going
    while going.any():
        seen, *_, info = env.step(model.predict(seen, deterministic=True)[0])
        if "success" in info:
            won |= going & info["success"][::robots]
            going &= ~info["_success"][::robots]
    return float(won.mean())


def main() -> None:
    import torch
    from scipy.stats import sem, t

    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--seeds", type=int, nargs="+", default=[0, 1, 2, 3, 4, 5])
    parser.add_argument("--steps", type=int, default=4_000_000)
    args = parser.parse_args()
    torch.set_num_threads(1)
    names, found = guide(blocks=1), []
    for seed in args.seeds:
        start = time.process_time()
        model = names["train"](seed, args.steps)
        spent = time.process_time() - start
        found.append(success(model, names["search"](missions=1000), seed=10**6 + seed))
        print(f"seed {seed}: {spent:.0f} s of processor time, greedy success {found[-1]:.3f}", flush=True)
    low, high = t.interval(0.95, len(found) - 1, np.mean(found), sem(found))
    print(f"mean {np.mean(found):.3f}, 95 % interval {low:.3f} to {high:.3f}")


if __name__ == "__main__":
    main()
