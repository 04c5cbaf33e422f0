"""V's coverage coefficient over many maps: where low CA is faster, where it makes no difference, and why.

The paper shows one map on which the weights fall as CA rises (Figure 3a, 3c; claim C1) and one without a
trend (Figure 3b, 3d; claim C2). Here V is learned on many generated maps: cells of the arm ``v``. The two maps that
are shown are chosen by their slopes on the even seeds; what is shown of them comes from their odd seeds only.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any, Literal, NamedTuple

import numpy as np
from numpy.typing import NDArray

from tasklift.building.graph import INTERSECTION, ROOM, Building
from tasklift.building.reading import PRESETS, SCATTERED
from tasklift.building.search import SEARCH_TIME_REWARD
from tasklift.building.simulator import edge_cost_mm, search_steps
from tasklift.checks import whole_number
from tasklift.errors import TaskliftError
from tasklift.lab import Cell, Store
from tasklift.stats import Interval, compare, holm
from tasklift.studies.arms import SOURCE
from tasklift.studies.claims import NO_TREND, on_maps
from tasklift.studies.samples import SLOPE, Coverage
from tasklift.studies.study import Condition, Part, Study, generated, numbered

#: The survey's maps are generated from this seed on. The properties below were devised on the maps 1000 to
#: 1059 and a study's own maps begin at 0: what the survey says of either it says on maps not seen before.
FIRST_MAP_SEED = 2000
#: Seeds on every map; and how many odd ones the two maps that are shown have in the end.
SEEDS, SHOWN = 12, 40

Half = Literal["even", "odd", "all"]


@dataclass(frozen=True, eq=False)
class Surveyed:
    """What V taught about CA on one map.

    Attributes
    ----------
    building
        The map.
    seeds
        ``int64 (n,)``.
    weights
        ``float64 (n, 11)``: mean weight by CA of the outputs that move (Figure 3c, 3d).
    steps
        ``float64 (n, 11)``: mean steps of their trials.
    """

    building: Building
    seeds: NDArray[np.int64]
    weights: NDArray[np.float64]
    steps: NDArray[np.float64]

    @cached_property
    def slopes(self) -> NDArray[np.float64]:
        """``float64 (n,)``: least-squares slope of weight on CA, per seed (weight per unit of CA)."""
        return np.asarray(self.weights @ SLOPE)

    def rows(self, half: Half) -> NDArray[np.bool_]:
        """``bool (n,)``: the seeds of a half.

        Raises
        ------
        TaskliftError
            If there are none.
        """
        if half not in ("even", "odd", "all"):
            raise TaskliftError(f"half of the seeds: expected even, odd or all, found {half!r}")
        rows = np.full(len(self.seeds), True) if half == "all" else self.seeds % 2 == (half == "odd")
        if not rows.any():
            raise TaskliftError(f"survey of {self.building.name!r}: no {half} seeds; survey with 2 or more")
        return rows


class Choice(NamedTuple):
    """The two maps of Figure 3, by their places in :attr:`Survey.maps`."""

    a: int
    b: int


@dataclass(frozen=True, eq=False)
class Survey:
    """V learned on many maps.

    Attributes
    ----------
    maps
        What was learned on each, by name.
    repeats
        Traversals per output.
    limit
        The mission's (steps).
    """

    maps: Mapping[str, Surveyed]
    repeats: int
    limit: int

    @classmethod
    def of(cls, store: Store, study: Study, condition: str, names: Sequence[str]) -> Survey:
        """Read the survey of some maps under one condition.

        Parameters
        ----------
        store
            Of the study.
        study
            Has the maps, and the cells of the arm ``v`` on them.
        condition
            One of the study's.
        names
            Of the maps.
        """
        found = Coverage.of(store, SOURCE.slug, **{study.axis: condition})
        maps = {}
        for name in names:
            here = found.maps == name
            maps[name] = Surveyed(
                study.buildings[name], found.seeds[here], found.weights[here], found.steps[here]
            )
        return cls(maps, study.repeats, study.limit)

    @cached_property
    def coverage(self) -> Coverage:
        """All rows together, as C1 and C2 are judged on them."""
        return Coverage(
            maps=np.repeat(list(self.maps), [len(of.seeds) for of in self.maps.values()]),
            seeds=np.concatenate([of.seeds for of in self.maps.values()]),
            weights=np.concatenate([of.weights for of in self.maps.values()]),
            steps=np.concatenate([of.steps for of in self.maps.values()]),
        )

    @cached_property
    def explanations(self) -> list[Explanation]:
        """What :func:`correlate` finds."""
        return correlate(self)

    def mean_slopes(self, half: Half = "all") -> NDArray[np.float64]:
        """``float64 (maps,)``: each map's mean slope over the seeds of a half (weight per unit of CA)."""
        return np.array([of.slopes[of.rows(half)].mean() for of in self.maps.values()])

    def choose(self) -> Choice:
        """Return the map with the steepest fall and the one nearest to no slope, by the even seeds."""
        slopes = self.mean_slopes("even")
        return Choice(int(slopes.argmin()), int(abs(slopes).argmin()))

    def shown(self) -> tuple[str, str]:
        """Return the names of the two maps that :meth:`choose` picks."""
        names = list(self.maps)
        steep, level = self.choose()
        return names[steep], names[level]

    def slope_interval(self, name: str, half: Half = "odd") -> Interval:
        """Return the 95 % interval of a map's mean slope over seeds (weight per unit of CA).

        Parameters
        ----------
        name
            Of the map.
        half
            Which seeds.
        """
        of = self.maps[name]
        return compare(of.slopes[of.rows(half)]).interval

    def margin(self, name: str, half: Half = "odd") -> float:
        """Return C2's margin on a map: the slope (weight per unit of CA) that still counts as no trend.

        A trial of V adds 0.2 · (1 − steps / limit) to the weight of its output, ``repeats`` times. A trial
        time that changes by 5 % of its mean per unit of CA therefore changes the weight by
        ``repeats · 0.2 · 0.05 · mean steps / limit``.
        """
        of = self.maps[name]
        mean_steps = float(of.steps[of.rows(half)].mean())
        return self.repeats * SEARCH_TIME_REWARD * NO_TREND * mean_steps / self.limit

    def in_words(self) -> str:
        """Say what came out over all maps, which maps are shown, and what in a map makes the difference."""
        falls = [one.verdict for one in on_maps(self.coverage, self.coverage.slopes, "below", 0.0).values()]
        level = [one.verdict for one in on_maps(self.coverage, self.coverage.changes, "within", NO_TREND).values()]
        shown = [
            f"map ({letter}) is {self.maps[name].building.name!r}, slope {self.slope_interval(name)}"
            for letter, name in zip("ab", self.shown(), strict=True)
        ]
        found = [
            f"“{row.name}” (rank correlation {row.rho:+.2f}, p {row.p_holm:.2g})"
            for row in self.explanations
            if row.p_holm < 0.05
        ]
        why = (
            f"What makes the difference between maps: {'; '.join(found)}; a positive correlation means: the "
            "larger, the flatter the fall."
            if found
            else "No property in the table goes with the slope beyond chance (p < 0.05 after Holm)."
        )
        return (
            f"V was learned on {len(self.maps)} maps. The weights fall as CA rises on "
            f"{falls.count('holds')} of them, rise on {falls.count('does not hold')}, and the trial time changes by "
            f"less than 5 % on {level.count('holds')} (all seeds; 5 % for all maps together). Chosen by "
            f"the even seeds and measured on the odd ones, {'; '.join(shown)}. {why}"
        )

    def explain(self) -> list[tuple[str, float | None, float | None]]:
        """Return table rows: property, rank correlation with the slope, p after Holm; None: no variation."""
        return [
            (f"{row.name}: {row.meaning}", row.rho, row.p_holm)
            if np.isfinite(row.rho)
            else (f"{row.name}: {row.meaning}; the same on all", None, None)
            for row in self.explanations
        ]


