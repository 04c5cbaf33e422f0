"""Mutation fuzzing of everything that reads a file: damaged, hostile or absurd input ends in one clear line.

Input number ``i`` of a reader is a function of its name, ``i`` and the samples, so a failure is repeated by its
number. Bytes are damaged, and where a sample is JSON its values are exchanged as well. An input must be read, or
refused by a :class:`TaskliftError` in one line of at most 300 characters that names the file, within 5 seconds and
1 GB. What is read is used, as later commands use it.

    python tests/fuzz.py --runs 100000            # every reader
    python tests/fuzz.py policy --only 4711       # one input again
"""

from __future__ import annotations

import argparse
import hashlib
import json
import random
import resource
import sqlite3
import sys
import tempfile
import time
from collections.abc import Callable, Iterator
from contextlib import suppress
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import Any

from tasklift.errors import TaskliftError, about

LONGEST_LINE, LONGEST_S, LARGEST_B = 300, 5.0, 1_000_000_000

#: Where files are quick to write, if there is such a place.
MEMORY = "/dev/shm" if Path("/dev/shm").is_dir() else None

TOKENS = (
    b"", b"0", b"-1", b"1", b"2", b"1e400", b"-1e400", b"1e-320", b"NaN", b"Infinity", b"nan", b"inf", b"null", b"true",
    b"9" * 30, b"7" * 5000, b"0.1", b"-0.0", b"1e308", b"9223372036854775808", b"18446744073709551616", b"2147483648",
    b'""', b'"\\ud800"', b'"\\u0000"', b'"\\u001b[2J"', b'"a\\nb"', b"\xff", b"\x00", b"\xed\xa0\x80", b"\xef\xbb\xbf",
    b"\xc2\xb2", b"[" * 300, b"[" * 100_000, b"{}", b"[]", b"]", b"}", b",", b":", b"\n", b"\r\n", b"\x1b[31m", b"'",
    b'"', b"[[", b"]]", b"=", b"#", b"a.b.c = 1", b".", b"..", b"/dev/zero", b"\\", b"$\\frac$", b"2026-01-01",
    b"&a", b"*a",
)  # fmt: skip

VALUES: tuple[Any, ...] = (
    None, True, False, 0, -1, 1, 2, 3, 7, 0.5, -0.5, 1e308, -1e308, 1e-320, 5e-324, 1e30, 10**30, 2**53, 2**63 - 1,
    2**63, 10**12, 10**6, 10**5, 10**4, 1000, 100, float("inf"), float("nan"), "", "a", "²", "x" * 1000, "a\nb",
    "\x1b[2J", "\x00", "\ud800", "\u202e", "$\\frac{$", "../../x", "/dev/zero", "1", "10+5", "²+5", "-0", [], {}, [[]],
    [1, 2], [0.5, "a"], {"a": 1}, {"": None}, ["a", "a"], [None], [1] * 1000, [[0, 0]] * 100,
)  # fmt: skip


@dataclass(frozen=True)
class Reader:
    """What is fuzzed: sample files by name, how one is read, and what is done with what was read."""

    samples: Callable[[], dict[str, bytes]]
    read: Callable[[Path], Any]
    use: Callable[[Any, Path], None] = lambda read, path: None
    tidy: Callable[[Any], Any] = lambda document: document
    mutate: Callable[[random.Random, bytes], bytes] | None = None


# -- mutation ----------------------------------------------------------------------------------------------


def mutated(rng: random.Random, sample: bytes, tidy: Callable[[Any], Any] = lambda document: document) -> bytes:
    """Return a sample with one to four changes, of its bytes or of its JSON values."""
    if sample[:1] in (b"{", b"[") and rng.random() < 0.6:
        document = json.loads(sample)
        for _ in range(rng.choice((1, 1, 1, 2, 3))):
            _exchange(rng, document)
        text = json.dumps(tidy(document), ensure_ascii=rng.random() < 0.5)
        return text.encode("utf-8", "surrogatepass")
    data = bytearray(sample)
    for _ in range(rng.choice((1, 1, 1, 2, 4))):
        _damage(rng, data)
    return bytes(data)


