"""What the kernel works on: record types for robots, places and teams, and the tuples of arrays that hold them.

Shapes: ``N`` nodes, ``E`` edges, ``H = 2 E`` half-edges, ``R`` robots, ``S0`` inputs of the full task, ``S`` and ``A``
inputs and outputs of the task that is learned, ``W`` 64-bit words of an edge set. Robots, nodes, teams and outputs are
rows of record arrays: one array per thing keeps the call between phases cheap and a robot's fields together.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np


def _record(**fields: str) -> np.dtype:
    return np.dtype(list(fields.items()), align=True)


# Numbers that index something are unsigned, where they are never -1: the compiler then need not ask for negative ones.
NODE = _record(x="f8", y="f8", feature="i8", first="u4", last="u4", near_first="u4", near_last="u4")
HALF = _record(to="u4", edge="u4", back="u4", cost_mm="i8", coverage="f8")  # back: the same way in reverse
MEMBER = _record(speed_mm="i8", armed="i8", kind="u4")
OUTPUT = _record(way="i4", wpn="i4", ca="f8")  # way: kernel.STAYS, ...
ROBOT = _record(  # 128 bytes
    decided="i8", planned="i8", arrives="i8", entered="i8",  # ticks; entered: it came to its place, or was lost
    passed="i8", pace="i4",  # under way only: mm that lay behind it at the tick `planned`, mm per step
    node="u4", half="i4", next="i4", came="i4",  # the last node, and half-edges: under way, chosen, back; -1: none
    row="i4", seen="i4",  # at its last decision: its input of Table I, and its row of the mission's table
    pair_row="u4", out="u4", decisions="u4", choices="u4",
    noted="u4",  # the entry of the agenda that holds its bit
    team="u4", after="i4", before="i4", arrived="i4",  # the step in which it came to `node`
    alert="i4", goal="i4", alarmed="i4",  # the node that it heads for, -1 for none; what DL and GL add to the input
    alive="u1", due="u1", going="u1", repelled="u1", crossing="u1", stopping="u1", listens="u1", dl="u1",
    unsettled="u1",  # whether it is planned anew at the end of the step
)  # fmt: skip
SITE = _record(
    crossed="i8", failed="i8", picking="i8",  # the tick at which it last was
    faced="i4", unsearched="i4", armed_crossing="i4", stoppers="i4", picks="i4", hostile="u1", resolved="u1",
)  # fmt: skip
PLACE = _record(  # a node, or N + a half-edge
    touched="i8", unsettled="i8", first="i4",  # the ticks at which it, or a robot there, last was; a robot, -1: none
)  # fmt: skip
TEAM = _record(formed="i8", slowest="i8", lead="u4", size="i4", armed="i4", weapons="u1", due="u1", learned="u1")
SLOT = _record(tick="i8", passed="i8", place="u4", team="u4")
COUNT = _record(
    step="i8", alive="i8", awake="i8", touched="i8", unsettled="i8", stopping="i8", edges_left="i8", rooms_left="i8",
    rooms_open="i8", hostiles_left="i8", losses="i8", cleared="i8", messages="i8", tick="i8",
    robot_steps="i8", arrivals="i8", outside="i8", key="u8",
)  # fmt: skip
PAY = _record(progress="f8", loss="f8", success="f8", signal="f8", team_share="f8")  # what a steered simulation rewards

#: Classes of robots in one corridor, by progress and pace, whose meetings are foreseen; with more it is watched.
CLASSES = 8

#: Ticks ahead for which it is noted who wakes, a power of two.
AGENDA = 64


class World(NamedTuple):
    """What never changes in a mission: the building, the team, what lies within earshot."""

    nodes: Any  # NODE (N,)
    halves: Any  # HALF (H,): each node's half-edges from `first` to `last`, by ascending neighbour
    near: Any  # uint32: features within the alert range of each node, by descending id, `near_first` to `near_last`
    search: Any  # int64 (N,): steps to search each room, 0 elsewhere
    candidates: Any  # uint32: nodes where hostiles may be hidden
    members: Any  # MEMBER (R,)
    numbers: Any  # float64 (kinds, P): what the mission's sensors are given, by kind of robot


class Rules(NamedTuple):
    """The Reading and the mission's numbers, as scalars."""

    start: int
    rooms: int
    hostiles: int
    placed: int  # 1: the hostiles stand on `candidates` themselves
    relocate: int
    weapons_needed: int
    limit: int
    patience: int
    by_team: int
    split: int  # kernel.SPLIT_…
    turn_back: int
    unvisited_first: int
    sharpness: float
    engage_crossing: int
    suspicion_goal: int
    share_map: int  # kernel.SHARE_…
    drill: int
    alerts: int  # 0 in a mission without hostiles: nothing to suspect


