"""The space of simpler tasks: moves make a task simpler, steps combine them, candidates are chains of steps.

A *move* changes one thing: a switch of the world, or one variable of the task. A *step* is a stage before the target
task: at most one switch, some other moves, and what is carried over from it. A *candidate* is one step, or several in a
row, each at least as simple in the task's variables as the next one.
"""

from __future__ import annotations

import hashlib
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from itertools import chain, combinations, product
from typing import Any

from tasklift.building import Mission
from tasklift.building.search import SEARCH_SIGNALS, SEARCH_TIME_REWARD
from tasklift.building.team import team_to_json
from tasklift.errors import TaskliftError
from tasklift.studies.spec_file import EVERY_DOOR
from tasklift.tasks.task import Task
from tasklift.tasks.variable import Signal, Variable

#: Fields of a stage that say how its task differs from the next one's; moves of one stage may share them.
CHANGES = ("fix", "remove", "restrict", "merge")
#: An input of fewer values than this is not made coarser.
COARSE_FROM = 4
_LONGEST = 90  # characters of a name in the store, where ten more may come before it


@dataclass(frozen=True)
class Move:
    """One thing that makes a task simpler: ``words`` for people, ``fields`` of a stage, the input that it concerns."""

    words: str
    fields: Mapping[str, Any]
    variable: str = ""


@dataclass(frozen=True)
class Carry:
    """What is carried over into the next stage: ``fields`` of that stage. Without words: all is copied."""

    words: str = ""
    fields: Mapping[str, Any] = field(default_factory=dict)


@dataclass(frozen=True)
class Step:
    """A stage before the target: the moves that make it simpler, and what is carried over from it.

    ``entries`` is the size of its table, the cheapness by which candidates are sorted.
    """

    moves: tuple[Move, ...]
    carry: Carry
    entries: int

    @property
    def words(self) -> str:
        """For people, such as ``no holes, without row; forget move``."""
        return ", ".join(move.words for move in self.moves) + (f"; {self.carry.words}" if self.carry.words else "")

    @property
    def changes(self) -> frozenset[str]:
        """The moves that change the task's table, by their words."""
        return frozenset(move.words for move in self.moves if move.fields.keys() & set(CHANGES))


@dataclass(frozen=True)
class Candidate:
    """Steps before the target, the first one learned first; or a curriculum of the user's own."""

    steps: tuple[Step, ...] = ()
    own: Mapping[str, Any] | None = None

    @property
    def words(self) -> str:
        """For people."""
        return str(self.own["name"]) if self.own is not None else " → ".join(step.words for step in self.steps)

    @property
    def name(self) -> str:
        """The candidate in the store: its words, cut where they are too long."""
        words = self.words
        digest = hashlib.sha256(words.encode()).hexdigest()[:8]
        return words if len(words) <= _LONGEST else f"{words[: _LONGEST - 10]}… {digest}"

    @property
    def complexity(self) -> tuple[int, int]:
        """How much there is to say: stages; moves and what is not merely copied. Of equals, the simplest is chosen."""
        if self.own is not None:
            return len(self.own["stages"]), sum(map(len, self.own["stages"]))
        return len(self.steps), sum(len(step.moves) + bool(step.carry.words) for step in self.steps)

    @property
    def cost(self) -> tuple[int, int, int]:
        """What candidates are sorted by: stages, entries of their tables, complexity."""
        return len(self.steps), sum(step.entries for step in self.steps), self.complexity[1]

    def stages(self, budget: Mapping[str, Any]) -> tuple[list[dict[str, Any]], dict[str, Any]]:
        """Return the stages before the target as a spec has them, and the fields that the target stage gets.

        Parameters
        ----------
        budget
            ``trials`` in all, divided evenly; and other fields that every stage before the target has.
        """
        if self.own is not None:
            entering = {name: value for name, value in self.own.items() if name in ("prior", "trust")}
            return [dict(stage) for stage in self.own["stages"]], entering
        found: list[dict[str, Any]] = []
        carried: Mapping[str, Any] = {}
        for k, step in enumerate(self.steps):
            after = self.steps[k + 1].changes if k + 1 < len(self.steps) else frozenset()
            trials = budget["trials"] * (k + 1) // len(self.steps) - budget["trials"] * k // len(self.steps)
            stage = {"name": step.words.partition(";")[0], **budget, "trials": trials}
            found.append(joined([stage, *(m.fields for m in step.moves if m.words not in after), carried]))
            carried = step.carry.fields
        return found, dict(carried)


