"""The multi-robot search, one step and one trial at a time, compiled with Numba.

``tests/oracle.py`` is the same world in plain Python and the better first read; the tests hold this file to it
step by step. The phases of a step stand in the order of rule 1 of ``docs/reading.md``.

The oracle looks at every robot in every phase. Here most robots sleep through a step, since nothing can change for them
but their progress: :func:`waking` says when each is looked at again, and decision 43 in ``docs/`` why that is exact.

Contract of everything here: **no bounds checks, no validation**. :mod:`tasklift.building.simulator` validates,
allocates and seeds; these functions fill what they are given. :mod:`tasklift.building.layout` tells the shape of
everything that comes in: ``world``, ``rules``, ``learner`` and ``lane`` are its tuples, and a robot, site or team is a
row of its record arrays.

Randomness is counter-based: every draw is a hash of (seed, map, stage, trial) and (robot, purpose, draw number).
Nothing depends on threads, batches or what other robots drew.
"""

from __future__ import annotations

import numpy as np
from numba import njit

from tasklift.building import bits, layout, randomness, sensors
from tasklift.building.bits import lowest_bit, take_next
from tasklift.building.layout import AGENDA, Lane
from tasklift.building.randomness import (
    EDGE_DRAW,
    FIRST,
    GOLDEN,
    GREEDY_COIN,
    INNER,
    OUTPUT_DRAW,
    PLACE_DRAW,
    UNCHECKED,
    absorb,
    inline,
    uniform,
)
from tasklift.compiled import keep
from tasklift.tasks import choice as scalar
from tasklift.tasks.choice import rarely

COMPILED_IN = bits, layout, randomness, sensors, scalar
# What Python calls, and nothing else does: no wrapper for C.
_entry = keep(*COMPILED_IN, nogil=True, **(UNCHECKED | {"no_cfunc_wrapper": True}))
_once_a_trial = njit(**INNER)  # inlined, it would take registers from the steps

# --- names of the numbers in `Rules` and `Learner`, and of what a step returns -----------------------------------

SPLIT_ROBOTS, SPLIT_PAIRS, SPLIT_TEAM = 0, 1, 2  # rule 7
SHARE_NONE, SHARE_TEAM, SHARE_RADIO = 0, 1, 2  # rule 12
TIME_NONE, TIME_INVERTED, TIME_BASELINE = 0, 1, 2  # rule 19
NEVER = np.int64(2**62)  # a tick that does not come
ARRIVES, DECIDES = np.int64(0), np.int64(1)  # what a robot wakes for
STAYS, GOES, GOES_BACK = 0, 1, 2  # what a robot's output is, by MV and BACK
GOES_ON, SUCCESS, FAILURE, OUTSIDE = 0, 1, 2, 3  # rule 16; OUTSIDE: an input that the task leaves out

_sum_up = inline(scalar.sum_up)
_draw_summed = inline(scalar.draw_summed)
_heaviest = inline(scalar.heaviest)
_reinforced = inline(scalar.reinforce)
_inverted = inline(scalar.time_inverted)
_against_mean = inline(scalar.time_baseline)


# --- keys of random draws: see tasklift.building.randomness ------------------------------------------------------


@_entry
def child_key(key, value):
    """Return :func:`absorb` of an int64, callable from Python."""
    return absorb(key, value)


@_entry
def keys(seed, map_id, stage):
    """Return the uint64 keys of a stage's trials and of the hostiles' places."""
    place_key = absorb(absorb(np.uint64(0), seed), map_id)
    return absorb(place_key, stage), place_key


# --- a step, phase by phase -------------------------------------------------------------------------------------


@inline
def hear(world, rules, lane, r, dl, about):
    """Let robot r know of danger at a feature; note the part of its input that nothing else changes."""
    robot = lane.robots[r]
    robot.dl = dl
    robot.alert = about
    robot.goal = about if dl == 2 or (dl == 1 and rules.suspicion_goal == 1) else np.int64(-1)
    danger = sensors.danger_level(world, rules, lane, r, world.numbers)
    robot.alarmed = danger * 30 + sensors.goal_known(world, rules, lane, r, world.numbers) * 15
    unsettle(world, lane, r)


@inline
def _input(lane, r):
    """Return robot r's input of Table I, numbered in C order: DL, GL, nWPN, FTR."""
    robot = lane.robots[r]
    return _row_of(lane, robot) + (lane.sites[robot.node].faced if robot.half < 0 else np.int64(0))


@inline
def _row_of(lane, robot):
    """Return a robot's input but for the feature that it faces."""
    return robot.alarmed + lane.teams[robot.team].weapons * 5


@inline
def _seen(world, rules, lane, r):
    """Return robot r's input: its row of the mission's table. :mod:`tasklift.building.inputs` puts others here."""
    return lane.robots[r].row


@inline
def reinforce(learner, lane, row, out, signal):
    """Change one weight; the row's running sums are stale from there on."""
    lane.weights[row, out] = _reinforced(lane.weights[row, out], signal, learner.floor)
    lane.stale[row] = min(lane.stale[row], out)


@inline
def credit(learner, lane, row, out):
    """Book the use of (row, out) and apply its local signal at once (rules 17 and 19)."""
    word, bit = out >> 6, np.uint64(1) << np.uint64(out & 63)
    used = lane.used[row, word]
    fresh = used & bit == 0
    lane.used[row, word] = used | bit
    if rarely((learner.at_once == 1) & (fresh | (learner.once == 0))):
        signal = learner.signal[row, out]
        if rarely(signal != 0.0):
            reinforce(learner, lane, row, out, signal)


@inline
def draw_by_weight(lane, row, u):
    """Draw an output in proportion to its weight, from sums that are brought up to date where they are stale."""
    weights, sums = lane.weights[row], lane.sums[row]
    if rarely(lane.stale[row] < weights.shape[0]):
        _sum_up(weights, sums, lane.stale[row])
        lane.stale[row] = weights.shape[0]
    return _draw_summed(weights, sums, u)


@inline
def draw_output(learner, lane, r):
    """Let robot r draw an output for its input (rule 20), or take the one that is given; book it."""
    robot, key = lane.robots[r], lane.count[0].key
    if rarely(learner.rows[np.uint64(robot.seen)] < 0):
        lane.count[0].outside = robot.seen + 1
        return
    row, out = np.uint32(learner.rows[np.uint64(robot.seen)]), lane.given[r]
    if out < 0:
        u = uniform(key, r, OUTPUT_DRAW, robot.decisions)
        if rarely(learner.greedy > 0.0) and uniform(key, r, GREEDY_COIN, robot.decisions) < learner.greedy:
            out = _heaviest(lane.weights[row], u)
        else:
            out = draw_by_weight(lane, row, u)
    robot.decisions += 1
    robot.out = out
    robot.pair_row = row
    credit(learner, lane, row, np.uint32(out))


