"""What of a Stable-Baselines3 training follows an extended policy: the model, normalisation, experience, a guard."""

from __future__ import annotations

from typing import Any

from tasklift.errors import TaskliftError
from tasklift.learning.guard import Watch
from tasklift.networks.extend import extend_module
from tasklift.networks.extension import Extension


def extend_model(model: Any, env: Any, source_task: Any, target_task: Any, prior: Any = (), **settings: Any) -> Any:
    """Return a copy of a PPO, A2C or DQN model for an environment of the target task; it goes on learning there.

    Parameters
    ----------
    model
        A model of Stable-Baselines3 with an ``MlpPolicy``; stays as it is.
    env
        An environment, or a vector of them, with the target task's spaces.
    source_task, target_task, prior, settings
        As of :func:`tasklift.networks.extend.extend_module`.

    Raises
    ------
    TaskliftError
        If the environment's spaces are not as wide as the extended policy.
    """
    if not hasattr(model, "policy"):
        raise TaskliftError(f"extend_model: expected a model of Stable-Baselines3, found {type(model).__name__}")
    settings.setdefault("outputs", "values" if hasattr(model.policy, "q_net") else "logits")
    policy = extend_module(model.policy, source_task, target_task, prior, **settings)
    extension: Extension = policy.extension
    vector = model._wrap_env(env, verbose=0)
    for side, space in (("observation", policy.observation_space), ("action", policy.action_space)):
        given = getattr(vector, f"{side}_space")
        if _width(given) != _width(space):
            raise TaskliftError(f"extend_model: expected an environment with the {side} space {space}, found {given}")
    settings_of = {
        name: getattr(model, name)
        for name in ("learning_rate", "gamma", "seed", "device", "policy_kwargs", "tensorboard_log", "verbose")
    }
    for name in (
        "n_steps", "batch_size", "n_epochs", "gae_lambda", "ent_coef", "vf_coef", "max_grad_norm", "clip_range",
        "buffer_size", "learning_starts", "tau", "train_freq", "gradient_steps", "target_update_interval",
        "exploration_fraction", "exploration_initial_eps", "exploration_final_eps",
    ):  # fmt: skip
        if hasattr(model, name):
            settings_of[name] = getattr(model, name)
    new = type(model)(model.policy_class, vector, **settings_of)
    policy.observation_space, policy.action_space = new.observation_space, new.action_space
    policy.optimizer = extension.optimizer(model.policy.optimizer, model.policy, policy)
    new.policy = policy
    if hasattr(policy, "q_net"):
        new.q_net, new.q_net_target = policy.q_net, policy.q_net_target
    new.num_timesteps, new._n_updates = model.num_timesteps, model._n_updates
    if getattr(model, "replay_buffer", None) is not None:
        replay_buffer(extension, model.replay_buffer, new.replay_buffer)
    return new


def replay_buffer(extension: Extension, old: Any, new: Any) -> None:
    """Copy experience of the source task into an empty replay buffer of the target task."""
    size = old.buffer_size if old.full else old.pos
    if new.buffer_size < size or new.n_envs != old.n_envs:
        raise TaskliftError(
            f"replay buffer: expected room for {size} steps of {old.n_envs} environments, found {new.buffer_size} of "
            f"{new.n_envs}"
        )
    for name in ("observations", "next_observations"):
        found = getattr(old, name)[:size]
        seen = extension.positions(found) if hasattr(old.observation_space, "nvec") else extension.observations(found)
        getattr(new, name)[:size] = seen.reshape(getattr(new, name)[:size].shape)
    new.actions[:size] = extension.actions(old.actions[:size])
    for name in ("rewards", "dones", "timeouts"):
        getattr(new, name)[:size] = getattr(old, name)[:size]
    new.pos, new.full = size % new.buffer_size, size == new.buffer_size


def vec_normalize(extension: Extension, old: Any, new: Any) -> None:
    """Take the statistics of a ``VecNormalize`` over to the target task's; new columns begin at mean 0, variance 1."""
    new.obs_rms.mean, new.obs_rms.var = extension.statistics(old.obs_rms.mean, old.obs_rms.var)
    new.obs_rms.count = old.obs_rms.count
    new.ret_rms.mean, new.ret_rms.var, new.ret_rms.count = old.ret_rms.mean, old.ret_rms.var, old.ret_rms.count
    for name in ("clip_obs", "clip_reward", "gamma", "epsilon", "norm_obs", "norm_reward", "training"):
        setattr(new, name, getattr(old, name))


def guard_callback(watch: Watch, arm: str) -> Any:
    """Return a callback that tells a :class:`.Watch` of each episode, and stops training once transfer hurts.

    Parameters
    ----------
    watch
        The guard of the training.
    arm : {"transferred", "control"}
        Which of the two is trained with this callback.
    """
    from stable_baselines3.common.callbacks import BaseCallback

    class GuardCallback(BaseCallback):
        def _on_step(self) -> bool:
            for info in self.locals["infos"]:
                if "episode" in info:
                    losses, success = info.get("losses", 0), info.get("is_success", False)
                    watch.episode(arm, float(info["episode"]["r"]), int(info["episode"]["l"]), losses, bool(success))
            return not (arm == "transferred" and watch.verdict == "hurts")

    return GuardCallback()


def _width(space: Any) -> Any:
    return getattr(space, "shape", None), getattr(space, "n", None), str(getattr(space, "nvec", None))
