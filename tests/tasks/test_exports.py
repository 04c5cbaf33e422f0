"""Policies that leave decide as the original does, in every state: Python, compiled C, ONNX, a ROS 2 package."""

from __future__ import annotations

import csv
import importlib
import json
import shutil
import subprocess
import sys
import xml.etree.ElementTree as xml
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from test_policy import random_policy
from test_task import paper_simple, paper_task, simplified, small_tasks

from tasklift.cli.main import cli
from tasklift.errors import TaskliftError
from tasklift.tasks import exports
from tasklift.tasks.policy import Policy
from tasklift.tasks.task import Task, Variable

PROPERTY = settings(deadline=None, derandomize=True, max_examples=40)
COMPILER = shutil.which("cc")
DRAWS = (0.0, 0.1, 1 / 3, 0.5, 0.77, 1 - 2**-53)


def trained(kind: str = "weight") -> Policy:
    """A policy of the paper's task with ties, rows of zeros and very different weights."""
    rng = np.random.default_rng(4)
    weights = np.round(rng.random((90, 44)) * 4) * 10.0 ** rng.integers(-9, 9, (90, 1))
    weights[7] = 0
    return Policy(paper_task(), weights if kind == "weight" else weights - weights.mean(), kind=kind)


def loaded(source: str) -> dict:
    module: dict = {}
    exec(compile(source, "exported.py", "exec"), module)
    return module


@PROPERTY
@given(st.data())
def test_the_python_file_decides_as_the_policy(data: st.DataObject) -> None:
    policy = random_policy(data.draw(simplified(data.draw(small_tasks()))))
    module = loaded(exports.to_python(policy))
    assert np.array_equal(np.array(module["WEIGHTS"]), policy.weights)
    for row in range(policy.task.shape[0]):
        seen = policy.task.input_values(row)
        assert module["act"](seen) == policy.task.output_values(int(policy.best()[row]))
        for u in DRAWS:
            assert module["act"](seen, u) == policy.task.output_values(policy.select(seen, u=u))


def test_the_python_file_takes_labels_and_refuses_what_is_no_state() -> None:
    module = loaded(exports.to_python(trained()))
    words = {"DL": 2, "GL": 1, "nWPN": "none", "FTR": "door"}
    plain = {"DL": 2, "GL": 1, "nWPN": 0, "FTR": 4}
    assert module["act"](words) == module["act"](plain)
    for wrong, says in ((plain | {"DL": 7}, "DL has no value 7"), ({"DL": 0}, "expected the inputs")):
        with pytest.raises(ValueError, match=says):
            module["act"](wrong)
    with pytest.raises(ValueError, match=r"u in \[0, 1\)"):
        module["act"](plain, 1.0)
    with pytest.raises(ValueError, match="in proportion"):
        loaded(exports.to_python(trained("value")))["act"](plain, 0.5)


C_MAIN = """
#include <stdio.h>
#include <stdlib.h>
#include "{name}.h"
#include "other.h"
int main(void) {{
  double us[] = {{{us}}};
  int out[{upper}_OUTPUTS];
  for (int s = -1; s <= {upper}_STATES; s++) {{
    printf("%d", {name}_best(s));
    {draws}
    if ({name}_valid(s)) for (int a = 0; a < {upper}_ACTIONS; a++) printf(" %a", {name}_weights[s][a]);
    printf("\\n");
  }}
  for (int a = 0; a < {upper}_ACTIONS; a++) {{
    {name}_outputs(a, out);
    for (int k = 0; k < {upper}_OUTPUTS; k++) printf("%d ", out[k]);
    printf("\\n");
  }}
  int seen[4];
  while (scanf("%d %d %d %d", seen, seen + 1, seen + 2, seen + 3) == 4) printf("%d\\n", {name}_state(seen));
  return (int)sizeof(us) * 0 + other_best(0) * 0;
}}
"""


