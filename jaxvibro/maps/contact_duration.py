"""How long a mass stays within a soft wall, and how it leaves: found by the certified flight, then made smooth.

The time of a stay is found without derivatives, then corrected by Newton's steps that are differentiated.
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

NEWTON_STEPS = 6  # of Newton's steps to a short stay from a parabola's guess
MEMORY_STEPS = 8.0  # longest steps: of a stay whose start its end has not forgotten


class ContactEnd(NamedTuple):
    """The end of a stay: its time; the velocity against the wall there; the drive's cosine and sine."""

    time: Float[jax.Array, "*lanes"]
    v: Float[jax.Array, "*lanes"]
    cosine: Float[jax.Array, "*lanes"]
    sine: Float[jax.Array, "*lanes"]


def contact_time_of(coeffs, contact, y, v, cosine, sine, max_time):
    """The time until lanes within a wall leave it, at most the longest; contact: their contact. No derivatives.

    It has its own digits, however short it is beside the max_time: a stiff wall forgets a start in a thousandth of it.
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
    """(matrix by rows, its determinant) of a stay over which the flow is free's, p00, p01, p11: how its end changes
    with its start.

    Where the damping jumps from gamma to gamma2 and back, S = ((1, 0), (+-2 (gamma - gamma2) v / u, 1)), v the
    velocity, u that against the wall; entry_ratio, exit_ratio: v / u there, 0 where there is no jump.
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
    """The free flow of a `soft_contact.StayResponse`. wall_to_wall: (lanes whose stay begins and ends at the wall, y',
    cosine, sine at its start): there p01 follows from y = 0 at the end, with all its digits where it is small, and the
    stiff wall multiplies it."""
    p00, p01, p11 = response.free_flow
    is_wall_to_wall, entry_velocity, cosine, sine = wall_to_wall
    zero = lax.full_like(contact_time, 0.0)
    is_wall_to_wall &= (contact_time > contact_coeffs.max_step) & (
        contact_time < MEMORY_STEPS * contact_coeffs.max_step
    )
    forced_response, _ = soft_contact.apply_response(contact_coeffs, contact, response, (zero, zero), cosine, sine)
    return p00, choose(is_wall_to_wall, -forced_response / choose(is_wall_to_wall, entry_velocity, 1.0), p01), p11


def velocity_ratio(wall_velocity, relative_velocity):
    """The mass's own velocity over that against the wall: 1 where the wall stands still, whatever the speed."""
    return 1.0 + choose(wall_velocity == 0, 0.0, wall_velocity / relative_velocity)


def matrix_product(left_matrix, right_matrix):
    """The product of two matrices, each by rows."""
    (a, b, c, d), (e, f, g, h) = left_matrix, right_matrix
    return a * e + b * g, a * f + b * h, c * e + d * g, c * f + d * h


def solve_contact_end(coeffs, side, cosine, sine, speed, approx_time, order):
    """The `ContactEnd` of lanes that meet a soft wall on a side with a speed; side 0: of none, any numbers.

    Smooth in all numbers, also where the speed goes through zero: the stay goes through zero with it, and from there on
    is a negative time. approx_time: its time; order: of the derivatives that are right.
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
    """(time, velocity) at the end of a stay no longer than a step; contact_time: near it. The root at 0 is divided
    out."""

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
    """As `_short_contact_end`, of a longer stay, by Taylor polynomials at a time that is right but for rounding."""
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
