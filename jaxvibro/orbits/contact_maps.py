"""Contact map: the effect of an impact, or a contact phase, as a function of its time and speed.

The equations of the impacts (`impact_equations`) treat impacts and contact phases alike. The equations need the start
of the next flight and its derivatives with respect to the time and the speed of the impact. A contact phase has a
duration, an impact has none. Both maps are smooth, also where the speed is zero.
"""

from typing import NamedTuple

import jax.numpy as jnp
from jaxtyping import Bool, Float

from continuation.array_type import Array

from ..contact.wall_at_contact import wall_derivatives
from ..flight.motion_in_soft_wall import restitution_of


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
        `phase_maps.ContactExit.exit_derivatives` instead.
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
    restitution = restitution_of(coeffs, sides) + zero
    velocity_after = wall_velocity - restitution * approach_velocity
    acceleration_after, _ = coeffs.flow.acceleration_and_jerk(coeffs, wall_position, velocity_after, cosine, sine)
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
    return coeffs.contact.complete_contact_map(coeffs, sides, speed, contact_map, grazing_mask, min_contact_time)


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
    acceleration_function = coeffs.flow.acceleration_and_jerk
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
    return coeffs.contact.saltation(coeffs, sides, contact_map, shear, acceleration_before, acceleration_after)
