"""Small tasks whose best simplification is known by construction, and how often the search for it is right.

``python tests/planted.py --tasks 50`` prints the share of right answers for each kind of task. In all of them a robot
drives along an aisle. The signal, at even places one way and at odd places the other, says whether driving on crashes.
The colour of the wall changes at random.

- ``independent``: the colour means nothing. Leaving it out is right, since one experience then counts for all colours.
- ``coupled``: the colour decides as well which signal is dangerous. Leaving anything out is wrong.
- ``decoy``: a switch makes crashes pay. What is learned there is wrong on the task.
- ``nothing``: the colour means nothing, but has one value; there is nothing to leave out that is not needed.
"""

from __future__ import annotations

import argparse
import sys
from pathlib import Path
from typing import Any

import numpy as np

from tasklift import Model, Task, Variable
from tasklift.studies.simplify.answer import Answer, answer_of
from tasklift.studies.simplify.search import SimplifyStudy

KINDS = ("independent", "coupled", "decoy", "nothing")


def make(kind: str, number: int, bribe: bool = False) -> Model:
    """Return task ``number`` of a kind; ``bribe`` is the decoy's switch."""
    rng = np.random.default_rng([KINDS.index(kind), number])
    places = int(rng.integers(3, 6))
    colours = int(rng.integers(5, 9)) if kind in ("independent", "decoy") else 2 if kind == "coupled" else 1
    task = Task(
        "aisle",
        (Variable("place", range(places)), Variable("signal", (0, 1)), Variable("colour", range(colours))),
        (Variable("drive", (0, 1)),),
    )
    ahead = [
        (0.5 / colours, {"signal": signal, "colour": colour})
        for signal in (0, 1)
        for colour in range(colours)
    ]

    def drive(state: dict[str, Any], output: dict[str, Any]) -> list[tuple[Any, ...]]:
        dangerous = state["signal"] == (state["place"] + (state["colour"] if kind == "coupled" else 0)) % 2
        crash = output["drive"] == 1 and dangerous
        place = 0 if crash else state["place"] + output["drive"]
        arrived = place == places
        reward = (3.0 if bribe else -6.0) if crash else -1.0
        there = 0 if arrived else place
        return [(p, {"place": there, **seen}, reward, arrived, int(crash), arrived) for p, seen in ahead]

    return Model.from_function(task, drive, start=[(p, {"place": 0, **seen}) for p, seen in ahead], limit=60)


def document(kind: str, number: int) -> dict[str, Any]:
    """Return the spec of a task, as :func:`tasklift.studies.spec_file.read_spec` would."""
    switches = [{"name": "bribe", "options": {"bribe": True}, "harmless": True}] if kind == "decoy" else []
    return {
        "name": f"{kind} {number}",
        "environment": {"python": "planted:make", "options": {"kind": kind, "number": number}},
        "learner": {"rule": "q-learning", "step_size": 0.2, "epsilon": 0.1, "discount": 1.0},
        "stages": [{"name": "aisle", "trials": 120}],
        "simplify": {"trials": 40, "switches": switches, "stages": 2, "seeds": 30},
    }


def answer(kind: str, number: int, folder: Path) -> Answer:
    """Search for the simplification of a task."""
    return answer_of(SimplifyStudy(document(kind, number), Path(__file__).parent), folder)


def right(kind: str, found: Answer) -> bool:
    """Return whether the answer is the planted one."""
    words = None if found.best is None else found.best.words
    return words == ("without colour" if kind in ("independent", "decoy") else None)


def main() -> None:
    """Print the shares."""
    import tempfile

    asked = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    asked.add_argument("--tasks", type=int, default=50)
    asked.add_argument("--kinds", default=",".join(KINDS))
    options = asked.parse_args()
    for kind in options.kinds.split(","):
        said: dict[str, int] = {}
        good = 0
        for number in range(options.tasks):
            with tempfile.TemporaryDirectory() as folder:
                found = answer(kind, number, Path(folder))
            good += right(kind, found)
            words = "nothing" if found.best is None else found.best.words
            said[words] = said.get(words, 0) + 1
        print(f"{kind}: right in {good} of {options.tasks}; {said}", flush=True)


if __name__ == "__main__":
    sys.exit(main())
