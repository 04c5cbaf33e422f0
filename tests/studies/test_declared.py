"""What a mission declares (team, kinds, inputs, outputs, limits) follows it everywhere, or is refused by name."""

from __future__ import annotations

import dataclasses
import json
from pathlib import Path

import pytest
from click.testing import CliRunner
from hypothesis import given, settings
from hypothesis import strategies as st

import tasklift as tl
from tasklift.building import Kind, Mission, generate
from tasklift.building.setting import Setting
from tasklift.building.terms import TERMS, terms_from_json, terms_of, terms_to_json
from tasklift.building.variables import (
    INPUTS,
    OUTPUTS,
    TABLE_I_OUTPUTS,
    detector,
    goal_distance,
    waited,
)
from tasklift.cli.policy import policy_show
from tasklift.errors import TaskliftError
from tasklift.studies.arms import Setup
from tasklift.studies.certify import Ground, certify, verify
from tasklift.studies.mission_file import declared, save_declared
from tasklift.studies.own_code import OwnCode
from tasklift.studies.simplify.search import study_of
from tasklift.studies.spec_file import arm_of, curriculum_of
from tasklift.studies.study import Condition, Study
from tasklift.studies.team import team
from tasklift.studies.train import train
from tasklift.watch.document import replay
from tasklift.watch.sources import run_traces

HOUSE = generate(9, 11, 3, 6, seed=5)
OWN = """
from tasklift import Variable
from tasklift.building.variables import Sensor

def far_from_start(world, rules, lane, r, numbers):
    dx = world.nodes[lane.robots[r].node].x - world.nodes[rules.start].x
    return 1 if dx * dx > numbers[0] * numbers[0] else 0

out = Sensor(Variable("OUT", (0, 1), labels=("near", "far"), meaning="from the start"), far_from_start, {"out_m": 6})
number = 3
"""
INPUTS_OF_ONES_OWN = 'inputs = ["DL", "GL", "nWPN", "FTR", { python = "own:out" }]\n'
DECLARED = 'outputs = ["MV", "WPN", "CA", "BACK"]\nlimit = 300\n'
KINDS = """
[[team]]
kind = "scout"
robots = 6
attributes = { detector_range_m = 9, out_m = 3 }
[[team]]
kind = "crawler"
robots = 6
speed_mm = 900
armed = true
"""


def own(folder: Path) -> OwnCode:
    (folder / "own.py").write_text(OWN)
    return OwnCode(folder)


@pytest.fixture
def file(tmp_path: Path) -> Path:
    own(tmp_path)
    path = tmp_path / "office.toml"
    path.write_text(INPUTS_OF_ONES_OWN + DECLARED + KINDS)
    return path


def test_every_field_of_a_mission_is_a_term_or_the_place_hostiles_and_rules():
    assert {f.name for f in dataclasses.fields(Setting)} == {*TERMS, "building", "hostiles", "reading"}
    for holder in (Study, Ground):
        assert {f.name for f in dataclasses.fields(holder)} >= set(TERMS)


numbers = st.floats(0.1, 50.0)
inputs = st.lists(
    st.sampled_from(list(INPUTS)) | st.builds(waited, numbers, numbers.map(lambda x: 50 + x))
    | st.builds(goal_distance, numbers, numbers.map(lambda x: 50 + x)) | st.builds(detector, numbers)
    | st.just("own"),
    max_size=6, unique_by=lambda one: INPUTS[one].name if one in INPUTS else getattr(one, "name", one),
)  # fmt: skip
kinds = st.dictionaries(
    st.builds(Kind, st.sampled_from("ab"), st.integers(1, 3000), st.booleans(),
              st.dictionaries(st.sampled_from(["out_m", "near_m"]), numbers, max_size=2)),
    st.integers(0, 9), min_size=1, max_size=3,
)  # fmt: skip


