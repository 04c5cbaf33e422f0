"""The multiverse of readings: a balanced design, cells that resume and can be recomputed, effects that are found."""

from __future__ import annotations

import csv
from functools import cache

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from tasklift.building.reading import Reading
from tasklift.errors import TaskliftError
from tasklift.lab import FILE_NAME, Store, recompute, run
from tasklift.learning.reinforcement import Reinforcement
from tasklift.studies.multiverse import report as pages
from tasklift.studies.multiverse.study import (
    ARMS,
    EXPLOITING,
    LINES,
    OFFSETS,
    OPTIONS,
    SELECTION,
    Judged,
    condition,
    draw,
    judge,
    main_effects,
    study,
)
from tasklift.studies.study import Study, generated

#: Drilling and the loss signal are additions of ours; the search rate, m and q have no alternatives of their own.
NO_OPTIONS = {"drill", "search_rate_m2", "loss_signal", "q"}


drawn = cache(draw)  # a good design takes a second


def option(name):
    return next(i for i, o in enumerate(OPTIONS) if o.name == name)


@settings(deadline=None, derandomize=True, max_examples=5)
@given(n=st.integers(2, 40), seed=st.integers(0, 10))
def test_every_level_of_an_option_is_drawn_equally_often(n, seed):
    levels = draw(n, seed)
    assert levels.shape == (n, len(OPTIONS))
    for column, o in zip(levels.T, OPTIONS, strict=True):
        counts = np.bincount(column, minlength=len(o.levels))
        assert len(counts) == len(o.levels)
        assert np.ptp(counts) <= 1


def test_the_design_depends_on_its_seed_and_on_nothing_else():
    assert (draw(20, 1) == draw(20, 1)).all()
    assert (draw(20, 1) != draw(20, 2)).any()
    with pytest.raises(TaskliftError, match="from 2 to"):
        draw(1)


def test_pairs_of_levels_are_nearer_to_balance_than_by_chance():
    levels = drawn(100)
    excess = []
    for i, a in enumerate(OPTIONS):
        for j, b in enumerate(OPTIONS[:i]):
            table = np.zeros((len(a.levels), len(b.levels)))
            np.add.at(table, (levels[:, i], levels[:, j]), 1)
            expected = np.outer(table.sum(axis=1), table.sum(axis=0)) / len(levels)
            excess.append(((table - expected) ** 2 / expected).sum() / ((len(a.levels) - 1) * (len(b.levels) - 1)))
    assert np.mean(excess) < 0.6  # 1 is what independent columns have on average


def test_all_named_alternatives_are_drawn_and_the_presets_are_among_them():
    named = {o.name for o in OPTIONS}
    fields = set(Reading.__dataclass_fields__) | set(Reinforcement.__dataclass_fields__)
    assert fields - NO_OPTIONS == named - {"hostiles"}
    for o in OPTIONS:
        if o.name != "hostiles":
            assert getattr(Reading() if o.of == "reading" else Reinforcement(), o.name) in o.levels
    default = condition([o.levels.index(getattr(Reading(), o.name)) if o.of == "reading" else 0 for o in OPTIONS])
    assert default.reading == Reading()
    rules = [condition([k, *[0] * (len(OPTIONS) - 1)]).reinforcement for k in range(4)]
    assert [(r.selection, r.q) for r in rules] == [
        ("exploration", 0.9), ("pseudo-random", 0.5), ("pseudo-random", 0.9), ("exploitation", 0.9),
    ]  # fmt: skip


@pytest.fixture(scope="module")
def small():
    return study(generated(range(2)), drawn(4), seeds=2, trials=12, repeats=1)


@pytest.fixture(scope="module")
def ran(small, tmp_path_factory):
    path = tmp_path_factory.mktemp("multiverse") / FILE_NAME
    with Store.open(path, small.spec("multiverse")) as store:
        run(store, small.cells()[:9], small.work, workers=2)  # an unfinished run, ...
    with Store.open(path, small.spec("multiverse")) as store:
        done = run(store, small.cells(), small.work, workers=2)  # ... resumed
        assert done.computed == len(small.cells()) - 9
    return path


def test_readings_that_explore_also_run_what_c10_needs(small):
    for name, levels in zip(small.conditions, drawn(4), strict=True):
        arms = {cell["arm"] for cell in small.cells() if cell["reading"] == name}
        assert arms == set(ARMS) | (set(EXPLOITING) if levels[SELECTION] == 0 else set())


def test_a_cell_is_the_main_studys_cell_and_can_be_recomputed(small, ran):
    cell = small.cell("r0002", "map-1", 1, "copy")
    of = condition([int(level) for level in drawn(4)[2]])
    alone = Study.every(small.buildings, {"r0002": of}, ("copy",), seeds=2, trials=12, repeats=1)
    full = alone.work(cell)
    with Store.read(ran) as store:
        kept = store.result(cell)
        assert list(kept.stages) == ["target"]
        for name, values in kept.stages["target"].items():
            assert (values == full.stages["target"][name]).all()
        assert (kept.attachments["move_weights"] == full.attachments["move_weights"]).all()
        recompute(store, cell, small.work)


