"""Contact map: the effect of an impact, or a contact phase, as a function of its time and speed.

The equations of the impacts (`impact_equations`) treat impacts and contact phases alike. The equations need the start
of the next flight and its derivatives with respect to the time and the speed of the impact. A contact phase has a
duration, an impact has none. Both maps are smooth, also where the speed is zero.
"""

from typing import NamedTuple

import jax
import jax.numpy as jnp
from jaxtyping import Bool, Float

from continuation.array_type import Array

from ..compiled.lane_arithmetic import choose
from ..flight import motion_in_soft_wall
from ..flight.flight_coefficients import ContactLaw
from ..flight.flow_dispatch import flow_of
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
        (cosine, sine) of the drive's phase at the start of the next flight.
    state_by_time, state_by_speed : tuple of Array
        Derivatives of (x, v) with respect to the time and the speed of the impact, at a fixed start of the next flight.
    exit_velocity : Array
        Velocity at the start of the next flight relative to the wall.
    is_soft : Array of bool or None
        True for contact phases; None if all walls are rigid.
    free_flow : tuple of Array or None
        Entries (p00, p01, p11) of the matrix of the flow within the wall over the contact phase, as in
        `contact_phase.ContactPhase`. Under a user-defined force the field contains
        `force_law_contact_map.ContactExit.exit_derivatives` instead.
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


def evaluate_contact_map(coeffs, sides, cosine, sine, speed, grazing_mask=None, min_contact_time=None):
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
    grazing_mask : Array, optional
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
    restitution = motion_in_soft_wall.restitution_of(coeffs, sides) + zero
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
    is_soft = motion_in_soft_wall.is_soft_side(coeffs, sides)
    is_soft = is_soft if grazing_mask is None else is_soft & (grazing_mask == 0)
    soft_fields, free_flow = contact_module.exit_map(coeffs, sides, is_soft, speed, contact_map, min_contact_time)
    rigid_fields = (
        contact_map.state,
        contact_map.phasor,
        contact_map.state_by_time,
        contact_map.state_by_speed,
        contact_map.exit_velocity,
        zero,
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


def saltation_matrices(coeffs, contact_map, sides):
    """Compute the saltation matrices of impacts (paper, (35)).

    For a contact phase the matrix maps a perturbation of (x, v) at the entry to a perturbation at the exit. In a linear
    soft wall the matrix is S2 P S1, where P is the flow matrix within the wall. S1 and S2 are the saltation matrices of
    the jumps of the damping at the entry and at the exit.

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
        Entries of the matrices by rows.
    determinant : Array
        Determinants of the matrices.
    """
    contact_module, acceleration_function = (
        CONTACT_MAP_MODULES[coeffs.contact_law],
        flow_of(coeffs).acceleration_and_jerk,
    )
    acceleration_before, _ = acceleration_function(
        coeffs,
        contact_map.wall_position,
        contact_map.wall_velocity + contact_map.approach_velocity,
        contact_map.cosine,
        contact_map.sine,
    )
    acceleration_after, _ = acceleration_function(coeffs, *contact_map.state, *contact_map.phasor)
    shear = (
        acceleration_after
        + contact_map.restitution * acceleration_before
        - (1.0 + contact_map.restitution) * contact_map.wall_acceleration
    ) / contact_map.approach_velocity
    if contact_module is not None:
        shear = choose(contact_map.restitution < 0, 0.0, shear)  # a grazing of a soft wall has no effect
    rigid_result = (
        (-contact_map.restitution, jnp.zeros_like(shear), shear, -contact_map.restitution),
        contact_map.restitution * contact_map.restitution,
    )
    if contact_module is None:
        return rigid_result
    soft_result = contact_module.contact_matrix(coeffs, sides, contact_map, acceleration_before, acceleration_after)
    return jax.tree.map(lambda soft, rigid: jnp.where(contact_map.is_soft, soft, rigid), soft_result, rigid_result)


def state_in_contact(coeffs, contact_map, sides, row_indices, elapsed_time, free_state):
    """Return (x, v) some time after the impacts in rows `row_indices`, or `free_state` outside contact phases."""
    return CONTACT_MAP_MODULES[coeffs.contact_law].state_in_contact(
        coeffs, contact_map, sides, row_indices, elapsed_time, free_state
    )


def max_oscillation_rate(coeffs, contact_map, sides):
    """Return the largest oscillation rate within soft walls.

    The rate is an upper bound for linear soft walls and an estimate under a user-defined force.

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