def _damage(rng: random.Random, data: bytearray) -> None:
    at = rng.randrange(len(data) + 1)
    end = min(len(data), at + rng.choice((1, 1, 2, 5, 20, 200)))
    kind = rng.randrange(8)
    if kind == 0 and at < len(data):
        data[at] ^= 1 << rng.randrange(8)
    elif kind == 1 and at < len(data):
        data[at] = rng.randrange(256)
    elif kind == 2:
        del data[at:end]
    elif kind == 3:
        data[at:at] = data[at:end]
    elif kind == 4:
        del data[at:]
    elif kind == 5:  # a token in the place of a number or a word
        stop = at
        while stop < len(data) and (chr(data[stop]).isalnum() or data[stop] in b"+-."):
            stop += 1
        while at and (chr(data[at - 1]).isalnum() or data[at - 1] in b"+-."):
            at -= 1
        data[at:stop] = rng.choice(TOKENS)
    elif kind == 6:
        data[at:at] = rng.choice(TOKENS)
    else:  # lines change places
        lines = data.split(b"\n")
        i, j = rng.randrange(len(lines)), rng.randrange(len(lines))
        lines[i], lines[j] = lines[j], lines[i]
        data[:] = b"\n".join(lines)


def _exchange(rng: random.Random, document: Any) -> None:
    """Change one place within a JSON document: another value, one from elsewhere, none, one more."""
    places = list(_places(document))
    if not places:
        return
    holder, key = rng.choice(places)
    kind = rng.randrange(8)
    if kind < 4:
        holder[key] = json.loads(json.dumps(rng.choice(VALUES)))
    elif kind == 4:
        other, its = rng.choice(places)
        try:
            holder[key] = json.loads(json.dumps(other[its]))
        except (KeyError, IndexError):
            return
    elif kind == 5:
        del holder[key]
    elif kind == 6 and isinstance(holder[key], int | float) and not isinstance(holder[key], bool):
        number = holder[key]
        holder[key] = rng.choice((-number, number * 10**6, number + 1, number * 0.3))
    elif isinstance(holder, list):
        holder.insert(rng.randrange(len(holder) + 1), json.loads(json.dumps(holder[key])))
    else:
        holder[rng.choice((str(key).upper(), "", f"{key} ", "zz"))] = holder[key]


def _places(value: Any) -> Iterator[tuple[Any, Any]]:
    keys = list(value) if isinstance(value, dict) else range(len(value)) if isinstance(value, list) else ()
    for key in keys:
        yield value, key
        yield from _places(value[key])


# -- the harness -------------------------------------------------------------------------------------------


@dataclass
class Figures:
    """What a run found."""

    read: int = 0
    refused: int = 0
    slowest_s: float = 0.0
    longest: int = 0

    def __str__(self) -> str:
        return (
            f"{self.read + self.refused:,} inputs, {self.read:,} read and used, {self.refused:,} refused, slowest "
            f"{self.slowest_s:.2f} s, longest message {self.longest} characters"
        )


