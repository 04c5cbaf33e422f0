"""Spec files: the examples run, what they say is what happens, and what is wrong in one is named."""

from __future__ import annotations

import contextlib
import re
import shutil
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import pytest
from click.testing import CliRunner
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from row_digests import RECORDED, digest
from tasklift.cli.learn import learn_command
from tasklift.errors import TaskliftError
from tasklift.files import parse_json
from tasklift.learning.compare import compare
from tasklift.studies import own_code
from tasklift.studies.learn import run_spec
from tasklift.studies.spec_file import arm_of, curriculum_of, read_spec
from tasklift.studies.study import Condition, Study, generated
from tasklift.tasks.policy import Policy

pytest.importorskip("gymnasium")
FUZZ = settings(
    deadline=None,
    derandomize=True,
    max_examples=250,
    suppress_health_check=[HealthCheck.function_scoped_fixture],
)
EXAMPLES = Path(__file__).parents[2] / "examples"
NAMES = sorted(path.name for path in (path for path in EXAMPLES.glob("*.toml") if not path.name.startswith("simplify")))


def shortened(name: str, folder: Path) -> Path:
    """The example with small budgets."""
    text = (EXAMPLES / name).read_text()
    text = re.sub(r"steps = \d{4,}", "steps = 3000", text)
    text = re.sub(r"trials = \d{3,}", "trials = 30", text)
    copy = folder / name
    copy.write_text(text)
    return copy


def test_there_is_an_example_for_each_case() -> None:
    assert len(NAMES) >= 7


@pytest.mark.parametrize("name", NAMES)
def test_every_example_runs_and_reports(name: str, tmp_path: Path) -> None:
    out = tmp_path / "out"
    result = CliRunner().invoke(learn_command, [str(shortened(name, tmp_path)), "--seeds", "2", "--out", str(out)])
    assert result.exception is None
    assert "curriculum against direct learning, 2 seeds" in result.output
    told = parse_json((out / "comparison.json").read_text(), "comparison")
    assert len(told["findings"]) == 6
    assert (out / "comparison.txt").read_text().strip() in result.output
    assert np.isfinite(Policy.load(out / "policy.json").weights).all()


@pytest.mark.parametrize("name", NAMES)
def test_the_rows_of_the_examples_do_not_change(name: str) -> None:
    curriculum = curriculum_of(read_spec(EXAMPLES / name), EXAMPLES)
    for seed in range(2):
        run = curriculum.run(seed)
        stages = {
            stage: {n: value for n, value in vars(outcomes).items() if isinstance(value, np.ndarray)}
            for stage, outcomes in run.outcomes.items()
        }
        found = digest(stages, {"policy": run.policy.weights, "best": run.best.weights})
        assert found == RECORDED["learn"][f"{Path(name).stem}/{seed}"]


def test_the_building_example_is_the_papers_experiment() -> None:
    curriculum = curriculum_of(read_spec(EXAMPLES / "building.toml"))
    v, t = curriculum.stages
    assert (v.task.shape, t.task.shape) == ((15, 44), (90, 44))
    assert v.world.n_hostiles == 0
    assert (v.learner.repeats, t.trials, t.max_losses) == (5, 100, 600)
    assert np.unique(v.task.signal_table(impossible=False)).tolist() == [-0.2, 0.0]
    drill = curriculum_of(read_spec(EXAMPLES / "drill.toml")).stages[0]
    assert drill.rehearsal
    assert drill.world.reading.drill


def test_the_same_spec_gives_the_same_files_and_another_is_kept_out(tmp_path: Path) -> None:
    spec = shortened("cliff.toml", tmp_path)
    one = run_spec(spec, tmp_path / "a", seeds=2)
    run_spec(spec, tmp_path / "a", seeds=2)
    run_spec(spec, tmp_path / "b", seeds=2)
    for name in ("comparison.json", "comparison.txt", "policy.json"):
        assert (tmp_path / "a" / name).read_bytes() == (tmp_path / "b" / name).read_bytes()
    before = files(tmp_path / "a")
    spec.write_text(spec.read_text().replace("epsilon = 0.1", "epsilon = 0.2"))
    with pytest.raises(TaskliftError, match=r"holds another experiment: learner.epsilon: 0.1, not 0.2"):
        run_spec(spec, tmp_path / "a", seeds=2)
    assert files(tmp_path / "a") == before
    with pytest.raises(TaskliftError, match="is not empty"):
        run_spec(spec, tmp_path, seeds=2)
    assert one.seeds == 2


