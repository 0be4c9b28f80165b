"""Apply the impact law y+ - v_b = -R (y- - v_b) (paper, (4)) and the rules for a mass without rebound speed."""

from typing import NamedTuple

import jax
from jax import lax
from jaxtyping import Float

from ..compiled.compiler_hints import choose, minimum, positive_part, two_sum
from ..scene.codes import Contact
from . import event, flow
from .contact_laws import contact_law_of
from .flight_state import CAPPED, Path, SlowMotion, split_motion
from .flows import flow_of
from .soft_contact import is_soft_side, restitution_of
from .soft_wall_lanes import in_soft_wall, relative_wall_derivs
from .wall_motion import select_lists_by_side, subtract, wall_jet_on_side

CHATTER_SPEED = -1.0  # smallest speed that marks a complete chatter
BOUNCE_TIME_FACTOR = 4.85  # 2 (1 + sqrt(2)), plus a margin for rounding
MAX_RELATIVE_CHANGE = 0.25  # largest relative change of a speed up to the event; a larger one is due to rounding


class EventOutcome(NamedTuple):
    """Outcome of an event.

    Attributes
    ----------
    approach_speed : array
        Speed relative to the wall before the event. Negative if the event is the exit from a soft wall.
    least_speed : array
        Smallest speed of the impacts that the event implies.
    contact : array
        Contact after the event, times the sign of the wall.
    """

    approach_speed: Float[jax.Array, "*lanes"]
    least_speed: Float[jax.Array, "*lanes"]
    contact: Float[jax.Array, "*lanes"]


def event_delay(coeffs, path, side):
    """Return the time from the end of a step to its event by one Halley step, from within `event.landing_tolerance`.

    The residual of a slow impact may be rounding error. It is not divided by the speed; the delay is then 0.
    """
    phasor = path.cosine, path.sine
    wall_position, wall_velocity, wall_acceleration = wall_jet_on_side(coeffs, side, *phasor, 2)
    force_lists = [flow_of(coeffs).contact_force(coeffs, wall, *phasor, 1) for wall in coeffs.walls]
    contact_force, force_rate = select_lists_by_side(side, coeffs.walls, force_lists)
    acceleration, _ = _acceleration_and_jerk(coeffs, path)
    wall_position, wall_velocity, wall_acceleration = relative_wall_derivs(
        in_soft_wall(coeffs, path.contact), side, (wall_position, wall_velocity, wall_acceleration)
    )
    relative_velocity, relative_accel = subtract(path.v, wall_velocity), subtract(acceleration, wall_acceleration)
    is_sticking = lax.abs(path.contact) == Contact.STUCK
    time = choose(is_sticking, -contact_force, (wall_position - path.x) - path.x_low) / choose(
        is_sticking, force_rate, relative_velocity
    )
    relative_change = choose(is_sticking, time * coeffs.inverse_max_step, relative_accel * time / relative_velocity)
    time = time * choose(is_sticking, 1.0, 1.0 - 0.5 * relative_change)
    return choose((side != 0) & (lax.abs(relative_change) < MAX_RELATIVE_CHANGE), time, 0.0)


