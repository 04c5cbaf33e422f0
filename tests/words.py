"""How the project writes: constructions that readers stumble over, and the length of sentences.

``python tests/words.py`` prints, for each page, its words, the median and the 95th percentile of words in a
sentence, and what is refused in it.
"""

from __future__ import annotations

import ast
import re
import statistics
import sys
from collections.abc import Iterator
from pathlib import Path

ROOT = Path(__file__).parents[1]

#: What is refused, and what to write instead.
REFUSED = {
    r"\bso many\b": "the number, or 'this many'",
    r"\bin earnest\b": "say where",
    r"(?<![Tt]here )\b(?:is|are|was|were) no\b(?! (?:longer|more|less|larger|smaller|later))": "'is not a …'",
    r"\btold\b": "say who knows what, or use the name of the option",
    r"\b(?:is|are|be|was|were|stays?|stayed) held\b": "stays, is kept, is played",
    r"\b(?:is|are|stays?) whole\b|\bas a whole\b": "complete, unchanged",
    r"\bwhole (?:story|study)\b": "full, or leave it out",
    r"\b(?:the|even|its|of|same) chances\b": "random numbers, probabilities",
}


def prose(markdown: str) -> str:
    """Return a page's text without code, tables, headings, pictures and addresses."""
    text = re.sub(r"^(```|~~~).*?^\1", "", markdown, flags=re.DOTALL | re.MULTILINE)
    text = re.sub(r"<[^>]+>", " ", text)
    text = re.sub(r"!\[[^\]]*\]\([^)]*\)", " ", text)
    text = re.sub(r"\[([^\]]*)\]\([^)]*\)", r"\1", text)
    text = re.sub(r"`[^`]*`", "CODE", text)
    lines = [line for line in text.splitlines() if not line.lstrip().startswith(("|", "#", "    "))]
    return "\n".join(lines)


def sentences(text: str) -> list[str]:
    """Split prose; items of lists and paragraphs end sentences too."""
    blocks = re.split(r"\n\s*(?:[-*]|\d+\.) |\n\s*\n", "\n" + text)
    found = []
    for block in blocks:
        joined = " ".join(block.split())
        found += [s for s in re.split(r"(?<=[.!?:])\s+(?=[A-Z*\"'(])", joined) if re.search(r"\w", s)]
    return found


def lengths(markdown: str) -> list[int]:
    """Return the number of words of each sentence."""
    return [len(re.findall(r"[\w’'-]+", sentence)) for sentence in sentences(prose(markdown))]


def strings(source: str) -> Iterator[tuple[int, str]]:
    """Yield every string of a module with its line: docstrings, errors, help, texts of reports."""
    for node in ast.walk(ast.parse(source)):
        if isinstance(node, ast.Constant) and isinstance(node.value, str):
            yield node.lineno, node.value


def refused(text: str) -> list[str]:
    """Return what is refused in a text."""
    bare = re.sub(r"``?[^`]*``?", "CODE", text)
    flat = " ".join(bare.split())
    return [match.group() for pattern in REFUSED for match in re.finditer(pattern, flat)]


def pages() -> list[Path]:
    """Return every page that the project shows people."""
    return [ROOT / "README.md", ROOT / "CONTRIBUTING.md", *sorted((ROOT / "docs").rglob("*.md"))]


def percentile_95(numbers: list[int]) -> int:
    """Return the smallest number that 95 % do not exceed."""
    return sorted(numbers)[int(0.95 * (len(numbers) - 1))]


if __name__ == "__main__":
    for page in pages():
        found = lengths(page.read_text()) or [0]
        name, bad = page.relative_to(ROOT), refused(prose(page.read_text()))
        middle, long = statistics.median(found), percentile_95(found)
        print(f"{name!s:58} {sum(found):6} words, {middle:4.0f} / {long:3}  {bad or ''}")
    for module in sorted((ROOT / "src").rglob("*.py")):
        for line, text in strings(module.read_text()):
            if bad := refused(text):
                print(f"{module.relative_to(ROOT)}:{line}: {bad}")
    sys.exit(0)
