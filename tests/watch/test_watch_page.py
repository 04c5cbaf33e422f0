"""The replay page in a real Chromium: what it shows is the trace, what people press works, bad input is told.

Debian's package is enough (``apt-get install chromium``); without it, or without playwright, all is skipped.
"""

from __future__ import annotations

import base64
import copy
import dataclasses
import os
import re
import shutil
import signal
import subprocess
import sys
import time
import zlib

import numpy as np
import pytest
import shapely
from test_simulator import random_weights

from oracle import Oracle
from strategies import random_building
from tasklift.building import COHESIVE, SCOUT, WEAPON, Mission, Reading, generate
from tasklift.building.graph import ROOM
from tasklift.learning.reinforcement import Reinforcement, reinforce
from tasklift.plans.exporting import export
from tasklift.plans.importing import import_map
from tasklift.tasks.policy import Policy
from tasklift.watch import page, replay

playwright = pytest.importorskip("playwright.sync_api", reason="playwright is not installed: pip install playwright")
CHROMIUM = shutil.which("chromium") or shutil.which("chromium-browser") or shutil.which("google-chrome")
pytestmark = pytest.mark.skipif(CHROMIUM is None, reason="no Chromium here: apt-get install chromium")

FLAGS = [
    "--no-sandbox", "--disable-gpu", "--disable-quic", "--no-first-run", "--disable-background-networking",
    "--disable-component-update", "--disable-sync",
]  # fmt: skip
WIDE, PHONE = (1440, 900), (390, 844)


@pytest.fixture(scope="module")
def chromium():
    with playwright.sync_playwright() as driver:
        browser = driver.chromium.launch(executable_path=CHROMIUM, args=FLAGS)
        yield browser
        browser.close()


@pytest.fixture
def show(chromium, tmp_path):
    """Open a document, or the text of a page, paused at a step; afterwards nothing may have gone wrong."""
    contexts, complaints, requests = [], [], []

    def open_page(what, step=0, size=WIDE, **options):
        file = tmp_path / f"replay{len(contexts)}.html"
        file.write_text(what if isinstance(what, str) else page(what), "utf-8")
        contexts.append(chromium.new_context(viewport={"width": size[0], "height": size[1]}, **options))
        tab = contexts[-1].new_page()
        tab.on("console", lambda message: complaints.append(message.text))
        tab.on("pageerror", lambda error: complaints.append(str(error)))
        tab.on("request", lambda request: requests.append(request.url))
        tab.goto(f"{file.as_uri()}#{step}" if step is not None else file.as_uri())
        return tab

    yield open_page
    for context in contexts:
        context.close()
    assert complaints == []
    assert len(requests) == len(contexts), "the page fetched something"


def ready(tab):
    tab.wait_for_selector("#player", state="visible")
    return tab


def settle(tab):
    """Wait until what was asked for is drawn."""
    tab.evaluate("() => new Promise((done) => requestAnimationFrame(() => requestAnimationFrame(done)))")


def go(tab, step):
    tab.evaluate("(step) => tasklift.go(step)", step)
    settle(tab)


def stats(tab, panel=0):
    """The numbers under a panel, as a reader finds them."""
    found = tab.locator(".panel").nth(panel)
    return {
        item.get_attribute("data-stat"): item.inner_text().split()
        for item in found.locator("[data-stat]").all()
    } | {"chip": found.locator(".chip").inner_text()}


@pytest.fixture(scope="module")
def mission():
    return Mission(generate(seed=7), {SCOUT: 6, WEAPON: 4}, limit=250)


@pytest.fixture(scope="module")
def trace(mission):
    learned = reinforce(mission, Policy.equal(mission.task, 1.5), trials=20, seed=0).policy
    traces = (mission.simulator.trace(learned, seed=0, trial=trial) for trial in range(20, 120))
    return next(t for t in traces if t.failed.any() and not t.hostile[-1].any())  # a loss, then revenge


@pytest.fixture(scope="module")
def document(trace):
    return replay([("direct", trace)], "A trial")


@pytest.fixture(scope="module")
def three():
    mission = Mission(generate(seed=7), {SCOUT: 6, WEAPON: 4}, limit=100)
    policy = Policy.equal(mission.task, 1.5)
    traces = [mission.simulator.trace(policy, seed=0, trial=trial) for trial in range(3)]
    return replay([(f"trial {i + 1}", t) for i, t in enumerate(traces)], "Three trials")


