"""Check that a system, a starting point, parameters and settings are valid and consistent."""

from collections.abc import Mapping

import jax
import numpy as np

from .branch import KIND_MEANINGS
from .errors import ContinuationError, error_summary
from .problem import ORBITS, System

DIRECTIONS = ("both", "forward", "backward")
SYMMETRY_TOLERANCE = 1e-9  # largest difference between a symmetric u and its image


def validate_start(u, start_params):
    """Return u as an array of shape (n,) and the parameters as floats. Raises ContinuationError for invalid values."""
    leaves = jax.tree.leaves((u, start_params))
    if any(isinstance(leaf, jax.core.Tracer) for leaf in leaves):
        raise ContinuationError("u", "must be concrete numbers; continue branches outside jit, grad and vmap", u)
    if not isinstance(start_params, Mapping):
        raise ContinuationError("at", "must map the names of the parameters to numbers", start_params)
    param_values = {}
    for name, value in start_params.items():
        if not isinstance(name, str) or np.ndim(value) or np.asarray(value).dtype.kind not in "fiu":
            raise ContinuationError(f"at.{name}", "must be a number; pass other data in args", value)
        param_values[name] = float(value)
    try:
        u_array = np.atleast_1d(np.asarray(u, float))
    except (TypeError, ValueError):
        raise ContinuationError("u", "must be a sequence of finite numbers", u) from None
    if u_array.ndim != 1 or not len(u_array) or not np.isfinite(u_array).all():
        raise ContinuationError("u", "must be a sequence of finite numbers", u)
    return u_array, param_values


def require_system(system, u, p, args):
    """Raise ContinuationError unless a system, u and args are valid.

    The function must map a state, which is a JAX array, to an array of the same shape. The leaves of `args` must be
    numbers or arrays. For periodic orbits, u must contain the points of the orbit and a positive period.
    """
    if not isinstance(system, System):
        raise ContinuationError(
            "system", "must be a system made by `equilibria`, `fixed_points` or `periodic_orbits`", system
        )
    for leaf in jax.tree.leaves(args):
        if not isinstance(leaf, bool | int | float | complex | np.generic | np.ndarray | jax.Array):
            raise ContinuationError("args", "must be numbers and arrays, or a pytree of them", leaf)
    n_segments = system.segments * system.times
    if system.kind == ORBITS and (len(u) <= n_segments or (len(u) - 1) % n_segments or u[-1] <= 0):
        raise ContinuationError("u", f"must be {n_segments} concatenated points of the orbit and a positive period", u)
    state_size = (len(u) - 1) // n_segments if system.kind == ORBITS else len(u)

    def evaluate_function(state, params):
        return system.function(state, params, args)

    try:
        result = jax.eval_shape(evaluate_function, jax.ShapeDtypeStruct((state_size,), float), p)
    except Exception as error:  # a user's function may raise any exception
        error_rule = (
            f"must be a function of (u, p, args) in jax.numpy that accepts u of shape ({state_size},)"
            f" ({error_summary(error)})"
        )
        raise ContinuationError("function", error_rule, system.function) from error
    if getattr(result, "shape", None) != (state_size,):
        error_rule = f"must return an array of shape ({state_size},)"
        result_text = f"shape {result.shape}" if hasattr(result, "shape") else f"a {type(result).__name__}"
        raise ContinuationError("function", error_rule, result_text)


def require_settings(direction, monitors, stop):
    """Raise ContinuationError for an unknown direction or an unknown kind of special point."""
    if direction not in DIRECTIONS:
        raise ContinuationError("direction", f"must be one of {', '.join(DIRECTIONS)}", direction)
    known_kinds = [*KIND_MEANINGS, *(monitors or {})]
    if isinstance(stop, str) or not set(stop) <= set(known_kinds):
        raise ContinuationError("stop", f"must be a tuple of kinds of special points ({', '.join(known_kinds)})", stop)


def restrict_to_symmetric(system, u, param_values, args):
    """Restrict a system to symmetric solutions if u is symmetric; raise ContinuationError for an invalid symmetry."""
    if not isinstance(system, System) or system.symmetry is None:
        return system
    random_u = u + np.random.default_rng(0).normal(size=len(u))
    twice_mapped_u = np.asarray(system.symmetry(system.symmetry(random_u)))
    function_of_image, image_of_function = (
        system.function(system.symmetry(random_u), param_values, args),
        system.symmetry(system.function(random_u, param_values, args)),
    )
    if not np.allclose(twice_mapped_u, random_u, rtol=0, atol=1e-9) or not np.allclose(
        function_of_image, image_of_function, rtol=1e-9, atol=1e-9
    ):
        raise ContinuationError(
            "symmetry", "must satisfy S(S(u)) = u and function(S(u)) = S(function(u))", system.symmetry
        )
    return system._replace(within=bool(np.allclose(system.symmetry(u), u, rtol=0, atol=SYMMETRY_TOLERANCE)))


def validate_bounds(param_values, param_names, bounds):
    """Return the bounds {name: (low, high)} as floats; raise ContinuationError if they are invalid.

    Bounds must be given for each name, and must be finite with low < high and contain the value at the start.
    """
    if set(bounds) != set(param_names):
        raise ContinuationError(
            "bounds", f"must contain the interval of each parameter: {', '.join(param_names)}", bounds
        )
    interval_by_name = {}
    for name, interval in ((name, bounds[name]) for name in param_names):
        if name not in param_values:
            raise ContinuationError("along", f"must be one of the parameters {', '.join(param_values)}", name)
        interval_ends = np.asarray(interval, float) if np.shape(interval) == (2,) else np.array([np.nan, np.nan])
        if not (np.isfinite(interval_ends).all() and interval_ends[0] < interval_ends[1]):
            raise ContinuationError("bounds", "must be (low, high), two finite numbers with low < high", interval)
        if not interval_ends[0] <= float(param_values[name]) <= interval_ends[1]:
            raise ContinuationError(
                "bounds", f"must contain the value of {name} at the start, {float(param_values[name]):.12g}", interval
            )
        interval_by_name[name] = (float(interval_ends[0]), float(interval_ends[1]))
    return interval_by_name
