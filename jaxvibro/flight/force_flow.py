"""Fly a mass under a user-defined force, by Taylor steps or by the steps of a solver.

The module is a `protocols.Flow`.
"""

from dataclasses import replace
from functools import lru_cache, reduce
from importlib import import_module
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax import lax

from ..compiled.lane_arithmetic import call_without_inlining, choose, maximum, minimum
from ..scene.scene_properties import frequency_and_damping
from ..scene.state import Contact
from . import event_certificates, flow, further_drive_terms, taylor_steps
from .flight_coefficients import FlowCoefficients, common_fields
from .flight_state import SlowMotion, add_to_slow_motion, rotate_drive_phasor, state_of_slow_motion
from .flow_defaults import (  # noqa: F401
    acceleration_and_jerk,
    flight_map,
    fly_with_matrix,
    jet_at_point,
    matrix_state,
    propagate_with_matrix,
    state_before_delay,
)
from .taylor_steps import ContactForceJet, derivatives_from_terms
from .wall_motion import select_lists_by_side, wall_derivative_bounds, wall_jet, wall_jet_on_side

RATE_FACTOR = 2.0  # bound on the rate of the contact force during chatter, relative to its rate at the start
MAX_STEPS = 100_000  # largest number of steps of a flight


class StepLookahead(NamedTuple):
    """Series of the flight and of the contact forces, expanded at the start of a step.

    Attributes
    ----------
    flight_series : FlightSeries
        Series of the flight.
    contact_force_jets : list of ContactForceJet
        Contact force on each wall if any lane sticks, zeros otherwise.
    """

    flight_series: taylor_steps.FlightSeries
    contact_force_jets: list[ContactForceJet]


def make_coefficients(scene, kinds):
    """Compute the `FlowCoefficients` of a scene with a user-defined force."""
    fields = common_fields(scene, kinds)
    frequency, walls = fields["frequency"], fields["walls"]
    max_harmonic = max((wall.harmonic for wall in walls if wall.amplitude is not None), default=1)
    max_harmonic = max(max_harmonic, further_drive_terms.highest_harmonic(fields["drive_terms"]))
    zero, max_step = jnp.zeros_like(frequency), flow.MAX_SCALED_STEP / (frequency * max_harmonic)
    return FlowCoefficients(
        **fields,
        damping=zero,
        in_phase_amplitude=zero,
        max_step=max_step,
        inverse_max_step=1.0 / max_step,
        taylor_weights=event_certificates.taylor_weights(max_step),
        wall_remainder_bounds=tuple(
            wall_derivative_bounds(wall, zero, frequency, zero, event_certificates.N_TERMS)[1] for wall in walls
        ),
        user_force=jax.tree.map(lambda param: jnp.asarray(param, scene.dtype), scene.force),
    )


def steady_amplitude(scene, amplitude, frequency):
    """Return the amplitude of a free mass under a harmonic force, at most that of the force."""
    return amplitude / np.maximum(1.0, frequency**2)


def rates(scene):
    """Return the rate of the drive and those of the linearised force at the walls."""
    return [float(scene.frequency), *frequency_and_damping(scene)]


def loses_energy(scene):
    """Return True if the force depends on the velocity at one of the states that `frequency_and_damping` examines."""
    return frequency_and_damping(scene)[1] > 0


def areas_may_grow():
    """Return True, because the force may feed energy."""
    return True


def has_unique_free_response():
    """Return False, because the equations of an orbit without impacts may have several solutions."""
    return False


def require_reversible(scene):
    """Accept every scene: a user-defined force can be reversed in time."""


def stepper_module_of(coeffs):
    """Return the module that steps the flight: `taylor_steps`, or `solver_steps`, which is imported on demand only."""
    return taylor_steps if coeffs.user_force.solver is None else import_module(".solver_steps", __package__)


def prepare_lookahead(coeffs, path):
    """Return (coefficients with the longest step of each lane, `StepLookahead`)."""
    flight_series = stepper_module_of(coeffs).flight_series(coeffs, path.x, path.v, path.cosine, path.sine)
    max_step, contact_force_jets = flight_series.max_step, []
    if coeffs.walls:
        contact_force_jets = _contact_forces_if_stuck(coeffs, path)
        max_step = call_without_inlining(
            _max_step_if_sticking, path.contact, max_step, [force_jet.max_step for force_jet in contact_force_jets]
        )
    return call_without_inlining(_coeffs_with_max_step, coeffs, max_step), StepLookahead(
        flight_series, contact_force_jets
    )


