"""V's coverage coefficient over maps: what is learned, what is chosen, what explains it."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from tasklift.building.generate import generate
from tasklift.building.graph import FEATURE, INTERSECTION, ROOM, Building
from tasklift.building.team import SCOUT, WEAPON
from tasklift.errors import TaskliftError
from tasklift.studies.paper.survey import CA, PROPERTIES, Survey, correlate, map_properties, survey


@pytest.fixture(scope="module")
def maps():
    return [generate(seed=2000 + i) for i in range(4)]


@pytest.fixture(scope="module")
def found(maps):
    return survey(maps, seeds=4, repeats=2, team={SCOUT: 4, WEAPON: 2}, shown=4)


def with_slopes(survey_, slopes):
    """The same survey, had V taught straight lines with these slopes: (maps,) or (maps, seeds)."""
    changed = []
    for of, slope in zip(survey_.maps, slopes, strict=True):
        weights = 2.0 + np.broadcast_to(slope, of.seeds.shape)[:, None] * CA
        changed.append(replace(of, weights=weights))
    return replace(survey_, maps=tuple(changed))


def test_the_two_chosen_maps_get_further_odd_seeds(found):
    chosen = set(found.choose())
    for place, of in enumerate(found.maps):
        assert of.seeds.tolist() == ([0, 1, 2, 3, 5, 7] if place in chosen else [0, 1, 2, 3])
        assert of.weights.shape == of.steps.shape == (len(of.seeds), 11)


def test_weights_follow_from_the_time_of_the_trials(found):
    # every trial of V adds 0.2 (1 - steps / limit); the margin of C2 rests on this
    for of in found.maps:
        np.testing.assert_allclose(of.weights, 1.5 + 2 * 0.2 * (1 - of.steps / found.limit), rtol=0, atol=1e-9)


def test_workers_change_nothing(maps, found):
    done = []
    again = survey(
        maps, seeds=4, repeats=2, team={SCOUT: 4, WEAPON: 2}, shown=4, workers=1,
        progress=lambda n, total: done.append((n, total)),
    )  # fmt: skip
    assert done == [(1, 4), (2, 4), (3, 4), (4, 4)]
    for one, two in zip(found.maps, again.maps, strict=True):
        np.testing.assert_array_equal(one.seeds, two.seeds)
        np.testing.assert_array_equal(one.weights, two.weights)


def test_odd_seeds_do_not_choose_and_even_seeds_do_not_speak(found):
    def slopes(even, odd):
        rows = [np.where(of.seeds % 2 == 0, e, o) for of, e, o in zip(found.maps, even, odd, strict=True)]
        return with_slopes(found, rows)

    made = slopes(even=[-0.1, 0.01, -0.3, 0.2], odd=[9.0, 8.0, 0.5, -7.0])
    assert made.choose() == (2, 1)
    assert made.slope_interval(2).estimate == pytest.approx(0.5)
    assert made.trend(2) == "does not hold"  # whatever it was chosen for
    assert made.slope_interval(2, "even").estimate == pytest.approx(-0.3)


def test_slopes_and_verdicts(found):
    margin = found.margin(0)
    mean_steps = found.maps[0].steps[found.maps[0].seeds % 2 == 1].mean()
    assert margin == pytest.approx(2 * 0.2 * 0.05 * mean_steps / 600)
    made = with_slopes(found, [-2 * margin, 0.9 * margin, 0.0, 2.0])
    np.testing.assert_allclose(made.mean_slopes(), [-2 * margin, 0.9 * margin, 0, 2], atol=1e-12)
    assert [made.trend(i, "all") for i in range(2)] == ["holds", "does not hold"]
    assert [made.no_trend(i) for i in range(4)] == ["does not hold", "holds", "holds", "does not hold"]


def test_steps_that_change_by_the_margin_change_the_weights_by_it(found):
    of = found.maps[0]
    steps = np.full((len(of.seeds), 11), 200.0) * (1 + 0.05 * (CA - 0.5))
    made = replace(of, steps=steps, weights=1.5 + found.repeats * 0.2 * (1 - steps / found.limit))
    changed = replace(found, maps=(made, *found.maps[1:]))
    assert changed.slope_interval(0).estimate == pytest.approx(-changed.margin(0))


def test_too_few_seeds_and_unknown_halves_are_refused(found, maps):
    with pytest.raises(TaskliftError, match="seeds: expected a whole number of at least 2, found 1"):
        survey(maps, seeds=1)
    with pytest.raises(TaskliftError, match="maps: expected at least one"):
        survey([])
    with pytest.raises(TaskliftError, match="expected even, odd or all, found 'third'"):
        found.slope_interval(0, "third")


def junction(turn=0.0):
    """A start room, a fork 10 m on, from there a room 10 m to the left and a loop on the right."""
    kind = [ROOM, INTERSECTION, ROOM, FEATURE, FEATURE]
    position = np.array([[0, 0], [0, 10], [-10, 10], [10, 10], [10, 20]], float)
    edges = np.array([[0, 1], [1, 2], [1, 3], [1, 4], [3, 4]])
    length = np.linalg.norm(position[edges[:, 0]] - position[edges[:, 1]], axis=1)
    rotation = np.array([[np.cos(turn), -np.sin(turn)], [np.sin(turn), np.cos(turn)]])
    return Building(
        name="junction",
        kind=np.array(kind, np.int8),
        feature_class=np.where(np.array(kind) == FEATURE, 4, 1).astype(np.int8),
        position_m=position @ rotation.T,
        area_m2=np.array([8.0, 0, 16, 0, 0]),
        obstacles=np.array([0, 0, 1, 0, 0]),
        edges=edges,
        length_m=length,
        width_m=np.full(5, 2.0),
        start=0,
    )


def test_properties_of_a_small_map():
    building = junction()
    values = map_properties(building)
    assert list(values) == list(PROPERTIES)
    far = 10 + np.sqrt(200)
    walk = 40 + np.sqrt(200)
    search = 2 + 5  # ceil(area / 4) + obstacles
    expected = {
        "corridor length (m)": walk,
        "loops": 1,
        "distance from the start (m)": (0 + 10 + 20 + 20 + far) / 5,
        "eccentricity of the start (m)": far,
        "diameter (m)": far,
        "dead ends (share)": 2 / 5,
        "degree of intersections": 4,
        "room search (share)": search / (search + walk),
        "distance of rooms (ratio)": 20 / ((50 + far) / 5),
    }
    for name, value in expected.items():
        assert values[name] == pytest.approx(value, abs=2e-3), name  # costs are whole millimetres
    here = slice(building.indptr[1], building.indptr[2])
    ways = building.coverage[here][1:] / building.coverage[here][1:].sum()  # not back to the start
    assert values["largest CovA"] == pytest.approx(ways.max())
    assert values["smallest CovA"] == pytest.approx(ways.min())
    assert values["robots to rooms (log2)"] == pytest.approx(np.log2(ways[0] * 3))


@settings(max_examples=15, deadline=None, derandomize=True)
@given(st.integers(0, 500), st.floats(0.1, 6.2))
def test_properties_do_not_depend_on_how_a_map_lies(seed, turn):
    building = generate(seed=seed)
    rotation = np.array([[np.cos(turn), -np.sin(turn)], [np.sin(turn), np.cos(turn)]])
    turned = replace(
        building,
        position_m=building.position_m @ rotation.T,
        outline_m=building.outline_m @ rotation.T,
        provenance={},
    )
    before, after = map_properties(building), map_properties(turned)
    for name in PROPERTIES:
        assert after[name] == pytest.approx(before[name], rel=1e-4, abs=1e-4), name


@pytest.fixture(scope="module")
def many():
    """Forty maps and nothing learned yet."""
    from tasklift.building.reading import SCATTERED
    from tasklift.studies.paper.survey import Surveyed

    seeds = np.arange(2)
    blank = np.full((2, 11), 150.0)
    return Survey(
        tuple(Surveyed(generate(seed=3000 + i), seeds, blank, blank) for i in range(40)), SCATTERED, 5, 600
    )


def test_a_property_that_decides_is_found(many):
    values = np.array([map_properties(of.building)["largest CovA"] for of in many.maps])
    made = with_slopes(many, -values)
    first = correlate(made)[0]
    assert (first.name, first.rho) == ("largest CovA", pytest.approx(-1.0))
    assert first.p == pytest.approx(1e-4)
    assert first.p < first.p_holm < 0.05
    assert "“largest CovA” (rank correlation -1.00" in made.in_words()


def test_chance_is_not_taken_for_a_cause(many):
    # 20 surveys of pure chance: at a family-wise level of 5 %, four or more false finds have p < 0.02
    rng = np.random.default_rng(0)
    finds = 0
    for _ in range(20):
        rows = correlate(with_slopes(many, rng.normal(size=40)), permutations=999)
        finds += any(row.p_holm < 0.05 for row in rows)
    assert finds <= 3


def test_what_is_the_same_on_all_maps_explains_nothing(many):
    rows = with_slopes(many, np.random.default_rng(1).normal(size=40)).explain()
    assert len(rows) == len(PROPERTIES)
    loops = [row for row in rows if row[0].startswith("loops")]
    assert loops == [("loops: independent cycles of the graph; the same on all", None, None)]
    assert rows.index(loops[0]) > max(i for i, row in enumerate(rows) if row[1] is not None)
