"""Frames per second of the replay page in Chromium, with 500 robots on 1,000 nodes, and the size of traces.

Needs Debian's chromium and playwright. Headless, without a graphics card, everything is drawn by the processor: a
desktop browser is faster. Milliseconds are processor time of the page's main thread per frame; 16.7 leave room for
60 frames a second.
"""

from __future__ import annotations

import json
import shutil
import tempfile
from pathlib import Path

from playwright.sync_api import sync_playwright

from tasklift.building import SCOUT, WEAPON, Mission, generate
from tasklift.tasks.policy import Policy
from tasklift.watch import page, replay

PLAY = """async (start) => {
  tasklift.go(start);
  tasklift.toggle();
  const begun = performance.now();
  let frames = 0;
  await new Promise((done) => {
    const next = () => {
      frames++;
      performance.now() - begun < 4000 ? requestAnimationFrame(next) : done();
    };
    requestAnimationFrame(next);
  });
  tasklift.pause();
  return [frames, performance.now() - begun];
}"""


def document(building, team, hostiles):
    """Trace one trial of even chances; say how large it is."""
    mission = Mission(building, team, hostiles=hostiles)
    trace = mission.simulator.trace(Policy.equal(mission.task), seed=0)
    made = replay([("direct", trace)], "benchmark")
    print(
        f"{mission.n_robots} robots, {trace.steps} steps, {building.n_nodes} nodes: trace "
        f"{len(json.dumps(made['traces'])) / 1000:.0f} KB, building {len(json.dumps(made['building'])) / 1000:.0f} KB"
    )
    return made


def play(made):
    """Play stretches of the trial at 8 steps per second."""
    with sync_playwright() as driver, tempfile.TemporaryDirectory() as folder:
        file = Path(folder) / "replay.html"
        file.write_text(page(made), "utf-8")
        flags = ["--no-sandbox", "--disable-gpu", "--no-first-run", "--disable-background-networking"]
        browser = driver.chromium.launch(executable_path=shutil.which("chromium"), args=flags)
        tab = browser.new_page(viewport={"width": 1440, "height": 900})
        tab.goto(f"{file.as_uri()}#0")
        tab.wait_for_selector("#player", state="visible")
        metrics = tab.context.new_cdp_session(tab)
        metrics.send("Performance.enable", {"timeDomain": "threadTicks"})

        def busy_s():
            found = metrics.send("Performance.getMetrics")["metrics"]
            return next(m["value"] for m in found if m["name"] == "TaskDuration")

        for start in (0, 150, 300, 450):
            before = busy_s()
            frames, milliseconds = tab.evaluate(PLAY, start)
            work_ms = 1000 * (busy_s() - before) / frames
            print(f"from step {start}: {1000 * frames / milliseconds:.0f} frames/s, {work_ms:.1f} ms a frame")
        browser.close()


def main():
    """Print sizes, then frames per second."""
    document(generate(seed=4), {SCOUT: 10, WEAPON: 5}, 3)
    large = generate(intersections=480, corridors=560, rooms=120, features=400, doors=100, seed=1)
    play(document(large, {SCOUT: 400, WEAPON: 100}, 5))


if __name__ == "__main__":
    if shutil.which("chromium") is None:
        print("no Chromium here: apt-get install chromium")
    else:
        main()
