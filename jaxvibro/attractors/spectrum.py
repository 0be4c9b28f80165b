"""The Lyapunov spectrum against a parameter: both exponents of what a scene settles on, with error bars."""

from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor

import jax
import numpy as np
import xarray as xr
from jaxtyping import ArrayLike, Float, Real

from continuation.limits import UNLIMITED, limits_of, partial_reason

from ..compiled.kernels import WIDTH
from ..maps.long_run import some
from ..maps.rests import NO_RESTS, rests
from ..output.units import scales_in, unit_of
from ..scene import check
from ..scene.scene import Scene
from ..scene.state import State, check_start, real_state
from ..scene.unit_slips import require_scene_units
from ..stores.engines import ThisThread, cores
from ..stores.filling import Store, done
from .chaotic_exponents import of_motion, settled
from .orbit_exponents import lost, of_orbits
from .spectrum_study import SpectrumStudy, rates_of
from .sweep import MEANING, UNITS, equation, others, started, static
from .tangent import LAPS, begin

FEW, MANY = 8, 64  # rounds after which most values have settled, and after which the others are averaged


@check.host("use monodromy")
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
    gamma) times within, without error (of a force of the user's own it is measured). Both are -inf where the
    mass comes to rest on a wall, as it then forgets all. rests: how often a period it does so; between: the largest
    growth of tangents from where a wall lets it go to where it next comes to rest, the hops of complete chatter
    included, a drive period of the time between (`rests`: to within some hundredths); nan where it has no such flight.
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
    settle, most = check.whole("settle", settle, 0), check.whole("most", most, 1)
    goal = check.number("error", error, np.float64)
    check.require("error", "must be greater than 0", goal, goal > 0)
    if goal.shape:
        raise check.ArgumentError("error", "must be a single number", error)
    values, state = _checked(scene, name, values, state)
    starts = jax.tree.map(lambda leaf: np.broadcast_to(leaf, values.shape), state)
    if store is None:
        with ThreadPoolExecutor(cores()) as pool:
            scenes = scene.replace(**{name: values})
            told = progress or (lambda done: None)
            found, resting = _found(pool, scenes, starts, settle, float(goal), most, told, limits)
        count = sum(int(one.status >= 0) for one in found)
        stopped = {} if count == len(values) else {"stopped": partial_reason(count, len(values), "values")}
    else:
        study = SpectrumStudy(scene, name, values, starts, _of_block, (settle, float(goal), most))
        data = done(study, store, progress and (lambda one: progress(one.done)), limits)
        found, resting = rates_of(data)
        stopped = {key: data.attrs[key] for key in ("stopped",) if key in data.attrs}
    return _dataset(scene, name, values, state, found, resting).assign_attrs(stopped)


def _checked(scene, name, values, state) -> tuple[Float[np.ndarray, " count"], State]:
    """(values, state), arrays of the scene's type, once they break no rule."""
    check.require_known(name, scene.names, name)
    values = check.number(name, values, scene.dtype)
    if values.ndim != 1 or len(values) == 0:
        raise check.ArgumentError(name, "must be a sequence of values, at least one", values)
    require_scene_units("values", scene, name, values)
    scenes = scene.replace(**{name: values})
    state = started(real_state(scene, state), scene.dtype, [(name, values)])
    check_start(scenes, state, "at each value")
    return values, state


def _of_block(scenes, state, settle, goal, most):
    """`_found` in this thread."""
    return _found(ThisThread, scenes, state, settle, goal, most, lambda done: None)


def _found(pool, scenes, state, settle, goal, most, progress, limits=UNLIMITED):
    """The `Rates` and the `Rests`, their count a period, of each value, in order; the status is -1 where the time was
    over."""
    everyone = np.arange(len(state.x))

    def early(index):
        return None if limits.expired else settled(some(scenes, index), begin(some(state, index)), settle, FEW)

    def late(index):
        if limits.expired:
            return None
        return settled(some(scenes, index), _joined(seen[k].lanes for k in index), 0, MANY)

    def orbits(index):
        state, periods = _joined((seen[k].lanes.state, seen[k].periods) for k in index)
        return of_orbits(some(scenes, index), state, periods)

    def motion(k):
        return (None, None) if limits.expired else of_motion(some(scenes, k), seen[k], goal, most)

    seen = _by_lane(pool, early, everyone)
    going = np.array([k for k, one in seen.items() if one.goes_on], int)
    later = _by_lane(pool, late, going)
    seen = {k: one for k, one in (seen | later).items() if k in later or not one.goes_on}
    found = {k: lost(one.status[0]) for k, one in seen.items() if not one.is_well}
    found |= _orbits(pool, orbits, [k for k, one in seen.items() if one.periods[0]])
    progress(len(found))
    rest = [k for k in seen if k not in found]
    for k, (rates, end) in zip(rest, _in_order(pool, motion, rest), strict=True):
        if rates is None:
            continue
        found[k] = rates
        if end is not None:
            seen[k] = end
        progress(len(found))
    found |= _orbits(pool, orbits, [k for k in rest if k in found and seen[k].periods[0]])
    resting = [NO_RESTS if k in found else NO_RESTS._replace(count=np.nan) for k in everyone.tolist()]
    for k in (k for k, one in found.items() if np.isneginf(one.exponent[0])):
        one, state = some(scenes, k), jax.tree.map(lambda leaf: leaf[0], seen[k].lanes.state)
        resting[k] = rests(one, state, found[k].periods or LAPS)
        resting[k] = resting[k]._replace(count=resting[k].count / (found[k].periods or LAPS))
    return [found.get(k, lost(-1)) for k in everyone.tolist()], resting


def _joined(parts):
    """Trees of lanes, their last axis, one after the other."""
    return jax.tree.map(lambda *leaves: np.concatenate(leaves, axis=-1), *parts)


def _lanes(trees):
    """Trees of one lane each."""
    cut = []
    for tree in trees:
        leaves, form = jax.tree.flatten(tree)
        cut += [form.unflatten([leaf[..., k : k + 1] for leaf in leaves]) for k in range(leaves[0].shape[-1])]
    return cut


def _in_blocks(pool, function, index):
    """The results of a function of an array of lanes, block by block."""
    return list(_in_order(pool, function, [index[first : first + WIDTH] for first in range(0, len(index), WIDTH)]))


def _by_lane(pool, function, index):
    """{value: tree of one lane} of a function of an array of lanes, block by block; it gives None for a block that is
    left out."""
    blocks = [index[first : first + WIDTH] for first in range(0, len(index), WIDTH)]
    trees = zip(blocks, _in_order(pool, function, blocks), strict=True)
    done = [(block.tolist(), _lanes([tree])) for block, tree in trees if tree is not None]
    return {k: one for block, lanes in done for k, one in zip(block, lanes, strict=True)}


def _in_order(pool, function, items):
    """The results in order; the first alone, as two threads would each compile what it needs."""
    yield from map(function, items[:1])
    yield from pool.map(function, items[1:])


def _orbits(pool, orbits, index):
    """{value: `Rates`} of those that are on a periodic orbit which does not repel."""
    blocks = _in_blocks(pool, orbits, np.array(index, int))
    rates = [some(block, k) for block in blocks for k in range(len(block.periods))]
    return {k: one for k, one in zip(index, rates, strict=True) if not one.repels}


def _dataset(scene, name, values, state, found, resting):
    """The named result of the `Rates` and the `Rests` of each value."""
    exponent, error, impacts, within, periods, status, count = (np.stack(part) for part in zip(*found, strict=True))
    coords = {
        name: (name, values, {"long_name": name, "units": unit_of(name)}),
        "order": ("order", [1, 2], {"long_name": "place among the exponents, the larger first"}),
        "wall": ("wall", ["left", "right"]),
    }
    attrs = {"equation": equation(scene), "units": UNITS, "swept": name, **static(scene), **scales_in(scene)}
    for key, value in (others(scene, name) | {"phase": state.phase}).items():
        if np.ndim(value):
            coords[key] = (name, value)
        else:
            attrs[key] = float(value)
    rate = {"units": "per drive period"}
    variables = {
        "exponent": ([name, "order"], exponent, {"long_name": "Lyapunov exponents", **rate}),
        "error": ([name, "order"], error, {"long_name": "standard errors of the exponents", **rate}),
        "rests": (name, [float(one.count) for one in resting], {"long_name": "comings to rest on a wall", **rate}),
        "between": (name, [one.rate for one in resting], {"long_name": "largest growth between rests", **rate}),
        "impacts": (name, impacts[:, 0], {"long_name": "impacts", **rate}),
        "impacts_on": ([name, "wall"], impacts[:, 1:], {"long_name": "impacts on a wall", **rate}),
        "within": ([name, "wall"], within, {"long_name": "time within a soft wall", "units": "t per drive period"}),
        "periods": (name, periods, {"long_name": "drive periods of the orbit, 0 where none was recognised"}),
        "count": (name, count, {"long_name": "drive periods averaged"}),
        "status": (name, status, {"long_name": "worst status at this value", **MEANING}),
    }
    return xr.Dataset(variables, coords, attrs)
