"""Compute the free flight x'' + 2 gamma x' + x = A cos(omega t) (paper, (3)) exactly.

No formula divides by (1 - omega^2)^2 + 4 gamma^2 omega^2, the denominator of the forced response, or by
sqrt(1 - gamma^2). Inside a soft wall the coefficient of x is the stiffness 1 + k2. A stiffness of None stands for 1.

Over a step of at most 1 / max(omega, 1, 2 gamma) the flow is computed from its Taylor series. The evaluation of the
series needs only products. The series is valid at resonance, at critical damping and beyond. A longer flight is a short
step that is doubled repeatedly.
"""

import math
from fractions import Fraction
from functools import lru_cache
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax import lax
from jaxtyping import Float
from numpy.polynomial import Polynomial, chebyshev

from ..compiled.lane_arithmetic import choose
from ..scene import check

MAX_SCALED_STEP = 1.0  # longest step, in units of 1 / rate
SERIES_ORDER = 18  # MAX_SCALED_STEP^19 / 19! < 1e-17
DROPPED_DEGREES = 5  # degrees of a `FlowSeries` that `economise_series` removes


Scalars = Float[jax.Array, "..."]
FreeFlow = tuple[Scalars, Scalars, Scalars]  # p00, p01, p11
ForcedFlow = tuple[tuple[Scalars, Scalars], tuple[Scalars, Scalars]]  # x, v under the cosine and under the sine
CoefficientRows = Float[jax.Array, "_ ..."] | list[Float[jax.Array, "..."]]


class FlowSeries(NamedTuple):
    """Taylor coefficients of the `Propagator`, from the first nonzero power of t on, with the order as first axis.

    Attributes
    ----------
    p00_minus_1 : array or list of array
        Coefficients of p00 - 1, from t^2 on.
    p01 : array or list of array
        Coefficients of p01, from t on.
    cos_response : array or list of array
        Coefficients of the position under the force cos(omega t), from t^2 on.
    sin_response : array or list of array
        Coefficients of the position under the force sin(omega t), from t^3 on.
    """

    p00_minus_1: CoefficientRows
    p01: CoefficientRows
    cos_response: CoefficientRows
    sin_response: CoefficientRows


class Propagator(NamedTuple):
    """Propagator of a flight of a given duration, from its series.

    The matrix of the free flow is ((p00, p01), (-stiffness p01, p00 - 2 gamma p01)).

    Attributes
    ----------
    p00_minus_1 : array
        Entry p00 of the matrix, less 1.
    p01 : array
        Entry p01 of the matrix.
    cos_response : array
        Position after a start from rest under the force cos(omega t).
    sin_response : array
        Position after a start from rest under the force sin(omega t).
    cos_less_1 : array
        Cosine of the drive angle over the flight, less 1.
    sin_angle : array
        Sine of the drive angle over the flight.
    """

    p00_minus_1: Float[jax.Array, "*lanes"]
    p01: Float[jax.Array, "*lanes"]
    cos_response: Float[jax.Array, "*lanes"]
    sin_response: Float[jax.Array, "*lanes"]
    cos_less_1: Float[jax.Array, "*lanes"]
    sin_angle: Float[jax.Array, "*lanes"]


def max_angular_rate(frequency, damping, stiffness=None):
    """Return an upper bound on the rates of the drive and of the free oscillation.

    Parameters
    ----------
    frequency : array
        Drive frequency.
    damping : array
        Half of the coefficient of the velocity; the damping ratio for stiffness 1.
    stiffness : array, optional
        Stiffness. None stands for 1.

    Returns
    -------
    array
        Bound on the angular frequencies and decay rates, in radians per unit of t. At least 1 for stiffness 1.
    """
    natural_frequency = 1.0 if stiffness is None else lax.sqrt(stiffness)
    larger_frequency = choose(frequency > natural_frequency, frequency, natural_frequency)
    return choose(2.0 * damping > larger_frequency, 2.0 * damping, larger_frequency)


