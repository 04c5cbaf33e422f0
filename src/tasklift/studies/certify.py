"""Certificates: what a policy does on fresh episodes, with exact bounds, in a file that can be recomputed.

The unit is stated: an episode (trial) on one building, or an episode on a building of its own. The bounds are those of
Clopper & Pearson (*Biometrika* 1934), which hold for any number of episodes and any true share. The random numbers come
from the policy's own content, under a stage of their own: no training and no choice of a policy has seen them.
"""

from __future__ import annotations

import hashlib
import json
import os
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass, field, fields, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import ArrayLike
from scipy.special import betaincinv

import tasklift
from tasklift.building.generate import generate
from tasklift.building.graph import Building
from tasklift.building.mission import Mission
from tasklift.building.reading import PRESETS, Reading
from tasklift.building.search import hostile_candidates
from tasklift.building.team import Kind, parse_team
from tasklift.building.terms import parse_terms, terms_from_json, terms_of, terms_to_json
from tasklift.building.variables import TABLE_I, TABLE_I_OUTPUTS, Sensor
from tasklift.checks import check_fields, number, one_of, whole_number
from tasklift.errors import TaskliftError, about
from tasklift.files import canonical_json, output_file, read_bytes, read_document, write_atomically
from tasklift.lab import FILE_NAME, Store
from tasklift.learning.chances import CERTIFY_STAGE
from tasklift.learning.learner import MOST_TRIALS
from tasklift.plans.read import load_building
from tasklift.studies.mission_file import declared
from tasklift.studies.own_code import OwnCode
from tasklift.tasks.policy import Policy

FORMAT = "tasklift-certificate"

#: Called as ``progress(done, total, note)``.
Progress = Callable[[int, int, str], None]


@dataclass(frozen=True)
class Sizes:
    """How large generated buildings are."""

    intersections: int
    corridors: int
    rooms: int

    @classmethod
    def parse(cls, text: str) -> Sizes:
        """Read ``21-25-6``: intersections, corridors, rooms."""
        parts = text.split("-")
        if len(parts) != 3 or not all(part.strip().isascii() and part.strip().isdigit() for part in parts):
            raise TaskliftError(f"buildings: expected INTERSECTIONS-CORRIDORS-ROOMS such as 21-25-6, found {text!r}")
        return cls(*(whole_number(int(part[:9]), "buildings", 1) for part in parts))

    def building(self, hostiles: int, seed: int) -> Building:
        """Return a building with places for this many hostiles: the first that has them, counting up from ``seed``."""
        doors = None if hostiles <= 4 else hostiles
        for attempt in range(100):
            found = generate(self.intersections, self.corridors, self.rooms, doors=doors, seed=seed + attempt)
            if len(hostile_candidates(found)) >= hostiles:
                return found
        raise TaskliftError(f"buildings: none of 100 of these sizes has {hostiles} places for hostiles; ask for fewer")


