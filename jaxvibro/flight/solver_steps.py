"""Step the free flight under a user-defined force with a solver of diffrax. The module is imported on demand only.

A step is as long as its estimated error allows. The error has two parts: that at the end of the step, which the solver
estimates, and that of the interpolating polynomial. This is the quintic through x, v and the acceleration at both ends.
Its error is h^6 x^(6) (s (1 - s))^3 / 720 at the fraction s of a step h, which is 1/24 of h^2 times the error of the
acceleration in the middle. Under strong damping it is smaller: the damping limits the error of v to the error of the
acceleration over the damping rate.
"""

import math
from functools import lru_cache, partial, reduce
from typing import Any, NamedTuple

import diffrax
import equinox as eqx
import jax
import jax.numpy as jnp
import lineax as lx
import numpy as np
import optimistix
from jax import lax
from jaxtyping import Float

from ..compiled.compiler_hints import choose, maximum, minimum
from ..scene.force import Force
from . import drive, event, flow
from .taylor_steps import (
    MAX_REMAINDER_SHARE,
    ContactForceJet,
    FlightSeries,
    as_derivatives,
    error_bound,
    error_scale,
    step_displacement,
)
from .wall_motion import wall_jet

MAX_TRIALS = 60  # largest number of trials of a step; each is shorter than the previous one
MIN_SHRINK, MAX_SHRINK = 0.05, 0.8  # ratio of a trial step to the previous one
SAFETY_FACTOR = 0.9  # of the optimal step
# least order at which error / motion decreases with the step; rounding errors have order 0 or 1
MIN_CONVERGENCE_ORDER = 1.5
ROUNDING_UNITS = 64.0  # roundoffs of x; smaller errors are always accepted
PRESS_SHRINK = 0.3  # ratio of a trial step of the contact force to the previous one
POLYNOMIAL_ERROR_RATIO = 24.0  # step^2 times the error of the acceleration over that of the polynomial, see above
MAX_EXACT_ORDER = 4  # highest derivative of x that is computed from derivatives of the force
# Chebyshev nodes of a step
CHEBYSHEV_NODES = 0.5 * (1.0 - np.cos(np.pi * np.arange(1, event.N_TERMS + 1) / event.N_TERMS))
# maps values at the nodes to coefficients of a polynomial
INVERSE_VANDERMONDE = np.linalg.inv(np.vander(CHEBYSHEV_NODES, increasing=True))
TOLERANCE_SENTINEL = diffrax.with_stepsize_controller_tols(diffrax.VeryChord)().rtol  # marks an unset tolerance


Matrix = Float[jax.Array, "2 2"]


class CramerSolver(lx.AbstractLinearSolver):
    """Solver of the two linear equations of a step by Cramer's rule, because a kernel cannot call LAPACK."""

    def init(self, operator: lx.AbstractLinearOperator, options: dict[str, Any]) -> Matrix:
        return operator.as_matrix()

    def compute(
        self, state: Matrix, vector: Float[jax.Array, "2"], options: dict[str, Any]
    ) -> tuple[Float[jax.Array, "2"], lx.RESULTS, dict[str, Any]]:
        (a, b), (c, d) = state
        u, w = vector
        solution = jnp.stack([d * u - b * w, a * w - c * u]) / (a * d - b * c)
        return solution, lx.RESULTS.successful, {}

    def transpose(self, state: Matrix, options: dict[str, Any]) -> tuple[Matrix, dict[str, Any]]:
        return state.T, {}

    def conj(self, state: Matrix, options: dict[str, Any]) -> tuple[Matrix, dict[str, Any]]:
        return state, {}

    def assume_full_rank(self) -> bool:
        return True


@lru_cache(64)
def _configure_solver(solver, tolerance):
    """Return a solver with forward-mode derivatives that solves its equations to a tolerance."""
    if getattr(solver, "scan_kind", "") is None:
        solver = eqx.tree_at(lambda tree: tree.scan_kind, solver, "lax", is_leaf=lambda leaf: leaf is None)
    if isinstance(solver, diffrax.AbstractImplicitSolver):
        for name, value in (("rtol", tolerance), ("atol", tolerance), ("norm", optimistix.max_norm)):
            if getattr(solver.root_finder, name) is TOLERANCE_SENTINEL:
                solver = eqx.tree_at(lambda tree, name=name: getattr(tree.root_finder, name), solver, value)
        if isinstance(getattr(solver.root_finder, "linear_solver", None), lx.AutoLinearSolver):
            solver = eqx.tree_at(lambda tree: tree.root_finder.linear_solver, solver, CramerSolver())
    return solver


