"""Grazing from within: a mass within a soft wall comes back to it, and just does not leave, or just does.

Where it leaves for a moment and enters again, one contact is two. With h how far it comes out, a its acceleration into
the wall, the speeds of leaving and entering are sqrt(2 a h), to first order, and the force has no jump where
`soft_grazing.is_smooth`: the motion outside differs from that within by h^(3/2), so that the orbits of one contact and
those of two are one branch, its tangent continuous. Of the equations with two it is a singular point, as the time of
leaving changes like the root of h; and those with one lose their stay's end, which jumps to the touch. It is a regular
point of the equations with one contact whose stay goes on past the touch (`Cycle.passed`): there it is found, and left.
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
    1e-2  # of the scene's length: a contact that comes as near to its wall, or enters as slowly, may be about to
)
END_DEPTH = 1e-12  # of the scene's length: below the wall there the orbits with one contact end
END_SPEEDS = (
    1e-6,
    3e-6,
)  # of the scene's length per t: at that speed of entering those with two end, the first that is met
SAMPLE_INTERVAL, MAX_SAMPLES = 0.2, 512  # of a stay's own time between samples; samples of a stay
MIN_HALF_SWINGS = 1.25  # half-swings: in a shorter stay the mass does not come back twice
NEWTON_STEPS = 6  # of Newton's steps to a turning point


def is_pressed_into_wall(problem, z, row):
    """Whether a mass that comes to its wall at a row without speed is pressed into it: it came from within."""
    return problem.scene.force is None and bool(_contact_motion_at(problem, z, row, 0.0)[2] > 0)


class InnerTurningPoint(NamedTuple):
    """Where a mass comes back to its wall within a stay. row: of the contact; time_in_contact: the time since it began;
    depth, how far it is past the wall there; inward_acceleration: its acceleration into the wall."""

    row: int
    time_in_contact: float
    depth: float
    inward_acceleration: float


class InnerGrazing(NamedTuple):
    """A grazing from within. extended_problem: the equations with one contact, its stay going on past the touch; z: its
    orbit; row: of the contact; time_in_contact: when the touch is since that began; tangent: of the branch, towards
    orbits that stay within; depth_rate: how fast the depth at the touch grows along it; inward_acceleration: the
    acceleration into the wall; residual."""

    extended_problem: OrbitEquations
    z: Float[np.ndarray, " unknowns"]
    row: int
    time_in_contact: float
    tangent: Float[np.ndarray, " unknowns"]
    depth_rate: float
    inward_acceleration: float
    residual: float


def _motion_in_contact(z, times, problem, row):
    """(depth, its rate, the acceleration into the wall) at times since the contact in a row began."""
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
    """The same at one time: three numbers."""
    return np.asarray(_contact_motion(z, np.array([time_in_contact]), problem, np.int32(row)))[:, 0]


def inner_turning_points(problem, z):
    """The `InnerTurningPoint`s of the contacts with walls of a spring and a damper at which the force has no jump, one
    of each: the nearest to its wall."""
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
    """(how fast the mass swings within a wall, its half-swing, inf where it creeps)."""
    wall_name = "left" if side < 0 else "right"
    wall_params = {term: _wall_parameter(problem, z, wall_name, term) for term in ("stiffness", "damping")}
    oscillation_rate = np.sqrt(1.0 + wall_params["stiffness"])
    squared_frequency = oscillation_rate * oscillation_rate - wall_params["damping"] ** 2
    return oscillation_rate, np.pi / np.sqrt(squared_frequency) if squared_frequency > 0 else 0.0


def _wall_parameter(problem, z, wall_name, term):
    """A number of a wall at z, its hardness counted."""
    return float(np.asarray(scene_at(problem, z).replace().parameter(f"{wall_name}.{term}")))


def _nearest_turning_point(problem, z, row, contact_duration, oscillation_rate):
    """The `InnerTurningPoint` of a stay of so long, None where the mass does not come back to its wall before the
    end."""
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
    """The `InnerTurningPoint` near a time."""
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
    """The `OrbitEquations` whose stay at a row goes on past a touch at a time: a little later it is within."""
    min_contact_times = np.zeros(len(problem.sequence.sides))
    min_contact_times[row] = time_in_contact + extension
    return problem._replace(sequence=problem.sequence._replace(min_contact_time=min_contact_times))


def locate_inner_grazing(problem, z, row, time_in_contact, length_scale):
    """The `InnerGrazing` near z where a stay touches its wall at about a time, None where none is found."""
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
    """How fast the depth at a time of a stay grows in a direction of z."""
    offset_depths = (
        _contact_motion_at(problem, z + sign * augmented_systems.DIFFERENCE_STEP * direction, row, time_in_contact)[0]
        for sign in (1, -1)
    )
    return float(np.subtract(*offset_depths) / (2.0 * augmented_systems.DIFFERENCE_STEP))


class UpcomingGrazing(NamedTuple):
    """A grazing from within that a branch is about to meet. z: its orbit where the branch ends; step: how far ahead;
    residual; grazing_contacts, exits, complete: as `grazing.exits` gives them."""

    z: Float[np.ndarray, " unknowns"]
    step: float
    residual: float
    grazing_contacts: list[GrazingContact]
    exits: list[grazing.GrazingExit]
    complete: bool


def find_upcoming_grazing(problem, points, control, length_scale):
    """(the place of the last of a branch's points before a grazing from within, its `UpcomingGrazing`), None where
    there is none near. points: as `arclength.Point`s, the last one that from which no step was tried yet, or failed."""
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
    """One contact that is about to be two."""
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
    """The `GrazingExit` along orbits of two contacts, None where Newton's method comes to none."""
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
    """Two contacts that are about to be one: the first of them ends as the second begins."""
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
    """(equations without the contact at a row, the `InnerGrazing` there, [(row of those kept, the place there)])."""
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
