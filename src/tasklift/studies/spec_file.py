"""A curriculum in one small TOML file: environment, task, learner, stages; run, compared, judged.

The whole language, by example (``docs/tutorial.md`` explains it)::

    name = "cliff"
    seeds = 100                                     # of the comparison
    performance = "return"                          # or "steps", "success"

    [environment]
    gymnasium = "CliffWalking-v1"                   # or building = …, or python = "module:function"
    limit = 200
    options = { is_slippery = true }
    loss = { reward = -100 }                        # when something is lost
    success = { terminated = true }

    [task]
    inputs = { row = 4, col = 12 }                  # a number stands for 0, 1, …
    outputs = { move = ["up", "right", "down", "left"] }

    [learner]
    rule = "sarsa"                                  # q-learning, sarsa, expected-sarsa or reinforcement
    step_size = 0.5

    [[stages]]
    name = "dry"
    options = { is_slippery = false }               # the environment's own switch
    trials = 300

    [[stages]]
    name = "slippery"
    trials = 300
    guard = { measure = "losses", share = 0.1 }
"""

from __future__ import annotations

import hashlib
import os
import sys
from collections.abc import Callable, Mapping
from dataclasses import fields
from importlib import import_module
from pathlib import Path
from typing import Any

from tasklift.checks import check_fields
from tasklift.envs.gymnasium import Event, Factored
from tasklift.errors import TaskliftError
from tasklift.files import canonical_json, parse_json, parse_toml, read_text, write_atomically
from tasklift.learning.compare import Comparison, compare
from tasklift.learning.curriculum import Curriculum
from tasklift.learning.guard import Guard
from tasklift.learning.learner import Learner
from tasklift.learning.reinforcement import Reinforcement, Sweep
from tasklift.learning.stage import Stage
from tasklift.learning.values import ValueLearning
from tasklift.tasks.prior import Prior, forget, invert, scale, set_weight, swap
from tasklift.tasks.task import LARGEST_TABLE, Signal, Task, Variable

_NUMBER = (int, float)
_TASK_CHANGES = ("fix", "remove", "restrict", "signals", "impossible", "time_reward")
_PRIORS = {"swap": swap, "forget": forget, "invert": invert, "scale": scale, "set_weight": set_weight}


def read_spec(path: str | os.PathLike[str]) -> dict[str, Any]:
    """Read a spec file (TOML, or JSON with the same fields) and check its outer fields."""
    text, where = read_text(path), str(path)
    document = parse_json(text, where) if Path(path).suffix == ".json" else parse_toml(text, where)
    check_fields(
        document,
        where,
        {
            "name": str,
            "environment": dict,
            "task?": dict,
            "learner?": dict,
            "stages": list,
            "seeds?": int,
            "performance?": str,
            "first?": int,
            "last?": int,
            "threshold?": _NUMBER,
            "max_losses?": int,
            "block?": int,
            "best_by?": list,
        },
    )
    if document.get("performance", "return") not in ("return", "steps", "success"):
        raise TaskliftError(f"{where}: performance is return, steps or success, found {document['performance']!r}")
    return document


