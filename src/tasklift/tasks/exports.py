"""Policies that leave: a Python file, a C header, an ONNX model, a ROS 2 package, none of which needs tasklift.

Each makes the decisions of :meth:`.Policy.select` in every state (input). Python and C take the same random numbers,
so they draw the same actions (outputs) as well. Python's file has the source of :mod:`tasklift.tasks.choice` in it.
"""

from __future__ import annotations

import inspect
import json
import keyword
import re
import sys
from pathlib import PurePath

import tasklift
from tasklift.errors import TaskliftError, missing
from tasklift.tasks import choice
from tasklift.tasks.policy import Policy
from tasklift.tasks.variable import Variable

#: The most weights that are spelled in source code: 20 bytes each.
LARGEST_SOURCE = 1_000_000


def to_python(policy: Policy) -> str:
    """Return the source of a Python module without dependencies, with ``act(inputs)``.

    Parameters
    ----------
    policy : Policy
        Of any kind; of values, only the heaviest action can be asked for.

    Raises
    ------
    TaskliftError
        If it has more than :data:`LARGEST_SOURCE` weights.

    Examples
    --------
    >>> from tasklift import Policy, Task, Variable
    >>> walk = Task("walk", (Variable("door", ("shut", "open")),), (Variable("move", (0, 1)),))
    >>> module = {}
    >>> exec(to_python(Policy(walk, [[3.0, 1.0], [1.0, 3.0]])), module)
    >>> module["act"]({"door": "open"})
    {'move': 1}
    """
    _need_source_size(policy)
    rows = "\n".join(f"    {row!r}," for row in policy.weights.tolist())
    return _PYTHON % {
        "task": _comment(policy.task.name),
        "version": tasklift.__version__,
        "kind": repr(policy.kind),
        "inputs": _python_variables(policy.task.inputs),
        "outputs": _python_variables(policy.task.outputs),
        "rows": rows,
        "rules": "\n\n".join(inspect.getsource(rule).rstrip() + "\n" for rule in (choice.heaviest, choice.draw)),
    }


def to_c(policy: Policy, name: str = "policy") -> str:
    """Return a C99 header without dependencies; its functions begin with ``name``.

    Parameters
    ----------
    policy : Policy
        Of values, only the heaviest action can be asked for: there is no ``NAME_draw``.
    name : str
        Letters that C does not take become underscores.

    Raises
    ------
    TaskliftError
        If it has more than :data:`LARGEST_SOURCE` weights.

    Examples
    --------
    >>> from tasklift import Policy, Task, Variable
    >>> walk = Task("walk", (Variable("door", ("shut", "open")),), (Variable("move", (0, 1)),))
    >>> "int walk_best(int state)" in to_c(Policy(walk, [[3.0, 1.0], [1.0, 3.0]]), "walk")
    True
    """
    _need_source_size(policy)
    prefix = re.sub(r"[^A-Za-z0-9_]", "_", name)
    prefix = prefix if prefix[:1].isalpha() else f"policy_{prefix}"
    rows = ",\n".join("  {" + ", ".join(map(repr, row)) + "}" for row in policy.weights.tolist())
    states, actions = policy.task.shape
    return (_C + (_C_DRAW if policy.kind == "weight" else "") + "#endif\n") % {
        "task": _comment(policy.task.name),
        "version": tasklift.__version__,
        "kind": policy.kind,
        "variables": _c_variables("input", policy.task.inputs) + _c_variables("output", policy.task.outputs),
        "name": prefix,
        "upper": prefix.upper(),
        "inputs": len(policy.task.inputs),
        "outputs": len(policy.task.outputs),
        "input_sizes": ", ".join(str(len(v)) for v in policy.task.inputs) or "1",
        "output_sizes": ", ".join(str(len(v)) for v in policy.task.outputs),
        "inputs_1": max(1, len(policy.task.inputs)),
        "states": states,
        "actions": actions,
        "rows": rows,
    }


