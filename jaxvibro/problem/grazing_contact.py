"""Locate grazing contacts, and find the admissible branches that emanate from a grazing.

Find the admissible branches that emanate from a grazing. At a grazing each grazing contact may be included in the
itinerary as an impact with zero speed, or omitted. For each of these choices the orbit is a regular point of a branch,
unless an included contact is at a soft wall with a continuous force (`soft_wall_grazing`). A direction of the branch is
admissible if the speeds of the included contacts and the clearances at the omitted contacts become positive.
"""

from functools import partial
from itertools import product
from typing import NamedTuple

import jax.numpy as jnp
import numpy as np
from jaxtyping import Float

from continuation import augmented_systems
from continuation.arclength import Point, make_control, make_start_point
from continuation.hostcall import FAST_COMPILE, persistent_jit

from ..compiled.kernel_calls import call_as_kernel
from ..contact.kinds import flow_coefficients
from ..orbits import flight_clearance, impact_equations
from ..orbits.flight_clearance import GRAZING_TOLERANCE
from .orbit_equations import (
    Diagnostics,
    diagnose,
    flight_without_impacts,
    scene_at,
    sequence_at,
    sides_with_release_codes,
)
from .orbit_point import match_repeated_contacts
from .orbit_problem import OrbitProblem

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


EXIT_STEPS = 1e-5, 1e-7  # arclengths at which a branch that emanates from a grazing is checked
TIGHT_TOLERANCE, LOOSE_TOLERANCE = (
    1e-12,
    1e-10,
)  # Newton's tolerance with and without added impacts; slow impacts amplify rounding
ZERO_RATE = 1e-6  # derivatives of speeds and distances along a branch below this count as zero
MAX_FREE_CHOICES = 4  # number of grazing contacts up to which every choice is tried


class BranchFromGrazing(NamedTuple):
    """Admissible branch that emanates from a grazing.

    Attributes
    ----------
    problem : OrbitProblem
        Equations of the orbits of the branch.
    point : Point
        The grazing, with the tangent that leads away from it.
    z_near_grazing : ndarray
        Unknowns of an orbit close to the grazing.
    diagnostics : Diagnostics
        Diagnostics at `z_near_grazing`.
    inclusion_mask : tuple of bool
        True for each grazing contact that counts as an impact.
    """

    problem: OrbitProblem
    point: Point
    z_near_grazing: Float[np.ndarray, " unknowns"]
    diagnostics: Diagnostics
    inclusion_mask: tuple[bool, ...]


class GrazingPoint(NamedTuple):
    """Details of a GR, CH or RL.

    Attributes
    ----------
    grazing_contacts : tuple of GrazingContact
        Grazing contacts.
    exits : tuple of BranchFromGrazing
        Branches that emanate from the point.
    complete : bool
        True if all exits are known.
    not_followed : tuple of bool
        True for each exit along which the branch does not continue.
    """

    grazing_contacts: tuple[GrazingContact, ...]
    exits: tuple[BranchFromGrazing, ...]
    complete: bool
    not_followed: tuple[bool, ...] = ()


def try_contact_choices(problem, z, grazing_contacts):
    """Yield the results of `check_exit_along_tangent` for all choices of grazing contacts and for both directions."""
    for inclusion_mask in _contact_choices(problem, z, grazing_contacts):
        problem_with_choice, grazing_z, omitted_locations = include_grazing_contacts(
            problem, z, grazing_contacts, inclusion_mask
        )
        tangent = problem_with_choice.tangent(grazing_z)
        growth_rates_along = contact_growth_rates(problem_with_choice, grazing_z, tangent, omitted_locations)
        for sign in (1.0, -1.0):
            yield check_exit_along_tangent(
                problem_with_choice, grazing_z, sign * tangent, sign * growth_rates_along, inclusion_mask
            )


def include_grazing_contacts(problem, z, grazing_contacts, inclusion_mask):
    """Return (equations, z, `locate_omitted_contacts` result) of the orbit with the included contacts as impacts."""
    all_impacts = list_impacts(problem, z, grazing_contacts, inclusion_mask)
    included_impacts = [impact for impact in all_impacts if impact.is_included]
    new_problem, grazing_z = replace_impacts(problem, z, included_impacts)
    return new_problem, grazing_z, locate_omitted_contacts(new_problem, grazing_z, all_impacts, included_impacts)


