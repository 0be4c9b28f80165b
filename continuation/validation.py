"""Whether a system, a start and parameters fit together: one clear error in place of what JAX would say later."""

from collections.abc import Mapping

import jax
import numpy as np

from .branch import KIND_MEANINGS
from .errors import ContinuationError, first_line
from .problem import ORBITS, System

DIRECTIONS = ("both", "forward", "backward")


def validate_start(u, params):
    """(u, (n,); {name: number}). Raises ContinuationError."""
    leaves = jax.tree.leaves((u, params))
    if any(isinstance(leaf, jax.core.Tracer) for leaf in leaves):
        raise ContinuationError("u", "must be known numbers: branches are followed outside jit, grad and vmap", u)
    if not isinstance(params, Mapping):
        raise ContinuationError("at", "must give each parameter's number by its name, {name: number}", params)
    param_values = {}
    for name, value in params.items():
        if not isinstance(name, str) or np.ndim(value) or np.asarray(value).dtype.kind not in "fiu":
            raise ContinuationError(f"at.{name}", "must be a number; what else a function needs goes into args", value)
        param_values[name] = float(value)
    try:
        u_array = np.atleast_1d(np.asarray(u, float))
    except (TypeError, ValueError):
        raise ContinuationError("u", "must be a row of finite numbers", u) from None
    if u_array.ndim != 1 or not len(u_array) or not np.isfinite(u_array).all():
        raise ContinuationError("u", "must be a row of finite numbers", u)
    return u_array, param_values


def require_system(system, u, p, args):
    """Raises ContinuationError where a system's function does not give n numbers of n, in JAX."""
    if not isinstance(system, System):
        raise ContinuationError("system", "must be one of `equilibria` or `fixed_points`", system)
    for leaf in jax.tree.leaves(args):
        if not isinstance(leaf, bool | int | float | complex | np.generic | np.ndarray | jax.Array):
            raise ContinuationError("args", "must be numbers and arrays, or a tree of them", leaf)
    n_segments = system.segments * system.times
    if system.kind == ORBITS and (len(u) <= n_segments or (len(u) - 1) % n_segments or u[-1] <= 0):
        raise ContinuationError("u", f"must be {n_segments} points, one after another, and the period", u)
    state_size = (len(u) - 1) // n_segments if system.kind == ORBITS else len(u)

    def evaluate_field(u_state, params):
        return system.function(u_state, params, args)

    try:
        result = jax.eval_shape(evaluate_field, jax.ShapeDtypeStruct((state_size,), float), p)
    except Exception as error:  # whatever a user's function falls over
        rule = (
            f"must be a function of (u, p, args) in jax.numpy that takes u of {state_size} numbers"
            f" ({first_line(error)})"
        )
        raise ContinuationError("function", rule, system.function) from error
    if getattr(result, "shape", None) != (state_size,):
        rule = f"must give an array of as many numbers as it is given, {state_size}, in one row"
        result_text = f"shape {result.shape}" if hasattr(result, "shape") else f"a {type(result).__name__}"
        raise ContinuationError("function", rule, result_text)


def require_settings(direction, monitors, stop):
    """Raises ContinuationError for directions, monitors and kinds of special points that are none."""
    if direction not in DIRECTIONS:
        raise ContinuationError("direction", f"must be one of {', '.join(DIRECTIONS)}", direction)
    known_kinds = [*KIND_MEANINGS, *(monitors or {})]
    if isinstance(stop, str) or not set(stop) <= set(known_kinds):
        raise ContinuationError("stop", f"must be a tuple of kinds of special points ({', '.join(known_kinds)})", stop)
