"""Compute the derivative from a grazing contact to the next, along the orbit that omits these contacts."""

from typing import NamedTuple

import jax.numpy as jnp
import numpy as np
from jaxtyping import Float

from continuation import augmented_systems
from continuation.persistent_jit import FAST_COMPILE, persistent_jit

from ..compiled.kernels import call_as_kernel
from ..flight import flow_matrix
from ..flight.coefficients import flow_coefficients
from ..flight.flows import flow_of
from ..orbits import impact_equations
from ..orbits.flight_clearance import OVERLAP_FACTOR, state_in_flight
from ..orbits.saltation import saltation_matrices
from ..scene.symmetry import stays_symmetric
from .diagnostics import free_flight
from .equations import OrbitEquations, are_impacts, continuation_problem, scene_at, sequence_at
from .grazing import ImpactEntry, with_grazing_contacts, with_impacts
from .grazing_contact import contact_durations_at, find_grazing_contacts, orbit_duration_at
from .grazing_depths import OmittedGrazing, find_omitted_grazings
from .orbit_point import OrbitPoint, is_own_mirror_image

HALF_TOLERANCE = 1e-6  # relative to the orbit's duration; applies to contacts half of it apart or identical
REPEAT_TOLERANCE = 1e-6  # relative to the scene's length; residual of an orbit with fewer periods


class GrazingReturn(NamedTuple):
    """Orbit at a grazing without its grazing contacts, and the map from one contact to the next.

    Attributes
    ----------
    reduced_problem : OrbitEquations
        Equations of the orbit.
    z : ndarray
        Its unknowns.
    omitted_grazings : tuple of OmittedGrazing
        The grazing contacts.
    matrix : ndarray
        Derivative of (x, v) at the next contact with respect to (x, v) at the first, array of shape (2, 2). For a
        symmetric orbit that touches both walls it covers half of the orbit, followed by the mirror image.
    is_half : bool
        Whether it covers half of the orbit.
    return_time : float
        Duration from one contact to the next.
    """

    reduced_problem: OrbitEquations
    z: Float[np.ndarray, " unknowns"]
    omitted_grazings: tuple[OmittedGrazing, ...]
    matrix: Float[np.ndarray, "2 2"]
    is_half: bool
    return_time: float


def compute_grazing_return(scene, name, problem, z, length_scale):
    """Compute the return map at a grazing.

    Parameters
    ----------
    scene : Scene
        Scene at the point.
    name : str
        Parameter of the branch.
    problem : OrbitEquations
        Equations of the orbit.
    z : ndarray
        Unknowns at the grazing.
    length_scale : float
        Length of the scene.

    Returns
    -------
    GrazingReturn or None
        Return map; None if no wall is touched from outside.
    """
    grazing_contacts = find_grazing_contacts(problem, z, length_scale)
    if not grazing_contacts:
        return None
    reduced_problem, reduced_z, omitted = with_grazing_contacts(
        problem, z, grazing_contacts, (False,) * len(grazing_contacts)
    )
    omitted_grazings = find_omitted_grazings(scene, reduced_problem, reduced_z, omitted, length_scale)
    reduced_problem, reduced_z, omitted_grazings = _single_traversal(
        reduced_problem, reduced_z, omitted_grazings, length_scale
    )
    is_half = _are_mirror_images(scene, name, reduced_problem, reduced_z, omitted_grazings)
    end_contacts = (omitted_grazings[0], omitted_grazings[1]) if is_half else (omitted_grazings[0], omitted_grazings[0])
    matrix = _matrix_between(reduced_problem, reduced_z, *end_contacts) * (-1.0 if is_half else 1.0)
    return GrazingReturn(
        reduced_problem,
        reduced_z,
        omitted_grazings,
        matrix,
        is_half,
        orbit_duration_at(reduced_problem, reduced_z) * (0.5 if is_half else 1.0),
    )


