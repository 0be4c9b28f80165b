"""Invariant manifolds in the plane of Sigma: lines from a saddle, broken where the curve is."""

from typing import Any

import numpy as np
import xarray as xr
from matplotlib.axes import Axes
from matplotlib.typing import ColorType

from .style import COLOURS, WALL, axes, is_from, legend, of_plane, picture, plain, scales_of

# Why a curve ends; it goes on beyond a grazing, and an impact at the section's phase.
ENDS = {"attractor": "o", "length": "s", "points": "D", "resolution": "^", "fast": "v"}
LOOKS = {"stable": (COLOURS[2], "-"), "unstable": (COLOURS[7], (0, (5, 2)))}


@picture
def manifold(
    dataset: xr.Dataset,
    ax: Axes | None = None,
    colour: ColorType | None = None,
    saddle: bool = True,
    units: str = "scene",
) -> Axes:
    """Draw a Dataset of `jaxvibro.manifold`, velocity against position: the Axes.

    A stable manifold is a black line, an unstable one a broken line in orange-red; colour: another one. saddle: mark
    the saddle's points with crosses. Where the curve ends for good it is marked, and the legend
    says why. Walls that stand still are grey lines. units: "scene", or "physical" of a scene that has scales. New Axes
    get a legend.

    Raises ArgumentError for what is no such Dataset, and for other units.
    """
    is_from("manifold", "manifold", ("kind", "piece", "x", "v"), dataset)
    across, up = of_plane(scales_of(dataset, units))
    alone, ax = ax is None, axes(ax)
    own, style = LOOKS[dataset.attrs["kind"]]
    breaks = np.flatnonzero(np.diff(dataset["piece"].values)) + 1
    states = across.size * dataset["x"].values, up.size * dataset["v"].values
    x, v = (np.insert(each, breaks, np.nan) for each in states)
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
        ax.plot(*(each[first] for each in states), gid="saddle", zorder=4, **dots)
    _ends(ax, dataset, states, look["color"])
    _walls(ax, dataset.attrs, across.size)
    ax.set(xlabel=across.label, ylabel=up.label)
    legend(ax, alone)
    return ax


def _ends(ax, dataset, states, colour):
    """Marks where pieces begin and end, a kind for each reason."""
    piece = dataset["piece"].values
    known = {line.get_label() for line in ax.lines if line.get_gid() == "end"}
    first, last = np.searchsorted(piece, np.unique(piece)), np.searchsorted(piece, np.unique(piece), "right") - 1
    places = np.append(first, last)
    reasons = np.append(*(dataset[name].values.astype(str) for name in ("began", "ended")))
    for reason, marker in ENDS.items():
        here, told = places[reasons == reason], f"end: {reason}"
        if not len(here):
            continue
        look = {"marker": marker, "markersize": 4.5, "markerfacecolor": "white"}
        look |= {"linestyle": "none", "markeredgecolor": colour, "label": f"_{told}" if told in known else told}
        ax.plot(*(each[here] for each in states), gid="end", zorder=3.5, **look)


def _walls(ax, attrs, size):
    known = [line.get_xdata()[0] for line in ax.lines if line.get_gid() == "wall"]
    for side in ("left", "right"):
        place = attrs.get(f"{side}.position")
        if place is not None and f"{side}.motion.amplitude" not in attrs and size * place not in known:
            ax.axvline(size * place, color=WALL, linewidth=0.8, zorder=1, gid="wall")
