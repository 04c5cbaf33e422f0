"""Checks of worlds and learners: the promises that curricula, budgets, caps and paired comparisons rest on."""

from __future__ import annotations

import json
from dataclasses import fields, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from tasklift.errors import TaskliftError
from tasklift.learning.chances import Chances
from tasklift.learning.learner import Curve, Learner, Run, check, count_as, divisible
from tasklift.learning.reinforcement import Reinforcement
from tasklift.learning.worlds import Outcomes, Step, Steps, Trials, joined
from tasklift.tasks.policy import Policy
from tasklift.tasks.task import Task


def check_world(world: Trials | Steps, task: Task | None = None, *, trials: int = 6, seed: int = 0) -> None:
    """Check that a world keeps the promises of :class:`.Steps` or :class:`.Trials`.

    Every answer has the right type and range. A trial depends on its seed, stage and number, and on nothing that ran
    before. A world of whole trials leaves the weights alone when asked to, learns the same twice, and begins no trial
    after a cap on losses.

    Parameters
    ----------
    world
        The world to check; it is run.
    task
        Of a world of whole trials: run this simplification of its task. Default: the task itself.
    trials
        How many to run of each kind.
    seed
        Of all random numbers, the outputs tried included.

    Raises
    ------
    AssertionError
        With the promise that is broken and the values found.

    Examples
    --------
    >>> from tasklift.building import Mission, generate
    >>> check_world(Mission(generate(seed=7), team="10+5", limit=100))
    """
    assert isinstance(world.task, Task), f"world, task: expected a Task, found {type(world.task).__name__}"
    if isinstance(world, Steps):
        _check_steps(world, trials, seed)
    else:
        _check_trials(world, world.task if task is None else task, trials, seed)


def _check_steps(world: Steps, trials: int, seed: int) -> None:
    limit = world.limit
    assert _whole(limit, 1), f"world, limit: expected a whole number of steps of at least 1, found {limit!r}"
    first = [_walk(world, trial, seed) for trial in range(trials)]
    for trial in reversed(range(trials)):
        again = _walk(world, trial, seed)
        for number, (before, now) in enumerate(zip(first[trial], again, strict=False)):
            assert before == now, (
                f"world: trial {trial} run again with the same random numbers and outputs differs at answer {number}: "
                f"{before} then {now}; take all random numbers from the generator, and keep nothing between trials"
            )
        assert len(again) == len(first[trial]), (
            f"world: trial {trial} run again has {len(again) - 1} steps, before {len(first[trial]) - 1}"
        )


def _walk(world: Any, trial: int, seed: int) -> list[Any]:
    """Run a trial with possible outputs at random; return the first input and every answer, by agent if several."""
    inputs, outputs = world.task.shape
    choose, begun = np.random.default_rng([seed, trial]), world.start(Chances(seed, 0).of(trial))
    team = isinstance(begun, dict)

    def by_agent(value: Any) -> dict[Any, Any]:
        return dict(value or {}) if team else {None: value}

    begun = by_agent(begun)
    for seen in begun.values():
        assert _whole(seen, 0, inputs), f"world, start: expected an input from 0 to {inputs - 1}, found {seen!r}"
    walked: list[Any] = [{agent: int(seen) for agent, seen in begun.items()}]
    acting = list(begun)
    while acting and len(walked) <= world.limit:
        masks = by_agent(getattr(world, "possible", None))
        chosen = {agent: _choice(masks.get(agent), outputs, choose) for agent in acting}
        answers = by_agent(world.step(chosen if team else chosen[None]))
        for answer in answers.values():
            _check_answer(answer, inputs)
        assert answers.keys() == chosen.keys(), f"world, step: expected answers for {acting}, found {list(answers)}"
        walked.append(answers)
        acting = [agent for agent, answer in answers.items() if not (answer.ended or answer.cut)]
    return walked


def _choice(mask: Any, outputs: int, choose: np.random.Generator) -> int:
    """Return an output at random, among those that the world says are possible."""
    if mask is None:
        return int(choose.integers(outputs))
    assert np.shape(mask) == (outputs,), f"world, possible: expected {outputs} truth values, found {mask!r}"
    assert np.any(mask), "world, possible: no output is possible in a trial that goes on"
    return int(choose.choice(np.flatnonzero(mask)))


def _check_answer(answer: Step, inputs: int) -> None:
    where = f"world, step: in {answer!r}"
    assert isinstance(answer, Step), f"world, step: expected a Step, found {answer!r}"
    # once a trial has ended, nobody looks at the input; a trial that is cut off goes on from it in learners' eyes
    looked_at = not answer.ended or answer.cut
    assert not looked_at or _whole(answer.input, 0, inputs), f"{where}, expected an input from 0 to {inputs - 1}"
    good = isinstance(answer.reward, int | float | np.number) and np.isfinite(answer.reward)
    assert good, f"{where}, expected a finite number as the reward"
    assert _whole(answer.lost, 0), f"{where}, expected a whole number of losses of at least 0"
    for name in ("ended", "success"):
        value = getattr(answer, name)
        assert isinstance(value, bool | np.bool_), f"{where}, expected true or false in {name}"


