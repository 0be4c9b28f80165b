"""A stay within a soft wall beside a force of the user's own: its end found as surely as an impact, step by step.

The steps are in s (`force_law_series`): e falls to 0 where the mass leaves, as a clearance does where it meets a wall,
and what `event` says of one holds for the other."""

from typing import NamedTuple

import jax
import jax.numpy as jnp
from jax import lax
from jaxtyping import Bool, Float, Int

from ..compiled.compiler_hints import choose, maximum, positive_part, stage, two_sum
from . import event, force_law_series, taylor_steps
from .force_flow import MAX_STEPS
from .force_law_series import ContactState, evaluate_terms, select_lanes

MAX_ROOT_ITERATIONS = 60  # of Newton's steps, or halvings, to the time that a stay is followed for
TIME_ROUNDINGS = 4.0  # roundings: as near is the time
POLISH_ITERATIONS = 2  # Newton's steps to the end of a stay, from one that is nearer than `event.landing`
FLIGHT_DEGREE = (
    10  # the last power of steps with derivatives: their cost is what there is to compile, which is less by it
)
MAX_ROOT = 1e100  # a root beyond which nothing comes back


class ContactPassage(NamedTuple):
    """Lanes on their way through a stay: where they are, the time they have left and its low part; s_span: in s, so
    far; exits: whether they have left the wall; steps taken."""

    state: ContactState
    time_remaining: Float[jax.Array, "*lanes"]
    time_remaining_low: Float[jax.Array, "*lanes"]
    s_span: Float[jax.Array, "*lanes"]
    exits: Bool[jax.Array, "*lanes"]
    n_steps: Int[jax.Array, ""]


def traverse_contact(coeffs, side, start, time_remaining, time_remaining_low=None):
    """The `ContactPassage` of lanes within the wall on a side up to where they leave it, or until so much time is gone.

    Lanes that have no time stay where they are. left is not 0 of a lane that has neither left nor come to its end.
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
    return TIME_ROUNDINGS * event.unit_roundoff(like.dtype) * period


def _exit_progress(root_terms, max_step, tolerance):
    """The `event.Progress` of minus the root, in longest steps; where the stay begins its root at 0 is divided out."""
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
    """Whether the root is where the stay ends, and near enough."""
    g = progress.terms
    return (root_error_bound >= 0) & (
        root_error_bound * (lax.abs(g[2]) + g[1]) < event.landing_tolerance(root.dtype) * g[1]
    )


def _step_in_s(terms, max_step, certified_step, root, root_error_bound, exits):
    """How long the step is, in s: to the end of the stay, polished, or as far as there surely is none."""
    exit_s = root * max_step
    for _ in range(POLISH_ITERATIONS):
        value, slope, _ = evaluate_terms(terms, exit_s)
        exit_s = exit_s - choose(exits, value / slope, 0.0)
    return choose(
        exits, exit_s, maximum(certified_step, choose(root_error_bound >= 0, root - root_error_bound, 0.0)) * max_step
    )


def _elapsed_time(terms, s_step):
    return evaluate_terms([terms], s_step)[0]


def _keep_step(terms, s_step, time_remaining, overshoots):
    return s_step


def _step_to_time(terms, s_step, time_remaining, overshoots):
    """The span after which the time left is gone, in lanes that go beyond it: the time rises all the way."""
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
    """(`ContactState`, the time that is gone) a span of s after a start, with derivatives, forward; no end is looked
    for."""
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
