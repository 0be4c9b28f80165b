"""Stroboscopic map in two tiers: the fast path, and the reference path for lanes that the fast path gives up.

The tier of a lane depends only on this lane, so that the results do not depend on the other lanes of a batch. Several
periods are computed as separate maps, each from the final state of the previous period.
"""

from dataclasses import replace
from functools import partial
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax import lax

from ..compiled.kernel_calls import call_as_kernel, reference_block_width
from ..compiled.lane_arithmetic import choose
from ..compiled.lane_blocks import run_in_blocks
from ..contact.kinds import make_flow_coefficients
from ..flight import fast_coefficients, fast_path, fast_tangent, impact_log
from ..flight.fast_tangent import Tangent
from ..flight.path_start import start_path
from ..scene.state import Contact, Impacts, State, Status
from . import reference_strobe
from .impact_replay import collect_replay_data, move_slots_first, replay_derivatives
from .reference_strobe import ReplayHistory

BLOCKS_PER_STRIP = 8  # blocks of one kernel: the launch of a kernel takes a tenth of a block's time


class StrobeSettings(NamedTuple):
    """Static options of a strobe.

    Attributes
    ----------
    slots : int
        Number of recorded impacts.
    clearance : bool
        True to measure the least clearance.
    argnums : tuple of int
        Indices of the leaves of (scene, state) with respect to which the results are differentiated.
    history_slots : int
        Number of impacts in a `ReplayHistory`.
    """

    slots: int
    clearance: bool = False
    argnums: tuple[int, ...] = ()
    history_slots: int = 0


def two_tier_strobe(scene, state, periods, slots, min_lanes, clearance=False):
    """Evaluate the map for arguments that broadcast.

    Parameters
    ----------
    scene, state : Scene, State
        Scene and state whose fields broadcast.
    periods : int
        Number of drive periods.
    slots : int
        Number of impacts to record.
    min_lanes : int
        Smallest number of lanes of a block.
    clearance : bool, optional
        Measure the least clearance.

    Returns
    -------
    end : State
        State after the last period.
    impacts : Impacts
        Recorded impacts.
    """
    return strobe_and_history(scene, state, periods, slots, min_lanes, clearance)[0]


def strobe_and_history(scene, state, periods, slots, min_lanes, clearance=False, history_slots=0):
    """Return ((State, Impacts), `ReplayHistory`); `history_slots` must not exceed `slots`."""
    if not has_fast_path(scene):
        return reference_strobe.strobe_and_history(scene, state, periods, slots, min_lanes, clearance, history_slots)
    scene, state, shape = _flatten_lanes(scene, state)
    results, replay_history, _ = _strobe_periods(
        scene, state, (), periods, StrobeSettings(slots, clearance, history_slots=history_slots), min_lanes
    )
    return _restore_shape((results, replay_history), shape)


def strobe_with_jacobian(treedef, *leaves, periods, slots, min_lanes, argnums):
    """Return ((State, Impacts), (derivatives of x, derivatives of v)) with respect to chosen leaves of (scene, state).

    The last axis of the derivatives runs over the leaves `argnums`. `has_fast_path` must be true for the scene.
    """
    scene, state, shape = _flatten_lanes(*treedef.unflatten(leaves))
    zeros, ones = jnp.zeros_like(state.x), jnp.ones_like(state.x)
    start_tangents = tuple(
        Tangent(*(ones if argnum == k else zeros for k in _state_argnums(treedef))) for argnum in argnums
    )
    results, _, tangents = _strobe_periods(
        scene, state, start_tangents, periods, StrobeSettings(slots, argnums=argnums), min_lanes
    )
    jacobian = tuple(jnp.stack(component_tangents, axis=-1) for component_tangents in zip(*tangents, strict=True))
    return _restore_shape((results, jacobian), shape)


def _state_argnums(treedef):
    """Return the indices of x and v among the leaves of (scene, state)."""
    return treedef.num_leaves - 4, treedef.num_leaves - 3


def _strobe_periods(scene, state, start_tangents, periods, settings, min_lanes):
    results = _strobe_period(scene, state, start_tangents, settings, min_lanes)
    if periods > 1:
        results = lax.fori_loop(1, periods, partial(_append_period, scene, settings, min_lanes), results)
    return results


