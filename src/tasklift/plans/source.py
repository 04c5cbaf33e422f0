"""A map file that a stranger wrote, read once and with bounds: bytes, text, and the JSON, YAML or XML in it.

Documents come out as plain values: mappings with text for keys, lists, text, numbers, truth values and nothing.
"""

from __future__ import annotations

import math
import os
import re
import stat
from collections.abc import Iterator
from functools import cached_property
from pathlib import Path
from typing import Any
from xml.etree.ElementTree import Element

from tasklift.errors import TaskliftError, missing
from tasklift.files import parse_json

LARGEST_TEXT_BYTES = 20_000_000
LARGEST_YAML_BYTES = 4_000_000
MOST_YAML_EVENTS = 1_000_000
MOST_ELEMENTS = 300_000
LARGEST_FILE_BYTES = 400_000_000
DEEPEST = 50
LONGEST_NAME = 60
YAML_ENDINGS = (".yaml", ".yml", ".tmap", ".tmap2")

_INTEGER = re.compile(r"[-+]?[0-9]{1,18}")
_NUMBER = re.compile(r"[-+]?([0-9]+\.?[0-9]*|\.[0-9]+)([eE][-+]?[0-9]+)?")
_SPECIAL = {".nan": math.nan, "nan": math.nan, "-nan": math.nan, "-.nan": math.nan}
_SPECIAL |= {sign + dot + "inf": math.inf if sign != "-" else -math.inf for sign in ("", "+", "-") for dot in ("", ".")}
_WORDS = {"true": True, "false": False, "null": None, "~": None, "": None}


class Source:
    """A file to be read as a map, with what the user said about it.

    Parameters
    ----------
    path
        The file.
    level
        The level to take of a building that has several.
    resolution_m
        Metres per pixel, or per unit of a drawing, where the file does not say.
    allow_outside
        Whether to follow the path of a picture that leaves the file's folder.
    """

    def __init__(
        self,
        path: str | os.PathLike[str],
        *,
        level: str | None = None,
        resolution_m: float | None = None,
        allow_outside: bool = False,
    ):
        self.path = Path(path)
        self.level = level
        self.resolution_m = resolution_m
        self.allow_outside = allow_outside
        self.files = [self.path]  # the file, and those that belong to it: none of them is ever written
        if resolution_m is not None and not (isinstance(resolution_m, int | float) and 0 < resolution_m <= 1000):
            raise TaskliftError(f"resolution: expected a number above 0 up to 1000 m per pixel, found {resolution_m!r}")

    def fault(self, message: str) -> TaskliftError:
        """Return an error that names the file."""
        return TaskliftError(f"{self.path}: {message}")

    @cached_property
    def head(self) -> bytes:
        """The first 4096 bytes.

        Raises
        ------
        TaskliftError
            If it is not a file that can be read, or empty.
        """
        head = self._bytes(4096)
        if not head.strip():
            raise self.fault("is empty; expected a map")
        return head

    @cached_property
    def data(self) -> bytes:
        """All bytes, at most 400 million."""
        return self._bytes(LARGEST_FILE_BYTES + 1, LARGEST_FILE_BYTES)

    @cached_property
    def text(self) -> str:
        """The text, without a byte-order mark; UTF-8 (or UTF-16 with its mark), at most 20 million bytes."""
        data = self._bytes(LARGEST_TEXT_BYTES + 1, LARGEST_TEXT_BYTES)
        encoding = "utf-16" if data[:2] in (b"\xff\xfe", b"\xfe\xff") else "utf-8-sig"
        try:
            text = data.decode(encoding)
        except UnicodeDecodeError as error:
            raise self.fault(f"expected UTF-8 text, found other bytes at offset {error.start}") from error
        if "\0" in text:
            raise self.fault(f"expected text, found a NUL character at offset {text.index(chr(0))}")
        return text

    @property
    def document(self) -> Any:
        """The plain values of its JSON or YAML, or ``None`` where it holds neither.

        Raises
        ------
        TaskliftError
            If it begins like JSON or YAML and is damaged, too large, or nested too deeply.
        """
        document, error = self._document
        if error is not None:
            raise error
        return document

    @cached_property
    def _document(self) -> tuple[Any, TaskliftError | None]:
        """The document, or why there is none: damage is looked for once, however many readers ask."""
        try:
            return self._parsed(), None
        except TaskliftError as error:
            return None, error

    def _parsed(self) -> Any:
        start = self.text.lstrip()[:1]
        if start == "<":
            return None
        if start in ("{", "[") and self.path.suffix.lower() not in YAML_ENDINGS:
            return parse_json(self.text, str(self.path))
        return _parse_yaml(self)

    @property
    def fields(self) -> dict[str, Any]:
        """The document where it is a mapping, else an empty one."""
        return self.document if isinstance(self.document, dict) else {}

    @cached_property
    def xml(self) -> Element | None:
        """The root of its XML, or ``None`` where it does not begin like XML; no document types, no entities."""
        if not self.head.removeprefix(b"\xef\xbb\xbf").lstrip().startswith(b"<"):
            return None
        if re.search(r"<!(DOCTYPE|ENTITY)", self.text):
            raise self.fault("XML with a document type is not read; remove the <!DOCTYPE …>")
        from xml.etree.ElementTree import ParseError, XMLPullParser

        parser: Any = XMLPullParser(("start", "end"))
        depth = count = 0
        root: Element | None = None
        try:
            for at in range(0, len(self.text), 65536):
                parser.feed(self.text[at : at + 65536])
                for event, element in parser.read_events():
                    root = element if root is None else root
                    depth += 1 if event == "start" else -1
                    count += event == "start"
                    if depth > DEEPEST or count > MOST_ELEMENTS:
                        raise self.fault(f"nested more than {DEEPEST} deep, or of more than {MOST_ELEMENTS:,} elements")
            parser.close()
        except ParseError as error:
            raise self.fault(f"not valid XML ({error}); is the file damaged or cut short?") from error
        return root

    def _bytes(self, most: int, limit: int | None = None) -> bytes:
        try:
            with open(self.path, "rb", opener=_open_plain) as file:
                data = file.read(most)
        except (OSError, ValueError) as error:
            raise self.fault(f"cannot be read ({getattr(error, 'strerror', None) or error})") from error
        if limit is not None and len(data) > limit:
            raise self.fault(f"larger than {limit:,} bytes, which such a map has at most")
        return data


