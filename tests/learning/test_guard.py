"""The guard on two real cases: the frozen lake where the hazard's reward decides, and the building search."""

from __future__ import annotations

from collections import Counter

import numpy as np
import pytest

import tasklift as tl
from tasklift.building import SCOUT, WEAPON, Mission, generate
from tasklift.envs.gymnasium import Factored
from tasklift.learning.curriculum import Curriculum
from tasklift.learning.guard import Guard
from tasklift.learning.model import Model
from tasklift.learning.stage import Stage
from tasklift.learning.values import ValueLearning, learn_values
from tasklift.tasks.task import Signal, Task, Variable

gymnasium = pytest.importorskip("gymnasium")

# Turchetta et al., "Safe Reinforcement Learning via Curriculum Induction" (NeurIPS 2020): the 10x10 lake
LAKE = [
    "SFFFFFFFFF",
    "FFFFFFFFFF",
    "HFFFFFFFFF",
    "FFHFFFFFFF",
    "HFFFFHFFFF",
    "FFHFFFHFFF",
    "HFFFFHFFFF",
    "FFHFFFFFFF",
    "HFFFFFFFFF",
    "FFFGFFFFFF",
]
TASK = Task(
    "lake",
    (Variable("row", range(10)), Variable("col", range(10))),
    (Variable("move", ("left", "down", "right", "up")),),
)
Q = ValueLearning("q-learning", step_size=0.1, epsilon=0.1, discount=0.99)
STEPS, SAFE_STEPS = 105_600, 20_000


