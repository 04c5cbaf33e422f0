"""Worlds that are met step by step: observe, act; and the paper's reinforcement of weights on them.

A world speaks of its own full task, by indices. A learner may be working on a simplification of that task;
:class:`View` translates, and refuses what lies outside of it.

Shapes: ``S`` inputs, ``A`` outputs, ``n`` trials.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, NamedTuple, Protocol, runtime_checkable

import numpy as np
from numpy.typing import NDArray

from tasklift.errors import TaskliftError
from tasklift.learning.reinforcement import Outcomes, Reinforcement
from tasklift.tasks import choice as rules
from tasklift.tasks.task import Task


class Step(NamedTuple):
    """What a world answers to one output."""

    input: int  # the next input, an index of the world's task
    reward: float
    ended: bool  # for good: nothing comes after
    lost: int = 0  # what this step lost (fell, crashed, destroyed), as the user counts it
    success: bool = False


@runtime_checkable
class Steps(Protocol):
    """A world that is met step by step."""

    @property
    def task(self) -> Task:
        """The full task, whose indices the world speaks of."""
        ...

    @property
    def limit(self) -> int:
        """The most steps of a trial; one that gets there is cut off."""
        ...

    def start(self, rng: np.random.Generator) -> int:
        """Begin a trial and return the first input; all chances of the trial come from ``rng``."""
        ...

    def step(self, output: int) -> Step:
        """Do one step with this output."""
        ...


@dataclass(frozen=True, eq=False)
class StepOutcomes(Outcomes):
    """Outcomes of trials on a world with rewards: ``returns``, float64 (n,), are their undiscounted sums."""

    returns: NDArray[np.float64]


class View:
    """A world seen through a task that is the world's own or a simplification of it.

    Raises
    ------
    TaskliftError
        If the task is neither; says which variable differs.
    """

    def __init__(self, world: Steps, task: Task) -> None:
        whole = task.ancestor(world.task)
        self.task = task
        self._whole = world.task
        self._rows: dict[int, int] = {}
        self.columns: list[int] = task.output_columns(whole).tolist()

    def row(self, input: int) -> int:
        """Return the task's row for an input of the world; rows are looked up as they turn up."""
        if input not in self._rows:
            values = self._whole.input_values(input)
            row = self.task.row_of(values)
            if row < 0:
                raise stray_input(values, self.task)
            self._rows[input] = row
        return self._rows[input]


def stray_input(values: Mapping[str, Any], task: Task) -> TaskliftError:
    """Return the error for a world that shows an input which a simplified task leaves out."""
    return TaskliftError(
        f"the world gave the input {values}, which is outside of the task {task.name!r}; "
        "simplify the task less, or switch the world to its simpler version"
    )


class Chances:
    """The random numbers of a stage's trials, keyed by seed, stage and trial: not by what ran before.

    Counter-based (Philox), so going to a trial costs next to nothing. The generator it gives is one and the same,
    and is good until the next trial is asked for.
    """

    def __init__(self, seed: int, stage: int) -> None:
        self._philox = np.random.Philox()
        self._generator = np.random.Generator(self._philox)
        self._state: Any = self._philox.state
        self._state["state"]["key"][:] = (seed % 2**64, stage)
        self._state |= {"buffer_pos": 4, "has_uint32": 0, "uinteger": 0}  # nothing left over from before

    def of(self, trial: int) -> np.random.Generator:
        """Return the generator, at the beginning of a trial."""
        self._state["state"]["counter"][:] = (0, trial, 0, 0)
        self._philox.state = self._state
        return self._generator