def fuzz(name: str, reader: Reader, folder: Path, runs: range) -> Figures:
    """Give a reader the inputs of these numbers; an ``AssertionError`` names the first that breaks a promise."""
    figures, samples = Figures(), reader.samples()
    names = sorted(samples)
    for other in names:  # imports and compilation are not an input's fault
        (folder / other).write_bytes(samples[other])
    for other in names:
        reader.use(reader.read(folder / other), folder / other)
    before = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    for number in runs:
        rng = random.Random(int.from_bytes(hashlib.sha256(f"{name} {number}".encode()).digest()[:8], "big"))
        chosen = rng.choice(names)
        path = folder / chosen
        path.write_bytes(
            reader.mutate(rng, samples[chosen]) if reader.mutate else mutated(rng, samples[chosen], reader.tidy)
        )
        start = time.process_time()  # not the clock's, which runs on while other programs have the processor
        try:
            try:
                found = reader.read(path)
            except TaskliftError as error:
                line = _one_line(error)
                assert path.stem in line, f"does not name {path.name}: {line}"
                figures.refused += 1
                figures.longest = max(figures.longest, len(line))
            else:
                figures.read += 1
                reader.use(found, path)
            taken = time.process_time() - start
            assert taken <= LONGEST_S, f"{taken:.1f} s"
            figures.slowest_s = max(figures.slowest_s, taken)
            grown = 1024 * (resource.getrusage(resource.RUSAGE_SELF).ru_maxrss - before)
            assert grown <= LARGEST_B, f"{grown:,} bytes of memory"
        except BaseException as error:
            kept = Path(tempfile.gettempdir()) / f"fuzz-{name}-{number}{path.suffix}"
            kept.write_bytes(path.read_bytes())
            raise AssertionError(
                f"{name}: input {number}, kept as {kept}: {type(error).__name__}: {error!s:.200}"
            ) from error
        path.write_bytes(samples[chosen])
    return figures


def _one_line(error: TaskliftError) -> str:
    line = str(error)
    assert len(line) <= LONGEST_LINE, f"{len(line)} characters: {line}"
    assert "\n" not in line, f"more than one line: {line!r}"
    assert line.isprintable() or all(c.isprintable() or c == "\u00a0" for c in line), repr(line)
    return line


# -- what is fuzzed ----------------------------------------------------------------------------------------


def _policies() -> dict[str, bytes]:
    import numpy as np

    from tasklift.building.search import search_and_clear
    from tasklift.tasks.policy import Policy

    task = search_and_clear()
    safe = task.simplify(fix={"DL": 0, "GL": 0, "WPN": 0}, restrict={"CA": [0.0, 0.5], "FTR": [3, 4]})
    table = np.arange(safe.shape[0] * safe.shape[1], dtype=float).reshape(safe.shape)
    policy = Policy(safe, table, {"seed": 3}, "value", {"visits": table, "epsilon": 0.5})
    return {"policy.json": _saved(policy), "other.json": _saved(Policy.equal(safe))}


def _saved(thing: Any) -> bytes:
    with tempfile.TemporaryDirectory() as folder:
        thing.save(Path(folder) / "saved.json")
        return (Path(folder) / "saved.json").read_bytes()


def _without_checksum(document: Any) -> Any:
    if isinstance(document, dict):
        document.pop("checksum", None)
    return document


def _use_policy(policy: Any, path: Path) -> None:
    from tasklift.tasks.policy import Policy

    assert list(policy.describe(2))
    assert policy.to_csv()
    policy.save(path)
    again = Policy.load(path)
    assert (again.weights == policy.weights).all()
    assert again.task == policy.task
    policy.probabilities(0, "exploitation")
    assert repr(policy.task.signal_table if hasattr(policy.task, "signal_table") else policy.task)


def _buildings() -> dict[str, bytes]:
    from tasklift.building import generate

    drawn = generate(intersections=4, corridors=4, rooms=2, seed=1)
    small = drawn.to_json() | {"name": "small", "start": 0}
    del small["outline"], small["provenance"]
    small["nodes"] = [
        {"id": 0, "kind": "room", "x": 0, "y": 0, "area_m2": 12.5, "obstacles": 2},
        {"id": 1, "kind": "feature", "class": "door", "x": 3, "y": 0},
        {"id": 2, "kind": "intersection", "x": 10.0, "y": 0.5},
        {"id": 3, "kind": "feature", "class": "bend", "x": 10.0, "y": 5.5},
    ]
    small["edges"] = [{"a": i, "b": i + 1, "length_m": 3.0 + i, "width_m": 2.0} for i in range(3)]
    return {"drawn.json": _saved(drawn), "small.json": json.dumps(small, indent=1).encode()}


