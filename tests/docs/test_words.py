"""The project's words: what readers stumbled over is refused, and the README stays readable (``words.py``)."""

from __future__ import annotations

import re
import statistics
from pathlib import Path

import pytest

from words import REFUSED, ROOT, lengths, pages, percentile_95, prose, refused, sentences, strings

README = (ROOT / "README.md").read_text()


@pytest.mark.parametrize(
    "text",
    ["It takes so many steps.", "This is no map.", "The robots are told nothing.", "It is held.", "the same chances"],
)
def test_the_constructions_are_found(text: str) -> None:
    assert refused(text)


def test_plain_sentences_pass() -> None:
    assert refused("There is no such file. It is no longer needed. `told` is a name. Whole trials are played.") == []
    text = "One idea. Another one:\n\n- an item\n- `code` here\n"
    assert sentences(prose(text)) == ["One idea.", "Another one:", "an item", "CODE here"]


@pytest.mark.parametrize("page", pages(), ids=lambda page: str(page.relative_to(ROOT)))
def test_pages_use_none_of_them(page: Path) -> None:
    found = refused(prose(page.read_text()))
    assert not found, f"{page.name}: {found}; write instead: {list(REFUSED.values())}"


def test_docstrings_errors_and_help_use_none_of_them() -> None:
    found = [
        f"{module.relative_to(ROOT)}:{line}: {bad}"
        for module in sorted((ROOT / "src").rglob("*.py"))
        for line, text in strings(module.read_text())
        if (bad := refused(text))
    ]
    assert found == []


def test_the_readme_is_readable() -> None:
    words = lengths(README)
    assert statistics.median(words) <= 16
    assert percentile_95(words) <= 35


def test_the_readmes_first_screen_says_what_this_is() -> None:
    first = README.split("\n## ")[0]
    definition = README.split("\n\n")[1].replace("*", "")
    assert len(definition.split()) <= 40
    for word in ("Python", "reinforcement learning", "transfer", "multi-robot"):
        assert word in definition
    for needed in ("pip install", "make demo", "make test", "headline.svg", "RL researchers", "robotics engineers"):
        assert needed in first, needed
    opening = " ".join(prose(README).split()[:150])
    for private in (r"\barm", r"\btrials?\b(?! and error)", r"\bdrill", r"\breading", r"\bT\b", r"\bV\b"):
        assert not re.search(private, opening), f"{private} is not explained in the first 150 words"