def files(folder: Path) -> dict[str, bytes]:
    return {name: (folder / name).read_bytes() for name in ("comparison.json", "comparison.txt", "policy.json")}


def test_more_seeds_are_added_and_what_is_there_is_not_computed_again(tmp_path: Path) -> None:
    spec, computed = shortened("building.toml", tmp_path), []
    run_spec(spec, tmp_path / "a", seeds=2)
    two = files(tmp_path / "a")
    more = run_spec(spec, tmp_path / "a", seeds=4, progress=lambda done, total, note: computed.append(note))
    assert sorted(computed) == [f"seed {seed}, arm {arm}" for seed in (2, 3) for arm in ("curriculum", "direct")]
    run_spec(spec, tmp_path / "b", seeds=4)
    assert files(tmp_path / "a") == files(tmp_path / "b")
    run_spec(spec, tmp_path / "a", seeds=2, progress=lambda *_: pytest.fail("computed again"))
    assert files(tmp_path / "a") == two
    # how it is judged is no part of the rows
    spec.write_text(spec.read_text().replace('performance = "steps"', 'performance = "success"\nfirst = 5'))
    judged = run_spec(spec, tmp_path / "a", seeds=2, progress=lambda *_: pytest.fail("computed again"))
    assert judged.finding("jumpstart (success, first 5 trials)") is not None
    assert more.seeds == 4
    by_hand = compare(curriculum_of(read_spec(spec), tmp_path), seeds=4, performance="steps")
    assert str(more) == str(by_hand)
    assert np.array_equal(more.policy.weights, by_hand.policy.weights)
    assert more.policy.provenance == by_hand.policy.provenance
    assert more.policy.task == by_hand.policy.task


def test_guards_values_and_what_learners_carry_come_back_from_the_store(tmp_path: Path) -> None:
    spec = shortened("lake-punished-falls.toml", tmp_path)
    stored = run_spec(spec, tmp_path / "out", seeds=2)
    document = read_spec(spec)
    options = {name: document[name] for name in ("performance", "threshold") if name in document}
    by_hand = compare(curriculum_of(document, tmp_path), seeds=2, **options)
    assert stored.to_json() == by_hand.to_json()
    assert stored.guards
    loaded = Policy.load(tmp_path / "out" / "policy.json")
    assert loaded.kind == "value"
    assert np.array_equal(loaded.carried["visits"], by_hand.policy.carried["visits"])


def test_killed_at_any_moment_the_same_command_finishes(tmp_path: Path) -> None:
    spec = tmp_path / "building.toml"
    spec.write_text((EXAMPLES / "building.toml").read_text())
    run_spec(spec, tmp_path / "unbroken", seeds=6)
    line = [sys.executable, "-c", "from tasklift.cli.main import main; main()", "learn", str(spec), "--seeds", "6"]
    line += ["--out", str(tmp_path / "killed")]
    for wait in (0.0, 0.6):
        process = subprocess.Popen(line, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)
        while process.poll() is None and not (tmp_path / "killed" / "experiment.sqlite").exists():
            time.sleep(0.01)
        time.sleep(wait)
        process.kill()
        process.wait()
    done = subprocess.run(line, capture_output=True, text=True, timeout=300)
    assert done.returncode == 0, done.stderr
    assert files(tmp_path / "killed") == files(tmp_path / "unbroken")
    names = {file.name for file in (tmp_path / "killed").iterdir()}
    assert names == {"experiment.sqlite", "comparison.json", "comparison.txt", "policy.json"}


def test_a_world_of_ones_own_from_a_python_file(tmp_path: Path) -> None:
    (tmp_path / "my_little_world.py").write_text(
        "from tasklift import Step, Task, Variable\n"
        "class Coin:\n"
        "    task = Task('coin', (Variable('side', (0, 1)),), (Variable('guess', (0, 1)),))\n"
        "    limit = 1\n"
        "    def __init__(self, bias=0.5):\n"
        "        self.bias = bias\n"
        "    def start(self, rng):\n"
        "        self.side = int(rng.random() < self.bias)\n"
        "        return self.side\n"
        "    def step(self, output):\n"
        "        right = output == self.side\n"
        "        return Step(self.side, float(right), True, int(not right), right)\n"
    )
    spec = tmp_path / "coin.toml"
    spec.write_text(
        'name = "coin"\nseeds = 5\n[environment]\npython = "my_little_world:Coin"\n[learner]\nrule = "sarsa"\n'
        'step_size = 0.5\n[[stages]]\nname = "one side"\noptions = { bias = 0.0 }\ntrials = 20\n'
        '[[stages]]\nname = "both"\ntrials = 60\n'
    )
    comparison = run_spec(spec)
    assert comparison.finding("late return (last 20 trials)").curriculum > 0.8
    text = spec.read_text().replace("Coin", "Dime")
    spec.write_text(text)
    with pytest.raises(TaskliftError, match="module 'my_little_world' has no 'Dime'"):
        run_spec(spec)


