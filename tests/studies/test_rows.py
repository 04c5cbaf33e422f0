"""Rows are what they were before the studies became lists of curricula: value by value, to the last bit.

The digests cover what rows held then. What cells keep beside that today is left out here: the weights of CA are kept
of every arm that learns V, where only ``copy`` had them; and the multiverse no longer rounds its mean weights to 32
bits. The expert's digests were recorded anew when the reference became the best of a small family.
"""

from __future__ import annotations

import numpy as np
import pytest

from row_digests import RECORDED, digest
from tasklift.lab import FILE_NAME, Store, run
from tasklift.studies.arms import PAPER
from tasklift.studies.drills import study as drills
from tasklift.studies.multiverse.study import draw
from tasklift.studies.multiverse.study import study as multiverse
from tasklift.studies.paper import survey
from tasklift.studies.paper.reproduce import study as reproduce
from tasklift.studies.study import generated


def differing(section, plan, cells):
    found = []
    for cell in cells:
        result = plan.work(cell)
        attachments = dict(result.attachments)
        attachments.pop("ca_steps", None)
        if section != "reproduce" or cell["arm"] != "copy":
            attachments.pop("ca_weights", None)
        if section == "multiverse":
            attachments["move_weights"] = attachments["move_weights"].astype(np.float32)
        name = "/".join(cell.values)
        if digest(result.stages, attachments) != RECORDED[section][name]:
            found.append(name)
    return found


def test_reproduce():
    plan = reproduce(maps=2, seeds=2, trials=100, arms=[arm.slug for arm in PAPER], survey=2)
    cells = [cell for cell in plan.cells() if cell["arm"] not in ("v", "searched")]
    assert len(cells) == len(RECORDED["reproduce"])
    assert differing("reproduce", plan, cells) == []


def test_drills():
    plan = drills.study(maps=1, seeds=2, hostiles=(1, 3))
    assert len(plan.cells()) == len(RECORDED["drills"])
    assert differing("drills", plan, plan.cells()) == []


def test_multiverse():
    plan = multiverse(generated(range(4)), draw(4, 0), seeds=5, trials=100)
    assert len(plan.cells()) == len(RECORDED["multiverse"])
    assert differing("multiverse", plan, plan.cells()) == []


@pytest.mark.slow
def test_choosing():
    plan = drills.choosing()
    assert differing("choosing", plan, plan.cells()) == []


def test_a_sample_of_choosing():
    plan = drills.choosing()
    assert len(plan.cells()) == len(RECORDED["choosing"])
    assert differing("choosing", plan, plan.cells()[::24]) == []


def test_survey(tmp_path):
    plan = survey.study(4, seeds=4, shown=6)
    with Store.open(tmp_path / FILE_NAME, plan.spec("survey")) as store:
        run(store, plan.cells(), plan.work)
        surveys = survey.read(store, plan)
        run(store, survey.further(plan, surveys), plan.work)
        found = {}
        for condition, of_all in survey.read(store, plan).items():
            for name, of in of_all.maps.items():
                rows = {"survey": {"seeds": of.seeds, "weights": of.weights, "steps": of.steps}}
                found[f"{condition}/{name}"] = digest(rows)
    assert found == RECORDED["survey"]
