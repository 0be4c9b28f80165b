"""Compute contact phases inside soft walls with spring and damper, by the steps of the free flight or by long steps.

The interface is that of `rigid_contact`, see `contact_laws`.
"""

from functools import partial

from jax import lax

from ..compiled.compiler_hints import choose, stage
from ..scene.codes import Contact
from . import event, soft_long_step
from .soft_contact import extra_force_derivs, lane_coefficients
from .soft_wall_lanes import relative_wall_derivs


def prepare_step(coeffs, path):
    """Return (coefficients of each lane, path, contact of the lanes, extra force)."""
    coeffs = coeffs._replace(**stage(lane_coefficients, coeffs, path.contact)._asdict())
    path = soft_long_step.take_entry_step(coeffs, path)
    extra_force = stage(extra_force_derivs, coeffs, path.contact, path.cosine, path.sine, order=event.N_TERMS - 2)
    return coeffs, path, path.contact, extra_force


def active_path(path):
    """Return the path of the lanes that take a step: all lanes."""
    return path


def target_wall(coeffs, contact, side, wall_derivs, is_leaving, wall_remainder):
    """Return the wall that a lane moves towards, see `rigid_contact.target_wall`; inside a wall y falls to 0."""
    is_inside_wall = (contact == Contact.WITHIN) | (contact == Contact.ENTERED)
    wall_derivs = relative_wall_derivs(is_inside_wall, side, wall_derivs)
    is_leaving |= contact == Contact.ENTERED
    wall_remainder, side = choose(is_inside_wall, 0.0, wall_remainder + 0.0 * side), choose(is_inside_wall, -side, side)
    return wall_derivs, is_leaving, wall_remainder, side, event.taylor_weights(coeffs.max_step)


def extra_force(coeffs, path):
    """Return the additional force and its rate, see `flow.extend_jet`."""
    return extra_force_derivs(coeffs, path.contact, path.cosine, path.sine, 1)


def max_step(coeffs):
    """Return the longest step, including steps inside walls."""
    step_limit = coeffs.max_step
    for soft_flow in coeffs.soft_flows:
        step_limit = step_limit if soft_flow is None else lax.min(step_limit, soft_flow.max_step)
    return step_limit


def initial_wait(zero):
    """Return the initial wait count of the lanes, given 0 for each lane."""
    return zero


def advance_waiting(coeffs, path, wait_count, is_due, is_idle):
    """Return (path, wait count), see `rigid_contact.advance_waiting`; lanes take a `soft_long_step` when one is due."""
    return lax.cond(
        is_due, partial(soft_long_step.take_long_step, coeffs), lambda *operands: operands, path, wait_count
    )