def to_onnx(policy: Policy) -> bytes:
    """Return an ONNX model (operator set 13): the positions of the inputs' values in, weights and best action out.

    ``state`` is int64 (n, inputs); ``weights`` float64 (n, A); ``action`` int64 (n,), the first of the heaviest;
    ``outputs`` int64 (n, outputs), the positions of the action's values. A task without inputs takes one column of
    zeros. The model's metadata lists the variables as JSON.

    Raises
    ------
    TaskliftError
        Without the extra ``onnx``.
    """
    try:
        from onnx import TensorProto, helper, numpy_helper
    except ImportError as error:
        raise missing("onnx", "onnx", "an ONNX file") from error
    import numpy as np

    task = policy.task
    sizes = [len(v) for v in task.inputs] or [1]
    positions = np.indices([len(v) for v in task.outputs]).reshape(len(task.outputs), -1).T.astype(np.int64)
    constants = {"table": policy.weights.reshape(*sizes, -1), "positions": np.ascontiguousarray(positions)}
    nodes = [
        helper.make_node("GatherND", ["table", "state"], ["weights"]),
        helper.make_node("ArgMax", ["weights"], ["action"], axis=1, keepdims=0),
        helper.make_node("Gather", ["positions", "action"], ["outputs"]),
    ]
    graph = helper.make_graph(
        nodes,
        "policy",
        [helper.make_tensor_value_info("state", TensorProto.INT64, ["n", len(sizes)])],
        [
            helper.make_tensor_value_info("weights", TensorProto.DOUBLE, ["n", task.shape[1]]),
            helper.make_tensor_value_info("action", TensorProto.INT64, ["n"]),
            helper.make_tensor_value_info("outputs", TensorProto.INT64, ["n", len(task.outputs)]),
        ],
        [numpy_helper.from_array(array, name) for name, array in constants.items()],
    )
    # an old version of the format and of the operators, so that old runtimes on robots read it
    model = helper.make_model(graph, opset_imports=[helper.make_opsetid("", 13)], ir_version=8)
    model.producer_name = f"tasklift {tasklift.__version__}"
    variables = {side: [v.to_json() for v in getattr(task, side)] for side in ("inputs", "outputs")}
    helper.set_model_props(model, {"task": task.name, **{side: json.dumps(of) for side, of in variables.items()}})
    return bytes(model.SerializeToString())


def to_ros2(policy: Policy, name: str) -> dict[str, str]:
    """Return the files of a ROS 2 source package (ament_python): their text by path.

    Its node takes states as JSON text on ``~/state`` (std_msgs/String), and answers on ``~/action``.

    Parameters
    ----------
    policy : Policy
        What the node decides by.
    name : str
        The package's: small letters, digits and single underscores, a letter first; not a word of Python's, nor a
        module that the node would no longer find.

    Raises
    ------
    TaskliftError
        For a name that ROS refuses.
    """
    if not re.fullmatch(r"[a-z](_?[a-z0-9])+", name):
        raise TaskliftError(
            "ROS 2 package: expected a name of two or more small letters, digits and single underscores, a letter "
            f"first, found {name!r}"
        )
    if keyword.iskeyword(name) or name in (*sys.stdlib_module_names, "rclpy", "std_msgs"):
        raise TaskliftError(f"ROS 2 package: {name!r} is a word or a module of Python's or ROS's; choose another name")
    words = {"name": name, "task": _comment(policy.task.name), "version": tasklift.__version__}
    return {
        "package.xml": _PACKAGE_XML % words,
        "setup.py": _SETUP_PY % words,
        "setup.cfg": _SETUP_CFG % words,
        f"resource/{name}": "",
        f"{name}/__init__.py": "",
        f"{name}/policy.py": to_python(policy),
        f"{name}/node.py": _NODE_PY % words,
    }


#: What a file's name ends in, by the kind of export; a ROS 2 package is a folder.
SUFFIXES = {"json": ".json", "csv": ".csv", "onnx": ".onnx", "python": ".py", "c": ".h", "ros2": ""}


def kind_of(path: PurePath, kind: str | None = None) -> str:
    """Return the kind of export that a path's name asks for; a ``kind`` given beside it has to fit.

    Raises
    ------
    TaskliftError
        For a name that ends in none of :data:`SUFFIXES`, or in another kind's.
    """
    suffix = path.suffix.lower()
    if kind is not None and SUFFIXES[kind] != suffix:
        ends = f"ends in {SUFFIXES[kind]}" if SUFFIXES[kind] else "has no dot, as a folder"
        raise TaskliftError(f"{path}: expected a name that {ends}, for the kind {kind}")
    for known, ending in SUFFIXES.items():
        if ending == suffix:
            return known
    endings = ", ".join(ending for ending in SUFFIXES.values() if ending)
    raise TaskliftError(f"{path}: expected a name that ends in one of {endings}, or a folder for a ROS 2 package")


