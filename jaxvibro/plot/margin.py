"""Draw the bifurcations near an orbit in the plane of two free parameters, or as changes of each parameter."""

import numpy as np
from matplotlib.axes import Axes
from matplotlib.patches import Ellipse

from ..branches.branch import KIND_NAMES
from ..design.margin import REACHED, Margin
from .locus import KIND_STYLES, MARKERS
from .style import COLOURS, axes_or_new, checked_picture, escape_formulas, parameter_axis, require_record, scales_of

PARAMETER_MARKERS = "osD^vP*X"  # of the free parameters
LINE_STYLES = {True: "-", False: ":"}  # True if the point is the first bifurcation on the line


@checked_picture
def margin(near: Margin, ax: Axes | None = None, units: str = "scene") -> Axes:
    """Draw the nearest bifurcations of an orbit.

    For two free parameters the drawing is their plane, the first on the x axis, with the orbit, a straight line to each
    point, and the ellipse inside which no bifurcation was found. A line is dotted if another boundary comes first. For
    any other number of free parameters the drawing shows the change of each that leads to each point, in its unit, the
    nearest point first.

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
    return _draw_plane(near, ax, scales) if len(near.free) == 2 else _draw_changes(near, ax)


def _draw_plane(margin, ax, scales):
    parameter_axes = {name: parameter_axis(scales, name) for name in margin.free}
    orbit_position = _plane_position(margin.orbit.scene, parameter_axes)
    ax.plot(*orbit_position, "o", color="black", label=margin.orbit.label, zorder=6)
    if margin.points:
        diameters = (2.0 * margin.distance * margin.free[name] * axis.factor for name, axis in parameter_axes.items())
        legend_text = f"nearest: {margin.distance:.3g} units"
        ax.add_patch(
            Ellipse(
                orbit_position,
                *diameters,
                fill=False,
                edgecolor="0.4",
                linestyle=(0, (4, 3)),
                label=legend_text,
                zorder=2,
            )
        )
    for point in margin.points:
        position, (colour, _) = _plane_position(point.scene, parameter_axes), KIND_STYLES[point.kind]
        ax.plot(
            *zip(orbit_position, position, strict=True),
            color=colour,
            linestyle=LINE_STYLES[point.status == REACHED],
            linewidth=1.2,
        )
        marker_style = {
            "marker": MARKERS[point.kind],
            "markersize": 8.0,
            "markeredgecolor": "black",
            "linestyle": "none",
        }
        ax.plot(*position, color=colour, label=_point_label(point), zorder=5, **marker_style)
    ax.set(**dict(zip(("xlabel", "ylabel"), (axis.label for axis in parameter_axes.values()), strict=True)))
    ax.margins(0.12)
    ax.legend(fontsize="small")
    return ax


def _plane_position(scene, parameter_axes):
    """Return the position of a scene in the plane of two parameters, given an `Axis` for each."""
    return [axis.factor * float(scene.parameter(name)) for name, axis in parameter_axes.items()]


def _draw_changes(margin, ax):
    positions = np.arange(len(margin.points))
    ax.axhline(0.0, color="0.5", linewidth=0.8)
    spacing = 0.6 / len(margin.free)
    for index, (name, unit) in enumerate(margin.free.items()):
        x = positions + spacing * (index - 0.5 * (len(margin.free) - 1))
        changes = [point.change[name] / unit for point in margin.points]
        colour = COLOURS[index % len(COLOURS)]
        ax.vlines(x, 0.0, changes, color=colour, linewidth=1.5)
        marker_style = {
            "marker": PARAMETER_MARKERS[index % len(PARAMETER_MARKERS)],
            "markeredgecolor": "black",
            "linestyle": "none",
        }
        ax.plot(x, changes, color=colour, label=f"{escape_formulas(name)}, unit {unit:g}", **marker_style)
    ax.set_xticks(
        positions, [f"{_point_label(point)}\n{point.distance:.3g} units" for point in margin.points], fontsize="small"
    )
    ax.set(xlim=(-0.6, max(len(positions), 2) - 0.4), ylabel="change to the point (units of each number)")
    ax.legend(fontsize="small")
    return ax


def _point_label(point):
    status_text = "" if point.status == REACHED else f", {point.status}"
    return f"{point.kind}: {KIND_NAMES[point.kind]}{status_text}"
