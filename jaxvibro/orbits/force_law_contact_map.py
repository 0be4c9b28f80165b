"""Contact phase within a soft wall under a user-defined force, for the equations of the impacts (`contact_maps`).

Time and speed of the exit are smooth functions of time and speed of the entry, also where the speed is zero. Their
derivatives are forward-mode derivatives of the steps of `force_law_contact.fly_contact_phase`.
"""

from typing import NamedTuple

import jax
import jax.numpy as jnp
from jax import lax
from jaxtyping import Float

from continuation.array_type import Array

from ..compiled.lane_arithmetic import choose
from ..flight import flow
from ..flight.flow_dispatch import flow_of
from ..flight.force_law_contact import entry_state, fly_contact_phase
from ..flight.force_law_passage import traverse_contact
from .wall_at_contact import wall_derivatives

MAX_PERIODS = 8.0  # largest duration of a contact phase in drive periods
MIN_TIME_INSIDE = 1e-20  # drive periods, added to times since the entry, where the root of the depth has no slope
DERIVATIVE_ORDER = 3  # order up to which derivatives of the exit are exact


class ContactExit(NamedTuple):
    """Exit from a contact phase.

    Attributes
    ----------
    time : Array
        Duration of the phase; nan if the phase does not end within `MAX_PERIODS`.
    speed : Array
        Time derivative of the depth at the exit.
    cosine, sine : Array
        Cosine and sine of the drive's phase at the exit.
    exit_derivatives : tuple of Array
        Derivatives of (time, speed) of the exit with respect to (time, speed) of the entry, by rows.
    """

    time: Float[Array, "*lanes"]
    speed: Float[Array, "*lanes"]
    cosine: Float[Array, "*lanes"]
    sine: Float[Array, "*lanes"]
    exit_derivatives: tuple[Float[Array, "*lanes"], ...]


def solve_contact_exit(coeffs, is_soft, side, cosine, sine, speed):
    """Return the `ContactExit` of lanes that enter a soft wall; arbitrary finite values where `is_soft` is false."""
    side, speed = jnp.where(is_soft, side, 1.0), jnp.where(is_soft, speed, 1.0)
    max_time = jnp.where(is_soft, MAX_PERIODS * coeffs.period, 0.0)
    passage_record = traverse_contact(*lax.stop_gradient((coeffs, side, entry_state(speed, cosine, sine), max_time)))
    zero = jnp.zeros_like(speed)

    def exit_of_entry(entry_delay, speed):
        contact_start = entry_state(speed, *flow.rotate_phasor_by_angle(cosine, sine, coeffs.frequency * entry_delay))
        contact_result = fly_contact_phase(
            coeffs, side, contact_start, max_time, entry_delay, DERIVATIVE_ORDER, passage_record
        )
        return entry_delay + contact_result.duration, contact_result.depth_rate

    def directional_derivative(delay_change, speed_change):
        return jax.jvp(exit_of_entry, (zero, speed), (delay_change + zero, speed_change + zero))

    unit_directions = jnp.eye(2, dtype=speed.dtype)  # both directions in one loop, which compiles once
    (contact_time, exit_speed), ((time_by_time, time_by_speed), (speed_by_time, speed_by_speed)) = jax.vmap(
        directional_derivative, out_axes=(None, 0)
    )(unit_directions[0], unit_directions[1])
    contact_time = jnp.where(is_soft & ~passage_record.has_exited, jnp.nan, contact_time)
    return ContactExit(
        contact_time,
        exit_speed,
        *flow.rotate_phasor_by_angle(cosine, sine, coeffs.frequency * contact_time),
        (time_by_time, time_by_speed, speed_by_time, speed_by_speed),
    )


def exit_map(coeffs, sides, is_soft, speed, contact_map, min_contact_time=None):
    """Return the fields of a `ContactMap` after contact phases.

    The result is ((state, phasor, state_by_time, state_by_speed, exit_velocity, contact_time), free_flow).
    """
    contact_exit = solve_contact_exit(coeffs, is_soft, sides, contact_map.cosine, contact_map.sine, speed)
    wall_position, wall_velocity, wall_acceleration = wall_derivatives(
        coeffs, sides, contact_exit.cosine, contact_exit.sine
    )
    relative_exit_velocity = sides * contact_exit.speed
    acceleration_after, _ = flow_of(coeffs).acceleration_and_jerk(
        coeffs, wall_position, wall_velocity + relative_exit_velocity, contact_exit.cosine, contact_exit.sine
    )
    exit_fields = (
        (wall_position, wall_velocity + relative_exit_velocity),
        (contact_exit.cosine, contact_exit.sine),
        *_exit_state_derivatives(contact_exit, wall_acceleration, acceleration_after, sides),
        relative_exit_velocity,
        contact_exit.time,
    )
    return exit_fields, contact_exit.exit_derivatives