def parts(names: Sequence[str], seeds: int = SEEDS, shown: int = SHOWN) -> tuple[Part, Part]:
    """Return the survey as parts of a study: V on every map, and the further seeds, on maps that are chosen later.

    Parameters
    ----------
    names
        Maps of the study.
    seeds
        On every map 0 to ``seeds`` − 1, at least 2.
    shown
        The two maps that :meth:`Survey.choose` picks get further odd seeds, up to this many: their intervals are to
        be narrow. Odd seeds choose nothing.

    Raises
    ------
    TaskliftError
        For fewer than two seeds.
    """
    whole_number(seeds, "survey, seeds", 2)
    further = tuple(range(seeds + 1 - seeds % 2, 2 * shown, 2))
    every = Part((SOURCE.slug,), tuple(PRESETS), tuple(names), tuple(range(seeds)))
    return every, replace(every, maps=(), seeds=further)


def study(maps: int, *, seeds: int = SEEDS, shown: int = SHOWN, **options: Any) -> Study:
    """Return a study that is a survey and nothing else.

    Parameters
    ----------
    maps
        How many are generated.
    seeds, shown
        As in :func:`parts`.
    options
        As in :class:`.Study`.
    """
    own = surveyed(maps)
    return Study(own, conditions(), parts(list(own), seeds, shown), **options)