def _use_building(building: Any, path: Path) -> None:
    from matplotlib.figure import Figure

    from tasklift.building import Building, Mission, draw
    from tasklift.plans.check import check
    from tasklift.tasks.policy import Policy
    from tasklift.watch.document import replay
    from tasklift.watch.html import page

    building.save(path)
    assert Building.load(path) == building
    mission = Mission(building, "2+2", hostiles=0, limit=10)
    trace = mission.simulator.trace(Policy.equal(mission.task), seed=0, trial=0)
    assert page(replay([("equal", trace)], building.name))
    check(building)
    if len(path.read_bytes()) % 40 == 0:  # a drawing takes as long as fifty readings
        figure = Figure()
        draw.draw_graph(building, figure.subplots())
        draw.draw_plan(building, figure.subplots())
        figure.canvas.draw()


def _specs() -> dict[str, bytes]:
    examples = Path(__file__).parent.parent / "examples"
    large, small = b"intersections = 21, corridors = 25, rooms = 6", b"intersections = 4, corridors = 4, rooms = 2"
    found = {name: (examples / name).read_bytes().replace(large, small) for name in ("building.toml", "drill.toml")}
    spec = {
        "name": "j", "performance": "steps", "seeds": 4,
        "environment": {"building": "b.json", "team": "2+2", "hostiles": 1, "limit": 20, "reading": {"patience": 3}},
        "learner": {"rule": "reinforcement", "selection": "pseudo-random", "q": 0.5},
        "stages": [
            {"name": "V", "options": {"hostiles": 0}, "fix": {"DL": 0, "GL": 0}, "signals": [], "repeats": 1},
            {"name": "T", "trials": 2, "max_losses": 9, "guard": {"measure": "losses", "share": 0.1},
             "prior": [{"operation": "swap", "output": "MV", "when": {"FTR": 4, "nWPN": [0, 1]}}]},
        ],
    }  # fmt: skip
    return found | {"spec.json": json.dumps(spec).encode()}


def _read_spec(path: Path) -> Any:
    from tasklift.building import generate
    from tasklift.studies.spec_file import curriculum_of, read_spec

    beside = path.parent / "b.json"
    if not beside.exists():
        generate(intersections=4, corridors=4, rooms=2, seed=1).save(beside)
    document = read_spec(path)
    with about(path):  # as run_spec says it
        return curriculum_of(document, path.parent)


def _use_spec(curriculum: Any, path: Path) -> None:
    small = all(
        (stage.trials or 0) + (stage.steps or 0) + getattr(stage.learner, "repeats", 1) <= 20
        and stage.world.limit <= 100
        and sum(stage.world.team.values()) <= 10
        for stage in curriculum.stages
    )
    if small:
        with suppress(TaskliftError):  # a world that is not what the task assumes is found when it is met
            curriculum.run(0)


def _read_arm(path: Path) -> Any:
    """Read a spec as ``train --curriculum`` does: the building takes the place of its environment."""
    from tasklift.studies.arms import Setup
    from tasklift.studies.spec_file import arm_of

    return arm_of(path).curriculum(Setup(_mission(), trials=2, repeats=1))


def _missions() -> dict[str, bytes]:
    mission = {
        "team": [{"kind": "bee", "robots": 2, "speed_mm": 700, "armed": True, "attributes": {"detector_range_m": 20}}],
        "weapons_needed": 2,
        "limit": 60,
        "inputs": ["DL", "GL", "nWPN", "FTR", "WAITED", {"sensor": "detector", "range_m": 12, "miss": 0.1}],
        "outputs": ["MV", "WPN", "CA", "BACK"],
    }
    return {"bees.json": json.dumps(mission).encode(), "few.toml": b'team = "2+2"\nweapons_needed = 2\nlimit = 60\n'}


def _read_mission(path: Path) -> Any:
    from tasklift.studies.mission_file import declared

    return declared(path)


def _use_mission(terms: Any, path: Path) -> None:
    assert _mission(hostiles=0, **terms).task.shape[0] >= 1


def _mission(**terms: Any) -> Any:
    from tasklift.building import Mission, generate

    return Mission(generate(intersections=4, corridors=4, rooms=2, seed=1), **{"team": "2+2"} | terms)


