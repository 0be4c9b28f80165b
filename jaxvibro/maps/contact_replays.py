"""Dispatch on the contact law in a replay: one module for each law, with the functions of `rigid_replay`."""

from ..flight.coefficients import ContactLaw
from . import force_law_replay, linear_contact_replay, rigid_replay

REPLAY_MODULES = {
    ContactLaw.RIGID: rigid_replay,
    ContactLaw.LINEAR: linear_contact_replay,
    ContactLaw.FORCE_LAW: force_law_replay,
}


def contact_replay_of(coeffs):
    """Return the replay module for the contact law of the coefficients."""
    return REPLAY_MODULES[coeffs.contact_law]
