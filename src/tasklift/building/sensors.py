"""What robots sense: one small function per input, compiled into the kernel.

Each takes ``(world, rules, lane, r, numbers)`` and returns the position of the input's value, counted from 0. The first
three are the tuples of :mod:`tasklift.building.layout`, ``r`` is the robot's number, and ``numbers`` are the sensor's
numbers for this kind of robot. A sensor reads the state and changes nothing. It is read when the robot decides.
:mod:`tasklift.building.variables` has names and meanings.
"""

from __future__ import annotations

import numpy as np

from tasklift.building.randomness import DETECTOR_DRAW, inline, uniform

__all__ = ["uniform"]


@inline
def danger_level(world, rules, lane, r, numbers):
    """DL: nothing, suspected, attacked."""
    return lane.robots[r].dl


@inline
def goal_known(world, rules, lane, r, numbers):
    """GL: whether the robot heads for a node."""
    return 1 if lane.robots[r].goal >= 0 else 0


@inline
def weapon_robots(world, rules, lane, r, numbers):
    """nWPN: no weapon robot in the team, fewer than m, enough."""
    return lane.teams[lane.robots[r].team].weapons


@inline
def feature_faced(world, rules, lane, r, numbers):
    """FTR: the class of the unresolved feature at which the robot is."""
    robot = lane.robots[r]
    return lane.sites[robot.node].faced if robot.half < 0 else np.int64(0)


@inline
def team_size(world, rules, lane, r, numbers):
    """TEAM: one robot, two, three, more."""
    return min(lane.teams[lane.robots[r].team].size, 4) - 1


@inline
def waited(world, rules, lane, r, numbers):
    """WAITED: steps at this node, below, from or long above the two numbers; 0 under way."""
    robot = lane.robots[r]
    steps = lane.count[0].step - robot.arrived
    return 0 if robot.half >= 0 or steps < numbers[0] else (1 if steps < numbers[1] else 2)


@inline
def unexplored_exits(world, rules, lane, r, numbers):
    """EXITS: corridors at this node that are not in the robot's map: none, one, more; none under way."""
    robot = lane.robots[r]
    n = 0
    if robot.half < 0:
        for j in range(world.nodes[robot.node].first, world.nodes[robot.node].last):
            edge = world.halves[j].edge
            known = (lane.maps[r, edge >> 6] >> np.uint64(edge & 63)) & np.uint64(1)
            n += 1 if known == np.uint64(0) else 0
    return min(n, 2)


@inline
def goal_distance(world, rules, lane, r, numbers):
    """FAR: without a goal, or the straight distance from the last node to it: below, from or beyond the two numbers."""
    robot = lane.robots[r]
    to = robot.goal
    if to < 0:
        return 0
    dx = world.nodes[robot.node].x - world.nodes[to].x
    dy = world.nodes[robot.node].y - world.nodes[to].y
    square = dx * dx + dy * dy
    return 1 if square < numbers[0] * numbers[0] else (2 if square < numbers[1] * numbers[1] else 3)


@inline
def robots_lost(world, rules, lane, r, numbers):
    """LOST: robots lost so far in this episode (trial): none, one, more."""
    return min(lane.count[0].losses, 2)


@inline
def alarm(world, rules, lane, r, numbers):
    """ALARM: whether the detector signals a hostile within its range of the last node; one draw per visit to a node."""
    robot = lane.robots[r]
    if numbers[0] <= 0.0:
        return 0
    chance = numbers[2]
    for k in range(world.candidates.shape[0]):
        place = world.candidates[k]
        dx = world.nodes[robot.node].x - world.nodes[place].x
        dy = world.nodes[robot.node].y - world.nodes[place].y
        if lane.sites[place].hostile == 1 and dx * dx + dy * dy <= numbers[0] * numbers[0]:
            chance = 1.0 - numbers[1]
    return 1 if uniform(lane.count[0].key, r, DETECTOR_DRAW, robot.arrived) < chance else 0