def resolve_event(coeffs, path, side, delay):
    """Return the `EventOutcome` of an event: rebound, sticking or release.

    Lanes without an event keep their contact.
    """
    is_sticking = lax.abs(path.contact) == Contact.STUCK
    cosine, sine = _rotate_drive(coeffs, path, delay)
    _, wall_velocity, contact_force, force_rate = wall_surface(
        coeffs, choose(is_sticking, path.contact, side), cosine, sine
    )
    acceleration, jerk = _acceleration_and_jerk(coeffs, path)
    is_inside_wall = in_soft_wall(coeffs, path.contact)
    (wall_velocity,) = relative_wall_derivs(is_inside_wall, side, (wall_velocity,))
    approach_speed = side * (path.v + delay * (acceleration + 0.5 * delay * jerk) - wall_velocity)
    restitution = restitution_of(coeffs, side)
    rebound_speed = restitution * approach_speed
    rebound_speed = choose(lax.abs(rebound_speed) > event.smallest_length(rebound_speed.dtype), rebound_speed, 0.0)
    new_contact = next_contact(coeffs, rebound_speed, side * contact_force, side * force_rate)
    force_rate_bound, damping, force_growth = flow_of(coeffs).chatter_bounds(
        coeffs, side, acceleration, approach_speed, cosine, sine
    )
    chatter_completes = is_complete_chatter(
        coeffs._replace(damping=damping),
        rebound_speed,
        side * contact_force,
        restitution,
        force_rate_bound,
        path.time_remaining,
        force_growth,
    )
    new_contact = choose(is_sticking, Contact.RELEASED, choose(chatter_completes, Contact.STUCK, new_contact))
    if is_inside_wall is not None:
        new_contact = choose(
            is_inside_wall, Contact.LANDED, choose(is_soft_side(coeffs, side), Contact.ENTERED, new_contact)
        )
    least_speed = choose((new_contact == Contact.STUCK) & (rebound_speed > 0), CHATTER_SPEED, approach_speed)
    return EventOutcome(
        choose(is_sticking, 0.0, approach_speed), least_speed, choose(side != 0, side * new_contact, path.contact)
    )


def _acceleration_and_jerk(coeffs, path):
    """Return the acceleration of the mass and its rate."""
    extra_force = contact_law_of(coeffs).extra_force(coeffs, path)
    return flow_of(coeffs).acceleration_and_jerk(coeffs, path.x, path.v, path.cosine, path.sine, extra_force)


def apply_event(coeffs, path, side, delay, outcome, step_time):
    """Return the path after the event.

    Lanes without an event continue. A sticking mass stays on its wall. For a mass that enters a soft wall, x and v
    become relative to the wall.
    """
    cosine, sine = _rotate_drive(coeffs, path, delay)
    is_sticking = lax.abs(path.contact) == Contact.STUCK
    wall_position, wall_velocity, _, _ = wall_surface(coeffs, choose(is_sticking, path.contact, side), cosine, sine)
    at_wall = (side != 0) | is_sticking
    rebound_speed = restitution_of(coeffs, side) * outcome.approach_speed
    rebounds = lax.abs(outcome.contact) == Contact.LANDED
    is_inside_wall = in_soft_wall(coeffs, path.contact)
    if is_inside_wall is not None:
        enters_wall = (side != 0) & (lax.abs(outcome.contact) == Contact.ENTERED)
        rebounds |= enters_wall
        rebound_speed = choose(enters_wall | is_inside_wall, -outcome.approach_speed, rebound_speed)
        wall_position, wall_velocity = relative_wall_derivs(enters_wall, side, (wall_position, wall_velocity))
        coeffs = coeffs._replace(swift_amplitude=choose(enters_wall, 0.0, coeffs.swift_amplitude))
    new_velocity = wall_velocity - side * choose(rebounds, rebound_speed, 0.0)
    x, v = choose(at_wall, wall_position, path.x), choose(at_wall, new_velocity, path.v)
    new_motion = split_motion(coeffs, wall_position, new_velocity, cosine, sine)
    slow_parts = (
        choose(at_wall, new_value, old_value)
        for new_value, old_value in zip(new_motion[:4], path.motion[:4], strict=True)
    )
    new_motion = SlowMotion(*slow_parts, cosine, sine)
    time_remaining, time_remaining_low = two_sum(path.time_remaining, path.time_remaining_low - delay)
    is_free_flight = (step_time > 0) & ~at_wall
    contact = choose(is_free_flight, 0.0, outcome.contact)
    if is_inside_wall is not None:
        is_inside_wall &= side == 0
        contact = choose(is_inside_wall & (step_time > 0), lax.sign(path.contact) * Contact.WITHIN, contact)
    time_remaining = choose(path.time_remaining == CAPPED, CAPPED, positive_part(time_remaining))
    return Path(x, choose(at_wall, 0.0, path.x_low), v, new_motion, time_remaining, time_remaining_low, contact)


