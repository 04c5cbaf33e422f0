"""Reading and writing files: bounded and checked when read; never half-written, never overwritten unasked."""

from __future__ import annotations

import io
import json
import math
import os
import re
import secrets
import stat
import tempfile
import tomllib
import warnings
import zipfile
from collections import Counter
from collections.abc import Collection, Iterable, Iterator, Sequence
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import IO, Any, TypeAlias

import numpy as np
from numpy.typing import NDArray

from tasklift.checks import plain
from tasklift.errors import TaskliftError
from tasklift.text import shown

try:
    import fcntl
except ImportError:  # not on Windows: leftovers of killed writers stay there
    fcntl = None  # type: ignore[assignment]

PathLike: TypeAlias = str | os.PathLike[str]

LARGEST_FILE = 32_000_000
"""Bytes of the largest document that is read. Parsed, 32 MB of JSON take up to 0.7 GB."""

LARGEST_TOML = 256_000

_PART = re.compile(r"\.tasklift-[0-9a-f]{16}\.part")

# -- writing -----------------------------------------------------------------------------------------------


@contextmanager
def writing(path: PathLike, *, replace: bool = True) -> Iterator[IO[bytes]]:
    """Open a binary file to write ``path`` with, so that a reader sees the old file or the new one, never a part.

    The bytes go to a temporary file of an unpredictable name in the same folder, which takes the place of
    ``path`` at the end. Temporary files that a killed process left in the folder are removed first.

    Parameters
    ----------
    path
        The file. A link there is replaced, not followed.
    replace
        Whether a file that is there may be replaced.

    Raises
    ------
    TaskliftError
        If the folder does not exist or cannot be written to, or there is a file that may not be replaced;
        whatever was at ``path`` is still there.
    """
    target = Path(path)
    if "\0" in str(target):
        raise TaskliftError(f"{target}: cannot be a file's name")
    temporary: str | None = None
    try:
        _remove_leftovers(target.parent)
        file, temporary = _temporary(target.parent)
        with file:
            yield file
            file.flush()
            os.fsync(file.fileno())
            if fcntl is None:
                file.close()  # Windows renames no open file
            if replace:
                os.replace(temporary, target)
            else:
                _place(temporary, target)
    except FileExistsError as error:
        raise TaskliftError(_is_there(target)) from error
    except OSError as error:
        raise TaskliftError(f"{target}: cannot be written ({error.strerror}); choose another place") from error
    finally:
        if temporary is not None:
            with suppress(OSError):
                os.unlink(temporary)


def write_atomically(path: PathLike, data: str | bytes, *, replace: bool = True) -> None:
    """Write ``data`` to ``path`` in one go; see :func:`writing`."""
    with writing(path, replace=replace) as file:
        file.write(data.encode() if isinstance(data, str) else data)


def output_file(path: PathLike, suffixes: Collection[str] = (), *, force: bool = False,
                reads: Iterable[PathLike] = ()) -> Path:  # fmt: skip
    """Return the path if a command may write its output there, and say why not otherwise.

    Parameters
    ----------
    path
        Named by the user, or the command's default.
    suffixes
        What its name may end in, such as ``(".csv",)``; capital letters do not matter.
    force
        Whether a file that is there may be replaced. Pass it on to :func:`writing`, too.
    reads
        Files that the command reads: these are never written, with ``force`` neither.
    """
    target = Path(path)
    if suffixes and not target.name.lower().endswith(tuple(suffixes)):
        raise TaskliftError(f"{target}: expected a name that ends in {' or '.join(suffixes)}")
    try:
        for source in reads:
            there = target.exists() and Path(source).exists()
            if target.resolve() == Path(source).resolve() or (there and target.samefile(source)):
                raise TaskliftError(f"{target}: is read by this command, and never written; choose another name")
        if target.is_dir():
            raise TaskliftError(f"{target}: is a folder; expected the name of a file")
        with suppress(FileNotFoundError):
            os.lstat(target)  # a link counts, wherever it leads; a name that cannot be is an error here
            if not force:
                raise TaskliftError(_is_there(target))
        if not target.parent.is_dir():
            raise TaskliftError(f"{target}: the folder {target.parent} does not exist; make it, or choose another")
    except (OSError, ValueError, RuntimeError) as error:  # a name too long, a NUL, links in a ring
        if isinstance(error, TaskliftError):
            raise
        reason = getattr(error, "strerror", None) or error
        raise TaskliftError(f"{target}: cannot be a file's name ({reason})") from error
    return target


