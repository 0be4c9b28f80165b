"""Locate grazings in contact: a mass inside a soft wall returns to the surface of the wall with zero relative velocity.

If the mass leaves the wall for a moment, one contact becomes two. Let h be the height of the excursion and a the
acceleration into the wall. The exit speed and the entry speed are sqrt(2 a h) to first order. The force is continuous
at the walls of `soft_wall_grazing.is_smooth_soft_wall`. The motion outside the wall differs from the motion inside by
h^(3/2). Hence the orbits with one contact and the orbits with two contacts form one branch with a continuous tangent.

The grazing is a singular point of the equations with two contacts, because the exit time changes like sqrt(h). In the
equations with one contact, the end of the contact phase jumps to the grazing contact. The grazing is a regular point if
this contact is extended past the grazing (``ImpactSequence.min_contact_time``). The extended equations are therefore
used to locate the grazing and to continue from it.
"""

from functools import partial
from typing import NamedTuple

import jax.numpy as jnp
import numpy as np
from jaxtyping import Float

from continuation import augmented_systems
from continuation.hostcall import FAST_COMPILE, persistent_jit

from ..compiled.kernel_calls import call_as_kernel
from ..contact.kinds import flow_coefficients, kinds_of_scene
from ..flight import flow, motion_in_soft_wall
from ..scene.state import Contact
from . import grazing_contact
from .grazing_contact import LOOSE_TOLERANCE, GrazingContact, GrazingPoint, contact_durations_at, flight_durations_at
from .orbit_equations import scene_at, sequence_at
from .orbit_problem import OrbitProblem
from .soft_wall_grazing import OFFSET_SPEEDS, is_smooth_soft_wall

PROXIMITY = 1e-2  # relative to the scene's length or speed; a nearer or slower contact may split or merge
END_DEPTH = 1e-12  # relative to the scene's length; depth at which the orbits with one contact end
END_SPEEDS = 1e-6, 3e-6  # entry speeds at which the orbits with two contacts end; the first that converges is used
SAMPLE_INTERVAL, MAX_SAMPLES = 0.2, 512  # sample spacing in units of the oscillation inside; samples of a contact phase
MIN_HALF_SWINGS = 1.25  # half-oscillations; in a shorter contact phase the mass does not return twice
NEWTON_STEPS = 6  # Newton steps to a turning point


def is_pressed_into_wall(problem, z, row):
    """Test whether a mass at a wall with zero relative velocity accelerates into the wall.

    Parameters
    ----------
    problem : OrbitProblem
        Equations of the orbit.
    z : ndarray
        Unknowns.
    row : int
        Row of the contact.

    Returns
    -------
    bool
        True if the acceleration points into the wall; always False under a user-defined force.
    """
    return problem.scene.force is None and bool(_contact_motion_at(problem, z, row, 0.0)[2] > 0)


class TurningPointInsideWall(NamedTuple):
    """Turning point within a contact phase at which the mass is nearest to the surface of the wall.

    Attributes
    ----------
    row : int
        Row of the contact.
    time_in_contact : float
        Time since the contact began.
    depth : float
        Depth behind the wall.
    inward_acceleration : float
        Acceleration into the wall.
    """

    row: int
    time_in_contact: float
    depth: float
    inward_acceleration: float


class GrazingInsideWall(NamedTuple):
    """Grazing of the surface of a soft wall within a contact phase.

    Attributes
    ----------
    extended_problem : OrbitProblem
        Equations whose contact phase is extended past the grazing.
    z : ndarray
        Unknowns.
    row : int
        Row of the contact.
    time_in_contact : float
        Time of the grazing since the contact began.
    tangent : ndarray
        Tangent of the branch, in the direction of orbits that remain inside the wall.
    depth_rate : float
        Derivative of the depth at the grazing along the tangent.
    inward_acceleration : float
        Acceleration into the wall.
    residual : float
        Largest residual.
    """

    extended_problem: OrbitProblem
    z: Float[np.ndarray, " unknowns"]
    row: int
    time_in_contact: float
    tangent: Float[np.ndarray, " unknowns"]
    depth_rate: float
    inward_acceleration: float
    residual: float