def _single_traversal(reduced_problem, z, omitted_grazings, length_scale):
    """Reduce the orbit to its least number of periods, together with its grazing contacts."""
    n_periods, impact_rows = (
        int(reduced_problem.sequence.periods),
        reduced_problem.impact_rows if len(reduced_problem.sequence.sides) else (),
    )
    for n_fewer_periods in (
        divisor
        for divisor in range(1, n_periods)
        if n_periods % divisor == 0 and len(impact_rows) * divisor % n_periods == 0
    ):
        impacts = [
            ImpactEntry(z[k], z[len(reduced_problem.sequence.sides) + k], reduced_problem.sequence.sides[k], True)
            for k in impact_rows
        ]
        short_problem, short_z = with_impacts(
            reduced_problem, z, impacts[: len(impact_rows) * n_fewer_periods // n_periods]
        )
        short_problem = short_problem._replace(
            sequence=short_problem.sequence._replace(periods=np.asarray(float(n_fewer_periods)))
        )
        residual, _ = augmented_systems.evaluate(continuation_problem(short_problem), short_z, short_problem)
        if abs(np.asarray(residual)).max() <= REPEAT_TOLERANCE * length_scale:
            return short_problem, short_z, _relocate_contacts(short_problem, short_z, omitted_grazings)
    return reduced_problem, z, omitted_grazings


def _relocate_contacts(short_problem, z, omitted_grazings):
    """Express the grazing contacts of a repeated orbit as those of a single traversal, without duplicates."""
    orbit_duration, contact_durations, distinct_contacts = (
        orbit_duration_at(short_problem, z),
        contact_durations_at(short_problem, z),
        [],
    )
    flight_starts = (
        z[short_problem.impact_rows] + contact_durations[short_problem.impact_rows]
        if len(short_problem.sequence.sides)
        else np.zeros(1)
    )
    for contact in omitted_grazings:
        elapsed_times = (contact.time - flight_starts) % orbit_duration
        row = int(np.argmin(elapsed_times))
        relocated = contact._replace(
            row=row, time_in_flight=float(elapsed_times[row]), time=float(flight_starts[row] + elapsed_times[row])
        )
        time_distances = (
            abs((relocated.time - other.time + 0.5 * orbit_duration) % orbit_duration - 0.5 * orbit_duration)
            for other in distinct_contacts
        )
        if not any(distance < HALF_TOLERANCE * orbit_duration for distance in time_distances):
            distinct_contacts.append(relocated)
    return tuple(distinct_contacts)


def _are_mirror_images(scene, name, reduced_problem, z, omitted_grazings):
    """Test whether two grazing contacts are mirror images of each other along the whole branch."""
    if (
        len(omitted_grazings) != 2
        or omitted_grazings[0].depth.side == omitted_grazings[1].depth.side
        or not stays_symmetric(scene, name)
    ):
        return False
    orbit_duration = orbit_duration_at(reduced_problem, z)
    if (
        abs((omitted_grazings[1].time - omitted_grazings[0].time) % orbit_duration - 0.5 * orbit_duration)
        > HALF_TOLERANCE * orbit_duration
    ):
        return False
    n_rows, impact_rows = len(reduced_problem.sequence.sides), np.flatnonzero(are_impacts(reduced_problem.sequence))
    state = (0.0, 0.0) if n_rows else z[:2]
    impact_columns = z[impact_rows], z[n_rows + impact_rows], np.asarray(reduced_problem.sequence.sides)[impact_rows]
    return is_own_mirror_image(
        scene, OrbitPoint(z[-1], *impact_columns, int(reduced_problem.sequence.periods), *state, 0.0)
    )


def _matrix_between(reduced_problem, z, start_contact, end_contact):
    """Return the derivative from one contact to another, or once around the orbit if they coincide, of shape (2, 2)."""
    n_flights = max(1, len(reduced_problem.impact_rows))
    begin_times, end_times = (
        np.zeros(max(1, len(reduced_problem.sequence.sides))),
        np.full(max(1, len(reduced_problem.sequence.sides)), np.inf),
    )
    if start_contact.row == end_contact.row and start_contact.time_in_flight < end_contact.time_in_flight:
        begin_times[start_contact.row], end_times[end_contact.row] = (
            start_contact.time_in_flight,
            end_contact.time_in_flight,
        )
        return _matrices_of_rows(reduced_problem, z, begin_times, end_times)[0][start_contact.row]
    first_begin_times, last_end_times = begin_times.copy(), end_times.copy()
    first_begin_times[start_contact.row], last_end_times[end_contact.row] = (
        start_contact.time_in_flight,
        end_contact.time_in_flight,
    )
    first_flight, last_flight, whole_flights = (
        _matrices_of_rows(reduced_problem, z, *time_limits)
        for time_limits in ((first_begin_times, end_times), (begin_times, last_end_times), (begin_times, end_times))
    )
    matrix, row = first_flight[0][start_contact.row], start_contact.row
    while True:
        row = (row + 1) % n_flights
        flight_matrices, impact_matrices = last_flight if row == end_contact.row else whole_flights
        matrix = flight_matrices[row] @ impact_matrices[row] @ matrix
        if row == end_contact.row:
            return matrix


def _propagate(problem, z, begin_times, end_times):
    """Return the matrices of the flights between two times, and of the impacts, entry by entry."""
    if len(problem.sequence.sides):
        coeffs, sequence = flow_coefficients(scene_at(problem, z)), sequence_at(problem, z)
        flights = impact_equations.compute_flights(coeffs, sequence)
        impact_matrices, durations = saltation_matrices(coeffs, flights.contact_map, sequence.sides)[0], flights.time
    else:
        coeffs, flights = free_flight(problem, z)
        ones, durations = jnp.ones_like(flights.time), flights.time / OVERLAP_FACTOR
        impact_matrices = ones, 0.0 * ones, 0.0 * ones, ones
    x, v, cosine, sine = state_in_flight(coeffs, flights, begin_times)
    _, matrix = flow_of(coeffs).fly_with_matrix(
        coeffs, x, v, cosine, sine, jnp.minimum(end_times, durations) - begin_times
    )
    return jnp.stack(flow_matrix.matrix_by_rows(matrix)), jnp.stack(impact_matrices)


@persistent_jit(compiler_options=FAST_COMPILE, numpy_first=_propagate)
def _propagate_compiled(problem, z, begin_times, end_times):
    return call_as_kernel(_propagate, problem, z, begin_times, end_times)


def _matrices_of_rows(problem, z, begin_times, end_times):
    """Return the matrices of each row's flight between two times and of each impact, arrays of shape (rows, 2, 2)."""
    entries = _propagate_compiled(problem, z, begin_times, end_times)
    return tuple(np.moveaxis(np.asarray(matrix_entries), 0, -1).reshape(-1, 2, 2) for matrix_entries in entries)
