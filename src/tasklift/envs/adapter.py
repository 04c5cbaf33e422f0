"""One agent's side of an environment: observations as inputs of a task, outputs as actions, events judged.

Gymnasium's environments have one agent (:class:`tasklift.envs.gymnasium.Factored`), PettingZoo's have several
(:class:`tasklift.envs.parallel.FactoredTeam`).
"""

from __future__ import annotations

import copy
import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray

from tasklift.envs.spaces import leaves, positions_of, value_at, whole
from tasklift.errors import TaskliftError
from tasklift.learning.worlds import Step, count_of, finite
from tasklift.tasks.task import Task
from tasklift.tasks.variable import Variable
from tasklift.text import one_line, shown


@dataclass(slots=True, eq=False)
class Event:
    """One transition of an environment, as the user's functions see it.

    Attributes
    ----------
    before, after
        The observations; copies, so that an environment may change its own in place.
    action, reward
        What was done, and what it gave.
    terminated, truncated
        Whether the episode (trial) ended by itself; whether it was cut off, by the environment or at the limit.
    info
        What the environment said beside.
    output
        Index, in the task, of the action.
    """

    before: Any
    action: Any
    reward: float
    after: Any
    terminated: bool
    truncated: bool
    info: Mapping[str, Any]
    output: int
    _adapter: Adapter

    @property
    def agent(self) -> str | None:
        """Whose it is, in an environment of several agents."""
        return self._adapter.agent

    @property
    def input(self) -> int:
        """Index, in the task, of ``after``; raises :class:`TaskliftError` if it is not an input of the task.

        What comes back at the end of an episode need not be one, and is looked up only where this is asked for.
        """
        return self._adapter.input_of(self.after)


Judge = Callable[[Event], Any]
Observe = Callable[[Any], Mapping[str, Any]]
Act = Callable[[Mapping[str, Any]], Any]


