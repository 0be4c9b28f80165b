"""Soft walls with spring and damper beside a linear flow, a `protocols.Contact`.

Lanes inside a wall take steps as in free flight, with the coefficients of the motion inside the wall, or long steps.
"""

from dataclasses import replace
from functools import partial, reduce

import jax.numpy as jnp
import numpy as np
from jax import lax

from ..compiled.lane_arithmetic import call_without_inlining, choose
from ..flight import event_certificates, linear_flow, motion_in_soft_wall, soft_wall_long_step
from ..flight.motion_in_soft_wall import frame_force_derivs, is_inside_soft_wall, lane_coefficients, soft_walls
from ..flight.path_start import start_at_soft_wall as start_at_wall  # noqa: F401
from ..flight.soft_wall_lanes import wall_jet_in_lane_frame
from ..scene import check
from ..scene.scene import SIDES, harden_wall
from ..scene.soft_walls import effective_restitution
from ..scene.state import Contact
from . import linear_map, phase_maps
from .contact_duration import linear_contact_duration as contact_duration  # noqa: F401
from .initial_contact import initial_relative_state as initial_phase  # noqa: F401
from .linear_map import max_contact_step, max_oscillation_rate, state_in_contact  # noqa: F401
from .linear_matrix import propagate_contact_phase  # noqa: F401
from .linear_replay import complete_pending_contact, replay_initial_contact, replay_wall_entry, state_after_delay  # noqa: F401

CODE_AFTER_IMPACT: int = Contact.WITHIN
complete_contact_map = partial(phase_maps.complete_contact_map, linear_map.exit_map)
saltation = partial(phase_maps.saltation, linear_map.contact_matrix)


def wall_fields(scene, side, as_array):
    """Return stiffness and damping of the wall, raised by the hardness of the scene."""
    wall = getattr(scene, side)
    stiffness = as_array(wall.stiffness)
    damping = as_array(scene.damping if wall.damping is None else wall.damping)
    if scene.harder is not None:
        stiffness, damping = harden_wall(stiffness, damping, as_array(scene.harder))
    return {"restitution": None, "stiffness": stiffness, "damping": damping}


wall_flow = motion_in_soft_wall.soft_wall_flow


def is_valid_wall(wall):
    """Return True in lanes where the stiffness is positive and the damping is not negative."""
    return (wall.stiffness > 0) & (wall.damping >= 0)


def rates(scene, side):
    """Return the rates of the spring and of the damping inside the wall."""
    wall, scene_damping = getattr(scene, side), float(scene.damping)
    contact_damping = scene_damping if wall.damping is None else scene_damping + float(wall.damping)
    return [np.sqrt(1.0 + float(wall.stiffness)), 2.0 * contact_damping]


def is_linear():
    """Return True."""
    return True


def require_reversible(scene, side):
    """Raise an error if the wall takes all of the speed, because its damping is critical or larger."""
    damping = scene.parameter(f"{side}.damping")
    if not effective_restitution(getattr(scene, side).stiffness, damping) > 0:
        raise check.ArgumentError(f"{side}.damping", "must be less than critical for the inverse map", damping)


def reverse_wall(wall):
    """Return the wall with negative damping."""
    return replace(wall, damping=-wall.damping)


def reverse_wall_flow(coeffs, wall, wall_flow):
    """Return the flow inside the wall with time reversed.

    The energy of y^(6) grows like that of x^(6), see `linear_flow.reverse_time`.
    """
    jet_bound_slope = wall_flow.jet_bound_slope * jnp.exp(-2.0 * wall.damping * wall_flow.max_step)
    force_deriv_bound = wall_flow.jet_bound / (1.0 + wall_flow.jet_bound_slope * wall_flow.max_step)
    reversed_flow = motion_in_soft_wall.soft_wall_flow(
        wall, coeffs.amplitude, coeffs.frequency, coeffs.drive_terms, motion_in_soft_wall.has_moving_soft_wall(coeffs)
    )
    return reversed_flow._replace(
        first_step=reversed_flow.first_step._replace(force_change_bound=wall_flow.first_step.force_change_bound),
        max_step=wall_flow.max_step,
        jet_bound=force_deriv_bound * (1.0 + jet_bound_slope * wall_flow.max_step),
        jet_bound_slope=jet_bound_slope,
    )


def wall_force(scene, side, depth, depth_rate, v):
    """Return the force of the wall that is added to the spring and the damper of the free mass."""
    damping = np.asarray(scene.parameter(f"{side}.damping")) - np.asarray(scene.damping)
    return spring_force(scene, side, depth, damping, v)


