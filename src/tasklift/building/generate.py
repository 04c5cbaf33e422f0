"""Buildings like the paper's: exact numbers of intersections, corridors, rooms and features, from a seed.

Three stages, each drawing from the same random numbers: a connected piece of a lattice with the exact counts
(``lattice.py``); the same in metres, with rooms on free sides; features that subdivide corridors. The paper's
25 corridors are those between intersections: with 21 of them and 6 rooms they could not hold the links to the
rooms as well (26 edges are the least that joins 27 nodes).
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from itertools import pairwise
from typing import Any

import numpy as np
from numpy.typing import NDArray

from tasklift.building.graph import (
    BEND,
    CORNER,
    DOOR,
    FEATURE,
    INTERSECTION,
    NONE,
    OTHER,
    ROOM,
    Building,
    buffered_hull,
)
from tasklift.building.lattice import STEP, Lattice
from tasklift.checks import whole_number
from tasklift.errors import TaskliftError

LARGEST = 2000  # intersections; the search takes minutes beyond
FEATURES_PER_CORRIDOR = 4

# Metres. A spacing of 6 m or more leaves every room its smallest footprint next to any neighbour.
_SPACING, _SPREAD, _SPACING_RANGE = 9.0, 0.2, (6.0, 15.0)
_WIDTHS = (1.8, 2.4, 3.0)
_DOOR_WIDTH = 1.0
_WALL = 0.3
_ROOM_AREA = (9.0, 60.0)
_SMALLEST_SIDE = 3.0
_CORNER = 0.65  # how much farther than its sides the outer corner of a wide corridor reaches
_FRONT = max(_WIDTHS) / 2 + _WALL  # from an intersection's centre to the near wall of its room

# Degrees by which a corridor turns, and the least angle between two corridors at a node
_TURN = {BEND: (37.0, 53.0), CORNER: (62.0, 80.0)}
_LEAST_ANGLE = 40.0


def generate(
    intersections: int = 21,
    corridors: int = 25,
    rooms: int = 6,
    features: int = 16,
    doors: int | None = None,
    seed: int = 0,
    name: str | None = None,
) -> Building:
    """Return a building with exactly these counts; the same arguments give the same building everywhere.

    Parameters
    ----------
    intersections, corridors
        Nodes of kind intersection, and the corridors that join them before features subdivide these.
    rooms
        Each hangs on one intersection by one link. The start is a room at the bottom, the most central one.
    features
        Nodes that subdivide corridors and links, so the building has ``intersections + rooms + features``
        nodes and ``corridors + rooms + features`` edges. Bends (37° to 53°) and corners (62° to 80°) do turn;
        where there is no place for one, the feature is an "other".
    doors
        Features that are doors. ``None``: a quarter of the features, at least 4 if there are as many: the
        four classes are equally common. Doors stand in corridors and at rooms alike, in proportion to their
        numbers; the start's own room is the last to get one, since no hostile may stand next to the start.
    seed
        A whole number, at least 0.
    name
        For people; by default made of the counts and the seed.

    Raises
    ------
    TaskliftError
        If no building has these counts.

    Examples
    --------
    >>> generate(intersections=9, corridors=11, rooms=3, features=6, seed=5)
    Building('generated 9-11-3-6 seed 5': 3 rooms, 9 intersections, 6 features, 20 edges)
    """
    doors = _check(intersections, corridors, rooms, features, doors, seed)
    rng = np.random.Generator(np.random.PCG64(seed))
    lattice = Lattice(intersections, corridors, rooms, rng)
    plan = _Plan.of(lattice, rng)
    plan.grow_rooms(rng)
    plan.add_features(features, doors, rng)
    counts = {"intersections": intersections, "corridors": corridors, "rooms": rooms, "features": features}
    arguments = {key: int(value) for key, value in (counts | {"doors": doors, "seed": seed}).items()}
    return plan.building(
        name if name is not None else f"generated {intersections}-{corridors}-{rooms}-{features} seed {seed}",
        {"source": "tasklift.building.generate", "arguments": arguments},
    )


def _check(intersections: int, corridors: int, rooms: int, features: int, doors: int | None, seed: int) -> int:
    """Refuse what cannot be, and return the number of doors."""
    given = {"intersections": intersections, "corridors": corridors, "rooms": rooms, "features": features}
    given["seed"] = seed
    if doors is not None:
        given["doors"] = doors
    for key, value in given.items():
        whole_number(value, f"generate: {key}", 1 if key in ("intersections", "rooms") else 0)
    if intersections > LARGEST:
        raise TaskliftError(f"generate: intersections: expected at most {LARGEST}, found {intersections}")
    if corridors < intersections - 1:
        raise TaskliftError(
            f"generate: {corridors} corridors cannot connect {intersections} intersections; "
            f"ask for at least {intersections - 1}"
        )
    most = 2 * intersections - math.ceil(2 * math.sqrt(intersections))
    if corridors > most:
        raise TaskliftError(
            f"generate: {intersections} intersections of a lattice have at most {most} corridors, "
            f"found {corridors}; ask for fewer corridors or more intersections"
        )
    sides = 4 * intersections - 2 * corridors
    if rooms > sides:
        raise TaskliftError(
            f"generate: {intersections} intersections with {corridors} corridors leave {sides} free sides, "
            f"found {rooms} rooms; ask for fewer rooms or corridors"
        )
    if doors is not None and doors > features:
        raise TaskliftError(
            f"generate: doors are features: found {doors} doors and {features} features; "
            f"ask for at least {doors} features"
        )
    if doors is None:
        # What the corridors cannot hold can only be doors at rooms
        doors = min(features, max(4, round(features / 4), features - FEATURES_PER_CORRIDOR * corridors))
    at_links = min(doors, rooms)
    most = FEATURES_PER_CORRIDOR * corridors + at_links
    if features > most:
        raise TaskliftError(
            f"generate: {corridors} corridors hold at most {most - at_links} features and the rooms "
            f"{at_links} doors, found {features} features; ask for fewer features"
        )
    return int(doors)


@dataclass
class _Plan:
    """The building in metres, with x to the east and y to the north, rounded to centimetres.

    Nodes are the ``V`` intersections, then the rooms, then the features.
    """

    position: list[tuple[float, float]]
    chains: list[list[int]]  # the nodes along each corridor, in order
    width: list[float]  # of each corridor
    holder: list[int]  # the intersection that each room hangs on, the start's room first
    way: list[int]
    box: list[tuple[float, float, float, float]]  # of each room: x0, y0, x1, y1
    links: list[list[int]]
    obstacles: list[int]
    feature_class: list[int]  # of each feature

    @classmethod
    def of(cls, lattice: Lattice, rng: np.random.Generator) -> _Plan:
        """Space the lattice out; rooms get their smallest footprint."""
        size = max(lattice.columns, lattice.rows) + 2
        spacing = np.clip(_SPACING * np.exp(_SPREAD * rng.standard_normal((2, size))), *_SPACING_RANGE)
        x, y = np.cumsum(np.round(spacing, 1), axis=1).tolist()
        order = sorted(lattice.nodes)
        index = {cell: i for i, cell in enumerate(order)}
        position = [(round(x[cell % lattice.stride], 2), round(y[cell // lattice.stride], 2)) for cell in order]
        chains = sorted(sorted([index[cell], index[cell + lattice.step[way]]]) for cell, way in lattice.edges)
        plan = cls(
            position=position,
            chains=chains,
            width=rng.choice(_WIDTHS, len(chains)).tolist(),
            holder=[index[cell] for cell, _ in lattice.rooms],
            way=[way for _, way in lattice.rooms],
            box=[],
            links=[],
            obstacles=rng.integers(0, 6, len(lattice.rooms)).tolist(),
            feature_class=[],
        )
        plan.box = [plan._footprint(i, _SMALLEST_SIDE, _SMALLEST_SIDE) for i in range(len(plan.holder))]
        return plan

    def _footprint(self, room: int, depth: float, breadth: float) -> tuple[float, float, float, float]:
        (x, y), (dx, dy) = self.position[self.holder[room]], STEP[self.way[room]]
        middle = _FRONT + depth / 2
        half_x, half_y = (depth / 2, breadth / 2) if dx else (breadth / 2, depth / 2)
        x, y = x + dx * middle, y + dy * middle
        return round(x - half_x, 2), round(y - half_y, 2), round(x + half_x, 2), round(y + half_y, 2)

    def grow_rooms(self, rng: np.random.Generator) -> None:
        """Give every room the size it draws, or the largest of that shape that touches nothing."""
        count = len(self.holder)
        area = np.exp(rng.uniform(math.log(_ROOM_AREA[0]), math.log(_ROOM_AREA[1]), count))
        breadth = np.sqrt(area * np.exp(rng.uniform(-0.3, 0.3, count)))
        bands = []
        for (a, b), width in zip(self.chains, self.width, strict=True):
            (x0, y0), (x1, y1) = self.position[a], self.position[b]
            bands.append((x0 - width / 2, y0 - width / 2, x1 + width / 2, y1 + width / 2))
        for i in range(count):
            (x, y), (dx, dy) = self.position[self.holder[i]], STEP[self.way[i]]
            far_x, far_y, half = x + dx * _FRONT, y + dy * _FRONT, _DOOR_WIDTH / 2
            bands.append((min(x, far_x) - half, min(y, far_y) - half, max(x, far_x) + half, max(y, far_y) + half))
        solid = np.array(bands + self.box)
        first, first_link = len(bands), len(self.chains)
        for i in range(count):
            others = np.ones(len(solid), bool)
            others[[first + i, first_link + i]] = False
            sides = area[i] / breadth[i], breadth[i]
            while max(sides) > _SMALLEST_SIDE:
                box = self._footprint(i, *(max(_SMALLEST_SIDE, round(side, 1)) for side in sides))
                low, high = np.array(box[:2]) - _WALL + 1e-6, np.array(box[2:]) + _WALL - 1e-6
                if not ((solid[others, :2] < high) & (solid[others, 2:] > low)).all(axis=1).any():
                    self.box[i] = box
                    solid[first + i] = box
                    break
                sides = sides[0] * 0.93, sides[1] * 0.93
        for i, (x0, y0, x1, y1) in enumerate(self.box):
            self.links.append([self.holder[i], len(self.position)])
            self.position.append((round((x0 + x1) / 2, 3), round((y0 + y1) / 2, 3)))

    def add_features(self, features: int, doors: int, rng: np.random.Generator) -> None:
        """Put doors at rooms, then bends and corners where there is room, then the rest anywhere."""
        rooms, corridors = len(self.links), len(self.chains)
        fair = round(doors * rooms / (rooms + corridors))
        at_links = min(doors, rooms, max(fair, features - FEATURES_PER_CORRIDOR * corridors))
        for i in [*range(1, rooms), 0][:at_links]:
            (x, y), (dx, dy) = self.position[self.holder[i]], STEP[self.way[i]]
            self._insert(self.links[i], 1, (x + dx * _FRONT, y + dy * _FRONT), DOOR)
        rest = features - at_links
        if not rest:
            return
        order = rng.permutation(corridors).tolist()
        count = [rest // corridors + (j < rest % corridors) for j in range(corridors)]
        wanted = {CORNER: (rest - doors + at_links + 1) // 3, BEND: (rest - doors + at_links + 2) // 3}
        straight = [j for j in range(corridors) if count[j] != 1]
        pool = [j for j in range(corridors) if count[j] == 1]
        for turn, number in wanted.items():
            left = []
            for j in pool:
                if number and self._add_turn(order[j], turn, rng):
                    number -= 1
                else:
                    left.append(j)
            pool = left
        slots = [order[j] for j in straight + pool for _ in range(count[j])]
        classes = [DOOR] * (doors - at_links) + [OTHER] * (len(slots) - doors + at_links)
        classes = [classes[k] for k in rng.permutation(len(slots)).tolist()]
        for j in straight + pool:
            self._divide(order[j], [classes.pop() for _ in range(count[j])], rng)

    def _insert(self, chain: list[int], at: int, point: tuple[float, float], feature: int) -> None:
        chain.insert(at, len(self.position))
        self.position.append((round(point[0], 2), round(point[1], 2)))
        self.feature_class.append(feature)

    def _divide(self, corridor: int, classes: list[int], rng: np.random.Generator) -> None:
        """Put features on a straight corridor: one in its middle part, several at equal distances."""
        chain = self.chains[corridor]
        (x0, y0), (x1, y1) = self.position[chain[0]], self.position[chain[1]]
        for k, feature in enumerate(classes, start=1):
            t = rng.uniform(0.3, 0.7) if len(classes) == 1 else k / (len(classes) + 1)
            self._insert(chain, k, (x0 + t * (x1 - x0), y0 + t * (y1 - y0)), feature)

    def _add_turn(self, corridor: int, feature: int, rng: np.random.Generator) -> bool:
        """Bend a corridor sideways by the angle that the class asks for, if nothing is in the way."""
        chain = self.chains[corridor]
        a, b = np.array(self.position[chain[0]]), np.array(self.position[chain[1]])
        length = float(np.abs(b - a).sum())  # corridors run along the axes
        ahead = (b - a) / length
        aside = np.array([-ahead[1], ahead[0]])
        obstacles = self._obstacles(corridor)
        for side in rng.permutation([-1, 1]).tolist():
            part = rng.uniform(0.4, 0.6) * length
            tangent = math.tan(math.radians(rng.uniform(*_TURN[feature])))
            # atan(h / part) + atan(h / (length - part)) is the turn: a quadratic in the height h
            height = math.sqrt(length**2 + 4 * tangent**2 * part * (length - part)) - length
            apex = a + part * ahead + side * height / (2 * tangent) * aside
            if self._clear(corridor, apex, *obstacles):
                self._insert(chain, 1, (float(apex[0]), float(apex[1])), feature)
                return True
        return False

    def _obstacles(self, corridor: int) -> tuple[NDArray[np.int64], NDArray[np.float64], NDArray[np.float64]]:
        """Every other corridor and link in pieces: nodes (M, 2), positions (M, 2, 2), widths."""
        pieces, widths = [], []
        links = [(link, _DOOR_WIDTH) for link in self.links]
        for j, (chain, width) in enumerate([*zip(self.chains, self.width, strict=True), *links]):
            if j != corridor:
                pieces += [chain[k : k + 2] for k in range(len(chain) - 1)]
                widths += [width] * (len(chain) - 1)
        nodes = np.array(pieces).reshape(-1, 2)
        return nodes, np.array(self.position)[nodes], np.array(widths)

    def _clear(
        self,
        corridor: int,
        apex: NDArray[np.float64],
        nodes: NDArray[np.int64],
        pieces: NDArray[np.float64],
        widths: NDArray[np.float64],
    ) -> bool:
        """Whether the corridor, led over ``apex``, keeps away from all else, and wide angles at its ends."""
        import shapely

        ends, half = self.chains[corridor], self.width[corridor] / 2
        legs = [shapely.LineString([self.position[end], apex]) for end in ends]
        rooms = shapely.box(*np.array(self.box).T)
        if shapely.distance(shapely.Point(apex), rooms).min() < half + _CORNER + _WALL:
            return False
        lines = shapely.linestrings(pieces)
        for end, leg in zip(ends, legs, strict=True):
            if shapely.distance(leg, rooms).min() < half + _WALL - 1e-6:
                return False
            meets = (nodes == end).any(axis=1)
            gap = shapely.distance(leg, lines[~meets]) - widths[~meets] / 2
            if gap.size and gap.min() < half + _CORNER + _WALL:
                return False
            here = np.array(self.position[end])
            # From the shared node to the far end of each piece; the near end adds nothing
            other = (pieces[meets] - here).sum(axis=1)
            mine = apex - here
            cosine = other @ mine / (np.hypot(*mine) * np.hypot(*other.T))
            if cosine.size and cosine.max() > math.cos(math.radians(_LEAST_ANGLE)):
                return False
        return True

    def building(self, name: str, provenance: dict[str, Any]) -> Building:
        """Freeze the plan; the rooms' rectangles go into the provenance, for drawing."""
        rooms, features = len(self.box), len(self.feature_class)
        first_room = len(self.position) - rooms - features
        n = len(self.position)
        kind = np.full(n, INTERSECTION)
        kind[first_room : n - features] = ROOM
        kind[n - features :] = FEATURE
        feature_class = np.full(n, NONE)
        feature_class[n - features :] = self.feature_class
        position = np.array(self.position)
        area, obstacles = np.zeros(n), np.zeros(n, np.int64)
        box = np.array(self.box)
        area[first_room : n - features] = np.round((box[:, 2] - box[:, 0]) * (box[:, 3] - box[:, 1]), 2)
        obstacles[first_room : n - features] = self.obstacles
        chains = [*zip(self.chains, self.width, strict=True), *((link, _DOOR_WIDTH) for link in self.links)]
        edges = np.array([pair for chain, _ in chains for pair in pairwise(chain)])
        width = np.array([width for chain, width in chains for _ in chain[1:]])
        corners = box[:, [0, 1, 2, 1, 2, 3, 0, 3]].reshape(-1, 2)
        return Building(
            name=name,
            kind=kind.astype(np.int8),
            feature_class=feature_class.astype(np.int8),
            position_m=position,
            area_m2=area,
            obstacles=obstacles,
            edges=edges,
            length_m=np.round(np.hypot(*(position[edges[:, 0]] - position[edges[:, 1]]).T), 3),
            width_m=width,
            start=first_room,
            outline_m=buffered_hull(np.concatenate([position, corners])),
            provenance=provenance | {"footprints": {str(first_room + i): list(b) for i, b in enumerate(self.box)}},
        )
