"""Duration, end and matrix of a contact phase within a soft wall.

Certified flight gives the duration without derivatives. Newton steps then correct the duration and are differentiated.
"""

import math
from typing import NamedTuple

import jax
import jax.numpy as jnp
from jax import lax
from jaxtyping import Float

from ..compiled.lane_arithmetic import call_without_inlining, choose
from ..flight import flow, motion_in_soft_wall, soft_wall_long_step, taylor_polynomials
from ..flight.flight_state import Path, SlowMotion
from ..flight.flight_step import certified_step
from ..flight.motion_in_soft_wall import is_inside_soft_wall
from ..flight.taylor_polynomials import ExpansionPoint
from ..scene.state import Contact

NEWTON_STEPS = 6  # from the guess of a parabola to the duration of a short contact phase
MEMORY_STEPS = 8.0  # contact phases up to this many longest steps depend on their start


class ContactEnd(NamedTuple):
    """End of a contact phase.

    Attributes
    ----------
    time : array
        Duration of the contact phase.
    v : array
        Velocity relative to the wall at the exit.
    cosine, sine : array
        Cosine and sine of the drive phase at the exit.
    """

    time: Float[jax.Array, "*lanes"]
    v: Float[jax.Array, "*lanes"]
    cosine: Float[jax.Array, "*lanes"]
    sine: Float[jax.Array, "*lanes"]


def path_inside_wall(contact_code, relative_displacement, relative_velocity, drive_cosine, drive_sine, max_duration):
    """Return the `Path` of lanes inside a wall with a remaining time, 0 for lanes outside the walls."""
    zeros = lax.full_like(relative_displacement, 0.0)
    slow_motion = SlowMotion(relative_displacement, zeros, relative_velocity, zeros, drive_cosine, drive_sine)
    time_remaining = choose(is_inside_soft_wall(contact_code), max_duration, 0.0)
    return Path(relative_displacement, zeros, relative_velocity, slow_motion, time_remaining, zeros, contact_code)


def linear_contact_duration(
    coeffs, contact_code, relative_displacement, relative_velocity, drive_cosine, drive_sine, max_duration
):
    """Return the time after which lanes within a wall leave the wall, at most `max_duration`; without derivatives.

    A time that is short compared with `max_duration` also has full relative accuracy. This accuracy matters in a stiff
    wall, where the influence of the initial state may decay within a thousandth of `max_duration`. The result is
    arbitrary for lanes outside the walls.
    """
    zeros = lax.full_like(relative_displacement, 0.0)
    path = path_inside_wall(
        contact_code, relative_displacement, relative_velocity, drive_cosine, drive_sine, max_duration
    )

    def step_until_exit(carry):
        path, n_steps_inside, remaining_at_exit, remaining_at_exit_low = carry
        n_steps_inside = n_steps_inside + 1.0
        is_long_step_due = jnp.any(soft_wall_long_step.is_long_step_due(path, n_steps_inside))
        path, n_steps_inside = lax.cond(
            is_long_step_due,
            lambda path, n_steps_inside: soft_wall_long_step.take_long_step(coeffs, path, n_steps_inside),
            lambda *unchanged: unchanged,
            path,
            n_steps_inside,
        )
        path_after_step = certified_step(coeffs, path).path
        has_left_wall = (path.time_remaining > 0) & ~is_inside_soft_wall(path_after_step.contact)
        remaining_at_exit, remaining_at_exit_low = (
            choose(has_left_wall, path_after_step.time_remaining, remaining_at_exit),
            choose(has_left_wall, path_after_step.time_remaining_low_part, remaining_at_exit_low),
        )
        time_remaining, time_remaining_low = (
            choose(has_left_wall, 0.0, remaining_part)
            for remaining_part in (path_after_step.time_remaining, path_after_step.time_remaining_low_part)
        )
        return (
            path_after_step._replace(time_remaining=time_remaining, time_remaining_low_part=time_remaining_low),
            n_steps_inside,
            remaining_at_exit,
            remaining_at_exit_low,
        )

    *_, remaining_at_exit, exit_remaining_low = lax.while_loop(
        lambda carry: jnp.any(carry[0].time_remaining > 0), step_until_exit, (path, zeros, zeros, zeros)
    )
    return (max_duration - remaining_at_exit) - exit_remaining_low


