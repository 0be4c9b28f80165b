"""Where a flight of any time ends, and how that changes with where it begins."""

import jax
import jax.numpy as jnp

from . import drive, flow, force_flow
from .coefficients import framed


def after(frame, x, v, cosine, sine, time):
    """(x, v) a time >= 0 after a start where the drive is at this cosine and sine."""
    flown = _sprung if frame.law is None else force_flow.fly
    return flown(frame, x, v, cosine, sine, time)[:2]


def with_phasor(frame, x, v, cosine, sine, time):
    """(x, v, the drive's cosine and sine) a time after."""
    if frame.law is not None:
        return force_flow.fly(frame, x, v, cosine, sine, time)
    x, v, angle, _ = _sprung(frame, x, v, cosine, sine, time)
    return x, v, *flow.turn(cosine, sine, *angle)


def with_matrix(frame, x, v, cosine, sine, time):
    """((x, v) a time after; how they change with x, v at the start, a matrix as `through` takes it)."""
    if frame.law is not None:
        return _slopes(frame, x, v, cosine, sine, time)
    x, v, _, matrix = _sprung(frame, x, v, cosine, sine, time)
    return (x, v), matrix


def _sprung(frame, x, v, cosine, sine, time):
    """(x, v, the drive's turn, the free flow's matrix) a time after, under spring and damper."""
    free, forced, angle = flow.doubled(frame.series, frame.frequency, frame.damping, time)
    x, v = flow.flown((free, forced), frame.force * cosine, frame.force * sine, x, v)
    if frame.terms:
        more = drive.responses(frame.terms, frame.frequency, frame.damping, time)
        x, v = _driven(frame, more, cosine, sine, x, v)
    return x, v, angle, free


def _driven(frame, responses, cosine, sine, x, v):
    """x and v with what the drive's further terms add to them."""
    dx, dv = drive.forced(frame.terms, responses, frame.frequency, cosine, sine)
    return x + dx, v + dv


def _slopes(frame, x, v, cosine, sine, time):
    def function(x, v):
        return force_flow.fly(frame, x, v, cosine, sine, time)[:2]

    def along(by_x, by_v):
        return jax.jvp(function, (x, v), (by_x + 0.0 * x, by_v + 0.0 * v))

    unit = jnp.eye(2, dtype=jnp.result_type(x))
    state, (by_x, by_v) = jax.vmap(along, out_axes=(None, 0))(unit[0], unit[1])
    return state, (by_x[0], by_x[1], by_v[1], by_v[0])


def repeated(frame, span):
    """(x, v, cosine, sine) -> the same a time after, for the same time again and again."""
    if frame.law is not None:
        return lambda *place: force_flow.fly(frame, *place, span)
    free, forced, (versed, sined) = flow.doubled(frame.series, frame.frequency, frame.damping, span)
    more = drive.responses(frame.terms, frame.frequency, frame.damping, span)

    def onwards(x, v, cosine, sine):
        x, v = flow.flown((free, forced), frame.force * cosine, frame.force * sine, x, v)
        if frame.terms:
            x, v = _driven(frame, more, cosine, sine, x, v)
        return x, v, *flow.turn(cosine, sine, versed, sined)

    return onwards


def of_scene(scene, x, v, phase, time):
    """`with_matrix` of a scene from a phase on, walls not looked at."""
    if scene.force is not None or scene.drive:
        return with_matrix(framed(scene), x, v, jnp.cos(phase), jnp.sin(phase), time)
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
