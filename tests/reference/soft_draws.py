"""Random scenes with soft walls, and starts, by seed."""

import math

import numpy as np

from .draws import Draw, position, start
from .scene import Motion, Scene, Soft, Wall

STRUCTURES = [  # of the walls left and right: "soft" or "rigid" and the harmonic, 0 for one that stands still
    (("soft", 0), None),
    (None, ("soft", 0)),
    (("soft", 0), ("soft", 0)),
    (("soft", 0), ("rigid", 0)),
    (("rigid", 0), ("soft", 0)),
    (("soft", 1), None),
    (None, ("soft", 2)),
    (("soft", 1), ("soft", 0)),
    (("rigid", 0), ("soft", 1)),
    (("soft", 0), ("rigid", 1)),
    (("soft", 3), ("soft", 1)),
    (("rigid", 2), ("soft", 1)),
]


def draw(seed):
    """The Draw of a seed; its start is free or, one in five, beyond a soft wall.

    gamma up to 1.5, omega 0.2 to 8, A 0.1 to 10, R 0.2 to 1; stiffness 1 to 1e8, damping in all shares of critical
    damping W = sqrt(1 + stiffness): none, little, 0.11 (it leaves 0.7 of the speed), up to 1, just 1, up to 3.
    """
    rng = np.random.default_rng([seed, 1])
    gamma = float(rng.choice([0.0, 1.0, rng.uniform(0, 0.2), rng.uniform(0, 1.5)], p=[0.05, 0.05, 0.5, 0.4]))
    omega = float(np.exp(rng.uniform(math.log(0.2), math.log(8))))
    amplitude = float(np.exp(rng.uniform(math.log(0.1), math.log(10))))
    kinds = STRUCTURES[rng.integers(len(STRUCTURES))]
    gap, low = float(rng.uniform(0.3, 4)), float(rng.uniform(-4, 2))
    if rng.random() < 0.4:
        low = -gap * float(rng.uniform(0.2, 0.8))  # the mass rests between the walls
    walls = [wall(rng, kind, place, gap) for kind, place in zip(kinds, (low, low + gap), strict=True)]
    phase = float(rng.choice([0.0, rng.uniform(0, 2 * math.pi)]))
    scene = Scene(gamma, omega, amplitude, *walls)
    x, v = start(scene, rng, phase), float(rng.normal(0, 2) * max(1, omega / 2))  # to meet a wall in a short period
    soft = [(side, each) for side, each in scene.walls() if isinstance(each, Soft)]
    side, each = soft[rng.integers(len(soft))]
    if rng.random() < 0.2:
        x = float(position(each, phase) + side * abs(rng.normal(0, 2)) / math.sqrt(1 + each.stiffness))
    return Draw(scene, x, v, phase)


def wall(rng, kind, place, gap):
    """A wall of a kind of STRUCTURES at a place; it swings by less than 0.45 of the gap."""
    r, stiffness = float(rng.uniform(0.2, 1)), float(np.exp(rng.uniform(0, math.log(1e8))))
    shares = [0.0, float(10 ** rng.uniform(-3, -1)), 0.11, float(rng.uniform(0, 1)), 1.0, float(rng.uniform(1, 3))]
    share = shares[rng.choice(len(shares), p=[0.12, 0.18, 0.2, 0.25, 0.1, 0.15])]
    swing, own = float(rng.uniform(0, 0.45 * gap)), float(rng.uniform(0, 2 * math.pi))
    if kind is None:
        return None
    motion = Motion(swing, own, kind[1]) if kind[1] else None
    if kind[0] == "rigid":
        return Wall(place, r, motion)
    return Soft(place, stiffness, share * math.sqrt(1 + stiffness), motion)