def surveyed(maps: int) -> dict[str, Building]:
    """Return the survey's maps by name.

    Raises
    ------
    TaskliftError
        For fewer than one.
    """
    return generated(numbered(maps, "survey", FIRST_MAP_SEED))


def conditions() -> dict[str, Condition]:
    """Return the presets as conditions."""
    return {name: Condition(reading) for name, reading in PRESETS.items()}


def read(store: Store, study: Study) -> dict[str, Survey]:
    """Return the surveys of a study by condition, from its store."""
    return {name: Survey.of(store, study, name, study.parts[-2].maps) for name in study.parts[-2].conditions}


def further(study: Study, surveys: Mapping[str, Survey]) -> list[Cell]:
    """Return the cells of the further seeds, now that each survey has chosen its maps."""
    return [
        study.cell(condition, name, seed, SOURCE.slug)
        for condition, survey in surveys.items()
        for name in dict.fromkeys(survey.shown())
        for seed in study.parts[-1].seeds
    ]


# --- which property of a map makes the difference -----------------------------------------------------------

#: What :func:`map_properties` measures. *Outwards*: away from the start, along shortest ways. A *fork* is a
#: node with two or more ways outwards; shares of CovA are taken among these, as for a robot that comes from
#: the start.
PROPERTIES: dict[str, str] = {
    "corridor length (m)": "all corridors together",
    "loops": "independent cycles of the graph",
    "distance from the start (m)": "mean over the nodes, along corridors",
    "eccentricity of the start (m)": "the farthest node from the start",
    "diameter (m)": "the longest of the shortest ways between two nodes",
    "dead ends (share)": "nodes with one corridor, among all nodes",
    "degree of intersections": "mean number of corridors that meet there",
    "elongation": "long side to short side of the smallest rectangle around the outline",
    "room search (share)": "steps to search the rooms, among these and the steps to walk every corridor once",
    "distance of rooms (ratio)": "mean distance of the rooms from the start, to that of all nodes",
    "largest CovA": "mean over forks of the largest share of CovA",
    "smallest CovA": "mean over forks of the smallest share of CovA",
    "CovA and work behind (r)": "correlation over ways at forks: share of CovA, share of the work there",
    "CovA's error": "mean over forks of the distance between shares of CovA and of work (total variation)",
    "robots to rooms (log2)": "robots that reach the rooms if forks split by CovA, to those of an even split",
    "robots to the loneliest way (log2)": "robots on the least travelled corridor, by CovA to an even split",
}


