"""Compute the change of motion by a grazing contact, and its derivative from a grazing contact to the next.

Compute the depth of the contact beyond a grazing, along the orbit that omits the contact. Let d be the depth and a the
acceleration away from the wall at the grazing. At a rigid wall the mass has the speed sqrt(2 a d), and the impact
changes the velocity by (1 + R) sqrt(2 a d). All other changes are smooth (Nordmark, J. Sound Vib. 145, 279, 1991). A
soft wall with a continuous force changes the velocity in proportion to a higher power of d (`grazing_exponent`), for a
spring and a damper d^(3/2). If a soft wall moves and has a separate damping, the force jumps by j at the wall, and the
acceleration within is a + j. If a + j > 0, the contact lasts 2 sqrt(2 a d) / (a + j) and changes the velocity by j
times this duration.
"""

from typing import NamedTuple

import jax.numpy as jnp
import numpy as np
from jaxtyping import Float

from continuation.hostcall import FAST_COMPILE, persistent_jit

from ..compiled.kernel_calls import call_as_kernel
from ..contact.kinds import flow_coefficients
from ..flight import flow_matrix
from ..orbits import impact_equations
from ..orbits.contact_maps import saltation_matrices
from ..orbits.flight_clearance import OVERLAP_FACTOR, state_in_flight
from ..scene.scene_properties import stays_symmetric
from .grazing_contact import (
    contact_durations_at,
    distance_growth_rate,
    find_grazing_contacts,
    include_grazing_contacts,
    refine_turning_point,
    scene_wall_sides,
)
from .orbit_equations import flight_without_impacts, scene_at, sequence_at
from .orbit_point import is_own_mirror_image
from .orbit_problem import OrbitProblem
from .soft_wall_grazing import is_smooth_soft_wall


class GrazingJump(NamedTuple):
    """Velocity jump and depth of a contact beyond a grazing, to leading order.

    Attributes
    ----------
    side : int
        Side of the wall, -1 or 1.
    root : float
        Jump of the velocity divided by the square root of the depth. It is 0 if the jump is proportional to a higher
        power of the depth, and inf if the acceleration within a soft wall is not directed out of the wall.
    slope : float
        Derivative of the depth with respect to the parameter along the orbit that omits all grazing contacts.
    acceleration : float
        Acceleration of the mass away from the wall, relative to the wall.
    """

    side: int
    root: float
    slope: float
    acceleration: float


def grazing_jumps(scene, problem, z):
    """Compute the velocity jump and the depth of each contact beyond a grazing.

    Parameters
    ----------
    scene : Scene
        Scene at the point.
    problem : OrbitProblem
        Equations of the orbit.
    z : ndarray
        Unknowns at the grazing.

    Returns
    -------
    tuple of GrazingJump
        One entry for each grazing contact, in order along the orbit.
    """
    grazing_contacts = find_grazing_contacts(problem, z)
    reduced_problem, reduced_z, omitted_locations = include_grazing_contacts(
        problem, z, grazing_contacts, (False,) * len(grazing_contacts)
    )
    return tuple(
        omitted_grazing.depth
        for omitted_grazing in find_omitted_grazings(scene, reduced_problem, reduced_z, omitted_locations)
    )


class OmittedGrazing(NamedTuple):
    """Grazing contact with a wall, along an orbit that omits all grazing contacts.

    Attributes
    ----------
    row : int
        Row of the impact before the grazing contact.
    time_in_flight : float
        Time since the start of the flight after that impact.
    time : float
        Time since phase 0 of the drive.
    depth : GrazingJump
        Velocity jump and depth of the contact.
    """

    row: int
    time_in_flight: float
    time: float
    depth: GrazingJump