def content(policy: Policy, kind: str, name: str) -> str | bytes:
    """Return what a file of a kind has in it; ``name`` is the prefix of C's functions."""
    if kind == "c":
        return to_c(policy, name)
    if kind == "onnx":
        return to_onnx(policy)
    return policy.to_csv() if kind == "csv" else to_python(policy)


def _need_source_size(policy: Policy) -> None:
    if policy.weights.size > LARGEST_SOURCE:
        raise TaskliftError(
            f"policy: {policy.weights.size:,} weights are too many for source code (at most {LARGEST_SOURCE:,}); "
            "export it as .onnx or .json"
        )


def _comment(text: str) -> str:
    """Return text that can stand in a comment or docstring of any of the languages."""
    kept = text.encode("ascii", "replace").decode()
    return re.sub(r"[^A-Za-z0-9 .,:;+=()\[\]_-]", "?", kept)


def _python_variables(variables: tuple[Variable, ...]) -> str:
    lines = [f"    ({v.name!r}, {v.values!r}, {v.labels or ()!r}),\n" for v in variables]
    return "(\n" + "".join(lines) + ")"


def _c_variables(side: str, variables: tuple[Variable, ...]) -> str:
    lines = []
    for k, variable in enumerate(variables):
        values = (_comment(str(value)) for value in variable.values)
        names = [""] * len(variable) if variable.labels is None else [f" {_comment(x)}" for x in variable.labels]
        listed = ", ".join(f"{i}: {value}{name}" for i, (value, name) in enumerate(zip(values, names, strict=True)))
        lines.append(f"   {side} {k}, {_comment(variable.name)}: {listed}\n")
    return "".join(lines)


_PYTHON = '''"""The policy of the task "%(task)s", exported by tasklift %(version)s. Needs nothing but Python 3."""

KIND = %(kind)s

# (name, values, labels) of each variable; the first one is the slowest in the index of a state or action
INPUTS = %(inputs)s
OUTPUTS = %(outputs)s

# one row per state, one weight per action
WEIGHTS = (
%(rows)s
)


%(rules)s

def state(inputs):
    """Return the row of a state, given as {name: value}; labels may stand for values."""
    if set(inputs) != {name for name, _, _ in INPUTS}:
        raise ValueError("expected the inputs %%s, found %%s" %% ([name for name, _, _ in INPUTS], sorted(inputs)))
    row = 0
    for name, values, labels in INPUTS:
        value = inputs[name]
        if value in values:
            position = values.index(value)
        elif value in labels:
            position = labels.index(value)
        else:
            raise ValueError("%%s has no value %%r; it has %%s" %% (name, value, list(values)))
        row = row * len(values) + position
    return row


def action(column):
    """Return an action as {name: value}, given its column."""
    found = {}
    for name, values, _ in reversed(OUTPUTS):
        column, position = divmod(column, len(values))
        found[name] = values[position]
    return {name: found[name] for name, _, _ in OUTPUTS}


def act(inputs, u=None):
    """Return the action in a state, both as {name: value}: the first of the heaviest.

    With u, a random number in [0, 1): one drawn in proportion to weight.
    """
    if u is None:
        return action(heaviest(WEIGHTS[state(inputs)], 0.0))
    if KIND != "weight":
        raise ValueError("values cannot be drawn in proportion; leave u out")
    if not 0 <= u < 1:
        raise ValueError("expected u in [0, 1), found %%r" %% (u,))
    return action(draw(WEIGHTS[state(inputs)], u))
'''

_C = """/* The policy of the task "%(task)s", exported by tasklift %(version)s. C99, no dependencies.

   A state is the position of each input's value, an action the position of each output's:
%(variables)s*/
#ifndef %(upper)s_H
#define %(upper)s_H

#define %(upper)s_INPUTS %(inputs)s
#define %(upper)s_OUTPUTS %(outputs)s
#define %(upper)s_STATES %(states)s
#define %(upper)s_ACTIONS %(actions)s

/* %(kind)ss, one row per state */
static const double %(name)s_weights[%(upper)s_STATES][%(upper)s_ACTIONS] = {
%(rows)s
};

/* the row of a state; -1 if a position is none of its variable's */
static inline int %(name)s_state(const int *positions) {
  static const int sizes[%(inputs_1)s] = {%(input_sizes)s};
  int row = 0;
  for (int k = 0; k < %(upper)s_INPUTS; k++) {
    if (positions[k] < 0 || positions[k] >= sizes[k]) return -1;
    row = row * sizes[k] + positions[k];
  }
  return row;
}

/* the positions of an action's values */
static inline void %(name)s_outputs(int action, int *positions) {
  static const int sizes[%(upper)s_OUTPUTS] = {%(output_sizes)s};
  for (int k = %(upper)s_OUTPUTS - 1; k >= 0; k--) {
    positions[k] = action %% sizes[k];
    action /= sizes[k];
  }
}

static inline int %(name)s_valid(int state) { return state >= 0 && state < %(upper)s_STATES; }

/* the heaviest action, the first one where several are equal; -1 for no state */
static inline int %(name)s_best(int state) {
  if (!%(name)s_valid(state)) return -1;
  int best = 0;
  for (int i = 1; i < %(upper)s_ACTIONS; i++)
    if (%(name)s_weights[state][i] > %(name)s_weights[state][best]) best = i;
  return best;
}

"""

