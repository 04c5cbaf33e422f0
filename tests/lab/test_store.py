"""The experiment file: damaged, of another time, hostile, left by a kill; and experiments that grow."""

from __future__ import annotations

import sqlite3
import zlib
from functools import partial

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from lab_work import AXES, CELLS, SPEC, work

import tasklift
from tasklift.errors import TaskliftError
from tasklift.lab import Cell, CellResult, Spec, Store, grid, run, runs
from tasklift.lab.cell import in_order
from tasklift.lab.packing import MOST_VALUES, Packed, pack, unpack


@pytest.fixture(scope="module")
def whole(tmp_path_factory):
    """A store that ran without a break."""
    path = tmp_path_factory.mktemp("whole") / "experiment.sqlite"
    with Store.open(path, SPEC) as store:
        run(store, CELLS, work, workers=1)
    return path


def change(path, *statements):
    """Change a store behind the laboratory's back."""
    with sqlite3.connect(path) as db:
        for statement in statements:
            db.execute(statement)
    db.close()


# ---------------------------------------------------------------- cells

names = st.from_regex(r"ax[a-z0-9]{0,5}", fullmatch=True)
values = st.one_of(st.integers(-20, 20), st.from_regex(r"[a-z]{0,3}-?[0-9]{1,3}", fullmatch=True))


@given(st.dictionaries(names, st.lists(values, min_size=1, max_size=4, unique_by=str), min_size=1, max_size=3))
@settings(deadline=None, derandomize=True, max_examples=50)
def test_a_grid_has_every_combination_once_and_the_last_axis_varies_fastest(axes):
    cells = grid(**axes)
    assert len(cells) == len(set(cells)) == np.prod([len(of) for of in axes.values()])
    assert cells[0].axes == {name: str(of[0]) for name, of in axes.items()}
    last = list(map(str, list(axes.values())[-1]))
    assert [cell.values[-1] for cell in cells[: len(last)]] == last
    assert all(cell == Cell(**cell.axes) and hash(cell) == hash(Cell(**cell.axes)) for cell in cells)
    assert all(cell.group == cell.values[:-1] for cell in cells)


def test_numbers_sort_as_numbers():
    mixed = ["map-10", "map-9", "b", "10", "9", "-1", "0.25", "0.3", "map-9b"]
    assert in_order(mixed) == ["-1", "0.25", "0.3", "9", "10", "b", "map-9", "map-9b", "map-10"]
    cells = [Cell(map=m, seed=s) for m in ("map-2", "map-10") for s in (9, 10)]
    backwards = cells[::-1]
    backwards.sort()
    assert backwards == cells


@pytest.mark.parametrize(
    ("axes", "match"),
    [
        ({}, "at least one axis"),
        ({"seed": True}, "whole number, or a printable text"),
        ({"seed": 1.5}, "whole number, or a printable text"),
        ({"seed": ""}, "1 to 100 characters"),
        ({"arm": "a" * 101}, "1 to 100 characters"),
        ({"arm": "a\nb"}, "printable"),
        ({"Arm": "a"}, "lower case"),
        ({"summary": "a"}, "none of"),
    ],
)
def test_axes_and_values_that_cannot_be_are_named(axes, match):
    with pytest.raises(TaskliftError, match=match):
        Cell(**axes)


def test_axes_that_a_cell_or_a_store_lacks_are_named(whole):
    with pytest.raises(TaskliftError, match=r"no axis 'hostiles'.*reading, map, seed, arm"):
        CELLS[0]["hostiles"]
    with Store.read(whole) as store, pytest.raises(TaskliftError, match=r"no axis 'hostiles'.*reading, map, seed, arm"):
        list(store.select(hostiles=1))
    with pytest.raises(TaskliftError, match="no axis 'hostiles'"):
        runs.show(whole, over=["hostiles"])


# ---------------------------------------------------------------- experiments that grow


