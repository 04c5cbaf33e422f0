"""One SQLite file per experiment: a transaction per cell, so that a kill at any moment loses only open work.

Layout (``application_id`` 0x7461736b, ``user_version`` 1)::

    meta         key, value            the spec (JSON), its id and name, the detail kept
    cells        id, spec, version, reading, map, seed, arm, summary (JSON), crc      one row per cell
    trials       cell, stage, n, columns                              one row per cell and stage, packed
    attachments  cell, name, data                                     TEXT is JSON, BLOB a packed array
    summaries    a view: one row per cell and summary value, for SQL

:mod:`tasklift.lab.packing` says how arrays are packed; :meth:`Store.select` and ``runs export`` unpack them.

The journal is a write-ahead log with ``synchronous = NORMAL``: a killed process loses nothing that was
committed; a power cut may lose the last cells, which a resumed run computes again, and damages nothing.
"""

from __future__ import annotations

import hashlib
import json
import os
import sqlite3
import time
import zlib
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from pathlib import Path
from types import TracebackType
from typing import Any

import numpy as np
from numpy.typing import NDArray

import tasklift
from tasklift.errors import TaskliftError
from tasklift.lab.packing import Detail, Packed, unpack
from tasklift.lab.spec import Cell, CellResult, Spec, differences

FILE_NAME = "experiment.sqlite"

_APPLICATION = 0x7461736B
_VERSION = 1
_SCHEMA = """
CREATE TABLE IF NOT EXISTS meta (key TEXT PRIMARY KEY, value TEXT NOT NULL) WITHOUT ROWID;
CREATE TABLE IF NOT EXISTS cells (id INTEGER PRIMARY KEY, spec TEXT NOT NULL, version TEXT NOT NULL,
  reading TEXT NOT NULL, map TEXT NOT NULL, seed INTEGER NOT NULL, arm TEXT NOT NULL,
  summary TEXT NOT NULL, crc INTEGER NOT NULL, UNIQUE (reading, map, seed, arm));
CREATE TABLE IF NOT EXISTS trials (cell INTEGER NOT NULL REFERENCES cells, stage TEXT NOT NULL,
  n INTEGER NOT NULL, columns BLOB NOT NULL, PRIMARY KEY (cell, stage)) WITHOUT ROWID;
CREATE TABLE IF NOT EXISTS attachments (cell INTEGER NOT NULL REFERENCES cells, name TEXT NOT NULL,
  data NOT NULL, PRIMARY KEY (cell, name)) WITHOUT ROWID;
CREATE VIEW IF NOT EXISTS summaries AS SELECT reading, map, seed, arm, key AS name, value
  FROM cells, json_each(cells.summary);
"""


@contextmanager
def _explained(path: Path) -> Iterator[None]:
    """Turn SQLite's and the codec's errors into one line about the file."""
    try:
        yield
    except (zlib.error, json.JSONDecodeError, UnicodeDecodeError) as error:
        raise TaskliftError(f"{path}: damaged ({error}); restore a copy, or move it away and run again") from error
    except sqlite3.Error as error:
        text = str(error)
        if "full" in text:
            line = "the disk is full; what was committed is safe: free some space and run the same command again"
        elif "disk I/O" in text:
            line = f"cannot be written ({text}: full disk, quota, or failing drive); what was committed is safe"
        elif "readonly" in text or "unable to open" in text:
            line = f"cannot be opened or written ({text}); check folder and permissions, or choose another --out"
        elif "not a database" in text or "malformed" in text or "decode" in text or "no such" in text:
            line = f"damaged, or not an experiment file ({text}); restore a copy, or move it away and run again"
        elif "locked" in text:
            line = "another process holds it for too long; try again when that one is done"
        else:
            line = f"SQLite says: {text}"
        raise TaskliftError(f"{path}: {line}") from error


