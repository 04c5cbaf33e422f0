"""Replay documents: traces of trials as JSON, small enough to send by mail.

A document holds one building and one or more traces of it, which the page plays side by side. Arrays are
deflated and in base64, in time order per robot and as differences from step to step. What follows from the rest is
left out: the page groups teams, pools maps, follows the weights from their start through every decision and
loss, and so finds the probabilities of any draw.

Shapes: ``F`` frames (steps + 1), ``R`` robots, ``N`` nodes, ``E`` edges, ``S`` inputs, ``A`` outputs.
"""

from __future__ import annotations

import base64
import dataclasses
import os
import zlib
from collections.abc import Mapping, Sequence
from html import escape
from importlib import import_module
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

import tasklift
from tasklift.building.graph import CLASS_NAMES, KIND_NAMES, ROOM, Building
from tasklift.checks import check_fields
from tasklift.errors import TaskliftError
from tasklift.files import check_document, parse_json, read_text
from tasklift.plans.floor import picture
from tasklift.text import shown

if TYPE_CHECKING:
    from tasklift.building.simulator import Trace
    from tasklift.tasks.task import Task
    from tasklift.tasks.variable import Variable

FORMAT, VERSION = "tasklift-replay", 1

#: Outputs and signals beyond this would make a file that nobody waits for
_LARGEST_TABLE = 1_000_000


class Replay(dict[str, Any]):
    """A replay document; in a notebook it plays."""

    def _repr_html_(self) -> str:
        page = import_module("tasklift.watch.html").page  # by name, since the page imports this module
        return f'<iframe srcdoc="{escape(page(self))}" width="100%" height="640" title="Replay"></iframe>'

    def __repr__(self) -> str:
        return f"Replay({shown(self.get('title'))}: {len(self.get('traces', ()))} episodes)"


def replay(traces: Sequence[tuple[str, Trace]], title: str, about: Mapping[str, str] | None = None) -> Replay:
    """Return a replay document, JSON values only. In a notebook it plays.

    Parameters
    ----------
    traces
        Labels and traces, in the order in which they stand side by side. All of one building and one team.
    title
        For people.
    about
        By label: what the method is, in a few words; shown below the label.

    Raises
    ------
    TaskliftError
        If the traces have different buildings or teams, or there are none.
    """
    if not traces:
        raise TaskliftError("replay: expected at least one trace, found none")
    mission = traces[0][1].mission
    for label, trace in traces:
        if trace.mission.building != mission.building or trace.mission.team != mission.team:
            raise TaskliftError(
                f"replay: {label!r} has another building or team than {traces[0][0]!r}; watch them one by one"
            )
    tasks: list[Task] = []
    for _, trace in traces:
        if trace.task not in tasks:
            tasks.append(trace.task)
    return Replay(
        format=FORMAT,
        version=VERSION,
        made_by=f"tasklift {tasklift.__version__}",
        title=title,
        building=_building(mission.building),
        kinds=[{"name": k.name, "armed": k.armed, "number": n} for k, n in mission.team.items()],
        tasks=[_task(task) for task in tasks],
        traces=[
            _trace(label, trace, tasks.index(trace.task)) | {"meaning": (about or {}).get(label, "")}
            for label, trace in traces
        ],
    )


def read(path: str | os.PathLike[str]) -> dict[str, Any]:
    """Read a replay document. The page checks the rest when it opens it, and says what is wrong."""
    return checked(parse_json(read_text(path), str(path)), str(path))


def checked(document: Any, where: str) -> dict[str, Any]:
    """Return a parsed document if it is a replay with the fields it has; errors name ``where``."""
    check_document(document, where, FORMAT, VERSION)
    parts = {"building": dict, "kinds": list, "tasks": list, "traces": list}
    return check_fields(document, where, {"format": str, "version": int, "made_by": str, "title": str} | parts)


# --- the parts ------------------------------------------------------------------------------------------------