_C_DRAW = """/* an action drawn in proportion to weight; u is a random number in [0, 1); -1 for no state or no such u */
static inline int %(name)s_draw(int state, double u) {
  if (!%(name)s_valid(state) || !(u >= 0.0 && u < 1.0)) return -1;
  const double *weights = %(name)s_weights[state];
  double sum = 0.0;
  for (int i = 0; i < %(upper)s_ACTIONS; i++) sum += weights[i];
  if (sum <= 0.0) {
    int even = (int)(u * %(upper)s_ACTIONS);
    return even < %(upper)s_ACTIONS ? even : %(upper)s_ACTIONS - 1;
  }
  double target = u * sum, running = 0.0;
  for (int i = 0; i < %(upper)s_ACTIONS; i++) {
    running += weights[i];
    if (target < running) return i;
  }
  int last = %(upper)s_ACTIONS - 1;
  while (weights[last] <= 0.0) last--;
  return last;
}

"""

_PACKAGE_XML = """<?xml version="1.0"?>
<package format="3">
  <name>%(name)s</name>
  <version>0.1.0</version>
  <description>A policy of the task %(task)s, exported by tasklift %(version)s</description>
  <maintainer email="you@example.com">your name</maintainer>
  <license>your licence</license>
  <exec_depend>rclpy</exec_depend>
  <exec_depend>std_msgs</exec_depend>
  <export>
    <build_type>ament_python</build_type>
  </export>
</package>
"""

_SETUP_PY = """from setuptools import setup

setup(
    name="%(name)s",
    version="0.1.0",
    packages=["%(name)s"],
    data_files=[
        ("share/ament_index/resource_index/packages", ["resource/%(name)s"]),
        ("share/%(name)s", ["package.xml"]),
    ],
    install_requires=["setuptools"],
    zip_safe=True,
    entry_points={"console_scripts": ["node = %(name)s.node:main"]},
)
"""

_SETUP_CFG = """[develop]
script_dir=$base/lib/%(name)s
[install]
install_scripts=$base/lib/%(name)s
"""

_NODE_PY = '''"""A ROS 2 node that decides by the policy: states on ~/state, actions on ~/action, as JSON text."""

import json
import random

from %(name)s import policy


def answer(text, u=None):
    """Return the action, as JSON text, for a state as JSON text; ValueError says what is wrong with it."""
    inputs = json.loads(text)
    if not isinstance(inputs, dict):
        raise ValueError("expected a state as {name: value}")
    return json.dumps(policy.act(inputs, u))


def main():
    """Run the node until it is stopped. Its parameter `draw` (default false) draws in proportion to weight."""
    import rclpy
    from rclpy.node import Node
    from std_msgs.msg import String

    class PolicyNode(Node):
        def __init__(self):
            super().__init__("%(name)s")
            self.draw = self.declare_parameter("draw", False).value
            self.publisher = self.create_publisher(String, "~/action", 10)
            self.create_subscription(String, "~/state", self.on_state, 10)

        def on_state(self, message):
            try:
                self.publisher.publish(String(data=answer(message.data, random.random() if self.draw else None)))
            except (ValueError, TypeError) as error:  # no action for a state that is none
                self.get_logger().error("state refused: %%s" %% error)

    rclpy.init()
    node = PolicyNode()
    try:
        rclpy.spin(node)
    except KeyboardInterrupt:
        pass
    finally:
        node.destroy_node()
        rclpy.try_shutdown()


if __name__ == "__main__":
    main()
'''