def spring_force(stiffness, x):
    """Return stiffness times x; None for the stiffness stands for 1."""
    return x if stiffness is None else stiffness * x


def flow_series(frequency, damping, stiffness=None):
    """Return the `FlowSeries` of an oscillator, from the derivatives at t = 0 that the equation of motion yields."""
    ones = jnp.ones_like(frequency * damping * (1.0 if stiffness is None else stiffness))
    zeros = jnp.zeros_like(ones)

    def next_derivatives(derivative_pairs, _):
        (drive_deriv, next_drive_deriv), (free_deriv, next_free_deriv), (forced_deriv, next_forced_deriv) = (
            derivative_pairs
        )
        next_pairs = (
            (next_drive_deriv, -(frequency * frequency) * drive_deriv),
            (next_free_deriv, -2.0 * damping * next_free_deriv - spring_force(stiffness, free_deriv)),
            (
                next_forced_deriv,
                drive_deriv - 2.0 * damping * next_forced_deriv - spring_force(stiffness, forced_deriv),
            ),
        )
        return next_pairs, (free_deriv, forced_deriv)

    _, (free_derivs, forced_derivs) = lax.scan(
        next_derivatives, ((ones, zeros), (zeros, ones), (zeros, zeros)), length=SERIES_ORDER + 1
    )

    def divide_by_factorials(values, order_shift):
        inverse_factorials = [1.0 / math.factorial(k + order_shift) for k in range(SERIES_ORDER + 1)]
        return values * jnp.array(inverse_factorials, values.dtype).reshape(-1, *[1] * ones.ndim)

    # p00' = -stiffness p01, sin_response' = omega cos_response
    return FlowSeries(
        -spring_force(stiffness, divide_by_factorials(free_derivs, 1)[1:-1]),
        divide_by_factorials(free_derivs, 0)[1:],
        divide_by_factorials(forced_derivs, 0)[2:],
        frequency * divide_by_factorials(forced_derivs, 1)[2:-1],
    )


def economise_series(series):
    """Return the `FlowSeries` with `DROPPED_DEGREES` fewer degrees.

    The result is valid for times from 0 to 1, the longest step. The Chebyshev terms of the polynomials beyond the
    remaining degree are omitted (economisation). The error is less than 1e-16 of the first coefficient, because the
    coefficients of a flow decrease like 1 / k!.
    """
    return FlowSeries(
        *(
            coefficient_rows if coefficient_rows is None else _economise_rows(coefficient_rows)
            for coefficient_rows in series
        )
    )


def _economise_rows(coefficient_rows):
    """Return the coefficient rows of a polynomial with `DROPPED_DEGREES` fewer degrees."""
    n_remaining_rows = len(coefficient_rows) - DROPPED_DEGREES
    remaining_rows = coefficient_rows[:n_remaining_rows]
    for row_weights, dropped_row in zip(
        _dropped_power_weights(n_remaining_rows), coefficient_rows[n_remaining_rows:], strict=True
    ):
        remaining_rows = (
            remaining_rows
            + jnp.array(row_weights, coefficient_rows.dtype).reshape(-1, *[1] * dropped_row.ndim) * dropped_row
        )
    return remaining_rows


@lru_cache(8)
def _dropped_power_weights(n_remaining_rows):
    """Return the contribution of each dropped power of t to the remaining coefficients."""
    weights_by_power, shifted_time = [], Polynomial(np.array([Fraction(-1), Fraction(2)]))
    for power in range(n_remaining_rows, n_remaining_rows + DROPPED_DEGREES):
        # exact: t^power in s = 2 t - 1, without the Chebyshev terms of higher degrees, in t again
        shifted_power = [Fraction(math.comb(power, k), 2**power) for k in range(power + 1)]
        chebyshev_coeffs = chebyshev.poly2cheb(np.array(shifted_power, object))[:n_remaining_rows]
        remaining_polynomial = Polynomial(chebyshev.cheb2poly(chebyshev_coeffs))(shifted_time)
        weights_by_power.append([float(coeff) for coeff in remaining_polynomial.coef])
    return weights_by_power


