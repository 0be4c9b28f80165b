"""A stay within a soft wall beside a force of the user's own, as the equations of the impacts ask for it (`saltation`).

When and how fast the mass leaves is a smooth function of when and how fast it comes, also where that speed is zero; its
derivatives are by jvp along the steps of `pushed_stay`.
"""

from typing import NamedTuple

import jax
import jax.numpy as jnp
from jax import lax
from jaxtyping import Float

from continuation.array_type import Array

from ..compiled.compiler_hints import choose
from ..flight import flow
from ..flight.flows import flow_of
from ..flight.force_law_contact import entry_state, fly_contact_phase
from ..flight.force_law_flow import traverse_contact
from .wall_at_contact import wall_derivatives

MAX_PERIODS = 8.0  # drive periods that a stay is searched for
MIN_TIME_INSIDE = (
    1e-20  # drive periods, by which a time since an entry is longer: there the root of the depth has no slope
)
DERIVATIVE_ORDER = 3  # to which derivatives of its end are right


class ContactExit(NamedTuple):
    """time of the stay, nan where it does not end in `MAX_PERIODS`; speed: the rate of the depth at its end; the
    drive's cosine and sine there; and how time and speed change with the time of the entry and with its speed, by
    rows."""

    time: Float[Array, "*lanes"]
    speed: Float[Array, "*lanes"]
    cosine: Float[Array, "*lanes"]
    sine: Float[Array, "*lanes"]
    derivatives: tuple[Float[Array, "*lanes"], ...]


def solve_contact_exit(coeffs, is_soft, side, cosine, sine, speed):
    """The `ContactExit` of lanes that meet the soft wall on a side, which gives; benign in others."""
    side, speed = jnp.where(is_soft, side, 1.0), jnp.where(is_soft, speed, 1.0)
    max_time = jnp.where(is_soft, MAX_PERIODS * coeffs.period, 0.0)
    passage = traverse_contact(*lax.stop_gradient((coeffs, side, entry_state(speed, cosine, sine), max_time)))
    zero = jnp.zeros_like(speed)

    def exit_of_entry(delay, speed):
        start = entry_state(speed, *flow.rotate_by_angle(cosine, sine, coeffs.frequency * delay))
        contact_result = fly_contact_phase(coeffs, side, start, max_time, delay, DERIVATIVE_ORDER, passage)
        return delay + contact_result.duration, contact_result.depth_rate

    def directional_derivative(delay_change, speed_change):
        return jax.jvp(exit_of_entry, (zero, speed), (delay_change + zero, speed_change + zero))

    basis = jnp.eye(2, dtype=speed.dtype)  # both ways in one loop, which is compiled once
    (contact_time, exit_speed), ((time_by_time, time_by_speed), (speed_by_time, speed_by_speed)) = jax.vmap(
        directional_derivative, out_axes=(None, 0)
    )(basis[0], basis[1])
    contact_time = jnp.where(is_soft & ~passage.exits, jnp.nan, contact_time)
    return ContactExit(
        contact_time,
        exit_speed,
        *flow.rotate_by_angle(cosine, sine, coeffs.frequency * contact_time),
        (time_by_time, time_by_speed, speed_by_time, speed_by_speed),
    )


def exit_map(coeffs, sides, is_soft, speed, contact_map, min_contact_time=None):
    """((the `saltation.Meeting`'s state, phasor, by_time, by_speed, opening, stay), its free) where a wall gives."""
    contact_exit = solve_contact_exit(coeffs, is_soft, sides, contact_map.cosine, contact_map.sine, speed)
    wall_position, wall_velocity, wall_acceleration = wall_derivatives(
        coeffs, sides, contact_exit.cosine, contact_exit.sine
    )
    exit_velocity = sides * contact_exit.speed
    acceleration_after, _ = flow_of(coeffs).accelerations(
        coeffs, wall_position, wall_velocity + exit_velocity, contact_exit.cosine, contact_exit.sine
    )
    exit_fields = (
        (wall_position, wall_velocity + exit_velocity),
        (contact_exit.cosine, contact_exit.sine),
        *_exit_state_derivatives(contact_exit, wall_acceleration, acceleration_after, sides),
        exit_velocity,
        contact_exit.time,
    )
    return exit_fields, contact_exit.derivatives


