"""BenchMARL's IPPO trains on the building search (`make test-learners`)."""

from __future__ import annotations

import pytest

import tasklift as tl

pytest.importorskip("benchmarl")

from benchmarl.algorithms import IppoConfig
from benchmarl.environments.pettingzoo.common import PettingZooClass
from benchmarl.experiment import Experiment, ExperimentConfig
from benchmarl.models import MlpConfig
from supersuit import black_death_v3
from torchrl.envs import PettingZooWrapper

pytestmark = [pytest.mark.slow, pytest.mark.filterwarnings("ignore")]


class Search(PettingZooClass):
    def get_env_fun(self, num_envs, continuous_actions, seed, device):
        return lambda: PettingZooWrapper(
            # TorchRL acts for the lost as well, which the environment refuses
            black_death_v3(tl.make("tasklift/SearchSmall-v0", observe="onehot", act="flat")),
            use_mask=True, categorical_actions=True, done_on_any=False, seed=seed, device=device,
        )  # fmt: skip

    def supports_continuous_actions(self) -> bool:
        return False

    def supports_discrete_actions(self) -> bool:
        return True

    def has_state(self) -> bool:
        return False

    def has_render(self, env) -> bool:
        return False

    def max_steps(self, env) -> int:
        return 600


def test_ippo_trains(tmp_path) -> None:
    config = ExperimentConfig.get_from_yaml()
    config.save_folder, config.loggers, config.create_json = str(tmp_path), [], False
    config.evaluation = config.render = config.prefer_continuous_actions = False
    config.max_n_frames, config.max_n_iters = None, 2
    config.on_policy_collected_frames_per_batch = 1000
    config.on_policy_n_minibatch_iters, config.on_policy_minibatch_size = 2, 250
    mlp = MlpConfig.get_from_yaml()
    experiment = Experiment(
        task=Search(name="SEARCH", config={}), algorithm_config=IppoConfig.get_from_yaml(), model_config=mlp,
        critic_model_config=mlp, seed=0, config=config,
    )  # fmt: skip
    experiment.run()
    assert experiment.n_iters_performed == 2
