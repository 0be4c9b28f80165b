"""The stroboscopic map: the state one or more drive periods later, and the impacts on the way."""

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

MIN_TWO_TIER_LANES = (
    256  # lanes of which one is nearly always given up: up to a chunk of them are done by both tiers in one call
)
CHUNK_LANES = 1024  # lanes that lean steps have given up are done so many at a time


@persistent_jit(static_argnums=(2, 3, 4), compiler_options=COMPILER_OPTIONS)
def _two_tier_strobe(scene, state, periods, slots, clearance):
    return two_tiers.strobe(scene, state, periods, slots, MIN_LANES, clearance)


@persistent_jit(static_argnums=(2, 3), compiler_options=COMPILER_OPTIONS)
def _fast_strobe(scene, state, slots, clearance):
    return two_tiers.fast_strobe(scene, state, slots, MIN_LANES, clearance)


@persistent_jit(static_argnums=(2, 3), compiler_options=COMPILER_OPTIONS)
def _fast_strobe_single(scene, state_values, slots, clearance):
    """The same of one state, its numbers in a row: each array that is handed over takes some microseconds."""
    return two_tiers.fast_strobe(scene, State(*state_values), slots, MIN_LANES, clearance)


@persistent_jit(static_argnums=(2, 3), compiler_options=COMPILER_OPTIONS)
def _reference_strobe(scene, state, slots, clearance, n_due):
    return one_period.strobe(scene, state, 1, slots, MIN_LANES, clearance, n_due)


@partial(jax.jit, donate_argnums=0)
def _replace_lanes(results, indices, replacement):
    """The results with those of some lanes replaced, in place; a place beyond the end is none."""
    return jax.tree.map(lambda old, new: old.at[indices].set(new, mode="drop"), results, replacement)


def _take_lanes(tree, indices, shape):
    """The lanes at some places of numbers that broadcast to a shape."""
    return jax.tree.map(lambda leaf: np.broadcast_to(leaf, shape)[indices] if leaf.ndim else leaf, tree)


def concrete_strobe(scene, state, periods, slots, clearance):
    """The strobe of numbers that are known: what the lean tier does not need is not compiled."""
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
    """The state after a number of drive periods, and the impacts on the way: (State, Impacts).

    scene: a `Scene`; state: a `State` at its phase; their numbers broadcast together, and the results have that shape.
    periods: whole number >= 1; slots: impacts to record, >= 0: with more of them the status is FULL, and all else is
    right; clearance: whether to measure `Impacts.least_clearance`, which else is None. What is not asked for costs no
    time. The state's phase comes back unchanged. An impact at the end belongs to the period that ends: the state is the
    one after it, and its contact says so. A start on a wall and moving into it rebounds at time 0. A flight that turns
    back within 8 ulp of its largest length (x, v, A, the walls') of a wall may count as a contact or as none. n periods
    in one call are n strobes: between rigid walls in double precision bit for bit; elsewhere
    but for roundings, which it carries on: they differ by less than 16 eps (1 + T) s (1 + the sum of abs M), T = 2 pi /
    omega, s the largest length or speed, M the derivative from each strobe on to the end (docs/numbers.md).

    jax.grad, jacfwd, jacrev, hessian and the rest go through it, at any order: by x, v, phase and every number of the
    scene; of the state, the impacts' times and speeds and the least speed. The rest of `Impacts` counts as constant.
    A derivative is nan where there is no end: the status says so. An impact at the end, and an entry into a soft wall
    or an exit from it at the end, make derivatives one-sided: they are those of the state and contact returned. With
    more than 32 impacts a period since the last rest that of the state may be nan, and is where it is of higher order.
    At an impact without speed there is none: what comes is that of the flight past it. A mass at rest forgets its
    start, and the impacts before it.

    Raises ArgumentError for periods, slots, clearance or a state that cannot be; all else is a status of each lane
    (`Impacts`).
    """
    periods, slots = check.whole_number("periods", periods, 1), check.whole_number("slots", slots, 0)
    if not isinstance(clearance, bool | np.bool_):
        raise check.ArgumentError("clearance", "must be True or False", clearance)
    state = state_arrays(scene, state)
    is_traced = any(isinstance(leaf, jax.core.Tracer) for leaf in jax.tree.leaves((scene, state)))
    return (derivatives.strobe if is_traced else concrete_strobe)(scene, state, periods, slots, bool(clearance))
