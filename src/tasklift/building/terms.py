"""What a mission declares beside its building, hostiles and rules: its terms, as Python values and as JSON.

Whatever makes missions (specs, studies, certificates, the command line) takes the terms from here, so that a new one
follows a mission everywhere.
"""

from __future__ import annotations

import hashlib
from collections.abc import Callable, Mapping, Sequence
from functools import partial
from pathlib import Path
from types import FunctionType
from typing import Any

from tasklift.building.inputs import function_of
from tasklift.building.team import parse_team, team_to_json
from tasklift.building.variables import (
    INPUTS,
    Sensor,
    chosen_inputs,
    chosen_outputs,
    detector,
    goal_distance,
    waited,
)
from tasklift.checks import check_fields, one_of, whole_number
from tasklift.errors import TaskliftError
from tasklift.files import read_bytes
from tasklift.tasks.variable import Variable
from tasklift.text import shown

#: The names of the terms, which are parameters of :class:`~tasklift.building.mission.Mission`.
TERMS = ("team", "weapons_needed", "limit", "inputs", "outputs")
#: Their fields in a document.
FIELDS: dict[str, Any] = {
    "team?": (str, list, Mapping), "weapons_needed?": int, "limit?": int, "inputs?": (list, tuple),
    "outputs?": (list, tuple),
}  # fmt: skip
#: Inputs with numbers of their own, by the names that documents use.
SENSORS: dict[str, Callable[..., Sensor]] = {
    "waited": waited, "goal_distance": goal_distance, "detector": detector
}  # fmt: skip
#: The largest step limit: draws are numbered with 32 bits.
LARGEST_LIMIT = 10**9
_PARSED: dict[str, Callable[[Any], Any]] = {
    "team": parse_team,
    "weapons_needed": partial(whole_number, what="weapons_needed", least=1, most=LARGEST_LIMIT),
    "limit": partial(whole_number, what="limit", least=1, most=LARGEST_LIMIT),
    "inputs": chosen_inputs,
    "outputs": chosen_outputs,
}

#: Finds ``module:name`` for a document; the second argument says where it is named.
Own = Callable[[str, str], Any]


def terms_of(declares: Any) -> dict[str, Any]:
    """Return the terms of a mission, or of another object that has them."""
    return {name: getattr(declares, name) for name in TERMS}


def parse_terms(declares: Any) -> None:
    """Put checked values in place of the terms that a frozen record was given.

    Raises
    ------
    TaskliftError
        For a team that cannot be read, numbers out of range, and inputs and outputs that cannot be chosen.
    """
    for name, parse in _PARSED.items():
        object.__setattr__(declares, name, parse(getattr(declares, name)))


def terms_to_json(declares: Any) -> dict[str, Any]:
    """Return the terms of a mission, or of another object that has them, as JSON data.

    Raises
    ------
    TaskliftError
        For a sensor whose function lies in no file.
    """
    return {
        "team": team_to_json(declares.team),
        "weapons_needed": declares.weapons_needed,
        "limit": declares.limit,
        "inputs": [_sensor_to_json(sensor) for sensor in declares.inputs],
        "outputs": list(declares.outputs),
    }


def terms_from_json(data: Mapping[str, Any], where: str, own: Own) -> dict[str, Any]:
    """Return terms as arguments of a mission; what a document leaves out is left out.

    Parameters
    ----------
    data : mapping
        What :func:`terms_to_json` returns, or what people write (``docs/formats.md``).
    where : str
        What errors begin with.
    own : function
        Finds what the document names as ``module:name``: sensors, and functions of sensors.

    Raises
    ------
    TaskliftError
        For what is not a term or has a value that a mission cannot have, and for a sensor of one's own that is not
        there or is another one.
    """
    found = check_fields(dict(data), where, FIELDS)
    if "inputs" in found:
        found["inputs"] = [_sensor(given, f"{where}, inputs", own) for given in found["inputs"]]
    try:
        return {name: _PARSED[name](value) for name, value in found.items()}
    except TaskliftError as error:
        raise TaskliftError(f"{where}: {error}") from error


def own_files(sensors: Sequence[Sensor]) -> list[Path]:
    """Return the files that the functions of sensors of one's own lie in, each once."""
    own = [function_of(sensor) for sensor in sensors if callable(sensor.read)]
    return list(dict.fromkeys(Path(function.__code__.co_filename) for function in own))


def _sensor_to_json(sensor: Sensor) -> Any:
    if INPUTS.get(sensor.name) == sensor:
        return sensor.name
    described = {"variable": sensor.variable.to_json(), "numbers": [list(pair) for pair in sensor.numbers]}
    if isinstance(sensor.read, str):
        return described | {"read": sensor.read}
    function = function_of(sensor)
    module = Path(function.__code__.co_filename).stem
    return described | {"read": f"{module}:{function.__name__}", "sha256": _content(function)}


def _content(function: FunctionType) -> str:
    """Return a hash of the file that a function lies in."""
    return hashlib.sha256(read_bytes(function.__code__.co_filename)).hexdigest()


def _sensor(given: Any, where: str, own: Own) -> str | Sensor:
    """Return an input that a document names, describes, or takes from a module beside it."""
    if isinstance(given, str | Sensor):
        return given
    if not isinstance(given, dict):
        raise TaskliftError(f"{where}: expected the name of a variable or a table, found {shown(given)}")
    if "sensor" in given:
        make = SENSORS[one_of(given["sensor"], list(SENSORS), f"{where}, sensor")]
        try:
            return make(**{name: value for name, value in given.items() if name != "sensor"})
        except (TypeError, TaskliftError) as error:
            raise TaskliftError(f"{where}, sensor {given['sensor']}: {error}") from error
    if "python" in given:
        named = check_fields(given, where, {"python": str})["python"]
        sensor = own(named, where)
        if not isinstance(sensor, Sensor):
            raise TaskliftError(f"{where}: expected a Sensor in {named}, found {shown(sensor)}")
        return sensor
    data = check_fields(given, where, {"variable": dict, "numbers": list, "read": str, "sha256?": str})
    read = own(data["read"], where) if "sha256" in data else data["read"]
    sensor = Sensor(Variable.from_json(data["variable"], where), read, data["numbers"])
    if "sha256" in data and _content(function_of(sensor)) != data["sha256"]:
        file = function_of(sensor).__code__.co_filename
        raise TaskliftError(f"{file}: has changed since {sensor.name!r} was recorded; put the file of that time back")
    return sensor
