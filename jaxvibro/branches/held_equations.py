"""Equations, for `continuation`, of orbits along two parameters with one quantity held fixed.

The unknowns z are the times and speeds of the impacts, or x and v for an orbit without impacts, then the first and the
second parameter. The gradient of the quantity is a central difference. The gradient only affects the direction of the
steps; the quantity itself is exact.
"""

from dataclasses import dataclass
from functools import partial

import jax
import jax.numpy as jnp
import numpy as np
from jax import lax
from jaxtyping import Float

from continuation.arclength import solve_bordered
from continuation.array_type import Array
from continuation.problem import Problem

from ..compiled.kernel_calls import call_as_kernel
from ..contact.kinds import flow_coefficients
from ..problem.orbit_diagnostics import flight_without_impacts
from ..problem.orbit_equations import FREE_PROBLEM, IMPACT_PROBLEM, STICKING_PROBLEM, scene_at, sequence_at
from ..problem.orbit_problem import Condition, OrbitProblem
from .largest_position import peak_of_flight, peak_of_sequence

DIFFERENCE_STEP = 1e-5  # relative to 1 + abs(z)


@jax.tree_util.register_dataclass
@dataclass(frozen=True, eq=False)
class HeldCondition(Condition):
    """Condition that one quantity has a value.

    Attributes
    ----------
    quantity_mask : Array
        Array of shape (2,), 1 at the held quantity among `HELD_QUANTITIES`.
    value : Array
        Value of the held quantity.
    """

    quantity_mask: Float[Array, "2"]
    value: Float[Array, ""]

    def equations(self, problem: OrbitProblem) -> Problem:
        """Return the equations of the orbits, with the quantity minus its value as the last residual."""
        return HELD_EQUATIONS[super().equations(problem)]


def _largest_position(z, problem):
    if len(problem.sequence.sides):
        return peak_of_sequence(flow_coefficients(scene_at(problem, z)), sequence_at(problem, z))
    return peak_of_flight(*flight_without_impacts(problem, z))


def _least_impact_speed(z, problem):
    n_rows = len(problem.sequence.sides)
    return jnp.min(jnp.where(problem.sequence.sides != 0, z[n_rows : 2 * n_rows], jnp.inf), initial=jnp.inf)


HELD_QUANTITIES = {"peak": _largest_position, "least_speed": _least_impact_speed}


def held_quantity(z, problem):
    """Return the held quantity at z."""
    return sum(
        problem.condition.quantity_mask[k]
        * jnp.where(problem.condition.quantity_mask[k] > 0, quantity_function(z, problem), 0.0)
        for k, quantity_function in enumerate(HELD_QUANTITIES.values())
    )


def _residual_and_jacobian(orbit_residual_function, z, problem):
    """Return F and dF/dz; the last residual is the quantity minus its value."""
    residual, jacobian = orbit_residual_function(z, problem)
    step_sizes = DIFFERENCE_STEP * (1.0 + abs(z))
    z_directions = np.concatenate([np.zeros((1, len(z))), np.eye(len(z)), -np.eye(len(z))])
    quantity_values = lax.map(
        lambda direction: held_quantity(z + direction * step_sizes, problem), jnp.asarray(z_directions, z.dtype)
    )
    quantity_gradient = (quantity_values[1 : len(z) + 1] - quantity_values[len(z) + 1 :]) / (2.0 * step_sizes)
    return jnp.append(residual, quantity_values[0] - problem.condition.value), jnp.concatenate(
        [jacobian, quantity_gradient[None]]
    )


def _hold_quantity(orbit_equations):
    """Append the held quantity to the equations of orbits without a condition."""
    residual_and_jacobian = partial(_residual_and_jacobian, orbit_equations.dense_function)
    return Problem(
        residual_and_jacobian,
        solve_bordered,
        residual_and_jacobian,
        (),
        call_as_kernel,
        orbit_equations.is_valid,
        compile_at_once=True,
    )


HELD_EQUATIONS = {
    equations: _hold_quantity(equations) for equations in (IMPACT_PROBLEM, STICKING_PROBLEM, FREE_PROBLEM)
}