def _open_plain(path: str, flags: int) -> int:
    """Open a plain file; a pipe or a device could be endless, or wait for ever."""
    handle = os.open(path, flags | getattr(os, "O_NONBLOCK", 0))
    if not stat.S_ISREG(os.fstat(handle).st_mode):
        os.close(handle)
        raise ValueError("not a plain file")
    return handle


# -- values ----------------------------------------------------------------------------------------


def number_in(value: object) -> float | None:
    """The number that a value of a document is, also where it was written as text; ``None`` if it is none."""
    if isinstance(value, str):
        value = scalar(value.strip())
    if isinstance(value, bool) or not isinstance(value, int | float):
        return None
    try:
        return float(value)
    except OverflowError:
        return math.inf


def coordinate(value: object) -> float | None:
    """A number up to a thousand kilometres either way, or ``None``."""
    number = number_in(value)
    return number if number is not None and abs(number) <= 1e6 else None


def plain_name(value: object) -> str:
    """A name as it may be shown: one line, without control characters, at most 60 characters; may be empty."""
    text = value if isinstance(value, str) else str(value) if type(value) is int else ""
    text = "".join(c if c.isprintable() else " " for c in text[: 4 * LONGEST_NAME])
    return " ".join(text.split())[:LONGEST_NAME]


# -- documents -------------------------------------------------------------------------------------


def scalar(text: str) -> Any:
    """What an unquoted word of YAML means: a number as yaml-cpp reads it, a truth value, nothing, or text."""
    if _INTEGER.fullmatch(text):
        return int(text)
    if _NUMBER.fullmatch(text):
        return float(text)
    lower = text.lower()
    if lower in _SPECIAL:
        return _SPECIAL[lower]
    return _WORDS.get(lower, text)


def _parse_yaml(source: Source) -> Any:
    """The plain values of a YAML document: no tags, no anchors or aliases.

    Aliases let a few lines stand for millions of values, and no map format needs them. Values are built here from
    the parser's events: PyYAML's own takes ten times as long, and reads ``5e-2`` as text.
    """
    try:
        import yaml
    except ImportError as error:
        raise missing("PyYAML", "plans", "reading YAML") from error

    if len(source.text) > LARGEST_YAML_BYTES:
        raise source.fault(f"larger than {LARGEST_YAML_BYTES:,} characters, which a map's YAML has at most")
    loader = getattr(yaml, "CSafeLoader", yaml.SafeLoader)  # the same, ten times faster, where it was built
    try:
        return _build(yaml, source, yaml.parse(source.text, Loader=loader))
    except yaml.YAMLError as error:
        mark = getattr(error, "problem_mark", None)
        line = f"line {mark.line + 1}: " if mark else ""
        problem = getattr(error, "problem", None) or getattr(error, "reason", "unreadable")
        raise source.fault(f"{line}not valid YAML ({problem})") from error
    except (RecursionError, ValueError, OverflowError) as error:
        if isinstance(error, TaskliftError):
            raise
        raise source.fault(f"not a map's YAML ({type(error).__name__})") from error


def _build(yaml: Any, source: Source, events: Iterator[Any]) -> Any:
    root: list[Any] = []
    stack: list[Any] = [root]
    keys: list[str | None] = [None]  # for every mapping under way the key that waits for its value
    documents = 0
    for i, event in enumerate(events):
        if i > MOST_YAML_EVENTS:
            raise source.fault(f"of more than {MOST_YAML_EVENTS:,} YAML values, which a map has not")
        kind = type(event)
        if kind is yaml.ScalarEvent or kind is yaml.SequenceStartEvent or kind is yaml.MappingStartEvent:
            if event.tag is not None:
                line = event.start_mark.line + 1
                raise source.fault(f"line {line}: a map holds plain values only, without tags such as {event.tag:.40}")
            into = stack[-1]
            if kind is yaml.ScalarEvent:
                if isinstance(into, dict) and keys[-1] is None:
                    keys[-1] = event.value
                    continue
                value = scalar(event.value) if event.implicit[0] else event.value
            else:
                if len(stack) > DEEPEST:
                    raise source.fault(f"nested more than {DEEPEST} deep, which a map is not")
                value = [] if kind is yaml.SequenceStartEvent else {}
            if isinstance(into, list):
                into.append(value)
            elif keys[-1] is None:
                line = event.start_mark.line + 1
                raise source.fault(f"line {line}: expected a name for a field, found a list or mapping")
            else:
                into[keys[-1]], keys[-1] = value, None
            if kind is not yaml.ScalarEvent:
                stack.append(value)
                keys.append(None)
        elif kind is yaml.SequenceEndEvent or kind is yaml.MappingEndEvent:
            stack.pop()
            keys.pop()
        elif kind is yaml.AliasEvent:
            line = event.start_mark.line + 1
            raise source.fault(f"line {line}: YAML aliases are not allowed in a map; write it out")
        elif kind is yaml.DocumentStartEvent:
            documents += 1
            if documents > 1:
                break
    return root[0] if root else None
