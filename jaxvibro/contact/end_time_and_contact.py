"""End of a replayed path, and the decision whether a mass leaves a soft wall before the end."""

from typing import NamedTuple

import jax
import jax.numpy as jnp
from jaxtyping import Bool, Float

from ..compiled.lane_arithmetic import choose
from ..flight.event_certificates import unit_roundoff
from ..flight.motion_in_soft_wall import is_inside_soft_wall
from ..scene.state import Contact

END_TOLERANCE = 64.0  # rounding errors of the path's length or the drive's period: such an exit is at the end


class EndTimeAndContact(NamedTuple):
    """End of a path.

    Attributes
    ----------
    time : array
        Time at the end.
    contact : array
        Contact code at the end, as the `contact` of a `State`; 0 for a free mass.
    """

    time: Float[jax.Array, "*lanes"]
    contact: Float[jax.Array, "*lanes"]


def exits_wall_before_end(
    coeffs, path_end: EndTimeAndContact, current_state, contact_code, contact_duration
) -> Bool[jax.Array, "*lanes"]:
    """Decide whether lanes within a soft wall leave the wall before the path ends.

    If a contact phase ends at the end of the path up to rounding, the contact that the simulation recorded at the end
    decides. The derivatives then belong to the returned state.

    Parameters
    ----------
    coeffs : FlowCoefficients
        Coefficients of the scene.
    path_end : EndTimeAndContact
        End of the path.
    current_state : ExpansionPoint or MonodromyState
        State at the start of the contact phase.
    contact_code : array
        Contact code of each lane, 0 for lanes outside the walls.
    contact_duration : array
        Duration of the contact phase, at most the time to the end of the path.

    Returns
    -------
    array of bool
        True for lanes that leave the wall before the path ends.
    """
    is_near_end = current_state.time + contact_duration >= path_end.time - END_TOLERANCE * unit_roundoff(
        contact_duration.dtype
    ) * jnp.maximum(coeffs.period, path_end.time)
    is_inside_wall_at_end = (abs(path_end.contact) == Contact.WITHIN) & (path_end.contact * contact_code > 0)
    return is_inside_soft_wall(contact_code) & choose(
        is_near_end, ~is_inside_wall_at_end, contact_duration < path_end.time - current_state.time
    )