def step_propagator(series, frequency, time):
    """Return the `Propagator` over a time between 0 and `MAX_SCALED_STEP` / rate."""
    angle = frequency * time
    time_squared = time * time
    p00_minus_1, p01 = horner(series.p00_minus_1, time) * time_squared, horner(series.p01, time) * time
    return Propagator(p00_minus_1, p01, *drive_responses(series, time), cos_less_1(angle), sin_by_series(angle))


def drive_responses(series, time):
    """Return (cos_response, sin_response) of the `Propagator`."""
    time_squared = time * time
    return horner(series.cos_response, time) * time_squared, horner(series.sin_response, time) * (time_squared * time)


def horner(coefficients, time):
    """Evaluate a polynomial from its coefficients, the constant first: rows of an array, or a list."""
    value = coefficients[len(coefficients) - 1]
    for k in range(len(coefficients) - 2, -1, -1):
        value = value * time + coefficients[k]
    return value


def extend_jet(frequency, damping, stiffness, drive_derivs, extra_force_derivs, last_two_derivs):
    """Return (next two derivatives of the drive force, next two derivatives of x) from the last two of each.

    `extra_force_derivs` are two derivatives of an additional force, of the same orders as `drive_derivs`; None stands
    for zero.
    """
    minus_omega_squared, drag_factor = -(frequency * frequency), -2.0 * damping
    total_force, force_rate = (
        drive_deriv if extra_deriv is None else drive_deriv + extra_deriv
        for drive_deriv, extra_deriv in zip(drive_derivs, extra_force_derivs, strict=True)
    )
    next_deriv = total_force + (drag_factor * last_two_derivs[1] - spring_force(stiffness, last_two_derivs[0]))
    next_but_one_deriv = force_rate + (drag_factor * next_deriv - spring_force(stiffness, last_two_derivs[1]))
    return (drive_derivs[0] * minus_omega_squared, drive_derivs[1] * minus_omega_squared), (
        next_deriv,
        next_but_one_deriv,
    )


def cos_less_1(angle):
    """Return cos(angle) - 1 to rounding for angles up to `MAX_SCALED_STEP` in magnitude."""
    angle_squared = angle * angle
    value = lax.full_like(angle, -1.0 / math.factorial(18))
    for k in range(8, 0, -1):
        value = value * angle_squared + (-1.0) ** k / math.factorial(2 * k)
    return value * angle_squared


def sin_by_series(angle):
    """Return sin(angle) to rounding for angles up to `MAX_SCALED_STEP` in magnitude."""
    angle_squared = angle * angle
    value = lax.full_like(angle, 1.0 / math.factorial(17))
    for k in range(7, -1, -1):
        value = value * angle_squared + (-1.0) ** k / math.factorial(2 * k + 1)
    return value * angle


def rotate_phasor(cosine, sine, cos_less_1, sin_angle):
    """Rotate the phasor of the drive by an angle, from the cosine less 1 and the sine of the angle.

    Parameters
    ----------
    cosine : array
        Cosine of the drive angle.
    sine : array
        Sine of the drive angle.
    cos_less_1 : array
        Cosine of the rotation angle, less 1.
    sin_angle : array
        Sine of the rotation angle.

    Returns
    -------
    cosine : array
        Cosine after the rotation.
    sine : array
        Sine after the rotation.
    """
    return cosine + (cosine * cos_less_1 - sine * sin_angle), sine + (sine * cos_less_1 + cosine * sin_angle)


def rotation_by_angle(angle):
    """Return (cos - 1, sin) of any angle, without cancellation."""
    half_sine = lax.sin(0.5 * angle)
    return -2.0 * half_sine * half_sine, lax.sin(angle)


def rotate_phasor_by_small_angle(cosine, sine, angle):
    """Rotate the phasor of the drive by an angle of which the third power is below rounding."""
    return rotate_phasor(cosine, sine, -0.5 * angle * angle, angle)


