"""The Lyapunov spectrum against a parameter: both exponents of what a scene settles on, with error bars."""

from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor

import jax
import numpy as np
import xarray as xr
from jaxtyping import ArrayLike, Float, Real

from continuation.limits import UNLIMITED, limits_of, partial_reason

from ..compiled.kernels import BLOCK_WIDTH
from ..maps.long_run import take_lanes
from ..maps.sticking_phases import NO_STICKING, find_sticking_phases
from ..output.units import scales_attributes, unit_of
from ..scene import check
from ..scene.scene import Scene
from ..scene.state import State, check_start, state_arrays
from ..scene.unit_mistakes import require_scene_units
from ..stores.engines import SerialPool, n_usable_cores
from ..stores.filling import Store, complete_study
from .chaotic_exponents import estimate_exponents, run_until_recurrence
from .orbit_exponents import compute_orbit_exponents, undefined_estimate
from .spectrum_study import SpectrumStudy, estimates_from
from .sweep import STATUS_FLAGS, UNITS_TEXT, check_start_state, equation_text, other_parameters, static_attributes
from .tangent import RECORDED_PERIODS, start_tangents

FEW_ROUNDS, MANY_ROUNDS = 8, 64  # rounds after which most values have settled, and after which the others are averaged


@check.host_only("use monodromy")
def spectrum(
    scene: Scene,
    name: str,
    values: Real[ArrayLike, "..."] | Sequence[float],
    state: State,
    settle: int = 300,
    error: Real[ArrayLike, ""] = 2e-3,
    most: int = 2**20,
    progress: Callable[[int], object] | None = None,
    store: Store | None = None,
    *,
    max_seconds: float | None = None,
) -> xr.Dataset:
    """Both Lyapunov exponents per drive period of what a scene settles on, for many values of a parameter: a Dataset.

    scene: a single one; name: of any of its parameters, dotted for a wall's; values: shape (count,). state: a `State`
    where every value starts, of numbers or with a number for each value. settle: drive periods left out. What recurs
    after at most 32 periods has its exponents from its multipliers, ln abs(mu) / n; all else from averages along 64
    copies of the motion, until the standard errors of both are at most `error`, or about `most` drive periods have been
    averaged. progress: called with the number of values done. store: a `Store` to keep the numbers in, 64 values at a
    time, and to go on with; None: in memory.

    The Dataset, along `name`: exponent and error (name, order), the larger first, per drive period, the error a
    standard error (of an orbit: what rounding leaves unsure); impacts per period, and impacts_on (name, wall), of the
    first 32 in a period, an entry into a soft one being an impact; within (name, wall), the time spent within a soft
    wall, t per drive period, 0 of a rigid one; periods of the orbit, 0 where none was recognised; count, drive periods
    averaged; status, as `Impacts` has it. The exponents' sum is -2 gamma T + 2 ln R times impacts_on - 2 (gamma2 -
    gamma) times within, without error (of a force of the user's own it is measured). Both are -inf where the mass comes
    to rest on a wall, as it then forgets all. rests: how often a period it does so; between: the largest growth of
    tangents from where a wall lets it go to where it next comes to rest, the hops of complete chatter included, a drive
    period of the time between (`find_sticking_phases`: to within some hundredths); nan where it has no such flight.
    Where a wall that is hit has R = 0 and the mass does not rest the second exponent is -inf. Both are nan where the
    motion has no end, with more than 32 impacts a period in flight (status full), and on an impact without speed
    (nonfinite).

    max_seconds: wall-clock time, s, after which no value is begun, or with a store no block of values; None is no
    limit. Values that are not done have nan and the status -1, and the attribute `stopped` says why; a later call with
    the same store goes on.

    Sources: Benettin et al., Meccanica 15 (1980) 9-20; at impacts Mueller, Chaos, Solitons and Fractals 5 (1995)
    1671-1681; paper, (38). Errors by batch means (`batch_means.standard_error`).

    Raises ArgumentError as `sweep` does, for an error that is not positive, and for counts that cannot be; and what the
    store raises.
    """
    limits = limits_of(None, max_seconds, None, check.ArgumentError)
    check.require_single(scene)
    settle, most = check.whole_number("settle", settle, 0), check.whole_number("most", most, 1)
    target_error = check.finite_array("error", error, np.float64)
    check.require("error", "must be greater than 0", target_error, target_error > 0)
    if target_error.shape:
        raise check.ArgumentError("error", "must be a single number", error)
    values, state = _check_arguments(scene, name, values, state)
    starts = jax.tree.map(lambda leaf: np.broadcast_to(leaf, values.shape), state)
    if store is None:
        with ThreadPoolExecutor(n_usable_cores()) as pool:
            scenes = scene.replace(**{name: values})
            report = progress or (lambda n_done: None)
            estimates, sticking = _compute_exponents(
                pool, scenes, starts, settle, float(target_error), most, report, limits
            )
        n_done = sum(int(estimate.status >= 0) for estimate in estimates)
        stopped = {} if n_done == len(values) else {"stopped": partial_reason(n_done, len(values), "values")}
    else:
        study = SpectrumStudy(scene, name, values, starts, _block_exponents, (settle, float(target_error), most))
        data = complete_study(study, store, progress and (lambda record: progress(record.done)), limits)
        estimates, sticking = estimates_from(data)
        stopped = {key: data.attrs[key] for key in ("stopped",) if key in data.attrs}
    return _make_dataset(scene, name, values, state, estimates, sticking).assign_attrs(stopped)


