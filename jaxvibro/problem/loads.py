"""What impacts do to walls: how fast the mass comes, and the energy that it leaves there.

An impact at a rigid wall takes (1 - R^2) u^2 / 2 of the energy in the wall's frame, u the speed before it relative to
the wall. Where the mass then comes to rest the impacts that are not told take all that is left, (R u)^2 / 2. Energies
are in the unit K length^2, work rates in K length^2 w0.
"""

import numpy as np

from ..maps.wall_loads import taken
from ..scene.codes import Contact

SIGNS = {"left": -1, "right": 1}


def largest_speed(sides, speeds):
    """The largest speed before an impact, relative to its wall, (points,): 0 where there is no impact. sides, speeds:
    (points, impacts), as a branch's data have them."""
    return np.max(speeds, axis=1, initial=0.0, where=_hits(sides))


def work_rate(sides, speeds, restitutions, span):
    """The energy that impacts leave at the walls, over time, (points,): nan where one of them is soft, as what that
    takes depends on the drive. restitutions: {side: (points,)}, nan of a soft wall; span: of the orbit, (points,)."""
    rebound = np.zeros(sides.shape)
    for side, sign in SIGNS.items():
        if side in restitutions:
            rebound = np.where(np.sign(sides) == sign, restitutions[side][:, None], rebound)
    return np.where(_hits(sides), taken(speeds, rebound, _last(sides)), 0.0).sum(axis=1) / span


def _hits(sides):
    return abs(sides) == Contact.LANDED


def _last(sides):
    """Which impacts are the last that are told before the mass rests."""
    found = np.zeros(sides.shape, bool)
    for row in np.unique(sides, axis=0):
        hit = np.flatnonzero(row)
        ends = hit[abs(np.roll(row[hit], -1)) >= Contact.STUCK]
        found[np.ix_((sides == row).all(axis=1), ends)] = True
    return found & _hits(sides)
