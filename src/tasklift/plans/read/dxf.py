"""DXF drawings, by layers, with ezdxf: walls are drawn, and opened where doors are.

Layers and blocks are recognised by their names in a few languages. Without a layer of walls, all lines are walls but
those on layers of doors, furniture, dimensions, text and the like. A quarter circle is the arc of a door, on any layer.
"""

from __future__ import annotations

import io
import logging
import re
from collections.abc import Iterator
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from tasklift.errors import TaskliftError, missing
from tasklift.plans.lines import Points, plan_of_lines
from tasklift.plans.plan import Plan
from tasklift.plans.source import Source
from tasklift.plans.swings import openings
from tasklift.text import shown

TITLE = "DXF drawing (.dxf), with the extra [dxf]; --resolution: metres per unit, --level: the layers of walls"
MOST_LINES = 100_000
CURVE_STEP_M = 0.02
# Floor is closed if gaps up to twice this let nobody in; it is looked for in cells of this size.
GAP_M = 0.7
CELL_M = 0.2
_NOT_LINES = ("TEXT", "MTEXT", "ATTRIB", "HATCH", "POINT", "IMAGE", "DIMENSION", "MESH")
# $INSUNITS: metres per unit
_UNITS = {1: 0.0254, 2: 0.3048, 4: 0.001, 5: 0.01, 6: 1.0, 10: 0.9144, 14: 0.1}
_WALLS = re.compile(
    r"wall|wand|wände|mauer|mur|parete|muro|pared|parede|стен|墙|partition|column|stütze|glaz|window|fenster"
)
_DOORS = re.compile(r"door|tür|tuer|porte|porta|puerta|двер|门|swing|leaf")
_OTHER = re.compile(
    r"furn|möbel|moebel|mobil|equip|dim|mass|text|anno|hatch|schraff|patt|grid|axis|achse|title|border|defpoints|sanit|"
    r"stair|elec|plumb|hvac|symbol|note|logo|viewport"
)


@dataclass(frozen=True, eq=False)
class _Line:
    """A line or curve: its points, layer, the names of the blocks that it is in, and a number for the outermost."""

    points: Points
    layer: str
    blocks: str
    insert: int

    def is_of(self, names: re.Pattern[str]) -> bool:
        return names.search(self.layer.lower()) is not None or names.search(self.blocks) is not None


def recognises(source: Source) -> bool:
    """Whether it begins with a section in DXF's pairs of lines, or is its binary form."""
    head = source.head.removeprefix(b"\xef\xbb\xbf")
    begins = re.match(rb"\s*(999\s*\r?\n[^\n]*\n\s*)*0\s*\r?\n\s*SECTION", head)
    return begins is not None or head.startswith(b"AutoCAD Binary DXF")


def read(source: Source) -> Plan:
    """Draw the walls, open at the doors.

    Raises
    ------
    TaskliftError
        If the drawing is damaged, too large, or its walls close no floor.
    """
    drawing = _drawing(source)
    scale = source.resolution_m or _UNITS.get(int(drawing.header.get("$INSUNITS", 0) or 0))
    lines = _lines(source, drawing, CURVE_STEP_M / (scale or 1.0))
    doubts: list[str] = []
    walls = _walls(source, lines, doubts)
    layers = sorted({line.layer for line in walls})
    if scale is None:
        extent = float(np.ptp(np.concatenate([line.points for line in walls]), axis=0).max())
        scale = 0.001 if extent > 1000 else 1.0
        unit = "millimetres" if scale < 1 else "metres"
        across = f"{extent * scale:.0f} m across"
        doubts.append(f"the drawing names no unit; taken as {unit} ({across}); --resolution says otherwise")
    if not all(np.abs(line.points).max() * scale <= 1e6 for line in walls):
        raise source.fault("has places farther than 1,000 km away; is the unit right? (--resolution: metres per unit)")
    doors: dict[int, list[Points]] = {}
    for i, line in enumerate(lines):
        if line.is_of(_DOORS) and np.abs(line.points).max() * scale <= 1e6:
            doors.setdefault(line.insert or -i, []).append(line.points * scale)
    kept, doors_m = openings([line.points * scale for line in walls], list(doors.values()))
    plan = plan_of_lines(source, source.path.stem, kept, openings=doors_m, doubts=doubts)
    if not _closes_floor(plan):
        listed, others = (", ".join(map(shown, names[:8])) for names in (layers, sorted({x.layer for x in lines})))
        raise source.fault(
            f"is a DXF drawing whose lines on {listed:.60} close no floor; name the layers of walls with --level "
            f"(it has {others:.100}), or the metres per unit with --resolution"
        )
    return plan


