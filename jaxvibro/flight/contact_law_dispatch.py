"""Dispatch on the kind of the contact phases inside soft walls.

Each kind is a module with the same functions:

- `prepare_step` and `path_of_stepping_lanes` prepare a step,
- `target_wall` describes the wall that a lane moves towards,
- `frame_force` returns the additional force in the acceleration,
- `max_step` is the longest step,
- `initial_waiting_steps` and `advance_waiting_lanes` advance lanes inside a wall that wait for a long step, or for the
  computation of the whole contact phase.
"""

from . import force_law_contact, linear_contact, no_contact_phase
from .flight_coefficients import ContactLaw

CONTACT_LAWS = {
    ContactLaw.RIGID: no_contact_phase,
    ContactLaw.LINEAR: linear_contact,
    ContactLaw.FORCE_LAW: force_law_contact,
}


def contact_law_of(coeffs):
    """Return the contact law that the coefficients select: a module with the functions listed for this module."""
    return CONTACT_LAWS[coeffs.contact_law]