def _exit_state_derivatives(contact_exit, wall_acceleration, acceleration_after, side):
    """Return the derivatives of (x, v) with respect to the time and the speed of the entry.

    The derivatives are taken at a fixed start of the next flight. `wall_acceleration` and `acceleration_after` are the
    accelerations of the wall and of the free mass at this start.
    """
    time_by_time, time_by_speed, speed_by_time, speed_by_speed = contact_exit.exit_derivatives
    state_by_time = (
        -side * contact_exit.speed * time_by_time,
        (wall_acceleration - acceleration_after) * time_by_time + side * speed_by_time,
    )
    return state_by_time, (
        -side * contact_exit.speed * time_by_speed,
        (wall_acceleration - acceleration_after) * time_by_speed + side * speed_by_speed,
    )


def contact_matrix(coeffs, sides, contact_map, acceleration_before, acceleration_after):
    """Return (matrix by rows, determinant) of contact phases for (x, v) at a fixed time.

    The accelerations are those of the free mass.
    """
    _, _, wall_acceleration = wall_derivatives(coeffs, sides, *contact_map.phasor)
    time_by_time, time_by_speed, speed_by_time, speed_by_speed = contact_map.free_flow
    acceleration_before, acceleration_after = (
        sides * (acceleration_before - contact_map.wall_acceleration),
        sides * (acceleration_after - wall_acceleration),
    )
    entry_speed, exit_speed = sides * contact_map.approach_velocity, sides * contact_map.exit_velocity
    speed_ratio = jnp.where(entry_speed == 0, -1.0, exit_speed / jnp.where(entry_speed == 0, 1.0, entry_speed))
    exit_time_by_delay, exit_speed_by_delay = (
        time_by_time + acceleration_before * time_by_speed,
        speed_by_time + acceleration_before * speed_by_speed,
    )
    velocity_by_position = jnp.where(
        entry_speed == 0,
        0.0,
        (acceleration_after * exit_time_by_delay - exit_speed_by_delay) / jnp.where(entry_speed == 0, 1.0, entry_speed),
    )
    matrix_entries = (
        speed_ratio * exit_time_by_delay,
        -exit_speed * time_by_speed,
        velocity_by_position,
        speed_by_speed - acceleration_after * time_by_speed,
    )
    return matrix_entries, speed_ratio * (time_by_time * speed_by_speed - time_by_speed * speed_by_time)


def state_in_contact(coeffs, contact_map, sides, row_indices, elapsed_time, free_state):
    """Return (x, v) some time after the impacts in rows `row_indices`, or `free_state` outside contact phases."""
    is_inside = contact_map.is_soft[row_indices] & (elapsed_time < contact_map.contact_time[row_indices])
    side, time_inside = sides[row_indices], jnp.where(is_inside, elapsed_time, 0.0)
    entry_values = (
        side,
        contact_map.cosine[row_indices],
        contact_map.sine[row_indices],
        side * contact_map.approach_velocity[row_indices],
    )
    depth, depth_rate = depth_since_entry(coeffs, is_inside, *entry_values, time_inside)
    wall_position, wall_velocity, _ = wall_derivatives(
        coeffs, side, *flow.rotate_phasor_by_angle(*entry_values[1:3], coeffs.frequency * time_inside)
    )
    return choose(is_inside, wall_position + side * depth, free_state[0]), choose(
        is_inside, wall_velocity + side * depth_rate, free_state[1]
    )


def depth_since_entry(coeffs, is_soft, side, cosine, sine, speed, elapsed_time):
    """Return (depth, rate of the depth) at a time since the entry; arbitrary finite values where `is_soft` is false."""
    side, speed = jnp.where(is_soft, side, 1.0), jnp.where(is_soft, speed, 1.0)
    time_inside = jnp.where(is_soft, elapsed_time + MIN_TIME_INSIDE * coeffs.period, 0.0)
    contact_result = fly_contact_phase(
        coeffs, side, entry_state(speed, cosine, sine), time_inside, 0.0 * time_inside, 1
    )
    return contact_result.depth, contact_result.depth_rate


def max_oscillation_rate(coeffs, contact_map, sides):
    """Return an estimate of the largest oscillation rate within soft walls, a scalar, from the durations of contact."""
    is_contact = contact_map.is_soft & (sides != 0) & (contact_map.contact_time > 0)
    return jnp.max(jnp.where(is_contact, jnp.pi / jnp.where(is_contact, contact_map.contact_time, 1.0), 0.0))


def max_contact_step(coeffs, contact_map, sides):
    """Return the longest step within contact phases, a scalar: the longest duration of a contact phase."""
    contact_times = jnp.where(contact_map.is_soft, jnp.maximum(contact_map.contact_time, 0.0), 0.0)
    return jnp.maximum(jnp.max(contact_times), jnp.finfo(contact_times.dtype).tiny)