@settings(max_examples=12, deadline=None, derandomize=True)
@given(inputs, st.permutations(list(OUTPUTS)), st.booleans(), kinds, st.integers(1, 3), st.integers(1, 999))
def test_any_selection_survives_documents_studies_certificates_and_specs(
    tmp_path_factory, chosen, outputs, all_outputs, robots, needed, limit
):
    folder = tmp_path_factory.mktemp("own")
    code = own(folder)
    robots = robots | {Kind("c", 1000, True): 3}
    chosen = [code.named("own:out", "test") if one == "own" else one for one in chosen]
    outputs = outputs if all_outputs else [name for name in outputs if name in TABLE_I_OUTPUTS]
    asked = {"team": robots, "weapons_needed": needed, "limit": limit, "inputs": chosen, "outputs": outputs}
    mission = Mission(HOUSE, **asked)
    document = json.loads(json.dumps(terms_to_json(mission)))

    def same(terms) -> None:
        again = Mission(HOUSE, **terms)
        assert again.task == mission.task
        assert list(again.team.items()) == list(mission.team.items())  # in the order in which robots are numbered
        for name in ("weapons_needed", "limit", "outputs"):
            assert getattr(again, name) == getattr(mission, name)
        for one, other in zip(again.inputs, mission.inputs, strict=True):
            assert (one.variable, one.numbers) == (other.variable, other.numbers)

    same(terms_from_json(document, "here", OwnCode(folder).named))
    HOUSE.save(folder / "house.json")
    study = Study.every({"house": HOUSE}, {"plain": Condition()}, ["random"], seeds=1, **asked)
    same(terms_of(Study.from_spec(study.spec("kept"), folder).mission("plain", "house")))
    ground = json.loads(json.dumps(Ground(HOUSE, **asked).to_json()))
    same(terms_of(Ground.from_json(ground, HOUSE, OwnCode(folder)).mission(1, 0)))
    spec = {"name": "s", "environment": {"building": "house.json", **document}, "stages": [{"name": "a", "trials": 2}]}
    same(terms_of(curriculum_of(spec, folder).stages[0].world))
    (folder / "arm.json").write_text(json.dumps({**spec, "environment": {}}))
    same(terms_of(arm_of(folder / "arm.json").curriculum(Setup(mission)).stages[-1].world))
    (folder / "s.json").write_text(json.dumps({**spec, "simplify": {"trials": 2}}))
    same(terms_of(study_of(folder / "s.json").curriculum(None).stages[-1].world))


def trained(file: Path) -> Path:
    """Train on what a file declares; return the run's folder."""
    HOUSE.save(file.with_name("house.json"))
    run, arms = file.with_name("run"), ("expert", "direct", "copy-prior", "search")
    lines, _ = train(building=file.with_name("house.json"), mission=file, arms=arms, seeds=1, trials=3, practice=400,
                     ready=0.1, out=run)  # fmt: skip
    assert lines[0].startswith("ready: ")
    mission = Mission(HOUSE, **declared(file))
    assert tl.Policy.load(run / "policy.json").task == mission.task
    ground = json.loads((run / "certificate.json").read_text())["ground"]
    assert [kind["kind"] for kind in ground["mission"]["team"]] == ["scout", "crawler"]
    assert verify(run / "certificate.json").startswith("99 % sure")
    (_, trace), = run_traces(run)
    assert trace.mission.task == mission.task
    assert trace.mission.team == mission.team
    assert replay([("it", trace)], "title")["tasks"][0]["outputs"][-1]["name"] == "BACK"
    shown = CliRunner().invoke(policy_show, [str(run / "policy.json"), "--json"])
    states = json.loads(shown.stdout)
    assert set(states[0]["state"]) == {variable.name for variable in mission.task.inputs}
    assert 0 < len(states) < mission.task.shape[0] / 2  # those that occur
    return run


def test_training_certifies_and_replays_what_the_file_declares(tmp_path: Path):
    file = tmp_path / "office.toml"
    file.write_text(DECLARED + KINDS)
    trained(file)


@pytest.mark.slow
def test_sensors_of_ones_own_go_with_the_policy(file: Path):
    run = trained(file)
    (run / "own.py").write_text(OWN.replace("1 if", "0 if"))
    with pytest.raises(TaskliftError, match=r"own\.py: has changed since 'OUT' was recorded"):
        verify(run / "certificate.json")
    (run / "own.py").unlink()
    for use, name in ((verify, "certificate.json"), (certify, "policy.json"), (run_traces, "")):
        with pytest.raises(TaskliftError, match=r"no own\.py beside"):
            use(run / name)


