"""What a user sees of an object: short text, a picture in a notebook, a table in pandas, names for type checkers."""

from __future__ import annotations

import ast
import os
import re
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

import tasklift as tl
from tasklift.watch import replay

pandas = pytest.importorskip("pandas")
LONG = "name" * 49


@pytest.fixture(scope="module")
def hunt() -> tl.Mission:
    return tl.Mission(tl.generate(seed=7), team="10+5", hostiles=1)


@pytest.fixture(scope="module")
def curve(hunt: tl.Mission) -> tl.Curve:
    return tl.reinforce(hunt, tl.Policy.equal(hunt.task), trials=12)


def everything(hunt: tl.Mission, curve: tl.Curve) -> dict[str, object]:
    wide = tl.Variable(LONG, range(500), labels=[f"{LONG}{i}" for i in range(500)])
    big = tl.Task(LONG, inputs=tuple(tl.Variable(f"v{i}", range(10)) for i in range(60)), outputs=(wide,))
    stages = [tl.Stage(f"{LONG}{i}", hunt.task, hunt, tl.Reinforcement(), trials=2) for i in range(6)]
    trace = hunt.simulator.trace(curve.policy)
    outcomes = hunt.evaluate(np.ones((3, *hunt.task.shape)), 4)
    run = tl.Curriculum(stages[:2]).run(seed=0)
    easy = hunt.task.simplify(fix={"DL": 0, "GL": 0})
    pair = [tl.Stage("V", easy, hunt.without_hostiles(), tl.Sweep(repeats=1)), stages[0]]
    return {
        "variable": wide, "signal": tl.Signal(-0.1, {"MV": 0}, "a stop"), "task": big, "policy": curve.policy,
        "curve": curve, "outcomes": curve.outcomes, "several": outcomes, "trace": trace, "mission": hunt,
        "changed": hunt.with_reading(drill=True, split="team", patience=3, engage="crossing", share_map="radio"),
        "missions": tl.Missions([hunt, hunt]), "reading": tl.COHESIVE, "stage": stages[0], "run": run,
        "curriculum": tl.Curriculum(stages), "building": hunt.building, "replay": replay([("a", trace)], LONG),
        "comparison": tl.compare(tl.Curriculum(pair), seeds=2), "search": tl.PolicySearch(),
        "guard": tl.Guard("losses"), "reinforcement": tl.Reinforcement(), "sweep": tl.Sweep(),
        "values": tl.ValueLearning(), "kind": tl.SCOUT,
        "budget": tl.Run(trials=4), "prior": tl.swap("MV", when={"FTR": "door"}),
    }  # fmt: skip


def test_every_repr_is_one_line_of_at_most_200_characters(hunt: tl.Mission, curve: tl.Curve) -> None:
    for name, thing in everything(hunt, curve).items():
        assert len(repr(thing)) <= 200, f"{name}: {len(repr(thing))} characters: {thing!r}"
        assert "\n" not in repr(thing), name


def test_notebooks_show_pictures_and_tables(hunt: tl.Mission, curve: tl.Curve) -> None:
    trace = hunt.simulator.trace(curve.policy)
    shown = {
        "<svg": (hunt.building, curve, curve.outcomes),
        "<table": (hunt.task, curve.policy),
        "<iframe": (replay([("one", trace)], "a replay"),),
    }
    for begins, things in shown.items():
        for thing in things:
            assert begins in thing._repr_html_()


def test_names_in_a_notebook_are_text() -> None:
    evil = tl.Task("<script>", inputs=(), outputs=(tl.Variable("<b>", ("<i>", "x")),))
    for thing in (evil, tl.Policy.equal(evil)):
        assert "<script>" not in thing._repr_html_()
        assert "<b>" not in thing._repr_html_()


def test_outcomes_become_a_table(curve: tl.Curve) -> None:
    table = curve.to_pandas()
    assert table.index.tolist() == list(range(1, 13))
    assert {"steps", "success", "losses", "robots_left_0", "robots_left_1"} <= set(table.columns)
    assert table["losses"].sum() == curve.outcomes.losses.sum()
    assert (table["robots_left_0"] + table["robots_left_1"] + table["losses"] == 15).all()


def test_several_runs_are_asked_for_one_by_one(hunt: tl.Mission) -> None:
    several = hunt.evaluate(np.ones((2, *hunt.task.shape)), 3)
    with pytest.raises(tl.TaskliftError, match="of_run"):
        several.to_pandas()
    assert len(several.of_run(1).to_pandas()) == 3


def test_a_plot_is_a_running_mean(curve: tl.Curve) -> None:
    (line,) = curve.plot("steps", smooth=4).get_lines()
    assert line.get_xdata().tolist() == list(range(4, 13))
    assert np.allclose(line.get_ydata()[0], curve.outcomes.steps[:4].mean())
    with pytest.raises(tl.TaskliftError, match="expected one of"):
        curve.plot("stepz")
    with pytest.raises(tl.TaskliftError, match="smooth"):
        curve.plot(smooth=0)


def test_the_best_action_is_in_words(hunt: tl.Mission) -> None:
    weights = np.ones(hunt.task.shape)
    at_door = {"DL": "none", "GL": "unknown", "nWPN": "none", "FTR": "door"}
    weights[hunt.task.input_index(at_door), hunt.task.output_index({"MV": 0, "WPN": 0, "CA": 0.2})] = 9
    assert tl.Policy(hunt.task, weights).best_action(at_door) == {"MV": "stop", "WPN": "deny", "CA": "0.2"}
    with pytest.raises(tl.TaskliftError, match="no value 'window'"):
        tl.Policy(hunt.task, weights).best_action({**at_door, "FTR": "window"})


def test_a_comparison_becomes_a_table(hunt: tl.Mission, curve: tl.Curve) -> None:
    comparison = everything(hunt, curve)["comparison"]
    table = comparison.to_pandas()
    assert len(table) == len(comparison.findings)
    assert {"low", "high", "p", "verdict"} <= set(table.columns)


def test_type_checkers_are_shown_the_names_that_are_found_on_first_use() -> None:
    stub = ast.parse(Path(tl.__file__).with_suffix(".pyi").read_text())
    imports = {n.asname: node.module for node in stub.body if isinstance(node, ast.ImportFrom) for n in node.names}
    assert imports == {name: f"tasklift.{home}" for name, home in tl._HOME_OF.items()}
    for name in tl.__all__:
        getattr(tl, name)
    assert dir(tl) == sorted(tl.__all__)


def test_a_users_mypy_sees_our_types(tmp_path: Path) -> None:
    script = tmp_path / "user.py"
    script.write_text(
        "import tasklift as tl\nreveal_type(tl.Mission(tl.generate(seed=7), '10+5').n_robots)\ntl.Policy(1, 2)\n"
    )
    package = Path(tl.__file__).parent
    assert (package / "py.typed").exists()
    command = [sys.executable, "-m", "mypy", "--no-error-summary", "--config-file=", str(script)]
    beside = {**os.environ, "MYPYPATH": str(package.parent)}
    done = subprocess.run(command, capture_output=True, text=True, cwd=tmp_path, env=beside, check=False)
    assert re.search(r'Revealed type is "(builtins\.)?int"', done.stdout), done.stdout
    assert 'incompatible type "int"; expected "Task"' in done.stdout


def test_python_m_tasklift_is_the_command_line() -> None:
    done = subprocess.run([sys.executable, "-m", "tasklift", "--version"], capture_output=True, text=True, check=True)
    assert tl.__version__ in done.stdout
