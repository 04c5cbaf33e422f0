"""Curricula: what enters a stage, the ledger and its caps, rollback, the guard and its error rates, the verdict."""

from __future__ import annotations

from collections import Counter
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from test_reinforcement import Corridor, simple_task
from test_values import Gate, random_model

from tasklift.errors import TaskliftError
from tasklift.learning.chances import SWEEP_STAGE, TARGET_STAGE
from tasklift.learning.compare import compare
from tasklift.learning.curriculum import Curriculum, CurriculumRun
from tasklift.learning.guard import Guard, SequentialTest
from tasklift.learning.learner import Run
from tasklift.learning.reinforcement import Fixed, Reinforcement, Sweep, reinforce, sweep
from tasklift.learning.stage import Stage
from tasklift.learning.values import ValueLearning, learn_values
from tasklift.learning.worlds import Outcomes, Step, StepOutcomes
from tasklift.tasks.policy import Policy, set_weight, swap
from tasklift.tasks.task import Signal, Task, Variable

PROPERTY = settings(deadline=None, derandomize=True, max_examples=60)
OPPOSITE = swap("go", when={"shut": 1})


def corridor_curriculum(**target) -> Curriculum:
    options = {"learner": Reinforcement(), "trials": 60, "prior": [OPPOSITE]} | target
    return Curriculum(
        [
            Stage("open", simple_task(), Corridor(hazard=False), Sweep()),
            Stage("gate", Corridor.task, Corridor(), **options),
        ]
    )


# -- stages --------------------------------------------------------------------------------------------------


def test_a_curriculum_does_what_one_would_do_by_hand() -> None:
    run = corridor_curriculum().run(seed=3)
    v = sweep(Corridor(hazard=False), simple_task(), repeats=5, seed=3)
    by_hand = reinforce(Corridor(), v.extend(Corridor.task, [OPPOSITE]), trials=60, seed=3)
    assert np.array_equal(run.policy.weights, by_hand.policy.weights)
    assert np.array_equal(run.outcomes["gate"].losses, by_hand.outcomes.losses)
    assert run.ledger.by_stage() == {"open": 0, "gate": int(by_hand.outcomes.losses.sum())}
    told = run.policy.provenance
    assert (told["stage"], told["trials"], told["seed"]) == ("gate", 60, 3)
    assert told["before"]["prior"][0]["operation"] == "swap"
    assert told["before"]["before"]["stage"] == "open"


@pytest.mark.parametrize("block", [1, 7, 20, 1000, None])
def test_blocks_change_nothing(block: int) -> None:
    learning = ValueLearning(epsilon=0.5, epsilon_decay=0.95, step_size=0.05, step_power=0.7)
    model = random_model(5)
    stage = Stage("all", model.task, model, learning, trials=50)
    run = Curriculum([stage], block=block).run(seed=4)
    whole = learn_values(model, trials=50, seed=4, learning=learning)
    assert np.array_equal(run.policy.weights, whole.policy.weights)
    assert np.array_equal(run.outcomes["all"].returns, whole.outcomes.returns)
    baseline = Reinforcement(time_signal="baseline")
    weights = Stage("all", Corridor.task, Corridor(), baseline, trials=30)
    one_piece = reinforce(Corridor(), Policy.equal(Corridor.task), trials=30, seed=4, reinforcement=baseline)
    assert np.array_equal(Curriculum([weights], block=block).run(4).policy.weights, one_piece.policy.weights)


def test_a_chain_of_three_tasks_by_value() -> None:
    # V1 sees the place only, V2 the gate as well but it is open, T is the gate that opens and shuts
    learner = ValueLearning("sarsa", 0.5, epsilon=0.2, epsilon_decay=0.98)
    safe = Gate.task.simplify(fix={"shut": 0})
    stages = [
        Stage("one", safe, Gate(False), learner, trials=20),
        Stage("two", Gate.task, Gate(False), learner, trials=20),
        Stage("three", Gate.task, Gate(), learner, trials=200),
    ]
    run = Curriculum(stages).run(1)
    assert [e.trials for e in run.ledger.entries] == [20, 20, 200]
    assert run.policy.carried["epsilon"] == pytest.approx(0.2 * 0.98**240)
    again = Curriculum([*stages[:2], replace(stages[2], keep_exploration=False)]).run(1)
    assert again.policy.carried["epsilon"] == pytest.approx(0.2 * 0.98**200)
    assert sum(run.ledger.by_stage().values()) == run.ledger.total == run.outcomes["three"].losses.sum()
    assert run.ledger.per_1000_steps()["one"] == 0
    assert "total losses" in str(run.ledger)


