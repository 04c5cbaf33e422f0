"""No argument of the public functions reaches the compiled code out of its range.

Every argument is driven beyond its range, one at a time. The call must refuse it with the project's own error, or work
where the argument may have this value. Anything else, a crash of the interpreter included, fails.
"""

from __future__ import annotations

import numpy as np
import pytest

import tasklift as tl
from tasklift.building import SCOUT, WEAPON, Kind, Mission, Reading, generate
from tasklift.building.search import search_only
from tasklift.building.simulator import Simulator
from tasklift.errors import TaskliftError

BUILDING = generate(intersections=9, corridors=11, rooms=3, features=6, doors=3, seed=5)
HUNT = Mission(BUILDING, "3+2", limit=20)
TASK, SHAPE = HUNT.task, HUNT.task.shape
POLICY = tl.Policy.equal(TASK)
LEARNER = tl.Reinforcement()

NUMBERS = (-1, -(2**63), 2**31, 2**32, 2**63, 10**30, 0.5, 1e300, float("nan"), float("inf"), -float("inf"), True)
THINGS = (None, "1", "²", b"1", "", [], {}, (), [1, 2], object(), np.arange(3), np.array(2.5))
ODD = (*NUMBERS, *map(np.float64, (-1, 7.5, np.nan)), np.uint64(2**64 - 1), np.int8(-1), *THINGS)


def arrays(shape):
    """Tables that do not fit: shape, type, order, content."""
    good = np.ones(shape)
    yield from (good[:-1], good[:, :-1], good[:, ::-1], np.asfortranarray(good), good.astype(np.float32), good > 0)
    yield from (good.astype(int), good.astype(object), good.astype(complex), good.tolist(), good[None, None])
    for value in (np.nan, np.inf, -1.0):
        spoiled = good.copy()
        spoiled[-1, -1] = value
        yield spoiled
    frozen = good.copy()
    frozen.flags.writeable = False
    yield frozen
    yield np.frombuffer(b"\0" + good.tobytes(), np.uint8)[1:].view(np.float64).reshape(shape)


@pytest.fixture(autouse=True)
def failures():
    """Collect what went wrong, so that one run shows all of it."""
    FAILED.clear()
    yield
    assert not FAILED, "\n".join(FAILED)


FAILED: list[str] = []


def must_refuse_or_work(call, also=(), **arguments):
    try:
        return call(**arguments)
    except also:
        pass
    except TaskliftError as error:
        if "\n" in str(error) or len(str(error)) > 300:
            FAILED.append(f"{call}: not one line of at most 300 characters: {error}")
    except Exception as error:
        shown = {name: repr(value)[:60] for name, value in arguments.items()}
        FAILED.append(f"{call}: {type(error).__name__}: {error}; with {shown}")


def drive(call, good, odd=ODD, also=()):
    call(**good)
    for name in good:
        for value in odd:
            must_refuse_or_work(call, also, **(good | {name: value}))


def test_missions_readings_and_kinds():
    drive(Mission, {"building": BUILDING, "team": "3+2", "hostiles": 1, "reading": Reading(), "weapons_needed": 2,
                    "limit": 20})  # fmt: skip
    for number in ODD:
        must_refuse_or_work(Mission, building=BUILDING, team={SCOUT: number, WEAPON: 2})
        must_refuse_or_work(Mission, building=BUILDING, team="3+2", hostiles=(number,))
        must_refuse_or_work(Mission, building=BUILDING, team="3+2", hostiles=[number, number])
    drive(Kind, {"name": "tank", "speed_mm": 700, "armed": True})
    drive(Reading, {name: getattr(Reading(), name) for name in Reading.__dataclass_fields__})
    drive(Simulator, {"mission": HUNT})


@pytest.mark.parametrize("field", [*Reading.__dataclass_fields__])
def test_what_a_reading_takes_also_runs(field):
    for value in (0, 1, 0.001, 100, 1e7, 1e9, 10**9, True, False, "robots", "pairs", "team", "robot", "memoryless"):
        reading = must_refuse_or_work(Reading, **{field: value})
        if reading is not None:
            Mission(BUILDING, "3+2", reading=reading, limit=20).evaluate(POLICY, 2)


def test_running_and_evaluating():
    good = {"task": TASK, "weights": np.ones(SHAPE), "trials": 1, "seed": 0, "stage": 2, "reinforcement": LEARNER,
            "outputs": np.zeros(1, int), "first_trial": 0, "learn": True, "max_losses": 1}  # fmt: skip
    drive(HUNT.run, good)
    for outputs in ([44], [-1], [0.5], [True], np.array([2**40]), [[0]], np.array([np.nan]), ["0"], [None]):
        must_refuse_or_work(HUNT.run, **(good | {"outputs": outputs}))
    for weights in arrays(SHAPE):
        must_refuse_or_work(HUNT.run, **(good | {"weights": weights}))
    many = {"task": TASK, "weights": np.ones((2, *SHAPE)), "trials": 1, "seeds": [0, 1], "stage": 2,
            "reinforcement": LEARNER, "outputs": None, "first_trial": 0, "learn": True, "max_losses": None,
            "threads": 1}  # fmt: skip
    drive(HUNT.simulator.run_many, many)
    for seeds in ([0], [0, 1, 2], [0, -1], [0, 2**63], [0, None], ["a", "b"], [True, False], np.array([0.5, 1])):
        must_refuse_or_work(HUNT.simulator.run_many, **(many | {"seeds": seeds}))
    drive(HUNT.evaluate, {"policies": POLICY, "episodes": 1, "seed": 0, "reinforcement": LEARNER, "stage": 5,
                          "first_episode": 0, "threads": 1})  # fmt: skip
    for weights in arrays(SHAPE):
        must_refuse_or_work(HUNT.evaluate, policies=weights, episodes=1)
        must_refuse_or_work(HUNT.evaluate, policies=[weights], episodes=1)
        must_refuse_or_work(HUNT.evaluate, policies=np.asarray(weights)[None], episodes=1)


