"""The bifurcations near an orbit: in the plane of two free numbers, or how much of each number leads to each."""

import numpy as np
from matplotlib.axes import Axes
from matplotlib.patches import Ellipse

from ..branches.branch import KIND_NAMES
from ..design.margin import REACHED, Margin
from .locus import KIND_STYLES, MARKERS
from .style import COLOURS, axes_or_new, checked_picture, escape_formulas, parameter_axis, require_record, scales_of

PARAMETER_MARKERS = "osD^vP*X"  # of the free numbers
LINE_STYLES = {True: "-", False: ":"}  # of a way: whether the point is the first that it meets


@checked_picture
def margin(near: Margin, ax: Axes | None = None, units: str = "scene") -> Axes:
    """Draw what `margin` found: the Axes.

    Of two free numbers their plane, the first across: the orbit, the way to each point (dotted where another boundary
    comes before), and the ellipse within which none was found. Of any other count of numbers the change of each that
    leads to each point, in its units, the nearest point first. units: of the plane, "scene", or "physical" of a scene
    that has scales.

    Raises ArgumentError where it is given anything else, and for other units.
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
    """Where a scene is in the plane of two parameters, with an `Axis` each."""
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