def rotate_phasor_by_angle(cosine, sine, angle):
    """Rotate the phasor of the drive by any angle.

    Parameters
    ----------
    cosine : array
        Cosine of the drive angle.
    sine : array
        Sine of the drive angle.
    angle : array
        Rotation angle, in rad.

    Returns
    -------
    cosine : array
        Cosine after the rotation.
    sine : array
        Sine after the rotation.
    """
    angle_cosine, angle_sine = jnp.cos(angle), jnp.sin(angle)
    return cosine * angle_cosine - sine * angle_sine, sine * angle_cosine + cosine * angle_sine


def time_at_phasor(frequency, cosine, sine):
    """Return the time within half a period of 0 at which the drive has a phasor."""
    return lax.atan2(sine, cosine) / frequency


def fly(scene, state, time):
    """Compute the state after a free flight under A cos(omega t), without walls.

    Parameters
    ----------
    scene : Scene
        Scene of which amplitude, frequency and damping are used.
    state : State
        Initial state, of which x, v and phase are used. Broadcasts with the scene and the time.
    time : array
        Duration of the flight, at least 0, in units of t.

    Returns
    -------
    x : array
        Position.
    v : array
        Velocity.

    Raises
    ------
    ArgumentError
        If the drive has further terms.

    Notes
    -----
    The error is below 1e-13 (1 + t)^2 (abs x + abs v + A) for damping in [0, 5] and frequency in [0.05, 20].
    """
    check.require_harmonic_drive(scene, "fly")
    values = (scene.amplitude, scene.frequency, scene.damping, state.x, state.v, state.phase, time)
    values = jnp.broadcast_arrays(*(jnp.asarray(value, scene.dtype) for value in values))
    amplitude, frequency, damping, x, v, phase, time = values
    return apply_responses(
        flight_responses(frequency, damping, time), amplitude * jnp.cos(phase), amplitude * jnp.sin(phase), x, v
    )


def apply_responses(responses, force_cos, force_sin, x, v, stiffness=None):
    """Compute the state after a flight from its responses.

    The force is force_cos cos(omega t) - force_sin sin(omega t).

    Parameters
    ----------
    responses : tuple
        Result of `flight_responses`.
    force_cos : array
        Amplitude of the cosine of the force.
    force_sin : array
        Amplitude of the sine of the force.
    x : array
        Initial position.
    v : array
        Initial velocity.
    stiffness : array, optional
        Stiffness. None stands for 1.

    Returns
    -------
    x : array
        Position.
    v : array
        Velocity.
    """
    (p00, p01, p11), (cos_response, sin_response) = responses
    new_x = p00 * x + p01 * v + (force_cos * cos_response[0] - force_sin * sin_response[0])
    return new_x, p11 * v - p01 * spring_force(stiffness, x) + (
        force_cos * cos_response[1] - force_sin * sin_response[1]
    )


def flight_responses(frequency, damping, time):
    """Compute the matrix and the forced responses of a flight.

    Parameters
    ----------
    frequency : array
        Drive frequency.
    damping : array
        Damping ratio.
    time : array
        Duration of the flight, at least 0, in units of t. All arguments have one shape.

    Returns
    -------
    free_flow : tuple of array
        Entries (p00, p01, p11) of the matrix ((p00, p01), (-p01, p11)) of the free flow.
    forced_flow : tuple
        States (x, v) after a start from rest under the force cos(omega t), and under sin(omega t).
    """
    return doubling_responses(flow_series(frequency, damping), frequency, damping, time)[:2]


