"""The work that every side does: one drive period from phase 0, walls at -1 and 1, itinerary recorded.

x'' + 2 gamma x' + x = A cos(omega t), y+ = -R y- at a rigid wall (Cheng and Xu 2007, equations 3 and 4); beyond a soft
one x'' + 2 gamma2 x' + k2 (x - x_b) + x = A cos(omega t), and an entry takes an impact's place in the itinerary (39).
A stiffness k2 of None says that the walls are rigid; a cubic of None that the spring is linear, else cubic x^3 is added
to it (Duffing).
"""

import math
from typing import NamedTuple

import numpy as np

OMEGA = 2.1
GAMMA = 0.05
RESTITUTION = 0.7
PERIOD = 2 * math.pi / OMEGA
# Complete chatter has impacts without end: every side stops a lane here, and no such lane is judged.
CAP = 30
CUBIC = 0.5
STIFFNESSES = (10.0, 1e4, 1e7)
# the share of critical damping with which a contact leaves R of the speed, R that of the rigid walls
SHARE = -math.log(RESTITUTION) / math.hypot(math.pi, math.log(RESTITUTION))


class Strobes(NamedTuple):
    """What a side returns for n states.

    ends: (n, 2) x and x' after one period.
    sides: (n, CAP) int, -1 left and 1 right in order of time, 0 in empty slots.
    times: (n, CAP) times of impact in t, inf in empty slots.
    """

    ends: np.ndarray
    sides: np.ndarray
    times: np.ndarray


def draw(count, seed=0):
    """Draw (count, 3) float64 rows x, x', A: x in [-1, 1], x' in [-3, 3], A in [0, 6], each uniform."""
    generator = np.random.default_rng(seed)
    return generator.uniform([-1.0, -3.0, 0.0], [1.0, 3.0, 6.0], (count, 3))


def blank(states):
    """Ends that copy the starts, and an empty itinerary, for a side to fill in."""
    sides = np.zeros((len(states), CAP), dtype=np.int8)
    return Strobes(states[:, :2].copy(), sides, np.full(sides.shape, np.inf))


def held(stiffness):
    """gamma2 at which a wall leaves the rigid walls' R of the speed, however stiff it is."""
    return SHARE * math.sqrt(1.0 + stiffness)


def words(stiffness):
    """A stiffness as text: 10 or 1e7."""
    return f"{stiffness:g}" if stiffness < 1e3 else f"1e{math.log10(stiffness):.0f}"
