"""All periodic orbits of a scene, stable or not, by brute force: Newton's method from every point of a fine grid.

It takes `strobe` and `monodromy` from the package and nothing else: no trajectory is waited for to recur, no start is
random. The points of all periods are unknown, so that errors are those of single periods: neither their growth over n
periods nor the square root of a graze keeps Newton's method from an orbit.
"""

from typing import NamedTuple

import numpy as np

import jaxvibro as jv

BATCH = 1 << 11  # states of a call
STEPS = 30  # of Newton's method, each the best of some fractions
FRACTIONS = 0.5 ** np.arange(6)
EXACT = 1e-11  # error of an orbit's points, each against the strobe of the point before
APART = 1e-8  # distance of different points


class Orbit(NamedTuple):
    """A periodic orbit: x, v on the section at phase 0, a row a period; multipliers, the larger one first."""

    points: np.ndarray
    multipliers: np.ndarray


def orbits(scene, max_period, columns=60):
    """All orbits of minimal period up to max_period of a single scene between two walls at rest: a list of `Orbit`.

    columns: of the grid, from wall to wall; its rows, twice as many, span the velocities that two periods leave of any.
    """
    left, right = float(scene.left.position), float(scene.right.position)
    wide = product(np.linspace(left, right, 31), np.sinh(np.linspace(-7.0, 7.0, 301)))
    speeds = strobed(scene, strobed(scene, wide))[:, 1]
    starts = product(np.linspace(left, right, columns), np.linspace(speeds.min(), speeds.max(), 2 * columns))
    result, rings = [], [starts]
    for n in range(1, max_period + 1):
        points, errors = solved(scene, np.stack(rings, 1))
        points = [ring for ring in distinct(points[errors < EXACT]) if len(ring) == n]
        result += [Orbit(ring, multipliers(scene, ring)) for ring in points]
        rings.append(strobed(scene, rings[-1]))
    return result


def product(x, v):
    """All pairs of two lists of numbers, shape (pairs, 2)."""
    return np.stack(np.meshgrid(x, v, indexing="ij"), -1).reshape(-1, 2)


def batched(function, points):
    """The function of x and v, called with a fixed number of points at a time."""
    padded = np.pad(points, ((0, -len(points) % BATCH), (0, 0)), mode="edge")
    return np.concatenate([function(*part.T) for part in padded.reshape(-1, BATCH, 2)])[: len(points)]


def strobed(scene, points):
    """x, v one period later, shape (points, 2)."""

    def run(x, v):
        state, _ = jv.strobe(scene, jv.State(x, v), 1, 0)
        return np.stack([state.x, state.v], -1)

    return batched(run, points)


def derivative(scene, points):
    """The derivative of one period, shape (points, 2, 2); zero where there is none."""
    matrices = batched(lambda x, v: np.asarray(jv.monodromy(scene, jv.State(x, v))), points)
    return np.where(np.isfinite(matrices), matrices, 0.0)


def multipliers(scene, ring):
    """The multipliers of an orbit, the larger one first."""
    values = np.linalg.eigvals(np.linalg.multi_dot([np.eye(2), *derivative(scene, ring)[::-1], np.eye(2)]))
    return values[np.argsort(-(values.imag if np.iscomplexobj(values) else abs(values)))]


def solved(scene, rings):
    """Newton's method for the points of whole orbits, shape (orbits, n, 2): (rings, largest error of each)."""
    n, left, right = rings.shape[1], float(scene.left.position), float(scene.right.position)

    def errors(rings):
        return strobed(scene, rings.reshape(-1, 2)).reshape(rings.shape) - np.roll(rings, -1, axis=-2)

    for _ in range(STEPS):
        slopes = derivative(scene, rings.reshape(-1, 2)).reshape(-1, n, 2, 2)
        system = np.zeros((len(rings), n, 2, n, 2))
        for k in range(n):
            system[:, k, :, k] += slopes[:, k]
            system[:, k, :, (k + 1) % n] -= np.eye(2)
        change = -np.linalg.pinv(system.reshape(-1, 2 * n, 2 * n)) @ errors(rings).reshape(-1, 2 * n, 1)
        trials = rings + FRACTIONS[:, None, None, None] * change.reshape(rings.shape)
        trials[..., 0] = np.clip(trials[..., 0], left, right)
        rings = trials[abs(errors(trials)).max((2, 3)).argmin(0), np.arange(len(rings))]
    return rings, abs(errors(rings)).max((1, 2))


def distinct(rings):
    """Different orbits, each as the points of the least number of periods."""
    orbits = []
    for ring in rings:
        n = len(ring)
        least = next(m for m in range(1, n + 1) if n % m == 0 and abs(np.roll(ring, -m, axis=0) - ring).max() < APART)
        if not any(len(other) == least and abs(other - ring[0]).max(1).min() < APART for other in orbits):
            orbits.append(ring[:least])
    return orbits
