"""Grid maps of the MovingAI benchmarks (``.map``): characters for cells.

Format: N. Sturtevant, "Benchmarks for Grid-Based Pathfinding", 2012: ``.``, ``G`` and ``S`` (swamp) are passable,
``@``, ``O``, ``T`` (trees) and ``W`` (water) are not.
"""

from __future__ import annotations

import re

import numpy as np

from tasklift.plans.plan import LARGEST_PIXELS, Plan
from tasklift.plans.source import Source
from tasklift.text import shown

TITLE = "MovingAI grid map (.map), --resolution"
RESOLUTION_M = 0.5
FREE, OTHERS = b".GS", b"@OTW"


def recognises(source: Source) -> bool:
    """Whether it begins with its four lines of header."""
    return re.match(rb"(\xef\xbb\xbf)?type\s+\S+\s+(height|width)\s", source.head) is not None


def read(source: Source) -> Plan:
    """Read the cells; they are 0.5 m wide unless the user says otherwise.

    Raises
    ------
    TaskliftError
        With the line at fault.
    """
    lines = source.text.splitlines()
    header = {line.split()[0].lower(): line.split()[-1] for line in lines[:4] if line.split()}
    size = [header.get(key, "") for key in ("height", "width")]
    if not all(re.fullmatch("[0-9]{1,6}", word) for word in size) or "map" not in header:
        raise source.fault("expected the lines type, height, width and map")
    height, width = (int(word) for word in size)
    if not 0 < height * width <= LARGEST_PIXELS:
        raise source.fault(f"{height} x {width} cells; expected 1 to {LARGEST_PIXELS:,}")
    start = next(i for i, line in enumerate(lines) if line.strip().lower() == "map") + 1
    rows = lines[start : start + height]
    if len(rows) < height:
        raise source.fault(f"cut short: {height} rows announced, {len(rows)} found")
    cells = np.zeros((height, width), np.uint8)
    for i, row in enumerate(rows):
        if len(row) != width or not row.isascii():
            raise source.fault(f"line {start + i + 1}: expected {width} cells, found {len(row)}")
        cells[i] = np.frombuffer(row.encode(), np.uint8)
    free = np.isin(cells, np.frombuffer(FREE, np.uint8))
    odd = ~free & ~np.isin(cells, np.frombuffer(OTHERS, np.uint8))
    if odd.any():
        row, column = np.argwhere(odd)[0].tolist()
        found = shown(chr(cells[row, column]))
        raise source.fault(f"line {start + row + 1}: expected one of . G S @ O T W, found {found}")
    resolution = source.resolution_m or RESOLUTION_M
    guess = f"cells were taken as {RESOLUTION_M:g} m wide; --resolution says otherwise"
    doubts = () if source.resolution_m else (guess,)
    grey = np.where(free, 254, 0).astype(np.uint8)
    return Plan(source.path.stem, free, np.zeros_like(free), grey, resolution, (0.0, 0.0, 0.0), doubts)
