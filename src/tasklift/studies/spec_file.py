"""A curriculum in one small TOML file: environment, task, learner, stages.

The whole language, by example (``docs/tutorial.md`` explains it)::

    name = "cliff"
    seeds = 100                                     # of the comparison
    performance = "return"                          # or "steps", "success"

    [environment]
    gymnasium = "CliffWalking-v1"                   # or building = …, or python = "module:name", beside the spec
    limit = 200
    options = { is_slippery = true }
    loss = { reward = -100 }                        # when something is lost
    success = { terminated = true }

    [task]
    inputs = { row = 4, col = 12 }                  # a number stands for 0, 1, …
    outputs = { move = ["up", "right", "down", "left"] }

    [learner]
    rule = "sarsa"                                  # q-learning, sarsa, expected-sarsa or reinforcement; or
    step_size = 0.5                                 # python = "module:Class" and its settings

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
import re
from collections.abc import Iterator, Mapping, MutableMapping
from dataclasses import asdict, fields, replace
from pathlib import Path
from typing import Any

from tasklift.building import Building, Mission, Reading, generate
from tasklift.building.search import hostile_candidates
from tasklift.building.terms import FIELDS, TERMS, terms_from_json, terms_of
from tasklift.checks import check_fields, one_of
from tasklift.envs.gymnasium import Event, Factored, has_table, make_environment
from tasklift.errors import TaskliftError, about
from tasklift.files import canonical_json, parse_json, parse_toml, read_text
from tasklift.learning.curriculum import Curriculum
from tasklift.learning.guard import Guard
from tasklift.learning.learner import Learner
from tasklift.learning.reinforcement import Reinforcement, Sweep
from tasklift.learning.stage import Stage
from tasklift.learning.values import ValueLearning
from tasklift.learning.worlds import Steps
from tasklift.studies.arms import Arm, Setup
from tasklift.studies.own_code import OwnCode
from tasklift.tasks.prior import Prior, forget, invert, scale, set_weight, swap
from tasklift.tasks.task import LARGEST_TABLE, Signal, Task, Variable
from tasklift.text import shown

_NUMBER = (int, float)
#: In place of a number of hostiles: one at each place that may hide one.
EVERY_DOOR = "every door"
_TASK_CHANGES = ("fix", "remove", "restrict", "merge", "signals", "impossible", "time_reward")
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
            "simplify?": dict,
        },
    )
    if document.get("performance", "return") not in ("return", "steps", "success"):
        raise TaskliftError(f"{where}: performance is return, steps or success, found {document['performance']!r}")
    return document


def curriculum_of(
    document: Mapping[str, Any],
    folder: str | os.PathLike[str] = ".",
    *,
    allow_imports: bool = False,
    worlds: MutableMapping[str, Any] | None = None,
) -> Curriculum:
    """Return the curriculum that a spec describes; :func:`tasklift.studies.learn.run_spec` runs it.

    Parameters
    ----------
    document
        As :func:`read_spec` returns it.
    folder
        Where files and modules that it names are looked for. A module there is code, and runs.
    allow_imports
        Whether it may name any other module, too.
    worlds
        Worlds made so far. Curricula with the same mapping, in one thread, share the worlds of equal environments.

    Raises
    ------
    TaskliftError
        For whatever is wrong with it: all of it is checked, and nothing is trained.
    """
    environment = dict(document["environment"])
    stages = document["stages"]
    if not stages:
        raise TaskliftError("stages: expected at least one [[stages]]")
    root, code = _declared_task(document, environment), OwnCode(Path(folder), allow_imports)
    built: list[Stage] = []
    after: Task | None = None
    # backwards, since each stage says how it simplifies the task of the next one
    for number in reversed(range(len(stages))):
        where = f"stages, {number + 1}"
        data = check_fields(stages[number], where, _stage_fields())
        where = f"stage {data['name']!r}"
        try:
            changed = _merged(environment, data.get("options", {}), where)
            key = "" if worlds is None else canonical_json(changed)
            world = worlds[key] if worlds and key in worlds else _world(changed, root, Path(folder), code)
            if worlds is not None:
                worlds[key] = world
            base = after if after is not None else world.task
            changes = {name: data[name] for name in _TASK_CHANGES if name in data}
            if "signals" in changes:
                changes["signals"] = [_signal(s, where) for s in changes["signals"]]
            after = base.simplify(name=data["name"], **changes) if changes else base
            settings = _settings(document.get("learner", {}), data.get("learner", {}))
            learner = _learner(settings, data.get("repeats"), code, where)
            kept = {n: data[n] for n in _STAGE_NUMBERS if n in data}
            guard = None if "guard" not in data else _made(Guard, data["guard"], f"{where}, guard")
            prior = tuple(_prior(p, where) for p in data.get("prior", []))
            built.append(Stage(data["name"], after, world, learner, prior=prior, guard=guard, **kept))
        except TaskliftError as error:
            raise TaskliftError(str(error) if where in str(error) else f"{where}: {error}") from error
    outer = {n: document[n] for n in ("max_losses", "block", "best_by") if n in document}
    curriculum = Curriculum(tuple(reversed(built)), **outer)
    with code.running("stages"):
        curriculum.check()
    return curriculum


def code_beside(document: Mapping[str, Any], folder: Path) -> dict[str, str]:
    """Return the modules beside a spec that it names anywhere, with the SHA-256 of each."""
    named = sorted({name.partition(":")[0] for name in _code_named(document)})
    files = {name: folder / f"{name}.py" for name in named}
    return {name: hashlib.sha256(file.read_bytes()).hexdigest() for name, file in files.items() if file.is_file()}


def _code_named(part: Any) -> Iterator[str]:
    """Yield what a spec, or a part of it, names as code: the worlds and learners of modules."""
    if isinstance(part, Mapping):
        yield from (part[key] for key in ("python", "gymnasium") if isinstance(part.get(key), str))
    if isinstance(part, Mapping | list):
        for value in part.values() if isinstance(part, Mapping) else part:
            yield from _code_named(value)


def arm_of(path: str | os.PathLike[str], *, allow_imports: bool = False) -> Arm:
    """Return a spec's curriculum as an arm for missions: a mission takes the place of the spec's environment.

    Parameters
    ----------
    path
        Of the spec. The arm is called ``own-`` and the file's name; it is judged against ``direct``.
    allow_imports
        As in :func:`curriculum_of`.

    Raises
    ------
    TaskliftError
        If the file cannot be read as a spec. What is wrong with a stage is found when a study is made; the error
        names the file.
    """
    slug = re.sub("[^a-z0-9]+", "-", Path(path).stem.lower()).strip("-")
    document = {name: value for name, value in read_spec(path).items() if name != "environment"}
    arm = own_arm(f"own-{slug}" if slug else "own", document, Path(path).parent, allow_imports=allow_imports)

    def curriculum(on: Setup) -> Curriculum:
        with about(path):
            return arm.curriculum(on)

    return replace(arm, curriculum=curriculum)


def own_arm(slug: str, document: Mapping[str, Any], folder: Path, *, allow_imports: bool = False) -> Arm:
    """Return the arm that a spec without environment describes; parameters as in :func:`curriculum_of`."""

    def curriculum(on: Setup) -> Curriculum:
        mission = on.mission
        hostiles = mission.hostiles if isinstance(mission.hostiles, int) else list(mission.hostiles)
        environment = {"building": mission.building, "hostiles": hostiles, "reading": asdict(mission.reading)}
        environment |= terms_of(mission)
        made = curriculum_of({**document, "environment": environment}, folder, allow_imports=allow_imports)
        return replace(made, stages=(*made.stages[:-1], replace(made.stages[-1], name="target")))

    meaning = f"the {len(document['stages'])} stage(s) of a spec"
    return Arm(slug, document["name"], meaning, curriculum, against=("direct",), drawn=True, settings=dict(document))


# -- the parts -------------------------------------------------------------------------------------------------

_STAGE_NUMBERS = ("trials", "steps", "trust", "keep_exploration", "max_losses", "rehearsal", "key")


def _stage_fields() -> dict[str, Any]:
    return {
        "name": str,
        "options?": dict,
        "fix?": dict,
        "remove?": list,
        "restrict?": dict,
        "merge?": dict,
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


def _settings(common: Mapping[str, Any], own: Mapping[str, Any]) -> dict[str, Any]:
    """Return a stage's settings of its learner: its own before the common ones, if both are of one kind."""
    another = ("python" in own or "rule" in own) and ("python" in own) != ("python" in common)
    return dict(own) if another else {**common, **own}


