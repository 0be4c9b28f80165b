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

from .arclength import solve_bordered
from .errors import ContinuationError
from .problem import Problem, System, TestFunction, problem_of, residual_and_jacobian, singular_matrix, split_unknowns

FOLD = "fold"  # where dF/du is singular, told from the turning points of the last parameter, which are called SN
ConstraintFunction = Callable[[Any, Any, Any], ArrayLike]  # of (u, p, args)


class HoldConstants(NamedTuple):
    """A `problem.Given`, and values, what the functions are to be."""

    fixed_params: dict[str, float]
    args: Any
    values: tuple[float, ...]


@lru_cache
def make_problem(system: System, constraints: tuple[ConstraintFunction, ...], names: tuple[str, ...]) -> Problem:
    """The `Problem` along parameters, one more than functions; args a `HoldConstants`."""

    def constraint_residual(z, constants):
        u, p = split_unknowns(names, z, constants)
        return jnp.stack([jnp.asarray(constraint(u, p, constants.args)) for constraint in constraints]) - jnp.stack(
            constants.values
        )

    def function(z, constants):
        residual, jacobian = residual_and_jacobian(system, names, z, constants)
        constraint_jacobian = jax.jacfwd(constraint_residual)(z, constants)
        return jnp.concatenate([residual, constraint_residual(z, constants)]), jnp.concatenate(
            [jacobian, constraint_jacobian]
        )

    base_problem = problem_of(system, names)
    test_functions = (TestFunction(FOLD, partial(singular_matrix, system, "SN", names)), *base_problem.test_functions)
    return Problem(
        function,
        solve_bordered,
        function,
        test_functions,
        compile_at_once=base_problem.compile_at_once,
        noise_floor=base_problem.noise_floor,
    )


def resolve_constraints(
    hold: Mapping[Any, float] | None, monitors: Mapping[str, ConstraintFunction] | None, names: tuple[str, ...]
) -> dict[ConstraintFunction, float]:
    """{function: value} of what is held, monitors given by their names. Raises ContinuationError."""
    constraints = {}
    for key, value in (hold or {}).items():
        function = (monitors or {}).get(key) if isinstance(key, str) else key
        if not callable(function):
            raise ContinuationError(
                "hold", f"must be of functions, or names of monitors ({', '.join(monitors or {})})", key
            )
        if not (isinstance(value, int | float) and np.isfinite(value)):
            raise ContinuationError("hold", "must be numbers by functions", value)
        constraints[function] = float(value)
    if len(names) != len(constraints) + 1 or len(set(names)) != len(names):
        raise ContinuationError(
            "along", f"must be {len(constraints) + 1} different parameters, one more than is held", names
        )
    return constraints