def curriculum_of(document: Mapping[str, Any], folder: str | os.PathLike[str] = ".") -> Curriculum:
    """Return the curriculum that a spec describes; files it names are looked for in ``folder``.

    Raises
    ------
    TaskliftError
        For whatever is wrong with it: all of it is checked, and nothing is trained.
    """
    environment = dict(document["environment"])
    stages = document["stages"]
    if not stages:
        raise TaskliftError("stages: expected at least one [[stages]]")
    root = _declared_task(document, environment)
    built: list[Stage] = []
    after: Task | None = None
    # backwards, since each stage says how it simplifies the task of the next one
    for number in reversed(range(len(stages))):
        where = f"stages, {number + 1}"
        data = check_fields(stages[number], where, _stage_fields())
        where = f"stage {data['name']!r}"
        try:
            changed = _merged(environment, data.get("options", {}), where)
            world = _world(changed, root, Path(folder))
            base = after if after is not None else world.task
            changes = {name: data[name] for name in _TASK_CHANGES if name in data}
            if "signals" in changes:
                changes["signals"] = [_signal(s, where) for s in changes["signals"]]
            after = base.simplify(name=data["name"], **changes) if changes else base
            learner = _learner({**document.get("learner", {}), **data.get("learner", {})}, data.get("repeats"), where)
            kept = {n: data[n] for n in _STAGE_NUMBERS if n in data}
            guard = None if "guard" not in data else _made(Guard, data["guard"], f"{where}, guard")
            prior = tuple(_prior(p, where) for p in data.get("prior", []))
            built.append(Stage(data["name"], after, world, learner, prior=prior, guard=guard, **kept))
        except TaskliftError as error:
            raise TaskliftError(str(error) if where in str(error) else f"{where}: {error}") from error
    outer = {n: document[n] for n in ("max_losses", "block", "best_by") if n in document}
    curriculum = Curriculum(tuple(reversed(built)), **outer)
    curriculum.check()
    return curriculum


def run_spec(
    path: str | os.PathLike[str],
    out: str | os.PathLike[str] | None = None,
    seeds: int | None = None,
    progress: Callable[[int, int], None] | None = None,
) -> Comparison:
    """Run a spec file: the curriculum against direct learning, over seeds.

    Parameters
    ----------
    path
        The spec.
    out
        A folder for ``comparison.json``, ``comparison.txt`` and ``policy.json`` (the first seed's); it may be missing,
        empty, or hold the results of the same spec.
    seeds
        In place of the spec's.
    progress
        Called after each seed with the number of seeds done, and of all.
    """
    document = read_spec(path)
    try:
        curriculum = curriculum_of(document, Path(path).parent)
        chosen = seeds if seeds is not None else document.get("seeds", 20)
        identity = hashlib.sha256(canonical_json([document, chosen]).encode()).hexdigest()
        folder = None if out is None else _prepared(Path(out), identity)
        options = {n: document[n] for n in ("performance", "first", "last", "threshold") if n in document}
        comparison = compare(curriculum, seeds=chosen, progress=progress, **options)
    except TaskliftError as error:
        raise TaskliftError(f"{path}: {error}") from error
    if folder is not None:
        told = {"format": "tasklift-comparison", "version": 1, "spec": identity, "name": document["name"]}
        comparison.policy.save(folder / "policy.json")
        write_atomically(folder / "comparison.txt", f"{comparison}\n")
        write_atomically(folder / "comparison.json", canonical_json(told | comparison.to_json()) + "\n")
    return comparison


def _prepared(folder: Path, identity: str) -> Path:
    """Return the output folder, or refuse one that holds something else."""
    held = folder / "comparison.json"
    if held.exists():
        found = parse_json(read_text(held), str(held))
        if not isinstance(found, dict) or found.get("spec") != identity:
            raise TaskliftError(f"{folder}: holds the results of another spec; choose another folder")
    elif folder.exists() and (not folder.is_dir() or any(folder.iterdir())):
        raise TaskliftError(f"{folder}: is not empty; choose another folder")
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise TaskliftError(f"{folder}: cannot be made ({error.strerror})") from error
    return folder


# -- the parts -------------------------------------------------------------------------------------------------

_STAGE_NUMBERS = ("trials", "steps", "trust", "keep_exploration", "max_losses", "rehearsal", "key")


def _stage_fields() -> dict[str, Any]:
    return {
        "name": str,
        "options?": dict,
        "fix?": dict,
        "remove?": list,
        "restrict?": dict,
        "signals?": list,
        "impossible?": list,
        "time_reward?": _NUMBER,
        "learner?": dict,
        "trials?": int,
        "steps?": int,
        "repeats?": int,
        "prior?": list,
        "trust?": _NUMBER,
        "keep_exploration?": bool,
        "max_losses?": int,
        "rehearsal?": bool,
        "guard?": dict,
        "key?": int,
    }