def _check_trials(world: Trials, task: Task, trials: int, seed: int) -> None:
    rules = Reinforcement()

    def run(weights: NDArray[np.float64], number: int = trials, **options: Any) -> Outcomes:
        asked: dict[str, Any] = {"seed": seed, "stage": 2, "reinforcement": rules} | options
        found = world.run(task, weights, trials=number, **asked)
        _check_outcomes(found, number, "world, run")
        return found

    start = np.full(task.shape, rules.initial_weight)
    weights = start.copy()
    played = run(weights, learn=False)
    assert np.array_equal(weights, start), "world, run: learn=False, and the weights changed"
    _same(played, run(weights, learn=False), "world: the same trials, run twice without learning, differ")
    half = trials // 2
    late = run(weights, trials - half, learn=False, first_trial=half)
    _same(_part(played, half, trials), late, f"world: trial {half} on depend on the trials before them")
    one, two = start.copy(), start.copy()
    whole = run(one)
    assert len(whole) == trials, f"world, run: asked for {trials} trials, found {len(whole)}"
    parts = joined([run(two, half), run(two, trials - half, first_trial=half)])
    assert np.isfinite(one).all(), "world, run: weights are not finite after learning"
    assert one.min() >= rules.floor, f"world, run: a weight of {one.min()} is below the floor {rules.floor}"
    _same(whole, parts, f"world: learning cut after {half} trials differs from learning in one piece")
    assert np.array_equal(one, two), f"world: learning cut after {half} trials comes to other weights"
    fixed = np.arange(trials, dtype=np.int64) % task.shape[1]
    first, again = (run(start.copy(), outputs=fixed) for _ in range(2))
    _same(first, again, "world: a sweep, run twice, differs")
    if (lost := int(played.losses.sum())) > 0:
        cap = (lost + 1) // 2
        capped = run(start.copy(), learn=False, max_losses=cap)
        _check_cap(capped, cap, "world, run")
        _same(_part(played, 0, len(capped)), capped, "world: the trials before a cap differ from those without one")


def check_learner(learner: Learner, world: Trials | Steps, *, trials: int = 12, seed: int = 0) -> None:
    """Check that a learner keeps the promises of :class:`.Learner`, by learning on a world.

    It starts with a policy of the task. It leaves the policy it is given as it was, learns the same twice whatever ran
    before, keeps to budgets and caps, can be cut in two (unless it says ``divisible = False``), and returns a policy
    that can be saved, extended and learned on.

    Parameters
    ----------
    learner
        The learner to check.
    world
        A world that :func:`check_world` finds nothing wrong with.
    trials
        How many to learn from, some ten times over.
    seed
        Of all random numbers.

    Raises
    ------
    AssertionError
        With the promise that is broken and the values found.

    Examples
    --------
    >>> from tasklift import Reinforcement
    >>> from tasklift.building import Mission, generate
    >>> check_learner(Reinforcement(), Mission(generate(seed=7), team="10+5", limit=100))
    """
    name, task = type(learner).__name__, world.task
    start = learner.start(task)
    assert isinstance(start, Policy), f"{name}, start: expected a Policy, found {type(start).__name__}"
    assert start.task == task, f"{name}, start: expected a policy of {task.name!r}, found one of {start.task.name!r}"
    _same_policy(start, learner.start(task), f"{name}, start: two starts on one task differ")
    asked = Run(seed=seed, trials=trials)
    kept = replace(start)

    def learn(policy: Policy, run: Run) -> Curve:
        curve = learner.learn(world, policy, run)
        what = f"{name}, learn: {run}"
        assert isinstance(curve, Curve), f"{what}: expected a Curve, found {type(curve).__name__}"
        found = curve.policy
        assert found.task == policy.task, f"{what}: came back with a policy of another task, {found.task.name!r}"
        assert found.kind == policy.kind, f"{what}: took a policy of {policy.kind}s, came back with {found.kind}s"
        _check_outcomes(curve.outcomes, run.trials, what)
        return curve

    whole = learn(start, asked)
    _same_policy(start, kept, f"{name}, learn: changed the policy that it was given")
    nothing = learn(start, replace(asked, trials=0))
    assert np.array_equal(nothing.policy.weights, start.weights), f"{name}, learn: 0 trials changed the weights"
    again = learn(start, asked)
    _same(whole.outcomes, again.outcomes, f"{name}: the same run, learned twice, has other outcomes")
    _same_policy(whole.policy, again.policy, f"{name}: the same run, learned twice, differs")
    if divisible(learner):
        half = trials // 2
        first = learn(start, replace(asked, trials=half))
        rest = learn(first.policy, replace(asked, first_trial=half, trials=trials - half))
        what = f"{name}: a run cut after {half} of {trials} trials (if that must be so, set divisible = False)"
        _same(whole.outcomes, joined([first.outcomes, rest.outcomes]), f"{what} has other outcomes")
        _same_policy(whole.policy, rest.policy, f"{what} differs")
    _check_budgets(learn, whole.outcomes, start, asked, learner, world)
    _check_use(learner, whole.policy, name)