def test_a_budget_of_steps() -> None:
    learner = ValueLearning()
    run = Curriculum([Stage("s", Gate.task, Gate(), learner, steps=300)]).run()
    steps = run.outcomes["s"].steps
    assert steps[:-1].sum() < 300 <= steps.sum()
    weights = Curriculum([Stage("s", Gate.task, Gate(), Reinforcement(), steps=300)]).run().outcomes["s"].steps
    assert weights[:-1].sum() < 300 <= weights.sum()


# -- what stages begin with, and share --------------------------------------------------------------------------


def test_a_stage_may_begin_with_a_policy_of_its_own() -> None:
    expert = Policy(simple_task(), np.tile([1.0, 9.0], (3, 1)))
    first, second = corridor_curriculum().stages
    run = Curriculum([first, replace(second, initial=expert)]).run(2)
    by_hand = reinforce(Corridor(), expert.extend(Corridor.task, [OPPOSITE]), trials=60, seed=2)
    assert np.array_equal(run.policy.weights, by_hand.policy.weights)
    values = Stage("values", Gate.task, Gate(), ValueLearning(), trials=5)
    with pytest.raises(TaskliftError, match="one learns values, one weights"):
        Curriculum([values, Stage("weights", Gate.task, Gate(), Reinforcement(), trials=5)]).check()
    with pytest.raises(TaskliftError, match="stage 'gate': "):
        Curriculum([replace(second, initial=Policy.equal(OTHER))]).check()


def test_prior_knowledge_is_applied_to_a_start_from_scratch_as_well() -> None:
    prior = set_weight(7.0, when={"shut": 1, "go": 0})
    stage = Stage("gate", Corridor.task, Corridor(), Fixed(), trials=1, prior=[prior])
    weights = Curriculum([stage]).run().policy.weights
    assert weights[1::2, 0].tolist() == [7.0] * 3
    assert weights[::2].tolist() == [[1.5, 1.5]] * 3


class Counted(Corridor):
    """Counts the trials that are run on it."""

    ran = 0

    def run(self, *given, **options) -> Outcomes:
        found = super().run(*given, **options)
        self.ran += len(found)
        return found


def same_run(one: CurriculumRun, other: CurriculumRun) -> bool:
    return (
        np.array_equal(one.policy.weights, other.policy.weights)
        and np.array_equal(one.best.weights, other.best.weights)
        and one.ledger == other.ledger
        and one.stopped == other.stopped
        and all(np.array_equal(one.outcomes[s].losses, other.outcomes[s].losses) for s in one.outcomes)
        and one.outcomes.keys() == other.outcomes.keys()
        and one.policy.provenance == other.policy.provenance
    )


@pytest.mark.parametrize("cap", [None, 8])
def test_curricula_that_begin_alike_learn_that_once_and_nothing_changes(cap: int | None) -> None:
    safe, world, shared = Counted(hazard=False), Corridor(), {}
    v = Stage("open", simple_task(), safe, Sweep())
    # the same prior is written anew for each curriculum: equal settings are the same stage
    priors = [[swap("go", when={"shut": 1})] for _ in range(2)]
    drills = [Stage("drill", Corridor.task, world, Reinforcement(), trials=20, key=4, prior=prior) for prior in priors]
    targets = [Stage("gate", Corridor.task, world, Reinforcement(q=q), trials=20) for q in (0.9, 0.5)]
    curricula = [Curriculum([v, d, t], max_losses=cap) for d, t in zip(drills, targets, strict=True)]
    curricula.append(Curriculum([v, targets[0]], max_losses=cap))
    for seed in (0, 1):
        found = [c.run(seed, shared=shared) for c in curricula]
        assert safe.ran == 10 * (seed + 1)
        assert found[0].outcomes["drill"] is found[1].outcomes["drill"]
        alone = [
            Curriculum([replace(v, world=Corridor(hazard=False)), *c.stages[1:]], max_losses=cap).run(seed)
            for c in curricula
        ]
        assert all(same_run(one, other) for one, other in zip(found, alone, strict=True))
        again = [c.run(seed, shared=shared) for c in curricula]
        assert all(one is other for one, other in zip(found, again, strict=True))