def _coeffs_with_max_step(coeffs, max_step):
    """Return the coefficients with another longest step."""
    return coeffs._replace(
        max_step=max_step, inverse_max_step=1.0 / max_step, taylor_weights=event_certificates.taylor_weights(max_step)
    )


def _max_step_if_sticking(contact, max_step, contact_max_steps):
    """Return the longest step of each lane, which only the contact force limits for a sticking mass."""
    return choose(lax.abs(contact) == Contact.STUCK, reduce(minimum, contact_max_steps), max_step)


def _contact_forces_if_stuck(coeffs, path):
    """Return the contact forces if any lane sticks, zeros otherwise."""
    return lax.cond(
        jnp.any(lax.abs(path.contact) == Contact.STUCK), _contact_forces, _zero_contact_forces, coeffs, path
    )


def _contact_forces(coeffs, path):
    """Return the contact force on each wall."""
    stepper = stepper_module_of(coeffs)
    return [
        call_without_inlining(stepper.contact_force_jet, coeffs, wall, path.cosine, path.sine) for wall in coeffs.walls
    ]


def _zero_contact_forces(coeffs, path):
    """Return a contact force of zero on each wall."""
    zero = lax.full_like(path.x, 0.0)
    return [ContactForceJet([zero] * event_certificates.N_TERMS, zero, zero) for _ in coeffs.walls]


def motion_derivatives(coeffs, path, lookahead, frame_force):
    """Return x and its derivatives up to order `event_certificates.N_TERMS`."""
    return call_without_inlining(
        derivatives_from_terms, lookahead.flight_series.terms[: event_certificates.N_TERMS + 1]
    )


def forces_and_remainder(lookahead):
    """Return (contact forces, bound on the remainder of the flight) of a `StepLookahead`."""
    return lookahead.contact_force_jets, lookahead.flight_series.remainder_bound


def contact_forces_ahead(coeffs, path, forces_and_remainder):
    """Return [(contact force and its derivatives, bound on the remainder)] for each wall."""
    return [(force_jet.derivatives, force_jet.remainder_bound) for force_jet in forces_and_remainder[0]]


def remainder_bound(
    coeffs,
    derivatives,
    forces_and_remainder,
    is_sticking,
    contact_remainder_bound,
    wall_remainder_bound,
    taylor_weights,
):
    """Return the bound on the remainder of an event's polynomial, in lengths, for free and for sticking lanes."""
    return (
        choose(is_sticking, contact_remainder_bound, forces_and_remainder[1])
        + wall_remainder_bound * taylor_weights[event_certificates.N_TERMS]
    )


def advance_motion(coeffs, motion, time, lookahead):
    """Return the motion after a step."""
    return _propagate_motion(coeffs, motion, time, lookahead.flight_series.terms)


def propagate_motion(coeffs, motion, time):
    """Return the `SlowMotion` after a time of at most one step."""
    return _propagate_motion(coeffs, motion, time)


def _propagate_motion(coeffs, motion, time, position_terms=None):
    """Return the `SlowMotion` after a time; `position_terms` are the Taylor coefficients of x, or None if unknown."""
    x, _, v = call_without_inlining(state_of_slow_motion, coeffs, motion)
    dx, dv = stepper_module_of(coeffs).step_increments(coeffs, x, v, motion.cosine, motion.sine, time, position_terms)
    slow_parts = call_without_inlining(add_to_slow_motion, motion, dx, dv)
    return SlowMotion(
        *slow_parts, *call_without_inlining(rotate_drive_phasor, coeffs.frequency, motion.cosine, motion.sine, time)
    )


def jet(coeffs, x, v, cosine, sine, order, frame_force=()):
    """Return x and its derivatives up to an order."""
    return stepper_module_of(coeffs).position_derivatives(coeffs, x, v, cosine, sine, order)


def contact_force(coeffs, wall, cosine, sine, order):
    """Return the force along x on a sticking mass relative to the wall, and its derivatives."""
    return derivatives_from_terms(stepper_module_of(coeffs).contact_taylor_terms(coeffs, wall, cosine, sine, order))