@dataclass(frozen=True)
class _Ways:
    """A building seen from its start. Costs are steps of a robot that makes a metre in each."""

    distance: NDArray[np.float64]  # (N, N)
    work: NDArray[np.float64]  # (N,): half of each corridor there, and the search of a room
    search: NDArray[np.float64]  # (N,)
    behind: NDArray[np.float64]  # (2E,): the work to which a half-edge is the nearest way from its node
    forks: tuple[NDArray[np.int64], ...]  # at each fork: its half-edges that lead outwards
    onwards: NDArray[np.bool_]  # (2E,): whether a half-edge leads outwards


def _ways(building: Building) -> _Ways:
    from scipy.sparse import csr_array
    from scipy.sparse.csgraph import shortest_path

    n = building.n_nodes
    cost = edge_cost_mm(building.length_m, building.width_m) / 1000
    distance = shortest_path(csr_array((cost, building.edges.T), shape=(n, n)), directed=False)
    search = search_steps(building.kind == ROOM, building.area_m2, building.obstacles, SCATTERED.search_rate_m2).astype(
        np.float64
    )
    work = search + np.bincount(building.edges.ravel(), np.repeat(cost / 2, 2), minlength=n)
    origin = np.repeat(np.arange(n), building.degree)
    along = cost[building.edge_of]
    # a place to which several ways are nearest counts for each of them in equal parts
    first = np.abs(distance[origin] - along[:, None] - distance[building.neighbour]) < 1e-6
    ties = np.maximum(np.add.reduceat(first, building.indptr[:-1], axis=0, dtype=np.float64), 1.0)
    behind = (first / ties[origin]) @ work + along / 2
    from_start = distance[building.start]
    onwards = from_start[building.neighbour] > from_start[origin]
    halves = [np.arange(building.indptr[u], building.indptr[u + 1]) for u in range(n)]
    outwards = [here[onwards[here]] for here in halves]
    return _Ways(distance, work, search, behind, tuple(h for h in outwards if len(h) > 1), onwards)


def _flow(building: Building, ways: _Ways, by_coverage: bool) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """The share of the robots that reach each node (N,) and each corridor (E,) if all go outwards only."""
    nodes, corridors = np.zeros(building.n_nodes), np.zeros(building.n_edges)
    nodes[building.start] = 1.0
    for node in ways.distance[building.start].argsort():
        here = np.arange(building.indptr[node], building.indptr[node + 1])
        here = here[ways.onwards[here]]
        if len(here) == 0:
            continue
        share = building.coverage[here] if by_coverage else np.ones(len(here))
        share = nodes[node] * share / share.sum()
        nodes[building.neighbour[here]] += share
        corridors[building.edge_of[here]] += share
    return nodes, corridors


