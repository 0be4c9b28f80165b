"""Stays within a soft wall beside a force of the user's own: of lanes on their path, and as smooth functions."""

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
from .rigid_contact import prepare_step as prepare_step  # a free flight's, as are these
from .rigid_contact import target_wall as target_wall
from .soft_contact import is_inside
from .taylor_steps import as_derivatives
from .wall_motion import wall_jet_on_side

INITIAL_PERIODS = 1e-9  # drive periods, after which a mass that is pressed into a wall from rest is on its way


def active_path(path):
    """The path of the lanes that a step is for: what is within a wall waits there."""
    return path._replace(time_remaining=choose(is_inside(path.contact), 0.0, path.time_remaining))


def initial_wait(zero):
    """As `spring_stay.unbegun`."""
    return zero


def advance_waiting(coeffs, path, wait_count, is_due, is_idle):
    """As `no_stay.paused`: through the whole stay, once all that can wait does, or one has waited long enough."""
    path = lax.cond(is_due | is_idle, partial(traverse_contacts, coeffs), lambda operand: operand, path)
    return path, jnp.zeros_like(wait_count)


def traverse_contacts(coeffs, path):
    """The path with the lanes that are within a soft wall carried to where they leave it, or to their end."""
    inside = is_inside(path.contact) & (path.time_remaining > 0)
    side = stage(_contact_side, path.contact)
    start, start_delay, exits_at_once = stage(_initial_state, coeffs, path, inside, side)
    time_remaining = choose(inside & ~exits_at_once, path.time_remaining - start_delay, 0.0)
    passage = force_law_flow.traverse_contact(coeffs, side, start, time_remaining, path.time_remaining_low)
    return stage(_path_after_contact, coeffs, path, passage, inside, exits_at_once, side)


def _contact_side(contact):
    return choose(contact < 0, lax.full_like(contact, -1.0), 1.0)


def _initial_state(coeffs, path, inside, side):
    """(`ContactState`, a time that is gone by then, whether the lane leaves at once); benign in lanes that are
    outside."""
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
    """The acceleration into the wall of a mass that it pushes, at the depth 0 and with this rate of it."""
    zero, ones = jnp.zeros_like(cosine), jnp.ones_like(cosine)
    return force_law_series.contact_series(
        coeffs, side, ContactState(zero, ones, depth_rate, cosine, sine), 2
    ).scaled_rate[2]


def _path_after_contact(coeffs, path, passage, inside, exits_at_once, side):
    """The path with the lanes that were inside where they are now."""
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
    """(position, velocity) of the wall on a side."""
    wall_position, wall_velocity = wall_jet_on_side(coeffs, side, cosine, sine, 1)
    return wall_position, jnp.zeros_like(cosine) if wall_velocity is None else wall_velocity


class ContactPhase(NamedTuple):
    """What a stay does. exits: whether the wall is left in time; duration: how long it takes, or how long it was given;
    depth and its rate at the end."""

    exits: Bool[jax.Array, "*lanes"]
    duration: Float[jax.Array, "*lanes"]
    depth: Float[jax.Array, "*lanes"]
    depth_rate: Float[jax.Array, "*lanes"]


def entry_state(speed, cosine, sine, mask=None):
    """The `ContactState` of lanes that enter a wall with a speed; benign in those that do not."""
    zero = jnp.zeros_like(speed)
    if mask is None:
        return ContactState(zero, zero + 1.0, speed, cosine, sine)
    return ContactState(*(choose(mask, *pair) for pair in ((zero, 1.0), (zero + 1.0, 0.0), (speed, 1.0))), cosine, sine)


def fly_contact_phase(coeffs, side, start, time_remaining, delay, order, passage=None):
    """The `ContactPhase` from a `ContactState` on, for at most so much time, with derivatives right to an order.

    It takes so much of s as it takes, a constant; its end is moved by Taylor polynomials. time_remaining: a constant;
    delay: 0, with derivatives: how much later the stay begins. passage: its `pushed_flow.Passage`, where that is known.
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
    """(the depth's rate, how much later) where the mass leaves, 0 later but for derivatives and rounding."""
    terms = force_law_series.contact_series(coeffs, side, state, order + 1)
    root_derivs, rate, time = (as_derivatives(series) for series in terms)
    exit_s = taylor.locate_root(root_derivs[: order + 1], order)
    rate, time = (taylor.evaluate_taylor(series, exit_s, order) for series in (rate, time))
    return state.scale * rate, time


def depth_after_delay(coeffs, side, state, depth, depth_rate, delay, order):
    """(depth, its rate) within the wall a time later, 0 but for derivatives and rounding; of a `ContactState` the
    drive's cosine and sine."""
    jets = force_law_series.depth_jets(coeffs, side, state, depth, depth_rate, order)
    return tuple(taylor.evaluate_taylor(jet, delay, order) for jet in jets)
