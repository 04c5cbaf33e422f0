"""Any Gymnasium environment with discrete inputs and outputs as a world of ours: declare how it factors.

Needs the extra ``gym``. :class:`Factored` takes an environment that the user made;
:func:`make_environment` makes a registered one by its name.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from tasklift.errors import TaskliftError, missing
from tasklift.learning.model import Model
from tasklift.learning.worlds import Step
from tasklift.tasks.task import Task
from tasklift.tasks.variable import Variable
from tasklift.text import one_line, shown


@dataclass(frozen=True)
class Event:
    """One transition of an environment, as the user's functions see it."""

    before: Any  # observation
    action: Any
    reward: float
    after: Any  # observation
    terminated: bool
    input: int  # index, in the task, of the observation after it
    output: int  # index, in the task, of the action


Judge = Callable[[Event], Any]
Observe = Callable[[Any], Mapping[str, Any]]
Act = Callable[[Mapping[str, Any]], Any]


def _nothing(event: Event) -> int:
    return 0


def make_environment(name: str, options: Mapping[str, Any]) -> Any:
    """Return a registered Gymnasium environment; unlike ``gymnasium.make``, import no module that the name holds.

    Parameters
    ----------
    name
        Such as ``"CliffWalking-v1"``.
    options
        Of the environment.

    Raises
    ------
    TaskliftError
        Without Gymnasium, or if there is no such environment, or it cannot be made with these options.
    """
    try:
        import gymnasium
    except ImportError as error:
        raise missing("Gymnasium", "gym", "an environment's name") from error
    if ":" in name:
        raise TaskliftError(f"environment: expected the name of a registered environment, found {shown(name)}")
    try:
        return gymnasium.make(name, **options)
    except Exception as error:  # whatever an environment's constructor raises at options that it does not like
        said = one_line(f"{type(error).__name__}: {error}", 150)
        raise TaskliftError(f"environment: Gymnasium cannot make {shown(name)}: {said}") from error


