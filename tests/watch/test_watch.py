"""Replays: what can be watched, what the documents hold, the command and its server."""

from __future__ import annotations

import base64
import dataclasses
import http.client
import json
import os
import re
import signal
import subprocess
import sys
import zlib

import numpy as np
import pytest
from click.testing import CliRunner

from tasklift.building import SCOUT, WEAPON, Building, Mission, generate
from tasklift.building.reading import PRESETS
from tasklift.cli.watch import watch_command
from tasklift.errors import TaskliftError
from tasklift.lab import FILE_NAME, Spec, Store, run
from tasklift.learning.reinforcement import Reinforcement, reinforce
from tasklift.studies.arms import PAPER
from tasklift.studies.drills.study import study as drills
from tasklift.studies.study import Condition, Study
from tasklift.tasks.policy import Policy
from tasklift.watch import page, read, replay
from tasklift.watch.sources import MOST, policy_traces, run_traces, study_traces

SMALL = dataclasses.replace(  # as if somebody had drawn it: it cannot be generated again
    generate(intersections=6, corridors=7, rooms=2, features=6, doors=4, seed=1), provenance={}
)
SLUGS = [arm.slug for arm in PAPER]


def study(arms=SLUGS, readings=("scattered", "cohesive"), rules=None, **options) -> Study:
    given = {"seeds": 2, "trials": 6, "repeats": 1, "limit": 150, "team": {SCOUT: 3, WEAPON: 3}} | options
    conditions = {name: Condition(PRESETS[name], rules or Reinforcement()) for name in readings}
    return Study.every({"small": SMALL}, conditions, arms, **given)


def unpack(packed) -> np.ndarray:
    raw = np.frombuffer(zlib.decompress(base64.b64decode(packed["data"])), packed["type"])
    values = raw.reshape(packed["shape"])
    return np.cumsum(values, axis=-1, dtype=values.dtype) if packed["steps"] else values


# --- what can be watched ---------------------------------------------------------------------------------------


@pytest.mark.parametrize("arm", SLUGS)
@pytest.mark.parametrize("time_signal", ["inverted", "baseline"])
def test_every_trial_of_an_arm_is_traced_as_the_unbroken_run_has_it(arm, time_signal):
    one = study(rules=Reinforcement(time_signal=time_signal, loss_signal=-0.5))
    cell = one.cell("cohesive", "small", 1, arm)
    rows = one.work(cell).stages["target"]
    traces = study_traces(one, condition="cohesive", map="small", seed=1, arms=[arm], trials=[1, 2, 6])
    assert [label for label, _ in traces] == ["trial 1", "trial 2", "trial 6"]
    for trial, (_, trace) in zip([1, 2, 6], traces, strict=True):
        assert (trace.steps if trace.success else 150) == rows["steps"][trial - 1]
        assert trace.success == rows["success"][trial - 1]
        assert trace.losses[-1] == rows["losses"][trial - 1]
        assert trace.messages[-1] == rows["messages"][trial - 1]
        assert trace.robots["alive"][-1].sum() == rows["robots_left"][trial - 1]


def test_arms_stand_side_by_side_with_the_same_hostiles():
    traces = study_traces(study(), condition="scattered", map="small", seed=0, arms=["direct", "copy"], trials=[3])
    assert [label for label, _ in traces] == ["direct", "copy"]
    assert (traces[0][1].hostile[0] == traces[1][1].hostile[0]).all()
    with pytest.raises(TaskliftError, match=f"at most {MOST}"):
        study_traces(study(), condition="scattered", map="small", seed=0, arms=["direct"] * 5, trials=[1, 2])
    with pytest.raises(TaskliftError, match="the trials 1 to 6"):
        study_traces(study(), condition="scattered", map="small", seed=0, arms=["direct"], trials=[0])


def test_greedy_policies_play_the_trials_that_a_study_counts():
    one = study()
    cell = one.cells()[2]
    greedy = one.work(cell).stages["greedy"]
    mission = one.mission(cell["reading"], cell["map"])
    for trial in (1, 4):
        [(label, trace)] = policy_traces(
            mission, [("learned", one.train(cell).policy)], seed=int(cell["seed"]), trial=trial, greedy=True
        )
        assert label == "learned"
        assert (trace.steps if trace.success else 150) == greedy["steps"][trial - 1]
        assert trace.losses[-1] == greedy["losses"][trial - 1]


@pytest.fixture
def experiment(tmp_path):
    one = study(("direct", "copy"), ("scattered",))
    with Store.open(tmp_path / FILE_NAME, one.spec("a test")) as store:
        run(store, one.cells(), one.work, workers=1)
    SMALL.save(tmp_path / "building.json")
    return tmp_path


