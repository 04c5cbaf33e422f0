"""Policies: exact extension, priors, choices that follow the weights, files that survive or are refused."""

from __future__ import annotations

import json
import math
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from scipy import stats
from test_task import paper_simple, paper_task, simplified, small_tasks

from tasklift.errors import TaskliftError
from tasklift.files import canonical_json
from tasklift.tasks import policy as module
from tasklift.tasks.policy import Policy, forget, invert, scale, set_weight, swap
from tasklift.tasks.task import Task, Variable

PROPERTY = settings(deadline=None, derandomize=True, max_examples=60)
FILES = settings(
    deadline=None,
    derandomize=True,
    max_examples=150,
    suppress_health_check=[HealthCheck.function_scoped_fixture],
)


def random_policy(task: Task, seed: int = 0, **rest) -> Policy:
    return Policy(task, np.random.default_rng(seed).random(task.shape) * 3, **rest)


# -- extending -----------------------------------------------------------------------------------------------


@PROPERTY
@given(st.data())
def test_extending_is_the_identity_on_what_was_kept(data: st.DataObject) -> None:
    task = data.draw(small_tasks())
    simple = data.draw(simplified(task))
    policy = random_policy(
        simple, carried={"visits": np.arange(math.prod(simple.shape)).reshape(simple.shape)}
    )
    wide = policy.extend(task)
    inside = simple.input_map >= 0
    kept = np.ix_(inside, simple.output_map)
    assert np.array_equal(wide.weights[kept], policy.weights[simple.input_map[inside]])
    assert np.array_equal(wide.carried["visits"][kept], policy.carried["visits"][simple.input_map[inside]])


@PROPERTY
@given(st.data())
def test_what_is_put_back_is_copied_or_averaged(data: st.DataObject) -> None:
    task = data.draw(small_tasks())
    simple = data.draw(simplified(task))
    policy = random_policy(simple)
    wide = policy.extend(task)
    names = {v.name: v for v in simple.variables}
    for s in range(task.shape[0]):
        for a in range(task.shape[1]):
            point = task.input_values(s) | task.output_values(a)
            mask = np.ones(simple.shape, dtype=bool)
            for name, variable in names.items():
                group = next((g for g in simple.merged.get(name, ()) if point[name] in g), (point[name],))
                if group[0] in variable.values:
                    mask &= simple.where({name: group[0]})
            assert wide.weights[s, a] == pytest.approx(policy.weights[mask].mean(), rel=1e-12)


@PROPERTY
@given(st.data())
def test_extending_step_by_step_is_extending_at_once(data: st.DataObject) -> None:
    task = data.draw(small_tasks())
    # the mean over values that a restriction kept counts a merged group once: in steps, it may count there as many
    middle = data.draw(simplified(task, merging=False))
    policy = random_policy(data.draw(simplified(middle, merging=False)))
    assert np.allclose(policy.extend(middle).extend(task).weights, policy.extend(task).weights, rtol=1e-12)


def test_the_papers_extension_copies_over_danger_and_goal() -> None:
    task, simple = paper_task(), paper_simple()
    v = random_policy(simple)
    t = v.extend(task)
    assert t.weights.shape == (90, 44)
    for level in range(6):
        assert np.array_equal(t.weights[15 * level : 15 * (level + 1)], v.weights)
    assert t.provenance["extended_from"] == "V"
    # a task that merely looks the same will do, as one read from a file does
    assert np.array_equal(v.extend(Task("other", task.inputs, task.outputs)).weights, t.weights)


# -- priors --------------------------------------------------------------------------------------------------


def test_swap_exchanges_two_values_and_twice_is_nothing() -> None:
    task = paper_task()
    t = random_policy(task)
    where = {"FTR": 4, "nWPN": [0, 1]}
    once = t.extend(task, [swap("MV", when=where)])
    for s in range(90):
        state = task.input_values(s)
        stop, move = t.weights[s, :22], t.weights[s, 22:]
        chosen = state["FTR"] == 4 and state["nWPN"] < 2
        expected = np.concatenate([move, stop] if chosen else [stop, move])
        assert np.array_equal(once.weights[s], expected)
    assert np.array_equal(once.extend(task, [swap("MV", when=where)]).weights, t.weights)