def test_worlds_that_cannot_be_compared_are_not_shared() -> None:
    class Unhashable(Corridor):
        __hash__ = None

        def __eq__(self, other: object) -> bool:
            return True

    shared: dict = {}
    stage = Stage("gate", Corridor.task, Unhashable(), Reinforcement(), trials=5)
    assert len(Curriculum([stage]).run(shared=shared).outcomes["gate"]) == 5
    assert not shared


@PROPERTY
@given(
    trial=st.integers(0, 60),
    block=st.sampled_from([1, 7, 20, None]),
    seed=st.integers(0, 9),
    learner=st.sampled_from([Reinforcement(), Reinforcement(time_signal="baseline"), Reinforcement(q=0.5)]),
)
def test_any_policy_on_the_way_can_be_had_again(
    trial: int, block: int | None, seed: int, learner: Reinforcement
) -> None:
    curriculum = replace(corridor_curriculum(learner=learner), block=block)
    found = curriculum.policy_at(seed, "gate", trial)
    first, second = curriculum.stages
    entered = second.enter(Curriculum([first], block=block).run(seed).policy)
    by_hand = reinforce(Corridor(), entered, trials=trial, seed=seed, reinforcement=learner)
    assert np.array_equal(found.weights, by_hand.policy.weights)
    swept = curriculum.policy_at(seed, "open", min(trial, 9))
    part = Sweep().learn(Corridor(False), Policy.equal(simple_task()), Run(seed, SWEEP_STAGE, trials=min(trial, 9)))
    assert np.array_equal(swept.weights, part.policy.weights)


def test_the_policy_of_a_trial_under_a_guard() -> None:
    wrong = Policy(Gate.task, np.array([[100.0, -100.0]] * 6), kind="value")
    learner = ValueLearning("sarsa", 0.02, discount=1.0, epsilon=0.1)
    guard = Guard("return", 0.3, on_hurts="decay")
    stage = Stage("gate", Gate.task, Gate(), learner, trials=120, guard=guard)
    curriculum = Curriculum([stage], block=5)
    run = curriculum.run(1, initial=wrong)
    assert run.guards["gate"].actions
    ends = len(run.outcomes["gate"])
    assert np.array_equal(curriculum.policy_at(1, "gate", ends, initial=wrong).weights, run.policy.weights)
    # every trial begun anew from the policy it began with comes out as it did
    for trial in range(0, ends, 7):
        policy = curriculum.policy_at(1, "gate", trial, initial=wrong)
        one = learner.learn(Gate(), policy, Run(1, TARGET_STAGE, first_trial=trial, trials=1))
        assert one.outcomes.steps[0] == run.outcomes["gate"].steps[trial]
    with pytest.raises(TaskliftError, match=f"the stage ends after {ends} trials"):
        curriculum.policy_at(1, "gate", ends + 1, initial=wrong)
    with pytest.raises(TaskliftError, match="no stage 'hall'; there are gate"):
        curriculum.policy_at(1, "hall", 0)


# -- trust ---------------------------------------------------------------------------------------------------


