"""Reports as one HTML file: no network, readable without JavaScript, printable, safe against any text.

A report begins with its result: :meth:`Report.headline` is one sentence and the numbers behind it, a chart follows.
What most readers do not need goes into a :meth:`Report.fold`.
"""

from __future__ import annotations

import base64
import hashlib
import os
import re
from collections.abc import Iterable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from itertools import groupby
from pathlib import Path
from typing import Any, Literal

import numpy as np
from numpy.typing import ArrayLike

import tasklift
from tasklift.errors import TaskliftError
from tasklift.files import write_atomically
from tasklift.report.charts import VERDICTS, Row, Series, curves_html, data_block, escape, rows_html, shares_html
from tasklift.style import GROUND, LOOKS, Look, css, look
from tasklift.text import number

_HERE = Path(__file__).parent
_BLOCK, _CHART = "", "charts"
#: Classes of charts of which one, two or three stand side by side where there is room.
_BESIDE = {1: _BLOCK, 2: _CHART, 3: "charts narrow"}


@dataclass(frozen=True)
class Link:
    """A cell of a table that leads to a file beside the report, by its relative path."""

    text: str
    to: str


@dataclass(frozen=True)
class Number:
    """A number of the headline: the number as text, its interval as text, and what it counts."""

    value: str
    interval: str
    label: str


def _marked(text: object) -> str:
    """Escaped text in which ``**bold**``, ``*emphasis*`` and backticks work; nothing else does."""
    safe = escape(text)
    safe = re.sub(r"`([^`\n]+)`", r"<code>\1</code>", safe)
    safe = re.sub(r"\*\*(\S(?:[^*\n]*\S)?)\*\*", r"<strong>\1</strong>", safe)
    return re.sub(r"\*(\S(?:[^*\n]*\S)?)\*", r"<em>\1</em>", safe)


