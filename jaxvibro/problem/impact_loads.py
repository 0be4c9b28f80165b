"""What impacts do to walls: how fast the mass comes, and the energy that it leaves there.

An impact at a rigid wall takes (1 - R^2) u^2 / 2 of the energy in the wall's frame, u the speed before it relative to
the wall. Where the mass then comes to rest the impacts that are not told take all that is left, (R u)^2 / 2. Energies
are in the unit K length^2, work rates in K length^2 w0.
"""

import numpy as np

from ..maps.wall_loads import impact_energy_loss
from ..scene.codes import Contact

SIDE_SIGNS = {"left": -1, "right": 1}


def largest_speed(sides, speeds):
    """The largest speed before an impact, relative to its wall, (points,): 0 where there is no impact. sides, speeds:
    (points, impacts), as a branch's data have them."""
    return np.max(speeds, axis=1, initial=0.0, where=_are_impacts(sides))


def work_rate(sides, speeds, restitutions, duration):
    """The energy that impacts leave at the walls, over time, (points,): nan where one of them is soft, as what that
    takes depends on the drive. restitutions: {side: (points,)}, nan of a soft wall; duration: of the orbit,
    (points,)."""
    restitution = np.zeros(sides.shape)
    for side, sign in SIDE_SIGNS.items():
        if side in restitutions:
            restitution = np.where(np.sign(sides) == sign, restitutions[side][:, None], restitution)
    return (
        np.where(_are_impacts(sides), impact_energy_loss(speeds, restitution, _find_last_impacts(sides)), 0.0).sum(
            axis=1
        )
        / duration
    )


def _are_impacts(sides):
    return abs(sides) == Contact.LANDED


def _find_last_impacts(sides):
    """Which impacts are the last that are told before the mass rests."""
    is_last = np.zeros(sides.shape, bool)
    for pattern in np.unique(sides, axis=0):
        impact_columns = np.flatnonzero(pattern)
        last_columns = impact_columns[abs(np.roll(pattern[impact_columns], -1)) >= Contact.STUCK]
        is_last[np.ix_((sides == pattern).all(axis=1), last_columns)] = True
    return is_last & _are_impacts(sides)
