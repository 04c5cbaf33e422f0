"""A real local Ray of two workers, one of which is killed in the middle, gives the rows that threads give.

Marked slow: Ray takes some 5 s to start and 5 s to replace a worker.
"""

from __future__ import annotations

import os
import signal
import sys
import threading
import time
from functools import partial

import pytest
from lab_work import CELLS, SPEC, work, work_and_wait_for_death

from tasklift.errors import TaskliftError
from tasklift.lab import Store, run

ray = pytest.importorskip("ray", reason="Ray is not installed: pip install 'tasklift[ray]'")

# what Ray leaves open or deprecated in itself is not ours to mend
pytestmark = [
    pytest.mark.slow,
    pytest.mark.filterwarnings("ignore::ResourceWarning"),
    pytest.mark.filterwarnings("ignore::DeprecationWarning"),
    pytest.mark.filterwarnings("ignore::FutureWarning"),
    pytest.mark.filterwarnings("ignore::pytest.PytestUnraisableExceptionWarning"),
]


@pytest.fixture(scope="module")
def local_ray():
    """One Ray for the tests that do not start their own."""
    os.environ["RAY_USAGE_STATS_ENABLED"] = "0"
    here = os.pathsep.join([os.path.dirname(__file__), *filter(None, sys.path)])
    ray.init(
        num_cpus=2,
        include_dashboard=False,
        log_to_driver=False,
        runtime_env={"env_vars": {"PYTHONPATH": here}},
    )
    yield
    ray.shutdown()


def fail_on_seed_2(cell):
    if cell["seed"] == "2":
        raise TaskliftError("no door")
    return work(cell)


@pytest.mark.parametrize("address", ["127.0.0.1:1", "ray://127.0.0.1:1", "no such place"])
def test_a_cluster_that_does_not_answer_is_named(tmp_path, address):
    with (
        Store.open(tmp_path / "e.sqlite", SPEC) as store,
        pytest.raises(TaskliftError, match=f"Ray at {address}"),
    ):
        run(store, CELLS, work, engine="ray", address=address)


def test_it_starts_a_ray_of_its_own_and_ends_it(tmp_path):
    with Store.open(tmp_path / "e.sqlite", SPEC) as store:
        assert run(store, CELLS, work, engine="ray", workers=2).computed == len(CELLS)
        for cell in CELLS[::9]:
            assert store.result(cell).summary == work(cell).summary
    assert not ray.is_initialized()


def test_a_killed_worker_changes_no_row(tmp_path, local_ray):
    with Store.open(tmp_path / "threads.sqlite", SPEC) as store:
        run(store, CELLS, work)
        expected = store.digest()
    note = tmp_path / "note"
    killed = []

    def kill():
        while not killed:
            time.sleep(0.02)
            if note.exists() and (text := note.read_text()):
                os.kill(int(text), signal.SIGKILL)
                killed.append(int(text))

    killer = threading.Thread(target=kill, daemon=True)
    killer.start()
    with Store.open(tmp_path / "ray.sqlite", SPEC) as store:
        run(store, CELLS, partial(work_and_wait_for_death, note=str(note)), engine="ray")
        assert len(killed) == 1
        assert killed[0] != os.getpid()
        assert store.digest() == expected


def test_errors_of_the_work_come_back_in_one_line(tmp_path, local_ray):
    with Store.open(tmp_path / "e.sqlite", SPEC) as store:
        with pytest.raises(TaskliftError, match=r"^cell .*seed 2.*: no door$"):
            run(store, CELLS, fail_on_seed_2, engine="ray")
        assert len(store) < len(CELLS)
