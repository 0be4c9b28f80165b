"""Compute both Lyapunov exponents of the attractor against a parameter, with error bars."""

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

FEW_ROUNDS, MANY_ROUNDS = 8, 64  # rounds until most values have settled, and until the others are averaged


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
    """Compute both Lyapunov exponents of the motion for many values of a parameter.

    A motion that recurs after at most 32 periods has its exponents from its multipliers, ``ln abs(mu) / n``. All other
    exponents are averages along 64 copies of the motion.

    Parameters
    ----------
    scene : Scene
        Scene without lanes.
    name : str
        Parameter of the scene, for example ``"amplitude"`` or ``"left.position"``.
    values : array_like
        Values of the parameter. Array of shape (count,).
    state : State
        Initial state at every value. Its fields are numbers, or arrays with one number for each value.
    settle : int, optional
        Drive periods discarded.
    error : float, optional
        Largest standard error of both exponents at which the average ends, per drive period.
    most : int, optional
        Number of drive periods, approximately, at which the average ends.
    progress : callable, optional
        Called with the number of values done.
    store : Store, optional
        Store that keeps the results, 64 values at a time, and from which the computation resumes. None keeps them in
        memory.
    max_seconds : float, optional
        Wall-clock time, in s, after which no value (with a store: no block of values) is started. None is no limit.

    Returns
    -------
    xarray.Dataset
        Variables along `name`: ``exponent`` and ``error`` (name, order), the larger exponent first, per drive period;
        the error is a standard error, or the rounding error for an orbit. ``impacts``: impacts per period.
        ``impacts_on`` (name, wall): impacts per period on each wall, among the first 32 in a period; an entry into a
        soft wall is an impact. ``within`` (name, wall): time inside a soft wall per drive period, 0 for a rigid wall.
        ``periods``: drive periods of the orbit, 0 if none was recognised. ``count``: drive periods averaged.
        ``status``: as in `Impacts`. ``rests``: number of times per period at which the mass begins to stick.
        ``between``: largest growth of tangents between two phases of sticking, per drive period of the time between
        them, the impacts of complete chatter included (accurate to a few hundredths); nan without such a flight.

    Raises
    ------
    ArgumentError
        If an argument is invalid for `sweep`, the error is not positive, or a count is invalid.

    See Also
    --------
    sweep : Sweep a parameter and record the stroboscopic states.

    Notes
    -----
    The sum of the exponents is known without error: ``-2 gamma T + 2 ln R`` times ``impacts_on``, minus
    ``2 (gamma2 - gamma)`` times ``within``. It is measured for a user-defined force.

    - Both exponents are -inf if the mass sticks to a wall, since later states then do not depend on its past.
    - The second is -inf if a wall that is hit has ``R = 0`` and the mass does not stick.
    - Both are nan if a period has more than 32 impacts in flight (status full), or at an impact with zero speed (status
      nonfinite).

    Standard errors are batch means. After `max_seconds`, the values that are not done have nan and the status -1, and
    the attribute ``stopped`` gives the reason. A later call with the same store resumes. The errors of the store are
    passed on.

    References
    ----------
    Benettin et al., Meccanica 15 (1980) 9-20. Impacts: Mueller, Chaos, Solitons and Fractals 5 (1995) 1671-1681. Sum of
    the exponents: paper, (38).

    Examples
    --------
    >>> data = jv.spectrum(scene, "amplitude", [2.0, 2.1], state, settle=50)
    >>> data["exponent"].values.round(4).tolist()
    [[-0.8629, -0.8629], [-0.8629, -0.8629]]
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
    """Return (values, state) as arrays of the scene's type, checked."""
    check.require_parameter(name, scene.names, name)
    values = check.finite_array(name, values, scene.dtype)
    if values.ndim != 1 or len(values) == 0:
        raise check.ArgumentError(name, "must be a sequence of at least one value", values)
    require_scene_units("values", scene, name, values)
    scenes = scene.replace(**{name: values})
    state = check_start_state(state_arrays(scene, state), scene.dtype, [(name, values)])
    check_start(scenes, state, "at each value")
    return values, state