# --- the plan that the building was found in ------------------------------------------------------------------


@pytest.fixture(scope="module")
def planned(tmp_path_factory):
    """A trace in a building that was found in a plan; its first corridor is bent."""
    folder = tmp_path_factory.mktemp("plan")
    export(generate(seed=7), folder / "seven.yaml")
    building, _ = import_map(folder / "seven.yaml")
    bend = np.add(building.position_m[building.edges[0]].mean(axis=0, keepdims=True), [0.5, 0.2])
    building = dataclasses.replace(building, course_m=(bend, *building.course_m[1:]))
    mission = Mission(building, {SCOUT: 6, WEAPON: 4}, limit=60)
    return mission.simulator.trace(Policy.equal(mission.task, 1.5), seed=0, trial=0)


@pytest.mark.parametrize("size", [WIDE, PHONE])
def test_a_building_lies_on_its_plan(show, planned, size):
    """Rooms have the floor that they have in the plan, and robots go along corridors as they run."""
    building, tab = planned.mission.building, ready(show(replay([("one", planned)], "plan"), step=60, size=size))
    boxes = dict(tab.evaluate("[...tasklift.panels[0].scene.plan.boxes]"))
    for room in np.flatnonzero(building.kind == ROOM).tolist():
        left, right, low, high = boxes[room]
        x, y = building.position_m[room]
        assert left < x < right
        assert low < y < high
        assert (right - left) * (high - low) == pytest.approx(building.area_m2[room], rel=0.15)
    line = tab.evaluate("tasklift.replay.building.lines[0]")
    assert np.allclose(line, building.line_m(0), atol=0.006)
    for share in (0.1, 0.8):
        there = shapely.LineString(building.line_m(0)).interpolate(share, normalized=True)
        at = tab.evaluate("([line, share]) => along(line, share)", [line, share])
        assert at == pytest.approx([there.x, there.y], abs=0.01)


def test_a_damaged_plan_is_named(show, planned):
    document = replay([("one", planned)], "plan")
    for href, part in (
        ("data:image/png;base64,AAAA", "damaged picture"),
        ("https://127.0.0.1/x.png", "expected a picture"),
    ):
        bad = copy.deepcopy(document)
        bad["building"]["plan"]["href"] = href
        tab = show(bad)
        tab.wait_for_selector("#message", state="visible")
        assert part in tab.locator("#message").inner_text()


# --- what it shows is the trace --------------------------------------------------------------------------------


def place_m(trace, robot, frame):
    """Where a robot is, from the trace and the building alone."""
    building, record = trace.mission.building, trace.robots[frame, robot]
    if record["half"] < 0:
        return building.position_m[record["node"]]
    origin = building.position_m[record["node"]]
    target = building.position_m[building.neighbour[record["half"]]]
    cost = trace.mission.simulator.world.halves["cost_mm"][record["half"]]
    return origin + (target - origin) * record["progress"] / cost


def standing(trace, hostile, frame):
    robots = trace.robots[frame]
    if not trace.hostile[frame, hostile]:
        return "destroyed"
    if trace.failed[: frame + 1, hostile].any():
        return "known"
    about = (robots["alive"] == 1) & (robots["dl"] > 0) & (robots["alert"] == hostile)
    return "suspected" if about.any() else "hidden"


