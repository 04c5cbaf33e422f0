"""Reports as one HTML file: no network, readable without JavaScript, printable, safe against any text."""

from __future__ import annotations

import base64
import hashlib
import os
import re
from collections.abc import Iterable, Sequence
from itertools import groupby
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

import tasklift
from tasklift.errors import TaskliftError
from tasklift.files import write_atomically
from tasklift.report.charts import Series, bars_scene, bars_svg, curves_svg, data_block, escape
from tasklift.style import GROUND, LOOKS, Look, css, look
from tasklift.text import number

_HERE = Path(__file__).parent
_BADGES = {"holds": "holds", "does not hold": "fails", "undecided": "open"}
_CHART, _SMALL, _BLOCK = "charts", "charts narrow", ""


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
        self._looks: dict[str, Look] = {}

    def verdict(self, *lines: str) -> Report:
        """Say the result in words and numbers, set off from the rest; a paragraph per line."""
        text = "".join(f"<p>{_marked(line)}</p>" for line in lines)
        return self._add(_BLOCK, f'<div class="verdict">{text}</div>')

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

    def code(self, text: str, *, summary: str | None = None) -> Report:
        """Add text as it is, a command for example; with ``summary``, folded away under that line."""
        block = f"<pre>{escape(text)}</pre>"
        if summary is not None:
            block = f"<details><summary>{escape(summary)}</summary>{block}</details>"
        return self._add(_BLOCK, block)

    def table(self, headers: Sequence[str], rows: Iterable[Sequence[Any]], *, caption: str = "") -> Report:
        """Add a table. Numbers are set right; *holds*, *does not hold* and *undecided* get their colour."""
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
            f'<div class="scroll"><table>{title}<thead><tr>{head}</tr></thead>'
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
        x_label: str = "trial",
        y_label: str = "",
        y_range: tuple[float, float] | None = None,
    ) -> Report:
        """Add curves with bands. Charts that follow one another stand side by side where there is room.

        With JavaScript, the pointer shows values and the legend switches series off and on.
        """
        for one in series:
            if one.name not in self._looks:
                self._looks[one.name] = look(one.slug or one.name, [*self._looks.values(), *LOOKS.values()])
        svg, data = curves_svg(series, self._looks, x=x, x_label=x_label, y_label=y_label, y_range=y_range)
        legend = "".join(
            f'<span class="c{self._looks[one.name].index}">'
            f'<i class="{self._looks[one.name].dash}"></i>{escape(one.name)}</span>'
            for one in series
        )
        return self._chart("curves", title, f'{svg}<div class="legend">{legend}</div>', data, caption, _CHART)

    def bars3d(
        self,
        values: ArrayLike,
        rows: Sequence[str],
        columns: Sequence[str],
        *,
        title: str = "",
        caption: str = "",
        z_label: str = "",
        z_range: tuple[float, float] | None = None,
    ) -> Report:
        """Add bars over a grid, ``values`` ``(rows, columns)``; dragging or the arrow keys turn them."""
        scene = bars_scene(values, rows, columns, z_label=z_label, z_range=z_range)
        label = escape(title or caption)
        svg = f'<svg viewBox="0 0 480 345" role="img" aria-label="{label}">{bars_svg(scene)}</svg>'
        hint = '<figcaption class="hint" hidden>Drag, or use the arrow keys, to turn it.</figcaption>'
        return self._chart("bars", title, svg + hint, scene, caption, _SMALL)

    def html(self) -> str:
        """The whole document."""
        style = css(GROUND) + (_HERE / "report.css").read_text(encoding="utf-8")
        script = (_HERE / "report.js").read_text(encoding="utf-8")
        allowed = base64.b64encode(hashlib.sha256(script.encode()).digest()).decode()
        # besides escaping: a browser runs this one script only, and fetches nothing
        policy = f"default-src 'none'; img-src data:; style-src 'unsafe-inline'; script-src 'sha256-{allowed}'"
        links = "".join(f'<a href="#s{i}">{escape(text)}</a>' for i, text in enumerate(self._sections, 1))
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
            f"<h1>{escape(self.title)}</h1>\n<nav>{links}</nav>\n" + "\n".join(body) + f"\n<script>{script}</script>"
            "\n</body>\n</html>\n"
        )

    def write(self, path: str | os.PathLike[str]) -> None:
        """Write the report; an older one stays until the new one is complete."""
        write_atomically(path, self.html().encode("utf-8", errors="replace"))

    def _chart(self, kind: str, title: str, inner: str, data: Any, caption: str, group: str) -> Report:
        head = f"<h3>{escape(title)}</h3>" if title else ""
        block = f'<script type="application/json">{data_block(data)}</script>'
        return self._add(group, f'<figure data-chart="{kind}">{head}{inner}{_caption(caption)}{block}</figure>')

    def _add(self, kind: str, text: str) -> Report:
        self._parts.append((kind, text))
        return self


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
    text = str(value)
    if text in _BADGES:
        return f'<td><span class="badge {_BADGES[text]}">{text}</span></td>'
    return f"<td>{_marked(text)}</td>"
