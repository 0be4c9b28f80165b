"""Grazing of soft walls, where the orbits with a contact and those without it are one branch, its tangent continuous.

So it is where the force is continuous at the touch: at a wall that stands still whatever its damping, as the damping's
jump goes with the velocity; at one that moves only if its damping is the scene's. Else a grazing is as that of a rigid
wall, and left to `grazing_contact`.

A contact of speed u is u^2 / 2 a deep, a being the acceleration away from the wall: with u and with -u the equations of
the impacts have the same orbit to first order, so that a grazing is a singular point of theirs. It is found, and left,
by way of the orbit that leaves the contact out, of which it is a regular point.
"""

from typing import NamedTuple

import numpy as np

from continuation import event_search
from continuation.augmented_systems import PointSolution

from . import grazing, grazing_contact
from .equations import continuation_problem, side_codes
from .grazing import LOOSE_TOLERANCE, ZERO_RATE, with_grazing_contacts, with_impacts
from .grazing_contact import arclength_weights, locate_grazing, wall_sides

SLOW_SPEED = 1e-4  # of the scene's length per t: as slow a contact is about to be none
OFFSET_SPEEDS = 1e-3, 1e-4  # as in `grazing_contact`; nearer to the singular point Newton's steps are rounding
COINCIDENCE_TOLERANCE = 1e-9  # of the scene's length: as near is a touch of another wall at the same point


def is_smooth_wall(scene, side):
    """Whether the wall on a side is soft, and a mass that moves along with it feels no jump of force on entering."""
    wall = scene.left if side < 0 else scene.right
    return wall is not None and wall.soft and (wall.motion is None or wall.damping is None)


def is_singular_grazing(problem, contacts):
    """Whether at some `Touch`es a contact with a soft wall has no speed: the equations are singular there."""
    return any(contact.is_impact and is_smooth_wall(problem.scene, contact.side) for contact in contacts)


def slow_contact_rows(problem, z, length_scale):
    """Rows of contacts with soft walls that are about to lose their speed."""
    n_rows, sides = len(problem.sequence.sides), problem.sequence.sides
    return [
        int(k)
        for k in problem.impact_rows
        if z[n_rows + k] < SLOW_SPEED * length_scale and is_smooth_wall(problem.scene, sides[k])
    ]


def is_past_zero_speed(problem, zs):
    """Which points, (points,), have a contact with a soft wall of a speed below zero that is above at the point
    before."""
    n_rows, sides, is_past = len(problem.sequence.sides), problem.sequence.sides, np.zeros(len(zs), bool)
    for k in problem.impact_rows:
        if is_smooth_wall(problem.scene, sides[k]):
            is_past[1:] |= (zs[:-1, n_rows + k] > 0) & (zs[1:, n_rows + k] < 0)
    return is_past


def locate_soft_grazing(problem, z, slow_rows, length_scale):
    """The grazing near z at which contacts with soft walls, in these rows, lose their speed: a `locate.Located`."""
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
    """(row before, counted among those kept, wall, time since the flight after that began) of a row that is left out;
    kept_rows: the rows that are kept."""
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
    """As `grazing.exits`, also where the walls touched are soft."""
    return grazing.find_exits(problem, z, length_scale, _generate_exits)


def _generate_exits(problem, z, grazing_contacts, length_scale):
    """As `grazing.each_choice`; where all is smooth, both directions of the orbit that leaves the touches out."""
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
    """How a flight comes to touch a wall along a branch: how fast it comes nearer, its acceleration away from it."""

    rate: float
    acceleration: float


def _entering_exit(problem, z, grazing_contacts, approaches, reduced_tangent, length_scale):
    """(the `GrazingExit` along which walls that come nearer are entered, None where it is none; whether that is sure).

    approaches: the `WallApproach` of each touch that is entered, by its place, in order of travel; reduced_tangent: the
    tangent of the orbits that leave the touches out. The exit's point lies a little on, as the grazing's tangent says
    nothing of its bend."""
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
    """(z where the fastest of the contacts that begin has a speed, the unit direction there from the grazing).

    A length s along `reduced_tangent`, a contact has the speed sqrt(2 pull rate s), and the rest is as without it to
    that order. Newton's method comes to the orbit from there, but not from the grazing."""
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
