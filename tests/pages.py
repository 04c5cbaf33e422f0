"""How large a page is for its reader: bytes, and height in screens, wide and on a phone.

``python tests/pages.py report.html [more.html ...]`` prints a line for each page; with ``--pictures FOLDER`` it also
keeps a picture of each. It needs playwright, and Chromium on the path.
"""

from __future__ import annotations

import argparse
import shutil
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

FLAGS = ["--no-sandbox", "--disable-gpu", "--no-first-run", "--disable-background-networking"]
SIZES = {"wide": (1440, 900), "phone": (390, 844)}
MOST_SCREENS, MOST_BYTES = 6.0, 1_000_000


@dataclass(frozen=True)
class Measured:
    """A page's bytes; by size of the window its height and overflow (px), and its height in screens."""

    bytes: int
    height: dict[str, int]
    overflow: dict[str, int]

    def screens(self, size: str) -> float:
        """Height in screens, folds closed."""
        return self.height[size] / SIZES[size][1]


def chromium() -> str | None:
    """Return where Chromium is, or None."""
    return shutil.which("chromium") or shutil.which("chromium-browser") or shutil.which("google-chrome")


@contextmanager
def browser() -> Iterator[Any]:
    """Start Chromium."""
    from playwright.sync_api import sync_playwright

    with sync_playwright() as driver:
        started = driver.chromium.launch(executable_path=chromium(), args=FLAGS)
        yield started
        started.close()


def measure(started: Any, path: Path, pictures: Path | None = None) -> Measured:
    """Open a page in windows of both sizes; return what is measured. A message on the console is an error."""
    height, overflow = {}, {}
    for name, (width, tall) in SIZES.items():
        context = started.new_context(viewport={"width": width, "height": tall})
        tab, complaints = context.new_page(), []
        tab.on("console", lambda message, to=complaints: to.append(message.text))
        tab.on("pageerror", lambda error, to=complaints: to.append(str(error)))
        tab.goto(path.resolve().as_uri())
        height[name] = tab.evaluate("document.documentElement.scrollHeight")
        overflow[name] = tab.evaluate("document.documentElement.scrollWidth") - width
        if pictures is not None:
            pictures.mkdir(exist_ok=True)
            tab.screenshot(path=pictures / f"{path.parent.name}-{path.stem}-{name}.png", full_page=True)
        context.close()
        assert complaints == [], f"{path}, {name}: {complaints}"
    return Measured(path.stat().st_size, height, overflow)


def main() -> None:
    """Print what is measured of each page."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("pages", nargs="+", type=Path)
    parser.add_argument("--pictures", type=Path)
    asked = parser.parse_args()
    with browser() as started:
        for path in asked.pages:
            found = measure(started, path, asked.pictures)
            sizes = ", ".join(f"{name} {found.height[name]} px = {found.screens(name):.1f} screens" for name in SIZES)
            print(f"{path}: {found.bytes / 1e6:.2f} MB; {sizes}")


if __name__ == "__main__":
    main()
