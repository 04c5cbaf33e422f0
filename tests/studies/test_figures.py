"""The figures show what was computed; GolC as drawn is GolC as drawn from."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from mpl_toolkits.mplot3d import proj3d
from numba import njit
from scipy.stats import chisquare

from tasklift.building import kernel
from tasklift.building.generate import generate
from tasklift.building.mission import Mission
from tasklift.building.reading import Reading
from tasklift.building.team import SCOUT, WEAPON
from tasklift.building.ways import goal_shares
from tasklift.errors import TaskliftError
from tasklift.lab import FILE_NAME, Store, run
from tasklift.learning.reinforcement import Reinforcement
from tasklift.report.pictures import save
from tasklift.stats import mean_band
from tasklift.studies.paper import figures, survey
from tasklift.studies.report import WEAPONS
from tasklift.studies.samples import CA, Sample
from tasklift.studies.study import Condition, Study

CHANCE = 1e-4  # p-threshold of the chi-square tests; seeds are fixed


@njit
def draw_many(world, rules, learner, lane, n_open, counts):
    first = world.nodes[lane.robots[0].node].first
    for _ in range(20_000):
        counts[kernel.draw_edge(world, rules, learner, lane, 0, n_open) - first] += 1


def drawn_shares(building, node, goal, ca, sharpness, closed=()):
    """How often the simulator's robot takes each way of a node; ways in ``closed`` are not open to it."""
    mission = Mission(building, {SCOUT: 1, WEAPON: 2}, reading=Reading(goal_sharpness=sharpness))
    simulator, task = mission.simulator, mission.task
    lane = simulator.lane(task.shape)
    simulator.begin_trial(lane, seed=3, stage=2, trial=0)
    robot = lane.robots[0]
    robot["node"], robot["goal"] = node, goal
    robot["out"] = task.output_index({"MV": 1, "WPN": 0, "CA": ca})
    degree = int(building.degree[node])
    ways = [way for way in range(degree) if way not in closed]
    lane.open[: len(ways)] = building.indptr[node] + np.array(ways)
    counts = np.zeros(degree, np.int64)
    draw_many(
        simulator.world,
        simulator.rules,
        simulator.learner(task, Reinforcement()),
        lane,
        len(ways),
        counts,
    )
    return counts


@pytest.mark.parametrize("sharpness", [0.0, 1.0, 2.0])
@pytest.mark.parametrize("ca", [0.0, 0.5, 1.0])
def test_robots_draw_their_way_by_the_shares_shown(ca, sharpness):
    building = generate(seed=5)
    node = int(building.degree.argmax())
    goal = int(np.hypot(*(building.position_m - building.position_m[node]).T).argmax())
    covered = building.coverage[building.indptr[node] : building.indptr[node + 1]]
    expected = ca * covered + (1 - ca) * goal_shares(building, node, goal, sharpness)
    counts = drawn_shares(building, node, goal, ca, sharpness)
    assert chisquare(counts, expected * counts.sum()).pvalue > CHANCE


def test_shares_among_the_open_ways_are_those_shown_renormalised():
    building = generate(seed=5)
    node = int(building.degree.argmax())
    goal = int(building.neighbour[building.indptr[node] + 1])  # sharp: the goal is next door
    expected = goal_shares(building, node, goal)
    expected[0] = 0
    expected /= expected.sum()
    counts = drawn_shares(building, node, goal, 0.0, 1.0, closed=(0,))
    assert counts[0] == 0
    assert chisquare(counts[1:], expected[1:] * counts.sum()).pvalue > CHANCE


@settings(max_examples=60, deadline=None, derandomize=True)
@given(st.integers(0, 5), st.integers(0, 10**6), st.integers(0, 10**6), st.floats(0, 400))
def test_goal_shares_sum_to_one_and_favour_the_near(seed, node, goal, sharpness):
    building = generate(seed=seed)
    node, goal = node % building.n_nodes, goal % building.n_nodes
    shares = goal_shares(building, node, goal, sharpness)
    assert shares.sum() == pytest.approx(1)
    ways = building.neighbour[building.indptr[node] : building.indptr[node + 1]]
    if node == goal:
        assert np.ptp(shares) == 0
    else:
        distance = np.hypot(*(building.position_m[ways] - building.position_m[goal]).T)
        assert (np.diff(shares[distance.argsort()]) <= 1e-12).all()


# --- figures ----------------------------------------------------------------------------------------------------


@pytest.fixture(scope="module")
def samples(tmp_path_factory):
    arms = ("direct", "copy", "expert")
    study = Study.every(
        {"one": generate(seed=1), "two": generate(seed=2)}, {"scattered": Condition()}, arms, seeds=2, trials=8,
        repeats=1, team="3+3",
    )  # fmt: skip
    with Store.open(tmp_path_factory.mktemp("study") / FILE_NAME, study.spec("figures")) as store:
        run(store, study.cells(), study.work, workers=1)
        return {arm: Sample.of(store, arm, reading="scattered") for arm in arms}


