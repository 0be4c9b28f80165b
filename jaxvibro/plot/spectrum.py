"""Draw Lyapunov exponents against a parameter, with chaotic ranges shaded."""

import numpy as np
import xarray as xr
from matplotlib.axes import Axes

from ..output.equal_runs import find_equal_runs
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
    is_chaotic = exponents[:, 0] > CHAOS_SIGMAS * standard_errors[:, 0]
    cell_borders = np.concatenate([x[:1], 0.5 * (x[1:] + x[:-1]), x[-1:]])
    for first_index, end_index in find_equal_runs(is_chaotic):
        if is_chaotic[first_index]:
            chaotic_range = cell_borders[first_index], cell_borders[end_index]
            ax.axvspan(*chaotic_range, color=CHAOS_SHADE, linewidth=0, zorder=-1, label="_chaotic")
    for index, line_style in enumerate(LINE_STYLES):
        _draw_exponent(ax, x, exponents[:, index], standard_errors[:, index], EXPONENT_NAMES[index], *line_style)
    if "between" in found and np.isfinite(found["between"]).any():
        ax.plot(
            x,
            found["between"].values,
            label="growth between rests",
            linestyle="none",
            marker="o",
            markersize=4,
            markerfacecolor="none",
            color=COLOURS[5],
        )
    ax.set(xlabel=x_axis.label, ylabel="Lyapunov exponents per drive period")
    ax.margins(x=0.01)
    add_legend(ax, is_new_axes)
    return ax


def _draw_exponent(ax, x, exponents, standard_errors, legend_text, dash_pattern, line_width, colour):
    """Draw one exponent: its line and band, isolated values as dots, and triangles where it is -inf."""
    is_finite, is_minus_infinity = np.isfinite(exponents), np.isneginf(exponents)
    finite_exponents = np.where(is_finite, exponents, np.nan)
    band_half_width = np.where(np.isfinite(standard_errors), BAND_SIGMAS * standard_errors, 0.0)
    ax.fill_between(
        x,
        finite_exponents - band_half_width,
        finite_exponents + band_half_width,
        color=colour,
        alpha=BAND_ALPHA,
        linewidth=0,
    )
    ax.plot(x, finite_exponents, dash_pattern, linewidth=line_width, color=colour, label=legend_text)
    has_finite_neighbour = np.pad(is_finite, 1)
    is_isolated = is_finite & ~has_finite_neighbour[:-2] & ~has_finite_neighbour[2:]
    if is_isolated.any():
        ax.plot(x[is_isolated], finite_exponents[is_isolated], "o", markersize=3, color=colour, label="_alone")
    ax.plot(
        x[is_minus_infinity],
        np.zeros(is_minus_infinity.sum()),
        transform=ax.get_xaxis_transform(),
        label="_-inf",
        linestyle="none",
        marker="v",
        markersize=4,
        color=colour,
        clip_on=False,
    )