def test_more_seeds_compute_only_what_is_new_and_fewer_read_only_theirs(tmp_path):
    done = []

    def counted(cell):
        done.append(cell)
        return work(cell)

    path = tmp_path / "e.sqlite"
    digests = {}
    for seeds in (2, 5, 3):
        spec = Spec.of("test", SPEC.settings, {**AXES, "seed": range(seeds)}, over=SPEC.over)
        assert spec.id == SPEC.id
        with Store.open(path, spec) as store:
            ran = run(store, spec.cells(), counted, workers=1)
            assert ran.total == len(store) == len(store.done()) == 8 * seeds
            assert store.curves("target", "steps", arm="copy").values.shape == (4 * seeds, 30)
            assert set(store.curves("target", "steps").column("seed")) == set(map(str, range(seeds)))
            digests[seeds] = store.digest()
        with Store.open(tmp_path / f"{seeds}.sqlite", spec) as alone:
            run(alone, spec.cells(), work, workers=1)
            assert alone.digest() == digests[seeds]
    assert len(done) == len(set(done)) == 8 * 5
    with Store.read(path) as store:
        assert len(store) == store.planned == 8 * 5
        assert list(store.spec.axes["seed"]) == list("01234")


def test_more_maps_and_arms_may_be_added_but_none_may_change(tmp_path):
    path = tmp_path / "e.sqlite"
    more = {**AXES, "map": {"b": "e0", "c": "11"}, "arm": ["copy", "prior"]}
    with Store.open(path, SPEC) as store:
        run(store, CELLS, work, workers=1)
    with Store.open(path, Spec.of("test", SPEC.settings, more)) as store:
        assert len(store) == 2 * 6
        assert run(store, store.spec.cells(), work, workers=1).computed == 48 - 12
    before = path.read_bytes()
    other = {**AXES, "map": {"b": "5" * 64, "d": "11"}}
    with pytest.raises(TaskliftError, match="map b: "):
        Store.open(path, Spec.of("test", SPEC.settings, other))
    with pytest.raises(TaskliftError, match="axes reading, map, seed, arm, not seed"):
        Store.open(path, Spec.of("test", SPEC.settings, {"seed": [0]}))
    assert path.read_bytes() == before


def test_an_unchanged_plan_leaves_the_file_as_it_is(whole):
    before = whole.read_bytes()
    with Store.open(whole, SPEC) as store:
        assert run(store, CELLS, lambda cell: 1 / 0).computed == 0
    assert whole.read_bytes() == before


def test_cells_of_other_axes_are_refused_before_anything_is_computed(tmp_path):
    with Store.open(tmp_path / "e.sqlite", SPEC) as store:
        for cell in (Cell(seed=0), Cell(**{**CELLS[0].axes, "arm": "pzior"})):
            with pytest.raises(TaskliftError, match="not of this experiment"):
                run(store, [*CELLS, cell], work)
        assert len(store) == 0


def test_what_differs_is_said_in_words_and_one_short_line(tmp_path):
    long = {f"setting_{i}": {"value": ["x" * 50, i]} for i in range(9)} | {"digest": "a" * 64}
    path = tmp_path / "e.sqlite"
    Store.open(path, Spec.of("long", long, {"seed": [0]})).close()
    changed = {**{key: {"value": ["y" * 50, -1]} for key in long}, "digest": "b" * 64}
    with pytest.raises(TaskliftError) as caught:
        Store.open(path, Spec.of("long", changed, {"seed": [0]}))
    line = str(caught.value)
    assert len(line) <= 300
    assert "digest: another one" in line
    assert "a" * 20 not in line
    assert "and " in line
    assert line.endswith("give its settings")


# ---------------------------------------------------------------- damaged


