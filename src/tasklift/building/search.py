"""The paper's two tasks in the building, T (Table I) and V (Table II), and where hostiles may be hidden."""

from __future__ import annotations

from functools import cache

from tasklift.building.graph import DOOR, Building
from tasklift.building.variables import OUTPUTS, TABLE_I, TABLE_I_OUTPUTS, Sensor, chosen_inputs
from tasklift.tasks.task import Signal, Task

#: The feature class that hides hostiles (the paper's EnemyFTR; Figure 5 shows it at 4).
ENEMY_FEATURE = DOOR

#: Table III, the signals of the simplified task V.
SEARCH_SIGNALS = (Signal(-0.2, {"MV": 0}, "stopped while mapping"),)
SEARCH_TIME_REWARD = 0.2


@cache
def search_and_clear(
    inputs: tuple[Sensor, ...] = chosen_inputs(TABLE_I), outputs: tuple[str, ...] = TABLE_I_OUTPUTS
) -> Task:
    """Return the paper's task T (Table I, 90 × 44 weights) with its signals (Table III), or one with other variables.

    Two misprints of Table III are mended. Its ``WPN ≥ 2`` and ``WPN = 0`` mean nWPN, since the output WPN has no
    such values. Its last row, described as "suspected enemy at a different feature", needs FTR ≠ enemy.

    Parameters
    ----------
    inputs : tuple of Sensor
        The task's inputs. A signal or an impossible output that depends on an input which is not among them is left
        out.
    outputs : tuple of str
        The task's outputs.

    Examples
    --------
    >>> search_and_clear().shape
    (90, 44)
    """
    elsewhere = [ftr for ftr in range(1, 6) if ftr != ENEMY_FEATURE]
    names = {sensor.name for sensor in inputs} | set(outputs)
    signals = (
        Signal(-0.1, {"MV": 0, "nWPN": 2}, "never stop when enough weapon robots"),
        Signal(+0.1, {"MV": 0, "nWPN": 0, "FTR": ENEMY_FEATURE}, "stopped near a correct feature"),
        Signal(-0.1, {"MV": 0, "FTR": elsewhere}, "suspected enemy at a different feature"),
    )
    impossible = ({"WPN": 1, "nWPN": 0},)
    return Task(
        name="search and clear",
        inputs=tuple(sensor.variable for sensor in inputs),
        outputs=tuple(OUTPUTS[name] for name in outputs),
        signals=tuple(signal for signal in signals if names.issuperset(signal.when)),
        impossible=tuple(condition for condition in impossible if names.issuperset(condition)),
        impossible_signal=-0.5,
        time_reward=0.1,
    )


def search_only(task: Task) -> Task:
    """Return the paper's task V (Table II, 15 × 44 weights): ``task`` with no danger and no goal, where it has them.

    Examples
    --------
    >>> search_only(search_and_clear()).shape
    (15, 44)
    """
    safe = {variable.name: 0 for variable in task.inputs if variable.name in ("DL", "GL")}
    return task.simplify(fix=safe, name="search", signals=SEARCH_SIGNALS, time_reward=SEARCH_TIME_REWARD)


def hostile_candidates(building: Building) -> list[int]:
    """Return the doors that are not next to the start, ascending: where hostiles may be hidden (rule 14).

    In a building without doors, these are all its features that are not next to the start.
    """
    start, features = building.start, building.feature_class
    beside = {int(v) for v in building.neighbour[building.indptr[start] : building.indptr[start + 1]]}
    hides = features == ENEMY_FEATURE if (features == ENEMY_FEATURE).any() else features > 1
    return [node for node in range(building.n_nodes) if hides[node] and node not in beside and node != start]
