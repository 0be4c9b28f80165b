"""Branches along which functions of the solution keep their values, each for one parameter more: z = (u, parameters).

To F(u, p) = 0 come h(u, p) - value = 0, one for each function. Where dF/du is singular the branch goes on as it does
elsewhere; so that is watched as one more test, and where the last parameter turns back is none.
"""

from collections.abc import Callable, Mapping
from functools import lru_cache, partial
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import ArrayLike

from .arclength import bordered
from .errors import ContinuationError
from .problem import Problem, System, Test, equations_at, problem_of, singular_matrix, split

FOLD = "fold"  # where dF/du is singular, told from the turning points of the last parameter, which are called SN
Function = Callable[[Any, Any, Any], ArrayLike]  # of (u, p, args)


class Held(NamedTuple):
    """A `problem.Given`, and values, what the functions are to be."""

    others: dict[str, float]
    args: Any
    values: tuple[float, ...]


@lru_cache
def held_problem(system: System, functions: tuple[Function, ...], names: tuple[str, ...]) -> Problem:
    """The `Problem` along parameters, one more than functions; args a `Held`."""

    def left(z, held):
        u, p = split(names, z, held)
        return jnp.stack([jnp.asarray(one(u, p, held.args)) for one in functions]) - jnp.stack(held.values)

    def function(z, held):
        value, slopes = equations_at(system, names, z, held)
        more = jax.jacfwd(left)(z, held)
        return jnp.concatenate([value, left(z, held)]), jnp.concatenate([slopes, more])

    plain = problem_of(system, names)
    tests = (Test(FOLD, partial(singular_matrix, system, "SN", names)), *plain.tests)
    return Problem(function, bordered, function, tests, at_once=plain.at_once, noise=plain.noise)


def named(
    hold: Mapping[Any, float] | None, monitors: Mapping[str, Function] | None, names: tuple[str, ...]
) -> dict[Function, float]:
    """{function: value} of what is held, monitors given by their names. Raises ContinuationError."""
    found = {}
    for one, value in (hold or {}).items():
        function = (monitors or {}).get(one) if isinstance(one, str) else one
        if not callable(function):
            raise ContinuationError(
                "hold", f"must be of functions, or names of monitors ({', '.join(monitors or {})})", one
            )
        if not (isinstance(value, int | float) and np.isfinite(value)):
            raise ContinuationError("hold", "must be numbers by functions", value)
        found[function] = float(value)
    if len(names) != len(found) + 1 or len(set(names)) != len(names):
        raise ContinuationError("along", f"must be {len(found) + 1} different parameters, one more than is held", names)
    return found
