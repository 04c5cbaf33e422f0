"""Reading and writing the project's JSON files: versioned, checked, and never half-written."""

from __future__ import annotations

import json
import os
import tempfile
from pathlib import Path
from typing import Any

from tasklift.errors import TaskliftError


def write_atomically(path: str | os.PathLike[str], data: str | bytes) -> None:
    """Write ``data`` to ``path`` so that a reader sees the old file or the whole new one, never a part.

    Raises
    ------
    TaskliftError
        If the folder does not exist or cannot be written to; whatever was at ``path`` is still there.
    """
    target = Path(path)
    raw = data.encode() if isinstance(data, str) else data
    temporary: str | None = None
    try:
        handle, temporary = tempfile.mkstemp(dir=target.parent, prefix=f".{target.name}.", suffix=".part")
        with os.fdopen(handle, "wb") as file:
            file.write(raw)
            file.flush()
            os.fsync(file.fileno())
        # mkstemp makes the file private; give it the mode an ordinary new file would have
        umask = os.umask(0)
        os.umask(umask)
        os.chmod(temporary, 0o666 & ~umask)
        os.replace(temporary, target)
    except OSError as error:
        raise TaskliftError(
            f"{target}: cannot be written ({error.strerror}); choose another place"
        ) from error
    finally:
        if temporary is not None and os.path.exists(temporary):
            os.unlink(temporary)


def read_text(path: str | os.PathLike[str]) -> str:
    """Return the text of ``path``, or raise :class:`TaskliftError` saying why it cannot be read."""
    try:
        return Path(path).read_text(encoding="utf-8")
    except OSError as error:
        raise TaskliftError(f"{path}: cannot be read ({error.strerror})") from error
    except UnicodeDecodeError as error:
        raise TaskliftError(
            f"{path}: expected UTF-8 text, found other bytes at offset {error.start}"
        ) from error


def _refuse_constant(name: str) -> Any:
    raise TaskliftError(f"found {name}, expected a finite number")


def parse_json(text: str, where: str) -> Any:
    """Parse strict JSON (no NaN or infinities); errors name ``where``, the line and the column."""
    try:
        return json.loads(text, parse_constant=_refuse_constant)
    except json.JSONDecodeError as error:
        raise TaskliftError(
            f"{where}: not valid JSON at line {error.lineno}, column {error.colno}: {error.msg}; "
            "is the file damaged or cut short?"
        ) from error
    except RecursionError as error:
        raise TaskliftError(f"{where}: JSON nested too deeply to be one of our files") from error
    except TaskliftError as error:
        raise TaskliftError(f"{where}: {error}") from error


def read_document(path: str | os.PathLike[str], format: str, version: int) -> dict[str, Any]:
    """Read one of the project's JSON documents and check its ``format`` and ``version`` fields.

    Parameters
    ----------
    path
        The file.
    format
        The expected value of the field ``format``, for example ``"tasklift-policy"``.
    version
        The newest version that this release reads.
    """
    document = parse_json(read_text(path), str(path))
    if not isinstance(document, dict) or document.get("format") != format:
        found = document.get("format") if isinstance(document, dict) else type(document).__name__
        raise TaskliftError(f"{path}: expected a {format} file (field 'format'), found {found!r}")
    found = document.get("version")
    if not isinstance(found, int) or isinstance(found, bool) or not 1 <= found <= version:
        raise TaskliftError(
            f"{path}: version {found!r} of {format} is not readable here (this release reads 1 to "
            f"{version}); install a newer tasklift"
        )
    return document


def canonical_json(value: Any) -> str:
    """One spelling per value: sorted keys, no spaces, shortest round-trip floats. What content ids hash."""
    return json.dumps(value, sort_keys=True, separators=(",", ":"), allow_nan=False, ensure_ascii=False)


def check_fields(value: Any, where: str, fields: dict[str, Any]) -> dict[str, Any]:
    """Return ``value`` if it is a JSON object with exactly these fields, each of a type it may have.

    Parameters
    ----------
    value
        What was read.
    where
        Named in errors.
    fields
        For each field the type, or a tuple of types, that it may have; None among them allows null. A truth
        value is not taken for a number. A field whose name ends in ``?`` may be missing.
    """
    if not isinstance(value, dict):
        raise TaskliftError(f"{where}: expected an object with fields, found {type(value).__name__}")
    names = {name.removesuffix("?") for name in fields}
    unknown = sorted(set(value) - names)
    if unknown:
        raise TaskliftError(
            f"{where}: unknown field {unknown[0]!r}; the fields are {', '.join(sorted(names))}"
        )
    for field, kinds in fields.items():
        name, kinds = field.removesuffix("?"), kinds if isinstance(kinds, tuple) else (kinds,)
        if name not in value:
            if field.endswith("?"):
                continue
            raise TaskliftError(f"{where}: the field {name!r} is missing")
        found = value[name]
        if found is None or (isinstance(found, bool) and bool not in kinds):
            fits = found is None and None in kinds
        else:
            fits = isinstance(found, tuple(kind for kind in kinds if kind is not None))
        if not fits:
            wanted = " or ".join("null" if k is None else k.__name__ for k in kinds)
            raise TaskliftError(f"{where}: expected {wanted} in the field {name!r}, found {repr(found)[:60]}")
    return value
