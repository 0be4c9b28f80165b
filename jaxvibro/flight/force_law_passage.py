"""Compute contact phases inside a soft wall under a user-defined force, from the entry to the exit.

The steps are in the scaled time s (`force_law_motion_series`). The root e of the depth falls to 0 at the exit, like a
clearance at a contact with a wall. Hence `event_certificates` apply, with an estimated bound on the remainder.
"""

from typing import NamedTuple

import jax
import jax.numpy as jnp
from jax import lax
from jaxtyping import Bool, Float, Int

from ..compiled.lane_arithmetic import call_without_inlining, choose, maximum, positive_part, two_sum
from . import event_certificates, force_law_motion_series, taylor_steps
from .force_flow import MAX_STEPS
from .force_law_motion_series import ContactState, evaluate_series, select_lanes

MAX_ROOT_ITERATIONS = 60  # largest number of Newton steps or bisections to the end of the available time
TIME_ROUNDINGS = 4.0  # accuracy of the time, in unit roundoffs
POLISH_ITERATIONS = 2  # Newton steps to the exit, starting within `event_certificates.landing_time_tolerance`
FLIGHT_DEGREE = 10  # degree of steps with derivatives; a low degree limits compilation, their main cost
MAX_ROOT = 1e100  # root of the depth beyond which a motion has diverged


class ContactPassage(NamedTuple):
    """State of lanes during a contact phase.

    Attributes
    ----------
    state : ContactState
        State inside the wall.
    time_remaining : array
        Remaining time.
    time_remaining_low_part : array
        Low part of the remaining time.
    scaled_time_span : array
        Span of the scaled time s since the start.
    has_exited : array of bool
        True if the mass has left the wall.
    n_steps : int
        Number of steps.
    """

    state: ContactState
    time_remaining: Float[jax.Array, "*lanes"]
    time_remaining_low_part: Float[jax.Array, "*lanes"]
    scaled_time_span: Float[jax.Array, "*lanes"]
    has_exited: Bool[jax.Array, "*lanes"]
    n_steps: Int[jax.Array, ""]


def traverse_contact(coeffs, side, start_state, time_remaining, time_remaining_low_part=None):
    """Advance lanes inside a wall to their exit or to the end of their time.

    Parameters
    ----------
    coeffs : FlowCoefficients
        Coefficients of the scene.
    side : array
        Side of the wall, -1 or 1.
    start_state : ContactState
        Initial state.
    time_remaining : array
        Available time. Lanes with 0 do not move.
    time_remaining_low_part : array, optional
        Low part of the available time.

    Returns
    -------
    ContactPassage
        State at the end. If a lane needs too many steps, it has not exited and its remaining time is not 0.
    """
    zero = jnp.zeros_like(time_remaining)
    remaining_time_low = zero if time_remaining_low_part is None else time_remaining_low_part

    def is_unfinished(passage):
        return jnp.any((passage.time_remaining > 0) & ~passage.has_exited) & (passage.n_steps < MAX_STEPS)

    return lax.while_loop(
        is_unfinished,
        lambda passage: _advance_lanes(coeffs, side, passage),
        ContactPassage(
            start_state, time_remaining, remaining_time_low, zero, time_remaining != time_remaining, jnp.int32(0)
        ),
    )


