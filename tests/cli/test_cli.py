"""The command line: what it makes, and one clear line with exit code 2 for every mistake."""

from __future__ import annotations

import json
import os
import re
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest

from tasklift.building.generate import generate
from tasklift.building.search import search_and_clear
from tasklift.cli import main as cli
from tasklift.lab import FILE_NAME
from tasklift.tasks.policy import Policy


@pytest.fixture
def tasklift(monkeypatch, capsys, tmp_path):
    """Run the command in an empty folder; return (exit code, standard output, standard error)."""
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("COLUMNS", "200")

    def run(*arguments):
        monkeypatch.setattr(sys, "argv", ["tasklift", *map(str, arguments)])
        code = 0
        try:
            cli.main()
        except SystemExit as stop:
            code = stop.code
        out = capsys.readouterr()
        return code, out.out, out.err

    return run


@pytest.fixture
def building(tmp_path):
    path = tmp_path / "house.json"
    generate(intersections=5, corridors=5, rooms=2, features=5, seed=1).save(path)
    return path


SMALL = ("--seeds", 1, "--trials", 3)


def test_help_names_every_command(tasklift):
    code, out, _ = tasklift("--help")
    assert code == 0
    for name in ("reproduce", "train", "map", "policy", "runs", "watch"):
        assert name in out


def test_help_loads_nothing_heavy():
    script = (
        "import sys; sys.argv = ['tasklift', '--help']\n"
        "from tasklift.cli import main as cli\n"
        "try: cli.main()\n"
        "except SystemExit: pass\n"
        "heavy = {'numba', 'scipy', 'matplotlib', 'shapely', 'numpy'} & set(sys.modules)\n"
        "assert not heavy, heavy"
    )
    subprocess.run([sys.executable, "-c", script], check=True, capture_output=True)


def test_train_leaves_policies_rows_and_a_report(tasklift, building):
    quick = ("train", building, *SMALL, "--practice", 2000, "--out", "run")
    code, out, _ = tasklift(*quick)
    assert code == 0
    assert out.startswith("ready: policy.json solves ")
    assert {p.name for p in Path("run").iterdir()} >= {"policy.json", "policies", "rows.csv", "report.html", FILE_NAME}
    assert Policy.load("run/policy.json", search_and_clear()).weights.shape == (90, 44)
    first = Path("run/policy.json").read_bytes()
    code, _, _ = tasklift(*quick)  # resumes: everything is there
    assert code == 0
    assert Path("run/policy.json").read_bytes() == first
    code, out, _ = tasklift("policy", "show", "run/policy.json")
    assert code == 0
    assert "12 states occur in 20" in out
    assert "danger level" in out
    assert "suspected" in out or "unknown" in out
    code, out, _ = tasklift("policy", "show", "run/policy.json", "--json", "--top", 2)
    states = json.loads(out)
    assert code == 0
    assert 1 < len(states) < 90
    assert {tuple(state["state"]) for state in states} == {("DL", "GL", "nWPN", "FTR")}
    assert all(1 >= sum(action["probability"] for action in state["actions"]) > 0 for state in states)
    code, out, _ = tasklift("policy", "show", "run/policy.json", "--json", "--all")
    assert len(json.loads(out)) == 90
    code, _, _ = tasklift("policy", "export", "run/policy.json", "-o", "table.csv")
    assert code == 0
    assert len(Path("table.csv").read_text().splitlines()) == 1 + 90 * 44
    code, out, _ = tasklift("runs", "show", "run")
    assert code == 0
    assert "copy-prior" in out
    code, out, _ = tasklift("runs", "list", ".")
    assert code == 0
    assert "training on" in out
    code, out, _ = tasklift("runs", "compare", "run", "--between", "arm=copy,direct")
    assert code == 0
    assert "losses" in out
    code, out, _ = tasklift("runs", "export", "run", "-o", "rows.parquet")
    assert code == 0
    assert Path("rows.parquet").stat().st_size > 0


def broken(text):
    def make(path):
        path.write_text(text(path.read_text()))

    return make


def edited(change):
    def edit(text):
        document = json.loads(text)
        change(document)
        return json.dumps(document)

    return broken(edit)


