"""The same cells on a Ray cluster, or on a local Ray: the same rows as threads give."""

from __future__ import annotations

import logging
import os
import secrets
import socket
import sys
from collections.abc import Generator, Iterator
from typing import Any

from tasklift.errors import TaskliftError, missing
from tasklift.lab.packing import Detail, Packed
from tasklift.lab.work import Group, Stopped, Work, compute
from tasklift.processes import cores

_RETRIES = 5  # of a group whose worker or node died; tasks keep no state, so repeating one is safe


def tasks(
    groups: Iterator[Group],
    work: Work,
    detail: Detail,
    stopped: Stopped,
    *,
    workers: int | None = None,
    address: str | None = None,
) -> Generator[Packed, None, None]:
    """Yield packed cells as Ray tasks finish: one task and one core per group, in any order.

    Only this process writes the store; tasks give back bytes. A task whose worker or node dies is repeated.
    A Ray that this process has started or joined already is used as it is, and left running.

    Raises
    ------
    TaskliftError
        If Ray is not installed, no cluster answers at ``address``, or the work fails.
    """
    try:
        import ray
    except ImportError as error:
        raise missing("Ray", "ray", "the engine 'ray'") from error
    started = not ray.is_initialized()
    if started:
        _connect(ray, workers, address)
    try:
        remote = ray.remote(max_retries=_RETRIES, num_cpus=1)(_compute_group)
        run, shared = secrets.token_hex(8), [ray.put((work, detail))]
        # two groups per core: one in work, one on its way
        limit = 2 * max(1, int(ray.cluster_resources().get("CPU", 1)))
        pending: list[Any] = []
        while True:
            while len(pending) < limit and not stopped() and (group := next(groups, None)):
                pending.append(remote.remote(run, shared, group))
            if not pending:
                return
            ready, pending = ray.wait(pending, timeout=1.0)
            for task in ready:
                yield from _received(ray, task)
    finally:
        if started:
            ray.shutdown()


def _connect(ray: Any, workers: int | None, address: str | None) -> None:
    options: dict[str, Any] = {"logging_level": logging.ERROR, "log_to_driver": False}
    if address is None:
        # statistics about usage would go over the network from a machine that asked for nothing of the kind
        os.environ.setdefault("RAY_USAGE_STATS_ENABLED", "0")
        options |= {"num_cpus": workers or cores(), "include_dashboard": False}
        # what this process can import, its workers can
        options["runtime_env"] = {"env_vars": {"PYTHONPATH": os.pathsep.join(filter(None, sys.path))}}
    elif workers is not None:
        raise TaskliftError(f"workers {workers}: a running cluster ({address}) has its own; leave one out")
    else:
        _knock(address)
    try:
        ray.init(address=address or "local", **options)
    except (ConnectionError, ValueError, RuntimeError) as error:
        raise TaskliftError(
            f"Ray at {address or 'this machine'}: cannot connect ({error}); it must run the same Ray and Python "
            "version, and where it asks for a token, RAY_AUTH_MODE=token must be set here"
        ) from error


def _knock(address: str) -> None:
    """See that someone listens at the address: Ray itself would try for minutes."""
    if address in ("auto", "local"):
        return
    host, _, port = address.removeprefix("ray://").rpartition(":")
    try:
        socket.create_connection((host, int(port)), timeout=10).close()
    except (OSError, ValueError) as error:
        raise TaskliftError(
            f"Ray at {address}: nobody answers ({error}); expected 'auto' or HOST:PORT of a running cluster"
        ) from error


_kept: dict[str, tuple[Work, Detail]] = {}  # in a worker process: what it computes with, by run


def _compute_group(run: str, shared: list[Any], group: Group) -> list[Packed]:
    # fetched once per process, not per task: the work may keep things (simulators) that are dear to make
    if run not in _kept:
        import ray

        _kept.clear()
        _kept[run] = ray.get(shared[0])
    work, detail = _kept[run]
    return [compute(work, cell, detail) for cell in group]


def _received(ray: Any, task: Any) -> list[Packed]:
    try:
        packed: list[Packed] = ray.get(task)
        return packed
    except ray.exceptions.RayTaskError as error:
        if isinstance(error.cause, TaskliftError):
            raise TaskliftError(str(error.cause)) from None
        raise
    except ray.exceptions.WorkerCrashedError as error:
        raise TaskliftError(
            f"Ray: a worker died {_RETRIES + 1} times on the same cells; memory may be short"
        ) from error
