"""The experiment file: its layout, what it says of itself, and how it is opened and checked.

Layout (``application_id`` 0x7461736b, ``user_version`` 2)::

    meta         key, value          the spec (name, settings, axes, over), detail, release, cells asked for; checksum
    cells        id, summary (JSON), contents (JSON), crc, and a column for each axis        one row per cell
    trials       cell, stage, n, columns                              one row per cell and stage, packed
    attachments  cell, name, data                                     TEXT is JSON, BLOB a packed array
    summaries    a view: one row per cell and summary value, for SQL

:mod:`tasklift.lab.packing` says how arrays are packed; :meth:`Store.select` and ``runs export`` unpack them.

Nothing is read unchecked. ``crc`` covers a cell's axes, summary and contents; its *contents* are the checksums of its
trials and attachments. A cell that lost a part or has a changed one is damaged: readers refuse it, a run computes
it again.

The journal is a write-ahead log with ``synchronous = NORMAL``: a killed process loses nothing that was
committed; a power cut may lose the last cells, which a resumed run computes again, and damages nothing. After a
kill the last cells may be in ``FILE-wal`` only, which belongs to the file until the next run closes it. A store that
was closed has no log: it is one file, and reading it leaves nothing beside it.
"""

from __future__ import annotations

import sqlite3
import time
import zlib
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import NamedTuple

from tasklift.errors import TaskliftError
from tasklift.files import canonical_json
from tasklift.lab.packing import Detail, checksum
from tasklift.lab.spec import Spec
from tasklift.text import one_line

FILE_NAME = "experiment.sqlite"

APPLICATION = 0x7461736B
VERSION = 2
META = "CREATE TABLE meta (key TEXT PRIMARY KEY, value TEXT NOT NULL) WITHOUT ROWID"
MOST_BYTES = 2**28  # of one value in the file
_PAGES_IN_LOG = 250  # about 1 MB, some 30 cells: what a copy of the file without its log may lack


def schema(axes: list[str]) -> list[str]:
    """The statements that make the tables; SQLite keeps them as they are."""
    columns, names = ", ".join(f'"{axis}" TEXT NOT NULL' for axis in axes), ", ".join(f'"{axis}"' for axis in axes)
    return [
        META,
        "CREATE TABLE cells (id INTEGER PRIMARY KEY, summary TEXT NOT NULL, contents TEXT NOT NULL, "
        f"crc INTEGER NOT NULL, {columns}, UNIQUE ({names}))",
        "CREATE TABLE trials (cell INTEGER NOT NULL REFERENCES cells, stage TEXT NOT NULL, "
        "n INTEGER NOT NULL, columns BLOB NOT NULL, PRIMARY KEY (cell, stage)) WITHOUT ROWID",
        "CREATE TABLE attachments (cell INTEGER NOT NULL REFERENCES cells, name TEXT NOT NULL, "
        "data NOT NULL, PRIMARY KEY (cell, name)) WITHOUT ROWID",
        f"CREATE VIEW summaries AS SELECT {names}, key AS name, value FROM cells, json_each(cells.summary)",
    ]


@contextmanager
def explained(path: Path) -> Iterator[None]:
    """Turn SQLite's and the codec's errors into one line about the file."""
    try:
        yield
    except TaskliftError:
        raise
    except (zlib.error, ValueError, TypeError, AttributeError, LookupError, RecursionError, OverflowError) as error:
        # what damaged bytes come to, where no checksum was asked first
        raise damaged(path, one_line(error, 80)) from error
    except sqlite3.Error as error:
        text = one_line(error, 80)
        if "full" in text:
            line = "the disk is full; what was committed is safe: free some space and run the same command again"
        elif "disk I/O" in text:
            line = f"cannot be written ({text}: full disk, quota, or failing drive); what was committed is safe"
        elif "readonly" in text or "unable to open" in text:
            line = f"cannot be opened or written ({text}); check folder and permissions, or choose another --out"
        elif "locked" in text:
            line = "another process holds it for too long; try again when that one is done"
        else:
            raise damaged(path, text) from error
        raise TaskliftError(f"{path}: {line}") from error


def damaged(path: Path, reason: str) -> TaskliftError:
    """The error for a file that cannot be what was written."""
    return TaskliftError(
        f"{path}: damaged, or not an experiment file ({reason}); restore a copy, or move it away and run again"
    )


