"""PettingZoo's parallel environments as worlds: one policy for all agents, on any learner."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

import tasklift as tl
from tasklift.errors import TaskliftError
from tasklift.testing import check_learner, check_world

pytest.importorskip("pettingzoo")

import gymnasium
from pettingzoo import ParallelEnv

from tasklift.envs.gymnasium import Factored
from tasklift.envs.parallel import FactoredTeam

TASK = tl.Task(
    "line",
    (tl.Variable("place", range(5)),),
    (tl.Variable("go", ("left", "right")),),
    signals=(tl.Signal(0.1, {"go": "right"}),),
)


class Line(ParallelEnv):
    """Robots on a line of five places: who reaches the right end is home, who leaves the left one is broken."""

    metadata = {"name": "line_v0"}  # noqa: RUF012

    def __init__(self, robots: int = 3, max_cycles: int | None = 12, mask: Any = None, latecomer: bool = False) -> None:
        self.possible_agents = [f"robot_{i}" for i in range(robots)]
        self.max_cycles, self.mask, self.latecomer = max_cycles, mask, latecomer

    def observation_space(self, agent: str) -> Any:
        return gymnasium.spaces.Discrete(5)

    def action_space(self, agent: str) -> Any:
        return gymnasium.spaces.Discrete(2)

    def _info(self, agent: str) -> dict[str, Any]:
        return {"broken": self.places[agent] < 0} | ({} if self.mask is None else {"action_mask": self.mask[agent]})

    def reset(self, seed=None, options=None):
        rng = np.random.default_rng(seed)
        self.agents, self.steps = self.possible_agents[self.latecomer :], 0
        self.places = {agent: int(rng.integers(4)) for agent in self.possible_agents}
        return {agent: self.places[agent] for agent in self.agents}, {agent: self._info(agent) for agent in self.agents}

    def step(self, actions):
        assert set(actions) == set(self.agents)
        self.steps += 1
        for agent, action in actions.items():
            self.places[agent] += 1 if action else -1
        over = {agent: self.places[agent] < 0 or self.places[agent] == 4 for agent in actions}
        cut = {agent: not over[agent] and self.steps == self.max_cycles for agent in actions}
        answers = (
            {agent: self.places[agent] for agent in actions},
            dict.fromkeys(actions, -1.0),
            over,
            cut,
            {agent: self._info(agent) for agent in actions},
        )
        self.agents = [agent for agent in self.agents if not (over.get(agent) or cut.get(agent))]
        if self.latecomer:
            self.agents = [*self.agents, self.possible_agents[0]]
        return answers


def world(**options: Any) -> FactoredTeam:
    return FactoredTeam(Line(**options), TASK, loss=lambda event: event.info["broken"])


def test_a_team_keeps_the_promises_of_worlds_and_learners() -> None:
    check_world(world())
    for learner in (tl.ValueLearning("sarsa", epsilon=0.3), tl.Reinforcement()):
        check_learner(learner, world())


@pytest.mark.parametrize("rule", ["q-learning", "sarsa", "expected-sarsa"])
def test_all_agents_teach_one_table(rule: str) -> None:
    learner = tl.ValueLearning(rule, epsilon=0.2, loss_penalty=10.0)
    learned = tl.learn_values(world(), trials=100, learning=learner)
    assert learned.policy.best()[:4].tolist() == [1, 1, 1, 1]
    steps = learned.policy.carried["visits"].sum()
    assert learned.outcomes.returns.sum() == -steps  # each agent's every step costs 1, and is a visit
    assert learned.outcomes.steps.sum() < steps < 3 * learned.outcomes.steps.sum()
    assert learned.outcomes.losses.sum() > 0
    played = tl.evaluate(world(), learned.policy, trials=20)
    assert played.success.all()
    assert played.losses.sum() == 0


def test_worlds_say_what_they_are() -> None:
    lake = tl.Task("lake", (tl.Variable("cell", range(16)),), (tl.Variable("move", range(4)),))
    assert repr(Factored(gymnasium.make("FrozenLake-v1"), lake)).startswith("Factored(FrozenLake-v1, Task('lake'")
    assert repr(world()).startswith("FactoredTeam(line_v0, 3 agents, Task('line'")


def test_one_agent_in_a_team_is_an_agent_alone() -> None:
    class Alone(gymnasium.Env):
        observation_space, action_space = gymnasium.spaces.Discrete(5), gymnasium.spaces.Discrete(2)

        def reset(self, *, seed=None, options=None):
            self.env = Line(robots=1)
            return tuple(part["robot_0"] for part in self.env.reset(seed))

        def step(self, action):
            return tuple(part["robot_0"] for part in self.env.step({"robot_0": action}))

    alone = Factored(Alone(), TASK, loss=lambda event: event.info["broken"], limit=12)
    search = tl.PolicySearch(population=4, episodes=3)
    for learner in (tl.ValueLearning("sarsa", epsilon=0.3), tl.Reinforcement(), search):
        one, team = (
            learner.learn(where, learner.start(TASK), tl.Run(trials=30)) for where in (alone, world(robots=1))
        )
        assert np.array_equal(one.policy.weights, team.policy.weights)
        for name in ("steps", "success", "losses", "returns"):
            assert np.array_equal(getattr(one.outcomes, name), getattr(team.outcomes, name))


def test_an_episode_succeeds_if_it_does_for_all_who_are_there_at_its_end() -> None:
    # all go right for at most two steps: who began at 3 is home and gone when those from 2 come
    env, told = Line(max_cycles=2), []
    right = tl.Policy(TASK, np.tile([0.0, 1.0], (5, 1)), kind="value")

    def callback(episode: Any) -> None:
        told.append((episode.success, set(env.places.values()) == {4}))

    tl.learn_values(
        FactoredTeam(env, TASK), right, trials=60, callback=callback,
        learning=tl.ValueLearning(epsilon=0.0, step_size=1e-9),
    )  # fmt: skip
    assert set(told) == {(True, True), (False, False)}
    left = tl.evaluate(world(), tl.Policy(TASK, np.tile([1.0, 0.0], (5, 1))), trials=20)
    assert left.losses.tolist() == [3] * 20
    assert not left.success.any()


def test_masks_are_obeyed_agent_by_agent() -> None:
    seen: set[tuple[str, int]] = set()
    env = Line(mask={"robot_0": [1, 1], "robot_1": [0, 1], "robot_2": np.array([1, 0], np.int8)})
    team = FactoredTeam(env, TASK, loss=lambda event: seen.add((event.agent, int(event.action))) or 0)
    tl.learn_values(team, trials=20, learning=tl.ValueLearning(epsilon=1.0))
    assert seen == {("robot_0", 0), ("robot_0", 1), ("robot_1", 1), ("robot_2", 0)}


def test_the_search_itself_can_be_a_world() -> None:
    by_hand = tl.make("tasklift/SearchSmall-v0", act="flat")
    env = tl.make("tasklift/SearchSmall-v0", act="flat")
    search = FactoredTeam(env, env.task, loss=lambda event: event.info["lost"], limit=env.mission.limit)
    inputs = search.start(np.random.default_rng(3))
    by_hand.reset(seed=int(np.random.default_rng(3).integers(2**31)))
    sums, lost, agents = np.zeros(2), 0, []
    while inputs:
        actions = {agent: 22 + 5 * number % 22 for number, agent in enumerate(inputs)}  # all move
        answers = search.step(actions)
        _, rewards, _, _, infos = by_hand.step(actions)
        sums += [sum(answer.reward for answer in answers.values()), sum(rewards.values())]
        lost += sum(answer.lost for answer in answers.values()) - sum(info["lost"] for info in infos.values())
        inputs = {agent: answer.input for agent, answer in answers.items() if not (answer.ended or answer.cut)}
        agents.append(len(inputs))
        assert list(inputs) == by_hand.agents
    assert lost == 0
    assert sums[0] == pytest.approx(sums[1])
    assert min(agents[:-1]) < len(search.agents)  # some were lost on the way


def started() -> FactoredTeam:
    team = world()
    team.start(np.random.default_rng(0))
    return team


def gives(**answers: Any) -> None:
    """Play a world whose ``reset`` or ``step`` returns the given answer."""
    env = Line()
    for call, answer in answers.items():
        real = getattr(env, call)
        setattr(env, call, lambda *a, answer=answer, real=real, **k: (real(*a, **k), answer)[1])
    tl.evaluate(FactoredTeam(env, TASK), tl.Policy.equal(TASK), trials=1)


@pytest.mark.parametrize(
    ("call", "says"),
    [
        (lambda: FactoredTeam(Line(max_cycles=None), TASK), "line_v0: the environment has no limit of steps"),
        (lambda: FactoredTeam(gymnasium.make("FrozenLake-v1"), TASK, limit=5), "no possible_agents .*Factored"),
        (lambda: FactoredTeam(tl.make("tasklift/SearchSmall-v0", api="aec"), TASK), "aec_to_parallel"),
        (lambda: Factored(Line(), TASK, limit=5), "several agents; use tasklift.envs.parallel.FactoredTeam"),
        (
            lambda: FactoredTeam(Line(), tl.Task("t", (tl.Variable("x", range(3)),), TASK.outputs)),
            r"line_v0: observation space is Discrete\(5\), which does not split into x \(3\)",
        ),
        (lambda: tl.evaluate(world(robots=0), tl.Policy.equal(TASK)), "no agent is there after reset"),
        (lambda: gives(reset={"robot_0": 0}), r"reset\(\) gave agent 'robot_0' nothing"),
        (lambda: gives(step=None), r"step\(\) gave agent 'robot_0' nothing: None"),
        (lambda: gives(step=({}, {}, {}, {}, {})), r"step\(\) gave agent 'robot_0' nothing"),
        (lambda: started().step({"robot_9": 0}), "expected an output of each agent that is there"),
        (lambda: started().step({"robot_0": 0}), "expected an output of each agent that is there"),
        (lambda: started().step(dict.fromkeys(Line().possible_agents, 2)), "expected an output from 0 to 1, found 2"),
        (lambda: tl.evaluate(world(latecomer=True), tl.Policy.equal(TASK), trials=1), "'robot_0' came in the middle"),
        (
            lambda: tl.evaluate(FactoredTeam(Line(), TASK, loss=lambda e: 0.5), tl.Policy.equal(TASK), trials=1),
            r"line_v0, robot_0, episode \(trial\) 1, step 1: the loss is 0.5",
        ),
    ],
)
def test_mistakes_are_named(call: Any, says: str) -> None:
    with pytest.raises(TaskliftError, match=says):
        call()
