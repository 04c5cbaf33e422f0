"""The scalar rules: distributions, edges of the unit interval, and compiled code with the same answers."""

from __future__ import annotations

import numba
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy import stats

import tasklift.building.bits  # noqa: F401 - tells Numba how to count eight at once
from tasklift.tasks import choice as rules

PROPERTY = settings(deadline=None, derandomize=True, max_examples=200)
ALMOST_ONE = np.nextafter(1.0, 0.0)
COMPILED = {
    name: numba.njit(getattr(rules, name))
    for name in ("total", "draw", "sum_up", "draw_summed", "heaviest", "reinforce")
}


@numba.njit
def at_or_below(rising, first, target):
    return rules.at_or_below(rising, first, target)


rows = st.lists(st.floats(0, 1e12), min_size=1, max_size=50).map(np.array)
long_rows = st.tuples(st.integers(1, 300), st.integers(0, 2**32)).map(
    lambda case: np.random.default_rng(case[1]).choice([0.0, 0.5, 1.5, 2e9], case[0])
)
rising_numbers = st.lists(st.floats(0, 9) | st.just(np.inf), min_size=16, max_size=16).map(sorted)
tied_rows = st.lists(st.sampled_from([0.0, 1.0, 1.5]), min_size=1, max_size=50).map(np.array)
chances = st.floats(0, 1, exclude_max=True) | st.sampled_from([0.0, ALMOST_ONE, 0.5])


@PROPERTY
@given(rows | tied_rows, chances, chances, st.floats(0, 1))
def test_compiled_and_plain_rules_agree(row: np.ndarray, coin: float, u: float, greedy: float) -> None:
    drawn, most = rules.draw(row, u), rules.heaviest(row, u)
    assert COMPILED["draw"](row, u) == drawn
    assert COMPILED["heaviest"](row, u) == most
    assert COMPILED["total"](row, len(row)) == rules.total(row, len(row))
    assert rules.select(row, greedy, coin, u) == (most if coin < greedy else drawn)
    assert 0 <= drawn < len(row)
    assert row[most] == row.max()
    if row.any():
        assert row[drawn] > 0


@PROPERTY
@given(rows | tied_rows | long_rows, chances, st.data())
def test_kept_sums_draw_as_the_weights_do(row: np.ndarray, u: float, data: st.DataObject) -> None:
    kept = {name: np.full(rules.room_for_sums(len(row)), np.inf) for name in ("plain", "compiled")}
    first = 0
    for _ in range(3):
        rules.sum_up(row, kept["plain"], first)
        COMPILED["sum_up"](row, kept["compiled"], first)
        assert kept["plain"].tolist() == kept["compiled"].tolist()
        assert kept["plain"][len(row) - 1] == rules.total(row, len(row))
        assert rules.draw_summed(row, kept["plain"], u) == rules.draw(row, u)
        assert COMPILED["draw_summed"](row, kept["compiled"], u) == rules.draw(row, u)
        first = data.draw(st.integers(0, len(row) - 1))  # the next change leaves the sums before it as they are
        row[first] = data.draw(st.sampled_from([0.0, 0.25, 7.0]))


@PROPERTY
@given(rising_numbers, st.integers(0, 8), st.floats(0, 9))
def test_eight_are_counted_at_once_as_one_by_one(rising: list[float], first: int, target: float) -> None:
    counted = sum(value <= target for value in rising[first : first + 8])
    assert rules.at_or_below(rising, first, target) == counted
    assert at_or_below(np.array(rising), first, target) == counted


def test_draw_inverts_the_running_sum() -> None:
    row = np.array([0.0, 2.0, 0.0, 1.0, 1.0, 0.0])
    assert [rules.draw(row, u) for u in (0, 0.49, 0.5, 0.74, 0.75, ALMOST_ONE)] == [1, 1, 3, 3, 4, 4]
    assert [rules.draw(np.zeros(4), u) for u in (0, 0.25, 0.5, ALMOST_ONE)] == [0, 1, 2, 3]


def test_no_weight_zero_at_the_end_of_a_sum_that_rounds() -> None:
    # u * sum rounds up to the sum itself for a subnormal sum, so no running sum exceeds it
    row = np.array([5e-324, 0.0])
    sums = np.full(rules.room_for_sums(2), np.inf)
    rules.sum_up(row, sums, 0)
    assert rules.draw_summed(row, sums, ALMOST_ONE) == 0
    assert COMPILED["draw_summed"](row, sums, ALMOST_ONE) == 0
    assert rules.draw(row, ALMOST_ONE) == 0
    assert COMPILED["draw"](row, ALMOST_ONE) == 0


@pytest.mark.parametrize("row", [[1.5, 0.0, 0.3, 3.2], [0.0, 0.0, 0.0]])
def test_draws_are_in_proportion(row: list[float]) -> None:
    weights = np.array(row)
    n = 20_000
    counts = np.bincount(
        [COMPILED["draw"](weights, u) for u in np.random.default_rng(0).random(n)], minlength=len(row)
    )
    expected = n * (weights / weights.sum() if weights.any() else np.full(len(row), 1 / len(row)))
    assert (counts[expected == 0] == 0).all()
    assert stats.chisquare(counts[expected > 0], expected[expected > 0]).pvalue > 1e-3


def test_ties_are_broken_evenly() -> None:
    row = np.array([1.0, 3.0, 3.0, 0.0, 3.0])
    counts = np.bincount(
        [rules.heaviest(row, u) for u in np.random.default_rng(1).random(9_000)], minlength=5
    )
    assert counts[[0, 3]].sum() == 0
    assert stats.chisquare(counts[[1, 2, 4]]).pvalue > 1e-3


def test_reinforce_stops_at_the_floor() -> None:
    assert rules.reinforce(1.5, -0.5, 0.0) == 1.0
    assert rules.reinforce(0.3, -0.5, 0.0) == 0.0
    assert COMPILED["reinforce"](0.3, -0.5, 0.1) == 0.1
