"""``tasklift map edit --browser`` in a real Chromium: what is clicked becomes lines that apply, and is saved."""

from __future__ import annotations

import http.client
import json
import os
import re
import shutil
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

import tasklift
from tasklift.building.generate import generate
from tasklift.building.graph import DOOR, ROOM, Building
from tasklift.plans.edits import apply_edits, read_edits
from tasklift.plans.exporting import export
from tasklift.plans.importing import import_map

playwright = pytest.importorskip("playwright.sync_api", reason="playwright is not installed: pip install playwright")
CHROMIUM = shutil.which("chromium") or shutil.which("chromium-browser") or shutil.which("google-chrome")
FLAGS = ["--no-sandbox", "--disable-gpu", "--no-first-run", "--disable-background-networking"]


@pytest.fixture(scope="module")
def office(tmp_path_factory) -> Path:
    folder = tmp_path_factory.mktemp("editor")
    export(generate(seed=7), folder / "seven.yaml")
    import_map(folder / "seven.yaml", folder / "seven.json")
    return folder / "seven.json"


@pytest.fixture
def session(office, tmp_path):
    """The command, running; its address, the edits file and the corrected building."""
    edits, out = tmp_path / "my.edits", tmp_path / "out.json"
    command = [sys.executable, "-m", "tasklift", "map", "edit", str(office), str(edits), "-o", str(out)]
    env = os.environ | {"PYTHONPATH": str(Path(tasklift.__file__).parents[1]), "PYTHONUNBUFFERED": "1"}
    with subprocess.Popen([*command, "--browser", "--no-open"], stdout=subprocess.PIPE, text=True, env=env) as server:
        url = re.search(r"http://\S+", server.stdout.readline()).group()
        yield url, edits, out
        server.terminate()


@pytest.fixture
def tab(session):
    if CHROMIUM is None:
        pytest.skip("no Chromium here: apt-get install chromium")
    complaints = []
    with playwright.sync_playwright() as driver:
        browser = driver.chromium.launch(executable_path=CHROMIUM, args=FLAGS)
        page = browser.new_page(viewport={"width": 1400, "height": 900})
        page.on("console", lambda message: complaints.append(message.text))
        page.on("pageerror", lambda error: complaints.append(str(error)))
        page.goto(session[0])
        yield page
        browser.close()
    assert complaints == []


def middle(tab, selector: str) -> tuple[float, float]:
    box = tab.locator(selector).bounding_box()
    return box["x"] + box["width"] / 2, box["y"] + box["height"] / 2


def test_click_drag_add_delete_undo_save(tab, session, office) -> None:
    _, edits, out = session
    building = Building.load(office)
    assert tab.locator(".node").count() == building.n_nodes
    assert tab.locator("image").count() == 1
    lines = tab.locator("#lines li")

    room = int(np.flatnonzero((building.kind == ROOM) & (np.arange(building.n_nodes) != building.start))[0])
    x, y = middle(tab, f"[data-node='{room}']")
    tab.mouse.move(x, y)
    tab.mouse.down()
    tab.mouse.move(x + 15, y + 5, steps=4)
    tab.mouse.up()
    playwright.expect(lines).to_have_count(1)

    tab.locator(f"[data-node='{room}']").click(force=True)
    playwright.expect(tab.locator("#what")).to_contain_text("room")
    tab.locator("#start").click()
    playwright.expect(lines).to_have_count(2)

    tab.get_by_role("button", name="Add room").click()
    tab.mouse.click(x + 60, y + 60)
    playwright.expect(lines).to_have_count(3)
    tab.get_by_role("button", name="Undo").click()
    playwright.expect(lines).to_have_count(2)
    tab.mouse.click(x + 60, y + 60)
    playwright.expect(lines).to_have_count(3)

    tab.get_by_role("button", name="Select, move").click()
    door = int(np.flatnonzero(building.feature_class == DOOR)[0])
    tab.locator(f"[data-node='{door}']").click(force=True)
    tab.keyboard.press("Delete")
    playwright.expect(lines).to_have_count(4)
    tab.get_by_role("button", name="Save").click()
    playwright.expect(tab.locator("#said")).to_contain_text("saved my.edits and out.json")

    corrected, _ = apply_edits(building, read_edits(edits))
    assert corrected == Building.load(out)
    assert (corrected.kind == ROOM).sum() == (building.kind == ROOM).sum() + 1
    assert corrected.n_nodes in (building.n_nodes, building.n_nodes + 1)  # the new corridor may end at a node
    assert not edits.read_text().count("node at node")


def test_what_does_not_apply_is_said_and_not_kept(tab, session, office) -> None:
    start = Building.load(office).start
    tab.locator(f"[data-node='{start}']").click(force=True)
    tab.locator("#delete").click()
    playwright.expect(tab.locator("#said")).to_contain_text("the robots start there")
    playwright.expect(tab.locator("#lines li")).to_have_count(0)


@pytest.mark.parametrize(
    ("headers", "body", "status"),
    [
        ({"Origin": "http://evil.example"}, "[]", 403),
        ({}, "[]", 403),
        ({"Host": "evil.example"}, "[]", 403),
        ({"Origin": "own"}, "[]", 200),
        ({"Origin": "own"}, "{", 200),
        ({"Origin": "own"}, "[1]", 200),
        ({"Origin": "own"}, '["nonsense"]', 200),
    ],
)
def test_only_its_own_page_may_ask(session, headers, body, status) -> None:
    url, edits, _ = session
    address = url.removeprefix("http://").rstrip("/")
    headers = {key: url.rstrip("/") if value == "own" else value for key, value in headers.items()}
    connection = http.client.HTTPConnection(address, timeout=20)
    connection.request("POST", "/save" if status == 403 else "/apply", body, headers)
    answer = connection.getresponse()
    assert answer.status == status
    if status == 200:
        assert ("error" in json.loads(answer.read())) == (body != "[]")
    connection.close()
    assert not edits.exists()
