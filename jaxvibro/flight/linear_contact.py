"""Soft walls of a spring and a damper: within one a lane flies by the steps of its free flight, or by a long one.

The interface is that of `no_stay`, see `stays`.
"""

from functools import partial

from jax import lax

from ..compiled.compiler_hints import choose, stage
from ..scene.codes import Contact
from . import event, soft_long_step
from .soft_contact import extra_force_derivs, lane_coefficients
from .soft_wall_lanes import relative_wall_derivs


def prepare_step(coeffs, path):
    """(frame as the lanes feel it, path, the lanes' contact where it matters to the flow, the derivatives' bias)."""
    coeffs = coeffs._replace(**stage(lane_coefficients, coeffs, path.contact)._asdict())
    path = soft_long_step.take_entry_step(coeffs, path)
    extra_force = stage(extra_force_derivs, coeffs, path.contact, path.cosine, path.sine, order=event.N_TERMS - 2)
    return coeffs, path, path.contact, extra_force


def active_path(path):
    """The path of the lanes that a step is for: all."""
    return path


def target_wall(coeffs, contact, side, wall_derivs, is_leaving, wall_remainder):
    """As `no_stay.facing`: from within, y falls to 0."""
    is_inside_wall = (contact == Contact.WITHIN) | (contact == Contact.ENTERED)
    wall_derivs = relative_wall_derivs(is_inside_wall, side, wall_derivs)
    is_leaving |= contact == Contact.ENTERED
    wall_remainder, side = choose(is_inside_wall, 0.0, wall_remainder + 0.0 * side), choose(is_inside_wall, -side, side)
    return wall_derivs, is_leaving, wall_remainder, side, event.taylor_weights(coeffs.max_step)


def extra_force(coeffs, path):
    """The bias of the acceleration and of its change, see `flow.extend`."""
    return extra_force_derivs(coeffs, path.contact, path.cosine, path.sine, 1)


def max_step(coeffs):
    """The longest step, within walls too."""
    step_limit = coeffs.max_step
    for soft_flow in coeffs.soft_flows:
        step_limit = step_limit if soft_flow is None else lax.min(step_limit, soft_flow.max_step)
    return step_limit


def initial_wait(zero):
    """What the lanes' waits within a wall begin with; zero: 0 of each lane."""
    return zero


def advance_waiting(coeffs, path, wait_count, is_due, is_idle):
    """As `no_stay.paused`: by `soft_long_step.leap`, where one is due."""
    return lax.cond(
        is_due, partial(soft_long_step.take_long_step, coeffs), lambda *operands: operands, path, wait_count
    )
