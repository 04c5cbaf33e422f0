"""Drills: the comparison is fair (equal totals, paired), the verdict can say all it should, the command is whole."""

from __future__ import annotations

import sys
from dataclasses import replace

import numpy as np
import pytest

from tasklift import stats
from tasklift.building.generate import generate
from tasklift.building.mission import Mission
from tasklift.building.search import hostile_candidates
from tasklift.cli import main as cli
from tasklift.errors import TaskliftError
from tasklift.lab import FILE_NAME, CellResult, Store, run
from tasklift.learning.curriculum import Curriculum
from tasklift.studies.arms import ARMS, COUNTED, DRILLS, EVERY_DOOR, LOSS_SIGNAL, SELECTIONS, Drilling, Setup
from tasklift.studies.drills import report as drill_report
from tasklift.studies.drills.contrasts import after_holm, contrast, times, times_fewer
from tasklift.studies.drills.report import BEGIN, END, chosen, headline
from tasklift.studies.drills.study import (
    CHOSEN,
    DOORS,
    RECORD,
    choosing,
    further_arms,
    main_arms,
    study,
    variants,
)
from tasklift.studies.samples import Sample
from tasklift.studies.study import Condition, Part, Study

HOUSE = generate(intersections=5, corridors=5, rooms=2, features=6, doors=4, seed=1)


@pytest.fixture(scope="module")
def on():
    return Setup(Mission(HOUSE, "3+3", hostiles=1))


def drilled(on, drilling, seed=0):
    return Curriculum([drilling.stage(on)], block=None).run(seed)


# --- what is trained


def test_drills_repel_and_their_hostiles_stand_where_they_are_said_to(on):
    for where in ("same", "relocated", "every door"):
        drilling = Drilling(20, hostiles=where)
        world = drilling.stage(on).world
        assert world.reading.drill
        outcomes = drilled(on, drilling).outcomes["drill"]
        assert outcomes.losses.sum() > 0  # would-be losses are booked
        assert (outcomes.robots_left.sum(axis=1) == on.mission.n_robots).all()  # and nobody is lost
        assert world.reading.relocate == (where == "relocated")
        assert world.hostiles == (tuple(hostile_candidates(HOUSE)) if where == "every door" else 1)
    assert not on.mission.reading.drill


def test_drills_in_parts_are_the_drills_in_one_go(on):
    once, parts = (drilled(on, Drilling(30, q=q), seed=3) for q in ((0.0,), (0.0, 0.0, 0.0)))
    assert np.array_equal(once.policy.weights, parts.policy.weights)
    assert np.array_equal(once.outcomes["drill"].losses, parts.outcomes["drill"].losses)
    annealed = drilled(on, Drilling(30, q=(0.0, 0.5, 0.9)), seed=3)
    assert not np.array_equal(once.policy.weights, annealed.policy.weights)


def rows_of(arm, on):
    """The learner on T, and the trials of every stage that the arm pays for."""
    stages = ARMS[arm].curriculum(on).stages
    trials = {s.name: s.trials or s.learner.trials(s.task) for s in stages if s.name not in ARMS[arm].unspent}
    return stages[-1].learner, trials


def test_every_arm_has_a_direct_learner_of_the_same_signals_selection_and_total(on):
    for arm in DRILLS:
        if not arm.against:
            continue
        (reference,) = arm.against
        learner, trials = rows_of(arm.slug, on)
        direct, direct_trials = rows_of(reference, on)
        assert direct == learner
        assert learner.loss_signal == LOSS_SIGNAL
        assert list(direct_trials) == ["target"]
        assert sum(trials.values()) <= direct_trials["target"]
        assert trials["target"] == COUNTED
    for selection in SELECTIONS:
        for arm in main_arms(selection):
            assert sum(rows_of(arm, on)[1].values()) == COUNTED + 300
        assert sum(rows_of(f"copy-prior-drill-80-{selection}", on)[1].values()) == COUNTED + 300


def test_all_arms_of_the_study_are_in_a_table_or_tried_as_variants():
    listed = [*(arm for selection in SELECTIONS for arm in main_arms(selection)), *further_arms(), *variants()]
    assert sorted(listed) == sorted(arm.slug for arm in DRILLS)


