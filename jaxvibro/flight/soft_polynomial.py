"""Expand the motion inside a soft wall over at most one longest step as a polynomial in the scaled time.

The scaled time s is the time over the longest step. The coefficients are arrays with the powers as the first axis.
About twelve operations replace a Horner scheme for each part of the flow. This suits code that is evaluated for few
lanes or is differentiated.
"""

import jax
import jax.numpy as jnp
from jax import lax

from ..compiled.compiler_hints import choose
from . import flow, soft_contact

DEGREE = flow.SERIES_ORDER
POWERS = tuple(range(DEGREE + 1))


def polynomial_basis(coeffs, contact):
    """Compute the contribution of each part of the motion to the polynomial of each lane.

    Parameters
    ----------
    coeffs : FlowCoefficients
        Coefficients of each lane, see `soft_contact.coeffs_by_lane`.
    contact : array
        Contact code times the sign of the wall.

    Returns
    -------
    list of array
        Arrays of shape (DEGREE + 1, lanes): for y, for the rows of the `flow.FlowSeries`, and for those of each of the
        `soft_contact.harmonic_forces`.
    """
    soft_flows = [part for part in coeffs.soft_flows if part is not None]
    has_moving_wall = soft_contact.has_moving_soft_wall(coeffs)
    bases = [_wall_basis(part, has_moving_wall, contact.ndim) for part in soft_flows]
    basis = bases[0] if len(bases) == 1 else [jnp.where(contact < 0, *part) for part in zip(*bases, strict=True)]
    step_powers = powers(lax.stop_gradient(coeffs.max_step))
    return [part * step_powers for part in basis]


