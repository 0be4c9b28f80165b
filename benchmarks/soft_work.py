"""The work between soft walls: that of `work`, but beyond a wall x'' + 2 gamma2 x' + k2 (x - x_b) + x = A cos(omega t).

An entry into a wall takes an impact's place in the itinerary (paper, (39)).
"""

import math

from benchmarks.work import RESTITUTION

STIFFNESSES = (10.0, 1e4, 1e7)
# the share of critical damping with which a contact leaves R of the speed, R that of the rigid walls
SHARE = -math.log(RESTITUTION) / math.hypot(math.pi, math.log(RESTITUTION))


def held(stiffness):
    """gamma2 at which a wall leaves the rigid walls' R of the speed, however stiff it is."""
    return SHARE * math.sqrt(1.0 + stiffness)


def words(stiffness):
    """A stiffness as text: 10 or 1e7."""
    return f"{stiffness:g}" if stiffness < 1e3 else f"1e{math.log10(stiffness):.0f}"
