"""Any Gymnasium environment with discrete inputs and outputs as a world of ours: declare how it factors.

Needs the extra ``gym``. :class:`Factored` takes an environment that the user made;
:func:`make_environment` makes a registered one by its name.
"""

from __future__ import annotations

import copy
import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from tasklift.envs.spaces import leaves, positions_of, value_at
from tasklift.errors import TaskliftError, missing
from tasklift.learning.model import Model
from tasklift.learning.worlds import Step
from tasklift.tasks.task import Task
from tasklift.tasks.variable import Variable
from tasklift.text import one_line, shown

#: Wrappers of Gymnasium that change no transition, so that a table of transitions still holds below them.
_TRANSPARENT = ("TimeLimit", "OrderEnforcing", "PassiveEnvChecker", "RecordEpisodeStatistics")

#: Transitions that :meth:`Factored.model` plays to see whether the table tells the truth.
PLAYED = 2000


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
    _find: Callable[[Any], int]

    @property
    def input(self) -> int:
        """Index, in the task, of ``after``; raises :class:`TaskliftError` if it is not an input of the task.

        What comes back at the end of an episode need not be one, and is looked up only where this is asked for.
        """
        return self._find(self.after)


Judge = Callable[[Event], Any]
Observe = Callable[[Any], Mapping[str, Any]]
Act = Callable[[Mapping[str, Any]], Any]


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
        Observation → ``{input: value}``. Default, for discrete spaces: the positions, in order (``MultiDiscrete``,
        ``MultiBinary``, ``Tuple`` and ``Dict`` of such, nested, from any first number), or, for a single number, the
        input's index, so that the first input variable is the slowest. For a ``Box``: :class:`.Bins`.
    act
        ``{output: value}`` → action. Default: as ``observe``, the other way round.
    loss
        Event → what was lost in it (a whole number, or a truth value); default: nothing ever is.
    success
        Event → whether an episode (trial) that ends so succeeded. Default: it terminated without a loss. In an episode
        whose every reward was above 0, going on is what pays: there it is one that was cut off without a loss.
    limit
        The most steps of an episode; default: the environment's own limit.
    mask
        The entry of ``info`` that tells which actions are possible next (a mask by action, or one for each part of
        it), and that learners by value obey. None: look at none.

    Raises
    ------
    TaskliftError
        If the spaces do not fit the task; later, for an observation outside of the declared factoring, a reward or
        loss that is not a number, a step after the end, and an environment that changed its spaces.
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
        mask: str | None = "action_mask",
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
        self._observe, self._loss, self._success, self._mask = observe, loss, success, mask
        if observe is None:
            self._positions = _splitter(self._spaces[0], task.inputs, f"{self._name}: observation space", "observe")
        if act is None:
            _splitter(self._spaces[1], task.outputs, f"{self._name}: action space", "act")
        self.actions = [_action(env.action_space, task, act, a) for a in range(task.shape[1])]
        for a, action in enumerate(self.actions):
            if not env.action_space.contains(action):
                raise TaskliftError(
                    f"{self._name}: output {task.output_values(a)} gives {action!r}, not an action of it"
                )
        self._sizes = [len(v) for v in task.inputs]
        self._shared = any(not isinstance(action, int | np.integer) for action in self.actions)
        self._before: Any = None
        self._episode, self._steps, self._going, self._paid = 0, 0, False, True
        #: bool (A,): the outputs that are possible now; None: all of the task's
        self.possible: NDArray[np.bool_] | None = None

    @property
    def task(self) -> Task:
        """The declared task."""
        return self._task

    @property
    def limit(self) -> int:
        """The most steps of an episode (trial)."""
        return self._limit

    def input_of(self, observation: Any) -> int:
        """Return the input's index of an observation, or say that it is outside of the declared factoring."""
        try:
            if self._observe is not None:
                return self._task.input_index(self._observe(observation))
            positions = self._positions(observation)
            if len(positions) == 1:
                index = positions[0]
                if 0 <= index < self._task.shape[0]:
                    return index
                raise ValueError(f"the task has {self._task.shape[0]} inputs")
            index = 0
            for position, size in zip(positions, self._sizes, strict=True):
                if not 0 <= position < size:
                    raise ValueError(f"position {position} of {size}")
                index = index * size + position
            return index
        except (TaskliftError, TypeError, ValueError, KeyError, IndexError, OverflowError) as error:
            raise TaskliftError(
                f"{self._name}: the observation {shown(observation)} is outside of the factoring declared in task "
                f"{self._task.name!r} ({error})"
            ) from error

    def start(self, rng: np.random.Generator) -> int:
        """Reset the environment, seeded from ``rng``, and return the first input."""
        if (self.env.observation_space, self.env.action_space) != self._spaces:
            raise TaskliftError(
                f"{self._name}: the environment changed its spaces, from {self._spaces[0]} and "
                f"{self._spaces[1]} to {self.env.observation_space} and {self.env.action_space}"
            )
        observation, info = self.env.reset(seed=int(rng.integers(2**31)))
        self._episode, self._steps, self._going, self._paid = self._episode + 1, 0, True, True
        self._before = _kept(observation)
        self._look(info)
        return self.input_of(observation)

    def step(self, output: int) -> Step:
        """Do one step with this output."""
        if not self._going:
            raise TaskliftError(f"{self._name}: a step after the end of an episode (trial); call start() before")
        if not 0 <= output < len(self.actions) or output != int(output):
            raise TaskliftError(f"{self._name}: expected an output from 0 to {len(self.actions) - 1}, found {output}")
        action = copy.deepcopy(self.actions[output]) if self._shared else self.actions[output]
        after, reward, terminated, truncated, info = self.env.step(action)
        self._steps += 1
        try:
            reward = float(reward)
        except (TypeError, ValueError):
            raise self._wrong("reward", reward, "a finite number") from None
        if not math.isfinite(reward):
            raise self._wrong("reward", reward, "a finite number")
        terminated = bool(terminated)
        truncated = not terminated and (bool(truncated) or self._steps >= self._limit)
        self._going = not (terminated or truncated)
        self._paid = self._paid and reward > 0
        lost, success = 0, terminated
        if self._loss is not None or self._success is not None:
            after = _kept(after)
            event = Event(
                self._before, action, reward, after, terminated, truncated, info, int(output), self.input_of
            )
            lost, success = self._judged(event)
            self._before = after
        elif self._paid and self._steps > 1:
            success = truncated
        if info:
            self._look(info)
        elif self.possible is not None:
            self.possible = None
        # what comes back at the end is nothing to act on, and need not be an input of the task
        return Step(-1 if terminated else self.input_of(after), reward, terminated, lost, success, truncated)

    def _judged(self, event: Event) -> tuple[int, bool]:
        """Return what an event lost, and whether the episode succeeds with it."""
        lost = 0
        if self._loss is not None:
            found = self._loss(event)
            try:
                lost = int(found)
            except (TypeError, ValueError, OverflowError):
                lost = -1
            if lost < 0 or lost != found:
                raise self._wrong("loss", found, "a whole number of at least 0; count the losses in smaller units")
        if self._success is not None:
            return lost, bool(self._success(event))
        lives = self._paid and self._steps > 1
        return lost, not lost and (event.truncated if lives else event.terminated)

    def _wrong(self, what: str, found: Any, expected: str) -> TaskliftError:
        return TaskliftError(
            f"{self._name}, episode (trial) {self._episode}, step {self._steps}: the {what} is {shown(found)}; "
            f"expected {expected}"
        )

    def _look(self, info: Mapping[str, Any]) -> None:
        """Take in which actions are possible next, if the environment says so."""
        mask = info.get(self._mask) if self._mask is not None else None
        if mask is None:
            self.possible = None
            return
        space = self._spaces[1]
        parts = [mask] if type(space).__name__ == "Discrete" else mask
        try:
            split = positions_of(space, [v.name for v in self._task.outputs])
            places = [split(action) for action in self.actions]
            possible = [all(part[i] for part, i in zip(parts, at, strict=True)) for at in places]
        except (AssertionError, TypeError, ValueError, IndexError) as error:
            raise self._wrong(str(self._mask), mask, f"a mask for {space}") from error
        if self._going and not any(possible):
            raise self._wrong(str(self._mask), mask, "at least one action that is possible")
        self.possible = np.array(possible)

    # --- as an explicit model -----------------------------------------------------------------------------------

    @property
    def has_model(self) -> bool:
        """Whether the environment tells its transitions, so that :meth:`model` may be had."""
        world = self.env.unwrapped
        return hasattr(world, "P") and hasattr(world, "initial_state_distrib")

    def model(self) -> Model:
        """Return the environment as an explicit :class:`~tasklift.learning.model.Model`: the same world, much faster.

        For environments that keep their transitions in ``P`` and ``initial_state_distrib``, as Gymnasium's
        toy text environments do. Loss and success are asked once for every transition. A model knows no masks.

        Raises
        ------
        TaskliftError
            If the environment has no table, if a wrapper may change what the table says, or if 2,000 transitions,
            played at random in the environment, differ from the table.
        """
        if not self.has_model:
            raise TaskliftError(f"{self._name}: has no table of transitions (P, initial_state_distrib)")
        limit, env = self._limit, self.env
        while env is not self.env.unwrapped:
            kind = type(env).__name__
            if kind not in _TRANSPARENT or not type(env).__module__.startswith("gymnasium."):
                raise TaskliftError(
                    f"{self._name}: the wrapper {kind} may change what the table of transitions says; "
                    "learn step by step, on the environment itself"
                )
            limit = min(limit, getattr(env, "_max_episode_steps", None) or limit)
            env = env.env
        table, start = self.env.unwrapped.P, self.env.unwrapped.initial_state_distrib
        n, outputs = len(table), len(self.actions)
        rows = np.array([self.input_of(s) for s in range(n)], dtype=np.int64)
        branches = max(len(table[s][a]) for s in range(n) for a in self.actions)
        shape = (n, outputs, branches)
        probability, reward = np.zeros(shape), np.zeros(shape)
        after, lost = np.zeros(shape, dtype=np.int64), np.zeros(shape, dtype=np.int64)
        ended, success = np.zeros(shape, dtype=np.bool_), np.zeros(shape, dtype=np.bool_)
        self._paid = all(r > 0 for s in range(n) for a in self.actions for _, _, r, _ in table[s][a])
        self._steps = 2 if self._paid else 1
        for s in range(n):
            for a, action in enumerate(self.actions):
                for k, (p, to, r, terminated) in enumerate(table[s][action]):
                    at = (s, a, k)
                    event = Event(s, action, float(r), int(to), bool(terminated), False, {}, a, self.input_of)
                    probability[at], after[at], reward[at], ended[at] = p, to, r, terminated
                    try:
                        lost[at], success[at] = self._judged(event)
                    except KeyError as error:
                        raise TaskliftError(
                            f"{self._name}: loss= or success= reads {error} of info, which a table of transitions "
                            "has not; learn step by step, on the environment itself"
                        ) from error
        start = np.asarray(start, dtype=np.float64)
        found = Model(self._task, rows, start, probability, after, reward, ended, lost, success, limit)
        self._compare(found)
        return found

    def _compare(self, model: Model) -> None:
        """Play transitions at random; raise :class:`TaskliftError` for one, or for frequencies, not of the model."""
        from scipy.stats import kstest

        rng = np.random.default_rng(0)
        # where a branch lies among the others of its pair, at random within it: even in [0, 1) if the model is right
        places: list[float] = []
        played = 0
        while played < PLAYED:
            first, state, going = played, -1, True
            seen, row = self.env.reset(seed=int(rng.integers(2**31)))[0], -1
            self._paid, self._steps, self._episode, self._before = True, 0, self._episode + 1, seen
            row = self._state(seen, len(model.rows))
            if model.start_probability[row] == 0:
                raise self._differs(f"starts in state {row}", model)
            while going and played < first + model.limit and played < PLAYED:
                state, output = row, int(rng.integers(len(self.actions)))
                action = copy.deepcopy(self.actions[output])
                seen, reward, terminated, truncated, info = self.env.step(action)
                played, self._steps = played + 1, self._steps + 1
                self._paid = self._paid and reward > 0
                going = not (terminated or truncated)
                row = self._state(seen, len(model.rows))
                cut = not terminated and (bool(truncated) or self._steps >= model.limit)
                event = Event(
                    state, action, float(reward), row, bool(terminated), cut, info, output, self.input_of
                )
                lost, success = self._judged(event)
                branch = (state, output)
                match = (
                    (model.probability[branch] > 0)
                    & (model.after[branch] == row)
                    & np.isclose(model.reward[branch], reward, rtol=1e-9, atol=1e-12)
                    & (model.ended[branch] == bool(terminated))
                    & (model.lost[branch] == lost)
                    & ((model.success[branch] == success) | (going and not cut))
                )
                did = f"answers {self._task.output_values(output)} in state {state} with state {row}"
                if not match.any():
                    raise self._differs(f"{did}, reward {reward:g}, loss {lost}, success {success}", model)
                share = model.probability[branch] * match
                if (model.probability[branch] > 0).sum() > 1:
                    k = int(rng.choice(len(share), p=share / share.sum()))
                    upto = model.probability[branch][:k].sum()
                    places.append(float(upto + rng.random() * model.probability[branch][k]))
        self._going = False
        if len(places) > 20 and kstest(places, "uniform").pvalue < 1e-6:
            raise self._differs("takes its branches with other probabilities", model)

    def _state(self, observation: Any, n: int) -> int:
        """Return the state that an observation is the number of."""
        try:
            state = int(observation)
        except (TypeError, ValueError):
            state = -1
        if not 0 <= state < n:
            raise TaskliftError(
                f"{self._name}: expected observations that are the numbers of its table's {n} states, found "
                f"{shown(observation)}; learn step by step, on the environment itself"
            )
        return state

    def _differs(self, what: str, model: Model) -> TaskliftError:
        spec = getattr(self.env, "spec", None)
        options = ", ".join(f"{name} = {value}" for name, value in (spec.kwargs if spec is not None else {}).items())
        return TaskliftError(
            f"{self._name}{f' ({options})' if options else ''}: {what}, which its table of transitions does not know; "
            "learn step by step, on the environment itself"
        )


