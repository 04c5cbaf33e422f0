"""Work on all cores, in processes of its own, for what threads would not make faster."""

from __future__ import annotations

import multiprocessing
import os
import pickle
import signal
import sys
import traceback
import warnings
from collections.abc import Callable, Iterator, Sequence
from multiprocessing.connection import Connection
from typing import Any, TypeVar

from tasklift.errors import TaskliftError

T = TypeVar("T")


def cores() -> int:
    """Return how many cores this process may use."""
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1


def in_processes(work: Callable[[int], T], numbers: Sequence[int], workers: int) -> Iterator[T]:
    """Yield ``work(number)`` for each of the numbers, in their order, from forked processes that take turns.

    A forked process starts as a copy of this one, so that ``work`` may be any function of any objects. Systems other
    than Linux do it all in this process.

    Parameters
    ----------
    work
        A function; what it returns has to be picklable.
    numbers
        What it is called with.
    workers
        Number of processes; 1: this one.

    Raises
    ------
    TaskliftError
        If a process was ended from outside. What ``work`` raises is raised here.

    Examples
    --------
    >>> list(in_processes(lambda number: number**2, range(5), workers=2))
    [0, 1, 4, 9, 16]
    """
    workers = min(workers, len(numbers))
    if workers <= 1 or sys.platform != "linux":
        yield from map(work, numbers)
        return
    fork = multiprocessing.get_context("fork")
    receivers, processes = [], []
    for share in range(workers):
        receiver, sender = fork.Pipe(duplex=False)
        processes.append(fork.Process(target=_share, args=(work, numbers[share::workers], sender)))
        with warnings.catch_warnings():
            # from Python 3.12 on, of any process with threads; those that NumPy's BLAS keeps are ready for it
            warnings.simplefilter("ignore", DeprecationWarning)
            processes[-1].start()
        sender.close()  # so that the receiver notices the end of the process
        receivers.append(receiver)
    try:
        for turn in range(len(numbers)):
            try:
                found, error = receivers[turn % workers].recv()
            except EOFError:
                raise TaskliftError("a process was ended from outside; memory may be short: try workers=1") from None
            if error is not None:
                raise error
            yield found
    finally:
        for process in processes:
            process.terminate()
            process.join()


def _share(work: Callable[[int], Any], numbers: Sequence[int], sender: Connection) -> None:
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # the first process hears it, and ends the others
    for number in numbers:
        try:
            sender.send((work(number), None))
        except Exception as error:
            sender.send((None, _portable(error)))


def _portable(error: Exception) -> Exception:
    """Return an error that another process can raise, with its traceback as a note."""
    try:
        found = pickle.loads(pickle.dumps(error))
    except Exception:  # an error of somebody's own, whose parts cannot be sent
        found = RuntimeError(f"{type(error).__name__}: {error}")
    found.add_note("".join(traceback.format_exception(error)))
    assert isinstance(found, Exception)
    return found
