"""Effect of contact phases on the flight after impacts, from the functions of one kind of contact."""

from typing import NamedTuple

import jax
import jax.numpy as jnp
from jaxtyping import Float

from continuation.array_type import Array

from ..compiled.lane_arithmetic import choose
from ..flight.motion_in_soft_wall import is_soft_side
from . import rigid
from .wall_at_contact import wall_derivatives


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


def complete_contact_map(exit_map, coeffs, sides, speed, contact_map, grazing_mask, min_contact_time):
    """Return the `orbits.contact_maps.ContactMap` of impacts including the contact phases.

    ``exit_map(coeffs, sides, is_soft, speed, contact_map, min_contact_time)`` returns the fields after contact phases,
    ((state, phasor, state_by_time, state_by_speed, exit_velocity, contact_time), free_flow). They are arbitrary where
    `is_soft` is false.
    """
    is_soft = is_soft_side(coeffs, sides)
    is_soft = is_soft if grazing_mask is None else is_soft & (grazing_mask == 0)
    soft_fields, free_flow = exit_map(coeffs, sides, is_soft, speed, contact_map, min_contact_time)
    rigid_fields = (
        contact_map.state,
        contact_map.phasor,
        contact_map.state_by_time,
        contact_map.state_by_speed,
        contact_map.exit_velocity,
        jnp.zeros_like(speed),
    )
    state, exit_phasor, state_by_time, state_by_speed, relative_exit_velocity, contact_time = jax.tree.map(
        lambda soft, rigid: jnp.where(is_soft, soft, rigid), soft_fields, rigid_fields
    )
    return contact_map._replace(
        contact_time=contact_time,
        state=state,
        phasor=exit_phasor,
        state_by_time=state_by_time,
        state_by_speed=state_by_speed,
        exit_velocity=relative_exit_velocity,
        is_soft=is_soft,
        free_flow=free_flow,
    )


def saltation(contact_matrix, coeffs, sides, contact_map, shear, acceleration_before, acceleration_after):
    """Return (matrix by rows, determinant) of impacts on rigid walls and of contact phases.

    ``contact_matrix(coeffs, sides, contact_map, acceleration_before, acceleration_after)`` returns those of contact
    phases.
    """
    shear = choose(contact_map.restitution < 0, 0.0, shear)  # a grazing of a soft wall has no effect
    accelerations = acceleration_before, acceleration_after
    rigid_result = rigid.saltation(coeffs, sides, contact_map, shear, *accelerations)
    soft_result = contact_matrix(coeffs, sides, contact_map, *accelerations)
    return jax.tree.map(lambda soft, rigid: jnp.where(contact_map.is_soft, soft, rigid), soft_result, rigid_result)


def exit_map(solve_contact_exit, coeffs, sides, is_soft, speed, contact_map, min_contact_time=None):
    """Return the fields of a `ContactMap` after contact phases, as for `complete_contact_map`.

    ``solve_contact_exit(coeffs, is_soft, sides, cosine, sine, speed)`` returns the `ContactExit`.
    """
    contact_exit = solve_contact_exit(coeffs, is_soft, sides, contact_map.cosine, contact_map.sine, speed)
    wall_position, wall_velocity, wall_acceleration = wall_derivatives(
        coeffs, sides, contact_exit.cosine, contact_exit.sine
    )
    relative_exit_velocity = sides * contact_exit.speed
    acceleration_after, _ = coeffs.flow.acceleration_and_jerk(
        coeffs, wall_position, wall_velocity + relative_exit_velocity, contact_exit.cosine, contact_exit.sine
    )
    exit_fields = (
        (wall_position, wall_velocity + relative_exit_velocity),
        (contact_exit.cosine, contact_exit.sine),
        *exit_state_derivatives(contact_exit, wall_acceleration, acceleration_after, sides),
        relative_exit_velocity,
        contact_exit.time,
    )
    return exit_fields, contact_exit.exit_derivatives


def exit_state_derivatives(contact_exit, wall_acceleration, acceleration_after, side):
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


def max_oscillation_rate(coeffs, contact_map, sides):
    """Return an estimate of the largest oscillation rate within soft walls, a scalar, from the durations of contact."""
    is_contact = contact_map.is_soft & (sides != 0) & (contact_map.contact_time > 0)
    return jnp.max(jnp.where(is_contact, jnp.pi / jnp.where(is_contact, contact_map.contact_time, 1.0), 0.0))


def max_contact_step(coeffs, contact_map, sides):
    """Return the longest step within contact phases, a scalar: the longest duration of a contact phase."""
    contact_times = jnp.where(contact_map.is_soft, jnp.maximum(contact_map.contact_time, 0.0), 0.0)
    return jnp.maximum(jnp.max(contact_times), jnp.finfo(contact_times.dtype).tiny)
