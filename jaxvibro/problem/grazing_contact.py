"""Locate grazing contacts: impacts with zero speed and flights that reach a wall at zero relative velocity."""

from functools import partial, singledispatch
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from continuation import augmented_systems
from continuation.persistent_jit import FAST_COMPILE, persistent_jit

from ..compiled.kernel_calls import call_as_kernel
from ..flight.flight_coefficients import flow_coefficients
from ..orbits import flight_clearance, impact_equations
from ..orbits.flight_clearance import GRAZING_TOLERANCE
from .orbit_diagnostics import diagnose, flight_without_impacts
from .orbit_equations import continuation_problem, parameter_value_at, scene_at, sequence_at

END_TOLERANCE = 1e-5  # relative to a flight; a contact closer to its ends belongs to the impact there
NEWTON_STEPS = 6  # Newton steps to a turning point


class GrazingContact(NamedTuple):
    """Grazing contact with a wall.

    Attributes
    ----------
    row : int
        Row of the impact at the grazing, or of the last impact before the grazing.
    side : int
        Side of the wall.
    time_since_impact : float
        Time since the impact of `row`.
    is_impact : bool
        True if the branch has the grazing contact as an impact.
    """

    row: int
    side: int
    time_since_impact: float
    is_impact: bool


def arclength_weights(problem, length_scale):
    """Return the weights of the unknowns in the arclength.

    Speeds, and parameters that are lengths, are divided by the length of the scene. Times are not scaled. Times and
    speeds contribute as a root mean square over the impacts. The unknowns x and v of an orbit without impacts are
    divided by the length of the scene.

    Parameters
    ----------
    problem : OrbitEquations
        Equations of the orbits.
    length_scale : float
        Length of the scene.

    Returns
    -------
    ndarray
        One weight for each unknown.
    """
    n_rows = len(problem.sequence.sides)
    impact_weight = 1.0 / max(1.0, np.sqrt(np.sum(problem.sequence.sides != 0)))
    impact_weights = np.asarray(problem.sequence.sides != 0, float) * impact_weight
    orbit_weights = (
        np.concatenate([impact_weights, impact_weights / length_scale]) if n_rows else np.ones(2) / length_scale
    )
    n_parameters = max(int(parameter_number) for parameter_number in jax.tree.leaves(problem.parameter_marks))
    return np.append(
        orbit_weights,
        [1.0 / _parameter_scale(problem.parameter_marks, k, length_scale) for k in range(1, n_parameters + 1)],
    )


def _parameter_scale(parameter_marks, parameter_number, length_scale):
    """Return the length of the scene if the parameter is a length, else 1."""
    wall_marks = parameter_marks.walls.values()
    length_marks = [
        parameter_marks.amplitude,
        *(term_marks.amplitude for term_marks in parameter_marks.drive),
        *(wall_mark.position for wall_mark in wall_marks),
    ]
    length_marks += [wall_mark.motion.amplitude for wall_mark in wall_marks if wall_mark.motion is not None]
    return length_scale if any(mark == parameter_number for mark in length_marks) else 1.0


def _relative_motion_kernel(z_and_time, problem, row, wall_index):
    """Return (distance, speed, acceleration) towards a wall in the flight after a row, at (z, time in flight)."""
    z, time_in_flight = z_and_time[:-1], z_and_time[-1]
    if len(problem.sequence.sides):
        coeffs = flow_coefficients(scene_at(problem, z))
        flights = impact_equations.compute_flights(coeffs, sequence_at(problem, z))
    else:
        coeffs, flights = flight_without_impacts(problem, z)
    wall_motions = flight_clearance.relative_motion(coeffs, flights, jnp.full_like(flights.time, time_in_flight))
    return jnp.stack([jnp.stack([wall_motion[k] for wall_motion in wall_motions])[wall_index, row] for k in range(3)])


@persistent_jit(compiler_options=FAST_COMPILE, numpy_first=_relative_motion_kernel)
def _relative_motion(z_and_time, problem, row, wall_index):
    return call_as_kernel(_relative_motion_kernel, z_and_time, problem, row, wall_index)


def wall_distance_and_speed(problem, row, wall_index, z_and_time):
    """Return (distance, speed) towards a wall at (z, time since the start of the flight)."""
    return np.asarray(_relative_motion(z_and_time, problem, np.int32(row), np.int32(wall_index)))[:2]


