"""The guide on networks is true: its code runs from top to bottom."""

from __future__ import annotations

import re
from pathlib import Path

import pytest

pytest.importorskip("torch")
pytest.importorskip("stable_baselines3")


@pytest.mark.filterwarnings("ignore")  # other people's
def test_the_code_of_the_guide_runs() -> None:
    page = Path(__file__).parents[2] / "docs" / "networks.md"
    blocks = re.findall(r"```python\n(.*?)```", page.read_text(), re.DOTALL)
    assert blocks
    exec(compile("\n".join(blocks), "docs/networks.md", "exec"), {})
