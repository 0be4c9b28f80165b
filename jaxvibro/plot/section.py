"""Sections of a motion: its states on Sigma, or its impacts on a wall."""

from typing import Any

import numpy as np
import xarray as xr
from matplotlib.axes import Axes
from matplotlib.typing import ColorType

from ..scene.check import ArgumentError
from .style import COLOURS, axes, is_from, of_plane, picture, scales_of

WALLS = ("left", "right")
NARROW = 0.01  # of the middle of an axis


@picture
def section(
    dataset: xr.Dataset,
    which: str = "sigma",
    ax: Axes | None = None,
    colour: ColorType | None = None,
    units: str = "scene",
) -> Axes:
    """Draw one section in a Dataset of `sections`: the Axes.

    which: "sigma", velocity against position at the drive's phase; "left" or "right", of the impacts on that wall the
    velocity after them against the phase of the drive. units: "scene", or "physical" of a scene that has scales.

    Raises ArgumentError for what is no such Dataset, and for another section or other units.
    """
    is_from("section", "sections", ("x", "v"), dataset)
    across, up = of_plane(scales_of(dataset, units))
    ax = axes(ax)
    look: dict[str, Any] = {
        "linestyle": "none",
        "marker": ".",
        "markersize": 2.0,
        "color": colour or COLOURS[0],
        "rasterized": True,
    }
    if which == "sigma":
        ax.plot(across.size * dataset["x"].values, up.size * dataset["v"].values, **look)
        ax.set(xlabel=across.label, ylabel=up.label)
        return _roomy(ax)
    if which not in WALLS:
        raise ArgumentError("which", 'must be "sigma", "left" or "right"', which)
    ax.plot(dataset[f"{which}_phase"].values / np.pi, up.size * dataset[f"{which}_velocity"].values, **look)
    ax.set(xlabel=r"phase of the drive at the impact $\,/\,\pi$", xlim=(0.0, 2.0))
    ax.set_ylabel(up.label.replace("velocity", "velocity after it"))
    return _roomy(ax)


def _roomy(ax):
    """Axes in which what is the same but for rounding, as states of a period, is one dot: no axis is so narrow."""
    for low, high, take in ((*ax.get_xlim(), ax.set_xlim), (*ax.get_ylim(), ax.set_ylim)):
        middle = 0.5 * (low + high)
        if high - low < NARROW * abs(middle):
            take(middle - NARROW * abs(middle), middle + NARROW * abs(middle))
    return ax
