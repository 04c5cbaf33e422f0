"""The paper's Figures 1 to 5, drawn from what the code computed; for papers (PNG and SVG) and for the report.

Every function returns a new ``matplotlib.figure.Figure``; :func:`tasklift.report.pictures.save` writes it.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from tasklift import style
from tasklift.building import draw
from tasklift.building.graph import Building
from tasklift.building.ways import goal_shares, sectors
from tasklift.errors import TaskliftError
from tasklift.report.pictures import PAGE, page, styled
from tasklift.stats import mean_band
from tasklift.studies.arms import ARMS, Arm
from tasklift.studies.paper.survey import Survey
from tasklift.studies.report import WEAPONS
from tasklift.studies.samples import CA, Sample
from tasklift.style import GROUND, SCENE, SERIES

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

_SECTORS = ("#a9d8f3", "#f6dd9b", "#a5dcc8", "#efc9de", "#f6bfa5", "#d5d9df")
_INK, _MUTED, _BLUE = GROUND["ink"][0], GROUND["soft"][0], SERIES["blue"][0]
_GOAL = SCENE["danger"][0]

@styled
def figure1(building: Building) -> Figure:
    """Draw a building as a plan (a) and as its graph (b)."""
    figure = page(PAGE, 3.9)
    left, right = figure.subplots(1, 2)
    draw.draw_plan(building, left)
    draw.draw_graph(building, right)
    _shrink_signs(right)
    for ax, title in ((left, "(a) the plan"), (right, "(b) its graph")):
        handles, labels = _taken_legend(ax)
        ax.legend(
            handles,
            labels,
            loc="upper center",
            bbox_to_anchor=(0.5, 0.0),
            ncols=3,
            handletextpad=0.4,
        )
        ax.set_title(title)
    # as high as the building asks for at this width, with the title and the legend
    (x0, x1), (y0, y1) = left.get_xlim(), left.get_ylim()
    figure.set_size_inches(PAGE, float(np.clip(PAGE / 2 * (y1 - y0) / (x1 - x0), 1.6, 7.5)) + 0.8)
    return figure


def _shrink_signs(ax: Axes) -> None:
    """Fit the signs of a graph, drawn for a panel of 5.5 inches, to one of half a page."""
    for line in ax.lines:
        line.set_markersize(0.58 * line.get_markersize())


def _taken_legend(ax: Axes) -> tuple[list[Any], list[str]]:
    """Take the legend off a drawn building, which is wider than our panels; return what it says."""
    legend = ax.get_legend()
    assert legend is not None
    legend.remove()
    return list(legend.legend_handles), [text.get_text() for text in legend.get_texts()]


@styled
def figure2(building: Building, node: int, goal: int, sharpness: float = 1.0) -> Figure:
    """Draw the shares by which robots divide at an intersection.

    Parameters
    ----------
    building, node
        Where; a node with two or more corridors.
    goal
        The node that the team heads for.
    sharpness
        As the reading's ``goal_sharpness``.

    Raises
    ------
    TaskliftError
        If the building has no such node.
    """
    for name, value in (("node", node), ("goal", goal)):
        if not 0 <= value < building.n_nodes:
            raise TaskliftError(f"figure2, {name}: expected 0 to {building.n_nodes - 1}, found {value}")
    figure = page(PAGE, 3.9)
    left, right = figure.subplots(1, 2)
    here = slice(building.indptr[node], building.indptr[node + 1])
    for k, sector in enumerate(sectors(building, node)):
        colour = _SECTORS[k % len(_SECTORS)]
        for polygon in getattr(sector, "geoms", [sector]):
            if polygon.geom_type == "Polygon":
                left.fill(*polygon.exterior.xy, facecolor=colour, edgecolor="white", linewidth=1.5)
    for ax in (left, right):
        _draw_faint(building, ax)
    _label_ways(building, left, node, building.coverage[here], "#3b414d", even=True)
    shares = goal_shares(building, node, goal, sharpness)
    _label_ways(building, right, node, shares, _BLUE, even=False)
    right.plot(*building.position_m[goal], marker="*", color=_GOAL, markersize=15, markeredgecolor="white", zorder=6)
    right.annotate("goal", building.position_m[goal], (9, 6), textcoords="offset points", color=_GOAL, zorder=6)
    left.set_title("(a) CovA: shares of the area, divided by the bisectors")
    right.set_title("(b) GolC: the nearer a way ends to the goal, the more")
    return figure


def _draw_faint(building: Building, ax: Axes) -> None:
    """Outline and graph as a background."""
    from matplotlib.collections import LineCollection

    ring = np.concatenate([building.outline_m, building.outline_m[:1]])
    ax.plot(*ring.T, color=_MUTED, linewidth=0.8, linestyle=(0, (4, 2)))
    lines = list(building.position_m[building.edges])
    ax.add_collection(LineCollection(lines, colors=_MUTED, linewidths=1.0, zorder=2))
    ax.set_aspect("equal")
    ax.axis("off")


def _label_ways(building: Building, ax: Axes, node: int, shares: NDArray[np.float64], colour: str, even: bool) -> None:
    """Draw an arrow along every way of a node, labelled with its share; as thick as the share unless ``even``."""
    here = building.position_m[node]
    extent = float(np.ptp(building.outline_m, axis=0).max())
    ways = building.neighbour[building.indptr[node] : building.indptr[node + 1]]
    for way, share in zip(ways, shares, strict=True):
        offset = building.position_m[way] - here
        along = offset / max(float(np.hypot(*offset)), 1e-9)
        tip = here + along * extent * 0.13
        ax.annotate(
            "",
            tip,
            here,
            arrowprops={
                "arrowstyle": "-|>",
                "color": colour,
                "linewidth": 2.0 if even else 0.8 + 6 * share,
                "shrinkA": 0,
                "shrinkB": 0,
            },
            zorder=4,
        )
        x, y = here + along * extent * 0.195
        ax.text(
            x,
            y,
            f"{share:.2f}",
            ha="center",
            va="center",
            fontsize=9,
            fontweight="bold",
            color=_INK,
            bbox={"boxstyle": "round,pad=0.2", "facecolor": "white", "edgecolor": colour, "linewidth": 0.8},
            zorder=5,
        )
    ax.plot(*here, "o", color=_INK, markersize=7, markeredgecolor="white", zorder=5)


@styled
def figure3(survey: Survey) -> Figure:
    """Draw two surveyed maps and what V taught about CA there: mean weights of the odd seeds, 95 % bands.

    Parameters
    ----------
    survey
        What was learned; it chooses the maps (:meth:`tasklift.studies.paper.survey.Survey.choose`).
    """
    figure = page(PAGE, 5.6)
    axes = figure.subplots(2, 2, height_ratios=[1.3, 1])
    axes[1, 1].sharey(axes[1, 0])
    for name, letters, (above, below) in zip(survey.shown(), ("ac", "bd"), axes.T, strict=True):
        of = survey.maps[name]
        draw.draw_graph(of.building, above)
        _shrink_signs(above)
        handles, labels = _taken_legend(above)
        above.set_title(f"({letters[0]}) {of.building.name}")
        rows = of.rows("odd")
        band = mean_band(of.weights[rows])
        below.fill_between(CA, band.low, band.high, color=_BLUE, alpha=0.22, linewidth=0)
        below.plot(CA, band.estimate, "o-", color=_BLUE, markersize=3.5)
        slope = survey.slope_interval(name)
        line = band.estimate.mean() + slope.estimate * (CA - CA.mean())
        below.plot(CA, line, color=_INK, linewidth=0.9, linestyle="--")
        title = f"({letters[1]}) slope {slope.estimate:+.3f} [{slope.low:+.3f}, {slope.high:+.3f}]"
        below.set_title(title.replace("-", "−"))
        below.text(
            0.03,
            0.05,
            f"{rows.sum()} seeds; no trend: within ±{survey.margin(name):.3f}",
            transform=below.transAxes,
            fontsize=7,
            color=_MUTED,
        )
        below.set_xlabel("coverage coefficient CA")
        below.set_xticks(np.linspace(0, 1, 6))
        below.grid(axis="y")
    axes[1, 0].set_ylabel("mean weight after V")
    figure.legend(handles, labels, loc="outside upper center", ncols=len(labels), handletextpad=0.4)
    return figure


_PANELS = (("steps", "steps"), ("robots_left", "robots left"), ("teams_left", "teams left"))


@styled
def figure4(
    samples: Mapping[str, Sample],
    run: tuple[str, int] | None = None,
    single: Sequence[str] = ("direct", "copy"),
    arms: Mapping[str, Arm] = ARMS,
) -> Figure:
    """Draw time, robots left and teams left per trial on T: means over all maps and seeds, and one single run.

    Parameters
    ----------
    samples
        By slug of the arm; those that are drawn are the lines above: means with 95 % bootstrap bands, seeds resampled
        within maps; of an arm that does not learn the mean over its trials.
    run
        Map and seed of the run below; the first one by default, so that nobody picks it.
    single
        The arms of that run.
    arms
        The arms themselves, by slug.

    Raises
    ------
    TaskliftError
        If there is no such run.
    """
    from matplotlib.ticker import MaxNLocator

    figure = page(PAGE, 4.9)
    axes = figure.subplots(2, 3, sharex=True, sharey="col")
    drawn = {slug: sample for slug, sample in samples.items() if arms[slug].drawn} or samples
    first = next(iter(drawn.values()))
    at = 0
    if run is not None:
        there = np.flatnonzero((first.maps == run[0]) & (first.seeds == run[1]))
        if not len(there):
            raise TaskliftError(f"figure4: no run of map {run[0]!r} and seed {run[1]}")
        at = int(there[0])
    for column, (name, label) in enumerate(_PANELS):
        above, below = axes[:, column]
        for slug, sample in drawn.items():
            values = getattr(sample, name)
            trials = np.arange(1, values.shape[1] + 1)
            line = style.look(slug).line
            shown = values if arms[slug].learns else np.broadcast_to(values.mean(axis=1, keepdims=True), values.shape)
            band = mean_band(shown, strata=sample.maps)
            above.fill_between(trials, band.low, band.high, color=line["color"], alpha=0.13, linewidth=0)
            above.plot(trials, band.estimate, **line, linewidth=1.1, label=arms[slug].label)
            if slug in single:
                below.plot(trials, values[at], **line, linewidth=0.9)
        above.set_title(f"({'abc'[column]}) {label}")
        below.set_xlabel("trial on T")
        above.set_ylim(0, (first.limit if name == "steps" else first.n_robots) * 1.04)
        above.yaxis.set_major_locator(MaxNLocator(5, steps=[1, 2, 5, 10], integer=True))
        for ax in (above, below):
            ax.grid(axis="y")
    axes[0, 0].set_ylabel(f"mean of {len(first.maps)} runs")
    axes[1, 0].set_ylabel(f"one run: {first.maps[at]}, seed {first.seeds[at]}")
    handles, labels = axes[0, 0].get_legend_handles_labels()
    figure.legend(handles, labels, loc="outside upper center", ncols=len(labels))
    return figure


@styled
def figure5(move_weights: ArrayLike) -> Figure:
    """Draw the weights of stopping and moving by feature, a panel per class of weapons.

    Parameters
    ----------
    move_weights
        ``(3, 5, 2)``: mean weight by nWPN, FTR and MV; see :func:`tasklift.studies.study.move_weights`.

    Raises
    ------
    TaskliftError
        For another shape.
    """
    values = np.asarray(move_weights, dtype=np.float64)
    if values.shape != (3, 5, 2):
        raise TaskliftError(f"figure5: expected weights of shape (3, 5, 2), found {values.shape}")
    figure = page(PAGE, 2.9)
    axes: Any = figure.subplots(1, 3, subplot_kw={"projection": "3d"})
    ticks = np.arange(1, 6)
    for n, ax in enumerate(axes):
        for move, name in ((1, "move"), (0, "stop")):
            colour = style.LOOKS[name].line["color"]
            heights = values[n, :, move]
            ax.bar3d(ticks - 0.32, move - 0.22, 0, 0.64, 0.44, heights, color=colour, edgecolor="white", linewidth=0.3)
        ax.view_init(elev=32, azim=-64)
        ax.set_box_aspect((1.6, 1.0, 1.0), zoom=1.12)
        ax.set_xticks(ticks)
        ax.set_yticks([0, 1], ["stop", "move"])
        ax.set_zlim(0, max(values.max() * 1.05, 1e-9))
        ax.tick_params(pad=-2, labelsize=7)
        ax.set_title(WEAPONS[n], loc="center")
    figure.supxlabel(
        "height: mean weight; feature: 1 none, 2 bend, 3 corner, 4 door (the enemy feature), 5 other", fontsize=7.5
    )
    return figure
