"""The lower bound on steps: no episode is faster, and where nothing can go wrong one is as fast."""

from __future__ import annotations

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from tasklift.building import Building, Mission, generate
from tasklift.building.least import least_steps
from tasklift.tasks.policy import Policy


def moving(mission: Mission) -> Policy:
    return Policy(mission.task, mission.task.where({"MV": 1, "WPN": 0}).astype(float))


@settings(deadline=None, max_examples=15)
@given(st.integers(0, 200), st.integers(0, 12), st.integers(1, 4), st.sampled_from(["robots", "team"]))
def test_no_episode_is_faster(seed: int, scouts: int, weapons: int, split: str) -> None:
    team = {"scout": scouts, "weapon": weapons}
    mission = Mission(generate(5, 5, 2, 5, seed=seed), team, 0).with_reading(split=split)
    assert mission.evaluate(moving(mission), 40, seed).steps.min() >= least_steps(mission)


def row_of(*lengths_m: float, areas_m2: tuple[float, float]) -> Building:
    """Two rooms with bends between them, in a row."""
    n = len(lengths_m) + 1
    at = [sum(lengths_m[:i]) for i in range(n)]
    return Building(
        "row",
        kind=[0, *[2] * (n - 2), 0],
        feature_class=[1 if i in (0, n - 1) else 2 for i in range(n)],
        position_m=[(x, 0.0) for x in at],
        area_m2=[areas_m2[0], *[0.0] * (n - 2), areas_m2[1]],
        obstacles=[0] * n,
        edges=[(i, i + 1) for i in range(n - 1)],
        length_m=list(lengths_m),
        width_m=[2.0] * (n - 1),
        start=0,
    )


@pytest.mark.parametrize(
    ("team", "building", "steps"),
    [
        # 3 steps of search at the start, 7 for 10 m at 1.5 m a step, 5 to search 20 m2: arrival counts as the first
        ({"scout": 2}, row_of(10.0, areas_m2=(12.0, 20.0)), 3 + 7 + 4),
        ({"weapon": 1}, row_of(10.0, areas_m2=(12.0, 20.0)), 3 + 10 + 4),
        ({"scout": 1, "weapon": 1}, row_of(4.0, 4.0, 4.0, areas_m2=(4.0, 4.0)), 1 + 3 * 3),
    ],
)
def test_in_a_row_the_bound_is_met(team: dict[str, int], building: Building, steps: int) -> None:
    mission = Mission(building, team, 0)
    assert least_steps(mission) == steps
    assert mission.evaluate(moving(mission), 1, 0).steps.tolist() == [[steps]]