def _building(building: Building) -> dict[str, Any]:
    """The graph, and the plan that it was found in, or else a sketch of its floor as polygons (m)."""
    from tasklift.building.draw import footprints
    from tasklift.building.simulator import edge_cost_mm

    rooms = footprints(building)
    plan = picture(building)
    return {
        "name": building.name,
        "start": building.start,
        "kind_names": list(KIND_NAMES),
        "class_names": {str(value): name for value, name in CLASS_NAMES.items()},
        "kind": building.kind.tolist(),
        "class": building.feature_class.tolist(),
        "position_m": building.position_m.round(3).tolist(),
        "area_m2": building.area_m2.round(2).tolist(),
        "edges": building.edges.tolist(),
        "course_m": [course.round(2).tolist() for course in building.course_m],
        "length_m": building.length_m.round(3).tolist(),
        "cost_mm": edge_cost_mm(building.length_m, building.width_m).tolist(),
        "width_m": building.width_m.round(3).tolist(),
        "outline_m": building.outline_m.round(2).tolist(),
        "rooms": {str(room): _lines(shape.exterior)[0] for room, shape in rooms.items()},
        "plan": None if plan is None else {"href": plan[0], "corners": plan[1]},
    } | (_sketch(building, rooms) if plan is None else {"corridors": [], "walls": []})


def _sketch(building: Building, rooms: dict[int, Any]) -> dict[str, Any]:
    """Corridors and walls, as corridors of their width and these rooms make them."""
    import shapely

    from tasklift.building.draw import corridor_floor

    corridors = corridor_floor(building)
    floor = shapely.union_all([corridors, *rooms.values()])
    everywhere = shapely.union_all(list(rooms.values()))
    walls = [floor.boundary]
    # a room's wall stops where a corridor enters, and where another room covers it
    doorways = corridors.buffer(1e-6)
    walls += [room.exterior.intersection(everywhere.boundary).difference(doorways) for room in rooms.values()]
    return {"corridors": _lines(corridors.boundary), "walls": [line for wall in walls for line in _lines(wall)]}


def _lines(shape: Any) -> list[list[list[float]]]:
    """The polylines of a shapely geometry of lines; the boundary of nothing is None."""
    if shape is None:
        return []
    return [np.asarray(line.coords).round(2).tolist() for line in getattr(shape, "geoms", [shape]) if not line.is_empty]


def _task(task: Task) -> dict[str, Any]:
    root = task.root
    return {
        "name": task.name,
        "inputs": [_variable(v) for v in root.inputs],
        "outputs": [_variable(v) for v in root.outputs],
        "columns": _pack(task.output_map, np.int32),
        "signals": [
            {"value": s.value, "name": s.name, "where": _pack(np.flatnonzero(task.where(s.when)), np.int32)}
            for s in task.signals
        ],
    }


def _variable(variable: Variable) -> dict[str, Any]:
    return {
        "name": variable.name,
        "meaning": variable.meaning,
        "values": [str(value) for value in variable.values],
        "labels": list(variable.labels or ()),
    }


def _trace(label: str, trace: Trace, task: int) -> dict[str, Any]:
    mission, learner = trace.mission, trace.learner
    if trace.weights.size > _LARGEST_TABLE:
        raise TaskliftError(f"replay: {label!r} has {trace.weights.size} weights; expected at most {_LARGEST_TABLE}")
    robots = trace.robots
    before = robots["alive"][:-1] == 1
    decided = before & (robots["since"][1:] == robots["alive"][1:])  # the dead count no further step
    rooms = np.flatnonzero(mission.building.kind == ROOM)
    died = np.where(robots["alive"][-1] == 1, -1, robots["alive"].sum(axis=0))
    packed = {
        "weights": _pack(trace.weights, np.float64),
        "signal": _pack(learner.signal, np.float64),
        "died": _pack(died, np.int32),
        "place": _pack(_places(trace).T, np.int32, steps=True),
        "progress": _pack(robots["progress"].T, np.int32, steps=True),
        "danger": _pack(robots["dl"].T, np.int8, steps=True),
        "about": _pack(robots["alert"].T, np.int32, steps=True),
        "input": _pack(robots["row"].T, np.int32, steps=True),
        "pair": _pack((robots["pair_row"] * trace.task.shape[1] + robots["out"]).T, np.int32, steps=True),
        "decided": _pack(np.pad(_draws(trace, decided), ((1, 0), (0, 0))).T, np.int8),
        "engaged": _pack(_engaged(trace).T, np.int8),
        "held": _pack(robots["repelled"].T, np.int8),
        "visited": _pack(_first(trace.visited), np.int32),
        "resolved": _pack(_first(trace.resolved), np.int32),
        "unsearched": _pack(trace.unsearched[:, rooms].T, np.int32, steps=True),
        "messages": _pack(trace.messages[None], np.int32, steps=True),
        "losses": _pack(trace.losses[None], np.int32, steps=True),
    }
    return {
        "label": label,
        "task": task,
        "seed": str(trace.seed),  # beyond 2^53 a browser's numbers are not exact
        "trial": trace.trial + 1,
        "success": trace.success,
        "frames": trace.steps + 1,
        "limit": mission.limit,
        "weapons_needed": mission.weapons_needed,
        "reading": dataclasses.asdict(mission.reading),
        "hostiles": _hostiles(trace),
        "failed": np.argwhere(trace.failed).tolist(),
        "learner": {
            "learns": bool(learner.learn and not learner.sweep_all),
            "greedy": learner.greedy,
            "floor": learner.floor,
            "once": bool(learner.once),
            "loss_signal": learner.loss_signal,
        },
        "arrays": packed,
    }


