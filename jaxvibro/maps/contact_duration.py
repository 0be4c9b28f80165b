"""Duration and end of a contact phase within a soft wall: found by certified flight, then made differentiable.

The duration is found without derivatives and then corrected by Newton steps that are differentiated.
"""

import math
from typing import NamedTuple

import jax
import jax.numpy as jnp
from jax import lax
from jaxtyping import Float

from ..compiled.compiler_hints import choose, stage
from ..flight import flow, force_law_contact, soft_contact, soft_long_step, taylor
from ..flight.coefficients import ContactLaw
from ..flight.flight_state import CAPPED, Path, SlowMotion
from ..flight.flows import flow_of
from ..flight.soft_contact import is_inside
from ..flight.step import certified_step
from ..flight.taylor import ExpansionPoint
from ..scene.codes import Contact

NEWTON_STEPS = 6  # from the guess of a parabola to the duration of a short contact phase
MEMORY_STEPS = 8.0  # contact phases up to this many longest steps depend on their start


class ContactEnd(NamedTuple):
    """End of a contact phase: duration, velocity relative to the wall, and cosine and sine of the drive."""

    time: Float[jax.Array, "*lanes"]
    v: Float[jax.Array, "*lanes"]
    cosine: Float[jax.Array, "*lanes"]
    sine: Float[jax.Array, "*lanes"]


def contact_time_of(coeffs, contact, y, v, cosine, sine, max_time):
    """Return the time until lanes within a wall leave it, at most `max_time`; without derivatives.

    The time has full relative accuracy, even if it is short compared with `max_time`. In a stiff wall the influence of
    the initial state may decay within a thousandth of `max_time`.
    """
    zero = lax.full_like(y, 0.0)
    motion = SlowMotion(y, zero, v, zero, cosine, sine)
    time_remaining = choose(is_inside(contact), max_time, 0.0)
    path = Path(y, zero, v, motion, time_remaining, zero, contact)
    if coeffs.contact_law is ContactLaw.FORCE_LAW:
        exit_path = force_law_contact.traverse_contacts(coeffs, path)
        exit_remaining = choose(exit_path.time_remaining == CAPPED, jnp.nan, exit_path.time_remaining)
        return choose(is_inside(contact), (max_time - exit_remaining) - exit_path.time_remaining_low, 0.0 * max_time)

    def step_lanes(carry):
        path, n_steps_inside, exit_remaining, exit_remaining_low = carry
        n_steps_inside = n_steps_inside + 1.0
        long_step_due = jnp.any(soft_long_step.is_due(path, n_steps_inside))
        path, n_steps_inside = lax.cond(
            long_step_due,
            lambda path, n_steps_inside: soft_long_step.take_long_step(coeffs, path, n_steps_inside),
            lambda *unchanged: unchanged,
            path,
            n_steps_inside,
        )
        next_path = certified_step(coeffs, path).path
        has_left_wall = (path.time_remaining > 0) & ~is_inside(next_path.contact)
        exit_remaining, exit_remaining_low = (
            choose(has_left_wall, next_path.time_remaining, exit_remaining),
            choose(has_left_wall, next_path.time_remaining_low, exit_remaining_low),
        )
        time_remaining, time_remaining_low = (
            choose(has_left_wall, 0.0, time_part)
            for time_part in (next_path.time_remaining, next_path.time_remaining_low)
        )
        return (
            next_path._replace(time_remaining=time_remaining, time_remaining_low=time_remaining_low),
            n_steps_inside,
            exit_remaining,
            exit_remaining_low,
        )

    *_, exit_remaining, exit_remaining_low = lax.while_loop(
        lambda carry: jnp.any(carry[0].time_remaining > 0), step_lanes, (path, zero, zero, zero)
    )
    return (max_time - exit_remaining) - exit_remaining_low


def contact_phase_matrix(coeffs, contact, contact_time, free_flow, entry_ratio, exit_ratio):
    """Compute the matrix of a contact phase and its determinant.

    Parameters
    ----------
    coeffs : FlowCoefficients
        Coefficients of the scene.
    contact : array
        Contact code of each lane.
    contact_time : array
        Duration of the contact phase, in t.
    free_flow : tuple of array
        Entries (p00, p01, p11) of the flow within the wall.
    entry_ratio, exit_ratio : array
        Ratio v / u at the entry and at the exit, where v is the velocity and u that relative to the wall; 0 without a
        jump of the damping.

    Returns
    -------
    matrix : tuple of array
        Four entries of the derivative of the final state with respect to the initial state, by rows.
    determinant : array
        Its determinant.

    Notes
    -----
    Where the damping jumps from gamma to gamma2 and back, the saltation matrix is S = ((1, 0), (+-2 (gamma - gamma2) v
    / u, 1)).
    """
    contact_coeffs = soft_contact.coeffs_by_lane(coeffs, contact)
    p00, p01, p11 = free_flow
    damping_jump = 2.0 * (coeffs.damping - contact_coeffs.damping)
    entry_jump, exit_jump = damping_jump * entry_ratio, damping_jump * exit_ratio
    shear = (entry_jump - exit_jump) * p00 - p01 * (
        2.0 * contact_coeffs.damping * entry_jump + contact_coeffs.stiffness + entry_jump * exit_jump
    )
    matrix = p00 + p01 * entry_jump, p01, shear, p11 - p01 * exit_jump
    return matrix, jnp.exp(-2.0 * contact_coeffs.damping * contact_time)