def joined(parts: Iterable[Mapping[str, Any]]) -> dict[str, Any]:
    """Return the fields of several parts of a stage; tables and lists that several have are put together."""
    whole: dict[str, Any] = {}
    for part in parts:
        for name, value in part.items():
            there = whole.get(name)
            if isinstance(there, Mapping) and isinstance(value, Mapping):
                whole[name] = {**there, **value}
            elif isinstance(there, list) and isinstance(value, list):
                whole[name] = [*there, *value]
            else:
                whole[name] = value
    return whole


def steps(task: Task, settings: Mapping[str, Any], world: Any = None) -> list[Candidate]:
    """Return every candidate of one stage once, the cheapest first.

    Parameters
    ----------
    task
        The target task.
    settings
        The spec's ``[simplify]``.
    world
        The target's world; a :class:`~tasklift.building.Mission` brings switches of its own.

    Examples
    --------
    >>> from tasklift.tasks.task import Task, Variable
    >>> walk = Task("walk", (Variable("place", range(8)), Variable("rain", (0, 1))), (Variable("go", (0, 1)),))
    >>> [candidate.words for candidate in steps(walk, {"trials": 20})]
    ['without place', 'coarse place', 'without rain']
    """
    never = [set(pair) for pair in settings.get("never", ())]
    found = []
    switches = [None, *(_switch(fields, task) for fields in _switches(settings, world))]
    for moves in _together(_moves(task), settings.get("depth", 1)):
        for switch in switches:
            chosen = moves if switch is None else (switch, *moves)
            touched = {move.variable for move in moves} | set(switch.fields.get("fix", ()) if switch else ())
            if any(pair <= touched for pair in never):
                continue
            if chosen and (simple := _simplified(task, chosen)) is not None:
                entries = simple.shape[0] * simple.shape[1]
                found += [Candidate((Step(chosen, carry, entries),)) for carry in _carries(simple, settings)]
    return sorted(found, key=lambda candidate: candidate.cost)


def chains(last: Sequence[Candidate], first: Sequence[Candidate]) -> list[Candidate]:
    """Return the chains of two stages, the first one simpler than the last; the cheapest first.

    The first one's table must be the last one's or a simplification of it, and the two must differ.
    """
    found = []
    for after, before in product(last, first):
        one, other = before.steps[0], after.steps[0]
        if one.changes >= other.changes and one.moves != other.moves:
            found.append(Candidate((one, other)))
    return sorted(found, key=lambda candidate: candidate.cost)


def _together(moves: Sequence[Move], depth: int) -> Iterator[tuple[Move, ...]]:
    """Yield the combinations of up to ``depth`` moves on different variables, none first."""
    for chosen in chain.from_iterable(combinations(moves, n) for n in range(depth + 1)):
        if len({move.variable for move in chosen}) == len(chosen):
            yield chosen


def _moves(task: Task) -> list[Move]:
    """Return what can be done with one variable: leave an input out or make it coarser, take values from an output."""
    found = []
    for variable in task.inputs:
        if len(variable) > 1 and len(task.inputs) > 1:
            found.append(Move(f"without {variable.name}", {"remove": [variable.name]}, variable.name))
        if len(variable) >= COARSE_FROM and _ordered(variable):
            values = list(variable.values)
            pairs = [values[k : k + 2] for k in range(0, len(values), 2)]
            found.append(Move(f"coarse {variable.name}", {"merge": {variable.name: pairs}}, variable.name))
    for variable in task.outputs:
        found += [
            Move(words, {"restrict": {variable.name: values}}, variable.name) for words, values in _fewer(variable)
        ]
    return found


