"""Draw one periodic orbit in the phase plane, or many in a sweep diagram."""

import numpy as np
from matplotlib.axes import Axes

from ..maps.simulate import simulate
from ..orbits.orbit import Orbit
from .diagram import mark_motions
from .portrait import portrait
from .style import COLOURS, check_plot_options, require_record, require_records

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
    return mark_motions(orbits, value, variable, ax, units, MARKERS, _orbit_mark)


def _orbit_mark(orbit, marker, is_first_image, has_mirror_image):
    """Return (points on the section, style) of an orbit in a diagram."""
    mirror_image_text = " and mirror image" if has_mirror_image else ""
    return _section_points(orbit), {
        "color": ORBIT_COLOUR,
        "marker": marker,
        "markerfacecolor": ORBIT_COLOUR if orbit.stable else "white",
        "label": f"{orbit.label}{mirror_image_text}, {_stability_word(orbit)}" if is_first_image else None,
        "zorder": 6,
    }


def _section_points(orbit):
    """Return (x, v) at phase 0 of each period, from the nearest samples; shape (periods, 2)."""
    trajectory = simulate(orbit.scene, orbit.state, orbit.periods, SAMPLES_PER_PERIOD)
    phase_in_periods = trajectory["phase"].values[:-1] / (2 * np.pi)
    section_rows = (
        abs(phase_in_periods - np.round(phase_in_periods)).reshape(orbit.periods, SAMPLES_PER_PERIOD).argmin(axis=1)
    )
    section_rows += SAMPLES_PER_PERIOD * np.arange(orbit.periods)
    return np.stack([trajectory[name].values[section_rows] for name in ("x", "v")], axis=-1)
