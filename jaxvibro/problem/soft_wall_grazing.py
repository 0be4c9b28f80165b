"""Locate grazings of soft walls with a continuous force, and find the branches that emanate from these grazings.

At such a wall the orbits with the contact and the orbits without it form one branch with a continuous tangent. The
force is continuous at a wall at rest, because the jump of the damping force is proportional to the velocity. At a
moving wall the force is continuous only if the wall has no separate damping. Other grazings are like grazings of a
rigid wall; see `grazing_contact`.

A contact with speed u has the depth u^2 / 2 a, where a is the acceleration away from the wall. To first order the
equations of the impacts have the same orbit for u and -u, so that a grazing is a singular point of these equations. The
grazing is a regular point of the equations that omit the contact. These equations are used to locate the grazing and to
continue from it.
"""

from typing import NamedTuple

import numpy as np

from continuation.augmented_systems import RootAndResidual

from . import grazing_contact
from .grazing_contact import (
    LOOSE_TOLERANCE,
    ZERO_RATE,
    GrazingPoint,
    find_grazing_contacts,
    include_grazing_contacts,
    locate_grazing,
    scene_wall_sides,
)

SLOW_SPEED = 1e-4  # scene's lengths per t; a slower contact is about to vanish
OFFSET_SPEEDS = 1e-3, 1e-4  # scene's lengths per t; closer to the singular point Newton's steps are rounding
COINCIDENCE_TOLERANCE = 1e-9  # relative to the scene's length; grazing contacts of two walls at one point


def is_smooth_soft_wall(scene, side):
    """Test whether a wall is soft and the force is continuous at a contact with zero relative velocity.

    Parameters
    ----------
    scene : Scene
        Scene.
    side : int
        Side of the wall.

    Returns
    -------
    bool
        True if the wall exists, is soft, and has a continuous force.
    """
    wall = scene.left if side < 0 else scene.right
    return wall is not None and wall.soft and (wall.motion is None or wall.damping is None)


def has_singular_contact(problem, grazing_contacts):
    """Test whether an impact with zero speed on a smooth soft wall makes the equations singular.

    Parameters
    ----------
    problem : OrbitProblem
        Equations of the orbit.
    grazing_contacts : sequence of GrazingContact
        Grazing contacts.

    Returns
    -------
    bool
        True if a grazing contact is an impact on a wall for which `is_smooth_soft_wall` is true.
    """
    return any(contact.is_impact and is_smooth_soft_wall(problem.scene, contact.side) for contact in grazing_contacts)


def slow_contact_rows(problem, z):
    """Return the rows of impacts on smooth soft walls (`is_smooth_soft_wall`) whose speeds are almost zero.

    Parameters
    ----------
    problem : OrbitProblem
        Equations of the orbit.
    z : ndarray
        Unknowns.

    Returns
    -------
    list of int
        Rows.
    """
    n_rows, sides, max_speed = problem.n_rows, problem.sequence.sides, SLOW_SPEED * problem.length_scale
    return [
        int(impact_row)
        for impact_row in problem.impact_rows
        if z[n_rows + impact_row] < max_speed and is_smooth_soft_wall(problem.scene, sides[impact_row])
    ]


def has_passed_zero_speed(problem, zs):
    """Mark the points at which the speed of an impact on a smooth soft wall has become negative.

    Parameters
    ----------
    problem : OrbitProblem
        Equations of the orbits.
    zs : ndarray
        Unknowns along a branch, array of shape (points, unknowns).

    Returns
    -------
    ndarray
        Boolean array of shape (points,): True if a speed is negative and was positive at the previous point.
    """
    n_rows, sides, has_point_passed = len(problem.sequence.sides), problem.sequence.sides, np.zeros(len(zs), bool)
    for impact_row in problem.impact_rows:
        if is_smooth_soft_wall(problem.scene, sides[impact_row]):
            has_point_passed[1:] |= (zs[:-1, n_rows + impact_row] > 0) & (zs[1:, n_rows + impact_row] < 0)
    return has_point_passed


