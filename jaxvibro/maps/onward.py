"""A lane on its way through flights, impacts and stays, with the matrix of the way."""

from typing import NamedTuple

import jax
from jaxtyping import Float


class Onward(NamedTuple):
    """time: since the start; place: (x, v), () where a flight's matrix does not depend on it; the drive's cosine and
    sine; matrix: how (x, v) changes with that at the start, by rows."""

    time: Float[jax.Array, "*lanes"]
    place: tuple[Float[jax.Array, "*lanes"], ...]
    cosine: Float[jax.Array, "*lanes"]
    sine: Float[jax.Array, "*lanes"]
    matrix: tuple[Float[jax.Array, "*lanes"], ...]