def test_trust_in_values_is_a_number_of_visits() -> None:
    learner = ValueLearning(step_size=0.01, step_power=1.0, epsilon=0.0)
    source = Policy(
        Gate.task.simplify(fix={"shut": 0}),
        np.array([[4.0, 8.0]] * 3),
        kind="value",
        carried={"visits": np.array([[500.0, 0.0]] * 3), "epsilon": 0.0},
    )
    stage = Stage("t", Gate.task, Gate(), learner, trials=1, trust=9)
    entered = stage.enter(source)
    assert entered.carried["visits"].tolist() == [[9, 0]] * 6
    # the next visit is the tenth, so it moves a trusted value by a tenth; what was never visited gives way at once
    assert pytest.approx(0.1) == 10**-1.0
    kept = replace(stage, trust=None).enter(source)
    assert kept.carried["visits"][0].tolist() == [500, 0]


def test_trust_in_weights_is_a_number_of_signals() -> None:
    task = Task("t", (Variable("x", (0, 1)),), (Variable("y", (0, 1, 2)),), (Signal(-0.25, {"y": 0}),))
    weights = np.array([[1.0, 2.0, 3.0], [0.0, 0.0, 0.0]])

    class Nothing:
        def __init__(self) -> None:
            self.task = task

        def run(self, *_, **__):  # pragma: no cover
            raise AssertionError

    entered = Stage("s", task, Nothing(), Reinforcement(), trials=1, trust=4).enter(Policy(task, weights))
    # the mean weight of a row is worth four signals of 0.25; chances stay as they are
    assert entered.weights.tolist() == [[0.5, 1.0, 1.5], [0.0, 0.0, 0.0]]


# -- caps and rollback ---------------------------------------------------------------------------------------


@PROPERTY
@given(
    cap=st.integers(1, 30), block=st.integers(1, 30), share=st.sampled_from([None, 0.2, 0.5]), seed=st.integers(0, 50)
)
def test_no_trial_begins_after_a_cap(cap: int, block: int, share: float | None, seed: int) -> None:
    model = random_model(seed)
    guard = None if share is None else Guard("return", share)
    learner = ValueLearning(epsilon=0.5)
    stage = Stage("risky", model.task, model, learner, trials=40, max_losses=cap, guard=guard)
    run = Curriculum([stage], block=block).run(seed)
    parts = [outcomes.losses for outcomes in run.outcomes.values()]
    largest = max(int(part.max()) for part in parts if len(part))
    if run.stopped:
        assert cap <= run.ledger.total < cap + largest
        assert any(entry.stopped for entry in run.ledger.entries)
    else:
        assert run.ledger.total < cap
        assert sum(entry.trials for entry in run.ledger.entries) == 40


def test_a_cap_over_all_stages_ends_the_run_and_one_of_a_stage_only_the_stage() -> None:
    learner = ValueLearning("sarsa", 0.5, epsilon=0.3)
    first = Stage("first", Gate.task, Gate(), learner, trials=500, max_losses=5)
    second = Stage("second", Gate.task, Gate(), learner, trials=30)
    run = Curriculum([first, second]).run(2)
    assert run.stopped == "first"
    assert [e.stopped for e in run.ledger.entries] == [True, False]
    assert run.ledger.entries[0].losses >= 5
    assert run.ledger.entries[1].trials == 30
    both = Curriculum([replace(first, max_losses=None), second], max_losses=5).run(2)
    assert [e.stage for e in both.ledger.entries] == ["first"]
    assert both.ledger.total >= 5


def test_a_rehearsal_loses_nothing_for_good() -> None:
    learner = ValueLearning("sarsa", 0.5, epsilon=0.3)
    drill = Stage("drill", Gate.task, Gate(), learner, trials=200, rehearsal=True)
    real = Stage("real", Gate.task, Gate(), learner, trials=30)
    run = Curriculum([drill, real], max_losses=50).run(2)
    first, second = run.ledger.entries
    assert (first.trials, first.losses) == (200, 0)
    assert first.would_be == run.outcomes["drill"].losses.sum() > 0
    assert run.ledger.total == second.losses == run.outcomes["real"].losses.sum()
    assert f"({first.would_be} would-be losses)" in str(run.ledger)


