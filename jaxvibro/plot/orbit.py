"""Draw one periodic orbit in the phase plane, or many in a sweep diagram."""

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
    check_plot_options,
    require_finite_position,
    require_record,
    require_records,
    scales_of,
    variable_axis,
)

SAMPLES_PER_PERIOD = 400  # samples per drive period
ORBIT_COLOUR, MARKERS = COLOURS[5], "^dv<>pXP"  # in a sweep diagram


@check_plot_options
def orbit(one: Orbit, ax: Axes | None = None, units: str = "scene") -> Axes:
    """Draw a periodic orbit in the phase plane.

    The title states the label, the stability and the larger multiplier of the orbit, or both multipliers if they are
    complex.

    Parameters
    ----------
    one : Orbit
        Orbit to draw.
    ax : Axes, optional
        Axes to draw into. None makes a new figure.
    units : {"scene", "physical"}, optional
        Units of the axes, as in `portrait`.

    Returns
    -------
    Axes
        Axes with the drawing.

    Raises
    ------
    ArgumentError
        If `one` is not an `Orbit`, if `units` is unknown, or if `units` is ``"physical"`` and the scene has no scales.

    See Also
    --------
    portrait : Draw a trajectory in the phase plane.
    jaxvibro.find_orbit : Find a periodic orbit near a state.

    Notes
    -----
    The drawing of an unstable orbit is a simulation from its state for its number of periods. In that time a rounding
    error of 1e-16 grows by a factor of about the modulus of the larger multiplier.

    Examples
    --------
    >>> ax = jv.plot.orbit(orbit)
    >>> ax.get_title()[:12]
    'P111, stable'
    """
    require_record("orbit", Orbit, one)
    ax = portrait(simulate(one.scene, one.state, one.periods, SAMPLES_PER_PERIOD), one.scene, ax, one.stable, units)
    ax.set_title(orbit_title(one), fontsize="medium")
    return ax


def orbit_title(orbit):
    """Return the title of the figure of an orbit.

    Parameters
    ----------
    orbit : Orbit
        Orbit.

    Returns
    -------
    str
        Label, stability and larger multiplier, or both multipliers if they are complex. If the phase of the state is
        not zero, this phase follows.
    """
    larger_multiplier = orbit.multipliers[0]
    multiplier_text = f"multiplier {larger_multiplier.real:.5g}"
    if larger_multiplier.imag:
        multiplier_text = f"multipliers {larger_multiplier.real:.4g} ± {abs(larger_multiplier.imag):.4g}i"
    phase_text = f", state at phase {orbit.state.phase:.4g}" if orbit.state.phase else ""
    return f"{orbit.label}, {_stability_word(orbit)}, {multiplier_text}{phase_text}"


def _stability_word(orbit):
    return "stable" if orbit.stable else "unstable"


@check_plot_options
def mark_orbits(
    orbits: tuple[Orbit, ...] | list[Orbit],
    value: float,
    variable: str = "x",
    ax: Axes | None = None,
    units: str = "scene",
) -> Axes:
    """Draw periodic orbits into a sweep diagram.

    Each orbit is shown by its states at phase 0 of each drive period. Stable orbits are filled, unstable ones open.
    Mirror images of each other have the same shape.

    Parameters
    ----------
    orbits : tuple or list of Orbit
        Orbits to draw.
    value : float
        Value of the swept parameter, in the units of the Axes.
    variable : {"x", "v"}, optional
        Position or velocity on the section.
    ax : Axes, optional
        Axes of the diagram. None makes a new figure.
    units : {"scene", "physical"}, optional
        Units of the axes. ``"physical"`` requires scenes with scales.

    Returns
    -------
    Axes
        Axes with the drawing.

    Raises
    ------
    ArgumentError
        If `orbits` is not a tuple or list of `Orbit` records, if `value` is not finite, or if `variable` or `units` is
        unknown.

    See Also
    --------
    diagram : Draw a sweep.
    jaxvibro.find_orbits : Find the periodic orbits of a scene.

    Examples
    --------
    >>> ax = jv.plot.mark_orbits([orbit], 2.0)
    >>> ax.get_legend_handles_labels()[1]
    ['P111, stable']
    """
    require_records("mark_orbits", Orbit, orbits)
    require_finite_position(value)
    require_choice("variable", variable, ("x", "v"))
    y_factor_by_orbit = [variable_axis(scales_of(orbit, units), variable).factor for orbit in orbits]
    ax = axes_or_new(ax)
    marker_by_index: dict[int, Any] = {}
    ax.axvline(value, color=WALL_COLOUR, linewidth=0.8, linestyle=":", zorder=0)
    for orbit_index, orbit in enumerate(orbits):
        mirror_index = orbit_index if orbit.mirror_of is None else orbit.mirror_of
        first_image_index = min(orbit_index, mirror_index)
        is_first_image = first_image_index not in marker_by_index
        marker = marker_by_index.setdefault(first_image_index, MARKERS[len(marker_by_index) % len(MARKERS)])
        y = y_factor_by_orbit[orbit_index] * _section_coordinates(orbit)["xv".index(variable)]
        marker_style = {"marker": marker, "markerfacecolor": ORBIT_COLOUR if orbit.stable else "white", "zorder": 6}
        mirror_image_text = " and mirror image" if mirror_index != orbit_index else ""
        legend_text = f"{orbit.label}{mirror_image_text}, {_stability_word(orbit)}" if is_first_image else None
        ax.plot(
            np.full(len(y), value),
            y,
            color=ORBIT_COLOUR,
            markersize=5.5,
            linestyle="none",
            label=legend_text,
            **marker_style,
        )
    return ax


def _section_coordinates(orbit):
    """Return x and v at phase 0 of each period, from the nearest samples, as two arrays of shape (periods,)."""
    trajectory = simulate(orbit.scene, orbit.state, orbit.periods, SAMPLES_PER_PERIOD)
    phase_in_periods = trajectory["phase"].values[:-1] / (2 * np.pi)
    section_rows = (
        abs(phase_in_periods - np.round(phase_in_periods)).reshape(orbit.periods, SAMPLES_PER_PERIOD).argmin(axis=1)
    )
    section_rows += SAMPLES_PER_PERIOD * np.arange(orbit.periods)
    return trajectory["x"].values[section_rows], trajectory["v"].values[section_rows]
