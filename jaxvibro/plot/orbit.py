"""Periodic orbits: one in the phase plane, and many in a swept diagram."""

from typing import Any

import numpy as np
from matplotlib.axes import Axes

from ..maps.simulate import simulate
from ..orbits.orbit import Orbit
from ..scene.check import require_choice
from .portrait import portrait
from .style import (
    COLOURS,
    WALL_COLOUR,
    axes_or_new,
    checked_picture,
    require_record,
    require_records,
    require_value,
    scales_of,
    variable_axis,
)

SAMPLES_PER_PERIOD = 400  # of a drive period
ORBIT_COLOUR, MARKERS = COLOURS[5], "^dv<>pXP"  # in a diagram


@checked_picture
def orbit(one: Orbit, ax: Axes | None = None, units: str = "scene") -> Axes:
    """Draw an `Orbit` of `find_orbit` or `find_orbits` in the phase plane, as `portrait` does: the Axes.

    The title says whether it is stable, and the larger multiplier. An orbit that repels is followed from its state for
    its own number of periods, in which an error of 1e-16 grows by the multiplier. units: as there.

    Raises ArgumentError as `simulate` and `portrait` do.
    """
    require_record("orbit", Orbit, one)
    ax = portrait(simulate(one.scene, one.state, one.periods, SAMPLES_PER_PERIOD), one.scene, ax, one.stable, units)
    ax.set_title(orbit_title(one), fontsize="medium")
    return ax


def orbit_title(orbit):
    """An `Orbit`'s label, its stability and its larger multiplier, or both where they are complex."""
    multiplier = orbit.multipliers[0]
    multiplier_text = f"multiplier {multiplier.real:.5g}"
    if multiplier.imag:
        multiplier_text = f"multipliers {multiplier.real:.4g} ± {abs(multiplier.imag):.4g}i"
    phase_text = f", state at phase {orbit.state.phase:.4g}" if orbit.state.phase else ""
    return f"{orbit.label}, {_stability_word(orbit)}, {multiplier_text}{phase_text}"


def _stability_word(orbit):
    return "stable" if orbit.stable else "unstable"


@checked_picture
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
    require_records("mark_orbits", Orbit, orbits)
    require_value(value)
    require_choice("variable", variable, ("x", "v"))
    factors = [variable_axis(scales_of(orbit, units), variable).factor for orbit in orbits]
    ax = axes_or_new(ax)
    markers: dict[int, Any] = {}
    ax.axvline(value, color=WALL_COLOUR, linewidth=0.8, linestyle=":", zorder=0)
    for index, orbit in enumerate(orbits):
        mirror_index = index if orbit.mirror_of is None else orbit.mirror_of
        first_index = min(index, mirror_index)
        is_new = first_index not in markers
        marker = markers.setdefault(first_index, MARKERS[len(markers) % len(MARKERS)])
        y = factors[index] * _section_points(orbit)["xv".index(variable)]
        marker_style = {"marker": marker, "markerfacecolor": ORBIT_COLOUR if orbit.stable else "white", "zorder": 6}
        image_text = " and mirror image" if mirror_index != index else ""
        text = f"{orbit.label}{image_text}, {_stability_word(orbit)}" if is_new else None
        ax.plot(
            np.full(len(y), value), y, color=ORBIT_COLOUR, markersize=5.5, linestyle="none", label=text, **marker_style
        )
    return ax


def _section_points(orbit):
    """x and v at phase 0 of each of an orbit's periods, two arrays of shape (periods,): the nearest samples."""
    trajectory = simulate(orbit.scene, orbit.state, orbit.periods, SAMPLES_PER_PERIOD)
    periods = trajectory["phase"].values[:-1] / (2 * np.pi)
    rows = abs(periods - np.round(periods)).reshape(orbit.periods, SAMPLES_PER_PERIOD).argmin(axis=1)
    rows += SAMPLES_PER_PERIOD * np.arange(orbit.periods)
    return trajectory["x"].values[rows], trajectory["v"].values[rows]
