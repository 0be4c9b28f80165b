"""Branches of periodic orbits against their parameter, and the special points on them."""

from itertools import pairwise
from typing import Any

import numpy as np
from jaxtyping import Float
from matplotlib.axes import Axes
from matplotlib.font_manager import FontProperties
from matplotlib.typing import ColorType

from ..branches.branch import MEANINGS, Branch
from ..output.labels import name_in
from .smooth import smooth
from .style import (
    COLOURS,
    WALL,
    are_of,
    axes,
    is_of,
    legend,
    of_parameter,
    of_variable,
    picture,
    plain,
    require_axes,
    scales_of,
    wide,
)

ORDER = tuple(COLOURS[k] for k in (2, 7, 5, 3, 0, 6, 1))  # yellow is too pale for a line
ORDER += ("#882255", "#999933", "#332288", "#44AA99")  # of Tol's, where there are more
WIDTHS = {True: 2.0, False: 0.9}  # of a stable and of an unstable part, points
STYLES = {True: "-", False: (0, (4, 2))}
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
FILLED = COLOURS[4]  # of special points: attractors are white or black
OTHERS = "XP*pdh<>"  # of monitors
LINES = 3  # on one tick
SAMPLED = 64  # points of a line that are looked for on others
SAME = 1e-3  # of their extent: lines as near are drawn once
TICKS = "x-small"  # their size


@picture
def branch(
    one: Branch,
    variable: str = "x",
    ax: Axes | None = None,
    colour: ColorType | None = None,
    units: str = "scene",
    labels: str = "jaxvibro",
) -> Axes:
    """Draw one variable of a `Branch` against its parameter: the Axes.

    variable: "x" or "v" at phase 0 of each drive period; of an orbit "speed", its largest before an impact,
    "least_speed", "clearance", its least, or "peak", its largest abs x. colour: of its lines; None takes the next of
    the house's, or that of a branch with the same labels in these Axes. units: "scene", or "physical" of a scene that
    has scales; labels: what special points are called, as in `Branch.table`.

    Stable parts are solid and thick, unstable ones dashed and thin. A line breaks where an impact crosses phase 0: the
    velocity jumps there, though the branch goes on. Each kind of special point has a marker of its own, the ends none.
    Between points lines are bent as their neighbours say. A line that coincides with one of another branch, as the
    speed of a mirror image does, is drawn once: two dashed lines would make a solid one. New Axes get a legend.

    Raises ArgumentError for what is no `Branch`, and for other variables, units and labels.
    """
    is_of("branch", Branch, one)
    scales, found, alone = scales_of(one, units), one.curves(variable), ax is None
    across, up = of_parameter(scales, one.name), of_variable(scales, variable)
    ax, text = axes(ax), name(one)
    known = {str(line.get_label()).lstrip("_"): line.get_color() for line in ax.lines if line.get_gid() == "branch"}
    colour = colour or known.get(text, ORDER[len(known) % len(ORDER)])
    twins, new = [], False
    for piece in found.pieces:
        look: dict[str, Any] = {
            "color": colour,
            "linewidth": wide(WIDTHS[piece.stable]),
            "linestyle": STYLES[piece.stable],
            "zorder": 3,
        }
        for across_part, up_part in _parts(piece, found.points.get("SB") if variable not in ("x", "v") else None):
            line = smooth(across_part * across.size, up_part * up.size)
            twin = covering(ax, line[0], line[1], look["linewidth"])
            twins += [] if twin is None else [twin]
            if twin is None:
                new = True
                ax.plot(*line, label="_" + text, gid="branch", solid_capstyle="butt", **look)
    if text not in known:
        told, shown = (text, colour) if new or not twins else (f"{text}, on {_label(twins[0])}", twins[0].get_color())
        ax.plot([], [], label=told, gid="branch", color=shown, linewidth=wide(WIDTHS[True]))
    stability_entries(ax)
    _points(ax, found.points, across.size, up.size, labels)
    if variable in ("x", "peak"):
        _walls(ax, one, up.size)
    ax.set(xlabel=across.label, ylabel=up.label)
    ax.margins(x=0.01)
    legend(ax, alone)
    return ax


def _parts(piece, turns):
    """(values, column) of the lines of a `Piece`: each of its columns, cut at the `Marks` where it turns back on itself
    (the orbits on the two sides of a symmetry breaking are mirror images), None: nowhere."""
    cuts = [] if turns is None else np.flatnonzero(np.isin(piece.values, turns.values))
    edges = [0, *(int(cut) for cut in cuts if 0 < cut < len(piece.values) - 1), len(piece.values) - 1]
    for column in piece.columns.T:
        for first, last in pairwise(edges):
            yield piece.values[first : last + 1], column[first : last + 1]


