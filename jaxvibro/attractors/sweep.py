"""The swept diagram: a parameter goes through its values, and the state at the end of one starts the next."""

import math
from collections.abc import Callable, Sequence

import jax
import jax.numpy as jnp
import numpy as np
import xarray as xr
from jax import lax
from jaxtyping import ArrayLike, Float, Real

from continuation.limits import UNLIMITED, limits_of, partial_reason
from continuation.persistent_jit import persistent_jit

from ..compiled.compiler_hints import OPTIONS
from ..flight.wall_positions import fit
from ..maps.strobe import strobe
from ..output.units import LENGTH, SPEED, scales_in, unit_of
from ..scene import check
from ..scene.codes import Status
from ..scene.named_forces import named
from ..scene.scene import Scene
from ..scene.state import State, check_start
from ..scene.unit_slips import require_scene_units
from ..stores.filling import Store, done
from .sweep_study import SweepStudy

CHUNK = 16  # values between two reports of progress
DRIVE = "amplitude cos(frequency t)"
SPRING = f"x'' + 2 damping x' + x = {DRIVE}"
REBOUND = "y+ - v_b = -restitution (y- - v_b) at a rigid wall"
MEANING = {"flag_values": [int(one) for one in Status], "flag_meanings": " ".join(one.word for one in Status)}
UNITS = "lengths in that of the walls, time t in 1/w0"


@check.host("use strobe")
def sweep(
    scene: Scene,
    name: str,
    values: Real[ArrayLike, "..."] | Sequence[float],
    state: State,
    settle: int = 300,
    keep: int = 100,
    chunk: int = CHUNK,
    progress: Callable[[int], object] | None = None,
    store: Store | None = None,
    *,
    max_seconds: float | None = None,
) -> xr.Dataset:
    """What a scene settles on as one of its parameters goes through values, in their order: an xarray.Dataset.

    name: of any parameter of the scene, dotted for a wall's. values: shape (count,), or (count, ...) with lanes: the
    first axis is the way, the others broadcast with the scene's and the state's numbers, as in `strobe`; a lane is a
    sweep of its own. state: a `State`, where the first value starts. At each value `settle` drive periods are left out
    and the next `keep` recorded. chunk: values between two calls of `progress`, which is given the number of values
    done; it changes no bit of the result. store: a `Store` to keep very many lanes in, 64 at a time from their first
    value to their last, and to go on with; `progress` is then given lanes. None: in memory.

    The Dataset holds x and v on Sigma (the state's phase) with dimensions (name, lane, period) and status with (name,
    lane); without lanes there is no dimension `lane`, with several axes of them they are lane_0, lane_1, ... Where
    values have lanes of their own, the first dimension is called "step" and the values are its coordinate (step, lane).
    The other parameters are attributes, or coordinates where they have lanes.

    A wall that moves over the mass, from one value to the next, carries it along (`wall_positions.fit`). A lane whose
    status is CAP or worse (`Impacts`) has nan for that value, and starts the next one anew from the given state.

    max_seconds: wall-clock time, s, after which no chunk of values is begun, or with a store no chunk of lanes; None is
    no limit. Values that are not done have nan and the status -1, and the attribute `stopped` says why; a later call
    with the same store goes on.

    Raises ArgumentError for an unknown name, values that are not finite or break a rule of the scene, a start beyond a
    wall, and counts that cannot be, all before any work; and what the store raises.
    """
    limits = limits_of(None, max_seconds, None, check.ArgumentError)
    settle, keep = check.whole("settle", settle, 0), check.whole("keep", keep, 1)
    chunk = check.whole("chunk", chunk, 1)
    values, state = _checked(scene, name, values, state)
    shape = np.broadcast_shapes(values.shape[1:], scene.shape, *map(np.shape, jax.tree.leaves(state)))
    lanes = _lanes(shape, scene, values, state)
    if store is None:
        found = _run(*lanes, name, settle, keep, chunk, progress, limits)
        count = int((found[2] >= 0).all(axis=1).sum())
        stopped = {} if count == len(values) else {"stopped": partial_reason(count, len(values), "values")}
    else:
        first = jax.tree.map(lambda leaf: leaf[0], lanes[0])
        study = SweepStudy(first, name, lanes, _whole, (settle, keep))
        seen = done(study, store, progress and (lambda one: progress(one.done)), limits)
        stopped = {key: seen.attrs[key] for key in ("stopped",) if key in seen.attrs}
        found = [np.moveaxis(seen[key].values, 0, 1) for key in ("x", "v", "status")]
    parts = [part.reshape(len(values), *shape, *part.shape[2:]) for part in found]
    return _dataset(scene, name, values, state, parts).assign_attrs(stopped)