def wall_to_wall_flow(contact_coeffs, contact, contact_time, response, wall_to_wall):
    """Return the flow (p00, p01, p11) of a contact phase, with an accurate p01 for wall-to-wall phases.

    `response` is the `soft_contact.ContactResponse`.

    `wall_to_wall` is (lanes whose contact phase begins and ends at the wall, y', cosine, sine at its start). For these
    lanes p01 follows from y = 0 at the end, with full relative accuracy where it is small; the stiff wall multiplies
    it.
    """
    p00, p01, p11 = response.free_flow
    is_wall_to_wall, entry_velocity, cosine, sine = wall_to_wall
    zero = lax.full_like(contact_time, 0.0)
    is_wall_to_wall &= (contact_time > contact_coeffs.max_step) & (
        contact_time < MEMORY_STEPS * contact_coeffs.max_step
    )
    forced_response, _ = soft_contact.apply_response(contact_coeffs, contact, response, (zero, zero), cosine, sine)
    return p00, choose(is_wall_to_wall, -forced_response / choose(is_wall_to_wall, entry_velocity, 1.0), p01), p11


def velocity_ratio(wall_velocity, relative_velocity):
    """Return the velocity of the mass divided by that relative to the wall.

    Parameters
    ----------
    wall_velocity, relative_velocity : array
        Velocity of the wall, and of the mass relative to it.

    Returns
    -------
    array
        The ratio; 1 for a wall at rest, whatever the speed.
    """
    return 1.0 + choose(wall_velocity == 0, 0.0, wall_velocity / relative_velocity)


def matrix_product(left_matrix, right_matrix):
    """Multiply two matrices.

    Parameters
    ----------
    left_matrix, right_matrix : tuple of array
        Four entries of each matrix by rows.

    Returns
    -------
    tuple of array
        Four entries of the product by rows.
    """
    (a, b, c, d), (e, f, g, h) = left_matrix, right_matrix
    return a * e + b * g, a * f + b * h, c * e + d * g, c * f + d * h


def solve_contact_end(coeffs, side, cosine, sine, speed, approx_time, order):
    """Compute the `ContactEnd` of lanes that enter a soft wall with a speed.

    Side 0 means no contact; the other arguments are then arbitrary. The result is smooth in all numbers, also where the
    speed passes through zero: the duration passes through zero with it and is negative beyond. `approx_time` is the
    duration, and `order` is that of the derivatives that are exact.
    """
    n_newton = math.ceil(math.log2(order + 1))
    contact = side * Contact.ENTERED
    contact_coeffs = soft_contact.coeffs_by_lane(coeffs, contact)
    v, max_step = side * speed, lax.stop_gradient(contact_coeffs.max_step)
    is_short = abs(approx_time) <= max_step
    short_end = stage(
        _short_contact_end,
        contact_coeffs,
        contact,
        v,
        cosine,
        sine,
        choose(is_short, approx_time, 0.0),
        n_newton=n_newton,
    )
    v = choose(is_short, side + 0.0 * v, v)
    long_end = stage(
        _long_contact_end,
        contact_coeffs,
        contact,
        v,
        cosine,
        sine,
        choose(is_short, 0.1 * max_step, approx_time),
        order=order,
    )
    contact_time, exit_velocity = (
        choose(is_short, *short_and_long) for short_and_long in zip(short_end, long_end, strict=True)
    )
    return ContactEnd(contact_time, exit_velocity, *flow.rotate_by_angle(cosine, sine, coeffs.frequency * contact_time))


def _short_contact_end(contact_coeffs, contact, v, cosine, sine, contact_time, n_newton):
    """Return (time, velocity) at the end of a contact phase within one step, with the root at 0 divided out."""

    constants = lax.stop_gradient((contact_coeffs, contact, v, cosine, sine))
    contact_time = lax.fori_loop(
        0, NEWTON_STEPS, lambda _, contact_time: _newton_step(*constants, contact_time), contact_time
    )
    for _ in range(n_newton):
        contact_time = stage(_newton_step, contact_coeffs, contact, v, cosine, sine, contact_time)
    return contact_time, stage(
        soft_contact.velocity_after_entry, contact_coeffs, contact, v, cosine, sine, contact_time
    )


def _newton_step(contact_coeffs, contact, v, cosine, sine, contact_time):
    def height(contact_time):
        return soft_contact.displacement_over_time(contact_coeffs, contact, v, cosine, sine, contact_time)

    value, slope = jax.jvp(height, (contact_time,), (lax.full_like(contact_time, 1.0),))
    return contact_time - value / slope


def _long_contact_end(contact_coeffs, contact, v, cosine, sine, contact_time, order):
    """Return (time, velocity) at the end of a longer contact phase, by Taylor polynomials at an accurate time."""
    y, v = soft_contact.apply_response(
        contact_coeffs,
        contact,
        soft_contact.contact_response(contact_coeffs, contact, contact_time),
        (lax.full_like(v, 0.0), v),
        cosine,
        sine,
    )
    exit_state = ExpansionPoint(
        y, v, *flow.rotate_by_angle(cosine, sine, contact_coeffs.frequency * contact_time), contact_time
    )
    jet = flow_of(contact_coeffs).jet_at_point(
        contact_coeffs,
        exit_state,
        order,
        soft_contact.extra_force_derivs(contact_coeffs, contact, *exit_state[2:4], order),
    )
    delay = taylor.locate_root(jet[: order + 1], order)
    return contact_time + delay, taylor.evaluate_taylor(jet[1:], delay, order)