def _exit_state_derivatives(contact_exit, wall_acceleration, acceleration_after, side):
    """(how (x, v) change with the time of the entry, with its speed) where the flight after a stay begins, at a fixed
    time; wall_acceleration, acceleration_after: the accelerations of the wall and of the free mass there."""
    time_by_time, time_by_speed, speed_by_time, speed_by_speed = contact_exit.derivatives
    state_by_time = (
        -side * contact_exit.speed * time_by_time,
        (wall_acceleration - acceleration_after) * time_by_time + side * speed_by_time,
    )
    return state_by_time, (
        -side * contact_exit.speed * time_by_speed,
        (wall_acceleration - acceleration_after) * time_by_speed + side * speed_by_speed,
    )


def contact_matrix(coeffs, sides, contact_map, acceleration_before, acceleration_after):
    """(rows, determinant) of what stays do to (x, v) at a fixed time; acceleration_before, acceleration_after: the
    accelerations of the free mass."""
    _, _, wall_acceleration = wall_derivatives(coeffs, sides, *contact_map.phasor)
    time_by_time, time_by_speed, speed_by_time, speed_by_speed = contact_map.free_flow
    acceleration_before, acceleration_after = (
        sides * (acceleration_before - contact_map.wall_acceleration),
        sides * (acceleration_after - wall_acceleration),
    )
    entry_speed, exit_speed = sides * contact_map.approach_velocity, sides * contact_map.exit_velocity
    speed_ratio = jnp.where(entry_speed == 0, -1.0, exit_speed / jnp.where(entry_speed == 0, 1.0, entry_speed))
    time_change, speed_change = (
        time_by_time + acceleration_before * time_by_speed,
        speed_by_time + acceleration_before * speed_by_speed,
    )
    shear = jnp.where(
        entry_speed == 0,
        0.0,
        (acceleration_after * time_change - speed_change) / jnp.where(entry_speed == 0, 1.0, entry_speed),
    )
    rows = (
        speed_ratio * time_change,
        -exit_speed * time_by_speed,
        shear,
        speed_by_speed - acceleration_after * time_by_speed,
    )
    return rows, speed_ratio * (time_by_time * speed_by_speed - time_by_speed * speed_by_time)


def state_in_contact(coeffs, contact_map, sides, row, elapsed_time, free_state):
    """(x, v) a time after the meetings in rows row: within the wall during the stay, else the state given."""
    is_inside = contact_map.is_soft[row] & (elapsed_time < contact_map.contact_time[row])
    side, time_inside = sides[row], jnp.where(is_inside, elapsed_time, 0.0)
    entry = side, contact_map.cosine[row], contact_map.sine[row], side * contact_map.approach_velocity[row]
    depth, rate = depth_since_entry(coeffs, is_inside, *entry, time_inside)
    wall_position, wall_velocity, _ = wall_derivatives(
        coeffs, side, *flow.rotate_by_angle(*entry[1:3], coeffs.frequency * time_inside)
    )
    return choose(is_inside, wall_position + side * depth, free_state[0]), choose(
        is_inside, wall_velocity + side * rate, free_state[1]
    )


def depth_since_entry(coeffs, is_soft, side, cosine, sine, speed, elapsed_time):
    """(depth, its rate) so long after the entry of lanes that are still within the wall then; benign in others."""
    side, speed = jnp.where(is_soft, side, 1.0), jnp.where(is_soft, speed, 1.0)
    time_inside = jnp.where(is_soft, elapsed_time + MIN_TIME_INSIDE * coeffs.period, 0.0)
    contact_result = fly_contact_phase(
        coeffs, side, entry_state(speed, cosine, sine), time_inside, 0.0 * time_inside, 1
    )
    return contact_result.depth, contact_result.depth_rate


def max_oscillation_rate(coeffs, contact_map, sides):
    """How fast the mass swings within soft walls at most, a scalar: by how long it stays."""
    is_contact = contact_map.is_soft & (sides != 0) & (contact_map.contact_time > 0)
    return jnp.max(jnp.where(is_contact, jnp.pi / jnp.where(is_contact, contact_map.contact_time, 1.0), 0.0))


def max_contact_step(coeffs, contact_map, sides):
    """How far stays can be followed in one piece, a scalar."""
    contact_times = jnp.where(contact_map.is_soft, jnp.maximum(contact_map.contact_time, 0.0), 0.0)
    return jnp.maximum(jnp.max(contact_times), jnp.finfo(contact_times.dtype).tiny)
