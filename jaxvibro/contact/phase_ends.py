"""Continue a path, a replay and a matrix after a contact phase, from the depth and its rate at the end of the phase.

These functions do not depend on the law of the wall. A law computes the end of the phase.
"""

from typing import NamedTuple

import jax
import jax.numpy as jnp
from jax import lax
from jaxtyping import Bool, Float

from ..compiled.lane_arithmetic import choose, value_and_gradient
from ..flight import flow, taylor_polynomials
from ..flight.flight_state import make_slow_motion
from ..flight.motion_in_soft_wall import is_inside_soft_wall
from ..flight.taylor_polynomials import ExpansionPoint
from ..flight.wall_motion import subtract_optional, wall_jet_on_side
from ..scene.state import Contact
from .contact_duration import multiply_2x2_matrices
from .monodromy_state import MonodromyState, add_contact_time


class ContactResult(NamedTuple):
    """Result of a contact phase inside a soft wall.

    Attributes
    ----------
    has_exited : array of bool
        True if the mass exits from the wall within the available time.
    duration : array
        Contact duration, or the available time if the mass does not exit.
    depth : array
        Depth at the end.
    depth_rate : array
        Rate of the depth at the end.
    """

    has_exited: Bool[jax.Array, "*lanes"]
    duration: Float[jax.Array, "*lanes"]
    depth: Float[jax.Array, "*lanes"]
    depth_rate: Float[jax.Array, "*lanes"]


class ContactPhaseEffect(NamedTuple):
    """Effect of a contact phase on the state of a lane.

    Attributes
    ----------
    time : array
        Duration of the contact phase.
    x, v : array
        Position and velocity at the end.
    cosine, sine : array
        Cosine and sine of the drive phase at the end.
    matrix : tuple of array
        Entries, by rows, of the derivative of the final (x, v) with respect to the initial (x, v).
    """

    time: Float[jax.Array, "*lanes"]
    x: Float[jax.Array, "*lanes"]
    v: Float[jax.Array, "*lanes"]
    cosine: Float[jax.Array, "*lanes"]
    sine: Float[jax.Array, "*lanes"]
    matrix: tuple[Float[jax.Array, "*lanes"], ...]


def side_of_contact(contact_code):
    """Return the side of a contact, 1 without one."""
    return choose(contact_code < 0, lax.full_like(contact_code, -1.0), 1.0)


def wall_position_velocity(coeffs, side, cosine, sine):
    """Return (position, velocity) of the wall on a side."""
    wall_position, wall_velocity = wall_jet_on_side(coeffs, side, cosine, sine, 1)
    return wall_position, jnp.zeros_like(cosine) if wall_velocity is None else wall_velocity


def path_after_contact(coeffs, path, side, has_exited, depth, depth_rate, cosine, sine):
    """Return the path at the end of contact phases, with its remaining time unchanged.

    Lanes that have exited are on the wall and move away from it. Other lanes remain inside the wall, where x and v are
    relative to it.
    """
    wall_position, wall_velocity = wall_position_velocity(coeffs, side, cosine, sine)
    relative_position, relative_velocity = side * depth, side * depth_rate
    x, v = (
        choose(has_exited, wall_position, relative_position),
        choose(has_exited, wall_velocity + relative_velocity, relative_velocity),
    )
    return path._replace(
        x=x,
        x_low_part=lax.full_like(x, 0.0),
        v=v,
        motion=make_slow_motion(coeffs, x, v, cosine, sine),
        contact=side * choose(has_exited, lax.full_like(side, float(Contact.LANDED)), float(Contact.WITHIN)),
    )


def entry_rate(coeffs, current_state, side, entry_delay, order):
    """Return the rate of the depth of lanes that enter a wall after a delay, with derivatives up to an order."""
    _, wall_velocity = taylor_polynomials.wall_state(
        taylor_polynomials.wall_derivatives(coeffs, current_state, side, order), entry_delay, order
    )
    velocity = taylor_polynomials.evaluate_taylor(
        coeffs.flow.jet_at_point(coeffs, current_state, order)[1:], entry_delay, order
    )
    return side * (velocity - wall_velocity)


