"""V's coverage coefficient over maps: what is learned, what is chosen, what explains it."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from tasklift.building.generate import generate
from tasklift.building.graph import FEATURE, INTERSECTION, ROOM, Building
from tasklift.errors import TaskliftError
from tasklift.lab import FILE_NAME, Store, run
from tasklift.studies.paper.survey import PROPERTIES, Survey, correlate, further, map_properties, parts, read, study
from tasklift.studies.samples import CA


def surveyed(folder, **engine):
    plan = study(4, seeds=4, shown=4, repeats=2, team="4+2")
    with Store.open(folder / FILE_NAME, plan.spec("survey")) as store:
        run(store, plan.cells(), plan.work, **engine)
        run(store, further(plan, read(store, plan)), plan.work, **engine)
        return read(store, plan)["scattered"], store.digest()


@pytest.fixture(scope="module")
def survey(tmp_path_factory):
    return surveyed(tmp_path_factory.mktemp("survey"))


@pytest.fixture(scope="module")
def found(survey):
    return survey[0]


def with_slopes(survey_, slopes):
    """The same survey, had V taught straight lines with these slopes: (maps,) or (maps, seeds)."""
    changed = {}
    for (name, of), slope in zip(survey_.maps.items(), slopes, strict=True):
        weights = 2.0 + np.broadcast_to(slope, of.seeds.shape)[:, None] * CA
        changed[name] = replace(of, weights=weights)
    return replace(survey_, maps=changed)


def test_the_two_chosen_maps_get_further_odd_seeds(found):
    for name, of in found.maps.items():
        assert of.seeds.tolist() == ([0, 1, 2, 3, 5, 7] if name in found.shown() else [0, 1, 2, 3])
        assert of.weights.shape == of.steps.shape == (len(of.seeds), 11)


def test_weights_follow_from_the_time_of_the_trials(found):
    # every trial of V adds 0.2 (1 - steps / limit); the margin of C2 rests on this
    for of in found.maps.values():
        np.testing.assert_allclose(of.weights, 1.5 + 2 * 0.2 * (1 - of.steps / found.limit), rtol=0, atol=1e-9)


def test_workers_change_nothing(survey, tmp_path):
    assert surveyed(tmp_path, workers=1)[1] == survey[1]


def test_odd_seeds_do_not_choose_and_even_seeds_do_not_speak(found):
    def slopes(even, odd):
        rows = [np.where(of.seeds % 2 == 0, e, o) for of, e, o in zip(found.maps.values(), even, odd, strict=True)]
        return with_slopes(found, rows)

    made = slopes(even=[-0.1, 0.01, -0.3, 0.2], odd=[9.0, 8.0, 0.5, -7.0])
    assert made.choose() == (2, 1)
    steep = made.shown()[0]
    assert made.slope_interval(steep).estimate == pytest.approx(0.5)  # whatever it was chosen for
    assert made.slope_interval(steep, "even").estimate == pytest.approx(-0.3)


def test_slopes_and_margins(found):
    name = next(iter(found.maps))
    of = found.maps[name]
    margin = found.margin(name)
    assert margin == pytest.approx(2 * 0.2 * 0.05 * of.steps[of.seeds % 2 == 1].mean() / 600)
    made = with_slopes(found, [-2 * margin, 0.9 * margin, 0.0, 2.0])
    np.testing.assert_allclose(made.mean_slopes(), [-2 * margin, 0.9 * margin, 0, 2], atol=1e-12)
    assert "rise on 0" in made.in_words()  # without a spread nothing can be said of chance
    slopes = [
        v * margin + 1e-5 * np.resize([1, -1], of.seeds.size)
        for v, of in zip((-2, 0.9, 0, 900), found.maps.values(), strict=True)
    ]
    assert "rise on 2" in with_slopes(found, slopes).in_words()


def test_steps_that_change_by_the_margin_change_the_weights_by_it(found):
    name = next(iter(found.maps))
    of = found.maps[name]
    steps = np.full((len(of.seeds), 11), 200.0) * (1 + 0.05 * (CA - 0.5))
    made = replace(of, steps=steps, weights=1.5 + found.repeats * 0.2 * (1 - steps / found.limit))
    changed = replace(found, maps={**found.maps, name: made})
    assert changed.slope_interval(name).estimate == pytest.approx(-changed.margin(name))
    assert changed.coverage.changes[: len(of.seeds)] == pytest.approx(0.05)


def test_too_few_seeds_and_unknown_halves_are_refused(found):
    with pytest.raises(TaskliftError, match="seeds: expected a whole number of at least 2, found 1"):
        parts(["map-2000"], seeds=1)
    with pytest.raises(TaskliftError, match="survey: expected a whole number from 1 to"):
        study(0)
    with pytest.raises(TaskliftError, match="expected even, odd or all, found 'third'"):
        found.slope_interval(next(iter(found.maps)), "third")


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
    from tasklift.studies.paper.survey import Surveyed

    seeds = np.arange(2)
    blank = np.full((2, 11), 150.0)
    return Survey({f"map-{i}": Surveyed(generate(seed=i), seeds, blank, blank) for i in range(3000, 3040)}, 5, 600)


def test_a_property_that_decides_is_found(many):
    values = np.array([map_properties(of.building)["largest CovA"] for of in many.maps.values()])
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