def contact_phase_matrix(
    coeffs, contact_code, contact_duration, flow_matrix_entries, entry_v_over_relative_v, exit_v_over_relative_v
):
    """Compute the matrix of a contact phase and its determinant.

    Parameters
    ----------
    coeffs : FlowCoefficients
        Coefficients of the scene.
    contact_code : array
        Contact code of each lane.
    contact_duration : array
        Duration of the contact phase, in t.
    flow_matrix_entries : tuple of array
        Entries (p00, p01, p11) of the flow matrix within the wall.
    entry_v_over_relative_v, exit_v_over_relative_v : array
        Ratio v / u at the entry and at the exit, where v is the velocity of the mass and u the velocity relative to the
        wall. 0 if the contact phase does not begin or end at the surface of the wall.

    Returns
    -------
    matrix : tuple of array
        Four entries of the derivative of the final state with respect to the initial state, by rows.
    determinant : array
        Determinant of the matrix.

    Notes
    -----
    At the entry the damping jumps from gamma to gamma2, and at the exit back to gamma. The saltation matrices are
    S = ((1, 0), (+-2 (gamma - gamma2) v / u, 1)), with + at the entry and - at the exit.
    """
    contact_coeffs = motion_in_soft_wall.coeffs_by_lane(coeffs, contact_code)
    p00, p01, p11 = flow_matrix_entries
    damping_jump = 2.0 * (coeffs.damping - contact_coeffs.damping)
    entry_saltation, exit_saltation = damping_jump * entry_v_over_relative_v, damping_jump * exit_v_over_relative_v
    lower_left_entry = (entry_saltation - exit_saltation) * p00 - p01 * (
        2.0 * contact_coeffs.damping * entry_saltation + contact_coeffs.stiffness + entry_saltation * exit_saltation
    )
    contact_matrix = p00 + p01 * entry_saltation, p01, lower_left_entry, p11 - p01 * exit_saltation
    return contact_matrix, jnp.exp(-2.0 * contact_coeffs.damping * contact_duration)


def flow_matrix_in_contact(contact_coeffs, contact_code, contact_duration, contact_response, surface_to_surface_start):
    """Return the entries (p00, p01, p11) of the flow matrix of a contact phase.

    `contact_response` is the `motion_in_soft_wall.ContactResponse`. `surface_to_surface_start` is (mask, relative
    velocity, cosine, sine). The mask selects lanes whose contact phase begins and ends at the surface of the wall. The
    other entries are the velocity relative to the wall and the drive at the start.

    For the selected lanes p01 follows from the zero displacement at the end, if the duration is between one and
    `MEMORY_STEPS` longest steps. A small p01 then has full relative accuracy. The accuracy matters because
    `contact_phase_matrix` multiplies p01 by the stiffness.
    """
    p00, p01, p11 = contact_response.free_flow
    is_surface_to_surface, entry_velocity, drive_cosine, drive_sine = surface_to_surface_start
    zero = lax.full_like(contact_duration, 0.0)
    is_surface_to_surface &= (contact_duration > contact_coeffs.max_step) & (
        contact_duration < MEMORY_STEPS * contact_coeffs.max_step
    )
    end_forced_displacement, _ = motion_in_soft_wall.apply_response(
        contact_coeffs, contact_code, contact_response, (zero, zero), drive_cosine, drive_sine
    )
    return (
        p00,
        choose(
            is_surface_to_surface, -end_forced_displacement / choose(is_surface_to_surface, entry_velocity, 1.0), p01
        ),
        p11,
    )


def v_over_relative_velocity(wall_velocity, relative_velocity):
    """Return the velocity of the mass divided by the velocity relative to the wall.

    Parameters
    ----------
    wall_velocity, relative_velocity : array
        Velocity of the wall, and velocity of the mass relative to the wall.

    Returns
    -------
    array
        The ratio; 1 for a wall at rest, also if the relative velocity is zero.
    """
    return 1.0 + choose(wall_velocity == 0, 0.0, wall_velocity / relative_velocity)


def multiply_2x2_matrices(left_matrix, right_matrix):
    """Multiply two matrices of shape (2, 2).

    Parameters
    ----------
    left_matrix, right_matrix : tuple of array
        Four entries of each matrix by rows.

    Returns
    -------
    tuple of array
        Four entries of the product by rows.
    """
    (left_00, left_01, left_10, left_11), (right_00, right_01, right_10, right_11) = left_matrix, right_matrix
    return (
        left_00 * right_00 + left_01 * right_10,
        left_00 * right_01 + left_01 * right_11,
        left_10 * right_00 + left_11 * right_10,
        left_10 * right_01 + left_11 * right_11,
    )


