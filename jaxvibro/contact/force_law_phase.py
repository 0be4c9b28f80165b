"""Compute contact phases inside a soft wall under a user-defined force, for paths and as smooth functions."""

import jax.numpy as jnp
from jax import lax

from ..compiled.lane_arithmetic import call_without_inlining, choose, minimum
from ..flight import force_law_motion_series, force_law_passage, taylor_polynomials
from ..flight.flight_state import CAPPED
from ..flight.force_law_motion_series import ContactState
from ..flight.motion_in_soft_wall import is_inside_soft_wall
from ..flight.taylor_steps import derivatives_from_terms
from ..scene.state import Contact
from .contact_duration import path_inside_wall
from .phase_ends import ContactResult, path_after_contact, side_of_contact

INITIAL_PERIODS = 1e-9  # initial time, in drive periods, of a mass that is pressed into a wall from rest


def complete_contact_phases(coeffs, path):
    """Advance lanes inside a soft wall to their exit or to the end of their time.

    Parameters
    ----------
    coeffs : FlowCoefficients
        Coefficients of the scene.
    path : Path
        Path of the lanes.

    Returns
    -------
    Path
        Path after the contact phases. Other lanes do not change.
    """
    is_inside_wall = is_inside_soft_wall(path.contact) & (path.time_remaining > 0)
    side = call_without_inlining(side_of_contact, path.contact)
    start_state, start_delay, exits_immediately = call_without_inlining(
        _initial_contact_state, coeffs, path, is_inside_wall, side
    )
    time_remaining = choose(is_inside_wall & ~exits_immediately, path.time_remaining - start_delay, 0.0)
    contact_passage = force_law_passage.traverse_contact(
        coeffs, side, start_state, time_remaining, path.time_remaining_low_part
    )
    return call_without_inlining(
        _path_after_contact, coeffs, path, contact_passage, is_inside_wall, exits_immediately, side
    )


def contact_duration(
    coeffs, contact_code, relative_displacement, relative_velocity, drive_cosine, drive_sine, max_duration
):
    """Return the time after which lanes within a wall leave the wall, at most `max_duration`; without derivatives.

    The result is nan if the limit on the steps is exceeded.
    """
    path = complete_contact_phases(
        coeffs,
        path_inside_wall(
            contact_code, relative_displacement, relative_velocity, drive_cosine, drive_sine, max_duration
        ),
    )
    remaining_at_exit = choose(path.time_remaining == CAPPED, jnp.nan, path.time_remaining)
    return choose(
        is_inside_soft_wall(contact_code),
        (max_duration - remaining_at_exit) - path.time_remaining_low_part,
        0.0 * max_duration,
    )


def _initial_contact_state(coeffs, path, is_inside_wall, side):
    """Return (`ContactState`, delay of the start, mask of lanes that exit at once); lanes outside get placeholders."""
    depth, depth_rate = side * path.x, side * path.v
    is_at_surface = (lax.abs(path.contact) == Contact.ENTERED) | (depth <= 0)
    inward_accel = inward_acceleration(coeffs, side, jnp.zeros_like(depth_rate), path.cosine, path.sine)
    has_zero_speed = is_at_surface & (depth_rate == 0)
    starts_from_rest = has_zero_speed & (inward_accel > 0)
    start_delay = minimum(INITIAL_PERIODS * coeffs.period + 0.0 * inward_accel, 0.5 * path.time_remaining)
    start_delay = choose(starts_from_rest & is_inside_wall, start_delay, 0.0)
    speed_scale = choose(is_at_surface & ~starts_from_rest, depth_rate, 1.0)
    scaled_depth_root = choose(
        starts_from_rest,
        lax.sqrt(choose(starts_from_rest, 0.5 * inward_accel, 0.0)) * start_delay,
        lax.sqrt(choose(is_at_surface, 0.0, depth)),
    )
    scaled_depth_rate = choose(starts_from_rest, inward_accel * start_delay, choose(is_at_surface, 1.0, depth_rate))
    exits_immediately = is_inside_wall & is_at_surface & ~starts_from_rest & (depth_rate <= 0)
    is_active = is_inside_wall & ~exits_immediately
    start_state = ContactState(
        *(
            choose(is_active, *pair)
            for pair in ((scaled_depth_root, 1.0), (scaled_depth_rate, 0.0), (speed_scale, 1.0))
        ),
        path.cosine,
        path.sine,
    )
    return start_state, start_delay, exits_immediately


def inward_acceleration(coeffs, side, depth_rate, cosine, sine):
    """Compute the acceleration into a wall at depth 0.

    Parameters
    ----------
    coeffs : FlowCoefficients
        Coefficients of the scene.
    side : array
        Side of the wall, -1 or 1.
    depth_rate : array
        Rate of the depth.
    cosine : array
        Cosine of the drive angle.
    sine : array
        Sine of the drive angle.

    Returns
    -------
    array
        Acceleration into the wall, relative to the wall and including the contact force.
    """
    zero, ones = jnp.zeros_like(cosine), jnp.ones_like(cosine)
    return force_law_motion_series.contact_series(
        coeffs, side, ContactState(zero, ones, depth_rate, cosine, sine), 2
    ).scaled_depth_rate[2]