def replace_impacts(problem, z, new_impacts, old_rows=()):
    """Return the problem with these `OrbitImpact`s and its unknowns; `old_rows` are the rows that contain them."""
    return problem.with_impacts(z, [(impact.time, impact.speed, impact.side) for impact in new_impacts], old_rows)


def _contact_choices(problem, z, grazing_contacts):
    """List the choices of grazing contacts as impacts that lead to different orbits.

    If the orbit is a repeated shorter orbit, choices that differ only by a shift in time lead to equal orbits. Among
    equivalent choices the choice of the current branch is listed, or else the first choice.
    """
    branch_mask, inclusion_masks = tuple(contact_or_mask.is_impact for contact_or_mask in grazing_contacts), []
    if not grazing_contacts:  # the samples did not resolve which turning point touches the wall
        return [branch_mask]
    contact_times = np.array(
        [
            contact_or_mask.time_since_impact + (z[contact_or_mask.row] if len(problem.sequence.sides) else 0.0)
            for contact_or_mask in grazing_contacts
        ]
    )
    contact_image_table = match_repeated_contacts(
        problem, z, contact_times, np.array([contact_or_mask.side for contact_or_mask in grazing_contacts])
    )
    for inclusion_mask in _list_contact_choices(grazing_contacts):
        equivalent_masks = [tuple(inclusion_mask[k] for k in contact_images) for contact_images in contact_image_table]
        if (inclusion_mask == branch_mask or branch_mask not in equivalent_masks) and not any(
            contact_or_mask in inclusion_masks for contact_or_mask in equivalent_masks
        ):
            inclusion_masks.append(inclusion_mask)
    return inclusion_masks


def _list_contact_choices(grazing_contacts):
    """List choices of grazing contacts as impacts.

    For few grazing contacts all choices are listed. For many the list contains the choice of the current branch, the
    complement of this choice, no contacts, and all contacts.
    """
    if len(grazing_contacts) <= MAX_FREE_CHOICES:
        return list(product((False, True), repeat=len(grazing_contacts)))
    branch_mask = tuple(entry.is_impact for entry in grazing_contacts)
    return list(
        dict.fromkeys(
            [
                branch_mask,
                tuple(not entry for entry in branch_mask),
                (False,) * len(grazing_contacts),
                (True,) * len(grazing_contacts),
            ]
        )
    )


class OrbitImpact(NamedTuple):
    """Impact or grazing contact of an orbit; `is_included` is False for a grazing contact that is omitted."""

    time: float
    speed: float
    side: int
    is_included: bool


def list_impacts(problem, z, grazing_contacts, inclusion_mask):
    """List all impacts and grazing contacts as `OrbitImpact` records, in order along the orbit."""
    n_rows, inclusion_of_contact = len(problem.sequence.sides), dict(zip(grazing_contacts, inclusion_mask, strict=True))
    contact_by_row = {
        grazing_contact.row: grazing_contact for grazing_contact in grazing_contacts if grazing_contact.is_impact
    }
    keyed_impacts = []
    coded_sides = sides_with_release_codes(problem.sequence)
    for row_index in np.flatnonzero(coded_sides):
        grazing_contact, coded_side = contact_by_row.get(int(row_index)), int(coded_sides[row_index])
        orbit_impact = OrbitImpact(
            z[row_index],
            0.0 if grazing_contact else z[n_rows + row_index],
            coded_side,
            inclusion_of_contact[grazing_contact] if grazing_contact else True,
        )
        keyed_impacts.append(((int(row_index), 0.0), orbit_impact))
    for grazing_contact in grazing_contacts:
        if not grazing_contact.is_impact:
            row_time = z[grazing_contact.row] if n_rows else 0.0
            keyed_impacts.append(
                (
                    (grazing_contact.row, grazing_contact.time_since_impact),
                    OrbitImpact(
                        row_time + grazing_contact.time_since_impact,
                        0.0,
                        grazing_contact.side,
                        inclusion_of_contact[grazing_contact],
                    ),
                )
            )
    return [orbit_impact for _, orbit_impact in sorted(keyed_impacts)]