def texts(ax):
    return [text.get_text() for text in ax.texts]


def test_a_saved_figure_is_the_same_every_time(tmp_path):
    contents = []
    for attempt in ("first", "second"):
        folder = tmp_path / attempt
        folder.mkdir()
        paths = save(figures.figure1(generate(seed=4)), folder, "figure1")
        assert [path.name for path in paths] == ["figure1.png", "figure1.svg"]
        contents.append([path.read_bytes() for path in paths])
    assert contents[0] == contents[1]
    assert contents[0][0].startswith(b"\x89PNG")
    assert b"<svg" in contents[0][1]
    assert b"dc:date" not in contents[0][1]


def test_figure2_shows_the_shares_of_the_code_that_computes_them():
    building = generate(seed=5)
    node = int(building.degree.argmax())
    goal = (node + 7) % building.n_nodes
    left, right = figures.figure2(building, node, goal, 2.0).axes
    covered = building.coverage[building.indptr[node] : building.indptr[node + 1]]
    near = goal_shares(building, node, goal, 2.0)
    assert [t for t in texts(left) if t] == [f"{share:.2f}" for share in covered]
    assert [t for t in texts(right) if t and t != "goal"] == [f"{share:.2f}" for share in near]
    with pytest.raises(TaskliftError, match="figure2, goal: expected 0 to"):
        figures.figure2(building, node, building.n_nodes)


def test_figure3_shows_the_odd_seeds_of_the_two_maps(tmp_path):
    plan = survey.study(2, seeds=12, shown=6, repeats=1)
    with Store.open(tmp_path / FILE_NAME, plan.spec("survey")) as store:
        run(store, plan.cells(), plan.work, workers=1)
        found = survey.read(store, plan)["scattered"]
    _, _, below_a, below_b = figures.figure3(found).axes
    for name, ax in zip(found.shown(), (below_a, below_b), strict=True):
        of = found.maps[name]
        points = ax.lines[0].get_xydata()
        np.testing.assert_allclose(points[:, 0], CA)
        np.testing.assert_allclose(points[:, 1], of.weights[of.seeds % 2 == 1].mean(axis=0))
        low_high = np.concatenate([path.vertices for path in ax.collections[0].get_paths()])[:, 1]
        assert low_high.min() <= points[:, 1].min()
        assert low_high.max() >= points[:, 1].max()
        assert f"{found.slope_interval(name).estimate:+.3f}".replace("-", "−") in ax.get_title(loc="left")


def test_figure4_shows_means_over_runs_and_one_run_as_it_was(samples):
    figure = figures.figure4(samples, run=("two", 1))
    for column, name in enumerate(("steps", "robots_left", "teams_left")):
        above, below = figure.axes[column], figure.axes[3 + column]
        lines = {line.get_label(): line.get_ydata() for line in above.lines}
        assert list(lines) == ["direct", "copy", "expert"]
        for arm in ("direct", "copy"):
            band = mean_band(getattr(samples[arm], name), strata=samples[arm].maps)
            np.testing.assert_allclose(lines[arm], band.estimate)
        np.testing.assert_allclose(lines["expert"], np.full(8, getattr(samples["expert"], name).mean()))
        for line, arm in zip(below.lines, ("direct", "copy"), strict=True):
            row = (samples[arm].maps == "two") & (samples[arm].seeds == 1)
            np.testing.assert_array_equal(line.get_ydata(), getattr(samples[arm], name)[row][0])
    with pytest.raises(TaskliftError, match="no run of map 'three'"):
        figures.figure4(samples, run=("three", 0))


def test_figure5_has_a_bar_for_every_weight(samples):
    weights = samples["copy"].move_weights.mean(axis=0)
    figure = figures.figure5(weights)
    figure.draw_without_rendering()
    assert [ax.get_title() for ax in figure.axes] == list(WEAPONS)
    for n, ax in enumerate(figure.axes):
        drawn = np.concatenate([path.vertices for bars in ax.collections for path in bars.get_paths()])
        for feature in range(5):
            for move in (0, 1):
                corner = feature + 1 - 0.32, move - 0.22, weights[n, feature, move]
                x, y, _ = proj3d.proj_transform(*corner, ax.get_proj())
                assert np.hypot(*(drawn - (x, y)).T).min() < 1e-9, (n, feature, move)
    with pytest.raises(TaskliftError, match=r"expected weights of shape \(3, 5, 2\), found \(5, 2\)"):
        figures.figure5(weights[0])