class Meta(NamedTuple):
    """What a file says of itself."""

    spec: Spec
    detail: Detail
    release: str
    planned: int

    @classmethod
    def read(cls, connection: sqlite3.Connection, path: Path) -> Meta:
        """Read and check it."""
        kept = dict(connection.execute("SELECT key, value FROM meta ORDER BY key LIMIT 99"))
        crc = kept.pop("crc", None)
        if crc != str(checksum("meta", canonical_json(kept))):
            raise damaged(path, "its spec is not what it was")
        spec = Spec.parse(kept["name"], kept["settings"], kept["axes"], kept["over"])
        return cls(spec, "rows" if kept["detail"] == "rows" else "summary", kept["release"], int(kept["planned"]))

    def write(self, connection: sqlite3.Connection) -> None:
        """Write it, within a transaction."""
        spec = self.spec
        kept = {"name": spec.name, "settings": spec.canonical, "axes": spec.plan, "over": canonical_json(spec.over)}
        kept |= {"detail": self.detail, "release": self.release, "planned": str(self.planned)}
        kept["crc"] = str(checksum("meta", canonical_json(kept)))
        connection.executemany("INSERT OR REPLACE INTO meta VALUES (?, ?)", kept.items())

    def refuse_another(self, asked: Meta, path: Path) -> None:
        """Raise if the rows of ``asked`` do not belong into this file."""
        changed = self.spec.conflicts(asked.spec)
        if changed:
            lines = [one_line(line, 80) for line in changed[:3]]
            while len(lines) > 1 and len(f"{path}{'; '.join(lines)}") > 180:
                lines.pop()
            more = f"; and {len(changed) - len(lines)} more" if len(changed) > len(lines) else ""
            raise TaskliftError(
                f"{path}: holds another experiment: {'; '.join(lines)}{more}; nothing was touched, choose another "
                "--out or give its settings"
            )
        if self.detail != asked.detail:
            raise TaskliftError(f"{path}: keeps detail {self.detail!r}, not {asked.detail!r}; nothing was touched")
        if self.release != asked.release:
            raise TaskliftError(
                f"{path}: its rows are those of tasklift {self.release}, this is {asked.release}, and rows of two "
                f"releases do not mix; nothing was touched: choose another --out, or install tasklift {self.release}"
            )


def is_empty(connection: sqlite3.Connection, path: Path) -> bool:
    """Whether nothing is in the file yet; refuse what is not ours, of another layout, or damaged."""
    connection.execute("PRAGMA cell_size_check = ON")
    connection.execute("BEGIN")  # one snapshot: another process may be creating the file at this moment
    try:
        (application,) = connection.execute("PRAGMA application_id").fetchone()
        (version,) = connection.execute("PRAGMA user_version").fetchone()
        tables = [sql for (sql,) in connection.execute("SELECT sql FROM sqlite_master WHERE sql IS NOT NULL LIMIT 99")]
        if not tables and not application:
            return True
        if application != APPLICATION:
            raise TaskliftError(f"{path}: a database of another program; nothing was touched, choose another place")
        if version != VERSION:
            age, do = ("older", "run again with another --out") if version < VERSION else ("newer", "install that one")
            raise TaskliftError(
                f"{path}: layout {version} of the experiment file, from {'an' if age == 'older' else 'a'} {age} "
                f"tasklift; this release reads layout {VERSION}; nothing was touched, {do}"
            )
        # a view could take the place of a table, and never end
        if META not in tables or sorted(schema(list(Meta.read(connection, path).spec.axes))) != sorted(tables):
            raise damaged(path, "its tables are not what they were")
        # pages that point astray would lose or repeat whole cells unnoticed
        (found,) = connection.execute("PRAGMA integrity_check(1)").fetchone()
        if found != "ok":
            raise damaged(path, one_line(found, 80))
        return False
    finally:
        connection.execute("COMMIT")


def write_ahead(connection: sqlite3.Connection) -> None:
    """Switch the journal; SQLite does not wait for its busy timeout here, so try again for a while."""
    connection.execute("PRAGMA synchronous = NORMAL")
    for attempt in range(100):
        try:
            connection.execute("PRAGMA journal_mode = WAL")
            connection.execute(f"PRAGMA wal_autocheckpoint = {_PAGES_IN_LOG}")
            return
        except sqlite3.OperationalError as error:
            if "locked" not in str(error) or attempt == 99:
                raise
            time.sleep(0.05)


def connect_to_read(path: Path) -> sqlite3.Connection:
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
    connection.setlimit(sqlite3.SQLITE_LIMIT_LENGTH, MOST_BYTES)
    return connection
