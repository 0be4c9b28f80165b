"""A lane on its way through flights, impacts and stays, with the matrix of the way."""

from typing import NamedTuple

import jax
from jaxtyping import Float

from ..compiled.compiler_hints import choose


class MonodromyState(NamedTuple):
    """time: since the start; xv: (x, v), () where a flight's matrix does not depend on it; the drive's cosine and sine;
    matrix: how (x, v) changes with that at the start, by rows; contact_times: the time spent within each soft wall,
    left first."""

    time: Float[jax.Array, "*lanes"]
    xv: tuple[Float[jax.Array, "*lanes"], ...]
    cosine: Float[jax.Array, "*lanes"]
    sine: Float[jax.Array, "*lanes"]
    matrix: tuple[Float[jax.Array, "*lanes"], ...]
    contact_times: tuple[Float[jax.Array, "*lanes"], ...] = ()


def add_contact_time(coeffs, contact, contact_time, contact_times):
    """The times spent within each soft wall after a stay more; contact: the contact of lanes that are within one, their
    time is 0 of others."""
    soft_walls = [
        wall for wall, soft_flow in zip(coeffs.walls, coeffs.soft_flows, strict=True) if soft_flow is not None
    ]
    return tuple(
        time_so_far + choose(contact * float(wall.sign) > 0, contact_time, 0.0)
        for wall, time_so_far in zip(soft_walls, contact_times, strict=True)
    )
