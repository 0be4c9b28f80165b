"""Stroboscopic map in two tiers: the fast path first, the reference path for the lanes that it gives up.

The tier of a lane depends on this lane alone, so that a batch may be cut and permuted at will. Each of several periods
begins with the state at the end of the one before: it is a strobe of its own.
"""

from dataclasses import replace
from functools import partial
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax import lax

from ..compiled.blocks import run_in_blocks
from ..compiled.compiler_hints import choose
from ..compiled.kernels import call_as_kernel, narrow_block_width
from ..flight import fast_coefficients, fast_path, fast_tangent, impact_log
from ..flight.coefficients import compute_coefficients
from ..flight.entry import start_path
from ..flight.fast_tangent import Tangent
from ..scene.codes import Contact, Status
from ..scene.state import Impacts, State
from . import one_period
from .one_period import ReplayHistory
from .replay_derivatives import collect_replay_data, move_slots_first, replay_derivatives

BLOCKS_PER_STRIP = 8  # blocks of one kernel: the launch of a kernel takes a tenth of a block's time


class StrobeSettings(NamedTuple):
    """Static options of a strobe.

    `slots` are the recorded impacts; `clearance` requests the least clearance; `argnums` are the indices of the leaves
    of (scene, state) to differentiate by; `history_slots` are the slots of a `ReplayHistory` per period.
    """

    slots: int
    clearance: bool = False
    argnums: tuple[int, ...] = ()
    history_slots: int = 0


