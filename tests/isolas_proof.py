"""Isolas that the starts of `explore` miss: `python -m tests.isolas_proof N [seed]`.

Orbits with one impact on one wall in n periods, P(n)01, are roots of a quadratic (`tests/reference/closed.py`): along
the frequency, at an amplitude a little above a least value of that of their fold, they are one closed branch between
two folds. Of every second scene the wall moves, and there is another: its folds are those of the first scene carried
there along their loci. Of so many scenes whose isola `explore` does not have `find_isolas` is to find it, closed, with
these folds, on no branch of the diagram.
"""

import sys
import time
from typing import NamedTuple

import jax
import mpmath
import numpy as np

import jaxvibro as jv
from tests.reference import closed

LOOKS = 400  # frequencies at which least values are looked for
SAME = 1e-9  # of a fold
NEAR = 1e-6  # of the frequency: two folds as near are one


class Isola(NamedTuple):
    """scene: at a frequency within; label; folds: the two frequencies; bounds: to explore."""

    scene: jv.Scene
    label: str
    folds: tuple
    bounds: tuple


def fold(gamma, restitution, wall, periods, omega):
    """(amplitude, speed) of the fold of P(n)01."""
    found = closed.fold(gamma, omega, restitution, wall, periods=periods)
    return float(found.amplitude), float(found.speed)


def drawn(rng):
    """A random `Isola` of one wall, or None."""
    gamma, restitution, wall = rng.uniform((0.02, 0.4, 0.3), (0.15, 0.85, 1.5))
    periods = int(rng.integers(2, 5))
    given = gamma, restitution, wall, periods
    grid = np.linspace(0.6, 1.8 * periods, LOOKS)
    sizes, speeds = np.array([fold(*given, omega) for omega in grid]).T
    least = np.flatnonzero((sizes[1:-1] < sizes[:-2]) & (sizes[1:-1] < sizes[2:]) & (speeds[1:-1] > 0)) + 1
    if not len(least):
        return None
    k = int(rng.choice(least))
    amplitude = float(sizes[k] * rng.uniform(1.0002, 1.002))
    inside = [k, k]
    while inside[0] > 0 and sizes[inside[0]] < amplitude:
        inside[0] -= 1
    while inside[1] < LOOKS - 1 and sizes[inside[1]] < amplitude:
        inside[1] += 1
    if inside[0] == 0 or inside[1] == LOOKS - 1 or (speeds[inside[0] : inside[1] + 1] <= 0).any():
        return None
    with mpmath.workdps(30):
        ends = [
            mpmath.findroot(
                lambda omega: closed.fold(gamma, omega, restitution, wall, periods=periods).amplitude - amplitude,
                (grid[k], grid[edge]),
                solver="anderson",
            )
            for edge in inside
        ]
        folds = tuple(float(each) for each in ends)
    if not is_clear(*given, amplitude, folds):
        return None
    scene = jv.make_scene(amplitude, 0.5 * sum(folds), gamma, restitution, (None, wall))
    return Isola(scene, f"P{periods}01", folds, (0.4 * folds[0], 2.0 * folds[1]))


def is_clear(gamma, restitution, wall, periods, amplitude, folds):
    """Whether the orbits all along an isola have two speeds, and keep to the wall's side between impacts."""
    for omega in np.linspace(*folds, 11)[1:-1]:
        found = closed.orbits(gamma, omega, amplitude, restitution, wall, periods=periods)
        if len(found) < 2:
            return False
        for one in found:
            phases = float(one.phase) + 2.0 * np.pi * np.linspace(0.0, periods, 64 * periods)[1:-1]
            if any(path(gamma, omega, amplitude, one, phase) >= wall for phase in phases):
                return False
    return True


def path(gamma, omega, amplitude, orbit, phase):
    """x of an orbit at a phase after its impact's."""
    (p, q), (x, _) = (closed.forced(gamma, omega, amplitude, each) for each in (orbit.phase, phase))
    free = closed.free_flow(gamma, (phase - orbit.phase) / omega) * mpmath.matrix([orbit.x - p, orbit.v - q])
    return x + free[0]


