"""Compute the free flight x'' + 2 gamma x' + x = A cos(omega t) (paper, (3)) exactly.

No formula divides by D or by sqrt(1 - gamma^2). Inside a soft wall x is multiplied by a stiffness of 1 + k2. A
stiffness of None stands for 1.

Over a step that is short relative to the fastest of the rates omega, 1 and 2 gamma the flow is its own Taylor series.
The series needs only products, and holds at resonance, at critical damping and beyond. A longer flight is a short
step that is doubled repeatedly.
"""

import math
from fractions import Fraction
from functools import lru_cache
from typing import NamedTuple

import jax
import jax.numpy as jnp
from jax import lax
from jaxtyping import Float

from ..compiled.compiler_hints import choose
from ..scene import check

MAX_SCALED_STEP = 1.0  # longest step, in units of 1 / rate
SERIES_ORDER = 18  # MAX_SCALED_STEP^19 / 19! < 1e-17
DROPPED_DEGREES = 5  # degrees of a `FlowSeries` that `economise_series` removes


Scalars = Float[jax.Array, "..."]
FreeFlow = tuple[Scalars, Scalars, Scalars]  # p00, p01, p11
ForcedFlow = tuple[tuple[Scalars, Scalars], tuple[Scalars, Scalars]]  # x, v under the cosine and under the sine
CoefficientRows = Float[jax.Array, "_ ..."] | list[Float[jax.Array, "..."]]


class FlowSeries(NamedTuple):
    """Taylor coefficients of the `Propagator`, from the first nonzero power of t on, with the order as first axis."""

    p00_minus_1: CoefficientRows
    p01: CoefficientRows
    cos_response: CoefficientRows
    sin_response: CoefficientRows


class Propagator(NamedTuple):
    """Propagator of a flight of a given duration, from its series.

    The free flow has the matrix ((p00, p01), (-p01, p00 - 2 gamma p01)).

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


def max_rate(frequency, damping, stiffness=None):
    """Return an upper bound on the rates of the drive and of the free oscillation.

    Parameters
    ----------
    frequency : array
        Drive frequency.
    damping : array
        Damping ratio.
    stiffness : array, optional
        Stiffness. None stands for 1.

    Returns
    -------
    array
        Bound on the angular frequencies and decay rates, in radians per unit of t. At least 1 for stiffness 1.
    """
    natural_frequency = 1.0 if stiffness is None else lax.sqrt(stiffness)
    faster_rate = choose(frequency > natural_frequency, frequency, natural_frequency)
    return choose(2.0 * damping > faster_rate, 2.0 * damping, faster_rate)


def spring_force(stiffness, x):
    """Return the spring force at x."""
    return x if stiffness is None else stiffness * x


def flow_series(frequency, damping, stiffness=None):
    """Return the `FlowSeries` of an oscillator: derivatives at t = 0 from the equation of motion, over factorials."""
    ones = jnp.ones_like(frequency * damping * (1.0 if stiffness is None else stiffness))
    zeros = jnp.zeros_like(ones)

    def next_derivatives(pairs, _):
        (drive_deriv, next_drive), (free_deriv, next_free), (forced_deriv, next_forced) = pairs
        next_pairs = (
            (next_drive, -(frequency * frequency) * drive_deriv),
            (next_free, -2.0 * damping * next_free - spring_force(stiffness, free_deriv)),
            (next_forced, drive_deriv - 2.0 * damping * next_forced - spring_force(stiffness, forced_deriv)),
        )
        return next_pairs, (free_deriv, forced_deriv)

    _, (free_derivs, forced_derivs) = lax.scan(
        next_derivatives, ((ones, zeros), (zeros, ones), (zeros, zeros)), length=SERIES_ORDER + 1
    )

    def divide_by_factorials(values, shift):
        inverse_factorials = [1.0 / math.factorial(k + shift) for k in range(SERIES_ORDER + 1)]
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

    It holds for times from 0 to the longest step, which must be 1. The polynomials lose their Chebyshev terms beyond
    the remaining degree (economisation). The error is less than 1e-16 of the first coefficient, because the
    coefficients of a flow decrease like 1 / k!.
    """
    return FlowSeries(*(rows if rows is None else _economise(rows) for rows in series))


def _economise(rows):
    """Return the coefficient rows with `DROPPED_DEGREES` fewer degrees."""
    n_kept = len(rows) - DROPPED_DEGREES
    kept_rows = rows[:n_kept]
    for row_weights, row in zip(_economy_weights(n_kept), rows[n_kept:], strict=True):
        kept_rows = kept_rows + jnp.array(row_weights, rows.dtype).reshape(-1, *[1] * row.ndim) * row
    return kept_rows


