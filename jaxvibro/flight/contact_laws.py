"""What a stay within a soft wall is to a path: each kind is a file with the same functions.

`begin` and `going`: of a step; `facing`: the wall that it meets; `bias`: of an acceleration; `reach`: the longest step;
`unbegun` and `paused`: of lanes that wait within a wall.
"""

from . import force_law_contact, linear_contact, rigid_contact
from .coefficients import ContactLaw

CONTACT_LAWS = {
    ContactLaw.RIGID: rigid_contact,
    ContactLaw.LINEAR: linear_contact,
    ContactLaw.FORCE_LAW: force_law_contact,
}


def contact_law_of(coeffs):
    """The kind of a coeffs: a file with the functions above."""
    return CONTACT_LAWS[coeffs.contact_law]
