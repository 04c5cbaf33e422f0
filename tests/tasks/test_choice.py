"""The scalar rules: distributions, edges of the unit interval, and compiled code with the same answers."""

from __future__ import annotations

import numba
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy import stats

from tasklift.tasks import choice as rules

PROPERTY = settings(deadline=None, derandomize=True, max_examples=200)
ALMOST_ONE = np.nextafter(1.0, 0.0)
COMPILED = {
    name: numba.njit(getattr(rules, name)) for name in ("total", "draw", "draw_summed", "heaviest", "reinforce")
}

rows = st.lists(st.floats(0, 1e12), min_size=1, max_size=50).map(np.array)
tied_rows = st.lists(st.sampled_from([0.0, 1.0, 1.5]), min_size=1, max_size=50).map(np.array)
chances = st.floats(0, 1, exclude_max=True) | st.sampled_from([0.0, ALMOST_ONE, 0.5])


@PROPERTY
@given(rows | tied_rows, chances, chances, st.floats(0, 1))
def test_compiled_and_plain_rules_agree(row: np.ndarray, coin: float, u: float, greedy: float) -> None:
    drawn, most = rules.draw(row, u), rules.heaviest(row, u)
    assert COMPILED["draw"](row, u) == drawn
    sums = np.array([rules.total(row, n + 1) for n in range(len(row))])
    assert rules.draw_summed(row, sums, u) == drawn
    assert COMPILED["draw_summed"](row, sums, u) == drawn
    assert COMPILED["heaviest"](row, u) == most
    assert COMPILED["total"](row, len(row)) == rules.total(row, len(row))
    assert rules.select(row, greedy, coin, u) == (most if coin < greedy else drawn)
    assert 0 <= drawn < len(row)
    assert row[most] == row.max()
    if row.any():
        assert row[drawn] > 0


def test_draw_inverts_the_running_sum() -> None:
    row = np.array([0.0, 2.0, 0.0, 1.0, 1.0, 0.0])
    assert [rules.draw(row, u) for u in (0, 0.49, 0.5, 0.74, 0.75, ALMOST_ONE)] == [1, 1, 3, 3, 4, 4]
    assert [rules.draw(np.zeros(4), u) for u in (0, 0.25, 0.5, ALMOST_ONE)] == [0, 1, 2, 3]


def test_no_weight_zero_at_the_end_of_a_sum_that_rounds() -> None:
    # u * sum rounds up to the sum itself for a subnormal sum, so no running sum exceeds it
    row = np.array([5e-324, 0.0])
    assert rules.draw_summed(row, row.cumsum(), ALMOST_ONE) == 0
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