def map_properties(building: Building) -> dict[str, float]:
    """Return what may decide how CA acts on a map, under the names of :data:`PROPERTIES` (units there)."""
    import shapely

    ways = _ways(building)
    from_start = ways.distance[building.start]
    rectangle = shapely.Polygon(building.outline_m).minimum_rotated_rectangle
    sides = np.hypot(*np.diff(np.asarray(rectangle.exterior.coords)[:3], axis=0).T)
    rooms = np.flatnonzero(building.kind == ROOM)
    rooms = rooms[rooms != building.start]
    crossings = building.degree[building.kind == INTERSECTION]
    walk = ways.work.sum() - ways.search.sum()
    covered = [building.coverage[fork] / building.coverage[fork].sum() for fork in ways.forks]
    work = [ways.behind[fork] / ways.behind[fork].sum() for fork in ways.forks]
    even = [np.full(len(fork), 1 / len(fork)) for fork in ways.forks]
    excess = np.concatenate([np.zeros((2, 0)), *map(np.array, zip(covered, work, strict=True))], axis=1)
    excess = excess - np.concatenate([np.zeros(0), *even])
    spread = np.sqrt((excess**2).sum(axis=1)).prod()
    nodes, corridors = _flow(building, ways, by_coverage=True)
    even_nodes, even_corridors = _flow(building, ways, by_coverage=False)
    travelled = even_corridors > 0  # a corridor between two places equally far is on no shortest way
    values = (
        building.length_m.sum(),
        building.n_edges - building.n_nodes + 1,
        from_start.mean(),
        from_start.max(),
        ways.distance.max(),
        (building.degree == 1).mean(),
        _mean(crossings, 0.0),
        sides.max() / max(sides.min(), 1e-9),
        ways.search.sum() / (ways.search.sum() + walk),
        _mean(from_start[rooms], from_start.mean()) / from_start.mean(),
        _mean([share.max() for share in covered], 1.0),
        _mean([share.min() for share in covered], 1.0),
        (excess[0] @ excess[1]) / spread if spread > 0 else 0.0,
        _mean([abs(c - w).sum() / 2 for c, w in zip(covered, work, strict=True)], 0.0),
        _mean(np.log2(_positive(nodes[rooms]) / even_nodes[rooms]), 0.0),
        np.log2(_positive(corridors[travelled]).min() / even_corridors[travelled].min()),
    )
    return {name: float(value) for name, value in zip(PROPERTIES, values, strict=True)}


def _mean(values: Sequence[float] | NDArray[np.float64], otherwise: float) -> float:
    return float(np.mean(values)) if len(values) else otherwise


def _positive(shares: NDArray[np.float64]) -> NDArray[np.float64]:
    """Shares, kept off zero (CovA may be 0) so that they have a logarithm."""
    return np.maximum(shares, 1e-9)


@dataclass(frozen=True)
class Explanation:
    """How a property of maps goes with their slopes.

    ``rho`` is Spearman's correlation over maps: positive where a larger value goes with a flatter fall; nan
    for a property that is the same on all maps. ``p`` comes from permuting the maps, ``p_holm`` is adjusted
    after Holm for all properties that vary.
    """

    name: str
    meaning: str
    rho: float
    p: float
    p_holm: float


def correlate(survey: Survey, *, permutations: int = 9999, seed: int = 0) -> list[Explanation]:
    """Return how each property of maps goes with their mean slope over all seeds, the strongest first."""
    from scipy.stats import rankdata

    properties = [map_properties(of.building) for of in survey.maps.values()]
    columns = np.array([[row[name] for row in properties] for name in PROPERTIES])
    ranks = np.apply_along_axis(rankdata, 1, columns)
    ranks = ranks - ranks.mean(axis=1, keepdims=True)
    slopes = rankdata(survey.mean_slopes())
    slopes = slopes - slopes.mean()
    norms = np.sqrt((ranks**2).sum(axis=1) * (slopes @ slopes))
    varies = norms > 0
    ranks, norms = ranks[varies], norms[varies]
    rho = ranks @ slopes / norms
    rng = np.random.default_rng(seed)
    shuffled = rng.permuted(np.tile(slopes, (permutations, 1)), axis=1)
    extreme = (abs(shuffled @ ranks.T / norms) >= abs(rho) - 1e-12).sum(axis=0)
    p = (extreme + 1) / (permutations + 1)
    adjusted = holm(p) if len(p) else p
    names = [name for name, varied in zip(PROPERTIES, varies, strict=True) if varied]
    found = [
        Explanation(name, PROPERTIES[name], float(r), float(p_one), float(p_all))
        for name, r, p_one, p_all in zip(names, rho, p, adjusted, strict=True)
    ]
    found.sort(key=lambda row: -abs(row.rho))
    nan = float("nan")
    return found + [Explanation(n, PROPERTIES[n], nan, nan, nan) for n in PROPERTIES if n not in names]