def _checked(scene, name, values, state) -> tuple[Float[np.ndarray, " count *lanes"], State]:
    """(values, state), arrays of the scene's type, once they break no rule."""
    check.require_known(name, scene.names, name)
    values = check.number(name, values, scene.dtype)
    if values.ndim == 0 or values.shape[0] == 0:
        raise check.ArgumentError(name, "must be a sequence of values to sweep through, at least one", values)
    require_scene_units("values", scene, name, values)
    spare = max(0, len(scene.shape) - (values.ndim - 1))
    aligned = values.reshape(values.shape[0], *[1] * spare, *values.shape[1:])
    scene.replace(**{name: aligned})
    state = started(state, scene.dtype, [("scene", np.empty(scene.shape)), (name, values[0])])
    check_start(scene.replace(**{name: aligned[0]}), state, "at the first value")
    return values, state


def started(state, dtype, beside):
    """The state, its numbers finite arrays of this type that broadcast with the named arrays beside it."""
    keys = ("x", "v", "phase", "contact")
    parts = [check.number(f"state.{key}", getattr(state, key), dtype) for key in keys]
    check.shapes_agree([*beside, *zip((f"state.{key}" for key in keys), parts, strict=True)])
    return State(*parts)


def _lanes(shape, scene, values, state) -> tuple[Scene, Float[np.ndarray, "count lanes"], State]:
    """Scene, values (count, lanes) and state with their lanes along one axis."""
    size = math.prod(shape)

    def flat(leaf):
        return np.broadcast_to(leaf, shape).reshape(size)

    return jax.tree.map(flat, scene), np.stack([flat(value) for value in values]), jax.tree.map(flat, state)


def _whole(scene, values, start, name, settle, keep):
    return _run(scene, values, start, name, settle, keep, CHUNK, None)


def _run(scene, values, start, name, settle, keep, chunk, progress, limits=UNLIMITED):
    """x, v of shape (count, lanes, keep) and status (count, lanes), which is -1 where the time was over."""
    state, found = start, []
    for first in range(0, len(values), chunk):
        if found and limits.expired:
            left, lanes = len(values) - first, values.shape[1]
            blank = np.full((left, keep, lanes), np.nan, values.dtype)
            found.append([blank, blank, np.full((left, lanes), -1, np.int32)])
            break
        some = values[first : first + chunk]
        padded = np.pad(some, ((0, chunk - len(some)), (0, 0)), mode="edge")
        state, parts = _chunk(scene, padded, len(some), start, state, settle, name=name, keep=keep)
        found.append([np.asarray(part)[: len(some)] for part in parts])
        if progress is not None:
            progress(first + len(some))
    x, v, status = (np.concatenate(parts) for parts in zip(*found, strict=True))
    return np.moveaxis(x, 1, 2), np.moveaxis(v, 1, 2), status


@persistent_jit(static_argnames=("name", "keep"), compiler_options=OPTIONS)
def _chunk(scene, values, count, start, state, settle, *, name, keep):
    """The state after the first `count` of the values, and x, v (values, keep, lanes), status (values, lanes)."""
    size = values.shape
    record = jnp.zeros((size[0], keep, size[1]), values.dtype)
    status = jnp.zeros(size, jnp.int32)

    def one(k, carry):
        state, *record = carry
        here = scene.replace(**{name: values[k]})
        state, x, v, status = _value(here, fit(here, state), settle, keep)
        bad = status >= Status.CAP
        state = jax.tree.map(lambda old, new: jnp.where(bad, old, new), start, state)
        return state, *(old.at[k].set(new) for old, new in zip(record, (x, v, status), strict=True))

    state, *record = lax.fori_loop(0, count, one, (state, record, record, status))
    return state, record