def _contact_motion_kernel(z, times_in_contact, problem, row):
    """Return (depth, rate of the depth, acceleration into the wall) at times since the contact of a row began."""
    coeffs, sequence = flow_coefficients(scene_at(problem, z)), sequence_at(problem, z)
    zeros = 0.0 * times_in_contact
    side, wall_code = sequence.sides[row] + zeros, sequence.sides[row] * float(Contact.ENTERED) + zeros
    contact_coeffs = motion_in_soft_wall.coeffs_by_lane(coeffs, wall_code)
    start_drive_angle = sequence.phase + coeffs.frequency * sequence.times[row] + zeros
    start_cosine, start_sine = jnp.cos(start_drive_angle), jnp.sin(start_drive_angle)
    contact_response = motion_in_soft_wall.contact_response(contact_coeffs, wall_code, times_in_contact)
    relative_displacement, relative_velocity = motion_in_soft_wall.apply_response(
        contact_coeffs, wall_code, contact_response, (zeros, side * sequence.speeds[row]), start_cosine, start_sine
    )
    current_phasor = flow.rotate_phasor_by_angle(start_cosine, start_sine, coeffs.frequency * times_in_contact)
    relative_acceleration, _ = contact_coeffs.flow.acceleration_and_jerk(
        contact_coeffs,
        relative_displacement,
        relative_velocity,
        *current_phasor,
        motion_in_soft_wall.frame_force_derivs(contact_coeffs, wall_code, *current_phasor, 1),
    )
    return jnp.stack([side * relative_displacement, side * relative_velocity, side * relative_acceleration])


@persistent_jit(compiler_options=FAST_COMPILE, numpy_first=True)
def _contact_motion(z, times_in_contact, problem, row):
    return call_as_kernel(_contact_motion_kernel, z, times_in_contact, problem, row)


def _contact_motion_at(problem, z, row, time_in_contact):
    """Return (depth, rate of the depth, acceleration into the wall) at a single time since the contact began."""
    return np.asarray(_contact_motion(z, np.array([time_in_contact]), problem, np.int32(row)))[:, 0]


def turning_points_in_wall(problem, z):
    """Return the nearest `TurningPointInsideWall` of each contact with a linear soft wall whose force is continuous."""
    scene, turning_points = problem.scene, []
    if not kinds_of_scene(scene).contact.is_linear() or not len(problem.sequence.sides):
        return turning_points
    contact_durations = contact_durations_at(problem, z)
    for row in problem.impact_rows:
        side = int(problem.sequence.sides[row])
        if not is_smooth_soft_wall(scene, side) or not np.isfinite(contact_durations[row]):
            continue
        oscillation_rate, half_oscillation = _contact_oscillation(problem, z, side)
        if contact_durations[row] > MIN_HALF_SWINGS * half_oscillation:
            duration = float(contact_durations[row])
            turning_point = _nearest_turning_point(problem, z, int(row), duration, oscillation_rate)
            turning_points += [turning_point] if turning_point else []
    return turning_points


def _contact_oscillation(problem, z, side):
    """Return the undamped angular frequency inside a wall and half the damped period, 0 if overdamped."""
    scene, wall_name = scene_at(problem, z).replace(), "left" if side < 0 else "right"
    stiffness, damping = (
        float(np.asarray(scene.parameter(f"{wall_name}.{parameter_name}")))
        for parameter_name in ("stiffness", "damping")
    )
    oscillation_rate = np.sqrt(1.0 + stiffness)
    squared_frequency = oscillation_rate * oscillation_rate - damping**2
    return oscillation_rate, np.pi / np.sqrt(squared_frequency) if squared_frequency > 0 else 0.0


