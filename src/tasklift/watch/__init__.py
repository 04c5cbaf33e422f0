"""Watching robots: trials as compact replay documents, and the page that plays them in a browser."""

from tasklift.watch.document import read, replay
from tasklift.watch.html import page

__all__ = ["page", "read", "replay"]