class Learner(NamedTuple):
    """The task's tables and how its weights change."""

    rows: Any  # int64 (S0,): the task's row of each input of the full task, -1: outside
    outputs: Any  # OUTPUT (A,)
    signal: Any  # float64 (S, A): local signals
    learn: int
    at_once: int  # 1: signals change weights as they come
    sweep_all: int  # 1: one output per trial, credited in every input at the end
    greedy: float  # probability of taking the heaviest output: 0 exploration, 1 exploitation
    floor: float
    once: int  # 1: a local signal reaches its pair once per trial
    time_signal: int  # kernel.TIME_…
    time_reward: float
    loss_signal: float


class Lane(NamedTuple):
    """One simulation under way. Everything here is written to."""

    robots: Any  # ROBOT (R,)
    given: Any  # int64 (R,): the output of each robot's next decisions, -1: drawn
    roster: Any  # uint32 (R,): the living, ascending, first `count.alive` entries
    agenda: Any  # uint64: of each tick to come, modulo AGENDA, a bit for each robot that wakes then: see `kernel.page`
    awake: Any  # uint32 (R,): who wakes at a node, then who leaves a feature, ascending, first `count.awake` entries
    sites: Any  # SITE (N,)
    places: Any  # PLACE (N + H,)
    touched: Any  # uint32 (N + H,): the places that are regrouped at the end of a step, first `count.touched` entries
    unsettled: Any  # uint32 (R,): who is planned anew at the end of a step, first `count.unsettled` entries
    rooms: Any  # uint32 (N,): rooms that are being searched, first `count.rooms_open` entries
    picks: Any  # uint32 (H,): per node, the half-edges chosen in this step, in order
    open: Any  # uint32 (largest degree,): the half-edges that a robot may take
    share: Any  # float64 (largest degree,): p_j over them
    visited: Any  # uint8 (E,)
    maps: Any  # uint64 (R, W): the edges in each robot's map
    pooled: Any  # uint64 (R, W): scratch, by team
    teams: Any  # TEAM (R,): at the number of one of its members
    slots: Any  # SLOT (power of two, at least 2 R,): hash of places to teams
    classes: Any  # int64 (CLASSES, 2): scratch, progress and pace
    used: Any  # uint64 (S, words): of each row, a bit for each output that was used in this trial
    shuffle: Any  # uint32: scratch for placing hostiles
    count: Any  # COUNT (1,)
    weights: Any  # float64 (S, A)
    sums: Any  # float64 (S, more than A): running sums of each row's weights, see `choice.sum_up`
    stale: Any  # int64 (S,): the first output whose sum is not up to date, A: none


class Steered(NamedTuple):
    """``n`` simulations side by side, in each of which every robot's output comes from outside."""

    lanes: Any  # a Lane, each of whose arrays has one more axis in front: (n, …)
    keys: Any  # uint64 (n, 2): of each, the hash of (seed, map, stage) and of (seed, map)
    trials: Any  # int64 (n,): the number of the trial under way
    pay: Any  # PAY (1,)
    outputs: Any  # int64 (n, R), in: those of the lost are not looked at
    state: Any  # int64 (n,): GOES_ON, or how the trial ended
    rows: Any  # int64 (n, R): every robot's input, its row of the mission's table
    alive: Any  # uint8 (n, R)
    decides: Any  # uint8 (n, R): who decides in the next step; the outputs of the others are not looked at
    lost: Any  # uint8 (n, R): who took part in a failed attack in the last step
    rewards: Any  # float64 (n, R): of the last step
