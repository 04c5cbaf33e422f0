"""The kernel for other inputs than Table I's: its own source with another ``_seen``, compiled once per selection.

The source is written to a file of the user's cache, named by the content of everything that is compiled in. Numba
keeps the machine code beside it, as for any module.
"""

from __future__ import annotations

import builtins
import hashlib
import linecache
import math
import os
import sys
import tempfile
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from functools import lru_cache
from pathlib import Path
from types import CodeType, FunctionType, ModuleType
from typing import Any

from tasklift.building.team import Kind
from tasklift.building.variables import TABLE_I, Sensor, chosen_inputs
from tasklift.errors import TaskliftError
from tasklift.files import write_atomically
from tasklift.text import one_line

_HERE = Path(__file__).parent
_COMPILED_IN = ("kernel.py", "sensors.py", "randomness.py", "../tasks/choice.py")
_SEEN = "    return lane.robots[r].row\n"


def kernel_for(sensors: tuple[Sensor, ...]) -> ModuleType:
    """Return the kernel that shows robots these inputs; for Table I it is :mod:`tasklift.building.kernel`.

    Raises
    ------
    TaskliftError
        For a sensor whose function is unknown, or uses what cannot be compiled in.
    """
    from tasklift.building import kernel

    return kernel if sensors == chosen_inputs(TABLE_I) else _written(sensors)


def numbers_of(sensors: tuple[Sensor, ...], kinds: list[Kind]) -> list[list[float]]:
    """Return what all sensors are given, for each kind of robot: the sensors' numbers, or the kind's own."""
    usual = [pair for sensor in sensors for pair in sensor.numbers]
    return [[dict(kind.attributes).get(name, value) for name, value in usual] for kind in kinds]


@lru_cache(maxsize=32)
def _written(sensors: tuple[Sensor, ...]) -> ModuleType:
    """Return the module of the kernel for some sensors, from the cache's file or newly written."""
    functions, terms, at = {}, [], 0
    for i, sensor in enumerate(sensors):
        functions[f"read_{i}"] = _function(sensor)
        size, stride = len(sensor.variable), math.prod(len(later.variable) for later in sensors[i + 1 :])
        given = f"world.numbers[world.members[r].kind, {at}:{at + len(sensor.numbers)}]"
        at += len(sensor.numbers)
        terms.append(f"min(max(np.int64(read_{i}(world, rules, lane, r, {given})), 0), {size - 1}) * {stride}")
    shown = " + ".join(terms) or "0"
    text = (_HERE / "kernel.py").read_text("utf-8").replace(_SEEN, f"    return {shown}\n", 1)
    content = hashlib.sha256(text.encode())
    for name in _COMPILED_IN:
        content.update((_HERE / name).read_bytes())
    for name, function in functions.items():
        content.update(f"{name} {_content(function, sensors[int(name[5:])].name)}".encode())
    module = ModuleType(f"tasklift_kernel_{content.hexdigest()[:20]}")
    path = _folder() / f"{module.__name__}.py"
    if not path.exists():
        write_atomically(path, text)
    from tasklift.building.randomness import inline

    module.__file__ = str(path)
    vars(module).update({name: f if hasattr(f, "py_func") else inline(f) for name, f in functions.items()})
    sys.modules[module.__name__] = module  # Numba looks a cached function's globals up by the module's name
    exec(compile(text, str(path), "exec"), vars(module))
    linecache.checkcache(str(path))
    return module


def _function(sensor: Sensor) -> Callable[..., Any]:
    """Return the function that reads a sensor."""
    if not isinstance(sensor.read, str):
        return sensor.read
    from tasklift.building import sensors

    known = [name for name, value in vars(sensors).items() if hasattr(value, "py_func")]
    if sensor.read not in known:
        raise TaskliftError(f"sensor {sensor.name!r}: expected a function, found {sensor.read!r}")
    return getattr(sensors, sensor.read)


def _content(function: Any, where: str) -> str:
    """Return a text that changes with whatever a function compiles to: its code, and what it uses by name."""
    plain = getattr(function, "py_func", function)
    if not isinstance(plain, FunctionType) or plain.__closure__:
        raise TaskliftError(
            f"sensor {where!r}: expected a function of a file, without values from around it, found {plain!r}; "
            "pass them as numbers"
        )
    parts = [repr((plain.__code__.co_code.hex(), _constants(plain.__code__), plain.__defaults__))]
    for name in plain.__code__.co_names:
        value = plain.__globals__.get(name, getattr(builtins, name, None))
        if isinstance(value, bool | int | float | str | tuple):
            parts.append(f"{name}={value!r}")
        elif isinstance(getattr(value, "py_func", value), FunctionType):
            of_ours = getattr(value, "__module__", "") or ""
            parts.append(f"{name}={of_ours}" if of_ours.startswith("tasklift.") else f"{name}={_content(value, where)}")
    return "\n".join(parts)


def _constants(code: CodeType) -> list[Any]:
    return [_constants(c) if isinstance(c, CodeType) else c for c in code.co_consts]


def _folder() -> Path:
    """Return the folder of written kernels: in Numba's cache if that is named, else in the user's."""
    home = os.environ.get("NUMBA_CACHE_DIR") or os.environ.get("XDG_CACHE_HOME") or "~/.cache"
    for folder in (Path(home).expanduser() / "tasklift", Path(tempfile.gettempdir()) / f"tasklift-{os.getuid()}"):
        try:
            folder.mkdir(mode=0o700, parents=True, exist_ok=True)
        except OSError:
            continue
        if os.access(folder, os.W_OK):
            return folder
    raise TaskliftError(f"{folder}: cannot be written to; name a folder in the environment variable NUMBA_CACHE_DIR")


@contextmanager
def compiling(sensors: tuple[Sensor, ...]) -> Iterator[None]:
    """Turn an error of the compiler into one line that names the sensors of the user's own."""
    from numba.core.errors import NumbaError

    try:
        yield
    except NumbaError as error:
        own = ", ".join(sensor.name for sensor in sensors if not isinstance(sensor.read, str))
        raise TaskliftError(f"inputs: {own or 'a sensor'} cannot be compiled: {_reason(error)}") from error


def _reason(error: Exception) -> str:
    lines = [line.strip() for line in str(error).splitlines() if line.strip()]
    useful = [line for line in lines if not line.startswith(("Failed in", "During:", "File", "non-precise"))]
    return one_line("; ".join(useful), 160)
