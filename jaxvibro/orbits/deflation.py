"""Find several solutions of the equations of the impacts from one guess: Newton's method with deflation.

With known solutions r, F is multiplied by ``prod (1 + 1 / |u - r|^2)``, which removes the zeros at all r. Newton's
method from the same guess then reaches another solution, or none (Farrell, Birkisson and Funke, SIAM J. Sci. Comput.
37, A2026, 2015). The factor is a scalar function, so that deflation multiplies Newton's step by a scalar. The
distance compares phases and speeds, for all cyclic shifts of impacts and periods.
"""

from functools import partial
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Bool, Float

from continuation import newton
from continuation.array_type import Array
from continuation.hostcall import persistent_jit

from ..contact.kinds import flow_coefficients
from . import flight_clearance, impact_equations

N_SOLUTIONS = 3  # solutions from one guess
MAX_NEWTON_STEPS = 60
MIN_DENOMINATOR = 1e-3  # smallest denominator of a deflated step, which bounds the step


class DeflatedSolutions(NamedTuple):
    """Solutions from one guess, in order of discovery.

    Attributes
    ----------
    times, speeds : Array
        Times and speeds of the impacts, in order of time.
    admissible : Array of bool
        True if Newton's method has converged, the order of the walls is that of the guess, the speeds are positive, and
        the flights stay between the walls.
    """

    times: Float[Array, "*lanes rows"]
    speeds: Float[Array, "*lanes rows"]
    admissible: Bool[Array, "*lanes"]


def solve_with_deflation(scenes, guesses, max_speed):
    """Find up to `N_SOLUTIONS` solutions from the guess of each lane.

    Parameters
    ----------
    scenes : Scene
        Scene with leaves of shape (lanes,).
    guesses : ImpactSequence
        Guesses of the lanes.
    max_speed : array
        Largest speed of the initial states of each lane, array of shape (lanes,). The distance between two solutions
        divides differences of speeds by this speed.

    Returns
    -------
    DeflatedSolutions
        Solutions with leaves of shape (solutions, lanes, ...).
    """
    n_lanes, n_rows = guesses.times.shape
    known_solutions, is_solution_known = np.zeros((n_lanes, N_SOLUTIONS, 2, n_rows)), np.zeros((n_lanes, N_SOLUTIONS))
    solutions = []
    for solution_index in range(N_SOLUTIONS):
        solution, converged = jax.device_get(
            _solve_lane(scenes, guesses, known_solutions, is_solution_known, max_speed)
        )
        solutions.append(solution)
        (
            known_solutions[:, solution_index, 0],
            known_solutions[:, solution_index, 1],
            is_solution_known[:, solution_index],
        ) = (
            solution.times,
            solution.speeds,
            converged,
        )
    return DeflatedSolutions(*(np.stack(fields) for fields in zip(*solutions, strict=True)))


@persistent_jit()
@jax.vmap
def _solve_lane(scene, guess, known_solutions, is_solution_known, max_speed):
    """Return (`DeflatedSolutions`, True if Newton's method has converged) of one lane."""
    coeffs, n_rows = flow_coefficients(scene), len(guess.sides)
    max_change = jnp.repeat(
        jnp.array([impact_equations.MAX_TIME_CHANGE * coeffs.period, jnp.inf]), n_rows, total_repeat_length=2 * n_rows
    )
    deflation_gradient_of = jax.grad(
        partial(_log_deflation_factor, coeffs, guess.sides, known_solutions, is_solution_known, max_speed)
    )

    def equations_and_gradient(unknowns):
        return impact_equations.residual_and_jacobian(
            coeffs, guess._replace(times=unknowns[:n_rows], speeds=unknowns[n_rows:])
        ), deflation_gradient_of(unknowns)

    def solve_deflated_step(jacobian, residual):
        (jacobian, gradient) = jacobian
        change, pivot_ratio = impact_equations.solve_cyclic(jacobian, residual)
        denominator = 1.0 + jnp.sum(gradient * change)
        return change / jnp.where(
            abs(denominator) < MIN_DENOMINATOR,
            jnp.where(denominator < 0, -MIN_DENOMINATOR, MIN_DENOMINATOR),
            denominator,
        ), pivot_ratio

    def residual_and_derivatives(unknowns):
        (residual, jacobian), gradient = equations_and_gradient(unknowns)
        return residual, (jacobian, gradient)

    newton_result = newton.newton(
        residual_and_derivatives,
        jnp.concatenate([guess.times, guess.speeds]),
        max_change,
        MAX_NEWTON_STEPS,
        solve_deflated_step,
    )
    sequence = impact_equations.sort_sequence(scene, guess, newton_result.unknowns)
    flights, is_impact = impact_equations.compute_flights(coeffs, sequence), sequence.sides != 0
    clearances, _ = flight_clearance.turning_clearances(coeffs, flights, flight_clearance.sample_count(coeffs, flights))
    admissible = jnp.all(~is_impact | ((sequence.speeds > 0) & (flights.time > 0))) & jnp.all(
        ~is_impact[:, None] | (clearances >= 0)
    )
    converged = newton_result.status == newton.OK
    has_guessed_sides = jnp.all(sequence.sides == guess.sides)
    return DeflatedSolutions(sequence.times, sequence.speeds, converged & has_guessed_sides & admissible), converged


def _log_deflation_factor(coeffs, sides, known_solutions, is_solution_known, max_speed, unknowns):
    """Evaluate the logarithm of the deflation factor."""
    n_rows, is_impact = len(sides), sides != 0
    n_impacts, row_index = jnp.sum(is_impact), jnp.arange(len(sides))
    phase, speed = coeffs.frequency * unknowns[:n_rows], unknowns[n_rows:]
    log_factors = []
    for impact_shift in range(n_rows):
        shifted_index = (row_index + impact_shift) % n_impacts
        shifted_solutions = known_solutions[:, :, jnp.where(is_impact, shifted_index, row_index)]
        squared_impact_distance = (
            2.0
            - 2.0 * jnp.cos(phase - coeffs.frequency * shifted_solutions[:, 0])
            + ((speed - shifted_solutions[:, 1]) / max_speed) ** 2
        )
        squared_distance = jnp.sum(jnp.where(is_impact, squared_impact_distance, 0.0), axis=1)
        log_factors.append(
            jnp.where(
                (is_solution_known > 0) & (impact_shift < n_impacts),
                jnp.log1p(1.0 / jnp.maximum(squared_distance, 1e-30)),
                0.0,
            )
        )
    return jnp.sum(jnp.stack(log_factors))
