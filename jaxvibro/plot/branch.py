"""Draw branches of periodic orbits against their parameter, with their special points."""

from itertools import pairwise
from typing import Any

import numpy as np
from jaxtyping import Float
from matplotlib.axes import Axes
from matplotlib.font_manager import FontProperties
from matplotlib.typing import ColorType

from ..branches.branch import KIND_NAMES, Branch
from ..output.labels import translate_label
from .smooth_line import smooth_line
from .style import (
    COLOURS,
    WALL_COLOUR,
    add_legend,
    axes_or_new,
    checked_picture,
    escape_formulas,
    parameter_axis,
    require_axes,
    require_record,
    require_records,
    scaled_line_width,
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


@checked_picture
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
        Quantity on the y axis: ``"x"`` or ``"v"`` at phase 0 of each drive period, or one value per orbit: the largest
        or the least speed before an impact, the least clearance, or the largest ``|x|``.
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
    scales, curves, is_new = scales_of(one, units), one.curves(variable), ax is None
    x_axis, y_axis = parameter_axis(scales, one.name), variable_axis(scales, variable)
    ax, branch_label = axes_or_new(ax), branch_name(one)
    label_colours = {
        str(line.get_label()).lstrip("_"): line.get_color() for line in ax.lines if line.get_gid() == "branch"
    }
    colour = colour or label_colours.get(branch_label, BRANCH_COLOURS[len(label_colours) % len(BRANCH_COLOURS)])
    covering_lines, has_new_line = [], False
    for piece in curves.pieces:
        line_style: dict[str, Any] = {
            "color": colour,
            "linewidth": scaled_line_width(LINE_WIDTHS[piece.stable]),
            "linestyle": LINE_STYLES[piece.stable],
            "zorder": 3,
        }
        for x_part, y_part in _split_at_turns(piece, curves.points.get("SB") if variable not in ("x", "v") else None):
            line = smooth_line(x_part * x_axis.factor, y_part * y_axis.factor)
            covering_line = find_covering_line(ax, line[0], line[1], line_style["linewidth"])
            covering_lines += [] if covering_line is None else [covering_line]
            if covering_line is None:
                has_new_line = True
                ax.plot(*line, label="_" + branch_label, gid="branch", solid_capstyle="butt", **line_style)
    if branch_label not in label_colours:
        legend_text, legend_colour = (
            (branch_label, colour)
            if has_new_line or not covering_lines
            else (f"{branch_label}, on {_line_label(covering_lines[0])}", covering_lines[0].get_color())
        )
        ax.plot(
            [], [], label=legend_text, gid="branch", color=legend_colour, linewidth=scaled_line_width(LINE_WIDTHS[True])
        )
    add_stability_legend(ax)
    _draw_special_points(ax, curves.points, x_axis.factor, y_axis.factor, labels)
    if variable in ("x", "peak"):
        _draw_walls(ax, one, y_axis.factor)
    ax.set(xlabel=x_axis.label, ylabel=y_axis.label)
    ax.margins(x=0.01)
    add_legend(ax, is_new)
    return ax


def _split_at_turns(piece, turning_marks):
    """Yield (values, column) of each line of a `Piece`, cut at the `Marks` where it turns back on itself.

    On the two sides of a symmetry breaking the orbits are mirror images. None as `turning_marks` cuts nowhere.
    """
    cut_indices = [] if turning_marks is None else np.flatnonzero(np.isin(piece.values, turning_marks.values))
    breaks = [0, *(int(index) for index in cut_indices if 0 < index < len(piece.values) - 1), len(piece.values) - 1]
    for column in piece.columns.T:
        for start, stop in pairwise(breaks):
            yield piece.values[start : stop + 1], column[start : stop + 1]


def find_covering_line(ax: Axes, x: Float[np.ndarray, " points"], y: Float[np.ndarray, " points"], width: float) -> Any:
    """Find a line of a branch of this width in the Axes that covers all points of a new line; None without one."""
    points = np.stack([x, y])[:, np.isfinite(y)]
    points = points[:, :: max(1, points.shape[1] // MAX_CHECK_POINTS)]
    for line in ax.lines:
        if line.get_gid() != "branch" or line.get_linewidth() != width or not points.size:
            continue
        line_points = np.array(line.get_data(), float)
        if line_points.shape[1] > 1 and _lies_on_line(points, line_points):
            return line
    return None


def _lies_on_line(points, line_points):
    """Return True if points lie on a line, both of shape (2, points), within `OVERLAP_TOLERANCE` of its extent."""
    extent = np.maximum(np.nanmax(line_points, axis=1) - np.nanmin(line_points, axis=1), np.ptp(points, axis=1))[
        :, None
    ]
    extent = np.where(extent > 0, extent, 1.0)
    points, line_points = points / extent, line_points / extent
    starts, directions = line_points[:, :-1, None], np.diff(line_points, axis=1)[:, :, None]
    squared_lengths = (directions**2).sum(axis=0)
    offsets = points[:, None, :] - starts
    with np.errstate(invalid="ignore", divide="ignore"):
        fraction = np.clip(
            np.where(squared_lengths > 0, (offsets * directions).sum(axis=0) / squared_lengths, 0.0), 0.0, 1.0
        )
    distances = np.hypot(*(offsets - fraction * directions))
    return bool((np.where(np.isnan(distances), np.inf, distances).min(axis=0) < OVERLAP_TOLERANCE).all())


def _line_label(line):
    return str(line.get_label()).lstrip("_")


def branch_name(branch):
    """Return the distinct labels of the segments of a branch in order: "P100, P111"."""
    return ", ".join(dict.fromkeys(segment.label for segment in branch.segments))


def add_stability_legend(ax):
    """Add the legend entries of stable and unstable lines, once in the Axes."""
    if not any(line.get_gid() == "stability" for line in ax.lines):
        for stable, text in ((True, "stable"), (False, "unstable")):
            line_style = {
                "color": WALL_COLOUR,
                "linewidth": scaled_line_width(LINE_WIDTHS[stable]),
                "linestyle": LINE_STYLES[stable],
            }
            ax.plot([], [], label=text, gid="stability", **line_style)


def _draw_special_points(ax, points, x_factor, y_factor, labels):
    known_labels = [line.get_label() for line in ax.lines if line.get_gid() == "special"]
    for kind, marks in points.items():
        y = y_factor * marks.columns
        x = np.broadcast_to(x_factor * marks.values[:, None], y.shape)
        text = escape_formulas(f"{translate_label(kind, labels)}: {KIND_NAMES[kind]}" if kind in KIND_NAMES else kind)
        legend_text = text if text not in known_labels else "_" + text
        marker_style = {
            "marker": _kind_marker(kind),
            "markersize": 5.5,
            "markerfacecolor": MARKER_COLOUR,
            "markeredgecolor": "black",
        }
        ax.plot(x.ravel(), y.ravel(), label=legend_text, gid="special", linestyle="none", zorder=7, **marker_style)


def _kind_marker(kind):
    """Return the marker of a kind; that of a monitor depends on its name only and is the same in every figure."""
    return MARKERS.get(kind) or MONITOR_MARKERS[sum(map(ord, kind)) % len(MONITOR_MARKERS)]


def _draw_walls(ax, branch, factor):
    """Draw each fixed wall once as a line, unless the parameter moves it or it is far from the drawing."""
    lower, upper = ax.get_ylim()
    tolerance = (upper - lower) / 4
    known_positions = [
        line.get_ydata()[0] for line in ax.lines if line.get_color() == WALL_COLOUR and len(line.get_ydata())
    ]
    for side, wall in branch.scene.walls.items():
        if wall.motion is not None or branch.name == f"{side}.position":
            continue
        position = factor * float(wall.position)
        if position not in known_positions and lower - tolerance <= position <= upper + tolerance:
            ax.axhline(position, color=WALL_COLOUR, linewidth=0.8, zorder=0)


@checked_picture
def mark_points(
    branches: tuple[Branch, ...] | list[Branch], ax: Axes, units: str = "scene", labels: str = "jaxvibro"
) -> Axes:
    """Write kind and value of the special points of branches along the top of the Axes.

    Points with the same value are written once. Points that lie too close for separate ticks share a tick, which lists
    the first of them.

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
    require_axes(ax)
    lower, upper = ax.get_xlim()
    line_spacing = _tick_line_width(ax) * (upper - lower)
    digits = max(0, 3 - int(np.floor(np.log10(upper - lower))))  # resolves about a thousandth of the range
    factors = [parameter_axis(scales_of(branch, units), branch.name).factor for branch in branches]
    points = [
        (item.kind, factor * item.value)
        for branch, factor in zip(branches, factors, strict=True)
        for item in branch.special
    ]
    unique_points = {(kind, f"{value:.{digits}f}"): value for kind, value in points}
    ticks: list[tuple[float, list[str]]] = []  # value, lines
    for (kind, text), value in sorted(unique_points.items(), key=lambda item: item[1]):
        if kind == "EP" or not lower <= value <= upper:
            continue
        if not ticks or value - ticks[-1][0] >= line_spacing * min(MAX_TICK_LINES, len(ticks[-1][1])):
            ticks.append((value, []))
        ticks[-1][1].append(f"{escape_formulas(translate_label(kind, labels))} {text}")
    top_axis = ax.secondary_xaxis("top")
    top_axis.set_xticks(
        [value for value, _ in ticks], [_tick_text(item) for _, item in ticks], rotation=90, fontsize=TICK_FONT_SIZE
    )
    for tick_label, (_, item) in zip(top_axis.get_xticklabels(), ticks, strict=True):
        tick_label.set_horizontalalignment("left" if len(item) > 1 else "center")  # the first line at the tick
    return ax


def _tick_line_width(ax):
    """Return the width of one line of tick text, as a fraction of the width of the Axes."""
    axes_width = ax.figure.get_figwidth() * ax.get_position().width
    return 1.3 * FontProperties(size=TICK_FONT_SIZE).get_size_in_points() / (72.0 * axes_width)


def _tick_text(texts):
    """Return the text of one tick."""
    return "\n".join(
        texts
        if len(texts) <= MAX_TICK_LINES
        else [*texts[: MAX_TICK_LINES - 1], f"and {len(texts) - MAX_TICK_LINES + 1} more"]
    )
