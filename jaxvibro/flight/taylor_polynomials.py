"""Evaluate Taylor polynomials near a known time.

The degree of the polynomials is the order of the derivatives that the caller needs.
"""

import math
from typing import NamedTuple

import jax
import jax.numpy as jnp
from jaxtyping import Float

from . import event_certificates
from .wall_motion import subtract_optional, wall_jet_on_side


class ExpansionPoint(NamedTuple):
    """State at which a motion is expanded.

    Attributes
    ----------
    x : array
        Position.
    v : array
        Velocity.
    cosine : array
        Cosine of the drive angle.
    sine : array
        Sine of the drive angle.
    time : array
        Time since the start, a constant.
    """

    x: Float[jax.Array, "*lanes"]
    v: Float[jax.Array, "*lanes"]
    cosine: Float[jax.Array, "*lanes"]
    sine: Float[jax.Array, "*lanes"]
    time: Float[jax.Array, "*lanes"]


def wall_derivatives(coeffs, expansion_point, side, order):
    """Compute the derivatives of a wall's position.

    Parameters
    ----------
    coeffs : FlowCoefficients
        Coefficients of the scene.
    expansion_point : ExpansionPoint
        Point of expansion.
    side : array
        Side of the wall, -1 or 1.
    order : int
        Order of the Taylor polynomials.

    Returns
    -------
    list of array or None
        Position and its derivatives up to order + 1. None stands for zero.
    """
    return wall_jet_on_side(coeffs, side, expansion_point.cosine, expansion_point.sine, order + 1)


def wall_state(wall_derivs, delay, order):
    """Compute the state of a wall after a delay.

    Parameters
    ----------
    wall_derivs : list of array or None
        Result of `wall_derivatives`.
    delay : array
        Time since the point of expansion.
    order : int
        Order of the Taylor polynomials.

    Returns
    -------
    position : array
        Position of the wall.
    velocity : array
        Velocity of the wall.
    """
    wall_position, wall_velocity = (
        evaluate_taylor(wall_derivs, delay, order),
        evaluate_taylor(wall_derivs[1:], delay, order),
    )
    return wall_position, jnp.zeros_like(delay) if wall_velocity is None else wall_velocity


def taylor_coefficients(derivatives):
    """Return Taylor coefficients from derivatives; None stands for zero."""
    return [
        None if derivative is None else derivative * (1.0 / math.factorial(k))
        for k, derivative in enumerate(derivatives)
    ]


def evaluate_taylor(derivatives, delay, order):
    """Evaluate a Taylor polynomial.

    Parameters
    ----------
    derivatives : list of array or None
        Derivatives from the value on. None stands for zero.
    delay : array
        Time since the point of expansion.
    order : int
        Degree of the polynomial.

    Returns
    -------
    array or None
        Value of the polynomial. None if all derivatives are zero.
    """
    coefficients = taylor_coefficients(derivatives[: order + 1])
    value = coefficients[-1]
    for term in coefficients[-2::-1]:
        value = term if value is None else subtract_optional(value * delay, None if term is None else -term)
    return value


def locate_root_near_zero(derivatives, order):
    """Locate the root near 0 of a polynomial.

    Parameters
    ----------
    derivatives : list of array or None
        Derivatives at 0 from the value on. None stands for zero.
    order : int
        Order in the value at 0 up to which the root is correct.

    Returns
    -------
    array
        Root.
    """
    coefficients = taylor_coefficients(derivatives)
    root = -coefficients[0] / coefficients[1]
    coefficients = [jnp.zeros_like(root) if term is None else term for term in coefficients]
    for _ in range(math.ceil(math.log2(order + 1)) - 1):
        value, slope = event_certificates.horner_with_slope(coefficients, root)
        root = root - value / slope
    return root
