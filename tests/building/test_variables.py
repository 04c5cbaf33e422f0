"""Variables as data: every declared input and output, and one of the tests' own, against the oracle."""

from __future__ import annotations

import dataclasses
import enum
import os
from types import ModuleType

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from test_simulator import agree

import tasklift as tl
from strategies import missions, reinforcements
from tasklift.building import Kind, Mission, Reading, generate
from tasklift.building.inputs import kernel_for
from tasklift.building.randomness import inline
from tasklift.building.variables import (
    INPUTS,
    OUTPUTS,
    TABLE_I,
    TABLE_I_OUTPUTS,
    Sensor,
    detector,
    goal_distance,
    waited,
)
from tasklift.errors import TaskliftError
from tasklift.tasks.policy import Policy
from tasklift.tasks.task import Variable


def far_from_start(world, rules, lane, r, numbers):
    dx = world.nodes[lane.robots[r].node].x - world.nodes[rules.start].x
    return 1 if dx * dx > numbers[0] * numbers[0] else 0


class Own:
    """The same sensor in plain Python."""

    name = "OUT"

    @staticmethod
    def oracle(oracle, robot):
        dx = oracle.position[robot.node][0] - oracle.position[oracle.building.start][0]
        limit = dict(robot.kind.attributes).get("out_m", 6.0)
        return int(dx * dx > limit * limit)


OUT = Sensor(Variable("OUT", (0, 1), labels=("near", "far"), meaning="from the start"), far_from_start, {"out_m": 6})
#: One selection, hence one compilation; other selections are simplifications of its task.
ALL = [*TABLE_I, "TEAM", waited(3, 12), "EXITS", goal_distance(4, 9), "LOST", detector(6, 0.2, 0.1), OUT]
EXTRA = ["TEAM", "WAITED", "EXITS", "FAR", "LOST", "ALARM", "OUT"]


@settings(max_examples=60, deadline=None, derandomize=True)
@given(
    missions(), reinforcements, st.integers(0, 2**31), st.integers(0, 2**40),
    st.sets(st.sampled_from(EXTRA), max_size=3), st.sets(st.sampled_from(TABLE_I), max_size=3), st.booleans(),
    st.floats(0.0, 30.0),
)  # fmt: skip
def test_kernel_agrees_with_oracle_on_any_selection(mission, learner, weight_seed, seed, extra, fewer, back, number):
    kinds = {dataclasses.replace(kind, attributes={"out_m": number, "detector_range_m": number}): n
             for kind, n in mission.team.items()}  # fmt: skip
    team = kinds if weight_seed % 2 else mission.team
    outputs = [*TABLE_I_OUTPUTS, *(["BACK"] if back else [])]
    mission = dataclasses.replace(mission, team=team, inputs=ALL, outputs=outputs)
    gone = [name for name in (*TABLE_I, *EXTRA) if name in fewer or (name in EXTRA and name not in extra)]
    task = mission.task.simplify(remove=gone, signals=(), impossible=())
    agree(mission, learner, weight_seed, seed, sweep=False, learn=True, trials=1, task=task, own=[Own])


@pytest.mark.parametrize("reading", [Reading(), Reading(split="team", engage="crossing", decide="team")])
def test_a_policy_of_table_i_first_plays_the_larger_table_as_before(reading):
    building = generate(seed=7)
    small = Mission(building, "10+5", reading=reading)
    large = Mission(building, "10+5", reading=reading, inputs=ALL)
    weights = np.random.default_rng(0).uniform(0, 3, small.task.shape)
    seen = large.task.simplify(remove=EXTRA)
    extended = Policy(seen, weights).extend(large.task)
    one = small.simulator.trace(Policy(small.task, weights), learn=False)
    other = large.simulator.trace(extended, learn=False)
    for name in ("alive", "node", "half", "progress", "out", "dl"):
        np.testing.assert_array_equal(one.robots[name], other.robots[name])
    shown = {large.task.input_values(int(row))["WAITED"] for row in np.unique(other.robots["row"][1:])}
    assert len(shown) > 1


def test_going_back_crosses_no_door():
    hunt = Mission(generate(seed=7), "10+5", inputs=ALL, outputs=[*TABLE_I_OUTPUTS, "BACK"], limit=200)
    weights = np.zeros(hunt.task.shape)
    home = [hunt.task.output_index({"MV": 1, "WPN": 0, "CA": 0.5, "BACK": back}) for back in (0, 1)]
    weights[:, home[0]] = 1
    door = hunt.task.input_mask({"FTR": [2, 3, 4, 5]})
    weights[door] = 0
    weights[door, home[1]] = 1
    robots = hunt.simulator.trace(Policy(hunt.task, weights), learn=False).robots
    assert (robots["alive"] == 1).all()
    assert (robots["crossing"] == 0).all()
    assert len(np.unique(robots["node"])) == 4  # the start, and the features around it


