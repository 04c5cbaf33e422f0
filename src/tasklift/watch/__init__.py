"""Watching robots: trials as compact replay documents, and the page that plays them in a browser."""

from tasklift.watch.page import page
from tasklift.watch.replay import read, replay

__all__ = ["page", "read", "replay"]
