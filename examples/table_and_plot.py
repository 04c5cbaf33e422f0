"""From a run to a table and a plot: ``python table_and_plot.py`` (needs pandas)."""

import tasklift as tl

hunt = tl.Mission(tl.generate(seed=7), team="10+5", hostiles=1)
curve = tl.reinforce(hunt, tl.Policy.equal(hunt.task), trials=300, seed=0)

print(curve.to_pandas().groupby(lambda trial: (trial - 1) // 100)[["steps", "losses", "success"]].mean().round(2))
axes = curve.plot("losses", smooth=20)
axes.figure.savefig("losses.png")
