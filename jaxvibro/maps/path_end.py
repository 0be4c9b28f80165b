"""The end of a replayed path: whether a mass has left a soft wall by then."""

from typing import NamedTuple

import jax
import jax.numpy as jnp
from jaxtyping import Bool, Float

from ..compiled.compiler_hints import choose
from ..flight.event import unit_roundoff
from ..flight.soft_contact import is_inside
from ..scene.codes import Contact

END_TOLERANCE = (
    64.0  # roundings of the path's length or the drive's period: a contact phase that ends this close to the end
)


class PathEnd(NamedTuple):
    """Time and contact at the end of a path, the contact as of a `State` (0 where the mass is free)."""

    time: Float[jax.Array, "*lanes"]
    contact: Float[jax.Array, "*lanes"]


def exits_before_end(coeffs, path_end: PathEnd, current, contact, contact_time) -> Bool[jax.Array, "*lanes"]:
    """Decide whether lanes within a soft wall leave it before the path ends.

    A contact phase that ends together with the path, up to rounding, is decided by the contact that the simulation
    has recorded at the end, so that derivatives belong to the state that is returned.

    Parameters
    ----------
    frame : Frame
        Coefficients of the scene.
    end : PathEnd
        End of the path.
    now : Now
        State from which the contact phase is replayed.
    touch : array
        Contact of the lanes, 0 of lanes outside.
    time : array
        Duration of the contact phase, at most the time to the path's end.
    """
    is_near_end = current.time + contact_time >= path_end.time - END_TOLERANCE * unit_roundoff(
        contact_time.dtype
    ) * jnp.maximum(coeffs.period, path_end.time)
    ends_inside = (abs(path_end.contact) == Contact.WITHIN) & (path_end.contact * contact > 0)
    return is_inside(contact) & choose(is_near_end, ~ends_inside, contact_time < path_end.time - current.time)
