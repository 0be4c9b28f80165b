"""The trace: position against time along a trajectory, between its walls."""

from typing import Any

import xarray as xr
from matplotlib.axes import Axes

from ..scene.scene import Scene
from .path import position, with_impacts
from .style import COLOURS, WALL, axes, is_from, is_of, of_time, of_variable, picture, scales_of


@picture
def trace(trajectory: xr.Dataset, scene: Scene, ax: Axes | None = None, units: str = "scene") -> Axes:
    """Draw the position in a Dataset of `simulate` against time, with walls and impacts: the Axes.

    units: "scene", time in drive periods, or "physical" of a scene that has scales, time in seconds.

    Raises ArgumentError for what is no such Dataset, or no `Scene`, and for other units.
    """
    is_from("trace", "simulate", ("x", "v", "phase", "impact_time"), trajectory)
    is_of("trace", Scene, scene)
    scales = scales_of(trajectory, units)
    across, up, ax = of_time(scales, float(scene.frequency)), of_variable(scales, "x"), axes(ax)
    for wall in scene.walls.values():
        place = up.size * position(wall, trajectory["phase"].values)
        ax.plot(across.size * trajectory["time"].values, place, color=WALL, linewidth=1.5)
    time, x, _, _ = with_impacts(trajectory, scene)
    ax.plot(across.size * time, up.size * x, color=COLOURS[0], linewidth=1.0)
    dots: dict[str, Any] = {"linestyle": "none", "marker": "o", "markersize": 3.5, "color": COLOURS[1], "zorder": 3}
    ax.plot(across.size * trajectory["impact_time"].values, up.size * trajectory["position"].values, **dots)
    ax.set(xlabel=across.label, ylabel=up.label)
    return ax