def test_traces_and_single_steps():
    drive(HUNT.simulator.trace, {"policy": POLICY, "seed": 0, "trial": 0, "stage": 2, "reinforcement": LEARNER,
                                 "output": 0, "learn": True})  # fmt: skip
    for output in (44, 1_000_000, -1):
        with pytest.raises(TaskliftError, match="from 0 to 43"):
            HUNT.simulator.trace(POLICY, output=output)
    simulator = HUNT.simulator
    drive(simulator.lane, {"shape": SHAPE}, (*ODD, (90,), (90, -1), (10**9, 10**9), (90, 44, 1), (0.5, 3)))
    drive(simulator.learner, {"task": TASK, "reinforcement": LEARNER, "sweep": True, "learn": True})
    drive(simulator.keys, {"seed": 0, "stage": 2})
    lane, learner = simulator.lane(SHAPE), simulator.learner(TASK, LEARNER)
    drive(simulator.begin_trial, {"lane": lane, "seed": 0, "stage": 2, "trial": 0})
    other = Mission(generate(seed=3), "10+5").simulator
    lanes = (simulator.lane((15, 44)), other.lane(SHAPE), lane._replace(weights=np.ones((2, 2))))
    learners = (simulator.learner(search_only(TASK), LEARNER), learner._replace(rows=np.full(3, 10**6)), lane)
    simulator.begin_trial(lane, 0, 2, 0)
    for odd in (*lanes, *ODD):
        must_refuse_or_work(simulator.step, learner=learner, lane=odd)
        must_refuse_or_work(simulator.begin_trial, lane=odd, seed=0, stage=2, trial=0)
    for odd in (*learners, *ODD):
        must_refuse_or_work(simulator.step, learner=odd, lane=lane)


def test_steered_simulations():
    simulator = HUNT.simulator
    names = ("progress_reward", "loss_reward", "success_reward", "signal_weight", "team_share")
    rewards = dict.fromkeys(names, 1.0)
    drive(simulator.steered, {"n": 2, **rewards}, (*ODD, 0, 2**40))
    steered, learner = simulator.steered(2, **rewards), simulator.learner(TASK, LEARNER, learn=False)
    other = Mission(generate(seed=3), "10+5").simulator.steered(2, **rewards)
    numbers = np.arange(2)
    for odd in (other, *ODD):
        must_refuse_or_work(simulator.seed_steered, steered=odd, seeds=[0, 1], stage=2)
        must_refuse_or_work(simulator.begin_steered, steered=odd, which=numbers)
        must_refuse_or_work(simulator.step_steered, learner=learner, steered=odd)
    for odd in (*ODD, [0], [0, 2**63], [0, -1], [0.5, 1]):
        must_refuse_or_work(simulator.seed_steered, steered=steered, seeds=odd, stage=2)
    for odd in (*ODD, np.array([2]), np.array([-1]), np.array([0.0]), np.array([[0]])):
        must_refuse_or_work(simulator.begin_steered, steered=steered, which=odd)
    simulator.begin_steered(steered, numbers)
    for odd in (simulator.learner(search_only(TASK), LEARNER), *ODD):
        must_refuse_or_work(simulator.step_steered, learner=odd, steered=steered)
    for output in (44, -1, 2**40):
        steered.outputs[1, 3] = output
        with pytest.raises(TaskliftError, match="from 0 to 43"):
            simulator.step_steered(learner, steered)


def test_policies_and_tasks():
    """These are plain Python, where a thing of another type may be answered with Python's own error."""
    kinds = (TypeError, AttributeError)
    for name, good in {"weights": np.ones(SHAPE), "kind": "weight"}.items():
        for odd in (*NUMBERS, "²", None, [1, 2], good):
            must_refuse_or_work(tl.Policy, task=TASK, **({"weights": np.ones(SHAPE)} | {name: odd}), also=kinds)
    for weights in arrays(SHAPE):
        policy = must_refuse_or_work(tl.Policy, task=TASK, weights=weights)
        if policy is not None:
            HUNT.evaluate(policy, 1)
    drive(POLICY.row, {"input": 0})
    drive(POLICY.probabilities, {"input": 0, "selection": "exploration", "q": 0.9})
    drive(POLICY.select, {"input": 0, "selection": "exploration", "q": 0.9, "u": 0.5, "coin": 0.5})
    drive(TASK.input_values, {"index": 0})
    drive(TASK.output_values, {"index": 0})
    drive(TASK.input_index, {"values": TASK.input_values(3)})
    for name, good in TASK.input_values(3).items():
        drive(lambda **values: TASK.input_index(TASK.input_values(3) | values), {name: good})
    drive(tl.Signal, {"value": 0.1})
    drive(tl.Task, {"name": "x", "inputs": TASK.inputs, "outputs": TASK.outputs, "impossible_signal": -0.5,
                    "time_reward": 0.1}, NUMBERS, also=kinds)  # fmt: skip
    drive(tl.Policy.equal, {"task": TASK, "weight": 1.5}, NUMBERS, also=kinds)
    drive(tl.scale, {"factor": 0.5}, NUMBERS)
    drive(tl.set_weight, {"value": 0.5}, NUMBERS)
