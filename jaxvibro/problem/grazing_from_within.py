"""Locate grazings from within: a mass inside a soft wall returns to its surface and just leaves, or just does not.

Where it leaves for a moment and enters again, one contact becomes two. Let h be the height of the excursion and a the
acceleration into the wall. The speeds of leaving and entering are sqrt(2 a h) to first order, and the force has no jump
where `soft_grazing.is_smooth_wall`. The motion outside differs from that inside by h^(3/2), so the orbits with one
contact and those with two form one branch with a continuous tangent. The grazing is a singular point of the equations
with two contacts, as the time of leaving changes like sqrt(h). The equations with one contact lose the end of the
contact phase, which jumps to the grazing contact. It is a regular point of the equations with one contact that is
extended past the grazing (``ImpactSequence.min_contact_time``). There it is located and left.
"""

from functools import partial
from typing import NamedTuple

import jax.numpy as jnp
import numpy as np
from jaxtyping import Float

from continuation import augmented_systems, event_search
from continuation.persistent_jit import FAST_COMPILE, persistent_jit

from ..compiled.kernels import call_as_kernel
from ..flight import flow, soft_contact
from ..flight.coefficients import flow_coefficients
from ..flight.flows import flow_of
from ..scene.codes import Contact
from . import grazing
from .equations import OrbitEquations, continuation_problem, scene_at, sequence_at
from .grazing import LOOSE_TOLERANCE, ImpactEntry, with_impacts
from .grazing_contact import (
    GrazingContact,
    arclength_weights,
    contact_durations_at,
    flight_durations_at,
    orbit_duration_at,
)
from .soft_grazing import OFFSET_SPEEDS, is_smooth_wall

PROXIMITY = (
    1e-2  # relative to the scene's length; a contact closer to its wall, or entered more slowly, may split or merge
)
END_DEPTH = 1e-12  # relative to the scene's length; depth at which the orbits with one contact end
END_SPEEDS = (
    1e-6,
    3e-6,
)  # scene's lengths per t; entry speed at which the orbits with two contacts end, the first that converges
SAMPLE_INTERVAL, MAX_SAMPLES = 0.2, 512  # sample spacing in units of the oscillation inside; samples of a contact phase
MIN_HALF_SWINGS = 1.25  # half-oscillations; in a shorter contact phase the mass does not return twice
NEWTON_STEPS = 6  # Newton steps to a turning point


def is_pressed_into_wall(problem, z, row):
    """Test whether a mass at its wall with zero speed is pressed into it, so that it came from within.

    Parameters
    ----------
    problem : OrbitEquations
        Equations of the orbit.
    z : ndarray
        Unknowns.
    row : int
        Row of the contact.

    Returns
    -------
    bool
        False under a user-defined force.
    """
    return problem.scene.force is None and bool(_contact_motion_at(problem, z, row, 0.0)[2] > 0)


