"""Fly a mass under a user-defined force, by Taylor steps or by the steps of a solver.

The interface is that of `linear_flow`, see `flows`.
"""

from dataclasses import replace
from functools import lru_cache, reduce
from importlib import import_module
from typing import NamedTuple

import jax
import jax.numpy as jnp
from jax import lax

from ..compiled.compiler_hints import choose, maximum, minimum, stage
from ..scene.codes import Contact
from . import event, flow, taylor_steps
from .flight_state import SlowMotion, add_increments, motion_state, rotate_drive
from .taylor import evaluate_taylor
from .taylor_steps import ContactForceJet, as_derivatives
from .wall_motion import select_lists_by_side, wall_jet, wall_jet_on_side

LINEAR = False  # the matrix of a flight depends on its initial state
RATE_FACTOR = 2.0  # bound on the rate of the contact force during chatter, relative to its rate at the start
MAX_STEPS = 100_000  # largest number of steps of a flight


class Lookahead(NamedTuple):
    """Information about the flight ahead of a step.

    Attributes
    ----------
    flight : FlightSeries
        Series of the flight.
    contact_forces : list of ContactForceJet
        Contact force on each wall if any lane sticks, zeros otherwise.
    """

    flight: taylor_steps.FlightSeries
    contact_forces: list[ContactForceJet]


def stepper_of(coeffs):
    """Return the module that steps the flight: `taylor_steps`, or `solver_steps`, which is imported on demand only."""
    return taylor_steps if coeffs.force_law.solver is None else import_module(".solver_steps", __package__)


def look_ahead(coeffs, path):
    """Return (coefficients with the longest step of each lane, `Lookahead`)."""
    flight = stepper_of(coeffs).flight_series(coeffs, path.x, path.v, path.cosine, path.sine)
    max_step, contact_forces = flight.max_step, []
    if coeffs.walls:
        contact_forces = _contact_forces_if_stuck(coeffs, path)
        max_step = stage(_sticking_max_step, path.contact, max_step, [force.max_step for force in contact_forces])
    return stage(_with_max_step, coeffs, max_step), Lookahead(flight, contact_forces)


def _with_max_step(coeffs, max_step):
    """Return the coefficients with another longest step."""
    return coeffs._replace(
        max_step=max_step, inverse_max_step=1.0 / max_step, taylor_weights=event.taylor_weights(max_step)
    )


def _sticking_max_step(contact, max_step, max_steps):
    """Return the longest step of each lane; for a sticking mass only the contact force limits it."""
    return choose(lax.abs(contact) == Contact.STUCK, reduce(minimum, max_steps), max_step)


def _contact_forces_if_stuck(coeffs, path):
    """Return the contact forces if any lane sticks, zeros otherwise."""
    return lax.cond(
        jnp.any(lax.abs(path.contact) == Contact.STUCK), _contact_forces, _zero_contact_forces, coeffs, path
    )


def _contact_forces(coeffs, path):
    """Return the contact force on each wall."""
    stepper = stepper_of(coeffs)
    return [stage(stepper.contact_force_jet, coeffs, wall, path.cosine, path.sine) for wall in coeffs.walls]


def _zero_contact_forces(coeffs, path):
    """Return a contact force of zero on each wall."""
    zero = lax.full_like(path.x, 0.0)
    return [ContactForceJet([zero] * event.N_TERMS, zero, zero) for _ in coeffs.walls]


def event_derivatives(coeffs, path, lookahead, extra_force):
    """Return x and its derivatives up to order `event.N_TERMS`."""
    return stage(as_derivatives, lookahead.flight.terms[: event.N_TERMS + 1])


def lookahead_bounds(lookahead):
    """Return the arrays of a `Lookahead` that describe the contact forces and the remainder."""
    return lookahead.contact_forces, lookahead.flight.remainder_bound


def contact_forces_ahead(coeffs, path, bounds):
    """Return [(contact force and its derivatives, bound on the remainder)] for each wall."""
    return [(force.derivatives, force.remainder_bound) for force in bounds[0]]


