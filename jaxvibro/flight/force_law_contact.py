"""Compute contact phases inside a soft wall under a user-defined force, for paths and as smooth functions."""

from functools import partial
from typing import NamedTuple

import jax
import jax.numpy as jnp
from jax import lax
from jaxtyping import Bool, Float

from ..compiled.compiler_hints import choose, minimum, stage
from ..scene.codes import Contact
from . import force_law_flow, force_law_series, taylor
from .flight_state import CAPPED, split_motion
from .force_law_series import ContactState
from .rigid_contact import extra_force as extra_force
from .rigid_contact import max_step as max_step
from .rigid_contact import prepare_step as prepare_step  # these four are as for rigid walls
from .rigid_contact import target_wall as target_wall
from .soft_contact import is_inside
from .taylor_steps import as_derivatives
from .wall_motion import wall_jet_on_side

INITIAL_PERIODS = 1e-9  # initial time, in drive periods, of a mass that is pressed into a wall from rest


def active_path(path):
    """Return the path of the lanes that take a step; lanes inside a wall wait there."""
    return path._replace(time_remaining=choose(is_inside(path.contact), 0.0, path.time_remaining))


def initial_wait(zero):
    """Return the initial wait count, see `linear_contact.initial_wait`."""
    return zero


def advance_waiting(coeffs, path, wait_count, is_due, is_idle):
    """Return (path, wait count), see `rigid_contact.advance_waiting`.

    The lanes complete their contact phase once one has waited long enough, or all lanes that can wait do.
    """
    path = lax.cond(is_due | is_idle, partial(traverse_contacts, coeffs), lambda operand: operand, path)
    return path, jnp.zeros_like(wait_count)


def traverse_contacts(coeffs, path):
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
    inside = is_inside(path.contact) & (path.time_remaining > 0)
    side = stage(_contact_side, path.contact)
    start, start_delay, exits_at_once = stage(_initial_state, coeffs, path, inside, side)
    time_remaining = choose(inside & ~exits_at_once, path.time_remaining - start_delay, 0.0)
    passage = force_law_flow.traverse_contact(coeffs, side, start, time_remaining, path.time_remaining_low)
    return stage(_path_after_contact, coeffs, path, passage, inside, exits_at_once, side)


def _contact_side(contact):
    """Return the side of the contact, 1 without one."""
    return choose(contact < 0, lax.full_like(contact, -1.0), 1.0)


