"""The end of a replayed path: whether a mass has left a soft wall by then."""

from typing import NamedTuple

import jax
import jax.numpy as jnp
from jaxtyping import Bool, Float

from ..compiled.compiler_hints import choose
from ..flight.event import rounding
from ..flight.soft_contact import is_inside
from ..scene.codes import Contact

NEAR = 64.0  # roundings of the path's length or the drive's period: a contact phase that ends this close to the end


class PathEnd(NamedTuple):
    """Time and contact at the end of a path, the contact as of a `State` (0 where the mass is free)."""

    time: Float[jax.Array, "*lanes"]
    contact: Float[jax.Array, "*lanes"]


def leaves(frame, end: PathEnd, now, touch, time) -> Bool[jax.Array, "*lanes"]:
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
    near = now.time + time >= end.time - NEAR * rounding(time.dtype) * jnp.maximum(frame.period, end.time)
    within = (abs(end.contact) == Contact.WITHIN) & (end.contact * touch > 0)
    return is_inside(touch) & choose(near, ~within, time < end.time - now.time)
