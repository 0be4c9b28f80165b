"""Whether a system, a start and parameters fit together: one clear error in place of what JAX would say later."""

from collections.abc import Mapping

import jax
import numpy as np

from .branch import MEANINGS
from .errors import ContinuationError, first_line
from .problem import ORBITS, System

DIRECTIONS = ("both", "forward", "backward")


def known_numbers(u, at):
    """(u, (n,); {name: number}). Raises ContinuationError."""
    leaves = jax.tree.leaves((u, at))
    if any(isinstance(leaf, jax.core.Tracer) for leaf in leaves):
        raise ContinuationError("u", "must be known numbers: branches are followed outside jit, grad and vmap", u)
    if not isinstance(at, Mapping):
        raise ContinuationError("at", "must give each parameter's number by its name, {name: number}", at)
    found = {}
    for name, value in at.items():
        if not isinstance(name, str) or np.ndim(value) or np.asarray(value).dtype.kind not in "fiu":
            raise ContinuationError(f"at.{name}", "must be a number; what else a function needs goes into args", value)
        found[name] = float(value)
    try:
        row = np.atleast_1d(np.asarray(u, float))
    except (TypeError, ValueError):
        raise ContinuationError("u", "must be a row of finite numbers", u) from None
    if row.ndim != 1 or not len(row) or not np.isfinite(row).all():
        raise ContinuationError("u", "must be a row of finite numbers", u)
    return row, found


def require_system(system, u, p, args):
    """Raises ContinuationError where a system's function does not give n numbers of n, in JAX."""
    if not isinstance(system, System):
        raise ContinuationError("system", "must be one of `equilibria` or `fixed_points`", system)
    for leaf in jax.tree.leaves(args):
        if not isinstance(leaf, bool | int | float | complex | np.generic | np.ndarray | jax.Array):
            raise ContinuationError("args", "must be numbers and arrays, or a tree of them", leaf)
    count = system.segments * system.times
    if system.kind == ORBITS and (len(u) <= count or (len(u) - 1) % count or u[-1] <= 0):
        raise ContinuationError("u", f"must be {count} points, one after another, and the period", u)
    size = (len(u) - 1) // count if system.kind == ORBITS else len(u)

    def asked(row, numbers):
        return system.function(row, numbers, args)

    try:
        found = jax.eval_shape(asked, jax.ShapeDtypeStruct((size,), float), p)
    except Exception as error:  # whatever a user's function falls over
        rule = f"must be a function of (u, p, args) in jax.numpy that takes u of {size} numbers ({first_line(error)})"
        raise ContinuationError("function", rule, system.function) from error
    if getattr(found, "shape", None) != (size,):
        rule = f"must give an array of as many numbers as it is given, {size}, in one row"
        given = f"shape {found.shape}" if hasattr(found, "shape") else f"a {type(found).__name__}"
        raise ContinuationError("function", rule, given)


def require_settings(direction, monitors, stop):
    """Raises ContinuationError for directions, monitors and kinds of special points that are none."""
    if direction not in DIRECTIONS:
        raise ContinuationError("direction", f"must be one of {', '.join(DIRECTIONS)}", direction)
    known = [*MEANINGS, *(monitors or {})]
    if isinstance(stop, str) or not set(stop) <= set(known):
        raise ContinuationError("stop", f"must be a tuple of kinds of special points ({', '.join(known)})", stop)
