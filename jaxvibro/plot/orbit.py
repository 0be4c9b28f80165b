"""Periodic orbits: one in the phase plane, and many in a swept diagram."""

from typing import Any

import numpy as np
from matplotlib.axes import Axes

from ..maps.simulate import simulate
from ..orbits.orbit import Orbit
from ..scene.check import choice
from .portrait import portrait
from .style import COLOURS, WALL, are_of, axes, is_of, of_variable, picture, require_value, scales_of

SAMPLES = 400  # of a drive period
COLOUR, MARKERS = COLOURS[5], "^dv<>pXP"  # in a diagram


@picture
def orbit(one: Orbit, ax: Axes | None = None, units: str = "scene") -> Axes:
    """Draw an `Orbit` of `find_orbit` or `find_orbits` in the phase plane, as `portrait` does: the Axes.

    The title says whether it is stable, and the larger multiplier. An orbit that repels is followed from its state for
    its own number of periods, in which an error of 1e-16 grows by the multiplier. units: as there.

    Raises ArgumentError as `simulate` and `portrait` do.
    """
    is_of("orbit", Orbit, one)
    ax = portrait(simulate(one.scene, one.state, one.periods, SAMPLES), one.scene, ax, one.stable, units)
    ax.set_title(title(one), fontsize="medium")
    return ax


def title(one):
    """An `Orbit`'s label, its stability and its larger multiplier, or both where they are complex."""
    first = one.multipliers[0]
    told = f"multiplier {first.real:.5g}"
    if first.imag:
        told = f"multipliers {first.real:.4g} ± {abs(first.imag):.4g}i"
    where = f", state at phase {one.state.phase:.4g}" if one.state.phase else ""
    return f"{one.label}, {_stability(one)}, {told}{where}"


def _stability(one):
    return "stable" if one.stable else "unstable"


@picture
def mark_orbits(
    orbits: tuple[Orbit, ...] | list[Orbit],
    value: float,
    variable: str = "x",
    ax: Axes | None = None,
    units: str = "scene",
) -> Axes:
    """Draw each `Orbit` into a diagram, at the value of the swept parameter that they belong to: the Axes.

    value: in the units of the Axes; variable: "x" or "v". units: "scene", or "physical" of a scene that has scales.
    Shown is the state at phase 0 of each drive period. Stable orbits are filled, unstable ones open; mirror images of
    each other have one shape.

    Raises ArgumentError for what is no tuple or list of `Orbit`s, and for other units.
    """
    are_of("mark_orbits", Orbit, orbits)
    require_value(value)
    choice("variable", variable, ("x", "v"))
    sizes = [of_variable(scales_of(one, units), variable).size for one in orbits]
    ax = axes(ax)
    shapes: dict[int, Any] = {}
    ax.axvline(value, color=WALL, linewidth=0.8, linestyle=":", zorder=0)
    for place, one in enumerate(orbits):
        twin = place if one.mirror_of is None else one.mirror_of
        first = min(place, twin)
        new = first not in shapes
        shape = shapes.setdefault(first, MARKERS[len(shapes) % len(MARKERS)])
        up = sizes[place] * _section(one)["xv".index(variable)]
        look = {"marker": shape, "markerfacecolor": COLOUR if one.stable else "white", "zorder": 6}
        image = " and mirror image" if twin != place else ""
        text = f"{one.label}{image}, {_stability(one)}" if new else None
        ax.plot(np.full(len(up), value), up, color=COLOUR, markersize=5.5, linestyle="none", label=text, **look)
    return ax


def _section(one):
    """x and v at phase 0 of each of an orbit's periods, two arrays of shape (periods,): the nearest samples."""
    motion = simulate(one.scene, one.state, one.periods, SAMPLES)
    turns = motion["phase"].values[:-1] / (2 * np.pi)
    where = abs(turns - np.round(turns)).reshape(one.periods, SAMPLES).argmin(axis=1)
    where += SAMPLES * np.arange(one.periods)
    return motion["x"].values[where], motion["v"].values[where]
