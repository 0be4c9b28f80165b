"""Where a flight of any time ends, and how that changes with where it begins."""

import jax.numpy as jnp

from . import flow
from .coefficients import framed
from .flows import flow_of


def of_scene(scene, x, v, phase, time):
    """`flow_of(frame).matrix` of a scene from a phase on, walls not looked at."""
    if scene.force is not None or scene.drive:
        built = framed(scene)
        return flow_of(built).matrix(built, x, v, jnp.cos(phase), jnp.sin(phase), time)
    responses = flow.responses(scene.frequency, scene.damping, time)
    force = scene.amplitude * jnp.cos(phase), scene.amplitude * jnp.sin(phase)
    return flow.flown(responses, *force, x, v), responses[0]


def through(matrix, x, v):
    """A matrix times a vector. matrix: (p00, p01, p11), p10 being -p01 as under spring and damper, or with p10 last."""
    p00, p01, p11, *more = matrix
    return p00 * x + p01 * v, p11 * v + more[0] * x if more else p11 * v - p01 * x


def by_rows(matrix):
    """The four entries of a matrix as `through` takes it, row by row."""
    p00, p01, p11, *more = matrix
    return p00, p01, more[0] if more else -p01, p11


def determinant(matrix):
    p00, p01, p11, *more = matrix
    return p00 * p11 - p01 * more[0] if more else p00 * p11 + p01 * p01
