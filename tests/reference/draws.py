"""Random scenes and starts, by seed."""

import math
from typing import NamedTuple

import numpy as np

from .scene import Motion, Scene, Wall


class Draw(NamedTuple):
    """A scene and a start strictly between its walls."""

    scene: Scene
    x: float
    v: float
    phase: float


def draw(seed):
    """The Draw of a seed: one wall, two, or moving ones; gamma up to 1.5, omega 0.3 to 5, A up to 10, R 0.2 to 1."""
    rng = np.random.default_rng(seed)
    gamma = float(rng.choice([0.0, 1.0, rng.uniform(0, 0.2), rng.uniform(0, 1.5)], p=[0.05, 0.05, 0.4, 0.5]))
    omega, amplitude = float(rng.uniform(0.3, 5)), float(rng.uniform(0, 10))
    gap, low = float(rng.uniform(0.3, 4)), float(rng.uniform(-4, 2))
    positions, keep = (low, low + gap), rng.choice(["left", "right", "both"], p=[0.2, 0.2, 0.6])
    walls = [None, None]
    for side in (0, 1):
        r = float(rng.uniform(0.2, 1))
        motion = moving(rng, gap)
        if keep == "both" or keep == ("left", "right")[side]:
            walls[side] = Wall(positions[side], r, motion)
    phase = float(rng.choice([0.0, rng.uniform(0, 2 * math.pi)]))
    scene = Scene(gamma, omega, amplitude, *walls)
    return Draw(scene, start(scene, rng, phase), float(rng.normal(0, 2)), phase)


def moving(rng, gap):
    """Half the time None, else a Motion of less than 0.45 of the gap."""
    motion = Motion(float(rng.uniform(0, 0.45 * gap)), float(rng.uniform(0, 2 * math.pi)), int(rng.integers(1, 4)))
    return motion if rng.random() < 0.5 else None


def position(wall, phase):
    """Where a wall is at a drive phase."""
    b, own, m = wall.motion or Motion(0.0)
    return wall.position + b * math.cos(m * phase + own)


def start(scene, rng, phase):
    """x between the walls, up to 3 away from a single one."""
    ends = [position(wall, phase) if wall else None for wall in (scene.left, scene.right)]
    low = ends[0] if ends[0] is not None else ends[1] - 3
    high = ends[1] if ends[1] is not None else ends[0] + 3
    return float(low + (high - low) * rng.uniform(0.001, 0.999))
