"""Start the path of a state: apply the rules for a start on a wall and reject invalid starts."""

from dataclasses import replace

import jax.numpy as jnp
from jax import lax

from ..compiled.lane_arithmetic import choose, positive_part
from ..scene.state import Contact, Status
from . import event_certificates, impact
from .flight_coefficients import check_validity
from .flight_state import Path, SlowMotion, make_slow_motion
from .motion_in_soft_wall import is_inside_soft_wall
from .wall_motion import max_wall_distance, subtract_optional, wall_jet

MAX_LENGTH_EXPONENT = 0.4  # squares and products of two lengths below largest**0.4 stay finite


def start_path(coeffs, state, check_scene_rules=check_validity):
    """Start a path at a state.

    Parameters
    ----------
    coeffs : FlowCoefficients
        Coefficients of the scene.
    state : State
        Initial state.
    check_scene_rules : callable, optional
        Function that returns the result of `check_validity` from the coefficients.

    Returns
    -------
    path : Path
        Path with no time remaining.
    status : array
        `Status.OK`, `Status.INVALID` or `Status.NONFINITE` for each lane.

    Notes
    -----
    A mass that starts on a wall and moves into the wall is free, so that the impact is its first event. A mass that
    moves away has the contact code `Contact.LANDED`. At zero relative speed the contact force decides, and if this
    force is also zero, its time derivative (`impact.contact_after_event`). Positions and velocities whose square would
    underflow are set to 0. The status is `Status.NONFINITE` if a number is not finite, or if the square of the largest
    length of state and scene would underflow or overflow.
    """
    cosine, sine = jnp.cos(state.phase), jnp.sin(state.phase)
    is_valid, is_finite = check_scene_rules(coeffs)
    for state_component in (state.x, state.v, cosine, state.contact):
        is_finite &= jnp.isfinite(state_component)
    float_info = jnp.finfo(jnp.result_type(state.x))
    min_squarable_length = event_certificates.min_squarable_length(float_info.dtype)
    x, v = (choose(abs(component) > min_squarable_length, component, 0.0) for component in (state.x, state.v))
    largest_length = jnp.maximum(coeffs.length_scale, jnp.maximum(abs(x), abs(v)))
    is_finite &= (largest_length >= min_squarable_length) & (
        largest_length < float(float_info.max) ** MAX_LENGTH_EXPONENT
    )
    state, zero = replace(state, x=x, v=v), jnp.zeros_like(state.x)
    cosine, sine = cosine + zero, sine + zero
    zero_slow_motion = SlowMotion(zero, zero, zero, zero, cosine, sine)
    path = Path(state.x + zero, zero, state.v + zero, zero_slow_motion, zero, zero, zero)
    contact_code = abs(state.contact) + zero
    is_valid &= (
        (contact_code == 0)
        | (contact_code == Contact.LANDED)
        | (contact_code == Contact.STUCK)
        | (contact_code == Contact.WITHIN)
    )
    has_wall_for_contact = contact_code == 0
    for wall, contact in zip(coeffs.walls, coeffs.kinds.wall_contacts, strict=True):
        wall_state = wall_jet(wall, coeffs.frequency, cosine, sine, 1)
        contact_on_wall = state.contact * wall.sign
        is_inside_wall = is_inside_soft_wall(
            path.contact
        )  # inside the previous wall, relative to which x and v are measured
        path_at_wall = path._replace(
            x=choose(is_inside_wall, state.x + zero, path.x), v=choose(is_inside_wall, state.v + zero, path.v)
        )
        path_at_wall, is_start_allowed = contact.start_at_wall(coeffs, wall, wall_state, path_at_wall, contact_on_wall)
        field_pairs = zip(
            (path.x, path.v, path.contact), (path_at_wall.x, path_at_wall.v, path_at_wall.contact), strict=True
        )
        path = path._replace(
            **dict(zip(("x", "v", "contact"), (choose(is_inside_wall, *pair) for pair in field_pairs), strict=True))
        )
        is_valid &= is_start_allowed
        has_wall_for_contact |= contact_on_wall > 0
    is_inside_wall = coeffs.contact.inside_mask(path.contact)
    if is_inside_wall is not None:
        coeffs = coeffs._replace(in_phase_amplitude=choose(is_inside_wall, 0.0, coeffs.in_phase_amplitude + zero))
    path = path._replace(motion=make_slow_motion(coeffs, path.x, path.v, cosine, sine))
    status = choose(
        is_finite,
        choose(is_valid & has_wall_for_contact, lax.full_like(zero, Status.OK), Status.INVALID),
        Status.NONFINITE,
    )
    return path, status


