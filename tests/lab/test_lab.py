"""The laboratory: specs, packing, the store, running and resuming, exports."""

from __future__ import annotations

import csv
import json
import os
import signal
import sqlite3
import subprocess
import sys
import tempfile
import threading
import time
from functools import partial
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp
from lab_work import CELLS, SPEC, work

from tasklift.errors import TaskliftError
from tasklift.lab import Cell, CellResult, Interrupted, Spec, Store, differences, recompute, run, runs
from tasklift.lab.packing import Packed, pack, unpack

SCRIPT = Path(__file__).with_name("lab_work.py")


@pytest.fixture(scope="module")
def whole(tmp_path_factory):
    """A store that ran without a break."""
    path = tmp_path_factory.mktemp("whole") / "experiment.sqlite"
    with Store.open(path, SPEC) as store:
        run(store, CELLS, work, workers=2)
    return path


@pytest.fixture(scope="module")
def digest(whole):
    with Store.read(whole) as store:
        return store.digest()


def same(a: CellResult, b: CellResult) -> bool:
    def plain(result):
        return json.dumps(
            [result.stages, result.summary, result.attachments], default=lambda v: v.tolist(), sort_keys=True
        )

    return plain(a) == plain(b)


# ---------------------------------------------------------------- spec

texts = st.text(st.characters(exclude_categories=["C"]), max_size=3)
json_values = st.recursive(
    st.none() | st.booleans() | st.integers(-9, 9) | texts | st.floats(-1, 1),
    lambda inner: st.lists(inner, max_size=3) | st.dictionaries(texts, inner, max_size=3),
    max_leaves=8,
)


@given(st.dictionaries(texts, json_values, max_size=4))
@settings(deadline=None, derandomize=True)
def test_a_spec_is_its_content(content):
    one, other = Spec.of("a", content, {"seed": [0]}), Spec.of("b", dict(reversed(content.items())), {"seed": [0]})
    assert one.id == other.id
    assert one.settings == content
    one.settings["more"] = 1
    assert one.settings == content
    assert Spec.of("a", {**content, "another": 0}, {"seed": [0]}).id != one.id


@given(json_values, json_values)
@settings(deadline=None, derandomize=True)
def test_differences_are_empty_exactly_for_equal_specs(a, b):
    assert not differences(a, a)
    assert bool(differences(a, b)) == (json.dumps(a, sort_keys=True) != json.dumps(b, sort_keys=True))


def test_differences_name_the_place():
    a, b = {"maps": ["a", "b"], "n": {"x": 1}, "old": 0}, {"maps": ["a", "c"], "n": {"x": 2}, "new": 0}
    assert differences(a, b) == [
        'maps[1]: "b", not "c"',
        "n.x: 1, not 2",
        "new: only the second has it (0)",
        "old: only the first has it (0)",
    ]


@pytest.mark.parametrize("value", [float("nan"), {1, 2}, np.int64(3), "\x1b[2J", 10**40])
def test_a_spec_takes_only_json(value):
    with pytest.raises(TaskliftError, match="JSON"):
        Spec.of("a", {"x": value}, {"seed": [0]})


# ---------------------------------------------------------------- packing

columns = st.one_of(
    hnp.arrays(st.sampled_from([np.int64, np.int16, np.uint8, np.uint32]), hnp.array_shapes(max_dims=2, min_side=0)),
    hnp.arrays(st.sampled_from([np.float64, np.float32]), hnp.array_shapes(max_dims=3)),
    hnp.arrays(np.bool_, st.integers(0, 9)),
)


@given(st.dictionaries(st.text(max_size=4), columns, max_size=4))
@settings(deadline=None, derandomize=True)
def test_packing_keeps_every_value(arrays):
    found = unpack(pack(arrays))
    assert list(found) == list(arrays)
    for name, array in arrays.items():
        assert found[name].dtype in (np.bool_, np.int64, np.float64)
        np.testing.assert_array_equal(found[name], array)


def test_a_hundred_trials_are_small():
    rng = np.random.default_rng(0)
    size = len(pack({"steps": rng.integers(50, 600, 100), "losses": rng.integers(0, 16, 100)}))
    assert size < 400


