"""Text for people: one line, no control characters, one spelling of numbers."""

from __future__ import annotations

import html
import io
import math
import re
from collections.abc import Iterable, Sequence
from typing import Any

#: What a terminal or a log would obey instead of showing: controls, line ends, changes of direction, lone surrogates.
_CONTROLS = re.compile("[\x00-\x1f\x7f-\x9f\u061c\u200e\u200f\u2028-\u202e\u2066-\u2069\ufeff\ud800-\udfff]")
_SPACE = re.compile(r"\s*[\r\n\u2028\u2029]\s*")

LONGEST_LINE = 300
LONGEST_VALUE = 60


def printable(text: object) -> str:
    r"""Return the text with control characters spelled out, safe for a terminal, a log and a table.

    >>> printable("office\x1b[2J")
    'office\\x1b[2J'
    """
    return _CONTROLS.sub(lambda found: found[0].encode("unicode_escape", "surrogatepass").decode(), str(text))


def one_line(text: object, most: int = LONGEST_LINE) -> str:
    r"""Return the text in one line of at most ``most`` characters; what is too much is cut from its middle.

    >>> one_line("two\n  lines")
    'two lines'
    """
    raw = str(text)
    if len(raw) > 4 * most:  # bound the work as well
        raw = f"{raw[: 2 * most]}…{raw[-2 * most :]}"
    line = printable(_SPACE.sub(" ", raw))
    if len(line) <= most:
        return line
    tail = most // 3
    return f"{line[: most - tail - 1]}…{line[-tail:]}"


def shown(value: object, most: int = LONGEST_VALUE) -> str:
    """Return how a value is shown in a message: its ``repr``, in one line of at most ``most`` characters."""
    if isinstance(value, int) and abs(value) >= 10**most:
        return f"a number of {math.floor(value.bit_length() * math.log10(2)) + 1:,} digits"
    if isinstance(value, str | bytes) and len(value) > most:
        value = value[:most]
    try:
        text = repr(value)
    except Exception as error:  # a caller's own object may refuse
        text = f"<{type(value).__name__}, whose repr fails: {type(error).__name__}>"
    line = printable(text[: 4 * most])
    return line if len(line) <= most else f"{line[: most - 1]}…"


def html_table(caption: str, header: Sequence[str], rows: Iterable[Sequence[object]]) -> str:
    """Return a table for a notebook; every text in it is escaped.

    >>> html_table("Sizes", ["a"], [["<1"]])
    '<table><caption>Sizes</caption><tr><th>a</th></tr><tr><td>&lt;1</td></tr></table>'
    """
    head = "".join(f"<th>{html.escape(name)}</th>" for name in header)
    body = "".join(f"<tr>{''.join(f'<td>{html.escape(printable(c))}</td>' for c in row)}</tr>" for row in rows)
    return f"<table><caption>{html.escape(printable(caption))}</caption><tr>{head}</tr>{body}</table>"


def html_picture(caption: str, figure: Any) -> str:
    """Return a matplotlib figure for a notebook, as SVG below its caption."""
    picture = io.StringIO()
    figure.savefig(picture, format="svg")
    svg = picture.getvalue()
    return f"<p>{html.escape(caption)}</p>{svg[svg.index('<svg') :]}"


def number(value: float, digits: int = 4) -> str:
    """Return a number as people write it: ``digits`` significant digits, thousands apart by commas.

    >>> number(0.123456), number(-2), number(1234567.8)
    ('0.1235', '−2', '1,234,568')
    """
    if not math.isfinite(value):
        return "–" if math.isnan(value) else ("∞" if value > 0 else "−∞")
    if abs(value) >= 1e15:
        return f"{value:.{digits}g}".replace("-", "−")
    if abs(value) >= 1e4 or value == round(value):
        return _fixed(value, 0)
    return f"{value:.{digits}g}".replace("-", "−")


def with_interval(estimate: float, low: float, high: float) -> str:
    """Return an estimate and its interval, all three to the same decimals: two digits of the half width.

    >>> with_interval(1.7231, 1.1752, 2.2713)
    '1.72 [1.18, 2.27]'
    """
    half = (high - low) / 2
    if not (math.isfinite(half) and math.isfinite(estimate) and max(abs(low), abs(high), abs(estimate)) < 1e15):
        return f"{number(estimate)} [{number(low)}, {number(high)}]"
    places = 2 if half == 0 else min(6, max(0, 1 - math.floor(math.log10(half))))
    return f"{_fixed(estimate, places)} [{_fixed(low, places)}, {_fixed(high, places)}]"


def _fixed(value: float, places: int) -> str:
    text = f"{value:,.{places}f}"
    if float(text.replace(",", "")) == 0:
        text = text.removeprefix("-")
    return text.replace("-", "−")
