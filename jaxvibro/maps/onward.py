"""A lane on its way through flights, impacts and stays, with the matrix of the way."""

from typing import NamedTuple

import jax
from jaxtyping import Float

from ..compiled.compiler_hints import choose


class Onward(NamedTuple):
    """time: since the start; place: (x, v), () where a flight's matrix does not depend on it; the drive's cosine and
    sine; matrix: how (x, v) changes with that at the start, by rows; within: the time spent within each soft wall, left
    first."""

    time: Float[jax.Array, "*lanes"]
    place: tuple[Float[jax.Array, "*lanes"], ...]
    cosine: Float[jax.Array, "*lanes"]
    sine: Float[jax.Array, "*lanes"]
    matrix: tuple[Float[jax.Array, "*lanes"], ...]
    within: tuple[Float[jax.Array, "*lanes"], ...] = ()


def spent(frame, touch, time, within):
    """The times spent within each soft wall after a stay more; touch: the contact of lanes that are within one, their
    time is 0 of others."""
    soft = [wall for wall, each in zip(frame.walls, frame.contacts, strict=True) if each is not None]
    return tuple(old + choose(touch * float(wall.sign) > 0, time, 0.0) for wall, old in zip(soft, within, strict=True))
