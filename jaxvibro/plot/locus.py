"""Draw loci in the plane of their two parameters, and the regions between them."""

from itertools import pairwise
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.typing import ColorType

from ..loci.locus import MEANINGS, Locus
from ..output.labels import translate_label
from ..scene.check import ArgumentError
from .parameter_plane import artists_with_gid, plane_gid, prepare_plane
from .smooth_line import smooth_line
from .style import (
    COLOURS,
    add_legend,
    axes_or_new,
    checked_picture,
    escape_formulas,
    require_record,
    scaled_line_width,
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


@checked_picture
def locus(
    one: Locus,
    ax: Axes | None = None,
    colour: ColorType | None = None,
    units: str = "scene",
    labels: str = "jaxvibro",
) -> Axes:
    """Draw a locus in the plane of its two parameters.

    The first parameter is on the x axis, the second on the y axis. Each kind of locus has its own colour and line
    style. Each kind of codimension-two point has its own marker; the ends of the locus have none.

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
    The second locus of a kind in the same Axes has a thinner line than the first, and further ones are thinner still.

    Examples
    --------
    >>> bounds = {"amplitude": (0.3, 5.0), "frequency": (2.0, 2.2)}
    >>> ax = jv.plot.locus(jv.locus(branch.points("GR")[0], ("amplitude", "frequency"), bounds))
    >>> ax.get_ylabel()[:15]
    'drive frequency'
    """
    require_record("locus", Locus, one)
    is_new = ax is None
    ax, factors = prepare_plane(axes_or_new(ax), one.names, scales_of(one, units))
    legend_text, (kind_colour, dashes) = locus_name(one), KIND_STYLES[one.kind]
    lines = artists_with_gid(ax.lines, LOCUS_GID)
    same_lines = [line for line in lines if line.get_label().lstrip("_") == legend_text]
    earlier_labels = {line.get_label().lstrip("_") for line in lines} - {legend_text}
    rank = sum(label.startswith(f"{one.kind} ") for label in earlier_labels)
    line_style: dict[str, Any] = {
        "color": colour or kind_colour,
        "linestyle": dashes,
        "linewidth": scaled_line_width(LINE_WIDTHS[min(rank, len(LINE_WIDTHS) - 1)]),
    }
    if same_lines:
        line_style = {
            "linestyle": dashes,
            "color": colour or same_lines[0].get_color(),
            "linewidth": same_lines[0].get_linewidth(),
        }
    is_listed = any(line.get_color() == line_style["color"] for line in same_lines)
    line = smooth_line(*(one.values * factors).T)
    ax.plot(
        *line,
        label=f"_{legend_text}" if is_listed else legend_text,
        gid=plane_gid(LOCUS_GID, one.names),
        zorder=3,
        **line_style,
    )
    _draw_codim2_points(ax, one, factors, labels)
    add_legend(ax, is_new)
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


def _draw_codim2_points(ax, locus, factors, labels):
    known_labels = [line.get_label() for line in ax.lines if line.get_gid() == "codimension two"]
    for kind in dict.fromkeys(special.kind for special in locus.special if special.kind != "EP"):
        x, y = (np.array([list(special.values.values()) for special in locus.points(kind)]) * factors).T
        text = f"{translate_label(kind, labels)}: {MEANINGS.get(kind, f'end of a locus of {kind}')}"
        legend_text = f"_{text}" if text in known_labels else text
        marker_style = {
            "marker": MARKERS[kind],
            "markersize": MARKER_SIZES.get(kind, 6.0),
            "zorder": 7 - 0.1 * MARKER_SIZES.get(kind, 6.0),
        }
        marker_style |= {"markerfacecolor": MARKER_COLOUR, "markeredgecolor": "black", "linestyle": "none"}
        ax.plot(x, y, label=legend_text, gid="codimension two", **marker_style)


@checked_picture
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
        Colour of the shade. None takes grey, with a different hatching for each region in these Axes.
    units : {"scene", "physical"}, optional
        Units of the axes. ``"physical"`` requires a scene with scales.

    Returns
    -------
    Axes
        Axes with the drawing.

    Raises
    ------
    ArgumentError
        If `first` or `second` is not a `Locus`, if their parameters differ, if no line of constant second parameter
        meets both, or as `locus` does.

    See Also
    --------
    locus : Draw a locus.

    Notes
    -----
    A point belongs to the region if its two neighbours on the line of constant second parameter lie on different loci.

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
    ax, factors = prepare_plane(axes_or_new(ax), first.names, scales_of(first, units))
    outlines = _outlines(first.values * factors, second.values * factors)
    if not outlines:
        raise ArgumentError("second", f"must share values of {first.names[1]} with the first", repr(second))
    n_earlier = len({patch.get_label() for patch in artists_with_gid(ax.patches, REGION_GID)} - {"_"})
    patch_style: dict[str, Any] = {
        "facecolor": colour or "0.5",
        "edgecolor": colour or "0.35",
        "hatch": HATCHES[n_earlier % len(HATCHES)],
    }
    for index, outline in enumerate(outlines):
        legend_text = escape_formulas(text) if index == 0 else "_"
        patch = ax.fill(
            *outline.T, label=legend_text, gid=plane_gid(REGION_GID, first.names), alpha=0.22, zorder=1, **patch_style
        )[0]
        patch.set_linewidth(0.0)
    x, y = _widest_point(outlines)
    box_style = {"facecolor": "white", "edgecolor": "none", "alpha": 0.75, "pad": 1.5}
    ax.text(x, y, escape_formulas(text), ha="center", va="center", zorder=8, fontsize="small", bbox=box_style)
    return ax


def _outlines(first, second):
    """Return the corners of each part of the region between two curves of shape (points, 2), as a list of (corners, 2).

    Between two levels of the second parameter at which neither curve has a point both are straight. There the pieces of
    both are sorted from left to right, and each two neighbours of different curves bound a part of the region.
    """
    levels = np.unique(np.concatenate([first[:, 1], second[:, 1]]))
    parts, open_parts = [], []
    for lower, upper in pairwise(levels):
        pieces = [
            (*piece, curve_index)
            for curve_index, element in enumerate((first, second))
            for piece in _level_crossings(element, lower, upper)
        ]
        pieces.sort(key=lambda piece: piece[0] + piece[1])
        pairs = [(element, neighbour) for element, neighbour in pairwise(pieces) if element[2] != neighbour[2]]
        if len(pairs) != len(open_parts):
            open_parts = [([], []) for _ in pairs]
            parts += open_parts
        for (left_edge, right_edge), (element, neighbour) in zip(open_parts, pairs, strict=True):
            left_edge += [(element[0], lower), (element[1], upper)]
            right_edge += [(neighbour[0], lower), (neighbour[1], upper)]
    return [np.array([*left_edge, *reversed(right_edge)]) for left_edge, right_edge in parts]


def _level_crossings(curve, lower, upper):
    """Yield (x at the lower level, x at the upper level) of each piece of a curve that spans both levels."""
    piece_levels = np.sort(np.stack([curve[:-1, 1], curve[1:, 1]]), axis=0)
    for index in np.flatnonzero((piece_levels[0] <= lower) & (upper <= piece_levels[1])):
        (x_start, y_start), (x_end, y_end) = curve[index : index + 2]
        yield tuple(x_start + (level - y_start) / (y_end - y_start) * (x_end - x_start) for level in (lower, upper))


def _widest_point(outlines):
    """Return a point in the middle of the widest part of the largest region, away from its ends."""
    best_width, best_point = -np.inf, None
    levels = np.concatenate(outlines)[:, 1]
    max_width = max(np.ptp(outline[:, 0]) for outline in outlines)
    for outline in outlines:
        left_edge, right_edge = outline[: len(outline) // 2], outline[len(outline) // 2 :][::-1]
        end_distance = np.minimum(left_edge[:, 1] - left_edge[0, 1], left_edge[-1, 1] - left_edge[:, 1]) / np.ptp(
            levels
        )
        width_score = np.minimum(abs(right_edge[:, 0] - left_edge[:, 0]) / max_width, 2.0 * end_distance)
        index = int(np.argmax(width_score))
        if width_score[index] > best_width:
            best_width, best_point = (
                width_score[index],
                (0.5 * (left_edge[index, 0] + right_edge[index, 0]), left_edge[index, 1]),
            )
    return best_point