def find_omitted_grazings(scene, reduced_problem, reduced_z, omitted_locations):
    """Locate the `OmittedGrazing` of each contact that `include_grazing_contacts` omits."""
    tangent = reduced_problem.tangent(reduced_z)
    wall_sides, omitted_grazings, contact_durations = (
        scene_wall_sides(reduced_problem.scene),
        [],
        contact_durations_at(reduced_problem, reduced_z),
    )
    for row, wall_index, time_in_flight in omitted_locations:
        time_in_flight, _, approach_acceleration = refine_turning_point(
            reduced_problem, reduced_z, row, wall_index, time_in_flight
        )
        side, penetration_rate = (
            wall_sides[wall_index],
            -distance_growth_rate(reduced_problem, reduced_z, tangent, row, wall_index, time_in_flight),
        )
        depth_slope = penetration_rate / tangent[-1] if tangent[-1] else np.inf
        flight_start_time = reduced_z[row] + contact_durations[row] if len(reduced_problem.sequence.sides) else 0.0
        separation_acceleration, time = -float(approach_acceleration), float(flight_start_time + time_in_flight)
        grazing_jump = GrazingJump(
            side,
            _jump_coefficient(scene, side, separation_acceleration, time),
            float(depth_slope),
            separation_acceleration,
        )
        omitted_grazings.append(OmittedGrazing(int(row), float(time_in_flight), time, grazing_jump))
    return tuple(omitted_grazings)


def _jump_coefficient(scene, side, separation_acceleration, time):
    """Return the jump of the velocity divided by the square root of the depth."""
    wall = scene.left if side < 0 else scene.right
    if not wall.soft:
        restitution = scene.restitution if wall.restitution is None else wall.restitution
        return float((1.0 + float(restitution)) * np.sqrt(2.0 * separation_acceleration))
    if is_smooth_soft_wall(scene, side):
        return 0.0
    wall_motion_frequency = wall.motion.harmonic * float(scene.frequency)
    wall_velocity = (
        -float(wall.motion.amplitude)
        * wall_motion_frequency
        * np.sin(wall_motion_frequency * time + float(wall.motion.phase))
    )
    scene_damping = 0.0 if scene.force is not None else float(scene.damping)
    acceleration_jump = side * 2.0 * (float(wall.damping) - scene_damping) * wall_velocity
    acceleration_in_contact = separation_acceleration + acceleration_jump
    return (
        float(2.0 * np.sqrt(2.0 * separation_acceleration) * abs(acceleration_jump) / acceleration_in_contact)
        if acceleration_in_contact > 0
        else np.inf
    )


HALF_TOLERANCE = 1e-6  # relative to the orbit's duration; applies to contacts half of it apart or identical
REPEAT_TOLERANCE = 1e-6  # relative to the scene's length; residual of an orbit with fewer periods


class GrazingReturn(NamedTuple):
    """Orbit at a grazing without its grazing contacts, and the map from one contact to the next.

    Attributes
    ----------
    reduced_problem : OrbitProblem
        Equations of the orbit.
    z : ndarray
        Unknowns of the orbit.
    omitted_grazings : tuple of OmittedGrazing
        The grazing contacts.
    matrix : ndarray
        Derivative of (x, v) at the next contact with respect to (x, v) at the first, array of shape (2, 2). For a
        symmetric orbit that grazes both walls, `matrix` covers half of the orbit, followed by the mirror image.
    is_half_orbit : bool
        True if `matrix` covers half of the orbit.
    return_time : float
        Duration from one contact to the next.
    """

    reduced_problem: OrbitProblem
    z: Float[np.ndarray, " unknowns"]
    omitted_grazings: tuple[OmittedGrazing, ...]
    matrix: Float[np.ndarray, "2 2"]
    is_half_orbit: bool
    return_time: float


