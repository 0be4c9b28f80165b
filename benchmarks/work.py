"""Define the work of every method: one drive period from phase 0, walls at -1 and 1, itinerary recorded.

x'' + 2 gamma x' + x = A cos(omega t), y+ = -R y- at a rigid wall (Cheng and Xu 2007, equations 3 and 4); beyond a soft
one x'' + 2 gamma2 x' + k2 (x - x_b) + x = A cos(omega t), where an entry replaces an impact in the itinerary (39). A
stiffness k2 of None stands for rigid walls; a cubic of None for a linear spring, otherwise cubic x^3 is added
(Duffing).
"""

import math
from typing import NamedTuple

import numpy as np

OMEGA = 2.1
GAMMA = 0.05
RESTITUTION = 0.7
PERIOD = 2 * math.pi / OMEGA
# Complete chatter has infinitely many impacts: every method stops a lane at this number, and such lanes are excluded.
CAP = 30
CUBIC = 0.5
STIFFNESSES = (10.0, 1e4, 1e7)
# Fraction of critical damping at which a contact has the restitution R of the rigid walls.
SHARE = -math.log(RESTITUTION) / math.hypot(math.pi, math.log(RESTITUTION))


class Strobes(NamedTuple):
    """Result of a method for n states.

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
    """Make ends that copy the starts, and an empty itinerary, for a method to fill in."""
    sides = np.zeros((len(states), CAP), dtype=np.int8)
    return Strobes(states[:, :2].copy(), sides, np.full(sides.shape, np.inf))


def held(stiffness):
    """Return gamma2 at which a wall of any stiffness has the restitution R of the rigid walls."""
    return SHARE * math.sqrt(1.0 + stiffness)


def words(stiffness):
    """Format a stiffness: 10 or 1e7."""
    return f"{stiffness:g}" if stiffness < 1e3 else f"1e{math.log10(stiffness):.0f}"
