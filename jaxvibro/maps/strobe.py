"""Stroboscopic (Poincaré) map: the state after one or more drive periods, and the impacts during these periods."""

import math
from functools import partial

import jax
import numpy as np

from continuation.hostcall import persistent_jit

from ..compiled.lane_arithmetic import COMPILER_OPTIONS
from ..compiled.lane_blocks import MIN_LANES
from ..scene import check
from ..scene.scene import Scene
from ..scene.state import Impacts, State, make_state_arrays
from . import reference_strobe, strobe_derivatives, two_tier_strobe

# The fast path nearly always gives up one of this many lanes: up to a chunk of lanes, one call runs both tiers.
MIN_TWO_TIER_LANES = 256
CHUNK_LANES = 1024  # number of lanes of a rerun by the reference path


@persistent_jit(static_argnums=(2, 3, 4), compiler_options=COMPILER_OPTIONS)
def _two_tier_strobe(scene, state, periods, slots, clearance):
    return two_tier_strobe.two_tier_strobe(scene, state, periods, slots, MIN_LANES, clearance)


@persistent_jit(static_argnums=(2, 3), compiler_options=COMPILER_OPTIONS)
def _fast_strobe(scene, state, slots, clearance):
    return two_tier_strobe.fast_strobe(scene, state, slots, MIN_LANES, clearance)


@persistent_jit(static_argnums=(2, 3), compiler_options=COMPILER_OPTIONS)
def _fast_strobe_single(scene, packed_state, slots, clearance):
    """Run the fast path for one state, packed in one array because each array argument costs microseconds."""
    return two_tier_strobe.fast_strobe(scene, State(*packed_state), slots, MIN_LANES, clearance)


@persistent_jit(static_argnums=(2, 3), compiler_options=COMPILER_OPTIONS)
def _reference_strobe(scene, state, slots, clearance, n_lanes_due):
    return reference_strobe.reference_strobe(scene, state, 1, slots, MIN_LANES, clearance, n_lanes_due)


@partial(jax.jit, donate_argnums=0)
def _replace_lanes(all_results, lane_indices, new_lane_results):
    """Replace some lanes of the results in place; an index beyond the end is ignored."""
    return jax.tree.map(lambda old, new: old.at[lane_indices].set(new, mode="drop"), all_results, new_lane_results)


def _take_lanes(tree, lane_indices, lane_shape):
    """Select lanes by index from leaves that broadcast to a shape."""
    return jax.tree.map(lambda leaf: np.broadcast_to(leaf, lane_shape)[lane_indices] if leaf.ndim else leaf, tree)


def concrete_strobe(scene, state, periods, slots, clearance):
    """Evaluate the map for concrete arguments; compile only the tiers that the lanes need."""
    state_leaves = (state.x, state.v, state.phase, state.contact)
    argument_shapes = [scene.shape, *map(np.shape, state_leaves)]
    lane_shape = np.broadcast_shapes(*argument_shapes) if any(argument_shapes) else ()
    if (
        periods > 1
        or not two_tier_strobe.has_fast_path(scene)
        or MIN_TWO_TIER_LANES <= math.prod(lane_shape) <= CHUNK_LANES
    ):
        return _two_tier_strobe(scene, state, periods, slots, clearance)
    if not lane_shape:
        results, is_given_up = _fast_strobe_single(scene, np.array(state_leaves), slots, clearance)
        return _reference_strobe(scene, state, slots, clearance, None) if np.asarray(is_given_up) else results
    results, is_given_up = _fast_strobe(scene, state, slots, clearance)
    given_up_lanes = np.flatnonzero(is_given_up)
    if not given_up_lanes.size:
        return results
    numpy_arguments = jax.tree.map(np.asarray, (scene, state))
    chunk_width = min(CHUNK_LANES, np.size(is_given_up))
    for chunk_start in range(0, given_up_lanes.size, chunk_width):
        chunk_lanes = given_up_lanes[chunk_start : chunk_start + chunk_width]
        n_padding_lanes = chunk_width - chunk_lanes.size
        lane_indices = np.unravel_index(np.pad(chunk_lanes, (0, n_padding_lanes), mode="edge"), lane_shape)
        chunk_results = _reference_strobe(
            *_take_lanes(numpy_arguments, lane_indices, lane_shape), slots, clearance, np.int32(chunk_lanes.size)
        )
        replacement_indices = (
            np.where(np.arange(chunk_width) < chunk_lanes.size, lane_indices[0], lane_shape[0]),
            *lane_indices[1:],
        )
        results = _replace_lanes(results, replacement_indices, chunk_results)
    return results


