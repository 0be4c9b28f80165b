"""The work that every side does: one drive period from phase 0, walls at -1 and 1, itinerary recorded.

x'' + 2 gamma x' + x = A cos(omega t), y+ = -R y- at a wall (Cheng and Xu 2007, equations 3 and 4).
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
