"""From a floor plan to a building: rooms, doors, junctions and bends, and the corridors between them.

Rooms and doors come from dividing the free space at its narrow places (:mod:`tasklift.plans.extract.segment`),
corridors from the skeleton of what is no room.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from tasklift.building.graph import BEND, CORNER, DOOR, FEATURE, INTERSECTION, NONE, OTHER, ROOM, Building
from tasklift.errors import TaskliftError
from tasklift.plans.extract.axes import centre_nodes, is_chamfer, is_spike, turn_before_door
from tasklift.plans.extract.paths import Node, PathGraph, Points, line_length, simplify, straight, trace
from tasklift.plans.extract.segment import Opening, Regions, divide, jambs
from tasklift.plans.extract.space import Settings, Space, clean, fill_islands
from tasklift.plans.read.ros import Plan

CORNER_DEGREES = 65.0
NEAR_DOOR_M = 0.4
SHORTEST_RING_M = 1.2
LONE_SPECKLE_M = 0.2
DOOR_TOLERANCE_M = 0.75
BEND_TOLERANCE_M = 0.6
TURN_M = 2.0  # how far from a bend its two corridors show how it turns
SAME_M = 0.6  # junctions whose corridors' axes cross so near to each other are one


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
    space = clean(plan, settings, seeds)
    say("dividing at the narrow places")
    region, openings, measure, is_room = divide(space, settings)
    if not openings:
        # one space without doors: what stands in it is all the structure there is
        settings = replace(settings, speckle_m=LONE_SPECKLE_M, furniture_m=0.0)
        space = clean(plan, settings, seeds)
        region, openings, measure, is_room = divide(space, settings)
        space.doubts.append("one space without doors: every obstacle in it was gone around")
    if plan.doors_m is not None:
        openings = _declared_doors(plan, space, region, openings)
    region, openings, left_out = _without_closets(region, openings, measure, is_room, settings)
    say("tracing the corridors")
    graph = _draw(space, settings, region, openings, is_room)
    centre_nodes(graph, space, ("path",))
    _join_same(graph, space)
    _drop_spikes(graph, space, settings)
    _name_bends(graph, space, settings)
    centre_nodes(graph, space, ("bend", "corner"))
    _no_parallels(graph)
    say("building the graph")
    return _to_building(plan, space, graph, region, measure, start, left_out)


def _declared_doors(plan: Plan, space: Space, region: NDArray[np.int32], openings: list[Opening]) -> list[Opening]:
    """Exactly the doors that the plan declares are doors; each lies where the plan has it."""
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
    return openings


def _stands_across(space: Space, pixel: tuple[int, int], ends: Points) -> bool:
    """Whether a door with these ends (cells) lies along the shortest line across the floor at its middle."""
    found = jambs(space.free, pixel, float(space.half_width_m[pixel]) / space.cell_m)
    if found is None:
        return False
    line, door = np.subtract(found[1], found[0]), ends[1] - ends[0]
    length, width = float(np.hypot(*line)), float(np.hypot(*door))
    return length < 1.6 * width + 4 and abs(float(line @ door)) > 0.8 * length * width


def _without_closets(
    region: NDArray[np.int32],
    openings: list[Opening],
    measure: Regions,
    is_room: NDArray[np.bool_],
    settings: Settings,
) -> tuple[NDArray[np.int32], list[Opening], int]:
    """Leave out what is too small for a room, leads nowhere, and is no corridor."""
    closet = (measure.exits == 1) & ~is_room & (measure.area_m2 < settings.smallest_room_m2)
    closet &= measure.elongation < 3
    if closet.sum() + 1 >= len(closet):
        return region, openings, 0
    kept = [o for o in openings if not closet[list(o.regions)].any()]
    return np.where(closet[region], 0, region).astype(np.int32), kept, int(closet.sum())


def _draw(
    space: Space,
    settings: Settings,
    region: NDArray[np.int32],
    openings: list[Opening],
    is_room: NDArray[np.bool_],
) -> PathGraph:
    """The lines of the whole building: one graph for every region, tied together at the openings."""
    from scipy import ndimage

    # corridors that run into each other without a door are one: their skeleton should not break there
    root = np.arange(len(is_room), dtype=np.int32)
    for opening in openings:
        a, b = (int(root[r]) for r in opening.regions)
        if not opening.is_door and not is_room[a] and not is_room[b]:
            root[root == max(a, b)] = min(a, b)
    region = root[region]
    ties: list[tuple[Opening, list[tuple[int, tuple[int, int]]]]] = []
    barred = np.zeros(region.shape, bool)
    for opening in openings:
        a, b = (int(root[r]) for r in opening.regions)
        if a != b:
            ties.append((opening, [(a, opening.pixel), (b, opening.pixel)]))
        elif opening.is_door and not is_room[a]:
            # a corridor leads around to the door's other side: bar it, so that the skeleton ends on either side
            beside = _bar(barred, space, opening)
            if beside is not None:
                ties.append((opening, [(a, side) for side in beside]))
    region[barred] = 0

    whole = PathGraph()
    of_region: dict[int, list[tuple[int, tuple[int, int]]]] = {}
    for opening, sides in ties:
        row, column = opening.pixel
        role = "door" if opening.is_door else "path"
        half = float(space.half_width_m[row, column])
        across = jambs(space.free, opening.pixel, half / space.cell_m)
        node = whole.add_node(Node((float(row), float(column)), half, role, 0, across))
        for number, point in sides:
            of_region.setdefault(number, []).append((node, point))
    for number, box in enumerate(ndimage.find_objects(region), start=1):
        if box is None:
            continue
        mine = of_region.get(number, [])
        # a door that the plan declares may lie beside its region
        cells = np.array([point for _, point in mine] or [(box[0].start, box[1].start)])
        low, high = cells.min(axis=0).tolist(), cells.max(axis=0).tolist()
        box = tuple(
            slice(max(0, min(s.start, first) - 1), max(s.stop, last + 1) + 1)
            for s, first, last in zip(box, low, high, strict=True)
        )
        mask = region[box] == number
        corner = box[0].start, box[1].start
        points = [(point[0] - corner[0], point[1] - corner[1]) for _, point in mine]
        part, ends = _draw_region(
            space, settings, mask, space.half_width_m[box], points, bool(is_room[number]), number, corner
        )
        _tie(whole, part, ends, [node for node, _ in mine])
    _simplify(whole, space, settings, is_room)
    return whole


def _bar(barred: NDArray[np.bool_], space: Space, opening: Opening) -> tuple[tuple[int, int], tuple[int, int]] | None:
    """Draw a bar across a door; returns a cell on either side of it, or ``None`` if that does not work out."""
    ends = jambs(space.free, opening.pixel, opening.width_m / 2 / space.cell_m)
    if ends is None:
        return None
    line = straight(*(np.array(end) for end in ends))
    across = np.subtract(ends[1], ends[0]) / np.hypot(*np.subtract(ends[1], ends[0]))
    sides = []
    for sign in (-1, 1):
        row, column = np.rint(opening.pixel + sign * 3 * np.array([-across[1], across[0]])).astype(int).tolist()
        if not space.free[row, column]:
            return None
        sides.append((row, column))
    for row, column in ((0, 0), (0, 1), (1, 0), (0, -1), (-1, 0)):
        barred[tuple((line + np.array([row, column])).clip(0, np.array(barred.shape) - 1).T)] = True
    return sides[0], sides[1]


def _draw_region(
    space: Space,
    settings: Settings,
    mask: NDArray[np.bool_],
    half: NDArray[np.float32],
    points: list[tuple[int, int]],
    is_room: bool,
    number: int,
    corner: tuple[int, int],
) -> tuple[PathGraph, list[tuple[int, Points]]]:
    """The lines within one region, and for each of its openings the node and the line that leads there."""
    if is_room:
        centre = _centre(mask, half)
        if _star_serves(np.array(points, float).reshape(-1, 2), np.array(centre, float), space.cell_m):
            graph = PathGraph()
            room = graph.add_node(
                Node((float(centre[0] + corner[0]), float(centre[1] + corner[1])), float(half[centre]), "room", number)
            )
            target = np.zeros_like(mask)
            target[centre] = True
            lead = _Leads(mask, target)
            lines = [lead(point) + np.array(corner, float) for point in points]
            return graph, [(room, line) for line in lines]
    from skimage.morphology import skeletonize

    # what another region left of a cell or two would be a ring in the skeleton
    mask = mask | fill_islands(mask, settings.furniture_m / space.cell_m)
    pixels = skeletonize(mask)
    graph = trace(pixels, half, owner=number)
    graph.prune(_reaches_out(space, settings))
    kept = _pixels(graph, mask.shape)
    lead = _Leads(mask, kept)
    leads = [lead(point) for point in [*points, *([centre] if is_room else [])]]
    graph = trace(kept, half, {(int(line[-1][0]), int(line[-1][1])) for line in leads}, corner, number)
    where = {node.at: number for number, node in graph.nodes.items()}
    ends = []
    for line in leads:
        line = line + np.array(corner, float)
        ends.append((where[float(line[-1][0]), float(line[-1][1])], line))
    if is_room:
        at, line = ends.pop()
        node = graph.nodes[at]
        if len(line) == 1 and node.role == "path":
            node.role = "room"
        else:
            room = graph.add_node(Node((float(line[0][0]), float(line[0][1])), float(half[centre]), "room", number))
            graph.add_edge(at, room, line[::-1])
    return graph, ends


def _centre(mask: NDArray[np.bool_], half: NDArray[np.float32]) -> tuple[int, int]:
    """The free cell nearest to the middle of a region, a step away from its walls where that is near."""
    cells = np.argwhere(mask)
    roomy = cells[half[mask] >= 0.5 * half[mask].max()]
    middle = cells.mean(axis=0)
    row, column = roomy[np.argmin(((roomy - middle) ** 2).sum(axis=1))].tolist()
    return row, column


def _star_serves(points: Points, centre: Points, cell_m: float) -> bool:
    """Whether ways through a room by its centre are hardly longer than the straight ones."""
    if len(points) < 2:
        return True
    radius = np.hypot(*(points - centre).T)
    straight = np.hypot(*(points[:, None] - points[None]).transpose(2, 0, 1))
    detour = radius[:, None] + radius[None] - straight
    np.fill_diagonal(detour, 0)
    return bool((detour * cell_m <= 1.0 + 0.5 * straight * cell_m).all())


class _Leads:
    """Finds the shortest lines of cells within ``mask`` to the nearest of the ``targets``."""

    def __init__(self, mask: NDArray[np.bool_], targets: NDArray[np.bool_]):
        from scipy.spatial import KDTree

        self.mask, self.targets = mask, targets
        self.cells = np.argwhere(targets)
        self.tree = KDTree(self.cells)

    def __call__(self, point: tuple[int, int]) -> Points:
        """The line from ``point``, which may be a cell outside the mask, to the target."""
        from skimage.graph import MCP_Geometric

        distance, nearest = self.tree.query(point)
        direct = straight(np.array(point), self.cells[nearest])
        if self.mask[tuple(direct[1:].T)].all():
            return direct.astype(float)
        reach = int(2 * distance) + 10
        while True:
            low = np.maximum(0, np.array(point) - reach)
            box = tuple(slice(int(s), int(p) + reach + 1) for s, p in zip(low, point, strict=True))
            cost = np.where(self.mask[box], 1.0, -1.0)
            start = tuple(int(v) for v in np.array(point) - low)
            cost[start] = 1.0
            ends = np.argwhere(self.targets[box])
            search = MCP_Geometric(cost)
            total, _ = search.find_costs([start], ends.tolist(), find_all_ends=False)
            costs = total[tuple(ends.T)]
            if np.isfinite(costs).any():
                return np.array(search.traceback(ends[int(np.argmin(costs))].tolist()), float) + low
            if cost.shape == self.mask.shape:
                return direct.astype(float)
            reach *= 2


def _reaches_out(
    space: Space, settings: Settings, is_room: NDArray[np.bool_] | None = None
) -> Callable[[float, Node, Node], bool]:
    """Whether a dangling branch reaches far enough beyond the walls of the space that it leaves.

    Within a room none does: the room's node stands for all of it.
    """

    def reaches_out(length: float, leaf: Node, stem: Node) -> bool:
        if is_room is not None and is_room[leaf.owner]:
            return False
        beyond = length * space.cell_m + leaf.half - stem.half
        return beyond >= max(settings.prune_m, 0.5 * stem.half)

    return reaches_out


def _pixels(graph: PathGraph, shape: tuple[int, ...]) -> NDArray[np.bool_]:
    pixels = np.zeros(shape, bool)
    for _, _, line in graph.edges.values():
        pixels[tuple(line.astype(int).T)] = True
    for node in graph.nodes.values():
        pixels[int(node.at[0]), int(node.at[1])] = True
    return pixels


def _tie(whole: PathGraph, part: PathGraph, ends: list[tuple[int, Points]], doors: list[int]) -> None:
    """Copy ``part`` into ``whole`` and join it to the openings."""
    number = {old: whole.add_node(node) for old, node in part.nodes.items()}
    for a, b, line in part.edges.values():
        whole.add_edge(number[a], number[b], line)
    for (node, line), door in zip(ends, doors, strict=True):
        at = np.array([whole.nodes[door].at])  # the line may begin beside the door
        whole.add_edge(door, number[node], line if (line[0] == at[0]).all() else np.concatenate([at, line]))


def _simplify(graph: PathGraph, space: Space, settings: Settings, is_room: NDArray[np.bool_]) -> None:
    def near(a: Node, b: Node) -> float:
        return max(settings.merge_m, settings.merge_share * max(a.half, b.half)) / space.cell_m

    reaches_out = _reaches_out(space, settings, is_room)
    graph.prune(reaches_out)
    graph.drop_rings(SHORTEST_RING_M / space.cell_m)
    graph.contract(near)
    graph.drop_rings(SHORTEST_RING_M / space.cell_m)
    graph.prune(reaches_out)


def _join_same(graph: PathGraph, space: Space) -> None:
    """Make one of junctions that came to lie at the same place."""
    for edge, (a, b, line) in graph.edges.items():
        if a != b and all(graph.nodes[end].role == "path" and graph.degree(end) >= 3 for end in (a, b)):
            pulled = _taut(line, space.free)
            if line_length(pulled) * space.cell_m < SAME_M:
                graph.edges[edge] = (a, b, pulled)
    graph.contract(lambda a, b: SAME_M / space.cell_m)


def _drop_spikes(graph: PathGraph, space: Space, settings: Settings) -> None:
    """Remove the dead ends in the sharp corners where two corridors meet; what is left there is a bend."""
    for node in [number for number, node in graph.nodes.items() if node.role == "path"]:
        if graph.degree(node) != 1:
            continue
        (edge,) = graph.incident[node]
        stem = graph.other(edge, node)
        if graph.nodes[stem].role == "path" and graph.degree(stem) == 3 and is_spike(graph.line(edge, node), space):
            graph.remove_node(node)
            ways = [graph.line(other, stem) for other in sorted(graph.incident[stem])]
            if len(ways) == 2:
                before, after = (way[min(round(TURN_M / space.cell_m), len(way) - 1)] for way in ways)
                turn = _turn(before, np.array(graph.nodes[stem].at), after)
                graph.nodes[stem].role = _role(turn, settings) or "path"
    graph.dissolve()


def _role(turn: float, settings: Settings) -> str | None:
    """What a turn by so many degrees is, if it is anything."""
    if turn < settings.bend_degrees:
        return None
    return "corner" if turn >= CORNER_DEGREES else "bend"


def _name_bends(graph: PathGraph, space: Space, settings: Settings) -> None:
    """Put a node of role "bend" or "corner" wherever a corridor turns."""
    for door in [number for number, node in graph.nodes.items() if node.role == "door"]:
        for edge in sorted(graph.incident[door]):
            if graph.nodes[graph.other(edge, door)].role != "room":
                _bend_before(graph, edge, door, space, settings)
    for edge in list(graph.edges):
        line = graph.edges[edge][2]
        corners = _corners(line, space, settings)
        # the last first, so that what is still to be split keeps its indices
        for k in range(len(corners) - 2, 0, -1):
            turn = _turn(*(line[i] for i in corners[k - 1 : k + 2]))
            edge = _bend(graph, edge, corners[k], turn, space, settings)


def _bend_before(graph: PathGraph, edge: int, door: int, space: Space, settings: Settings) -> None:
    """Put a bend where a corridor turns right before a door."""
    line = graph.line(edge, door)
    found = turn_before_door(graph.nodes[door], line, space)
    if found is None:
        return
    at, turn = found
    away = np.hypot(*(line - at).T)
    index = int(away.argmin())
    half = float(space.half_width_m[tuple(np.rint(at).astype(int))])
    if away[index] * space.cell_m <= max(1.0, 2 * half):
        from_start = index if door == graph.edges[edge][0] else len(line) - 1 - index
        _bend(graph, edge, from_start, float(np.degrees(turn)), space, settings)


def _bend(graph: PathGraph, edge: int, index: int, turn: float, space: Space, settings: Settings) -> int:
    """Put a bend at a point of an edge's line, if it turns enough (degrees), and not close to either end.

    Returns the edge up to there.
    """
    a, b, line = graph.edges[edge]
    here = line[index]
    half = float(space.half_width_m[tuple(np.rint(here).astype(int))])
    for end in (a, b):
        apart = np.hypot(*(here - graph.nodes[end].at)) * space.cell_m
        if apart < (max(settings.merge_m, half) if graph.nodes[end].role == "path" else NEAR_DOOR_M):
            return edge
    role = _role(turn, settings)
    if role is None:
        return edge
    node = graph.split(edge, index, Node((float(here[0]), float(here[1])), half, role))
    return min(graph.incident[node])  # splitting numbers the first part before the second


def _corners(line: Points, space: Space, settings: Settings) -> list[int]:
    """Indices of the points where a line turns; two close together in one turn are one, between them."""
    corners = simplify(line, BEND_TOLERANCE_M / space.cell_m).tolist()
    k = 1
    while k + 2 < len(corners):
        first, second = line[corners[k]], line[corners[k + 1]]
        half = float(space.half_width_m[tuple(int(v) for v in np.rint(first))])
        short = np.hypot(*(second - first)) * space.cell_m < max(settings.merge_m, 1.8 * half)
        if short or is_chamfer(line[corners[k] : corners[k + 1] + 1], space):
            corners[k : k + 2] = [(corners[k] + corners[k + 1]) // 2]
        else:
            k += 1
    return corners


def _taut(line: Points, free: NDArray[np.bool_]) -> Points:
    """The points of ``line`` that remain when it is pulled straight, around the walls that it goes around."""
    from skimage.draw import polygon

    kept = simplify(line, 1.0).tolist()
    middle = len(kept) - 2
    while middle > 0:
        corners = np.rint(line[kept[middle - 1 : middle + 2]]).astype(np.int64)
        cut = straight(corners[0], corners[2]).T
        # not only the short cut itself: between it and the corner there may be a wall as well
        between = polygon(corners[:, 0], corners[:, 1], free.shape)
        if free[tuple(cut)].all() and free[between].all():
            del kept[middle]
            middle = min(middle, len(kept) - 2)
        else:
            middle -= 1
    return line[kept]


def _turn(before: Points, here: Points, after: Points) -> float:
    """The angle (degrees) by which a line turns at ``here``."""
    u, v = here - before, after - here
    return float(abs(np.degrees(np.arctan2(u[0] * v[1] - u[1] * v[0], u @ v))))


def _no_parallels(graph: PathGraph) -> None:
    """Put a node of role "other" into one of two corridors between the same nodes, and two into a ring."""
    seen: set[tuple[int, int]] = set()
    for edge in sorted(graph.edges):
        a, b, line = graph.edges[edge]
        pair = (min(a, b), max(a, b))
        if a == b:
            cuts = [2 * len(line) // 3, len(line) // 3]
        elif pair in seen:
            cuts = [len(line) // 2]
        else:
            cuts = []
        seen.add(pair)
        for cut in cuts:
            at = (float(line[cut][0]), float(line[cut][1]))
            node = graph.split(edge, cut, Node(at, 0.0, "other"))
            edge = min(graph.incident[node])  # the first part: splitting numbers it first


def _to_building(
    plan: Plan,
    space: Space,
    graph: PathGraph,
    region: NDArray[np.int32],
    measure: Regions,
    start: tuple[float, float] | int | None,
    left_out: int,
) -> tuple[Building, list[str]]:
    kinds = {"room": (ROOM, NONE), "path": (INTERSECTION, NONE), "door": (FEATURE, DOOR)}
    kinds |= {"bend": (FEATURE, BEND), "corner": (FEATURE, CORNER), "other": (FEATURE, OTHER)}
    if len(graph.nodes) < 2:
        raise TaskliftError(
            f"{plan.name}: the free space is a single room without doors; a building needs two nodes at least"
        )
    obstacles = _obstacles(space, region)
    order = sorted(graph.nodes, key=lambda n: (kinds[graph.nodes[n].role], graph.nodes[n].at))
    number = {node: i for i, node in enumerate(order)}
    nodes = [graph.nodes[n] for n in order]
    cells = np.array([node.at for node in nodes])
    position = np.round(plan.to_world(*space.to_plan(cells).T), 3)
    room = [node.owner if node.role == "room" else 0 for node in nodes]
    edges, lengths, widths = [], [], []
    for a, b, line in graph.edges.values():
        edges.append((number[a], number[b]))
        straight = _taut(line, space.free)
        lengths.append(max(round(line_length(straight) * space.cell_m, 3), space.cell_m))
        along = space.half_width_m[tuple(np.rint(line).astype(int).T)]
        widths.append(max(round(2 * float(np.median(along)), 3), 2 * space.cell_m))
    kind = np.array([kinds[node.role][0] for node in nodes], np.int8)
    building = Building(
        name=plan.name,
        kind=kind,
        feature_class=np.array([kinds[node.role][1] for node in nodes], np.int8),
        position_m=position,
        area_m2=np.round(measure.area_m2[room], 2) * (kind == ROOM),
        obstacles=obstacles[room] * (kind == ROOM),
        edges=np.array(edges, np.int64),
        length_m=np.array(lengths),
        width_m=np.array(widths),
        start=choose_start(plan.name, kind, position, start),
        provenance={"source": plan.name, "resolution_m": plan.resolution_m},
    )
    doubts = [*plan.doubts, *space.doubts]
    if left_out:
        doubts.append(f"{left_out} closets too small for a room were left out")
    return building, doubts


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
