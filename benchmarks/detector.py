"""A team gets a noisy detector of hostiles: what does PPO lose, extended with one line of prior knowledge?

    python benchmarks/detector.py                          5 robots in the small building
    python benchmarks/detector.py tasklift/Search-v0       15 robots in the large one

The figures of ``docs/networks.md``. One policy of Stable-Baselines3 acts for all robots. It first learns where nothing
is hidden, from two inputs. Then a hostile is hidden, and the robots sense danger, goal and the detector as well. Every
arm has the same settings, seeds and number of robot-steps on that task. The prior: on an alarm at a door, do not go on
with too few weapon robots. Needs the extra ``torch`` and stable-baselines3.

Each line: the arm, robots lost per seed in these steps, missions (episodes) that ended, and how many of them succeeded.
Then the ratio of losses to those of PPO from scratch, with a 95 % interval over seeds.
"""

from __future__ import annotations

import argparse
from typing import Any

import numpy as np
import torch
from stable_baselines3 import PPO
from stable_baselines3.common.vec_env import VecEnv

import tasklift as tl
from tasklift import stats
from tasklift.building import Mission
from tasklift.building.variables import TABLE_I, detector
from tasklift.envs.ids import mission_of
from tasklift.networks.sb3 import extend_model

ROBOTS, ROLLOUT = 40, 5_000
CAREFUL = tl.set_weight(0, {"ALARM": 1, "FTR": 4, "nWPN": [0, 1], "MV": 1})


class Robots(VecEnv):
    """Every robot of some missions as an environment of Stable-Baselines3; counts what is lost and solved."""

    def __init__(self, name: str, mission: Mission) -> None:
        options = {"mission": mission, "missions": ROBOTS // mission.n_robots, "observe": "onehot", "act": "flat"}
        self.env = tl.make(name, api="vector", **options)
        self.lost = self.ended = self.solved = 0
        super().__init__(self.env.num_envs, self.env.single_observation_space, self.env.single_action_space)

    def reset(self) -> np.ndarray:
        return self.env.reset(seed=self._seeds[0])[0]

    def step_async(self, actions: np.ndarray) -> None:
        self.actions = actions

    def step_wait(self) -> tuple[Any, ...]:
        seen, rewards, ended, cut, info = self.env.step(self.actions)
        solved, over = (info.get(name, np.zeros_like(ended)) for name in ("success", "_success"))
        self.lost += (ended & info["alive"] & ~solved).sum()
        self.ended += over.sum() // self.env.mission.n_robots
        self.solved += (over & solved).sum() // self.env.mission.n_robots
        infos: list[dict[str, Any]] = [{} for _ in ended]
        for i in np.flatnonzero(ended | cut):
            infos[i] = {"terminal_observation": info["final_obs"][i], "TimeLimit.truncated": bool(cut[i])}
        return seen, rewards.astype(np.float32), ended | cut, infos

    def close(self) -> None:
        self.env.close()

    def get_attr(self, attr_name: str, indices: Any = None) -> list[Any]:
        return [getattr(self.env, attr_name, None)] * self.num_envs

    def set_attr(self, attr_name: str, value: Any, indices: Any = None) -> None:
        setattr(self.env, attr_name, value)

    def env_method(self, method_name: str, *args: Any, indices: Any = None, **options: Any) -> list[Any]:
        return [getattr(self.env, method_name)(*args, **options)] * self.num_envs

    def env_is_wrapped(self, wrapper_class: Any, indices: Any = None) -> list[bool]:
        return [False] * self.num_envs


def figures(name: str, seed: int, steps: int) -> dict[str, tuple[int, int, int]]:
    """Return what each arm lost, ended and solved in its first steps on the full task, and the simple stage first."""
    known = mission_of(name)
    building, team = known.building, known.team
    simple = Mission(building, team, hostiles=0, inputs=["nWPN", "FTR"])
    full = Mission(building, team, inputs=[*TABLE_I, detector()])
    source = full.task.simplify(fix={"DL": 0, "GL": 0, "ALARM": 0})
    calm, worlds = Robots(name, simple), {}

    def ppo(env: Robots) -> PPO:
        options = {"n_steps": ROLLOUT // env.num_envs, "batch_size": 500, "gamma": 0.999, "ent_coef": 0.01}
        return PPO("MlpPolicy", env, seed=seed, device="cpu", **options)

    untrained, trained = ppo(calm), ppo(calm).learn(steps)
    for arm in ("from scratch", "extended", "extended, prior", "untrained, prior"):
        worlds[arm] = env = Robots(name, full)
        if arm == "from scratch":
            model = ppo(env)
        else:
            start, prior = (untrained if "untrained" in arm else trained), ([CAREFUL] if "prior" in arm else [])
            model = extend_model(start, env, source, full.task, prior)
        model.learn(steps)
    return {arm: (env.lost, env.ended, env.solved) for arm, env in {"simple task": calm, **worlds}.items()}


def main() -> None:
    """Compare the arms over seeds."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("name", nargs="?", default="tasklift/SearchSmall-v0")
    parser.add_argument("--seeds", type=int, default=20)
    parser.add_argument("--first-seed", type=int, default=0)
    parser.add_argument("--steps", type=int, default=100_000, help="robot-steps per stage, in whole rollouts")
    options = parser.parse_args()
    torch.set_num_threads(1)
    seeds = range(options.first_seed, options.first_seed + options.seeds)
    found = [figures(options.name, seed, options.steps) for seed in seeds]
    lost = {arm: np.array([one[arm][0] for one in found], dtype=float) for arm in found[0]}
    for arm in lost:
        ended, solved = np.mean([one[arm][1:] for one in found], axis=0)
        print(f"{arm}: {lost[arm].mean():.1f} robots lost, {ended:.1f} missions ended, {solved:.1f} of them solved")
    for arm in ("extended", "extended, prior", "untrained, prior"):
        ratio = stats.ratio(lost[arm], lost["from scratch"], reference=0.2)
        print(f"{arm} / from scratch: {ratio.interval}; at most a fifth: {ratio.verdict}")


if __name__ == "__main__":
    main()
