"""Continue solutions along which functions keep their values, with one parameter more for each: z = (u, parameters).

Equations h(u, p) - value = 0 augment F(u, p) = 0, one for each function. The branch is regular where dF/du is singular,
so that a further test function detects folds; turning points of the last parameter are not folds.
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

FOLD = "fold"  # label of points with singular dF/du; SN denotes turning points of the last parameter
ConstraintFunction = Callable[[Any, Any, Any], ArrayLike]  # function of (u, p, args)


class HoldConstants(NamedTuple):
    """`Constants` of a system and the values at which functions are held."""

    fixed_params: dict[str, float]
    args: Any
    values: tuple[float, ...]


@lru_cache
def make_problem(system: System, constraints: tuple[ConstraintFunction, ...], names: tuple[str, ...]) -> Problem:
    """Make the `Problem` with held functions, in one parameter more than functions; its args are `HoldConstants`."""

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
    """Return {function: value} for the held functions; monitors may be given by name. Raises ContinuationError."""
    constraints = {}
    for key, value in (hold or {}).items():
        function = (monitors or {}).get(key) if isinstance(key, str) else key
        if not callable(function):
            raise ContinuationError(
                "hold", f"must have functions or names of monitors ({', '.join(monitors or {})}) as keys", key
            )
        if not (isinstance(value, int | float) and np.isfinite(value)):
            raise ContinuationError("hold", "must map functions to finite numbers", value)
        constraints[function] = float(value)
    if len(names) != len(constraints) + 1 or len(set(names)) != len(names):
        raise ContinuationError(
            "along",
            f"must name {len(constraints) + 1} different parameter(s), one more than functions in `hold`",
            names,
        )
    return constraints