def _advance_lanes(coeffs, side, contact_passage):
    """Advance the lanes by one step in s, which ends at the exit or before it."""
    state, time_remaining = contact_passage.state, contact_passage.time_remaining
    contact_series = force_law_motion_series.contact_series(
        coeffs, side, state, taylor_steps.step_polynomial_degree(coeffs)
    )
    max_scaled_step = force_law_motion_series.max_scaled_step(coeffs, contact_series, state.scale)
    exit_polynomial = call_without_inlining(
        _exit_polynomial, contact_series.scaled_depth_root, max_scaled_step, tolerance=coeffs.user_force.tolerance
    )
    certified_scaled_step, exit_root, root_error_bound = event_certificates.certify_event(exit_polynomial)
    exits_in_step = call_without_inlining(_is_certain_exit, exit_polynomial, exit_root, root_error_bound)
    scaled_step = call_without_inlining(
        _select_scaled_step,
        contact_series,
        max_scaled_step,
        certified_scaled_step,
        exit_root,
        root_error_bound,
        exits_in_step,
    )
    is_active = (time_remaining > 0) & ~contact_passage.has_exited
    scaled_step, overshoots_end_time = _shorten_to_end_time(
        coeffs, contact_series, scaled_step, time_remaining, is_active, exits_in_step
    )
    exits_in_step &= ~overshoots_end_time
    scaled_depth_root, scaled_rate, step_time = call_without_inlining(evaluate_series, contact_series, scaled_step)
    scaled_depth_root = choose(exits_in_step, 0.0, scaled_depth_root)
    cosine, sine = call_without_inlining(force_law_motion_series.rotate_drive_phasor, coeffs, state, step_time)
    next_state = state._replace(
        scaled_depth_root=scaled_depth_root, scaled_depth_rate=scaled_rate, cosine=cosine, sine=sine
    )
    next_time_remaining, next_time_low_part = two_sum(time_remaining, -step_time)
    next_time_remaining, next_time_low_part = two_sum(
        next_time_remaining, next_time_low_part + contact_passage.time_remaining_low_part
    )
    next_time_remaining = choose(overshoots_end_time, 0.0, positive_part(next_time_remaining))
    next_time_low_part = choose(next_time_remaining > 0, next_time_low_part, 0.0)
    has_diverged = ~(lax.abs(scaled_depth_root) < MAX_ROOT)
    next_values = (
        next_state,
        choose(has_diverged, jnp.nan, next_time_remaining),
        next_time_low_part,
        contact_passage.scaled_time_span + scaled_step,
        exits_in_step,
    )
    values = (
        state,
        time_remaining,
        contact_passage.time_remaining_low_part,
        contact_passage.scaled_time_span,
        contact_passage.has_exited,
    )
    return ContactPassage(*select_lanes(is_active, next_values, values), contact_passage.n_steps + 1)


def _shorten_to_end_time(coeffs, contact_series, scaled_step, time_remaining, is_active, exits_in_step):
    """Return (step in s, mask of the lanes whose step ends with the available time and not at an exit)."""
    step_time = call_without_inlining(_elapsed_time, contact_series.time, scaled_step)
    overshoots_end_time = (
        is_active
        & (step_time >= time_remaining)
        & ~(
            exits_in_step
            & (step_time <= time_remaining + call_without_inlining(_time_tolerance, coeffs.period, time_remaining))
        )
    )
    scaled_step = lax.cond(
        jnp.any(overshoots_end_time),
        _scaled_step_to_time,
        _unchanged_step,
        contact_series.time,
        scaled_step,
        time_remaining,
        overshoots_end_time,
    )
    return scaled_step, overshoots_end_time


def _time_tolerance(period, template):
    """Return the tolerance with which an exit counts as within the remaining time."""
    return TIME_ROUNDINGS * event_certificates.unit_roundoff(template.dtype) * period


def _exit_polynomial(depth_root_terms, max_scaled_step, tolerance):
    """Return the `event_certificates.EventPolynomial` of the negative square root of the depth.

    A zero at the start is divided out. The unit of s is the longest step.
    """
    step_power, polynomial_terms, remainder_bound, leading_magnitude = (
        lax.full_like(max_scaled_step, 1.0),
        [],
        lax.full_like(max_scaled_step, 0.0),
        None,
    )
    for k, coefficient in enumerate(depth_root_terms):
        scaled_term = coefficient * step_power
        if k < event_certificates.N_TERMS:
            polynomial_terms.append(-scaled_term)
        else:
            remainder_bound = remainder_bound + (k / event_certificates.N_TERMS) * lax.abs(scaled_term)
        leading_magnitude = (
            lax.abs(scaled_term)
            if leading_magnitude is None
            else maximum(leading_magnitude, lax.abs(scaled_term))
            if k < 3
            else leading_magnitude
        )
        step_power = step_power * max_scaled_step
    return event_certificates.make_event_polynomial(
        polynomial_terms, remainder_bound + 2.0 * tolerance * leading_magnitude, depth_root_terms[0] == 0
    )


def _is_certain_exit(exit_polynomial, exit_root, root_error_bound):
    """Return True where the root is certainly the exit and accurate enough for a step to end there."""
    polynomial_terms = exit_polynomial.terms
    return (root_error_bound >= 0) & (
        root_error_bound * (lax.abs(polynomial_terms[2]) + polynomial_terms[1])
        < event_certificates.landing_time_tolerance(exit_root.dtype) * polynomial_terms[1]
    )


