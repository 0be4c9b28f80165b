"""Loci in the plane of their two parameters, and the regions between them."""

from itertools import pairwise
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.typing import ColorType

from ..loci.locus import MEANINGS, Locus
from ..output.labels import name_in
from ..scene.check import ArgumentError
from .plane import in_plane, plane_gid, with_gid
from .smooth import smooth
from .style import COLOURS, axes, is_of, legend, picture, plain, scales_of, wide

# Of each kind: a colour, and a style that tells it without colour.
LOOKS = {
    "SN": (COLOURS[0], "-"),
    "PD": (COLOURS[7], (0, (6, 2))),
    "SB": (COLOURS[5], (0, (7, 2, 1.5, 2))),
    "GR": (COLOURS[2], (0, (1.2, 1.2))),
    "CH": (COLOURS[3], (0, (3, 1, 1, 1, 1, 1))),
    "RL": (COLOURS[1], (0, (10, 3))),
}
WIDTHS = (2.2, 1.4, 0.8)  # of the first, second and further loci of a kind, points
MARKERS = {"CP": "*", "GPD": "^", "DSB": "D", "GR": "v", "GG": "s", "RG": "o", "SN": "<", "PD": ">", "SB": "d"}
MARKERS |= {"CH": "H", "RL": "8", "DG": "P"}
SIZES = {"RG": 9.0}  # points; of others 6: loci that end on a grazing may do so at an RG, whose ring then shows
FILLED = COLOURS[4]
HATCHES = ("///", "\\\\\\", "...", "xxx", "")
LOCUS, REGION = "locus", "region"


@picture
def locus(
    one: Locus,
    ax: Axes | None = None,
    colour: ColorType | None = None,
    units: str = "scene",
    labels: str = "jaxvibro",
) -> Axes:
    """Draw a `Locus` in the plane of its two parameters, the first across, the second up: the Axes.

    colour: of its line; None takes that of its kind. Each kind has a colour and a style of line; of two loci of a kind
    in the same Axes the second is thinner, and further ones thinner still. Each kind of codimension-two point has a
    marker, ends have none. units: "scene", or "physical" of a scene that has scales; labels: what points are called, as
    in `Branch.table`. New Axes get a legend.

    Raises ArgumentError where the Axes hold loci of other parameters, or of these the other way round, and for other
    units and labels.
    """
    is_of("locus", Locus, one)
    alone = ax is None
    ax, sizes = in_plane(axes(ax), one.names, scales_of(one, units))
    told, (own, style) = name(one), LOOKS[one.kind]
    lines = with_gid(ax.lines, LOCUS)
    alike = [line for line in lines if line.get_label().lstrip("_") == told]
    earlier = {line.get_label().lstrip("_") for line in lines} - {told}
    rank = sum(each.startswith(f"{one.kind} ") for each in earlier)
    look: dict[str, Any] = {
        "color": colour or own,
        "linestyle": style,
        "linewidth": wide(WIDTHS[min(rank, len(WIDTHS) - 1)]),
    }
    if alike:
        look = {"linestyle": style, "color": colour or alike[0].get_color(), "linewidth": alike[0].get_linewidth()}
    hidden = any(line.get_color() == look["color"] for line in alike)
    line = smooth(*(one.values * sizes).T)
    ax.plot(*line, label=f"_{told}" if hidden else told, gid=plane_gid(LOCUS, one.names), zorder=3, **look)
    _points(ax, one, sizes, labels)
    legend(ax, alone)
    return ax


def name(one):
    """What a locus is called: "SN of P111"."""
    return f"{one.kind} of {one.label}"


def _points(ax, one, sizes, labels):
    known = [line.get_label() for line in ax.lines if line.get_gid() == "codimension two"]
    for kind in dict.fromkeys(each.kind for each in one.special if each.kind != "EP"):
        across, up = (np.array([list(each.values.values()) for each in one.points(kind)]) * sizes).T
        text = f"{name_in(kind, labels)}: {MEANINGS.get(kind, f'end of a locus of {kind}')}"
        told = f"_{text}" if text in known else text
        look = {"marker": MARKERS[kind], "markersize": SIZES.get(kind, 6.0), "zorder": 7 - 0.1 * SIZES.get(kind, 6.0)}
        look |= {"markerfacecolor": FILLED, "markeredgecolor": "black", "linestyle": "none"}
        ax.plot(across, up, label=told, gid="codimension two", **look)


