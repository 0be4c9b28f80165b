"""Draw branches with one held quantity in the plane of their two parameters."""

from matplotlib.axes import Axes
from matplotlib.typing import ColorType

from ..branches.held_branch import HELD_UNITS, HeldBranch
from ..output.equal_runs import find_equal_runs
from ..output.units import quantity_text
from .branch import LINE_STYLES, LINE_WIDTHS, add_stability_legend
from .plane_axes import artist_gid, artists_of_kind, prepare_plane
from .smooth_line import smooth_line
from .style import COLOURS, add_legend, axes_or_new, check_plot_options, rc_scaled_line_width, require_record, scales_of

HELD_GID = "held"
HELD_COLOURS = tuple(COLOURS[k] for k in (6, 3, 5, 7, 0))  # ordered so that they differ from those of loci


@check_plot_options
def held(one: HeldBranch, ax: Axes | None = None, colour: ColorType | None = None, units: str = "scene") -> Axes:
    """Draw a branch with one held quantity in the plane of its two parameters.

    The first parameter is on the x axis, the second on the y axis. Stable parts are solid and thick, unstable parts are
    dashed and thin.

    Parameters
    ----------
    one : HeldBranch
        Branch to draw.
    ax : Axes, optional
        Axes to draw into. None makes a new figure, whose Axes get a legend. The Axes may hold loci of the same
        parameters.
    colour : colour, optional
        Colour of the line. None takes the colour of a curve with the same legend text in these Axes, else the next
        colour of the cycle.
    units : {"scene", "physical"}, optional
        Units of the axes. ``"physical"`` requires a scene with scales.

    Returns
    -------
    Axes
        Axes with the drawing.

    Raises
    ------
    ArgumentError
        If `one` is not a `HeldBranch`, if the Axes hold curves of other parameters or of the same parameters in the
        other order, or if `units` is unknown.

    See Also
    --------
    jaxvibro.follow : Continue a periodic orbit; `hold` fixes a quantity.
    locus : Draw a locus in the same plane.

    Examples
    --------
    >>> bounds = {"amplitude": (1.5, 2.5), "frequency": (2.05, 2.15)}
    >>> held = jv.follow(orbit, ("amplitude", "frequency"), bounds, hold={"least_speed": 1.9})
    >>> ax = jv.plot.held(held)
    >>> ax.get_ylabel()[:15]
    'drive frequency'
    """
    require_record("held", HeldBranch, one)
    is_new_axes = ax is None
    ax, axis_factors = prepare_plane(axes_or_new(ax), one.names, scales_of(one, units))
    legend_text = f"{one.held} {quantity_text(scales_of(one, units), HELD_UNITS[one.held], one.value)} of {one.label}"
    colour_by_label = {
        str(line.get_label()).lstrip("_"): line.get_color() for line in artists_of_kind(ax.lines, HELD_GID)
    }
    colour = colour or colour_by_label.get(legend_text, HELD_COLOURS[len(colour_by_label) % len(HELD_COLOURS)])
    line_points, is_stable_interval = one.values * axis_factors, one.stable[:-1] & one.stable[1:]
    for first_row, last_row in find_equal_runs(is_stable_interval):
        is_stable_run = bool(is_stable_interval[first_row])
        ax.plot(
            *smooth_line(*line_points[first_row : last_row + 1].T),
            label="_" + legend_text,
            gid=artist_gid(HELD_GID, one.names),
            color=colour,
            linewidth=rc_scaled_line_width(LINE_WIDTHS[is_stable_run]),
            linestyle=LINE_STYLES[is_stable_run],
            zorder=4,
        )
    if legend_text not in colour_by_label:
        ax.plot(
            [],
            [],
            label=legend_text,
            gid=artist_gid(HELD_GID, one.names),
            color=colour,
            linewidth=rc_scaled_line_width(LINE_WIDTHS[True]),
        )
    add_stability_legend(ax)
    add_legend(ax, is_new_axes)
    return ax
