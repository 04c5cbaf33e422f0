"""Certificates: exact bounds, fresh episodes, files that can be recomputed."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.stats import binom

from tasklift.building import Mission, generate
from tasklift.errors import TaskliftError
from tasklift.lab import FILE_NAME, Store, run
from tasklift.studies.certify import (
    Bounds,
    Counts,
    Ground,
    Sizes,
    certify,
    learning_costs,
    quantile_bound,
    runs_needed,
    share_bounds,
    verify,
)
from tasklift.studies.study import Condition, Record, Study
from tasklift.tasks.policy import Policy

PLACE = generate(9, 11, 3, 6, seed=5)
TASK = Mission(PLACE, "4+5").task


def careful(stop: float) -> Policy:
    """Stop at doors until two weapon robots are there, with this probability; else move."""
    weights = TASK.where({"MV": 1, "WPN": 0, "CA": 0.0}).astype(float)
    unsafe = TASK.input_mask({"FTR": 4, "nWPN": (0, 1)})
    weights[unsafe] *= 1 - stop
    weights[unsafe] += stop * TASK.where({"MV": 0, "WPN": 0, "CA": 0.0})[unsafe]
    return Policy(TASK, weights)


@settings(deadline=None)
@given(st.integers(1, 2000), st.floats(0, 1), st.floats(0.5, 0.9999))
def test_bounds_are_where_the_binomial_says(trials: int, share: float, level: float) -> None:
    successes = round(share * trials)
    lower, upper = share_bounds(successes, trials, level)
    assert 0 <= lower <= successes / trials <= upper <= 1
    if successes:
        assert binom.sf(successes - 1, trials, lower) == pytest.approx(1 - level, rel=1e-6)
    if successes < trials:
        assert binom.cdf(successes, trials, upper) == pytest.approx(1 - level, rel=1e-6)


def test_published_bounds() -> None:
    # Clopper & Pearson 1934, figure for 95 % two-sided (each side 97.5 %): 10 of 20 -> 0.272, 0.728
    assert share_bounds(10, 20, 0.975) == pytest.approx((0.27196, 0.72804), abs=1e-5)
    # Hanley & Lippman-Hand 1983, "if nothing goes wrong": the rule of three
    assert share_bounds(0, 1000, 0.95)[1] == pytest.approx(3 / 1000, rel=0.01)


def test_a_thousand_certificates_are_wrong_in_at_most_five_percent() -> None:
    """Counts drawn as episodes are: the bounds hold together as often as they say, for many true shares."""
    rng = np.random.default_rng(0)
    for solved, loss in ((0.98, 0.001), (0.9, 0.02), (0.5, 0.3), (0.999, 0.0), (0.6, 0.4)):
        # an episode is solved without a loss, unsolved without, or unsolved with one
        draws = rng.multinomial(400, [solved, 1 - solved - loss, loss], size=1000)
        found = [Bounds.of(Counts(400, int(a), int(c), int(c), 0), 9, 0.95) for a, _, c in draws]
        wrong = [b.solved_at_least > solved or b.loss_at_most < loss for b in found]
        assert np.mean(wrong) <= 0.05


@pytest.mark.slow
def test_a_thousand_certificates_in_the_building_are_wrong_in_at_most_five_percent() -> None:
    policy, ground = careful(0.8), Ground(PLACE, "4+5")
    truth = ground.play(policy, 200_000, seed=10**6)
    wrong = 0
    for seed in range(1000):
        found = Bounds.of(ground.play(policy, 200, seed), 9, 0.95)
        wrong += found.solved_at_least > truth.solved / truth.episodes
        wrong += found.loss_at_most < truth.with_losses / truth.episodes
        wrong += found.lost_per_100_at_most < 100 * truth.lost / truth.episodes
    print(f"{wrong} of 1,000 certificates wrong")
    assert wrong <= 50


@pytest.mark.parametrize("scale", [1.0, 100.0])
def test_the_bound_on_what_learning_costs_holds_for_any_distribution(scale: float) -> None:
    rng = np.random.default_rng(1)
    n = runs_needed(0.9, 0.95)
    assert n == 29
    for draw in (rng.exponential, lambda size: rng.integers(0, 3, size), lambda size: rng.standard_cauchy(size) ** 2):
        samples = scale * np.asarray(draw(size=(1000, n)), float)
        quantile = np.quantile(scale * np.asarray(draw(size=200_000), float), 0.9, method="inverted_cdf")
        bounds = np.array([quantile_bound(row, 0.9, 0.95) for row in samples])
        assert np.mean(bounds < quantile) <= 0.05
    assert quantile_bound(np.zeros(n - 1), 0.9, 0.95) is None


def test_counts_depend_on_nothing_but_policy_ground_and_seed() -> None:
    ground = Ground(PLACE, "4+5", (1, 2))
    one, same = ground.play(careful(0.8), 300, 0), ground.play(careful(0.8), 300, 0)
    assert one == same
    assert 0 < one.with_losses < 300
    assert ground.play(careful(0.8), 300, 1) != one
    # another policy meets other episodes, so none can be chosen on them
    scaled = careful(0.8)
    assert ground.play(replace(scaled, weights=2 * scaled.weights), 300, 0) != one


def test_a_policy_that_never_risks_anything_is_certified_so_and_one_that_does_is_not() -> None:
    ground = Ground(PLACE, "4+5")
    safe = Bounds.of(ground.play(careful(1.0), 2000, 0), 9, 0.99)
    rash = Bounds.of(ground.play(careful(0.0), 2000, 0), 9, 0.99)
    assert safe.loss_at_most < 0.003
    assert safe.solved_at_least > 0.9
    assert rash.loss_at_most > 0.2


def test_unseen_buildings_are_fresh_each_time() -> None:
    ground = Ground(Sizes(6, 7, 2), "3+4", (1, 2))
    counts = ground.play(careful(1.0), 20, 0)
    assert counts == ground.play(careful(1.0), 20, 0)
    assert counts.episodes == 20
    assert ground.unit == "episodes on fresh buildings"
    assert ground.mission(1, 3).building != ground.mission(1, 4).building


def test_a_simpler_policy_is_extended() -> None:
    simple = TASK.simplify(remove=["DL", "GL"])
    policy = Policy.equal(simple)
    ground = Ground(PLACE, "4+5")
    assert ground.play(policy, 50, 0) == ground.play(policy.extend(TASK), 50, 0)


@pytest.fixture
def files(tmp_path: Path) -> Path:
    PLACE.save(tmp_path / "building.json")
    careful(1.0).save(tmp_path / "policy.json")
    return tmp_path


def test_a_certificate_is_recomputed(files: Path) -> None:
    made = certify(files / "policy.json", team="4+5", hostiles=(1, 2), episodes=400)
    says, path = made.says, made.path
    assert says.startswith("99 % sure: at most 1 in ")
    assert path == files / "policy-certificate.json"
    assert path.stat().st_size < 2500
    assert verify(path) == says
    moved = files / "else" / "where"
    moved.mkdir(parents=True)
    for name in ("policy.json", "building.json", path.name):
        (files / name).rename(moved / name)
    assert verify(moved / path.name) == says


def test_a_certificate_on_unseen_buildings_is_recomputed(files: Path) -> None:
    path = certify(files / "policy.json", buildings="6-7-2", team="3+4", episodes=10, confidence=0.9).path
    assert verify(path)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (lambda d: d["counts"].update(solved=400), "does not hold: its counts"),
        (lambda d: d["bounds"].update(loss_at_most=0.0), "does not hold: its bounds"),
        (lambda d: d.update(says="all is well"), "does not hold: its says"),
        (lambda d: d["policy"].update(sha256="0"), "is not the file"),
        (lambda d: d["place"].update(file="nowhere.json"), "cannot be read"),
        (lambda d: d.update(place={"rooms": 3}), "is not as a certificate has it"),
        (lambda d: d["ground"].pop("mission"), "is not as a certificate has it"),
        (lambda d: d["ground"]["mission"].update(team=[[1]]), "mission: team: expected an object with fields"),
        (lambda d: d.update(confidence=1.5), "above 0 and below 1"),
        (lambda d: d.update(episodes=0), "whole number from 1"),
    ],
)
def test_a_certificate_that_was_changed_does_not_hold(files: Path, change, message: str) -> None:
    path = certify(files / "policy.json", team="4+5", episodes=200).path
    document = json.loads(path.read_text())
    change(document)
    path.write_text(json.dumps(document))
    with pytest.raises(TaskliftError, match=message):
        verify(path)


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"confidence": 1.0}, "confidence: expected a number above 0 and below 1"),
        ({"confidence": 0.0}, "confidence"),
        ({"confidence": float("nan")}, "confidence"),
        ({"episodes": 0}, "episodes: expected a whole number"),
        ({"hostiles": (9,)}, "asked for 9"),
        ({"team": "4+1"}, "no team could ever succeed"),
        ({"buildings": "21-25"}, "expected INTERSECTIONS-CORRIDORS-ROOMS"),
        ({"buildings": "6-7-2", "building": Path("b.json")}, "give one of them"),
        ({"preset": "tidy"}, "expected one of scattered, cohesive"),
        ({"building": Path("nowhere.json")}, "cannot be read"),
        ({"out": Path("c.txt")}, "ends in .json"),
        ({"seed": -1}, "seed"),
    ],
)
def test_says_what_is_wrong_and_writes_nothing(files: Path, options, message: str) -> None:
    before = sorted(files.iterdir())
    with pytest.raises(TaskliftError, match=message):
        certify(files / "policy.json", **{"team": "4+5", "episodes": 20, **options})
    assert sorted(files.iterdir()) == before


def test_a_policy_of_another_task_and_a_certificate_that_is_there_are_refused(files: Path) -> None:
    other = Policy.equal(TASK.simplify(fix={"DL": 0, "GL": 0}).parent.simplify(remove=["DL"], name="other"))
    strange = replace(other, task=replace(other.task, parent=None, removed=()))
    strange.save(files / "strange.json")
    with pytest.raises(TaskliftError, match="neither equal to nor a simplification"):
        certify(files / "strange.json", team="4+5", episodes=20)
    certify(files / "policy.json", team="4+5", episodes=20)
    with pytest.raises(TaskliftError, match="is there already"):
        certify(files / "policy.json", team="4+5", episodes=20)


def test_what_learning_costs_is_bounded_where_there_are_runs_enough(tmp_path: Path) -> None:
    study = Study.every({"house": PLACE}, {"scattered": Condition()}, ("direct", "expert"), seeds=60, trials=3,
                        team="4+5", record=Record(policy=False))  # fmt: skip
    with Store.open(tmp_path / FILE_NAME, study.spec("a test")) as store:
        run(store, [cell for cell in study.cells() if int(cell["seed"]) < 58 or cell["arm"] == "direct"], study.work)
        lost = sorted(int(result.stages["target"]["losses"].sum()) for _, result in store.select(arm="direct"))
    (line,) = learning_costs(tmp_path)
    assert line.startswith(f"reading scattered, map house, arm direct: 95 % of runs lose at most {lost[-1]} robots")
    (line,) = learning_costs(tmp_path, share=0.99)
    assert line.endswith("60 runs bound nothing, 299 are needed")
    with pytest.raises(TaskliftError):
        learning_costs(tmp_path / "nowhere")
