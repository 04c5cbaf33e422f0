"""Training on one's own building: what is handed over, or why nothing is."""

from __future__ import annotations

import numpy as np
import pytest

from tasklift.building import Mission, generate
from tasklift.errors import TaskliftError
from tasklift.learning.chances import CHOICE_STAGE
from tasklift.learning.reinforcement import Reinforcement
from tasklift.studies.arms import ARMS, EXPERTS, expert
from tasklift.studies.readiness import advice, diagnose, end_of, larger
from tasklift.studies.train import Candidate, _handed_over, chosen, frontier, train
from tasklift.tasks.policy import Policy

HOUSE = generate(9, 11, 3, 6, seed=5)


def candidate(solved: float, lost: float, steps: float, seed: int = 0) -> Candidate:
    return Candidate(ARMS["search"], seed, Policy.equal(Mission(HOUSE, "2+2").task), solved, lost, steps)


def test_solved_counts_first_then_losses_then_steps() -> None:
    safe_and_idle = candidate(0.04, 0.0, 593)
    rash = candidate(0.97, 0.9, 150)
    slow = candidate(0.975, 0.0, 300)
    fast = candidate(0.97, 0.005, 250)
    assert chosen([safe_and_idle, rash, slow, fast]) is fast
    assert chosen([safe_and_idle, rash]) is rash


def test_no_point_of_the_frontier_is_beaten_in_both() -> None:
    rng = np.random.default_rng(0)
    found = [candidate(*rng.uniform([0.9, 0, 100], [1, 2, 500]), seed=k) for k in range(200)]
    points = frontier(found, 0.95)
    assert points
    for point in points:
        assert point.solved >= 0.95
        assert not any(c.steps < point.steps and c.lost < point.lost and c.solved >= 0.95 for c in found)
    assert [p.steps for p in points] == sorted(p.steps for p in points)


def test_hands_over_a_policy_with_its_certificate(tmp_path) -> None:
    HOUSE.save(tmp_path / "house.json")
    options = {"building": tmp_path / "house.json", "team": "6+6", "seeds": 1, "trials": 5, "practice": 8000}
    lines, page = train(**options, arms=("search", "direct"), out=tmp_path / "run")
    assert lines[0].startswith("ready: policy.json solves ")
    assert "from 8,000 safe and 0 dangerous episodes" in lines[0]
    assert any(line.startswith("direct: its best policy solves") for line in lines)
    assert page.exists()
    for name in ("policy.json", "certificate.json", "policies/search.json", "policies/frontier-1.json"):
        assert (tmp_path / "run" / name).exists()
    again, _ = train(**options, arms=("search", "direct"), out=tmp_path / "run")
    assert again == lines


def test_says_that_none_is_ready_and_a_team_that_would_do(tmp_path) -> None:
    place = generate(9, 11, 3, 12, doors=8, seed=5)
    place.save(tmp_path / "house.json")
    options = {"building": tmp_path / "house.json", "seeds": 1, "trials": 5, "arms": ("expert", "direct")}
    lines, _ = train(**options, team="4+3", out=tmp_path / "run")
    assert lines[0].startswith("none is ready: ")
    assert "weapon robots wait one by one at different doors" in lines[1]
    assert lines[2].startswith("what would do: --team 4+")
    assert not (tmp_path / "run" / "policy.json").exists()
    team = lines[2].split()[4].rstrip(";")
    lines, _ = train(**options, team=team, out=tmp_path / "better")
    assert lines[0].startswith("ready: ")


def test_the_certificate_has_the_last_word(tmp_path) -> None:
    HOUSE.save(tmp_path / "building.json")
    still = Policy(task := Mission(HOUSE, "4+3").task, task.where({"MV": 0}).astype(float))
    lucky = Candidate(ARMS["search"], 0, still, 1.0, 0.0, 100.0)
    best, made = _handed_over(lucky, 0.95, tmp_path, {"team": "4+3"})
    assert made is None
    assert (best.solved, best.lost, best.steps) == (0.0, 0.0, 600.0)


def test_waiting_one_by_one_is_recognised_in_a_trace() -> None:
    mission = Mission(generate(9, 11, 3, 12, doors=8, seed=5), "4+3").with_reading(relocate=True)
    policy = expert(mission)
    failed = np.flatnonzero(~mission.evaluate(policy, 200, stage=CHOICE_STAGE).success[0])
    trace = mission.simulator.trace(policy, trial=int(failed[0]), stage=CHOICE_STAGE, learn=False,
                                    reinforcement=Reinforcement())  # fmt: skip
    end = end_of(trace)
    assert (end.waiting, end.places, end.armed) == (3, 3, 3)
    assert 0 < end.explored < 1
    assert "one by one" in diagnose(mission, policy)[0]
    still = Policy(mission.task, mission.task.where({"MV": 0}).astype(float))
    assert "ran out of their 600 steps" in diagnose(mission, still)[0]
    rash = Policy(mission.task, mission.task.where({"MV": 1, "CA": 0.0}).astype(float))
    assert "fewer than 2 weapon robots were left" in diagnose(mission, rash)[0]


def test_larger_teams_grow_until_not_all_can_wait_alone() -> None:
    mission = Mission(generate(9, 11, 3, 12, doors=8, seed=5), "4+3")
    tries = list(larger(mission))
    assert max(m.n_robots for m in tries) - 4 >= 2 * 9
    assert all(m.n_robots > 7 or m.limit > 600 for m in tries)
    hurried = Mission(mission.building, "4+3", limit=20)
    assert "no policy can: the building needs at least" in advice(hurried, 0.95)[0]


@pytest.mark.parametrize("preset", ["scattered", "cohesive"])
def test_the_expert_waits_where_a_hostile_may_hide(preset: str) -> None:
    bends = generate(9, 11, 3, 6, doors=0, seed=5)
    for place in (HOUSE, bends):
        mission = Mission(place, "4+5")
        hides = {int(place.feature_class[node]) for node in mission.drill().hostiles}
        for member in EXPERTS:
            policy = expert(mission, member)
            for row in range(90):
                seen = mission.task.input_values(row)
                moves = policy.weights[row].reshape(2, -1)[1].sum()
                if seen["FTR"] in hides and seen["nWPN"] < 2:
                    assert moves == 0
                else:
                    assert moves == (1 - member[1] if (seen["FTR"], seen["nWPN"]) == (1, 2) else 1)


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"ready": 0.0}, "ready: expected a number above 0 up to 1"),
        ({"ready": 1.5}, "ready"),
        ({"practice": 10}, "a generation of 100 candidates"),
        ({"practice": 0}, "practice"),
        ({"arms": ("random",)}, "none of those named learns"),
        ({"team": "4+1"}, "no team could ever succeed"),
        ({"hostiles": 40}, "asked for 40"),
        ({"preset": "tidy"}, "expected one of scattered, cohesive"),
    ],
)
def test_mistakes_are_named_before_anything_is_trained(tmp_path, options, message) -> None:
    HOUSE.save(tmp_path / "house.json")
    with pytest.raises(TaskliftError, match=message):
        train(building=tmp_path / "house.json", out=tmp_path / "run", **options)
    assert not (tmp_path / "run").exists()
