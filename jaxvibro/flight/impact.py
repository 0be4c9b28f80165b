"""Apply the impact law v+ - v_b = -R (v- - v_b) (paper, (4)) and the rules for a rebound speed of zero.

v- and v+ are the velocities of the mass before and after the impact, v_b is the velocity of the wall, and R is the
restitution.
"""

from typing import NamedTuple

import jax
from jax import lax
from jaxtyping import Float

from ..compiled.lane_arithmetic import choose, minimum, positive_part, two_sum
from ..scene.state import Contact
from . import event_certificates, flow
from .flight_state import CAPPED, Path, SlowMotion, make_slow_motion
from .motion_in_soft_wall import is_soft_side, restitution_of
from .soft_wall_lanes import wall_jet_in_lane_frame
from .wall_motion import select_lists_by_side, subtract_optional, wall_jet_on_side

CHATTER_SPEED = -1.0  # smallest speed that marks a complete chatter
BOUNCE_TIME_FACTOR = 4.85  # 2 (1 + sqrt(2)), plus a margin for rounding
MAX_RELATIVE_CHANGE = 0.25  # largest relative change of a speed up to the event; a larger one is due to rounding


class EventOutcome(NamedTuple):
    """Outcome of an event.

    Attributes
    ----------
    approach_speed : array
        Speed relative to the wall before the event. Negative if the event is the exit from a soft wall. 0 for a
        release.
    least_speed : array
        `CHATTER_SPEED` if the mass sticks although the rebound speed is positive, that is after a complete chatter.
        Otherwise `approach_speed`.
    contact : array
        Contact after the event, times the sign of the wall.
    """

    approach_speed: Float[jax.Array, "*lanes"]
    least_speed: Float[jax.Array, "*lanes"]
    contact: Float[jax.Array, "*lanes"]


def event_delay(coeffs, path, side):
    """Return the time from the end of a step to its event by one Halley step.

    The magnitude of this time is less than `event_certificates.landing_time_tolerance` longest steps. The residual of a
    slow impact may be rounding error. In this case the result is 0, because a division by the speed would amplify the
    error."""
    phasor = path.cosine, path.sine
    wall_position, wall_velocity, wall_acceleration = wall_jet_on_side(coeffs, side, *phasor, 2)
    contact_force_derivs = [coeffs.flow.contact_force(coeffs, wall, *phasor, 1) for wall in coeffs.walls]
    contact_force, force_rate = select_lists_by_side(side, coeffs.walls, contact_force_derivs)
    acceleration, _ = _acceleration_and_jerk(coeffs, path)
    wall_position, wall_velocity, wall_acceleration = wall_jet_in_lane_frame(
        coeffs.contact.inside_mask(path.contact), side, (wall_position, wall_velocity, wall_acceleration)
    )
    relative_velocity, relative_accel = (
        subtract_optional(path.v, wall_velocity),
        subtract_optional(acceleration, wall_acceleration),
    )
    is_sticking = lax.abs(path.contact) == Contact.STUCK
    delay_to_event = choose(is_sticking, -contact_force, (wall_position - path.x) - path.x_low_part) / choose(
        is_sticking, force_rate, relative_velocity
    )
    relative_speed_change = choose(
        is_sticking, delay_to_event * coeffs.inverse_max_step, relative_accel * delay_to_event / relative_velocity
    )
    delay_to_event = delay_to_event * choose(is_sticking, 1.0, 1.0 - 0.5 * relative_speed_change)
    return choose((side != 0) & (lax.abs(relative_speed_change) < MAX_RELATIVE_CHANGE), delay_to_event, 0.0)


