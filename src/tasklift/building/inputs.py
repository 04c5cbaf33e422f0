"""The kernel for other inputs than Table I's: its own source with another ``_seen``, compiled once per selection.

The source is written to a file of the user's cache, named by the content of everything that is compiled in. Numba
keeps the machine code beside it, as for any module.
"""

from __future__ import annotations

import builtins
import hashlib
import inspect
import linecache
import math
import os
import sys
import tempfile
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from enum import Enum, EnumMeta
from pathlib import Path
from types import BuiltinFunctionType, CodeType, FunctionType, ModuleType
from typing import Any

import numpy as np

from tasklift.building.team import Kind
from tasklift.building.variables import TABLE_I, Sensor, chosen_inputs
from tasklift.compiled import fingerprint
from tasklift.errors import TaskliftError
from tasklift.files import write_atomically
from tasklift.text import one_line, shown

_made: dict[str, ModuleType] = {}
_SEEN = "    return lane.robots[r].row\n"


def kernel_for(sensors: tuple[Sensor, ...]) -> ModuleType:
    """Return the kernel that shows robots these inputs; for Table I it is :mod:`tasklift.building.kernel`.

    Raises
    ------
    TaskliftError
        For a sensor whose function is unknown, or uses what cannot be compiled in.
    """
    from tasklift.building import kernel

    return kernel if sensors == chosen_inputs(TABLE_I) else _written(kernel, sensors)


def numbers_of(sensors: tuple[Sensor, ...], kinds: list[Kind]) -> list[list[float]]:
    """Return what all sensors are given, for each kind of robot: the sensors' numbers, or the kind's own."""
    usual = [pair for sensor in sensors for pair in sensor.numbers]
    return [[dict(kind.attributes).get(name, value) for name, value in usual] for kind in kinds]


def _written(kernel: ModuleType, sensors: tuple[Sensor, ...]) -> ModuleType:
    """Return the module of the kernel for some sensors, from the cache's file or newly written."""
    functions, terms, at = {}, [], 0
    first = len(TABLE_I) if sensors[: len(TABLE_I)] == chosen_inputs(TABLE_I) else 0
    if first:  # the kernel knows these already, as one number
        terms = [f"lane.robots[r].row * {math.prod(len(sensor.variable) for sensor in sensors[first:])}"]
    for i, sensor in enumerate(sensors[first:], first):
        functions[f"read_{i}"] = _compiled_alone(sensor)
        size, stride = len(sensor.variable), math.prod(len(later.variable) for later in sensors[i + 1 :])
        given = f"world.numbers[world.members[r].kind, {at}:{at + len(sensor.numbers)}]"
        at += len(sensor.numbers)
        terms.append(f"min(max(np.int64(read_{i}(world, rules, lane, r, {given})), 0), {size - 1}) * {stride}")
    text = inspect.getsource(kernel).replace(_SEEN, f"    return {' + '.join(terms) or '0'}\n", 1)
    content = hashlib.sha256("\n".join([text, fingerprint(*kernel.COMPILED_IN), *map(_key, sensors)]).encode())
    name = f"tasklift_kernel_{content.hexdigest()[:20]}"
    if name in _made:
        return _made[name]
    path = _folder() / f"{name}.py"
    if not path.exists():
        write_atomically(path, text)
    from tasklift.building.randomness import inline

    module = ModuleType(name)
    module.__file__ = str(path)
    vars(module).update({name: f if hasattr(f, "py_func") else inline(f) for name, f in functions.items()})
    sys.modules[name] = module  # Numba looks a cached function's globals up by the module's name
    exec(compile(text, str(path), "exec"), vars(module))
    linecache.checkcache(str(path))
    return _made.setdefault(name, module)


def function_of(sensor: Sensor) -> FunctionType:
    """Return the Python function that reads a sensor.

    Raises
    ------
    TaskliftError
        For a name that no function has, and for what cannot be compiled alone.
    """
    read = _compiled_alone(sensor)
    found = getattr(read, "py_func", read)
    if not isinstance(found, FunctionType) or found.__closure__:
        raise TaskliftError(
            f"sensor {sensor.name!r}: expected a function of a file, without values from around it, found {found!r}; "
            "pass them as numbers"
        )
    return found