def lake(hole: float, holes: bool = True) -> Model:
    rows = LAKE if holes else [row.replace("H", "F") for row in LAKE]
    env = gymnasium.make(
        "FrozenLake-v1", desc=rows, success_rate=0.8, reward_schedule=(6, hole, -0.01), max_episode_steps=200
    )

    def fell(event) -> bool:
        return rows[event.after // 10][event.after % 10] == "H"

    return Factored(env, TASK, loss=fell).model()


def falls(hole: float, seeds: int) -> tuple[np.ndarray, np.ndarray]:
    """Falls within 105,600 steps: from scratch, and after 20,000 steps on the lake without holes."""
    risky, safe = lake(hole), lake(hole, holes=False)
    scratch, lifted = [], []
    for seed in range(seeds):
        scratch.append(learn_values(risky, steps=STEPS, seed=seed, learning=Q).outcomes.losses.sum())
        source = learn_values(safe, steps=SAFE_STEPS, seed=seed, stage=1, learning=Q)
        assert source.outcomes.losses.sum() == 0
        lifted.append(learn_values(risky, source.policy, steps=STEPS, seed=seed, learning=Q).outcomes.losses.sum())
    return np.array(scratch), np.array(lifted)


def verdicts(hole: float, seeds: int, guard: Guard) -> tuple[Counter, list[int]]:
    risky, safe = lake(hole), lake(hole, holes=False)
    stages = [
        Stage("no holes", TASK, safe, Q, steps=SAFE_STEPS),
        Stage("holes", TASK, risky, Q, steps=STEPS, guard=guard),
    ]
    runs = [Curriculum(stages).run(seed) for seed in range(seeds)]
    return Counter(run.guards["holes"].verdict for run in runs), [run.ledger.total for run in runs]


def test_the_lake_itself() -> None:
    model = lake(0)
    assert model.optimum(steps=200) == pytest.approx(5.726, abs=5e-4)
    assert model.optimum(reward=model.success, steps=200) > 0.999999


def test_where_falling_costs_nothing_transfer_looks_miraculous() -> None:
    # the pilot's figures: some 33,500 falls from scratch, about 1,500 after the lake without holes
    scratch, lifted = falls(hole=0, seeds=2)
    assert scratch.mean() == pytest.approx(33_500, rel=0.05)
    assert lifted.mean() == pytest.approx(1_500, rel=0.4)
    told, _ = verdicts(hole=0, seeds=2, guard=Guard("losses", share=0.1, window=100))
    assert told == {"helps": 2}


def test_where_falling_is_punished_transfer_hurts() -> None:
    # the pilot's figures: about 340 falls from scratch, about 1,060 after the lake without holes; single runs from
    # scratch either settle below 250 or, at the wrong end of the lake, near 1,000, so the mean varies
    scratch, lifted = falls(hole=-6, seeds=16)
    assert 200 < scratch.mean() < 750
    assert 900 < lifted.mean() < 1_400
    assert np.median(lifted) > 2 * np.median(scratch)
    told, total = verdicts(hole=-6, seeds=12, guard=Guard("losses", share=0.2, window=100))
    assert told["hurts"] >= 9
    assert told["helps"] <= 1
    # falling back saves losses against carrying on with what hurts, the control's own losses included
    assert np.mean(total) < lifted.mean()


MOVES = ("left", "down", "right", "up")
AROUND = ((0, -1), (1, 0), (0, 1), (-1, 0))
SIGHTED = Task(
    "sighted lake",
    (*TASK.inputs, *(Variable(f"hole {move}", (0, 1)) for move in MOVES)),
    TASK.outputs,
)


def sighted(hole: float, holes: bool = True) -> Model:
    """The lake, factored into the place and the neighbouring hazards."""
    rows = LAKE if holes else [row.replace("H", "F") for row in LAKE]

    def is_hole(row: int, col: int) -> bool:
        return 0 <= row < 10 and 0 <= col < 10 and rows[row][col] == "H"

    def observe(place) -> dict:
        row, col = divmod(int(place), 10)
        around = {f"hole {m}": int(is_hole(row + y, col + x)) for m, (y, x) in zip(MOVES, AROUND, strict=True)}
        return {"row": row, "col": col} | around

    env = gymnasium.make(
        "FrozenLake-v1", desc=rows, success_rate=0.8, reward_schedule=(6, hole, -0.01), max_episode_steps=200
    )
    return Factored(env, SIGHTED, observe=observe, loss=lambda e: is_hole(*divmod(int(e.after), 10))).model()


@pytest.mark.slow
def test_on_the_punished_lake_the_prior_is_what_helps() -> None:
    # docs/hazards.md has the figures of 12 seeds
    calm = SIGHTED.simplify(fix={f"hole {move}": 0 for move in MOVES})
    told = [tl.set_weight(-6, when={f"hole {move}": 1, "move": move}) for move in MOVES]
    risky, safe = sighted(-6), sighted(-6, holes=False)
    lost: dict[str, list[int]] = {}
    for seed in range(12):
        v = learn_values(safe, task=calm, steps=SAFE_STEPS, seed=seed, stage=1, learning=Q).policy
        arms = {
            "scratch": Q.start(SIGHTED),
            "copy": v.extend(SIGHTED),
            "prior": Q.start(SIGHTED).extend(SIGHTED, told),
            "copy+prior": v.extend(SIGHTED, told),
        }
        for name, start in arms.items():
            outcomes = learn_values(risky, start, steps=STEPS, seed=seed, learning=Q).outcomes
            lost.setdefault(name, []).append(int(outcomes.losses.sum()))
    mean = {name: np.mean(losses) for name, losses in lost.items()}
    assert mean["prior"] < 0.8 * mean["scratch"]
    assert mean["copy"] > 1.4 * mean["scratch"]
    assert mean["copy+prior"] > 1.4 * mean["scratch"]


def test_pure_copying_in_the_building_search_is_seen_to_hurt() -> None:
    # V punishes every stop, and T inherits a reluctance to stop where stopping saves robots
    told: Counter = Counter()
    settings = tl.Reinforcement(selection="pseudo-random", q=0.9)
    for seed in range(6):
        hunt = Mission(generate(seed=seed), team={SCOUT: 10, WEAPON: 5}, hostiles=1)
        simple = hunt.task.simplify(fix={"DL": 0, "GL": 0}, signals=[Signal(-0.2, {"MV": 0})], time_reward=0.2)
        guard = Guard("losses", share=0.25, bound=15)
        stages = [
            Stage("V", simple, hunt.without_hostiles(), tl.Sweep()),
            Stage("T", hunt.task, hunt, settings, trials=400, guard=guard),
        ]
        run = Curriculum(stages).run(seed)
        assert run.ledger.by_stage()["V"] == 0
        told[run.guards["T"].verdict] += 1
    assert told["hurts"] >= 5
    assert told["helps"] == 0
