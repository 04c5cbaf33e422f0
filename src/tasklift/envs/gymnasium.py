"""Any Gymnasium environment with discrete inputs and outputs as a world of ours: declare how it factors.

Needs the extra ``gym``. :class:`Factored` takes an environment that the user made;
:func:`make_environment` makes a registered one by its name.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from tasklift.checks import whole_number
from tasklift.envs.adapter import Act, Adapter, Event, Judge, Observe
from tasklift.errors import TaskliftError, missing
from tasklift.learning.model import Model
from tasklift.learning.worlds import Step
from tasklift.tasks.task import Task
from tasklift.text import one_line, shown

__all__ = ["Event", "Factored", "has_table", "make_environment"]

#: Wrappers of Gymnasium that change no transition, so that a table of transitions still holds below them.
_TRANSPARENT = ("TimeLimit", "OrderEnforcing", "PassiveEnvChecker", "RecordEpisodeStatistics")

#: Transitions that :meth:`Factored.model` plays to see whether the table tells the truth.
PLAYED = 2000


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


def has_table(env: Any) -> bool:
    """Return whether an environment tells its transitions, so that :meth:`Factored.model` may be had."""
    return hasattr(env.unwrapped, "P") and hasattr(env.unwrapped, "initial_state_distrib")


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
        it), and that learners obey. None: look at none.

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
        if hasattr(env, "possible_agents"):
            raise TaskliftError(f"{type(env).__name__}: has several agents; use tasklift.envs.parallel.FactoredTeam")
        if hasattr(env, "num_envs") or not all(hasattr(env, name) for name in ("reset", "step", "action_space")):
            raise TaskliftError(f"expected one Gymnasium environment, found {shown(env)}")
        self.env = env
        spec = getattr(env, "spec", None)
        name = spec.id if spec is not None else type(env).__name__
        chosen = getattr(spec, "max_episode_steps", None) if limit is None else limit
        if chosen is None:
            raise TaskliftError(f"{name}: the environment has no limit of steps; give limit=")
        self._agent = Adapter(
            name,
            (env.observation_space, env.action_space),
            task,
            observe=observe,
            act=act,
            loss=loss,
            success=success,
            limit=whole_number(chosen, f"{name}, limit", least=1),
            mask=mask,
        )

    def __repr__(self) -> str:
        return f"Factored({self._agent.name}, {self.task!r})"

    @property
    def task(self) -> Task:
        """The declared task."""
        return self._agent.task

    @property
    def limit(self) -> int:
        """The most steps of an episode (trial)."""
        return self._agent.limit

    @property
    def actions(self) -> list[Any]:
        """The environment's action for each output."""
        return self._agent.actions

    @property
    def possible(self) -> NDArray[np.bool_] | None:
        """The outputs that are possible now, bool (A,); None: all of the task's."""
        return self._agent.possible

    def input_of(self, observation: Any) -> int:
        """Return the input's index of an observation, or say that it is outside of the declared factoring."""
        return self._agent.input_of(observation)

    def start(self, rng: np.random.Generator) -> int:
        """Reset the environment, seeded from ``rng``, and return the first input."""
        self._agent.need_spaces(self.env.observation_space, self.env.action_space)
        return self._agent.begin(self.env.reset(seed=int(rng.integers(2**31))))

    def step(self, output: int) -> Step:
        """Do one step with this output."""
        return self._agent.answer(self.env.step(self._agent.action(output)))

    # --- as an explicit model -----------------------------------------------------------------------------------

    def model(self) -> Model:
        """Return the environment as an explicit :class:`~tasklift.learning.model.Model`: the same world, much faster.

        For environments that keep their transitions in ``P`` and ``initial_state_distrib``, as Gymnasium's
        toy text environments do. Loss and success are asked once for every transition. A model knows no masks; give
        ``mask=None`` where ``info`` has some.

        Raises
        ------
        TaskliftError
            If the environment has no table, if a wrapper may change what the table says, or if 2,000 transitions,
            played at random in the environment, differ from the table; if ``info`` tells masks.
        """
        if not has_table(self.env):
            raise TaskliftError(f"{self._agent.name}: has no table of transitions (P, initial_state_distrib)")
        limit = self._wrapped_limit()
        table, start = self.env.unwrapped.P, self.env.unwrapped.initial_state_distrib
        agent, n, outputs = self._agent, len(table), len(self.actions)
        rows = np.array([self.input_of(s) for s in range(n)], dtype=np.int64)
        branches = max(len(table[s][a]) for s in range(n) for a in self.actions)
        shape = (n, outputs, branches)
        probability, reward = np.zeros(shape), np.zeros(shape)
        after, lost = np.zeros(shape, dtype=np.int64), np.zeros(shape, dtype=np.int64)
        ended, success = np.zeros(shape, dtype=np.bool_), np.zeros(shape, dtype=np.bool_)
        lives = all(r > 0 for s in range(n) for a in self.actions for _, _, r, _ in table[s][a])
        for s in range(n):
            for a, action in enumerate(self.actions):
                for k, (p, to, r, terminated) in enumerate(table[s][action]):
                    at = (s, a, k)
                    # success is asked of the last step only: where the trial does not end, of one that is cut off there
                    event, cut = (
                        Event(s, action, float(r), int(to), bool(terminated), cut, {}, a, agent)
                        for cut in (False, not terminated)
                    )
                    probability[at], after[at], reward[at], ended[at] = p, to, r, terminated
                    try:
                        lost[at] = agent.lost(event)
                        success[at] = agent.succeeds(cut, int(lost[at]), lives)
                    except KeyError as error:
                        raise TaskliftError(
                            f"{agent.name}: loss= or success= reads {error} of info, which a table of transitions "
                            "has not; learn step by step, on the environment itself"
                        ) from error
        start = np.asarray(start, dtype=np.float64)
        found = Model(self.task, rows, start, probability, after, reward, ended, lost, success, limit)
        self._compare(found)
        return found

    def _wrapped_limit(self) -> int:
        """Return the limit of steps under all wrappers; refuse a wrapper that may change a transition."""
        limit, env = self.limit, self.env
        while env is not self.env.unwrapped:
            kind = type(env).__name__
            if kind not in _TRANSPARENT or not type(env).__module__.startswith("gymnasium."):
                raise TaskliftError(
                    f"{self._agent.name}: the wrapper {kind} may change what the table of transitions says; "
                    "learn step by step, on the environment itself"
                )
            limit = min(limit, getattr(env, "_max_episode_steps", None) or limit)
            env = env.env
        return limit

    def _compare(self, model: Model) -> None:
        """Play transitions at random; raise :class:`TaskliftError` for one, or for frequencies, not of the model."""
        from scipy.stats import kstest

        rng, n = np.random.default_rng(0), len(model.rows)
        # where a branch lies among the others of its pair, at random within it: even in [0, 1) if the model is right
        places: list[float] = []
        going, masked, state = False, False, -1
        for _ in range(PLAYED):
            if not going:
                self.start(rng)
                masked, state = masked or self.possible is not None, self._state(n)
                if model.start_probability[state] == 0:
                    raise self._differs(f"starts in state {state}")
            output = int(rng.integers(len(self.actions)))
            branch, (_, reward, ended, lost, success, cut) = (state, output), self.step(output)
            state, going = self._state(n), not (ended or cut)
            match = (
                (model.probability[branch] > 0)
                & (model.after[branch] == state)
                & np.isclose(model.reward[branch], reward, rtol=1e-9, atol=1e-12)
                & (model.ended[branch] == ended)
                & (model.lost[branch] == lost)
                & ((model.success[branch] == success) | going)
            )
            if not match.any():
                did = f"answers {self.task.output_values(output)} in state {branch[0]} with state {state}"
                raise self._differs(f"{did}, reward {reward:g}, loss {lost}, success {success}")
            share = model.probability[branch] * match
            if (model.probability[branch] > 0).sum() > 1:
                k = int(rng.choice(len(share), p=share / share.sum()))
                upto = model.probability[branch][:k].sum()
                places.append(float(upto + rng.random() * model.probability[branch][k]))
        if len(places) > 20 and kstest(places, "uniform").pvalue < 1e-6:
            raise self._differs("takes its branches with other probabilities")
        if masked:
            raise TaskliftError(
                f"{self._agent.name}: says in info which actions are possible, which a table of transitions does not "
                "know; look at no masks (mask=None), or learn step by step, on the environment itself"
            )

    def _state(self, n: int) -> int:
        """Return the state, of ``n``, that the last observation is the number of."""
        try:
            state = int(self._agent.seen)
        except (TypeError, ValueError):
            state = -1
        if not 0 <= state < n:
            raise TaskliftError(
                f"{self._agent.name}: expected observations that are the numbers of its table's {n} states, found "
                f"{shown(self._agent.seen)}; learn step by step, on the environment itself"
            )
        return state

    def _differs(self, what: str) -> TaskliftError:
        spec = getattr(self.env, "spec", None)
        options = ", ".join(f"{name} = {value}" for name, value in (spec.kwargs if spec is not None else {}).items())
        return TaskliftError(
            f"{self._agent.name}{f' ({options})' if options else ''}: {what}, which its table of transitions does not "
            "know; learn step by step, on the environment itself"
        )
