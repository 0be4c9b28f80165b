"""Draw sweep diagrams: a coordinate of the stroboscopic section against the parameter, one colour per leg."""

from typing import Any

import numpy as np
import xarray as xr
from matplotlib.axes import Axes
from matplotlib.markers import TICKLEFT, TICKRIGHT

from ..attractors.basin_fraction_bounds import format_share
from ..attractors.find import Attractor
from ..scene.check import require_choice
from .style import (
    COLOURS,
    WALL_COLOUR,
    add_legend,
    axes_or_new,
    check_plot_options,
    escape_formulas,
    lighten,
    parameter_axis,
    require_dataset,
    require_finite_position,
    require_records,
    scales_of,
    variable_axis,
)

DOT_SIZES = 2.2, 3.6  # points, smallest and largest dot of the first leg; between them the size follows the spacing
DOT_SPACING = 0.7  # fraction of the distance between two values
LEG_SIZE_RATIO = 0.5  # relative to the previous leg: where legs agree, a ring of the larger dot stays visible
FAINT_SIZE_RATIO = 0.7  # relative to the size of other dots
MARKERS = "osD^vP*X"
SWEEP_GID = "swept"  # group id of the dots of sweeps


@check_plot_options
def diagram(
    swept: xr.Dataset, variable: str = "x", ax: Axes | None = None, faint: bool = False, units: str = "scene"
) -> Axes:
    """Draw a coordinate of a sweep against its parameter.

    A leg is one pass through the values of the parameter. If the Dataset has a dimension besides the parameter and
    ``period``, such as ``lane`` or ``leg``, each entry of this dimension is a leg. Each leg has its own colour; the
    first three legs also have different dot sizes.

    Parameters
    ----------
    swept : xarray.Dataset
        Dataset of `jaxvibro.sweep`.
    variable : {"x", "v"}, optional
        Position or velocity on the section.
    ax : Axes, optional
        Axes to draw into. None makes a new figure, whose Axes get a legend. Legs follow those of earlier sweeps in the
        colour cycle.
    faint : bool, optional
        Draw smaller and paler dots below branches. By default the dots lie above branches.
    units : {"scene", "physical"}, optional
        Units of the axes. ``"physical"`` requires a scene with scales.

    Returns
    -------
    Axes
        Axes with the drawing.

    Raises
    ------
    ArgumentError
        If `swept` is not a Dataset of `jaxvibro.sweep`, or if `variable` or `units` is unknown.

    See Also
    --------
    jaxvibro.sweep : Sweep a parameter and record the section.
    mark : Draw attractors into a sweep diagram.
    mark_orbits : Draw orbits into a sweep diagram.

    Notes
    -----
    Fixed walls are drawn as lines in a diagram of ``"x"``, unless they are far from all dots.

    Examples
    --------
    >>> swept = jv.sweep(scene, "amplitude", np.linspace(1.9, 2.1, 3), orbit.state, settle=20, keep=4)
    >>> ax = jv.plot.diagram(swept)
    >>> ax.get_legend_handles_labels()[1]
    ['from 1.9 to 2.1']
    """
    require_dataset("diagram", "sweep", ("swept", "x", "v"), swept)
    require_choice("variable", variable, ("x", "v"))
    is_new_axes, scales = ax is None, scales_of(swept, units)
    ax, parameter_name = axes_or_new(ax), swept.attrs["swept"]
    x_axis, y_axis = parameter_axis(scales, parameter_name), variable_axis(scales, variable)
    step_dim, *leg_dims = (dim for dim in swept[variable].dims if dim != "period")
    sweep_legs = (
        [swept]
        if not leg_dims
        else [swept.isel({leg_dims[0]: leg_index}) for leg_index in range(swept.sizes[leg_dims[0]])]
    )
    n_earlier_legs = sum(line.get_gid() == SWEEP_GID and np.size(line.get_xdata()) > 0 for line in ax.lines)
    first_dot_size = float(np.clip(DOT_SPACING * _axes_width_in_points(ax) / len(swept[step_dim]), *DOT_SIZES))
    for leg_index, sweep_leg in enumerate(sweep_legs, n_earlier_legs):
        x = np.broadcast_to(x_axis.factor * sweep_leg[parameter_name].values[:, None], sweep_leg[variable].shape)
        y = y_axis.factor * sweep_leg[variable].transpose(step_dim, "period").values
        _draw_dots(
            ax,
            x,
            y,
            leg_index,
            first_dot_size,
            _leg_label_prefix(sweep_leg, leg_dims) + f"from {x[0, 0]:g} to {x[-1, 0]:g}",
            faint,
        )
    if variable == "x":
        _draw_walls(ax, swept.attrs, y_axis.factor)
    ax.set(xlabel=x_axis.label, ylabel=y_axis.label)
    ax.margins(x=0.01)
    add_legend(ax, is_new_axes)
    return ax