def test_swap_of_two_of_several_values_in_some_columns() -> None:
    task = paper_task()
    t = random_policy(task)
    changed = t.extend(task, [swap("CA", values=(0.0, 1.0), when={"MV": 1, "DL": 2})]).weights
    s = task.input_index({"DL": 2, "GL": 0, "nWPN": 1, "FTR": 3})

    def column(mv: int, wpn: int, ca: float) -> int:
        return task.output_index({"MV": mv, "WPN": wpn, "CA": ca})

    for wpn in (0, 1):
        assert changed[s, column(1, wpn, 0.0)] == t.weights[s, column(1, wpn, 1.0)]
        assert changed[s, column(1, wpn, 1.0)] == t.weights[s, column(1, wpn, 0.0)]
        assert changed[s, column(0, wpn, 0.0)] == t.weights[s, column(0, wpn, 0.0)]
        assert changed[s, column(1, wpn, 0.5)] == t.weights[s, column(1, wpn, 0.5)]
    assert (changed != t.weights).sum() == 30 * 4


@PROPERTY
@given(st.data())
def test_invert_reflects_each_row_and_twice_is_nothing(data: st.DataObject) -> None:
    task = data.draw(small_tasks())
    t = random_policy(task, data.draw(st.integers(0, 99)))
    where = {"i0": 0, "o0": [v for v in task.outputs[0].values if v != "v2"]}
    once = t.extend(task, [invert(where)])
    chosen = task.where(where)
    assert np.array_equal(once.weights[~chosen], t.weights[~chosen])
    for row, old, mask in zip(once.weights, t.weights, chosen, strict=True):
        if mask.any():
            assert np.array_equal(np.argsort(-row[mask]), np.argsort(old[mask]))
            assert row[mask].min() == pytest.approx(old[mask].min())
            assert row[mask].max() == pytest.approx(old[mask].max())
    assert np.allclose(once.extend(task, [invert(where)]).weights, t.weights)


@PROPERTY
@given(st.data())
def test_forget_spreads_one_output_and_keeps_the_others(data: st.DataObject) -> None:
    task = data.draw(small_tasks())
    t = random_policy(task, data.draw(st.integers(0, 99)))
    forgotten = data.draw(st.sampled_from(task.outputs))
    axis = 1 + task.outputs.index(forgotten)
    once = t.extend(task, [forget(forgotten.name)])
    shape = (task.shape[0], *map(len, task.outputs))
    before, after = t.weights.reshape(shape), once.weights.reshape(shape)
    assert np.all(np.ptp(after, axis=axis) == 0)
    assert np.allclose(after.sum(axis=axis), before.sum(axis=axis))
    where = {"i0": 0}
    partly = t.extend(task, [forget(forgotten.name, where)])
    chosen = task.where(where)
    assert np.array_equal(partly.weights, np.where(chosen, once.weights, t.weights))


def test_scale_and_set_act_in_order_and_are_told() -> None:
    task = paper_task()
    t = Policy.equal(task, 2.0)
    wide = t.extend(task, [scale(0.5, {"DL": 1}), set_weight(3, {"MV": 0}), scale(2, {"DL": 1, "MV": 0})])
    assert np.unique(wide.weights[task.where({"DL": 1, "MV": 1})]).tolist() == [1.0]
    assert np.unique(wide.weights[task.where({"DL": 1, "MV": 0})]).tolist() == [6.0]
    assert np.unique(wide.weights[task.where({"DL": 0, "MV": 0})]).tolist() == [3.0]
    assert [step["operation"] for step in wide.provenance["prior"]] == ["scale", "set_weight", "scale"]
    canonical_json(wide.provenance)


# -- choosing ------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(("rule", "q"), [("exploration", 0.3), ("pseudo-random", 0.6), ("exploitation", 0.3)])
def test_choices_follow_the_probabilities(rule: str, q: float) -> None:
    task = Task("t", (Variable("x", (0,)),), (Variable("y", range(5)),))
    policy = Policy(task, np.array([[1.0, 3.0, 0.0, 3.0, 1.5]]))
    rng = np.random.default_rng(5)
    counts = np.bincount([policy.select(0, rule, q=q, rng=rng) for _ in range(8000)], minlength=5)
    chances = policy.probabilities({"x": 0}, rule, q)
    assert chances.sum() == pytest.approx(1)
    assert (counts[chances == 0] == 0).all()
    assert stats.chisquare(counts[chances > 0], 8000 * chances[chances > 0]).pvalue > 1e-3


def test_choices_can_be_repeated() -> None:
    policy = random_policy(paper_task())
    one, two = np.random.default_rng(3), np.random.default_rng(3)
    assert [policy.select(s, rng=one) for s in range(90)] == [policy.select(s, rng=two) for s in range(90)]
    assert policy.select(7, "pseudo-random", q=0.5, coin=0.4, u=0.1) == policy.best()[7]