def test_the_chosen_drills_are_among_those_tried_and_on_other_maps():
    assert CHOSEN in variants()
    assert ARMS[CHOSEN].curriculum.keywords["drilling"] == EVERY_DOOR
    reported = study(maps=12, seeds=2, hostiles=(1, 2))
    assert not {b.content_id for b in choosing().buildings.values()} & {
        b.content_id for b in reported.buildings.values()
    }
    assert all(len(hostile_candidates(b)) == DOORS for b in reported.buildings.values())


def test_a_cell_does_not_depend_on_what_was_computed_before_it():
    arms = ("drill-300-q90", "every-door-300-q90", "every-door-300-exploitation",
            "copy-drill-80-q90", "copy-every-door-80-q90", "prior-loss-q90")  # fmt: skip

    def plan():
        part = Part(arms, ("1", "2"), ("house",), (0,))
        conditions = {h: Condition(hostiles=int(h)) for h in ("1", "2")}
        return Study({"house": HOUSE}, conditions, (part,), axis="hostiles", team="2+3", limit=60, record=RECORD)

    together = plan()
    results = {cell: together.work(cell) for cell in together.cells()}
    assert len(results) == 2 * len(arms)
    for cell, result in results.items():
        alone = plan().work(cell)
        assert alone.summary == result.summary
        for stage, columns in result.stages.items():
            for name, values in columns.items():
                assert np.array_equal(values, alone.stages[stage][name])
    # a hostile at every door: the same drills, however many there are on T
    pair = [results[together.cell(h, "house", 0, arms[1])] for h in ("1", "2")]
    assert np.array_equal(*(result.stages["drill"]["losses"] for result in pair))
    ledger = results[together.cell("1", "house", 0, "copy-drill-80-q90")].stages
    assert {stage: len(columns["losses"]) for stage, columns in ledger.items()} == {
        "source": 220, "drill": 80, "target": 100,
    }  # fmt: skip
    assert ledger["source"]["losses"].sum() == 0
    # prior knowledge is made from V, whose traversals the arm does not pay for
    assert list(results[together.cell("1", "house", 0, "prior-loss-q90")].stages) == ["target"]


def test_mistakes_are_refused_before_training():
    with pytest.raises(TaskliftError, match="unknown; the nearest are: drill"):
        Study.every({"house": HOUSE}, {"1": Condition()}, ("dril",))
    with pytest.raises(TaskliftError, match="door"):
        study(maps=1, seeds=1, hostiles=(DOORS + 1,))


# --- what is concluded


def arm(rng, *, losses, solved, trials=COUNTED, spread=0.3, maps=4, seeds=10):
    n = maps * seeds
    level = losses * rng.lognormal(0, spread, (n, 1))
    return Sample(
        maps=np.repeat([f"map-{i}" for i in range(maps)], seeds),
        seeds=np.tile(np.arange(seeds), maps),
        losses=rng.poisson(level, (n, trials)).astype(float),
        steps=np.full((n, trials), 300.0),
        success=(rng.random((n, trials)) < solved).astype(float),
        limit=600,
        n_robots=15,
        spent={"drill": np.array([300, 0, 0]), "target": np.array([trials, 0, 0])},
    )


DRILL = main_arms("q90")[1]


def judged(first, second):
    return contrast(first, second, name=DRILL, hostiles=1, resamples=500)