def test_what_cannot_be_done_with_a_selection_is_refused_before_anything_is_computed(file: Path, tmp_path: Path):
    HOUSE.save(tmp_path / "house.json")
    blind = tmp_path / "blind.toml"
    blind.write_text('inputs = ["DL", "GL", "TEAM"]\n')
    for command, message in (
        (lambda: train(building=tmp_path / "house.json", mission=blind, out=tmp_path / "run"),
         "arm 'expert': task 'search and clear': no variable 'FTR'|arm 'expert': .*no variable 'FTR'"),
        (lambda: team(building=tmp_path / "house.json", mission=blind, out=tmp_path / "run"), "no variable 'FTR'"),
    ):  # fmt: skip
        with pytest.raises(TaskliftError, match=message):
            command()
    assert not (tmp_path / "run").exists()
    with pytest.raises(TaskliftError, match="the same inputs and outputs"):
        tl.Missions([Mission(HOUSE, "2+2"), Mission(HOUSE, "2+2", inputs=["DL"])])


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ('inputs = ["XX"]', "inputs: expected a Sensor or one of DL"),
        ('inputs = [{ sensor = "sonar" }]', "inputs, sensor: expected one of waited, goal_distance, detector"),
        ('inputs = [{ sensor = "detector", reach = 3 }]', "sensor detector: .*unexpected keyword argument 'reach'"),
        ('inputs = [{ sensor = "detector", miss = 3 }]', "miss: expected a probability"),
        ('inputs = [{ python = "own:number" }]', "expected a Sensor in own:number, found 3"),
        ('inputs = [{ python = "os:system" }]', r"no os\.py beside"),
        ('inputs = [{ python = "own:nothing" }]', "has no 'nothing'"),
        ('inputs = [{ python = "own:out", more = 1 }]', "unknown field 'more'"),
        ("inputs = [3]", "expected the name of a variable or a table, found 3"),
        ('inputs = ["DL", "DL"]', "inputs: expected each variable once"),
        ('outputs = ["MV", "WPN", "CA", "FLY"]', "outputs: expected names among"),
        ('outputs = ["MV"]', "outputs: expected each of MV, WPN, CA once"),
        ("hostiles = 2", "unknown field 'hostiles'"),
        ('team = [{ kind = "bee", robots = 3 }]', "kind 'bee', speed_mm .*found None"),
        ('team = [{ kind = "scout", robots = 3 }, { kind = "scout", robots = 1 }]', "the kind 'scout' is there twice"),
        ('team = [{ kind = "weapon", robots = 2, speed_mm = 0.5 }]', "expected a whole number in the field 'speed_mm'"),
        ("team = [3]", "team: expected an object"),
        ("limit = 0", "limit: expected a whole number from 1"),
        ("weapons_needed = 0", "weapons_needed: expected a whole number from 1"),
    ],
)  # fmt: skip
def test_a_bad_file_is_one_line_that_names_it(text: str, message: str, tmp_path: Path):
    own(tmp_path)
    file = tmp_path / "bad.toml"
    file.write_text(text)
    with pytest.raises(TaskliftError, match=message) as found:
        Mission(HOUSE, **declared(file))
    assert "\n" not in str(found.value)
    assert str(found.value).count("bad.toml") == 1


def test_a_mission_goes_through_its_file(file: Path, tmp_path: Path):
    mission = Mission(HOUSE, **declared(file))
    (tmp_path / "copy").mkdir()
    save_declared(mission, tmp_path / "copy")
    again = Mission(HOUSE, **declared(None, tmp_path / "copy"))
    assert again.task == mission.task
    assert again.team == mission.team
    (tmp_path / "copy" / "own.py").unlink()
    with pytest.raises(TaskliftError, match=r"no own\.py beside"):
        declared(None, tmp_path / "copy")
    assert declared(file, team="3+3", limit=5)["limit"] == 5
    assert Mission(HOUSE, **declared(None)).task == Mission(HOUSE, "10+5").task