def _made(kind: Any, data: Mapping[str, Any], where: str) -> Any:
    """Return a settings record made from named fields; unknown ones are refused."""
    names = {f.name for f in fields(kind)}
    unknown = sorted(set(data) - names)
    if unknown:
        raise TaskliftError(f"{where}: unknown field {unknown[0]!r}; the fields are {', '.join(sorted(names))}")
    return kind(**data)


def _learner(data: Mapping[str, Any], repeats: int | None, where: str) -> Learner:
    if data.get("rule", "reinforcement") == "reinforcement":
        rest = {name: value for name, value in data.items() if name != "rule"}
        found = _made(Reinforcement, rest, f"{where}, learner")
        return found if repeats is None else Sweep(found, repeats)
    if repeats is not None:
        raise TaskliftError(f"{where}: a sweep reinforces weights; a learner by value needs trials= or steps=")
    return _made(ValueLearning, data, f"{where}, learner")


def _prior(data: Any, where: str) -> Prior:
    if not isinstance(data, dict) or str(data.get("operation")) not in _PRIORS:
        raise TaskliftError(f"{where}: a prior has an operation: {', '.join(_PRIORS)}; found {data!r}")
    rest = {name: value for name, value in data.items() if name != "operation"}
    try:
        return _PRIORS[data["operation"]](**rest)  # type: ignore[operator]
    except TypeError as error:
        raise TaskliftError(f"{where}: prior {data['operation']}: {error}") from error


def _signal(data: Any, where: str) -> Signal:
    check_fields(data, f"{where}, signal", {"value": _NUMBER, "when?": dict, "name?": str})
    return Signal(**data)


def _variables(data: Mapping[str, Any], where: str) -> tuple[Variable, ...]:
    found = []
    for name, values in data.items():
        if isinstance(values, int) and not isinstance(values, bool):
            if not 1 <= values <= LARGEST_TABLE:
                raise TaskliftError(f"{where}: {name!r} needs from one to {LARGEST_TABLE:,} values, found {values}")
            found.append(Variable(name, tuple(range(values))))
        elif isinstance(values, list):
            found.append(Variable(name, tuple(values)))
        else:
            raise TaskliftError(f"{where}: expected a number or a list of values for {name!r}, found {values!r}")
    return tuple(found)


def _declared_task(document: Mapping[str, Any], environment: Mapping[str, Any]) -> Task | None:
    kinds = [kind for kind in ("gymnasium", "building", "python") if kind in environment]
    if len(kinds) != 1:
        raise TaskliftError(f"environment: expected one of gymnasium, building or python, found {kinds or 'none'}")
    if kinds != ["gymnasium"]:
        if "task" in document:
            raise TaskliftError(f"task: a world from {kinds[0]!r} brings its own; take [task] out")
        return None
    number = {"impossible_signal?": _NUMBER, "time_reward?": _NUMBER}
    data = check_fields(
        document.get("task"), "task", {"inputs": dict, "outputs": dict, "signals?": list, "impossible?": list} | number
    )
    return Task(
        document["name"],
        _variables(data["inputs"], "task, inputs"),
        _variables(data["outputs"], "task, outputs"),
        tuple(_signal(s, "task") for s in data.get("signals", [])),
        tuple(data.get("impossible", [])),
        **{n.rstrip("?"): data[n.rstrip("?")] for n in number if n.rstrip("?") in data},
    )


def _merged(environment: Mapping[str, Any], options: Mapping[str, Any], where: str) -> dict[str, Any]:
    """Return the environment with a stage's options in place of its own."""
    if "building" not in environment:
        return {**environment, "options": {**environment.get("options", {}), **options}}
    reading = {**environment.get("reading", {}), **options.get("reading", {})}
    if "building" in options:
        raise TaskliftError(f"{where}: all stages are in one building")
    return {**environment, **options} | ({"reading": reading} if reading else {})


