"""The states of a motion at times that are given: `sample`."""

from functools import partial

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import ArrayLike, Float, Int

from continuation.array_type import Array
from continuation.persistent_jit import persistent_jit

from ..compiled.compiler_hints import COMPILER_OPTIONS
from ..scene import check
from ..scene.scene import Scene
from ..scene.state import State, state_arrays
from .sample_derivatives import SampleRequest, differentiable_sample, sample_in_blocks

MIN_COMPILED_TIMES = 8  # times that are compiled for; known ones are filled up to a power of two


@check.check_types
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
    state = state_arrays(scene, state)
    time_array = _validate_times(scene, state, times)
    n_times = time_array.shape[-1]
    is_traced = check.is_traced(*jax.tree.leaves((scene, state, time_array)))
    n_padded = (
        n_times if is_traced and n_times else max(MIN_COMPILED_TIMES, 1 << (n_times - 1).bit_length() if n_times else 0)
    )
    padded_times = (jnp if is_traced else np).concatenate(
        [time_array, _repeat_last(time_array, n_padded - n_times)], -1
    )
    leaves, tree = jax.tree.flatten((scene, state))
    (contact, status), ((x, v), *_) = (
        differentiable_sample(SampleRequest(tree)) if is_traced else partial(_sample_concrete, tree)
    )(*leaves, padded_times)
    x, v, contact = (array[..., :n_times] for array in (x, v, contact))
    phase = jnp.asarray(state.phase)[..., None] + jnp.asarray(scene.frequency)[..., None] * time_array
    phase = jnp.broadcast_to(phase, x.shape)
    return State(x, v, phase, contact), status.astype(jnp.int32)


@persistent_jit(static_argnums=0, compiler_options=COMPILER_OPTIONS)
def _sample_compiled(tree, leaves, times):
    return sample_in_blocks(SampleRequest(tree), *leaves, times)


def _sample_concrete(tree, *arguments):
    return _sample_compiled(tree, arguments[:-1], arguments[-1])


def _repeat_last(times, n_repeats):
    """The last of the times so often, 0 where there is none."""
    if times.shape[-1]:
        return times[..., [-1] * n_repeats]
    return np.zeros((*times.shape[:-1], n_repeats), times.dtype)


def _validate_times(scene, state, times):
    """The times as an array of the scene's type."""
    times = check.real_array("times", times, scene.dtype)
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
        is_in_order = np.diff(times, axis=-1, prepend=0.0) >= 0
        check.require("times", "must be in order, none before the one before", times, is_in_order)
    return times
