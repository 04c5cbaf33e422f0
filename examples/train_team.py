"""Train a team in practice episodes, bound what it does for real, and watch it: ``python train_team.py``."""

import tasklift as tl
from tasklift.watch import page, replay

hunt = tl.Mission(tl.generate(seed=7), team="10+5", hostiles=1)
simple = hunt.task.simplify(remove=["DL", "GL"])
search = tl.PolicySearch()
found = search.learn(hunt.drill(), search.start(simple), tl.Run(trials=24_000))
policy = found.policy.extend(hunt.task)
policy.save("team.json")

print(hunt.with_reading(relocate=True).evaluate(policy, 1000))
print("alone at a door:", policy.best_action({"DL": "none", "GL": "unknown", "nWPN": "none", "FTR": "door"}))

trace = hunt.simulator.trace(policy, learn=False)
with open("team.html", "w", encoding="utf-8") as file:
    file.write(page(replay([("practised first", trace)], "One episode")))
