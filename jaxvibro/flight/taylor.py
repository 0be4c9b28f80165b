"""Taylor polynomials near a known time, as long as the order of the derivatives asked for."""

import math
from typing import NamedTuple

import jax
import jax.numpy as jnp
from jaxtyping import Float

from . import event
from .wall import course_on, less


class Now(NamedTuple):
    """x, v and the drive's phasor at a time since the start; the time is a constant."""

    x: Float[jax.Array, "*lanes"]
    v: Float[jax.Array, "*lanes"]
    cosine: Float[jax.Array, "*lanes"]
    sine: Float[jax.Array, "*lanes"]
    time: Float[jax.Array, "*lanes"]


def way(frame, now, side, order):
    """Position of the wall on a side and its derivatives, one more than the order."""
    return course_on(frame, side, now.cosine, now.sine, order + 1)


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
