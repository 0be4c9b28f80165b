"""Taylor polynomials near a known time, as long as the order of the derivatives asked for."""

import math
from typing import NamedTuple

import jax
import jax.numpy as jnp
from jaxtyping import Float

from . import event
from .wall_motion import subtract, wall_jet_on_side


class ExpansionPoint(NamedTuple):
    """x, v and the drive's phasor at a time since the start; the time is a constant."""

    x: Float[jax.Array, "*lanes"]
    v: Float[jax.Array, "*lanes"]
    cosine: Float[jax.Array, "*lanes"]
    sine: Float[jax.Array, "*lanes"]
    time: Float[jax.Array, "*lanes"]


def wall_derivatives(coeffs, point, side, order):
    """Position of the wall on a side and its derivatives, one more than the order."""
    return wall_jet_on_side(coeffs, side, point.cosine, point.sine, order + 1)


def wall_state(wall_derivs, delay, order):
    """Position and velocity of a wall a time later, from its `wall_derivs`."""
    wall_position, wall_velocity = (
        evaluate_taylor(wall_derivs, delay, order),
        evaluate_taylor(wall_derivs[1:], delay, order),
    )
    return wall_position, jnp.zeros_like(delay) if wall_velocity is None else wall_velocity


def taylor_coefficients(derivatives):
    """Taylor coefficients from derivatives, None being zero."""
    return [
        None if derivative is None else derivative * (1.0 / math.factorial(k))
        for k, derivative in enumerate(derivatives)
    ]


def evaluate_taylor(derivatives, delay, order):
    """The Taylor polynomial of an order with these derivatives, a time later."""
    coefficients = taylor_coefficients(derivatives[: order + 1])
    value = coefficients[-1]
    for term in coefficients[-2::-1]:
        value = term if value is None else subtract(value * delay, None if term is None else -term)
    return value


def locate_root(derivatives, order):
    """The root near 0 of the polynomial with these derivatives, right to an order in its value at 0."""
    coefficients = taylor_coefficients(derivatives)
    delay = -coefficients[0] / coefficients[1]
    coefficients = [jnp.zeros_like(delay) if term is None else term for term in coefficients]
    for _ in range(math.ceil(math.log2(order + 1)) - 1):
        value, slope = event.horner_with_slope(coefficients, delay)
        delay = delay - value / slope
    return delay
