"""Draw Lyapunov exponents against a parameter, with chaotic ranges shaded."""

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

CHAOS_SIGMAS = 3.0  # standard errors by which the first exponent exceeds 0 in the shaded ranges
BAND_SIGMAS = 2.0  # half width of the bands in standard errors
CHAOS_SHADE, BAND_ALPHA = "0.85", 0.35
EXPONENT_NAMES = ("first exponent", "second exponent")
LINE_STYLES = (("-", 1.3, COLOURS[0]), ("--", 1.0, COLOURS[7]))  # dashes and width distinguish them in grey


@checked_picture
def spectrum(found: xr.Dataset, ax: Axes | None = None, units: str = "scene") -> Axes:
    """Draw the Lyapunov exponents of a scene against a parameter.

    Both exponents are per drive period, the first a solid line and the second a dashed one. Bands are two standard
    errors wide on each side. Ranges in which the first exponent exceeds zero by three standard errors are grey.

    Parameters
    ----------
    found : xarray.Dataset
        Dataset of `jaxvibro.spectrum`.
    ax : Axes, optional
        Axes to draw into. None makes a new figure, whose Axes get a legend.
    units : {"scene", "physical"}, optional
        Units of the parameter. ``"physical"`` requires a scene with scales.

    Returns
    -------
    Axes
        Axes with the drawing.

    Raises
    ------
    ArgumentError
        If `found` is not a Dataset of `jaxvibro.spectrum`, or if `units` is unknown.

    See Also
    --------
    jaxvibro.spectrum : Compute the Lyapunov exponents along a parameter.

    Notes
    -----
    An exponent of -inf is a tick at the lower edge. A line has a gap where there is no exponent, and an isolated value
    is a dot. Open circles are the growth between sticking phases of a mass that sticks to a wall.

    Examples
    --------
    >>> ax = jv.plot.spectrum(jv.spectrum(scene, "amplitude", [1.9, 2.1], orbit.state, error=0.05))
    >>> ax.get_ylabel()
    'Lyapunov exponents per drive period'
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
    """Return True for each value without a neighbour to which a line can be drawn."""
    neighbours = np.pad(finite, 1)
    return finite & ~neighbours[:-2] & ~neighbours[2:]


def _true_ranges(x, condition):
    """Return the ranges of x in which a condition holds, extended half way to the neighbouring values."""
    edges = np.concatenate([x[:1], 0.5 * (x[1:] + x[:-1]), x[-1:]])
    changes = np.flatnonzero(np.diff(np.concatenate([[0], condition.astype(int), [0]])))
    return [(edges[start], edges[stop]) for start, stop in zip(changes[::2], changes[1::2], strict=True)]
