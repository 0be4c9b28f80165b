"""Soft walls with a `Push` under a user-defined force, a `protocols.Contact`.

Lanes inside a wall wait until all of them complete their contact phase (`force_law_phase`).
"""

from dataclasses import replace
from functools import lru_cache, partial

import jax
import jax.numpy as jnp
import numpy as np
from jax import lax

from ..compiled.lane_arithmetic import choose
from ..flight import jaxpr_series
from ..flight.motion_in_soft_wall import is_inside_soft_wall
from ..flight.path_start import start_at_soft_wall as start_at_wall  # noqa: F401
from ..scene import check
from ..scene.force_operations import ops_without_series
from ..scene.state import Contact
from . import force_law_map, force_law_matrix, phase_ends, phase_maps
from .force_law_map import state_in_contact  # noqa: F401
from .force_law_phase import complete_contact_phases, contact_duration  # noqa: F401
from .force_law_replay import complete_pending_contact, replay_initial_contact, replay_wall_entry, state_after_delay  # noqa: F401
from .grazing_exponent import grazing_exponent  # noqa: F401
from .initial_contact import initial_relative_state as initial_phase  # noqa: F401
from .phase_maps import max_contact_step, max_oscillation_rate  # noqa: F401
from .rigid import advance_motion, frame_force, is_linear, max_step, prepare_step, rates, target_wall  # noqa: F401

CODE_AFTER_IMPACT: int = Contact.WITHIN
exit_map = partial(phase_maps.exit_map, force_law_map.solve_contact_exit)
complete_contact_map = partial(phase_maps.complete_contact_map, exit_map)
saltation = partial(phase_maps.saltation, phase_maps.contact_matrix)
propagate_contact_phase = partial(phase_ends.propagate_contact_phase, force_law_matrix.contact_phase_effect)
inside_mask = is_inside_soft_wall


def wall_fields(scene, side, as_array):
    """Return the law of the wall, which must have a Taylor series in the root of the depth."""
    wall_law = getattr(scene, side).law
    trace_signature = wall_law.function, tuple(wall_law.numbers), np.dtype(scene.dtype)
    unknown_operations = ops_without_series(*trace_signature, 2)
    if unknown_operations:
        error_message = (
            f"must use operations with a known Taylor series; none is known of {', '.join(unknown_operations)}"
        )
        raise check.SceneError(f"{side}.law", error_message, wall_law.function)
    if not jaxpr_series.is_series_of_root(*trace_signature):
        raise check.SceneError(f"{side}.law", "must be a power series in the root of the depth", wall_law.function)
    return {"restitution": None, "law": jax.tree.map(as_array, wall_law)}


def wall_flow(wall, amplitude, frequency, drive_terms, is_any_soft_wall_moving):
    """Return the wall: its force enters the series of the motion."""
    return wall


def is_valid_wall(wall):
    """Return True: the numbers of a law have no rules."""
    return True


def require_reversible(scene, side):
    """Accept every wall: its law can be reversed in time."""


def reverse_wall(wall):
    """Return the wall with time reversed."""
    return replace(wall, law=replace(wall.law, function=_reverse_wall_law(wall.law.function)))


def reverse_wall_flow(coeffs, wall, wall_flow):
    """Return the wall with time reversed: its force enters the series of the motion."""
    return wall


@lru_cache(256)
def _reverse_wall_law(law_function):
    """Return the law of a wall under time reversal."""

    def reversed_law(depth, depth_rate, law_params):
        return law_function(depth, -depth_rate, law_params)

    return reversed_law


def wall_force(scene, side, depth, depth_rate, v):
    """Return the force of the law."""
    wall_law = getattr(scene, side).law
    law_params = {name: np.asarray(value)[:, None] for name, value in wall_law.numbers.items()}
    return np.asarray(wall_law.function(np.maximum(depth, 0.0), depth_rate, law_params))


def force_series(wall, side, depth_series, depth_rate_series, velocity_series):
    """Return the `Series` of the force of the wall."""
    return jaxpr_series.wall_force_series(wall.law, depth_series, depth_rate_series)


def path_of_stepping_lanes(path):
    """Return the path of the lanes that take a step; lanes inside a wall get no remaining time."""
    return path._replace(time_remaining=choose(is_inside_soft_wall(path.contact), 0.0, path.time_remaining))


def initial_waiting_steps(zeros):
    """Return the initial number of waiting steps of each lane; `zeros` is 0 for each lane."""
    return zeros


def advance_waiting_lanes(coeffs, path, n_waiting_steps, is_any_lane_due, is_loop_idle):
    """Return (path, number of waiting steps), see `rigid.advance_waiting_lanes`.

    If `is_any_lane_due` or `is_loop_idle` is True, all lanes inside a wall complete their contact phase.
    """
    path = lax.cond(
        is_any_lane_due | is_loop_idle, partial(complete_contact_phases, coeffs), lambda operand: operand, path
    )
    return path, jnp.zeros_like(n_waiting_steps)
