"""The states of a motion at times that are given: `sample`."""

from functools import partial

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import ArrayLike, Float, Int

from continuation.arrays import Array
from continuation.persistent_jit import persistent_jit

from ..compiled.compiler_hints import OPTIONS
from ..scene import check
from ..scene.scene import Scene
from ..scene.state import State, real_state
from .sample_slopes import Request, in_lanes, sampled

FEWEST = 8  # times that are compiled for; known ones are filled up to a power of two


@check.typed
def sample(scene: Scene, state: State, times: Float[ArrayLike, "..."]) -> tuple[State, Int[Array, "..."]]:
    """The states at given times, and a status of each lane: (State, status).

    scene: a `Scene`; state: a `State` at its phase. times: in t, since the state's phase, from 0 on and in order, along
    the last axis, (n,) or (..., n); the rest of their shape broadcasts with that of scene and state. State: arrays of
    shape (..., n), the phase counted on from the start's, the contact as of `strobe`. status: shape (...), a code as of
    `Impacts.status`: OK; CAP: 1,000 impacts or a million steps within a period, or times beyond a million periods;
    INVALID: a bad scene, a start beyond a wall, or times that are not in order; NONFINITE. From CAP on the states are
    nan where they are not known.

    At the time of an impact, to rounding, it is the state after it, and its derivatives are one-sided: those of the
    motion just after that impact, the limit of the derivatives at later times. Where a soft wall is entered or left at
    a time, the contact says on which side of that event the state and its derivatives are.

    jax.grad, jacfwd, jacrev, hessian and the rest go through it, at any order: x and v by those of the state, its
    phase, every number of the scene and the times. A derivative is nan where there is no state, and
    from the time on that more than 32 impacts lie between two times and within a period, up to the next rest. A mass at
    rest forgets its start, and the impacts before it.

    Raises ArgumentError for times, where they are known, that are not finite, negative or not in order, for a state or
    times that do not broadcast, and for what is no number.
    """
    state = real_state(scene, state)
    given = _checked(scene, state, times)
    count = given.shape[-1]
    traced = check.is_traced(*jax.tree.leaves((scene, state, given)))
    full = count if traced and count else max(FEWEST, 1 << (count - 1).bit_length() if count else 0)
    filled = (jnp if traced else np).concatenate([given, _last(given, full - count)], -1)
    leaves, tree = jax.tree.flatten((scene, state))
    (contact, status), ((x, v), *_) = (sampled(Request(tree)) if traced else partial(_known, tree))(*leaves, filled)
    x, v, contact = (each[..., :count] for each in (x, v, contact))
    phase = jnp.asarray(state.phase)[..., None] + jnp.asarray(scene.frequency)[..., None] * given
    phase = jnp.broadcast_to(phase, x.shape)
    return State(x, v, phase, contact), status.astype(jnp.int32)


@persistent_jit(static_argnums=0, compiler_options=OPTIONS)
def _flown(tree, leaves, times):
    return in_lanes(Request(tree), *leaves, times)


def _known(tree, *given):
    return _flown(tree, given[:-1], given[-1])


def _last(times, more):
    """The last of the times so often, 0 where there is none."""
    if times.shape[-1]:
        return times[..., [-1] * more]
    return np.zeros((*times.shape[:-1], more), times.dtype)


def _checked(scene, state, times):
    """The times as an array of the scene's type."""
    times = check.real("times", times, scene.dtype)
    if not times.ndim:
        raise check.ArgumentError("times", "must have an axis, the last, for one after the other", times)
    shape = np.broadcast_shapes(scene.shape, *map(np.shape, jax.tree.leaves(state)))
    try:
        np.broadcast_shapes(shape, times.shape[:-1])
    except ValueError:
        rule = f"must have a shape (..., n) whose first part broadcasts with {shape}, that of scene and state"
        raise check.ArgumentError("times", rule, times) from None
    if not check.is_traced(times):
        check.require("times", "must be finite", times, np.isfinite(times))
        check.require("times", "must not be negative", times, times >= 0)
        later = np.diff(times, axis=-1, prepend=0.0) >= 0
        check.require("times", "must be in order, none before the one before", times, later)
    return times
