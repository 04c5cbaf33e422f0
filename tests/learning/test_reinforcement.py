"""Learning by reinforcement of weights, in a small world: a corridor with a gate that opens and shuts."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest

import tasklift as tl
from tasklift.errors import TaskliftError
from tasklift.learning.chances import SWEEP_STAGE, TARGET_STAGE
from tasklift.learning.learner import Run
from tasklift.learning.reinforcement import Reinforcement, Sweep, reinforce, sweep
from tasklift.learning.worlds import Outcomes
from tasklift.tasks import choice as rules
from tasklift.tasks.policy import Policy, swap
from tasklift.tasks.task import Signal, Task, Variable

LIMIT = 30


class Corridor:
    """Three places in a row, the gate before the last; who enters the shut gate is lost, and begins again.

    Inputs: the place, and whether the gate is seen to be shut. Outputs: stay or go. Without the hazard the
    gate is always open. One trial is one walk to the end.
    """

    task = Task(
        "corridor",
        (Variable("place", (0, 1, 2)), Variable("shut", (0, 1))),
        (Variable("go", (0, 1)),),
        signals=(Signal(-0.1, {"go": 0, "shut": 0}), Signal(0.1, {"go": 0, "shut": 1})),
        time_reward=0.1,
    )

    def __init__(self, hazard: bool = True) -> None:
        self.hazard = hazard

    def run(
        self,
        task,
        weights,
        *,
        trials,
        seed,
        stage,
        reinforcement,
        outputs=None,
        first_trial=0,
        learn=True,
        max_losses=None,
    ) -> Outcomes:
        signals, rows = task.signal_table(), task.input_rows(self.task)
        records: list[tuple[int, bool, int]] = []
        for i in range(trials):
            if max_losses is not None and sum(r[2] for r in records) >= max_losses:
                break
            rng = np.random.default_rng([seed, stage, first_trial + i])
            place, steps, losses = 0, 0, 0
            pairs: list[tuple[int, int]] = []
            while place < 3 and steps < LIMIT:
                shut = int(self.hazard and rng.random() < 0.5)
                row = int(rows[self.task.input_index({"place": place, "shut": shut})])
                greedy = {"exploration": 0.0, "exploitation": 1.0}.get(
                    reinforcement.selection, reinforcement.q
                )
                chosen = rules.select(weights[row], greedy, rng.random(), rng.random())
                output = int(outputs[i]) if outputs is not None else chosen
                pairs.append((row, output))
                if learn and outputs is None:
                    weights[row, output] = rules.reinforce(
                        weights[row, output], signals[row, output], reinforcement.floor
                    )
                go = output == 1
                if go and shut and place == 2:
                    losses, place = losses + 1, 0
                elif go:
                    place += 1
                steps += 1
            if learn:
                if outputs is not None:
                    pairs = [(s, int(outputs[i])) for s in range(len(weights))]
                for row, output in set(pairs):
                    reward = task.time_reward * (1 - steps / LIMIT)
                    local = signals[row, output] if outputs is not None else 0.0
                    weights[row, output] = rules.reinforce(
                        weights[row, output], reward + local, reinforcement.floor
                    )
            records.append((steps, place == 3, losses))
        table = np.array(records, dtype=np.int64).reshape(-1, 3)
        return Outcomes(table[:, 0], table[:, 1].astype(bool), table[:, 2], LIMIT)


def simple_task() -> Task:
    return Corridor.task.simplify(fix={"shut": 0}, time_reward=0.2)


def test_the_whole_method_on_a_world_that_is_not_a_building() -> None:
    safe = simple_task()
    v = sweep(Corridor(hazard=False), safe, repeats=5, seed=1)
    assert v.weights.shape == (3, 2)
    assert (v.best() == 1).all()
    t = v.extend(Corridor.task, [swap("go", when={"shut": 1})])
    assert (t.best() == [1, 0, 1, 0, 1, 0]).all()
    world = Corridor()
    lifted = reinforce(world, t, trials=60, seed=1)
    scratch = reinforce(world, Policy.equal(Corridor.task), trials=60, seed=1)
    assert lifted.outcomes.losses.sum() < scratch.outcomes.losses.sum()
    assert np.array_equal(t.weights, v.extend(Corridor.task, [swap("go", when={"shut": 1})]).weights)


def test_a_sweep_tries_every_output_as_often() -> None:
    curve = Sweep(repeats=3).learn(Corridor(hazard=False), Policy.equal(simple_task()), Run())
    assert len(curve.outcomes) == 6
    # staying never ends, going takes three steps; all of one round come before the next
    assert curve.outcomes.steps.tolist() == [LIMIT, 3] * 3
    stay, go = 1.5 - 3 * 0.1, 1.5 + 3 * 0.2 * (1 - 3 / LIMIT)
    assert curve.policy.weights == pytest.approx(np.tile([stay, go], (3, 1)))
    again = sweep(Corridor(hazard=False), simple_task(), repeats=1, initial=curve.policy)
    assert again.weights[0, 0] == pytest.approx(1.5 - 4 * 0.1)


def test_everything_is_repeatable_and_a_run_can_go_on() -> None:
    world, start = Corridor(), Policy.equal(Corridor.task)
    whole = reinforce(world, start, trials=40, seed=9)
    first = reinforce(world, start, trials=15, seed=9)
    rest = reinforce(world, first.policy, trials=25, seed=9, first_trial=15)
    assert np.array_equal(rest.policy.weights, whole.policy.weights)
    assert np.array_equal(np.append(first.outcomes.steps, rest.outcomes.steps), whole.outcomes.steps)
    other = reinforce(world, start, trials=40, seed=10)
    assert not np.array_equal(other.outcomes.steps, whole.outcomes.steps)


def test_no_trial_begins_after_the_cap() -> None:
    curve = reinforce(Corridor(), Policy.equal(Corridor.task), trials=500, seed=2, max_losses=20)
    losses = curve.outcomes.losses
    assert losses[:-1].sum() < 20 <= losses.sum()
    assert len(curve.outcomes) < 500


def test_provenance_tells_the_whole_story() -> None:
    settings = Reinforcement(q=0.5, selection="pseudo-random")
    v = sweep(Corridor(False), simple_task(), repeats=2, seed=4)
    t = v.extend(Corridor.task, [swap("go", when={"shut": 1})])
    told = reinforce(Corridor(), t, trials=7, seed=5, reinforcement=settings, max_losses=90).policy.provenance
    assert told["learned_by"] == "reinforce"
    assert (told["seed"], told["stage"], told["max_losses"]) == (5, TARGET_STAGE, 90)
    assert told["settings"] == dataclasses.asdict(settings)
    assert told["before"]["prior"][0]["operation"] == "swap"
    swept = told["before"]["before"]
    assert (swept["learned_by"], swept["stage"], swept["outcomes"]["trials"]) == ("sweep", SWEEP_STAGE, 4)


def test_the_public_names_are_the_real_ones() -> None:
    assert tl.sweep is sweep
    assert tl.Reinforcement is Reinforcement
    for name in tl.__all__:
        assert getattr(tl, name) is not None
    with pytest.raises(AttributeError, match="no attribute 'nothing'"):
        _ = tl.nothing


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"initial_weight": float("nan")}, "initial_weight: expected finite numbers"),
        ({"initial_weight": "1"}, "initial_weight: expected a number"),
        ({"floor": -1.0}, "floor: weights are not negative"),
        ({"floor": 2.0}, "at least the floor 2.0"),
        ({"sweep_credit": "some"}, "sweep_credit: expected one of all, visited"),
        ({"credit": "step"}, "credit: expected one of decision, trial"),
        ({"time_signal": None}, "time_signal: expected one of"),
        ({"selection": "best"}, "selection: expected one of exploration"),
        ({"q": 1.1}, "q: a probability"),
        ({"loss_signal": 0.5}, "loss_signal: a loss is not rewarded"),
    ],
)
def test_settings_are_checked(change: dict, message: str) -> None:
    with pytest.raises(TaskliftError, match=message):
        Reinforcement(**change)


@pytest.mark.parametrize(
    ("call", "message"),
    [
        (lambda w, p: reinforce(w, p, trials=-1), "trials: expected a whole number from 0 to"),
        (lambda w, p: reinforce(w, p, trials=True), "trials: expected a whole number"),
        (lambda w, p: reinforce(w, p, seed=0.5), "seed: expected a whole number"),
        (lambda w, p: reinforce(w, p, max_losses=0), "max_losses: expected a whole number of at least 1"),
        (lambda w, p: sweep(w, p.task, repeats=0), "repeats: expected a whole number of at least 1"),
        (lambda w, p: sweep(w, simple_task(), initial=p), "policy is of another task: input 'shut'"),
        (lambda w, p: reinforce(w, Policy(p.task, p.weights, kind="value")), "policy of weights"),
    ],
)
def test_mistakes_are_named_before_anything_runs(call, message: str) -> None:
    with pytest.raises(TaskliftError, match=message):
        call(Corridor(), Policy.equal(Corridor.task))


def test_outcomes_need_an_entry_per_trial() -> None:
    with pytest.raises(TaskliftError, match="one entry per trial"):
        Outcomes(np.zeros(3, np.int64), np.zeros(2, bool), np.zeros(3, np.int64), 5)