def test_the_sizes_follow_the_variables():
    hunt = Mission(generate(seed=7), "1+2", inputs=["FTR", "LOST"], outputs=["BACK", *TABLE_I_OUTPUTS])
    assert hunt.task.shape == (15, 88)
    assert [s.name for s in hunt.task.signals] == ["suspected enemy at a different feature"]
    assert not hunt.task.impossible
    assert Mission(hunt.building, "1+2").task == Mission(hunt.building, "1+2", inputs=list(TABLE_I)).task


@pytest.mark.parametrize("name", [*INPUTS, *OUTPUTS])
def test_every_variable_has_a_meaning(name):
    variable = INPUTS[name].variable if name in INPUTS else OUTPUTS[name]
    assert variable.meaning


def test_what_cannot_be_chosen_is_refused_in_one_line():
    building = generate(seed=7)
    for wrong in ("DL", ["XX"], ["DL", "DL"], [3], 5, None, [waited(), "WAITED"]):
        with pytest.raises(TaskliftError, match="inputs: expected"):
            Mission(building, "1+2", inputs=wrong)
    for wrong in ("MV", ["MV"], ["MV", "WPN", "CA", "XX"], [*TABLE_I_OUTPUTS, "MV"], None):
        with pytest.raises(TaskliftError, match="outputs: expected"):
            Mission(building, "1+2", outputs=wrong)
    with pytest.raises(TaskliftError, match="false_alarm: expected a probability"):
        detector(false_alarm=1.5)
    with pytest.raises(TaskliftError, match="expected numbers by name"):
        Kind("bee", 2600, False, attributes=[3])
    limit = 3
    around = Sensor(Variable("A", (0, 1)), lambda world, rules, lane, r, numbers: limit)
    hunt = Mission(building, "1+2", inputs=[around])
    with pytest.raises(TaskliftError, match="without values from around it"):
        hunt.evaluate(tl.Policy.equal(hunt.task), 1)


def module(**values):
    found = ModuleType("settings")
    vars(found).update(values)
    return found


def helper(body):
    space = {"__name__": "helpers"}
    exec(f"def helper(x):\n    return {body}\n", space)
    return inline(space["helper"])


@pytest.mark.parametrize(
    ("body", "one", "other"),
    [
        ("K[1]", np.array([1, 2]), np.array([1, 3])),
        ("K[1]", np.array([1, 2], np.int32), np.array([1, 2], np.int64)),
        ("K[0][1]", (np.arange(3000), 1), (np.arange(3000) * (np.arange(3000) != 1500), 1)),
        ("K", 1, 2),
        ("K", 1, 1.0),
        ("max([K for _ in range(2)])", 1, 2),
        ("K.level", module(level=1), module(level=2)),
        ("K.LOW.value", enum.Enum("K", {"LOW": 1}), enum.Enum("K", {"LOW": 2})),
        ("K(r)", helper("x"), helper("x + 1")),
        ("K(r)", helper("max([x for _ in range(2)])"), helper("max([x for _ in range(3)])")),
    ],
)
def test_whatever_a_sensor_uses_by_name_compiles_anew_when_it_changes(body, one, other, tmp_path, monkeypatch):
    monkeypatch.setenv("NUMBA_CACHE_DIR", str(tmp_path))
    names = []
    for value in (one, one, other):
        space = {"__name__": "mine", "K": value}
        exec(f"def read(world, rules, lane, r, numbers):\n    return {body}\n", space)
        names.append(kernel_for((Sensor(Variable("S", range(9)), space["read"]),)).__name__)
    assert names[0] == names[1] != names[2]


@pytest.mark.parametrize("value", [{"a": 1}, [1, 2], object()])
def test_a_value_without_a_content_is_refused_by_name(value):
    space = {"__name__": "mine", "K": value}
    exec("def read(world, rules, lane, r, numbers):\n    return len(K)\n", space)
    with pytest.raises(TaskliftError, match="sensor 'S', K: expected a number, an array or a function"):
        kernel_for((Sensor(Variable("S", range(9)), space["read"]),))


def test_kernels_are_kept_where_there_are_no_user_ids(tmp_path, monkeypatch):
    (tmp_path / "file").write_text("in the way")
    monkeypatch.setenv("NUMBA_CACHE_DIR", str(tmp_path / "file"))
    monkeypatch.setattr("tempfile.tempdir", str(tmp_path))
    monkeypatch.delattr(os, "getuid")
    assert kernel_for((waited(7, 9),)).__file__.startswith(str(tmp_path / "tasklift"))


def unknown_field(world, rules, lane, r, numbers):
    return lane.robots[r].progress


def test_a_sensor_that_reads_an_unknown_field_is_refused_in_one_line():
    own = Sensor(Variable("OWN", (0, 1)), unknown_field)
    mission = Mission(generate(seed=7), "10+5", inputs=[*TABLE_I, own])
    with pytest.raises(TaskliftError, match="inputs: OWN cannot be compiled: unknown field 'progress'"):
        mission.evaluate(Policy.equal(mission.task), 1)