class Report:
    """A report that is built top to bottom and written at once; every method returns the report.

    All text is plain text and is escaped; in paragraphs, captions and the verdict ``**bold**``, ``*emphasis*``
    and backticks are marked up. A series has the colour of its slug (:data:`tasklift.style.LOOKS`), else one of
    its own throughout the report, by name.
    """

    def __init__(self, title: str) -> None:
        self.title = title
        self._parts: list[tuple[str, str]] = []
        self._sections: list[str] = []
        self._footer: list[str] = []
        self._looks: dict[str, Look] = {}

    def headline(self, sentence: str, numbers: Sequence[Number] = ()) -> Report:
        """Say the result in one sentence, and the numbers behind it, large, each with its interval."""
        text = f'<p class="lead">{_marked(sentence)}</p>'
        if numbers:
            items = (
                f"<div><dt>{_marked(one.label)}</dt><dd><b>{escape(one.value)}</b> "
                f"<span>{escape(one.interval)}</span></dd></div>"
                for one in numbers
            )
            text += f'<dl class="numbers">{"".join(items)}</dl>'
        return self._add(_BLOCK, text)

    def verdict(self, *lines: str) -> Report:
        """Say more of the result in words and numbers, set off from the rest; a paragraph per line."""
        text = "".join(f"<p>{_marked(line)}</p>" for line in lines)
        return self._add(_BLOCK, f'<div class="verdict">{text}</div>')

    def warning(self, text: str) -> Report:
        """Say what a reader must know before they believe the rest."""
        return self._add(_BLOCK, f'<p class="warning">{_marked(text)}</p>')

    @contextmanager
    def fold(self, summary: str) -> Iterator[Report]:
        """Put what is added within behind this line, closed until somebody opens it."""
        self._add(_BLOCK, f"<details><summary>{escape(summary)}</summary>")
        yield self
        self._add(_BLOCK, "</details>")

    def footer(self, *lines: str) -> Report:
        """Add lines to the page's foot: what made it, when, how."""
        self._footer += lines
        return self

    def section(self, title: str) -> Report:
        """Begin a section; the report's head links to it."""
        self._sections.append(title)
        return self._add(_BLOCK, f'<h2 id="s{len(self._sections)}">{escape(title)}</h2>')

    def paragraph(self, text: str) -> Report:
        """Add a paragraph."""
        return self._add(_BLOCK, f"<p>{_marked(text)}</p>")

    def bullets(self, lines: Iterable[str]) -> Report:
        """Add a list."""
        return self._add(_BLOCK, f"<ul>{''.join(f'<li>{_marked(line)}</li>' for line in lines)}</ul>")

    def code(self, text: str) -> Report:
        """Add text as it is, a command for example."""
        return self._add(_BLOCK, f"<pre>{escape(text)}</pre>")

    def table(self, headers: Sequence[str], rows: Iterable[Sequence[Any]], *, caption: str = "") -> Report:
        """Add a table. Numbers are set right; verdicts get a sign and a colour; a :class:`Link` leads to a file."""
        lines = [list(row) for row in rows]
        for line in lines:
            if len(line) != len(headers):
                raise TaskliftError(f"report.table: {len(line)} cells, expected {len(headers)}: {line}")
        right = [bool(lines) and all(_is_number(line[j]) for line in lines) for j in range(len(headers))]
        head = "".join(
            f'<th scope="col"{" class=num" if numeric else ""}>{_marked(text)}</th>'
            for text, numeric in zip(headers, right, strict=True)
        )
        body = [f"<tr>{''.join(_cell(value) for value in line)}</tr>" for line in lines]
        title = f"<caption>{_marked(caption)}</caption>" if caption else ""
        return self._add(
            _BLOCK,
            f'<div class="scroll" tabindex="0"><table>{title}<thead><tr>{head}</tr></thead>'
            f"<tbody>{''.join(body)}</tbody></table></div>",
        )

    def figure(self, picture: bytes | str | os.PathLike[str], caption: str = "", *, alt: str = "") -> Report:
        """Add a PNG or SVG, given as bytes or as a path; it is copied into the report."""
        if isinstance(picture, bytes):
            data = picture
        else:
            try:
                data = Path(picture).read_bytes()
            except OSError as error:
                raise TaskliftError(f"{picture}: cannot be read ({error.strerror})") from error
        if data.startswith(b"\x89PNG"):
            kind = "png"
        elif b"<svg" in data[:2000]:
            kind = "svg+xml"
        else:
            raise TaskliftError("report.figure: expected a PNG or an SVG, found something else")
        source = f"data:image/{kind};base64,{base64.b64encode(data).decode()}"
        return self._add(
            _BLOCK, f'<figure><img src="{source}" alt="{escape(alt or caption)}">{_caption(caption)}</figure>'
        )

    def curves(
        self,
        series: Sequence[Series],
        *,
        title: str = "",
        caption: str = "",
        x: ArrayLike | None = None,
        x_label: str = "episode",
        y_label: str = "",
        y_range: tuple[float, float] | None = None,
    ) -> Report:
        """Add curves with bands, named at their ends. Charts that follow one another stand side by side.

        With JavaScript, the pointer shows values, and the names switch series off and on. Where series have
        ``each``, a switch shows those values instead of the smoothed ones.
        """
        self._look((one.name, one.slug or one.name) for one in series)
        drawn, data = curves_html(series, self._looks, x=x, x_label=x_label, y_label=y_label, y_range=y_range)
        block = f'<script type="application/json">{data_block(data)}</script>'
        shown = _title(title) + drawn + _caption(caption)
        return self._add(_CHART, f'<figure data-chart="curves">{shown}{block}</figure>')

    def rows(
        self,
        rows: Sequence[Row],
        *,
        title: str = "",
        caption: str = "",
        label: str = "",
        within: tuple[float, float] | None = None,
        beside: Literal[1, 2, 3] = 1,
    ) -> Report:
        """Add a flat chart: a row per name, a dot with its interval per mark, one scale for all.

        Parameters
        ----------
        rows
            At least one mark in all.
        title, caption, label
            The head, what is below, and the scale's name.
        within
            The scale's ends; default: those of the marks.
        beside
            How many such charts, one after the other, stand side by side where there is room.
        """
        self._look((mark.slug, mark.slug) for row in rows for mark in row.marks)
        return self._flat(rows_html(rows, self._looks, label=label, within=within), title, caption, beside)

    def shares(
        self, rows: Sequence[tuple[str, Sequence[float], str]], *, title: str = "", caption: str = ""
    ) -> Report:
        """Add a flat chart of how often something holds, is undecided, and does not hold: name, three shares, text."""
        return self._flat(shares_html(rows), title, caption, 1)

    def html(self) -> str:
        """The whole document."""
        style = css(GROUND) + (_HERE / "report.css").read_text(encoding="utf-8")
        script = (_HERE / "report.js").read_text(encoding="utf-8")
        allowed = base64.b64encode(hashlib.sha256(script.encode()).digest()).decode()
        # besides escaping: a browser runs this one script only, and fetches nothing
        policy = f"default-src 'none'; img-src data:; style-src 'unsafe-inline'; script-src 'sha256-{allowed}'"
        links = "".join(f'<a href="#s{i}">{escape(text)}</a>' for i, text in enumerate(self._sections, 1))
        nav = f"<nav>{links}</nav>\n" if links else ""
        foot = "".join(f"<p>{_marked(line)}</p>" for line in self._footer)
        foot = f"<footer>{foot}</footer>\n" if foot else ""
        body = []
        for kind, group in groupby(self._parts, key=lambda part: part[0]):
            inner = "\n".join(text for _, text in group)
            body.append(f'<div class="{kind}">\n{inner}\n</div>' if kind else inner)
        return (
            f'<!DOCTYPE html>\n<html lang="en">\n<head>\n<meta charset="utf-8">\n'
            f'<meta http-equiv="Content-Security-Policy" content="{policy}">\n'
            f'<meta name="viewport" content="width=device-width, initial-scale=1">\n'
            f'<meta name="generator" content="tasklift {tasklift.__version__}">\n'
            f"<title>{escape(self.title)}</title>\n<style>\n{style}</style>\n</head>\n<body>\n"
            f"<main>\n<h1>{escape(self.title)}</h1>\n{nav}" + "\n".join(body) + f"\n</main>\n{foot}"
            f"<script>{script}</script>\n</body>\n</html>\n"
        )

    def write(self, path: str | os.PathLike[str]) -> None:
        """Write the report; an older one stays until the new one is complete."""
        write_atomically(path, self.html().encode("utf-8", errors="replace"))

    def _look(self, names: Iterable[tuple[str, str]]) -> None:
        """Give every new name the look of its slug, or one of its own."""
        for name, slug in names:
            if name not in self._looks:
                self._looks[name] = look(slug, [*self._looks.values(), *LOOKS.values()])

    def _flat(self, drawn: str, title: str, caption: str, beside: int) -> Report:
        return self._add(_BESIDE[beside], f"<figure>{_title(title)}{drawn}{_caption(caption)}</figure>")

    def _add(self, kind: str, text: str) -> Report:
        self._parts.append((kind, text))
        return self


def _title(text: str) -> str:
    """Return a chart's title: not a heading, since charts also stand above the first section."""
    return f'<p class="title">{escape(text)}</p>' if text else ""


def _caption(text: str) -> str:
    return f"<figcaption>{_marked(text)}</figcaption>" if text else ""


def _is_number(value: Any) -> bool:
    return isinstance(value, (int, float, np.number)) and not isinstance(value, (bool, np.bool_))


def _cell(value: Any) -> str:
    if isinstance(value, (bool, np.bool_)):
        return f"<td>{'yes' if value else 'no'}</td>"
    if value is None:
        return "<td>–</td>"
    if _is_number(value):
        return f'<td class="num">{number(float(value))}</td>'
    if isinstance(value, Link):
        return f'<td><a class="play" href="{escape(value.to)}">{escape(value.text)}</a></td>'
    text = str(value)
    for verdict, (sign, kind) in VERDICTS.items():
        if text == verdict or (verdict == "too few" and text.startswith(verdict)):
            short = " short" if len(text) < 16 else ""
            return f'<td><span class="badge {kind}{short}"><b>{sign}</b> <span>{escape(text)}</span></span></td>'
    return f"<td>{_marked(text)}</td>"