def _learner(data: Mapping[str, Any], repeats: int | None, code: OwnCode, where: str) -> Learner:
    if "python" in data:
        rest = {name: value for name, value in data.items() if name != "python"}
        made = code.made(_text(data["python"], f"{where}, learner"), rest, f"{where}, learner")
        for method in ("start", "learn"):
            if isinstance(made, type) or not callable(getattr(made, method, None)):
                raise TaskliftError(f"{where}, learner: {data['python']} makes no learner: it has no {method}()")
        if repeats is not None:
            raise TaskliftError(f"{where}: repeats= is a sweep's, which reinforces weights; give trials= or steps=")
        return made
    if data.get("rule", "reinforcement") == "reinforcement":
        rest = {name: value for name, value in data.items() if name != "rule"}
        found = _made(Reinforcement, rest, f"{where}, learner")
        return found if repeats is None else Sweep(found, repeats)
    if repeats is not None:
        raise TaskliftError(f"{where}: a sweep reinforces weights; a learner by value needs trials= or steps=")
    return _made(ValueLearning, data, f"{where}, learner")


def _prior(data: Any, where: str) -> Prior:
    number = {"factor?": _NUMBER, "value?": _NUMBER}
    check_fields(data, f"{where}, prior", {"operation": str, "output?": str, "values?": list, "when?": dict} | number)
    one_of(data["operation"], _PRIORS, f"{where}, prior, operation")
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
    for held, which in ((environment, "environment"), (options, f"{where}, options")):
        for name in ("options", "reading"):
            if not isinstance(held.get(name, {}), dict):
                raise TaskliftError(f"{which}: expected {name} = {{ name = value, … }}, found {shown(held[name])}")
    if "building" not in environment:
        return {**environment, "options": {**environment.get("options", {}), **options}}
    reading = {**environment.get("reading", {}), **options.get("reading", {})}
    if "building" in options:
        raise TaskliftError(f"{where}: all stages are in one building")
    return {**environment, **options} | ({"reading": reading} if reading else {})


