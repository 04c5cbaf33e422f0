"""Stable-Baselines3 models go on with a larger task: the same evaluation to the digit, and then they learn."""

from __future__ import annotations

import runpy
from pathlib import Path

import numpy as np
import pytest

from tasklift.errors import TaskliftError
from tasklift.learning.guard import Guard, Watch
from tasklift.tasks.policy import swap
from tasklift.tasks.task import Task, Variable

torch = pytest.importorskip("torch")
sb3 = pytest.importorskip("stable_baselines3")
import gymnasium  # noqa: E402
from gymnasium import spaces  # noqa: E402
from stable_baselines3.common.evaluation import evaluate_policy  # noqa: E402
from stable_baselines3.common.preprocessing import get_flattened_obs_dim  # noqa: E402
from stable_baselines3.common.torch_layers import BaseFeaturesExtractor  # noqa: E402
from stable_baselines3.common.vec_env import DummyVecEnv, VecNormalize  # noqa: E402

from tasklift.networks.sb3 import extend_model, guard_callback, vec_normalize  # noqa: E402

pytestmark = pytest.mark.filterwarnings("ignore")  # other people's
FULL = Task(
    "corridor",
    (Variable("alarm", (0, 1)), Variable("place", tuple(range(6)))),
    (Variable("go", ("left", "right", "wait")),),
)
SOURCE = FULL.simplify(fix={"alarm": 0}, restrict={"go": ["left", "right"]})


class Corridor(gymnasium.Env):
    """Six places; the last one is home. On the full task there is an alarm, which means nothing yet."""

    def __init__(self, full: bool, box: bool = False) -> None:
        sizes = [2, 6] if full else [6]
        self.full, self.box = full, box
        high = np.array([n - 1.0 for n in sizes], dtype=np.float32)
        self.observation_space = spaces.Box(0 * high, high) if box else spaces.MultiDiscrete(sizes)
        self.action_space = spaces.Discrete(3 if full else 2)

    def see(self):
        seen = [0, self.place] if self.full else [self.place]
        return np.array(seen, dtype=np.float32 if self.box else np.int64)

    def reset(self, *, seed=None, options=None):
        super().reset(seed=seed)
        self.place, self.steps = int(self.np_random.integers(5)), 0
        return self.see(), {}

    def step(self, action):
        noise = self.np_random.random() < 0.1
        move = (-1, 1, 0)[int(action)]
        self.place = int(np.clip(self.place + (0 if noise else move), 0, 5))
        self.steps += 1
        return self.see(), -1.0 + 0.01 * self.place, self.place == 5, self.steps >= 30, {}


def seeded(env):
    env.seed(7)
    return env


def score(model, env):
    return evaluate_policy(model, seeded(env), n_eval_episodes=20, return_episode_rewards=True, warn=False)


@pytest.mark.parametrize("kind", ["PPO", "A2C", "DQN"])
@pytest.mark.parametrize("box", [False, True])
def test_a_model_goes_on_where_it_was(kind, box) -> None:
    torch.set_num_threads(1)
    small, large = DummyVecEnv([lambda: Corridor(False, box)]), DummyVecEnv([lambda: Corridor(True, box)])
    more = {"n_steps": 64} if kind != "DQN" else {"buffer_size": 500, "learning_starts": 50}
    model = getattr(sb3, kind)("MlpPolicy", small, seed=1, device="cpu", **more)
    model.learn(300)
    wide = extend_model(model, large, SOURCE, FULL)
    assert score(wide, large) == score(model, small)
    old = {n: p.clone() for n, p in wide.policy.named_parameters()}
    wide.learn(300, reset_num_timesteps=False)
    assert any(not torch.equal(p, old[n]) for n, p in wide.policy.named_parameters())
    assert wide.num_timesteps >= 600 if kind != "DQN" else wide.replay_buffer.size() > 500 - 1
    with pytest.raises(TaskliftError, match="expected an environment with the observation space"):
        extend_model(model, small, SOURCE, FULL)


class Extractor(BaseFeaturesExtractor):
    def __init__(self, space) -> None:
        super().__init__(space, 32)
        self.net = torch.nn.Sequential(torch.nn.Linear(get_flattened_obs_dim(space), 32), torch.nn.ReLU())

    def forward(self, x):
        return self.net(x)


