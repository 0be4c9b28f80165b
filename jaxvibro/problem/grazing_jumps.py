"""Compute the depth of the contact beyond a grazing, along the orbit that omits the contact.

Let d be the depth and a the acceleration away from the wall at the grazing. At a rigid wall the mass has the speed
sqrt(2 a d), and the impact changes the velocity by (1 + R) sqrt(2 a d). All other changes are smooth (Nordmark, J.
Sound Vib. 145, 279, 1991). A soft wall with a continuous force changes the velocity in proportion to a higher power of
d (`grazing_exponent`), for a spring and a damper d^(3/2). If a soft wall moves and has a separate damping, the
force jumps by j at the wall, and the acceleration within is a + j. If a + j > 0, the contact lasts
2 sqrt(2 a d) / (a + j) and changes the velocity by j times this duration.
"""

from typing import NamedTuple

import numpy as np

from .branches_from_grazing import distance_growth_rate, include_grazing_contacts
from .grazing_contact import (
    contact_durations_at,
    find_grazing_contacts,
    refine_turning_point,
    scene_wall_sides,
)
from .soft_wall_grazing import is_smooth_soft_wall


class GrazingJump(NamedTuple):
    """Velocity jump and depth of a contact beyond a grazing, to leading order.

    Attributes
    ----------
    side : int
        Side of the wall, -1 or 1.
    root : float
        Jump of the velocity divided by the square root of the depth. It is 0 if the jump is proportional to a higher
        power of the depth, and inf if the acceleration within a soft wall is not directed out of the wall.
    slope : float
        Derivative of the depth with respect to the parameter along the orbit that omits all grazing contacts.
    acceleration : float
        Acceleration of the mass away from the wall, relative to the wall.
    """

    side: int
    root: float
    slope: float
    acceleration: float


def grazing_jumps(scene, problem, z):
    """Compute the velocity jump and the depth of each contact beyond a grazing.

    Parameters
    ----------
    scene : Scene
        Scene at the point.
    problem : OrbitProblem
        Equations of the orbit.
    z : ndarray
        Unknowns at the grazing.

    Returns
    -------
    tuple of GrazingJump
        One entry for each grazing contact, in order along the orbit.
    """
    grazing_contacts = find_grazing_contacts(problem, z)
    reduced_problem, reduced_z, omitted_locations = include_grazing_contacts(
        problem, z, grazing_contacts, (False,) * len(grazing_contacts)
    )
    return tuple(
        omitted_grazing.depth
        for omitted_grazing in find_omitted_grazings(scene, reduced_problem, reduced_z, omitted_locations)
    )


class OmittedGrazing(NamedTuple):
    """Grazing contact with a wall, along an orbit that omits all grazing contacts.

    Attributes
    ----------
    row : int
        Row of the impact before the grazing contact.
    time_in_flight : float
        Time since the start of the flight after that impact.
    time : float
        Time since phase 0 of the drive.
    depth : GrazingJump
        Velocity jump and depth of the contact.
    """

    row: int
    time_in_flight: float
    time: float
    depth: GrazingJump


def find_omitted_grazings(scene, reduced_problem, reduced_z, omitted_locations):
    """Locate the `OmittedGrazing` of each contact that `include_grazing_contacts` omits."""
    tangent = reduced_problem.tangent(reduced_z)
    wall_sides, omitted_grazings, contact_durations = (
        scene_wall_sides(reduced_problem.scene),
        [],
        contact_durations_at(reduced_problem, reduced_z),
    )
    for row, wall_index, time_in_flight in omitted_locations:
        time_in_flight, _, approach_acceleration = refine_turning_point(
            reduced_problem, reduced_z, row, wall_index, time_in_flight
        )
        side, penetration_rate = (
            wall_sides[wall_index],
            -distance_growth_rate(reduced_problem, reduced_z, tangent, row, wall_index, time_in_flight),
        )
        depth_slope = penetration_rate / tangent[-1] if tangent[-1] else np.inf
        flight_start_time = reduced_z[row] + contact_durations[row] if len(reduced_problem.sequence.sides) else 0.0
        separation_acceleration, time = -float(approach_acceleration), float(flight_start_time + time_in_flight)
        grazing_jump = GrazingJump(
            side,
            _jump_coefficient(scene, side, separation_acceleration, time),
            float(depth_slope),
            separation_acceleration,
        )
        omitted_grazings.append(OmittedGrazing(int(row), float(time_in_flight), time, grazing_jump))
    return tuple(omitted_grazings)


def _jump_coefficient(scene, side, separation_acceleration, time):
    """Return the jump of the velocity divided by the square root of the depth."""
    wall = scene.left if side < 0 else scene.right
    if not wall.soft:
        restitution = scene.restitution if wall.restitution is None else wall.restitution
        return float((1.0 + float(restitution)) * np.sqrt(2.0 * separation_acceleration))
    if is_smooth_soft_wall(scene, side):
        return 0.0
    wall_motion_frequency = wall.motion.harmonic * float(scene.frequency)
    wall_velocity = (
        -float(wall.motion.amplitude)
        * wall_motion_frequency
        * np.sin(wall_motion_frequency * time + float(wall.motion.phase))
    )
    scene_damping = 0.0 if scene.force is not None else float(scene.damping)
    acceleration_jump = side * 2.0 * (float(wall.damping) - scene_damping) * wall_velocity
    acceleration_in_contact = separation_acceleration + acceleration_jump
    return (
        float(2.0 * np.sqrt(2.0 * separation_acceleration) * abs(acceleration_jump) / acceleration_in_contact)
        if acceleration_in_contact > 0
        else np.inf
    )