DAMAGE = {
    "a summary": """UPDATE cells SET summary = replace(summary, '"losses":', '"losses":1') WHERE id = 7""",
    "the checksum": "UPDATE cells SET crc = crc + 1 WHERE id = 7",
    "an axis": "UPDATE cells SET arm = 'pzior' WHERE id = 7",
    "the contents": "UPDATE cells SET contents = replace(contents, '1', '2') WHERE id = 7",
    "a number of trials": "UPDATE trials SET n = 29 WHERE cell = 7 AND stage = 'target'",
    "a stage": "DELETE FROM trials WHERE cell = 7 AND stage = 'target'",
    "its name": "UPDATE trials SET stage = 'tarqet' WHERE cell = 7 AND stage = 'target'",
    "the columns": "UPDATE trials SET columns = (SELECT columns FROM trials WHERE cell = 8 AND stage = 'target') "
    "WHERE cell = 7 AND stage = 'target'",
    "an attachment": "UPDATE attachments SET data = '{}' WHERE cell = 7 AND name = 'note'",
    "its kind": "UPDATE attachments SET data = CAST(data AS BLOB) WHERE cell = 7 AND name = 'note'",
    "another type": "UPDATE cells SET summary = x'00ff' WHERE id = 7",
}


@pytest.mark.parametrize("what", DAMAGE)
def test_damage_is_named_and_a_run_mends_it(tmp_path, whole, what):
    path = tmp_path / "e.sqlite"
    path.write_bytes(whole.read_bytes())
    change(path, DAMAGE[what])
    asked = {
        "select": lambda store: list(store.select(attachments=True)),
        "curves": lambda store: store.curves("target", "steps"),
        "outlines": lambda store: list(store.outlines()),
        "summaries": lambda store: store.summaries("steps"),
        "done": lambda store: store.done(),
        "digest": lambda store: store.digest(),
    }
    reads_rows = {"select", "digest"} | ({"curves"} if "attachment" not in what and "kind" not in what else set())
    concerned = set(asked) if DAMAGE[what].startswith("UPDATE cells") else reads_rows
    refusing = set()
    with Store.read(path) as store:
        for name, read in asked.items():
            try:
                read(store)
            except TaskliftError as error:
                assert "is damaged" in str(error)  # noqa: PT017
                refusing.add(name)
    assert refusing == concerned
    notes = []
    with Store.open(path, SPEC) as store:
        assert run(store, CELLS, work, workers=1, progress=lambda done, total, note: notes.append(note)).computed == 1
        digest = store.digest()
    assert notes[0].startswith("1 damaged")
    with Store.read(whole) as store:
        assert store.digest() == digest


def test_reading_commands_refuse_a_damaged_summary(tmp_path, whole):
    path = tmp_path / "e.sqlite"
    path.write_bytes(whole.read_bytes())
    change(path, DAMAGE["a summary"])
    for read in (
        lambda: runs.show(path),
        lambda: runs.compare(path, between=("arm", "direct", "copy")),
        lambda: runs.compare(whole, path),
        lambda: runs.export(path, tmp_path / "c.csv", what="cells"),
        lambda: runs.export(path, tmp_path / "t.csv"),
    ):
        with pytest.raises(TaskliftError, match="is damaged"):
            read()
    assert sorted(file.name for file in tmp_path.iterdir()) == ["e.sqlite"]


@pytest.mark.parametrize("key", ["name", "settings", "axes", "over", "detail", "release", "planned", "crc"])
def test_what_the_file_says_of_itself_is_checked(tmp_path, whole, key):
    path = tmp_path / "e.sqlite"
    path.write_bytes(whole.read_bytes())
    change(path, f"UPDATE meta SET value = value || '1' WHERE key = '{key}'")
    for opening in (Store.read, lambda path: Store.open(path, SPEC)):
        with pytest.raises(TaskliftError, match=r"^.*e\.sqlite: damaged"):
            opening(path)


