"""One page on 127.0.0.1, until Ctrl-C."""

from __future__ import annotations

import sys
import threading
import webbrowser
from collections.abc import Callable
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from typing import Any

ADDRESS = "127.0.0.1"


class PageServer(ThreadingHTTPServer):
    """A server on a free port of this machine alone."""

    daemon_threads = True

    def __init__(self, handler: type[BaseHTTPRequestHandler]) -> None:
        super().__init__((ADDRESS, 0), handler)  # port 0: a free one
        self.url = f"http://{ADDRESS}:{self.server_port}/"

    def handle_error(self, request: Any, client_address: Any) -> None:
        """Say nothing of a tab that was closed or reloaded before it had the page."""
        if not isinstance(sys.exception(), ConnectionError):
            super().handle_error(request, client_address)


class _Server(PageServer):
    def __init__(self, html: str) -> None:
        super().__init__(_Handler)
        self.body = html.encode("utf-8", errors="replace")


class _Handler(BaseHTTPRequestHandler):
    server: _Server

    def do_GET(self) -> None:
        self._answer(with_body=True)

    def do_HEAD(self) -> None:
        self._answer(with_body=False)

    def _answer(self, with_body: bool) -> None:
        # a page elsewhere that points its own name at this address would send that name: it gets nothing
        if self.headers.get("Host") != f"{ADDRESS}:{self.server.server_port}":
            self.send_error(403)
        elif self.path != "/":
            self.send_error(404)
        else:
            self.send_response(200)
            self.send_header("Content-Type", "text/html; charset=utf-8")
            self.send_header("Content-Length", str(len(self.server.body)))
            self.send_header("Cache-Control", "no-store")
            self.end_headers()
            if with_body:
                self.wfile.write(self.server.body)

    def log_message(self, format: str, *args: object) -> None:
        """Say nothing: the terminal shows the address only."""


def serve(html: str, *, open_browser: bool, say: Callable[[str], None]) -> None:
    """Serve one page and return after Ctrl-C.

    Parameters
    ----------
    html
        The page.
    open_browser
        Whether to open it in the user's browser.
    say
        Gets the address once the page is there.
    """
    with _Server(html) as server:
        run(server, "watch", open_browser=open_browser, say=say)


def run(server: PageServer, verb: str, *, open_browser: bool, say: Callable[[str], None]) -> None:
    """Say where the server is, and serve until Ctrl-C."""
    say(f"{verb} at {server.url} (Ctrl-C ends it)")
    if open_browser:
        # some browsers keep the caller until they are closed
        threading.Thread(target=webbrowser.open, args=(server.url,), daemon=True).start()
    try:
        server.serve_forever(poll_interval=0.1)
    except KeyboardInterrupt:
        say("")
