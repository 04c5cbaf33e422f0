"""Steps of living robots per second of processor time through the environments, with 15 robots that act at random."""

from __future__ import annotations

import time

import numpy as np

import tasklift as tl

NAME, ROUNDS = "tasklift/Search-v0", 7


def parallel() -> float:
    env = tl.make(NAME, observe="onehot", act="flat")
    rng, steps = np.random.default_rng(0), 0
    choices = [dict(zip(env.possible_agents, rng.integers(22, 44, 15).tolist(), strict=True)) for _ in range(64)]
    env.reset(seed=0)
    start = time.process_time()
    for actions in choices * 30:
        if len(env.agents) < 12:  # most steps of careful teams are made by all
            env.reset()
        steps += len(env.agents)
        env.step({agent: actions[agent] for agent in env.agents})
    return steps / (time.process_time() - start)


def vector(missions: int) -> float:
    env = tl.make(NAME, api="vector", observe="onehot", act="flat", missions=missions)
    rng, steps = np.random.default_rng(0), 0
    choices = rng.integers(22, 44, (8, env.num_envs))
    env.reset(seed=0)
    start = time.process_time()
    for actions in choices[np.arange(40_000 // missions) % 8]:
        steps += int(env.step(actions)[4]["alive"].sum())
    return steps / (time.process_time() - start)


def main() -> None:
    for name, measure in (
        ("ParallelEnv", parallel),
        ("VectorEnv, 64 missions", lambda: vector(64)),
        ("VectorEnv, 1,024 missions", lambda: vector(1024)),
        ("VectorEnv, 4,096 missions", lambda: vector(4096)),
    ):
        found = sorted(measure() for _ in range(ROUNDS))
        print(f"{name:28s} median {found[ROUNDS // 2]:12,.0f}, best {found[-1]:12,.0f} agent-steps per second and core")


if __name__ == "__main__":
    main()
