"""How fast a Gymnasium environment is learned through Factored, beside a loop over plain lists in its own code.

Processor time, interleaved; the ratio is what counts. Both run Q-learning, epsilon-greedy, and reset with a seed.
"""

import math
import random
import statistics
import time

import gymnasium

import tasklift as tl
from tasklift.envs.gymnasium import Factored

ROUNDS = 7
CASES = {
    "CliffWalking-v1": ((4, 12), 4, {"max_episode_steps": 500}, 150, lambda event: event.reward == -100),
    "FrozenLake-v1": ((4, 4), 4, {}, 1500, lambda event: event.terminated and event.reward == 0),
    "Taxi-v4": ((5, 5, 5, 4), 6, {}, 60, lambda event: event.reward == -10),  # tells masks, which only Factored obeys
}


def plain(env, states, actions, trials):
    values = [[0.0] * actions for _ in range(states)]
    rng, steps = random.Random(0), 0
    for trial in range(trials):
        state, _ = env.reset(seed=trial)
        over = False
        while not over:
            row = values[state]
            action = rng.randrange(actions) if rng.random() < 0.1 else row.index(max(row))
            state, reward, terminated, truncated, _ = env.step(action)
            target = reward if terminated else reward + 0.99 * max(values[state])
            row[action] += 0.1 * (target - row[action])
            over, steps = terminated or truncated, steps + 1
    return steps


def ours(env, sizes, actions, trials, loss=None, limit=500):
    inputs = tuple(tl.Variable(f"part {k}", range(n)) for k, n in enumerate(sizes))
    task = tl.Task("bench", inputs, (tl.Variable("action", range(actions)),))
    return int(tl.learn_values(Factored(env, task, loss=loss, limit=limit), trials=trials).outcomes.steps.sum())


def rate(learn, *given):
    start = time.process_time()
    return learn(*given) / (time.process_time() - start)


def measured(name, sizes, actions, options, trials, loss):
    """Return the steps per second of the plain loop, and the ratios of ours to it, without and with a loss function."""
    rates = []
    for _ in range(ROUNDS):
        envs = [gymnasium.make(name, **options) for _ in range(3)]
        speed = rate(plain, envs[0], math.prod(sizes), actions, trials)
        rates.append((
            speed,
            rate(ours, envs[1], sizes, actions, trials) / speed,
            rate(ours, envs[2], sizes, actions, trials, loss) / speed,
        ))  # fmt: skip
    return [statistics.median(column) for column in zip(*rates, strict=True)]


def main():
    print(f"{'environment':16}  {'plain lists, steps/s':>20}  {'Factored':>8}  {'with loss=':>10}")
    for name, case in CASES.items():
        ours(gymnasium.make(name), *case[:2], 2)  # compiles
        speed, without, judged = measured(name, *case)
        print(f"{name:16}  {speed:20,.0f}  {without:8.2f}  {judged:10.2f}")


if __name__ == "__main__":
    main()
