"""Contact phase within a soft wall under a user-defined force, for the equations of the impacts (`contact_maps`).

Time and speed of the exit are smooth functions of time and speed of the entry, also where the speed is zero. Their
derivatives are forward-mode derivatives of the steps of `force_law_phase.fly_contact_phase`.
"""

import jax
import jax.numpy as jnp
from jax import lax

from ..compiled.lane_arithmetic import choose
from ..flight import flow
from ..flight.force_law_passage import traverse_contact
from .force_law_phase import entry_state, fly_contact_phase
from .phase_maps import ContactExit
from .wall_at_contact import wall_derivatives

MAX_PERIODS = 8.0  # largest duration of a contact phase in drive periods
MIN_TIME_INSIDE = 1e-20  # drive periods, added to times since the entry, where the root of the depth has no slope
DERIVATIVE_ORDER = 3  # order up to which derivatives of the exit are exact


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
