"""Step the flight under a user-defined force by Taylor polynomials.

A step is as long as the last terms of its polynomial allow (Jorba and Zou 2005).
"""

import math
from functools import reduce
from typing import NamedTuple

import jax
import jax.numpy as jnp
from jax import lax
from jaxtyping import Float

from ..compiled.lane_arithmetic import call_without_inlining, choose, maximum, minimum
from . import event_certificates, flow, jaxpr_series
from .further_drive_terms import harmonic_phasor, term_angular_rate
from .power_series import Series, add_coefficients
from .wall_motion import wall_jet

MIN_ORDER = event_certificates.N_TERMS + 2  # least degree of a step, which exceeds that of an event
CONTACT_FORCE_ORDER = event_certificates.N_TERMS + 4  # degree of the contact force
SPEED_SHARE = 2.0**-20  # fraction of the speed gained in the longest step, see `error_scale`
MAX_REMAINDER_SHARE = 1e-3  # largest remainder of the contact force over a step, relative to its terms


class FlightSeries(NamedTuple):
    """Taylor polynomial of the flight ahead.

    Attributes
    ----------
    terms : list of array
        Coefficients of x from the constant on.
    max_step : array
        Time up to which the polynomial holds, in units of t.
    remainder_bound : array
        Bound on the sum of the terms beyond the first `event_certificates.N_TERMS`, in units of length.
    """

    terms: list[Float[jax.Array, "*lanes"]]
    max_step: Float[jax.Array, "*lanes"]
    remainder_bound: Float[jax.Array, "*lanes"]


class ContactForceJet(NamedTuple):
    """Contact force on a wall near a time.

    Attributes
    ----------
    derivatives : list of array
        Contact force and its time derivatives, `event_certificates.N_TERMS` entries.
    remainder_bound : array
        Bound on the sum of the omitted terms over a step, and on its slope divided by `event_certificates.N_TERMS`.
    max_step : array
        Longest step for which this bound is small.
    """

    derivatives: list[Float[jax.Array, "*lanes"]]
    remainder_bound: Float[jax.Array, "*lanes"]
    max_step: Float[jax.Array, "*lanes"]


def step_polynomial_degree(coeffs):
    """Return the degree of a step's polynomial that is most efficient for the tolerance of the user-defined force."""
    return max(MIN_ORDER, math.ceil(1.0 - 0.5 * math.log(coeffs.user_force.tolerance)))


def motion_coefficients(coeffs, x, v, cosine, sine, order):
    """Return the Taylor coefficients of x up to an order, at a phasor of the drive."""
    time = call_without_inlining(flow.time_at_phasor, coeffs.frequency, cosine, sine)
    drive_force_terms = _drive_coefficients(coeffs, cosine, sine, order - 1)
    return jaxpr_series.motion_coefficients(coeffs.user_force, time, x, v, drive_force_terms, order)


def _drive_coefficients(coeffs, cosine, sine, n_terms):
    """Return the first Taylor coefficients of the total force of the drive."""
    total_force_terms = jaxpr_series.drive_coefficients(coeffs.amplitude, coeffs.frequency, cosine, sine, n_terms)
    for drive_term in coeffs.drive_terms:
        term_force_terms = jaxpr_series.drive_coefficients(
            drive_term.amplitude,
            term_angular_rate(drive_term, coeffs.frequency),
            *harmonic_phasor(drive_term, cosine, sine),
            n_terms,
        )
        total_force_terms = [
            total_coeff + term_coeff
            for total_coeff, term_coeff in zip(total_force_terms, term_force_terms, strict=True)
        ]
    return total_force_terms


def position_derivatives(coeffs, x, v, cosine, sine, order):
    """Return x and its derivatives up to an order."""
    return derivatives_from_terms(motion_coefficients(coeffs, x, v, cosine, sine, order))