def _wall_basis(soft_flow, has_moving_wall, n_lane_axes):
    """Return the basis of one wall in powers of the unscaled time, for lanes with n_lane_axes axes."""
    flow_rows = [
        soft_flow.series.p00_minus_1,
        soft_flow.series.p01,
        soft_flow.series.cos_response,
        soft_flow.series.sin_response,
    ]
    wall_rows = (
        [jnp.zeros_like(array) for array in flow_rows[2:]]
        if soft_flow.wall_series is None
        else [soft_flow.wall_series.cos_response, soft_flow.wall_series.sin_response]
    )
    term_rows = [rows for series in soft_flow.term_series for rows in (series.cos_response, series.sin_response)]
    parts = [jnp.ones_like(flow_rows[0][:1]), *flow_rows, *term_rows, *(wall_rows if has_moving_wall else [])]
    first_powers = (0, 2, 1, *(2, 3) * (len(parts) // 2 - 1))
    rows = []
    for part, first_power in zip(parts, first_powers, strict=True):
        padding = [(first_power, DEGREE + 1 - first_power - len(part))] + [(0, 0)] * (part.ndim - 1)
        rows.append(jnp.pad(part, padding))
    return [array.reshape(*array.shape, *[1] * (n_lane_axes + 1 - array.ndim)) for array in rows]


def coefficients(coeffs, contact, basis, y, v, cosine, sine):
    """Compute the coefficients of the polynomial of y.

    Parameters
    ----------
    coeffs : FlowCoefficients
        Coefficients of each lane, see `soft_contact.coeffs_by_lane`.
    contact : array
        Contact code times the sign of the wall.
    basis : list of array
        Result of `polynomial_basis`.
    y : array
        Initial displacement past the wall.
    v : array
        Initial velocity relative to the wall.
    cosine : array
        Cosine of the drive angle.
    sine : array
        Sine of the drive angle.

    Returns
    -------
    array
        Coefficients of shape (DEGREE + 1, lanes).
    """
    wall_position, _ = soft_contact.mean_position_increments(coeffs, contact, cosine, 1.0, 0.0 * cosine)
    parts = [y, y + wall_position, v, coeffs.amplitude * cosine, -(coeffs.amplitude * sine)]
    for force_cos, force_sin, _ in soft_contact.harmonic_forces(coeffs, contact, cosine, sine):
        parts += [force_cos, -force_sin]
    return sum(part * row for part, row in zip(parts, basis, strict=True))


def powers(step_fraction):
    """Return the powers of the scaled time.

    Parameters
    ----------
    step_fraction : array
        Scaled time s.

    Returns
    -------
    array
        1, s, s^2, ..., s^DEGREE along the first axis.
    """
    rows, factor = jnp.stack([jnp.ones_like(step_fraction), step_fraction]), step_fraction * step_fraction
    while len(rows) <= DEGREE:
        rows, factor = jnp.concatenate([rows, rows * factor]), factor * factor
    return rows[: DEGREE + 1]


def sum_along_axis(terms, axis=0):
    """Return the sum along an axis, as the last cumulative sum.

    With many lanes, the emitter of a whole loop as one kernel supports no other sum along an axis that is not a lane
    axis.
    """
    return lax.index_in_dim(lax.cumsum(terms, axis), -1, axis, keepdims=False)


def evaluate(coefficients, powers):
    """Evaluate a polynomial.

    Parameters
    ----------
    coefficients : array
        Coefficients, powers first.
    powers : array
        Result of `powers`.

    Returns
    -------
    array
        Values.
    """
    return sum_along_axis(coefficients * powers[: len(coefficients)])


def differentiate(coefficients):
    """Return the coefficients of the derivative of a polynomial with respect to s.

    Parameters
    ----------
    coefficients : array
        Coefficients, powers first.

    Returns
    -------
    array
        Coefficients of the derivative, one row fewer.
    """
    exponents = jnp.asarray(POWERS[1 : len(coefficients)], coefficients.dtype)
    return coefficients[1:] * exponents.reshape(-1, *[1] * (coefficients.ndim - 1))


def contact_response(coeffs, contact, basis, time):
    """Compute the response of each lane over a contact phase by doubling.

    Parameters
    ----------
    coeffs : FlowCoefficients
        Coefficients of each lane, see `soft_contact.coeffs_by_lane`.
    contact : array
        Contact code times the sign of the wall.
    basis : list of array
        Result of `polynomial_basis`.
    time : array
        Duration of any length, a constant for derivatives, in units of t.

    Returns
    -------
    ContactResponse
        Response of each lane, see `soft_contact.ContactResponse`.
    """
    max_step = lax.stop_gradient(coeffs.max_step)
    n_doublings = jnp.maximum(jnp.ceil(jnp.log2(lax.stop_gradient(time) / max_step)), 0.0)
    step = time * jnp.exp2(-n_doublings)
    step_powers = powers(step / max_step)
    _, p00_minus_1, p01, cos_response, sin_response, *harmonic_responses = (evaluate(row, step_powers) for row in basis)
    free_flow = 1.0 + p00_minus_1, p01, 1.0 + p00_minus_1 - 2.0 * coeffs.damping * p01
    angular_rates = [
        angular_rate for *_, angular_rate in soft_contact.harmonic_forces(coeffs, contact, 0.0 * time, 0.0 * time)
    ]
    responses = [(cos_response, sin_response, coeffs.frequency + 0.0 * time)]
    responses += zip(harmonic_responses[::2], harmonic_responses[1::2], angular_rates, strict=True)
    forced_flows = [
        (((x_cos, p01 - angular_rate * x_sin), (x_sin, angular_rate * x_cos)), _rotation(angular_rate * step))
        for x_cos, x_sin, angular_rate in responses
    ]

    def double(carry):
        n_remaining, *flows = carry
        free_flow, *forced_flows = flows
        next_flows = [flow.double_responses(coeffs.stiffness, free_flow, *flow_pair) for flow_pair in forced_flows]
        next_flows = [next_flows[0][0], *(flow_pair[1:] for flow_pair in next_flows)]
        return n_remaining - 1.0, *jax.tree.map(
            lambda next_value, value: choose(n_remaining > 0, next_value, value), next_flows, flows
        )

    start = (n_doublings, free_flow, *forced_flows)
    _, free_flow, *forced_flows = lax.while_loop(lambda carry: jnp.any(carry[0] > 0), double, start)
    return soft_contact.ContactResponse(
        free_flow, forced_flows[0][0], tuple(forced_flow for forced_flow, _ in forced_flows[1:])
    )


def _rotation(angle):
    """Return (cos - 1, sin) of an angle."""
    half_sine = jnp.sin(0.5 * angle)
    return -2.0 * half_sine * half_sine, jnp.sin(angle)
