"""The paper's experiment, small: every part is made, the report is whole, a second run changes nothing."""

from __future__ import annotations

import csv
from html.parser import HTMLParser

import numpy as np
import pytest

from tasklift.building.generate import generate
from tasklift.building.reading import PRESETS
from tasklift.building.search import search_and_clear, search_only
from tasklift.errors import TaskliftError
from tasklift.lab import FILE_NAME, Cell, Store
from tasklift.learning.reinforcement import Reinforcement
from tasklift.studies.arms import ARMS, UNSAFE, arm_named, expert, learn_source, start_policy
from tasklift.studies.paper.claims import CLAIMS
from tasklift.studies.paper.reproduce import reproduce
from tasklift.studies.study import Study
from tasklift.tasks.policy import Policy

FIGURES = ["figure1", "figure2", "figure3"]
FIGURES += [f"figure4-{preset}" for preset in PRESETS]
FIGURES += [f"figure5-{preset}-{arm}" for preset in PRESETS for arm in ("copy", "copy+prior")]


@pytest.fixture(scope="module")
def reproduction(tmp_path_factory):
    folder = tmp_path_factory.mktemp("reproduction") / "out"
    seen = []
    report = reproduce(
        out=folder, maps=2, seeds=2, trials=25, survey=3, progress=lambda done, total, note: seen.append((done, total))
    )
    assert report == folder / "report.html"
    assert seen
    assert all(done <= total for done, total in seen)
    return folder


def test_every_figure_is_there_twice(reproduction):
    for name in FIGURES:
        assert (reproduction / "figures" / f"{name}.png").read_bytes().startswith(b"\x89PNG")
        assert b"<svg" in (reproduction / "figures" / f"{name}.svg").read_bytes()[:1000]


def test_the_report_is_whole_and_speaks_of_every_claim_arm_and_preset(reproduction):
    class Page(HTMLParser):
        text, images, outside = "", 0, []

        def handle_data(self, data):
            self.text += data

        def handle_starttag(self, tag, attributes):
            given = dict(attributes)
            self.images += tag == "img"
            for name in ("src", "href"):
                if not given.get(name, "#").startswith(("#", "data:")):
                    self.outside.append(given[name])

    page = Page()
    page.feed((reproduction / "report.html").read_text())
    assert page.images >= len(FIGURES) - 2
    assert page.outside == []
    for word in [*CLAIMS, *ARMS, *PRESETS, "holds", "does not hold"]:
        assert word in page.text


def test_the_claims_table_has_a_verdict_for_every_claim_and_preset(reproduction):
    with open(reproduction / "claims.csv") as file:
        rows = list(csv.DictReader(file))
    assert {(row["claim"], row["reading"]) for row in rows} == {(c, p) for c in CLAIMS for p in PRESETS}
    assert {row["verdict"] for row in rows} <= {"holds", "does not hold", "undecided"}
    for row in rows:
        assert float(row["low"]) <= float(row["estimate"]) <= float(row["high"])


def test_the_summary_quotes_the_same_verdicts(reproduction):
    text = (reproduction / "summary.md").read_text()
    with open(reproduction / "claims.csv") as file:
        rows = list(csv.DictReader(file))
    for row in rows:
        cells = f"| {row['claim']} | {row['reading']} | {row['contrast']} |"
        (line,) = [line for line in text.splitlines() if line.startswith(cells)]
        assert f"| {row['verdict']} |" in line


def test_the_rows_are_those_of_the_store_and_policies_load(reproduction):
    with Store.read(reproduction / FILE_NAME) as store:
        expected = sum(len(next(iter(c.values()))) for _, r in store.select() for c in r.stages.values())
    with open(reproduction / "rows.csv") as file:
        assert sum(1 for _ in file) - 1 == expected
    policies = list((reproduction / "policies").iterdir())
    assert len(policies) == len(PRESETS) * sum(arm.learns for arm in ARMS.values())
    for path in policies:
        Policy.load(path, search_and_clear())


def test_running_again_computes_nothing_and_changes_no_row(reproduction):
    with Store.read(reproduction / FILE_NAME) as store:
        before = store.digest()
    reproduce(out=reproduction, maps=2, seeds=2, trials=25, survey=3)
    with Store.read(reproduction / FILE_NAME) as store:
        assert store.digest() == before


def study(**options):
    return Study({"house": generate(seed=2)}, PRESETS, tuple(ARMS), seeds=1, trials=10, **options)


def test_arms_are_paired_and_adding_one_changes_no_other():
    few = Study({"house": generate(seed=2)}, PRESETS, ("copy",), seeds=1, trials=10)
    cell = Cell(reading="scattered", map="house", seed=0, arm="copy")
    many = study()
    for arm in ARMS:
        many.work(Cell(reading="scattered", map="house", seed=0, arm=arm))
    alone, among = few.work(cell), many.work(cell)
    for stage in alone.stages:
        for column in alone.stages[stage]:
            assert alone.stages[stage][column].tolist() == among.stages[stage][column].tolist()


def test_a_learned_policy_is_the_one_whose_weights_the_cell_reported():
    work = study()
    for arm in ("direct+budget", "copy+prior", "expert"):
        cell = Cell(reading="cohesive", map="house", seed=0, arm=arm)
        weights = work.learned(cell).weights.reshape(3, 2, 3, 5, 2, 22).mean(axis=(0, 1, 5))
        assert np.array_equal(work.work(cell).attachments["move_weights"], weights)


def test_the_arms_start_where_they_say():
    task = search_and_clear()
    mission = study().mission("scattered", "house")
    source = learn_source(mission, repeats=1, seed=0, reinforcement=Reinforcement()).policy
    assert source.task == search_only(task)
    starts = {name: start_policy(name, task, source, 1.5).weights for name in ("equal", "copy", "prior", "copy+prior")}
    unsafe = task.input_mask(UNSAFE)
    assert unsafe.sum() == 3 * 2 * 2  # DL × GL × (nWPN below m), at the enemy feature
    copied = starts["copy"].reshape(3, 2, 15, 44)
    assert (copied == source.weights).all()
    assert (starts["copy+prior"][~unsafe] == starts["copy"][~unsafe]).all()
    swapped = starts["copy"][unsafe].reshape(-1, 2, 22)[:, ::-1].reshape(-1, 44)
    assert (starts["copy+prior"][unsafe] == swapped).all()
    assert (starts["prior"][unsafe] == starts["copy+prior"][unsafe]).all()
    assert (starts["prior"][~unsafe] == starts["equal"][~unsafe]).all()


def test_the_expert_stops_at_doors_until_enough_weapon_robots_are_there():
    task = search_and_clear()
    policy = expert(task)
    for row in range(task.shape[0]):
        seen = task.input_values(row)
        does = task.output_values(policy.select(row, rng=np.random.default_rng(0)))
        assert does["MV"] == (0 if seen["FTR"] == 4 and seen["nWPN"] < 2 else 1)


def test_mistakes_are_refused_before_anything_is_trained():
    with pytest.raises(TaskliftError, match="arm 'copie' is unknown"):
        arm_named("copie")
    with pytest.raises(TaskliftError, match="seeds"):
        Study({"house": generate(seed=2)}, PRESETS, ("direct",), seeds=0)
    with pytest.raises(TaskliftError, match="hostiles"):
        study(hostiles=50)
    with pytest.raises(TaskliftError, match="policy learned on the simple task"):
        start_policy("copy", search_and_clear(), None, 1.5)
