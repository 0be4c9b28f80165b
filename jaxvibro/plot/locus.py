"""Draw loci in the plane of their two parameters, and the regions between them."""

from itertools import pairwise

import numpy as np
from matplotlib.axes import Axes
from matplotlib.typing import ColorType

from ..loci.locus import MEANINGS, Locus
from ..output.label_codes import translate_label
from ..scene.check import ArgumentError
from .plane_axes import artist_gid, artists_of_kind, prepare_plane
from .smooth_line import smooth_line
from .style import (
    COLOURS,
    add_legend,
    axes_or_new,
    check_plot_options,
    escape_formulas,
    label_once,
    rc_scaled_line_width,
    require_record,
    scales_of,
)

# Colour and dashes of each kind; the dashes distinguish the kinds without colour.
KIND_STYLES = {
    "SN": (COLOURS[0], "-"),
    "PD": (COLOURS[7], (0, (6, 2))),
    "SB": (COLOURS[5], (0, (7, 2, 1.5, 2))),
    "GR": (COLOURS[2], (0, (1.2, 1.2))),
    "CH": (COLOURS[3], (0, (3, 1, 1, 1, 1, 1))),
    "RL": (COLOURS[1], (0, (10, 3))),
}
LINE_WIDTHS = (2.2, 1.4, 0.8)  # points, of the first, second and further loci of a kind
MARKERS = {"CP": "*", "GPD": "^", "DSB": "D", "GR": "v", "GG": "s", "RG": "o", "SN": "<", "PD": ">", "SB": "d"}
MARKERS |= {"CH": "H", "RL": "8", "DG": "P"}
MARKER_SIZES = {"RG": 9.0}  # points, others have 6; a larger RG stays visible below the end of a locus of GR
MARKER_COLOUR = COLOURS[4]
HATCHES = ("///", "\\\\\\", "...", "xxx", "")
LOCUS_GID, REGION_GID = "locus", "region"


@check_plot_options
def locus(
    one: Locus,
    ax: Axes | None = None,
    colour: ColorType | None = None,
    units: str = "scene",
    labels: str = "jaxvibro",
) -> Axes:
    """Draw a locus in the plane of its two parameters.

    The first parameter is on the x axis, the second on the y axis. Each kind of locus has its own colour and line
    style. Each kind of codimension-two point has its own marker. The ends of the locus have no marker.

    Parameters
    ----------
    one : Locus
        Locus to draw.
    ax : Axes, optional
        Axes to draw into. None makes a new figure, whose Axes get a legend.
    colour : colour, optional
        Colour of the line. None takes the colour of its kind.
    units : {"scene", "physical"}, optional
        Units of the axes. ``"physical"`` requires a scene with scales.
    labels : str, optional
        Label system of the points, as in `Branch.table`.

    Returns
    -------
    Axes
        Axes with the drawing.

    Raises
    ------
    ArgumentError
        If `one` is not a `Locus`, if the Axes hold curves of other parameters or of the same parameters in the other
        order, or if `units` or `labels` is unknown.

    See Also
    --------
    jaxvibro.locus : Continue a special point in two parameters.
    region : Shade the region between two loci.
    held : Draw a branch with one held quantity in the same plane.

    Notes
    -----
    The second locus of a kind in the same Axes has a thinner line than the first. The third and all further loci have
    an even thinner line.

    Examples
    --------
    >>> bounds = {"amplitude": (0.3, 5.0), "frequency": (2.0, 2.2)}
    >>> ax = jv.plot.locus(jv.locus(branch.points("GR")[0], ("amplitude", "frequency"), bounds))
    >>> ax.get_ylabel()[:15]
    'drive frequency'
    """
    require_record("locus", Locus, one)
    is_new_axes = ax is None
    ax, axis_factors = prepare_plane(axes_or_new(ax), one.names, scales_of(one, units))
    legend_text, (kind_colour, kind_dash_pattern) = locus_name(one), KIND_STYLES[one.kind]
    locus_lines = artists_of_kind(ax.lines, LOCUS_GID)
    same_name_lines = [line for line in locus_lines if line.get_label().lstrip("_") == legend_text]
    other_locus_names = {line.get_label().lstrip("_") for line in locus_lines} - {legend_text}
    n_earlier_loci = sum(other_locus_name.startswith(f"{one.kind} ") for other_locus_name in other_locus_names)
    line_width = rc_scaled_line_width(LINE_WIDTHS[min(n_earlier_loci, len(LINE_WIDTHS) - 1)])
    if same_name_lines:
        kind_colour, line_width = same_name_lines[0].get_color(), same_name_lines[0].get_linewidth()
    line_colour = colour or kind_colour
    is_in_legend = any(line.get_color() == line_colour for line in same_name_lines)
    ax.plot(
        *smooth_line(*(one.values * axis_factors).T),
        label=f"_{legend_text}" if is_in_legend else legend_text,
        gid=artist_gid(LOCUS_GID, one.names),
        color=line_colour,
        linestyle=kind_dash_pattern,
        linewidth=line_width,
        zorder=3,
    )
    _draw_codim2_points(ax, one, axis_factors, labels)
    add_legend(ax, is_new_axes)
    return ax


