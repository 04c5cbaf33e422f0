"""What the site shows and nobody writes by hand: replays, the reference of the command line, the changelog."""

from __future__ import annotations

import sys
from pathlib import Path
from typing import Any

from mkdocs.structure.files import File, Files

sys.path.insert(0, str(Path(__file__).parent))

from commands import commands_page
from names import names_page
from replays import replays


def on_files(files: Files, config: Any) -> Files:
    """Add the generated files, once for each build."""
    for name, html in replays().items():
        files.append(File.generated(config, f"replays/{name}.html", content=html))
    files.append(File.generated(config, "reference/commands.md", content=commands_page()))
    files.append(File.generated(config, "reference/names.md", content=names_page()))
    for name in ("CHANGELOG", "CONTRIBUTING"):
        text = (Path(config.config_file_path).parent / f"{name}.md").read_text(encoding="utf-8")
        files.append(File.generated(config, f"{name.lower()}.md", content=text))
    return files
