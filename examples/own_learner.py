"""A learner of one's own, in a curriculum with a cap, a guard and a verdict: ``python own_learner.py``."""

from dataclasses import dataclass, replace

import numpy as np
from ferry import Ferry

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
            best = policy.carried.get("score", -1e9)  # fades: an old success may have been luck
            policy = replace(tried if score >= best else policy, carried={"score": max(score, best - 1)})
        return tl.Curve(policy, tl.joined(parts))


calm = tl.Stage("calm", Ferry.task.simplify(fix={"storm": 0}), Ferry(0.0), RandomSearch(), trials=40)
wait, guard = tl.swap("sail", when={"storm": 1, "place": 2}), tl.Guard("losses", share=0.2)
storms = tl.Stage("storms", Ferry.task, Ferry(0.5), RandomSearch(), trials=200, prior=[wait], guard=guard)
curriculum = tl.Curriculum([calm, storms], max_losses=60)

if __name__ == "__main__":
    print(curriculum.run(seed=0).guards["storms"])
    print(tl.compare(curriculum, seeds=20, performance="steps"))
