"""Take one certified step of a path: a flight to the next event, or without an event, and the event itself.

A step consists of a few functions of lanes, which are called without inlining, so that their results are stored (see
`lane_arithmetic.call_without_inlining`)."""

from typing import NamedTuple

import jax
from jax import lax
from jaxtyping import Float

from ..compiled.lane_arithmetic import call_without_inlining, choose, maximum, minimum, positive_part
from ..scene.state import Contact
from . import event_certificates, impact
from .flight_state import Path, reduce_time_remaining, state_of_slow_motion
from .wall_motion import select_by_side, select_lists_by_side, subtract_optional, wall_jet, wall_jet_on_side

SLOW_FRACTION = 0.25  # speed limit, relative to the speed gained by the acceleration in the longest step


class StepResult(NamedTuple):
    """Result of a step.

    Attributes
    ----------
    time : array
        Length of the step.
    pre_impact_path : Path
        Path at the end of the flight, before an impact.
    path : Path
        Path after the step.
    side : array
        Side of the event, 0 without an event.
    event_outcome : EventOutcome
        Outcome of the event.
    """

    time: Float[jax.Array, "*lanes"]
    pre_impact_path: Path
    path: Path
    side: Float[jax.Array, "*lanes"]
    event_outcome: impact.EventOutcome


def certified_step(coeffs, path):
    """Take one certified step of every lane with time remaining.

    Parameters
    ----------
    coeffs : FlowCoefficients
        Coefficients of the scene.
    path : Path
        Paths of the lanes.

    Returns
    -------
    StepResult
        Result of the step. Lanes without time remaining do not change.
    """
    flow, contact, scene_coeffs = coeffs.flow, coeffs.contact, coeffs
    coeffs, lookahead = flow.prepare_lookahead(coeffs, path)
    if not coeffs.walls:
        step_time = positive_part(minimum(coeffs.max_step, path.time_remaining))
        pre_impact_path = _advance_path(coeffs, path, step_time, lookahead)
        zero = lax.full_like(path.x, 0.0)
        return StepResult(step_time, pre_impact_path, pre_impact_path, zero, impact.EventOutcome(zero, zero, zero))
    coeffs, path, frame_force = contact.prepare_step(coeffs, path)
    path_with_waiting_lanes, path = path, contact.path_of_stepping_lanes(path)
    derivatives = flow.motion_derivatives(coeffs, path, lookahead, frame_force)
    target_side = call_without_inlining(_target_side, coeffs, path, *derivatives[2:4])
    forces_and_remainder = flow.forces_and_remainder(lookahead)
    event_polynomial = call_without_inlining(
        _wall_event_polynomial, coeffs, path, derivatives, target_side, forces_and_remainder
    )
    horizon_step, root, root_error = event_certificates.certify_event(event_polynomial)
    other_wall_step = lax.full_like(root, 1.0)
    if len(coeffs.walls) == 2:
        other_upper_cubic = call_without_inlining(
            _other_upper_cubic, coeffs, path, derivatives, target_side, forces_and_remainder
        )
        other_wall_step = call_without_inlining(
            _other_wall_step, path, contact.inside_mask(path.contact), other_upper_cubic
        )
    hit_side = call_without_inlining(
        _hit_side, coeffs, path, event_polynomial, root, root_error, other_wall_step, target_side
    )
    step_time = call_without_inlining(
        _step_time, coeffs, path, hit_side, root, root_error, horizon_step, other_wall_step
    )
    pre_impact_path = _advance_path(coeffs, path_with_waiting_lanes, step_time, lookahead)
    delay = call_without_inlining(impact.event_delay, coeffs, pre_impact_path, hit_side)
    event_outcome = call_without_inlining(impact.resolve_event, coeffs, pre_impact_path, hit_side, delay)
    new_path = call_without_inlining(
        impact.apply_event, scene_coeffs, pre_impact_path, hit_side, delay, event_outcome, step_time
    )
    return StepResult(step_time, pre_impact_path, new_path, hit_side, event_outcome)


