"""Transfer in reinforcement learning when failures are expensive.

Train a policy on a safe version of a task, transfer it to the dangerous one, and test whether that saved failures.
Everything that users need by name is here: ``tl.Task``, ``tl.Policy``, ``tl.Mission``, ``tl.Curriculum``, …. Type
checkers read the same names in ``__init__.pyi``.
"""

from __future__ import annotations

from importlib import import_module as _import_module

__version__ = "0.1.0"

_HOMES = {
    "errors": ("TaskliftError",),
    "tasks.task": ("Signal", "Task", "Variable"),
    "tasks.policy": ("Policy", "forget", "invert", "scale", "set_weight", "swap"),
    "learning.worlds": ("Outcomes", "Step", "StepOutcomes", "Steps", "Trials", "joined"),
    "learning.chances": ("Chances",),
    "learning.learner": ("Curve", "InTurn", "Learner", "Run"),
    "learning.reinforcement": ("Fixed", "Reinforcement", "StepTrials", "Sweep", "reinforce", "sweep"),
    "learning.search": ("PolicySearch",),
    "learning.model": ("Model",),
    "learning.values": ("ValueLearning", "evaluate", "learn_values"),
    "learning.guard": ("Guard", "Watch"),
    "learning.stage": ("Stage",),
    "learning.ledger": ("Ledger",),
    "learning.curriculum": ("Curriculum",),
    "learning.compare": ("compare",),
    "learning.approx": ("approximate", "fidelity", "learn_approximate"),
    "networks.extend": ("extend_module",),
    "envs.ids": ("make",),
    "building.graph": ("Building",),
    "building.generate": ("generate",),
    "building.mission": ("Mission",),
    "building.missions": ("Missions",),
    "building.reading": ("COHESIVE", "SCATTERED", "Reading"),
    "building.team": ("SCOUT", "WEAPON", "Kind"),
}
_HOME_OF = {name: home for home, names in _HOMES.items() for name in names}

__all__ = ["__version__", *sorted(_HOME_OF)]


def __getattr__(name: str) -> object:
    # names are found on first use, so that `import tasklift` and `tasklift --help` load nothing they do not
    # need
    if name in _HOME_OF:
        return getattr(_import_module(f"tasklift.{_HOME_OF[name]}"), name)
    raise AttributeError(f"module 'tasklift' has no attribute {name!r}")


def __dir__() -> list[str]:
    return sorted(__all__)
