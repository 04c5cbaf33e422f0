"""What ``tasklift runs`` does: find experiments, show one, compare two or two values of an axis, export rows."""

from __future__ import annotations

import csv
import io
import os
import re
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import IO, Any, NamedTuple

import numpy as np

from tasklift import stats
from tasklift.errors import TaskliftError, missing
from tasklift.files import canonical_json, output_file, writing
from tasklift.lab.cell import Cell
from tasklift.lab.file import FILE_NAME
from tasklift.lab.store import Store

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
                cells = f"{len(store)} of {store.planned}"
                rows.append([place, store.spec.name, store.spec.id[:12], cells, store.detail, round(size, 1)])
        except TaskliftError as error:
            rows.append([place, str(error), "", "", "", round(size, 1)])
    return Table(f"Experiments in {root}", ["folder", "name", "spec", "cells", "detail", "MB"], rows)


def show(path: str | os.PathLike[str], *, over: Sequence[str] | None = None) -> list[Table]:
    """Show one experiment: its settings and axes, and the mean of every summary over some axes.

    Parameters
    ----------
    path
        The experiment's folder or file.
    over
        The axes over which to take means; by default those that the experiment names.

    Raises
    ------
    TaskliftError
        If there is no experiment, it is damaged, or it has no such axis.
    """
    with Store.read(path) as store:
        facts = {
            "name": store.spec.name,
            "spec": store.spec.id,
            "cells": f"{len(store)} of {store.planned}",
            "detail": store.detail,
            "written by": f"tasklift {store.release}",
        }
        settings = {f"settings.{key}": canonical_json(value) for key, value in store.spec.settings.items()}
        axes = {f"axes.{axis}": ", ".join(values) for axis, values in store.spec.axes.items()}
        by = _others(store, over)
        means: dict[tuple[str, ...], list[dict[str, float]]] = {}
        for cell, summary in store.outlines():
            means.setdefault(tuple(cell[axis] for axis in by), []).append(_numbers(summary))
    names = sorted({name for group in means.values() for summary in group for name in summary})
    rows = [
        [*key, len(group), *(_mean([summary[name] for summary in group if name in summary]) for name in names)]
        for key, group in means.items()
    ]
    return [
        Table(str(path), ["", ""], [[key, value] for key, value in (facts | settings | axes).items()]),
        Table("Means over cells", [*by, "cells", *names], rows),
    ]


def compare(
    first: str | os.PathLike[str],
    second: str | os.PathLike[str] | None = None,
    *,
    between: tuple[str, str, str] | None = None,
    over: Sequence[str] | None = None,
    seed: int = 0,
) -> list[Table]:
    """Compare the cells that two experiments share, or two values of an axis of one.

    Parameters
    ----------
    first, second
        Folders or files; ``second`` may be left out where ``between`` is given.
    between
        An axis and two of its values: ``("arm", "direct", "copy")``.
    over
        The axes over which differences are paired, from the outermost: the last one repeats, within strata of the
        others. By default those that the first experiment names.
    seed
        Of the resampling.

    Returns
    -------
    list of Table
        The settings that differ (two experiments only), and paired differences, second minus first, of every
        summary: mean, 95 % interval, p after Holm over all rows, and whether they differ by it.

    Raises
    ------
    TaskliftError
        If the two have no cells in common, or one is damaged.
    """
    if second is None and between is None:
        raise TaskliftError("runs compare: give two experiments, or one and --between AXIS=FIRST,SECOND")
    axis, *values = between or ("", None, None)
    other = first if second is None else second
    with Store.read(first) as a, Store.read(other) as b:
        over = list(a.spec.over) if over is None else list(over)
        by = [name for name in _others(a, over) if name != axis]
        left, right = (_keyed(store, axis, value) for store, value in zip((a, b), values, strict=True))
        changed = a.spec.conflicts(b.spec)
    shared = sorted(left.keys() & right.keys())
    if not shared:
        asked = f" for {axis} {values[0]} and {values[1]}" if between else ""
        raise TaskliftError(f"{first}, {other}: no cells in common{asked}; `tasklift runs show` lists what there is")
    rows, found = [], []
    for group in sorted({tuple(cell[name] for name in by) for cell in shared}):
        cells = [cell for cell in shared if tuple(cell[name] for name in by) == group]
        strata = [", ".join(cell[name] for name in over[:-1]) for cell in cells]
        for name in sorted(set.intersection(*(set(left[cell]) & set(right[cell]) for cell in cells))):
            x, y = (np.array([side[cell][name] for cell in cells]) for side in (left, right))
            found.append(stats.compare(y, x, strata=strata, seed=seed))
            rows.append([*group, name, float(x.mean()), float(y.mean()), str(found[-1].interval), len(cells)])
    rows = [[*row, one.p, _differs(one)] for row, one in zip(rows, stats.after_holm(found), strict=True)]
    means = values if between else ("first", "second")
    headers = [*by, "summary", *means, "difference [95 %]", "pairs", "p (Holm)", "verdict"]
    tables = [Table("Paired differences, second minus first", headers, rows)]
    if second is not None:
        tables.insert(0, Table("Settings that differ", ["first, not second"], [[line] for line in changed]))
    return tables