def _world(environment: Mapping[str, Any], task: Task | None, folder: Path, code: OwnCode) -> Any:
    if "gymnasium" in environment and task is not None:
        return _gymnasium(environment, task, code)
    if "building" in environment:
        return _mission(environment, folder, code)
    data = check_fields(environment, "environment", {"python": str, "options?": dict})
    world = code.made(data["python"], data.get("options", {}), "environment")
    with code.loading("environment"):
        found = isinstance(getattr(world, "task", None), Task) and not isinstance(world, type)
        if not found or not (isinstance(world, Steps) or callable(getattr(world, "run", None))):
            raise TaskliftError(
                f"environment: {data['python']} makes no world: it needs a task, and start(), step(), limit, or run()"
            )
    return world


def _gymnasium(environment: Mapping[str, Any], task: Task, code: OwnCode) -> Any:
    data = check_fields(
        environment,
        "environment",
        {"gymnasium": str, "options": dict, "loss?": dict, "success?": dict, "limit?": int},
    )
    module, _, name = data["gymnasium"].rpartition(":")
    if module:
        code.module(module, "environment")
    env = make_environment(name, data["options"])
    judges = {name: _judge(data[name], task, name) for name in ("loss", "success") if name in data}
    # a table of transitions knows no masks, and where one stage has a table, all are to choose alike
    mask = None if has_table(env) else "action_mask"
    world = Factored(env, task, limit=data.get("limit"), mask=mask, **judges)
    try:
        return world.model() if has_table(env) else world
    except TaskliftError:  # its table of transitions is not all of it: then the environment itself, step by step
        return world


def _judge(condition: Mapping[str, Any], task: Task, what: str) -> Any:
    """Return the function that tells whether an event meets a condition of the spec.

    The condition names ``reward``, ``terminated``, ``truncated``, input variables (their value after the step)
    or outputs.
    """
    inputs = {v.name for v in task.inputs}
    names = {"reward", "terminated", "truncated"} | {v.name for v in task.variables}
    for name in condition:
        if name not in names:
            raise TaskliftError(f"environment, {what}: unknown {name!r}; conditions are on {', '.join(sorted(names))}")
    allowed = {name: value if isinstance(value, list) else [value] for name, value in condition.items()}

    def judge(event: Event) -> bool:
        seen: dict[str, Any] = {name: getattr(event, name) for name in ("reward", "terminated", "truncated")}
        seen |= task.output_values(event.output)
        if inputs & set(allowed):
            try:
                seen |= task.input_values(event.input)
            except TaskliftError:  # what comes back at the end may be no input of the task
                if not event.terminated:
                    raise
                return False
        return all(seen[name] in values for name, values in allowed.items())

    return judge


def _mission(environment: Mapping[str, Any], folder: Path, code: OwnCode) -> Mission:
    data = check_fields(
        environment,
        "environment",
        {
            "building": (str, dict, Building),
            "hostiles?": (int, list, str),
            "reading?": dict,
            **FIELDS,
        },
    )
    try:
        chosen = data["building"]
        building = Building.load(folder / chosen) if isinstance(chosen, str) else chosen
        if isinstance(building, dict):
            building = generate(**building)
    except TypeError as error:
        raise TaskliftError(f"environment, building: {error}") from error
    hostiles = data.get("hostiles", 1)
    if isinstance(hostiles, str):
        one_of(hostiles, (EVERY_DOOR,), "environment, hostiles")
        hostiles = hostile_candidates(building)
    reading = Reading.from_json(data.get("reading", {}), "environment, reading")
    terms = terms_from_json({name: data[name] for name in TERMS if name in data}, "environment", code.named)
    try:
        return Mission(building, reading=reading, hostiles=hostiles, **{"team": "10+5"} | terms)
    except TaskliftError as error:
        raise TaskliftError(f"environment: {error}") from error


def _text(value: Any, where: str) -> str:
    if not isinstance(value, str):
        raise TaskliftError(f"{where}: expected text, found {shown(value)}")
    return value
