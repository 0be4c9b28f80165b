"""Draw Poincaré sections of a motion: states at one phase of the drive, or impacts on one wall."""

import numpy as np
import xarray as xr
from matplotlib.axes import Axes
from matplotlib.typing import ColorType

from ..scene.check import ArgumentError
from ..scene.scene import SIDES
from .style import COLOURS, axes_or_new, check_plot_options, phase_plane_axes, require_dataset, scales_of

MIN_RELATIVE_RANGE = 0.01  # relative to the middle value of an axis


@check_plot_options
def section(
    dataset: xr.Dataset,
    which: str = "sigma",
    ax: Axes | None = None,
    colour: ColorType | None = None,
    units: str = "scene",
) -> Axes:
    """Draw one Poincaré section of a motion.

    Parameters
    ----------
    dataset : xarray.Dataset
        Dataset of `jaxvibro.sections`.
    which : {"sigma", "left", "right"}, optional
        Section: ``"sigma"`` draws velocity against position at one phase of the drive; ``"left"`` and ``"right"`` draw
        the velocity after each impact on that wall against the phase of the drive.
    ax : Axes, optional
        Axes to draw into. None makes a new figure.
    colour : colour, optional
        Colour of the dots.
    units : {"scene", "physical"}, optional
        Units of the axes. ``"physical"`` requires a scene with scales.

    Returns
    -------
    Axes
        Axes with the drawing.

    Raises
    ------
    ArgumentError
        If `dataset` is not a Dataset of `jaxvibro.sections`, or if `which` or `units` is unknown.

    See Also
    --------
    jaxvibro.sections : Compute the Poincaré sections of a motion.

    Notes
    -----
    The range of each axis is at least one per cent of its middle value. Each point of a periodic motion therefore
    appears as one dot, despite rounding errors.

    Examples
    --------
    >>> ax = jv.plot.section(jv.sections(scene, orbit.state, periods=10, settle=0), "right")
    >>> ax.get_ylabel()[:17]
    'velocity after it'
    """
    require_dataset("section", "sections", ("x", "v"), dataset)
    x_axis, y_axis = phase_plane_axes(scales_of(dataset, units))
    ax = axes_or_new(ax)
    if which == "sigma":
        x, v = x_axis.factor * dataset["x"].values, y_axis.factor * dataset["v"].values
        ax.set(xlabel=x_axis.label, ylabel=y_axis.label)
    elif which in SIDES:
        x, v = dataset[f"{which}_phase"].values / np.pi, y_axis.factor * dataset[f"{which}_velocity"].values
        ax.set(xlabel=r"phase of the drive at the impact $\,/\,\pi$", xlim=(0.0, 2.0))
        ax.set_ylabel(y_axis.label.replace("velocity", "velocity after it"))
    else:
        raise ArgumentError("which", 'must be "sigma", "left" or "right"', which)
    ax.plot(x, v, linestyle="none", marker=".", markersize=2.0, color=colour or COLOURS[0], rasterized=True)
    return _widen_narrow_axes(ax)


def _widen_narrow_axes(ax):
    """Widen each axis whose range is less than `MIN_RELATIVE_RANGE` of its middle value."""
    for axis_min, axis_max, set_axis_limits in ((*ax.get_xlim(), ax.set_xlim), (*ax.get_ylim(), ax.set_ylim)):
        axis_middle = 0.5 * (axis_min + axis_max)
        if axis_max - axis_min < MIN_RELATIVE_RANGE * abs(axis_middle):
            set_axis_limits(
                axis_middle - MIN_RELATIVE_RANGE * abs(axis_middle), axis_middle + MIN_RELATIVE_RANGE * abs(axis_middle)
            )
    return ax
