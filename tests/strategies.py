"""Random buildings, teams, readings and policies for the property tests."""

from __future__ import annotations

import numpy as np
from hypothesis import strategies as st

from tasklift.building.graph import FEATURE, INTERSECTION, ROOM, Building
from tasklift.building.mission import Mission
from tasklift.building.reading import Reading
from tasklift.building.search import hostile_candidates
from tasklift.building.team import Kind
from tasklift.learning.reinforcement import Reinforcement

readings = st.builds(
    Reading,
    decide=st.sampled_from(["robot", "team"]),
    patience=st.sampled_from([1, 2, 7, 60, 90]),
    split=st.sampled_from(["robots", "pairs", "team"]),
    turn_back=st.booleans(),
    explore=st.sampled_from(["unvisited-first", "memoryless"]),
    goal_sharpness=st.sampled_from([0.0, 0.5, 1.0, 2.0]),
    engage=st.sampled_from(["team", "crossing"]),
    alert_range_m=st.sampled_from([0.0, 4.0, 10.0, 25.0]),
    suspicion_goal=st.booleans(),
    share_map=st.sampled_from(["team", "radio", "none"]),
    relocate=st.booleans(),
    drill=st.booleans(),
)

reinforcements = st.builds(
    Reinforcement,
    sweep_credit=st.sampled_from(["all", "visited"]),
    credit=st.sampled_from(["decision", "trial"]),
    time_signal=st.sampled_from(["inverted", "baseline", "none"]),
    selection=st.sampled_from(["exploration", "pseudo-random", "exploitation"]),
    q=st.sampled_from([0.5, 0.9]),
    floor=st.sampled_from([0.0, 0.25]),
    loss_signal=st.sampled_from([0.0, -0.5]),
)


def random_building(rng: np.random.Generator, n_nodes: int) -> Building:
    """A connected graph of nodes in general position: a random tree and a few corridors more."""
    kind = rng.choice([ROOM, INTERSECTION, FEATURE, FEATURE], n_nodes)
    feature_class = np.where(kind == FEATURE, rng.choice([2, 3, 4, 4, 4, 5], n_nodes), 1)
    position = rng.uniform(0, 6 * np.sqrt(n_nodes), (n_nodes, 2)).round(2)
    edges = {(int(rng.integers(v)), v) for v in range(1, n_nodes)}
    for _ in range(int(rng.integers(0, n_nodes))):
        a, b = sorted(rng.choice(n_nodes, 2, replace=False).tolist())
        edges.add((a, b))
    order = np.array(sorted(edges))
    straight = np.linalg.norm(position[order[:, 0]] - position[order[:, 1]], axis=1)
    return Building(
        name="random",
        kind=kind,
        feature_class=feature_class,
        position_m=position,
        area_m2=np.where(kind == ROOM, rng.uniform(1, 40, n_nodes).round(1), 0.0),
        obstacles=np.where(kind == ROOM, rng.integers(0, 4, n_nodes), 0),
        edges=order,
        length_m=np.maximum(0.5, straight.round(2)),
        width_m=rng.choice([0.8, 1.5, 2.0, 3.0], len(order)),
        start=int(rng.integers(n_nodes)),
    )


@st.composite
def missions(draw, most_nodes=14, most_robots=12, readings=readings):
    """A random mission; about one in three without any hostile."""
    rng = np.random.default_rng(draw(st.integers(0, 2**32 - 1)))
    building = random_building(rng, draw(st.integers(2, most_nodes)))
    kinds = [
        Kind("scout", 1500, False),
        Kind("weapon", 1000, True),
        Kind("tank", 700, True),
        Kind("bee", 2600, False),
    ]
    total = draw(st.integers(1, most_robots))
    split = rng.multinomial(total, rng.dirichlet(np.ones(4)))
    team = {kind: int(n) for kind, n in zip(kinds, split, strict=True)}
    armed = int(split[1] + split[2])
    features = np.flatnonzero(building.kind == FEATURE)
    hostiles: int | tuple[int, ...] = 0
    if armed:
        way = int(rng.integers(3))
        if way == 0:
            hostiles = min(len(hostile_candidates(building)), int(rng.integers(1, 4)))
        elif way == 1 and len(features):
            chosen = rng.choice(features, min(len(features), int(rng.integers(1, 4))), replace=False)
            hostiles = tuple(int(v) for v in chosen)
    return Mission(
        building,
        team,
        hostiles=hostiles,
        reading=draw(readings),
        weapons_needed=int(rng.integers(1, armed + 1)) if armed else 1,
        limit=int(rng.integers(20, 120)),
    )