def _check_arguments(scene, name, values, state) -> tuple[Float[np.ndarray, " count"], State]:
    """(values, state), arrays of the scene's type, once they break no rule."""
    check.require_parameter(name, scene.names, name)
    values = check.finite_array(name, values, scene.dtype)
    if values.ndim != 1 or len(values) == 0:
        raise check.ArgumentError(name, "must be a sequence of values, at least one", values)
    require_scene_units("values", scene, name, values)
    scenes = scene.replace(**{name: values})
    state = check_start_state(state_arrays(scene, state), scene.dtype, [(name, values)])
    check_start(scenes, state, "at each value")
    return values, state


def _block_exponents(scenes, state, settle, target_error, max_periods):
    """`_compute_exponents` in this thread."""
    return _compute_exponents(SerialPool, scenes, state, settle, target_error, max_periods, lambda n_done: None)


def _compute_exponents(pool, scenes, state, settle, target_error, max_periods, progress, limits=UNLIMITED):
    """The `Rates` and the `Rests`, their count a period, of each value, in order; the status is -1 where the time was
    over."""
    all_indices = np.arange(len(state.x))

    def settle_block(indices):
        return (
            None
            if limits.expired
            else run_until_recurrence(
                take_lanes(scenes, indices), start_tangents(take_lanes(state, indices)), settle, FEW_ROUNDS
            )
        )

    def settle_longer(indices):
        if limits.expired:
            return None
        return run_until_recurrence(
            take_lanes(scenes, indices), _concatenate_lanes(settled_lanes[k].lanes for k in indices), 0, MANY_ROUNDS
        )

    def solve_orbits(indices):
        state, periods = _concatenate_lanes((settled_lanes[k].lanes.state, settled_lanes[k].periods) for k in indices)
        return compute_orbit_exponents(take_lanes(scenes, indices), state, periods)

    def average_value(k):
        return (
            (None, None)
            if limits.expired
            else estimate_exponents(take_lanes(scenes, k), settled_lanes[k], target_error, max_periods)
        )

    settled_lanes = _map_lanes(pool, settle_block, all_indices)
    unsettled_indices = np.array([k for k, entry in settled_lanes.items() if entry.is_unsettled], int)
    longer_runs = _map_lanes(pool, settle_longer, unsettled_indices)
    settled_lanes = {
        k: entry for k, entry in (settled_lanes | longer_runs).items() if k in longer_runs or not entry.is_unsettled
    }
    estimates = {k: undefined_estimate(entry.status[0]) for k, entry in settled_lanes.items() if not entry.is_valid}
    estimates |= _orbit_estimates(pool, solve_orbits, [k for k, entry in settled_lanes.items() if entry.periods[0]])
    progress(len(estimates))
    remaining = [k for k in settled_lanes if k not in estimates]
    for k, (estimate, new_settled) in zip(remaining, _map_in_order(pool, average_value, remaining), strict=True):
        if estimate is None:
            continue
        estimates[k] = estimate
        if new_settled is not None:
            settled_lanes[k] = new_settled
        progress(len(estimates))
    estimates |= _orbit_estimates(
        pool, solve_orbits, [k for k in remaining if k in estimates and settled_lanes[k].periods[0]]
    )
    sticking = [NO_STICKING if k in estimates else NO_STICKING._replace(count=np.nan) for k in all_indices.tolist()]
    for k in (k for k, entry in estimates.items() if np.isneginf(entry.exponent[0])):
        entry, state = take_lanes(scenes, k), jax.tree.map(lambda leaf: leaf[0], settled_lanes[k].lanes.state)
        sticking[k] = find_sticking_phases(entry, state, estimates[k].periods or RECORDED_PERIODS)
        sticking[k] = sticking[k]._replace(count=sticking[k].count / (estimates[k].periods or RECORDED_PERIODS))
    return [estimates.get(k, undefined_estimate(-1)) for k in all_indices.tolist()], sticking