def _walls(source: Source, lines: list[_Line], doubts: list[str]) -> list[_Line]:
    """The lines on layers of walls: those that the user names, those whose names say so, or all that may be."""
    layers = sorted({line.layer for line in lines})
    if source.level is not None:
        asked = {name.strip().lower() for name in source.level.split(",")}
        found = [line for line in lines if line.layer.lower() in asked]
        unknown = asked - {line.layer.lower() for line in found}
        if unknown:
            listed = ", ".join(map(shown, layers[:8]))
            raise source.fault(f"has no lines on layer {shown(min(unknown)):.60}; its layers are {listed:.120}")
        return found
    found = [x for x in lines if _WALLS.search(x.layer.lower()) and not x.is_of(_DOORS) and not x.is_of(_OTHER)]
    if not found:
        found = [line for line in lines if not line.is_of(_DOORS) and not line.is_of(_OTHER)]
        listed = ", ".join(map(shown, sorted({line.layer for line in found})[:5]))
        doubts.append(f"no layer is named like walls; took all lines on {listed:.120} for walls")
    if not found:
        raise source.fault(f"has no lines that could be walls; its layers are {', '.join(map(shown, layers[:8])):.160}")
    return found


def _closes_floor(plan: Plan) -> bool:
    """Whether walls close any floor, but for gaps as wide as doors."""
    from scipy import ndimage

    factor = max(1, round(CELL_M / plan.resolution_m))
    height, width = (size // factor * factor for size in plan.free.shape)
    free = plan.free[:height, :width].reshape(height // factor, factor, width // factor, factor).all(axis=(1, 3))
    away = np.asarray(ndimage.distance_transform_edt(np.pad(free, 1, constant_values=True)))
    label, n = ndimage.label(away > GAP_M / CELL_M)
    outside = np.concatenate([label[0], label[-1], label[:, 0], label[:, -1]])
    return len(set(range(1, n + 1)) - set(outside.tolist())) > 0


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


def _lines(source: Source, drawing: Any, step: float) -> list[_Line]:
    """Every line and curve that shows, blocks taken apart."""
    from ezdxf.disassemble import recursive_decompose

    found: list[_Line] = []
    try:
        hidden = {x.dxf.name.lower() for x in drawing.layers if x.is_off() or x.is_frozen()}
        for entity in recursive_decompose(drawing.modelspace()):
            layer, blocks, insert = str(entity.dxf.layer), "", 0
            block = entity.source_block_reference
            while block is not None:
                layer = str(block.dxf.layer) if layer == "0" else layer
                blocks += f" {str(block.dxf.name).lower()}"
                insert, block = id(block), block.source_block_reference
            if layer.lower() not in hidden:
                shape = _Line(np.zeros((0, 2)), layer, blocks, insert)
                found += [replace(shape, points=points) for points in _points(entity, step)]
            if len(found) > MOST_LINES:
                raise source.fault(f"has more than {MOST_LINES:,} lines; save the walls alone")
    except TaskliftError:
        raise
    except Exception as error:
        raise source.fault(f"damaged DXF ({type(error).__name__}: {' '.join(str(error).split()):.80})") from error
    return found


def _points(entity: Any, step: float) -> Iterator[Points]:
    """The points of an entity's lines; a polyline with arcs is several."""
    from ezdxf.disassemble import make_primitive

    if entity.dxftype() in _NOT_LINES:
        return
    if getattr(entity, "has_arc", False):
        for part in entity.virtual_entities():
            yield from _points(part, step)
        return
    points = np.array([(v.x, v.y) for v in make_primitive(entity, max_flattening_distance=step).vertices()], float)
    points = points.reshape(-1, 2)
    if len(points) > 1 and np.isfinite(points).all():
        yield points
