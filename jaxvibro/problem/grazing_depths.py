"""How deep a contact is beyond a grazing: on the orbit that leaves it out, behind the wall that is touched.

A contact that would be d deep meets a rigid wall with the speed sqrt(2 a d), a the acceleration away from the wall at
the grazing, and its impact changes the velocity by (1 + R) sqrt(2 a d): by a root, where all else changes smoothly
(Nordmark, J. Sound Vib. 145, 279, 1991). A soft wall changes the velocity by d^(3/2): it has no root, unless it moves
and has a damping of its own. Then the force has a jump at the wall, the acceleration is a + j within, and the contact
of 2 sqrt(2 a d) / (a + j) changes the velocity by j times that.
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
    """Of one touch of a wall. side; root: by how much the velocity jumps, over the root of the depth, 0 where that goes
    with a higher power, inf where a soft wall does not let go at once; slope: how the depth grows with the parameter
    along the orbit that leaves all touches out; acceleration: away from the wall, relative to it."""

    side: int
    root: float
    slope: float
    acceleration: float


def grazing_depths(scene, problem, z, length_scale):
    """The `Depth`s at a grazing, in the order of its touches along the orbit; scene: at the point."""
    grazing_contacts = find_grazing_contacts(problem, z, length_scale)
    reduced_problem, reduced_z, omitted = with_grazing_contacts(
        problem, z, grazing_contacts, (False,) * len(grazing_contacts)
    )
    return tuple(
        omitted_grazing.depth
        for omitted_grazing in find_omitted_grazings(scene, reduced_problem, reduced_z, omitted, length_scale)
    )


class OmittedGrazing(NamedTuple):
    """Where an orbit that leaves all touches out touches a wall. row: of the impact before; time_in_flight: the time
    since the flight after that began; time: since the drive was at phase 0; depth: its `Depth`."""

    row: int
    time_in_flight: float
    time: float
    depth: Depth


def find_omitted_grazings(scene, reduced_problem, reduced_z, omitted, length_scale):
    """The `OmittedGrazing`es of an orbit that leaves touches out, as `grazing.with_touches` gives it and them."""
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
