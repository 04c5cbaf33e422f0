"""Tasks: the paper's tables, index maps of simpler versions, signals, and clear refusals."""

from __future__ import annotations

import itertools

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from tasklift.errors import TaskliftError
from tasklift.tasks.policy import Policy
from tasklift.tasks.task import Signal, Task, Variable

PROPERTY = settings(deadline=None, derandomize=True, max_examples=60)


def paper_task() -> Task:
    """Table I of the paper, with the signals of Table III."""
    return Task(
        "T",
        inputs=(
            Variable("DL", (0, 1, 2)),
            Variable("GL", (0, 1)),
            Variable("nWPN", (0, 1, 2), ("none", "some", "enough")),
            Variable("FTR", range(1, 6), ("nothing", "bend", "corner", "door", "other")),
        ),
        outputs=(
            Variable("MV", (0, 1)),
            Variable("WPN", (0, 1)),
            Variable("CA", tuple(k / 10 for k in range(11))),
        ),
        signals=(
            Signal(-0.1, {"MV": 0, "nWPN": 2}, "never stop when enough weapon robots"),
            Signal(+0.1, {"MV": 0, "nWPN": 0, "FTR": 4}, "suspected enemy"),
            Signal(-0.1, {"MV": 0, "FTR": [1, 2, 3, 5]}, "not an enemy feature"),
        ),
        impossible=({"WPN": 1, "nWPN": 0},),
        time_reward=0.1,
    )


def paper_simple() -> Task:
    """Table II."""
    return paper_task().simplify(fix={"DL": 0, "GL": 0}, name="V", signals=[Signal(-0.2, {"MV": 0})], time_reward=0.2)


def small_tasks() -> st.SearchStrategy[Task]:
    sizes = st.lists(st.integers(1, 3), min_size=1, max_size=3)

    def build(ins: list[int], outs: list[int]) -> Task:
        inputs = tuple(Variable(f"i{k}", tuple(10 * k + j for j in range(n))) for k, n in enumerate(ins))
        outputs = tuple(Variable(f"o{k}", tuple(f"v{j}" for j in range(n))) for k, n in enumerate(outs))
        return Task("small", inputs, outputs, (Signal(0.5, {"i0": 0, "o0": "v0"}),))

    return st.builds(build, sizes, sizes)


@st.composite
def simplified(draw: st.DrawFn, task: Task, merging: bool = True) -> Task:
    fix, remove, restrict, merge = {}, [], {}, {}
    open_outputs = len(task.outputs)
    for variable in task.variables:
        output = variable in task.outputs
        choices = ["keep", "restrict", *([] if output else ["fix", "remove"])]
        if output and open_outputs > 1:
            choices.append("fix")
        if merging and not output:
            choices.append("merge")
        fate = draw(st.sampled_from(choices))
        if fate == "fix":
            fix[variable.name] = draw(st.sampled_from(variable.values))
            open_outputs -= output
        elif fate == "remove":
            remove.append(variable.name)
        elif fate == "restrict":
            chosen = st.lists(st.sampled_from(variable.values), min_size=1, unique=True)
            restrict[variable.name] = draw(chosen)
        elif fate == "merge":
            groups: dict[int, list] = {}
            for value in draw(st.permutations(variable.values)):
                groups.setdefault(draw(st.integers(0, 2)), []).append(value)
            merge[variable.name] = list(groups.values())
    return task.simplify(fix, remove, restrict, merge, signals=())


def test_the_papers_tables() -> None:
    task, simple = paper_task(), paper_simple()
    assert task.shape == (90, 44)
    assert np.prod(task.shape) == 3960
    assert simple.shape == (15, 44)
    assert np.prod(simple.shape) == 660
    assert simple.parent == task
    assert simple.root == task


def test_the_index_is_in_c_order() -> None:
    task = paper_task()
    for dl, gl, n, f in itertools.product(range(3), range(2), range(3), range(1, 6)):
        index = ((dl * 2 + gl) * 3 + n) * 5 + (f - 1)
        assert task.input_index({"DL": dl, "GL": gl, "nWPN": n, "FTR": f}) == index
        assert task.input_values(index) == {"DL": dl, "GL": gl, "nWPN": n, "FTR": f}
    assert task.output_index({"MV": 1, "WPN": 0, "CA": 0.3}) == (1 * 2 + 0) * 11 + 3


def test_table_three_as_an_array() -> None:
    task = paper_task()
    table = task.signal_table(impossible=False)
    for s, a in itertools.product(range(90), range(44)):
        state, action = task.input_values(s), task.output_values(a)
        expected = 0.0
        if action["MV"] == 0:
            expected -= 0.1 * (state["nWPN"] == 2)
            expected += 0.1 * (state["nWPN"] == 0 and state["FTR"] == 4)
            expected -= 0.1 * (state["FTR"] != 4)
        assert table[s, a] == pytest.approx(expected)
        assert task.impossible_table()[s, a] == (action["WPN"] == 1 and state["nWPN"] == 0)
    assert np.array_equal(task.signal_table(), table - 0.5 * task.impossible_table())


