"""Random isolas whose folds are known: closed branches along the frequency that no start leads to.

Orbits with one impact on one wall in n periods, P(n)01, are roots of a quadratic (`tests/reference/closed.py`). Along
the frequency, at an amplitude a little above a least value of that of their fold, they are one closed branch between
two folds. Where the wall moves, the folds are those of the first scene, carried there along their loci.
"""

from typing import NamedTuple

import mpmath
import numpy as np

import jaxvibro as jv
from tests.reference import closed

LOOKS = 400  # frequencies at which least values are looked for
NEAR = 1e-6  # of the frequency: two folds as near are one


class Isola(NamedTuple):
    """A scene at a frequency within the isola, the label of the orbits, the frequencies of the folds, and bounds."""

    scene: jv.Scene
    label: str
    folds: tuple
    bounds: tuple


def draw_isola(rng):
    """Return a random Isola between one wall that is still."""
    while True:
        isola = _try_isola(rng)
        if isola is not None:
            return isola


def draw_moving_isola(rng):
    """Return a random Isola at a wall that moves, with another wall on the left."""
    while True:
        isola = _with_moving_wall(rng, draw_isola(rng))
        if isola is not None:
            return isola


def has_folds(branch, isola):
    """Return whether a branch has the folds of an isola."""
    values = [point.value for point in branch.points("SN") if point.label == isola.label]
    return all(min((abs(value - fold) for value in values), default=np.inf) < NEAR for fold in isola.folds)


def _try_isola(rng):
    gamma, restitution, wall = rng.uniform((0.02, 0.4, 0.3), (0.15, 0.85, 1.5))
    periods = int(rng.integers(2, 5))

    def fold(omega):
        return closed.fold(gamma, omega, restitution, wall, periods=periods)

    grid = np.linspace(0.6, 1.8 * periods, LOOKS)
    folds = [fold(omega) for omega in grid]
    sizes = np.array([float(one.amplitude) for one in folds])
    speeds = np.array([float(one.speed) for one in folds])
    least = np.flatnonzero((sizes[1:-1] < sizes[:-2]) & (sizes[1:-1] < sizes[2:]) & (speeds[1:-1] > 0)) + 1
    if not len(least):
        return None
    k = int(rng.choice(least))
    amplitude = float(sizes[k] * rng.uniform(1.0002, 1.002))
    above = np.flatnonzero(sizes >= amplitude)
    low, high = above[above < k], above[above > k]
    if not len(low) or not len(high) or (speeds[low[-1] : high[0] + 1] <= 0).any():
        return None
    with mpmath.workdps(30):
        ends = [
            float(mpmath.findroot(lambda w: fold(w).amplitude - amplitude, (grid[k], grid[edge]), solver="anderson"))
            for edge in (low[-1], high[0])
        ]
    for omega in np.linspace(*ends, 11)[1:-1]:
        orbits = closed.orbits(gamma, omega, amplitude, restitution, wall, periods=periods)
        if len(orbits) < 2 or any(_passes_wall(gamma, omega, amplitude, orbit, wall, periods) for orbit in orbits):
            return None
    scene = jv.make_scene(amplitude, 0.5 * sum(ends), gamma, restitution, (None, wall))
    return Isola(scene, f"P{periods}01", tuple(ends), (0.4 * ends[0], 2.0 * ends[1]))


def _passes_wall(gamma, omega, amplitude, orbit, wall, periods):
    """Return whether an orbit is beyond its wall between two impacts."""
    p, q = closed.forced(gamma, omega, amplitude, orbit.phase)
    for late in 2.0 * np.pi * np.linspace(0.0, periods, 64 * periods)[1:-1]:
        free = closed.free_flow(gamma, late / omega) * mpmath.matrix([orbit.x - p, orbit.v - q])
        if closed.forced(gamma, omega, amplitude, orbit.phase + late)[0] + free[0] >= wall:
            return True
    return False


def _with_moving_wall(rng, isola):
    """Return the Isola where the wall moves, None where its folds do not come there."""
    wall, size = float(isola.scene.right.position), float(rng.uniform(0.002, 0.02))
    motion = jv.Motion(0.0, rng.uniform(0.0, 6.28), int(rng.integers(1, 3)))
    left = jv.Wall(-wall * rng.uniform(1.5, 3.0), rng.uniform(0.3, 0.9))
    names = "damping", "frequency", "amplitude", "restitution"
    gamma, omega, amplitude, restitution = (float(isola.scene.parameter(name)) for name in names)
    scene = jv.make_scene(amplitude, omega, gamma, restitution, (left, jv.Wall(wall, motion=motion)))
    periods, names = int(isola.label[1]), ("frequency", "right.motion.amplitude")
    orbit = closed.orbits(gamma, omega, amplitude, restitution, wall, periods=periods)[0]
    start = jv.State(float(orbit.x), float(orbit.v), float(orbit.phase))
    bounds = {names[0]: isola.bounds, names[1]: (0.0, size)}
    try:
        found = jv.find_orbit(scene, start, periods, ("R", *[""] * (periods - 1)), 0)
        loci = [jv.locus(point, names, bounds) for point in jv.follow(found, names[0], isola.bounds).points("SN")]
    except (jv.OrbitError, jv.ArgumentError, ValueError):
        return None
    folds = sorted(float(omega) for locus in loci for omega, moving in locus.values[[0, -1]] if moving == size)
    if len(folds) != 2:
        return None
    scene = scene.replace(**{"right.motion.amplitude": size, "frequency": 0.5 * sum(folds)})
    return Isola(scene, isola.label, tuple(folds), isola.bounds)