def _path_after_contact(coeffs, path, contact_passage, is_inside_wall, exits_immediately, side):
    """Return the path with the lanes inside a wall at the end of their passage."""
    state = contact_passage.state
    has_exited = contact_passage.has_exited | exits_immediately
    depth_root = state.scale * state.scaled_depth_root
    next_path = path_after_contact(
        coeffs,
        path,
        side,
        has_exited,
        depth_root * depth_root,
        choose(exits_immediately, side * path.v, state.scale * state.scaled_depth_rate),
        state.cosine,
        state.sine,
    )
    is_complete = (contact_passage.time_remaining == 0) | has_exited
    time_remaining = choose(
        exits_immediately, path.time_remaining, choose(is_complete, contact_passage.time_remaining, CAPPED)
    )
    time_remaining_low_part = choose(
        exits_immediately,
        path.time_remaining_low_part,
        choose(is_complete & (contact_passage.time_remaining > 0), contact_passage.time_remaining_low_part, 0.0),
    )
    next_path = next_path._replace(time_remaining=time_remaining, time_remaining_low_part=time_remaining_low_part)
    return force_law_motion_series.select_lanes(is_inside_wall, next_path, path)


def entry_state(entry_speed, cosine, sine, enters_wall=None):
    """Build the state of lanes that enter a wall.

    Parameters
    ----------
    entry_speed : array
        Speed of entry relative to the wall.
    cosine : array
        Cosine of the drive angle.
    sine : array
        Sine of the drive angle.
    enters_wall : array of bool, optional
        Mask of the lanes that enter. Other lanes get finite placeholder values. None selects all lanes.

    Returns
    -------
    ContactState
        State at depth 0.
    """
    zero = jnp.zeros_like(entry_speed)
    if enters_wall is None:
        return ContactState(zero, zero + 1.0, entry_speed, cosine, sine)
    return ContactState(
        *(choose(enters_wall, *pair) for pair in ((zero, 1.0), (zero + 1.0, 0.0), (entry_speed, 1.0))), cosine, sine
    )


def fly_contact_phase(coeffs, side, start_state, time_remaining, start_delay, order, contact_passage=None):
    """Compute a contact phase with derivatives correct to an order.

    The span of the scaled time s (`force_law_motion_series`) is constant under differentiation. Taylor polynomials
    correct the end of the phase.

    Parameters
    ----------
    coeffs : FlowCoefficients
        Coefficients of the scene.
    side : array
        Side of the wall, -1 or 1.
    start_state : ContactState
        Initial state.
    time_remaining : array
        Available time, a constant.
    start_delay : array
        Delay of the start of the phase. The value is 0; only the derivatives matter.
    order : int
        Order of the derivatives.
    contact_passage : ContactPassage, optional
        Result of `force_law_passage.traverse_contact` if known.

    Returns
    -------
    ContactResult
        Result of the phase. Duration and rate of the depth are nan if too many steps are needed.
    """
    contact_passage = contact_passage or force_law_passage.traverse_contact(
        *lax.stop_gradient((coeffs, side, start_state, time_remaining))
    )
    state, elapsed_time = force_law_passage.fly_scaled_time_span(
        coeffs, side, start_state, lax.stop_gradient(contact_passage.scaled_time_span)
    )
    exit_depth_rate, exit_time = _exit_rate_and_delay(coeffs, side, state, order)
    depth_root = state.scale * state.scaled_depth_root
    depth, depth_rate = depth_after_delay(
        coeffs,
        side,
        state,
        depth_root * depth_root,
        state.scale * state.scaled_depth_rate,
        time_remaining - elapsed_time - start_delay,
        order,
    )
    has_failed = ~(contact_passage.has_exited | (contact_passage.time_remaining == 0))
    depth_rate = choose(has_failed, jnp.nan, choose(contact_passage.has_exited, exit_depth_rate, depth_rate))
    exit_time = choose(
        has_failed, jnp.nan, choose(contact_passage.has_exited, elapsed_time + exit_time, time_remaining - start_delay)
    )
    return ContactResult(
        contact_passage.has_exited, exit_time, choose(contact_passage.has_exited, 0.0, depth), depth_rate
    )


def _exit_rate_and_delay(coeffs, side, state, order):
    """Return (rate of the depth, delay) at the exit; the value of the delay is 0 up to rounding."""
    contact_series = force_law_motion_series.contact_series(coeffs, side, state, order + 1)
    depth_root_derivs, depth_rate_derivs, time_derivs = (derivatives_from_terms(series) for series in contact_series)
    exit_scaled_time = taylor_polynomials.locate_root_near_zero(depth_root_derivs[: order + 1], order)
    depth_rate_derivs, time_derivs = (
        taylor_polynomials.evaluate_taylor(series, exit_scaled_time, order)
        for series in (depth_rate_derivs, time_derivs)
    )
    return state.scale * depth_rate_derivs, time_derivs


def depth_after_delay(coeffs, side, state, depth, depth_rate, delay, order):
    """Compute the depth and its rate after a delay.

    Parameters
    ----------
    coeffs : FlowCoefficients
        Coefficients of the scene.
    side : array
        Side of the wall, -1 or 1.
    state : ContactState
        State of which the cosine and sine of the drive angle are used.
    depth : array
        Depth.
    depth_rate : array
        Rate of the depth.
    delay : array
        Delay. The value is 0 up to rounding; only the derivatives matter.
    order : int
        Order of the derivatives.

    Returns
    -------
    tuple of array
        Depth and its rate.
    """
    depth_and_rate_jets = force_law_motion_series.depth_jets(coeffs, side, state, depth, depth_rate, order)
    return tuple(taylor_polynomials.evaluate_taylor(jet, delay, order) for jet in depth_and_rate_jets)
