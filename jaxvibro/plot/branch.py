"""Draw branches of periodic orbits against their parameter, with their special points."""

from itertools import pairwise
from typing import Any

import numpy as np
from jaxtyping import Float
from matplotlib.axes import Axes
from matplotlib.font_manager import FontProperties
from matplotlib.typing import ColorType

from ..branches.branch import KIND_NAMES, Branch
from ..output.label_codes import translate_label
from ..scene.check import ArgumentError
from .smooth_line import smooth_line
from .style import (
    COLOURS,
    WALL_COLOUR,
    add_legend,
    axes_or_new,
    axes_width_in_points,
    check_plot_options,
    draw_fixed_walls,
    escape_formulas,
    label_once,
    parameter_axis,
    rc_scaled_line_width,
    require_record,
    require_records,
    scales_of,
    variable_axis,
)

BRANCH_COLOURS = tuple(COLOURS[k] for k in (2, 7, 5, 3, 0, 6, 1))  # yellow is too pale for a line
BRANCH_COLOURS += ("#882255", "#999933", "#332288", "#44AA99")  # from Tol's palette, for further branches
LINE_WIDTHS = {True: 2.0, False: 0.9}  # points, of stable and of unstable parts
LINE_STYLES = {True: "-", False: (0, (4, 2))}
MARKERS = {
    "SN": "o",
    "SB": "D",
    "BP": "s",
    "PD": "^",
    "GR": "v",
    "NS": "P",
    "NSA": "X",
    "CH": "H",
    "RL": "8",
    "R3": "<",
    "R4": "d",
}
MARKER_COLOUR = COLOURS[4]  # of special points; attractors are white or black
MONITOR_MARKERS = "XP*pdh<>"  # of points of user-defined monitors
MAX_TICK_LINES = 3  # lines of text per tick
MAX_CHECK_POINTS = 64  # points of a new line that are compared with other lines
OVERLAP_TOLERANCE = 1e-3  # relative to the extent: lines that are closer are drawn once
TICK_FONT_SIZE = "x-small"  # of the tick texts


@check_plot_options
def branch(
    one: Branch,
    variable: str = "x",
    ax: Axes | None = None,
    colour: ColorType | None = None,
    units: str = "scene",
    labels: str = "jaxvibro",
) -> Axes:
    """Draw one variable of a branch against its parameter.

    Stable parts are solid and thick, unstable parts dashed and thin. Each kind of special point has its own marker; the
    ends of the branch have none.

    Parameters
    ----------
    one : Branch
        Branch to draw.
    variable : {"x", "v", "speed", "least_speed", "clearance", "peak"}, optional
        Quantity on the y axis. ``"x"`` and ``"v"`` are the position and velocity at phase 0 of each drive period. The
        others are one value per orbit: the largest or least speed before an impact, the least clearance, or the largest
        ``|x|``.
    ax : Axes, optional
        Axes to draw into. None makes a new figure, whose Axes get a legend.
    colour : colour, optional
        Colour of the lines. None takes the colour of a branch with the same labels in these Axes, else the next colour
        of the cycle.
    units : {"scene", "physical"}, optional
        Units of the axes. ``"physical"`` requires a scene with scales.
    labels : str, optional
        Label system of the special points, as in `Branch.table`.

    Returns
    -------
    Axes
        Axes with the drawing.

    Raises
    ------
    ArgumentError
        If `one` is not a `Branch`, if `variable`, `units` or `labels` is unknown, or if `units` is ``"physical"`` and
        the scene has no scales.

    See Also
    --------
    jaxvibro.follow : Continue a periodic orbit in one parameter.
    mark_points : Write the special points along the top of the Axes.

    Notes
    -----
    A line breaks where an impact crosses phase 0: the velocity jumps there, although the branch continues. Lines are
    splines through the computed points. A line that coincides with a line of another branch, such as the speed of a
    mirror image, is drawn once, because two dashed lines on each other look solid.

    Examples
    --------
    >>> ax = jv.plot.branch(branch, "speed")
    >>> ax.get_xlabel()[:15]
    'drive amplitude'
    """
    require_record("branch", Branch, one)
    scales, branch_curves, is_new_axes = scales_of(one, units), one.curves(variable), ax is None
    x_axis, y_axis = parameter_axis(scales, one.name), variable_axis(scales, variable)
    ax, branch_label = axes_or_new(ax), branch_name(one)
    colour_by_label = {
        str(line.get_label()).lstrip("_"): line.get_color() for line in ax.lines if line.get_gid() == "branch"
    }
    colour = colour or colour_by_label.get(branch_label, BRANCH_COLOURS[len(colour_by_label) % len(BRANCH_COLOURS)])
    covering_lines, has_uncovered_line = [], False
    for curve_piece in branch_curves.pieces:
        line_width = rc_scaled_line_width(LINE_WIDTHS[curve_piece.stable])
        for x_part, y_part in _split_at_sb_points(
            curve_piece, branch_curves.points.get("SB") if variable not in ("x", "v") else None
        ):
            line = smooth_line(x_part * x_axis.factor, y_part * y_axis.factor)
            covering_line = find_covering_line(ax, line[0], line[1], line_width)
            covering_lines += [] if covering_line is None else [covering_line]
            if covering_line is None:
                has_uncovered_line = True
                ax.plot(
                    *line,
                    label="_" + branch_label,
                    gid="branch",
                    color=colour,
                    linewidth=line_width,
                    linestyle=LINE_STYLES[curve_piece.stable],
                    solid_capstyle="butt",
                    zorder=3,
                )
    if branch_label not in colour_by_label:
        legend_text, legend_colour = (
            (branch_label, colour)
            if has_uncovered_line or not covering_lines
            else (f"{branch_label}, on {_line_label(covering_lines[0])}", covering_lines[0].get_color())
        )
        ax.plot(
            [],
            [],
            label=legend_text,
            gid="branch",
            color=legend_colour,
            linewidth=rc_scaled_line_width(LINE_WIDTHS[True]),
        )
    add_stability_legend(ax)
    _draw_special_points(ax, branch_curves.points, x_axis.factor, y_axis.factor, labels)
    if variable in ("x", "peak"):
        draw_fixed_walls(ax, [y_axis.factor * position for position in _positions_of_unmoved_walls(one)])
    ax.set(xlabel=x_axis.label, ylabel=y_axis.label)
    ax.margins(x=0.01)
    add_legend(ax, is_new_axes)
    return ax


