"""Flights and walls near a known time, as Taylor polynomials as long as the order of the derivatives asked for.

frame: as the lanes feel it; within a soft wall x is counted from the wall, and bias is what `soft_contact.biases` says.
"""

import math
from typing import NamedTuple

import jax
import jax.numpy as jnp
from jaxtyping import Float

from . import drive, event, flow, force_flow
from .wall import course, less, picked


class Now(NamedTuple):
    """x, v and the drive's phasor at a time since the start; the time is a constant."""

    x: Float[jax.Array, "*lanes"]
    v: Float[jax.Array, "*lanes"]
    cosine: Float[jax.Array, "*lanes"]
    sine: Float[jax.Array, "*lanes"]
    time: Float[jax.Array, "*lanes"]


def jet(frame, now, order, bias=()):
    """x and its derivatives, one more than the order."""
    if frame.law is not None:
        return force_flow.derivatives(frame, now.x, now.v, now.cosine, now.sine, order + 1)
    return free(frame, now.x, now.v, pulls(frame, now, order, bias))


def pulls(frame, now, order, bias=()):
    """The force and its derivatives, one less than the order."""
    found = [frame.force * now.cosine, -(frame.force * now.sine) * frame.frequency]
    while len(found) < order:
        found.append(-(frame.frequency * frame.frequency) * found[-2])
    more = drive.pushed(frame.terms, frame.frequency, now.cosine, now.sine, [*bias, *[None] * order][:order])
    return [own if each is None else own + each for own, each in zip(found[:order], more, strict=False)]


def free(frame, x, v, pulls):
    """x and its derivatives under these forces."""
    found = [x, v]
    for pull in pulls:
        found.append(pull - flow.pulled(frame.stiffness, found[-2]) - 2.0 * frame.damping * found[-1])
    return found


def back(frame, now, x, v, late, order, bias=()):
    """x and v now of a flight that is at x, v a little later."""
    if frame.law is not None:
        phasor = flow.rotated(now.cosine, now.sine, frame.frequency * late)
        path = force_flow.derivatives(frame, x, v, *phasor, order + 1)
        return shifted(path, -late, order), shifted(path[1:], -late, order)
    force = pulls(frame, now, order, bias)
    path = free(frame, x, v, [shifted(force[k:], late, order - 1 - k) for k in range(order)])
    return shifted(path, -late, order), shifted(path[1:], -late, order)


def way(frame, now, side, order):
    """Position of the wall on a side and its derivatives, one more than the order."""
    ways = [course(wall, frame.frequency, now.cosine, now.sine, order + 1) for wall in frame.walls]
    return picked(side, frame.walls, ways)


def placed(way, late, order):
    """Position and velocity of a wall a time later, from its `way`."""
    where, pace = shifted(way, late, order), shifted(way[1:], late, order)
    return where, jnp.zeros_like(late) if pace is None else pace


def terms(derivatives):
    """Taylor coefficients from derivatives, None being zero."""
    return [None if each is None else each * (1.0 / math.factorial(k)) for k, each in enumerate(derivatives)]


def shifted(derivatives, late, order):
    """The Taylor polynomial of an order with these derivatives, a time later."""
    found = terms(derivatives[: order + 1])
    total = found[-1]
    for term in found[-2::-1]:
        total = term if total is None else less(total * late, None if term is None else -term)
    return total


def root(derivatives, order):
    """The root near 0 of the polynomial with these derivatives, right to an order in its value at 0."""
    found = terms(derivatives)
    late = -found[0] / found[1]
    found = [jnp.zeros_like(late) if term is None else term for term in found]
    for _ in range(math.ceil(math.log2(order + 1)) - 1):
        value, slope = event.horner(found, late)
        late = late - value / slope
    return late
