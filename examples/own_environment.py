"""Firm ice first, then slippery ice, on Gymnasium's FrozenLake; did it pay? ``python own_environment.py``."""

import gymnasium

import tasklift as tl
from tasklift.envs.gymnasium import Factored

lake = tl.Task(
    "lake",
    inputs=(tl.Variable("row", range(4)), tl.Variable("col", range(4))),
    outputs=(tl.Variable("move", ("left", "down", "right", "up")),),
)


def world(slippery):
    env = gymnasium.make("FrozenLake-v1", is_slippery=slippery)
    return Factored(env, lake, loss=lambda event: event.terminated and event.reward == 0).model()


learner = tl.ValueLearning("q-learning", step_size=0.1, epsilon=0.1)
curriculum = tl.Curriculum(
    [
        tl.Stage("firm", lake, world(slippery=False), learner, trials=300),
        tl.Stage("slippery", lake, world(slippery=True), learner, trials=1000),
    ]
)
comparison = tl.compare(curriculum, seeds=20)
print(comparison)
print(comparison.policy.best_action({"row": 0, "col": 0}))