@inline
def wake_teams(rules, lane):
    """Wake every member of a team in which one is due (rule 5)."""
    robots, teams, count = lane.robots, lane.teams, lane.count[0]
    for i in range(count.alive):
        robot = robots[lane.roster[i]]
        robot.due |= np.int64(count.tick >= robot.decided + rules.patience)
        teams[robot.team].due |= robot.due
    for i in range(count.alive):
        r = lane.roster[i]
        robots[r].due = teams[robots[r].team].due
        if robots[r].due == 1:
            cancel(lane, r)  # an entry for later: it wakes now
            schedule(lane, r, count.tick, DECIDES)
    for i in range(count.alive):
        teams[robots[lane.roster[i]].team].due = 0


@inline
def stops(robot, site):
    """Return whether a robot at a node stops there at an unresolved feature: it does not move on (rule 11)."""
    return (robot.going == STAYS) & (site.faced > 0)


@inline
def decide(world, rules, learner, lane):
    """Let those who wake to it decide, in robot order (rules 5 and 6); list those of them who are at a node.

    Keeps count of who stops at an unresolved feature, and returns whether somebody began to.
    """
    robots, count = lane.robots, lane.count[0]
    began, n_awake = False, 0
    for first in range(0, robots.shape[0], 64):
        bits = lane.agenda[page(count.tick, np.uint32(first), DECIDES)]
        while bits != 0:
            r = lowest_robot(first, bits)
            bits &= bits - np.uint64(1)
            robot = robots[r]
            if robot.due == 1 or count.tick >= robot.decided + rules.patience:
                take_output(world, rules, learner, lane, r)
            robot.crossing = 0
            if rarely(robot.half >= 0):
                lane.agenda[page(count.tick, r, ARRIVES)] |= bit_of(r)
                continue
            lane.awake[np.uint64(n_awake)] = r
            n_awake += 1
            site = lane.sites[robot.node]
            change = np.int64(stops(robot, site)) - robot.stopping
            if rarely(change != 0):
                began |= change > 0
                count.stopping += change
                site.stoppers += change
                robot.stopping += change
    count.awake = n_awake
    return began


@inline
def take_output(world, rules, learner, lane, r):
    """Let robot r see its input and decide, or follow the lead of its team (rule 5)."""
    robot = lane.robots[r]
    robot.row = _input(lane, r)
    robot.seen = _seen(world, rules, lane, r)
    if rarely(rules.by_team == 1) and lane.teams[robot.team].lead != r:
        lead = lane.teams[robot.team].lead
        robot.out = lane.robots[lead].out
        robot.pair_row = lane.robots[lead].pair_row
    else:
        draw_output(learner, lane, r)
    robot.due = 0
    robot.decided = lane.count[0].tick
    robot.repelled = 0
    robot.going = learner.outputs[robot.out].way


@inline
def _listen(world, rules, lane, r):
    """Let a robot that suspects nothing hear of a stop at a nearby feature, the highest-numbered one (rule 11)."""
    robot = lane.robots[r]
    robot.listens = 0
    if robot.dl > 0:
        return
    node = world.nodes[robot.node]
    for k in range(node.near_first, node.near_last):
        site = lane.sites[world.near[k]]
        if site.stoppers > 0 and site.resolved == 0:
            hear(world, rules, lane, r, np.int64(1), np.int64(world.near[k]))
            lane.count[0].messages += 1
            return


@inline
def alert(world, rules, lane):
    """Spread the suspicion of robots that stop at an unresolved feature.

    Who suspects nothing has heard of no earlier stop. So nothing changes but by a stop that has just begun, by a
    suspicion that was resolved, and for a robot that ``listens``: it came to another node. :func:`leave` sees to that.
    """
    count = lane.count[0]
    for i in range(count.alive):
        _listen(world, rules, lane, lane.roster[i])
    count.cleared = 0


@inline
def _knows(lane, r, edge):
    return (lane.maps[r, edge >> 6] >> np.uint64(edge & 63)) & np.uint64(1) == np.uint64(1)


@inline
def open_edges(world, rules, lane, r):
    """List in ``lane.open`` the half-edges that robot r may take from its node (rule 8); return how many."""
    robot, is_open = lane.robots[r], lane.open
    node = world.nodes[robot.node]
    back = node.last - node.first == 1 or (rules.turn_back == 1 and robot.goal >= 0 and robot.goal != robot.node)
    came = np.int64(-1) if back else robot.came
    # this and the other choices between few edges are not rare, but measured faster when laid out as if they were
    if rarely((came >= 0) & (node.last - node.first == 2)):  # nothing but to go on
        is_open[0] = node.first + (node.first == came)
        return 1
    n = 0
    if (rules.unvisited_first == 1) & (robot.goal < 0):
        for half in range(node.first, node.last):
            is_open[np.uint64(n)] = half
            n += not _knows(lane, r, world.halves[half].edge)
        if n > 0:
            return n
    for half in range(node.first, node.last):
        is_open[np.uint64(n)] = half
        n += half != came
    return n


@inline
def _nearness(world, rules, node, goal):
    dx = world.nodes[node].x - world.nodes[goal].x
    dy = world.nodes[node].y - world.nodes[goal].y
    base = 0.5 + np.sqrt(dx * dx + dy * dy)
    if rarely(rules.sharpness != 1.0):
        return 1.0 / base**rules.sharpness
    return 1.0 / base


@inline
def draw_edge(world, rules, learner, lane, r, n_open):
    """Draw one of the open half-edges by p_j = CA · CovA_j + (1 − CA) · GolC_j (rule 9; section IV)."""
    robot, is_open, share = lane.robots[r], lane.open, lane.share
    if rarely(n_open == 1):
        return is_open[0]
    coverage, nearness = 0.0, 0.0
    for j in range(n_open):
        coverage += world.halves[is_open[j]].coverage
    if robot.goal >= 0 and robot.goal != robot.node:
        for j in range(n_open):
            share[j] = _nearness(world, rules, world.halves[is_open[j]].to, robot.goal)
            nearness += share[j]
    ca = learner.outputs[robot.out].ca
    even, running = 1.0 / n_open, 0.0
    for j in range(n_open):
        covered = world.halves[is_open[j]].coverage / coverage if coverage > 0.0 else even
        near = share[j] / nearness if nearness > 0.0 else even
        running += ca * covered + (1.0 - ca) * near
        share[j] = running
    target = uniform(lane.count[0].key, r, EDGE_DRAW, robot.choices) * running
    robot.choices += 1
    j = 0
    while j < n_open - 1 and target >= share[j]:
        j += 1
    return is_open[np.uint64(j)]


