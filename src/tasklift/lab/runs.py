"""What ``tasklift runs`` does: find experiments, show one, compare two or two arms, export rows."""

from __future__ import annotations

import csv
import os
from collections.abc import Iterator
from contextlib import suppress
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from tasklift import stats
from tasklift.errors import TaskliftError
from tasklift.files import canonical_json
from tasklift.lab.spec import Cell, differences
from tasklift.lab.store import FILE_NAME, Store

_CELLS_AT_ONCE = 500  # of an export: some 10 MB


class Table(NamedTuple):
    """Something to print: a row holds text and numbers."""

    title: str
    headers: list[str]
    rows: list[list[Any]]


def find(folder: str | os.PathLike[str]) -> Table:
    """List the experiments in a folder and below; a file that cannot be read is listed with the reason."""
    root = Path(folder)
    if not root.is_dir():
        raise TaskliftError(f"{root}: no such folder")
    rows = []
    for path in sorted(root.rglob(FILE_NAME)):
        place, size = str(path.parent.relative_to(root)), path.stat().st_size / 1e6
        try:
            with Store.read(path) as store:
                of = store.planned or len(store)
                cells = f"{len(store)} of {of}"
                rows.append([place, store.spec.name, store.spec.id[:12], cells, store.detail, round(size, 1)])
        except TaskliftError as error:
            rows.append([place, str(error), "", "", "", round(size, 1)])
    return Table(f"Experiments in {root}", ["folder", "name", "spec", "cells", "detail", "MB"], rows)


def show(path: str | os.PathLike[str]) -> list[Table]:
    """Show one experiment: its settings, and the mean of every summary by reading and arm."""
    with Store.read(path) as store:
        facts = {
            "name": store.spec.name,
            "spec": store.spec.id,
            "cells": f"{len(store)} of {store.planned or len(store)}",
            "detail": store.detail,
            "written by": ", ".join(f"tasklift {version}" for version in sorted(set(store.origins().values()))),
        }
        settings = {f"settings.{key}": canonical_json(value) for key, value in store.spec.settings.items()}
        means: dict[tuple[str, str], dict[str, list[float]]] = {}
        counts: dict[tuple[str, str], int] = {}
        for cell, summary in store.outlines():
            group = means.setdefault((cell.reading, cell.arm), {})
            counts[cell.reading, cell.arm] = counts.get((cell.reading, cell.arm), 0) + 1
            for name, value in _numbers(summary).items():
                group.setdefault(name, []).append(value)
    names = sorted({name for group in means.values() for name in group})
    rows = [
        [*key, counts[key], *(float(np.mean(group[name])) if name in group else None for name in names)]
        for key, group in means.items()
    ]
    return [
        Table(str(path), ["", ""], [[key, value] for key, value in (facts | settings).items()]),
        Table("Means over cells", ["reading", "arm", "cells", *names], rows),
    ]


def compare(
    first: str | os.PathLike[str],
    second: str | os.PathLike[str] | None = None,
    *,
    arms: tuple[str, str] | None = None,
    seed: int = 0,
) -> list[Table]:
    """Compare the cells that two experiments share, or two arms of one (then ``second`` may be left out).

    Returns
    -------
    One table of the settings that differ (two experiments only), and one of paired differences, second minus
    first, of every summary: mean, 95 % interval over seeds within maps, p after Holm over all rows.
    """
    if second is None and arms is None:
        raise TaskliftError("runs compare: give two experiments, or one and two of its arms")
    other = first if second is None else second
    with Store.read(first) as a, Store.read(other) as b:
        pair = f"{arms[1]} - {arms[0]}" if arms else ""
        left, right = _keyed(a, arms and arms[0], pair), _keyed(b, arms and arms[1], pair)
        changed = differences(a.spec.settings, b.spec.settings)
    shared = sorted(left.keys() & right.keys())
    if not shared:
        there = sorted({key[1] for key in left.keys() | right.keys()})
        raise TaskliftError(f"{first}, {other}: no cells in common for arms {arms or there}; `runs show` lists them")
    rows, p = [], []
    for reading, arm in sorted({key[:2] for key in shared}):
        keys = [key for key in shared if key[:2] == (reading, arm)]
        strata = [key[2] for key in keys]
        for name in sorted(set.intersection(*(set(left[key]) & set(right[key]) for key in keys))):
            x, y = (np.array([side[key][name] for key in keys]) for side in (left, right))
            found = stats.paired_difference(y, x, strata=strata, seed=seed)
            p.append(stats.sign_flip_test(y - x, seed=seed))
            rows.append([reading, arm, name, float(x.mean()), float(y.mean()), str(found), len(keys)])
    rows = [[*row, float(q)] for row, q in zip(rows, stats.holm(p) if p else [], strict=True)]
    headers = ["reading", "arm", "summary", "first", "second", "difference [95 %]", "pairs", "p (Holm)"]
    title = "Paired differences, second minus first"
    tables = [Table(title, headers, rows)]
    if second is not None:
        tables.insert(0, Table("Settings that differ", ["first, not second"], [[line] for line in changed]))
    return tables