OWN = 'name = "own"\nseeds = 2\n[environment]\npython = "own_learner:Ferry"\noptions = { storms = 0.5 }\n[learner]\n'
STAGE = '[[stages]]\nname = "a"\ntrials = 20\n'


def beside(tmp_path: Path, text: str, module: str | None = None) -> Path:
    shutil.copy(EXAMPLES / "ferry.py", tmp_path)
    (tmp_path / "own_learner.py").write_text(module or (EXAMPLES / "own_learner.py").read_text())
    spec = tmp_path / "own.toml"
    spec.write_text(text)
    return spec


def test_a_learner_of_ones_own_from_a_python_file(tmp_path: Path) -> None:
    text = f'{OWN}python = "own_learner:RandomSearch"\nsize = 0.5\n{STAGE}'
    last = '[[stages]]\nname = "b"\ntrials = 30\nlearner = { rule = "reinforcement", q = 0.5, loss_signal = -0.5 }\n'
    curriculum = curriculum_of(read_spec(beside(tmp_path, text + last)), tmp_path)
    one, other = (stage.learner for stage in curriculum.stages)
    assert (type(one).__name__, one.size) == ("RandomSearch", 0.5)
    assert other.q == 0.5
    # two specs in two folders may each have a module of the same name
    again = tmp_path / "again"
    again.mkdir()
    module = (EXAMPLES / "own_learner.py").read_text().replace("size: float = 1.0", "size: float = 3.0")
    spec = beside(again, text.replace("size = 0.5\n", ""), module)
    assert curriculum_of(read_spec(spec), again).stages[0].learner.size == 3.0
    assert run_spec(tmp_path / "own.toml", tmp_path / "out").seeds == 2


