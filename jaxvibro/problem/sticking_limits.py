"""Locate the limits of orbits that stick: incipient complete chatter (CH), and releases while sticking (RL).

At a CH the speed at the row of the last recorded bounce is critical (`orbits.chatter`). This is an additional equation,
smooth through the point; on the other side the mass leaves the wall after finitely many bounces. At an RL the least
contact force within a sticking phase vanishes, and the mass is released there.
"""

import numpy as np

from continuation.persistent_jit import FAST_COMPILE, persistent_jit

from ..compiled.kernels import call_as_kernel
from ..flight.coefficients import flow_coefficients
from ..orbits import chatter_and_release, impact_equations
from ..orbits.flight_clearance import GRAZING_TOLERANCE
from .diagnostics import diagnose
from .equations import scene_at, sequence_at
from .grazing_contact import locate_zero


def _measure_kernel(z, problem, measure):
    coeffs, sequence = flow_coefficients(scene_at(problem, z)), sequence_at(problem, z)
    return chatter_and_release.map_chatter_starts(
        measure, coeffs, sequence, impact_equations.compute_flights(coeffs, sequence)
    )


@persistent_jit(static_argnums=0, compiler_options=FAST_COMPILE)
def _evaluate_measure(measure, z, problem):
    return call_as_kernel(_measure_kernel, z, problem, measure=measure)


def excess_speeds(problem, z):
    """Return the excess of each row's speed over the largest one that leads to sticking.

    Parameters
    ----------
    problem : OrbitEquations
        Equations of the orbit.
    z : ndarray
        Unknowns.

    Returns
    -------
    ndarray
        Array of shape (rows,), inf for rows that no release follows. See `chatter_and_release.excess_speed`.
    """
    return np.asarray(_evaluate_measure(chatter_and_release.excess_speed, z, problem))


def min_contact_forces(problem, z):
    """Return the least contact force between each row and its release.

    For a mass that leaves its wall with zero speed it is the force that pulls it off.

    Parameters
    ----------
    problem : OrbitEquations
        Equations of the orbit.
    z : ndarray
        Unknowns.

    Returns
    -------
    ndarray
        Array of shape (rows,), inf for other rows.
    """
    return np.asarray(diagnose(problem, z[None]).min_contact_force)[0]


def toggle_lift_off(problem, z, length_scale):
    """Switch between orbits whose mass lifts off before sticking and orbits whose mass does not.

    Parameters
    ----------
    problem : OrbitEquations
        Equations of the orbit.
    z : ndarray
        Unknowns.
    length_scale : float
        Length of the scene.

    Returns
    -------
    OrbitEquations or None
        Switched equations; None if no contact force begins at an impact.
    """
    if problem.sequence.releases is None:
        return None
    switching_rows = np.flatnonzero(
        abs(np.asarray(_evaluate_measure(chatter_and_release.initial_contact_force, z, problem)))
        < GRAZING_TOLERANCE * length_scale
    )
    if not len(switching_rows):
        return None
    release_codes = np.array(problem.sequence.releases)
    release_rows = (switching_rows + 1) % np.count_nonzero(problem.sequence.sides)
    release_codes[release_rows] = 3.0 - release_codes[release_rows]
    return problem._replace(sequence=problem.sequence._replace(releases=release_codes))


def locate_sticking_limit(problem, z, row, measure):
    """Locate the point near z at which a measure of a row vanishes.

    Parameters
    ----------
    problem : OrbitEquations
        Equations of the orbit.
    z : ndarray
        Guess.
    row : int
        Row.
    measure : callable
        `excess_speeds` or `min_contact_forces`.

    Returns
    -------
    continuation.augmented_systems.PointSolution
        Solution.
    """
    return locate_zero(problem, z, lambda z: measure(problem, z)[row], _relevant_indices(problem, z, row))


def _relevant_indices(problem, z, row):
    """Return the indices of the unknowns of a row's measure: its impact, the next one, and the parameters."""
    n_rows, next_row = len(problem.sequence.sides), (row + 1) % np.count_nonzero(problem.sequence.sides)
    return [*sorted({row, next_row, n_rows + row, n_rows + next_row}), *range(2 * n_rows, len(z))]


def sticking_limit_kind(problem, z, length_scale):
    """Classify the limit of an orbit that sticks.

    Parameters
    ----------
    problem : OrbitEquations
        Equations of the orbit.
    z : ndarray
        Unknowns.
    length_scale : float
        Length of the scene.

    Returns
    -------
    str
        ``"CH"`` if a sticking phase just exists, ``"RL"`` if the contact force just holds, else empty.
    """
    tolerance, release_codes = GRAZING_TOLERANCE * length_scale, problem.sequence.releases
    zero_force_rows = np.flatnonzero(abs(min_contact_forces(problem, z)) < tolerance)
    if release_codes is None:
        return "CH" if len(zero_force_rows) else ""
    next_releases = release_codes[(zero_force_rows + 1) % np.count_nonzero(problem.sequence.sides)]
    if (next_releases == 0).any() or (abs(excess_speeds(problem, z)) < tolerance).any():
        return "CH"
    return "RL" if len(zero_force_rows) else ""
