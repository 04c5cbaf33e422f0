"""Commands that are stopped at random moments finish as if nothing was; ``tests/kills.py`` says how."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import pytest

import kills

QUICK = ("certify", "map import", "policy export", "learn")


@pytest.mark.skipif(sys.platform == "win32", reason="kills.py forks")
@pytest.mark.parametrize(
    "names", [QUICK, *(pytest.param((name,), marks=pytest.mark.slow) for name in kills.COMMANDS if name not in QUICK)]
)
def test_stopped_commands_finish_as_if_nothing_was(names: tuple[str, ...]) -> None:
    rounds = "1" if names == QUICK else "5"
    line = [sys.executable, str(Path(kills.__file__)), "--rounds", rounds, *names]
    done = subprocess.run(line, capture_output=True, text=True, timeout=1200)
    print(done.stdout)
    assert done.returncode == 0, done.stderr
    assert done.stdout.count("all finished alike") == len(names)
