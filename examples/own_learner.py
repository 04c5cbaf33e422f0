"""A learner of one's own, in a curriculum with a ledger, a cap, a guard and a verdict: ``python own_learner.py``."""

from dataclasses import dataclass, replace

import numpy as np

import tasklift as tl


@dataclass(frozen=True)
class RandomSearch:
    """Change all weights at random; keep the change if the next episode with it goes no worse."""

    size: float = 1.0

    def start(self, task):
        return tl.Policy.equal(task)

    def learn(self, world, policy, run):
        parts = []
        while (left := run.rest(parts)) is not None:
            rng = np.random.default_rng([left.seed, left.stage, left.first_trial])
            changed = np.maximum(0, policy.weights + rng.normal(0, self.size, policy.task.shape))
            tried = replace(policy, weights=changed)
            parts.append(tl.Fixed().learn(world, tried, replace(left, trials=1)).outcomes)
            score = -float(parts[-1].steps[0] + 20 * parts[-1].losses[0])
            best = policy.carried.get("score", -1e9)
            # an old success fades, since it may have been luck
            policy = replace(tried if score >= best else policy, carried={"score": max(score, best - 1)})
        return tl.Curve(policy, tl.joined(parts))

    def count_as(self, policy, trust):
        raise tl.TaskliftError("random search cannot weigh what was copied")


class Ferry:
    """Three stretches of water; who sails a storm on the last one sinks, and begins again."""

    place, storm, sail = tl.Variable("place", range(3)), tl.Variable("storm", (0, 1)), tl.Variable("sail", (0, 1))
    task = tl.Task("ferry", inputs=(place, storm), outputs=(sail,))
    limit = 30

    def __init__(self, storms):
        self.storms = storms

    def look(self):
        self.stormy = int(self.rng.random() < self.storms)
        return self.task.input_index({"place": self.at, "storm": self.stormy})

    def start(self, rng):
        self.rng, self.at = rng, 0
        return self.look()

    def step(self, output):
        sunk = output == 1 and self.at == 2 and self.stormy == 1
        self.at = 0 if sunk else self.at + output
        if self.at == 3:
            return tl.Step(0, -1.0, ended=True, success=True)
        return tl.Step(self.look(), -1.0 - 20 * sunk, ended=False, lost=int(sunk))


calm = Ferry.task.simplify(fix={"storm": 0})
guard = tl.Guard("losses", share=0.2)
wait = tl.swap("sail", when={"storm": 1, "place": 2})
curriculum = tl.Curriculum(
    [
        tl.Stage("calm", calm, Ferry(0.0), RandomSearch(), trials=40),
        tl.Stage("storms", Ferry.task, Ferry(0.5), RandomSearch(), trials=200, prior=[wait], guard=guard),
    ],
    max_losses=60,
)

if __name__ == "__main__":
    run = curriculum.run(seed=0)
    print(run.ledger)
    print(run.guards["storms"])
    print(tl.compare(curriculum, seeds=20, performance="steps"))
