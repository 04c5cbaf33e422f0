"""Build the wheel and try it in empty environments: plain, with each extra alone, and with all of them.

``python tests/wheels.py`` tries every Python from 3.11 to 3.13 that is installed, plain and with the light extras.
``--extras torch,ray,all`` tries others, ``--pythons 3.13`` fewer Pythons.
"""

from __future__ import annotations

import argparse
import os
import shutil
import subprocess
import sys
import tempfile
from pathlib import Path

ROOT = Path(__file__).parents[1]

PLAIN = """
import warnings; warnings.simplefilter("error")
import tasklift as tl
hunt = tl.Mission(tl.generate(seed=7), team="10+5", hostiles=1)
print(tl.reinforce(hunt, tl.Policy.equal(hunt.task), trials=3))
"""
#: What shows that an extra does what it is for.
WORKS = {
    "plans": "from PIL import Image; Image.new('L', (80, 60), 255).save('a.png')\n"
    "from tasklift.plans.read import load_building\nimport yaml, skimage",
    "dxf": "import ezdxf, tasklift.plans.read.dxf",
    "gym": "import gymnasium, tasklift.envs.pettingzoo\nfrom tasklift.envs.gymnasium import make_environment\n"
    "make_environment('FrozenLake-v1', {})",
    "approx": "import tasklift as tl\nhunt = tl.Mission(tl.generate(seed=7), '10+5')\n"
    "print(tl.approximate(tl.Policy.equal(hunt.task), 'tree', max_leaves=4))",
    "parquet": "import pyarrow.parquet",
    "pandas": "import pandas",
    "ray": "import ray, tasklift.lab.ray",
    "torch": "import torch",
}


def run(command: list[str], folder: Path) -> str:
    """Run a command in a folder with nothing of ours on the path; say what it printed if it fails."""
    environment = {name: value for name, value in os.environ.items() if not name.startswith("PYTHON")}
    done = subprocess.run(command, cwd=folder, capture_output=True, text=True, check=False, env=environment)
    if done.returncode:
        raise SystemExit(f"{' '.join(command)}\n{done.stdout[-2000:]}{done.stderr[-4000:]}")
    return done.stdout


def attempt(python: str, extra: str, wheel: Path) -> str:
    """Install the wheel with an extra into an empty environment and use it."""
    with tempfile.TemporaryDirectory() as folder:
        home = Path(folder)
        run([python, "-m", "venv", "env"], home)
        binaries = home / "env" / "bin"
        named = f"{wheel}[{extra}]" if extra else str(wheel)
        run([str(binaries / "python"), "-m", "pip", "install", "--quiet", named], home)
        said = run([str(binaries / "python"), "-c", PLAIN], home)
        for name in WORKS if extra == "all" else [extra] if extra else []:
            run([str(binaries / "python"), "-c", WORKS[name]], home)
        run([str(binaries / "tasklift"), "map", "generate", "-o", "a.json", "--seed", "3"], home)
        run([str(binaries / "python"), "-m", "tasklift", "map", "check", "a.json"], home)
        return said.strip()


def main() -> None:
    """Build, then try every combination that was asked for."""
    asked = argparse.ArgumentParser(description=__doc__)
    asked.add_argument("--pythons", default="3.11,3.12,3.13")
    asked.add_argument("--extras", default="plans,dxf,gym,approx,parquet,pandas")
    options = asked.parse_args()
    dist = ROOT / "dist"
    shutil.rmtree(dist, ignore_errors=True)
    run([sys.executable, "-m", "pip", "wheel", "--quiet", "--no-deps", "--wheel-dir", str(dist), str(ROOT)], ROOT)
    (wheel,) = dist.glob("*.whl")
    print(f"{wheel.name}: {wheel.stat().st_size / 1000:.0f} kB")
    pythons = [name for version in options.pythons.split(",") if (name := shutil.which(f"python{version}"))]
    rows = set()
    for k, python in enumerate(pythons):
        works = subprocess.run([python, "--version"], capture_output=True, text=True, check=False)
        if works.returncode:
            continue
        for extra in ["", *(filter(None, options.extras.split(",")) if k == 0 else [])]:
            rows.add(attempt(python, extra, wheel))
            print(f"{works.stdout.strip()}, {extra or 'plain'}: works", flush=True)
    assert len(rows) == 1, f"the Pythons disagree: {rows}"


if __name__ == "__main__":
    main()
