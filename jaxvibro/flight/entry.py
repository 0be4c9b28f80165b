"""Start the path of a state: apply the rules for a start on a wall and reject invalid starts."""

from dataclasses import replace

import jax.numpy as jnp
from jax import lax

from ..compiled.compiler_hints import choose, positive_part
from ..scene.codes import Contact, Status
from . import event, impact
from .coefficients import check_validity
from .flight_state import Path, SlowMotion, split_motion
from .soft_contact import is_inside
from .soft_wall_lanes import in_soft_wall
from .wall_motion import subtract, wall_extent, wall_jet

MAX_LENGTH_EXPONENT = 0.4  # squares and products of two lengths below largest**0.4 stay finite


def start_path(coeffs, state, check_rules=check_validity):
    """Start a path at a state.

    Parameters
    ----------
    coeffs : FlowCoefficients
        Coefficients of the scene.
    state : State
        Initial state.
    check_rules : callable, optional
        Function from the coefficients to (valid, finite) of the scene.

    Returns
    -------
    path : Path
        Path with no time remaining.
    status : array
        `Status.OK`, `Status.INVALID` or `Status.NONFINITE` for each lane.

    Notes
    ----- A mass that starts on a wall and moves into it is free, so that the impact is its first event. A mass that
    moves away has landed and leaves. Without relative speed the contact force decides, then its rate
    (`impact.next_contact`). Positions and velocities whose square would underflow are set to 0. A start is not finite
    if the largest length of state and scene would underflow or overflow when squared.
    """
    cosine, sine = jnp.cos(state.phase), jnp.sin(state.phase)
    valid, finite = check_rules(coeffs)
    for value in (state.x, state.v, cosine, state.contact):
        finite &= jnp.isfinite(value)
    kind = jnp.finfo(jnp.result_type(state.x))
    min_length = event.smallest_length(kind.dtype)
    x, v = (choose(abs(pair) > min_length, pair, 0.0) for pair in (state.x, state.v))
    largest_length = jnp.maximum(coeffs.length_scale, jnp.maximum(abs(x), abs(v)))
    finite &= (largest_length >= min_length) & (largest_length < float(kind.max) ** MAX_LENGTH_EXPONENT)
    state, zero = replace(state, x=x, v=v), jnp.zeros_like(state.x)
    cosine, sine = cosine + zero, sine + zero
    motion_at_rest = SlowMotion(zero, zero, zero, zero, cosine, sine)
    path = Path(state.x + zero, zero, state.v + zero, motion_at_rest, zero, zero, zero)
    kind = abs(state.contact) + zero
    valid &= (kind == 0) | (kind == Contact.LANDED) | (kind == Contact.STUCK) | (kind == Contact.WITHIN)
    has_known_contact = kind == 0
    for wall, soft_flow in zip(coeffs.walls, coeffs.soft_flows, strict=True):
        wall_state = wall_jet(wall, coeffs.frequency, cosine, sine, 1)
        wall_contact = state.contact * wall.sign
        is_inside_wall = is_inside(path.contact)  # inside the previous wall, relative to which x and v are measured
        wall_path = path._replace(
            x=choose(is_inside_wall, state.x + zero, path.x), v=choose(is_inside_wall, state.v + zero, path.v)
        )
        wall_path, is_allowed = (_start_at_rigid_wall if soft_flow is None else _start_at_soft_wall)(
            coeffs, wall, wall_state, wall_path, wall_contact
        )
        field_pairs = zip((path.x, path.v, path.contact), (wall_path.x, wall_path.v, wall_path.contact), strict=True)
        path = path._replace(
            **dict(zip(("x", "v", "contact"), (choose(is_inside_wall, *pair) for pair in field_pairs), strict=True))
        )
        valid &= is_allowed & (wall_contact != (Contact.WITHIN if soft_flow is None else Contact.STUCK))
        has_known_contact |= wall_contact > 0
    is_inside_wall = in_soft_wall(coeffs, path.contact)
    if is_inside_wall is not None:
        coeffs = coeffs._replace(swift_amplitude=choose(is_inside_wall, 0.0, coeffs.swift_amplitude + zero))
    path = path._replace(motion=split_motion(coeffs, path.x, path.v, cosine, sine))
    status = choose(
        finite, choose(valid & has_known_contact, lax.full_like(zero, Status.OK), Status.INVALID), Status.NONFINITE
    )
    return path, status