def _certificates() -> dict[str, bytes]:
    from tasklift.studies.certify import certify
    from tasklift.tasks.policy import Policy

    mission = _mission()
    with tempfile.TemporaryDirectory() as folder:
        made = Path(folder) / "policy.json"
        Policy.equal(mission.task).save(made)
        mission.building.save(Path(folder) / "building.json")
        certificate = certify(made, team="2+2", limit=20, episodes=4).path
        return {file.name: file.read_bytes() for file in (certificate,)}


def _read_certificate(path: Path) -> Any:
    from tasklift.studies.certify import verify
    from tasklift.tasks.policy import Policy

    mission = _mission()
    for thing, name in ((Policy.equal(mission.task), "policy.json"), (mission.building, "building.json")):
        if not (path.parent / name).exists():
            thing.save(path.parent / name)
    return verify(path)


def _few_episodes(document: Any) -> Any:
    """Return the document with at most four episodes: a mutated one may ask for a million, which takes too long."""
    if isinstance(document, dict) and document.get("episodes") not in (0, -1, None):
        document["episodes"] = 4
    return document


def _simplify_specs() -> dict[str, bytes]:
    lake = (Path(__file__).parent.parent / "examples" / "simplify-lake.toml").read_bytes()
    spec = {
        "name": "j",
        "environment": {"gymnasium": "FrozenLake-v1", "loss": {"terminated": True, "reward": 0}},
        "task": {"inputs": {"row": 4, "col": 4}, "outputs": {"move": ["left", "down", "right", "up"]}},
        "learner": {"rule": "q-learning"},
        "stages": [{"name": "T", "trials": 2}],
        "simplify": {
            "trials": 2, "depth": 2, "seeds": 6, "criterion": "steps", "never": [["row", "col"]],
            "switches": [{"name": "firm", "options": {"is_slippery": False}, "fix": {"row": 0}, "harmless": True}],
            "priors": [{"name": "none", "operations": [{"operation": "forget", "output": "move"}]}], "trust": [2],
            "curricula": [{"name": "mine", "stages": [{"name": "V", "trials": 2}]}], "stages": 2, "threshold": 0.5,
            "most": {"losses": 9},
        },
    }  # fmt: skip
    return {"lake.toml": lake, "spec.json": json.dumps(spec).encode()}


def _read_simplify(path: Path) -> Any:
    from tasklift.studies.simplify.search import study_of

    return study_of(path)


def _use_simplify(study: Any, path: Path) -> None:
    assert study.price() > 0
    if len(path.read_bytes()) % 8 == 0:  # a world of Gymnasium's takes as long as ten readings
        try:
            study.curriculum(study.found[-1])
        except TaskliftError as error:
            _one_line(error)


def _weights() -> dict[str, bytes]:
    import numpy as np

    from tasklift.tasks import policy
    from tasklift.tasks.task import Task, Variable

    task = Task("t", (Variable("row", range(9)), Variable("col", range(9))), (Variable("move", range(4)),))
    table = np.random.default_rng(1).random(task.shape)
    before, policy.LARGEST_JSON = policy.LARGEST_JSON, 10
    try:
        with tempfile.TemporaryDirectory() as folder:
            policy.Policy(task, table, {}, "value", {"visits": table}).save(Path(folder) / "p.json")
            return {path.name: path.read_bytes() for path in Path(folder).iterdir()}
    finally:
        policy.LARGEST_JSON = before


def _read_weights(path: Path) -> Any:
    """Read a policy whose weights lie in a file of arrays, with the checksum that fits them."""
    from tasklift.tasks.policy import Policy

    document = next(path.parent.glob("*.json"))
    if path.suffix == ".npz":
        found = json.loads(_weights()[document.name])
        del found["checksum"]
        found["arrays"]["sha256"] = hashlib.sha256(path.read_bytes()).hexdigest()
        document.write_text(json.dumps(found))
    return Policy.load(document)


def _use_weights(policy: Any, path: Path) -> None:
    assert policy.to_csv()
    assert policy.probabilities(0, "exploitation").shape == (4,)


