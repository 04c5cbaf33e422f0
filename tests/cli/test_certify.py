"""``tasklift certify``: one line, a file, and one clear line for every mistake."""

from __future__ import annotations

import json
import sys

import pytest

from tasklift.building import Mission, generate
from tasklift.cli import main as cli
from tasklift.tasks.policy import Policy
from tasklift.tasks.task import Task
from tasklift.tasks.variable import Variable


@pytest.fixture
def tasklift(monkeypatch, capsys, tmp_path):
    """Run the command in a folder with a policy and a building; return (exit code, standard output, standard error)."""
    monkeypatch.chdir(tmp_path)
    place = generate(5, 5, 2, 5, seed=1)
    place.save("building.json")
    Policy.equal(Mission(place, "2+3").task).save("policy.json")
    (tmp_path / "alone").mkdir()
    Policy.equal(Mission(place, "2+3").task).save("alone/policy.json")
    generate(5, 5, 2, 0, seed=1).save("bare.json")
    Policy.equal(Task("other", (Variable("A", (0, 1)),), (Variable("B", (0, 1)),))).save("other.json")

    def run(*arguments):
        monkeypatch.setattr(sys, "argv", ["tasklift", "certify", *map(str, arguments)])
        code = 0
        try:
            cli.main()
        except SystemExit as stop:
            code = stop.code
        out = capsys.readouterr()
        return code, out.out, out.err

    return run


def test_certifies_and_verifies(tasklift):
    code, out, err = tasklift("policy.json", "--team", "2+3", "--episodes", 300)
    assert (code, err) == (0, "")
    says, written = out.splitlines()
    assert says.startswith("99 % sure: ")
    assert written == "certificate: policy-certificate.json"
    with open("policy-certificate.json", encoding="utf-8") as file:
        assert json.load(file)["says"] == says
    code, out, err = tasklift("--verify", "policy-certificate.json")
    assert (code, out) == (0, f"holds: {says}\n")


def test_certifies_on_fresh_buildings(tasklift):
    code, out, _ = tasklift("policy.json", "--buildings", "6-7-2", "--team", "2+3", "--episodes", 5, "-o", "c.json")
    assert code == 0
    assert "episodes on fresh buildings" in out


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ([], "expected a policy"),
        (["policy.json", "--team", "2+1"], "no team could ever succeed"),
        (["other.json", "--team", "2+3"], "neither equal to nor a simplification of"),
        (["policy.json", "--building", "bare.json", "--team", "2+3"], "has 0 place(s) for them"),
        (["policy.json", "--team", "2+3", "--confidence", "1"], "above 0 and below 1"),
        (["policy.json", "--team", "2+3", "--confidence", "-0.5"], "above 0 and below 1"),
        (["policy.json", "--team", "2+3", "--episodes", "0"], "whole number from 1"),
        (["policy.json", "--team", "2+3", "--hostiles", "40"], "asked for 40"),
        (["policy.json", "--team", "2+3", "--hostiles", "3-1"], "such as 1-5"),
        (["policy.json", "--building", "b.json"], "b.json: cannot be read"),
        (["missing.json"], "missing.json: cannot be read"),
        (["alone/policy.json"], "alone/building.json: is not there; name the building with --building"),
        (["policy.json", "--buildings", "6-7"], "such as 21-25-6"),
        (["building.json"], "tasklift-policy"),
        (["--verify", "policy.json"], "tasklift-certificate"),
    ],
)
def test_a_mistake_is_one_line_and_exit_code_2(tasklift, tmp_path, arguments, message):
    before = sorted(tmp_path.iterdir())
    code, out, err = tasklift(*arguments)
    assert (code, out) == (2, "")
    assert message in err
    assert err.count("\n") == 1
    assert sorted(tmp_path.iterdir()) == before