def _rotate_drive(coeffs, path, delay):
    """Return the phasor of the drive after a delay."""
    angle = coeffs.frequency * delay
    return flow.rotate(path.cosine, path.sine, -0.5 * angle * angle, angle)


def wall_surface(coeffs, side, cosine, sine):
    """Compute the motion of a wall and the contact force on a mass that sticks to it.

    Parameters
    ----------
    coeffs : FlowCoefficients
        Coefficients of the scene.
    side : array
        Side of the wall, -1 or 1.
    cosine : array
        Cosine of the drive angle.
    sine : array
        Sine of the drive angle.

    Returns
    -------
    position : array
        Position of the wall.
    velocity : array
        Velocity of the wall.
    contact_force : array
        Force along x on the sticking mass relative to the wall. It presses the mass on the wall if it has the sign of
        the wall.
    force_rate : array
        Rate of the contact force.
    """
    wall_position, wall_velocity = wall_jet_on_side(coeffs, side, cosine, sine, 1)
    force_lists = [flow_of(coeffs).contact_force(coeffs, wall, cosine, sine, 1) for wall in coeffs.walls]
    return (
        wall_position,
        0.0 if wall_velocity is None else wall_velocity,
        *select_lists_by_side(side, coeffs.walls, force_lists),
    )


def next_contact(coeffs, rebound_speed, contact_force, force_rate):
    """Return the contact that follows on a wall: `LANDED`, `STUCK` or `RELEASED`.

    A bounce of a height below rounding, speed^2 / (2 force), does not count: the mass sticks. Without rebound speed the
    contact force decides, then its rate.
    """
    has_no_speed = rebound_speed == 0
    hop_is_negligible = (contact_force > 0) & (
        rebound_speed * (rebound_speed / coeffs.length_scale)
        <= 4.0 * event.unit_roundoff(contact_force.dtype) * contact_force
    )
    sticks = hop_is_negligible | (has_no_speed & (contact_force == 0) & (force_rate >= 0))
    other_contact = choose(
        has_no_speed & (contact_force == 0), Contact.RELEASED, lax.full_like(contact_force, Contact.LANDED)
    )
    return choose(sticks, Contact.STUCK, other_contact)


def is_complete_chatter(coeffs, rebound_speed, contact_force, restitution, force_rate_bound, time, force_growth=None):
    """Return True if the following infinitely many bounces certainly end within a time: complete chatter.

    Let the contact force stay within force (1 +- e). A bounce with rebound speed u rises for at most u / (force (1 -
    e)) to the height h = u^2 / (2 force (1 - e)). It falls for at most sqrt(2) times as long, provided that damping is
    less than half of the force. It ends with a speed of at most k u, where k^2 = (force (1 + e) + h) / (force (1 - e)).
    The speeds decrease at least like ((1 + R) / 2)^n if R k <= (1 + R) / 2. This condition determines e, and the total
    time is bounded by a geometric series.

    `force_growth` is the growth of the acceleration away from the wall per unit of distance, at least 1. None stands
    for 1.
    """
    decay_squared = 0.25 * (1.0 + restitution) * (1.0 + restitution)
    restitution_squared = restitution * restitution
    max_variation = minimum((decay_squared - restitution_squared) / (decay_squared + 2.0 * restitution_squared), 0.5)
    min_force = contact_force * (1.0 - max_variation)
    chatter_time, speed_squared = BOUNCE_TIME_FACTOR * rebound_speed, rebound_speed * rebound_speed
    scaled_height = speed_squared if force_growth is None else speed_squared * force_growth
    time = time * min_force * (1.0 - restitution)
    variation_small = (
        force_rate_bound * chatter_time <= max_variation * contact_force * min_force * (1.0 - restitution)
    ) & (scaled_height <= 2.0 * max_variation * contact_force * min_force)
    clears_other_wall = (speed_squared < min_force * coeffs.min_wall_gap) & (
        8.0 * coeffs.damping * rebound_speed <= min_force
    )
    return (contact_force > 0) & (rebound_speed > 0) & (chatter_time <= time) & variation_small & clears_other_wall