def _kept(observation: Any) -> Any:
    """Return an observation that the environment cannot change any more."""
    if isinstance(observation, np.ndarray):
        return observation.copy()
    return observation if isinstance(observation, int | float | str | np.generic) else copy.deepcopy(observation)


def _splitter(
    space: Any, variables: Sequence[Variable], what: str, function: str
) -> Callable[[Any], list[int]]:
    """Return the function that splits values of a space, or refuse a space that does not fit the variables."""
    variable_names = [v.name for v in variables]
    found, ours = leaves(space, variable_names), [len(v) for v in variables]
    sizes = None if found is None else [size for _, size in found]
    if sizes is None or (sizes != ours and (len(sizes) > 1 or sizes[0] != math.prod(ours))):
        names = " × ".join(f"{v.name} ({len(v)})" for v in variables)
        binned = "; for numbers in bins, tasklift.envs.spaces.Bins" if type(space).__name__ == "Box" else ""
        raise TaskliftError(f"{what} is {space}, which does not split into {names} by itself; give {function}={binned}")
    return positions_of(space, variable_names)


def _action(space: Any, task: Task, act: Act | None, output: int) -> Any:
    if act is not None:
        return act(task.output_values(output))
    sizes = [len(v) for v in task.outputs]
    alone = len(leaves(space) or ()) == 1
    positions = [output] if alone else [int(p) for p in np.unravel_index(output, sizes)]
    return value_at(space, [v.name for v in task.outputs], positions)
