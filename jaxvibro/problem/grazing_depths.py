"""Compute the depth of the contact beyond a grazing, along the orbit that leaves the contact out.

A contact of depth d meets a rigid wall with the speed sqrt(2 a d), a being the acceleration away from the wall at the
grazing. Its impact changes the velocity by (1 + R) sqrt(2 a d), a square root, while everything else changes smoothly
(Nordmark, J. Sound Vib. 145, 279, 1991). A soft wall changes the velocity by d^(3/2), without a root, unless the wall
moves and has damping of its own. Then the force has a jump at the wall and the acceleration within is a + j. The
contact lasts 2 sqrt(2 a d) / (a + j) and changes the velocity by j times that.
"""

from typing import NamedTuple

import numpy as np

from continuation import event_search

from .equations import continuation_problem
from .grazing import opening_rate, with_grazing_contacts
from .grazing_contact import (
    arclength_weights,
    contact_durations_at,
    find_grazing_contacts,
    refine_turning_point,
    wall_sides,
)
from .soft_grazing import is_smooth_wall


class Depth(NamedTuple):
    """Depth of a contact at one grazing of a wall.

    Attributes
    ----------
    side : int
        Side of the wall, -1 or 1.
    root : float
        Jump of the velocity divided by the square root of the depth. 0 if the change is of higher power, inf if a soft
        wall does not let go at once.
    slope : float
        Derivative of the depth with respect to the parameter along the orbit that omits all grazing contacts.
    acceleration : float
        Acceleration away from the wall, relative to it.
    """

    side: int
    root: float
    slope: float
    acceleration: float


def grazing_depths(scene, problem, z, length_scale):
    """Compute the depths at a grazing.

    Parameters
    ----------
    scene : Scene
        Scene at the point.
    problem : OrbitEquations
        Equations of the orbit.
    z : ndarray
        Unknowns at the grazing.
    length_scale : float
        Length of the scene.

    Returns
    -------
    tuple of Depth
        One entry for each grazing contact, in order along the orbit.
    """
    grazing_contacts = find_grazing_contacts(problem, z, length_scale)
    reduced_problem, reduced_z, omitted = with_grazing_contacts(
        problem, z, grazing_contacts, (False,) * len(grazing_contacts)
    )
    return tuple(
        omitted_grazing.depth
        for omitted_grazing in find_omitted_grazings(scene, reduced_problem, reduced_z, omitted, length_scale)
    )


class OmittedGrazing(NamedTuple):
    """Grazing contact with a wall, along an orbit that omits all grazing contacts.

    Attributes
    ----------
    row : int
        Row of the impact before.
    time_in_flight : float
        Time since the start of the flight after that impact.
    time : float
        Time since phase 0 of the drive.
    depth : Depth
        Depth of the contact.
    """

    row: int
    time_in_flight: float
    time: float
    depth: Depth


def find_omitted_grazings(scene, reduced_problem, reduced_z, omitted, length_scale):
    """Locate the `OmittedGrazing` of each contact that `grazing.with_grazing_contacts` left out."""
    tangent = event_search.unit_tangent(
        continuation_problem(reduced_problem),
        reduced_z,
        arclength_weights(reduced_problem, length_scale),
        reduced_problem,
    )
    side_of_wall, omitted_grazings, contact_durations = (
        wall_sides(reduced_problem.scene),
        [],
        contact_durations_at(reduced_problem, reduced_z),
    )
    for row, wall, time_in_flight in omitted:
        time_in_flight, _, approach_acceleration = refine_turning_point(
            reduced_problem, reduced_z, row, wall, time_in_flight
        )
        side, penetration_rate = (
            side_of_wall[wall],
            -opening_rate(reduced_problem, reduced_z, tangent, row, wall, time_in_flight),
        )
        depth_slope = penetration_rate / tangent[-1] if tangent[-1] else np.inf
        flight_start = reduced_z[row] + contact_durations[row] if len(reduced_problem.sequence.sides) else 0.0
        acceleration, time = -float(approach_acceleration), float(flight_start + time_in_flight)
        depth = Depth(side, _jump_coefficient(scene, side, acceleration, time), float(depth_slope), acceleration)
        omitted_grazings.append(OmittedGrazing(int(row), float(time_in_flight), time, depth))
    return tuple(omitted_grazings)


def _jump_coefficient(scene, side, acceleration, time):
    """Return the jump of the velocity divided by the square root of the depth."""
    wall = scene.left if side < 0 else scene.right
    if not wall.soft:
        restitution = scene.restitution if wall.restitution is None else wall.restitution
        return float((1.0 + float(restitution)) * np.sqrt(2.0 * acceleration))
    if is_smooth_wall(scene, side):
        return 0.0
    angular_frequency = wall.motion.harmonic * float(scene.frequency)
    wall_velocity = (
        -float(wall.motion.amplitude) * angular_frequency * np.sin(angular_frequency * time + float(wall.motion.phase))
    )
    free_damping = 0.0 if scene.force is not None else float(scene.damping)
    acceleration_jump = side * 2.0 * (float(wall.damping) - free_damping) * wall_velocity
    inner_acceleration = acceleration + acceleration_jump
    return (
        float(2.0 * np.sqrt(2.0 * acceleration) * abs(acceleration_jump) / inner_acceleration)
        if inner_acceleration > 0
        else np.inf
    )