def locus_name(locus):
    """Return the name of a locus.

    Parameters
    ----------
    locus : Locus
        Locus.

    Returns
    -------
    str
        For example ``"SN of P111"``.
    """
    return f"{locus.kind} of {locus.label}"


def _draw_codim2_points(ax, locus, axis_factors, label_system):
    for kind in dict.fromkeys(special.kind for special in locus.special if special.kind != "EP"):
        x, y = (np.array([list(special.values.values()) for special in locus.points(kind)]) * axis_factors).T
        kind_text = f"{translate_label(kind, label_system)}: {MEANINGS.get(kind, f'end of a locus of {kind}')}"
        marker_size = MARKER_SIZES.get(kind, 6.0)
        ax.plot(
            x,
            y,
            label=label_once(ax, "codimension two", kind_text),
            gid="codimension two",
            linestyle="none",
            marker=MARKERS[kind],
            markersize=marker_size,
            markerfacecolor=MARKER_COLOUR,
            markeredgecolor="black",
            zorder=7 - 0.1 * marker_size,
        )


@check_plot_options
def region(
    first: Locus,
    second: Locus,
    text: str,
    ax: Axes | None = None,
    colour: ColorType | None = None,
    units: str = "scene",
) -> Axes:
    """Shade the region between two loci and write a text into it.

    Parameters
    ----------
    first : Locus
        First boundary of the region.
    second : Locus
        Second boundary, over the same two parameters in the same order.
    text : str
        Text inside the region and in the legend.
    ax : Axes, optional
        Axes to draw into. None makes a new figure.
    colour : colour, optional
        Colour of the shade. None takes grey. Five successive regions in the same Axes differ in their hatching; the
        fifth has no hatching.
    units : {"scene", "physical"}, optional
        Units of the axes. ``"physical"`` requires a scene with scales.

    Returns
    -------
    Axes
        Axes with the drawing.

    Raises
    ------
    ArgumentError
        If `first` or `second` is not a `Locus`, if `text` is not a string, if the parameters of the loci differ, if no
        line of constant second parameter meets both loci, if the Axes hold curves of other parameters, or if `units` is
        unknown.

    See Also
    --------
    locus : Draw a locus.

    Notes
    -----
    Consider the line of constant second parameter through a point. The point belongs to the region if the nearest
    crossings of this line with the loci, to the left and to the right of the point, are on different loci.

    Examples
    --------
    >>> bounds = {"amplitude": (0.3, 5.0), "frequency": (2.0, 2.2)}
    >>> names = ("amplitude", "frequency")
    >>> fold, grazing = (jv.locus(branch.points(kind)[0], names, bounds) for kind in ("SN", "GR"))
    >>> ax = jv.plot.region(fold, grazing, "P111")
    >>> ax.texts[0].get_text()
    'P111'
    """
    require_record("region", Locus, first, second)
    if not isinstance(text, str):
        raise ArgumentError("text", "must be a string", text)
    if first.names != second.names:
        raise ArgumentError("second", f"must be a locus in {' and '.join(first.names)}, as the first", second.names)
    ax, axis_factors = prepare_plane(axes_or_new(ax), first.names, scales_of(first, units))
    outlines = _region_outlines(first.values * axis_factors, second.values * axis_factors)
    if not outlines:
        raise ArgumentError("second", f"must share values of {first.names[1]} with the first", repr(second))
    n_earlier_regions = len(
        {region_patch.get_label() for region_patch in artists_of_kind(ax.patches, REGION_GID)} - {"_"}
    )
    for index, outline in enumerate(outlines):
        legend_text = escape_formulas(text) if index == 0 else "_"
        region_patch = ax.fill(
            *outline.T,
            label=legend_text,
            gid=artist_gid(REGION_GID, first.names),
            facecolor=colour or "0.5",
            edgecolor=colour or "0.35",
            hatch=HATCHES[n_earlier_regions % len(HATCHES)],
            alpha=0.22,
            zorder=1,
        )[0]
        region_patch.set_linewidth(0.0)
    x, y = _label_position(outlines)
    box_style = {"facecolor": "white", "edgecolor": "none", "alpha": 0.75, "pad": 1.5}
    ax.text(x, y, escape_formulas(text), ha="center", va="center", zorder=8, fontsize="small", bbox=box_style)
    return ax


