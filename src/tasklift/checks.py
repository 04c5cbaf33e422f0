"""Validation: each kind of value is checked in one way, with one wording.

Every function returns the value, as a plain Python value, or raises :class:`TaskliftError` with what was
expected, what was found and where.
"""

from __future__ import annotations

import math
import re
from collections.abc import Collection, Mapping
from typing import Any, TypeVar

import numpy as np

from tasklift.errors import TaskliftError
from tasklift.text import printable, shown

T = TypeVar("T")

LARGEST_WHOLE = 2**63 - 1
"""The largest whole number that the compiled parts can keep: seeds may be as large."""

DEEPEST = 100
"""Levels of lists and objects in a document. A policy's provenance grows by one with each extension."""

LONGEST_NAME = 200


def whole_number(value: Any, what: str, least: int = 0, most: int = LARGEST_WHOLE) -> int:
    """Return ``value`` if it is a whole number from ``least`` to ``most``; NumPy's count, truth values do not.

    >>> whole_number(3, "trials", 1)
    3
    >>> whole_number(2.0, "trials", 1)
    Traceback (most recent call last):
    tasklift.errors.TaskliftError: trials: expected a whole number of at least 1, found 2.0
    """
    good = isinstance(value, int | np.integer) and not isinstance(value, bool)
    if good and least <= value <= most:
        return int(value)
    open_ended = most == LARGEST_WHOLE and not (good and value > most)
    bounds = f"of at least {least:,}" if open_ended else f"from {least:,} to {most:,}"
    raise TaskliftError(f"{what}: expected a whole number {bounds}, found {shown(value)}")


def number(value: Any, what: str, least: float = -math.inf, most: float = math.inf, *, above: bool = False) -> float:
    """Return ``value`` as a float if it is a finite number from ``least`` (with ``above``, beyond it) to ``most``."""
    good = isinstance(value, int | float | np.integer | np.floating) and not isinstance(value, bool)
    if not good or not abs(value) <= 1.7e308:
        raise TaskliftError(f"{what}: expected a finite number, found {shown(value)}")
    if least <= value <= most and not (above and value == least):
        return float(value)
    lower = "" if least == -math.inf else f" {'above' if above else 'from'} {least:g}"
    upper = "" if most == math.inf else f" up to {most:g}"
    raise TaskliftError(f"{what}: expected a number{lower}{upper}, found {shown(value)}")


def one_of(value: T, allowed: Collection[T], what: str) -> T:
    """Return ``value`` if it is among those allowed."""
    if any(type(value) is type(one) and value == one for one in allowed):
        return value
    raise TaskliftError(f"{what}: expected one of {', '.join(map(str, allowed))}, found {shown(value)}")


def check_name(value: Any, what: str) -> str:
    """Return ``value`` if it can be a name: text of 1 to 200 characters in one line, without control characters."""
    if not isinstance(value, str):
        raise TaskliftError(f"{what}: expected a name, found {shown(value)}")
    if not value or len(value) > LONGEST_NAME or printable(value) != value:
        raise TaskliftError(
            f"{what}: expected a name of 1 to {LONGEST_NAME} characters in one line, without control characters, "
            f"found {shown(value)}"
        )
    return value


def digits(text: str, what: str, least: int = 0, most: int = LARGEST_WHOLE) -> int:
    """Return the whole number that a text from a command line or a file spells, in the digits 0 to 9 only.

    >>> digits("²", "team")
    Traceback (most recent call last):
    tasklift.errors.TaskliftError: team: expected a whole number of at least 0, found '²'
    """
    spelled = text.strip()
    if not re.fullmatch(r"-?[0-9]{1,40}", spelled):
        raise TaskliftError(f"{what}: expected a whole number of at least {least}, found {shown(text)}")
    return whole_number(int(spelled), what, least, most)


