"""Sections of a motion: its states on Sigma, or its impacts on a wall."""

from typing import Any

import numpy as np
import xarray as xr
from matplotlib.axes import Axes
from matplotlib.typing import ColorType

from ..scene.check import ArgumentError
from .style import COLOURS, COORDINATES, axes, is_from

WALLS = ("left", "right")


def section(dataset: xr.Dataset, which: str = "sigma", ax: Axes | None = None, colour: ColorType | None = None) -> Axes:
    """Draw one section in a Dataset of `sections`: the Axes.

    which: "sigma", velocity against position at the drive's phase; "left" or "right", of the impacts on that wall the
    velocity after them against the phase of the drive.

    Raises ArgumentError for what is no such Dataset, and for another section.
    """
    is_from("section", "sections", ("x", "v"), dataset)
    ax = axes(ax)
    look: dict[str, Any] = {
        "linestyle": "none",
        "marker": ".",
        "markersize": 2.0,
        "color": colour or COLOURS[0],
        "rasterized": True,
    }
    if which == "sigma":
        ax.plot(dataset["x"].values, dataset["v"].values, **look)
        ax.set(xlabel=COORDINATES["x"], ylabel=COORDINATES["v"])
        return ax
    if which not in WALLS:
        raise ArgumentError("which", 'must be "sigma", "left" or "right"', which)
    ax.plot(dataset[f"{which}_phase"].values / np.pi, dataset[f"{which}_velocity"].values, **look)
    ax.set(xlabel=r"phase of the drive at the impact $\,/\,\pi$", xlim=(0.0, 2.0))
    ax.set_ylabel(COORDINATES["v"].replace("velocity", "velocity after it"))
    return ax
