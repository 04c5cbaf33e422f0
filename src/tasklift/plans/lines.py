"""Floor plans that come as lines: walls and floors drawn on a fine grid."""

from __future__ import annotations

from collections.abc import Iterable, Sequence

import numpy as np
from numpy.typing import NDArray

from tasklift.plans.plan import Plan
from tasklift.plans.source import Source

# The first that keeps the plan below a number of cells.
RESOLUTIONS_M = (0.05, 0.1)
MOST_CELLS = 17_000_000
WALL_M = 0.1
# Around what is drawn; where the outdoors is not known to be no floor, wide enough not to look like a corridor.
MARGIN_M, OUTDOORS_M = 1.0, 4.0
DEEP_M = 0.35  # an opening reaches so far to both sides

Points = NDArray[np.float64]


def plan_of_lines(
    source: Source,
    name: str,
    walls: Sequence[Points],
    floors: Sequence[Points] = (),
    *,
    doors: Points | None = None,
    openings: Points | None = None,
    seeds: Points | None = None,
    doubts: Iterable[str] = (),
) -> Plan:
    """The plan of walls and floors on a grid of 5 cm, or 10 cm if it is very large.

    Without floors all within the walls' bounds is floor.

    Parameters
    ----------
    walls, floors
        Lines and polygons, ``(n, 2)`` points each (m).
    doors
        ``(K, 2, 2)``: both ends of every door (m), or ``None`` where the file does not tell.
    openings
        ``(K, 2, 2)``: both ends (m) of every place where walls are to be opened; they may run through doors, and be
        drawn by both their faces.
    seeds
        ``(n, 2)``: points (m) in the building, or ``None``.

    Raises
    ------
    TaskliftError
        If the lines extend farther than a plan may.
    """
    from PIL import Image, ImageDraw

    points = np.concatenate([*walls, *floors])
    margin = MARGIN_M if len(floors) else OUTDOORS_M
    low, high = points.min(axis=0) - margin, points.max(axis=0) + margin
    for resolution in RESOLUTIONS_M:
        width, height = (float(v) for v in np.ceil((high - low) / resolution))
        if width * height <= MOST_CELLS:
            break
    else:
        raise source.fault(
            f"{name}: {high[0] - low[0]:.0f} x {high[1] - low[1]:.0f} m are more than fits {MOST_CELLS:,} cells of "
            f"{resolution:g} m; is the measurement right, and the unit?"
        )

    def pixels(line: Points) -> list[tuple[float, float]]:
        at = (line - low) / resolution
        return [(x - 0.5, height - y - 0.5) for x, y in at.tolist()]

    thickness = max(1, round(WALL_M / resolution))
    floor = Image.new("1", (int(width), int(height)), 0 if len(floors) else 1)
    pen = ImageDraw.Draw(floor)
    for polygon in floors:
        pen.polygon(pixels(polygon), fill=1)
    drawn = Image.new("1", floor.size, 0)
    pen = ImageDraw.Draw(drawn)
    for line in walls:
        pen.line(pixels(line), fill=1, width=thickness)
    for start, end in () if openings is None else openings:
        along = end - start
        deep = np.array([-along[1], along[0]]) / max(np.hypot(*along), 1e-9) * DEEP_M
        doorway = pixels(np.array([start - deep, end - deep, end + deep, start + deep]))
        pen.polygon(doorway, fill=0)
        ImageDraw.Draw(floor).polygon(doorway, fill=1)
    wall, inside = np.asarray(drawn, bool), np.asarray(floor, bool)
    return Plan(
        name,
        inside & ~wall,
        ~inside & ~wall,
        np.where(wall, 0, np.where(inside, 254, 205)).astype(np.uint8),
        resolution,
        (float(low[0]), float(low[1]), 0.0),
        tuple(doubts),
        doors_m=doors,
        seeds_m=seeds,
    )
