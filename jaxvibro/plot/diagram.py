"""Draw sweep diagrams: a coordinate of the stroboscopic section against the parameter, one colour per leg."""

from typing import Any

import numpy as np
import xarray as xr
from matplotlib.axes import Axes
from matplotlib.markers import TICKLEFT, TICKRIGHT

from ..attractors.find import Attractor
from ..attractors.shares import share_text
from ..scene.check import require_choice
from .style import (
    COLOURS,
    WALL_COLOUR,
    add_legend,
    axes_or_new,
    checked_picture,
    escape_formulas,
    lighten,
    parameter_axis,
    require_dataset,
    require_records,
    require_value,
    scales_of,
    variable_axis,
)

DOT_SIZES = 2.2, 3.6  # points, smallest and largest dot of the first leg; between them the size follows the spacing
DOT_SPACING = 0.7  # fraction of the distance between two values
LEG_SIZE_RATIO = 0.5  # relative to the previous leg: where legs agree, a ring of the larger dot stays visible
FAINT_SIZE_RATIO = 0.7  # relative to the size of other dots
MARKERS = "osD^vP*X"
SWEEP_GID = "swept"  # group id of the dots of sweeps


@checked_picture
def diagram(
    swept: xr.Dataset, variable: str = "x", ax: Axes | None = None, faint: bool = False, units: str = "scene"
) -> Axes:
    """Draw a coordinate of a sweep against its parameter.

    A dimension besides the parameter and ``period``, such as ``lane`` or ``leg``, makes one leg of each of its entries.
    Each leg has its own colour and dot size.

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
    is_new, scales = ax is None, scales_of(swept, units)
    ax, parameter = axes_or_new(ax), swept.attrs["swept"]
    x_axis, y_axis = parameter_axis(scales, parameter), variable_axis(scales, variable)
    step, *leg_dims = (dim for dim in swept[variable].dims if dim != "period")
    legs = (
        [swept]
        if not leg_dims
        else [swept.isel({leg_dims[0]: leg_index}) for leg_index in range(swept.sizes[leg_dims[0]])]
    )
    n_earlier_legs = sum(line.get_gid() == SWEEP_GID and np.size(line.get_xdata()) > 0 for line in ax.lines)
    first_size = float(np.clip(DOT_SPACING * _axes_width(ax) / len(swept[step]), *DOT_SIZES))
    for leg_index, leg in enumerate(legs, n_earlier_legs):
        x = np.broadcast_to(x_axis.factor * leg[parameter].values[:, None], leg[variable].shape)
        y = y_axis.factor * leg[variable].transpose(step, "period").values
        _draw_dots(
            ax, x, y, leg_index, first_size, _leg_prefix(leg, leg_dims) + f"from {x[0, 0]:g} to {x[-1, 0]:g}", faint
        )
    if variable == "x":
        _draw_walls(ax, swept.attrs, y_axis.factor)
    ax.set(xlabel=x_axis.label, ylabel=y_axis.label)
    ax.margins(x=0.01)
    add_legend(ax, is_new)
    return ax


def _leg_prefix(leg, leg_dims):
    return escape_formulas(f"{leg[leg_dims[0]].values}: ") if leg_dims and leg_dims[0] in leg.coords else ""


def _draw_walls(ax, attrs, factor):
    lower, upper = ax.get_ylim()
    tolerance = (upper - lower) / 4
    for side in ("left", "right"):
        position = attrs.get(f"{side}.position")
        is_fixed = position is not None and f"{side}.motion.amplitude" not in attrs
        if is_fixed and lower - tolerance <= factor * position <= upper + tolerance:
            ax.axhline(factor * position, color=WALL_COLOUR, linewidth=0.8, zorder=0)


def _axes_width(ax):
    """Return the width of Axes in points."""
    return 72.0 * ax.figure.get_figwidth() * ax.get_position().width


def _draw_dots(ax, x, y, leg_index, first_size, text, faint):
    size, colour = first_size * LEG_SIZE_RATIO ** min(leg_index, 2), COLOURS[leg_index % len(COLOURS)]
    style = {"linestyle": "none", "marker": "o", "markeredgewidth": 0, "color": lighten(colour) if faint else colour}
    size, style["zorder"] = (FAINT_SIZE_RATIO * size, 2.0) if faint else (size, 4.0)
    ax.plot(x.ravel(), y.ravel(), markersize=size, rasterized=True, label="_" + text, gid=SWEEP_GID, **style)
    ax.plot([], [], markersize=7 / (1 + 0.4 * leg_index), label=text, **style)


@checked_picture
def mark(
    attractors: tuple[Attractor, ...] | list[Attractor],
    value: float,
    variable: str = "x",
    ax: Axes | None = None,
    units: str = "scene",
) -> Axes:
    """Draw attractors into a sweep diagram.

    The legend lists their shares of the initial states, with 95 % bounds.

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
    Mirror images of each other have the same shape: the first is open, the second filled. A chaotic attractor is a row
    of ticks to the left of the value, and its mirror image a row to the right.

    Examples
    --------
    >>> attractors = jv.find_attractors(scene, starts=20, settle=50)
    >>> ax = jv.plot.mark(tuple(attractors), 2.0)
    >>> len(ax.lines) > 1
    True
    """
    require_records("mark", Attractor, attractors)
    require_value(value)
    require_choice("variable", variable, ("x", "v"))
    factors = [variable_axis(scales_of(attractor, units), variable).factor for attractor in attractors]
    ax = axes_or_new(ax)
    markers: dict[int, Any] = {}
    ax.axvline(value, color=WALL_COLOUR, linewidth=0.8, linestyle=":", zorder=0)
    for index, attractor in enumerate(attractors):
        if attractor.kind == "unresolved":
            continue
        mirror_index = index if attractor.mirror_of is None else attractor.mirror_of
        first_index = min(index, mirror_index)
        marker = markers.setdefault(first_index, MARKERS[len(markers) % len(MARKERS)])
        y = factors[index] * attractor.points[:, "xv".index(variable)]
        if attractor.kind == "chaotic":
            marker_style: dict[str, Any] = {
                "marker": TICKLEFT if index == first_index else TICKRIGHT,
                "markeredgewidth": 0.3,
                "zorder": 4,
            }
        else:
            marker_style = {
                "marker": marker,
                "markerfacecolor": "white" if index == first_index else "black",
                "zorder": 5,
            }
        text = f"{attractor.label}, {share_text(attractor)}"
        ax.plot(np.full(len(y), value), y, color="black", markersize=5.5, linestyle="none", label=text, **marker_style)
    return ax
