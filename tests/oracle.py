"""The building search in slow, plain Python: the reader's first stop, and the kernel's judge.

Nothing here is fast and nothing is shared with the kernel: maps are sets, teams are dictionaries, distances are
looked up as they are needed. Numbers in brackets are the rules of ``docs/reading.md``. Only the *order* of
floating-point additions is kept the same on purpose, so that the two agree to the last bit.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field

from tasklift.building.graph import FEATURE, ROOM

MASK = (1 << 64) - 1
OUTPUT_DRAW, EDGE_DRAW, GREEDY_COIN, PLACE_DRAW, DETECTOR_DRAW = 0, 1, 2, 3, 4


# --- randomness: SplitMix64's finaliser as a hash of a key and an address ---------------------------------------


def mix(z):
    z = ((z ^ (z >> 30)) * 0xBF58476D1CE4E5B9) & MASK
    z = ((z ^ (z >> 27)) * 0x94D049BB133111EB) & MASK
    return z ^ (z >> 31)


def absorb(key, value):
    return mix(key ^ mix((value + 0x9E3779B97F4A7C15) & MASK))


def uniform(key, robot, purpose, number):
    return (absorb(key, robot << 40 | purpose << 32 | number) >> 11) / 2**53


def draw(weights, u):
    """Return an index in proportion to the weights; all zero draws evenly (17)."""
    total = 0.0
    for w in weights:
        total += w
    if total == 0:
        return int(u * len(weights))
    running = 0.0
    for i, w in enumerate(weights):
        running += w
        if u * total < running:
            return i
    return max(i for i, w in enumerate(weights) if w > 0)


def heaviest(weights, u):
    ties = [i for i, w in enumerate(weights) if w == max(weights)]
    return ties[int(u * len(ties))]


# --- the world --------------------------------------------------------------------------------------------------


@dataclass(eq=False)
class Robot:
    number: int
    kind: object
    node: int  # where it is, or where it last was
    edge: int | None = None  # the corridor it is in, with `to` and `progress`
    to: int | None = None
    progress: int = 0
    leaving: tuple[int, int] | None = None  # (edge, far node) chosen in this step
    came: int | None = None  # the corridor by which it reached `node`
    map: set = field(default_factory=set)  # the edges it knows
    alive: bool = True
    danger: int = 0
    about: int | None = None  # the feature that the danger is about
    input: tuple | None = None  # (DL, GL, nWPN, FTR)
    seen: dict | None = None  # by name, the positions of all its inputs at its last decision
    arrived: int = 0  # steps at which it came to `node`
    used: tuple | None = None  # (row, output number) of its last decision
    output: dict | None = None  # what it last decided
    force: dict | None = None  # what it acts on
    repelled: bool = False  # repelled by a hostile in a drill: stays until its next decision
    crossing: bool = False
    due: bool = True
    waited: int = 0  # steps since its last decision
    decisions: int = 0
    choices: int = 0


class Oracle:
    """One trial at a time of one mission, with one policy.

    ``weights`` is a list of rows, changed in place; ``outputs[a]`` maps names to values; ``row_of(seen)`` gives the
    row of an input, given as the position of each variable's value; ``signal[s][a]`` are the local signals.
    """

    def __init__(
        self,
        mission,
        weights,
        outputs,
        row_of,
        signal,
        reinforcement,
        *,
        learn=True,
        sweep=False,
        time_reward=0.1,
        own=(),
    ):
        self.mission, self.building, self.reading = mission, mission.building, mission.reading
        self.weights, self.outputs, self.row_of, self.signal = weights, outputs, row_of, signal
        self.reinforcement, self.learn, self.sweep, self.time_reward = (
            reinforcement,
            learn,
            sweep,
            time_reward,
        )
        self.own = own  # sensors that the test declares: with a name, and `oracle(self, robot)`
        b = self.building
        self.position = [tuple(map(float, p)) for p in b.position_m]
        self.ways = [  # of each node: (edge, far node, CovA), by ascending far node
            [
                (int(b.edge_of[h]), int(b.neighbour[h]), float(b.coverage[h]))
                for h in range(b.indptr[v], b.indptr[v + 1])
            ]
            for v in range(b.n_nodes)
        ]
        self.cost = [  # [2] millimetres, stretched in corridors narrower than 2 m
            max(1, round(1000.0 * float(b.length_m[e]) * max(1.0, 2.0 / float(b.width_m[e])))) for e in range(b.n_edges)
        ]
        self.trial_number = 0

    # --- beginning and end ---

    def begin(self, seed, stage, trial):
        building, mission = self.building, self.mission
        place_key = absorb(absorb(0, seed), building.map_id)
        self.key = absorb(absorb(place_key, stage), trial)
        self.hostiles = self.hide(absorb(self.key, 0) if self.reading.relocate else place_key)
        kinds = [kind for kind, number in mission.team.items() for _ in range(number)]
        self.robots = [Robot(i, kind, building.start) for i, kind in enumerate(kinds)]
        self.resolved = set()
        self.visited = set()
        self.unsearched = {  # [13]
            v: max(
                1,
                math.ceil(float(building.area_m2[v]) / self.reading.search_rate_m2) + int(building.obstacles[v]),
            )
            for v in range(building.n_nodes)
            if building.kind[v] == ROOM
        }
        self.steps = self.messages = self.losses = 0
        self.pairs_used = []
        self.find_teams()

    def hide(self, key):
        """[14] Choose the doors that hide a hostile, none of them next to the start."""
        if not isinstance(self.mission.hostiles, int):
            return set(self.mission.hostiles)
        start, classes = self.building.start, self.building.feature_class.tolist()
        beside = [far for _, far, _ in self.ways[start]]
        hides = (4,) if 4 in classes else (2, 3, 4, 5)  # without any door, at any feature
        doors = [v for v, kind in enumerate(classes) if kind in hides and v != start and v not in beside]
        chosen = set()
        for k in range(self.mission.hostiles):
            i = k + int(uniform(key, 0, PLACE_DRAW, k) * (len(doors) - k))
            doors[k], doors[i] = doors[i], doors[k]
            chosen.add(doors[k])
        return chosen

    @property
    def living(self):
        return [robot for robot in self.robots if robot.alive]

    def status(self):
        """[16] Return ``"success"``, ``"failure"`` or ``"on"``."""
        if len(self.visited) == self.building.n_edges and not self.unsearched and not self.hostiles:
            return "success"
        return "failure" if not self.living or self.steps == self.mission.limit else "on"

    def end(self, success, fixed, mean_steps):
        """[18, 19] Apply the global time signal; return the trial's steps."""
        limit, rein = self.mission.limit, self.reinforcement
        steps = self.steps if success else limit
        inverted = self.time_reward * (1.0 - steps / limit)
        if not self.learn:
            return steps
        if self.sweep and rein.sweep_credit == "all":
            for row in range(len(self.weights)):
                self.reinforce(row, fixed, self.signal[row][fixed] + inverted)
        elif self.sweep or rein.time_signal == "inverted":
            for row, out in self.pairs_used:
                self.reinforce(row, out, inverted)
        elif rein.time_signal == "baseline" and mean_steps is not None:
            for row, out in self.pairs_used:
                self.reinforce(row, out, 2.0 * self.time_reward * (mean_steps - steps) / limit)
        return steps

    def reinforce(self, row, out, signal):
        self.weights[row][out] = max(self.reinforcement.floor, self.weights[row][out] + signal)

    # --- [1] a step ---

    def step(self, fixed=None):
        self.sense()
        self.decide(fixed)
        self.alert()
        self.leave()
        self.encounter()
        self.move()
        self.find_teams()
        self.pool()
        self.search()
        for robot in self.living:
            robot.waited += 1
        self.steps += 1

    def goal(self, robot):
        known = robot.danger == 2 or (robot.danger == 1 and self.reading.suspicion_goal)
        return robot.about if known else None

    def facing(self, robot):
        """[3] Return the unresolved feature that a robot stands at, or None."""
        if robot.edge is None and self.building.kind[robot.node] == FEATURE and robot.node not in self.resolved:
            return robot.node
        return None

    def stops(self, robot):
        return robot.repelled or robot.force["MV"] == 0

    def armed(self, team):
        return [robot for robot in team if robot.kind.armed]

    def sense(self):
        """[3, 4, 6] Everyone's input, and who is due for a decision."""
        for robot in self.living:
            seen = self.input_of(robot)
            if seen != robot.input or robot.waited >= self.reading.patience:
                robot.due = True
            robot.input = seen

    def input_of(self, robot):
        """[3, 4] Return a robot's values of Table I's inputs."""
        weapons = len(self.armed(self.team_of[robot.number]))
        level = 0 if weapons == 0 else 1 if weapons < self.mission.weapons_needed else 2
        feature = self.facing(robot)
        ftr = 1 if feature is None else int(self.building.feature_class[feature])
        return robot.danger, int(self.goal(robot) is not None), level, ftr

    def seen(self, robot):
        """Return the positions of the values of all inputs, by name; Table I's are those that make robots decide."""
        danger, goal_known, level, ftr = robot.input
        mine = {name: value for sensor in self.mission.inputs for name, value in sensor.numbers}
        mine |= {name: value for name, value in robot.kind.attributes if name in mine}
        goal, at_node = self.goal(robot), robot.edge is None
        waits = self.steps - robot.arrived if at_node else 0
        new = sum(edge not in robot.map for edge, _, _ in self.ways[robot.node]) if at_node else 0
        found = {"DL": danger, "GL": goal_known, "nWPN": level, "FTR": ftr - 1}
        found |= {"TEAM": min(len(self.team_of[robot.number]), 4) - 1}
        found |= {"EXITS": min(new, 2), "LOST": min(self.losses, 2)}
        if "waited_some" in mine:
            found["WAITED"] = sum(at_node and waits >= mine[name] for name in ("waited_some", "waited_long"))
        if "near_m" in mine:
            far = None if goal is None else square(self.position[robot.node], self.position[goal])
            found["FAR"] = 0 if far is None else 1 + sum(far >= mine[name] ** 2 for name in ("near_m", "far_m"))
        if "detector_range_m" in mine:
            rates = [mine[f"detector_{name}"] for name in ("range_m", "miss", "false_alarm")]
            found["ALARM"] = int(self.alarmed(robot, *rates))
        return found | {sensor.name: sensor.oracle(self, robot) for sensor in self.own}

    def alarmed(self, robot, range_m, miss, false_alarm):
        """Whether a noisy detector signals: one draw for each visit to a node."""
        here = self.position[robot.node]
        near = any(square(here, self.position[v]) <= range_m * range_m for v in self.hostiles)
        chance = 1.0 - miss if near else false_alarm
        return range_m > 0 and uniform(self.key, robot.number, DETECTOR_DRAW, robot.arrived) < chance

    def decide(self, fixed):
        """[5, 20] Draw an output for everyone who is due."""
        alone = self.reading.decide == "robot"
        for team in [[robot] for robot in self.living] if alone else self.teams:
            if not any(robot.due for robot in team):
                continue
            lead = team[0]
            for robot in team:
                robot.seen = self.seen(robot)
            row = self.row_of(lead.seen)
            out = self.draw_output(lead, row) if fixed is None else fixed
            lead.decisions += 1
            self.credit(row, out)
            for robot in team:
                robot.used, robot.output = (row, out), self.outputs[out]
                robot.due, robot.waited, robot.repelled = False, 0, False
                if robot.edge is None:  # [2] in mid-corridor it takes effect from the next step on
                    robot.force = robot.output

    def draw_output(self, robot, row):
        rein = self.reinforcement
        q = {"exploration": 0.0, "pseudo-random": rein.q, "exploitation": 1.0}[rein.selection]
        u = uniform(self.key, robot.number, OUTPUT_DRAW, robot.decisions)
        if uniform(self.key, robot.number, GREEDY_COIN, robot.decisions) < q:
            return heaviest(self.weights[row], u)
        return draw(self.weights[row], u)

    def credit(self, row, out):
        """[19] A local signal at every decision, or once per trial."""
        first_time = (row, out) not in self.pairs_used
        if first_time:
            self.pairs_used.append((row, out))
        at_once = self.learn and not (self.sweep and self.reinforcement.sweep_credit == "all")
        if at_once and (first_time or self.reinforcement.credit == "decision"):
            self.reinforce(row, out, self.signal[row][out])

    def alert(self):
        """[11] Whoever stops at an unresolved feature is heard by those near it who suspect nothing yet."""
        if self.mission.n_hostiles == 0:
            return
        suspected = {self.facing(robot) for robot in self.living if self.stops(robot)} - {None}
        for robot in self.living:
            heard = [
                f
                for f in suspected
                if math.dist(self.position[robot.node], self.position[f]) <= self.reading.alert_range_m
            ]
            if robot.danger == 0 and heard:
                robot.danger, robot.about = 1, max(heard)
                self.messages += 1

    # --- [7, 8, 9] choosing an edge ---

    def leave(self):
        chosen_here = {}
        for robot in self.living:
            robot.crossing, robot.leaving = False, None
            if robot.edge is None and not self.stops(robot) and robot.node not in self.unsearched:
                way = self.choose(robot, chosen_here.setdefault(robot.node, []))
                robot.leaving = way[:2]
                only_one = len(self.ways[robot.node]) == 1
                robot.crossing = self.facing(robot) is not None and (way[0] != robot.came or only_one)

    def choose(self, robot, earlier):
        if robot.force.get("BACK") == 1 and robot.came is not None:
            return next(way for way in self.ways[robot.node] if way[0] == robot.came)
        ways = self.open_ways(robot)
        if self.reading.split == "team":
            for way in earlier:
                if way in ways:
                    return way
        if self.reading.split == "pairs" and len(earlier) == 2:
            ways = [way for way in ways if way in earlier] or ways
        way = self.draw_way(robot, ways)
        if way not in earlier and (self.reading.split == "team" or len(earlier) < 2):
            earlier.append(way)
        return way

    def open_ways(self, robot):
        """[8] Not back, unless there is no other way or the goal lies elsewhere; the unknown first."""
        ways, goal = self.ways[robot.node], self.goal(robot)
        elsewhere = goal is not None and goal != robot.node
        if len(ways) > 1 and not (self.reading.turn_back and elsewhere):
            ways = [way for way in ways if way[0] != robot.came]
        unknown = [way for way in ways if way[0] not in robot.map]
        if goal is None and self.reading.explore == "unvisited-first" and unknown:
            return unknown
        return ways

    def draw_way(self, robot, ways):
        """[9] p_j = CA · CovA_j + (1 − CA) · GolC_j."""
        if len(ways) == 1:
            return ways[0]
        goal = self.goal(robot)
        near = [1.0] * len(ways)
        if goal is not None and goal != robot.node:
            near = [
                1.0 / (0.5 + math.dist(self.position[far], self.position[goal])) ** self.reading.goal_sharpness
                for _, far, _ in ways
            ]
        covered = shares([coverage for _, _, coverage in ways])
        near = shares(near)
        ca = robot.force["CA"]
        p = [ca * c + (1.0 - ca) * g for c, g in zip(covered, near, strict=True)]
        robot.choices += 1
        return ways[draw(p, uniform(self.key, robot.number, EDGE_DRAW, robot.choices - 1))]

    # --- [10, 21] encounters ---

    def encounter(self):
        crossed = sorted({robot.node for robot in self.living if robot.crossing})
        for node in crossed:
            here = [robot for robot in self.living if robot.edge is None and robot.node == node]
            engaged = here if self.reading.engage == "team" else [robot for robot in here if robot.crossing]
            if node not in self.hostiles:
                self.resolved.add(node)
            elif len(self.armed(engaged)) >= self.mission.weapons_needed:
                self.hostiles.remove(node)
                self.resolved.add(node)
        before = {robot.number: (robot.danger, robot.about) for robot in self.living}
        for robot in self.living:
            if robot.about in self.resolved:
                robot.danger, robot.about = 0, None
        for node in crossed:
            if node in self.hostiles:
                self.attack(node)
        for robot in self.living:
            if (robot.danger, robot.about) != before[robot.number]:
                self.messages += 1

    def attack(self, node):
        """Fewer than m weapon robots met the hostile at ``node``."""
        here = [robot for robot in self.living if robot.edge is None and robot.node == node]
        engaged = here if self.reading.engage == "team" else [robot for robot in here if robot.crossing]
        for robot in engaged:
            self.losses += 1
            if self.learn and not (self.sweep and self.reinforcement.sweep_credit == "all"):
                self.reinforce(*robot.used, self.reinforcement.loss_signal)
            if not self.reading.drill:
                robot.alive = False
            elif robot.crossing:
                robot.leaving, robot.repelled = None, True
        for robot in self.living:
            if robot not in engaged:
                robot.danger, robot.about = 2, node

    # --- [2, 4, 12, 13] moving, meeting, searching ---

    def move(self):
        for robot in self.living:
            starts = robot.leaving is not None
            if starts:
                robot.edge, robot.to = robot.leaving
                robot.progress = 0
            if robot.edge is not None:
                if starts or robot.force["MV"] == 1:
                    robot.progress += self.speed(robot)
                    if robot.progress >= self.cost[robot.edge]:
                        self.arrive(robot)
                robot.force = robot.output

    def speed(self, robot):
        """[15] A scout that keeps with weapon robots moves at the slowest armed member's speed."""
        armed = self.armed(self.team_of[robot.number])
        if robot.kind.armed or robot.force["WPN"] == 0 or not armed:
            return robot.kind.speed_mm
        return min(robot.kind.speed_mm, *(member.kind.speed_mm for member in armed))

    def arrive(self, robot):
        robot.node, robot.came = robot.to, robot.edge
        robot.arrived = self.steps + 1
        robot.map.add(robot.edge)
        self.visited.add(robot.edge)
        robot.edge, robot.to, robot.progress, robot.due = None, None, 0, True

    def find_teams(self):
        """[4] The living at one node, or on one corridor in one direction with equal progress."""
        places = {}
        for robot in self.living:
            places.setdefault((robot.node, robot.edge, robot.progress), []).append(robot)
        self.teams = list(places.values())
        self.team_of = {robot.number: team for team in self.teams for robot in team}

    def pool(self):
        """[12] Pool maps; a pooling that taught someone something is one message."""
        groups = {"team": self.teams, "radio": [self.living], "none": []}[self.reading.share_map]
        for group in groups:
            together = set().union(*(robot.map for robot in group))
            if any(robot.map != together for robot in group):
                self.messages += 1
            for robot in group:
                robot.map = set(together)

    def search(self):
        """[13] A room with any robot in it is searched by one step's worth."""
        for node in {robot.node for robot in self.living if robot.edge is None}:
            if node in self.unsearched:
                self.unsearched[node] -= 1
                if self.unsearched[node] == 0:
                    del self.unsearched[node]


def square(a, b):
    """Return the squared distance of two points."""
    return (a[0] - b[0]) * (a[0] - b[0]) + (a[1] - b[1]) * (a[1] - b[1])


def shares(values):
    """Normalise to one; equal shares where all are zero."""
    total = 0.0
    for value in values:
        total += value
    return [value / total if total > 0 else 1.0 / len(values) for value in values]