def remainder_bound(coeffs, derivatives, bounds, is_sticking, force_remainder, wall_remainder, taylor_weights):
    """Return the bound on the remainder of an event's polynomial, in lengths, for free and for sticking lanes."""
    return choose(is_sticking, force_remainder, bounds[1]) + wall_remainder * taylor_weights[event.N_TERMS]


def advance_motion(coeffs, motion, time, contact, lookahead):
    """Return the motion after a step."""
    return _propagate(coeffs, motion, time, lookahead.flight.terms)


def propagate(coeffs, motion, time, contact=None):
    """Return the `SlowMotion` after a time of at most one step."""
    return _propagate(coeffs, motion, time)


def _propagate(coeffs, motion, time, terms=None):
    """Return the `SlowMotion` after a time; `terms` are the coefficients of x if known."""
    x, _, v = stage(motion_state, coeffs, motion)
    dx, dv = stepper_of(coeffs).step_increments(coeffs, x, v, motion.cosine, motion.sine, time, terms)
    slow_parts = stage(add_increments, motion, dx, dv)
    return SlowMotion(*slow_parts, *stage(rotate_drive, coeffs.frequency, motion.cosine, motion.sine, time))


def acceleration_and_jerk(coeffs, x, v, cosine, sine, extra_force=()):
    """Return the acceleration of a free mass and its rate."""
    return tuple(jet(coeffs, x, v, cosine, sine, 3)[2:])


def jet(coeffs, x, v, cosine, sine, order, extra_force=()):
    """Return x and its derivatives up to an order."""
    return stepper_of(coeffs).derivatives(coeffs, x, v, cosine, sine, order)


def jet_at_point(coeffs, point, order, extra_force=()):
    """Return x and its derivatives up to order + 1 at a `taylor.ExpansionPoint`."""
    return jet(coeffs, point.x, point.v, point.cosine, point.sine, order + 1)


def propagate_back(coeffs, point, x, v, delay, order, extra_force=()):
    """Return x and v at a point of a flight that is at x, v after a short delay."""
    phasor = flow.rotate_by_angle(point.cosine, point.sine, coeffs.frequency * delay)
    derivs = jet(coeffs, x, v, *phasor, order + 1)
    return evaluate_taylor(derivs, -delay, order), evaluate_taylor(derivs[1:], -delay, order)


def contact_force(coeffs, wall, cosine, sine, order):
    """Return the force along x on a sticking mass relative to the wall, and its derivatives."""
    return as_derivatives(stepper_of(coeffs).contact_force_terms(coeffs, wall, cosine, sine, order))


def chatter_bounds(coeffs, side, acceleration, approach_speed, cosine, sine):
    """Return (rate bound, damping, force growth), estimated at the start of chatter on a wall.

    The rate bound limits the rate of the contact force. The damping follows from the acceleration before an impact at
    the approach speed. The force growth is the increase of the force away from the wall with distance, at least 1.
    """
    wall_bounds = select_lists_by_side(
        side,
        coeffs.walls,
        [_wall_chatter_bounds(coeffs, wall, acceleration, approach_speed, cosine, sine) for wall in coeffs.walls],
    )
    wall_position, wall_velocity = wall_jet_on_side(coeffs, side, cosine, sine, 1)
    zero = jnp.zeros_like(cosine)
    force_growth = stepper_of(coeffs).force_gradient(
        coeffs, wall_position + zero, zero if wall_velocity is None else wall_velocity + zero, cosine, sine
    )
    return *wall_bounds, choose(force_growth > 1.0, force_growth, 1.0)


def _wall_chatter_bounds(coeffs, wall, acceleration, approach_speed, cosine, sine):
    """Return (rate bound, damping) of chatter on one wall."""
    force, force_rate, force_curvature = as_derivatives(
        stepper_of(coeffs).contact_force_terms(coeffs, wall, cosine, sine, 2)
    )
    rate_bound = RATE_FACTOR * (lax.abs(force_rate) + coeffs.max_step * lax.abs(force_curvature))
    wall_acceleration = wall_jet(wall, coeffs.frequency, cosine, sine, 2)[2]
    damping_force = lax.abs(
        acceleration - force if wall_acceleration is None else acceleration - force - wall_acceleration
    )
    return rate_bound, 0.5 * damping_force / maximum(
        lax.abs(approach_speed), jnp.full_like(approach_speed, jnp.finfo(approach_speed.dtype).tiny)
    )