def covering(ax: Axes, across: Float[np.ndarray, " points"], up: Float[np.ndarray, " points"], width: float) -> Any:
    """Find a branch's line of this width in the Axes that covers all points of a new line; None without one."""
    points = np.stack([across, up])[:, np.isfinite(up)]
    points = points[:, :: max(1, points.shape[1] // SAMPLED)]
    for line in ax.lines:
        if line.get_gid() != "branch" or line.get_linewidth() != width or not points.size:
            continue
        drawn = np.array(line.get_data(), float)
        if drawn.shape[1] > 1 and _is_on(points, drawn):
            return line
    return None


def _is_on(points, line):
    """Return True if points lie on a line, (2, points) both, to SAME of its extent."""
    size = np.maximum(np.nanmax(line, axis=1) - np.nanmin(line, axis=1), np.ptp(points, axis=1))[:, None]
    size = np.where(size > 0, size, 1.0)
    points, line = points / size, line / size
    starts, ways = line[:, :-1, None], np.diff(line, axis=1)[:, :, None]
    lengths = (ways**2).sum(axis=0)
    off = points[:, None, :] - starts
    with np.errstate(invalid="ignore", divide="ignore"):
        share = np.clip(np.where(lengths > 0, (off * ways).sum(axis=0) / lengths, 0.0), 0.0, 1.0)
    apart = np.hypot(*(off - share * ways))
    return bool((np.where(np.isnan(apart), np.inf, apart).min(axis=0) < SAME).all())


def _label(line):
    return str(line.get_label()).lstrip("_")


def name(one):
    """The labels of a branch's stretches, each once, in their order: "P100, P111"."""
    return ", ".join(dict.fromkeys(part.label for part in one.segments))


def stability_entries(ax):
    """What the lines mean, once in a legend."""
    if not any(line.get_gid() == "stability" for line in ax.lines):
        for stable, text in ((True, "stable"), (False, "unstable")):
            look = {"color": WALL, "linewidth": wide(WIDTHS[stable]), "linestyle": STYLES[stable]}
            ax.plot([], [], label=text, gid="stability", **look)


def _points(ax, points, wide, high, labels):
    known = [line.get_label() for line in ax.lines if line.get_gid() == "special"]
    for kind, marks in points.items():
        up = high * marks.columns
        across = np.broadcast_to(wide * marks.values[:, None], up.shape)
        text = plain(f"{name_in(kind, labels)}: {MEANINGS[kind]}" if kind in MEANINGS else kind)
        told = text if text not in known else "_" + text
        look = {"marker": _marker(kind), "markersize": 5.5, "markerfacecolor": FILLED, "markeredgecolor": "black"}
        ax.plot(across.ravel(), up.ravel(), label=told, gid="special", linestyle="none", zorder=7, **look)


def _marker(kind):
    """A kind's marker: a monitor's is told by its name alone, so that it is the same in every picture."""
    return MARKERS.get(kind) or OTHERS[sum(map(ord, kind)) % len(OTHERS)]


def _walls(ax, one, size):
    """Lines where the walls stand, each once: not those that move or that the parameter moves, nor those far off."""
    low, high = ax.get_ylim()
    near = (high - low) / 4
    known = [line.get_ydata()[0] for line in ax.lines if line.get_color() == WALL and len(line.get_ydata())]
    for side, wall in one.scene.walls.items():
        if wall.motion is not None or one.name == f"{side}.position":
            continue
        place = size * float(wall.position)
        if place not in known and low - near <= place <= high + near:
            ax.axhline(place, color=WALL, linewidth=0.8, zorder=0)


@picture
def mark_points(
    branches: tuple[Branch, ...] | list[Branch], ax: Axes, units: str = "scene", labels: str = "jaxvibro"
) -> Axes:
    """Tell kind and value of the special points of branches along the top of Axes in which they are drawn: the Axes.

    Points of one value are told once, and those that lie too close to be told apart on one tick: the first of them.
    units, labels: as in `branch`.

    Raises ArgumentError for what is no tuple or list of `Branch`es.
    """
    are_of("mark_points", Branch, branches)
    require_axes(ax)
    low, high = ax.get_xlim()
    close = _line(ax) * (high - low)
    digits = max(0, 3 - int(np.floor(np.log10(high - low))))  # about a thousandth of the range
    sizes = [of_parameter(scales_of(one, units), one.name).size for one in branches]
    special = [
        (each.kind, size * each.value) for one, size in zip(branches, sizes, strict=True) for each in one.special
    ]
    found = {(kind, f"{value:.{digits}f}"): value for kind, value in special}
    ticks: list[tuple[float, list[str]]] = []  # value, lines
    for (kind, text), value in sorted(found.items(), key=lambda item: item[1]):
        if kind == "EP" or not low <= value <= high:
            continue
        if not ticks or value - ticks[-1][0] >= close * min(LINES, len(ticks[-1][1])):
            ticks.append((value, []))
        ticks[-1][1].append(f"{plain(name_in(kind, labels))} {text}")
    top = ax.secondary_xaxis("top")
    top.set_xticks([value for value, _ in ticks], [_lines(each) for _, each in ticks], rotation=90, fontsize=TICKS)
    for told, (_, each) in zip(top.get_xticklabels(), ticks, strict=True):
        told.set_horizontalalignment("left" if len(each) > 1 else "center")  # the first line at the tick
    return ax


def _line(ax):
    """The width of a line of such a text, of the Axes' width."""
    across = ax.figure.get_figwidth() * ax.get_position().width
    return 1.3 * FontProperties(size=TICKS).get_size_in_points() / (72.0 * across)


def _lines(told):
    """What one tick says."""
    return "\n".join(told if len(told) <= LINES else [*told[: LINES - 1], f"and {len(told) - LINES + 1} more"])