def test_all_verdicts_for_the_right_reason():
    rng = np.random.default_rng(0)
    direct = arm(rng, losses=1.0, solved=0.9, trials=COUNTED + 300)
    better = judged(arm(rng, losses=0.2, solved=0.95), direct)
    assert better.holds
    assert better.everything.fewer.verdict == "holds"
    assert (better.safe, better.dangerous) == (300, 100)
    ratio = better.first.fewer.interval
    assert ratio.low < 5 < ratio.high  # 100 x 1 against 100 x .2
    # fewer in all, since drills lose nobody, and yet more in as many trials: like with like is what counts
    late = judged(arm(rng, losses=2.0, solved=0.95), direct)
    assert late.everything.fewer.verdict == "holds"
    assert late.last.fewer.verdict == late.first.fewer.verdict == "does not hold"
    assert not late.holds
    assert "more" in headline([late])[0]
    # who never moves loses nothing, and solves nothing
    still = judged(arm(rng, losses=0.0, solved=0.0), direct)
    assert still.first.fewer.verdict == still.everything.fewer.verdict == "does not hold"
    assert times_fewer(still.first.fewer) == "none lost"
    worse = judged(arm(rng, losses=8.0, solved=0.95), direct)
    assert worse.everything.fewer.verdict == "does not hold"
    # as many losses, from the same runs in another order
    same = judged(replace(arm(rng, losses=1.0, solved=0.95), losses=direct.losses[::-1, -COUNTED:]), direct)
    assert same.last.fewer.verdict == "undecided"
    few = {"maps": 1, "seeds": 3}
    few = judged(arm(rng, losses=0.2, solved=0.95, **few), arm(rng, losses=1, solved=0.9, trials=400, **few))
    assert few.first.fewer.says == "too few seeds (3 of at least 6)"
    assert "∞" not in " ".join(map(str, drill_report.losses([few, still])[0]))


def test_fewer_losses_count_only_where_the_task_is_solved_as_often():
    """A difference that is not shown to be less than five points leaves the verdict open."""
    rng = np.random.default_rng(3)
    direct = arm(rng, losses=1.0, solved=0.9, trials=COUNTED + 300)
    vague = arm(rng, losses=0.2, solved=0.9)
    runs = rng.random(len(vague.success)) < 0.9  # whole runs fail or succeed
    vague = replace(vague, success=np.repeat(runs[:, None] * 1.0, COUNTED, axis=1))
    found = judged(vague, replace(direct, success=direct.success * 0 + vague.success[::-1].mean()))
    assert found.last.fewer.verdict == "undecided"
    alone = stats.ratio(direct.losses[:, -COUNTED:].sum(axis=1), vague.losses.sum(axis=1), better="greater")
    assert alone.verdict == "holds"


def test_the_headline_says_what_is_lost_after_arrival_and_the_price():
    rng = np.random.default_rng(1)
    direct = arm(rng, losses=1.0, solved=0.9, trials=COUNTED + 300)
    good = judged(arm(rng, losses=0.2, solved=0.95), direct)
    bad = replace(judged(arm(rng, losses=8.0, solved=0.5), direct), hostiles=2)
    (line,) = headline([good, bad])
    assert f"fewer with 1 hostile ({times_fewer(good.first.fewer)} times)" in line
    assert "more, or T solved less often, with 2 hostiles" in line
    assert "300 safe and 100 dangerous trials instead of 400 dangerous ones" in line
    assert f"{good.lost:.3g} instead of {good.everything.lost:.3g} (1)" in line
    other = replace(good, arm=main_arms("q90")[2], lost=0.0)
    assert [says[2:].partition("**")[0] for says in headline([good, bad, other])] == [
        "every-door drill 300, q = .9",
        "drill 300, q = .9",
    ]


def test_all_tables_are_judged_together():
    rng = np.random.default_rng(1)
    direct = arm(rng, losses=1.0, solved=0.9, trials=COUNTED + 300)
    found = [judged(arm(rng, losses=0.93, solved=0.95), direct) for _ in range(20)]
    together = after_holm({"one": found[:10], "other": found[10:]})
    assert [c.lost for c in together["one"] + together["other"]] == [c.lost for c in found]
    pairs = list(zip(found, together["one"] + together["other"], strict=True))
    assert all(before.last.fewer.p <= after.last.fewer.p for before, after in pairs)
    assert any(before.last.fewer.p < after.last.fewer.p for before, after in pairs)
    assert all(before.last.fewer.interval == after.last.fewer.interval for before, after in pairs)


def test_times_fewer_is_the_ratio_of_means():
    found = stats.ratio([10.0, 20.0, 30.0, 25.0, 15.0, 20.0], [1.0, 0.0, 2.0, 1.0, 1.0, 1.0], better="greater")
    assert found.estimate == pytest.approx(120 / 6)
    assert times_fewer(found) == "20 (no interval)"  # five that lose somebody are too few
    assert [times(x) for x in (0.5, 1.0, 20.0, 124.2)] == ["0.5", "1.0", "20", "124"]


