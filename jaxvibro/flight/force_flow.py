"""What moves the mass between walls: a force of the user's own, by Taylor's steps, or by those of a solver where the
force has one. The interface is that of `spring_flow`."""

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

LINEAR = False  # a flight's matrix depends on where it begins
RATE_FACTOR = 2.0  # times the change of the press where hops begin: faster it may not change while they last
MAX_STEPS = 100_000  # of a flight of any time: more would be a hang


class Lookahead(NamedTuple):
    """What a step knows of the flight ahead: a `taylor_steps.Ahead`; the `ContactForceJet` on each wall where a lane
    rests on one, else zeros."""

    flight: taylor_steps.FlightSeries
    contact_forces: list[ContactForceJet]


def stepper_of(coeffs):
    """What steps the flight: `taylor_steps`, or `solver_steps`, which nothing else loads."""
    return taylor_steps if coeffs.force_law.solver is None else import_module(".solver_steps", __package__)


def look_ahead(coeffs, path):
    """(frame, `Lookahead`): the frame with the longest step of each lane."""
    flight = stepper_of(coeffs).flight_series(coeffs, path.x, path.v, path.cosine, path.sine)
    max_step, contact_forces = flight.max_step, []
    if coeffs.walls:
        contact_forces = _contact_forces_if_stuck(coeffs, path)
        max_step = stage(_sticking_max_step, path.contact, max_step, [force.max_step for force in contact_forces])
    return stage(_with_max_step, coeffs, max_step), Lookahead(flight, contact_forces)


def _with_max_step(coeffs, max_step):
    return coeffs._replace(
        max_step=max_step, inverse_max_step=1.0 / max_step, taylor_weights=event.taylor_weights(max_step)
    )


def _sticking_max_step(contact, max_step, max_steps):
    """The longest step of each lane: of one that rests that of the press, however fast it would move."""
    return choose(lax.abs(contact) == Contact.STUCK, reduce(minimum, max_steps), max_step)


def _contact_forces_if_stuck(coeffs, path):
    return lax.cond(
        jnp.any(lax.abs(path.contact) == Contact.STUCK), _contact_forces, _zero_contact_forces, coeffs, path
    )


def _contact_forces(coeffs, path):
    stepper = stepper_of(coeffs)
    return [stage(stepper.contact_force_jet, coeffs, wall, path.cosine, path.sine) for wall in coeffs.walls]


def _zero_contact_forces(coeffs, path):
    zero = lax.full_like(path.x, 0.0)
    return [ContactForceJet([zero] * event.N_TERMS, zero, zero) for _ in coeffs.walls]


def event_derivatives(coeffs, path, lookahead, extra_force):
    """x and its derivatives, as many as an event has terms and one."""
    return stage(as_derivatives, lookahead.flight.terms[: event.N_TERMS + 1])


def lookahead_bounds(lookahead):
    """What of a `Lookahead` says how the walls press, and what is beyond the derivatives: arrays."""
    return lookahead.contact_forces, lookahead.flight.remainder_bound


def contact_forces_ahead(coeffs, path, bounds):
    """[(the press on a wall, its derivatives; a bound on what is beyond them)] for each wall."""
    return [(force.derivatives, force.remainder_bound) for force in bounds[0]]


def remainder_bound(coeffs, derivatives, bounds, is_sticking, force_remainder, wall_remainder, taylor_weights):
    """What is beyond the terms of an event, in lengths, of lanes that are free and that rest."""
    return choose(is_sticking, force_remainder, bounds[1]) + wall_remainder * taylor_weights[event.N_TERMS]


def advance_motion(coeffs, motion, time, contact, lookahead):
    """The motion a step later."""
    return _propagate(coeffs, motion, time, lookahead.flight.terms)


def propagate(coeffs, motion, time, contact=None):
    """The `SlowMotion` a time later, no longer than a step."""
    return _propagate(coeffs, motion, time)


def _propagate(coeffs, motion, time, terms=None):
    """terms: the coefficients of x, where known."""
    x, _, v = stage(motion_state, coeffs, motion)
    dx, dv = stepper_of(coeffs).step_increments(coeffs, x, v, motion.cosine, motion.sine, time, terms)
    slow_parts = stage(add_increments, motion, dx, dv)
    return SlowMotion(*slow_parts, *stage(rotate_drive, coeffs.frequency, motion.cosine, motion.sine, time))