@pytest.mark.skipif(COMPILER is None, reason="no C compiler")
@pytest.mark.parametrize("kind", ["weight", "value"])
def test_compiled_c_has_all_3960_cells_and_decides_as_the_policy(tmp_path: Path, kind: str) -> None:
    policy = trained(kind)
    draws = 'for (int i = 0; i < 6; i++) printf(" %d", my_team_draw(s, us[i]));' if kind == "weight" else ""
    (tmp_path / "my_team.h").write_text(exports.to_c(policy, "my-team"))
    (tmp_path / "other.h").write_text(exports.to_c(random_policy(paper_simple()), "other"))
    us = ", ".join(map(repr, DRAWS))
    (tmp_path / "main.c").write_text(C_MAIN.format(name="my_team", upper="MY_TEAM", us=us, draws=draws))
    strict = ["-std=c99", "-O2", "-Wall", "-Wextra", "-pedantic", "-Werror"]
    subprocess.run([COMPILER, *strict, "main.c", "-o", "main"], cwd=tmp_path, check=True)
    states = policy.task.input_positions(range(90))
    text = "\n".join(" ".join(map(str, row)) for row in [*states.tolist(), [0, 0, 0, 5], [-1, 0, 0, 0]])
    printed = subprocess.run([tmp_path / "main"], input=text, capture_output=True, text=True, check=True).stdout
    lines = [line.split() for line in printed.splitlines()]
    drawn = len(DRAWS) if kind == "weight" else 0
    assert lines[0] == lines[91] == ["-1"] * (1 + drawn)  # no states
    cells = 0
    for row, (best, *rest) in enumerate(lines[1:91]):
        assert int(best) == policy.best()[row]
        assert [int(x) for x in rest[:drawn]] == [policy.select(row, u=u) for u in DRAWS[:drawn]]
        found = [float.fromhex(x) for x in rest[drawn:]]
        assert found == policy.weights[row].tolist()
        cells += len(found)
    assert cells == 3960
    outputs = [list(map(int, line)) for line in lines[92:136]]
    expected = [[v.find(policy.task.output_values(a)[v.name]) for v in policy.task.outputs] for a in range(44)]
    assert outputs == expected
    assert [int(line[0]) for line in lines[136:]] == [*range(90), -1, -1]


ODD = {
    "comment": Task("*/ int", (), (Variable("a */ b\\", ("*/", "/*", "\\", "ü")),)),
    "quotes": Task('"""', (Variable("a 'b'", (0, 1), ('"""', "it's")),), (Variable("b\\n", ("\\", '\\"')),)),
    "words": Task("int", (Variable("class", ("for", "None")), Variable("struct", (1, 2))), (Variable("def", (0, 1)),)),
    "percent": Task("%s", (Variable("100 %d", ("%", "%%")),), (Variable("%(name)s", ("{}", "??/")),)),
    "long": Task("x" * 200, (Variable("1" * 200, ("p" * 200, "日本")),), (Variable("2nd", (0, 1)),)),
    "numbers": Task("n", (Variable("a", (-1e-300, 0.1, 1e300)),), (Variable("b", (False, True)),)),
}


@pytest.mark.skipif(COMPILER is None, reason="no C compiler")
@pytest.mark.parametrize("name", list(ODD))
@pytest.mark.parametrize("compiler", [("cc", "c", "-std=c99"), ("c++", "cpp", "-std=c++11")], ids=["C", "C++"])
def test_odd_names_and_labels_stay_in_their_places(tmp_path: Path, name: str, compiler: tuple[str, str, str]) -> None:
    task = ODD[name]
    policy = Policy(task, np.random.default_rng(1).integers(0, 3, task.shape) * 1e307)
    module = loaded(exports.to_python(policy))
    for row, best in enumerate(policy.best()):
        assert module["act"](task.input_values(row)) == task.output_values(int(best))
    command, suffix, standard = compiler
    if shutil.which(command) is None:
        pytest.skip(f"no {command}")
    body = 'int main(void) { for (int s = 0; s < P_STATES; s++) printf("%d %d\\n", p_best(s), p_draw(s, 0.5)); }'
    (tmp_path / f"p.{suffix}").write_text("#include <stdio.h>\n" + exports.to_c(policy, "p") + body)
    strict = [standard, "-Wall", "-Wextra", "-Wno-unused-function", "-pedantic", "-Werror"]
    subprocess.run([command, *strict, f"p.{suffix}", "-o", "p"], cwd=tmp_path, check=True)
    printed = subprocess.run([tmp_path / "p"], capture_output=True, text=True, check=True).stdout
    expected = [f"{best} {policy.select(row, u=0.5)}" for row, best in enumerate(policy.best())]
    assert printed.splitlines() == expected


@PROPERTY
@given(st.data())
def test_onnx_decides_as_the_policy(data: st.DataObject) -> None:
    onnx = pytest.importorskip("onnx")
    from onnx.reference import ReferenceEvaluator

    policy = random_policy(data.draw(simplified(data.draw(small_tasks()))))
    model = onnx.load_from_string(exports.to_onnx(policy))
    onnx.checker.check_model(model, full_check=True)
    task = policy.task
    states = task.input_positions(range(task.shape[0]))
    asked = states if task.inputs else np.zeros((1, 1), dtype=np.int64)
    weights, action, outputs = ReferenceEvaluator(model).run(None, {"state": asked})
    assert np.array_equal(weights, policy.weights)
    assert np.array_equal(action, policy.best())
    expected = [[v.find(task.output_values(int(a))[v.name]) for v in task.outputs] for a in policy.best()]
    assert outputs.tolist() == expected