def _value(scene, state, settle, keep):
    """The state after settle + keep periods, x and v (keep, lanes) at the end of the last `keep`, the worst status."""

    def one(k, carry):
        state, x, v, status = carry
        state, impacts = strobe(scene, state, slots=0)
        place = jnp.maximum(k - settle, 0)
        worst = jnp.where(
            status >= Status.CAP, status, jnp.where(impacts.status >= Status.CAP, impacts.status, Status.OK)
        )
        return state, x.at[place].set(state.x), v.at[place].set(state.v), worst

    record = jnp.zeros((keep, *state.x.shape), state.x.dtype)
    state, x, v, status = lax.fori_loop(
        0, settle + keep, one, (state, record, record, jnp.zeros(state.x.shape, jnp.int32))
    )
    bad = status >= Status.CAP
    return state, jnp.where(bad, jnp.nan, x), jnp.where(bad, jnp.nan, v), status


def _dataset(scene, name, values, state, parts):
    """The named result of x, v (count, lanes..., keep) and status (count, lanes...)."""
    x, v, status = parts
    lanes = ["lane"] if status.ndim == 2 else [f"lane_{axis}" for axis in range(status.ndim - 1)]
    step = name if values.ndim == 1 else "step"
    whole = values if values.ndim == 1 else np.stack([np.broadcast_to(value, status.shape[1:]) for value in values])
    coords = {
        name: ([step, *lanes][: whole.ndim], whole, {"long_name": name, "units": unit_of(name)}),
        "period": ("period", np.arange(x.shape[-1]), {"long_name": "drive periods after those left out"}),
    }
    attrs = {"equation": equation(scene), "units": UNITS, "swept": name, **static(scene), **scales_in(scene)}
    for key, value in (others(scene, name) | {"phase": state.phase}).items():
        if np.ndim(value):
            coords[key] = (lanes, np.broadcast_to(value, status.shape[1:]))
        else:
            attrs[key] = float(value)
    variables = {
        "x": ([step, *lanes, "period"], x, {"long_name": "position on Sigma", "units": LENGTH}),
        "v": ([step, *lanes, "period"], v, {"long_name": "velocity on Sigma", "units": SPEED}),
        "status": ([step, *lanes], status, {"long_name": "worst status at this value", **MEANING}),
    }
    return xr.Dataset(variables, coords, attrs)


def others(scene, name):
    """The parameters that are not swept, without those that a wall takes from the scene, or that follow from others."""
    follows = [f"{side}.{name}" for side, wall in scene.walls.items() for name in wall.taken]
    follows += [f"{side}.{own}" for side in scene.soft_sides for own in ("stiffness", "damping") if name == "hardness"]
    follows.append("hardness")
    return {key: scene.parameter(key) for key in scene.names if key != name and key not in follows}


def equation(scene):
    """The equation of motion and the law of impact, as files hold them."""
    terms = [
        f" + drive.{k}.amplitude cos({term.harmonic} frequency t + drive.{k}.phase)"
        for k, term in enumerate(scene.drive)
    ]
    plain = f"x'' = {named(scene.force.function)}(t, x, v) + {DRIVE}" if scene.force is not None else SPRING
    return f"{plain}{''.join(terms)}, {REBOUND}"


def static(scene):
    """What of the scene is no parameter: its walls, and the harmonics of those that move and of the drive."""
    moving = {side: wall.motion.harmonic for side, wall in scene.walls.items() if wall.motion is not None}
    found = {f"{side}.motion.harmonic": m for side, m in moving.items()}
    found |= {f"drive.{k}.harmonic": term.harmonic for k, term in enumerate(scene.drive)}
    return {"walls": " ".join(scene.walls) or "none"} | found
