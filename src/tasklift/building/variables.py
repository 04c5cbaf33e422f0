"""The variables of the building search: what robots may sense, and what they may decide.

A mission chooses from them: ``Mission(..., inputs=[*TABLE_I, "WAITED"], outputs=[*TABLE_I_OUTPUTS, "BACK"])``. Table I
of the paper is the default. A sensor of your own is a :class:`Sensor` with a function of yours
(``docs/extending.md``).
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from tasklift.checks import check_name
from tasklift.errors import TaskliftError
from tasklift.tasks.variable import Variable, plain_number
from tasklift.text import shown

#: The most inputs of one mission, and the most rows of its table.
LARGEST_SENSORS, LARGEST_ROWS = 64, 2**24


@dataclass(frozen=True)
class Sensor:
    """An input of the building search: a variable, and how it is read from the state.

    Robots read their sensors when they decide. A change of an input of Table I makes them decide anew (rule 6); a
    change of another one does not, so they see it at their next decision, at the latest after ``Reading.patience``
    steps. This is why a policy of Table I, extended to more inputs, first acts as before.

    Parameters
    ----------
    variable : Variable
        Name, values, labels and meaning.
    read : function or str
        ``read(world, rules, lane, r, numbers)`` returns the position of the value, counted from 0. Positions beyond
        the last value count as the last, below 0 as the first. It is compiled by Numba; the tuples are those of
        :mod:`tasklift.building.layout`, ``r`` is the robot's number. A string names a function of
        :mod:`tasklift.building.sensors`.
    numbers : mapping of str to float, optional
        What ``read`` gets as ``numbers``, in this order. A kind of robots with an attribute of the same name has its
        own (:class:`~tasklift.building.team.Kind`). A change of numbers compiles nothing anew.

    Raises
    ------
    TaskliftError
        For a variable or a function that is not one, and numbers that are not finite.

    Examples
    --------
    >>> def at_start(world, rules, lane, r, numbers):
    ...     return 1 if lane.robots[r].node == rules.start else 0
    >>> Sensor(Variable("HOME", (0, 1), labels=("away", "home")), at_start).name
    'HOME'
    """

    variable: Variable
    read: Callable[..., Any] | str
    numbers: tuple[tuple[str, float], ...] = ()

    def __post_init__(self) -> None:
        if not isinstance(self.variable, Variable):
            raise TaskliftError(f"sensor: expected a Variable, found {shown(self.variable)}")
        where = f"sensor {self.name!r}"
        if not callable(self.read) and not isinstance(self.read, str):
            raise TaskliftError(f"{where}: expected a function in read, found {shown(self.read)}")
        object.__setattr__(self, "numbers", named_numbers(self.numbers, where))

    @property
    def name(self) -> str:
        """The variable's name."""
        return self.variable.name


def named_numbers(numbers: Any, where: str) -> tuple[tuple[str, float], ...]:
    """Return a mapping of names to numbers, or pairs of them, as a tuple of pairs."""
    try:
        pairs = list(numbers.items() if isinstance(numbers, Mapping) else numbers)
        named = [(check_name(name, where), plain_number(value, f"{where}, {name}")) for name, value in pairs]
    except (TypeError, ValueError) as error:
        raise TaskliftError(
            f"{where}: expected numbers by name, such as {{'range_m': 8}}, found {shown(numbers)}"
        ) from error
    if len(dict(named)) < len(named):
        raise TaskliftError(f"{where}: a name is there twice in {shown(numbers)}")
    return tuple(named)


def waited(some: float = 60, long: float = 180) -> Sensor:
    """Return the input WAITED: how many steps the robot has been at its node, in three classes.

    Parameters
    ----------
    some, long : float
        Where the second and the third class begin (steps).
    """
    labels = (f"below {some:g} steps", f"{some:g} steps or more", f"{long:g} steps or more")
    variable = Variable("WAITED", (0, 1, 2), labels=labels, meaning="steps waited here")
    return Sensor(variable, "waited", {"waited_some": some, "waited_long": long})  # type: ignore[arg-type]


def goal_distance(near_m: float = 8, far_m: float = 20) -> Sensor:
    """Return the input FAR: the straight distance from the robot's last node to its goal, in classes (metres)."""
    labels = ("no goal", f"below {near_m:g} m", f"below {far_m:g} m", f"{far_m:g} m or more")
    variable = Variable("FAR", (0, 1, 2, 3), labels=labels, meaning="distance to the goal")
    return Sensor(variable, "goal_distance", {"near_m": near_m, "far_m": far_m})  # type: ignore[arg-type]


