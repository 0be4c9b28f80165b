"""The swept diagram: a coordinate on the section against the parameter, one colour a leg."""

from typing import Any

import numpy as np
import xarray as xr
from matplotlib.axes import Axes
from matplotlib.markers import TICKLEFT, TICKRIGHT

from ..attractors.find import Attractor
from ..attractors.shares import share_text
from ..scene.check import choice
from .style import (
    COLOURS,
    WALL,
    are_of,
    axes,
    is_from,
    legend,
    of_parameter,
    of_variable,
    paler,
    picture,
    plain,
    require_value,
    scales_of,
)

SIZES = 2.2, 3.6  # points, of the first leg's dots: between these what there is room for
ROOM = 0.7  # of the way from one value to the next
SMALLER = 0.5  # of the size of the leg before: where legs agree a ring of it is seen, in print too
FAINT = 0.7  # of that size
MARKERS = "osD^vP*X"
SWEPT = "swept"  # group id of dots


@picture
def diagram(
    swept: xr.Dataset, variable: str = "x", ax: Axes | None = None, faint: bool = False, units: str = "scene"
) -> Axes:
    """Draw one variable, "x" or "v", of a Dataset of `sweep`: the Axes.

    A dimension besides the values' and `period` (lane, or leg with its names) makes a leg of each of its entries, with
    a colour and a size of dot of its own, those after what the Axes hold of other sweeps. Fixed walls are lines where x
    is drawn, unless they are far from all dots. faint: smaller and paler dots, below branches; without it they lie
    above. units: "scene", or "physical" of a scene that has scales. New Axes get a legend.

    Raises ArgumentError for what is no such Dataset, and for other units.
    """
    is_from("diagram", "sweep", ("swept", "x", "v"), swept)
    choice("variable", variable, ("x", "v"))
    alone, scales = ax is None, scales_of(swept, units)
    ax, name = axes(ax), swept.attrs["swept"]
    wide, high = of_parameter(scales, name), of_variable(scales, variable)
    step, *lanes = (dim for dim in swept[variable].dims if dim != "period")
    legs = [swept] if not lanes else [swept.isel({lanes[0]: k}) for k in range(swept.sizes[lanes[0]])]
    there = sum(line.get_gid() == SWEPT and np.size(line.get_xdata()) > 0 for line in ax.lines)
    first = float(np.clip(ROOM * _points(ax) / len(swept[step]), *SIZES))
    for k, leg in enumerate(legs, there):
        across = np.broadcast_to(wide.size * leg[name].values[:, None], leg[variable].shape)
        up = high.size * leg[variable].transpose(step, "period").values
        _dots(ax, across, up, k, first, _named(leg, lanes) + f"from {across[0, 0]:g} to {across[-1, 0]:g}", faint)
    if variable == "x":
        _walls(ax, swept.attrs, high.size)
    ax.set(xlabel=wide.label, ylabel=high.label)
    ax.margins(x=0.01)
    legend(ax, alone)
    return ax


def _named(leg, lanes):
    return plain(f"{leg[lanes[0]].values}: ") if lanes and lanes[0] in leg.coords else ""


def _walls(ax, attrs, size):
    low, high = ax.get_ylim()
    near = (high - low) / 4
    for side in ("left", "right"):
        place = attrs.get(f"{side}.position")
        stands = place is not None and f"{side}.motion.amplitude" not in attrs
        if stands and low - near <= size * place <= high + near:
            ax.axhline(size * place, color=WALL, linewidth=0.8, zorder=0)


def _points(ax):
    """The width of Axes, points."""
    return 72.0 * ax.figure.get_figwidth() * ax.get_position().width


def _dots(ax, across, up, place, first, text, faint):
    size, colour = first * SMALLER ** min(place, 2), COLOURS[place % len(COLOURS)]
    style = {"linestyle": "none", "marker": "o", "markeredgewidth": 0, "color": paler(colour) if faint else colour}
    size, style["zorder"] = (FAINT * size, 2.0) if faint else (size, 4.0)
    ax.plot(across.ravel(), up.ravel(), markersize=size, rasterized=True, label="_" + text, gid=SWEPT, **style)
    ax.plot([], [], markersize=7 / (1 + 0.4 * place), label=text, **style)


@picture
def mark(
    attractors: tuple[Attractor, ...] | list[Attractor],
    value: float,
    variable: str = "x",
    ax: Axes | None = None,
    units: str = "scene",
) -> Axes:
    """Draw attractors into a diagram, at the value of the swept parameter that they belong to: the Axes.

    value: in the units of the Axes; variable: "x" or "v". units: "scene", or "physical" of a scene that has scales.
    Mirror images of each other have one shape, the first of them open and the second filled; a chaotic one is a row of
    ticks, to the left or, its image, to the right. The legend tells their shares of the starts, with bounds at 95 %.

    Raises ArgumentError for what is no tuple or list of `Attractor`s, and for other units.
    """
    are_of("mark", Attractor, attractors)
    require_value(value)
    choice("variable", variable, ("x", "v"))
    sizes = [of_variable(scales_of(one, units), variable).size for one in attractors]
    ax = axes(ax)
    shapes: dict[int, Any] = {}
    ax.axvline(value, color=WALL, linewidth=0.8, linestyle=":", zorder=0)
    for place, one in enumerate(attractors):
        if one.kind == "unresolved":
            continue
        twin = place if one.mirror_of is None else one.mirror_of
        first = min(place, twin)
        shape = shapes.setdefault(first, MARKERS[len(shapes) % len(MARKERS)])
        up = sizes[place] * one.points[:, "xv".index(variable)]
        if one.kind == "chaotic":
            look: dict[str, Any] = {
                "marker": TICKLEFT if place == first else TICKRIGHT,
                "markeredgewidth": 0.3,
                "zorder": 4,
            }
        else:
            look = {"marker": shape, "markerfacecolor": "white" if place == first else "black", "zorder": 5}
        text = f"{one.label}, {share_text(one)}"
        ax.plot(np.full(len(up), value), up, color="black", markersize=5.5, linestyle="none", label=text, **look)
    return ax