def _fewer(variable: Variable) -> list[tuple[str, list[Any]]]:
    """Return ways to restrict an output, in words and values: every second value, or each value but one."""
    values = list(variable.values)
    if len(values) >= COARSE_FROM and _ordered(variable):
        return [(f"coarse {variable.name}", values[::2])]
    left = [[value for value in values if value != out] for out in values]
    return [
        (f"{variable.name} never {variable.label(out)}", kept) for out, kept in zip(values, left, strict=True) if kept
    ]


def _ordered(variable: Variable) -> bool:
    """Return whether the values are numbers in order, and not names in the guise of numbers."""
    numbers = all(isinstance(value, int | float) and not isinstance(value, bool) for value in variable.values)
    return numbers and variable.labels is None and list(variable.values) == sorted(variable.values)


def _simplified(task: Task, moves: Sequence[Move]) -> Task | None:
    """Return the task of a step; None if a signal depends on what is left out, or nothing is left to choose."""
    fields = joined(move.fields for move in moves)
    changes = {name: fields[name] for name in CHANGES if name in fields}
    fixed, changed = changes.get("fix", {}), [*changes.get("remove", ()), *changes.get("merge", {})]
    if set(fixed) & {*changed, *changes.get("restrict", {})}:
        return None
    try:
        own = [Signal(**signal) for signal in fields["signals"]] if "signals" in fields else None
        simple = task.simplify(**changes, signals=own)
    except TaskliftError:
        return None
    return simple if simple.shape[1] > 1 else None


def _switch(fields: Mapping[str, Any], task: Task) -> Move:
    """Return a switch of the world as a move; what it fixes must be a variable of the task."""
    stage = {name: value for name, value in fields.items() if name not in ("name", "harmless")}
    names = [variable.name for variable in task.variables]
    if "fix" in stage:
        stage["fix"] = {name: value for name, value in stage["fix"].items() if name in names}
    return Move(fields["name"], stage | ({"rehearsal": True} if fields.get("harmless", False) else {}))


def _switches(settings: Mapping[str, Any], world: Any) -> list[Mapping[str, Any]]:
    """Return the spec's switches; of a mission, if the spec has none, what a building search can do without."""
    if "switches" in settings or not isinstance(world, Mission):
        return list(settings.get("switches", ()))
    inputs = {variable.name for variable in world.task.inputs}
    safe = {
        "name": "no hostiles",
        "options": {"hostiles": 0},
        "fix": {name: 0 for name in ("DL", "GL") if name in inputs},
        "signals": [{"value": signal.value, "when": dict(signal.when)} for signal in SEARCH_SIGNALS],
        "time_reward": SEARCH_TIME_REWARD,
    }
    drills = [
        {"name": f"harmless hostiles {where}", "options": options, "harmless": True}
        for where, options in (
            ("in place", {"reading": {"drill": True}}),
            ("relocated", {"reading": {"drill": True, "relocate": True}}),
            ("at every door", {"reading": {"drill": True}, "hostiles": EVERY_DOOR}),
        )
    ]
    fewer = [{"name": "one hostile", "options": {"hostiles": 1}}] if world.n_hostiles > 1 else []
    return [safe, *drills, *fewer, *_half_team(world)]


def _half_team(mission: Mission) -> list[Mapping[str, Any]]:
    """Return the switch that halves the team, if that leaves enough robots to destroy a hostile."""
    half = {kind: (n + 1) // 2 for kind, n in mission.team.items()}
    try:
        replace(mission, team=half)
    except TaskliftError:
        return []
    return [{"name": "half the team", "options": {"team": team_to_json(half)}}]


def _carries(simple: Task, settings: Mapping[str, Any]) -> list[Carry]:
    """Return what may be carried over: all, all but one of several outputs, the user's priors, and degrees of trust."""
    learned = [variable.name for variable in simple.outputs if len(variable) > 1]
    forgotten = learned if len(learned) > 1 else []
    found = [Carry(), *(Carry(f"forget {n}", {"prior": [{"operation": "forget", "output": n}]}) for n in forgotten)]
    found += [Carry(prior["name"], {"prior": list(prior["operations"])}) for prior in settings.get("priors", ())]
    return [*found, *(Carry(f"trust {trust:g}", {"trust": trust}) for trust in settings.get("trust", ()))]