def locate_soft_grazing(problem, z, slow_rows):
    """Locate the grazing near z at which the speeds of impacts on soft walls vanish.

    Parameters
    ----------
    problem : OrbitProblem
        Equations of the orbit.
    z : ndarray
        Guess.
    slow_rows : sequence of int
        Rows of the impacts whose speeds are zero at the grazing.

    Returns
    -------
    continuation.augmented_systems.RootAndResidual
        Solution.
    """
    n_rows, sides = len(problem.sequence.sides), problem.sequence.sides
    other_rows = [other_row for other_row in np.flatnonzero(sides != 0) if other_row not in slow_rows]
    reduced_problem, reduced_z = problem.with_rows(z, other_rows)
    omitted_locations = [_location_without_row(problem, z, row, other_rows) for row in slow_rows]
    solution = locate_grazing(reduced_problem, reduced_z, *omitted_locations[0])
    if solution.z is None:
        return solution
    n_reduced_rows, n_parameters = len(reduced_problem.sequence.sides), len(z) - 2 * n_rows
    grazing_z = np.array(z)
    grazing_z[-n_parameters:] = solution.z[-n_parameters:]
    orbit_duration = problem.duration(grazing_z)
    for reduced_row, other_row in enumerate(other_rows):
        grazing_z[other_row], grazing_z[n_rows + other_row] = (
            solution.z[reduced_row],
            solution.z[n_reduced_rows + reduced_row],
        )
    for row, (previous_reduced_row, wall_index, time_in_flight) in zip(slow_rows, omitted_locations, strict=True):
        time_in_flight, distance, _ = grazing_contact.refine_turning_point(
            reduced_problem, solution.z, previous_reduced_row, wall_index, time_in_flight
        )
        if not abs(distance) <= COINCIDENCE_TOLERANCE * problem.length_scale:
            return RootAndResidual(None, solution.residual)
        grazing_z[row] = (
            solution.z[previous_reduced_row]
            + grazing_contact.contact_durations_at(reduced_problem, solution.z)[previous_reduced_row]
            if other_rows
            else 0.0
        ) + time_in_flight
        grazing_z[row] -= orbit_duration * np.round((grazing_z[row] - z[row]) / orbit_duration)
        grazing_z[n_rows + row] = 0.0
    return solution._replace(z=grazing_z)


def _location_without_row(problem, z, row, other_rows):
    """Return (index in `other_rows` of the previous row, wall, time in flight after that row) of an omitted row."""
    wall_index = scene_wall_sides(problem.scene).index(int(problem.sequence.sides[row]))
    orbit_duration = problem.duration(z)
    if not other_rows:
        return 0, wall_index, float(np.mod(z[row], orbit_duration))
    times_since_others = np.mod(z[row] - z[other_rows], orbit_duration)
    previous_reduced_row = int(np.argmin(times_since_others))
    return (
        previous_reduced_row,
        wall_index,
        float(
            times_since_others[previous_reduced_row]
            - grazing_contact.contact_durations_at(problem, z)[other_rows[previous_reduced_row]]
        ),
    )


def find_all_exits(problem, z):
    """Find the branches that emanate from a grazing, also at smooth soft walls (`is_smooth_soft_wall`).

    Parameters
    ----------
    problem : OrbitProblem
        Equations of the orbit.
    z : ndarray
        Unknowns at the grazing.

    Returns
    -------
    GrazingPoint
        Grazing contacts, and the branches that emanate from the grazing. They include the branch that led to it. A
        branch is unknown if Newton's method fails.
    """
    grazing_contacts = find_grazing_contacts(problem, z)
    outcomes = list(_generate_exits(problem, z, grazing_contacts))
    exits = tuple(grazing_exit for grazing_exit, _ in outcomes if grazing_exit)
    return GrazingPoint(tuple(grazing_contacts), exits, all(is_certain for _, is_certain in outcomes))


def _generate_exits(problem, z, grazing_contacts):
    """Yield the results of `grazing_contact.check_exit_along_tangent` for all exits.

    If `is_smooth_soft_wall` is true for all contacts, the exits are computed from the orbit that omits the contacts.
    Otherwise `grazing_contact.try_contact_choices` is used.
    """
    if not grazing_contacts or not all(
        is_smooth_soft_wall(problem.scene, contact_or_location.side) for contact_or_location in grazing_contacts
    ):
        yield from grazing_contact.try_contact_choices(problem, z, grazing_contacts)
        return
    empty_inclusion_mask = (False,) * len(grazing_contacts)
    reduced_problem, reduced_z, omitted_locations = include_grazing_contacts(
        problem, z, grazing_contacts, empty_inclusion_mask
    )
    tangent = reduced_problem.tangent(reduced_z)
    time_ordered_indices = sorted(
        range(len(grazing_contacts)),
        key=lambda k: (
            grazing_contacts[k].row,
            0.0 if grazing_contacts[k].is_impact else grazing_contacts[k].time_since_impact,
        ),
    )
    distance_growth_rates, separation_accels = np.zeros(len(grazing_contacts)), np.zeros(len(grazing_contacts))
    for k, contact_or_location in zip(time_ordered_indices, omitted_locations, strict=True):
        distance_growth_rates[k] = grazing_contact.distance_growth_rate(
            reduced_problem, reduced_z, tangent, *contact_or_location
        )
        separation_accels[k] = -grazing_contact.refine_turning_point(reduced_problem, reduced_z, *contact_or_location)[
            2
        ]
    for sign in (1.0, -1.0):
        if (sign * distance_growth_rates > -ZERO_RATE).all():
            growth_rates_along = sign * grazing_contact.contact_growth_rates(
                reduced_problem, reduced_z, tangent, omitted_locations
            )
            yield grazing_contact.check_exit_along_tangent(
                reduced_problem, reduced_z, sign * tangent, growth_rates_along, empty_inclusion_mask
            )
        else:
            depth_growths = {
                k: DepthGrowthAlongBranch(-sign * distance_growth_rates[k], separation_accels[k])
                for k in time_ordered_indices
                if sign * distance_growth_rates[k] <= -ZERO_RATE
            }
            yield _exit_into_walls(problem, z, grazing_contacts, depth_growths, sign * tangent)