@lru_cache(8)
def _economy_weights(n_kept):
    """Return the contribution of each dropped power of t to the remaining coefficients."""
    chebyshev = [[1], [-1, 2]]  # in t from 0 to 1
    for _ in range(n_kept - 2):
        previous, second_previous = chebyshev[-1], [*chebyshev[-2], 0, 0]
        chebyshev.append(
            [4 * a - 2 * b - c for a, b, c in zip([0, *previous], [*previous, 0], second_previous, strict=True)]
        )
    weights = []
    for power in range(n_kept, n_kept + DROPPED_DEGREES):
        kept_weights = [Fraction(0)] * n_kept
        for j, polynomial in enumerate(chebyshev):
            factor = Fraction(math.comb(2 * power, power - j) * (2 if j else 1), 4**power)
            kept_weights[: j + 1] = [
                weight + factor * value for weight, value in zip(kept_weights, polynomial, strict=False)
            ]
        weights.append([float(value) for value in kept_weights])
    return weights


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
    """Evaluate a polynomial, given by its coefficients from the constant on: rows of an array, or a list."""
    value = coefficients[len(coefficients) - 1]
    for k in range(len(coefficients) - 2, -1, -1):
        value = value * time + coefficients[k]
    return value


def extend_jet(frequency, damping, stiffness, drive_derivs, extra_derivs, jet):
    """Return (drive derivatives, jet): the next two derivatives of the drive force and of x from the last two of each.

    `extra_derivs` are the derivatives of another force; None stands for zero.
    """
    minus_omega_squared, drag_factor = -(frequency * frequency), -2.0 * damping
    force, force_rate = (
        drive_part if extra_part is None else drive_part + extra_part
        for drive_part, extra_part in zip(drive_derivs, extra_derivs, strict=True)
    )
    second_last_deriv = force + (drag_factor * jet[1] - spring_force(stiffness, jet[0]))
    last_deriv = force_rate + (drag_factor * second_last_deriv - spring_force(stiffness, jet[1]))
    return (drive_derivs[0] * minus_omega_squared, drive_derivs[1] * minus_omega_squared), (
        second_last_deriv,
        last_deriv,
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


def rotate(cosine, sine, cos_less_1, sin_angle):
    """Rotate the phasor of the drive by an angle given by its cosine less 1 and its sine.

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


def rotate_by_angle(cosine, sine, angle):
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
    check.require_one_harmonic(scene, "fly")
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
    rate_limit, zero = max_rate(frequency, damping, stiffness), lax.full_like(time, 0.0)

    def needs_halving(carry):
        return jnp.any(carry[0] * rate_limit > MAX_SCALED_STEP)

    def halve(carry):
        step_time, n_halvings = carry
        is_long = step_time * rate_limit > MAX_SCALED_STEP
        return choose(is_long, 0.5 * step_time, step_time), n_halvings + choose(is_long, zero + 1.0, 0.0)

    _, n_doublings = lax.while_loop(needs_halving, halve, (lax.stop_gradient(time), zero))

    def double(carry):
        n_left, responses = carry
        doubled = double_responses(stiffness, *responses)
        return n_left - 1.0, jax.tree.map(
            lambda updated, current: choose(n_left > 0, updated, current), doubled, responses
        )

    initial_carry = (n_doublings, _step_responses(series, frequency, damping, time * jnp.exp2(-n_doublings)))
    return lax.while_loop(lambda carry: jnp.any(carry[0] > 0), double, initial_carry)[1]


def fixed_doubling_responses(series, frequency, damping, time, stiffness, n_doublings):
    """Return the `doubling_responses` over at most 2^n_doublings longest steps."""
    responses = _step_responses(series, frequency, damping, time * 0.5**n_doublings)
    for _ in range(n_doublings):
        responses = double_responses(stiffness, *responses)
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


def double_responses(stiffness, free_flow, forced_flow, angle_pair):
    """Return the responses of a flight of twice the duration."""
    (p00, p01, p11), (cos_response, sin_response), (cos_less_1, sin_angle) = free_flow, forced_flow, angle_pair
    cosine = 1.0 + cos_less_1

    def apply_free_flow(x, v):
        return p00 * x + p01 * v, p11 * v - p01 * spring_force(stiffness, x)

    (cos_x, cos_v), (sin_x, sin_v) = apply_free_flow(*cos_response), apply_free_flow(*sin_response)
    cos_response = (
        cos_x + cosine * cos_response[0] - sin_angle * sin_response[0],
        cos_v + cosine * cos_response[1] - sin_angle * sin_response[1],
    )
    sin_response = (
        sin_x + cosine * sin_response[0] + sin_angle * (old_cos_response := forced_flow[0])[0],
        sin_v + cosine * sin_response[1] + sin_angle * old_cos_response[1],
    )
    coupling = p01 * spring_force(stiffness, p01)
    free_flow = (p00 * p00 - coupling, p01 * (p00 + p11), p11 * p11 - coupling)
    return free_flow, (cos_response, sin_response), (2.0 * cos_less_1 * (2.0 + cos_less_1), 2.0 * sin_angle * cosine)
