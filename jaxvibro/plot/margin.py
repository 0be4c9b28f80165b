"""The bifurcations near an orbit: in the plane of two free numbers, or how much of each number leads to each."""

import numpy as np
from matplotlib.axes import Axes
from matplotlib.patches import Ellipse

from ..branches.branch import MEANINGS
from ..design.margin import REACHED, Margin
from .locus import LOOKS, MARKERS
from .style import COLOURS, axes, is_of, of_parameter, picture, plain, scales_of

SHAPES = "osD^vP*X"  # of the free numbers
STYLES = {True: "-", False: ":"}  # of a way: whether the point is the first that it meets


@picture
def margin(near: Margin, ax: Axes | None = None, units: str = "scene") -> Axes:
    """Draw what `margin` found: the Axes.

    Of two free numbers their plane, the first across: the orbit, the way to each point (dotted where another boundary
    comes before), and the ellipse within which none was found. Of any other count of numbers the change of each that
    leads to each point, in its units, the nearest point first. units: of the plane, "scene", or "physical" of a scene
    that has scales.

    Raises ArgumentError where it is given anything else, and for other units.
    """
    is_of("margin", Margin, near)
    scales, ax = scales_of(near.orbit, units), axes(ax)
    return _plane(near, ax, scales) if len(near.free) == 2 else _changes(near, ax)


def _plane(near, ax, scales):
    both = {name: of_parameter(scales, name) for name in near.free}
    here = _place(near.orbit.scene, both)
    ax.plot(*here, "o", color="black", label=near.orbit.label, zorder=6)
    if near.points:
        sizes = (2.0 * near.distance * near.free[name] * axis.size for name, axis in both.items())
        told = f"nearest: {near.distance:.3g} units"
        ax.add_patch(Ellipse(here, *sizes, fill=False, edgecolor="0.4", linestyle=(0, (4, 3)), label=told, zorder=2))
    for one in near.points:
        there, (colour, _) = _place(one.scene, both), LOOKS[one.kind]
        ax.plot(*zip(here, there, strict=True), color=colour, linestyle=STYLES[one.status == REACHED], linewidth=1.2)
        look = {"marker": MARKERS[one.kind], "markersize": 8.0, "markeredgecolor": "black", "linestyle": "none"}
        ax.plot(*there, color=colour, label=_told(one), zorder=5, **look)
    ax.set(**dict(zip(("xlabel", "ylabel"), (axis.label for axis in both.values()), strict=True)))
    ax.margins(0.12)
    ax.legend(fontsize="small")
    return ax


def _place(scene, both):
    """Where a scene is in the plane of two parameters, with an `Axis` each."""
    return [axis.size * float(scene.parameter(name)) for name, axis in both.items()]


def _changes(near, ax):
    places = np.arange(len(near.points))
    ax.axhline(0.0, color="0.5", linewidth=0.8)
    apart = 0.6 / len(near.free)
    for k, (name, unit) in enumerate(near.free.items()):
        across = places + apart * (k - 0.5 * (len(near.free) - 1))
        changes = [one.change[name] / unit for one in near.points]
        colour = COLOURS[k % len(COLOURS)]
        ax.vlines(across, 0.0, changes, color=colour, linewidth=1.5)
        look = {"marker": SHAPES[k % len(SHAPES)], "markeredgecolor": "black", "linestyle": "none"}
        ax.plot(across, changes, color=colour, label=f"{plain(name)}, unit {unit:g}", **look)
    ax.set_xticks(places, [f"{_told(one)}\n{one.distance:.3g} units" for one in near.points], fontsize="small")
    ax.set(xlim=(-0.6, max(len(places), 2) - 0.4), ylabel="change to the point (units of each number)")
    ax.legend(fontsize="small")
    return ax


def _told(one):
    behind = "" if one.status == REACHED else f", {one.status}"
    return f"{one.kind}: {MEANINGS[one.kind]}{behind}"