def test_a_view_cannot_take_the_place_of_a_table(tmp_path, whole):
    path = tmp_path / "e.sqlite"
    path.write_bytes(whole.read_bytes())
    endless = "WITH RECURSIVE n(i) AS (SELECT 1 UNION ALL SELECT i FROM n) SELECT i FROM n"
    change(path, "ALTER TABLE cells RENAME TO kept", f"CREATE VIEW cells AS {endless}")
    with pytest.raises(TaskliftError, match="damaged"):
        Store.read(path)


@given(st.integers(0, 2**31))
@settings(deadline=None, derandomize=True, max_examples=60)
def test_a_log_left_by_a_kill_gives_cells_as_they_were_or_not_at_all(tmp_path_factory, seed):
    files = killed(tmp_path_factory)
    rng = np.random.default_rng(seed)
    folder = tmp_path_factory.mktemp("log")
    for name, raw in files.items():
        damaged = bytearray(raw)
        if name.endswith("-wal") or rng.random() < 0.3:
            for _ in range(int(rng.integers(1, 3))):
                damaged[rng.integers(0, len(raw))] = rng.integers(0, 256)
        if rng.random() < 0.2:
            del damaged[rng.integers(0, len(raw)) :]
        if rng.random() < 0.9:
            (folder / name).write_bytes(damaged)
    try:
        with Store.read(folder / "e.sqlite") as store:
            found = [cell.axes for cell, result in store.select() if result.summary == work(cell).summary]
            assert len(found) == len(store)
    except TaskliftError as error:
        assert "e.sqlite" in str(error)  # noqa: PT017


_killed: dict[str, bytes] = {}


def killed(tmp_path_factory) -> dict[str, bytes]:
    """Return the files of a store as a kill leaves them: the last cells are in the log only."""
    if not _killed:
        path = tmp_path_factory.mktemp("killed") / "e.sqlite"
        with Store.open(path, SPEC) as store:
            for cell in CELLS[:20]:
                store.add(Packed.of(cell, work(cell)))
            _killed.update({file.name: file.read_bytes() for file in path.parent.iterdir() if "shm" not in file.name})
        assert set(_killed) == {"e.sqlite", "e.sqlite-wal"}
    return _killed


def test_the_main_file_alone_knows_the_experiment_and_says_what_is_missing(tmp_path, tmp_path_factory):
    files = killed(tmp_path_factory)
    (tmp_path / "e.sqlite").write_bytes(files["e.sqlite"])
    with Store.read(tmp_path / "e.sqlite") as store:
        assert store.spec.id == SPEC.id
        assert len(store) < 20
    (tmp_path / "e.sqlite-wal").write_bytes(files["e.sqlite-wal"])
    with Store.read(tmp_path / "e.sqlite") as store:
        assert store.done() == set(CELLS[:20])


# ---------------------------------------------------------------- of another time


def test_a_store_of_the_old_layout_is_refused_untouched(tmp_path):
    path = tmp_path / "experiment.sqlite"
    change(path, "CREATE TABLE cells (id INTEGER PRIMARY KEY, reading TEXT)", "PRAGMA application_id = 1952543595",
           "PRAGMA user_version = 1")  # fmt: skip
    before = path.read_bytes()
    for opening in (Store.read, lambda path: Store.open(path, SPEC)):
        with pytest.raises(TaskliftError, match=r"layout 1 .* older tasklift; this release reads layout 2"):
            opening(path)
    assert "layout 1" in runs.find(tmp_path).rows[0][1]
    assert path.read_bytes() == before


def test_rows_of_two_releases_do_not_mix(tmp_path, monkeypatch):
    path = tmp_path / "e.sqlite"
    monkeypatch.setattr(tasklift, "__version__", "0.0.9")
    with Store.open(path, SPEC) as store:
        run(store, CELLS[:4], work, workers=1)
    monkeypatch.undo()
    before = path.read_bytes()
    with pytest.raises(TaskliftError, match=r"tasklift 0\.0\.9.*do not mix"):
        Store.open(path, SPEC)
    assert path.read_bytes() == before
    with Store.read(path) as store:
        assert len(store) == 4
        assert store.release == "0.0.9"
    assert ["written by", "tasklift 0.0.9"] in runs.show(path)[0].rows


