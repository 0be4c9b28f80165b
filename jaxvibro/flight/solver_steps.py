"""Step the free flight under a user-defined force with a solver of diffrax.

The module is imported on demand only. A step is as long as the estimated error allows. The error is the larger of two:
the error at the end of the step, which the solver estimates, and the error of the interpolating polynomial. This
polynomial is the quintic with the values of x, v and the acceleration at both ends. At the fraction s of a step h, the
error of the quintic is h^6 x^(6) (s (1 - s))^3 / 720. At s = 1/2 this is h^2 / 24 times the error of the acceleration.
Under strong damping the error is smaller, because damping limits the error of v to the error of the acceleration over
the damping rate.
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

from ..compiled.lane_arithmetic import choose, maximum, minimum
from ..scene.force import Force
from . import event_certificates, flow, further_drive_terms
from .taylor_steps import (
    MAX_REMAINDER_SHARE,
    ContactForceJet,
    FlightSeries,
    derivatives_from_terms,
    error_scale,
    step_displacement,
    step_error_bound,
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
CHEBYSHEV_NODES = 0.5 * (
    1.0 - np.cos(np.pi * np.arange(1, event_certificates.N_TERMS + 1) / event_certificates.N_TERMS)
)
# maps values at the nodes to coefficients of a polynomial
INVERSE_VANDERMONDE = np.linalg.inv(np.vander(CHEBYSHEV_NODES, increasing=True))
TOLERANCE_SENTINEL = diffrax.with_stepsize_controller_tols(diffrax.VeryChord)().rtol  # marks an unset tolerance


Matrix = Float[jax.Array, "2 2"]


class CramerSolver(lx.AbstractLinearSolver):
    """Solver of two linear equations by Cramer's rule, because a kernel cannot call LAPACK."""

    def init(self, operator: lx.AbstractLinearOperator, options: dict[str, Any]) -> Matrix:
        return operator.as_matrix()

    def compute(
        self, state: Matrix, vector: Float[jax.Array, "2"], options: dict[str, Any]
    ) -> tuple[Float[jax.Array, "2"], lx.RESULTS, dict[str, Any]]:
        (entry_00, entry_01), (entry_10, entry_11) = state
        right_side_0, right_side_1 = vector
        solution = jnp.stack(
            [entry_11 * right_side_0 - entry_01 * right_side_1, entry_00 * right_side_1 - entry_10 * right_side_0]
        ) / (entry_00 * entry_11 - entry_01 * entry_10)
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
    """User-defined force and drive of one or more lanes.

    Attributes
    ----------
    user_force : Force
        User-defined force.
    frequency : array
        Drive frequency.
    amplitude : array
        Drive amplitude.
    drive_terms : tuple of DriveTerm
        Further drive terms.
    """

    user_force: Force
    frequency: Float[jax.Array, "..."]
    amplitude: Float[jax.Array, "..."]
    drive_terms: tuple[further_drive_terms.DriveTerm, ...]


def _apply_per_lane(function, coeffs, *arguments):
    """Apply ``function(lane_force, *arguments)``, which is written for one state, to each lane."""
    force_leaves, force_treedef = jax.tree.flatten(
        LaneForce(coeffs.user_force, coeffs.frequency, coeffs.amplitude, coeffs.drive_terms)
    )
    n_leaves, result_treedef = len(force_leaves), []

    def call_for_lane(*operands):
        leaves, treedef_of_result = jax.tree.flatten(
            function(force_treedef.unflatten(operands[:n_leaves]), *operands[n_leaves:])
        )
        result_treedef[:] = [treedef_of_result]
        return tuple(leaves)  # the only results that vectorize accepts for lanes with axes of length one

    leaves = jnp.vectorize(call_for_lane)(*force_leaves, *arguments)
    return result_treedef[0].unflatten(leaves)


