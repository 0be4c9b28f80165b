"""Sections of a motion: its states on Sigma, or its impacts on a wall."""

from typing import Any

import numpy as np
import xarray as xr
from matplotlib.axes import Axes
from matplotlib.typing import ColorType

from ..scene.check import ArgumentError
from .style import COLOURS, axes_or_new, checked_picture, phase_plane_axes, require_dataset, scales_of

SIDES = ("left", "right")
MIN_RELATIVE_RANGE = 0.01  # of the middle of an axis


@checked_picture
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
    require_dataset("section", "sections", ("x", "v"), dataset)
    x_axis, y_axis = phase_plane_axes(scales_of(dataset, units))
    ax = axes_or_new(ax)
    marker_style: dict[str, Any] = {
        "linestyle": "none",
        "marker": ".",
        "markersize": 2.0,
        "color": colour or COLOURS[0],
        "rasterized": True,
    }
    if which == "sigma":
        ax.plot(x_axis.factor * dataset["x"].values, y_axis.factor * dataset["v"].values, **marker_style)
        ax.set(xlabel=x_axis.label, ylabel=y_axis.label)
        return _widen_limits(ax)
    if which not in SIDES:
        raise ArgumentError("which", 'must be "sigma", "left" or "right"', which)
    ax.plot(
        dataset[f"{which}_phase"].values / np.pi, y_axis.factor * dataset[f"{which}_velocity"].values, **marker_style
    )
    ax.set(xlabel=r"phase of the drive at the impact $\,/\,\pi$", xlim=(0.0, 2.0))
    ax.set_ylabel(y_axis.label.replace("velocity", "velocity after it"))
    return _widen_limits(ax)


def _widen_limits(ax):
    """Axes in which what is the same but for rounding, as states of a period, is one dot: no axis is so narrow."""
    for lower, upper, set_limits in ((*ax.get_xlim(), ax.set_xlim), (*ax.get_ylim(), ax.set_ylim)):
        middle = 0.5 * (lower + upper)
        if upper - lower < MIN_RELATIVE_RANGE * abs(middle):
            set_limits(middle - MIN_RELATIVE_RANGE * abs(middle), middle + MIN_RELATIVE_RANGE * abs(middle))
    return ax
