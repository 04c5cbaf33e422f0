"""The code that a spec brings along: a module that lies beside it, and nothing else unless it is allowed.

A spec is text, and text must not run commands. What a spec names as ``module:name`` is looked for in ``module.py``
beside the spec; whoever puts a module there means it to run. Everything else that can be imported needs a word on the
command line (``--allow-imports``).
"""

from __future__ import annotations

import hashlib
import re
import signal
import sys
import threading
import traceback
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from importlib import import_module
from importlib.util import module_from_spec, spec_from_file_location
from pathlib import Path
from types import ModuleType
from typing import Any

from tasklift.errors import TaskliftError
from tasklift.text import one_line, shown

LONGEST_LOAD_S = 20.0
"""Seconds that a module, or what it makes, may take to be there; training has no limit."""


_loading = threading.RLock()  # one thread at a time runs a module beside a spec


class _Late(BaseException):
    """The time is over; no ``except Exception`` of the user's catches it."""


class OwnCode:
    """Finds what a spec names, and turns its errors into one line.

    Parameters
    ----------
    folder
        Where the spec lies.
    anywhere
        Whether any module that can be imported will do.
    """

    def __init__(self, folder: Path, anywhere: bool = False) -> None:
        self.folder, self.anywhere = folder.resolve(), anywhere
        self._modules: dict[str, ModuleType] = {}

    def made(self, named: str, options: Mapping[str, Any], where: str) -> Any:
        """Return what ``module:name`` gives when it is called with the options.

        Raises
        ------
        TaskliftError
            If it does not exist, raises, exits, takes too long, or is not allowed.
        """
        make = self.named(named, where)
        if not callable(make):
            raise TaskliftError(f"{where}: expected a class or a function in {named}, found {shown(make)}")
        with self.loading(where):
            return make(**options)

    def named(self, named: str, where: str) -> Any:
        """Return what ``module:name`` names.

        Raises
        ------
        TaskliftError
            If it does not exist, or is not allowed; and if the module raises, exits or takes too long.
        """
        name, _, attribute = named.partition(":")
        if not attribute.isidentifier():
            raise TaskliftError(f"{where}: expected module:name, found {shown(named)}")
        module = self.module(name, where)
        if not hasattr(module, attribute):
            raise TaskliftError(f"{where}: module {name!r} has no {attribute!r}")
        return getattr(module, attribute)

    def module(self, name: str, where: str) -> ModuleType:
        """Return a module beside the spec, run once as long as it stays the same; or any other, if that is allowed."""
        if name in self._modules:
            return self._modules[name]
        if not re.fullmatch(r"[A-Za-z_]\w*(\.[A-Za-z_]\w*)*", name):
            raise TaskliftError(f"{where}: expected the name of a module, found {shown(name)}")
        file = self.folder / f"{name}.py"
        if file.is_file():
            with _loading:
                found = self._beside(name, file, where)
        elif self.anywhere:
            with self.loading(where):
                found = import_module(name)
        else:
            raise TaskliftError(
                f"{where}: no {name}.py beside the spec; other modules are imported with --allow-imports only, "
                "because a module is code that runs"
            )
        self._modules[name] = found
        return found

    def _beside(self, name: str, file: Path, where: str) -> ModuleType:
        # of a name of its own, so that it never takes the place of an installed module, or of another spec's; the same
        # one for the same content, since machine code that is kept is looked for by it
        known = f"spec_{hashlib.sha256(file.read_bytes()).hexdigest()[:8]}_{name}"
        if known in sys.modules and sys.modules[known].__file__ == str(file):
            return sys.modules[known]
        plan = spec_from_file_location(known, file)
        assert plan is not None
        assert plan.loader is not None
        module = sys.modules[known] = module_from_spec(plan)
        sys.path.insert(0, str(self.folder))  # it may import others that lie beside it
        try:
            with self.loading(where):
                plan.loader.exec_module(module)
        except BaseException:
            del sys.modules[known]
            raise
        finally:
            sys.path.remove(str(self.folder))
        return module

    @contextmanager
    def loading(self, where: str) -> Iterator[None]:
        """Turn whatever the code raises into one line; give up after some time."""
        try:
            with _within(LONGEST_LOAD_S):
                yield
        except (TaskliftError, KeyboardInterrupt):
            raise
        except BaseException as error:
            raise self._told(error, where) from error

    @contextmanager
    def running(self, where: str) -> Iterator[None]:
        """Turn what the code beside the spec raises into one line; errors from elsewhere stay as they are."""
        try:
            yield
        except TaskliftError:
            raise
        except (Exception, SystemExit) as error:
            if self._place(error) is None:
                raise
            raise self._told(error, where) from error

    def _told(self, error: BaseException, where: str) -> TaskliftError:
        place = self._place(error)
        said = {
            SystemExit: "ends the program",
            _Late: f"was not done after {LONGEST_LOAD_S:g} s",
        }.get(type(error), f"{type(error).__name__}: {error}")
        return TaskliftError(f"{where}: {place + ': ' if place else ''}{one_line(said, 150)}")

    def _place(self, error: BaseException) -> str | None:
        """Return file and line of the last step in a file beside the spec; None if the error comes from elsewhere."""
        if isinstance(error, SyntaxError) and error.filename and Path(error.filename).parent == self.folder:
            return f"{Path(error.filename).name}, line {error.lineno}"
        frames = traceback.extract_tb(error.__traceback__)
        inside = [frame for frame in frames if Path(frame.filename).parent == self.folder]
        return f"{Path(inside[-1].filename).name}, line {inside[-1].lineno}" if inside else None


@contextmanager
def _within(seconds: float) -> Iterator[None]:
    """Give up after some time, in the main thread of systems that have alarms."""
    if threading.current_thread() is not threading.main_thread() or not hasattr(signal, "setitimer"):
        yield
        return

    def late(*_: Any) -> None:
        raise _Late

    before = signal.signal(signal.SIGALRM, late)
    signal.setitimer(signal.ITIMER_REAL, seconds)
    try:
        yield
    finally:
        signal.setitimer(signal.ITIMER_REAL, 0)
        signal.signal(signal.SIGALRM, before)
