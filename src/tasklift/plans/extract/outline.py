"""The outline of a space as straight walls."""

from __future__ import annotations

import math
from collections.abc import Iterator

import numpy as np
from numpy.typing import NDArray

from tasklift.plans.extract.paths import Points, simplify, straight

# a wall ends where the outline turns away from the floor by more (rad)
TURN = 0.7
# the end of a wall is blunt: a line that comes so close (cells) has come to it
BLUNT = 2


class Outline:
    """The straight walls around and within a space; the floor is on one side of each.

    ``middle``, ``ahead`` and ``inward`` are ``float64 (W, 2)`` in cells, rows and columns: a point in the middle of
    each wall, its direction, and the direction to the floor, both of length one. ``reach (W, 2)`` says how far
    (cells) a wall extends from its middle, back and ahead, ``length (W,)`` the sum;
    ``next`` and ``last`` are the walls that follow and precede it along the outline.
    """

    def __init__(self, free: NDArray[np.bool_], tolerance: float):
        """Straighten the outline of what is ``free``: no cell of it is farther than ``tolerance`` cells from a wall."""
        from scipy.spatial import KDTree
        from skimage.measure import find_contours

        rows: list[tuple[Points, Points, float, float]] = []
        points, owner, following, before = [], [], [], []
        for line in find_contours(free.astype(np.float32), 0.5):
            # the point farthest from the middle is a corner: no wall is cut in two where the outline begins
            first = int(((line - line.mean(axis=0)) ** 2).sum(axis=1).argmax())
            line = np.concatenate([line[first:], line[1 : first + 1]])
            corners = simplify(line, tolerance)
            for first, last in zip(corners[:-1].tolist(), corners[1:].tolist(), strict=True):
                piece = line[first : last + 1]
                middle = piece.mean(axis=0)
                ahead = _direction(piece - middle, piece[-1] - piece[0])
                along = (piece - middle) @ ahead
                points.append(piece)
                owner.append(np.full(len(piece), len(rows)))
                rows.append((middle, ahead, float(along.min()), float(along.max())))
            here = np.arange(len(rows) - len(corners) + 1, len(rows))
            following.append(np.roll(here, -1))
            before.append(np.roll(here, 1))
        self.middle = np.array([row[0] for row in rows])
        self.ahead = np.array([row[1] for row in rows])
        # find_contours keeps the larger values, the floor, on one side
        self.inward = np.column_stack([self.ahead[:, 1], -self.ahead[:, 0]])
        self.reach = np.array([row[2:] for row in rows])
        self.length = self.reach[:, 1] - self.reach[:, 0]
        self.next, self.last = np.concatenate(following), np.concatenate(before)
        self._owner = np.concatenate(owner)
        self._tree = KDTree(np.concatenate(points))

    def near(self, point: Points, radius: float) -> NDArray[np.int64]:
        """The walls within ``radius`` of a point."""
        return np.unique(self._owner[self._tree.query_ball_point(point, radius)])

    def beside(self, walls: NDArray[np.int64], point: Points) -> Points:
        """The points ``(n, 2)`` on the lines of these walls that are nearest to a point."""
        ahead = self.ahead[walls]
        return self.middle[walls] + ((point - self.middle[walls]) * ahead).sum(axis=1)[:, None] * ahead

    def gaps(self, half: NDArray[np.float32], shortest: float, longest: float) -> Iterator[NDArray[np.int64]]:
        """The gaps in walls: from where a wall ends straight on to the next wall.

        Yields the cells ``(n, 2)`` of the line across, from wall to wall.

        Parameters
        ----------
        half
            The distance (cells) of each cell to the nearest wall.
        shortest, longest
            The least length of the wall, and the greatest of the gap (cells).
        """
        for wall in np.flatnonzero(self.length >= shortest).tolist():
            for sign, other in ((1, self.next[wall]), (-1, self.last[wall])):
                ahead = sign * self.ahead[wall]
                on = sign * self.ahead[other]
                if math.atan2(float(on @ self.inward[wall]), float(on @ ahead)) > -TURN:
                    continue
                end = self.middle[wall] + self.reach[wall, (sign + 1) // 2] * self.ahead[wall] - self.inward[wall]
                line = np.rint(end + np.arange(-BLUNT, longest + BLUNT)[:, None] * ahead).astype(np.int64)
                line = line[((line >= 0) & (line < half.shape)).all(axis=1)]
                clear = half[tuple(line.T)] > BLUNT
                start = int(clear.argmax())
                length = int((~clear[start:]).argmax())
                if length:
                    middle = line[start : start + length]
                    ends = _wall_by(half, middle[0]), _wall_by(half, middle[-1])
                    yield np.concatenate([straight(ends[0], middle[0]), middle, straight(middle[-1], ends[1])])


def _wall_by(half: NDArray[np.float32], cell: NDArray[np.int64]) -> NDArray[np.int64]:
    """The wall cell next to a cell that is no more than a few from it."""
    low = np.maximum(cell - 2 * BLUNT, 0)
    near = np.argwhere(half[low[0] : cell[0] + 2 * BLUNT + 1, low[1] : cell[1] + 2 * BLUNT + 1] == 0) + low
    return near[np.argmin(((near - cell) ** 2).sum(axis=1))] if len(near) else cell


def _direction(offsets: Points, towards: Points) -> Points:
    """The direction in which points with these offsets from their mean extend, ``towards`` rather than back."""
    (rows, both), (_, columns) = (offsets.T @ offsets).tolist()
    angle = math.atan2(2 * both, rows - columns) / 2  # of the larger principal axis
    direction = np.array([math.cos(angle), math.sin(angle)])
    return direction if direction @ towards >= 0 else -direction