class Store:
    """An open experiment file. Use :meth:`open` to run, :meth:`read` to look; both are context managers."""

    def __init__(self, path: Path, connection: sqlite3.Connection) -> None:
        self.path = path
        self._db = connection
        self.spec, self.detail = _identity(connection, path)

    @classmethod
    def open(cls, path: str | os.PathLike[str], spec: Spec, *, detail: Detail = "rows") -> Store:
        """Open for writing, and create the file if there is none (its folder must exist).

        Parameters
        ----------
        path
            The file, usually ``FOLDER/experiment.sqlite``.
        detail
            ``"rows"`` keeps everything; ``"summary"`` only the summaries: see :meth:`recompute`.

        Raises
        ------
        TaskliftError
            If the file holds another experiment (the message names what differs; nothing was touched), comes
            from a newer release, is damaged, or cannot be written.
        """
        where = Path(path)
        if not where.parent.is_dir():
            raise TaskliftError(f"{where.parent}: no such folder; create it first")
        with _explained(where):
            connection = sqlite3.connect(where, timeout=60, isolation_level=None)
            try:
                if not _is_empty(connection, where):
                    _refuse_another(connection, where, spec, detail)
                _write_ahead(connection)
                connection.execute("BEGIN IMMEDIATE")
                for statement in _SCHEMA.split(";\n"):
                    connection.execute(statement)
                connection.execute(f"PRAGMA application_id = {_APPLICATION}")
                connection.execute(f"PRAGMA user_version = {_VERSION}")
                rows = {"spec": spec.canonical, "spec_id": spec.id, "name": spec.name, "detail": detail}
                connection.executemany("INSERT OR IGNORE INTO meta VALUES (?, ?)", rows.items())
                connection.execute("COMMIT")
                _refuse_another(connection, where, spec, detail)  # two processes may have created it at once
                return cls(where, connection)
            except BaseException:
                connection.close()
                raise

    @classmethod
    def read(cls, path: str | os.PathLike[str]) -> Store:
        """Open an existing file, or the one in a folder, for reading only."""
        where = Path(path)
        where = where / FILE_NAME if where.is_dir() else where
        if not where.is_file():
            raise TaskliftError(f"{where}: no such experiment; `tasklift runs list FOLDER` shows which there are")
        with _explained(where):
            connection = _connect_to_read(where)
            try:
                if _is_empty(connection, where):
                    raise TaskliftError(f"{where}: an empty experiment file; run the experiment first")
                return cls(where, connection)
            except BaseException:
                connection.close()
                raise

    def close(self) -> None:
        """Close the file; the last one to close it folds the write-ahead log into it."""
        with _explained(self.path):
            self._db.close()

    def __enter__(self) -> Store:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()

    # ------------------------------------------------------------ writing

    def plan(self, total: int) -> None:
        """Note how many cells the latest run asked for, for those who look at an unfinished experiment."""
        with _explained(self.path):
            self._db.execute("INSERT OR REPLACE INTO meta VALUES ('planned', ?)", (str(total),))

    def add(self, packed: Packed) -> bool:
        """Commit one cell in one transaction. False if it was there already, with the same content.

        Raises
        ------
        TaskliftError
            If it was there with other content, so the work is not a function of the cell; the old one stays.
        """
        cell, crc = packed.cell, packed.crc
        with _explained(self.path):
            self._db.execute("BEGIN IMMEDIATE")
            try:
                cursor = self._db.execute(
                    "INSERT OR IGNORE INTO cells (spec, version, reading, map, seed, arm, summary, crc) "
                    "VALUES (?, ?, ?, ?, ?, ?, ?, ?)",
                    (self.spec.id, tasklift.__version__, *_key(cell), packed.summary, crc),
                )
                if cursor.rowcount:
                    key = cursor.lastrowid
                    self._db.executemany(
                        "INSERT INTO trials VALUES (?, ?, ?, ?)", [(key, *row) for row in packed.trials]
                    )
                    self._db.executemany(
                        "INSERT INTO attachments VALUES (?, ?, ?)",
                        [(key, *row) for row in packed.attachments],
                    )
                self._db.execute("COMMIT")
            except BaseException:
                with suppress(sqlite3.Error):  # a failed COMMIT may have rolled back by itself
                    self._db.execute("ROLLBACK")
                raise
            if cursor.rowcount:
                return True
            (there,) = self._db.execute(f"SELECT crc FROM cells WHERE {_WHERE}", _key(cell)).fetchone()
        if there != crc:
            raise TaskliftError(
                f"{self.path}: cell {cell} is there with another result; the work must depend on the cell "
                "alone, or the file comes from another release: choose another --out"
            )
        return False

    # ------------------------------------------------------------ reading

    def done(self) -> set[Cell]:
        """The cells that are there."""
        with _explained(self.path):
            return {Cell(*row) for row in self._db.execute("SELECT reading, map, seed, arm FROM cells")}

    def __contains__(self, cell: Cell) -> bool:
        with _explained(self.path):
            return self._db.execute(f"SELECT 1 FROM cells WHERE {_WHERE}", _key(cell)).fetchone() is not None

    def __len__(self) -> int:
        with _explained(self.path):
            (count,) = self._db.execute("SELECT count(*) FROM cells").fetchone()
            return int(count)

    @property
    def planned(self) -> int | None:
        """How many cells the latest run asked for."""
        with _explained(self.path):
            found = self._db.execute("SELECT value FROM meta WHERE key = 'planned'").fetchone()
            return int(found[0]) if found else None

    def origins(self) -> dict[Cell, str]:
        """The release of tasklift that computed each cell."""
        with _explained(self.path):
            rows = self._db.execute("SELECT reading, map, seed, arm, version FROM cells")
            return {Cell(*row[:4]): row[4] for row in rows}

    def select(
        self,
        *,
        reading: str | None = None,
        map: str | None = None,
        seed: int | None = None,
        arm: str | None = None,
        attachments: bool = False,
    ) -> Iterator[tuple[Cell, CellResult]]:
        """Yield cells with their results, ordered by reading, arm, map, seed; ``None`` means any."""
        with _explained(self.path):
            for key, cell, summary, crc in self._selected(reading, map, seed, arm):
                packed = self._packed(key, cell, summary)
                if not _intact(packed, crc):
                    raise TaskliftError(f"{self.path}: cell {cell} is damaged; restore a copy, or run it afresh")
                yield (
                    cell,
                    CellResult(
                        {stage: unpack(data) for stage, _, data in packed.trials},
                        json.loads(summary),
                        {name: _attachment(data) for name, data in packed.attachments} if attachments else {},
                    ),
                )

    def result(self, cell: Cell) -> CellResult:
        """One cell's result with everything that the store keeps of it."""
        for _, result in self.select(
            reading=cell.reading, map=cell.map, seed=cell.seed, arm=cell.arm, attachments=True
        ):
            return result
        raise TaskliftError(f"{self.path}: no cell {cell}; `tasklift runs show` lists what is there")

    def curves(
        self,
        stage: str,
        column: str,
        *,
        reading: str | None = None,
        arm: str | None = None,
        pad: float | None = None,
    ) -> Curves:
        """One column of one stage as a matrix, a row per cell, ordered by reading, arm, map, seed.

        Parameters
        ----------
        pad
            Fills rows that ended early (a loss cap); without it, unequal rows are an error.
        """
        with _explained(self.path):
            cells, rows = [], []
            query = (
                "SELECT reading, map, seed, arm, columns FROM cells JOIN trials ON cell = id AND stage = ?1 "
                "WHERE (?2 IS NULL OR reading = ?2) AND (?3 IS NULL OR arm = ?3) "
                "ORDER BY reading, arm, map, seed"
            )
            for *key, data in self._db.execute(query, (stage, reading, arm)):
                columns = unpack(data)
                if column not in columns:
                    raise TaskliftError(f"{self.path}: stage {stage!r} has {sorted(columns)}, not {column!r}")
                cells.append(Cell(*key))
                rows.append(columns[column])
        if not rows:
            raise TaskliftError(
                f"{self.path}: no rows of stage {stage!r}, reading {reading!r}, arm {arm!r} (a store of "
                "summaries keeps none); `tasklift runs show` tells what is there"
            )
        longest = max(map(len, rows))
        if pad is None and min(map(len, rows)) < longest:
            raise TaskliftError(f"{self.path}: stage {stage!r} has rows of unequal length; pass pad=")
        values = np.full((len(rows), longest), 0.0 if pad is None else pad)
        for i, row in enumerate(rows):
            values[i, : len(row)] = row
        return Curves(values, cells)

    def outlines(self, *, reading: str | None = None, arm: str | None = None) -> Iterator[tuple[Cell, dict[str, Any]]]:
        """Yield cells with their summaries only, which is quick, in the order of :meth:`select`."""
        with _explained(self.path):
            for _, cell, summary, _ in self._selected(reading, None, None, arm):
                yield cell, json.loads(summary)

    def summaries(self, name: str, *, reading: str | None = None, arm: str | None = None) -> Curves:
        """One summary value, ``(n, 1)``, of the selected cells, ordered as :meth:`curves`; None is nan."""
        cells, values = [], []
        for cell, summary in self.outlines(reading=reading, arm=arm):
            if name not in summary:
                raise TaskliftError(f"{self.path}: cell {cell} has {sorted(summary)}, but no {name!r}")
            cells.append(cell)
            values.append(np.nan if summary[name] is None else float(summary[name]))
        return Curves(np.array(values, dtype=np.float64).reshape(-1, 1), cells)

    def digest(self) -> str:
        """Fingerprint (sha256) of all results, whatever order they came in."""
        total = hashlib.sha256(self.spec.id.encode())
        with _explained(self.path):
            for key, cell, summary, _ in self._selected(None, None, None, None):
                packed = self._packed(key, cell, summary)
                total.update(repr((_key(cell), summary, packed.trials, packed.attachments)).encode())
        return total.hexdigest()

    def _selected(
        self, reading: str | None, map: str | None, seed: int | None, arm: str | None
    ) -> Iterator[tuple[int, Cell, str, int]]:
        wanted = {"reading": reading, "map": map, "seed": seed, "arm": arm}
        given = {name: value for name, value in wanted.items() if value is not None}
        where = " AND ".join(f"{name} = :{name}" for name in given) or "1"
        query = f"SELECT id, reading, map, seed, arm, summary, crc FROM cells WHERE {where}"
        for row in self._db.execute(f"{query} ORDER BY reading, arm, map, seed", given):
            yield row[0], Cell(*row[1:5]), row[5], row[6]

    def _packed(self, key: int, cell: Cell, summary: str) -> Packed:
        trials = self._db.execute("SELECT stage, n, columns FROM trials WHERE cell = ? ORDER BY stage", (key,))
        extra = self._db.execute("SELECT name, data FROM attachments WHERE cell = ? ORDER BY name", (key,))
        return Packed(cell, summary, tuple(trials), tuple(extra))