def test_the_spec_covers_design_and_maps(small):
    def spec(buildings, levels):
        return study(buildings, levels, seeds=2, trials=12, repeats=1).spec("multiverse")

    assert not spec(small.buildings, drawn(4)).conflicts(small.spec("multiverse"))
    assert spec(small.buildings, draw(4, 1)).conflicts(small.spec("multiverse"))
    assert spec(generated([1]) | {"map-0": generated([5])["map-5"]}, drawn(4)).conflicts(small.spec("multiverse"))


def test_claims_are_judged_from_the_rows_alone(ran):
    with Store.read(ran) as store:
        judged = judge(store, drawn(4), resamples=100)
        assert judged.kept.shape == (4, 4)
    assert np.isin(judged.verdict[np.isfinite(judged.verdict)], (-1, 0, 1)).all()
    assert np.isfinite(judged.column("C1", "v")).all()
    explores = judged.levels[:, SELECTION] == 0
    for arm in ("copy", "copy-prior"):
        assert (np.isfinite(judged.column("C10", arm)) == explores).all()
        assert np.isfinite(judged.column("C6", arm)).all()
    # the sign of a standardised effect agrees with its verdict
    judged_so = np.isfinite(judged.effect)
    assert judged_so.sum() > 50
    assert (judged.effect * judged.verdict)[judged_so].min() >= 0


def made(n=160, seed=0, size=0.8):
    """Verdicts in which share_map = radio alone decides C6 of copy, and all else is chance."""
    rng = np.random.default_rng(seed)
    levels = drawn(n)
    verdict = rng.integers(-1, 2, (n, len(LINES))).astype(float)
    line = LINES.index(("C6", "copy"))
    radio = levels[:, option("share_map")] == 1
    verdict[:, line] = np.where(radio & (rng.random(n) < size), 1, rng.integers(-1, 2, n))
    verdict[levels[:, SELECTION] != 0, LINES.index(("C10", "copy"))] = np.nan
    effect = verdict * 2.5
    arms = {arm: rng.uniform(1, 9, (n, 4)) for arm in ARMS}
    return Judged(levels, verdict, effect, rng.uniform(0, 40, (n, 4)), arms)


def test_main_effects_find_what_decides_and_nothing_else():
    judged = made()
    effects = main_effects(judged.verdict, judged.levels, resamples=400)
    line, start = LINES.index(("C6", "copy")), OFFSETS[option("share_map")]
    assert effects.decides[line, start + 1]
    assert effects.estimate[line, start + 1] > 0.3
    assert effects.low[line, start + 1] > 0
    others = effects.decides.copy()
    others[line, start : start + 3] = False
    assert others.sum() <= 1  # of 1,300 that have no effect
    outcome, levels = judged.verdict[:, line], judged.levels[:, option("share_map")]
    expected = [outcome[levels == k].mean() - outcome.mean() for k in range(3)]
    np.testing.assert_allclose(effects.estimate[line, start : start + 3], expected)
    # C10 is judged under one rule only: the rule cannot decide it
    assert np.isnan(effects.p[LINES.index(("C10", "copy")), : len(OPTIONS[SELECTION].levels)]).all()


def test_the_false_discovery_rate_is_what_it_says():
    found = 0
    for seed in range(8):
        judged = made(n=80, seed=seed, size=0.0)
        found += main_effects(judged.verdict, judged.levels, resamples=50, seed=seed).decides.any()
    assert found <= 3  # each with a chance of 5 % at most: P(4 or more of 8) < 0.0004


def test_shares_add_up_and_the_report_tells_them(tmp_path):
    judged = made(n=60)
    share = pages.shares(judged)
    np.testing.assert_allclose(share.sum(axis=1), 1)
    plan = study({"<b>map</b>": generated([0])["map-0"]}, judged.levels)
    with Store.open(tmp_path / FILE_NAME, plan.spec("<b>name</b>")) as store:
        lines, path = pages.write_report(plan, judged, tmp_path, store, "tasklift multiverse --out <here>", 0.0)
    assert lines[0].startswith("Of 60 readings of what the paper leaves open, copy loses fewer robots in ")
    html = path.read_text()
    assert "<b>map" not in html
    assert "<here>" not in html
    assert f"{judged.together('copy').sum()} of 60 readings" in html
    with (tmp_path / "verdicts.csv").open() as file:
        rows = list(csv.DictReader(file))
    assert len(rows) == 60
    holds = sum(row["C6 copy"] == "holds" for row in rows)
    assert holds / 60 == pytest.approx(share[LINES.index(("C6", "copy")), 0])
    with (tmp_path / "effects.csv").open() as file:
        assert len(list(csv.DictReader(file))) == 2 * len(LINES) * OFFSETS[-1]
    for name in ("multiverse", "selection-rules", "eleven-of-100"):
        assert (tmp_path / "figures" / f"{name}.png").stat().st_size > 10_000


def test_the_command_runs_resumes_and_refuses_another_design(tmp_path, monkeypatch):
    from click.testing import CliRunner

    from tasklift.cli.main import cli

    monkeypatch.chdir(tmp_path)
    command = ["multiverse", "--readings", "2", "--maps", "1", "--seeds", "2", "--trials", "20", "--out", "here"]
    for _ in range(2):
        done = CliRunner().invoke(cli, command, catch_exceptions=False)
        assert done.exit_code == 0
        assert "report.html" in done.output
    other = CliRunner().invoke(cli, [*command, "--design", "1"])
    assert isinstance(other.exception, TaskliftError)
    assert "another experiment" in str(other.exception)