def test_numbers_positions_and_states_are_those_of_the_trace(show, trace, document):
    tab = ready(show(document))
    building, last = trace.mission.building, trace.steps
    rooms = np.flatnonzero(building.kind == 0)
    told = [frame for at in np.argwhere(trace.failed)[:3, 0].tolist() for frame in (at - 1, at)]
    for frame in sorted({0, 1, 2, 17, last // 3, last // 2, last - 1, last, *told}):
        go(tab, frame)
        robots, alive = trace.robots[frame], trace.robots["alive"][frame] == 1
        share = trace.visited[frame].mean()
        shown = stats(tab)
        assert shown["explored"][0] == (f"{100 * share:.1f}" if 0 < share < 0.1 else str(int(100 * share + 0.5)))
        kinds = [span.inner_text() for span in tab.locator("[data-stat=robots] [data-kind]").all()]
        assert kinds == [str(alive[:6].sum()), str(alive[6:].sum())]
        places = {(r["node"], r["half"], r["progress"]) for r in robots[alive]}
        assert shown["teams"] == [str(len(places))]
        assert shown["losses"] == [str(trace.losses[frame])]
        assert shown["messages"] == [str(trace.messages[frame])]
        assert shown["searched"] == [str((trace.unsearched[frame, rooms] == 0).sum()), "of", str(len(rooms))]
        assert shown["hostiles"] == [str(trace.hostile[frame].sum())]
        assert f"step {frame}" in tab.locator("#step").inner_text()

        drawn = tab.evaluate("""() => { const { scene, trace } = tasklift.panels[0];
          return scene.drawn.map(({ r, x, y }) => ({ r, x, y, to: [scene.view.x + (x - scene.width / 2) / scene.k,
            scene.view.y - (y - scene.height / 2) / scene.k],
            team: trace.teams[scene.frame][trace.team[scene.frame * trace.R + r]].length,
            reach: 2 * scene.size() * cluster(trace.R).radius / scene.k,
            level: trace.at("danger", r, scene.frame) })) }""")
        assert [d["r"] for d in drawn] == np.flatnonzero(alive).tolist()
        for robot in drawn:
            away = np.hypot(*(place_m(trace, robot["r"], frame) - robot["to"]))
            assert away < (1e-6 if robot["team"] == 1 else robot["reach"])
            assert robot["level"] == robots["dl"][robot["r"]]
        hostiles = tab.evaluate("""() => { const { scene, trace } = tasklift.panels[0];
          return trace.hostiles.map((h) => [h.node, trace.standing(h, scene.frame)]) }""")
        assert hostiles == [[int(h), standing(trace, h, frame)] for h in np.flatnonzero(trace.hostile[0])]
    assert shown["chip"] == (f"done in {last} steps" if trace.success else "out of time")


def test_between_steps_robots_are_on_the_straight_line(show, document):
    tab = ready(show(document))
    middle, ends = tab.evaluate("""() => { const { scene } = tasklift.panels[0], at = (time) => {
      scene.draw(time); return scene.drawn.map(({ r, x, y }) => [r, x, y]) };
      return [at(30.25), [at(30), at(31)]] }""")
    assert np.ptp(np.subtract(ends[1], ends[0])[:, 1:]) > 0
    assert np.allclose(middle, 0.75 * np.array(ends[0]) + 0.25 * np.array(ends[1]))


def test_what_is_known_is_lit_and_the_rest_dim_in_whatever_order_one_looks(show, trace, document):
    tab = ready(show(document))
    lit, dim = tab.evaluate("""() => ["floor", "ghost-floor"].map((name) => {
      const pen = new OffscreenCanvas(1, 1).getContext("2d"); pen.fillStyle = palette[name]; pen.fillRect(0, 0, 1, 1);
      return [...pen.getImageData(0, 0, 1, 1).data].join() })""")
    building = trace.mission.building
    toggles = tab.evaluate("() => tasklift.panels[0].trace.changes")  # compared with the oracle below
    for frame in (40, trace.steps, 12, 41, 41, 90, 0):
        go(tab, frame)
        colours = tab.evaluate("""() => {
          const { scene, trace } = tasklift.panels[0], b = trace.building, { width, height } = scene.shown;
          const pen = new OffscreenCanvas(width, height).getContext("2d", { willReadFrequently: true });
          pen.drawImage(scene.shown, 0, 0);
          return b.edges.map(([p, q]) => {
            const [x, y] = scene.toScreen(...[0, 1].map((i) => (b.position[p][i] + b.position[q][i]) / 2));
            return [...pen.getImageData(Math.round(x), Math.round(y), 1, 1).data].join() }) }""")
        known = np.zeros(building.n_edges, bool)
        for changed in toggles[: frame + 1]:
            known[changed] ^= True
        for edge, (a, b) in enumerate(building.edges):
            if building.length_m[edge] < 6 or 0 in (building.kind[a], building.kind[b]):
                continue  # lit by its neighbours, or within a room
            assert (colours[edge] == lit) == known[edge]
            assert (colours[edge] == dim) == (not trace.visited[frame, edge])


class Witness(Oracle):
    """The oracle, telling the weights of every draw."""

    def draw_output(self, robot, row):
        self.draws[self.steps + 1, robot.number] = list(self.weights[row])
        return super().draw_output(robot, row)


CASES = [
    (Reading(), Reinforcement()),
    (Reading(share_map="radio", patience=5), Reinforcement(loss_signal=-0.5, floor=0.25)),
    (Reading(share_map="none", engage="crossing"), Reinforcement(credit="trial", loss_signal=-0.5)),
    (Reading(decide="team", split="team", patience=7), Reinforcement(selection="pseudo-random", q=0.5)),
    (Reading(drill=True), Reinforcement(loss_signal=-0.5)),
    (
        Reading(drill=True, engage="crossing", alert_range_m=25.0),
        Reinforcement(loss_signal=-0.5, selection="exploitation"),
    ),
    (COHESIVE, Reinforcement(time_signal="baseline")),
]


@pytest.mark.parametrize("case", range(len(CASES)))
def test_the_page_follows_maps_and_weights_as_the_oracle_has_them(show, case):
    reading, rules = CASES[case]
    rng = np.random.default_rng(case)
    building = random_building(rng, 22)
    doors = np.flatnonzero(building.feature_class > 1)[:3]
    mission = Mission(building, {SCOUT: 5, WEAPON: 4}, tuple(doors.tolist()), reading, limit=70)
    task = mission.task
    weights = np.maximum(random_weights(rng, task.shape), rules.floor)
    trace = mission.simulator.trace(Policy(task, weights, {}), seed=case, trial=2, reinforcement=rules)

    oracle = Witness(
        mission, weights.tolist(), [task.output_values(a) for a in range(44)],
        lambda seen: task.input_index({v.name: v.values[seen[v.name]] for v in task.inputs}),
        task.signal_table().tolist(), rules,
    )  # fmt: skip
    oracle.draws = {}
    oracle.begin(case, 2, 2)
    known, learned = [[]], [[set(robot.map) for robot in oracle.robots]]
    while oracle.status() == "on":
        oracle.step()
        known.append(sorted(set().union(*(robot.map for robot in oracle.living))))
        learned.append([set(robot.map) for robot in oracle.robots])
    assert trace.steps == oracle.steps

    tab = ready(show(replay([("case", trace)], "Maps and weights")))
    shown = tab.evaluate("""() => { const { trace } = tasklift.panels[0], known = new Set(), all = [];
      for (const changed of trace.changes) {
        for (const e of changed) known.delete(e) || known.add(e);
        all.push([...known].sort((a, b) => a - b)); }
      return all }""")
    assert shown == known
    told = tab.evaluate("() => [...tasklift.panels[0].trace.learned]")
    for robot, first in enumerate(np.reshape(told, (9, building.n_edges))):
        for edge, frame in enumerate(first):
            assert frame == next((t for t, maps in enumerate(learned) if edge in maps[robot]), -1)

    asked = [list(key) for key in oracle.draws]
    answers = tab.evaluate("""(asked) => asked.map(([t, r]) => { const d = tasklift.panels[0].trace.decision(r, t);
      return { frame: d.frame, drawer: d.drawer, weights: [...d.weights], p: d.probabilities[d.output],
        sum: d.probabilities.reduce((a, b) => a + b, 0) } })""", asked)
    assert len(answers) >= 10
    for (frame, robot), answer in zip(asked, answers, strict=True):
        assert (answer["frame"], answer["drawer"]) == (frame, robot)
        assert answer["weights"] == oracle.draws[frame, robot]
        assert answer["sum"] == pytest.approx(1)
        assert answer["p"] > 0
    if reading.decide == "team":
        others = tab.evaluate("""() => { const { trace } = tasklift.panels[0], found = [];
          for (let r = 0; r < trace.R; r++) for (let t = 1; t < trace.F; t++)
            if (trace.alive(r, t) && trace.at("decided", r, t) === 2) found.push([r, t, trace.decision(r, t).drawer]);
          return found }""")
        assert others
        assert all((frame, drawer) in oracle.draws and drawer < robot for robot, frame, drawer in others)


def test_the_probabilities_are_the_policys(show, mission):
    policy = Policy(mission.task, np.random.default_rng(1).uniform(0, 3, mission.task.shape), {})
    trace = mission.simulator.trace(policy, seed=1, learn=False)
    tab = ready(show(replay([("fixed", trace)], "Fixed"), step=9))
    tab.evaluate("() => tasklift.select(2)")
    settle(tab)
    row = int(trace.robots["pair_row"][9, 2])
    bars = [float(cell.get_attribute("data-chance")) for cell in tab.locator("[data-chance]").all()]
    assert bars == pytest.approx(policy.probabilities(row).tolist())
    drawn = mission.task.output_values(int(trace.robots["out"][9, 2]))
    labels = {v.name: v.labels for v in mission.task.outputs}
    for name, value in drawn.items():
        shown = tab.locator(f"[data-output='{name}'] dd").inner_text()
        assert shown == (labels[name][int(value)] if labels[name] else str(value))


# --- what people press works -----------------------------------------------------------------------------------


def now(tab):
    settle(tab)
    return tab.evaluate("() => tasklift.time")


def test_it_plays_to_the_end_and_from_the_beginning(show, three):
    tab = ready(show(three))
    last = tab.evaluate("() => tasklift.last")
    tab.select_option("#speed", "64")
    tab.click("#play")
    tab.wait_for_selector("body.playing")
    assert tab.locator("#play").get_attribute("aria-label") == "Pause"
    tab.wait_for_selector("body:not(.playing)", timeout=60_000)
    assert now(tab) == last
    for panel in range(3):
        assert "step" not in stats(tab, panel)["chip"].split()[:1]
    tab.keyboard.press("Space")
    tab.wait_for_selector("body.playing")
    assert now(tab) < last
    tab.keyboard.press("Space")
    tab.wait_for_selector("body:not(.playing)")


def test_the_command_serves_it_and_the_browser_asks_for_nothing_else(chromium, tmp_path):
    generate(seed=7).save(tmp_path / "office.json")
    options = "--arms direct --trial 1 --limit 30 --no-open"
    process = subprocess.Popen(
        [sys.executable, "-c", "from tasklift.cli.main import main; main()", "watch", "office.json", *options.split()],
        cwd=tmp_path, stdout=subprocess.PIPE, text=True, env=os.environ | {"PYTHONUNBUFFERED": "1"},
    )  # fmt: skip
    try:
        url = re.search(r"http://127\.0\.0\.1:\d+/", process.stdout.readline())[0]
        tab, seen = chromium.new_page(), []
        tab.on("console", lambda message: seen.append(message.text))
        tab.on("pageerror", lambda error: seen.append(str(error)))
        tab.on("request", lambda request: seen.append(request.url))
        tab.goto(url)
        ready(tab).wait_for_selector("body.playing")
        assert tab.locator(".panel .label").inner_text() == "direct"
        tab.close()
        assert seen == [url]
    finally:
        process.send_signal(signal.SIGINT)
        process.communicate(timeout=30)
    assert process.returncode == 0


def test_it_starts_by_itself_unless_asked_to_move_less(show, three):
    tab = ready(show(three, step=None))
    tab.wait_for_selector("body.playing")
    tab = ready(show(three, step=None, reduced_motion="reduce"))
    assert now(tab) == 0


def test_keyboard(show, document):
    tab = ready(show(document, step=20))
    last = tab.evaluate("() => tasklift.last")
    for key, step in (
        ("ArrowRight", 21), ("ArrowLeft", 20), ("Shift+ArrowRight", 30), ("Shift+ArrowLeft", 20), ("End", last),
        ("ArrowRight", last), ("Home", 0), ("ArrowLeft", 0),
    ):  # fmt: skip
        tab.keyboard.press(key)
        assert now(tab) == step, key
    speed = tab.locator("#speed")
    for key, value in (("+", "16"), ("=", "32"), ("-", "16")):
        tab.keyboard.press(key)
        assert speed.input_value() == value
    tab.keyboard.press("]")
    events = tab.evaluate("() => tasklift.log.events.map((e) => e.t)")
    assert now(tab) == events[0]
    tab.keyboard.press("]")
    tab.keyboard.press("[")
    assert now(tab) == events[0]
    for key, robot in (("n", 0), ("n", 1), ("p", 0), ("p", 9), ("Escape", -1)):
        tab.keyboard.press(key)
        assert tab.evaluate("() => tasklift.selected") == robot
    tab.keyboard.press("?")
    assert tab.locator("#keys").is_visible()
    tab.keyboard.press("ArrowRight")
    assert now(tab) == events[0]
    tab.keyboard.press("Escape")
    assert not tab.locator("#keys").is_visible()


def test_buttons_scrubber_and_timeline(show, three):
    tab = ready(show(three, step=20))
    last = tab.evaluate("() => tasklift.last")
    for button, step in (("#forward", 21), ("#back", 20), ("#to-end", last), ("#to-start", 0)):
        tab.click(button)
        assert now(tab) == step, button
    tab.locator("#scrub").fill("33")
    assert now(tab) == 33
    box = tab.locator(".row canvas").nth(1).bounding_box()
    tab.mouse.click(box["x"] + 6 + (box["width"] - 12) * 0.5, box["y"] + 2)
    assert abs(now(tab) - last / 2) <= 6 * last / box["width"] + 1
    assert tab.evaluate("() => tasklift.panels.indexOf(tasklift.active)") == 1
    tab.keyboard.press("3")
    assert tab.evaluate("() => tasklift.panels.indexOf(tasklift.active)") == 2


def test_every_event_is_a_click_away_and_filters_hide_kinds(show, trace, document):
    tab = ready(show(document))
    assert tab.locator("#events button").filter(has_text="splits").count() == 0  # until somebody asks for them
    tab.click("#filters [data-type=split]")
    button = tab.locator("#events button").filter(has_text="splits").first
    step = int(button.get_attribute("data-step"))
    button.click()
    assert now(tab) == step
    counts = tab.evaluate("() => Object.groupBy(tasklift.panels[0].trace.events, (e) => e.type)")
    died = trace.robots["alive"][:-1].astype(int) - trace.robots["alive"][1:]
    lost = {(t + 1, int(trace.robots["node"][t + 1, r])) for t, r in np.argwhere(died == 1)}
    assert {(e["t"], e["node"]) for e in counts.get("loss", [])} == lost
    assert {(e["t"], e["node"]) for e in counts.get("attack", []) if "fails" in e["text"]} == {
        (t, n) for t, n in np.argwhere(trace.failed).tolist()
    }
    cleared = np.flatnonzero(trace.resolved[-1] & ~trace.hostile[0]).tolist()
    assert sorted(e["node"] for e in counts["cleared"]) == cleared
    alerted = (trace.robots["dl"][1:] == 1) & (trace.robots["dl"][:-1] == 0) & (trace.robots["alive"][:-1] == 1)
    assert sum(len(e["robots"]) for e in counts.get("alert", [])) == alerted.sum()
    tab.click("#filters [data-type=split]")
    settle(tab)
    assert tab.locator("#events button").filter(has_text="splits").count() == 0


def test_a_click_on_a_robot_tells_why_it_moved(show, trace, document):
    step = 25
    tab = ready(show(document, step=step))
    settle(tab)
    spot = tab.evaluate("() => tasklift.panels[0].scene.drawn.find(({ r }) => r === 3)")
    box = tab.locator(".plan canvas").last.bounding_box()
    tab.mouse.click(box["x"] + spot["x"], box["y"] + spot["y"])
    settle(tab)
    chosen = tab.evaluate("() => tasklift.selected")
    beside = tab.evaluate("([x, y]) => tasklift.panels[0].scene.robotAt(x, y)", [spot["x"], spot["y"]])
    assert chosen == beside
    told = trace.mission.task.input_values(int(trace.robots["row"][step, chosen]))
    labels = {v.name: v.labels for v in trace.mission.task.inputs}
    for variable in trace.mission.task.inputs:
        shown = tab.locator(f"[data-input='{variable.name}'] dd").inner_text()
        assert shown == labels[variable.name][variable.values.index(told[variable.name])]
    assert "Drawn with" in tab.locator("#inspector").inner_text()
    tab.mouse.click(box["x"] + 3, box["y"] + 3)
    settle(tab)
    assert tab.evaluate("() => tasklift.selected") == -1


def test_the_wheel_zooms_and_dragging_moves(show, document):
    tab = ready(show(document, step=5))
    box = tab.locator(".plan").bounding_box()
    tab.mouse.move(box["x"] + 200, box["y"] + 200)
    before = tab.evaluate("() => tasklift.panels[0].scene.toScreen(0, 0)")
    tab.mouse.wheel(0, -400)
    settle(tab)
    assert tab.evaluate("() => tasklift.view.zoom") > 1.5
    tab.mouse.down()
    tab.mouse.move(box["x"] + 260, box["y"] + 230, steps=4)
    tab.mouse.up()
    settle(tab)
    tab.keyboard.press("0")
    settle(tab)
    assert tab.evaluate("() => tasklift.panels[0].scene.toScreen(0, 0)") == pytest.approx(before)


# --- both kinds of windows -------------------------------------------------------------------------------------


@pytest.mark.parametrize("size", [(1280, 640), (1024, 768), (900, 900)])
def test_plans_side_by_side_have_one_scale(show, three, size):
    document = copy.deepcopy(three)
    document["traces"][2]["label"] = "an arm whose name is so long that the head of its panel wraps at any width"
    tab = ready(show(document, step=40, size=size))
    heads, plans = tab.evaluate("""() => ["header", ".plan"].map((part) => tasklift.panels.map(({ element }) => {
      const { width, height } = element.querySelector(part).getBoundingClientRect();
      return [width, height];
    }))""")
    assert np.ptp(np.round(plans), axis=0).max() <= 1, plans
    assert max(height for _, height in heads) > 1.5 * 24, "no head wrapped: the test shows nothing"


@pytest.mark.parametrize("size", [WIDE, PHONE], ids=["wide", "phone"])
@pytest.mark.parametrize("scheme", ["light", "dark"])
def test_everything_fits_the_window(show, three, size, scheme):
    tab = ready(show(three, step=40, size=size, color_scheme=scheme))
    settle(tab)
    assert tab.evaluate("() => document.documentElement.scrollWidth") <= size[0]
    assert tab.evaluate("() => document.documentElement.scrollHeight") <= size[1] or size == PHONE
    for control in ("#play", "#forward", "#speed", "#step", "#rows canvas"):
        box = tab.locator(control).first.bounding_box()
        assert box["x"] >= 0
        assert box["x"] + box["width"] <= size[0] + 0.5, control
        assert box["y"] + box["height"] <= size[1], control
    for panel in tab.locator(".panel").all():
        box = panel.locator(".plan").bounding_box()
        assert min(box["width"], box["height"]) > 200
    colours = tab.evaluate("""() => tasklift.panels.map(({ scene }) => [scene.shown, scene.canvas].map((canvas) => {
      const { data } = canvas.getContext("2d").getImageData(0, 0, canvas.width, canvas.height), seen = new Set();
      for (let i = 0; i < data.length; i += 4)
        if (data[i + 3] > 250) seen.add(data[i] << 16 | data[i + 1] << 8 | data[i + 2]);
      return seen.size }))""")
    assert all(plan > 5 and things > 5 for plan, things in colours)
    inside = tab.evaluate("""() => tasklift.panels.every(({ scene }) =>
      scene.drawn.every(({ x, y }) => x > 0 && y > 0 && x < scene.width && y < scene.height))""")
    assert inside


def test_on_a_phone_a_robot_answers_below_its_panel(show, three):
    tab = ready(show(three, step=25, size=PHONE, has_touch=True))
    settle(tab)
    canvas = tab.locator(".plan canvas").nth(3)
    canvas.scroll_into_view_if_needed()
    spot = tab.evaluate("() => tasklift.panels[1].scene.drawn[4]")
    canvas.tap(position={"x": spot["x"], "y": spot["y"]})
    settle(tab)
    assert tab.evaluate("() => [tasklift.panels.indexOf(tasklift.active), tasklift.selected >= 0]") == [1, True]
    below = tab.locator(".panel").nth(1).locator("+ #inspector")
    assert "What it senses" in below.inner_text()
    tab.set_viewport_size({"width": WIDE[0], "height": WIDE[1]})
    tab.wait_for_selector("aside > #inspector")


# --- bad input -------------------------------------------------------------------------------------------------


def repack(packed, values):
    raw = np.ascontiguousarray(values).astype(packed["type"])
    return packed | {"data": base64.b64encode(zlib.compress(raw.tobytes())).decode()}


def broken(document, what):
    bad = copy.deepcopy(document)
    trace = bad["traces"][0]
    arrays = trace["arrays"]
    if what == "another version":
        bad["version"] = 2
    elif what == "another format":
        bad["format"] = "tasklift-policy"
    elif what == "no trace":
        bad["traces"] = []
    elif what == "cut array":
        arrays["place"]["data"] = arrays["place"]["data"][: len(arrays["place"]["data"]) // 8 * 4]
    elif what == "no base64":
        arrays["place"]["data"] = "!" + arrays["place"]["data"]
    elif what == "not a number":
        shape = arrays["weights"]["shape"]
        arrays["weights"] = repack(arrays["weights"], np.full(shape, np.nan))
    elif what == "place outside":
        arrays["place"] = repack(arrays["place"], np.full(arrays["place"]["shape"], 10**6))
    elif what == "too short":
        arrays["progress"] = repack(arrays["progress"], np.zeros(3))
    elif what == "too long":
        arrays["progress"] = repack(arrays["progress"], np.zeros(10**6))
    elif what == "missing array":
        del arrays["pair"]
    elif what == "missing building":
        del bad["building"]
    elif what == "position as text":
        bad["building"]["position_m"][3] = ["0", 1]
    elif what == "edge to nowhere":
        bad["building"]["edges"][0] = [0, 9999]
    elif what == "no task":
        trace["task"] = 7
    elif what == "task without variables":
        bad["tasks"][0]["inputs"] = None
    elif what == "hostile nowhere":
        trace["hostiles"] = [[-5, 3]]
    elif what == "frames":
        trace["frames"] = 1e9
    return bad


BROKEN = {
    "another version": "version 2", "another format": "expected the format tasklift-replay", "no trace": "no trace",
    "cut array": "damaged or cut short", "no base64": "damaged or cut short", "not a number": "NaN",
    "place outside": "1000000 is not from 0", "too short": "damaged or cut short", "too long": "damaged or cut short",
    "missing array": "missing", "missing building": "building", "position as text": "position",
    "edge to nowhere": "9999", "no task": "task is missing", "task without variables": "task is damaged",
    "hostile nowhere": "hostile",
    "frames": "frames",
}  # fmt: skip


@pytest.mark.parametrize("what", BROKEN)
def test_damaged_replays_are_told_in_the_page(show, document, what):
    tab = show(broken(document, what))
    tab.wait_for_selector("#message", state="visible")
    deadline = time.monotonic() + 10
    while "cut short, or JavaScript is off" in tab.locator("#message").inner_text() and time.monotonic() < deadline:
        tab.wait_for_timeout(20)
    assert BROKEN[what] in tab.locator("#message").inner_text()
    assert not tab.locator("#player").is_visible()


@pytest.mark.parametrize("share", [0.3, 0.6, 0.9, 0.999])
def test_a_page_that_was_cut_short_says_so(show, document, share):
    whole = page(document)
    tab = show(whole[: int(len(whole) * share)])
    assert "cut short" in tab.locator("#message").inner_text()
    assert not tab.locator("#player").is_visible()


def test_markup_in_names_is_text(show, document):
    nasty = "</script><script>window.bad=1</script><img src=x onerror='window.bad=1'>{{data}}"
    bad = copy.deepcopy(document)
    bad["title"] = bad["building"]["name"] = nasty
    bad["traces"][0]["label"] = bad["kinds"][0]["name"] = nasty
    bad["building"]["class_names"] = {"2": nasty, "3": nasty, "4": nasty, "5": nasty}
    for variable in bad["tasks"][0]["inputs"] + bad["tasks"][0]["outputs"]:
        variable["meaning"] = variable["name"] = nasty
        variable["labels"] = [nasty] * len(variable["labels"])
    tab = ready(show(bad, step=30))
    tab.evaluate("() => tasklift.select(0)")
    settle(tab)
    assert tab.locator("h1").inner_text() == nasty
    assert tab.title() == nasty
    assert tab.evaluate("() => window.bad") is None
    assert tab.locator("img").count() == 0
    assert nasty in tab.locator("#inspector").inner_text()
    assert tab.evaluate("() => document.documentElement.scrollWidth") <= WIDE[0]