def _leg_label_prefix(sweep_leg, leg_dims):
    return escape_formulas(f"{sweep_leg[leg_dims[0]].values}: ") if leg_dims and leg_dims[0] in sweep_leg.coords else ""


def _draw_walls(ax, sweep_attrs, position_factor):
    y_min, y_max = ax.get_ylim()
    axis_margin = (y_max - y_min) / 4
    for side in ("left", "right"):
        position = sweep_attrs.get(f"{side}.position")
        is_fixed_wall = position is not None and f"{side}.motion.amplitude" not in sweep_attrs
        if is_fixed_wall and y_min - axis_margin <= position_factor * position <= y_max + axis_margin:
            ax.axhline(position_factor * position, color=WALL_COLOUR, linewidth=0.8, zorder=0)


def _axes_width_in_points(ax):
    """Return the width of Axes in points."""
    return 72.0 * ax.figure.get_figwidth() * ax.get_position().width


def _draw_dots(ax, x, y, leg_index, first_dot_size, legend_text, is_faint):
    dot_size, dot_colour = first_dot_size * LEG_SIZE_RATIO ** min(leg_index, 2), COLOURS[leg_index % len(COLOURS)]
    dot_style = {
        "linestyle": "none",
        "marker": "o",
        "markeredgewidth": 0,
        "color": lighten(dot_colour) if is_faint else dot_colour,
    }
    dot_size, dot_style["zorder"] = (FAINT_SIZE_RATIO * dot_size, 2.0) if is_faint else (dot_size, 4.0)
    ax.plot(
        x.ravel(), y.ravel(), markersize=dot_size, rasterized=True, label="_" + legend_text, gid=SWEEP_GID, **dot_style
    )
    ax.plot([], [], markersize=7 / (1 + 0.4 * leg_index), label=legend_text, **dot_style)


@check_plot_options
def mark(
    attractors: tuple[Attractor, ...] | list[Attractor],
    value: float,
    variable: str = "x",
    ax: Axes | None = None,
    units: str = "scene",
) -> Axes:
    """Draw attractors into a sweep diagram.

    The legend texts of the attractors contain their shares of the initial states, with 95 % bounds. The function does
    not draw the legend.

    Parameters
    ----------
    attractors : tuple or list of Attractor
        Attractors of one scene, as `jaxvibro.find_attractors` returns them. Unresolved entries are not drawn.
    value : float
        Value of the swept parameter, in the units of the Axes.
    variable : {"x", "v"}, optional
        Position or velocity on the section.
    ax : Axes, optional
        Axes of the diagram. None makes a new figure.
    units : {"scene", "physical"}, optional
        Units of the axes. ``"physical"`` requires a scene with scales.

    Returns
    -------
    Axes
        Axes with the drawing.

    Raises
    ------
    ArgumentError
        If `attractors` is not a tuple or list of `Attractor` records, if `value` is not finite, or if `variable` or
        `units` is unknown.

    See Also
    --------
    diagram : Draw a sweep.
    jaxvibro.find_attractors : Find the attractors of a scene.

    Notes
    -----
    Mirror images of each other have markers of the same shape: the first is open, the second filled. A chaotic
    attractor is a column of ticks to the left of the value, and its mirror image is a column of ticks to the right.

    Examples
    --------
    >>> attractors = jv.find_attractors(scene, starts=20, settle=50)
    >>> ax = jv.plot.mark(tuple(attractors), 2.0)
    >>> len(ax.lines) > 1
    True
    """
    require_records("mark", Attractor, attractors)
    require_finite_position(value)
    require_choice("variable", variable, ("x", "v"))
    y_factor_by_attractor = [variable_axis(scales_of(attractor, units), variable).factor for attractor in attractors]
    ax = axes_or_new(ax)
    marker_by_index: dict[int, Any] = {}
    ax.axvline(value, color=WALL_COLOUR, linewidth=0.8, linestyle=":", zorder=0)
    for attractor_index, attractor in enumerate(attractors):
        if attractor.kind == "unresolved":
            continue
        mirror_index = attractor_index if attractor.mirror_of is None else attractor.mirror_of
        first_image_index = min(attractor_index, mirror_index)
        marker = marker_by_index.setdefault(first_image_index, MARKERS[len(marker_by_index) % len(MARKERS)])
        y = y_factor_by_attractor[attractor_index] * attractor.points[:, "xv".index(variable)]
        if attractor.kind == "chaotic":
            marker_style: dict[str, Any] = {
                "marker": TICKLEFT if attractor_index == first_image_index else TICKRIGHT,
                "markeredgewidth": 0.3,
                "zorder": 4,
            }
        else:
            marker_style = {
                "marker": marker,
                "markerfacecolor": "white" if attractor_index == first_image_index else "black",
                "zorder": 5,
            }
        legend_text = f"{attractor.label}, {format_share(attractor)}"
        ax.plot(
            np.full(len(y), value),
            y,
            color="black",
            markersize=5.5,
            linestyle="none",
            label=legend_text,
            **marker_style,
        )
    return ax
