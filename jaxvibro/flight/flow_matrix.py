"""Compute flights of any duration and the derivatives of the final state with respect to the initial state."""

import jax.numpy as jnp

from . import flow
from .flight_coefficients import flow_coefficients
from .flow_dispatch import flow_of


def fly_with_matrix(scene, x, v, phase, time):
    """Compute the final state of a flight without walls and the matrix of the flight.

    Parameters
    ----------
    scene : Scene
        Scene.
    x : array
        Initial position.
    v : array
        Initial velocity.
    phase : array
        Initial phase of the drive, in rad.
    time : array
        Duration of the flight, at least 0, in units of t.

    Returns
    -------
    state : tuple of array
        Final position and velocity.
    matrix : tuple of array
        Derivative of the final state with respect to the initial state, see `apply_matrix`.
    """
    if scene.force is not None or scene.drive:
        coeffs = flow_coefficients(scene)
        return flow_of(coeffs).fly_with_matrix(coeffs, x, v, jnp.cos(phase), jnp.sin(phase), time)
    responses = flow.flight_responses(scene.frequency, scene.damping, time)
    force = scene.amplitude * jnp.cos(phase), scene.amplitude * jnp.sin(phase)
    return flow.apply_responses(responses, *force, x, v), responses[0]


def apply_matrix(matrix, x, v):
    """Multiply the matrix of a flight by a vector.

    Parameters
    ----------
    matrix : tuple of array
        Entries (p00, p01, p11) with p10 = -p01 for the linear oscillator, or (p00, p01, p11, p10).
    x : array
        First component of the vector.
    v : array
        Second component of the vector.

    Returns
    -------
    x : array
        First component of the product.
    v : array
        Second component of the product.
    """
    p00, p01, p11, *p10 = matrix
    return p00 * x + p01 * v, p11 * v + p10[0] * x if p10 else p11 * v - p01 * x


def matrix_by_rows(matrix):
    """Return the four entries of a matrix row by row.

    Parameters
    ----------
    matrix : tuple of array
        Matrix as in `apply_matrix`.

    Returns
    -------
    tuple of array
        Entries (p00, p01, p10, p11).
    """
    p00, p01, p11, *p10 = matrix
    return p00, p01, p10[0] if p10 else -p01, p11


def determinant(matrix):
    """Return the determinant of the matrix of a flight.

    Parameters
    ----------
    matrix : tuple of array
        Matrix as in `apply_matrix`.

    Returns
    -------
    array
        Determinant.
    """
    p00, p01, p11, *p10 = matrix
    return p00 * p11 - p01 * p10[0] if p10 else p00 * p11 + p01 * p01
