"""Expand the motion inside a soft wall over at most one longest step as a polynomial in the scaled time.

The scaled time s is the time over the longest step. The coefficients are arrays with the powers as the first axis.
About twelve operations replace a Horner scheme for each part of the flow. This representation is efficient in code that
is evaluated for few lanes or is differentiated.
"""

import jax
import jax.numpy as jnp
from jax import lax

from ..compiled.lane_arithmetic import choose
from . import flow, motion_in_soft_wall

DEGREE = flow.SERIES_ORDER
POWERS = tuple(range(DEGREE + 1))


def polynomial_basis(coeffs, contact):
    """Compute the polynomials of y under a unit of each part of the initial state and of each force, in each lane.

    Parameters
    ----------
    coeffs : FlowCoefficients
        Coefficients of each lane, see `motion_in_soft_wall.coeffs_by_lane`.
    contact : array
        Contact code times the sign of the wall.

    Returns
    -------
    list of array
        Coefficients of shape (DEGREE + 1, lanes): a constant 1, the four series of the `flow.FlowSeries`, and for each
        of the `motion_in_soft_wall.harmonic_forces` the responses to its cosine and sine.
    """
    basis_by_wall = [_wall_basis(soft_flow, contact.ndim) for _, soft_flow in motion_in_soft_wall.soft_walls(coeffs)]
    lane_basis = (
        basis_by_wall[0]
        if len(basis_by_wall) == 1
        else [jnp.where(contact < 0, *part) for part in zip(*basis_by_wall, strict=True)]
    )
    max_step_powers = scaled_time_powers(lax.stop_gradient(coeffs.max_step))
    return [part * max_step_powers for part in lane_basis]


