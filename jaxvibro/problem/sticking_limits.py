"""Where orbits that rest end: a chatter that just does not complete (CH), a wall that lets go in the midst of a rest.

At a CH the speed of the last hop's row is the critical one (`orbits.chatter`): an equation beside those of the orbit,
smooth through the point, whose orbits on the other side leave the wall after some last hops. The press on the wall that
is least within a rest is another: where it comes to zero the mass is let go there.
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
    """By how much the speed in each row is too large for a rest, (rows,), inf of rows that no release follows; see
    `releases.too_fast`."""
    return np.asarray(_evaluate_measure(chatter_and_release.excess_speed, z, problem))


def min_contact_forces(problem, z):
    """The least press between two falls of it on the way from each row to a release, or how hard the mass is drawn off
    the wall that it leaves without speed, (rows,), inf elsewhere."""
    return np.asarray(diagnose(problem, z[None]).min_contact_force)[0]


def toggle_lift_off(problem, z, length_scale):
    """The equations with the mass drawn off its wall before a rest where it just is not, or the other way round; None
    where the press is not about to begin at an impact."""
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
    """The point near z where a measure of a row, of `excess_speeds` or `min_contact_forces`, is zero:
    `locate.Located`."""
    return locate_zero(problem, z, lambda z: measure(problem, z)[row], _relevant_indices(problem, z, row))


def _relevant_indices(problem, z, row):
    """The places in z of what a measure of a row depends on: its impact, the one that follows, and the parameters."""
    n_rows, next_row = len(problem.sequence.sides), (row + 1) % np.count_nonzero(problem.sequence.sides)
    return [*sorted({row, next_row, n_rows + row, n_rows + next_row}), *range(2 * n_rows, len(z))]


def sticking_limit_kind(problem, z, length_scale):
    """ "CH" or "RL" where a rest of the orbit just is one, or its wall just holds; "" elsewhere."""
    tolerance, release_codes = GRAZING_TOLERANCE * length_scale, problem.sequence.releases
    zero_force_rows = np.flatnonzero(abs(min_contact_forces(problem, z)) < tolerance)
    if release_codes is None:
        return "CH" if len(zero_force_rows) else ""
    next_releases = release_codes[(zero_force_rows + 1) % np.count_nonzero(problem.sequence.sides)]
    if (next_releases == 0).any() or (abs(excess_speeds(problem, z)) < tolerance).any():
        return "CH"
    return "RL" if len(zero_force_rows) else ""
