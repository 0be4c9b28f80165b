"""Invariant manifolds in the plane of Sigma: lines from a saddle, broken where the curve is."""

from typing import Any

import numpy as np
import xarray as xr
from matplotlib.axes import Axes
from matplotlib.typing import ColorType

from .style import COLOURS, COORDINATES, axes, is_from, plain

LOOKS = {"stable": (COLOURS[2], "-"), "unstable": (COLOURS[7], (0, (5, 2)))}


def manifold(dataset: xr.Dataset, ax: Axes | None = None, colour: ColorType | None = None, saddle: bool = True) -> Axes:
    """Draw a Dataset of `jaxvibro.manifold`, velocity against position: the Axes.

    A stable manifold is a black line, an unstable one a broken line in orange-red; colour: another one. saddle: mark
    the saddle's points with crosses.

    Raises ArgumentError for what is no such Dataset.
    """
    is_from("manifold", "manifold", ("kind", "piece", "x", "v"), dataset)
    ax = axes(ax)
    own, style = LOOKS[dataset.attrs["kind"]]
    breaks = np.flatnonzero(np.diff(dataset["piece"].values)) + 1
    x, v = (np.insert(dataset[name].values, breaks, np.nan) for name in ("x", "v"))
    told = f"{dataset.attrs['kind']} manifold of {plain(dataset.attrs['label'])}"
    look: dict[str, Any] = {"color": colour or own, "linestyle": style, "linewidth": 0.9}
    ax.plot(x, v, label=told, gid="manifold", zorder=2, **look)
    if saddle:
        first = np.flatnonzero(dataset["arc"].values == 0)
        dots: dict[str, Any] = {
            "linestyle": "none",
            "marker": "X",
            "markersize": 8,
            "color": "white",
            "markeredgecolor": "black",
        }
        ax.plot(dataset["x"].values[first], dataset["v"].values[first], gid="saddle", zorder=4, **dots)
    ax.set(xlabel=COORDINATES["x"], ylabel=COORDINATES["v"])
    return ax