class StepTrials:
    """Reinforcement of weights on a world that is met step by step, as a world of whole trials.

    The signals are the task's rules, not the world's rewards; a loss adds the ``loss_signal`` to the pair that led
    to it. The decision is made at every step.
    """

    def __init__(self, world: Steps) -> None:
        self.world = world

    @property
    def task(self) -> Task:
        """The world's full task."""
        return self.world.task

    def run(
        self,
        task: Task,
        weights: NDArray[np.float64],
        *,
        trials: int,
        seed: int,
        stage: int,
        reinforcement: Reinforcement,
        outputs: NDArray[np.int64] | None = None,
        first_trial: int = 0,
        learn: bool = True,
        max_losses: int | None = None,
    ) -> StepOutcomes:
        """Run trials and update ``weights``, float64 (S, A), in place; as :class:`.Trials` asks."""
        view = View(self.world, task)
        # in a sweep the output is not the learner's choice, so it is not punished for being impossible
        chosen = outputs is None or reinforcement.sweep_credit == "visited"
        signals = task.signal_table(impossible=bool(chosen))
        records: list[tuple[int, bool, int, float]] = []
        chances = Chances(seed, stage)
        lost = counted = 0
        for i in range(trials):
            if max_losses is not None and lost >= max_losses:
                break
            held = None if outputs is None else int(outputs[i])
            trial = _Trial(self.world, view, weights, signals, reinforcement, held, learn)
            records.append(trial.run(chances.of(first_trial + i), counted / i if i else None))
            steps, success, losses, _ = records[-1]
            lost += losses
            counted += steps if success else self.world.limit
        return outcomes_of(records, self.world.limit)


class _Trial:
    """One trial under reinforcement of weights (sections V and VI; Table III)."""

    def __init__(
        self,
        world: Steps,
        view: View,
        weights: NDArray[np.float64],
        signals: NDArray[np.float64],
        settings: Reinforcement,
        held: int | None,
        learn: bool,
    ) -> None:
        self.world, self.view, self.weights, self.signals = world, view, weights, signals
        self.settings, self.held, self.learn = settings, held, learn
        self.to_all = held is not None and settings.sweep_credit == "all"
        self.greedy = {"exploration": 0.0, "exploitation": 1.0}.get(settings.selection, settings.q)
        self.used: dict[tuple[int, int], None] = {}

    def run(self, rng: np.random.Generator, usual_steps: float | None) -> tuple[int, bool, int, float]:
        """Run the trial and return its steps, success, losses and return."""
        row = self.view.row(self.world.start(rng))
        steps, losses, total = 0, 0, 0.0
        ended = success = False
        while not ended and steps < self.world.limit:
            coin, u = rng.random(), rng.random()
            column = rules.select(self.weights[row], self.greedy, coin, u) if self.held is None else self.held
            first = (row, column) not in self.used
            self.used[row, column] = None
            if not self.to_all and (first or self.settings.credit == "decision"):
                self._signal(row, column, self.signals[row, column])
            answer = self.world.step(self.view.columns[column])
            steps, losses, total = steps + 1, losses + answer.lost, total + answer.reward
            if answer.lost and not self.to_all:
                self._signal(row, column, self.settings.loss_signal * answer.lost)
            ended, success = answer.ended, answer.success
            if not ended:
                row = self.view.row(answer.input)
        # a failed trial must not look fast to the time signal, however early it ended
        self._finish(steps if success else self.world.limit, usual_steps)
        return steps, success, losses, total

    def _signal(self, row: int, column: int, signal: float) -> None:
        if self.learn:
            self.weights[row, column] = rules.reinforce(self.weights[row, column], signal, self.settings.floor)

    def _finish(self, steps: int, usual_steps: float | None) -> None:
        """Apply the global signal of the time taken, and a sweep's credit to all inputs."""
        size, limit = self.view.task.time_reward, self.world.limit
        reward = 0.0
        if self.held is not None or self.settings.time_signal == "inverted":  # a sweep is judged by its time
            reward = size * (1 - steps / limit)
        elif self.settings.time_signal == "baseline" and usual_steps is not None:
            reward = 2 * size * (usual_steps - steps) / limit
        pairs = list(self.used)
        if self.to_all and self.held is not None:
            pairs = [(row, self.held) for row in range(len(self.weights))]
        for row, column in pairs:
            self._signal(row, column, reward + (self.signals[row, column] if self.to_all else 0.0))


def outcomes_of(records: list[tuple[int, bool, int, float]], limit: int) -> StepOutcomes:
    """Return the outcomes of trials recorded as (steps, success, losses, return)."""
    columns: list[Any] = list(zip(*records, strict=True)) if records else [(), (), (), ()]
    return StepOutcomes(
        steps=np.array(columns[0], dtype=np.int64),
        success=np.array(columns[1], dtype=np.bool_),
        losses=np.array(columns[2], dtype=np.int64),
        limit=limit,
        returns=np.array(columns[3], dtype=np.float64),
    )