def shortest_step(coeffs, flights):
    """Return half of the shortest first step of some `flight_clearance.Flight`s, a scalar."""
    stepper = stepper_of(coeffs)
    max_steps = stepper.sampling_step(
        coeffs, stepper.flight_series(coeffs, flights.x, flights.v, flights.cosine, flights.sine).max_step
    )
    return jnp.minimum(coeffs.max_step, 0.5 * jnp.min(max_steps))


def fly(coeffs, x, v, cosine, sine, time):
    """Return (x, v, cosine, sine) after any time >= 0; forward-mode derivatives only, nan after too many steps."""
    zero = jnp.zeros(jnp.broadcast_shapes(*map(jnp.shape, (x, v, cosine, sine, time))), jnp.result_type(x))
    stepper = stepper_of(coeffs)

    def is_unfinished(carry):
        return jnp.any(carry[4] > 0) & (carry[5] < MAX_STEPS)

    def advance_step(carry):
        *state, time_remaining, n_steps = carry
        flight = stepper.flight_series(coeffs, *state)
        max_step = lax.stop_gradient(flight.max_step)
        is_last = time_remaining <= max_step
        step_time = choose(is_last, time_remaining, max_step)
        dx, dv = stepper.step_increments(coeffs, *state, step_time, flight.terms)
        angle = coeffs.frequency * step_time
        new_phasor = flow.rotate(*state[2:], flow.cos_less_1(angle), flow.sin_by_series(angle))
        new_state = (state[0] + dx, state[1] + dv, *new_phasor, choose(is_last, 0.0, time_remaining - step_time))
        new_state = jax.tree.map(
            lambda updated, current: choose(time_remaining > 0, updated, current), new_state, (*state, time_remaining)
        )
        return *new_state, n_steps + 1

    initial_carry = (x + zero, v + zero, cosine + zero, sine + zero, time + zero, jnp.int32(0))
    x, v, cosine, sine, time_remaining, _ = lax.while_loop(is_unfinished, advance_step, initial_carry)
    failed = time_remaining > 0
    return (*(choose(failed, jnp.nan, value) for value in (x, v)), cosine, sine)


def fly_with_matrix(coeffs, x, v, cosine, sine, time):
    """Return ((x, v) after a time, derivative with respect to the initial state as in `flow_matrix.apply_matrix`)."""

    def final_state(x, v):
        return fly(coeffs, x, v, cosine, sine, time)[:2]

    def directional_derivative(x_direction, v_direction):
        return jax.jvp(final_state, (x, v), (x_direction + 0.0 * x, v_direction + 0.0 * v))

    identity = jnp.eye(2, dtype=jnp.result_type(x))
    state, (x_gradient, v_gradient) = jax.vmap(directional_derivative, out_axes=(None, 0))(identity[0], identity[1])
    return state, (x_gradient[0], x_gradient[1], v_gradient[1], v_gradient[0])


def propagate_matrix(coeffs, state, cosine, sine, time):
    """Return (state, cosine, sine, matrix of the flow by rows) after a time; `state` is (x, v)."""
    state, (p00, p01, p11, p10) = fly_with_matrix(coeffs, *state, cosine, sine, time)
    return state, *flow.rotate_by_angle(cosine, sine, coeffs.frequency * time), (p00, p01, p10, p11)


def flight_map(coeffs, duration):
    """Return the map of (x, v, cosine, sine) over a fixed duration."""
    return lambda *state: fly(coeffs, *state, duration)


def reverse_time(coeffs):
    """Return the coefficients of the flow with time reversed."""
    force_law = replace(coeffs.force_law, function=_reverse_force(coeffs.force_law.function))
    return coeffs._replace(
        force_law=force_law,
        drive_terms=tuple(replace(term, sine=-term.sine, series=None) for term in coeffs.drive_terms),
    )


@lru_cache(256)
def _reverse_force(function):
    """Return a force as a function with time reversed."""

    def reversed_force(t, x, v, params):
        return function(-t, x, -v, params)

    return reversed_force