def _target_side(coeffs, path, acceleration, jerk):
    """Return the side of the wall whose event is certified.

    The nearer wall is selected if the mass sticks or remains close to that wall (`_stays_near_wall`), or without
    relative velocity. Otherwise the wall is selected that the mass reaches first at its present velocity. At equal
    distances the wall is selected towards which the mass accelerates, so that a mirror image selects the other wall.
    Inside a soft wall this wall is selected.
    """
    wall_approaches = []
    for candidate_wall in coeffs.walls:
        wall_position, wall_velocity, approach_accel, approach_jerk = wall_jet(
            candidate_wall, coeffs.frequency, path.cosine, path.sine, 3
        )
        clearance, approach_speed = (
            candidate_wall.sign * ((wall_position - path.x) + path.x_low_part),
            candidate_wall.sign * subtract_optional(path.v, wall_velocity),
        )
        approach_accel, approach_jerk = (
            candidate_wall.sign * subtract_optional(acceleration, approach_accel),
            subtract_optional(jerk, approach_jerk),
        )
        stays_near_wall = _stays_near_wall(
            coeffs, path.contact * candidate_wall.sign, clearance, approach_speed, approach_accel, approach_jerk
        )
        wall_approaches.append((clearance, approach_speed, approach_accel, stays_near_wall))
    if len(wall_approaches) == 1:
        return lax.full_like(path.x, float(coeffs.walls[0].sign))
    (
        (clearance, approach_speed, approach_accel, stays_near_wall),
        (other_clearance, other_approach_speed, other_approach_accel, stays_near_other_wall),
    ) = wall_approaches
    inverse_arrival_time, other_inverse_arrival = approach_speed * other_clearance, other_approach_speed * clearance
    accelerates_to_other = (other_inverse_arrival > inverse_arrival_time) | (
        (other_inverse_arrival == inverse_arrival_time) & (other_approach_accel > approach_accel)
    )
    is_other_nearer = (other_clearance < clearance) | ((other_clearance == clearance) & accelerates_to_other)
    is_other_sooner = (other_inverse_arrival > inverse_arrival_time) | (
        (other_inverse_arrival == inverse_arrival_time) & is_other_nearer
    )
    is_right_target = choose(
        is_other_nearer, stays_near_other_wall | is_other_sooner, is_other_sooner & ~stays_near_wall
    )
    is_inside_wall = coeffs.contact.inside_mask(path.contact)
    if is_inside_wall is not None:
        is_right_target = (is_inside_wall & (path.contact > 0)) | (~is_inside_wall & is_right_target)
    return choose(is_right_target, lax.full_like(path.x, 1.0), -1.0)


def _stays_near_wall(coeffs, contact_on_side, clearance, approach_speed, approach_accel, approach_jerk):
    """Return True if the mass sticks to the wall, is about to hit this wall again, or is close and slow."""
    slow_speed_limit = (
        SLOW_FRACTION * coeffs.max_step * (lax.abs(approach_accel) + coeffs.max_step * lax.abs(approach_jerk))
    )
    is_slow = (lax.abs(approach_speed) < slow_speed_limit) & (clearance < coeffs.max_step * slow_speed_limit)
    bounces_back = (contact_on_side == Contact.LANDED) & (
        2.0 * lax.abs(approach_speed) < coeffs.max_step * approach_accel
    )
    return is_slow | bounces_back | (contact_on_side == Contact.STUCK)


