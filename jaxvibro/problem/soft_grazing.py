"""Locate and leave grazings of soft walls, where the orbits with a contact and those without it form one smooth branch.

The tangent is continuous if the force is continuous at the grazing contact. This holds at a wall at rest with any
damping, because the jump of the damping force is proportional to the velocity. It holds at a moving wall only if its
damping is that of the scene. Otherwise a grazing is like that of a rigid wall and is left to `grazing_contact`.

A contact with speed u has the depth u^2 / 2 a, a being the acceleration away from the wall. With u and with -u the
equations of the impacts have the same orbit to first order, so a grazing is a singular point of them. It is located and
left by way of the orbit that omits the contact, of which it is a regular point.
"""

from typing import NamedTuple

import numpy as np

from continuation import event_search
from continuation.augmented_systems import PointSolution

from . import grazing, grazing_contact
from .equations import continuation_problem, side_codes
from .grazing import LOOSE_TOLERANCE, ZERO_RATE, with_grazing_contacts, with_impacts
from .grazing_contact import arclength_weights, locate_grazing, wall_sides

SLOW_SPEED = 1e-4  # scene's lengths per t; a slower contact is about to vanish
OFFSET_SPEEDS = 1e-3, 1e-4  # scene's lengths per t; closer to the singular point Newton's steps are rounding
COINCIDENCE_TOLERANCE = 1e-9  # relative to the scene's length; grazing contacts of two walls at one point


def is_smooth_wall(scene, side):
    """Test whether a wall is soft and its force is continuous for a mass that moves along with it.

    Parameters
    ----------
    scene : Scene
        Scene.
    side : int
        Side of the wall.

    Returns
    -------
    bool
        True if the wall exists and is smooth.
    """
    wall = scene.left if side < 0 else scene.right
    return wall is not None and wall.soft and (wall.motion is None or wall.damping is None)


def is_singular_grazing(problem, contacts):
    """Test whether the equations are singular because a contact with a smooth soft wall has zero speed.

    Parameters
    ----------
    problem : OrbitEquations
        Equations of the orbit.
    contacts : sequence of GrazingContact
        Grazing contacts.

    Returns
    -------
    bool
        True if one of them is such a contact.
    """
    return any(contact.is_impact and is_smooth_wall(problem.scene, contact.side) for contact in contacts)


def slow_contact_rows(problem, z, length_scale):
    """Return the rows of contacts with smooth soft walls that are about to lose their speed.

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
    list of int
        Rows.
    """
    n_rows, sides = len(problem.sequence.sides), problem.sequence.sides
    return [
        int(k)
        for k in problem.impact_rows
        if z[n_rows + k] < SLOW_SPEED * length_scale and is_smooth_wall(problem.scene, sides[k])
    ]


def is_past_zero_speed(problem, zs):
    """Mark the points at which the speed of a contact with a smooth soft wall has become negative.

    Parameters
    ----------
    problem : OrbitEquations
        Equations of the orbits.
    zs : ndarray
        Unknowns along a branch, array of shape (points, unknowns).

    Returns
    -------
    ndarray
        Boolean array of shape (points,): True if a speed is negative and was positive at the previous point.
    """
    n_rows, sides, is_past = len(problem.sequence.sides), problem.sequence.sides, np.zeros(len(zs), bool)
    for k in problem.impact_rows:
        if is_smooth_wall(problem.scene, sides[k]):
            is_past[1:] |= (zs[:-1, n_rows + k] > 0) & (zs[1:, n_rows + k] < 0)
    return is_past