def solve_contact_end(coeffs, side, drive_cosine, drive_sine, entry_speed, approximate_duration, order):
    """Compute the `ContactEnd` of lanes that enter a soft wall with a speed.

    Side 0 means no contact; the other arguments are then arbitrary. `approximate_duration` is an estimate of the
    duration of the contact phase. Derivatives are exact up to `order`. The result is a smooth function of all
    arguments, also at zero speed. For a negative speed the duration is negative.
    """
    n_newton_steps = math.ceil(math.log2(order + 1))
    contact_code = side * Contact.ENTERED
    contact_coeffs = motion_in_soft_wall.coeffs_by_lane(coeffs, contact_code)
    entry_velocity, max_step = side * entry_speed, lax.stop_gradient(contact_coeffs.max_step)
    is_short_contact = abs(approximate_duration) <= max_step
    short_contact_values = call_without_inlining(
        _short_contact_end,
        contact_coeffs,
        contact_code,
        entry_velocity,
        drive_cosine,
        drive_sine,
        choose(is_short_contact, approximate_duration, 0.0),
        n_newton_steps=n_newton_steps,
    )
    entry_velocity = choose(is_short_contact, side + 0.0 * entry_velocity, entry_velocity)
    long_contact_values = call_without_inlining(
        _long_contact_end,
        contact_coeffs,
        contact_code,
        entry_velocity,
        drive_cosine,
        drive_sine,
        choose(is_short_contact, 0.1 * max_step, approximate_duration),
        order=order,
    )
    contact_duration, exit_velocity = (
        choose(is_short_contact, *short_and_long_value)
        for short_and_long_value in zip(short_contact_values, long_contact_values, strict=True)
    )
    return ContactEnd(
        contact_duration,
        exit_velocity,
        *flow.rotate_phasor_by_angle(drive_cosine, drive_sine, coeffs.frequency * contact_duration),
    )


def _short_contact_end(
    contact_coeffs, contact_code, entry_velocity, drive_cosine, drive_sine, contact_duration, n_newton_steps
):
    """Return (duration, exit velocity) of a short contact phase; the root of the displacement at 0 is divided out."""

    frozen_arguments = lax.stop_gradient((contact_coeffs, contact_code, entry_velocity, drive_cosine, drive_sine))
    contact_duration = lax.fori_loop(
        0,
        NEWTON_STEPS,
        lambda _, contact_duration: _duration_newton_step(*frozen_arguments, contact_duration),
        contact_duration,
    )
    for _ in range(n_newton_steps):
        contact_duration = call_without_inlining(
            _duration_newton_step,
            contact_coeffs,
            contact_code,
            entry_velocity,
            drive_cosine,
            drive_sine,
            contact_duration,
        )
    return contact_duration, call_without_inlining(
        motion_in_soft_wall.velocity_after_entry,
        contact_coeffs,
        contact_code,
        entry_velocity,
        drive_cosine,
        drive_sine,
        contact_duration,
    )


def _duration_newton_step(contact_coeffs, contact_code, entry_velocity, drive_cosine, drive_sine, contact_duration):
    def displacement_over_time(contact_duration):
        return motion_in_soft_wall.displacement_per_time(
            contact_coeffs, contact_code, entry_velocity, drive_cosine, drive_sine, contact_duration
        )

    quotient, quotient_slope = jax.jvp(
        displacement_over_time, (contact_duration,), (lax.full_like(contact_duration, 1.0),)
    )
    return contact_duration - quotient / quotient_slope


def _long_contact_end(
    contact_coeffs, contact_code, relative_velocity, drive_cosine, drive_sine, contact_duration, order
):
    """Return (duration, exit velocity) of a long contact phase, by Taylor polynomials about `contact_duration`."""
    exit_displacement, relative_velocity = motion_in_soft_wall.apply_response(
        contact_coeffs,
        contact_code,
        motion_in_soft_wall.contact_response(contact_coeffs, contact_code, contact_duration),
        (lax.full_like(relative_velocity, 0.0), relative_velocity),
        drive_cosine,
        drive_sine,
    )
    exit_state = ExpansionPoint(
        exit_displacement,
        relative_velocity,
        *flow.rotate_phasor_by_angle(drive_cosine, drive_sine, contact_coeffs.frequency * contact_duration),
        contact_duration,
    )
    relative_jet = contact_coeffs.flow.jet_at_point(
        contact_coeffs,
        exit_state,
        order,
        motion_in_soft_wall.frame_force_derivs(contact_coeffs, contact_code, *exit_state[2:4], order),
    )
    exit_delay = taylor_polynomials.locate_root_near_zero(relative_jet[: order + 1], order)
    return contact_duration + exit_delay, taylor_polynomials.evaluate_taylor(relative_jet[1:], exit_delay, order)