class Adapter:
    """What one agent sees and does, between its environment and a task.

    Parameters
    ----------
    name
        Of the environment, for messages.
    spaces
        Of the agent's observations and actions.
    task, observe, act, loss, success, limit, mask
        As in :class:`tasklift.envs.gymnasium.Factored`.
    agent
        Its name among several.

    Raises
    ------
    TaskliftError
        If the spaces do not fit the task.
    """

    def __init__(
        self,
        name: str,
        spaces: tuple[Any, Any],
        task: Task,
        *,
        observe: Observe | None,
        act: Act | None,
        loss: Judge | None,
        success: Judge | None,
        limit: int,
        mask: str | None,
        agent: str | None = None,
    ) -> None:
        for what, function in (("observe", observe), ("act", act), ("loss", loss), ("success", success)):
            if function is not None and not callable(function):
                raise TaskliftError(f"{name}, {what}: expected a function, found {shown(function)}")
        if not isinstance(mask, str | None):
            raise TaskliftError(f"{name}, mask: expected the name of an entry of info, or None, found {shown(mask)}")
        self.name, self.spaces, self.task, self.limit = name, spaces, task, limit
        if observe is None:
            self._index = _finder(spaces[0], task, name)
        else:
            self._index = lambda observation: task.input_index(observe(observation))
        self.actions = _actions(spaces[1], task, act, name)
        self._outputs = range(len(self.actions))
        self.agent, self._loss, self._success, self._mask = agent, loss, success, mask
        self._judges = loss is not None or success is not None
        self._shared = any(not isinstance(action, int | np.integer) for action in self.actions)
        self.seen: Any = None  # the last observation
        self._action: Any = None
        self._output, self._episode, self._steps, self._going, self._paid = 0, 0, 0, False, True
        #: bool (A,): the outputs that are possible now; None: all of the task's
        self.possible: NDArray[np.bool_] | None = None

    def input_of(self, observation: Any) -> int:
        """Return the input's index of an observation, or say that it is outside of the declared factoring."""
        try:
            return self._index(observation)
        except (TaskliftError, TypeError, ValueError, KeyError, IndexError, OverflowError) as error:
            raise TaskliftError(
                f"{self.name}: the observation {shown(observation)} is outside of the factoring declared in task "
                f"{self.task.name!r} ({error})"
            ) from error

    def need_spaces(self, observations: Any, actions: Any) -> None:
        """Refuse an environment that has changed its spaces since the world was declared."""
        if (observations, actions) != self.spaces:
            raise TaskliftError(
                f"{self.name}: the environment changed its spaces, from {self.spaces[0]} and {self.spaces[1]} to "
                f"{observations} and {actions}"
            )

    def begin(self, given: Any) -> int:
        """Take in what a reset gave, and return the first input."""
        try:
            observation, info = given
            self._mask in info  # noqa: B015
        except (TypeError, ValueError) as error:
            raise self._no_answer("reset", given, "observation, info") from error
        self._episode, self._steps, self._going, self._paid = self._episode + 1, 0, True, True
        self.seen = _kept(observation)
        self._look(info)
        return self.input_of(observation)

    def action(self, output: int) -> Any:
        """Return the action of an output, for the environment's next step."""
        if not self._going:
            raise TaskliftError(f"{self.name}: a step after the end of an episode (trial); call start() before")
        if output not in self._outputs:
            raise TaskliftError(f"{self.name}: expected an output from 0 to {len(self.actions) - 1}, found {output}")
        action = self.actions[output]
        self._output, self._action = output, copy.deepcopy(action) if self._shared else action
        return self._action

    def answer(self, given: Any) -> Step:
        """Return what the environment answered to the last action."""
        self._steps = steps = self._steps + 1
        try:
            after, reward, terminated, truncated, info = given
            terminated, masked = bool(terminated), self._mask in info
        except (TypeError, ValueError) as error:
            raise self._no_answer("step", given, "observation, reward, terminated, truncated, info") from error
        if not finite(reward):
            raise self._wrong("reward", reward, "a finite number")
        reward = float(reward)
        truncated = not terminated and (bool(truncated) or steps >= self.limit)
        self._going = not (terminated or truncated)
        self._paid = paid = self._paid and reward > 0
        lives = paid and steps > 1
        if self._judges:
            before, self.seen = self.seen, _kept(after)
            event = Event(
                before, self._action, reward, self.seen, terminated, truncated, info, self._output, self
            )  # fmt: skip
            lost = self.lost(event)
            success = self.succeeds(event, lost, lives)
        else:
            self.seen, lost, success = after, 0, truncated if lives else terminated
        if masked or self.possible is not None:
            self._look(info)
        # what comes back at the end is nothing to act on, and need not be an input of the task
        seen = -1 if terminated else self.input_of(after)
        return Step.unchecked((seen, reward, terminated, lost, success, truncated))

    def lost(self, event: Event) -> int:
        """Return what an event lost."""
        if self._loss is None:
            return 0
        found = self._loss(event)
        lost = count_of(found)
        if lost < 0:
            raise self._wrong("loss", found, "a whole number of at least 0; count the losses in smaller units")
        return lost

    def succeeds(self, event: Event, lost: int, lives: bool) -> bool:
        """Return whether the episode succeeds if it ends, or is cut off, with this event.

        Parameters
        ----------
        event
            A transition.
        lost
            What it lost.
        lives
            Whether every step paid so far, so that going on is what counts.
        """
        if self._success is None:
            return not lost and (event.truncated if lives else event.terminated)
        found = self._success(event)
        try:
            return bool(found)
        except ValueError:
            raise self._wrong("success", found, "one truth value") from None

    def _wrong(self, what: str, found: Any, expected: str) -> TaskliftError:
        whose = "" if self.agent is None else f", {self.agent}"
        return TaskliftError(
            f"{self.name}{whose}, episode (trial) {self._episode}, step {self._steps}: the {what} is {shown(found)}; "
            f"expected {expected}"
        )

    def _no_answer(self, call: str, found: Any, expected: str) -> TaskliftError:
        return TaskliftError(f"{self.name}: {call}() gave {shown(found)}; expected ({expected})")

    def _look(self, info: Mapping[str, Any]) -> None:
        """Take in which actions are possible next, if the environment says so."""
        mask = info.get(self._mask) if self._mask is not None else None
        if mask is None:
            self.possible = None
            return
        parts = [mask] if type(self.spaces[1]).__name__ == "Discrete" else mask
        try:
            first, *others = [_masked(part, size, at) for part, (size, at) in zip(parts, self._places, strict=True)]
        except (AssertionError, TypeError, ValueError) as error:
            raise self._wrong(str(self._mask), mask, f"a mask for {self.spaces[1]}") from error
        for other in others:
            first &= other
        self.possible = first
        if self._going and True not in first.tolist():  # for the few actions that there are, faster than any()
            raise self._wrong(str(self._mask), mask, "at least one action that is possible")

    @cached_property
    def _places(self) -> list[tuple[int, NDArray[np.int64]]]:
        """The size of each part of a mask, and where the outputs' actions are in it, int64 (A,)."""
        names = [v.name for v in self.task.outputs]
        split, sizes = positions_of(self.spaces[1], names), [size for _, size in leaves(self.spaces[1], names) or ()]
        return list(zip(sizes, np.array([split(action) for action in self.actions], np.int64).T, strict=True))


