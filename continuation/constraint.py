"""Define the equations of solutions along which functions are held at constant values.

Each held function h adds an equation h(u, p) - value = 0 to F(u, p) = 0, and a continuation parameter to the unknowns z
= (u, parameters). The branch may be regular and not turn where dF/du is singular. An additional test function therefore
detects folds. A turning point of the last parameter is in general not a fold.
"""

from collections.abc import Callable, Mapping
from functools import lru_cache
from typing import Any

import jax.numpy as jnp
import numpy as np
from jaxtyping import ArrayLike

from .errors import ContinuationError
from .problem import (
    Problem,
    System,
    extend_function,
    make_dense_problem,
    make_problem,
    make_test_function,
    split_unknowns,
)

FOLD = "fold"  # label of points with singular dF/du; SN denotes turning points of the last parameter
ConstraintFunction = Callable[[Any, Any, Any], ArrayLike]  # function of (u, p, args)


@lru_cache
def make_constrained_problem(
    system: System, constraint_functions: tuple[ConstraintFunction, ...], param_names: tuple[str, ...]
) -> Problem:
    """Make the `Problem` with n held functions, whose values are part of the constants, in n + 1 parameters."""

    def constraint_residual(z, constants):
        u, p = split_unknowns(param_names, z, constants)
        values = [jnp.asarray(constraint(u, p, constants.args)) for constraint in constraint_functions]
        return jnp.stack(values) - jnp.stack(constants.values)

    base_problem = make_problem(system, param_names)
    test_functions = make_test_function(system, FOLD, "SN", param_names), *base_problem.test_functions
    function = extend_function(system, param_names, constraint_residual)
    return make_dense_problem(system, function, test_functions, base_problem.compile_at_once)


def resolve_constraints(
    hold: Mapping[Any, float] | None, monitors: Mapping[str, ConstraintFunction] | None, param_names: tuple[str, ...]
) -> dict[ConstraintFunction, float]:
    """Return {function: value} of the held functions; a key of `hold` may be the name of a monitor.

    Raises ContinuationError if `hold` is invalid, or if the number of different parameters is not one more than the
    number of held functions.
    """
    value_by_function = {}
    for function_or_name, value in (hold or {}).items():
        function = (monitors or {}).get(function_or_name) if isinstance(function_or_name, str) else function_or_name
        if not callable(function):
            raise ContinuationError(
                "hold",
                f"must have functions or names of monitors ({', '.join(monitors or {})}) as keys",
                function_or_name,
            )
        if not (isinstance(value, int | float) and np.isfinite(value)):
            raise ContinuationError("hold", "must map functions to finite numbers", value)
        value_by_function[function] = float(value)
    if len(param_names) != len(value_by_function) + 1 or len(set(param_names)) != len(param_names):
        raise ContinuationError(
            "along",
            f"must name {len(value_by_function) + 1} different parameter(s), one more than functions in `hold`",
            param_names,
        )
    return value_by_function