def test_weights_cannot_be_changed_from_outside() -> None:
    given = np.ones(paper_task().shape)
    policy = Policy(paper_task(), given)
    given[0, 0] = 7
    assert policy.weights[0, 0] == 1
    with pytest.raises(ValueError, match="read-only"):
        policy.weights[0, 0] = 2


def with_entry(value: float) -> np.ndarray:
    weights = np.ones((90, 44))
    weights[16, 23] = value
    return weights


T = paper_task()


@pytest.mark.parametrize(
    ("make", "message"),
    [
        (lambda: Policy(T, np.ones((15, 44))), r"shape \(90, 44\) .* found \(15, 44\)"),
        (lambda: Policy(T, with_entry(np.nan)), "found nan at input {'DL': 0, 'GL': 1, 'nWPN': 0, 'FTR': 2}"),
        (lambda: Policy(T, with_entry(np.inf)), r"found inf .* output {'MV': 1, 'WPN': 0, 'CA': 0.1}"),
        (lambda: Policy(T, with_entry(-0.1)), "not negative, found -0.1"),
        (lambda: Policy(T, np.full((90, 44), 1e308)), "too large"),
        (lambda: Policy(T, [["a"]]), "not a table of numbers"),
        (lambda: Policy(T, np.ones((90, 44)), kind="q"), "kind"),
        (lambda: Policy(T, np.ones((90, 44)), carried={"visits": np.ones(3)}), "carried 'visits' of shape"),
        (lambda: Policy(T, np.ones((90, 44)), carried={"input": 1.0}), "name is taken"),
        (lambda: Policy(T, np.ones((90, 44)), carried={"eps": math.nan}), "expected finite numbers"),
        (
            lambda: Policy.equal(T).extend(paper_simple()),
            "neither equal to nor a simplification of 'V': input 'DL'",
        ),
        (lambda: Policy.equal(T).extend(T, [swap("XX")]), "no variable 'XX'"),
        (lambda: Policy.equal(T).extend(T, [swap("DL")]), "expected an output, found the input 'DL'"),
        (lambda: Policy.equal(T).extend(T, [swap("CA")]), "has 11 values; say which"),
        (lambda: Policy.equal(T).extend(T, [swap("CA", (0.0, 0.77))]), "no value 0.77"),
        (lambda: Policy.equal(T).extend(T, [swap("MV", when={"MV": 0})]), "cannot be a condition"),
        (lambda: Policy.equal(T).extend(T, [forget("DL")]), "expected an output, found the input 'DL'"),
        (lambda: Policy.equal(T).extend(T, [forget("MV", {"MV": 0})]), "cannot be a condition"),
        (lambda: Policy.equal(T).extend(T, [invert({"DL": 3})]), "'DL' has no value 3"),
        (lambda: Policy.equal(T).extend(T, [set_weight(-1)]), "not negative"),
        (lambda: scale(-1), "number of 0.0 or more"),
        (lambda: set_weight(math.nan), "finite"),
        (lambda: Policy.equal(T).select(0), "give either rng= or u="),
        (lambda: Policy.equal(T).select(0, "best", u=0.5), "expected one of exploration"),
        (lambda: Policy.equal(T).select(0, "pseudo-random", q=2, u=0.5), "from 0 up to 1"),
        (lambda: Policy.equal(T).select(90, u=0.5), "from 0 to 89"),
        (lambda: Policy(T, np.ones((90, 44)), kind="value").select(0, u=0.5), "drawn in proportion"),
    ],
)
def test_mistakes_are_named(make, message: str) -> None:
    with pytest.raises(TaskliftError, match=message):
        make()


# -- files ---------------------------------------------------------------------------------------------------


def same(one: Policy, other: Policy) -> bool:
    return (
        one.task == other.task
        and one.weights.tobytes() == other.weights.tobytes()
        and one.kind == other.kind
        and one.provenance == other.provenance
        and one.carried.keys() == other.carried.keys()
        and all(np.array_equal(one.carried[k], other.carried[k]) for k in one.carried)
    )