def _edits() -> dict[str, bytes]:
    from tasklift.plans import edits

    lines = [line.strip() for line in (edits.__doc__ or "").split("\n") if line.startswith("    ")]
    numbered = ["drop node 3", "add node at 5 3 to 3 0  # a remark", "set class at 3 0 to corner", "start at 10 0.5"]
    return {"all.edits": "\n".join(lines).encode(), "few.edits": "\n".join([edits.HEADER, *numbered]).encode()}


def _read_edits(path: Path) -> Any:
    from tasklift.plans.edits import read_edits

    return read_edits(path)


def _use_edits(found: Any, path: Path) -> None:
    from tasklift.building import Building
    from tasklift.plans.check import check
    from tasklift.plans.edits import apply_edits, as_places

    building = Building.from_json(json.loads(_buildings()["small.json"]))
    try:
        assert len(as_places(building, found)) == len(found)
        assert check(apply_edits(building, found)[0]).lines()
    except TaskliftError as error:
        _one_line(error)


def _replays() -> dict[str, bytes]:
    from tasklift.building import Mission, generate
    from tasklift.files import canonical_json
    from tasklift.tasks.policy import Policy
    from tasklift.watch.document import replay

    mission = Mission(generate(intersections=4, corridors=4, rooms=2, seed=1), "2+2", hostiles=1, limit=10)
    trace = mission.simulator.trace(Policy.equal(mission.task), seed=0, trial=0)
    return {"replay.json": canonical_json(replay([("equal", trace)], "title")).encode()}


def _read_replay(path: Path) -> Any:
    from tasklift.watch.document import read

    return read(path)


def _use_replay(document: Any, path: Path) -> None:
    from tasklift.watch.html import page

    assert page(document).encode("utf-8", errors="strict")


def _read_policy(path: Path) -> Any:
    from tasklift.tasks.policy import Policy

    return Policy.load(path)


def _read_building(path: Path) -> Any:
    from tasklift.building import Building

    return Building.load(path)


def _map_readers() -> dict[str, Reader]:
    """One for each reader of maps, on its samples; what lies beside a sample is damaged as well."""
    from tasklift.plans.read import readers

    folder = Path(__file__).parent / "plans" / "samples"
    found = {}
    for reader in readers():
        name = reader.__name__.rpartition(".")[2]
        if name != "building":
            files = {path.name: path.read_bytes() for path in sorted((folder / name).iterdir())}
            found[f"map-{name}"] = Reader(lambda files=files: files, _read_sample, _use_map)
    return found


def _read_sample(path: Path) -> Any:
    from tasklift.plans.read import read_map
    from tasklift.plans.source import Source

    if path.suffix == ".pgm":
        path = path.with_suffix(".yaml")
    return read_map(Source(path, resolution_m=0.25 if path.suffix in (".png", ".map") else None))


def _use_map(found: Any, path: Path) -> None:
    from tasklift.building import Building
    from tasklift.plans.check import check
    from tasklift.plans.extract.building import extract
    from tasklift.plans.overlay import draw_overlay
    from tasklift.plans.places import Places
    from tasklift.plans.plan import Plan

    number = len(path.read_bytes())
    try:
        if isinstance(found, Places):
            found = found.building()
        elif isinstance(found, Plan) and number % 8 == 0:  # extraction takes as long as fifty readings
            found = extract(found)[0]
    except TaskliftError as error:
        _one_line(error)
        return
    if isinstance(found, Building):
        assert check(found).lines()
        if number % 80 == 0:
            draw_overlay(found, path.with_name("overlay.png"))


def _store_work(cell: Any) -> Any:
    """A cell's numbers: a function of the cell alone."""
    import numpy as np

    from tasklift.lab import CellResult

    rng = np.random.default_rng([*str(cell).encode()])
    steps = rng.integers(50, 601, 40)
    return CellResult(
        {"source": {"steps": rng.integers(0, 70_000, 8)}, "target": {"steps": steps, "share": rng.random(40)}},
        {"steps": float(steps.mean()), "losses": int(steps[0]), "time_to": None, "word": "abc"},
        {"weights": rng.random((3, 4)), "note": {"best": [1, 2]}},
    )