def _restore_shape(lane_tree, shape):
    return jax.tree.map(lambda leaf: leaf.reshape(*shape, *leaf.shape[1:]) if shape else leaf, lane_tree)


def fast_strobe(scene, state, slots, min_lanes, clearance=False):
    """Return ((State, Impacts), mask of lanes that are given up); results of these lanes are meaningless."""
    scene, state, shape = _flatten_lanes(scene, state)
    results, _, is_given_up = _fast_period_in_blocks(scene, state, (), StrobeSettings(slots, clearance), min_lanes)
    return _restore_shape((results, is_given_up), shape)


def has_fast_path(scene):
    """Test whether the fast path applies: spring, damper, one drive term and rigid walls, in double precision."""
    walls = [wall for wall in (scene.left, scene.right) if wall is not None]
    has_single_drive_term = scene.force is None and not scene.drive
    return has_single_drive_term and bool(walls) and not any(wall.soft for wall in walls) and scene.dtype == np.float64


def _flatten_lanes(scene, state):
    """Return (scene, state, shape of the lanes); arrays are broadcast and flattened, and scalars remain scalars."""
    shape = jnp.broadcast_shapes(*map(jnp.shape, jax.tree.leaves((scene, state))))
    state = replace(state, x=jnp.broadcast_to(state.x, shape))

    def flatten_leaf(leaf):
        return jnp.broadcast_to(leaf, shape).reshape(-1) if jnp.ndim(leaf) else leaf

    return *jax.tree.map(flatten_leaf, (scene, state)), shape


def _fast_period_in_blocks(scene, state, start_tangents, settings, min_lanes):
    def run_block(arguments):
        return call_as_kernel(_fast_period_in_strip, *arguments, settings=settings, min_lanes=min_lanes)

    return run_in_blocks(
        run_block,
        (scene, state, start_tangents),
        partial(_make_empty_fast_results, scene.dtype, settings),
        min_lanes,
        max_blocks_per_call=BLOCKS_PER_STRIP,
    )


def _make_empty_fast_results(dtype, settings, n_lanes):
    zero = jnp.zeros(n_lanes, dtype)
    results = reference_strobe.make_empty_results(n_lanes, settings.slots, dtype, settings.clearance)
    return results, (Tangent(zero, zero),) * len(settings.argnums), jnp.zeros(n_lanes, bool)


def _fast_period_in_strip(scene, state, start_tangents, settings, min_lanes):
    """Run `_run_fast_period` block after block."""
    make_empty_results = partial(_make_empty_fast_results, scene.dtype, settings)
    return run_in_blocks(
        lambda arguments: _run_fast_period(*arguments, settings),
        (scene, state, start_tangents),
        make_empty_results,
        min_lanes,
    )


def _run_fast_period(scene, state, start_tangents, settings):
    """Return ((State, Impacts), tangents for each active argument, mask of given-up lanes) of a fast period."""
    coeffs = make_flow_coefficients(scene)
    fast_coeffs = fast_coefficients.make_fast_coefficients(coeffs)
    path, start_status = start_path(coeffs, state)
    fast_lanes = fast_path.start_lanes(fast_coeffs, path, start_status == Status.OK)
    parameter_directions = tuple(_parameter_direction(fast_coeffs, scene, state, argnum) for argnum in settings.argnums)
    start_tangents = tuple(Tangent(x, v * fast_coeffs.max_step) for x, v in start_tangents)
    empty_log = impact_log.empty_log(state.x, settings.slots, coeffs.period)
    fast_lanes, log, slot_rows, tangents, min_clearance = fast_path.run_lanes(
        fast_coeffs, fast_lanes, *empty_log, parameter_directions, start_tangents, settings.clearance
    )
    times, sides, speeds = impact_log.impact_arrays(slot_rows)
    is_valid_start = start_status == Status.OK
    slot_status = choose(log.count > settings.slots, lax.full_like(start_status, Status.FULL), Status.OK)
    x, v = (
        choose(is_valid_start, fast_lanes.x, jnp.nan),
        choose(is_valid_start, fast_lanes.v * fast_coeffs.inverse_max_step, jnp.nan),
    )
    impacts = Impacts(
        time=times,
        side=sides,
        speed=speeds,
        count=log.count.astype(jnp.int32),
        least_speed=log.least_speed,
        least_clearance=min_clearance,
        status=choose(is_valid_start, slot_status, start_status).astype(jnp.int32),
    )
    end_state = State(x, v, jnp.broadcast_to(state.phase, x.shape), jnp.zeros_like(x))
    tangents = tuple(
        Tangent(choose(is_valid_start, x, jnp.nan), choose(is_valid_start, v * fast_coeffs.inverse_max_step, jnp.nan))
        for x, v in tangents
    )
    return (end_state, impacts), tangents, fast_lanes.time_remaining == fast_coefficients.GIVEN_UP