def _split_at_sb_points(curve_piece, sb_points):
    """Yield (parameter values, ordinates) of the lines of a `Piece`, cut at the points of symmetry breaking.

    Orbits on the two sides of a symmetry breaking are mirror images, so that their lines may coincide. `sb_points`
    contains the points of symmetry breaking. If `sb_points` is None, the lines are not cut.
    """
    cut_indices = [] if sb_points is None else np.flatnonzero(np.isin(curve_piece.values, sb_points.values))
    part_boundary_indices = [
        0,
        *(int(index) for index in cut_indices if 0 < index < len(curve_piece.values) - 1),
        len(curve_piece.values) - 1,
    ]
    for y_values in curve_piece.columns.T:
        for first_index, last_index in pairwise(part_boundary_indices):
            yield curve_piece.values[first_index : last_index + 1], y_values[first_index : last_index + 1]


def find_covering_line(
    ax: Axes, x: Float[np.ndarray, " points"], y: Float[np.ndarray, " points"], required_line_width: float
) -> Any:
    """Find a branch line of this width in the Axes that covers all points of a new line; None if no line does."""
    new_line_data = np.stack([x, y])[:, np.isfinite(y)]
    new_line_data = new_line_data[:, :: max(1, new_line_data.shape[1] // MAX_CHECK_POINTS)]
    for line in ax.lines:
        if line.get_gid() != "branch" or line.get_linewidth() != required_line_width or not new_line_data.size:
            continue
        drawn_line_data = np.array(line.get_data(), float)
        if drawn_line_data.shape[1] > 1 and _lies_on_line(new_line_data, drawn_line_data):
            return line
    return None


def _lies_on_line(new_line_data, drawn_line_data):
    """Return True if points lie on a line, within `OVERLAP_TOLERANCE` of the extent; both have shape (2, points)."""
    extent_per_axis = np.maximum(
        np.nanmax(drawn_line_data, axis=1) - np.nanmin(drawn_line_data, axis=1), np.ptp(new_line_data, axis=1)
    )[:, None]
    extent_per_axis = np.where(extent_per_axis > 0, extent_per_axis, 1.0)
    new_line_data, drawn_line_data = new_line_data / extent_per_axis, drawn_line_data / extent_per_axis
    segment_starts, segment_vectors = drawn_line_data[:, :-1, None], np.diff(drawn_line_data, axis=1)[:, :, None]
    squared_segment_lengths = (segment_vectors**2).sum(axis=0)
    offsets_from_starts = new_line_data[:, None, :] - segment_starts
    with np.errstate(invalid="ignore", divide="ignore"):
        segment_fraction = np.clip(
            np.where(
                squared_segment_lengths > 0,
                (offsets_from_starts * segment_vectors).sum(axis=0) / squared_segment_lengths,
                0.0,
            ),
            0.0,
            1.0,
        )
    distances = np.hypot(*(offsets_from_starts - segment_fraction * segment_vectors))
    return bool((np.where(np.isnan(distances), np.inf, distances).min(axis=0) < OVERLAP_TOLERANCE).all())


def _line_label(line):
    return str(line.get_label()).lstrip("_")


def branch_name(branch):
    """Return the distinct labels of the segments of a branch in order: "P100, P111"."""
    return ", ".join(dict.fromkeys(segment.label for segment in branch.segments))


def add_stability_legend(ax):
    """Add the legend entries of stable and unstable lines, once in the Axes."""
    if not any(line.get_gid() == "stability" for line in ax.lines):
        for is_stable, text in ((True, "stable"), (False, "unstable")):
            ax.plot(
                [],
                [],
                label=text,
                gid="stability",
                color=WALL_COLOUR,
                linewidth=rc_scaled_line_width(LINE_WIDTHS[is_stable]),
                linestyle=LINE_STYLES[is_stable],
            )


def _draw_special_points(ax, points_by_kind, x_factor, y_factor, label_system):
    for kind, kind_points in points_by_kind.items():
        y = y_factor * kind_points.columns
        x = np.broadcast_to(x_factor * kind_points.values[:, None], y.shape)
        kind_text = escape_formulas(
            f"{translate_label(kind, label_system)}: {KIND_NAMES[kind]}" if kind in KIND_NAMES else kind
        )
        ax.plot(
            x.ravel(),
            y.ravel(),
            label=label_once(ax, "special", kind_text),
            gid="special",
            linestyle="none",
            # The marker of a monitor depends only on its name and is the same in all figures.
            marker=MARKERS.get(kind) or MONITOR_MARKERS[sum(map(ord, kind)) % len(MONITOR_MARKERS)],
            markersize=5.5,
            markerfacecolor=MARKER_COLOUR,
            markeredgecolor="black",
            zorder=7,
        )


def _positions_of_unmoved_walls(branch):
    """Return the positions of the fixed walls that the parameter of a branch does not move."""
    return [
        float(wall.position)
        for side, wall in branch.scene.walls.items()
        if wall.motion is None and branch.name != f"{side}.position"
    ]


@check_plot_options
def mark_points(
    branches: tuple[Branch, ...] | list[Branch], ax: Axes, units: str = "scene", labels: str = "jaxvibro"
) -> Axes:
    """Write kind and value of the special points of branches along the top of the Axes.

    Points of the same kind and value are written once. Points that are too close for separate ticks share a tick, which
    lists the first of these points. The ends of branches and points outside the range of the x axis are omitted.

    Parameters
    ----------
    branches : tuple or list of Branch
        Branches with the special points.
    ax : Axes
        Axes into which the branches are drawn.
    units : {"scene", "physical"}, optional
        Units of the axes. ``"physical"`` requires scenes with scales.
    labels : str, optional
        Label system of the special points, as in `Branch.table`.

    Returns
    -------
    Axes
        The same Axes.

    Raises
    ------
    ArgumentError
        If `branches` is not a tuple or list of `Branch` records, if `ax` is not an Axes, or if `units` or `labels` is
        unknown.

    See Also
    --------
    branch : Draw one variable of a branch.

    Examples
    --------
    >>> ax = jv.plot.mark_points([branch], jv.plot.branch(branch))
    >>> ax.get_ylabel()[:8]
    'position'
    """
    require_records("mark_points", Branch, branches)
    if not isinstance(ax, Axes):
        raise ArgumentError("ax", "must be an Axes of matplotlib", ax)
    x_min, x_max = ax.get_xlim()
    tick_line_spacing = _tick_width_fraction(ax) * (x_max - x_min)
    n_decimals = max(0, 3 - int(np.floor(np.log10(x_max - x_min))))  # resolves about a thousandth of the range
    x_factor_by_branch = [parameter_axis(scales_of(branch, units), branch.name).factor for branch in branches]
    kinds_and_values = [
        (special_point.kind, x_factor * special_point.value)
        for branch, x_factor in zip(branches, x_factor_by_branch, strict=True)
        for special_point in branch.special
    ]
    value_by_kind_and_text = {(kind, f"{value:.{n_decimals}f}"): value for kind, value in kinds_and_values}
    ticks_with_lines: list[tuple[float, list[str]]] = []  # value, lines
    for (kind, value_text), value in sorted(value_by_kind_and_text.items(), key=lambda item: item[1]):
        if kind == "EP" or not x_min <= value <= x_max:
            continue
        if not ticks_with_lines or value - ticks_with_lines[-1][0] >= tick_line_spacing * min(
            MAX_TICK_LINES, len(ticks_with_lines[-1][1])
        ):
            ticks_with_lines.append((value, []))
        ticks_with_lines[-1][1].append(f"{escape_formulas(translate_label(kind, labels))} {value_text}")
    top_axis = ax.secondary_xaxis("top")
    top_axis.set_xticks(
        [value for value, _ in ticks_with_lines],
        [_tick_text(tick_lines) for _, tick_lines in ticks_with_lines],
        rotation=90,
        fontsize=TICK_FONT_SIZE,
    )
    for tick_label, (_, tick_lines) in zip(top_axis.get_xticklabels(), ticks_with_lines, strict=True):
        tick_label.set_horizontalalignment("left" if len(tick_lines) > 1 else "center")  # the first line at the tick
    return ax


def _tick_width_fraction(ax):
    """Return the line spacing of vertical tick text, as a fraction of the width of the Axes."""
    return 1.3 * FontProperties(size=TICK_FONT_SIZE).get_size_in_points() / axes_width_in_points(ax)


def _tick_text(text_lines):
    """Return the text of one tick."""
    return "\n".join(
        text_lines
        if len(text_lines) <= MAX_TICK_LINES
        else [*text_lines[: MAX_TICK_LINES - 1], f"and {len(text_lines) - MAX_TICK_LINES + 1} more"]
    )