def start_at_soft_wall(coeffs, wall, wall_state, path, contact_on_wall):
    """Apply the start rules of a soft wall: return (path, mask of the lanes with an admissible start).

    A mass beyond the position of the wall starts inside the wall, and x and v are then relative to the wall.
    """
    wall_position, optional_wall_velocity = wall_state
    wall_velocity = jnp.zeros_like(wall_position) if optional_wall_velocity is None else optional_wall_velocity
    depth, approach_speed = wall.sign * (path.x - wall_position), wall.sign * (path.v - wall_velocity)
    machine_epsilon = 2.0 * event_certificates.unit_roundoff(depth.dtype)
    surface_tolerance = _contact_tolerance(wall, depth)
    has_within_code, has_landed_on_wall = contact_on_wall == Contact.WITHIN, contact_on_wall == Contact.LANDED
    is_at_surface = has_landed_on_wall | (abs(depth) <= surface_tolerance) | (has_within_code & (depth <= 0))
    contact_force, force_rate = impact.wall_state_and_force(coeffs, path.x * 0.0 + wall.sign, path.cosine, path.sine)[
        2:
    ]
    contact_force, force_rate = wall.sign * contact_force, wall.sign * force_rate
    is_pressed_on_wall = (contact_force > 0) | ((contact_force == 0) & (force_rate > 0))
    starts_inside = choose(
        is_at_surface, has_within_code & (approach_speed > 0) | (approach_speed == 0) & is_pressed_on_wall, depth > 0
    )
    starts_leaving = is_at_surface & ~starts_inside & (has_landed_on_wall | (approach_speed <= 0))
    loose_length_tolerance = machine_epsilon**0.5 * coeffs.length_scale
    is_start_allowed = ~(has_within_code | has_landed_on_wall) | (
        choose(has_landed_on_wall, abs(depth), -depth) <= loose_length_tolerance
    )
    is_start_allowed &= ~has_landed_on_wall | (
        approach_speed <= machine_epsilon**0.5 * (abs(path.v) + coeffs.length_scale * (1.0 + coeffs.frequency))
    )
    new_contact_code = choose(
        starts_inside,
        choose(is_at_surface, Contact.ENTERED, lax.full_like(depth, Contact.WITHIN)),
        choose(starts_leaving, Contact.LANDED, lax.full_like(depth, 0.0)),
    )
    new_x = choose(
        starts_inside, choose(is_at_surface, 0.0, wall.sign * depth), choose(is_at_surface, wall_position, path.x)
    )
    new_v = choose(starts_inside, path.v - wall_velocity, path.v)
    is_in_contact = starts_inside | starts_leaving
    return path._replace(
        x=new_x, v=new_v, contact=choose(is_in_contact, wall.sign * new_contact_code, path.contact)
    ), is_start_allowed & (contact_on_wall != Contact.STUCK)


def start_at_rigid_wall(coeffs, wall, wall_state, path, contact_on_wall):
    """Apply the start rules of a rigid wall: return (path, mask of the lanes with an admissible start).

    `contact_on_wall` is the contact times the sign of the wall.
    """
    wall_position, optional_wall_velocity = wall_state
    signed_wall_distance = wall.sign * ((wall_position - path.x) + path.x_low_part)
    approach_speed = wall.sign * subtract_optional(path.v, optional_wall_velocity)
    machine_epsilon = 2.0 * event_certificates.unit_roundoff(signed_wall_distance.dtype)
    surface_tolerance = _contact_tolerance(wall, signed_wall_distance)
    loose_relative_tol = machine_epsilon**0.5
    has_contact_code = contact_on_wall > 0
    is_at_surface = ~has_contact_code & (abs(signed_wall_distance) <= surface_tolerance)
    is_start_allowed = choose(
        has_contact_code,
        abs(signed_wall_distance) <= loose_relative_tol * coeffs.length_scale,
        signed_wall_distance >= -surface_tolerance,
    )
    speed_scale = abs(path.v) + coeffs.length_scale * (1.0 + coeffs.frequency)
    checked_speed = choose(contact_on_wall == Contact.STUCK, abs(approach_speed), approach_speed)
    is_start_allowed &= ~has_contact_code | (checked_speed <= loose_relative_tol * speed_scale)
    contact_force_and_rate = [
        wall.sign * value
        for value in impact.wall_state_and_force(coeffs, path.x * 0.0 + wall.sign, path.cosine, path.sine)[2:]
    ]
    departure_speed = choose(contact_on_wall == Contact.STUCK, 0.0, positive_part(-approach_speed))
    new_contact = wall.sign * impact.contact_after_event(coeffs, departure_speed, *contact_force_and_rate)
    is_in_contact = has_contact_code | (is_at_surface & (approach_speed <= 0))
    moves_with_wall = is_in_contact & ((abs(new_contact) == Contact.STUCK) | (departure_speed == 0))
    wall_velocity = jnp.zeros_like(signed_wall_distance) if optional_wall_velocity is None else optional_wall_velocity
    return path._replace(
        x=choose(is_in_contact | is_at_surface, wall_position, path.x),
        v=choose(moves_with_wall, wall_velocity, path.v),
        contact=choose(is_in_contact, new_contact, path.contact),
    ), is_start_allowed & (contact_on_wall != Contact.WITHIN)


def _contact_tolerance(wall, template):
    """Return the tolerance of a start on a wall: 0 for a fixed wall, a few rounding errors for a moving wall."""
    return (
        jnp.zeros_like(template)
        if wall.amplitude is None
        else 8.0 * event_certificates.unit_roundoff(template.dtype) * max_wall_distance(wall)
    )
