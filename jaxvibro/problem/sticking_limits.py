"""Locate the limits of orbits that stick: incipient complete chatter (CH), and releases while sticking (RL).

At a CH the speed of the last recorded bounce has the critical value of `orbits.chatter`. This condition is an
additional equation, which is smooth near the point. Beyond the point the mass leaves the wall after finitely many
bounces. At an RL the least contact force within a sticking phase vanishes, and beyond the point the mass is released
earlier.
"""

import numpy as np

from continuation.hostcall import FAST_COMPILE, persistent_jit

from ..compiled.kernel_calls import call_as_kernel
from ..contact.kinds import flow_coefficients
from ..orbits import chatter_and_release, impact_equations
from ..orbits.flight_clearance import GRAZING_TOLERANCE
from .orbit_diagnostics import diagnose
from .orbit_equations import scene_at, sequence_at


def _row_values_kernel(z, problem, function_of_start):
    coeffs, sequence = flow_coefficients(scene_at(problem, z)), sequence_at(problem, z)
    return chatter_and_release.evaluate_chatter_starts(
        function_of_start, coeffs, sequence, impact_equations.compute_flights(coeffs, sequence)
    )


@persistent_jit(static_argnums=0, compiler_options=FAST_COMPILE)
def _evaluate_row_values(function_of_start, z, problem):
    return call_as_kernel(_row_values_kernel, z, problem, function_of_start=function_of_start)


def excess_speeds(problem, z):
    """Return the excess of the speed of each row over the largest speed that leads to sticking.

    Parameters
    ----------
    problem : OrbitProblem
        Equations of the orbit.
    z : ndarray
        Unknowns.

    Returns
    -------
    ndarray
        Array of shape (rows,), inf for rows without a following release. See `chatter_and_release.excess_speed`.
    """
    return np.asarray(_evaluate_row_values(chatter_and_release.excess_speed, z, problem))


def min_contact_forces(problem, z):
    """Return the least contact force between each row and its release.

    For an impact with R = 0 that no release follows, the value is the force that pulls the mass off the wall.

    Parameters
    ----------
    problem : OrbitProblem
        Equations of the orbit.
    z : ndarray
        Unknowns.

    Returns
    -------
    ndarray
        Array of shape (rows,), inf for other rows.
    """
    return np.asarray(diagnose(problem, z[None]).min_contact_force)[0]


def toggle_early_lift_off(problem, z):
    """Switch between equations of orbits with and without a lift-off of the mass before it sticks.

    Parameters
    ----------
    problem : OrbitProblem
        Equations of the orbit.
    z : ndarray
        Unknowns.

    Returns
    -------
    OrbitProblem or None
        Switched equations; None if the orbit does not stick, or if no sticking phase begins with zero contact force.
    """
    if problem.sequence.releases is None:
        return None
    zero_force_rows = np.flatnonzero(
        abs(np.asarray(_evaluate_row_values(chatter_and_release.initial_contact_force, z, problem)))
        < GRAZING_TOLERANCE * problem.length_scale
    )
    if not len(zero_force_rows):
        return None
    release_codes = np.array(problem.sequence.releases)
    release_rows = (zero_force_rows + 1) % np.count_nonzero(problem.sequence.sides)
    release_codes[release_rows] = 3.0 - release_codes[release_rows]
    return problem._replace(sequence=problem.sequence._replace(releases=release_codes))


def locate_sticking_limit(problem, z, row, row_values_of):
    """Locate the point near z at which the excess speed or the least contact force of a row is zero.

    Parameters
    ----------
    problem : OrbitProblem
        Equations of the orbit.
    z : ndarray
        Guess.
    row : int
        Row of the impact.
    row_values_of : callable
        `excess_speeds` or `min_contact_forces`.

    Returns
    -------
    continuation.augmented_systems.RootAndResidual
        Solution.
    """
    n_rows, next_row = problem.n_rows, (row + 1) % problem.n_used_rows
    # The values depend on the times and speeds of the row and of the next row, and on the parameters.
    entry_indices = [*sorted({row, next_row, n_rows + row, n_rows + next_row}), *range(2 * n_rows, len(z))]
    return problem.locate_zero(z, lambda z: row_values_of(problem, z)[row], entry_indices)


def sticking_limit_kind(problem, z):
    """Classify the limit of an orbit that sticks.

    Parameters
    ----------
    problem : OrbitProblem
        Equations of the orbit.
    z : ndarray
        Unknowns.

    Returns
    -------
    str
        ``"CH"`` if a sticking phase begins to exist, ``"RL"`` if the least contact force vanishes, otherwise empty.
    """
    rounding_tolerance, release_codes = GRAZING_TOLERANCE * problem.length_scale, problem.sequence.releases
    zero_force_rows = np.flatnonzero(abs(min_contact_forces(problem, z)) < rounding_tolerance)
    if release_codes is None:
        return "CH" if len(zero_force_rows) else ""
    next_release_codes = release_codes[(zero_force_rows + 1) % np.count_nonzero(problem.sequence.sides)]
    if (next_release_codes == 0).any() or (abs(excess_speeds(problem, z)) < rounding_tolerance).any():
        return "CH"
    return "RL" if len(zero_force_rows) else ""
