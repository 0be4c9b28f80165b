"""Compute contact phases inside a soft wall under a user-defined force, with a certified exit.

The steps are in s (`force_law_series`). The root e of the depth falls to 0 at the exit, like a clearance at a contact
with a wall. Hence the certificates of `event` apply.
"""

from typing import NamedTuple

import jax
import jax.numpy as jnp
from jax import lax
from jaxtyping import Bool, Float, Int

from ..compiled.compiler_hints import choose, maximum, positive_part, stage, two_sum
from . import event, force_law_series, taylor_steps
from .force_flow import MAX_STEPS
from .force_law_series import ContactState, evaluate_terms, select_lanes

MAX_ROOT_ITERATIONS = 60  # largest number of Newton steps or bisections to the end of the available time
TIME_ROUNDINGS = 4.0  # accuracy of the time, in unit roundoffs
POLISH_ITERATIONS = 2  # Newton steps to the exit, starting within `event.landing_tolerance`
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
    time_remaining_low : array
        Low part of the remaining time.
    s_span : array
        Span of s since the start.
    exits : array of bool
        True if the mass has left the wall.
    n_steps : int
        Number of steps.
    """

    state: ContactState
    time_remaining: Float[jax.Array, "*lanes"]
    time_remaining_low: Float[jax.Array, "*lanes"]
    s_span: Float[jax.Array, "*lanes"]
    exits: Bool[jax.Array, "*lanes"]
    n_steps: Int[jax.Array, ""]


def traverse_contact(coeffs, side, start, time_remaining, time_remaining_low=None):
    """Advance lanes inside a wall to their exit or to the end of their time.

    Parameters
    ----------
    coeffs : FlowCoefficients
        Coefficients of the scene.
    side : array
        Side of the wall, -1 or 1.
    start : ContactState
        Initial state.
    time_remaining : array
        Available time. Lanes with 0 do not move.
    time_remaining_low : array, optional
        Low part of the available time.

    Returns
    -------
    ContactPassage
        State at the end. The remaining time of a lane that neither leaves nor reaches the end of its time is not 0.
    """
    zero = jnp.zeros_like(time_remaining)
    remaining_low = zero if time_remaining_low is None else time_remaining_low

    def is_unfinished(passage):
        return jnp.any((passage.time_remaining > 0) & ~passage.exits) & (passage.n_steps < MAX_STEPS)

    return lax.while_loop(
        is_unfinished,
        lambda passage: _step_lanes(coeffs, side, passage),
        ContactPassage(start, time_remaining, remaining_low, zero, time_remaining != time_remaining, jnp.int32(0)),
    )


def _step_lanes(coeffs, side, passage):
    """Advance the lanes by one certified step."""
    state, time_remaining = passage.state, passage.time_remaining
    terms = force_law_series.contact_series(coeffs, side, state, taylor_steps.step_order(coeffs))
    max_step = force_law_series.max_step(coeffs, terms, state.scale)
    exit_progress = stage(_exit_progress, terms.scaled_root, max_step, tolerance=coeffs.force_law.tolerance)
    bound = event.bound_progress(exit_progress, stage(event.cubic_bound, exit_progress))
    safe_step, root_guess = stage(event.safe_step, bound), stage(event.first_quadratic_root, *bound[:3])
    certified_step = stage(event.safe_horizon_step, bound, stage(event.bounding_horizon, bound, root_guess), safe_step)
    root = stage(event.newton_step, exit_progress, stage(event.halley_step, exit_progress, root_guess))
    root_error_bound = stage(event.root_error_bound, exit_progress, root_guess, root)
    exits = stage(_exits, exit_progress, root, root_error_bound)
    s_step = stage(_step_in_s, terms, max_step, certified_step, root, root_error_bound, exits)
    active = (time_remaining > 0) & ~passage.exits
    step_time = stage(_elapsed_time, terms.time, s_step)
    overshoots = (
        active
        & (step_time >= time_remaining)
        & ~(exits & (step_time <= time_remaining + stage(_time_tolerance, coeffs.period, time_remaining)))
    )
    s_step = lax.cond(jnp.any(overshoots), _step_to_time, _keep_step, terms.time, s_step, time_remaining, overshoots)
    exits &= ~overshoots
    root, scaled_rate, step_time = stage(evaluate_terms, terms, s_step)
    root = choose(exits, 0.0, root)
    cosine, sine = stage(force_law_series.rotate_drive, coeffs, state, step_time)
    next_state = state._replace(scaled_root=root, scaled_rate=scaled_rate, cosine=cosine, sine=sine)
    next_remaining, next_remaining_low = two_sum(time_remaining, -step_time)
    next_remaining, next_remaining_low = two_sum(next_remaining, next_remaining_low + passage.time_remaining_low)
    next_remaining = choose(overshoots, 0.0, positive_part(next_remaining))
    next_remaining_low = choose(next_remaining > 0, next_remaining_low, 0.0)
    has_diverged = ~(lax.abs(root) < MAX_ROOT)
    next_values = (
        next_state,
        choose(has_diverged, jnp.nan, next_remaining),
        next_remaining_low,
        passage.s_span + s_step,
        exits,
    )
    values = state, time_remaining, passage.time_remaining_low, passage.s_span, passage.exits
    return ContactPassage(*select_lanes(active, next_values, values), passage.n_steps + 1)


def _time_tolerance(period, like):
    """Return the tolerance of the remaining time."""
    return TIME_ROUNDINGS * event.unit_roundoff(like.dtype) * period


def _exit_progress(root_terms, max_step, tolerance):
    """Return the `event.Progress` of minus the root, in longest steps; a root 0 at the start is divided out."""
    power, terms, remainder, magnitude = lax.full_like(max_step, 1.0), [], lax.full_like(max_step, 0.0), None
    for k, coefficient in enumerate(root_terms):
        term = coefficient * power
        if k < event.N_TERMS:
            terms.append(-term)
        else:
            remainder = remainder + (k / event.N_TERMS) * lax.abs(term)
        magnitude = lax.abs(term) if magnitude is None else maximum(magnitude, lax.abs(term)) if k < 3 else magnitude
        power = power * max_step
    return event.make_progress(terms, remainder + 2.0 * tolerance * magnitude, root_terms[0] == 0)


def _exits(progress, root, root_error_bound):
    """Return True where the root is the exit and close enough."""
    g = progress.terms
    return (root_error_bound >= 0) & (
        root_error_bound * (lax.abs(g[2]) + g[1]) < event.landing_tolerance(root.dtype) * g[1]
    )


def _step_in_s(terms, max_step, certified_step, root, root_error_bound, exits):
    """Return the step in s: to the polished exit, or as far as there is certainly none."""
    exit_s = root * max_step
    for _ in range(POLISH_ITERATIONS):
        value, slope, _ = evaluate_terms(terms, exit_s)
        exit_s = exit_s - choose(exits, value / slope, 0.0)
    return choose(
        exits, exit_s, maximum(certified_step, choose(root_error_bound >= 0, root - root_error_bound, 0.0)) * max_step
    )


def _elapsed_time(terms, s_step):
    """Return the time that a step in s takes."""
    return evaluate_terms([terms], s_step)[0]


def _keep_step(terms, s_step, time_remaining, overshoots):
    """Return the step unchanged."""
    return s_step


def _step_to_time(terms, s_step, time_remaining, overshoots):
    """Return the span of s after which no time remains, in lanes that overshoot; the time increases with s."""
    derivative_terms = [k * term for k, term in enumerate(terms)][1:]

    def is_unfinished(carry):
        _, _, _, active, n_iterations = carry
        return jnp.any(active) & (n_iterations < MAX_ROOT_ITERATIONS)

    def refine(carry):
        lower, upper, guess, _, n_iterations = carry
        value, slope = evaluate_terms([terms, derivative_terms], guess)
        too_far = value > time_remaining
        lower, upper = choose(too_far, lower, guess), choose(too_far, guess, upper)
        next_guess = guess - (value - time_remaining) / slope
        next_guess = choose((next_guess > lower) & (next_guess < upper), next_guess, 0.5 * (lower + upper))
        active = overshoots & (lax.abs(next_guess - guess) > TIME_ROUNDINGS * event.unit_roundoff(guess.dtype) * guess)
        return lower, upper, next_guess, active, n_iterations + 1

    zero = lax.full_like(s_step, 0.0)
    solution = lax.while_loop(is_unfinished, refine, (zero, s_step, s_step, overshoots, jnp.int32(0)))[2]
    return choose(overshoots, solution, s_step)


def fly_s_span(coeffs, side, start, s_span):
    """Return (`ContactState`, elapsed time) after a span of s, with forward-mode derivatives; exits are ignored."""
    zero = jnp.zeros_like(s_span)

    def is_unfinished(carry):
        return jnp.any(carry[2] > 0) & (carry[3] < MAX_STEPS)

    def step(carry):
        state, elapsed, s_remaining, n_iterations = carry
        terms = force_law_series.contact_series(coeffs, side, state, FLIGHT_DEGREE)
        max_step = force_law_series.max_step(*lax.stop_gradient((coeffs, terms, state.scale)))
        is_last = s_remaining <= max_step
        s_step = choose(is_last, s_remaining, max_step)
        scaled_root, scaled_rate, step_time = evaluate_terms(terms, s_step)
        cosine, sine = force_law_series.rotate_drive(coeffs, state, step_time)
        next_values = (
            state._replace(scaled_root=scaled_root, scaled_rate=scaled_rate, cosine=cosine, sine=sine),
            elapsed + step_time,
        )
        next_values = select_lanes(s_remaining > 0, next_values, (state, elapsed))
        return *next_values, choose(is_last, 0.0, positive_part(s_remaining - s_step)), n_iterations + 1

    start = jax.tree.map(lambda leaf: leaf + zero, start)
    state, elapsed, _, _ = lax.while_loop(is_unfinished, step, (start, zero, s_span, jnp.int32(0)))
    return state, elapsed