class InnerTurningPoint(NamedTuple):
    """Return of the mass to its wall within a contact phase.

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


class InnerGrazing(NamedTuple):
    """Grazing from within.

    Attributes
    ----------
    extended_problem : OrbitEquations
        Equations with one contact, extended past the grazing.
    z : ndarray
        Unknowns.
    row : int
        Row of the contact.
    time_in_contact : float
        Time of the grazing since the contact began.
    tangent : ndarray
        Tangent of the branch, towards orbits that stay inside.
    depth_rate : float
        Derivative of the depth at the grazing along the tangent.
    inward_acceleration : float
        Acceleration into the wall.
    residual : float
        Largest residual.
    """

    extended_problem: OrbitEquations
    z: Float[np.ndarray, " unknowns"]
    row: int
    time_in_contact: float
    tangent: Float[np.ndarray, " unknowns"]
    depth_rate: float
    inward_acceleration: float
    residual: float


def _motion_in_contact(z, times, problem, row):
    """Return depth, its rate and the acceleration into the wall at times since the contact of a row began."""
    coeffs, sequence = flow_coefficients(scene_at(problem, z)), sequence_at(problem, z)
    zeros = 0.0 * times
    side, contact = sequence.sides[row] + zeros, sequence.sides[row] * float(Contact.ENTERED) + zeros
    contact_coeffs = soft_contact.coeffs_by_lane(coeffs, contact)
    drive_angle = sequence.phase + coeffs.frequency * sequence.times[row] + zeros
    cosine, sine = jnp.cos(drive_angle), jnp.sin(drive_angle)
    contact_response = soft_contact.contact_response(contact_coeffs, contact, times)
    displacement, v = soft_contact.apply_response(
        contact_coeffs, contact, contact_response, (zeros, side * sequence.speeds[row]), cosine, sine
    )
    drive_phasor = flow.rotate_by_angle(cosine, sine, coeffs.frequency * times)
    acceleration, _ = flow_of(contact_coeffs).acceleration_and_jerk(
        contact_coeffs,
        displacement,
        v,
        *drive_phasor,
        soft_contact.extra_force_derivs(contact_coeffs, contact, *drive_phasor, 1),
    )
    return jnp.stack([side * displacement, side * v, side * acceleration])


@persistent_jit(compiler_options=FAST_COMPILE, numpy_first=_motion_in_contact)
def _contact_motion(z, times, problem, row):
    return call_as_kernel(_motion_in_contact, z, times, problem, row)


def _contact_motion_at(problem, z, row, time_in_contact):
    """Return depth, its rate and the acceleration into the wall at one time."""
    return np.asarray(_contact_motion(z, np.array([time_in_contact]), problem, np.int32(row)))[:, 0]


def inner_turning_points(problem, z):
    """Return the `InnerTurningPoint` nearest to the wall of each contact with a linear wall whose force has no jump."""
    scene, turning_points = problem.scene, []
    if not scene.soft_sides or scene.force is not None or not len(problem.sequence.sides):
        return turning_points
    contact_durations = contact_durations_at(problem, z)
    for row in problem.impact_rows:
        side = int(problem.sequence.sides[row])
        if not is_smooth_wall(scene, side) or not np.isfinite(contact_durations[row]):
            continue
        oscillation_rate, half_swing = _contact_oscillation(problem, z, side)
        if contact_durations[row] > MIN_HALF_SWINGS * half_swing:
            turning_point = _nearest_turning_point(
                problem, z, int(row), float(contact_durations[row]), oscillation_rate
            )
            turning_points += [turning_point] if turning_point else []
    return turning_points


def _contact_oscillation(problem, z, side):
    """Return the oscillation rate inside a wall and the duration of half an oscillation, 0 if overdamped."""
    wall_name = "left" if side < 0 else "right"
    wall_params = {term: _wall_parameter(problem, z, wall_name, term) for term in ("stiffness", "damping")}
    oscillation_rate = np.sqrt(1.0 + wall_params["stiffness"])
    squared_frequency = oscillation_rate * oscillation_rate - wall_params["damping"] ** 2
    return oscillation_rate, np.pi / np.sqrt(squared_frequency) if squared_frequency > 0 else 0.0


def _wall_parameter(problem, z, wall_name, term):
    """Return a parameter of a wall at z, including its hardness."""
    return float(np.asarray(scene_at(problem, z).replace().parameter(f"{wall_name}.{term}")))


def _nearest_turning_point(problem, z, row, contact_duration, oscillation_rate):
    """Return the `InnerTurningPoint` of a contact phase, None if the mass does not return before the end."""
    n_samples = min(
        MAX_SAMPLES, 1 << int(np.ceil(np.log2(contact_duration * oscillation_rate / SAMPLE_INTERVAL + 8.0)))
    )
    times = contact_duration * np.arange(1, n_samples + 1) / (n_samples + 1.0)
    depth, depth_rate, _ = np.asarray(_contact_motion(z, times, problem, np.int32(row)))
    turning_cells = np.flatnonzero((depth_rate[:-1] < 0) & (depth_rate[1:] >= 0))
    if not len(turning_cells):
        return None
    nearest_cell = turning_cells[np.argmin(depth[turning_cells])]
    fraction = depth_rate[nearest_cell] / (depth_rate[nearest_cell] - depth_rate[nearest_cell + 1])
    return _refine_turning_point(problem, z, row, times[nearest_cell] + fraction * (times[1] - times[0]))


def _refine_turning_point(problem, z, row, time_in_contact):
    """Return the `InnerTurningPoint` near a time."""
    for _ in range(NEWTON_STEPS):
        _, depth_rate, inward_acceleration = _contact_motion_at(problem, z, row, time_in_contact)
        time_in_contact -= depth_rate / inward_acceleration
    depth, _, inward_acceleration = _contact_motion_at(problem, z, row, time_in_contact)
    return (
        InnerTurningPoint(row, float(time_in_contact), float(depth), float(inward_acceleration))
        if np.isfinite(time_in_contact) and inward_acceleration > 0
        else None
    )


def extend_contact(problem, row, time_in_contact, extension):
    """Extend the contact phase of a row past a grazing."""
    min_contact_times = np.zeros(len(problem.sequence.sides))
    min_contact_times[row] = time_in_contact + extension
    return problem._replace(sequence=problem.sequence._replace(min_contact_time=min_contact_times))


def locate_inner_grazing(problem, z, row, time_in_contact, length_scale):
    """Locate the `InnerGrazing` near z at which a contact phase grazes its wall near a time, None if not found."""
    rate, _ = _contact_oscillation(problem, z, int(problem.sequence.sides[row]))
    extended_problem = extend_contact(problem, row, time_in_contact, 1.0 / rate)
    depth_and_rate = partial(_depth_and_rate, problem, row)

    def system(unknowns):
        residual, jacobian = (
            np.asarray(array)
            for array in augmented_systems.evaluate(
                continuation_problem(extended_problem), unknowns[:-1], extended_problem
            )
        )
        extended_jacobian = np.vstack(
            [np.pad(jacobian, ((0, 0), (0, 1))), augmented_systems.central_differences(depth_and_rate, unknowns)]
        )
        return np.concatenate([residual, depth_and_rate(unknowns)]), extended_jacobian

    solution = augmented_systems.solve_newton(system, np.append(z, time_in_contact))
    if solution.z is None or not np.isfinite(solution.z).all():
        return None
    z, time_in_contact = solution.z[:-1], float(solution.z[-1])
    inward_acceleration = float(_contact_motion_at(problem, z, row, time_in_contact)[2])
    tangent = event_search.unit_tangent(
        continuation_problem(extended_problem), z, arclength_weights(problem, length_scale), extended_problem
    )
    rate = _depth_growth_rate(problem, z, tangent, row, time_in_contact)
    if not (time_in_contact > 0 and inward_acceleration > 0 and abs(rate) > 0):
        return None
    sign = np.sign(rate)
    return InnerGrazing(
        extended_problem,
        z,
        row,
        time_in_contact,
        sign * tangent,
        abs(rate),
        inward_acceleration,
        float(solution.residual),
    )


def _depth_and_rate(problem, row, unknowns):
    return _contact_motion_at(problem, unknowns[:-1], row, unknowns[-1])[:2]


def _depth_growth_rate(problem, z, direction, row, time_in_contact):
    """Return the derivative of the depth at a time of a contact phase in a direction of z."""
    offset_depths = (
        _contact_motion_at(problem, z + sign * augmented_systems.DIFFERENCE_STEP * direction, row, time_in_contact)[0]
        for sign in (1, -1)
    )
    return float(np.subtract(*offset_depths) / (2.0 * augmented_systems.DIFFERENCE_STEP))


class UpcomingGrazing(NamedTuple):
    """Grazing from within that a branch is about to reach.

    Attributes
    ----------
    z : ndarray
        Unknowns at the end of the branch.
    step : float
        Arclength from the last point.
    residual : float
        Largest residual.
    grazing_contacts : list of GrazingContact
        Grazing contacts, as in `grazing.find_exits`.
    exits : list of GrazingExit
        Exits.
    complete : bool
        Whether all exits are known.
    """

    z: Float[np.ndarray, " unknowns"]
    step: float
    residual: float
    grazing_contacts: list[GrazingContact]
    exits: list[grazing.GrazingExit]
    complete: bool


def find_upcoming_grazing(problem, points, control, length_scale):
    """Find a grazing from within ahead of a branch.

    Parameters
    ----------
    problem : OrbitEquations
        Equations of the orbits.
    points : continuation.arclength.Point
        Points of the branch. From the last one no step has been tried, or a step failed.
    control : continuation.arclength.StepControl
        Weights of the arclength.
    length_scale : float
        Length of the scene.

    Returns
    -------
    tuple or None
        Index of the last point before the grazing, and its `UpcomingGrazing`; None if none is near.
    """
    if problem.scene.force is not None or not problem.scene.soft_sides or not len(problem.sequence.sides):
        return None
    for k in range(1, len(points.z)):
        upcoming = _find_merger(problem, points.z[k], points.tangent[k], control, length_scale)
        if upcoming is not None:
            return k, upcoming
    last_index = len(points.z) - 1
    upcoming = _find_split(problem, points.z[last_index], points.tangent[last_index], control, length_scale)
    return upcoming and (last_index, upcoming)


def _find_split(problem, z, tangent, control, length_scale):
    """Find the grazing at which one contact becomes two."""
    for turning_point in inner_turning_points(problem, z):
        if not 0 < turning_point.depth < PROXIMITY * length_scale:
            continue
        depth_rate = _depth_growth_rate(problem, z, tangent, turning_point.row, turning_point.time_in_contact)
        inner_grazing = (
            locate_inner_grazing(problem, z, turning_point.row, turning_point.time_in_contact, length_scale)
            if depth_rate < 0
            else None
        )
        if inner_grazing is None:
            continue
        arclength = float(np.sum(control.scale**2 * tangent * (inner_grazing.z - z)))
        if abs(arclength + turning_point.depth / depth_rate) < -0.5 * turning_point.depth / depth_rate:
            end_z = inner_grazing.z + END_DEPTH * length_scale / inner_grazing.depth_rate * inner_grazing.tangent
            grazing_contacts = [
                GrazingContact(
                    inner_grazing.row,
                    int(problem.sequence.sides[inner_grazing.row]),
                    inner_grazing.time_in_contact,
                    False,
                )
            ]
            grazing_exit = _two_contact_exit(problem, inner_grazing, length_scale)
            return UpcomingGrazing(
                end_z,
                arclength,
                inner_grazing.residual,
                grazing_contacts,
                [grazing_exit] if grazing_exit else [],
                grazing_exit is not None,
            )
    return None


def _two_contact_exit(problem, inner_grazing, length_scale):
    """Return the `GrazingExit` along orbits with two contacts, None if Newton's method fails."""
    z, row, n_rows = inner_grazing.z, inner_grazing.row, len(problem.sequence.sides)
    side, grazing_time = (
        int(problem.sequence.sides[row]),
        inner_grazing.z[inner_grazing.row] + inner_grazing.time_in_contact,
    )
    impacts = [ImpactEntry(z[k], z[n_rows + k], int(problem.sequence.sides[k]), True) for k in problem.impact_rows]
    impacts.insert(row + 1, ImpactEntry(grazing_time, 0.0, side, True))
    split_problem, start_z = with_impacts(
        problem._replace(sequence=problem.sequence._replace(min_contact_time=None)), z, impacts
    )
    n_split_rows, z_change = len(split_problem.sequence.sides), np.zeros(len(start_z))
    new_rows = [k + (k > row) for k in problem.impact_rows]
    z_change[new_rows], z_change[np.add(n_split_rows, new_rows)] = (
        -inner_grazing.tangent[problem.impact_rows],
        -inner_grazing.tangent[n_rows + problem.impact_rows],
    )
    z_change[row + 1], z_change[-1] = -inner_grazing.tangent[row], -inner_grazing.tangent[-1]
    for relative_speed in (10.0 * OFFSET_SPEEDS[0], *OFFSET_SPEEDS):
        speed = relative_speed * length_scale
        guess = start_z + speed**2 / (2.0 * inner_grazing.inward_acceleration * inner_grazing.depth_rate) * z_change
        guess[row + 1] += speed / inner_grazing.inward_acceleration
        guess[n_split_rows + row + 1] = speed
        tangent = np.zeros(len(start_z))
        tangent[row + 1], tangent[n_split_rows + row + 1] = 1.0 / inner_grazing.inward_acceleration, 1.0
        tangent /= np.linalg.norm(arclength_weights(split_problem, length_scale) * tangent)
        grazing_exit, _ = grazing.step_along_exit(
            split_problem, guess, tangent, length_scale, (True,), LOOSE_TOLERANCE, (0.0,)
        )
        if grazing_exit:
            tangent = event_search.unit_tangent(
                continuation_problem(split_problem),
                grazing_exit.nearby_z,
                arclength_weights(split_problem, length_scale),
                split_problem,
                tangent,
            )
            return grazing_exit._replace(point=grazing_exit.point._replace(z=grazing_exit.nearby_z, tangent=tangent))
    return None


