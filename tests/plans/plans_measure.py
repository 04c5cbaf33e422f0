"""Measures of an extracted building against hand-made graphs, hand-marked labels, and what was drawn."""

from __future__ import annotations

import json
from dataclasses import dataclass, replace
from itertools import combinations
from pathlib import Path

import numpy as np
import pytest
from scipy.optimize import linear_sum_assignment
from scipy.sparse import coo_array
from scipy.sparse.csgraph import dijkstra

from tasklift.building.graph import BEND, CORNER, DOOR, INTERSECTION, ROOM, Building
from tasklift.plans.plan import Plan
from tasklift.plans.read import patrolling
from tasklift.plans.source import Source

MAPS = Path(__file__).parents[3] / "shared" / "maps"
LABELS = Path(__file__).parent / "data" / "willow_labels.json"
WITHIN_M = 1.5
PLAIN_M, FORK_M2, SIGHT_M = 0.3, 4.0, 20.0


def needs_maps() -> Path:
    """The folder of real maps; the test is skipped where it is not there."""
    if not MAPS.is_dir():
        pytest.skip(f"the real maps are not here ({MAPS})")
    return MAPS


def read_graph(path: Path, **options: object) -> Building:
    """A .graph file as a building."""
    return patrolling.read(Source(path)).building(**options)


def match(a: np.ndarray, b: np.ndarray, within_m: float = WITHIN_M) -> tuple[np.ndarray, np.ndarray]:
    """As many one-to-one pairs of points within a distance as there can be; indices into ``a`` and ``b``."""
    if not len(a) or not len(b):
        return np.zeros(0, int), np.zeros(0, int)
    distance = np.hypot(*(a[:, None] - b[None]).transpose(2, 0, 1))
    i, j = linear_sum_assignment(np.where(distance <= within_m, distance - 1000.0, 0.0))
    near = distance[i, j] <= within_m
    return i[near], j[near]


def loop_count(building: Building) -> int:
    return building.n_edges - building.n_nodes + 1


@dataclass(frozen=True)
class Agreement:
    """How an extracted building agrees with a hand-made graph."""

    hand: str
    found: str
    junction_recall: float
    junctions: int
    precision: float
    nodes: int
    path_median: float
    path_p90: float


def agreement(building: Building, plan: Plan, graph: Path, as_a_building: bool = False) -> Agreement:
    """Compare with the ``.graph`` file.

    A junction is a hand-made node with three corridors or more; it is found if some node of ours lies within
    1.5 m, one to one. Precision: the share of our nodes, bends left out, that lie so near to a hand-made one.
    Paths run between all pairs of hand-made nodes, straight from place to place; in our graph they begin at
    the nearest point of a corridor that the place sees.

    The hand-made graphs are for patrols, and do what a building's graph should not, or need not. With
    ``as_a_building`` they are counted without that:

    - Patrols inside a room: nodes on a loop around nothing but floor, or on a fork whose ends see each other across
      nothing but floor, count neither as junctions nor for paths, nor do our nodes within.
    - Stops before a wall: a branch that ends before a wall as plain as beside it makes no junction.
    - They name no doors, and put a room's node anywhere in it: a door of ours is right where a hand-made corridor
      passes within 1.5 m, and a room's node where a hand-made node lies within the room's radius in sight of it.
    """
    hand = read_graph(graph, add_doors=False)
    keep = np.ones(hand.n_nodes, bool)
    junction = hand.degree >= 3
    straight = ~np.isin(building.feature_class, (BEND, CORNER))
    if as_a_building:
        loops = empty_loops(hand, plan)
        keep[sorted({node for loop in loops for node in loop})] = False
        junction = (hand.degree - before_plain_walls(hand, plan)) >= 3
        straight &= ~_inside(hand, loops, building.position_m)
    matched, _ = match(hand.position_m, building.position_m)
    recall = np.isin(np.flatnonzero(junction & keep), matched).sum() / max(1, (junction & keep).sum())
    ours = np.flatnonzero(straight)
    _, hit = match(hand.position_m[keep], building.position_m[ours])
    right = np.zeros(len(ours), bool)
    right[hit] = True
    if as_a_building:
        right |= _on_a_corridor(hand, building, ours) | _in_the_room(hand, building, ours, plan)
    error = _path_errors(hand, building, plan, keep)
    return Agreement(
        hand=f"{hand.n_nodes}/{hand.n_edges}/{loop_count(hand)}",
        found=f"{building.n_nodes}/{building.n_edges}/{loop_count(building)}",
        junction_recall=float(recall),
        junctions=int((junction & keep).sum()),
        precision=float(right.mean()) if len(ours) else 0.0,
        nodes=len(ours),
        path_median=float(np.median(error)),
        path_p90=float(np.quantile(error, 0.9)),
    )