def resolve_event(coeffs, path, side, delay):
    """Return the `EventOutcome` of an event: rebound, sticking, release, or entry into or exit from a soft wall.

    Lanes without an event keep their contact.
    """
    is_sticking = lax.abs(path.contact) == Contact.STUCK
    cosine, sine = flow.rotate_phasor_by_small_angle(path.cosine, path.sine, coeffs.frequency * delay)
    _, wall_velocity, contact_force, force_rate = wall_state_and_force(
        coeffs, choose(is_sticking, path.contact, side), cosine, sine
    )
    acceleration, jerk = _acceleration_and_jerk(coeffs, path)
    is_inside_wall = coeffs.contact.inside_mask(path.contact)
    (wall_velocity,) = wall_jet_in_lane_frame(is_inside_wall, side, (wall_velocity,))
    approach_speed = side * (path.v + delay * (acceleration + 0.5 * delay * jerk) - wall_velocity)
    restitution = restitution_of(coeffs, side)
    rebound_speed = restitution * approach_speed
    rebound_speed = choose(
        lax.abs(rebound_speed) > event_certificates.min_squarable_length(rebound_speed.dtype), rebound_speed, 0.0
    )
    new_contact = contact_after_event(coeffs, rebound_speed, side * contact_force, side * force_rate)
    force_rate_bound, damping, force_gradient_bound = coeffs.flow.chatter_bounds(
        coeffs, side, acceleration, approach_speed, cosine, sine
    )
    chatter_completes = is_complete_chatter(
        coeffs._replace(damping=damping),
        rebound_speed,
        side * contact_force,
        restitution,
        force_rate_bound,
        path.time_remaining,
        force_gradient_bound,
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
    """Return acceleration and jerk of the mass."""
    frame_force = coeffs.contact.frame_force(coeffs, path)
    return coeffs.flow.acceleration_and_jerk(coeffs, path.x, path.v, path.cosine, path.sine, frame_force)


def apply_event(coeffs, path, side, delay, event_outcome, step_time):
    """Return the path after the event.

    Lanes without an event continue their flight. A sticking mass remains on its wall. For a mass that enters a soft
    wall, x and v become relative to the wall.
    """
    cosine, sine = flow.rotate_phasor_by_small_angle(path.cosine, path.sine, coeffs.frequency * delay)
    is_sticking = lax.abs(path.contact) == Contact.STUCK
    wall_position, wall_velocity, _, _ = wall_state_and_force(
        coeffs, choose(is_sticking, path.contact, side), cosine, sine
    )
    is_at_wall = (side != 0) | is_sticking
    rebound_speed = restitution_of(coeffs, side) * event_outcome.approach_speed
    leaves_with_speed = lax.abs(event_outcome.contact) == Contact.LANDED
    is_inside_wall = coeffs.contact.inside_mask(path.contact)
    if is_inside_wall is not None:
        enters_wall = (side != 0) & (lax.abs(event_outcome.contact) == Contact.ENTERED)
        leaves_with_speed |= enters_wall
        rebound_speed = choose(enters_wall | is_inside_wall, -event_outcome.approach_speed, rebound_speed)
        wall_position, wall_velocity = wall_jet_in_lane_frame(enters_wall, side, (wall_position, wall_velocity))
        coeffs = coeffs._replace(in_phase_amplitude=choose(enters_wall, 0.0, coeffs.in_phase_amplitude))
    new_velocity = wall_velocity - side * choose(leaves_with_speed, rebound_speed, 0.0)
    x, v = choose(is_at_wall, wall_position, path.x), choose(is_at_wall, new_velocity, path.v)
    new_motion = make_slow_motion(coeffs, wall_position, new_velocity, cosine, sine)
    slow_parts = (
        choose(is_at_wall, new_value, old_value)
        for new_value, old_value in zip(new_motion[:4], path.motion[:4], strict=True)
    )
    new_motion = SlowMotion(*slow_parts, cosine, sine)
    time_remaining, time_remaining_low_part = two_sum(path.time_remaining, path.time_remaining_low_part - delay)
    is_free_flight = (step_time > 0) & ~is_at_wall
    contact = choose(is_free_flight, 0.0, event_outcome.contact)
    if is_inside_wall is not None:
        is_inside_wall &= side == 0
        contact = choose(is_inside_wall & (step_time > 0), lax.sign(path.contact) * Contact.WITHIN, contact)
    time_remaining = choose(path.time_remaining == CAPPED, CAPPED, positive_part(time_remaining))
    return Path(
        x, choose(is_at_wall, 0.0, path.x_low_part), v, new_motion, time_remaining, time_remaining_low_part, contact
    )


def wall_state_and_force(coeffs, side, cosine, sine):
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
        Force along x on the sticking mass relative to the wall. If the force has the sign of the wall, it presses the
        mass on the wall.
    force_rate : array
        Time derivative of the contact force.
    """
    wall_position, wall_velocity = wall_jet_on_side(coeffs, side, cosine, sine, 1)
    contact_force_derivs = [coeffs.flow.contact_force(coeffs, wall, cosine, sine, 1) for wall in coeffs.walls]
    return (
        wall_position,
        0.0 if wall_velocity is None else wall_velocity,
        *select_lists_by_side(side, coeffs.walls, contact_force_derivs),
    )


def contact_after_event(coeffs, rebound_speed, contact_force, force_rate):
    """Return the contact that follows on a wall: `LANDED`, `STUCK` or `RELEASED`.

    The mass sticks if the height of its bounce, speed^2 / (2 force), is below rounding. At zero rebound speed the
    contact force decides, and if this force is also zero, its time derivative.
    """
    has_zero_speed = rebound_speed == 0
    is_bounce_negligible = (contact_force > 0) & (
        rebound_speed * (rebound_speed / coeffs.length_scale)
        <= 4.0 * event_certificates.unit_roundoff(contact_force.dtype) * contact_force
    )
    is_sticking = is_bounce_negligible | (has_zero_speed & (contact_force == 0) & (force_rate >= 0))
    contact_unless_sticking = choose(
        has_zero_speed & (contact_force == 0), Contact.RELEASED, lax.full_like(contact_force, Contact.LANDED)
    )
    return choose(is_sticking, Contact.STUCK, contact_unless_sticking)


def is_complete_chatter(
    coeffs, rebound_speed, contact_force, restitution, force_rate_bound, available_time, force_gradient_bound=1.0
):
    """Return True if the following infinitely many bounces certainly end within the available time: complete chatter.

    Let the contact force remain within F (1 +- e), where F is its present value. A bounce with rebound speed u rises
    for at most u / (F (1 - e)) to the height h = u^2 / (2 F (1 - e)). The mass falls for at most sqrt(2) times as long,
    if the damping force is less than half of the contact force. The bounce ends with a speed of at most k u, where
    k^2 = (F (1 + e) + h) / (F (1 - e)). For the restitution R the speeds decrease at least like ((1 + R) / 2)^n if
    R k <= (1 + R) / 2. This condition determines e. A geometric series bounds the total time. The product of this time
    and `force_rate_bound` and the product of h and `force_gradient_bound` must not exceed F e, and no bounce may reach
    the other wall.

    `force_gradient_bound` bounds the derivative of the force with respect to x: the rate at which the force towards the
    wall may decrease with the distance from the wall. The bound is at least 1.
    """
    decay_ratio_squared = 0.25 * (1.0 + restitution) * (1.0 + restitution)
    restitution_squared = restitution * restitution
    max_force_variation = minimum(
        (decay_ratio_squared - restitution_squared) / (decay_ratio_squared + 2.0 * restitution_squared), 0.5
    )
    min_contact_force = contact_force * (1.0 - max_force_variation)
    chatter_time_times_force, speed_squared = BOUNCE_TIME_FACTOR * rebound_speed, rebound_speed * rebound_speed
    height_times_gradient = speed_squared * force_gradient_bound
    available_time = available_time * min_contact_force * (1.0 - restitution)
    is_variation_small = (
        force_rate_bound * chatter_time_times_force
        <= max_force_variation * contact_force * min_contact_force * (1.0 - restitution)
    ) & (height_times_gradient <= 2.0 * max_force_variation * contact_force * min_contact_force)
    misses_other_wall = (speed_squared < min_contact_force * coeffs.min_wall_gap) & (
        8.0 * coeffs.damping * rebound_speed <= min_contact_force
    )
    return (
        (contact_force > 0)
        & (rebound_speed > 0)
        & (chatter_time_times_force <= available_time)
        & is_variation_small
        & misses_other_wall
    )
