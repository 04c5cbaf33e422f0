"""Machine code that was kept on disk is not used again once anything that was compiled in has changed."""

import ast
import importlib
import os
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

import tasklift

PACKAGE = Path(tasklift.__file__).parent


def imported(file: Path) -> set[Path]:
    """Return the files of the package that a file imports at its top, and what those import."""
    found: set[Path] = set()
    for node in ast.parse(file.read_text()).body:
        if isinstance(node, ast.ImportFrom) and (node.module or "").startswith("tasklift"):
            folder = PACKAGE.joinpath(*node.module.split(".")[1:])
            candidates = [folder.with_suffix(".py"), *(folder / f"{name.name}.py" for name in node.names)]
            found |= {path for path in candidates if path.exists()}
    for path in list(found):
        found |= imported(path)
    return found


@pytest.mark.parametrize("kernel", ["tasklift.building.kernel", "tasklift.learning.model_kernel"])
def test_all_that_a_kernel_imports_is_told_by_the_name(kernel):
    module = importlib.import_module(kernel)
    told = {Path(part.__file__) for part in module.COMPILED_IN}
    assert told == imported(Path(module.__file__)) - {PACKAGE / "compiled.py"}


def test_nothing_else_keeps_machine_code():
    assert [file.name for file in PACKAGE.rglob("*.py") if "cache=True" in file.read_text()] == ["compiled.py"]


@pytest.mark.parametrize(
    "asked",
    [
        "import tasklift.compiled, tasklift.building.inputs",
        "import tasklift as tl; tl.Mission(tl.generate(seed=7), '10+5').task",
        "from tasklift.plans.importing import import_map",
        "import tasklift.cli.main",
    ],
)
def test_numba_is_imported_only_to_simulate(asked):
    code = f"import sys; {asked}; assert 'numba' not in sys.modules"
    subprocess.run([sys.executable, "-c", code], check=True)


@pytest.mark.parametrize(
    ("changed", "before", "after", "asked"),
    [
        (
            "building/randomness.py",
            "0x9E3779B97F4A7C15",
            "0x9E3779B97F4A7C17",
            "import numpy as np; from tasklift.building.kernel import child_key; print(child_key(np.uint64(1), 2))",
        ),
        (
            "tasks/choice.py",
            "target = u * added",
            "target = (1.0 - u) * added",
            "import numpy as np; from tasklift.learning.model_kernel import choose\n"
            "numbers = np.array([1.0, 2.0, 3.0])\n"
            "settings = np.array([0.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0])\n"
            "print(choose(np.zeros((1, 3)), settings, 0, np.ones(3, np.bool_), 0.1, np.zeros((2, 3))))",
        ),
    ],
)
def test_a_change_in_another_file_has_the_code_compiled_anew(tmp_path, changed, before, after, asked):
    shutil.copytree(PACKAGE, tmp_path / "tasklift", ignore=shutil.ignore_patterns("__pycache__"))
    environment = os.environ | {"PYTHONPATH": str(tmp_path), "PYTHONDONTWRITEBYTECODE": "1"}
    environment.pop("NUMBA_CACHE_DIR", None)

    def answer() -> str:
        return subprocess.check_output([sys.executable, "-c", asked], env=environment, text=True)

    first = answer()
    assert answer() == first
    file = tmp_path / "tasklift" / changed
    assert before in file.read_text()
    file.write_text(file.read_text().replace(before, after))
    assert answer() != first
