"""Several missions as one world."""

from __future__ import annotations

import numpy as np
import pytest

import tasklift as tl
from tasklift.building import Mission, generate
from tasklift.building.missions import Missions
from tasklift.errors import TaskliftError
from tasklift.testing import check_learner, check_world

HUNTS = [Mission(generate(5, 5, 2, 5, seed=seed), "2+3", limit=100) for seed in (1, 2, 3)]
WORLD = Missions(HUNTS)


def test_keeps_the_promises_of_a_world_and_learners_theirs_on_it() -> None:
    check_world(WORLD)
    for learner in (tl.Reinforcement(loss_signal=-0.5), tl.PolicySearch(population=3, episodes=2)):
        check_learner(learner, WORLD)


def test_each_trial_is_the_one_of_the_mission_whose_turn_it_is() -> None:
    key = {"stage": 2, "reinforcement": tl.Reinforcement(), "learn": False}
    weights = np.random.default_rng(0).random((2, *WORLD.task.shape))
    many = WORLD.run_many(WORLD.task, weights, trials=7, first_trial=2, seeds=[4, 4], **key)
    for k in (0, 1):
        together = WORLD.run(WORLD.task, weights[k], trials=7, first_trial=2, seed=4, **key)
        for name in ("steps", "success", "losses", "robots_left", "explored"):
            assert np.array_equal(getattr(many, name)[k], getattr(together, name))
        for i, steps in enumerate(together.steps, start=2):
            alone = HUNTS[i % 3].run(WORLD.task, weights[k], trials=1, first_trial=i, seed=4, **key)
            assert alone.steps.tolist() == [steps]


def test_says_what_is_wrong() -> None:
    with pytest.raises(TaskliftError, match="at least one"):
        Missions([])
    with pytest.raises(TaskliftError, match="same kinds"):
        Missions([HUNTS[0], Mission(HUNTS[1].building, {"weapon": 3})])