def _concatenate_lanes(trees):
    """Trees of lanes, their last axis, one after the other."""
    return jax.tree.map(lambda *leaves: np.concatenate(leaves, axis=-1), *trees)


def _split_lanes(trees):
    """Trees of one lane each."""
    lane_trees = []
    for tree in trees:
        leaves, structure = jax.tree.flatten(tree)
        lane_trees += [
            structure.unflatten([leaf[..., k : k + 1] for leaf in leaves]) for k in range(leaves[0].shape[-1])
        ]
    return lane_trees


def _map_blocks(pool, function, indices):
    """The results of a function of an array of lanes, block by block."""
    return list(
        _map_in_order(
            pool, function, [indices[start : start + BLOCK_WIDTH] for start in range(0, len(indices), BLOCK_WIDTH)]
        )
    )


def _map_lanes(pool, function, indices):
    """{value: tree of one lane} of a function of an array of lanes, block by block; it gives None for a block that is
    left out."""
    blocks = [indices[start : start + BLOCK_WIDTH] for start in range(0, len(indices), BLOCK_WIDTH)]
    trees = zip(blocks, _map_in_order(pool, function, blocks), strict=True)
    block_lanes = [(block.tolist(), _split_lanes([tree])) for block, tree in trees if tree is not None]
    return {k: lane_tree for block, lane_trees in block_lanes for k, lane_tree in zip(block, lane_trees, strict=True)}


def _map_in_order(pool, function, items):
    """The results in order; the first alone, as two threads would each compile what it needs."""
    yield from map(function, items[:1])
    yield from pool.map(function, items[1:])


def _orbit_estimates(pool, solve_orbits, indices):
    """{value: `Rates`} of those that are on a periodic orbit which does not repel."""
    blocks = _map_blocks(pool, solve_orbits, np.array(indices, int))
    estimates = [take_lanes(block, k) for block in blocks for k in range(len(block.periods))]
    return {k: estimate for k, estimate in zip(indices, estimates, strict=True) if not estimate.is_repelling}


def _make_dataset(scene, name, values, state, estimates, sticking):
    """The named result of the `Rates` and the `Rests` of each value."""
    exponent, error, impacts, within, periods, status, count = (
        np.stack(arrays) for arrays in zip(*estimates, strict=True)
    )
    coords = {
        name: (name, values, {"long_name": name, "units": unit_of(name)}),
        "order": ("order", [1, 2], {"long_name": "place among the exponents, the larger first"}),
        "wall": ("wall", ["left", "right"]),
    }
    attrs = {
        "equation": equation_text(scene),
        "units": UNITS_TEXT,
        "swept": name,
        **static_attributes(scene),
        **scales_attributes(scene),
    }
    for key, value in (other_parameters(scene, name) | {"phase": state.phase}).items():
        if np.ndim(value):
            coords[key] = (name, value)
        else:
            attrs[key] = float(value)
    rate_attrs = {"units": "per drive period"}
    variables = {
        "exponent": ([name, "order"], exponent, {"long_name": "Lyapunov exponents", **rate_attrs}),
        "error": ([name, "order"], error, {"long_name": "standard errors of the exponents", **rate_attrs}),
        "rests": (
            name,
            [float(sticking_record.count) for sticking_record in sticking],
            {"long_name": "comings to rest on a wall", **rate_attrs},
        ),
        "between": (
            name,
            [sticking_record.growth_rate for sticking_record in sticking],
            {"long_name": "largest growth between rests", **rate_attrs},
        ),
        "impacts": (name, impacts[:, 0], {"long_name": "impacts", **rate_attrs}),
        "impacts_on": ([name, "wall"], impacts[:, 1:], {"long_name": "impacts on a wall", **rate_attrs}),
        "within": ([name, "wall"], within, {"long_name": "time within a soft wall", "units": "t per drive period"}),
        "periods": (name, periods, {"long_name": "drive periods of the orbit, 0 where none was recognised"}),
        "count": (name, count, {"long_name": "drive periods averaged"}),
        "status": (name, status, {"long_name": "worst status at this value", **STATUS_FLAGS}),
    }
    return xr.Dataset(variables, coords, attrs)