def test_the_onnx_runtime_runs_it_too() -> None:
    pytest.importorskip("onnx")
    runtime = pytest.importorskip("onnxruntime")
    policy = trained()
    session = runtime.InferenceSession(exports.to_onnx(policy), providers=["CPUExecutionProvider"])
    weights, action, _ = session.run(None, {"state": policy.task.input_positions(range(90))})
    assert np.array_equal(weights, policy.weights)
    assert np.array_equal(action, policy.best())


def test_the_ros2_package_parses_and_decides_without_ros(tmp_path, monkeypatch) -> None:
    policy = trained()
    for name, text in exports.to_ros2(policy, "team_policy").items():
        path = tmp_path / name
        path.parent.mkdir(exist_ok=True)
        path.write_text(text)
        if name.endswith(".py"):
            compile(text, name, "exec")
    package = xml.parse(tmp_path / "package.xml").getroot()
    assert package.findtext("name") == "team_policy"
    assert package.findtext("export/build_type") == "ament_python"
    assert (tmp_path / "resource" / "team_policy").exists()
    monkeypatch.syspath_prepend(tmp_path)
    node = importlib.import_module("team_policy.node")
    for row in range(90):
        seen = policy.task.input_values(row)
        assert json.loads(node.answer(json.dumps(seen))) == policy.task.output_values(int(policy.best()[row]))
        drawn = policy.task.output_values(policy.select(row, u=0.3))
        assert json.loads(node.answer(json.dumps(seen), 0.3)) == drawn
    for wrong in ("[1]", "{", '{"DL": 0}'):
        with pytest.raises(ValueError, match=r"."):
            node.answer(wrong)
    for module in [name for name in sys.modules if name.startswith("team_policy")]:
        del sys.modules[module]
    with pytest.raises(TaskliftError, match="small letters"):
        exports.to_ros2(policy, "Team-Policy")
    for name in ("class", "json", "random", "rclpy"):
        with pytest.raises(TaskliftError, match=f"'{name}' is a word or a module"):
            exports.to_ros2(policy, name)


def test_large_policies_are_refused_as_source(monkeypatch) -> None:
    monkeypatch.setattr(exports, "LARGEST_SOURCE", 3959)
    for export in (exports.to_python, exports.to_c):
        with pytest.raises(TaskliftError, match="3,960 weights are too many"):
            export(trained())


def export(*arguments: object) -> None:
    cli.main(["policy", "export", *map(str, arguments)], standalone_mode=False)


def test_the_command_writes_every_kind_by_its_name(tmp_path, monkeypatch) -> None:
    pytest.importorskip("onnx")
    monkeypatch.chdir(tmp_path)
    policy = trained()
    policy.save("policy.json")
    for name in ("copy.json", "table.csv", "net.onnx", "policy.py", "policy.h", "team_node"):
        export("policy.json", "-o", name)
        if name == "team_node":  # a package that was stopped half-way is finished; only another one is in the way
            Path(name, "setup.py").unlink()
            export("policy.json", "-o", name)
            Path(name, "setup.py").write_text("mine")
        with pytest.raises(TaskliftError, match="is there already"):
            export("policy.json", "-o", name)
        export("policy.json", "-o", name, "--force")
    assert np.array_equal(Policy.load("copy.json").weights, policy.weights)
    rows = list(csv.DictReader(Path("table.csv").read_text().splitlines()))
    assert [float(row["weight"]) for row in rows] == policy.weights.ravel().tolist()
    assert loaded(Path("policy.py").read_text())["act"]({"DL": 0, "GL": 0, "nWPN": 0, "FTR": 1})
    assert Path("policy.h").read_text() == exports.to_c(policy, "policy")
    assert Path("net.onnx").read_bytes() == exports.to_onnx(policy)
    assert Path("team_node/team_node/policy.py").read_text() == exports.to_python(policy)


@pytest.mark.parametrize(
    ("arguments", "says"),
    [
        (("-o", "policy.txt"), "ends in one of .json, .csv, .onnx, .py, .h"),
        (("-o", "policy.py", "--kind", "c"), "ends in .h, for the kind c"),
        (("-o", "policy.h", "--kind", "ros2"), "has no dot"),
        (("-o", "policy.json"), "is read by this command"),
        (("-o", "Bad-Name"), "small letters"),
        (("-o", "full"), "is not empty"),
    ],
)
def test_the_command_refuses_what_does_not_fit_before_it_writes(tmp_path, monkeypatch, arguments, says) -> None:
    monkeypatch.chdir(tmp_path)
    trained().save("policy.json")
    (tmp_path / "full").mkdir()
    (tmp_path / "full" / "mine.txt").write_text("mine")
    before = sorted(tmp_path.rglob("*"))
    with pytest.raises(TaskliftError, match=says):
        export("policy.json", *arguments, "--force")
    assert sorted(tmp_path.rglob("*")) == before