def moved(rng, one):
    """The `Isola` where the wall moves and another stands on the left, None where its folds do not come there."""
    wall, size = float(one.scene.right.position), float(rng.uniform(0.002, 0.02))
    motion = jv.Motion(0.0, rng.uniform(0.0, 6.28), int(rng.integers(1, 3)))
    left = jv.Wall(-wall * rng.uniform(1.5, 3.0), rng.uniform(0.3, 0.9))
    numbers = [float(one.scene.parameter(name)) for name in ("amplitude", "frequency", "damping", "restitution")]
    scene = jv.make_scene(*numbers, (left, jv.Wall(wall, motion=motion)))
    try:
        branch = first(scene, one)
        folds = [carried(point, one.bounds, size) for point in branch.points("SN")]
    except (jv.OrbitError, jv.ArgumentError, ValueError):
        return None
    if len(folds) != 2 or None in folds:
        return None
    there = scene.replace(**{"right.motion.amplitude": size, "frequency": 0.5 * sum(folds)})
    return Isola(there, one.label, tuple(sorted(folds)), one.bounds)


def first(scene, one):
    """The branch of an isola where the wall does not move yet, from the closed form."""
    gamma, omega, amplitude, restitution = (
        float(scene.parameter(name)) for name in ("damping", "frequency", "amplitude", "restitution")
    )
    periods, wall = int(one.label[1]), float(scene.right.position)
    orbit = closed.orbits(gamma, omega, amplitude, restitution, wall, periods=periods)[0]
    state = jv.State(float(orbit.x), float(orbit.v), float(orbit.phase))
    walls = ("R", *[""] * (periods - 1))
    return jv.follow(jv.find_orbit(scene, state, periods, walls, 0), "frequency", one.bounds)


def carried(point, bounds, size):
    """The frequency of a fold where the wall moves by so much, None where it does not come there."""
    names = ("frequency", "right.motion.amplitude")
    locus = jv.locus(point, names, {names[0]: bounds, names[1]: (0.0, size)})
    ends = [frequency for frequency, moving in locus.values[[0, -1]] if moving == size]
    return float(ends[0]) if len(ends) == 1 else None


def has(branch, one):
    """Whether a branch has the folds of an isola."""
    found = [point.value for point in branch.points("SN") if point.label == one.label]
    return all(min((abs(value - each) for value in found), default=np.inf) < NEAR for each in one.folds)


def main(count, seed):
    """So many isolas that `explore` misses; what is found of each."""
    rng, tried, missed, got, worst, more = np.random.default_rng(seed), 0, 0, 0, 0.0, 0
    while missed < count:
        one = drawn(rng)
        if one is not None and tried % 2:
            one = moved(rng, one)
        if one is None:
            continue
        tried += 1
        began = time.perf_counter()
        diagram = jv.explore(one.scene, "frequency", one.bounds, max_period=4)
        if any(has(branch, one) for branch in diagram.branches):
            print(f"  on the diagram: {one.label} {one.folds}", flush=True)
            continue
        missed, spent = missed + 1, time.perf_counter() - began
        found = jv.find_isolas(diagram)
        mine = [branch for branch in found if has(branch, one)]
        off = np.inf
        if len(mine) == 1:
            off = max(min(abs(point.value - each) for point in mine[0].points("SN")) for each in one.folds)
            got, worst = got + (mine[0].reasons[1].startswith("it closes") and off < SAME), max(worst, off)
        more += len(found) - len(mine)
        share = (one.folds[1] - one.folds[0]) / (one.bounds[1] - one.bounds[0])
        kind = "".join(
            "-" if wall is None else "w" if wall.motion is None else "m" for wall in (one.scene.left, one.scene.right)
        )
        told = f"{missed} {kind} {one.label} of {share:.4f} of the bounds: {len(mine)} found, folds off by {off:.1e}"
        print(
            f"{told}, {len(found) - len(mine)} others ({spent:.0f} s, {time.perf_counter() - began - spent:.0f} s)",
            flush=True,
        )
    print(
        f"{tried} isolas, {missed} missed by the starts of explore, {got} of them found, closed;",
        f"folds off by {worst:.1e}; {more} other isolas",
    )


if __name__ == "__main__":
    jax.config.update("jax_enable_x64", True)
    number, *rest = sys.argv[1:]
    main(int(number), int(rest[0]) if rest else 0)
