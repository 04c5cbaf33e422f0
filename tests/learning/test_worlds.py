"""Worlds met step by step: what they say is possible, and what they may not answer."""

from __future__ import annotations

from dataclasses import replace
from functools import partial

import numpy as np
import pytest

from tasklift.errors import TaskliftError
from tasklift.learning.learner import Run
from tasklift.learning.reinforcement import Fixed, Reinforcement, reinforce, sweep
from tasklift.learning.values import evaluate, learn_values
from tasklift.learning.worlds import Step
from tasklift.tasks.policy import Policy
from tasklift.tasks.task import Task, Variable


class Doors:
    """Three doors, of which one is locked, another one at every step; who tries it has broken the world."""

    task = Task("doors", (Variable("step", range(3)),), (Variable("door", range(3)),), time_reward=0.1)
    limit = 6

    def start(self, rng):
        self.steps = 0
        self.possible = np.arange(3) != 0
        return 0

    def step(self, output):
        assert self.possible[output]
        self.steps += 1
        self.possible = np.arange(3) != self.steps % 3
        return Step(self.steps % 3, 1.0, ended=False)


@pytest.mark.parametrize("selection", ["exploration", "pseudo-random", "exploitation"])
def test_learners_of_weights_choose_what_is_possible(selection: str) -> None:
    learner = Reinforcement(selection=selection)
    locked = Policy(Doors.task, np.eye(3))  # prefers the locked door, and gives the others nothing
    learned = learner.learn(Doors(), locked, Run(trials=30)).policy
    assert (np.diag(learned.weights) == 1).all()
    assert len(Fixed(learner).learn(Doors(), locked, Run(trials=5)).outcomes) == 5
    with pytest.raises(TaskliftError, match=r"'door': 0} is impossible at {'step': 0}; a sweep tries every output"):
        sweep(Doors(), Doors.task)


def test_where_nothing_is_possible_it_is_said() -> None:
    only_first = Doors.task.simplify(restrict={"door": [0]})
    shut = replace(Doors.task, impossible=({"door": [1, 2]},))  # and the world says that the first one is locked
    behind_shut = type("Behind", (Doors,), {"task": shut})()
    for call in (
        lambda: learn_values(Doors(), task=only_first, trials=1),
        lambda: reinforce(Doors(), Policy.equal(only_first), trials=1),
        lambda: evaluate(behind_shut, Policy.equal(shut), trials=1),
    ):
        with pytest.raises(TaskliftError, match=r"no output is possible at {'step': 0}"):
            call()


@pytest.mark.parametrize("mask", [[True, False], 5, "abc"])
def test_a_mask_of_another_size_is_refused(mask) -> None:
    world = Doors()
    world.start = lambda rng: setattr(world, "possible", mask) or 0
    with pytest.raises(TaskliftError, match="a truth value for each of its 3 outputs"):
        learn_values(world, trials=1)


# -- what a world may answer -------------------------------------------------------------------------------------


@pytest.mark.parametrize("bad", [0.5, -1, float("nan"), float("inf"), "one", None, 10**30])
def test_losses_that_are_no_count_are_refused(bad) -> None:
    with pytest.raises(TaskliftError, match="step, lost: expected a whole number of at least 0"):
        Step(0, 1.0, False, bad)


@pytest.mark.parametrize("bad", [float("nan"), float("inf"), "1.0", None, np.zeros(2), 10**400])
def test_rewards_that_are_no_number_are_refused(bad) -> None:
    with pytest.raises(TaskliftError, match="step, reward: expected a finite number"):
        Step(0, bad, False)


@pytest.mark.parametrize("good", [(True, 1), (np.int64(3), 3), (2.0, 2), (False, 0)])
def test_losses_are_counted_as_whole_numbers(good) -> None:
    step = Step(0, np.float32(0.5), False, good[0])
    assert (step.lost, type(step.lost)) == (good[1], int)
    assert (step.reward, type(step.reward)) == (0.5, float)


@pytest.mark.parametrize(
    ("answer", "says"),
    [
        ((0, 1.0, False), r"step 1 of a trial: expected a Step, found \(0, 1.0, False\)"),
        (None, "expected a Step, found None"),
        (Step(9, 1.0, False), "number of an input: expected a whole number from 0 to 2, found 9"),
        (Step([0], 1.0, False), r"expected the number of an input, found \[0\]"),
    ],
)
@pytest.mark.parametrize("learn", [learn_values, partial(reinforce, policy=Policy.equal(Doors.task))])
def test_a_wrong_answer_of_a_world_is_named(answer, says: str, learn) -> None:
    world = Doors()
    world.step = lambda output: answer
    with pytest.raises(TaskliftError, match=says):
        learn(world, trials=1)


def test_an_unknown_option_of_a_run_is_named() -> None:
    policy = Policy.equal(Doors.task)
    for call in (learn_values, partial(reinforce, policy=policy), partial(evaluate, policy=policy)):
        with pytest.raises(TaskliftError, match="unknown option 'callbacks'; the run takes seed, stage"):
            call(Doors(), trials=1, callbacks=[print])


# -- several agents ----------------------------------------------------------------------------------------------


class Pair:
    """Two walk to the end of a corridor; the second one begins half-way, and each leaves when it is there."""

    task = Task("corridor", (Variable("place", range(4)),), (Variable("go", ("stay", "on")),))
    limit = 12
    possible = None

    def start(self, rng):
        self.places = {"first": 0, "second": 2}
        return dict(self.places)

    def step(self, outputs):
        answers = {}
        for agent, output in outputs.items():
            self.places[agent] += output
            there = self.places[agent] == 4
            answers[agent] = Step(min(3, self.places[agent]), -1.0, ended=there, success=there)
        return answers


def test_agents_of_a_world_of_ones_own_share_a_policy() -> None:
    learned = learn_values(Pair(), trials=60)
    assert learned.policy.best().tolist() == [1, 1, 1, 1]
    played = evaluate(Pair(), learned.policy, trials=3)
    assert (played.steps.tolist(), played.returns.tolist()) == ([4] * 3, [-6.0] * 3)
    assert played.success.all()
    silent = Pair()
    silent.step = lambda outputs: {"first": Step(0, 0.0, False)}
    with pytest.raises(TaskliftError, match=r"expected answers for \['first', 'second'\], found \['first'\]"):
        evaluate(silent, learned.policy)


def test_a_world_of_one_agent_may_have_agents_of_its_own() -> None:
    world = Doors()
    world.agents = ["a lock"]
    assert len(learn_values(world, trials=2).outcomes) == 2