class LaneForce(NamedTuple):
    """Force and drive of one or more lanes; the drive is as in `coefficients.FlowCoefficients`."""

    force_law: Force
    frequency: Float[jax.Array, "..."]
    amplitude: Float[jax.Array, "..."]
    drive_terms: tuple[drive.DriveTerm, ...]


def _map_lanes(function, coeffs, *arguments):
    """Apply a function (lane force, *arguments) of one state to each lane."""
    force_leaves, treedef = jax.tree.flatten(
        LaneForce(coeffs.force_law, coeffs.frequency, coeffs.amplitude, coeffs.drive_terms)
    )
    n_leaves, result_treedef = len(force_leaves), []

    def call_for_lane(*operands):
        leaves, treedef_of_result = jax.tree.flatten(
            function(treedef.unflatten(operands[:n_leaves]), *operands[n_leaves:])
        )
        result_treedef[:] = [treedef_of_result]
        return tuple(leaves)  # the only results that vectorize accepts for lanes with axes of length one

    leaves = jnp.vectorize(call_for_lane)(*force_leaves, *arguments)
    return result_treedef[0].unflatten(leaves)


def _acceleration(lane_force, cosine, sine, delay, x, v):
    """Return the acceleration after a delay, given the present phasor of the drive."""
    force_law, frequency, amplitude, drive_terms = lane_force
    c, s = flow.rotate_by_angle(cosine, sine, frequency * delay)
    acceleration = (
        force_law.function(lax.atan2(sine, cosine) / frequency + delay, x, v, force_law.numbers) + amplitude * c
    )
    return acceleration + sum(force_cos for force_cos, _, _ in drive.term_forces(drive_terms, frequency, c, s))


def _solver_step(lane_force, x, v, cosine, sine, length_scale, step):
    """Return (x, v, acceleration, estimated error over the length scale) after a step."""
    solver = _configure_solver(lane_force.force_law.solver, lane_force.force_law.tolerance)

    def vector_field(delay, y, _):
        x, v = length_scale * y[0], length_scale * y[1]
        return jnp.stack([v, _acceleration(lane_force, cosine, sine, delay, x, v)]) / length_scale

    term, start = diffrax.ODETerm(vector_field), jnp.stack([x, v]) / length_scale
    zero = jnp.zeros_like(step)
    state = solver.init(term, zero, step, start, None)
    end, error, _, _, result = solver.step(term, zero, step, start, None, state, made_jump=False)
    success = result == diffrax.RESULTS.successful
    error = jnp.where(success, jnp.max(jnp.abs(error)), jnp.inf)
    x, v = length_scale * end[0], length_scale * end[1]
    return x, v, _acceleration(lane_force, cosine, sine, step, x, v), error


def flight_series(coeffs, x, v, cosine, sine):
    """Return the `taylor_steps.FlightSeries` of lanes, a constant for derivatives."""
    coeffs, x, v, cosine, sine = lax.stop_gradient((coeffs, x, v, cosine, sine))
    acceleration = _lane_acceleration(coeffs, x, v, cosine, sine)
    length_scale = error_scale(coeffs, x, v, acceleration)
    return FlightSeries(
        *_map_lanes(_select_step, coeffs, x, v, cosine, sine, acceleration, length_scale, coeffs.max_step + 0.0 * x)
    )


def _lane_acceleration(coeffs, x, v, cosine, sine):
    """Return the acceleration of lanes."""
    return _map_lanes(_acceleration, coeffs, cosine, sine, jnp.zeros_like(x), x, v)


def force_gradient(coeffs, x, v, cosine, sine):
    """Return the derivative of the force with respect to x."""

    def lane_gradient(lane_force, x, v, cosine, sine):
        acceleration = partial(_acceleration, lane_force, cosine, sine, jnp.zeros_like(x))
        return jax.jvp(lambda x: acceleration(x, v), (x,), (jnp.ones_like(x),))[1]

    return _map_lanes(lane_gradient, coeffs, x, v, cosine, sine)


