"""What an impact, or a stay within a soft wall, makes of a mass that comes to a wall at a time with a speed.

Both are the same to the equations of the impacts (`impact_equations`): from where and when the next flight begins, and
how that changes with the impact's own time and speed. A stay takes time; it is as smooth as an impact where its speed
is zero.
"""

from typing import NamedTuple

import jax
import jax.numpy as jnp
from jaxtyping import Bool, Float

from continuation.array_type import Array

from ..compiled.compiler_hints import choose
from ..flight import soft_contact
from ..flight.coefficients import ContactLaw
from ..flight.flows import flow_of
from . import force_law_contact_map, linear_contact_map
from .wall_at_contact import wall_derivatives

CONTACT_MAP_MODULES = {
    ContactLaw.RIGID: None,
    ContactLaw.LINEAR: linear_contact_map,
    ContactLaw.FORCE_LAW: force_law_contact_map,
}


class ContactMap(NamedTuple):
    """Of each impact: the drive's cosine and sine; the wall's position, velocity and acceleration; R and the velocity
    against the wall; the acceleration before. And of the start of the flight that follows: the stay before it, None
    where all walls are rigid; (x, v); the drive's (cosine, sine); how (x, v) change with the impact's time and speed,
    the flight's start being kept; the velocity against the wall. is_soft: whether it is a stay, None where all walls
    are rigid; free_flow: the free flow's matrix over it, beside a force of the user's own
    `pushed_meeting.Leaving.slopes`."""

    cosine: Float[Array, "*shape"]
    sine: Float[Array, "*shape"]
    wall_position: Float[Array, "*shape"]
    wall_velocity: Float[Array, "*shape"]
    wall_acceleration: Float[Array, "*shape"]
    restitution: Float[Array, "*shape"]
    approach_velocity: Float[Array, "*shape"]
    contact_time: Float[Array, "*shape"] | None
    state: tuple[Float[Array, "*shape"], Float[Array, "*shape"]]
    phasor: tuple[Float[Array, "*shape"], Float[Array, "*shape"]]
    state_by_time: tuple[Float[Array, "*shape"], Float[Array, "*shape"]]
    state_by_speed: tuple[Float[Array, "*shape"], Float[Array, "*shape"]]
    exit_velocity: Float[Array, "*shape"]
    is_soft: Bool[Array, "*shape"] | None = None
    free_flow: tuple[Float[Array, "*shape"], ...] | None = None


def evaluate_contact_map(coeffs, sides, cosine, sine, speed, grazing=None, min_contact_time=None):
    """The `ContactMap` of impacts on these sides, 0: of none, any numbers; arrays of one shape. grazing,
    min_contact_time: as of a `Cycle`, the latter beside no force of the user's own."""
    wall_position, wall_velocity, wall_acceleration = wall_derivatives(coeffs, sides, cosine, sine)
    approach_velocity, zero = sides * speed, jnp.zeros_like(speed)
    restitution = soft_contact.restitution_of(coeffs, sides) + zero
    velocity_after = wall_velocity - restitution * approach_velocity
    acceleration_after, _ = flow_of(coeffs).acceleration_and_jerk(coeffs, wall_position, velocity_after, cosine, sine)
    state_by_time, state_by_speed = (
        (restitution * approach_velocity, wall_acceleration - acceleration_after),
        (zero, -restitution * sides),
    )
    contact_map = ContactMap(
        cosine,
        sine,
        wall_position,
        wall_velocity,
        wall_acceleration,
        restitution,
        approach_velocity,
        None,
        (wall_position, velocity_after),
        (cosine, sine),
        state_by_time,
        state_by_speed,
        velocity_after - wall_velocity,
    )
    contact_module = CONTACT_MAP_MODULES[coeffs.contact_law]
    if contact_module is None:
        return contact_map
    is_soft = soft_contact.is_soft_side(coeffs, sides)
    is_soft = is_soft if grazing is None else is_soft & (grazing == 0)
    soft, free_flow = contact_module.exit_map(coeffs, sides, is_soft, speed, contact_map, min_contact_time)
    rigid = (
        contact_map.state,
        contact_map.phasor,
        contact_map.state_by_time,
        contact_map.state_by_speed,
        contact_map.exit_velocity,
        zero,
    )
    state, phasor, state_by_time, state_by_speed, exit_velocity, contact_time = jax.tree.map(
        lambda soft, rigid: jnp.where(is_soft, soft, rigid), soft, rigid
    )
    return contact_map._replace(
        contact_time=contact_time,
        state=state,
        phasor=phasor,
        state_by_time=state_by_time,
        state_by_speed=state_by_speed,
        exit_velocity=exit_velocity,
        is_soft=is_soft,
        free_flow=free_flow,
    )


def saltation_matrices(coeffs, contact_map, sides):
    """(Q by rows, det Q) of each meeting (paper, (35)), for a stay S P S, S the saltation where the damping jumps."""
    contact_module, accelerations = CONTACT_MAP_MODULES[coeffs.contact_law], flow_of(coeffs).acceleration_and_jerk
    acceleration_before, _ = accelerations(
        coeffs,
        contact_map.wall_position,
        contact_map.wall_velocity + contact_map.approach_velocity,
        contact_map.cosine,
        contact_map.sine,
    )
    acceleration_after, _ = accelerations(coeffs, *contact_map.state, *contact_map.phasor)
    shear = (
        acceleration_after
        + contact_map.restitution * acceleration_before
        - (1.0 + contact_map.restitution) * contact_map.wall_acceleration
    ) / contact_map.approach_velocity
    if contact_module is not None:
        shear = choose(contact_map.restitution < 0, 0.0, shear)  # a touch does nothing
    rigid = (
        (-contact_map.restitution, jnp.zeros_like(shear), shear, -contact_map.restitution),
        contact_map.restitution * contact_map.restitution,
    )
    if contact_module is None:
        return rigid
    soft = contact_module.contact_matrix(coeffs, sides, contact_map, acceleration_before, acceleration_after)
    return jax.tree.map(lambda soft, rigid: jnp.where(contact_map.is_soft, soft, rigid), soft, rigid)


def state_in_contact(coeffs, contact_map, sides, row, elapsed_time, free_state):
    """(x, v) a time after the meetings in rows row: within the wall during the stay, else the state given."""
    return CONTACT_MAP_MODULES[coeffs.contact_law].state_in_contact(
        coeffs, contact_map, sides, row, elapsed_time, free_state
    )


def max_oscillation_rate(coeffs, contact_map, sides):
    """How fast the mass swings within soft walls at most, a scalar."""
    return CONTACT_MAP_MODULES[coeffs.contact_law].max_oscillation_rate(coeffs, contact_map, sides)


def max_contact_step(coeffs, contact_map, sides):
    """How far stays can be followed in one piece, a scalar."""
    return CONTACT_MAP_MODULES[coeffs.contact_law].max_contact_step(coeffs, contact_map, sides)