def _nearest_turning_point(problem, z, row, contact_duration, oscillation_rate):
    """Return the nearest `TurningPointInsideWall` of a contact phase; None if the phase has no turning point."""
    n_samples = min(
        MAX_SAMPLES, 1 << int(np.ceil(np.log2(contact_duration * oscillation_rate / SAMPLE_INTERVAL + 8.0)))
    )
    times_in_contact = contact_duration * np.arange(1, n_samples + 1) / (n_samples + 1.0)
    depth, depth_rate, _ = np.asarray(_contact_motion(z, times_in_contact, problem, np.int32(row)))
    turning_intervals = np.flatnonzero((depth_rate[:-1] < 0) & (depth_rate[1:] >= 0))
    if not len(turning_intervals):
        return None
    nearest_interval = turning_intervals[np.argmin(depth[turning_intervals])]
    interval_fraction = depth_rate[nearest_interval] / (depth_rate[nearest_interval] - depth_rate[nearest_interval + 1])
    turning_time = times_in_contact[nearest_interval] + interval_fraction * (times_in_contact[1] - times_in_contact[0])
    return _refine_turning_point(problem, z, row, turning_time)


def _refine_turning_point(problem, z, row, time_in_contact):
    """Return the `TurningPointInsideWall` near a time since the contact began; None if Newton's method fails."""
    for _ in range(NEWTON_STEPS):
        _, depth_rate, inward_acceleration = _contact_motion_at(problem, z, row, time_in_contact)
        time_in_contact -= depth_rate / inward_acceleration
    depth, _, inward_acceleration = _contact_motion_at(problem, z, row, time_in_contact)
    return (
        TurningPointInsideWall(row, float(time_in_contact), float(depth), float(inward_acceleration))
        if np.isfinite(time_in_contact) and inward_acceleration > 0
        else None
    )


def extend_contact(problem, row, time_in_contact, extra_duration):
    """Return equations in which the contact phase of a row is extended past a grazing, by `extra_duration` in t."""
    min_contact_times = np.zeros(len(problem.sequence.sides))
    min_contact_times[row] = time_in_contact + extra_duration
    return problem._replace(sequence=problem.sequence._replace(min_contact_time=min_contact_times))


def locate_grazing_inside(problem, z, row, time_in_contact):
    """Locate the `GrazingInsideWall` near z and near a time of a contact phase; None if Newton's method fails."""
    oscillation_rate, _ = _contact_oscillation(problem, z, int(problem.sequence.sides[row]))
    extended_problem = extend_contact(problem, row, time_in_contact, 1.0 / oscillation_rate)
    depth_and_depth_rate = partial(_depth_and_depth_rate, problem, row)
    solution = extended_problem.locate_zero(np.append(z, time_in_contact), depth_and_depth_rate, n_extra=1)
    if solution.z is None or not np.isfinite(solution.z).all():
        return None
    z, time_in_contact = solution.z[:-1], float(solution.z[-1])
    inward_acceleration = float(_contact_motion_at(problem, z, row, time_in_contact)[2])
    tangent = extended_problem.tangent(z)
    depth_growth_rate = _depth_growth_rate(problem, z, tangent, row, time_in_contact)
    if not (time_in_contact > 0 and inward_acceleration > 0 and abs(depth_growth_rate) > 0):
        return None
    depth_rate_sign = np.sign(depth_growth_rate)
    return GrazingInsideWall(
        extended_problem,
        z,
        row,
        time_in_contact,
        depth_rate_sign * tangent,
        abs(depth_growth_rate),
        inward_acceleration,
        float(solution.residual),
    )


def _depth_and_depth_rate(problem, row, z_and_time):
    return _contact_motion_at(problem, z_and_time[:-1], row, z_and_time[-1])[:2]


def _depth_growth_rate(problem, z, z_direction, row, time_in_contact):
    """Return the derivative of the depth at a time of a contact phase in a direction of z."""

    def depth_at(z):
        return _contact_motion_at(problem, z, row, time_in_contact)[0]

    return augmented_systems.directional_derivative(depth_at, z, z_direction)


def find_upcoming_grazing(problem, points, step_control):
    """Find a grazing within a contact phase ahead of a branch.

    Parameters
    ----------
    problem : OrbitProblem
        Equations of the orbits.
    points : continuation.arclength.Point
        Points of the branch, up to a point from which a step has failed or has not been tried.
    step_control : continuation.arclength.StepControl
        Weights of the arclength.

    Returns
    -------
    tuple or None
        (index of the last point before the grazing, (unknowns at the end of the branch, arclength from that point,
        largest residual, `GrazingPoint`)); None if no grazing is near.
    """
    if not kinds_of_scene(problem.scene).contact.is_linear() or not len(problem.sequence.sides):
        return None
    for k in range(1, len(points.z)):
        upcoming_grazing = _find_contact_merger(problem, points.z[k], points.tangent[k], step_control)
        if upcoming_grazing is not None:
            return k, upcoming_grazing
    last_index = len(points.z) - 1
    upcoming_grazing = _find_contact_split(problem, points.z[last_index], points.tangent[last_index], step_control)
    return upcoming_grazing and (last_index, upcoming_grazing)


