"""Draw sweep diagrams: a coordinate of the stroboscopic section against the parameter, one colour per leg."""

import numpy as np
import xarray as xr
from matplotlib.axes import Axes
from matplotlib.markers import TICKLEFT, TICKRIGHT

from ..attractors.basin_fraction_bounds import format_share
from ..attractors.find import Attractor
from ..scene.check import check_finite_float, require_choice
from .style import (
    COLOURS,
    WALL_COLOUR,
    add_legend,
    axes_or_new,
    axes_width_in_points,
    check_plot_options,
    draw_fixed_walls,
    escape_formulas,
    fixed_wall_positions,
    lighten,
    parameter_axis,
    require_dataset,
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
    first_dot_size = float(np.clip(DOT_SPACING * axes_width_in_points(ax) / len(swept[step_dim]), *DOT_SIZES))
    for leg_index, sweep_leg in enumerate(sweep_legs, n_earlier_legs):
        x = np.broadcast_to(x_axis.factor * sweep_leg[parameter_name].values[:, None], sweep_leg[variable].shape)
        y = y_axis.factor * sweep_leg[variable].transpose(step_dim, "period").values
        has_leg_label = leg_dims and leg_dims[0] in sweep_leg.coords
        leg_label = f"{sweep_leg[leg_dims[0]].values}: " if has_leg_label else ""
        legend_text = escape_formulas(leg_label) + f"from {x[0, 0]:g} to {x[-1, 0]:g}"
        _draw_dots(ax, x, y, leg_index, first_dot_size, legend_text, faint)
    if variable == "x":
        draw_fixed_walls(ax, [y_axis.factor * position for position in fixed_wall_positions(swept.attrs)])
    ax.set(xlabel=x_axis.label, ylabel=y_axis.label)
    ax.margins(x=0.01)
    add_legend(ax, is_new_axes)
    return ax


def _draw_dots(ax, x, y, leg_index, first_dot_size, legend_text, is_faint):
    dot_size, dot_colour = first_dot_size * LEG_SIZE_RATIO ** min(leg_index, 2), COLOURS[leg_index % len(COLOURS)]
    if is_faint:
        dot_size, dot_colour = FAINT_SIZE_RATIO * dot_size, lighten(dot_colour)
    dot_style = {
        "linestyle": "none",
        "marker": "o",
        "markeredgewidth": 0,
        "color": dot_colour,
        "zorder": 2.0 if is_faint else 4.0,
    }
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
    return mark_motions(attractors, value, variable, ax, units, MARKERS, _attractor_mark)


def _attractor_mark(attractor, marker, is_first_image, has_mirror_image):
    """Return (points on the section, style) of an attractor in a diagram; None if it is not drawn."""
    if attractor.kind == "unresolved":
        return None
    mark_style = {"color": "black", "label": f"{attractor.label}, {format_share(attractor)}"}
    if attractor.kind == "chaotic":
        mark_style |= {"marker": TICKLEFT if is_first_image else TICKRIGHT, "markeredgewidth": 0.3, "zorder": 4}
    else:
        mark_style |= {"marker": marker, "markerfacecolor": "white" if is_first_image else "black", "zorder": 5}
    return attractor.points, mark_style


def mark_motions(motions, value, variable, ax, units, markers, describe_mark):
    """Draw the points of motions on the section into a sweep diagram; return the Axes.

    Parameters
    ----------
    motions : sequence of Attractor or Orbit
        Motions of one scene. Mirror images of each other have the same marker.
    value : float
        Value of the swept parameter, in the units of the Axes.
    variable : {"x", "v"}
        Position or velocity on the section.
    ax : Axes or None
        Axes of the diagram. None makes a new figure.
    units : {"scene", "physical"}
        Units of the axes.
    markers : str
        Markers of the motions, in order.
    describe_mark : callable
        Function of a motion, its marker and two bools: True for the first of two mirror images, and True if another
        motion is the mirror image. It returns the points, shape (points, 2), and the style of the markers, or None for
        a motion that is not drawn.

    Raises
    ------
    ArgumentError
        If `value` is not finite, or if `variable` or `units` is unknown.
    """
    check_finite_float("value", value)
    require_choice("variable", variable, ("x", "v"))
    y_factors = [variable_axis(scales_of(motion, units), variable).factor for motion in motions]
    ax = axes_or_new(ax)
    ax.axvline(value, color=WALL_COLOUR, linewidth=0.8, linestyle=":", zorder=0)
    marker_by_index: dict[int, str] = {}  # of the first of two mirror images
    for index, (motion, y_factor) in enumerate(zip(motions, y_factors, strict=True)):
        mirror_index = index if motion.mirror_of is None else motion.mirror_of
        first_index = min(index, mirror_index)
        is_first_image = first_index not in marker_by_index
        marker = marker_by_index.get(first_index, markers[len(marker_by_index) % len(markers)])
        points_and_style = describe_mark(motion, marker, is_first_image, mirror_index != index)
        if points_and_style is not None:
            marker_by_index[first_index] = marker
            points, mark_style = points_and_style
            y = y_factor * points[:, "xv".index(variable)]
            ax.plot(np.full(len(y), value), y, markersize=5.5, linestyle="none", **mark_style)
    return ax