def _differs(found: stats.Comparison) -> str:
    return "differs" if found.verdict in ("holds", "does not hold") else found.says


def export(
    path: str | os.PathLike[str], out: str | os.PathLike[str], *, what: str = "trials", force: bool = True
) -> int:
    """Write rows to a ``.csv`` or ``.parquet`` file; return how many.

    Parameters
    ----------
    path
        The experiment's folder or file.
    out
        The file to write.
    what
        ``"trials"``: a row per trial, with spec (the first 12 digits of its id), release, axes, stage, trial
        (from 1) and every column.
        ``"cells"``: a row per cell with its summaries.
    force
        Whether a file that is there is replaced; the command line asks for ``--force``.

    Raises
    ------
    TaskliftError
        If there is no experiment, it is damaged, or ``out`` cannot be written; a file that was there is still there.
    """
    target = output_file(out, (".csv", ".parquet"), force=force)
    if what not in ("trials", "cells"):
        raise TaskliftError(f"runs export: {what!r}, expected 'trials' or 'cells'")
    with Store.read(path) as store:
        if what == "trials" and store.detail == "summary":
            raise TaskliftError(f"{store.path}: keeps summaries only; export what='cells'")
        columns = _columns(store, what)
        batches = _batches(store, what, columns)
        write = _write_csv if target.suffix.lower() == ".csv" else _write_parquet
        with writing(target, replace=force) as file:
            return write(file, columns, batches)


# ---------------------------------------------------------------- parts


def _numbers(summary: dict[str, Any]) -> dict[str, float]:
    return {name: float(value) for name, value in summary.items() if isinstance(value, (int, float))}


def _mean(values: list[float]) -> float | None:
    return float(np.mean(values)) if values else None


def _others(store: Store, over: Sequence[str] | None) -> list[str]:
    """The axes over which no means are taken."""
    over = store.spec.over if over is None else over
    if unknown := [axis for axis in over if axis not in store.spec.axes]:
        raise TaskliftError(f"{store.path}: no axis {unknown[0]!r}; the axes are {', '.join(store.spec.axes)}")
    return [axis for axis in store.spec.axes if axis not in over]


def _keyed(store: Store, axis: str, value: str | None) -> dict[Cell, dict[str, float]]:
    """Summaries by cell; where an axis is compared, of one value of it, and by the other axes."""
    found = {}
    for cell, summary in store.outlines(**({axis: value} if axis else {})):
        others = {name: value for name, value in cell.items if name != axis}
        found[Cell.of(others, others.values())] = _numbers(summary)
    return found


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
    own: dict[str, type] = {"spec": str, "release": str}
    for axis, kept in store.spec.axes.items():
        own[axis] = int if all(re.fullmatch("0|-?[1-9][0-9]{0,17}", value) for value in kept) else str
    own |= {} if what == "cells" else {"stage": str, "trial": int}
    if clash := kinds.keys() & own.keys():
        raise TaskliftError(f"{store.path}: columns named {sorted(clash)} clash with the cell's own; rename them")
    return own | kinds


def _batches(store: Store, what: str, columns: dict[str, type]) -> Iterator[dict[str, list[Any]]]:
    """Yield the rows column by column, some hundred cells at a time; None where a cell lacks a column."""
    of = {"spec": store.spec.id[:12], "release": store.release}
    batch: dict[str, list[Any]] = {name: [] for name in columns}
    for count, (cell, stage, given) in enumerate(_parts(store, what), 1):
        n = len(next(iter(given.values()), [None]))
        known = of | cell.axes | {"stage": stage}
        for name, kind in columns.items():
            if name in given:
                values = given[name]
                batch[name] += values if kind is bool else [None if v is None else kind(v) for v in values]
            elif name == "trial":
                batch[name] += range(1, n + 1)
            else:
                batch[name] += [kind(known[name]) if name in known else None] * n
        if count % _CELLS_AT_ONCE == 0:
            yield batch
            batch = {name: [] for name in columns}
    yield batch


def _write_csv(file: IO[bytes], columns: dict[str, type], batches: Iterator[dict[str, list[Any]]]) -> int:
    count = 0
    text = io.TextIOWrapper(file, encoding="utf-8", newline="")
    writer = csv.writer(text)
    writer.writerow(columns)
    for batch in batches:
        writer.writerows(zip(*batch.values(), strict=True))
        count += len(batch["spec"])
    text.detach()  # flushed; the file stays open
    return count


def _write_parquet(file: IO[bytes], columns: dict[str, type], batches: Iterator[dict[str, list[Any]]]) -> int:
    try:
        import pyarrow
        from pyarrow import parquet
    except ImportError as error:
        raise missing("pyarrow", "parquet", "Parquet (.csv needs nothing)") from error
    kinds = {str: pyarrow.string(), int: pyarrow.int64(), float: pyarrow.float64(), bool: pyarrow.bool_()}
    schema = pyarrow.schema([(name, kinds[kind]) for name, kind in columns.items()])
    count = 0
    with parquet.ParquetWriter(file, schema, compression="zstd") as writer:
        for batch in batches:
            writer.write_table(pyarrow.table(batch, schema=schema))
            count += len(batch["spec"])
    return count
