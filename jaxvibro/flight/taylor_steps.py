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

from ..compiled.compiler_hints import choose, maximum, minimum, stage
from . import event, traced_force
from .drive import angular_rate, harmonic_phasor
from .series import Series, evaluate_polynomial
from .wall_motion import wall_jet

MIN_ORDER = event.N_TERMS + 2  # least degree of a step, which exceeds that of an event
CONTACT_FORCE_ORDER = event.N_TERMS + 4  # degree of the contact force
SPEED_SHARE = 2.0**-20  # fraction of the speed gained in the longest step, see `error_scale`
MAX_REMAINDER_SHARE = 1e-3  # largest remainder of the contact force over a step, relative to its terms


class FlightSeries(NamedTuple):
    """Taylor polynomial of the flight ahead.

    Attributes
    ----------
    terms : list of array
        Coefficients of x from the constant on.
    max_step : array
        Time up to which they hold, in units of t.
    remainder_bound : array
        Bound on the terms beyond those of an event, in lengths.
    """

    terms: list[Float[jax.Array, "*lanes"]]
    max_step: Float[jax.Array, "*lanes"]
    remainder_bound: Float[jax.Array, "*lanes"]


class ContactForceJet(NamedTuple):
    """Contact force on a wall near a time.

    Attributes
    ----------
    derivatives : list of array
        Contact force and its derivatives, as many as an event has terms.
    remainder_bound : array
        Bound on the further terms over a step, and on their slope over as many terms.
    max_step : array
        Longest step for which this bound is small.
    """

    derivatives: list[Float[jax.Array, "*lanes"]]
    remainder_bound: Float[jax.Array, "*lanes"]
    max_step: Float[jax.Array, "*lanes"]


def step_order(coeffs):
    """Return the degree of a step's polynomial, the cheapest for its tolerance."""
    return max(MIN_ORDER, math.ceil(1.0 - 0.5 * math.log(coeffs.force_law.tolerance)))


def motion_coefficients(coeffs, x, v, cosine, sine, order):
    """Return the Taylor coefficients of x up to an order, at a phasor of the drive."""
    time = stage(_drive_time, coeffs.frequency, cosine, sine)
    drive_terms = _drive_coefficients(coeffs, cosine, sine, order - 1)
    return traced_force.motion_coefficients(coeffs.force_law, time, x, v, drive_terms, order)


def _drive_coefficients(coeffs, cosine, sine, n_terms):
    """Return the first Taylor coefficients of the drive's force."""
    total_force = traced_force.drive_coefficients(coeffs.amplitude, coeffs.frequency, cosine, sine, n_terms)
    for term in coeffs.drive_terms:
        term_force = traced_force.drive_coefficients(
            term.amplitude, angular_rate(term, coeffs.frequency), *harmonic_phasor(term, cosine, sine), n_terms
        )
        total_force = [a + b for a, b in zip(total_force, term_force, strict=True)]
    return total_force


def _drive_time(frequency, cosine, sine):
    """Return the time at which the drive has a phasor."""
    return lax.atan2(sine, cosine) / frequency


def derivatives(coeffs, x, v, cosine, sine, order):
    """Return x and its derivatives up to an order."""
    return as_derivatives(motion_coefficients(coeffs, x, v, cosine, sine, order))


def force_gradient(coeffs, x, v, cosine, sine):
    """Return the derivative of the force with respect to x."""
    time = Series(None, stage(_drive_time, coeffs.frequency, cosine, sine))
    gradient = traced_force.force_series(
        coeffs.force_law, time, Series(lambda series, k: None, x, 1.0), Series(None, v)
    )[1]
    return jnp.zeros_like(x) if gradient is None else gradient + jnp.zeros_like(x)


def as_derivatives(terms):
    """Return derivatives from Taylor coefficients."""
    return [term * float(math.factorial(k)) for k, term in enumerate(terms)]


def contact_force_jet(coeffs, wall, cosine, sine):
    """Return the `ContactForceJet` on a wall."""
    return stage(
        _contact_force_jet, coeffs.max_step, contact_force_terms(coeffs, wall, cosine, sine, CONTACT_FORCE_ORDER)
    )


def _contact_force_jet(max_step, terms):
    """Return the `ContactForceJet` of Taylor coefficients."""
    magnitudes, last_terms = [lax.abs(term) for term in terms[: event.N_TERMS]], terms[event.N_TERMS :]
    magnitude, step, remainder_bound = (
        reduce(maximum, magnitudes) + float(jnp.finfo(magnitudes[0].dtype).tiny),
        max_step + 0.0 * magnitudes[0],
        0.0,
    )
    for k, term in enumerate(last_terms, event.N_TERMS):
        step = minimum(step, lax.exp(lax.log(MAX_REMAINDER_SHARE * magnitude / lax.abs(term)) / float(k)))
    for k, term in enumerate(last_terms, event.N_TERMS):
        remainder_bound = remainder_bound + (2.0 * k / event.N_TERMS) * (lax.abs(term) * step**k)
    return ContactForceJet(as_derivatives(terms[: event.N_TERMS]), remainder_bound, step)