def _initial_state(coeffs, path, inside, side):
    """Return (`ContactState`, elapsed time, exits at once), with finite placeholder values in lanes outside."""
    depth, depth_rate = side * path.x, side * path.v
    at_surface = (lax.abs(path.contact) == Contact.ENTERED) | (depth <= 0)
    inward_accel = inward_acceleration(coeffs, side, jnp.zeros_like(depth_rate), path.cosine, path.sine)
    without_speed = at_surface & (depth_rate == 0)
    starts_from_rest = without_speed & (inward_accel > 0)
    start_delay = minimum(INITIAL_PERIODS * coeffs.period + 0.0 * inward_accel, 0.5 * path.time_remaining)
    start_delay = choose(starts_from_rest & inside, start_delay, 0.0)
    scale = choose(at_surface & ~starts_from_rest, depth_rate, 1.0)
    scaled_root = choose(
        starts_from_rest,
        lax.sqrt(choose(starts_from_rest, 0.5 * inward_accel, 0.0)) * start_delay,
        lax.sqrt(choose(at_surface, 0.0, depth)),
    )
    scaled_rate = choose(starts_from_rest, inward_accel * start_delay, choose(at_surface, 1.0, depth_rate))
    exits_at_once = inside & at_surface & ~starts_from_rest & (depth_rate <= 0)
    active = inside & ~exits_at_once
    start = ContactState(
        *(choose(active, *pair) for pair in ((scaled_root, 1.0), (scaled_rate, 0.0), (scale, 1.0))),
        path.cosine,
        path.sine,
    )
    return start, start_delay, exits_at_once


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
        Acceleration into the wall, relative to the wall and including its force.
    """
    zero, ones = jnp.zeros_like(cosine), jnp.ones_like(cosine)
    return force_law_series.contact_series(
        coeffs, side, ContactState(zero, ones, depth_rate, cosine, sine), 2
    ).scaled_rate[2]


def _path_after_contact(coeffs, path, passage, inside, exits_at_once, side):
    """Return the path with the lanes inside a wall at the end of their passage."""
    state = passage.state
    exits = passage.exits | exits_at_once
    wall_position, wall_velocity = _wall_state(coeffs, side, state.cosine, state.sine)
    depth_root = state.scale * state.scaled_root
    relative_x, relative_v = (
        side * (depth_root * depth_root),
        side * choose(exits_at_once, side * path.v, state.scale * state.scaled_rate),
    )
    x, v = choose(exits, wall_position, relative_x), choose(exits, wall_velocity + relative_v, relative_v)
    next_motion = split_motion(coeffs, x, v, state.cosine, state.sine)
    complete = (passage.time_remaining == 0) | exits
    time_remaining = choose(exits_at_once, path.time_remaining, choose(complete, passage.time_remaining, CAPPED))
    remaining_low = choose(
        exits_at_once,
        path.time_remaining_low,
        choose(complete & (passage.time_remaining > 0), passage.time_remaining_low, 0.0),
    )
    contact = side * choose(exits, lax.full_like(side, float(Contact.LANDED)), float(Contact.WITHIN))
    zero = lax.full_like(x, 0.0)
    next_path = path._replace(
        x=x,
        x_low=zero,
        v=v,
        motion=next_motion,
        time_remaining=time_remaining,
        time_remaining_low=remaining_low,
        contact=contact,
    )
    return force_law_series.select_lanes(inside, next_path, path)


def _wall_state(coeffs, side, cosine, sine):
    """Return (position, velocity) of the wall on a side."""
    wall_position, wall_velocity = wall_jet_on_side(coeffs, side, cosine, sine, 1)
    return wall_position, jnp.zeros_like(cosine) if wall_velocity is None else wall_velocity


class ContactPhase(NamedTuple):
    """Result of a contact phase inside a soft wall.

    Attributes
    ----------
    exits : array of bool
        True if the mass leaves the wall in time.
    duration : array
        Contact duration, or the available time if the mass does not leave.
    depth : array
        Depth at the end.
    depth_rate : array
        Rate of the depth at the end.
    """

    exits: Bool[jax.Array, "*lanes"]
    duration: Float[jax.Array, "*lanes"]
    depth: Float[jax.Array, "*lanes"]
    depth_rate: Float[jax.Array, "*lanes"]


def entry_state(speed, cosine, sine, mask=None):
    """Build the state of lanes that enter a wall.

    Parameters
    ----------
    speed : array
        Speed of entry relative to the wall.
    cosine : array
        Cosine of the drive angle.
    sine : array
        Sine of the drive angle.
    mask : array of bool, optional
        Lanes that enter. Other lanes get finite placeholder values. None selects all lanes.

    Returns
    -------
    ContactState
        State at the depth 0.
    """
    zero = jnp.zeros_like(speed)
    if mask is None:
        return ContactState(zero, zero + 1.0, speed, cosine, sine)
    return ContactState(*(choose(mask, *pair) for pair in ((zero, 1.0), (zero + 1.0, 0.0), (speed, 1.0))), cosine, sine)


def fly_contact_phase(coeffs, side, start, time_remaining, delay, order, passage=None):
    """Compute a contact phase with derivatives correct to an order.

    The span of s is a constant. Taylor polynomials move the end of the phase.

    Parameters
    ----------
    coeffs : FlowCoefficients
        Coefficients of the scene.
    side : array
        Side of the wall, -1 or 1.
    start : ContactState
        Initial state.
    time_remaining : array
        Available time, a constant.
    delay : array
        Delay of the start of the phase. Its value is 0; its derivatives count.
    order : int
        Order of the derivatives.
    passage : ContactPassage, optional
        Result of `force_law_flow.traverse_contact` if known.

    Returns
    -------
    ContactPhase
        Result of the phase. Duration and rate are nan if too many steps are needed.
    """
    passage = passage or force_law_flow.traverse_contact(*lax.stop_gradient((coeffs, side, start, time_remaining)))
    state, elapsed = force_law_flow.fly_s_span(coeffs, side, start, lax.stop_gradient(passage.s_span))
    exit_rate, exit_time = _exit_rate_and_delay(coeffs, side, state, order)
    depth_root = state.scale * state.scaled_root
    depth, depth_rate = depth_after_delay(
        coeffs,
        side,
        state,
        depth_root * depth_root,
        state.scale * state.scaled_rate,
        time_remaining - elapsed - delay,
        order,
    )
    has_failed = ~(passage.exits | (passage.time_remaining == 0))
    depth_rate = choose(has_failed, jnp.nan, choose(passage.exits, exit_rate, depth_rate))
    exit_time = choose(has_failed, jnp.nan, choose(passage.exits, elapsed + exit_time, time_remaining - delay))
    return ContactPhase(passage.exits, exit_time, choose(passage.exits, 0.0, depth), depth_rate)


def _exit_rate_and_delay(coeffs, side, state, order):
    """Return (rate of the depth, delay) at the exit; the delay is 0 up to derivatives and rounding."""
    terms = force_law_series.contact_series(coeffs, side, state, order + 1)
    root_derivs, rate, time = (as_derivatives(series) for series in terms)
    exit_s = taylor.locate_root(root_derivs[: order + 1], order)
    rate, time = (taylor.evaluate_taylor(series, exit_s, order) for series in (rate, time))
    return state.scale * rate, time


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
        Delay. Its value is 0 up to rounding; its derivatives count.
    order : int
        Order of the derivatives.

    Returns
    -------
    tuple of array
        Depth and its rate.
    """
    jets = force_law_series.depth_jets(coeffs, side, state, depth, depth_rate, order)
    return tuple(taylor.evaluate_taylor(jet, delay, order) for jet in jets)
