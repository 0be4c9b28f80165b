"""The trace: position against time along a trajectory, between its walls."""

from typing import Any

import numpy as np
import xarray as xr
from matplotlib.axes import Axes

from ..scene.scene import Scene
from .path import position, with_impacts
from .style import COLOURS, COORDINATES, TIME, WALL, axes, is_from, is_of


def trace(trajectory: xr.Dataset, scene: Scene, ax: Axes | None = None) -> Axes:
    """Draw the position in a Dataset of `simulate` against time in drive periods, with walls and impacts: the Axes.

    Raises ArgumentError for what is no such Dataset, or no `Scene`.
    """
    is_from("trace", "simulate", ("x", "v", "phase", "impact_time"), trajectory)
    is_of("trace", Scene, scene)
    ax, period = axes(ax), 2 * np.pi / float(scene.frequency)
    turns = trajectory["time"].values / period
    for wall in scene.walls.values():
        ax.plot(turns, position(wall, trajectory["phase"].values), color=WALL, linewidth=1.5)
    time, x, _, _ = with_impacts(trajectory, scene)
    ax.plot(time / period, x, color=COLOURS[0], linewidth=1.0)
    dots: dict[str, Any] = {"linestyle": "none", "marker": "o", "markersize": 3.5, "color": COLOURS[1], "zorder": 3}
    ax.plot(trajectory["impact_time"].values / period, trajectory["position"].values, **dots)
    ax.set(xlabel=TIME, ylabel=COORDINATES["x"])
    return ax
