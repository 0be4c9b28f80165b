"""The Lyapunov spectrum against a parameter, chaotic ranges shaded."""

from typing import Any

import numpy as np
import xarray as xr
from matplotlib.axes import Axes

from .style import (
    COLOURS,
    WALL_COLOUR,
    add_legend,
    axes_or_new,
    checked_picture,
    parameter_axis,
    require_dataset,
    scales_of,
)

CHAOS_SIGMAS = 3.0  # standard errors by which the first exponent must exceed 0, for a value to be shaded as chaotic
BAND_SIGMAS = 2.0  # standard errors to either side
CHAOS_SHADE, BAND_ALPHA = "0.85", 0.35
EXPONENT_NAMES = ("first exponent", "second exponent")
LINE_STYLES = (("-", 1.3, COLOURS[0]), ("--", 1.0, COLOURS[7]))  # told apart in grey by dashes and width


@checked_picture
def spectrum(found: xr.Dataset, ax: Axes | None = None, units: str = "scene") -> Axes:
    """Draw a Dataset of `jaxvibro.spectrum`: the Axes.

    Both exponents per drive period against the parameter, solid and dashed, with bands of two standard errors, which
    are seen where the errors are; a line at zero; grey behind the values where the first exponent is positive beyond
    doubt. An exponent of -inf is a tick at the lower edge; where there is none, the line has a gap; a value that stands
    alone is a dot. Open circles are the growth between rests of a mass that comes to rest. units: of the parameter,
    "scene", or "physical" of a scene that has scales. New Axes get a legend.

    Raises ArgumentError for what is no such Dataset, and for other units.
    """
    require_dataset("spectrum", "spectrum", ("swept", "exponent", "error"), found)
    parameter = found.attrs["swept"]
    is_new, x_axis, ax = ax is None, parameter_axis(scales_of(found, units), parameter), axes_or_new(ax)
    order = np.argsort(found[parameter].values, kind="stable")
    found = found.isel({parameter: order})
    x, exponent, error = x_axis.factor * found[parameter].values, found["exponent"].values, found["error"].values
    ax.axhline(0.0, color=WALL_COLOUR, linewidth=0.8, zorder=0)
    for start, stop in _true_ranges(x, exponent[:, 0] > CHAOS_SIGMAS * error[:, 0]):
        ax.axvspan(start, stop, color=CHAOS_SHADE, linewidth=0, zorder=-1, label="_chaotic")
    for index, (dashes, width, colour) in enumerate(LINE_STYLES):
        line = np.where(np.isfinite(exponent[:, index]), exponent[:, index], np.nan)
        spread = np.where(np.isfinite(error[:, index]), BAND_SIGMAS * error[:, index], 0.0)
        ax.fill_between(x, line - spread, line + spread, color=colour, alpha=BAND_ALPHA, linewidth=0)
        ax.plot(x, line, dashes, linewidth=width, color=colour, label=EXPONENT_NAMES[index])
        is_isolated = _isolated_values(np.isfinite(line))
        if is_isolated.any():
            ax.plot(x[is_isolated], line[is_isolated], "o", markersize=3, color=colour, label="_alone")
        infinite_values = x[np.isneginf(exponent[:, index])]
        tick_style: dict[str, Any] = {
            "linestyle": "none",
            "marker": "v",
            "markersize": 4,
            "color": colour,
            "clip_on": False,
        }
        ax.plot(
            infinite_values,
            np.zeros(len(infinite_values)),
            transform=ax.get_xaxis_transform(),
            label="_-inf",
            **tick_style,
        )
    if "between" in found and np.isfinite(found["between"]).any():
        circle_style: dict[str, Any] = {
            "linestyle": "none",
            "marker": "o",
            "markersize": 4,
            "markerfacecolor": "none",
            "color": COLOURS[5],
        }
        ax.plot(x, found["between"].values, label="growth between rests", **circle_style)
    ax.set(xlabel=x_axis.label, ylabel="Lyapunov exponents per drive period")
    ax.margins(x=0.01)
    add_legend(ax, is_new)
    return ax


def _isolated_values(finite):
    """Which values have no neighbour to draw a line to."""
    neighbours = np.pad(finite, 1)
    return finite & ~neighbours[:-2] & ~neighbours[2:]


def _true_ranges(x, condition):
    """Where neighbouring values hold: from half way to the one before to half way to the one after."""
    edges = np.concatenate([x[:1], 0.5 * (x[1:] + x[:-1]), x[-1:]])
    changes = np.flatnonzero(np.diff(np.concatenate([[0], condition.astype(int), [0]])))
    return [(edges[start], edges[stop]) for start, stop in zip(changes[::2], changes[1::2], strict=True)]
