"""Compute contact phases inside soft walls with spring and damper, by steps as in free flight or by long steps.

The interface is that of `no_contact_phase`, see `contact_law_dispatch`.
"""

from functools import partial

from jax import lax

from ..compiled.lane_arithmetic import call_without_inlining, choose
from ..scene.codes import Contact
from . import event_certificates, soft_wall_long_step
from .motion_in_soft_wall import frame_force_derivs, lane_coefficients
from .soft_wall_lanes import wall_jet_in_lane_frame


def prepare_step(coeffs, path):
    """Return (coefficients of each lane, path, contact of the lanes, additional force and its derivatives).

    The path includes the first step after an entry, see `soft_wall_long_step.take_first_step_in_wall`.
    """
    coeffs = coeffs._replace(**call_without_inlining(lane_coefficients, coeffs, path.contact)._asdict())
    path = soft_wall_long_step.take_first_step_in_wall(coeffs, path)
    frame_force = call_without_inlining(
        frame_force_derivs, coeffs, path.contact, path.cosine, path.sine, order=event_certificates.N_TERMS - 2
    )
    return coeffs, path, path.contact, frame_force


def path_of_stepping_lanes(path):
    """Return the path of the lanes that take a step: all lanes."""
    return path


def target_wall(coeffs, contact_on_side, side, wall_derivs, is_leaving, wall_remainder_bound):
    """Return the description of the wall that a lane moves towards, see `no_contact_phase.target_wall`.

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


def max_step(coeffs):
    """Return the longest step, including steps inside walls."""
    longest_step = coeffs.max_step
    for soft_flow in coeffs.soft_flows:
        longest_step = longest_step if soft_flow is None else lax.min(longest_step, soft_flow.max_step)
    return longest_step


def initial_waiting_steps(zeros):
    """Return the initial number of waiting steps of each lane; `zeros` is 0 for each lane."""
    return zeros


def advance_waiting_lanes(coeffs, path, n_waiting_steps, is_any_lane_due, is_loop_idle):
    """Return (path, number of waiting steps), see `no_contact_phase.advance_waiting_lanes`.

    If `is_any_lane_due` is True, the lanes that have waited long enough take a long step, see `soft_wall_long_step`.
    """
    return lax.cond(
        is_any_lane_due,
        partial(soft_wall_long_step.take_long_step, coeffs),
        lambda *operands: operands,
        path,
        n_waiting_steps,
    )
