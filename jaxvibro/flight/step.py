"""Take one certified step of a path: fly to the next event or as far as is certain, then rebound, stick or release.

A step consists of a few stages on lanes. The results of a stage are stored, see `compiler_hints.stage`.
"""

from typing import NamedTuple

import jax
from jax import lax
from jaxtyping import Float

from ..compiled.compiler_hints import choose, maximum, minimum, positive_part, stage
from ..scene.codes import Contact
from . import event, impact
from .contact_laws import contact_law_of
from .flight_state import Path, motion_state, subtract_time
from .flows import flow_of
from .soft_wall_lanes import in_soft_wall
from .wall_motion import select_by_side, select_lists_by_side, subtract, wall_jet, wall_jet_on_side

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
        Side of the event, 0 without one.
    outcome : EventOutcome
        Outcome of the event.
    """

    time: Float[jax.Array, "*lanes"]
    pre_impact_path: Path
    path: Path
    side: Float[jax.Array, "*lanes"]
    outcome: impact.EventOutcome


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
    flow, contact_law, free_coeffs = flow_of(coeffs), contact_law_of(coeffs), coeffs
    coeffs, lookahead = flow.look_ahead(coeffs, path)
    if not coeffs.walls:
        step_time = positive_part(minimum(coeffs.max_step, path.time_remaining))
        pre_impact_path = _advance_path(coeffs, path, step_time, None, lookahead)
        zero = lax.full_like(path.x, 0.0)
        return StepResult(step_time, pre_impact_path, pre_impact_path, zero, impact.EventOutcome(zero, zero, zero))
    coeffs, path, contact, extra_force = contact_law.prepare_step(coeffs, path)
    whole_path, path = path, contact_law.active_path(path)
    derivatives = flow.event_derivatives(coeffs, path, lookahead, extra_force)
    side = stage(_target_side, coeffs, path, *derivatives[2:4])
    bounds = flow.lookahead_bounds(lookahead)
    progress = stage(_wall_progress, coeffs, path, derivatives, side, bounds)
    progress_bound = event.bound_progress(progress, stage(event.cubic_bound, progress))
    safe_step = stage(event.safe_step, progress_bound)
    other_wall_step = lax.full_like(safe_step, 1.0)
    if len(coeffs.walls) == 2:
        other_bound = stage(_other_progress_bound, coeffs, path, derivatives, side, bounds)
        other_wall_step = stage(_other_wall_step, path, in_soft_wall(coeffs, path.contact), other_bound)
    root_guess = stage(event.first_quadratic_root, *progress_bound[:3])
    horizon_step = stage(
        event.safe_horizon_step, progress_bound, stage(event.bounding_horizon, progress_bound, root_guess), safe_step
    )
    root = stage(event.newton_step, progress, stage(event.halley_step, progress, root_guess))
    root_error = stage(event.root_error_bound, progress, root_guess, root)
    hit_side = stage(_hit_side, coeffs, path, progress, root, root_error, other_wall_step, side)
    step_time = stage(_step_time, coeffs, path, hit_side, root, root_error, horizon_step, other_wall_step)
    pre_impact_path = _advance_path(coeffs, whole_path, step_time, contact, lookahead)
    delay = stage(impact.event_delay, coeffs, pre_impact_path, hit_side)
    outcome = stage(impact.resolve_event, coeffs, pre_impact_path, hit_side, delay)
    new_path = stage(impact.apply_event, free_coeffs, pre_impact_path, hit_side, delay, outcome, step_time)
    return StepResult(step_time, pre_impact_path, new_path, hit_side, outcome)


def _target_side(coeffs, path, acceleration, jerk):
    """Return the side of the wall whose event is certified.

    It is the nearer wall if that wall holds the mass (`_holds_mass`), otherwise the wall that the mass reaches first at
    its present velocity. Without relative velocity it is the nearer wall. At equal distances it is the wall towards
    which the mass accelerates, so that a mirror image selects the other wall.
    """
    wall_states = []
    for wall in coeffs.walls:
        wall_position, wall_velocity, approach_accel, approach_jerk = wall_jet(
            wall, coeffs.frequency, path.cosine, path.sine, 3
        )
        clearance, approach_speed = (
            wall.sign * ((wall_position - path.x) + path.x_low),
            wall.sign * subtract(path.v, wall_velocity),
        )
        approach_accel, approach_jerk = (
            wall.sign * subtract(acceleration, approach_accel),
            subtract(jerk, approach_jerk),
        )
        holds = _holds_mass(coeffs, path.contact * wall.sign, clearance, approach_speed, approach_accel, approach_jerk)
        wall_states.append((clearance, approach_speed, approach_accel, holds))
    if len(wall_states) == 1:
        return lax.full_like(path.x, float(coeffs.walls[0].sign))
    (clearance, approach_speed, approach_accel, holds), (other_clearance, other_speed, other_accel, other_holds) = (
        wall_states
    )
    urgency, other_urgency = approach_speed * other_clearance, other_speed * clearance
    drawn_to_other = (other_urgency > urgency) | ((other_urgency == urgency) & (other_accel > approach_accel))
    other_is_nearer = (other_clearance < clearance) | ((other_clearance == clearance) & drawn_to_other)
    other_is_sooner = (other_urgency > urgency) | ((other_urgency == urgency) & other_is_nearer)
    aims_right = choose(other_is_nearer, other_holds | other_is_sooner, other_is_sooner & ~holds)
    is_inside_wall = in_soft_wall(coeffs, path.contact)
    if is_inside_wall is not None:
        aims_right = (is_inside_wall & (path.contact > 0)) | (~is_inside_wall & aims_right)
    return choose(aims_right, lax.full_like(path.x, 1.0), -1.0)


def _holds_mass(coeffs, contact, clearance, approach_speed, approach_accel, approach_jerk):
    """Return True if the mass sticks, bounces back, or is so close and slow that only a short horizon helps."""
    speed_limit = SLOW_FRACTION * coeffs.max_step * (lax.abs(approach_accel) + coeffs.max_step * lax.abs(approach_jerk))
    is_slow = (lax.abs(approach_speed) < speed_limit) & (clearance < coeffs.max_step * speed_limit)
    hops_back = (contact == Contact.LANDED) & (2.0 * lax.abs(approach_speed) < coeffs.max_step * approach_accel)
    return is_slow | hops_back | (contact == Contact.STUCK)


def _wall_progress(coeffs, path, derivatives, side, bounds):
    """Return the `event.Progress` towards the wall on a side; `bounds` come from `lookahead_bounds` of the flow."""
    flow, walls, contact = flow_of(coeffs), coeffs.walls, path.contact * side
    force_lists, force_remainders = zip(*flow.contact_forces_ahead(coeffs, path, bounds), strict=True)
    contact_force = select_lists_by_side(side, walls, force_lists)
    wall_derivs = wall_jet_on_side(coeffs, side, path.cosine, path.sine, event.N_TERMS)
    is_sticking, is_released = contact == Contact.STUCK, contact == Contact.RELEASED
    force_remainder, wall_remainder = (
        select_by_side(side, walls, force_remainders),
        select_by_side(side, walls, coeffs.wall_remainders),
    )
    is_leaving = (contact == Contact.LANDED) | is_released
    wall_derivs, is_leaving, wall_remainder, side, taylor_weights = contact_law_of(coeffs).target_wall(
        coeffs, contact, side, wall_derivs, is_leaving, wall_remainder
    )
    clearance_derivs = [
        subtract(position_deriv, wall_deriv)
        for position_deriv, wall_deriv in zip(derivatives, wall_derivs, strict=True)
    ]
    clearance_derivs[0] = clearance_derivs[0] + path.x_low
    terms = [
        choose(is_sticking, -force_deriv, clearance_deriv) * (side * taylor_weight)
        for force_deriv, clearance_deriv, taylor_weight in zip(
            contact_force, clearance_derivs, taylor_weights, strict=False
        )
    ]
    terms[1:3] = (choose(is_released, 0.0, term) for term in terms[1:3])
    return event.make_progress(
        terms,
        flow.remainder_bound(coeffs, derivatives, bounds, is_sticking, force_remainder, wall_remainder, taylor_weights),
        is_leaving,
    )


def _other_progress_bound(coeffs, path, derivatives, side, bounds):
    """Return the `event.ProgressBound` towards the other wall."""
    progress = _wall_progress(coeffs, path, derivatives, -side, bounds)
    return event.bound_progress(progress, event.cubic_bound(progress))


def _other_wall_step(path, is_inside_wall, bound):
    """Return a step that certainly does not reach the other wall."""
    is_held = lax.abs(path.contact) == Contact.STUCK
    if is_inside_wall is not None:
        is_held |= is_inside_wall
    return choose(is_held, 1.0, event.safe_root_step(bound))


def _hit_side(coeffs, path, progress, root, root_error, other_wall_step, side):
    """Return the side of the wall hit at the root, or 0 if the root is inaccurate or not the next event."""
    terms = progress.terms
    time_remaining = path.time_remaining * coeffs.inverse_max_step
    time_rounding = 4.0 * event.unit_roundoff(time_remaining.dtype) * coeffs.period * coeffs.inverse_max_step
    is_accurate = root_error * (lax.abs(terms[2]) + terms[1]) < event.landing_tolerance(time_remaining.dtype) * terms[1]
    before_end = (root + root_error <= time_remaining) | (
        (root_error <= time_rounding) & (root <= time_remaining + time_rounding)
    )
    is_hit = (root_error >= 0) & is_accurate & before_end & (root <= other_wall_step) & (time_remaining > 0)
    return choose(is_hit, side, 0.0)


def _step_time(coeffs, path, hit_side, root, root_error, horizon_step, other_wall_step):
    """Return the length of the step."""
    safe_time = minimum(maximum(horizon_step, choose(root_error >= 0, root - root_error, 0.0)), other_wall_step)
    return positive_part(minimum(choose(hit_side != 0, root, safe_time) * coeffs.max_step, path.time_remaining))


def _advance_path(coeffs, path, step_time, contact, lookahead):
    """Return the path after a free flight."""
    motion = flow_of(coeffs).advance_motion(coeffs, path.motion, step_time, contact, lookahead)
    return Path(*stage(motion_state, coeffs, motion), motion, *stage(subtract_time, path, step_time), path.contact)
