"""The replay page: one HTML file that works from the file system, fetches nothing and runs one script."""

from __future__ import annotations

import base64
import hashlib
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

from tasklift.files import write_atomically
from tasklift.report.charts import data_block, escape
from tasklift.style import GROUND, SCENE, css
from tasklift.watch.document import replay

if TYPE_CHECKING:
    from tasklift.building.simulator import Trace

_HERE = Path(__file__).parent / "page"
#: One script, in this order: what a replay means, the plan, how both are drawn, what people do with it
_SCRIPTS = ("model.js", "floor.js", "scene.js", "panels.js", "main.js")


def page(document: Mapping[str, Any]) -> str:
    """Return the page that plays a replay document (see :func:`tasklift.watch.replay`).

    All text in the document reaches the page as text, never as markup. Besides, the page's content security
    policy allows this one script and no request.
    """
    return filled("page.html", document.get("title", ""), "page.css", document, _SCRIPTS)


def filled(
    template: str, title: str, sheet: str, document: Mapping[str, Any], scripts: Sequence[str], allowed: str = ""
) -> str:
    """Return a page of the folder ``page``: a template with its style sheet, data and scripts in it.

    ``allowed`` adds a directive to the content security policy, which else allows these scripts and no request.
    """
    script = "".join(_part(name) for name in scripts)
    digest = base64.b64encode(hashlib.sha256(script.encode()).digest()).decode()
    policy = f"default-src 'none'; img-src data:; style-src 'unsafe-inline'; {allowed}script-src 'sha256-{digest}'"
    parts = {
        "policy": policy,
        "title": escape(title),
        "style": css(GROUND, SCENE) + _part(sheet),
        "data": data_block(document),
        "script": script,
    }
    # one pass over the template: what is filled in is not searched again
    head, *rest = _part(template).split("{{")
    pieces = [head]
    for chunk in rest:
        name, _, text = chunk.partition("}}")
        pieces += [parts[name], text]
    return "".join(pieces)


def write(title: str, traces: Sequence[tuple[str, Trace]], path: Path) -> None:
    """Write the page that plays labelled traces; reports link to such pages."""
    write_atomically(path, page(replay(list(traces), title)))


def _part(name: str) -> str:
    return (_HERE / name).read_text(encoding="utf-8")