@check.check_types
def strobe(
    scene: Scene, state: State, periods: int = 1, slots: int = 4, clearance: bool = False
) -> tuple[State, Impacts]:
    """Evaluate the stroboscopic map and record the impacts.

    The fields of `scene` and `state` broadcast together, and the results have the broadcast shape. The map has
    derivatives of any order in forward and reverse mode.

    Parameters
    ----------
    scene : Scene
        Oscillator, drive and walls. A single scene or a batch.
    state : State
        Initial state at its phase. A single state or a batch.
    periods : int, optional
        Number of drive periods, at least 1.
    slots : int, optional
        Number of impacts to record, at least 0. If there are more impacts, the status is FULL, and all other results
        are correct.
    clearance : bool, optional
        Measure `Impacts.least_clearance`. If False, the field is None.

    Returns
    -------
    end : State
        State after the last period. Its phase is that of `state`.
    impacts : Impacts
        Impacts in order of time, and the status of each lane.

    Raises
    ------
    ArgumentError
        If `periods`, `slots`, `clearance` or `state` is invalid. All other failures are reported by `Impacts.status`.

    See Also
    --------
    sample : States at given times.
    simulate : Trajectory of one state, for plots.
    monodromy : First derivative with respect to the state, as a product of matrices.

    Notes
    -----
    *Impacts at the ends.* An impact at the end belongs to the period that ends: `end` is the state after the impact,
    and the contact shows this. A mass that starts on a wall and moves into the wall rebounds at time 0. A flight that
    turns back within 8 ulp of the largest length (x, v, A and the walls' positions) from a wall may count as an impact
    or not.

    *Several periods.* A call with n periods is equivalent to n calls with one. With the linear spring, a single drive
    term and rigid walls, in double precision, the results agree bit for bit. Otherwise they differ by rounding, by less
    than ``16 eps (1 + T) s (1 + sum of |M|)``. Here T = 2 pi / omega, s is the largest length or speed, and
    M is the derivative of the final state with respect to each intermediate state (``docs/numbers.md``).

    *Derivatives.* ``jax.grad``, ``jax.jacfwd``, ``jax.jacrev``, ``jax.hessian`` and their compositions apply, with
    respect to x, v, the phase and every number of the scene. The final state, the times and speeds of the impacts and
    the least speed are differentiable. Other fields of `Impacts` are constants. Derivatives follow these rules:

    - Derivatives are nan if there is no final state, that is, if the status is CAP or worse.
    - Derivatives are one-sided if an impact, an entry into a soft wall or an exit from a soft wall happens at the end.
      They belong to the returned state and contact.
    - With more than 32 impacts per period since the last release, first derivatives of the state may be nan, and higher
      derivatives are nan.
    - Derivatives do not exist at a grazing. The result is the derivative of the flight without the impact.
    - If the mass sticks, later states do not depend on the initial state or on the impacts before the mass sticks.

    Examples
    --------
    >>> end, impacts = jv.strobe(scene, state)
    >>> round(float(end.x), 6), round(float(end.v), 6), int(impacts.count)
    (0.674479, 2.09915, 1)
    >>> position = lambda amplitude: jv.strobe(scene.replace(amplitude=amplitude), state)[0].x
    >>> round(float(jax.grad(position)(2.0)), 6)
    0.442388
    """
    periods, slots = check.check_whole_number("periods", periods, 1), check.check_whole_number("slots", slots, 0)
    if not isinstance(clearance, bool | np.bool_):
        raise check.ArgumentError("clearance", "must be True or False", clearance)
    state = make_state_arrays(scene, state)
    is_traced = any(isinstance(leaf, jax.core.Tracer) for leaf in jax.tree.leaves((scene, state)))
    return (strobe_derivatives.traced_strobe if is_traced else concrete_strobe)(
        scene, state, periods, slots, bool(clearance)
    )
