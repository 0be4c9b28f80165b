"""Define the equations of an orbit at a limit of its sticking phase (CH or RL) in two parameters.

One equation is added to those of the orbit: a measure of the distance from the limit is zero. At CH, where the chatter
just completes, the measure is the excess of the speed of the bounces before the release over the critical speed for
sticking, which is computed by bisection (a time if the restitution is 0; see `excess_speed`). At RL, a release within a
sticking phase, the measure is the minimum of the contact force. Neither measure has exact derivatives. Their gradients
are central differences with respect to the time and speed of the last impact before sticking, the time of the release,
and the parameters. No other unknown affects the measures.
"""

from dataclasses import dataclass
from functools import partial
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Float

from continuation.arclength import solve_bordered
from continuation.array_type import Array
from continuation.problem import Problem

from ..compiled.kernel_calls import call_as_kernel
from ..contact.kinds import flow_coefficients
from ..orbits import chatter_and_release, cyclic_system, impact_equations
from ..problem.orbit_equations import scene_at, sequence_at
from ..problem.orbit_problem import OrbitProblem
from .locus_equations import RowCondition, evaluate_orbit

DIFFERENCE_STEP = 1e-5  # relative to 1 + |z|: step of central differences


@jax.tree_util.register_dataclass
@dataclass(frozen=True, eq=False)
class StickingLimitCondition(RowCondition):
    """Condition of a locus of CH or RL: the sticking phase of one row is at its limit.

    Attributes
    ----------
    is_release : Array
        1 at RL, where the contact force vanishes; 0 at CH, where the mass only just sticks.
    """

    is_release: Float[Array, ""]

    def equations(self, problem: OrbitProblem) -> Problem:
        """Return the equations of the orbits, with the distance from the limit as the last residual."""
        return RELEASE if bool(self.is_release) else CHATTER

    def sticking_margins(self, diagnostics: Any) -> tuple[Float[np.ndarray, "*points rows"], ...]:
        """Return the margins other than the one that vanishes along the locus."""
        sticking_times, min_contact_forces = (
            np.where(self.row_mask > 0, np.inf, values)
            for values in (diagnostics.sticking_time, diagnostics.min_contact_force)
        )
        return (
            (diagnostics.sticking_time, min_contact_forces)
            if bool(self.is_release)
            else (sticking_times, diagnostics.min_contact_force)
        )


def _evaluate_limit_measure(limit_measure, problem, z):
    """Evaluate the measure that vanishes at the limit of the sticking phase."""
    coeffs, sequence = flow_coefficients(scene_at(problem, z)), sequence_at(problem, z)
    flights = impact_equations.compute_flights(coeffs, sequence)
    chatter_starts_by_row, _ = chatter_and_release.chatter_starts(coeffs, sequence, flights)
    limit_row = jnp.argmax(problem.condition.row_mask)
    return limit_measure(coeffs, jax.tree.map(lambda leaf: leaf[limit_row], chatter_starts_by_row))


def _unit_vectors_of_measure(problem, z):
    """Return the unit vectors of the unknowns that affect the measure. Array of shape (directions, unknowns)."""
    n_rows = len(problem.condition.row_mask)
    last_row = jnp.sum(problem.sequence.sides != 0) - 1
    limit_row = jnp.argmax(problem.condition.row_mask)
    next_row = jnp.where(limit_row == last_row, 0, limit_row + 1)
    unknown_indices = jnp.stack([limit_row, next_row, n_rows + limit_row, *range(2 * n_rows, len(z))])
    return jnp.eye(len(z), dtype=z.dtype)[unknown_indices]


def _sticking_limit_system(limit_measure, z, problem):
    """Return (F, dF/dz) of the orbit equations and the measure.

    For an empty row, F holds its unknowns, which must vanish.
    """
    residual, jacobian = evaluate_orbit(z, problem)
    is_empty_unknown = jnp.tile(problem.sequence.sides == 0, 2)
    orbit_residual = jnp.where(is_empty_unknown, z[: len(is_empty_unknown)], residual)
    measure_directions = _unit_vectors_of_measure(problem, z)
    difference_steps = DIFFERENCE_STEP * (1.0 + abs(measure_directions @ z))
    z_shifts = difference_steps[:, None] * measure_directions
    measures = jax.vmap(partial(_evaluate_limit_measure, limit_measure, problem))(
        jnp.concatenate([z[None], z + z_shifts, z - z_shifts])
    )
    forward_measures, backward_measures = jnp.split(measures[1:], 2)
    measure_gradient = ((forward_measures - backward_measures) / (2.0 * difference_steps)) @ measure_directions
    return jnp.append(orbit_residual, measures[0]), jnp.concatenate(
        [cyclic_system.dense_matrix(jacobian), measure_gradient[None]]
    )


def _make_problem(limit_measure):
    limit_system = partial(_sticking_limit_system, limit_measure)
    return Problem(limit_system, solve_bordered, limit_system, (), call_as_kernel, compile_at_once=True)


RELEASE = _make_problem(chatter_and_release.min_contact_force)
CHATTER = _make_problem(chatter_and_release.excess_speed)