def acceleration_and_jerk(coeffs, x, v, cosine, sine, extra_force=()):
    """The acceleration of a free mass, and its rate of change."""
    return tuple(jet(coeffs, x, v, cosine, sine, 3)[2:])


def jet(coeffs, x, v, cosine, sine, order, extra_force=()):
    """x and its derivatives up to an order."""
    return stepper_of(coeffs).derivatives(coeffs, x, v, cosine, sine, order)


def jet_at_point(coeffs, point, order, extra_force=()):
    """x and its derivatives, one more than the order, at a `taylor.Now`."""
    return jet(coeffs, point.x, point.v, point.cosine, point.sine, order + 1)


def propagate_back(coeffs, point, x, v, delay, order, extra_force=()):
    """x and v now of a flight that is at x, v a little later."""
    phasor = flow.rotate_by_angle(point.cosine, point.sine, coeffs.frequency * delay)
    derivs = jet(coeffs, x, v, *phasor, order + 1)
    return evaluate_taylor(derivs, -delay, order), evaluate_taylor(derivs[1:], -delay, order)


def contact_force(coeffs, wall, cosine, sine, order):
    """How hard a mass that rests on the wall is driven along x relative to it, and its derivatives."""
    return as_derivatives(stepper_of(coeffs).contact_force_terms(coeffs, wall, cosine, sine, order))


def chatter_bounds(coeffs, side, acceleration, approach_speed, cosine, sine):
    """What says whether hops on a wall end: (how fast the press on it changes at most; the damping that the force has,
    from the acceleration before an impact at so much speed; how fast the force away from the wall grows with the
    distance, at least 1), as estimated where they begin."""
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
    """Half of the shortest of the first steps of some `flight_clearance.Flight`s, a scalar."""
    stepper = stepper_of(coeffs)
    max_steps = stepper.sampling_step(
        coeffs, stepper.flight_series(coeffs, flights.x, flights.v, flights.cosine, flights.sine).max_step
    )
    return jnp.minimum(coeffs.max_step, 0.5 * jnp.min(max_steps))


def fly(coeffs, x, v, cosine, sine, time):
    """(x, v, cosine, sine) after any time >= 0, with derivatives, forward; nan where that takes too many steps."""
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
    """((x, v) a time after; how they change with x, v at the start, a matrix as `response.through` takes it)."""

    def final_state(x, v):
        return fly(coeffs, x, v, cosine, sine, time)[:2]

    def directional_derivative(x_direction, v_direction):
        return jax.jvp(final_state, (x, v), (x_direction + 0.0 * x, v_direction + 0.0 * v))

    identity = jnp.eye(2, dtype=jnp.result_type(x))
    state, (x_gradient, v_gradient) = jax.vmap(directional_derivative, out_axes=(None, 0))(identity[0], identity[1])
    return state, (x_gradient[0], x_gradient[1], v_gradient[1], v_gradient[0])


def propagate_matrix(coeffs, state, cosine, sine, time):
    """(place, cosine, sine, the flow's matrix by rows) a time after; state: (x, v)."""
    state, (p00, p01, p11, p10) = fly_with_matrix(coeffs, *state, cosine, sine, time)
    return state, *flow.rotate_by_angle(cosine, sine, coeffs.frequency * time), (p00, p01, p10, p11)


def flight_map(coeffs, duration):
    """(x, v, cosine, sine) -> the same a time after, for the same time again and again."""
    return lambda *state: fly(coeffs, *state, duration)


def reverse_time(coeffs):
    """The frame of the flow with time reversed."""
    force_law = replace(coeffs.force_law, function=_reverse_force(coeffs.force_law.function))
    return coeffs._replace(
        force_law=force_law,
        drive_terms=tuple(replace(term, sine=-term.sine, series=None) for term in coeffs.drive_terms),
    )


@lru_cache(256)
def _reverse_force(function):
    """A force as it is seen with time reversed."""

    def reversed_force(t, x, v, params):
        return function(-t, x, -v, params)

    return reversed_force