def _select_step(lane_force, x, v, cosine, sine, acceleration, length_scale, max_step):
    """Select the step length of one lane; return (terms, length, remainder) of a `taylor_steps.FlightSeries`.

    The error of an accepted step is at most `tolerance * length_scale`. Steps are shortened further until the error is
    also at most `sqrt(tolerance)` times the motion, so that small motions keep half of the digits. This ends if a
    shorter step does not reduce the error: then rounding dominates, or the residual of an implicit solver's equations.
    """
    force_law, acceleration_at = lane_force.force_law, partial(_acceleration, lane_force, cosine, sine)
    exponent = -1.0 / min(_configure_solver(force_law.solver, force_law.tolerance).order(None), 5)
    max_error, relative_tolerance = force_law.tolerance * length_scale, math.sqrt(force_law.tolerance)
    rounding_error = ROUNDING_UNITS * float(jnp.finfo(x.dtype).eps) * jnp.abs(x) + event.smallest_length(x.dtype)

    def try_step(step):
        """Return (terms, error, error / allowed error) of a step."""
        end_x, end_v, end_acceleration, error = _solver_step(lane_force, x, v, cosine, sine, length_scale, step)
        terms = quintic_coefficients(x, v, acceleration, end_x, end_v, end_acceleration, step)
        half_step = 0.5 * step
        mid_x, mid_v = event.horner_with_slope(terms, half_step)
        mid_acceleration = event.horner_with_slope([k * term for k, term in enumerate(terms)][1:], half_step)[1]
        exact_acceleration, damping_rate = jax.jvp(
            partial(acceleration_at, half_step, mid_x), (mid_v,), (jnp.ones_like(mid_v),)
        )
        interpolation_error = (
            step
            * step
            * jnp.abs(mid_acceleration - exact_acceleration)
            / (POLYNOMIAL_ERROR_RATIO + step * jnp.abs(damping_rate))
        )
        error = jnp.maximum(length_scale * error, interpolation_error)
        error = jnp.where(jnp.isnan(error), jnp.inf, error)
        displacement = maximum(
            step_displacement(v, acceleration, step), maximum(jnp.abs(end_x - x), step * jnp.abs(end_v))
        )
        allowed_error = minimum(max_error, maximum(relative_tolerance * displacement, rounding_error))
        return tuple(terms), error, error / allowed_error

    def shorten(carry):
        step, terms, error, error_ratio, n_trials, _ = carry
        next_step = step * jnp.clip(SAFETY_FACTOR * error_ratio**exponent, MIN_SHRINK, MAX_SHRINK)
        next_terms, next_error, next_error_ratio = try_step(next_step)
        no_progress = (error <= max_error) & ~(
            next_error_ratio < error_ratio * (next_step / step) ** MIN_CONVERGENCE_ORDER
        )
        values, next_values = (step, terms, error, error_ratio), (next_step, next_terms, next_error, next_error_ratio)
        return *jax.tree.map(partial(choose, no_progress), values, next_values), n_trials + 1, no_progress

    def is_unfinished(carry):
        *_, error_ratio, n_trials, no_progress = carry
        return (error_ratio > 1.0) & (n_trials < MAX_TRIALS) & ~no_progress

    initial_carry = (max_step, *try_step(max_step), jnp.int32(0), jnp.zeros(x.shape, bool))
    step, terms, error, *_ = lax.while_loop(is_unfinished, shorten, initial_carry)
    zero, remainder_bound = (
        jnp.zeros_like(step),
        error_bound(step_displacement(v, acceleration, step), error, length_scale, force_law.tolerance),
    )
    return [*terms, *[zero] * (event.N_TERMS + 3 - len(terms))], step, remainder_bound


def quintic_coefficients(x, v, acceleration, end_x, end_v, end_acceleration, step):
    """Return the coefficients, from the constant on, of the quintic with given x, v and acceleration at both ends."""
    x_defect = (end_x - x) - step * (v + 0.5 * step * acceleration)
    v_defect = step * ((end_v - v) - step * acceleration)
    acceleration_defect = step * step * (end_acceleration - acceleration)
    cubic, quartic = (
        10.0 * x_defect - 4.0 * v_defect + 0.5 * acceleration_defect,
        7.0 * v_defect - 15.0 * x_defect - acceleration_defect,
    )
    return (
        x,
        v,
        0.5 * acceleration,
        cubic / step**3,
        quartic / step**4,
        (6.0 * x_defect - 3.0 * v_defect + 0.5 * acceleration_defect) / step**5,
    )


def step_increments(coeffs, x, v, cosine, sine, step, terms=None):
    """Return (increment of x, increment of v) of a step of the solver."""
    length_scale = lax.stop_gradient(error_scale(coeffs, x, v, _lane_acceleration(coeffs, x, v, cosine, sine)))

    def lane_increments(lane_force, x, v, cosine, sine, length_scale, step):
        end_x, end_v, _, _ = _solver_step(lane_force, x, v, cosine, sine, length_scale, step)
        return end_x - x, end_v - v

    return _map_lanes(lane_increments, coeffs, x, v, cosine, sine, length_scale, step)


