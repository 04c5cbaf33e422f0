"""Damaged, hostile or absurd files end in one clear line.

2,000 mutated inputs a reader, 500 a format of maps and of edits, 700 certificates, 200 stores and specs of simplify;
`make fuzz` gives 100,000.
"""

from __future__ import annotations

import tempfile
from pathlib import Path

import pytest

import fuzz


@pytest.mark.parametrize("name", fuzz.READERS)
def test_mutated_files_are_read_and_used_or_refused_in_one_line(name: str) -> None:
    runs = 500 if name.startswith("map-") or name == "edits" else 2000  # a dozen formats: more would take minutes
    if name in ("store", "resume", "simplify"):
        runs = 200  # each is read in ten ways, or takes a world of Gymnasium's
    if name == "certificate":
        runs = 700  # each that is read plays its episodes, and few are
    with tempfile.TemporaryDirectory(dir=fuzz.MEMORY) as folder:
        figures = fuzz.fuzz(name, fuzz.READERS[name], Path(folder), range(runs))
    print(f"{name}: {figures}")
    assert figures.read + figures.refused == runs
    assert figures.read > 20
    assert figures.refused > 20
