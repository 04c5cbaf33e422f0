"""Many policies or seeds in one call: the same rows as one by one, on any number of threads, however calls are cut."""

from __future__ import annotations

import os
import signal
from threading import Timer

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

import tasklift as tl
from strategies import missions, reinforcements
from tasklift.building import Mission, generate
from tasklift.building.search import search_only
from tasklift.errors import TaskliftError
from tasklift.learning.chances import GREEDY_STAGE
from tasklift.learning.reinforcement import Reinforcement

FIELDS = ("steps", "success", "losses", "robots_left", "teams_left", "hostiles_left", "explored", "messages")


def rows(outcomes):
    return [getattr(outcomes, name).tolist() for name in FIELDS]


@settings(max_examples=30, deadline=None, derandomize=True)
@given(missions(), reinforcements, st.integers(0, 2**31), st.integers(1, 6), st.integers(1, 9), st.integers(1, 5))
def test_policies_together_are_the_policies_one_by_one(mission, reinforcement, weight_seed, n, episodes, threads):
    rng = np.random.default_rng(weight_seed)
    tables = rng.uniform(0, 3, (n, *mission.task.shape)) * rng.integers(0, 2, (n, *mission.task.shape))
    kept = tables.copy()
    key = {"seed": weight_seed, "reinforcement": reinforcement}
    together = mission.evaluate(tables, episodes, threads=threads, **key)
    assert together.steps.shape == (n, episodes)
    assert (tables == kept).all()
    for p in range(n):
        alone = mission.run(
            mission.task, tables[p].copy(), trials=episodes, stage=GREEDY_STAGE, learn=False, **key
        )
        assert rows(alone) == rows(together.of_run(p))
    cut = episodes // 2
    parts = [
        mission.evaluate(tables[::-1].copy(), count, first_episode=first, threads=1, **key)
        for first, count in ((0, cut), (cut, episodes - cut))
    ]
    for name in FIELDS:
        glued = np.concatenate([getattr(part, name) for part in parts], axis=1)[::-1]
        assert glued.tolist() == getattr(together, name).tolist()


@settings(max_examples=20, deadline=None, derandomize=True)
@given(missions(), reinforcements, st.integers(0, 2**31), st.integers(1, 5), st.booleans())
def test_seeds_trained_together_are_the_seeds_one_by_one(mission, reinforcement, first_seed, n, sweep):
    task = search_only(mission.task) if mission.n_hostiles == 0 else mission.task
    start = np.full((n, *task.shape), reinforcement.initial_weight)
    seeds = list(range(first_seed, first_seed + n))
    settings_ = {"trials": 4, "stage": 2, "reinforcement": reinforcement}
    settings_ |= {"outputs": np.array([0, 5, 20, 43])} if sweep else {}
    together = mission.simulator.run_many(task, start, seeds=seeds, threads=3, **settings_)
    for p, seed in enumerate(seeds):
        weights = np.full(task.shape, reinforcement.initial_weight)
        assert rows(mission.run(task, weights, seed=seed, **settings_)) == rows(together.of_run(p))
        assert weights.tolist() == start[p].tolist()


def test_an_interrupt_leaves_the_runs_that_no_thread_has_taken():
    hunt = Mission(generate(seed=3), "10+5")
    hunt.evaluate(tl.Policy.equal(hunt.task), 1, seed=0)  # compiles, where that was not done yet
    weights = np.full((4000, *hunt.task.shape), 1.5)
    soon = Timer(0.5, os.kill, [os.getpid(), signal.SIGINT])
    soon.start()
    with pytest.raises(KeyboardInterrupt):
        hunt.run_many(
            hunt.task, weights, trials=100, seeds=list(range(4000)), stage=2, reinforcement=Reinforcement(), threads=2
        )
    untouched = (weights == 1.5).all(axis=(1, 2))
    assert untouched.any()
    assert not untouched.all()


def test_policies_are_taken_as_objects_as_well():
    hunt = Mission(generate(seed=3), "4+3")
    policies = [tl.Policy.equal(hunt.task), tl.Policy(hunt.task, np.random.default_rng(0).random(hunt.task.shape))]
    one = hunt.evaluate(policies[1], 5, seed=2)
    both = hunt.evaluate(policies, 5, seed=2)
    assert rows(one) == [part[1:] for part in rows(both)]
    assert rows(both.of_run(0)) != rows(both.of_run(1))
    calm = hunt.without_hostiles()
    safe = [tl.Policy.equal(search_only(hunt.task))] * 2
    assert calm.evaluate(safe, 3).steps.shape == (2, 3)
    with pytest.raises(TaskliftError, match="leaves out"):
        hunt.evaluate(safe, 3)


@pytest.mark.parametrize(
    ("policies", "options", "says"),
    [
        ([], {}, "at least one policy"),
        (["policy.json"], {}, "expected policies"),
        (np.ones((2, 90, 43)), {}, r"shape \(90, 44\)"),
        (np.ones((90, 44)), {}, r"shape \(90, 44\)"),
        (np.ones((1, 90, 44), np.float32), {}, "float64"),
        (np.full((1, 90, 44), np.nan), {}, "finite"),
        (-np.ones((1, 90, 44)), {}, "at least 0"),
        (np.ones((1, 90, 44)), {"episodes": -1}, "episodes|trials"),
        (np.ones((1, 90, 44)), {"episodes": 10**30}, "trials"),
        (np.ones((1, 90, 44)), {"episodes": True}, "trials"),
        (np.ones((1, 90, 44)), {"seed": -1}, "seed"),
        (np.ones((1, 90, 44)), {"seed": 2**63}, "seed"),
        (np.ones((1, 90, 44)), {"stage": -1}, "stage"),
        (np.ones((1, 90, 44)), {"first_episode": 2**70}, "first_trial"),
        (np.ones((1, 90, 44)), {"threads": 0}, "threads"),
    ],
)
def test_what_cannot_be_evaluated_is_refused(policies, options, says):
    hunt = Mission(generate(seed=3), "4+3")
    with pytest.raises(TaskliftError, match=says):
        hunt.evaluate(policies, **({"episodes": 2} | options))


def test_values_may_be_negative_where_the_heaviest_output_is_taken():
    hunt = Mission(generate(seed=3), "4+3")
    values = np.random.default_rng(1).normal(size=(1, *hunt.task.shape))
    greedy = Reinforcement(selection="exploitation")
    one = hunt.evaluate(values, 3, reinforcement=greedy)
    assert rows(one) == rows(hunt.evaluate(values - values.min(), 3, reinforcement=greedy))
