"""Commands that are killed or interrupted at random moments: the same command finishes the work, as if nothing was.

Every command runs once unbroken. Then, each time in a new folder, it is stopped a few times by SIGKILL, SIGTERM or
SIGINT, and run again to its end. It must then have the same files with the same content as the unbroken one, and none
beside. Ctrl-C must end in one line with exit code 130.

    python tests/kills.py --rounds 20        # every command, 60 stops each
    python tests/kills.py train certify

Commands run in forks of one process that has everything imported, so that a stop falls into their work.
"""

from __future__ import annotations

import argparse
import hashlib
import os
import random
import re
import shutil
import signal
import sys
import tempfile
import threading
import time
import traceback
from collections import Counter
from importlib import import_module
from pathlib import Path

SMALL = ["--team", "2+2", "--limit", "40"]
LEARN = """
name = "small"
seeds = 6
performance = "steps"
environment = { building = "b.json", team = "2+2", hostiles = 1, limit = 40 }
learner = { rule = "reinforcement" }
stages = [{ name = "V", options = { hostiles = 0 }, trials = 20 }, { name = "T", trials = 20 }]
"""
SIMPLIFY = """
name = "small"
environment = { building = "b.json", team = "2+2", hostiles = 1, limit = 20 }
learner = { rule = "reinforcement" }
stages = [{ name = "T", trials = 5 }]
simplify = { trials = 5, seeds = 6, depth = 0 }
"""

#: By name: the command, and the outputs besides its folder ``out``.
COMMANDS = {
    "train": ["train", "b.json", *SMALL, "--seeds", "3", "--trials", "20", "--practice", "2000", "--out", "out"],
    "learn": ["learn", "learn.toml", "--out", "out"],
    "simplify": ["simplify", "simplify.toml", "--out", "out"],
    "team": ["team", "b.json", "--scouts", "2", "--weapons", "2,3", "--limit", "40", "--practice", "6000",
             "--out", "out"],
    "drills": ["drills", "--maps", "1", "--seeds", "1", "--hostiles", "1", "--out", "out"],
    "multiverse": ["multiverse", "--readings", "2", "--maps", "1", "--seeds", "2", "--trials", "10", "--out", "out"],
    "reproduce": [
        "reproduce", "--maps", "1", "--seeds", "2", "--trials", "10", "--survey", "2", "--practice", "500",
        "--arms", "direct,direct-budget,copy,prior,copy-prior", "--out", "out",
    ],
    "certify": ["certify", "policy.json", "--building", "b.json", *SMALL, "--episodes", "60000"],
    "map import": ["map", "import", "office.yaml"],
    "policy export": ["policy", "export", "policy.json", "-o", "package"],
}  # fmt: skip
MODULES = ("studies.train", "studies.learn", "studies.simplify.answer", "studies.team", "studies.drills.report",
           "studies.multiverse.report", "studies.paper.reproduce", "studies.certify", "plans.importing", "watch.html",
           "tasks.exports", "cli.plans", "cli.certify", "cli.experiments", "cli.learn", "cli.policy", "cli.simplify",
           "cli.team")  # fmt: skip


def prepare(folder: Path) -> None:
    """Write what the commands read."""
    from tasklift.building import Mission, generate
    from tasklift.tasks.policy import Policy

    building = generate(intersections=4, corridors=4, rooms=2, features=4, seed=1)
    building.save(folder / "b.json")
    Policy.equal(Mission(building, "2+2").task).save(folder / "policy.json")
    (folder / "learn.toml").write_text(LEARN)
    (folder / "simplify.toml").write_text(SIMPLIFY)
    for file in (Path(__file__).parent / "plans" / "samples" / "ros").iterdir():
        shutil.copy(file, folder)