def export(path: str | os.PathLike[str], out: str | os.PathLike[str], *, what: str = "trials") -> int:
    """Write rows to a ``.csv`` or ``.parquet`` file; return how many.

    Parameters
    ----------
    what
        ``"trials"``: a row per trial, with spec (the first 12 digits of its id), version, cell, stage, trial
        (from 1) and every column.
        ``"cells"``: a row per cell with its summaries.
    """
    target = Path(out)
    if target.suffix not in (".csv", ".parquet"):
        raise TaskliftError(f"{target}: expected a name that ends in .csv or .parquet")
    if what not in ("trials", "cells"):
        raise TaskliftError(f"runs export: {what!r}, expected 'trials' or 'cells'")
    part = target.with_name(f".{target.name}.{os.getpid()}.part")
    with Store.read(path) as store:
        if what == "trials" and store.detail == "summary":
            raise TaskliftError(f"{store.path}: keeps summaries only; export what='cells'")
        columns = _columns(store, what)
        batches = _batches(store, what, columns)
        try:
            count = (_write_csv if target.suffix == ".csv" else _write_parquet)(part, columns, batches)
            os.replace(part, target)
        except OSError as error:
            raise TaskliftError(f"{target}: cannot be written ({error.strerror}); choose another place") from error
        finally:
            with suppress(OSError):
                part.unlink(missing_ok=True)
    return count


# ---------------------------------------------------------------- parts


def _numbers(summary: dict[str, Any]) -> dict[str, float]:
    return {name: float(value) for name, value in summary.items() if isinstance(value, (int, float))}


def _keyed(store: Store, arm: str | None, pair: str) -> dict[tuple[str, str, str, int], dict[str, float]]:
    """Summaries by (reading, arm, map, seed); of one arm only if it is named, and then as `pair`."""
    return {
        (cell.reading, pair if arm else cell.arm, cell.map, cell.seed): _numbers(summary)
        for cell, summary in store.outlines(arm=arm)
    }


_KEYS: dict[str, type] = {"spec": str, "version": str, "reading": str, "map": str, "seed": int, "arm": str}


def _parts(store: Store, what: str) -> Iterator[tuple[Cell, str, dict[str, list[Any]]]]:
    """Yield (cell, stage, columns) in order; for cells the stage is empty and the columns hold one value."""
    if what == "cells":
        for cell, summary in store.outlines():
            yield cell, "", {name: [value] for name, value in summary.items()}
    else:
        for cell, result in store.select():
            for stage, columns in result.stages.items():
                yield cell, stage, {name: column.tolist() for name, column in columns.items()}


def _columns(store: Store, what: str) -> dict[str, type]:
    """Name and type of every exported column, by a first pass: cells and stages may differ."""
    found: dict[str, set[type]] = {}
    for _, _, columns in _parts(store, what):
        for name, values in columns.items():
            found.setdefault(name, set()).update(type(value) for value in values[:1] if value is not None)
    kinds: dict[str, type] = {}
    for name, types in sorted(found.items()):
        mixed = float if types <= {bool, int, float} else str
        kinds[name] = types.pop() if len(types) == 1 else mixed
    own = _KEYS if what == "cells" else _KEYS | {"stage": str, "trial": int}
    if clash := kinds.keys() & own.keys():
        raise TaskliftError(f"{store.path}: columns named {sorted(clash)} clash with the cell's own; rename them")
    return own | kinds


def _batches(store: Store, what: str, columns: dict[str, type]) -> Iterator[dict[str, list[Any]]]:
    """Yield the rows column by column, some hundred cells at a time; None where a cell lacks a column."""
    versions, spec = store.origins(), store.spec.id[:12]
    batch: dict[str, list[Any]] = {name: [] for name in columns}
    for count, (cell, stage, given) in enumerate(_parts(store, what), 1):
        n = len(next(iter(given.values()), [None]))
        own = (spec, versions[cell], cell.reading, cell.map, cell.seed, cell.arm)
        known = dict(zip(_KEYS, own, strict=True)) | {"stage": stage}
        for name, kind in columns.items():
            if name in given:
                values = given[name]
                batch[name] += values if kind is bool else [None if v is None else kind(v) for v in values]
            elif name == "trial":
                batch[name] += range(1, n + 1)
            else:
                batch[name] += [known.get(name)] * n
        if count % _CELLS_AT_ONCE == 0:
            yield batch
            batch = {name: [] for name in columns}
    yield batch


def _write_csv(path: Path, columns: dict[str, type], batches: Iterator[dict[str, list[Any]]]) -> int:
    count = 0
    with open(path, "w", newline="", encoding="utf-8") as file:
        writer = csv.writer(file)
        writer.writerow(columns)
        for batch in batches:
            writer.writerows(zip(*batch.values(), strict=True))
            count += len(batch["spec"])
    return count


def _write_parquet(path: Path, columns: dict[str, type], batches: Iterator[dict[str, list[Any]]]) -> int:
    try:
        import pyarrow
        from pyarrow import parquet
    except ImportError as error:
        raise TaskliftError("Parquet needs pyarrow: pip install 'tasklift[parquet]', or export to .csv") from error
    kinds = {str: pyarrow.string(), int: pyarrow.int64(), float: pyarrow.float64(), bool: pyarrow.bool_()}
    schema = pyarrow.schema([(name, kinds[kind]) for name, kind in columns.items()])
    count = 0
    with parquet.ParquetWriter(path, schema, compression="zstd") as writer:
        for batch in batches:
            writer.write_table(pyarrow.table(batch, schema=schema))
            count += len(batch["spec"])
    return count
