"""One SQLite file per experiment: a transaction per cell, so that a kill at any moment loses only open work.

Every reader goes through the same few methods, which compare checksums: a damaged cell is an error, never a number.
:mod:`tasklift.lab.file` has the layout.
"""

from __future__ import annotations

import hashlib
import json
import os
import sqlite3
import zlib
from collections.abc import Iterable, Iterator, Mapping
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from types import TracebackType
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

import tasklift
from tasklift.errors import TaskliftError
from tasklift.lab import file
from tasklift.lab.cell import Cell, CellResult, axis_value, in_order
from tasklift.lab.file import FILE_NAME, Meta, explained
from tasklift.lab.packing import Detail, Packed, checksum, scalars, unpack
from tasklift.lab.spec import Spec
from tasklift.text import one_line


class _Row(NamedTuple):
    """A cell as it is kept, its checksum compared."""

    key: int
    cell: Cell
    summary: str
    contents: str


class Store:
    """An open experiment file. Use :meth:`open` to run, :meth:`read` to look; both are context managers.

    Reading goes by axes: ``store.curves("target", "steps", arm="copy")``. Rows come in the order of the grid: axis
    by axis, numbers sorted as numbers. A store that was opened with a spec shows the cells which that spec asks for;
    one that was opened to read shows all that are there.

    Attributes
    ----------
    path
        The file.
    spec
        The experiment, with the values asked for (:meth:`open`) or all that were ever asked for (:meth:`read`).
    detail
        ``"rows"`` or ``"summary"``.
    release
        The release of tasklift whose rows these are.

    Examples
    --------
    >>> import tempfile
    >>> from tasklift.lab import CellResult, run
    >>> spec = Spec.of("squares", {}, {"seed": range(3), "arm": ["a", "b"]})
    >>> def work(cell):
    ...     return CellResult({"target": {"steps": np.arange(2) + int(cell["seed"]) ** 2}}, {"seed": int(cell["seed"])})
    >>> with tempfile.TemporaryDirectory() as folder, Store.open(f"{folder}/{FILE_NAME}", spec) as store:
    ...     ran = run(store, spec.cells(), work)
    ...     curves = store.curves("target", "steps", arm="b")
    >>> ran.computed, curves.values.tolist(), curves.column("seed").tolist()
    (6, [[0.0, 1.0], [1.0, 2.0], [4.0, 5.0]], ['0', '1', '2'])
    """

    def __init__(self, path: Path, connection: sqlite3.Connection, asked: Spec | None = None) -> None:
        self.path = path
        self._db = connection
        self._logging = connection.execute("PRAGMA journal_mode").fetchone() == ("wal",)
        there = Meta.read(connection, path)
        self.spec, self.detail, self.release = asked or there.spec, there.detail, there.release
        self._id, self._axes = there.spec.id, tuple(there.spec.axes)

    @classmethod
    def open(cls, path: str | os.PathLike[str], spec: Spec, *, detail: Detail = "rows") -> Store:
        """Open for writing, and create the file if there is none (its folder must exist).

        Parameters
        ----------
        path
            The file, usually ``FOLDER/experiment.sqlite``.
        spec
            The experiment. A file of the same experiment may know other values of its axes; both stay.
        detail
            ``"rows"`` keeps everything; ``"summary"`` only the summaries: see :func:`tasklift.lab.recompute`.

        Raises
        ------
        TaskliftError
            If the file holds another experiment (the message names what differs; nothing was touched), comes
            from another release, is damaged, or cannot be written.
        """
        where = Path(path)
        if not where.parent.is_dir():
            raise TaskliftError(f"{where.parent}: no such folder; create it first")
        asked = Meta(spec, detail, tasklift.__version__, 0)
        with explained(where):
            connection = sqlite3.connect(where, timeout=60, isolation_level=None)
            try:
                connection.setlimit(sqlite3.SQLITE_LIMIT_LENGTH, file.MOST_BYTES)
                if not file.is_empty(connection, where):
                    there = Meta.read(connection, where)
                    there.refuse_another(asked, where)
                    if there.spec.joined(spec) == there.spec:  # nothing new: the file stays as it is
                        return cls(where, connection, spec)
                file.write_ahead(connection)
                connection.execute("BEGIN IMMEDIATE")
                if connection.execute("SELECT count(*) FROM sqlite_master").fetchone() == (0,):
                    for statement in file.schema(list(spec.axes)):
                        connection.execute(statement)
                    connection.execute(f"PRAGMA application_id = {file.APPLICATION}")
                    connection.execute(f"PRAGMA user_version = {file.VERSION}")
                    asked.write(connection)
                else:
                    there = Meta.read(connection, where)
                    there.refuse_another(asked, where)  # two processes may have created it at once
                    joined = there._replace(spec=there.spec.joined(spec))
                    if joined != there:
                        joined.write(connection)
                connection.execute("COMMIT")
                connection.execute("PRAGMA wal_checkpoint(PASSIVE)")  # a copy of this file alone says what it is
                return cls(where, connection, spec)
            except BaseException:
                connection.close()
                raise

    @classmethod
    def read(cls, path: str | os.PathLike[str]) -> Store:
        """Open an existing file, or the one in a folder, for reading only.

        Raises
        ------
        TaskliftError
            If there is none, or it is damaged, of an older layout, or of a newer release.
        """
        where = Path(path)
        where = where / FILE_NAME if where.is_dir() else where
        if not where.is_file():
            raise TaskliftError(f"{where}: no such experiment; `tasklift runs list FOLDER` shows which there are")
        with explained(where):
            connection = file.connect_to_read(where)
            try:
                if file.is_empty(connection, where):
                    raise TaskliftError(
                        f"{where}: an empty experiment file; run the experiment first (after a kill, {where.name}-wal "
                        "belongs to it: copy both)"
                    )
                return cls(where, connection)
            except BaseException:
                connection.close()
                raise

    def close(self) -> None:
        """Close the file; the last one to close it folds the write-ahead log into it."""
        with explained(self.path):
            if self._logging:
                with suppress(sqlite3.Error):  # where another process has it open, that one will
                    self._db.execute("PRAGMA busy_timeout = 0")
                    self._db.execute("PRAGMA journal_mode = DELETE")  # reading a file with a log leaves files beside it
            self._db.close()

    def __enter__(self) -> Store:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()

    # ------------------------------------------------------------ writing

    def plan(self, missing: int) -> None:
        """Note how many cells are still to come, for those who look at an unfinished experiment."""
        with explained(self.path):
            (count,) = self._db.execute("SELECT count(*) FROM cells").fetchone()
        if self.planned != count + missing:
            with self._transaction():
                Meta.read(self._db, self.path)._replace(planned=count + missing).write(self._db)

    def mend(self) -> int:
        """Remove damaged cells, so that a run computes them again; return how many there were."""
        with explained(self.path):
            damaged = [row if isinstance(row, int) else row.key for row in self._rows({}) if not self._intact(row)]
            astray = [
                (table, cell)
                for table in ("trials", "attachments")
                for (cell,) in self._db.execute(f"SELECT cell FROM {table} WHERE cell NOT IN (SELECT id FROM cells)")
            ]
        if damaged or astray:
            with self._transaction():
                self._db.executemany("DELETE FROM cells WHERE id = ?", [(key,) for key in damaged])
                for table, cell in [*astray, *((t, key) for key in damaged for t in ("trials", "attachments"))]:
                    self._db.execute(f"DELETE FROM {table} WHERE cell = ?", (cell,))
        return len(damaged)

    def add(self, packed: Packed) -> bool:
        """Commit one cell in one transaction. False if it was there already, with the same content.

        Raises
        ------
        TaskliftError
            If it was there with other content, so the work is not a function of the cell; the old one stays.
        """
        cell, contents = packed.cell, packed.contents
        crc = self._seal(cell.values, packed.summary, contents)
        with self._transaction():
            marks = ", ".join("?" * (4 + len(cell.items)))
            cursor = self._db.execute(
                f"INSERT OR IGNORE INTO cells VALUES ({marks})", (None, packed.summary, contents, crc, *cell.values)
            )
            if cursor.rowcount:
                key = cursor.lastrowid
                self._db.executemany("INSERT INTO trials VALUES (?, ?, ?, ?)", [(key, *row) for row in packed.trials])
                self._db.executemany(
                    "INSERT INTO attachments VALUES (?, ?, ?)", [(key, *row) for row in packed.attachments]
                )
                return True
            where = " AND ".join(f'"{axis}" = ?' for axis in cell.names)
            there = self._db.execute(f"SELECT crc FROM cells WHERE {where}", cell.values).fetchone()
        if there != (crc,):
            raise TaskliftError(
                f"{self.path}: cell {cell} is there with another result; the work must depend on the cell "
                "alone: choose another --out"
            )
        return False

    @contextmanager
    def _transaction(self) -> Iterator[None]:
        with explained(self.path):
            if not self._logging:
                file.write_ahead(self._db)
                self._logging = True
            self._db.execute("BEGIN IMMEDIATE")
            try:
                yield
                self._db.execute("COMMIT")
            except BaseException:
                with suppress(sqlite3.Error):  # a failed COMMIT may have rolled back by itself
                    self._db.execute("ROLLBACK")
                raise

    # ------------------------------------------------------------ reading

    def done(self) -> set[Cell]:
        """The cells that are there."""
        return {row.cell for row in self._selected({})}

    def __contains__(self, cell: Cell) -> bool:
        where = " AND ".join(f'"{axis}" = ?' for axis in cell.names)
        with explained(self.path):
            return self._db.execute(f"SELECT 1 FROM cells WHERE {where}", cell.values).fetchone() is not None

    def __len__(self) -> int:
        return len(self._selected({}))

    @property
    def planned(self) -> int:
        """How many cells there will be when the latest run is done."""
        with explained(self.path):
            return Meta.read(self._db, self.path).planned

    def select(self, *, attachments: bool = False, **axes: str | int | None) -> Iterator[tuple[Cell, CellResult]]:
        """Yield cells with their results, in the order of the grid.

        Parameters
        ----------
        attachments
            Also read the attachments.
        **axes
            The value that cells must have on an axis; None means any.

        Raises
        ------
        TaskliftError
            If a cell is damaged, or there is no such axis.
        """
        for row in self._selected(axes):
            with explained(self.path):
                stages = {stage: unpack(data) for stage, _, data in self._trials(row)}
                extra = {name: _attachment(data) for name, _, data in self._attachments(row)} if attachments else {}
                yield row.cell, CellResult(stages, scalars(json.loads(row.summary)), extra)

    def result(self, cell: Cell) -> CellResult:
        """One cell's result with everything that the store keeps of it."""
        for _, result in self.select(attachments=True, **cell.axes):
            return result
        raise TaskliftError(f"{self.path}: no cell {cell}; `tasklift runs show` lists what is there")

    def curves(self, stage: str, column: str, /, *, pad: float | None = None, **axes: str | int | None) -> Curves:
        """One column of one stage as a matrix, a row per cell that has the stage, in the order of the grid.

        Parameters
        ----------
        stage, column
            Names that the work gave.
        pad
            Fills rows that ended early (a loss cap); without it, unequal rows are an error.
        **axes
            The value that cells must have on an axis; None means any.

        Raises
        ------
        TaskliftError
            If there are no such rows, they are of unequal length, or a cell is damaged.
        """
        cells, rows = [], []
        with explained(self.path):
            selected = self._selected(axes)  # first: what another process commits meanwhile is not among them
            where, given = self._condition(axes)
            query = "SELECT cell, n, columns FROM trials WHERE stage = :stage AND cell IN (SELECT id FROM cells WHERE "
            parts = self._db.execute(f"{query}{where})", given | {"stage": stage})
            packed = {key: [(stage, n, data)] for key, n, data in parts}
            for row in selected:
                kept = {name: crc for name, crc in json.loads(row.contents)["trials"].items() if name == stage}
                for _, _, data in self._as_written(row, packed.get(row.key, []), kept):
                    found = unpack(data, column)
                    if column not in found:
                        raise TaskliftError(f"{self.path}: stage {stage!r} has {sorted(unpack(data))}, not {column!r}")
                    cells.append(row.cell)
                    rows.append(found[column])
        if not rows:
            asked = "".join(f", {axis} {value}" for axis, value in axes.items() if value is not None)
            raise TaskliftError(
                f"{self.path}: no rows of stage {stage!r}{asked} (a store of summaries keeps none); "
                "`tasklift runs show` tells what is there"
            )
        longest = max(map(len, rows))
        if pad is None and min(map(len, rows)) < longest:
            raise TaskliftError(f"{self.path}: stage {stage!r} has rows of unequal length; pass pad=")
        values = np.full((len(rows), longest), 0.0 if pad is None else pad)
        for i, values_of_one in enumerate(rows):
            values[i, : len(values_of_one)] = values_of_one
        return Curves(values, cells)

    def outlines(self, **axes: str | int | None) -> Iterator[tuple[Cell, dict[str, Any]]]:
        """Yield cells with their summaries only, which is quick, in the order of :meth:`select`."""
        for row in self._selected(axes):
            with explained(self.path):
                yield row.cell, scalars(json.loads(row.summary))

    def summaries(self, name: str, /, **axes: str | int | None) -> Curves:
        """One summary value, ``(n, 1)``, of the selected cells, in the order of the grid; None is nan."""
        cells, values = [], []
        for cell, summary in self.outlines(**axes):
            value = summary.get(name, "")
            if isinstance(value, str):
                numbers = sorted(key for key, of in summary.items() if not isinstance(of, str))
                raise TaskliftError(f"{self.path}: cell {cell} has the numbers {numbers}, but no {name!r}")
            cells.append(cell)
            values.append(np.nan if value is None else float(value))
        return Curves(np.array(values, dtype=np.float64).reshape(-1, 1), cells)

    def digest(self) -> str:
        """Fingerprint (sha256) of all results, whatever order they came in."""
        total = hashlib.sha256(self._id.encode())
        for row in self._selected({}):
            with explained(self.path):
                parts = self._trials(row), self._attachments(row)
                total.update(repr((row.cell.items, row.summary, *parts)).encode())
        return total.hexdigest()

    # ------------------------------------------------------------ every reader goes through these

    def _selected(self, axes: Mapping[str, str | int | None]) -> list[_Row]:
        """The rows of the spec's cells that have these values, in order; one damaged row is an error."""
        found = []
        places = list(self._places.values())
        with explained(self.path):
            for row in self._rows(axes):
                if isinstance(row, int):
                    raise self._damage(row)
                try:
                    found.append((tuple([of[value] for of, value in zip(places, row.cell.values, strict=True)]), row))
                except KeyError:  # not among the values that were asked for
                    continue
        found.sort()
        return [row for _, row in found]

    @cached_property
    def _places(self) -> dict[str, dict[str, int]]:
        """For each axis the place of each of the spec's values."""
        return {axis: {value: i for i, value in enumerate(in_order(of))} for axis, of in self.spec.axes.items()}

    def _rows(self, axes: Mapping[str, str | int | None]) -> Iterator[_Row | int]:
        """Yield the rows that have these values; of a damaged one its number."""
        where, given = self._condition(axes)
        columns = ", ".join(f'"{axis}"' for axis in self._axes)
        query = f"SELECT id, summary, contents, crc, {columns} FROM cells WHERE {where}"
        for key, summary, contents, crc, *values in self._db.execute(query, given):
            try:
                intact = self._seal(values, summary, contents) == crc
            except TypeError:  # something is not even text
                intact = False
            yield _Row(key, Cell.of(self._axes, values), summary, contents) if intact else key

    def _condition(self, axes: Mapping[str, str | int | None]) -> tuple[str, dict[str, str]]:
        """An SQL condition for the axes that have a value, and its parameters."""
        given = {axis: axis_value(axis, value) for axis, value in axes.items() if value is not None}
        if unknown := [axis for axis in given if axis not in self._axes]:
            raise TaskliftError(f"{self.path}: no axis {unknown[0]!r}; the axes are {', '.join(self._axes)}")
        return " AND ".join(f'"{axis}" = :{axis}' for axis in given) or "1", given

    def _seal(self, values: Iterable[str], summary: str, contents: str) -> int:
        """Checksum of a row of cells."""
        return zlib.crc32("\0".join((self._id, *values, summary, contents)).encode())

    def _trials(self, row: _Row) -> list[tuple[str, int, bytes]]:
        """The packed stages of a cell: name, trials, columns."""
        query = "SELECT stage, n, columns FROM trials WHERE cell = ? ORDER BY stage"
        return self._as_written(row, self._db.execute(query, (row.key,)).fetchall(), json.loads(row.contents)["trials"])

    def _attachments(self, row: _Row) -> list[tuple[str, int, str | bytes]]:
        """The attachments of a cell: name, 0, text or bytes."""
        query = "SELECT name, 0, data FROM attachments WHERE cell = ? ORDER BY name"
        parts = self._db.execute(query, (row.key,)).fetchall()
        return self._as_written(row, parts, json.loads(row.contents)["attachments"])

    def _as_written(self, row: _Row, parts: list[Any], kept: dict[str, int]) -> list[Any]:
        """Return the parts of a cell if they have the checksums that the cell keeps of them."""
        if {name: checksum(name, data, n) for name, n, data in parts} != kept:
            raise self._damage(row.key)
        return parts

    def _intact(self, row: _Row | int) -> bool:
        """Whether all that is kept of a cell is as it was written."""
        try:
            return not isinstance(row, int) and bool((self._trials(row), self._attachments(row)))
        except (ValueError, TypeError, AttributeError, sqlite3.Error):  # a TaskliftError is a ValueError
            return False

    def _damage(self, key: int) -> TaskliftError:
        columns = ", ".join(f'"{axis}"' for axis in self._axes)
        values = self._db.execute(f"SELECT {columns} FROM cells WHERE id = ?", (key,)).fetchone()
        cell = ", ".join(f"{axis} {value}" for axis, value in zip(self._axes, values, strict=True))
        return TaskliftError(
            f"{self.path}: cell {one_line(cell, 80)} is damaged; restore a copy, or run the same command again, which "
            "computes it afresh"
        )


@dataclass(frozen=True)
class Curves:
    """Values of cells. ``values`` float64 ``(n, T)``, a row per cell; ``cells`` in the same order."""

    values: NDArray[np.float64]
    cells: list[Cell]

    def column(self, axis: str) -> NDArray[np.str_]:
        """Each row's value on an axis ``(n,)``: the strata of the statistics, for example."""
        return np.array([cell[axis] for cell in self.cells])

    def paired_with(self, other: Curves, over: Iterable[str]) -> bool:
        """Whether both have the same values on the axes ``over`` row by row, so that differences are paired."""
        axes = list(over)
        return [[cell[axis] for axis in axes] for cell in self.cells] == [
            [cell[axis] for axis in axes] for cell in other.cells
        ]


def _attachment(data: str | bytes) -> Any:
    return unpack(data)[""] if isinstance(data, bytes) else json.loads(data)
