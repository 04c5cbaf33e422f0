"""Other people's learners take the building search (`make test-learners`)."""

from __future__ import annotations

import pytest
from ppo import guide, success

import tasklift as tl

pytestmark = [pytest.mark.slow, pytest.mark.filterwarnings("ignore")]
SMALL = "tasklift/SearchSmall-v0"


@pytest.mark.parametrize("observe", ["values", "onehot", "local"])
def test_stable_baselines3_checks_the_team(observe) -> None:
    checker = pytest.importorskip("stable_baselines3.common.env_checker")
    checker.check_env(tl.make(SMALL, api="team", observe=observe), warn=False)


def test_stable_baselines3_learns_to_search_as_the_guide_says() -> None:
    pytest.importorskip("stable_baselines3")
    names = guide()
    assert success(names["model"], names["search"](missions=500), seed=1) >= 0.5


def test_torchrl_checks_the_specs() -> None:
    pytest.importorskip("torchrl")
    from supersuit import black_death_v3
    from torchrl.envs import PettingZooWrapper
    from torchrl.envs.utils import check_env_specs

    env = black_death_v3(tl.make(SMALL, observe="onehot", act="flat"))
    check_env_specs(PettingZooWrapper(env, use_mask=True, done_on_any=False))


def test_rllibs_ppo_trains_with_its_defaults() -> None:
    pytest.importorskip("ray.rllib", exc_type=ImportError)
    import ray
    from ray.rllib.algorithms.ppo import PPOConfig
    from ray.rllib.env.wrappers.pettingzoo_env import ParallelPettingZooEnv
    from ray.tune.registry import register_env

    register_env("search", lambda _: ParallelPettingZooEnv(tl.make(SMALL, observe="onehot", act="flat")))
    ray.init(num_cpus=2, include_dashboard=False, log_to_driver=False)
    try:
        config = PPOConfig().environment("search").env_runners(num_env_runners=0)
        algorithm = config.multi_agent(policies={"all"}, policy_mapping_fn=lambda *_, **__: "all").build_algo()
        assert algorithm.train()["env_runners"]["num_episodes"] > 0
        algorithm.stop()
    finally:
        ray.shutdown()
