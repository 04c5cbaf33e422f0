"""The site builds without a warning, and every page can be read: wide, on a phone, by keyboard, by a screen reader."""

from __future__ import annotations

import shutil
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

import pytest

pytest.importorskip("mkdocs", reason="the extra 'docs' is not installed: make docs")
axe_playwright = pytest.importorskip("axe_playwright_python.sync_playwright")
playwright = pytest.importorskip("playwright.sync_api")
CHROMIUM = shutil.which("chromium") or shutil.which("chromium-browser") or shutil.which("google-chrome")
ROOT = Path(__file__).parents[2]
pytestmark = [pytest.mark.slow, pytest.mark.skipif(CHROMIUM is None, reason="no Chromium")]

WIDE_TABLES = """() => [...document.querySelectorAll('article table')].filter(
    (table) => table.getBoundingClientRect().width > table.parentElement.clientWidth + 1
).map((table) => table.innerText.slice(0, 60))"""

BROKEN_NAMES = """() => [...document.querySelectorAll('article td:first-child code')].filter(
    (name) => /^["\\w=.]+$/.test(name.textContent) && name.getClientRects().length > 1
).map((name) => name.textContent)"""


@pytest.fixture(scope="module")
def site(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("site")
    command = [sys.executable, "-m", "mkdocs", "build", "--strict", "--quiet", "--site-dir", str(folder)]
    done = subprocess.run(command, cwd=ROOT, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    return folder


@pytest.fixture(scope="module")
def browser() -> Iterator[playwright.Browser]:
    with playwright.sync_playwright() as driver:
        browser = driver.chromium.launch(executable_path=CHROMIUM, args=["--no-sandbox", "--disable-gpu"])
        yield browser
        browser.close()


def test_every_page_passes_axe_and_no_table_is_wider_than_its_column(site: Path, browser: playwright.Browser) -> None:
    axe, faults = axe_playwright.Axe(), []
    pages = [page for page in sorted(site.rglob("*.html")) if page.name != "404.html" and page.parent.name != "replays"]
    assert len(pages) > 60
    tab = browser.new_page(viewport={"width": 1440, "height": 900})
    for page in pages:
        tab.goto(page.as_uri())
        name = page.relative_to(site)
        faults += [f"{name}: wide table {table!r}" for table in tab.evaluate(WIDE_TABLES)]
        found = axe.run(tab, options={"iframes": False}).response["violations"]
        faults += [f"{name}: {rule['id']}: {rule['nodes'][0]['html'][:120]}" for rule in found]
    assert faults == []


def test_no_page_is_wider_than_a_phone_nor_breaks_the_names_in_its_tables(
    site: Path, browser: playwright.Browser
) -> None:
    tab = browser.new_page(viewport={"width": 390, "height": 844})
    for page in sorted(site.glob("*.html")):
        tab.goto(page.as_uri())
        assert tab.evaluate("document.documentElement.scrollWidth") <= 390, page.name
        assert tab.evaluate(BROKEN_NAMES) == [], page.name


def test_the_home_page_plays_a_replay(site: Path, browser: playwright.Browser) -> None:
    tab = browser.new_page(viewport={"width": 1440, "height": 900})
    tab.goto((site / "index.html").as_uri())
    tab.wait_for_selector("iframe.replay")
    (frame,) = [frame for frame in tab.frames if frame.url.endswith("replays/home.html")]
    frame.wait_for_selector("#player", state="visible")
    before = frame.evaluate("tasklift.time")
    tab.wait_for_timeout(1000)
    assert frame.evaluate("tasklift.time") > before
    # it can be seen without scrolling
    assert tab.locator("iframe.replay").bounding_box()["y"] < 450