def derivatives(coeffs, x, v, cosine, sine, order):
    """Return x and its derivatives up to an order; the high ones are those of a step's polynomial."""
    n_exact = min(order, MAX_EXACT_ORDER) - 1
    jet = [x, v, *_map_lanes(partial(_acceleration_jet, n_derivatives=n_exact), coeffs, x, v, cosine, sine)]
    if order > MAX_EXACT_ORDER:
        jet += as_derivatives(flight_series(coeffs, x, v, cosine, sine).terms)[MAX_EXACT_ORDER + 1 : order + 1]
    return jet


def _acceleration_jet(lane_force, x, v, cosine, sine, n_derivatives):
    """Return the acceleration and its derivatives along the motion, n_derivatives values."""
    acceleration = partial(_acceleration, lane_force, cosine, sine)

    def total_derivative(function):
        return lambda delay, x, v: jax.jvp(
            function, (delay, x, v), (jnp.ones_like(delay), v, acceleration(delay, x, v))
        )[1]

    jet, derivative = [], acceleration
    for _ in range(n_derivatives):
        jet.append(derivative(jnp.zeros_like(x), x, v))
        derivative = total_derivative(derivative)
    return jet


def _contact_force(coeffs, wall, cosine, sine, delay):
    """Return the contact force on a wall after a delay, given the present phasor of the drive."""
    wall_position, wall_velocity, wall_acceleration = wall_jet(
        wall, coeffs.frequency, *flow.rotate_by_angle(cosine, sine, coeffs.frequency * delay), 2
    )
    zero = jnp.zeros_like(delay)
    wall_velocity, wall_acceleration = (
        zero if derivative is None else derivative for derivative in (wall_velocity, wall_acceleration)
    )
    return _map_lanes(_acceleration, coeffs, cosine, sine, delay, wall_position, wall_velocity) - wall_acceleration


def contact_force_terms(coeffs, wall, cosine, sine, order):
    """Return the Taylor coefficients of the contact force on a wall up to an order."""

    def total_derivative(function):
        return lambda delay: jax.jvp(function, (delay,), (jnp.ones_like(delay),))[1]

    terms, derivative = [], partial(_contact_force, coeffs, wall, cosine, sine)
    for k in range(order + 1):
        terms.append(derivative(jnp.zeros_like(cosine)) * (1.0 / math.factorial(k)))
        derivative = total_derivative(derivative)
    return terms


def contact_force_jet(coeffs, wall, cosine, sine):
    """Return the `taylor_steps.ContactForceJet` on a wall, from values at nodes of a step.

    The step is shortened until the nodes resolve the contact force.
    """
    initial_force = _contact_force(coeffs, wall, cosine, sine, jnp.zeros_like(cosine))

    def fit_terms(step):
        divided_differences = [
            (_contact_force(coeffs, wall, cosine, sine, node * step) - initial_force) / node
            for node in CHEBYSHEV_NODES.tolist()
        ]
        terms = [
            initial_force,
            *(
                sum(weight * difference for weight, difference in zip(weights, divided_differences, strict=True))
                for weights in INVERSE_VANDERMONDE
            ),
        ]
        terms = [lax.convert_element_type(term, step.dtype) for term in terms]
        magnitudes = [lax.abs(term) for term in terms]
        return terms, choose(
            magnitudes[-1] > MAX_REMAINDER_SHARE * reduce(maximum, magnitudes[:-1]),
            lax.full_like(initial_force, 1.0),
            0.0,
        )

    def shorten(carry):
        step, _, is_unresolved, n_trials = carry
        step = choose(is_unresolved > 0, PRESS_SHRINK * step, step)
        return step, *fit_terms(step), n_trials + 1

    max_step = coeffs.max_step + 0.0 * cosine
    initial_carry = (max_step, *fit_terms(max_step), jnp.int32(0))
    step, terms, _, _ = lax.while_loop(
        lambda carry: jnp.any(carry[2] > 0) & (carry[3] < MAX_TRIALS), shorten, initial_carry
    )
    force_derivs = as_derivatives([term / step**k for k, term in enumerate(terms[: event.N_TERMS])])
    return ContactForceJet(force_derivs, 2.0 * lax.abs(terms[event.N_TERMS]), step)


def sampling_step(coeffs, step):
    """Return the step up to which the polynomial of a step is correct to 1e-4 of its size."""
    return step * (1e-4 / coeffs.force_law.tolerance) ** (1.0 / 6.0)