def _masked(part: Any, size: int, at: NDArray[np.int64]) -> NDArray[np.bool_]:
    mask = np.asarray(part, np.bool_)
    if mask.shape != (size,):
        raise ValueError(f"{size} truth values are needed")
    return mask[at]


def _kept(observation: Any) -> Any:
    """Return an observation that the environment cannot change any more."""
    if type(observation) is int or isinstance(observation, float | str | np.generic):
        return observation
    return observation.copy() if isinstance(observation, np.ndarray) else copy.deepcopy(observation)


def _finder(space: Any, task: Task, name: str) -> Callable[[Any], int]:
    """Return the function that finds the input's index of an observation, or raises ``ValueError``."""
    _need_split(space, task.inputs, f"{name}: observation space", "observe")
    sizes = [len(v) for v in task.inputs]
    if type(space).__name__ == "Discrete":
        first, inputs = int(space.start), task.shape[0]

        def find_one(observation: Any) -> int:
            index = (observation if type(observation) is int else whole(observation)) - first
            if 0 <= index < inputs:
                return index
            raise ValueError(f"the task has {inputs} inputs")

        return find_one
    split = positions_of(space, [v.name for v in task.inputs])
    if len(leaves(space) or ()) == 1:
        sizes = [task.shape[0]]

    def find(observation: Any) -> int:
        index = 0
        for position, size in zip(split(observation), sizes, strict=True):
            if not 0 <= position < size:
                raise ValueError(f"position {position} of {size}")
            index = index * size + position
        return index

    return find


def _need_split(space: Any, variables: Sequence[Variable], what: str, function: str) -> None:
    """Refuse a space that does not split into the variables by itself."""
    found, ours = leaves(space, [v.name for v in variables]), [len(v) for v in variables]
    sizes = None if found is None else [size for _, size in found]
    if sizes is None or (sizes != ours and (len(sizes) > 1 or sizes[0] != math.prod(ours))):
        names = " × ".join(f"{v.name} ({len(v)})" for v in variables)
        binned = ", such as tasklift.envs.spaces.Bins" if type(space).__name__ == "Box" else ""
        raise TaskliftError(
            f"{what} is {one_line(space, 80)}, which does not split into {names} by itself; give {function}={binned} "
            "(in a spec: a world of your own, python = ...)"
        )


def _actions(space: Any, task: Task, act: Act | None, name: str) -> list[Any]:
    """Return the action of each output."""
    if act is not None:
        found = [act(task.output_values(output)) for output in range(task.shape[1])]
    else:
        _need_split(space, task.outputs, f"{name}: action space", "act")
        sizes, alone = [len(v) for v in task.outputs], len(leaves(space) or ()) == 1
        places = [[output] if alone else np.unravel_index(output, sizes) for output in range(task.shape[1])]
        found = [value_at(space, [v.name for v in task.outputs], [int(p) for p in place]) for place in places]
    for output, action in enumerate(found):
        if not space.contains(action):
            raise TaskliftError(f"{name}: output {task.output_values(output)} gives {action!r}, not an action of it")
    return found