def locate_grazing(problem, z, row, wall_index, time_in_flight):
    """Locate the point near z at which the flight after a row reaches a wall with zero relative velocity."""
    contact_residual_of = partial(wall_distance_and_speed, problem, row, wall_index)

    def evaluate_extended_system(z_and_time):
        residual, jacobian = (
            np.asarray(system_array)
            for system_array in augmented_systems.evaluate_problem(
                continuation_problem(problem), z_and_time[:-1], problem
            )
        )
        extended_jacobian = np.vstack(
            [
                np.pad(jacobian, ((0, 0), (0, 1))),
                augmented_systems.two_point_derivative(contact_residual_of, z_and_time),
            ]
        )
        return np.concatenate([residual, contact_residual_of(z_and_time)]), extended_jacobian

    solution = augmented_systems.solve_newton(evaluate_extended_system, np.append(z, time_in_flight))
    return solution if solution.z is None else solution._replace(z=solution.z[:-1])


def locate_zero(problem, z, zero_function, dependency_indices=None):
    """Locate the point near z at which an additional function of z vanishes.

    Parameters
    ----------
    problem : OrbitEquations
        Equations of the orbit.
    z : ndarray
        Guess.
    zero_function : callable
        Function of z.
    dependency_indices : sequence of int, optional
        Indices of the unknowns on which the function depends. None means all unknowns.

    Returns
    -------
    continuation.augmented_systems.RootAndResidual
        Solution.
    """

    def evaluate_extended_system(z):
        residual, jacobian = (
            np.asarray(system_array)
            for system_array in augmented_systems.evaluate_problem(continuation_problem(problem), z, problem)
        )
        return np.append(residual, zero_function(z)), np.vstack(
            [jacobian, augmented_systems.two_point_derivative(zero_function, z, dependency_indices)]
        )

    return augmented_systems.solve_newton(evaluate_extended_system, z)


def refine_turning_point(problem, z, row, wall_index, time_in_flight):
    """Return (time, distance, acceleration towards the wall) at the turning point nearest to a time of a flight."""
    for _ in range(NEWTON_STEPS):
        distance, speed, acceleration = np.asarray(
            _relative_motion(np.append(z, time_in_flight), problem, np.int32(row), np.int32(wall_index))
        )
        time_in_flight -= speed / acceleration
    return time_in_flight, distance, acceleration


def find_grazing_contacts(problem, z, length_scale):
    """Find the grazing contacts at a point.

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
    list of GrazingContact
        Contacts at impacts with zero speed, then contacts at which a flight grazes a wall.
    """
    sides, diagnostics = problem.sequence.sides, diagnose(problem, z[None])
    n_rows = len(sides)
    nonempty_rows = np.flatnonzero(sides != 0)
    zero_speed_row_indices = [
        int(impact_row)
        for impact_row in problem.impact_rows
        if abs(z[n_rows + impact_row]) < GRAZING_TOLERANCE * length_scale
    ]
    grazing_contacts = [
        GrazingContact(impact_row, int(sides[impact_row]), 0.0, True) for impact_row in zero_speed_row_indices
    ]
    wall_sides = scene_wall_sides(problem.scene)
    flight_durations, contact_durations = flight_durations_at(problem, z), contact_durations_at(problem, z)
    for row, wall_index in zip(
        *np.nonzero(abs(diagnostics.clearance[0]) < GRAZING_TOLERANCE * length_scale), strict=True
    ):
        time_in_flight, side = float(diagnostics.turning_time[0, row, wall_index]), wall_sides[wall_index]
        next_row = (
            int(nonempty_rows[(np.flatnonzero(nonempty_rows == row)[0] + 1) % len(nonempty_rows)]) if n_rows else None
        )
        is_at_start = (
            row in zero_speed_row_indices
            and sides[row] == side
            and time_in_flight < END_TOLERANCE * flight_durations[row]
        )
        is_at_end = (
            next_row in zero_speed_row_indices
            and sides[next_row] == side
            and time_in_flight > (1.0 - END_TOLERANCE) * flight_durations[row]
        )
        if not (is_at_start or is_at_end):
            grazing_contacts.append(
                GrazingContact(int(row), side, float(contact_durations[row]) + time_in_flight, False)
            )
    return grazing_contacts


def set_slow_speeds_to_zero(problem, z, length_scale):
    """Set the speeds of z that vanish up to rounding to zero."""
    n_rows = len(problem.sequence.sides)
    z_with_zero_speeds = np.array(z)
    speeds = z_with_zero_speeds[n_rows : 2 * n_rows]
    speeds[abs(speeds) < GRAZING_TOLERANCE * length_scale] = 0.0
    return z_with_zero_speeds