def detector(range_m: float = 8, miss: float = 0.1, false_alarm: float = 0.05) -> Sensor:
    """Return the input ALARM: a noisy detector of hostiles, which draws once per visit of a robot to a node.

    Parameters
    ----------
    range_m : float
        It detects hostiles within this straight distance of the node (metres). A kind of robots with
        ``attributes={"detector_range_m": 0}`` carries none.
    miss : float
        Probability of no alarm though a hostile is within range.
    false_alarm : float
        Probability of an alarm though none is.

    Raises
    ------
    TaskliftError
        For a rate outside 0 to 1.
    """
    for name, rate in {"miss": miss, "false_alarm": false_alarm}.items():
        if not 0 <= plain_number(rate, f"detector, {name}") <= 1:
            raise TaskliftError(f"detector, {name}: expected a probability from 0 to 1, found {shown(rate)}")
    variable = Variable("ALARM", (0, 1), labels=("quiet", "alarm"), meaning="hostile detector")
    numbers = {"detector_range_m": range_m, "detector_miss": miss, "detector_false_alarm": false_alarm}
    return Sensor(variable, "alarm", numbers)  # type: ignore[arg-type]


_DL = Variable("DL", (0, 1, 2), labels=("none", "suspected", "attacked"), meaning="danger level")
_GL = Variable("GL", (0, 1), labels=("unknown", "known"), meaning="goal")
_NWPN = Variable("nWPN", (0, 1, 2), labels=("none", "below m", "m or more"), meaning="weapon robots in the team")
_FTR = Variable("FTR", (1, 2, 3, 4, 5), labels=("none", "bend", "corner", "door", "other"), meaning="feature faced")
_TEAM = Variable("TEAM", (1, 2, 3, 4), labels=("alone", "two", "three", "four or more"), meaning="robots in the team")
_EXITS = Variable("EXITS", (0, 1, 2), labels=("none", "one", "more"), meaning="unexplored exits here")
_LOST = Variable("LOST", (0, 1, 2), labels=("none", "one", "more"), meaning="robots lost so far")

#: Every declared input, by name. The first four are the paper's (Table I).
INPUTS: dict[str, Sensor] = {
    sensor.name: sensor
    for sensor in (
        Sensor(_DL, "danger_level"),
        Sensor(_GL, "goal_known"),
        Sensor(_NWPN, "weapon_robots"),
        Sensor(_FTR, "feature_faced"),
        Sensor(_TEAM, "team_size"),
        waited(),
        Sensor(_EXITS, "unexplored_exits"),
        goal_distance(),
        Sensor(_LOST, "robots_lost"),
        detector(),
    )
}

#: Every declared output, by name. The first three are the paper's (Table I).
OUTPUTS: dict[str, Variable] = {
    variable.name: variable
    for variable in (
        Variable("MV", (0, 1), labels=("stop", "move"), meaning="stop or move"),
        Variable("WPN", (0, 1), labels=("deny", "accept"), meaning="keep to the weapon robots' speed"),
        Variable("CA", tuple(i / 10 for i in range(11)), meaning="coverage coefficient"),
        Variable("BACK", (0, 1), labels=("go on", "go back"), meaning="leave by the corridor it came by"),
    )
}

#: The paper's inputs and outputs, by name: the default of a mission.
TABLE_I = ("DL", "GL", "nWPN", "FTR")
TABLE_I_OUTPUTS = ("MV", "WPN", "CA")


def chosen_inputs(inputs: Any) -> tuple[Sensor, ...]:
    """Return the sensors that are named or given, in order; refuse unknown and doubled ones, and too many."""
    if isinstance(inputs, str) or not isinstance(inputs, Sequence):
        raise TaskliftError(f"inputs: expected names of variables or Sensors, found {shown(inputs)}")
    found: list[Sensor] = []
    for given in inputs:
        sensor = INPUTS.get(given) if isinstance(given, str) else given
        if not isinstance(sensor, Sensor):
            raise TaskliftError(f"inputs: expected a Sensor or one of {', '.join(INPUTS)}, found {shown(given)}")
        found.append(sensor)
    names = [sensor.name for sensor in found]
    if len(set(names)) < len(names):
        raise TaskliftError(f"inputs: expected each variable once, found {shown(names)}")
    if len(found) > LARGEST_SENSORS:
        raise TaskliftError(f"inputs: expected at most {LARGEST_SENSORS}, found {len(found)}")
    rows = math.prod(len(sensor.variable) for sensor in found)
    if rows > LARGEST_ROWS:
        raise TaskliftError(f"inputs: a table of {rows:,} rows is more than the {LARGEST_ROWS:,} that are built")
    return tuple(found)


def chosen_outputs(outputs: Any) -> tuple[str, ...]:
    """Return the names of the outputs; refuse unknown and doubled ones, and a table without the paper's three."""
    if isinstance(outputs, str) or not isinstance(outputs, Sequence):
        raise TaskliftError(f"outputs: expected names of variables, found {shown(outputs)}")
    for given in outputs:
        if not isinstance(given, str) or given not in OUTPUTS:
            raise TaskliftError(f"outputs: expected names among {', '.join(OUTPUTS)}, found {shown(given)}")
    if len(set(outputs)) < len(outputs) or not set(TABLE_I_OUTPUTS) <= set(outputs):
        raise TaskliftError(
            f"outputs: expected each of {', '.join(TABLE_I_OUTPUTS)} once, found {shown(list(outputs))}; "
            "use task.simplify(fix=...) to do without one"
        )
    return tuple(outputs)