@contextmanager
def results_folder(path: PathLike | None, own: Sequence[str]) -> Iterator[Path]:
    """Yield :func:`output_folder`; for None, a temporary folder, which goes when the block ends."""
    if path is not None:
        yield output_folder(path, own)
        return
    with tempfile.TemporaryDirectory() as folder:
        yield Path(folder)


def output_files(*named: tuple[PathLike | None, Collection[str]], force: bool = False,
                 reads: Iterable[PathLike] = ()) -> list[Path]:  # fmt: skip
    """Return the paths that a command may write its outputs to, each with its ``suffixes``; see :func:`output_file`.

    Outputs that are None are left out. Two of one name would replace each other, and are refused.
    """
    targets = [output_file(path, suffixes, force=force, reads=reads) for path, suffixes in named if path is not None]
    for i, target in enumerate(targets):
        if target.resolve() in [other.resolve() for other in targets[:i]]:
            raise TaskliftError(f"{target}: is named for two outputs; give each a name of its own")
    return targets


def output_folder(path: PathLike, own: Sequence[str] = (), parts: Sequence[str] = ()) -> Path:
    """Make the folder of a command's results, or recognise it: new, empty, or with one of the files ``own`` in it.

    Parameters
    ----------
    path
        Named by the user, or the command's default.
    own
        Names of files by which the command knows its own folder; without any, every folder will do.
    parts
        Folders to make in it: before the work, so that what stands in their way is found then.

    Raises
    ------
    TaskliftError
        If it cannot be made, or holds other things: nothing of the user's is overwritten.
    """
    folder = made = Path(path)
    try:
        folder.mkdir(parents=True, exist_ok=True)
        inside = [name for name in os.listdir(folder) if not name.startswith(".")]
        if not own or not inside or any(name in inside for name in own):
            for part in parts:
                made = folder / part
                made.mkdir(exist_ok=True)
    except (OSError, ValueError) as error:
        reason = getattr(error, "strerror", None) or error
        raise TaskliftError(f"{made}: cannot be a folder of results ({reason}); choose another") from error
    if inside and own and not any(name in inside for name in own):
        raise TaskliftError(
            f"{folder}: is not empty and holds no {' or '.join(own)}: not a folder of this command; choose another"
        )
    return folder


def _is_there(target: Path) -> str:
    return f"{target}: is there already; choose another name, or say --force to replace it"


def _temporary(folder: Path) -> tuple[IO[bytes], str]:
    """Return a new, locked file of an unpredictable name, and the name; the mode is an ordinary new file's."""
    while True:
        name = str(folder / f".tasklift-{secrets.token_hex(8)}.part")
        handle = os.open(name, os.O_RDWR | os.O_CREAT | os.O_EXCL | getattr(os, "O_CLOEXEC", 0), 0o666)
        file = os.fdopen(handle, "wb")
        if fcntl is None:
            return file, name
        with suppress(OSError):  # a file system without locks
            fcntl.flock(handle, fcntl.LOCK_EX)
        if os.fstat(handle).st_nlink:
            return file, name
        file.close()  # somebody cleaned up between the two calls, and took it for a leftover


def _remove_leftovers(folder: Path) -> None:
    """Remove temporary files whose writers are gone: nobody locks them."""
    if fcntl is None:
        return
    for name in os.listdir(folder):
        if not _PART.fullmatch(name):
            continue
        with suppress(OSError):
            handle = os.open(folder / name, os.O_RDWR | os.O_NOFOLLOW | os.O_NONBLOCK)
            try:
                fcntl.flock(handle, fcntl.LOCK_EX | fcntl.LOCK_NB)
                os.unlink(folder / name)
            finally:
                os.close(handle)