def _distances(n: int, edges: np.ndarray, length: np.ndarray) -> np.ndarray:
    graph = coo_array((length, (edges[:, 0], edges[:, 1])), shape=(n, n)).tocsr()
    return dijkstra(graph, directed=False)


def _path_errors(hand: Building, building: Building, plan: Plan, keep: np.ndarray) -> np.ndarray:
    a, b = hand.position_m[hand.edges[:, 0]], hand.position_m[hand.edges[:, 1]]
    expected = _distances(hand.n_nodes, hand.edges, np.hypot(*(a - b).T))
    # drawn lines against drawn lines: lengths are those of ways that cut corners
    drawn = np.array([np.hypot(*np.diff(building.line_m(e), axis=0).T).sum() for e in range(building.n_edges)])
    building = replace(building, length_m=np.maximum(drawn, building.length_m))
    within = _distances(building.n_nodes, building.edges, building.length_m)
    places = [_attach(point, building, plan) for point in hand.position_m]
    errors = []
    for i in np.flatnonzero(keep).tolist():
        for j in np.flatnonzero(keep[:i]).tolist():
            found = _between(building, within, places[i], places[j])
            errors.append(abs(found - expected[i, j]) / expected[i, j])
    return np.array(errors or [0.0])


def _attach(point: np.ndarray, building: Building, plan: Plan) -> tuple[int, float, float]:
    """The edge whose nearest point is the nearest that ``point`` sees, where on it (0 to 1), and how far (m)."""
    start = building.position_m[building.edges[:, 0]]
    along = building.position_m[building.edges[:, 1]] - start
    share = np.clip(((point - start) * along).sum(axis=1) / (along**2).sum(axis=1), 0, 1)
    nearest = start + share[:, None] * along
    away = np.hypot(*(point - nearest).T)
    order = np.argsort(away)
    edge = next((e for e in order.tolist() if _sees(plan, point, nearest[e])), int(order[0]))
    return edge, float(share[edge]), float(away[edge])


def _sees(plan: Plan, a: np.ndarray, b: np.ndarray) -> bool:
    ends = plan.to_pixels(np.array([a, b]))
    steps = int(np.abs(ends[1] - ends[0]).max()) + 2
    cells = np.floor(ends[0] + np.linspace(0, 1, steps)[:, None] * (ends[1] - ends[0])).astype(int)
    cells = np.clip(cells, 0, np.array(plan.free.shape) - 1)
    return bool(plan.free[tuple(cells.T)].all())


def _between(building: Building, within: np.ndarray, a: tuple, b: tuple) -> float:
    (edge, share, off), (other, part, aside) = a, b
    ends, others = building.edges[edge], building.edges[other]
    length, long = building.length_m[edge], building.length_m[other]
    ways = [
        within[ends[i], others[j]] + (share if i == 0 else 1 - share) * length + (part if j == 0 else 1 - part) * long
        for i in (0, 1)
        for j in (0, 1)
    ]
    if edge == other:
        ways.append(abs(share - part) * length)
    return float(min(ways)) + off + aside