class DepthGrowthAlongBranch(NamedTuple):
    """Growth of the depth of a contact along a branch, to leading order.

    Attributes
    ----------
    approach_rate : float
        Derivative of the depth with respect to the arclength, along the orbits that omit the contact.
    separation_acceleration : float
        Acceleration of the mass away from the wall at the grazing.
    """

    approach_rate: float
    separation_acceleration: float


def _exit_into_walls(problem, z, grazing_contacts, depth_growths, reduced_tangent):
    """Return (`BranchFromGrazing` along which the mass enters walls, or None; True if this result is certain).

    `depth_growths` maps the index of each new contact to the `DepthGrowthAlongBranch`, in order along the orbit.
    `reduced_tangent` is the tangent of the orbits that omit the contacts. The exit starts from an orbit close to the
    grazing, because the equations are singular at the grazing.
    """
    if any(depth_growth.separation_acceleration <= 0 for depth_growth in depth_growths.values()):
        return None, True
    inclusion_mask = tuple(k in depth_growths for k in range(len(grazing_contacts)))
    new_problem, grazing_z, _ = include_grazing_contacts(problem, z, grazing_contacts, inclusion_mask)
    for relative_speed in OFFSET_SPEEDS:
        z_guess, tangent = _guess_beyond_grazing(
            new_problem, grazing_z, list(depth_growths.values()), reduced_tangent, relative_speed * problem.length_scale
        )
        grazing_exit, _ = grazing_contact.step_along_exit(
            new_problem, z_guess, tangent, inclusion_mask, LOOSE_TOLERANCE, (0.0,)
        )
        if grazing_exit:
            tangent = new_problem.tangent(grazing_exit.z_near_grazing, tangent)
            return grazing_exit._replace(
                point=grazing_exit.point._replace(z=grazing_exit.z_near_grazing, tangent=tangent)
            ), True
    return None, False


def _guess_beyond_grazing(new_problem, grazing_z, depth_growths, reduced_tangent, fastest_speed):
    """Return (z at which the fastest new contact has the speed `fastest_speed`, unit direction from the grazing to it).

    At an arclength s along `reduced_tangent` a contact has the speed sqrt(2 a r s), where a is the separation
    acceleration of its `DepthGrowthAlongBranch` and r is the derivative of the depth. To this order the other unknowns
    do not depend on the contact. Newton's method converges from this guess, but not from the grazing.
    """
    n_rows, n_reduced_rows = len(new_problem.sequence.sides), (len(reduced_tangent) - 1) // 2
    arclength = fastest_speed**2 / max(
        2.0 * depth_growth.separation_acceleration * depth_growth.approach_rate for depth_growth in depth_growths
    )
    z_rate, tangent, depth_growths, reduced_row = (
        np.zeros(len(grazing_z)),
        np.zeros(len(grazing_z)),
        iter(depth_growths),
        0,
    )
    z_rate[-1] = reduced_tangent[-1]
    for impact_row in new_problem.impact_rows:
        if grazing_z[n_rows + impact_row] == 0.0:
            depth_growth = next(depth_growths)
            speed = np.sqrt(2.0 * depth_growth.separation_acceleration * depth_growth.approach_rate * arclength)
            tangent[impact_row], tangent[n_rows + impact_row] = -speed / depth_growth.separation_acceleration, speed
        else:
            z_rate[impact_row], z_rate[n_rows + impact_row] = (
                reduced_tangent[reduced_row],
                reduced_tangent[n_reduced_rows + reduced_row],
            )
            reduced_row += 1
    return grazing_z + arclength * z_rate + tangent, tangent / np.linalg.norm(new_problem.weights(arclength) * tangent)