def chatter_bounds(coeffs, side, acceleration, approach_speed, cosine, sine):
    """Return (rate bound, damping, bound on the force gradient), estimated at the start of chatter on a wall.

    The rate bound limits the time derivative of the contact force. The damping is half of the difference between the
    contact force and the acceleration relative to the wall before an impact, over the approach speed. The third result
    is the derivative of the force with respect to x, at least 1.
    """
    rate_bound_and_damping = select_lists_by_side(
        side,
        coeffs.walls,
        [_wall_chatter_bounds(coeffs, wall, acceleration, approach_speed, cosine, sine) for wall in coeffs.walls],
    )
    wall_position, wall_velocity = wall_jet_on_side(coeffs, side, cosine, sine, 1)
    zero = jnp.zeros_like(cosine)
    force_gradient_bound = stepper_module_of(coeffs).force_derivative_in_x(
        coeffs, wall_position + zero, zero if wall_velocity is None else wall_velocity + zero, cosine, sine
    )
    return *rate_bound_and_damping, choose(force_gradient_bound > 1.0, force_gradient_bound, 1.0)


def _wall_chatter_bounds(coeffs, wall, acceleration, approach_speed, cosine, sine):
    """Return (rate bound, damping) of chatter on one wall."""
    contact_force, force_rate, force_curvature = derivatives_from_terms(
        stepper_module_of(coeffs).contact_taylor_terms(coeffs, wall, cosine, sine, 2)
    )
    force_rate_bound = RATE_FACTOR * (lax.abs(force_rate) + coeffs.max_step * lax.abs(force_curvature))
    wall_acceleration = wall_jet(wall, coeffs.frequency, cosine, sine, 2)[2]
    damping_force = lax.abs(
        acceleration - contact_force if wall_acceleration is None else acceleration - contact_force - wall_acceleration
    )
    return force_rate_bound, 0.5 * damping_force / maximum(
        lax.abs(approach_speed), jnp.full_like(approach_speed, jnp.finfo(approach_speed.dtype).tiny)
    )


def sampling_time_scale(coeffs, flights):
    """Return half of the shortest sampling step at the start of `flight_clearance.Flight`s, at most the longest step.

    The result is a scalar.
    """
    stepper = stepper_module_of(coeffs)
    sampling_steps = stepper.sampling_step(
        coeffs, stepper.flight_series(coeffs, flights.x, flights.v, flights.cosine, flights.sine).max_step
    )
    return jnp.minimum(coeffs.max_step, 0.5 * jnp.min(sampling_steps))


def fly(coeffs, x, v, cosine, sine, time):
    """Return (x, v, cosine, sine) after any time >= 0; x and v are nan if the flight needs too many steps.

    Only forward-mode derivatives are supported.
    """
    zero = jnp.zeros(jnp.broadcast_shapes(*map(jnp.shape, (x, v, cosine, sine, time))), jnp.result_type(x))
    stepper = stepper_module_of(coeffs)

    def is_unfinished(carry):
        return jnp.any(carry[4] > 0) & (carry[5] < MAX_STEPS)

    def advance_step(carry):
        *state, time_remaining, n_steps = carry
        flight_series = stepper.flight_series(coeffs, *state)
        max_step = lax.stop_gradient(flight_series.max_step)
        is_last_step = time_remaining <= max_step
        step_time = choose(is_last_step, time_remaining, max_step)
        dx, dv = stepper.step_increments(coeffs, *state, step_time, flight_series.terms)
        angle = coeffs.frequency * step_time
        new_phasor = flow.rotate_phasor(*state[2:], flow.cos_less_1(angle), flow.sin_by_series(angle))
        new_state = (state[0] + dx, state[1] + dv, *new_phasor, choose(is_last_step, 0.0, time_remaining - step_time))
        new_state = jax.tree.map(
            lambda updated, current: choose(time_remaining > 0, updated, current), new_state, (*state, time_remaining)
        )
        return *new_state, n_steps + 1

    initial_carry = (x + zero, v + zero, cosine + zero, sine + zero, time + zero, jnp.int32(0))
    x, v, cosine, sine, time_remaining, _ = lax.while_loop(is_unfinished, advance_step, initial_carry)
    has_failed = time_remaining > 0
    return (*(choose(has_failed, jnp.nan, value) for value in (x, v)), cosine, sine)


def reverse_time(coeffs):
    """Return the coefficients of the flow with time reversed."""
    reversed_user_force = replace(coeffs.user_force, function=_reverse_force(coeffs.user_force.function))
    return coeffs._replace(
        user_force=reversed_user_force,
        drive_terms=tuple(replace(term, sine=-term.sine, series=None) for term in coeffs.drive_terms),
    )


@lru_cache(256)
def _reverse_force(function):
    """Return a force as a function with time reversed."""

    def reversed_force(t, x, v, params):
        return function(-t, x, -v, params)

    return reversed_force