@pytest.mark.parametrize(
    ("damage", "says"),
    [
        (lambda path: path.unlink(), "cannot be read"),
        (broken(lambda text: text[: len(text) // 2]), "not valid JSON"),
        (edited(lambda d: d.update(colour="red")), "colour"),
        (edited(lambda d: d["nodes"][0].update(colour="red")), "colour"),
        (edited(lambda d: d["edges"][0].update(b=99)), "99"),
        (edited(lambda d: d.update(edges=d["edges"][1:2])), "reach"),
        (edited(lambda d: d["edges"][0].update(length_m=-1)), "length_m"),
        (edited(lambda d: d.update(version=99)), "newer"),
        (edited(lambda d: d.update(format="tasklift-policy")), "tasklift-building"),
    ],
)
def test_damaged_buildings_are_refused_in_one_line(tasklift, building, damage, says):
    damage(building)
    code, out, err = tasklift("train", building, *SMALL, "--out", "run")
    assert (code, out) == (2, "")
    assert says in err
    assert err.count("\n") == 1
    assert "Traceback" not in err
    assert not Path("run").exists()


@pytest.mark.parametrize(
    ("options", "says"),
    [
        (("--hostiles", 9), "not next to the start"),
        (("--weapons-needed", 6), "needs 6 weapon robots, the team has 5"),
        (("--team", "0+0", "--hostiles", 0), "number of robots: expected a whole number from 1"),
        (("--team", "ten"), "10+5"),
        (("--trials", 0), "--trials"),
        (("--limit", -1), "--limit"),
        (("--engine", "abacus"), "--engine"),
    ],
)
def test_impossible_requests_are_refused(tasklift, building, options, says):
    code, _, err = tasklift("train", building, *SMALL, *options, "--out", "run")
    assert code == 2
    assert says in err
    assert not Path("run").exists()


#: Numbers that may be of any size: a seed is only a name, and who asks for all outputs gets all there are.
ANY_SIZE = {"seed", "design", "top"}


def commands(group=cli.cli, names=()):
    """Every command with its words."""
    for name in group.list_commands(None):
        found = group.get_command(None, name)
        yield from commands(found, (*names, name)) if hasattr(found, "commands") else [((*names, name), found)]


def number_options():
    for words, command in commands():
        for option in command.params:
            kind = type(option.type).__name__
            if kind in ("IntRange", "Int", "IntParamType", "Numbers") and option.name not in ANY_SIZE:
                yield pytest.param(words, option.opts[0], id=" ".join([*words, option.opts[0]]))


@pytest.mark.parametrize(("words", "option"), list(number_options()))
@pytest.mark.parametrize("number", [10**11, pytest.param(10**30, marks=pytest.mark.slow)])
def test_numbers_too_large_for_the_machine_are_refused_at_once(tasklift, building, words, option, number):
    arguments = {"train": [building], "team": [building], "watch": [building, "--html", "o.html"]}.get(words[0], [])
    if words[0] == "certify":
        Policy.equal(search_and_clear()).save("policy.json")
        arguments = ["policy.json", "--building", building]
    if words == ("map", "generate"):
        arguments = ["-o", "o.json"]
    if words[0] == "learn":
        Path("s.toml").write_text((Path(__file__).parents[2] / "examples" / "building.toml").read_text())
        arguments = ["s.toml", "--out", "run"]
    before = set(Path().iterdir())
    code, _, err = tasklift(*words, *arguments, option, number)
    assert (code, err.count("\n")) == (2, 1), err
    assert set(Path().iterdir()) == before


def test_what_is_in_the_way_of_figures_is_found_before_the_work(tasklift, building):
    for name in ("figures", "policies"):
        Path("run").mkdir(exist_ok=True)
        (Path("run") / FILE_NAME).touch()
        (Path("run") / name).write_text("mine")
        code, _, err = tasklift("train", building, *SMALL, "--out", "run")
        assert (code, err.count("\n")) == (2, 1), err
        assert name in err
        assert (Path("run") / name).read_text() == "mine"
        (Path("run") / name).unlink()


@pytest.mark.skipif(not Path("/dev/full").exists(), reason="needs /dev/full")
@pytest.mark.parametrize("words", [["--help"], ["map", "check", "house.json"], ["runs", "list", "."]])
def test_an_output_that_takes_nothing_ends_in_one_line(building, words):
    """A full disk is said; a reader that went away is not; with standard output closed, there is nothing to say."""
    command, where = [sys.executable, "-m", "tasklift", *words], building.parent
    with open("/dev/full", "w") as full:
        done = subprocess.run(command, cwd=where, stdout=full, stderr=subprocess.PIPE, text=True)
        assert (done.returncode, done.stderr) == (2, "tasklift: the output: No space left on device\n")
        assert subprocess.run(command, cwd=where, stdout=full, stderr=full).returncode == 2
    reads, writes = os.pipe()
    os.close(reads)
    done = subprocess.run(command, cwd=where, stdout=writes, stderr=subprocess.PIPE, text=True)
    os.close(writes)
    assert (done.returncode, done.stderr) == (1, "")
    closed = subprocess.run(["sh", "-c", 'exec "$@" >&-', "sh", *command], cwd=where, stderr=subprocess.PIPE, text=True)
    assert (closed.returncode, closed.stderr) == (0, "")


def test_a_folder_with_anything_else_is_left_alone(tasklift, building):
    Path("thesis").mkdir()
    Path("thesis/chapter1.txt").write_text("precious")
    code, _, err = tasklift("train", building, *SMALL, "--out", "thesis")
    assert code == 2
    assert "holds no experiment" in err
    assert [p.name for p in Path("thesis").iterdir()] == ["chapter1.txt"]


def test_a_folder_with_another_experiment_is_left_alone(tasklift, building):
    assert tasklift("train", building, *SMALL, "--out", "run")[0] == 0
    before = {p: p.stat().st_mtime_ns for p in Path("run").rglob("*")}
    code, _, err = tasklift("train", building, "--seeds", 1, "--trials", 4, "--out", "run")
    assert code == 2
    assert "trials" in err
    assert {p: p.stat().st_mtime_ns for p in Path("run").rglob("*")} == before


def test_a_finished_experiment_takes_more_seeds(tasklift, building):
    assert tasklift("train", building, *SMALL, "--out", "run")[0] == 0
    assert tasklift("train", building, "--seeds", 2, "--trials", 3, "--out", "run")[0] == 0
    code, out, _ = tasklift("runs", "list", ".")
    assert code == 0
    assert "10 of 10" in out  # 5 arms × 2 seeds


def test_training_takes_any_arms_and_refuses_unknown_ones(tasklift, building):
    asked = ("train", building, *SMALL, "--team", "2+2", "--limit", 40, "--out", "run")
    code, out, _ = tasklift(*asked, "--arms", "direct-400-q90, every-door-300-q90")
    assert code == 0
    assert "none is ready: the best policy (" in out
    assert "400 trials, q = .9" in out
    assert "every-door drill 300, q = .9" in out
    command = (
        f"tasklift train {building} --team 2+2 --hostiles 1 --limit 40 --preset scattered "
        "--arms direct-400-q90,every-door-300-q90 --seeds 1 --trials 3 --practice 36000 --ready 0.95 --out run"
    )
    assert command in Path("run/report.html").read_text()
    for arms, says in (("direct,evry-door-300-q90", "every-door-300-q90"), ("random", "learns"), ("a,,b", "commas")):
        code, _, err = tasklift("train", building, "--arms", arms, "--out", "other")
        assert code == 2
        assert says in err
        assert err.count("\n") == 1
    assert not Path("other").exists()


def test_training_takes_a_curriculum_from_a_spec(tasklift, building):
    Path("my plan.toml").write_text(
        'name = "my own way"\nenvironment = {}\n[learner]\nrule = "reinforcement"\n'
        '[[stages]]\nname = "calm"\noptions = { hostiles = 0 }\ntrials = 4\n[[stages]]\nname = "all"\ntrials = 5\n'
    )
    asked = ("train", building, "--team", "2+2", "--limit", 60, "--seeds", 1, "--arms", "direct", "--trials", 4)
    code, out, err = tasklift(*asked, "--curriculum", "my plan.toml", "--out", "run")
    assert code == 0, err
    page = Path("run/report.html").read_text()
    assert "my own way" in page
    assert "--curriculum &#x27;my plan.toml&#x27; --seeds 1" in page
    code, out, _ = tasklift("runs", "show", "run")
    assert "own-my-plan" in out
    Path("my plan.toml").write_text(Path("my plan.toml").read_text().replace("trials = 5", "trials = 6"))
    code, _, err = tasklift(*asked, "--curriculum", "my plan.toml", "--out", "run")
    assert (code, err.count("\n")) == (2, 1)
    assert "own-my-plan" in err


def test_unknown_files_and_policies_are_refused(tasklift, tmp_path):
    for arguments, says in [
        (("train", "plan.dwg"), "cannot be read"),
        (("policy", "show", "nothing.json"), "cannot be read"),
        (("policy", "export", "nothing.json", "-o", "x.csv"), "cannot be read"),
        (("runs", "show", "nowhere"), "nowhere"),
        (("frobnicate",), "frobnicate"),
    ]:
        code, _, err = tasklift(*arguments)
        assert code == 2, arguments
        assert says in err
        assert "Traceback" not in err


def test_ctrl_c_ends_in_one_line_and_the_same_command_resumes(tmp_path):
    house = tmp_path / "house.json"
    generate(seed=1).save(house)
    command = [Path(sys.executable).with_name("tasklift"), "train", house, "--seeds", "40", "--out", tmp_path / "run"]
    process = subprocess.Popen(command, stderr=subprocess.PIPE, stdout=subprocess.PIPE, text=True)
    store = tmp_path / "run" / FILE_NAME
    deadline = time.monotonic() + 120
    while not (store.exists() and store.stat().st_size > 60_000) and time.monotonic() < deadline:
        time.sleep(0.05)
    os.kill(process.pid, signal.SIGINT)
    _, err = process.communicate(timeout=60)
    assert process.returncode == 130
    assert "the same command goes on from there" in err
    assert "Traceback" not in err


@pytest.mark.parametrize(
    ("module", "lost"), [("click", False), ("tasklift.plans.read", False), ("tasklift.plans.read", True)]
)
def test_ctrl_c_during_an_import_ends_in_one_line(module, lost):
    """While the command line is imported, while a command imports what it needs, and where Python loses exceptions."""
    meddler = f"""
import signal, sys
class Lost:
    def __del__(self): signal.raise_signal(signal.SIGINT)
class Finder:
    def find_spec(self, name, path=None, target=None):
        if name == {module!r}:
            {"Lost()" if lost else "signal.raise_signal(signal.SIGINT)"}
sys.meta_path.insert(0, Finder())
sys.argv = ["tasklift", "map", "formats"]
from tasklift.__main__ import main
main()
"""
    done = subprocess.run([sys.executable, "-c", meddler], capture_output=True, text=True, timeout=120)
    assert (done.returncode, done.stdout) == (130, "")
    assert re.fullmatch(r"\n?tasklift: stopped[^\n]*\n", done.stderr)


def test_options_come_from_a_file_and_the_command_line_goes_before_it(tasklift, building):
    Path("mine.toml").write_text('seeds = 1\ntrials = 3\narms = ["direct", "copy"]\nout = "filed"\n')
    code, _, err = tasklift("train", building, "--config", "mine.toml", "--practice", 500, "--quiet", "--trials", 2)
    assert (code, err) == (0, "")
    rows = Path("filed/rows.csv").read_text().splitlines()
    assert {line.split(",")[5] for line in rows[1:]} == {"direct", "copy"}
    assert max(int(line.split(",")[7]) for line in rows[1:] if ",target," in line) == 2
    for text, says in (
        ("seed = 3\n", "unknown option 'seed'"),
        ("seeds = {a = 1}\n", "expected a value or a list"),
        ("seeds = 0\n", "mine.toml, seeds: 0 is not in the range"),
        ("arms = true\n", "arm 'True' is unknown"),
        ("json = 3\n", "mine.toml, json: "),
        ("seeds = ", "mine.toml"),
    ):
        Path("mine.toml").write_text(text)
        code, _, err = tasklift("train", building, "--config", "mine.toml")
        assert code == 2
        assert says in err
        assert len(err.splitlines()) == 1


def test_scripts_get_json(tasklift, building):
    code, out, err = tasklift("train", building, *SMALL, "--practice", 2000, "--out", "run", "--json")
    found = json.loads(out)
    assert (code, err) == (0, "")
    assert set(found) == {"policy", "certificate", "says", "report"}
    assert Path(found["report"]).exists()
    code, out, _ = tasklift("runs", "list", "--json")
    (table,) = json.loads(out)
    assert table["rows"]
    code, out, _ = tasklift("runs", "compare", "run", "--between", "arm=copy,direct", "--json")
    assert code == 0
    assert any("verdict" in row for table in json.loads(out) for row in table["rows"])


@pytest.mark.parametrize(
    ("words", "says"),
    [
        (["tarin", "x"], "unknown command 'tarin'; did you mean 'train'?"),
        (["map", "imprt"], "unknown command 'imprt'; did you mean 'import'?"),
        (["runs", "42"], "unknown command '42'; expected one of compare, export, list, show"),
        (["--versio"], "No such option '--versio'"),
    ],
)
def test_an_unknown_command_names_what_may_be_meant(tasklift, words, says):
    code, _, err = tasklift(*words)
    assert code == 2
    assert says in err
    assert len(err.splitlines()) == 1


def test_a_piped_table_keeps_its_words(tasklift, building, monkeypatch):
    monkeypatch.delenv("COLUMNS", raising=False)
    tasklift("train", building, *SMALL, "--practice", 500, "--arms", "direct,copy", "--out", "run")
    _, out, _ = tasklift("runs", "compare", "run", "--between", "arm=copy,direct")
    assert "greedy_losses" in out
    assert "too few seeds (1 of at least 9)" in out


@pytest.mark.parametrize("command", ["compare run --between arm=copy,direct", "show run"])
def test_names_are_not_cut_at_80_columns(tasklift, building, command, monkeypatch):
    tasklift("train", building, *SMALL, "--practice", 500, "--arms", "direct,copy", "--out", "run")
    monkeypatch.setenv("COLUMNS", "80")
    code, out, _ = tasklift("runs", *command.split())
    assert code == 0
    assert "…" not in out
    assert max(map(len, out.splitlines())) <= 80
