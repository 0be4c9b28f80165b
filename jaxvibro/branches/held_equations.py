"""Equations of orbits along two parameters with one quantity held fixed, as `continuation` takes them.

The unknowns are z = (times, speeds or x and v, first parameter, second parameter). The gradient of the quantity is a
central difference. It only affects the direction of the steps: the quantity itself is exact.
"""

from functools import partial
from typing import NamedTuple

import jax.numpy as jnp
import numpy as np
from jax import lax
from jaxtyping import Float

from continuation.arclength import solve_bordered
from continuation.array_type import Array
from continuation.problem import Problem

from ..compiled.kernels import call_as_kernel
from ..flight.coefficients import flow_coefficients
from ..orbits.impact_equations import ImpactSequence
from ..problem.diagnostics import free_flight
from ..problem.equations import (
    FREE_PROBLEM,
    IMPACT_PROBLEM,
    STICKING_PROBLEM,
    OrbitEquations,
    continuation_problem,
    scene_at,
    sequence_at,
)
from ..scene.scene import Scene
from .largest_position import peak_of_flight, peak_of_sequence

DIFFERENCE_STEP = 1e-5  # relative to 1 + abs(z)


class HeldOrbitEquations(NamedTuple):
    """Equations of orbits with one quantity held fixed.

    Attributes
    ----------
    scene, parameter_marks, sequence
        As in `OrbitEquations`.
    quantity_mask : Array
        Array of shape (2,), 1 at the held quantity among `HELD_QUANTITIES`.
    value : Array
        Value of the held quantity.
    """

    scene: Scene
    parameter_marks: Scene
    sequence: ImpactSequence
    quantity_mask: Float[Array, "2"]
    value: Float[Array, ""]

    impact_rows = OrbitEquations.impact_rows  # type: ignore[misc]  # shared property
    slack = OrbitEquations.slack  # type: ignore[misc]  # shared property


def _peak(z, problem):
    if len(problem.sequence.sides):
        return peak_of_sequence(flow_coefficients(scene_at(problem, z)), sequence_at(problem, z))
    return peak_of_flight(*free_flight(problem, z))


def _least_speed(z, problem):
    n_rows = len(problem.sequence.sides)
    return jnp.min(jnp.where(problem.sequence.sides != 0, z[n_rows : 2 * n_rows], jnp.inf), initial=jnp.inf)


HELD_QUANTITIES = {"peak": _peak, "least_speed": _least_speed}


def held_quantity(z, problem):
    """Return the held quantity at z."""
    return sum(
        problem.quantity_mask[k] * jnp.where(problem.quantity_mask[k] > 0, quantity(z, problem), 0.0)
        for k, quantity in enumerate(HELD_QUANTITIES.values())
    )


def _held_system(dense_function, z, problem):
    """Return F and dF/dz; the last residual is the quantity minus its value."""
    residual, jacobian = dense_function(z, problem)
    spacing = DIFFERENCE_STEP * (1.0 + abs(z))
    directions = np.concatenate([np.zeros((1, len(z))), np.eye(len(z)), -np.eye(len(z))])
    values = lax.map(
        lambda direction: held_quantity(z + direction * spacing, problem), jnp.asarray(directions, z.dtype)
    )
    gradient = (values[1 : len(z) + 1] - values[len(z) + 1 :]) / (2.0 * spacing)
    return jnp.append(residual, values[0] - problem.value), jnp.concatenate([jacobian, gradient[None]])


def _make_problem(orbit_problem):
    held_system = partial(_held_system, orbit_problem.dense_function)
    return Problem(
        held_system, solve_bordered, held_system, (), call_as_kernel, orbit_problem.is_valid, compile_at_once=True
    )


PROBLEMS = tuple(_make_problem(orbit_problem) for orbit_problem in (IMPACT_PROBLEM, STICKING_PROBLEM, FREE_PROBLEM))


@continuation_problem.register
def _(problem: HeldOrbitEquations):
    has_sticking = problem.sequence.releases is not None
    return PROBLEMS[(1 if has_sticking else 0) if len(problem.sequence.sides) else 2]