def _start_at_soft_wall(coeffs, wall, wall_state, path, wall_contact):
    """Apply the start rules of a soft wall: return (path, is_allowed).

    Beyond the wall the mass starts inside it, and x and v are relative to the wall.
    """
    wall_position, velocity_or_none = wall_state
    wall_velocity = jnp.zeros_like(wall_position) if velocity_or_none is None else velocity_or_none
    depth, approach_speed = wall.sign * (path.x - wall_position), wall.sign * (path.v - wall_velocity)
    eps = 2.0 * event.unit_roundoff(depth.dtype)
    tolerance = _contact_tolerance(wall, depth)
    is_within, is_landed = wall_contact == Contact.WITHIN, wall_contact == Contact.LANDED
    at_surface = is_landed | (abs(depth) <= tolerance) | (is_within & (depth <= 0))
    contact_force, force_rate = impact.wall_surface(coeffs, path.x * 0.0 + wall.sign, path.cosine, path.sine)[2:]
    contact_force, force_rate = wall.sign * contact_force, wall.sign * force_rate
    is_pressed = (contact_force > 0) | ((contact_force == 0) & (force_rate > 0))
    starts_inside = choose(at_surface, is_within & (approach_speed > 0) | (approach_speed == 0) & is_pressed, depth > 0)
    starts_leaving = at_surface & ~starts_inside & (is_landed | (approach_speed <= 0))
    loose_tolerance = eps**0.5 * coeffs.length_scale
    is_allowed = ~(is_within | is_landed) | (choose(is_landed, abs(depth), -depth) <= loose_tolerance)
    is_allowed &= ~is_landed | (
        approach_speed <= eps**0.5 * (abs(path.v) + coeffs.length_scale * (1.0 + coeffs.frequency))
    )
    contact_kind = choose(
        starts_inside,
        choose(at_surface, Contact.ENTERED, lax.full_like(depth, Contact.WITHIN)),
        choose(starts_leaving, Contact.LANDED, lax.full_like(depth, 0.0)),
    )
    new_x = choose(starts_inside, choose(at_surface, 0.0, wall.sign * depth), choose(at_surface, wall_position, path.x))
    new_v = choose(starts_inside, path.v - wall_velocity, path.v)
    in_contact = starts_inside | starts_leaving
    return path._replace(
        x=new_x, v=new_v, contact=choose(in_contact, wall.sign * contact_kind, path.contact)
    ), is_allowed


def _start_at_rigid_wall(coeffs, wall, wall_state, path, wall_contact):
    """Apply the start rules of a rigid wall: return (path, is_allowed).

    `wall_contact` is the contact times the sign of the wall.
    """
    wall_position, velocity_or_none = wall_state
    gap = wall.sign * ((wall_position - path.x) + path.x_low)
    approach_speed = wall.sign * subtract(path.v, velocity_or_none)
    eps = 2.0 * event.unit_roundoff(gap.dtype)
    tolerance = _contact_tolerance(wall, gap)
    loose_factor = eps**0.5
    is_touching = wall_contact > 0
    at_surface = ~is_touching & (abs(gap) <= tolerance)
    is_allowed = choose(is_touching, abs(gap) <= loose_factor * coeffs.length_scale, gap >= -tolerance)
    speed_scale = abs(path.v) + coeffs.length_scale * (1.0 + coeffs.frequency)
    excess_speed = choose(wall_contact == Contact.STUCK, abs(approach_speed), approach_speed)
    is_allowed &= ~is_touching | (excess_speed <= loose_factor * speed_scale)
    force_and_rate = [
        wall.sign * value for value in impact.wall_surface(coeffs, path.x * 0.0 + wall.sign, path.cosine, path.sine)[2:]
    ]
    rebound_speed = choose(wall_contact == Contact.STUCK, 0.0, positive_part(-approach_speed))
    new_contact = wall.sign * impact.next_contact(coeffs, rebound_speed, *force_and_rate)
    in_contact = is_touching | (at_surface & (approach_speed <= 0))
    moves_with_wall = in_contact & ((abs(new_contact) == Contact.STUCK) | (rebound_speed == 0))
    wall_velocity = jnp.zeros_like(gap) if velocity_or_none is None else velocity_or_none
    return path._replace(
        x=choose(in_contact | at_surface, wall_position, path.x),
        v=choose(moves_with_wall, wall_velocity, path.v),
        contact=choose(in_contact, new_contact, path.contact),
    ), is_allowed


def _contact_tolerance(wall, depth):
    """Return the distance within which a start is on a moving wall, whose position callers know only up to rounding."""
    return (
        jnp.zeros_like(depth) if wall.amplitude is None else 8.0 * event.unit_roundoff(depth.dtype) * wall_extent(wall)
    )