def empty_loops(hand: Building, plan: Plan) -> list[list[int]]:
    """Loops and forks of the hand-made graph within which less than 2 % is not floor."""
    import networkx
    import shapely
    from skimage.draw import polygon

    graph = hand.to_networkx()
    around = networkx.minimum_cycle_basis(graph, weight="length_m")
    for node in graph:
        ends = [end for end in graph[node] if graph.degree(end) == 1]
        forks = [[node, a, b] for a, b in combinations(ends, 2)]
        around += [fork for fork in forks if shapely.Polygon(hand.position_m[fork]).area >= FORK_M2]
    found = []
    for loop in around:
        rows, columns = plan.to_pixels(hand.position_m[loop]).T
        inside = polygon(rows, columns, plan.free.shape)
        if len(inside[0]) and plan.free[inside].mean() > 0.98:
            found.append(loop)
    return found


def _inside(hand: Building, loops: list[list[int]], points: np.ndarray) -> np.ndarray:
    import shapely

    inside = np.zeros(len(points), bool)
    for loop in loops:
        ring = shapely.MultiPoint(hand.position_m[loop]).convex_hull.buffer(WITHIN_M)
        inside |= shapely.contains_xy(ring, points)
    return inside


def before_plain_walls(hand: Building, plan: Plan) -> np.ndarray:
    """For each hand-made node, how many of its branches are short and end before a wall as far off as beside it."""
    stops = np.zeros(hand.n_nodes, int)
    for end in np.flatnonzero(hand.degree == 1).tolist():
        node = int(hand.neighbour[hand.indptr[end]])
        at, ahead = hand.position_m[node], hand.position_m[end] - hand.position_m[node]
        if np.hypot(*ahead) > WITHIN_M:
            continue
        ahead = ahead / np.hypot(*ahead)
        aside = np.array([-ahead[1], ahead[0]])
        beside = [_clear_m(plan, at + step * aside, ahead) for step in (-2.0, -1.5, -1.0, 1.0, 1.5, 2.0)]
        stops[node] += _clear_m(plan, at, ahead) < np.median(beside) + PLAIN_M
    return stops


def _clear_m(plan: Plan, at: np.ndarray, ahead: np.ndarray) -> float:
    """How far one sees from a point in a direction, up to ``SIGHT_M`` (m)."""
    away = np.arange(0, SIGHT_M, plan.resolution_m / 2)
    cells = np.floor(plan.to_pixels(at + away[:, None] * ahead)).astype(int)
    hidden = ~plan.free[tuple(np.clip(cells, 0, np.array(plan.free.shape) - 1).T)]
    return float(away[hidden.argmax()]) if hidden.any() else SIGHT_M


def _on_a_corridor(hand: Building, building: Building, nodes: np.ndarray) -> np.ndarray:
    """Whether nodes are doors through which a hand-made corridor passes."""
    import shapely

    corridors = shapely.MultiLineString([hand.position_m[edge] for edge in hand.edges])
    away = shapely.distance(shapely.points(building.position_m[nodes]), corridors)
    return (building.feature_class[nodes] == DOOR) & (away <= WITHIN_M)


def _in_the_room(hand: Building, building: Building, nodes: np.ndarray, plan: Plan) -> np.ndarray:
    """Whether nodes are rooms that have a hand-made node."""
    found = np.zeros(len(nodes), bool)
    for i in np.flatnonzero(building.kind[nodes] == ROOM).tolist():
        at, radius = building.position_m[nodes[i]], np.sqrt(building.area_m2[nodes[i]] / np.pi)
        near = np.hypot(*(hand.position_m - at).T) <= radius
        found[i] = any(_sees(plan, at, point) for point in hand.position_m[near])
    return found


@dataclass(frozen=True)
class Found:
    """Recall and precision of one kind of place, and the places missed and wrong (m)."""

    recall: float
    precision: float
    missed: list
    wrong: list