# ---------------------------------------------------------------- bombs


def packed(header: str, size: int) -> bytes:
    return zlib.compress(header.encode() + b"\n" + bytes(size), 9)


@pytest.mark.parametrize(
    "bomb",
    [
        packed('[["x", "<f8", [1000000000000]]]', 8),
        packed('[["x", "<f8", [1000000, 1000000]]]', 8),
        packed('[["x", "<f8", [0, 1000000000000]]]', 0),
        packed('[["x", "<f8", [-1]]]', 0),
        packed('[["x", "|u1", [100000000]]]', 100_000_000),
        packed('[["x", "<f8", [1]]]', 300_000_000),
        packed('[["x", "|O", [1]]]', 8),
        packed('[["x", "<f8", "11"]]', 88),
        packed('[["x", "<f8"]]', 8),
        packed("[" * 10_000, 8),
        zlib.compress(b"", 9),
    ],
)
def test_bombs_are_refused_before_they_take_memory(tmp_path, whole, bomb):
    path = tmp_path / "e.sqlite"
    path.write_bytes(whole.read_bytes())
    with Store.open(path, SPEC) as store:  # with checksums that fit
        good = Packed.of(CELLS[0], CellResult({"target": {"x": np.arange(3)}}))
        crc = zlib.crc32(bomb, zlib.crc32(b"target\x003\x00bytes\x00"))
        bad = Packed(CELLS[0], "{}", (("target", 3, bomb),), (), f'{{"attachments":{{}},"trials":{{"target":{crc}}}}}')
        assert Packed(good.cell, "{}", good.trials, (), good.contents) == good
        store._db.execute("DELETE FROM trials WHERE cell = 1")
        store._db.execute("DELETE FROM attachments WHERE cell = 1")
        store._db.execute("DELETE FROM cells WHERE id = 1")
        store.add(bad)
    with Store.read(path) as store:
        for read in (
            lambda: list(store.select()),
            lambda: store.curves("target", "x", reading=CELLS[0]["reading"], map=CELLS[0]["map"], seed=0, arm="direct"),
        ):
            with pytest.raises(TaskliftError, match=r"e\.sqlite: damaged"):
                read()


def test_what_is_too_large_is_refused_when_it_is_packed():
    with pytest.raises(ValueError, match="values in one stage"):
        pack({"x": np.broadcast_to(np.uint8(0), MOST_VALUES), "y": np.zeros(1)})
    with pytest.raises(TaskliftError, match="cannot be stored"):
        Packed.of(CELLS[0], CellResult(attachments={"x": np.broadcast_to(np.uint8(0), (MOST_VALUES, 2))}))


@pytest.mark.parametrize("summary", [{"x": float("inf")}, {"x": [1]}, {"x": 2**63}, {"x": "\ud800"}])
def test_summaries_are_scalars(summary):
    with pytest.raises(TaskliftError, match="cannot be stored"):
        Packed.of(CELLS[0], CellResult(summary=summary))


def test_one_column_is_unpacked_alone():
    data = pack({"a": np.arange(3), "b": np.array([True, False])})
    assert list(unpack(data, "b")) == ["b"]
    assert unpack(data, "b")["b"].dtype == np.bool_
    assert unpack(data, "c") == {}


def test_pairs_are_those_of_the_named_axes(whole):
    with Store.read(whole) as store:
        curves = partial(store.curves, "target", "steps", reading="scattered")
        assert curves(arm="copy").paired_with(curves(arm="direct"), over=["map", "seed"])
        assert not curves(arm="copy").paired_with(curves(arm="direct", map="a"), over=["map", "seed"])
        assert not curves(arm="copy", map="b").paired_with(curves(arm="direct", map="a"), over=["map", "seed"])
        assert curves(arm="copy", map="b").paired_with(curves(arm="direct", map="a"), over=["seed"])