def test_trials_of_an_experiment_are_found_by_map_seed_arm_and_number(experiment):
    def traces(**options):
        return run_traces(experiment, **options)

    assert [(label, trace.trial) for label, trace in traces()] == [("direct", 5), ("copy", 5)]
    assert [label for label, _ in traces(arms=["copy"], trials=[1, 4], seed=1)] == ["trial 1", "trial 4"]
    for options, message in (
        ({"condition": "cohesive"}, "there are: scattered"),
        ({"map": "big"}, "there are: small"),
        ({"arms": ["prior"]}, "there are: copy, direct"),
        ({"seed": 2}, "there are: 0, 1"),
        ({"trials": [7]}, "trials 1 to 6 in stage 'target', not trial 7"),
        ({"stage": "drill"}, "no stage 'drill'"),
    ):
        with pytest.raises(TaskliftError, match=message):
            traces(**options)
    (experiment / "building.json").unlink()
    with pytest.raises(TaskliftError, match=r"put its \.json file back"):
        traces()


def test_rows_that_this_release_plays_differently_are_refused(experiment, monkeypatch):
    from tasklift.lab import CellResult

    result = Store.result

    def altered(store, cell):
        found = result(store, cell)
        target = dict(found.stages["target"])
        target["steps"] = target["steps"] + 1
        return CellResult({**found.stages, "target": target})

    monkeypatch.setattr(Store, "result", altered)
    with pytest.raises(TaskliftError, match="recorded by tasklift"):
        run_traces(experiment, trials=[2])


def test_every_stage_of_every_experiment_can_be_watched(tmp_path):
    plan = drills(maps=1, seeds=1, hostiles=(1, 2))
    cells = [plan.cell(h, "map-0", 0, "copy-every-door-80-q90") for h in ("1", "2")]
    with Store.open(tmp_path / FILE_NAME, plan.spec("drills")) as store:
        run(store, cells, plan.work, workers=1)
    for stage, last in (("source", 220), ("drill", 80), ("target", 100)):
        [(label, trace)] = run_traces(tmp_path, condition="2", stage=stage)
        assert label == "copy→every-door drill 80, q = .9"
        assert trace.trial == last - 1
        assert trace.mission.n_hostiles == {"source": 0, "drill": 6, "target": 2}[stage]
    result = watch(tmp_path, "--hostiles", "2", "--stage", "drill", "--trials", "1,80", "--json", tmp_path / "r.json")
    assert result.exit_code == 0, result.output
    assert [trace["label"] for trace in read(tmp_path / "r.json")["traces"]] == ["trial 1", "trial 80"]


def test_an_experiment_of_another_kind_is_refused(tmp_path):
    with Store.open(tmp_path / FILE_NAME, Spec.of("apples", {"apples": 3}, {"seed": [0]})):
        pass
    with pytest.raises(TaskliftError, match="not a study of missions"):
        run_traces(tmp_path)


# --- the document ----------------------------------------------------------------------------------------------


def test_a_long_trial_of_fifteen_robots_fits_into_100_kb():
    mission = Mission(generate(seed=4), {SCOUT: 10, WEAPON: 5}, hostiles=3)
    learned = reinforce(mission, Policy.equal(mission.task, 1.5), trials=60, seed=0).policy
    traces = [mission.simulator.trace(learned, seed=0, trial=trial) for trial in range(60, 70)]
    trace = max(traces, key=lambda t: t.steps)
    assert trace.steps == 600
    assert len(json.dumps(replay([("direct", trace)], "long"))) < 100_000


def test_arrays_come_back_to_the_last_bit():
    mission = Mission(SMALL, {SCOUT: 3, WEAPON: 2}, limit=80)
    policy = Policy(mission.task, np.random.default_rng(0).uniform(0, 3, mission.task.shape), {})
    trace = mission.simulator.trace(policy, seed=3)
    document = json.loads(json.dumps(replay([("a", trace)], "a"), allow_nan=False))
    arrays = {name: unpack(packed) for name, packed in document["traces"][0]["arrays"].items()}
    robots = trace.robots
    assert (arrays["weights"] == policy.weights).all()
    assert (arrays["progress"] == robots["progress"].T).all()
    assert (arrays["danger"] == robots["dl"].T).all()
    assert (arrays["about"] == robots["alert"].T).all()
    assert (arrays["input"] == robots["row"].T).all()
    alive = (arrays["died"][:, None] < 0) | (np.arange(trace.steps + 1) < arrays["died"][:, None])
    assert (alive == (robots["alive"].T == 1)).all()
    assert (arrays["messages"][0] == trace.messages).all()
    for name, flags in (("visited", trace.visited), ("resolved", trace.resolved)):
        first = arrays[name]
        seen = (first >= 0) & (first <= np.arange(trace.steps + 1)[:, None])
        assert (seen == flags).all()


def test_traces_of_different_buildings_or_teams_do_not_stand_side_by_side():
    def trace(building, scouts):
        mission = Mission(building, {SCOUT: scouts, WEAPON: 2}, limit=5)
        return mission.simulator.trace(Policy.equal(mission.task))

    other = generate(intersections=6, corridors=7, rooms=2, features=6, doors=4, seed=2)
    for second in (trace(SMALL, 3), trace(other, 2)):
        with pytest.raises(TaskliftError, match="'b' has another building or team than 'a'"):
            replay([("a", trace(SMALL, 2)), ("b", second)], "no")
    with pytest.raises(TaskliftError, match="at least one trace"):
        replay([], "none")


