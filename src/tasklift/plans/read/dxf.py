"""DXF drawings, by layers, with ezdxf: what is on the layers of walls is drawn; doors are left open.

Layers are recognised by their names in a few languages. Without a layer of walls, all lines are walls but those on
layers of doors, furniture, dimensions, text and the like.
"""

from __future__ import annotations

import io
import logging
import re
from typing import Any

import numpy as np
from numpy.typing import NDArray

from tasklift.errors import TaskliftError, missing
from tasklift.plans.lines import plan_of_lines
from tasklift.plans.plan import Plan
from tasklift.plans.source import Source
from tasklift.text import shown

TITLE = "DXF drawing (.dxf), with the extra [dxf]; --resolution: metres per unit"
MOST_LINES = 100_000
CURVE_STEP_M = 0.05
_NOT_LINES = ("TEXT", "MTEXT", "ATTRIB", "HATCH", "POINT", "IMAGE", "DIMENSION", "MESH")
# $INSUNITS: metres per unit
_UNITS = {1: 0.0254, 2: 0.3048, 4: 0.001, 5: 0.01, 6: 1.0, 10: 0.9144, 14: 0.1}
_WALLS = re.compile(
    r"wall|wand|wände|mauer|mur|parete|muro|pared|parede|стен|墙|partition|column|stütze|glaz|window|fenster"
)
_OPEN = re.compile(r"door|tür|tuer|porte|porta|puerta|двер|门|swing|leaf")
_OTHER = re.compile(
    r"furn|möbel|moebel|mobil|equip|dim|mass|text|anno|hatch|schraff|grid|axis|achse|title|border|defpoints|sanit|stair|"
    r"elec|plumb|hvac|symbol|note|logo|viewport"
)


def recognises(source: Source) -> bool:
    """Whether it begins with a section in DXF's pairs of lines, or is its binary form."""
    head = source.head.removeprefix(b"\xef\xbb\xbf")
    begins = re.match(rb"\s*(999\s*\r?\n[^\n]*\n\s*)*0\s*\r?\n\s*SECTION", head)
    return begins is not None or head.startswith(b"AutoCAD Binary DXF")


def read(source: Source) -> Plan:
    """Draw the walls.

    Raises
    ------
    TaskliftError
        If the drawing is damaged, too large, or has no lines.
    """
    drawing = _drawing(source)
    lines: dict[str, list[NDArray[np.float64]]] = {}
    for layer, line in _lines(source, drawing):
        lines.setdefault(layer, []).append(line)
    names = sorted(lines)
    chosen = [n for n in names if _WALLS.search(n.lower()) and not _OPEN.search(n.lower())]
    doubts = []
    if not chosen:
        chosen = [n for n in names if not _OPEN.search(n.lower()) and not _OTHER.search(n.lower())]
        listed = ", ".join(shown(n) for n in chosen[:5])
        doubts.append(f"no layer is named like walls; took all lines on {listed:.120} for walls")
    walls = [line for name in chosen for line in lines[name]]
    if not walls:
        raise source.fault(f"has no lines that could be walls; its layers are {', '.join(map(shown, names[:8])):.160}")
    scale = source.resolution_m or _UNITS.get(int(drawing.header.get("$INSUNITS", 0) or 0))
    if scale is None:
        points = np.concatenate(walls)
        extent = float(np.ptp(points, axis=0).max())
        scale = 0.001 if extent > 1000 else 1.0
        unit = "millimetres" if scale < 1 else "metres"
        across = f"{extent * scale:.0f} m across"
        doubts.append(f"the drawing names no unit; taken as {unit} ({across}); --resolution says otherwise")
    walls = [line * scale for line in walls]
    if not all(np.abs(line).max() <= 1e6 for line in walls):
        raise source.fault("has places farther than 1,000 km away; is the unit right? (--resolution: metres per unit)")
    return plan_of_lines(source, source.path.stem, walls, doubts=doubts)


def _drawing(source: Source) -> Any:
    try:
        import ezdxf
    except ImportError as error:
        raise missing("ezdxf", "dxf", "reading a DXF drawing") from error
    logging.getLogger("ezdxf").setLevel(logging.CRITICAL)  # what is wrong is said in our one line
    if source.head.startswith(b"AutoCAD Binary DXF"):
        raise source.fault("is a binary DXF; save it as text (ASCII) DXF")
    try:
        return ezdxf.read(io.StringIO(source.text.replace("\r\n", "\n")))
    except Exception as error:  # ezdxf raises all sorts on damaged files
        raise source.fault(f"damaged DXF ({type(error).__name__}: {' '.join(str(error).split()):.80})") from error


def _lines(source: Source, drawing: Any) -> list[tuple[str, NDArray[np.float64]]]:
    """The layer and the points of every line and curve, blocks taken apart."""
    from ezdxf.disassemble import recursive_decompose, to_primitives

    found: list[tuple[str, NDArray[np.float64]]] = []
    step = CURVE_STEP_M / (source.resolution_m or 1.0)
    try:
        for primitive in to_primitives(recursive_decompose(drawing.modelspace()), max_flattening_distance=step):
            if primitive.entity.dxftype() in _NOT_LINES:
                continue
            points = np.array([(v.x, v.y) for v in primitive.vertices()], float).reshape(-1, 2)
            if len(points) > 1 and np.isfinite(points).all():
                found.append((str(primitive.entity.dxf.layer), points))
            if len(found) > MOST_LINES:
                raise source.fault(f"has more than {MOST_LINES:,} lines; save the walls alone")
    except TaskliftError:
        raise
    except Exception as error:
        raise source.fault(f"damaged DXF ({type(error).__name__}: {' '.join(str(error).split()):.80})") from error
    return found