def _find_contact_split(problem, z, tangent, step_control):
    """Return (z, arclength, residual, `GrazingPoint`) where one contact becomes two; None if none is near."""
    for turning_point in turning_points_in_wall(problem, z):
        if not 0 < turning_point.depth < PROXIMITY * problem.length_scale:
            continue
        depth_rate = _depth_growth_rate(problem, z, tangent, turning_point.row, turning_point.time_in_contact)
        inside_grazing = (
            locate_grazing_inside(problem, z, turning_point.row, turning_point.time_in_contact)
            if depth_rate < 0
            else None
        )
        if inside_grazing is None:
            continue
        arclength = float(np.sum(step_control.scale**2 * tangent * (inside_grazing.z - z)))
        if abs(arclength + turning_point.depth / depth_rate) < -0.5 * turning_point.depth / depth_rate:
            branch_end_z = (
                inside_grazing.z + END_DEPTH * problem.length_scale / inside_grazing.depth_rate * inside_grazing.tangent
            )
            side = int(problem.sequence.sides[inside_grazing.row])
            contact = GrazingContact(inside_grazing.row, side, inside_grazing.time_in_contact, False)
            grazing_exit = _two_contact_exit(problem, inside_grazing)
            grazing_point = GrazingPoint((contact,), (grazing_exit,) if grazing_exit else (), grazing_exit is not None)
            return branch_end_z, arclength, inside_grazing.residual, grazing_point
    return None


def _two_contact_exit(problem, inside_grazing):
    """Return the `BranchFromGrazing` along orbits with two contacts; None if Newton's method fails."""
    merged_z, row, n_rows = inside_grazing.z, inside_grazing.row, len(problem.sequence.sides)
    side, grazing_time = int(problem.sequence.sides[row]), merged_z[row] + inside_grazing.time_in_contact
    impacts = [(merged_z[k], merged_z[n_rows + k], int(problem.sequence.sides[k])) for k in problem.impact_rows]
    impacts.insert(row + 1, (grazing_time, 0.0, side))
    problem = problem._replace(sequence=problem.sequence._replace(min_contact_time=None))
    split_problem, split_z = problem.with_impacts(merged_z, impacts)
    n_split_rows, split_z_rate = len(split_problem.sequence.sides), np.zeros(len(split_z))
    split_rows = [k + (k > row) for k in problem.impact_rows]
    split_z_rate[split_rows], split_z_rate[np.add(n_split_rows, split_rows)] = (
        -inside_grazing.tangent[problem.impact_rows],
        -inside_grazing.tangent[n_rows + problem.impact_rows],
    )
    split_z_rate[row + 1], split_z_rate[-1] = -inside_grazing.tangent[row], -inside_grazing.tangent[-1]
    for relative_speed in (10.0 * OFFSET_SPEEDS[0], *OFFSET_SPEEDS):
        entry_speed = relative_speed * problem.length_scale
        z_guess = (
            split_z
            + entry_speed**2 / (2.0 * inside_grazing.inward_acceleration * inside_grazing.depth_rate) * split_z_rate
        )
        z_guess[row + 1] += entry_speed / inside_grazing.inward_acceleration
        z_guess[n_split_rows + row + 1] = entry_speed
        tangent = np.zeros(len(split_z))
        tangent[row + 1], tangent[n_split_rows + row + 1] = 1.0 / inside_grazing.inward_acceleration, 1.0
        tangent /= np.linalg.norm(split_problem.weights() * tangent)
        grazing_exit, _ = grazing_contact.step_along_exit(
            split_problem, z_guess, tangent, (True,), LOOSE_TOLERANCE, (0.0,)
        )
        if grazing_exit:
            tangent = split_problem.tangent(grazing_exit.z_near_grazing, tangent)
            return grazing_exit._replace(
                point=grazing_exit.point._replace(z=grazing_exit.z_near_grazing, tangent=tangent)
            )
    return None