def _wall_basis(soft_flow, n_lane_axes):
    """Return the `polynomial_basis` of one wall in powers of the unscaled time, for lanes with `n_lane_axes` axes."""
    harmonic_rows = [
        polynomial_rows
        for series in soft_flow.harmonic_series
        for polynomial_rows in (series.cos_response, series.sin_response)
    ]
    response_rows = [jnp.ones_like(soft_flow.series.p01[:1]), *soft_flow.series, *harmonic_rows]
    lowest_powers = (0, 2, 1, *(2, 3) * (len(response_rows) // 2 - 1))
    polynomial_rows = []
    for part, lowest_power in zip(response_rows, lowest_powers, strict=True):
        row_padding = [(lowest_power, DEGREE + 1 - lowest_power - len(part))] + [(0, 0)] * (part.ndim - 1)
        polynomial_rows.append(jnp.pad(part, row_padding))
    return [array.reshape(*array.shape, *[1] * (n_lane_axes + 1 - array.ndim)) for array in polynomial_rows]


def displacement_polynomial(coeffs, contact, polynomial_basis, displacement, velocity, cosine, sine):
    """Compute the coefficients of the polynomial of y.

    Parameters
    ----------
    coeffs : FlowCoefficients
        Coefficients of each lane, see `motion_in_soft_wall.coeffs_by_lane`.
    contact : array
        Contact code times the sign of the wall.
    polynomial_basis : list of array
        Result of `polynomial_basis`.
    displacement : array
        Initial displacement past the wall.
    velocity : array
        Initial velocity relative to the wall.
    cosine : array
        Cosine of the drive angle.
    sine : array
        Sine of the drive angle.

    Returns
    -------
    array
        Coefficients in the scaled time, of shape (DEGREE + 1, lanes).
    """
    position_over_stiffness, _ = motion_in_soft_wall.mean_position_increments(
        coeffs, contact, cosine, 1.0, 0.0 * cosine
    )
    basis_weights = [
        displacement,
        displacement + position_over_stiffness,
        velocity,
        coeffs.amplitude * cosine,
        -(coeffs.amplitude * sine),
    ]
    for force_cos, force_sin, _ in motion_in_soft_wall.harmonic_forces(coeffs, contact, cosine, sine):
        basis_weights += [force_cos, -force_sin]
    return sum(basis_weight * row for basis_weight, row in zip(basis_weights, polynomial_basis, strict=True))


def scaled_time_powers(scaled_time):
    """Return the powers of the scaled time.

    Parameters
    ----------
    scaled_time : array
        Scaled time s.

    Returns
    -------
    array
        1, s, s^2, ..., s^DEGREE along the first axis.
    """
    power_rows, factor = jnp.stack([jnp.ones_like(scaled_time), scaled_time]), scaled_time * scaled_time
    while len(power_rows) <= DEGREE:
        power_rows, factor = jnp.concatenate([power_rows, power_rows * factor]), factor * factor
    return power_rows[: DEGREE + 1]


def sum_along_axis(terms, axis=0):
    """Return the sum along an axis, computed as the last cumulative sum.

    Within a loop that is compiled as one kernel, no other sum along an axis of array entries is supported.
    """
    return lax.index_in_dim(lax.cumsum(terms, axis), -1, axis, keepdims=False)


def evaluate_polynomial(polynomial, time_powers):
    """Evaluate a polynomial.

    Parameters
    ----------
    polynomial : array
        Coefficients, powers first.
    time_powers : array
        Result of `scaled_time_powers`.

    Returns
    -------
    array
        Values.
    """
    return sum_along_axis(polynomial * time_powers[: len(polynomial)])


def differentiate_polynomial(polynomial):
    """Return the coefficients of the derivative of a polynomial with respect to s.

    Parameters
    ----------
    polynomial : array
        Coefficients, powers first.

    Returns
    -------
    array
        Coefficients of the derivative, one row fewer.
    """
    exponents = jnp.asarray(POWERS[1 : len(polynomial)], polynomial.dtype)
    return polynomial[1:] * exponents.reshape(-1, *[1] * (polynomial.ndim - 1))


def contact_response(coeffs, contact, polynomial_basis, time):
    """Compute the response of each lane over a contact phase by doubling.

    Parameters
    ----------
    coeffs : FlowCoefficients
        Coefficients of each lane, see `motion_in_soft_wall.coeffs_by_lane`.
    contact : array
        Contact code times the sign of the wall.
    polynomial_basis : list of array
        Result of `polynomial_basis`.
    time : array
        Duration of any length, in units of t.

    Returns
    -------
    ContactResponse
        Response of each lane, see `motion_in_soft_wall.ContactResponse`.
    """
    max_step = lax.stop_gradient(coeffs.max_step)
    n_doublings = jnp.maximum(jnp.ceil(jnp.log2(lax.stop_gradient(time) / max_step)), 0.0)
    short_step = time * jnp.exp2(-n_doublings)
    short_step_powers = scaled_time_powers(short_step / max_step)
    _, p00_minus_1, p01, cos_response, sin_response, *harmonic_values = (
        evaluate_polynomial(row, short_step_powers) for row in polynomial_basis
    )
    free_flow = 1.0 + p00_minus_1, p01, 1.0 + p00_minus_1 - 2.0 * coeffs.damping * p01
    angular_rates = [
        angular_rate
        for *_, angular_rate in motion_in_soft_wall.harmonic_forces(coeffs, contact, 0.0 * time, 0.0 * time)
    ]
    responses = [(cos_response, sin_response, coeffs.frequency + 0.0 * time)]
    responses += zip(harmonic_values[::2], harmonic_values[1::2], angular_rates, strict=True)
    forced_flows = [
        (
            ((x_cos, p01 - angular_rate * x_sin), (x_sin, angular_rate * x_cos)),
            flow.rotation_by_angle(angular_rate * short_step),
        )
        for x_cos, x_sin, angular_rate in responses
    ]

    def double_flows(carry):
        n_doublings_left, *flows = carry
        free_flow, *forced_flows = flows
        next_flows = [
            flow.responses_after_doubling(coeffs.stiffness, free_flow, *flow_and_rotation)
            for flow_and_rotation in forced_flows
        ]
        next_flows = [next_flows[0][0], *(flow_and_rotation[1:] for flow_and_rotation in next_flows)]
        return n_doublings_left - 1.0, *jax.tree.map(
            lambda next_value, value: choose(n_doublings_left > 0, next_value, value), next_flows, flows
        )

    initial_carry = (n_doublings, free_flow, *forced_flows)
    _, free_flow, *forced_flows = lax.while_loop(lambda carry: jnp.any(carry[0] > 0), double_flows, initial_carry)
    return motion_in_soft_wall.ContactResponse(
        free_flow, forced_flows[0][0], tuple(forced_flow for forced_flow, _ in forced_flows[1:])
    )