def _places(trace: Trace) -> NDArray[np.int64]:
    """``(F, R)``: a node, or N + 2 × edge under way to the edge's higher node, one more the other way."""
    building, robots = trace.mission.building, trace.robots
    origin = np.repeat(np.arange(building.n_nodes), np.diff(building.indptr))
    corridor = building.n_nodes + 2 * building.edge_of + (origin > building.neighbour)
    return np.where(robots["half"] < 0, robots["node"], corridor[robots["half"]])


def _draws(trace: Trace, decided: NDArray[np.bool_]) -> NDArray[np.int8]:
    """``(F - 1, R)``: 1 where a robot drew an output, 2 where it took over the one its team's first robot drew."""
    if trace.mission.reading.decide != "team":
        return decided.astype(np.int8)
    robots = trace.robots
    draws = np.zeros(decided.shape, np.int8)
    for frame in range(len(draws)):
        living = np.flatnonzero(robots["alive"][frame] == 1)
        _, first = np.unique(robots["team"][frame, living], return_index=True)
        draws[frame, living] = 2
        draws[frame, living[first]] = 1
    return np.where(decided, draws, 0).astype(np.int8)


def _engaged(trace: Trace) -> NDArray[np.bool_]:
    """``(F, R)``: who took part in a failed attack in this step (rule 10)."""
    robots = trace.robots
    found = np.zeros(robots.shape, bool)
    there = (robots["alive"][:-1] == 1) & (robots["half"][:-1] < 0)
    if trace.mission.reading.engage == "crossing":
        there &= robots["crossing"][1:] == 1
    found[1:] = there & np.take_along_axis(trace.failed[1:], robots["node"][:-1], axis=1)
    return found


def _hostiles(trace: Trace) -> list[list[int]]:
    """Node and the frame in which it was destroyed, or -1, of every hostile."""
    nodes = np.flatnonzero(trace.hostile[0])
    return [[int(node), int(frame)] for node, frame in zip(nodes, _first(~trace.hostile[:, nodes]), strict=True)]


def _first(flags: NDArray[np.bool_]) -> NDArray[np.int64]:
    """The first frame in which each column of ``(F, n)`` is true, or -1."""
    return np.where(flags.any(axis=0), flags.argmax(axis=0), -1)


def _pack(values: NDArray[Any], dtype: Any, steps: bool = False) -> dict[str, Any]:
    """Little-endian bytes, deflated, in base64; with ``steps`` as differences along the last axis."""
    array = np.asarray(values, dtype)
    data = np.diff(array, axis=-1, prepend=array.dtype.type(0)) if steps else array
    raw = np.ascontiguousarray(data, data.dtype.newbyteorder("<")).tobytes()
    return {
        "type": array.dtype.name,
        "shape": list(array.shape),
        "steps": steps,
        "data": base64.b64encode(zlib.compress(raw, 9)).decode(),
    }
