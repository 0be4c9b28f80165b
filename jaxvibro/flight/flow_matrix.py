"""Where a flight of any time ends, and how that changes with where it begins."""

import jax.numpy as jnp

from . import flow
from .coefficients import flow_coefficients
from .flows import flow_of


def fly_with_matrix(scene, x, v, phase, time):
    """`flow_of(frame).matrix` of a scene from a phase on, walls not looked at."""
    if scene.force is not None or scene.drive:
        coeffs = flow_coefficients(scene)
        return flow_of(coeffs).fly_with_matrix(coeffs, x, v, jnp.cos(phase), jnp.sin(phase), time)
    responses = flow.flight_responses(scene.frequency, scene.damping, time)
    force = scene.amplitude * jnp.cos(phase), scene.amplitude * jnp.sin(phase)
    return flow.apply_responses(responses, *force, x, v), responses[0]


def apply_matrix(matrix, x, v):
    """A matrix times a vector. matrix: (p00, p01, p11), p10 being -p01 as under spring and damper, or with p10 last."""
    p00, p01, p11, *p10 = matrix
    return p00 * x + p01 * v, p11 * v + p10[0] * x if p10 else p11 * v - p01 * x


def matrix_by_rows(matrix):
    """The four entries of a matrix as `apply_matrix` takes it, row by row."""
    p00, p01, p11, *p10 = matrix
    return p00, p01, p10[0] if p10 else -p01, p11


def determinant(matrix):
    p00, p01, p11, *p10 = matrix
    return p00 * p11 - p01 * p10[0] if p10 else p00 * p11 + p01 * p01
