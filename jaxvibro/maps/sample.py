"""Compute the states of a motion at given times."""

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

MIN_COMPILED_TIMES = 8  # smallest number of times to compile for; concrete times are padded to a power of two


@check.check_types
def sample(scene: Scene, state: State, times: Float[ArrayLike, "..."]) -> tuple[State, Int[Array, "..."]]:
    """Compute the states of a motion at given times.

    The map has derivatives of any order in forward and reverse mode.

    Parameters
    ----------
    scene : Scene
        Oscillator, drive and walls. A single scene or a batch.
    state : State
        Initial state at its phase; its numbers broadcast with those of `scene`.
    times : array_like
        Times since the phase of `state`, in t, of shape (n,) or (..., n). They are not negative and increase along the
        last axis; equal times are allowed. The leading axes broadcast with `scene` and `state`.

    Returns
    -------
    states : State
        Arrays of shape (..., n). The phase continues from that of `state`, and the contact is as for `strobe`.
    status : Array of int
        Status of each lane, of shape (...), with the codes of `Impacts`: OK; CAP for 1,000 impacts or a million steps
        within a period, or for times beyond a million periods; INVALID for an invalid scene, a start beyond a wall or
        times that are not in order; NONFINITE. From CAP on the states are nan where they are unknown.

    Raises
    ------
    ArgumentError
        If concrete times are not finite, negative or not in order, if `state` or `times` does not broadcast, or if an
        argument is not a number.

    See Also
    --------
    simulate : Trajectory of one state at even samples, with its impacts.
    strobe : State after whole periods.

    Notes
    -----
    A sample at the time of an impact, up to rounding, is the state after the impact. Its derivatives are one-sided:
    they are the limit of the derivatives at later times. At the entry into a soft wall or the exit from it, the contact
    shows on which side of the event the state and its derivatives are.

    Derivatives are with respect to x, v and the phase of the state, every number of the scene, and the times. A
    derivative is nan where there is no state. It is also nan if more than 32 impacts lie between two times and within a
    period, from there until the mass sticks next. If the mass sticks, later states do not depend on its initial state
    or on the impacts before it sticks.

    Examples
    --------
    >>> states, status = jv.sample(scene, state, np.linspace(0.0, 2.0, 5))
    >>> np.asarray(states.x).round(4), int(status)
    (array([ 0.9   ,  0.4963,  0.2084, -0.3364, -0.8562]), 0)
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
    """Repeat the last time `n_repeats` times; use 0 if there is none."""
    if times.shape[-1]:
        return times[..., [-1] * n_repeats]
    return np.zeros((*times.shape[:-1], n_repeats), times.dtype)


def _validate_times(scene, state, times):
    """Return the times as an array of the scene's type."""
    times = check.real_array("times", times, scene.dtype)
    if not times.ndim:
        raise check.ArgumentError("times", "must have at least one axis", times)
    shape = np.broadcast_shapes(scene.shape, *map(np.shape, jax.tree.leaves(state)))
    try:
        np.broadcast_shapes(shape, times.shape[:-1])
    except ValueError:
        rule = f"must have a shape (..., n) whose leading axes broadcast with {shape}, the shape of scene and state"
        raise check.ArgumentError("times", rule, times) from None
    if not check.is_traced(times):
        check.require("times", "must be finite", times, np.isfinite(times))
        check.require("times", "must not be negative", times, times >= 0)
        is_in_order = np.diff(times, axis=-1, prepend=0.0) >= 0
        check.require("times", "must be in order, each not less than the one before", times, is_in_order)
    return times