def against_labels(building: Building) -> dict[str, Found]:
    """Rooms and doors against Willow Garage's labels: found one to one within 1.5 m."""
    labels = json.loads(LABELS.read_text())
    found = {}
    for name, mask in (("rooms", building.kind == ROOM), ("doors", building.feature_class == DOOR)):
        marked, ours = np.array(labels[name]), building.position_m[mask]
        hit, used = match(marked, ours)
        rest = np.delete(np.arange(len(ours)), used)
        _, excused = match(np.array(labels[f"either_{name}"]), ours[rest])
        wrong = np.delete(rest, excused)
        found[name] = Found(
            len(hit) / len(marked),
            len(hit) / (len(hit) + len(wrong)),
            np.delete(marked, hit, axis=0).tolist(),
            ours[wrong].tolist(),
        )
    return found


def drawn_counts(building: Building) -> tuple[int, int, int]:
    """Rooms, doors and loops that a generated building shows once it is drawn.

    A room's link is one metre wide whether a door feature is on it or not, so it is drawn, and found, as a
    door.
    """
    doors = int((building.feature_class == DOOR).sum())
    for room in np.flatnonzero(building.kind == ROOM):
        near = building.neighbour[building.indptr[room] : building.indptr[room + 1]]
        doors += int((building.feature_class[near] != DOOR).sum())
    return int((building.kind == ROOM).sum()), doors, loop_count(building)


def counts(building: Building) -> tuple[int, int, int]:
    return int((building.kind == ROOM).sum()), int((building.feature_class == DOOR).sum()), loop_count(building)


def visible_intersections(building: Building, turn_degrees: float = 30.0) -> np.ndarray:
    """Intersections that a drawing shows: not those in the middle of a corridor that goes straight on."""
    found = []
    for node in np.flatnonzero(building.kind == INTERSECTION).tolist():
        near = building.neighbour[building.indptr[node] : building.indptr[node + 1]]
        if len(near) == 2:
            away = building.position_m[near] - building.position_m[node]
            away = away / np.hypot(*away.T)[:, None]
            if np.degrees(np.arccos(np.clip(-(away[0] @ away[1]), -1, 1))) < turn_degrees:
                continue
        found.append(node)
    return np.array(found)


def farthest_intersection_m(drawn: Building, found: Building) -> float:
    """How far the worst-placed visible intersection of ``drawn`` is from the nearest node of ``found`` (m)."""
    at = drawn.position_m[visible_intersections(drawn)]
    return float(np.hypot(*(at[:, None] - found.position_m[None]).transpose(2, 0, 1)).min(axis=1).max())


def office(pixels: int) -> Plan:
    """A made-up office of ``pixels`` x ``pixels`` cells of 5 cm: blocks of eight rooms between corridors."""
    free = np.zeros((pixels, pixels), bool)
    free[40:-40, 40:-40] = True
    rng = np.random.default_rng(0)
    block = (200, 360)
    starts = [range(80, pixels - size - 40, size + 40) for size in block]
    for r in starts[0]:
        for c in starts[1]:
            free[r : r + block[0], c : c + block[1]] = False
            for i in range(2):
                for j in range(4):
                    row, column = r + 4 + i * 98, c + 4 + j * 88
                    free[row : row + 94, column : column + 84] = True
                    door = column + int(rng.integers(10, 56))
                    rows = slice(r, row) if i == 0 else slice(row + 94, r + block[0])
                    free[rows, door : door + 18] = True
    return Plan("office", free, np.zeros_like(free), free.astype(np.uint8) * 254, 0.05, (0.0, 0.0, 0.0))


def write_office(folder: Path, pixels: int) -> Path:
    """Write :func:`office` as a ROS map; returns the YAML file."""
    (folder / "office.pgm").write_bytes(b"P5\n%d %d\n255\n" % (pixels, pixels) + office(pixels).grey.tobytes())
    path = folder / "office.yaml"
    path.write_text(
        "image: office.pgm\nresolution: 0.05\norigin: [0, 0, 0]\nnegate: 0\noccupied_thresh: 0.65\nfree_thresh: 0.196\n"
    )
    return path