def strobe(scene, state, periods, slots, min_lanes, clearance=False):
    """Evaluate the map for numbers that broadcast.

    Parameters
    ----------
    scene, state : Scene, State
        Numbers that broadcast with each other.
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
    return strobe_with_record(scene, state, periods, slots, min_lanes, clearance)[0]


def strobe_with_record(scene, state, periods, slots, min_lanes, clearance=False, history_slots=0):
    """Return ((State, Impacts), `ReplayHistory`); `history_slots` is at most the number of slots of the impacts."""
    if not has_fast_path(scene):
        return one_period.strobe_with_record(scene, state, periods, slots, min_lanes, clearance, history_slots)
    scene, state, shape = _flatten_lanes(scene, state)
    results, history, _ = _strobe_periods(
        scene, state, (), periods, StrobeSettings(slots, clearance, history_slots=history_slots), min_lanes
    )
    return _restore_shape((results, history), shape)


def strobe_with_jacobian(tree, *leaves, periods, slots, min_lanes, argnums):
    """Return ((State, Impacts), (derivatives of x, of v)) with respect to chosen leaves of (scene, state).

    The derivatives have a last axis for the leaves `argnums`. The scene must have a fast path (`has_fast_path`).
    """
    scene, state, shape = _flatten_lanes(*tree.unflatten(leaves))
    zero, one = jnp.zeros_like(state.x), jnp.ones_like(state.x)
    start_tangents = tuple(Tangent(*(one if argnum == k else zero for k in _state_argnums(tree))) for argnum in argnums)
    results, _, tangents = _strobe_periods(
        scene, state, start_tangents, periods, StrobeSettings(slots, argnums=argnums), min_lanes
    )
    jacobian = tuple(jnp.stack(components, axis=-1) for components in zip(*tangents, strict=True))
    return _restore_shape((results, jacobian), shape)


def _state_argnums(tree):
    """Return the indices of x and v among the leaves of (scene, state)."""
    return tree.num_leaves - 4, tree.num_leaves - 3


def _strobe_periods(scene, state, start_tangents, periods, settings, min_lanes):
    results = _strobe_period(scene, state, start_tangents, settings, min_lanes)
    if periods > 1:
        results = lax.fori_loop(1, periods, partial(_append_period, scene, settings, min_lanes), results)
    return results


def _restore_shape(tree, shape):
    return jax.tree.map(lambda leaf: leaf.reshape(*shape, *leaf.shape[1:]) if shape else leaf, tree)


def fast_strobe(scene, state, slots, min_lanes, clearance=False):
    """Return ((State, Impacts), given_up); the results of lanes that are given up have no meaning."""
    scene, state, shape = _flatten_lanes(scene, state)
    results, _, given_up = _fast_in_blocks(scene, state, (), StrobeSettings(slots, clearance), min_lanes)
    return _restore_shape((results, given_up), shape)


def has_fast_path(scene):
    """Test that the fast path applies: spring, damper, one drive term and rigid walls, in double precision."""
    walls = [wall for wall in (scene.left, scene.right) if wall is not None]
    is_single_term = scene.force is None and not scene.drive
    return is_single_term and bool(walls) and not any(wall.soft for wall in walls) and scene.dtype == np.float64


def _flatten_lanes(scene, state):
    """Return (scene, state, shape of the lanes); numbers become scalars or have all lanes along one axis."""
    shape = jnp.broadcast_shapes(*map(jnp.shape, jax.tree.leaves((scene, state))))
    state = replace(state, x=jnp.broadcast_to(state.x, shape))

    def flatten(leaf):
        return jnp.broadcast_to(leaf, shape).reshape(-1) if jnp.ndim(leaf) else leaf

    return *jax.tree.map(flatten, (scene, state)), shape


def _fast_in_blocks(scene, state, start_tangents, settings, min_lanes):
    def run(arguments):
        return call_as_kernel(_fast_strip, *arguments, settings=settings, min_lanes=min_lanes)

    return run_in_blocks(
        run,
        (scene, state, start_tangents),
        partial(_empty_results, scene.dtype, settings),
        min_lanes,
        max_blocks=BLOCKS_PER_STRIP,
    )


def _empty_results(dtype, settings, n_lanes):
    zero = jnp.zeros(n_lanes, dtype)
    results = one_period.empty_results(n_lanes, settings.slots, dtype, settings.clearance)
    return results, (Tangent(zero, zero),) * len(settings.argnums), jnp.zeros(n_lanes, bool)


def _fast_strip(scene, state, start_tangents, settings, min_lanes):
    """Run `_fast_period` block after block."""
    make_empty = partial(_empty_results, scene.dtype, settings)
    return run_in_blocks(
        lambda arguments: _fast_period(*arguments, settings), (scene, state, start_tangents), make_empty, min_lanes
    )


def _fast_period(scene, state, start_tangents, settings):
    """Return ((State, Impacts), tangents by the active arguments, given_up) of a period by the fast path."""
    coeffs = compute_coefficients(scene)
    fast_coeffs = fast_coefficients.scale_coefficients(coeffs)
    path, entry_status = start_path(coeffs, state)
    lanes = fast_path.start_lanes(fast_coeffs, path, entry_status == Status.OK)
    shifts = tuple(_argument_shift(fast_coeffs, scene, state, argnum) for argnum in settings.argnums)
    start_tangents = tuple(Tangent(x, v * fast_coeffs.max_step) for x, v in start_tangents)
    empty_log = impact_log.empty_log(state.x, settings.slots, coeffs.period)
    lanes, log, slot_rows, tangents, min_clearance = fast_path.run_lanes(
        fast_coeffs, lanes, *empty_log, shifts, start_tangents, settings.clearance
    )
    times, sides, speeds = impact_log.impact_rows(slot_rows)
    is_valid = entry_status == Status.OK
    slot_status = choose(log.count > settings.slots, lax.full_like(entry_status, Status.FULL), Status.OK)
    x, v = choose(is_valid, lanes.x, jnp.nan), choose(is_valid, lanes.v * fast_coeffs.inverse_max_step, jnp.nan)
    impacts = Impacts(
        time=times,
        side=sides,
        speed=speeds,
        count=log.count.astype(jnp.int32),
        least_speed=log.least_speed,
        least_clearance=min_clearance,
        status=choose(is_valid, slot_status, entry_status).astype(jnp.int32),
    )
    end = State(x, v, jnp.broadcast_to(state.phase, x.shape), jnp.zeros_like(x))
    tangents = tuple(
        Tangent(choose(is_valid, x, jnp.nan), choose(is_valid, v * fast_coeffs.inverse_max_step, jnp.nan))
        for x, v in tangents
    )
    return (end, impacts), tangents, lanes.time_remaining == fast_coefficients.GIVEN_UP


def _argument_shift(fast_coeffs, scene, state, argnum):
    """Return the `fast_tangent.ParameterDirection` of one number of scene and state."""
    leaves, tree = jax.tree.flatten((scene, state))
    rates = [jnp.ones_like(leaf) if k == argnum else None for k, leaf in enumerate(leaves)]
    rates, state_rates = tree.unflatten(rates)
    return fast_tangent.parameter_direction(fast_coeffs, scene, rates, state_rates.phase)


def _strobe_period(scene, state, start_tangents, settings, min_lanes):
    """Return ((State, Impacts), `ReplayHistory`, tangents) of one period: fast path, else reference path."""
    results, tangents, given_up = _fast_in_blocks(scene, state, start_tangents, settings, min_lanes)
    rerun = partial(_reference_rerun, (scene, state, start_tangents), settings, given_up)
    history = one_period.history_without_release(results[1], settings.history_slots)
    return lax.cond(jnp.any(given_up), rerun, lambda unchanged: unchanged, (results, history, tangents))


def _reference_rerun(arguments, settings, is_due, results):
    """Replace the results of the lanes that are due, block by block, by the reference path."""
    run = partial(_reference_period, settings=settings)
    if not is_due.shape:
        return run(*arguments)
    n_lanes, block_width = len(is_due), min(narrow_block_width(), len(is_due))
    due_indices = jnp.append(jnp.nonzero(is_due, size=n_lanes, fill_value=n_lanes)[0], jnp.full(block_width, n_lanes))

    def run_block(k, results):
        block_indices = lax.dynamic_slice_in_dim(due_indices, k * block_width, block_width)
        lane_arguments = jax.tree.map(
            lambda leaf: leaf.at[block_indices].get(mode="clip") if jnp.ndim(leaf) else leaf, arguments
        )
        return jax.tree.map(lambda old, new: old.at[block_indices].set(new, mode="drop"), results, run(*lane_arguments))

    return lax.fori_loop(0, -(-jnp.sum(is_due) // block_width), run_block, results)


def _reference_period(scene, state, start_tangents, settings):
    """Compute a period by the reference path, with derivatives by replay; results as for `_strobe_period`."""
    argnums = settings.argnums
    settings_dict = {
        "slots": settings.slots,
        "clearance": settings.clearance,
        "history_slots": one_period.REPLAY_SLOTS if argnums else settings.history_slots,
    }
    (end, impacts), history = call_as_kernel(one_period.strobe_with_history, scene, state, periods=1, **settings_dict)
    if not argnums:
        return (end, impacts), history, ()
    leaves, tree = jax.tree.flatten((scene, state))
    impacts_to_replay = move_slots_first(collect_replay_data(end, impacts, history).state_impacts)
    state_argnums = _state_argnums(tree)
    active_indices = tuple(sorted({*argnums, *state_argnums}))
    ((x, v),) = call_as_kernel(
        replay_derivatives,
        leaves,
        impacts_to_replay,
        tree=tree,
        argnums=active_indices,
        periods=1,
        order=1,
        of_state=True,
    )
    columns = {argnum: (x[..., k], v[..., k]) for k, argnum in enumerate(active_indices)}
    forgets_start = (history.release_time >= 0) | (abs(end.contact) == Contact.STUCK)

    def propagate(argnum, tangent):
        state_part = [
            sum(columns[k][component] * rate for k, rate in zip(state_argnums, tangent, strict=True))
            for component in (0, 1)
        ]
        state_part = [choose(forgets_start, 0.0, component) for component in state_part]  # for any start, also nan
        return (
            Tangent(*state_part)
            if argnum in state_argnums
            else Tangent(*(a + b for a, b in zip(state_part, columns[argnum], strict=True)))
        )

    tangents = tuple(propagate(*argnum_and_start) for argnum_and_start in zip(argnums, start_tangents, strict=True))
    return (end, impacts), ReplayHistory(history.release_time), tangents


def _append_period(scene, settings, min_lanes, period, results):
    """Append one more period, with index `period` from 0, to the results."""
    slots = settings.slots
    (state, old_impacts), old_history, tangents = results
    (end, new_impacts), new_history, tangents = _strobe_period(scene, state, tangents, settings, min_lanes)
    start_time = period * compute_coefficients(scene).period
    is_invalid = old_impacts.status >= Status.CAP
    status = jnp.where(is_invalid, old_impacts.status, jnp.maximum(old_impacts.status, new_impacts.status))
    append = partial(_append_rows, old_impacts.count)
    impacts = Impacts(
        time=append(old_impacts.time, _delay_times(new_impacts.time, start_time)),
        side=append(old_impacts.side, new_impacts.side),
        speed=append(old_impacts.speed, new_impacts.speed),
        count=old_impacts.count + new_impacts.count,
        least_speed=jnp.minimum(old_impacts.least_speed, new_impacts.least_speed),
        least_clearance=jnp.minimum(old_impacts.least_clearance, new_impacts.least_clearance)
        if settings.clearance
        else None,
        status=jnp.where((status == Status.OK) & (old_impacts.count + new_impacts.count > slots), Status.FULL, status),
    )
    return (end, impacts), _join_histories(old_impacts.count, old_history, new_history, start_time), tangents


def _append_rows(n_old, old_rows, new_rows):
    """Append rows after the first `n_old` entries; slots are the last axis."""
    source = jnp.arange(old_rows.shape[-1]) - n_old.astype(int)[..., None]
    return jnp.where(source >= 0, jnp.take_along_axis(new_rows, jnp.maximum(source, 0), -1), old_rows)


def _delay_times(times, start_time):
    return times + jnp.asarray(start_time)[..., None]


def _join_histories(n_impacts, old_history, new_history, start_time):
    """Join the `ReplayHistory` of a path with `n_impacts` impacts and that of the period after it."""
    has_release = new_history.release_time >= 0
    release_time = jnp.where(has_release, new_history.release_time + start_time, old_history.release_time)
    if new_history.count is None:
        return ReplayHistory(release_time)

    def since_release(old_rows, new_rows):
        return jnp.where(has_release[..., None], new_rows, _append_rows(old_history.count, old_rows, new_rows))

    last_releases = jnp.where(
        new_history.last_releases >= 0,
        _delay_times(new_history.last_releases, start_time),
        old_history.release_time[..., None],
    )
    return ReplayHistory(
        release_time,
        jnp.where(has_release, new_history.count, old_history.count + new_history.count),
        since_release(old_history.times, _delay_times(new_history.times, start_time)),
        since_release(old_history.sides, new_history.sides),
        _append_rows(n_impacts, old_history.last_releases, last_releases),
    )
