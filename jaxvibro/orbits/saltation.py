"""Contact map: the effect of an impact, or a contact phase, as a function of its time and speed.

The equations of the impacts (`impact_equations`) treat both alike: they need the start of the next flight and its
derivative with respect to the time and the speed of the impact. A contact phase takes time. It is as smooth as an
impact where its speed is zero.
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
    """Effect of impacts and contact phases on the flight that follows.

    Attributes
    ----------
    cosine, sine : Array
        Cosine and sine of the drive's phase at the impact.
    wall_position, wall_velocity, wall_acceleration : Array
        Motion of the wall at the impact.
    restitution : Array
        Coefficient of restitution R.
    approach_velocity : Array
        Velocity before the impact relative to the wall.
    contact_time : Array or None
        Duration of the contact phase; None if all walls are rigid.
    state : tuple of Array
        (x, v) at the start of the next flight.
    phasor : tuple of Array
        (cosine, sine) of the drive's phase there.
    state_by_time, state_by_speed : tuple of Array
        Derivatives of (x, v) with respect to the time and the speed of the impact, at a fixed start of the next flight.
    exit_velocity : Array
        Velocity at the start of the next flight relative to the wall.
    is_soft : Array of bool or None
        True for contact phases; None if all walls are rigid.
    free_flow : tuple of Array or None
        Matrix of the free flow over the contact phase. Under a user-defined force it is
        `force_law_contact_map.ContactExit.derivatives`.
    """

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
    """Evaluate the contact map of impacts.

    Parameters
    ----------
    coeffs : FlowCoefficients
        Coefficients of the scene.
    sides : Array
        Sides of the impacts; 0 for an empty row, whose other entries are arbitrary.
    cosine, sine : Array
        Cosine and sine of the drive's phase at the impacts.
    speed : Array
        Speeds relative to the walls.
    grazing : Array, optional
        As in `ImpactSequence`.
    min_contact_time : Array, optional
        As in `ImpactSequence`; not used under a user-defined force.

    Returns
    -------
    ContactMap
        Effect of the impacts, of the shape of the arguments.
    """
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
    """Compute the saltation matrices of impacts (paper, (35)).

    For a contact phase the matrix is S P S, where S is the saltation matrix of the jump of the damping.

    Parameters
    ----------
    coeffs : FlowCoefficients
        Coefficients of the scene.
    contact_map : ContactMap
        Effect of the impacts.
    sides : Array
        Sides of the impacts.

    Returns
    -------
    matrix : tuple of Array
        Entries of Q by rows.
    determinant : Array
        Determinants of Q.
    """
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
        shear = choose(contact_map.restitution < 0, 0.0, shear)  # a grazing of a soft wall has no effect
    rigid = (
        (-contact_map.restitution, jnp.zeros_like(shear), shear, -contact_map.restitution),
        contact_map.restitution * contact_map.restitution,
    )
    if contact_module is None:
        return rigid
    soft = contact_module.contact_matrix(coeffs, sides, contact_map, acceleration_before, acceleration_after)
    return jax.tree.map(lambda soft, rigid: jnp.where(contact_map.is_soft, soft, rigid), soft, rigid)


def state_in_contact(coeffs, contact_map, sides, row, elapsed_time, free_state):
    """Return (x, v) some time after the impacts in rows `row`; it is `free_state` outside contact phases."""
    return CONTACT_MAP_MODULES[coeffs.contact_law].state_in_contact(
        coeffs, contact_map, sides, row, elapsed_time, free_state
    )


def max_oscillation_rate(coeffs, contact_map, sides):
    """Return an upper bound of the oscillation rate within soft walls.

    Parameters
    ----------
    coeffs : FlowCoefficients
        Coefficients of the scene.
    contact_map : ContactMap
        Effect of the impacts.
    sides : Array
        Sides of the impacts.

    Returns
    -------
    Array
        Rate, a scalar.
    """
    return CONTACT_MAP_MODULES[coeffs.contact_law].max_oscillation_rate(coeffs, contact_map, sides)


def max_contact_step(coeffs, contact_map, sides):
    """Return the longest step within contact phases.

    Parameters
    ----------
    coeffs : FlowCoefficients
        Coefficients of the scene.
    contact_map : ContactMap
        Effect of the impacts.
    sides : Array
        Sides of the impacts.

    Returns
    -------
    Array
        Step in t, a scalar.
    """
    return CONTACT_MAP_MODULES[coeffs.contact_law].max_contact_step(coeffs, contact_map, sides)