def _acceleration(lane_force, cosine, sine, delay, x, v):
    """Return the acceleration at x and v after a delay, given the phasor of the drive before the delay."""
    user_force, frequency, amplitude, drive_terms = lane_force
    end_cosine, end_sine = flow.rotate_phasor_by_angle(cosine, sine, frequency * delay)
    acceleration = (
        user_force.function(lax.atan2(sine, cosine) / frequency + delay, x, v, user_force.numbers)
        + amplitude * end_cosine
    )
    return acceleration + sum(
        force_cos for force_cos, _, _ in further_drive_terms.term_forces(drive_terms, frequency, end_cosine, end_sine)
    )


def _solver_step(lane_force, x, v, cosine, sine, length_scale, step):
    """Return (x, v, acceleration, estimated error divided by the length scale) after a step of the solver."""
    solver = _configure_solver(lane_force.user_force.solver, lane_force.user_force.tolerance)

    def vector_field(delay, scaled_state, _):
        x, v = length_scale * scaled_state[0], length_scale * scaled_state[1]
        return jnp.stack([v, _acceleration(lane_force, cosine, sine, delay, x, v)]) / length_scale

    ode_term, start_state = diffrax.ODETerm(vector_field), jnp.stack([x, v]) / length_scale
    zero = jnp.zeros_like(step)
    solver_state = solver.init(ode_term, zero, step, start_state, None)
    end_state, estimated_error, _, _, solver_status = solver.step(
        ode_term, zero, step, start_state, None, solver_state, made_jump=False
    )
    is_successful = solver_status == diffrax.RESULTS.successful
    estimated_error = jnp.where(is_successful, jnp.max(jnp.abs(estimated_error)), jnp.inf)
    x, v = length_scale * end_state[0], length_scale * end_state[1]
    return x, v, _acceleration(lane_force, cosine, sine, step, x, v), estimated_error


def flight_series(coeffs, x, v, cosine, sine):
    """Return the `taylor_steps.FlightSeries` of lanes, which is a constant under differentiation."""
    coeffs, x, v, cosine, sine = lax.stop_gradient((coeffs, x, v, cosine, sine))
    acceleration = _lane_acceleration(coeffs, x, v, cosine, sine)
    length_scale = error_scale(coeffs, x, v, acceleration)
    return FlightSeries(
        *_apply_per_lane(
            _select_step_length, coeffs, x, v, cosine, sine, acceleration, length_scale, coeffs.max_step + 0.0 * x
        )
    )


def _lane_acceleration(coeffs, x, v, cosine, sine):
    """Return the acceleration of lanes."""
    return _apply_per_lane(_acceleration, coeffs, cosine, sine, jnp.zeros_like(x), x, v)


def force_derivative_in_x(coeffs, x, v, cosine, sine):
    """Return the derivative of the force with respect to x."""

    def lane_derivative_in_x(lane_force, x, v, cosine, sine):
        acceleration = partial(_acceleration, lane_force, cosine, sine, jnp.zeros_like(x))
        return jax.jvp(lambda x: acceleration(x, v), (x,), (jnp.ones_like(x),))[1]

    return _apply_per_lane(lane_derivative_in_x, coeffs, x, v, cosine, sine)