def plain(value: Any, where: str) -> Any:
    """Return a document's ``value`` if it holds nothing but plain data of moderate size.

    Lists and objects at most :data:`DEEPEST` deep, texts without control characters (tabs and line ends are
    allowed) and without lone surrogates, finite numbers, whole numbers of at most 64 bits, null, true, false.
    """
    stack: list[tuple[Any, int]] = [(value, 0)]
    while stack:
        item, depth = stack.pop()
        if item is None or isinstance(item, bool):
            continue
        if isinstance(item, str):
            if not item.isascii() or not item.isprintable():
                _check_text(item, where)
        elif isinstance(item, int):
            if not -(2**63) <= item < 2**64:
                raise TaskliftError(f"{where}: expected a number of at most 64 bits, found {shown(item)}")
        elif isinstance(item, float):
            if not math.isfinite(item):
                raise TaskliftError(f"{where}: expected a finite number, found {item}")
        elif isinstance(item, list | dict):
            if depth >= DEEPEST:
                raise TaskliftError(f"{where}: nested more than {DEEPEST} deep, which none of our files is")
            if isinstance(item, dict):
                for key in item:
                    if not isinstance(key, str):
                        raise TaskliftError(f"{where}: expected text as the name of a field, found {shown(key)}")
                    _check_text(key, where)
                stack.extend((inner, depth + 1) for inner in item.values())
            else:
                stack.extend((inner, depth + 1) for inner in item)
        else:
            raise TaskliftError(f"{where}: expected text or a number, found {shown(item)} ({type(item).__name__})")
    return value


_NOT_TEXT = re.compile("[\x00-\x08\x0b\x0c\x0e-\x1f\x7f-\x9f\ud800-\udfff]")


def _check_text(text: str, where: str) -> None:
    found = _NOT_TEXT.search(text)
    if found is not None:
        kind = "half a surrogate pair" if found[0] >= "\ud800" else "a control character"
        raise TaskliftError(f"{where}: a text holds {kind} ({shown(found[0])}): {shown(text)}")


#: The types that fields have, in words that JSON, TOML and YAML share.
_SPELLED: dict[Any, str] = {
    None: "null", str: "text", int: "a whole number", float: "a number", bool: "true or false", list: "a list",
    tuple: "a list", dict: "an object (table)", Mapping: "an object (table)",
}  # fmt: skip


def check_fields(value: Any, where: str, kinds: Mapping[str, Any]) -> dict[str, Any]:
    """Return ``value`` if it is an object with exactly these fields, each of a type it may have.

    Parameters
    ----------
    value
        What was read.
    where
        Named in errors.
    kinds
        For each field the type, or a tuple of types, that it may have; None among them allows null. A truth
        value is not taken for a number. A field whose name ends in ``?`` may be missing.
    """
    if not isinstance(value, dict):
        raise TaskliftError(f"{where}: expected an object with fields, found {shown(value)}")
    names = {field.removesuffix("?") for field in kinds}
    unknown = sorted(set(value) - names, key=str)
    if unknown:
        raise TaskliftError(
            f"{where}: unknown field {shown(unknown[0])}; the fields are {', '.join(sorted(names))}"
        )
    for field, allowed in kinds.items():
        types = allowed if isinstance(allowed, tuple) else (allowed,)
        key = field.removesuffix("?")
        if key not in value:
            if field.endswith("?"):
                continue
            raise TaskliftError(f"{where}: the field {key!r} is missing")
        found = value[key]
        if found is None or (isinstance(found, bool) and bool not in types):
            fits = found is None and None in types
        else:
            fits = isinstance(found, tuple(kind for kind in types if kind is not None))
        if not fits:
            asked = [kind for kind in types if kind is not int or float not in types]
            wanted = dict.fromkeys(_SPELLED.get(kind) or kind.__name__ for kind in asked)
            raise TaskliftError(f"{where}: expected {' or '.join(wanted)} in the field {key!r}, found {shown(found)}")
    return value
