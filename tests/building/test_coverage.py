"""CovA against areas worked out by other means: by hand, and by cutting with half-planes and the shoelace."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import assume, given, settings
from hypothesis import strategies as st

from tasklift.building.generate import generate
from tasklift.building.graph import Building
from tasklift.building.ways import sectors

SQUARE = [[-10, -10], [10, -10], [10, 10], [-10, 10]]
# A concave outline: an L without its upper right quarter
L_SHAPE = [[-10, -10], [10, -10], [10, 0.5], [0.5, 0.5], [0.5, 10], [-10, 10]]


def star(angles_deg, outline=SQUARE, centre=(0.0, 0.0), radius=0.25):
    """A building with one node in the middle, number 0, and a corridor at each angle, in the order given."""
    angles = np.radians(angles_deg)
    ends = np.column_stack([np.cos(angles), np.sin(angles)]) * radius
    n = len(angles) + 1
    return Building(
        name="star",
        kind=[1] * n,
        feature_class=[1] * n,
        position_m=np.concatenate([[[0.0, 0.0]], ends]) + centre,
        area_m2=[0] * n,
        obstacles=[0] * n,
        edges=[[0, i] for i in range(1, n)],
        length_m=[1.0] * (n - 1),
        width_m=[2.0] * (n - 1),
        start=0,
        outline_m=outline,
    )


def shares(building, node=0):
    return building.coverage[building.indptr[node] : building.indptr[node + 1]]


def shoelace(ring):
    if len(ring) < 3:
        return 0.0
    x, y = np.array(ring).T
    return abs(float(x @ np.roll(y, -1) - y @ np.roll(x, -1))) / 2


def cut(ring, point, normal):
    """Keep the part of a ring where (p - point)·normal >= 0; bridges left on the cut have no area."""
    kept = []
    for a, b in zip(ring, ring[1:] + ring[:1], strict=True):
        side_a, side_b = ((p[0] - point[0]) * normal[0] + (p[1] - point[1]) * normal[1] for p in (a, b))
        if side_a >= 0:
            kept.append(a)
        if (side_a >= 0) != (side_b >= 0):
            t = side_a / (side_a - side_b)
            kept.append((a[0] + t * (b[0] - a[0]), a[1] + t * (b[1] - a[1])))
    return kept


def expected(building, node):
    """CovA by cutting the outline along both bisectors of every corridor."""
    here = building.position_m[node]
    others = building.neighbour[building.indptr[node] : building.indptr[node + 1]]
    angles = [math.atan2(*(building.position_m[other] - here)[::-1]) for other in others]
    ranked = sorted(angles)
    areas = []
    for angle in angles:
        i = ranked.index(angle)
        after = (ranked[(i + 1) % len(ranked)] - angle) % (2 * math.pi)
        before = (angle - ranked[i - 1]) % (2 * math.pi)
        low, high = angle - before / 2, angle + after / 2
        ring = [tuple(p) for p in building.outline_m.tolist()]
        ring = cut(ring, here, (-math.sin(low), math.cos(low)))
        ring = cut(ring, here, (math.sin(high), -math.cos(high)))
        areas.append(shoelace(ring))
    return np.array(areas) / sum(areas)


angle_sets = st.lists(st.integers(0, 359), min_size=2, max_size=7, unique=True)


@pytest.mark.parametrize(
    ("angles", "outline", "wanted"),
    [
        ([0, 90, 180, 270], SQUARE, [1 / 4] * 4),
        ([45, 135, 225, 315], SQUARE, [1 / 4] * 4),
        ([0, 180], SQUARE, [1 / 2, 1 / 2]),
        ([0, 90, 180], SQUARE, [3 / 8, 1 / 4, 3 / 8]),
        # Bisectors at 45° and 225°: the diagonal, whichever way round the corridors are listed
        ([0, 90], SQUARE, [1 / 2, 1 / 2]),
        ([90, 0], SQUARE, [1 / 2, 1 / 2]),
        # Bisectors at 60°, 180°, 300°: the right half less two triangles of 10 x 10/sqrt(3)
        (
            [0, 120, 240],
            SQUARE,
            [(200 - 100 / math.sqrt(3)) / 400, *([(100 + 50 / math.sqrt(3)) / 400] * 2)],
        ),
        # In the triangle (-1, -1), (2, -1), (-1, 2) around (0, 0), of area 4.5: corridors east and north; the
        # bisectors are the axis of symmetry
        ([0, 90], [[-1, -1], [2, -1], [-1, 2]], [1 / 2, 1 / 2]),
        # East and west there: the line x = 0 leaves a triangle of legs 2 on the right
        ([0, 180], [[-1, -1], [2, -1], [-1, 2]], [2 / 4.5, 2.5 / 4.5]),
        ([17], SQUARE, [1]),
    ],
)
def test_areas_worked_out_by_hand(angles, outline, wanted):
    np.testing.assert_allclose(shares(star(angles, outline)), wanted, rtol=0, atol=1e-12)


@settings(deadline=None, derandomize=True, max_examples=80)
@given(
    angle_sets,
    st.sampled_from([SQUARE, L_SHAPE]),
    st.tuples(st.floats(-9, 0), st.floats(-9, 0)),
)
def test_areas_agree_with_cutting_by_half_planes(angles, outline, centre):
    building = star(angles, outline, centre)
    np.testing.assert_allclose(shares(building), expected(building, 0), rtol=0, atol=1e-9)


@settings(deadline=None, derandomize=True, max_examples=60)
@given(angle_sets, st.sampled_from([SQUARE, L_SHAPE]), st.floats(0, 2 * math.pi), st.tuples(st.floats(-99, 99)))
def test_turning_and_moving_everything_changes_nothing(angles, outline, turn, move):
    building = star(angles, outline)
    matrix = np.array([[math.cos(turn), -math.sin(turn)], [math.sin(turn), math.cos(turn)]])
    fields = {name: getattr(building, name) for name in building.__dataclass_fields__}
    fields |= {name: fields[name] @ matrix.T + move for name in ("position_m", "outline_m")}
    np.testing.assert_allclose(Building(**fields).coverage, building.coverage, rtol=0, atol=1e-9)


@settings(deadline=None, derandomize=True, max_examples=40)
@given(angle_sets, st.integers(0, 6))
def test_the_order_of_corridors_does_not_matter(angles, shift):
    turned = angles[shift % len(angles) :] + angles[: shift % len(angles)]
    by_angle = dict(zip(angles, shares(star(angles)), strict=True))
    for angle, share in zip(turned, shares(star(turned)), strict=True):
        assert share == pytest.approx(by_angle[angle], abs=1e-12)


@settings(deadline=None, derandomize=True, max_examples=15)
@given(st.integers(0, 10_000))
def test_shares_of_a_generated_building(seed):
    building = generate(seed=seed)
    assert building.coverage.shape == (2 * building.n_edges,)
    assert (building.coverage >= 0).all()
    np.testing.assert_allclose(np.add.reduceat(building.coverage, building.indptr[:-1]), 1, rtol=0, atol=1e-14)
    for node in range(0, building.n_nodes, 5):
        wanted = expected(building, node) if building.degree[node] > 1 else 1.0
        np.testing.assert_allclose(shares(building, node), wanted, rtol=0, atol=1e-9)


def test_corridors_in_the_same_direction_share_their_sector_evenly():
    building = star([0, 0, 180])
    np.testing.assert_allclose(shares(building), [1 / 4, 1 / 4, 1 / 2], rtol=0, atol=1e-12)
    first, second, _ = sectors(building, 0)
    assert first.equals(second)
    np.testing.assert_allclose(shares(star([30, 30, 30])), [1 / 3] * 3)
    # A ten-billionth of a turn around east, from both sides
    tiny = 360e-12
    np.testing.assert_allclose(shares(star([tiny, -tiny, 180])), [1 / 4, 1 / 4, 1 / 2], rtol=0, atol=1e-9)


@settings(deadline=None, derandomize=True, max_examples=60)
@given(angle_sets, st.sampled_from([(-10.0, 0.0), (10.0, 10.0), (-10.0, -10.0), (3.0, 10.0)]))
def test_a_node_on_the_outline_gets_shares_that_sum_to_one(angles, centre):
    # Corridors so short that their ends count as on the outline too
    building = star(angles, centre=centre, radius=5e-4)
    assert shares(building).sum() == pytest.approx(1, abs=1e-12)
    assert (shares(building) >= 0).all()


@settings(deadline=None, derandomize=True, max_examples=60)
@given(angle_sets, st.tuples(st.floats(-9, 0), st.floats(-9, 0)))
def test_sectors_are_what_the_shares_measure(angles, centre):
    import shapely

    building = star(angles, L_SHAPE, centre)
    parts = sectors(building, 0)
    total = shapely.Polygon(L_SHAPE).area
    np.testing.assert_allclose([part.area / total for part in parts], shares(building), rtol=0, atol=1e-9)
    overlaps = [a.intersection(b).area for i, a in enumerate(parts) for b in parts[:i]]
    np.testing.assert_allclose(overlaps, 0, rtol=0, atol=1e-9)


@settings(deadline=None, derandomize=True, max_examples=60)
@given(angle_sets)
def test_each_sector_holds_its_own_corridor_and_no_other(angles):
    import shapely

    gaps = np.diff([*sorted(angles), sorted(angles)[0] + 360])
    assume(gaps.min() >= 2)
    building = star(angles)
    for i, part in enumerate(sectors(building, 0)):
        for j in range(1, building.n_nodes):
            assert part.covers(shapely.Point(building.position_m[j])) == (i + 1 == j)


def test_a_dead_end_sees_everything():
    building = star([0])
    assert building.coverage.tolist() == [1, 1]
    (only,) = sectors(building, 1)
    assert only.area == 400