@jax.jit
def doubling_responses(series, frequency, damping, time, stiffness=None):
    """Compute the responses of a flight of any duration by doubling a short step.

    Parameters
    ----------
    series : FlowSeries
        Series of the flow.
    frequency : array
        Drive frequency.
    damping : array
        Damping ratio.
    time : array
        Duration of the flight, at least 0, in units of t.
    stiffness : array, optional
        Stiffness. None stands for 1.

    Returns
    -------
    free_flow : tuple of array
        Entries (p00, p01, p11) of the matrix ((p00, p01), (-stiffness p01, p11)) of the free flow.
    forced_flow : tuple
        States (x, v) after a start from rest under the force cos(omega t), and under sin(omega t).
    angle_pair : tuple of array
        Cosine less 1 and sine of the drive angle over the flight.
    """
    fastest_rate, zero = max_angular_rate(frequency, damping, stiffness), lax.full_like(time, 0.0)

    def needs_halving(carry):
        return jnp.any(carry[0] * fastest_rate > MAX_SCALED_STEP)

    def halve_step(carry):
        step_time, n_halvings = carry
        is_step_too_long = step_time * fastest_rate > MAX_SCALED_STEP
        return choose(is_step_too_long, 0.5 * step_time, step_time), n_halvings + choose(
            is_step_too_long, zero + 1.0, 0.0
        )

    _, n_doublings = lax.while_loop(needs_halving, halve_step, (lax.stop_gradient(time), zero))

    def double_step(carry):
        n_doublings_left, responses = carry
        next_responses = responses_after_doubling(stiffness, *responses)
        return n_doublings_left - 1.0, jax.tree.map(
            lambda updated, current: choose(n_doublings_left > 0, updated, current), next_responses, responses
        )

    initial_carry = (n_doublings, _step_responses(series, frequency, damping, time * jnp.exp2(-n_doublings)))
    return lax.while_loop(lambda carry: jnp.any(carry[0] > 0), double_step, initial_carry)[1]


def fixed_doubling_responses(series, frequency, damping, time, stiffness, n_doublings):
    """Return the `doubling_responses` with a fixed number of doublings, over at most 2^n_doublings longest steps."""
    responses = _step_responses(series, frequency, damping, time * 0.5**n_doublings)
    for _ in range(n_doublings):
        responses = responses_after_doubling(stiffness, *responses)
    return responses


def _step_responses(series, frequency, damping, time):
    """Return the `doubling_responses` over a time of at most one longest step."""
    propagator = step_propagator(series, frequency, time)
    free_flow = (
        1.0 + propagator.p00_minus_1,
        propagator.p01,
        1.0 + propagator.p00_minus_1 - 2.0 * damping * propagator.p01,
    )
    forced_flow = (
        (propagator.cos_response, propagator.p01 - frequency * propagator.sin_response),
        (propagator.sin_response, frequency * propagator.cos_response),
    )
    return free_flow, forced_flow, (propagator.cos_less_1, propagator.sin_angle)


def responses_after_doubling(stiffness, free_flow, forced_flow, drive_rotation):
    """Return the responses of a flight of twice the duration."""
    (p00, p01, p11), (cos_response, sin_response), (cos_less_1, sin_angle) = free_flow, forced_flow, drive_rotation
    cosine = 1.0 + cos_less_1

    def apply_free_flow(x, v):
        return p00 * x + p01 * v, p11 * v - p01 * spring_force(stiffness, x)

    (propagated_cos_x, propagated_cos_v), (propagated_sin_x, propagated_sin_v) = (
        apply_free_flow(*cos_response),
        apply_free_flow(*sin_response),
    )
    cos_response = (
        propagated_cos_x + cosine * cos_response[0] - sin_angle * sin_response[0],
        propagated_cos_v + cosine * cos_response[1] - sin_angle * sin_response[1],
    )
    sin_response = (
        propagated_sin_x + cosine * sin_response[0] + sin_angle * (old_cos_response := forced_flow[0])[0],
        propagated_sin_v + cosine * sin_response[1] + sin_angle * old_cos_response[1],
    )
    stiffness_times_p01_sq = p01 * spring_force(stiffness, p01)
    free_flow = (p00 * p00 - stiffness_times_p01_sq, p01 * (p00 + p11), p11 * p11 - stiffness_times_p01_sq)
    return free_flow, (cos_response, sin_response), (2.0 * cos_less_1 * (2.0 + cos_less_1), 2.0 * sin_angle * cosine)
