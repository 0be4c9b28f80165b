"""Locate grazing contacts: impacts with zero speed and flights that reach a wall at zero relative velocity."""

from functools import partial
from typing import NamedTuple

import jax.numpy as jnp
import numpy as np

from continuation.hostcall import FAST_COMPILE, persistent_jit

from ..compiled.kernel_calls import call_as_kernel
from ..contact.kinds import flow_coefficients
from ..orbits import flight_clearance, impact_equations
from ..orbits.flight_clearance import GRAZING_TOLERANCE
from .orbit_diagnostics import diagnose, flight_without_impacts
from .orbit_equations import scene_at, sequence_at

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


@persistent_jit(compiler_options=FAST_COMPILE, numpy_first=True)
def _relative_motion(z_and_time, problem, row, wall_index):
    return call_as_kernel(_relative_motion_kernel, z_and_time, problem, row, wall_index)


def wall_distance_and_speed(problem, row, wall_index, z_and_time):
    """Return (distance, speed) towards a wall at (z, time since the start of the flight)."""
    return np.asarray(_relative_motion(z_and_time, problem, np.int32(row), np.int32(wall_index)))[:2]


def locate_grazing(problem, z, row, wall_index, time_in_flight):
    """Locate the point near z at which the flight after a row reaches a wall with zero relative velocity."""
    contact_residual_of = partial(wall_distance_and_speed, problem, row, wall_index)
    solution = problem.locate_zero(np.append(z, time_in_flight), contact_residual_of, n_extra=1)
    return solution if solution.z is None else solution._replace(z=solution.z[:-1])


def refine_turning_point(problem, z, row, wall_index, time_in_flight):
    """Return (time, distance, acceleration towards the wall) at the turning point nearest to a time of a flight."""
    for _ in range(NEWTON_STEPS):
        distance, speed, acceleration = np.asarray(
            _relative_motion(np.append(z, time_in_flight), problem, np.int32(row), np.int32(wall_index))
        )
        time_in_flight -= speed / acceleration
    return time_in_flight, distance, acceleration


def find_grazing_contacts(problem, z):
    """Find the grazing contacts at a point.

    Parameters
    ----------
    problem : OrbitProblem
        Equations of the orbit.
    z : ndarray
        Unknowns.

    Returns
    -------
    list of GrazingContact
        Contacts at impacts with zero speed, then contacts at which a flight grazes a wall.
    """
    sides, diagnostics = problem.sequence.sides, diagnose(problem, z[None])
    tolerance = GRAZING_TOLERANCE * problem.length_scale
    n_rows = len(sides)
    nonempty_rows = np.flatnonzero(sides != 0)
    zero_speed_row_indices = [
        int(impact_row) for impact_row in problem.impact_rows if abs(z[n_rows + impact_row]) < tolerance
    ]
    grazing_contacts = [
        GrazingContact(impact_row, int(sides[impact_row]), 0.0, True) for impact_row in zero_speed_row_indices
    ]
    wall_sides = scene_wall_sides(problem.scene)
    flight_durations, contact_durations = flight_durations_at(problem, z), contact_durations_at(problem, z)
    for row, wall_index in zip(*np.nonzero(abs(diagnostics.clearance[0]) < tolerance), strict=True):
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


def set_slow_speeds_to_zero(problem, z):
    """Set the speeds of z that vanish up to rounding to zero."""
    n_rows = len(problem.sequence.sides)
    z_with_zero_speeds = np.array(z)
    speeds = z_with_zero_speeds[n_rows : 2 * n_rows]
    speeds[abs(speeds) < GRAZING_TOLERANCE * problem.length_scale] = 0.0
    return z_with_zero_speeds


def approach_acceleration(problem, z, row):
    """Return the relative acceleration towards the wall of an impact at the time when the mass leaves the wall.

    Parameters
    ----------
    problem : OrbitProblem
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
    problem : OrbitProblem
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


def flight_durations_at(problem, z):
    """Return the duration of each flight, of shape (rows,); without impacts the orbit duration, of shape (1,)."""
    if not len(problem.sequence.sides):
        return np.array([problem.duration(z)])
    return np.asarray(_compute_durations(problem, z)[0])


def contact_durations_at(problem, z):
    """Return the contact durations of the impacts.

    Parameters
    ----------
    problem : OrbitProblem
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
    problem : OrbitProblem
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
    sticking_margin_rows = np.concatenate(
        [*problem.condition.sticking_margins(diagnostics), diagnostics.hop_margin], axis=1
    )
    has_positive_margins = (diagnostics.clearance >= -problem.slack).all(axis=(1, 2)) & (
        sticking_margin_rows > -problem.slack
    ).all(axis=1)
    return has_positive_speeds & has_positive_margins & np.isfinite(zs).all(axis=1)
