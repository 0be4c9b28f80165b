"""Soft walls with spring and damper under a user-defined force, a `protocols.Contact`.

The contact phases are those of `force_law`, in which only the series of the force differs.
"""

import numpy as np

from ..flight.power_series import add_series, scale_series
from . import linear
from .force_law import (  # noqa: F401
    CODE_AFTER_IMPACT,
    advance_motion,
    advance_waiting_lanes,
    complete_contact_map,
    complete_pending_contact,
    contact_duration,
    frame_force,
    initial_phase,
    initial_waiting_steps,
    inside_mask,
    is_linear,
    max_contact_step,
    max_oscillation_rate,
    max_step,
    path_of_stepping_lanes,
    prepare_step,
    propagate_contact_phase,
    rates,
    replay_initial_contact,
    replay_wall_entry,
    require_reversible,
    reverse_wall_flow,
    saltation,
    start_at_wall,
    state_after_delay,
    state_in_contact,
    target_wall,
    wall_flow,
)
from .linear import grazing_exponent, is_valid_wall, reverse_wall, wall_fields  # noqa: F401


def wall_force(scene, side, depth, depth_rate, v):
    """Return the force of the spring and the damper of the wall."""
    return linear.spring_force(scene, side, depth, np.asarray(scene.parameter(f"{side}.damping")), v)


def force_series(wall, side, depth_series, depth_rate_series, velocity_series):
    """Return the `Series` of the force of the wall."""
    return add_series(
        scale_series(wall.stiffness, depth_series), scale_series(2.0 * wall.damping * side, velocity_series)
    )