@pytest.mark.parametrize(
    ("module", "learner", "message"),
    [
        ("import sys\nsys.exit(3)", "", "stage 'a': environment: own_learner.py, line 2: ends the program"),
        ("raise OSError('disk\\nfull')", "", "environment: own_learner.py, line 1: OSError: disk full"),
        ("def Ferry(", "", "own_learner.py, line 1: SyntaxError"),
        ("import no_such_module", "", "own_learner.py, line 1: ModuleNotFoundError: No module named 'no_such_module'"),
        ("while True: pass", "", "own_learner.py, line 1: was not done after 0.3 s"),
        ("import time\ndef Ferry(storms):\n    time.sleep(60)", "", "line 3: was not done after 0.3 s"),
        ("Ferry = 5", "", "expected a class or a function in own_learner:Ferry, found 5"),
        ("Ferry = dict", "", "makes no world: it needs a task"),
        ("def Ferry(): pass", "", "TypeError: .*unexpected keyword argument 'storms'"),
        ("def Ferry(storms):\n    return 1 / 0", "", "own_learner.py, line 2: ZeroDivisionError: division by zero"),
        (None, 'python = "own_learner:Ferry"\nstorms = 0.1\n', "makes no learner: it has no learn\\(\\)"),
        (None, 'python = "own_learner:RandomSearch"\nsice = 0.1\n', "unexpected keyword argument 'sice'"),
        (None, 'python = "own_learner:RandomSearch"\nsize = "x"\n', "training: own_learner.py, line .*: .*Error"),
        (None, "python = 5\n", "learner: expected text, found 5"),
        (None, 'python = "own_learner"\n', "expected module:name, found 'own_learner'"),
        (None, 'python = "../x:y"\n', "expected the name of a module"),
    ],
)
def test_what_goes_wrong_in_code_of_ones_own_is_one_line(
    module: str | None, learner: str, message: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(own_code, "LONGEST_LOAD_S", 0.3)
    spec = beside(tmp_path, f"{OWN}{learner}{STAGE}", module)
    result = CliRunner().invoke(learn_command, [str(spec)])
    assert isinstance(result.exception, TaskliftError)
    assert re.search(message, str(result.exception))
    assert "\n" not in str(result.exception)
    assert len(str(result.exception)) <= 300 + len(str(spec))


@pytest.mark.parametrize(
    "environment",
    [
        'python = "os:system"\noptions = { command = "touch RAN" }',
        'python = "subprocess:check_output"\noptions = { args = "touch RAN", shell = true }',
        'gymnasium = "ran_by_name:Env-v0"\noptions = {}\n[task]\ninputs = { x = 2 }\noutputs = { y = 2 }',
    ],
)
def test_a_spec_alone_runs_nothing(environment: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    elsewhere = tmp_path / "elsewhere"
    elsewhere.mkdir()
    (elsewhere / "ran_by_name.py").write_text("open('RAN', 'w').close()")
    monkeypatch.syspath_prepend(str(elsewhere))
    monkeypatch.chdir(tmp_path)
    spec = tmp_path / "s.toml"
    spec.write_text(f'name = "x"\nseeds = 2\n[environment]\n{environment}\n{STAGE}')
    with pytest.raises(TaskliftError, match="beside the spec; other modules are imported with --allow-imports only"):
        run_spec(spec)
    assert not (tmp_path / "RAN").exists()
    with pytest.raises(TaskliftError):  # it makes no world, but with the option it runs
        run_spec(spec, allow_imports=True)
    assert (tmp_path / "RAN").exists()


def test_a_chain_of_three_tasks_and_other_fields(tmp_path: Path) -> None:
    spec = tmp_path / "chain.toml"
    text = (EXAMPLES / "building.toml").read_text()
    middle = '[[stages]]\nname = "no goal"\nfix = { GL = 0 }\ntrials = 5\n\n[[stages]]\nname = "T"'
    spec.write_text(
        text.replace('[[stages]]\nname = "T"', middle).replace("fix = { DL = 0, GL = 0 }", "fix = { DL = 0 }")
    )
    curriculum = curriculum_of(read_spec(spec))
    assert [stage.task.shape[0] for stage in curriculum.stages] == [15, 45, 90]


VALUES = ["0", "-1", "1.5", "true", '"x"', "[]", "{}", "1e400", "nan", "99999999999999999999", "[1, 2]", "{ a = 1 }"]


@FUZZ
@given(
    name=st.sampled_from([name for name in NAMES if name != "lake-punished-falls.toml"]),
    place=st.floats(0, 1, exclude_max=True),
    change=st.sampled_from(VALUES) | st.integers(0, 255) | st.none(),
)
def test_a_damaged_spec_is_refused_or_means_something(name: str, place: float, change, tmp_path: Path) -> None:
    text = (EXAMPLES / name).read_text()
    spec = tmp_path / "spec.toml"
    if change is None:
        spec.write_text(text[: int(place * len(text))])
    elif isinstance(change, int):
        raw = bytearray(text.encode())
        raw[int(place * len(raw))] = change
        spec.write_bytes(bytes(raw))
    else:
        values = list(re.finditer(r"= ([^\n{}\[\]]+?)(?=[\n,} ])", text))
        found = values[int(place * len(values))]
        spec.write_text(text[: found.start(1)] + change + text[found.end(1) :])
    with contextlib.suppress(TaskliftError):
        curriculum_of(read_spec(spec), tmp_path)


def changed(old: str, new: str, example: str = "cliff.toml") -> str:
    text = (EXAMPLES / example).read_text()
    assert old in text
    return text.replace(old, new, 1)


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("name = ", "not valid TOML"),
        ("", "the field 'name' is missing"),
        (changed('name = "cliff"', 'name = "cliff"\nnmae = 1'), "unknown field 'nmae'"),
        (changed('gymnasium = "CliffWalking-v1"', ""), "expected one of gymnasium, building or python"),
        (changed("CliffWalking-v1", "CliffWalkin-v1"), "Gymnasium cannot make 'CliffWalkin-v1'"),
        (changed("is_slippery = true", "slippery = true"), "Gymnasium cannot make"),
        (changed("limit = 200\n", ""), "no limit of steps; give limit="),
        (changed("loss = { reward = -100 }", "loss = { rewrad = -100 }"), "loss: unknown 'rewrad'"),
        (changed("row = 4", "row = 5"), "does not split into row \\(5\\) × col \\(12\\)"),
        (changed("row = 4", "row = 0"), "'row' needs from one to"),
        (changed("row = 4", 'row = "4"'), "expected a number or a list of values for 'row'"),
        (changed('rule = "q-learning"', 'rule = "dqn"'), "expected q-learning, sarsa"),
        (changed("epsilon = 0.1", "epsilom = 0.1"), "learner: unknown field 'epsilom'"),
        (changed("epsilon = 0.1", "epsilon = 7"), "epsilon: expected 0.0 to 1.0"),
        (changed("trials = 300", "trials = 0"), "trials: expected a whole number of at least 1"),
        (changed("trials = 300", ""), "stage 'firm ground': has no budget"),
        (changed("trials = 300", "trials = 300\nmax_losses = 0"), "max_losses: expected a whole number of at least 1"),
        (changed("trials = 300", "trials = 300\nfix = { rwo = 1 }"), "no variable 'rwo'"),
        (changed("trials = 300", "trials = 300\nguard = { share = 2 }"), "guard, share"),
        (changed("trials = 300", "trials = 300\nguard = { shar = 2 }"), "guard: unknown field 'shar'"),
        (changed('"V"', '"V"\ntrials = "5"', "building.toml"), "expected a whole number in the field 'trials'"),
        (changed('operation = "swap"', 'operation = "swop"', "building.toml"), "expected one of swap, forget"),
        (changed('output = "MV"', "", "building.toml"), "prior swap: .*output"),
        (changed("FTR = 4", "FTR = 9", "building.toml"), "stage 'T': .*'FTR' has no value 9"),
        (changed('team = "10+5"', 'team = "lots"', "building.toml"), "expected SCOUTS\\+WEAPONS"),
        (changed('team = "10+5"', 'team = "10+1"', "building.toml"), "no team could ever succeed"),
        (changed("seed = 7", "sed = 7", "building.toml"), "environment, building: .*sed"),
        (changed("[environment]", "[task]\ninputs = {}\n[environment]", "building.toml"), "brings its own; take"),
        (
            changed(
                "building = { intersections = 21, corridors = 25, rooms = 6, seed = 7 }",
                'building = "no.json"',
                "building.toml",
            ),
            "cannot be read",
        ),
    ],
)
def test_mistakes_in_a_spec_are_named_before_anything_is_trained(text: str, message: str, tmp_path: Path) -> None:
    spec = tmp_path / "spec.toml"
    spec.write_text(text)
    with pytest.raises(TaskliftError, match=message) as caught:
        run_spec(spec, tmp_path / "out")
    assert "spec.toml" in str(caught.value)
    assert "\n" not in str(caught.value)
    assert not (tmp_path / "out").exists()