def locate_soft_grazing(problem, z, slow_rows, length_scale):
    """Locate the grazing near z at which contacts with soft walls lose their speed.

    Parameters
    ----------
    problem : OrbitEquations
        Equations of the orbit.
    z : ndarray
        Guess.
    slow_rows : sequence of int
        Rows of these contacts.
    length_scale : float
        Length of the scene.

    Returns
    -------
    continuation.augmented_systems.PointSolution
        Solution.
    """
    n_rows, sides = len(problem.sequence.sides), problem.sequence.sides
    kept_rows = [k for k in np.flatnonzero(sides != 0) if k not in slow_rows]
    impacts = [grazing.ImpactEntry(z[k], z[n_rows + k], side_codes(problem.sequence)[k], True) for k in kept_rows]
    reduced_problem, reduced_z = with_impacts(problem, z, impacts, kept_rows)
    locations = [_location_of_row(problem, z, row, kept_rows) for row in slow_rows]
    solution = locate_grazing(reduced_problem, reduced_z, *locations[0])
    if solution.z is None:
        return solution
    n_reduced_rows, n_parameters = len(reduced_problem.sequence.sides), len(z) - 2 * n_rows
    grazing_z = np.array(z)
    grazing_z[-n_parameters:] = solution.z[-n_parameters:]
    orbit_duration = grazing_contact.orbit_duration_at(problem, grazing_z)
    for index, k in enumerate(kept_rows):
        grazing_z[k], grazing_z[n_rows + k] = solution.z[index], solution.z[n_reduced_rows + index]
    for row, (previous_row, wall, time_in_flight) in zip(slow_rows, locations, strict=True):
        time_in_flight, distance, _ = grazing_contact.refine_turning_point(
            reduced_problem, solution.z, previous_row, wall, time_in_flight
        )
        if not abs(distance) <= COINCIDENCE_TOLERANCE * length_scale:
            return PointSolution(None, solution.residual)
        grazing_z[row] = (
            solution.z[previous_row] + grazing_contact.contact_durations_at(reduced_problem, solution.z)[previous_row]
            if kept_rows
            else 0.0
        ) + time_in_flight
        grazing_z[row] -= orbit_duration * np.round((grazing_z[row] - z[row]) / orbit_duration)
        grazing_z[n_rows + row] = 0.0
    return solution._replace(z=grazing_z)


def _location_of_row(problem, z, row, kept_rows):
    """Return (previous row among the kept ones, wall, time since the start of its flight) of an omitted row."""
    wall = wall_sides(problem.scene).index(int(problem.sequence.sides[row]))
    orbit_duration = grazing_contact.orbit_duration_at(problem, z)
    if not kept_rows:
        return 0, wall, float(np.mod(z[row], orbit_duration))
    delays = np.mod(z[row] - z[kept_rows], orbit_duration)
    previous_index = int(np.argmin(delays))
    return (
        previous_index,
        wall,
        float(delays[previous_index] - grazing_contact.contact_durations_at(problem, z)[kept_rows[previous_index]]),
    )


def find_all_exits(problem, z, length_scale):
    """Find the exits of a grazing, also at smooth soft walls.

    Parameters
    ----------
    problem : OrbitEquations
        Equations of the orbit.
    z : ndarray
        Unknowns at the grazing.
    length_scale : float
        Length of the scene.

    Returns
    -------
    grazing_contacts : list of GrazingContact
        Grazing contacts.
    exits : list of GrazingExit
        Branches that emanate from the grazing.
    complete : bool
        Whether all exits are known.
    """
    return grazing.find_exits(problem, z, length_scale, _generate_exits)


def _generate_exits(problem, z, grazing_contacts, length_scale):
    """Yield exits as `grazing.try_all_choices`; if all walls are smooth, along the orbit that omits the contacts."""
    if not grazing_contacts or not all(is_smooth_wall(problem.scene, entry.side) for entry in grazing_contacts):
        yield from grazing.try_all_choices(problem, z, grazing_contacts, length_scale)
        return
    no_contacts = (False,) * len(grazing_contacts)
    reduced_problem, reduced_z, omitted = with_grazing_contacts(problem, z, grazing_contacts, no_contacts)
    tangent = event_search.unit_tangent(
        continuation_problem(reduced_problem),
        reduced_z,
        arclength_weights(reduced_problem, length_scale),
        reduced_problem,
    )
    order = sorted(
        range(len(grazing_contacts)),
        key=lambda k: (grazing_contacts[k].row, 0.0 if grazing_contacts[k].is_impact else grazing_contacts[k].delay),
    )
    opening_rates, accelerations = np.zeros(len(grazing_contacts)), np.zeros(len(grazing_contacts))
    for k, entry in zip(order, omitted, strict=True):
        opening_rates[k] = grazing.opening_rate(reduced_problem, reduced_z, tangent, *entry)
        accelerations[k] = -grazing_contact.refine_turning_point(reduced_problem, reduced_z, *entry)[2]
    for sign in (1.0, -1.0):
        if (sign * opening_rates > -ZERO_RATE).all():
            rates = sign * grazing.growth_rates(reduced_problem, reduced_z, tangent, omitted)
            yield grazing.find_exit(reduced_problem, reduced_z, sign * tangent, rates, length_scale, no_contacts)
        else:
            approaches = {
                k: WallApproach(-sign * opening_rates[k], accelerations[k])
                for k in order
                if sign * opening_rates[k] <= -ZERO_RATE
            }
            yield _entering_exit(problem, z, grazing_contacts, approaches, sign * tangent, length_scale)


