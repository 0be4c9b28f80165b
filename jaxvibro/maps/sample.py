"""Compute the states of a motion at given times."""

from functools import partial

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import ArrayLike, Float, Int

from continuation.array_type import Array
from continuation.hostcall import persistent_jit

from ..compiled.lane_arithmetic import COMPILER_OPTIONS
from ..scene import check
from ..scene.scene import Scene
from ..scene.state import State, make_state_arrays
from .sample_derivatives import SampleDerivativeRequest, differentiable_sample, sample_in_lane_blocks

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
        Initial state at its phase. The fields broadcast with the fields of `scene`.
    times : array_like
        Times since the initial state, in t, of shape (n,) or (..., n). The times must not be negative and must not
        decrease along the last axis. The leading axes broadcast with `scene` and `state`.

    Returns
    -------
    states : State
        States of shape (..., n). The phase continues from the phase of `state`. The contact is defined as for `strobe`.
    status : Array of int
        Status of each lane, of shape (...), with the codes of `Impacts`: OK; CAP for 1,000 impacts or a million steps
        within a period, or for times beyond a million periods; INVALID for an invalid scene, a start beyond a wall or
        times that are not in order; NONFINITE. If the status is CAP or worse, unknown states are nan.

    Raises
    ------
    ArgumentError
        If concrete times are not finite, negative or not in order, if `state` or `times` does not broadcast, or if an
        argument is not a number.

    See Also
    --------
    simulate : Trajectory of one state at evenly spaced times, with the impacts.
    strobe : State after whole periods.

    Notes
    -----
    A sample at the time of an impact, up to rounding, is the state after the impact. The derivatives are one-sided:
    they are the limit of the derivatives at later times. At an entry into a soft wall or an exit from the wall, the
    contact shows whether the state and the derivatives belong to the motion before or after the event.

    Derivatives are with respect to x, v and the phase of the state, every number of the scene, and the times. A
    derivative is nan where the state is nan. If more than 32 impacts occur between two times and within a period,
    later derivatives are nan until the mass sticks. If the mass sticks, later states do not depend on the initial state
    or on the impacts before the mass sticks.

    Examples
    --------
    >>> states, status = jv.sample(scene, state, np.linspace(0.0, 2.0, 5))
    >>> np.asarray(states.x).round(4), int(status)
    (array([ 0.9   ,  0.4963,  0.2084, -0.3364, -0.8562]), 0)
    """
    state = make_state_arrays(scene, state)
    time_array = _validate_times(scene, state, times)
    n_times = time_array.shape[-1]
    is_traced = check.is_traced(*jax.tree.leaves((scene, state, time_array)))
    n_padded_times = (
        n_times if is_traced and n_times else max(MIN_COMPILED_TIMES, 1 << (n_times - 1).bit_length() if n_times else 0)
    )
    padded_times = (jnp if is_traced else np).concatenate(
        [time_array, _repeat_last_time(time_array, n_padded_times - n_times)], -1
    )
    leaves, treedef = jax.tree.flatten((scene, state))
    (contact, status), ((x, v), *_) = (
        differentiable_sample(SampleDerivativeRequest(treedef)) if is_traced else partial(_sample_concrete, treedef)
    )(*leaves, padded_times)
    x, v, contact = (array[..., :n_times] for array in (x, v, contact))
    phase = jnp.asarray(state.phase)[..., None] + jnp.asarray(scene.frequency)[..., None] * time_array
    phase = jnp.broadcast_to(phase, x.shape)
    return State(x, v, phase, contact), status.astype(jnp.int32)


@persistent_jit(static_argnums=0, compiler_options=COMPILER_OPTIONS)
def _compiled_sample(treedef, leaves, times):
    return sample_in_lane_blocks(SampleDerivativeRequest(treedef), *leaves, times)


def _sample_concrete(treedef, *arguments):
    return _compiled_sample(treedef, arguments[:-1], arguments[-1])


def _repeat_last_time(times, n_repeats):
    """Return the last time repeated `n_repeats` times, or zeros if there are no times."""
    if times.shape[-1]:
        return times[..., [-1] * n_repeats]
    return np.zeros((*times.shape[:-1], n_repeats), times.dtype)


def _validate_times(scene, state, times):
    """Validate the times and return an array of the floating-point type of the scene."""
    times = check.check_real_array("times", times, scene.dtype)
    if not times.ndim:
        raise check.ArgumentError("times", "must have at least one axis", times)
    shape = np.broadcast_shapes(scene.shape, *map(np.shape, jax.tree.leaves(state)))
    try:
        np.broadcast_shapes(shape, times.shape[:-1])
    except ValueError:
        rule_text = (
            f"must have a shape (..., n) whose leading axes broadcast with {shape}, the shape of scene and state"
        )
        raise check.ArgumentError("times", rule_text, times) from None
    if not check.is_traced(times):
        check.require("times", "must be finite", times, np.isfinite(times))
        check.require("times", "must not be negative", times, times >= 0)
        are_times_in_order = np.diff(times, axis=-1, prepend=0.0) >= 0
        check.require("times", "must be in order, each not less than the one before", times, are_times_in_order)
    return times
