"""Pieces of a square lattice with exact numbers of nodes and edges: what generated buildings are made of."""

from __future__ import annotations

import math

import numpy as np

from tasklift.errors import TaskliftError

EAST, NORTH, WEST, SOUTH = range(4)
STEP = ((1, 0), (0, 1), (-1, 0), (0, -1))


class Lattice:
    """A connected piece of a square lattice with exact numbers of nodes and edges, and rooms on free sides.

    Found by simulated annealing with moves that keep the numbers: first without rooms, to break the block up
    from which it starts, then with them.

    Attributes
    ----------
    nodes, edges, rooms
        Cells; ``(cell, direction)`` pairs; ``(cell, direction)`` pairs, the start's room first.
    stride, step
        Cells are numbered row by row, ``stride`` to a row, in a grid with a frame one cell wide which only
        rooms may use; ``step`` is what to add to a cell for each direction.
    corridor, room
        Four bits per cell, one per direction.
    holder
        Which node the room in a cell hangs on, -1 where there is none.
    """

    ROUNDS, STEPS_PER_NODE = 8, 300
    TEMPERATURES = (1.5, 0.2)
    # The energy of a node that leads nowhere, of a full 2 × 2 block, and of two nodes side by side where so
    # many rooms are asked for that sides must stay free for them
    LONELY, BLOCK, CROWD = 2.0, 1.5, 1.0

    def __init__(self, nodes: int, edges: int, rooms: int, rng: np.random.Generator) -> None:
        cells = max(2 * nodes, nodes + 2 * rooms)
        self.columns = max(math.ceil(math.sqrt(cells * 7 / 6)), math.ceil(math.sqrt(nodes)))
        self.rows = max(math.ceil(cells / self.columns), math.ceil(math.sqrt(nodes)))
        self.stride = self.columns + 2
        self.step = tuple(dx + self.stride * dy for dx, dy in STEP)
        size = self.stride * (self.rows + 2)
        self.inside = [
            1 <= cell % self.stride <= self.columns and 1 <= cell // self.stride <= self.rows for cell in range(size)
        ]
        self.corridor, self.room = [0] * size, [0] * size
        self.taken = [False] * size  # by a node
        self.holder = [-1] * size
        self.rooms: list[tuple[int, int]] = []
        self.crowd = self.CROWD if 2 * rooms > nodes else 0.0
        self._start_with_a_block(nodes, edges, rng)
        for _ in range(self.ROUNDS):
            self._anneal(0, rng)
            # The start's room comes last, at the bottom
            self._anneal(rooms - 1, rng)
            if not self.missing and self._add_start_room(rng):
                return
            self._clear_rooms()
        raise TaskliftError(
            f"generate: found no place for {rooms} rooms around {nodes} intersections and {edges} corridors; "
            "ask for fewer rooms or corridors"
        )

    def _start_with_a_block(self, nodes: int, edges: int, rng: np.random.Generator) -> None:
        """Take a block as square as can be, and drop edges that hold nothing together."""
        side = math.isqrt(nodes)
        # A square, the column to its right, the row above: 2n - ceil(2 sqrt n) edges, the most possible
        cells = [(x, y) for y in range(side) for x in range(side)]
        cells += [(side, y) for y in range(side)] + [(x, side) for x in range(side + 1)]
        left, bottom = 1 + (self.columns - side) // 2, 1 + (self.rows - side) // 2
        left, bottom = max(1, min(left, self.columns - side)), max(1, min(bottom, self.rows - side))
        self.nodes = [left + x + self.stride * (bottom + y) for x, y in cells[:nodes]]
        for node in self.nodes:
            self.taken[node] = True
        self.edges = [(node, way) for node in self.nodes for way in (EAST, NORTH) if self.taken[node + self.step[way]]]
        for node, way in self.edges:
            self._flip(node, way)
        order = rng.permutation(len(self.edges)).tolist()
        dropped: set[int] = set()
        for i in order:
            if len(self.edges) - len(dropped) == edges:
                break
            node, way = self.edges[i]
            self._flip(node, way)
            if self._joined(node, node + self.step[way]):
                dropped.add(i)
            else:
                self._flip(node, way)
        self.edges = [edge for i, edge in enumerate(self.edges) if i not in dropped]

    def _flip(self, node: int, way: int) -> None:
        self.corridor[node] ^= 1 << way
        self.corridor[node + self.step[way]] ^= 1 << (way + 2) % 4

    def _joined(self, a: int, b: int) -> bool:
        seen, stack = {a}, [a]
        while stack:
            node = stack.pop()
            if node == b:
                return True
            bits = self.corridor[node]
            for way in range(4):
                if bits >> way & 1:
                    other = node + self.step[way]
                    if other not in seen:
                        seen.add(other)
                        stack.append(other)
        return False

    def _energy(self, cells: set[int]) -> float:
        """What is unlike a building at these cells, and at the blocks whose lower left corner they are.

        A node in a straight corridor that leads nowhere, a dead end without a room, a full 2 × 2 block.
        """
        corridor, step = self.corridor, self.step
        total = 0.0
        for cell in cells:
            bits = corridor[cell]
            if bits in (0b0101, 0b1010, 1, 2, 4, 8) and not self.room[cell]:
                total += self.lonely
            if bits & 0b11 == 0b11 and corridor[cell + 1] & 0b10 and corridor[cell + step[NORTH]] & 1:
                total += self.BLOCK
            if self.crowd and self.taken[cell]:
                total += self.crowd * (self.taken[cell + 1] + self.taken[cell + step[NORTH]])
        return total

    def _around(self, *nodes: int) -> set[int]:
        row = self.stride
        return {cell for node in nodes for cell in (node, node - 1, node - row, node - row - 1) if cell >= 0}

    def _clear_rooms(self) -> None:
        for node, way in self.rooms:
            self.room[node] = 0
            self.holder[node + self.step[way]] = -1
        self.rooms = []

    def _anneal(self, rooms: int, rng: np.random.Generator) -> None:
        """Move at random, less and less uphill; without rooms only full blocks cost anything."""
        self.missing = rooms
        self.lonely = self.LONELY if rooms else 0.0
        steps = self.STEPS_PER_NODE * len(self.nodes)
        hot, cold = self.TEMPERATURES
        cooling = np.geomspace(hot, cold, steps).tolist()
        moves = (self._switch_edge, self._move_leaf, self._move_room)
        for temperature, draws in zip(cooling, rng.random((steps, 5)).tolist(), strict=True):
            # A move is accepted while its gain in energy stays below this
            limit = -temperature * math.log(1.0 - draws[0])
            move = draws[1] * 3
            moves[int(move)](move % 1, draws[2], draws[3], draws[4], limit)

    def _switch_edge(self, pick: float, where: float, way: float, _: float, limit: float) -> None:
        """Take one corridor away and open another, if everything stays connected."""
        if not self.edges:
            return
        i = int(pick * len(self.edges))
        old, old_way = self.edges[i]
        new, new_way = self.nodes[int(where * len(self.nodes))], int(way * 4)
        other = new + self.step[new_way]
        if not self.taken[other] or self.corridor[new] >> new_way & 1:
            return
        end = old + self.step[old_way]
        cells = self._around(old, end, new, other)
        before = self._energy(cells)
        self._flip(old, old_way)
        self._flip(new, new_way)
        if self._energy(cells) - before > limit or not self._joined(old, end):
            self._flip(old, old_way)
            self._flip(new, new_way)
            return
        self.edges[i] = (new, new_way)

    def _move_leaf(self, pick: float, where: float, way: float, _: float, limit: float) -> None:
        """Cut off a dead end without rooms and let it grow elsewhere."""
        i = int(pick * len(self.nodes))
        leaf = self.nodes[i]
        bits = self.corridor[leaf]
        root, new_way = self.nodes[int(where * len(self.nodes))], int(way * 4)
        target = root + self.step[new_way]
        if (
            bits not in (1, 2, 4, 8)
            or self.room[leaf]
            or root == leaf
            or not self.inside[target]
            or (self.taken[target] and target != leaf)
            or self.holder[target] >= 0
        ):
            return
        old_way = bits.bit_length() - 1
        cells = self._around(leaf, leaf + self.step[old_way], root, target)
        before = self._energy(cells)
        self._flip(leaf, old_way)
        self._flip(root, new_way)
        self.taken[leaf] = False
        self.taken[target] = True
        if self._energy(cells) - before > limit:
            self._flip(root, new_way)
            self._flip(leaf, old_way)
            self.taken[target] = False
            self.taken[leaf] = True
            return
        self.nodes[i] = target
        ends = {(leaf, old_way), (leaf + self.step[old_way], (old_way + 2) % 4)}
        j = next(j for j, edge in enumerate(self.edges) if edge in ends)
        self.edges[j] = (root, new_way)

    def _move_room(self, pick: float, where: float, way: float, _: float, limit: float) -> None:
        """Give a room that has no place one, or move one to another free side."""
        node, new_way = self.nodes[int(where * len(self.nodes))], int(way * 4)
        cell = node + self.step[new_way]
        if self.taken[cell] or self.holder[cell] >= 0:
            return
        if self.missing:
            self.missing -= 1
            self._hang(node, new_way)
            return
        if not self.rooms:
            return
        i = int(pick * len(self.rooms))
        old, old_way = self.rooms[i]
        cells = {old, node}
        before = self._energy(cells)
        self.room[old] ^= 1 << old_way
        self.room[node] ^= 1 << new_way
        if self._energy(cells) - before > limit:
            self.room[old] ^= 1 << old_way
            self.room[node] ^= 1 << new_way
            return
        self.holder[old + self.step[old_way]] = -1
        self.holder[cell] = node
        self.rooms[i] = (node, new_way)

    def _hang(self, node: int, way: int) -> None:
        self.room[node] |= 1 << way
        self.holder[node + self.step[way]] = node
        self.rooms.append((node, way))

    def _add_start_room(self, rng: np.random.Generator) -> bool:
        """Hang the last room below the lowest row, as central as can be, or else on any free side."""
        lowest = min(node // self.stride for node in self.nodes)
        columns = [node % self.stride for node in self.nodes]
        middle = (min(columns) + max(columns)) / 2
        sides = [
            (node, way)
            for node in sorted(self.nodes)
            for way in range(4)
            if not self.taken[node + self.step[way]] and self.holder[node + self.step[way]] < 0
        ]
        if not sides:
            return False

        def below(sides: list[tuple[int, int]]) -> list[tuple[int, int]]:
            found = [(node, way) for node, way in sides if way == SOUTH and node // self.stride == lowest]
            return sorted(found, key=lambda side: (abs(side[0] % self.stride - middle), side[0]))

        self._hang(*(below(sides) or [sides[int(rng.integers(len(sides)))]])[0])
        start = below(self.rooms)[0]
        self.rooms.remove(start)
        self.rooms.insert(0, start)  # the plan takes the first room for the start
        return True
