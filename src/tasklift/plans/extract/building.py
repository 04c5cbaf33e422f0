"""From a floor plan to a building: rooms, doors, junctions and bends, and the corridors between them.

Rooms and doors come from dividing the free space at its narrow places (:mod:`tasklift.plans.extract.segment`),
corridors from the skeleton of the rest (:mod:`tasklift.plans.extract.corridors`).
"""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np
from numpy.typing import NDArray

from tasklift.building.graph import BEND, CORNER, DOOR, FEATURE, INTERSECTION, NONE, OTHER, ROOM, Building
from tasklift.errors import TaskliftError
from tasklift.plans.extract.axes import centre_nodes
from tasklift.plans.extract.bends import name_bends, part_parallels
from tasklift.plans.extract.corridors import draw_lines, drop_spikes, join_same, keep_joined
from tasklift.plans.extract.doubts import doubt, not_free
from tasklift.plans.extract.lengths import courses
from tasklift.plans.extract.outside import leave_out
from tasklift.plans.extract.paths import PathGraph, Points
from tasklift.plans.extract.regions import Opening, jambs
from tasklift.plans.extract.segment import Division, divide
from tasklift.plans.extract.space import Settings, Space, clean
from tasklift.plans.extract.strokes import without_door_leaves
from tasklift.plans.plan import Plan

DOOR_TOLERANCE_M = 0.75


def extract(
    plan: Plan,
    settings: Settings | None = None,
    *,
    seed_point: tuple[float, float] | None = None,
    start: tuple[float, float] | int | None = None,
    progress: Callable[[str], None] | None = None,
) -> tuple[Building, list[str]]:
    """Return the building that ``plan`` shows, and a list of doubts, a sentence each.

    Parameters
    ----------
    seed_point
        A point (m) inside the building, where the picture holds several.
    start
        Where the robots begin: a node id, or a point (m), of which the nearest room is taken. By default the
        room nearest to the bottom centre.
    """
    settings = settings or Settings()
    say = progress or (lambda _: None)
    say("cleaning the picture")
    points = plan.seeds_m if seed_point is None else np.array([seed_point], float)
    seeds = None if points is None else plan.to_pixels(points)
    try:
        space = clean(plan, settings, seeds)
    except TaskliftError as error:
        raise TaskliftError("; ".join([str(error), *not_free(plan), *plan.doubts])) from error
    plan, space = _opened(plan, space, seeds)
    say("dividing at the narrow places")
    division = divide(space)
    if not division.openings:
        # one space without doors: what stands in it is all the structure there is
        division = divide(clean(plan, settings, seeds, keep_islands=True), furnished=False)
        division.space.doubts.append("one space without doors: every obstacle in it was gone around")
    if plan.doors_m is not None:
        _declare_doors(division, plan)
    leave_out(division, plan)
    space = division.space
    say("tracing the corridors")
    graph = draw_lines(division)
    centre_nodes(graph, space, ("path",))
    join_same(graph, space)
    drop_spikes(graph, space)
    name_bends(graph, space)
    centre_nodes(graph, space, ("bend", "corner"))
    part_parallels(graph)
    lost = keep_joined(graph)
    if lost:
        space.doubts.append(f"{lost} nodes that no corridor joins to the others were left out")
    doubt(plan, division, graph)
    say("building the graph")
    return _to_building(plan, division, graph, start)


def _opened(plan: Plan, space: Space, seeds: Points | None) -> tuple[Plan, Space]:
    """The plan and its space without leaves and arcs of doors, if rooms are shut by them."""
    found = without_door_leaves(plan) if space.left_out_m2 >= space.settings.smallest_room_m2 else None
    if found is None:
        return plan, space
    opened, places = found
    wider = clean(opened, space.settings, seeds)
    grown = (wider.free.sum() - space.free.sum()) * space.cell_m**2
    if grown < space.settings.smallest_room_m2:
        return plan, space
    listed = ", ".join(f"({x:.1f}, {y:.1f})" for x, y in places[:5].tolist())
    wider.doubts.append(
        f"{len(places)} thin drawings were taken for leaves and arcs of doors, and opened: {listed}"
        f"{' …' if len(places) > 5 else ''} m"
    )
    return opened, wider


def _declare_doors(division: Division, plan: Plan) -> None:
    """Make doors of exactly those that the plan declares; each lies where the plan has it."""
    space, region, openings = division.space, division.region, division.openings
    doors = plan.doors_m
    assert doors is not None
    taken: set[int] = set()
    middles = space.to_cells(plan.to_pixels(doors.mean(axis=1)))
    for opening in openings:
        opening.is_door = False
    for (start, end), middle in zip(doors, middles, strict=True):
        away = [
            np.hypot(*(middle - o.pixel)) * space.cell_m if i not in taken else np.inf for i, o in enumerate(openings)
        ]
        row, column = (int(v) for v in np.rint(middle))
        inside = 0 <= row < region.shape[0] and 0 <= column < region.shape[1] and region[row, column] > 0
        width = float(np.hypot(*(end - start)))
        best = int(np.argmin(away)) if away else -1
        if best >= 0 and away[best] <= max(DOOR_TOLERANCE_M, width / 2):
            taken.add(best)
            pixel = (row, column) if inside else openings[best].pixel
            openings[best] = Opening(pixel, openings[best].regions, width, True)
        elif inside and _stands_across(space, (row, column), space.to_cells(plan.to_pixels(np.array([start, end])))):
            number = int(region[row, column])
            openings.append(Opening((row, column), (number, number), width, True))
            taken.add(len(openings) - 1)
        else:
            x, y = (start + end) / 2
            space.doubts.append(f"the door at ({x:.1f}, {y:.1f}) m does not part the floor; it was left out")


