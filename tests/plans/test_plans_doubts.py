"""Doubts where they hurt: wrong scales, inverted pictures, dim greys; none about buildings that were generated."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from PIL import Image
from test_plans_rooms import drawn, office

from tasklift.building.generate import generate
from tasklift.errors import TaskliftError
from tasklift.plans.check import check
from tasklift.plans.extract.building import extract
from tasklift.plans.importing import import_map


@pytest.mark.parametrize("seed", range(10))
def test_a_generated_building_has_none(seed: int) -> None:
    assert check(generate(seed=seed)).warnings == ()


@pytest.mark.parametrize("times", [5, 10])
def test_a_resolution_that_is_too_large(times: int) -> None:
    plan = drawn(office(), 0)
    assert not any("resolution" in doubt for doubt in extract(plan)[1])
    _, doubts = extract(replace(plan, resolution_m=plan.resolution_m * times))
    assert any("is the resolution" in doubt for doubt in doubts)


def write(folder: Path, grey: np.ndarray, **fields: object) -> Path:
    Image.fromarray(grey.astype(np.uint8)).save(folder / "m.png")
    values = {"image": "m.png", "resolution": 0.05, "origin": "[0, 0, 0]", "negate": 0}
    values |= {"occupied_thresh": 0.65, "free_thresh": 0.196} | fields
    (folder / "m.yaml").write_text("".join(f"{key}: {value}\n" for key, value in values.items()))
    return folder / "m.yaml"


def test_an_inverted_picture_is_asked_about(tmp_path: Path) -> None:
    grey = drawn(office(), 0).grey
    with pytest.raises(TaskliftError, match=r"inverted \('negate: 1'\)") as caught:
        import_map(write(tmp_path, np.where(grey == 254, 0, np.where(grey == 0, 254, 205))))
    assert "\n" not in str(caught.value)


def test_a_grey_that_is_just_not_free_is_named(tmp_path: Path) -> None:
    grey = drawn(office(), 0, outside=128).grey
    grey = np.where(grey == 254, 200, grey)
    grey[0, :40] = 254  # what little is free does not help
    path = write(tmp_path, grey)
    with pytest.raises(TaskliftError, match=r"commonest light grey is 200 \(p = 0\.216"):
        import_map(path)


def test_floor_left_out_is_asked_about() -> None:
    plan = drawn(office(), 0)
    free = plan.free.copy()
    door = plan.to_pixels(np.array([[2.0, 2.3]]))[0].astype(int)  # the first room's door is shut
    free[door[0] - 1 : door[0] + 1, door[1] - 15 : door[1] + 15] = False
    building, doubts = extract(replace(plan, free=free))
    assert any("are doors shut, or drawn as lines?" in doubt for doubt in doubts)
    assert (building.kind == 0).sum() == 5