def approach_acceleration(problem, z, row):
    """Return the relative acceleration towards the wall of an impact at the time when the mass leaves the wall.

    Parameters
    ----------
    problem : OrbitEquations
        Equations of the orbit.
    z : ndarray
        Unknowns.
    row : int
        Row of the impact.

    Returns
    -------
    float
        Acceleration, positive towards the wall.
    """
    wall_index = scene_wall_sides(problem.scene).index(int(problem.sequence.sides[row]))
    return float(_relative_motion(np.append(z, 0.0), problem, np.int32(row), np.int32(wall_index))[2])


def is_pressed_on_wall(problem, z, grazing_contacts):
    """Test whether the mass sticks at a grazing contact because it is pressed against the wall.

    Parameters
    ----------
    problem : OrbitEquations
        Equations of the orbit.
    z : ndarray
        Unknowns.
    grazing_contacts : sequence of GrazingContact
        Grazing contacts; only those that are impacts count.

    Returns
    -------
    bool
        True if the acceleration points into the wall at any of these contacts.
    """
    return any(
        approach_acceleration(problem, z, grazing_contact.row) > 0
        for grazing_contact in grazing_contacts
        if grazing_contact.is_impact
    )


def orbit_duration_at(problem, z):
    """Return the duration of the orbit."""
    return float(problem.sequence.periods) * 2.0 * np.pi / parameter_value_at(problem, z, "frequency")


def flight_durations_at(problem, z):
    """Return the duration of each flight, of shape (rows,); without impacts the orbit duration, of shape (1,)."""
    if not len(problem.sequence.sides):
        return np.array([orbit_duration_at(problem, z)])
    return np.asarray(_compute_durations(problem, z)[0])


def contact_durations_at(problem, z):
    """Return the contact durations of the impacts.

    Parameters
    ----------
    problem : OrbitEquations
        Equations of the orbit.
    z : ndarray
        Unknowns.

    Returns
    -------
    ndarray
        Duration inside the wall before the flight begins, array of shape (rows,), or (1,) without impacts.
    """
    n_rows = len(problem.sequence.sides)
    return (
        np.asarray(_compute_durations(problem, z)[1])
        if n_rows and problem.scene.soft_sides
        else np.zeros(max(1, n_rows))
    )


@persistent_jit(compiler_options=FAST_COMPILE, numpy_first=True)
def _compute_durations(problem, z):
    flights = impact_equations.compute_flights(flow_coefficients(scene_at(problem, z)), sequence_at(problem, z))
    return (
        flights.time,
        0.0 * flights.time if flights.contact_map.contact_time is None else flights.contact_map.contact_time,
    )


def scene_wall_sides(scene):
    """Return the sides of the walls that exist.

    Parameters
    ----------
    scene : Scene
        Scene.

    Returns
    -------
    list of int
        -1 if the left wall exists, then 1 if the right wall exists.
    """
    return [side for side, wall in ((-1, scene.left), (1, scene.right)) if wall is not None]


def are_admissible(problem, zs, diagnostics):
    """Test which points are admissible orbits.

    Parameters
    ----------
    problem : OrbitEquations
        Equations of the orbits.
    zs : ndarray
        Unknowns, array of shape (points, unknowns) or (unknowns,).
    diagnostics : Diagnostics
        Diagnostics of the points.

    Returns
    -------
    ndarray
        Boolean array of shape (points,): True if the orbit stays between the walls, all impacts have positive speeds,
        and all sticking phases of the itinerary exist.
    """
    zs = np.atleast_2d(zs)
    has_positive_speeds = (zs[:, len(problem.sequence.sides) + problem.impact_rows] > 0).all(axis=1)
    sticking_margin_rows = np.concatenate([*sticking_margins(problem, diagnostics), diagnostics.hop_margin], axis=1)
    has_positive_margins = (diagnostics.clearance >= -problem.slack).all(axis=(1, 2)) & (
        sticking_margin_rows > -problem.slack
    ).all(axis=1)
    return has_positive_speeds & has_positive_margins & np.isfinite(zs).all(axis=1)


@singledispatch
def sticking_margins(problem, diagnostics):
    """Return the margins of the sticking phases that must stay positive along a curve.

    Parameters
    ----------
    problem : OrbitEquations
        Equations of the orbits; other classes are registered.
    diagnostics : Diagnostics
        Diagnostics of the points.

    Returns
    -------
    sticking_time, min_contact_force : ndarray
        Durations and least contact forces of the sticking phases.
    """
    return diagnostics.sticking_time, diagnostics.min_contact_force
