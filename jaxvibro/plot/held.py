"""Orbits that share a number, in the plane of their two parameters."""

from typing import Any

from matplotlib.axes import Axes
from matplotlib.typing import ColorType

from ..branches.held_branch import UNITS, HeldBranch
from ..output.runs import runs
from ..output.units import amount_text
from .branch import STYLES, WIDTHS, stability_entries
from .plane import in_plane, plane_gid, with_gid
from .smooth import smooth
from .style import COLOURS, axes, is_of, legend, picture, scales_of, wide

HELD = "held"
ORDER = tuple(COLOURS[k] for k in (6, 3, 5, 7, 0))  # loci have others first


@picture
def held(one: HeldBranch, ax: Axes | None = None, colour: ColorType | None = None, units: str = "scene") -> Axes:
    """Draw a `HeldBranch` in the plane of its two parameters, the first across, the second up: the Axes.

    colour: of its line; None takes the next of the house's. Stable parts are solid and thick, unstable ones dashed and
    thin, as of a branch. units: "scene", or "physical" of a scene that has scales. New Axes get a legend. Loci of the
    same parameters may be in the same Axes.

    Raises ArgumentError for what is no `HeldBranch`, where the Axes hold curves of other parameters, or of these the
    other way round, and for other units.
    """
    is_of("held", HeldBranch, one)
    alone = ax is None
    ax, sizes = in_plane(axes(ax), one.names, scales_of(one, units))
    told = f"{one.held} {amount_text(scales_of(one, units), UNITS[one.held], one.value)} of {one.label}"
    known = {str(line.get_label()).lstrip("_"): line.get_color() for line in with_gid(ax.lines, HELD)}
    colour = colour or known.get(told, ORDER[len(known) % len(ORDER)])
    line, steady = one.values * sizes, one.stable[:-1] & one.stable[1:]
    for first, last in runs(steady):
        here = bool(steady[first])
        look: dict[str, Any] = {
            "color": colour,
            "linewidth": wide(WIDTHS[here]),
            "linestyle": STYLES[here],
            "zorder": 4,
        }
        ax.plot(*smooth(*line[first : last + 1].T), label="_" + told, gid=plane_gid(HELD, one.names), **look)
    if told not in known:
        ax.plot([], [], label=told, gid=plane_gid(HELD, one.names), color=colour, linewidth=wide(WIDTHS[True]))
    stability_entries(ax)
    legend(ax, alone)
    return ax
