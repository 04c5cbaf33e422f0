"""Measure and draw the README's first picture: robots lost in 400 dangerous episodes, on 12 buildings.

Run from the repository: ``python docs/pictures/headline.py``. It takes 75 seconds of processor time. Both teams meet
the same 400 episodes with one hidden hostile, which hides afresh in each. *From scratch* is the strongest learner
without transfer: punished for every loss, greedy in nine of ten decisions. *Practised first* is what ``tasklift train``
hands over.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np

import tasklift as tl
from tasklift.building import Mission, generate
from tasklift.learning.reinforcement import Reinforcement
from tasklift.studies.arms import Setup, searching
from tasklift.style import GROUND, SERIES

BUILDINGS = range(9100, 9112)  # those of benchmarks/search.py: no choice was tuned on them
EPISODES = 400
HERE = Path(__file__).parent


def losses(seed: int) -> tuple[int, int]:
    """Return robots lost on one building: from scratch, practised first."""
    building = generate(21, 25, 6, doors=5, seed=seed)
    mission = Mission(building, "10+5", 1).with_reading(relocate=True)
    learner = Reinforcement(loss_signal=-0.5, selection="pseudo-random", q=0.9)
    scratch = tl.reinforce(
        mission, tl.Policy.equal(mission.task), trials=EPISODES, seed=0, reinforcement=learner
    ).outcomes
    policy = tl.Curriculum(searching(Setup(mission)).stages[:-1], block=None).run(seed=0).policy
    played = mission.evaluate(policy, EPISODES, seed=0)
    for name, outcomes in (("from scratch", scratch), ("practised first", played)):
        print(f"{seed} {name}: lost {outcomes.losses.sum()}, solved {outcomes.success.mean():.1%}")
    return int(scratch.losses.sum()), int(played.losses.sum())


def bars(scratch: float, practised: float) -> str:
    """Return the picture: two bars, each with its number at its end."""
    ink, soft, paper = (GROUND[name][0] for name in ("ink", "soft", "paper"))
    rows = [
        ("learning from scratch", scratch, SERIES["blue"][0]),
        ("practised with harmless hostiles first", practised, SERIES["green"][0]),
    ]
    title = f"Robots lost in {EPISODES} dangerous episodes"
    parts = [
        '<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 760 190" role="img" '
        'font-family="system-ui, Segoe UI, Helvetica, Arial, sans-serif">',
        f"<title>{title}: {scratch:.0f} from scratch, {practised:.0f} practised first</title>",
        f'<rect width="760" height="190" rx="8" fill="{paper}"/>',
        f'<text x="24" y="36" font-size="19" font-weight="600" fill="{ink}">{title}</text>',
    ]
    for i, (name, value, colour) in enumerate(rows):
        top, width = 56 + 56 * i, max(3.0, 620 * value / scratch)
        number = f'x="{34 + width:.1f}" y="{top + 38}" font-size="20" font-weight="700"'
        parts += [
            f'<text x="24" y="{top + 12}" font-size="15" fill="{ink}">{name}</text>',
            f'<rect x="24" y="{top + 20}" width="{width:.1f}" height="22" rx="3" fill="{colour}"/>',
            f'<text {number} fill="{ink}">{value:.0f}</text>',
        ]
    note = (
        f"Mean of {len(BUILDINGS)} buildings; 10 scouts, 5 weapon robots, one hidden hostile. "
        "Practice: 36,000 harmless episodes, 9 s."
    )
    parts += [f'<text x="24" y="178" font-size="12.5" fill="{soft}">{note}</text>', "</svg>", ""]
    return "\n".join(parts)


def main() -> None:
    """Measure, print, draw."""
    found = np.array([losses(seed) for seed in BUILDINGS], dtype=float)
    print(f"mean: from scratch {found[:, 0].mean():.0f}, practised first {found[:, 1].mean():.0f}")
    (HERE / "headline.svg").write_text(bars(*found.mean(axis=0)), encoding="utf-8")


if __name__ == "__main__":
    main()
