"""Show Sphinx roles in docstrings (``:class:`tasklift.tasks.task.Task```) as code in the reference."""

from __future__ import annotations

import re
from typing import Any

import griffe

_ROLE = re.compile(r":(?:class|func|meth|mod|data|attr|exc):`(~?)([\w.]+)`")


def _shown(role: re.Match[str]) -> str:
    shortened, name = role.groups()
    return f"`{name.rsplit('.', 1)[-1] if shortened else name}`"


class Roles(griffe.Extension):
    """Rewrites every docstring once it is found."""

    def on_instance(self, *, obj: griffe.Object, **kwargs: Any) -> None:
        """Rewrite one docstring."""
        if obj.docstring is not None:
            obj.docstring.value = _ROLE.sub(_shown, obj.docstring.value)
