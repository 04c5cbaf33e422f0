"""The page of the public names, as users type them: ``tl.Task``, ``tl.Policy``, …; made from the package itself."""

from __future__ import annotations

import inspect

import tasklift

#: Groups, by the folder that a name comes from.
_GROUPS = {
    "tasks": "Tasks and policies",
    "learning": "Learning and comparing",
    "building": "The building search",
    "networks": "Networks",
    "errors": "Errors",
}


def names_page() -> str:
    """Return the page: a table for each group, with the first sentence of every docstring."""
    parts = ["# The names\n", "What `import tasklift as tl` brings. A name leads to its full description.\n"]
    for folder, title in _GROUPS.items():
        parts += [f"## {title}\n", "| name | what it is |", "|---|---|"]
        for name, home in sorted(tasklift._HOME_OF.items()):
            if home.split(".")[0] == folder:
                parts.append(f"| [`tl.{name}`][tasklift.{home}.{name}] | {_first_sentence(getattr(tasklift, name))} |")
        parts.append("")
    return "\n".join(parts)


def _first_sentence(thing: object) -> str:
    if not (inspect.isclass(thing) or inspect.isroutine(thing)):
        return f"`{thing!r}`".replace("|", "\\|")
    text = " ".join((inspect.getdoc(thing) or "").split("\n\n")[0].split())
    return text.replace("``", "`").replace("|", "\\|")