@dataclass(frozen=True)
class Curves:
    """Values of cells. ``values`` float64 ``(n, T)``, a row per cell; ``cells`` in the same order."""

    values: NDArray[np.float64]
    cells: list[Cell]

    @property
    def maps(self) -> NDArray[np.str_]:
        """Each row's map ``(n,)``: the strata of the statistics."""
        return np.array([cell.map for cell in self.cells])

    def paired_with(self, other: Curves) -> bool:
        """Whether both have the same (map, seed) row by row, so that differences are paired."""
        return [(c.map, c.seed) for c in self.cells] == [(c.map, c.seed) for c in other.cells]


_WHERE = "reading = ? AND map = ? AND seed = ? AND arm = ?"


def _key(cell: Cell) -> tuple[str, str, int, str]:
    return cell.reading, cell.map, cell.seed, cell.arm


def _intact(packed: Packed, crc: int) -> bool:
    try:
        return packed.crc == crc
    except (TypeError, AttributeError):  # a damaged field may come back as another type
        return False


def _attachment(data: str | bytes) -> Any:
    return unpack(data)[""] if isinstance(data, bytes) else json.loads(data)


def _is_empty(connection: sqlite3.Connection, path: Path) -> bool:
    """Whether nothing is in the file yet; refuse what is not ours, newer than this release, or damaged."""
    connection.execute("BEGIN")  # one snapshot: another process may be creating the file at this moment
    (application,) = connection.execute("PRAGMA application_id").fetchone()
    (version,) = connection.execute("PRAGMA user_version").fetchone()
    (tables,) = connection.execute("SELECT count(*) FROM sqlite_master").fetchone()
    connection.execute("COMMIT")
    if not tables and not application:
        return True
    if application != _APPLICATION:
        raise TaskliftError(f"{path}: a database of another program; nothing was touched, choose another place")
    if version > _VERSION:
        raise TaskliftError(
            f"{path}: version {version} of the experiment file, this release reads up to {_VERSION}; "
            "nothing was touched, install a newer tasklift"
        )
    # pages that point astray would lose or repeat whole cells unnoticed; this takes about 1 ms per MB
    (found,) = connection.execute("PRAGMA quick_check(1)").fetchone()
    if found != "ok":
        line = " ".join(str(found).split())
        raise TaskliftError(f"{path}: damaged ({line}); restore a copy, or move it away and run again")
    return False


