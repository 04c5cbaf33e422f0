"""CovA: the share of a building's area that lies on each corridor's side of a node (paper, Fig. 2a).

The plane around a node is divided by the bisectors of the angles between neighbouring corridors; the outline
cuts each sector off, in a strict geometric sense, whether or not walls lie between.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

# Directions that differ by less than this part of a full turn are one direction (0.6 nanoradians)
_DIRECTIONS = 10**10


def coverage(
    position_m: NDArray[np.float64],
    outline_m: NDArray[np.float64],
    indptr: NDArray[np.int64],
    neighbour: NDArray[np.int64],
) -> NDArray[np.float64]:
    """Return CovA of every half-edge at its node; the parameters are a :class:`.Building`'s arrays of these names.

    Corridors that leave a node in the same direction share their sector evenly; a node's only corridor has
    all of the area. The sectors of a node divide the whole plane, so this holds wherever the node lies.

    Returns
    -------
    float64 (2E,)
        In the order of ``neighbour``; at least 0, sums to 1 at every node.
    """
    import shapely

    outline = shapely.Polygon(outline_m)
    share = np.empty(len(neighbour))
    found, groups, nodes = [], [], []
    for node, position in enumerate(position_m):
        here = slice(indptr[node], indptr[node + 1])
        ring, group = rings(position, position_m[neighbour[here]], outline_m)
        if len(ring) == 1:
            share[here] = 1 / len(group)
        else:
            found.append(ring)
            groups.append(group)
            nodes.append(here)
    if not found:
        return share
    area = shapely.area(shapely.intersection(shapely.polygons(np.concatenate(found)), outline))
    first = 0
    for ring, group, here in zip(found, groups, nodes, strict=True):
        of_sector = area[first : first + len(ring)]
        first += len(ring)
        # Sectors partition the plane: only rounding may be missing
        assert abs(of_sector.sum() / outline.area - 1) < 1e-6, "sectors do not add up to the outline"
        of_edge = (of_sector / np.bincount(group))[group]
        share[here] = of_edge / of_edge.sum()
    return share


def rings(
    here: NDArray[np.float64], ways: NDArray[np.float64], outline_m: NDArray[np.float64]
) -> tuple[NDArray[np.float64], NDArray[np.int64]]:
    """Return the sectors of a node at ``here`` (2,) with corridors towards ``ways`` (k, 2).

    Returns
    -------
    float64 (G, 7, 2)
        A ring for each of the G directions, large enough for the outline. With a single direction there is one
        sector, the whole plane, and its ring means nothing.
    int64 (k,)
        Each corridor's sector.
    """
    offset = ways - here
    angle = np.arctan2(offset[:, 1], offset[:, 0])
    key = np.round(angle * (_DIRECTIONS / (2 * np.pi))).astype(np.int64) % _DIRECTIONS
    _, first, group = np.unique(key, return_index=True, return_inverse=True)
    direction = angle[first]
    gap = np.mod(np.roll(direction, -1) - direction, 2 * np.pi)
    low, width = direction - np.roll(gap, 1) / 2, (gap + np.roll(gap, 1)) / 2
    # With two or more directions a sector spans at most half a turn, so the ring's chords stay 1.38 times as
    # far from the node as the farthest point of the outline
    ray = low[:, None] + width[:, None] * np.linspace(0, 1, 5)
    radius = 1.5 * np.sqrt(((outline_m - here) ** 2).sum(axis=1).max())
    ring = np.empty((len(direction), 7, 2))
    ring[:, [0, 6]] = here
    ring[:, 1:6, 0] = here[0] + radius * np.cos(ray)
    ring[:, 1:6, 1] = here[1] + radius * np.sin(ray)
    return ring, group
