"""Work in processes: the order of results, and what becomes of errors."""

from __future__ import annotations

import os
import signal
import sys

import pytest

from tasklift.errors import TaskliftError
from tasklift.processes import in_processes


class Odd(Exception):
    """An error that cannot be sent to another process."""

    def __init__(self, one: int, two: int) -> None:
        super().__init__(f"{one} and {two}")


@pytest.mark.parametrize("workers", [1, 2, 3, 9])
def test_results_come_in_the_order_of_the_numbers(workers: int) -> None:
    factor = 3  # a function of what is around it cannot be pickled, and need not be
    assert list(in_processes(lambda n: factor * n, range(5, 12), workers)) == [factor * n for n in range(5, 12)]


@pytest.mark.skipif(sys.platform != "linux", reason="processes are forked on Linux only")
def test_every_process_does_its_share() -> None:
    assert len(set(in_processes(lambda n: os.getpid(), range(6), 3)) - {os.getpid()}) == 3


@pytest.mark.skipif(sys.platform != "linux", reason="processes are forked on Linux only")
@pytest.mark.parametrize(("error", "kind", "says"), [
    (TaskliftError("no door"), TaskliftError, "no door"),
    (KeyError("door"), KeyError, "door"),
    (Odd(1, 2), RuntimeError, "Odd: 1 and 2"),
])  # fmt: skip
def test_an_error_comes_out_with_its_traceback(error: Exception, kind: type[Exception], says: str) -> None:
    def work(number: int) -> int:
        if number == 2:
            raise error
        return number

    found = in_processes(work, range(4), 2)
    assert [next(found), next(found)] == [0, 1]
    with pytest.raises(kind, match=says) as raised:
        next(found)
    assert "in work" in raised.value.__notes__[-1]


@pytest.mark.skipif(sys.platform != "linux", reason="processes are forked on Linux only")
def test_a_process_that_is_killed_is_noticed() -> None:
    with pytest.raises(TaskliftError, match="ended from outside"):
        list(in_processes(lambda n: os.kill(os.getpid(), signal.SIGKILL), range(4), 2))