@dataclass(frozen=True, eq=False)
class Ground:
    """Where, with whom and against what a policy is certified.

    Parameters
    ----------
    place : Building or Sizes
        One building, or generated ones that nothing was learned on.
    team : str or mapping
        As in :class:`.Mission`.
    hostiles : sequence of int
        Their number is drawn from these for each episode, each equally likely. They are placed afresh each time.
    reading, weapons_needed, limit, inputs, outputs
        As in :class:`.Mission`.

    Raises
    ------
    TaskliftError
        If no episode could be played: no place for a hostile, or a team that can never succeed.
    """

    place: Building | Sizes
    team: str | Mapping[Kind, int] = "10+5"
    hostiles: Sequence[int] = (1,)
    reading: Reading = field(default_factory=Reading)
    weapons_needed: int = 2
    limit: int = 600
    inputs: Sequence[str | Sensor] = TABLE_I
    outputs: Sequence[str] = TABLE_I_OUTPUTS

    def __post_init__(self) -> None:
        parse_terms(self)
        object.__setattr__(self, "hostiles", tuple(whole_number(n, "hostiles") for n in self.hostiles))
        object.__setattr__(self, "reading", replace(self.reading, relocate=True))
        if not self.hostiles:
            raise TaskliftError("hostiles: expected at least one number, found none")
        self.mission(max(self.hostiles), 0)

    @property
    def unit(self) -> str:
        """What is counted."""
        return "episodes on this building" if isinstance(self.place, Building) else "episodes on fresh buildings"

    def mission(self, hostiles: int, seed: int) -> Mission:
        """Return the world of an episode with this many hostiles; ``seed`` makes the building where it is not given."""
        place = self.place if isinstance(self.place, Building) else self.place.building(hostiles, seed)
        return Mission(place, hostiles=hostiles, reading=self.reading, **terms_of(self))

    def to_json(self) -> dict[str, Any]:
        """Return everything but a given building, as JSON data."""
        usual = Reading()
        options = {f.name: getattr(self.reading, f.name) for f in fields(Reading)}
        return {
            "hostiles": list(self.hostiles),
            "reading": {name: value for name, value in options.items() if value != getattr(usual, name)},
            "mission": terms_to_json(self),
        }

    @classmethod
    def from_json(cls, document: dict[str, Any], place: Building | Sizes, own: OwnCode) -> Ground:
        """Undo :meth:`to_json`; ``own`` finds the functions of sensors of one's own."""
        terms = terms_from_json(document["mission"], "mission", own.named)
        return cls(place, hostiles=document["hostiles"], reading=Reading.from_json(document["reading"]), **terms)

    def play(self, policy: Policy, episodes: int, seed: int, progress: Progress | None = None) -> Counts:
        """Play fresh episodes and count.

        Parameters
        ----------
        policy : Policy
            Of the mission's task, or of a simplification of it.
        episodes : int
            At least 1.
        seed : int
            Together with the policy's weights, it makes all random numbers.

        Raises
        ------
        TaskliftError
            For a policy of another task, and a number out of range.
        """
        whole_number(episodes, "episodes", 1, MOST_TRIALS)
        whole_number(seed, "seed")
        full = policy.extend(self.mission(min(self.hostiles), 0).task)
        content = hashlib.sha256(f"{seed} {canonical_json(full.task.to_json())} ".encode() + full.weights.tobytes())
        rng = np.random.default_rng([CERTIFY_STAGE, *content.digest()])
        parts = [
            mission.evaluate(full, n, seed=int(rng.integers(2**62)), stage=CERTIFY_STAGE)
            for mission, n in self._missions(episodes, rng, progress)
        ]
        success, losses, steps = (
            np.concatenate([getattr(part, name).ravel() for part in parts]) for name in ("success", "losses", "steps")
        )
        return Counts(len(success), int(success.sum()), int((losses > 0).sum()), int(losses.sum()), int(steps.sum()))

    def _missions(
        self, episodes: int, rng: np.random.Generator, progress: Progress | None
    ) -> Iterator[tuple[Mission, int]]:
        drawn = rng.integers(len(self.hostiles), size=episodes)
        if isinstance(self.place, Building):
            for k, hostiles in enumerate(self.hostiles):
                if n := int((drawn == k).sum()):
                    yield self.mission(hostiles, 0), n
            return
        for done, k in enumerate(drawn.tolist()):
            yield self.mission(self.hostiles[k], int(rng.integers(2**62))), 1
            if progress is not None:
                progress(done + 1, episodes, self.unit)

    @property
    def n_robots(self) -> int:
        """Robots at the start of an episode."""
        return sum(parse_team(self.team).values())


@dataclass(frozen=True)
class Counts:
    """What came of ``episodes``: solved ones, ones in which a robot was lost, robots lost and steps in all."""

    episodes: int
    solved: int
    with_losses: int
    lost: int
    steps: int


@dataclass(frozen=True)
class Bounds:
    """What holds with the stated confidence, all at once.

    Parameters
    ----------
    solved_at_least, loss_at_most
        Shares of episodes: solved, and with a robot lost.
    lost_per_100_at_most
        Robots lost in 100 episodes, on average: nobody can lose more than the team in an episode.
    """

    solved_at_least: float
    loss_at_most: float
    lost_per_100_at_most: float

    @classmethod
    def of(cls, counts: Counts, n_robots: int, confidence: float) -> Bounds:
        """Return the exact bounds; each of the two shares may be wrong with half of what confidence leaves."""
        level = 1.0 - (1.0 - checked_confidence(confidence)) / 2.0
        solved = share_bounds(counts.solved, counts.episodes, level)[0]
        loss = share_bounds(counts.with_losses, counts.episodes, level)[1]
        return cls(solved, loss, 100.0 * n_robots * loss)


def checked_confidence(value: float) -> float:
    """Return a confidence if it lies between 0 and 1, both excluded."""
    confidence = number(value, "confidence")
    if not 0.0 < confidence < 1.0:
        raise TaskliftError(f"confidence: expected a number above 0 and below 1, such as 0.99, found {value!r}")
    return confidence


def share_bounds(successes: int, trials: int, level: float) -> tuple[float, float]:
    """Return a lower and an upper bound of a share, each exact at ``level`` by itself (Clopper & Pearson 1934).

    Examples
    --------
    No failure in 299 trials: 95 % sure that at most 1 in 100 fails (the rule of three, exactly).

    >>> round(share_bounds(0, 299, 0.95)[1], 5)
    0.00997
    """
    lower = 0.0 if successes == 0 else float(betaincinv(successes, trials - successes + 1, 1.0 - level))
    upper = 1.0 if successes == trials else float(betaincinv(successes + 1, trials - successes, level))
    return lower, upper