def _place(temporary: str, target: Path) -> None:
    """Give a finished file its name, unless there is a file of that name."""
    try:
        os.link(temporary, target)
    except FileExistsError:
        raise
    except OSError:  # a file system without hard links
        if os.path.lexists(target):
            raise FileExistsError from None
        os.replace(temporary, target)


# -- reading -----------------------------------------------------------------------------------------------


def read_bytes(path: PathLike, most: int = LARGEST_FILE) -> bytes:
    """Return the content of a plain file of at most ``most`` bytes; devices and pipes, which may never end, are not.

    Raises
    ------
    TaskliftError
        If there is no such file, it is not plain, too large, or cannot be read.
    """
    try:
        # without O_NONBLOCK, opening a pipe would wait for its writer
        handle = os.open(path, os.O_RDONLY | getattr(os, "O_NONBLOCK", 0) | getattr(os, "O_BINARY", 0))
        with os.fdopen(handle, "rb", closefd=True) as file:
            if not stat.S_ISREG(os.fstat(handle).st_mode):
                raise TaskliftError(f"{path}: is not a plain file, but a device or a pipe; copy it into a file first")
            data = file.read(most + 1)
    except (OSError, ValueError) as error:
        if isinstance(error, TaskliftError):
            raise
        raise TaskliftError(f"{path}: cannot be read ({getattr(error, 'strerror', None) or error})") from error
    if len(data) > most:
        raise TaskliftError(f"{path}: larger than {most:,} bytes, the most that is read of such a file")
    return data


def holds(path: PathLike, text: str) -> bool:
    """Return whether there is a plain file with exactly this text."""
    try:
        return read_bytes(path) == text.encode()
    except TaskliftError:
        return False


def read_text(path: PathLike, most: int = LARGEST_FILE) -> str:
    """Return the text of a plain file: UTF-8, a byte-order mark left out, lines ending in one newline character."""
    try:
        text = read_bytes(path, most).decode("utf-8-sig")
    except UnicodeDecodeError as error:
        raise TaskliftError(f"{path}: expected UTF-8 text, found other bytes at offset {error.start}") from error
    return text.replace("\r\n", "\n").replace("\r", "\n")


def _refuse_constant(name: str) -> Any:
    raise TaskliftError(f"expected a finite number, found {name}")


def _object(pairs: list[tuple[str, Any]]) -> dict[str, Any]:
    found = dict(pairs)
    if len(found) < len(pairs):
        twice = Counter(name for name, _ in pairs).most_common(1)[0][0]
        raise TaskliftError(f"the field {shown(twice)} is there twice")
    return found


def parse_json(text: str, where: str) -> Any:
    """Parse strict JSON into plain data (see :func:`tasklift.checks.plain`).

    Errors name ``where``, and the line and column where the text is not JSON.
    """
    try:
        value = json.loads(text, parse_constant=_refuse_constant, object_pairs_hook=_object)
    except json.JSONDecodeError as error:
        raise TaskliftError(
            f"{where}: not valid JSON at line {error.lineno}, column {error.colno}: {error.msg}; "
            "is the file damaged or cut short?"
        ) from error
    except RecursionError as error:
        raise TaskliftError(f"{where}: JSON nested too deeply to be one of our files") from error
    except TaskliftError as error:
        raise TaskliftError(f"{where}: {error}") from error
    except ValueError as error:  # whole numbers of more than 4,300 digits
        raise TaskliftError(f"{where}: a number has too many digits to be one of ours") from error
    return plain(value, where)


#: A key of many parts, a.b.c…, takes the parser time that grows with the square of their number.
_LONG_KEY = re.compile(r"""(?<![\w-])(?:(?:[\w-]+|"[^"\n]*"|'[^'\n]*')[ \t]*\.[ \t]*){50}""")


