"""Dispatch on the kind of the contact phases inside soft walls.

Each kind is a module with the same functions:

- `prepare_step` and `active_path` prepare a step,
- `target_wall` describes the wall that a lane moves towards,
- `extra_force` returns the additional force in the acceleration,
- `max_step` is the longest step,
- `initial_wait` and `advance_waiting` treat lanes that wait inside a wall.
"""

from . import force_law_contact, linear_contact, rigid_contact
from .coefficients import ContactLaw

CONTACT_LAWS = {
    ContactLaw.RIGID: rigid_contact,
    ContactLaw.LINEAR: linear_contact,
    ContactLaw.FORCE_LAW: force_law_contact,
}


def contact_law_of(coeffs):
    """Return the contact law of some coefficients: a module with the functions above."""
    return CONTACT_LAWS[coeffs.contact_law]