def _check_budgets(
    learn: Any, whole: Outcomes, start: Policy, asked: Run, learner: Learner, world: Trials | Steps
) -> None:
    name = type(learner).__name__
    lost, walked = int(whole.losses.sum()), int(whole.steps.sum())
    if lost > 0:
        cap = (lost + 1) // 2
        _check_cap(learn(start, replace(asked, max_losses=cap)).outcomes, cap, f"{name}, learn: max_losses={cap}")
    by_steps = replace(asked, trials=None, steps=max(1, walked // 2))
    try:
        check(learner, world, start.task, by_steps)
    except TaskliftError:
        return  # a learner may refuse a budget of steps
    found = learn(start, by_steps).outcomes.steps
    assert found[:-1].sum() < (by_steps.steps or 0) <= found.sum(), (
        f"{name}, learn: steps={by_steps.steps}: expected the last trial to begin before and to end after, "
        f"found {int(found[:-1].sum())} steps before it and {int(found.sum())} after it"
    )


def _check_use(learner: Learner, policy: Policy, name: str) -> None:
    try:
        json.dumps(dict(policy.provenance))
    except (TypeError, ValueError) as error:
        broken = f"{name}, learn: the policy cannot be saved, its provenance is not JSON: {error}"
        raise AssertionError(broken) from error
    policy.extend(policy.task)
    try:
        counted = count_as(learner, policy, 3.0)
    except TaskliftError:
        return  # a learner may refuse to weigh experience
    assert counted.task == policy.task, f"{name}, count_as: came back with a policy of another task"
    assert counted.kind == policy.kind, f"{name}, count_as: took {policy.kind}s, came back with {counted.kind}s"


# -- comparing ---------------------------------------------------------------------------------------------------


def _whole(value: Any, least: int, end: float = float("inf")) -> bool:
    return isinstance(value, int | np.integer) and not isinstance(value, bool) and bool(least <= value < end)


def _check_outcomes(outcomes: Outcomes, most: int | None, where: str) -> None:
    assert isinstance(outcomes, Outcomes), f"{where}: expected Outcomes, found {type(outcomes).__name__}"
    assert most is None or len(outcomes) <= most, f"{where}: at most {most} trials, found {len(outcomes)}"
    for column, kind in (("steps", "i"), ("losses", "i"), ("success", "b")):
        found = getattr(outcomes, column)
        assert found.dtype.kind == kind, f"{where}: {column} are of type {found.dtype}, expected {kind!r}"
    assert not len(outcomes) or outcomes.steps.min() >= 1, f"{where}: a trial has {outcomes.steps.min()} steps"
    assert not len(outcomes) or outcomes.losses.min() >= 0, f"{where}: a trial lost {outcomes.losses.min()}"


def _check_cap(outcomes: Outcomes, cap: int, where: str) -> None:
    before = int(outcomes.losses[:-1].sum())
    assert before < cap, f"{where}: a trial began after {before} losses, with a cap of {cap}"


def _part(outcomes: Outcomes, begin: int, end: int) -> Outcomes:
    arrays = {f.name: getattr(outcomes, f.name) for f in fields(outcomes)}
    cut: dict[str, Any] = {n: a[begin:end] for n, a in arrays.items() if isinstance(a, np.ndarray)}
    return replace(outcomes, **cut)


def _same(one: Outcomes, other: Outcomes, broken: str) -> None:
    assert len(one) == len(other), f"{broken}: {len(one)} trials and {len(other)}"
    for column in (f.name for f in fields(one) if isinstance(getattr(one, f.name), np.ndarray)):
        left, right = getattr(one, column), getattr(other, column)
        if not np.array_equal(left, right):
            trial = int(np.argmax([not np.array_equal(a, b) for a, b in zip(left, right, strict=True)]))
            raise AssertionError(f"{broken}: {column} of trial {trial} are {left[trial]} and {right[trial]}")


def _same_policy(one: Policy, other: Policy, broken: str) -> None:
    assert set(one.carried) == set(other.carried), f"{broken}: carry {sorted(one.carried)} and {sorted(other.carried)}"
    tables = [("weights", one.weights, other.weights)]
    for name, value in one.carried.items():
        tables.append((f"carried {name!r}", np.atleast_1d(value), np.atleast_1d(other.carried[name])))
    for name, left, right in tables:
        if not np.array_equal(left, right):
            at = tuple(int(i) for i in np.argwhere(left != right)[0])
            raise AssertionError(f"{broken}: {name} at {at} are {left[at]} and {right[at]}")
