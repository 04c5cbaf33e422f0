"""The file that declares a mission: team, kinds of robots, inputs, outputs. TOML, or JSON with the same fields.

``tasklift train`` writes ``mission.json`` beside the policy, so that what a mission declares goes with it::

    inputs = ["DL", "GL", "nWPN", "FTR", "WAITED", { sensor = "detector", range_m = 12 }, { python = "own:home" }]
    outputs = ["MV", "WPN", "CA", "BACK"]
    weapons_needed = 2
    limit = 600

    [[team]]
    kind = "crawler"
    robots = 4
    speed_mm = 700
    armed = true
    attributes = { detector_range_m = 20 }
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

from tasklift.building.mission import Mission
from tasklift.building.terms import own_files, terms_from_json, terms_to_json
from tasklift.errors import about
from tasklift.files import canonical_json, parse_json, parse_toml, read_bytes, read_text, write_atomically
from tasklift.studies.own_code import OwnCode

MISSION_FILE = "mission.json"


def declared(file: Path | None, beside: Path | None = None, **given: Any) -> dict[str, Any]:
    """Return what a mission declares, as its arguments.

    Parameters
    ----------
    file : Path, optional
        TOML or JSON. A module that lies beside it, and that it names, is code, and runs.
    beside : Path, optional
        A folder. Without ``file``, its ``mission.json`` is read, if it has one.
    given
        The team (default: ``10+5``) and other arguments, in place of the file's; None: not given.

    Raises
    ------
    TaskliftError
        For a file that cannot be read, and what cannot be declared.
    """
    if file is None and beside is not None and (beside / MISSION_FILE).exists():
        file = beside / MISSION_FILE
    found: dict[str, Any] = {"team": "10+5"}
    if file is not None:
        parse = parse_json if file.suffix == ".json" else parse_toml
        document = parse(read_text(file), str(file))
        with about(file):
            found |= terms_from_json(document, "mission", OwnCode(file.parent).named)
    return found | {name: value for name, value in given.items() if value is not None}


def save_declared(mission: Mission, folder: Path) -> None:
    """Write what a mission declares as ``mission.json``, with the modules of its own sensors beside it."""
    write_atomically(folder / MISSION_FILE, canonical_json(terms_to_json(mission)) + "\n")
    for file in own_files(mission.inputs):
        write_atomically(folder / file.name, read_bytes(file))