def _find_contact_merger(problem, z, tangent, step_control):
    """Return (z, arclength, residual, `GrazingPoint`) where two contacts become one; None if none is near."""
    n_rows, sides = len(problem.sequence.sides), problem.sequence.sides
    impact_row_indices = [int(k) for k in problem.impact_rows]
    for impact_index, row in enumerate(impact_row_indices):
        previous_row = impact_row_indices[impact_index - 1]
        is_losing_speed = 0 < z[n_rows + row] < PROXIMITY * problem.length_scale and tangent[n_rows + row] < 0
        if (
            not is_losing_speed
            or previous_row == row
            or sides[previous_row] != sides[row]
            or not is_smooth_soft_wall(problem.scene, sides[row])
        ):
            continue
        flight_durations, contact_durations = flight_durations_at(problem, z), contact_durations_at(problem, z)
        _, _, inward_acceleration = _contact_motion_at(problem, z, row, 0.0)
        if not inward_acceleration > 0 or flight_durations[previous_row] > 4.0 * z[n_rows + row] / inward_acceleration:
            continue
        merged_result = _locate_merged_grazing(problem, z, row, previous_row, contact_durations, flight_durations)
        if merged_result is None:
            continue
        merged_problem, solution, old_and_new_rows = merged_result
        two_contact_z = np.array(z)
        for k, merged_row in old_and_new_rows:
            two_contact_z[k], two_contact_z[n_rows + k] = (
                solution.z[merged_row],
                solution.z[len(merged_problem.sequence.sides) + merged_row],
            )
        orbit_duration = problem.duration(z)
        two_contact_z[row] = solution.z[solution.row] + solution.time_in_contact
        two_contact_z[row] -= orbit_duration * np.round((two_contact_z[row] - z[row]) / orbit_duration)
        two_contact_z[n_rows + row], two_contact_z[-1] = 0.0, solution.z[-1]
        arclength = float(np.sum(step_control.scale**2 * tangent * (two_contact_z - z)))
        expected_arclength = -z[n_rows + row] / tangent[n_rows + row]
        if not abs(arclength - expected_arclength) < 0.5 * expected_arclength:
            continue
        end_point_candidates = (
            problem.solve_at(two_contact_z, n_rows + row, relative_speed * problem.length_scale)
            for relative_speed in END_SPEEDS
        )
        end_point = next((solution for solution in end_point_candidates if solution.converged), None)
        if end_point is None:
            continue
        exit_problem = merged_problem._replace(sequence=merged_problem.sequence._replace(min_contact_time=None))
        grazing_exit, is_certain = grazing_contact.check_exit_along_tangent(
            exit_problem, solution.z, solution.tangent, np.array([solution.depth_rate]), (False,)
        )
        grazing_exit = grazing_exit and grazing_exit._replace(
            point=grazing_exit.point._replace(z=grazing_exit.z_near_grazing)
        )
        contact = GrazingContact(row, int(sides[row]), 0.0, True)
        grazing_point = GrazingPoint((contact,), (grazing_exit,) if grazing_exit else (), is_certain)
        return end_point.z, arclength, solution.residual, grazing_point
    return None


def _locate_merged_grazing(problem, z, row, previous_row, contact_durations, flight_durations):
    """Return (equations without the contact of a row, `GrazingInsideWall`, pairs of old and new rows), or None."""
    other_rows = [int(k) for k in problem.impact_rows if k != row]
    merged_problem, merged_z = problem.with_rows(z, other_rows)
    time_in_contact = contact_durations[previous_row] + 0.5 * flight_durations[previous_row]
    inside_grazing = locate_grazing_inside(
        merged_problem, merged_z, other_rows.index(previous_row), float(time_in_contact)
    )
    return inside_grazing and (
        merged_problem,
        inside_grazing,
        list(zip(other_rows, range(len(other_rows)), strict=True)),
    )
