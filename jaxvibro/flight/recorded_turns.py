"""Keep the smallest clearance and the steps with turning points that are still to be measured.

The modules that measure them, `turning_points` and `fast_turning_points`, define the start of a step and the code.
"""

from functools import partial
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
from jax import lax
from jaxtyping import Float

from ..compiled.lane_arithmetic import bit_mask, call_without_inlining, choose, merge_bits


class StepWithTurningPoint(NamedTuple):
    """Step with a turning point.

    Attributes
    ----------
    start : pytree of array
        Motion at the start of the step.
    code : array
        Code of the turning point, 0 without one.
    """

    start: Any
    code: Float[jax.Array, "*lanes"]


class ClosestApproaches(NamedTuple):
    """Smallest clearance and recorded turning points.

    Attributes
    ----------
    least_clearance : array
        Smallest clearance.
    pending_turn : StepWithTurningPoint
        Turning points to be measured.
    latest_turn : StepWithTurningPoint
        Turning points of the last step, in lanes that already have a pending turning point.
    """

    least_clearance: Float[jax.Array, "*lanes"]
    pending_turn: StepWithTurningPoint
    latest_turn: StepWithTurningPoint


def empty_approaches(zero, empty_start):
    """Return `ClosestApproaches` without turning points; `zero` is 0 for each lane."""
    empty_step = StepWithTurningPoint(empty_start, zero)
    return ClosestApproaches(jnp.full_like(zero, jnp.inf), empty_step, empty_step)


def record_step(closest_approaches, start, code, doubtful_code=jnp.inf):
    """Record the turning points of a step.

    Parameters
    ----------
    closest_approaches : ClosestApproaches
        Closest approaches before the step.
    start : pytree of array
        Motion at the start of the step.
    code : array
        Code of the turning point, 0 without one.
    doubtful_code : float, optional
        Magnitude from which on a code marks a lane in doubt, which records nothing.

    Returns
    -------
    ClosestApproaches
        Closest approaches including the step. The new turning point becomes pending in lanes without a pending turning
        point.
    """
    pending_mask, latest_code = call_without_inlining(
        _assign_turning_point, closest_approaches.pending_turn.code, code, doubtful_code=doubtful_code
    )
    pending_turn = jax.tree.map(
        partial(merge_bits, pending_mask), StepWithTurningPoint(start, code), closest_approaches.pending_turn
    )
    return closest_approaches._replace(pending_turn=pending_turn, latest_turn=StepWithTurningPoint(start, latest_code))


def _assign_turning_point(pending_code, new_code, doubtful_code):
    """Return (bit mask of the lanes whose new turning point becomes pending, codes in the other lanes)."""
    is_certain = ~(lax.abs(new_code) >= doubtful_code)  # also nan
    return bit_mask((pending_code == 0) & (new_code != 0) & is_certain, new_code), choose(
        (pending_code != 0) & is_certain, new_code, 0.0
    )


def needs_measurement(closest_approaches):
    """Return the lanes with a new and a pending turning point, for which a measurement is due."""
    return closest_approaches.latest_turn.code != 0


def has_pending_turn(closest_approaches):
    """Return the lanes with a pending turning point."""
    return closest_approaches.pending_turn.code != 0