@picture
def region(
    first: Locus,
    second: Locus,
    text: str,
    ax: Axes | None = None,
    colour: ColorType | None = None,
    units: str = "scene",
) -> Axes:
    """Shade the region between two `Locus` over the same two parameters, and write a text into it: the Axes.

    A point is in the region if, on the line through it on which the second parameter is constant, its neighbours are
    the one locus on one side and the other locus on the other. colour: of the shade; None takes grey, with another
    hatching for each region in these Axes, told by the text in the legend too. units: as in `locus`.

    Raises ArgumentError where the two are not over the same parameters in the same order, where no such line meets
    both, and as `locus` does.
    """
    is_of("region", Locus, first, second)
    if not isinstance(text, str):
        raise ArgumentError("text", "must be a string", text)
    if first.names != second.names:
        raise ArgumentError("second", f"must be a locus in {' and '.join(first.names)}, as the first", second.names)
    ax, sizes = in_plane(axes(ax), first.names, scales_of(first, units))
    outlines = _outlines(first.values * sizes, second.values * sizes)
    if not outlines:
        raise ArgumentError("second", f"must share values of {first.names[1]} with the first", repr(second))
    earlier = len({patch.get_label() for patch in with_gid(ax.patches, REGION)} - {"_"})
    look: dict[str, Any] = {
        "facecolor": colour or "0.5",
        "edgecolor": colour or "0.35",
        "hatch": HATCHES[earlier % len(HATCHES)],
    }
    for place, outline in enumerate(outlines):
        told = plain(text) if place == 0 else "_"
        patch = ax.fill(*outline.T, label=told, gid=plane_gid(REGION, first.names), alpha=0.22, zorder=1, **look)[0]
        patch.set_linewidth(0.0)
    across, up = _widest(outlines)
    box = {"facecolor": "white", "edgecolor": "none", "alpha": 0.75, "pad": 1.5}
    ax.text(across, up, plain(text), ha="center", va="center", zorder=8, fontsize="small", bbox=box)
    return ax


def _outlines(first, second):
    """The corners of each part of the region between two curves of points (across, up), a list of (corners, 2).

    Between two heights at which neither curve has a point both are straight; there, of all their pieces from left to
    right, each two neighbours of different curves have a part of the region between them.
    """
    heights = np.unique(np.concatenate([first[:, 1], second[:, 1]]))
    parts, open_parts = [], []
    for low, high in pairwise(heights):
        pieces = [(*piece, curve) for curve, one in enumerate((first, second)) for piece in _pieces(one, low, high)]
        pieces.sort(key=lambda piece: piece[0] + piece[1])
        pairs = [(one, other) for one, other in pairwise(pieces) if one[2] != other[2]]
        if len(pairs) != len(open_parts):
            open_parts = [([], []) for _ in pairs]
            parts += open_parts
        for (left, right), (one, other) in zip(open_parts, pairs, strict=True):
            left += [(one[0], low), (one[1], high)]
            right += [(other[0], low), (other[1], high)]
    return [np.array([*left, *reversed(right)]) for left, right in parts]


def _pieces(curve, low, high):
    """(across at the one height, at the other) of each piece of a curve that reaches from the one to the other."""
    ends = np.sort(np.stack([curve[:-1, 1], curve[1:, 1]]), axis=0)
    for place in np.flatnonzero((ends[0] <= low) & (high <= ends[1])):
        (left, down), (right, up) = curve[place : place + 2]
        yield tuple(left + (height - down) / (up - down) * (right - left) for height in (low, high))


def _widest(outlines):
    """A point in the middle of where the largest region is wide, not close to its ends."""
    best, where = -np.inf, None
    heights = np.concatenate(outlines)[:, 1]
    largest = max(np.ptp(one[:, 0]) for one in outlines)
    for one in outlines:
        left, right = one[: len(one) // 2], one[len(one) // 2 :][::-1]
        room = np.minimum(left[:, 1] - left[0, 1], left[-1, 1] - left[:, 1]) / np.ptp(heights)
        size = np.minimum(abs(right[:, 0] - left[:, 0]) / largest, 2.0 * room)
        place = int(np.argmax(size))
        if size[place] > best:
            best, where = size[place], (0.5 * (left[place, 0] + right[place, 0]), left[place, 1])
    return where
