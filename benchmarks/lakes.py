"""Measure the tables of docs/hazards.md: falls on two lakes, with a little knowledge, and behind a shield.

Run from the repository: ``python benchmarks/lakes.py``. The lakes and the learner are those of the page.
"""

from __future__ import annotations

import argparse
import re
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import gymnasium
import numpy as np

from tasklift import Curriculum, Guard, Run, Stage, Task, Variable, set_weight
from tasklift.envs.gymnasium import Event, Factored

PAGE = Path(__file__).parents[1] / "docs" / "hazards.md"
GIVES = (0, -6)
SAFE_STEPS, STEPS = 20_000, 105_600
#: Where each move leads: rows and columns further.
WAYS = {"left": (0, -1), "down": (1, 0), "right": (0, 1), "up": (-1, 0)}


def page() -> dict[str, Any]:
    """Run the first code of the page, up to what it shows, and return its names."""
    names: dict[str, Any] = {}
    code = re.findall(r"```python\n(.*?)```", PAGE.read_text(), re.DOTALL)[0]
    exec(code.partition("\nfor fall in")[0], names)
    return names


LAKES = page()


def curriculum(task: Task, simple: Task, worlds: Sequence[Any], **target: Any) -> Curriculum:
    """Return the lake without holes and then the one with them; of one world, that one alone."""
    stages = [Stage("no holes", simple, worlds[0], LAKES["learner"], steps=SAFE_STEPS)] if len(worlds) > 1 else []
    return Curriculum([*stages, Stage("holes", task, worlds[-1], LAKES["learner"], steps=STEPS, **target)])


def falls(plan: Curriculum, seeds: int) -> list[int]:
    """Return what each seed loses on the lake with holes."""
    return [int(plan.run(seed=seed).ledger.by_stage()["holes"]) for seed in range(seeds)]


def spread(values: Sequence[float]) -> str:
    return f"{np.mean(values):,.1f} ({min(values):,} to {max(values):,})"


def transfer(seeds: int) -> None:
    """Print falls from scratch and after the lake without holes, and what the guard says."""
    task, lake = LAKES["task"], LAKES["lake"]
    for gives in GIVES:
        both = [lake(gives, holes=False), lake(gives)]
        scratch, after = falls(curriculum(task, task, both[1:]), seeds), falls(curriculum(task, task, both), seeds)
        guarded = curriculum(task, task, both, guard=Guard("losses", share=0.2, window=100))
        said = [guarded.run(seed=seed).guards["holes"].verdict for seed in range(seeds)]
        print(f"a fall gives {gives}, {seeds} seeds: from scratch {spread(scratch)}, after no holes {spread(after)}, "
              f"more with {sum(a > b for a, b in zip(after, scratch, strict=True))} seeds; the guard says "
              f"{', '.join(f'{word} {said.count(word)}' for word in sorted(set(said)))}")  # fmt: skip


def seen(gives: float, holes: bool) -> Factored:
    """Return the lake in which a learner also sees the holes around it."""
    rows = LAKES["MAP"] if holes else [row.replace("H", "F") for row in LAKES["MAP"]]

    def observe(place: int) -> dict[str, int]:
        row, col = divmod(place, 10)
        found = {"row": row, "col": col}
        for way, (down, right) in WAYS.items():
            r, c = row + down, col + right
            found[f"hole {way}"] = int(0 <= r < 10 and 0 <= c < 10 and rows[r][c] == "H")
        return found

    def lost(event: Event) -> bool:
        return rows[event.after // 10][event.after % 10] == "H"

    env = gymnasium.make(
        "FrozenLake-v1", desc=rows, success_rate=0.8, reward_schedule=(6, gives, -0.01), max_episode_steps=200
    )
    return Factored(env, with_holes(), observe=observe, loss=lost)


def with_holes() -> Task:
    task = LAKES["task"]
    return Task("lake", (*task.inputs, *(Variable(f"hole {way}", range(2)) for way in WAYS)), task.outputs)


def knowledge(seeds: int) -> None:
    """Print falls with prior knowledge about holes, with and without the simple task."""
    task = with_holes()
    simple = task.simplify(fix={f"hole {way}": 0 for way in WAYS})
    prior = [set_weight(-6, when={f"hole {way}": 1, "move": way}) for way in WAYS]
    for gives in GIVES:
        worlds = [seen(gives, holes=False).model(), seen(gives, holes=True).model()]
        for name, used, knows in (
            ("from scratch", worlds[1:], []),
            ("copy", worlds, []),
            ("the prior", worlds[1:], prior),
            ("copy + prior", worlds, prior),
        ):
            print(f"a fall gives {gives}, {seeds} seeds: {name} "
                  f"{spread(falls(curriculum(task, simple, used, prior=knows), seeds))}", flush=True)  # fmt: skip


def shield(seeds: int) -> None:
    """Print failures behind shields of several risks, on both lakes and on the cliff."""
    ways = Variable("move", ("up", "right", "down", "left"))
    cliff = Task("cliff", (Variable("row", range(4)), Variable("col", range(12))), (ways,))
    env = gymnasium.make("CliffWalking-v1", is_slippery=True)
    worlds = {f"a fall gives {gives}": LAKES["lake"](gives) for gives in GIVES}
    worlds["the cliff"] = Factored(env, cliff, limit=200, loss=lambda event: event.reward == -100).model()
    for name, world in worlds.items():
        for risk in (None, 0.1, 0.01, 0.001):
            shielded, learner = world if risk is None else world.shielded(risk=risk), LAKES["learner"]
            outcomes = [
                learner.learn(shielded, learner.start(world.task), Run(steps=STEPS, seed=seed)).outcomes
                for seed in range(seeds)
            ]
            lost = spread([int(found.losses.sum()) for found in outcomes])
            late = np.mean([found.success[-200:].mean() for found in outcomes])
            behind = "no shield" if risk is None else f"shield, risk {risk}"
            print(f"{name}, {behind}, {seeds} seeds: {lost}, late success {late:.2f}", flush=True)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--seeds", type=int, nargs=3, default=[24, 12, 6], help="of the three tables")
    first, second, third = parser.parse_args().seeds
    transfer(first)
    knowledge(second)
    shield(third)


if __name__ == "__main__":
    main()