@pytest.mark.parametrize("bad", [np.array(["a"]), np.array([1j]), np.array([2**63], dtype=np.uint64)])
def test_what_cannot_be_packed_is_named(bad):
    with pytest.raises(TaskliftError, match="'x'"):
        pack({"x": bad})


def test_columns_of_a_stage_are_equally_long():
    with pytest.raises(TaskliftError, match="target"):
        CellResult({"target": {"a": np.arange(3), "b": np.arange(4)}})


# ---------------------------------------------------------------- run and resume


def test_what_is_stored_is_what_the_work_gave(whole):
    with Store.read(whole) as store:
        assert store.done() == set(CELLS)
        for cell in CELLS[::7]:
            assert same(store.result(cell), work(cell))
            assert same(recompute(store, cell, work), work(cell))


@given(st.sets(st.integers(0, len(CELLS) - 1)), st.integers(1, 3))
@settings(deadline=None, derandomize=True, max_examples=10)
def test_a_resumed_run_computes_only_what_is_missing(first, workers):
    done = []

    def counted(cell):
        done.append(cell)
        return work(cell)

    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "experiment.sqlite"
        with Store.open(path, SPEC) as store:
            run(store, [CELLS[i] for i in sorted(first)], counted, workers=workers)
        with Store.open(path, SPEC) as store:
            counts = []
            ran = run(store, CELLS, counted, workers=workers, progress=lambda *args: counts.append(args[:2]))
            assert counts == [(i, len(CELLS)) for i in range(len(first) + 1, len(CELLS) + 1)]
            assert ran.computed == len(CELLS) - len(first)
            assert sorted(done) == sorted(CELLS)
            one = store.digest()
        with Store.open(Path(folder) / "other.sqlite", SPEC) as store:
            run(store, CELLS[::-1], work, workers=1)
            assert store.digest() == one


def test_arms_of_one_seed_run_one_after_another_in_one_thread(tmp_path):
    seen = {}

    def watched(cell):
        seen.setdefault(cell.group, []).append((cell["arm"], threading.current_thread().name))
        return work(cell)

    with Store.open(tmp_path / "e.sqlite", SPEC) as store:
        run(store, CELLS, watched, workers=3)
    for visits in seen.values():
        assert [arm for arm, _ in visits] == ["direct", "copy"]
        assert len({thread for _, thread in visits}) == 1


def test_ctrl_c_commits_what_is_in_flight_and_says_how_to_go_on(tmp_path, digest):
    notes = []

    def progress(done, total, note):
        notes.append(note)
        if done == 7 and len(notes) == 7:
            signal.raise_signal(signal.SIGINT)

    before = signal.getsignal(signal.SIGINT)
    with Store.open(tmp_path / "e.sqlite", SPEC) as store:
        with pytest.raises(Interrupted, match=r"of 48 cells are in .*the same command"):
            run(store, CELLS, work, workers=2, progress=progress)
        assert 7 <= len(store) < len(CELLS)
        assert any("stopping" in note for note in notes)
        assert signal.getsignal(signal.SIGINT) is before
        run(store, CELLS, work, workers=2)
        assert store.digest() == digest


def test_an_error_names_the_cell_and_keeps_the_rest(tmp_path):
    bad = CELLS[20]

    def failing(error, cell):
        if cell == bad:
            raise error
        return work(cell)

    with Store.open(tmp_path / "e.sqlite", SPEC) as store:
        with pytest.raises(TaskliftError, match=f"cell {bad}: no door"):
            run(store, CELLS, partial(failing, TaskliftError("no door")), workers=2)
        assert 0 < len(store) < len(CELLS)
        with pytest.raises(ZeroDivisionError) as caught:
            run(store, CELLS, partial(failing, ZeroDivisionError()), workers=2)
        assert str(bad) in caught.value.__notes__[0]
        run(store, CELLS, work)
        assert len(store) == len(CELLS)


def test_work_that_is_no_function_of_the_cell_is_refused(tmp_path):
    with Store.open(tmp_path / "e.sqlite", SPEC) as store:
        cell = CELLS[0]
        assert store.add(Packed.of(cell, work(cell)))
        assert not store.add(Packed.of(cell, work(cell)))
        with pytest.raises(TaskliftError, match="another result"):
            store.add(Packed.of(cell, CellResult(summary={"steps": 1})))
        assert same(store.result(cell), work(cell))


