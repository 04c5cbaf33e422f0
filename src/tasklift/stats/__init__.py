"""What may be concluded from runs: intervals, p-values and verdicts that hold for few seeds as for many.

**The seed is the unit of replication, never the trial**: every function takes one value per seed. Arms that
share their seeds are compared by paired differences. ``strata`` labels each seed's map: the spread is measured
within maps, and the answer speaks of these maps. ``better`` says which direction is good: ``"less"`` for steps
and losses, ``"greater"`` for rewards.

A verdict and its p-value come from one test, and the 95 % interval is what that test does not reject
(:class:`~tasklift.stats.paired.PairedTest` says how it works). Below the number of seeds with which the test can
decide anything the verdict is *too few seeds*, and there is no interval. ``tests/test_stats.py`` measures how often
all this errs; docs/quality.md has the figures. Every random result follows from its ``seed``.
"""

from tasklift.stats.curves import Times, mean_band, median_time, time_to_threshold
from tasklift.stats.paired import LEVEL, PairedTest, seeds_needed
from tasklift.stats.verdicts import (
    Comparison,
    Direction,
    Interval,
    Verdict,
    after_holm,
    benjamini_hochberg,
    bounds_ratio,
    compare,
    equivalent,
    holm,
    ratio,
    share,
)

__all__ = [
    "LEVEL",
    "Comparison",
    "Direction",
    "Interval",
    "PairedTest",
    "Times",
    "Verdict",
    "after_holm",
    "benjamini_hochberg",
    "bounds_ratio",
    "compare",
    "equivalent",
    "holm",
    "mean_band",
    "median_time",
    "ratio",
    "seeds_needed",
    "share",
    "time_to_threshold",
]