def test_labels_stand_for_values() -> None:
    task = paper_task()
    assert np.array_equal(task.where({"FTR": "door", "MV": 0}), task.where({"FTR": [4], "MV": (0,)}))
    assert task.input_mask({"nWPN": ["none", "some"]}).sum() == 60


def test_the_simple_tasks_own_and_inherited_signals() -> None:
    assert np.unique(paper_simple().signal_table(impossible=False)).tolist() == [-0.2, 0.0]
    inherited = paper_task().simplify(fix={"nWPN": 0, "DL": 0}, restrict={"FTR": [1, 4]})
    assert [s.value for s in inherited.signals] == [0.1, -0.1]
    rows, columns = inherited.input_map, inherited.output_map
    ours = paper_task().signal_table()[np.ix_(rows >= 0, columns)]
    assert np.allclose(inherited.signal_table()[rows[rows >= 0]], ours)
    assert paper_task().simplify(fix={"WPN": 0}).impossible == ()


@PROPERTY
@given(st.data())
def test_index_maps_are_exact(data: st.DataObject) -> None:
    task = data.draw(small_tasks())
    simple = data.draw(simplified(task))
    kept = [v.name for v in simple.inputs]
    for s in range(task.shape[0]):
        values = {
            name: next((group[0] for group in simple.merged.get(name, ()) if value in group), value)
            for name, value in task.input_values(s).items()
        }
        allowed = {v.name: v.values for v in simple.inputs}
        inside = all(values[n] in allowed[n] for n in kept)
        inside &= all(values[n] == v for n, v in simple.fixed.items() if n in values)
        expected = simple.input_index({n: values[n] for n in kept}) if inside else -1
        assert simple.input_map[s] == expected
        assert simple.row_of(task.input_values(s)) == expected
    for a in range(simple.shape[1]):
        fixed = {v.name: simple.fixed[v.name] for v in task.outputs if v.name in simple.fixed}
        assert task.output_values(int(simple.output_map[a])) == simple.output_values(a) | fixed


@PROPERTY
@given(st.data())
def test_maps_of_a_chain_compose(data: st.DataObject) -> None:
    task = data.draw(small_tasks())
    middle = data.draw(simplified(task))
    last = data.draw(simplified(middle))
    through = np.append(last.input_rows(middle), -1)[middle.input_map]
    assert np.array_equal(last.input_map, through)
    assert np.array_equal(last.output_map, middle.output_map[last.output_columns(middle)])
    assert last.root is task


@PROPERTY
@given(st.data())
def test_json_brings_back_the_same_task(data: st.DataObject) -> None:
    task = data.draw(simplified(data.draw(small_tasks())))
    again = Task.from_json(task.to_json())
    assert again == task
    assert hash(again) == hash(task)
    assert again != paper_task()


def test_merged_values_share_a_row_and_what_was_learned_there() -> None:
    walk = Task("walk", (Variable("place", range(6)),), (Variable("move", (0, 1)),), (Signal(1.0, {"place": [4, 5]}),))
    coarse = walk.simplify(merge={"place": [[5, 4], [0, 2]]})
    assert coarse.merged == {"place": ((4, 5), (0, 2))}
    assert coarse.inputs[0].values == (0, 1, 3, 4)
    assert coarse.signal_table()[:, 0].tolist() == [0, 0, 0, 1]
    extended = Policy(coarse, [[0, 1], [2, 3], [4, 5], [6, 7]]).extend(walk)
    assert extended.weights[:, 0].tolist() == [0, 2, 0, 4, 6, 6]
    lower = coarse.simplify(restrict={"place": [0, 4]})
    assert lower.input_map.tolist() == [0, -1, 0, -1, 1, 1]
    assert Policy(lower, [[0, 1], [4, 5]]).extend(walk).weights[:, 0].tolist() == [0, 2, 0, 2, 4, 4]


def test_a_huge_task_is_declared_and_not_enumerated() -> None:
    inputs = tuple(Variable(f"x{i}", range(10)) for i in range(12))
    task = Task("huge", inputs, (Variable("go", (0, 1)),), (Signal(1.0, {"x3": 3}),))
    assert task.shape == (10**12, 2)
    assert task.input_values(10**12 - 1) == {f"x{i}": 9 for i in range(12)}
    assert task.input_index({f"x{i}": 0 for i in range(11)} | {"x11": 7}) == 7
    small = task.simplify(remove=[f"x{i}" for i in range(6, 12)], restrict={"x0": [1, 2]})
    assert small.shape == (200_000, 2)
    with pytest.raises(TaskliftError, match="map of inputs would have 1,000,000,000,000 entries"):
        _ = small.input_map
    million = Task("million", inputs[:6], task.outputs)
    assert million.simplify(remove=["x5"]).input_map.shape == (1_000_000,)


