"""Draw the bifurcations near an orbit in the plane of two free parameters, or as changes of each parameter."""

import numpy as np
from matplotlib.axes import Axes
from matplotlib.patches import Ellipse

from ..branches.branch import KIND_NAMES
from ..design.margin_result import REACHED, Margin
from .locus import KIND_STYLES, MARKERS
from .style import COLOURS, axes_or_new, check_plot_options, escape_formulas, parameter_axis, require_record, scales_of

PARAMETER_MARKERS = "osD^vP*X"  # of the free parameters
LINE_STYLES = {True: "-", False: ":"}  # True if the point is the first bifurcation on the line


@check_plot_options
def margin(near: Margin, ax: Axes | None = None, units: str = "scene") -> Axes:
    """Draw the nearest bifurcations of an orbit.

    For two free parameters the drawing is the plane of these parameters, the first on the x axis. It shows the orbit, a
    straight line to each bifurcation, and the ellipse inside which no bifurcation was found. A line is dotted if it
    crosses another bifurcation first. For any other number of free parameters the drawing shows, for each bifurcation,
    the change of each parameter, divided by the unit in `Margin.free`. The bifurcations are in the order of
    `Margin.points`.

    Parameters
    ----------
    near : Margin
        Result of `jaxvibro.margin`.
    ax : Axes, optional
        Axes to draw into. None makes a new figure.
    units : {"scene", "physical"}, optional
        Units of the plane. ``"physical"`` requires a scene with scales.

    Returns
    -------
    Axes
        Axes with the drawing.

    Raises
    ------
    ArgumentError
        If `near` is not a `Margin`, or if `units` is unknown.

    See Also
    --------
    jaxvibro.margin : Compute the distance from an orbit to the nearest bifurcations.

    Examples
    --------
    >>> near = jv.margin(orbit, {"amplitude": 0.1, "frequency": 0.1}, directions=8)
    >>> ax = jv.plot.margin(near)
    >>> ax.get_ylabel()[:15]
    'drive frequency'
    """
    require_record("margin", Margin, near)
    scales, ax = scales_of(near.orbit, units), axes_or_new(ax)
    return _draw_plane(near, ax, scales) if len(near.free) == 2 else _draw_parameter_changes(near, ax)


def _draw_plane(margin, ax, scales):
    parameter_axes = {name: parameter_axis(scales, name) for name in margin.free}
    orbit_position = _plane_position(margin.orbit.scene, parameter_axes)
    ax.plot(*orbit_position, "o", color="black", label=margin.orbit.label, zorder=6)
    if margin.points:
        ellipse_diameters = (
            2.0 * margin.distance * margin.free[name] * axis.factor for name, axis in parameter_axes.items()
        )
        legend_text = f"nearest: {margin.distance:.3g} units"
        ax.add_patch(
            Ellipse(
                orbit_position,
                *ellipse_diameters,
                fill=False,
                edgecolor="0.4",
                linestyle=(0, (4, 3)),
                label=legend_text,
                zorder=2,
            )
        )
    for nearest_point in margin.points:
        point_position = _plane_position(nearest_point.scene, parameter_axes)
        colour = KIND_STYLES[nearest_point.kind][0]
        ax.plot(
            *zip(orbit_position, point_position, strict=True),
            color=colour,
            linestyle=LINE_STYLES[nearest_point.status == REACHED],
            linewidth=1.2,
        )
        ax.plot(
            *point_position,
            label=_point_label(nearest_point),
            linestyle="none",
            marker=MARKERS[nearest_point.kind],
            markersize=8.0,
            color=colour,
            markeredgecolor="black",
            zorder=5,
        )
    ax.set(**dict(zip(("xlabel", "ylabel"), (axis.label for axis in parameter_axes.values()), strict=True)))
    ax.margins(0.12)
    ax.legend(fontsize="small")
    return ax


def _plane_position(scene, parameter_axes):
    """Return the position of a scene in the plane of two parameters; `parameter_axes` is {parameter:
    `AxisLabelAndFactor`}."""
    return [axis.factor * float(scene.parameter(parameter_name)) for parameter_name, axis in parameter_axes.items()]


def _draw_parameter_changes(margin, ax):
    tick_positions = np.arange(len(margin.points))
    ax.axhline(0.0, color="0.5", linewidth=0.8)
    marker_spacing = 0.6 / len(margin.free)
    for parameter_index, (parameter_name, parameter_unit) in enumerate(margin.free.items()):
        x = tick_positions + marker_spacing * (parameter_index - 0.5 * (len(margin.free) - 1))
        scaled_changes = [point.change[parameter_name] / parameter_unit for point in margin.points]
        colour = COLOURS[parameter_index % len(COLOURS)]
        ax.vlines(x, 0.0, scaled_changes, color=colour, linewidth=1.5)
        ax.plot(
            x,
            scaled_changes,
            label=f"{escape_formulas(parameter_name)}, unit {parameter_unit:g}",
            linestyle="none",
            marker=PARAMETER_MARKERS[parameter_index % len(PARAMETER_MARKERS)],
            color=colour,
            markeredgecolor="black",
        )
    ax.set_xticks(
        tick_positions,
        [f"{_point_label(point)}\n{point.distance:.3g} units" for point in margin.points],
        fontsize="small",
    )
    ax.set(xlim=(-0.6, max(len(tick_positions), 2) - 0.4), ylabel="change to the point (units of each number)")
    ax.legend(fontsize="small")
    return ax


def _point_label(point):
    status_text = "" if point.status == REACHED else f", {point.status}"
    return f"{point.kind}: {KIND_NAMES[point.kind]}{status_text}"
