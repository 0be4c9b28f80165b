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
    check_plot_options,
    parameter_axis,
    require_dataset,
    scales_of,
)

CHAOS_SIGMAS = 3.0  # standard errors by which the first exponent exceeds 0 in the shaded ranges
BAND_SIGMAS = 2.0  # half width of the bands in standard errors
CHAOS_SHADE, BAND_ALPHA = "0.85", 0.35
EXPONENT_NAMES = ("first exponent", "second exponent")
LINE_STYLES = (("-", 1.3, COLOURS[0]), ("--", 1.0, COLOURS[7]))  # dashes and width distinguish them in grey


@check_plot_options
def spectrum(found: xr.Dataset, ax: Axes | None = None, units: str = "scene") -> Axes:
    """Draw the Lyapunov exponents of a scene against a parameter.

    Both exponents are per drive period. The first is a solid line, the second a dashed line. Bands extend two standard
    errors to each side. Ranges in which the first exponent exceeds zero by three standard errors are grey.

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
    A triangle at the lower edge marks an exponent of -inf. A line has a gap where no exponent exists, and an isolated
    value is a dot. Open circles are growth rates between the sticking phases of a mass that sticks to a wall.

    Examples
    --------
    >>> ax = jv.plot.spectrum(jv.spectrum(scene, "amplitude", [1.9, 2.1], orbit.state, error=0.05))
    >>> ax.get_ylabel()
    'Lyapunov exponents per drive period'
    """
    require_dataset("spectrum", "spectrum", ("swept", "exponent", "error"), found)
    parameter_name = found.attrs["swept"]
    is_new_axes, x_axis, ax = ax is None, parameter_axis(scales_of(found, units), parameter_name), axes_or_new(ax)
    parameter_order = np.argsort(found[parameter_name].values, kind="stable")
    found = found.isel({parameter_name: parameter_order})
    x, exponents, standard_errors = (
        x_axis.factor * found[parameter_name].values,
        found["exponent"].values,
        found["error"].values,
    )
    ax.axhline(0.0, color=WALL_COLOUR, linewidth=0.8, zorder=0)
    for range_lower, range_upper in _ranges_where_true(x, exponents[:, 0] > CHAOS_SIGMAS * standard_errors[:, 0]):
        ax.axvspan(range_lower, range_upper, color=CHAOS_SHADE, linewidth=0, zorder=-1, label="_chaotic")
    for exponent_index, (dash_pattern, line_width, colour) in enumerate(LINE_STYLES):
        finite_exponents = np.where(np.isfinite(exponents[:, exponent_index]), exponents[:, exponent_index], np.nan)
        band_half_width = np.where(
            np.isfinite(standard_errors[:, exponent_index]), BAND_SIGMAS * standard_errors[:, exponent_index], 0.0
        )
        ax.fill_between(
            x,
            finite_exponents - band_half_width,
            finite_exponents + band_half_width,
            color=colour,
            alpha=BAND_ALPHA,
            linewidth=0,
        )
        ax.plot(
            x, finite_exponents, dash_pattern, linewidth=line_width, color=colour, label=EXPONENT_NAMES[exponent_index]
        )
        is_isolated = _is_isolated(np.isfinite(finite_exponents))
        if is_isolated.any():
            ax.plot(x[is_isolated], finite_exponents[is_isolated], "o", markersize=3, color=colour, label="_alone")
        minus_infinity_x = x[np.isneginf(exponents[:, exponent_index])]
        tick_style: dict[str, Any] = {
            "linestyle": "none",
            "marker": "v",
            "markersize": 4,
            "color": colour,
            "clip_on": False,
        }
        ax.plot(
            minus_infinity_x,
            np.zeros(len(minus_infinity_x)),
            transform=ax.get_xaxis_transform(),
            label="_-inf",
            **tick_style,
        )
    if "between" in found and np.isfinite(found["between"]).any():
        sticking_growth_style: dict[str, Any] = {
            "linestyle": "none",
            "marker": "o",
            "markersize": 4,
            "markerfacecolor": "none",
            "color": COLOURS[5],
        }
        ax.plot(x, found["between"].values, label="growth between rests", **sticking_growth_style)
    ax.set(xlabel=x_axis.label, ylabel="Lyapunov exponents per drive period")
    ax.margins(x=0.01)
    add_legend(ax, is_new_axes)
    return ax


def _is_isolated(is_finite):
    """Return a mask of the finite values without a finite neighbour, to which no line can be drawn."""
    padded_is_finite = np.pad(is_finite, 1)
    return is_finite & ~padded_is_finite[:-2] & ~padded_is_finite[2:]


def _ranges_where_true(x, condition):
    """Return the ranges of x in which a condition holds, extended half way to the neighbouring values."""
    cell_borders = np.concatenate([x[:1], 0.5 * (x[1:] + x[:-1]), x[-1:]])
    change_indices = np.flatnonzero(np.diff(np.concatenate([[0], condition.astype(int), [0]])))
    return [
        (cell_borders[start], cell_borders[stop])
        for start, stop in zip(change_indices[::2], change_indices[1::2], strict=True)
    ]