def _select_step_length(lane_force, x, v, cosine, sine, acceleration, length_scale, max_step):
    """Select the step length of one lane; return the fields of a `taylor_steps.FlightSeries`.

    The error of an accepted step is at most `tolerance * length_scale`. Steps are shortened further until the error is
    also at most `sqrt(tolerance)` times the displacement, so that half of the digits of small motions are correct. The
    search ends if a shorter step does not reduce the error. The error is then due to rounding or to the residual of the
    equations of an implicit solver.
    """
    user_force, acceleration_at = lane_force.user_force, partial(_acceleration, lane_force, cosine, sine)
    exponent = -1.0 / min(_configure_solver(user_force.solver, user_force.tolerance).order(None), 5)
    max_error, relative_tolerance = user_force.tolerance * length_scale, math.sqrt(user_force.tolerance)
    rounding_error = ROUNDING_UNITS * float(jnp.finfo(x.dtype).eps) * jnp.abs(
        x
    ) + event_certificates.min_squarable_length(x.dtype)

    def try_step(step):
        """Return (terms, error, error / allowed error) of a step."""
        end_x, end_v, end_acceleration, estimated_error = _solver_step(
            lane_force, x, v, cosine, sine, length_scale, step
        )
        terms = quintic_coefficients(x, v, acceleration, end_x, end_v, end_acceleration, step)
        half_step = 0.5 * step
        mid_x, mid_v = event_certificates.horner_with_slope(terms, half_step)
        mid_acceleration = event_certificates.horner_with_slope(
            [k * term for k, term in enumerate(terms)][1:], half_step
        )[1]
        exact_acceleration, damping_rate = jax.jvp(
            partial(acceleration_at, half_step, mid_x), (mid_v,), (jnp.ones_like(mid_v),)
        )
        interpolation_error = (
            step
            * step
            * jnp.abs(mid_acceleration - exact_acceleration)
            / (POLYNOMIAL_ERROR_RATIO + step * jnp.abs(damping_rate))
        )
        estimated_error = jnp.maximum(length_scale * estimated_error, interpolation_error)
        estimated_error = jnp.where(jnp.isnan(estimated_error), jnp.inf, estimated_error)
        displacement = maximum(
            step_displacement(v, acceleration, step), maximum(jnp.abs(end_x - x), step * jnp.abs(end_v))
        )
        allowed_error = minimum(max_error, maximum(relative_tolerance * displacement, rounding_error))
        return tuple(terms), estimated_error, estimated_error / allowed_error

    def reduce_error(carry):
        step, terms, error, error_ratio, n_trials, _ = carry
        next_step = step * jnp.clip(SAFETY_FACTOR * error_ratio**exponent, MIN_SHRINK, MAX_SHRINK)
        next_terms, next_error, next_error_ratio = try_step(next_step)
        has_error_stagnated = (error <= max_error) & ~(
            next_error_ratio < error_ratio * (next_step / step) ** MIN_CONVERGENCE_ORDER
        )
        values, next_values = (step, terms, error, error_ratio), (next_step, next_terms, next_error, next_error_ratio)
        return (
            *jax.tree.map(partial(choose, has_error_stagnated), values, next_values),
            n_trials + 1,
            has_error_stagnated,
        )

    def is_unfinished(carry):
        *_, error_ratio, n_trials, has_error_stagnated = carry
        return (error_ratio > 1.0) & (n_trials < MAX_TRIALS) & ~has_error_stagnated

    initial_carry = (max_step, *try_step(max_step), jnp.int32(0), jnp.zeros(x.shape, bool))
    step, terms, error, *_ = lax.while_loop(is_unfinished, reduce_error, initial_carry)
    zero, remainder_bound = (
        jnp.zeros_like(step),
        step_error_bound(step_displacement(v, acceleration, step), error, length_scale, user_force.tolerance),
    )
    return [*terms, *[zero] * (event_certificates.N_TERMS + 3 - len(terms))], step, remainder_bound


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

    return _apply_per_lane(lane_increments, coeffs, x, v, cosine, sine, length_scale, step)


def position_derivatives(coeffs, x, v, cosine, sine, order):
    """Return x and its derivatives up to an order.

    Derivatives of an order above `MAX_EXACT_ORDER` are those of the polynomial of a step.
    """
    n_acceleration_derivs = min(order, MAX_EXACT_ORDER) - 1
    position_jet = [
        x,
        v,
        *_apply_per_lane(partial(_acceleration_jet, n_derivatives=n_acceleration_derivs), coeffs, x, v, cosine, sine),
    ]
    if order > MAX_EXACT_ORDER:
        position_jet += derivatives_from_terms(flight_series(coeffs, x, v, cosine, sine).terms)[
            MAX_EXACT_ORDER + 1 : order + 1
        ]
    return position_jet