@cache
def _store_spec() -> Any:
    from tasklift.lab import Spec

    axes = {"map": {"a": "7f", "b": "e0"}, "seed": range(8), "arm": ["direct", "copy"]}
    return Spec.of("stored", {"trials": 40, "team": [10, 5]}, axes, over=["map", "seed"])


@cache
def _stores() -> dict[str, bytes]:
    from tasklift.lab import FILE_NAME, Store, run

    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / FILE_NAME
        with Store.open(path, _store_spec()) as store:
            run(store, _store_spec().cells(), _store_work, workers=1)
        return {FILE_NAME: path.read_bytes()}


def _damaged_store(rng: random.Random, sample: bytes) -> bytes:
    """Overwrite bytes, as disks do; exchange pages; change rows through SQL, as people do; or anything at all."""
    kind, data = rng.randrange(10), bytearray(sample)
    if kind < 4:
        for _ in range(rng.choice((1, 1, 1, 2, 5))):
            at = rng.randrange(len(data))
            data[at] = rng.choice((data[at] ^ 1 << rng.randrange(8), rng.randrange(256), 0, 255))
    elif kind == 4:
        start, size = rng.randrange(len(data)), rng.choice((4, 100, 512, 4096))
        data[start : start + size] = bytes(len(data[start : start + size]))
    elif kind == 5:
        pages = len(data) // 4096
        one, other = (4096 * rng.randrange(pages) for _ in range(2))
        data[one : one + 4096], data[other : other + 4096] = data[other : other + 4096], data[one : one + 4096]
    elif kind < 9:
        with sqlite3.connect(":memory:", isolation_level=None) as db:
            db.deserialize(bytes(data[:18]) + b"\x01\x01" + bytes(data[20:]))  # memory has no write-ahead log
            for _ in range(rng.choice((1, 1, 3))):
                try:
                    _change_rows(rng, db)
                except (sqlite3.Error, UnicodeEncodeError):
                    continue
            data[:] = db.serialize()
        db.close()
    else:
        return mutated(rng, sample)
    return bytes(data)


def _change_rows(rng: random.Random, db: sqlite3.Connection) -> None:
    table, columns = rng.choice(
        (("meta", ("key", "value")), ("cells", ("id", "summary", "contents", "crc", "map", "seed", "arm")),
         ("trials", ("cell", "stage", "n", "columns")), ("attachments", ("cell", "name", "data")))
    )  # fmt: skip
    where = f"rowid = {rng.randrange(1, 34)}" if table == "cells" else f"{columns[0]} = :one"
    ones = [one for (one,) in db.execute(f"SELECT {columns[0]} FROM {table}")]
    one, other = rng.choice(ones), rng.choice(ones)
    column, kind = rng.choice(columns), rng.randrange(10)
    if kind == 0 and table != "cells":  # without a cell, a store is one whose run was stopped
        db.execute(f"DELETE FROM {table} WHERE {where}", {"one": one})
    elif kind == 1:
        db.execute(f"CREATE VIEW v{rng.randrange(9)} AS SELECT * FROM {table}")
    elif kind == 2:
        db.execute(f"PRAGMA user_version = {rng.randrange(4)}")
    elif kind == 3:  # what another row has
        value = f"(SELECT {column} FROM {table} WHERE {columns[0]} = :other)"
        db.execute(f"UPDATE {table} SET {column} = {value} WHERE {where}", {"one": one, "other": other})
    else:
        (value,) = rng.choice(db.execute(f"SELECT {column} FROM {table}").fetchall() or [(None,)])
        changed = bytearray(value if isinstance(value, bytes) else str(value).encode())
        _damage(rng, changed)
        new = rng.choice((bytes(changed), changed.decode(errors="replace"), rng.choice(VALUES[:40])))
        if isinstance(new, int) and abs(new) >= 2**63:
            new = str(new)
        db.execute(f"UPDATE {table} SET {column} = :new WHERE {where}", {"one": one, "new": new})


