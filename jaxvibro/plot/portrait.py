"""The phase portrait: velocity against position along a trajectory, with its impacts."""

from typing import Any

import numpy as np
import xarray as xr
from matplotlib.axes import Axes

from ..scene.scene import Scene
from .path import with_impacts
from .style import COLOURS, WALL, axes, is_from, is_of, of_plane, picture, scales_of


@picture
def portrait(
    trajectory: xr.Dataset, scene: Scene, ax: Axes | None = None, stable: bool = True, units: str = "scene"
) -> Axes:
    """Draw a Dataset of `simulate` in the phase plane: the Axes.

    Walls are grey, a moving one as wide as it goes; an impact is a dashed line; dots are the states on the section,
    at the end of each drive period. stable: whether the motion is; one that is not has a dashed line of its own colour,
    its impacts are dotted, its states open. units: "scene", or "physical" of a scene that has scales.

    Raises ArgumentError for what is no such Dataset, or no `Scene`, and for other units.
    """
    is_from("portrait", "simulate", ("x", "v", "phase", "impact_time"), trajectory)
    is_of("portrait", Scene, scene)
    across, up = of_plane(scales_of(trajectory, units))
    ax = axes(ax)
    _walls(ax, scene, across.size)
    _, x, v, jumps = with_impacts(trajectory, scene)
    x, v = across.size * x, up.size * v
    line, broken = ("-", "--") if stable else ((0, (6, 2)), ":")
    ax.plot(x, v, color=COLOURS[0 if stable else 7], linewidth=1.0, linestyle=line)
    ends = np.stack([jumps, jumps + 2, jumps + 1], -1).ravel()  # before, after, nan
    ax.plot(x[ends], v[ends], color=COLOURS[1], linewidth=1.2, linestyle=broken)
    turns = trajectory["phase"].values / (2 * np.pi)
    whole = np.flatnonzero(abs(turns - turns[0] - np.round(turns - turns[0])) < 1e-6)[1:]
    dots: dict[str, Any] = {"linestyle": "none", "marker": "o", "markersize": 4, "color": COLOURS[2], "zorder": 3}
    dots["markerfacecolor"] = COLOURS[2] if stable else "white"
    ax.plot(across.size * trajectory["x"].values[whole], up.size * trajectory["v"].values[whole], **dots)
    ax.set(xlabel=across.label, ylabel=up.label)
    ax.locator_params(axis="x", nbins=6)
    return ax


def _walls(ax, scene, size):
    for wall in (scene.left, scene.right):
        if wall is None:
            continue
        swing = 0.0 if wall.motion is None else size * abs(float(wall.motion.amplitude))
        place = size * float(wall.position)
        ax.axvspan(place - swing, place + swing, color=WALL, alpha=0.3, linewidth=0, zorder=0)
        ax.axvline(place, color=WALL, linewidth=1.0, zorder=0)
