"""Running cells: what is missing, on all cores, committed one by one, stopped and resumed at will."""

from __future__ import annotations

import queue
import random
import signal
import threading
import time
from collections.abc import Callable, Generator, Iterable, Iterator
from concurrent.futures import ThreadPoolExecutor
from contextlib import closing, contextmanager
from dataclasses import dataclass
from itertools import groupby
from typing import Protocol

from tasklift.errors import TaskliftError
from tasklift.lab.cell import Cell, CellResult
from tasklift.lab.packing import Detail, Packed
from tasklift.lab.store import Store
from tasklift.lab.work import Group, Stopped, Work, compute
from tasklift.processes import cores


class Progress(Protocol):
    """Called in the main thread after every commit, and with a note when a stop was asked for."""

    def __call__(self, done: int, total: int, note: str) -> None:
        """``done`` of ``total`` cells are in the store; ``note`` is the last cell, or what is going on."""


@dataclass(frozen=True)
class Ran:
    """What a run did: cells of the request, how many of them it computed, and the time it took (s)."""

    total: int
    computed: int
    seconds: float


class Interrupted(KeyboardInterrupt):
    """Ctrl-C, after what was in flight has been committed; its text tells how to go on."""


def run(
    store: Store,
    cells: Iterable[Cell],
    work: Work,
    *,
    engine: str = "threads",
    workers: int | None = None,
    address: str | None = None,
    progress: Progress | None = None,
) -> Ran:
    """Compute the cells that the store lacks, and commit each as soon as it is there.

    Parameters
    ----------
    work
        ``work(cell) -> CellResult``, a function of the cell alone. On threads it should release the GIL (a
        Numba kernel does). The cells of one group (all axes but the last one) run one after another in the
        same worker, so a small cache in ``work`` is enough for what they share. For Ray it must be picklable: a
        module-level function, or ``functools.partial`` of one.
    engine
        ``"threads"`` or ``"ray"``; both give the same rows.
    workers
        Threads, or the size of a local Ray; by default one per core.
    address
        For Ray: of a running cluster (``"auto"`` or ``"HOST:PORT"``); by default a local one is started.

    Raises
    ------
    Interrupted
        At Ctrl-C. A second Ctrl-C drops what is in flight; threads still end the cell they are in.
    TaskliftError
        From the work (the message then names the cell) or from the store. What was committed stays.
    """
    start = time.perf_counter()
    wanted = list(dict.fromkeys(cells))
    for cell in wanted:
        if not store.spec.covers(cell):
            raise TaskliftError(f"cell {cell}: not of this experiment, whose axes are {_axes(store)}")
    damaged = store.mend()
    there = store.done()
    missing = [cell for cell in wanted if cell not in there]
    store.plan(len(missing))
    done, computed = len(wanted) - len(missing), 0
    if damaged and progress is not None:
        progress(done, len(wanted), f"{damaged} damaged cells are computed again")
    with _stop_at_interrupt(progress, lambda: (done, len(wanted))) as stopped:
        groups = _groups_to_do(store, missing)
        try:
            # closing: where a commit fails, the engine ends its workers before the error goes up
            with closing(_engine(engine, workers, address)(groups, work, store.detail, stopped)) as results:
                for packed in results:
                    computed += store.add(packed)
                    done += 1
                    if progress is not None:
                        progress(done, len(wanted), str(packed.cell))
        except KeyboardInterrupt:  # the second one
            raise _interrupted(store, wanted) from None
        if stopped():
            raise _interrupted(store, wanted)
    return Ran(len(wanted), computed, time.perf_counter() - start)


def _interrupted(store: Store, wanted: list[Cell]) -> Interrupted:
    return Interrupted(
        f"stopped: {len(store.done().intersection(wanted))} of {len(wanted)} cells are in {store.path}; the same "
        "command goes on from there"
    )


def _axes(store: Store) -> str:
    return "; ".join(f"{axis}: {', '.join(list(values)[:3])}, …" for axis, values in store.spec.axes.items())


