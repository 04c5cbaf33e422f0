"""Graphs of places that people made for their robots: waypoints and the ways between them, on the way to a building.

Such files know places and ways. Which place is a room, a door or a corner is set here, by one rule for all formats.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from tasklift.building.graph import BEND, CORNER, DOOR, FEATURE, INTERSECTION, NONE, OTHER, ROOM, Building
from tasklift.errors import TaskliftError
from tasklift.plans.source import Source, plain_name

MOST_PLACES = 100_000
FEWEST_DOORS = 4  # not next to the start
BEND_DEGREES, CORNER_DEGREES = 35.0, 70.0
SHORTEST_M = 0.001

RULE = (
    "Nodes with one neighbour are rooms. A node with two neighbours next to a room is a door; a room without "
    "one gets a door in the middle of its corridor. Other nodes with two neighbours are corners if the way "
    f"turns there by more than {CORNER_DEGREES:g} degrees, bends by more than {BEND_DEGREES:g}, else other "
    "features. All others are intersections, and so is a start that is not a room. While fewer than "
    f"{FEWEST_DOORS} doors are not next to the start, the longest corridor without a door gets one in its "
    "middle. Lengths are straight distances, or the file's lengths where these are longer."
)


@dataclass(eq=False)
class Places:
    """Places and ways as a file has them.

    Attributes
    ----------
    source
        The file, for messages.
    provenance
        What the building is to know of where it comes from.
    position_m
        Place by place ``(x, y)`` (m).
    ways
        Length (m) by ``(lower, higher)`` place; never below the straight distance once it is a building.
    names
        What places are called, by place.
    rooms, doors
        Places of which the file says what they are.
    doubts
        What the reader is not sure of, a sentence each.
    must_be_joined
        Whether a file whose places are not all joined is at fault; else the largest part stays.
    """

    source: Source
    provenance: dict[str, Any]
    position_m: list[tuple[float, float]] = field(default_factory=list)
    ways: dict[tuple[int, int], float] = field(default_factory=dict)
    names: dict[int, str] = field(default_factory=dict)
    rooms: set[int] = field(default_factory=set)
    doors: set[int] = field(default_factory=set)
    doubts: list[str] = field(default_factory=list)
    must_be_joined: bool = False

    def add(self, x: float, y: float, name: object = "") -> int:
        """Add a place (m) and return its number."""
        if len(self.position_m) >= MOST_PLACES:
            raise self.source.fault(f"more than {MOST_PLACES:,} places")
        self.position_m.append((round(x, 4) + 0.0, round(y, 4) + 0.0))
        number = len(self.position_m) - 1
        if called := plain_name(name):
            self.names[number] = called
        return number

    def join(self, a: int, b: int, length_m: float = 0.0) -> None:
        """Add a way; of two between the same places the shorter one stays, one from a place to itself is left out."""
        if a != b:
            pair = (min(a, b), max(a, b))
            length = round(max(length_m, math.dist(self.position_m[a], self.position_m[b])), 4)
            self.ways[pair] = min(length, self.ways.get(pair, math.inf))

    def building(
        self,
        *,
        start: int | tuple[float, float] | None = None,
        room_area_m2: float = 12.0,
        width_m: float = 2.0,
        add_doors: bool = True,
    ) -> Building:
        """Return the building; places keep their numbers, doors that are added follow.

        Kinds that the file does not say are set by this rule. Nodes with one neighbour are rooms. A node with two
        neighbours next to a room is a door; a room without one gets a door in the middle of its corridor. Other nodes
        with two neighbours are corners if the way turns there by more than 70°, bends by more than 35°, else other
        features. All others are intersections, and so is a start that is not a room. While fewer than 4 doors are not
        next to the start, the longest corridor without a door gets one in its middle, so that hostiles have a choice.

        Parameters
        ----------
        start
            Where robots begin: a place, or a point (m) of which the nearest room is taken. ``None``: the lowest room
            on the map, or else the lowest place.
        room_area_m2
            Area of every room (m²); obstacles are 0.
        width_m
            Width of every corridor (m).
        add_doors
            Whether to add nodes for doors; without, the building has exactly the file's nodes and edges.

        Raises
        ------
        TaskliftError
            With the file and the place at fault.
        """
        self._in_one_piece()
        n = len(self.position_m)
        if n < 2:
            raise self.source.fault(f"expected two places or more that are joined, found {n}")
        degree = [len(near) for near in self._neighbours()]
        rooms = [p for p in range(n) if p in self.rooms or (degree[p] == 1 and p not in self.doors)]
        start = self._start(start, rooms)
        kind = [FEATURE] * n
        feature = [NONE] * n
        self._set_kinds(kind, feature, rooms, start)
        if add_doors:
            self._add_doors(kind, feature, rooms, start)
        return self._built(kind, feature, start, n, room_area_m2, width_m)

    def _built(
        self, kind: list[int], feature: list[int], start: int, n: int, room_area_m2: float, width_m: float
    ) -> Building:
        edges = sorted(self.ways)
        kinds = np.array(kind, np.int8)
        names = {"names": {str(place): name for place, name in sorted(self.names.items())}} if self.names else {}
        settings = {"nodes_in_file": n, "rule": RULE, "room_area_m2": room_area_m2, "width_m": width_m}
        try:
            return Building(
                name=self.source.path.name.split(".")[0],
                kind=kinds,
                feature_class=np.array(feature, np.int8),
                position_m=np.array(self.position_m),
                area_m2=np.where(kinds == ROOM, room_area_m2, 0.0),
                obstacles=np.zeros(len(kinds), np.int64),
                edges=np.array(edges, np.int64).reshape(-1, 2),
                length_m=np.array([max(self.ways[edge], SHORTEST_M) for edge in edges]),
                width_m=np.full(len(edges), width_m),
                start=start,
                provenance=self.provenance | settings | names,
            )
        except TaskliftError as error:
            raise self.source.fault(str(error)) from error

    def _start(self, start: int | tuple[float, float] | None, rooms: Sequence[int]) -> int:
        n = len(self.position_m)
        if isinstance(start, int):
            if not 0 <= start < n:
                raise self.source.fault(f"start {start!r} is not a node of the file; expected 0 to {n - 1}")
            return start
        among = rooms or range(n)
        if start is None:
            return min(among, key=lambda place: (self.position_m[place][1], place))
        return min(among, key=lambda place: (math.dist(self.position_m[place], start), place))

    def _neighbours(self) -> list[list[int]]:
        neighbours: list[list[int]] = [[] for _ in self.position_m]
        for a, b in self.ways:
            neighbours[a].append(b)
            neighbours[b].append(a)
        return neighbours

    def _in_one_piece(self) -> None:
        """Keep the largest part that is joined; say so."""
        parts = self._parts()
        if len(parts) > 1 and self.must_be_joined:
            lost = min(place for part in parts if 0 not in part for place in part)
            raise self.source.fault(f"node {lost} cannot be reached from node 0; add an edge or remove it")
        if len(parts) > 1:
            largest = max(parts, key=len)
            left = len(self.position_m) - len(largest)
            self.doubts.append(f"{left} places that no way joins to the other {len(largest)} were left out")
            self._keep(set(largest))

    def _keep(self, kept: set[int]) -> None:
        """Leave out all other places, and number anew."""
        number = {old: new for new, old in enumerate(sorted(kept))}
        self.position_m = [self.position_m[i] for i in number]
        self.ways = {(number[a], number[b]): length for (a, b), length in self.ways.items() if a in number}
        self.names = {number[i]: name for i, name in self.names.items() if i in number}
        self.rooms = {number[i] for i in self.rooms if i in number}
        self.doors = {number[i] for i in self.doors if i in number}

    def _parts(self) -> list[list[int]]:
        """The places by what is joined."""
        neighbours = self._neighbours()
        seen = [False] * len(neighbours)
        parts = []
        for begin in range(len(neighbours)):
            if seen[begin]:
                continue
            part, seen[begin] = [begin], True
            for place in part:  # grows meanwhile
                for other in neighbours[place]:
                    if not seen[other]:
                        seen[other] = True
                        part.append(other)
            parts.append(part)
        return parts

    def _set_kinds(self, kind: list[int], feature: list[int], rooms: Sequence[int], start: int) -> None:
        is_room = set(rooms)
        for place, others in enumerate(self._neighbours()):
            if place in is_room:
                kind[place] = ROOM
            elif place in self.doors and place != start:
                feature[place] = DOOR
            elif len(others) == 2 and place != start:
                feature[place] = self._class_between(place, others, is_room)
            else:
                kind[place] = INTERSECTION

    def _class_between(self, place: int, others: Sequence[int], is_room: set[int]) -> int:
        """What a place with two neighbours is."""
        if any(other in is_room for other in others):
            return DOOR
        (ax, ay), (bx, by) = (self.position_m[other] for other in others)
        x, y = self.position_m[place]
        turn = abs(math.degrees(math.atan2(by - y, bx - x) - math.atan2(y - ay, x - ax)))
        turn = min(turn, 360 - turn)
        return CORNER if turn > CORNER_DEGREES else BEND if turn > BEND_DEGREES else OTHER

    def _add_doors(self, kind: list[int], feature: list[int], rooms: Sequence[int], start: int) -> None:
        """Give every room a door, and the building enough doors that are not next to the start."""
        neighbours = self._neighbours()
        for room in rooms:
            for other in neighbours[room]:
                # Two rooms joined by one corridor share a door
                if feature[other] != DOOR and (min(room, other), max(room, other)) in self.ways:
                    self._insert_door(kind, feature, room, other)
        while True:
            is_door = [value == DOOR for value in feature]
            beside = {place for way in self.ways if start in way for place in way}
            plain = [way for way in self.ways if not is_door[way[0]] and not is_door[way[1]] and start not in way]
            if not plain or sum(is_door[p] and p not in beside for p in range(len(is_door))) >= FEWEST_DOORS:
                return
            self._insert_door(kind, feature, *min(plain, key=lambda way: (-self.ways[way], way)))

    def _insert_door(self, kind: list[int], feature: list[int], a: int, b: int) -> None:
        half = round(self.ways.pop((min(a, b), max(a, b))) / 2, 4)
        door = len(self.position_m)
        (ax, ay), (bx, by) = self.position_m[a], self.position_m[b]
        self.position_m.append((round((ax + bx) / 2, 4), round((ay + by) / 2, 4)))
        kind.append(FEATURE)
        feature.append(DOOR)
        self.ways[a, door] = self.ways[b, door] = half