def force_derivative_in_x(coeffs, x, v, cosine, sine):
    """Return the derivative of the force with respect to x."""
    time_series = Series(None, call_without_inlining(flow.time_at_phasor, coeffs.frequency, cosine, sine))
    derivative_in_x = jaxpr_series.force_series(
        coeffs.user_force, time_series, Series(lambda series, k: None, x, 1.0), Series(None, v)
    )[1]
    return jnp.zeros_like(x) if derivative_in_x is None else derivative_in_x + jnp.zeros_like(x)


def derivatives_from_terms(terms):
    """Return the derivatives that belong to Taylor coefficients."""
    return [term * float(math.factorial(k)) for k, term in enumerate(terms)]


def contact_force_jet(coeffs, wall, cosine, sine):
    """Return the `ContactForceJet` on a wall."""
    return call_without_inlining(
        _contact_force_jet, coeffs.max_step, contact_taylor_terms(coeffs, wall, cosine, sine, CONTACT_FORCE_ORDER)
    )


def _contact_force_jet(max_step, terms):
    """Return the `ContactForceJet` from the Taylor coefficients of the contact force."""
    term_magnitudes, remainder_terms = (
        [lax.abs(term) for term in terms[: event_certificates.N_TERMS]],
        terms[event_certificates.N_TERMS :],
    )
    largest_magnitude, max_jet_step, remainder_bound = (
        reduce(maximum, term_magnitudes) + float(jnp.finfo(term_magnitudes[0].dtype).tiny),
        max_step + 0.0 * term_magnitudes[0],
        0.0,
    )
    for k, term in enumerate(remainder_terms, event_certificates.N_TERMS):
        max_jet_step = minimum(
            max_jet_step, lax.exp(lax.log(MAX_REMAINDER_SHARE * largest_magnitude / lax.abs(term)) / float(k))
        )
    for k, term in enumerate(remainder_terms, event_certificates.N_TERMS):
        remainder_bound = remainder_bound + (2.0 * k / event_certificates.N_TERMS) * (lax.abs(term) * max_jet_step**k)
    return ContactForceJet(derivatives_from_terms(terms[: event_certificates.N_TERMS]), remainder_bound, max_jet_step)


def contact_taylor_terms(coeffs, wall, cosine, sine, order):
    """Return the Taylor coefficients of the contact force on a wall up to an order."""
    wall_derivs = wall_jet(wall, coeffs.frequency, cosine, sine, order + 2)
    zero = jnp.zeros_like(cosine)
    wall_position_terms = [
        zero if derivative is None else derivative * (1.0 / math.factorial(k)) + zero
        for k, derivative in enumerate(wall_derivs)
    ]
    x_series = Series(lambda series, k: wall_position_terms[k], wall_position_terms[0])
    v_series = Series(lambda series, k: (k + 1.0) * wall_position_terms[k + 1], wall_position_terms[1])
    time_series = Series(
        lambda series, k: None, call_without_inlining(flow.time_at_phasor, coeffs.frequency, cosine, sine), 1.0
    )
    force_series = jaxpr_series.force_series(coeffs.user_force, time_series, x_series, v_series)
    drive_force_terms = _drive_coefficients(coeffs, cosine, sine, max(order + 1, 2))
    terms = []
    for k in range(order + 1):
        term = drive_force_terms[k] - (k + 2.0) * (k + 1.0) * wall_position_terms[k + 2]
        terms.append(add_coefficients(term, force_series[k]))
    return terms


def flight_series(coeffs, x, v, cosine, sine):
    """Return the `FlightSeries` of lanes."""
    degree = step_polynomial_degree(coeffs)
    terms = motion_coefficients(coeffs, x, v, cosine, sine, degree)
    length_scale = error_scale(coeffs, x, v, 2.0 * terms[2])
    max_step = call_without_inlining(
        _max_step,
        terms[-2],
        terms[-1],
        coeffs.max_step + 0.0 * x,
        length_scale,
        order=degree,
        tolerance=coeffs.user_force.tolerance,
    )
    return FlightSeries(
        terms,
        max_step,
        call_without_inlining(_remainder_bound, terms, max_step, length_scale, tolerance=coeffs.user_force.tolerance),
    )