Engine = Callable[[Iterator[Group], Work, Detail, Stopped], Generator[Packed, None, None]]


def _engine(name: str, workers: int | None, address: str | None) -> Engine:
    if workers is not None and workers < 1:
        raise TaskliftError(f"workers: expected at least 1, found {workers}")
    if name == "threads":
        if address is not None:
            raise TaskliftError(f"address {address!r} is for the engine 'ray'; add --engine ray")
        count = workers or cores()
        return lambda groups, work, detail, stopped: threads(groups, work, detail, stopped, workers=count)
    if name == "ray":
        from tasklift.lab import ray

        return lambda groups, work, detail, stopped: ray.tasks(
            groups, work, detail, stopped, workers=workers, address=address
        )
    raise TaskliftError(f"engine {name!r}: expected 'threads' or 'ray'")


def _groups_to_do(store: Store, missing: list[Cell]) -> Iterator[Group]:
    """Yield groups of cells in order, without what another process has put into the store meanwhile."""
    groups = [list(group) for _, group in groupby(missing, key=lambda cell: cell.group)]
    groups.reverse()
    alone = True
    while groups:
        todo = [cell for cell in groups.pop() if cell not in store]
        if todo:
            yield todo
        elif alone:  # someone is ahead of us on the same path: take another one
            alone = False
            random.shuffle(groups)


@contextmanager
def _stop_at_interrupt(progress: Progress | None, count: Callable[[], tuple[int, int]]) -> Iterator[Stopped]:
    """Make the first Ctrl-C a flag and the second one a KeyboardInterrupt (in the main thread only)."""
    flag = threading.Event()

    def handle(number: int, frame: object) -> None:
        if flag.is_set():
            raise KeyboardInterrupt
        flag.set()
        if progress is not None:
            progress(*count(), "stopping after the cells in flight; Ctrl-C again drops them")

    if threading.current_thread() is not threading.main_thread():
        yield flag.is_set
        return
    before = signal.signal(signal.SIGINT, handle)
    try:
        yield flag.is_set
    finally:
        signal.signal(signal.SIGINT, before)


def threads(
    groups: Iterator[Group], work: Work, detail: Detail, stopped: Stopped, *, workers: int
) -> Generator[Packed, None, None]:
    """Yield packed cells as `workers` threads finish them; after a stop or an error, what is in flight."""
    results: queue.SimpleQueue[Packed | BaseException | None] = queue.SimpleQueue()
    halt = threading.Event()

    def serve(group: Group) -> None:
        try:
            for cell in group:
                if halt.is_set() or stopped():
                    break
                results.put(compute(work, cell, detail))
        except BaseException as error:
            results.put(error)
        finally:
            results.put(None)

    failure: BaseException | None = None
    with ThreadPoolExecutor(workers, thread_name_prefix="cell") as pool:
        try:
            open_groups, more = 0, True
            while more or open_groups:
                # one group waits beside those in work, so that no thread idles while the main one commits
                while more and open_groups <= workers:
                    group = None if stopped() or failure else next(groups, None)
                    if group is None:
                        more = False
                    else:
                        pool.submit(serve, group)
                        open_groups += 1
                if not open_groups:
                    break
                item = results.get()
                if item is None:
                    open_groups -= 1
                elif isinstance(item, BaseException):
                    failure = failure or item
                    halt.set()
                else:
                    yield item
        finally:
            halt.set()
    if failure is not None:
        raise failure


def recompute(store: Store, cell: Cell, work: Work) -> CellResult:
    """Compute a cell of the store again, whole, and check that its summary came out the same.

    This is how rows are read from a store that keeps only summaries.
    """
    kept = store.result(cell)
    result = work(cell)
    if Packed.of(cell, result, "summary") != Packed.of(cell, kept, "summary"):
        raise TaskliftError(
            f"{store.path}: cell {cell} gives another summary now; tasklift {store.release} wrote it: install that "
            "release to read its rows"
        )
    return result