def _compiled_alone(sensor: Sensor) -> Callable[..., Any]:
    """Return the function that reads a sensor, as the kernel gets it."""
    if not isinstance(sensor.read, str):
        return sensor.read
    from tasklift.building import sensors

    known = [name for name, value in vars(sensors).items() if hasattr(value, "py_func")]
    if sensor.read not in known:
        raise TaskliftError(f"sensor {sensor.name!r}: expected a function, found {sensor.read!r}")
    return getattr(sensors, sensor.read)


def _key(sensor: Sensor) -> str:
    """Return a text that changes with whatever a sensor's function compiles to: its code, and what it uses by name."""
    return _stated(function_of(sensor), f"sensor {sensor.name!r}")


def _stated(value: Any, where: str) -> str:
    """Return a text that differs for values that compile to something else, or that Numba keeps apart."""
    value = getattr(value, "py_func", value)
    if isinstance(value, FunctionType):
        if value.__module__.startswith("tasklift."):
            return f"{value.__module__}.{value.__name__}"  # the kernel's key has these files already
        codes = list(_codes(value.__code__))
        used = dict.fromkeys(name for code in codes for name in code.co_names)
        found = {name: value.__globals__.get(name, getattr(builtins, name, None)) for name in used}
        # of a module, only what the function may ask it for
        holders = {name: one for name, one in found.items() if isinstance(one, ModuleType | EnumMeta)}
        found |= {f"{name}.{of}": getattr(one, of) for name, one in holders.items() for of in used if hasattr(one, of)}
        parts = [f"{code.co_code.hex()} {[c for c in code.co_consts if not isinstance(c, CodeType)]}" for code in codes]
        # machine code that was kept looks for the module again
        parts += [value.__module__, _stated(value.__defaults__, where)]
        return "\n".join([*parts, *(f"{name}={_stated(one, f'{where}, {name}')}" for name, one in found.items())])
    if isinstance(value, np.ndarray):
        return f"{value.dtype} {value.shape} {hashlib.sha256(value.tobytes()).hexdigest()}"
    if isinstance(value, tuple):
        return f"{type(value).__name__}({', '.join(_stated(one, where) for one in value)})"
    if value is None or isinstance(value, bool | int | float | complex | str | np.generic | Enum):
        return repr(value)
    if isinstance(value, type | ModuleType | BuiltinFunctionType | np.ufunc) or callable(value):
        return getattr(value, "__name__", repr(type(value)))
    raise TaskliftError(f"{where}: expected a number, an array or a function, found {shown(value)}")


def _codes(code: CodeType) -> Iterator[CodeType]:
    """Yield a function's code and that of the functions and comprehensions in it."""
    yield code
    for inner in code.co_consts:
        if isinstance(inner, CodeType):
            yield from _codes(inner)


def _folder() -> Path:
    """Return the folder of written kernels: in Numba's cache if that is named, else in the user's."""
    home = os.environ.get("NUMBA_CACHE_DIR") or os.environ.get("XDG_CACHE_HOME") or "~/.cache"
    # a system without user ids has a temporary folder for each user
    user = f"-{os.getuid()}" if hasattr(os, "getuid") else ""
    for folder in (Path(home).expanduser() / "tasklift", Path(tempfile.gettempdir()) / f"tasklift{user}"):
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
    except (NumbaError, KeyError) as error:  # a KeyError is Numba's for a record's unknown field
        own = ", ".join(sensor.name for sensor in sensors if not isinstance(sensor.read, str))
        reason = f"unknown field {error}" if isinstance(error, KeyError) else _reason(error)
        raise TaskliftError(f"inputs: {own or 'a sensor'} cannot be compiled: {reason}") from error


def _reason(error: Exception) -> str:
    lines = [line.strip() for line in str(error).splitlines() if line.strip()]
    useful = [line for line in lines if not line.startswith(("Failed in", "During:", "File", "non-precise"))]
    return one_line("; ".join(useful), 160)