@inline
def _among(halves, first, n, half):
    """Return whether a half-edge is among ``n`` of a list, from ``first`` on."""
    found = False
    for k in range(first, first + n):
        found |= halves[k] == half
    return found


@inline
def choose_edge(world, rules, learner, lane, r):
    """Return the half-edge by which robot r leaves, minding what others chose here in this step (rule 7).

    With the output BACK it is the one by which it came; others do not mind that one.
    """
    robot, picks, is_open = lane.robots[r], lane.picks, lane.open
    site, count = lane.sites[robot.node], lane.count[0]
    first = world.nodes[robot.node].first
    if rarely(robot.going == GOES_BACK) and robot.came >= 0:
        return np.uint32(robot.came)
    n_open = open_edges(world, rules, lane, r)
    if rules.split == SPLIT_ROBOTS:
        return draw_edge(world, rules, learner, lane, r, n_open)
    if site.picking != count.tick:
        site.picking = count.tick
        site.picks = 0
    if rules.split == SPLIT_TEAM:
        for k in range(first, first + site.picks):
            if _among(is_open, 0, n_open, picks[k]):
                return picks[k]
    elif site.picks == 2:
        n_both = 0
        for j in range(n_open):
            if _among(picks, first, 2, is_open[j]):
                is_open[n_both] = is_open[j]
                n_both += 1
        n_open = n_both if n_both > 0 else n_open
    half = draw_edge(world, rules, learner, lane, r, n_open)
    if rules.split == SPLIT_TEAM or (site.picks < 2 and not _among(picks, first, site.picks, half)):
        picks[first + site.picks] = half
        site.picks += 1
    return half


@inline
def leave(world, rules, learner, lane, suspicions):
    """Let those who leave choose an edge (rules 7 to 9); mark the features that are crossed (rule 10).

    A fight does not concern who faces no unresolved feature: it departs here. ``lane.awake`` keeps the others. Returns
    whether any unresolved feature is crossed.
    """
    robots, sites, count = lane.robots, lane.sites, lane.count[0]
    crossed, n_facing = False, 0
    for i in range(count.awake):
        r = lane.awake[i]
        robot = robots[r]
        site = sites[robot.node]
        if rarely(suspicions) and robot.listens == 1:
            _listen(world, rules, lane, r)
        if rarely(robot.going == STAYS) or rarely(site.unsearched > 0):
            if robot.unsettled == 0:
                cancel(lane, r)
                sleep(rules, lane, r)
            continue
        half = choose_edge(world, rules, learner, lane, r)
        if rarely(site.faced > 0):
            robot.next = half
            lane.awake[np.uint64(n_facing)] = r
            n_facing += 1
            crossed |= cross(world, lane, r)
        else:
            depart(world, rules, learner, lane, r, half)
    count.awake = n_facing
    return crossed


@inline
def cross(world, lane, r):
    """Mark the feature that robot r faces if its edge leads past it (rule 10); return whether it does."""
    robot, tick = lane.robots[r], lane.count[0].tick
    node, site = world.nodes[robot.node], lane.sites[robot.node]
    if robot.next == robot.came and node.last - node.first > 1:
        return False
    robot.crossing = 1
    if site.crossed != tick:
        site.crossed = tick
        site.armed_crossing = 0
    site.armed_crossing += world.members[r].armed
    return True


@inline
def _resolve(rules, lane):
    """Decide each crossed feature; return the highest and second-highest node of a failed attack, or -1."""
    robots, sites, count = lane.robots, lane.sites, lane.count[0]
    highest, second = np.int64(-1), np.int64(-1)
    for i in range(count.awake):
        robot = robots[lane.awake[i]]
        site = sites[robot.node]
        if robot.crossing == 0 or site.resolved == 1 or site.failed == count.tick:
            continue
        armed = site.armed_crossing if rules.engage_crossing == 1 else lane.teams[robot.team].armed
        if site.hostile == 1 and armed < rules.weapons_needed:
            site.failed = count.tick
            if robot.node > highest:
                highest, second = robot.node, highest
            elif robot.node > second:
                second = robot.node
        else:
            count.hostiles_left -= site.hostile
            site.hostile = 0
            site.resolved = 1
            site.faced = 0
    return highest, second


@inline
def encounter(world, rules, learner, lane):
    """Fight at the crossed features; spread the news (rule 10). A drill repels instead of destroying (rule 21)."""
    robots, sites, count, roster = lane.robots, lane.sites, lane.count[0], lane.roster
    highest, second = _resolve(rules, lane)
    living = 0
    for i in range(count.alive):
        r = roster[i]
        robot = robots[r]
        engaged = (
            robot.half < 0
            and sites[robot.node].failed == count.tick
            and (rules.engage_crossing == 0 or robot.crossing == 1)
        )
        if engaged:
            count.losses += 1
            if learner.loss_signal != 0.0 and learner.at_once == 1:
                reinforce(learner, lane, robot.pair_row, robot.out, learner.loss_signal)
            if rules.drill == 0:
                robot.alive = 0
                robot.entered = count.tick
                cancel(lane, r)
                count.stopping -= robot.stopping
                sites[robot.node].stoppers -= robot.stopping
                robot.stopping = 0
                robot.next = -1
                take_out(lane, r, robot.node)
                continue
            if robot.crossing == 1:
                robot.next = -1
                robot.repelled = 1
                robot.going = STAYS
        news = second if engaged and robot.node == highest else highest
        dl, about = robot.dl, robot.alert
        if about >= 0 and sites[about].resolved == 1:
            dl, about = np.int64(0), np.int64(-1)
            count.cleared = 1
        if news >= 0:
            dl, about = np.int64(2), news
        if robot.dl != dl or robot.alert != about:
            hear(world, rules, lane, r, dl, about)
            count.messages += 1
        roster[living] = r
        living += 1
    count.alive = living


@inline
def _speed(world, learner, lane, r):
    """Return how far a robot comes in a step in which it moves (mm): rules 2 and 15."""
    robot, member = lane.robots[r], world.members[r]
    slowest = lane.teams[robot.team].slowest
    if slowest < member.speed_mm and member.armed == 0 and learner.outputs[robot.out].wpn == 1:
        return slowest
    return member.speed_mm