def locate_omitted_contacts(problem, z, all_impacts, included_impacts):
    """Return (row, wall, time since the start of the flight after this row) of each omitted grazing contact.

    `problem` and `z` belong to the orbit without the omitted contacts, with one row for each of `included_impacts`.
    """
    wall_sides, omitted_locations, contact_durations = (
        scene_wall_sides(problem.scene),
        [],
        contact_durations_at(problem, z),
    )
    orbit_duration = problem.duration(z)
    previous_row = len(included_impacts) - 1  # grazings before the first impact follow the last one
    for orbit_impact in all_impacts:
        if orbit_impact.is_included:
            previous_row = included_impacts.index(orbit_impact)
        else:
            previous_time, flight_row = (
                included_impacts[previous_row].time if included_impacts else 0.0,
                max(previous_row, 0),
            )
            omitted_locations.append(
                (
                    flight_row,
                    wall_sides.index(orbit_impact.side),
                    (orbit_impact.time - previous_time) % orbit_duration - float(contact_durations[flight_row]),
                )
            )
    return omitted_locations


def distance_growth_rate(problem, z, z_direction, row, wall_index, time_in_flight):
    """Return the derivative of the distance from a wall in a direction of z.

    Parameters
    ----------
    problem : OrbitProblem
        Equations of the orbit.
    z : ndarray
        Unknowns.
    z_direction : ndarray
        Direction in the space of unknowns.
    row : int
        Row of the impact before the flight.
    wall_index : int
        Index of the wall.
    time_in_flight : float
        Time since the start of the flight.

    Returns
    -------
    float
        Directional derivative, by a central difference.
    """

    def distance_at(z):
        return wall_distance_and_speed(problem, row, wall_index, np.append(z, time_in_flight))[0]

    return augmented_systems.directional_derivative(distance_at, z, z_direction)


def contact_growth_rates(problem, z, tangent, omitted_locations):
    """Return derivatives along a tangent: of speeds that are zero, then of the distances at omitted contacts."""
    n_rows = len(problem.sequence.sides)
    impact_speed_rates = [tangent[n_rows + k] for k in problem.impact_rows if z[n_rows + k] == 0.0]
    return np.array(
        impact_speed_rates + [distance_growth_rate(problem, z, tangent, *location) for location in omitted_locations]
    )


def check_exit_along_tangent(problem, z, tangent, growth_rates_along, inclusion_mask):
    """Return (`BranchFromGrazing` along a tangent or None, True if this result is certain).

    `growth_rates_along` is the result of `contact_growth_rates` for this tangent.
    """
    if (growth_rates_along < -ZERO_RATE).any():
        return None, True
    grazing_exit, has_converged = step_along_exit(
        problem,
        z,
        tangent,
        inclusion_mask,
        TIGHT_TOLERANCE if any(inclusion_mask) else LOOSE_TOLERANCE,
        EXIT_STEPS,
    )
    return grazing_exit, has_converged or growth_rates_along.min(initial=0.0) <= 0


def step_along_exit(problem, z, tangent, inclusion_mask, newton_tolerance, trial_arclengths):
    """Return (`BranchFromGrazing` along a tangent or None, True if Newton's method converged).

    `trial_arclengths` are arclengths, tried in order until the orbit is admissible.
    """
    grazing_point, has_converged = make_start_point(z, tangent), False
    step_control = make_control(problem.weights(), 0.0, 1.0, newton_tolerance, (-np.inf, np.inf))
    for trial_arclength in trial_arclengths:
        nearby_point = problem.take_step(grazing_point, trial_arclength, step_control)
        has_converged |= bool(nearby_point.converged)
        diagnostics = diagnose(problem, nearby_point.z[None])
        if nearby_point.converged and are_admissible(problem, nearby_point.z, diagnostics)[0]:
            return BranchFromGrazing(problem, grazing_point, nearby_point.z, diagnostics, inclusion_mask), True
    return None, has_converged