def test_unpaired_or_too_short_references_are_refused():
    rng = np.random.default_rng(2)
    with pytest.raises(TaskliftError, match="expected 400 paired"):
        judged(arm(rng, losses=1, solved=1), arm(rng, losses=1, solved=1, trials=399))
    with pytest.raises(TaskliftError, match="paired"):
        judged(arm(rng, losses=1, solved=1), arm(rng, losses=1, solved=1, trials=400, maps=5, seeds=8))


def test_the_rule_that_chooses_the_drills(tmp_path):
    """Few losses admit a variant, the solved share decides; many losses cannot be made up for."""
    good, fast = "variant-every-door", "variant-q90"
    losses = dict.fromkeys(variants(), 1) | {good: 0, fast: 0}
    solved = dict.fromkeys(variants(), 1.0) | {good: 0.8, fast: 0.7}

    def work(cell):
        success = np.arange(COUNTED) < round(COUNTED * solved[cell["arm"]])
        ones = np.ones(COUNTED, np.int32)
        return CellResult(
            {"target": {"losses": losses[cell["arm"]] * ones, "steps": ones, "success": success},
             "drill": {"losses": ones, "steps": ones}}
        )  # fmt: skip

    plan = choosing(maps=1, seeds=2)
    with Store.open(tmp_path / FILE_NAME, plan.spec("choosing")) as store:
        run(store, plan.cells(), work, workers=1)
        slug, table = chosen(store)
    assert slug == good
    assert [row[0] for row in table if row[-1]] == [ARMS[fast].label, ARMS[good].label]


# --- the command


def test_the_command_leaves_a_report_a_figure_and_a_page(tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    page = tmp_path / "docs" / "drills.md"
    page.parent.mkdir()
    page.write_text(f"# Drills\n\n{BEGIN}\n{END}\n\nThe end.\n", encoding="utf-8")
    asked = ["drills", "--maps", "1", "--seeds", "2", "--hostiles", "2", "--out", "out", "--page", str(page)]
    pages = []
    for _ in range(2):
        monkeypatch.setattr(sys, "argv", ["tasklift", *asked])
        cli.main()
        assert "report: out/report.html" in capsys.readouterr().out
        pages.append(page.read_bytes())
    assert pages[0] == pages[1]
    text = page.read_text(encoding="utf-8")
    assert text.startswith("# Drills\n")
    assert text.endswith("The end.\n")
    for name in ("| drill 300, q = .9 | 2 |", "| every-door drill 300, exploitation | 2 |", "(pictures/drills.png)"):
        assert name in text
    assert text.count("<details markdown>") == text.count("</details>") == text.count("<summary>") > 0
    assert (page.parent / "pictures" / "drills.png").read_bytes().startswith(b"\x89PNG")
    assert (tmp_path / "out" / "drills.md").read_text(encoding="utf-8") in text
    report = (tmp_path / "out" / "report.html").read_text(encoding="utf-8")
    assert "tasklift drills --maps 1 --seeds 2 --hostiles 2 --out out" in report


def test_a_page_without_marks_a_picture_of_the_users_and_a_wrong_range_are_refused(tmp_path, monkeypatch, capsys):
    page = tmp_path / "page.md"
    page.write_text("no marks\n", encoding="utf-8")
    with pytest.raises(TaskliftError, match="marks"):
        drill_report.drills(out=tmp_path / "out", maps=1, seeds=1, page=page)
    page.write_text(f"![mine](pictures/drills.png)\n{BEGIN}\n{END}\n", encoding="utf-8")
    picture = tmp_path / "pictures" / "drills.png"
    picture.parent.mkdir()
    picture.write_text("precious", encoding="utf-8")
    with pytest.raises(TaskliftError, match="is there already"):
        drill_report.drills(out=tmp_path / "out", maps=1, seeds=1, page=page)
    assert picture.read_text(encoding="utf-8") == "precious"
    assert not (tmp_path / "out").exists()
    for text in ("x", "0-3", "3-1", "-2", "1,,3"):
        monkeypatch.setattr(sys, "argv", ["tasklift", "drills", "--hostiles", text])
        with pytest.raises(SystemExit) as stop:
            cli.main()
        assert stop.value.code == 2
        assert "range" in capsys.readouterr().err