def _acceleration_jet(lane_force, x, v, cosine, sine, n_derivatives):
    """Return the acceleration and its time derivatives along the motion, `n_derivatives` values in all."""
    acceleration = partial(_acceleration, lane_force, cosine, sine)

    def total_derivative(function):
        return lambda delay, x, v: jax.jvp(
            function, (delay, x, v), (jnp.ones_like(delay), v, acceleration(delay, x, v))
        )[1]

    acceleration_jet, derivative_function = [], acceleration
    for _ in range(n_derivatives):
        acceleration_jet.append(derivative_function(jnp.zeros_like(x), x, v))
        derivative_function = total_derivative(derivative_function)
    return acceleration_jet


def _contact_force(coeffs, wall, cosine, sine, delay):
    """Return the contact force on a wall after a delay, given the phasor of the drive before the delay."""
    wall_position, wall_velocity, wall_acceleration = wall_jet(
        wall, coeffs.frequency, *flow.rotate_phasor_by_angle(cosine, sine, coeffs.frequency * delay), 2
    )
    zero = jnp.zeros_like(delay)
    wall_velocity, wall_acceleration = (
        zero if derivative is None else derivative for derivative in (wall_velocity, wall_acceleration)
    )
    return _apply_per_lane(_acceleration, coeffs, cosine, sine, delay, wall_position, wall_velocity) - wall_acceleration


def contact_taylor_terms(coeffs, wall, cosine, sine, order):
    """Return the Taylor coefficients of the contact force on a wall up to an order."""

    def total_derivative(function):
        return lambda delay: jax.jvp(function, (delay,), (jnp.ones_like(delay),))[1]

    terms, derivative_function = [], partial(_contact_force, coeffs, wall, cosine, sine)
    for k in range(order + 1):
        terms.append(derivative_function(jnp.zeros_like(cosine)) * (1.0 / math.factorial(k)))
        derivative_function = total_derivative(derivative_function)
    return terms


def contact_force_jet(coeffs, wall, cosine, sine):
    """Return the `taylor_steps.ContactForceJet` on a wall, from values at Chebyshev nodes of a step.

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
                sum(weight * difference for weight, difference in zip(node_weights, divided_differences, strict=True))
                for node_weights in INVERSE_VANDERMONDE
            ),
        ]
        terms = [lax.convert_element_type(term, step.dtype) for term in terms]
        term_magnitudes = [lax.abs(term) for term in terms]
        return terms, choose(
            term_magnitudes[-1] > MAX_REMAINDER_SHARE * reduce(maximum, term_magnitudes[:-1]),
            lax.full_like(initial_force, 1.0),
            0.0,
        )

    def shorten_step(carry):
        step, _, is_unresolved, n_trials = carry
        step = choose(is_unresolved > 0, PRESS_SHRINK * step, step)
        return step, *fit_terms(step), n_trials + 1

    max_step = coeffs.max_step + 0.0 * cosine
    initial_carry = (max_step, *fit_terms(max_step), jnp.int32(0))
    step, terms, _, _ = lax.while_loop(
        lambda carry: jnp.any(carry[2] > 0) & (carry[3] < MAX_TRIALS), shorten_step, initial_carry
    )
    force_derivs = derivatives_from_terms(
        [term / step**k for k, term in enumerate(terms[: event_certificates.N_TERMS])]
    )
    return ContactForceJet(force_derivs, 2.0 * lax.abs(terms[event_certificates.N_TERMS]), step)


def sampling_step(coeffs, step):
    """Return the time up to which the polynomial of a step has a relative error of at most 1e-4."""
    return step * (1e-4 / coeffs.user_force.tolerance) ** (1.0 / 6.0)
