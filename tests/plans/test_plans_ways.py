"""Ways between rooms are as long as the shortest free ones, though corridors run along axes."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from click.testing import CliRunner
from test_plans_rooms import drawn, office

from tasklift.building.generate import generate
from tasklift.cli.plans import check_command
from tasklift.plans.exporting import export
from tasklift.plans.extract.building import extract
from tasklift.plans.extract.lengths import pulled_length
from tasklift.plans.importing import import_map
from tasklift.plans.raster import rasterise
from tasklift.plans.ways import compare_ways


@pytest.mark.parametrize("turn", [0, 38])
@pytest.mark.parametrize("corridor", [2.0, 3.0])
def test_ways_between_the_rooms_of_an_office(turn: float, corridor: float) -> None:
    plan = drawn(office(rooms=5, corridor_m=corridor), turn)
    building, _ = extract(plan)
    found = compare_ways(building, plan)
    assert (found.pairs, found.rooms) == (45, 10)
    assert abs(found.median) <= 0.05
    assert found.p90 <= 0.15


@pytest.mark.parametrize("seed", range(3))
def test_ways_of_drawn_buildings(seed: int) -> None:
    plan = rasterise(generate(seed=seed))
    building, _ = extract(plan)
    found = compare_ways(building, plan)
    assert abs(found.median) <= 0.05
    assert found.p90 <= 0.15


def test_a_line_is_pulled_around_a_corner() -> None:
    free = np.ones((60, 60), bool)
    free[:40, 20:40] = False
    line = np.array([[5, 5], [55, 5], [55, 55], [5, 55]], float)
    shortest = 2 * np.hypot(35, 14.5) + 20
    assert shortest - 2 <= pulled_length(line, free, 0.1) <= 1.06 * shortest


def test_check_prints_the_comparison(tmp_path: Path) -> None:
    export(generate(seed=3), tmp_path / "three.yaml")
    import_map(tmp_path / "three.yaml", tmp_path / "found.json")
    result = CliRunner().invoke(check_command, [str(tmp_path / "found.json")])
    assert result.exit_code == 0
    assert "15 pairs of 6 rooms" in result.output
    generate(seed=3).save(tmp_path / "made.json")
    assert "pairs of" not in CliRunner().invoke(check_command, [str(tmp_path / "made.json")]).output