def _parameter_direction(fast_coeffs, scene, state, argnum):
    """Return the `fast_tangent.ParameterDirection` of one leaf of (scene, state)."""
    leaves, tree = jax.tree.flatten((scene, state))
    argument_derivatives = [jnp.ones_like(leaf) if k == argnum else None for k, leaf in enumerate(leaves)]
    argument_derivatives, state_derivatives = tree.unflatten(argument_derivatives)
    return fast_tangent.parameter_direction(fast_coeffs, scene, argument_derivatives, state_derivatives.phase)


def _strobe_period(scene, state, start_tangents, settings, min_lanes):
    """Return ((State, Impacts), `ReplayHistory`, tangents) of one period by the fast path, else the reference path."""
    results, tangents, is_given_up = _fast_period_in_blocks(scene, state, start_tangents, settings, min_lanes)
    rerun_given_up_lanes = partial(_rerun_by_reference, (scene, state, start_tangents), settings, is_given_up)
    replay_history = reference_strobe.history_without_release(results[1], settings.history_slots)
    return lax.cond(
        jnp.any(is_given_up), rerun_given_up_lanes, lambda unchanged: unchanged, (results, replay_history, tangents)
    )


def _rerun_by_reference(arguments, settings, is_given_up, results):
    """Recompute the selected lanes by the reference path, block by block, and replace their results."""
    run_reference_period = partial(_reference_period, settings=settings)
    if not is_given_up.shape:
        return run_reference_period(*arguments)
    n_lanes, block_width = len(is_given_up), min(reference_block_width(), len(is_given_up))
    padded_lane_indices = jnp.append(
        jnp.nonzero(is_given_up, size=n_lanes, fill_value=n_lanes)[0], jnp.full(block_width, n_lanes)
    )

    def run_block(block_index, results):
        block_lane_indices = lax.dynamic_slice_in_dim(padded_lane_indices, block_index * block_width, block_width)
        lane_arguments = jax.tree.map(
            lambda leaf: leaf.at[block_lane_indices].get(mode="clip") if jnp.ndim(leaf) else leaf, arguments
        )
        return jax.tree.map(
            lambda old, new: old.at[block_lane_indices].set(new, mode="drop"),
            results,
            run_reference_period(*lane_arguments),
        )

    return lax.fori_loop(0, -(-jnp.sum(is_given_up) // block_width), run_block, results)


def _reference_period(scene, state, start_tangents, settings):
    """Compute a period by the reference path with derivatives by replay; the results are those of `_strobe_period`."""
    argnums = settings.argnums
    strobe_options = {
        "slots": settings.slots,
        "clearance": settings.clearance,
        "history_slots": reference_strobe.REPLAY_SLOTS if argnums else settings.history_slots,
    }
    (end_state, impacts), replay_history = call_as_kernel(
        reference_strobe.strobe_with_history, scene, state, periods=1, **strobe_options
    )
    if not argnums:
        return (end_state, impacts), replay_history, ()
    leaves, tree = jax.tree.flatten((scene, state))
    impacts_to_replay = move_slots_first(collect_replay_data(end_state, impacts, replay_history).impacts_since_release)
    state_argnums = _state_argnums(tree)
    active_indices = tuple(sorted({*argnums, *state_argnums}))
    ((x_derivatives, v_derivatives),) = call_as_kernel(
        replay_derivatives,
        leaves,
        impacts_to_replay,
        tree=tree,
        argnums=active_indices,
        periods=1,
        order=1,
        of_state=True,
    )
    jacobian_columns = {
        argnum: (x_derivatives[..., column_index], v_derivatives[..., column_index])
        for column_index, argnum in enumerate(active_indices)
    }
    is_independent_of_start = (replay_history.release_time >= 0) | (abs(end_state.contact) == Contact.STUCK)

    def propagate_tangent(argnum, start_tangent):
        tangent_from_state = [
            sum(
                jacobian_columns[state_argnum][component_index] * start_component
                for state_argnum, start_component in zip(state_argnums, start_tangent, strict=True)
            )
            for component_index in (0, 1)
        ]
        tangent_from_state = [
            choose(is_independent_of_start, 0.0, component) for component in tangent_from_state
        ]  # for any start, also nan
        return (
            Tangent(*tangent_from_state)
            if argnum in state_argnums
            else Tangent(
                *(
                    part_from_state + part_from_argument
                    for part_from_state, part_from_argument in zip(
                        tangent_from_state, jacobian_columns[argnum], strict=True
                    )
                )
            )
        )

    tangents = tuple(
        propagate_tangent(*argnum_and_start) for argnum_and_start in zip(argnums, start_tangents, strict=True)
    )
    return (end_state, impacts), ReplayHistory(replay_history.release_time), tangents


def _append_period(scene, settings, min_lanes, period_index, results):
    """Compute one more period, with index `period_index` counted from 0, and append it to the results."""
    slots = settings.slots
    (state, old_impacts), old_history, tangents = results
    (end_state, new_impacts), new_history, tangents = _strobe_period(scene, state, tangents, settings, min_lanes)
    period_start_time = period_index * make_flow_coefficients(scene).period
    is_invalid = old_impacts.status >= Status.CAP
    status = jnp.where(is_invalid, old_impacts.status, jnp.maximum(old_impacts.status, new_impacts.status))
    append_new_rows = partial(_append_rows, old_impacts.count)
    impacts = Impacts(
        time=append_new_rows(old_impacts.time, _delay_times(new_impacts.time, period_start_time)),
        side=append_new_rows(old_impacts.side, new_impacts.side),
        speed=append_new_rows(old_impacts.speed, new_impacts.speed),
        count=old_impacts.count + new_impacts.count,
        least_speed=jnp.minimum(old_impacts.least_speed, new_impacts.least_speed),
        least_clearance=jnp.minimum(old_impacts.least_clearance, new_impacts.least_clearance)
        if settings.clearance
        else None,
        status=jnp.where((status == Status.OK) & (old_impacts.count + new_impacts.count > slots), Status.FULL, status),
    )
    return (
        (end_state, impacts),
        _join_histories(old_impacts.count, old_history, new_history, period_start_time),
        tangents,
    )


def _append_rows(n_old_entries, old_rows, new_rows):
    """Write new rows after the first `n_old_entries` entries of old rows; the last axis is that of the slots."""
    new_row_indices = jnp.arange(old_rows.shape[-1]) - n_old_entries.astype(int)[..., None]
    return jnp.where(new_row_indices >= 0, jnp.take_along_axis(new_rows, jnp.maximum(new_row_indices, 0), -1), old_rows)


def _delay_times(times, delay):
    return times + jnp.asarray(delay)[..., None]


def _join_histories(n_old_impacts, old_history, new_history, period_start_time):
    """Join the `ReplayHistory` of a path with `n_old_impacts` impacts and the `ReplayHistory` of the next period."""
    has_new_release = new_history.release_time >= 0
    release_time = jnp.where(has_new_release, new_history.release_time + period_start_time, old_history.release_time)
    if new_history.count is None:
        return ReplayHistory(release_time)

    def rows_since_release(old_rows, new_rows):
        return jnp.where(has_new_release[..., None], new_rows, _append_rows(old_history.count, old_rows, new_rows))

    new_last_release_times = jnp.where(
        new_history.last_releases >= 0,
        _delay_times(new_history.last_releases, period_start_time),
        old_history.release_time[..., None],
    )
    return ReplayHistory(
        release_time,
        jnp.where(has_new_release, new_history.count, old_history.count + new_history.count),
        rows_since_release(old_history.times, _delay_times(new_history.times, period_start_time)),
        rows_since_release(old_history.sides, new_history.sides),
        _append_rows(n_old_impacts, old_history.last_releases, new_last_release_times),
    )
