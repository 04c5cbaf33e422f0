"""The command line, and ``python -m tasklift``: Ctrl-C ends in one line from here on, while the rest is imported."""

from __future__ import annotations

import os
import signal
import sys


def main() -> None:
    """Run the command line; see :func:`tasklift.cli.main.main`."""
    sys.unraisablehook = _unraisable
    heeded = signal.getsignal(signal.SIGINT) is signal.default_int_handler  # else whoever started us ignores it
    if heeded:
        signal.signal(signal.SIGINT, _stop)
    from tasklift.cli.main import main as run

    if heeded:
        signal.signal(signal.SIGINT, signal.default_int_handler)
    run()


def _stop(*_: object) -> None:
    """End at once: there is nothing to tidy up, and an exception could be lost while Python imports a module."""
    os.write(2, b"tasklift: stopped\n")
    os._exit(130)


def _unraisable(problem: sys.UnraisableHookArgs) -> None:
    """Stop at a Ctrl-C that falls where Python ignores exceptions, such as the end of an import."""
    if issubclass(problem.exc_type, KeyboardInterrupt):
        _stop()
    sys.__unraisablehook__(problem)


if __name__ == "__main__":
    main()