def _select_scaled_step(
    contact_series, max_scaled_step, certified_scaled_step, exit_root, root_error_bound, exits_in_step
):
    """Return the step in s: to the exit, or up to a value before which there is certainly no exit."""
    exit_scaled_time = exit_root * max_scaled_step
    for _ in range(POLISH_ITERATIONS):
        value, slope, _ = evaluate_series(contact_series, exit_scaled_time)
        exit_scaled_time = exit_scaled_time - choose(exits_in_step, value / slope, 0.0)
    return choose(
        exits_in_step,
        exit_scaled_time,
        maximum(certified_scaled_step, choose(root_error_bound >= 0, exit_root - root_error_bound, 0.0))
        * max_scaled_step,
    )


def _elapsed_time(time_terms, scaled_step):
    """Return the time that a step in s takes."""
    return evaluate_series([time_terms], scaled_step)[0]


def _unchanged_step(time_terms, scaled_step, time_remaining, overshoots_end_time):
    """Return the step unchanged; the parameters are those of `_scaled_step_to_time`."""
    return scaled_step


def _scaled_step_to_time(time_terms, scaled_step, time_remaining, overshoots_end_time):
    """Return the step in s, shortened to the end of the available time in lanes that overshoot it.

    The time increases with s.
    """
    time_slope_terms = [k * term for k, term in enumerate(time_terms)][1:]

    def is_unfinished(carry):
        _, _, _, is_active, n_iterations = carry
        return jnp.any(is_active) & (n_iterations < MAX_ROOT_ITERATIONS)

    def refine(carry):
        lower, upper, guess, _, n_iterations = carry
        time_value, time_slope = evaluate_series([time_terms, time_slope_terms], guess)
        is_past_end_time = time_value > time_remaining
        lower, upper = choose(is_past_end_time, lower, guess), choose(is_past_end_time, guess, upper)
        next_guess = guess - (time_value - time_remaining) / time_slope
        next_guess = choose((next_guess > lower) & (next_guess < upper), next_guess, 0.5 * (lower + upper))
        is_active = overshoots_end_time & (
            lax.abs(next_guess - guess) > TIME_ROUNDINGS * event_certificates.unit_roundoff(guess.dtype) * guess
        )
        return lower, upper, next_guess, is_active, n_iterations + 1

    zero = lax.full_like(scaled_step, 0.0)
    scaled_step_to_end = lax.while_loop(
        is_unfinished, refine, (zero, scaled_step, scaled_step, overshoots_end_time, jnp.int32(0))
    )[2]
    return choose(overshoots_end_time, scaled_step_to_end, scaled_step)


def fly_scaled_time_span(coeffs, side, start_state, scaled_time_span):
    """Return (`ContactState`, elapsed time) after a span of s, with forward-mode derivatives; exits are ignored."""
    zero = jnp.zeros_like(scaled_time_span)

    def is_unfinished(carry):
        return jnp.any(carry[2] > 0) & (carry[3] < MAX_STEPS)

    def advance_step(carry):
        state, elapsed_time, scaled_time_remaining, n_iterations = carry
        contact_series = force_law_motion_series.contact_series(coeffs, side, state, FLIGHT_DEGREE)
        max_scaled_step = force_law_motion_series.max_scaled_step(
            *lax.stop_gradient((coeffs, contact_series, state.scale))
        )
        is_last_step = scaled_time_remaining <= max_scaled_step
        scaled_step = choose(is_last_step, scaled_time_remaining, max_scaled_step)
        scaled_depth_root, scaled_depth_rate, step_time = evaluate_series(contact_series, scaled_step)
        cosine, sine = force_law_motion_series.rotate_drive_phasor(coeffs, state, step_time)
        next_values = (
            state._replace(
                scaled_depth_root=scaled_depth_root, scaled_depth_rate=scaled_depth_rate, cosine=cosine, sine=sine
            ),
            elapsed_time + step_time,
        )
        next_values = select_lanes(scaled_time_remaining > 0, next_values, (state, elapsed_time))
        return (
            *next_values,
            choose(is_last_step, 0.0, positive_part(scaled_time_remaining - scaled_step)),
            n_iterations + 1,
        )

    start_state = jax.tree.map(lambda leaf: leaf + zero, start_state)
    state, time_since_start, _, _ = lax.while_loop(
        is_unfinished, advance_step, (start_state, zero, scaled_time_span, jnp.int32(0))
    )
    return state, time_since_start