def _block_exponents(scenes, state, settle, target_error, max_periods):
    """Run `_compute_exponents` in this thread."""
    return _compute_exponents(SerialPool, scenes, state, settle, target_error, max_periods, lambda n_done: None)


def _compute_exponents(pool, scenes, state, settle, target_error, max_periods, progress, limits=UNLIMITED):
    """Return the `ExponentEstimate` and the `StickingPhases` (count per period) of each value, in order.

    The status of an estimate is -1 if the time limit was reached before it was computed.
    """
    all_indices = np.arange(len(state.x))

    def settle_block(indices):
        """Run a block of values for the first rounds; None after the time limit."""
        return (
            None
            if limits.expired
            else run_until_recurrence(
                take_lanes(scenes, indices), start_tangents(take_lanes(state, indices)), settle, FEW_ROUNDS
            )
        )

    def settle_longer(indices):
        """Run unsettled values for further rounds; None after the time limit."""
        if limits.expired:
            return None
        return run_until_recurrence(
            take_lanes(scenes, indices), _concatenate_lanes(settled_lanes[k].lanes for k in indices), 0, MANY_ROUNDS
        )

    def solve_orbits(indices):
        """Compute the exponents of the periodic orbits of a block."""
        state, periods = _concatenate_lanes((settled_lanes[k].lanes.state, settled_lanes[k].periods) for k in indices)
        return compute_orbit_exponents(take_lanes(scenes, indices), state, periods)

    def average_value(k):
        """Average the exponents of one value; (None, None) after the time limit."""
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
    """Concatenate trees of lanes along their last axis."""
    return jax.tree.map(lambda *leaves: np.concatenate(leaves, axis=-1), *trees)


def _split_lanes(trees):
    """Split trees of lanes into trees of one lane each."""
    lane_trees = []
    for tree in trees:
        leaves, structure = jax.tree.flatten(tree)
        lane_trees += [
            structure.unflatten([leaf[..., k : k + 1] for leaf in leaves]) for k in range(leaves[0].shape[-1])
        ]
    return lane_trees


def _map_blocks(pool, function, indices):
    """Return the results of a function of an array of lanes, block by block."""
    return list(
        _map_in_order(
            pool, function, [indices[start : start + BLOCK_WIDTH] for start in range(0, len(indices), BLOCK_WIDTH)]
        )
    )


def _map_lanes(pool, function, indices):
    """Return {value: tree of one lane} of a function of an array of lanes, which may return None for a block."""
    blocks = [indices[start : start + BLOCK_WIDTH] for start in range(0, len(indices), BLOCK_WIDTH)]
    trees = zip(blocks, _map_in_order(pool, function, blocks), strict=True)
    block_lanes = [(block.tolist(), _split_lanes([tree])) for block, tree in trees if tree is not None]
    return {k: lane_tree for block, lane_trees in block_lanes for k, lane_tree in zip(block, lane_trees, strict=True)}


def _map_in_order(pool, function, items):
    """Yield the results in order. The first item runs alone, since two threads would both compile."""
    yield from map(function, items[:1])
    yield from pool.map(function, items[1:])


def _orbit_estimates(pool, solve_orbits, indices):
    """Return {value: `ExponentEstimate`} of the values on a periodic orbit that does not repel."""
    blocks = _map_blocks(pool, solve_orbits, np.array(indices, int))
    estimates = [take_lanes(block, k) for block in blocks for k in range(len(block.periods))]
    return {k: estimate for k, estimate in zip(indices, estimates, strict=True) if not estimate.is_repelling}


def _make_dataset(scene, name, values, state, estimates, sticking):
    """Return the named result of the `ExponentEstimate` and the `StickingPhases` of each value."""
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