T = paper_task()


@pytest.mark.parametrize(
    ("make", "message"),
    [
        (lambda: Variable("", (1,)), "expected a name"),
        (lambda: Variable("x", ()), "has no values"),
        (lambda: Variable("x", (1, 2, 1)), "the value 1 is there twice"),
        (lambda: Variable("x", (1, True)), "there twice"),
        (lambda: Variable("x", (float("nan"),)), "finite"),
        (lambda: Variable("x", ([1],)), "expected a number, a string"),
        (lambda: Variable("x", "ab"), "expected a list of values"),
        (lambda: Variable("x", (1, 2), ("a",)), "expected 2 labels"),
        (lambda: Variable("x", (1, 2), ("a", "a")), "stands for two values"),
        (lambda: Signal(float("inf")), "finite"),
        (lambda: Signal("much"), "expected a number"),
        (lambda: Task("t", (), ()), "no output left"),
        (lambda: Task("t", T.inputs, T.inputs), "two variables are called 'DL'"),
        (lambda: Task("t", T.inputs, T.outputs, (Signal(1, {"XX": 1}),)), "no variable 'XX'"),
        (
            lambda: Task("t", T.inputs, T.outputs, (Signal(1, {"DL": 7}),)),
            "'DL' has no value 7; it has 0, 1, 2",
        ),
        (lambda: Task("t", T.inputs, T.outputs, (Signal(1, {"DL": []}),)), "nothing can meet"),
        (lambda: Task("t", T.inputs, T.outputs, (), ({"DL": [0, 0]},)), "given twice"),
        (lambda: Task("t", T.inputs, T.outputs, time_reward=float("nan")), "finite"),
        (lambda: T.simplify(fix={"DL": 9}), "no value 9"),
        (lambda: T.simplify(fix={"XX": 9}), "no variable 'XX'"),
        (lambda: T.simplify(fix={"DL": 0}, remove=["DL"]), "named twice"),
        (lambda: T.simplify(remove=["DL", "DL"]), "named twice"),
        (lambda: T.simplify(remove="DL"), "expected a list of names"),
        (lambda: T.simplify(remove=["MV"]), "'MV' is an output"),
        (lambda: T.simplify(restrict={"DL": []}), "no value of 'DL'"),
        (lambda: T.simplify(fix={"MV": 0, "WPN": 0, "CA": 0.0}), "no output left"),
        (lambda: T.simplify(merge={"MV": [[0, 1]]}), "'MV' is an output"),
        (lambda: T.simplify(merge={"DL": [[0, 1], [1, 2]]}), "groups of different values"),
        (lambda: T.simplify(merge={"DL": [[0, 7]]}), "no value 7"),
        (lambda: T.simplify(merge={"DL": [[0, 1]]}, remove=["DL"]), "named twice"),
        (lambda: T.simplify(merge={"FTR": [[4, 5]]}), "depends on 'FTR', which is merged"),
        (lambda: T.simplify(remove=["FTR"]), "depends on 'FTR', which is removed"),
        (lambda: T.simplify(fix={"DL": 0}).simplify(fix={"DL": 0}), "no variable 'DL'"),
        (lambda: T.input_index({"DL": 0}), "expected an input as"),
        (lambda: T.input_index({"DL": 0, "GL": 0, "nWPN": 0, "XX": 1}), "has no 'FTR'"),
        (lambda: T.input_values(90), "from 0 to 89"),
        (lambda: T.output_values(-1), "from 0 to 43"),
        (lambda: T.input_mask({"MV": 1}), "over inputs, found output 'MV'"),
        (lambda: T.ancestor(Task("t", T.inputs[:3], T.outputs)), "input 'FTR' of 'T' is not in 't'"),
        (lambda: Task.from_json([]), "expected an object"),
        (lambda: Task.from_json(T.to_json() | {"more": 1}), "unknown field 'more'"),
        (lambda: Task.from_json({k: v for k, v in T.to_json().items() if k != "name"}), "'name' is missing"),
        (lambda: Task.from_json(T.to_json() | {"fixed": {"DL": 1}}), "expected a parent task.*found none"),
        (lambda: Task.from_json(T.to_json() | {"merged": {"DL": [[0, 1]]}}), "expected a parent task.*found none"),
        (lambda: Task.from_json(paper_simple().to_json() | {"merged": {"FTR": 4}}), "groups of values"),
        (lambda: Task.from_json(paper_simple().to_json() | {"merged": {"FTR": [[4, 5]]}}), "only the first"),
        (lambda: Task.from_json(paper_simple().to_json() | {"removed": ["DL"]}), "exactly one of them"),
    ],
)
def test_mistakes_are_named(make, message: str) -> None:
    with pytest.raises(TaskliftError, match=message):
        make()