def contact_force_terms(coeffs, wall, cosine, sine, order):
    """Return the Taylor coefficients of the contact force on a wall up to an order."""
    wall_derivs = wall_jet(wall, coeffs.frequency, cosine, sine, order + 2)
    zero = jnp.zeros_like(cosine)
    wall_terms = [
        zero if derivative is None else derivative * (1.0 / math.factorial(k)) + zero
        for k, derivative in enumerate(wall_derivs)
    ]
    x = Series(lambda series, k: wall_terms[k], wall_terms[0])
    v = Series(lambda series, k: (k + 1.0) * wall_terms[k + 1], wall_terms[1])
    time = Series(lambda series, k: None, stage(_drive_time, coeffs.frequency, cosine, sine), 1.0)
    force_series = traced_force.force_series(coeffs.force_law, time, x, v)
    drive_terms = _drive_coefficients(coeffs, cosine, sine, max(order + 1, 2))
    terms = []
    for k in range(order + 1):
        term = drive_terms[k] - (k + 2.0) * (k + 1.0) * wall_terms[k + 2]
        terms.append(term if force_series[k] is None else term + force_series[k])
    return terms


def flight_series(coeffs, x, v, cosine, sine):
    """Return the `FlightSeries` of lanes."""
    degree = step_order(coeffs)
    terms = motion_coefficients(coeffs, x, v, cosine, sine, degree)
    length_scale = error_scale(coeffs, x, v, 2.0 * terms[2])
    max_step = stage(
        _max_step,
        terms[-2],
        terms[-1],
        coeffs.max_step + 0.0 * x,
        length_scale,
        order=degree,
        tolerance=coeffs.force_law.tolerance,
    )
    return FlightSeries(
        terms, max_step, stage(_remainder_bound, terms, max_step, length_scale, tolerance=coeffs.force_law.tolerance)
    )


def error_scale(coeffs, x, v, acceleration):
    """Return the length to which the error of a step is relative.

    For a mass at rest at 0 in a scene without length scale it is a small fraction of the speed gained in the longest
    step.
    """
    return maximum(
        maximum(lax.abs(x), lax.abs(v)),
        maximum(coeffs.length_scale, SPEED_SHARE * coeffs.max_step * lax.abs(acceleration)),
    )


def step_displacement(v, acceleration, step):
    """Return the order of magnitude of the displacement in a step.

    A mass that approaches an equilibrium on a wall is soon closer to it than the tolerance of the scene's size. Unless
    its own displacement counts then, its steps would become ever shorter.
    """
    return step * maximum(lax.abs(v), step * lax.abs(acceleration))


def _max_step(penultimate_term, last_term, max_step, length_scale, order, tolerance):
    """Return a step for which the error of x, from the last terms, and that of v over as many steps are tolerable."""
    for k, term in ((order - 1, penultimate_term), (order, last_term)):
        error_ratio = tolerance * length_scale / lax.abs(term)
        log_step_x, log_step_v = lax.log(error_ratio) / float(k), lax.log(error_ratio / k) / (k - 1.0)
        max_step = minimum(max_step, lax.exp(minimum(log_step_x, log_step_v)))
    return max_step


def error_bound(displacement, error, length_scale, tolerance):
    """Bound the error of a step's polynomial.

    The bound is twice the tolerance times the length scale. A motion smaller than this, `displacement` (see
    `step_displacement`), is bounded by the larger of its estimated error and the tolerance times the motion.
    """
    return 2.0 * choose(
        displacement < tolerance * length_scale, maximum(tolerance * displacement, error), tolerance * length_scale
    )


def _remainder_bound(terms, step, length_scale, tolerance):
    """Return a bound on the terms beyond an event's, and on their slope over as many terms.

    The bound includes the truncation error.
    """
    displacement, degree = step_displacement(terms[1], 2.0 * terms[2], step), len(terms) - 1
    error = maximum(lax.abs(terms[-2]) * step ** (degree - 1), lax.abs(terms[-1]) * step**degree)
    bound, step_power = error_bound(displacement, error, length_scale, tolerance), step**event.N_TERMS
    for k in range(event.N_TERMS, len(terms)):
        bound = bound + (k / event.N_TERMS) * (lax.abs(terms[k]) * step_power)
        step_power = step_power * step
    return bound


def sampling_step(coeffs, step):
    """Return the step up to which the polynomial of a step is correct to 1e-4 of its size: the step itself."""
    return step


def step_increments(coeffs, x, v, cosine, sine, step, terms=None):
    """Return (increment of x, increment of v) after at most one step; `terms` are the coefficients of x if known."""
    if terms is None:
        terms = motion_coefficients(coeffs, x, v, cosine, sine, step_order(coeffs))
    return stage(_evaluate_increments, terms, step)


def _evaluate_increments(terms, step):
    """Return the increments of x and v from the coefficients of x."""
    x = evaluate_polynomial(terms[1:], step) * step
    return x, evaluate_polynomial([k * term for k, term in enumerate(terms)][2:], step) * step