def spring_force(scene, side, depth, damping, v):
    """Return the force of a spring and a damper at a wall against the mass, for arrays of shape (lanes, points)."""
    stiffness, wall_sign = np.asarray(scene.parameter(f"{side}.stiffness")), 2.0 * SIDES.index(side) - 1.0
    return stiffness[:, None] * depth + 2.0 * damping[:, None] * wall_sign * v


def grazing_exponent(wall):
    """Return the exponent of a force proportional to the depth, see `grazing_exponent.grazing_exponent`."""
    return 1.5


inside_mask = is_inside_soft_wall


def prepare_step(coeffs, path):
    """Return (coefficients of each lane, path, additional force and its derivatives).

    The path includes the first step after an entry, see `soft_wall_long_step.take_first_step_in_wall`.
    """
    coeffs = coeffs._replace(**call_without_inlining(lane_coefficients, coeffs, path.contact))
    path = soft_wall_long_step.take_first_step_in_wall(coeffs, path)
    frame_force = call_without_inlining(
        frame_force_derivs, coeffs, path.contact, path.cosine, path.sine, order=event_certificates.N_TERMS - 2
    )
    return coeffs, path, frame_force


def path_of_stepping_lanes(path):
    """Return the path of the lanes that take a step: all lanes."""
    return path


def target_wall(coeffs, contact_on_side, side, wall_derivs, is_leaving, wall_remainder_bound):
    """Return the description of the wall that a lane moves towards, see `rigid.target_wall`.

    Inside a wall the event is the exit, where the displacement past the wall returns to 0.
    """
    is_inside_wall = (contact_on_side == Contact.WITHIN) | (contact_on_side == Contact.ENTERED)
    wall_derivs = wall_jet_in_lane_frame(is_inside_wall, side, wall_derivs)
    is_leaving |= contact_on_side == Contact.ENTERED
    wall_remainder_bound, side = (
        choose(is_inside_wall, 0.0, wall_remainder_bound + 0.0 * side),
        choose(is_inside_wall, -side, side),
    )
    return wall_derivs, is_leaving, wall_remainder_bound, side, event_certificates.taylor_weights(coeffs.max_step)


def frame_force(coeffs, path):
    """Return the additional force and its time derivative, see `flow.extend_jet`."""
    return frame_force_derivs(coeffs, path.contact, path.cosine, path.sine, 1)


def advance_motion(coeffs, path, time, lookahead):
    """Return the motion of a path after a step, outside and inside walls."""
    contact, motion = path.contact, path.motion
    propagator = call_without_inlining(motion_in_soft_wall.lane_propagator, coeffs, contact, time)
    extra_responses = []
    if coeffs.drive_terms or motion_in_soft_wall.has_moving_soft_wall(coeffs):
        extra_responses = call_without_inlining(motion_in_soft_wall.harmonic_responses, coeffs, contact, time)
    extra_increments = call_without_inlining(
        motion_in_soft_wall.extra_increments, coeffs, contact, motion, propagator, extra_responses
    )
    slow_parts = call_without_inlining(_slow_parts_of_lanes, coeffs, motion, propagator, contact, extra_increments)
    return linear_flow.rotate_drive(slow_parts, motion, propagator)


def _slow_parts_of_lanes(coeffs, motion, propagator, contact, extra_increments):
    """Return the first four fields of the `SlowMotion` after a flight; inside a wall the force is A cos(omega t)."""
    is_inside_wall = is_inside_soft_wall(contact)
    force_cos, force_sin = linear_flow.slow_force(coeffs, motion)
    force_cos = choose(is_inside_wall, coeffs.amplitude * motion.cosine, force_cos)
    force_sin = choose(is_inside_wall, coeffs.amplitude * motion.sine, force_sin)
    return linear_flow.slow_parts_after_flight(coeffs, motion, propagator, extra_increments, force_cos, force_sin)


def max_step(coeffs):
    """Return the longest step, including steps inside walls."""
    return reduce(lax.min, (soft_flow.max_step for _, soft_flow in soft_walls(coeffs)), coeffs.max_step)


def initial_waiting_steps(zeros):
    """Return the initial number of waiting steps of each lane; `zeros` is 0 for each lane."""
    return zeros


def advance_waiting_lanes(coeffs, path, n_waiting_steps, is_any_lane_due, is_loop_idle):
    """Return (path, number of waiting steps), see `rigid.advance_waiting_lanes`.

    If `is_any_lane_due` is True, the lanes that have waited long enough take a long step, see `soft_wall_long_step`.
    """
    return lax.cond(
        is_any_lane_due,
        partial(soft_wall_long_step.take_long_step, coeffs),
        lambda *operands: operands,
        path,
        n_waiting_steps,
    )