def compute_grazing_return(scene, parameter_name, problem, z):
    """Compute the return map at a grazing.

    Parameters
    ----------
    scene : Scene
        Scene at the point.
    parameter_name : str
        Parameter of the branch.
    problem : OrbitProblem
        Equations of the orbit.
    z : ndarray
        Unknowns at the grazing.

    Returns
    -------
    GrazingReturn or None
        Return map; None if the point has no grazing contacts.
    """
    grazing_contacts = find_grazing_contacts(problem, z)
    if not grazing_contacts:
        return None
    reduced_problem, reduced_z, omitted_locations = include_grazing_contacts(
        problem, z, grazing_contacts, (False,) * len(grazing_contacts)
    )
    omitted_grazings = find_omitted_grazings(scene, reduced_problem, reduced_z, omitted_locations)
    reduced_problem, reduced_z, omitted_grazings = _reduce_repeated_orbit(reduced_problem, reduced_z, omitted_grazings)
    is_half_orbit = _are_mirror_images(scene, parameter_name, reduced_problem, reduced_z, omitted_grazings)
    first_and_next_contact = (
        (omitted_grazings[0], omitted_grazings[1]) if is_half_orbit else (omitted_grazings[0], omitted_grazings[0])
    )
    return_matrix = _matrix_between(reduced_problem, reduced_z, *first_and_next_contact) * (
        -1.0 if is_half_orbit else 1.0
    )
    return GrazingReturn(
        reduced_problem,
        reduced_z,
        omitted_grazings,
        return_matrix,
        is_half_orbit,
        reduced_problem.duration(reduced_z) * (0.5 if is_half_orbit else 1.0),
    )


