"""Stroboscopic (Poincaré) map: the state one or more drive periods later, and the impacts in between."""

import math
from functools import partial

import jax
import numpy as np

from continuation.persistent_jit import persistent_jit

from ..compiled.blocks import MIN_LANES
from ..compiled.compiler_hints import COMPILER_OPTIONS
from ..scene import check
from ..scene.scene import Scene
from ..scene.state import Impacts, State, state_arrays
from . import derivatives, one_period, two_tiers

# The fast path nearly always gives up one of this many lanes: up to a chunk of lanes, one call runs both tiers.
MIN_TWO_TIER_LANES = 256
CHUNK_LANES = 1024  # number of lanes of a rerun by the reference path


@persistent_jit(static_argnums=(2, 3, 4), compiler_options=COMPILER_OPTIONS)
def _two_tier_strobe(scene, state, periods, slots, clearance):
    return two_tiers.strobe(scene, state, periods, slots, MIN_LANES, clearance)


@persistent_jit(static_argnums=(2, 3), compiler_options=COMPILER_OPTIONS)
def _fast_strobe(scene, state, slots, clearance):
    return two_tiers.fast_strobe(scene, state, slots, MIN_LANES, clearance)


@persistent_jit(static_argnums=(2, 3), compiler_options=COMPILER_OPTIONS)
def _fast_strobe_single(scene, state_values, slots, clearance):
    """Run the fast path for one state whose numbers are packed in one array: each array argument costs microseconds."""
    return two_tiers.fast_strobe(scene, State(*state_values), slots, MIN_LANES, clearance)


@persistent_jit(static_argnums=(2, 3), compiler_options=COMPILER_OPTIONS)
def _reference_strobe(scene, state, slots, clearance, n_due):
    return one_period.strobe(scene, state, 1, slots, MIN_LANES, clearance, n_due)


@partial(jax.jit, donate_argnums=0)
def _replace_lanes(results, indices, replacement):
    """Replace some lanes of the results in place; an index beyond the end is ignored."""
    return jax.tree.map(lambda old, new: old.at[indices].set(new, mode="drop"), results, replacement)


def _take_lanes(tree, indices, shape):
    """Select lanes by index from leaves that broadcast to a shape."""
    return jax.tree.map(lambda leaf: np.broadcast_to(leaf, shape)[indices] if leaf.ndim else leaf, tree)


def concrete_strobe(scene, state, periods, slots, clearance):
    """Evaluate the map for concrete numbers; compile only the tiers that the lanes need."""
    state_values = (state.x, state.v, state.phase, state.contact)
    shapes = [scene.shape, *map(np.shape, state_values)]
    shape = np.broadcast_shapes(*shapes) if any(shapes) else ()
    if periods > 1 or not two_tiers.has_fast_path(scene) or MIN_TWO_TIER_LANES <= math.prod(shape) <= CHUNK_LANES:
        return _two_tier_strobe(scene, state, periods, slots, clearance)
    if not shape:
        results, given_up = _fast_strobe_single(scene, np.array(state_values), slots, clearance)
        return _reference_strobe(scene, state, slots, clearance, None) if np.asarray(given_up) else results
    results, given_up = _fast_strobe(scene, state, slots, clearance)
    due_lanes = np.flatnonzero(given_up)
    if not due_lanes.size:
        return results
    host_arguments = jax.tree.map(np.asarray, (scene, state))
    width = min(CHUNK_LANES, np.size(given_up))
    for start in range(0, due_lanes.size, width):
        chunk = due_lanes[start : start + width]
        n_padding = width - chunk.size
        lane_indices = np.unravel_index(np.pad(chunk, (0, n_padding), mode="edge"), shape)
        chunk_results = _reference_strobe(
            *_take_lanes(host_arguments, lane_indices, shape), slots, clearance, np.int32(chunk.size)
        )
        target_indices = (np.where(np.arange(width) < chunk.size, lane_indices[0], shape[0]), *lane_indices[1:])
        results = _replace_lanes(results, target_indices, chunk_results)
    return results


@check.check_types
def strobe(
    scene: Scene, state: State, periods: int = 1, slots: int = 4, clearance: bool = False
) -> tuple[State, Impacts]:
    """Evaluate the stroboscopic map and record the impacts.

    The numbers of `scene` and `state` broadcast together, and the results have the broadcast shape. The map has
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
        Number of impacts to record, at least 0. If there are more impacts, the status is FULL and all other results are
        still right.
    clearance : bool, optional
        Measure `Impacts.least_clearance`. The field is None if `clearance` is False, and the measurement then costs no
        time.

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
    *Impacts at the ends.* An impact at the end belongs to the period that ends: `end` is the state after it, and its
    contact says so. A state on a wall that moves into the wall rebounds at time 0. A flight that turns back within 8
    ulp of the largest length (x, v, A and the walls' positions) from a wall may count as an impact or as none.

    *Several periods.* A call with n periods is equivalent to n calls with one. Between rigid walls and in double
    precision the results agree bit for bit. Otherwise they differ by rounding, by less than ``16 eps (1 + T) s (1 + sum
    of |M|)``. Here T = 2 pi / omega, s is the largest length or speed, and M is the derivative of the final state with
    respect to each intermediate state (``docs/numbers.md``).

    *Derivatives.* ``jax.grad``, ``jax.jacfwd``, ``jax.jacrev``, ``jax.hessian`` and their compositions apply, by x, v,
    the phase and every number of the scene. Differentiable are the end, the times and speeds of the impacts and the
    least speed; the other fields of `Impacts` are constants. Derivatives follow these rules:

    - They are nan if there is no end state, that is for a status from CAP on.
    - They are one-sided if an impact, an entry into a soft wall or an exit from it happens at the end. They belong to
      the state and contact that are returned.
    - With more than 32 impacts per period since the last release, those of the state may be nan; those of higher order
      are nan.
    - At a grazing they do not exist. The result is that of the flight without the impact.
    - If the mass sticks, later states do not depend on its initial state or on the impacts before it sticks.

    Examples
    --------
    >>> end, impacts = jv.strobe(scene, state)
    >>> round(float(end.x), 6), round(float(end.v), 6), int(impacts.count)
    (0.674479, 2.09915, 1)
    >>> position = lambda amplitude: jv.strobe(scene.replace(amplitude=amplitude), state)[0].x
    >>> round(float(jax.grad(position)(2.0)), 6)
    0.442388
    """
    periods, slots = check.whole_number("periods", periods, 1), check.whole_number("slots", slots, 0)
    if not isinstance(clearance, bool | np.bool_):
        raise check.ArgumentError("clearance", "must be True or False", clearance)
    state = state_arrays(scene, state)
    is_traced = any(isinstance(leaf, jax.core.Tracer) for leaf in jax.tree.leaves((scene, state)))
    return (derivatives.strobe if is_traced else concrete_strobe)(scene, state, periods, slots, bool(clearance))