@pytest.mark.parametrize(
    ("options", "match"),
    [({"engine": "dask"}, "threads"), ({"workers": 0}, "at least 1"), ({"address": "auto"}, "--engine ray")],
)
def test_bad_options_are_named(tmp_path, options, match):
    with Store.open(tmp_path / "e.sqlite", SPEC) as store, pytest.raises(TaskliftError, match=match):
        run(store, CELLS, work, **options)


def test_results_that_cannot_be_stored_are_named(tmp_path):
    with (
        Store.open(tmp_path / "e.sqlite", SPEC) as store,
        pytest.raises(TaskliftError, match=r"cell .* stored"),
    ):
        run(store, CELLS[:1], lambda cell: CellResult(summary={"x": float("nan")}))


# ---------------------------------------------------------------- killed, crowded, full, damaged


def start(path, delay, detail="rows"):
    return subprocess.Popen(
        [sys.executable, str(SCRIPT), str(path), str(delay), detail],
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
    )


def kill_and_resume(path, rng, kills):
    """Kill runs at random moments, then let one finish; return how many were really killed."""
    killed = 0
    for _ in range(kills):
        process = start(path, 0.03)
        while not path.exists() and process.poll() is None:
            time.sleep(0.002)
        time.sleep(rng.uniform(0, 0.25))
        process.kill()
        process.communicate()
        killed += process.returncode == -signal.SIGKILL
    process = start(path, 0)
    _, errors = process.communicate()
    assert process.returncode == 0, errors.decode()
    return killed


@pytest.mark.parametrize("rounds", [1, pytest.param(4, marks=pytest.mark.slow)])
def test_killed_runs_resume_to_the_same_rows(tmp_path, digest, rounds):
    """5 kills in every run of the tests, 20 in the slow ones."""
    rng = np.random.default_rng(rounds)
    killed = 0
    for i in range(rounds):
        path = tmp_path / f"{i}.sqlite"
        killed += kill_and_resume(path, rng, 5)
        with Store.read(path) as store:
            assert store.digest() == digest
    print(f"{killed} of {5 * rounds} runs killed; all went on to the same rows")
    assert killed >= 4 * rounds


def test_ctrl_c_in_a_process(tmp_path, digest):
    path = tmp_path / "e.sqlite"
    process = start(path, 0.03)
    while not path.exists():
        time.sleep(0.002)
    time.sleep(0.2)
    process.send_signal(signal.SIGINT)
    _, errors = process.communicate()
    assert b"the same command goes on" in errors
    assert process.returncode != 0
    assert not path.with_name("e.sqlite-wal").exists()
    process = start(path, 0)
    process.communicate()
    assert process.returncode == 0
    with Store.read(path) as store:
        assert store.digest() == digest


def test_two_processes_share_a_store(tmp_path, digest):
    path = tmp_path / "e.sqlite"
    both = [start(path, 0.01), start(path, 0.01)]
    errors = [process.communicate()[1].decode() for process in both]
    assert [process.returncode for process in both] == [0, 0], errors
    with Store.read(path) as store:
        assert store.digest() == digest
        assert len(store) == len(CELLS)


def test_another_experiment_is_refused_and_nothing_touched(whole):
    before = whole.read_bytes()
    other = Spec.of("test", {**SPEC.settings, "trials": 31}, SPEC.axes)
    with pytest.raises(TaskliftError, match=r"trials: 30, not 31.*nothing was touched"):
        Store.open(whole, other)
    with pytest.raises(TaskliftError, match="detail 'rows', not 'summary'"):
        Store.open(whole, SPEC, detail="summary")
    assert whole.read_bytes() == before


@pytest.mark.parametrize("opening", [lambda p: Store.open(p, SPEC), Store.read])
def test_files_that_are_not_ours_or_newer_are_refused(tmp_path, whole, opening):
    newer, foreign, text = tmp_path / "newer.sqlite", tmp_path / "foreign.sqlite", tmp_path / "text.sqlite"
    newer.write_bytes(whole.read_bytes())
    with sqlite3.connect(newer) as db:
        db.execute("PRAGMA user_version = 3")
    db.close()
    with sqlite3.connect(foreign) as db:
        db.execute("CREATE TABLE t (x)")
    db.close()
    text.write_text("not a database, but longer than a header would be. " * 40)
    for path, match in ((newer, "newer tasklift"), (foreign, "another program"), (text, "not an experiment")):
        before = path.read_bytes()
        with pytest.raises(TaskliftError, match=match):
            opening(path)
        assert path.read_bytes() == before