@FILES
@given(data=st.data())
def test_a_round_trip_is_exact(data: st.DataObject, tmp_path: Path) -> None:
    task = data.draw(simplified(data.draw(small_tasks())))
    bound = 1e300
    number = (
        st.floats(-bound, bound)
        if (kind := data.draw(st.sampled_from(["weight", "value"]))) == "value"
        else st.floats(0, bound)
    )
    cells = math.prod(task.shape)
    weights = np.array(data.draw(st.lists(number, min_size=cells, max_size=cells))).reshape(task.shape)
    policy = Policy(task, weights, {"seed": 3, "who": "Ünal"}, kind, {"visits": weights / 2, "epsilon": 0.1})
    path = tmp_path / "policy.json"
    policy.save(path)
    assert same(Policy.load(path), policy)
    assert same(Policy.load(path, task), policy)


def test_a_large_table_goes_beside_the_file(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    task = Task("big", (Variable("x", range(30_000)),), (Variable("y", range(4)),))
    assert math.prod(task.shape) > module.LARGEST_JSON
    policy = random_policy(task, carried={"visits": np.ones(task.shape), "epsilon": 0.25})
    policy.save(tmp_path / "big.json")
    assert same(Policy.load(tmp_path / "big.json", task), policy)
    (first,) = tmp_path.glob("big-*.npz")
    random_policy(task, 1).save(tmp_path / "other.json")
    (other,) = tmp_path.glob("other-*.npz")
    kept = first.read_bytes()
    other.rename(first)
    with pytest.raises(TaskliftError, match="not the ones saved with it"):
        Policy.load(tmp_path / "big.json")
    first.write_bytes(kept)
    random_policy(task, 2).save(tmp_path / "big.json")
    (second,) = tmp_path.glob("big-*.npz")
    assert second.name != first.name
    (tmp_path / "copy.json").write_bytes((tmp_path / "big.json").read_bytes())
    policy.save(tmp_path / "big.json")
    assert same(Policy.load(tmp_path / "copy.json"), random_policy(task, 2))
    first.unlink()
    with pytest.raises(TaskliftError, match="cannot be read"):
        Policy.load(tmp_path / "big.json")
    with pytest.raises(TaskliftError, match=r"suffix \.npz is taken"):
        policy.save(tmp_path / "big.npz")


def test_a_person_can_read_and_edit_the_file(tmp_path: Path) -> None:
    path = tmp_path / "v.json"
    random_policy(paper_simple()).save(path)
    lines = path.read_text().splitlines()
    assert sum('"input": {"nWPN"' in line for line in lines) == 15
    document = json.loads(path.read_text())
    document["rows"][3]["weights"][5] = 0.75
    path.write_text(json.dumps(document))
    with pytest.raises(TaskliftError, match="take the field 'checksum' out"):
        Policy.load(path)
    del document["checksum"]
    path.write_text(json.dumps(document))
    assert Policy.load(path).weights[3, 5] == 0.75


@FILES
@given(cut=st.floats(0, 1, exclude_max=True))
def test_a_file_cut_short_is_refused(cut: float, tmp_path: Path) -> None:
    path = tmp_path / "cut.json"
    random_policy(paper_simple()).save(path)
    raw = path.read_bytes()
    path.write_bytes(raw[: int(cut * (len(raw) - 2))])
    with pytest.raises(TaskliftError):
        Policy.load(path)


@FILES
@given(
    flips=st.lists(st.tuples(st.floats(0, 1, exclude_max=True), st.integers(1, 255)), min_size=1, max_size=4)
)
def test_a_damaged_file_is_the_same_or_refused(flips: list[tuple[float, int]], tmp_path: Path) -> None:
    path = tmp_path / "damaged.json"
    policy = random_policy(
        paper_task().simplify(fix={"DL": 0, "GL": 0, "WPN": 0}, restrict={"CA": [0.0, 0.5]})
    )
    policy.save(path)
    raw = bytearray(path.read_bytes())
    for place, bits in flips:
        raw[int(place * len(raw))] ^= bits
    path.write_bytes(bytes(raw))
    try:
        assert same(Policy.load(path), policy)
    except TaskliftError as error:
        assert "damaged.json" in str(error)  # noqa: PT017  (refusal is one of two good ends)


@FILES
@given(
    value=st.recursive(
        st.none() | st.booleans() | st.floats(allow_nan=False) | st.integers() | st.text(max_size=3),
        lambda inner: st.lists(inner, max_size=3) | st.dictionaries(st.text(max_size=3), inner, max_size=3),
        max_leaves=8,
    ),
    field=st.sampled_from(
        ["kind", "task", "provenance", "numbers", "outputs", "rows", "weights", "inputs", "parent", "signals"]
    ),
)
def test_foreign_content_in_any_field_is_the_same_or_refused(value, field: str, tmp_path: Path) -> None:
    path = tmp_path / "foreign.json"
    small = paper_task().simplify(fix={"DL": 0, "GL": 0, "WPN": 0}, restrict={"CA": [0.0, 0.5]})
    random_policy(small).save(path)
    document = json.loads(path.read_text())
    del document["checksum"]
    if field == "weights":
        document["rows"][2]["weights"] = value
    elif field in document:
        document[field] = value
    else:
        document["task"][field] = value
    path.write_text(json.dumps(document))
    try:
        Policy.load(path)
    except TaskliftError as error:
        assert "foreign.json" in str(error)  # noqa: PT017  (refusal is one of two good ends)


def test_a_policy_of_another_task_is_refused_by_the_variable(tmp_path: Path) -> None:
    path = tmp_path / "t.json"
    random_policy(T).save(path)
    other = Task("other", (*T.inputs[:3], Variable("FTR", range(1, 5))), T.outputs)
    with pytest.raises(TaskliftError, match=r"another task: input 'FTR' has the values \(1, 2, 3, 4, 5\)"):
        Policy.load(path, other)
    with pytest.raises(TaskliftError, match="input 'DL' of 'T' is not in 'V'"):
        Policy.load(path, paper_simple())
    assert Policy.load(path, T).task is T
    path.write_text('{"format": "tasklift-building", "version": 1}')
    with pytest.raises(TaskliftError, match="expected a tasklift-policy file"):
        Policy.load(path)
    with pytest.raises(TaskliftError, match="cannot be read"):
        Policy.load(tmp_path / "missing.json")
    with pytest.raises(TaskliftError, match="not JSON data"):
        Policy.equal(T).__class__(T, np.ones(T.shape), {"seed": {1, 2}}).save(path)


def test_a_policy_reads_as_lines_and_as_a_table():
    task = Task("door", (Variable("near", (0, 1)),), (Variable("act", ("stop", "go")),))
    policy = Policy(task, np.array([[1.0, 3.0], [2.0, 0.0]]))
    assert list(policy.describe(top=1)) == [
        ({"near": "0"}, [(0.75, {"act": "go"})]),
        ({"near": "1"}, [(1.0, {"act": "stop"})]),
    ]
    assert policy.to_csv().splitlines() == [
        "near,act,weight,probability",
        "0,stop,1.0,0.25",
        "0,go,3.0,0.75",
        "1,stop,2.0,1.0",
        "1,go,0.0,0.0",
    ]
    values = Policy(task, np.array([[-1.0, -3.0], [2.0, 0.0]]), kind="value")
    assert list(values.describe(top=1)) == [
        ({"near": near}, [(1.0, {"act": "stop"})]) for near in ("0", "1")
    ]


KILLED = """
import sys
from itertools import cycle
import numpy as np
from tasklift.tasks import policy as module
from tasklift.tasks.policy import Policy
from tasklift.tasks.task import Task, Variable

module.LARGEST_JSON = int(sys.argv[2])
task = Task("t", (Variable("x", range(400)),), (Variable("y", range(50)),))
policies = [Policy(task, np.full(task.shape, float(value))) for value in (1, 2, 3)]
policies[0].save(sys.argv[1])
print("ready", flush=True)
for policy in cycle(policies):
    policy.save(sys.argv[1])
"""


@pytest.mark.parametrize("largest_json", [10, 10**6], ids=["beside", "within"])
def test_a_policy_whose_writer_is_killed_is_whole(largest_json: int, tmp_path: Path) -> None:
    path, rng = tmp_path / "policy.json", np.random.default_rng(largest_json)
    seen = set()
    for _ in range(6):
        command = [sys.executable, "-c", KILLED, str(path), str(largest_json)]
        with subprocess.Popen(command, stdout=subprocess.PIPE) as process:
            assert process.stdout is not None
            assert process.stdout.readline() == b"ready\n"
            time.sleep(rng.uniform(0, 0.1))
            process.kill()
        policy = Policy.load(path)
        seen.add(value := policy.weights[0, 0])
        assert (policy.weights == value).all()
    assert seen <= {1.0, 2.0, 3.0}
    monkey = pytest.MonkeyPatch()
    with monkey.context() as patch:
        patch.setattr(module, "LARGEST_JSON", largest_json)
        patch.setattr(module, "AN_HOUR_S", -1.0)
        Policy(policy.task, policy.weights + 1).save(path)
    assert len(list(tmp_path.iterdir())) == 1 + (largest_json == 10), "nothing is left of those killed"
