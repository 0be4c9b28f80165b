"""The Lyapunov spectrum against a parameter, chaotic ranges shaded."""

from typing import Any

import numpy as np
import xarray as xr
from matplotlib.axes import Axes

from .style import COLOURS, WALL, axes, is_from, legend, of_parameter, picture, scales_of

SURE = 3.0  # standard errors by which the first exponent must exceed 0, for a value to be shaded as chaotic
BAND = 2.0  # standard errors to either side
SHADE, PALE = "0.85", 0.35
NAMES = ("first exponent", "second exponent")
STYLES = (("-", 1.3, COLOURS[0]), ("--", 1.0, COLOURS[7]))  # told apart in grey by dashes and width


@picture
def spectrum(found: xr.Dataset, ax: Axes | None = None, units: str = "scene") -> Axes:
    """Draw a Dataset of `jaxvibro.spectrum`: the Axes.

    Both exponents per drive period against the parameter, solid and dashed, with bands of two standard errors, which
    are seen where the errors are; a line at zero; grey behind the values where the first exponent is positive beyond
    doubt. An exponent of -inf is a tick at the lower edge; where there is none, the line has a gap; a value that stands
    alone is a dot. Open circles are the growth between rests of a mass that comes to rest. units: of the parameter,
    "scene", or "physical" of a scene that has scales. New Axes get a legend.

    Raises ArgumentError for what is no such Dataset, and for other units.
    """
    is_from("spectrum", "spectrum", ("swept", "exponent", "error"), found)
    name = found.attrs["swept"]
    alone, wide, ax = ax is None, of_parameter(scales_of(found, units), name), axes(ax)
    order = np.argsort(found[name].values, kind="stable")
    found = found.isel({name: order})
    across, exponent, error = wide.size * found[name].values, found["exponent"].values, found["error"].values
    ax.axhline(0.0, color=WALL, linewidth=0.8, zorder=0)
    for first, last in _ranges(across, exponent[:, 0] > SURE * error[:, 0]):
        ax.axvspan(first, last, color=SHADE, linewidth=0, zorder=-1, label="_chaotic")
    for k, (dashes, width, colour) in enumerate(STYLES):
        line = np.where(np.isfinite(exponent[:, k]), exponent[:, k], np.nan)
        spread = np.where(np.isfinite(error[:, k]), BAND * error[:, k], 0.0)
        ax.fill_between(across, line - spread, line + spread, color=colour, alpha=PALE, linewidth=0)
        ax.plot(across, line, dashes, linewidth=width, color=colour, label=NAMES[k])
        single = _alone(np.isfinite(line))
        if single.any():
            ax.plot(across[single], line[single], "o", markersize=3, color=colour, label="_alone")
        deep = across[np.isneginf(exponent[:, k])]
        ticks: dict[str, Any] = {"linestyle": "none", "marker": "v", "markersize": 4, "color": colour, "clip_on": False}
        ax.plot(deep, np.zeros(len(deep)), transform=ax.get_xaxis_transform(), label="_-inf", **ticks)
    if "between" in found and np.isfinite(found["between"]).any():
        look: dict[str, Any] = {
            "linestyle": "none",
            "marker": "o",
            "markersize": 4,
            "markerfacecolor": "none",
            "color": COLOURS[5],
        }
        ax.plot(across, found["between"].values, label="growth between rests", **look)
    ax.set(xlabel=wide.label, ylabel="Lyapunov exponents per drive period")
    ax.margins(x=0.01)
    legend(ax, alone)
    return ax


def _alone(finite):
    """Which values have no neighbour to draw a line to."""
    beside = np.pad(finite, 1)
    return finite & ~beside[:-2] & ~beside[2:]


def _ranges(across, holds):
    """Where neighbouring values hold: from half way to the one before to half way to the one after."""
    edges = np.concatenate([across[:1], 0.5 * (across[1:] + across[:-1]), across[-1:]])
    turns = np.flatnonzero(np.diff(np.concatenate([[0], holds.astype(int), [0]])))
    return [(edges[first], edges[last]) for first, last in zip(turns[::2], turns[1::2], strict=True)]
