"""A building corrected in the browser: one page on 127.0.0.1 that gathers lines of an edits file.

The page holds nothing but the lines. Each change is sent here, applied to the building as :mod:`tasklift.plans.edits`
applies a file, and what comes of it is drawn. What it saves is that file.
"""

from __future__ import annotations

import json
from collections.abc import Callable
from http import HTTPStatus
from http.server import BaseHTTPRequestHandler
from pathlib import Path
from typing import Any

from tasklift.building.graph import CLASS_NAMES, FEATURE, KIND_NAMES, Building
from tasklift.errors import TaskliftError
from tasklift.files import write_atomically
from tasklift.plans.edits import HEADER, LARGEST_EDITS_BYTES, apply_edits, as_places, parse_edits
from tasklift.plans.floor import picture
from tasklift.watch.html import filled
from tasklift.watch.server import ADDRESS, PageServer, run


class Editing:
    """A building, the edits file that is made, and where the corrected building goes, if anywhere."""

    def __init__(self, building: Building, edits: Path, out: Path | None, lines: list[str]):
        self.building, self.edits, self.out = building, edits, out
        self.lines = as_places(building, parse_edits("\n".join([HEADER, *lines]), str(edits)))

    def apply(self, lines: list[str]) -> Building:
        """The corrected building."""
        return apply_edits(self.building, parse_edits("\n".join([HEADER, *lines]), self.edits.name))[0]

    def save(self, lines: list[str]) -> str:
        """Write the file, and the corrected building; returns what to say."""
        corrected = self.apply(lines)
        write_atomically(self.edits, "\n".join([HEADER, *lines]) + "\n")
        if self.out is not None:
            corrected.save(self.out)
        return f"saved {self.edits.name}" + (f" and {self.out.name}" if self.out is not None else "")

    def page(self) -> str:
        """The page, with the building as the lines so far leave it."""
        plan = picture(self.building)
        document = {
            "building": drawn(self.apply(self.lines)),
            "lines": self.lines,
            "plan": None if plan is None else {"href": plan[0], "corners": plan[1]},
        }
        return filled(
            "edit.html", self.building.name or "building", "edit.css", document, ("edit.js",), "connect-src 'self'; "
        )


def drawn(building: Building) -> dict[str, Any]:
    """What the page draws: nodes with their class, corridors as polylines (m)."""
    kinds = zip(building.kind.tolist(), building.feature_class.tolist(), strict=True)
    return {
        "start": building.start,
        "nodes": [
            {"x": x, "y": y, "class": CLASS_NAMES[feature] if kind == FEATURE else KIND_NAMES[kind], "area": area}
            for (x, y), (kind, feature), area in zip(
                building.position_m.round(3).tolist(), kinds, building.area_m2.round(2).tolist(), strict=True
            )
        ],
        "edges": [
            {"a": a, "b": b, "line": building.line_m(i).round(3).tolist()}
            for i, (a, b) in enumerate(building.edges.tolist())
        ],
    }


class _Handler(BaseHTTPRequestHandler):
    server: _EditServer

    def do_GET(self) -> None:
        if self._is_ours() and self.path == "/":
            self._answer(HTTPStatus.OK, self.server.editing.page().encode("utf-8", "replace"), "text/html")
        else:
            self.send_error(HTTPStatus.NOT_FOUND)

    def do_POST(self) -> None:
        """Apply or save the lines that are sent; only this server's own page may."""
        length = self.headers.get("Content-Length", "")
        origin = self.headers.get("Origin")
        if not self._is_ours() or origin != self.server.url.rstrip("/") or self.path not in ("/apply", "/save"):
            self.send_error(HTTPStatus.FORBIDDEN)
            return
        if not length.isdigit() or int(length) > LARGEST_EDITS_BYTES:
            self.send_error(HTTPStatus.REQUEST_ENTITY_TOO_LARGE)
            return
        try:
            lines = _lines(self.rfile.read(int(length)))
            if self.path == "/save":
                answer: dict[str, Any] = {"said": self.server.editing.save(lines)}
            else:
                answer = {"building": drawn(self.server.editing.apply(lines))}
        except TaskliftError as error:
            answer = {"error": str(error)}
        self._answer(HTTPStatus.OK, json.dumps(answer).encode(), "application/json")

    def _is_ours(self) -> bool:
        # a page elsewhere that points its own name at this address would send that name: it gets nothing
        return self.headers.get("Host") == f"{ADDRESS}:{self.server.server_port}"

    def _answer(self, status: HTTPStatus, body: bytes, kind: str) -> None:
        self.send_response(status)
        self.send_header("Content-Type", f"{kind}; charset=utf-8")
        self.send_header("Content-Length", str(len(body)))
        self.send_header("Cache-Control", "no-store")
        self.end_headers()
        self.wfile.write(body)

    def log_message(self, format: str, *args: object) -> None:
        """Say nothing: the terminal shows the address only."""


class _EditServer(PageServer):
    def __init__(self, editing: Editing) -> None:
        super().__init__(_Handler)
        self.editing = editing


def _lines(body: bytes) -> list[str]:
    try:
        found = json.loads(body)
    except (ValueError, RecursionError) as error:
        raise TaskliftError("expected a list of lines") from error
    if not isinstance(found, list) or not all(isinstance(line, str) and line.isprintable() for line in found):
        raise TaskliftError("expected a list of lines")
    return found


def edit(editing: Editing, *, open_browser: bool, say: Callable[[str], None]) -> None:
    """Serve the page of an editing session and return after Ctrl-C; see :func:`tasklift.watch.server.serve`."""
    with _EditServer(editing) as server:
        run(server, "edit", open_browser=open_browser, say=say)