def point_after_contact(coeffs, current_state, side, contact_result, delay, time_remaining, order):
    """Return the `ExpansionPoint` at the end of contact phases, for a replay.

    Parameters
    ----------
    coeffs : FlowCoefficients
        Coefficients of the scene.
    current_state : ExpansionPoint
        State at the start of the phases.
    side : array
        Side of the wall, -1 or 1.
    contact_result : ContactResult
        End of the phases, with derivatives up to `order`.
    delay : array
        Delay of the start, 0 with derivatives.
    time_remaining : array
        Time to the end of the path, a constant.
    order : int
        Order of the derivatives.

    Returns
    -------
    ExpansionPoint
        State at the exit, transported to a constant time, or at the end of the path.
    """
    contact_duration = choose(contact_result.has_exited, lax.stop_gradient(contact_result.duration), time_remaining)
    delay = choose(contact_result.has_exited, delay + (contact_result.duration - contact_duration), 0.0)
    drive_phasor = flow.rotate_phasor_by_angle(
        current_state.cosine, current_state.sine, coeffs.frequency * contact_duration
    )
    end_point = ExpansionPoint(current_state.x, current_state.v, *drive_phasor, current_state.time + contact_duration)
    wall_position, wall_velocity = taylor_polynomials.wall_state(
        taylor_polynomials.wall_derivatives(coeffs, end_point, side, order), delay, order
    )
    x, v = wall_position + side * contact_result.depth, wall_velocity + side * contact_result.depth_rate
    xv_after_exit = coeffs.flow.state_before_delay(coeffs, end_point, wall_position, v, delay, order)
    x, v = (
        choose(contact_result.has_exited, *free_and_contact_value)
        for free_and_contact_value in zip(xv_after_exit, (x, v), strict=True)
    )
    return end_point._replace(x=x, v=v)


def effect_of_phase(coeffs, side, has_exited, end_after_perturbation, cosine, sine):
    """Compute the `ContactPhaseEffect` of contact phases.

    ``end_after_perturbation(depth_change, depth_rate_change)`` returns (time, depth, depth rate) at the end of the
    phase after changes of the initial values. The acceleration outside the wall converts a change of the time of the
    exit into a change at a fixed time (saltation matrix).
    """
    zero = jnp.zeros_like(cosine)
    (contact_duration, end_depth, end_depth_rate), end_tangents = value_and_gradient(
        end_after_perturbation, (zero, zero)
    )
    drive_phasor = flow.rotate_phasor_by_angle(cosine, sine, coeffs.frequency * contact_duration)
    exit_inward_accel = force_free_acceleration(coeffs, side, end_depth_rate, *drive_phasor)
    time_tangent, depth_tangent, depth_rate_tangent = end_tangents
    depth_matrix_row = choose(has_exited, -end_depth_rate * time_tangent, depth_tangent)
    depth_rate_matrix_row = choose(
        has_exited, depth_rate_tangent - exit_inward_accel * time_tangent, depth_rate_tangent
    )
    wall_position, wall_velocity = wall_position_velocity(coeffs, side, *drive_phasor)
    matrix = depth_matrix_row[0], depth_matrix_row[1], depth_rate_matrix_row[0], depth_rate_matrix_row[1]
    return ContactPhaseEffect(
        contact_duration, wall_position + side * end_depth, wall_velocity + side * end_depth_rate, *drive_phasor, matrix
    )


def force_free_acceleration(coeffs, side, depth_rate, cosine, sine):
    """Compute the acceleration of a mass at the wall into the wall, relative to the wall, without contact force."""
    wall_position, wall_velocity, wall_acceleration = wall_jet_on_side(coeffs, side, cosine, sine, 2)
    v = side * depth_rate if wall_velocity is None else wall_velocity + side * depth_rate
    acceleration, _ = coeffs.flow.acceleration_and_jerk(coeffs, wall_position + 0.0 * depth_rate, v, cosine, sine)
    return side * subtract_optional(acceleration, wall_acceleration)


def propagate_contact_phase(phase_effect, coeffs, relative_state, is_entry_from_outside, path_end, current_state):
    """Return the `MonodromyState` after the contact phase of lanes within a wall, at the exit or at the
    `EndTimeAndContact`.

    ``phase_effect(coeffs, relative_state, is_entry_from_outside, path_end, current_state)`` returns the
    `ContactPhaseEffect`. `relative_state` is (contact code, displacement, velocity) relative to the wall.
    `is_entry_from_outside` is true for lanes that have just entered the wall.
    """
    is_within_wall = is_inside_soft_wall(relative_state[0])
    effect = phase_effect(coeffs, relative_state, is_entry_from_outside, path_end, current_state)
    total_contact_times = add_contact_time(
        coeffs, relative_state[0], choose(is_within_wall, effect.time, 0.0), current_state.total_contact_times
    )
    new_state = MonodromyState(
        current_state.time + effect.time,
        (effect.x, effect.v),
        effect.cosine,
        effect.sine,
        multiply_2x2_matrices(effect.matrix, current_state.matrix),
        total_contact_times,
    )
    return jax.tree.map(lambda new, old: choose(is_within_wall, new, old), new_state, current_state)