@inline
def arrive(world, rules, lane, r):
    """Take a robot in at the end of its corridor (rules 2 and 12)."""
    robot, count = lane.robots[r], lane.count[0]
    half = world.halves[np.uint64(robot.half)]
    take_out(lane, r, corridor(world, robot.half))
    robot.node = half.to
    robot.came = half.back
    robot.half = -1
    robot.entered = count.tick
    robot.due = 1
    robot.listens = 1
    robot.arrived = count.step + 1
    lane.maps[r, half.edge >> 6] |= np.uint64(1) << np.uint64(half.edge & 63)
    count.arrivals += 1
    if rarely(lane.visited[half.edge] == 0):
        lane.visited[half.edge] = 1
        count.edges_left -= 1
    others = put_in(lane, r, half.to)
    if rarely((lane.sites[half.to].unsearched > 0) & (not others)):
        lane.rooms[count.rooms_open] = half.to
        count.rooms_open += 1
    if others | (lane.teams[robot.team].size > 1):  # read again: kept from `take_out`, it costs more instructions
        touch(lane, half.to)
    else:
        schedule(lane, r, count.tick + 1, DECIDES)


@inline
def depart(world, rules, learner, lane, r, half):
    """Send a robot into the corridor that it chose, by its first step."""
    robot, tick, place = lane.robots[r], lane.count[0].tick, corridor(world, half)
    in_team = take_out(lane, r, robot.node)
    robot.half = half
    robot.passed = robot.pace = _speed(world, learner, lane, r)
    robot.entered = robot.planned = tick
    robot.arrives = _end_of_way(world, robot, tick)
    others = put_in(lane, r, place)
    if rarely(robot.arrives == tick):  # the corridor is so short
        lane.agenda[page(tick, r, ARRIVES)] |= bit_of(r)
    elif in_team:
        touch(lane, place)
    elif others | (robot.unsettled == 1):
        unsettle(world, lane, r)
    else:
        sleep(rules, lane, r)