def _wall_event_polynomial(coeffs, path, derivatives, side, forces_and_remainder):
    """Return the `event_certificates.EventPolynomial` towards the wall on a side.

    `forces_and_remainder` is the result of the function of this name of the flow.
    """
    flow, walls, contact_on_side = coeffs.flow, coeffs.walls, path.contact * side
    contact_force_derivs, contact_remainder_bounds = zip(
        *flow.contact_forces_ahead(coeffs, path, forces_and_remainder), strict=True
    )
    target_force_derivs = select_lists_by_side(side, walls, contact_force_derivs)
    wall_derivs = wall_jet_on_side(coeffs, side, path.cosine, path.sine, event_certificates.N_TERMS)
    is_sticking, is_released = contact_on_side == Contact.STUCK, contact_on_side == Contact.RELEASED
    contact_remainder_bound, wall_remainder_bound = (
        select_by_side(side, walls, contact_remainder_bounds),
        select_by_side(side, walls, coeffs.wall_remainder_bounds),
    )
    is_leaving = (contact_on_side == Contact.LANDED) | is_released
    wall_derivs, is_leaving, wall_remainder_bound, side, taylor_weights = coeffs.contact.target_wall(
        coeffs, contact_on_side, side, wall_derivs, is_leaving, wall_remainder_bound
    )
    relative_derivs = [
        subtract_optional(position_deriv, wall_deriv)
        for position_deriv, wall_deriv in zip(derivatives, wall_derivs, strict=True)
    ]
    relative_derivs[0] = relative_derivs[0] + path.x_low_part
    taylor_terms = [
        choose(is_sticking, -force_deriv, relative_deriv) * (side * taylor_weight)
        for force_deriv, relative_deriv, taylor_weight in zip(
            target_force_derivs, relative_derivs, taylor_weights, strict=False
        )
    ]
    taylor_terms[1:3] = (choose(is_released, 0.0, term) for term in taylor_terms[1:3])
    return event_certificates.make_event_polynomial(
        taylor_terms,
        flow.remainder_bound(
            coeffs,
            derivatives,
            forces_and_remainder,
            is_sticking,
            contact_remainder_bound,
            wall_remainder_bound,
            taylor_weights,
        ),
        is_leaving,
    )


def _other_upper_cubic(coeffs, path, derivatives, side, forces_and_remainder):
    """Return the `event_certificates.UpperCubic` towards the other wall."""
    event_polynomial = _wall_event_polynomial(coeffs, path, derivatives, -side, forces_and_remainder)
    return event_certificates.make_upper_cubic(
        event_polynomial, event_certificates.cubic_coefficient_bound(event_polynomial)
    )


def _other_wall_step(path, is_inside_wall, upper_cubic):
    """Return a step without contact with the other wall; 1 for a mass that sticks or is inside a soft wall."""
    is_sticking_or_inside = lax.abs(path.contact) == Contact.STUCK
    if is_inside_wall is not None:
        is_sticking_or_inside |= is_inside_wall
    return choose(is_sticking_or_inside, 1.0, event_certificates.safe_step_by_root(upper_cubic))


def _hit_side(coeffs, path, event_polynomial, root, root_error, other_wall_step, target_side):
    """Return the side of the wall hit at the root, or 0 if the root is inaccurate or not the next event."""
    terms = event_polynomial.terms
    time_remaining = path.time_remaining * coeffs.inverse_max_step
    time_rounding = (
        4.0 * event_certificates.unit_roundoff(time_remaining.dtype) * coeffs.period * coeffs.inverse_max_step
    )
    is_accurate = (
        root_error * (lax.abs(terms[2]) + terms[1])
        < event_certificates.landing_time_tolerance(time_remaining.dtype) * terms[1]
    )
    is_before_end = (root + root_error <= time_remaining) | (
        (root_error <= time_rounding) & (root <= time_remaining + time_rounding)
    )
    is_hit = (root_error >= 0) & is_accurate & is_before_end & (root <= other_wall_step) & (time_remaining > 0)
    return choose(is_hit, target_side, 0.0)


def _step_time(coeffs, path, hit_side, root, root_error, horizon_step, other_wall_step):
    """Return the length of the step."""
    safe_time = minimum(maximum(horizon_step, choose(root_error >= 0, root - root_error, 0.0)), other_wall_step)
    return positive_part(minimum(choose(hit_side != 0, root, safe_time) * coeffs.max_step, path.time_remaining))


def _advance_path(coeffs, path, step_time, lookahead):
    """Return the path after the flight of a step."""
    motion = coeffs.contact.advance_motion(coeffs, path, step_time, lookahead)
    return Path(
        *call_without_inlining(state_of_slow_motion, coeffs, motion),
        motion,
        *call_without_inlining(reduce_time_remaining, path, step_time),
        path.contact,
    )
