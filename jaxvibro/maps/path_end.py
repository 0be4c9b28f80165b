"""End of a replayed path, and the decision on exits from soft walls near it."""

from typing import NamedTuple

import jax
import jax.numpy as jnp
from jaxtyping import Bool, Float

from ..compiled.compiler_hints import choose
from ..flight.event import unit_roundoff
from ..flight.soft_contact import is_inside
from ..scene.codes import Contact

END_TOLERANCE = 64.0  # rounding errors of the path's length or the drive's period: such an exit is at the end


class PathEnd(NamedTuple):
    """Time and contact at the end of a path; the contact is that of a `State`, 0 for a free mass."""

    time: Float[jax.Array, "*lanes"]
    contact: Float[jax.Array, "*lanes"]


def exits_before_end(coeffs, path_end: PathEnd, current, contact, contact_time) -> Bool[jax.Array, "*lanes"]:
    """Decide for lanes within a soft wall if they leave it before the path ends.

    If a contact phase ends together with the path, up to rounding, the contact that the simulation recorded at the end
    decides. So derivatives belong to the state that is returned.

    Parameters
    ----------
    coeffs : FlowCoefficients
        Coefficients of the scene.
    path_end : PathEnd
        End of the path.
    current : ExpansionPoint or MonodromyState
        State at the start of the contact phase.
    contact : array
        Contact of the lanes, 0 for lanes outside.
    contact_time : array
        Duration of the contact phase, at most the time to the end of the path.

    Returns
    -------
    array of bool
        True for lanes that leave the wall before the path ends.
    """
    is_near_end = current.time + contact_time >= path_end.time - END_TOLERANCE * unit_roundoff(
        contact_time.dtype
    ) * jnp.maximum(coeffs.period, path_end.time)
    ends_inside = (abs(path_end.contact) == Contact.WITHIN) & (path_end.contact * contact > 0)
    return is_inside(contact) & choose(is_near_end, ~ends_inside, contact_time < path_end.time - current.time)
