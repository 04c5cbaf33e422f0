"""Validation and text for people: one way and one wording each."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from tasklift import checks
from tasklift.errors import TaskliftError
from tasklift.text import LONGEST_LINE, number, one_line, printable, shown, with_interval

ANYTHING = (
    st.none() | st.booleans() | st.integers() | st.floats() | st.text() | st.binary()
    | st.lists(st.integers(), max_size=2)
)


@given(ANYTHING, st.integers(-5, 5), st.integers(0, 2**70))
def test_whole_numbers_in_range_pass_and_nothing_else(value: Any, least: int, span: int) -> None:
    good = isinstance(value, int) and not isinstance(value, bool) and least <= value <= least + span
    if good:
        assert checks.whole_number(value, "x", least, least + span) == value
    else:
        with pytest.raises(TaskliftError, match=r"^x: expected a whole number"):
            checks.whole_number(value, "x", least, least + span)


def test_whole_numbers_of_numpy_become_plain_and_too_large_ones_name_the_bound() -> None:
    assert type(checks.whole_number(np.uint8(3), "x")) is int
    with pytest.raises(TaskliftError, match="from 0 to 9,223,372,036,854,775,807, found a number of 71 digits"):
        checks.whole_number(10**70, "x")
    with pytest.raises(TaskliftError, match="from 1 to 100, found 101"):
        checks.whole_number(101, "x", 1, 100)


@given(ANYTHING)
def test_numbers_are_finite_and_in_range(value: Any) -> None:
    good = isinstance(value, int | float) and not isinstance(value, bool) and 0 < value <= 10
    if good:
        assert checks.number(value, "x", 0, 10, above=True) == value
    else:
        with pytest.raises(TaskliftError, match=r"^x: expected a"):
            checks.number(value, "x", 0, 10, above=True)


@given(st.text())
def test_digits_are_those_that_int_and_a_reader_agree_on(text: str) -> None:
    try:
        found = checks.digits(text, "x")
    except TaskliftError:
        assert not (text.isascii() and text.isdigit() and len(text) < 19)
    else:
        assert int(text) == found
        assert text.strip().isascii()


@pytest.mark.parametrize("text", ["²", "١", "1_0", "", " ", "1.0", "1e3", "+-1", "9" * 50, "0x1"])
def test_what_only_looks_like_digits_is_refused(text: str) -> None:
    with pytest.raises(TaskliftError, match="expected a whole number"):
        checks.digits(text, "team")


@pytest.mark.parametrize("name", ["", "a\nb", "\x1b[2J", "\ud800", "\u202e", "x" * 201, 5, None])
def test_what_cannot_be_a_name_is_refused(name: Any) -> None:
    with pytest.raises(TaskliftError, match="expected a name"):
        checks.check_name(name, "building")


def test_one_of_tells_truth_values_from_numbers() -> None:
    assert checks.one_of("b", ("a", "b"), "x") == "b"
    for value in ("c", True, [1]):
        with pytest.raises(TaskliftError, match="x: expected one of 1, 2, found"):
            checks.one_of(value, (1, 2), "x")


@given(st.text(st.characters()) | st.text("\n\r\x1b\ud800\u2028ab", max_size=2000))
def test_every_message_is_one_printable_line(text: str) -> None:
    for line in (str(TaskliftError(text)), one_line(text)):
        assert len(line) <= LONGEST_LINE
        assert len(line.splitlines()) <= 1
        assert printable(line) == line
        line.encode()


def test_a_long_message_keeps_its_beginning_and_its_end() -> None:
    line = one_line(f"file: {'x' * 10**6} is too long; shorten it")
    assert line.startswith("file: xxx")
    assert line.endswith("is too long; shorten it")


class Hostile:
    def __repr__(self) -> str:
        raise RuntimeError("no")


@given(ANYTHING)
def test_values_are_shown_short(value: Any) -> None:
    assert len(shown(value)) <= 60
    assert printable(shown(value)) == shown(value)


def test_what_cannot_be_shown_is_shown_all_the_same() -> None:
    assert shown(Hostile()) == "<Hostile, whose repr fails: RuntimeError>"
    assert shown(10**5000) == "a number of 5,001 digits"
    assert len(shown("x" * 10**7)) <= 60


@given(st.floats(allow_nan=False, allow_infinity=False, width=32))
def test_numbers_for_people_say_what_they_are(value: float) -> None:
    text = number(value).replace(",", "").replace("−", "-")
    assert math.isclose(float(text), value, rel_tol=6e-4)
    assert "-" not in number(value)


@pytest.mark.parametrize(
    ("numbers", "text"),
    [
        ((1.7231, 1.1752, 2.2713), "1.72 [1.18, 2.27]"),
        ((-3.5, -4.25, -2.75), "−3.50 [−4.25, −2.75]"),
        ((1234567, 1230000, 1240000), "1,234,567 [1,230,000, 1,240,000]"),
        ((2.0, 2.0, 2.0), "2.00 [2.00, 2.00]"),
        ((math.inf, 1.0, math.inf), "∞ [1, ∞]"),
        ((-0.001, -0.2, 0.198), "0.00 [−0.20, 0.20]"),
    ],
)
def test_an_interval_has_its_estimates_decimals(numbers: tuple[float, float, float], text: str) -> None:
    assert with_interval(*numbers) == text