class WallApproach(NamedTuple):
    """Approach of a flight to a wall along a branch: its rate, and the acceleration away from the wall."""

    rate: float
    acceleration: float


def _entering_exit(problem, z, grazing_contacts, approaches, reduced_tangent, length_scale):
    """Return the `GrazingExit` along which approaching walls are entered, or None, and whether this is certain.

    `approaches` maps the index of each grazing contact that is entered to its `WallApproach`, in order of travel;
    `reduced_tangent` is the tangent of the orbits that omit the contacts. The point of the exit lies close to the
    grazing, because the tangent at the grazing contains no curvature.
    """
    if any(approach.acceleration <= 0 for approach in approaches.values()):
        return None, True
    included = tuple(k in approaches for k in range(len(grazing_contacts)))
    new_problem, start_z, _ = with_grazing_contacts(problem, z, grazing_contacts, included)
    for relative_speed in OFFSET_SPEEDS:
        guess, tangent = _guess_beyond_grazing(
            new_problem, start_z, list(approaches.values()), reduced_tangent, relative_speed * length_scale
        )
        grazing_exit, _ = grazing.step_along_exit(
            new_problem, guess, tangent, length_scale, included, LOOSE_TOLERANCE, (0.0,)
        )
        if grazing_exit:
            tangent = event_search.unit_tangent(
                continuation_problem(new_problem),
                grazing_exit.nearby_z,
                arclength_weights(new_problem, length_scale),
                new_problem,
                tangent,
            )
            return grazing_exit._replace(
                point=grazing_exit.point._replace(z=grazing_exit.nearby_z, tangent=tangent)
            ), True
    return None, False


def _guess_beyond_grazing(new_problem, start_z, approaches, reduced_tangent, max_speed):
    """Return z where the fastest new contact has a given speed, and the unit direction from the grazing to it.

    At an arclength s along `reduced_tangent` a contact has the speed sqrt(2 a r s), with the acceleration a and the
    rate r of its `WallApproach`. The other unknowns are as without the contact to that order. Newton's method converges
    from there, but not from the grazing.
    """
    n_rows, n_reduced_rows = len(new_problem.sequence.sides), (len(reduced_tangent) - 1) // 2
    arclength = max_speed**2 / max(2.0 * approach.acceleration * approach.rate for approach in approaches)
    z_slope, tangent, approaches, index = np.zeros(len(start_z)), np.zeros(len(start_z)), iter(approaches), 0
    z_slope[-1] = reduced_tangent[-1]
    for k in new_problem.impact_rows:
        if start_z[n_rows + k] == 0.0:
            approach = next(approaches)
            speed = np.sqrt(2.0 * approach.acceleration * approach.rate * arclength)
            tangent[k], tangent[n_rows + k] = -speed / approach.acceleration, speed
        else:
            z_slope[k], z_slope[n_rows + k] = reduced_tangent[index], reduced_tangent[n_reduced_rows + index]
            index += 1
    return start_z + arclength * z_slope + tangent, tangent / np.linalg.norm(
        arclength_weights(new_problem, arclength) * tangent
    )
