"""The palette: what each colour and dash means, in reports, charts, figures, plans and the replay.

It lies below everything that draws, since buildings are drawn without the report. Every colour is a pair: on
light ground and on dark. Figures, which go into papers, use the first.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from typing import Any

#: The ground and what is written on it; verdicts.
GROUND: Mapping[str, tuple[str, str]] = {
    "paper": ("#ffffff", "#14181d"),
    "ink": ("#1c2127", "#e6e9ed"),
    "soft": ("#5b6570", "#a3adb8"),
    "line": ("#d5dae0", "#353d46"),
    "tint": ("#f3f5f8", "#1d232a"),
    "holds": ("#0a6b45", "#5fd6a4"),
    "fails": ("#b3261e", "#ff8f86"),
    "open": ("#7a5a00", "#e6c25a"),
}

#: Colours of series, in the order in which a chart gives them to names without a meaning of their own.
SERIES: Mapping[str, tuple[str, str]] = {
    "blue": ("#0b62a8", "#6cb6f5"),
    "orange": ("#c2500c", "#f39a5b"),
    "green": ("#00795c", "#4fcfa6"),
    "pink": ("#a83279", "#ee8cc6"),
    "gold": ("#8a6a00", "#e3c04f"),
    "sky": ("#3f93c9", "#9fd4f7"),
    "violet": ("#5a49b5", "#b3a6ff"),
    "grey": ("#555d66", "#b6bec7"),
    "brown": ("#7a4b2a", "#d7a982"),
}

#: The replay's plan, robots and signs.
SCENE: Mapping[str, tuple[str, str]] = {
    "accent": ("#0b7285", "#4fd1e0"),
    "ground": ("#eef0f3", "#191f27"),
    "ghost-floor": ("#e6e9ed", "#1f2630"),
    "ghost-wall": ("#cfd4db", "#303a46"),
    "floor": ("#ffffff", "#33404f"),
    "wall": ("#3a4250", "#a8b5c4"),
    "room": ("#f8ecd2", "#4a4331"),
    "searched": ("#cdebd9", "#1f5b45"),
    "door": ("#c77700", "#f0a63a"),
    "mark": ("#9aa3ae", "#66727f"),
    "alert": ("#dd8a00", "#ffb531"),
    "danger": ("#cf2e1f", "#ff6a55"),
    "safe": ("#12805c", "#4fd6a0"),
    "kind0": ("#1479c9", "#5db7ff"),
    "kind1": ("#a3227e", "#ff7fd0"),
    "kind2": ("#0e7c66", "#4fd6b0"),
    "kind3": ("#5a4fcf", "#b0a5ff"),
}

#: Lengths of dashes and gaps, in widths of a line.
DASHES: Mapping[str, tuple[float, ...]] = {
    "solid": (),
    "dashed": (5, 2),
    "dotted": (1, 1.5),
    "dash-dot": (5, 1.5, 1, 1.5),
}


@dataclass(frozen=True)
class Look:
    """A colour of :data:`SERIES` and dashes of :data:`DASHES`, by name."""

    colour: str
    dash: str = "solid"

    @property
    def index(self) -> int:
        """Place of the colour in :data:`SERIES`; the style sheets name it ``c0``, ``c1`` …"""
        return list(SERIES).index(self.colour)

    @property
    def line(self) -> dict[str, Any]:
        """Matplotlib's options of a line that looks like this."""
        dashes = DASHES[self.dash]
        return {"color": SERIES[self.colour][0], "linestyle": (0, dashes) if dashes else "-"}


#: What looks the same wherever it is drawn, by slug: arms, and the two values of MV in Figure 5.
LOOKS: Mapping[str, Look] = {
    "direct": Look("orange"),
    "direct-budget": Look("gold", "dashed"),
    "copy": Look("blue"),
    "copy-prior": Look("green"),
    "prior": Look("pink", "dotted"),
    "copy-drill": Look("sky", "dashed"),
    "drill": Look("sky"),
    "every-door": Look("violet", "dashed"),
    "search": Look("brown"),
    "expert": Look("grey", "dash-dot"),
    "random": Look("grey", "dotted"),
    "move": Look("violet"),
    "stop": Look("brown"),
}


def look(slug: str, taken: Iterable[Look] = ()) -> Look:
    """Return how a slug is drawn: its own look, or that of the name it begins with, or one that is not taken.

    >>> look("direct").colour, look("direct-loss").colour, look("direct-loss").dash
    ('orange', 'orange', 'dashed')
    """
    if slug in LOOKS:
        return LOOKS[slug]
    used = set(taken)
    kin = [known for known in LOOKS if slug.startswith(f"{known}-")]
    first = [LOOKS[max(kin, key=len)].colour] if kin else []
    colours = [*first, *(name for name in SERIES if name not in first)]
    free = [Look(colour, dash) for colour in first for dash in DASHES if dash != "solid"]
    free += [Look(colour, dash) for dash in DASHES for colour in colours]
    return next((one for one in free if one not in used), free[0])


def css(*groups: Mapping[str, tuple[str, str]]) -> str:
    """Return a style sheet's variables: ``--ink`` and the like, ``--c0`` … for series; light, dark, and printed."""
    pairs = {f"--{name}": pair for group in groups for name, pair in group.items()}
    pairs |= {f"--c{i}": pair for i, pair in enumerate(SERIES.values())}
    light, dark = ("; ".join(f"{name}: {pair[side]}" for name, pair in pairs.items()) for side in (0, 1))
    classes = " ".join(f".c{i} {{ --c: var(--c{i}); }}" for i in range(len(SERIES)))
    return (
        f":root {{ color-scheme: light dark; {light}; }}\n"
        f"@media (prefers-color-scheme: dark) {{ :root {{ {dark}; }} }}\n"
        f"@media print {{ :root {{ color-scheme: light; {light}; }} }}\n{classes}\n"
    )


_INK, _MUTED = GROUND["ink"][0], GROUND["soft"][0]

#: Matplotlib's settings for figures; the font comes with matplotlib: the same picture everywhere.
FIGURE: Any = {
    "font.family": "DejaVu Sans",
    "font.size": 8,
    "axes.titlesize": 8.5,
    "axes.labelsize": 8,
    "axes.edgecolor": _MUTED,
    "axes.linewidth": 0.7,
    "axes.spines.top": False,
    "axes.spines.right": False,
    "axes.titlelocation": "left",
    "xtick.labelsize": 7.5,
    "ytick.labelsize": 7.5,
    "xtick.color": _MUTED,
    "ytick.color": _MUTED,
    "xtick.labelcolor": _INK,
    "ytick.labelcolor": _INK,
    "grid.color": "#e3e6ea",
    "grid.linewidth": 0.6,
    "legend.fontsize": 7.5,
    "legend.frameon": False,
    "lines.linewidth": 1.3,
}