def test_missing_places_are_named(tmp_path):
    with pytest.raises(TaskliftError, match="no such experiment"):
        Store.read(tmp_path)
    with pytest.raises(TaskliftError, match="no such folder"):
        Store.open(tmp_path / "no" / "e.sqlite", SPEC)
    (tmp_path / "empty.sqlite").touch()
    with pytest.raises(TaskliftError, match="empty"):
        Store.read(tmp_path / "empty.sqlite")
    with Store.open(tmp_path / "empty.sqlite", SPEC) as store:
        assert len(store) == 0


def test_damage_is_noticed_never_read(tmp_path, whole):
    """A flipped byte anywhere: one clear error, or (in unused space) the same results."""
    raw = whole.read_bytes()
    with Store.read(whole) as store:
        good = list(store.select(attachments=True))
    rng = np.random.default_rng(2)
    path = tmp_path / "e.sqlite"
    lines = []
    for position in rng.integers(0, len(raw), 120):
        damaged = bytearray(raw)
        damaged[position] ^= int(rng.integers(1, 256))
        path.write_bytes(damaged)
        try:
            with Store.read(path) as store:
                found = list(store.select(attachments=True))
        except TaskliftError as error:
            lines.append(str(error))
        else:
            assert [cell for cell, _ in found] == [cell for cell, _ in good], position
            assert all(same(a, b) for (_, a), (_, b) in zip(found, good, strict=True)), position
    assert len(lines) > 60
    assert all(line.startswith(str(path)) and "\n" not in line for line in lines)
    path.write_bytes(raw[: len(raw) // 2])
    with pytest.raises(TaskliftError, match="damaged"), Store.read(path) as store:
        list(store.select())


def test_pages_that_point_astray_are_noticed(tmp_path, whole):
    """Twice the same child in the tree of cells would repeat some cells and lose others."""
    raw = bytearray(whole.read_bytes())
    with sqlite3.connect(whole) as db:
        (page,) = db.execute("SELECT rootpage FROM sqlite_master WHERE name = 'cells'").fetchone()
        (size,) = db.execute("PRAGMA page_size").fetchone()
    db.close()
    start = (page - 1) * size
    assert raw[start] == 0x05  # an inner page; its cells begin with the number of a child page
    first, second = (start + int.from_bytes(raw[start + at : start + at + 2]) for at in (12, 14))
    raw[second : second + 4] = raw[first : first + 4]
    (tmp_path / "e.sqlite").write_bytes(raw)
    for opening in (Store.read, lambda path: Store.open(path, SPEC)):
        with pytest.raises(TaskliftError, match="damaged"):
            opening(tmp_path / "e.sqlite")


def in_a_process(code, folder):
    """Run code in another process, with `folder` as its argument; return its output."""
    here = os.pathsep.join([str(SCRIPT.parent), *filter(None, sys.path)])
    done = subprocess.run(
        [sys.executable, "-c", code, str(folder)], capture_output=True, text=True,
        env={**os.environ, "PYTHONPATH": here, "PYTHONDONTWRITEBYTECODE": "1"},
    )  # fmt: skip
    assert done.returncode == 0, done.stderr
    return done.stdout


def test_a_full_disk_loses_nothing(tmp_path, digest):
    """A limit on file size stands for the full disk; SQLite meets the same failure to write."""
    code = """
import resource, sys
from lab_work import *
resource.setrlimit(resource.RLIMIT_FSIZE, (90_000, 90_000))
try:
    with Store.open(sys.argv[1] + "/e.sqlite", SPEC) as store:
        run(store, CELLS, work)
except ValueError as error:
    print(type(error).__name__, error)
"""
    out = in_a_process(code, tmp_path)
    assert out.startswith("TaskliftError")
    assert "what was committed is safe" in out
    with Store.open(tmp_path / "e.sqlite", SPEC) as store:
        assert 0 < len(store) < len(CELLS)
        for cell, result in store.select(attachments=True):
            assert same(result, work(cell))
        run(store, CELLS, work)
        assert store.digest() == digest


def test_a_read_only_folder_can_be_read_and_refuses_to_run(whole, digest):
    code = """
import os, sys
from lab_work import *
if os.geteuid() == 0:  # who may write anywhere
    os.setuid(65534)
folder = sys.argv[1]
with Store.open(f"{folder}/experiment.sqlite", SPEC) as store:  # everything is there
    run(store, CELLS, work)
    print(store.digest())
for name in ("experiment.sqlite", "new.sqlite"):
    try:
        with Store.open(f"{folder}/{name}", Spec.of("test", SPEC.settings, {**AXES, "seed": range(7)})) as store:
            run(store, store.spec.cells(), work)
    except ValueError as error:
        print(type(error).__name__, error)
"""
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        (folder / "experiment.sqlite").write_bytes(whole.read_bytes())
        (folder / "experiment.sqlite").chmod(0o444)
        folder.chmod(0o555)
        lines = in_a_process(code, folder).splitlines()
        folder.chmod(0o755)
    assert lines[0] == digest
    assert len(lines) == 3
    assert all(line.startswith("TaskliftError") and "choose another --out" in line for line in lines[1:])


# ---------------------------------------------------------------- summaries, curves, runs


def test_a_store_of_summaries_recomputes_any_cell(tmp_path):
    with Store.open(tmp_path / "e.sqlite", SPEC, detail="summary") as store:
        run(store, CELLS, work)
        cell = CELLS[9]
        assert not store.result(cell).stages
        assert same(recompute(store, cell, work), work(cell))
        with pytest.raises(TaskliftError, match="another summary"):
            recompute(store, cell, lambda cell: CellResult(summary={"steps": 1.0}))
        with pytest.raises(TaskliftError, match="keeps none"):
            store.curves("target", "steps")
        assert store.summaries("losses", arm="copy").values.shape == (24, 1)


def test_curves_come_in_one_order_so_that_arms_pair(whole):
    with Store.read(whole) as store:
        copy = store.curves("target", "steps", reading="scattered", arm="copy")
        direct = store.curves("target", "steps", reading="scattered", arm="direct")
        assert copy.values.shape == (12, 30)
        assert copy.paired_with(direct, over=["map", "seed"])
        assert copy.column("map").tolist() == ["a"] * 6 + ["b"] * 6
        for row, cell in zip(copy.values, copy.cells, strict=True):
            assert row.tolist() == work(cell).stages["target"]["steps"].tolist()
        losses = store.summaries("losses", reading="scattered", arm="copy")
        assert losses.cells == copy.cells
        assert np.isnan(store.summaries("time_to").values).all()
        for call in (
            lambda: store.curves("target", "speed"),
            lambda: store.curves("drill", "steps"),
            lambda: store.summaries("speed"),
            lambda: store.result(Cell(reading="x", map="a", seed=0, arm="copy")),
        ):
            with pytest.raises(TaskliftError, match=str(whole)):
                call()


def test_curves_that_ended_early_are_padded_on_request(tmp_path):
    def capped(cell):
        return CellResult({"target": {"steps": np.arange(3 + int(cell["seed"]))}})

    spec = Spec.of("capped", {}, {"seed": range(2)})
    with Store.open(tmp_path / "e.sqlite", spec) as store:
        run(store, spec.cells(), capped)
        with pytest.raises(TaskliftError, match="pad="):
            store.curves("target", "steps")
        values = store.curves("target", "steps", pad=600).values
        assert values.tolist() == [[0, 1, 2, 600], [0, 1, 2, 3]]


@pytest.mark.parametrize("what", ["trials", "cells"])
def test_csv_and_parquet_hold_every_row(tmp_path, whole, what):
    parquet = pytest.importorskip("pyarrow.parquet")
    rows = runs.export(whole, tmp_path / "out.csv", what=what)
    assert runs.export(whole, tmp_path / "out.parquet", what=what) == rows
    with open(tmp_path / "out.csv", newline="") as file:
        text = list(csv.DictReader(file))
    table = parquet.read_table(tmp_path / "out.parquet").to_pylist()
    assert rows == len(text) == len(table) == (len(CELLS) * 38 if what == "trials" else len(CELLS))
    for a, b in zip(text, table, strict=True):
        assert a == {key: "" if value is None else str(value) for key, value in b.items()}
    assert {row["spec"] for row in table} == {SPEC.id[:12]}
    if what == "trials":
        found = [r["steps"] for r in table if (r["reading"], r["map"], r["seed"], r["arm"], r["stage"])
                 == ("cohesive", "b", 4, "copy", "target")]  # fmt: skip
        assert found == work(Cell(reading="cohesive", map="b", seed=4, arm="copy")).stages["target"]["steps"].tolist()
        assert {row["trial"] for row in table if row["stage"] == "sweep"} == set(range(1, 9))
    assert list(tmp_path.glob(".*")) == []


def test_exports_that_cannot_be_are_named(tmp_path, whole):
    with pytest.raises(TaskliftError, match=r"\.csv"):
        runs.export(whole, tmp_path / "out.xlsx")
    with pytest.raises(TaskliftError, match="cells"):
        runs.export(whole, tmp_path / "out.csv", what="rows")
    with pytest.raises(TaskliftError, match="does not exist"):
        runs.export(whole, tmp_path / "no" / "out.csv")
    (tmp_path / "out.csv").write_text("mine")
    with pytest.raises(TaskliftError, match="--force"):
        runs.export(whole, tmp_path / "out.csv", force=False)
    assert (tmp_path / "out.csv").read_text() == "mine"


def test_runs_are_found_and_shown(tmp_path, whole):
    for name in ("one", "two", "bad"):
        (tmp_path / name).mkdir()
    (tmp_path / "one" / "experiment.sqlite").write_bytes(whole.read_bytes())
    (tmp_path / "bad" / "experiment.sqlite").write_text("x" * 5000)
    with Store.open(tmp_path / "two" / "experiment.sqlite", SPEC) as store, pytest.raises(ZeroDivisionError):
        run(store, CELLS, lambda cell: work(cell) if int(cell["seed"]) < 4 else 1 / 0, workers=1)
    table = runs.find(tmp_path)
    assert [row[0] for row in table.rows] == ["bad", "one", "two"]
    assert "damaged" in table.rows[0][1]
    assert table.rows[1][3] == "48 of 48"
    assert table.rows[2][3] != "48 of 48"
    assert table.rows[2][3].endswith("of 48")
    facts, means = runs.show(tmp_path / "one")
    assert ["settings.trials", "30"] in facts.rows
    assert means.headers == ["reading", "arm", "cells", "losses", "steps"]
    expected = np.mean([work(c).summary["losses"] for c in CELLS if c["reading"] == "cohesive" and c["arm"] == "copy"])
    (row,) = [row for row in means.rows if row[:2] == ["cohesive", "copy"]]
    assert row[2:4] == [12, pytest.approx(expected)]


def test_runs_are_compared_by_pairs(tmp_path, whole):
    changed = Spec.of("test", {**SPEC.settings, "trials": 31}, SPEC.axes)

    def shifted(cell):
        return CellResult(summary={"steps": work(cell).summary["steps"] + 10})

    with Store.open(tmp_path / "e.sqlite", changed) as store:
        run(store, CELLS[:40], shifted)
    settings_, table = runs.compare(whole, tmp_path / "e.sqlite")
    assert settings_.rows == [["trials: 30, not 31"]]
    assert {row[2] for row in table.rows} == {"steps"}
    assert all(row[5].startswith("10 (no interval") for row in table.rows)  # the same in every seed
    assert sum(row[6] for row in table.rows) == 40
    (arms,) = runs.compare(whole, between=("arm", "direct", "copy"))
    assert {row[1] for row in arms.rows} == {"steps", "losses"}
    assert arms.headers == ["reading", "summary", "direct", "copy", "difference [95 %]", "pairs", "p (Holm)", "verdict"]
    assert all(0 < row[-2] <= 1 for row in arms.rows)
    assert all((row[-1] == "differs") == (row[-2] <= 0.05) for row in arms.rows)
    with pytest.raises(TaskliftError, match="no cells in common"):
        runs.compare(whole, between=("arm", "direct", "drill"))
    with pytest.raises(TaskliftError, match="give two"):
        runs.compare(whole)
