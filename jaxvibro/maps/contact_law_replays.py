"""Dispatch on the contact law in a replay: each law has a module with the functions of `rigid_wall_replay`."""

from ..flight.flight_coefficients import ContactLaw
from . import force_law_contact_replay, linear_contact_replay, rigid_wall_replay

REPLAY_MODULES = {
    ContactLaw.RIGID: rigid_wall_replay,
    ContactLaw.LINEAR: linear_contact_replay,
    ContactLaw.FORCE_LAW: force_law_contact_replay,
}


def replay_module_of(coeffs):
    """Return the replay module for the contact law of the coefficients."""
    return REPLAY_MODULES[coeffs.contact_law]