# --- the command -----------------------------------------------------------------------------------------------


@pytest.fixture
def building_file(tmp_path):
    SMALL.save(tmp_path / "small.json")
    return tmp_path / "small.json"


def watch(*arguments):
    return CliRunner().invoke(watch_command, [str(a) for a in arguments], catch_exceptions=True)


def test_a_building_is_watched_with_arms_or_policies(building_file, tmp_path):
    small = ("--team", "2+2", "--limit", "60")
    result = watch(building_file, *small, "--arms", "direct,prior", "--trial", "2", "--json", tmp_path / "r.json")
    assert result.exit_code == 0, result.output
    document = read(tmp_path / "r.json")
    assert [trace["label"] for trace in document["traces"]] == ["direct", "prior"]
    assert [trace["trial"] for trace in document["traces"]] == [2, 2]

    again = watch(tmp_path / "r.json", "--html", tmp_path / "r.html")
    assert again.exit_code == 0, again.output
    assert (tmp_path / "r.html").read_text("utf-8") == page(document)

    mission = Mission(Building.load(building_file), {SCOUT: 2, WEAPON: 2}, limit=60)
    Policy.equal(mission.task).save(tmp_path / "even.json")
    result = watch(
        building_file, *small, "--policy", tmp_path / "even.json", "--draw", "--trials", "1,3",
        "--json", tmp_path / "p.json",
    )  # fmt: skip
    assert result.exit_code == 0, result.output
    document = read(tmp_path / "p.json")
    assert [trace["label"] for trace in document["traces"]] == ["even, trial 1", "even, trial 3"]
    assert not document["traces"][0]["learner"]["learns"]


def test_mistakes_are_told_in_one_line(building_file, tmp_path):
    nan = tmp_path / "nan.json"
    nan.write_text('{"format": "tasklift-replay", "version": 1, "title": NaN}')
    newer = tmp_path / "newer.json"
    newer.write_text('{"format": "tasklift-replay", "version": 2}')
    cut = tmp_path / "cut.json"
    cut.write_text('{"format": "tasklift-replay", "vers')
    plan = tmp_path / "plan.pgm"
    plan.write_bytes(b"P5 2 2 255 " + bytes(4))
    for arguments, message in (
        ((tmp_path / "nothing",), "no such file or folder"),
        ((plan,), "is a floor plan, not a building"),
        ((nan,), "NaN"),
        ((newer,), "version 2"),
        ((cut,), "cut short"),
        ((tmp_path,), "no such experiment"),
        ((building_file, "--trials", "0"), "numbers from 1"),
        ((building_file, "--trials", "one"), "numbers from 1"),
        ((building_file, "--team", "ten"), "SCOUTS+WEAPONS"),
        ((building_file, "--arms", "fastest"), "unknown"),
        ((building_file, "--preset", "neat"), "scattered, cohesive"),
        ((building_file, "--map", "x"), "not with a building"),
        ((building_file, "--policy", building_file, "--arms", "direct"), "exclude"),
    ):
        result = watch(*arguments)
        told = str(result.exception) if isinstance(result.exception, TaskliftError) else result.output
        assert result.exit_code != 0
        assert message in told, (arguments, told)
        assert "\n" not in str(result.exception)


def test_the_server_answers_on_its_own_address_only_and_ends_with_ctrl_c(building_file):
    command = (
        "from tasklift.cli.main import main; import sys; "
        f"sys.argv[1:] = ['watch', {str(building_file)!r}, '--arms', 'direct', '--trial', '1', '--no-open']; "
        "main()"
    )
    process = subprocess.Popen(
        [sys.executable, "-c", command], stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True,
        env=os.environ | {"PYTHONUNBUFFERED": "1"},
    )  # fmt: skip
    try:
        line = process.stdout.readline()
        port = int(re.fullmatch(r"watch at http://127\.0\.0\.1:(\d+)/ \(Ctrl-C ends it\)\n", line)[1])

        def ask(method, path, **headers):
            connection = http.client.HTTPConnection("127.0.0.1", port, timeout=10)
            connection.request(method, path, headers=headers)
            answer = connection.getresponse()
            body = answer.read()
            connection.close()
            return answer.status, body

        status, body = ask("GET", "/")
        assert status == 200
        assert b"<title>" in body
        assert ask("HEAD", "/") == (200, b"")
        assert ask("GET", "/etc/passwd")[0] == 404
        assert ask("GET", "/", Host="example.org")[0] == 403
        assert ask("POST", "/")[0] == 501
    finally:
        process.send_signal(signal.SIGINT)
        _, errors = process.communicate(timeout=60)
    assert process.returncode == 0, errors
    assert "Traceback" not in errors