def _identity(connection: sqlite3.Connection, path: Path) -> tuple[Spec, Detail]:
    meta = dict(connection.execute("SELECT key, value FROM meta"))
    spec, detail = Spec(str(meta.get("name")), str(meta.get("spec"))), meta.get("detail")
    if spec.id != meta.get("spec_id") or detail not in ("rows", "summary"):
        raise TaskliftError(f"{path}: damaged (its spec is not what it was); restore a copy, or move it away")
    return spec, "rows" if detail == "rows" else "summary"


def _refuse_another(connection: sqlite3.Connection, path: Path, spec: Spec, detail: Detail) -> None:
    there, kept = _identity(connection, path)
    if there.id != spec.id:
        changed = differences(there.settings, spec.settings)
        more = f" and {len(changed) - 3} more" if len(changed) > 3 else ""
        raise TaskliftError(
            f"{path}: holds another experiment ({there.name!r}, {there.id[:12]}): it has "
            f"{'; '.join(changed[:3])}{more}; nothing was touched, choose another --out or give its settings"
        )
    if kept != detail:
        raise TaskliftError(f"{path}: keeps detail {kept!r}, not {detail!r}; nothing was touched")


def _write_ahead(connection: sqlite3.Connection) -> None:
    """Switch the journal; SQLite does not wait for its busy timeout here, so try again for a while."""
    connection.execute("PRAGMA synchronous = NORMAL")
    for attempt in range(100):
        try:
            connection.execute("PRAGMA journal_mode = WAL")
            return
        except sqlite3.OperationalError as error:
            if "locked" not in str(error) or attempt == 99:
                raise
            time.sleep(0.05)


def _connect_to_read(path: Path) -> sqlite3.Connection:
    """Open read-only; in a folder where SQLite may not put its log, as a file that does not change."""
    address = path.resolve().as_uri()
    connection = sqlite3.connect(f"{address}?mode=ro", uri=True, timeout=60, isolation_level=None)
    try:
        connection.execute("SELECT count(*) FROM sqlite_master").fetchone()
    except sqlite3.OperationalError:
        connection.close()
        log = path.with_name(path.name + "-wal")
        if log.exists() and log.stat().st_size:
            raise
        connection = sqlite3.connect(f"{address}?mode=ro&immutable=1", uri=True, isolation_level=None)
    return connection
