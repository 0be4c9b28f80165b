"""What a stay within a soft wall is to a replay: each kind is a file with the same functions, see `rigid_replay`."""

from ..flight.coefficients import ContactLaw
from . import force_law_replay, linear_contact_replay, rigid_replay

REPLAY_MODULES = {
    ContactLaw.RIGID: rigid_replay,
    ContactLaw.LINEAR: linear_contact_replay,
    ContactLaw.FORCE_LAW: force_law_replay,
}


def contact_replay_of(coeffs):
    """The kind of a frame."""
    return REPLAY_MODULES[coeffs.contact_law]
