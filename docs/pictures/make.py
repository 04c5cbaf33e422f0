"""Take the pictures of the replay page that docs/watch.md shows, in a real Chromium.

Run from the repository: ``python docs/pictures/make.py``. It needs Debian's chromium, playwright and Pillow.
"""

from __future__ import annotations

import io
import shutil
import tempfile
from pathlib import Path

from PIL import Image
from playwright.sync_api import Browser, Page, sync_playwright

from tasklift.building import generate
from tasklift.studies.study import Condition, Study
from tasklift.watch import page, replay
from tasklift.watch.sources import study_traces

HERE = Path(__file__).parent
ARMS = ("direct", "copy", "copy-prior")
STUDY = Study.every({"office": generate(seed=3)}, {"scattered": Condition()}, ARMS, seeds=1)


def traces(arms, trials):
    """Trace trials on the map and with the seed that all pictures show."""
    return study_traces(STUDY, condition="scattered", map="office", seed=0, arms=arms, trials=trials)


def open_page(browser: Browser, document, step: int, size: tuple[int, int], scheme: str, scale: float = 1) -> Page:
    """Open a replay, paused at a step."""
    tab = browser.new_page(
        viewport={"width": size[0], "height": size[1]}, color_scheme=scheme, device_scale_factor=scale
    )
    with tempfile.NamedTemporaryFile("w", suffix=".html", encoding="utf-8") as file:
        file.write(page(document))
        file.flush()
        tab.goto(f"{Path(file.name).as_uri()}#{step}")
        tab.wait_for_selector("#player", state="visible")
    return tab


def picture(tab: Page) -> Image.Image:
    """Take what is drawn once the next frame is."""
    tab.evaluate("() => new Promise((done) => requestAnimationFrame(() => requestAnimationFrame(done)))")
    return Image.open(io.BytesIO(tab.screenshot())).convert("RGB")


def save(tab: Page, name: str) -> None:
    """Write a picture and close its page."""
    picture(tab).save(HERE / name, lossless=True, method=4)
    tab.close()


def animate(browser: Browser, document) -> None:
    """The first 190 steps, without the column at the side."""
    tab = open_page(browser, document, 0, (1080, 610), "dark")
    wide = "aside { display: none !important } #player { grid: 'stage' 1fr 'foot' auto / 1fr !important }"
    tab.add_style_tag(content=wide)
    tab.evaluate("() => tasklift.layout()")
    times = [2 * i for i in range(96)]
    frames = []
    for time in times:
        tab.evaluate("(time) => tasklift.go(time)", time)
        frames.append(picture(tab))
    tab.close()
    frames[0].save(
        HERE / "three-arms.webp", save_all=True, append_images=frames[1:], loop=0, quality=55, method=3,
        duration=[120] * (len(frames) - 1) + [2500],
    )  # fmt: skip


def main() -> None:
    """Take them all."""
    arms = replay(traces(ARMS, [100]), "Three arms at trial 100")
    learning = replay(traces(["direct"], [1, 10, 50, 100]), "Direct learning at trials 1, 10, 50 and 100")
    flags = ["--no-sandbox", "--disable-gpu", "--no-first-run", "--disable-background-networking"]
    with sync_playwright() as driver:
        browser = driver.chromium.launch(executable_path=shutil.which("chromium"), args=flags)
        tab = open_page(browser, arms, 154, (1440, 860), "light")
        tab.evaluate("() => { tasklift.select(6); tasklift.look(2); }")
        save(tab, "watch-arms.webp")
        tab = open_page(browser, learning, 150, (1440, 860), "light")
        save(tab, "watch-learning.webp")
        one = replay(traces(["copy-prior"], [100]), "copy+prior at trial 100")
        tab = open_page(browser, one, 154, (1440, 860), "dark")
        tab.evaluate("() => { tasklift.select(6); document.getElementById('legend').open = true; }")
        save(tab, "watch-one.webp")
        tab = open_page(browser, arms, 154, (390, 844), "light", 2)
        save(tab, "watch-phone.webp")
        animate(browser, arms)
        browser.close()


if __name__ == "__main__":
    main()