def test_the_rollback_policy_is_the_one_with_which_the_best_block_began() -> None:
    # learning that is punished for going: it gets worse and worse, so the best block is an early one
    spoilt = Corridor.task.simplify(signals=[Signal(-0.5, {"go": 1})], time_reward=0.0)
    start = Policy(spoilt, np.tile([0.5, 9.0], (6, 1)))
    stage = Stage("spoilt", spoilt, Corridor(hazard=False), Reinforcement(), trials=60)
    run = Curriculum([stage], block=10, best_by=("success", "steps")).run(0, initial=start)
    assert np.array_equal(run.best.weights, start.weights)
    assert not np.array_equal(run.policy.weights, start.weights)
    blocks = run.outcomes["spoilt"].steps.reshape(6, 10).mean(axis=1)
    assert blocks.argmin() == 0


def test_one_lucky_trial_is_no_best_block() -> None:
    # a budget of steps runs weights trial by trial, and a last block may be cut short; neither is a block to judge by
    stage = Stage("s", Gate.task, Gate(), Reinforcement(), steps=400)
    run = Curriculum([stage], block=10, best_by=["steps"]).run(3)
    steps = run.outcomes["s"].steps
    full = steps[: len(steps) // 10 * 10].reshape(-1, 10).mean(axis=1)
    before = 10 * int(full.argmin())
    assert steps.min() < full.min()
    assert 0 < before < len(steps)
    until = Curriculum([replace(stage, steps=None, trials=before)]).run(3)
    assert np.array_equal(run.best.weights, until.policy.weights)
    v = Curriculum([corridor_curriculum().stages[0]]).run(0)
    assert np.array_equal(v.best.weights, v.policy.weights)


def test_after_a_cap_the_next_stage_enters_with_the_rollback_policy() -> None:
    first = Stage("first", Gate.task, Gate(), Reinforcement(), trials=200, max_losses=4)
    second = Stage("second", Gate.task, Gate(False), Reinforcement(), trials=5)
    run = Curriculum([first, second], block=3).run(5)
    alone = Curriculum([first], block=3).run(5)
    assert alone.stopped == "first"
    # the first stage of two has another random key than a last one, so compare by key
    keyed = Curriculum([replace(first, key=2), second], block=3).run(5)
    assert keyed.policy.provenance["before"]["before"]["losses"] == alone.ledger.total
    assert run.stopped == "first"


# -- the guard -----------------------------------------------------------------------------------------------


def first_verdict(differences: np.ndarray, alpha: float = 0.05) -> str:
    test = SequentialTest(alpha)
    for difference in differences:
        if test.update(float(difference)) != "can't tell yet":
            break
    return test.verdict


@pytest.mark.parametrize("kind", ["signs", "bounded", "sticky", "rare"])
def test_false_alarms_are_as_rare_as_stated(kind: str) -> None:
    # looked at after each of 300 pairs; each side may be wrong in 5 % of streams, and 3 standard errors more
    rng = np.random.default_rng(11)
    streams, pairs = 500, 300
    if kind == "signs":
        data = rng.choice([-1.0, 1.0], (streams, pairs))
    elif kind == "bounded":
        data = rng.beta(0.5, 1.5, (streams, pairs)) - rng.beta(0.5, 1.5, (streams, pairs))
    elif kind == "sticky":
        # the size depends on the past, the mean given the past is zero all the same
        size = np.cumprod(rng.choice([0.97, 1.0], (streams, pairs)), axis=1)
        data = size * rng.choice([-1.0, 1.0], (streams, pairs))
    else:
        data = rng.choice([-1.0, 0.0, 1.0], (streams, pairs), p=[0.02, 0.96, 0.02])
    told = Counter(first_verdict(stream) for stream in data)
    allowed = streams * 0.05 + 3 * np.sqrt(streams * 0.05 * 0.95)
    assert told["helps"] <= allowed
    assert told["hurts"] <= allowed
    assert told["can't tell yet"] >= streams - 2 * allowed


def test_true_effects_are_found() -> None:
    rng = np.random.default_rng(12)
    for lean, expected in ((0.7, "helps"), (0.3, "hurts")):
        data = np.where(rng.random((300, 200)) < lean, 1.0, -1.0)
        assert Counter(first_verdict(stream) for stream in data)[expected] > 0.95 * 300


def test_the_order_of_evidence_is_symmetric() -> None:
    rng = np.random.default_rng(13)
    one, other = SequentialTest(), SequentialTest()
    for difference in rng.uniform(-1, 1, 50):
        one.update(difference)
        other.update(-difference)
    assert one.evidence == other.evidence[::-1]


class Raffle:
    """Two outputs, equally bad; each has its own luck in every trial."""

    task = Task("raffle", (Variable("x", (0,)),), (Variable("ticket", (0, 1)),))
    limit = 1

    def start(self, rng: np.random.Generator) -> int:
        self.unlucky = rng.random(2) < 0.3
        return 0

    def step(self, output: int) -> Step:
        lost = int(self.unlucky[output])
        return Step(0, -float(lost), True, lost, not lost)


def test_a_whole_guarded_stage_keeps_to_its_error_rates() -> None:
    # what is transferred prefers a ticket for no reason: neither helps nor hurts, though the trials differ
    settled = Policy(Raffle.task, np.array([[0.5, -0.5]]), kind="value")
    guard = Guard("losses", share=0.5, on_hurts="report")
    stage = Stage("raffle", Raffle.task, Raffle(), ValueLearning(epsilon=0.1), trials=160, guard=guard)
    runs, pairs, evidence = 150, [], []
    told: Counter = Counter()
    for seed in range(runs):
        report = Curriculum([stage]).run(seed, initial=settled).guards["raffle"]
        told[report.verdict] += 1
        pairs.append(report.pairs)
        evidence.append(report.evidence)
    assert min(pairs) >= 70
    allowed = runs * 0.05 + 3 * np.sqrt(runs * 0.05 * 0.95)
    assert told["helps"] <= allowed
    assert told["hurts"] <= allowed
    assert sum(max(e) > 2 for e in evidence) > 5  # there are differences, and they do add up now and then


def guarded(guard: Guard, trials: int):
    learner = ValueLearning("sarsa", 0.2, discount=1.0, epsilon=0.1)
    safe = Gate.task.simplify(fix={"shut": 0})
    stages = [
        Stage("open", safe, Gate(False), learner, trials=60),
        Stage("gate", Gate.task, Gate(), learner, trials=trials, guard=guard),
    ]
    return Curriculum(stages, block=5).run(0)


def test_the_guard_sees_harm_and_falls_back() -> None:
    # what is transferred is sure of the opposite of the truth: always stand, gate open or not
    wrong = Policy(Gate.task, np.array([[100.0, -100.0]] * 6), kind="value")
    learner = ValueLearning("sarsa", 0.02, discount=1.0, epsilon=0.1)
    stage = Stage("gate", Gate.task, Gate(), learner, trials=400, guard=Guard("return", 0.2))
    run = Curriculum([stage], block=5).run(1, initial=wrong)
    report = run.guards["gate"]
    assert report.verdict == "hurts"
    assert "fell back to the control" in str(report)
    entries = {e.learner: e for e in run.ledger.entries}
    assert entries["control"].trials > 0.2 * 400
    assert entries["control"].trials + entries["transferred"].trials == 400
    assert run.at_the_end("gate") is run.outcomes["gate (control)"]
    assert run.at_the_end("gate").success[-20:].mean() > 0.8


def test_on_harm_trust_may_decay_instead() -> None:
    wrong = Policy(Gate.task, np.array([[100.0, -100.0]] * 6), kind="value")
    learner = ValueLearning("sarsa", 0.02, discount=1.0, epsilon=0.1)
    guard = Guard("return", 0.3, on_hurts="decay")
    stage = Stage("gate", Gate.task, Gate(), learner, trials=300, guard=guard)
    run = Curriculum([stage], block=5).run(1, initial=wrong)
    actions = run.guards["gate"].actions
    assert actions
    assert all(action.startswith("moved half-way") for action in actions)
    assert run.policy.weights[:, 0].max() < 100 / 2 ** (len(actions) - 1)
    only_told = replace(stage, guard=replace(guard, on_hurts="report"))
    silent = Curriculum([only_told], block=5).run(1, initial=wrong).guards["gate"]
    assert (silent.verdict, silent.actions) == ("hurts", [])


def test_the_control_keeps_to_its_share_and_pairs_are_of_one_age() -> None:
    run = guarded(Guard("losses", 0.25), trials=200)
    control = next(e for e in run.ledger.entries if e.learner == "control")
    assert control.trials == pytest.approx(50, abs=5)
    assert run.guards["gate"].pairs == control.trials
    scratch = learn_values(
        Gate(), trials=control.trials, learning=ValueLearning("sarsa", 0.2, discount=1.0, epsilon=0.1)
    )
    assert np.array_equal(run.outcomes["gate (control)"].losses, scratch.outcomes.losses)


def test_windows_of_steps() -> None:
    steps = np.array([3, 4, 5, 10, 2])
    outcomes = StepOutcomes(steps, np.ones(5, bool), np.array([1, 2, 3, 4, 5]), 10, np.arange(5.0))
    # trials end after 3, 7, 12, 22 and 24 steps; two windows of 10 are full
    assert Guard("losses", window=10).scores(outcomes) == [-3.0, -3.0]
    assert Guard("return", window=8).scores(outcomes) == [1.0, 2.0, 7.0]
    assert Guard("losses").scores(outcomes) == [-1, -2, -3, -4, -5]


# -- the verdict over seeds ----------------------------------------------------------------------------------


def test_a_comparison_says_what_paid() -> None:
    comparison = compare(corridor_curriculum(), seeds=20, first=5, threshold=8)
    losses = comparison.finding("losses, all stages, equal total budget")
    assert losses.verdict == "helps"
    assert losses.curriculum < losses.direct
    assert comparison.finding("jumpstart (steps, first 5 trials)").verdict == "helps"
    assert comparison.ledger["open"] == 0
    assert comparison.until is not None
    assert comparison.until.curriculum.estimate < comparison.until.direct.estimate
    assert comparison.until.curriculum_reached == 1
    assert "median losses until 8 is reached" in str(comparison)
    assert "20 seeds" in str(comparison)
    assert comparison.to_json()["findings"][0]["verdict"] == "helps"
    assert comparison.policy.task == Corridor.task


@pytest.mark.parametrize("workers", [2, 5, None])
def test_a_comparison_is_the_same_on_any_number_of_processes(workers: int | None) -> None:
    told: list[tuple[int, int]] = []
    alone = compare(corridor_curriculum(), seeds=5, first=5, threshold=8, workers=1)
    many = compare(
        corridor_curriculum(), seeds=5, first=5, threshold=8, workers=workers,
        progress=lambda done, of: told.append((done, of)),
    )  # fmt: skip
    assert many.to_json() == alone.to_json()
    assert np.array_equal(many.policy.weights, alone.policy.weights)
    assert many.policy.provenance == alone.policy.provenance
    assert told == [(n, 5) for n in range(1, 6)]


def test_a_curriculum_without_transfer_is_no_help() -> None:
    # one stage only: both arms are the same learner, seed by seed
    model = random_model(8)
    comparison = compare(Curriculum([Stage("only", model.task, model, ValueLearning(), trials=30)]), seeds=8)
    assert {f.verdict for f in comparison.findings} == {"can't tell"}
    assert all(f.curriculum == f.direct for f in comparison.findings)


# -- mistakes ------------------------------------------------------------------------------------------------


class Trap:
    """A world that must not be run."""

    task = Corridor.task

    def run(self, *_, **__) -> Outcomes:
        raise AssertionError("trained before the mistake was found")


GOOD = Stage("gate", Corridor.task, Trap(), Reinforcement(), trials=5)
BY_VALUE = Stage("gate", Gate.task, Gate(), ValueLearning(), trials=5)


class Plain:
    """A learner with the two methods that every learner has."""

    start = GOOD.learner.start
    learn = GOOD.learner.learn


OTHER = Task("other", (Variable("place", (0, 1, 2)), Variable("shut", ("no", "yes"))), Corridor.task.outputs)


@pytest.mark.parametrize(
    ("stages", "options", "message"),
    [
        ([], {}, "has no stages"),
        ([GOOD, GOOD], {}, "same name"),
        ([replace(GOOD, trials=None)], {}, "stage 'gate': has no budget"),
        ([replace(GOOD, trials=0)], {}, "stage 'gate', trials: expected a whole number of at least 1"),
        ([replace(GOOD, max_losses=0)], {}, "stage 'gate', max_losses: expected a whole number of at least 1"),
        ([replace(GOOD, rehearsal=True, max_losses=5)], {}, "a rehearsal loses nothing"),
        ([GOOD], {"max_losses": 0}, "curriculum, max_losses: expected a whole number of at least 1"),
        ([GOOD], {"best_by": ["luck"]}, "best_by: expected losses"),
        ([replace(GOOD, learner=Sweep())], {}, "stage 'gate': a sweep has its own budget"),
        ([replace(BY_VALUE, trials=None)], {}, "stage 'gate': has no budget"),
        ([replace(GOOD, learner=Sweep(), trials=None, guard=Guard())], {}, "a guard needs a share of a budget"),
        ([replace(GOOD, guard=Guard("losses"))], {"block": None}, "a guard takes turns by blocks"),
        ([replace(GOOD, trials=None, steps=9, learner=Reinforcement(time_signal="baseline"))], {}, "baseline"),
        ([replace(GOOD, learner=ValueLearning())], {}, "whole trials only"),
        ([replace(GOOD, prior=[swap("go", when={"shut": 3})])], {}, "'shut' has no value 3"),
        ([replace(GOOD, prior=[swap("come")])], {}, "no variable 'come'"),
        ([replace(GOOD, task=OTHER)], {}, "neither equal to nor a simplification of 'corridor': input 'shut'"),
        (
            [replace(GOOD, name="a", task=OTHER, world=type("W", (Trap,), {"task": OTHER})()), GOOD],
            {},
            "stage 'a' cannot lead to 'gate'.*input 'shut' has the values",
        ),
        ([GOOD, replace(GOOD, name="b", task=simple_task())], {}, "input 'shut' of 'corridor' is not in"),
        ([replace(BY_VALUE, name="a"), replace(GOOD, task=Gate.task, world=Gate())], {}, "one learns values"),
        ([replace(BY_VALUE, trust=5)], {}, "give the learner a step_power"),
        ([replace(GOOD, learner=Plain(), trust=2)], {}, "trust: a Plain cannot weigh what was copied"),
        ([replace(GOOD, trust=-1)], {}, "trust: expected a number above 0"),
        ([replace(GOOD, trust=2, task=Corridor.task.simplify(signals=(), time_reward=0))], {}, "no signal to measure"),
    ],
)
def test_mistakes_are_named_before_anything_is_trained(stages: list, options: dict, message: str) -> None:
    with pytest.raises(TaskliftError, match=message):
        Curriculum(stages, **options).run()


@pytest.mark.parametrize(
    ("make", "message"),
    [
        (lambda: Guard("luck"), "measure: expected one of losses"),
        (lambda: Guard(on_hurts="cry"), "on_hurts: expected one of fall back"),
        (lambda: Guard(share=0), "share: expected more than 0"),
        (lambda: Guard(share=0.7), "share: expected more than 0 and at most 0.5"),
        (lambda: Guard(alpha=1), "alpha: an error rate"),
        (lambda: Guard(bound=0), "bound: expected a number above 0"),
        (lambda: Guard(window=0), "window: expected a whole number"),
        (lambda: Guard("steps", window=5), "windows have equally many steps"),
        (lambda: SequentialTest().update(2), "from -1 to 1"),
        (lambda: compare(corridor_curriculum(), seeds=1), "seeds: expected a whole number of at least 2"),
        (lambda: compare(corridor_curriculum(), seeds=2, workers=0), "workers: expected a whole number of at least 1"),
        (lambda: compare(Curriculum(corridor_curriculum().stages[:1]), seeds=2), "stage has its learner's budget"),
        (lambda: compare(corridor_curriculum(), seeds=2, performance="return"), "no returns"),
    ],
)
def test_other_mistakes_are_named(make, message: str) -> None:
    with pytest.raises(TaskliftError, match=message):
        make()