def _stands_across(space: Space, pixel: tuple[int, int], ends: Points) -> bool:
    """Whether a door with these ends (cells) lies along the shortest line across the floor at its middle."""
    found = jambs(space.free, pixel, float(space.half_width_m[pixel]) / space.cell_m)
    if found is None:
        return False
    line, door = np.subtract(found[1], found[0]), ends[1] - ends[0]
    length, width = float(np.hypot(*line)), float(np.hypot(*door))
    return length < 1.6 * width + 4 and abs(float(line @ door)) > 0.8 * length * width


def _to_building(
    plan: Plan,
    division: Division,
    graph: PathGraph,
    start: tuple[float, float] | int | None,
) -> tuple[Building, list[str]]:
    kinds = {"room": (ROOM, NONE), "path": (INTERSECTION, NONE), "door": (FEATURE, DOOR)}
    kinds |= {"bend": (FEATURE, BEND), "corner": (FEATURE, CORNER), "other": (FEATURE, OTHER)}
    if len(graph.nodes) < 2:
        raise TaskliftError(
            f"{plan.name}: the free space is a single room without doors; a building needs two nodes at least"
        )
    space = division.space
    obstacles = _obstacles(space, division.region)
    order = sorted(graph.nodes, key=lambda n: (kinds[graph.nodes[n].role], graph.nodes[n].at))
    number = {node: i for i, node in enumerate(order)}
    nodes = [graph.nodes[n] for n in order]
    cells = np.array([node.at for node in nodes])
    position = np.round(plan.to_world(*space.to_plan(cells).T), 3)
    room = [node.owner if node.role == "room" else 0 for node in nodes]
    edges, lengths, widths, ways = [], [], [], []
    found = courses(graph, space)
    for edge, (a, b, line) in graph.edges.items():
        edges.append((number[a], number[b]))
        lengths.append(max(round(found[edge].length * space.cell_m, 3), space.cell_m))
        ways.append(np.round(plan.to_world(*space.to_plan(found[edge].line[1:-1]).T), 3))
        along = space.half_width_m[tuple(np.rint(line).astype(int).T)]
        widths.append(max(round(2 * float(np.median(along)), 3), 2 * space.cell_m))
    kind = np.array([kinds[node.role][0] for node in nodes], np.int8)
    building = Building(
        name=plan.name,
        kind=kind,
        feature_class=np.array([kinds[node.role][1] for node in nodes], np.int8),
        position_m=position,
        area_m2=np.round(division.measure.area_m2[room], 2) * (kind == ROOM),
        obstacles=obstacles[room] * (kind == ROOM),
        edges=np.array(edges, np.int64),
        length_m=np.array(lengths),
        width_m=np.array(widths),
        start=choose_start(plan.name, kind, position, start),
        provenance={"source": plan.name, "resolution_m": plan.resolution_m} | _names(plan, division, room),
        course_m=tuple(ways),
    )
    doubts = [*plan.doubts, *space.doubts]
    return building, doubts


def _names(plan: Plan, division: Division, room: Sequence[int]) -> dict[str, dict[str, str]]:
    """What the plan calls the rooms, by node; ``room`` has the region of each node that is one, and 0 for others."""
    if not plan.names:
        return {}
    cells = np.floor(division.space.to_cells(plan.to_pixels(np.array([at for _, at in plan.names]))) + 0.5).astype(int)
    node_of = {region: node for node, region in enumerate(room) if region}
    found: dict[str, str] = {}
    for (row, column), (name, _) in zip(cells.tolist(), plan.names, strict=True):
        if 0 <= row < division.region.shape[0] and 0 <= column < division.region.shape[1]:
            region = int(division.region[row, column])
            found |= {str(node_of[region]): name} if region in node_of else {}
    return {"names": found}


def choose_start(name: str, kind: NDArray[np.int8], position: Points, start: tuple[float, float] | int | None) -> int:
    """The node where the robots begin: the one asked for, or the room nearest to a point.

    Without a point it is the bottom centre, as in the paper's Figure 3. Without rooms any node serves.
    """
    if isinstance(start, int):
        if not 0 <= start < len(kind):
            raise TaskliftError(f"{name}: start node {start} does not exist; nodes are 0 to {len(kind) - 1}")
        return start
    low, high = position.min(axis=0), position.max(axis=0)
    point = np.array([(low[0] + high[0]) / 2, low[1]]) if start is None else np.array(start, float)
    among = np.flatnonzero(kind == ROOM) if (kind == ROOM).any() else np.arange(len(kind))
    return int(among[np.argmin(np.hypot(*(position[among] - point).T))])


def _obstacles(space: Space, region: NDArray[np.int32]) -> NDArray[np.int64]:
    """How many obstacles stand in each region: islands closer to each other than half a metre count as one."""
    from scipy import ndimage

    n = int(region.max()) + 1
    near = ndimage.binary_dilation(space.filled, iterations=max(1, round(0.25 / space.cell_m)))
    label, count = ndimage.label(near & (region > 0), structure=np.ones((3, 3), bool))
    found = np.zeros(n, np.int64)
    if count:
        owner = np.zeros(count + 1, np.int64)
        owner[label.ravel()] = region.ravel()  # one of the regions that it touches, if it stands in a doorway
        found += np.bincount(owner[1:], minlength=n)
    return found