def start(words: list[str], folder: Path) -> int:
    """Run a command in a fork; return its process id once it begins. What it says is in ``said`` beside the folder."""
    begun, begins = os.pipe()
    pid = os.fork()
    if pid:
        os.close(begins)
        os.read(begun, 1)
        os.close(begun)
        return pid
    os.chdir(folder)
    said = os.open(folder.with_name("said"), os.O_WRONLY | os.O_CREAT | os.O_TRUNC)
    os.dup2(os.open(os.devnull, os.O_RDWR), 0)
    os.dup2(said, 1)
    os.dup2(said, 2)
    sys.argv = ["tasklift", *words]
    run = import_module("tasklift.__main__").main
    os.write(begins, b".")
    code = 1
    try:
        run()
        code = 0
    except SystemExit as end:
        code = int(end.code or 0)
    except BaseException:
        traceback.print_exc()
    finally:
        sys.stdout.flush()
        sys.stderr.flush()
        os._exit(code)


def finish(words: list[str], folder: Path) -> float:
    """Run a command to its end; return the time it took (s)."""
    since = time.perf_counter()
    _, status = os.waitpid(start(words, folder), 0)
    assert os.waitstatus_to_exitcode(status) == 0, folder.with_name("said").read_text()
    return time.perf_counter() - since


def stop(words: list[str], folder: Path, number: int, after_s: float) -> bool:
    """Run a command, and stop it; return whether the signal came before its end."""
    pid = start(words, folder)
    timer = threading.Timer(after_s, os.kill, (pid, number))
    timer.start()
    _, status = os.waitpid(pid, 0)
    timer.cancel()
    timer.join()
    code, said = os.waitstatus_to_exitcode(status), folder.with_name("said").read_text()
    assert code in (0, -number) or (code, number) == (130, signal.SIGINT), f"exit code {code}: {said}"
    if code == 130:
        lines = [line for line in re.split("[\r\n]+", said) if line.startswith("tasklift: ")]
        assert len(lines) == 1, said
        assert "Traceback" not in said, said
        assert "Error" not in said, said
    return code != 0


def contents(folder: Path) -> dict[str, str]:
    """Return what every file holds, as a digest: a store's rows, a report without its date and duration."""
    from tasklift.lab import FILE_NAME, Store

    found = {}
    for path in sorted(folder.rglob("*")):
        name = str(path.relative_to(folder))
        if path.name == FILE_NAME:
            with Store.read(path) as store:
                found[name] = store.digest()
        elif path.is_file():
            timeless = re.sub(rb"Written [0-9: -]+ UTC|This command took [0-9 mins]+\.", b"", path.read_bytes())
            found[name] = hashlib.sha256(timeless).hexdigest()
    return found


def stopped(name: str, rounds: int, stops: int = 3) -> str:
    """Stop a command at random moments, ``stops`` times in each round; return how often by which signal."""
    words, rng, came = COMMANDS[name], random.Random(name), Counter[str]()
    with tempfile.TemporaryDirectory() as scratch:
        base = Path(scratch) / "base"
        base.mkdir()
        prepare(base)
        unbroken = shutil.copytree(base, Path(scratch) / "unbroken" / "w")
        finish(words, unbroken)
        expected, took = contents(unbroken), finish(words, shutil.copytree(base, Path(scratch) / "again" / "w"))
        for number in range(rounds):
            folder = shutil.copytree(base, Path(scratch) / str(number) / "w")
            for k, signal_ in enumerate(rng.sample([signal.SIGKILL, signal.SIGTERM, signal.SIGINT], stops)):
                if stop(words, folder, signal_, rng.uniform(0, took / (k + 1))):  # less is left to do each time
                    came[signal_.name] += 1
                else:
                    break
            else:
                finish(words, folder)
            found = contents(folder)
            assert found == expected, sorted(found.items() ^ expected.items())
    return ", ".join(f"{count} by {which}" for which, count in sorted(came.items()))


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("commands", nargs="*", help=f"some of {', '.join(COMMANDS)}; default: all")
    parser.add_argument("--rounds", type=int, default=20)
    given = parser.parse_args()
    for module in MODULES:
        import_module(f"tasklift.{module}")
    for name in given.commands or COMMANDS:
        print(f"{name}: stopped {stopped(name, given.rounds)}; all finished alike", flush=True)


if __name__ == "__main__":
    main()