def error_scale(coeffs, x, v, acceleration):
    """Return the length to which the error of a step is relative.

    For a mass at rest at 0 in a scene without a length scale, the result is a small fraction of the speed gained in the
    longest step.
    """
    return maximum(
        maximum(lax.abs(x), lax.abs(v)),
        maximum(coeffs.length_scale, SPEED_SHARE * coeffs.max_step * lax.abs(acceleration)),
    )


def step_displacement(v, acceleration, step):
    """Return the order of magnitude of the displacement in a step.

    A mass that approaches an equilibrium on a wall is soon closer to the equilibrium than the tolerance times the
    length scale. Steps that were certified with this tolerance would then become ever shorter. Therefore
    `step_error_bound` depends on the displacement.
    """
    return step * maximum(lax.abs(v), step * lax.abs(acceleration))


def _max_step(penultimate_term, last_term, max_step, length_scale, order, tolerance):
    """Return a step for which the last terms of x and of v remain within the tolerance."""
    for k, term in ((order - 1, penultimate_term), (order, last_term)):
        error_ratio = tolerance * length_scale / lax.abs(term)
        log_step_x, log_step_v = lax.log(error_ratio) / float(k), lax.log(error_ratio / k) / (k - 1.0)
        max_step = minimum(max_step, lax.exp(minimum(log_step_x, log_step_v)))
    return max_step


def step_error_bound(displacement, estimated_error, length_scale, tolerance):
    """Bound the error of a step's polynomial.

    The bound is twice the tolerance times the length scale. If the `displacement` (see `step_displacement`) is smaller
    than the tolerance times the length scale, the bound is twice the larger of the estimated error and the tolerance
    times the displacement.
    """
    return 2.0 * choose(
        displacement < tolerance * length_scale,
        maximum(tolerance * displacement, estimated_error),
        tolerance * length_scale,
    )


def _remainder_bound(terms, step, length_scale, tolerance):
    """Return the `remainder_bound` of a `FlightSeries`, including the truncation error.

    The result bounds the sum of the terms beyond the first `event_certificates.N_TERMS`, and the slope of this sum
    divided by `event_certificates.N_TERMS`."""
    displacement, degree = step_displacement(terms[1], 2.0 * terms[2], step), len(terms) - 1
    estimated_error = maximum(lax.abs(terms[-2]) * step ** (degree - 1), lax.abs(terms[-1]) * step**degree)
    remainder_bound, step_power = (
        step_error_bound(displacement, estimated_error, length_scale, tolerance),
        step**event_certificates.N_TERMS,
    )
    for k in range(event_certificates.N_TERMS, len(terms)):
        remainder_bound = remainder_bound + (k / event_certificates.N_TERMS) * (lax.abs(terms[k]) * step_power)
        step_power = step_power * step
    return remainder_bound


def sampling_step(coeffs, step):
    """Return the time up to which the polynomial of a step has a relative error of at most 1e-4: the whole step."""
    return step


def step_increments(coeffs, x, v, cosine, sine, step, position_terms=None):
    """Return (increment of x, increment of v) after at most one step.

    `position_terms` are the Taylor coefficients of x, None if they are unknown.
    """
    if position_terms is None:
        position_terms = motion_coefficients(coeffs, x, v, cosine, sine, step_polynomial_degree(coeffs))
    return call_without_inlining(_evaluate_increments, position_terms, step)


def _evaluate_increments(position_terms, step):
    """Return the increments of x and v from the coefficients of x."""
    x_increment = flow.horner(position_terms[1:], step) * step
    return x_increment, flow.horner([k * term for k, term in enumerate(position_terms)][2:], step) * step