@inline
def _end_of_way(world, robot, tick):
    """Return the tick at which a robot that goes on at its pace has come through its corridor."""
    pace, way = np.uint64(robot.pace), np.uint64(world.halves[np.uint64(robot.half)].cost_mm - robot.passed)
    return tick + np.int64((way + pace - np.uint64(1)) // pace)


@inline
def move(world, rules, learner, lane):
    """Send off those who faced a feature and were not held up, and take in who arrives."""
    robots, count = lane.robots, lane.count[0]
    for i in range(count.awake):
        r = lane.awake[i]
        if robots[r].next >= 0:
            depart(world, rules, learner, lane, r, np.uint32(robots[r].next))
            robots[r].next = -1
        elif robots[r].alive == 1:
            unsettle(world, lane, r)
    for first in range(0, robots.shape[0], 64):
        at = page(count.tick, np.uint32(first), ARRIVES)
        bits = lane.agenda[at]
        while bits != 0:
            r = lowest_robot(first, bits)
            bits &= bits - np.uint64(1)
            if rarely(robots[r].arrives > count.tick):
                unsettle(world, lane, r)
            else:
                arrive(world, rules, lane, r)
        lane.agenda[at] = 0
        lane.agenda[page(count.tick, np.uint32(first), DECIDES)] = 0


# --- who is where ------------------------------------------------------------------------------------------------


@inline
def corridor(world, half):
    """Return the number of the place that a half-edge is: they are counted on from the nodes."""
    return np.uint32(world.nodes.shape[0] + half)


@inline
def place_of(world, robot):
    """Return the number of the place at which a robot is, a node or a half-edge."""
    return np.uint32(robot.node) if robot.half < 0 else corridor(world, robot.half)


@inline
def touch(lane, place):
    """Have a place regrouped at the end of the step: teams there may change."""
    count = lane.count[0]
    if lane.places[place].touched != count.tick:
        lane.places[place].touched = count.tick
        lane.touched[count.touched] = place
        count.touched += 1


@inline
def put_in(lane, r, place):
    """Enter a robot in the list of those at a place; return whether there are others."""
    robot, first = lane.robots[r], lane.places[place].first
    robot.before = -1
    robot.after = first
    if first >= 0:
        lane.robots[np.uint64(first)].before = r
    lane.places[place].first = r
    return first >= 0


@inline
def take_out(lane, r, place):
    """Take a robot out of the list of those at a place; return whether it was in a team, which is regrouped then."""
    before, after = lane.robots[r].before, lane.robots[r].after
    if before >= 0:
        lane.robots[before].after = after
    else:
        lane.places[place].first = after
    if after >= 0:
        lane.robots[after].before = before
    in_team = lane.teams[lane.robots[r].team].size > 1
    if in_team:
        touch(lane, place)
    return in_team


@inline
def unsettle(world, lane, r):
    """Have robot r planned anew at the end of the step; with a second one at its place, the place is regrouped."""
    robot, count = lane.robots[r], lane.count[0]
    if robot.unsettled == 1:
        return
    at = place_of(world, robot)
    place = lane.places[at]
    if place.unsettled == count.tick:
        touch(lane, at)
    place.unsettled = count.tick
    robot.unsettled = 1
    lane.unsettled[count.unsettled] = r
    count.unsettled += 1


@inline
def search(lane):
    """Search the rooms that hold a robot, one step's worth each (rule 13); nobody leaves one before that is done."""
    count = lane.count[0]
    left = 0
    for i in range(count.rooms_open):
        node = lane.rooms[i]
        lane.sites[node].unsearched -= 1
        if lane.sites[node].unsearched == 0:
            count.rooms_left -= 1
            touch(lane, node)
        else:
            lane.rooms[left] = node
            left += 1
    count.rooms_open = left


@inline
def team_at(slots, tick, place, passed, fresh):
    """Return the number of the team at a place and as far along it; the first one founds team ``fresh`` (rule 4)."""
    mask = np.uint32(slots.shape[0] - 1)
    address = (np.uint64(place) * FIRST + np.uint64(passed)) * GOLDEN
    at = np.uint32(address >> np.uint64(32)) & mask
    while slots[at].tick == tick:
        if slots[at].place == place and slots[at].passed == passed:
            return slots[at].team
        at = np.uint32(at + 1) & mask
    slot = slots[at]
    slot.tick = tick
    slot.place = place
    slot.passed = passed
    slot.team = fresh
    return fresh


@inline
def came_together(lane, place):
    """Return whether those at a place are one whole team that came there in this step, each as far as the others.

    Then they are the team that they were. They took the same corridor, since two nodes have only one, so their maps
    are equal as before. A team that was formed in this step is not the one that they were in: its founder left them.
    """
    robots, tick, following = lane.robots, lane.count[0].tick, lane.places[place].first
    first = robots[np.uint32(following)]
    team = lane.teams[first.team]
    missing = team.size
    if team.formed == tick:
        return False
    while following >= 0:
        robot = robots[np.uint32(following)]
        if robot.team != first.team or robot.entered != tick or robot.passed != first.passed:
            return False
        missing -= 1
        following = robot.after
    return missing == 0


@inline
def form_teams(world, rules, lane, place):
    """Find the teams at a place (rule 4), numbered by one of their members; pool their maps (rule 12)."""
    robots, maps = lane.robots, lane.maps
    at_node, first = place < world.nodes.shape[0], lane.places[place].first
    differ, following, t = False, first, np.uint32(first)
    while following >= 0:
        r = np.uint32(following)
        robot = robots[r]
        if not at_node:
            come_along(lane, robot)
            if (following == first) | (robot.passed != robots[t].passed):
                t = team_at(lane.slots, lane.count[0].tick, place, robot.passed, r)
        if t == r:
            found_team(world, rules, lane, r)
        else:
            join_team(world, rules, lane, r, t)
            if rules.share_map == SHARE_TEAM:
                for w in range(maps.shape[1]):
                    differ |= maps[r, w] != maps[t, w]
        following = robot.after
    if rarely(differ):
        pool(lane, first)


@inline
def come_along(lane, robot):
    """Bring up to date how far a robot has come along its corridor."""
    robot.passed = progress(lane, robot)
    robot.planned = lane.count[0].tick


@inline
def progress(lane, robot):
    """Return how far a robot has come along its corridor (mm)."""
    return robot.passed + robot.pace * (lane.count[0].tick - robot.planned)


@inline
def stay_alone(world, rules, lane, r):
    """See to it that robot r is a team of its own."""
    if rarely((lane.robots[r].team != r) | (lane.teams[r].size > 1)):
        found_team(world, rules, lane, r)


@inline
def found_team(world, rules, lane, r):
    """Make robot r a team of its own, which has its number."""
    team, member = lane.teams[r], world.members[r]
    lane.robots[r].team = r
    team.formed = lane.count[0].tick
    team.lead = r
    team.size = 1
    team.armed = 0
    team.slowest = NEVER
    team.weapons = 0
    if member.armed == 1:
        arm(rules, team, member)


@inline
def join_team(world, rules, lane, r, t):
    """Take robot r into team t."""
    team, member = lane.teams[t], world.members[r]
    lane.robots[r].team = t
    team.lead = min(team.lead, np.uint32(r))
    team.size += 1
    if member.armed == 1:
        arm(rules, team, member)


@inline
def arm(rules, team, member):
    """Count a weapon robot in a team: how many there are for the inputs, and how fast the slowest is."""
    team.armed += 1
    team.slowest = min(team.slowest, member.speed_mm)
    team.weapons = 1 if team.armed < rules.weapons_needed else 2


@inline
def pool(lane, first):
    """Pool the maps of each team at a place; one message per pooling that taught someone (rules 11, 12)."""
    robots, teams, maps, pooled = lane.robots, lane.teams, lane.maps, lane.pooled
    r = first
    while r >= 0:
        t = robots[r].team
        teams[t].learned = 0
        for w in range(maps.shape[1]):
            pooled[t, w] = maps[r, w] if t == r else pooled[t, w] | maps[r, w]
        r = robots[r].after
    r = first
    while r >= 0:
        t = robots[r].team
        for w in range(maps.shape[1]):
            if maps[r, w] != pooled[t, w]:
                maps[r, w] = pooled[t, w]
                if teams[t].learned == 0:
                    teams[t].learned = 1
                    lane.count[0].messages += 1
        r = robots[r].after


@inline
def pool_all(lane):
    """Pool everyone's maps by radio; one message if that taught someone (rules 11, 12)."""
    maps, pooled, count = lane.maps, lane.pooled, lane.count[0]
    learned = False
    for w in range(maps.shape[1]):
        pooled[0, w] = 0
        for i in range(count.alive):
            pooled[0, w] |= maps[lane.roster[i], w]
        for i in range(count.alive):
            learned |= maps[lane.roster[i], w] != pooled[0, w]
            maps[lane.roster[i], w] = pooled[0, w]
    if learned:
        count.messages += 1


@inline
def regroup(world, rules, learner, lane, place):
    """Find teams and plans anew at a place that was touched."""
    first = lane.places[place].first
    if rarely(first < 0):
        return
    r = np.uint32(first)
    if lane.robots[r].after < 0:
        stay_alone(world, rules, lane, r)
        plan(world, rules, learner, lane, r)
        return
    if came_together(lane, place):  # they woke in this step and keep their pace: nothing to cancel or find anew
        while first >= 0:
            r = np.uint32(first)
            first = lane.robots[r].after
            sleep(rules, lane, r)
        return
    form_teams(world, rules, lane, place)
    n_classes, passed, pace, at_node = np.int64(0), np.int64(-1), np.int64(0), place < world.nodes.shape[0]
    while first >= 0:
        r = np.uint32(first)
        first = lane.robots[r].after
        cancel(lane, r)
        keep_pace(world, learner, lane, r)
        wakes, decides = waking(rules, lane, r)
        meets = wakes
        robot = lane.robots[r]
        if not at_node and (robot.passed != passed or robot.pace != pace):
            meets, n_classes = meeting(lane, r, wakes, n_classes)
            passed, pace = robot.passed, np.int64(robot.pace)
        schedule(lane, r, meets, decides if meets == wakes else ARRIVES)


@inline
def settle(world, rules, learner, lane, r):
    """Plan a robot anew by itself: its team stays as it is. If it meets one or parts now, its place is regrouped."""
    robot, tick = lane.robots[r], lane.count[0].tick
    place = place_of(world, robot)
    robot.unsettled = 0
    if robot.alive == 0 or lane.places[place].touched == tick:
        return
    cancel(lane, r)
    keep_pace(world, learner, lane, r)
    wakes, decides = waking(rules, lane, r)
    meets = wakes
    if robot.half >= 0:
        come_along(lane, robot)
        other = lane.places[place].first
        while other >= 0:
            q = np.uint32(other)
            gap = progress(lane, lane.robots[q]) - robot.passed
            if q != r:
                if (gap == 0) != (lane.robots[q].team == robot.team):
                    touch(lane, place)
                meets = catches_up(gap, robot.pace - lane.robots[q].pace, tick, meets)
            other = lane.robots[q].after
    schedule(lane, r, meets, decides if meets == wakes else ARRIVES)


# --- who wakes when -----------------------------------------------------------------------------------------------


@inline
def plan(world, rules, learner, lane, r):
    """Find anew the pace of a robot that is alone, and when it wakes."""
    cancel(lane, r)
    keep_pace(world, learner, lane, r)
    sleep(rules, lane, r)


@inline
def keep_pace(world, learner, lane, r):
    """Find anew how fast a robot goes on in its corridor, and when it arrives."""
    robot = lane.robots[r]
    if robot.half >= 0:
        pace = _speed(world, learner, lane, r) if robot.going != STAYS else np.int64(0)
        if rarely(pace != robot.pace):
            come_along(lane, robot)
            robot.pace = pace
            robot.arrives = _end_of_way(world, robot, robot.planned) if pace > 0 else NEVER


@inline
def sleep(rules, lane, r):
    """Let a robot sleep until something can change for it; nobody meets it before that, or its place is touched."""
    wakes, decides = waking(rules, lane, r)
    schedule(lane, r, wakes, decides)


@inline
def waking(rules, lane, r):
    """Foresee the tick at which a robot must be looked at again: it *wakes* then. Return also whether to decide.

    Until then it only moves on by its pace. It wakes to decide, for want of patience or since its input has changed, to
    arrive, and where it begins or ends to stop at a feature. What others do to it later (alerts, fights, comings and
    goings at its place) has its place planned anew.
    """
    robot, tick = lane.robots[r], lane.count[0].tick
    if robot.due == 0:
        wakes, decides, row = robot.decided + rules.patience, DECIDES, _row_of(lane, robot)
        if robot.half >= 0:
            if robot.arrives < wakes:
                wakes, decides = robot.arrives, ARRIVES
        else:
            site = lane.sites[robot.node]
            row += site.faced
            if (robot.going != STAYS) & (site.unsearched == 0) | (stops(robot, site) != robot.stopping):
                wakes = tick + 1
        if row == robot.row:
            # what is further off than the agenda reaches wakes it earlier, for nothing
            return min(wakes, tick + AGENDA - 1), decides
        robot.due = 1  # rule 6; the row itself is noted when it decides
    return tick + 1, DECIDES


@inline
def meeting(lane, r, wakes, n_classes):
    """Return the first tick, ``wakes`` at the latest, at which robot r meets or parts from one of those before it.

    ``lane.classes`` has their progress and pace, each once. Return also how many these are with robot r.
    """
    robot, classes, tick = lane.robots[r], lane.classes, lane.count[0].tick
    for c in range(n_classes):
        gap, faster = classes[c, 0] - robot.passed, robot.pace - classes[c, 1]
        if rarely((gap == 0) & (faster == 0)):
            return wakes, n_classes
        wakes = catches_up(gap, faster, tick, wakes)
    if n_classes == classes.shape[0]:
        return tick + 1, n_classes
    classes[n_classes, 0] = robot.passed
    classes[n_classes, 1] = robot.pace
    return wakes, n_classes + 1


@inline
def catches_up(gap, faster, tick, wakes):
    """Return the tick, at most ``wakes``, at which a robot catches up: ``gap`` (mm) behind, ``faster`` (mm per step).

    Robots at the same progress that differ in pace part at the next tick.
    """
    if rarely((gap == 0) & (faster != 0)):
        return tick + 1
    if faster < 0:
        gap, faster = -gap, -faster
    if rarely((gap > 0) & (gap <= faster * (wakes - tick))) and gap % faster == 0:
        return tick + gap // faster
    return wakes


@inline
def schedule(lane, r, tick, decides):
    """Note that robot r, for whom nothing is noted, wakes at a tick: to decide or leave, or else to arrive.

    The tick is at most ``AGENDA - 1`` ahead.
    """
    at = page(tick, r, decides)
    lane.robots[r].noted = at
    lane.agenda[at] |= bit_of(r)


@inline
def cancel(lane, r):
    """Strike out when robot r wakes; where that has passed, there is nothing to strike out."""
    lane.agenda[lane.robots[r].noted] &= ~bit_of(r)


@inline
def page(tick, r, decides):
    """Return where the agenda has a tick's word of 64 bits, robot r's among them, for ``DECIDES`` or ``ARRIVES``."""
    return np.uint64(((((r >> 6) * AGENDA) | (tick & (AGENDA - 1))) << 1) | decides)


@inline
def bit_of(r):
    """Return the uint64 that has robot r's bit of its word."""
    return np.uint64(1) << np.uint64(r & 63)


@inline
def lowest_robot(first, bits):
    """Return the lowest robot that has its bit in a word, which begins with robot ``first``; there is one."""
    return np.uint32(first + np.int64(lowest_bit(bits)))


# --- a step -------------------------------------------------------------------------------------------------------


@inline
def _step(world, rules, learner, lane):
    """Run one step (rule 1) and return ``GOES_ON``, ``SUCCESS``, ``FAILURE`` (rule 16) or ``OUTSIDE``.

    After ``OUTSIDE``, ``count.outside`` is 1 + the input that the task leaves out.
    """
    count = lane.count[0]
    count.tick += 1
    count.robot_steps += count.alive
    count.touched = 0
    count.unsettled = 0
    count.arrivals = 0
    if rarely(rules.by_team == 1):
        wake_teams(rules, lane)
    began = decide(world, rules, learner, lane)
    if rarely(count.outside > 0):
        return OUTSIDE
    suspicions = (count.stopping > 0) & (rules.alerts == 1)
    if rarely(suspicions & (began | (count.cleared == 1))):
        alert(world, rules, lane)
    if rarely(leave(world, rules, learner, lane, suspicions)):
        encounter(world, rules, learner, lane)
    move(world, rules, learner, lane)
    search(lane)
    for i in range(count.unsettled):
        settle(world, rules, learner, lane, lane.unsettled[i])
    for i in range(count.touched):
        regroup(world, rules, learner, lane, lane.touched[i])
    if rarely(rules.share_map == SHARE_RADIO) and count.arrivals > 0:
        pool_all(lane)
    count.step += 1
    if count.edges_left + count.rooms_left + count.hostiles_left == 0:
        return SUCCESS
    return FAILURE if count.alive == 0 or count.step >= rules.limit else GOES_ON


@_entry
def step(world, rules, learner, lane):
    """Run :func:`_step`; the door from Python, for traces and tests."""
    return _step(world, rules, learner, lane)


# --- many simulations, steered from outside ----------------------------------------------------------------------


@inline
def _lane(lanes, i):
    """Return simulation i of several: every array of ``lanes`` has one more axis, in front."""
    return Lane(
        lanes.robots[i],
        lanes.given[i],
        lanes.roster[i],
        lanes.agenda[i],
        lanes.awake[i],
        lanes.sites[i],
        lanes.places[i],
        lanes.touched[i],
        lanes.unsettled[i],
        lanes.rooms[i],
        lanes.picks[i],
        lanes.open[i],
        lanes.share[i],
        lanes.visited[i],
        lanes.maps[i],
        lanes.pooled[i],
        lanes.teams[i],
        lanes.slots[i],
        lanes.classes[i],
        lanes.used[i],
        lanes.shuffle[i],
        lanes.count[i],
        lanes.weights[i],
        lanes.sums[i],
        lanes.stale[i],
    )


@inline
def _show(world, rules, lane, steered, i):
    """Write out simulation i's inputs, who lives and who decides next; a lost robot keeps the last that it saw."""
    for k in range(lane.count[0].alive):
        r = lane.roster[k]
        lane.robots[r].row = _input(lane, r)
        lane.robots[r].seen = _seen(world, rules, lane, r)
    for r in range(lane.robots.shape[0]):
        steered.rows[i, r] = lane.robots[r].seen
        steered.alive[i, r] = lane.robots[r].alive
        steered.decides[i, r] = lane.robots[r].alive & _decides(rules, lane, r)


@inline
def _decides(rules, lane, r):
    """Return 1 if robot r, which has just found its input, decides in the next step, else 0 (rule 6)."""
    robot = lane.robots[r]
    return 1 if robot.due == 1 or lane.count[0].tick + 1 >= robot.decided + rules.patience else 0


@_entry
def begin_many(world, rules, steered, which):
    """Begin the next trial of some simulations; ``which`` int64 (k,) are their numbers."""
    for k in range(which.shape[0]):
        i = which[k]
        lane = _lane(steered.lanes, i)
        steered.trials[i] += 1
        _begin_trial(world, rules, lane, absorb(steered.keys[i, 0], steered.trials[i]), steered.keys[i, 1])
        steered.state[i] = GOES_ON
        steered.lost[i] = 0
        steered.rewards[i] = 0.0
        _show(world, rules, lane, steered, i)


@_entry
def step_many(world, rules, learner, steered):
    """Step every simulation that goes on until somebody decides, and reward it; the others stay as they are."""
    for i in range(steered.state.shape[0]):
        steered.lost[i] = 0
        steered.rewards[i] = 0.0
        if steered.state[i] == GOES_ON:
            _step_until_due(world, rules, learner, steered, i)


@inline
def _step_until_due(world, rules, learner, steered, i):
    lane, pay, rewards, decides = _lane(steered.lanes, i), steered.pay[0], steered.rewards[i], steered.decides[i]
    n_robots = lane.robots.shape[0]
    for r in range(n_robots):
        out = steered.outputs[i, r]
        lane.given[r] = out
        if decides[r] == 1:
            rewards[r] = pay.signal * learner.signal[steered.rows[i, r], out]
    waits = True
    while waits:
        _step_and_reward(world, rules, learner, lane, steered, i)
        waits = steered.state[i] == GOES_ON
        for r in range(n_robots):
            waits &= decides[r] == 0 and steered.lost[i, r] == 0
    if pay.team_share > 0.0:
        mean = rewards.sum() / n_robots
        for r in range(n_robots):
            rewards[r] += pay.team_share * (mean - rewards[r])


@inline
def _step_and_reward(world, rules, learner, lane, steered, i):
    count, robots, pay = lane.count[0], lane.robots, steered.pay[0]
    rewards, alive = steered.rewards[i], steered.alive[i]
    left = count.edges_left + count.rooms_left + count.hostiles_left
    state = _step(world, rules, learner, lane)
    left -= count.edges_left + count.rooms_left + count.hostiles_left
    gain = pay.progress * left / (lane.visited.shape[0] + rules.rooms + rules.hostiles)
    if state == SUCCESS:
        gain += pay.success * (1.0 - 0.5 * count.step / rules.limit)
    for r in range(robots.shape[0]):
        repelled = robots[r].repelled == 1 and robots[r].crossing == 1  # just now: it crosses nothing until it decides
        lost = alive[r] == 1 and (robots[r].alive == 0 or repelled)
        steered.lost[i, r] = 1 if lost else 0
        if alive[r] == 1:
            rewards[r] += pay.loss if lost else gain
    steered.state[i] = state
    _show(world, rules, lane, steered, i)


# --- a trial ----------------------------------------------------------------------------------------------------


@inline
def place_hostiles(world, rules, lane, place_key):
    """Hide the hostiles: the same draw for every arm, since ``place_key`` knows only seed and map (rule 14)."""
    n_candidates = world.candidates.shape[0]
    for k in range(n_candidates):
        lane.shuffle[k] = world.candidates[k]
    for k in range(rules.hostiles):
        chosen = np.int64(k)
        if rules.placed == 0:
            u = uniform(place_key, 0, PLACE_DRAW, k)
            chosen = k + np.int64(u * (n_candidates - k))
        node = lane.shuffle[chosen]
        lane.shuffle[chosen] = lane.shuffle[k]
        lane.sites[node].hostile = 1


@_once_a_trial
def _begin_trial(world, rules, lane, trial_key, place_key):
    """Put everyone at the start with an empty map; hide the hostiles."""
    count = lane.count[0]
    n_robots = world.members.shape[0]
    count.tick += 1
    lane.used[:] = 0
    count.step = 0
    count.alive = n_robots
    count.edges_left = lane.visited.shape[0]
    count.rooms_left = rules.rooms
    count.hostiles_left = rules.hostiles
    count.losses = 0
    count.messages = 0
    count.outside = 0
    count.key = trial_key
    count.stopping = 0
    count.cleared = 0
    count.touched = 0
    lane.visited[:] = 0
    lane.maps[:] = 0
    lane.agenda[:] = 0
    for v in range(world.nodes.shape[0]):
        site = lane.sites[v]
        site.hostile = 0
        site.resolved = 0
        site.stoppers = 0
        site.unsearched = world.search[v]
        site.faced = world.nodes[v].feature - 1
    for place in range(lane.places.shape[0]):
        lane.places[place].first = -1
    place_hostiles(world, rules, lane, absorb(trial_key, 0) if rules.relocate == 1 else place_key)
    for r in range(n_robots - 1, -1, -1):
        lane.roster[r] = r
        robot = lane.robots[r]
        robot.alive = 1
        robot.node = rules.start
        robot.half = -1
        robot.next = -1
        robot.came = -1
        robot.passed = 0
        robot.planned = count.tick
        robot.pace = 0
        robot.due = 1
        robot.decided = count.tick + 1  # the first decision falls due then
        schedule(lane, np.uint32(r), count.tick + 1, DECIDES)
        robot.row = -1
        robot.seen = -1
        robot.arrived = 0
        robot.pair_row = 0
        robot.out = 0
        robot.going = STAYS
        robot.goal = -1
        robot.repelled = 0
        robot.crossing = 0
        robot.stopping = 0
        robot.dl = 0
        robot.alert = -1
        robot.alarmed = 0
        robot.listens = 1
        robot.unsettled = 0
        robot.decisions = 0
        robot.choices = 0
        put_in(lane, np.uint32(r), np.uint32(rules.start))
    found_team(world, rules, lane, np.uint32(0))
    for r in range(1, n_robots):
        join_team(world, rules, lane, np.uint32(r), np.uint32(0))
    count.rooms_open = 1 if world.search[rules.start] > 0 else 0
    lane.rooms[0] = rules.start


@_once_a_trial
def _end_trial(rules, learner, lane, success, fixed, mean_steps):
    """Apply the global time signal (rules 18 and 19); return the trial's steps (a failure counts as the limit)."""
    count = lane.count[0]
    steps = count.step if success else rules.limit
    if learner.learn == 0:
        return steps
    inverted = _inverted(learner.time_reward, steps, rules.limit)
    if learner.sweep_all == 1:
        for row in range(lane.weights.shape[0]):
            reinforce(learner, lane, row, fixed, learner.signal[row, fixed] + inverted)
    elif learner.time_signal != TIME_NONE:
        signal = inverted
        if learner.time_signal == TIME_BASELINE:
            signal = _against_mean(learner.time_reward, steps, rules.limit, mean_steps)
        for row in range(lane.used.shape[0]):
            for word in range(lane.used.shape[1]):
                bits = lane.used[row, word]
                while bits != 0:
                    reinforce(learner, lane, row, np.int64(lowest_bit(bits)) + 64 * word, signal)
                    bits &= bits - np.uint64(1)
    return steps


@_entry
def begin_trial(world, rules, lane, trial_key, place_key):
    """Run :func:`_begin_trial`; a door from Python, as :func:`step`."""
    _begin_trial(world, rules, lane, trial_key, place_key)


@_entry
def end_trial(rules, learner, lane, success, fixed, mean_steps):
    """Run :func:`_end_trial`; a door from Python, as :func:`step`."""
    return _end_trial(rules, learner, lane, success, fixed, mean_steps)


@inline
def copy(weights, to):
    """Copy a table of weights (S, A) entry by entry: assignment of a whole table would allocate."""
    for row in range(weights.shape[0]):
        for out in range(weights.shape[1]):
            to[row, out] = weights[row, out]


@inline
def record(world, lane, steps, success, row, left):
    """Write out how a trial ended: a row of ``table`` and of ``left``, see :func:`run`."""
    count = lane.count[0]
    row[0] = steps
    row[1] = 1 if success else 0
    row[2] = count.losses
    row[3] = 0
    row[4] = count.hostiles_left
    row[5] = lane.visited.shape[0] - count.edges_left
    row[6] = count.messages
    for k in range(left.shape[0]):
        left[k] = 0
    for i in range(count.alive):
        r = lane.roster[i]
        left[world.members[r].kind] += 1
        row[3] += 1 if lane.robots[r].team == r else 0  # a team is numbered by one of its members


@_entry
def run(world, rules, learner, lane, keys, first_trial, fixed, max_losses, weights, jobs, taken, table, left, done):
    """Run the trials of many runs, one job after the other; each job is a block of one run's trials.

    Any number of threads may do so together, each with a lane of its own: whoever is free takes the next job.

    Parameters
    ----------
    world, rules, learner, lane
        See the classes; no bounds checking.
    keys
        uint64 (P, 2): of each run, the hash of (seed, map, stage) and of (seed, map).
    first_trial
        The number of every run's first trial (part of the random key).
    fixed
        int64 (n,): each trial's one output, or -1.
    max_losses
        No further trial of a run begins once this many robots were lost; -1: no cap.
    weights
        float64 (P, S, A), in and out. A run that learns is one job; its weights go on from trial to trial.
    jobs
        int64 (J, 3): the run, its first trial and the trial after its last, counted from 0.
    taken
        int64 (1,), in and out: the number of jobs that were taken.
    table
        int64 (P, n, 7), out: steps, success, losses, teams left, hostiles left, edges seen, messages.
    left
        int64 (P, n, kinds), out: robots left by kind.
    done
        int64 (J, 2), out: the number of trials run, and 0 or 1 + the input outside the task at which the job stopped.
    """
    count = lane.count[0]
    j = take_next(taken)
    while j < jobs.shape[0]:
        p, first, last = jobs[j, 0], jobs[j, 1], jobs[j, 2]
        copy(weights[p], lane.weights)
        lane.stale[:] = 0
        done[j, 0], done[j, 1] = last - first, 0
        total_steps, total_losses = 0, 0
        for n in range(first, last):
            if 0 <= max_losses <= total_losses:
                done[j, 0] = n - first
                break
            _begin_trial(world, rules, lane, absorb(keys[p, 0], first_trial + n), keys[p, 1])
            # with one output that stops everybody, a step without any change repeats itself to the end
            stuck = fixed[n] >= 0 and learner.outputs[max(fixed[n], 0)].way == STAYS
            stuck = stuck and (learner.sweep_all == 1 or learner.learn == 0)
            for r in range(lane.given.shape[0]):
                lane.given[r] = fixed[n]
            state = GOES_ON
            while state == GOES_ON:
                if rarely(stuck):
                    messages, searching = count.messages, count.rooms_open > 0
                state = _step(world, rules, learner, lane)
                if rarely(stuck) and not searching and count.messages == messages and state == GOES_ON:
                    state = FAILURE
            if state == OUTSIDE:
                done[j, 0], done[j, 1] = n - first, count.outside
                break
            mean_steps = total_steps / (n - first) if n > first else -1.0
            steps = _end_trial(rules, learner, lane, state == SUCCESS, fixed[n], mean_steps)
            total_steps += steps
            total_losses += count.losses
            record(world, lane, steps, state == SUCCESS, table[p, n], left[p, n])
        if learner.learn == 1:
            copy(lane.weights, weights[p])
        j = take_next(taken)