def quantile_bound(values: ArrayLike, share: float = 0.95, confidence: float = 0.95) -> float | None:
    """Return what at most 1 − ``share`` of further values exceed, whatever their distribution is.

    It is the smallest order statistic for which that holds with ``confidence`` (Wilks 1941); None if there are too few
    values for one (:func:`runs_needed`).

    Parameters
    ----------
    values : (n,)
        Independent, such as the losses of runs with different seeds.

    Examples
    --------
    >>> quantile_bound(range(100)), quantile_bound(range(20))
    (98.0, None)
    """
    from scipy.stats import binom

    ordered = np.sort(np.asarray(values, dtype=np.float64))
    # the r-th smallest is at least the quantile if fewer than r values lie below it
    enough = np.flatnonzero(binom.cdf(np.arange(len(ordered)), len(ordered), share) >= confidence)
    return float(ordered[enough[0]]) if len(enough) else None


def runs_needed(share: float = 0.95, confidence: float = 0.95) -> int:
    """Return how many runs :func:`quantile_bound` needs.

    >>> runs_needed()
    59
    """
    return int(np.ceil(np.log(1.0 - confidence) / np.log(share)))


def learning_costs(folder: Path, share: float = 0.95, confidence: float = 0.95) -> list[str]:
    """Say, for every method and condition of an experiment, how many robots its runs lose before they are done.

    Parameters
    ----------
    folder : Path
        Of `tasklift train` or another experiment with missions.
    share, confidence : float
        As in :func:`quantile_bound`.

    Raises
    ------
    TaskliftError
        If there is no experiment, or it keeps no losses.
    """
    checked_confidence(confidence)
    runs: dict[str, list[int]] = {}
    with Store.read(folder / FILE_NAME) as store:
        for cell, result in store.select():
            lost = [result.stages[stage]["losses"] for stage in ("budget", "target") if stage in result.stages]
            if lost and cell["arm"] not in ("random", "expert"):
                name = ", ".join(f"{axis} {value}" for axis, value in cell.axes.items() if axis != "seed")
                runs.setdefault(name, []).append(int(sum(column.sum() for column in lost)))
    if not runs:
        raise TaskliftError(f"{folder}: keeps no losses of episodes on the dangerous task")
    lines = []
    for name, losses in runs.items():
        bound = quantile_bound(losses, share, confidence)
        if bound is None:
            lines.append(f"{name}: {len(losses)} runs bound nothing, {runs_needed(share, confidence)} are needed")
            continue
        sure = f"{len(losses)} runs, {100 * confidence:g} % sure"
        lines.append(f"{name}: {100 * share:g} % of runs lose at most {bound:g} robots before they are done ({sure})")
    return lines


def statement(counts: Counts, bounds: Bounds, confidence: float, unit: str) -> str:
    """Say in one line what a certificate says."""
    if bounds.loss_at_most <= 0.5:
        lost = f"at most 1 in {int(1.0 / bounds.loss_at_most):,} {unit} loses a robot"
    else:
        lost = f"at most {np.ceil(1000 * bounds.loss_at_most) / 10:g} % of {unit} lose a robot"
    return (
        f"{100 * confidence:g} % sure: {lost}; at least {np.floor(1000 * bounds.solved_at_least) / 10:g} % are solved "
        f"({counts.episodes:,} episodes: {counts.solved:,} solved, {counts.with_losses:,} lost a robot, "
        f"{counts.lost:,} robots lost, {counts.steps / counts.episodes:.0f} steps on average)"
    )


# -- files -------------------------------------------------------------------------------------------------------


@dataclass(frozen=True)
class Certified:
    """A certificate: what it says in one line, its file, and the numbers."""

    says: str
    path: Path
    counts: Counts
    bounds: Bounds
    confidence: float