def test_a_specs_curriculum_is_an_arm_for_any_building(tmp_path: Path) -> None:
    mine = arm_of(shortened("drill.toml", tmp_path))
    study = Study.every(generated([7]), {"scattered": Condition()}, ["direct", mine], seeds=2, trials=5)
    cell = study.cell("scattered", "map-7", 1, "own-drill")
    assert cell in study.cells()
    rows = study.work(cell).stages
    assert {stage: len(columns["steps"]) for stage, columns in rows.items()} == {"drill": 30, "target": 30, "greedy": 5}
    # the example's own building is map-7: the same episodes as the spec by itself
    run = curriculum_of(read_spec(tmp_path / "drill.toml")).run(1)
    assert rows["target"]["steps"].tolist() == list(run.outcomes.values())[-1].steps.tolist()
    for stage in ("drill", "target"):
        trace = study.replay(cell, 29, stage)
        assert trace.losses[-1] == rows[stage]["losses"][29]
    again = Study.from_spec(study.spec("a"), tmp_path)  # as `tasklift watch` finds it
    assert again.work(cell).summary == study.work(cell).summary
    # another curriculum under the same name is another experiment
    text = (tmp_path / "drill.toml").read_text()
    (tmp_path / "drill.toml").write_text(text.replace("trials = 30", "trials = 31", 1))
    other = Study.every(study.buildings, study.conditions, ["direct", arm_of(tmp_path / "drill.toml")], seeds=2)
    assert any("own-drill" in line for line in other.spec("a").conflicts(study.spec("a")))
    with pytest.raises(TaskliftError, match="own"):
        Study.every(generated([7]), {"scattered": Condition()}, [arm_of(EXAMPLES / "cliff.toml")])
