"""A picture of a search under way, in the replay's colours."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from tasklift.building.draw import draw_plan
from tasklift.building.mission import Mission
from tasklift.building.simulator import progress_mm
from tasklift.checks import one_of
from tasklift.envs.batch import Batch
from tasklift.style import SERIES

MODES = ["rgb_array", "human"]


class Drawn:
    """What an environment with a single mission needs to be drawn; it sets ``render_mode``, by which it is."""

    _batch: Batch
    _picture: Picture | None = None
    render_mode: str | None

    def _set_mode(self, render_mode: str | None) -> None:
        self.render_mode = one_of(render_mode, (None, *MODES), "render_mode")

    def render(self) -> NDArray[np.uint8] | None:
        """Draw the building, the robots and the hostiles: uint8 (height, width, 3), or a window."""
        if self.render_mode is None:
            return None
        if self._picture is None:
            self._picture = Picture(self._batch.mission, self.render_mode)
        return self._picture.of(self._batch)

    def _show(self) -> None:
        """Draw into the window, if there is one."""
        if self.render_mode == "human":
            self.render()

    def close(self) -> None:
        """Close the window, if there is one."""
        if self._picture is not None:
            self._picture.close()
            self._picture = None


class Picture:
    """The floor plan, the robots on it, and the hostiles that are left.

    Parameters
    ----------
    mission
        Whose building is drawn.
    mode
        ``"rgb_array"``: pixels; ``"human"``: a window of matplotlib's, where there is a screen.
    """

    def __init__(self, mission: Mission, mode: str) -> None:
        from matplotlib.backends.backend_agg import FigureCanvasAgg
        from matplotlib.figure import Figure

        self._window = mode == "human"
        if self._window:
            from matplotlib import pyplot

            self._figure: Any = pyplot.figure(figsize=(8, 6))
        else:
            self._figure = Figure(figsize=(8, 6), dpi=80)
            FigureCanvasAgg(self._figure)
        axes = self._figure.subplots()
        draw_plan(mission.building, axes, legend=False)
        building = mission.building
        self._at, self._to = building.position_m, building.neighbour
        self._cost = mission.simulator.world.halves["cost_mm"]
        armed = mission.simulator.world.members["armed"] == 1
        self._colours = np.where(armed, SERIES["orange"][0], SERIES["blue"][0])
        self._robots = axes.scatter([], [], s=45, zorder=6, edgecolors="white", linewidths=0.8)
        self._hostiles = axes.scatter([], [], s=90, zorder=5, marker="X", color="black")

    def of(self, batch: Batch) -> NDArray[np.uint8] | None:
        """Draw the first mission of a batch as it is now; pixels uint8 (height, width, 3), None in a window."""
        robots, sites = batch.lanes.robots[0], batch.lanes.sites[0]
        half = np.maximum(robots["half"], 0)
        along = progress_mm(robots, batch.lanes.count["tick"][0, 0])
        share = np.where(robots["half"] >= 0, along / self._cost[half], 0.0)[:, None]
        here = self._at[robots["node"]]
        places = here + share * (self._at[self._to[half]] - here)
        # robots at one place stand around it
        turn = 2 * np.pi * np.arange(len(robots)) / len(robots)
        places = places + 0.25 * np.column_stack([np.cos(turn), np.sin(turn)])
        alive = robots["alive"] == 1
        self._robots.set_offsets(places[alive])
        self._robots.set_facecolor(self._colours[alive].tolist())
        self._hostiles.set_offsets(self._at[sites["hostile"] == 1])
        self._figure.canvas.draw()
        if self._window:
            self._figure.canvas.flush_events()
            return None
        return np.asarray(self._figure.canvas.buffer_rgba())[..., :3].copy()

    def close(self) -> None:
        """Close the window."""
        if self._window:
            from matplotlib import pyplot

            pyplot.close(self._figure)