def _find_merger(problem, z, tangent, control, length_scale):
    """Find the grazing at which two contacts become one: the first ends as the second begins."""
    n_rows, sides = len(problem.sequence.sides), problem.sequence.sides
    impact_rows = [int(k) for k in problem.impact_rows]
    for index, row in enumerate(impact_rows):
        previous_row = impact_rows[index - 1]
        is_losing_speed = 0 < z[n_rows + row] < PROXIMITY * length_scale and tangent[n_rows + row] < 0
        if (
            not is_losing_speed
            or previous_row == row
            or sides[previous_row] != sides[row]
            or not is_smooth_wall(problem.scene, sides[row])
        ):
            continue
        flight_durations, contact_durations = flight_durations_at(problem, z), contact_durations_at(problem, z)
        _, _, inward_acceleration = _contact_motion_at(problem, z, row, 0.0)
        if not inward_acceleration > 0 or flight_durations[previous_row] > 4.0 * z[n_rows + row] / inward_acceleration:
            continue
        merger = _merged_grazing(problem, z, row, previous_row, contact_durations, flight_durations, length_scale)
        if merger is None:
            continue
        merged_problem, solution, row_pairs = merger
        grazing_z = np.array(z)
        for k, merged_row in row_pairs:
            grazing_z[k], grazing_z[n_rows + k] = (
                solution.z[merged_row],
                solution.z[len(merged_problem.sequence.sides) + merged_row],
            )
        orbit_duration = orbit_duration_at(problem, z)
        grazing_z[row] = solution.z[solution.row] + solution.time_in_contact
        grazing_z[row] -= orbit_duration * np.round((grazing_z[row] - z[row]) / orbit_duration)
        grazing_z[n_rows + row], grazing_z[-1] = 0.0, solution.z[-1]
        arclength = float(np.sum(control.scale**2 * tangent * (grazing_z - z)))
        expected_length = -z[n_rows + row] / tangent[n_rows + row]
        if not abs(arclength - expected_length) < 0.5 * expected_length:
            continue
        pinned_points = (
            event_search.solve_with_fixed_entry(
                continuation_problem(problem), grazing_z, n_rows + row, relative_speed * length_scale, control, problem
            )
            for relative_speed in END_SPEEDS
        )
        end_point = next((solution for solution in pinned_points if solution.converged), None)
        if end_point is None:
            continue
        exit_problem = merged_problem._replace(sequence=merged_problem.sequence._replace(min_contact_time=None))
        grazing_exit, complete = grazing.find_exit(
            exit_problem, solution.z, solution.tangent, np.array([solution.depth_rate]), length_scale, (False,)
        )
        grazing_exit = grazing_exit and grazing_exit._replace(
            point=grazing_exit.point._replace(z=grazing_exit.nearby_z)
        )
        grazing_contacts = [GrazingContact(row, int(sides[row]), 0.0, True)]
        return UpcomingGrazing(
            end_point.z,
            arclength,
            solution.residual,
            grazing_contacts,
            [grazing_exit] if grazing_exit else [],
            complete,
        )
    return None


def _merged_grazing(problem, z, row, previous_row, contact_durations, flight_durations, length_scale):
    """Return equations without the contact of a row, the `InnerGrazing`, and pairs of old and new rows."""
    n_rows, sides = len(problem.sequence.sides), problem.sequence.sides
    kept_rows = [int(k) for k in problem.impact_rows if k != row]
    merged_problem, start_z = with_impacts(
        problem, z, [ImpactEntry(z[k], z[n_rows + k], int(sides[k]), True) for k in kept_rows], kept_rows
    )
    time_in_contact = contact_durations[previous_row] + 0.5 * flight_durations[previous_row]
    inner_grazing = locate_inner_grazing(
        merged_problem, start_z, kept_rows.index(previous_row), float(time_in_contact), length_scale
    )
    return inner_grazing and (merged_problem, inner_grazing, list(zip(kept_rows, range(len(kept_rows)), strict=True)))