@pytest.mark.parametrize(
    "more",
    [
        {"net_arch": []},
        {"net_arch": {"pi": [], "vf": [16]}},
        {"features_extractor_class": Extractor},
        {"features_extractor_class": Extractor, "share_features_extractor": False},
        {"optimizer_class": torch.optim.SGD, "optimizer_kwargs": {"momentum": 0.9}},
    ],
    ids=str,
)
def test_policies_of_many_kinds_go_on(more) -> None:
    small, large = DummyVecEnv([lambda: Corridor(False)]), DummyVecEnv([lambda: Corridor(True)])
    model = sb3.PPO("MlpPolicy", small, n_steps=64, seed=1, device="cpu", policy_kwargs=more).learn(100)
    wide = extend_model(model, large, SOURCE, FULL)
    assert score(wide, large) == score(model, small)
    wide.learn(100)


def test_what_is_not_a_model_or_has_another_space_is_refused() -> None:
    class Number(gymnasium.ObservationWrapper):
        observation_space = spaces.Discrete(6)

        def observation(self, seen):
            return int(seen[0])

    env = DummyVecEnv([lambda: Number(Corridor(False))])
    model = sb3.PPO("MlpPolicy", env, n_steps=64, device="cpu")
    with pytest.raises(TaskliftError, match=r"Discrete\(6\) is seen as 6 columns, and would be as 12"):
        extend_model(model, env, SOURCE, FULL)
    with pytest.raises(TaskliftError, match="expected a model of Stable-Baselines3, found ActorCriticPolicy"):
        extend_model(model.policy, env, SOURCE, FULL)


def test_statistics_of_vec_normalize_follow() -> None:
    small = VecNormalize(DummyVecEnv([lambda: Corridor(False, True)]))
    large = VecNormalize(DummyVecEnv([lambda: Corridor(True, True)]))
    model = sb3.PPO("MlpPolicy", small, n_steps=64, seed=1, device="cpu").learn(300)
    wide = extend_model(model, large, SOURCE, FULL)
    vec_normalize(wide.policy.extension, small, large)
    small.training = large.training = False
    assert score(wide, large) == score(model, small)


def test_a_model_with_a_prior_learns_and_differs_only_where_it_says() -> None:
    small, large = DummyVecEnv([lambda: Corridor(False)]), DummyVecEnv([lambda: Corridor(True)])
    model = sb3.PPO("MlpPolicy", small, n_steps=64, seed=1, device="cpu").learn(300)
    wide = extend_model(model, large, SOURCE, FULL, [swap("go", ("left", "right"), {"alarm": 1})])
    assert score(wide, large) == score(model, small)
    for place in range(6):
        calm, _ = wide.predict(np.array([0, place]), deterministic=True)
        alarmed, _ = wide.predict(np.array([1, place]), deterministic=True)
        assert {int(calm), int(alarmed)} == {0, 1}
    wide.learn(200)


def test_the_guard_stops_a_training_that_hurts() -> None:
    watch = Watch(Guard("return"))
    for _ in range(60):
        watch.episode("control", returned=100.0)
    env = DummyVecEnv([lambda: gymnasium.wrappers.RecordEpisodeStatistics(Corridor(True))])
    model = sb3.PPO("MlpPolicy", env, n_steps=64, seed=1, device="cpu")
    model.learn(5_000, callback=guard_callback(watch, "transferred"))
    assert watch.verdict == "hurts"
    assert model.num_timesteps < 5_000
    with pytest.raises(TaskliftError, match="transferred or control"):
        watch.episode("other")


def test_with_a_line_of_prior_knowledge_a_noisy_detector_saves_robots() -> None:
    torch.set_num_threads(1)
    figures = runpy.run_path(str(Path(__file__).parents[2] / "benchmarks" / "detector.py"))["figures"]
    lost = {arm: found[0] for arm, found in figures("tasklift/SearchSmall-v0", seed=1, steps=5_000).items()}
    assert lost["simple task"] == 0
    assert 0 < 3 * lost["extended, prior"] < lost["from scratch"]
