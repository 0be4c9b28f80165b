"""State of a lane on its path, with the matrix of the path."""

from typing import NamedTuple

import jax
from jaxtyping import Float

from ..compiled.compiler_hints import choose


class MonodromyState(NamedTuple):
    """State on a path of flights, impacts and contact phases, with its derivative with respect to the initial state.

    `time` is since the start. `xv` is (x, v), or () where the matrix of a flight does not depend on it. `cosine` and
    `sine` are those of the drive. `matrix` is the derivative of (x, v), by rows, with respect to the initial (x, v).
    `contact_times` are the times spent within each soft wall, left first.
    """

    time: Float[jax.Array, "*lanes"]
    xv: tuple[Float[jax.Array, "*lanes"], ...]
    cosine: Float[jax.Array, "*lanes"]
    sine: Float[jax.Array, "*lanes"]
    matrix: tuple[Float[jax.Array, "*lanes"], ...]
    contact_times: tuple[Float[jax.Array, "*lanes"], ...] = ()


def add_contact_time(coeffs, contact, contact_time, contact_times):
    """Add the duration of a contact phase to the times spent within each soft wall; it is 0 for lanes outside."""
    soft_walls = [
        wall for wall, soft_flow in zip(coeffs.walls, coeffs.soft_flows, strict=True) if soft_flow is not None
    ]
    return tuple(
        time_so_far + choose(contact * float(wall.sign) > 0, contact_time, 0.0)
        for wall, time_so_far in zip(soft_walls, contact_times, strict=True)
    )