def _read_store(path: Path) -> Any:
    """Everything that can be asked of a store."""
    from tasklift.lab import Store, runs

    with Store.read(path) as store:
        read: dict[str, Any] = {
            "select": [(cell, str(vars(result))) for cell, result in store.select(attachments=True)],
            "some": [(cell, str(vars(result))) for cell, result in store.select(arm="copy", map="b")],
            "curves": [store.curves(*asked).values.tolist() for asked in (("target", "share"), ("source", "steps"))],
            "one": store.curves("target", "steps", arm="direct").values.tolist(),
            "outlines": list(store.outlines(arm="copy")),
            "summaries": store.summaries("steps").values.tolist(),
            "done": sorted(store.done()),
            "length": len(store),
            "digest": store.digest(),
            "spec": (store.spec.settings, store.spec.axes, store.spec.over, store.spec.name, store.planned),
        }
    out = path.with_suffix(".csv")
    for what in ("trials", "cells"):
        runs.export(path, out, what=what)
        read[what] = out.read_text()
    read["show"] = [table.rows for table in runs.show(path)]
    read["compare"] = [table.rows for table in runs.compare(path, between=("arm", "direct", "copy"))]
    return read


@cache
def _undamaged() -> Any:
    from tasklift.lab import FILE_NAME

    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / FILE_NAME
        path.write_bytes(_stores()[FILE_NAME])
        return _read_store(path) | {"show": None}


def _use_store(read: Any, path: Path) -> None:
    """What was read must be what was written; release and path apart, which no reader computes with."""
    for key, expected in _undamaged().items():
        assert key == "show" or read[key] == expected, f"{key} is not what was written"


def _resume_store(path: Path) -> str:
    """Run the experiment again on what is there; return the digest of its rows."""
    from tasklift.lab import Store, run

    with Store.open(path, _store_spec()) as store:
        run(store, _store_spec().cells(), _store_work, workers=1)
        return store.digest()


def _use_resumed(digest: str, path: Path) -> None:
    assert digest == _undamaged()["digest"], "a resumed run has other rows"
    left = [name.name for name in path.parent.iterdir() if name.name != path.name]
    assert not left, f"left behind: {left}"


READERS = {
    "policy": Reader(_policies, _read_policy, _use_policy, _without_checksum),
    "building": Reader(_buildings, _read_building, _use_building),
    "spec": Reader(_specs, _read_spec, _use_spec),
    "curriculum": Reader(_specs, _read_arm),
    "mission": Reader(_missions, _read_mission, _use_mission),
    "certificate": Reader(_certificates, _read_certificate, tidy=_few_episodes),
    "simplify": Reader(_simplify_specs, _read_simplify, _use_simplify),
    "weights": Reader(_weights, _read_weights, _use_weights),
    "edits": Reader(_edits, _read_edits, _use_edits),
    "replay": Reader(_replays, _read_replay, _use_replay),
    "store": Reader(_stores, _read_store, _use_store, mutate=_damaged_store),
    "resume": Reader(_stores, _resume_store, _use_resumed, mutate=_damaged_store),
    **_map_readers(),
}


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("readers", nargs="*", help=f"some of {', '.join(READERS)}; default: all")
    parser.add_argument("--runs", type=int, default=100_000)
    parser.add_argument("--first", type=int, default=0)
    parser.add_argument("--only", type=int, help="one input")
    given = parser.parse_args()
    runs = range(given.first, given.first + given.runs) if given.only is None else range(given.only, given.only + 1)
    failed = False
    for name in given.readers or READERS:
        start = time.perf_counter()
        with tempfile.TemporaryDirectory(dir=MEMORY) as folder:
            try:
                print(f"{name}: {fuzz(name, READERS[name], Path(folder), runs)}", end="")
            except AssertionError as error:
                failed = True
                print(error, end="")
        print(f" ({time.perf_counter() - start:.0f} s)", flush=True)
    sys.exit(failed)


if __name__ == "__main__":
    main()