class Factored:
    """A Gymnasium environment as a world that is met step by step (:class:`tasklift.learning.worlds.Steps`).

    Parameters
    ----------
    env
        The environment, as ``gymnasium.make`` gives it.
    task
        How its observations and actions factor into variables.
    observe
        Observation → ``{input: value}``. Default, for a ``Discrete`` space: the observation is the input's
        index, so that the first input variable is the slowest; for ``MultiDiscrete`` or a tuple: the positions, in
        order.
    act
        ``{output: value}`` → action. Default: the output's index, or the positions.
    loss
        Event → what was lost in it (a count, or a truth value); default: nothing ever is.
    success
        Event → whether a trial that ends so succeeded; default: it terminated without a loss.
    limit
        The most steps of a trial; default: the environment's own limit.

    Raises
    ------
    TaskliftError
        If the spaces do not fit the task; later, for an observation outside of the declared factoring, and
        for an environment that changed its spaces.
    """

    def __init__(
        self,
        env: Any,
        task: Task,
        *,
        observe: Observe | None = None,
        act: Act | None = None,
        loss: Judge | None = None,
        success: Judge | None = None,
        limit: int | None = None,
    ) -> None:
        self.env, self._task = env, task
        self._name = env.spec.id if getattr(env, "spec", None) is not None else type(env).__name__
        self._spaces = (env.observation_space, env.action_space)
        own = env.spec.max_episode_steps if getattr(env, "spec", None) is not None else None
        chosen = own if limit is None else limit
        if chosen is None:
            raise TaskliftError(f"{self._name}: the environment has no limit of steps; give limit=")
        self._limit = int(chosen)
        if self._limit < 1:
            raise TaskliftError(f"{self._name}: expected a limit of at least 1 step, found {limit}")
        self._observe, self._loss, self._success = observe, loss or _nothing, success
        if observe is None:
            _fits(self._spaces[0], task.inputs, f"{self._name}: observation space", "observe")
        if act is None:
            _fits(self._spaces[1], task.outputs, f"{self._name}: action space", "act")
        self.actions = [_action(env.action_space, task, act, a) for a in range(task.shape[1])]
        for a, action in enumerate(self.actions):
            if not env.action_space.contains(action):
                raise TaskliftError(
                    f"{self._name}: output {task.output_values(a)} gives {action!r}, not an action of it"
                )
        self._before: Any = None

    @property
    def task(self) -> Task:
        """The declared task."""
        return self._task

    @property
    def limit(self) -> int:
        """The most steps of a trial."""
        return self._limit

    def input_of(self, observation: Any) -> int:
        """Return the input's index of an observation, or say that it is outside of the declared factoring."""
        try:
            if self._observe is not None:
                return self._task.input_index(self._observe(observation))
            index = _index(observation, self._task.inputs)
        except (TaskliftError, TypeError, ValueError, KeyError, IndexError) as error:
            raise TaskliftError(
                f"{self._name}: the observation {observation!r} is outside of the factoring declared in task "
                f"{self._task.name!r} ({error})"
            ) from error
        if not 0 <= index < self._task.shape[0]:
            raise TaskliftError(
                f"{self._name}: the observation {observation!r} is outside of the factoring declared in task "
                f"{self._task.name!r}, which has {self._task.shape[0]} inputs"
            )
        return index

    def start(self, rng: np.random.Generator) -> int:
        """Reset the environment, seeded from ``rng``, and return the first input."""
        if (self.env.observation_space, self.env.action_space) != self._spaces:
            raise TaskliftError(
                f"{self._name}: the environment changed its spaces, from {self._spaces[0]} and "
                f"{self._spaces[1]} to {self.env.observation_space} and {self.env.action_space}"
            )
        self._before, _ = self.env.reset(seed=int(rng.integers(2**31)))
        return self.input_of(self._before)

    def step(self, output: int) -> Step:
        """Do one step with this output."""
        action = self.actions[output]
        after, reward, terminated, _, _ = self.env.step(action)
        event = Event(self._before, action, float(reward), after, bool(terminated), self.input_of(after), output)
        self._before = after
        lost, success = self.judge(event)
        # truncation is ours to do, by `limit`: it cuts a trial off, it does not end it
        return Step(event.input, event.reward, event.terminated, lost, success)

    def judge(self, event: Event) -> tuple[int, bool]:
        """Return what an event lost, and whether the trial succeeds with it."""
        lost = int(self._loss(event))
        if self._success is not None:
            return lost, bool(self._success(event))
        return lost, event.terminated and not lost

    @property
    def has_model(self) -> bool:
        """Whether the environment tells its transitions, so that :meth:`model` can be had."""
        world = self.env.unwrapped
        return hasattr(world, "P") and hasattr(world, "initial_state_distrib")

    def model(self) -> Model:
        """Return the environment as an explicit :class:`~tasklift.learning.model.Model`: the same world, much faster.

        For environments that keep their transitions in ``P`` and ``initial_state_distrib``, as Gymnasium's
        toy text environments do. Loss and success are asked once for every transition.
        """
        if not self.has_model:
            raise TaskliftError(f"{self._name}: has no table of transitions (P, initial_state_distrib)")
        table, start = self.env.unwrapped.P, self.env.unwrapped.initial_state_distrib
        n, outputs = len(table), len(self.actions)
        rows = np.array([self.input_of(s) for s in range(n)], dtype=np.int64)
        branches = max(len(table[s][a]) for s in range(n) for a in self.actions)
        shape = (n, outputs, branches)
        probability, reward = np.zeros(shape), np.zeros(shape)
        after, lost = np.zeros(shape, dtype=np.int64), np.zeros(shape, dtype=np.int64)
        ended, success = np.zeros(shape, dtype=np.bool_), np.zeros(shape, dtype=np.bool_)
        for s in range(n):
            for a, action in enumerate(self.actions):
                for k, (p, to, r, terminated) in enumerate(table[s][action]):
                    at = (s, a, k)
                    event = Event(s, action, float(r), int(to), bool(terminated), int(rows[to]), a)
                    probability[at], after[at], reward[at], ended[at] = p, to, r, terminated
                    lost[at], success[at] = self.judge(event)
        start = np.asarray(start, dtype=np.float64)
        return Model(self._task, rows, start, probability, after, reward, ended, lost, success, self._limit)


def _sizes(space: Any) -> list[int] | None:
    """Return the sizes of a discrete space that starts at 0, or of a tuple of such; None for any other."""
    if isinstance(getattr(space, "spaces", None), tuple):
        parts = [_sizes(part) for part in space.spaces]
        return None if None in parts else [size for part in parts for size in part or []]
    if np.any(getattr(space, "start", 0)):
        return None
    if hasattr(space, "nvec"):
        return [int(n) for n in np.ravel(space.nvec)]
    return [int(space.n)] if hasattr(space, "n") and np.ndim(space.n) == 0 else None


def _fits(space: Any, variables: Sequence[Variable], what: str, function: str) -> None:
    sizes, ours = _sizes(space), [len(v) for v in variables]
    if sizes is None or (sizes != ours and (len(sizes) > 1 or sizes[0] != int(np.prod(ours)))):
        names = " × ".join(f"{v.name} ({len(v)})" for v in variables)
        raise TaskliftError(f"{what} is {space}, which does not split into {names} by itself; give {function}=")


def _index(observation: Any, variables: Sequence[Variable]) -> int:
    positions = np.atleast_1d(observation)
    if positions.size == 1 and len(variables) != 1:
        return int(positions[0])
    return int(np.ravel_multi_index(tuple(int(p) for p in positions), [len(v) for v in variables]))


def _action(space: Any, task: Task, act: Act | None, output: int) -> Any:
    if act is not None:
        return act(task.output_values(output))
    positions = [int(p) for p in np.unravel_index(output, [len(v) for v in task.outputs])]
    if hasattr(space, "nvec"):
        return np.array(positions, dtype=space.dtype)
    return tuple(positions) if isinstance(getattr(space, "spaces", None), tuple) else output