def _region_outlines(first_curve, second_curve):
    """Return a list with the corners of each part of the region between two curves, arrays of shape (corners, 2).

    The curves have shape (points, 2). A level is a value of the second parameter at a point of a curve. Between two
    consecutive levels the pieces of both curves are straight. The pieces are sorted from left to right. Two
    neighbouring pieces of different curves bound a part of the region.
    """
    levels = np.unique(np.concatenate([first_curve[:, 1], second_curve[:, 1]]))
    outline_edges, open_outline_edges = [], []
    for lower_level, upper_level in pairwise(levels):
        curve_pieces = [
            (*piece, curve_index)
            for curve_index, curve in enumerate((first_curve, second_curve))
            for piece in _level_crossings(curve, lower_level, upper_level)
        ]
        curve_pieces.sort(key=lambda piece: piece[0] + piece[1])
        neighbour_pairs = [
            (left_piece, right_piece)
            for left_piece, right_piece in pairwise(curve_pieces)
            if left_piece[2] != right_piece[2]
        ]
        if len(neighbour_pairs) != len(open_outline_edges):
            open_outline_edges = [([], []) for _ in neighbour_pairs]
            outline_edges += open_outline_edges
        for (left_edge, right_edge), (left_piece, right_piece) in zip(open_outline_edges, neighbour_pairs, strict=True):
            left_edge += [(left_piece[0], lower_level), (left_piece[1], upper_level)]
            right_edge += [(right_piece[0], lower_level), (right_piece[1], upper_level)]
    return [np.array([*left_edge, *reversed(right_edge)]) for left_edge, right_edge in outline_edges]


def _level_crossings(curve, lower_level, upper_level):
    """Yield (x at the lower level, x at the upper level) of each piece of a curve that spans both levels."""
    sorted_end_levels = np.sort(np.stack([curve[:-1, 1], curve[1:, 1]]), axis=0)
    for index in np.flatnonzero((sorted_end_levels[0] <= lower_level) & (upper_level <= sorted_end_levels[1])):
        (x_start, y_start), (x_end, y_end) = curve[index : index + 2]
        yield tuple(
            x_start + (level - y_start) / (y_end - y_start) * (x_end - x_start) for level in (lower_level, upper_level)
        )


def _label_position(outlines):
    """Return the point, in the middle between two edges, where the region is widest and far from the ends of a part."""
    best_score, best_point = -np.inf, None
    corner_levels = np.concatenate(outlines)[:, 1]
    max_width = max(np.ptp(outline[:, 0]) for outline in outlines)
    for outline in outlines:
        left_edge, right_edge = outline[: len(outline) // 2], outline[len(outline) // 2 :][::-1]
        relative_end_distance = np.minimum(
            left_edge[:, 1] - left_edge[0, 1], left_edge[-1, 1] - left_edge[:, 1]
        ) / np.ptp(corner_levels)
        width_score = np.minimum(abs(right_edge[:, 0] - left_edge[:, 0]) / max_width, 2.0 * relative_end_distance)
        index = int(np.argmax(width_score))
        if width_score[index] > best_score:
            best_score, best_point = (
                width_score[index],
                (0.5 * (left_edge[index, 0] + right_edge[index, 0]), left_edge[index, 1]),
            )
    return best_point
