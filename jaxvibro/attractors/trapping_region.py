"""Traps: neighbourhoods of an attractor on Sigma from which no state leaves again.

Near a point of a periodic attractor of n periods the map F^n draws in. In the norm of z' P z, with P from Lyapunov's
equation of its derivative M, it does so at every return: an ellipse abs(L (z - point)) <= r, L' L = P, is mapped into
itself. How large r may be is tried on a fan of states. A chaotic attractor has no such ellipse: a sample of it takes
its place.
"""

from typing import NamedTuple

import numpy as np
import scipy
from jaxtyping import Bool, Float

from ..maps.iterate import KEEP, ends, iterate
from ..maps.monodromy import monodromy
from ..maps.phase_shift import shift_phase
from ..scene.codes import Status
from ..scene.state import State

TURNS, SHARES = 32, 8  # of a fan: directions, radii from one to its double
SAFETY = 0.5  # of the largest ellipse whose fan comes back nearer
SAMPLE = 8  # times KEEP periods of each of the sampled states of a chaotic attractor
LOOSE = 3.0  # times the distance within which 99 % of one half of a sample find the other: on the same set


class Trap(NamedTuple):
    """Of a periodic attractor: its points (n, 2), and L (n, 2, 2); a state with abs(L (z - point)) <= 1 is in it."""

    points: Float[np.ndarray, "points 2"]
    lengths: Float[np.ndarray, "points 2 2"]

    def holds(self, z: Float[np.ndarray, "lanes 2"]) -> Bool[np.ndarray, " lanes"]:
        """Whether states (lanes, 2) are in it."""
        found = np.zeros(len(z), bool)
        for point, length in zip(self.points, self.lengths, strict=True):
            found |= np.square((z - point) @ length.T).sum(axis=1) <= 1.0
        return found


class Cloud(NamedTuple):
    """Of a chaotic attractor: a tree of sampled points, and how near to one of them a state counts as on it."""

    tree: "scipy.spatial.cKDTree"
    near: float

    def holds(self, z: Float[np.ndarray, "lanes 2"]) -> Bool[np.ndarray, " lanes"]:
        """Whether states (lanes, 2) are near it."""
        return np.isfinite(self.tree.query(z, distance_upper_bound=self.near)[0])


def trap(scene, points, phase, scale):
    """The `Trap` of a periodic attractor with these points (n, 2) on Sigma, in order; None where there is none.

    There is none where the derivative does not exist or does not draw in, and where an impact falls on the section's
    phase, as neighbours jump there. phase: rad, of the section; scale: of x and v, the largest.
    """
    derivatives = np.asarray(monodromy(scene, states(scene, points, phase), len(points)), float)
    found = []
    for place, derivative in enumerate(derivatives):
        if not np.isfinite(derivative).all() or (grip := max(abs(np.linalg.eigvals(derivative)))) >= 1.0:
            return None
        rate = 0.5 * (1.0 + grip)
        length = scipy.linalg.cholesky(scipy.linalg.solve_discrete_lyapunov(derivative.T / rate, np.eye(2)))
        radius = _radius(scene, np.roll(points, -place, axis=0), phase, length, 0.5 * (1.0 + rate), scale)
        if not radius:
            return None
        found.append(length / radius)
    return Trap(points, np.array(found))


def _radius(scene, points, phase, length, rate, scale):
    """A radius below which all states of a fan come nearer to the first point, by the rate at least; 0: none."""
    angle = 2.0 * np.pi * np.arange(TURNS) / TURNS
    heading = np.linalg.solve(length, np.stack([np.cos(angle), np.sin(angle)])).T
    halvings = int(-0.5 * np.log2(np.finfo(scene.dtype).eps))  # down to where rounding is not yet felt
    radii = scale * 2.0 ** (-np.arange(halvings * SHARES) / SHARES)
    fan = points[0] + radii[:, None, None] * heading
    after, status = ends(scene, states(scene, fan.reshape(-1, 2), phase), len(points))
    back = np.stack([after.x, after.v], -1) - points[0]
    apart = np.sqrt(np.square(back @ length.T).sum(axis=1)).reshape(fan.shape[:2])
    outside = (status >= Status.CAP).reshape(fan.shape[:2])  # beyond a wall there are no states
    bad = np.flatnonzero(((apart > rate * radii[:, None]) & ~outside).any(axis=1))
    first = bad[-1] + 1 if bad.size else 0
    return SAFETY * radii[first] if first < len(radii) else 0.0


def cloud(scene, points, phase):
    """The `Cloud` of a chaotic attractor with these points (lanes, 2) on Sigma at phase 0."""
    state, _ = shift_phase(scene, states(scene, points, 0.0), phase)
    sample = []
    for _ in range(1 + SAMPLE):
        run = iterate(scene, state, KEEP)
        state = run.state
        sample.append(run.points)
    sample = np.concatenate(sample[1:])  # in the first round the lanes part from each other
    half = sample.shape[1] // 2
    first, second = (part.reshape(-1, 2) for part in (sample[:, :half], sample[:, half:]))
    near = np.quantile(scipy.spatial.cKDTree(first).query(second)[0], 0.99)
    return Cloud(scipy.spatial.cKDTree(sample.reshape(-1, 2)), LOOSE * near)


def states(scene, points, phase):
    """Free states at these points (lanes, 2) and a phase."""
    x, v = np.asarray(points, scene.dtype).T
    return State(x, v, np.full(len(x), phase, scene.dtype), np.zeros(len(x), scene.dtype))
