"""The documentation is true: its code runs, and its rules, options and links fit the code."""

from __future__ import annotations

import ast
import dataclasses
import re
import sys
from itertools import pairwise
from pathlib import Path

import pytest

import tasklift
from tasklift.building.reading import Reading
from tasklift.learning.reinforcement import Reinforcement
from tasklift.studies.arms import PAPER
from tasklift.studies.claims import CLAIMS
from tasklift.studies.study import GREEDY_TRIALS

ROOT = Path(__file__).parents[2]
DOCS = ROOT / "docs"
#: Written by docs/theme/hooks.py when the site is built, whose strict build checks links to them.
GENERATED = re.compile(
    r"(\.\./)?(replays/\w+\.html|reference/(commands|names)\.md|changelog\.md|contributing\.md)$"
)


@pytest.mark.parametrize("page", ["method", "simulator", "experiments", "watch", "extending", "learners", "robot"])
def test_code_blocks_run_from_top_to_bottom_and_print_what_the_page_says(page, tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    text = (DOCS / f"{page}.md").read_text()
    blocks = re.findall(r"```python\n(.*?)```", text, re.DOTALL)
    assert blocks
    exec(compile("\n".join(blocks), f"docs/{page}.md", "exec"), {})
    printed = capsys.readouterr().out
    for says in re.findall(r"```text\n(.*?)```", text, re.DOTALL):
        assert says in printed


def test_the_method_page_shows_what_its_first_blocks_print(tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    text = (DOCS / "method.md").read_text().split("## Learn, on the paper's world")[0]
    code = "\n".join(re.findall(r"```python\n(.*?)```", text, re.DOTALL))
    exec(compile(code, "docs/method.md", "exec"), {})
    printed = capsys.readouterr().out.splitlines()
    assert printed
    for line in printed:
        assert line in text, f"docs/method.md does not show {line!r}"


def test_the_buildings_and_policies_of_the_pages_are_read(tmp_path):
    from tasklift.building import Building

    written = re.findall(r"```json\n(.*?)```", (DOCS / "simulator.md").read_text(), re.DOTALL)
    for i, text in enumerate(written):
        path = tmp_path / f"{i}.json"
        path.write_text(text)
        assert Building.load(path).n_nodes == 3


def test_the_reading_has_rules_1_to_21_and_only_these():
    text = (DOCS / "reading.md").read_text()
    assert [int(n) for n in re.findall(r"^### (\d+)\. ", text, re.MULTILINE)] == list(range(1, 22))
    for source in [*(ROOT / "src").rglob("*.py"), ROOT / "tests" / "oracle.py"]:
        for cited in re.findall(r"\brules? (\d+)\b", source.read_text()):
            assert 1 <= int(cited) <= 21, source


@pytest.mark.parametrize("record", [Reading, Reinforcement])
def test_the_reading_lists_every_option_with_its_default(record):
    text = (DOCS / "reading.md").read_text().split("## Options at a glance")[1].split("\n## ")[0]
    for option in dataclasses.fields(record):
        row = next((line for line in text.splitlines() if f"`{option.name}`" in line), None)
        assert row is not None, f"docs/reading.md does not list {option.name}"
        default = option.default
        shown = str(default) if isinstance(default, bool) else f'"{default}"'
        if isinstance(default, int | float) and not isinstance(default, bool):
            shown = f"{default:g}"
        assert shown in row, f"docs/reading.md: {option.name} defaults to {shown}"


def test_the_reading_names_every_arm_and_claim():
    text = (DOCS / "reading.md").read_text()
    for arm in PAPER:
        assert f"`{arm.slug}`" in text
    for claim in CLAIMS:
        assert f"| {re.match(r'C[0-9]+', claim)[0]} |" in text
    assert f"runs {GREEDY_TRIALS} more trials" in text


def test_links_between_pages_lead_somewhere():
    for page in DOCS.rglob("*.md"):
        for target in re.findall(r"\]\(([^)#:\s]+)(?:#[^)]*)?\)", page.read_text()):
            there = GENERATED.match(target) or (page.parent / target).exists()
            assert there, f"{page.relative_to(ROOT)} links to {target}"


def test_the_generated_pages_link_to_what_is_documented(monkeypatch):
    monkeypatch.syspath_prepend(str(DOCS / "theme"))
    from commands import commands_page
    from names import names_page

    options = [line for line in commands_page().splitlines() if line.startswith("| `")]
    assert options
    assert not [line for line in options if re.search(r"(?<!\\)\[", line.split("` | ")[1])]
    linked = re.findall(r"\]\[(tasklift[\w.]*)\.(\w+)\]", names_page())
    constants = [(module, name) for module, name in linked if not callable(getattr(tasklift, name))]
    assert constants
    for module, name in constants:  # the reference has those with a docstring below them
        body = ast.parse(Path(sys.modules[module].__file__).read_text()).body
        below = next(after for before, after in pairwise(body) if ast.unparse(before).startswith(f"{name} = "))
        assert isinstance(below, ast.Expr), f"{module}.{name} has no docstring"


def test_the_program_of_the_replay_pictures_fits_the_code(monkeypatch):
    pytest.importorskip("playwright.sync_api")
    monkeypatch.syspath_prepend(str(DOCS / "pictures"))
    import make

    assert [label for label, _ in make.traces(make.ARMS, [1])] == ["direct", "copy", "copy+prior"]


def test_every_decision_is_in_the_index_and_in_the_navigation():
    index, navigation = (DOCS / "decisions" / "README.md").read_text(), (ROOT / "mkdocs.yml").read_text()
    for page in DOCS.glob("decisions/0*.md"):
        assert page.name in index
        assert page.name in navigation
        assert 6 <= len(page.read_text().splitlines()) <= 40