def certify(
    policy: Path,
    *,
    building: Path | None = None,
    buildings: str | None = None,
    mission: Path | None = None,
    team: str | None = None,
    hostiles: Sequence[int] = (1,),
    weapons_needed: int | None = None,
    limit: int | None = None,
    preset: str = "scattered",
    episodes: int | None = None,
    confidence: float = 0.99,
    seed: int = 0,
    out: Path | None = None,
    force: bool = False,
    progress: Progress | None = None,
) -> Certified:
    """Certify a policy file and write the certificate.

    Parameters
    ----------
    policy : Path
        The policy.
    building : Path, optional
        The building. Default: ``building.json`` in the policy's folder.
    buildings : str, optional
        In its place, the sizes of generated buildings, such as ``21-25-6``: each episode has one of its own.
    mission, team, weapons_needed, limit
        As in :func:`.declared`. Default: ``mission.json`` in the policy's folder, if there is one.
    hostiles
        As in :class:`Ground`.
    preset : str
        ``scattered`` or ``cohesive``.
    episodes : int, optional
        Default: 10,000, or 1,000 on generated buildings.
    confidence, seed
        As in :meth:`Bounds.of` and :meth:`Ground.play`.
    out : Path, optional
        File of the certificate. Default: beside the policy, by its name.
    force : bool
        Whether a file that is there may be replaced.

    Returns
    -------
    Certified
        What it says, and its file.

    Raises
    ------
    TaskliftError
        Before anything is written.
    """
    checked_confidence(confidence)
    if building is not None and buildings is not None:
        raise TaskliftError("certify: --building names one building, --buildings generates many; give one of them")
    loaded = Policy.load(policy)
    file = None if buildings is not None else building or policy.parent / "building.json"
    if building is None and file is not None and not file.exists():
        raise TaskliftError(f"{file}: is not there; name the building with --building, or sizes with --buildings")
    reads = [policy] if file is None else [policy, file]
    out = out or policy.with_name(f"{policy.stem}-certificate.json")
    target = output_file(out, (".json",), force=force, reads=reads)
    reading = PRESETS[one_of(preset, list(PRESETS), "preset")]
    place = Sizes.parse(buildings) if buildings is not None else load_building(file or policy)
    terms = declared(mission, policy.parent, team=team, weapons_needed=weapons_needed, limit=limit)
    ground = Ground(place, hostiles=hostiles, reading=reading, **terms)
    if episodes is None:
        episodes = 10_000 if file is not None else 1_000
    counts = ground.play(loaded, episodes, seed, progress)
    bounds = Bounds.of(counts, ground.n_robots, confidence)
    says = statement(counts, bounds, confidence, ground.unit)
    document = {
        "format": FORMAT,
        "version": 1,
        "written_by": f"tasklift {tasklift.__version__}",
        "says": says,
        "policy": _named(policy, target),
        "place": asdict(place) if isinstance(place, Sizes) else _named(file or policy, target),
        "ground": ground.to_json(),
        "episodes": episodes,
        "seed": seed,
        "confidence": confidence,
        "counts": asdict(counts),
        "bounds": asdict(bounds),
    }
    write_atomically(target, json.dumps(document, indent=1, ensure_ascii=False) + "\n", replace=force)
    return Certified(says, target, counts, bounds, confidence)


def verify(certificate: Path, progress: Progress | None = None) -> str:
    """Recompute a certificate from its policy and building, which lie where it says, and compare.

    Returns
    -------
    str
        What it says, in one line.

    Raises
    ------
    TaskliftError
        If a file is missing or another one, or a number differs; says which.
    """
    document = read_document(certificate, FORMAT, 1)
    numbers = dict.fromkeys(("episodes", "seed"), int)
    shape = numbers | {"format": str, "version": int, "written_by": str, "says": str, "confidence": float}
    shape |= dict.fromkeys(("policy", "place", "ground", "counts", "bounds"), dict)
    check_fields(document, str(certificate), shape)
    with about(certificate):
        policy = Policy.load(_found(document["policy"], certificate))
        place: Building | Sizes
        try:
            if "file" in document["place"]:
                place = load_building(_found(document["place"], certificate))
            else:
                place = Sizes(**document["place"])
            ground = Ground.from_json(document["ground"], place, OwnCode(certificate.parent))
        except (KeyError, TypeError, ValueError) as error:
            raise TaskliftError(f"the place or the ground is not as a certificate has it ({error})") from error
        counts = ground.play(policy, document["episodes"], document["seed"], progress)
        bounds = Bounds.of(counts, ground.n_robots, document["confidence"])
        says = statement(counts, bounds, document["confidence"], ground.unit)
        for name, found in (("counts", asdict(counts)), ("bounds", asdict(bounds)), ("says", says)):
            if document[name] != found:
                raise TaskliftError(f"does not hold: its {name} are {document[name]}, recomputed {found}")
    return says


def _named(file: Path, beside: Path) -> dict[str, str]:
    """Return a file's name, seen from the folder of ``beside``, and its content's hash."""
    return {
        "file": Path(os.path.relpath(file, beside.parent)).as_posix(),
        "sha256": hashlib.sha256(read_bytes(file)).hexdigest(),
    }


def _found(named: dict[str, Any], certificate: Path) -> Path:
    """Return the path of a file that a certificate names, if its content is the same as then."""
    check_fields(named, "policy or place", {"file": str, "sha256": str})
    path = certificate.parent / named["file"]
    if hashlib.sha256(read_bytes(path)).hexdigest() != named["sha256"]:
        raise TaskliftError(f"{path}: is not the file that this certificate is about; its content differs")
    return path