def parse_toml(text: str, where: str) -> dict[str, Any]:
    """Parse TOML into plain data (see :func:`tasklift.checks.plain`): dates, infinities and NaN are refused."""
    if len(text) > LARGEST_TOML:
        raise TaskliftError(f"{where}: longer than {LARGEST_TOML:,} characters, the most that is read of a spec")
    if _LONG_KEY.search(text):
        raise TaskliftError(f"{where}: a key of more than 50 parts, which none of ours has")
    try:
        value = tomllib.loads(text)
    except tomllib.TOMLDecodeError as error:
        raise TaskliftError(f"{where}: not valid TOML: {error}") from error
    except RecursionError as error:
        raise TaskliftError(f"{where}: TOML nested too deeply to be one of our files") from error
    except ValueError as error:  # whole numbers of more than 4,300 digits, days that do not exist
        raise TaskliftError(f"{where}: a number or a date is out of range ({str(error).partition(';')[0]})") from error
    return plain(value, where)


def parse_arrays(data: bytes, where: str, shape: tuple[int, ...], most: int) -> dict[str, NDArray[np.float64]]:
    """Return the arrays of an NPZ file's bytes by name: float64, all of the one ``shape`` expected.

    What an array claims to be is compared with ``shape`` before anything is unpacked; together they may have
    at most ``most`` bytes.
    """
    size = 8 * math.prod(shape)
    found: dict[str, NDArray[np.float64]] = {}
    try:
        with zipfile.ZipFile(io.BytesIO(data)) as archive, warnings.catch_warnings():
            warnings.simplefilter("ignore")  # NumPy's, on odd headers
            members = archive.infolist()
            if len(members) * size > most:
                raise TaskliftError(f"{len(members)} arrays of shape {shape}: more than {most:,} bytes")
            for member in members:
                name = member.filename.removesuffix(".npy")
                if member.compress_type not in (zipfile.ZIP_STORED, zipfile.ZIP_DEFLATED):
                    raise TaskliftError(f"array {shown(name)} is packed in a way that NumPy does not use")
                with archive.open(member) as file:
                    version = np.lib.format.read_magic(file)
                    read = np.lib.format.read_array_header_1_0 if version == (1, 0) else _no_header
                    claimed, fortran, dtype = read(file)
                    if claimed != shape or fortran or dtype != np.float64:
                        raise TaskliftError(
                            f"expected array {shown(name)} of shape {shape}, float64, found {claimed}, {dtype}"
                        )
                    raw = file.read(size + 1)
                if len(raw) != size or name in found:
                    raise TaskliftError(f"array {shown(name)} has another length than it says, or is there twice")
                found[name] = np.frombuffer(raw, np.float64).reshape(shape)
    except TaskliftError as error:
        raise TaskliftError(f"{where}: {error}") from error
    except Exception as error:  # damaged bytes make zipfile, zlib and NumPy raise nearly anything
        raise TaskliftError(f"{where}: not a file of arrays ({error or type(error).__name__})") from error
    return found


def _no_header(file: Any) -> Any:
    raise ValueError("a version of the format that NumPy does not use for numbers")


def read_document(path: PathLike, format: str, version: int) -> dict[str, Any]:
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
    return check_document(parse_json(read_text(path), str(path)), str(path), format, version)


def check_document(document: Any, where: str, format: str, version: int) -> dict[str, Any]:
    """Return a parsed document if its fields ``format`` and ``version`` are those expected."""
    if not isinstance(document, dict) or document.get("format") != format:
        found = shown(document.get("format")) if isinstance(document, dict) else type(document).__name__
        raise TaskliftError(f"{where}: expected a {format} file (field 'format'), found {found}")
    version_found = document.get("version")
    if not isinstance(version_found, int) or isinstance(version_found, bool) or not 1 <= version_found <= version:
        raise TaskliftError(
            f"{where}: version {shown(version_found)} of {format} is not readable here (this release reads 1 to "
            f"{version}); install a newer tasklift"
        )
    return document


def canonical_json(value: Any) -> str:
    """One spelling per value: sorted keys, no spaces, shortest round-trip floats. What content ids hash."""
    return json.dumps(value, sort_keys=True, separators=(",", ":"), allow_nan=False, ensure_ascii=False)