def _world(environment: Mapping[str, Any], task: Task | None, folder: Path) -> Any:
    if "gymnasium" in environment and task is not None:
        return _gymnasium(environment, task)
    if "building" in environment:
        return _mission(environment, folder)
    data = check_fields(environment, "environment", {"python": str, "options?": dict})
    module, _, function = data["python"].partition(":")
    sys.path.insert(0, str(folder.resolve()))
    try:
        make = getattr(import_module(module), function)
    except (ImportError, AttributeError, ValueError) as error:
        raise TaskliftError(f"environment: cannot find {data['python']!r} ({error}); give module:function") from error
    finally:
        sys.path.pop(0)
    return make(**data.get("options", {}))


def _gymnasium(environment: Mapping[str, Any], task: Task) -> Any:
    data = check_fields(
        environment,
        "environment",
        {"gymnasium": str, "options": dict, "loss?": dict, "success?": dict, "limit?": int},
    )
    try:
        import gymnasium
    except ImportError as error:
        raise TaskliftError('needs Gymnasium; type: pip install "tasklift[gym]"') from error
    try:
        env = gymnasium.make(data["gymnasium"], **data["options"])
    except (gymnasium.error.Error, TypeError, ValueError, AssertionError) as error:
        raise TaskliftError(f"environment: Gymnasium cannot make {data['gymnasium']!r}: {error}") from error
    judges = {name: _judge(data[name], task, name) for name in ("loss", "success") if name in data}
    world = Factored(env, task, limit=data.get("limit"), **judges)
    return world.model() if world.has_model else world


def _judge(condition: Mapping[str, Any], task: Task, what: str) -> Any:
    """Return the function that tells whether an event meets a condition of the spec.

    The condition names ``reward``, ``terminated``, input variables (their value after the step) or outputs.
    """
    names = {"reward", "terminated"} | {v.name for v in task.variables}
    for name in condition:
        if name not in names:
            raise TaskliftError(f"environment, {what}: unknown {name!r}; conditions are on {', '.join(sorted(names))}")
    allowed = {name: value if isinstance(value, list) else [value] for name, value in condition.items()}

    def judge(event: Event) -> bool:
        seen: dict[str, Any] = {"reward": event.reward, "terminated": event.terminated}
        seen |= task.input_values(event.input) | task.output_values(event.output)
        return all(seen[name] in values for name, values in allowed.items())

    return judge


def _mission(environment: Mapping[str, Any], folder: Path) -> Any:
    from tasklift.building import SCOUT, WEAPON, Building, Mission, Reading, generate

    data = check_fields(
        environment,
        "environment",
        {
            "building": (str, dict),
            "team?": str,
            "hostiles?": (int, list),
            "weapons_needed?": int,
            "limit?": int,
            "reading?": dict,
        },
    )
    team = data.get("team", "10+5").split("+")
    if len(team) != 2 or not all(part.strip().isdigit() for part in team):
        raise TaskliftError(f"environment, team: expected SCOUTS+WEAPONS such as 10+5, found {data['team']!r}")
    try:
        chosen = data["building"]
        building = Building.load(folder / chosen) if isinstance(chosen, str) else generate(**chosen)
    except TypeError as error:
        raise TaskliftError(f"environment, building: {error}") from error
    hostiles = data.get("hostiles", 1)
    numbers = {name: data[name] for name in ("weapons_needed", "limit") if name in data}
    return Mission(
        building,
        {SCOUT: int(team[0]), WEAPON: int(team[1])},
        tuple(hostiles) if isinstance(hostiles, list) else hostiles,
        Reading.from_json(data.get("reading", {}), "environment, reading"),
        **numbers,
    )