def _reduce_repeated_orbit(reduced_problem, reduced_z, omitted_grazings):
    """Reduce a repeated orbit, with its grazing contacts, to a single traversal of the shorter orbit."""
    n_periods, n_impacts = int(reduced_problem.sequence.periods), len(reduced_problem.impact_rows)
    for n_short_periods in (
        period_divisor
        for period_divisor in range(1, n_periods)
        if n_periods % period_divisor == 0 and n_impacts * period_divisor % n_periods == 0
    ):
        short_rows = reduced_problem.impact_rows[: n_impacts * n_short_periods // n_periods]
        short_problem, short_z = reduced_problem.with_rows(reduced_z, short_rows)
        short_problem = short_problem._replace(
            sequence=short_problem.sequence._replace(periods=np.asarray(float(n_short_periods)))
        )
        residual, _ = short_problem.evaluate(short_z)
        if abs(residual).max() <= REPEAT_TOLERANCE * reduced_problem.length_scale:
            return short_problem, short_z, _contacts_in_traversal(short_problem, short_z, omitted_grazings)
    return reduced_problem, reduced_z, omitted_grazings


def _contacts_in_traversal(short_problem, short_z, omitted_grazings):
    """Return the grazing contacts of a repeated orbit relative to a single traversal, without duplicates."""
    orbit_duration, contact_durations, distinct_contacts = (
        short_problem.duration(short_z),
        contact_durations_at(short_problem, short_z),
        [],
    )
    flight_starts = (
        short_z[short_problem.impact_rows] + contact_durations[short_problem.impact_rows]
        if len(short_problem.sequence.sides)
        else np.zeros(1)
    )
    for omitted_grazing in omitted_grazings:
        elapsed_times = (omitted_grazing.time - flight_starts) % orbit_duration
        row = int(np.argmin(elapsed_times))
        contact_in_traversal = omitted_grazing._replace(
            row=row, time_in_flight=float(elapsed_times[row]), time=float(flight_starts[row] + elapsed_times[row])
        )
        time_distances = (
            abs(
                (contact_in_traversal.time - other_contact.time + 0.5 * orbit_duration) % orbit_duration
                - 0.5 * orbit_duration
            )
            for other_contact in distinct_contacts
        )
        if not any(distance < HALF_TOLERANCE * orbit_duration for distance in time_distances):
            distinct_contacts.append(contact_in_traversal)
    return tuple(distinct_contacts)


def _are_mirror_images(scene, parameter_name, reduced_problem, reduced_z, omitted_grazings):
    """Test whether the two grazing contacts of an orbit are mirror images on all orbits of the branch."""
    if (
        len(omitted_grazings) != 2
        or omitted_grazings[0].depth.side == omitted_grazings[1].depth.side
        or not stays_symmetric(scene, parameter_name)
    ):
        return False
    orbit_duration = reduced_problem.duration(reduced_z)
    if (
        abs((omitted_grazings[1].time - omitted_grazings[0].time) % orbit_duration - 0.5 * orbit_duration)
        > HALF_TOLERANCE * orbit_duration
    ):
        return False
    return is_own_mirror_image(reduced_problem, reduced_z)


def _matrix_between(reduced_problem, reduced_z, start_contact, end_contact):
    """Return the derivative of the state from a contact to another contact, or to itself after one traversal."""
    n_flights = max(1, len(reduced_problem.impact_rows))
    flight_start_times, flight_end_times = (
        np.zeros(max(1, len(reduced_problem.sequence.sides))),
        np.full(max(1, len(reduced_problem.sequence.sides)), np.inf),
    )
    if start_contact.row == end_contact.row and start_contact.time_in_flight < end_contact.time_in_flight:
        flight_start_times[start_contact.row], flight_end_times[end_contact.row] = (
            start_contact.time_in_flight,
            end_contact.time_in_flight,
        )
        return _matrices_of_rows(reduced_problem, reduced_z, flight_start_times, flight_end_times)[0][start_contact.row]
    first_start_times, last_end_times = flight_start_times.copy(), flight_end_times.copy()
    first_start_times[start_contact.row], last_end_times[end_contact.row] = (
        start_contact.time_in_flight,
        end_contact.time_in_flight,
    )
    first_flight_matrices, last_flight_matrices, whole_flight_matrices = (
        _matrices_of_rows(reduced_problem, reduced_z, *time_limits)
        for time_limits in (
            (first_start_times, flight_end_times),
            (flight_start_times, last_end_times),
            (flight_start_times, flight_end_times),
        )
    )
    contact_to_contact, row = first_flight_matrices[0][start_contact.row], start_contact.row
    while True:
        row = (row + 1) % n_flights
        flight_matrices, impact_matrices = last_flight_matrices if row == end_contact.row else whole_flight_matrices
        contact_to_contact = flight_matrices[row] @ impact_matrices[row] @ contact_to_contact
        if row == end_contact.row:
            return contact_to_contact


def _flight_impact_matrices(problem, z, flight_start_times, flight_end_times):
    """Return (matrices of the flights between two times, saltation matrices of the impacts), by entries."""
    if len(problem.sequence.sides):
        coeffs, sequence = flow_coefficients(scene_at(problem, z)), sequence_at(problem, z)
        flights = impact_equations.compute_flights(coeffs, sequence)
        impact_matrices, durations = saltation_matrices(coeffs, flights.contact_map, sequence.sides)[0], flights.time
    else:
        coeffs, flights = flight_without_impacts(problem, z)
        identity_entries, durations = jnp.ones_like(flights.time), flights.time / OVERLAP_FACTOR
        impact_matrices = identity_entries, 0.0 * identity_entries, 0.0 * identity_entries, identity_entries
    x, v, cosine, sine = state_in_flight(coeffs, flights, flight_start_times)
    _, matrix = coeffs.flow.fly_with_matrix(
        coeffs, x, v, cosine, sine, jnp.minimum(flight_end_times, durations) - flight_start_times
    )
    return jnp.stack(flow_matrix.matrix_by_rows(matrix)), jnp.stack(impact_matrices)


@persistent_jit(compiler_options=FAST_COMPILE, numpy_first=True)
def _compiled_matrices(problem, z, flight_start_times, flight_end_times):
    return call_as_kernel(_flight_impact_matrices, problem, z, flight_start_times, flight_end_times)


def _matrices_of_rows(problem, z, flight_start_times, flight_end_times):
    """Return (flight matrices between two times, saltation matrices), arrays of shape (rows, 2, 2)."""
    flight_impact_entries = _compiled_matrices(problem, z, flight_start_times, flight_end_times)
    return tuple(
        np.moveaxis(np.asarray(matrix_entries), 0, -1).reshape(-1, 2, 2) for matrix_entries in flight_impact_entries
    )
