"""State on a path together with the derivative of the state with respect to the initial state."""

from typing import NamedTuple

import jax
from jaxtyping import Float

from ..compiled.lane_arithmetic import choose
from ..flight.motion_in_soft_wall import soft_walls


class MonodromyState(NamedTuple):
    """State on a path of flights, impacts and contact phases, with its derivative with respect to the initial state.

    Attributes
    ----------
    time : array
        Time since the start.
    xv : tuple of array
        (x, v), or () if the matrix of a flight does not depend on (x, v).
    cosine, sine : array
        Cosine and sine of the drive phase.
    matrix : tuple of array
        Entries, by rows, of the derivative of (x, v) with respect to the initial (x, v).
    total_contact_times : tuple of array
        Total time spent within each soft wall, left first.
    """

    time: Float[jax.Array, "*lanes"]
    xv: tuple[Float[jax.Array, "*lanes"], ...]
    cosine: Float[jax.Array, "*lanes"]
    sine: Float[jax.Array, "*lanes"]
    matrix: tuple[Float[jax.Array, "*lanes"], ...]
    total_contact_times: tuple[Float[jax.Array, "*lanes"], ...] = ()


def add_contact_time(coeffs, contact_code, contact_duration, total_contact_times):
    """Add the duration of a contact phase, 0 for lanes outside the walls, to the total time within each soft wall."""
    return tuple(
        previous_total + choose(contact_code * float(wall.sign) > 0, contact_duration, 0.0)
        for (wall, _), previous_total in zip(soft_walls(coeffs), total_contact_times, strict=True)
    )
